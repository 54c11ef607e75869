//! Adam (Kingma and Ba 2015, algorithm 1), element by element, in place, in one pass over memory.

use super::simd::{Isa, Simd, Work, dispatch};
use super::smooth::compact_texels;
use rayon::prelude::*;

/// Elements a task works on: 4 x 64 KiB stay in the second-level cache.
const CHUNK: usize = 16 * 1024;
/// Gradients of padded texels that are brought together before they are used: they stay in the first-level cache.
const TOGETHER: usize = 512;

/// Constants of one update.
#[derive(Clone, Copy, Debug)]
pub struct Update {
    /// Learning rate divided by (1 - beta1^t).
    pub rate: f32,
    /// 1 / sqrt(1 - beta2^t).
    pub root_correction: f32,
    /// epsilon.
    pub epsilon: f32,
}

impl Update {
    /// The constants of step `t`, counted from 1.
    pub fn new(rate: f64, beta1: f64, beta2: f64, epsilon: f64, t: u64) -> Self {
        let power = |beta: f64| beta.powf(t as f64);
        Self {
            rate: (rate / (1.0 - power(beta1))) as f32,
            root_correction: (1.0 / (1.0 - power(beta2)).sqrt()) as f32,
            epsilon: epsilon as f32,
        }
    }
}

/// One update of `theta` and its moments by `gradient`:
///
/// first = beta1 first + (1 - beta1) gradient, second = beta2 second + (1 - beta2) gradient^2,
/// theta -= rate first / (sqrt(second) root_correction + epsilon).
///
/// # Panics
/// If the lengths differ.
pub fn step(
    isa: Isa,
    theta: &mut [f32],
    first: &mut [f32],
    second: &mut [f32],
    gradient: &[f32],
    betas: [f32; 2],
    update: Update,
) {
    let lengths = [first.len(), second.len(), gradient.len()];
    assert!(lengths.iter().all(|n| *n == theta.len()), "lengths");
    let moments = first.par_chunks_mut(CHUNK).zip(second.par_chunks_mut(CHUNK));
    let chunks = theta.par_chunks_mut(CHUNK).zip(moments).zip(gradient.par_chunks(CHUNK));
    chunks.for_each(|((theta, (first, second)), gradient)| {
        dispatch(isa, Dense { values: [theta, first, second], gradient, betas, update });
    });
}

/// [`step`] of texels of `channels` floats by a gradient \[texels, stride\] whose texels are padded, which becomes 0.
///
/// # Panics
/// If the lengths do not fit.
#[expect(clippy::too_many_arguments, reason = "the arguments of `step` and two more")]
pub fn step_padded(
    isa: Isa,
    theta: &mut [f32],
    first: &mut [f32],
    second: &mut [f32],
    gradient: &mut [f32],
    stride: usize,
    channels: usize,
    betas: [f32; 2],
    update: Update,
) {
    assert!(first.len() == theta.len() && second.len() == theta.len(), "lengths");
    if theta.is_empty() {
        gradient.fill(0.0);
        return;
    }
    assert!(0 < channels && channels <= stride, "fewer floats a texel than channels");
    let texels = theta.len() / channels;
    assert!(theta.len() == texels * channels && gradient.len() == texels * stride, "lengths");
    let rows = (CHUNK / channels).max(1);
    let moments = first.par_chunks_mut(rows * channels).zip(second.par_chunks_mut(rows * channels));
    let chunks =
        theta.par_chunks_mut(rows * channels).zip(moments).zip(gradient.par_chunks_mut(rows * stride));
    chunks.for_each(|((theta, (first, second)), gradient)| {
        let values = [theta, first, second];
        dispatch(isa, Padded { values, gradient, shape: [stride, channels], betas, update });
    });
}

/// theta, first, second of a chunk, and its gradient.
struct Dense<'a> {
    values: [&'a mut [f32]; 3],
    gradient: &'a [f32],
    betas: [f32; 2],
    update: Update,
}

