//! Rays against fibres: tubes around polylines, each segment a cylinder with spheres at its ends.

use super::shapes::{CellRay, Grid, LANES, Placed, Shapes};
use super::tiled::Tiled;
use super::tube::{frame, outward, tube};
use super::{MAX_PRIMITIVES, check_point, dot, sub};
use crate::error::{Error, Result};
use crate::reference::heightfield::MAX_DEPTH;
use glam::Vec4;

/// Smallest radius of a fibre, in tile widths: coordinates are rounded by a tenth of it.
pub const MIN_RADIUS: f64 = 1e-6;

/// Largest radius of a fibre, in tile widths.
pub const MAX_RADIUS: f64 = 0.25;

/// How deep inside the tube a ray starts that leaves a fibre, in tile widths. Whatever starts inside a segment cannot
/// hit it, whichever way it goes; the depth is far above the rounding of positions (2e-12 at 10,000 tiles), far below
/// a radius.
pub const TUBE_DEPTH: f64 = 1e-8;

/// How well the ends of a periodic curve must match, in tile widths: what a text file's digits lose.
const PERIOD_TOLERANCE: f64 = 1e-6;

/// Points that a closed ring has at least, its first one counted twice.
const LEAST_RING: usize = 4;

/// Ties of two neighbours on their common sphere, in tile widths: rounding is 1e-15.
const TIE: f64 = 1e-12;

/// A fibre: a tube of constant radius around a polyline, with round ends.
///
/// The tangent is averaged at the points and smooth between them. A curve that repeats with the tile ends at its first
/// point plus a whole number of tiles; its ends then have one tangent. Segments should not be much shorter than the
/// radius where the curve bends sharply.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// At least 2 points in tile widths; they may run over several tiles.
    pub points: Vec<[f64; 3]>,
    /// Radius in tile widths, at most [`MAX_RADIUS`].
    pub radius: f64,
    /// What the fibre looks like: handed through to the hit.
    pub look: u32,
}

/// Where a ray meets a fibre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CurveHit {
    /// Distance along the ray in units of its direction's length.
    pub t: f64,
    /// The point, not wrapped.
    pub position: [f64; 3],
    /// Unit, away from the axis, perpendicular to `tangent`.
    pub normal: [f64; 3],
    /// Unit, along the curve in the order of its points.
    pub tangent: [f64; 3],
    /// The curve's `look`.
    pub look: u32,
    /// The curve's radius in tile widths.
    pub radius: f64,
    /// Unit normal of the tube itself: not `normal` where the curve bends or ends.
    outward: [f64; 3],
}

impl CurveHit {
    /// The point from which rays leave the fibre, through it or away from it: just inside, so that none meets the
    /// segment again.
    pub fn departure(&self) -> [f64; 3] {
        std::array::from_fn(|c| self.position[c] - TUBE_DEPTH * self.outward[c])
    }
}

/// Fibres that repeat with the tile, hit from outside only: a ray that starts inside a tube leaves it freely.
#[derive(Debug)]
pub struct Curves {
    tiled: Tiled<Segments>,
}

impl Curves {
    /// Fibres ready for rays. Segments without length are left out.
    ///
    /// # Errors
    /// `Config` on `curves` if there is none or more than [`MAX_PRIMITIVES`] segments, a curve has fewer than
    /// 2 points or a radius outside [`MIN_RADIUS`] to [`MAX_RADIUS`], a point is not finite or lies outside [`MAX_EXTENT`](super::MAX_EXTENT), or a
    /// tube reaches farther than [`MAX_DEPTH`] from the plane.
    pub fn new(curves: &[Curve]) -> Result<Self> {
        let segments = Segments::new(curves)?;
        let mut range = [f64::INFINITY, f64::NEG_INFINITY];
        for (index, style) in (0..).zip(&segments.style_of) {
            let Some(Style { radius, .. }) = segments.styles.get(*style as usize) else { continue };
            for [_, _, z] in segments.ends(index) {
                range = [range[0].min(z - radius), range[1].max(z + radius)];
            }
        }
        if range[0] < -f64::from(MAX_DEPTH) || range[1] > f64::from(MAX_DEPTH) {
            let [low, high] = range;
            return Err(Error::config(
                "curves",
                format!(
                    "span {low} to {high} tile widths; at most {MAX_DEPTH} above and below the plane works"
                ),
            ));
        }
        Ok(Self { tiled: Tiled::new(segments, range, "curves")? })
    }

