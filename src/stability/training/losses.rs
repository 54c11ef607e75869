//! What losses do to ordinary, noisy and spoilt data.

use super::sources::{Spoilt, noise};
use crate::dataset::{Dataset, SplitName};
use crate::error::Result;
use crate::query::Reflectance;
use crate::report::figures::Series;
use crate::stability::probe::{Bound, Group, Outcome, Plot, Probe};
use crate::stability::variants::{L1, ROOTS};
use crate::stability::workshop::{Workshop, split_errors};

/// Losses as `--set train.stages=` takes them.
const L2: &str = r#"train.stages=[{"share":1,"terms":[{"kind":"l2","remap":"linear","weight":1}]}]"#;
/// What bounds fireflies.
const CLAMPED: &str = "train.target_range=[0,10]";
/// Weights of the gradient term; the first is none, the last the printed one.
const WEIGHTS: [f64; 6] = [0.0, 0.003, 0.01, 0.03, 0.3, 1.0];
/// The weight in `improved`.
const PAYS: f64 = 0.03;
/// Samples of the noisiest estimates, and of the others of the curve.
const NOISIEST: usize = 1;
const QUIETER: [usize; 2] = [4, 16];
/// One sample in so many is an outlier.
const RARE: usize = 500;
/// Samples over which means are taken.
const LOOKED_AT: usize = 400_000;
/// Outliers are as bright as this and up to ten times brighter.
const BRIGHT: f32 = 100.0;

pub(super) fn probes() -> Vec<Probe> {
    vec![
        Probe {
            name: "gradient-weight",
            group: Group::Training,
            provokes: "The gradient loss is added to L1 with weight 1 in print. A Sobel response is up to 8 times a difference, \
                       squared and on 4th roots: it drowns L1.",
            naive: "weight 1, as printed",
            cured: "weight 0.03, as in `improved`",
            figure: "`mse` on the test split over that of the same training without the gradient term",
            bound: Bound::new(
                1.1,
                "a term that is there to gain accuracy may not cost more than seeds differ",
            ),
            run: gradient_weight,
        },
        Probe {
            name: "noisy-targets",
            group: Group::Training,
            provokes: "Training data are noisy. L1 finds the median of what a query gave, L2 of 4th roots the 4th power of the \
                       mean root: both are below the mean where noise has a long tail.",
            naive: "L1",
            cured: "`improved`, whose last stage is `l2-mean`",
            figure: "relative error of the mean of all answers, trained on one exponential sample a query",
            bound: Bound::new(0.02, "as for levels: two hundredths of the brightness are hardly seen"),
            run: noisy_targets,
        },
        Probe {
            name: "outliers",
            group: Group::Training,
            provokes: "One sample in 500 is a firefly, 100 to 1000 bright, beside zeros. Squared errors learn nothing else, and \
                       what keeps the mean keeps them.",
            naive: "L2 of linear values",
            cured: "`improved` with targets clamped to 10 (`train.target_range`)",
            figure: "`mse` on clean test data over that of the same training on clean data",
            bound: Bound::new(2.0, "one sample in 500 may cost something, not everything"),
            run: outliers,
        },
    ]
}

