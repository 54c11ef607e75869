//! `neumip train`.

use super::console::{Console, short};
use crate::config::{Budget, Config, EngineKind};
use crate::dataset::Dataset;
use crate::error::Result;
use crate::model;
use crate::trainer::{Event, Trainer};
use clap::Args;
use std::path::PathBuf;

/// Train a model on a dataset.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  neumip train data/metal --out runs/metal --preset improved\n  \
    neumip train data/metal --out runs/wide --preset neumip --set model.decoder.hidden=[40,40,40] --minutes 10\n  \
    neumip train data/metal --out runs/metal --resume\n\n\
    A preset is a JSON file {\"model\": ..., \"train\": ...}; src/presets holds the built-in ones. --set reaches any field.")]
pub struct Train {
    /// The dataset.
    data: PathBuf,
    /// The run's folder.
    #[arg(long)]
    out: PathBuf,
    /// neumip, paper, improved, or a preset file.
    #[arg(long, default_value = "improved")]
    preset: String,
    /// Set any field of the preset, as model.texture.channels=12; may be given several times.
    #[arg(long = "set", value_name = "FIELD=VALUE")]
    overrides: Vec<String>,
    /// Budget in optimiser steps.
    #[arg(long, group = "budget")]
    steps: Option<u64>,
    /// Budget in samples presented.
    #[arg(long, group = "budget")]
    samples: Option<u64>,
    /// Budget in minutes.
    #[arg(long, group = "budget")]
    minutes: Option<f64>,
    /// Samples a step.
    #[arg(long)]
    batch: Option<usize>,
    /// Highest learning rate.
    #[arg(long)]
    learning_rate: Option<f64>,
    /// A named schedule of losses: s1, s2 or s3.
    #[arg(long)]
    stages: Option<String>,
    /// Seed of weights and order.
    #[arg(long)]
    seed: Option<u64>,
    /// Training data kept in memory at a time, as 512M or 2G; more is streamed. It decides the order of reading.
    #[arg(long, default_value = "2G", value_parser = super::parse_bytes)]
    memory: usize,
    /// cpu, cuda:N or metal:N.
    #[arg(long, default_value = "cpu")]
    device: String,
    /// What computes the steps: by default fused on the CPU, candle on other devices.
    #[arg(long)]
    engine: Option<EngineKind>,
    /// Go on with an interrupted run.
    #[arg(long, conflicts_with_all = ["force", "preset", "overrides", "budget", "batch", "learning_rate", "stages", "seed", "memory", "engine"])]
    resume: bool,
    /// Replace an existing run.
    #[arg(long)]
    force: bool,
    /// Leave out the probes of the trained material at the end.
    #[arg(long)]
    no_stability: bool,
    /// Write progress and validations here.
    #[arg(long)]
    json: Option<PathBuf>,
}

impl Train {
    /// Runs the command.
    pub fn run(self, console: &Console) -> Result<()> {
        super::check_json(self.json.as_deref())?;
        let data = Dataset::open(&self.data)?;
        if !data.manifest().complete {
            console.say(format!("note: {} is incomplete; training on what it holds", self.data.display()));
        }
        let device = model::device(&self.device)?;
        let mut trainer = if self.resume {
            Trainer::resume(&self.out, &data, &device)?
        } else {
            Trainer::new(self.config()?, &data, &self.out, self.force, self.memory, &device)?
        };
        train(&mut trainer, &format!("train {}", self.out.display()), console)?;
        if !self.no_stability {
            super::stability::after_training(&self.out, &self.data, &data, console);
        }
        super::save_json(self.json.as_deref(), trainer.progress())
    }

    fn config(&self) -> Result<Config> {
        let mut config = Config::preset(&self.preset)?;
        for assignment in &self.overrides {
            config.set(assignment)?;
        }
        let train = &mut config.train;
        let budget = self.steps.map(Budget::Steps).or(self.samples.map(Budget::Samples));
        train.budget = budget.or(self.minutes.map(Budget::Minutes)).unwrap_or(train.budget);
        train.batch = self.batch.unwrap_or(train.batch);
        train.learning_rate.peak = self.learning_rate.unwrap_or(train.learning_rate.peak);
        train.seed = self.seed.unwrap_or(train.seed);
        train.engine = self.engine.or(train.engine);
        if let Some(name) = &self.stages {
            train.stages = crate::config::StagePlan::Named(name.clone());
        }
        Ok(config)
    }
}

/// Runs a trainer with progress; returns samples a second.
pub fn train(trainer: &mut Trainer, label: &str, console: &Console) -> Result<f64> {
    // Shares of the run, in thousandths of a percent, so that every kind of budget has one meter.
    const PARTS: f64 = 100_000.0;
    let begun = trainer.progress().clone();
    let mut meter = console.meter(label, PARTS as u64, "parts");
    let mut validation = String::new();
    let clock = std::time::Instant::now();
    let result = trainer.run(&mut |event| {
        match event {
            Event::Step { samples, fraction, loss, .. } => {
                let rate = (samples - begun.samples) as f64 / clock.elapsed().as_secs_f64();
                let note = format!("{}/s, loss {loss:.5}{validation}", short(rate, "samples"));
                meter.show((fraction * PARTS) as u64, &note);
            }
            Event::Validation { point, .. } => {
                validation = format!(", validation mse {:.3}e-3", point.errors.mse * 1e3);
            }
            Event::Stage { .. } => {}
        }
        console.flow()
    });
    meter.finish(0);
    result?;
    let progress = trainer.progress();
    let rate = (progress.samples - begun.samples) as f64 / (progress.seconds - begun.seconds).max(1e-9);
    if let Some(best) = &progress.best {
        console.say(format!(
            "{label}: {} steps, {} samples in {:.0} s ({}/s), best validation mse {:.3}e-3 at step {}",
            progress.step,
            progress.samples,
            progress.seconds,
            short(rate, "samples"),
            best.errors.mse * 1e3,
            best.step
        ));
    }
    Ok(rate)
}
