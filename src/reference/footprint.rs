//! The box over which a query is averaged, its strata, and how sure the average is.

/// Strata of the unit square with two samples each, the last one with three where the number of samples is odd; areas
/// are proportional to samples. One sample a stratum would be less noisy, but would not tell how noisy it is: taking
/// neighbours for twins overestimates the variance wherever strata differ.
#[derive(Clone, Debug)]
pub struct Strata {
    /// The stratum of each sample.
    boxes: Vec<Stratum>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Stratum {
    corner: [f64; 2],
    size: [f64; 2],
}

impl Strata {
    /// Strata for `count` >= 1 samples in about as many rows as columns.
    pub fn new(count: usize) -> Self {
        let strata = (count / 2).max(1);
        let rows = ((strata as f64).sqrt().round() as usize).max(1);
        // Samples before stratum k.
        let before = |k: usize| if k == strata { count } else { 2 * k };
        let mut boxes = Vec::with_capacity(count);
        for row in 0..rows {
            let (first, end) = (strata * row / rows, strata * (row + 1) / rows);
            let (start, in_row) = (before(first), (before(end) - before(first)) as f64);
            for k in first..end {
                let samples = before(k + 1) - before(k);
                let corner = [(before(k) - start) as f64 / in_row, start as f64 / count as f64];
                let size = [samples as f64 / in_row, in_row / count as f64];
                boxes.extend(std::iter::repeat_n(Stratum { corner, size }, samples));
            }
        }
        Self { boxes }
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.boxes.len()
    }

    /// True if there are none.
    pub fn is_empty(&self) -> bool {
        self.boxes.is_empty()
    }

    /// Where sample `k` falls, at `jitter` in \[0, 1)^2 of its stratum.
    pub fn point(&self, k: usize, jitter: [f64; 2]) -> [f64; 2] {
        let Stratum { corner, size } = self.boxes[k];
        std::array::from_fn(|c| corner[c] + jitter[c] * size[c])
    }
}

/// A box on the reference plane, in tile widths.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Footprint {
    /// Least corner, x then y.
    pub corner: [f64; 2],
    /// Sides.
    pub size: [f64; 2],
}

impl Footprint {
    /// The box of side 2^level texels around u, on a tile of `resolution` = \[H, W\] texels. Any finite u is wrapped;
    /// the level is clamped to 0 (one texel) and log2 of the larger side (the tile).
    pub fn new(u: [f32; 2], level: f32, resolution: [usize; 2]) -> Self {
        let coarsest = (resolution[0].max(resolution[1]) as f64).log2();
        let texels = f64::from(level).clamp(0.0, coarsest).exp2();
        let size = [texels / resolution[1] as f64, texels / resolution[0] as f64];
        Self { corner: std::array::from_fn(|c| f64::from(u[c]).rem_euclid(1.0) - 0.5 * size[c]), size }
    }

    /// The point at `p` in \[0, 1)^2 of the box.
    pub fn point(&self, p: [f64; 2]) -> [f64; 2] {
        std::array::from_fn(|c| self.corner[c] + p[c] * self.size[c])
    }
}

