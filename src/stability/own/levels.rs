//! Along levels: even steps, one mean, and coarse texels that are the mean of the fine ones below them.

use super::finding::{Bounds, Seen};
use super::numbers::worst;
use super::pictures::{Panel, strip};
use super::subject::{Pair, Questions, Subject, energy, grey, minus};
use super::{Check, Needs, advice};
use crate::error::Result;
use crate::query::RgbImage;
use std::collections::BTreeMap;

/// Stream of what is drawn.
const STEPS: u64 = 5;
const MEANS: u64 = 13;
const MEAN_PAIRS: u64 = 14;
/// Strata of positions along a side of the tile, for means.
const ACROSS: usize = 16;
/// Energy of what can be seen on a tile, over that of its mean: 5 % of contrast.
const SEEN: f64 = 0.0025;
/// Parts of a level.
const PARTS: usize = 8;
/// An octave that changes less than this share of the answers' energy is flat.
const FLAT: f64 = 1e-5;

pub(super) fn checks() -> Vec<Check> {
    vec![
        Check {
            name: "popping",
            measures: "largest step along an eighth of a level, times 8, over the change along the whole level, worst octave",
            bounds: Bounds {
                watch: 4.0,
                wrong: Some(6.0),
                reason: "even steps have 1, a random walk 2.8, a jump 8",
            },
            needs: Needs::Pointwise,
            run: popping,
        },
        Check {
            name: "level-means",
            measures: "stops between the tile's mean at a level and at the finest one under the same directions, worst level",
            bounds: Bounds {
                watch: 0.2,
                wrong: Some(0.5),
                reason: "a level's answers are averages of the finest one's, so that their means agree; a fifth of a stop is seen \
                         in a zoom, half a stop by anyone",
            },
            needs: Needs::Anything,
            run: means,
        },
        Check {
            name: "level-pairs",
            measures: "energy of the difference between a level's texels and the mean of the 2 x 2 below each, over that of what \
                       the level shows, worst level",
            bounds: Bounds {
                watch: 1.0,
                wrong: None,
                reason: "at 1 the coarser level shows nothing of what the finer one does, or as much that it does not; a hint, since few \
                         texels are left on coarse levels",
            },
            needs: Needs::Anything,
            run: consistency,
        },
    ]
}

fn popping(subject: &Subject) -> Result<Seen> {
    let pairs = subject.pairs(subject.choose(12, 32));
    let positions = subject.choose(256, 1024);
    let steps = subject.coarsest * PARTS;
    if steps == 0 {
        return Ok(Seen::left_out("there is one level only"));
    }
    let mut questions = Questions::default();
    for (p, pair) in pairs.iter().enumerate() {
        for k in 0..positions {
            let mut random = Subject::random(STEPS, p * positions + k);
            let u = [random.uniform(), random.uniform()];
            (0..=steps).for_each(|step| questions.push(u, *pair, step as f32 / PARTS as f32));
        }
    }
    let answers = subject.ask(questions.clone())?;
    let (mut small, mut large) = (vec![0.0; steps], vec![0.0; subject.coarsest]);
    let mut own = 0.0;
    let mut worst_step = vec![(0.0, 0); subject.coarsest];
    for (k, line) in answers.chunks(steps + 1).enumerate() {
        own += energy(line[0]);
        for (s, two) in line.windows(2).enumerate() {
            let step = energy(minus(two[1], two[0]));
            small[s] += step;
            let worst_step = &mut worst_step[s / PARTS];
            if step > worst_step.0 {
                *worst_step = (step, k * (steps + 1) + s);
            }
        }
        for (octave, change) in large.iter_mut().enumerate() {
            *change += energy(minus(line[(octave + 1) * PARTS], line[octave * PARTS]));
        }
    }
    let ratio = |octave: usize| {
        let largest = small[octave * PARTS..][..PARTS].iter().copied().fold(0.0, f64::max);
        PARTS as f64 * (largest / large[octave].max(FLAT * own).max(f64::MIN_POSITIVE)).sqrt()
    };
    let ratios: Vec<f64> = (0..subject.coarsest).map(ratio).collect();
    let Some((octave, figure)) = worst(&ratios).first().copied() else { return Ok(Seen::nothing()) };
    let places: Vec<_> = worst(&ratios)
        .iter()
        .map(|(octave, _)| questions.place(worst_step[*octave].1, worst_step[*octave].0.sqrt()))
        .collect();
    let pair = Pair { wi: places[0].wi, wo: places[0].wo };
    let [height, width] = subject.grid(octave);
    let frame = |part: usize| -> Result<RgbImage> {
        let level = octave as f32 + part as f32 / 4.0;
        let queries = crate::query::QueryBuffer::slice(height, width, pair.wi, pair.wo, level);
        subject.material.evaluate(&queries)
    };
    let frames = (0..=4).map(frame).collect::<Result<Vec<_>>>()?;
    let png = strip(&frames.iter().map(Panel::Light).collect::<Vec<_>>())?;
    Ok(Seen {
        figure,
        says: format!(
            "between level {octave} and {} the largest of 8 steps is {figure:.1} times an even one",
            octave + 1
        ),
        change: "train on data with fractional levels (neumip generate without --regime slices), so that levels learn to blend"
            .into(),
        values: ratios.iter().enumerate().map(|(l, v)| (format!("from level {l}"), *v)).collect(),
        places,
        picture: Some((format!("Level {octave} to {} in quarters.", octave + 1), png)),
        ..Seen::default()
    })
}

