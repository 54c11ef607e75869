//! Sprayed insulation foam, cut open: a skin with ragged holes over deep cells of several sizes. Matte, porous, deep.
//!
//! Two parts: [`InsulationFoam::spot`] is the solid with its cells, [`InsulationFoam::sheet`] the skin above it.

use super::noise::{gradient, lattice, octaves};
use super::{Spot, mix, mix_rgb, smooth_step};
use crate::random::hash;

/// Voids that the skin roofed.
const VOIDS: Bubbles = Bubbles { period: 4, radius: [0.40, 0.66], share: 0.92, sink: 0.22 };
/// Bubbles in the foam around them, the coarse ones first.
const BUBBLES: [Bubbles; 3] = [
    Bubbles { period: 12, radius: [0.40, 0.66], share: 0.45, sink: 0.25 },
    Bubbles { period: 19, radius: [0.42, 0.66], share: 0.9, sink: 0.15 },
    Bubbles { period: 30, radius: [0.42, 0.66], share: 0.95, sink: 0.15 },
];
/// Height of the foam's walls where no void cuts them, in tile widths; the skin lies on them.
const TOP: f64 = 0.035;
/// Height that the deepest cells tend to, and the height over it from which they do.
const FLOOR: f64 = -0.098;
const SOLE: f64 = 0.035;
/// Height by which foam and skin swell and sink.
const SWELL: f64 = 0.012;
/// Depth below the crests of the walls between cells down to which walls are thin and look bright.
const WALL: f64 = 0.016;
/// Height of fine grain on the foam.
const GRAIN: f64 = 0.0015;
/// Least distance of the skin from the foam: two fields that touch would show through each other.
const SKIN_GAP: f64 = 0.005;
/// Height of the skin's lumps, as foam has that swelled freely.
const LUMPS: f64 = 0.028;
/// Height by which the skin curls up at holes, and how far from them it starts.
const CURL: f64 = 0.010;
const CURL_REACH: f64 = 0.03;
/// Radius of a hole in radii of its void, and the strength with which noise makes it ragged, in tile widths.
const HOLE: f64 = 0.90;
const RAGGED: f64 = 0.046;
/// Share of the finer bubbles that burst through the skin, and the radius of their holes in theirs.
const BURST: f64 = 0.22;
const BURST_RADIUS: f64 = 0.55;
/// Slope of the opacity over a hole's border, in 1 over tile widths: 20 texels of the default field from 0 to 1.
const BORDER_SLOPE: f64 = 25.0;

/// Foam on the walls' crests, in the depth of the cells, and the skin, which light has tanned.
const CREST: [f64; 3] = [0.93, 0.87, 0.62];
const DEPTH: [f64; 3] = [0.60, 0.38, 0.12];
const SKIN: [f64; 3] = [0.78, 0.57, 0.24];
const ROUGHNESS: f64 = 0.92;
const SKIN_ROUGHNESS: f64 = 0.8;

/// Round cavities, one a lattice cell at most.
struct Bubbles {
    period: i64,
    /// Least and greatest radius in lattice cells.
    radius: [f64; 2],
    /// Share of lattice cells that have one.
    share: f64,
    /// Height of a cavity's centre over the surface that it is cut into, in radii.
    sink: f64,
}

/// A cavity seen from a position; lengths in tile widths.
struct Bubble {
    radius: f64,
    /// Uniform in \[0, 1).
    luck: f64,
    /// From the position to the centre.
    towards: [f64; 2],
}

impl Bubbles {
    /// The cavities near a position.
    fn near(&self, seed: u64, x: f64, y: f64) -> impl Iterator<Item = Bubble> {
        let Self { period, radius, share, .. } = *self;
        let (px, py) = (x * period as f64, y * period as f64);
        let (row, column) = (py.floor() as i64, px.floor() as i64);
        (0..9).filter_map(move |k| {
            let (i, j) = (row - 1 + k / 3, column - 1 + k % 3);
            let draw = |salt: u64| lattice(seed ^ salt, i, j, period);
            (draw(1) < share).then(|| Bubble {
                radius: mix(radius[0], radius[1], draw(2)) / period as f64,
                luck: draw(5),
                towards: [j as f64 + draw(3) - px, i as f64 + draw(4) - py].map(|d| d / period as f64),
            })
        })
    }

