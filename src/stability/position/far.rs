//! Positions far from the origin: a plane of ten thousand tiles.

use super::formula;
use crate::error::Result;
use crate::query::{QueryBuffer, Reflectance, RgbImage};
use crate::random::{Random, Stream};
use crate::report::figures::Series;
use crate::stability::places::farthest;
use crate::stability::probe::{Bound, Group, Outcome, Plot, Probe};
use crate::stability::workshop::Workshop;

/// Queries.
const QUERIES: usize = 4096;
/// Positions are multiples of 1 / this: exact in f32 as far away as [`FAR`].
const STEPS: usize = 1024;
/// Tiles away.
const FAR: f32 = 10_000.0;
/// Distances of the curve, in tiles.
const DISTANCES: [f32; 7] = [1.0, 3.0, 10.0, 100.0, 1000.0, 3000.0, FAR];
/// The formula in f32 against the product on the tile itself.
const SAME_MODEL: f64 = 1e-3;

pub(super) fn probes() -> Vec<Probe> {
    vec![Probe {
        name: "far-away",
        group: Group::Position,
        provokes: "A plane repeats the tile thousands of times. 2^k pi (2u - 1) in f32 loses its phase there: the material changes \
                   from tile to tile.",
        naive: "gamma(u) by the formula, u as it comes",
        cured: "u wrapped to the tile before anything else",
        figure: "largest change of an answer at u + 1 and u + 10,000 against u, for u that f32 holds exactly",
        bound: Bound::new(0.0, "the same position of the same tile: the same bytes"),
        run: far,
    }]
}

/// Random positions that stay exact, `away` tiles off, at all levels.
fn queries(away: f32, coarsest: usize) -> Result<QueryBuffer> {
    let mut asked = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for k in 0..QUERIES {
        let mut random = Random::new(k as u64, Stream::Probe, 1);
        let mut exact = || random.below(STEPS) as f32 / STEPS as f32 + away;
        asked.0.push([exact(), exact()]);
        asked.1.push(random.disc(0.99));
        asked.2.push(random.disc(0.99));
        asked.3.push(random.below(2 * coarsest + 1) as f32 / 2.0);
    }
    QueryBuffer::new(1, QUERIES, asked.0, asked.1, asked.2, asked.3)
}

fn far(workshop: &mut Workshop) -> Result<Outcome> {
    let material = workshop.scale().glossy().to_string();
    let model = workshop.train(&material, "improved", &[])?.sound()?.clone();
    let coarsest = model.material.architecture().coarsest();
    let by_formula = |q: &QueryBuffer| formula::answers(&model.checkpoint, &model.material, q);
    let product = |q: &QueryBuffer| model.material.evaluate(q);
    let here = queries(0.0, coarsest)?;
    let (naive_here, cured_here) = (by_formula(&here)?, product(&here)?);
    let moved = |answers: &dyn Fn(&QueryBuffer) -> Result<RgbImage>, here: &RgbImage, away: f32| {
        Ok(farthest(&answers(&queries(away, coarsest)?)?, here))
    };
    let mut points = Vec::new();
    for away in DISTANCES {
        let change: Result<f64> = moved(&by_formula, &naive_here, away);
        points.push((f64::from(away).log10(), change?));
    }
    let worst = |answers: &dyn Fn(&QueryBuffer) -> Result<RgbImage>, here: &RgbImage| -> Result<f64> {
        let one: Result<f64> = moved(answers, here, 1.0);
        let far: Result<f64> = moved(answers, here, FAR);
        Ok(one?.max(far?))
    };
    let same = farthest(&naive_here, &cured_here);
    let mut outcome = Outcome::new(worst(&by_formula, &naive_here)?, worst(&product, &cured_here)?);
    outcome.values.push(("formula against product on the tile".into(), same));
    if same > SAME_MODEL {
        outcome.cured = f64::INFINITY;
        outcome.notes.push("The formula and the product are not the same model.".into());
    }
    outcome.notes.push(
        "Wrapping cannot bring back what f32 never held: 10,000 tiles away a position is known to 1/1024 of a tile (an eighth of a \
         texel of 128), 100,000 away to 1/128. A renderer should hand over u - floor(u) of its own doubles."
            .into(),
    );
    let series = vec![Series { name: "formula".into(), points }];
    outcome.plot = Some(Plot { x: "log10 of the tiles away".into(), y: "largest change".into(), series });
    Ok(outcome)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_are_exact_as_far_as_asked_and_no_farther() {
        let back = |away: f32| {
            let (near, far) = (queries(0.0, 5).unwrap(), queries(away, 5).unwrap());
            near.u.iter().zip(&far.u).all(|(n, f)| f[0] - away == n[0] && f[1] - away == n[1])
        };
        assert!(back(1.0) && back(FAR));
        assert!(!back(3.0 * FAR));
    }
}
