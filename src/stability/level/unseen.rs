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
        figure: "worst mse of a level from 3 on over that of `improved`; cured: of another seed",
        bound: Bound::new(1.3, "seeds differ by less"),
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

/// The worst unseen level beside one that was seen.
fn figure(errors: &[f64], seen: &[f64]) -> f64 {
    let ratios = errors.iter().zip(seen).skip(SEEN + 1).map(|(error, seen)| error / seen);
    ratios.max_by(f64::total_cmp).unwrap_or(f64::NAN)
}

fn unseen(workshop: &mut Workshop) -> Result<Outcome> {
    let matte = workshop.scale().matte().to_string();
    let naive = workshop.train(&matte, "improved", NAIVE)?.sound()?.clone();
    let cured = workshop.train(&matte, "improved", &[])?.sound()?.clone();
    let again = workshop.train(&matte, "improved", &["train.seed=2"])?.sound()?.clone();
    let of_matte = errors(workshop, &matte, &[&naive, &cured, &again])?;
    let mut outcome = Outcome::new(figure(&of_matte[0], &of_matte[1]), figure(&of_matte[2], &of_matte[1]));
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
        let seen = [1.0, 1.0, 1.0, 0.5, 1.0];
        assert_eq!(figure(&[9.0, 9.0, 9.0, 0.5, 0.25], &seen), 1.0);
        assert_eq!(figure(&[1.0, 0.5, 0.5, 4.0, 1.0], &seen), 8.0);
    }
}
