//! The machine's peak, measured: independent multiply-adds in registers, as many as the set can start.

use crate::kernels::simd::{Isa, Simd, Work, dispatch};
use std::hint::black_box;

/// Independent sums: more than latency times units of any core on sale, and few enough for 16 registers.
const SUMS: usize = 12;
/// Steps of a pass: some tens of microseconds, beside which entering the kernel costs nothing.
const STEPS: usize = 1 << 14;

/// `passes` times [`STEPS`] multiply-adds of every sum.
struct Loop {
    passes: usize,
    factor: f32,
    term: f32,
}

impl Work for Loop {
    type Output = f32;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> f32 {
        // Sums that differ: equal ones could be computed once.
        let mut sums = [simd.splat(0.0); SUMS];
        for (k, sum) in sums.iter_mut().enumerate() {
            *sum = simd.splat(k as f32);
        }
        let (factor, term) = (simd.splat(self.factor), simd.splat(self.term));
        for _ in 0..self.passes * STEPS {
            for sum in &mut sums {
                *sum = simd.fma(*sum, factor, term);
            }
        }
        let mut lanes = [0.0; 16];
        let mut total = 0.0;
        for sum in sums {
            simd.store(&mut lanes, sum);
            total += lanes[0];
        }
        total
    }
}

struct Lanes;

impl Work for Lanes {
    type Output = usize;

    #[inline(always)]
    fn run<S: Simd>(self, _: S) -> usize {
        S::LANES
    }
}

/// Floating-point operations of one pass on one thread.
pub(super) fn operations(isa: Isa) -> f64 {
    (2 * SUMS * STEPS * dispatch(isa, Lanes)) as f64
}

/// Does `passes` on this thread.
pub(super) fn run(isa: Isa, passes: usize) {
    // The sums settle at 1: neither infinities nor denormals slow them down.
    let work = Loop { passes, factor: black_box(0.5), term: black_box(0.5) };
    black_box(dispatch(isa, work));
}
