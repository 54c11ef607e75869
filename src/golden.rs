//! Golden answers: what a material says to queries that cover its whole domain and its edges, and what rounding its
//! numbers changes of them.

use crate::error::Result;
use crate::model::NeuralMaterial;
use crate::query::{QueryBuffer, Reflectance};
use crate::random::{Random, Stream};
use candle_core::Device;
use neumip_export::checkpoint::Checkpoint;
use neumip_export::config::Architecture;
use neumip_export::{Golden, Guide, Rounding, Storage};

/// Largest |difference| / (1 + |value|) of a reader of the bundle: f32 networks summed in another order, on positions that
/// an offset network moves by an ulp.
pub const TOLERANCE: f64 = 2e-5;
/// Queries in a bundle.
pub const QUERIES: usize = 1024;

/// `n` queries, in turn: plain, u negative or large, level below 0 or beyond the last, grazing, below the horizon.
pub fn probes(n: usize, coarsest: usize, seed: u64) -> QueryBuffer {
    let mut queries = QueryBuffer::slice(1, n, [0.0; 2], [0.0; 2], 0.0);
    let last = coarsest as f32;
    for k in 0..n {
        let mut random = Random::new(seed, Stream::Probe, k as u64);
        queries.u[k] = [random.uniform(), random.uniform()];
        queries.wi[k] = random.disc(0.99);
        queries.wo[k] = random.disc(0.99);
        queries.level[k] = random.uniform() * last;
        match k % 8 {
            1 => queries.u[k] = queries.u[k].map(|u| 20.0 * u - 10.0),
            2 => queries.u[k] = queries.u[k].map(|u| 2000.0 * u - 1000.0),
            3 => {
                queries.level[k] =
                    (last + 3.0) * random.uniform() * if random.uniform() < 0.5 { -1.0 } else { 1.5 }
            }
            4 => queries.level[k] = queries.level[k].round(),
            5 => (queries.wi[k], queries.wo[k]) = (grazing(&mut random), grazing(&mut random)),
            6 => {
                let below = queries.wi[k].map(|x| 2.0 * x + 0.9);
                let place = if random.uniform() < 0.5 { &mut queries.wi[k] } else { &mut queries.wo[k] };
                *place = below;
            }
            _ => {}
        }
    }
    queries
}

/// Least distance of a probe to the border of a window, in tiles, where engines that round otherwise may answer otherwise.
pub const BORDER: f32 = 1e-4;
/// Positions that are tried before a probe is put into the tile [0, 1).
const TRIES: u64 = 16;

/// The probes of a material that answers queries one by one: [`probes`], and where it has a domain they are moved so that a
/// third of them is outside of it, by position or by level, and none within [`BORDER`] of its window.
pub fn queries(architecture: &Architecture, n: usize, seed: u64) -> QueryBuffer {
    let (Some(domain), Some(guide)) = (&architecture.domain, architecture.guide()) else {
        return probes(n, architecture.coarsest(), seed);
    };
    // Levels of the tile, not only those that are stored.
    let last = architecture.tile()[0].min(architecture.tile()[1]).ilog2() as usize;
    let mut queries = probes(n, last, seed);
    let [finest, coarsest] = domain.levels;
    // A window that leaves less than this has no room outside.
    let room = |axis: &usize| guide.part[*axis] && 1.0 - 1.0 / guide.scale[*axis] > 4.0 * BORDER;
    let apart = [0, 1].into_iter().find(room);
    for k in 0..n {
        let outside = apart.filter(|_| k % 6 == 0);
        if guide.is_window() {
            queries.u[k] = placed(&guide, queries.u[k], outside, [seed, k as u64]);
        }
        let share = (queries.level[k] / last as f32).clamp(0.0, 1.0);
        queries.level[k] = match k % 3 == 0 {
            // Any level.
            true if outside.is_some() => queries.level[k],
            true if k % 12 < 6 => finest - 1.0 - share,
            true => coarsest + 0.5 + share * last as f32,
            false => finest + share * (coarsest - finest),
        };
    }
    queries
}

/// A position in the window, or outside of it along an axis, in the tile of `probe`.
fn placed(guide: &Guide, probe: [f32; 2], outside: Option<usize>, [seed, k]: [u64; 2]) -> [f32; 2] {
    let mut place = probe;
    for attempt in 0..=TRIES {
        let mut random = Random::sub_stream(seed, Stream::Probe, 2 + attempt, k);
        let inside = [0, 1].map(|c| 1.0 / guide.scale[c]);
        let mut share = [random.uniform(), random.uniform()];
        // In the middle nothing is near a border.
        if attempt == TRIES {
            share = [0.5; 2];
        }
        for c in 0..2 {
            let at = match outside {
                Some(axis) if axis == c => inside[c] + (1.0 - inside[c]) * share[c],
                _ => inside[c] * share[c],
            };
            let turns = if attempt == TRIES { 0.0 } else { probe[c].floor() };
            place[c] = guide.corner[c] + at + turns;
        }
        if guide.border(place) >= BORDER && guide.is_inside(place) == outside.is_none() {
            break;
        }
    }
    place
}

