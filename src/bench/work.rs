//! What is timed, pass by pass.

use super::peak;
use super::subject::Subject;
use crate::dataset::Block;
use crate::engine::{FusedMaterial, Prepared};
use crate::error::{Error, Result};
use crate::kernels::simd::Isa;
use crate::model::texture::Sigmas;
use crate::query::{QueryBuffer, Reflectance};
use crate::trainer::{Learner, Step};
use rayon::ThreadPool;
use std::hint::black_box;
use std::time::Instant;

/// Learning rate of timed steps.
const RATE: f64 = 1e-3;

/// One kind of pass.
pub(super) enum Task<'a> {
    /// An optimiser step.
    Train(Box<Trainee<'a>>),
    /// All queries, whole.
    Answer(&'a dyn Reflectance, &'a QueryBuffer),
    /// All queries prepared once and then lit by every light.
    Lights(&'a FusedMaterial, &'a QueryBuffer, &'a [Vec<[f32; 2]>]),
    /// The machine's peak.
    Peak(Isa),
}

/// A model that takes timed steps.
pub(super) struct Trainee<'a> {
    pub learner: Learner,
    pub subject: &'a Subject,
    /// Batches that take turns.
    pub batches: &'a [Vec<Block>],
    pub sigmas: Sigmas,
    /// Steps between two updates of the textures.
    pub every: u64,
    /// Of the steps that update no textures, those that are timed between two that do; the others are taken to be alike.
    pub most: u64,
    pub steps: u64,
    pub updates: u64,
}

impl Task<'_> {
    /// Seconds of a pass on the threads of `pool`, averaged over `passes`.
    pub fn time(&mut self, pool: &ThreadPool, passes: usize) -> Result<f64> {
        let passes = passes.max(1);
        let each = |total: f64| total / passes as f64;
        pool.install(|| match self {
            Self::Train(trainee) => (0..passes).map(|_| trainee.cycle()).sum::<Result<f64>>().map(each),
            Self::Answer(material, queries) => {
                let begun = Instant::now();
                for _ in 0..passes {
                    black_box(material.evaluate(queries)?);
                }
                Ok(each(begun.elapsed().as_secs_f64()))
            }
            Self::Lights(material, queries, lights) => {
                let begun = Instant::now();
                for _ in 0..passes {
                    let prepared: Prepared = material.prepare(&queries.u, &queries.level, &queries.wo)?;
                    for wi in *lights {
                        black_box(material.light(&prepared, wi)?);
                    }
                }
                Ok(each(begun.elapsed().as_secs_f64()))
            }
            Self::Peak(isa) => {
                let begun = Instant::now();
                rayon::broadcast(|_| peak::run(*isa, passes));
                Ok(each(begun.elapsed().as_secs_f64()))
            }
        })
    }

    /// Of what `time` averages over, what one pass really runs: steps of a whole cycle, else 1.
    pub fn steps(&self) -> u64 {
        match self {
            Self::Train(trainee) => 1 + trainee.most.min(trainee.every - 1),
            _ => 1,
        }
    }
}

impl Trainee<'_> {
    /// From one update of the textures to the next: seconds a step.
    fn cycle(&mut self) -> Result<f64> {
        let begun = Instant::now();
        let seconds = || begun.elapsed().as_secs_f64();
        // This one reads the textures anew.
        self.step()?;
        let first = seconds();
        let others = self.every - 1;
        let timed = others.min(self.most);
        for _ in 0..timed {
            self.step()?;
        }
        let plain = if timed > 0 { (seconds() - first) / timed as f64 } else { 0.0 };
        let before = seconds();
        self.updates += 1;
        self.learner.update_textures(RATE, self.updates, true)?;
        let update = seconds() - before;
        Ok((first + plain * others as f64 + update) / self.every as f64)
    }

    fn step(&mut self) -> Result<()> {
        let step = Step {
            pieces: &self.batches[self.steps as usize % self.batches.len()],
            terms: &self.subject.terms,
            target_range: self.subject.target_range,
            highest_level: None,
            offset_texture: true,
        };
        let loss = self.learner.step(&step, &self.sigmas)?;
        if !loss.is_finite() {
            return Err(Error::Diverged(format!("the loss of timed step {} is not finite", self.steps + 1)));
        }
        self.steps += 1;
        self.learner.update_networks(RATE, self.steps)
    }
}
