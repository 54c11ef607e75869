//! How the numbers of a bundle are stored: 32-bit floats, or smaller ones that 32-bit arithmetic reads.
//!
//! Rounding makes another model, so it comes before everything else: what is written from a rounded checkpoint (graphs,
//! EXR files, weights, golden answers, the checkpoint itself) is one model, not several that differ by a rounding.

use crate::checkpoint::Checkpoint;
use crate::config::Architecture;
use crate::error::{Error, Result};
use crate::tensors::Tensor;
use half::f16;
use serde::{Deserialize, Serialize};

/// Storage of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Precision {
    /// 32-bit floats.
    #[serde(rename = "f32")]
    Single,
    /// 16-bit floats (IEEE 754 binary16).
    #[serde(rename = "f16")]
    Half,
    /// 8-bit integers from -127 to 127 times one factor for each channel of a texture, over all its levels. Factors have
    /// four significant bits, so that every value is a half float too and EXR files hold it exactly.
    #[serde(rename = "i8")]
    Byte,
}

/// Largest integer of [`Precision::Byte`].
const LARGEST: f32 = 127.0;
/// Steps between two powers of two that the factors of [`Precision::Byte`] take: four significant bits.
const STEPS: f32 = 8.0;

/// How texture values and weights are stored. All arithmetic is in 32-bit floats.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Storage {
    /// Values of the pyramid and the offset texture.
    pub textures: Precision,
    /// Weights and biases of the networks.
    pub weights: Precision,
}

/// How a bundle is stored, and what that costs on its golden queries: |difference| / (1 + |value|) over all channels,
/// between the answers before and after rounding.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rounding {
    /// Storage of all numbers.
    pub storage: Storage,
    /// Largest difference.
    pub largest_difference: f64,
    /// Mean difference.
    pub mean_difference: f64,
}

impl Precision {
    /// Bytes of a number.
    pub fn bytes(self) -> usize {
        match self {
            Self::Single => 4,
            Self::Half => 2,
            Self::Byte => 1,
        }
    }
}

impl Storage {
    /// Everything as it was trained.
    pub const SINGLE: Self = Self { textures: Precision::Single, weights: Precision::Single };
    /// Textures in half floats.
    pub const HALF_TEXTURES: Self = Self { textures: Precision::Half, weights: Precision::Single };
    /// Everything in half floats.
    pub const HALF: Self = Self { textures: Precision::Half, weights: Precision::Half };
    /// Textures in bytes; the weights, few and sensitive, in half floats.
    pub const BYTE: Self = Self { textures: Precision::Byte, weights: Precision::Half };

    /// Rounds every number to the nearest that is stored, ties to even.
    ///
    /// # Errors
    /// `Config`, naming the tensor that is invalid, or with a value that would become infinite.
    pub fn round(self, mut checkpoint: Checkpoint) -> Result<Checkpoint> {
        checkpoint.validate()?;
        self.validate()?;
        for (textures, precision) in [(true, self.textures), (false, self.weights)] {
            for group in groups(&checkpoint.header.architecture, textures) {
                match precision {
                    Precision::Single => {}
                    Precision::Half => round_halfs(&mut checkpoint, &group)?,
                    Precision::Byte => round_bytes(&mut checkpoint, &group)?,
                }
            }
        }
        Ok(checkpoint)
    }

    /// Checks that a valid checkpoint loses nothing when it is stored.
    ///
    /// # Errors
    /// `Config`, naming the tensor that would.
    pub fn check(self, checkpoint: &Checkpoint) -> Result<()> {
        self.validate()?;
        for (textures, precision) in [(true, self.textures), (false, self.weights)] {
            for group in groups(&checkpoint.header.architecture, textures) {
                match precision {
                    Precision::Single => {}
                    Precision::Half => check_halfs(checkpoint, &group)?,
                    Precision::Byte => drop(byte_factors(checkpoint, &group)?),
                }
            }
        }
        Ok(())
    }

    /// Checks that networks are not in bytes, which no texture's channel gives a factor to.
    ///
    /// # Errors
    /// `Config`, naming the field.
    pub fn validate(self) -> Result<()> {
        match self.weights {
            Precision::Byte => Err(Error::config("storage.weights", "weights are stored as f32 or f16")),
            _ => Ok(()),
        }
    }
}

impl Rounding {
    /// Checks that the differences are finite and not negative.
    ///
    /// # Errors
    /// `Config`, naming the field.
    pub fn validate(&self) -> Result<()> {
        self.storage.validate()?;
        for (field, value) in
            [("largest_difference", self.largest_difference), ("mean_difference", self.mean_difference)]
        {
            if !(value.is_finite() && value >= 0.0) {
                let problem = format!("{value} is not a difference");
                return Err(Error::config(format!("rounding.{field}"), problem));
            }
        }
        Ok(())
    }
}

