//! Energy over the hemisphere and reciprocity, as information: nothing in the method promises either.

use super::asking::HIGH;
use crate::error::Result;
use crate::query::{QueryBuffer, Reflectance, RgbImage, unit};
use crate::random::{Random, Stream};
use crate::report::figures::Series;
use crate::stability::probe::{Bound, Group, Outcome, Plot, Probe};
use crate::stability::workshop::Workshop;
use std::f32::consts::TAU;

/// Positions and views.
const PLACES: usize = 96;
/// Rows and columns of the lights of the hemisphere, each uniform in solid angle.
const LIGHTS: [usize; 2] = [16, 32];
/// Sub-samples of the truth: the lights average it once more.
const SPP: usize = 8;
/// Pairs of directions for reciprocity, each averaged over the tile.
const PAIRS: usize = 64;
/// Positions along each side of the tile that such an average takes.
const ALONG: usize = 12;
/// Sub-samples of the truth of a pair's average.
const PAIR_SPP: usize = 4;
/// What answers may add: a white surface gives back 1, and 512 lights integrate a highlight to a few per cent.
const MARGIN: f64 = 0.1;
/// A training that has seen a twentieth of the samples.
const SHORT: u64 = 20;

pub(super) fn probes() -> Vec<Probe> {
    vec![Probe {
        name: "energy-reciprocity",
        group: Group::Direction,
        provokes: "Nothing keeps a network from giving back more light than it gets, or from answering otherwise when light and \
                   view change places.",
        naive: "short training (a twentieth)",
        cured: "improved",
        figure: "largest albedo over positions and views, light integrated over the hemisphere",
        bound: Bound::new(1.0 + MARGIN, "no surface gives back more than 1; a tenth for the integration"),
        run: energy,
    }]
}

/// Lights that are uniform in solid angle for each of the places.
fn furnace() -> Result<QueryBuffer> {
    let [rows, columns] = LIGHTS;
    let n = rows * columns;
    let (mut u, mut wi, mut wo) = (Vec::new(), Vec::new(), Vec::new());
    for place in 0..PLACES {
        let mut random = Random::new(13, Stream::Probe, place as u64);
        let (at, view) = ([random.uniform(), random.uniform()], random.disc(HIGH));
        for k in 0..n {
            let z = ((k / columns) as f32 + random.uniform()) / rows as f32;
            let (sin, cos) = (TAU * ((k % columns) as f32 + random.uniform()) / columns as f32).sin_cos();
            let radius = (1.0 - z * z).max(0.0).sqrt();
            u.push(at);
            wi.push([radius * cos, radius * sin]);
            wo.push(view);
        }
    }
    QueryBuffer::new(PLACES, n, u, wi, wo, vec![0.0; PLACES * n])
}

/// Albedo of each place, the channels averaged: the mean answer times the hemisphere's solid angle.
fn albedos(answers: &RgbImage) -> Vec<f64> {
    let rows = answers.pixels.chunks(answers.width.max(1));
    let mean = |row: &[[f32; 3]]| {
        row.as_flattened().iter().map(|v| f64::from(*v)).sum::<f64>() / (3 * row.len()) as f64
    };
    rows.map(|row| std::f64::consts::TAU * mean(row)).collect()
}

/// Pairs of directions over a grid of the tile, a row a pair: there and with light and view exchanged.
fn exchanged() -> Result<[QueryBuffer; 2]> {
    let n = ALONG * ALONG;
    let (mut u, mut wi, mut wo) = (Vec::new(), Vec::new(), Vec::new());
    for pair in 0..PAIRS {
        let mut random = Random::new(17, Stream::Probe, pair as u64);
        let (light, view) = (random.disc(HIGH), random.disc(HIGH));
        for k in 0..n {
            u.push([k % ALONG, k / ALONG].map(|at| (at as f32 + random.uniform()) / ALONG as f32));
            wi.push(light);
            wo.push(view);
        }
    }
    let level = vec![0.0; PAIRS * n];
    let there = QueryBuffer::new(PAIRS, n, u.clone(), wi.clone(), wo.clone(), level.clone())?;
    Ok([there, QueryBuffer::new(PAIRS, n, u, wo, wi, level)?])
}

/// Mean |f(wi, wo) - f(wo, wi)| of the tile over its mean f; f is the answer over the light's cosine.
fn reciprocity(queries: &[QueryBuffer; 2], answers: [&RgbImage; 2]) -> f64 {
    let mean = |which: usize| -> Vec<f64> {
        let (queries, answers) = (&queries[which], answers[which]);
        let rows = queries.wi.chunks(queries.width()).zip(answers.pixels.chunks(queries.width()));
        rows.map(|(wi, row)| {
            let sum: f64 = row.as_flattened().iter().map(|v| f64::from(*v)).sum();
            sum / (3 * row.len()) as f64 / f64::from(unit(wi[0])[2])
        })
        .collect()
    };
    let (there, back) = (mean(0), mean(1));
    let apart: f64 = there.iter().zip(&back).map(|(a, b)| (a - b).abs()).sum();
    let both: f64 = there.iter().zip(&back).map(|(a, b)| 0.5 * (a + b)).sum();
    apart / both
}