impl Work for Dense<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let [theta, first, second] = self.values;
        let [beta1, beta2] = self.betas.map(|beta| s.splat(beta));
        let [rest1, rest2] = self.betas.map(|beta| s.splat(1.0 - beta));
        let rate = s.splat(-self.update.rate);
        let (correction, epsilon) = (s.splat(self.update.root_correction), s.splat(self.update.epsilon));
        macro_rules! advance {
            ($theta:expr, $first:expr, $second:expr, $gradient:expr) => {
                let g = s.load($gradient);
                let m = s.fma(beta1, s.load($first), s.mul(rest1, g));
                let v = s.fma(beta2, s.load($second), s.mul(rest2, s.mul(g, g)));
                let root = s.fma(s.sqrt(v), correction, epsilon);
                let moved = s.add(s.load($theta), s.div(s.mul(rate, m), root));
                s.store($theta, moved);
                s.store($first, m);
                s.store($second, v);
            };
        }
        let mut theta = theta.chunks_exact_mut(S::LANES);
        let mut first = first.chunks_exact_mut(S::LANES);
        let mut second = second.chunks_exact_mut(S::LANES);
        let mut gradient = self.gradient.chunks_exact(S::LANES);
        for (((t, m), v), g) in theta.by_ref().zip(first.by_ref()).zip(second.by_ref()).zip(gradient.by_ref())
        {
            advance!(t, m, v, g);
        }
        // What is left goes through whole vectors too, so that an element's value does not depend on where it lies.
        let tail = [theta.into_remainder(), first.into_remainder(), second.into_remainder()];
        let gradient = gradient.remainder();
        let n = gradient.len();
        let (mut lanes, mut last) = ([[0.0; MOST_LANES]; 3], [0.0; MOST_LANES]);
        for (lanes, tail) in lanes.iter_mut().zip(&tail) {
            lanes[..n].copy_from_slice(&tail[..n]);
        }
        last[..n].copy_from_slice(gradient);
        let [t, m, v] = &mut lanes;
        advance!(t, m, v, &last);
        for (tail, lanes) in tail.into_iter().zip(&lanes) {
            tail[..n].copy_from_slice(&lanes[..n]);
        }
    }
}

/// Lanes of the widest vector.
const MOST_LANES: usize = 16;

/// The same of a chunk of texels, with \[stride, channels\].
struct Padded<'a> {
    values: [&'a mut [f32]; 3],
    gradient: &'a mut [f32],
    shape: [usize; 2],
    betas: [f32; 2],
    update: Update,
}

impl Work for Padded<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let [stride, channels] = self.shape;
        let [mut theta, mut first, mut second] = self.values;
        let (betas, update) = (self.betas, self.update);
        let mut together = [0.0; TOGETHER];
        let texels = (TOGETHER / channels).max(1);
        for padded in self.gradient.chunks_mut(texels * stride) {
            let n = padded.len() / stride * channels;
            let values = [take(&mut theta, n), take(&mut first, n), take(&mut second, n)];
            // A texel of more than the room for many is used where it lies.
            let gradient = match together.get_mut(..n) {
                Some(together) => {
                    compact_texels(padded, stride, channels, together);
                    &*together
                }
                None => &padded[..n],
            };
            Dense { values, gradient, betas, update }.run(s);
            padded.fill(0.0);
        }
    }
}

