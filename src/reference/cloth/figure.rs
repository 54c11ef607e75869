//! The figure of a damask: an ogee lattice whose cells each hold a palmette, mirrored left to right and dropped by
//! half from one column to the next.

use super::vary;
use crate::random::Random;
use std::f64::consts::{PI, TAU};

/// Discs a stroke: more than two a thread on the longest.
const DISCS: usize = 96;
/// Centres of the cells that reach into a tile, in tile widths: two cells and their copies.
const CENTRES: [[f64; 2]; 13] = [
    [0.0, 0.0],
    [1.0, 0.0],
    [0.0, 1.0],
    [1.0, 1.0],
    [-0.5, -0.5],
    [0.5, -0.5],
    [1.5, -0.5],
    [-0.5, 0.5],
    [0.5, 0.5],
    [1.5, 0.5],
    [-0.5, 1.5],
    [0.5, 1.5],
    [1.5, 1.5],
];
/// No stroke reaches farther from the centre of its cell, to either side or up and down: half a tile and a rosette.
const CELL_REACH: f64 = 0.62;
/// Turns of a volute.
const VOLUTE_TURNS: f64 = 1.25;

/// Which part of the tile the figure covers.
#[derive(Clone, Debug)]
pub struct Figure {
    strokes: Vec<Stroke>,
}

/// Discs along a curve in the right half of a cell: centre, to the right and up, and radius, in tile widths.
#[derive(Clone, Debug)]
struct Stroke {
    discs: Vec<[f64; 3]>,
    /// Whether the stroke adds to the figure, or is cut out of what was drawn before.
    adds: bool,
}

impl Figure {
    /// A figure whose proportions are drawn.
    pub fn new(random: &mut Random) -> Self {
        let mut this = Self { strokes: Vec::new() };
        this.frame(random);
        this.leaves(random);
        this.fruit(random);
        this.rosette([0.5, 0.0], vary(random, 0.046, 0.12));
        this.rosette([0.0, 0.5], vary(random, 0.046, 0.12));
        this
    }

    /// True if the figure covers the point, any in the tile. y goes down.
    pub fn covers(&self, x: f64, y: f64) -> bool {
        let places = CENTRES.map(|[cx, cy]| [(x - cx).abs(), cy - y]);
        let near: Vec<_> = places.iter().filter(|p| p.iter().all(|c| c.abs() < CELL_REACH)).collect();
        let mut covered = false;
        for stroke in &self.strokes {
            let holds = |[u, v]: &[f64; 2]| {
                stroke.discs.iter().any(|[du, dv, r]| (u - du).powi(2) + (v - dv).powi(2) < r * r)
            };
            if near.iter().any(|place| holds(place)) {
                covered = stroke.adds;
            }
        }
        covered
    }

    /// The ogee band around a cell. Its half width goes from half a tile at the middle to nothing at the tips, so
    /// that the same band, shifted by half a tile either way, is its own outside.
    fn frame(&mut self, random: &mut Random) {
        let width = vary(random, 0.021, 0.12);
        let beads = 8.0 + random.below(3) as f64 * 2.0;
        let discs = (0..4 * DISCS).map(|k| {
            let v = (k as f64 + 0.5) / (4 * DISCS) as f64 - 0.5;
            [0.25 * (1.0 + (TAU * v).cos()), v, width * (1.0 + 0.3 * (beads * TAU * v).cos())]
        });
        self.strokes.push(Stroke { discs: discs.collect(), adds: true });
    }

    /// Leaves on both sides of a stem, from large ones below to small ones at the crown, each with its vein.
    fn leaves(&mut self, random: &mut Random) {
        self.blade([[0.0, -0.46], [0.0, -0.3], [0.0, -0.1]], |_| 0.017, true);
        let count = 3 + random.below(2);
        let droop = vary(random, 0.08, 0.6);
        for k in (0..count).rev() {
            let f = k as f64 / (count - 1) as f64;
            let reach = 0.33 - 0.16 * f;
            let root = [0.01, -0.30 + 0.24 * f];
            let bend = [0.55 * reach + 0.06, root[1] - 0.08 * (1.0 - f)];
            let tip = [root[0] + reach, root[1] + 0.14 + 0.20 * f + droop * (0.5 - f)];
            let width = vary(random, 0.050 - 0.012 * f, 0.08);
            let outline = move |s: f64| 0.006 + width * (PI * s.powf(0.9)).sin().max(0.0);
            self.blade([root, bend, tip], |s| outline(s) + 0.014, false);
            self.blade([root, bend, tip], outline, true);
            self.blade([root, bend, tip], |s| 0.010 * (1.0 - s) * f64::from(s > 0.2), false);
        }
        // A volute under the lowest leaves.
        let spiral = (0..DISCS).map(|k| {
            let s = k as f64 / DISCS as f64;
            let (sin, cos) = (TAU * VOLUTE_TURNS * s - 2.4).sin_cos();
            let radius = 0.062 * (1.0 - 0.9 * s);
            [0.085 + radius * cos, -0.375 + radius * sin, 0.013]
        });
        self.strokes.push(Stroke { discs: spiral.collect(), adds: true });
    }

