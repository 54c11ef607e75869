//! Training data for a scene: patches around what it asks, and a floor of everything else.
//!
//! Positions are those of the window, whose tile the dataset takes for its own. Blocks of the level above the fitted ones hold
//! the average of the whole tile, which answers outside of the window.

use super::need::Need;
use super::truth::Truth;
use crate::dataset::{Block, Dataset, Existing, Layout, Manifest, Patch, SplitName, Writer};
use crate::error::{Error, Result};
use crate::query::QueryBuffer;
use crate::random::{Random, Stream};
use crate::render::Demand;
use half::f16;
use rayon::prelude::*;
use serde_json::json;
use std::ops::ControlFlow;
use std::path::Path;

/// Samples along a side of a block.
const SIDE: usize = 32;
/// Samples along a side of a patch: the least that a gradient sees more than once.
const PATCH: usize = 4;
/// Patches of a block.
const PATCHES: usize = (SIDE / PATCH) * (SIDE / PATCH);
/// Blocks of a file, which is what is measured at a time.
const FILE: usize = 256;
/// Share of the floor that teaches a window's last level the average of the tile.
const AVERAGE: f64 = 0.25;
/// Standard deviation of what is added to asked directions: a scene's light and camera are not known to the last digit.
const JITTER: f32 = 0.01;
/// Squared radius of the floor's directions: up to 84 degrees.
const DISC: f32 = 0.99;

/// How much data.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Amount {
    /// Training samples.
    pub train: usize,
    /// Validation samples, of what is asked alone.
    pub validation: usize,
    /// Rays a sample.
    pub spp: usize,
    /// Share of the training samples that are spread over everything else.
    pub floor: f64,
    /// Seed of everything that is drawn.
    pub seed: u64,
}

/// A dataset for `need` in the folder `root`; one that is there already is kept.
///
/// # Errors
/// `File` for the folder, `Interrupted`, or whatever keeps the truth from answering.
pub fn samples(
    root: &Path,
    demand: &Demand,
    need: &Need,
    truth: &Truth,
    of: (&str, [f32; 2]),
    amount: &Amount,
    progress: &mut dyn FnMut(f64) -> ControlFlow<()>,
) -> Result<Dataset> {
    if let Ok(data) = Dataset::open(root)
        && data.manifest().complete
    {
        return Ok(data);
    }
    let (material, height_range) = of;
    let source = json!({
        "kind": "fit", "need": need, "seed": amount.seed, "spp": amount.spp, "floor": amount.floor,
        "train": amount.train, "validation": amount.validation, "surface": truth.is_surface(),
    });
    let manifest = Manifest::new(material, source, need.size, height_range);
    let existing = if root.exists() { Existing::Resume } else { Existing::Refuse };
    let mut writer = Writer::create(root, manifest, existing)?;
    let splits =
        [(SplitName::Validation, amount.validation, 0.0), (SplitName::Train, amount.train, amount.floor)];
    let blocks_of = |samples: usize| samples.div_ceil(SIDE * SIDE).max(1);
    let total: usize = splits.iter().map(|(_, samples, _)| blocks_of(*samples)).sum();
    let mut done = 0;
    for (place, (name, samples, floor)) in splits.into_iter().enumerate() {
        let blocks = blocks_of(samples);
        writer.plan_split(name, SIDE, blocks, truth.is_surface().then_some(amount.spp))?;
        let layouts = layouts(demand, need, blocks, floor, amount.seed, place as u64)?;
        let finished = writer.manifest().splits.get(&name).map_or(0, |split| split.files.len());
        for (file, part) in layouts.chunks(FILE).enumerate() {
            done += part.len();
            if file < finished {
                continue;
            }
            let first = ((place as u64) << 48) + (file * FILE * SIDE * SIDE) as u64;
            let blocks = measured(part, need, truth, amount, first)?;
            writer.push(name, &blocks)?;
            if progress(done as f64 / total as f64).is_break() {
                let problem = format!("{} keeps what is measured; the same command goes on", root.display());
                return Err(Error::Interrupted(problem));
            }
        }
    }
    writer.finish()?;
    Dataset::open(root)
}

