//! Probes of precision, instruction sets and engines.

mod adversarial;
mod engines;
mod flush;
mod halves;
mod published;
mod queries;
mod sets;
mod short;

use super::probe::Probe;

/// Largest |difference| / (1 + |value|) between two ways to the same answer: that of golden answers in bundles, f32
/// networks summed in another order on positions that an offset network moves by an ulp.
const SAME: f64 = 2e-5;

/// The probes of numbers.
pub fn probes() -> Vec<Probe> {
    let parts = [
        adversarial::probes(),
        halves::probes(),
        flush::probes(),
        sets::probes(),
        engines::probes(),
        short::probes(),
    ];
    parts.into_iter().flatten().collect()
}
