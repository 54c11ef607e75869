//! Elementary functions on vectors, by polynomials on reduced arguments.

use super::simd::Simd;
use std::f32::consts::PI;

/// Largest difference of [`sin_cos_pi`] from float64: three roundings of values up to 1.
pub const SINE_ERROR: f64 = 1.5e-7;
/// Largest relative difference of [`exp`] from float64: the reduced argument's rounding and two more.
pub const EXP_ERROR: f64 = 2e-7;
/// Largest difference of [`ln`] from float64, relative to 1 + |ln x|.
pub const LN_ERROR: f64 = 2e-7;

/// Adding and taking away 1.5 * 2^23 rounds to the nearest integer, and leaves that integer in the lowest bits between.
const ROUND: f32 = 12_582_912.0;

/// sin(pi t) and cos(pi t) for |t| up to 2^21; beyond that every f32 is a multiple of 1/4 and the answer may be of a neighbour.
#[inline(always)]
pub fn sin_cos_pi<S: Simd>(s: S, t: S::F) -> (S::F, S::F) {
    // t = x + q / 2 with |x| <= 1/4, exactly; sine and cosine trade places with every odd q.
    let shifted = s.add(s.add(t, t), s.splat(ROUND));
    let q = s.bits(shifted);
    let x = s.fma(s.sub(shifted, s.splat(ROUND)), s.splat(-0.5), t);
    let y = s.mul(x, x);
    let step = |sum: S::F, c: f32| s.fma(sum, y, s.splat(c));
    let sin =
        s.mul(step(step(step(step(s.splat(0.080_888_05), -0.599_186_1), 2.550_162), -5.167_712_8), PI), x);
    let cos = step(
        step(step(step(step(s.splat(-0.025_447_44), 0.235_305_41), -1.335_262), 4.058_712), -4.934_802),
        1.0,
    );
    let odd = s.greater(s.float(s.int_and(q, s.int(1))), s.splat(0.5));
    let sign = |v: S::F, q: S::I| s.as_float(s.int_xor(s.bits(v), s.int_up::<30>(s.int_and(q, s.int(2)))));
    (sign(s.select(odd, cos, sin), q), sign(s.select(odd, sin, cos), s.int_add(q, s.int(1))))
}

/// e^x: 0 below -87, infinite above 88, NaN for NaN.
#[inline(always)]
pub fn exp<S: Simd>(s: S, x: S::F) -> S::F {
    const LOG2_E: f32 = std::f32::consts::LOG2_E;
    // ln 2 in two parts; n times the first is exact.
    const HIGH: f32 = 0.693_359_4;
    const LOW: f32 = -2.121_944_4e-4;
    let bounded = s.min(s.max(x, s.splat(-87.0)), s.splat(88.0));
    let shifted = s.fma(bounded, s.splat(LOG2_E), s.splat(ROUND));
    let n = s.sub(shifted, s.splat(ROUND));
    let r = s.fma(n, s.splat(-LOW), s.fma(n, s.splat(-HIGH), bounded));
    let step = |sum: S::F, c: f32| s.fma(sum, r, s.splat(c));
    let tail = step(step(step(step(s.splat(1.395_17e-3), 8.369_592e-3), 4.166_619e-2), 1.666_651_3e-1), 0.5);
    let mantissa = s.add(s.fma(s.mul(tail, r), r, r), s.splat(1.0));
    // The lowest bits of `shifted` hold n: moved up, they are added to the exponent.
    let value = s.as_float(s.int_add(s.bits(mantissa), s.int_up::<23>(s.bits(shifted))));
    let value = s.select(s.greater(x, s.splat(88.0)), s.splat(f32::INFINITY), value);
    let value = s.select(s.greater(s.splat(-87.0), x), s.splat(0.0), value);
    keep_nan(s, x, value)
}

/// ln x of a positive normal number; what else comes is no promise but a number, NaN, or an infinity.
#[inline(always)]
pub fn ln<S: Simd>(s: S, x: S::F) -> S::F {
    // x = 2^e m with m in [sqrt(1/2), sqrt 2): the offset makes the exponent field turn there.
    let bits = s.int_add(s.bits(x), s.int(0x3f80_0000 - 0x3f35_04f3));
    let e = s.float(s.int_add(s.int_down::<23>(bits), s.int(-127)));
    let m = s.as_float(s.int_add(s.int_and(bits, s.int(0x007f_ffff)), s.int(0x3f35_04f3)));
    // ln m = 2 atanh f, f = (m - 1) / (m + 1), |f| <= 0.172.
    let f = s.div(s.sub(m, s.splat(1.0)), s.add(m, s.splat(1.0)));
    let y = s.mul(f, f);
    let step = |sum: S::F, c: f32| s.fma(sum, y, s.splat(c));
    let series = step(step(step(s.splat(0.235_937_69), 0.285_371), 0.400_003_27), 2.0 / 3.0);
    let value = s.fma(s.mul(f, y), series, s.add(f, f));
    keep_nan(s, x, s.fma(e, s.splat(std::f32::consts::LN_2), value))
}

