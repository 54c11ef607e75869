//! How a model is trained: the structs behind a preset's `train` object, the command line and the run's record.

mod schedule;
mod stages;

pub use schedule::{AdamConfig, Blend, Budget, Decay, LearningRate, Smoothing};
pub use stages::{Plateau, Remap, Stage, StagePlan, Term, TermKind};

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
    /// Bounds how far the networks move in a step: the learning rate of a weight matrix or bias is at most this share of
    /// its root mean square. Absent: no bound. With 0.02 to 0.03 a learning rate ten times too high trains about as well
    /// as the right one; without it, its ReLUs die.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clip: Option<f64>,
    /// Gaussian smoothing of the textures while training.
    pub smoothing: Option<Smoothing>,
    /// Steps between two updates of the textures; the networks are updated at every one. Smoothing, its adjoint and Adam
    /// touch every texel, whatever the batch: between updates texels' gradients are added up, as those of a batch so many
    /// times as large would be. `null`: so that an update sees a quarter of a sample a texel.
    #[serde(default)]
    pub texture_every: Option<u64>,
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
    /// What computes the steps; absent: fused on the CPU, candle on other devices.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub engine: Option<EngineKind>,
}

/// What computes steps and answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum EngineKind {
    /// Fused kernels; CPU only.
    Fused,
    /// candle's graph, on any device.
    Candle,
}

/// Most steps between two updates of the textures.
const MOST_EVERY: u64 = 4096;

/// Names of the built-in presets.
pub const PRESETS: [&str; 5] = ["neumip", "paper", "improved", "inception", "inception-small"];

impl Config {
    /// A built-in preset by name, or a preset file.
    ///
    /// # Errors
    /// `Usage` for an unknown name, `File` for an unreadable or malformed file.
    pub fn preset(name: &str) -> Result<Self> {
        let text = match name {
            "neumip" => include_str!("../presets/neumip.json").to_string(),
            "paper" => include_str!("../presets/paper.json").to_string(),
            "improved" => include_str!("../presets/improved.json").to_string(),
            "inception" => include_str!("../presets/inception.json").to_string(),
            "inception-small" => include_str!("../presets/inception-small.json").to_string(),
            path if path.ends_with(".json") => std::fs::read_to_string(path)
                .map_err(|e| Error::file(path, format!("cannot read preset: {e}")))?,
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
        let unknown = || Error::config(field, "no such field; src/presets shows how presets look");
        let (parent, name) = field.rsplit_once('.').ok_or_else(unknown)?;
        let pointer = format!("/{}", parent.replace('.', "/"));
        match tree.pointer_mut(&pointer) {
            // A field that is left out by default is inserted; one that does not exist is refused when read back.
            Some(Value::Object(fields)) => {
                fields.insert(name.into(), value);
            }
            Some(Value::Array(items)) => {
                *name.parse().ok().and_then(|i: usize| items.get_mut(i)).ok_or_else(unknown)? = value;
            }
            _ => return Err(unknown()),
        }
        *self = serde_json::from_value(tree).map_err(|e| Error::config(field, e))?;
        Ok(())
    }
}

impl TrainConfig {
    /// Steps between two updates of the textures of a tile of \[height, width\] texels.
    pub fn texture_every(&self, resolution: [usize; 2]) -> u64 {
        let texels = (resolution[0] * resolution[1]) as u64;
        self.texture_every.unwrap_or_else(|| (texels / (4 * self.batch.max(1) as u64)).clamp(1, MOST_EVERY))
    }

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
            return fail(
                "batch",
                format!("{} is not a multiple of piece^2 = {samples} (up to 2^24)", self.batch),
            );
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
        if !(0.0..1.0).contains(&adam.beta1)
            || !(0.0..1.0).contains(&adam.beta2)
            || !finite_positive(adam.epsilon)
        {
            return fail("adam", "beta1 and beta2 must be in [0, 1), epsilon positive".into());
        }
        if let Some(clip) = self.clip
            && !finite_positive(clip)
        {
            return fail(
                "clip",
                format!("{clip} is not positive; 0.02 to 0.03 works, leave it out for no bound"),
            );
        }
        if let Some(s) = &self.smoothing {
            let all = [s.start, s.rate, s.minimum, s.skip_below, s.offset_minimum];
            if all.iter().any(|v| !v.is_finite() || *v < 0.0 || *v > 1e3) || s.start <= 0.0 {
                return fail("smoothing", "every value must be in 0 to 1000, start above 0".into());
            }
        }
        if let Some(every) = self.texture_every
            && !(1..=MOST_EVERY).contains(&every)
        {
            return fail("texture_every", format!("{every} is outside 1 to {MOST_EVERY}"));
        }
        if let Some(b) = &self.blend
            && !(share(b.until)
                && share(b.amount)
                && share(b.every)
                && b.every > 0.0
                && finite_positive(b.sigma))
        {
            return fail(
                "blend",
                "until, every and amount must be in [0, 1], every and sigma above 0".into(),
            );
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
        stages.iter().enumerate().try_for_each(|(i, stage)| stage.validate(&format!("train.stages[{i}]")))
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
        config.set("model.texture.levels=3").unwrap();
        assert_eq!(config.model.texture.levels, Some(3));
        config.set("train.level_dropout.0=2").unwrap();
        assert_eq!(config.train.level_dropout[0], Some(2));
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
