//! Data on disk and in memory.
//!
//! ```text
//! source ── plan ── generate ── write ──▶ folder ──▶ read ── stream ──▶ batches of pieces
//! truth     what     asks it    whole     format     checks   shuffles
//!           to ask              files     (json, EXR, table)
//! ```
//! `block` is the unit of all of them; `query_frame` writes single pictures for evaluation and other tools.

mod block;
mod config;
mod folder;
mod format;
mod frame;
mod from_reference;
mod generate;
mod grid;
mod nearest;
mod plan;
mod query_frame;
mod read;
mod scene;
mod source;
mod stream;
mod table;
mod write;

pub use block::{Block, Layout, MAX_LEVEL, MAX_SIDE, Patch};
pub use config::{GenerateConfig, Regime};
pub use format::{
    Distance, FORMAT, FileInfo, HeightInfo, MANIFEST, Manifest, SplitInfo, SplitName, Summary, ViewInfo,
};
pub use generate::{Progress, generate};
pub use query_frame::{read_query_frame, write_query_frame};
pub use read::{Dataset, Split};
pub use scene::{SCENES, Scene};
pub use source::Source;
pub use stream::{Batch, Stream};
pub use write::{Existing, Writer};
