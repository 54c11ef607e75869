//! Steps through candle's graph: fixed chunks of pieces, each with its own graph, summed in chunk order.
//!
//! Chunks spread over the cores, keep every tensor small, and depend on the batch alone, so a step gives the same bytes on
//! any number of threads.

#[cfg(test)]
mod tests;

use super::engine::{Engine, Gradient, Step, Take, patches};
use crate::dataset::Block;
use crate::error::{Error, Result};
use crate::loss::{Means, Patches, Target};
use crate::model::texture::{Sigmas, smoothed};
use crate::model::variables::is_texture;
use crate::model::{Inputs, Networks, Tables, Variables};
use candle_core::{Device, Tensor, Var};
use neumip_export::config::{Architecture, OFFSET_TEXTURE, texture_name};
use rayon::prelude::*;

/// Least samples of a chunk.
const CHUNK_SAMPLES: usize = 1024;
/// Most chunks of a batch: each one's graph zero-fills and adds a gradient as large as the textures.
const MOST_CHUNKS: usize = 8;

/// One batch's work.
pub(super) struct Job<'a> {
    pub networks: &'a Networks,
    pub variables: &'a Variables,
    pub tables: &'a Tables,
    pub step: &'a Step<'a>,
    pub device: &'a Device,
}

/// Loss and gradients of a batch.
pub(super) struct Gradients {
    /// The loss.
    pub loss: f64,
    /// Of the tables, as the lookups saw them.
    pyramid: Tensor,
    offset: Option<Tensor>,
    /// Of the networks' weights and biases, by name.
    networks: Vec<(String, Tensor)>,
}

/// A part of a batch, ready for the networks.
pub(super) struct Chunk {
    pub inputs: Inputs,
    pub target: Target,
}

impl Job<'_> {
    /// The batch's loss and gradients.
    pub fn gradients(&self) -> Result<Gradients> {
        let pieces = self.step.pieces;
        let means = self.means();
        let parts: Vec<Gradients> = pieces
            .par_chunks(self.per_chunk())
            .map(|chunk| self.chunk_gradients(chunk, means))
            .collect::<Result<_>>()?;
        let mut parts = parts.into_iter();
        let Some(mut total) = parts.next() else {
            return Err(Error::config("batch", "is empty"));
        };
        for part in parts {
            total.add(part)?;
        }
        Ok(total)
    }

    /// Pieces that are one graph.
    pub fn per_chunk(&self) -> usize {
        if self.networks.architecture.neighbourhood().is_some() {
            // Images of different levels are of different sizes.
            return 1;
        }
        let pieces = self.step.pieces;
        let samples = pieces.iter().map(|p| p.side() * p.side()).sum::<usize>();
        let largest = pieces.first().map_or(1, |p| p.side() * p.side());
        (samples.div_ceil(MOST_CHUNKS).max(CHUNK_SAMPLES) / largest).max(1)
    }

    /// Counts that the batch's sums are divided by.
    pub fn means(&self) -> Means {
        self.step.means(&self.networks.architecture)
    }

    /// The queries and targets of some pieces of a batch.
    pub fn chunk(&self, pieces: &[Block], means: Means) -> Result<Chunk> {
        let architecture = &self.networks.architecture;
        let side = pieces.first().map_or(1, |p| p.side());
        let (mut u, mut wi, mut wo, mut level) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let mut rgb = Vec::with_capacity(pieces.len() * side * side);
        let [low, high] = self.step.target_range;
        for piece in pieces {
            let queries = piece.queries(architecture.resolution);
            u.extend_from_slice(&queries.u);
            wi.extend_from_slice(&queries.wi);
            wo.extend_from_slice(&queries.wo);
            level.extend_from_slice(&queries.level);
            rgb.extend(piece.target().iter().map(|p| p.map(|v| v.clamp(low, high))));
        }
        let patches: Vec<Patches> = pieces.iter().map(|p| patches(p.layout(), architecture)).collect();
        let weights: Vec<f32> = pieces
            .iter()
            .map(|p| f32::from(self.step.highest_level.is_none_or(|most| p.level() <= most as f32)))
            .collect();
        let mut inputs = Inputs::new(architecture, &u, &wi, &wo, &level, self.device)?;
        if let ([piece], Some(_)) = (pieces, architecture.neighbourhood()) {
            inputs = inputs.as_images(piece.layout().mosaic());
        }
        Ok(Chunk { inputs, target: Target::new(rgb, side, &patches, &weights, means, self.device)? })
    }

    fn chunk_gradients(&self, pieces: &[Block], means: Means) -> Result<Gradients> {
        let chunk = self.chunk(pieces, means)?;
        let pyramid = Var::from_tensor(&self.tables.pyramid)?;
        let offset = self.tables.offset.as_ref().map(Var::from_tensor).transpose()?;
        let tables = Tables {
            pyramid: pyramid.as_tensor().clone(),
            offset: offset.as_ref().map(|o| o.as_tensor().clone()),
        };
        let prediction = self.networks.forward(&chunk.inputs, &tables)?;
        let loss = chunk.target.loss(&prediction, self.step.terms)?;
        let mut store = loss.backward()?;
        let mut take = |var: &Var| match store.remove(var.as_tensor()) {
            Some(gradient) => Ok(gradient),
            None => var.as_tensor().zeros_like(),
        };
        let mut networks = Vec::new();
        for (name, var) in self.variables.iter() {
            if !is_texture(name) {
                networks.push((name.to_string(), take(var)?));
            }
        }
        Ok(Gradients {
            loss: f64::from(loss.to_scalar::<f32>()?),
            pyramid: take(&pyramid)?,
            offset: offset.as_ref().map(take).transpose()?,
            networks,
        })
    }
}

