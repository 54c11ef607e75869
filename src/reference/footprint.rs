//! The box over which a query is averaged, its strata, and how sure the average is.

/// Equal-area strata of the unit square, in an order in which neighbours follow each other: rows there and back.
#[derive(Clone, Debug)]
pub struct Strata {
    boxes: Vec<Stratum>,
}

#[derive(Clone, Copy, Debug)]
struct Stratum {
    corner: [f64; 2],
    size: [f64; 2],
}

impl Strata {
    /// `count` >= 1 strata in about sqrt(count) rows. Rows hold as many strata as they have height, so that the
    /// areas are equal for every count.
    pub fn new(count: usize) -> Self {
        let rows = ((count as f64).sqrt().round() as usize).max(1);
        let mut boxes = Vec::with_capacity(count);
        for row in 0..rows {
            let (first, end) = (count * row / rows, count * (row + 1) / rows);
            let size = [1.0 / (end - first) as f64, (end - first) as f64 / count as f64];
            for k in 0..end - first {
                let column = if row % 2 == 0 { k } else { end - first - 1 - k };
                boxes.push(Stratum { corner: [column as f64 * size[0], first as f64 / count as f64], size });
            }
        }
        Self { boxes }
    }

    /// Number of strata.
    pub fn len(&self) -> usize {
        self.boxes.len()
    }

    /// True if there are none.
    pub fn is_empty(&self) -> bool {
        self.boxes.is_empty()
    }

    /// The point of stratum `k` at `jitter` in \[0, 1)^2.
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

/// Mean of one sample a stratum, and the variance of that mean averaged over RGB.
///
/// One sample says nothing about its own stratum, so neighbouring strata are collapsed into pairs (the last three
/// into a triple where the count is odd): a pair adds (a - b)^2 / n^2, a triple 3/2 of its squared deviations / n^2.
/// Where strata differ in their means this overestimates, which errs on the safe side. One sample gives 0: unknown.
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
    fn strata_share_the_square_equally() {
        for count in [1, 2, 3, 5, 7, 16, 30, 31, 64, 97] {
            let strata = Strata::new(count);
            assert_eq!(strata.len(), count);
            let area: f64 = strata.boxes.iter().map(|b| b.size[0] * b.size[1]).sum();
            // Sums of up to 97 products of f64.
            assert!((area - 1.0).abs() < 1e-12);
            for k in 0..count {
                let inside = strata.point(k, [0.5, 0.5]);
                let owners = (0..count).filter(|&o| {
                    let b = strata.boxes[o];
                    (0..2).all(|c| b.corner[c] < inside[c] && inside[c] < b.corner[c] + b.size[c])
                });
                assert_eq!(owners.collect::<Vec<_>>(), [k]);
            }
        }
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
