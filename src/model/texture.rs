//! Texture pyramid: the flattened tables that lookups read, their smoothing, and the trilinear wrapped fetch.

use super::inputs::{Inputs, Levels};
use super::variables::Variables;
use crate::config::Smoothing;
use crate::error::Result;
use crate::kernels::smooth;
use candle_core::{DType, Device, Tensor};
use neumip_export::config::{Architecture, OFFSET_TEXTURE, texture_name};

/// Textures as lookups read them.
#[derive(Clone)]
pub struct Tables {
    /// All pyramid levels, finest first \[texels, C\].
    pub pyramid: Tensor,
    /// Offset texture \[H * W, C\].
    pub offset: Option<Tensor>,
}

/// sigma in texels for each texture, 0 for one that is read as it is.
#[derive(Clone, Debug, PartialEq)]
pub struct Sigmas {
    /// A pyramid level each.
    pub pyramid: Vec<f64>,
    /// The offset texture.
    pub offset: f64,
}

impl Sigmas {
    /// No smoothing.
    pub fn none(architecture: &Architecture) -> Self {
        Self { pyramid: vec![0.0; architecture.levels()], offset: 0.0 }
    }

    /// The sigmas when a share `fraction` of the run is done.
    pub fn at(architecture: &Architecture, smoothing: Option<&Smoothing>, fraction: f64) -> Self {
        let Some(smoothing) = smoothing else {
            return Self::none(architecture);
        };
        let sigma = smoothing.sigma(fraction);
        let unless_small = |s: f64| if s < smoothing.skip_below { 0.0 } else { s };
        Self {
            pyramid: (0..architecture.levels()).map(|l| unless_small(sigma / f64::from(1u32 << l))).collect(),
            offset: unless_small(sigma.max(smoothing.offset_minimum)),
        }
    }
}

impl Sigmas {
    /// The sigma of a variable by name; 0 for one that is no texture.
    pub fn of(&self, name: &str) -> f64 {
        if name == OFFSET_TEXTURE {
            return self.offset;
        }
        (0..self.pyramid.len()).find(|&l| texture_name(l) == name).map_or(0.0, |l| self.pyramid[l])
    }
}

impl Tables {
    /// The tables of `variables`, smoothed. They hold no graph: smoothing is linear and [`smoothed`] its own adjoint, so
    /// a gradient of a table becomes the variable's by smoothing it once more.
    ///
    /// # Errors
    /// Whatever candle refuses.
    pub fn new(architecture: &Architecture, variables: &Variables, sigmas: &Sigmas) -> Result<Self> {
        let flat = |name: &str, sigma: f64| -> Result<Tensor> {
            let texture = smoothed(&variables.get(name)?.as_detached_tensor(), sigma)?;
            let (height, width, channels) = texture.dims3()?;
            Ok(texture.reshape((height * width, channels))?)
        };
        let levels = sigmas
            .pyramid
            .iter()
            .enumerate()
            .map(|(level, &sigma)| flat(&texture_name(level), sigma))
            .collect::<Result<Vec<_>>>()?;
        let offset = match architecture.offset_widths() {
            Some(_) => Some(flat(OFFSET_TEXTURE, sigmas.offset)?),
            None => None,
        };
        Ok(Self { pyramid: Tensor::cat(&levels, 0)?, offset })
    }
}

/// A texture \[H, W, C\] smoothed with a wrapped Gaussian of `sigma` texels; 0 gives the texture itself.
///
/// # Errors
/// Whatever candle refuses.
pub fn smoothed(texture: &Tensor, sigma: f64) -> Result<Tensor> {
    if sigma == 0.0 {
        return Ok(texture.clone());
    }
    if !texture.device().is_cpu() {
        return smoothed_by_matrices(texture, sigma);
    }
    let (height, width, channels) = texture.dims3()?;
    let values: Vec<f32> = texture.flatten_all()?.to_vec1()?;
    let out = smooth::smooth(&values, height, width, channels, sigma);
    Ok(Tensor::from_vec(out, (height, width, channels), texture.device())?)
}

