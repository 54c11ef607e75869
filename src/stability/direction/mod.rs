//! Probes of light and view directions.

mod asking;
mod energy;
mod grazing;
mod horizon;
mod mirror;
mod opposite;
mod same;

use super::probe::Probe;

/// The probes of directions.
pub fn probes() -> Vec<Probe> {
    let groups = [
        grazing::probes(),
        same::probes(),
        mirror::probes(),
        opposite::probes(),
        horizon::probes(),
        energy::probes(),
    ];
    groups.into_iter().flatten().collect()
}
