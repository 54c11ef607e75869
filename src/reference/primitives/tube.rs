//! The shape of one fibre segment: a cylinder with spheres at its ends.

use super::{cross, dot, normalise, sub};

/// Where a ray of unit direction enters and leaves a cylinder with spheres at its ends `p` and `q`. The origin should
/// be near: squares of its distance are rounded. As the tube is convex, the crossings of its three parts join to one.
pub(super) fn tube(
    [p, q]: [[f64; 3]; 2],
    radius: f64,
    origin: [f64; 3],
    direction: [f64; 3],
) -> Option<[f64; 2]> {
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

/// Tangent and normal at the point `x` of the segment in the middle of `points`, two neighbours on either side. Open ends
/// are repeated.
pub(super) fn frame(points: &[[f64; 3]; 6], x: [f64; 3], direction: [f64; 3]) -> ([f64; 3], [f64; 3]) {
    // The planes that halve the bends part the segments: neighbours then agree where they meet, on the inner side of a
    // bend too. On the sphere of a joint a ray meets both, and either may have been found.
    let [_, before, p, q, behind, _] = *points;
    let (since, until) = (dot(sub(x, p), bisector(before, p, q)), dot(sub(q, x), bisector(p, q, behind)));
    let first = match (since < 0.0 && before != p, until < 0.0 && behind != q) {
        (true, false) => 0,
        (false, true) => 2,
        _ => 1,
    };
    let [before, p, q, behind] = [points[first], points[first + 1], points[first + 2], points[first + 3]];
    let axis = sub(q, p);
    let (first, last) = (bisector(before, p, q), bisector(p, q, behind));
    let (since, until) = (dot(sub(x, p), first), dot(sub(q, x), last));
    let along = if since + until > 0.0 { (since / (since + until)).clamp(0.0, 1.0) } else { 0.5 };
    let tangent = normalise(std::array::from_fn(|c| first[c] + (last[c] - first[c]) * along))
        .or_else(|| normalise(axis))
        .unwrap_or([1.0, 0.0, 0.0]);
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

/// Unit normal of the tube around a segment at its point `x`.
pub(super) fn outward([p, q]: [[f64; 3]; 2], x: [f64; 3]) -> [f64; 3] {
    let axis = sub(q, p);
    let along = (dot(sub(x, p), axis) / dot(axis, axis)).clamp(0.0, 1.0);
    let nearest = std::array::from_fn(|c| p[c] + axis[c] * along);
    normalise(sub(x, nearest)).unwrap_or([0.0, 0.0, 1.0])
}

/// Unit tangent at `b`, halfway between those of its two segments; the other's where one has no length.
fn bisector(a: [f64; 3], b: [f64; 3], c: [f64; 3]) -> [f64; 3] {
    let (into, out) = (normalise(sub(b, a)), normalise(sub(c, b)));
    match (into, out) {
        // A curve that turns right back has no average.
        (Some(into), Some(out)) => normalise(std::array::from_fn(|k| into[k] + out[k])).unwrap_or(out),
        (one, other) => one.or(other).unwrap_or([1.0, 0.0, 0.0]),
    }
}

/// Squared sine to the tangent below which a direction says nothing about the side it is on.
const ON_AXIS: f64 = 1e-12;