    /// The two lowest of `from` and of the cavities' walls, each centred over `surface` at its own place.
    fn cut(&self, seed: u64, x: f64, y: f64, from: Lowest, surface: impl Fn(f64, f64) -> f64) -> Lowest {
        self.near(seed, x, y).fold(from, |lowest, Bubble { radius, towards: [dx, dy], .. }| {
            let inside = radius * radius - dx * dx - dy * dy;
            if inside <= 0.0 {
                return lowest;
            }
            let wall = surface(x + dx, y + dy) + self.sink * radius - inside.sqrt();
            Lowest { first: lowest.first.min(wall), second: lowest.second.min(wall.max(lowest.first)) }
        })
    }
}

/// The two lowest heights at a position: where they meet, a wall has its crest.
struct Lowest {
    first: f64,
    second: f64,
}

impl Lowest {
    fn of(height: f64) -> Self {
        Self { first: height, second: f64::INFINITY }
    }
}

/// The material under one seed.
pub struct InsulationFoam {
    seed: u64,
}

impl InsulationFoam {
    pub fn new(seed: u64) -> Self {
        Self { seed: hash(seed ^ 0x666f_616d) }
    }

    /// The foam with its cells; nowhere above the skin.
    pub fn spot(&self, x: f64, y: f64) -> Spot {
        let hollow = self.hollow(x, y);
        let grain = octaves(self.seed ^ 21, x, y, 24, 3);
        let cells = BUBBLES.iter().enumerate().fold(Lowest::of(hollow), |lowest, (k, bubbles)| {
            bubbles.cut(self.bubble_seed(k), x, y, lowest, |x, y| self.hollow(x, y))
        });
        let height = cells.first;
        let crest = 1.0 - smooth_step(0.0, WALL, cells.second - height);
        let light = mix(0.15, 1.0, crest) * mix(0.6, 1.0, smooth_step(FLOOR, TOP, height));
        Spot {
            height: deepen(height + GRAIN * (grain - 1.5)),
            base_colour: mix_rgb(DEPTH, CREST, light).map(|c| c * (1.0 + 0.06 * grain)),
            roughness: ROUGHNESS + 0.05 * grain,
            metalness: 0.0,
        }
    }

    /// The skin and its opacity: a hole where it is below 0.5. The skin lies above the foam everywhere.
    pub fn sheet(&self, x: f64, y: f64) -> (Spot, f64) {
        let into = self.hole_depth(x, y);
        let lumps = gradient(self.seed ^ 31, x, y, 5).abs() + 0.5 * gradient(self.seed ^ 33, x, y, 11).abs();
        let spots = octaves(self.seed ^ 32, x, y, 16, 3);
        let curl = smooth_step(-CURL_REACH, 0.0, into);
        let height = self.top(x, y) + SKIN_GAP + LUMPS * lumps + CURL * curl * curl;
        let shade = 0.92 + 0.12 * spots + 0.15 * lumps;
        let skin = Spot {
            height,
            base_colour: mix_rgb(SKIN, CREST, 0.5 * curl).map(|c| c * shade),
            roughness: SKIN_ROUGHNESS + 0.06 * spots,
            metalness: 0.0,
        };
        (skin, (0.5 - BORDER_SLOPE * into).clamp(0.0, 1.0))
    }

    fn bubble_seed(&self, size: usize) -> u64 {
        self.seed ^ (100 + size as u64)
    }

    /// Height of the walls' tops.
    fn top(&self, x: f64, y: f64) -> f64 {
        TOP + SWELL * gradient(self.seed ^ 41, x, y, 3)
    }

    /// Height of the foam after the voids and before the bubbles.
    fn hollow(&self, x: f64, y: f64) -> f64 {
        VOIDS.cut(self.seed ^ 51, x, y, Lowest::of(self.top(x, y)), |x, y| self.top(x, y)).first
    }

    /// How far a position is inside a hole of the skin, about in tile widths; below 0 outside.
    fn hole_depth(&self, x: f64, y: f64) -> f64 {
        let ragged = RAGGED * octaves(self.seed ^ 61, x, y, 7, 4);
        let inside = |b: &Bubble, part: f64| part * b.radius - b.towards[0].hypot(b.towards[1]);
        let torn = VOIDS.near(self.seed ^ 51, x, y).map(|b| inside(&b, HOLE)).fold(-1.0, f64::max) + ragged;
        let finer = BUBBLES[1].near(self.bubble_seed(1), x, y).filter(|b| b.luck < BURST);
        finer.map(|b| inside(&b, BURST_RADIUS) + 0.15 * ragged).fold(torn, f64::max)
    }
}