/// Images of regular grids for a decoder that reads neighbours, \[N, H, W\]: whole tiles, from the finest level on that is no
/// larger than half of `n`; coarser ones repeat in the image. In turn plain, on other tiles, grazing, below the horizon.
pub fn image_probes(architecture: &Architecture, n: usize, seed: u64) -> (QueryBuffer, [usize; 3]) {
    let size = |level: u32| architecture.resolution.map(|side| side >> level);
    let whole = |level: &u32| size(*level).map(|side| side << level) == architecture.resolution;
    let levels: Vec<u32> = (0..=architecture.coarsest() as u32 + 1).take_while(whole).collect();
    let small = |level: &&u32| 2 * size(**level).iter().product::<usize>() <= n;
    let finest = levels.iter().find(small).or(levels.last()).copied().unwrap_or(0);
    let [height, width] = size(finest);
    let count = (n / (height * width)).max(2);
    let mut queries = QueryBuffer::slice(count * height, width, [0.0; 2], [0.0; 2], 0.0);
    for k in 0..count {
        let mut random = Random::sub_stream(seed, Stream::Probe, 1, k as u64);
        let level = finest + k as u32 % (levels.len() as u32 - finest);
        let [rows, columns] = size(level);
        let mut w = [random.disc(0.99), random.disc(0.99)];
        match k % 8 {
            3 => w = [grazing(&mut random), grazing(&mut random)],
            5 => w[random.below(2)] = [0.8, -0.9],
            _ => {}
        }
        let tiles = if k % 4 == 1 { 3.0 } else { 0.0 };
        let (top, left) = (random.below(rows), random.below(columns));
        for (i, j) in (0..height * width).map(|at| (at / width, at % width)) {
            let at = (k * height + i) * width + j;
            let centre = |first: usize, index: usize, texels: usize| {
                ((first + index) % texels) as f32 / texels as f32 + 0.5 / texels as f32 - tiles
            };
            queries.u[at] = [centre(left, j, columns), centre(top, i, rows)];
            [queries.wi[at], queries.wo[at]] = w;
            queries.level[at] = level as f32;
        }
    }
    (queries, [count, height, width])
}

/// A direction within a few degrees of the horizon.
fn grazing(random: &mut Random) -> [f32; 2] {
    let radius = 0.99 + 0.0099 * random.uniform();
    let (sin, cos) = (std::f32::consts::TAU * random.uniform()).sin_cos();
    [radius * cos, radius * sin]
}

/// The golden answers of a checkpoint, as candle gives them.
///
/// # Errors
/// As [`NeuralMaterial::from_checkpoint`] and its answers.
pub fn answers(checkpoint: &Checkpoint, n: usize) -> Result<Golden> {
    let material = NeuralMaterial::from_checkpoint(checkpoint, &Device::Cpu)?;
    let architecture = &checkpoint.header.architecture;
    let (queries, images) = match architecture.neighbourhood() {
        None => (queries(architecture, n, 1), None),
        Some(_) => {
            let (queries, images) = image_probes(architecture, n, 1);
            (queries, Some(images))
        }
    };
    let rgb = material.evaluate(&queries)?.pixels;
    let QueryBuffer { u, wi, wo, level, .. } = queries;
    Ok(Golden { tolerance: TOLERANCE, u, wi, wo, level, rgb, images })
}

/// A checkpoint with rounded numbers, its golden answers, and how far they are from those before.
pub struct Rounded {
    /// The checkpoint.
    pub checkpoint: Checkpoint,
    /// Its answers.
    pub golden: Golden,
    /// What rounding cost.
    pub cost: Rounding,
}

/// Rounds a checkpoint and asks both, before and after, `n` queries.
///
/// # Errors
/// As [`Storage::round`] and [`answers`].
pub fn rounded(checkpoint: &Checkpoint, storage: Storage, n: usize) -> Result<Rounded> {
    // First, so that what cannot be rounded is refused before anything is computed.
    let rounded = storage.round(checkpoint.clone())?;
    let before = answers(checkpoint, n)?;
    let golden = answers(&rounded, n)?;
    let pairs = golden.rgb.as_flattened().iter().zip(before.rgb.as_flattened());
    let (mut largest, mut sum) = (0.0f64, 0.0);
    for (after, before) in pairs {
        let (after, before) = (f64::from(*after), f64::from(*before));
        let difference = (after - before).abs() / (1.0 + before.abs());
        // Not `max`, which would hide a NaN.
        largest = if difference <= largest { largest } else { difference };
        sum += difference;
    }
    let mean = sum / (3 * golden.rgb.len().max(1)) as f64;
    let cost = Rounding { storage, largest_difference: largest, mean_difference: mean };
    Ok(Rounded { checkpoint: rounded, golden, cost })
}