fn gradient_stage(weight: f64) -> String {
    let gradient = if weight > 0.0 {
        format!(r#",{{"kind":"gradient","remap":{{"root4-signed":0.001}},"weight":{weight}}}"#)
    } else {
        String::new()
    };
    format!(r#"train.stages=[{{"share":1,"terms":[{{"kind":"l1","remap":"linear","weight":1}}{gradient}]}}]"#)
}

fn gradient_weight(workshop: &mut Workshop) -> Result<Outcome> {
    let material = workshop.scale().matte().to_string();
    let data = workshop.data(&material)?;
    let mut points = Vec::new();
    for weight in WEIGHTS {
        let trained = workshop.train(&material, "improved", &[&gradient_stage(weight)])?;
        let mse = match trained.model() {
            Some(model) => split_errors(&model.material, &data, SplitName::Test)?.mse,
            None => f64::NAN,
        };
        points.push((weight, mse));
    }
    let none = points[0].1;
    let of = |weight: f64| points.iter().find(|p| p.0 == weight).map_or(f64::NAN, |p| p.1 / none);
    let (naive, cured) = (of(1.0), of(PAYS));
    let series = vec![Series { name: "L1 + w gradient".into(), points }];
    let plot = Plot { x: "weight of the gradient term".into(), y: "mse, test".into(), series };
    Ok(Outcome { plot: Some(plot), ..Outcome::new(naive, cured) })
}

/// Mean of all answers over the mean of the clean truth, less 1.
fn bias(workshop: &mut Workshop, clean: &Dataset, noisy: &Dataset, set: &[&str]) -> Result<f64> {
    let config = workshop.config("improved", set)?;
    let trained = workshop.train_on("noisy", config, noisy)?;
    let Some(model) = trained.model() else { return Ok(f64::NAN) };
    let (mut answers, mut truth, mut samples) = (0.0, 0.0, 0);
    let sum = |pixels: &[[f32; 3]]| pixels.as_flattened().iter().map(|v| f64::from(*v)).sum::<f64>();
    // The queries of the noisy data with clean answers: directions in between would add an error of their own.
    let split = clean.split(SplitName::Train)?;
    for file in 0..split.files() {
        for block in split.read_file(file)? {
            if samples < LOOKED_AT {
                let answer = model.material.evaluate(&block.queries(clean.resolution()))?;
                answers += sum(&answer.pixels);
                truth += sum(&block.target());
                samples += answer.pixels.len();
            }
        }
    }
    Ok(answers / truth - 1.0)
}

fn noisy_targets(workshop: &mut Workshop) -> Result<Outcome> {
    let material = workshop.scale().matte().to_string();
    let clean = workshop.data(&material)?;
    let inner = workshop.reference(&material)?;
    let mut counts = vec![NOISIEST];
    if !workshop.scale().is_quick() {
        counts.extend(QUIETER);
    }
    let mut lines: Vec<Series> =
        ["L1", "4th roots", "improved"].map(|name| Series { name: name.into(), points: Vec::new() }).to_vec();
    let mut first = Vec::new();
    for samples in counts {
        let change = move |rgb: [f32; 3], random: &mut crate::random::Random| {
            let factor = noise(samples, random);
            rgb.map(|v| v * factor)
        };
        let source = Spoilt { inner: inner.clone(), how: format!("exponential noise / {samples}"), change };
        let mut config = workshop.generation();
        config.validation_samples = config.validation_samples.min(config.samples);
        (config.test_pairs, config.offgrid_samples, config.grazing_samples) = (0, 0, 0);
        let noisy = workshop.data_of(&format!("{material}-noise-{samples}"), &source, &config)?;
        for (line, set) in lines.iter_mut().zip([&[L1][..], &[ROOTS], &[]]) {
            let bias = bias(workshop, &clean, &noisy, set)?;
            line.points.push((samples as f64, bias.abs()));
            if samples == NOISIEST {
                first.push(bias);
            }
        }
    }
    let values = vec![("L1".into(), first[0]), ("4th roots".into(), first[1]), ("improved".into(), first[2])];
    let plot = Plot { x: "samples a query".into(), y: "|relative error of the mean|".into(), series: lines };
    Ok(Outcome { plot: Some(plot), values, ..Outcome::new(first[0].abs(), first[2].abs()) })
}

fn outliers(workshop: &mut Workshop) -> Result<Outcome> {
    let material = workshop.scale().glossy().to_string();
    let clean = workshop.data(&material)?;
    let change = |rgb: [f32; 3], random: &mut crate::random::Random| match random.below(RARE) {
        0 => [BRIGHT * 10f32.powf(random.uniform()); 3],
        _ => rgb,
    };
    let source =
        Spoilt { inner: workshop.reference(&material)?, how: format!("1 in {RARE} is {BRIGHT}"), change };
    let mut config = workshop.generation();
    (config.test_pairs, config.offgrid_samples, config.grazing_samples) = (0, 0, 0);
    let spoilt = workshop.data_of(&format!("{material}-outliers"), &source, &config)?;
    let mut figure = |set: &[&str]| -> Result<f64> {
        let good = workshop.train(&material, "improved", set)?;
        let config = workshop.config("improved", set)?;
        let bad = workshop.train_on("outliers", config, &spoilt)?;
        let Some(bad) = bad.model() else { return Ok(f64::NAN) };
        let of = |model: &crate::stability::workshop::Model| {
            split_errors(&model.material, &clean, SplitName::Test)
        };
        Ok(of(bad)?.mse / of(good.sound()?)?.mse)
    };
    let (naive, open, cured) = (figure(&[L2])?, figure(&[])?, figure(&[CLAMPED])?);
    let values = vec![("improved as it is, targets up to 1000".into(), open)];
    Ok(Outcome { values, ..Outcome::new(naive, cured) })
}
