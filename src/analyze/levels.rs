//! How large a pixel is on the tile.

use super::histogram::{Histogram, QUANTILES, Quantiles};
use serde::Serialize;

/// Bins of a level.
pub(super) const BINS: usize = 4;

/// The levels that are asked.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Levels {
    /// By quarter of a level, from 0 to the coarsest that there is.
    pub histogram: Histogram,
    /// By integer part.
    pub whole: Histogram,
    /// Levels.
    pub quantiles: Quantiles,
    /// Texels along a side of a pixel's footprint, at the quantiles of the levels by number of queries.
    pub texels_a_pixel: [f32; QUANTILES.len()],
    /// Pixels \[down, across\] that the tile spans, at the same.
    pub pixels_a_tile: [[f32; 2]; QUANTILES.len()],
    /// Queries at level 0, where a pixel is no larger than a texel, as a share of all.
    pub finest: f64,
    /// Queries at the coarsest level that there is, as a share of all.
    pub coarsest: f64,
}

impl Levels {
    pub(super) fn new(level: &[f32], weight: &[f64], resolution: [usize; 2], coarsest: f32) -> Self {
        let bin = |level: f32, bins: usize| (level.clamp(0.0, coarsest) * bins as f32).floor() as usize;
        let histogram = |bins: usize| {
            let all = level.iter().zip(weight).map(|(level, weight)| (bin(*level, bins), *weight));
            Histogram::of(bin(coarsest, bins) + 1, all)
        };
        let quantiles = Quantiles::of(level, weight);
        let texels = quantiles.queries.map(f32::exp2);
        let share = |at: &dyn Fn(f32) -> bool| {
            level.iter().filter(|level| at(**level)).count() as f64 / level.len().max(1) as f64
        };
        Self {
            histogram: histogram(BINS),
            whole: histogram(1),
            quantiles,
            texels_a_pixel: texels,
            pixels_a_tile: texels.map(|texels| resolution.map(|side| side as f32 / texels)),
            finest: share(&|level| level <= 0.0),
            coarsest: share(&|level| level >= coarsest),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_fall_into_quarters_and_footprints_halve_the_tile() {
        let level = [0.0, 0.0, 0.3, 1.24, 1.25, 2.9, 6.0, 6.0, 6.0, 6.0];
        let levels = Levels::new(&level, &[1.0; 10], [128, 64], 6.0);
        assert_eq!(levels.histogram.queries.len(), 25);
        let filled = |h: &Histogram| -> Vec<(usize, u64)> {
            h.queries.iter().copied().enumerate().filter(|(_, n)| *n > 0).collect()
        };
        assert_eq!(filled(&levels.histogram), [(0, 2), (1, 1), (4, 1), (5, 1), (11, 1), (24, 4)]);
        assert_eq!(filled(&levels.whole), [(0, 3), (1, 2), (2, 1), (6, 4)]);
        assert_eq!((levels.finest, levels.coarsest), (0.2, 0.4));
        assert_eq!(levels.texels_a_pixel[8], 64.0);
        assert_eq!((levels.pixels_a_tile[0], levels.pixels_a_tile[8]), ([128.0, 64.0], [2.0, 1.0]));
        // A matt material has one level.
        assert_eq!(Levels::new(&[0.0], &[1.0], [1, 1], 0.0).histogram.queries, [1]);
    }
}
