//! What came of a fit.

use super::goal::Goal;
use super::need::Need;
use super::search::Trial;
use crate::evaluate::Cost;
use crate::render::compare::Comparison;
use neumip_export::Storage;
use serde::Serialize;

/// One model beside the others.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// `full`, `full, half precision`, `fitted`, `truncated`.
    pub name: String,
    /// Its size.
    pub shape: String,
    /// How its numbers are stored.
    pub storage: Storage,
    /// Bytes as stored.
    pub bytes: usize,
    /// Floating-point operations a query.
    pub flops: usize,
    /// Nanoseconds a query on the scene's queries, one thread.
    pub cost: Cost,
    /// Milliseconds a picture: that, times the queries of a picture.
    pub frame_ms: f64,
    /// Seconds of training: of the search and all its trainings for what was fitted, 0 for what was not trained.
    pub training_seconds: f64,
    /// Errors over the path: the mean over the pictures.
    pub errors: Comparison,
    /// Errors of each picture.
    pub pictures: Vec<Comparison>,
}

/// Errors on held-out data of the whole material, apart for what the fitted model was made for and what not.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Elsewhere {
    /// The split.
    pub split: String,
    /// Queries inside and outside of the domain.
    pub queries: [u64; 2],
    /// `mse` of the full model inside and outside, where there are such queries.
    pub full: [Option<f64>; 2],
    /// `mse` of the fitted model inside and outside.
    pub fitted: [Option<f64>; 2],
}

/// Everything that a report says.
#[derive(Clone, Debug, Serialize)]
pub struct Outcome {
    /// The scene.
    pub scene: String,
    /// The material's name in it, and what the full model was trained on.
    pub material: String,
    /// What the full model was trained on.
    pub trained_on: String,
    /// What the scene needs.
    pub need: Need,
    /// What was to be reached.
    pub goal: Goal,
    /// The bound of the error, where there was one.
    pub bound: Option<f64>,
    /// Whether it is held on the reported pictures.
    pub holds: bool,
    /// `surface`, or `full model` where the data has none.
    pub truth: String,
    /// Training samples of the fit, and the share of them that is spread over everything else.
    pub unique_samples: usize,
    /// That share.
    pub floor: f64,
    /// Pictures and queries of each, on average.
    pub pictures: usize,
    /// Queries of a picture.
    pub queries_per_picture: f64,
    /// Full, fitted, truncated.
    pub rows: Vec<Row>,
    /// Samples presented and seconds of training of the full model; absent where it does not say.
    pub full_training: Option<(u64, f64)>,
    /// Seconds in which the scene was asked, its truth and the training data were measured.
    pub measuring_seconds: f64,
    /// Samples presented in all trials.
    pub search_samples: u64,
    /// Seconds of training in all trials.
    pub search_seconds: f64,
    /// Those over the full model's training.
    pub trainings: Option<f64>,
    /// Every trial.
    pub trials: Vec<Trial>,
    /// Errors on the data's own splits.
    pub elsewhere: Vec<Elsewhere>,
}

impl Outcome {
    /// A row by its name.
    pub fn row(&self, name: &str) -> Option<&Row> {
        self.rows.iter().find(|row| row.name == name)
    }

    /// How many times fewer bytes and nanoseconds the fitted model has, and its error over the full one's.
    pub fn savings(&self) -> Option<[f64; 3]> {
        let (full, fitted) = (self.row(FULL)?, self.row(FITTED)?);
        let metric = self.goal.metric();
        let error = metric.of(&fitted.errors).ok()? / metric.of(&full.errors).ok()?;
        let bytes = full.bytes as f64 / fitted.bytes as f64;
        Some([bytes, full.cost.ns_per_query / fitted.cost.ns_per_query, error])
    }
}

/// The full model as it was trained.
pub const FULL: &str = "full";
/// The full model in half precision: what rounding alone saves.
pub const ROUNDED: &str = "full, half precision";
/// The fitted model.
pub const FITTED: &str = "fitted";
/// The full model cut down to the fitted one's size, without training.
pub const TRUNCATED: &str = "truncated";
