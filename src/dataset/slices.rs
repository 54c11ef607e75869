//! Training data of whole aligned slices: which block holds which pairs at which level.

use super::config::GenerateConfig;
use crate::random::{Random, Stream};
use std::ops::Range;

/// Index of the permutation of a part's blocks, out of the way of pairs.
const ORDER: u64 = u64::MAX;

/// The slices of a range of pairs. A longer dataset is one of several such parts, so that each of them shows its
/// pairs at every level.
#[derive(Clone, Debug)]
pub(super) struct Slices {
    pairs: Range<u64>,
    /// Blocks of each level.
    counts: Vec<usize>,
    /// Mixed, so that every file has its share of levels and a stopped run has them all.
    order: Vec<u32>,
}

/// One block of slices.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Place {
    pub level: usize,
    first: u64,
    pairs: Range<u64>,
}

impl Place {
    /// The pair of the block's `k`-th patch.
    pub(super) fn pair(&self, k: usize) -> u64 {
        self.pairs.start + (self.first + k as u64) % (self.pairs.end - self.pairs.start).max(1)
    }
}

impl Slices {
    /// The slices of a split in the order of the levels, for a split that is made as a whole.
    pub(super) fn in_order(levels: usize, pairs: usize) -> Self {
        let counts = counts(levels, pairs, 0.0);
        let order = (0..counts.iter().sum::<usize>() as u32).collect();
        Self { pairs: 0..pairs as u64, counts, order }
    }

    /// The slices of a range of training pairs, mixed.
    pub(super) fn mixed(config: &GenerateConfig, pairs: Range<u64>, split: u64) -> Self {
        let counts =
            counts(config.levels(), (pairs.end - pairs.start) as usize, f64::from(config.least_level_share));
        let index = ORDER - pairs.start;
        let order = Random::sub_stream(config.seed, Stream::Patches, split, index)
            .permutation(counts.iter().sum::<usize>());
        Self { pairs, counts, order }
    }

    /// Number of blocks.
    pub(super) fn blocks(&self) -> usize {
        self.order.len()
    }

    /// The block at place `index`.
    pub(super) fn place(&self, index: usize) -> Place {
        let mut rest = self.order[index] as usize;
        let mut level = 0;
        while rest >= self.counts[level] {
            rest -= self.counts[level];
            level += 1;
        }
        Place { level, first: (rest as u64) << (2 * level), pairs: self.pairs.clone() }
    }
}

/// Blocks of each level: every pair once at least, and a level at least `least` of all blocks.
fn counts(levels: usize, pairs: usize, least: f64) -> Vec<usize> {
    let full: Vec<usize> = (0..levels).map(|level| pairs.div_ceil(1 << (2 * level))).collect();
    let raised = |floor: usize| -> Vec<usize> { full.iter().map(|n| (*n).max(floor)).collect() };
    // All levels together need at most 1 / least times the floor, so a floor is found; levels x least = 1 asks for
    // equal counts, which the largest count gives.
    let enough = |floor: usize| floor as f64 >= least * raised(floor).iter().sum::<usize>() as f64;
    let (mut low, mut high) = (1, full.first().copied().unwrap_or(1).max(1));
    while low < high {
        let middle = low + (high - low) / 2;
        if enough(middle) {
            high = middle;
        } else {
            low = middle + 1;
        }
    }
    raised(low)
}

/// Samples of the slices of so many pairs.
pub(super) fn samples(config: &GenerateConfig, pairs: usize) -> u64 {
    let blocks: usize = counts(config.levels(), pairs, f64::from(config.least_level_share)).iter().sum();
    blocks as u64 * (config.resolution * config.resolution) as u64
}

/// Most pairs, up to `most`, whose slices have at most `budget` samples.
pub(super) fn pairs_for(config: &GenerateConfig, budget: u64, most: usize) -> usize {
    let (mut low, mut high) = (0, most);
    while low < high {
        let middle = high - (high - low) / 2;
        if samples(config, middle) <= budget {
            low = middle;
        } else {
            high = middle - 1;
        }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_budget_is_spent_and_not_exceeded() {
        let config = GenerateConfig::new(64);
        for budget in [100_000, 1_000_000, 26_000_000] {
            let pairs = pairs_for(&config, budget, 1 << 20);
            assert!(samples(&config, pairs) <= budget && samples(&config, pairs + 1) > budget, "{pairs}");
        }
        assert_eq!(pairs_for(&config, 4096, 1 << 20), 0);
        assert_eq!(pairs_for(&config, u64::MAX, 77), 77);
    }

    #[test]
    fn counts_are_the_least_that_keep_the_shares() {
        for (pairs, least) in [(9, 0.05), (1000, 0.05), (77, 0.25), (5, 0.0)] {
            let counts = counts(4, pairs, least);
            let total: usize = counts.iter().sum();
            assert!(counts.iter().all(|n| *n as f64 >= least * total as f64), "{counts:?}");
            assert!(counts.iter().enumerate().all(|(l, n)| n << (2 * l) >= pairs));
            assert_eq!(counts[0], pairs);
        }
        assert_eq!(counts(4, 1000, 0.05), [1000, 250, 70, 70]);
    }
}
