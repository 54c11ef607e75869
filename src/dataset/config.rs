//! What to generate.

use super::{motion::Motion, regime::Regime, scene::scenes, slices};
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::fmt;

/// What to generate: everything that the bytes of a dataset depend on, besides the material.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GenerateConfig {
    /// Texels along a side of the tile: a power of two from 4 to 4096.
    pub resolution: usize,
    /// Directions of the training data.
    pub regime: Regime,
    /// Unique training samples: scattered ones are rounded up to whole blocks, `slices` takes as many pairs as they
    /// pay for, and for `slices-N` they follow from N (see [`GenerateConfig::resolved`]).
    pub samples: u64,
    /// Samples of the validation split, rounded up to whole blocks; 0 leaves it out.
    pub validation_samples: u64,
    /// Samples of the offgrid split.
    pub offgrid_samples: u64,
    /// Samples of the grazing split.
    pub grazing_samples: u64,
    /// Pairs of directions of the test split at level 0, a whole slice each; 0 leaves it out.
    pub test_pairs: usize,
    /// Pixels along a side of each view; 0 leaves them out.
    pub view_size: usize,
    /// Tiles along a side of the views' square \[-1, 1\]^2.
    pub view_tiles: usize,
    /// Samples along a side of a block, a power of two up to the resolution; slices and tests use the tile's
    /// side.
    pub block_side: usize,
    /// Samples of a file, which is what a killed run can lose; a file holds at least one block.
    pub file_samples: usize,
    /// Directions \[tilt, pan\] of the views' lights in degrees: from the normal, and from x towards y.
    #[serde(default = "neumip_lights")]
    pub lights: Vec<[f32; 2]>,
    /// Sequences of views, of the views' size; absent: none. Half of `held_out_spp` are the sub-samples of
    /// each half of a frame, whatever `noise` is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub motion: Option<Motion>,
    /// Sub-samples of a training sample.
    pub spp: usize,
    /// Sub-samples of every other sample.
    pub held_out_spp: usize,
    /// The noise (square root of the mean variance) that the answers of a block or view may have: more sub-samples are
    /// taken until it holds. Blocks of less than 32 x 32 are too small to judge it without bias.
    #[serde(default)]
    pub noise: Option<f32>,
    /// Where `noise` is given, the most sub-samples of a sample.
    #[serde(default = "most_spp")]
    pub most_spp: usize,
    /// Share of the directions of scattered and slice training data, and of validation, that is uniform in solid angle
    /// down to 0.5 degrees above the horizon; the rest is uniform in the projected disc down to 5.7 degrees.
    #[serde(default)]
    pub grazing_floor: f32,
    /// Share of scattered blocks at a level between two integers.
    pub fractional_share: f32,
    /// Least share of the samples that a level gets; the rest goes to the levels in proportion to 4^-level.
    pub least_level_share: f32,
    /// Everything random follows from it.
    pub seed: u64,
    /// Store the height map, where the material has one.
    pub heights: bool,
}

/// A scattered split has at least so many blocks: a share of 5 % then has its block at every level.
pub(crate) const MIN_BLOCKS: usize = 40;
/// Most pairs of slices.
const MAX_PAIRS: usize = 1 << 20;
/// Most lights of views.
pub(crate) const MAX_LIGHTS: usize = 64;
/// Names of files have five digits.
pub(crate) const MAX_FILES: usize = 100_000;

/// The lights of NeuMIP's two scenes.
fn neumip_lights() -> Vec<[f32; 2]> {
    vec![[0.0, 0.0], [45.0, 30.0]]
}

fn most_spp() -> usize {
    1024
}

impl GenerateConfig {
    /// The defaults for a tile: 200 scattered training samples a texel, 16 sub-samples (64 where held out),
    /// blocks of 32 x 32, four held-out samples a texel in each of validation, offgrid and grazing.
    pub fn new(resolution: usize) -> Self {
        let texels = (resolution as u64).saturating_mul(resolution as u64);
        Self {
            resolution,
            regime: Regime::Scattered,
            samples: texels.saturating_mul(200),
            validation_samples: texels.saturating_mul(4),
            offgrid_samples: texels.saturating_mul(4),
            grazing_samples: texels.saturating_mul(4),
            test_pairs: 24,
            view_size: 256,
            view_tiles: 1,
            lights: neumip_lights(),
            motion: None,
            block_side: resolution.min(32),
            file_samples: 1 << 20,
            spp: 16,
            held_out_spp: 64,
            noise: None,
            most_spp: most_spp(),
            grazing_floor: 0.1,
            fractional_share: 0.25,
            least_level_share: 0.05,
            seed: 0,
            heights: true,
        }
    }

