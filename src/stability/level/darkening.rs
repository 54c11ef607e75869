//! Coarse levels of gloss: most directions are dark and a few very bright, and a loss that predicts a median forgets the few.

use crate::error::Result;
use crate::query::Reflectance;
use crate::report::figures::Series;
use crate::stability::places::{Halves, Places, mean, texels};
use crate::stability::probe::{Bound, Group, Outcome, Plot, Probe};
use crate::stability::variants::{L1, ROOTS};
use crate::stability::workshop::{Model, Workshop};

/// Random directions and texels a level.
const PLACES: usize = 32_768;
/// Levels from here on are coarse: a picture of a surface far away is made of them.
const COARSE: usize = 2;
/// The models as they are shown.
const NAMES: [&str; 3] = ["L1", "4th roots", "improved"];

pub(super) fn probes() -> Vec<Probe> {
    vec![Probe {
        name: "coarse-darkening",
        group: Group::Level,
        provokes: "At coarse levels of a glossy material L1 predicts the median of what a network cannot tell apart: highlights are \
                   forgotten, and far surfaces are too dark.",
        naive: "L1",
        cured: "`improved`, whose last stage is `l2-mean`",
        figure: "|mean answer over mean of the reference - 1|, worst level from 2 on, glossy material",
        bound: Bound {
            most: 0.15,
            reason: "a fifth of a stop; the 2 % that nobody sees are not reached: a coarse level has some thousand pairs of \
                     directions to learn its highlights from",
            quick: Some(0.25),
        },
        run: darkening,
    }]
}

/// Mean answers of models over the reference's mean at each level, and how well that mean is known.
fn means(workshop: &mut Workshop, material: &str, models: &[&Model]) -> Result<Vec<(Vec<f64>, f64)>> {
    let places = Places::new(PLACES, 6);
    let mut all = Vec::new();
    for level in 0..workshop.generation().levels() {
        let queries = places.at(texels(workshop.scale().resolution, level), [0.0; 2], level as f32)?;
        let [a, b] = Halves::of(workshop, material, &queries, level as u64)?.means();
        let truth = 0.5 * (a + b);
        let of = |model: &&Model| Ok(mean(&model.material.evaluate(&queries)?) / truth);
        all.push((models.iter().map(of).collect::<Result<Vec<f64>>>()?, 0.5 * (a - b).abs() / truth));
    }
    Ok(all)
}

/// Largest distance from 1 of the coarse levels.
fn worst(means: impl Iterator<Item = f64>) -> f64 {
    means.skip(COARSE).map(|mean| (mean - 1.0).abs()).max_by(f64::total_cmp).unwrap_or(f64::NAN)
}

fn darkening(workshop: &mut Workshop) -> Result<Outcome> {
    let material = workshop.scale().glossy().to_string();
    let naive = workshop.train(&material, "improved", &[L1])?.sound()?.clone();
    let roots = workshop.train(&material, "improved", &[ROOTS])?.sound()?.clone();
    let cured = workshop.train(&material, "improved", &[])?.sound()?.clone();
    let means = means(workshop, &material, &[&naive, &roots, &cured])?;
    let figure = |of: usize| worst(means.iter().map(|(means, _)| means[of]));
    let mut outcome = Outcome::new(figure(0), figure(2));
    for (level, (means, noise)) in means.iter().enumerate() {
        for (name, mean) in NAMES.iter().zip(means) {
            outcome.values.push((format!("{name}, level {level}, mean over reference"), *mean));
        }
        outcome.values.push((format!("reference, level {level}, noise of its mean"), *noise));
    }
    let series = NAMES.into_iter().enumerate().map(|(of, name)| {
        let points = means.iter().enumerate().map(|(level, (means, _))| (level as f64, means[of]));
        Series { name: name.into(), points: points.collect() }
    });
    let plot = Plot { x: "level".into(), y: "mean over the reference's".into(), series: series.collect() };
    outcome.plot = Some(plot);
    Ok(outcome)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_coarse_levels_count() {
        let worst = |means: [f64; 4]| worst(means.into_iter());
        assert!(worst([0.5, 2.0, 1.0, 0.99]) < 0.02);
        assert!(worst([1.0, 1.0, 1.0, 0.97]) > 0.02);
    }
}
