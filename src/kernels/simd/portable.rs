//! Plain Rust on arrays, which the compiler turns into whatever the target always has (SSE2, NEON).

use super::{Simd, TEXEL, Work};
use half::f16;

const N: usize = 4;

/// No special instructions.
#[derive(Clone, Copy)]
pub struct Portable(());

/// Runs a kernel.
pub fn enter<W: Work>(work: W) -> W::Output {
    work.run(Portable(()))
}

#[inline(always)]
fn map<A: Copy, B: Copy + Default, const M: usize>(a: [A; M], f: impl Fn(A) -> B) -> [B; M] {
    let mut out = [B::default(); M];
    for i in 0..M {
        out[i] = f(a[i]);
    }
    out
}

#[inline(always)]
fn zip<A: Copy, B: Copy + Default, const M: usize>(a: [A; M], b: [A; M], f: impl Fn(A, A) -> B) -> [B; M] {
    let mut out = [B::default(); M];
    for i in 0..M {
        out[i] = f(a[i], b[i]);
    }
    out
}

/// floor without a call into the mathematics library, which baseline x86-64 would need: values of 2^23 and more are whole.
#[inline(always)]
fn floor(x: f32) -> f32 {
    let whole = x as i32 as f32;
    let low = if whole > x { whole - 1.0 } else { whole };
    if x.abs() < 8_388_608.0 { low } else { x }
}

impl Simd for Portable {
    const LANES: usize = N;
    const OUTPUTS: usize = 5;
    const SQUARE: usize = 3;
    type F = [f32; N];
    type I = [i32; N];
    type M = [bool; N];
    type T = [f32; TEXEL];

