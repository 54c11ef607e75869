//! Loss and gradients of a training step: fixed chunks of pieces, spread over the cores and summed in chunk order.
//!
//! A piece's loss needs no other piece, so a tile goes forward, meets its loss and goes back while all that it computed is
//! still in the cache. Gradients of textures are kept sample by sample and then added by owners of texels, each in the
//! order of the samples: the sums are the same bytes on any number of threads.

use super::backward::{Record, Room, backward};
use super::networks::Networks;
use super::plan::Plan;
use super::studio::Studio;
use super::textures::Textures;
use super::tile::{Queries, Tile, stride_of};
use crate::dataset::Block;
use crate::error::Result;
use crate::kernels::fetch::{Owned, padded};
use crate::kernels::loss::{self, Term};
use rayon::prelude::*;
use std::sync::Mutex;

/// Least samples of a chunk: two tiles, so that small batches still feed several cores.
const CHUNK: usize = 512;
/// Most chunks of a batch: each has its own sums of the weights' gradients.
const MOST_CHUNKS: usize = 64;
/// Samples that small pieces are gathered to: a tile's intermediate values stay in the second-level cache.
const TILE: usize = 256;
/// Largest piece that is one tile; of larger ones the forward pass is run twice, once for the loss of the whole piece.
const LARGEST: usize = 1024;

/// What a step is measured by.
#[derive(Clone, Copy, Debug)]
pub struct Loss<'a> {
    /// Terms, scaled for the batch.
    pub terms: &'a [Term],
    /// Targets are clamped to this range.
    pub range: [f32; 2],
    /// Pieces of a higher level are left out.
    pub highest_level: Option<u32>,
    /// Whether the offset texture learns.
    pub offset_texture: bool,
}

/// Gradients of a step, or of several that were added up.
#[derive(Clone, Debug)]
pub struct Sums {
    /// Of all layers, weight and bias in turn, the offset network's first.
    pub networks: Vec<f32>,
    /// Of the pyramid's texels, all levels, each padded to whole vectors.
    pub pyramid: Vec<f32>,
    /// Of the offset texture's texels, alike.
    pub offset: Vec<f32>,
}

/// Room for steps of one model.
#[derive(Debug)]
pub struct Batch {
    plan: Plan,
    weights: usize,
    chunks: Vec<Chunk>,
    workers: Mutex<Vec<Worker>>,
    studio: Studio,
}

/// What one chunk gives.
#[derive(Debug, Default)]
struct Chunk {
    loss: f64,
    weights: Vec<f32>,
    /// Of the pyramid and of the offset texture, a tile each.
    records: Vec<[Record; 2]>,
    used: usize,
}

/// What one thread works in.
#[derive(Debug, Default)]
struct Worker {
    tile: Tile,
    room: Room,
    by_rgb: Vec<f32>,
    target: Vec<f32>,
    piece: Queries,
    rgb: Vec<f32>,
    loss: loss::Scratch,
}

impl Batch {
    /// Room for steps of a model.
    pub fn new(plan: Plan) -> Self {
        let weights = plan.architecture.network_weights();
        Self { plan, weights, chunks: Vec::new(), workers: Mutex::new(Vec::new()), studio: Studio::default() }
    }

    /// The plan.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// Sums of zero.
    pub fn zeros(&self) -> Sums {
        let architecture = &self.plan.architecture;
        let [height, width] = architecture.finest_size();
        Sums {
            networks: vec![0.0; self.weights],
            pyramid: vec![0.0; architecture.pyramid_texels() * padded(self.plan.channels())],
            offset: vec![0.0; self.plan.offset.map_or(0, |(c, _)| height * width * padded(c))],
        }
    }

