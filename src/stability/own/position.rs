//! Between texels and across the tile's border.

use super::finding::{Bounds, Seen};
use super::numbers::worst;
use super::pictures::{Panel, cut, strip};
use super::subject::{Pair, Questions, Subject, energy, minus};
use super::{Check, Needs, advice};
use crate::error::Result;
use crate::query::RgbImage;
use std::collections::BTreeMap;

/// Stream of what is drawn.
const CELLS: u64 = 4;
/// Half of a step across a line between texels, in texels.
const BESIDE: f32 = 1.0 / 16.0;
/// Rows that are crossed.
const ROWS: usize = 48;
/// Fewer lines inside the tile have no usual step.
const LEAST_LINES: usize = 8;
/// Positions in a cell between four texel centres.
const WITHIN: [[f32; 2]; 5] = [[0.5, 0.0], [0.0, 0.5], [0.5, 0.5], [0.25, 0.0], [0.0, 0.25]];
/// Its corners: the texel centres.
const CORNERS: [[f32; 2]; 4] = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]];
/// Levels of fewer texels along a side have too few steps to tell what is usual.
const LEAST_SIDE: usize = 4;
/// Steps of less energy than this share of the answers' own are flat, and flat is smooth.
const FLAT: f64 = 1e-5;
/// Texels along a side of a picture, and pixels a texel.
const SHOWN: usize = 24;
const DENSER: usize = 4;

pub(super) fn checks() -> Vec<Check> {
    vec![
        Check {
            name: "seam",
            measures: "mean step across the tile's border over the largest mean step across any other line between texels",
            bounds: Bounds {
                watch: 1.25,
                wrong: Some(2.0),
                reason: "a tile repeats, so that its border is a line as any other: it is the largest of all by chance, but not by \
                         far",
            },
            needs: Needs::Pointwise,
            run: seam,
        },
        Check {
            name: "between-texels",
            measures: "energy of answers between texel centres around the line through their neighbours, over that of the steps \
                       between centres, worst level",
            bounds: Bounds {
                watch: 0.5,
                wrong: Some(1.0),
                reason: "white noise seen through the footprint has 0.25, and twice that is left to training; at 1 answers between \
                         texels stray as far as neighbours differ",
            },
            needs: Needs::Pointwise,
            run: between,
        },
    ]
}

/// Mean steps of one pair at one level across the lines of an axis, the border first.
fn steps(subject: &Subject, pair: Pair, level: usize, axis: usize) -> Result<Vec<f64>> {
    let [height, width] = subject.grid(level);
    let [lines, along] = if axis == 0 { [width, height] } else { [height, width] };
    let rows = along.min(ROWS);
    let mut questions = Questions::default();
    for line in 0..lines {
        for row in 0..rows {
            let other = ((row * along / rows) as f32 + 0.5) / along as f32;
            for side in [-BESIDE, BESIDE] {
                let across = (line as f32 + side) / lines as f32;
                questions.push(if axis == 0 { [across, other] } else { [other, across] }, pair, level as f32);
            }
        }
    }
    let answers = subject.ask(questions)?;
    let step = |two: &[[f32; 3]]| energy(minus(two[0], two[1])).sqrt();
    Ok(answers.chunks(2 * rows).map(|line| line.chunks(2).map(step).sum::<f64>() / rows as f64).collect())
}

fn seam(subject: &Subject) -> Result<Seen> {
    let pairs = subject.pairs(subject.choose(6, 18));
    let mut found = Vec::new();
    for level in 0..=subject.coarsest {
        for (axis, side) in [(0, "left"), (1, "upper")] {
            let mut sums: Vec<f64> = Vec::new();
            let mut worst_pair = (0.0, pairs[0]);
            for pair in &pairs {
                let lines = steps(subject, *pair, level, axis)?;
                sums.resize(lines.len(), 0.0);
                sums.iter_mut().zip(&lines).for_each(|(sum, line)| *sum += line);
                if lines[0] > worst_pair.0 {
                    worst_pair = (lines[0], *pair);
                }
            }
            if sums.len() > LEAST_LINES {
                let inside = &sums[1..];
                let most = inside.iter().copied().fold(0.0, f64::max);
                let mean = inside.iter().sum::<f64>() / inside.len() as f64;
                // A flat tile has no steps to compare with.
                let least = f64::from(f32::EPSILON) * pairs.len() as f64;
                found.push((
                    sums[0] / most.max(least),
                    sums[0] / mean.max(least),
                    level,
                    side,
                    axis,
                    worst_pair.1,
                ));
            }
        }
    }
    let ratios: Vec<f64> = found.iter().map(|f| f.0).collect();
    let Some((k, figure)) = worst(&ratios).first().copied() else {
        return Ok(Seen::nothing());
    };
    let (_, mean, level, side_name, axis, pair) = found[k];
    let beside = if axis == 0 { [0.0, 0.5] } else { [0.5, 0.0] };
    let fine = around(subject, pair, level, beside, DENSER)?;
    let side = fine.height - 1;
    let (shown, next) = (cut(&fine, [0, 0], side), cut(&fine, if axis == 0 { [0, 1] } else { [1, 0] }, side));
    let png = strip(&[Panel::Light(&shown), Panel::Apart(&shown, &next)])?;
    let caption = format!(
        "Level {level}, asked {DENSER} x denser, the {side_name} border in the middle; the steps between neighbours."
    );
    let mut at = Questions::default();
    at.push([0.0, 0.0], pair, level as f32);
    Ok(Seen {
        figure,
        says: if figure > 1.25 {
            format!(
                "the tile has a seam along its {side_name} border at level {level}: {mean:.1} times the mean step inside, {figure:.1} times the largest"
            )
        } else {
            format!(
                "no seam: the border is crossed in at most {mean:.1} times the mean step inside, {figure:.1} times the largest"
            )
        },
        change: advice::seam(subject.checkpoint),
        values: BTreeMap::from([("over the mean step inside".into(), mean)]),
        places: vec![at.place(0, figure)],
        picture: Some((caption, png)),
        ..Seen::default()
    })
}