    /// Least and greatest z of the tubes, in tile widths.
    pub fn range(&self) -> [f64; 2] {
        self.tiled.range
    }

    /// First point at 0 <= t <= `t_max` where the ray enters a fibre. Rays are followed for
    /// [`crate::reference::raycast::MAX_DISTANCE`].
    pub fn intersect(&self, origin: [f64; 3], direction: [f64; 3], t_max: f64) -> Option<CurveHit> {
        let found = self.tiled.trace::<false>(origin, direction, t_max)?;
        let segments = &self.tiled.shapes;
        let style = segments.style(found.placed.index);
        let points = segments.chain(found.placed.index).map(|p| found.placed.place(p));
        let (tangent, normal) = frame(&points, found.local, found.direction);
        let (t, position, Style { radius, look }) = (found.t, found.position, style);
        let outward = outward([points[2], points[3]], found.local);
        Some(CurveHit { t, position, normal, tangent, look, radius, outward })
    }

    /// True if the ray enters a fibre on its way out.
    pub fn occluded(&self, origin: [f64; 3], direction: [f64; 3]) -> bool {
        self.tiled.trace::<true>(origin, direction, f64::INFINITY).is_some()
    }
}

/// What the segments of one curve share.
#[derive(Clone, Copy, Debug)]
struct Style {
    radius: f64,
    look: u32,
}

/// Segments go by the index of the first of their [`Segments::chain`].
#[derive(Debug)]
struct Segments {
    /// Curve after curve; each has two more points at either end: the next ones in the next tile if it is periodic,
    /// the end twice more if not.
    points: Vec<[f64; 3]>,
    /// Style of the segment at each point, [`NO_SEGMENT`] where there is none.
    style_of: Vec<u32>,
    styles: Vec<Style>,
    /// What f32 may lose of the distance between a ray and an axis.
    slack: f32,
}

/// Marks the last points of a curve.
const NO_SEGMENT: u32 = u32::MAX;

impl Segments {
    fn new(curves: &[Curve]) -> Result<Self> {
        if curves.is_empty() {
            return Err(Error::config("curves", "there is none; give at least one"));
        }
        let total = curves.iter().fold(0, |sum: usize, curve| sum.saturating_add(curve.points.len()));
        if total > MAX_PRIMITIVES {
            return Err(Error::config(
                "curves",
                format!("have {total} points; at most {MAX_PRIMITIVES} work"),
            ));
        }
        let mut this = Self { points: Vec::new(), style_of: Vec::new(), styles: Vec::new(), slack: 0.0 };
        for (k, curve) in curves.iter().enumerate() {
            let Curve { points, radius, .. } = curve;
            if points.len() < 2 {
                return Err(Error::config(
                    format!("curves[{k}].points"),
                    format!("has {} points; at least 2 are needed", points.len()),
                ));
            }
            if !(*radius >= MIN_RADIUS && *radius <= MAX_RADIUS) {
                return Err(Error::config(
                    format!("curves[{k}].radius"),
                    format!("{radius} is outside {MIN_RADIUS} to {MAX_RADIUS} tile widths"),
                ));
            }
            for (j, point) in points.iter().enumerate() {
                check_point(*point, || format!("curves[{k}].points[{j}]"))?;
            }
        }
        let longest = curves.iter().map(longest_step).fold(0.0, f64::max);
        let grid = Grid::new(longest + MAX_RADIUS);
        for Curve { points, radius, look } in curves {
            // Packets hold radii in f32: all others must agree.
            let radius = f64::from(*radius as f32);
            this.add(points.iter().map(|p| grid.snap(*p)).collect(), Style { radius, look: *look });
        }
        this.slack = SLACK * (1.0 + longest as f32);
        Ok(this)
    }