/// The same by two products with circulant matrices, for devices without the kernel.
fn smoothed_by_matrices(texture: &Tensor, sigma: f64) -> Result<Tensor> {
    let (height, width, channels) = texture.dims3()?;
    let device = texture.device();
    let rows = circulant(sigma, height, device)?.matmul(&texture.reshape((height, width * channels))?)?;
    let columns_first = rows.reshape((height, width, channels))?.transpose(0, 1)?.contiguous()?;
    let columns =
        circulant(sigma, width, device)?.matmul(&columns_first.reshape((width, height * channels))?)?;
    Ok(columns.reshape((width, height, channels))?.transpose(0, 1)?.contiguous()?)
}

fn circulant(sigma: f64, n: usize, device: &Device) -> Result<Tensor> {
    let mut matrix = vec![0.0f32; n * n];
    for (offset, weight) in smooth::ring(sigma, n) {
        for i in 0..n {
            matrix[i * n + (i + offset) % n] = weight;
        }
    }
    Ok(Tensor::from_vec(matrix, (n, n), device)?)
}

/// Features \[N, C\] at positions \[N, 2\] (any finite values; they wrap), trilinear.
///
/// # Errors
/// Whatever candle refuses.
pub fn fetch(table: &Tensor, position: &Tensor, levels: &Levels) -> Result<Tensor> {
    let n = position.dims()[0];
    let x = (position.unsqueeze(1)?.broadcast_mul(&levels.size)? - 0.5)?;
    let low = x.detach().floor()?;
    let fraction = (&x - &low)?;
    let wrap = |i: &Tensor| -> Result<Tensor> {
        let turns = (i / &levels.size)?.floor()?;
        Ok((i - (turns * &levels.size)?)?.to_dtype(DType::U32)?)
    };
    let (first, second) = (wrap(&low)?, wrap(&(&low + 1.0)?)?);
    let column = |t: &Tensor| -> Result<Tensor> { Ok(t.narrow(2, 0, 1)?.squeeze(2)?) };
    let row = |t: &Tensor| -> Result<Tensor> {
        let row = t.narrow(2, 1, 1)?.squeeze(2)?;
        Ok(((row * &levels.width)? + &levels.base)?)
    };
    let (row0, row1, column0, column1) = (row(&first)?, row(&second)?, column(&first)?, column(&second)?);
    let index = Tensor::stack(
        &[(&row0 + &column0)?, (&row0 + &column1)?, (&row1 + &column0)?, (&row1 + &column1)?],
        2,
    )?;
    let (fx, fy) = (fraction.narrow(2, 0, 1)?, fraction.narrow(2, 1, 1)?);
    let (gx, gy) = (fx.affine(-1.0, 1.0)?, fy.affine(-1.0, 1.0)?);
    let weight = Tensor::cat(&[(&gx * &gy)?, (&fx * &gy)?, (&gx * &fy)?, (&fx * &fy)?], 2)?;
    let weight = weight.broadcast_mul(&levels.mix)?.reshape((n, 8, 1))?;
    gather(table, &index.flatten_all()?, &weight)
}

/// Weighted sums of table rows: indices \[N * K\], weights \[N, K, 1\] give \[N, C\].
///
/// # Errors
/// Whatever candle refuses.
pub fn gather(table: &Tensor, index: &Tensor, weight: &Tensor) -> Result<Tensor> {
    let (n, k, _) = weight.dims3()?;
    let rows = table.index_select(index, 0)?.reshape((n, k, table.dims()[1]))?;
    Ok(rows.broadcast_mul(weight)?.sum(1)?)
}

/// The offset texture at u \[N, C\], bilinear.
///
/// # Errors
/// Whatever candle refuses.
pub fn fetch_offset(table: &Tensor, inputs: &Inputs) -> Result<Option<Tensor>> {
    match &inputs.offset_taps {
        Some((index, weight)) => Ok(Some(gather(table, index, weight)?)),
        None => Ok(None),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_ways_of_smoothing_agree_and_a_changed_sigma_is_noticed() {
        const ROUNDING: f32 = 2e-6;
        let texture = Tensor::randn(0f32, 1.0, (11, 9, 3), &Device::Cpu).unwrap();
        let difference = |a: f64, b: f64| -> f32 {
            let d = (smoothed(&texture, a).unwrap() - smoothed_by_matrices(&texture, b).unwrap()).unwrap();
            d.abs().unwrap().max_all().unwrap().to_scalar().unwrap()
        };
        for sigma in [0.4, 1.03, 8.0] {
            assert!(difference(sigma, sigma) < ROUNDING);
            assert!(difference(sigma, sigma * 1.01) > ROUNDING);
        }
    }
}
