//! How much falls into which bin, by number and by weight, and the values below which a share of all lies.

use serde::Serialize;

/// The shares at which quantiles are given.
pub const QUANTILES: [f64; 9] = [0.0, 0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99, 1.0];

/// Queries by bin.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Histogram {
    /// Their number; the sum is the number of those that have a bin.
    pub queries: Vec<u64>,
    /// Their weight as a share of the weight of those that have a bin: the sum is 1, or 0 where none has a weight.
    pub weight: Vec<f64>,
}

impl Histogram {
    /// The histogram of (bin, weight).
    pub(super) fn of(bins: usize, all: impl Iterator<Item = (usize, f64)>) -> Self {
        let mut this = Self { queries: vec![0; bins], weight: vec![0.0; bins] };
        for (bin, weight) in all {
            this.queries[bin] += 1;
            this.weight[bin] += weight;
        }
        let total: f64 = this.weight.iter().sum();
        if total > 0.0 {
            this.weight.iter_mut().for_each(|w| *w /= total);
        }
        this
    }

    /// The number of queries by bin as a share of their sum.
    pub fn shares(&self) -> Vec<f64> {
        let total = self.queries.iter().sum::<u64>().max(1) as f64;
        self.queries.iter().map(|n| *n as f64 / total).collect()
    }
}

/// Values at [`QUANTILES`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Quantiles {
    /// By number of queries.
    pub queries: [f32; QUANTILES.len()],
    /// By weight; None where none has a weight.
    pub weight: Option<[f32; QUANTILES.len()]>,
}

impl Quantiles {
    /// The quantiles of values with their weights; there has to be a value.
    pub(super) fn of(values: &[f32], weight: &[f64]) -> Self {
        let mut sorted: Vec<(f32, f64)> = values.iter().copied().zip(weight.iter().copied()).collect();
        sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
        let last = sorted.len() - 1;
        let queries = QUANTILES.map(|share| sorted[((share * last as f64).round() as usize).min(last)].0);
        sorted.retain(|(_, weight)| *weight > 0.0);
        let total: f64 = sorted.iter().map(|(_, weight)| weight).sum();
        let at = |share: f64, greatest: f32| {
            let mut sum = 0.0;
            let reached = sorted.iter().find(|(_, weight)| {
                sum += weight;
                sum >= share * total
            });
            reached.map_or(greatest, |(value, _)| *value)
        };
        Self {
            queries,
            weight: sorted.last().map(|(greatest, _)| QUANTILES.map(|share| at(share, *greatest))),
        }
    }
}

/// The least share of all that has half of the weight; None without any weight.
pub(super) fn half(weight: &[f64]) -> Option<f64> {
    let mut sorted = weight.to_vec();
    sorted.sort_by(|a, b| b.total_cmp(a));
    let total: f64 = sorted.iter().sum();
    let mut sum = 0.0;
    let reached = sorted.iter().position(|weight| {
        sum += weight;
        sum >= 0.5 * total
    });
    reached.filter(|_| total > 0.0).map(|last| (last + 1) as f64 / weight.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sums of a few shares in double precision.
    const ROUNDED: f64 = 1e-12;

    #[test]
    fn a_histogram_has_all_of_the_queries_and_all_of_the_weight() {
        let all = [(0, 0.5), (3, 1.5), (3, 0.0), (1, 0.25)];
        let histogram = Histogram::of(4, all.into_iter());
        assert_eq!(histogram.queries, [1, 1, 0, 2]);
        assert_eq!(histogram.shares(), [0.25, 0.25, 0.0, 0.5]);
        let apart = |added: f64| (histogram.weight.iter().sum::<f64>() + added - 1.0).abs();
        assert!(apart(0.0) < ROUNDED && apart(1e-3) > ROUNDED);
        assert!((histogram.weight[3] - 1.5 / 2.25).abs() < ROUNDED);
        // Without light nothing has a weight, and nothing is divided by it.
        assert_eq!(Histogram::of(2, [(0, 0.0)].into_iter()).weight, [0.0, 0.0]);
    }

    #[test]
    fn quantiles_are_values_by_number_and_by_weight() {
        let values: Vec<f32> = (0..101).rev().map(|k| k as f32).collect();
        let flat = Quantiles::of(&values, &vec![1.0; 101]);
        assert_eq!(flat.queries, [0.0, 1.0, 5.0, 25.0, 50.0, 75.0, 95.0, 99.0, 100.0]);
        // The sum passes 5 % of 101 with the sixth value.
        assert_eq!(flat.weight.unwrap(), [0.0, 1.0, 5.0, 25.0, 50.0, 75.0, 95.0, 99.0, 100.0]);
        // All of the weight on 30 and 70.
        let weight: Vec<f64> =
            values.iter().map(|v| if [30.0, 70.0].contains(v) { 2.0 } else { 0.0 }).collect();
        let heavy = Quantiles::of(&values, &weight);
        assert_eq!(heavy.queries, flat.queries);
        assert_eq!(heavy.weight.unwrap(), [30.0, 30.0, 30.0, 30.0, 30.0, 70.0, 70.0, 70.0, 70.0]);
        assert_eq!(Quantiles::of(&[1.0], &[0.0]).weight, None);
    }

    #[test]
    fn half_of_the_weight_lies_on_the_heaviest() {
        assert_eq!(half(&[1.0; 10]), Some(0.5));
        assert_eq!(half(&[1.0, 1.0, 9.0, 1.0]), Some(0.25));
        assert_eq!(half(&[0.0; 3]), None);
    }
}