/// Levels out towards [`FLOOR`], so that no two cells end in one flat bottom.
fn deepen(height: f64) -> f64 {
    let over = height - FLOOR - SOLE;
    if over >= 0.0 { height } else { FLOOR + SOLE * (over / SOLE).exp() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayon::prelude::*;

    const SIDE: usize = 192;

    fn grid<T: Send>(of: impl Fn(f64, f64) -> T + Sync) -> Vec<T> {
        let at = |k: usize| (k as f64 + 0.5) / SIDE as f64;
        (0..SIDE * SIDE).into_par_iter().map(|k| of(at(k % SIDE), at(k / SIDE))).collect()
    }

    fn share(marks: impl Iterator<Item = bool>) -> f64 {
        marks.filter(|&m| m).count() as f64 / (SIDE * SIDE) as f64
    }

    #[test]
    fn every_value_is_one_that_shading_allows_and_the_foam_is_deep() {
        for seed in 0..2 {
            let foam = InsulationFoam::new(seed);
            let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
            for s in grid(|x, y| foam.spot(x, y)).iter().chain(&grid(|x, y| foam.sheet(x, y).0)) {
                let values = [s.base_colour[0], s.base_colour[1], s.base_colour[2], s.roughness, s.metalness];
                assert!(values.iter().all(|v| (0.0..=1.0).contains(v)));
                assert!(s.roughness > 0.7);
                (low, high) = (low.min(s.height), high.max(s.height));
            }
            assert!(low > -0.1 && high < 0.1 && (0.15..0.2).contains(&(high - low)), "{low} {high}");
        }
    }

    #[test]
    fn it_repeats_with_the_tile_and_seeds_differ() {
        // x + 1 rounds positions by 1e-16; a bubble's wall is a square root.
        const ROUNDING: f64 = 1e-6;
        let (foam, other) = (InsulationFoam::new(3), InsulationFoam::new(4));
        for k in 0..200 {
            let (x, y) = (k as f64 * 0.754_877 % 1.0, k as f64 * 0.569_840 % 1.0);
            let (here, there) = (foam.spot(x, y), foam.spot(x + 1.0, y - 2.0));
            assert!((here.height - there.height).abs() < ROUNDING);
            let (skin, far) = (foam.sheet(x, y), foam.sheet(x + 1.0, y - 2.0));
            assert!((skin.0.height - far.0.height).abs() < ROUNDING && (skin.1 - far.1).abs() < ROUNDING);
            assert!((here.height - foam.spot(x + 0.5, y).height).abs() > ROUNDING);
            assert!((skin.0.height - other.sheet(x, y).0.height).abs() > ROUNDING);
        }
    }

    #[test]
    fn the_skin_lies_above_the_foam() {
        // Heights in fields are f32 of about 0.1.
        const LEAST: f64 = 1e-3;
        for seed in 0..3 {
            let foam = InsulationFoam::new(seed);
            let gaps = grid(|x, y| foam.sheet(x, y).0.height - foam.spot(x, y).height);
            let least = gaps.iter().fold(f64::INFINITY, |a, &b| a.min(b));
            assert!(least > LEAST, "{least}");
            assert!(least < 3.0 * SKIN_GAP, "the skin rests on the walls: {least}");
        }
    }

    #[test]
    fn holes_take_about_half_of_the_skin_and_have_soft_borders() {
        for seed in 0..3 {
            let foam = InsulationFoam::new(seed);
            let opacity = grid(|x, y| foam.sheet(x, y).1);
            let holes = share(opacity.iter().map(|&o| o < 0.5));
            assert!((0.35..0.65).contains(&holes), "{holes}");
            // From texel to texel the opacity moves by part of its range, so that bilinear borders follow the shape.
            let steps = opacity.windows(2).enumerate().filter(|(k, _)| (k + 1) % SIDE != 0);
            let hard = share(steps.map(|(_, o)| (o[1] - o[0]).abs() > 0.5));
            assert!(hard < 0.002, "{hard}");
            assert!(
                share(opacity.iter().map(|&o| o > 0.02 && o < 0.98)) > 0.1,
                "a hard mask has none between"
            );
        }
    }

    #[test]
    fn cells_are_dark_below_bright_walls() {
        let foam = InsulationFoam::new(0);
        let spots = grid(|x, y| foam.spot(x, y));
        let brightness = |s: &Spot| s.base_colour[2];
        assert!((0.05..0.4).contains(&share(spots.iter().map(|s| brightness(s) > 0.42))));
        assert!((0.3..0.8).contains(&share(spots.iter().map(|s| brightness(s) < 0.28))));
    }
}
