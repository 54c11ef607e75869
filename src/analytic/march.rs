//! The view ray and the shadow, on heights of the query's level. Lanes are queries.
//!
//! Products and sums are rounded one by one: all instruction sets take the same steps.

use super::maps::Maps;
use super::{MapsConfig, Rows, TILE};
use crate::kernels::simd::{Simd, Work};

/// Least z of a direction: about that of the lowest that f32 pairs have above the horizon.
pub(super) const LEAST_Z: f32 = 2e-4;

/// Levels by which maps are read finer than the footprint: what interpolation blurs.
const SHADE_BIAS: f32 = -0.85;
const HEIGHT_BIAS: f32 = -1.0;
/// Heights read between the last step above the surface and the first below it.
const REFINEMENTS: usize = 1;
/// Share of a ray's rise over which its shadow is soft near the point that it leaves.
const NEAR: f32 = 0.5;
/// Height that rounding may take from a ray that leaves the surface: a few units in the last digit of heights up to 1.
const ROUNDING: f32 = 1e-6;
/// Least difference of heights that is divided by: far below what single precision tells apart.
const TINY: f32 = 1e-9;

/// Follows view rays down to the surface.
pub(super) struct View<'a> {
    pub maps: &'a Maps,
    pub config: &'a MapsConfig,
    pub rows: &'a mut Rows,
    /// Where in the footprint, from -1/2 to 1/2 of its sides.
    pub place: [f32; 2],
}

/// Follows rays from there to the light.
pub(super) struct Shadow<'a> {
    pub maps: &'a Maps,
    pub config: &'a MapsConfig,
    pub rows: &'a mut Rows,
}

/// Heights of one level, per lane.
struct Heights<'a, S: Simd> {
    values: &'a [f32],
    start: S::I,
    stride: S::I,
    width: S::F,
    rows: S::F,
    /// Half a texel.
    half: [S::F; 2],
    low: S::F,
    high: S::F,
}

impl<'a, S: Simd> Heights<'a, S> {
    #[inline(always)]
    fn new(s: S, maps: &'a Maps, level: S::F) -> Self {
        let level = s.truncate(s.add(level, s.splat(0.5)));
        let (width, rows) = (s.gather(&maps.widths, level), s.gather(&maps.rows, level));
        let half = s.splat(0.5);
        Self {
            values: &maps.heights,
            start: s.bits(s.gather(&maps.starts, level)),
            stride: s.int_add(s.truncate(width), s.int(1)),
            half: [s.div(half, width), s.div(half, rows)],
            width,
            rows,
            low: s.gather(&maps.lows, level),
            high: s.gather(&maps.highs, level),
        }
    }

    /// Height over a position that was moved by half a texel towards 0.
    #[inline(always)]
    fn at(&self, s: S, x: S::F, y: S::F) -> S::F {
        let column = s.mul(s.sub(x, s.floor(x)), self.width);
        let row = s.mul(s.sub(y, s.floor(y)), self.rows);
        // A fraction that rounds to 1 reads the copy of the first column, and what lies behind it with weight 0.
        let (j, i) = (s.truncate(column), s.truncate(row));
        let (u, v) = (s.sub(column, s.float(j)), s.sub(row, s.float(i)));
        let at = s.int_add(self.start, s.int_add(s.int_mul(i, self.stride), j));
        let (h00, h10) = s.gather_pairs(self.values, at);
        let (h01, h11) = s.gather_pairs(self.values, s.int_add(at, self.stride));
        let near = s.add(h00, s.mul(s.sub(h10, h00), u));
        let far = s.add(h01, s.mul(s.sub(h11, h01), u));
        s.add(near, s.mul(s.sub(far, near), v))
    }
}

/// z of a direction.
#[inline(always)]
pub(super) fn elevation<S: Simd>(s: S, x: S::F, y: S::F) -> S::F {
    let square = s.sub(s.sub(s.splat(1.0), s.mul(x, x)), s.mul(y, y));
    s.max(s.sqrt(s.max(square, s.splat(0.0))), s.splat(LEAST_Z))
}

/// Level of a query, clamped to what the reference clamps it to.
#[inline(always)]
fn level<S: Simd>(s: S, maps: &Maps, level: S::F) -> S::F {
    s.min(s.max(level, s.splat(0.0)), s.splat(maps.coarsest))
}

/// Level of the maps, clamped to what there is.
#[inline(always)]
fn of_maps<S: Simd>(s: S, maps: &Maps, level: S::F, bias: f32) -> S::F {
    let last = s.splat((maps.starts.len() - 1) as f32);
    s.min(s.max(s.add(level, s.splat(maps.level_shift + bias)), s.splat(0.0)), last)
}

/// 2^level, to 0.3 %.
#[inline(always)]
fn footprint<S: Simd>(s: S, level: S::F) -> S::F {
    let whole = s.floor(level);
    let power = s.as_float(s.int_up::<23>(s.int_add(s.truncate(whole), s.int(127))));
    let part = s.sub(level, whole);
    let curve = s.add(s.splat(0.6565), s.mul(s.splat(0.3435), part));
    s.mul(power, s.add(s.splat(1.0), s.mul(part, curve)))
}

/// A view ray over the plane, by its height.
struct Ray<S: Simd> {
    x: S::F,
    y: S::F,
    dx: S::F,
    dy: S::F,
}

impl<S: Simd> Ray<S> {
    /// How far it is under the surface at the height z.
    #[inline(always)]
    fn under(&self, s: S, heights: &Heights<S>, z: S::F) -> S::F {
        let (x, y) = (s.add(self.x, s.mul(self.dx, z)), s.add(self.y, s.mul(self.dy, z)));
        s.sub(heights.at(s, x, y), z)
    }
}

