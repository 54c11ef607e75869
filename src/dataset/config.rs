//! What to generate.

use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::{fmt, str::FromStr};

/// Directions of the training data.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Regime {
    /// A pair of directions a patch, positions and levels between the texels' too.
    Scattered,
    /// This many pairs, a full aligned image each, at every level.
    Slices(usize),
}

impl fmt::Display for Regime {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Scattered => f.write_str("scattered"),
            Self::Slices(pairs) => write!(f, "slices-{pairs}"),
        }
    }
}

impl FromStr for Regime {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        if text == "scattered" {
            return Ok(Self::Scattered);
        }
        let pairs = text.strip_prefix("slices-").and_then(|n| n.parse().ok());
        pairs
            .map(Self::Slices)
            .ok_or_else(|| Error::config("regime", format!("{text} is neither scattered nor slices-N")))
    }
}

impl TryFrom<String> for Regime {
    type Error = Error;

    fn try_from(text: String) -> Result<Self> {
        text.parse()
    }
}

impl From<Regime> for String {
    fn from(regime: Regime) -> Self {
        regime.to_string()
    }
}

/// What to generate: everything that the bytes of a dataset depend on, besides the material.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GenerateConfig {
    /// Texels along a side of the tile: a power of two from 4 to 4096.
    pub resolution: usize,
    /// Directions of the training data.
    pub regime: Regime,
    /// Unique training samples, rounded up to whole blocks; `slices-N` follows from N instead.
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
    /// Sub-samples of a training sample.
    pub spp: usize,
    /// Sub-samples of every other sample.
    pub held_out_spp: usize,
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
/// Names of files have five digits.
pub(crate) const MAX_FILES: usize = 100_000;

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
            block_side: resolution.min(32),
            file_samples: 1 << 20,
            spp: 16,
            held_out_spp: 64,
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
        if let Regime::Slices(pairs) = self.regime {
            within("regime (pairs of slices)", pairs, 2, 1 << 20)?;
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
        within("fractional_share", self.fractional_share, 0.0, 1.0)?;
        within("least_level_share", self.least_level_share, 0.0, 1.0 / self.levels() as f32)
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
