//! Runs that are stopped, and data with a value that is none.

use crate::config::{Budget, Config};
use crate::dataset::{Dataset, Existing, SplitName, Stream, generate};
use crate::error::{Error, Result};
use crate::kernels::loss::{self, Kind, Remap, Scratch, Term};
use crate::kernels::simd::Isa;
use crate::model::Variables;
use crate::model::texture::Sigmas;
use crate::stability::probe::{Bound, Group, Outcome, Probe};
use crate::stability::training::sources::Spoilt;
use crate::stability::workshop::Workshop;
use crate::trainer::{Event, Learner, Step, Trainer};
use candle_core::Device;
use neumip_export::config::Architecture;
use std::ops::ControlFlow;

/// Steps of the run that is stopped half way.
const STEPS: u64 = 64;
/// Memory for its data.
const MEMORY: usize = 1 << 28;
/// Side of the piece that holds a value which is none.
const SIDE: usize = 16;

pub(super) fn probes() -> Vec<Probe> {
    vec![
        Probe {
            name: "interrupted-run",
            group: Group::Training,
            provokes: "A run that goes on from its weights alone has lost Adam's moments, its place in the data and its schedule.",
            naive: "weights kept, moments begun anew",
            cured: "`neumip train --resume`",
            figure: "largest difference of a weight from those of the run that was not interrupted",
            bound: Bound::new(0.0, "the same seed and inputs are the same bytes"),
            run: interrupted,
        },
        Probe {
            name: "poisoned-texel",
            group: Group::Training,
            provokes: "One value of the data is no number, as happens in measured data and in maps.",
            naive: "it reaches the loss",
            cured: "generation refuses it and names u, wi, wo and the level; files with one are refused by name",
            figure: "share of the piece's gradients that are no number, or 1 if data with one are accepted",
            bound: Bound::new(0.0, "one of them destroys every weight"),
            run: poisoned,
        },
    ]
}

fn short(workshop: &Workshop) -> Result<Config> {
    let mut config = workshop.config("improved", &[])?;
    config.train.budget = Budget::Steps(STEPS);
    config.train.validations = 4;
    Ok(config)
}

fn interrupted(workshop: &mut Workshop) -> Result<Outcome> {
    let material = workshop.scale().glossy().to_string();
    let data = workshop.data(&material)?;
    let config = short(workshop)?;
    let whole = workshop.folder().run("interrupted-whole");
    let parts = workshop.folder().run("interrupted-parts");
    let mut trainer = Trainer::new(config.clone(), &data, &whole, true, MEMORY, &Device::Cpu)?;
    trainer.run(&mut |_| ControlFlow::Continue(()))?;
    let expected = trainer.checkpoint()?.tensors;
    let mut trainer = Trainer::new(config.clone(), &data, &parts, true, MEMORY, &Device::Cpu)?;
    let stopped = trainer.run(&mut |event| match event {
        Event::Step { step, .. } if *step >= STEPS / 2 => ControlFlow::Break(()),
        _ => ControlFlow::Continue(()),
    });
    if !matches!(stopped, Err(Error::Interrupted(_))) {
        return Err(Error::config("train", "the run did not stop half way"));
    }
    let mut trainer = Trainer::resume(&parts, &data, &Device::Cpu)?;
    trainer.run(&mut |_| ControlFlow::Continue(()))?;
    let resumed = trainer.checkpoint()?.tensors;
    let apart = |other: &std::collections::BTreeMap<String, neumip_export::Tensor>| {
        let values = expected.iter().flat_map(|(name, tensor)| {
            let other = other.get(name).map(|t| t.data.as_slice()).unwrap_or_default();
            tensor.data.iter().zip(other).map(|(a, b)| f64::from((a - b).abs()))
        });
        values.fold(0.0, f64::max)
    };
    let cured = apart(&resumed);
    let [through, restarted] = [false, true].map(|restart| by_hand(&config, &data, restart));
    let (through, restarted) = (through?, restarted?);
    let difference = |(a, b): (&Vec<f32>, &Vec<f32>)| {
        a.iter().zip(b).map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max)
    };
    let naive = through.iter().zip(&restarted).map(difference).fold(0.0, f64::max);
    Ok(Outcome::new(naive, cured))
}

