//! Probes of losses, optimiser and data.

mod directions;
mod losses;
mod optimiser;
mod roots;
mod sources;
mod whole;

use super::probe::Probe;

/// The probes of training.
pub fn probes() -> Vec<Probe> {
    [roots::probes(), losses::probes(), directions::probes(), optimiser::probes(), whole::probes()]
        .into_iter()
        .flatten()
        .collect()
}
