//! Which yarn lies on top at each crossing.

/// A weave over one tile. Warp i runs along y at x = (i + 0.5) / warps, weft j along x at y = (j + 0.5) / wefts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Weave {
    warps: usize,
    wefts: usize,
    /// Row j, column i.
    warp_on_top: Vec<bool>,
}

impl Weave {
    /// A weave of `warps` by `wefts` crossings, both at least 1; `rule(i, j)` is true where warp i lies over weft j.
    pub fn new(warps: usize, wefts: usize, rule: impl Fn(usize, usize) -> bool) -> Self {
        let warp_on_top = (0..warps * wefts).map(|k| rule(k % warps, k / warps)).collect();
        Self { warps, wefts, warp_on_top }
    }

    /// Warp yarns a tile.
    pub fn warps(&self) -> usize {
        self.warps
    }

    /// Weft yarns a tile.
    pub fn wefts(&self) -> usize {
        self.wefts
    }

    /// Whether warp i lies over weft j; both count on into the neighbouring tiles.
    pub fn warp_on_top(&self, i: usize, j: usize) -> bool {
        self.warp_on_top[(j % self.wefts) * self.warps + i % self.warps]
    }
}

/// Basket weave: groups of `size` yarns go over and under together. Its period is 2 `size`.
pub fn basket(size: usize, i: usize, j: usize) -> bool {
    (i / size + j / size).is_multiple_of(2)
}

/// Twill: each warp goes over `over` wefts and under `under`, its neighbour one weft later. Its period is their sum.
pub fn twill(over: usize, under: usize, i: usize, j: usize) -> bool {
    let period = over + under;
    (j + period - i % period) % period < over
}

/// Where a satin of this period ties its floats down: once in `period` crossings, the ties `step` apart from one row
/// to the next so that no two touch. `step` and `period` have no common divisor.
pub fn satin_tie(period: usize, step: usize, i: usize, j: usize) -> bool {
    i % period == (j * step) % period
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_rule_repeats_and_balances() {
        for (period, share, rule) in [
            (4, 0.5, (|i, j| basket(2, i, j)) as fn(usize, usize) -> bool),
            (6, 0.5, |i, j| basket(3, i, j)),
            (4, 0.75, |i, j| twill(3, 1, i, j)),
            (4, 0.5, |i, j| twill(2, 2, i, j)),
            (5, 0.2, |i, j| satin_tie(5, 2, i, j)),
            (8, 0.125, |i, j| satin_tie(8, 3, i, j)),
        ] {
            let up = (0..period * period).filter(|k| rule(k % period, k / period)).count();
            assert_eq!(up as f64, share * (period * period) as f64);
            for k in 0..period * period {
                let (i, j) = (k % period, k / period);
                assert_eq!(rule(i, j), rule(i + period, j));
                assert_eq!(rule(i, j), rule(i, j + period));
            }
        }
    }

    #[test]
    fn satin_ties_never_touch() {
        let touching = |step| {
            (0..64).any(|k| {
                let (i, j) = (k % 8 + 8, k / 8 + 8);
                let near = [(i + 1, j), (i, j + 1), (i + 1, j + 1), (i - 1, j + 1)];
                satin_tie(8, step, i, j) && near.iter().any(|&(a, b)| satin_tie(8, step, a, b))
            })
        };
        assert!(!touching(3));
        // A step of one is a twill: its ties touch along the diagonal.
        assert!(touching(1));
    }

    #[test]
    fn a_weave_wraps() {
        let weave = Weave::new(8, 4, |i, j| twill(3, 1, i, j));
        assert_eq!((weave.warps(), weave.wefts()), (8, 4));
        assert_eq!(weave.warp_on_top(3, 2), weave.warp_on_top(11, 6));
        assert_ne!(weave.warp_on_top(0, 0), weave.warp_on_top(0, 3));
    }
}
