//! Short trainings with random configurations: none may leave the finite numbers.

use super::queries::SEED;
use crate::config::{Budget, Config, Remap, Stage, StagePlan, Term, TermKind};
use crate::dataset::Dataset;
use crate::error::{Error, Result};
use crate::random::{Random, Stream};
use crate::reference::{Reference, ReferenceOptions};
use crate::stability::probe::{Bound, Group, Outcome, Probe};
use crate::stability::workshop::Workshop;
use crate::trainer::Trainer;
use candle_core::Device;
use neumip_export::config::{DecoderConfig, OffsetConfig, OutputSpace, OutputTransform, ParallaxConfig};
use std::ops::ControlFlow;

/// Texels along a side of the tile.
const SIDE: usize = 32;
/// Steps of a training: divergence of the first steps, which is most of it.
const STEPS: u64 = 60;
/// Unique training samples a texel.
const UNIQUE: u64 = 60;
/// Memory for the training data.
const MEMORY: usize = 64 << 20;
const PRESETS: [&str; 3] = ["neumip", "paper", "improved"];
/// Learning rates, weights of terms and epsilons of roots, from one power of ten to another.
const RATES: [f64; 2] = [1e-4, 0.1];
const WEIGHTS: [f64; 2] = [0.01, 10.0];
const EPSILONS: [f64; 2] = [1e-4, 0.1];

pub(super) fn probes() -> Vec<Probe> {
    vec![Probe {
        name: "short-trainings",
        group: Group::Numbers,
        provokes: "Users combine what no one tried: a training that ends in NaN after an hour of waiting is the method's most \
                   expensive failure.",
        naive: "random configurations with the 4th root as printed",
        cured: "the same configurations with any other remap",
        figure: "trainings of 60 steps that leave the finite numbers",
        bound: Bound::new(0.0, "a configuration that is accepted must train"),
        run,
    }]
}

fn run(workshop: &mut Workshop) -> Result<Outcome> {
    let data = data(workshop)?;
    let count = workshop.scale().trainings;
    let (mut naive, mut notes) = (0u64, Vec::new());
    let mut cured = 0u64;
    for index in 0..count {
        let config = configuration(index)?;
        if let Some(problem) = diverges(workshop, &config, &data)? {
            notes.push(format!("{}: {problem}", described(index, &config)));
            cured += 1;
        }
        naive += u64::from(diverges(workshop, &as_printed(config), &data)?.is_some());
    }
    notes.insert(0, format!("{count} configurations of {STEPS} steps at {SIDE} x {SIDE}."));
    let values = vec![("trainings".into(), count as f64)];
    Ok(Outcome { notes, values, ..Outcome::new(naive as f64, cured as f64) })
}

fn data(workshop: &mut Workshop) -> Result<Dataset> {
    let material = workshop.scale().glossy().to_string();
    let options = ReferenceOptions { resolution: Some([SIDE; 2]), bounces: 0, ..ReferenceOptions::default() };
    let reference = Reference::open(&material, &options)?;
    let mut generation = workshop.generation();
    let texels = (SIDE * SIDE) as u64;
    generation.resolution = SIDE;
    generation.samples = texels * UNIQUE;
    generation.validation_samples = texels;
    generation.offgrid_samples = 0;
    generation.grazing_samples = 0;
    generation.test_pairs = 0;
    workshop.data_of(&format!("{material}.{SIDE}"), &reference, &generation)
}

/// What a training says that does not end well.
fn diverges(workshop: &Workshop, config: &Config, data: &Dataset) -> Result<Option<String>> {
    workshop.check()?;
    let root = workshop.folder().root();
    let folder = tempfile::tempdir_in(root).map_err(|e| Error::file(root, e))?;
    let run = folder.path().join("run");
    let mut trainer = Trainer::new(config.clone(), data, &run, false, MEMORY, &Device::Cpu)?;
    let trained = trainer.run(&mut |_| ControlFlow::Continue(())).and_then(|()| trainer.checkpoint());
    Ok(match trained {
        Ok(checkpoint) => {
            let bad =
                checkpoint.tensors.iter().find(|(_, tensor)| !tensor.data.iter().all(|v| v.is_finite()));
            bad.map(|(name, _)| format!("{name} is not finite"))
        }
        // What it says of its folder differs from run to run.
        Err(Error::Diverged(problem)) => {
            Some(problem.split("; the last good state").next().unwrap_or_default().to_string())
        }
        Err(problem @ (Error::File { .. } | Error::Usage(_))) => return Err(problem),
        Err(problem) => Some(problem.to_string()),
    })
}

/// Uniform in the logarithm.
fn between(random: &mut Random, [low, high]: [f64; 2]) -> f64 {
    low * (high / low).powf(random.uniform_f64())
}

fn one_of<T: Copy>(random: &mut Random, all: &[T]) -> T {
    all[random.below(all.len())]
}

