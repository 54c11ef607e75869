//! Tuning: the same trials for every preset, judged on the validation split.

use crate::config::{Config, Decay, Remap, StagePlan};
use crate::error::Result;
use crate::random::{Random, Stream};
use crate::results::Trial;
use serde_json::json;
use std::collections::BTreeMap;

/// Factors on the learning rate.
const RATES: [f64; 7] = [0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0];
/// Factors on the weights of every term of the loss but the first.
const WEIGHTS: [f64; 5] = [0.1, 0.3, 1.0, 3.0, 10.0];
/// Factors on the epsilon of roots.
const EPSILONS: [f64; 3] = [0.1, 1.0, 10.0];
/// How the learning rate falls.
const DECAYS: [Decay; 4] = [
    Decay::Cosine { floor: 0.01 },
    Decay::Cosine { floor: 0.1 },
    Decay::Exponential { floor: 0.01 },
    Decay::Constant {},
];

/// The settings of trial `index`: number 0 is the preset as it is; the others draw the same factors whatever the
/// preset, so that none is tuned better than another. Where a preset has no second term or no epsilon, its draw is
/// without effect.
pub fn settings(config: &Config, index: usize, seed: u64) -> Vec<String> {
    if index == 0 {
        return Vec::new();
    }
    let mut random = Random::new(seed, Stream::Trials, index as u64);
    let mut pick = |n: usize| random.below(n);
    let (rate, decay) = (RATES[pick(RATES.len())], DECAYS[pick(DECAYS.len())]);
    let (weight, epsilon) = (WEIGHTS[pick(WEIGHTS.len())], EPSILONS[pick(EPSILONS.len())]);
    let mut set = vec![
        format!("train.learning_rate.peak={}", config.train.learning_rate.peak * rate),
        format!("train.learning_rate.decay={}", json!(decay)),
    ];
    let StagePlan::List(stages) = &config.train.stages else { return set };
    for (s, stage) in stages.iter().enumerate() {
        for (t, term) in stage.terms.iter().enumerate() {
            if t > 0 && weight != 1.0 {
                set.push(format!("train.stages.{s}.terms.{t}.weight={}", term.weight * weight));
            }
            let remap = match term.remap {
                Remap::Root4Signed(e) => Remap::Root4Signed(e * epsilon),
                Remap::Sqrt(e) => Remap::Sqrt(e * epsilon),
                other => other,
            };
            if remap != term.remap {
                set.push(format!("train.stages.{s}.terms.{t}.remap={}", json!(remap)));
            }
        }
    }
    set
}

/// The trial with the lowest geometric mean of `mse` over the materials that every trial was run on; none where no trial
/// was.
pub fn best<'a>(trials: impl IntoIterator<Item = &'a Trial>, materials: &[String]) -> Option<usize> {
    let mut sums: BTreeMap<usize, (f64, usize)> = BTreeMap::new();
    for trial in trials {
        let mse = trial.mse.filter(|mse| mse.is_finite() && *mse > 0.0);
        if let Some(mse) = mse.filter(|_| materials.contains(&trial.material)) {
            let (sum, n) = sums.entry(trial.index).or_default();
            (*sum, *n) = (*sum + mse.ln(), *n + 1);
        }
    }
    let complete = sums.into_iter().filter(|(_, (_, n))| *n == materials.len());
    complete.min_by(|(_, a), (_, b)| a.0.total_cmp(&b.0)).map(|(index, _)| index)
}

/// Sets the fields of a trial that the configuration has: a variant may have changed what the preset's trial set.
///
/// # Errors
/// As [`Config::set`].
pub fn apply(config: &mut Config, set: &[String]) -> Result<()> {
    set.iter().try_for_each(|field| config.set(field))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::PRESETS;

    #[test]
    fn trials_differ_and_can_be_trained() {
        for preset in PRESETS {
            let config = Config::preset(preset).unwrap();
            assert!(settings(&config, 0, 1).is_empty());
            let mut seen = std::collections::BTreeSet::new();
            for index in 1..8 {
                let mut tuned = config.clone();
                apply(&mut tuned, &settings(&config, index, 1)).unwrap();
                tuned.train.validate().unwrap();
                assert_eq!(tuned.model, config.model);
                seen.insert(serde_json::to_string(&tuned.train).unwrap());
            }
            assert!(seen.len() >= 6, "{preset}: {}", seen.len());
        }
    }

    #[test]
    fn the_best_trial_is_the_lowest_on_all_materials() {
        let trial = |index, material: &str, mse| Trial {
            preset: "p".into(),
            material: material.into(),
            regime: "scattered".into(),
            index,
            set: Vec::new(),
            seed: 1,
            samples_per_texel: 1.0,
            mse: Some(mse),
            chosen: false,
        };
        let trials = [
            trial(0, "a", 1.0),
            trial(0, "b", 1.0),
            trial(1, "a", 0.1),
            trial(1, "b", 4.0),
            trial(2, "a", 0.01),
        ];
        let materials = ["a".to_string(), "b".to_string()];
        assert_eq!(best(&trials, &materials), Some(1));
        assert_eq!(best(&trials[..2], &materials), Some(0));
        assert_eq!(best(&trials[4..], &materials), None);
        assert_eq!(best(&[Trial { mse: None, ..trial(3, "a", 1.0) }], &materials[..1]), None);
    }
}
