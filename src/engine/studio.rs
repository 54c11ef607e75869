//! Training steps of a decoder that reads neighbours: piece by piece, each one's images at once on all cores.

use super::backward::Record;
use super::batch::{Loss, Sums};
use super::images::{Canvas, Part, parts};
use super::networks::Networks;
use super::plan::Plan;
use super::textures::Textures;
use super::tile::{Queries, stride_of};
use crate::dataset::Block;
use crate::error::Result;
use crate::kernels::loss;
use crate::query::grid::Mosaic;

/// Room for steps of one model.
#[derive(Debug, Default)]
pub(super) struct Studio {
    canvas: Canvas,
    /// Of all pieces of the last step, one behind the other.
    parts: Vec<Part>,
    used: usize,
    /// Queries as the piece has them.
    piece: Queries,
    /// \[3\]\[stride\], image by image.
    target: Vec<f32>,
    by_rgb: Vec<f32>,
    /// Of one image, without its margin: prediction, target and gradient \[3\]\[pixels\].
    cropped: [Vec<f32>; 3],
    loss: loss::Scratch,
}

impl Studio {
    /// As [`super::Batch::gradients`], but for the textures: those wait in the records.
    pub fn gradients(
        &mut self,
        plan: &Plan,
        networks: &Networks,
        textures: &Textures,
        pieces: &[Block],
        loss: &Loss,
        sums: &mut Sums,
    ) -> Result<f64> {
        sums.networks.fill(0.0);
        self.used = 0;
        let mut total = 0.0;
        let counts = |p: &&Block| loss.highest_level.is_none_or(|most| p.level() <= most as f32);
        for piece in pieces.iter().filter(counts) {
            let mosaic = piece.layout().mosaic();
            self.load(plan, piece, mosaic, loss.range);
            self.canvas.forward(plan, networks, textures, mosaic, true)?;
            total += self.compare(plan, piece, mosaic, loss);
            let first = self.used;
            self.used += parts(mosaic.samples());
            self.parts.resize_with(self.parts.len().max(self.used), Part::default);
            let parts = &mut self.parts[first..self.used];
            let of_offset = sums.networks.len() - networks.convolved();
            let (offset, decoder) = sums.networks.split_at_mut(of_offset);
            self.canvas.backward(plan, networks, textures, mosaic, &self.by_rgb, decoder, parts)?;
            for part in parts {
                offset.iter_mut().zip(&part.weights).for_each(|(sum, part)| *sum += part);
            }
        }
        Ok(total)
    }

    /// What the textures are to be added, in order.
    pub fn records(&self) -> impl Iterator<Item = &[Record; 2]> + Clone + Sync {
        self.parts[..self.used].iter().flat_map(|part| &part.records[..part.used])
    }

    /// Queries and targets of a piece in the order of its images, as rows.
    fn load(&mut self, plan: &Plan, piece: &Block, mosaic: Mosaic, [low, high]: [f32; 2]) {
        let (samples, stride) = (mosaic.samples(), stride_of(mosaic.samples()));
        self.piece.resize(stride);
        let [ux, wix, wox] =
            [&mut self.piece.u, &mut self.piece.wi, &mut self.piece.wo].map(|pair| pair.split_at_mut(stride));
        let rows = [ux.0, ux.1, wix.0, wix.1, wox.0, wox.1].map(|row| &mut row[..samples]);
        piece.layout().rows(plan.architecture.resolution, rows);

        let queries = &mut self.canvas.queries;
        queries.resize(stride);
        queries.level.fill(piece.level().min(plan.architecture.coarsest() as f32));
        let pairs = [
            (&mut queries.u, &self.piece.u),
            (&mut queries.wi, &self.piece.wi),
            (&mut queries.wo, &self.piece.wo),
        ];
        for (to, from) in pairs {
            for (to, from) in to.chunks_mut(stride).zip(from.chunks(stride)) {
                for (to, start) in to.chunks_mut(mosaic.width).zip(mosaic.rows()) {
                    to.copy_from_slice(&from[start..start + mosaic.width]);
                }
                // What pads the rows asks something harmless and teaches nothing.
                to[samples..].fill(0.0);
            }
        }
        self.target.resize(3 * stride, 0.0);
        for (c, to) in self.target.chunks_mut(stride).enumerate() {
            for (to, start) in to.chunks_mut(mosaic.width).zip(mosaic.rows()) {
                for (to, pixel) in to.iter_mut().zip(&piece.rgb()[start..]) {
                    *to = pixel[c].to_f32().clamp(low, high);
                }
            }
        }
        self.by_rgb.clear();
        self.by_rgb.resize(3 * stride, 0.0);
    }

    /// Loss of the loaded piece and its gradient by the RGB of the canvas.
    fn compare(&mut self, plan: &Plan, piece: &Block, mosaic: Mosaic, loss: &Loss) -> f64 {
        let Mosaic { height, width, .. } = mosaic;
        let stride = self.by_rgb.len() / 3;
        let radius = plan.architecture.neighbourhood().unwrap_or(0);
        let margin = piece.layout().margin(radius, plan.architecture.resolution);
        let side = height.saturating_sub(2 * margin);
        if side == 0 {
            return 0.0;
        }
        let mut total = 0.0;
        for image in 0..mosaic.images() {
            let line = |row: usize| {
                let start = (image * height + margin + row) * width + margin;
                start..start + side
            };
            let [prediction, target, gradient] = &mut self.cropped;
            for (to, from) in [(&mut *prediction, &self.canvas.rgb), (&mut *target, &self.target)] {
                to.clear();
                for plane in from.chunks(stride) {
                    (0..side).for_each(|row| to.extend_from_slice(&plane[line(row)]));
                }
            }
            gradient.resize(3 * side * side, 0.0);
            let (r, rest) = gradient.split_at_mut(side * side);
            let (g, b) = rest.split_at_mut(side * side);
            let of = |c: usize| c * side * side..(c + 1) * side * side;
            total += loss::run(
                plan.isa,
                loss.terms,
                side,
                side,
                1.0,
                [0, 1, 2].map(|c| &prediction[of(c)]),
                [0, 1, 2].map(|c| &target[of(c)]),
                [r, g, b],
                &mut self.loss,
            );
            for (to, from) in self.by_rgb.chunks_mut(stride).zip(gradient.chunks(side * side)) {
                for (row, from) in from.chunks(side).enumerate() {
                    to[line(row)].copy_from_slice(from);
                }
            }
        }
        total
    }
}
