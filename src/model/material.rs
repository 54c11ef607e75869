//! A trained model that answers query buffers through candle.

use super::texture::{Sigmas, Tables};
use super::{Inputs, Networks, Variables};
use crate::error::{Error, Result};
use crate::query::grid::{self, Mosaic};
use crate::query::{QueryBuffer, Reflectance, RgbImage, Support, above_horizon};
use candle_core::Device;
use neumip_export::checkpoint::Checkpoint;
use neumip_export::config::Architecture;
use rayon::prelude::*;

/// Queries answered at once: every intermediate tensor stays in a core's cache, and under the size from which candle
/// itself splits elementwise work over threads (these chunks are already spread over the cores).
const CHUNK: usize = 1024;

/// A neural material in candle.
pub struct NeuralMaterial {
    networks: Networks,
    tables: Tables,
    device: Device,
}

impl NeuralMaterial {
    /// The material of a checkpoint.
    ///
    /// # Errors
    /// `Config` if a tensor does not fit the architecture.
    pub fn from_checkpoint(checkpoint: &Checkpoint, device: &Device) -> Result<Self> {
        let architecture = &checkpoint.header.architecture;
        let variables = Variables::from_stored(architecture, &checkpoint.tensors, device)?;
        let tables = Tables::new(architecture, &variables, &Sigmas::none(architecture))?;
        Ok(Self { networks: Networks::detached(architecture, &variables)?, tables, device: device.clone() })
    }

    /// What the material is.
    pub fn architecture(&self) -> &Architecture {
        &self.networks.architecture
    }

    /// The answers to images of queries, each taken as periodic.
    ///
    /// # Errors
    /// Whatever candle refuses.
    pub fn images(&self, queries: &QueryBuffer, images: Mosaic) -> Result<Vec<[f32; 3]>> {
        let mut pixels = vec![[0.0f32; 3]; queries.len()];
        self.answer(queries, 0, Some(images), &mut pixels)?;
        Ok(pixels)
    }

    fn answer(
        &self,
        queries: &QueryBuffer,
        start: usize,
        images: Option<Mosaic>,
        out: &mut [[f32; 3]],
    ) -> Result<()> {
        let part = start..start + out.len();
        let (wi, wo) = (&queries.wi[part.clone()], &queries.wo[part.clone()]);
        let (u, level) = (&queries.u[part.clone()], &queries.level[part]);
        let inputs = Inputs::new(self.architecture(), u, wi, wo, level, &self.device)?;
        let inputs = Inputs { images, ..inputs };
        let rgb: Vec<f32> = self.networks.forward(&inputs, &self.tables)?.flatten_all()?.to_vec1()?;
        for (k, pixel) in out.iter_mut().enumerate() {
            if above_horizon(wi[k]) && above_horizon(wo[k]) {
                // f32::max would hide a NaN behind 0.
                *pixel = std::array::from_fn(|c| {
                    let value = rgb[3 * k + c];
                    if value < 0.0 { 0.0 } else { value }
                });
            }
        }
        Ok(())
    }
}

impl Reflectance for NeuralMaterial {
    fn support(&self) -> Support {
        Support::of(self.architecture().neighbourhood(), self.architecture().resolution)
    }

    fn evaluate(&self, queries: &QueryBuffer) -> Result<RgbImage> {
        let pixels = match self.support() {
            Support::Pointwise => {
                let mut pixels = vec![[0.0f32; 3]; queries.len()];
                let chunks = pixels.par_chunks_mut(CHUNK).enumerate();
                chunks.try_for_each(|(chunk, out)| self.answer(queries, chunk * CHUNK, None, out))?;
                pixels
            }
            Support::Neighbourhood { radius, resolution } => {
                grid::answer(queries, radius, resolution, &|images, mosaic| self.images(images, mosaic))?
            }
        };
        match pixels.iter().position(|p| !p.iter().all(|v| v.is_finite())) {
            Some(k) => Err(Error::config(format!("query[{k}]"), "the model's answer is not finite")),
            None => Ok(RgbImage { height: queries.height(), width: queries.width(), pixels }),
        }
    }
}
