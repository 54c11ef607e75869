//! Where a ray first meets a heightfield: a solid one, or a thin sheet with holes.
//!
//! In grid coordinates a ray crosses one patch over an interval of t, where its height over the surface is a
//! quadratic in t: the root is exact. The pyramid of maxima skips blocks that lie below the ray (the maximum-mipmap
//! walk of Tevs et al. 2008, here with whole-number cells, so that a step always moves on to another cell).

use super::heightfield::Heightfield;
use super::texture::Texture;

/// Farthest that a ray is followed, in tile widths; whatever flies on horizontally for longer has left the surface.
/// A view ray at z = 2.4e-4, the lowest that f32 directions have, crosses a range of 2 within it.
pub const MAX_DISTANCE: f64 = 10_000.0;

/// How far the slab in which a surface is looked for exceeds it, so that rounding never loses the outermost heights.
pub(super) const SLAB_MARGIN: f64 = 1e-7;

/// Steps along the normal by which a ray leaves the surface, in tile widths: far above the rounding of positions
/// (1e-13 at hundreds of tiles), far below a texel.
pub const SURFACE_OFFSET: f64 = 1e-9;

/// Where a ray meets the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance along the ray in units of its direction's length.
    pub t: f64,
    /// The point, not wrapped.
    pub position: [f64; 3],
    /// Upward unit normal of the bilinear patch.
    pub normal: [f64; 3],
}

impl Hit {
    /// The point from which rays leave the surface.
    pub fn departure(&self) -> [f64; 3] {
        std::array::from_fn(|c| self.position[c] + SURFACE_OFFSET * self.normal[c])
    }
}

/// What lies below the surface.
trait Body {
    /// A ray below the surface is inside: it has hit.
    const SOLID: bool;

    /// The ray is known to be above or below the surface.
    fn starts(&mut self, _above: bool) {}

    /// True if a ray that stays between the heights `lowest` and `highest` passes all patches of heights between `least`
    /// and `most`.
    fn passes(&mut self, lowest: f64, highest: f64, least: f32, most: f32) -> bool;

    /// First s in \[0, end\] at which a ray of height c + b s + a s^2 over the surface meets it; `place` gives the
    /// position (x, y) at s.
    fn meets(&mut self, height: [f64; 3], end: f64, place: impl Fn(f64) -> [f64; 2]) -> Option<f64>;
}

/// Everything below the surface is inside.
struct Solid;

impl Body for Solid {
    const SOLID: bool = true;

    fn passes(&mut self, lowest: f64, _: f64, _: f32, most: f32) -> bool {
        lowest > f64::from(most)
    }

    fn meets(&mut self, [a, b, c]: [f64; 3], end: f64, _: impl Fn(f64) -> [f64; 2]) -> Option<f64> {
        first_root(a, b, c, end)
    }
}

/// The surface is a sheet; where the opacity is below one half it has holes.
struct Sheet<'a> {
    opacity: &'a Texture<1>,
    /// The side on which the ray is; None before the first patch.
    above: Option<bool>,
}

impl Body for Sheet<'_> {
    const SOLID: bool = false;

    fn starts(&mut self, above: bool) {
        self.above = Some(above);
    }

    fn passes(&mut self, lowest: f64, highest: f64, least: f32, most: f32) -> bool {
        let over = lowest > f64::from(most);
        if !over && highest >= f64::from(least) {
            return false;
        }
        // A ray that changed sides on a border, where neither patch has a root, is looked at closely.
        *self.above.get_or_insert(over) == over
    }

    fn meets(&mut self, [a, b, c]: [f64; 3], end: f64, place: impl Fn(f64) -> [f64; 2]) -> Option<f64> {
        let above = *self.above.get_or_insert(c >= 0.0);
        let at_start = (c != 0.0 && (c > 0.0) != above).then_some(0.0);
        let at_end = c + end * (b + a * end);
        self.above = Some(if at_end == 0.0 { above } else { at_end > 0.0 });
        let inside = both_roots(a, b, c).into_iter().filter(|s| (0.0..=end).contains(s));
        at_start.into_iter().chain(inside).find(|&s| {
            let [x, y] = place(s);
            self.opacity.at(x, y)[0] >= 0.5
        })
    }
}

/// A root of the ray's height over the surface, with the patch and the position inside it.
struct Crossing {
    t: f64,
    row: usize,
    column: usize,
    u: f64,
    v: f64,
}

