//! How a model is trained: the structs behind a preset's `train` object, the command line and the run's record.

use crate::error::{Error, Result};
use neumip_export::config::ModelConfig;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// A preset: what is trained and how.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// The model.
    pub model: ModelConfig,
    /// Its training.
    pub train: TrainConfig,
}

/// Training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainConfig {
    /// Seed of weights, order and every other choice.
    pub seed: u64,
    /// How long.
    pub budget: Budget,
    /// Samples a step: a multiple of `piece`^2.
    pub batch: usize,
    /// Side of the square pieces a step is made of: a power of two; larger blocks of the data are cut.
    pub piece: usize,
    /// Learning rate.
    pub learning_rate: LearningRate,
    /// Adam's constants.
    pub adam: AdamConfig,
    /// Gaussian smoothing of the textures while training.
    pub smoothing: Option<Smoothing>,
    /// Early blending of the stored pyramid towards its blur.
    pub blend: Option<Blend>,
    /// Share of the run after which the offset texture stops learning.
    pub offset_freeze: Option<f64>,
    /// Each step draws one of these; queries beyond that level get weight 0 (`null`: all levels count).
    pub level_dropout: Vec<Option<u32>>,
    /// Targets are clamped to this range.
    pub target_range: [f32; 2],
    /// Losses over the run.
    pub stages: StagePlan,
    /// Validations during the run.
    pub validations: usize,
}

/// When training ends.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Budget {
    /// Optimiser steps.
    Steps(u64),
    /// Samples presented.
    Samples(u64),
    /// Minutes of training; the one budget whose result depends on the machine.
    Minutes(f64),
}

/// Learning rate over the run: `peak`, after a linear rise over `warmup`, falling along `decay`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LearningRate {
    /// Highest value.
    pub peak: f64,
    /// Share of the run in which it rises from 0.
    pub warmup: f64,
    /// How it falls afterwards.
    pub decay: Decay,
}

/// Decay of the learning rate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Decay {
    /// None.
    Constant {},
    /// Half a cosine down to `floor` times the peak.
    Cosine {
        /// Share of the peak that is left at the end.
        floor: f64,
    },
    /// Exponentially down to `floor` times the peak.
    Exponential {
        /// Share of the peak that is left at the end.
        floor: f64,
    },
}

impl LearningRate {
    /// The rate when a share `fraction` of the run is done.
    pub fn at(&self, fraction: f64) -> f64 {
        if fraction < self.warmup {
            return self.peak * (fraction / self.warmup).max(1e-3);
        }
        let t = ((fraction - self.warmup) / (1.0 - self.warmup)).clamp(0.0, 1.0);
        self.peak
            * match self.decay {
                Decay::Constant {} => 1.0,
                Decay::Cosine { floor } => floor + (1.0 - floor) * 0.5 * (1.0 + (std::f64::consts::PI * t).cos()),
                Decay::Exponential { floor } => floor.powf(t),
            }
    }
}

/// Adam (Kingma and Ba 2015).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AdamConfig {
    /// Decay of the first moment.
    pub beta1: f64,
    /// Decay of the second moment.
    pub beta2: f64,
    /// Added to the root of the second moment.
    pub epsilon: f64,
}

/// Gaussian through which every texture is read while training (NeuMIP's code):
/// sigma(t) = max(minimum, start * start^(-rate t)) texels for t in \[0, 1\] of the run; level l uses sigma / 2^l.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Smoothing {
    /// Texels at the start.
    pub start: f64,
    /// Decades of `start` over the run: 3 in NeuMIP, 0.3 in the improved method's code.
    pub rate: f64,
    /// Least sigma, texels.
    pub minimum: f64,
    /// A level whose sigma is under this is read as it is.
    pub skip_below: f64,
    /// Least sigma of the offset texture, texels.
    pub offset_minimum: f64,
}

