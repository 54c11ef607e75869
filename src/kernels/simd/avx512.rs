//! AVX-512: vectors of 16.

use super::x86::{instructions, texels};
use super::{Simd, TEXEL, Work};
use std::arch::x86_64::*;

const N: usize = 16;

/// Proof that the machine has the instructions: only [`enter`] makes one.
#[derive(Clone, Copy)]
pub struct Avx512(());

/// True if the machine has the instructions.
pub fn present() -> bool {
    is_x86_feature_detected!("avx512f")
        && is_x86_feature_detected!("avx512vl")
        && is_x86_feature_detected!("avx512dq")
        && is_x86_feature_detected!("avx512bw")
        && super::avx2::present()
}

/// Runs a kernel.
///
/// # Safety
/// [`present`] has said yes.
pub unsafe fn enter<W: Work>(work: W) -> W::Output {
    #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx512bw,avx2,fma,f16c")]
    fn inside<W: Work>(work: W) -> W::Output {
        work.run(Avx512(()))
    }
    // SAFETY: the caller has asked the machine.
    unsafe { inside(work) }
}

/// Sums of neighbouring 128-bit quarters of `a`, then of `b`.
///
/// # Safety
/// The machine has AVX-512.
#[inline(always)]
unsafe fn fold(a: __m512, b: __m512) -> __m512 {
    // SAFETY: the caller has AVX-512.
    unsafe { _mm512_add_ps(_mm512_shuffle_f32x4::<0x88>(a, b), _mm512_shuffle_f32x4::<0xdd>(a, b)) }
}

/// Lane i of the result is the sum of the lanes of row i: three rounds of halving, interleaving as they go.
///
/// # Safety
/// The machine has AVX-512.
#[inline(always)]
unsafe fn sum_rows(r: [__m512; N]) -> __m512 {
    // SAFETY: the caller has AVX-512; nothing here touches memory.
    unsafe {
        let mut pairs = [r[0]; 8];
        for i in 0..8 {
            let (a, b) = (r[2 * i], r[2 * i + 1]);
            pairs[i] = _mm512_add_ps(_mm512_unpacklo_ps(a, b), _mm512_unpackhi_ps(a, b));
        }
        let mut quads = [r[0]; 4];
        for i in 0..4 {
            let (a, b) = (_mm512_castps_pd(pairs[2 * i]), _mm512_castps_pd(pairs[2 * i + 1]));
            let (low, high) = (_mm512_unpacklo_pd(a, b), _mm512_unpackhi_pd(a, b));
            quads[i] = _mm512_add_ps(_mm512_castpd_ps(low), _mm512_castpd_ps(high));
        }
        fold(fold(quads[0], quads[1]), fold(quads[2], quads[3]))
    }
}

impl Simd for Avx512 {
    const LANES: usize = N;
    const OUTPUTS: usize = 12;
    const SQUARE: usize = 5;
    type F = __m512;
    type I = __m512i;
    type M = __mmask16;
    type T = __m256;

