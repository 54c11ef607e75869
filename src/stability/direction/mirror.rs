//! Highlights: where light and view mirror each other on the glossy material.

use super::asking::{HIGH, asked};
use crate::error::Result;
use crate::query::{QueryBuffer, Reflectance, RgbImage};
use crate::report::figures::Series;
use crate::report::picture::strip;
use crate::stability::probe::{Bound, Group, Outcome, Plot, Probe};
use crate::stability::variants::L1;
use crate::stability::workshop::Workshop;

/// Queries: the brightest hundredth of them are peaks.
const QUERIES: usize = 16_384;
/// Share of the queries that count as peaks.
const PEAKS: usize = 100;
/// Sub-samples of the truth.
const SPP: usize = 64;
/// Radius around the mirror direction in which the light is, in the projected disc.
const AROUND: f32 = 0.2;
/// A third of the light.
const THIRD: f64 = 0.35;
/// Light and view of the picture.
const SHOWN: [[f32; 2]; 2] = [[0.3, 0.1], [-0.25, -0.1]];

pub(super) fn probes() -> Vec<Probe> {
    vec![Probe {
        name: "mirror-peaks",
        group: Group::Direction,
        provokes: "A highlight is rare: L1 predicts the median of what it cannot tell apart, and the median of a highlight \
                   is the dark around it.",
        naive: "L1 on linear values (paper)",
        cured: "`improved`, whose last stage is `l2-mean`",
        figure: "share of all light that is lost near mirror pairs",
        bound: Bound::new(
            THIRD,
            "two thirds of the highlights' light have to be there, if not where it belongs",
        ),
        run: mirror,
    }]
}

fn near_mirror() -> Result<QueryBuffer> {
    asked(QUERIES, 3, |random| {
        let wo = random.disc(HIGH);
        let [x, y] = random.disc(1.0);
        let wi = [AROUND * x - wo[0], AROUND * y - wo[1]];
        // Beyond the horizon nothing shines.
        let length = (wi[0] * wi[0] + wi[1] * wi[1]).sqrt();
        [wi.map(|v| v * (HIGH.sqrt() / length).min(1.0)), wo]
    })
}

fn light(pixel: &[f32; 3]) -> f64 {
    pixel.iter().map(|v| f64::from(*v)).sum()
}

/// Places from the brightest to the darkest.
fn ranked(truth: &RgbImage) -> Vec<usize> {
    let mut places: Vec<usize> = (0..truth.pixels.len()).collect();
    places.sort_by(|a, b| light(&truth.pixels[*b]).total_cmp(&light(&truth.pixels[*a])).then(a.cmp(b)));
    places
}

/// Share of the truth's light at places that the answer has not; below 0 where it has more.
fn lost(answer: &RgbImage, truth: &RgbImage, places: &[usize]) -> f64 {
    let sum = |image: &RgbImage| places.iter().map(|k| light(&image.pixels[*k])).sum::<f64>();
    1.0 - sum(answer) / sum(truth)
}

/// The brightest `part` of a hundredth and so on, and what is lost there.
fn curve(answer: &RgbImage, truth: &RgbImage, ranked: &[usize]) -> Vec<(f64, f64)> {
    let shares = [0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0];
    let point = |share: f64| {
        let n = ((ranked.len() as f64 * share / 100.0) as usize).clamp(1, ranked.len());
        (share.log10(), 1.0 - lost(answer, truth, &ranked[..n]))
    };
    shares.into_iter().map(point).collect()
}

fn mirror(workshop: &mut Workshop) -> Result<Outcome> {
    let material = workshop.scale().glossy().to_string();
    let naive = workshop.train(&material, "improved", &[L1])?;
    let cured = workshop.train(&material, "improved", &[])?;
    let queries = near_mirror()?;
    let truth = workshop.truth(&material, &queries, SPP, 0)?;
    let ranked = ranked(&truth);
    let peaks = &ranked[..ranked.len() / PEAKS];
    let side = workshop.scale().resolution;
    let slice = QueryBuffer::slice(side, side, SHOWN[0], SHOWN[1], 0.0);
    let mut shown = vec![workshop.truth(&material, &slice, SPP, 0)?];
    let (mut figures, mut series, mut values) = (Vec::new(), Vec::new(), Vec::new());
    for (name, trained) in [("naive", &naive), ("cured", &cured)] {
        let model = &trained.sound()?.material;
        let answer = model.evaluate(&queries)?;
        figures.push(lost(&answer, &truth, &ranked).abs());
        values.push((
            format!("share of the light of the brightest hundredth that is lost, {name}"),
            lost(&answer, &truth, peaks),
        ));
        series.push(Series { name: name.into(), points: curve(&answer, &truth, &ranked) });
        shown.push(model.evaluate(&slice)?);
    }
    let plot = Plot {
        x: "log10 of the share of queries, brightest first, %".into(),
        y: "light that is kept".into(),
        series,
    };
    let picture = strip(&[&shown[1], &shown[2], &shown[0]], 0.0)?;
    Ok(Outcome {
        values,
        plot: Some(plot),
        picture: Some(("A mirror pair on the glossy material: naive, cured, reference.".into(), picture)),
        ..Outcome::new(figures[0], figures[1])
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(values: &[f32]) -> RgbImage {
        RgbImage { height: 1, width: values.len(), pixels: values.iter().map(|v| [*v; 3]).collect() }
    }

    #[test]
    fn what_is_lost_is_counted_at_the_peaks() {
        let (truth, answer) = (image(&[0.0, 4.0, 1.0, 3.0]), image(&[9.0, 2.0, 1.0, 3.0]));
        assert_eq!(ranked(&truth), [1, 3, 2, 0]);
        assert!((lost(&answer, &truth, &[1]) - 0.5).abs() < 1e-12);
        assert!((lost(&answer, &truth, &[1, 3]) - 2.0 / 7.0).abs() < 1e-12);
        assert!(lost(&answer, &truth, &ranked(&truth)) < 0.0);
    }
}
