//! Scutes of a tortoise's shell: horny domes with growth rings and amber rays, and matte grooves between them.
//! Sharp highlights on bumps of two sizes.

use super::noise::{Packing, Polygon, gradient, lattice, octaves};
use super::{Spot, mix, mix_rgb, smooth_step};
use crate::random::hash;
use std::f64::consts::TAU;

/// Scutes a side of the tile, in rows that are shifted like bricks.
const SCUTES: Packing =
    Packing { seed: 0, period: 4, jitter: 0.5, brick: 0.5, spread: 0.20, sharpness: 26.0 };
/// Strength with which noise bends outlines and rings, in tile widths.
const BEND: f64 = 0.008;
/// Height of the grooves, of the scutes' edges over them and of the scutes' centres over their edges, in tile widths.
const GROOVE: f64 = -0.045;
const EDGE_RISE: f64 = 0.020;
const DOME_RISE: [f64; 2] = [0.050, 0.085];
/// Half the width of a groove, and of the edge that rises from it, in cells.
const GAP: f64 = 0.014;
const EDGE: f64 = 0.085;
/// Share of a scute that is its areole, the flat plate it had at hatching.
const AREOLE: f64 = 0.22;
/// Growth rings of a scute, and half their height. At 512 texels a ring is about 10 texels wide: the normals of
/// neighbouring texels then differ by less than a highlight's width, which keeps highlights whole.
const RINGS: [f64; 2] = [4.0, 6.0];
const RING_HEIGHT: f64 = 0.0011;
/// Height of dents.
const DENTS: f64 = 0.0030;

/// Colours: horn between the rays, the rays and the areole, and the skin in the grooves.
const DARK: [f64; 3] = [0.022, 0.012, 0.008];
const AMBER: [f64; 3] = [0.56, 0.27, 0.055];
const HONEY: [f64; 3] = [0.62, 0.38, 0.12];
const SKIN: [f64; 3] = [0.050, 0.038, 0.028];
/// Rays of a scute.
const RAYS: [f64; 2] = [8.0, 12.0];
/// Roughness of horn from polished to worn, and of the grooves.
const HORN_ROUGHNESS: [f64; 2] = [0.14, 0.29];
/// Added where a scute falls off to the groove: worn, and steep enough to throw stray glints otherwise.
const EDGE_WEAR: f64 = 0.25;
const GROOVE_ROUGHNESS: f64 = 0.8;

/// The material under one seed.
pub struct TurtleShell {
    seed: u64,
    scutes: Packing,
}

impl TurtleShell {
    pub fn new(seed: u64) -> Self {
        let seed = hash(seed ^ 0x7363_7574);
        Self { seed, scutes: Packing { seed: seed ^ 31, ..SCUTES } }
    }

    pub fn spot(&self, x: f64, y: f64) -> Spot {
        let bend = |salt: u64| BEND * octaves(self.seed ^ salt, x, y, 7, 2);
        let scute = self.scutes.at(x + bend(11), y + bend(12));
        let dents = octaves(self.seed ^ 13, x, y, 9, 2);
        let grain = octaves(self.seed ^ 14, x, y, 32, 3);
        // A quarter of an ellipse from the groove up to the edge.
        let away = (1.0 - (scute.border - GAP) / EDGE).clamp(0.0, 1.0);
        let edge = (1.0 - away * away).sqrt();
        let horn = smooth_step(0.25, 0.6, edge);
        let Growth { rise, ring, amber } = self.growth(&scute, x, y);
        let colour = mix_rgb(DARK, mix_rgb(AMBER, HONEY, smooth_step(0.5, 0.0, scute.share)), amber);
        // A ring's furrow holds dirt.
        let furrow = smooth_step(0.2, -0.9, ring);
        let shade = (1.0 + 0.18 * grain) * mix(1.0, 0.55, furrow);
        let wear = 0.5 + 0.5 * gradient(self.seed ^ 15, x, y, 8) + 0.3 * grain;
        let polish = mix(HORN_ROUGHNESS[0], HORN_ROUGHNESS[1], (0.8 * wear + 0.2 * furrow).clamp(0.0, 1.0));
        Spot {
            height: GROOVE + edge * (EDGE_RISE + rise + DENTS * dents) + RING_HEIGHT * ring * edge,
            base_colour: mix_rgb(SKIN, colour.map(|c| c * shade), horn),
            roughness: mix(GROOVE_ROUGHNESS, polish + EDGE_WEAR * smooth_step(0.97, 0.75, edge), horn),
            metalness: 0.0,
        }
    }

