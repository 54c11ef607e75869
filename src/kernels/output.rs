//! From the decoder's outputs to RGB and back, on tiles.

use super::math;
use super::simd::{Isa, Simd, Work, dispatch};

/// What outputs go through.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Output {
    /// Rows of the matrix that makes RGB of the first three outputs; none where they are RGB.
    pub matrix: Option<[[f32; 3]; 3]>,
    /// exp(x) - 1 after the matrix.
    pub exponential: bool,
    /// Three more outputs x multiply the colour as [`MASK_FLOOR`] + sigmoid(x).
    pub mask: bool,
}

/// Least factor of a mask.
pub const MASK_FLOOR: f32 = 0.1;

/// RGB \[3\]\[stride\] of outputs \[3 or 6\]\[stride\], not clamped.
///
/// # Panics
/// If a slice is too short or `stride` no multiple of 16.
pub fn rgb(isa: Isa, output: Output, stride: usize, outputs: &[f32], rgb: &mut [f32]) {
    assert!(stride.is_multiple_of(16));
    dispatch(isa, Rgb { output, stride, outputs, rgb });
}

/// Gradient by the outputs \[3 or 6\]\[stride\] from that by RGB \[3\]\[stride\].
///
/// # Panics
/// As [`rgb`].
pub fn gradient(isa: Isa, output: Output, stride: usize, outputs: &[f32], by_rgb: &[f32], out: &mut [f32]) {
    assert!(stride.is_multiple_of(16));
    dispatch(isa, Gradient { output, stride, outputs, by_rgb, out });
}

/// Colour before the mask, and its factor, of three vectors of samples.
#[inline(always)]
fn parts<S: Simd>(s: S, output: Output, stride: usize, outputs: &[f32], at: usize) -> ([S::F; 3], [S::F; 3]) {
    let mut colour = [s.splat(0.0); 3];
    let mut factor = [s.splat(1.0); 3];
    let raw = [s.load(&outputs[at..]), s.load(&outputs[stride + at..]), s.load(&outputs[2 * stride + at..])];
    for c in 0..3 {
        colour[c] = match output.matrix {
            Some(m) => {
                let two = s.fma(raw[1], s.splat(m[c][1]), s.mul(raw[0], s.splat(m[c][0])));
                s.fma(raw[2], s.splat(m[c][2]), two)
            }
            None => raw[c],
        };
        if output.exponential {
            colour[c] = s.sub(math::exp(s, colour[c]), s.splat(1.0));
        }
        if output.mask {
            let x = s.load(&outputs[(3 + c) * stride + at..]);
            let e = math::exp(s, s.sub(s.splat(0.0), x));
            factor[c] = s.add(s.div(s.splat(1.0), s.add(e, s.splat(1.0))), s.splat(MASK_FLOOR));
        }
    }
    (colour, factor)
}

struct Rgb<'a> {
    output: Output,
    stride: usize,
    outputs: &'a [f32],
    rgb: &'a mut [f32],
}

impl Work for Rgb<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        for at in (0..self.stride).step_by(S::LANES) {
            let (colour, factor) = parts(s, self.output, self.stride, self.outputs, at);
            for c in 0..3 {
                s.store(&mut self.rgb[c * self.stride + at..], s.mul(colour[c], factor[c]));
            }
        }
    }
}

struct Gradient<'a> {
    output: Output,
    stride: usize,
    outputs: &'a [f32],
    by_rgb: &'a [f32],
    out: &'a mut [f32],
}

