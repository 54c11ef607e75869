//! AVX2 with FMA and F16C: vectors of 8.

use super::x86::{instructions, texels};
use super::{Simd, TEXEL, Work};
use std::arch::x86_64::*;

const N: usize = 8;

/// Proof that the machine has the instructions: only [`enter`] makes one.
#[derive(Clone, Copy)]
pub struct Avx2(());

/// True if the machine has the instructions.
pub fn present() -> bool {
    is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") && is_x86_feature_detected!("f16c")
}

/// Runs a kernel.
///
/// # Safety
/// [`present`] has said yes.
pub unsafe fn enter<W: Work>(work: W) -> W::Output {
    #[target_feature(enable = "avx2,fma,f16c")]
    fn inside<W: Work>(work: W) -> W::Output {
        work.run(Avx2(()))
    }
    // SAFETY: the caller has asked the machine.
    unsafe { inside(work) }
}

/// Lane i of the result is the sum of the lanes of row i: three rounds of halving, interleaving as they go.
///
/// # Safety
/// The machine has AVX2.
#[inline(always)]
unsafe fn sum_rows(r: [__m256; N]) -> __m256 {
    // SAFETY: the caller has AVX2; nothing here touches memory.
    unsafe {
        let mut pairs = [r[0]; 4];
        for i in 0..4 {
            let (a, b) = (r[2 * i], r[2 * i + 1]);
            pairs[i] = _mm256_add_ps(_mm256_unpacklo_ps(a, b), _mm256_unpackhi_ps(a, b));
        }
        let mut quads = [r[0]; 2];
        for i in 0..2 {
            let (a, b) = (_mm256_castps_pd(pairs[2 * i]), _mm256_castps_pd(pairs[2 * i + 1]));
            let (low, high) = (_mm256_unpacklo_pd(a, b), _mm256_unpackhi_pd(a, b));
            quads[i] = _mm256_add_ps(_mm256_castpd_ps(low), _mm256_castpd_ps(high));
        }
        let (a, b) = (quads[0], quads[1]);
        _mm256_add_ps(_mm256_permute2f128_ps::<0x20>(a, b), _mm256_permute2f128_ps::<0x31>(a, b))
    }
}

impl Simd for Avx2 {
    const LANES: usize = N;
    const OUTPUTS: usize = 6;
    const SQUARE: usize = 3;
    type F = __m256;
    type I = __m256i;
    type M = __m256;
    type T = __m256;

