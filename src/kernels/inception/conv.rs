//! Convolution of a line: lanes are pixels, and a block of output channels stays in registers.
//!
//! out\[o\]\[x\] = bias\[o\] + sum over ky, c, kx of weight\[o\]\[c\]\[ky\]\[kx\] in\[y + ky - r\]\[c\]\[x + kx - r\]

use super::super::simd::{Isa, Simd, Work, dispatch};
use super::grid::{Grid, HALO, Source};
use std::ops::Range;

/// Most outputs of a block, of any instruction set.
const MOST: usize = 12;
/// Largest kernel: what halos reach.
pub const LARGEST: usize = 2 * HALO + 1;

/// A convolution packed for one instruction set.
#[derive(Clone, Debug)]
pub struct Packed {
    isa: Isa,
    kernel: usize,
    inputs: usize,
    /// Outputs of each block; a block is \[ky\]\[c\]\[kx\]\[output\], then its biases.
    blocks: Vec<Range<usize>>,
    values: Vec<f32>,
}

/// Parts of 0..`n` of nearly equal size, none larger than `most`.
pub fn parts(n: usize, most: usize) -> impl Iterator<Item = Range<usize>> {
    let count = n.div_ceil(most).max(1);
    (0..count).map(move |k| n * k / count..n * (k + 1) / count)
}

struct Block;

impl Work for Block {
    type Output = usize;

    #[inline(always)]
    fn run<S: Simd>(self, _: S) -> usize {
        S::OUTPUTS.min(MOST)
    }
}

impl Packed {
    /// A convolution of weights 0.
    pub fn new(isa: Isa, inputs: usize, outputs: usize, kernel: usize) -> Self {
        let blocks: Vec<_> = parts(outputs, dispatch(isa, Block)).collect();
        let values = vec![0.0; (inputs * kernel * kernel + 1) * outputs];
        Self { isa, kernel, inputs, blocks, values }
    }

    /// Takes weights by output, input, ky and kx, and biases by output.
    pub fn fill(&mut self, weight: impl Fn(usize, usize, usize, usize) -> f32, bias: impl Fn(usize) -> f32) {
        let (kernel, inputs) = (self.kernel, self.inputs);
        let mut values = &mut self.values[..];
        for block in &self.blocks {
            let count = block.len();
            let (matrix, rest) = values.split_at_mut(inputs * kernel * kernel * count);
            let (biases, rest) = rest.split_at_mut(count);
            values = rest;
            // Weights are read in their order and written in blocks: the other way round is slower.
            for o in 0..count {
                let mut to = matrix[o..].iter_mut().step_by(count);
                for ky in 0..kernel {
                    for c in 0..inputs {
                        for kx in 0..kernel {
                            if let Some(to) = to.next() {
                                *to = weight(block.start + o, c, ky, kx);
                            }
                        }
                    }
                }
                biases[o] = bias(block.start + o);
            }
        }
    }

    /// Number of outputs.
    pub fn outputs(&self) -> usize {
        self.blocks.last().map_or(0, |b| b.end)
    }

    /// Rows \[out\]\[stride\] of a line.
    pub fn apply(&self, grid: &Grid, source: Source, line: usize, start: Start, end: End, out: &mut [f32]) {
        let reach = (self.kernel / 2) as isize;
        let mut rows = [None; LARGEST];
        for (ky, row) in rows[..self.kernel].iter_mut().enumerate() {
            *row = source.neighbour(grid, line, ky as isize - reach, self.inputs);
        }
        self.run(grid, rows, start, end, out);
    }

    /// As [`Self::apply`], for a kernel of 1x1 on rows \[in\]\[stride\].
    pub fn apply_rows(&self, grid: &Grid, rows: &[f32], start: Start, end: End, out: &mut [f32]) {
        debug_assert_eq!(self.kernel, 1);
        self.run(grid, [Some(rows), None, None, None, None], start, end, out);
    }

    fn run(&self, grid: &Grid, rows: [Option<&[f32]>; LARGEST], start: Start, end: End, out: &mut [f32]) {
        let out = &mut out[..self.outputs() * grid.stride];
        dispatch(self.isa, Apply { packed: self, grid, rows, start, end, out });
    }