impl Heightfield {
    /// First point at 0 <= t <= `t_max` where the ray is on or below the surface. The field is solid below its
    /// surface: a ray that starts inside hits at its origin. Rays are followed for [`MAX_DISTANCE`].
    pub fn intersect(&self, origin: [f64; 3], direction: [f64; 3], t_max: f64) -> Option<Hit> {
        let crossing = self.first_crossing(Solid, origin, direction, t_max)?;
        Some(self.hit(crossing, origin, direction))
    }

    /// True if the ray meets the surface on its way out.
    pub fn occluded(&self, origin: [f64; 3], direction: [f64; 3]) -> bool {
        self.first_crossing(Solid, origin, direction, f64::INFINITY).is_some()
    }

    /// First point at 0 <= t <= `t_max` where the ray crosses the surface, from either side, at an opacity of at least
    /// one half: the field as a thin sheet with holes.
    pub fn intersect_sheet(
        &self,
        opacity: &Texture<1>,
        origin: [f64; 3],
        direction: [f64; 3],
        t_max: f64,
    ) -> Option<Hit> {
        let sheet = Sheet { opacity, above: None };
        let crossing = self.first_crossing(sheet, origin, direction, t_max)?;
        Some(self.hit(crossing, origin, direction))
    }

    fn hit(&self, crossing: Crossing, origin: [f64; 3], direction: [f64; 3]) -> Hit {
        let Crossing { t, row, column, u, v } = crossing;
        let position = std::array::from_fn(|c| origin[c] + direction[c] * t);
        Hit { t, position, normal: self.normal(row, column, u, v) }
    }

    fn first_crossing<B: Body>(
        &self,
        mut body: B,
        origin: [f64; 3],
        direction: [f64; 3],
        t_max: f64,
    ) -> Option<Crossing> {
        let (w, h) = (self.width as f64, self.height as f64);
        let [ox, oy, oz] = [origin[0] * w - 0.5, origin[1] * h - 0.5, origin[2]];
        let [dx, dy, dz] = [direction[0] * w, direction[1] * h, direction[2]];

        // Clip the ray to the slab that holds the surface.
        let (floor, ceiling) = (self.low - SLAB_MARGIN, self.high + SLAB_MARGIN);
        let mut t = 0.0;
        if oz > ceiling {
            if dz >= 0.0 {
                return None;
            }
            t = (ceiling - oz) / dz;
            body.starts(true);
        } else if !B::SOLID && oz < floor {
            if dz <= 0.0 {
                return None;
            }
            t = (floor - oz) / dz;
            body.starts(false);
        }
        let leave =
            if dz == 0.0 { f64::INFINITY } else { (if dz > 0.0 { ceiling } else { floor } - oz) / dz };
        let t_end = leave.max(t).min(t + MAX_DISTANCE).min(t_max);
        if t_end < t {
            return None;
        }

        // A direction without an x or y part gets one that is too small to reach the next patch.
        let inverse = |d: f64| if d.abs() < TINY { 1.0 / TINY } else { 1.0 / d };
        let (inv_x, inv_y, inv_z) = (inverse(dx), inverse(dy), inverse(dz));
        let (right, down) = (dx > -TINY, dy > -TINY);
        let (columns, rows) = (self.width as i64, self.height as i64);

        // The patch under the start: whole numbers inside one copy of the tile, and that copy's origin.
        let (start_x, start_y) = (ox + dx * t, oy + dy * t);
        let (mut tile_x, mut tile_y) = ((start_x / w).floor() * w, (start_y / h).floor() * h);
        let mut column = ((start_x - tile_x) as i64).clamp(0, columns - 1);
        let mut row = ((start_y - tile_y) as i64).clamp(0, rows - 1);

        let top = self.levels.len();
        let mut level = if dz < 0.0 { START_DOWNWARDS } else { START_UPWARDS }.min(top);
        loop {
            // Where does the ray leave the block that holds the current patch?
            let (left, up) = ((column >> level) << level, (row >> level) << level);
            let (end_x, end_y) = ((left + (1 << level)).min(columns), (up + (1 << level)).min(rows));
            let tx = (if right { end_x } else { left } as f64 + tile_x - ox) * inv_x;
            let ty = (if down { end_y } else { up } as f64 + tile_y - oy) * inv_y;
            let t_exit = tx.min(ty).min(t_end).max(t);

            // Skip the block if the ray stays above it; otherwise look closer.
            let (sinks, rises) = if dz < 0.0 { (t_exit, t) } else { (t, t_exit) };
            let (lowest, highest) = (oz + dz * sinks, oz + dz * rises);
            let (i, j) = (row as usize, column as usize);
            if level == 0 {
                let least = if B::SOLID { 0.0 } else { self.patch_min(i, j) };
                if !body.passes(lowest, highest, least, self.patch_max(i, j)) {
                    let patch = self.patch(i, j);
                    let u = ox + dx * t - tile_x - column as f64;
                    let v = oy + dy * t - tile_y - row as f64;
                    // Height of the ray over the patch, s after the entry: c + b s + a s^2.
                    let c = oz + dz * t - patch.height(u, v);
                    let b =
                        dz - (patch.rise_x + patch.twist * v) * dx - (patch.rise_y + patch.twist * u) * dy;
                    let a = -patch.twist * dx * dy;
                    let place = |s: f64| [0, 1].map(|c| origin[c] + direction[c] * (t + s));
                    if let Some(s) = body.meets([a, b, c], t_exit - t, place) {
                        let (u, v) = ((u + dx * s).clamp(0.0, 1.0), (v + dy * s).clamp(0.0, 1.0));
                        return Some(Crossing { t: t + s, row: i, column: j, u, v });
                    }
                }
            } else {
                let most = self.block_max(level, i, j);
                let least = if B::SOLID { 0.0 } else { self.block_min(level, i, j) };
                if !body.passes(lowest, highest, least, most) {
                    // A ray that comes down into the block starts its closer look where it gets below the maximum.
                    let t_below = (f64::from(most) - oz) * inv_z;
                    if dz < 0.0 && t_below > t {
                        t = t_below.min(t_exit);
                        body.starts(true);
                        let x = (ox + dx * t - tile_x) as i64;
                        let y = (oy + dy * t - tile_y) as i64;
                        column = if right { x.clamp(column, end_x - 1) } else { x.clamp(left, column) };
                        row = if down { y.clamp(row, end_y - 1) } else { y.clamp(up, row) };
                    }
                    level -= 1;
                    continue;
                }
            }

            // Move on to the patch behind the block's border, and look at larger blocks once a larger one ends.
            if t_exit >= t_end {
                return None;
            }
            t = t_exit;
            let parent = level + 1;
            let mut rises;
            if tx <= ty {
                column = if right { end_x } else { left - 1 };
                rises = column >> parent != left >> parent;
                if column == columns {
                    column = 0;
                    tile_x += w;
                    rises = true;
                } else if column < 0 {
                    column = columns - 1;
                    tile_x -= w;
                    rises = true;
                }
                let y = (oy + dy * t - tile_y) as i64;
                row = if down { y.clamp(row, end_y - 1) } else { y.clamp(up, row) };
            } else {
                row = if down { end_y } else { up - 1 };
                rises = row >> parent != up >> parent;
                if row == rows {
                    row = 0;
                    tile_y += h;
                    rises = true;
                } else if row < 0 {
                    row = rows - 1;
                    tile_y -= h;
                    rises = true;
                }
                let x = (ox + dx * t - tile_x) as i64;
                column = if right { x.clamp(column, end_x - 1) } else { x.clamp(left, column) };
            }
            if rises && level < top {
                level += 1;
            }
        }
    }
}

