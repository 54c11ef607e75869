//! Levels that training never shows.

use crate::error::Result;
use crate::query::{QueryBuffer, Reflectance};
use crate::report::figures::Series;
use crate::report::picture;
use crate::stability::places::{Halves, Places, texels};
use crate::stability::probe::{Bound, Group, Outcome, Plot, Probe};
use crate::stability::workshop::{Model, Workshop};

/// Places a level.
const PLACES: usize = 8192;
/// Patches of a fixed side of 16 texels on a tile of 64 end here.
const SEEN: usize = 2;
const NAIVE: &[&str] = &["train.level_dropout=[2]"];
/// Level and side of the picture, and its scale.
const SHOWN: f32 = 4.0;
const SIDE: usize = 48;
const ENLARGED: u32 = 3;

pub(super) fn probes() -> Vec<Probe> {
    vec![Probe {
        name: "coarse-levels-unseen",
        group: Group::Level,
        provokes: "Patches of a fixed side fit the finer levels only: textures of the coarse ones keep their random start.",
        naive: "training sees levels 0 to 2",
        cured: "every level has at least 5 % of the samples",
        figure: "worst mse of levels from 3 on over mse at level 0 (naive: matte; cured: worse material)",
        bound: Bound {
            most: 1.0,
            reason: "larger footprints are smoother: no level is harder than the finest",
        },
        run: unseen,
    }]
}

/// `mse` of models at each level.
fn errors(workshop: &mut Workshop, material: &str, models: &[&Model]) -> Result<Vec<Vec<f64>>> {
    let places = Places::new(PLACES, 7);
    let mut all = vec![Vec::new(); models.len()];
    for level in 0..workshop.generation().levels() {
        let side = texels(workshop.scale().resolution, level);
        let queries = places.at(side, [0.0; 2], level as f32)?;
        let truth = Halves::of(workshop, material, &queries, level as u64)?;
        for (errors, model) in all.iter_mut().zip(models) {
            errors.push(truth.mse(&model.material, &queries)?);
        }
    }
    Ok(all)
}

/// The worst unseen level over the finest one.
fn figure(errors: &[f64]) -> f64 {
    let worst = errors.iter().skip(SEEN + 1).copied().max_by(f64::total_cmp).unwrap_or(f64::NAN);
    worst / errors.first().copied().unwrap_or(f64::NAN)
}

fn unseen(workshop: &mut Workshop) -> Result<Outcome> {
    let (glossy, matte) = (workshop.scale().glossy().to_string(), workshop.scale().matte().to_string());
    // On gloss the finest level is so hard that the coarse ones hide behind it.
    let naive = workshop.train(&matte, "improved", NAIVE)?.sound()?.clone();
    let cured = workshop.train(&matte, "improved", &[])?.sound()?.clone();
    let of_matte = errors(workshop, &matte, &[&naive, &cured])?;
    let on_glossy = workshop.train(&glossy, "improved", &[])?.sound()?.clone();
    let of_glossy = errors(workshop, &glossy, &[&on_glossy])?;
    let mut outcome = Outcome::new(figure(&of_matte[0]), figure(&of_matte[1]).max(figure(&of_glossy[0])));
    outcome.values.push((format!("improved, {matte}"), figure(&of_matte[1])));
    outcome.values.push((format!("improved, {glossy}"), figure(&of_glossy[0])));
    for (level, (naive, cured)) in of_matte[0].iter().zip(&of_matte[1]).enumerate().skip(SEEN + 1) {
        outcome.values.push((format!("{matte}, level {level}, unseen over seen"), naive / cured));
    }
    let series = ["unseen", "improved"].into_iter().zip(&of_matte).map(|(name, errors)| {
        let points = errors.iter().enumerate().map(|(level, error)| (level as f64, *error));
        Series { name: name.into(), points: points.collect() }
    });
    outcome.plot = Some(Plot { x: format!("level, {matte}"), y: "mse".into(), series: series.collect() });
    let queries = QueryBuffer::slice(SIDE, SIDE, [0.3, 0.2], [-0.2, 0.1], SHOWN);
    let truth = workshop.truth(&matte, &queries, workshop.scale().held_out_spp, 0)?;
    let images = [naive.material.evaluate(&queries)?, truth, cured.material.evaluate(&queries)?];
    let pictures = images.iter().map(|image| picture::enlarged(&picture::srgb(image, 0.0)?, ENLARGED));
    let strip = picture::strip_of(&pictures.collect::<Result<Vec<_>>>()?)?;
    outcome.picture =
        Some((format!("{matte} at level 4: trained on levels 0 to 2, reference, `improved`."), strip));
    Ok(outcome)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_unseen_levels_count() {
        assert_eq!(figure(&[1.0, 5.0, 5.0, 0.5, 0.25]), 0.5);
        assert_eq!(figure(&[1.0, 0.5, 0.5, 4.0]), 4.0);
    }
}
