//! The separable Gaussian: rows in blocks, down the columns and then along.

use super::super::simd::{Isa, Simd, TEXEL, Work, dispatch};
use super::{BAND, Target, Texture, lanes, last, put, taps, texel};
use std::cell::RefCell;

/// A distance from the middle of a symmetric sum: its weight, and where its two terms lie.
#[derive(Clone, Copy)]
struct Pair {
    weight: f32,
    low: usize,
    high: usize,
}

thread_local! {
    /// A block of smoothed rows, and the terms of sums down and across: kept, so that no step allocates them anew.
    static ROWS: RefCell<(Vec<f32>, Vec<Pair>, Vec<Pair>)> = const { RefCell::new((vec![], vec![], vec![])) };
}

/// The exact Gaussian.
pub(super) fn gaussian(isa: Isa, from: &Texture, sigma: f64, to: Target) {
    let (down, across) = (taps(sigma, from.height), taps(sigma, from.width));
    to.bands(from.width, BAND, |first, to| {
        ROWS.with_borrow_mut(|(rows, lines, columns)| {
            let terms = [lines, columns];
            dispatch(isa, Gaussian { from, to, first, down: &down, across: &across, rows, terms });
        });
    });
}

/// Rows from `first` on, smoothed down the columns a block of rows at a time, then along each row.
struct Gaussian<'a> {
    from: &'a Texture<'a>,
    to: Target<'a>,
    first: usize,
    down: &'a [f32],
    across: &'a [f32],
    rows: &'a mut Vec<f32>,
    terms: [&'a mut Vec<Pair>; 2],
}

impl Work for Gaussian<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        // Sums and two windows of as many vectors stay in registers.
        match S::LANES {
            16 => self.blocks::<S, 8, 8>(s),
            8 => self.blocks::<S, 4, 4>(s),
            _ => self.blocks::<S, 4, 2>(s),
        }
    }
}

/// Runs a body for each number below N, at most 8, written out: indexed in a loop, arrays of vectors would lie in memory.
macro_rules! each {
    ($i:ident < $n:ident, $body:block) => {
        each!($i $n $body 0 1 2 3 4 5 6 7)
    };
    ($i:ident $n:ident $body:block $($value:literal)*) => {$(
        if $value < $n {
            let $i: usize = $value;
            $body
        }
    )*};
}

impl Gaussian<'_> {
    /// R rows at once down the columns, whatever the floats are; C texels at once along a row.
    #[inline(always)]
    fn blocks<S: Simd, const R: usize, const C: usize>(mut self, s: S) {
        let (height, width, stride) = (self.from.height, self.from.width, self.from.stride);
        let (up, left) = (self.down.len() - 1, self.across.len() - 1);
        let (row, out_row) = (width * stride, width * self.to.stride);
        let out_rows = self.to.values.len() / out_row;
        let (out_stride, channels) = (self.to.stride, self.to.channels);
        // Texels to either side, and what whole vectors and blocks of texels need beyond.
        let length = (left + width + left + C) * stride + S::LANES;
        if self.rows.len() < R * length {
            self.rows.resize(R * length, 0.0);
        }
        let rows = &mut self.rows[..R * length];
        let [down, across] = self.terms;
        across.clear();
        across.extend((1..=left).map(|d| Pair {
            weight: self.across[d],
            low: (left - d) * stride,
            high: (left + C - 1 + d) * stride,
        }));
        let mut along = [0; C];
        for (i, start) in along.iter_mut().enumerate() {
            *start = (left + i) * stride;
        }
        for block in (0..out_rows).step_by(R) {
            let line = |i: usize| (self.first + block + i) % height * row;
            down.clear();
            down.extend((1..=up).map(|d| Pair {
                weight: self.down[d],
                low: line(height - d),
                high: line(R - 1 + d),
            }));
            let mut middle = [0; R];
            for (b, start) in middle.iter_mut().enumerate() {
                *start = line(b);
            }
            for at in (0..row).step_by(S::LANES) {
                let sums = vector_sums::<S, R>(s, self.from.values, at, &middle, self.down[0], down);
                each!(b < R, {
                    s.store(&mut rows[b * length + left * stride + at..], sums[b]);
                });
            }
            for (b, smooth) in rows.chunks_exact_mut(length).take(out_rows - block).enumerate() {
                smooth.copy_within(row..row + left * stride, 0);
                for j in left + width..left + width + left + C {
                    let source = (j - width) * stride;
                    smooth.copy_within(source..source + stride, j * stride);
                }
                let out = &mut self.to.values[(block + b) * out_row..][..out_row];
                for group in 0..channels.div_ceil(TEXEL) {
                    let lanes = lanes(channels, out_stride, group);
                    for j in (0..width).step_by(C) {
                        let at = j * stride + group * TEXEL;
                        let sums = texel_sums::<S, C>(s, smooth, at, &along, self.across[0], across);
                        each!(i < C, {
                            if j + i < width {
                                put(s, out, (j + i) * out_stride + group * TEXEL, lanes, sums[i]);
                            }
                        });
                    }
                }
            }
        }
        self.to.clear_padding();
    }
}

/// As many floats as a vector holds, from `at` on; beyond the end, zeros.
#[inline(always)]
fn vector<S: Simd>(s: S, from: &[f32], at: usize) -> S::F {
    match from.get(at..) {
        Some(from) if from.len() >= S::LANES => s.load(from),
        _ => s.load([last(from, at), last(from, at + TEXEL)].as_flattened()),
    }
}

/// Symmetric sums around N neighbours: the middle of sum i lies at `middle[i] + at`; of each pair, the lower term of the
/// first sum and the higher term of the last.
///
/// A pair of terms is added before it is weighted. Neighbours share all terms but one at each end, so each distance
/// reads two vectors and keeps the others: place i of a window belongs to the terms i, i + N, i - N, ...
macro_rules! symmetric_sums {
    ($name:ident $type:ident $load:ident $splat:ident $add:ident $mul:ident $fma:ident) => {
        #[inline(always)]
        fn $name<S: Simd, const N: usize>(
            s: S,
            from: &[f32],
            at: usize,
            middle: &[usize; N],
            weight: f32,
            pairs: &[Pair],
        ) -> [S::$type; N] {
            let mut low = [s.$splat(0.0); N];
            let mut sums = low;
            let weight = s.$splat(weight);
            each!(i < N, {
                low[i] = $load(s, from, middle[i] + at);
                sums[i] = s.$mul(low[i], weight);
            });
            let mut high = low;
            let mut pairs = pairs.iter();
            loop {
                each!(turn < N, {
                    let Some(pair) = pairs.next() else {
                        break;
                    };
                    low[(2 * N - 1 - turn) % N] = $load(s, from, pair.low + at);
                    high[turn % N] = $load(s, from, pair.high + at);
                    let weight = s.$splat(pair.weight);
                    each!(i < N, {
                        let both = s.$add(low[(i + 2 * N - 1 - turn) % N], high[(i + turn + 1) % N]);
                        sums[i] = s.$fma(both, weight, sums[i]);
                    });
                });
            }
            sums
        }
    };
}

symmetric_sums!(vector_sums F vector splat add mul fma);
symmetric_sums!(texel_sums T texel texel_splat texel_add texel_mul texel_fma);
