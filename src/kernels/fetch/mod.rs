//! Wrapped bilinear and trilinear lookups of tiles of samples, with the slopes along u, and the scatter of their gradients.
//!
//! Positions are computed with lanes as samples, texels are mixed with lanes as channels, and the result is transposed.

mod aim;
mod read;
mod scatter;
#[cfg(test)]
mod tests;

pub use aim::{Aim, aim};
pub use read::read;
pub use scatter::{OWNED, Owned, by_sample};

use super::simd::TEXEL;
use half::f16;

/// Samples of a tile come in multiples of this.
const GROUP: usize = 16;

/// Channels rounded up to whole texel vectors: floats a texel of gradient tables and half-precision textures.
pub fn padded(channels: usize) -> usize {
    channels.next_multiple_of(TEXEL)
}

/// Textures of which each is half the size of the one before: level l has max(1, side >> l) rows and columns.
#[derive(Clone, Debug)]
pub struct Pyramid<'a> {
    /// The levels, finest first.
    pub levels: Vec<Texels<'a>>,
    /// Rows of the finest.
    pub height: usize,
    /// Columns of the finest.
    pub width: usize,
}

/// Values of a texture, row by row.
#[derive(Clone, Copy, Debug)]
pub enum Texels<'a> {
    /// Single precision, `channels` values a texel.
    Single(&'a [f32]),
    /// Half precision, [`padded`] values a texel.
    Half(&'a [f16]),
}

/// Where a lookup read in one level: texels of the gradient table, and their weights.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Taps([f32; TEXEL]);

impl Taps {
    /// Texels (row 0, column 0), (0, 1), (1, 0), (1, 1); the levels follow one another in the table.
    #[inline(always)]
    pub fn index(&self) -> [u32; 4] {
        [0, 1, 2, 3].map(|k| self.0[k].to_bits())
    }

    /// Their weights.
    #[inline(always)]
    pub fn weight(&self) -> [f32; 4] {
        [4, 5, 6, 7].map(|k| self.0[k])
    }
}

/// Rows \[stride\] that say where a tile looks.
#[derive(Clone, Copy, Debug)]
pub struct Places<'a> {
    /// First component of the position.
    pub x: &'a [f32],
    /// Second component.
    pub y: &'a [f32],
    /// Level of each sample, clamped to what there is; what is no number counts as 0.
    pub level: &'a [f32],
}

/// What a lookup writes.
#[derive(Debug)]
pub struct Found<'a> {
    /// Features \[channels\]\[stride\].
    pub features: &'a mut [f32],
    /// Their slopes along x and y \[2\]\[channels\]\[stride\]; empty if they are not wanted.
    pub slopes: &'a mut [f32],
    /// Taps of the finer and the coarser level \[2\]\[stride\], or of one texture \[stride\]; empty if they are not wanted.
    pub taps: &'a mut [Taps],
}
