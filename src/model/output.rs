//! From the decoder's outputs to RGB.

use crate::error::Result;
use candle_core::Tensor;
use neumip_export::config::{OutputConfig, OutputSpace, OutputTransform, YUV_TO_RGB};

/// RGB \[N, 3\] from outputs \[N, 3 or 6\], not clamped.
///
/// # Errors
/// Whatever candle refuses.
pub fn rgb(outputs: &Tensor, config: &OutputConfig) -> Result<Tensor> {
    let mut rgb = outputs.narrow(1, 0, 3)?.contiguous()?;
    if config.space == OutputSpace::Yuv {
        let columns: Vec<f32> = (0..9).map(|k| YUV_TO_RGB[k % 3][k / 3]).collect();
        rgb = rgb.matmul(&Tensor::from_vec(columns, (3, 3), outputs.device())?)?;
    }
    if config.transform == OutputTransform::ExpMinusOne {
        rgb = (rgb.exp()? - 1.0)?;
    }
    if config.mask {
        let mask = (candle_nn::ops::sigmoid(&outputs.narrow(1, 3, 3)?.contiguous()?)? + 0.1)?;
        rgb = (rgb * mask)?;
    }
    Ok(rgb)
}
