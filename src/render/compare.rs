//! How far a picture of the model is from one of the reference surface.

use crate::error::Result;
use crate::metrics::{ErrorSum, flip::flip, ssim::ssim};
use crate::query::RgbImage;
use crate::report::picture::{self, Picture};
use serde::Serialize;

/// Difference that is shown as pale yellow.
const WORST: f32 = 0.2;

/// Errors of a picture.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// Squared error of linear RGB, both clamped to \[0, 1\].
    pub mse: f64,
    /// Squared error of linear RGB.
    pub mse_linear: f64,
    /// Squared error of ln(1 + max(x, 0)).
    pub mse_log1p: f64,
    /// Of `mse`, in dB.
    pub psnr: Option<f64>,
    /// Structural similarity.
    pub ssim: Option<f64>,
    /// FLIP.
    pub flip: Option<f64>,
    /// What the reference's own noise adds to `mse_linear`: the mean variance of its pixels.
    pub noise: Option<f64>,
}

impl Comparison {
    /// Compares pictures of one size; `noise` is the mean variance of the reference's pixels.
    pub fn new(answer: &RgbImage, reference: &RgbImage, noise: Option<f64>) -> Self {
        let (height, width) = (reference.height, reference.width);
        let mut sum = ErrorSum::default();
        sum.add(&answer.pixels, &reference.pixels);
        let errors = sum.errors();
        Self {
            mse: errors.mse,
            mse_linear: errors.mse_linear,
            mse_log1p: errors.mse_log1p,
            psnr: errors.psnr(),
            ssim: ssim(height, width, &answer.pixels, &reference.pixels),
            flip: flip(height, width, &answer.pixels, &reference.pixels),
            noise,
        }
    }

    /// The mean over frames; what some frame has not, the mean has not.
    pub fn mean(frames: &[Self]) -> Option<Self> {
        let of = |value: fn(&Self) -> Option<f64>| {
            let values: Option<Vec<f64>> = frames.iter().map(value).collect();
            values.map(|values| values.iter().sum::<f64>() / values.len() as f64)
        };
        (!frames.is_empty()).then(|| Self {
            mse: of(|c| Some(c.mse)).unwrap_or_default(),
            mse_linear: of(|c| Some(c.mse_linear)).unwrap_or_default(),
            mse_log1p: of(|c| Some(c.mse_log1p)).unwrap_or_default(),
            psnr: of(|c| c.psnr),
            ssim: of(|c| c.ssim),
            flip: of(|c| c.flip),
            noise: of(|c| c.noise),
        })
    }
}

/// Model, reference and their difference side by side.
///
/// # Errors
/// `Config` if the pictures differ in size or are too large.
pub fn side_by_side(answer: &RgbImage, reference: &RgbImage, stops: f32) -> Result<Picture> {
    let difference = picture::difference(answer, reference, WORST)?;
    picture::sheet(&[vec![picture::srgb(answer, stops)?, picture::srgb(reference, stops)?, difference]])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_are_of_what_all_frames_have() {
        let grey = |v: f32| RgbImage { height: 16, width: 16, pixels: vec![[v; 3]; 256] };
        let a = Comparison::new(&grey(0.5), &grey(0.4), Some(1e-4));
        let b = Comparison::new(&grey(0.4), &grey(0.4), Some(3e-4));
        assert!((a.mse - 0.01).abs() < 1e-8 && b.psnr.is_none() && a.flip.unwrap() > b.flip.unwrap());
        let mean = Comparison::mean(&[a, b]).unwrap();
        assert!((mean.mse - 0.005).abs() < 1e-8 && mean.psnr.is_none());
        assert!((mean.noise.unwrap() - 2e-4).abs() < 1e-12);
        assert!(Comparison::mean(&[]).is_none());
    }
}
