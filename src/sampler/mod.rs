//! Importance sampling of a trained material: where the light matters to a query, as a mixture of lobes that a tiny network
//! chooses. [`neumip_export::sampler`] is the exact definition and the file.
//!
//! ```text
//! Lobes ─ samples and densities      Network ─ from features and wo to lobes
//!   │                                  │
//! MaterialSampler ─ lobes of queries  fit ─ from the material's own answers, by the slopes of `gradient`
//!   │                                  │
//! gain ─ variance beside cosine sampling, under the lights of `light`; cost ─ time beside the material's
//! golden ─ samples that other programs have to reproduce
//! ```

mod condition;
mod cost;
mod fit;
mod gain;
pub mod golden;
mod gradient;
mod horizon;
pub mod light;
mod lobe;
mod material;
mod network;
mod objective;
#[cfg(test)]
mod tests;

pub use cost::{Cost, cost};
pub use fit::{Listener, Options, fit};
pub use gain::{CONDITIONS, Gain, gain, gains};
pub use light::Light;
pub use lobe::Lobes;
pub use material::MaterialSampler;

/// What every choice of fitting and measuring is drawn from: parts of one stream.
#[derive(Clone, Copy, Debug)]
enum Part {
    /// Conditions that are fitted.
    Fitted,
    /// Their directions.
    Directions,
    /// Initial weights.
    Weights,
    /// Conditions that are measured.
    HeldOut,
    /// Their directions, and how the light is turned.
    Measured,
    /// Numbers of golden samples.
    Golden,
}

/// An answer as the one number whose variance counts: the mean of its colours.
fn value(rgb: [f32; 3]) -> f32 {
    (rgb[0] + rgb[1] + rgb[2]) / 3.0
}
