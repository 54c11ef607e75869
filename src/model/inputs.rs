//! What the networks read of a batch of queries: everything that does not depend on a parameter is computed here once,
//! on the host, by the kernels.

use crate::error::Result;
use crate::kernels::{encoding, taps};
use crate::query::grid::Mosaic;
use crate::query::unit;
use candle_core::{Device, Tensor};
use neumip_export::config::{Architecture, DirectionEncoding, ParallaxConfig};

/// N queries on the device.
pub struct Inputs {
    /// Wrapped position \[N, 2\].
    pub u: Tensor,
    /// View direction \[N, 2\].
    pub wo: Tensor,
    /// 0.5 wo.xy / max(wo.z, min_z) \[N, 2\], where the model has an offset.
    pub shift: Option<Tensor>,
    /// Lookup of the offset texture at u: texel indices \[4 N\] and weights \[N, 4, 1\].
    pub offset_taps: Option<(Tensor, Tensor)>,
    /// gamma(u), gamma(wi), gamma(wo) \[N, E\].
    pub encoding: Option<Tensor>,
    /// Pyramid levels of each query.
    pub levels: Levels,
    /// How the queries are laid out, where a decoder reads images.
    pub images: Option<Mosaic>,
}

/// The two pyramid levels that each query reads.
pub struct Levels {
    /// Columns and rows of the finer and of the coarser level \[N, 2 levels, 2\], f32.
    pub size: Tensor,
    /// Columns \[N, 2\], u32.
    pub width: Tensor,
    /// First row of the level in the table \[N, 2\], u32.
    pub base: Tensor,
    /// Weights of the two levels \[N, 2, 1\].
    pub mix: Tensor,
}

impl Inputs {
    /// Prepares N queries (slices of equal length).
    ///
    /// # Errors
    /// Whatever candle refuses.
    pub fn new(
        architecture: &Architecture,
        u: &[[f32; 2]],
        wi: &[[f32; 2]],
        wo: &[[f32; 2]],
        level: &[f32],
        device: &Device,
    ) -> Result<Self> {
        let n = u.len();
        let [height, width] = architecture.finest_size();
        let coarsest = architecture.coarsest() as f32;
        let guide = architecture.guide();
        let places = u.iter().zip(level).map(|(&u, &level)| {
            let (u, level) = guide.map_or((u, level), |guide| guide.lead(u, level));
            (taps::wrap(u), level.clamp(0.0, coarsest))
        });
        let (wrapped, level): (Vec<[f32; 2]>, Vec<f32>) = places.unzip();

        let (mut shift, mut offset_taps) = (None, None);
        if let ParallaxConfig::Offset(offset) = &architecture.model.parallax {
            let slope: Vec<f32> = wo
                .iter()
                .flat_map(|&wo| {
                    let scale = 0.5 / unit(wo)[2].max(offset.min_z);
                    [scale * wo[0], scale * wo[1]]
                })
                .collect();
            shift = Some(Tensor::from_vec(slope, (n, 2), device)?);
            let (mut index, mut weight) = (Vec::with_capacity(4 * n), Vec::with_capacity(4 * n));
            for &u in &wrapped {
                taps::bilinear(u, height, width, &mut index, &mut weight);
            }
            offset_taps =
                Some((Tensor::from_vec(index, 4 * n, device)?, Tensor::from_vec(weight, (n, 4, 1), device)?));
        }
        Ok(Self {
            encoding: encode(architecture, &wrapped, wi, wo, &level, device)?,
            levels: Levels::new(architecture, &level, device)?,
            u: pairs(&wrapped, device)?,
            wo: pairs(wo, device)?,
            shift,
            offset_taps,
            images: None,
        })
    }

    /// The same queries as images of one size.
    pub fn as_images(self, images: Mosaic) -> Self {
        Self { images: Some(images), ..self }
    }

    /// Number of queries.
    pub fn len(&self) -> usize {
        self.u.dims()[0]
    }

