//! Probes of footprints.

mod darkening;
mod fractional;
mod popping;
mod range;
mod rounded;
mod unseen;

use super::probe::Probe;

/// The probes of levels.
pub fn probes() -> Vec<Probe> {
    let all =
        [fractional::probes(), popping::probes(), range::probes(), darkening::probes(), unseen::probes()];
    all.into_iter().flatten().collect()
}
