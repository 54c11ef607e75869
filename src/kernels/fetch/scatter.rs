//! Gradients of features back to the texels that they were mixed from.

use super::{Taps, padded};
use crate::kernels::simd::{Isa, Simd, TEXEL, Work, dispatch};

/// Samples between asking for a texel's line and adding to it.
const AHEAD: usize = 8;

/// Texels of a block of a gradient table: blocks go to owners in turn, and each owner adds to its own alone.
pub const OWNED: usize = 512;

/// The blocks of a gradient table that one owner adds to: those whose number is `number` modulo `owners`, a power of two.
#[derive(Debug)]
pub struct Owned<'a> {
    number: usize,
    owners: usize,
    stride: usize,
    blocks: Vec<&'a mut [f32]>,
}

impl<'a> Owned<'a> {
    /// Splits a table of texels of `stride` floats, a multiple of 8, among owners: as many, or up to the next power of two.
    pub fn split(table: &'a mut [f32], stride: usize, owners: usize) -> Vec<Self> {
        let owners = owners.max(1).next_power_of_two();
        let mut all: Vec<Self> =
            (0..owners).map(|number| Self { number, owners, stride, blocks: Vec::new() }).collect();
        for (k, block) in table.chunks_mut(OWNED * stride).enumerate() {
            all[k % owners].blocks.push(block);
        }
        all
    }

    /// Adds the gradients of samples' features to the texels that this owner has. `gradients` holds `stride` floats a
    /// sample. Called for samples in one order, every texel has one sum, whoever owns it.
    pub fn scatter(&mut self, isa: Isa, taps: &[Taps], gradients: &[f32]) {
        dispatch(isa, Scatter { owned: self, taps, gradients });
    }
}

struct Scatter<'a, 'b> {
    owned: &'a mut Owned<'b>,
    taps: &'a [Taps],
    gradients: &'a [f32],
}

impl Work for Scatter<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let Owned { number, owners, stride, blocks } = self.owned;
        // A division by a number that is not known here would cost as much as the sum.
        let (mask, shift) = (*owners - 1, owners.trailing_zeros());
        for (k, (taps, gradient)) in self.taps.iter().zip(self.gradients.chunks_exact(*stride)).enumerate() {
            if let Some(taps) = self.taps.get(k + AHEAD) {
                for index in taps.index() {
                    let (block, texel) = (index as usize / OWNED, index as usize % OWNED);
                    if block & mask == *number
                        && let Some(block) = blocks.get(block >> shift)
                    {
                        s.prefetch(block, texel * *stride);
                    }
                }
            }
            if taps.weight() == [0.0; 4] {
                continue;
            }
            for (index, weight) in taps.index().into_iter().zip(taps.weight()) {
                let (block, texel) = (index as usize / OWNED, index as usize % OWNED);
                if block & mask != *number {
                    continue;
                }
                let Some(block) = blocks.get_mut(block >> shift) else { continue };
                let Some(texel) = block.get_mut(texel * *stride..(texel + 1) * *stride) else { continue };
                for (sum, part) in
                    texel.as_chunks_mut::<TEXEL>().0.iter_mut().zip(gradient.as_chunks::<TEXEL>().0)
                {
                    let value = s.texel_fma(s.texel_load(part), s.texel_splat(weight), s.texel_load(sum));
                    s.texel_store(sum, value);
                }
            }
        }
    }
}

/// Rows \[channels\]\[stride\] as \[samples\]\[padded channels\], zeros in the padding.
pub fn by_sample(isa: Isa, stride: usize, channels: usize, rows: &[f32], out: &mut [f32]) {
    dispatch(isa, BySample { stride, channels, rows, out });
}

struct BySample<'a> {
    stride: usize,
    channels: usize,
    rows: &'a [f32],
    out: &'a mut [f32],
}

impl Work for BySample<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let wide = padded(self.channels);
        for channel in (0..self.channels).step_by(TEXEL) {
            for at in (0..self.stride).step_by(TEXEL) {
                let mut rows = [s.texel_splat(0.0); TEXEL];
                for (c, row) in rows.iter_mut().enumerate().take(self.channels - channel) {
                    let first = (channel + c) * self.stride + at;
                    if let Some(eight) = self.rows[first..].first_chunk() {
                        *row = s.texel_load(eight);
                    }
                }
                for (k, sample) in s.transpose(rows).into_iter().enumerate() {
                    if let Some(eight) = self.out[(at + k) * wide + channel..].first_chunk_mut() {
                        s.texel_store(eight, sample);
                    }
                }
            }
        }
    }
}
