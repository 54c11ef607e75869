//! The search: short trials of many sizes, longer ones of the better half, and so on (successive halving, Jamieson and Talwalkar
//! 2016), until the smallest that reaches the goal is found.
//!
//! Every trial goes on from the weights of the one before, the first from what the full model knew. With a target the cheapest
//! sizes that are on their way to it are kept, and always the best one; without, the best.

use super::candidates::Candidate;
use super::goal::{Goal, Metric};
use crate::error::{Error, Result};
use crate::render::compare::Comparison;
use neumip_export::Tensor;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Candidates of the first rung.
pub const CANDIDATES: usize = 12;
/// Of a full training, the samples of a trial of each rung; half of the candidates are left for the next. The last is the final
/// training.
pub const SHARES: [f64; 4] = [1.0 / 48.0, 1.0 / 24.0, 1.0 / 12.0, 1.0 / 4.0];
/// Finals before the search gives up.
const FINALS: usize = 3;
/// What is hoped to be left of FLIP at the end, by the rung in which it is measured; of squared errors its square. More cautious than
/// the medians of the fits of docs/fit/FIT.md (0.72, 0.84, 0.92): who is hoped of in vain costs a final training.
const HOPE: [f64; 4] = [0.8, 0.9, 0.95, 1.0];

/// Tensors by name.
pub type Tensors = BTreeMap<String, Tensor>;

/// A finished trial.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Trial {
    /// The size, as it is written.
    pub shape: String,
    /// Its rung, from 0.
    pub rung: usize,
    /// Samples presented in it.
    pub samples: u64,
    /// Seconds of training.
    pub seconds: f64,
    /// Bytes in half precision.
    pub bytes: usize,
    /// Expected nanoseconds a query.
    pub ns: f64,
    /// FLIP of the pictures that choices are made on.
    pub flip: Option<f64>,
    /// Squared error of those.
    pub mse: f64,
}

/// What a trial gives.
pub struct Tried {
    /// Its tensors.
    pub tensors: Tensors,
    /// Its pictures' errors, the mean.
    pub errors: Comparison,
    /// Seconds of training.
    pub seconds: f64,
}

/// Who trains and measures a candidate: its place, its rung, its samples, and the tensors that it starts from (none: those of
/// the full model).
pub type Judge<'a> = dyn FnMut(&Candidate, usize, u64, Option<&Tensors>) -> Result<Tried> + 'a;

/// What a search found.
pub struct Found {
    /// The size.
    pub candidate: Candidate,
    /// Its tensors.
    pub tensors: Tensors,
    /// Its pictures' errors.
    pub errors: Comparison,
    /// Every trial.
    pub trials: Vec<Trial>,
    /// Whether the target is held; true without one.
    pub holds: bool,
}

struct Runner {
    candidate: Candidate,
    tensors: Option<Tensors>,
    errors: Option<Comparison>,
    error: f64,
}

/// Searches among `candidates`; `full` is the full model's error in the goal's metric and `samples` what it was presented.
///
/// # Errors
/// What trials meet, but for divergence, which only costs a candidate its place; `Diverged` if all did.
pub fn search(
    candidates: Vec<Candidate>,
    goal: &Goal,
    full: f64,
    samples: u64,
    judge: &mut Judge,
) -> Result<Found> {
    let metric = goal.metric();
    let bound = goal.bound(full);
    let mut trials = Vec::new();
    let start = |candidate| Runner { candidate, tensors: None, errors: None, error: f64::INFINITY };
    let mut runners: Vec<Runner> = candidates.into_iter().map(start).collect();
    let finals = SHARES.len() - 1;
    for rung in 0..finals {
        for runner in &mut runners {
            run(runner, rung, samples, metric, &mut trials, judge)?;
        }
        runners.retain(|runner| runner.error.is_finite());
        order(&mut runners, bound, rung, goal);
        runners.truncate(if rung + 1 == finals { FINALS } else { runners.len().div_ceil(2).max(FINALS) });
    }
    if runners.is_empty() {
        return Err(Error::Diverged("every candidate left the finite numbers; lower --rate".into()));
    }
    let mut best: Option<Runner> = None;
    for mut runner in runners {
        run(&mut runner, finals, samples, metric, &mut trials, judge)?;
        let holds = bound.is_none_or(|bound| runner.error <= bound);
        if best.as_ref().is_none_or(|best| runner.error < best.error || holds) {
            best = Some(runner);
        }
        // Without a bound the order says which is the best; with one, the cheapest that holds it comes first.
        if holds {
            break;
        }
    }
    let held = |runner: &Runner| bound.is_none_or(|bound| runner.error <= bound);
    match best {
        Some(Runner { candidate, tensors: Some(tensors), errors: Some(errors), error }) => {
            let holds = held(&Runner { candidate: candidate.clone(), tensors: None, errors: None, error });
            Ok(Found { candidate, tensors, errors, trials, holds })
        }
        _ => Err(Error::Diverged("every candidate left the finite numbers; lower --rate".into())),
    }
}

/// What is kept of a trial.
pub fn trial_of(candidate: &Candidate, rung: usize, samples: u64, tried: &Tried) -> Trial {
    Trial {
        shape: candidate.shape.to_string(),
        rung,
        samples,
        seconds: tried.seconds,
        bytes: candidate.bytes,
        ns: candidate.ns,
        flip: tried.errors.flip,
        mse: tried.errors.mse,
    }
}

