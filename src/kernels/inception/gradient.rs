//! Gradients of convolutions by their weights: sums over pixels of a gradient times a shifted input.
//!
//! A task is some outputs and inputs of one convolution over all pixels, so the order of a sum never depends on threads.

use super::super::simd::{Isa, Simd, Work, dispatch};
use super::conv::parts;
use super::grid::{Grid, HALO, Source};
use rayon::prelude::*;
use std::ops::Range;

/// Pixels of a channel whose sums stay in registers: so many of a block's channels fit the first-level cache.
const RUN: usize = 768;
/// Blocks along each side of a task of 1x1, of all of which the pixels of a run fit the second-level cache. Larger kernels
/// use what they load more often: fewer blocks do, and leave more tasks.
const BLOCKS: usize = 8;

/// One convolution: its input, with the border about it, and its sums' gradient, with zeros about it.
pub struct Flow<'a> {
    pub input: Source<'a>,
    pub inputs: usize,
    pub gradient: Source<'a>,
    pub outputs: usize,
    pub kernel: usize,
    /// Where its weight begins among all parameters.
    pub place: usize,
}

struct Side;

impl Work for Side {
    type Output = usize;

    #[inline(always)]
    fn run<S: Simd>(self, _: S) -> usize {
        S::SQUARE
    }
}

/// Adds the gradients of convolutions to `all`: each weight's, then its bias'.
pub fn add(isa: Isa, grid: &Grid, flows: &[Flow], all: &mut [f32]) {
    let side = dispatch(isa, Side);
    let blocks = |n: usize| parts(n, side).collect::<Vec<_>>();
    let sides: Vec<_> = flows.iter().map(|flow| (flow, blocks(flow.outputs), blocks(flow.inputs))).collect();
    let mut tasks = Vec::new();
    for (flow, outputs, inputs) in &sides {
        let most = (BLOCKS / flow.kernel).max(1);
        for outputs in outputs.chunks(most) {
            tasks.extend(inputs.chunks(most).map(|inputs| (*flow, outputs, inputs)));
        }
    }
    let run = |(flow, outputs, inputs): &(&Flow, &[Range<usize>], &[Range<usize>])| {
        let (of_outputs, of_inputs) = (span(outputs), span(inputs));
        let mut sums = vec![0.0; of_outputs.len() * of_inputs.len() * flow.kernel * flow.kernel];
        let mut bias = vec![0.0; if of_inputs.start == 0 { of_outputs.len() } else { 0 }];
        dispatch(isa, Task { grid, flow, outputs, inputs, sums: &mut sums, bias: &mut bias });
        (sums, bias)
    };
    let results: Vec<_> = tasks.par_iter().map(run).collect();
    for ((flow, outputs, inputs), (sums, bias)) in tasks.iter().zip(results) {
        let (outputs, inputs, area) = (span(outputs), span(inputs), flow.kernel * flow.kernel);
        for (o, sums) in outputs.clone().zip(sums.chunks_exact(inputs.len() * area)) {
            let place = flow.place + (o * flow.inputs + inputs.start) * area;
            all[place..place + sums.len()].iter_mut().zip(sums).for_each(|(to, from)| *to += from);
        }
        let place = flow.place + flow.outputs * flow.inputs * area + outputs.start;
        all[place..place + bias.len()].iter_mut().zip(bias).for_each(|(to, from)| *to += from);
    }
}

/// All of neighbouring blocks.
fn span(blocks: &[Range<usize>]) -> Range<usize> {
    blocks.first().map_or(0, |b| b.start)..blocks.last().map_or(0, |b| b.end)
}

struct Task<'a> {
    grid: &'a Grid,
    flow: &'a Flow<'a>,
    /// Blocks of each, neighbours.
    outputs: &'a [Range<usize>],
    inputs: &'a [Range<usize>],
    /// \[output\]\[input\]\[ky\]\[kx\]
    sums: &'a mut [f32],
    /// Empty where another task has it.
    bias: &'a mut [f32],
}

/// Rows of a line's inputs and of its gradients.
type Line<'a> = (&'a [f32], &'a [f32]);

/// Whether an instruction set has blocks of that shape: known to the compiler, which leaves the others out.
#[inline(always)]
const fn fits(side: usize, shape: [usize; 2]) -> bool {
    side >= shape[0] && side >= shape[1]
}

