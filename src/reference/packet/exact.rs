//! The exact side of a packet: where rays enter tiles and patches, and their roots, in double precision.
//!
//! Loops over a group have no branches, so that the compiler makes vectors of them.

use super::heights::Heights;
use super::walk::{Each, GROUP, Steps};
use crate::reference::heightfield::Heightfield;
use crate::reference::raycast::{Hit, MAX_DISTANCE, SLAB_MARGIN, TINY};

/// Largest component of origins and directions: beyond it single precision could overflow. No number is not smaller.
const HUGE: f64 = 1e9;

/// Side of the blocks with which rays from above start: they first sink through empty space.
const START_ABOVE: f64 = 16.0;

/// One number a ray.
type Row = [f64; GROUP];

/// Rays of a group in double precision.
#[derive(Default)]
pub(super) struct Rays {
    origin: [Row; 3],
    direction: [Row; 3],
    /// Origins and directions in grid coordinates.
    o: [Row; 3],
    d: [Row; 3],
    inverse: [Row; 2],
    /// Where rays enter the slab that holds the surface, and where they end.
    start: Row,
    end: Row,
    /// First corner of the copy of the tile that each ray is in.
    tile: [Row; 2],
}

/// Kinds of rays at their start, a bit each.
pub(super) struct Started {
    /// They come near the surface at all.
    pub live: u32,
    /// They start between the lowest and the highest point.
    pub inside: u32,
}

/// Where rays of a group meet the patches that they are over.
#[derive(Default)]
pub(super) struct Meetings {
    pub met: [bool; GROUP],
    /// Met already where they enter the patch, so that something before it must have been overlooked.
    pub late: [bool; GROUP],
    t: Row,
    position: [Row; 3],
    normal: [Row; 3],
}

impl Meetings {
    /// What ray k has met.
    #[inline(always)]
    pub fn hit(&self, k: usize) -> Hit {
        let at = |rows: &[Row; 3]| [rows[0][k], rows[1][k], rows[2][k]];
        Hit { t: self.t[k], position: at(&self.position), normal: at(&self.normal) }
    }
}

