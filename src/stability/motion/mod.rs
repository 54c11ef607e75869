//! Probes of sequences of pictures.

mod flicker;
mod sequence;

use super::probe::Probe;

/// The probes of motion.
pub fn probes() -> Vec<Probe> {
    flicker::probes()
}
