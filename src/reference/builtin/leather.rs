//! Pebbled leather: rounded grains of several sizes with fine creases between them, wrinkles, and pores on the grains.

use super::noise::{Packing, gradient, lattice, octaves};
use super::{Spot, mix, mix_rgb, smooth_step};
use crate::random::hash;
use std::f64::consts::TAU;

/// Grains a side of the tile, and the groups of grains that deeper creases part.
const GRAINS: Packing =
    Packing { seed: 0, period: 22, jitter: 0.85, brick: 0.5, spread: 0.4, sharpness: 16.0 };
const GROUPS: Packing =
    Packing { seed: 0, period: 8, jitter: 0.95, brick: 0.5, spread: 0.4, sharpness: 16.0 };
/// Strength with which noise bends their outlines, in tile widths.
const BEND: f64 = 0.007;
/// Rise of grains and of groups over the creases at their borders, in tile widths.
const GRAIN_RISE: [f64; 2] = [0.0045, 0.0085];
const GROUP_RISE: f64 = 0.0065;
/// Distance from the border to where they are nearly level, in cells: 5 and 8 texels of the default field.
const GRAIN_SHOULDER: f64 = 0.26;
const GROUP_SHOULDER: f64 = 0.16;
/// Height that the hide waves about, and how high its waves are.
const MIDDLE: f64 = -0.006;
const WAVE: f64 = 0.0155;
/// Depth of wrinkles and half their width in units of the noise whose zero lines they are.
const WRINKLE: f64 = 0.010;
const WRINKLE_WIDTH: f64 = 0.055;
/// Pores a side of the tile before thinning, the share that is left, their radius in cells and their depth. A pore is
/// 5 texels wide in the default field.
const PORES: i64 = 44;
const PORE_SHARE: f64 = 0.35;
const PORE_RADIUS: f64 = 0.22;
const PORE_DEPTH: f64 = 0.0030;

/// Dyes between which the hide wanders, and what is left of them in creases and pores.
const OXBLOOD: [f64; 3] = [0.200, 0.045, 0.024];
const CHESTNUT: [f64; 3] = [0.285, 0.105, 0.042];
const CREASE_SHADE: f64 = 0.36;
/// Roughness of polished tops and of creases.
const TOP_ROUGHNESS: [f64; 2] = [0.35, 0.44];
const CREASE_ROUGHNESS: f64 = 0.62;

/// The material under one seed.
pub struct Leather {
    seed: u64,
    grains: Packing,
    groups: Packing,
}

impl Leather {
    pub fn new(seed: u64) -> Self {
        let seed = hash(seed ^ 0x6869_6465);
        Self {
            seed,
            grains: Packing { seed: seed ^ 31, ..GRAINS },
            groups: Packing { seed: seed ^ 32, ..GROUPS },
        }
    }

    pub fn spot(&self, x: f64, y: f64) -> Spot {
        let bend = |salt: u64| BEND * octaves(self.seed ^ salt, x, y, 9, 3);
        let (bx, by) = (x + bend(11), y + bend(12));
        let (grain, group) = (self.grains.at(bx, by), self.groups.at(bx, by));
        let draw = |k: u64| lattice(hash(grain.id ^ k), 0, 0, 1);
        let rise = mix(GRAIN_RISE[0], GRAIN_RISE[1], draw(1));
        let (pebble, cushion) = (pillow(grain.border, GRAIN_SHOULDER), pillow(group.border, GROUP_SHOULDER));
        let wave = self.wave(x, y);
        let wrinkle = self.wrinkle(x, y);
        let pore = self.pore(x, y) * smooth_step(0.5, 0.9, pebble);
        let top = smooth_step(0.05, 0.6, pebble * mix(1.0, cushion, 0.7)) * (1.0 - 0.7 * wrinkle);
        let dye = (0.5 + 0.35 * octaves(self.seed ^ 24, x, y, 4, 2) + 0.3 * (draw(2) - 0.5)).clamp(0.0, 1.0);
        let hidden = 1.0 - top * (1.0 - 0.7 * pore);
        let wear = 0.5 + 0.5 * gradient(self.seed ^ 14, x, y, 12);
        Spot {
            height: MIDDLE + WAVE * wave + rise * pebble + GROUP_RISE * cushion
                - WRINKLE * wrinkle
                - PORE_DEPTH * pore,
            base_colour: mix_rgb(OXBLOOD, CHESTNUT, dye).map(|c| c * mix(1.0, CREASE_SHADE, hidden)),
            roughness: mix(mix(TOP_ROUGHNESS[0], TOP_ROUGHNESS[1], wear), CREASE_ROUGHNESS, hidden),
            metalness: 0.0,
        }
    }

    /// Slow waves, about in \[-1.3, 1.3\]. Slow noise would have so few cells that its range hung on the seed.
    fn wave(&self, x: f64, y: f64) -> f64 {
        let plane = |k: u64, a: f64, b: f64| (TAU * (a * x + b * y + lattice(self.seed ^ k, 0, 0, 1))).sin();
        let planes = plane(21, 1.0, 2.0) + plane(22, 2.0, -1.0) + plane(23, 1.0, -1.0);
        0.5 * planes + 0.3 * octaves(self.seed ^ 13, x, y, 5, 2)
    }

