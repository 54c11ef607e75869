//! Heights in single precision as lanes read them: the samples, and what nothing under a block rises above.

use crate::kernels::simd::Simd;
use crate::reference::heightfield::Heightfield;

/// What single precision takes from heights along a ray: they reach 1, and a handful of roundings of 6e-8 each go into
/// one.
const HEIGHT_SLACK: f32 = 1e-6;

/// What it takes from positions, as a share of the tile: a handful of roundings of half of this.
const PLACE_SLACK: f32 = 4.0 * f32::EPSILON;

/// Height of blocks that lie outside the tile: below every surface.
const NOTHING: f32 = -2.0;

/// Bits 2, 4, 6, ...: sums of powers of four are cut out of them.
const POWERS: i32 = 0x5555_5554;

/// Samples of a field, and maxima over blocks of 2^level x 2^level patches, all levels one after the other. Levels are
/// padded to sides that are powers of two, so that where a block lies follows from its level without a table. Maxima
/// are raised by the slack: a ray that is above one in single precision is above it in double precision.
#[derive(Clone, Debug)]
pub(super) struct Heights {
    /// The first row and column are repeated behind the last.
    samples: Vec<f32>,
    /// Samples in a row.
    columns: usize,
    maxima: Vec<f32>,
    /// Patches in a row of the finest level.
    width: usize,
    /// Patches of the finest level.
    patches: usize,
    /// By how much heights over the surface in single precision may differ from those in double precision.
    slack: f32,
    /// Side of the largest blocks, in patches.
    pub largest: usize,
}

impl Heights {
    pub fn new(field: &Heightfield) -> Self {
        let map = field.height_map();
        let (rows, columns) = (map.height + 1, map.width + 1);
        let samples: Vec<f32> = (0..rows * columns)
            .map(|k| map.values[k / columns % map.height * map.width + k % columns % map.width])
            .collect();
        let (width, height) = (map.width.next_power_of_two(), map.height.next_power_of_two());
        let mut maxima = vec![NOTHING; width * height];
        let mut steepest = 0.0_f32;
        for i in 0..map.height {
            for j in 0..map.width {
                let at = i * columns + j;
                let corners =
                    [samples[at], samples[at + 1], samples[at + columns], samples[at + columns + 1]];
                let most = corners.into_iter().fold(f32::NEG_INFINITY, f32::max);
                steepest = steepest.max(most - corners.into_iter().fold(f32::INFINITY, f32::min));
                maxima[i * width + j] = most;
            }
        }
        let slack = HEIGHT_SLACK + steepest * PLACE_SLACK * map.width.max(map.height) as f32;
        for most in maxima.iter_mut().filter(|most| **most > NOTHING) {
            *most += slack;
        }
        let largest = width.min(height);
        let (mut base, mut side, mut high) = (0, width, height);
        for _ in 0..largest.ilog2() {
            let next = maxima.len();
            for i in 0..high / 2 {
                for j in 0..side / 2 {
                    let at = base + 2 * (i * side + j);
                    let near = maxima[at].max(maxima[at + 1]);
                    maxima.push(near.max(maxima[at + side].max(maxima[at + side + 1])));
                }
            }
            (base, side, high) = (next, side / 2, high / 2);
        }
        Self { samples, columns, maxima, width, patches: width * height, slack, largest }
    }

    /// Heights h00, h10, h01, h11 at the corners of a patch; those of the last one where there is no such patch.
    #[inline(always)]
    pub fn corners(&self, row: usize, column: usize) -> [f32; 4] {
        let row = row.min(self.samples.len() / self.columns - 2);
        let (_, rows) = self.samples.split_at(row * self.columns);
        let (near, far) = rows.split_at(self.columns);
        let column = column.min(self.columns - 2);
        [near[column], near[column + 1], far[column], far[column + 1]]
    }

    #[inline(always)]
    pub fn lanes<S: Simd>(&self, s: S) -> Lanes<'_, S> {
        let powers = if self.patches.ilog2().is_multiple_of(2) { POWERS } else { POWERS << 1 };
        Lanes {
            samples: &self.samples,
            maxima: &self.maxima,
            width: s.splat(self.width as f32),
            columns: s.int(self.columns as i32),
            four_patches: s.splat(4.0 * self.patches as f32),
            four_patches_whole: s.int(4 * self.patches as i32),
            powers: s.int(powers),
            slack: s.splat(self.slack),
        }
    }
}