    /// True if there is no query.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

impl Levels {
    fn new(architecture: &Architecture, level: &[f32], device: &Device) -> Result<Self> {
        let sizes = architecture.level_sizes();
        let finest = architecture.model.texture.finest as f32;
        let n = level.len();
        let (mut size, mut width) = (Vec::with_capacity(4 * n), Vec::with_capacity(2 * n));
        let (mut base, mut mix) = (Vec::with_capacity(2 * n), Vec::with_capacity(2 * n));
        for &level in level {
            let level = (level - finest).max(0.0);
            let finer = level.floor();
            let coarse_share = level - finer;
            let finer = finer as usize;
            let coarser = (finer + 1).min(sizes.len() - 1);
            for (index, weight) in [(finer, 1.0 - coarse_share), (coarser, coarse_share)] {
                let s = sizes[index];
                size.extend([s.width as f32, s.height as f32]);
                width.push(s.width as u32);
                base.push(s.base as u32);
                mix.push(weight);
            }
        }
        Ok(Self {
            size: Tensor::from_vec(size, (n, 2, 2), device)?,
            width: Tensor::from_vec(width, (n, 2), device)?,
            base: Tensor::from_vec(base, (n, 2), device)?,
            mix: Tensor::from_vec(mix, (n, 2, 1), device)?,
        })
    }
}

fn pairs(values: &[[f32; 2]], device: &Device) -> Result<Tensor> {
    Ok(Tensor::from_slice(values.as_flattened(), (values.len(), 2), device)?)
}

fn encode(
    architecture: &Architecture,
    u: &[[f32; 2]],
    wi: &[[f32; 2]],
    wo: &[[f32; 2]],
    level: &[f32],
    device: &Device,
) -> Result<Option<Tensor>> {
    let inputs = architecture.encoding_inputs();
    if inputs == 0 {
        return Ok(None);
    }
    let config = &architecture.model.encoding;
    let [height, width] = architecture.resolution;
    let bands = architecture.u_bands();
    let direction = |out: &mut Vec<f32>, w: [f32; 2], encoding: &DirectionEncoding| {
        let full = unit(w);
        if config.components == 3 {
            encoding::encode(out, full, encoding.bands, config.pi, |_, _| encoding.amplitude);
        } else {
            encoding::encode(out, w, encoding.bands, config.pi, |_, _| encoding.amplitude);
        }
        if encoding.raw {
            out.extend_from_slice(&full[..config.components]);
        }
    };
    // Neighbouring queries mostly share their level and directions: what follows from those is kept for the next one.
    let mut attenuation = Remembered::default();
    let (mut light, mut view) = (Remembered::default(), Remembered::default());
    let mut out = Vec::with_capacity(inputs * u.len());
    for (((&u, &wi), &wo), &level) in u.iter().zip(wi).zip(wo).zip(level) {
        let p = [2.0 * u[0] - 1.0, 2.0 * u[1] - 1.0];
        if config.u.attenuate {
            let factors = attenuation.get([level, 0.0], |out| {
                let sigma = [width, height].map(|texels| encoding::footprint_sigma(level, texels));
                out.extend((0..2 * bands).map(|i| encoding::attenuation(i / 2, config.pi, sigma[i % 2])));
            });
            encoding::encode(&mut out, p, bands, config.pi, |k, d| factors[2 * k + d]);
        } else {
            encoding::encode(&mut out, p, bands, config.pi, |_, _| 1.0);
        }
        if config.u.raw {
            out.extend(p);
        }
        out.extend_from_slice(light.get(wi, |out| direction(out, wi, &config.wi)));
        out.extend_from_slice(view.get(wo, |out| direction(out, wo, &config.wo)));
    }
    Ok(Some(Tensor::from_vec(out, (u.len(), inputs), device)?))
}

/// The values that were computed for the last key.
#[derive(Default)]
struct Remembered {
    key: Option<[f32; 2]>,
    values: Vec<f32>,
}

impl Remembered {
    fn get(&mut self, key: [f32; 2], fill: impl FnOnce(&mut Vec<f32>)) -> &[f32] {
        if self.key != Some(key) {
            self.key = Some(key);
            self.values.clear();
            fill(&mut self.values);
        }
        &self.values
    }
}
