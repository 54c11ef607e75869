//! Geometry that repeats over the plane: one cell holds every copy of a primitive that touches it, and a ray walks over
//! the repetitions of that cell.

use super::tree::{BoxRay, LANES, Stack, Tree, widened_box};
use crate::error::{Error, Result};
use crate::reference::raycast::MAX_DISTANCE;

/// How far boxes exceed their primitives and the cell's content the cell, in tile widths. It covers what f32 loses on
/// the way to a box: coordinates to 2 and distances to 3 are rounded four times, 4 x 3 x 6e-8.
const BOX_MARGIN: f64 = 2e-6;

/// How far a hit may lie outside the part of the ray that crosses a cell, in tile widths: the crossing is rounded at
/// 1e-12 (at 10,000 tiles), and neither of two cells may think that a hit on their border is the other's.
const BORDER_MARGIN: f64 = 1e-9;

/// Most copies of all primitives together: 2.5 GiB.
const MAX_COPIES: usize = 1 << 24;

/// Grid on which coordinates lie, in tile widths: a shift by whole tiles is then exact in f64, and every copy of a
/// primitive has the same shape to the last bit.
const GRID: f64 = 1.0 / (1u64 << 40) as f64;

/// The nearest grid coordinate.
pub(super) fn snap(x: f64) -> f64 {
    (x / GRID).round() * GRID
}

/// A primitive, moved by whole tiles so that it touches the unit cell.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placed {
    pub(super) index: u32,
    /// Tiles in x and y that are subtracted from the primitive's own position.
    shift: [i8; 2],
}

impl Placed {
    /// A point of the primitive, in the unit cell's frame.
    pub(super) fn place(self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        [x - f64::from(self.shift[0]), y - f64::from(self.shift[1]), z]
    }
}

/// A ray inside one cell: its origin is where it enters, its direction has unit length.
#[derive(Clone, Copy, Debug)]
pub(super) struct CellRay {
    pub(super) origin: [f64; 3],
    pub(super) direction: [f64; 3],
    /// t of the whole ray's origin, at most 0.
    pub(super) start: f64,
    /// Hits count from this t,
    pub(super) near: f64,
    /// to this one.
    pub(super) far: f64,
}

/// Primitives of one kind.
pub(super) trait Shapes {
    /// Up to [`LANES`] primitives side by side.
    type Packet;
    /// What is worked out once a ray.
    type Aim: Copy;
    /// What is worked out once a cell.
    type Local: Copy;
    /// What a hit is described from.
    type Hit: Copy;

    /// Number of primitives.
    fn len(&self) -> usize;
    /// Corners of the box around the part of a primitive over \[-margin, 1 + margin\]^2, once it is placed; None if
    /// nothing is there.
    fn bounds(&self, placed: Placed, margin: f64) -> Option<[[f64; 3]; 2]>;
    /// Least and greatest x and y of a primitive where it lies: \[\[x, x\], \[y, y\]\].
    fn extent(&self, index: u32) -> [[f64; 2]; 2];
    fn packet(&self, members: [Option<Placed>; LANES]) -> Self::Packet;
    fn aim(&self, direction: [f64; 3]) -> Self::Aim;
    fn local(&self, aim: Self::Aim, ray: &CellRay) -> Self::Local;
    /// A bit for each primitive that the ray may hit at t <= far; misses no hit.
    fn candidates(&self, packet: &Self::Packet, local: &Self::Local, far: f32) -> u32;
    /// The exact answer: where in \[near, far\] the ray hits.
    fn intersect(&self, placed: Placed, aim: &Self::Aim, ray: &CellRay) -> Option<(f64, Self::Hit)>;
}

struct Leaf<P> {
    packet: P,
    members: [Placed; LANES],
}

impl<P: std::fmt::Debug> std::fmt::Debug for Leaf<P> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Leaf").field("packet", &self.packet).field("members", &self.members).finish()
    }
}

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
    tree: Tree<Leaf<S::Packet>>,
    /// Least and greatest z.
    pub(super) range: [f64; 2],
}