    #[inline(always)]
    fn load(self, from: &[f32]) -> __m512 {
        let from = &from[..N];
        // SAFETY: the token proves the instructions; the slice has the lanes.
        unsafe { _mm512_loadu_ps(from.as_ptr()) }
    }
    #[inline(always)]
    fn store(self, to: &mut [f32], x: __m512) {
        let to = &mut to[..N];
        // SAFETY: the token proves the instructions; the slice has the lanes.
        unsafe { _mm512_storeu_ps(to.as_mut_ptr(), x) }
    }
    #[inline(always)]
    fn int_store(self, to: &mut [u32], a: __m512i) {
        let to = &mut to[..N];
        // SAFETY: the token proves the instructions; the slice has the lanes.
        unsafe { _mm512_storeu_si512(to.as_mut_ptr().cast(), a) }
    }
    #[inline(always)]
    fn both(self, a: __mmask16, b: __mmask16) -> __mmask16 {
        a & b
    }
    #[inline(always)]
    fn either(self, a: __mmask16, b: __mmask16) -> __mmask16 {
        a | b
    }
    #[inline(always)]
    fn mask_bits(self, mask: __mmask16) -> u32 {
        u32::from(mask)
    }
    #[inline(always)]
    fn gather(self, from: &[f32], at: __m512i) -> __m512 {
        let last = super::last_index(from, 1);
        // SAFETY: the token proves the instructions; no index exceeds the last one of the slice, unsigned.
        unsafe {
            _mm512_i32gather_ps::<4>(_mm512_min_epu32(at, _mm512_set1_epi32(last)), from.as_ptr().cast())
        }
    }
    #[inline(always)]
    fn gather_pairs(self, from: &[f32], at: __m512i) -> (__m512, __m512) {
        let last = super::last_index(from, 2);
        // SAFETY: the token proves the instructions; no index exceeds the last one with a value behind it, unsigned.
        unsafe {
            let at = _mm512_min_epu32(at, _mm512_set1_epi32(last));
            let pairs = |at| _mm512_castpd_ps(_mm512_i32gather_pd::<4>(at, from.as_ptr().cast()));
            let (low, high) = (pairs(_mm512_castsi512_si256(at)), pairs(_mm512_extracti64x4_epi64::<1>(at)));
            let even = _mm512_set_epi32(30, 28, 26, 24, 22, 20, 18, 16, 14, 12, 10, 8, 6, 4, 2, 0);
            let odd = _mm512_add_epi32(even, _mm512_set1_epi32(1));
            (_mm512_permutex2var_ps(low, even, high), _mm512_permutex2var_ps(low, odd, high))
        }
    }
    #[inline(always)]
    fn sums<const M: usize>(self, rows: &[__m512; M], out: &mut [f32; M]) {
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
    fn int_up<const B: u32>(self, a: __m512i) -> __m512i {
        // SAFETY: the token proves the instructions.
        unsafe { _mm512_slli_epi32::<B>(a) }
    }
    #[inline(always)]
    fn int_down<const B: u32>(self, a: __m512i) -> __m512i {
        // SAFETY: the token proves the instructions.
        unsafe { _mm512_srli_epi32::<B>(a) }
    }
    instructions! {
        splat(x: f32) -> __m512 = _mm512_set1_ps(x);
        add(a: __m512, b: __m512) -> __m512 = _mm512_add_ps(a, b);
        sub(a: __m512, b: __m512) -> __m512 = _mm512_sub_ps(a, b);
        mul(a: __m512, b: __m512) -> __m512 = _mm512_mul_ps(a, b);
        div(a: __m512, b: __m512) -> __m512 = _mm512_div_ps(a, b);
        max(a: __m512, b: __m512) -> __m512 = _mm512_max_ps(a, b);
        min(a: __m512, b: __m512) -> __m512 = _mm512_min_ps(a, b);
        fma(a: __m512, b: __m512, c: __m512) -> __m512 = _mm512_fmadd_ps(a, b, c);
        sqrt(a: __m512) -> __m512 = _mm512_sqrt_ps(a);
        floor(a: __m512) -> __m512 = _mm512_roundscale_ps::<0x09>(a);
        greater(a: __m512, b: __m512) -> __mmask16 = _mm512_cmp_ps_mask::<_CMP_GT_OQ>(a, b);
        select(mask: __mmask16, a: __m512, b: __m512) -> __m512 = _mm512_mask_blend_ps(mask, b, a);
        int(x: i32) -> __m512i = _mm512_set1_epi32(x);
        truncate(a: __m512) -> __m512i = _mm512_cvttps_epi32(a);
        float(a: __m512i) -> __m512 = _mm512_cvtepi32_ps(a);
        bits(a: __m512) -> __m512i = _mm512_castps_si512(a);
        as_float(a: __m512i) -> __m512 = _mm512_castsi512_ps(a);
        int_add(a: __m512i, b: __m512i) -> __m512i = _mm512_add_epi32(a, b);
        int_sub(a: __m512i, b: __m512i) -> __m512i = _mm512_sub_epi32(a, b);
        int_mul(a: __m512i, b: __m512i) -> __m512i = _mm512_mullo_epi32(a, b);
        int_max(a: __m512i, b: __m512i) -> __m512i = _mm512_max_epi32(a, b);
        int_min(a: __m512i, b: __m512i) -> __m512i = _mm512_min_epi32(a, b);
        int_select(mask: __mmask16, a: __m512i, b: __m512i) -> __m512i = _mm512_mask_blend_epi32(mask, b, a);
        int_and(a: __m512i, b: __m512i) -> __m512i = _mm512_and_si512(a, b);
        int_xor(a: __m512i, b: __m512i) -> __m512i = _mm512_xor_si512(a, b);
    }
    texels!();
}
