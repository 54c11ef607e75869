//! CPU loops on slices. Nothing here knows candle but [`custom_op`].

pub mod adam;
pub mod custom_op;
pub mod encoding;
pub mod smooth;
pub mod taps;
