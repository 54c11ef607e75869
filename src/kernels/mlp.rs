//! Fully connected layers on tiles: lanes are samples, and a block of outputs stays in registers.
//!
//! A tile is rows of `stride` samples, one row a neuron. `stride` is a multiple of [`STEP`]. Weights are packed by blocks of
//! outputs, so that the inner loop reads them in order and broadcasts each to two vectors of samples.

use super::simd::{Isa, Simd, Work, dispatch};
use std::ops::Range;

/// Samples of a tile come in multiples of this: two of the widest vectors.
pub const STEP: usize = 32;
/// Most outputs of a block, of any instruction set.
const MOST: usize = 12;

/// A matrix and a bias, packed for one instruction set.
#[derive(Clone, Debug)]
pub struct Packed {
    isa: Isa,
    inputs: usize,
    /// Outputs of each block; a block is its rows, an input each, and its biases.
    blocks: Vec<Range<usize>>,
    values: Vec<f32>,
}

/// Parts of 0..`n` of nearly equal size, none larger than `most`.
fn parts(n: usize, most: usize) -> impl Iterator<Item = Range<usize>> {
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
    /// A layer from its weight \[out, in\] and bias \[out\], of which it takes the inputs `of` in that order.
    pub fn layer(isa: Isa, weight: &[f32], bias: &[f32], of: impl IntoIterator<Item = usize>) -> Self {
        let inputs = weight.len() / bias.len().max(1);
        let of: Vec<usize> = of.into_iter().collect();
        Self::new(isa, of.len(), bias.len(), |o, i| weight[o * inputs + of[i]], |o| bias[o])
    }

    /// The transpose of a weight \[out, in\], of which it gives the inputs `of`: what takes gradients back.
    pub fn transposed(isa: Isa, weight: &[f32], outputs: usize, of: Range<usize>) -> Self {
        let inputs = weight.len() / outputs.max(1);
        Self::new(isa, outputs, of.len(), |k, o| weight[o * inputs + of.start + k], |_| 0.0)
    }

    fn new(
        isa: Isa,
        inputs: usize,
        outputs: usize,
        weight: impl Fn(usize, usize) -> f32,
        bias: impl Fn(usize) -> f32,
    ) -> Self {
        let blocks: Vec<_> = parts(outputs, dispatch(isa, Block)).collect();
        let mut values = Vec::with_capacity((inputs + 1) * outputs);
        for block in &blocks {
            for i in 0..inputs {
                values.extend(block.clone().map(|o| weight(o, i)));
            }
            values.extend(block.clone().map(&bias));
        }
        Self { isa, inputs, blocks, values }
    }

    /// Number of outputs.
    pub fn outputs(&self) -> usize {
        self.blocks.last().map_or(0, |b| b.end)
    }

    /// Number of inputs.
    pub fn inputs(&self) -> usize {
        self.inputs
    }

    /// Outputs \[out\]\[stride\] of inputs \[in\]\[stride\].
    ///
    /// # Panics
    /// If a slice is too short or `stride` no multiple of [`STEP`].
    pub fn apply(&self, stride: usize, x: &[f32], start: Start, end: End, out: &mut [f32]) {
        assert!(stride.is_multiple_of(STEP) && x.len() >= self.inputs * stride);
        let (x, out) = (&x[..self.inputs * stride], &mut out[..self.outputs() * stride]);
        dispatch(self.isa, Apply { packed: self, stride, x, start, end, out });
    }
}

/// What a layer's sums begin with.
#[derive(Clone, Copy, Debug)]
pub enum Start<'a> {
    /// The bias.
    Bias,
    /// Sums so far \[out\]\[stride\], the bias among them.
    Rows(&'a [f32]),
}

/// What happens to a layer's sums.
#[derive(Clone, Copy, Debug)]
pub enum End<'a> {
    /// Nothing.
    Linear,
    /// ReLU; NaN stays.
    Relu,
    /// 0 where these rows \[out\]\[stride\], a ReLU's outputs, are not above 0.
    Where(&'a [f32]),
}

struct Apply<'a> {
    packed: &'a Packed,
    stride: usize,
    x: &'a [f32],
    start: Start<'a>,
    end: End<'a>,
    out: &'a mut [f32],
}

