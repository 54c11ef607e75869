//! `neumip reproduce`: the paper's questions at a budget of one's own.

pub(super) mod machine;
mod run;
mod times;
mod training;

use super::console::Console;
use super::surface::materials;
use crate::error::{Error, Result};
use crate::lpips::Lpips;
use crate::reproduce::study::Directions;
use crate::reproduce::{Question, Scope, Study};
use clap::Args;
use std::path::PathBuf;
use std::str::FromStr;

/// Ask the paper's questions again: tables, ablation, Inception decoder, speed against accuracy.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  neumip reproduce --quick --out quick\n  \
    neumip reproduce --out study --materials all --seeds 3\n  \
    neumip reproduce --out part --cells 1/2        (on one machine; 2/2 on the other)\n  \
    neumip reproduce --out study --merge part --materials all --seeds 3\n\n\
    A stopped study goes on when the same command is given again; a cell that is finished is not run again. Materials,\n\
    presets, questions and seeds may be added later; resolution, budgets and tuning are the folder's.")]
pub struct Reproduce {
    /// Folder of the study: data, runs, cells, results.
    #[arg(long, default_value = "neumip-study")]
    out: PathBuf,
    /// What is asked.
    #[arg(long, value_delimiter = ',', default_value = "presets,ablation,inception,chart")]
    questions: Vec<Question>,
    /// Materials of tables 1 and 2: names, files or `all`.
    #[arg(long, value_delimiter = ',')]
    materials: Vec<String>,
    /// Presets of tables 1 and 2.
    #[arg(long, value_delimiter = ',', default_value = "neumip,paper,improved")]
    presets: Vec<String>,
    /// Regimes of training data in tables 1 and 2.
    #[arg(long, value_delimiter = ',', default_value = "scattered,slices")]
    regimes: Vec<Directions>,
    /// Trainings of every cell but the ablation's, with seeds 1, 2, ...
    #[arg(long)]
    seeds: Option<u64>,
    /// Texels along a side of the tile.
    #[arg(long)]
    resolution: Option<usize>,
    /// Samples presented in a training, a texel.
    #[arg(long)]
    budget: Option<u64>,
    /// Samples of the training data, a texel.
    #[arg(long)]
    unique: Option<u64>,
    /// Tuning trials of each preset.
    #[arg(long)]
    trials: Option<usize>,
    /// Material of the ablation.
    #[arg(long)]
    ablation_on: Option<String>,
    /// Materials of the Inception question.
    #[arg(long, value_delimiter = ',')]
    inception_on: Vec<String>,
    /// Decoders of the Inception question.
    #[arg(long, value_delimiter = ',', default_value = "inception-small")]
    decoders: Vec<String>,
    /// Materials of the chart.
    #[arg(long, value_delimiter = ',')]
    chart_on: Vec<String>,
    /// Indirect bounces of the reference.
    #[arg(long)]
    bounces: Option<usize>,
    /// Rays a training sample.
    #[arg(long)]
    spp: Option<usize>,
    /// Weight of the gradient loss in the ablation.
    #[arg(long)]
    gradient_weight: Option<f64>,
    /// Only every N-th training, from the I-th on: I/N.
    #[arg(long, default_value = "1/1", value_name = "I/N")]
    cells: Share,
    /// Take over what other folders of the same study have finished.
    #[arg(long, value_delimiter = ',')]
    merge: Vec<PathBuf>,
    /// A small study of two materials at 64 x 64 that takes a few minutes: does everything work?
    #[arg(long)]
    quick: bool,
    /// Say what would be run, and run nothing.
    #[arg(long)]
    plan: bool,
    /// Render the datasets of the regimes and stop.
    #[arg(long)]
    prepare: bool,
    /// Weights of LPIPS, as scripts/lpips_weights.py writes them; cells that are finished keep what they have.
    #[arg(long, value_name = "FILE")]
    lpips_weights: Option<PathBuf>,
    /// Rounds of the timing; 0 leaves it out.
    #[arg(long, default_value_t = 7)]
    rounds: usize,
    /// Write results.json here too.
    #[arg(long)]
    json: Option<PathBuf>,
}

/// The I-th of N parts.
#[derive(Clone, Copy, Debug)]
struct Share {
    index: usize,
    of: usize,
}

impl FromStr for Share {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let parts = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
        match parts {
            Some((index, of)) if (1..=of).contains(&index) => Ok(Self { index, of }),
            _ => Err(format!("{text} is no part such as 1/2: from 1/N to N/N")),
        }
    }
}

/// The defaults that `--quick` changes.
struct Size {
    resolution: usize,
    budget: u64,
    unique: u64,
    batch: usize,
    trials: usize,
    seeds: u64,
    spp: usize,
    held_out_spp: usize,
    test_pairs: usize,
    view_size: usize,
    motion: usize,
    materials: &'static [&'static str],
    tuned_on: &'static [&'static str],
    ablation_on: &'static str,
    chart_on: &'static [&'static str],
}

