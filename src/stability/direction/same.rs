//! The light where the viewer is.

use super::asking::{Asked, HIGH, Squares, any_pan, asked, tilted};
use crate::error::Result;
use crate::query::unit;
use crate::random::{Random, Stream};
use crate::report::figures::Series;
use crate::stability::probe::{Bound, Group, Outcome, Plot, Probe};
use crate::stability::workshop::Workshop;

/// Queries a set.
const QUERIES: usize = 4096;
/// Sub-samples of the truth.
const SPP: usize = 128;
/// Angles between light and view at which both sets of coordinates are looked at, radians.
const APART: [f32; 7] = [0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3, 3e-4];
/// How far the light is moved at each, as a share of the angle.
const MOVED: f32 = 0.5;
/// Pairs a point of the curve.
const PAIRS: u64 = 256;

pub(super) fn probes() -> Vec<Probe> {
    vec![Probe {
        name: "same-direction",
        group: Group::Direction,
        provokes: "Where wi = wo no shadow is seen and the difference vector of half-vector coordinates has no azimuth: an \
                   answer that is smooth in those coordinates jumps there.",
        naive: "Rusinkiewicz's coordinates (half and difference vector as angles)",
        cured: "raw wi and wo",
        figure: "largest change of the decoder's direction inputs over the change of wi, with light and view 3e-4 apart",
        bound: Bound::new(10.0, "inputs that move ten times as fast as the light are a jump for the eye"),
        run: same,
    }]
}

fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn normalised(v: [f32; 3]) -> [f32; 3] {
    let length = dot(v, v).sqrt();
    v.map(|x| x / length)
}

/// Angles (theta_h, phi_h, theta_d, phi_d) of Rusinkiewicz 1998, the azimuths as sine and cosine.
fn half_vector(wi: [f32; 2], wo: [f32; 2]) -> [f32; 6] {
    let (wi, wo) = (unit(wi), unit(wo));
    let h = normalised([0, 1, 2].map(|c| wi[c] + wo[c]));
    let pan = h[1].atan2(h[0]);
    // The difference vector: wi in the frame of h.
    let tangent = normalised(cross([-pan.sin(), pan.cos(), 0.0], h));
    let d = [dot(wi, tangent), dot(wi, cross(h, tangent)), dot(wi, h)];
    let turn = d[1].atan2(d[0]);
    [h[2].clamp(-1.0, 1.0).acos(), pan.sin(), pan.cos(), d[2].clamp(-1.0, 1.0).acos(), turn.sin(), turn.cos()]
}

fn raw(wi: [f32; 2], wo: [f32; 2]) -> [f32; 6] {
    [wi[0], wi[1], wo[0], wo[1], 0.0, 0.0]
}

/// Largest change of coordinates over the change of wi, for lights so far from the view.
fn speed(coordinates: fn([f32; 2], [f32; 2]) -> [f32; 6], apart: f32) -> f64 {
    let mut most = 0.0f64;
    for k in 0..PAIRS {
        let mut random = Random::new(1, Stream::Probe, k);
        let wo = random.disc(0.5 * HIGH);
        let [a, b] = [0.0, 90.0].map(|turn| {
            let pan = 360.0 * (k as f32 / PAIRS as f32) + turn * MOVED;
            let (sin, cos) = pan.to_radians().sin_cos();
            [wo[0] + apart * cos, wo[1] + apart * sin]
        });
        let (from, to) = (coordinates(a, wo), coordinates(b, wo));
        let distance =
            |x: &[f32], y: &[f32]| x.iter().zip(y).map(|(x, y)| f64::from(x - y).powi(2)).sum::<f64>().sqrt();
        let ratio = distance(&from, &to) / distance(&a, &b);
        most = if ratio.is_finite() { most.max(ratio) } else { f64::INFINITY };
    }
    most
}

/// mse at wi = wo over mse at the same angles from the normal with light and view turned against each other.
fn ratio(workshop: &mut Workshop, material: &str) -> Result<(f64, Squares)> {
    let model = workshop.train(material, "improved", &[])?;
    let material_answers = &model.sound()?.material;
    let mut squares = Vec::new();
    for turned in [false, true] {
        let queries = asked(QUERIES, 7, |random| {
            let tilt = HIGH.sqrt().asin().to_degrees() * random.uniform().sqrt();
            let (pan, other) = (any_pan(random), any_pan(random));
            let wi = tilted(tilt, pan);
            [wi, if turned { tilted(tilt, other) } else { wi }]
        })?;
        squares.push(Asked::new(workshop, material, queries, SPP)?.squares(material_answers)?);
    }
    Ok((squares[0].mse() / squares[1].mse(), squares[0]))
}

fn same(workshop: &mut Workshop) -> Result<Outcome> {
    let [naive, cured] = [half_vector as fn(_, _) -> _, raw]
        .map(|coordinates| APART.map(|apart| (f64::from(apart), speed(coordinates, apart))));
    let last = |points: &[(f64, f64)]| points.last().map_or(f64::NAN, |p| p.1);
    let scale = workshop.scale();
    let mut values = Vec::new();
    for material in [scale.glossy(), scale.matte()].map(String::from) {
        let (ratio, squares) = ratio(workshop, &material)?;
        values.push((format!("{material}: mse at wi = wo over mse with light and view turned apart"), ratio));
        values.push((format!("{material}: error's energy over the truth's at wi = wo"), squares.relative()));
    }
    let points = |p: &[(f64, f64)]| p.iter().map(|(x, y)| (-x.log10(), *y)).rev().collect();
    let series = vec![
        Series { name: "half vector".into(), points: points(&naive) },
        Series { name: "raw".into(), points: points(&cured) },
    ];
    let plot = Plot {
        x: "-log10 of the angle between light and view".into(),
        y: "change of inputs / change of wi".into(),
        series,
    };
    Ok(Outcome { values, plot: Some(plot), ..Outcome::new(last(&naive), last(&cured)) })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rounding of f32 in angles.
    const ROUNDING: f32 = 1e-5;

    #[test]
    fn half_vectors_are_between_light_and_view() {
        let [theta_h, _, cos_h, theta_d, ..] = half_vector([0.5, 0.0], [0.0, 0.0]);
        for (angle, expected) in [(theta_h, 15.0f32), (theta_d, 15.0)] {
            assert!((angle - expected.to_radians()).abs() < ROUNDING, "{angle}");
            assert!((angle - (expected + 0.1).to_radians()).abs() > ROUNDING);
        }
        assert!((cos_h - 1.0).abs() < ROUNDING);
    }

    #[test]
    fn raw_directions_move_with_the_light() {
        assert!((speed(raw, 0.1) - 1.0).abs() < 1e-4);
        assert!(speed(half_vector, 1e-3) > 10.0 * speed(half_vector, 0.3));
    }
}
