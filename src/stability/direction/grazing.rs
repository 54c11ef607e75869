//! Grazing light and view, up to 89.5 degrees from the normal.

use super::asking::{Asked, HIGH, Squares, any_pan, asked, tilted};
use crate::error::Result;
use crate::query::Reflectance;
use crate::report::figures::Series;
use crate::stability::probe::{Bound, Group, Outcome, Plot, Probe};
use crate::stability::workshop::Workshop;

/// Ends of the ranges of angles that are looked at, degrees from the normal.
const ENDS: [f32; 8] = [0.0, 30.0, 50.0, 65.0, 75.0, 80.0, 85.0, 89.5];
/// The last range is grazing.
const GRAZING: usize = ENDS.len() - 2;
/// Queries of a range.
const QUERIES: usize = 2048;
/// Sub-samples of the truth.
const SPP: usize = 128;
/// Data whose directions end 5.7 degrees above the horizon.
const WITHOUT: &str = "disc";
/// Directions as the paper has them.
const FLAT: [&str; 1] = ["model.encoding.components=2"];
/// Parallax as u + h wo.xy / wo.z is written.
const UNBOUNDED: [&str; 1] = ["model.parallax.min_z=0.001"];

/// Which direction grazes.
#[derive(Clone, Copy)]
enum Which {
    Light,
    View,
}

pub(super) fn probes() -> Vec<Probe> {
    vec![
        Probe {
            name: "grazing-light",
            group: Group::Direction,
            provokes: "Answers hold the light's cosine and fall to 0 at the horizon, at the end steeply in x and y: a decoder \
                       of (x, y) that saw no light there goes on as before, and surfaces glow.",
            naive: "(x, y) of the directions, on training data that end 5.7 degrees above the horizon",
            cured: "(x, y, z), and a tenth of the directions uniform in solid angle down to 0.5 degrees (`improved`)",
            figure: "error's energy over the truth's for lights 85 to 89.5 degrees from the normal",
            bound: Bound {
                most: 2.0,
                reason: "1 is what an answer of 0 has; the last degrees before the horizon are not there yet",
                quick: Some(3.0),
            },
            run: light,
        },
        Probe {
            name: "grazing-parallax",
            group: Group::Direction,
            provokes: "Parallax divides by wo.z: towards the horizon lookups leave for places that have nothing to do with the \
                       query.",
            naive: "wo.xy / wo.z as geometry has it (min_z 0.001)",
            cured: "wo.xy / max(wo.z, 0.6)",
            figure: "error's energy over the truth's for views 85 to 89.5 degrees from the normal",
            bound: Bound::new(1.0, "1 is what an answer of 0 has"),
            run: view,
        },
    ]
}

/// A range of angles each.
fn ranges(workshop: &mut Workshop, material: &str, which: Which) -> Result<Vec<Asked>> {
    let mut ranges = Vec::new();
    for (k, ends) in ENDS.windows(2).enumerate() {
        workshop.check()?;
        let queries = asked(QUERIES, k as u64, |random| {
            let tilt = ends[0] + (ends[1] - ends[0]) * random.uniform();
            let (low, other) = (tilted(tilt, any_pan(random)), random.disc(HIGH));
            match which {
                Which::Light => [low, other],
                Which::View => [other, low],
            }
        })?;
        ranges.push(Asked::new(workshop, material, queries, SPP)?);
    }
    Ok(ranges)
}

fn squares(ranges: &[Asked], answerer: &dyn Reflectance) -> Result<Vec<Squares>> {
    ranges.iter().map(|range| range.squares(answerer)).collect()
}

/// mse of the grazing range over that of angles up to 65 degrees.
fn growth(squares: &[Squares]) -> f64 {
    let up_to = squares.iter().take(3).fold(Squares::default(), |sum, s| sum.with(*s));
    squares.get(GRAZING).map_or(f64::NAN, |grazing| grazing.mse() / up_to.mse())
}

