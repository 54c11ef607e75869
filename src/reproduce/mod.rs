//! The paper's questions, asked again at any budget: what is trained, on what, how it is tuned and what is kept.
//!
//! ```text
//! study ── jobs ──▶ trials ──▶ cells ──▶ results ──▶ tables ──▶ Markdown, page
//! what     variant  tuning     one job    merged      the paper's questions
//!          x data   by val.    each
//! ```
//! Equal data, equal samples, equal tuning: every variant of a study is trained on the same dataset with the same
//! number of samples presented, and every preset has the same trials. A job that is finished is a file of cells, so a
//! study may be stopped, shared out over machines, and put together again.

pub mod folder;
pub mod job;
pub mod measure;
pub mod page;
pub mod paper;
pub mod study;
pub mod tables;
pub mod tuning;
pub mod variant;

pub use folder::Folder;
pub use job::{Job, jobs};
pub use study::{Question, Scope, Study};
pub use variant::Variant;
