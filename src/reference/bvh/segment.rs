//! Rays against fibres: tubes around polylines, each segment a cylinder with spheres at its ends.

use super::tiled::{CellRay, Placed, Shapes, Tiled, snap};
use super::tree::LANES;
use super::{MAX_PRIMITIVES, check_point, cross, dot, normalise, sub};
use crate::error::{Error, Result};
use crate::reference::heightfield::MAX_DEPTH;
use glam::Vec4;

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
}

impl CurveHit {
    /// The point from which rays leave the fibre, through it or away from it: just inside, so that none meets the
    /// segment again.
    pub fn departure(&self) -> [f64; 3] {
        let depth = TUBE_DEPTH.min(0.5 * self.radius);
        std::array::from_fn(|c| self.position[c] - depth * self.normal[c])
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
    /// 2 points or a radius outside (0, [`MAX_RADIUS`]\], a point is not finite or lies outside [`MAX_EXTENT`](super::MAX_EXTENT), or a
    /// tube reaches farther than [`MAX_DEPTH`] from the plane.
    pub fn new(curves: &[Curve]) -> Result<Self> {
        let segments = Segments::new(curves)?;
        let mut range = [f64::INFINITY, f64::NEG_INFINITY];
        for segment in &segments.segments {
            let radius = segments.styles[segment.style as usize].radius;
            for [_, _, z] in segments.ends(segment) {
                range = [range[0].min(z - radius), range[1].max(z + radius)];
            }
        }
        if range[0] < -f64::from(MAX_DEPTH) || range[1] > f64::from(MAX_DEPTH) {
            let [low, high] = range;
            return Err(Error::config(
                "curves",
                format!("span {low} to {high} tile widths; at most {MAX_DEPTH} above and below the plane works"),
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
        let segment = &segments.segments[found.placed.index as usize];
        let style = &segments.styles[segment.style as usize];
        let points = segments.chain(segment).map(|p| found.placed.place(p));
        let (tangent, normal) = frame(&points, found.local, found.direction);
        let (t, position) = (found.t, found.position);
        Some(CurveHit { t, position, normal, tangent, look: style.look, radius: style.radius })
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

#[derive(Clone, Copy, Debug)]
struct Segment {
    /// Index of the point before its first.
    chain: u32,
    style: u32,
}

#[derive(Debug)]
struct Segments {
    /// Curve after curve; each has one more point at either end, the neighbour in the next tile if it is periodic,
    /// the end once more if not.
    points: Vec<[f64; 3]>,
    segments: Vec<Segment>,
    styles: Vec<Style>,
    /// What f32 may lose of the distance between a ray and an axis.
    slack: f32,
}

impl Segments {
    fn new(curves: &[Curve]) -> Result<Self> {
        if curves.is_empty() {
            return Err(Error::config("curves", "there is none; give at least one"));
        }
        let total = curves.iter().fold(0, |sum: usize, curve| sum.saturating_add(curve.points.len()));
        if total > MAX_PRIMITIVES {
            return Err(Error::config("curves", format!("have {total} points; at most {MAX_PRIMITIVES} work")));
        }
        let mut this = Self { points: Vec::new(), segments: Vec::new(), styles: Vec::new(), slack: 0.0 };
        for (k, curve) in curves.iter().enumerate() {
            let Curve { points, radius, look } = curve;
            if points.len() < 2 {
                return Err(Error::config(
                    format!("curves[{k}].points"),
                    format!("has {} points; at least 2 are needed", points.len()),
                ));
            }
            if !(*radius > 0.0 && *radius <= MAX_RADIUS) {
                return Err(Error::config(
                    format!("curves[{k}].radius"),
                    format!("{radius} is outside 0 to {MAX_RADIUS} tile widths"),
                ));
            }
            for (j, point) in points.iter().enumerate() {
                check_point(*point, || format!("curves[{k}].points[{j}]"))?;
            }
            this.add(points, Style { radius: *radius, look: *look });
        }
        let farthest = this.points.iter().flatten().fold(1.0, |most: f64, x| most.max(x.abs()));
        this.slack = SLACK * farthest as f32;
        Ok(this)
    }

    fn add(&mut self, points: &[[f64; 3]], style: Style) {
        let mut points: Vec<[f64; 3]> = points.iter().map(|p| p.map(snap)).collect();
        points.dedup();
        let mut count = points.len();
        if count < 2 {
            return;
        }
        let gap: [f64; 3] = std::array::from_fn(|c| points[count - 1][c] - points[0][c]);
        let period = [gap[0].round(), gap[1].round(), 0.0];
        let returns = (0..3).all(|c| (gap[c] - period[c]).abs() <= PERIOD_TOLERANCE);
        let (before, after) = if returns && (period != [0.0; 3] || count >= LEAST_RING) {
            let move_by = |p: [f64; 3], sign: f64| std::array::from_fn(|c| p[c] + sign * period[c]);
            points[count - 1] = move_by(points[0], 1.0);
            if points[count - 1] == points[count - 2] {
                points.pop();
                count -= 1;
            }
            (move_by(points[count - 2], -1.0), move_by(points[1], 1.0))
        } else {
            (points[0], points[count - 1])
        };
        let first = self.points.len() as u32;
        self.points.push(before);
        self.points.extend(points);
        self.points.push(after);
        let number = self.styles.len() as u32;
        self.segments.extend((0..count as u32 - 1).map(|k| Segment { chain: first + k, style: number }));
        self.styles.push(style);
    }

    /// The point before, the two ends, the point behind.
    fn chain(&self, segment: &Segment) -> [[f64; 3]; 4] {
        let at = segment.chain as usize;
        [self.points[at], self.points[at + 1], self.points[at + 2], self.points[at + 3]]
    }

    fn ends(&self, segment: &Segment) -> [[f64; 3]; 2] {
        let at = segment.chain as usize;
        [self.points[at + 1], self.points[at + 2]]
    }
}

/// Four segments by their middles and half axes.
#[derive(Clone, Debug)]
struct Packet {
    middle: [Vec4; 3],
    half: [Vec4; 3],
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
        self.segments.len()
    }

    fn extent(&self, index: u32) -> [[f64; 2]; 2] {
        let segment = &self.segments[index as usize];
        let radius = self.styles[segment.style as usize].radius;
        let [p, q] = self.ends(segment);
        [0, 1].map(|c| [p[c].min(q[c]) - radius, p[c].max(q[c]) + radius])
    }

    fn bounds(&self, placed: Placed, margin: f64) -> Option<[[f64; 3]; 2]> {
        let segment = &self.segments[placed.index as usize];
        let radius = self.styles[segment.style as usize].radius;
        let [p, q] = self.ends(segment).map(|p| placed.place(p));
        // The part of the axis from which the tube reaches the cell.
        let (mut first, mut last): (f64, f64) = (0.0, 1.0);
        let (floor, ceiling) = (-radius - margin, 1.0 + radius + margin);
        for c in 0..2 {
            let rise = q[c] - p[c];
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
        let at = |s: f64| -> [f64; 3] { std::array::from_fn(|c| p[c] + (q[c] - p[c]) * s) };
        let (p, q) = (at(first), at(last));
        Some([
            std::array::from_fn(|c| p[c].min(q[c]) - radius),
            std::array::from_fn(|c| p[c].max(q[c]) + radius),
        ])
    }

    fn packet(&self, members: [Option<Placed>; LANES]) -> Packet {
        let mut packet = Packet {
            middle: [Vec4::ZERO; 3],
            half: [Vec4::ZERO; 3],
            radius: Vec4::ZERO,
            reach: Vec4::splat(f32::NAN),
        };
        for (lane, placed) in members.iter().enumerate() {
            let Some(placed) = placed else { continue };
            let segment = &self.segments[placed.index as usize];
            let radius = self.styles[segment.style as usize].radius;
            let [p, q] = self.ends(segment).map(|p| placed.place(p));
            let half = sub(q, p).map(|x| 0.5 * x);
            for c in 0..3 {
                packet.middle[c][lane] = (0.5 * (p[c] + q[c])) as f32;
                packet.half[c][lane] = half[c] as f32;
            }
            packet.radius[lane] = radius as f32 + self.slack;
            packet.reach[lane] = (dot(half, half).sqrt() + radius) as f32 + self.slack;
        }
        packet
    }

    fn aim(&self, direction: [f64; 3]) -> [Vec4; 3] {
        direction.map(|d| Vec4::splat(d as f32))
    }

    fn local(&self, direction: [Vec4; 3], ray: &CellRay) -> Local {
        let origin = ray.origin.map(|o| Vec4::splat(o as f32));
        Local { origin, direction, near: Vec4::splat(ray.near as f32 - self.slack) }
    }

    /// Tests the sphere around each tube, then the distance of the ray from the infinite axis.
    #[inline]
    fn candidates(&self, packet: &Packet, local: &Local, far: f32) -> u32 {
        let d = local.direction;
        let w: [Vec4; 3] = std::array::from_fn(|c| packet.middle[c] - local.origin[c]);
        let along = dot4(w, d);
        let p: [Vec4; 3] = std::array::from_fn(|c| w[c] - d[c] * along);
        let reach = packet.reach;
        let in_reach = dot4(p, p).cmple(reach * reach)
            & (along - reach).cmple(Vec4::splat(far))
            & (along + reach).cmpge(local.near);
        if in_reach.bitmask() == 0 {
            return 0;
        }
        let h = packet.half;
        let n = [d[1] * h[2] - d[2] * h[1], d[2] * h[0] - d[0] * h[2], d[0] * h[1] - d[1] * h[0]];
        let most = packet.radius * dot4(n, n).sqrt() + reach * reach * TWIST;
        (in_reach & dot4(p, n).abs().cmple(most)).bitmask()
    }

    #[inline]
    fn intersect(&self, placed: Placed, _: &[Vec4; 3], ray: &CellRay) -> Option<(f64, ())> {
        let segment = &self.segments[placed.index as usize];
        let radius = self.styles[segment.style as usize].radius;
        let [before, p, q, behind] = self.chain(segment).map(|p| placed.place(p));

        // From a point near the segment nothing is lost by squares of long distances.
        let middle: [f64; 3] = std::array::from_fn(|c| 0.5 * (p[c] + q[c]));
        let along = dot(sub(middle, ray.origin), ray.direction);
        let origin = std::array::from_fn(|c| ray.origin[c] + ray.direction[c] * along);
        let [enter, _] = tube([p, q], radius, origin, ray.direction)?;
        if enter + along < ray.near || enter + along > ray.far {
            return None;
        }

        // Inside a neighbour there is no surface.
        let start = ray.start - along;
        for neighbour in [[before, p], [q, behind]] {
            if let Some([a, b]) = tube(neighbour, radius, origin, ray.direction)
                && (a < enter - TIE || a < start)
                && b > enter + TIE
            {
                return None;
            }
        }
        Some((enter + along, ()))
    }
}

/// Where a ray of unit direction enters and leaves a cylinder with spheres at its ends `p` and `q`. The origin should
/// be near: squares of its distance are rounded. As the tube is convex, the crossings of its three parts join to one.
fn tube([p, q]: [[f64; 3]; 2], radius: f64, origin: [f64; 3], direction: [f64; 3]) -> Option<[f64; 2]> {
    let mut crossing: Option<[f64; 2]> = None;
    let mut join = |a: f64, b: f64| {
        crossing = Some(crossing.map_or([a, b], |[enter, leave]| [enter.min(a), leave.max(b)]));
    };
    for centre in [p, q] {
        let w = sub(centre, origin);
        let along = dot(w, direction);
        let off: [f64; 3] = std::array::from_fn(|c| w[c] - direction[c] * along);
        let rest = radius * radius - dot(off, off);
        if rest >= 0.0 {
            let reach = rest.sqrt();
            join(along - reach, along + reach);
        }
    }

    // The cylinder: r^2 |a|^2 = |(o + t d - p) x a|^2, cut off by the planes through the ends.
    let axis = sub(q, p);
    let length_squared = dot(axis, axis);
    let w = sub(origin, p);
    let (turn, arm) = (cross(direction, axis), cross(w, axis));
    let a = dot(turn, turn);
    if a > PARALLEL * length_squared {
        let b = dot(turn, arm);
        let across = cross(turn, arm);
        // b^2 - a c in a form without cancellation (Lagrange's identity).
        let rest = a * radius * radius * length_squared - dot(across, across);
        if rest >= 0.0 {
            let reach = rest.sqrt();
            let (mut enter, mut leave) = ((-b - reach) / a, (-b + reach) / a);
            let (height, rise) = (dot(w, axis), dot(direction, axis));
            if rise != 0.0 {
                let (s, t) = (-height / rise, (length_squared - height) / rise);
                enter = enter.max(s.min(t));
                leave = leave.min(s.max(t));
            } else if height < 0.0 || height > length_squared {
                return crossing;
            }
            if enter <= leave {
                join(enter, leave);
            }
        }
    }
    crossing
}

/// Squared sine of the angle to the axis below which the spheres alone bound a crossing.
const PARALLEL: f64 = 1e-18;

/// Tangent and normal at the point `x` of the segment between the middle two of `points`.
fn frame(points: &[[f64; 3]; 4], x: [f64; 3], direction: [f64; 3]) -> ([f64; 3], [f64; 3]) {
    let [before, p, q, behind] = *points;
    let axis = sub(q, p);
    let along = (dot(sub(x, p), axis) / dot(axis, axis)).clamp(0.0, 1.0);
    let own = normalise(axis).unwrap_or([1.0, 0.0, 0.0]);
    let average = |other: [f64; 3]| {
        let other = normalise(other).unwrap_or(own);
        // A curve that turns right back has no average.
        normalise(std::array::from_fn(|c| own[c] + other[c])).unwrap_or(own)
    };
    let (first, last) = (average(sub(p, before)), average(sub(behind, q)));
    let tangent =
        normalise(std::array::from_fn(|c| first[c] + (last[c] - first[c]) * along)).unwrap_or(own);
    let reject = |v: [f64; 3]| {
        let share = dot(v, tangent);
        let across: [f64; 3] = std::array::from_fn(|c| v[c] - tangent[c] * share);
        (dot(across, across) > ON_AXIS * dot(v, v)).then(|| normalise(across)).flatten()
    };
    let outward = std::array::from_fn(|c| x[c] - p[c] - axis[c] * along);
    // At the pole of a round end any normal is right: the one that faces the ray is the smoothest, if there is one.
    let normal = reject(outward)
        .or_else(|| reject(direction.map(|d| -d)))
        .or_else(|| reject([0.0, 0.0, 1.0]))
        .or_else(|| reject([1.0, 0.0, 0.0]))
        .unwrap_or([0.0, 1.0, 0.0]);
    (tangent, normal)
}

/// Squared sine to the tangent below which a direction says nothing about the side it is on.
const ON_AXIS: f64 = 1e-12;

#[inline]
fn dot4(a: [Vec4; 3], b: [Vec4; 3]) -> Vec4 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
