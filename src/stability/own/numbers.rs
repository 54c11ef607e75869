//! Answers that are no colours: no number, below 0, light below the horizon, levels and tiles that are not clamped.

use super::finding::{Bounds, Seen};
use super::subject::{Pair, Questions, Subject, energy, minus};
use super::{Check, Needs};
use crate::error::Result;
use crate::query::{QueryBuffer, RgbImage};

/// Streams of what is drawn.
const RANDOM: u64 = 1;
const HORIZON: u64 = 2;
const LEVELS: u64 = 3;
/// Faults that are counted before the search ends: a material that is wrong everywhere is known by then.
const ENOUGH: usize = 64;
/// Queries that are asked together.
const TOGETHER: usize = 1 << 15;
/// Places that are named.
const NAMED: usize = 4;
/// Steps of positions whose sum with a far whole number is exact in f32.
const EXACT: usize = 512;
/// Far away, in tiles.
const FAR: f32 = 1e4;
/// Rounding of positions within the tile, in answers: a wrapped position is the same to a few units in the last place.
const SAME: f64 = 1e-3;

pub(super) fn checks() -> Vec<Check> {
    let none = |reason| Bounds { watch: 0.0, wrong: Some(0.0), reason };
    vec![
        Check {
            name: "numbers",
            measures: "answers that are no number or below 0, over random and adversarial queries",
            bounds: none(
                "one such answer is a black or burning pixel, and spreads through a renderer's filters",
            ),
            needs: Needs::Anything,
            run: numbers,
        },
        Check {
            name: "horizon",
            measures: "largest answer with light or view on or below the horizon",
            bounds: none("no light comes from there"),
            needs: Needs::Pointwise,
            run: horizon,
        },
        Check {
            name: "range",
            measures: "largest difference of answers below level 0, beyond the last level and many tiles away, from those within",
            bounds: Bounds {
                watch: SAME,
                wrong: Some(10.0 * SAME),
                reason: "they are the same queries; only the rounding of positions may show",
            },
            needs: Needs::Pointwise,
            run: range,
        },
    ]
}

/// A direction, at times exactly along an axis, within rounding of the horizon, or straight up.
fn direction(random: &mut crate::random::Random) -> [f32; 2] {
    match random.below(8) {
        0 => [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]][random.below(4)].map(|v: f32| v * 0.999_999),
        1 => {
            let (sin, cos) = (std::f32::consts::TAU * random.uniform()).sin_cos();
            let radius = 1.0 - 10f32.powf(-1.0 - 6.0 * random.uniform());
            [radius * cos, radius * sin]
        }
        2 => [0.0; 2],
        _ => random.disc(0.9999),
    }
}

fn adversarial(subject: &Subject, k: usize) -> ([f32; 2], Pair, f32) {
    let mut random = Subject::random(RANDOM, k);
    let (wi, wo) = (direction(&mut random), direction(&mut random));
    let coordinate = |random: &mut crate::random::Random| match random.below(8) {
        0 => [0.0, 1.0, -1.0, 0.5, 1.0 - f32::EPSILON / 2.0, 1e-38][random.below(6)],
        1 => FAR * (2.0 * random.uniform() - 1.0),
        _ => random.uniform(),
    };
    let u = [coordinate(&mut random), coordinate(&mut random)];
    let coarsest = subject.coarsest as f32;
    let level = match random.below(8) {
        0 => [-1e6, -1.0, coarsest + 1.0, 1e6][random.below(4)],
        1 => random.below(subject.coarsest + 1) as f32,
        _ => random.uniform() * coarsest,
    };
    // Half of all pairs mirror each other: peaks are there.
    let wi = if random.below(2) == 0 { wo.map(|v| -v) } else { wi };
    (u, Pair { wi, wo }, level)
}

fn numbers(subject: &Subject) -> Result<Seen> {
    let mut bad = Vec::new();
    let mut asked = 0;
    if subject.is_pointwise() {
        let total = subject.choose(1_000_000, 10_000_000);
        while asked < total && bad.len() < ENOUGH {
            let mut questions = Questions::default();
            let end = (asked + TOGETHER).min(total);
            for k in asked..end {
                let (u, pair, level) = adversarial(subject, k);
                questions.push(u, pair, level);
            }
            faults(subject, &questions.buffer()?, &mut bad)?;
            asked = end;
        }
    } else {
        let levels = subject.whole_levels();
        for k in 0..subject.choose(4, 64) {
            let (_, pair, _) = adversarial(subject, k);
            let level = levels.get(k % levels.len().max(1)).copied().unwrap_or(0);
            let [height, width] = subject.grid(level);
            let tile = QueryBuffer::slice(height, width, pair.wi, pair.wo, level as f32);
            asked += tile.len();
            if subject.material.evaluate(&tile).is_ok_and(|image| image.pixels.iter().all(is_colour)) {
                continue;
            }
            bad.push((pair, level as f32, tile.u[0]));
        }
    }
    let many = if bad.len() >= ENOUGH { "at least " } else { "" };
    let says = match bad.len() {
        0 => format!("all of {asked} answers are numbers and none is below 0"),
        n => format!("{many}{n} of {asked} answers are no number or below 0"),
    };
    let place = |(pair, level, u): &(Pair, f32, [f32; 2])| {
        let mut at = Questions::default();
        at.push(*u, *pair, *level);
        at.place(0, f64::NAN)
    };
    Ok(Seen {
        figure: bad.len() as f64,
        says,
        change: "train again with a lower --learning-rate, and clip weights that are beyond half floats; do not ship this one".into(),
        places: bad.iter().take(NAMED).map(place).collect(),
        ..Seen::default()
    })
}