/// The configuration of a number: any that is accepted, but for the 4th root as printed.
fn configuration(index: u64) -> Result<Config> {
    let random = &mut Random::sub_stream(SEED, Stream::Probe, 3, index);
    let mut config = Config::preset(one_of(random, &PRESETS))?;
    let hidden =
        |random: &mut Random| (0..1 + random.below(3)).map(|_| 8 + random.below(41)).collect::<Vec<_>>();
    let model = &mut config.model;
    model.texture.channels = 3 + random.below(14);
    model.texture.init_std = between(random, [0.01, 1.0]) as f32;
    model.parallax = match random.below(4) {
        0 => ParallaxConfig::None {},
        _ => ParallaxConfig::Offset(OffsetConfig {
            channels: 3 + random.below(10),
            hidden: hidden(random),
            scale: between(random, [0.01, 1.0]) as f32,
            min_z: between(random, [0.05, 0.9]) as f32,
        }),
    };
    let encoding = &mut model.encoding;
    encoding.pi = random.below(2) == 0;
    encoding.components = 2 + random.below(2);
    encoding.u.bands = random.below(11);
    encoding.u.attenuate = random.below(2) == 0;
    encoding.u.limit_to_resolution = random.below(2) == 0;
    encoding.u.raw = random.below(2) == 0;
    for direction in [&mut encoding.wi, &mut encoding.wo] {
        direction.bands = random.below(7);
        direction.raw = direction.bands == 0 || random.below(2) == 0;
        direction.amplitude = between(random, [0.1, 2.0]) as f32;
    }
    model.decoder = DecoderConfig::Mlp { hidden: hidden(random) };
    model.output.space = one_of(random, &[OutputSpace::Rgb, OutputSpace::Yuv]);
    model.output.transform = one_of(random, &[OutputTransform::Identity, OutputTransform::ExpMinusOne]);
    model.output.mask = random.below(3) == 0;
    let train = &mut config.train;
    train.seed = u64::from(random.next_u32());
    train.budget = Budget::Steps(STEPS);
    train.validations = 1;
    train.piece = one_of(random, &[4, 8, 16]);
    train.batch = train.piece * train.piece * (1 + random.below(4));
    train.learning_rate.peak = between(random, RATES);
    train.learning_rate.warmup = one_of(random, &[0.0, 0.02, 0.2]);
    let kinds = [TermKind::L1, TermKind::L2, TermKind::Gradient, TermKind::GradientLuma];
    let terms = (0..1 + random.below(3)).map(|_| Term {
        kind: one_of(random, &kinds),
        remap: match random.below(5) {
            0 => Remap::Linear,
            1 => Remap::Root4Guarded,
            2 => Remap::Root4Signed(between(random, EPSILONS)),
            3 => Remap::Sqrt(between(random, EPSILONS)),
            _ => Remap::Log,
        },
        weight: between(random, WEIGHTS),
    });
    let terms = terms.collect();
    train.stages = StagePlan::List(vec![Stage { share: 1.0, plateau: None, terms }]);
    config.train.validate()?;
    Ok(config)
}

/// The same with the literal 4th root.
fn as_printed(mut config: Config) -> Config {
    if let StagePlan::List(stages) = &mut config.train.stages {
        stages
            .iter_mut()
            .flat_map(|stage| &mut stage.terms)
            .for_each(|term| term.remap = Remap::Root4Literal);
    }
    config
}

/// What matters of a configuration, in a line.
fn described(index: u64, config: &Config) -> String {
    let Config { model, train } = config;
    let stages: &[Stage] = match &train.stages {
        StagePlan::List(stages) => stages,
        StagePlan::Named(_) => &[],
    };
    let terms = stages.iter().flat_map(|stage| &stage.terms);
    let terms: Vec<String> =
        terms.map(|t| format!("{:.2} {:?} of {:?}", t.weight, t.kind, t.remap)).collect();
    format!(
        "configuration {index} (learning rate {:.1e}, {}, batch {}, {:?} {:?}, seed {})",
        train.learning_rate.peak,
        terms.join(" + "),
        train.batch,
        model.output.space,
        model.output.transform,
        train.seed
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use neumip_export::Architecture;

    #[test]
    fn configurations_are_valid_differ_and_come_back() {
        let all: Vec<Config> = (0..200).map(|index| configuration(index).unwrap()).collect();
        for (index, config) in all.iter().enumerate() {
            Architecture::new(config.model.clone(), [SIDE; 2]).unwrap();
            assert_eq!(*config, configuration(index as u64).unwrap());
            let text = serde_json::to_string(&config.train.stages).unwrap();
            assert!(!text.contains("root4-literal"));
            let printed = serde_json::to_string(&as_printed(config.clone()).train.stages).unwrap();
            assert!(printed.contains("root4-literal") && !printed.contains("guarded"));
        }
        assert!(all.windows(2).all(|pair| pair[0] != pair[1]));
        let rates = all.iter().map(|c| c.train.learning_rate.peak);
        let (low, high) = rates.fold((1.0f64, 0.0f64), |(l, h), r| (l.min(r), h.max(r)));
        assert!(low < 2e-4 && high > 0.05);
    }
}
