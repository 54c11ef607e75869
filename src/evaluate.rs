//! Errors of an answerer on every split and level of a dataset, and its time per query.

mod apart;

pub use apart::{Apart, apart_table};

use crate::dataset::{Dataset, SplitName};
use crate::error::Result;
use crate::lpips::Lpips;
use crate::metrics::flicker::Flicker;
use crate::metrics::flip::flip;
use crate::metrics::ssim::ssim;
use crate::metrics::{ErrorSum, Errors};
use crate::query::{QueryBuffer, Reflectance, Support};
use crate::random::{Random, Stream};
use crate::results::Metrics;
use rayon::ThreadPoolBuilder;
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;
use std::time::Instant;

/// Queries of a timing, as in DESIGN's metrics.
pub const TIMED_QUERIES: usize = 262_144;
/// Directions of timed queries: squared radius in the projected disc.
const TIMED_DISC: f32 = 0.99;

/// One line of the error table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Split, `views/NAME` for a view, `motion/NAME` for a sequence.
    pub split: String,
    /// The level, rounded down; none for all of the split.
    pub level: Option<usize>,
    /// Queries compared.
    pub queries: u64,
    /// The errors.
    #[serde(flatten)]
    pub errors: Errors,
    /// Of `mse`, dB.
    pub psnr: Option<f64>,
    /// Mean over images of at least 8 x 8.
    pub ssim: Option<f64>,
    /// Mean over the same images.
    pub flip: Option<f64>,
    /// Mean over the images that are large enough, where there are weights.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lpips: Option<f64>,
    /// Of a sequence.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub flicker: Option<f64>,
    /// Variance of the reference itself: a perfect answer's `mse_linear`.
    pub noise: Option<f64>,
}

impl Row {
    /// Its errors as results name them.
    pub fn metrics(&self) -> Metrics {
        Metrics {
            mse: Some(self.errors.mse),
            mse_linear: Some(self.errors.mse_linear),
            mse_log1p: Some(self.errors.mse_log1p),
            psnr: self.psnr,
            ssim: self.ssim,
            flip: self.flip,
            lpips: self.lpips,
            flicker: self.flicker,
        }
    }
}

/// A mean of what there is.
#[derive(Clone, Copy, Default)]
struct Mean {
    sum: f64,
    values: u64,
}

impl Mean {
    fn add(&mut self, value: Option<f64>) {
        self.sum += value.unwrap_or(0.0);
        self.values += u64::from(value.is_some());
    }

    fn value(self) -> Option<f64> {
        (self.values > 0).then(|| self.sum / self.values as f64)
    }
}

/// What is said of one image as a whole.
#[derive(Clone, Copy, Debug)]
struct Likeness {
    ssim: Option<f64>,
    flip: Option<f64>,
    lpips: Option<f64>,
}

impl Likeness {
    fn new(
        height: usize,
        width: usize,
        answer: &[[f32; 3]],
        reference: &[[f32; 3]],
        lpips: Option<&Lpips>,
    ) -> Result<Self> {
        let lpips = lpips.map(|network| network.distance(height, width, answer, reference)).transpose()?;
        Ok(Self {
            ssim: ssim(height, width, answer, reference),
            flip: flip(height, width, answer, reference),
            lpips: lpips.flatten(),
        })
    }
}

#[derive(Default)]
struct Bucket {
    sum: ErrorSum,
    ssim: Mean,
    flip: Mean,
    lpips: Mean,
    noise: Mean,
}

impl Bucket {
    fn add(&mut self, answer: &[[f32; 3]], reference: &[[f32; 3]], noise: f32, images: &[Likeness]) {
        self.sum.add(answer, reference);
        self.noise.add(Some(f64::from(noise)));
        for image in images {
            self.ssim.add(image.ssim);
            self.flip.add(image.flip);
            self.lpips.add(image.lpips);
        }
    }