    fn add(&mut self, mut points: Vec<[f64; 3]>, style: Style) {
        points.dedup();
        let mut count = points.len();
        if count < 2 {
            return;
        }
        let gap: [f64; 3] = std::array::from_fn(|c| points[count - 1][c] - points[0][c]);
        let period = [gap[0].round(), gap[1].round(), 0.0];
        let returns = (0..3).all(|c| (gap[c] - period[c]).abs() <= PERIOD_TOLERANCE);
        let periodic = returns && (period != [0.0; 3] || count >= LEAST_RING);
        if periodic {
            points[count - 1] = std::array::from_fn(|c| points[0][c] + period[c]);
            if points[count - 1] == points[count - 2] {
                points.pop();
                count -= 1;
            }
        }
        let steps = count as i64 - 1;
        let beyond = |k: i64| {
            if !periodic {
                return points[k.clamp(0, steps) as usize];
            }
            let (turns, at) = (k.div_euclid(steps) as f64, k.rem_euclid(steps) as usize);
            std::array::from_fn(|c| points[at][c] + turns * period[c])
        };
        self.points.extend((-2..=steps + 2).map(beyond));
        self.style_of.extend(std::iter::repeat_n(self.styles.len() as u32, count - 1));
        self.style_of.extend([NO_SEGMENT; 5]);
        self.styles.push(style);
    }

    /// Two points before, the two ends, two points behind.
    fn chain(&self, index: u32) -> [[f64; 3]; 6] {
        let at = index as usize;
        std::array::from_fn(|k| self.points[at + k])
    }

    fn ends(&self, index: u32) -> [[f64; 3]; 2] {
        let at = index as usize;
        [self.points[at + 2], self.points[at + 3]]
    }

    fn style(&self, index: u32) -> Style {
        self.styles[self.style_of[index as usize] as usize]
    }
}

/// Largest step in x or y from one point to the next.
fn longest_step(curve: &Curve) -> f64 {
    let step = |pair: &[[f64; 3]]| (pair[1][0] - pair[0][0]).abs().max((pair[1][1] - pair[0][1]).abs());
    curve.points.windows(2).map(step).fold(0.0, f64::max)
}

/// Four segments.
#[derive(Clone, Debug)]
struct Packet {
    ends: [[Vec4; 3]; 2],
    radius: Vec4,
    /// Radius of the sphere around the tube; NaN in lanes without segment.
    reach: Vec4,
}

/// What the quick test needs of a ray.
#[derive(Clone, Copy, Debug)]
struct Local {
    origin: [Vec4; 3],
    direction: [Vec4; 3],
    near: Vec4,
}

/// What f32 loses of a distance to an axis per unit of the largest coordinate: positions and their products are
/// rounded four times at magnitudes to 3.
const SLACK: f32 = 2e-6;

/// What f32 loses of the direction of a common perpendicular, relative to the half axis.
const TWIST: f32 = 1e-6;

impl Shapes for Segments {
    type Packet = Packet;
    type Aim = [Vec4; 3];
    type Local = Local;
    type Hit = ();

    fn len(&self) -> usize {
        self.points.len()
    }

    fn extent(&self, index: u32) -> Option<[[f64; 2]; 2]> {
        let radius = self.styles.get(self.style_of[index as usize] as usize)?.radius;
        let [p, q] = self.ends(index);
        Some([0, 1].map(|c| [p[c].min(q[c]) - radius, p[c].max(q[c]) + radius]))
    }

    fn heights_over(&self, placed: Placed, low: [f64; 2], high: [f64; 2]) -> Option<[f64; 2]> {
        let Style { radius, .. } = self.style(placed.index);
        let [p, q] = self.ends(placed.index).map(|p| placed.place(p));
        // The part of the axis from which the tube reaches the rectangle.
        let (mut first, mut last): (f64, f64) = (0.0, 1.0);
        for c in 0..2 {
            let (floor, ceiling, rise) = (low[c] - radius, high[c] + radius, q[c] - p[c]);
            if rise == 0.0 {
                if p[c] < floor || p[c] > ceiling {
                    return None;
                }
                continue;
            }
            let (a, b) = ((floor - p[c]) / rise, (ceiling - p[c]) / rise);
            first = first.max(a.min(b));
            last = last.min(a.max(b));
        }
        if first > last {
            return None;
        }
        let [a, b] = [first, last].map(|s| p[2] + (q[2] - p[2]) * s);
        Some([a.min(b) - radius, a.max(b) + radius])
    }

