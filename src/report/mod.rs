//! What `neumip demo` hands back: one self-contained page, and the same figures as JSON.
//!
//! [`html`] needs no other file, no script and no network; [`json`] keeps every number of the page and none
//! of its pictures. Numbers that are not finite become `null`.

pub(crate) mod colour;
pub mod figures;
pub(crate) mod numbers;
mod page;
mod panel;
pub mod picture;
#[cfg(test)]
mod tests;

pub use page::{escaped, filled, inert};
pub use panel::Panel;

use crate::error::{Error, Result};
use serde::Serialize;

/// The style of every page.
pub const STYLE: &str = include_str!("style.css");

/// Everything the page shows.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Report {
    /// Heading.
    pub title: String,
    /// Name and value: material, resolution, samples a texel, steps, threads, seconds...
    pub facts: Vec<(String, String)>,
    /// One sentence that says what came out.
    pub verdict: String,
    /// Rows of pictures.
    pub panels: Vec<Panel>,
    /// How the training of each model went.
    pub curves: Vec<Curve>,
    /// Held-out errors; rows of the same split and level form a group.
    pub table: Vec<TableRow>,
    /// What a query costs.
    pub costs: Vec<CostRow>,
    /// Files that were written for other programs.
    pub exports: Vec<ExportRow>,
    /// Command lines that do the same again.
    pub commands: Vec<String>,
}

/// Progress of one training.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Curve {
    /// The model.
    pub name: String,
    /// (steps done, training loss). Models are trained on losses of their own: compare shapes, not heights.
    pub training: Vec<(f64, f64)>,
    /// (steps done, `mse` on held-out directions), comparable between models.
    pub validation: Vec<(f64, f64)>,
}

/// Held-out errors of one model in one split and level.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct TableRow {
    /// The model.
    pub model: String,
    /// Part of the data.
    pub split: String,
    /// A level, or a word for several.
    pub level: String,
    /// Queries that were compared.
    pub samples: u64,
    /// Squared error, both clamped to \[0, 1\].
    pub mse: f64,
    /// Squared error.
    pub mse_linear: f64,
    /// Squared error of ln(1 + max(x, 0)).
    pub mse_log1p: f64,
    /// Of `mse`, dB.
    pub psnr: Option<f64>,
    /// Structural similarity.
    pub ssim: Option<f64>,
    /// FLIP, what is seen when answer and reference alternate: 0 to 1.
    pub flip: Option<f64>,
    /// `mse` that the reference's own noise amounts to: no model can be seen to be better than that.
    pub noise: Option<f64>,
}

/// Time and size of one model.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct CostRow {
    /// The model.
    pub model: String,
    /// Median of the nanoseconds a query.
    pub ns: f64,
    /// Fastest run.
    pub ns_low: f64,
    /// Slowest run.
    pub ns_high: f64,
    /// Weights of the networks.
    pub weights: u64,
    /// Floating point operations a query.
    pub flops: u64,
    /// Bytes of the whole material.
    pub bytes: u64,
    /// Held-out `mse`.
    pub mse: f64,
}

/// One exported file.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ExportRow {
    /// The model.
    pub model: String,
    /// Where it is, relative to the page.
    pub file: String,
    /// Its size.
    pub bytes: u64,
    /// What it holds and who reads it.
    pub what: String,
}

/// The page.
///
/// # Errors
/// `Config` if a panel has an image without pixels, or images of different shapes.
pub fn html(report: &Report) -> Result<String> {
    page::html(report)
}

/// The figures of the page: the fields of [`Report`] by name. A panel has its `title`, `caption`, `height`,
/// `width`, `exposure_stops`, `difference_maximum` and, for each of its `answers`, `model`, `mse`,
/// `mse_linear`, `mse_log1p` and `psnr` (`null` where it is unbounded).
///
/// # Errors
/// As [`html`].
pub fn json(report: &Report) -> Result<serde_json::Value> {
    for (i, panel) in report.panels.iter().enumerate() {
        panel.checked().map_err(|e| Error::config(format!("report.panels[{i}]"), e))?;
    }
    serde_json::to_value(report).map_err(|e| Error::config("report", e))
}
