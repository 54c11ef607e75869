//! Polygons cut into triangles: corner after corner is cut off where that leaves the rest whole (ear clipping), so
//! that faces with inward corners stay what they are.

use super::{Checked, cross, minus};

/// Most corners of a face: cutting takes time with the cube of their number.
const MAX_CORNERS: usize = 256;

/// Appends the triangles of a polygon. False if it crosses itself or has no area, so that they may fold over.
///
/// # Errors
/// For fewer than 3 corners or more than [`MAX_CORNERS`].
pub(super) fn triangulate(
    corners: &[u32],
    position: impl Fn(u32) -> [f64; 3],
    triangles: &mut Vec<[u32; 3]>,
) -> Checked<bool> {
    match corners.len() {
        0..3 => return Err(format!("a face has {} corners; 3 or more make one", corners.len())),
        3 => {
            triangles.push([corners[0], corners[1], corners[2]]);
            return Ok(true);
        }
        4..=MAX_CORNERS => {}
        more => return Err(format!("a face has {more} corners; cut the faces into triangles")),
    }
    let points: Vec<[f64; 3]> = corners.iter().map(|&corner| position(corner)).collect();
    let flat = flatten(&points);
    let mut left: Vec<usize> = (0..corners.len()).collect();
    let mut whole = true;
    while left.len() > 3 {
        let ear = (0..left.len()).find(|&k| is_ear(&flat, &left, k));
        whole &= ear.is_some();
        let k = ear.unwrap_or(1);
        let [before, after] = neighbours(&left, k);
        triangles.push([corners[before], corners[left[k]], corners[after]]);
        left.remove(k);
    }
    triangles.push([corners[left[0]], corners[left[1]], corners[left[2]]]);
    Ok(whole && area(flat[left[0]], flat[left[1]], flat[left[2]]) >= 0.0)
}

/// A word on polygons that did not come out whole.
pub(super) fn note(folded: usize) -> Option<String> {
    (folded > 0).then(|| format!("{folded} faces cross themselves or have no area; they may fold over"))
}

fn neighbours(left: &[usize], k: usize) -> [usize; 2] {
    [left[(k + left.len() - 1) % left.len()], left[(k + 1) % left.len()]]
}

/// The polygon in the coordinate plane in which its area is largest, running counter-clockwise.
fn flatten(points: &[[f64; 3]]) -> Vec<[f64; 2]> {
    let mut normal = [0.0; 3];
    for k in 1..points.len() - 1 {
        let part = cross(minus(points[k], points[0]), minus(points[k + 1], points[0]));
        normal = std::array::from_fn(|c| normal[c] + part[c]);
    }
    let axis = (0..3).max_by(|&a, &b| f64::abs(normal[a]).total_cmp(&normal[b].abs())).unwrap_or(2);
    let (x, y) = ((axis + 1) % 3, (axis + 2) % 3);
    let turn = if normal[axis] < 0.0 { -1.0 } else { 1.0 };
    points.iter().map(|p| [p[x], turn * p[y]]).collect()
}

fn area(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

fn is_ear(flat: &[[f64; 2]], left: &[usize], k: usize) -> bool {
    let [before, after] = neighbours(left, k);
    let (a, b, c) = (flat[before], flat[left[k]], flat[after]);
    let outside = |p: [f64; 2]| area(a, b, p) < 0.0 || area(b, c, p) < 0.0 || area(c, a, p) < 0.0;
    let free = |&other: &usize| {
        let p = flat[other];
        // A polygon with a hole is joined by a bridge along which corners coincide.
        [before, left[k], after].contains(&other) || [a, b, c].contains(&p) || outside(p)
    };
    area(a, b, c) > 0.0 && left.iter().all(free)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Triangles of a polygon in the plane, and whether they are whole.
    fn cut(points: &[[f64; 2]], tilt: f64) -> (Vec<[u32; 3]>, bool) {
        let mut triangles = Vec::new();
        let corners: Vec<u32> = (0..points.len() as u32).collect();
        let at = |k: u32| {
            let [x, y] = points[k as usize];
            [x, y, tilt * x]
        };
        let whole = triangulate(&corners, at, &mut triangles).unwrap();
        (triangles, whole)
    }

    fn areas(points: &[[f64; 2]], triangles: &[[u32; 3]]) -> Vec<f64> {
        let at = |k: u32| points[k as usize];
        triangles.iter().map(|t| 0.5 * area(at(t[0]), at(t[1]), at(t[2]))).collect()
    }

    #[test]
    fn inward_corners_stay() {
        let arrow = [[0.0, 0.0], [2.0, 1.0], [0.0, 2.0], [0.5, 1.0]];
        let comb = [
            [0.0, 0.0],
            [5.0, 0.0],
            [5.0, 2.0],
            [4.0, 2.0],
            [4.0, 1.0],
            [3.0, 1.0],
            [3.0, 2.0],
            [2.0, 2.0],
            [2.0, 1.0],
            [1.0, 1.0],
            [1.0, 2.0],
            [0.0, 2.0],
        ];
        for (points, want) in [(&arrow[..], 1.5), (&comb[..], 8.0)] {
            for tilt in [0.0, 3.0, -50.0] {
                let (triangles, whole) = cut(points, tilt);
                let areas = areas(points, &triangles);
                assert!(whole && triangles.len() == points.len() - 2);
                assert!(areas.iter().all(|&a| a > 0.0) && areas.iter().sum::<f64>() == want, "{areas:?}");
            }
        }
        // A fan from the first corner would fold over.
        let fan: Vec<_> = (1..11).map(|k| [0, k, k + 1]).collect();
        assert!(areas(&comb, &fan).iter().any(|&a| a <= 0.0));
        let mut turned = arrow;
        turned.reverse();
        let (triangles, whole) = cut(&turned, 0.0);
        assert!(whole && areas(&turned, &triangles).iter().all(|&a| a < 0.0), "the side is kept");
    }

    #[test]
    fn crossed_polygons_are_told() {
        assert!(!cut(&[[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]], 0.0).1);
        assert!(!cut(&[[0.0, 0.0], [1.0, 1.0], [2.0, 2.0], [3.0, 3.0]], 0.0).1);
        assert!(cut(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], 0.0).1);
        assert!(triangulate(&[0; 257], |_| [0.0; 3], &mut Vec::new()).is_err());
        assert!(triangulate(&[0; 256], |_| [f64::NAN; 3], &mut Vec::new()).is_ok());
    }
}
