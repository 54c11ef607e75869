//! Decoders that read neighbours: tiles make the inputs of whole images, the decoder's kernels answer them at once, and on
//! the way back tiles take the gradients of their features.

use super::backward::{Record, Room, features_backward, size};
use super::networks::Networks;
use super::plan::Plan;
use super::textures::Textures;
use super::tile::{Queries, Tile};
use crate::error::{Error, Result};
use crate::kernels::inception::{self, Border, Images, Network};
use crate::kernels::output;
use crate::query::grid::Mosaic;
use rayon::prelude::*;
use std::sync::Mutex;

/// Samples of a tile.
const TILE: usize = 256;
/// Samples that one core takes at a time.
const CHUNK: usize = 4 * TILE;

/// Workers that threads take and give back.
#[derive(Debug, Default)]
struct Pool(Mutex<Vec<(Tile, Room)>>);

impl Pool {
    fn with<T>(&self, work: impl FnOnce(&mut (Tile, Room)) -> T) -> T {
        let idle = self.0.lock().ok().and_then(|mut all| all.pop());
        let mut worker = idle.unwrap_or_default();
        let result = work(&mut worker);
        if let Ok(mut all) = self.0.lock() {
            all.push(worker);
        }
        result
    }
}

/// Room for images of one model.
#[derive(Debug, Default)]
pub(super) struct Canvas {
    pool: Pool,
    /// Queries \[samples\] image by image.
    pub queries: Queries,
    /// Of the decoder \[samples\]\[inputs\], and \[samples\]\[outputs\].
    input: Vec<f32>,
    output: Vec<f32>,
    /// Outputs \[outputs\]\[stride\].
    rows: Vec<f32>,
    /// \[3\]\[stride\].
    pub rgb: Vec<f32>,
    /// Gradient of the features \[samples\]\[channels\].
    by_features: Vec<f32>,
    by_rows: Vec<f32>,
    room: inception::Room,
}

/// What a chunk of samples adds to the gradients of textures and of the offset network.
#[derive(Debug, Default)]
pub(super) struct Part {
    pub weights: Vec<f32>,
    pub records: Vec<[Record; 2]>,
    pub used: usize,
}

/// Parts of a mosaic of so many samples.
pub(super) fn parts(samples: usize) -> usize {
    samples.div_ceil(CHUNK)
}

/// The kernel's images of a mosaic: they are periodic; what a margin keeps from the border does not see it.
fn images(mosaic: Mosaic) -> Result<Images> {
    Images::new(mosaic.images(), mosaic.height, mosaic.width, Border::Wrap)
}

fn decoder(networks: &Networks) -> Result<&Network> {
    let missing = || Error::config("decoder.kind", "has no convolutions");
    networks.inception.as_ref().ok_or_else(missing)
}

impl Canvas {
    /// From the queries, `mosaic.samples()` of them in the order of the images, to RGB, not clamped.
    ///
    /// # Errors
    /// `Config` for more samples than can be.
    pub fn forward(
        &mut self,
        plan: &Plan,
        networks: &Networks,
        textures: &Textures,
        mosaic: Mosaic,
        keep: bool,
    ) -> Result<()> {
        let (samples, stride) = (mosaic.samples(), self.queries.level.len());
        let [inputs, outputs] = [plan.architecture.decoder_inputs(), plan.architecture.decoder_outputs()];
        self.input.resize(samples * inputs, 0.0);
        self.output.resize(samples * outputs, 0.0);
        let (queries, pool) = (&self.queries, &self.pool);
        self.input.par_chunks_mut(CHUNK * inputs).enumerate().for_each(|(chunk, out)| {
            pool.with(|(tile, _)| {
                for (k, out) in out.chunks_mut(TILE * inputs).enumerate() {
                    let start = chunk * CHUNK + k * TILE;
                    view(tile, plan, networks, textures, queries, start, keep);
                    to_pixels(&tile.input, tile.stride, inputs, out);
                }
            });
        });
        let (network, images) = (decoder(networks)?, images(mosaic)?);
        match keep {
            true => network.forward_keeping(images, &self.input, &mut self.room, &mut self.output),
            false => network.forward(images, &self.input, &mut self.room, &mut self.output),
        }
        self.rows.resize(outputs * stride, 0.0);
        to_rows(&self.output, outputs, stride, &mut self.rows);
        self.rgb.resize(3 * stride, 0.0);
        output::rgb(plan.isa, plan.output, stride, &self.rows, &mut self.rgb);
        Ok(())
    }