/// What the blocks of a split ask, in the order in which they are stored.
fn layouts(
    demand: &Demand,
    need: &Need,
    blocks: usize,
    floor: f64,
    seed: u64,
    split: u64,
) -> Result<Vec<Layout>> {
    let of_floor = (blocks as f64 * floor).round() as usize;
    let averages = if need.is_window() { (of_floor as f64 * AVERAGE).ceil() as usize } else { 0 };
    let asked = blocks - of_floor;
    let mut drawn = chosen(&demand.weight, asked * PATCHES, seed ^ split);
    // Queries of a block share its level: those of similar levels go together.
    drawn.sort_by(|&a, &b| demand.queries.level[a].total_cmp(&demand.queries.level[b]).then(a.cmp(&b)));
    let make = |k: usize| {
        let mut random = Random::sub_stream(seed, Stream::Patches, 16 + split, k as u64);
        if k < asked {
            around(demand, need, &drawn[k * PATCHES..(k + 1) * PATCHES], &mut random)
        } else {
            anything(need, k - asked < averages, &mut random)
        }
    };
    let order = Random::sub_stream(seed, Stream::Shuffle, 16 + split, 0).permutation(blocks);
    order.into_par_iter().map(|k| make(k as usize)).collect()
}

/// `n` places drawn with probabilities in proportion to the weights, evenly: each as often as its share says, rounded up or
/// down.
fn chosen(weight: &[f32], n: usize, seed: u64) -> Vec<usize> {
    let total: f64 = weight.iter().map(|w| f64::from(*w)).sum();
    let start = Random::new(seed, Stream::Patches, u64::MAX).uniform_f64();
    let (mut out, mut sum) = (Vec::with_capacity(n), 0.0);
    for (k, w) in weight.iter().enumerate() {
        sum += f64::from(*w);
        while (out.len() as f64 + start) * total < sum * n as f64 && out.len() < n {
            out.push(k);
        }
    }
    let last = weight.len().saturating_sub(1);
    out.resize(n, last);
    out
}

/// Patches around asked queries.
fn around(demand: &Demand, need: &Need, chosen: &[usize], random: &mut Random) -> Result<Layout> {
    let queries = &demand.queries;
    let mean = chosen.iter().map(|k| queries.level[*k]).sum::<f32>() / chosen.len() as f32;
    let level = mean.clamp(need.levels[0], need.levels[1]);
    let domain = need.domain("", 0.0);
    let patch = |k: &usize| {
        let texel = level.exp2();
        let local = domain.local(need.size, queries.u[*k]);
        let corner = [0, 1].map(|c| {
            let side = need.size[1 - c] as f32;
            let off = (random.uniform() - 0.5 - 0.5 * PATCH as f32) * texel / side;
            wrap(local[c] + off)
        });
        let mut near = |w: [f32; 2]| inside(w.map(|v| v + JITTER * random.normal()));
        Patch { corner, wi: near(queries.wi[*k]), wo: near(queries.wo[*k]) }
    };
    Layout::new(SIDE, PATCH, level, chosen.iter().map(patch).collect())
}

/// Patches anywhere, under any directions; `average`: of the whole tile.
fn anything(need: &Need, average: bool, random: &mut Random) -> Result<Layout> {
    let level = match need.average().filter(|_| average) {
        Some(level) => level as f32,
        None => need.levels[0] + random.uniform() * (need.levels[1] - need.levels[0]),
    };
    let mut patch = || Patch {
        corner: [random.uniform(), random.uniform()],
        wi: random.disc(DISC),
        wo: random.disc(DISC),
    };
    let patches = (0..PATCHES).map(|_| patch()).collect();
    Layout::new(SIDE, PATCH, level, patches)
}

fn wrap(x: f32) -> f32 {
    let fraction = x - x.floor();
    if fraction < 1.0 { fraction } else { 0.0 }
}