/// The smaller; one instruction, which `f64::min` is not.
#[inline(always)]
fn least(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

/// The larger.
#[inline(always)]
fn most(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// A bit for every ray that is true.
#[inline(always)]
fn bits(each: &[bool; GROUP]) -> u32 {
    let mut bits = 0;
    for k in 0..GROUP {
        bits |= u32::from(each[k]) << k;
    }
    bits
}

impl Rays {
    /// Sets ray k.
    #[inline(always)]
    pub fn set(&mut self, k: usize, origin: [f64; 3], direction: [f64; 3]) {
        for c in 0..3 {
            self.origin[c][k] = origin[c];
            self.direction[c][k] = direction[c];
        }
    }

    /// Takes all rays to where they enter the slab.
    #[inline(always)]
    pub fn start(&mut self, field: &Heightfield, largest: usize, steps: &mut Steps) -> Started {
        let (w, h) = (field.width as f64, field.height as f64);
        let (floor, ceiling) = (field.low - SLAB_MARGIN, field.high + SLAB_MARGIN);
        let (mut live, mut inside) = ([false; GROUP], [false; GROUP]);
        let mut at = [[0.0; GROUP]; 2];
        for k in 0..GROUP {
            let [px, py, pz] = [self.origin[0][k], self.origin[1][k], self.origin[2][k]];
            let [vx, vy, dz] = [self.direction[0][k], self.direction[1][k], self.direction[2][k]];
            let (ox, oy, dx, dy) = (px * w - 0.5, py * h - 0.5, vx * w, vy * h);
            let sane = (px.abs() < HUGE) & (py.abs() < HUGE) & (pz.abs() < HUGE);
            let sane = sane & (vx.abs() < HUGE) & (vy.abs() < HUGE) & (dz.abs() < HUGE);
            let (above, inverse_z) = (pz > ceiling, 1.0 / dz);
            let start = if above { (ceiling - pz) * inverse_z } else { 0.0 };
            let leave = (if dz > 0.0 { ceiling } else { floor } - pz) * inverse_z;
            let leave = if dz == 0.0 { f64::INFINITY } else { leave };
            live[k] = sane & !(above & (dz >= 0.0));
            inside[k] = pz < field.high - SLAB_MARGIN;
            let (x, y) = (ox + dx * start, oy + dy * start);
            let (tile_x, tile_y) = ((x / w).floor() * w, (y / h).floor() * h);
            (self.o[0][k], self.o[1][k], self.o[2][k]) = (ox, oy, pz);
            (self.d[0][k], self.d[1][k], self.d[2][k]) = (dx, dy, dz);
            // A direction without an x or y part gets one that is too small to reach the next patch.
            self.inverse[0][k] = if dx.abs() < TINY { 1.0 / TINY } else { 1.0 / dx };
            self.inverse[1][k] = if dy.abs() < TINY { 1.0 / TINY } else { 1.0 / dy };
            (self.tile[0][k], self.tile[1][k]) = (tile_x, tile_y);
            (self.start[k], self.end[k]) = (start, least(most(leave, start), start + MAX_DISTANCE));
            (at[0][k], at[1][k]) = (x - tile_x, y - tile_y);
            steps.inverse_fall.0[k] = if dz < 0.0 { inverse_z as f32 } else { 0.0 };
            let side = if inside[k] { 1.0 } else { START_ABOVE };
            steps.side.0[k] = least(side, largest as f64) as f32;
        }
        for k in 0..GROUP {
            let (dx, dy, dz) = (self.d[0][k], self.d[1][k], self.d[2][k]);
            let (right, down) = (dx > -TINY, dy > -TINY);
            (steps.dx.0[k], steps.dy.0[k], steps.dz.0[k]) = (dx as f32, dy as f32, dz as f32);
            steps.inverse_x.0[k] = self.inverse[0][k] as f32;
            steps.inverse_y.0[k] = self.inverse[1][k] as f32;
            steps.right.0[k] = if right { 1.0 } else { 0.0 };
            steps.down.0[k] = if down { 1.0 } else { 0.0 };
            let (start, x, y) = (self.start[k], at[0][k], at[1][k]);
            (steps.x.0[k], steps.y.0[k]) = (x as f32, y as f32);
            steps.z.0[k] = (self.o[2][k] + dz * start) as f32;
            steps.end_at_border(k, [w as f32, h as f32], (self.end[k] - start) as f32);
            steps.column.0[k] = least(most(x.floor(), 0.0), w - 1.0) as f32;
            steps.row.0[k] = least(most(y.floor(), 0.0), h - 1.0) as f32;
        }
        steps.t = Each::default();
        steps.pass = Each::default();
        Started { live: bits(&live), inside: bits(&inside) }
    }

    /// Takes ray k over the border of the copy of the tile; false where it ends before.
    #[inline(always)]
    pub fn next_tile(&mut self, field: &Heightfield, k: usize, steps: &mut Steps) -> bool {
        let sides = [field.width as f64, field.height as f64];
        let onward = [self.d[0][k] > -TINY, self.d[1][k] > -TINY];
        let border = |c: usize| {
            (self.tile[c][k] + if onward[c] { sides[c] } else { 0.0 } - self.o[c][k]) * self.inverse[c][k]
        };
        let (tx, ty) = (border(0), border(1));
        let t = least(tx, ty);
        if t >= self.end[k] || t.is_nan() {
            return false;
        }
        let axis = usize::from(ty < tx);
        self.tile[axis][k] += if onward[axis] { sides[axis] } else { -sides[axis] };
        let place = |c: usize| self.o[c][k] + self.d[c][k] * t - self.tile[c][k];
        let mut at = [place(0), place(1)];
        at[axis] = if onward[axis] { 0.0 } else { sides[axis] };
        (steps.x.0[k], steps.y.0[k]) = (at[0] as f32, at[1] as f32);
        steps.z.0[k] = (self.o[2][k] + self.d[2][k] * t) as f32;
        steps.end_at_border(k, sides.map(|side| side as f32), (self.end[k] - t) as f32);
        steps.column.0[k] = least(most(at[0].floor(), 0.0), sides[0] - 1.0) as f32;
        steps.row.0[k] = least(most(at[1].floor(), 0.0), sides[1] - 1.0) as f32;
        (steps.t.0[k], steps.side.0[k], steps.pass.0[k]) = (0.0, 1.0, 0.0);
        true
    }

    /// True for a ray that falls to the floor of the slab: it cannot miss a solid surface.
    #[inline(always)]
    pub fn lands(&self, k: usize) -> bool {
        self.d[2][k] < 0.0 && self.end[k] < self.start[k] + MAX_DISTANCE
    }

    /// Where the rays of `held` meet the patches that they are over. With `HITS` all that a hit tells, else only whether.
    #[inline(always)]
    pub fn meet<const HITS: bool>(
        &self,
        field: &Heightfield,
        heights: &Heights,
        steps: &Steps,
        held: u32,
        out: &mut Meetings,
    ) {
        let (w, h) = (field.width as f64, field.height as f64);
        let mut corners = [[0.0; GROUP]; 4];
        let mut waiting = held;
        while waiting != 0 {
            let k = waiting.trailing_zeros() as usize;
            waiting &= waiting - 1;
            let heights = heights.corners(steps.row.0[k] as usize, steps.column.0[k] as usize);
            for c in 0..4 {
                corners[c][k] = f64::from(heights[c]);
            }
        }
        for k in 0..GROUP {
            let [h00, h10, h01, h11] = [corners[0][k], corners[1][k], corners[2][k], corners[3][k]];
            let (rise_x, rise_y, twist) = (h10 - h00, h01 - h00, h00 - h10 - h01 + h11);
            let (dx, dy, dz) = (self.d[0][k], self.d[1][k], self.d[2][k]);
            let left = f64::from(steps.column.0[k]) + self.tile[0][k] - self.o[0][k];
            let up = f64::from(steps.row.0[k]) + self.tile[1][k] - self.o[1][k];
            let (x0, x1) = (left * self.inverse[0][k], (left + 1.0) * self.inverse[0][k]);
            let (y0, y1) = (up * self.inverse[1][k], (up + 1.0) * self.inverse[1][k]);
            let enter = most(most(least(x0, x1), least(y0, y1)), self.start[k]);
            let exit = least(least(most(x0, x1), most(y0, y1)), self.end[k]);
            let (u, v) = (dx * enter - left, dy * enter - up);
            // Height of the ray over the patch, s after the entry: c + b s + a s^2.
            let c = self.o[2][k] + dz * enter - (h00 + rise_x * u + (rise_y + twist * u) * v);
            let b = dz - (rise_x + twist * v) * dx - (rise_y + twist * u) * dy;
            let (found, s) = first_root(-twist * dx * dy, b, c, exit - enter);
            out.met[k] = found & (enter <= exit);
            out.late[k] = (c < 0.0) & (enter > self.start[k]);
            if HITS {
                let (u, v) = (least(most(u + dx * s, 0.0), 1.0), least(most(v + dy * s, 0.0), 1.0));
                let t = enter + s;
                out.t[k] = t;
                for c in 0..3 {
                    out.position[c][k] = self.origin[c][k] + self.direction[c][k] * t;
                }
                let (slope_x, slope_y) = ((rise_x + twist * v) * w, (rise_y + twist * u) * h);
                let scale = 1.0 / (1.0 + slope_x * slope_x + slope_y * slope_y).sqrt();
                out.normal[0][k] = -slope_x * scale;
                out.normal[1][k] = -slope_y * scale;
                out.normal[2][k] = scale;
            }
        }
    }
}

/// Whether there is an s in \[0, end\] with c + b s + a s^2 <= 0, and the first one: that of `raycast` without branches.
#[inline(always)]
fn first_root(a: f64, b: f64, c: f64, end: f64) -> (bool, f64) {
    let inside = c < 0.0;
    let below_at_end = c + end * (b + a * end) < 0.0;
    let dips_between = (a > 0.0) & (b < 0.0) & (-b < 2.0 * a * end);
    let discriminant = b * b - 4.0 * a * c;
    let real = discriminant >= 0.0;
    // In this form the first root needs no case for the sign of a and loses no digits as a goes to 0.
    let denominator = most(discriminant, 0.0).sqrt() - b;
    let regular = real & (denominator > 0.0);
    let s = if regular { least(2.0 * c / denominator, end) } else { end };
    (inside | below_at_end | (dips_between & regular), if inside { 0.0 } else { s })
}
