//! CPU loops on slices, for every instruction set the machine has. Nothing here knows candle but [`custom_op`].
//!
//! Arrays of vectors are indexed by number on purpose: iterators over them leave the registers now and then.
#![allow(clippy::needless_range_loop)]

pub mod adam;
pub mod custom_op;
pub mod encoding;
pub mod encoding_rows;
pub mod fetch;
pub mod inception;
pub mod loss;
pub mod math;
pub mod mlp;
pub mod output;
pub mod rows;
pub mod simd;
pub mod smooth;
pub mod taps;
pub mod window;
