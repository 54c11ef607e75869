//! A trained material with its sampler.

use super::lobe::Lobes;
use super::network::Network;
use crate::engine::FusedMaterial;
use crate::error::{Error, Result};
use crate::kernels::mlp::{End, Packed, STEP, Start};
use neumip_export::checkpoint::Checkpoint;
use neumip_export::sampler::{OUTPUTS_PER_LOBE, Sampler, SamplerConfig};
use rayon::prelude::*;

/// Queries of a tile: the network's values stay in the first-level cache.
const TILE: usize = 2 * STEP;
/// Queries that a core handles at a time.
const CHUNK: usize = 16 * TILE;

/// A trained material and the mixtures to sample its light by.
#[derive(Clone, Debug)]
pub struct MaterialSampler {
    material: FusedMaterial,
    config: SamplerConfig,
    layers: Vec<Packed>,
}

impl MaterialSampler {
    /// The sampler of a checkpoint's material, on the instruction set in use.
    ///
    /// # Errors
    /// As [`FusedMaterial::from_checkpoint`] and [`MaterialSampler::new`].
    pub fn from_checkpoint(checkpoint: &Checkpoint, sampler: &Sampler) -> Result<Self> {
        Self::new(FusedMaterial::from_checkpoint(checkpoint)?, sampler)
    }

    /// The sampler of a material.
    ///
    /// # Errors
    /// `Config` if the sampler is damaged or another material's: it reads another number of channels.
    pub fn new(material: FusedMaterial, sampler: &Sampler) -> Result<Self> {
        let network = Network::new(sampler)?;
        let config = sampler.header.config.clone();
        let channels = material.architecture().model.texture.channels;
        if config.features != channels {
            let problem = format!("reads {} channels where the material has {channels}", config.features);
            return Err(Error::config("sampler.features", problem));
        }
        let isa = material.isa();
        let layers = network.layers.iter();
        let inputs = |weight: &[f32], bias: &[f32]| 0..weight.len() / bias.len();
        let layers = layers.map(|l| Packed::layer(isa, &l.weight, &l.bias, inputs(&l.weight, &l.bias)));
        Ok(Self { layers: layers.collect(), material, config })
    }

    /// The material.
    pub fn material(&self) -> &FusedMaterial {
        &self.material
    }

    /// The mixtures of queries at positions `u` and `level`, seen from `wo`.
    ///
    /// # Errors
    /// `Config` if the slices differ in length or a value is not finite, or if the decoder reads neighbours.
    pub fn lobes(&self, u: &[[f32; 2]], level: &[f32], wo: &[[f32; 2]]) -> Result<Vec<Lobes>> {
        self.lobes_of(&self.material.features(u, level, wo)?, wo)
    }

    /// The mixtures of queries seen from `wo` whose features \[queries\]\[channels\] were looked up before
    /// ([`FusedMaterial::features`]).
    ///
    /// # Errors
    /// `Config` if the slices do not fit each other.
    pub fn lobes_of(&self, features: &[f32], wo: &[[f32; 2]]) -> Result<Vec<Lobes>> {
        let outputs = self.outputs(features, wo)?;
        let each = outputs.par_chunks_exact(self.width()).zip(wo).with_min_len(TILE);
        Ok(each.map(|(outputs, wo)| Lobes::new(&self.config, outputs, *wo)).collect())
    }

    /// What the outputs mean for a viewer.
    pub(super) fn config(&self) -> &SamplerConfig {
        &self.config
    }

    /// Number of outputs.
    pub(super) fn width(&self) -> usize {
        OUTPUTS_PER_LOBE * self.config.lobes.len()
    }

