//! The 4th root of the gradient loss: below 0 it is no number, at 0 its slope has none.

use crate::config::Remap;
use crate::error::Result;
use crate::loss::remap;
use crate::report::figures::Series;
use crate::stability::probe::{Bound, Group, Outcome, Plot, Probe};
use crate::stability::workshop::{Trained, Workshop};
use candle_core::{Device, Tensor, Var};

/// Predictions around 0 at which remaps are looked at: a new network answers about so much on both sides.
const AROUND: f32 = 0.1;
/// Steps of the sweep on each side.
const STEPS: i32 = 500;
/// epsilon of the signed root, as `improved` has it.
const EPSILON: f64 = 1e-3;
/// Slopes at 0.
const STEEPEST: f64 = 100.0;
/// A prediction that is wrong by so little below 0 should be pulled up.
const BELOW: f32 = -0.01;
/// A pull that counts: a hundredth of what L1 would give.
const PULL: f64 = 0.01;

/// The literal root, in a whole configuration.
const LITERAL: [&str; 2] =
    ["train.stages.0.terms.0.remap=root4-literal", "train.stages.0.terms.1.remap=root4-literal"];

pub(super) fn probes() -> Vec<Probe> {
    vec![
        Probe {
            name: "root-below-zero",
            group: Group::Training,
            provokes: "A network's first answers are on both sides of 0, where the 4th root of the paper is no number: the loss \
                       is none at the first step.",
            naive: "4th root as printed",
            cured: "signed root with epsilon 1e-3",
            figure: "share of predictions in -0.1 to 0.1 whose remapped value or slope is no number, or 1 if training diverges",
            bound: Bound::new(0.0, "one such value ends a training"),
            run: below_zero,
        },
        Probe {
            name: "root-slope",
            group: Group::Training,
            provokes: "The root's slope grows without bound towards 0: dark texels get gradients that drown all others, and at 0 \
                       none.",
            naive: "4th root guarded at 1e-7 (authors' code)",
            cured: "signed root with epsilon 1e-3",
            figure: "steepest slope for predictions in -0.1 to 0.1",
            bound: Bound::new(STEEPEST, "a dark texel counts at most as much as a hundred bright ones"),
            run: slope,
        },
        Probe {
            name: "root-dead-zone",
            group: Group::Training,
            provokes: "A guarded root is flat below its guard: where all answers are negative nothing pulls them up.",
            naive: "4th root guarded at 1e-7 (authors' code)",
            cured: "signed root with epsilon 1e-3",
            figure: "1 if a prediction of -0.01 whose target is 0.5 feels no pull, else 0",
            bound: Bound::new(0.0, "every wrong answer must be able to learn"),
            run: dead_zone,
        },
    ]
}

/// Values and slopes of a remap at predictions.
fn looked(remapped: Remap, x: &[f32]) -> Result<(Vec<f32>, Vec<f32>)> {
    let variable = Var::from_slice(x, x.len(), &Device::Cpu)?;
    let values = remap::apply(variable.as_tensor(), remapped)?;
    let slopes = values.sum_all()?.backward()?;
    let slopes = match slopes.get(&variable) {
        Some(slopes) => slopes.to_vec1()?,
        None => Tensor::zeros_like(variable.as_tensor())?.to_vec1()?,
    };
    Ok((values.to_vec1()?, slopes))
}

fn sweep() -> Vec<f32> {
    (-STEPS..=STEPS).map(|k| AROUND * k as f32 / STEPS as f32).collect()
}

fn below_zero(workshop: &mut Workshop) -> Result<Outcome> {
    let mut figure = |remapped: Remap, set: &[&str]| -> Result<(f64, Option<String>)> {
        let x = sweep();
        let (values, slopes) = looked(remapped, &x)?;
        let bad = values.iter().zip(&slopes).filter(|(v, s)| !(v.is_finite() && s.is_finite())).count();
        let material = workshop.scale().glossy().to_string();
        match workshop.train(&material, "improved", set)? {
            Trained::Diverged(problem) => Ok((1.0, Some(problem))),
            Trained::Model(_) => Ok((bad as f64 / x.len() as f64, None)),
        }
    };
    let (naive, problem) = figure(Remap::Root4Literal, &LITERAL)?;
    let (cured, _) = figure(Remap::Root4Signed(EPSILON), &[])?;
    // Where the run is kept is of no use to a reader of the report.
    let notes = problem.map(|problem| {
        let cause = problem.split("; the last good state").next().unwrap_or_default();
        format!("What the naive training says: {cause}")
    });
    Ok(Outcome { notes: notes.into_iter().collect(), ..Outcome::new(naive, cured) })
}

fn slope(_: &mut Workshop) -> Result<Outcome> {
    let x = sweep();
    let variants = [
        ("printed", Remap::Root4Literal),
        ("guarded", Remap::Root4Guarded),
        ("signed", Remap::Root4Signed(EPSILON)),
    ];
    let mut series = Vec::new();
    let mut steepest = Vec::new();
    for (name, remapped) in variants {
        // Powers of ten as well: a guard is narrower than the sweep's step.
        let fine = (0..60).map(|k| 10f32.powf(-9.0 + k as f32 / 7.5));
        let x: Vec<f32> = x.iter().copied().chain(fine).collect();
        let (_, slopes) = looked(remapped, &x)?;
        steepest.push(slopes.iter().fold(0.0f64, |most, s| most.max(f64::from(s.abs()))));
        let points = x.iter().zip(&slopes).filter(|(x, _)| (-0.02..=0.02).contains(*x));
        let mut points: Vec<(f64, f64)> = points.map(|(x, s)| (f64::from(*x), f64::from(*s))).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        series.push(Series { name: name.into(), points });
    }
    let plot = Plot { x: "prediction".into(), y: "slope of the remap".into(), series };
    Ok(Outcome { plot: Some(plot), ..Outcome::new(steepest[1], steepest[2]) })
}

fn dead_zone(_: &mut Workshop) -> Result<Outcome> {
    let stuck = |remapped| -> Result<f64> {
        let (_, slopes) = looked(remapped, &[BELOW])?;
        Ok(f64::from(!slopes.iter().all(|s| f64::from(*s) > PULL)))
    };
    Ok(Outcome::new(stuck(Remap::Root4Guarded)?, stuck(Remap::Root4Signed(EPSILON))?))
}