/// Where depths that lead from above the surface to below it would be 0 along a line.
#[inline(always)]
fn between<S: Simd>(s: S, [above, below]: [S::F; 2], [over, under]: [S::F; 2]) -> S::F {
    let zero = s.splat(0.0);
    let whole = s.max(s.sub(under, over), s.splat(TINY));
    let share = s.min(s.div(s.max(s.sub(zero, over), zero), whole), s.splat(1.0));
    s.add(above, s.mul(s.sub(below, above), share))
}

impl Work for View<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let Self { maps, config, rows, place } = self;
        let zero = s.splat(0.0);
        let finer = (config.rays as f32).log2();
        for at in (0..TILE).step_by(S::LANES) {
            let level = level(s, maps, s.load(&rows.level[at..]));
            s.store(&mut rows.shade_level[at..], of_maps(s, maps, level, SHADE_BIAS - finer));
            let heights = Heights::new(s, maps, of_maps(s, maps, level, HEIGHT_BIAS - finer));
            let (u, v) = (s.load(&rows.u[0][at..]), s.load(&rows.u[1][at..]));
            let (u, v) = (s.sub(u, s.floor(u)), s.sub(v, s.floor(v)));
            let side = footprint(s, level);
            let u = s.add(u, s.mul(side, s.splat(place[0] * maps.texel[0])));
            let v = s.add(v, s.mul(side, s.splat(place[1] * maps.texel[1])));
            let (wx, wy) = (s.load(&rows.wo[0][at..]), s.load(&rows.wo[1][at..]));
            let inverse = s.div(s.splat(1.0), elevation(s, wx, wy));
            let (dx, dy) = (s.mul(wx, inverse), s.mul(wy, inverse));
            let (px, py) = (s.sub(u, heights.half[0]), s.sub(v, heights.half[1]));
            let ray = Ray { x: px, y: py, dx, dy };

            // The last point above the surface and the first one below it.
            let step = s.mul(s.sub(heights.low, heights.high), s.splat(1.0 / (config.view_steps - 1) as f32));
            let (mut above, mut below) = (heights.high, heights.high);
            let mut depth_above = ray.under(s, &heights, above);
            let mut depth = depth_above;
            for k in 1..config.view_steps {
                let z = s.add(heights.high, s.mul(step, s.splat(k as f32)));
                let open = s.greater(zero, depth);
                if s.mask_bits(open) == 0 {
                    break;
                }
                let found = ray.under(s, &heights, z);
                above = s.select(open, below, above);
                depth_above = s.select(open, depth, depth_above);
                below = s.select(open, z, below);
                depth = s.select(open, found, depth);
            }
            for _ in 0..REFINEMENTS {
                let z = between(s, [above, below], [depth_above, depth]);
                let found = ray.under(s, &heights, z);
                let open = s.greater(zero, found);
                above = s.select(open, z, above);
                depth_above = s.select(open, found, depth_above);
                below = s.select(open, below, z);
                depth = s.select(open, depth, found);
            }
            let z = between(s, [above, below], [depth_above, depth]);
            let (x, y) = (s.add(u, s.mul(dx, z)), s.add(v, s.mul(dy, z)));
            s.store(&mut rows.x[at..], s.sub(x, s.floor(x)));
            s.store(&mut rows.y[at..], s.sub(y, s.floor(y)));
            s.store(&mut rows.z[at..], z);
        }
    }
}

impl Work for Shadow<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let Self { maps, config, rows } = self;
        let (zero, one, half) = (s.splat(0.0), s.splat(1.0), s.splat(0.5));
        let finer = (config.rays as f32).log2();
        for at in (0..TILE).step_by(S::LANES) {
            let level = level(s, maps, s.load(&rows.level[at..]));
            let heights = Heights::new(s, maps, of_maps(s, maps, level, HEIGHT_BIAS - finer));
            let (wx, wy) = (s.load(&rows.wi[0][at..]), s.load(&rows.wi[1][at..]));
            let wz = elevation(s, wx, wy);
            let inverse = s.div(one, wz);
            let (dx, dy) = (s.mul(wx, inverse), s.mul(wy, inverse));
            let (x, y, z) = (s.load(&rows.x[at..]), s.load(&rows.y[at..]), s.load(&rows.z[at..]));
            let (x, y) = (s.sub(x, heights.half[0]), s.sub(y, heights.half[1]));
            // What the march has missed the surface by must not shade it.
            let z = s.max(z, heights.at(s, x, y));
            let climb = s.max(s.sub(heights.high, z), zero);
            let side =
                s.mul(footprint(s, level), s.splat(maps.texel[0].max(maps.texel[1]) / config.rays as f32));
            // Heights by which the light's ray clears or misses a point, from none to all of the footprint: what the footprint's
            // side makes far away, and a share of the rise near by, where only the point's own slope is in the way.
            let flat = s.sqrt(s.add(s.mul(dx, dx), s.mul(dy, dy)));
            let far = s.div(side, s.add(flat, s.splat(TINY)));
            let mut lit = one;
            for k in 0..config.shadow_steps {
                let share = (k as f32 + 0.5) / config.shadow_steps as f32;
                let share = share * share;
                let rise = s.mul(climb, s.splat(share));
                let height = heights.at(s, s.add(x, s.mul(dx, rise)), s.add(y, s.mul(dy, rise)));
                let clear = s.sub(s.add(z, rise), height);
                let width = s.max(s.min(far, s.mul(rise, s.splat(NEAR))), s.splat(TINY));
                let open = s.add(half, s.mul(half, s.div(s.add(clear, s.splat(ROUNDING)), width)));
                lit = s.min(lit, open);
            }
            s.store(&mut rows.lit[at..], s.max(lit, zero));
        }
    }
}