/// Direction components below this count as 0.
pub(super) const TINY: f64 = 1e-30;

/// Block size, as a level, with which a walk starts: from above it first sinks through empty space; from the surface
/// what is nearest decides.
const START_DOWNWARDS: usize = 4;
const START_UPWARDS: usize = 0;

/// First s in \[0, end\] at which c + b s + a s^2 <= 0.
fn first_root(a: f64, b: f64, c: f64, end: f64) -> Option<f64> {
    if c < 0.0 {
        return Some(0.0);
    }
    let below_at_end = c + end * (b + a * end) < 0.0;
    let dips_between = a > 0.0 && b < 0.0 && -b < 2.0 * a * end;
    if !below_at_end && !dips_between {
        return None;
    }
    let discriminant = b * b - 4.0 * a * c;
    if discriminant < 0.0 {
        return below_at_end.then_some(end);
    }
    // In this form the first root needs no case for the sign of a and loses no digits as a goes to 0.
    let denominator = discriminant.sqrt() - b;
    if denominator <= 0.0 { below_at_end.then_some(end) } else { Some((2.0 * c / denominator).min(end)) }
}

/// The roots of c + b s + a s^2 in rising order; infinite where there is none.
fn both_roots(a: f64, b: f64, c: f64) -> [f64; 2] {
    let discriminant = b * b - 4.0 * a * c;
    if discriminant < 0.0 {
        return [f64::INFINITY; 2];
    }
    // Neither quotient subtracts nearly equal numbers; 0 / 0 and x / 0 fall out of every interval.
    let q = -0.5 * (b + discriminant.sqrt().copysign(b));
    let (x, y) = (q / a, c / q);
    if x < y { [x, y] } else { [y, x] }
}
