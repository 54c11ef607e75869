//! Opposite grazing lights, which gamma(w) of period 2 cannot tell apart.

use super::asking::{asked, tilted, turned};
use crate::error::Result;
use crate::query::{QueryBuffer, Reflectance, RgbImage};
use crate::report::figures::Series;
use crate::report::picture::strip;
use crate::stability::probe::{Bound, Group, Outcome, Plot, Probe};
use crate::stability::variants::PRINTED;
use crate::stability::workshop::Workshop;

/// Queries of an angle.
const QUERIES: usize = 2048;
/// Sub-samples of the truth: what differs is about as large as the light itself.
const SPP: usize = 128;
/// Angles of the light from the normal.
const TILTS: [f32; 9] = [30.0, 50.0, 65.0, 75.0, 80.0, 82.5, 85.0, 87.0, 89.0];
/// Those of the figure: grazing, and not so low that there is hardly any light left (`grazing-light` is about that).
const GRAZING: [f32; 2] = [80.0, 82.5];
/// Squared radius of the views: 45 degrees.
const VIEWS: f32 = 0.5;
/// Of the light of the picture.
const SHOWN: f32 = 87.0;

pub(super) fn probes() -> Vec<Probe> {
    vec![Probe {
        name: "opposite-lights",
        group: Group::Direction,
        provokes: "sin(2^k pi x) and cos(2^k pi x) are the same at x = -1 and 1: grazing lights from opposite sides along an \
                   axis are one light to the network.",
        naive: "gamma(wi), gamma(wo) with 4 octaves and nothing else (paper)",
        cured: "wi and wo themselves",
        figure: "error of the difference between opposite lights at 80 and 82.5 degrees over the true difference (squares)",
        bound: Bound::new(
            0.75,
            "1 is what an answer has that does not tell them apart; a quarter has to be told",
        ),
        run: opposite,
    }]
}

/// Lights along the axes, where every band has its period.
fn lights(tilt: f32) -> Result<QueryBuffer> {
    asked(QUERIES, 11, |random| {
        let pan = 90.0 * random.below(4) as f32;
        [tilted(tilt, pan), random.disc(VIEWS)]
    })
}

/// Sums of squares: of the error of the difference, and of the true difference.
fn squares(answers: [&RgbImage; 2], truths: [&RgbImage; 2]) -> [f64; 2] {
    let flat = |image: &'_ RgbImage| -> Vec<f64> {
        image.pixels.as_flattened().iter().map(|v| f64::from(v.clamp(0.0, 1.0))).collect()
    };
    let difference =
        |[a, b]: [&RgbImage; 2]| -> Vec<f64> { flat(a).iter().zip(flat(b)).map(|(a, b)| a - b).collect() };
    let (own, truth) = (difference(answers), difference(truths));
    let error = own.iter().zip(&truth).map(|(own, truth)| (own - truth).powi(2)).sum();
    [error, truth.iter().map(|v| v * v).sum()]
}

fn opposite(workshop: &mut Workshop) -> Result<Outcome> {
    let material = workshop.scale().matte().to_string();
    let naive = workshop.train(&material, "improved", &PRINTED)?;
    let cured = workshop.train(&material, "improved", &[])?;
    let models = [&naive.sound()?.material, &cured.sound()?.material];
    let mut sums = [[0.0; 2]; 2];
    let mut lines = [Vec::new(), Vec::new()];
    for tilt in TILTS {
        workshop.check()?;
        let there = lights(tilt)?;
        let back = turned(&there)?;
        let truths =
            [workshop.truth(&material, &there, SPP, 0)?, workshop.truth(&material, &back, SPP, 1 << 32)?];
        for ((model, sums), line) in models.iter().zip(&mut sums).zip(&mut lines) {
            let answers = [model.evaluate(&there)?, model.evaluate(&back)?];
            let [error, truth] = squares([&answers[0], &answers[1]], [&truths[0], &truths[1]]);
            line.push((f64::from(tilt), error / truth));
            if GRAZING.contains(&tilt) {
                *sums = [sums[0] + error, sums[1] + truth];
            }
        }
    }
    let side = workshop.scale().resolution;
    let mut shown = Vec::new();
    for pan in [0.0, 180.0] {
        let slice = QueryBuffer::slice(side, side, tilted(SHOWN, pan), [0.0; 2], 0.0);
        for model in models {
            shown.push(model.evaluate(&slice)?);
        }
        shown.push(workshop.truth(&material, &slice, SPP, 0)?);
    }
    let shown: Vec<&RgbImage> = [0, 3, 1, 4, 2, 5].into_iter().map(|k| &shown[k]).collect();
    let caption =
        "Light 87 degrees from the normal, from the right and from the left: naive, cured, reference.";
    let [naive, cured] = lines;
    let plot = Plot {
        x: "light from the normal, degrees".into(),
        y: "error of the difference / difference".into(),
        series: vec![
            Series { name: "naive".into(), points: naive },
            Series { name: "cured".into(), points: cured },
        ],
    };
    Ok(Outcome {
        plot: Some(plot),
        picture: Some((caption.into(), strip(&shown, 1.0)?)),
        ..Outcome::new(sums[0][0] / sums[0][1], sums[1][0] / sums[1][1])
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_answer_that_tells_nothing_apart_has_1() {
        let image = |v: f32| RgbImage { height: 1, width: 1, pixels: vec![[v; 3]] };
        let (a, b) = (image(0.75), image(0.25));
        assert_eq!(squares([&a, &a], [&a, &b]), [0.75, 0.75]);
        assert_eq!(squares([&a, &b], [&a, &b])[0], 0.0);
        assert_eq!(squares([&b, &a], [&a, &b]), [3.0, 0.75]);
    }
}