fn grazing(squares: &[Squares]) -> Squares {
    squares.get(GRAZING).copied().unwrap_or_default()
}

/// A line of values, each in the middle of its range.
fn line(name: &str, values: impl Iterator<Item = f64>) -> Series {
    let middles = ENDS.windows(2).map(|ends| f64::from(0.5 * (ends[0] + ends[1])));
    Series { name: name.into(), points: middles.zip(values).collect() }
}

fn light(workshop: &mut Workshop) -> Result<Outcome> {
    let material = workshop.scale().matte().to_string();
    let with = workshop.train(&material, "improved", &[])?;
    let reference = workshop.reference(&material)?;
    let generation = crate::dataset::GenerateConfig { grazing_floor: 0.0, ..workshop.generation() };
    let data = workshop.data_of(&format!("{material}.{WITHOUT}"), &*reference, &generation)?;
    let config = workshop.config("improved", &FLAT)?;
    let without = workshop.train_on(&format!("{material}.{WITHOUT}"), config, &data)?;
    let ranges = ranges(workshop, &material, Which::Light)?;
    let [without, with] = [without, with].map(|t| squares(&ranges, &t.sound()?.material));
    let (without, with) = (without?, with?);
    let relative = |squares: &[Squares]| squares.iter().map(|s| s.relative()).collect::<Vec<_>>().into_iter();
    let plot = Plot {
        x: "light from the normal, degrees".into(),
        y: "error's energy over the truth's".into(),
        series: vec![line("naive", relative(&without)), line("cured", relative(&with))],
    };
    let [naive, cured] = [&without, &with].map(|squares| grazing(squares).relative());
    let values = [("mse, naive", grazing(&without).mse()), ("mse, cured", grazing(&with).mse())];
    Ok(Outcome {
        values: values.map(|(name, value)| (name.into(), value)).to_vec(),
        plot: Some(plot),
        ..Outcome::new(naive, cured)
    })
}

fn view(workshop: &mut Workshop) -> Result<Outcome> {
    let material = workshop.scale().matte().to_string();
    let bounded = workshop.train(&material, "improved", &[])?;
    let unbounded = workshop.train(&material, "improved", &UNBOUNDED)?;
    let ranges = ranges(workshop, &material, Which::View)?;
    let [unbounded, bounded] = [unbounded, bounded].map(|t| squares(&ranges, &t.sound()?.material));
    let (unbounded, bounded) = (unbounded?, bounded?);
    let mse = |squares: &[Squares]| squares.iter().map(|s| s.mse()).collect::<Vec<_>>().into_iter();
    let plot = Plot {
        x: "view from the normal, degrees".into(),
        y: "mse".into(),
        series: vec![line("naive", mse(&unbounded)), line("cured", mse(&bounded))],
    };
    let values = [
        ("mse over that up to 65 degrees, naive", growth(&unbounded)),
        ("mse over that up to 65 degrees, cured", growth(&bounded)),
    ];
    let [naive, cured] = [&unbounded, &bounded].map(|squares| grazing(squares).relative());
    let safe = (naive <= 1.0).then(|| {
        "The offset is learnt: its network sees wo and divides by what it needs, whatever the formula divides by. What is left at \
         the horizon is what the texture cannot show, with either."
            .to_string()
    });
    Ok(Outcome {
        values: values.map(|(name, value)| (name.into(), value)).to_vec(),
        plot: Some(plot),
        safe,
        ..Outcome::new(naive, cured)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn growth_is_of_the_last_range_over_the_high_ones() {
        let of = |error| Squares { values: 1, error, truth: 1.0 };
        let mut squares = [1.0, 1.0, 1.0, 9.0, 9.0, 9.0, 3.0].map(of);
        assert_eq!(growth(&squares), 3.0);
        squares[6].error = 4.0;
        assert_eq!(growth(&squares), 4.0);
        assert!(growth(&squares[..3]).is_nan());
    }
}
