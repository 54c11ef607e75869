//! A sequence of pictures with two independent estimates of the truth of each.

use crate::dataset::Motion;
use crate::error::Result;
use crate::metrics::flicker::Flicker;
use crate::query::{QueryBuffer, Reflectance, RgbImage};
use crate::stability::workshop::Workshop;

/// Numbers of one half's random numbers: a picture has fewer pixels.
const APART: u64 = 1 << 40;
/// Groups of pixels, each of which estimates the flicker on its own.
const GROUPS: usize = 8;

/// Frames of a sequence: queries and two halves of their truth.
pub(super) struct Sequence {
    frames: Vec<(QueryBuffer, [RgbImage; 2])>,
}

/// What an answerer's sequence does.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moved {
    /// Flicker over all pixels.
    pub flicker: f64,
    /// Its standard error, from groups of pixels.
    pub error: f64,
    /// Energy of the answers' change over the true change's.
    pub own: f64,
}

impl Sequence {
    /// The sequence at `place` in [`crate::dataset::SEQUENCES`], a tile's pictures of `side` pixels, from `spp` sub-samples
    /// a half. A pixel draws the same random numbers in every frame, as in datasets.
    ///
    /// # Errors
    /// What the surface reports.
    pub fn new(
        workshop: &mut Workshop,
        material: &str,
        place: usize,
        motion: Motion,
        side: usize,
        spp: usize,
    ) -> Result<Self> {
        let resolution = [workshop.scale().resolution; 2];
        let mut frames = Vec::new();
        for frame in 0..motion.frames {
            workshop.check()?;
            let queries = motion.scene(place, frame).queries(side, 1, resolution);
            let a = workshop.truth(material, &queries, spp, 0)?;
            let b = workshop.truth(material, &queries, spp, APART)?;
            frames.push((queries, [a, b]));
        }
        Ok(Self { frames })
    }

    /// The flicker of an answerer.
    ///
    /// # Errors
    /// What the answerer reports.
    pub fn moved(&self, answerer: &dyn Reflectance) -> Result<Moved> {
        let mut all = Flicker::default();
        let (mut half, mut groups) = (Flicker::default(), vec![Flicker::default(); GROUPS]);
        for (queries, [a, b]) in &self.frames {
            let answer = answerer.evaluate(queries)?;
            all.add(&answer.pixels, [&a.pixels, &b.pixels]);
            let halved: Vec<[f32; 3]> = answer.pixels.iter().map(|p| p.map(|v| 0.5 * v.min(1.0))).collect();
            half.add(&halved, [&a.pixels, &b.pixels]);
            for (k, group) in groups.iter_mut().enumerate() {
                let [answer, a, b] = [&answer, a, b].map(|image| every(&image.pixels, k));
                group.add(&answer, [&a, &b]);
            }
        }
        let values: Vec<f64> = groups.iter().filter_map(Flicker::value).collect();
        let [flicker, halved] = [all, half].map(|flicker| flicker.value().unwrap_or(f64::NAN));
        // 1 - 2 c k + s k^2 for answers times k: s from k = 1 and 1/2.
        Ok(Moved { flicker, error: standard_error(&values), own: 2.0 * (flicker - 2.0 * halved + 1.0) })
    }

    /// The change between the first two frames around grey, `gain` times larger: the answerer's, then the reference's.
    ///
    /// # Errors
    /// What the answerer reports.
    pub fn changes(&self, answerers: &[&dyn Reflectance], gain: f32) -> Result<Vec<RgbImage>> {
        let [(first, halves), (second, later), ..] = &self.frames[..] else { return Ok(Vec::new()) };
        let mut images = Vec::new();
        for answerer in answerers {
            images.push(change(&answerer.evaluate(first)?, &answerer.evaluate(second)?, gain));
        }
        let [a, b] = [0, 1].map(|half| change(&halves[half], &later[half], gain));
        let mean = a.pixels.iter().zip(&b.pixels).map(|(a, b)| [0, 1, 2].map(|c| 0.5 * (a[c] + b[c])));
        images.push(RgbImage { pixels: mean.collect(), ..a });
        Ok(images)
    }
}

/// Pixels of the group `k`.
fn every(pixels: &[[f32; 3]], k: usize) -> Vec<[f32; 3]> {
    pixels.iter().skip(k).step_by(GROUPS).copied().collect()
}

/// Linear grey that looks like the middle.
const GREY: f32 = 0.2;

fn change(first: &RgbImage, second: &RgbImage, gain: f32) -> RgbImage {
    let clamped = |v: f32| v.clamp(0.0, 1.0);
    let moved = first.pixels.iter().zip(&second.pixels);
    let pixels =
        moved.map(|(a, b)| [0, 1, 2].map(|c| GREY + gain * (clamped(b[c]) - clamped(a[c])))).collect();
    RgbImage { height: first.height, width: first.width, pixels }
}

/// Standard error of the mean of values.
fn standard_error(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
    (squares / (n - 1.0) / n).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Result;

    struct Ramp(f32);

    impl Reflectance for Ramp {
        fn evaluate(&self, queries: &QueryBuffer) -> Result<RgbImage> {
            let pixels = queries.wi.iter().map(|w| [0.3 + self.0 * w[0]; 3]).collect();
            Ok(RgbImage { height: queries.height(), width: queries.width(), pixels })
        }
    }

    fn sequence() -> Sequence {
        let motion = Motion { frames: 3, step: 1.0 };
        let frame = |k| {
            let queries = motion.scene(0, k).queries(16, 1, [16, 16]);
            let truth = Ramp(0.2).evaluate(&queries).unwrap();
            (queries, [truth.clone(), truth])
        };
        Sequence { frames: (0..3).map(frame).collect() }
    }

    #[test]
    fn flicker_is_that_of_the_answers() {
        let sequence = sequence();
        for (slope, expected) in [(0.2, 0.0), (0.0, 1.0), (0.4, 1.0), (0.6, 4.0)] {
            let moved = sequence.moved(&Ramp(slope)).unwrap();
            assert!((moved.flicker - expected).abs() < 1e-4, "{slope}: {moved:?}");
            assert!(
                moved.error < 1e-4 && (moved.own - f64::from(5.0 * slope).powi(2)).abs() < 1e-3,
                "{moved:?}"
            );
        }
    }

    #[test]
    fn changes_are_shown_around_grey() {
        let images = sequence().changes(&[&Ramp(0.0), &Ramp(0.2)], 8.0).unwrap();
        assert!(images[0].pixels.iter().flatten().all(|v| *v == GREY));
        assert_eq!(images[1], images[2]);
        assert!(images[1].pixels.iter().flatten().any(|v| (*v - GREY).abs() > 0.01));
    }

    #[test]
    fn scatter_is_of_the_mean() {
        assert_eq!(standard_error(&[1.0; 5]), 0.0);
        assert!((standard_error(&[1.0, 2.0, 3.0, 4.0]) - (5.0f64 / 12.0).sqrt()).abs() < 1e-12);
    }
}
