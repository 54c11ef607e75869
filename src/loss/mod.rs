//! The loss of a batch of pieces: a sum of weighted terms, each a mean over the batch (paper, equation 2).

pub mod gradient;
pub mod remap;
#[cfg(test)]
mod tests;

use crate::config::{Term, TermKind};
use crate::error::Result;
use candle_core::{Device, Tensor};

/// What a batch is compared with: K pieces of side P.
pub struct Target {
    /// Reference RGB \[K, P, P, 3\].
    rgb: Tensor,
    /// Weight of each piece \[K, 1, 1, 1\]: 0 where its level is left out of the step.
    weight: Tensor,
    /// 1 at the interior pixels of each patch \[K, P - 2, P - 2, 1\], where P > 2.
    interior: Option<Tensor>,
    means: Means,
}

/// What sums are divided by: counts over the whole batch, of which a target may be a part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Means {
    /// Pixels.
    pub pixels: usize,
    /// Interior pixels of patches.
    pub interior: usize,
}

impl Means {
    /// The counts of pieces of side `side` with the given patch sides.
    pub fn of(side: usize, patches: impl Iterator<Item = usize>) -> Self {
        let mut means = Self { pixels: 0, interior: 0 };
        for patch in patches {
            means.pixels += side * side;
            means.interior += (side / patch * patch.saturating_sub(2)).pow(2);
        }
        means
    }
}

impl Target {
    /// The target of pieces of side `side`: RGB of all their pixels row by row, the side of each one's patches, its weight.
    ///
    /// # Errors
    /// Whatever candle refuses.
    pub fn new(
        rgb: Vec<[f32; 3]>,
        side: usize,
        patches: &[usize],
        weights: &[f32],
        means: Means,
        device: &Device,
    ) -> Result<Self> {
        let k = patches.len();
        let interior =
            if side > 2 && means.interior > 0 {
                let inside = |x: usize, patch: usize| (1..patch - 1).contains(&(x % patch));
                let mut mask = Vec::with_capacity(k * (side - 2) * (side - 2));
                for &patch in patches {
                    for row in 1..side - 1 {
                        mask.extend((1..side - 1).map(|column| {
                            f32::from(patch > 2 && inside(row, patch) && inside(column, patch))
                        }));
                    }
                }
                Some(Tensor::from_vec(mask, (k, side - 2, side - 2, 1), device)?)
            } else {
                None
            };
        Ok(Self {
            rgb: Tensor::from_vec(rgb.into_flattened(), (k, side, side, 3), device)?,
            weight: Tensor::from_slice(weights, (k, 1, 1, 1), device)?,
            interior,
            means,
        })
    }

    /// The loss of a prediction \[K * P * P, 3\] under `terms`: a scalar, this part's share of the batch's mean.
    ///
    /// # Errors
    /// Whatever candle refuses.
    pub fn loss(&self, prediction: &Tensor, terms: &[Term]) -> Result<Tensor> {
        let prediction = prediction.reshape(self.rgb.shape())?;
        let mut total: Option<Tensor> = None;
        for term in terms {
            let difference = (remap::apply(&prediction, term.remap)? - remap::apply(&self.rgb, term.remap)?)?;
            let (errors, count) = match (term.kind, &self.interior) {
                (TermKind::L1, _) => (difference.abs()?, 3 * self.means.pixels),
                (TermKind::L2, _) => (difference.sqr()?, 3 * self.means.pixels),
                (TermKind::Gradient, Some(mask)) => {
                    (gradient::squared(&difference)?.broadcast_mul(mask)?, 3 * self.means.interior)
                }
                (TermKind::GradientLuma, Some(mask)) => {
                    (gradient::absolute_luma(&difference)?.broadcast_mul(mask)?, self.means.interior)
                }
                (TermKind::Gradient | TermKind::GradientLuma, None) => continue,
            };
            let value = (errors.broadcast_mul(&self.weight)?.sum_all()? * (term.weight / count as f64))?;
            total = Some(match total {
                Some(sum) => (sum + value)?,
                None => value,
            });
        }
        match total {
            Some(total) => Ok(total),
            None => Ok((prediction.sum_all()? * 0.0)?),
        }
    }
}
