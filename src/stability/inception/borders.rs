//! Pictures put together of patches.

use super::padded::{Padded, cut};
use crate::error::Result;
use crate::kernels::inception::Border;
use crate::query::{QueryBuffer, Reflectance, RgbImage};
use crate::random::{Random, Stream};
use crate::report::figures::Series;
use crate::report::picture::{enlarged, srgb, strip_of};
use crate::stability::probe::{Bound, Group, Outcome, Plot, Probe};
use crate::stability::workshop::Workshop;

/// Samples along a side of a patch.
const PATCH: usize = 16;
/// Pairs of directions, so that edges of the material fall on borders and inside alike.
const PAIRS: u64 = 8;
/// Directions stay above 30 degrees of elevation: grazing ones are dark.
const DISC: f32 = 0.75;
const SEED: u64 = 11;
/// Stops by which the picture is brighter: the brightest pair is still dark.
const STOPS: f32 = 2.0;
/// Pixels of a texel in the picture.
const ENLARGED: u32 = 4;

pub(super) fn probes() -> Vec<Probe> {
    vec![Probe {
        name: "inception-borders",
        group: Group::Inception,
        provokes: "A large picture is answered in patches. Zeros beyond their borders are neighbours that no training showed.",
        naive: "patches of 16 x 16 with zeros around them",
        cured: "patches of 16 x 16 with the missing neighbours added",
        figure: "mean jump across patch borders over that of the slice answered at once",
        bound: Bound::new(1.001, "a patch's border is a line like any other"),
        run,
    }]
}

fn run(workshop: &mut Workshop) -> Result<Outcome> {
    let model = super::trained(workshop)?;
    let padded = Padded::new(&model.checkpoint)?;
    let side = workshop.scale().resolution;
    let mut jumps = [Jumps::default(), Jumps::default(), Jumps::default()];
    let (mut shown, mut brightest) = (Vec::new(), 0.0);
    for pair in 0..PAIRS {
        let random = &mut Random::sub_stream(SEED, Stream::Probe, 4, pair);
        let whole = QueryBuffer::slice(side, side, random.disc(DISC), random.disc(DISC), 0.0);
        let once = model.material.evaluate(&whole)?.pixels;
        let mut patches = [vec![[0.0; 3]; side * side], vec![[0.0; 3]; side * side]];
        for (i, j) in (0..side).step_by(PATCH).flat_map(|i| (0..side).step_by(PATCH).map(move |j| (i, j))) {
            let (part, places) = cut(&whole, [i, j], [PATCH; 2])?;
            let answers = [padded.answers(&part, Border::Zero)?, model.material.evaluate(&part)?.pixels];
            for (image, answers) in patches.iter_mut().zip(answers) {
                places.iter().zip(answers).for_each(|(k, answer)| image[*k] = answer);
            }
        }
        let [naive, cured] = patches;
        for (jumps, pixels) in jumps.iter_mut().zip([&once, &naive, &cured]) {
            jumps.add(side, pixels);
        }
        let light: f64 = once.iter().flatten().map(|v| f64::from(*v)).sum();
        if light > brightest || pair == 0 {
            brightest = light;
            let image = |pixels| RgbImage { height: side, width: side, pixels };
            shown = vec![image(naive), image(cured)];
        }
    }
    let [once, naive, cured] = jumps;
    let notes = vec![format!(
        "Across borders over inside: {:.2} as they come, {:.2} with neighbours, {:.2} of the slice at once.",
        naive.ratio(),
        cured.ratio(),
        once.ratio()
    )];
    let values = vec![
        ("naive_over_inside".into(), naive.ratio()),
        ("cured_over_inside".into(), cured.ratio()),
        ("slice_over_inside".into(), once.ratio()),
    ];
    let pictures =
        shown.iter().map(|image| enlarged(&srgb(image, STOPS)?, ENLARGED)).collect::<Result<Vec<_>>>()?;
    let caption = "Left: patches with zeros around them; right: with their neighbours; four times brighter."
        .to_string();
    let plot = Plot {
        x: "column of the patch, from the border on".into(),
        y: "mean jump to the column before".into(),
        series: vec![naive.series("zeros"), cured.series("neighbours")],
    };
    Ok(Outcome {
        notes,
        values,
        plot: Some(plot),
        picture: Some((caption, strip_of(&pictures)?)),
        ..Outcome::new(naive.across() / once.across(), cured.across() / once.across())
    })
}

/// Sums of |difference| to the column before and the row above, by the place in a patch.
#[derive(Clone, Debug, Default)]
struct Jumps {
    sum: [f64; PATCH],
    count: [f64; PATCH],
}

impl Jumps {
    fn add(&mut self, side: usize, pixels: &[[f32; 3]]) {
        let apart = |a: usize, b: usize| -> f64 {
            (0..3).map(|c| f64::from((pixels[a][c] - pixels[b][c]).abs())).sum()
        };
        for k in 0..side * side {
            let (i, j) = (k / side, k % side);
            for (at, before) in [(i, (i + side - 1) % side * side + j), (j, i * side + (j + side - 1) % side)]
            {
                self.sum[at % PATCH] += apart(k, before);
                self.count[at % PATCH] += 1.0;
            }
        }
    }

    fn mean(&self, at: usize) -> f64 {
        self.sum[at] / self.count[at].max(1.0)
    }

    fn across(&self) -> f64 {
        self.mean(0)
    }

    /// Across borders over inside.
    fn ratio(&self) -> f64 {
        self.across() * (PATCH - 1) as f64 / (1..PATCH).map(|at| self.mean(at)).sum::<f64>()
    }

    fn series(&self, name: &str) -> Series {
        Series { name: name.into(), points: (0..PATCH).map(|at| (at as f64, self.mean(at))).collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A few roundings of f32 values up to 1.
    const ROUNDING: f64 = 1e-5;

    #[test]
    fn a_step_at_a_border_is_a_jump_and_a_step_inside_is_none() {
        const SIDE: usize = 2 * PATCH;
        let image = |value: &dyn Fn(usize, usize) -> f32| -> Jumps {
            let mut jumps = Jumps::default();
            let pixels: Vec<[f32; 3]> = (0..SIDE * SIDE).map(|k| [value(k / SIDE, k % SIDE); 3]).collect();
            jumps.add(SIDE, &pixels);
            jumps
        };
        let step = |at: usize| image(&move |_, j| f32::from((j + at) % SIDE < PATCH));
        assert!(step(0).across() > 1.0 && step(1).across() == 0.0);
        // Noise has no preferred place.
        let noise = image(&|i, j| (crate::random::hash((i * SIDE + j) as u64) % 1000) as f32 / 1000.0);
        assert!((noise.ratio() - 1.0).abs() < 0.1, "{}", noise.ratio());
        let seams = image(&|i, j| if (i / PATCH + j / PATCH).is_multiple_of(2) { 0.5 } else { 0.0 });
        assert!((seams.across() - 1.5).abs() < ROUNDING && seams.mean(1) == 0.0);
    }
}
