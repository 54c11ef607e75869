//! Parallax: where a view ray that meets the plane at u looks up the pyramid (NeuMIP's neural offset).

use super::decoder::Mlp;
use super::inputs::Inputs;
use super::texture::{self, Tables};
use crate::error::Result;
use candle_core::Tensor;
use neumip_export::config::ParallaxConfig;

/// u' = u + 0.5 r wo.xy / max(wo.z, min_z) with r = scale * MLP(texture(u), wo.xy): positions \[N, 2\].
///
/// # Errors
/// Whatever candle refuses.
pub fn shifted(
    config: &ParallaxConfig,
    mlp: Option<&Mlp>,
    inputs: &Inputs,
    tables: &Tables,
) -> Result<Tensor> {
    let (ParallaxConfig::Offset(offset), Some(mlp), Some(shift), Some(table)) =
        (config, mlp, &inputs.shift, &tables.offset)
    else {
        return Ok(inputs.u.clone());
    };
    let Some(features) = texture::fetch_offset(table, inputs)? else {
        return Ok(inputs.u.clone());
    };
    let r = mlp.forward(&Tensor::cat(&[&features, &inputs.wo], 1)?)?;
    Ok((&inputs.u + shift.broadcast_mul(&(r * f64::from(offset.scale))?)?)?)
}
