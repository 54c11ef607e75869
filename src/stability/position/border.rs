//! The border of the tile: encodings that are not periodic make a seam there.

use crate::error::Result;
use crate::query::{QueryBuffer, Reflectance, RgbImage};
use crate::random::{Random, Stream};
use crate::report::figures::Series;
use crate::report::picture;
use crate::stability::probe::{Bound, Group, Outcome, Plot, Probe};
use crate::stability::workshop::Workshop;

/// Half the distance over which answers jump, in texels: a close view.
const NEAR: f32 = 1.0 / 64.0;
/// Distances of the curve.
const DISTANCES: [f32; 6] = [1.0 / 64.0, 1.0 / 32.0, 1.0 / 16.0, 1.0 / 8.0, 1.0 / 4.0, 1.0 / 2.0];
/// Rows of texels, each with its own directions.
const ROWS: usize = 512;
/// The answers jump at each line between two columns of texels; the border is one of them.
const MOST: f64 = 1.5;
/// Side of the picture in queries, and how many of them a texel has.
const PICTURE: usize = 96;
const DENSITY: usize = 6;

/// What the naive variants set.
const WITHOUT_PI: &[&str] = &["model.encoding.pi=false"];
const RAW: &[&str] = &["model.encoding.u.raw=true"];

pub(super) fn probes() -> Vec<Probe> {
    vec![Probe {
        name: "tile-border",
        group: Group::Position,
        provokes: "Frequencies 2^k without pi, or u itself beside its encoding (both as in the authors' code), do not repeat with \
                   the tile: a seam.",
        naive: "frequencies 2^k",
        cured: "frequencies 2^k pi, without u itself",
        figure: "rms jump of the answers over 1/32 texel at the tile's border over the largest such jump between columns inside",
        bound: Bound::new(MOST, "by chance the border may be the worst of all columns, but not by half"),
        run: border,
    }]
}

/// Queries to the left and to the right of each line between two columns of texels: the line at u = 0 first, with
/// `rows` queries each.
fn sides(resolution: usize, away: f32) -> Result<[QueryBuffer; 2]> {
    let side = resolution as f32;
    let of = |away: f32| {
        let mut asked = (Vec::new(), Vec::new(), Vec::new());
        for column in 0..resolution {
            for row in 0..ROWS {
                // Every column has the same rows and directions, so that columns compare.
                let mut random = Random::new(row as u64, Stream::Probe, 0);
                let x = (column as f32 + away) / side;
                asked.0.push([x - x.floor(), random.uniform()]);
                asked.1.push(random.disc(0.99));
                asked.2.push(random.disc(0.99));
            }
        }
        let n = asked.0.len();
        QueryBuffer::new(resolution, ROWS, asked.0, asked.1, asked.2, vec![0.0; n])
    };
    Ok([of(-away)?, of(away)?])
}

/// Root mean square jump over each line.
fn jumps(material: &dyn Reflectance, sides: &[QueryBuffer; 2]) -> Result<Vec<f64>> {
    let [left, right] = [material.evaluate(&sides[0])?, material.evaluate(&sides[1])?];
    Ok(lines(&left, &right))
}

fn lines(left: &RgbImage, right: &RgbImage) -> Vec<f64> {
    let columns = left.pixels.chunks(left.width.max(1)).zip(right.pixels.chunks(left.width.max(1)));
    let jump = |(left, right): (&[[f32; 3]], &[[f32; 3]])| {
        let squares = left.as_flattened().iter().zip(right.as_flattened());
        let sum: f64 = squares.map(|(a, b)| f64::from(a - b).powi(2)).sum();
        (sum / left.as_flattened().len() as f64).sqrt()
    };
    columns.map(jump).collect()
}

/// The first line's jump over the largest of the others.
fn seam(jumps: &[f64]) -> f64 {
    match jumps.split_first() {
        Some((border, inside)) => border / inside.iter().copied().fold(0.0, f64::max),
        None => f64::NAN,
    }
}

fn border(workshop: &mut Workshop) -> Result<Outcome> {
    let material = workshop.scale().glossy().to_string();
    let resolution = workshop.scale().resolution;
    let variants = [("2^k", WITHOUT_PI), ("u beside", RAW), ("improved", &[])];
    let mut models = Vec::new();
    for (_, set) in variants {
        models.push(workshop.train(&material, "improved", set)?.sound()?.clone());
    }
    let near = sides(resolution, NEAR)?;
    let mut figures = Vec::new();
    for model in &models {
        figures.push(seam(&jumps(&model.material, &near)?));
    }
    let mut series = Vec::new();
    for ((name, _), model) in variants.iter().zip(&models) {
        let mut points = Vec::new();
        for away in DISTANCES {
            points.push((2.0 * f64::from(away), seam(&jumps(&model.material, &sides(resolution, away)?)?)));
        }
        series.push(Series { name: (*name).into(), points });
    }
    let mut outcome = Outcome::new(figures[0], figures[2]);
    outcome.values.push(("u beside its encoding".into(), figures[1]));
    outcome.plot = Some(Plot {
        x: "distance in texels".into(),
        y: "jump at the border over the largest inside".into(),
        series,
    });
    let view = corner(resolution)?;
    let truth = workshop.truth(&material, &view, workshop.scale().held_out_spp, 0)?;
    let images = [models[0].material.evaluate(&view)?, truth, models[2].material.evaluate(&view)?];
    let pictures = images.iter().map(|image| picture::enlarged(&picture::srgb(image, 0.0)?, 2));
    let strip = picture::strip_of(&pictures.collect::<Result<Vec<_>>>()?)?;
    let caption =
        "16 x 16 texels around the corner where four tiles meet: frequencies 2^k, reference, `improved`.";
    outcome.picture = Some((caption.into(), strip));
    Ok(outcome)
}

/// A close view with the tile's corner in its middle.
fn corner(resolution: usize) -> Result<QueryBuffer> {
    let cells = (resolution * DENSITY) as f32;
    let at = |k: usize| {
        let x = (k as f32 + 0.5 - PICTURE as f32 / 2.0) / cells;
        x - x.floor()
    };
    let n = PICTURE * PICTURE;
    let u = (0..n).map(|k| [at(k % PICTURE), at(k / PICTURE)]).collect();
    QueryBuffer::new(PICTURE, PICTURE, u, vec![[0.3, 0.2]; n], vec![[-0.2, 0.1]; n], vec![0.0; n])
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Ramp {
        seam: f32,
    }

    impl Reflectance for Ramp {
        fn evaluate(&self, queries: &QueryBuffer) -> Result<RgbImage> {
            let of = |u: &[f32; 2]| [(std::f32::consts::TAU * u[0]).sin() + self.seam * u[0]; 3];
            let pixels = queries.u.iter().map(of).collect();
            Ok(RgbImage { height: queries.height(), width: queries.width(), pixels })
        }
    }

    #[test]
    fn a_seam_is_seen_and_a_wave_has_none() {
        let figure = |seam_of: f32| seam(&jumps(&Ramp { seam: seam_of }, &sides(32, NEAR).unwrap()).unwrap());
        // The wave is steepest at the border and next to it.
        assert!(figure(0.0) < 1.1, "{}", figure(0.0));
        assert!(figure(0.1) > 10.0, "{}", figure(0.1));
    }
}