impl Work for Gradient<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let stride = self.stride;
        for at in (0..stride).step_by(S::LANES) {
            let (colour, factor) = parts(s, self.output, stride, self.outputs, at);
            let mut raw = [s.splat(0.0); 3];
            for c in 0..3 {
                let by_rgb = s.load(&self.by_rgb[c * stride + at..]);
                let mut slope = s.mul(by_rgb, factor[c]);
                if self.output.exponential {
                    slope = s.mul(slope, s.add(colour[c], s.splat(1.0)));
                }
                if self.output.mask {
                    let sigmoid = s.sub(factor[c], s.splat(MASK_FLOOR));
                    let bend = s.mul(sigmoid, s.sub(s.splat(1.0), sigmoid));
                    let value = s.mul(s.mul(by_rgb, colour[c]), bend);
                    s.store(&mut self.out[(3 + c) * stride + at..], value);
                }
                match self.output.matrix {
                    Some(m) => {
                        for k in 0..3 {
                            raw[k] = s.fma(slope, s.splat(m[c][k]), raw[k]);
                        }
                    }
                    None => raw[c] = slope,
                }
            }
            for k in 0..3 {
                s.store(&mut self.out[k * stride + at..], raw[k]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Random, Stream};

    /// A few roundings of values up to e^2.
    const ROUNDING: f64 = 5e-6;
    const STRIDE: usize = 32;

    fn rgb64(output: Output, y: &[f64; 6]) -> [f64; 3] {
        [0, 1, 2].map(|c| {
            let mut x = match output.matrix {
                Some(m) => (0..3).map(|k| f64::from(m[c][k]) * y[k]).sum(),
                None => y[c],
            };
            if output.exponential {
                x = x.exp() - 1.0;
            }
            if output.mask { x * (0.1 + 1.0 / (1.0 + (-y[3 + c]).exp())) } else { x }
        })
    }

    /// Largest errors of values and gradients, with one output changed.
    fn worst(isa: Isa, output: Output, change: f32) -> [f64; 2] {
        let mut random = Random::new(3, Stream::Probe, 0);
        let outputs: Vec<f32> = (0..6 * STRIDE).map(|_| random.normal() * 0.5).collect();
        let by_rgb: Vec<f32> = (0..3 * STRIDE).map(|_| random.normal()).collect();
        let mut given = outputs.clone();
        given[STRIDE + 5] += change;
        let (mut colour, mut slopes) = (vec![0.0; 3 * STRIDE], vec![0.0; 6 * STRIDE]);
        rgb(isa, output, STRIDE, &given, &mut colour);
        gradient(isa, output, STRIDE, &given, &by_rgb, &mut slopes);
        let mut worst = [0.0f64; 2];
        for n in 0..STRIDE {
            let y: [f64; 6] = std::array::from_fn(|k| f64::from(outputs[k * STRIDE + n]));
            let exact = rgb64(output, &y);
            for c in 0..3 {
                worst[0] = worst[0].max((f64::from(colour[c * STRIDE + n]) - exact[c]).abs());
            }
            for k in 0..if output.mask { 6 } else { 3 } {
                let at = |step: f64| {
                    let mut y = y;
                    y[k] += step;
                    let rgb = rgb64(output, &y);
                    (0..3).map(|c| rgb[c] * f64::from(by_rgb[c * STRIDE + n])).sum::<f64>()
                };
                let slope = (at(1e-5) - at(-1e-5)) / 2e-5;
                worst[1] = worst[1].max((f64::from(slopes[k * STRIDE + n]) - slope).abs());
            }
        }
        worst
    }

    #[test]
    fn values_and_gradients_follow_float64_and_a_changed_output_is_noticed() {
        const YUV: [[f32; 3]; 3] = [[1.0, 0.0, 1.14], [1.0, -0.39, -0.58], [1.0, 2.03, 0.0]];
        for isa in Isa::all() {
            for matrix in [None, Some(YUV)] {
                for exponential in [false, true] {
                    for mask in [false, true] {
                        let output = Output { matrix, exponential, mask };
                        let [value, slope] = worst(isa, output, 0.0);
                        assert!(value < ROUNDING && slope < ROUNDING, "{output:?} {value:e} {slope:e}");
                        assert!(worst(isa, output, 1e-3)[0] > ROUNDING);
                        let bends = exponential || mask;
                        assert!(!bends || worst(isa, output, 1e-3)[1] > ROUNDING);
                    }
                }
            }
        }
    }
}
