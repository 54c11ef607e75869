//! Along directions: jitter on arcs, opposite grazing lights, glow at grazing angles.

use super::finding::{Bounds, Seen};
use super::numbers::worst;
use super::pictures::{Panel, strip};
use super::subject::{Pair, Questions, Subject, energy, grey, minus};
use super::{Check, Needs};
use crate::error::Result;
use crate::query::RgbImage;

/// Streams of what is drawn.
const ARCS: u64 = 6;
const OPPOSITE: u64 = 7;
const GLOW: u64 = 8;
/// Step of an arc in degrees, and steps.
const STEP: f32 = 0.1;
const LENGTH: usize = 48;
/// Arcs stay above this angle of the horizon.
const STEEPEST: f32 = 80.0;
/// Energy of steps, as a share of the answers', below which an arc is flat: ten times the rounding of f32 squared.
const FLAT: f64 = 1e-11;
/// Lights at these angles from the normal, one clearly seen and one where encodings may meet.
const SEEN: f32 = 60.0;
const GRAZING: f32 = 89.0;
/// Opposite lights that differ by less than this share of their energy tell nothing.
const ALIKE: f64 = 1e-3;
/// What counts as grazing for glow.
const GLOWING: f32 = 85.0;
/// The share of answers that is left out as the brightest: single peaks depend on which directions were drawn.
const BRIGHTEST: f64 = 1e-3;

pub(super) fn checks() -> Vec<Check> {
    let arc = |reason| Bounds { watch: 0.1, wrong: Some(0.5), reason };
    vec![
        Check {
            name: "light-arc",
            measures: "energy of second differences over that of first ones, along arcs of the light in steps of 0.1 degrees",
            bounds: arc(
                "a lobe of a degree has 0.01, noise has 3: above 0.1 motion is rough, above 0.5 it flickers",
            ),
            needs: Needs::Pointwise,
            run: |subject| arcs(subject, true),
        },
        Check {
            name: "camera-arc",
            measures: "the same along arcs of the view",
            bounds: arc("as for light-arc"),
            needs: Needs::Pointwise,
            run: |subject| arcs(subject, false),
        },
        Check {
            name: "opposite-lights",
            measures: "how much less lights from opposite sides differ at 89 degrees than at 60",
            bounds: Bounds {
                watch: 10.0,
                wrong: None,
                reason: "shadows grow towards the horizon, so that opposite lights differ more there and not less; a hint, since a \
                         flat surface answers both alike",
            },
            needs: Needs::Pointwise,
            run: opposite,
        },
        Check {
            name: "grazing-glow",
            measures: "brightest answers with light or view beyond 85 degrees over the brightest elsewhere",
            bounds: Bounds {
                watch: 4.0,
                wrong: Some(20.0),
                reason: "irradiance vanishes at the horizon; gloss can still shine there a few times brighter, not twenty times",
            },
            needs: Needs::Pointwise,
            run: glow,
        },
    ]
}

/// (x, y) of a direction at an angle from the normal.
fn at(degrees: f32, azimuth: f32) -> [f32; 2] {
    let radius = degrees.to_radians().sin();
    [radius * azimuth.cos(), radius * azimuth.sin()]
}

fn arcs(subject: &Subject, light: bool) -> Result<Seen> {
    let (arcs, positions) = (subject.choose(16, 64), subject.choose(96, 512));
    let mut questions = Questions::default();
    let ask =
        |random: &mut crate::random::Random, other: [f32; 2], u: [f32; 2], level: f32, to: &mut Questions| {
            let azimuth = std::f32::consts::TAU * random.uniform();
            let start = STEEPEST * (2.0 * random.uniform() - 1.0) - 0.5 * STEP * LENGTH as f32;
            (0..LENGTH).for_each(|k| {
                let moving = at((start + STEP * k as f32).clamp(-STEEPEST - 5.0, STEEPEST + 5.0), azimuth);
                let pair =
                    if light { Pair { wi: moving, wo: other } } else { Pair { wi: other, wo: moving } };
                to.push(u, pair, level);
            });
        };
    for arc in 0..arcs {
        let mut random = Subject::random(ARCS, 2 * arc + usize::from(light));
        let other = random.disc(0.8);
        let level = (arc % (subject.coarsest + 1)) as f32;
        for k in 0..positions {
            let mut of_place = Subject::random(ARCS, (arc + 1) << 20 | k);
            let u = [of_place.uniform(), of_place.uniform()];
            ask(&mut random.clone(), other, u, level, &mut questions);
        }
    }
    let answers = subject.ask(questions.clone())?;
    let (mut ratios, mut places) = (Vec::new(), Vec::new());
    let (mut first, mut second) = (0.0, 0.0);
    for (arc, of_arc) in answers.chunks(LENGTH * positions).enumerate() {
        let (mut steps, mut bends, mut own) = (0.0, 0.0, 0.0);
        let mut worst_place = (0.0, 0);
        for (k, line) in of_arc.chunks(LENGTH).enumerate() {
            let changes: Vec<[f32; 3]> = line.windows(2).map(|two| minus(two[1], two[0])).collect();
            let bend: f64 = changes.windows(2).map(|two| energy(minus(two[1], two[0]))).sum();
            steps += changes.iter().map(|change| energy(*change)).sum::<f64>();
            own += line.iter().map(|p| energy(*p)).sum::<f64>();
            bends += bend;
            if bend > worst_place.0 {
                worst_place = (bend, k);
            }
        }
        let steps = steps.max(FLAT * own).max(f64::MIN_POSITIVE);
        ratios.push(bends / steps);
        (first, second) = (first + steps, second + bends);
        let worst_at = (arc * positions + worst_place.1) * LENGTH + LENGTH / 2;
        places.push(questions.place(worst_at, bends / steps));
    }
    let of_all = second / first.max(f64::MIN_POSITIVE);
    let Some((arc, largest)) = worst(&ratios).first().copied() else { return Ok(Seen::nothing()) };
    let rows = &answers[arc * LENGTH * positions..][..LENGTH * positions];
    let image = RgbImage { height: positions, width: LENGTH, pixels: rows.to_vec() };
    // One column less: the last one has no next.
    let shown = super::pictures::cut(&image, [0, 0], LENGTH - 1);
    let next = super::pictures::cut(&image, [0, 1], LENGTH - 1);
    let png = strip(&[Panel::Light(&shown), Panel::Apart(&shown, &next)])?;
    let name = if light { "light" } else { "camera" };
    Ok(Seen {
        figure: of_all,
        says: format!(
            "as the {name} moves by 0.1 degrees, changes change by {of_all:.3} of themselves, {largest:.3} on the worst arc"
        ),
        change: "take fewer octaves of directions: train with --set model.encoding.wi.bands=0 --set model.encoding.wo.bands=0 and \
                 raw directions, as the preset improved does"
            .into(),
        values: [("worst arc".to_string(), largest)].into(),
        places: worst(&ratios).iter().map(|(arc, _)| places[*arc]).collect(),
        picture: Some((format!("The worst arc: a row a position, the {name} moves to the right; its steps."), png)),
        ..Seen::default()
    })
}

