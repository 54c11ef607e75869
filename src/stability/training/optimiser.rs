//! Learning rates that are too high, and how much a seed decides.

use crate::dataset::SplitName;
use crate::error::Result;
use crate::report::figures::Series;
use crate::stability::probe::{Bound, Group, Outcome, Plot, Probe};
use crate::stability::variants::CONSTANT;
use crate::stability::workshop::{Workshop, error_of_the_mean, split_errors};

/// Learning rates over that of `improved`; the quick suite takes the first and the last.
const FACTORS: [f64; 5] = [1.0, 2.0, 5.0, 20.0, 10.0];
/// The highest learning rate of `improved`.
const PEAK: f64 = 0.006;
/// What a high rate needs: no step moves a matrix by more than this share of its size.
const CAREFUL: [&str; 1] = ["train.clip=0.03"];
const CARELESS: [&str; 3] = ["train.clip=null", "train.learning_rate.warmup=0.0", CONSTANT];
/// Five times the usual rate: too high for some seeds and not for others.
const HIGH: &str = "train.learning_rate.peak=0.03";

pub(super) fn probes() -> Vec<Probe> {
    vec![
        Probe {
            name: "learning-rate-x10",
            group: Group::Training,
            provokes: "A learning rate ten times too high throws networks into corners from which they do not come back.",
            naive: "rate x 10 from the first to the last step",
            cured: "the same rate with warm-up, cosine and `train.clip` = 0.03",
            figure: "share of what training gains over answering with the mean that is lost beside the usual rate, `mse` on the \
                     test split",
            bound: Bound::new(0.5, "a wrong guess of the rate may cost accuracy, but not the training"),
            run: rates,
        },
        Probe {
            name: "seed-spread",
            group: Group::Training,
            provokes: "Where a seed decides more than a method, comparisons of methods are dice.",
            naive: "a constant rate of 0.03, five times that of `improved`, without bounds: the ReLUs of some seeds die",
            cured: "`improved`",
            figure: "share of what training gains over answering with the mean that the worst seed loses beside the best seed of \
                     `improved`, `mse` on the test split",
            bound: Bound::new(0.3, "a seed may cost something, not a third of what is learnt"),
            run: seeds,
        },
    ]
}

fn rates(workshop: &mut Workshop) -> Result<Outcome> {
    let material = workshop.scale().glossy().to_string();
    let data = workshop.data(&material)?;
    let usual = workshop.train(&material, "improved", &[])?;
    let usual = split_errors(&usual.sound()?.material, &data, SplitName::Test)?.mse;
    let nothing = error_of_the_mean(&data, SplitName::Test)?;
    let quick = workshop.scale().is_quick();
    let mut figures = [f64::NAN; 2];
    let mut series = Vec::new();
    let variants = [("careless", &CARELESS[..]), ("careful", &CAREFUL[..])];
    for (k, (name, set)) in variants.into_iter().enumerate() {
        let mut points = Vec::new();
        for factor in FACTORS.into_iter().skip(if quick { FACTORS.len() - 1 } else { 0 }) {
            let peak = format!("train.learning_rate.peak={}", PEAK * factor);
            let set: Vec<&str> = set.iter().copied().chain([peak.as_str()]).collect();
            let trained = workshop.train(&material, "improved", &set)?;
            let mse = match trained.model() {
                Some(model) => {
                    let mse = split_errors(&model.material, &data, SplitName::Test)?.mse;
                    ((mse - usual) / (nothing - usual)).max(0.0)
                }
                None => f64::NAN,
            };
            points.push((factor, mse));
            figures[k] = mse;
        }
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        series.push(Series { name: name.into(), points });
    }
    let plot =
        Plot { x: "learning rate over the usual".into(), y: "share of the gain that is lost".into(), series };
    Ok(Outcome { plot: Some(plot), ..Outcome::new(figures[0], figures[1]) })
}

fn seeds(workshop: &mut Workshop) -> Result<Outcome> {
    let material = workshop.scale().glossy().to_string();
    let data = workshop.data(&material)?;
    let mut series = Vec::new();
    let careless: Vec<&str> = CARELESS.into_iter().chain([HIGH]).collect();
    for (name, set) in [("careless", &careless[..]), ("improved", &[])] {
        let mut points = Vec::new();
        for seed in 1..=workshop.scale().seeds {
            let seeded = format!("train.seed={seed}");
            let set: Vec<&str> = set.iter().copied().chain([seeded.as_str()]).collect();
            let trained = workshop.train(&material, "improved", &set)?;
            let mse = split_errors(&trained.sound()?.material, &data, SplitName::Test)?.mse;
            points.push((seed as f64, mse));
        }
        series.push(Series { name: name.into(), points });
    }
    let nothing = error_of_the_mean(&data, SplitName::Test)?;
    let values = |line: &Series| -> Vec<f64> { line.points.iter().map(|p| p.1).collect() };
    let best = values(&series[1]).into_iter().fold(f64::INFINITY, f64::min);
    let lost: Vec<f64> = series.iter().map(|line| worst(&values(line), best, nothing)).collect();
    let spread = spread(&series[1].points);
    let plot = Plot { x: "seed".into(), y: "mse, test".into(), series };
    let values = vec![("largest less least `mse` of `improved` over their mean".into(), spread)];
    Ok(Outcome { plot: Some(plot), values, ..Outcome::new(lost[0], lost[1]) })
}

/// What the worst of several errors loses of the gain that the best one has over learning nothing.
fn worst(errors: &[f64], best: f64, nothing: f64) -> f64 {
    let worst = errors.iter().copied().fold(best, |a, b| if b <= a { a } else { b });
    (worst - best) / (nothing - best)
}

/// Largest less least over the mean.
fn spread(points: &[(f64, f64)]) -> f64 {
    let values = points.iter().map(|p| p.1);
    let mean = values.clone().sum::<f64>() / points.len() as f64;
    (values.clone().fold(f64::MIN, f64::max) - values.fold(f64::MAX, f64::min)) / mean
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dead_seed_loses_everything() {
        assert_eq!(worst(&[2.0, 4.0, 3.0], 2.0, 4.0), 1.0);
        assert_eq!(worst(&[2.0, 2.5, 3.0], 2.0, 4.0), 0.5);
        assert!(worst(&[2.0, f64::NAN], 2.0, 4.0).is_nan());
    }
}