    /// The loss of a batch. Its gradients by the weights replace those of `sums`; those by the texels are added.
    ///
    /// # Errors
    /// `Config` for pieces that are too large for a decoder that reads neighbours.
    ///
    /// # Panics
    /// If the networks, textures or sums are those of another plan, or the pieces differ in side.
    pub fn gradients(
        &mut self,
        networks: &Networks,
        textures: &Textures,
        pieces: &[Block],
        loss: &Loss,
        sums: &mut Sums,
    ) -> Result<f64> {
        if self.plan.architecture.neighbourhood().is_some() {
            let total = self.studio.gradients(&self.plan, networks, textures, pieces, loss, sums)?;
            scatter(&self.plan, self.studio.records(), loss, sums);
            return Ok(total);
        }
        let samples = |p: &Block| p.side() * p.side();
        let total: usize = pieces.iter().map(samples).sum();
        let largest = pieces.first().map_or(1, samples);
        let per_chunk = (total.div_ceil(MOST_CHUNKS).max(CHUNK) / largest).max(1);
        let count = pieces.len().div_ceil(per_chunk);
        self.chunks.resize_with(self.chunks.len().max(count), Chunk::default);
        let (plan, workers, weights) = (&self.plan, &self.workers, self.weights);
        self.chunks[..count].par_iter_mut().zip(pieces.par_chunks(per_chunk)).for_each(|(chunk, pieces)| {
            let idle = workers.lock().ok().and_then(|mut all| all.pop());
            let mut worker = idle.unwrap_or_default();
            chunk.loss = 0.0;
            chunk.used = 0;
            chunk.weights.clear();
            chunk.weights.resize(weights, 0.0);
            worker.chunk(plan, networks, textures, pieces, loss, chunk);
            if let Ok(mut all) = workers.lock() {
                all.push(worker);
            }
        });
        let chunks = &self.chunks[..count];
        scatter(&self.plan, chunks.iter().flat_map(|c| &c.records[..c.used]), loss, sums);
        sums.networks.fill(0.0);
        for chunk in chunks {
            sums.networks.iter_mut().zip(&chunk.weights).for_each(|(sum, part)| *sum += part);
        }
        Ok(chunks.iter().map(|c| c.loss).sum())
    }
}

/// Adds what records hold, in their order, to the tables of gradients.
fn scatter<'a>(
    plan: &Plan,
    records: impl Iterator<Item = &'a [Record; 2]> + Clone + Sync,
    loss: &Loss,
    sums: &mut Sums,
) {
    let threads = rayon::current_num_threads();
    let wide = [padded(plan.channels()), plan.offset.map_or(8, |(c, _)| padded(c))];
    let mut owners = Vec::new();
    for (which, table) in [&mut sums.pyramid, &mut sums.offset].into_iter().enumerate() {
        if which == 0 || (loss.offset_texture && plan.offset.is_some()) {
            owners.extend(Owned::split(table, wide[which], threads).into_iter().map(|o| (which, o)));
        }
    }
    owners.par_iter_mut().for_each(|(which, owned)| {
        for record in records.clone() {
            let Record { taps, gradients } = &record[*which];
            for of_level in taps.chunks((gradients.len() / wide[*which]).max(1)) {
                owned.scatter(plan.isa, of_level, gradients);
            }
        }
    });
}

impl Worker {
    fn chunk(
        &mut self,
        plan: &Plan,
        networks: &Networks,
        textures: &Textures,
        pieces: &[Block],
        loss: &Loss,
        chunk: &mut Chunk,
    ) {
        let counts = |p: &&Block| loss.highest_level.is_none_or(|most| p.level() <= most as f32);
        let pieces: Vec<&Block> = pieces.iter().filter(counts).collect();
        let Some(first) = pieces.first() else { return };
        let samples = first.side() * first.side();
        for pieces in pieces.chunks((TILE / samples).max(1)) {
            let stride = stride_of(samples * pieces.len());
            self.load(plan, pieces, stride, loss.range);
            if samples <= LARGEST {
                self.tile.resize(plan, networks, stride, true);
                std::mem::swap(&mut self.tile.queries, &mut self.piece);
                self.tile.forward(plan, networks, textures);
                std::mem::swap(&mut self.tile.queries, &mut self.piece);
                std::mem::swap(&mut self.tile.rgb, &mut self.rgb);
                chunk.loss += self.compare(plan, pieces, stride, loss);
                std::mem::swap(&mut self.tile.rgb, &mut self.rgb);
                self.back(plan, networks, chunk);
            } else {
                self.large(plan, networks, textures, pieces, stride, loss, chunk);
            }
        }
    }

