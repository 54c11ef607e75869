//! Popping: a slow zoom must change the picture as slowly as the surface does.

use super::rounded::Rounded;
use crate::error::Result;
use crate::query::{QueryBuffer, Reflectance, RgbImage};
use crate::report::figures::Series;
use crate::report::picture;
use crate::stability::places::{Halves, Places};
use crate::stability::probe::{Bound, Group, Outcome, Plot, Probe};
use crate::stability::workshop::Workshop;

/// Steps of a level.
const STEPS: usize = 8;
/// Queries that stay where they are while the footprint grows.
const QUERIES: usize = 2048;
/// The pictures' frames: just before and just after the step from level 1 to level 2.
const FRAMES: [f32; 2] = [1.375, 1.5];
/// Side of a picture in queries, and its scale.
const SIDE: usize = 48;
const ENLARGED: u32 = 3;

pub(super) fn probes() -> Vec<Probe> {
    vec![Probe {
        name: "popping",
        group: Group::Level,
        provokes: "While a camera moves away the picture jumps from one level to the next.",
        naive: "the level rounded at the query",
        cured: "linear between the two levels",
        figure: "largest step (rms) between pictures 1/8 level apart over the reference's own largest step, worst material",
        bound: Bound::new(1.5, "half as much again as the true change is not seen as a jump"),
        run: popping,
    }]
}

/// The same queries at a level.
fn zoomed(places: &Places, resolution: usize, step: usize) -> Result<QueryBuffer> {
    places.at(resolution, [0.0; 2], step as f32 / STEPS as f32)
}

/// Mean square of the change between two pairs of pictures: the pictures of a pair show the same with noise of their own,
/// which leaves the product. For pictures without noise both are the same.
fn change(before: [&RgbImage; 2], after: [&RgbImage; 2]) -> f64 {
    let clamped = |v: f32| f64::from(v.clamp(0.0, 1.0));
    let [a, b] = [0, 1].map(|half| {
        let pairs = before[half].pixels.as_flattened().iter().zip(after[half].pixels.as_flattened());
        pairs.map(|(before, after)| clamped(*after) - clamped(*before)).collect::<Vec<f64>>()
    });
    let sum: f64 = a.iter().zip(&b).map(|(a, b)| a * b).sum();
    sum / a.len().max(1) as f64
}

/// Root mean square steps along the zoom.
fn steps<'a>(pictures: impl Iterator<Item = [&'a RgbImage; 2]>) -> Vec<f64> {
    let pictures: Vec<_> = pictures.collect();
    pictures.windows(2).map(|pair| change(pair[0], pair[1]).max(0.0).sqrt()).collect()
}

fn largest(steps: &[f64]) -> f64 {
    steps.iter().copied().max_by(f64::total_cmp).unwrap_or(f64::NAN)
}

/// Steps of the reference, of the model asked at whole levels, and of the model.
fn zoom(workshop: &mut Workshop, material: &str) -> Result<[Vec<f64>; 3]> {
    let model = workshop.train(material, "improved", &[])?.sound()?.clone();
    let places = Places::new(QUERIES, 4);
    let (resolution, coarsest) = (workshop.scale().resolution, model.material.architecture().coarsest());
    let (mut truth, mut naive, mut cured) = (Vec::new(), Vec::new(), Vec::new());
    for step in 0..=coarsest * STEPS {
        let queries = zoomed(&places, resolution, step)?;
        // One set of random numbers for the whole zoom: sub-samples move with the footprint.
        truth.push(Halves::of(workshop, material, &queries, 0)?);
        naive.push(Rounded(&model.material).evaluate(&queries)?);
        cured.push(model.material.evaluate(&queries)?);
    }
    let same = |pictures: &[RgbImage]| steps(pictures.iter().map(|picture| [picture; 2]));
    Ok([steps(truth.iter().map(Halves::images)), same(&naive), same(&cured)])
}

fn popping(workshop: &mut Workshop) -> Result<Outcome> {
    let mut materials = workshop.scale().materials.clone();
    if workshop.scale().is_quick() {
        materials.truncate(2);
    }
    let mut outcome = Outcome::new(0.0, 0.0);
    for material in &materials {
        let [truth, naive, cured] = zoom(workshop, material)?;
        let of = |steps: &[f64]| largest(steps) / largest(&truth);
        outcome.naive = outcome.naive.max(of(&naive));
        outcome.cured = outcome.cured.max(of(&cured));
        outcome.values.push((format!("{material}, rounded"), of(&naive)));
        outcome.values.push((format!("{material}, linear"), of(&cured)));
        if outcome.plot.is_none() {
            let named = [("rounded", naive), ("linear", cured), ("reference", truth)];
            let series = named.into_iter().map(|(name, steps)| {
                let points = steps.into_iter().enumerate();
                let points = points.map(|(k, step)| ((k as f64 + 0.5) / STEPS as f64, step)).collect();
                Series { name: name.into(), points }
            });
            let x = format!("level, {material}");
            outcome.plot = Some(Plot { x, y: "rms step".into(), series: series.collect() });
        }
    }
    outcome.picture = Some(pictures(workshop, &materials[0])?);
    Ok(outcome)
}

/// Two frames by rounding and two by mixing.
fn pictures(workshop: &mut Workshop, material: &str) -> Result<(String, Vec<u8>)> {
    let model = workshop.train(material, "improved", &[])?.sound()?.clone();
    let mut shown = Vec::new();
    for answers in [&Rounded(&model.material) as &dyn Reflectance, &model.material] {
        for level in FRAMES {
            let queries = QueryBuffer::slice(SIDE, SIDE, [0.3, 0.2], [-0.2, 0.1], level);
            shown.push(picture::enlarged(&picture::srgb(&answers.evaluate(&queries)?, 0.0)?, ENLARGED)?);
        }
    }
    let caption = format!(
        "{material} at levels 1.375 and 1.5: two pictures of the rounded level, two of the mixed ones."
    );
    Ok((caption, picture::strip_of(&shown)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_jump_is_a_step_and_noise_is_none() {
        let image = |v: [f32; 4]| RgbImage { height: 1, width: 4, pixels: v.map(|v| [v; 3]).to_vec() };
        let (dark, light) = (image([0.2; 4]), image([0.5; 4]));
        let found = steps([[&dark; 2], [&dark; 2], [&light; 2]].into_iter());
        assert_eq!(found[0], 0.0);
        assert!((largest(&found) - 0.3).abs() < 1e-6);
        // Noise of the two halves that has nothing in common.
        let (a, b) = (image([0.3, 0.1, 0.3, 0.1]), image([0.3, 0.3, 0.1, 0.1]));
        assert!(steps([[&dark; 2], [&a, &b]].into_iter())[0] < 1e-6);
        assert!(steps([[&dark; 2], [&a, &a]].into_iter())[0] > 0.09);
    }
}
