//! Texel vectors of 256 bits, which AVX-512 and AVX2 share.

use super::TEXEL;
use std::arch::x86_64::*;

/// 8 x 8 transposition.
///
/// # Safety
/// The machine has AVX.
#[inline(always)]
pub unsafe fn transpose(r: [__m256; TEXEL]) -> [__m256; TEXEL] {
    // SAFETY: the caller has AVX; nothing here touches memory.
    unsafe {
        let mut t = r;
        for i in 0..4 {
            t[2 * i] = _mm256_unpacklo_ps(r[2 * i], r[2 * i + 1]);
            t[2 * i + 1] = _mm256_unpackhi_ps(r[2 * i], r[2 * i + 1]);
        }
        let mut u = t;
        for i in 0..2 {
            let (a, b, c, d) = (t[4 * i], t[4 * i + 1], t[4 * i + 2], t[4 * i + 3]);
            u[4 * i] = _mm256_shuffle_ps::<0x44>(a, c);
            u[4 * i + 1] = _mm256_shuffle_ps::<0xee>(a, c);
            u[4 * i + 2] = _mm256_shuffle_ps::<0x44>(b, d);
            u[4 * i + 3] = _mm256_shuffle_ps::<0xee>(b, d);
        }
        let mut out = u;
        for i in 0..4 {
            out[i] = _mm256_permute2f128_ps::<0x20>(u[i], u[i + 4]);
            out[i + 4] = _mm256_permute2f128_ps::<0x31>(u[i], u[i + 4]);
        }
        out
    }
}

/// Methods of `Simd` that are one instruction, or a few without memory, on a token that proves them.
macro_rules! instructions {
    ($($name:ident($($argument:ident: $type:ty),*) -> $result:ty = $value:expr;)*) => {
        $(
            #[inline(always)]
            fn $name(self, $($argument: $type),*) -> $result {
                // SAFETY: the token proves the instructions.
                unsafe { $value }
            }
        )*
    };
}

/// The methods of `Simd` on texels, for a token whose machine has AVX2, FMA and F16C.
macro_rules! texels {
    () => {
        super::x86::instructions! {
            texel_splat(x: f32) -> __m256 = _mm256_set1_ps(x);
            texel_add(a: __m256, b: __m256) -> __m256 = _mm256_add_ps(a, b);
            texel_sub(a: __m256, b: __m256) -> __m256 = _mm256_sub_ps(a, b);
            texel_mul(a: __m256, b: __m256) -> __m256 = _mm256_mul_ps(a, b);
            texel_fma(a: __m256, b: __m256, c: __m256) -> __m256 = _mm256_fmadd_ps(a, b, c);
        }
        #[inline(always)]
        fn prefetch<X>(self, all: &[X], at: usize) {
            if let Some(value) = all.get(at) {
                // SAFETY: every x86-64 has the instruction; the address is of a value of the slice.
                unsafe { _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(value).cast()) }
            }
        }
        #[inline(always)]
        fn texel_load(self, from: &[f32; TEXEL]) -> __m256 {
            // SAFETY: the token proves the instructions; the array has the 32 bytes.
            unsafe { _mm256_loadu_ps(from.as_ptr()) }
        }
        #[inline(always)]
        fn texel_load_half(self, from: &[half::f16; TEXEL]) -> __m256 {
            // SAFETY: the token proves the instructions; the array has the 16 bytes.
            unsafe { _mm256_cvtph_ps(_mm_loadu_si128(from.as_ptr().cast())) }
        }
        #[inline(always)]
        fn texel_store(self, to: &mut [f32; TEXEL], a: __m256) {
            // SAFETY: the token proves the instructions; the array has the 32 bytes.
            unsafe { _mm256_storeu_ps(to.as_mut_ptr(), a) }
        }
        #[inline(always)]
        fn transpose(self, rows: [__m256; TEXEL]) -> [__m256; TEXEL] {
            // SAFETY: the token proves the instructions.
            unsafe { super::x86::transpose(rows) }
        }
    };
}

pub(super) use {instructions, texels};
