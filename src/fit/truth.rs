//! What a fitted material is to answer: the reference surface where there is one, else the full model.

use crate::error::Result;
use crate::query::{QueryBuffer, Reflectance};
use crate::reference::{Reference, Sampling};

/// Ground truth of a fit.
pub enum Truth {
    /// A surface, whose answers are measured.
    Surface(Box<Reference>),
    /// The full model: what is fitted cannot be better than it.
    Model(Box<dyn Reflectance>),
}

impl Truth {
    /// Answers and the mean variance of each; `spp` rays a query, of which those of query k draw from (`seed`, `first` + k).
    ///
    /// # Errors
    /// Whatever keeps it from answering.
    pub fn ask(
        &self,
        queries: &QueryBuffer,
        spp: usize,
        seed: u64,
        first: u64,
    ) -> Result<(Vec<[f32; 3]>, Vec<f32>)> {
        match self {
            Self::Surface(surface) => {
                let measured = surface.measure(queries, &Sampling { spp, seed, first })?;
                Ok((measured.rgb.pixels, measured.variance))
            }
            Self::Model(model) => Ok((model.evaluate(queries)?.pixels, vec![0.0; queries.len()])),
        }
    }

    /// True for a surface.
    pub fn is_surface(&self) -> bool {
        matches!(self, Self::Surface(_))
    }
}