const FULL: Size = Size {
    resolution: 128,
    budget: 1200,
    unique: 100,
    batch: 8192,
    trials: 8,
    seeds: 2,
    spp: 16,
    held_out_spp: 64,
    test_pairs: 12,
    view_size: 192,
    motion: 4,
    materials: &["all"],
    tuned_on: &["metal-rings", "rocks"],
    ablation_on: "basket-cloth",
    chart_on: &["metal-rings", "rocks", "basket-cloth"],
};

const QUICK: Size = Size {
    resolution: 64,
    budget: 150,
    unique: 40,
    batch: 2048,
    trials: 2,
    seeds: 1,
    spp: 8,
    held_out_spp: 16,
    test_pairs: 6,
    view_size: 64,
    motion: 3,
    materials: &["metal-rings", "rocks"],
    tuned_on: &["rocks"],
    ablation_on: "metal-rings",
    chart_on: &["metal-rings", "rocks"],
};

/// Share of the budget that a trial has.
const TRIAL_SHARE: f64 = 0.25;
/// Weight of the gradient loss in the ablation: at the printed one it swamps the pixel loss (docs/presets.md).
const GRADIENT_WEIGHT: f64 = 0.03;

impl Reproduce {
    /// Runs the command.
    pub fn run(self, console: &Console) -> Result<()> {
        super::check_json(self.json.as_deref())?;
        let (study, scope) = self.study()?;
        study.validate()?;
        let lpips = self.lpips_weights.as_ref().map(Lpips::open).transpose()?;
        run::Run { study, scope, asked: &self, lpips, console }.run()
    }

    fn study(&self) -> Result<(Study, Scope)> {
        let size = if self.quick { QUICK } else { FULL };
        let given = |names: &[String], default: &[&str]| -> Vec<String> {
            let names: Vec<String> = if names.is_empty() {
                default.iter().map(|n| n.to_string()).collect()
            } else {
                names.to_vec()
            };
            names.iter().flat_map(|name| materials(name)).collect()
        };
        let seeds = self.seeds.unwrap_or(size.seeds);
        if !(1..=1000).contains(&seeds) {
            return Err(Error::usage(format!("--seeds {seeds}: 1 to 1000 work")));
        }
        let study = Study {
            resolution: self.resolution.unwrap_or(size.resolution),
            budget: self.budget.unwrap_or(size.budget),
            unique: self.unique.unwrap_or(size.unique),
            batch: size.batch,
            trials: self.trials.unwrap_or(size.trials),
            trial_share: TRIAL_SHARE,
            tuned_on: given(&[], size.tuned_on),
            bounces: self.bounces.unwrap_or(1),
            spp: self.spp.unwrap_or(size.spp),
            held_out_spp: size.held_out_spp,
            test_pairs: size.test_pairs,
            view_size: size.view_size,
            motion: size.motion,
            gradient_weight: self.gradient_weight.unwrap_or(GRADIENT_WEIGHT),
            data_seed: 1,
        };
        let ablation_on = self.ablation_on.clone().unwrap_or(size.ablation_on.into());
        let scope = Scope {
            questions: self.questions.clone(),
            materials: given(&self.materials, size.materials),
            presets: self.presets.clone(),
            regimes: self.regimes.clone(),
            seeds,
            inception_on: given(&self.inception_on, &[&ablation_on]),
            ablation_on,
            decoders: self.decoders.clone(),
            chart_on: given(&self.chart_on, size.chart_on),
        };
        Ok((study, scope))
    }

    /// The command that does the same again.
    fn command(&self, study: &Study, scope: &Scope) -> String {
        let questions: Vec<String> = scope
            .questions
            .iter()
            .filter_map(|q| clap::ValueEnum::to_possible_value(q).map(|v| v.get_name().to_string()))
            .collect();
        let quick = if self.quick { " --quick" } else { "" };
        let regimes: Vec<String> = scope.regimes.iter().map(ToString::to_string).collect();
        format!(
            "neumip reproduce{quick} --out {} --questions {} --materials {} --presets {} --regimes {} --seeds {} \
             --resolution {} --budget {} --unique {} --trials {} --ablation-on {} --inception-on {} --decoders {} \
             --chart-on {} --bounces {} --spp {} --gradient-weight {}",
            self.out.display(),
            questions.join(","),
            scope.materials.join(","),
            scope.presets.join(","),
            regimes.join(","),
            scope.seeds,
            study.resolution,
            study.budget,
            study.unique,
            study.trials,
            scope.ablation_on,
            scope.inception_on.join(","),
            scope.decoders.join(","),
            scope.chart_on.join(","),
            study.bounces,
            study.spp,
            study.gradient_weight
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_read() {
        let share: Share = "2/3".parse().unwrap();
        assert_eq!((share.index, share.of), (2, 3));
        for wrong in ["0/2", "3/2", "1", "a/b", ""] {
            assert!(wrong.parse::<Share>().is_err(), "{wrong}");
        }
    }
}
