//! Input encoding of a tile: rows of samples in, a row of samples for every sine and cosine out, in the order of
//! [`super::encoding`].

use super::encoding::RESTART;
use super::math;
use super::simd::{Isa, Simd, Work, dispatch};

/// What sines and cosines are multiplied with.
#[derive(Clone, Copy, Debug)]
pub enum Factor<'a> {
    /// The same for all.
    Amplitude(f32),
    /// exp(-(frequency sigma)^2 / 2) with sigma = 2^level \* these, a component each, for these levels \[stride\].
    Footprint(&'a [f32], [f32; 2]),
}

/// Encodes a tile: components \[D\]\[stride\] to \[bands\]\[sines, then cosines\]\[D\]\[stride\].
///
/// # Panics
/// If `stride` is no multiple of 16 or a slice is too short.
pub fn encode(isa: Isa, stride: usize, p: &[f32], bands: usize, pi: bool, factor: Factor, out: &mut [f32]) {
    let components = p.len() / stride;
    assert!(
        stride.is_multiple_of(16)
            && components <= 3
            && bands <= MOST_BANDS
            && out.len() >= 2 * components * bands * stride
    );
    let uniform = match factor {
        Factor::Amplitude(_) => true,
        Factor::Footprint(level, _) => level.iter().all(|l| *l == level[0]),
    };
    for component in 0..components {
        dispatch(isa, Encode { stride, p, bands, pi, factor, out, component, components, uniform });
    }
}

struct Encode<'a> {
    stride: usize,
    p: &'a [f32],
    bands: usize,
    pi: bool,
    factor: Factor<'a>,
    out: &'a mut [f32],
    component: usize,
    components: usize,
    uniform: bool,
}

impl Work for Encode<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let Self { stride, bands, component, components, .. } = self;
        let p = &self.p[component * stride..(component + 1) * stride];
        // Of the first band; the factor of band k has 4^k times the exponent.
        let exponent = |sigma: S::F| {
            let frequency = if self.pi { std::f32::consts::PI } else { 1.0 };
            let x = s.mul(sigma, s.splat(frequency));
            s.mul(s.mul(x, x), s.splat(-0.5))
        };
        let mut factors = [s.splat(1.0); MOST_BANDS];
        let mut first = s.splat(0.0);
        match self.factor {
            Factor::Amplitude(amplitude) => factors = [s.splat(amplitude); MOST_BANDS],
            Factor::Footprint(level, sigma) if self.uniform => {
                first = exponent(s.splat(sigma[component % 2] * level[0].exp2()));
                for (k, factor) in factors.iter_mut().enumerate().take(bands) {
                    *factor = math::exp(s, s.mul(first, s.splat(four_to(k))));
                }
            }
            Factor::Footprint(..) => {}
        }
        for at in (0..stride).step_by(S::LANES) {
            if let (Factor::Footprint(level, sigma), false) = (self.factor, self.uniform) {
                let size = math::exp(s, s.mul(s.load(&level[at..]), s.splat(std::f32::consts::LN_2)));
                first = exponent(s.mul(size, s.splat(sigma[component % 2])));
            }
            let x = s.load(&p[at..]);
            let (mut sin, mut cos) = (s.splat(0.0), s.splat(1.0));
            for band in 0..bands {
                if band % RESTART == 0 {
                    let t = s.mul(x, s.splat((1u32 << band) as f32));
                    (sin, cos) = if self.pi { math::sin_cos_pi(s, t) } else { sin_cos(s, t) };
                } else {
                    let twice = s.add(sin, sin);
                    (sin, cos) = (s.mul(twice, cos), s.sub(s.splat(1.0), s.mul(twice, sin)));
                }
                let factor = if self.uniform {
                    factors[band]
                } else {
                    math::exp(s, s.mul(first, s.splat(four_to(band))))
                };
                let row = 2 * components * band + component;
                s.store(&mut self.out[row * stride + at..], s.mul(sin, factor));
                s.store(&mut self.out[(row + components) * stride + at..], s.mul(cos, factor));
            }
        }
    }
}

/// Most bands: 2^23 periods a tile is where f32 positions end.
pub const MOST_BANDS: usize = 24;

/// 4^k.
#[inline(always)]
fn four_to(k: usize) -> f32 {
    (1u64 << (2 * k)) as f32
}

/// Sine and cosine of radians, a lane at a time: only configurations without pi come here, and no reduction of large
/// arguments by a few products is exact.
#[inline(always)]
fn sin_cos<S: Simd>(s: S, x: S::F) -> (S::F, S::F) {
    let (mut sin, mut cos) = ([0.0f32; 16], [0.0f32; 16]);
    s.store(&mut sin, x);
    for k in 0..S::LANES {
        (sin[k], cos[k]) = sin[k].sin_cos();
    }
    (s.load(&sin), s.load(&cos))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::encoding::{DRIFT, footprint_sigma};
    use crate::random::{Random, Stream};

    const STRIDE: usize = 32;
    const BANDS: usize = 10;

    /// Largest difference from float64, for positions moved by `moved`; levels differ from sample to sample, or do not.
    fn worst(isa: Isa, components: usize, pi: bool, footprint: Option<bool>, moved: f32) -> f64 {
        let mut random = Random::new(5, Stream::Probe, components as u64);
        let p: Vec<f32> = (0..components * STRIDE).map(|_| 2.0 * random.uniform() - 1.0).collect();
        let varied = |k: usize| if footprint == Some(true) { 0.25 * (k % 9) as f32 } else { 1.5 };
        let level: Vec<f32> = (0..STRIDE).map(varied).collect();
        let sigma = [footprint_sigma(0.0, 64), footprint_sigma(0.0, 128)];
        let factor = match footprint {
            Some(_) => Factor::Footprint(&level, sigma),
            None => Factor::Amplitude(0.25),
        };
        let given: Vec<f32> = p.iter().map(|p| p + moved).collect();
        let mut out = vec![f32::NAN; 2 * components * BANDS * STRIDE];
        encode(isa, STRIDE, &given, BANDS, pi, factor, &mut out);
        let mut worst = 0.0f64;
        for (i, value) in out.iter().enumerate() {
            let (row, k) = (i / STRIDE, i % STRIDE);
            let (band, of_band) = (row / (2 * components), row % (2 * components));
            let c = of_band % components;
            let frequency = f64::from(1 << band) * if pi { std::f64::consts::PI } else { 1.0 };
            let angle = frequency * f64::from(p[c * STRIDE + k]);
            let wave = if of_band < components { angle.sin() } else { angle.cos() };
            let amplitude = match footprint {
                Some(_) => {
                    let x = frequency * f64::from(level[k]).exp2() * f64::from(sigma[c % 2]);
                    (-0.5 * x * x).exp()
                }
                None => 0.25,
            };
            worst = worst.max((f64::from(*value) - wave * amplitude).abs());
        }
        worst
    }

    #[test]
    fn tiles_follow_float64_and_a_moved_position_is_noticed() {
        for isa in Isa::all() {
            for components in [2, 3] {
                for pi in [true, false] {
                    for footprint in [None, Some(false), Some(true)] {
                        // An attenuation has two components.
                        if components == 3 && footprint.is_some() {
                            continue;
                        }
                        let found = worst(isa, components, pi, footprint, 0.0);
                        assert!(found < f64::from(DRIFT), "{} {pi} {footprint:?} {found:e}", isa.name());
                        assert!(worst(isa, components, pi, footprint, 1e-4) > f64::from(DRIFT));
                    }
                }
            }
        }
    }
}