/// Mean of the samples of [`Strata`], and the variance of that mean averaged over RGB, without bias: the two samples a, b
/// of a stratum add (a - b)^2 / n^2, three add 3/2 of their squared deviations / n^2. One sample gives 0: unknown.
pub fn mean_and_variance(samples: &[[f32; 3]]) -> ([f32; 3], f32) {
    let n = samples.len();
    let mean = |group: &[[f32; 3]], c: usize| {
        group.iter().map(|s| f64::from(s[c])).sum::<f64>() / group.len() as f64
    };
    let mut sum = 0.0;
    let mut rest = samples;
    while rest.len() >= 2 {
        let (group, after) = rest.split_at(if rest.len() == 3 { 3 } else { 2 });
        let scale = group.len() as f64 / (group.len() - 1) as f64;
        for c in 0..3 {
            let m = mean(group, c);
            sum += scale * group.iter().map(|s| (f64::from(s[c]) - m).powi(2)).sum::<f64>();
        }
        rest = after;
    }
    (std::array::from_fn(|c| mean(samples, c) as f32), (sum / (3.0 * (n * n) as f64)) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Random, Stream};

    #[test]
    fn strata_share_the_square_by_their_samples() {
        for count in [1, 2, 3, 5, 7, 16, 30, 31, 64, 97] {
            let strata = Strata::new(count);
            assert_eq!(strata.len(), count);
            for k in 0..count {
                let inside = strata.point(k, [0.5, 0.5]);
                let holds = |b: &&Stratum| {
                    (0..2).all(|c| b.corner[c] < inside[c] && inside[c] < b.corner[c] + b.size[c])
                };
                let owners: Vec<_> = strata.boxes.iter().filter(holds).collect();
                let own = strata.boxes[k];
                assert!(owners.iter().all(|b| **b == own), "strata overlap");
                let expected = if count == 1 { 1..=1 } else { 2..=3 };
                assert!(expected.contains(&owners.len()) && (owners.len() == 3) <= (count % 2 == 1));
                // Quotients of small integers in f64.
                assert!((own.size[0] * own.size[1] - owners.len() as f64 / count as f64).abs() < 1e-12);
            }
        }
    }

    /// Ratio of the estimated to the true variance of the mean over a square of which a slanted half is white.
    fn edge_ratio(count: usize, sample: impl Fn(&Strata, usize, [f64; 2]) -> [f64; 2]) -> f64 {
        let strata = Strata::new(count);
        let trials = 20_000;
        let (mut sum, mut squares, mut estimated) = (0.0, 0.0, 0.0);
        for trial in 0..trials {
            let mut random = Random::new(5, Stream::Probe, trial);
            let samples: Vec<_> = (0..count)
                .map(|k| {
                    let [x, y] = sample(&strata, k, [random.uniform_f64(), random.uniform_f64()]);
                    [if x + 0.37 * y < 0.6 { 1.0 } else { 0.0 }; 3]
                })
                .collect();
            let (mean, variance) = mean_and_variance(&samples);
            sum += f64::from(mean[0]);
            squares += f64::from(mean[0]).powi(2);
            estimated += f64::from(variance);
        }
        let n = trials as f64;
        estimated / n / (squares / n - (sum / n).powi(2))
    }

    #[test]
    fn noise_is_told_without_bias_at_edges() {
        // A variance from 20,000 trials is right to 1 %, the estimates' mean too.
        let close = |ratio: f64| (ratio - 1.0).abs() < 0.05;
        for count in [4, 7, 16, 64] {
            let ratio = edge_ratio(count, |strata, k, jitter| strata.point(k, jitter));
            assert!(close(ratio), "{count}: {ratio}");
        }
        // Strata of one sample each, with neighbours taken for twins.
        let single = |_: &Strata, k: usize, jitter: [f64; 2]| {
            let (row, column) = (k / 4, if (k / 4).is_multiple_of(2) { k % 4 } else { 3 - k % 4 });
            [(column as f64 + jitter[0]) / 4.0, (row as f64 + jitter[1]) / 4.0]
        };
        assert!(edge_ratio(16, single) > 1.3);
    }

    /// Ratio of the estimated to the true variance of the mean of `count` samples uniform over \[0, 1\].
    fn variance_ratio(count: usize, scale: f32) -> f64 {
        let trials = 4000;
        let mut estimated = 0.0;
        for trial in 0..trials {
            let mut random = Random::new(3, Stream::Probe, trial);
            let samples: Vec<_> = (0..count).map(|_| std::array::from_fn(|_| random.uniform())).collect();
            estimated += f64::from(mean_and_variance(&samples).1 * scale);
        }
        estimated / trials as f64 * 12.0 * count as f64
    }

    #[test]
    fn variance_is_that_of_the_mean() {
        // 4000 trials of at least 3 squared differences each leave under 2 % of noise.
        let close = |ratio: f64| (ratio - 1.0).abs() < 0.06;
        for count in [2, 3, 5, 16] {
            assert!(close(variance_ratio(count, 1.0)), "{count}");
            assert!(!close(variance_ratio(count, 1.1)), "{count}");
        }
        assert_eq!(mean_and_variance(&[[0.25; 3]]), ([0.25; 3], 0.0));
    }

    #[test]
    fn boxes_wrap_and_levels_clamp() {
        assert_eq!(Footprint::new([1.25, -0.75], -3.0, [8, 8]), Footprint::new([0.25, 0.25], 0.0, [8, 8]));
        assert_eq!(Footprint::new([0.5, 0.5], 40.0, [8, 4]).size, [2.0, 1.0]);
        assert_eq!(Footprint::new([0.5, 0.5], 1.0, [8, 4]).size, [0.5, 0.25]);
    }
}
