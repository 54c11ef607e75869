//! The cells of one training: its errors on every split, seen and held out.

use super::job::Job;
use super::study::Study;
use crate::dataset::{Dataset, SplitName};
use crate::error::Result;
use crate::evaluate::{Row, motion_table, split_table, view_table};
use crate::lpips::Lpips;
use crate::query::Reflectance;
use crate::results::Cell;
use neumip_export::config::Architecture;
use neumip_export::{Precision, Storage};

/// Held-out splits.
const HELD_OUT: [SplitName; 3] = [SplitName::Test, SplitName::Offgrid, SplitName::Grazing];
/// Samples a texel of the training data that are asked again.
const TRAINING_SAMPLES: u64 = 8;

/// The data of a job.
#[derive(Clone, Copy, Debug)]
pub struct Data<'a> {
    /// What it is trained on.
    pub training: &'a Dataset,
    /// Where its held-out splits and views are.
    pub held_out: &'a Dataset,
}

/// The rows of an answerer: some of the training data, all held-out splits that the data has, the views, the
/// sequences.
///
/// # Errors
/// As [`split_table`].
pub fn rows(
    answerer: &dyn Reflectance,
    study: &Study,
    data: Data,
    lpips: Option<&Lpips>,
) -> Result<Vec<Row>> {
    let mut rows =
        split_table(answerer, data.training, SplitName::Train, study.texels() * TRAINING_SAMPLES, lpips)?;
    for split in HELD_OUT.into_iter().filter(|s| data.held_out.split_names().contains(s)) {
        rows.extend(split_table(answerer, data.held_out, split, u64::MAX, lpips)?);
    }
    rows.extend(view_table(answerer, data.held_out, lpips)?);
    rows.extend(motion_table(answerer, data.held_out, lpips)?);
    Ok(rows)
}

/// What answered.
#[derive(Clone, Debug)]
pub struct Answered {
    /// Added to the label.
    pub suffix: &'static str,
    /// In words.
    pub engine: String,
    /// Bytes of weights and textures.
    pub bytes: usize,
    /// Of the networks, a query.
    pub flops: usize,
}

impl Answered {
    /// A trained model with textures of a precision.
    pub fn model(architecture: &Architecture, precision: Precision, engine: String) -> Self {
        Self {
            suffix: if precision == Precision::Half { "-f16" } else { "" },
            engine,
            bytes: architecture.bytes_as(Storage { textures: precision, ..Storage::SINGLE }),
            flops: architecture.flops_per_query(),
        }
    }
}

/// Cells of a job's rows; `presented` samples were shown to it.
pub fn cells(job: &Job, data: Data, presented: u64, answered: &Answered, rows: Vec<Row>) -> Vec<Cell> {
    let [height, width] = data.training.resolution();
    let texels = (height * width) as f64;
    let training = data.training.manifest().splits.get(&SplitName::Train);
    let unique = training.map_or(0, |split| split.samples()) as f64;
    rows.into_iter()
        .map(|row| Cell {
            material: job.material.clone(),
            preset: format!("{}{}", job.variant.label, answered.suffix),
            seed: if presented > 0 { job.seed } else { 0 },
            resolution: [height, width],
            samples_per_texel: presented as f64 / texels,
            unique_samples_per_texel: if presented > 0 { unique / texels } else { 0.0 },
            regime: job.directions.to_string(),
            metrics: row.metrics(),
            noise: row.noise,
            split: row.split,
            level: row.level,
            ns_per_query: None,
            bytes: answered.bytes as u64,
            flops: answered.flops as u64,
            engine: answered.engine.clone(),
        })
        .collect()
}