/// The factors that turn the bytes of a texture's channels into values, where all its values are such.
///
/// # Errors
/// `Config`, naming the tensor with a value that is none.
pub(crate) fn byte_factors(checkpoint: &Checkpoint, levels: &[String]) -> Result<Vec<f32>> {
    let mut factors = Vec::new();
    for channel in 0..channels(checkpoint, levels)? {
        let least = factor(largest(checkpoint, levels, channel)?);
        // Rounding may have brought the largest value just under what asks for this factor.
        let next = factor((least + least / STEPS / 2.0) * LARGEST);
        let mut found = Err(Error::config("texture", "has no levels"));
        for candidate in [least, next] {
            found = match not_a_byte(checkpoint, levels, channel, candidate)? {
                None => Ok(candidate),
                Some((name, value)) => {
                    let problem = format!("{value} is not a byte times a factor: round the checkpoint first");
                    Err(Error::config(format!("tensor {name}"), problem))
                }
            };
            if found.is_ok() {
                break;
            }
        }
        factors.push(found?);
    }
    Ok(factors)
}

/// The bytes of a tensor, channel by channel over the factor.
pub(crate) fn bytes_of<'a>(data: &'a [f32], factors: &'a [f32]) -> impl Iterator<Item = i8> + 'a {
    data.iter().zip(factors.iter().cycle()).map(|(value, factor)| (value / factor) as i8)
}

/// The least factor of [`STEPS`] to a power of two whose bytes reach a value.
fn factor(largest: f32) -> f32 {
    // Below it factors would lose bits to underflow, in half floats too.
    const SMALLEST: f32 = 1.0 / (1 << 20) as f32;
    let exact = (largest / LARGEST).max(SMALLEST);
    let power = exact.log2().floor().exp2();
    let step = power / STEPS;
    (exact / step).ceil() * step
}

fn not_a_byte<'a>(
    checkpoint: &Checkpoint,
    levels: &'a [String],
    channel: usize,
    factor: f32,
) -> Result<Option<(&'a String, f32)>> {
    for name in levels {
        let wrong = of_channel(checkpoint.tensor(name)?, channel).find(|value| {
            let byte = value / factor;
            byte != byte.trunc() || byte.abs() > LARGEST
        });
        if let Some(value) = wrong {
            return Ok(Some((name, value)));
        }
    }
    Ok(None)
}

fn round_bytes(checkpoint: &mut Checkpoint, levels: &[String]) -> Result<()> {
    for channel in 0..channels(checkpoint, levels)? {
        let factor = factor(largest(checkpoint, levels, channel)?);
        for name in levels {
            let Some(tensor) = checkpoint.tensors.get_mut(name) else { continue };
            let channels = tensor.shape.last().copied().unwrap_or(1);
            for value in tensor.data.iter_mut().skip(channel).step_by(channels) {
                *value = (*value / factor).round_ties_even() * factor;
            }
        }
        if f16::from_f32(factor * LARGEST).is_infinite() {
            let problem = format!("{} exceeds half floats", factor * LARGEST);
            return Err(Error::config(format!("tensor {}", levels[0]), problem));
        }
    }
    Ok(())
}

fn round_halfs(checkpoint: &mut Checkpoint, names: &[String]) -> Result<()> {
    for name in names {
        for value in checkpoint.tensors.get_mut(name).into_iter().flat_map(|tensor| &mut tensor.data) {
            let rounded = f16::from_f32(*value).to_f32();
            if !rounded.is_finite() {
                return Err(Error::config(format!("tensor {name}"), format!("{value} exceeds half floats")));
            }
            *value = rounded;
        }
    }
    Ok(())
}

fn check_halfs(checkpoint: &Checkpoint, names: &[String]) -> Result<()> {
    for name in names {
        let data = &checkpoint.tensor(name)?.data;
        if let Some(value) = data.iter().find(|v| f16::from_f32(**v).to_f32() != **v) {
            let problem = format!("{value} is not a half float: round the checkpoint first");
            return Err(Error::config(format!("tensor {name}"), problem));
        }
    }
    Ok(())
}

fn channels(checkpoint: &Checkpoint, levels: &[String]) -> Result<usize> {
    let first = levels.first().ok_or_else(|| Error::config("texture", "has no levels"))?;
    Ok(checkpoint.tensor(first)?.shape.last().copied().unwrap_or(1))
}

fn largest(checkpoint: &Checkpoint, levels: &[String], channel: usize) -> Result<f32> {
    let mut largest = 0.0f32;
    for name in levels {
        largest = of_channel(checkpoint.tensor(name)?, channel).fold(largest, |m, v| m.max(v.abs()));
    }
    Ok(largest)
}

fn of_channel(tensor: &Tensor, channel: usize) -> impl Iterator<Item = f32> {
    let channels = tensor.shape.last().copied().unwrap_or(1).max(1);
    tensor.data.iter().skip(channel).step_by(channels).copied()
}

/// Names of the tensors that are textures (the ones with rows, columns and channels), texture by texture; or of all others.
fn groups(architecture: &Architecture, textures: bool) -> Vec<Vec<String>> {
    let named = architecture.tensors().into_iter().filter(|(_, shape)| (shape.len() == 3) == textures);
    let (pyramid, rest): (Vec<String>, Vec<String>) =
        named.map(|(name, _)| name).partition(|name| textures && name.starts_with("texture."));
    [pyramid, rest].into_iter().filter(|group| !group.is_empty()).collect()
}