impl Smoothing {
    /// sigma in texels of level 0 when a share `fraction` of the run is done.
    pub fn sigma(&self, fraction: f64) -> f64 {
        (self.start * self.start.powf(-self.rate * fraction)).max(self.minimum)
    }
}

/// Blending of the stored pyramid towards its own blur, early in the run (NeuMIP's code).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Blend {
    /// Share of the run in which it happens.
    pub until: f64,
    /// Share of the run between two blends.
    pub every: f64,
    /// Weight of the blur.
    pub amount: f64,
    /// Its sigma in texels of the level.
    pub sigma: f64,
}

/// Losses over the run: a named schedule or a list of stages.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum StagePlan {
    /// `s1`, `s2` or `s3` of the authors' code.
    Named(String),
    /// In order.
    List(Vec<Stage>),
}

/// One stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stage {
    /// Share of the run after which the next stage begins; the last stage lasts to the end.
    pub share: f64,
    /// Ends the stage earlier, when validation stops improving.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plateau: Option<Plateau>,
    /// Terms that are added up.
    pub terms: Vec<Term>,
}

/// The adaptive criterion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plateau {
    /// Validations without improvement that end the stage.
    pub patience: usize,
    /// Relative improvement that counts.
    pub improvement: f64,
}

/// One weighted term of the loss.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Term {
    /// What is compared.
    pub kind: TermKind,
    /// Applied to prediction and target first.
    pub remap: Remap,
    /// Factor.
    pub weight: f64,
}

/// What a term compares.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TermKind {
    /// Mean absolute difference.
    L1,
    /// Mean squared difference; with remap `log` NeuMIP's MSE of log1p.
    L2,
    /// Squared difference of Sobel-x and Sobel-y responses, RGB (paper, equation 1).
    Gradient,
    /// Absolute difference of half-strength Sobel responses of luma (authors' code).
    GradientLuma,
}

/// Output remapping (paper, section 3.2).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Remap {
    /// x.
    Linear,
    /// x^(1/4) as printed: not a number below 0, infinite slope at 0.
    Root4Literal,
    /// max(x, 1e-7)^(1/4) (authors' code).
    Root4Guarded,
    /// sign(x) ((|x| + epsilon)^(1/4) - epsilon^(1/4)).
    Root4Signed(f64),
    /// sign(x) ((|x| + epsilon)^(1/2) - epsilon^(1/2)).
    Sqrt(f64),
    /// ln(1 + max(x, -0.1)).
    Log,
}

/// epsilon of the square root in the named schedules: the slope at 0 stays under 16.
const NAMED_SQRT_EPSILON: f64 = 1e-3;

impl StagePlan {
    /// The list of stages.
    ///
    /// # Errors
    /// `Config` if the name is unknown.
    pub fn resolve(&self) -> Result<Vec<Stage>> {
        let name = match self {
            Self::List(list) => return Ok(list.clone()),
            Self::Named(name) => name.as_str(),
        };
        use Remap::{Linear, Root4Guarded, Sqrt};
        let l1 = |remap| Term { kind: TermKind::L1, remap, weight: 1.0 };
        let gradient = |remap| Term { kind: TermKind::GradientLuma, remap, weight: 1.0 };
        let stage = |share, terms| Stage { share, plateau: None, terms };
        let both = |remap| vec![l1(remap), gradient(remap)];
        let root = Sqrt(NAMED_SQRT_EPSILON);
        match name {
            "s1" => Ok(vec![
                stage(0.25, vec![l1(Root4Guarded)]),
                stage(0.5, both(Linear)),
                stage(0.25, both(root)),
            ]),
            "s2" => Ok(vec![stage(0.5, vec![l1(Root4Guarded)]), stage(0.5, both(Linear))]),
            "s3" => Ok(vec![stage(0.25, vec![l1(Root4Guarded)]), stage(0.75, both(Root4Guarded))]),
            _ => Err(Error::config("train.stages", format!("{name:?} is no schedule: use s1, s2, s3 or a list"))),
        }
    }
}

