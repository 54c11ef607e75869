//! Positions between the texel centres: gamma(u) oscillates there, and data on the grid never shows it.

use crate::dataset::Regime;
use crate::error::Result;
use crate::query::QueryBuffer;
use crate::query::Reflectance;
use crate::report::figures::Series;
use crate::report::picture;
use crate::stability::places::{Halves, Places, texels};
use crate::stability::probe::{Bound, Group, Outcome, Plot, Probe};
use crate::stability::workshop::{Model, Workshop};

/// Places a level.
const PLACES: usize = 16_384;
/// Shifts of the curve: eighths of a texel.
const SHIFTS: usize = 8;
/// Places a level and shift of the curve.
const CURVE_PLACES: usize = 4096;
/// A grid that a close view asks.
const DENSITY: usize = 4;
/// Levels at which the dense grid is asked.
const DENSE_LEVELS: [usize; 2] = [0, 2];
/// Texels along a side of the picture's part of the tile, and how much larger it is shown.
const PART: usize = 24;
const ENLARGED: u32 = 2;

/// Encoding of u as the paper prints it.
const PRINTED: [&str; 2] = ["model.encoding.u.limit_to_resolution=false", "model.encoding.u.attenuate=false"];
/// Off the grid over on the grid.
const WORSE: f64 = 1.1;
const REASON: &str =
    "a renderer asks between the texels almost always: errors there may be a tenth larger, no more";
const NAIVE: &str = "gamma(u) of 10 octaves as printed, trained on whole aligned slices";
const CURED: &str = "octaves up to the resolution, attenuated by the footprint, trained on shifted patches";

pub(super) fn probes() -> Vec<Probe> {
    vec![
        Probe {
            name: "half-texel",
            group: Group::Position,
            provokes: "At texel centres the fine octaves of gamma(u) take a few values only; half a texel off, at every level, \
                       they take values that training never saw.",
            naive: NAIVE,
            cured: CURED,
            figure: "mse half a texel off the grid over mse on the grid, mean of the levels, same directions (naive: matte; cured: worse material)",
            bound: Bound::new(WORSE, REASON),
            run: half_texel,
        },
        Probe {
            name: "denser-grid",
            group: Group::Position,
            provokes: "A close view asks four times as many positions as there are texels, at the same level.",
            naive: NAIVE,
            cured: CURED,
            figure: "mse on a grid four times as dense over mse on the grid, mean of levels 0 and 2 (naive: matte; cured: worse material)",
            bound: Bound::new(WORSE, REASON),
            run: denser,
        },
    ]
}

/// The published encoding on published data: slices of as many samples.
fn naive(workshop: &mut Workshop, material: &str) -> Result<Model> {
    let reference = workshop.reference(material)?;
    let mut generation = workshop.generation();
    generation.regime = Regime::Slices(0);
    let name = format!("{material}.slices");
    let data = workshop.data_of(&name, &*reference, &generation)?;
    let config = workshop.config("improved", &PRINTED)?;
    Ok(workshop.train_on(&name, config, &data)?.sound()?.clone())
}

fn cured(workshop: &mut Workshop, material: &str) -> Result<Model> {
    Ok(workshop.train(material, "improved", &[])?.sound()?.clone())
}

/// Grid and shift in cells of that grid.
type Asked = (usize, f32);

/// `mse` of models at a level, on a grid.
fn errors_at(
    workshop: &mut Workshop,
    material: &str,
    models: &[&Model],
    places: &Places,
    level: usize,
    asked: Asked,
) -> Result<Vec<f64>> {
    let (density, shift) = asked;
    let side = texels(workshop.scale().resolution, level) * density;
    let queries = places.at(side, [shift; 2], level as f32)?;
    // On and off the grid have the same places and the same random numbers: what differs is the shift.
    let truth = Halves::of(workshop, material, &queries, level as u64)?;
    models.iter().map(|model| truth.mse(&model.material, &queries)).collect()
}

/// `mse` on the grid and asked otherwise, per level.
type Pairs = Vec<[f64; 2]>;

/// Per model and level: `mse` on the grid and asked otherwise.
fn pairs(
    workshop: &mut Workshop,
    material: &str,
    models: &[&Model],
    levels: &[usize],
    asked: Asked,
) -> Result<Vec<Pairs>> {
    let mut pairs = vec![Vec::new(); models.len()];
    let places = Places::new(PLACES, 0);
    for &level in levels {
        let on = errors_at(workshop, material, models, &places, level, (1, 0.0))?;
        let off = errors_at(workshop, material, models, &places, level, asked)?;
        for (pairs, (on, off)) in pairs.iter_mut().zip(on.into_iter().zip(off)) {
            pairs.push([on, off]);
        }
    }
    Ok(pairs)
}

/// Error off the grid over error on it, all levels together.
fn together(pairs: &Pairs) -> f64 {
    let sum = |of: usize| pairs.iter().map(|pair| pair[of]).sum::<f64>();
    sum(1) / sum(0)
}

