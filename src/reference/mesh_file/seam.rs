//! Whether the borders of a mesh meet when it is repeated.
//!
//! A mesh cut along its tile has open edges (edges of one triangle) on two opposite borders. Each must have its copy on
//! the other side, or lie along several that continue each other.

use super::Checked;
use super::place::{Frame, bounds};
use crate::reference::primitives::TriangleMesh;
use std::collections::{HashMap, HashSet};

/// How far a border may be from its copy, in tile widths: a hundredth of a texel of a 1024-texel tile, and what is left of
/// six digits of a text file.
const MEETS: f64 = 1e-5;

/// Most comparisons of edges without an exact copy with those of the other side; where there would be more, only every
/// n-th of the former is compared and stands for its neighbours.
const MAX_COMPARISONS: usize = 20_000_000;

/// An open edge on a border: its ends as (position along the border, height).
type Edge = [[f64; 2]; 2];

/// Checks both pairs of borders.
pub(super) fn check(mesh: &TriangleMesh, frame: &Frame) -> Checked<()> {
    let (low, high) = bounds(mesh.triangles.iter().flatten().map(|&k| mesh.positions[k as usize]));
    for axis in 0..2 {
        // A mesh that is one tile wide is cut along its own ends, wherever the tile was put.
        let spans_tile = (high[axis] - low[axis] - 1.0).abs() <= MEETS;
        let start = if spans_tile { low[axis] } else { 0.0 };
        let borders = [start, start + 1.0].map(|line| open_edges(mesh, axis, line));
        let alone = [alone(&borders[0], &borders[1]), alone(&borders[1], &borders[0])];
        let largest = alone.iter().filter_map(|side| side.largest).max_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((gap, place)) = largest {
            let mut at = [start, place];
            at.rotate_right(axis);
            let sides = if axis == 0 { "left and right" } else { "top and bottom" };
            let count: usize = alone.iter().map(|side| side.count).sum();
            let gap =
                if gap.is_finite() { format!("{gap:.5} tile widths") } else { "no edge there at all".into() };
            return Err(format!(
                "does not tile: {count} open edges on its {sides} borders do not meet their copies; the largest gap \
                 is {gap}, at {}",
                frame.ground(at)
            ));
        }
    }
    Ok(())
}

/// Edges of exactly one triangle that lie on the border `axis` = `line`.
fn open_edges(mesh: &TriangleMesh, axis: usize, line: f64) -> Vec<Edge> {
    let on_border = |k: u32| (mesh.positions[k as usize][axis] - line).abs() <= MEETS;
    // Vertices that differ only in their normals are one.
    let key = |k: u32| mesh.positions[k as usize].map(|c| (c + 0.0).to_bits());
    let mut counts = HashMap::new();
    for triangle in &mesh.triangles {
        for c in 0..3 {
            let (a, b) = (triangle[c], triangle[(c + 1) % 3]);
            if on_border(a) && on_border(b) && key(a) != key(b) {
                let ends = if key(a) < key(b) { [key(a), key(b)] } else { [key(b), key(a)] };
                *counts.entry(ends).or_insert(0_u32) += 1;
            }
        }
    }
    let open = counts.into_iter().filter(|(_, count)| *count == 1);
    let end = |bits: [u64; 3]| [f64::from_bits(bits[1 - axis]), f64::from_bits(bits[2])];
    let mut edges: Vec<Edge> = open.map(|(ends, _)| ends.map(end)).collect();
    // The order of a hash map differs from run to run.
    edges.sort_by(|a, b| a.as_flattened().partial_cmp(b.as_flattened()).unwrap_or(std::cmp::Ordering::Equal));
    edges
}

/// Edges without a copy.
struct Alone {
    count: usize,
    /// The largest gap, and where along the border it is.
    largest: Option<(f64, f64)>,
}

/// The edges that do not meet `others`.
fn alone(edges: &[Edge], others: &[Edge]) -> Alone {
    let cell = |p: [f64; 2]| p.map(|c| (c / MEETS).round() as i64);
    let both_ways = others.iter().flat_map(|e| [[e[0], e[1]], [e[1], e[0]]]);
    let copies: HashSet<[[i64; 2]; 2]> = both_ways.map(|e| e.map(cell)).collect();
    // An end may be rounded to the cell next to its copy's.
    let near = |p: [f64; 2]| {
        let [x, y] = cell(p);
        (-1..=1).flat_map(move |i| (-1..=1).map(move |j| [x + i, y + j]))
    };
    let has_copy = |e: &Edge| near(e[0]).any(|a| near(e[1]).any(|b| copies.contains(&[a, b])));
    let left: Vec<&Edge> = edges.iter().filter(|e| !has_copy(e)).collect();
    let step = (left.len() * others.len()).div_ceil(MAX_COMPARISONS).max(1);
    let gap = |edge: &&Edge| {
        let middle = std::array::from_fn(|c| 0.5 * (edge[0][c] + edge[1][c]));
        let far = |p: [f64; 2]| others.iter().map(|other| distance(p, other)).fold(f64::INFINITY, f64::min);
        let gaps = [edge[0], middle, edge[1]].map(|p| (far(p), p[0]));
        gaps.into_iter().fold((0.0, middle[0]), |a, b| if b.0 > a.0 { b } else { a })
    };
    let gaps: Vec<(f64, f64)> =
        left.iter().copied().step_by(step).map(|e| gap(&e)).filter(|g| g.0 > MEETS).collect();
    let largest = gaps.iter().copied().max_by(|a, b| a.0.total_cmp(&b.0));
    Alone { count: (gaps.len() * step).min(left.len()), largest }
}

fn distance(p: [f64; 2], [a, b]: &Edge) -> f64 {
    let along = [b[0] - a[0], b[1] - a[1]];
    let squared = along[0] * along[0] + along[1] * along[1];
    let share = ((p[0] - a[0]) * along[0] + (p[1] - a[1]) * along[1]) / squared;
    let share = if squared > 0.0 { share.clamp(0.0, 1.0) } else { 0.0 };
    (p[0] - a[0] - share * along[0]).hypot(p[1] - a[1] - share * along[1])
}
