//! Output remapping in lanes: values and slopes.

use super::super::math;
use super::super::simd::Simd;
use super::Remap;

/// Least value under the guarded 4th root (authors' code).
pub const GUARD: f32 = 1e-7;
/// Least value under log1p (NeuMIP's code).
pub const LOG_FLOOR: f32 = -0.1;

/// A remap and its constants in lanes.
pub struct Curve<S: Simd> {
    remap: Remap,
    epsilon: S::F,
    /// The root of epsilon, taken as other roots are: the image of 0 is 0.
    at_zero: S::F,
}

impl<S: Simd> Curve<S> {
    #[inline(always)]
    pub fn new(s: S, remap: Remap) -> Self {
        let (epsilon, at_zero) = match remap {
            Remap::Root4Signed(e) => (s.splat(e), s.sqrt(s.sqrt(s.splat(e)))),
            Remap::Sqrt(e) => (s.splat(e), s.sqrt(s.splat(e))),
            _ => (s.splat(0.0), s.splat(0.0)),
        };
        Self { remap, epsilon, at_zero }
    }

    /// Value, and slope where a guard is taken no notice of: past it, the slope at it.
    #[inline(always)]
    pub fn at(&self, s: S, x: S::F) -> (S::F, S::F) {
        match self.remap {
            Remap::Linear => (x, s.splat(1.0)),
            Remap::Root4Literal => root4(s, x),
            Remap::Root4Guarded => root4(s, s.max(s.splat(GUARD), x)),
            Remap::Root4Signed(_) => {
                let (value, slope) = root4(s, s.add(absolute(s, x), self.epsilon));
                (with_sign(s, s.sub(value, self.at_zero), x), slope)
            }
            Remap::Sqrt(_) => {
                let root = s.sqrt(s.add(absolute(s, x), self.epsilon));
                (with_sign(s, s.sub(root, self.at_zero), x), s.div(s.splat(0.5), root))
            }
            Remap::Log => {
                let y = s.add(s.max(s.splat(LOG_FLOOR), x), s.splat(1.0));
                // Adding 0 y keeps the loss of an infinity from being a number, which `ln` alone would make of it.
                let value = s.fma(y, s.splat(0.0), math::ln(s, y));
                (value, s.div(s.splat(1.0), y))
            }
        }
    }

    /// The remap's slope from the one that [`Curve::at`] gives: 0 past a guard.
    #[inline(always)]
    pub fn cut(&self, s: S, x: S::F, slope: S::F) -> S::F {
        match self.remap {
            Remap::Root4Guarded => above(s, x, GUARD, slope),
            Remap::Log => above(s, x, LOG_FLOOR, slope),
            _ => slope,
        }
    }
}

/// x^(1/4) and its slope.
#[inline(always)]
fn root4<S: Simd>(s: S, x: S::F) -> (S::F, S::F) {
    let half = s.sqrt(x);
    let root = s.sqrt(half);
    (root, s.div(s.splat(0.25), s.mul(half, root)))
}

/// The slope of max(x, least), times `slope`: half of it where they are equal, as candle has it.
#[inline(always)]
fn above<S: Simd>(s: S, x: S::F, least: f32, slope: S::F) -> S::F {
    let least = s.splat(least);
    let equal = s.mul(slope, s.splat(0.5));
    s.select(s.greater(x, least), slope, s.select(s.greater(least, x), s.splat(0.0), equal))
}

/// |x|.
#[inline(always)]
pub fn absolute<S: Simd>(s: S, x: S::F) -> S::F {
    s.as_float(s.int_and(s.bits(x), s.int(i32::MAX)))
}

/// A magnitude with the sign of x.
#[inline(always)]
fn with_sign<S: Simd>(s: S, magnitude: S::F, x: S::F) -> S::F {
    s.as_float(s.int_xor(s.bits(magnitude), s.int_and(s.bits(x), s.int(i32::MIN))))
}

/// -1, 0 or 1; x itself where it is no number.
#[inline(always)]
pub fn sign<S: Simd>(s: S, x: S::F) -> S::F {
    let zero = s.splat(0.0);
    s.select(s.greater(x, zero), s.splat(1.0), s.select(s.greater(zero, x), s.splat(-1.0), x))
}