    /// Queries and targets of some pieces, one behind the other, as rows.
    fn load(&mut self, plan: &Plan, pieces: &[&Block], stride: usize, [low, high]: [f32; 2]) {
        self.piece.resize(stride);
        self.target.resize(3 * stride, 0.0);
        self.by_rgb.resize(3 * stride, 0.0);
        let mut start = 0;
        for piece in pieces {
            let n = piece.side() * piece.side();
            let [ux, wix, wox] = [&mut self.piece.u, &mut self.piece.wi, &mut self.piece.wo]
                .map(|pair| pair.split_at_mut(stride));
            let rows = [ux.0, ux.1, wix.0, wix.1, wox.0, wox.1].map(|row| &mut row[start..start + n]);
            piece.layout().rows(plan.architecture.resolution, rows);
            let coarsest = plan.architecture.coarsest() as f32;
            self.piece.level[start..start + n].fill(piece.level().min(coarsest));
            for (c, row) in self.target.chunks_mut(stride).enumerate() {
                for (to, pixel) in row[start..].iter_mut().zip(piece.rgb()) {
                    *to = pixel[c].to_f32();
                }
            }
            start += n;
        }
        for row in self.target.chunks_mut(stride) {
            row[..start].iter_mut().for_each(|v| *v = v.clamp(low, high));
        }
        // What pads the tile asks something harmless and teaches nothing.
        self.piece.level[start..].fill(0.0);
        for pair in [&mut self.piece.u, &mut self.piece.wi, &mut self.piece.wo] {
            pair.chunks_mut(stride).for_each(|row| row[start..].fill(0.0));
        }
        self.by_rgb.chunks_mut(stride).for_each(|row| row[start..].fill(0.0));
    }

    /// Loss of the loaded pieces and its gradient by their RGB.
    fn compare(&mut self, plan: &Plan, pieces: &[&Block], stride: usize, loss: &Loss) -> f64 {
        let mut total = 0.0;
        let mut start = 0;
        for piece in pieces {
            let n = piece.side() * piece.side();
            let [a, b, c] = [0, 1, 2].map(|c| c * stride + start..c * stride + start + n);
            let (red, rest) = self.by_rgb.split_at_mut(stride);
            let (green, blue) = rest.split_at_mut(stride);
            total += loss::run(
                plan.isa,
                loss.terms,
                piece.side(),
                piece.patch(),
                1.0,
                [&self.rgb[a.clone()], &self.rgb[b.clone()], &self.rgb[c.clone()]],
                [&self.target[a], &self.target[b], &self.target[c]],
                [&mut red[start..start + n], &mut green[start..start + n], &mut blue[start..start + n]],
                &mut self.loss,
            );
            start += n;
        }
        total
    }

    /// Back through the tile with the gradient that [`Worker::compare`] left.
    fn back(&mut self, plan: &Plan, networks: &Networks, chunk: &mut Chunk) {
        chunk.records.resize_with(chunk.records.len().max(chunk.used + 1), Default::default);
        let [pyramid, offset] = &mut chunk.records[chunk.used];
        chunk.used += 1;
        let weights = &mut chunk.weights;
        let records = [pyramid, offset];
        backward(&mut self.tile, plan, networks, &self.by_rgb, weights, records, &mut self.room);
    }

    /// A piece that is larger than a tile: its RGB tile by tile, its loss, and then each tile forward and back.
    #[expect(clippy::too_many_arguments, reason = "what a chunk has, and the loaded piece")]
    fn large(
        &mut self,
        plan: &Plan,
        networks: &Networks,
        textures: &Textures,
        pieces: &[&Block],
        stride: usize,
        loss: &Loss,
        chunk: &mut Chunk,
    ) {
        self.rgb.resize(3 * stride, 0.0);
        let parts = || (0..stride).step_by(TILE).map(|start| start..(start + TILE).min(stride));
        for part in parts() {
            self.tile.resize(plan, networks, part.len(), true);
            self.tile.queries.copy(&self.piece, stride, part.clone());
            self.tile.forward(plan, networks, textures);
            for (to, from) in self.rgb.chunks_mut(stride).zip(self.tile.rgb.chunks(part.len())) {
                to[part.clone()].copy_from_slice(from);
            }
        }
        chunk.loss += self.compare(plan, pieces, stride, loss);
        let whole = std::mem::take(&mut self.by_rgb);
        for part in parts() {
            self.tile.resize(plan, networks, part.len(), true);
            self.tile.queries.copy(&self.piece, stride, part.clone());
            self.tile.forward(plan, networks, textures);
            self.by_rgb.clear();
            whole.chunks(stride).for_each(|row| self.by_rgb.extend_from_slice(&row[part.clone()]));
            self.back(plan, networks, chunk);
        }
        self.by_rgb = whole;
    }
}
