//! `neumip sampler`.

use super::console::Console;
use crate::checkpoint;
use crate::error::{Error, Result};
use crate::sampler::{CONDITIONS, Cost, Gain, MaterialSampler, Options, cost, fit, gains};
use clap::Args;
use serde::Serialize;
use serde_json::Value;
use std::path::PathBuf;

/// Rounds of the timing.
const ROUNDS: usize = 5;
/// Added to the seed for what is printed: other queries than those that decided between mixture and cosine.
const FRESH: u64 = 1;

/// Fit an importance sampler to a trained material and measure it beside cosine sampling.
#[derive(Debug, Args)]
#[command(after_help = "Example: neumip sampler runs/metal --out sampler.safetensors\n\n\
    The table gives the variance of the reflected radiance that one direction estimates, mean over random positions,\n\
    levels and viewers, under a light that is the same from everywhere and under a sky with a sun and a window, turned\n\
    at random. `worst decile`: one query in ten has a larger ratio.")]
pub struct Sampler {
    /// A run's folder or a checkpoint.
    run: PathBuf,
    /// The file.
    #[arg(long)]
    out: PathBuf,
    /// Optimiser steps.
    #[arg(long, default_value_t = Options::default().steps)]
    steps: u64,
    /// Seed of weights, queries and directions.
    #[arg(long, default_value_t = Options::default().seed)]
    seed: u64,
    /// Replace an existing file.
    #[arg(long)]
    force: bool,
    /// Write what was measured here.
    #[arg(long)]
    json: Option<PathBuf>,
}

/// What is said of a sampler.
#[derive(Clone, Debug, Serialize)]
struct Measured {
    run: String,
    material: String,
    provenance: Value,
    gains: Vec<Gain>,
    /// Nanoseconds a query, one thread.
    cost: Cost,
}

impl Sampler {
    /// Runs the command.
    pub fn run(self, console: &Console) -> Result<()> {
        super::check_json(self.json.as_deref())?;
        super::check_json(Some(&self.out))?;
        if self.out.exists() && !self.force {
            return Err(Error::file(&self.out, "exists: name another file or add --force"));
        }
        let checkpoint = checkpoint::load(&self.run)?;
        let options = Options { steps: self.steps, seed: self.seed, ..Options::default() };
        let mut meter = console.meter(format!("sampler of {}", self.run.display()), self.steps, "steps");
        let fitted = fit(&checkpoint, &options, &mut |step, loss| {
            meter.update(step, &format!("loss {loss:.3}"));
            console.flow()
        });
        meter.finish(self.steps);
        let fitted = fitted?;
        let sampler = MaterialSampler::from_checkpoint(&checkpoint, &fitted)?;
        let measured = Measured {
            run: self.run.display().to_string(),
            material: checkpoint.header.material,
            provenance: fitted.header.provenance.clone(),
            gains: gains(&sampler, CONDITIONS, self.seed.wrapping_add(FRESH))?,
            cost: cost(&sampler, ROUNDS)?,
        };
        console.check("no sampler was written")?;
        fitted.write(&self.out)?;
        super::save_json(self.json.as_deref(), &measured)?;
        console.answer(text(&measured))
    }
}

fn text(measured: &Measured) -> String {
    let Cost { answer, lobes, sample, .. } = measured.cost;
    let mut out = format!(
        "{}: {answer:.0} ns an answer, {lobes:.0} ns the lobes of a prepared query, {sample:.0} ns a sample (one thread)\n",
        measured.material
    );
    if measured.provenance["fallback"] == true {
        out += "the mixture was no better than the cosine, which is all that the file holds\n";
    }
    out += &format!(
        "\n{:<8} {:>12} {:>12} {:>17} {:>8} {:>13}",
        "light", "cosine", "mixture", "ratio", "median", "worst decile"
    );
    for g in &measured.gains {
        out += &format!(
            "\n{:<8} {:>12.5} {:>12.5} {:>8.4} +- {:.4} {:>8.3} {:>13.3}",
            g.light, g.cosine, g.mixture, g.ratio, g.error, g.median, g.worst_decile
        );
    }
    out + "\nvariance of an estimate by one direction; ratio with its standard error"
}