    fn growth(&self, scute: &Polygon, x: f64, y: f64) -> Growth {
        let draw = |k: u64| lattice(hash(scute.id ^ k), 0, 0, 1);
        let share = scute.share;
        let outside = smooth_step(0.7 * AREOLE, 1.3 * AREOLE, share);
        // A cone with a round top; the areole is nearly level.
        let dome = 1.0 - (share * share + AREOLE * AREOLE).sqrt() + 0.5 * AREOLE;
        let rings = mix(RINGS[0], RINGS[1], draw(1)).round();
        let phase = rings * share + 0.18 * gradient(self.seed ^ 16, x, y, 10);
        let ring = outside * (TAU * phase).cos();

        let count = mix(RAYS[0], RAYS[1], draw(2)).round();
        let angle = scute.offset[1].atan2(scute.offset[0]) + 0.28 * octaves(self.seed ^ 17, x, y, 14, 2);
        let comb =
            (count * angle + TAU * draw(3)).cos() + 0.55 * ((count - 3.0) * angle + TAU * draw(4)).cos();
        let ray = smooth_step(0.2, 0.6, comb) * smooth_step(1.02, 0.85, share);
        let amber = mix(1.0, ray, smooth_step(0.8 * AREOLE, 1.25 * AREOLE, share));
        Growth { rise: mix(DOME_RISE[0], DOME_RISE[1], draw(5)) * dome, ring, amber }
    }
}

/// What a scute's growth left at a position.
struct Growth {
    /// Height over the scute's edge.
    rise: f64,
    /// From -1 in a furrow to 1 on a ring.
    ring: f64,
    /// Share of amber.
    amber: f64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayon::prelude::*;

    const SIDE: usize = 512;

    fn spots(seed: u64, side: usize) -> Vec<Spot> {
        let shell = TurtleShell::new(seed);
        let at = |k: usize| (k as f64 + 0.5) / side as f64;
        (0..side * side).into_par_iter().map(|k| shell.spot(at(k % side), at(k / side))).collect()
    }

    fn share(spots: &[Spot], is: impl Fn(&Spot) -> bool) -> f64 {
        spots.iter().filter(|s| is(s)).count() as f64 / spots.len() as f64
    }

    /// Share of texels that shine at least twice as brightly as white chalk that faces the light: seen along the
    /// plane's normal, lit from 45 degrees, with normals from differences to the next texels of the default field and
    /// roughness from `rough`.
    fn highlights(spots: &[Spot], rough: impl Fn(&Spot) -> f64) -> f64 {
        let (sin, cos) = std::f64::consts::FRAC_PI_8.sin_cos();
        let bright = |k: usize| {
            let (i, j) = (k / SIDE, k % SIDE);
            let slope = |next: usize| (spots[next].height - spots[k].height) * SIDE as f64;
            let (sx, sy) = (slope(i * SIDE + (j + 1) % SIDE), slope((i + 1) % SIDE * SIDE + j));
            let up = 1.0 / (1.0 + sx * sx + sy * sy).sqrt();
            let half = up * (cos - sx * sin);
            let a2 = rough(&spots[k]).powi(4);
            let lobe = a2 / (std::f64::consts::PI * (half * half * (a2 - 1.0) + 1.0).powi(2));
            0.04 * lobe / (4.0 * up) > 2.0 * std::f64::consts::FRAC_1_PI
        };
        (0..SIDE * SIDE).filter(|&k| bright(k)).count() as f64 / (SIDE * SIDE) as f64
    }

    #[test]
    fn every_value_is_one_that_shading_allows() {
        for spots in [spots(0, 128), spots(1, 128)] {
            for s in &spots {
                let values = [s.base_colour[0], s.base_colour[1], s.base_colour[2], s.roughness, s.metalness];
                assert!(s.height.abs() < 0.1 && values.iter().all(|v| (0.0..=1.0).contains(v)));
            }
            assert!(share(&spots, |s| s.height < -0.02) > 0.01 && share(&spots, |s| s.height > 0.02) > 0.01);
        }
    }

    #[test]
    fn it_repeats_with_the_tile_and_seeds_differ() {
        // x + 1 rounds positions by 1e-16; an edge starts as a square root.
        const ROUNDING: f64 = 1e-6;
        let (shell, other) = (TurtleShell::new(3), TurtleShell::new(4));
        let (mut moved, mut changed) = (0, 0);
        for k in 0..200 {
            let (x, y) = (k as f64 * 0.754_877 % 1.0, k as f64 * 0.569_840 % 1.0);
            let (here, there) = (shell.spot(x, y), shell.spot(x + 1.0, y - 2.0));
            assert!((here.height - there.height).abs() < ROUNDING);
            assert!((here.roughness - there.roughness).abs() < ROUNDING);
            let differs = |spot: Spot| usize::from((here.roughness - spot.roughness).abs() > ROUNDING);
            moved += differs(shell.spot(x + 0.5, y));
            changed += differs(other.spot(x, y));
        }
        // Grooves are alike everywhere.
        assert!(moved > 180 && changed > 180, "{moved} {changed}");
    }

    #[test]
    fn horn_is_glossy_grooves_are_matte_and_highlights_are_sharp_and_small() {
        let spots = spots(0, SIDE);
        assert!((0.6..0.9).contains(&share(&spots, |s| s.roughness < 0.31)));
        assert!((0.05..0.2).contains(&share(&spots, |s| s.roughness > 0.7)));
        assert!((0.25..0.6).contains(&share(&spots, |s| s.base_colour[0] > 0.2)));
        assert!((0.002..0.05).contains(&highlights(&spots, |s| s.roughness)));
        // The same shape with a satin finish has none.
        assert_eq!(highlights(&spots, |s| s.roughness.max(0.4)), 0.0);
    }
}
