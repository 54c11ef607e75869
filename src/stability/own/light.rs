//! Light that is made or lost: the albedo over the hemisphere, and reciprocity.

use super::finding::{Bounds, Place, Seen};
use super::numbers::worst;
use super::pictures::{Panel, strip};
use super::subject::{Pair, Questions, Subject, grey};
use super::{Check, Needs};
use crate::error::Result;
use crate::query::{RgbImage, unit};
use neumip_export::checkpoint::Measure;

/// Streams of what is drawn.
const ALBEDO: u64 = 9;
const AGAIN: u64 = 10;
const RECIPROCAL: u64 = 11;
/// Strata along a side of the hemisphere's square, at first and where it counts.
const STRATA: usize = 16;
const FINER: usize = 96;
/// Views that are asked again with more lights: what was largest is so partly by chance.
const REPEATED: usize = 6;
/// Pixels along a side of the picture of a hemisphere.
const SHOWN: usize = 64;
/// Views of the albedo: squared radius, up to 75 degrees. Closer to the horizon a texel's footprint is another matter.
const VIEWS: f32 = 0.93;

pub(super) fn checks() -> Vec<Check> {
    vec![
        Check {
            name: "energy",
            measures: "light that comes back under a white sky of radiance 1, largest over positions, views and levels",
            bounds: Bounds {
                watch: 1.1,
                wrong: Some(3.0),
                reason: "no surface gives back more than it gets. A model that keeps the mean of highlights and not their place has \
                         single places that do; from three times on pictures have fireflies",
            },
            needs: Needs::Pointwise,
            run: albedo,
        },
        Check {
            name: "reciprocity",
            measures: "mean difference of the whole tile's reflectance when light and view change places, over its mean",
            bounds: Bounds {
                watch: 1.0,
                wrong: None,
                reason: "information: no model of this family is reciprocal, and only path tracers that go both ways notice",
            },
            needs: Needs::Pointwise,
            run: reciprocity,
        },
    ]
}

/// Answers to f cos(theta_i).
fn weighted(subject: &Subject, value: f64, wi: [f32; 2]) -> f64 {
    match subject.measure {
        Measure::RadianceCosine => value,
        Measure::Reflectance => value * f64::from(unit(wi)[2]),
    }
}

/// Albedos of places, `strata` x `strata` lights each, evenly over the hemisphere.
fn albedos(
    subject: &Subject,
    stream: u64,
    views: &[([f32; 2], [f32; 2], f32)],
    strata: usize,
) -> Result<Vec<f64>> {
    let mut questions = Questions::default();
    for (k, (u, wo, level)) in views.iter().enumerate() {
        let mut random = Subject::random(stream, k);
        for s in 0..strata * strata {
            let [a, b] = [s % strata, s / strata].map(|i| (i as f32 + random.uniform()) / strata as f32);
            let radius = (1.0 - a * a).max(0.0).sqrt();
            let (sin, cos) = (std::f32::consts::TAU * b).sin_cos();
            questions.push(*u, Pair { wi: [radius * cos, radius * sin], wo: *wo }, *level);
        }
    }
    let lights: Vec<[f32; 2]> = questions.clone().buffer()?.wi;
    let answers = subject.ask(questions)?;
    let values: Vec<f64> =
        answers.iter().zip(&lights).map(|(p, wi)| weighted(subject, grey(*p), *wi)).collect();
    let per = strata * strata;
    Ok(values
        .chunks(per)
        .map(|of_view| std::f64::consts::TAU * of_view.iter().sum::<f64>() / per as f64)
        .collect())
}

