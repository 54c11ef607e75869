//! D and 4 D^T: a texture of half the sides, and back.

use super::super::simd::{Simd, TEXEL, Work};
use super::{Target, Texture, lanes, put, texel};

/// D: rows from `first` on of a texture of half the sides.
pub(super) struct Halve<'a> {
    pub from: &'a Texture<'a>,
    pub to: Target<'a>,
    pub first: usize,
}

impl Work for Halve<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let (height, width, stride) = (self.from.height, self.from.width, self.from.stride);
        let out_stride = self.to.stride;
        let (near, far) = (s.texel_splat(0.375), s.texel_splat(0.125));
        macro_rules! weighted {
            ($a:expr, $b:expr, $c:expr, $d:expr) => {
                s.texel_fma(s.texel_add($b, $c), near, s.texel_mul(s.texel_add($a, $d), far))
            };
        }
        for group in 0..self.to.channels / TEXEL {
            let outs = self.to.values.chunks_exact_mut(width / 2 * out_stride);
            for (i, out) in outs.enumerate() {
                let mut rows = [0; 4];
                for (k, row) in rows.iter_mut().enumerate() {
                    *row = (2 * (self.first + i) + k + height - 1) % height * self.from.row() + group * TEXEL;
                }
                macro_rules! column {
                    ($j:expr) => {{
                        let at = $j * stride;
                        weighted!(
                            texel(s, self.from.values, rows[0] + at),
                            texel(s, self.from.values, rows[1] + at),
                            texel(s, self.from.values, rows[2] + at),
                            texel(s, self.from.values, rows[3] + at)
                        )
                    }};
                }
                let (mut a, mut b) = (column!(width - 1), column!(0));
                for j in 0..width / 2 {
                    let next = if 2 * j + 2 < width { 2 * j + 2 } else { 0 };
                    let (c, d) = (column!(2 * j + 1), column!(next));
                    put(s, out, j * out_stride + group * TEXEL, TEXEL, weighted!(a, b, c, d));
                    (a, b) = (c, d);
                }
            }
        }
    }
}

/// 4 D^T: rows from `first` on, which is even, of a texture of twice the sides.
pub(super) struct Double<'a> {
    pub from: &'a Texture<'a>,
    pub to: Target<'a>,
    pub first: usize,
}

impl Work for Double<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(mut self, s: S) {
        let (height, width, stride) = (self.from.height, self.from.width, self.from.stride);
        let (out_stride, channels) = (self.to.stride, self.to.channels);
        let out_row = 2 * width * out_stride;
        let (near, far) = (s.texel_splat(0.75), s.texel_splat(0.25));
        for group in 0..channels.div_ceil(TEXEL) {
            let lanes = lanes(channels, out_stride, group);
            for (i, outs) in self.to.values.chunks_exact_mut(2 * out_row).enumerate() {
                let (upper, lower) = outs.split_at_mut(out_row);
                let middle = self.first / 2 + i;
                let row = |i: usize| i % height * self.from.row() + group * TEXEL;
                let (above, middle, below) = (row(middle + height - 1), row(middle), row(middle + 1));
                macro_rules! column {
                    ($j:expr) => {{
                        let at = $j * stride;
                        let own = s.texel_mul(texel(s, self.from.values, middle + at), near);
                        [
                            s.texel_fma(texel(s, self.from.values, above + at), far, own),
                            s.texel_fma(texel(s, self.from.values, below + at), far, own),
                        ]
                    }};
                }
                let (mut a, mut b) = (column!(width - 1), column!(0));
                for j in 0..width {
                    let c = column!(if j + 1 < width { j + 1 } else { 0 });
                    let at = 2 * j * out_stride + group * TEXEL;
                    let own = s.texel_mul(b[0], near);
                    put(s, upper, at, lanes, s.texel_fma(a[0], far, own));
                    put(s, upper, at + out_stride, lanes, s.texel_fma(c[0], far, own));
                    let own = s.texel_mul(b[1], near);
                    put(s, lower, at, lanes, s.texel_fma(a[1], far, own));
                    put(s, lower, at + out_stride, lanes, s.texel_fma(c[1], far, own));
                    (a, b) = (b, c);
                }
            }
        }
        self.to.clear_padding();
    }
}