/// Tiles of all levels under one pair.
fn pyramid(subject: &Subject, pair: Pair, levels: &[usize]) -> Result<Vec<RgbImage>> {
    levels.iter().map(|level| subject.tile(pair, *level)).collect()
}

fn mean(image: &RgbImage) -> f64 {
    image.pixels.iter().map(|p| grey(*p)).sum::<f64>() / image.pixels.len().max(1) as f64
}

/// Levels that are compared, and pairs under which: an answerer that reads neighbours takes tens of times longer.
fn compared(subject: &Subject) -> (Vec<usize>, Vec<Pair>) {
    match subject.is_pointwise() {
        true => ((0..=subject.coarsest).collect(), subject.pairs(subject.choose(8, 32))),
        false => (subject.whole_levels(), subject.pairs(subject.choose(3, 12))),
    }
}

/// Sums of all answers level by level, each under the same pairs: over random positions, or over whole tiles.
fn sums(subject: &Subject, levels: &[usize], pairs: &[Pair]) -> Result<Vec<Vec<f64>>> {
    if !subject.is_pointwise() {
        let of_pair = |pair: &Pair| Ok(pyramid(subject, *pair, levels)?.iter().map(mean).collect());
        return pairs.iter().map(of_pair).collect();
    }
    let mut questions = Questions::default();
    for (p, pair) in pairs.iter().enumerate() {
        for level in levels {
            for k in 0..ACROSS * ACROSS {
                let mut random = Subject::random(MEANS, p * ACROSS * ACROSS + k);
                let u = [k % ACROSS, k / ACROSS].map(|i| (i as f32 + random.uniform()) / ACROSS as f32);
                questions.push(u, *pair, *level as f32);
            }
        }
    }
    let answers = subject.ask(questions)?;
    let mean = |part: &[[f32; 3]]| part.iter().map(|p| grey(*p)).sum::<f64>() / part.len() as f64;
    let per = ACROSS * ACROSS;
    Ok(answers.chunks(per * levels.len()).map(|of_pair| of_pair.chunks(per).map(mean).collect()).collect())
}

fn means(subject: &Subject) -> Result<Seen> {
    let levels = compared(subject).0;
    let count = if subject.is_pointwise() { subject.choose(256, 2048) } else { subject.choose(3, 12) };
    // Evenly over the directions, as light falls: near the mirror direction alone a peak's width would decide.
    let pair = |k: usize| {
        let mut random = Subject::random(MEAN_PAIRS, k);
        Pair { wi: Subject::direction(&mut random), wo: Subject::direction(&mut random) }
    };
    let pairs: Vec<Pair> = (0..count).map(pair).collect();
    let mut total = vec![0.0; levels.len()];
    // Of the pair that loses or gains most light at each level.
    let mut worst_pair = vec![(0.0, pairs[0]); levels.len()];
    for (pair, means) in pairs.iter().zip(sums(subject, &levels, &pairs)?) {
        for (k, mean) in means.iter().enumerate() {
            total[k] += mean;
            if (mean - means[0]).abs() > worst_pair[k].0 {
                worst_pair[k] = ((mean - means[0]).abs(), *pair);
            }
        }
    }
    let finest = total[0];
    if finest <= 0.0 {
        return Ok(Seen { says: "the material is black".into(), ..Seen::default() });
    }
    let stops: Vec<f64> = total.iter().map(|sum| (sum / finest).log2().abs()).collect();
    let Some((at, figure)) = worst(&stops).first().copied() else { return Ok(Seen::nothing()) };
    let place = |k: usize| {
        let mut questions = Questions::default();
        questions.push([0.0, 0.0], worst_pair[k].1, levels[k] as f32);
        questions.place(0, total[k] / finest)
    };
    let tiles = pyramid(subject, worst_pair[at].1, &levels)?;
    let png = strip(&tiles.iter().map(Panel::Light).collect::<Vec<_>>())?;
    let change = if total[at] < finest { "darker" } else { "brighter" };
    Ok(Seen {
        figure,
        says: format!(
            "level {} is {:.1} % {change} than the finest one on the whole",
            levels[at],
            100.0 * (total[at] / finest - 1.0).abs()
        ),
        change: advice::means(subject.checkpoint),
        values: levels
            .iter()
            .zip(&total)
            .map(|(l, sum)| (format!("level {l} over level 0"), sum / finest))
            .collect(),
        places: worst(&stops).iter().filter(|w| w.1 > 0.0).map(|(k, _)| place(*k)).collect(),
        picture: Some(("All levels, finest first, under the directions that change most.".into(), png)),
        ..Seen::default()
    })
}

