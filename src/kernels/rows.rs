//! Tiles as rows of samples: queries turned into rows, and the parallax of the neural offset.

use super::simd::{Isa, Simd, Work, dispatch};

/// Writes pairs as two rows, zeros behind them; with `wrap` each value's fraction of 1.
///
/// # Panics
/// If the rows are shorter than the pairs, or not of one length that is a multiple of 16.
pub fn split(isa: Isa, pairs: &[[f32; 2]], wrap: bool, x: &mut [f32], y: &mut [f32]) {
    assert!(x.len() == y.len() && x.len().is_multiple_of(16));
    for (k, pair) in pairs.iter().enumerate() {
        (x[k], y[k]) = (pair[0], pair[1]);
    }
    x[pairs.len()..].fill(0.0);
    y[pairs.len()..].fill(0.0);
    if wrap {
        for row in [x, y] {
            dispatch(isa, Wrap(row));
        }
    }
}

struct Wrap<'a>(&'a mut [f32]);

impl Work for Wrap<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        for part in self.0.chunks_exact_mut(S::LANES) {
            let u = s.load(part);
            s.store(part, s.sub(u, s.floor(u)));
        }
    }
}

/// a x + b of a row.
pub fn affine(isa: Isa, x: &[f32], a: f32, b: f32, out: &mut [f32]) {
    dispatch(isa, Affine { x, a, b, out });
}

struct Affine<'a> {
    x: &'a [f32],
    a: f32,
    b: f32,
    out: &'a mut [f32],
}

impl Work for Affine<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        for (out, x) in self.out.chunks_exact_mut(S::LANES).zip(self.x.chunks_exact(S::LANES)) {
            s.store(out, s.add(s.mul(s.load(x), s.splat(self.a)), s.splat(self.b)));
        }
    }
}

/// z = sqrt(max(0, 1 - x^2 - y^2)) of directions.
pub fn height(isa: Isa, x: &[f32], y: &[f32], z: &mut [f32]) {
    dispatch(isa, Height { x, y, z });
}

struct Height<'a> {
    x: &'a [f32],
    y: &'a [f32],
    z: &'a mut [f32],
}

impl Work for Height<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let rows = self.x.chunks_exact(S::LANES).zip(self.y.chunks_exact(S::LANES));
        for (z, (x, y)) in self.z.chunks_exact_mut(S::LANES).zip(rows) {
            let (x, y) = (s.load(x), s.load(y));
            // Products rounded one by one, as the format has them: near the horizon a rounding decides.
            let square = s.sub(s.sub(s.splat(1.0), s.mul(x, x)), s.mul(y, y));
            s.store(z, s.sqrt(s.max(square, s.splat(0.0))));
        }
    }
}

/// NeuMIP's neural offset: u' = u + depth scale 0.5 wo.xy / max(wo.z, min_z).
#[derive(Clone, Copy, Debug)]
pub struct Parallax {
    /// Factor on the network's output.
    pub scale: f32,
    /// Least wo.z that divides.
    pub min_z: f32,
}

impl Parallax {
    /// How far one unit of the network's output moves u along one axis, from that component of wo and from wo.z.
    pub fn reach(self, isa: Isa, w: &[f32], z: &[f32], out: &mut [f32]) {
        dispatch(isa, Reach { parallax: self, w, z, out });
    }
}

struct Reach<'a> {
    parallax: Parallax,
    w: &'a [f32],
    z: &'a [f32],
    out: &'a mut [f32],
}

impl Work for Reach<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let rows = self.w.chunks_exact(S::LANES).zip(self.z.chunks_exact(S::LANES));
        for (out, (w, z)) in self.out.chunks_exact_mut(S::LANES).zip(rows) {
            let half = s.div(s.splat(0.5), s.max(s.load(z), s.splat(self.parallax.min_z)));
            s.store(out, s.mul(s.mul(half, s.load(w)), s.splat(self.parallax.scale)));
        }
    }
}

/// out = a + b c, row by row.
pub fn multiply_add(isa: Isa, a: &[f32], b: &[f32], c: &[f32], out: &mut [f32]) {
    dispatch(isa, MultiplyAdd { a, b, c, out });
}

struct MultiplyAdd<'a> {
    a: &'a [f32],
    b: &'a [f32],
    c: &'a [f32],
    out: &'a mut [f32],
}

impl Work for MultiplyAdd<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let n = S::LANES;
        let rows = self.a.chunks_exact(n).zip(self.b.chunks_exact(n)).zip(self.c.chunks_exact(n));
        for (out, ((a, b), c)) in self.out.chunks_exact_mut(n).zip(rows) {
            s.store(out, s.fma(s.load(b), s.load(c), s.load(a)));
        }
    }
}