impl Gradients {
    fn add(&mut self, other: Self) -> Result<()> {
        self.loss += other.loss;
        self.pyramid = (&self.pyramid + other.pyramid)?;
        if let (Some(mine), Some(theirs)) = (&mut self.offset, other.offset) {
            *mine = (&*mine + theirs)?;
        }
        for ((_, mine), (_, theirs)) in self.networks.iter_mut().zip(other.networks) {
            *mine = (&*mine + theirs)?;
        }
        Ok(())
    }

    /// Adds the gradients of the tables of earlier steps.
    fn add_texels(&mut self, other: &Self) -> Result<()> {
        self.pyramid = (&self.pyramid + &other.pyramid)?;
        if let (Some(mine), Some(theirs)) = (&mut self.offset, &other.offset) {
            *mine = (&*mine + theirs)?;
        }
        Ok(())
    }

    /// False if the loss or any sample's gradient is not finite: every one of them reaches the last bias.
    pub fn finite(&self) -> bool {
        let bias = self.networks.last().and_then(|(_, g)| g.flatten_all().ok()?.to_vec1::<f32>().ok());
        self.loss.is_finite() && bias.is_some_and(|b| b.iter().all(|v| v.is_finite()))
    }

    /// Gradients of the textures by name: the tables' ones smoothed once more, which is the adjoint of reading them so.
    pub fn of_textures(self, architecture: &Architecture, sigmas: &Sigmas) -> Result<Vec<(String, Tensor)>> {
        let mut all = Vec::new();
        for (level, size) in architecture.level_sizes().iter().enumerate() {
            let shape = (size.height, size.width, architecture.model.texture.channels);
            let part = self.pyramid.narrow(0, size.base, size.height * size.width)?.reshape(shape)?;
            all.push((texture_name(level), smoothed(&part, sigmas.pyramid[level])?));
        }
        if let Some(offset) = self.offset {
            let [height, width] = architecture.finest_size();
            let offset = offset.reshape((height, width, ()))?;
            all.push((OFFSET_TEXTURE.into(), smoothed(&offset, sigmas.offset)?));
        }
        Ok(all)
    }
}

/// The engine that goes through candle's graph, on any device.
pub(super) struct CandleEngine {
    networks: Networks,
    device: Device,
    tables: Option<Tables>,
    /// The last step's, with the texels' of all steps since they were handed out.
    gradients: Option<Gradients>,
}

impl CandleEngine {
    /// An engine over `variables`.
    ///
    /// # Errors
    /// `Config` if one is missing.
    pub fn new(architecture: &Architecture, variables: &Variables, device: &Device) -> Result<Self> {
        let networks = Networks::new(architecture, variables)?;
        Ok(Self { networks, device: device.clone(), tables: None, gradients: None })
    }
}

impl Engine for CandleEngine {
    fn read(&mut self, variables: &Variables, sigmas: &Sigmas) -> Result<()> {
        self.tables = Some(Tables::new(&self.networks.architecture, variables, sigmas)?);
        Ok(())
    }

    fn step(&mut self, variables: &Variables, step: &Step) -> Result<f64> {
        let Some(tables) = &self.tables else {
            return Err(Error::config("textures", "are stepped on before they are read"));
        };
        let job = Job { networks: &self.networks, variables, tables, step, device: &self.device };
        let mut new = job.gradients()?;
        let loss = if new.finite() { new.loss } else { f64::NAN };
        if let Some(before) = self.gradients.take() {
            new.add_texels(&before)?;
        }
        self.gradients = Some(new);
        Ok(loss)
    }

    fn networks(&mut self, take: &mut Take) -> Result<()> {
        let parts = self.gradients.iter_mut().flat_map(|g| g.networks.drain(..));
        parts.into_iter().try_for_each(|(name, gradient)| take(&name, Gradient::Tensor(gradient)))
    }

    fn textures(&mut self, sigmas: &Sigmas, take: &mut Take) -> Result<()> {
        let Some(gradients) = self.gradients.take() else { return Ok(()) };
        let all = gradients.of_textures(&self.networks.architecture, sigmas)?;
        all.into_iter().try_for_each(|(name, gradient)| take(&name, Gradient::Tensor(gradient)))
    }
}
