//! The walk of many rays over the pyramid of maxima, a ray a lane, in single precision.
//!
//! It is the walk of `raycast`, without branches: every lane passes or opens its own block. What it decides, it decides
//! with room for rounding; where that leaves a doubt the lane stops, and double precision decides.

use super::heights::{Heights, Lanes};
use crate::kernels::simd::Simd;

/// Rays of a group, whatever the number of lanes.
pub(super) const GROUP: usize = 16;

/// A bit for every ray of a group.
pub(super) const ALL: u32 = (1 << GROUP) - 1;

/// One number a ray.
#[derive(Clone, Copy, Default)]
#[repr(align(64))]
pub(super) struct Each(pub [f32; GROUP]);

/// Rays inside one copy of the tile, in grid coordinates of that copy. Distances count from where the ray enters it.
#[derive(Clone, Copy, Default)]
pub(super) struct Steps {
    pub x: Each,
    pub y: Each,
    pub z: Each,
    pub dx: Each,
    pub dy: Each,
    pub dz: Each,
    pub inverse_x: Each,
    pub inverse_y: Each,
    /// 1 / dz of rays that fall, 0 of others.
    pub inverse_fall: Each,
    /// 1 where columns rise along the ray, else 0.
    pub right: Each,
    /// 1 where rows rise along the ray, else 0.
    pub down: Each,
    /// Where the ray ends or leaves the copy of the tile.
    pub end: Each,
    /// How far it has come.
    pub t: Each,
    /// Patch that it is over.
    pub row: Each,
    pub column: Each,
    /// Side of the block that it looks at, which holds the patch.
    pub side: Each,
    /// 1 for a ray that leaves its patch whatever the height there, else 0.
    pub pass: Each,
}

impl Steps {
    /// Ends ray k after `end`, or before at a border of the tile: there where the walk comes to it, to the last bit, for
    /// beyond it there are no patches.
    #[inline(always)]
    pub fn end_at_border(&mut self, k: usize, [width, height]: [f32; 2], end: f32) {
        let tx = (self.right.0[k] * width - self.x.0[k]) * self.inverse_x.0[k];
        let ty = (self.down.0[k] * height - self.y.0[k]) * self.inverse_y.0[k];
        let border = if tx < ty { tx } else { ty };
        self.end.0[k] = if border < end { border } else { end };
    }
}

/// Why rays have stopped, a bit each.
#[derive(Clone, Copy, Default)]
pub(super) struct Stopped {
    /// At a patch that they may meet.
    pub held: u32,
    /// Surely below the surface.
    pub struck: u32,
}