fn run(
    runner: &mut Runner,
    rung: usize,
    samples: u64,
    metric: Metric,
    trials: &mut Vec<Trial>,
    judge: &mut Judge,
) -> Result<()> {
    let presented = (samples as f64 * SHARES[rung]) as u64;
    let tried = match judge(&runner.candidate, rung, presented, runner.tensors.as_ref()) {
        Ok(tried) => tried,
        Err(Error::Diverged(_)) => {
            runner.error = f64::INFINITY;
            return Ok(());
        }
        Err(other) => return Err(other),
    };
    trials.push(trial_of(&runner.candidate, rung, presented, &tried));
    runner.error = metric.of(&tried.errors)?;
    runner.tensors = Some(tried.tensors);
    runner.errors = Some(tried.errors);
    Ok(())
}

/// Those first that are to be kept. With a bound: what is expected to hold it, the cheapest first, then the rest by error; the
/// best of all in the second place at least, as what is left if hopes fail.
fn order(runners: &mut Vec<Runner>, bound: Option<f64>, rung: usize, goal: &Goal) {
    runners.sort_by(|a, b| a.error.total_cmp(&b.error));
    let Some(bound) = bound else { return };
    if runners.is_empty() {
        return;
    }
    let best = runners.remove(0);
    let hope = match goal.metric() {
        Metric::Flip => HOPE[rung],
        Metric::Mse => HOPE[rung] * HOPE[rung],
    };
    let hopeful = |runner: &Runner| runner.error * hope <= bound;
    let cost = |runner: &Runner| runner.candidate.cost(goal.prefer);
    runners.sort_by(|a, b| match (hopeful(a), hopeful(b)) {
        (true, true) => cost(a).total_cmp(&cost(b)),
        (false, false) => a.error.total_cmp(&b.error),
        (a, b) => b.cmp(&a),
    });
    // Among those that hold it the best has its place by cost.
    let place = runners.iter().filter(|r| hopeful(r) && cost(r) < cost(&best)).count();
    runners.insert(if hopeful(&best) { place.min(FINALS - 1) } else { 0 }, best);
}

#[cfg(test)]
mod tests {
    use super::super::shape::Shape;
    use super::*;
    use crate::query::RgbImage;

    fn candidate(width: usize, ns: f64) -> Candidate {
        let shape = Shape { finest: 0, channels: 4, hidden: vec![width], offset: None, bands: 0 };
        Candidate { shape, bytes: 1000 * width, ns, error: 1.0 }
    }

    /// A trial whose pictures differ by `error` from grey.
    fn tried(error: f32) -> Tried {
        let grey = |v: f32| RgbImage { height: 8, width: 8, pixels: vec![[v; 3]; 64] };
        let errors = Comparison::new(&grey(0.5 + error), &grey(0.5), None);
        Tried { tensors: Tensors::new(), errors, seconds: 1.0 }
    }

    fn goal(most: Option<f64>) -> Goal {
        let target = most.map(|most| super::super::goal::Target { metric: Metric::Mse, most: Some(most) });
        Goal { target, ..Goal::FREE }
    }

    /// Errors fall with width and with rungs, as trainings' do.
    fn found(most: Option<f64>, seen: &mut Vec<(usize, usize, u64)>) -> Found {
        let candidates = (1..=12).map(|k| candidate(4 * k, 10.0 + k as f64)).collect();
        let mut judge = |candidate: &Candidate, rung: usize, samples: u64, start: Option<&Tensors>| {
            assert_eq!(start.is_some(), rung > 0);
            let width = candidate.shape.hidden[0];
            seen.push((width, rung, samples));
            Ok(tried(0.4 / width as f32 * (1.0 - 0.05 * rung as f32)))
        };
        search(candidates, &goal(most), 1.0, 48_000, &mut judge).unwrap()
    }

    #[test]
    fn the_smallest_that_holds_the_target_is_found_in_little_time() {
        let mut seen = Vec::new();
        // Width 16 ends at (0.4 / 16 * 0.85)^2 = 4.5e-4, width 12 at 8e-4.
        let found = found(Some(5e-4), &mut seen);
        assert!(found.holds && found.candidate.shape.hidden == [16], "{:?}", found.candidate);
        let presented: u64 = seen.iter().map(|(_, _, samples)| samples).sum();
        assert!(presented < 2 * 48_000, "{presented}");
        assert_eq!(seen.iter().filter(|(_, rung, _)| *rung == 0).count(), 12);
        assert_eq!(seen.iter().filter(|(_, rung, _)| *rung == 1).count(), 6);
        assert_eq!(found.trials.len(), seen.len());
    }

    #[test]
    fn without_a_target_the_best_wins_and_a_target_too_far_is_not_held() {
        let best = found(None, &mut Vec::new());
        assert!(best.holds && best.candidate.shape.hidden == [48]);
        let near = found(Some(1e-6), &mut Vec::new());
        assert!(!near.holds && near.candidate.shape.hidden == [48]);
    }

    #[test]
    fn what_diverges_loses_its_place() {
        let candidates = (1..=4).map(|k| candidate(4 * k, 10.0)).collect();
        let mut judge =
            |candidate: &Candidate, _: usize, _: u64, _: Option<&Tensors>| match candidate.shape.hidden[0] {
                16 => Err(Error::Diverged("not a number".into())),
                width => Ok(tried(0.4 / width as f32)),
            };
        let found = search(candidates, &goal(None), 1.0, 48_000, &mut judge).unwrap();
        assert_eq!(found.candidate.shape.hidden, [12]);
    }
}
