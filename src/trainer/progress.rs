//! What a run has done so far: the part of its state that is not a tensor.

use crate::config::{Config, Stage};
use crate::metrics::Errors;
use serde::{Deserialize, Serialize};
use serde_json::json;

/// One validation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Point {
    /// Steps done.
    pub step: u64,
    /// Samples presented.
    pub samples: u64,
    /// Seconds of training.
    pub seconds: f64,
    /// Validation errors.
    pub errors: Errors,
}

/// Progress of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Progress {
    /// Steps done.
    pub step: u64,
    /// Samples presented.
    pub samples: u64,
    /// Seconds of training, validations included.
    pub seconds: f64,
    /// Share of the budget used.
    pub fraction: f64,
    /// Index of the stage of the losses.
    pub stage: usize,
    /// Share of the run at which that stage began.
    pub stage_began: f64,
    /// Lowest validation error of the stage, and validations since.
    stage_best: Option<f64>,
    stage_stale: usize,
    /// Best validation of the last stage that has any.
    pub best: Option<Point>,
    /// All validations.
    pub validations: Vec<Point>,
    /// Mean training loss over intervals: (steps done, loss).
    pub losses: Vec<(u64, f64)>,
    loss_sum: f64,
    loss_count: u64,
}

impl Progress {
    /// Adds one step's loss to the curve, which gets a point every `interval` steps.
    pub(super) fn add_loss(&mut self, loss: f64, interval: u64) {
        self.loss_sum += loss;
        self.loss_count += 1;
        if self.loss_count >= interval {
            self.losses.push((self.step, self.loss_sum / self.loss_count as f64));
            (self.loss_sum, self.loss_count) = (0.0, 0);
        }
    }

    /// Records a validation; true if it is the best so far. The first one of a later stage is, whatever came before: a
    /// stage may keep the mean of noisy data where the one before it was nearer by `mse` and too dark.
    pub(super) fn add_validation(&mut self, errors: Errors, stages: &[Stage]) -> (Point, bool) {
        let point = Point { step: self.step, samples: self.samples, seconds: self.seconds, errors };
        self.validations.push(point);
        let mse = errors.mse;
        let first_of_stage = self.stage > 0 && self.stage_best.is_none();
        let best = first_of_stage || self.best.is_none_or(|b| mse < b.errors.mse);
        if best {
            self.best = Some(point);
        }
        let improvement = stages[self.stage].plateau.map_or(0.0, |p| p.improvement);
        if self.stage_best.is_none_or(|b| mse < b * (1.0 - improvement)) {
            self.stage_best = Some(mse);
            self.stage_stale = 0;
        } else {
            self.stage_stale += 1;
        }
        (point, best)
    }

    /// Goes to the next stage when this one's share is used up or its plateau is reached; the last one stays.
    /// True if it went on.
    pub(super) fn advance_stage(&mut self, stages: &[Stage]) -> bool {
        let stage = &stages[self.stage];
        let over = self.fraction - self.stage_began >= stage.share - 1e-12;
        let stale = stage.plateau.is_some_and(|p| self.stage_stale >= p.patience);
        let goes_on = (over || stale) && self.stage + 1 < stages.len();
        if goes_on {
            self.stage += 1;
            self.stage_began = self.fraction;
            (self.stage_best, self.stage_stale) = (None, 0);
        }
        goes_on
    }

    /// What a checkpoint says of its training.
    pub(super) fn provenance(&self, config: &Config, data: &str) -> serde_json::Value {
        json!({
            "data": data,
            "seed": config.train.seed,
            "steps": self.step,
            "samples": self.samples,
            "train": config.train,
        })
    }

    /// The newest validation errors, for the checkpoint's error table.
    pub(super) fn latest_errors(&self) -> serde_json::Value {
        match self.validations.last() {
            Some(point) => json!({ "validation": point.errors }),
            None => serde_json::Value::Null,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Plateau, Remap, Term, TermKind};
    use crate::metrics::ErrorSum;

    fn stage(share: f64, plateau: Option<Plateau>) -> Stage {
        Stage { share, plateau, terms: vec![Term { kind: TermKind::L1, remap: Remap::Linear, weight: 1.0 }] }
    }

    fn errors(value: f32) -> Errors {
        let mut sum = ErrorSum::default();
        sum.add(&[[value; 3]], &[[0.0; 3]]);
        sum.errors()
    }

    #[test]
    fn fixed_stages_follow_their_shares() {
        let stages = [stage(0.25, None), stage(0.5, None), stage(0.25, None)];
        let mut progress = Progress::default();
        let mut seen = Vec::new();
        for i in 1..=100 {
            progress.fraction = f64::from(i) / 100.0;
            progress.advance_stage(&stages);
            seen.push(progress.stage);
        }
        assert_eq!((seen[23], seen[24], seen[73], seen[74], seen[99]), (0, 1, 1, 2, 2));
    }

    #[test]
    fn a_later_stage_has_a_best_of_its_own() {
        let stages = [stage(0.5, None), stage(0.5, None)];
        let mut progress = Progress::default();
        let mut best = Vec::new();
        for value in [0.3, 0.2, 0.4, 0.35, 0.38] {
            progress.fraction += 0.25;
            best.push(progress.add_validation(errors(value), &stages).1);
            progress.advance_stage(&stages);
        }
        assert_eq!(best, [true, true, true, true, false]);
    }

    #[test]
    fn a_plateau_ends_a_stage_early_and_progress_does_not() {
        let plateau = Some(Plateau { patience: 2, improvement: 0.1 });
        for (values, expected) in [([0.5, 0.49, 0.49], 1), ([0.5, 0.4, 0.3], 0)] {
            let stages = [stage(0.9, plateau), stage(0.1, None)];
            let mut progress = Progress::default();
            for value in values {
                progress.fraction += 0.01;
                progress.add_validation(errors(value), &stages);
                progress.advance_stage(&stages);
            }
            assert_eq!(progress.stage, expected);
        }
    }
}