impl Work for Task<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(mut self, s: S) {
        let (grid, flow) = (self.grid, self.flow);
        let at_once = (RUN / grid.computed).max(1);
        let mut lines: Vec<Line> = Vec::with_capacity(at_once);
        for first in (0..grid.lines).step_by(at_once) {
            for ky in 0..flow.kernel {
                let by = ky as isize - (flow.kernel / 2) as isize;
                // Rows first: a call between products would take the sums out of their registers.
                lines.clear();
                for line in first..(first + at_once).min(grid.lines) {
                    if let Some(x) = flow.input.neighbour(grid, line, by, flow.inputs) {
                        lines.push((x, flow.gradient.rows(grid, line, flow.outputs)));
                    }
                }
                for inputs in self.inputs {
                    for outputs in self.outputs {
                        self.block(s, &lines, ky, inputs.clone(), outputs.clone());
                    }
                }
            }
        }
        let outputs = span(self.outputs);
        for line in 0..grid.lines * usize::from(!self.bias.is_empty()) {
            let rows = flow.gradient.rows(grid, line, outputs.end);
            let rows = rows[outputs.start * grid.stride..].chunks_exact(grid.stride);
            for (bias, row) in self.bias.iter_mut().zip(rows) {
                let mut sum = [s.splat(0.0); 1];
                for part in row[HALO..HALO + grid.computed].chunks_exact(S::LANES) {
                    sum[0] = s.add(sum[0], s.load(part));
                }
                let mut lanes = [0.0];
                s.sums(&sum, &mut lanes);
                *bias += lanes[0];
            }
        }
    }
}

impl Task<'_> {
    /// One row of taps of a few of the inputs and outputs.
    #[inline(always)]
    fn block<S: Simd>(
        &mut self,
        s: S,
        lines: &[Line],
        ky: usize,
        inputs: Range<usize>,
        outputs: Range<usize>,
    ) {
        macro_rules! sizes {
            ($($rows:literal: $($columns:literal)*;)*) => {
                match (inputs.len(), outputs.len()) {
                    $($(($rows, $columns) if fits(S::SQUARE, [$rows, $columns]) => {
                        self.taps::<S, $rows, $columns, { $rows * $columns }>(s, lines, ky, inputs.start, outputs.start);
                    })*)*
                    _ => {}
                }
            };
        }
        sizes!(1: 1 2 3 4 5; 2: 1 2 3 4 5; 3: 1 2 3 4 5; 4: 1 2 3 4 5; 5: 1 2 3 4 5;);
    }

    /// As [`Self::block`], of `R` inputs and `C` outputs, `N` = `R` `C`.
    #[inline(always)]
    fn taps<S: Simd, const R: usize, const C: usize, const N: usize>(
        &mut self,
        s: S,
        lines: &[Line],
        ky: usize,
        input: usize,
        output: usize,
    ) {
        let (kernel, stride, computed) = (self.flow.kernel, self.grid.stride, self.grid.computed);
        let (outputs, inputs) = (span(self.outputs), span(self.inputs));
        let first_input = input * stride + HALO - kernel / 2;
        let first_output = output * stride + HALO;
        for kx in 0..kernel {
            let mut sums = [s.splat(0.0); N];
            for (x, gradient) in lines {
                let (x, gradient) = (&x[first_input + kx..], &gradient[first_output..]);
                let x: [&[f32]; R] = std::array::from_fn(|r| &x[r * stride..][..computed]);
                let gradient: [&[f32]; C] = std::array::from_fn(|c| &gradient[c * stride..][..computed]);
                for at in (0..computed).step_by(S::LANES) {
                    let mut of_outputs = [s.splat(0.0); C];
                    for c in 0..C {
                        of_outputs[c] = s.load(&gradient[c][at..]);
                    }
                    for r in 0..R {
                        let x = s.load(&x[r][at..]);
                        for c in 0..C {
                            sums[r * C + c] = s.fma(x, of_outputs[c], sums[r * C + c]);
                        }
                    }
                }
            }
            let mut lanes = [0.0; N];
            s.sums(&sums, &mut lanes);
            for r in 0..R {
                for c in 0..C {
                    let weight = (output - outputs.start + c) * inputs.len() + input - inputs.start + r;
                    self.sums[(weight * kernel + ky) * kernel + kx] += lanes[r * C + c];
                }
            }
        }
    }
}
