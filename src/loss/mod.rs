//! The loss of a batch of pieces: a sum of weighted terms, each a mean over the batch (paper, equation 2).

pub mod gradient;
pub mod remap;
#[cfg(test)]
mod tests;

use crate::config::{Term, TermKind};
use crate::error::Result;
use candle_core::{Device, Tensor};
use std::ops::Range;

/// What a batch is compared with: K pieces of side P.
pub struct Target {
    /// Reference RGB \[K, P, P, 3\].
    rgb: Tensor,
    /// 1 at the pixels of each piece that count \[K, P, P, 1\], where not all do.
    counted: Option<Tensor>,
    /// Weight of each piece \[K, 1, 1, 1\]: 0 where its level is left out of the step.
    weight: Tensor,
    /// 1 at the interior pixels of each patch's part that counts \[K, P - 2, P - 2, 1\], where P > 2.
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
    /// The counts of pieces of side `side` with the given patches.
    pub fn of(side: usize, patches: impl Iterator<Item = Patches>) -> Self {
        let mut means = Self { pixels: 0, interior: 0 };
        for Patches { side: patch, margin } in patches {
            let across = side / patch;
            means.pixels += (across * patch.saturating_sub(2 * margin)).pow(2);
            means.interior += (across * patch.saturating_sub(2 * margin + 2)).pow(2);
        }
        means
    }
}

/// The patches of a piece.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Patches {
    /// Side of each.
    pub side: usize,
    /// Pixels along the border of each that do not count.
    pub margin: usize,
}

impl Patches {
    /// True where a row or column is at least `more` pixels inside the part of its patch that counts.
    fn inside(self, x: usize, more: usize) -> bool {
        let border = self.margin + more;
        let x = x % self.side;
        x >= border && x + border < self.side
    }

    /// 1 for the pixels of a range of rows and columns that are so far inside, 0 for the others.
    fn mask(self, range: Range<usize>, more: usize, mask: &mut Vec<f32>) {
        for row in range.clone() {
            mask.extend(range.clone().map(|x| f32::from(self.inside(row, more) && self.inside(x, more))));
        }
    }
}

impl Target {
    /// The target of pieces of side `side`: RGB of all their pixels row by row, each one's patches, its weight.
    ///
    /// # Errors
    /// Whatever candle refuses.
    pub fn new(
        rgb: Vec<[f32; 3]>,
        side: usize,
        patches: &[Patches],
        weights: &[f32],
        means: Means,
        device: &Device,
    ) -> Result<Self> {
        let k = patches.len();
        let mask = |range: Range<usize>, more: usize| -> Result<Tensor> {
            let mut mask = Vec::with_capacity(k * range.len() * range.len());
            patches.iter().for_each(|patches| patches.mask(range.clone(), more, &mut mask));
            Ok(Tensor::from_vec(mask, (k, range.len(), range.len(), 1), device)?)
        };
        let cropped = patches.iter().any(|patches| patches.margin > 0);
        let interior = (side > 2 && means.interior > 0).then(|| mask(1..side - 1, 1)).transpose()?;
        Ok(Self {
            counted: cropped.then(|| mask(0..side, 0)).transpose()?,
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
            let difference = match term.kind {
                TermKind::L2Mean => {
                    // Held, so that the error is least where the residual is 0 on average and nowhere else.
                    ((&prediction - &self.rgb)? * remap::slope(&prediction.detach(), term.remap)?)?
                }
                _ => (remap::apply(&prediction, term.remap)? - remap::apply(&self.rgb, term.remap)?)?,
            };
            let counted = |errors: Tensor| match &self.counted {
                Some(mask) => errors.broadcast_mul(mask),
                None => Ok(errors),
            };
            let (errors, count) = match (term.kind, &self.interior) {
                (TermKind::L1, _) => (counted(difference.abs()?)?, 3 * self.means.pixels),
                (TermKind::L2 | TermKind::L2Mean, _) => (counted(difference.sqr()?)?, 3 * self.means.pixels),
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
