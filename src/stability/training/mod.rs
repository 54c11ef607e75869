//! Probes of losses, optimiser and data.

mod roots;

use super::probe::Probe;

/// The probes of training.
pub fn probes() -> Vec<Probe> {
    [roots::probes()].into_iter().flatten().collect()
}
