//! What changes over a run besides the losses: budget, learning rate, smoothing. Shares are of the whole run.

use serde::{Deserialize, Serialize};

/// When training ends.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Budget {
    /// Optimiser steps.
    Steps(u64),
    /// Samples presented.
    Samples(u64),
    /// Minutes of training; the one budget whose result depends on the machine.
    Minutes(f64),
}

/// Learning rate over the run: `peak`, after a linear rise over `warmup`, falling along `decay`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LearningRate {
    /// Highest value.
    pub peak: f64,
    /// Share of the run in which it rises from 0.
    pub warmup: f64,
    /// How it falls afterwards.
    pub decay: Decay,
}

/// Decay of the learning rate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Decay {
    /// None.
    Constant {},
    /// Half a cosine down to `floor` times the peak.
    Cosine {
        /// Share of the peak that is left at the end.
        floor: f64,
    },
    /// Exponentially down to `floor` times the peak.
    Exponential {
        /// Share of the peak that is left at the end.
        floor: f64,
    },
}

impl LearningRate {
    /// The rate when a share `fraction` of the run is done.
    pub fn at(&self, fraction: f64) -> f64 {
        if fraction < self.warmup {
            return self.peak * (fraction / self.warmup).max(1e-3);
        }
        let t = ((fraction - self.warmup) / (1.0 - self.warmup)).clamp(0.0, 1.0);
        self.peak
            * match self.decay {
                Decay::Constant {} => 1.0,
                Decay::Cosine { floor } => {
                    floor + (1.0 - floor) * 0.5 * (1.0 + (std::f64::consts::PI * t).cos())
                }
                Decay::Exponential { floor } => floor.powf(t),
            }
    }
}

/// Adam (Kingma and Ba 2015).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AdamConfig {
    /// Decay of the first moment.
    pub beta1: f64,
    /// Decay of the second moment.
    pub beta2: f64,
    /// Added to the root of the second moment.
    pub epsilon: f64,
}

/// Gaussian through which every texture is read while training (NeuMIP's code):
/// sigma(t) = max(minimum, start * start^(-rate t)) texels for t in \[0, 1\] of the run; level l uses sigma / 2^l.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Smoothing {
    /// Texels at the start.
    pub start: f64,
    /// Decades of `start` over the run: 3 in NeuMIP, 0.3 in the improved method's code.
    pub rate: f64,
    /// Least sigma, texels.
    pub minimum: f64,
    /// A level whose sigma is under this is read as it is.
    pub skip_below: f64,
    /// Least sigma of the offset texture, texels.
    pub offset_minimum: f64,
}

impl Smoothing {
    /// sigma in texels of level 0 when a share `fraction` of the run is done.
    pub fn sigma(&self, fraction: f64) -> f64 {
        (self.start * self.start.powf(-self.rate * fraction)).max(self.minimum)
    }
}

/// Blending of the stored pyramid towards its own blur, early in the run (NeuMIP's code).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Blend {
    /// Share of the run in which it happens.
    pub until: f64,
    /// Share of the run between two blends.
    pub every: f64,
    /// Weight of the blur.
    pub amount: f64,
    /// Its sigma in texels of the level.
    pub sigma: f64,
}
