//! Whether a mesh, repeated, catches every ray from above.
//!
//! A grid of vertical rays is struck off triangle by triangle, row by row. Each row links every ray to the next one that
//! is still falling, so that what is covered already costs nothing, however often it is covered.

use super::Checked;
use super::place::Frame;
use crate::reference::primitives::TriangleMesh;

/// Rays a side: as many as a usual tile has texels.
const SIDE: usize = 1024;

/// Where in its cell a ray stands (the golden section), so that it does not run along the edges of a regular mesh.
const SHIFT: f64 = 0.381_966_011;

/// How far beyond its edge a triangle still catches a ray, in cells: the rounding with which neighbours find their
/// common edge.
const EDGE: f64 = 1e-7;

/// Checks that no ray falls through.
pub(super) fn check(mesh: &TriangleMesh, frame: &Frame) -> Checked<()> {
    let mut rays = Rays::new();
    for triangle in &mesh.triangles {
        rays.strike(triangle.map(|k| mesh.positions[k as usize]));
    }
    match rays.falling() {
        (0, _) => Ok(()),
        (count, first) => {
            let all = SIDE * SIDE;
            Err(format!(
                "has holes: {count} of {all} vertical rays fall through, the first at {}; close it, or put a floor \
                 below it",
                frame.ground(first)
            ))
        }
    }
}

/// In row r, `next[r][c]` leads towards the first falling ray at or after column c; SIDE is none.
struct Rays {
    next: Vec<u16>,
}

impl Rays {
    fn new() -> Self {
        Self { next: (0..SIDE).flat_map(|_| 0..=SIDE as u16).collect() }
    }

    /// First falling ray of a row at or after a column.
    fn first(&mut self, row: usize, column: usize) -> usize {
        let links = &mut self.next[row * (SIDE + 1)..][..=SIDE];
        let mut at = column;
        while usize::from(links[at]) != at {
            // Halving the way keeps later ones short.
            links[at] = links[usize::from(links[at])];
            at = links[at].into();
        }
        at
    }

    fn strike(&mut self, points: [[f64; 3]; 3]) {
        let points = points.map(|p| [p[0], p[1]].map(|c| c * SIDE as f64 - SHIFT));
        let low = points.iter().fold(f64::INFINITY, |a, p| a.min(p[1]));
        let high = points.iter().fold(f64::NEG_INFINITY, |a, p| a.max(p[1]));
        let (first, last) = ((low - EDGE).ceil() as i64, (high + EDGE).floor() as i64);
        for line in first..=last {
            let y = (line as f64).clamp(low, high);
            let (mut left, mut right) = (f64::INFINITY, f64::NEG_INFINITY);
            for k in 0..3 {
                let ([ax, ay], [bx, by]) = (points[k], points[(k + 1) % 3]);
                if ay.min(by) <= y && y <= ay.max(by) {
                    let ends = if ay == by { [ax, bx] } else { [ax + (bx - ax) * ((y - ay) / (by - ay)); 2] };
                    left = left.min(ends[0]).min(ends[1]);
                    right = right.max(ends[0]).max(ends[1]);
                }
            }
            self.strike_row(line, (left - EDGE).ceil() as i64, (right + EDGE).floor() as i64);
        }
    }

    /// Strikes columns from `start` to `end`, wrapped.
    fn strike_row(&mut self, line: i64, start: i64, end: i64) {
        let side = SIDE as i64;
        if end < start {
            return;
        }
        let row = line.rem_euclid(side) as usize;
        let from = start.rem_euclid(side) as usize;
        let to = from + (end - start).min(side - 1) as usize;
        self.strike_columns(row, from, to.min(SIDE - 1));
        if to >= SIDE {
            self.strike_columns(row, 0, to - SIDE);
        }
    }

    fn strike_columns(&mut self, row: usize, from: usize, to: usize) {
        let mut at = self.first(row, from);
        while at <= to {
            self.next[row * (SIDE + 1) + at] = at as u16 + 1;
            at = self.first(row, at);
        }
    }

    /// How many rays still fall, and where the first does, in tile widths.
    fn falling(&self) -> (usize, [f64; 2]) {
        let place = |cell: usize| (cell as f64 + SHIFT) / SIDE as f64;
        let (mut count, mut first) = (0, None);
        for (row, links) in self.next.chunks_exact(SIDE + 1).enumerate() {
            for (column, _) in links[..SIDE].iter().enumerate().filter(|(k, link)| usize::from(**link) == *k)
            {
                count += 1;
                first = first.or(Some([place(column), place(row)]));
            }
        }
        (count, first.unwrap_or_default())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Random, Stream};

    #[test]
    fn struck_rays_are_those_inside() {
        let mut random = Random::new(3, Stream::Probe, 0);
        for _ in 0..20 {
            let points: [[f64; 3]; 3] = std::array::from_fn(|_| {
                [random.uniform_f64() * 1.4 - 0.2, random.uniform_f64() * 1.4 - 0.2, 0.0]
            });
            let mut rays = Rays::new();
            rays.strike(points);
            let inside = |p: [f64; 2]| {
                let side =
                    |a: [f64; 3], b: [f64; 3]| (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]);
                let sides: [f64; 3] = std::array::from_fn(|k| side(points[k], points[(k + 1) % 3]));
                sides.iter().all(|&s| s >= 0.0) || sides.iter().all(|&s| s <= 0.0)
            };
            for _ in 0..2000 {
                let cell = [random.below(SIDE), random.below(SIDE)];
                let p = cell.map(|c| (c as f64 + SHIFT) / SIDE as f64);
                let copies = (0..9).map(|k| [p[0] + f64::from(k % 3) - 1.0, p[1] + f64::from(k / 3) - 1.0]);
                let want = copies.clone().any(inside);
                let links = &rays.next[cell[1] * (SIDE + 1)..][..=SIDE];
                assert_eq!(usize::from(links[cell[0]]) != cell[0], want, "{points:?} {p:?}");
            }
        }
    }
}
