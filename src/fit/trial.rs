//! A short training of one candidate.

use crate::checkpoint::{self, RunFolder};
use crate::config::{Budget, Config};
use crate::dataset::Dataset;
use crate::error::{Error, Result};
use crate::trainer::{Event, Progress, Trainer};
use candle_core::Device;
use neumip_export::Tensor;
use neumip_export::checkpoint::Checkpoint;
use neumip_export::config::Architecture;
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::Path;

/// Memory for the training data.
const MEMORY: usize = 2 << 30;
/// Validations of a trial: each keeps a state to go back to.
const VALIDATIONS: usize = 4;
/// Samples a step: small models on small windows learn from many small steps.
const BATCH: usize = 2048;

/// The training of a candidate for `samples` presented samples, from what a larger model knew, in the folder `out`; one that was
/// begun there goes on, and one that is finished is read.
///
/// # Errors
/// What training meets, a divergence included; `Interrupted` if `flow`, which is told the share that is done, breaks.
pub fn train(
    full: &Config,
    architecture: &Architecture,
    start: &BTreeMap<String, Tensor>,
    data: &Dataset,
    out: &Path,
    (samples, rate): (u64, f64),
    flow: &dyn Fn(f64) -> ControlFlow<()>,
) -> Result<(Checkpoint, Progress)> {
    let mut config = Config { model: architecture.model.clone(), train: full.train.clone() };
    let train = &mut config.train;
    train.piece = train.piece.min(16);
    train.batch = BATCH.max(train.piece * train.piece);
    train.budget = Budget::Steps((samples / train.batch as u64).max(1));
    train.learning_rate.peak = rate;
    train.validations = VALIDATIONS;
    // What is known already is not to be blurred, and no level is to be left out.
    (train.smoothing, train.blend, train.offset_freeze) = (None, None, None);
    train.level_dropout = Vec::new();
    train.texture_every = Some(1);
    let begun = out.is_dir().then(|| RunFolder::open(out).ok()).flatten();
    let device = Device::Cpu;
    let mut trainer = match begun {
        Some((_, record)) if record.config == config => match Trainer::resume(out, data, &device) {
            Ok(trainer) => trainer,
            Err(_) => Trainer::starting_from(start, config, data, (out, true), MEMORY, &device)?,
        },
        _ => Trainer::starting_from(start, config, data, (out, out.exists()), MEMORY, &device)?,
    };
    let mut done = 0.0;
    let mut listener = |event: &Event| {
        if let Event::Step { fraction, .. } = event {
            done = *fraction;
        }
        flow(done)
    };
    trainer.run(&mut listener).map_err(|error| match error {
        Error::Interrupted(_) => {
            Error::Interrupted("what is finished is kept; the same command goes on".to_string())
        }
        other => other,
    })?;
    Ok((checkpoint::load(out)?, trainer.progress().clone()))
}
