//! From a yarn's path to its fibres: plies wound around the centre line, fibres wound in each ply.
//!
//! Fibres fill a ply evenly, stray from their place with smooth noise, and now and then leave the yarn in a loop;
//! hairs with free ends stick out. Ply twist, migration and loops follow the anatomy of Zhao, Luan and Bala (2016),
//! "Fitting procedural yarn models for realistic cloth rendering".

use super::yarn::{Path, Wave, add, unit};
use crate::random::Random;
use crate::reference::primitives::Curve;
use std::f64::consts::{PI, TAU};
use std::ops::Range;

/// Turn between fibres of neighbouring rank: the golden angle, which fills a disc evenly at any number.
const GOLDEN: f64 = 2.399_963_229_728_653;
/// Most of a ply's radius that a straying fibre keeps to: a little fuzz on its outside.
const FUZZ: f64 = 1.06;
/// How much a ply's thickness varies along it, as a share.
const SWELL: f64 = 0.06;
/// How far a fibre's shade lies from its yarn's, as a share of all shades: standard deviation.
const SHADE_SPREAD: f64 = 0.16;
/// Part of its way, in tiles, that a loop is off the yarn.
const LOOP_REACH: Range<f64> = 0.03..0.08;
/// Pieces of a hair.
const HAIR_PIECES: usize = 10;
/// Hairs are finer than the fibres of the yarn: single ones.
const HAIR_RADIUS: f64 = 0.6;

/// How a yarn is spun.
#[derive(Clone, Debug)]
pub struct Spin {
    /// Plies, at least 1.
    pub plies: usize,
    /// Turns of the plies around the yarn in a tile; whole, so that each ply meets itself. Negative ones turn back.
    pub ply_turns: i32,
    /// Turns of the fibres around their ply in a tile, over those of the ply.
    pub fibre_turns: i32,
    /// Fibres a ply.
    pub fibres: usize,
    /// Radius of a fibre, in tile widths.
    pub fibre_radius: f64,
    /// How far fibres stray from their place, in radii of the ply.
    pub migration: f64,
    /// How unevenly the yarn is twisted, in turns.
    pub uneven: f64,
    /// Share of the fibres that leave the yarn in a loop.
    pub loops: f64,
    /// Height of a loop over the ply, in its radii.
    pub loop_height: f64,
    /// Hairs a yarn.
    pub hairs: usize,
    /// Length of the longest hair, in tile widths.
    pub hair_length: f64,
    /// Places a tile at which the curves bend.
    pub places: usize,
    /// Looks that the fibres point into, from dark to light.
    pub shades: Range<u32>,
}

/// The curves of a yarn.
pub struct Spun {
    /// Fibres, all of which go on in the next tile.
    pub endless: Vec<Curve>,
    /// Hairs, which end.
    pub hairs: Vec<Curve>,
}

/// Winds fibres along a path.
pub fn spin(path: &Path, spin: &Spin, random: &mut Random) -> Spun {
    let plies = spin.plies as f64;
    let ply_radius = if spin.plies > 1 { 1.0 / (1.0 + 1.0 / (PI / plies).sin()) } else { 1.0 };
    let start = random.uniform_f64();
    let twist = Wave::new(random, 1, 5);
    let yarn_shade = random.uniform_f64();
    let mut endless = Vec::with_capacity(spin.plies * spin.fibres);
    let tiles: Vec<f64> = (0..path.len()).map(|k| k as f64 / path.len() as f64).collect();
    for ply in 0..spin.plies {
        let swell = Wave::new(random, 1, 7);
        // What the fibres of a ply share: its angle around the yarn, its centre and its radius.
        let axes = tiles.iter().map(|&t| {
            let wound =
                start + f64::from(spin.ply_turns) * t + spin.uneven * twist.at(t) + ply as f64 / plies;
            let (sin, cos) = (TAU * wound).sin_cos();
            let offset = 1.0 - ply_radius;
            ([offset * cos, offset * sin], wound, ply_radius * (1.0 + SWELL * swell.at(t)))
        });
        let axes: Vec<_> = axes.collect();
        for rank in 0..spin.fibres {
            let fibre = Fibre::new(spin, rank, random);
            let look = shade(&spin.shades, yarn_shade, random);
            let points = tiles.iter().zip(&axes).enumerate().map(|(k, (&t, (centre, wound, scale)))| {
                let (radius, turn) = fibre.polar(t);
                let (sin, cos) = (TAU * (wound + f64::from(spin.fibre_turns) * t + turn)).sin_cos();
                let section = [centre[0] + scale * radius * cos, centre[1] + scale * radius * sin];
                place(path, k, section, spin.fibre_radius)
            });
            let mut points: Vec<_> = points.collect();
            points.push(add(points[0], path.period, 1.0));
            endless.push(Curve { points, radius: spin.fibre_radius, look });
        }
    }
    let hairs = (0..spin.hairs).map(|_| hair(path, spin, shade(&spin.shades, yarn_shade, random), random));
    let hairs = hairs.collect();
    Spun { endless, hairs }
}