fn half_texel(workshop: &mut Workshop) -> Result<Outcome> {
    let mut outcome = compared(workshop, None, (1, 0.5))?;
    let matte = workshop.scale().matte().to_string();
    let (naive, cured) = (naive(workshop, &matte)?, cured(workshop, &matte)?);
    let levels = workshop.generation().levels();
    let places = Places::new(CURVE_PLACES, 1);
    let mut lines = [Vec::new(), Vec::new()];
    for shift in 0..=SHIFTS {
        let shift = shift as f64 / SHIFTS as f64;
        let mut sums = [0.0; 2];
        for level in 0..levels {
            let errors = errors_at(workshop, &matte, &[&naive, &cured], &places, level, (1, shift as f32))?;
            sums.iter_mut().zip(errors).for_each(|(sum, error)| *sum += error / levels as f64);
        }
        lines.iter_mut().zip(sums).for_each(|(line, error)| line.push((shift, error)));
    }
    let series = ["naive", "improved"].into_iter().zip(lines);
    let series = series.map(|(name, points)| Series { name: name.into(), points }).collect();
    let x = format!("shift in texels, {matte}");
    outcome.plot = Some(Plot { x, y: "mse, mean of the levels".into(), series });
    Ok(outcome)
}

fn denser(workshop: &mut Workshop) -> Result<Outcome> {
    let mut outcome = compared(workshop, Some(&DENSE_LEVELS), (DENSITY, 0.0))?;
    let matte = workshop.scale().matte().to_string();
    let (naive, cured) = (naive(workshop, &matte)?, cured(workshop, &matte)?);
    let queries = close_view(workshop.scale().resolution)?;
    let truth = workshop.truth(&matte, &queries, workshop.scale().held_out_spp, 0)?;
    let images = [naive.material.evaluate(&queries)?, truth, cured.material.evaluate(&queries)?];
    let pictures = images.iter().map(|image| picture::enlarged(&picture::srgb(image, 0.0)?, ENLARGED));
    let strip = picture::strip_of(&pictures.collect::<Result<Vec<_>>>()?)?;
    let caption =
        format!("{PART} x {PART} texels of {matte}, four times as dense: naive, reference, `improved`.");
    outcome.picture = Some((caption, strip));
    Ok(outcome)
}

/// A part of the tile on the dense grid, under slanted light.
fn close_view(resolution: usize) -> Result<QueryBuffer> {
    let (side, cells) = (PART * DENSITY, (resolution * DENSITY) as f32);
    let n = side * side;
    let u = (0..n).map(|k| [((k % side) as f32 + 0.5) / cells, ((k / side) as f32 + 0.5) / cells]).collect();
    QueryBuffer::new(side, side, u, vec![[0.3, 0.2]; n], vec![[-0.2, 0.1]; n], vec![0.0; n])
}

/// Both variants on the matte material, where errors of directions hide those of positions least, the cured one on the glossy
/// one as well.
fn compared(workshop: &mut Workshop, levels: Option<&[usize]>, asked: Asked) -> Result<Outcome> {
    let (glossy, matte) = (workshop.scale().glossy().to_string(), workshop.scale().matte().to_string());
    let all: Vec<usize> = (0..workshop.generation().levels()).collect();
    let levels = levels.unwrap_or(&all);
    let (naive, cured_matte) = (naive(workshop, &matte)?, cured(workshop, &matte)?);
    let of_matte = pairs(workshop, &matte, &[&naive, &cured_matte], levels, asked)?;
    let cured_glossy = cured(workshop, &glossy)?;
    let of_glossy = pairs(workshop, &glossy, &[&cured_glossy], levels, asked)?;
    let cured = together(&of_matte[1]).max(together(&of_glossy[0]));
    let mut outcome = Outcome::new(together(&of_matte[0]), cured);
    let rows = [("naive", &of_matte[0]), (&matte, &of_matte[1]), (&glossy, &of_glossy[0])];
    for (name, pairs) in rows {
        for (level, [on, off]) in levels.iter().zip(pairs) {
            outcome.values.push((format!("{name}, level {level}"), off / on));
        }
    }
    Ok(outcome)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_count_by_their_errors() {
        assert_eq!(together(&vec![[1.0, 1.0], [1.0, 2.0]]), 1.5);
        assert_eq!(together(&vec![[1.0, 1.0], [3.0, 3.0]]), 1.0);
        assert!(together(&vec![[1.0, f64::NAN]]).is_nan());
    }

    #[test]
    fn a_close_view_is_as_dense_as_it_says() {
        const ROUNDING: f32 = 1e-6;
        let queries = close_view(64).unwrap();
        let step = queries.u[1][0] - queries.u[0][0];
        assert!((step - 1.0 / (64 * DENSITY) as f32).abs() < ROUNDING);
        assert!((step - 1.0 / 64.0).abs() > ROUNDING);
    }
}