    /// Goes back through what [`Canvas::forward`] kept: from the gradient by RGB \[3\]\[stride\] to those of the decoder's
    /// weights, to which it adds, and of each part.
    ///
    /// # Errors
    /// As [`Canvas::forward`].
    #[expect(clippy::too_many_arguments, reason = "what the forward pass had, and where gradients go")]
    pub fn backward(
        &mut self,
        plan: &Plan,
        networks: &Networks,
        textures: &Textures,
        mosaic: Mosaic,
        by_rgb: &[f32],
        weights: &mut [f32],
        parts: &mut [Part],
    ) -> Result<()> {
        let (samples, stride) = (mosaic.samples(), self.queries.level.len());
        let (channels, outputs) = (plan.channels(), plan.architecture.decoder_outputs());
        self.by_rows.resize(outputs * stride, 0.0);
        output::gradient(plan.isa, plan.output, stride, &self.rows, by_rgb, &mut self.by_rows);
        to_pixels(&self.by_rows, stride, outputs, &mut self.output);
        self.by_features.resize(samples * channels, 0.0);
        let (network, images) = (decoder(networks)?, images(mosaic)?);
        network.backward(images, &mut self.room, &self.output, weights, &mut self.by_features);

        let of_offset: usize = networks.offset.iter().map(size).sum();
        let (queries, pool) = (&self.queries, &self.pool);
        let chunks = self.by_features.par_chunks(CHUNK * channels).zip(parts).enumerate();
        chunks.for_each(|(chunk, (by_features, part))| {
            part.weights.clear();
            part.weights.resize(of_offset, 0.0);
            part.used = by_features.len().div_ceil(TILE * channels);
            part.records.resize_with(part.records.len().max(part.used), Default::default);
            pool.with(|(tile, room)| {
                for (k, by_features) in by_features.chunks(TILE * channels).enumerate() {
                    view(tile, plan, networks, textures, queries, chunk * CHUNK + k * TILE, true);
                    room.here.clear();
                    room.here.resize(channels * tile.stride, 0.0);
                    to_rows(by_features, channels, tile.stride, &mut room.here);
                    let [pyramid, offset] = &mut part.records[k];
                    features_backward(tile, plan, networks, &mut part.weights, [pyramid, offset], room);
                }
            });
        });
        Ok(())
    }
}

/// The decoder's inputs of the tile that begins at sample `start`.
fn view(
    tile: &mut Tile,
    plan: &Plan,
    networks: &Networks,
    textures: &Textures,
    queries: &Queries,
    start: usize,
    training: bool,
) {
    let all = queries.level.len();
    let part = start..(start + TILE).min(all);
    tile.resize(plan, networks, part.len(), training);
    tile.queries.copy(queries, all, part);
    tile.view(plan, networks, textures, true);
}

/// \[channels\]\[stride\] to \[samples\]\[channels\], as many samples as there is room for.
fn to_pixels(rows: &[f32], stride: usize, channels: usize, pixels: &mut [f32]) {
    for (k, pixel) in pixels.chunks_mut(channels).enumerate() {
        for (c, value) in pixel.iter_mut().enumerate() {
            *value = rows[c * stride + k];
        }
    }
}

/// \[samples\]\[channels\] to \[channels\]\[stride\].
fn to_rows(pixels: &[f32], channels: usize, stride: usize, rows: &mut [f32]) {
    for (c, row) in rows.chunks_mut(stride).enumerate() {
        for (value, pixel) in row.iter_mut().zip(pixels.chunks(channels)) {
            *value = pixel[c];
        }
    }
}