/// Variables after a short run, whose moments begin anew half way or not.
fn by_hand(config: &Config, data: &Dataset, restart: bool) -> Result<Vec<Vec<f32>>> {
    let architecture = Architecture::new(config.model.clone(), data.resolution())?;
    let train = &config.train;
    let variables = Variables::initial(&architecture, train.seed, &Device::Cpu)?;
    let mut learner = Learner::new(&architecture, variables, train.adam, None, &Device::Cpu)?;
    let pieces = train.batch / (train.piece * train.piece);
    let mut stream = Stream::new(data, SplitName::Train, train.piece, pieces, MEMORY, train.seed)?;
    let stages = train.stages.resolve()?;
    let terms = &stages[0].terms;
    let sigmas = Sigmas::at(&architecture, None, 0.0);
    for step in 0..STEPS {
        if restart && step == STEPS / 2 {
            let stored = learner.variables().to_stored()?;
            let variables = Variables::from_stored(&architecture, &stored, &Device::Cpu)?;
            learner = Learner::new(&architecture, variables, train.adam, None, &Device::Cpu)?;
        }
        let batch = stream.next_batch()?;
        let task = Step {
            pieces: &batch.pieces,
            terms,
            target_range: train.target_range,
            highest_level: None,
            offset_texture: true,
        };
        learner.step(&task, &sigmas)?;
        // Adam's own count of updates is part of what is lost.
        let t = if restart && step >= STEPS / 2 { step - STEPS / 2 + 1 } else { step + 1 };
        learner.update_networks(train.learning_rate.peak, t)?;
        learner.update_textures(train.learning_rate.peak, t, true)?;
    }
    Ok(learner.variables().to_stored()?.into_values().map(|tensor| tensor.data).collect())
}

fn poisoned(workshop: &mut Workshop) -> Result<Outcome> {
    let n = SIDE * SIDE;
    let prediction = vec![0.5f32; n];
    let mut target = vec![0.25f32; n];
    target[n / 2] = f32::NAN;
    let terms = [
        Term { kind: Kind::L2, remap: Remap::Root4Signed(1e-3), scale: 1.0 },
        Term { kind: Kind::Gradient, remap: Remap::Root4Signed(1e-3), scale: 1.0 },
    ];
    let mut gradient = [vec![0.0f32; n], vec![0.0; n], vec![0.0; n]];
    let [r, g, b] = &mut gradient;
    let planes = [&prediction[..]; 3];
    let loss = loss::run(
        Isa::chosen()?,
        &terms,
        SIDE,
        SIDE,
        1.0,
        planes,
        [&target[..]; 3],
        [r, g, b],
        &mut Scratch::new(SIDE),
    );
    let bad = gradient.iter().flatten().filter(|v| !v.is_finite()).count();
    let naive = if loss.is_finite() { 0.0 } else { bad as f64 / (3 * n) as f64 };
    let material = workshop.scale().glossy().to_string();
    let inner = workshop.reference(&material)?;
    let change = |rgb: [f32; 3], random: &mut crate::random::Random| match random.below(1000) {
        0 => [f32::NAN; 3],
        _ => rgb,
    };
    let source = Spoilt { inner, how: "1 in 1000 is no number".into(), change };
    let path = workshop.folder().data("poisoned");
    let existing = if path.exists() { Existing::Replace } else { Existing::Refuse };
    let made = generate(&source, &workshop.generation(), &path, existing, &mut |_| ControlFlow::Continue(()));
    let (cured, note) = match made {
        Err(Error::Config { field, problem }) => (0.0, format!("What generation says: `{field}: {problem}`")),
        Err(other) => return Err(other),
        Ok(_) => (1.0, "Data with a value that is none were accepted.".into()),
    };
    Ok(Outcome { notes: vec![note], ..Outcome::new(naive, cured) })
}