    fn row(&self, split: &str, level: Option<usize>) -> Row {
        let errors = self.sum.errors();
        Row {
            split: split.into(),
            level,
            queries: self.sum.pixels(),
            errors,
            psnr: errors.psnr(),
            ssim: self.ssim.value(),
            flip: self.flip.value(),
            lpips: self.lpips.value(),
            flicker: None,
            noise: self.noise.value(),
        }
    }
}

/// Why an answerer cannot be asked the queries of a split, in a line; nothing if it can.
///
/// # Errors
/// `File` for data that cannot be read.
pub fn refusal(answerer: &dyn Reflectance, data: &Dataset, name: SplitName) -> Result<Option<String>> {
    if answerer.support() == Support::Pointwise {
        return Ok(None);
    }
    let split = data.split(name)?;
    for file in 0..split.files() {
        for layout in split.layouts(file)? {
            if let Err(error) = answerer.support().check(&layout.queries(data.resolution())) {
                return Ok(Some(format!("{name} is left out: {error}")));
            }
        }
    }
    Ok(None)
}

/// Errors on the given splits: a row a level and one for the whole split; with weights of LPIPS that too. Splits that the
/// answerer cannot be asked ([`refusal`]) have no rows.
///
/// # Errors
/// `File` for data that cannot be read, or what the answerer reports.
pub fn error_table(
    answerer: &dyn Reflectance,
    data: &Dataset,
    splits: &[SplitName],
    lpips: Option<&Lpips>,
) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for &name in splits {
        rows.extend(split_table(answerer, data, name, u64::MAX, lpips)?);
    }
    Ok(rows)
}

/// Errors on the first `most` samples of a split (rounded up to whole files): a row a level and one for all.
///
/// # Errors
/// As [`error_table`].
pub fn split_table(
    answerer: &dyn Reflectance,
    data: &Dataset,
    name: SplitName,
    most: u64,
    lpips: Option<&Lpips>,
) -> Result<Vec<Row>> {
    if refusal(answerer, data, name)?.is_some() {
        return Ok(Vec::new());
    }
    let split = data.split(name)?;
    let mut levels: BTreeMap<usize, Bucket> = BTreeMap::new();
    let mut all = Bucket::default();
    for file in 0..split.files() {
        if all.sum.pixels() >= most {
            break;
        }
        for block in split.read_file(file)? {
            let answer = answerer.evaluate(&block.queries(data.resolution()))?.pixels;
            let target = block.target();
            let images = images(block.side(), block.patch(), &answer, &target, lpips)?;
            let level = levels.entry(block.level().floor() as usize).or_default();
            for bucket in [level, &mut all] {
                bucket.add(&answer, &target, block.noise(), &images);
            }
        }
    }
    let mut rows: Vec<Row> =
        levels.iter().map(|(level, bucket)| bucket.row(name.as_str(), Some(*level))).collect();
    rows.push(all.row(name.as_str(), None));
    Ok(rows)
}

/// Errors on the perspective views: a row each. An answerer that reads neighbours has none, since a view is no regular grid.
///
/// # Errors
/// As [`error_table`].
pub fn view_table(answerer: &dyn Reflectance, data: &Dataset, lpips: Option<&Lpips>) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    if answerer.support() != Support::Pointwise {
        return Ok(rows);
    }
    for view in &data.manifest().views {
        let (queries, reference) = data.read_view(&view.name)?;
        let answer = answerer.evaluate(&queries)?;
        let image = Likeness::new(answer.height, answer.width, &answer.pixels, &reference.pixels, lpips)?;
        let mut bucket = Bucket::default();
        bucket.add(&answer.pixels, &reference.pixels, view.summary.variance, &[image]);
        rows.push(bucket.row(&format!("views/{}", view.name), None));
    }
    Ok(rows)
}

