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
    /// At the end.
    pub over: u32,
    /// At a patch that may stop them.
    pub held: u32,
}

/// Walks the rays of one vector, from `at` on, until all of them have stopped; those of `idle` do not count.
#[inline(always)]
pub(super) fn walk<S: Simd>(s: S, ceiling: &Ceiling, steps: &mut Steps, at: usize, idle: u32) -> Stopped {
    let all = ((1_u64 << S::LANES) - 1) as u32;
    let load = |each: &Each| s.load(&each.0[at..]);
    let blocks = ceiling.blocks(s);
    let (zero, half, one, two) = (s.splat(0.0), s.splat(0.5), s.splat(1.0), s.splat(2.0));
    let largest = s.splat((1_u32 << ceiling.top) as f32);
    let (x, y, z) = (load(&steps.x), load(&steps.y), load(&steps.z));
    let (dx, dy, dz) = (load(&steps.dx), load(&steps.dy), load(&steps.dz));
    let (inverse_x, inverse_y) = (load(&steps.inverse_x), load(&steps.inverse_y));
    let inverse_fall = load(&steps.inverse_fall);
    let (right, down, end) = (load(&steps.right), load(&steps.down), load(&steps.end));
    let falls = s.greater(zero, dz);
    let (next_x, next_y) = (s.sub(right, one), s.sub(down, one));
    let (mut t, mut column) = (load(&steps.t), load(&steps.column));
    let (mut row, mut side) = (load(&steps.row), load(&steps.side));
    let never = s.greater(zero, zero);
    let mut pass = s.greater(load(&steps.pass), zero);
    let mut over = 0;
    let mut held;
    loop {
        // Where does the ray leave the block that holds its patch? 2^-l has the exponent 254 - that of 2^l.
        let inverse = s.as_float(s.int_sub(s.int(254 << 23), s.bits(side)));
        let (bx, by) = (s.floor(s.mul(column, inverse)), s.floor(s.mul(row, inverse)));
        let (hx, hy) = (s.add(bx, right), s.add(by, down));
        let (ex, ey) = (s.mul(hx, side), s.mul(hy, side));
        let tx = s.mul(s.sub(ex, x), inverse_x);
        let ty = s.mul(s.sub(ey, y), inverse_y);
        let exit = s.max(s.min(s.min(tx, ty), end), t);

        let lowest = s.add(z, s.mul(dz, s.select(falls, exit, t)));
        let most = blocks.most(s, by, bx, inverse);
        let skips = s.either(s.greater(lowest, most), pass);
        pass = never;

        let below = s.min(s.max(s.mul(s.sub(most, z), inverse_fall), t), exit);
        t = s.select(skips, exit, below);
        let (left, top) = (s.mul(bx, side), s.mul(by, side));
        let last = s.sub(side, one);
        let px = s.floor(s.add(x, s.mul(dx, t)));
        let py = s.floor(s.add(y, s.mul(dy, t)));
        let px = s.min(s.max(px, left), s.add(left, last));
        let py = s.min(s.max(py, top), s.add(top, last));
        let vertical = s.greater(tx, ty);
        column = s.select(skips, s.select(vertical, px, s.add(ex, next_x)), px);
        row = s.select(skips, s.select(vertical, s.add(ey, next_y), py), py);

        let finest = s.mask_bits(s.greater(two, side));
        let onward = s.mask_bits(s.both(skips, s.greater(end, exit)));
        let skipped = s.mask_bits(skips);
        over |= skipped & !onward;
        held = finest & !skipped;

        // Larger blocks once a larger one ends: where the border's number among those of the level is even.
        let halves = s.mul(s.select(vertical, hy, hx), half);
        let odd = s.sub(halves, s.floor(halves));
        let larger = s.min(s.mul(side, s.sub(two, s.add(odd, odd))), largest);
        side = s.select(skips, larger, s.max(s.mul(side, half), one));
        if (over | held | idle) & all == all {
            break;
        }
    }
    let mut store = |each: &mut Each, v| s.store(&mut each.0[at..], v);
    store(&mut steps.t, t);
    store(&mut steps.column, column);
    store(&mut steps.row, row);
    store(&mut steps.side, side);
    Stopped { over, held: held & !over }
}
