//! A tile of samples on its way through the model. Rows of `stride` samples, one buffer a stage.

use super::networks::Networks;
use super::plan::Plan;
use super::textures::Textures;
use crate::kernels::encoding_rows::{Factor, encode};
use crate::kernels::fetch::{Aim, Found, Places, Taps, aim, read};
use crate::kernels::mlp::{End, Packed, STEP, Start};
use crate::kernels::{output, rows};
use neumip_export::config::DirectionEncoding;
use std::ops::Range;

/// Queries of a tile, as rows \[stride\].
#[derive(Clone, Debug, Default)]
pub(super) struct Queries {
    /// Wrapped positions \[2\]\[stride\].
    pub u: Vec<f32>,
    pub level: Vec<f32>,
    /// Directions \[2\]\[stride\].
    pub wi: Vec<f32>,
    pub wo: Vec<f32>,
}

impl Queries {
    pub fn resize(&mut self, stride: usize) {
        self.level.resize(stride, 0.0);
        for pair in [&mut self.u, &mut self.wi, &mut self.wo] {
            pair.resize(2 * stride, 0.0);
        }
    }

    /// Takes a part of longer rows.
    pub fn copy(&mut self, from: &Self, stride: usize, part: Range<usize>) {
        self.level.copy_from_slice(&from.level[part.clone()]);
        let pairs = [(&mut self.u, &from.u), (&mut self.wi, &from.wi), (&mut self.wo, &from.wo)];
        for (to, from) in pairs {
            for (to, from) in to.chunks_mut(part.len()).zip(from.chunks(stride)) {
                to.copy_from_slice(&from[part.clone()]);
            }
        }
    }
}

/// Everything that the backward pass needs of the forward pass, and room for both.
#[derive(Debug, Default)]
pub(super) struct Tile {
    pub stride: usize,
    pub queries: Queries,
    /// Features of the offset texture and wo \[channels + 2\]\[stride\].
    pub offset_input: Vec<f32>,
    pub offset_hidden: Vec<Vec<f32>>,
    /// How far a unit of depth moves u \[2\]\[stride\].
    pub reach: Vec<f32>,
    /// Features, gamma(u), gamma(wi), gamma(wo) \[inputs\]\[stride\].
    pub input: Vec<f32>,
    pub hidden: Vec<Vec<f32>>,
    /// The decoder's outputs \[3 or 6\]\[stride\].
    pub outputs: Vec<f32>,
    /// \[3\]\[stride\].
    pub rgb: Vec<f32>,
    /// Slopes of the features along u \[2\]\[channels\]\[stride\].
    pub slopes: Vec<f32>,
    pub pyramid_taps: Vec<Taps>,
    pub offset_taps: Vec<Taps>,
    /// Sums of the decoder's first layer that do not depend on wi.
    pub partial: Vec<f32>,
    aim: Aim,
    depth: Vec<f32>,
    position: Vec<f32>,
    scratch: Vec<f32>,
    zeros: Vec<f32>,
}

/// Samples of a tile that holds `n`.
pub(super) fn stride_of(n: usize) -> usize {
    n.next_multiple_of(STEP).max(STEP)
}

impl Tile {
    /// Makes room for tiles of `stride` samples.
    pub fn resize(&mut self, plan: &Plan, networks: &Networks, stride: usize, training: bool) {
        if self.stride == stride {
            return;
        }
        self.stride = stride;
        self.queries.resize(stride);
        let hidden = |layers: &[Packed]| -> Vec<Vec<f32>> {
            layers.iter().rev().skip(1).rev().map(|l| vec![0.0; l.outputs() * stride]).collect()
        };
        let channels = plan.channels();
        let room = |rows: usize| vec![0.0; rows * stride];
        self.offset_input = room(plan.offset.map_or(0, |(c, _)| c + 2));
        self.offset_hidden = hidden(&networks.offset);
        self.reach = room(2);
        self.input = room(plan.architecture.decoder_inputs());
        self.hidden = hidden(&networks.decoder);
        self.outputs = room(plan.architecture.decoder_outputs());
        self.rgb = room(3);
        self.partial = room(networks.first_outputs());
        (self.depth, self.position) = (room(1), room(2));
        (self.scratch, self.zeros) = (room(3), room(1));
        if training {
            self.slopes = room(2 * channels);
            self.pyramid_taps = vec![Taps::default(); 2 * stride];
            self.offset_taps = vec![Taps::default(); if plan.offset.is_some() { stride } else { 0 }];
        }
    }

    /// From the queries to RGB, not clamped.
    pub fn forward(&mut self, plan: &Plan, networks: &Networks, textures: &Textures) {
        self.view(plan, networks, textures, true);
        let stride = self.stride;
        run(&networks.decoder, stride, &self.input, &mut self.hidden, &mut self.outputs);
        output::rgb(plan.isa, plan.output, stride, &self.outputs, &mut self.rgb);
    }

    /// What does not depend on wi, down to the partial sums of the decoder's first layer.
    pub fn prepare(&mut self, plan: &Plan, networks: &Networks, textures: &Textures) {
        self.view(plan, networks, textures, false);
        if let Some((first, _)) = &networks.first {
            first.apply(self.stride, &self.input, Start::Bias, End::Linear, &mut self.partial);
        }
    }