    /// 1 in the middle of a wrinkle, 0 away from it. Wrinkles are zero lines of slow noise, which fade in and out.
    fn wrinkle(&self, x: f64, y: f64) -> f64 {
        let line = octaves(self.seed ^ 15, x, y, 3, 4);
        let there = smooth_step(-0.1, 0.35, gradient(self.seed ^ 16, x, y, 5));
        (-(line / WRINKLE_WIDTH).powi(2)).exp() * there
    }

    /// 1 in the middle of a pore, 0 outside.
    fn pore(&self, x: f64, y: f64) -> f64 {
        let (px, py) = (x * PORES as f64, y * PORES as f64);
        let (row, column) = (py.floor() as i64, px.floor() as i64);
        let draw = |k: u64| lattice(self.seed ^ k, row, column, PORES);
        if draw(17) >= PORE_SHARE {
            return 0.0;
        }
        let place = |p: f64, k: u64| p - p.floor() - mix(PORE_RADIUS, 1.0 - PORE_RADIUS, draw(k));
        smooth_step(PORE_RADIUS, 0.0, place(px, 18).hypot(place(py, 19)))
    }
}

/// From 0 on a border to nearly 1 at `shoulder`: steep at the crease, round on top.
fn pillow(border: f64, shoulder: f64) -> f64 {
    let b = border.max(0.0) / shoulder;
    1.0 - (-1.2 * b - b * b).exp()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayon::prelude::*;

    const SIDE: usize = 256;

    fn spots(seed: u64) -> Vec<Spot> {
        let leather = Leather::new(seed);
        let at = |k: usize| (k as f64 + 0.5) / SIDE as f64;
        (0..SIDE * SIDE).into_par_iter().map(|k| leather.spot(at(k % SIDE), at(k / SIDE))).collect()
    }

    fn share(spots: &[Spot], is: impl Fn(&Spot) -> bool) -> f64 {
        spots.iter().filter(|s| is(s)).count() as f64 / spots.len() as f64
    }

    /// Tops a side of the tile: the root of the number of texels that are higher than all within `reach` texels.
    fn tops(spots: &[Spot], reach: usize) -> f64 {
        let around = |p: usize| (0..=2 * reach).map(move |d| (p + SIDE + d - reach) % SIDE);
        let is_top = |k: usize| {
            let near = around(k / SIDE).flat_map(|i| around(k % SIDE).map(move |j| i * SIDE + j));
            near.filter(|&other| other != k).all(|other| spots[other].height < spots[k].height)
        };
        ((0..SIDE * SIDE).filter(|&k| is_top(k)).count() as f64).sqrt()
    }

    #[test]
    fn every_value_is_one_that_shading_allows() {
        for spots in [spots(0), spots(1)] {
            for s in &spots {
                let values = [s.base_colour[0], s.base_colour[1], s.base_colour[2], s.roughness, s.metalness];
                assert!(s.height.abs() < 0.1 && values.iter().all(|v| (0.0..=1.0).contains(v)));
            }
            assert!(
                share(&spots, |s| s.height < -0.02) > 0.001 && share(&spots, |s| s.height > 0.02) > 0.001
            );
        }
    }

    #[test]
    fn it_repeats_with_the_tile_and_seeds_differ() {
        // x + 1 rounds positions by 1e-16, and nothing here is steeper than 10.
        const ROUNDING: f64 = 1e-9;
        let (leather, other) = (Leather::new(3), Leather::new(4));
        for k in 0..200 {
            let (x, y) = (k as f64 * 0.754_877 % 1.0, k as f64 * 0.569_840 % 1.0);
            let (here, there) = (leather.spot(x, y), leather.spot(x + 1.0, y - 2.0));
            assert!((here.height - there.height).abs() < ROUNDING);
            assert!((here.roughness - there.roughness).abs() < ROUNDING);
            assert!((here.height - leather.spot(x + 0.5, y).height).abs() > ROUNDING);
            assert!((here.height - other.spot(x, y).height).abs() > ROUNDING);
        }
    }

    #[test]
    fn grains_number_twenty_to_thirty_a_side() {
        let spots = spots(0);
        let grains = tops(&spots, 3);
        assert!((20.0..30.0).contains(&grains), "{grains}");
        assert!(tops(&spots, 8) < 20.0, "a wide look sees fewer");
    }

    #[test]
    fn tops_are_softly_glossy_creases_dark_and_pores_few() {
        let spots = spots(0);
        let leather = Leather::new(0);
        let at = |k: usize| (k as f64 + 0.5) / SIDE as f64;
        let pores = (0..SIDE * SIDE).filter(|k| leather.pore(at(k % SIDE), at(k / SIDE)) > 0.5).count();
        assert!((0.005..0.04).contains(&(pores as f64 / (SIDE * SIDE) as f64)));
        assert!((0.3..0.8).contains(&share(&spots, |s| s.roughness < 0.46)));
        assert!((0.2..0.5).contains(&share(&spots, |s| s.roughness > 0.53)));
        assert!(spots.iter().all(|s| (0.35..=CREASE_ROUGHNESS).contains(&s.roughness)));
        let mean = |crease: bool| {
            let of: Vec<f64> =
                spots.iter().filter(|s| (s.roughness > 0.53) == crease).map(|s| s.base_colour[0]).collect();
            of.iter().sum::<f64>() / of.len() as f64
        };
        assert!(mean(true) < 0.7 * mean(false), "{} {}", mean(true), mean(false));
    }
}
