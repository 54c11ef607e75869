//! Where a yarn runs: its centre line with crimp, and its cross-section along the way.

use super::weave::Weave;
use crate::random::Random;
use std::f64::consts::TAU;

/// Half the reach, in pitches of the crossing yarns, of the mean that tells a float from a binding point.
const FLOAT_REACH: f64 = 1.5;
/// Samples of that mean.
const FLOAT_SAMPLES: usize = 24;
/// Share of the float's spread that the height gives up: less than all, since loose yarns are less dense.
const FLATTENING: f64 = 0.6;

/// Direction in which a family of yarns runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Family {
    /// Along y.
    Warp,
    /// Along x.
    Weft,
}

/// How the yarns of a family lie in the cloth. Lengths are in pitches of this family, unless said otherwise.
#[derive(Clone, Debug)]
pub struct Lay {
    /// Half the width of a yarn's section; 0.5 closes the gaps between parallel yarns.
    pub half_width: f64,
    /// Half its height.
    pub half_height: f64,
    /// How far the centre line leaves the middle plane at a crossing, as a share of the distance at which the two
    /// families touch; the shares of both add up to about 1.
    pub crimp: f64,
    /// Length of the way from top to bottom, in pitches of the crossing yarns, above 0 to 1.
    pub passage: f64,
    /// How far the middle of a float rises above its ends, in half heights.
    pub bow: f64,
    /// How much wider the section is in a float than where yarns alternate, as a share.
    pub spread: f64,
    /// How far yarns lean to a neighbour that goes the same way, and away from one that does not.
    pub bunching: f64,
    /// How far the centre line strays sideways.
    pub wander: f64,
    /// Variation of the thickness from yarn to yarn and along each, as a share.
    pub slub: f64,
}

/// A yarn's centre line and section at `len()` places, evenly spaced along the tile; the place behind the last is the
/// first, one tile further on.
#[derive(Clone, Debug)]
pub struct Path {
    /// Centre of the section.
    pub centre: Vec<[f64; 3]>,
    /// Sideways, in the plane of the cloth; unit.
    pub side: Vec<[f64; 3]>,
    /// Up, square to the side and to the centre line; unit.
    pub up: Vec<[f64; 3]>,
    /// Half the section's width, in tile widths.
    pub half_width: Vec<f64>,
    /// Half the section's height, in tile widths.
    pub half_height: Vec<f64>,
    /// From a place to the same place in the next tile.
    pub period: [f64; 3],
}

impl Path {
    /// The path of yarn `index` of a family, at `places` places, at least 3. `touching` is the distance, in tile
    /// widths, between the centres of two yarns that touch at a crossing.
    pub fn new(
        weave: &Weave,
        (family, index): (Family, usize),
        lay: &Lay,
        touching: f64,
        places: usize,
        random: &mut Random,
    ) -> Self {
        let (yarns, crossings) = match family {
            Family::Warp => (weave.warps(), weave.wefts()),
            Family::Weft => (weave.wefts(), weave.warps()),
        };
        let pitch = 1.0 / yarns as f64;
        // 1 where the yarn is on top, -1 where it is below.
        let level = |yarn: usize, crossing: usize| match family {
            Family::Warp if weave.warp_on_top(yarn, crossing) => 1.0,
            Family::Weft if !weave.warp_on_top(crossing, yarn) => 1.0,
            _ => -1.0,
        };
        let levels: Vec<f64> = (0..crossings).map(|c| level(index, c)).collect();
        let neighbour =
            |yarn: usize| (0..crossings).map(move |c| levels_agree(level(index, c), level(yarn, c)));
        let right: Vec<f64> = neighbour(index + 1).collect();
        let left: Vec<f64> = neighbour(index + yarns - 1).collect();

        let stray = Wave::new(random, 1, 4);
        let slub = Wave::new(random, 1, 6);
        let thickness = 1.0 + lay.slub * f64::from(random.normal()).clamp(-2.0, 2.0) * 0.5;

        let mut path = Self {
            centre: Vec::with_capacity(places),
            side: Vec::with_capacity(places),
            up: Vec::with_capacity(places),
            half_width: Vec::with_capacity(places),
            half_height: Vec::with_capacity(places),
            period: match family {
                Family::Warp => [0.0, 1.0, 0.0],
                Family::Weft => [1.0, 0.0, 0.0],
            },
        };
        for k in 0..places {
            let t = k as f64 / places as f64;
            let float = mean(&levels, t);
            let lean = 0.5 * (mean(&right, t) - mean(&left, t));
            let loose = lay.spread * (float.abs() - 0.5);
            let thick = thickness * (1.0 + lay.slub * slub.at(t));
            let half_height = lay.half_height * pitch * thick;
            let across = (index as f64 + 0.5 + lay.bunching * lean + lay.wander * stray.at(t)) * pitch;
            let z = lay.crimp * touching * passage(&levels, t, lay.passage) + lay.bow * half_height * float;
            path.centre.push(match family {
                Family::Warp => [across, t, z],
                Family::Weft => [t, across, z],
            });
            path.half_width.push(lay.half_width * pitch * thick * (1.0 + loose));
            path.half_height.push(half_height * (1.0 - FLATTENING * loose));
        }
        path.frame();
        path
    }