/// Gradient by the network's output \[stride\] from that by features and their slopes:
/// sum over axes of reach (sum over channels of gradient slope). Slopes \[2\]\[channels\]\[stride\], reach \[2\]\[stride\].
pub fn parallax_gradient(
    isa: Isa,
    stride: usize,
    gradient: &[f32],
    slopes: &[f32],
    reach: &[f32],
    out: &mut [f32],
) {
    dispatch(isa, ParallaxGradient { stride, gradient, slopes, reach, out });
}

struct ParallaxGradient<'a> {
    stride: usize,
    gradient: &'a [f32],
    slopes: &'a [f32],
    reach: &'a [f32],
    out: &'a mut [f32],
}

impl Work for ParallaxGradient<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let (stride, half) = (self.stride, self.slopes.len() / 2);
        for at in (0..stride).step_by(S::LANES) {
            let (mut x, mut y) = (s.splat(0.0), s.splat(0.0));
            for row in (0..half).step_by(stride) {
                let gradient = s.load(&self.gradient[row + at..]);
                x = s.fma(gradient, s.load(&self.slopes[row + at..]), x);
                y = s.fma(gradient, s.load(&self.slopes[half + row + at..]), y);
            }
            let along = s.mul(x, s.load(&self.reach[at..]));
            s.store(&mut self.out[at..], s.fma(y, s.load(&self.reach[stride + at..]), along));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Random, Stream};

    /// A few roundings of values of size 1; sums of a handful of them.
    const ROUNDING: f64 = 3e-6;
    const STRIDE: usize = 32;

    fn noise(n: usize, seed: u64) -> Vec<f32> {
        let mut random = Random::new(seed, Stream::Probe, 1);
        (0..n).map(|_| random.normal()).collect()
    }

    fn worst(a: &[f32], b: impl Fn(usize) -> f64) -> f64 {
        a.iter().enumerate().map(|(k, a)| (f64::from(*a) - b(k)).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn pairs_become_rows_that_wrap_and_end_in_zeros() {
        for isa in Isa::all() {
            let (mut x, mut y) = ([9.0; 16], [9.0; 16]);
            split(isa, &[[1.25, -0.25], [-3.5, 7.0]], true, &mut x, &mut y);
            assert_eq!((x[..3].to_vec(), y[..3].to_vec()), (vec![0.25, 0.5, 0.0], vec![0.75, 0.0, 0.0]));
            split(isa, &[[1.25, -0.25]], false, &mut x, &mut y);
            assert_eq!((x[0], y[0], x[15]), (1.25, -0.25, 0.0));
            let mut z = [9.0; 16];
            height(isa, &[0.6; 16], &[0.0; 16], &mut z);
            assert!((z[3] - 0.8).abs() < 1e-6);
            height(isa, &[1.5; 16], &[0.0; 16], &mut z);
            assert_eq!(z, [0.0; 16]);
            affine(isa, &[0.75; 16], 2.0, -1.0, &mut z);
            assert_eq!(z, [0.5; 16]);
        }
    }

    #[test]
    fn parallax_and_its_gradient_follow_float64_and_a_changed_one_is_noticed() {
        let parallax = Parallax { scale: 0.1, min_z: 0.6 };
        let w: Vec<f32> = noise(STRIDE, 1).iter().map(|w| 0.4 * w).collect();
        let z: Vec<f32> = noise(STRIDE, 2).iter().map(|z| z.abs()).collect();
        let (channels, u) = (3, noise(STRIDE, 3));
        let depth = noise(STRIDE, 4);
        let gradient = noise(channels * STRIDE, 5);
        let slopes = noise(2 * channels * STRIDE, 6);
        let reach64 = |k: usize| 0.1 * 0.5 * f64::from(w[k]) / f64::from(z[k]).max(0.6);
        for isa in Isa::all() {
            let mut reach = vec![0.0; 2 * STRIDE];
            for half in reach.chunks_mut(STRIDE) {
                parallax.reach(isa, &w, &z, half);
            }
            assert!(worst(&reach[..STRIDE], reach64) < ROUNDING);
            assert!(worst(&reach[..STRIDE], |k| reach64(k) + 1e-5) > ROUNDING);
            let mut moved = vec![0.0; STRIDE];
            multiply_add(isa, &u, &reach[..STRIDE], &depth, &mut moved);
            let moved64 = |k: usize| f64::from(u[k]) + f64::from(depth[k]) * reach64(k);
            assert!(worst(&moved, moved64) < ROUNDING);
            assert!(worst(&moved, |k| moved64(k) + 1e-5) > ROUNDING);
            let mut out = vec![0.0; STRIDE];
            parallax_gradient(isa, STRIDE, &gradient, &slopes, &reach, &mut out);
            let gradient64 = |k: usize| {
                (0..2 * channels)
                    .map(|i| {
                        f64::from(gradient[i % channels * STRIDE + k]) * f64::from(slopes[i * STRIDE + k])
                    })
                    .sum::<f64>()
                    * reach64(k)
            };
            assert!(worst(&out, gradient64) < ROUNDING);
            assert!(worst(&out, |k| gradient64(k) + 1e-5) > ROUNDING);
        }
    }
}