    /// Checks every bound.
    ///
    /// # Errors
    /// `Config`, naming the field.
    pub fn validate(&self) -> Result<()> {
        fn within<T: PartialOrd + fmt::Display>(field: &str, value: T, low: T, high: T) -> Result<()> {
            if value >= low && value <= high {
                return Ok(());
            }
            Err(Error::config(field, format!("{value} is outside {low} to {high}")))
        }
        let power = |field: &str, value: usize| {
            if value.is_power_of_two() {
                return Ok(());
            }
            let above = value.next_power_of_two();
            Err(Error::config(field, format!("{value} is no power of two; {} or {above} is", above / 2)))
        };
        within("resolution", self.resolution, 4, 4096)?;
        power("resolution", self.resolution)?;
        within("block_side", self.block_side, 2, self.resolution)?;
        power("block_side", self.block_side)?;
        if let Regime::Slices(pairs @ 1..) = self.regime {
            within("regime (pairs of slices)", pairs, 2, MAX_PAIRS)?;
        }
        within("spp", self.spp, 1, 1 << 20)?;
        within("held_out_spp", self.held_out_spp, 1, 1 << 20)?;
        within("samples", self.samples, 1, 1 << 40)?;
        within("validation_samples", self.validation_samples, 0, 1 << 40)?;
        within("offgrid_samples", self.offgrid_samples, 0, 1 << 40)?;
        within("grazing_samples", self.grazing_samples, 0, 1 << 40)?;
        within("test_pairs", self.test_pairs, 0, 1 << 16)?;
        within("view_size", self.view_size, 0, 8192)?;
        within("view_tiles", self.view_tiles, 1, 1024)?;
        within("file_samples", self.file_samples, 1, 1 << 25)?;
        within("lights (number)", self.lights.len(), 0, MAX_LIGHTS)?;
        scenes(&self.lights)?;
        if let Some(motion) = &self.motion {
            motion.validate()?;
            within("view_size (with motion)", self.view_size, 1, 8192)?;
        }
        if let Some(noise) = self.noise {
            within("noise", noise, f32::MIN_POSITIVE, f32::MAX)?;
            within("most_spp", self.most_spp, self.spp.max(self.held_out_spp), 1 << 20)?;
            // A single sub-sample does not tell its noise.
            within("spp (with noise)", self.spp, 2, 1 << 20)?;
            within("held_out_spp (with noise)", self.held_out_spp, 2, 1 << 20)?;
        }
        within("grazing_floor", self.grazing_floor, 0.0, 1.0)?;
        within("fractional_share", self.fractional_share, 0.0, 1.0)?;
        within("least_level_share", self.least_level_share, 0.0, 1.0 / self.levels() as f32)
    }

    /// The same with the number of pairs that `slices` has no number for, and with the samples that slices have.
    /// `earlier` are the amounts (see [`GenerateConfig::amount`]) that were made before, one for each time that the
    /// dataset was appended to.
    ///
    /// # Errors
    /// `Config` if a bound does not hold, or if the samples do not pay for two pairs.
    pub fn resolved(&self, earlier: &[u64]) -> Result<Self> {
        self.validate()?;
        let Regime::Slices(pairs) = self.regime else { return Ok(self.clone()) };
        let mut start = 0;
        let mut spent = 0;
        for end in earlier {
            spent += slices::samples(self, end.saturating_sub(start) as usize);
            start = *end;
        }
        let pairs = match pairs {
            0 => start as usize + slices::pairs_for(self, self.samples.saturating_sub(spent), MAX_PAIRS),
            pairs => pairs,
        };
        if pairs < 2 {
            let problem = format!(
                "{} do not pay for two pairs of slices: those have {}",
                self.samples,
                slices::samples(self, 2)
            );
            return Err(Error::config("samples", problem));
        }
        let more = (pairs as u64).saturating_sub(start) as usize;
        let samples = spent + if more > 0 { slices::samples(self, more) } else { 0 };
        Ok(Self { regime: Regime::Slices(pairs), samples, ..self.clone() })
    }

    /// How much training data there is: samples where it is scattered, pairs of slices.
    pub fn amount(&self) -> u64 {
        match self.regime {
            Regime::Scattered => self.samples,
            Regime::Slices(pairs) => pairs as u64,
        }
    }

    /// Levels of the tile: log2 of its side.
    pub fn levels(&self) -> usize {
        self.resolution.max(2).ilog2() as usize
    }

    /// Share of the samples that each level gets.
    pub fn level_shares(&self) -> Vec<f64> {
        let least = f64::from(self.least_level_share);
        let weights: Vec<f64> = (0..self.levels()).map(|level| 0.25f64.powi(level as i32)).collect();
        let rest = (1.0 - least * weights.len() as f64) / weights.iter().sum::<f64>();
        weights.iter().map(|w| least + rest * w).collect()
    }
}