    #[inline(always)]
    fn load(self, from: &[f32]) -> __m256 {
        let from = &from[..N];
        // SAFETY: the token proves the instructions; the slice has the lanes.
        unsafe { _mm256_loadu_ps(from.as_ptr()) }
    }
    #[inline(always)]
    fn store(self, to: &mut [f32], x: __m256) {
        let to = &mut to[..N];
        // SAFETY: the token proves the instructions; the slice has the lanes.
        unsafe { _mm256_storeu_ps(to.as_mut_ptr(), x) }
    }
    #[inline(always)]
    fn int_store(self, to: &mut [u32], a: __m256i) {
        let to = &mut to[..N];
        // SAFETY: the token proves the instructions; the slice has the lanes.
        unsafe { _mm256_storeu_si256(to.as_mut_ptr().cast(), a) }
    }
    #[inline(always)]
    fn gather(self, from: &[f32], at: __m256i) -> __m256 {
        let last = super::last_index(from, 1);
        // SAFETY: the token proves the instructions; no index exceeds the last one of the slice, unsigned.
        unsafe { _mm256_i32gather_ps::<4>(from.as_ptr(), _mm256_min_epu32(at, _mm256_set1_epi32(last))) }
    }
    #[inline(always)]
    fn gather_pairs(self, from: &[f32], at: __m256i) -> (__m256, __m256) {
        let last = super::last_index(from, 2);
        // SAFETY: the token proves the instructions; no index exceeds the last one with a value behind it, unsigned.
        unsafe {
            let at = _mm256_min_epu32(at, _mm256_set1_epi32(last));
            let pairs = |at| _mm256_castpd_ps(_mm256_i32gather_pd::<4>(from.as_ptr().cast(), at));
            let (low, high) = (pairs(_mm256_castsi256_si128(at)), pairs(_mm256_extracti128_si256::<1>(at)));
            let order = |x| _mm256_castpd_ps(_mm256_permute4x64_pd::<0xd8>(_mm256_castps_pd(x)));
            (order(_mm256_shuffle_ps::<0x88>(low, high)), order(_mm256_shuffle_ps::<0xdd>(low, high)))
        }
    }
    #[inline(always)]
    fn sums<const M: usize>(self, rows: &[__m256; M], out: &mut [f32; M]) {
        for start in (0..M).step_by(N) {
            let mut group = [self.splat(0.0); N];
            for i in 0..N {
                if start + i < M {
                    group[i] = rows[start + i];
                }
            }
            let mut sums = [0.0; N];
            // SAFETY: the token proves the instructions.
            self.store(&mut sums, unsafe { sum_rows(group) });
            let n = N.min(M - start);
            out[start..start + n].copy_from_slice(&sums[..n]);
        }
    }
    #[inline(always)]
    fn int_up<const B: u32>(self, a: __m256i) -> __m256i {
        // SAFETY: the token proves the instructions.
        unsafe { _mm256_sll_epi32(a, _mm_cvtsi32_si128(B as i32)) }
    }
    #[inline(always)]
    fn int_down<const B: u32>(self, a: __m256i) -> __m256i {
        // SAFETY: the token proves the instructions.
        unsafe { _mm256_srl_epi32(a, _mm_cvtsi32_si128(B as i32)) }
    }
    instructions! {
        splat(x: f32) -> __m256 = _mm256_set1_ps(x);
        add(a: __m256, b: __m256) -> __m256 = _mm256_add_ps(a, b);
        sub(a: __m256, b: __m256) -> __m256 = _mm256_sub_ps(a, b);
        mul(a: __m256, b: __m256) -> __m256 = _mm256_mul_ps(a, b);
        div(a: __m256, b: __m256) -> __m256 = _mm256_div_ps(a, b);
        max(a: __m256, b: __m256) -> __m256 = _mm256_max_ps(a, b);
        min(a: __m256, b: __m256) -> __m256 = _mm256_min_ps(a, b);
        fma(a: __m256, b: __m256, c: __m256) -> __m256 = _mm256_fmadd_ps(a, b, c);
        sqrt(a: __m256) -> __m256 = _mm256_sqrt_ps(a);
        floor(a: __m256) -> __m256 = _mm256_floor_ps(a);
        greater(a: __m256, b: __m256) -> __m256 = _mm256_cmp_ps::<_CMP_GT_OQ>(a, b);
        select(mask: __m256, a: __m256, b: __m256) -> __m256 = _mm256_blendv_ps(b, a, mask);
        both(a: __m256, b: __m256) -> __m256 = _mm256_and_ps(a, b);
        either(a: __m256, b: __m256) -> __m256 = _mm256_or_ps(a, b);
        mask_bits(mask: __m256) -> u32 = _mm256_movemask_ps(mask) as u32;
        int(x: i32) -> __m256i = _mm256_set1_epi32(x);
        truncate(a: __m256) -> __m256i = _mm256_cvttps_epi32(a);
        float(a: __m256i) -> __m256 = _mm256_cvtepi32_ps(a);
        bits(a: __m256) -> __m256i = _mm256_castps_si256(a);
        as_float(a: __m256i) -> __m256 = _mm256_castsi256_ps(a);
        int_add(a: __m256i, b: __m256i) -> __m256i = _mm256_add_epi32(a, b);
        int_sub(a: __m256i, b: __m256i) -> __m256i = _mm256_sub_epi32(a, b);
        int_mul(a: __m256i, b: __m256i) -> __m256i = _mm256_mullo_epi32(a, b);
        int_max(a: __m256i, b: __m256i) -> __m256i = _mm256_max_epi32(a, b);
        int_min(a: __m256i, b: __m256i) -> __m256i = _mm256_min_epi32(a, b);
        int_select(mask: __m256, a: __m256i, b: __m256i) -> __m256i = _mm256_blendv_epi8(b, a, _mm256_castps_si256(mask));
        int_and(a: __m256i, b: __m256i) -> __m256i = _mm256_and_si256(a, b);
        int_xor(a: __m256i, b: __m256i) -> __m256i = _mm256_xor_si256(a, b);
    }
    texels!();
}
