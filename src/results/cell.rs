//! One line of the results, and one tuning trial.

use serde::{Deserialize, Serialize};

/// Errors by name; none where a metric was not or cannot be computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Metrics {
    /// Squared error of linear RGB clamped to \[0, 1\]: the headline.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mse: Option<f64>,
    /// Squared error of linear RGB.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mse_linear: Option<f64>,
    /// Squared error of ln(1 + max(x, 0)).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mse_log1p: Option<f64>,
    /// Of `mse`, dB.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub psnr: Option<f64>,
    /// Structural similarity.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ssim: Option<f64>,
    /// FLIP, beside `mse` the headline.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub flip: Option<f64>,
    /// LPIPS, where weights were given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lpips: Option<f64>,
    /// Error of the frame difference over the energy of the true one, where the split is a sequence.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub flicker: Option<f64>,
}

/// One cell of the tables: a trained material asked about one split at one level.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cell {
    /// Material.
    pub material: String,
    /// Preset, or the variant's label.
    pub preset: String,
    /// Seed of the training; 0 where nothing is trained.
    pub seed: u64,
    /// Texels of the tile, \[height, width\].
    pub resolution: [usize; 2],
    /// Samples presented in training, a texel.
    pub samples_per_texel: f64,
    /// Samples of the training data, a texel.
    pub unique_samples_per_texel: f64,
    /// Directions of the training data: `scattered`, `slices-N`.
    pub regime: String,
    /// Split: `train`, `test`, `offgrid`, `grazing`, `views/NAME`, `motion/NAME`.
    pub split: String,
    /// The level, rounded down; none for all of the split.
    pub level: Option<usize>,
    /// The errors.
    #[serde(flatten)]
    pub metrics: Metrics,
    /// Variance of the reference itself: a perfect answer's `mse_linear`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise: Option<f64>,
    /// Time of a whole query, fused, one thread.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ns_per_query: Option<f64>,
    /// Weights and textures as they are answered from.
    pub bytes: u64,
    /// Multiply-adds of the networks times 2, a query.
    pub flops: u64,
    /// What answered: precision of the textures, engine.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub engine: String,
}

/// Material, preset, regime, resolution, samples a texel, seed.
pub type RunKey = (String, String, String, [usize; 2], u64, u64);

impl Cell {
    /// What was trained.
    pub fn run_key(&self) -> RunKey {
        let budget = self.samples_per_texel.round() as u64;
        let (material, preset, regime) = (self.material.clone(), self.preset.clone(), self.regime.clone());
        (material, preset, regime, self.resolution, budget, self.seed)
    }

    /// What was trained, and what it was asked.
    pub fn key(&self) -> (RunKey, String, Option<usize>) {
        (self.run_key(), self.split.clone(), self.level)
    }
}

/// One tuning trial: what was tried and what it gave on the validation split.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Trial {
    /// Preset.
    pub preset: String,
    /// Material.
    pub material: String,
    /// Directions of the training data.
    pub regime: String,
    /// Number of the trial.
    pub index: usize,
    /// Fields that were set, as `--set` takes them.
    pub set: Vec<String>,
    /// Seed of the training.
    pub seed: u64,
    /// Samples presented, a texel.
    pub samples_per_texel: f64,
    /// `mse` on the validation split; none where the training did not end in numbers.
    pub mse: Option<f64>,
    /// True for the one that the preset was run with.
    pub chosen: bool,
}

impl Trial {
    /// What was tried.
    pub fn key(&self) -> (String, String, String, usize, u64) {
        let (preset, material, regime) = (self.preset.clone(), self.material.clone(), self.regime.clone());
        (preset, regime, material, self.index, self.seed)
    }
}
