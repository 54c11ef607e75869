//! Instruction sets, chosen at run time: one small trait, one generic body for every kernel.
//!
//! A kernel is a [`Work`]: its `run` is written once for any [`Simd`] and compiled for each instruction set. [`dispatch`]
//! enters it with the token of a set that the machine has been asked about, so methods that use a set's instructions
//! cannot be reached on a machine without them.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod denormal;
mod portable;
#[cfg(test)]
mod tests;
#[cfg(target_arch = "x86_64")]
mod x86;

pub use denormal::flushing;

use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::sync::OnceLock;

/// Channels that a texel vector holds; textures are read in groups of so many.
pub const TEXEL: usize = 8;

/// Forces an instruction set: `avx512`, `avx2` or `portable`.
pub const VARIABLE: &str = "NEUMIP_ISA";

/// Vectors of f32 and what kernels do with them. A value of the type proves that the machine has the instructions.
pub trait Simd: Copy + Send + Sync {
    /// Lanes of a vector; a multiple of 4 that divides 16.
    const LANES: usize;
    /// Outputs that a block of a layer accumulates in registers, two vectors each.
    const OUTPUTS: usize;
    /// Side of the square block in which weight gradients are accumulated in registers.
    const SQUARE: usize;
    /// [`Self::LANES`] floats.
    type F: Copy;
    /// [`Self::LANES`] 32-bit integers.
    type I: Copy;
    /// A truth value a lane.
    type M: Copy;
    /// [`TEXEL`] floats.
    type T: Copy;

    /// All lanes `x`.
    fn splat(self, x: f32) -> Self::F;
    /// The first lanes of a slice, which must have as many.
    fn load(self, from: &[f32]) -> Self::F;
    /// Writes the first lanes of a slice, which must have as many.
    fn store(self, to: &mut [f32], x: Self::F);
    /// a + b.
    fn add(self, a: Self::F, b: Self::F) -> Self::F;
    /// a - b.
    fn sub(self, a: Self::F, b: Self::F) -> Self::F;
    /// a b.
    fn mul(self, a: Self::F, b: Self::F) -> Self::F;
    /// a / b.
    fn div(self, a: Self::F, b: Self::F) -> Self::F;
    /// a b + c, rounded once where the set has such an instruction.
    fn fma(self, a: Self::F, b: Self::F, c: Self::F) -> Self::F;
    /// The larger; `b` where either is no number.
    fn max(self, a: Self::F, b: Self::F) -> Self::F;
    /// The smaller; `b` where either is no number.
    fn min(self, a: Self::F, b: Self::F) -> Self::F;
    /// Square root.
    fn sqrt(self, a: Self::F) -> Self::F;
    /// Largest integer not above.
    fn floor(self, a: Self::F) -> Self::F;
    /// a > b, false where either is no number.
    fn greater(self, a: Self::F, b: Self::F) -> Self::M;
    /// `a` where true, else `b`.
    fn select(self, mask: Self::M, a: Self::F, b: Self::F) -> Self::F;
    /// True where both are.
    fn both(self, a: Self::M, b: Self::M) -> Self::M;
    /// True where one is, or both.
    fn either(self, a: Self::M, b: Self::M) -> Self::M;
    /// Bit k is lane k.
    fn mask_bits(self, mask: Self::M) -> u32;
    /// The values at the indices of a slice that is not empty; indices beyond its end, and below 0, read its last value.
    fn gather(self, from: &[f32], at: Self::I) -> Self::F;
    /// The values at the indices of a slice of at least two, and those behind them; indices beyond the last pair, and
    /// below 0, read the last pair.
    fn gather_pairs(self, from: &[f32], at: Self::I) -> (Self::F, Self::F);
    /// Sums of the lanes of each vector.
    fn sums<const N: usize>(self, rows: &[Self::F; N], out: &mut [f32; N]);

    /// All lanes `x`.
    fn int(self, x: i32) -> Self::I;
    /// The integer part; lanes beyond an i32 give any value.
    fn truncate(self, a: Self::F) -> Self::I;
    /// The integers as floats.
    fn float(self, a: Self::I) -> Self::F;
    /// The bits of floats.
    fn bits(self, a: Self::F) -> Self::I;
    /// The floats of bits.
    fn as_float(self, a: Self::I) -> Self::F;
    /// a + b, wrapping.
    fn int_add(self, a: Self::I, b: Self::I) -> Self::I;
    /// a - b, wrapping.
    fn int_sub(self, a: Self::I, b: Self::I) -> Self::I;
    /// a b, wrapping.
    fn int_mul(self, a: Self::I, b: Self::I) -> Self::I;
    /// The larger.
    fn int_max(self, a: Self::I, b: Self::I) -> Self::I;
    /// The smaller.
    fn int_min(self, a: Self::I, b: Self::I) -> Self::I;
    /// `a` where true, else `b`.
    fn int_select(self, mask: Self::M, a: Self::I, b: Self::I) -> Self::I;
    /// a and b.
    fn int_and(self, a: Self::I, b: Self::I) -> Self::I;
    /// a exclusive-or b.
    fn int_xor(self, a: Self::I, b: Self::I) -> Self::I;
    /// a shifted up by N bits.
    fn int_up<const N: u32>(self, a: Self::I) -> Self::I;
    /// a shifted down by N bits, zeros from above.
    fn int_down<const N: u32>(self, a: Self::I) -> Self::I;
    /// Writes the first lanes of a slice, which must have as many.
    fn int_store(self, to: &mut [u32], a: Self::I);

