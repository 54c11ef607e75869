//! Encoded directions: what they cost early, and what they make of few directions.

use crate::dataset::{Dataset, GenerateConfig, Regime, SplitName};
use crate::error::Result;
use crate::evaluate::split_table;
use crate::report::figures::Series;
use crate::stability::probe::{Bound, Group, Outcome, Plot, Probe};
use crate::stability::variants::PRINTED;
use crate::stability::workshop::{Model, Workshop, error_of_the_mean};
use crate::trainer::Progress;

/// Amplitudes of the curve.
const AMPLITUDES: [f64; 4] = [0.1, 0.25, 0.5, 1.0];
/// The amplitude that cured early prototypes.
const GENTLE: f64 = 0.25;
/// Pairs of directions of the probe and, in the full suite, of the curve.
const FEW: usize = 90;
const PAIRS: [usize; 2] = [30, FEW];
/// Training samples on which an error is measured.
const SEEN: u64 = 100_000;

pub(super) fn probes() -> Vec<Probe> {
    vec![
        Probe {
            name: "gamma-on-gloss",
            group: Group::Training,
            provokes: "gamma(wi), gamma(wo) make a glossy material's training collapse early: a highlight moves through all \
                       phases of the finest octave, and the error on training data is as bad as on others.",
            naive: "4 octaves in place of wi and wo, as printed",
            cured: "the directions themselves, as in `improved`",
            figure: "`mse` on training data over that of octaves of amplitude 0.25 beside the directions",
            bound: Bound::new(1.1, "an encoding may not cost more than seeds differ"),
            run: gloss,
        },
        Probe {
            name: "few-directions",
            group: Group::Training,
            provokes: "90 pairs of directions, a whole image each: octaves of wi and wo fit them one by one, and other directions \
                       are answered at random.",
            naive: "4 octaves in place of wi and wo, 90 slices",
            cured: "the same on as many samples in scattered patches, each with a pair of its own",
            figure: "share of what training gains over answering with the mean that the octaves lose, `mse` on the validation \
                     split, whose directions are new, at the end of the run",
            bound: Bound::new(0.75, "an encoding may cost much, not nearly all that is learnt"),
            run: few,
        },
    ]
}

fn gentle(amplitude: f64) -> Vec<String> {
    let mut set = Vec::new();
    for w in ["wi", "wo"] {
        set.push(format!("model.encoding.{w}.bands=4"));
        set.push(format!("model.encoding.{w}.amplitude={amplitude}"));
    }
    set
}

/// `mse` on data that the model has seen.
fn seen(model: &Model, data: &Dataset) -> Result<f64> {
    let rows = split_table(&model.material, data, SplitName::Train, SEEN, None)?;
    Ok(rows.last().map_or(f64::NAN, |row| row.errors.mse))
}

fn gloss(workshop: &mut Workshop) -> Result<Outcome> {
    let material = workshop.scale().glossy().to_string();
    let data = workshop.data(&material)?;
    let mut error = |set: &[&str]| -> Result<f64> {
        let trained = workshop.train(&material, "improved", set)?;
        trained.model().map_or(Ok(f64::NAN), |model| seen(model, &data))
    };
    let printed = error(&PRINTED)?;
    let raw = error(&[])?;
    let mut points = Vec::new();
    for amplitude in AMPLITUDES {
        let set = gentle(amplitude);
        points.push((amplitude, error(&set.iter().map(String::as_str).collect::<Vec<_>>())?));
    }
    let base = points.iter().find(|p| p.0 == GENTLE).map_or(f64::NAN, |p| p.1);
    let level =
        |name: &str, value: f64| Series { name: name.into(), points: vec![(0.0, value), (1.0, value)] };
    let series = vec![
        Series { name: "beside them".into(), points },
        level("in their place", printed),
        level("none", raw),
    ];
    let plot = Plot { x: "amplitude of gamma(wi), gamma(wo)".into(), y: "mse, training data".into(), series };
    Ok(Outcome { plot: Some(plot), ..Outcome::new(printed / base, raw / base) })
}

/// Validation over a run: samples presented a texel, `mse`.
fn course(workshop: &Workshop, progress: &Progress) -> Vec<(f64, f64)> {
    let texels = workshop.scale().texels() as f64;
    progress.validations.iter().map(|point| (point.samples as f64 / texels, point.errors.mse)).collect()
}

fn few(workshop: &mut Workshop) -> Result<Outcome> {
    let material = workshop.scale().glossy().to_string();
    let reference = workshop.reference(&material)?;
    let quick = workshop.scale().is_quick();
    let (mut series, mut values) = (Vec::new(), Vec::new());
    let mut lost = f64::NAN;
    for pairs in PAIRS.into_iter().skip(if quick { PAIRS.len() - 1 } else { 0 }).map(Some).chain([None]) {
        let (name, data) = match pairs {
            Some(pairs) => {
                let config = GenerateConfig {
                    regime: Regime::Slices(pairs),
                    test_pairs: 0,
                    offgrid_samples: 0,
                    grazing_samples: 0,
                    ..workshop.generation()
                };
                let name = format!("{material}-slices-{pairs}");
                (format!("{pairs} slices"), workshop.data_of(&name, &*reference, &config)?)
            }
            None => ("scattered".into(), workshop.data(&material)?),
        };
        let nothing = error_of_the_mean(&data, SplitName::Validation)?;
        let mut ends = Vec::new();
        for (with, set) in [("octaves", &PRINTED[..]), ("directions", &[])] {
            let config = workshop.config("improved", set)?;
            let trained = workshop.train_on(&format!("{material}.improved"), config, &data)?;
            let Some(model) = trained.model() else { continue };
            let points = course(workshop, &model.progress);
            ends.push(points.last().map_or(f64::NAN, |p| p.1));
            if pairs.is_none_or(|pairs| pairs == FEW) {
                series.push(Series { name: format!("{with}, {name}"), points });
            }
        }
        let share = match ends[..] {
            [with, without] => ((with - nothing).min(0.0) - (without - nothing)) / (nothing - without),
            _ => f64::NAN,
        };
        if pairs == Some(FEW) {
            lost = share;
        }
        values.push((name, share));
    }
    let cured = values.last().map_or(f64::NAN, |(_, share)| *share);
    let plot = Plot { x: "samples presented a texel".into(), y: "mse, validation".into(), series };
    Ok(Outcome { plot: Some(plot), values, ..Outcome::new(lost, cured) })
}
