//! What a study fixes, and which of its questions a call asks.

use crate::dataset::{GenerateConfig, Motion, Regime};
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::fmt;

/// What every cell of a folder shares. Cells of other studies do not belong into the same folder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Study {
    /// Texels along a side of the tile.
    pub resolution: usize,
    /// Samples presented in training, a texel.
    pub budget: u64,
    /// Samples of the training data, a texel.
    pub unique: u64,
    /// Samples of a step.
    pub batch: usize,
    /// Tuning trials of each preset, the preset as it is among them.
    pub trials: usize,
    /// Share of the budget that a trial has.
    pub trial_share: f64,
    /// Materials that trials are run on.
    pub tuned_on: Vec<String>,
    /// Indirect bounces of the reference.
    pub bounces: usize,
    /// Sub-samples of a training sample.
    pub spp: usize,
    /// Sub-samples of a held-out sample.
    pub held_out_spp: usize,
    /// Pairs of the test split.
    pub test_pairs: usize,
    /// Pixels along a side of a view.
    pub view_size: usize,
    /// Frames of each sequence of views, a degree apart.
    pub motion: usize,
    /// Weight of the gradient term in the ablation.
    pub gradient_weight: f64,
    /// Seed of the data.
    pub data_seed: u64,
}

/// Regimes of training data by their short names.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Directions {
    /// A pair of directions a patch.
    Scattered,
    /// As many whole slices as the samples pay for: the paper's.
    Slices,
}

impl fmt::Display for Directions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Scattered => "scattered",
            Self::Slices => "slices",
        })
    }
}

/// A question of the paper's, or of ours.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Question {
    /// Tables 1 and 2: the presets on every material, in both regimes.
    Presets,
    /// Figure 3: encoding, gradient loss and stages as a factorial on one material.
    Ablation,
    /// Figure 8: the Inception decoder.
    Inception,
    /// Error against time and bytes over many variants.
    Chart,
}

/// What a call asks for; it may differ from call to call.
#[derive(Clone, Debug, PartialEq)]
pub struct Scope {
    /// Questions.
    pub questions: Vec<Question>,
    /// Materials of the tables.
    pub materials: Vec<String>,
    /// Presets of the tables, by name or file.
    pub presets: Vec<String>,
    /// Regimes of the tables.
    pub regimes: Vec<Directions>,
    /// Trainings of each cell of the tables: seeds 1 to this.
    pub seeds: u64,
    /// Material of the ablation.
    pub ablation_on: String,
    /// Materials of the Inception question, and its decoders.
    pub inception_on: Vec<String>,
    /// Decoders of the Inception question.
    pub decoders: Vec<String>,
    /// Materials of the chart.
    pub chart_on: Vec<String>,
}

impl Study {
    /// Checks every bound.
    ///
    /// # Errors
    /// `Config`, naming the field.
    pub fn validate(&self) -> Result<()> {
        let fail = |field: &str, problem: String| Err(Error::config(field, problem));
        if !(1..=10_000_000).contains(&self.budget) {
            return fail("budget", format!("{} samples a texel: 1 to 10,000,000 work", self.budget));
        }
        if !(1..=1_000_000).contains(&self.unique) {
            return fail("unique", format!("{} samples a texel: 1 to 1,000,000 work", self.unique));
        }
        if !(1..=1000).contains(&self.trials) {
            return fail("trials", format!("{}: 1 to 1000 work", self.trials));
        }
        if !(self.trial_share > 0.0 && self.trial_share <= 1.0) {
            return fail("trial_share", format!("{} is not in (0, 1]", self.trial_share));
        }
        if self.tuned_on.is_empty() {
            return fail("tuned_on", "name at least one material".into());
        }
        if !(self.gradient_weight.is_finite() && self.gradient_weight > 0.0) {
            return fail("gradient_weight", format!("{} is not positive", self.gradient_weight));
        }
        self.generation(Directions::Scattered).validate()?;
        self.generation(Directions::Slices).resolved(&[]).map(|_| ())
    }

    /// The dataset of a regime. Held-out splits are made once, with the scattered data.
    pub fn generation(&self, directions: Directions) -> GenerateConfig {
        let mut config = GenerateConfig::new(self.resolution);
        config.samples = self.texels().saturating_mul(self.unique);
        config.spp = self.spp;
        config.held_out_spp = self.held_out_spp;
        config.seed = self.data_seed;
        config.test_pairs = self.test_pairs;
        config.view_size = self.view_size;
        config.motion = (self.motion > 0).then_some(Motion { frames: self.motion, step: 1.0 });
        if directions == Directions::Slices {
            config.regime = Regime::Slices(0);
            (config.test_pairs, config.view_size, config.motion) = (0, 0, None);
            (config.offgrid_samples, config.grazing_samples) = (0, 0);
        }
        config
    }

    /// Texels of the tile.
    pub fn texels(&self) -> u64 {
        (self.resolution as u64).saturating_mul(self.resolution as u64)
    }

    /// Samples presented in a training.
    pub fn samples(&self) -> u64 {
        self.texels().saturating_mul(self.budget)
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A small study.
    pub(in super::super) fn study() -> Study {
        Study {
            resolution: 16,
            budget: 20,
            unique: 20,
            batch: 1024,
            trials: 2,
            trial_share: 0.5,
            tuned_on: vec!["rocks".into()],
            bounces: 0,
            spp: 2,
            held_out_spp: 2,
            test_pairs: 2,
            view_size: 16,
            motion: 2,
            gradient_weight: 0.03,
            data_seed: 1,
        }
    }

    /// All of it.
    pub(in super::super) fn scope() -> Scope {
        Scope {
            questions: vec![Question::Presets, Question::Ablation, Question::Inception, Question::Chart],
            materials: vec!["rocks".into(), "metal-rings".into()],
            presets: vec!["neumip".into(), "improved".into()],
            regimes: vec![Directions::Scattered, Directions::Slices],
            seeds: 2,
            ablation_on: "metal-rings".into(),
            inception_on: vec!["rocks".into()],
            decoders: vec!["inception-small".into()],
            chart_on: vec!["rocks".into()],
        }
    }

    #[test]
    fn bounds_are_named() {
        study().validate().unwrap();
        let wrong = |change: fn(&mut Study)| {
            let mut study = study();
            change(&mut study);
            study.validate().unwrap_err().to_string()
        };
        assert!(wrong(|s| s.trials = 0).contains("trials"));
        assert!(wrong(|s| s.trial_share = f64::NAN).contains("trial_share"));
        assert!(wrong(|s| s.resolution = 100).contains("resolution"));
        assert!(wrong(|s| s.tuned_on.clear()).contains("tuned_on"));
        assert!(wrong(|s| s.gradient_weight = 0.0).contains("gradient_weight"));
    }
}
