//! One training of a study, begun or gone on with.

use super::super::console::Console;
use super::super::train::train;
use crate::checkpoint::RunFolder;
use crate::config::{Budget, Config};
use crate::dataset::Dataset;
use crate::error::{Error, Result};
use crate::reproduce::{Folder, Study};
use crate::trainer::{Progress, Trainer};
use candle_core::Device;

/// Memory for the training data.
const MEMORY: usize = 2 << 30;
/// Validations of a training: each costs about one thousandth of it.
const VALIDATIONS: usize = 10;

/// The configuration of a training of the study.
pub fn configured(mut config: Config, study: &Study, seed: u64, share: f64) -> Config {
    let train = &mut config.train;
    // A decoder that sees its neighbours takes whole slices.
    let piece = train.piece.min(study.resolution);
    train.piece = piece;
    train.batch = study.batch.max(piece * piece);
    let samples = (study.samples() as f64 * share) as u64;
    train.budget = Budget::Steps((samples / train.batch as u64).max(1));
    train.seed = seed;
    train.validations = VALIDATIONS;
    config
}

/// Trains to the end, from where an earlier call stopped.
pub fn trained(
    folder: &Folder,
    name: &str,
    config: Config,
    data: &Dataset,
    console: &Console,
) -> Result<Progress> {
    let path = folder.run(name);
    let begun = path.is_dir().then(|| RunFolder::open(&path).ok()).flatten();
    let device = Device::Cpu;
    let mut trainer = match begun {
        Some((_, record)) if record.config == config => Trainer::resume(&path, data, &device)?,
        _ => {
            if let Some(parent) = path.parent() {
                std::fs::create_dir_all(parent)
                    .map_err(|e| Error::file(parent, format!("cannot be made: {e}")))?;
            }
            Trainer::new(config, data, &path, path.exists(), MEMORY, &device)?
        }
    };
    if trainer.progress().fraction < 1.0 {
        train(&mut trainer, name, console)?;
    }
    Ok(trainer.progress().clone())
}