    fn packet(&self, members: [Option<Placed>; LANES]) -> Packet {
        let mut packet =
            Packet { ends: [[Vec4::ZERO; 3]; 2], radius: Vec4::ZERO, reach: Vec4::splat(f32::NAN) };
        for (lane, placed) in members.iter().enumerate() {
            let Some(placed) = placed else { continue };
            let Style { radius, .. } = self.style(placed.index);
            let ends = self.ends(placed.index).map(|p| placed.place(p));
            for (side, end) in packet.ends.iter_mut().zip(ends) {
                for (coordinate, x) in side.iter_mut().zip(end) {
                    coordinate[lane] = x as f32;
                }
            }
            let axis = sub(ends[1], ends[0]);
            packet.radius[lane] = radius as f32;
            packet.reach[lane] = (0.5 * dot(axis, axis).sqrt() + radius) as f32 + self.slack;
        }
        packet
    }

    fn aim(&self, direction: [f64; 3]) -> [Vec4; 3] {
        direction.map(|d| Vec4::splat(d as f32))
    }

    fn local(&self, direction: &[Vec4; 3], ray: &CellRay) -> Local {
        let origin = ray.origin.map(|o| Vec4::splat(o as f32));
        Local { origin, direction: *direction, near: Vec4::splat(ray.near as f32) }
    }

    /// Tests the sphere around each tube, then the distance of the ray from the infinite axis.
    #[inline]
    fn candidates(&self, packet: &Packet, local: &Local, far: f64) -> u32 {
        let ([p, q], d, reach) = (&packet.ends, local.direction, packet.reach);
        let w: [Vec4; 3] = std::array::from_fn(|c| (p[c] + q[c]) * 0.5 - local.origin[c]);
        let along = dot4(w, d);
        let off: [Vec4; 3] = std::array::from_fn(|c| w[c] - d[c] * along);
        let in_reach = dot4(off, off).cmple(reach * reach)
            & (along - reach).cmple(Vec4::splat(far as f32))
            & (along + reach).cmpge(local.near);
        if in_reach.bitmask() == 0 {
            return 0;
        }
        let h: [Vec4; 3] = std::array::from_fn(|c| (q[c] - p[c]) * 0.5);
        let n = [d[1] * h[2] - d[2] * h[1], d[2] * h[0] - d[0] * h[2], d[0] * h[1] - d[1] * h[0]];
        let radius = packet.radius + self.slack;
        let most = radius * dot4(n, n).sqrt() + reach * reach * TWIST;
        (in_reach & dot4(off, n).abs().cmple(most)).bitmask()
    }

    #[inline]
    fn intersect(&self, packet: &Packet, lane: usize, _: &[Vec4; 3], ray: &CellRay) -> Option<(f64, ())> {
        let ends = packet.ends.map(|end| end.map(|x| f64::from(x[lane])));
        let (origin, along) = nearby(ends, ray);
        let [enter, _] = tube(ends, f64::from(packet.radius[lane]), origin, ray.direction)?;
        let t = enter + along;
        (t >= ray.near && t <= ray.far).then_some((t, ()))
    }

    /// Inside a neighbour there is no surface. Only a ray from inside a fibre can meet one there first.
    fn stands(&self, placed: Placed, t: f64, ray: &CellRay) -> bool {
        let Style { radius, .. } = self.style(placed.index);
        let [_, before, p, q, behind, _] = self.chain(placed.index).map(|p| placed.place(p));
        let (origin, along) = nearby([p, q], ray);
        let (enter, start) = (t - along, ray.start - along);
        let hides = |[a, b]: [f64; 2]| (a < enter - TIE || a < start) && b > enter + TIE;
        let around = |ends| tube(ends, radius, origin, ray.direction).is_some_and(hides);
        !around([before, p]) && !around([q, behind])
    }
}

/// The point of the ray beside the middle of a segment, and its t: from there nothing is lost by squares of long
/// distances.
#[inline]
fn nearby([p, q]: [[f64; 3]; 2], ray: &CellRay) -> ([f64; 3], f64) {
    let to_middle = std::array::from_fn(|c| 0.5 * (p[c] + q[c]) - ray.origin[c]);
    let along = dot(to_middle, ray.direction);
    (std::array::from_fn(|c| ray.origin[c] + ray.direction[c] * along), along)
}

#[inline]
fn dot4(a: [Vec4; 3], b: [Vec4; 3]) -> Vec4 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