    #[inline(always)]
    fn splat(self, x: f32) -> Self::F {
        [x; N]
    }
    #[inline(always)]
    fn load(self, from: &[f32]) -> Self::F {
        let mut out = [0.0; N];
        out.copy_from_slice(&from[..N]);
        out
    }
    #[inline(always)]
    fn store(self, to: &mut [f32], x: Self::F) {
        to[..N].copy_from_slice(&x);
    }
    #[inline(always)]
    fn add(self, a: Self::F, b: Self::F) -> Self::F {
        zip(a, b, |a, b| a + b)
    }
    #[inline(always)]
    fn sub(self, a: Self::F, b: Self::F) -> Self::F {
        zip(a, b, |a, b| a - b)
    }
    #[inline(always)]
    fn mul(self, a: Self::F, b: Self::F) -> Self::F {
        zip(a, b, |a, b| a * b)
    }
    #[inline(always)]
    fn div(self, a: Self::F, b: Self::F) -> Self::F {
        zip(a, b, |a, b| a / b)
    }
    #[inline(always)]
    fn fma(self, a: Self::F, b: Self::F, c: Self::F) -> Self::F {
        // f32::mul_add would be a library call where the target has no such instruction.
        self.add(self.mul(a, b), c)
    }
    #[inline(always)]
    fn max(self, a: Self::F, b: Self::F) -> Self::F {
        zip(a, b, |a, b| if a > b { a } else { b })
    }
    #[inline(always)]
    fn min(self, a: Self::F, b: Self::F) -> Self::F {
        zip(a, b, |a, b| if a < b { a } else { b })
    }
    #[inline(always)]
    fn sqrt(self, a: Self::F) -> Self::F {
        map(a, f32::sqrt)
    }
    #[inline(always)]
    fn floor(self, a: Self::F) -> Self::F {
        map(a, floor)
    }
    #[inline(always)]
    fn greater(self, a: Self::F, b: Self::F) -> Self::M {
        zip(a, b, |a, b| a > b)
    }
    #[inline(always)]
    fn select(self, mask: Self::M, a: Self::F, b: Self::F) -> Self::F {
        let mut out = b;
        for i in 0..N {
            out[i] = if mask[i] { a[i] } else { b[i] };
        }
        out
    }
    #[inline(always)]
    fn both(self, a: Self::M, b: Self::M) -> Self::M {
        zip(a, b, |a, b| a & b)
    }
    #[inline(always)]
    fn either(self, a: Self::M, b: Self::M) -> Self::M {
        zip(a, b, |a, b| a | b)
    }
    #[inline(always)]
    fn mask_bits(self, mask: Self::M) -> u32 {
        let mut bits = 0;
        for i in 0..N {
            bits |= u32::from(mask[i]) << i;
        }
        bits
    }
    #[inline(always)]
    fn gather(self, from: &[f32], at: Self::I) -> Self::F {
        let last = super::last_index(from, 1) as u32;
        map(at, |at| from[(at as u32).min(last) as usize])
    }
    #[inline(always)]
    fn gather_pairs(self, from: &[f32], at: Self::I) -> (Self::F, Self::F) {
        let last = super::last_index(from, 2) as u32;
        let pair = |behind: usize| map(at, |at| from[(at as u32).min(last) as usize + behind]);
        (pair(0), pair(1))
    }
    #[inline(always)]
    fn sums<const M: usize>(self, rows: &[Self::F; M], out: &mut [f32; M]) {
        for i in 0..M {
            out[i] = (rows[i][0] + rows[i][2]) + (rows[i][1] + rows[i][3]);
        }
    }
    #[inline(always)]
    fn int(self, x: i32) -> Self::I {
        [x; N]
    }
    #[inline(always)]
    fn truncate(self, a: Self::F) -> Self::I {
        map(a, |a| a as i32)
    }
    #[inline(always)]
    fn float(self, a: Self::I) -> Self::F {
        map(a, |a| a as f32)
    }
    #[inline(always)]
    fn bits(self, a: Self::F) -> Self::I {
        map(a, |a| a.to_bits() as i32)
    }
    #[inline(always)]
    fn as_float(self, a: Self::I) -> Self::F {
        map(a, |a| f32::from_bits(a as u32))
    }
    #[inline(always)]
    fn int_add(self, a: Self::I, b: Self::I) -> Self::I {
        zip(a, b, i32::wrapping_add)
    }
    #[inline(always)]
    fn int_sub(self, a: Self::I, b: Self::I) -> Self::I {
        zip(a, b, i32::wrapping_sub)
    }
    #[inline(always)]
    fn int_mul(self, a: Self::I, b: Self::I) -> Self::I {
        zip(a, b, i32::wrapping_mul)
    }
    #[inline(always)]
    fn int_max(self, a: Self::I, b: Self::I) -> Self::I {
        zip(a, b, i32::max)
    }
    #[inline(always)]
    fn int_min(self, a: Self::I, b: Self::I) -> Self::I {
        zip(a, b, i32::min)
    }
    #[inline(always)]
    fn int_select(self, mask: Self::M, a: Self::I, b: Self::I) -> Self::I {
        let mut out = b;
        for i in 0..N {
            out[i] = if mask[i] { a[i] } else { b[i] };
        }
        out
    }
    #[inline(always)]
    fn int_and(self, a: Self::I, b: Self::I) -> Self::I {
        zip(a, b, |a, b| a & b)
    }
    #[inline(always)]
    fn int_xor(self, a: Self::I, b: Self::I) -> Self::I {
        zip(a, b, |a, b| a ^ b)
    }
    #[inline(always)]
    fn int_up<const B: u32>(self, a: Self::I) -> Self::I {
        map(a, |a| a << B)
    }
    #[inline(always)]
    fn int_down<const B: u32>(self, a: Self::I) -> Self::I {
        map(a, |a| (a as u32 >> B) as i32)
    }
    #[inline(always)]
    fn int_store(self, to: &mut [u32], a: Self::I) {
        for i in 0..N {
            to[i] = a[i] as u32;
        }
    }
    #[inline(always)]
    fn prefetch<X>(self, _: &[X], _: usize) {}
    #[inline(always)]
    fn texel_splat(self, x: f32) -> Self::T {
        [x; TEXEL]
    }
    #[inline(always)]
    fn texel_load(self, from: &[f32; TEXEL]) -> Self::T {
        *from
    }
    #[inline(always)]
    fn texel_load_half(self, from: &[f16; TEXEL]) -> Self::T {
        map(*from, f16::to_f32)
    }
    #[inline(always)]
    fn texel_store(self, to: &mut [f32; TEXEL], a: Self::T) {
        *to = a;
    }
    #[inline(always)]
    fn texel_add(self, a: Self::T, b: Self::T) -> Self::T {
        zip(a, b, |a, b| a + b)
    }
    #[inline(always)]
    fn texel_sub(self, a: Self::T, b: Self::T) -> Self::T {
        zip(a, b, |a, b| a - b)
    }
    #[inline(always)]
    fn texel_mul(self, a: Self::T, b: Self::T) -> Self::T {
        zip(a, b, |a, b| a * b)
    }
    #[inline(always)]
    fn texel_fma(self, a: Self::T, b: Self::T, c: Self::T) -> Self::T {
        self.texel_add(self.texel_mul(a, b), c)
    }
    #[inline(always)]
    fn transpose(self, rows: [Self::T; TEXEL]) -> [Self::T; TEXEL] {
        let mut out = [[0.0; TEXEL]; TEXEL];
        for i in 0..TEXEL {
            for j in 0..TEXEL {
                out[j][i] = rows[i][j];
            }
        }
        out
    }
}