/// The first `n`, taken off.
#[inline(always)]
fn take<'a>(values: &mut &'a mut [f32], n: usize) -> &'a mut [f32] {
    let (part, rest) = std::mem::take(values).split_at_mut(n);
    *values = rest;
    part
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Random, Stream};

    /// A handful of f32 roundings of values up to 3 at each of 50 steps, which the gradient feeds back.
    const ROUNDING: f64 = 3e-5;
    const BETAS: [f64; 2] = [0.9, 0.999];
    const STEPS: u64 = 50;

    fn noise(n: usize, index: u64) -> Vec<f32> {
        let mut random = Random::new(7, Stream::Probe, index);
        (0..n).map(|_| random.normal()).collect()
    }

    fn at(t: u64) -> Update {
        Update::new(0.05, BETAS[0], BETAS[1], 1e-8, t)
    }

    /// Texels of `channels` floats whose gradient at step t is theta - 3 + noise, with the gradient dense or padded to
    /// `stride`; `wrong` is added to the gradient of the last element.
    fn steps(isa: Isa, texels: usize, channels: usize, stride: Option<usize>, wrong: f32) -> Vec<f32> {
        let n = texels * channels;
        let (mut theta, mut m, mut v) = (noise(n, 0), vec![0.0; n], vec![0.0; n]);
        let betas = BETAS.map(|b| b as f32);
        for t in 1..=STEPS {
            let mut gradient: Vec<f32> = noise(n, t).iter().zip(&theta).map(|(e, x)| x - 3.0 + e).collect();
            if let Some(last) = gradient.last_mut() {
                *last += wrong;
            }
            let Some(stride) = stride else {
                step(isa, &mut theta, &mut m, &mut v, &gradient, betas, at(t));
                continue;
            };
            let mut padded = vec![f32::NAN; texels * stride];
            for (to, from) in padded.chunks_mut(stride).zip(gradient.chunks(channels)) {
                to[..channels].copy_from_slice(from);
            }
            step_padded(isa, &mut theta, &mut m, &mut v, &mut padded, stride, channels, betas, at(t));
            assert!(padded.iter().all(|g| *g == 0.0));
        }
        theta
    }

    fn steps_in_float64(n: usize) -> Vec<f64> {
        let one = |i: usize, start: f32, noise: &[Vec<f32>]| {
            let (mut x, mut m, mut v) = (f64::from(start), 0.0, 0.0);
            for t in 1..=STEPS as i32 {
                let g = x - 3.0 + f64::from(noise[t as usize - 1][i]);
                m = BETAS[0] * m + (1.0 - BETAS[0]) * g;
                v = BETAS[1] * v + (1.0 - BETAS[1]) * g * g;
                let root = (v / (1.0 - BETAS[1].powi(t))).sqrt();
                x -= 0.05 * (m / (1.0 - BETAS[0].powi(t))) / (root + 1e-8);
            }
            x
        };
        let all: Vec<Vec<f32>> = (1..=STEPS).map(|t| noise(n, t)).collect();
        noise(n, 0).iter().enumerate().map(|(i, start)| one(i, *start, &all)).collect()
    }

    fn worst(a: &[f32], b: &[f64]) -> f64 {
        assert_eq!(a.len(), b.len());
        a.iter().zip(b).map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn follows_float64_whatever_the_padding_and_notices_a_changed_gradient() {
        for (texels, channels, stride) in [(1, 1, 8), (5, 7, 8), (33, 9, 16), (611, 3, 3), (2, 2500, 2504)] {
            let expected = steps_in_float64(texels * channels);
            for isa in Isa::all() {
                let dense = steps(isa, texels, channels, None, 0.0);
                let found = worst(&dense, &expected);
                assert!(found < ROUNDING, "{} {texels} {channels} {found:e}", isa.name());
                assert_eq!(steps(isa, texels, channels, Some(stride), 0.0), dense);
                assert!(worst(&steps(isa, texels, channels, Some(stride), 0.01), &expected) > ROUNDING);
            }
        }
    }

    #[test]
    fn nothing_and_what_is_no_number() {
        for isa in Isa::all() {
            step(isa, &mut [], &mut [], &mut [], &[], [0.9, 0.999], at(1));
            step_padded(isa, &mut [], &mut [], &mut [], &mut [], 8, 7, [0.9, 0.999], at(1));
            let (mut theta, mut m, mut v) = ([1.0; 4], [0.0; 4], [0.0; 4]);
            let gradient = [f32::NAN, f32::INFINITY, 1e-40, 0.0];
            step(isa, &mut theta, &mut m, &mut v, &gradient, [0.9, 0.999], at(1));
            assert!(theta[0].is_nan() && theta[1].is_nan() && theta[2].is_finite());
            assert_eq!(theta[3], 1.0);
        }
    }

    #[test]
    fn any_number_of_threads_gives_the_same_bytes() {
        let texels = 3 * CHUNK / 7 + 5;
        for isa in Isa::all() {
            let run = |threads: usize| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                let bits = |values: Vec<f32>| values.into_iter().map(f32::to_bits).collect::<Vec<_>>();
                pool.install(|| {
                    [bits(steps(isa, texels, 7, None, 0.0)), bits(steps(isa, texels, 7, Some(8), 0.0))]
                })
            };
            let one = run(1);
            assert_eq!(one[0], one[1]);
            assert!(run(2) == one && run(4) == one, "{}", isa.name());
        }
    }
}
