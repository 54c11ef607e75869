//! Steps through the fused kernels, on values that candle variables own.

use super::engine::{Engine, Gradient, Step, Take};
use crate::config::{Remap, Term, TermKind};
use crate::engine::{Batch, Loss, Networks, Order, Plan, Sums, Textures};
use crate::error::Result;
use crate::kernels::fetch::{Texels, padded};
use crate::kernels::loss;
use crate::kernels::simd::Isa;
use crate::kernels::smooth::smooth_strided;
use crate::loss::Means;
use crate::model::Variables;
use crate::model::texture::Sigmas;
use crate::model::variables::is_texture;
use neumip_export::config::{Architecture, OFFSET_TEXTURE, texture_name};

/// The fused engine.
pub(super) struct FusedEngine {
    batch: Batch,
    sums: Sums,
    textures: Vec<Read>,
    room: (Vec<f32>, Vec<f32>),
}

/// A texture as lookups read it.
struct Read {
    name: String,
    /// Height, width, channels.
    shape: [usize; 3],
    /// First texel in the gradient table.
    base: usize,
    /// Sigma of `smoothed`; none where the variable changed since.
    sigma: Option<f64>,
    /// The values, where they are not the variable's own.
    smoothed: Vec<f32>,
}

impl FusedEngine {
    /// An engine on an instruction set.
    pub fn new(architecture: &Architecture, isa: Isa) -> Self {
        let batch = Batch::new(Plan::new(architecture, isa, Order::Stored));
        let read = |name: String, [height, width]: [usize; 2], channels: usize, base: usize| Read {
            name,
            shape: [height, width, channels],
            base,
            sigma: None,
            smoothed: Vec::new(),
        };
        let channels = architecture.model.texture.channels;
        let sizes = architecture.level_sizes().into_iter().enumerate();
        let mut textures: Vec<Read> =
            sizes.map(|(l, s)| read(texture_name(l), [s.height, s.width], channels, s.base)).collect();
        if let Some(channels) = architecture.offset_channels() {
            textures.push(read(OFFSET_TEXTURE.into(), architecture.finest_size(), channels, 0));
        }
        Self { sums: batch.zeros(), batch, textures, room: Default::default() }
    }
}

impl Engine for FusedEngine {
    fn read(&mut self, variables: &Variables, sigmas: &Sigmas) -> Result<()> {
        let isa = self.batch.plan().isa;
        for texture in &mut self.textures {
            let sigma = sigmas.of(&texture.name);
            if texture.sigma == Some(sigma) {
                continue;
            }
            if sigma > 0.0 {
                let values = variables.values(&texture.name)?;
                let (shape, channels) = (texture.shape, texture.shape[2]);
                texture.smoothed.resize(shape.iter().product(), 0.0);
                let out = (&mut texture.smoothed[..], channels);
                smooth_strided(isa, (values.slice(), channels), shape, sigma, out, &mut self.room.0);
            }
            texture.sigma = Some(sigma);
        }
        Ok(())
    }

    fn step(&mut self, variables: &Variables, step: &Step) -> Result<f64> {
        let owned = |name: &str| Ok(variables.values(name)?.slice().to_vec());
        let networks = Networks::training(self.batch.plan(), &owned)?;
        let mut guards = Vec::new();
        for texture in &self.textures {
            guards.push(match texture.sigma {
                Some(sigma) if sigma > 0.0 => None,
                _ => Some(variables.values(&texture.name)?),
            });
        }
        let texels = self.textures.iter().zip(&guards).map(|(texture, guard)| match guard {
            Some(values) => Texels::Single(values.slice()),
            None => Texels::Single(&texture.smoothed),
        });
        let mut levels: Vec<Texels> = texels.collect();
        let offset = match self.textures.last() {
            Some(last) if last.name == OFFSET_TEXTURE => levels.pop(),
            _ => None,
        };
        let textures = Textures::new(self.batch.plan(), levels, offset);
        let means = step.means(&self.batch.plan().architecture);
        let loss = Loss {
            terms: &scaled(step.terms, means),
            range: step.target_range,
            highest_level: step.highest_level,
            offset_texture: step.offset_texture,
        };
        let value = self.batch.gradients(&networks, &textures, step.pieces, &loss, &mut self.sums)?;
        // Every sample's gradient reaches the last bias.
        let outputs = self.batch.plan().architecture.decoder_outputs();
        let last = &self.sums.networks[self.sums.networks.len() - outputs..];
        Ok(if last.iter().all(|v| v.is_finite()) { value } else { f64::NAN })
    }

    fn networks(&mut self, take: &mut Take) -> Result<()> {
        let mut rest = &self.sums.networks[..];
        for (name, shape) in self.batch.plan().architecture.tensors() {
            if !is_texture(&name) {
                let (part, others) = rest.split_at(shape.iter().product());
                rest = others;
                take(&name, Gradient::Dense(part))?;
            }
        }
        Ok(())
    }

    fn textures(&mut self, sigmas: &Sigmas, take: &mut Take) -> Result<()> {
        let isa = self.batch.plan().isa;
        for texture in &mut self.textures {
            let [height, width, channels] = texture.shape;
            let stride = padded(channels);
            let table = match texture.name == OFFSET_TEXTURE {
                true => &mut self.sums.offset,
                false => &mut self.sums.pyramid,
            };
            let table = &mut table[texture.base * stride..(texture.base + height * width) * stride];
            let sigma = sigmas.of(&texture.name);
            if sigma > 0.0 {
                let (scratch, out) = &mut self.room;
                out.resize(height * width * channels, 0.0);
                smooth_strided(isa, (table, stride), texture.shape, sigma, (out, channels), scratch);
                table.fill(0.0);
                take(&texture.name, Gradient::Dense(out))?;
            } else {
                take(&texture.name, Gradient::Padded { table, stride, channels })?;
            }
            texture.sigma = None;
        }
        Ok(())
    }
}

/// Terms of the configuration as the kernel has them, for a batch of these counts.
fn scaled(terms: &[Term], means: Means) -> Vec<loss::Term> {
    let one = |term: &Term| {
        let (kind, count) = match term.kind {
            TermKind::L1 => (loss::Kind::L1, 3 * means.pixels),
            TermKind::L2 => (loss::Kind::L2, 3 * means.pixels),
            TermKind::L2Mean => (loss::Kind::L2Mean, 3 * means.pixels),
            TermKind::Gradient => (loss::Kind::Gradient, 3 * means.interior),
            TermKind::GradientLuma => (loss::Kind::GradientLuma, means.interior),
        };
        let remap = match term.remap {
            Remap::Linear => loss::Remap::Linear,
            Remap::Root4Literal => loss::Remap::Root4Literal,
            Remap::Root4Guarded => loss::Remap::Root4Guarded,
            Remap::Root4Signed(epsilon) => loss::Remap::Root4Signed(epsilon as f32),
            Remap::Sqrt(epsilon) => loss::Remap::Sqrt(epsilon as f32),
            Remap::Log => loss::Remap::Log,
        };
        (count > 0).then(|| loss::Term { kind, remap, scale: (term.weight / count as f64) as f32 })
    };
    terms.iter().filter_map(one).collect()
}