fn is_colour(pixel: &[f32; 3]) -> bool {
    pixel.iter().all(|v| v.is_finite() && *v >= 0.0)
}

/// Adds the queries whose answers are no colours; an answerer that refuses all because of one is asked for halves.
fn faults(subject: &Subject, asked: &QueryBuffer, bad: &mut Vec<(Pair, f32, [f32; 2])>) -> Result<()> {
    let mut waiting = vec![(0, asked.len())];
    while let Some((start, end)) = waiting.pop() {
        if bad.len() >= ENOUGH || start == end {
            return Ok(());
        }
        let mut add =
            |k: usize| bad.push((Pair { wi: asked.wi[k], wo: asked.wo[k] }, asked.level[k], asked.u[k]));
        match subject.material.evaluate(&asked.range(start, end)) {
            Ok(RgbImage { pixels, .. }) => {
                pixels.iter().enumerate().filter(|(_, p)| !is_colour(p)).for_each(|(k, _)| add(start + k));
            }
            Err(_) if end - start == 1 => add(start),
            Err(_) => {
                let half = start + (end - start) / 2;
                waiting.extend([(half, end), (start, half)]);
            }
        }
    }
    Ok(())
}

fn horizon(subject: &Subject) -> Result<Seen> {
    let mut questions = Questions::default();
    for k in 0..subject.choose(4096, 65_536) {
        let mut random = Subject::random(HORIZON, k);
        let (sin, cos) = (std::f32::consts::TAU * random.uniform()).sin_cos();
        let radius = [1.000_001, 1.0 + random.uniform()][k / 2 % 2];
        let (below, above) = ([radius * cos, radius * sin], Subject::direction(&mut random));
        let pair = if k % 2 == 0 { Pair { wi: below, wo: above } } else { Pair { wi: above, wo: below } };
        questions.push(
            [random.uniform(), random.uniform()],
            pair,
            random.uniform() * subject.coarsest as f32,
        );
    }
    let answers = subject.ask(questions.clone())?;
    let worst = worst(&answers.iter().map(|p| energy(*p).sqrt()).collect::<Vec<_>>());
    Ok(Seen {
        figure: worst.first().map_or(0.0, |w| w.1),
        says: match worst.first() {
            Some((_, value)) if *value > 0.0 => {
                format!("answers of up to {value:.3} come from below the horizon")
            }
            _ => "answers on and below the horizon are 0".into(),
        },
        change: "this is a fault of the evaluator, not of the training: report it".into(),
        places: worst.iter().filter(|w| w.1 > 0.0).map(|(k, value)| questions.place(*k, *value)).collect(),
        ..Seen::default()
    })
}

fn range(subject: &Subject) -> Result<Seen> {
    let (mut outside, mut inside) = (Questions::default(), Questions::default());
    let coarsest = subject.coarsest as f32;
    for k in 0..subject.choose(4096, 65_536) {
        let mut random = Subject::random(LEVELS, k);
        let pair = Pair { wi: Subject::direction(&mut random), wo: Subject::direction(&mut random) };
        let u = [0; 2].map(|_| random.below(EXACT) as f32 / EXACT as f32);
        let within = random.uniform() * coarsest;
        let far = [[FAR, 0.0], [0.0, -FAR], [1.0, 1.0]][k / 4 % 3];
        let (level, clamped, away) = match k % 4 {
            0 => ([-0.5, -1e6][k / 4 % 2], 0.0, [0.0; 2]),
            1 => (coarsest + [0.5, 1e6][k / 4 % 2], coarsest, [0.0; 2]),
            _ => (within, within, far),
        };
        outside.push([u[0] + away[0], u[1] + away[1]], pair, level);
        inside.push(u, pair, clamped);
    }
    let (a, b) = (subject.ask(outside.clone())?, subject.ask(inside)?);
    let apart: Vec<f64> =
        a.iter().zip(&b).map(|(a, b)| energy(minus(*a, *b)).sqrt() / (1.0 + energy(*b).sqrt())).collect();
    let worst = worst(&apart);
    let figure = worst.first().map_or(0.0, |w| w.1);
    Ok(Seen {
        figure,
        says: format!(
            "levels outside 0 to {coarsest} and positions {FAR:.0} tiles away answer as their clamped and wrapped ones, to {figure:.1e}"
        ),
        change: "train with --set model.encoding.pi=true and --set model.encoding.u.raw=false: then the model repeats".into(),
        places: worst.iter().filter(|w| w.1 > SAME).map(|(k, v)| outside.place(*k, *v)).collect(),
        ..Seen::default()
    })
}

/// The indices of the largest values, worst first; what is no number is worst of all.
pub(super) fn worst(values: &[f64]) -> Vec<(usize, f64)> {
    let mut order: Vec<(usize, f64)> = values.iter().copied().enumerate().collect();
    let rank = |v: f64| if v.is_nan() { f64::INFINITY } else { v };
    order.sort_by(|a, b| rank(b.1).total_cmp(&rank(a.1)).then(a.0.cmp(&b.0)));
    order.truncate(NAMED);
    order
}
