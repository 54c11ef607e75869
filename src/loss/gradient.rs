//! Gradient loss (paper, equation 1): Sobel responses of the difference of two images.
//!
//! Sobel is linear, so one pass over the difference of the remapped images serves for both.

use crate::error::Result;
use candle_core::Tensor;

/// Rec. 601 luma.
const LUMA: [f32; 3] = [0.299, 0.587, 0.114];

/// Sobel-x and Sobel-y responses \[K, H - 2, W - 2, C\] of images \[K, H, W, C\], with the kernels as printed.
fn sobel(images: &Tensor) -> Result<(Tensor, Tensor)> {
    let part = |t: &Tensor, axis: usize, start: usize| t.narrow(axis, start, t.dims()[axis] - 2);
    let across = |t: &Tensor, axis: usize| part(t, axis, 0)? - part(t, axis, 2)?;
    let along =
        |t: &Tensor, axis: usize| (part(t, axis, 0)? + (part(t, axis, 1)? * 2.0)?)? + part(t, axis, 2)?;
    Ok((along(&across(images, 2)?, 1)?, along(&across(images, 1)?, 2)?))
}

/// G_x^2 + G_y^2 of the difference \[K, H - 2, W - 2, C\].
///
/// # Errors
/// Whatever candle refuses.
pub fn squared(difference: &Tensor) -> Result<Tensor> {
    let (x, y) = sobel(difference)?;
    Ok((x.sqr()? + y.sqr()?)?)
}

/// |G_x| + |G_y| of luma with kernels of half strength \[K, H - 2, W - 2, 1\] (authors' code).
///
/// # Errors
/// Whatever candle refuses.
pub fn absolute_luma(difference: &Tensor) -> Result<Tensor> {
    let weights = Tensor::new(&LUMA, difference.device())?;
    let luma = difference.broadcast_mul(&weights)?.sum_keepdim(3)?;
    let (x, y) = sobel(&luma)?;
    Ok(((x.abs()? + y.abs()?)? * 0.5)?)
}
