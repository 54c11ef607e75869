//! The one thing that generation asks of a ground truth.

use crate::{error::Result, query::QueryBuffer};

/// What a ground truth says to a buffer of queries.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Answers {
    /// RGB, one entry a query.
    pub rgb: Vec<[f32; 3]>,
    /// Variance of each estimate (mean of the three channels); 0 where it is exact, or unknown after one sub-sample.
    pub variance: Vec<f32>,
    /// Rays that were traced for it.
    pub rays: u64,
}

/// A ground truth that estimates answers and says how noisy they are.
pub trait Source: Sync {
    /// Name of the material.
    fn name(&self) -> &str;

    /// Lowest and highest point of the surface around z = 0, in tile widths.
    fn height_range(&self) -> [f32; 2];

    /// Rows, columns and heights (row by row, tile widths), where the material is a height field;
    /// nothing where it is not (fibres, meshes).
    fn height_map(&self) -> Option<(usize, usize, Vec<f32>)>;

    /// Estimates every query from `spp` sub-samples; query k of the buffer draws its random numbers from
    /// (`seed`, `first + k`) alone, so that an answer does not depend on the buffer that it is asked in.
    ///
    /// # Errors
    /// Whatever keeps the material from being evaluated.
    fn measure(&self, queries: &QueryBuffer, spp: usize, seed: u64, first: u64) -> Result<Answers>;

    /// What `dataset.json` records about the material. Resuming compares it.
    fn description(&self) -> serde_json::Value;
}