fn between(subject: &Subject) -> Result<Seen> {
    let pairs = subject.pairs(subject.choose(6, 16));
    let cells = subject.choose(512, 2048);
    let per = CORNERS.len() + WITHIN.len();
    let (mut ratios, mut places) = (Vec::new(), Vec::new());
    for level in 0..=subject.coarsest {
        let [height, width] = subject.grid(level);
        if height.min(width) < LEAST_SIDE {
            break;
        }
        let mut questions = Questions::default();
        for (p, pair) in pairs.iter().enumerate() {
            for k in 0..cells {
                let mut random = Subject::random(CELLS, (level * pairs.len() + p) * cells + k);
                let cell = [random.below(width), random.below(height)];
                for at in CORNERS.iter().chain(&WITHIN) {
                    let place = |axis: usize, side: usize| (cell[axis] as f32 + 0.5 + at[axis]) / side as f32;
                    questions.push([place(0, width), place(1, height)], *pair, level as f32);
                }
            }
        }
        let answers = subject.ask(questions.clone())?;
        let (mut residual, mut step, mut own) = (0.0, 0.0, 0.0);
        let mut worst_cell = (0.0, 0);
        for (k, cell) in answers.chunks(per).enumerate() {
            let (corners, within) = cell.split_at(CORNERS.len());
            let off = WITHIN
                .iter()
                .zip(within)
                .map(|(at, v)| energy(minus(*v, bilinear(corners, *at))))
                .sum::<f64>()
                / WITHIN.len() as f64;
            residual += off;
            step += 0.5 * (energy(minus(corners[1], corners[0])) + energy(minus(corners[2], corners[0])));
            own += energy(corners[0]);
            if off > worst_cell.0 {
                worst_cell = (off, k);
            }
        }
        ratios.push(residual / step.max(FLAT * own).max(f64::MIN_POSITIVE));
        places.push(questions.place(worst_cell.1 * per, worst_cell.0.sqrt()));
    }
    let Some((level, figure)) = worst(&ratios).first().copied() else { return Ok(Seen::nothing()) };
    let place = places[level];
    let png = picture(subject, Pair { wi: place.wi, wo: place.wo }, level, place.u)?;
    let caption = format!(
        "Level {level} around the worst place: texel centres interpolated, the material asked {DENSER} x denser, the difference."
    );
    Ok(Seen {
        figure,
        says: format!(
            "between the texels of level {level} answers leave the line through their neighbours by {figure:.2} of the steps' energy"
        ),
        change: advice::between(subject.checkpoint),
        values: ratios.iter().enumerate().map(|(l, v)| (format!("level {l}"), *v)).collect(),
        places: worst(&ratios).iter().map(|(level, _)| places[*level]).collect(),
        picture: Some((caption, png)),
        ..Seen::default()
    })
}

/// What four corners have between them.
fn bilinear(corners: &[[f32; 3]], [x, y]: [f32; 2]) -> [f32; 3] {
    let weights = [(1.0 - x) * (1.0 - y), x * (1.0 - y), (1.0 - x) * y, x * y];
    [0, 1, 2].map(|c| corners.iter().zip(weights).map(|(corner, w)| w * corner[c]).sum())
}

/// Answers of some texels around a position, so many times denser than texels, from a texel's centre on.
fn around(subject: &Subject, pair: Pair, level: usize, centre: [f32; 2], denser: usize) -> Result<RgbImage> {
    let [height, width] = subject.grid(level);
    let across = SHOWN.min(height).min(width);
    let first = [(centre[0] * width as f32) as i64, (centre[1] * height as f32) as i64];
    let first = first.map(|c| c - across as i64 / 2);
    let side = across * denser;
    let mut questions = Questions::default();
    for k in 0..side * side {
        let at = |axis: usize, index: usize, texels: usize| {
            (first[axis] as f32 + 0.5 + index as f32 / denser as f32) / texels as f32
        };
        questions.push([at(0, k % side, width), at(1, k / side, height)], pair, level as f32);
    }
    Ok(RgbImage { height: side, width: side, pixels: subject.ask(questions)? })
}

fn picture(subject: &Subject, pair: Pair, level: usize, centre: [f32; 2]) -> Result<Vec<u8>> {
    let image = |denser: usize| around(subject, pair, level, centre, denser);
    let (coarse, fine) = (image(1)?, image(DENSER)?);
    let mut smooth = fine.clone();
    for (k, pixel) in smooth.pixels.iter_mut().enumerate() {
        let [i, j] = [k / fine.width, k % fine.width];
        let part = cut(&coarse, [i / DENSER, j / DENSER], 2);
        // The last cell has no far corner in the picture.
        let inner = |at: usize| {
            if at / DENSER + 1 < coarse.width { (at % DENSER) as f32 / DENSER as f32 } else { 0.0 }
        };
        *pixel = if part.pixels.len() == 4 {
            bilinear(&part.pixels, [inner(j), inner(i)])
        } else {
            part.pixels[0]
        };
    }
    strip(&[Panel::Light(&smooth), Panel::Light(&fine), Panel::Apart(&smooth, &fine)])
}
