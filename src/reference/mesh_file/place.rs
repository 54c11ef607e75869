//! From the file's coordinates to the tile's.

use super::{Checked, RawMesh, cross, dot, minus};
use crate::reference::heightfield::MAX_DEPTH;
use crate::reference::primitives::TriangleMesh;
use serde::Deserialize;

/// How far the sides of a tile may differ, relatively: what is lost in typing them.
const SQUARE: f64 = 1e-5;

/// How far a mesh may stick out of its tile, in tile widths; more is a tile that was not stated.
const MAX_OVERHANG: f64 = 0.5;

/// Largest texture coordinate: beyond it less than a thousandth of a texel of f32 is left of where it points.
const MAX_UV: f64 = 1e4;

/// Area of a triangle against its longest side squared, below which it is a line: the rounding of f64.
const FLAT: f64 = 1e-13;

/// Which axis of the file is up.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub enum Up {
    /// The ground is x and y.
    #[default]
    Z,
    /// The ground is x and z.
    Y,
}

/// Where the tile lies in the file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Its corners \[x0, y0, x1, y1\] on the file's ground (z instead of y where y is up).
    pub tile: [f64; 4],
    /// Which axis is up.
    pub up: Up,
}

impl Default for Placement {
    fn default() -> Self {
        Self { tile: [0.0, 0.0, 1.0, 1.0], up: Up::Z }
    }
}

/// A checked placement.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    tile: [f64; 4],
    side: f64,
    up: Up,
}

impl Frame {
    pub fn new(placement: &Placement) -> Checked<Self> {
        let Placement { tile, up } = *placement;
        let [width, depth] = [tile[2] - tile[0], tile[3] - tile[1]];
        if !(width > 0.0 && depth > 0.0 && width.is_finite() && depth.is_finite()) {
            return Err(format!(
                "has the tile {tile:?}; state it as [x0, y0, x1, y1] with x0 < x1 and y0 < y1"
            ));
        }
        if (width - depth).abs() > SQUARE * width {
            return Err(format!(
                "has a tile of {width} x {depth}; it must be square, since heights and both sides share one scale"
            ));
        }
        Ok(Self { tile, side: width, up })
    }

    /// A point of the tile from a point of the file.
    fn point(&self, p: [f64; 3]) -> [f64; 3] {
        let [x0, y0, _, y1] = self.tile;
        match self.up {
            Up::Z => [p[0] - x0, y1 - p[1], p[2]],
            Up::Y => [p[0] - x0, p[2] - y0, p[1]],
        }
        .map(|c| c / self.side)
    }

    fn direction(&self, d: [f64; 3]) -> [f64; 3] {
        match self.up {
            Up::Z => [d[0], -d[1], d[2]],
            Up::Y => [d[0], d[2], d[1]],
        }
    }

    /// Where a point (x, y) of the tile lies on the file's ground, in words.
    pub fn ground(&self, [x, y]: [f64; 2]) -> String {
        let [x0, y0, _, y1] = self.tile;
        let x = x0 + self.side * x;
        match self.up {
            Up::Z => format!("x = {x:.4}, y = {:.4}", y1 - self.side * y),
            Up::Y => format!("x = {x:.4}, z = {:.4}", y0 + self.side * y),
        }
    }

    /// The mesh in tile widths, without triangles that are none.
    pub fn place(&self, raw: RawMesh, notes: &mut Vec<String>) -> Checked<TriangleMesh> {
        if raw.triangles.is_empty() {
            return Err("has no triangles".into());
        }
        let positions: Vec<[f64; 3]> = raw.positions.iter().map(|&p| self.point(p)).collect();
        if let Some(k) = positions.iter().position(|p| !p.iter().all(|c| c.is_finite())) {
            return Err(format!("has a vertex that is not finite: {:?}", raw.positions[k]));
        }
        // Both ways of putting the file's axes to ours mirror the mesh: turning the triangles keeps their outer side.
        let turned = raw.triangles.iter().map(|&[a, b, c]| [a, c, b]);
        let triangles: Vec<[u32; 3]> =
            turned.filter(|t| has_area(t.map(|k| positions[k as usize]))).collect();
        let lines = raw.triangles.len() - triangles.len();
        if triangles.is_empty() {
            return Err("has no triangle with an area".into());
        }
        if lines > 0 {
            notes.push(format!("{lines} of {} triangles have no area and are left out", raw.triangles.len()));
        }
        self.check_extent(&positions, &triangles)?;
        let normals = self.normals(&raw, notes);
        let uv = uv(&raw, notes);
        Ok(used_only(TriangleMesh { positions, triangles, normals, uv }))
    }