    /// A pomegranate in the middle, with a ring of ground around its heart, and a crown of blades.
    fn fruit(&mut self, random: &mut Random) {
        let size = vary(random, 0.115, 0.08);
        let almond = |scale: f64| move |s: f64| scale * (PI * s.powf(0.85)).sin().max(0.0).powf(0.9);
        self.blade([[0.0, 0.12], [0.005, 0.25], [0.0, 0.43]], |s| 0.036 * (PI * s).sin() + 0.006, true);
        self.blade([[0.03, 0.14], [0.06, 0.25], [0.15, 0.30]], |s| 0.034 * (PI * s).sin() + 0.006, true);
        let spine = [[0.0, -0.17], [0.0, 0.0], [0.0, 0.21]];
        self.blade(spine, almond(size + 0.024), false);
        self.blade(spine, almond(size), true);
        self.blade(spine, almond(0.70 * size), false);
        self.blade(spine, almond(0.46 * size), true);
        for k in 0..3 {
            let v = -0.06 + 0.055 * f64::from(k);
            self.strokes.push(Stroke { discs: vec![[0.0, v, 0.014]], adds: false });
        }
    }

    fn rosette(&mut self, [u, v]: [f64; 2], radius: f64) {
        let petals = (0..8).map(|k| {
            let (sin, cos) = (TAU * f64::from(k) / 8.0).sin_cos();
            [u + radius * cos, v + radius * sin, 0.55 * radius]
        });
        self.strokes.push(Stroke { discs: vec![[u, v, 1.9 * radius]], adds: false });
        self.strokes.push(Stroke { discs: petals.collect(), adds: true });
        self.strokes.push(Stroke { discs: vec![[u, v, 0.62 * radius]], adds: false });
        self.strokes.push(Stroke { discs: vec![[u, v, 0.36 * radius]], adds: true });
    }

    /// A stroke along the quadratic Bezier curve of three points, `radius` wide from its start at 0 to its end at 1.
    fn blade(&mut self, [a, b, c]: [[f64; 2]; 3], radius: impl Fn(f64) -> f64, adds: bool) {
        let discs = (0..DISCS).map(|k| {
            let s = (k as f64 + 0.5) / DISCS as f64;
            let weights = [(1.0 - s) * (1.0 - s), 2.0 * s * (1.0 - s), s * s];
            let at = |axis: usize| weights[0] * a[axis] + weights[1] * b[axis] + weights[2] * c[axis];
            [at(0), at(1), radius(s)]
        });
        self.strokes.push(Stroke { discs: discs.collect(), adds });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Stream;

    /// Places a side at which figures are compared: off the lattice's lines, where rounding decides.
    const PLACES: usize = 41;

    fn agrees(figure: &Figure, other: impl Fn(f64, f64) -> [f64; 2]) -> bool {
        (0..PLACES * PLACES).all(|k| {
            let [x, y] = [k % PLACES, k / PLACES].map(|v| (v as f64 + 0.37) / PLACES as f64);
            let [u, v] = other(x, y).map(|c| c.rem_euclid(1.0));
            figure.covers(x, y) == figure.covers(u, v)
        })
    }

    #[test]
    fn figures_have_the_symmetry_of_a_half_drop() {
        for seed in 0..2 {
            let figure = Figure::new(&mut Random::new(seed, Stream::Material, 0));
            assert!(agrees(&figure, |x, y| [1.0 - x, y]));
            assert!(agrees(&figure, |x, y| [x + 0.5, y + 0.5]));
            assert!(!agrees(&figure, |x, y| [x, 1.0 - y]));
            assert!(!agrees(&figure, |x, y| [x + 0.5, y]));
        }
    }

    #[test]
    fn figures_cover_a_part_and_differ() {
        let covered = |seed| {
            let figure = Figure::new(&mut Random::new(seed, Stream::Material, 0));
            let reach = figure
                .strokes
                .iter()
                .flat_map(|s| &s.discs)
                .fold(0.0, |most: f64, [u, v, r]| most.max(u.abs() + r).max(v.abs() + r));
            assert!(reach < CELL_REACH, "{reach}");
            let at = |k: usize| (k as f64 + 0.37) / PLACES as f64;
            (0..PLACES * PLACES).map(|k| figure.covers(at(k % PLACES), at(k / PLACES))).collect::<Vec<_>>()
        };
        let figures: Vec<_> = (0..4).map(covered).collect();
        for figure in &figures {
            let share = figure.iter().filter(|c| **c).count() as f64 / figure.len() as f64;
            assert!((0.25..0.65).contains(&share), "{share}");
        }
        assert!(figures.windows(2).all(|w| w[0] != w[1]));
    }
}
