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

/// Rays of one vector: their group, and where in it they start.
#[derive(Clone, Copy)]
pub(super) struct Chunk {
    pub group: usize,
    pub at: usize,
    /// Rays that do not count, a bit each.
    pub idle: u32,
}

/// Walks the rays of some vectors until all of them have stopped. Vectors take turns, so that one computes while another
/// waits for memory.
#[inline(always)]
pub(super) fn walk<S: Simd, const N: usize>(
    s: S,
    ceiling: &Ceiling,
    groups: &mut [Steps],
    chunks: [Chunk; N],
) -> [Stopped; N] {
    let all = ((1_u64 << S::LANES) - 1) as u32;
    let blocks = ceiling.blocks(s);
    let (zero, half, one, two) = (s.splat(0.0), s.splat(0.5), s.splat(1.0), s.splat(2.0));
    let largest = s.splat((1_u32 << ceiling.top) as f32);
    let never = s.greater(zero, zero);
    let mut t = [zero; N];
    let mut column = [zero; N];
    let mut row = [zero; N];
    let mut side = [zero; N];
    let mut pass = [never; N];
    for c in 0..N {
        let Chunk { group, at, .. } = chunks[c];
        let steps = &groups[group];
        t[c] = s.load(&steps.t.0[at..]);
        column[c] = s.load(&steps.column.0[at..]);
        row[c] = s.load(&steps.row.0[at..]);
        side[c] = s.load(&steps.side.0[at..]);
        pass[c] = s.greater(s.load(&steps.pass.0[at..]), zero);
    }
    let mut over = [0; N];
    let mut held = [0; N];
    loop {
        let mut stopped = true;
        for c in 0..N {
            let Chunk { group, at, idle } = chunks[c];
            let steps = &groups[group];
            let load = |each: &Each| s.load(&each.0[at..]);
            let (x, y, z) = (load(&steps.x), load(&steps.y), load(&steps.z));
            let (dx, dy, dz) = (load(&steps.dx), load(&steps.dy), load(&steps.dz));
            let (inverse_x, inverse_y) = (load(&steps.inverse_x), load(&steps.inverse_y));
            let inverse_fall = load(&steps.inverse_fall);
            let (right, down, end) = (load(&steps.right), load(&steps.down), load(&steps.end));

            // Where does the ray leave the block that holds its patch? 2^-l has the exponent 254 - that of 2^l.
            let inverse = s.as_float(s.int_sub(s.int(254 << 23), s.bits(side[c])));
            let (bx, by) = (s.floor(s.mul(column[c], inverse)), s.floor(s.mul(row[c], inverse)));
            let (hx, hy) = (s.add(bx, right), s.add(by, down));
            let (ex, ey) = (s.mul(hx, side[c]), s.mul(hy, side[c]));
            let tx = s.mul(s.sub(ex, x), inverse_x);
            let ty = s.mul(s.sub(ey, y), inverse_y);
            let exit = s.max(s.min(s.min(tx, ty), end), t[c]);

            let lowest = s.add(z, s.mul(dz, s.select(s.greater(zero, dz), exit, t[c])));
            let most = blocks.most(s, by, bx, inverse);
            let skips = s.either(s.greater(lowest, most), pass[c]);
            pass[c] = never;

            let below = s.min(s.max(s.mul(s.sub(most, z), inverse_fall), t[c]), exit);
            t[c] = s.select(skips, exit, below);
            let (left, top) = (s.mul(bx, side[c]), s.mul(by, side[c]));
            let last = s.sub(side[c], one);
            let px = s.floor(s.add(x, s.mul(dx, t[c])));
            let py = s.floor(s.add(y, s.mul(dy, t[c])));
            let px = s.min(s.max(px, left), s.add(left, last));
            let py = s.min(s.max(py, top), s.add(top, last));
            let vertical = s.greater(tx, ty);
            let next_x = s.sub(s.add(ex, right), one);
            let next_y = s.sub(s.add(ey, down), one);
            column[c] = s.select(skips, s.select(vertical, px, next_x), px);
            row[c] = s.select(skips, s.select(vertical, next_y, py), py);

            let finest = s.mask_bits(s.greater(two, side[c]));
            let onward = s.mask_bits(s.both(skips, s.greater(end, exit)));
            let skipped = s.mask_bits(skips);
            over[c] |= skipped & !onward;
            held[c] = finest & !skipped;
            stopped &= (over[c] | held[c] | idle) & all == all;

            // Larger blocks once a larger one ends: where the border's number among those of the level is even.
            let halves = s.mul(s.select(vertical, hy, hx), half);
            let odd = s.sub(halves, s.floor(halves));
            let larger = s.min(s.mul(side[c], s.sub(two, s.add(odd, odd))), largest);
            side[c] = s.select(skips, larger, s.max(s.mul(side[c], half), one));
        }
        if stopped {
            break;
        }
    }
    let mut out = [Stopped::default(); N];
    for c in 0..N {
        let Chunk { group, at, .. } = chunks[c];
        let steps = &mut groups[group];
        s.store(&mut steps.t.0[at..], t[c]);
        s.store(&mut steps.column.0[at..], column[c]);
        s.store(&mut steps.row.0[at..], row[c]);
        s.store(&mut steps.side.0[at..], side[c]);
        out[c] = Stopped { over: over[c] & all, held: held[c] & !over[c] & all };
    }
    out
}