    /// Number of inputs and side of the kernel.
    pub fn sizes(&self) -> (usize, usize) {
        (self.inputs, self.kernel)
    }
}

/// What a convolution's sums begin with.
#[derive(Clone, Copy, Debug)]
pub enum Start {
    /// The bias.
    Bias,
    /// What the outputs hold.
    Own,
}

/// What happens to a convolution's sums.
#[derive(Clone, Copy, Debug)]
pub enum End<'a> {
    /// Nothing.
    Linear,
    /// ReLU; NaN stays.
    Relu,
    /// 0 where these rows, a ReLU's outputs, are not above 0.
    Where(&'a [f32]),
}

struct Apply<'a> {
    packed: &'a Packed,
    grid: &'a Grid,
    /// Rows of the inputs by ky.
    rows: [Option<&'a [f32]>; LARGEST],
    start: Start,
    end: End<'a>,
    out: &'a mut [f32],
}

impl Work for Apply<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(mut self, s: S) {
        let packed = self.packed;
        let of_output = packed.inputs * packed.kernel * packed.kernel + 1;
        // All blocks of a few pixels before the next few: their inputs stay in the caches.
        for at in (0..self.grid.computed).step_by(2 * S::LANES) {
            let mut values = &packed.values[..];
            for range in &packed.blocks {
                let (block, rest) = values.split_at(of_output * range.len());
                values = rest;
                macro_rules! sizes {
                    ($($size:literal)*) => {
                        match range.len() {
                            $($size if S::OUTPUTS >= $size => self.block::<S, $size>(s, block, range.start, at),)*
                            _ => {}
                        }
                    };
                }
                sizes!(1 2 3 4 5 6 7 8 9 10 11 12);
            }
        }
    }
}

impl Apply<'_> {
    #[inline(always)]
    fn block<S: Simd, const B: usize>(&mut self, s: S, values: &[f32], first: usize, at: usize) {
        let (stride, kernel) = (self.grid.stride, self.packed.kernel);
        let (matrix, bias) = values.split_at(values.len() - B);
        let place = first * stride + HALO + at;
        let (mut near, mut far) = ([s.splat(0.0); B], [s.splat(0.0); B]);
        match self.start {
            Start::Bias => {
                for o in 0..B {
                    near[o] = s.splat(bias[o]);
                }
                far = near;
            }
            Start::Own => {
                for o in 0..B {
                    [near[o], far[o]] = pair(s, self.out, place + o * stride);
                }
            }
        }
        let left = HALO + at - kernel / 2;
        for (matrix, rows) in matrix.chunks_exact(matrix.len() / kernel).zip(&self.rows) {
            let Some(rows) = rows else { continue };
            let weights = matrix.as_chunks::<B>().0;
            for (weights, row) in weights.chunks_exact(kernel).zip(rows.chunks_exact(stride)) {
                for (kx, weights) in weights.iter().enumerate() {
                    let [a, b] = pair(s, row, left + kx);
                    for o in 0..B {
                        let w = s.splat(weights[o]);
                        near[o] = s.fma(w, a, near[o]);
                        far[o] = s.fma(w, b, far[o]);
                    }
                }
            }
        }
        // A loop for each end: one loop of all would be too long to unroll, and the sums would leave the registers.
        let zero = s.splat(0.0);
        match self.end {
            End::Linear => {}
            // max(0, NaN) would be NaN or 0 by the order of arguments: here it stays NaN.
            End::Relu => {
                for o in 0..B {
                    near[o] = s.max(zero, near[o]);
                    far[o] = s.max(zero, far[o]);
                }
            }
            End::Where(rows) => {
                for o in 0..B {
                    let [a, b] = pair(s, rows, place + o * stride);
                    near[o] = s.select(s.greater(a, zero), near[o], zero);
                    far[o] = s.select(s.greater(b, zero), far[o], zero);
                }
            }
        }
        for o in 0..B {
            let out = &mut self.out[place + o * stride..][..2 * S::LANES];
            s.store(out, near[o]);
            s.store(&mut out[S::LANES..], far[o]);
        }
    }
}

#[inline(always)]
fn pair<S: Simd>(s: S, row: &[f32], at: usize) -> [S::F; 2] {
    let part = &row[at..at + 2 * S::LANES];
    [s.load(part), s.load(&part[S::LANES..])]
}
