//! Errors of an answerer on every split and level of a dataset, and its time per query.

use crate::dataset::{Dataset, SplitName};
use crate::error::Result;
use crate::metrics::ssim::ssim;
use crate::metrics::{ErrorSum, Errors};
use crate::query::{QueryBuffer, Reflectance, Support};
use crate::random::{Random, Stream};
use rayon::ThreadPoolBuilder;
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
    /// Split, `views/NAME` for a view.
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
    /// Variance of the reference itself: a perfect answer's `mse_linear`.
    pub noise: Option<f64>,
}

#[derive(Default)]
struct Bucket {
    sum: ErrorSum,
    ssim: (f64, u64),
    noise: (f64, u64),
}

impl Bucket {
    fn row(&self, split: &str, level: Option<usize>) -> Row {
        let errors = self.sum.errors();
        let mean = |(sum, n): (f64, u64)| (n > 0).then(|| sum / n as f64);
        Row {
            split: split.into(),
            level,
            queries: self.sum.pixels(),
            errors,
            psnr: errors.psnr(),
            ssim: mean(self.ssim),
            noise: mean(self.noise),
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

/// Errors on the given splits: a row a level and one for the whole split. Splits that the answerer cannot be asked
/// ([`refusal`]) have no rows.
///
/// # Errors
/// `File` for data that cannot be read, or what the answerer reports.
pub fn error_table(answerer: &dyn Reflectance, data: &Dataset, splits: &[SplitName]) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for &name in splits {
        if refusal(answerer, data, name)?.is_some() {
            continue;
        }
        let split = data.split(name)?;
        let mut levels: BTreeMap<usize, Bucket> = BTreeMap::new();
        let mut all = Bucket::default();
        for file in 0..split.files() {
            for block in split.read_file(file)? {
                let answer = answerer.evaluate(&block.queries(data.resolution()))?.pixels;
                let target = block.target();
                let level = levels.entry(block.level().floor() as usize).or_default();
                for bucket in [level, &mut all] {
                    bucket.sum.add(&answer, &target);
                    bucket.noise.0 += f64::from(block.noise());
                    bucket.noise.1 += 1;
                    for image in images(block.side(), block.patch(), &answer, &target) {
                        bucket.ssim.0 += image;
                        bucket.ssim.1 += 1;
                    }
                }
            }
        }
        rows.extend(levels.iter().map(|(level, bucket)| bucket.row(name.as_str(), Some(*level))));
        rows.push(all.row(name.as_str(), None));
    }
    Ok(rows)
}

/// Errors on the perspective views: a row each. An answerer that reads neighbours has none, since a view is no regular grid.
///
/// # Errors
/// As [`error_table`].
pub fn view_table(answerer: &dyn Reflectance, data: &Dataset) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    if answerer.support() != Support::Pointwise {
        return Ok(rows);
    }
    for view in &data.manifest().views {
        let (queries, reference) = data.read_view(&view.name)?;
        let answer = answerer.evaluate(&queries)?;
        let mut bucket = Bucket { noise: (f64::from(view.summary.variance), 1), ..Bucket::default() };
        bucket.sum.add(&answer.pixels, &reference.pixels);
        if let Some(value) = ssim(answer.height, answer.width, &answer.pixels, &reference.pixels) {
            bucket.ssim = (value, 1);
        }
        rows.push(bucket.row(&format!("views/{}", view.name), None));
    }
    Ok(rows)
}

/// Structural similarity of every patch of a block.
fn images(side: usize, patch: usize, answer: &[[f32; 3]], target: &[[f32; 3]]) -> Vec<f64> {
    let across = side / patch;
    let cut = |pixels: &[[f32; 3]], k: usize| -> Vec<[f32; 3]> {
        let (top, left) = (k / across * patch, k % across * patch);
        (0..patch * patch).map(|i| pixels[(top + i / patch) * side + left + i % patch]).collect()
    };
    (0..across * across).filter_map(|k| ssim(patch, patch, &cut(answer, k), &cut(target, k))).collect()
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
    let pool = ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .map_err(|e| crate::error::Error::usage(format!("a timing thread cannot be started: {e}")))?;
    let mut times = vec![Vec::new(); answerers.len()];
    // One round more than is counted: the first warms caches and allocators.
    for round in 0..=rounds {
        for ((answerer, queries), times) in answerers.iter().zip(&asked).zip(&mut times) {
            let start = Instant::now();
            pool.install(|| answerer.evaluate(queries))?;
            if round > 0 {
                times.push(start.elapsed().as_secs_f64() * 1e9 / queries.len() as f64);
            }
        }
    }
    Ok(times
        .into_iter()
        .zip(asked)
        .map(|(mut t, queries)| {
            t.sort_by(f64::total_cmp);
            let at = |i: usize| t.get(i).copied().unwrap_or(f64::NAN);
            Cost {
                ns_per_query: at(t.len() / 2),
                ns_low: at(0),
                ns_high: at(t.len().saturating_sub(1)),
                rounds,
                queries: queries.len(),
            }
        })
        .collect())
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
        assert_eq!(images(side, 8, &answer, &target).len(), 4);
        assert_eq!(images(side, 4, &answer, &target).len(), 0);
        answer[0] = [1.0; 3];
        let values = images(side, 8, &answer, &target);
        assert!(values[0] < 1.0 && values[1..].iter().all(|v| (*v - 1.0).abs() < 1e-6));
    }
}