fn opposite(subject: &Subject) -> Result<Seen> {
    let positions = subject.choose(512, 4096);
    let mut apart = [0.0; 2];
    for (angle, sum) in [SEEN, GRAZING].into_iter().zip(&mut apart) {
        let mut questions = Questions::default();
        for k in 0..positions {
            let mut random = Subject::random(OPPOSITE, k);
            let (u, wo) = ([random.uniform(), random.uniform()], random.disc(0.5));
            let azimuth = std::f32::consts::FRAC_PI_2 * random.below(2) as f32;
            for side in [1.0, -1.0] {
                questions.push(u, Pair { wi: at(side * angle, azimuth), wo }, 0.0);
            }
        }
        let answers = subject.ask(questions)?;
        let (mut off, mut own) = (0.0, 0.0);
        for two in answers.chunks(2) {
            off += energy(minus(two[0], two[1]));
            own += energy(two[0]) + energy(two[1]);
        }
        *sum = if own > 0.0 { off / own } else { 0.0 };
    }
    let [seen, grazing] = apart;
    let figure = if seen > ALIKE { seen / grazing.max(f64::MIN_POSITIVE) } else { 0.0 };
    Ok(Seen {
        figure: figure.min(1e9),
        says: format!("opposite lights differ by {seen:.3} of their energy at 60 degrees and by {grazing:.3} at 89"),
        change: "give the decoder raw directions: --set model.encoding.wi.raw=true --set model.encoding.wo.raw=true; gamma alone is the \
                 same for opposite grazing lights"
            .into(),
        values: [("at 60 degrees".to_string(), seen), ("at 89 degrees".to_string(), grazing)].into(),
        ..Seen::default()
    })
}

fn glow(subject: &Subject) -> Result<Seen> {
    let count = subject.choose(1 << 15, 1 << 18);
    let limit = GLOWING.to_radians().sin();
    let mut brightest = [0.0; 2];
    let mut places = Vec::new();
    for (grazing, brightest) in [false, true].into_iter().zip(&mut brightest) {
        let mut questions = Questions::default();
        for k in 0..count {
            let mut random = Subject::random(GLOW, 2 * k + usize::from(grazing));
            let low = if grazing { limit } else { 0.0 };
            let high = if grazing { 0.9999 } else { limit };
            let mut direction = || {
                let radius = (low * low + (high * high - low * low) * random.uniform()).sqrt();
                let (sin, cos) = (std::f32::consts::TAU * random.uniform()).sin_cos();
                [radius * cos, radius * sin]
            };
            let (one, mut other) = (direction(), direction());
            if k % 3 == 0 {
                other = one.map(|v| -v);
            }
            // One of the two grazes, or both.
            if grazing && k % 3 == 1 {
                other = random.disc(limit * limit);
            }
            let pair = if k % 2 == 0 { Pair { wi: one, wo: other } } else { Pair { wi: other, wo: one } };
            let level = random.uniform() * subject.coarsest as f32;
            questions.push([random.uniform(), random.uniform()], pair, level);
        }
        let values: Vec<f64> = subject.ask(questions.clone())?.iter().map(|p| grey(*p)).collect();
        let mut sorted = values.clone();
        sorted.sort_by(f64::total_cmp);
        *brightest = sorted[((1.0 - BRIGHTEST) * (count - 1) as f64) as usize];
        if grazing {
            places = worst(&values).iter().map(|(k, v)| questions.place(*k, *v)).collect();
        }
    }
    let [elsewhere, grazing] = brightest;
    let figure = if grazing > 0.0 { grazing / elsewhere.max(1e-6) } else { 0.0 };
    Ok(Seen {
        figure,
        says: format!("beyond 85 degrees the brightest answers reach {grazing:.2}, elsewhere {elsewhere:.2}"),
        change: "train on data with more grazing pairs (generate --grazing-floor), or longer; until then keep such angles out of sight"
            .into(),
        values: [("beyond 85 degrees".to_string(), grazing), ("elsewhere".to_string(), elsewhere)].into(),
        places,
        picture: None,
        ..Seen::default()
    })
}
