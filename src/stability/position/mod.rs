//! Probes of u.

mod between;
mod border;
mod far;
mod formula;
mod odd;

use super::probe::Probe;

/// The probes of positions.
pub fn probes() -> Vec<Probe> {
    [between::probes(), border::probes(), far::probes(), odd::probes()].into_iter().flatten().collect()
}