fn energy(workshop: &mut Workshop) -> Result<Outcome> {
    let material = workshop.scale().glossy().to_string();
    let data = workshop.data(&material)?;
    let mut config = workshop.config("improved", &[])?;
    let scale = workshop.scale();
    let steps = (scale.texels() * scale.budget / config.train.batch as u64 / SHORT).max(1);
    config.train.budget = crate::config::Budget::Steps(steps);
    let short = workshop.train_on(&format!("{material}.short"), config, &data)?;
    let long = workshop.train(&material, "improved", &[])?;
    let (furnace, pairs) = (furnace()?, exchanged()?);
    let truth = workshop.truth(&material, &furnace, SPP, 0)?;
    let there = workshop.truth(&material, &pairs[0], PAIR_SPP, 0)?;
    let back = workshop.truth(&material, &pairs[1], PAIR_SPP, 1 << 32)?;
    let mut lists = Vec::new();
    let mut values = Vec::new();
    for (name, answerer) in [("naive", &short), ("cured", &long)] {
        let model = &answerer.sound()?.material;
        lists.push((name, albedos(&model.evaluate(&furnace)?)));
        let both = [model.evaluate(&pairs[0])?, model.evaluate(&pairs[1])?];
        values.push((format!("reciprocity error, {name}"), reciprocity(&pairs, [&both[0], &both[1]])));
    }
    values.push(("reciprocity error, reference".into(), reciprocity(&pairs, [&there, &back])));
    lists.push(("reference", albedos(&truth)));
    let largest = |list: &[f64]| list.iter().copied().fold(0.0f64, f64::max);
    let mean = |list: &[f64]| list.iter().sum::<f64>() / list.len().max(1) as f64;
    for (name, list) in &lists {
        values.push((format!("mean albedo, {name}"), mean(list)));
        values.push((format!("largest albedo, {name}"), largest(list)));
    }
    let series = lists.iter().map(|(name, list)| {
        let mut list = list.clone();
        list.sort_by(f64::total_cmp);
        let points = list.iter().enumerate().map(|(k, v)| (100.0 * k as f64 / PLACES as f64, *v)).collect();
        Series { name: (*name).into(), points }
    });
    let plot =
        Plot { x: "positions and views, by albedo, %".into(), y: "albedo".into(), series: series.collect() };
    let (naive, cured) = (largest(&lists[0].1), largest(&lists[1].1));
    let safe = (naive <= 1.0 + MARGIN).then(|| {
        "Training pulls answers towards what the surface gives back, and a short one answers too little. Single places may \
         still make light: `neumip stability RUN` looks at more of them."
            .to_string()
    });
    Ok(Outcome { values, safe, plot: Some(plot), ..Outcome::new(naive, cured) })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Five standard errors of the integration of a cosine by stratified lights.
    const INTEGRATED: f64 = 1e-2;

    struct Surface(fn([f32; 2], [f32; 2]) -> f32);

    impl Reflectance for Surface {
        fn evaluate(&self, queries: &QueryBuffer) -> Result<RgbImage> {
            let pixels = queries.wi.iter().zip(&queries.wo).map(|(wi, wo)| [(self.0)(*wi, *wo); 3]).collect();
            Ok(RgbImage { height: queries.height(), width: queries.width(), pixels })
        }
    }

    #[test]
    fn a_white_surface_gives_back_everything() {
        let white = Surface(|wi, _| unit(wi)[2] / std::f32::consts::PI);
        let albedos = albedos(&white.evaluate(&furnace().unwrap()).unwrap());
        assert!(albedos.iter().all(|a| (a - 1.0).abs() < INTEGRATED), "{albedos:?}");
        let constant = Surface(|_, _| 1.0 / std::f32::consts::PI);
        let albedos = super::albedos(&constant.evaluate(&furnace().unwrap()).unwrap());
        assert!(albedos.iter().all(|a| (a - 2.0).abs() < INTEGRATED));
    }

    #[test]
    fn reciprocity_is_of_f() {
        let pairs = exchanged().unwrap();
        let error = |surface: Surface| {
            let [a, b] = [0, 1].map(|k| surface.evaluate(&pairs[k]).unwrap());
            reciprocity(&pairs, [&a, &b])
        };
        assert!(error(Surface(|wi, wo| unit(wi)[2] * (1.0 + wi[0] * wo[0]))) < 1e-6);
        assert!(error(Surface(|wi, wo| unit(wi)[2] * (1.5 + wo[0]))) > 0.05);
    }
}