/// [`Heights`] as lanes read them.
#[derive(Clone, Copy)]
pub(super) struct Lanes<'a, S: Simd> {
    samples: &'a [f32],
    maxima: &'a [f32],
    width: S::F,
    columns: S::I,
    four_patches: S::F,
    four_patches_whole: S::I,
    powers: S::I,
    pub slack: S::F,
}

impl<S: Simd> Lanes<'_, S> {
    /// Largest heights under the blocks whose first patches are (`top`, `left`); `inverse` is 1 / their side.
    #[inline(always)]
    pub fn most(&self, s: S, top: S::F, left: S::F, inverse: S::F) -> S::F {
        // The levels before theirs hold A (1 + 1/4 + ...) = 4/3 (A - A / side^2) blocks if the finest holds A: a sum of
        // powers of four.
        let theirs = s.truncate(s.mul(self.four_patches, s.mul(inverse, inverse)));
        let base = s.int_and(self.powers, s.int_sub(self.four_patches_whole, theirs));
        // Whole numbers up to 2^24 and their products with powers of two: nothing is rounded.
        let inside = s.mul(s.add(s.mul(top, s.mul(self.width, inverse)), left), inverse);
        s.gather(self.maxima, s.int_add(base, s.truncate(inside)))
    }

    /// Heights at the first corners of patches, their rises along x and along y from there, and their two-way differences.
    #[inline(always)]
    pub fn patches(&self, s: S, row: S::I, column: S::I) -> [S::F; 4] {
        let at = s.int_add(s.int_mul(row, self.columns), column);
        let (h00, h10) = s.gather_pairs(self.samples, at);
        let (h01, h11) = s.gather_pairs(self.samples, s.int_add(at, self.columns));
        let (rise_x, rise_y) = (s.sub(h10, h00), s.sub(h01, h00));
        [h00, rise_x, rise_y, s.sub(s.sub(h11, h01), rise_x)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::simd::{Isa, Work, dispatch};
    use crate::random::{Random, Stream};
    use crate::reference::heightfield::HeightMap;

    /// Largest height that lanes see under one block.
    struct Most<'a>(&'a Heights, [usize; 2], usize);

    impl Work for Most<'_> {
        type Output = f32;

        #[inline(always)]
        fn run<S: Simd>(self, s: S) -> f32 {
            let Self(heights, [top, left], side) = self;
            let splat = |x: usize| s.splat(x as f32);
            let mut out = [0.0; 16];
            let inverse = s.splat(1.0 / side as f32);
            s.store(&mut out, heights.lanes(s).most(s, splat(top), splat(left), inverse));
            out[S::LANES - 1]
        }
    }

    #[test]
    fn blocks_of_every_level_are_found_and_bound_their_patches() {
        for (rows, columns) in [(13, 6), (8, 16), (5, 2), (33, 32)] {
            let mut random = Random::new(2, Stream::Probe, rows as u64);
            let values = (0..rows * columns).map(|_| random.uniform() - 0.5).collect();
            let field = Heightfield::new(&HeightMap { height: rows, width: columns, values }).unwrap();
            let heights = Heights::new(&field);
            for isa in Isa::all() {
                let mut side = 1;
                while side <= heights.largest {
                    for (i, j) in (0..rows * columns).map(|k| (k / columns, k % columns)) {
                        let (top, left) = (i / side * side, j / side * side);
                        let inside = (top..(top + side).min(rows))
                            .flat_map(|i| (left..(left + side).min(columns)).map(move |j| (i, j)));
                        let want = inside.map(|(i, j)| field.patch_max(i, j)).reduce(f32::max).unwrap();
                        let got = dispatch(isa, Most(&heights, [top, left], side));
                        assert_eq!(got, want + heights.slack, "{rows} x {columns}, {side}, {i}, {j}");
                    }
                    side *= 2;
                }
            }
        }
    }
}