/// `value`, or NaN where `x` is.
#[inline(always)]
fn keep_nan<S: Simd>(s: S, x: S::F, value: S::F) -> S::F {
    // x - x is 0 for every number, and an infinity that has been answered already stays.
    let finite = s.greater(s.splat(f32::MAX), x);
    let infinite = s.greater(x, s.splat(0.0));
    s.select(finite, value, s.select(infinite, value, s.splat(f32::NAN)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::simd::{Isa, Work, dispatch};

    #[derive(Clone, Copy)]
    enum Function {
        Sin,
        Cos,
        Exp,
        Ln,
    }

    struct Map<'a>(Function, &'a mut [f32]);

    impl Work for Map<'_> {
        type Output = ();

        #[inline(always)]
        fn run<S: Simd>(self, s: S) {
            for part in self.1.chunks_exact_mut(S::LANES) {
                let x = s.load(part);
                let y = match self.0 {
                    Function::Sin => sin_cos_pi(s, x).0,
                    Function::Cos => sin_cos_pi(s, x).1,
                    Function::Exp => exp(s, x),
                    Function::Ln => ln(s, x),
                };
                s.store(part, y);
            }
        }
    }

    /// Largest of `error(x, f(x + moved))` over `n` points of [low, high].
    fn worst(
        isa: Isa,
        f: Function,
        [low, high]: [f32; 2],
        moved: f32,
        error: impl Fn(f64, f64) -> f64,
    ) -> f64 {
        const POINTS: usize = 1 << 16;
        let at = |i: usize| low + (high - low) * (i as f32 / POINTS as f32);
        let mut values: Vec<f32> = (0..POINTS).map(|i| at(i) + moved).collect();
        dispatch(isa, Map(f, &mut values));
        values.iter().enumerate().map(|(i, y)| error(f64::from(at(i)), f64::from(*y))).fold(0.0, f64::max)
    }

    #[test]
    fn functions_follow_float64_and_a_moved_argument_is_noticed() {
        use std::f64::consts::PI;
        for isa in Isa::all() {
            let check = |f, range, bound: f64, moved: f32, error: &dyn Fn(f64, f64) -> f64| {
                let found = worst(isa, f, range, 0.0, error);
                assert!(found < bound, "{} {range:?} {found:e}", isa.name());
                assert!(worst(isa, f, range, moved, error) > bound);
            };
            check(Function::Sin, [-700.0, 700.0], SINE_ERROR, 1e-3, &|x, y| (y - (PI * x).sin()).abs());
            check(Function::Cos, [-1.5, 1.5], SINE_ERROR, 1e-6, &|x, y| (y - (PI * x).cos()).abs());
            check(Function::Exp, [-86.0, 87.0], EXP_ERROR, 1e-4, &|x, y| (y / x.exp() - 1.0).abs());
            check(Function::Exp, [-0.1, 0.1], EXP_ERROR, 1e-6, &|x, y| (y / x.exp() - 1.0).abs());
            let of_ln = |x: f64, y: f64| (y - x.ln()).abs() / (1.0 + x.ln().abs());
            check(Function::Ln, [0.5, 2.0], LN_ERROR, 1e-5, &of_ln);
            check(Function::Ln, [1e-3, 3e4], LN_ERROR, 1e-2, &of_ln);
        }
    }

    #[test]
    fn the_ends_of_the_number_line() {
        for isa in Isa::all() {
            let of = |f, x: f32| {
                let mut values = [x; 16];
                dispatch(isa, Map(f, &mut values));
                values[0]
            };
            assert_eq!(of(Function::Exp, 0.0), 1.0);
            assert_eq!(of(Function::Exp, 1e3), f32::INFINITY);
            assert_eq!(of(Function::Exp, f32::INFINITY), f32::INFINITY);
            assert_eq!(of(Function::Exp, -1e3), 0.0);
            assert_eq!(of(Function::Exp, f32::NEG_INFINITY), 0.0);
            assert_eq!(of(Function::Ln, 1.0), 0.0);
            for f in [Function::Sin, Function::Cos, Function::Exp, Function::Ln] {
                assert!(of(f, f32::NAN).is_nan(), "{}", isa.name());
            }
        }
    }
}