    /// Number of places.
    pub fn len(&self) -> usize {
        self.centre.len()
    }

    /// Unit vector along the centre line at place k.
    pub fn along(&self, k: usize) -> [f64; 3] {
        let n = self.len();
        let ahead =
            if k + 1 < n { self.centre[k + 1] } else { add(self.centre[k + 1 - n], self.period, 1.0) };
        let behind = if k > 0 { self.centre[k - 1] } else { add(self.centre[n - 1], self.period, -1.0) };
        unit(add(ahead, behind, -1.0))
    }

    fn frame(&mut self) {
        for k in 0..self.len() {
            let t = self.along(k);
            let side = unit([-t[1], t[0], 0.0]);
            self.side.push(side);
            self.up.push(cross(t, side));
        }
    }
}

/// A smooth periodic wobble of about unit size: three sines with whole numbers of turns over the tile.
#[derive(Clone, Copy, Debug)]
pub struct Wave {
    terms: [[f64; 2]; 3],
}

impl Wave {
    /// A wobble of `slowest` to `fastest` turns a tile, at least one.
    pub fn new(random: &mut Random, slowest: usize, fastest: usize) -> Self {
        let terms = std::array::from_fn(|_| {
            let turns = slowest + random.below(fastest.saturating_sub(slowest) + 1);
            [turns as f64, TAU * random.uniform_f64()]
        });
        Self { terms }
    }

    /// Value at t, in tiles.
    pub fn at(&self, t: f64) -> f64 {
        // Three unit sines have the variance 3/2.
        const SCALE: f64 = 0.816_496_580_927_726;
        SCALE * self.terms.iter().map(|[turns, phase]| (TAU * turns * t + phase).sin()).sum::<f64>()
    }
}

fn levels_agree(a: f64, b: f64) -> f64 {
    if a == b { 1.0 } else { -1.0 }
}

/// The values at the crossings, joined by smooth steps of a length `reach` (in pitches, at most 1) half-way between
/// them: exactly the crossing's value at each crossing.
fn passage(values: &[f64], t: f64, reach: f64) -> f64 {
    let n = values.len();
    let x = t * n as f64;
    let border = x.round();
    let b = border as i64;
    let at = |k: i64| values[k.rem_euclid(n as i64) as usize];
    let f = ((x - border) / reach + 0.5).clamp(0.0, 1.0);
    let f = f * f * (3.0 - 2.0 * f);
    at(b - 1) + (at(b) - at(b - 1)) * f
}