/// Errors on the sequences: a row each, over all of its frames.
///
/// # Errors
/// As [`error_table`].
pub fn motion_table(answerer: &dyn Reflectance, data: &Dataset, lpips: Option<&Lpips>) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    if answerer.support() != Support::Pointwise {
        return Ok(rows);
    }
    for sequence in &data.manifest().motion {
        let (mut bucket, mut flicker) = (Bucket::default(), Flicker::default());
        for [a, b] in sequence.frames() {
            let ((queries, mut reference), (_, other)) = (data.read_view(&a.name)?, data.read_view(&b.name)?);
            let answer = answerer.evaluate(&queries)?;
            flicker.add(&answer.pixels, [&reference.pixels, &other.pixels]);
            for (half, other) in reference.pixels.iter_mut().zip(&other.pixels) {
                *half = [0, 1, 2].map(|c| 0.5 * (half[c] + other[c]));
            }
            let variance = 0.25 * (a.summary.variance + b.summary.variance);
            let image = Likeness::new(answer.height, answer.width, &answer.pixels, &reference.pixels, lpips)?;
            bucket.add(&answer.pixels, &reference.pixels, variance, &[image]);
        }
        let row = bucket.row(&format!("motion/{}", sequence.name), None);
        rows.push(Row { flicker: flicker.value(), ..row });
    }
    Ok(rows)
}

/// What is said of every patch of a block.
fn images(
    side: usize,
    patch: usize,
    answer: &[[f32; 3]],
    target: &[[f32; 3]],
    lpips: Option<&Lpips>,
) -> Result<Vec<Likeness>> {
    let across = side / patch;
    let cut = |pixels: &[[f32; 3]], k: usize| -> Vec<[f32; 3]> {
        let (top, left) = (k / across * patch, k % across * patch);
        (0..patch * patch).map(|i| pixels[(top + i / patch) * side + left + i % patch]).collect()
    };
    let patches = (0..across * across).into_par_iter();
    patches.map(|k| Likeness::new(patch, patch, &cut(answer, k), &cut(target, k), lpips)).collect()
}

/// Time per query of an answerer on one thread.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Cost {
    /// Median over the rounds, nanoseconds.
    pub ns_per_query: f64,
    /// Fastest round.
    pub ns_low: f64,
    /// Slowest round.
    pub ns_high: f64,
    /// Rounds.
    pub rounds: usize,
    /// Queries of a round.
    pub queries: usize,
}

/// Times several answerers in interleaved rounds on one thread: random positions and directions, levels 0 to `levels` - 1,
/// or as many whole tiles of level 0 as hold so many queries for an answerer that reads neighbours.
///
/// # Errors
/// What an answerer reports.
pub fn costs(
    answerers: &[&dyn Reflectance],
    levels: usize,
    queries: usize,
    rounds: usize,
) -> Result<Vec<Cost>> {
    let random = random_queries(queries, levels, 1);
    let asked = |answerer: &&dyn Reflectance| match answerer.support() {
        Support::Pointwise => None,
        Support::Neighbourhood { resolution, .. } => Some(tiles(queries, resolution, 1)),
    };
    let asked: Vec<Option<QueryBuffer>> = answerers.iter().map(asked).collect();
    let asked: Vec<&QueryBuffer> = asked.iter().map(|own| own.as_ref().unwrap_or(&random)).collect();
    interleaved(answerers, &asked, rounds)
}

/// Times an answerer that takes whole slices only, on the finest one, on one thread.
///
/// # Errors
/// What the answerer reports.
pub fn slice_cost(answerer: &dyn Reflectance, side: usize, rounds: usize) -> Result<Cost> {
    let mut random = Random::new(1, Stream::Probe, 0);
    let slice = QueryBuffer::slice(side, side, random.disc(TIMED_DISC), random.disc(TIMED_DISC), 0.0);
    Ok(interleaved(&[answerer], &[&slice], rounds)?.remove(0))
}

/// Nanoseconds a query of several answerers on the same queries; see [`costs`].
///
/// # Errors
/// Whatever keeps an answerer from answering.
pub fn costs_on(answerers: &[&dyn Reflectance], queries: &QueryBuffer, rounds: usize) -> Result<Vec<Cost>> {
    interleaved(answerers, &vec![queries; answerers.len()], rounds)
}

