//! Motion that is not there: flicker along arcs of the light and of the camera, and along a zoom.

use super::sequence::Sequence;
use crate::dataset::{Motion, SEQUENCES};
use crate::error::Result;
use crate::query::Reflectance;
use crate::report::figures::Series;
use crate::report::picture::strip;
use crate::stability::probe::{Bound, Group, Outcome, Plot, Probe};
use crate::stability::variants::{CALM, PRINTED, UNSMOOTHED};
use crate::stability::workshop::Workshop;

/// Degrees from frame to frame.
const STEPS: [f32; 2] = [1.0, 0.1];
/// Sub-samples of each half of a frame: of a tenth of a degree's motion more is noise.
const SPP: [usize; 2] = [32, 64];
/// What makes changes of a degree visible.
const GAIN: f32 = 2.0;

const OCTAVES: &str = "gamma(wi), gamma(wo) with 4 octaves and nothing else (paper)";
const STEEP: &str = "textures that were never smoothed";
const CURED: &str = "improved without gamma(u), offset smoothed by 3 texels, half the learning rate";
/// What the three models are.
const NAMES: [&str; 3] = ["naive", "improved", "cured"];
const FIGURE: &str =
    "error's energy of the change from frame to frame over the true change's, worst material and step";
const STILL: Bound = Bound::new(1.0, "1 is a picture that stands still; more is motion that is not there");
/// Of a camera on an arc.
const NEARLY: Bound = Bound {
    most: 2.0,
    reason: "1 is a picture that stands still. Gloss under a camera that moves by a tenth of a degree does not reach it; what was \
             reached is guarded",
    quick: Some(1.25),
};
/// Of a camera that comes closer.
const CLOSER: Bound = Bound {
    most: 1.5,
    reason: "1 is a picture that stands still. Gloss does not reach it at a tenth of a degree; what was reached is guarded",
    quick: Some(1.0),
};

pub(super) fn probes() -> Vec<Probe> {
    let probe = |name, provokes, naive, bound, run| Probe {
        name,
        group: Group::Motion,
        provokes,
        naive,
        cured: CURED,
        figure: FIGURE,
        bound,
        run,
    };
    vec![
        probe(
            "flicker-light",
            "As the light moves by 1 or 0.1 degrees, answers change more than the surface does, and elsewhere.",
            OCTAVES,
            STILL,
            |workshop| flicker(workshop, 0),
        ),
        probe(
            "flicker-camera",
            "As the camera moves by 1 or 0.1 degrees, pixels slide over texels: what the textures have of noise moves.",
            STEEP,
            NEARLY,
            |workshop| flicker(workshop, 1),
        ),
        probe(
            "flicker-zoom",
            "As the camera comes closer, levels and texels change under the pixels.",
            STEEP,
            CLOSER,
            |workshop| flicker(workshop, 2),
        ),
    ]
}

fn flicker(workshop: &mut Workshop, place: usize) -> Result<Outcome> {
    let materials = workshop.scale().materials.clone();
    let (side, frames) = (workshop.scale().resolution, workshop.scale().frames);
    let mut outcome = Outcome::new(0.0, 0.0);
    let mut series = Vec::new();
    let (mut largest, mut plain) = (0.0f64, 0.0f64);
    for material in &materials {
        let naive: &[&str] = if place == 0 { &PRINTED } else { &UNSMOOTHED };
        let naive = workshop.train(material, "improved", naive)?;
        let improved = workshop.train(material, "improved", &[])?;
        let cured = workshop.train(material, "improved", &CALM)?;
        let [naive, improved, cured] = [naive.sound()?, improved.sound()?, cured.sound()?];
        let models: [&dyn Reflectance; 3] = [&naive.material, &improved.material, &cured.material];
        let mut lines = [Vec::new(), Vec::new(), Vec::new()];
        for (model, name) in [&naive, &improved, &cured].into_iter().zip(NAMES) {
            if let Some(best) = &model.progress.best {
                outcome.values.push((format!("{material}, {name}: mse of validation"), best.errors.mse));
            }
        }
        for (step, spp) in STEPS.into_iter().zip(SPP) {
            let motion = Motion { frames, step };
            let sequence = Sequence::new(workshop, material, place, motion, side, spp)?;
            for (k, (model, name)) in models.into_iter().zip(NAMES).enumerate() {
                let moved = sequence.moved(model)?;
                let worst = [&mut outcome.naive, &mut plain, &mut outcome.cured];
                for worst in worst.into_iter().skip(k).take(1) {
                    // A flicker without number is the worst; f64::max would drop it.
                    *worst = if moved.flicker <= *worst { *worst } else { moved.flicker };
                }
                largest = largest.max(moved.error);
                lines[k].push((f64::from(step.log10()), moved.flicker));
                outcome.values.push((format!("{material}, {step} degrees, {name}"), moved.flicker));
                outcome.values.push((
                    format!("{material}, {step} degrees, {name}: motion over the true one's"),
                    moved.own,
                ));
            }
            if outcome.picture.is_none() {
                let shown = sequence.changes(&models, GAIN)?;
                let shown: Vec<_> = shown.iter().collect();
                let caption = format!(
                    "{}, {material}: change over {step} degrees around grey: naive, improved, cured, reference.",
                    SEQUENCES[place]
                );
                outcome.picture = Some((caption, strip(&shown, 0.0)?));
            }
        }
        for (points, name) in lines.into_iter().zip(NAMES) {
            series.push(Series { name: format!("{name}, {material}"), points });
        }
    }
    outcome.values.push(("worst, improved as it is".into(), plain));
    outcome.values.push(("largest standard error of a flicker".into(), largest));
    outcome.plot = Some(Plot { x: "log10 of the step in degrees".into(), y: "flicker".into(), series });
    Ok(outcome)
}
