//! A ray's way over the repetitions of the unit cell.

use super::columns::{Columns, Group};
use super::shapes::{CellRay, LANES, Placed, Shapes};
use crate::error::Result;
use crate::reference::raycast::MAX_DISTANCE;

/// How far a hit may lie outside the part of the ray that crosses a cell, in tile widths: the crossing is rounded at
/// 1e-12 (at 10,000 tiles), and neither of two cells may think that a hit on their border is the other's.
const BORDER_MARGIN: f64 = 1e-9;

/// Cells farther than this from the origin are not looked at: positions there are coarser than the margins.
const MAX_CELL: f64 = 1e6;

/// Direction components below this count as 0.
const TINY: f64 = 1e-30;

/// Where a ray hits.
pub(super) struct Found<H> {
    /// In units of the direction's length.
    pub(super) t: f64,
    /// The point, not wrapped.
    pub(super) position: [f64; 3],
    /// The ray's unit direction.
    pub(super) direction: [f64; 3],
    /// The point in the frame of the cell.
    pub(super) local: [f64; 3],
    pub(super) placed: Placed,
    pub(super) hit: H,
}

/// Primitives that repeat with the tile.
#[derive(Debug)]
pub(super) struct Tiled<S: Shapes> {
    pub(super) shapes: S,
    columns: Columns<S::Packet>,
    /// Least and greatest z.
    pub(super) range: [f64; 2],
}

impl<S: Shapes + Sync> Tiled<S> {
    /// # Errors
    /// `Config` on `field`, as [`Columns::new`].
    pub(super) fn new(shapes: S, range: [f64; 2], field: &str) -> Result<Self> {
        let columns = Columns::new(&shapes, field)?;
        Ok(Self { shapes, columns, range })
    }

    /// First hit at 0 <= t <= `t_max`, or any hit if `ANY`. Rays are followed for [`MAX_DISTANCE`]. A ray whose
    /// direction has no length, or that is not finite, hits nothing.
    pub(super) fn trace<const ANY: bool>(
        &self,
        origin: [f64; 3],
        direction: [f64; 3],
        t_max: f64,
    ) -> Option<Found<S::Hit>> {
        let [x, y, z] = direction;
        let length = (x * x + y * y + z * z).sqrt();
        let finite = length > 0.0 && length < f64::INFINITY && origin.iter().all(|o| o.is_finite());
        if !finite || t_max.is_nan() {
            return None;
        }
        let direction = direction.map(|d| d / length);
        let [t0, t_end] = self.clip(origin[2], direction[2], t_max * length)?;

        // A direction without an x or y part gets one that is too small to reach the next cell.
        let inverse = |d: f64| 1.0 / if d.abs() < TINY { TINY.copysign(d) } else { d };
        let (inv_x, inv_y) = (inverse(direction[0]), inverse(direction[1]));
        let (right, up) = (inv_x > 0.0, inv_y > 0.0);
        let mut cell = [0, 1].map(|c| (origin[c] + direction[c] * t0).floor());
        if cell.iter().any(|c| c.abs() > MAX_CELL) {
            return None;
        }

        let aim = self.shapes.aim(direction);
        let mut t = t0;
        loop {
            let tx = (cell[0] + f64::from(right) - origin[0]) * inv_x;
            let ty = (cell[1] + f64::from(up) - origin[1]) * inv_y;
            let exit = tx.min(ty).min(t_end).max(t);
            let ray = CellRay {
                origin: [
                    origin[0] - cell[0] + direction[0] * t,
                    origin[1] - cell[1] + direction[1] * t,
                    origin[2] + direction[2] * t,
                ],
                direction,
                start: -t,
                near: (-t).max(-BORDER_MARGIN),
                far: (exit + BORDER_MARGIN).min(t_end) - t,
            };
            if let Some((s, placed, hit)) = self.in_cell::<ANY>(&aim, ray) {
                let local = std::array::from_fn(|c| ray.origin[c] + direction[c] * s);
                let position = [local[0] + cell[0], local[1] + cell[1], local[2]];
                return Some(Found {
                    t: ((t + s) / length).max(0.0),
                    position,
                    direction,
                    local,
                    placed,
                    hit,
                });
            }
            if exit >= t_end {
                return None;
            }
            t = exit;
            if tx <= ty {
                cell[0] += if right { 1.0 } else { -1.0 };
            } else {
                cell[1] += if up { 1.0 } else { -1.0 };
            }
        }
    }

    /// The part of the ray inside the slab that holds everything, and not beyond its end.
    fn clip(&self, z: f64, dz: f64, t_max: f64) -> Option<[f64; 2]> {
        let (floor, ceiling) = (self.range[0] - BORDER_MARGIN, self.range[1] + BORDER_MARGIN);
        let (mut enter, mut leave): (f64, f64) = (0.0, f64::INFINITY);
        if dz.abs() < TINY {
            if z < floor || z > ceiling {
                return None;
            }
        } else {
            let (first, last) = if dz > 0.0 { (floor, ceiling) } else { (ceiling, floor) };
            enter = ((first - z) / dz).max(0.0);
            leave = (last - z) / dz;
        }
        let end = leave.min(enter + MAX_DISTANCE).min(t_max);
        (end >= enter).then_some([enter, end])
    }

    #[inline]
    fn in_cell<const ANY: bool>(&self, aim: &S::Aim, cell: CellRay) -> Option<(f64, Placed, S::Hit)> {
        let local = self.shapes.local(aim, &cell);
        let mut ray = cell;
        loop {
            let mut best = None;
            self.columns.walk(&cell, cell.far, |group: &Group<S::Packet>, mut far| {
                let mut lanes = self.shapes.candidates(&group.packet, &local, far);
                while lanes != 0 {
                    let lane = lanes.trailing_zeros() as usize & (LANES - 1);
                    lanes &= lanes - 1;
                    let Some((t, hit)) = self.shapes.intersect(&group.packet, lane, aim, &ray) else {
                        continue;
                    };
                    let placed = group.members[lane];
                    if !ANY {
                        best = Some((t, placed, hit));
                        (ray.far, far) = (t, t);
                    } else if self.shapes.stands(placed, t, &cell) {
                        best = Some((t, placed, hit));
                        return -1.0;
                    }
                }
                far
            });
            match best {
                Some((t, placed, _)) if !ANY && !self.shapes.stands(placed, t, &cell) => {
                    // Look on behind it.
                    ray = CellRay { near: t.next_up(), ..cell };
                }
                answer => return answer,
            }
        }
    }
}