impl Work for Apply<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(mut self, s: S) {
        // All blocks of a few samples before the next few: their inputs stay in the first-level cache.
        for at in (0..self.stride).step_by(2 * S::LANES) {
            let mut values = &self.packed.values[..];
            for range in &self.packed.blocks {
                let (block, rest) = values.split_at((self.packed.inputs + 1) * range.len());
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
        let stride = self.stride;
        let (matrix, bias) = values.split_at(values.len() - B);
        let mut sums = [[s.splat(0.0); 2]; B];
        for o in 0..B {
            sums[o] = match self.start {
                Start::Bias => [s.splat(bias[o]); 2],
                Start::Rows(rows) => pair(s, rows, (first + o) * stride + at),
            };
        }
        for (weights, x) in matrix.as_chunks::<B>().0.iter().zip(self.x.chunks_exact(stride)) {
            let [a, b] = pair(s, x, at);
            for o in 0..B {
                let w = s.splat(weights[o]);
                sums[o] = [s.fma(w, a, sums[o][0]), s.fma(w, b, sums[o][1])];
            }
        }
        for o in 0..B {
            let place = (first + o) * stride + at;
            for half in 0..2 {
                let sum = sums[o][half];
                let value = match self.end {
                    End::Linear => sum,
                    // max(0, NaN) would be NaN or 0 by the order of arguments: here it stays NaN.
                    End::Relu => s.max(s.splat(0.0), sum),
                    End::Where(rows) => {
                        let on = s.greater(s.load(&rows[place + half * S::LANES..]), s.splat(0.0));
                        s.select(on, sum, s.splat(0.0))
                    }
                };
                s.store(&mut self.out[place + half * S::LANES..], value);
            }
        }
    }
}

#[inline(always)]
fn pair<S: Simd>(s: S, row: &[f32], at: usize) -> [S::F; 2] {
    let part = &row[at..at + 2 * S::LANES];
    [s.load(part), s.load(&part[S::LANES..])]
}

/// Adds a layer's weight gradient \[out, in\] and bias gradient \[out\] over a tile of inputs \[in\]\[stride\] and gradients
/// of the sums \[out\]\[stride\].
///
/// # Panics
/// If a slice is too short or `stride` no multiple of [`STEP`].
pub fn weight_gradient(
    isa: Isa,
    stride: usize,
    x: &[f32],
    gradient: &[f32],
    weight: &mut [f32],
    bias: &mut [f32],
) {
    let outputs = bias.len();
    let inputs = weight.len() / outputs.max(1);
    assert!(stride.is_multiple_of(STEP) && x.len() >= inputs * stride && gradient.len() >= outputs * stride);
    dispatch(isa, WeightGradient { stride, x, gradient, weight, bias, inputs });
}

struct WeightGradient<'a> {
    stride: usize,
    x: &'a [f32],
    gradient: &'a [f32],
    weight: &'a mut [f32],
    bias: &'a mut [f32],
    inputs: usize,
}

impl Work for WeightGradient<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(mut self, s: S) {
        for rows in parts(self.inputs, S::SQUARE) {
            for columns in parts(self.bias.len(), S::SQUARE) {
                macro_rules! sizes {
                    ($($rows:literal: $($columns:literal)*;)*) => {
                        match (rows.len(), columns.len()) {
                            $($(($rows, $columns) if fits(S::SQUARE, [$rows, $columns]) => {
                                self.square::<S, $rows, $columns, { $rows * $columns }>(s, rows.start, columns.start);
                            })*)*
                            _ => {}
                        }
                    };
                }
                sizes!(1: 1 2 3 4 5; 2: 1 2 3 4 5; 3: 1 2 3 4 5; 4: 1 2 3 4 5; 5: 1 2 3 4 5;);
            }
        }
        for (o, bias) in self.bias.iter_mut().enumerate() {
            let row = &self.gradient[o * self.stride..(o + 1) * self.stride];
            let mut sum = [s.splat(0.0); 1];
            for part in row.chunks_exact(S::LANES) {
                sum[0] = s.add(sum[0], s.load(part));
            }
            let mut lanes = [0.0];
            s.sums(&sum, &mut lanes);
            *bias += lanes[0];
        }
    }
}

