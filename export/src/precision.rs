//! How texture values are stored: 32-bit floats, or half floats that 32-bit arithmetic reads.
//!
//! Rounding makes another model, so it comes before everything else: what is written from a rounded checkpoint (graphs,
//! EXR files, golden answers, the checkpoint itself) is one model, not several that differ by a rounding.

use crate::checkpoint::Checkpoint;
use crate::config::Architecture;
use crate::error::{Error, Result};
use half::f16;
use serde::{Deserialize, Serialize};

/// Storage of texture values. Weights, biases and all arithmetic are in 32-bit floats.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Precision {
    /// 32-bit floats.
    #[serde(rename = "f32")]
    Single,
    /// 16-bit floats (IEEE 754 binary16).
    #[serde(rename = "f16")]
    Half,
}

/// How the textures of a bundle are stored, and what that costs on its golden queries:
/// |difference| / (1 + |value|) over all channels, between the answers before and after rounding.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TexturePrecision {
    /// Storage of texture values.
    pub storage: Precision,
    /// Largest difference.
    pub largest_difference: f64,
    /// Mean difference.
    pub mean_difference: f64,
}

impl Precision {
    /// Bytes of a texture value.
    pub fn bytes(self) -> usize {
        match self {
            Self::Single => 4,
            Self::Half => 2,
        }
    }

    /// Rounds every value of the pyramid and the offset texture to the nearest that is stored, ties to even.
    ///
    /// # Errors
    /// `Config`, naming the tensor that is invalid, or with a value that would become infinite.
    pub fn round(self, mut checkpoint: Checkpoint) -> Result<Checkpoint> {
        checkpoint.validate()?;
        if self == Self::Single {
            return Ok(checkpoint);
        }
        for name in textures(&checkpoint.header.architecture) {
            for value in checkpoint.tensors.get_mut(&name).into_iter().flat_map(|tensor| &mut tensor.data) {
                let rounded = f16::from_f32(*value).to_f32();
                if !rounded.is_finite() {
                    let problem = format!("{value} exceeds half floats");
                    return Err(Error::config(format!("tensor {name}"), problem));
                }
                *value = rounded;
            }
        }
        Ok(checkpoint)
    }

    /// Checks that the textures of a valid checkpoint lose nothing when they are stored.
    ///
    /// # Errors
    /// `Config`, naming the tensor that would.
    pub fn check(self, checkpoint: &Checkpoint) -> Result<()> {
        if self == Self::Single {
            return Ok(());
        }
        for name in textures(&checkpoint.header.architecture) {
            let data = &checkpoint.tensor(&name)?.data;
            if let Some(value) = data.iter().find(|v| f16::from_f32(**v).to_f32() != **v) {
                let problem = format!("{value} is not a half float: round the checkpoint first");
                return Err(Error::config(format!("tensor {name}"), problem));
            }
        }
        Ok(())
    }
}

impl TexturePrecision {
    /// Checks that the differences are finite and not negative.
    ///
    /// # Errors
    /// `Config`, naming the field.
    pub fn validate(&self) -> Result<()> {
        for (field, value) in
            [("largest_difference", self.largest_difference), ("mean_difference", self.mean_difference)]
        {
            if !(value.is_finite() && value >= 0.0) {
                let problem = format!("{value} is not a difference");
                return Err(Error::config(format!("texture_precision.{field}"), problem));
            }
        }
        Ok(())
    }
}

/// Names of the tensors that are textures: the ones with rows, columns and channels.
fn textures(architecture: &Architecture) -> impl Iterator<Item = String> {
    architecture.tensors().into_iter().filter(|(_, shape)| shape.len() == 3).map(|(name, _)| name)
}
