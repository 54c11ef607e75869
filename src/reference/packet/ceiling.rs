//! Heights in single precision as lanes read them: the samples, and what nothing under a block rises above.

use crate::kernels::simd::Simd;
use crate::reference::heightfield::Heightfield;

/// What single precision takes from heights along a ray: heights reach 1, and a handful of roundings of 6e-8 each go
/// into one.
const HEIGHT_SLACK: f32 = 1e-6;

/// What it takes from positions: a few roundings of numbers as large as the tile, as a share of the tile.
const PLACE_SLACK: f32 = 4.0 * f32::EPSILON;

/// Height of blocks that lie outside the tile.
const NOTHING: f32 = -2.0;

/// Bits 2, 4, 6, ...: sums of powers of four are cut out of them.
const POWERS: i32 = 0x5555_5554;

/// Samples, and maxima over blocks of 2^level x 2^level patches, all levels one after the other. Sides of levels are
/// padded to powers of two, so that where a block lies follows from its level without a table.
#[derive(Clone, Debug)]
pub(super) struct Ceiling {
    samples: Vec<f32>,
    columns: usize,
    maxima: Vec<f32>,
    width: usize,
    patches: usize,
    /// By how much heights in single precision may differ from those in double precision.
    slack: f32,
    /// Side of the largest blocks.
    pub largest: usize,
}

impl Ceiling {
    pub fn new(field: &Heightfield) -> Self {
        let (width, height) = (field.width.next_power_of_two(), field.height.next_power_of_two());
        let largest = width.min(height);
        let map = field.height_map();
        let columns = field.width + 1;
        let at = |i: usize, j: usize| map.values[i % field.height * field.width + j % field.width];
        let samples: Vec<f32> = (0..(field.height + 1) * columns).map(|k| at(k / columns, k % columns)).collect();
        let mut finest = vec![NOTHING; width * height];
        let mut steepest = 0.0_f32;
        for i in 0..field.height {
            for j in 0..field.width {
                let corners = [at(i, j), at(i, j + 1), at(i + 1, j), at(i + 1, j + 1)];
                let most = corners.into_iter().fold(f32::NEG_INFINITY, f32::max);
                steepest = steepest.max(most - corners.into_iter().fold(f32::INFINITY, f32::min));
                finest[i * width + j] = most;
            }
        }
        let slack = HEIGHT_SLACK + steepest * PLACE_SLACK * width.max(height) as f32;
        for value in finest.iter_mut().filter(|value| **value > NOTHING) {
            *value += slack;
        }
        let mut maxima = finest;
        let (mut base, mut side, mut rows) = (0, width, height);
        for _ in 0..largest.ilog2() {
            let next = maxima.len();
            for i in 0..rows / 2 {
                for j in 0..side / 2 {
                    let at = base + 2 * i * side + 2 * j;
                    let (near, far) = (maxima[at].max(maxima[at + 1]), maxima[at + side].max(maxima[at + side + 1]));
                    maxima.push(near.max(far));
                }
            }
            (base, side, rows) = (next, side / 2, rows / 2);
        }
        Self { samples, columns, maxima, width, patches: width * height, slack, largest }
    }

    #[inline(always)]
    pub fn lanes<S: Simd>(&self, s: S) -> Heights<'_, S> {
        let powers = if self.patches.ilog2().is_multiple_of(2) { POWERS } else { POWERS << 1 };
        Heights {
            samples: &self.samples,
            maxima: &self.maxima,
            width: s.splat(self.width as f32),
            columns: s.int(self.columns as i32),
            four_patches: s.splat(4.0 * self.patches as f32),
            four_patches_int: s.int(4 * self.patches as i32),
            powers: s.int(powers),
            slack: s.splat(self.slack),
        }
    }

    /// Corners of the patch.
    #[inline(always)]
    pub fn corners(&self, row: usize, column: usize) -> [f32; 4] {
        let at = row * self.columns + column;
        match (self.samples.get(at..at + 2), self.samples.get(at + self.columns..at + self.columns + 2)) {
            (Some(near), Some(far)) => [near[0], near[1], far[0], far[1]],
            _ => [NOTHING; 4],
        }
    }
}

/// [`Ceiling`] as lanes read it.
#[derive(Clone, Copy)]
pub(super) struct Heights<'a, S: Simd> {
    samples: &'a [f32],
    maxima: &'a [f32],
    width: S::F,
    columns: S::I,
    four_patches: S::F,
    four_patches_int: S::I,
    powers: S::I,
    pub slack: S::F,
}

impl<S: Simd> Heights<'_, S> {
    /// Largest heights under the blocks whose first patches are (`top`, `left`), of the level whose side's inverse is
    /// `inverse`.
    #[inline(always)]
    pub fn most(&self, s: S, top: S::F, left: S::F, inverse: S::F) -> S::F {
        // The levels before this one hold A (1 + 1/4 + ...) = 4/3 (A - A / side^2) blocks of A patches in all: a sum of
        // powers of four.
        let here = s.truncate(s.mul(self.four_patches, s.mul(inverse, inverse)));
        let base = s.int_and(self.powers, s.int_sub(self.four_patches_int, here));
        let inside = s.mul(s.add(s.mul(top, s.mul(self.width, inverse)), left), inverse);
        s.gather(self.maxima, s.int_add(base, s.truncate(inside)))
    }

    /// Height at the corner, and the rises to its neighbours along x, along y, and along both less these two.
    #[inline(always)]
    pub fn patch(&self, s: S, row: S::I, column: S::I) -> [S::F; 4] {
        let at = s.int_add(s.int_mul(row, self.columns), column);
        let below = s.int_add(at, self.columns);
        let (h00, h10) = s.gather_pairs(self.samples, at);
        let (h01, h11) = s.gather_pairs(self.samples, below);
        let (rise_x, rise_y) = (s.sub(h10, h00), s.sub(h01, h00));
        [h00, rise_x, rise_y, s.sub(s.sub(h11, h01), rise_x)]
    }
}
