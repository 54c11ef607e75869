//! Footprints between two levels.

use super::rounded::Rounded;
use crate::error::Result;
use crate::query::Reflectance;
use crate::report::figures::Series;
use crate::stability::places::{Halves, Places, texels};
use crate::stability::probe::{Bound, Group, Outcome, Plot, Probe};
use crate::stability::workshop::Workshop;

/// Places a level.
const PLACES: usize = 16_384;
/// Steps of a level on the curve.
const STEPS: usize = 4;
/// Places a point of the curve.
const CURVE_PLACES: usize = 4096;

pub(super) fn probes() -> Vec<Probe> {
    vec![Probe {
        name: "fractional-levels",
        group: Group::Level,
        provokes: "Footprints of a renderer lie between levels. The nearest level is sharper or blurrier than what is asked.",
        naive: "the level rounded at the query",
        cured: "linear between the two levels",
        figure: "mse at levels l + 0.5 over the mean mse at l and l + 1, worst l (cured: worst material too)",
        bound: Bound::new(1.1, "between levels errors may be a tenth larger than at them, no more"),
        run: fractional,
    }]
}

/// `mse` at a level, positions by chance in the finer whole level's texels, by rounding and as it is.
fn errors(
    workshop: &mut Workshop,
    material: &str,
    answers: &dyn Reflectance,
    places: &Places,
    level: f32,
) -> Result<[f64; 2]> {
    let side = texels(workshop.scale().resolution, level as usize);
    let queries = places.at(side, [0.0; 2], level)?;
    let truth = Halves::of(workshop, material, &queries, (level * STEPS as f32) as u64)?;
    Ok([truth.mse(&Rounded(answers), &queries)?, truth.mse(answers, &queries)?])
}

/// Error at half levels over the mean error at their neighbours, by rounding and as it is; worst level.
fn ratios(workshop: &mut Workshop, material: &str) -> Result<Vec<[f64; 2]>> {
    let model = workshop.train(material, "improved", &[])?.sound()?.clone();
    let places = Places::new(PLACES, 2);
    let mut at = |level: f32| errors(workshop, material, &model.material, &places, level);
    let coarsest = model.material.architecture().coarsest();
    let whole = (0..=coarsest).map(|level| at(level as f32)).collect::<Result<Vec<_>>>()?;
    let mut ratios = Vec::new();
    for (level, pair) in whole.windows(2).enumerate() {
        let mean = 0.5 * (pair[0][1] + pair[1][1]);
        ratios.push(at(level as f32 + 0.5)?.map(|error| error / mean));
    }
    Ok(ratios)
}

fn fractional(workshop: &mut Workshop) -> Result<Outcome> {
    let (glossy, matte) = (workshop.scale().glossy().to_string(), workshop.scale().matte().to_string());
    let mut worst = [0.0f64; 2];
    let mut values = Vec::new();
    for material in [&glossy, &matte] {
        for (level, [naive, cured]) in ratios(workshop, material)?.into_iter().enumerate() {
            worst = [worst[0].max(naive), worst[1].max(cured)];
            values.push((format!("{material}, level {level}.5, rounded"), naive));
            values.push((format!("{material}, level {level}.5"), cured));
        }
    }
    let model = workshop.train(&matte, "improved", &[])?.sound()?.clone();
    let coarsest = model.material.architecture().coarsest();
    let places = Places::new(CURVE_PLACES, 3);
    let mut lines = [Vec::new(), Vec::new()];
    for step in 0..=coarsest * STEPS {
        let level = step as f32 / STEPS as f32;
        let errors = errors(workshop, &matte, &model.material, &places, level)?;
        lines.iter_mut().zip(errors).for_each(|(line, error)| line.push((f64::from(level), error)));
    }
    let series = ["rounded", "linear"].into_iter().zip(lines);
    let series = series.map(|(name, points)| Series { name: name.into(), points }).collect();
    let plot = Plot { x: format!("level, {matte}"), y: "mse".into(), series };
    Ok(Outcome { plot: Some(plot), values, ..Outcome::new(worst[0], worst[1]) })
}
