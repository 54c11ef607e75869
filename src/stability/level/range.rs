//! Levels that no texture has.

use crate::error::Result;
use crate::query::{Reflectance, RgbImage};
use crate::report::figures::Series;
use crate::stability::places::{Places, farthest};
use crate::stability::probe::{Bound, Group, Outcome, Plot, Probe};
use crate::stability::workshop::Workshop;

/// Queries.
const QUERIES: usize = 1024;
/// A footprint of an eighth of a texel, and one far larger than the tile.
const BELOW: f32 = -3.0;
const BEYOND: f32 = 99.0;
/// Levels of the curve below 0.
const CURVE: usize = 8;

pub(super) fn probes() -> Vec<Probe> {
    vec![Probe {
        name: "level-range",
        group: Group::Level,
        provokes: "A camera comes nearer than a texel or sees more than the tile; a footprint of radius 0 has level -infinity. \
                   Weights of levels that are not clamped go on outside 0 to 1.",
        naive: "unclamped weights between the two first and the two last levels",
        cured: "the level clamped; one that is no number refused",
        figure: "largest difference of answers at level -3 from those at 0, and at 99 from those at the last level",
        bound: Bound::new(0.0, "there is nothing finer or coarser to answer with: the same bytes"),
        run: range,
    }]
}

/// What weights 1 - t and t make of two answers.
fn extrapolated(a: &RgbImage, b: &RgbImage, t: f32) -> RgbImage {
    let pairs = a.pixels.iter().zip(&b.pixels);
    let pixels = pairs.map(|(a, b)| std::array::from_fn(|c| (1.0 - t) * a[c] + t * b[c])).collect();
    RgbImage { height: a.height, width: a.width, pixels }
}

fn range(workshop: &mut Workshop) -> Result<Outcome> {
    let material = workshop.scale().glossy().to_string();
    let model = workshop.train(&material, "improved", &[])?.sound()?.clone();
    let (places, resolution) = (Places::new(QUERIES, 5), workshop.scale().resolution);
    let at = |level: f32| model.material.evaluate(&places.at(resolution, [0.5; 2], level)?);
    let last = model.material.architecture().coarsest() as f32;
    let (first, second, before, coarsest) = (at(0.0)?, at(1.0)?, at(last - 1.0)?, at(last)?);
    let below = farthest(&extrapolated(&first, &second, BELOW), &first);
    let beyond = farthest(&extrapolated(&before, &coarsest, BEYOND - last + 1.0), &coarsest);
    let mut cured = farthest(&at(BELOW)?, &first).max(farthest(&at(BEYOND)?, &coarsest));
    let refused =
        [f32::NEG_INFINITY, f32::INFINITY, f32::NAN].map(|level| refusal(&places, resolution, level));
    if refused.iter().any(Option::is_none) {
        cured = f64::INFINITY;
    }
    let mut lines = [Vec::new(), Vec::new()];
    for k in 0..=CURVE {
        let level = -(k as f32) * 0.5;
        let of = [extrapolated(&first, &second, level), at(level)?];
        for (line, answer) in lines.iter_mut().zip(of) {
            line.push((f64::from(level), farthest(&answer, &first)));
        }
    }
    lines.iter_mut().for_each(|line| line.reverse());
    let series = ["unclamped", "clamped"].into_iter().zip(lines);
    let series = series.map(|(name, points)| Series { name: name.into(), points }).collect();
    let mut outcome = Outcome::new(below.max(beyond), cured);
    outcome.values = vec![("unclamped, level -3".into(), below), ("unclamped, level 99".into(), beyond)];
    if let [Some(refusal), ..] = refused {
        outcome.notes.push(format!("A footprint of radius 0: \"{refusal}\"."));
    }
    outcome.plot = Some(Plot { x: "level".into(), y: "largest difference".into(), series });
    Ok(outcome)
}

/// What is said about a level that is no number.
fn refusal(places: &Places, resolution: usize, level: f32) -> Option<String> {
    places.at(resolution, [0.0; 2], level).err().map(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_outside_leave_the_answers() {
        let image = |v: f32| RgbImage { height: 1, width: 1, pixels: vec![[v; 3]] };
        assert_eq!(farthest(&extrapolated(&image(0.5), &image(1.0), 0.0), &image(0.5)), 0.0);
        assert_eq!(farthest(&extrapolated(&image(0.5), &image(1.0), -3.0), &image(0.5)), 1.5);
    }

    #[test]
    fn only_numbers_are_levels() {
        let places = Places::new(1, 0);
        assert!(refusal(&places, 64, f32::NEG_INFINITY).is_some_and(|text| text.contains("level")));
        assert!(refusal(&places, 64, -3.0).is_none());
    }
}
