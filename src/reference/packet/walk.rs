//! The walk of many rays over the pyramid of maxima, a ray a lane, in single precision.

use super::ceiling::Ceiling;
use crate::kernels::simd::Simd;

/// Rays that walk together.
pub(super) const GROUP: usize = 16;

/// One number a ray.
#[derive(Clone, Copy, Default)]
#[repr(align(64))]
pub(super) struct Each(pub [f32; GROUP]);

/// Rays inside one copy of the tile, in grid coordinates of it. Distances count from where the ray enters it.
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
    /// 1 / dz of rays that go down, 0 of others.
    pub inverse_fall: Each,
    /// 1 where dx > 0, else 0.
    pub right: Each,
    /// 1 where dy > 0, else 0.
    pub down: Each,
    /// Where the ray ends, or leaves the tile.
    pub end: Each,
    /// How far it has come.
    pub t: Each,
    /// Patch that it is over.
    pub column: Each,
    pub row: Each,
    /// Side of the block that it looks at.
    pub side: Each,
    /// 1 for a ray that passes its patch whatever its height, else 0.
    pub pass: Each,
}

/// Rays that have stopped, a bit each.
#[derive(Clone, Copy, Default)]
pub(super) struct Stopped {
    /// At the end, or surely below the surface.
    pub over: u32,
    /// At a patch that may stop them.
    pub held: u32,
    /// Surely below the surface.
    pub struck: u32,
}

/// Walks the rays of one vector, from `at` on, until all of them have stopped; those of `idle` do not count.
#[inline(always)]
pub(super) fn walk<S: Simd, const STRIKE: bool>(s: S, ceiling: &Ceiling, steps: &mut Steps, at: usize, idle: u32) -> Stopped {
    let all = ((1_u64 << S::LANES) - 1) as u32;
    let load = |each: &Each| s.load(&each.0[at..]);
    let whole = |each: &Each| s.truncate(s.load(&each.0[at..]));
    let heights = ceiling.lanes(s);
    let zero = s.splat(0.0);
    let (none, one) = (s.int(0), s.int(1));
    let largest = s.int(ceiling.largest as i32);
    let (x, y, z) = (load(&steps.x), load(&steps.y), load(&steps.z));
    let (dx, dy, dz) = (load(&steps.dx), load(&steps.dy), load(&steps.dz));
    let (inverse_x, inverse_y) = (load(&steps.inverse_x), load(&steps.inverse_y));
    let inverse_fall = load(&steps.inverse_fall);
    let (right, down, end) = (whole(&steps.right), whole(&steps.down), load(&steps.end));
    // All bits where the ray goes right, and -1 where it goes left.
    let (right, before) = (s.int_sub(none, right), s.int_sub(right, one));
    let (down, above) = (s.int_sub(none, down), s.int_sub(down, one));
    let falls = s.greater(zero, dz);
    let (mut t, mut column) = (load(&steps.t), whole(&steps.column));
    let (mut row, mut side) = (whole(&steps.row), whole(&steps.side));
    let never = s.greater(zero, zero);
    let mut pass = s.greater(load(&steps.pass), zero);
    let (mut over, mut held, mut struck) = (0, 0, 0);
    loop {
        // Where does the ray leave the block that holds its patch? 2^-l has the exponent 254 - that of 2^l.
        let inverse = s.as_float(s.int_sub(s.int(254 << 23), s.bits(s.float(side))));
        let corner = s.int_sub(none, side);
        let (left, top) = (s.int_and(column, corner), s.int_and(row, corner));
        let (ex, ey) = (s.int_add(left, s.int_and(side, right)), s.int_add(top, s.int_and(side, down)));
        let tx = s.mul(s.sub(s.float(ex), x), inverse_x);
        let ty = s.mul(s.sub(s.float(ey), y), inverse_y);
        let exit = s.max(s.min(s.min(tx, ty), end), t);
        let lowest = s.add(z, s.mul(dz, s.select(falls, exit, t)));
        let most = heights.most(s, s.float(top), s.float(left), inverse);
        let below = s.min(s.max(s.mul(s.sub(most, z), inverse_fall), t), exit);
        let finest = s.greater(inverse, s.splat(0.75));
        let mut skips = s.either(s.greater(lowest, most), pass);
        pass = never;
        let near = s.mask_bits(finest) & !s.mask_bits(skips);
        if near & !(held | over | idle) & all != 0 {
            let patch = heights.patch(s, row, column);
            let ray = [x, y, z, dx, dy, dz, s.float(column), s.float(row)];
            // Bernstein coefficients of the ray's height over the patch: the height lies between them.
            let (first, u0, v0) = height_over(s, &ray, &patch, below);
            let (last, u1, v1) = height_over(s, &ray, &patch, exit);
            let bend = s.mul(s.mul(patch[3], s.sub(u1, u0)), s.sub(v1, v0));
            let middle = s.mul(s.splat(0.5), s.add(s.add(first, last), bend));
            let ends = s.min(first, last);
            skips = s.either(skips, s.both(finest, s.greater(s.min(ends, middle), heights.slack)));
            if STRIKE {
                let deep = s.greater(s.sub(zero, heights.slack), ends);
                let surely = s.mask_bits(deep) & near & !over;
                struck |= surely;
                over |= surely;
            }
        }
        let skipped = s.mask_bits(skips);
        let onward = s.mask_bits(s.both(skips, s.greater(end, exit)));
        over |= skipped & !onward;
        held = near & !skipped;

        t = s.select(skips, exit, below);
        let px = s.truncate(s.add(x, s.mul(dx, t)));
        let py = s.truncate(s.add(y, s.mul(dy, t)));
        let last = s.int_sub(side, one);
        let px = s.int_min(s.int_max(px, left), s.int_add(left, last));
        let py = s.int_min(s.int_max(py, top), s.int_add(top, last));
        let vertical = s.greater(tx, ty);
        column = s.int_select(skips, s.int_select(vertical, px, s.int_add(ex, before)), px);
        row = s.int_select(skips, s.int_select(vertical, s.int_add(ey, above), py), py);
        // Larger blocks once a larger one ends: where its border is one of theirs.
        let border = s.int_select(vertical, ey, ex);
        let larger = s.int_min(s.int_sub(s.int_add(side, side), s.int_and(border, side)), largest);
        side = s.int_select(skips, larger, s.int_max(s.int_down::<1>(side), one));
        if (over | held | idle) & all == all {
            break;
        }
    }
    let mut store = |each: &mut Each, v| s.store(&mut each.0[at..], v);
    store(&mut steps.t, t);
    store(&mut steps.column, s.float(column));
    store(&mut steps.row, s.float(row));
    store(&mut steps.side, s.float(side));
    Stopped { over: over & all, held: held & !over & all, struck: struck & all }
}

/// Height of a ray over a patch at the distance t, and where in the patch that is.
#[inline(always)]
fn height_over<S: Simd>(s: S, ray: &[S::F; 8], patch: &[S::F; 4], t: S::F) -> (S::F, S::F, S::F) {
    let [x, y, z, dx, dy, dz, column, row] = *ray;
    let [corner, rise_x, rise_y, twist] = *patch;
    let u = s.sub(s.add(x, s.mul(dx, t)), column);
    let v = s.sub(s.add(y, s.mul(dy, t)), row);
    let surface = s.add(s.add(corner, s.mul(rise_x, u)), s.mul(s.add(rise_y, s.mul(twist, u)), v));
    (s.sub(s.add(z, s.mul(dz, t)), surface), u, v)
}
