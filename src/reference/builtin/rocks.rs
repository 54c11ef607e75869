//! Rounded rocks packed on pebbly ground: mostly matte, some of them wet.

use super::noise::{Cell, cell, lattice, octaves};
use super::{Spot, mix, mix_rgb, smooth_step};
use crate::random::hash;

/// Rocks and pebbles a side of the tile.
const ROCKS: i64 = 5;
const PEBBLES: i64 = 14;
/// How far their centres leave a regular lattice, in cells.
const JITTER: f64 = 0.75;
/// Strength with which noise bends the outlines, in tile widths.
const BEND: f64 = 0.016;
/// Height of the ground, and of rocks and pebbles above it, in tile widths.
const GROUND: f64 = -0.040;
const ROCK_RISE: [f64; 2] = [0.045, 0.092];
const PEBBLE_RISE: [f64; 2] = [0.008, 0.024];
/// Distance from the border to where a rock is level, in cells.
const SHOULDER: f64 = 0.38;
/// Gap between neighbouring rocks and the ground that shows there, in cells.
const GAP: f64 = 0.025;
/// Largest tilt of a rock's top: rise over its cell in tile widths.
const TILT: f64 = 0.030;
/// Height of fine grain.
const GRAIN: f64 = 0.0022;

/// Colours of stone between which rocks lie, and of the ground.
const STONES: [[f64; 3]; 4] =
    [[0.34, 0.32, 0.30], [0.20, 0.21, 0.23], [0.42, 0.33, 0.24], [0.52, 0.49, 0.44]];
const SOIL: [f64; 3] = [0.10, 0.075, 0.05];
const DRY_ROUGHNESS: f64 = 0.8;
const WET_ROUGHNESS: f64 = 0.38;
/// Share of rocks that are wet.
const WET: f64 = 0.25;

/// The material under one seed.
pub struct Rocks {
    seed: u64,
}

impl Rocks {
    pub fn new(seed: u64) -> Self {
        Self { seed: hash(seed ^ 0x726f_636b) }
    }

    pub fn spot(&self, x: f64, y: f64) -> Spot {
        let bend = |salt: u64| BEND * octaves(self.seed ^ salt, x, y, 6, 2);
        let (bx, by) = (x + bend(11), y + bend(12));
        let grain = octaves(self.seed ^ 21, x, y, 20, 4);
        let ground = Spot {
            height: GROUND + 2.0 * GRAIN * grain,
            base_colour: SOIL.map(|c| c * (1.0 + 0.4 * grain)),
            roughness: 0.95,
            metalness: 0.0,
        };
        let rock = cell(self.seed ^ 31, bx, by, ROCKS, JITTER);
        let pebble = cell(self.seed ^ 41, bx, by, PEBBLES, JITTER);
        [self.stone(&rock, ROCK_RISE, TILT, grain), self.stone(&pebble, PEBBLE_RISE, 0.2 * TILT, grain)]
            .into_iter()
            .flatten()
            .fold(ground, |below, stone| if stone.height > below.height { stone } else { below })
    }

    /// A stone that fills its cell up to the gap; none in the gap.
    fn stone(&self, at: &Cell, rise: [f64; 2], tilt: f64, grain: f64) -> Option<Spot> {
        let inside = (at.border - GAP) / SHOULDER;
        if inside <= 0.0 {
            return None;
        }
        let draw = |k: u64| lattice(hash(at.id ^ k), 0, 0, 1);
        // A quarter of an ellipse from the gap to the shoulder, then level.
        let away = (1.0 - inside).max(0.0);
        let dome = (1.0 - away * away).sqrt();
        let (sin, cos) = (std::f64::consts::TAU * draw(1)).sin_cos();
        let slant = tilt * draw(2) * (cos * at.offset[0] + sin * at.offset[1]);
        let height = GROUND + dome * (mix(rise[0], rise[1], draw(3)) + slant) + GRAIN * grain;
        let kind = draw(4) * (STONES.len() - 1) as f64;
        let first = kind as usize;
        let stone = mix_rgb(STONES[first], STONES[first + 1], kind - first as f64);
        let wet = smooth_step(1.0 - WET, 1.0 - 0.5 * WET, draw(5));
        let dust = smooth_step(0.35, 0.0, inside);
        let shade = (1.0 + 0.28 * grain) * mix(1.0, 0.6, wet);
        Some(Spot {
            height,
            base_colour: mix_rgb(stone.map(|c| c * shade), SOIL, 0.6 * dust),
            roughness: mix(mix(DRY_ROUGHNESS, WET_ROUGHNESS, wet), DRY_ROUGHNESS, dust) + 0.06 * grain,
            metalness: 0.0,
        })
    }
}