    fn check_extent(&self, positions: &[[f64; 3]], triangles: &[[u32; 3]]) -> Checked<()> {
        let (low, high) = bounds(triangles.iter().flatten().map(|&k| positions[k as usize]));
        if (0..2).any(|c| low[c] < -MAX_OVERHANG || high[c] > 1.0 + MAX_OVERHANG) {
            let from = self.ground([low[0], low[1]]);
            let to = self.ground([high[0], high[1]]);
            return Err(format!(
                "reaches from {from} to {to}, far out of its tile {:?}; state the square that repeats as tile: \
                 [x0, y0, x1, y1]",
                self.tile
            ));
        }
        let depth = low[2].abs().max(high[2].abs());
        if depth > f64::from(MAX_DEPTH) {
            return Err(format!(
                "reaches {depth:.3} tile widths from the plane; at most {MAX_DEPTH} works: move or flatten it"
            ));
        }
        Ok(())
    }

    fn normals(&self, raw: &RawMesh, notes: &mut Vec<String>) -> Option<Vec<[f64; 3]>> {
        if raw.normals.len() != raw.positions.len() {
            return None;
        }
        let unit = |n: &[f64; 3]| {
            let length = dot(*n, *n).sqrt();
            (length > 0.0 && length.is_finite()).then(|| self.direction(n.map(|c| c / length)))
        };
        let normals: Option<Vec<_>> = raw.normals.iter().map(unit).collect();
        if normals.is_none() {
            notes.push("some normals have no direction; all of them are left aside".into());
        }
        normals
    }
}

fn uv(raw: &RawMesh, notes: &mut Vec<String>) -> Option<Vec<[f64; 2]>> {
    if raw.uv.len() != raw.positions.len() {
        return None;
    }
    if !raw.uv.iter().flatten().all(|c| c.abs() <= MAX_UV) {
        notes.push(format!("some texture coordinates are beyond {MAX_UV}; all of them are left aside"));
        return None;
    }
    Some(raw.uv.iter().map(|[u, v]| [*u, 1.0 - v]).collect())
}

/// Leaves out vertices of no triangle: nothing that is measured on the mesh may depend on them.
fn used_only(mut mesh: TriangleMesh) -> TriangleMesh {
    let mut places = vec![u32::MAX; mesh.positions.len()];
    let mut kept = Vec::new();
    for index in mesh.triangles.as_flattened_mut() {
        let old = *index as usize;
        if places[old] == u32::MAX {
            places[old] = kept.len() as u32;
            kept.push(old);
        }
        *index = places[old];
    }
    TriangleMesh {
        positions: kept.iter().map(|&k| mesh.positions[k]).collect(),
        normals: mesh.normals.map(|normals| kept.iter().map(|&k| normals[k]).collect()),
        uv: mesh.uv.map(|uv| kept.iter().map(|&k| uv[k]).collect()),
        triangles: mesh.triangles,
    }
}

fn has_area([a, b, c]: [[f64; 3]; 3]) -> bool {
    let sides = [minus(b, a), minus(c, a), minus(c, b)];
    let longest = sides.iter().map(|s| dot(*s, *s)).fold(0.0, f64::max);
    let normal = cross(sides[0], sides[1]);
    dot(normal, normal).sqrt() > FLAT * longest
}

/// Smallest and largest coordinates.
pub(super) fn bounds(points: impl Iterator<Item = [f64; 3]>) -> ([f64; 3], [f64; 3]) {
    points.fold(([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]), |(low, high), p| {
        (std::array::from_fn(|c| low[c].min(p[c])), std::array::from_fn(|c| high[c].max(p[c])))
    })
}