    /// The network's outputs \[queries\]\[width\].
    pub(super) fn outputs(&self, features: &[f32], wo: &[[f32; 2]]) -> Result<Vec<f32>> {
        let (channels, width) = (self.config.features, self.width());
        if features.len() != channels * wo.len() {
            let problem = format!("{} where {} queries have {channels} each", features.len(), wo.len());
            return Err(Error::config("features", problem));
        }
        let mut outputs = vec![0.0; wo.len() * width];
        let chunks = outputs.par_chunks_mut(CHUNK * width).zip(wo.par_chunks(CHUNK));
        let chunks = chunks.zip(features.par_chunks(CHUNK * channels));
        chunks.for_each_init(Vec::new, |rooms: &mut Vec<Vec<f32>>, ((outputs, wo), features)| {
            let tiles = outputs.chunks_mut(TILE * width).zip(wo.chunks(TILE));
            for ((outputs, wo), features) in tiles.zip(features.chunks(TILE * channels)) {
                self.tile(rooms, features, wo, outputs);
            }
        });
        Ok(outputs)
    }

    /// The mixture of one query.
    ///
    /// # Errors
    /// As [`MaterialSampler::lobes`].
    pub fn lobes_at(&self, u: [f32; 2], level: f32, wo: [f32; 2]) -> Result<Lobes> {
        Ok(self.lobes(&[u], &[level], &[wo])?.first().copied().unwrap_or_else(Lobes::cosine))
    }

    /// For each query a direction of light, a unit vector, and its density over solid angle, from two numbers in [0, 1).
    ///
    /// # Errors
    /// As [`MaterialSampler::lobes`], and `Config` if `xi` has another length.
    pub fn sample(
        &self,
        u: &[[f32; 2]],
        level: &[f32],
        wo: &[[f32; 2]],
        xi: &[[f32; 2]],
    ) -> Result<Vec<([f32; 3], f32)>> {
        if xi.len() != u.len() {
            return Err(Error::config("xi", format!("has {} entries where u has {}", xi.len(), u.len())));
        }
        let lobes = self.lobes(u, level, wo)?;
        Ok(lobes.par_iter().zip(xi).map(|(lobes, xi)| lobes.sample(*xi)).collect())
    }

    /// For each query the density over solid angle of a direction, a unit vector; 0 on and below the horizon.
    ///
    /// # Errors
    /// As [`MaterialSampler::lobes`], and `Config` if `wi` has another length.
    pub fn pdf(&self, u: &[[f32; 2]], level: &[f32], wo: &[[f32; 2]], wi: &[[f32; 3]]) -> Result<Vec<f32>> {
        if wi.len() != u.len() {
            return Err(Error::config("wi", format!("has {} entries where u has {}", wi.len(), u.len())));
        }
        let lobes = self.lobes(u, level, wo)?;
        Ok(lobes.par_iter().zip(wi).map(|(lobes, wi)| lobes.pdf(*wi)).collect())
    }

    /// The outputs of a tile; `rooms` are the network's rows of values.
    fn tile(&self, rooms: &mut Vec<Vec<f32>>, features: &[f32], wo: &[[f32; 2]], outputs: &mut [f32]) {
        let channels = self.config.features;
        rooms.resize(self.layers.len() + 1, Vec::new());
        rooms[0].clear();
        rooms[0].resize((channels + 2) * TILE, 0.0);
        for (k, (features, wo)) in features.chunks_exact(channels).zip(wo).enumerate() {
            for (row, value) in features.iter().chain(wo).enumerate() {
                rooms[0][row * TILE + k] = *value;
            }
        }
        for (k, layer) in self.layers.iter().enumerate() {
            let (before, after) = rooms.split_at_mut(k + 1);
            after[0].resize(layer.outputs() * TILE, 0.0);
            let end = if k + 1 < self.layers.len() { End::Relu } else { End::Linear };
            layer.apply(TILE, &before[k], Start::Bias, end, &mut after[0]);
        }
        let rows = &rooms[self.layers.len()];
        for (k, outputs) in outputs.chunks_exact_mut(self.width()).enumerate() {
            for (to, row) in outputs.iter_mut().zip(rows.chunks_exact(TILE)) {
                *to = row[k];
            }
        }
    }
}
