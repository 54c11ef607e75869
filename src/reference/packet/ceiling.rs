//! Heights that nothing under a block rises above, in single precision, laid out for lanes that look at blocks of
//! different sizes at once.

use crate::kernels::simd::Simd;
use crate::reference::heightfield::Heightfield;

/// What single precision takes from heights along a ray: heights reach 1, and a handful of roundings of 6e-8 each go
/// into one, besides those of the end of the slab.
const HEIGHT_SLACK: f32 = 1e-6;

/// What it takes from positions: a few roundings of numbers as large as the tile, as a share of the tile.
const PLACE_SLACK: f32 = 4.0 * f32::EPSILON;

/// Height of blocks that lie outside the tile.
const NOTHING: f32 = -2.0;

/// Bits 2, 4, 6, ...: sums of powers of four are cut out of them.
const POWERS: i32 = 0x5555_5554;

/// Maxima over blocks of 2^level x 2^level patches, all levels one after the other. Sides are padded to powers of two,
/// so that where a block lies follows from its level without a table.
#[derive(Clone, Debug)]
pub(super) struct Ceiling {
    values: Vec<f32>,
    width: usize,
    patches: usize,
    /// Level of the largest blocks.
    pub top: u32,
}

impl Ceiling {
    pub fn new(field: &Heightfield) -> Self {
        let (width, height) = (field.width.next_power_of_two(), field.height.next_power_of_two());
        let top = width.min(height).ilog2();
        let mut finest = vec![NOTHING; width * height];
        let mut steepest = 0.0_f32;
        for i in 0..field.height {
            for j in 0..field.width {
                let most = field.patch_max(i, j);
                steepest = steepest.max(most - field.patch_min(i, j));
                finest[i * width + j] = most;
            }
        }
        let slack = HEIGHT_SLACK + steepest * PLACE_SLACK * field.width.max(field.height) as f32;
        for value in finest.iter_mut().filter(|value| **value > NOTHING) {
            *value += slack;
        }
        let mut values = finest;
        let (mut base, mut side, mut rows) = (0, width, height);
        for _ in 0..top {
            let next = values.len();
            for i in 0..rows / 2 {
                for j in 0..side / 2 {
                    let at = base + 2 * i * side + 2 * j;
                    let (near, far) = (values[at].max(values[at + 1]), values[at + side].max(values[at + side + 1]));
                    values.push(near.max(far));
                }
            }
            (base, side, rows) = (next, side / 2, rows / 2);
        }
        Self { values, width, patches: width * height, top }
    }
}

/// [`Ceiling`] as lanes read it.
#[derive(Clone, Copy)]
pub(super) struct Blocks<'a, S: Simd> {
    values: &'a [f32],
    width: S::F,
    four_patches: S::F,
    four_patches_int: S::I,
    powers: S::I,
}

impl Ceiling {
    #[inline(always)]
    pub fn blocks<S: Simd>(&self, s: S) -> Blocks<'_, S> {
        let powers = if self.patches.ilog2() % 2 == 0 { POWERS } else { POWERS << 1 };
        Blocks {
            values: &self.values,
            width: s.splat(self.width as f32),
            four_patches: s.splat(4.0 * self.patches as f32),
            four_patches_int: s.int(4 * self.patches as i32),
            powers: s.int(powers),
        }
    }
}

impl<S: Simd> Blocks<'_, S> {
    /// Largest heights under the blocks (`row`, `column`) of the level whose side's inverse is `inverse`.
    #[inline(always)]
    pub fn most(&self, s: S, row: S::F, column: S::F, inverse: S::F) -> S::F {
        // The levels before this one hold A (1 + 1/4 + ...) = 4/3 (A - A / side^2) blocks of A patches in all: a sum of
        // powers of four.
        let here = s.truncate(s.mul(self.four_patches, s.mul(inverse, inverse)));
        let base = s.int_and(self.powers, s.int_sub(self.four_patches_int, here));
        let inside = s.add(s.mul(row, s.mul(self.width, inverse)), column);
        s.gather(self.values, s.int_add(base, s.truncate(inside)))
    }
}
