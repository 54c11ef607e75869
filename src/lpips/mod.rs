//! LPIPS (Zhang et al. 2018), version 0.1 on AlexNet: how far apart two images are in the eyes of a trained network.
//!
//! The weights are not ours to hand out: the user names a file that `scripts/lpips_weights.py` made (`weights` says
//! what is in it). Widths and kernels are those of the file; strides, padding and pooling are AlexNet's.

mod weights;

use crate::error::Result;
use crate::srgb;
use candle_core::{Device, Tensor};
use std::path::Path;
use weights::Stage;

/// Number of stages: convolution, ReLU, and what the next one begins with.
const STAGES: usize = 5;
/// Step of the first convolution; that of the others is 1.
const FIRST_STRIDE: usize = 4;
/// Padding of the first convolution; the others keep the size.
const FIRST_PADDING: usize = 2;
/// The stages, from 0, that begin with a maximum over windows of [`POOL`], [`POOL_STRIDE`] apart.
const POOLED: [usize; 2] = [1, 2];
const POOL: usize = 3;
const POOL_STRIDE: usize = 2;
/// Mean and deviation of the images that the network was trained on, in sRGB of \[-1, 1\].
const SHIFT: [f32; 3] = [-0.030, -0.088, -0.188];
const SCALE: [f32; 3] = [0.458, 0.448, 0.450];
/// Keeps the direction of features that are all 0 defined.
const LEAST_NORM: f64 = 1e-10;

/// The network.
#[derive(Clone, Debug)]
pub struct Lpips {
    stages: Vec<Stage>,
    least_side: usize,
}

impl Lpips {
    /// Reads the weights.
    ///
    /// # Errors
    /// `File`, naming the tensor, if one is missing, has a shape that cannot be, or holds a value that is not finite.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        let stages = weights::read(path.as_ref())?;
        // What leaves one value after the last pooling.
        let first = POOLED.iter().fold(1, |side, _| (side - 1) * POOL_STRIDE + POOL);
        let kernel = stages.first().map_or(0, |stage| stage.kernel);
        let least_side = ((first - 1) * FIRST_STRIDE + kernel).saturating_sub(2 * FIRST_PADDING).max(1);
        Ok(Self { stages, least_side })
    }

    /// Least side of an image that has a value: 31 for AlexNet's first kernel of 11.
    pub fn least_side(&self) -> usize {
        self.least_side
    }

    /// LPIPS of two images of one shape (linear RGB, row by row, clamped to \[0, 1\]): 0 for equal ones. None where a
    /// side is below [`Lpips::least_side`], shapes differ or a value is no number.
    ///
    /// # Errors
    /// `Tensor` if candle refuses an operation.
    pub fn distance(
        &self,
        height: usize,
        width: usize,
        answer: &[[f32; 3]],
        reference: &[[f32; 3]],
    ) -> Result<Option<f64>> {
        let pixels = height.checked_mul(width).unwrap_or(0);
        if height.min(width) < self.least_side || [answer.len(), reference.len()] != [pixels; 2] {
            return Ok(None);
        }
        let mut values = Vec::with_capacity(6 * pixels);
        for image in [answer, reference] {
            for c in 0..3 {
                let seen = |v: f32| (2.0 * srgb::encoded(v) - 1.0 - SHIFT[c]) / SCALE[c];
                values.extend(image.iter().map(|p| seen(p[c])));
            }
        }
        // A ReLU may make a number of what is none.
        if values.iter().any(|v| v.is_nan()) {
            return Ok(None);
        }
        let mut images = Tensor::from_vec(values, (2, 3, height, width), &Device::Cpu)?;
        let mut sum = 0.0;
        for (k, stage) in self.stages.iter().enumerate() {
            if POOLED.contains(&k) {
                images = images.max_pool2d_with_stride(POOL, POOL_STRIDE)?;
            }
            let (padding, stride) =
                if k == 0 { (FIRST_PADDING, FIRST_STRIDE) } else { (stage.kernel / 2, 1) };
            images = images.conv2d(&stage.weight, padding, stride, 1, 1)?;
            images = images.broadcast_add(&stage.bias)?.relu()?;
            sum += apart(&images, &stage.linear)?;
        }
        Ok(Some(sum).filter(|sum| sum.is_finite()))
    }
}

/// The mean over places of the weighted squares by which the directions of two features differ; `features` are
/// \[2, C, H, W\].
fn apart(features: &Tensor, linear: &Tensor) -> Result<f64> {
    let norm = (features.sqr()?.sum_keepdim(1)?.sqrt()? + LEAST_NORM)?;
    let directions = features.broadcast_div(&norm)?;
    let squares = (directions.narrow(0, 0, 1)? - directions.narrow(0, 1, 1)?)?.sqr()?;
    let weighted = squares.broadcast_mul(linear)?.sum(1)?;
    Ok(f64::from(weighted.mean_all()?.to_scalar::<f32>()?))
}