fn albedo(subject: &Subject) -> Result<Seen> {
    let view = |k: usize| {
        let mut random = Subject::random(ALBEDO, k);
        let u = [random.uniform(), random.uniform()];
        (u, random.disc(VIEWS), (k % (subject.coarsest + 1)) as f32)
    };
    let views: Vec<_> = (0..subject.choose(1024, 8192)).map(view).collect();
    let first = albedos(subject, ALBEDO, &views, STRATA)?;
    let mean = first.iter().sum::<f64>() / first.len().max(1) as f64;
    let chosen: Vec<_> = worst(&first).iter().take(REPEATED).map(|(k, _)| views[*k]).collect();
    let again = albedos(subject, AGAIN, &chosen, FINER)?;
    let order = worst(&again);
    let Some((k, figure)) = order.first().copied() else { return Ok(Seen::nothing()) };
    let place = |k: usize| Place {
        u: chosen[k].0,
        wi: [0.0; 2],
        wo: chosen[k].1,
        level: chosen[k].2,
        value: Some(again[k]),
    };
    let png = strip(&[Panel::Light(&hemisphere(subject, chosen[k])?)])?;
    Ok(Seen {
        figure,
        says: match figure > 1.1 {
            true => format!("the material makes light: at its worst place {figure:.2} times what falls on it comes back, {mean:.2} on the whole"),
            false => format!("at most {figure:.2} of the light comes back, {mean:.2} on the whole"),
        },
        change: "train longer or on more sub-samples (generate --spp): highlights are too wide or too bright; until then a path tracer has \
                 to end paths early"
            .into(),
        values: [("mean".to_string(), mean)].into(),
        places: order.iter().map(|(k, _)| place(*k)).collect(),
        picture: Some(("Answers over all lights (x to the right, y down) at the worst place.".into(), png)),
        ..Seen::default()
    })
}

fn hemisphere(subject: &Subject, (u, wo, level): ([f32; 2], [f32; 2], f32)) -> Result<RgbImage> {
    let mut questions = Questions::default();
    for k in 0..SHOWN * SHOWN {
        let wi = [k % SHOWN, k / SHOWN].map(|i| 2.0 * (i as f32 + 0.5) / SHOWN as f32 - 1.0);
        questions.push(u, Pair { wi, wo }, level);
    }
    Ok(RgbImage { height: SHOWN, width: SHOWN, pixels: subject.ask(questions)? })
}

fn reciprocity(subject: &Subject) -> Result<Seen> {
    let positions = subject.choose(256, 2048);
    let (mut apart, mut own) = (0.0, 0.0);
    let mut worst_pair = (0.0, Pair { wi: [0.0; 2], wo: [0.0; 2] });
    let pairs = subject.pairs(subject.choose(24, 96));
    for (p, pair) in pairs.iter().enumerate() {
        let turned = Pair { wi: pair.wo, wo: pair.wi };
        let mut questions = Questions::default();
        for k in 0..positions {
            let mut random = Subject::random(RECIPROCAL, p * positions + k);
            let u = [random.uniform(), random.uniform()];
            questions.push(u, *pair, 0.0);
            questions.push(u, turned, 0.0);
        }
        let answers = subject.ask(questions)?;
        let mean = |which: usize, wi: [f32; 2]| {
            let sum: f64 = answers.iter().skip(which).step_by(2).map(|p| grey(*p)).sum();
            let cos = f64::from(unit(wi)[2]).max(1e-3);
            weighted(subject, sum, wi) / cos / positions as f64
        };
        let (a, b) = (mean(0, pair.wi), mean(1, pair.wo));
        apart += (a - b).abs();
        own += 0.5 * (a + b);
        if (a - b).abs() > worst_pair.0 {
            worst_pair = ((a - b).abs(), *pair);
        }
    }
    let figure = if own > 0.0 { apart / own } else { 0.0 };
    let mut at = Questions::default();
    at.push([0.0; 2], worst_pair.1, 0.0);
    Ok(Seen {
        figure,
        says: format!("with light and view exchanged the tile's reflectance differs by {figure:.2} of itself"),
        change: "nothing for a renderer that traces from the eye; a bidirectional one should trace this material from the eye only".into(),
        places: vec![at.place(0, worst_pair.0)],
        ..Seen::default()
    })
}