    /// RGB from the partial sums and wi.
    pub fn light(&mut self, plan: &Plan, networks: &Networks) {
        self.directions(plan, Which::Light);
        let stride = self.stride;
        let (Some((_, second)), Some((_, rest))) = (&networks.first, networks.decoder.split_first()) else {
            return;
        };
        let [hidden, others @ ..] = &mut self.hidden[..] else { return };
        let light = &self.input[plan.wi.start * stride..];
        second.apply(stride, light, Start::Rows(&self.partial), End::Relu, hidden);
        run(rest, stride, hidden, others, &mut self.outputs);
        output::rgb(plan.isa, plan.output, stride, &self.outputs, &mut self.rgb);
    }

    /// The decoder's input, gamma(wi) only if asked for. Encodings are computed while texels are on their way.
    pub fn view(&mut self, plan: &Plan, networks: &Networks, textures: &Textures, light: bool) {
        let (stride, isa) = (self.stride, plan.isa);
        let parallax = plan.offset.zip(textures.offset.as_ref());
        if let Some(((channels, _), texture)) = parallax {
            let (x, y) = self.queries.u.split_at(stride);
            aim(isa, stride, channels, texture, Places { x, y, level: &self.zeros }, &mut self.aim);
        }
        self.positions(plan);
        if let Some(((channels, parallax), texture)) = parallax {
            let (features, wo) = self.offset_input.split_at_mut(channels * stride);
            wo.copy_from_slice(&self.queries.wo);
            let found = Found { features, slopes: &mut [], taps: &mut self.offset_taps };
            read(isa, stride, channels, texture, &self.aim, found);
            run(&networks.offset, stride, &self.offset_input, &mut self.offset_hidden, &mut self.depth);
            let z = &mut self.scratch[..stride];
            let (wx, wy) = self.queries.wo.split_at(stride);
            rows::height(isa, wx, wy, z);
            let halves = self.reach.chunks_mut(stride).zip(self.position.chunks_mut(stride));
            let of_u = self.queries.u.chunks(stride);
            for ((reach, position), (w, u)) in halves.zip([wx, wy].into_iter().zip(of_u)) {
                parallax.reach(isa, w, z, reach);
                rows::multiply_add(isa, u, reach, &self.depth, position);
            }
        }
        let channels = plan.channels();
        let looked_at = if parallax.is_some() { &self.position } else { &self.queries.u };
        let (x, y) = looked_at.split_at(stride);
        let finest = plan.architecture.model.texture.finest as f32;
        let level = if finest > 0.0 {
            let level = &mut self.scratch[..stride];
            for (to, from) in level.iter_mut().zip(&self.queries.level) {
                *to = (from - finest).max(0.0);
            }
            level
        } else {
            &mut self.queries.level[..]
        };
        let places = Places { x, y, level };
        aim(isa, stride, channels, &textures.pyramid, places, &mut self.aim);
        self.directions(plan, Which::View);
        if light {
            self.directions(plan, Which::Light);
        }
        let features = &mut self.input[..channels * stride];
        let found = Found { features, slopes: &mut self.slopes, taps: &mut self.pyramid_taps };
        read(isa, stride, channels, &textures.pyramid, &self.aim, found);
    }

    /// gamma(u).
    fn positions(&mut self, plan: &Plan) {
        let (stride, isa) = (self.stride, plan.isa);
        let config = &plan.architecture.model.encoding;
        let bands = plan.architecture.u_bands();
        let out = &mut self.input[plan.u.start * stride..plan.u.end * stride];
        if out.is_empty() {
            return;
        }
        let p = &mut self.scratch[..2 * stride];
        rows::affine(isa, &self.queries.u, 2.0, -1.0, p);
        let factor = match config.u.attenuate {
            true => Factor::Footprint(&self.queries.level, plan.sigma),
            false => Factor::Amplitude(1.0),
        };
        encode(isa, stride, p, bands, config.pi, factor, out);
        if config.u.raw {
            out[4 * bands * stride..].copy_from_slice(p);
        }
    }

    /// gamma of one direction.
    fn directions(&mut self, plan: &Plan, which: Which) {
        let (stride, isa) = (self.stride, plan.isa);
        let encoding = &plan.architecture.model.encoding;
        let (w, config, range): (_, &DirectionEncoding, _) = match which {
            Which::Light => (&self.queries.wi, &encoding.wi, &plan.wi),
            Which::View => (&self.queries.wo, &encoding.wo, &plan.wo),
        };
        let full = &mut self.scratch[..encoding.components * stride];
        full[..2 * stride].copy_from_slice(w);
        if encoding.components == 3 {
            let (x, y) = w.split_at(stride);
            rows::height(isa, x, y, &mut full[2 * stride..]);
        }
        let out = &mut self.input[range.start * stride..range.end * stride];
        let waves = 2 * encoding.components * config.bands * stride;
        encode(isa, stride, full, config.bands, encoding.pi, Factor::Amplitude(config.amplitude), out);
        if config.raw {
            out[waves..].copy_from_slice(full);
        }
    }
}

#[derive(Clone, Copy)]
enum Which {
    Light,
    View,
}

/// All layers of a network: ReLU between them, the last one linear.
fn run(layers: &[Packed], stride: usize, input: &[f32], hidden: &mut [Vec<f32>], out: &mut [f32]) {
    let mut x = input;
    let mut rooms = hidden.iter_mut();
    for layer in layers {
        match rooms.next() {
            Some(room) => {
                layer.apply(stride, x, Start::Bias, End::Relu, room);
                x = room;
            }
            None => layer.apply(stride, x, Start::Bias, End::Linear, out),
        }
    }
}