impl<S: Shapes> Tiled<S> {
    /// # Errors
    /// `Config` on `field` if there is no primitive, or so large ones that their copies in one tile are too many.
    pub(super) fn new(shapes: S, range: [f64; 2], field: &str) -> Result<Self> {
        let (mut placed, mut boxes) = (Vec::new(), Vec::new());
        for index in 0..shapes.len() as u32 {
            let [xs, ys] = shapes.extent(index).map(|[low, high]| {
                ((low - BOX_MARGIN).ceil() as i64 - 1, (high + BOX_MARGIN).floor() as i64)
            });
            for (y, x) in (ys.0..=ys.1).flat_map(|y| (xs.0..=xs.1).map(move |x| (y, x))) {
                let copy = Placed { index, shift: [x as i8, y as i8] };
                let Some([low, high]) = shapes.bounds(copy, BOX_MARGIN) else { continue };
                placed.push(copy);
                boxes.push(widened_box(low, high, BOX_MARGIN));
            }
            if placed.len() > MAX_COPIES {
                return Err(Error::config(
                    field,
                    format!(
                        "more than {MAX_COPIES} pieces overlap in one tile; make them fewer or smaller than a tile"
                    ),
                ));
            }
        }
        if boxes.is_empty() {
            return Err(Error::config(field, "nothing is left of positive size; give at least one piece"));
        }
        let tree = Tree::new(&boxes, |members| {
            let copies: [Option<Placed>; LANES] =
                std::array::from_fn(|lane| members.get(lane).map(|&k| placed[k as usize]));
            let first = placed[members[0] as usize];
            Leaf { packet: shapes.packet(copies), members: copies.map(|copy| copy.unwrap_or(first)) }
        });
        Ok(Self { shapes, tree, range })
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
        let box_ray = BoxRay::new(origin, direction);
        let mut stack = Stack::new();
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
            if let Some((s, placed, hit)) = self.in_cell::<ANY>(&mut stack, aim, &box_ray, ray) {
                let local = std::array::from_fn(|c| ray.origin[c] + direction[c] * s);
                let position = [local[0] + cell[0], local[1] + cell[1], local[2]];
                return Some(Found { t: ((t + s) / length).max(0.0), position, direction, local, placed, hit });
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
    fn in_cell<const ANY: bool>(
        &self,
        stack: &mut Stack,
        aim: S::Aim,
        box_ray: &BoxRay,
        mut ray: CellRay,
    ) -> Option<(f64, Placed, S::Hit)> {
        let local = self.shapes.local(aim, &ray);
        let box_ray = box_ray.with_origin(ray.origin);
        let mut best = None;
        let (near, far) = (ray.near as f32 - F32_MARGIN, ray.far as f32 + F32_MARGIN);
        let visit = |leaf: &Leaf<S::Packet>, mut far: f32| {
            let mut lanes = self.shapes.candidates(&leaf.packet, &local, far);
            while lanes != 0 {
                let placed = leaf.members[lanes.trailing_zeros() as usize & (LANES - 1)];
                lanes &= lanes - 1;
                if let Some((t, hit)) = self.shapes.intersect(placed, &aim, &ray) {
                    best = Some((t, placed, hit));
                    if ANY {
                        return f32::NEG_INFINITY;
                    }
                    ray.far = t;
                    far = t as f32 + F32_MARGIN;
                }
            }
            far
        };
        if ANY {
            self.tree.walk::<false>(stack, &box_ray, near, far, visit);
        } else {
            self.tree.walk::<true>(stack, &box_ray, near, far, visit);
        }
        best
    }
}

/// Direction components below this count as 0.
const TINY: f64 = 1e-30;

/// Cells farther than this from the origin are not looked at: positions there are coarser than the margins.
const MAX_CELL: f64 = 1e6;

/// What f32 may lose of a distance inside a cell, in tile widths.
const F32_MARGIN: f32 = 2e-6;
