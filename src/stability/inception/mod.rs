//! Probes of the Inception decoder, whose answers depend on the queries around them.

mod borders;
mod layout;
mod padded;

use super::probe::Probe;
use super::workshop::Workshop;
use crate::config::Budget;
use crate::dataset::Regime;
use crate::error::Result;
use crate::stability::workshop::Model;

/// Pairs of directions of the training slices.
const PAIRS: usize = 24;
/// Samples of a training step: whole slices, as the decoder needs them.
const SLICES: usize = 1;
/// Steps: seconds, and enough for neighbours to matter.
const STEPS: u64 = 150;

/// The probes of the Inception decoder.
pub fn probes() -> Vec<Probe> {
    [layout::probes(), borders::probes()].into_iter().flatten().collect()
}

/// A small Inception model of the glossy material.
fn trained(workshop: &mut Workshop) -> Result<Model> {
    let material = workshop.scale().glossy().to_string();
    let mut generation = workshop.generation();
    generation.regime = Regime::Slices(PAIRS);
    generation.test_pairs = 2;
    generation.offgrid_samples = 0;
    generation.grazing_samples = 0;
    let reference = workshop.reference(&material)?;
    let data = workshop.data_of(&format!("{material}.slices"), &*reference, &generation)?;
    let side = workshop.scale().resolution;
    let mut config = workshop.config("inception-small", &[])?;
    config.train.piece = side;
    config.train.batch = SLICES * side * side;
    config.train.budget = Budget::Steps(STEPS);
    config.train.validations = 1;
    let trained = workshop.train_on(&format!("{material}.inception-small"), config, &data)?;
    Ok(trained.sound()?.clone())
}