    /// Asks for the cache line that holds a value, if there is such a value; a hint and nothing else.
    fn prefetch<X>(self, all: &[X], at: usize);

    /// All channels `x`.
    fn texel_splat(self, x: f32) -> Self::T;
    /// Eight channels.
    fn texel_load(self, from: &[f32; TEXEL]) -> Self::T;
    /// Eight channels in half precision.
    fn texel_load_half(self, from: &[half::f16; TEXEL]) -> Self::T;
    /// Writes eight channels.
    fn texel_store(self, to: &mut [f32; TEXEL], a: Self::T);
    /// a + b.
    fn texel_add(self, a: Self::T, b: Self::T) -> Self::T;
    /// a - b.
    fn texel_sub(self, a: Self::T, b: Self::T) -> Self::T;
    /// a b.
    fn texel_mul(self, a: Self::T, b: Self::T) -> Self::T;
    /// a b + c.
    fn texel_fma(self, a: Self::T, b: Self::T, c: Self::T) -> Self::T;
    /// Eight samples' channels as eight channels' samples.
    fn transpose(self, rows: [Self::T; TEXEL]) -> [Self::T; TEXEL];
}

/// A kernel call: its arguments, and its body for any instruction set.
pub trait Work {
    /// What it returns.
    type Output;
    /// The body; mark it `#[inline(always)]`, as everything that it calls, or it is compiled for the plain machine.
    fn run<S: Simd>(self, simd: S) -> Self::Output;
}

/// An instruction set that this machine has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(transparent)]
pub struct Isa(Kind);

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Kind {
    Avx512,
    Avx2,
    Portable,
}

impl Kind {
    fn name(self) -> &'static str {
        match self {
            Self::Avx512 => "avx512",
            Self::Avx2 => "avx2",
            Self::Portable => "portable",
        }
    }

    #[cfg(target_arch = "x86_64")]
    fn present(self) -> bool {
        match self {
            Self::Avx512 => avx512::present(),
            Self::Avx2 => avx2::present(),
            Self::Portable => true,
        }
    }

    #[cfg(not(target_arch = "x86_64"))]
    fn present(self) -> bool {
        self == Self::Portable
    }
}

const KINDS: [Kind; 3] = [Kind::Avx512, Kind::Avx2, Kind::Portable];

impl Isa {
    /// All sets of this machine, the widest first.
    pub fn all() -> Vec<Self> {
        KINDS.into_iter().filter(|k| k.present()).map(Self).collect()
    }

    /// The set in use: the widest, unless [`VARIABLE`] names another.
    ///
    /// # Errors
    /// `Usage` if the variable names none, or one that this machine has not.
    pub fn chosen() -> Result<Self> {
        static CHOSEN: OnceLock<std::result::Result<Isa, String>> = OnceLock::new();
        let choose = || match std::env::var(VARIABLE) {
            Err(_) => Ok(Self::all()[0]),
            Ok(name) => Self::named(&name),
        };
        CHOSEN.get_or_init(choose).clone().map_err(Error::usage)
    }

    fn named(name: &str) -> std::result::Result<Self, String> {
        match KINDS.into_iter().find(|k| k.name() == name) {
            Some(kind) if kind.present() => Ok(Self(kind)),
            Some(_) => Err(format!("{VARIABLE}={name}: this machine has no {name}")),
            None => Err(format!("{VARIABLE}={name}: use avx512, avx2 or portable")),
        }
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        self.0.name()
    }
}

/// Runs a kernel with an instruction set.
pub fn dispatch<W: Work>(isa: Isa, work: W) -> W::Output {
    match isa.0 {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: an Isa is made of nothing but a set that is present.
        Kind::Avx512 => unsafe { avx512::enter(work) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above.
        Kind::Avx2 => unsafe { avx2::enter(work) },
        _ => portable::enter(work),
    }
}

/// Last index of a slice at which there are `together` values and that 32 bits reach.
fn last_index(from: &[f32], together: usize) -> i32 {
    assert!(from.len() >= together, "{} values are too few to gather {together} at once", from.len());
    (from.len() - together).min(i32::MAX as usize) as i32
}