/// Names of the built-in presets.
pub const PRESETS: [&str; 3] = ["neumip", "paper", "improved"];

impl Config {
    /// A built-in preset by name, or a preset file.
    ///
    /// # Errors
    /// `Usage` for an unknown name, `File` for an unreadable or malformed file.
    pub fn preset(name: &str) -> Result<Self> {
        let text = match name {
            "neumip" => include_str!("presets/neumip.json").to_string(),
            "paper" => include_str!("presets/paper.json").to_string(),
            "improved" => include_str!("presets/improved.json").to_string(),
            path if path.ends_with(".json") => {
                std::fs::read_to_string(path).map_err(|e| Error::file(path, format!("cannot read preset: {e}")))?
            }
            _ => {
                return Err(Error::usage(format!(
                    "--preset {name}: unknown; use {} or a .json file",
                    PRESETS.join(", ")
                )));
            }
        };
        serde_json::from_str(&text).map_err(|e| Error::file(name, format!("not a preset: {e}")))
    }

    /// Sets one field by its dotted name, as in `model.texture.channels=12`; the value is JSON or a bare word.
    ///
    /// # Errors
    /// `Usage` for a malformed assignment, `Config` for an unknown field or a value that does not fit.
    pub fn set(&mut self, assignment: &str) -> Result<()> {
        let (field, text) = assignment
            .split_once('=')
            .ok_or_else(|| Error::usage(format!("--set {assignment}: write field=value")))?;
        let value: Value = serde_json::from_str(text).unwrap_or_else(|_| Value::String(text.into()));
        let mut tree = serde_json::to_value(&*self).map_err(|e| Error::config(field, e))?;
        let pointer = format!("/{}", field.replace('.', "/"));
        match tree.pointer_mut(&pointer) {
            Some(place) => *place = value,
            None => return Err(Error::config(field, "no such field; `neumip train --help` shows how presets look")),
        }
        *self = serde_json::from_value(tree).map_err(|e| Error::config(field, e))?;
        Ok(())
    }
}