/// The mean of the values around t under a raised cosine.
fn mean(values: &[f64], t: f64) -> f64 {
    let (mut sum, mut weights) = (0.0, 0.0);
    for k in 0..FLOAT_SAMPLES {
        let f = (k as f64 + 0.5) / FLOAT_SAMPLES as f64 * 2.0 - 1.0;
        let weight = 1.0 + (0.5 * TAU * f).cos();
        sum += weight * passage(values, t + f * FLOAT_REACH / values.len() as f64, 1.0);
        weights += weight;
    }
    sum / weights
}

/// a + s b.
pub fn add(a: [f64; 3], b: [f64; 3], s: f64) -> [f64; 3] {
    std::array::from_fn(|c| a[c] + s * b[c])
}

/// a x b.
pub fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// a / |a|; a is not 0.
pub fn unit(a: [f64; 3]) -> [f64; 3] {
    let scale = 1.0 / a.iter().map(|c| c * c).sum::<f64>().sqrt();
    a.map(|c| c * scale)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Stream;
    use crate::reference::cloth::weave::twill;

    /// Sums and roots of a few numbers below 1.
    const ROUNDING: f64 = 1e-12;

    const LAY: Lay = Lay {
        half_width: 0.5,
        half_height: 0.3,
        crimp: 0.5,
        passage: 0.9,
        bow: 0.2,
        spread: 0.2,
        bunching: 0.05,
        wander: 0.05,
        slub: 0.05,
    };

    fn path(family: Family, index: usize) -> Path {
        let weave = Weave::new(8, 8, |i, j| twill(3, 1, i, j));
        Path::new(&weave, (family, index), &LAY, 0.075, 64, &mut Random::new(1, Stream::Probe, index as u64))
    }

    #[test]
    fn a_passage_is_exact_at_the_crossings() {
        let levels = [1.0, -1.0, -1.0, 1.0, 1.0];
        for (k, level) in levels.iter().enumerate() {
            for reach in [0.3, 1.0] {
                assert_eq!(passage(&levels, (k as f64 + 0.5) / 5.0, reach), *level);
            }
        }
        assert_eq!(passage(&levels, 0.2, 0.9), 0.0);
        assert_ne!(passage(&levels, 0.13, 1.0), 1.0);
    }

    #[test]
    fn floats_are_told_from_binding_points() {
        let (float, plain) = ([1.0; 8], [1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0]);
        assert!((mean(&float, 0.3) - 1.0).abs() < ROUNDING);
        assert!(mean(&plain, 0.3).abs() < 0.2);
    }

    #[test]
    fn frames_are_orthonormal_and_sections_open() {
        for (family, index) in [(Family::Warp, 0), (Family::Warp, 7), (Family::Weft, 3)] {
            let path = path(family, index);
            assert_eq!(path.len(), 64);
            for k in 0..path.len() {
                let axes = [path.along(k), path.side[k], path.up[k]];
                for a in 0..3 {
                    for b in 0..3 {
                        let dot: f64 = (0..3).map(|c| axes[a][c] * axes[b][c]).sum();
                        assert!((dot - f64::from(u8::from(a == b))).abs() < ROUNDING);
                    }
                }
                assert!(path.up[k][2] > 0.0 && path.side[k][2] == 0.0);
                assert!(path.half_width[k] > path.half_height[k] && path.half_height[k] > 0.0);
            }
        }
    }

    #[test]
    fn waves_close_and_have_about_unit_size() {
        let mean_square = |k: u64| {
            let wave = Wave::new(&mut Random::new(2, Stream::Probe, k), 1, 5);
            assert!((wave.at(0.0) - wave.at(1.0)).abs() < ROUNDING);
            assert!((wave.at(0.0) - wave.at(0.98)).abs() > ROUNDING);
            (0..64).map(|t| wave.at(f64::from(t) / 64.0).powi(2)).sum::<f64>() / 64.0
        };
        let mean = (0..64).map(mean_square).sum::<f64>() / 64.0;
        assert!((0.8..1.25).contains(&mean), "{mean}");
    }
}