/// A fibre's place in its ply.
struct Fibre {
    radius: f64,
    turn: f64,
    migration: f64,
    inward: Wave,
    around: Wave,
    /// Middle, reach and height of the loop.
    arc: Option<[f64; 3]>,
}

impl Fibre {
    fn new(spin: &Spin, rank: usize, random: &mut Random) -> Self {
        let radius = ((rank as f64 + 0.5) / spin.fibres as f64).sqrt();
        let turn = (rank as f64 * GOLDEN + 0.4 * random.uniform_f64()) / TAU;
        let fastest = (spin.places / 16).max(2);
        let (inward, around) = (Wave::new(random, 1, fastest), Wave::new(random, 1, fastest));
        let arc = [
            random.uniform_f64(),
            LOOP_REACH.start + (LOOP_REACH.end - LOOP_REACH.start) * random.uniform_f64(),
            spin.loop_height * (0.3 + 0.7 * random.uniform_f64()),
        ];
        let leaves = random.uniform_f64() < spin.loops;
        Self { radius, turn, migration: spin.migration, inward, around, arc: leaves.then_some(arc) }
    }

    /// Radius in radii of the ply, and angle in turns, at t.
    fn polar(&self, t: f64) -> (f64, f64) {
        let mut radius = (self.radius + self.migration * self.inward.at(t)).clamp(0.0, FUZZ);
        if let Some([middle, reach, height]) = self.arc {
            let from_middle = (t - middle) - (t - middle).round();
            if from_middle.abs() < reach {
                radius += height * 0.25 * (1.0 + (PI * from_middle / reach).cos()).powi(2);
            }
        }
        let turn = self.turn + self.migration * self.around.at(t) / (TAU * self.radius.max(0.3));
        (radius, turn)
    }
}

fn place(path: &Path, k: usize, [u, v]: [f64; 2], fibre_radius: f64) -> [f64; 3] {
    let width = (path.half_width[k] - fibre_radius).max(0.0);
    let height = (path.half_height[k] - fibre_radius).max(0.0);
    add(add(path.centre[k], path.side[k], width * u), path.up[k], height * v)
}

/// A hair starts below the yarn's upper surface, leaves it at a low angle and curls.
fn hair(path: &Path, spin: &Spin, look: u32, random: &mut Random) -> Curve {
    let k = random.below(path.len());
    let angle = PI * (0.1 + 0.8 * random.uniform_f64());
    let root = place(path, k, [0.9 * angle.cos(), 0.9 * angle.sin()], spin.fibre_radius);
    let length = spin.hair_length * (0.35 + 0.65 * random.uniform_f64());
    let forward = if random.uniform() < 0.5 { 1.0 } else { -1.0 };
    let outward = add(path.side[k].map(|c| c * angle.cos()), path.up[k], 0.6 * angle.sin());
    let mut direction = add(path.along(k).map(|c| c * forward), outward, 0.25 + 0.5 * random.uniform_f64());
    let sway: [f64; 3] = std::array::from_fn(|_| f64::from(random.normal()));
    let curl = f64::from(random.normal()) * 0.35;
    let mut points = vec![root];
    for piece in 0..HAIR_PIECES {
        // Hairs bend back to the cloth: they are held down by their neighbours.
        direction[2] -= 0.12;
        let bend = curl + 0.2 * sway[piece % 3];
        direction = unit(add(direction, [-direction[1], direction[0], 0.0], bend));
        points.push(add(points[piece], direction, length / HAIR_PIECES as f64));
    }
    Curve { points, radius: HAIR_RADIUS * spin.fibre_radius, look }
}

/// A shade near the yarn's own.
fn shade(shades: &Range<u32>, yarn_shade: f64, random: &mut Random) -> u32 {
    let count = f64::from(shades.end - shades.start);
    let at = 0.25 + 0.5 * yarn_shade + SHADE_SPREAD * f64::from(random.normal());
    shades.start + (at * count).clamp(0.0, count - 1.0) as u32
}