impl TrainConfig {
    /// Checks every bound.
    ///
    /// # Errors
    /// `Config`, naming the field.
    pub fn validate(&self) -> Result<()> {
        let fail = |field: &str, problem: String| Err(Error::config(format!("train.{field}"), problem));
        let finite_positive = |value: f64| value.is_finite() && value > 0.0;
        let share = |value: f64| (0.0..=1.0).contains(&value);
        match self.budget {
            Budget::Steps(0) | Budget::Samples(0) => return fail("budget", "must be positive".into()),
            Budget::Minutes(m) if !finite_positive(m) => return fail("budget", "must be positive".into()),
            _ => {}
        }
        if !self.piece.is_power_of_two() || !(1..=1024).contains(&self.piece) {
            return fail("piece", format!("{} is not a power of two from 1 to 1024", self.piece));
        }
        let samples = self.piece * self.piece;
        if self.batch == 0 || !self.batch.is_multiple_of(samples) || self.batch > 1 << 24 {
            return fail("batch", format!("{} is not a multiple of piece^2 = {samples} (up to 2^24)", self.batch));
        }
        let rate = &self.learning_rate;
        if !finite_positive(rate.peak) {
            return fail("learning_rate.peak", format!("{} is not positive", rate.peak));
        }
        if !(0.0..1.0).contains(&rate.warmup) {
            return fail("learning_rate.warmup", format!("{} is not in [0, 1)", rate.warmup));
        }
        if let Decay::Cosine { floor } | Decay::Exponential { floor } = rate.decay
            && !(floor > 0.0 && floor <= 1.0)
        {
            return fail("learning_rate.decay.floor", format!("{floor} is not in (0, 1]"));
        }
        let adam = &self.adam;
        if !(0.0..1.0).contains(&adam.beta1) || !(0.0..1.0).contains(&adam.beta2) || !finite_positive(adam.epsilon) {
            return fail("adam", "beta1 and beta2 must be in [0, 1), epsilon positive".into());
        }
        if let Some(s) = &self.smoothing {
            let all = [s.start, s.rate, s.minimum, s.skip_below, s.offset_minimum];
            if all.iter().any(|v| !v.is_finite() || *v < 0.0 || *v > 1e3) || s.start <= 0.0 {
                return fail("smoothing", "every value must be in 0 to 1000, start above 0".into());
            }
        }
        if let Some(b) = &self.blend
            && !(share(b.until) && share(b.amount) && share(b.every) && b.every > 0.0 && finite_positive(b.sigma))
        {
            return fail("blend", "until, every and amount must be in [0, 1], every and sigma above 0".into());
        }
        if self.offset_freeze.is_some_and(|f| !share(f)) {
            return fail("offset_freeze", "must be in [0, 1]".into());
        }
        let [low, high] = self.target_range;
        if !(low.is_finite() && high.is_finite() && low < high) {
            return fail("target_range", "must be [low, high] with low < high".into());
        }
        if self.validations == 0 {
            return fail("validations", "at least one is needed".into());
        }
        let stages = self.stages.resolve()?;
        if stages.is_empty() {
            return fail("stages", "at least one stage is needed".into());
        }
        for (i, stage) in stages.iter().enumerate() {
            if !(stage.share > 0.0 && stage.share <= 1.0) {
                return fail(&format!("stages[{i}].share"), format!("{} is not in (0, 1]", stage.share));
            }
            if stage.terms.is_empty() {
                return fail(&format!("stages[{i}].terms"), "at least one term is needed".into());
            }
            for (j, term) in stage.terms.iter().enumerate() {
                if !finite_positive(term.weight) {
                    return fail(&format!("stages[{i}].terms[{j}].weight"), format!("{} is not positive", term.weight));
                }
                if let Remap::Root4Signed(e) | Remap::Sqrt(e) = term.remap
                    && !finite_positive(e)
                {
                    return fail(&format!("stages[{i}].terms[{j}].remap"), format!("epsilon {e} is not positive"));
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_valid_and_round_trip() {
        for name in PRESETS {
            let config = Config::preset(name).unwrap();
            config.train.validate().unwrap();
            let text = serde_json::to_string(&config).unwrap();
            assert_eq!(serde_json::from_str::<Config>(&text).unwrap(), config);
            neumip_export::config::Architecture::new(config.model, [128, 128]).unwrap();
        }
    }

    #[test]
    fn named_schedules_are_valid() {
        let mut config = Config::preset("paper").unwrap();
        for name in ["s1", "s2", "s3"] {
            config.set(&format!("train.stages={name}")).unwrap();
            config.train.validate().unwrap();
            let shares: f64 = config.train.stages.resolve().unwrap().iter().map(|s| s.share).sum();
            assert_eq!(shares, 1.0);
        }
        config.set("train.stages=s9").unwrap();
        assert!(config.train.validate().is_err());
    }

    #[test]
    fn overrides_reach_any_field_and_name_what_is_wrong() {
        let mut config = Config::preset("neumip").unwrap();
        config.set("model.texture.channels=12").unwrap();
        assert_eq!(config.model.texture.channels, 12);
        assert!(config.set("model.texture.chanels=12").unwrap_err().to_string().contains("chanels"));
        assert!(config.set("train.batch=many").is_err());
        config.set("train.batch=100").unwrap();
        assert!(config.train.validate().unwrap_err().to_string().contains("train.batch"));
    }

    #[test]
    fn neumip_smoothing_follows_the_published_schedule() {
        let smoothing = Config::preset("neumip").unwrap().train.smoothing.unwrap();
        // 8 * 8^(-t / 10000) at iteration 10000 of 30000 is one texel.
        assert!((smoothing.sigma(1.0 / 3.0) - 1.0).abs() < 1e-12);
        assert_eq!(smoothing.sigma(1.0), 0.1);
    }
}
