//! Ground truths whose answers are spoilt on purpose.

use crate::dataset::{Answers, Source};
use crate::error::Result;
use crate::query::QueryBuffer;
use crate::random::{Random, Stream};
use crate::reference::Reference;
use serde_json::{Value, json};
use std::sync::Arc;

/// A surface whose answers are changed one by one; a change draws from the answer's own random numbers.
pub(super) struct Spoilt<F> {
    pub(super) inner: Arc<Reference>,
    /// What is done, for the data's description.
    pub(super) how: String,
    pub(super) change: F,
}

impl<F: Fn([f32; 3], &mut Random) -> [f32; 3] + Sync> Source for Spoilt<F> {
    fn name(&self) -> &str {
        self.inner.name()
    }

    fn height_range(&self) -> [f32; 2] {
        self.inner.height_range()
    }

    fn height_map(&self) -> Option<(usize, usize, Vec<f32>)> {
        None
    }

    fn measure(&self, queries: &QueryBuffer, spp: usize, seed: u64, first: u64) -> Result<Answers> {
        let mut answers = Source::measure(&*self.inner, queries, spp, seed, first)?;
        for (k, rgb) in answers.rgb.iter_mut().enumerate() {
            *rgb = (self.change)(*rgb, &mut Random::new(seed, Stream::Probe, first + k as u64));
        }
        Ok(answers)
    }

    fn description(&self) -> Value {
        json!({ "kind": "spoilt", "how": self.how, "of": Source::description(&*self.inner) })
    }
}

/// A factor of mean 1 that is as noisy as the mean of `samples` exponential ones: Monte Carlo noise with a long tail.
pub(super) fn noise(samples: usize, random: &mut Random) -> f32 {
    let sum: f64 = (0..samples).map(|_| -(1.0 - random.uniform_f64()).ln()).sum();
    (sum / samples as f64) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Five standard errors of the mean of so many exponential numbers.
    const SCATTER: f64 = 5.0 * 0.01;

    #[test]
    fn noise_has_mean_one_and_a_median_below() {
        let mut random = Random::new(1, Stream::Probe, 0);
        let mut values: Vec<f64> = (0..10_000).map(|_| f64::from(noise(1, &mut random))).collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        values.sort_by(f64::total_cmp);
        let median = values[values.len() / 2];
        assert!((mean - 1.0).abs() < SCATTER, "{mean}");
        assert!((median - 1.0).abs() > SCATTER && (median - 2f64.ln()).abs() < SCATTER, "{median}");
    }
}
