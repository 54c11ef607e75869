//! Data on disk and in memory.
//!
//! ```text
//! source ── plan ── generate ── write ──▶ folder ──▶ read ── stream ──▶ batches of pieces
//! truth     what     asks it    whole     format     checks   shuffles
//!           to ask   measure    files     (json, EXR, table)
//! ```
//! `block` is the unit of all of them. `plan` takes levels from `cycle` or `slices` and directions from `directions`;
//! `origin` and `shard` let a dataset be resumed, appended to and made in parts; `contact_sheet` shows it;
//! `query_frame` writes single pictures for evaluation and other tools.

mod block;
mod config;
mod contact_sheet;
mod cycle;
mod directions;
mod files;
mod folder;
mod format;
mod frame;
mod from_reference;
mod generate;
mod grid;
mod images;
mod measure;
mod motion;
mod nearest;
mod origin;
mod plan;
mod progress;
mod query_frame;
mod read;
mod regime;
mod scene;
mod shard;
mod slices;
mod source;
mod stream;
mod table;
mod write;

pub use block::{Block, Layout, MAX_LEVEL, MAX_SIDE, Patch};
pub use config::GenerateConfig;
pub use contact_sheet::contact_sheet;
pub use files::CONTACT_SHEET;
pub use format::{
    Distance, FORMAT, FileInfo, HeightInfo, MANIFEST, Manifest, SequenceInfo, SplitInfo, SplitName, Summary,
    ViewInfo,
};
pub use generate::{generate, generate_shard};
pub use motion::{Motion, SEQUENCES};
pub use progress::Progress;
pub use query_frame::{read_query_frame, write_query_frame};
pub use read::{Dataset, Split};
pub use regime::Regime;
pub use scene::{Camera, SCENES, Scene};
pub use shard::Shard;
pub use source::{Answers, Source};
pub use stream::{Batch, Stream};
pub use write::{Existing, Writer};