/// `asked` are the queries of each answerer.
fn interleaved(answerers: &[&dyn Reflectance], asked: &[&QueryBuffer], rounds: usize) -> Result<Vec<Cost>> {
    let pool = ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .map_err(|e| crate::error::Error::usage(format!("a timing thread cannot be started: {e}")))?;
    let mut times = vec![Vec::new(); answerers.len()];
    // One round more than is counted: the first warms caches and allocators.
    for round in 0..=rounds {
        for ((answerer, queries), times) in answerers.iter().zip(asked).zip(&mut times) {
            let start = Instant::now();
            pool.install(|| answerer.evaluate(queries))?;
            if round > 0 {
                times.push(start.elapsed().as_secs_f64() * 1e9 / queries.len() as f64);
            }
        }
    }
    let cost = |(mut t, queries): (Vec<f64>, &&QueryBuffer)| {
        t.sort_by(f64::total_cmp);
        let at = |i: usize| t.get(i).copied().unwrap_or(f64::NAN);
        let (ns_low, ns_high) = (at(0), at(t.len().saturating_sub(1)));
        Cost { ns_per_query: at(t.len() / 2), ns_low, ns_high, rounds, queries: queries.len() }
    };
    Ok(times.into_iter().zip(asked).map(cost).collect())
}

/// Whole tiles of \[H, W\] texels at level 0, one below the other under random directions: `n` queries or a tile more.
fn tiles(n: usize, resolution: [usize; 2], seed: u64) -> QueryBuffer {
    let [height, width] = resolution;
    let count = n.div_ceil(height * width).max(1);
    let tile = QueryBuffer::slice(height, width, [0.0; 2], [0.0; 2], 0.0);
    let mut queries = QueryBuffer::slice(count * height, width, [0.0; 2], [0.0; 2], 0.0);
    for k in 0..count {
        let mut random = Random::new(seed, Stream::Probe, k as u64);
        let of_tile = k * tile.len()..(k + 1) * tile.len();
        queries.u[of_tile.clone()].copy_from_slice(&tile.u);
        queries.wi[of_tile.clone()].fill(random.disc(TIMED_DISC));
        queries.wo[of_tile].fill(random.disc(TIMED_DISC));
    }
    queries
}

/// Queries at random positions under random directions, levels uniform in \[0, `levels` - 1\].
pub fn random_queries(n: usize, levels: usize, seed: u64) -> QueryBuffer {
    let mut queries = QueryBuffer::slice(1, n, [0.0; 2], [0.0; 2], 0.0);
    for k in 0..n {
        let mut random = Random::new(seed, Stream::Probe, k as u64);
        queries.u[k] = [random.uniform(), random.uniform()];
        queries.wi[k] = random.disc(TIMED_DISC);
        queries.wo[k] = random.disc(TIMED_DISC);
        queries.level[k] = random.uniform() * levels.saturating_sub(1) as f32;
    }
    queries
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patches_of_a_block_are_compared_apart() {
        let side = 16;
        let target: Vec<[f32; 3]> = (0..side * side).map(|k| [(k % 5) as f32 / 5.0; 3]).collect();
        let mut answer = target.clone();
        assert!(
            images(side, 4, &answer, &target, None)
                .unwrap()
                .iter()
                .all(|image| (image.ssim, image.flip) == (None, None))
        );
        answer[0] = [1.0; 3];
        let found = images(side, 8, &answer, &target, None).unwrap();
        assert_eq!(found.len(), 4);
        assert!(found[0].ssim.unwrap() < 1.0 && found[0].flip.unwrap() > 0.0);
        for image in &found[1..] {
            assert!((image.ssim.unwrap() - 1.0).abs() < 1e-6 && image.flip == Some(0.0));
        }
    }

    #[test]
    fn a_mean_leaves_out_what_is_not_there() {
        let mut mean = Mean::default();
        assert_eq!(mean.value(), None);
        [Some(1.0), None, Some(4.0)].into_iter().for_each(|value| mean.add(value));
        assert_eq!(mean.value(), Some(2.5));
    }
}
