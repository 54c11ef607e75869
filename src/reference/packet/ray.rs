//! The exact side of a packet: where rays enter tiles and patches, and their roots, in double precision.
//!
//! Loops over the lanes of a group are written without branches, so that the compiler makes vectors of them.

use super::ceiling::Ceiling;
use super::walk::{Each, GROUP, Steps};
use crate::reference::heightfield::Heightfield;
use crate::reference::raycast::{Hit, MAX_DISTANCE};

/// How far the slab in which a surface is looked for exceeds it.
const SLAB_MARGIN: f64 = 1e-7;

/// Direction components below this count as 0.
const TINY: f64 = 1e-30;

/// Sides of the blocks with which a walk starts.
const START_DOWNWARDS: f32 = 16.0;

/// One number a ray.
type Row = [f64; GROUP];

#[inline(always)]
fn least(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

#[inline(always)]
fn most(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// Rays in double precision.
#[derive(Default)]
pub(super) struct Rays {
    origin: [Row; 3],
    direction: [Row; 3],
    /// Origin and direction in grid coordinates.
    o: [Row; 3],
    d: [Row; 3],
    inverse: [Row; 3],
    start: Row,
    end: Row,
    tile: [Row; 2],
}

/// Where rays of a group meet their patches.
#[derive(Default)]
pub(super) struct Meetings {
    pub met: [bool; GROUP],
    t: Row,
    position: [Row; 3],
    normal: [Row; 3],
}

impl Meetings {
    pub fn hit(&self, k: usize) -> Hit {
        Hit { t: self.t[k], position: self.position.map(|row| row[k]), normal: self.normal.map(|row| row[k]) }
    }
}

impl Rays {
    /// Sets a ray.
    #[inline(always)]
    pub fn set(&mut self, k: usize, origin: [f64; 3], direction: [f64; 3]) {
        for c in 0..3 {
            self.origin[c][k] = origin[c];
            self.direction[c][k] = direction[c];
        }
    }

    /// Rays that come near the surface, a bit each.
    #[inline(always)]
    pub fn start(&mut self, field: &Heightfield, largest: f32, steps: &mut Steps) -> (u32, u32) {
        let (w, h) = (field.width as f64, field.height as f64);
        let (floor, ceiling) = (field.low - SLAB_MARGIN, field.high + SLAB_MARGIN);
        let mut at = [[0.0; GROUP]; 2];
        let mut near = [0_u32; GROUP];
        let mut inside = [0_u32; GROUP];
        for k in 0..GROUP {
            let (ox, oy, oz) = (self.origin[0][k] * w - 0.5, self.origin[1][k] * h - 0.5, self.origin[2][k]);
            let (dx, dy, dz) = (self.direction[0][k] * w, self.direction[1][k] * h, self.direction[2][k]);
            let inverse = |d: f64| if d.abs() < TINY { 1.0 / TINY } else { 1.0 / d };
            let inv_z = 1.0 / dz;
            let t = if oz > ceiling { (ceiling - oz) * inv_z } else { 0.0 };
            let leave = (if dz > 0.0 { ceiling } else { floor } - oz) * inv_z;
            let leave = if dz == 0.0 { f64::INFINITY } else { leave };
            near[k] = u32::from(!((oz > ceiling) & (dz >= 0.0))) << k;
            inside[k] = u32::from(oz < field.high - SLAB_MARGIN) << k;
            let (x, y) = (ox + dx * t, oy + dy * t);
            let (tile_x, tile_y) = ((x / w).floor() * w, (y / h).floor() * h);
            (self.o[0][k], self.o[1][k], self.o[2][k]) = (ox, oy, oz);
            (self.d[0][k], self.d[1][k], self.d[2][k]) = (dx, dy, dz);
            (self.inverse[0][k], self.inverse[1][k], self.inverse[2][k]) = (inverse(dx), inverse(dy), inv_z);
            (self.tile[0][k], self.tile[1][k]) = (tile_x, tile_y);
            (self.start[k], self.end[k]) = (t, least(most(leave, t), t + MAX_DISTANCE));
            (at[0][k], at[1][k]) = (x - tile_x, y - tile_y);
        }
        for k in 0..GROUP {
            let (dx, dy, dz) = (self.d[0][k], self.d[1][k], self.d[2][k]);
            let (right, down) = (dx > -TINY, dy > -TINY);
            steps.dx.0[k] = dx as f32;
            steps.dy.0[k] = dy as f32;
            steps.dz.0[k] = dz as f32;
            steps.inverse_x.0[k] = self.inverse[0][k] as f32;
            steps.inverse_y.0[k] = self.inverse[1][k] as f32;
            steps.inverse_fall.0[k] = if dz < 0.0 { self.inverse[2][k] as f32 } else { 0.0 };
            steps.right.0[k] = if right { 1.0 } else { 0.0 };
            steps.down.0[k] = if down { 1.0 } else { 0.0 };
            let t = self.start[k];
            let tx = (self.tile[0][k] + if right { w } else { 0.0 } - self.o[0][k]) * self.inverse[0][k];
            let ty = (self.tile[1][k] + if down { h } else { 0.0 } - self.o[1][k]) * self.inverse[1][k];
            let (x, y) = (at[0][k], at[1][k]);
            steps.x.0[k] = x as f32;
            steps.y.0[k] = y as f32;
            steps.z.0[k] = (self.o[2][k] + dz * t) as f32;
            steps.end.0[k] = (least(least(tx, ty), self.end[k]) - t) as f32;
            steps.column.0[k] = least(most(x.floor(), 0.0), w - 1.0) as f32;
            steps.row.0[k] = least(most(y.floor(), 0.0), h - 1.0) as f32;
            let side = if inside[k] == 0 { START_DOWNWARDS } else { 1.0 };
            steps.side.0[k] = if side < largest { side } else { largest };
        }
        steps.t = Each([0.0; GROUP]);
        steps.pass = Each([0.0; GROUP]);
        let (mut bits, mut within) = (0, 0);
        for k in 0..GROUP {
            bits |= near[k];
            within |= inside[k];
        }
        (bits, within)
    }

    /// Goes on behind the border of the tile; false where the ray ends before.
    #[inline(always)]
    pub fn next_tile(&mut self, field: &Heightfield, k: usize, steps: &mut Steps) -> bool {
        let sides = [field.width as f64, field.height as f64];
        let onward: [bool; 2] = std::array::from_fn(|c| self.d[c][k] > -TINY);
        let border = |c: usize, tile: f64| {
            (tile + if onward[c] { sides[c] } else { 0.0 } - self.o[c][k]) * self.inverse[c][k]
        };
        let [tx, ty] = [border(0, self.tile[0][k]), border(1, self.tile[1][k])];
        let t = tx.min(ty);
        if t >= self.end[k] {
            return false;
        }
        let axis = usize::from(ty < tx);
        self.tile[axis][k] += if onward[axis] { sides[axis] } else { -sides[axis] };
        let border = |c: usize, tile: f64| {
            (tile + if onward[c] { sides[c] } else { 0.0 } - self.o[c][k]) * self.inverse[c][k]
        };
        let next = border(0, self.tile[0][k]).min(border(1, self.tile[1][k]));
        let mut at: [f64; 2] = std::array::from_fn(|c| self.o[c][k] + self.d[c][k] * t - self.tile[c][k]);
        at[axis] = if onward[axis] { 0.0 } else { sides[axis] };
        steps.x.0[k] = at[0] as f32;
        steps.y.0[k] = at[1] as f32;
        steps.z.0[k] = (self.o[2][k] + self.d[2][k] * t) as f32;
        steps.end.0[k] = (next.min(self.end[k]) - t) as f32;
        steps.t.0[k] = 0.0;
        steps.column.0[k] = at[0].floor().clamp(0.0, sides[0] - 1.0) as f32;
        steps.row.0[k] = at[1].floor().clamp(0.0, sides[1] - 1.0) as f32;
        steps.side.0[k] = 1.0;
        steps.pass.0[k] = 0.0;
        true
    }

    /// Where the rays meet the patches that they are over.
    #[inline(always)]
    pub fn meet<const NORMALS: bool>(&self, field: &Heightfield, ceiling: &Ceiling, steps: &Steps, held: u32, out: &mut Meetings) {
        let (w, h) = (field.width as f64, field.height as f64);
        let (mut h00, mut rise_x, mut rise_y, mut twist) = ([0.0; GROUP], [0.0; GROUP], [0.0; GROUP], [0.0; GROUP]);
        let mut left = held;
        while left != 0 {
            let k = left.trailing_zeros() as usize % GROUP;
            left &= left - 1;
            let (column, row) = (steps.column.0[k] as u32 as usize, steps.row.0[k] as u32 as usize);
            let [a, b, c, d] = ceiling.corners(row, column).map(f64::from);
            (h00[k], rise_x[k], rise_y[k], twist[k]) = (a, b - a, c - a, a - b - c + d);
        }
        for k in 0..GROUP {
            let (dx, dy, dz) = (self.d[0][k], self.d[1][k], self.d[2][k]);
            let left = f64::from(steps.column.0[k]) + self.tile[0][k] - self.o[0][k];
            let up = f64::from(steps.row.0[k]) + self.tile[1][k] - self.o[1][k];
            let (x0, x1) = (left * self.inverse[0][k], (left + 1.0) * self.inverse[0][k]);
            let (y0, y1) = (up * self.inverse[1][k], (up + 1.0) * self.inverse[1][k]);
            let enter = most(most(least(x0, x1), least(y0, y1)), self.start[k]);
            let exit = least(least(most(x0, x1), most(y0, y1)), self.end[k]);
            let (u, v) = (dx * enter - left, dy * enter - up);
            // Height of the ray over the patch, s after the entry: c + b s + a s^2.
            let c = self.o[2][k] + dz * enter - (h00[k] + rise_x[k] * u + (rise_y[k] + twist[k] * u) * v);
            let b = dz - (rise_x[k] + twist[k] * v) * dx - (rise_y[k] + twist[k] * u) * dy;
            let a = -twist[k] * dx * dy;
            let (found, s) = first_root(a, b, c, exit - enter);
            let (u, v) = (least(most(u + dx * s, 0.0), 1.0), least(most(v + dy * s, 0.0), 1.0));
            out.met[k] = found & (enter <= exit);
            let t = enter + s;
            if NORMALS {
                out.t[k] = t;
                for c in 0..3 {
                    out.position[c][k] = self.origin[c][k] + self.direction[c][k] * t;
                }
                let slope_x = (rise_x[k] + twist[k] * v) * w;
                let slope_y = (rise_y[k] + twist[k] * u) * h;
                let scale = 1.0 / (1.0 + slope_x * slope_x + slope_y * slope_y).sqrt();
                out.normal[0][k] = -slope_x * scale;
                out.normal[1][k] = -slope_y * scale;
                out.normal[2][k] = scale;
            }
        }
    }
}

/// First s in \[0, end\] at which c + b s + a s^2 <= 0, and whether there is one.
#[inline(always)]
fn first_root(a: f64, b: f64, c: f64, end: f64) -> (bool, f64) {
    let inside = c < 0.0;
    let below_at_end = c + end * (b + a * end) < 0.0;
    let dips_between = (a > 0.0) & (b < 0.0) & (-b < 2.0 * a * end);
    let discriminant = b * b - 4.0 * a * c;
    let real = discriminant >= 0.0;
    let denominator = (if real { discriminant } else { 0.0 }).sqrt() - b;
    // In this form the first root needs no case for the sign of a and loses no digits as a goes to 0.
    let root = least(2.0 * c / denominator, end);
    let regular = real & (denominator > 0.0);
    let s = if regular { root } else { end };
    (inside | below_at_end | (dips_between & regular), if inside { 0.0 } else { s })
}