/// Whether an instruction set has blocks of that shape: known to the compiler, which leaves the others out.
#[inline(always)]
const fn fits(square: usize, shape: [usize; 2]) -> bool {
    square >= shape[0] && square >= shape[1]
}

impl WeightGradient<'_> {
    /// The weights of `R` inputs and `C` outputs, `N` = `R` `C`.
    #[inline(always)]
    fn square<S: Simd, const R: usize, const C: usize, const N: usize>(
        &mut self,
        s: S,
        input: usize,
        output: usize,
    ) {
        let stride = self.stride;
        let x = &self.x[input * stride..(input + R) * stride];
        let gradient = &self.gradient[output * stride..(output + C) * stride];
        let mut sums = [s.splat(0.0); N];
        for at in (0..stride).step_by(S::LANES) {
            let mut of_outputs = [s.splat(0.0); C];
            for c in 0..C {
                of_outputs[c] = s.load(&gradient[c * stride + at..]);
            }
            for r in 0..R {
                let x = s.load(&x[r * stride + at..]);
                for c in 0..C {
                    sums[r * C + c] = s.fma(x, of_outputs[c], sums[r * C + c]);
                }
            }
        }
        let mut lanes = [0.0; N];
        s.sums(&sums, &mut lanes);
        for r in 0..R {
            for c in 0..C {
                self.weight[(output + c) * self.inputs + input + r] += lanes[r * C + c];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Random, Stream};

    /// Sums of up to 130 products of values of size 1, relative to 1 + |sum|.
    const ROUNDING: f64 = 1e-5;
    const STRIDE: usize = 2 * STEP;

    fn noise(n: usize, seed: u64) -> Vec<f32> {
        let mut random = Random::new(seed, Stream::Probe, n as u64);
        (0..n).map(|_| random.normal()).collect()
    }

    fn worst(a: &[f32], b: &[f64]) -> f64 {
        assert_eq!(a.len(), b.len());
        a.iter().zip(b).map(|(a, b)| (f64::from(*a) - b).abs() / (1.0 + b.abs())).fold(0.0, f64::max)
    }

    /// sum_i weight[o][i] x[i][k], plus the bias.
    fn layer64(weight: &[f32], bias: &[f32], inputs: usize, of: Range<usize>, x: &[f32]) -> Vec<f64> {
        let mut out = Vec::new();
        for (o, bias) in bias.iter().enumerate() {
            for k in 0..STRIDE {
                let product =
                    |i: usize| f64::from(weight[o * inputs + of.start + i]) * f64::from(x[i * STRIDE + k]);
                out.push(f64::from(*bias) + (0..of.len()).map(product).sum::<f64>());
            }
        }
        out
    }

    const SHAPES: [(usize, usize); 9] =
        [(1, 1), (9, 25), (25, 25), (25, 1), (79, 25), (25, 3), (5, 128), (128, 7), (43, 14)];

    #[test]
    fn layers_follow_float64_and_a_changed_weight_is_noticed() {
        for isa in Isa::all() {
            for (inputs, outputs) in SHAPES {
                let mut weight = noise(inputs * outputs, 1);
                let (bias, x) = (noise(outputs, 2), noise(inputs * STRIDE, 3));
                let mut out = vec![f32::NAN; outputs * STRIDE];
                let want = layer64(&weight, &bias, inputs, 0..inputs, &x);
                let packed = Packed::layer(isa, &weight, &bias, 0..inputs);
                packed.apply(STRIDE, &x, Start::Bias, End::Linear, &mut out);
                assert!(worst(&out, &want) < ROUNDING, "{} {inputs} {outputs}", isa.name());
                let sums = out.clone();
                packed.apply(STRIDE, &x, Start::Bias, End::Relu, &mut out);
                assert!(out.iter().zip(&sums).all(|(a, b)| *a == b.max(0.0)));
                let mask = noise(outputs * STRIDE, 4);
                packed.apply(STRIDE, &x, Start::Bias, End::Where(&mask), &mut out);
                let on = |k: usize| if mask[k] > 0.0 { sums[k] } else { 0.0 };
                assert!((0..out.len()).all(|k| out[k] == on(k)));
                weight[inputs * outputs / 2] += 1e-2;
                let packed = Packed::layer(isa, &weight, &bias, 0..inputs);
                packed.apply(STRIDE, &x, Start::Bias, End::Linear, &mut out);
                assert!(worst(&out, &want) > ROUNDING);
            }
        }
    }

    #[test]
    fn a_layer_in_two_parts_is_the_layer() {
        let (inputs, outputs, cut) = (11, 25, 4);
        for isa in Isa::all() {
            let (weight, bias) = (noise(inputs * outputs, 1), noise(outputs, 2));
            let x = noise(inputs * STRIDE, 3);
            let want = layer64(&weight, &bias, inputs, 0..inputs, &x);
            let (mut sums, mut out) = (vec![0.0; outputs * STRIDE], vec![0.0; outputs * STRIDE]);
            let first = Packed::layer(isa, &weight, &bias, 0..cut);
            first.apply(STRIDE, &x, Start::Bias, End::Linear, &mut sums);
            let second = Packed::layer(isa, &weight, &bias, cut..inputs);
            second.apply(STRIDE, &x[cut * STRIDE..], Start::Rows(&sums), End::Linear, &mut out);
            assert!(worst(&out, &want) < ROUNDING);
            second.apply(STRIDE, &x[cut * STRIDE..], Start::Bias, End::Linear, &mut out);
            assert!(worst(&out, &want) > ROUNDING);
        }
    }

    #[test]
    fn gradients_follow_float64_and_a_changed_one_is_noticed() {
        for isa in Isa::all() {
            for (inputs, outputs) in SHAPES {
                let weight = noise(inputs * outputs, 1);
                let (x, mut gradient) = (noise(inputs * STRIDE, 3), noise(outputs * STRIDE, 4));
                // Back through the transpose, to the first inputs alone.
                let of = inputs / 3..inputs;
                let column = |k: usize| (0..outputs).map(move |o| (o, k));
                let back: Vec<f64> = of
                    .clone()
                    .flat_map(|k| {
                        (0..STRIDE).map(move |n| (k, n)).map(|(k, n)| {
                            column(k)
                                .map(|(o, k)| {
                                    f64::from(weight[o * inputs + k]) * f64::from(gradient[o * STRIDE + n])
                                })
                                .sum()
                        })
                    })
                    .collect();
                let mut out = vec![0.0; of.len() * STRIDE];
                let packed = Packed::transposed(isa, &weight, outputs, of);
                packed.apply(STRIDE, &gradient, Start::Bias, End::Linear, &mut out);
                assert!(worst(&out, &back) < ROUNDING, "{} {inputs} {outputs}", isa.name());

                let dot = |a: &[f32], b: &[f32]| {
                    1.0 + a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>()
                };
                let row = |t: &[f32], k: usize| t[k * STRIDE..(k + 1) * STRIDE].to_vec();
                let want: Vec<f64> = (0..outputs * inputs)
                    .map(|k| dot(&row(&gradient, k / inputs), &row(&x, k % inputs)))
                    .collect();
                let want_bias: Vec<f64> =
                    (0..outputs).map(|o| dot(&row(&gradient, o), &[1.0; STRIDE])).collect();
                let run = |gradient: &[f32]| {
                    // Gradients are added to what is there.
                    let (mut weight, mut bias) = (vec![1.0; inputs * outputs], vec![1.0; outputs]);
                    weight_gradient(isa, STRIDE, &x, gradient, &mut weight, &mut bias);
                    worst(&weight, &want).max(worst(&bias, &want_bias))
                };
                assert!(run(&gradient) < ROUNDING, "{} {inputs} {outputs}", isa.name());
                gradient[outputs * STRIDE / 2] += 1e-2;
                assert!(run(&gradient) > ROUNDING);
            }
        }
    }

    #[test]
    fn poison_stays_in_its_lane() {
        for isa in Isa::all() {
            let (weight, bias) = (noise(25 * 9, 1), noise(25, 2));
            let mut x = noise(9 * STRIDE, 3);
            x[3 * STRIDE + 7] = f32::NAN;
            let mut out = vec![0.0; 25 * STRIDE];
            Packed::layer(isa, &weight, &bias, 0..9).apply(STRIDE, &x, Start::Bias, End::Relu, &mut out);
            for (k, value) in out.iter().enumerate() {
                assert_eq!(value.is_nan(), k % STRIDE == 7, "{}", isa.name());
            }
        }
    }
}
