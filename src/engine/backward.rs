//! The backward pass of a tile: from the gradient by RGB to those of weights, and of features sample by sample.

use super::networks::Networks;
use super::plan::Plan;
use super::tile::Tile;
use crate::kernels::fetch::{Taps, by_sample, padded};
use crate::kernels::mlp::{End, Packed, Start, weight_gradient};
use crate::kernels::{output, rows};

/// Room for gradients of activations.
#[derive(Debug, Default)]
pub(super) struct Room {
    pub here: Vec<f32>,
    next: Vec<f32>,
}

/// What samples of a tile add to a texture: one gradient a sample, one or two sets of taps each.
#[derive(Debug, Default)]
pub(super) struct Record {
    /// \[levels\]\[samples\].
    pub taps: Vec<Taps>,
    /// \[samples\]\[padded channels\].
    pub gradients: Vec<f32>,
}

impl Record {
    /// Takes a tile's taps, leaving room for the next ones.
    fn set(&mut self, plan: &Plan, stride: usize, channels: usize, taps: &mut Vec<Taps>, rows: &[f32]) {
        self.taps.resize(taps.len(), Taps::default());
        std::mem::swap(&mut self.taps, taps);
        self.gradients.resize(stride * padded(channels), 0.0);
        by_sample(plan.isa, stride, channels, rows, &mut self.gradients);
    }
}

/// Goes back through a tile whose forward pass has run. `by_rgb` is the gradient \[3\]\[stride\]; `weights` the gradients of
/// all layers, weight and bias in turn, the offset network's first, to which it adds. The two records are of the pyramid
/// and of the offset texture.
pub(super) fn backward(
    tile: &mut Tile,
    plan: &Plan,
    networks: &Networks,
    by_rgb: &[f32],
    weights: &mut [f32],
    records: [&mut Record; 2],
    room: &mut Room,
) {
    let (stride, isa) = (tile.stride, plan.isa);
    let (of_offset, of_decoder) = weights.split_at_mut(networks.offset.iter().map(size).sum());
    room.here.resize(tile.outputs.len(), 0.0);
    output::gradient(isa, plan.output, stride, &tile.outputs, by_rgb, &mut room.here);
    through(
        &networks.decoder,
        &networks.decoder_back,
        stride,
        &tile.input,
        &tile.hidden,
        of_decoder,
        room,
        isa,
    );
    features_backward(tile, plan, networks, of_offset, records, room);
}

/// Goes back from the decoder's inputs: `room.here` is the gradient of the features.
pub(super) fn features_backward(
    tile: &mut Tile,
    plan: &Plan,
    networks: &Networks,
    of_offset: &mut [f32],
    [pyramid, offset]: [&mut Record; 2],
    room: &mut Room,
) {
    let (stride, isa) = (tile.stride, plan.isa);
    pyramid.set(plan, stride, plan.channels(), &mut tile.pyramid_taps, &room.here);
    if let Some((channels, _)) = plan.offset {
        room.next.resize(stride, 0.0);
        let gradient = &room.here[..plan.channels() * stride];
        rows::parallax_gradient(isa, stride, gradient, &tile.slopes, &tile.reach, &mut room.next);
        std::mem::swap(&mut room.here, &mut room.next);
        through(
            &networks.offset,
            &networks.offset_back,
            stride,
            &tile.offset_input,
            &tile.offset_hidden,
            of_offset,
            room,
            isa,
        );
        offset.set(plan, stride, channels, &mut tile.offset_taps, &room.here);
    }
}

/// Weights and biases of a layer.
pub(super) fn size(layer: &Packed) -> usize {
    (layer.inputs() + 1) * layer.outputs()
}

/// Back through a network: `room.here` is the gradient of its outputs and becomes that of its learned inputs.
#[expect(clippy::too_many_arguments, reason = "two networks with all that belongs to each")]
fn through(
    layers: &[Packed],
    back: &[Packed],
    stride: usize,
    input: &[f32],
    hidden: &[Vec<f32>],
    mut weights: &mut [f32],
    room: &mut Room,
    isa: crate::kernels::simd::Isa,
) {
    for (i, layer) in layers.iter().enumerate().rev() {
        let (rest, of_layer) = weights.split_at_mut(weights.len() - size(layer));
        weights = rest;
        let (weight, bias) = of_layer.split_at_mut(layer.inputs() * layer.outputs());
        let (x, end) = match i.checked_sub(1) {
            Some(before) => (&hidden[before][..], End::Where(&hidden[before])),
            None => (input, End::Linear),
        };
        weight_gradient(isa, stride, x, &room.here, weight, bias);
        room.next.resize(back[i].outputs() * stride, 0.0);
        back[i].apply(stride, &room.here, Start::Bias, end, &mut room.next);
        std::mem::swap(&mut room.here, &mut room.next);
    }
}