/// Means of 2 x 2 pixels; none where sides are odd.
fn halved(image: &RgbImage) -> Option<RgbImage> {
    let (height, width) = (image.height / 2, image.width / 2);
    if image.height != 2 * height || image.width != 2 * width || height == 0 || width == 0 {
        return None;
    }
    let at = |i: usize, j: usize, c: usize| image.pixels[i * image.width + j][c];
    let pixel = |k: usize| {
        let (i, j) = (2 * (k / width), 2 * (k % width));
        [0, 1, 2].map(|c| 0.25 * (at(i, j, c) + at(i, j + 1, c) + at(i + 1, j, c) + at(i + 1, j + 1, c)))
    };
    Some(RgbImage { height, width, pixels: (0..height * width).map(pixel).collect() })
}

fn consistency(subject: &Subject) -> Result<Seen> {
    let (levels, pairs) = compared(subject);
    let (mut apart, mut shown) = (vec![0.0; levels.len()], vec![0.0; levels.len()]);
    let mut worst_pair = vec![(0.0, pairs[0]); levels.len()];
    for pair in &pairs {
        let tiles = pyramid(subject, *pair, &levels)?;
        for (k, two) in tiles.windows(2).enumerate() {
            let Some(fine) = halved(&two[0]) else { continue };
            // Means are another check's.
            let (mean_fine, mean_coarse) = (centre(&fine), centre(&two[1]));
            let (mut off, mut own) = (0.0, 0.0);
            for (a, b) in fine.pixels.iter().zip(&two[1].pixels) {
                let (a, b) = (minus(*a, mean_fine), minus(*b, mean_coarse));
                off += energy(minus(a, b));
                own += energy(a);
            }
            apart[k] += off / fine.pixels.len() as f64;
            shown[k] += own / fine.pixels.len() as f64 + SEEN * energy(mean_fine);
            if off > worst_pair[k].0 {
                worst_pair[k] = (off, *pair);
            }
        }
    }
    let ratios: Vec<f64> =
        apart.iter().zip(&shown).map(|(a, s)| if *s > 0.0 { a / s } else { 0.0 }).collect();
    let Some((at, figure)) = worst(&ratios).first().copied() else { return Ok(Seen::nothing()) };
    let pair = worst_pair[at].1;
    let picture = match (halved(&subject.tile(pair, levels[at])?), levels.get(at + 1)) {
        (Some(fine), Some(next)) => {
            let coarse = subject.tile(pair, *next)?;
            let png = strip(&[Panel::Light(&fine), Panel::Light(&coarse), Panel::Apart(&fine, &coarse)])?;
            Some((
                format!("Level {} averaged over 2 x 2 texels, level {next}, the difference.", levels[at]),
                png,
            ))
        }
        _ => None,
    };
    let mut questions = Questions::default();
    questions.push([0.0, 0.0], pair, levels[at] as f32 + 1.0);
    let named = ratios.iter().zip(&levels).take(levels.len().saturating_sub(1));
    Ok(Seen {
        figure,
        says: format!(
            "level {} differs from the mean of level {} by {figure:.2} of what it shows",
            levels[at] + 1,
            levels[at]
        ),
        change: "train longer; a coarse level that few samples show learns last".into(),
        values: named.map(|(v, l)| (format!("level {} of level {l}", l + 1), *v)).collect::<BTreeMap<_, _>>(),
        places: vec![questions.place(0, figure)],
        picture,
        ..Seen::default()
    })
}

fn centre(image: &RgbImage) -> [f32; 3] {
    let n = image.pixels.len().max(1) as f64;
    [0, 1, 2].map(|c| (image.pixels.iter().map(|p| f64::from(p[c])).sum::<f64>() / n) as f32)
}
