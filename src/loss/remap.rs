//! Output remapping (paper, section 3.2): what the losses see instead of linear radiance.

use crate::config::Remap;
use crate::error::Result;
use candle_core::Tensor;

/// Least value under the guarded 4th root (authors' code).
const GUARD: f32 = 1e-7;
/// Least value under log1p (NeuMIP's code).
const LOG_FLOOR: f32 = -0.1;

/// The remapped image.
///
/// # Errors
/// Whatever candle refuses.
pub fn apply(x: &Tensor, remap: Remap) -> Result<Tensor> {
    Ok(match remap {
        Remap::Linear => x.clone(),
        Remap::Root4Literal => x.powf(0.25)?,
        Remap::Root4Guarded => x.maximum(GUARD)?.sqrt()?.sqrt()?,
        Remap::Root4Signed(epsilon) => signed(x, epsilon, |x| Ok(x.sqrt()?.sqrt()?), epsilon.powf(0.25))?,
        Remap::Sqrt(epsilon) => signed(x, epsilon, |x| Ok(x.sqrt()?), epsilon.sqrt())?,
        Remap::Log => (x.maximum(LOG_FLOOR)? + 1.0)?.log()?,
    })
}

/// The slope of [`apply`] at x; past a guard, the slope at it.
///
/// # Errors
/// Whatever candle refuses.
pub fn slope(x: &Tensor, remap: Remap) -> Result<Tensor> {
    let root4 = |x: Tensor| -> Result<Tensor> {
        let half = x.sqrt()?;
        Ok(((&half * half.sqrt()?)?.recip()? * 0.25)?)
    };
    match remap {
        Remap::Linear => Ok(x.ones_like()?),
        Remap::Root4Literal => root4(x.clone()),
        Remap::Root4Guarded => root4(x.maximum(GUARD)?),
        Remap::Root4Signed(epsilon) => root4((x.abs()? + epsilon)?),
        Remap::Sqrt(epsilon) => Ok(((x.abs()? + epsilon)?.sqrt()?.recip()? * 0.5)?),
        Remap::Log => Ok((x.maximum(LOG_FLOOR)? + 1.0)?.recip()?),
    }
}

/// sign(x) (root(|x| + epsilon) - root(epsilon)): odd, with a finite slope at 0.
fn signed(
    x: &Tensor,
    epsilon: f64,
    root: impl Fn(&Tensor) -> Result<Tensor>,
    at_zero: f64,
) -> Result<Tensor> {
    // sign has gradient 0 in candle, and abs +1 at 0, where sign is 0: the product's gradient is right but at 0 itself.
    let magnitude = (root(&(x.abs()? + epsilon)?)? - at_zero)?;
    Ok((magnitude * x.sign()?)?)
}