/// A direction that is not below the horizon.
fn inside([x, y]: [f32; 2]) -> [f32; 2] {
    let longest = (x * x + y * y).sqrt() / DISC.sqrt();
    if longest > 1.0 { [x / longest, y / longest] } else { [x, y] }
}

/// Queries of the window as those of the tile.
pub(super) fn of_tile(need: &Need, queries: &QueryBuffer) -> Result<QueryBuffer> {
    if !need.is_window() {
        return Ok(queries.clone());
    }
    let average = need.average().map_or(f32::INFINITY, |level| level as f32 - 0.5);
    let coarsest = (need.tile[0].min(need.tile[1]).ilog2() as f32 - 1.0).max(0.0);
    let mut out = queries.clone();
    for (u, level) in out.u.iter_mut().zip(&mut out.level) {
        if *level > average {
            // The window's last level is the tile, from side to side.
            *level = coarsest;
            continue;
        }
        *u = [0, 1].map(|c| {
            let (corner, size) = (need.corner[1 - c] as f32, need.size[1 - c] as f32);
            wrap((corner + u[c] * size) / need.tile[1 - c] as f32)
        });
    }
    Ok(out)
}

/// Layouts with their answers.
fn measured(
    layouts: &[Layout],
    need: &Need,
    truth: &Truth,
    amount: &Amount,
    first: u64,
) -> Result<Vec<Block>> {
    let samples = SIDE * SIDE;
    let measure = |(k, layout): (usize, &Layout)| {
        let queries = of_tile(need, &layout.queries(need.size))?;
        let (rgb, variance) = truth.ask(&queries, amount.spp, amount.seed, first + (k * samples) as u64)?;
        let noise = variance.iter().map(|v| f64::from(*v)).sum::<f64>() / samples as f64;
        let half = rgb.into_iter().map(|rgb| rgb.map(f16::from_f32)).collect();
        Block::new(layout.clone(), half, noise as f32)
    };
    layouts.par_iter().enumerate().map(measure).collect()
}

#[cfg(test)]
mod tests {
    use super::super::need::tests::demand;
    use super::*;

    #[test]
    fn places_are_drawn_by_weight() {
        let drawn = chosen(&[1.0, 0.0, 3.0, 4.0], 800, 1);
        let count = |k: usize| drawn.iter().filter(|d| **d == k).count() as f64;
        // Even steps through the sum of weights miss a share by one.
        for (k, share) in [100.0, 0.0, 300.0, 400.0].into_iter().enumerate() {
            assert!((count(k) - share).abs() <= 1.0, "{k}: {}", count(k));
        }
        assert!((count(0) - 200.0).abs() > 1.0);
    }

    #[test]
    fn blocks_hold_what_is_asked_and_the_floor_everything() {
        let u = (0..1000).map(|k| [0.4 + 2e-4 * k as f32, 0.3]).collect();
        let demand = demand(u, (0..1000).map(|k| 0.2 + 5e-4 * k as f32).collect());
        let need = Need::new(&demand, 6).unwrap();
        assert!(need.is_window());
        let all = layouts(&demand, &need, 40, 0.2, 1, 1).unwrap();
        let resolution = need.size;
        let (mut asked, mut average, mut floor) = (0, 0, 0);
        for layout in &all {
            let queries = of_tile(&need, &layout.queries(resolution)).unwrap();
            let aimed = layout.patches().iter().all(|p| (p.wi[0] - 0.3).abs() < 0.1);
            if layout.level() == need.average().unwrap() as f32 {
                average += 1;
                assert!(queries.level.iter().all(|l| *l == 6.0));
            } else if aimed {
                asked += 1;
                let texel = layout.level().exp2() / 128.0;
                for u in &queries.u {
                    assert!((u[1] - 0.3).abs() < 3.0 * texel && u[0] > 0.4 - 3.0 * texel, "{u:?}");
                }
            } else {
                floor += 1;
            }
        }
        assert_eq!((asked, average, floor), (32, 2, 6));
        assert_eq!(all, layouts(&demand, &need, 40, 0.2, 1, 1).unwrap());
    }
}