/// Walks the live rays of one vector, those from `at` on, until all of them have stopped. Rays that are neither held nor
/// struck have come to their end. Without `STRIKE` none is struck.
#[inline(always)]
pub(super) fn walk<S: Simd, const STRIKE: bool>(
    s: S,
    heights: &Heights,
    steps: &mut Steps,
    at: usize,
    live: u32,
) -> Stopped {
    let lanes = ((1_u64 << S::LANES) - 1) as u32;
    let live = live >> at & lanes;
    if live == 0 {
        return Stopped::default();
    }
    let surface = heights.lanes(s);
    let load = |each: &Each| s.load(&each.0[at..]);
    let whole = |each: &Each| s.truncate(s.load(&each.0[at..]));
    let zero = s.splat(0.0);
    let (none, one, largest) = (s.int(0), s.int(1), s.int(heights.largest as i32));
    let (x, y, z) = (load(&steps.x), load(&steps.y), load(&steps.z));
    let (dx, dy, dz) = (load(&steps.dx), load(&steps.dy), load(&steps.dz));
    let ray = [x, y, z, dx, dy, dz];
    let (inverse_x, inverse_y) = (load(&steps.inverse_x), load(&steps.inverse_y));
    let (inverse_fall, end) = (load(&steps.inverse_fall), load(&steps.end));
    // All bits where the ray goes right, and what leads from a block's border to the patch behind it.
    let (right, behind_x) = (s.int_sub(none, whole(&steps.right)), s.int_sub(whole(&steps.right), one));
    let (down, behind_y) = (s.int_sub(none, whole(&steps.down)), s.int_sub(whole(&steps.down), one));
    let falls = s.greater(zero, dz);
    let (mut t, mut row, mut column) = (load(&steps.t), whole(&steps.row), whole(&steps.column));
    let mut side = whole(&steps.side);
    let mut pass = s.greater(load(&steps.pass), zero);
    let (mut over, mut held, mut struck) = (0, 0, 0);
    loop {
        // Where does the ray leave the block? The exponent of 2^-l is 254 less that of 2^l.
        let inverse = s.as_float(s.int_sub(s.int(254 << 23), s.bits(s.float(side))));
        let first = s.int_sub(none, side);
        let (left, top) = (s.int_and(column, first), s.int_and(row, first));
        let (ex, ey) = (s.int_add(left, s.int_and(side, right)), s.int_add(top, s.int_and(side, down)));
        let tx = s.mul(s.sub(s.float(ex), x), inverse_x);
        let ty = s.mul(s.sub(s.float(ey), y), inverse_y);
        let exit = s.max(s.min(s.min(tx, ty), end), t);

        // Pass the block if the ray stays above it. A ray that falls looks closer from where it gets below the maximum.
        let most = surface.most(s, s.float(top), s.float(left), inverse);
        let lowest = s.add(z, s.mul(dz, s.select(falls, exit, t)));
        let below = s.min(s.max(s.mul(s.sub(most, z), inverse_fall), t), exit);
        let finest = s.greater(inverse, s.splat(0.75));
        let mut passes = s.either(s.greater(lowest, most), pass);
        pass = s.greater(zero, zero);
        let near = s.mask_bits(finest) & !s.mask_bits(passes);
        if near & live & !(held | over) != 0 {
            // Rays that are held already come to the same end again: t is `below` by then.
            let (least, ends) = heights_over(s, &surface, &ray, [row, column], [below, exit]);
            passes = s.either(passes, s.both(finest, s.greater(least, surface.slack)));
            if STRIKE {
                let deep = s.mask_bits(s.greater(s.sub(zero, surface.slack), ends));
                struck |= deep & near & !over;
                over |= struck;
            }
        }
        let passed = s.mask_bits(passes);
        over |= passed & !s.mask_bits(s.both(passes, s.greater(end, exit)));
        held = near & !passed;

        // Move on to the patch behind the block's border, or where the closer look starts. Rounding must not lead out of
        // the block elsewhere: borders that have been crossed are never crossed again.
        t = s.select(passes, exit, below);
        let last = s.int_sub(side, one);
        let px = s.truncate(s.add(x, s.mul(dx, t)));
        let py = s.truncate(s.add(y, s.mul(dy, t)));
        let px = s.int_min(s.int_max(px, left), s.int_add(left, last));
        let py = s.int_min(s.int_max(py, top), s.int_add(top, last));
        let vertical = s.greater(tx, ty);
        column = s.int_select(passes, s.int_select(vertical, px, s.int_add(ex, behind_x)), px);
        row = s.int_select(passes, s.int_select(vertical, s.int_add(ey, behind_y), py), py);
        // Look at larger blocks once a larger one ends: where its border is one of theirs.
        let border = s.int_select(vertical, ey, ex);
        let larger = s.int_min(s.int_sub(s.int_add(side, side), s.int_and(border, side)), largest);
        side = s.int_select(passes, larger, s.int_max(s.int_down::<1>(side), one));
        if live & !(over | held) == 0 {
            break;
        }
    }
    let store = |each: &mut Each, v| s.store(&mut each.0[at..], v);
    store(&mut steps.t, t);
    store(&mut steps.row, s.float(row));
    store(&mut steps.column, s.float(column));
    store(&mut steps.side, s.float(side));
    Stopped { held: (held & !over & live) << at, struck: (struck & live) << at }
}

/// A bound below the heights of rays over their patches between two distances, and the lower of those at the two.
#[inline(always)]
fn heights_over<S: Simd>(
    s: S,
    surface: &Lanes<'_, S>,
    ray: &[S::F; 6],
    [row, column]: [S::I; 2],
    [from, to]: [S::F; 2],
) -> (S::F, S::F) {
    let patch = surface.patches(s, row, column);
    let corner = [s.float(column), s.float(row)];
    let (first, u0, v0) = height_over(s, ray, &patch, corner, from);
    let (last, u1, v1) = height_over(s, ray, &patch, corner, to);
    // The height is a quadratic in t, and lies between its Bernstein coefficients.
    let bend = s.mul(s.mul(patch[3], s.sub(u1, u0)), s.sub(v1, v0));
    let middle = s.mul(s.splat(0.5), s.add(s.add(first, last), bend));
    let ends = s.min(first, last);
    (s.min(ends, middle), ends)
}

/// Heights of rays over their patches at the distance t, and where in the patches that is.
#[inline(always)]
fn height_over<S: Simd>(
    s: S,
    ray: &[S::F; 6],
    patch: &[S::F; 4],
    [column, row]: [S::F; 2],
    t: S::F,
) -> (S::F, S::F, S::F) {
    let [x, y, z, dx, dy, dz] = *ray;
    let [corner, rise_x, rise_y, twist] = *patch;
    let u = s.sub(s.add(x, s.mul(dx, t)), column);
    let v = s.sub(s.add(y, s.mul(dy, t)), row);
    let surface = s.add(s.add(corner, s.mul(rise_x, u)), s.mul(s.add(rise_y, s.mul(twist, u)), v));
    (s.sub(s.add(z, s.mul(dz, t)), surface), u, v)
}
