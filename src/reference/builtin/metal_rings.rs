//! Glossy metal rings woven over a dark, matte plate with round holes: sharp highlights, hard shadows, deep parallax.

use super::noise::{gradient, lattice, octaves};
use super::{Spot, mix, mix_rgb, smooth_step};

/// Rings a side of the tile; each has a cell of its own and reaches into its neighbours'.
const RINGS: i64 = 3;
/// Radius of a ring's centre line, in tile widths: above half a cell, so that neighbours cross.
const RADIUS: f64 = 0.193;
/// Radius of the wire.
const WIRE: f64 = 0.033;
/// A ring rises and falls by this twice on its way round: it passes over one neighbour and under the next.
const WEAVE: f64 = 0.020;
/// Height of the rings' centre lines.
const RING_HEIGHT: f64 = -0.004;
/// Height of the plate.
const PLATE_HEIGHT: f64 = -0.022;
/// Depth of the holes below the plate.
const HOLE_DEPTH: f64 = 0.040;
/// Radius of the holes, which sit at the rings' centres.
const HOLE_RADIUS: f64 = 0.068;
/// Width of the holes' rims.
const RIM: f64 = 0.008;
/// Strength of the plate's grain in height.
const GRAIN: f64 = 0.0012;

/// Reflectance at the normal of plain and of tinted rings.
const STEEL: [f64; 3] = [0.82, 0.80, 0.77];
const BRASS: [f64; 3] = [0.91, 0.66, 0.30];
/// Largest share of the tint.
const MOST_BRASS: f64 = 1.0;
/// Part of the wire's radius that is metal: what is left is a dark edge of two texels of the default field, without which the walls below
/// a wire, which a heightfield draws as steps, would glint.
const BARE: f64 = 0.90;
/// Roughness of rings, from and to.
const RING_ROUGHNESS: [f64; 2] = [0.3, 0.42];
/// Paint of the plate, and inside the holes.
const PLATE: [f64; 3] = [0.060, 0.068, 0.085];
const PIT: [f64; 3] = [0.16, 0.045, 0.03];
const PLATE_ROUGHNESS: f64 = 0.6;

/// The material under one seed.
pub struct MetalRings {
    seed: u64,
}

impl MetalRings {
    pub fn new(seed: u64) -> Self {
        Self { seed: crate::random::hash(seed ^ 0x7269_6e67) }
    }

    pub fn spot(&self, x: f64, y: f64) -> Spot {
        self.highest_ring(x, y).unwrap_or_else(|| self.plate(x, y))
    }

    fn highest_ring(&self, x: f64, y: f64) -> Option<Spot> {
        let cell = 1.0 / RINGS as f64;
        let (row, column) = ((y / cell).floor() as i64, (x / cell).floor() as i64);
        let mut best: Option<Spot> = None;
        for i in row - 1..=row + 1 {
            for j in column - 1..=column + 1 {
                let (dx, dy) = (x - (j as f64 + 0.5) * cell, y - (i as f64 + 0.5) * cell);
                let across = dx.hypot(dy) - RADIUS;
                if across.abs() >= WIRE {
                    continue;
                }
                let weave = WEAVE * (2.0 * dy.atan2(dx)).sin();
                let height = RING_HEIGHT + weave + (WIRE * WIRE - across * across).sqrt();
                if best.as_ref().is_none_or(|b| height > b.height) {
                    let draw = |k: u64| lattice(self.seed.wrapping_add(k), i, j, RINGS);
                    let wear = 0.5 + 0.5 * gradient(self.seed ^ 3, x, y, 24);
                    if across.abs() > BARE * WIRE {
                        best = Some(Spot { height, ..self.plate(x, y) });
                        continue;
                    }
                    best = Some(Spot {
                        height,
                        base_colour: mix_rgb(STEEL, BRASS, MOST_BRASS * draw(1)),
                        roughness: mix(RING_ROUGHNESS[0], RING_ROUGHNESS[1], 0.7 * draw(2) + 0.3 * wear),
                        metalness: 1.0,
                    });
                }
            }
        }
        best
    }

    fn plate(&self, x: f64, y: f64) -> Spot {
        let cell = 1.0 / RINGS as f64;
        let to_centre = |p: f64| (p / cell).rem_euclid(1.0) * cell - 0.5 * cell;
        let distance = to_centre(x).hypot(to_centre(y));
        let hole = 1.0 - smooth_step(HOLE_RADIUS - 0.5 * RIM, HOLE_RADIUS + 0.5 * RIM, distance);
        let grain = octaves(self.seed ^ 5, x, y, 12, 4);
        let shade = 1.0 + 0.35 * grain;
        Spot {
            height: PLATE_HEIGHT - HOLE_DEPTH * hole + GRAIN * grain,
            base_colour: mix_rgb(PLATE, PIT, hole).map(|c| c * shade),
            roughness: PLATE_ROUGHNESS + 0.1 * grain,
            metalness: 0.0,
        }
    }
}
