//! Rays against a triangle mesh.
//!
//! The mesh is watertight: along a common edge both triangles get the same number with opposite signs (Woop, Benthin and
//! Wald 2013), here in f64.

use super::shapes::{CellRay, Grid, LANES, Placed, Shapes};
use super::tiled::Tiled;
use super::{MAX_PRIMITIVES, check_point, cross, dot, normalise, sub};
use crate::error::{Error, Result};
use crate::reference::raycast::SURFACE_OFFSET;
use glam::Vec4;

/// A mesh as plain data.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TriangleMesh {
    /// Corners in tile widths.
    pub positions: Vec<[f64; 3]>,
    /// Three corners each; both sides are hit.
    pub triangles: Vec<[u32; 3]>,
    /// A shading normal a corner, of any length. None shades with the triangles' own.
    pub normals: Option<Vec<[f64; 3]>>,
    /// Position in the material's maps a corner. None takes x and y.
    pub uv: Option<Vec<[f64; 2]>>,
}

/// Where a ray meets a mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeshHit {
    /// Distance along the ray in units of its direction's length.
    pub t: f64,
    /// The point, not wrapped.
    pub position: [f64; 3],
    /// Unit normal of the triangle, on the side the ray came from.
    pub normal: [f64; 3],
    /// Unit normal between those of the corners, on the same side of the triangle.
    pub shading_normal: [f64; 3],
    /// Position in the material's maps: between those of the corners, not wrapped; without them x and y, wrapped.
    pub uv: [f64; 2],
}

impl MeshHit {
    /// The point from which rays leave the surface, see [`SURFACE_OFFSET`].
    pub fn departure(&self) -> [f64; 3] {
        std::array::from_fn(|c| self.position[c] + SURFACE_OFFSET * self.normal[c])
    }
}

/// A mesh that repeats with the tile.
#[derive(Debug)]
pub struct Triangles {
    tiled: Tiled<Mesh>,
}

impl Triangles {
    /// A mesh ready for rays. Triangles without area are left out.
    ///
    /// # Errors
    /// `Config` on `mesh` if there is no triangle or more than [`MAX_PRIMITIVES`], a corner does not exist, a number
    /// is not finite, a position lies outside [`MAX_EXTENT`](super::MAX_EXTENT) or farther than [`MAX_DEPTH`](crate::reference::heightfield::MAX_DEPTH) from the plane, or normals
    /// or uv are not as many as positions.
    pub fn new(mesh: TriangleMesh) -> Result<Self> {
        let mesh = Mesh::new(mesh)?;
        let mut range = [f64::INFINITY, f64::NEG_INFINITY];
        for index in 0..mesh.triangles.len() {
            for [_, _, z] in mesh.corners(index as u32) {
                range = [range[0].min(z), range[1].max(z)];
            }
        }
        Ok(Self { tiled: Tiled::new(mesh, range, "mesh")? })
    }

    /// Least and greatest z, in tile widths.
    pub fn range(&self) -> [f64; 2] {
        self.tiled.range
    }

    /// First point at 0 <= t <= `t_max` where the ray meets the mesh. Rays are followed for
    /// [`crate::reference::raycast::MAX_DISTANCE`].
    pub fn intersect(&self, origin: [f64; 3], direction: [f64; 3], t_max: f64) -> Option<MeshHit> {
        let found = self.tiled.trace::<false>(origin, direction, t_max)?;
        let mesh = &self.tiled.shapes;
        let Blend { weights, normal } = found.hit;
        let corners = || mesh.triangles[found.placed.index as usize].map(|corner| corner as usize);
        let facing = |n: [f64; 3], towards: [f64; 3]| if dot(n, towards) < 0.0 { n.map(|x| -x) } else { n };
        let normal = facing(normalise(normal)?, found.direction.map(|d| -d));
        let shading_normal = mesh.normals.as_ref().and_then(|normals| {
            let n = blend(weights, corners().map(|corner| normals[corner]));
            Some(facing(normalise(n)?, normal))
        });
        let uv = match &mesh.uv {
            Some(uv) => blend(weights, corners().map(|corner| uv[corner])),
            None => [wrap(found.local[0]), wrap(found.local[1])],
        };
        let (t, position) = (found.t, found.position);
        Some(MeshHit { t, position, normal, shading_normal: shading_normal.unwrap_or(normal), uv })
    }

    /// True if the ray meets the mesh on its way out.
    pub fn occluded(&self, origin: [f64; 3], direction: [f64; 3]) -> bool {
        self.tiled.trace::<true>(origin, direction, f64::INFINITY).is_some()
    }
}

/// The position inside the tile, below 1 even where rounding would give 1.
fn wrap(x: f64) -> f64 {
    let x = x.rem_euclid(1.0);
    if x < 1.0 { x } else { 0.0 }
}

fn blend<const N: usize>(weights: [f64; 3], values: [[f64; N]; 3]) -> [f64; N] {
    std::array::from_fn(|c| (0..3).map(|k| weights[k] * values[k][c]).sum())
}

#[derive(Debug)]
struct Mesh {
    positions: Vec<[f64; 3]>,
    triangles: Vec<[u32; 3]>,
    normals: Option<Vec<[f64; 3]>>,
    uv: Option<Vec<[f64; 2]>>,
    /// What f32 may lose of a corner's position as seen from the ray.
    slack: f32,
}

impl Mesh {
    fn new(mesh: TriangleMesh) -> Result<Self> {
        let TriangleMesh { mut positions, mut triangles, normals, uv } = mesh;
        if triangles.is_empty() {
            return Err(Error::config("mesh.triangles", "there is none; give at least one"));
        }
        if triangles.len() > MAX_PRIMITIVES {
            return Err(Error::config(
                "mesh.triangles",
                format!("{} are given; at most {MAX_PRIMITIVES} work", triangles.len()),
            ));
        }
        for (k, position) in positions.iter().enumerate() {
            check_point(*position, || format!("mesh.positions[{k}]"))?;
        }
        for (k, corner) in triangles.iter().enumerate().flat_map(|(k, t)| t.map(|corner| (k, corner))) {
            if corner as usize >= positions.len() {
                return Err(Error::config(
                    format!("mesh.triangles[{k}]"),
                    format!("names corner {corner} of {}", positions.len()),
                ));
            }
        }
        check_corners("mesh.normals", normals.as_deref(), positions.len())?;
        check_corners("mesh.uv", uv.as_deref(), positions.len())?;

        let widest = triangles.iter().map(|corners| width(&positions, corners)).fold(0.0, f64::max);
        let grid = Grid::new(widest);
        for position in &mut positions {
            *position = grid.snap(*position);
        }
        triangles.retain(|corners| {
            let [a, b, c] = corners.map(|corner| positions[corner as usize]);
            normalise(cross(sub(b, a), sub(c, a))).is_some()
        });
        Ok(Self { positions, triangles, normals, uv, slack: SLACK * (1.0 + widest as f32) })
    }

    fn corners(&self, index: u32) -> [[f64; 3]; 3] {
        self.triangles[index as usize].map(|corner| self.positions[corner as usize])
    }
}

/// Extent of a triangle in x or y, whichever is larger.
fn width(positions: &[[f64; 3]], corners: &[u32; 3]) -> f64 {
    let [p, q, r] = corners.map(|corner| positions[corner as usize]);
    let extent = |c: usize| p[c].max(q[c]).max(r[c]) - p[c].min(q[c]).min(r[c]);
    extent(0).max(extent(1))
}

/// A triangle that planes cut corners off: at most 3 + 4.
struct Polygon {
    corners: [[f64; 3]; 7],
    len: usize,
}

impl Polygon {
    fn new([a, b, c]: [[f64; 3]; 3]) -> Self {
        Self { corners: [a, b, c, a, a, a, a], len: 3 }
    }

    fn push(&mut self, corner: [f64; 3]) {
        if let Some(slot) = self.corners.get_mut(self.len) {
            *slot = corner;
            self.len += 1;
        }
    }

    /// The part with (x - bound) sign >= 0 on an axis (Sutherland and Hodgman 1974).
    fn cut(&self, axis: usize, bound: f64, sign: f64) -> Self {
        let mut kept = Self { corners: [[0.0; 3]; 7], len: 0 };
        for k in 0..self.len {
            let (p, q) = (self.corners[k], self.corners[(k + 1) % self.len]);
            let [a, b] = [p, q].map(|corner| (corner[axis] - bound) * sign);
            if a >= 0.0 {
                kept.push(p);
            }
            if (a >= 0.0) != (b >= 0.0) {
                let s = a / (a - b);
                kept.push(std::array::from_fn(|c| p[c] + (q[c] - p[c]) * s));
            }
        }
        kept
    }

    fn heights(&self) -> Option<[f64; 2]> {
        let heights = self.corners[..self.len].iter().map(|corner| corner[2]);
        heights.fold(None, |range, z| {
            let [low, high] = range.unwrap_or([z, z]);
            Some([low.min(z), high.max(z)])
        })
    }
}

fn check_corners<const N: usize>(field: &str, values: Option<&[[f64; N]]>, count: usize) -> Result<()> {
    let Some(values) = values else { return Ok(()) };
    if values.len() != count {
        return Err(Error::config(field, format!("has {} entries for {count} positions", values.len())));
    }
    match values.iter().position(|value| value.iter().any(|x| !x.is_finite())) {
        Some(k) => Err(Error::config(format!("{field}[{k}]"), "is not finite")),
        None => Ok(()),
    }
}

/// What f32 loses of a corner's position as seen from the ray, per unit of the largest coordinate: it is rounded
/// five times at magnitudes to 3.
const SLACK: f32 = 2e-6;

/// The axis along which a ray runs most, the other two, and how it shears along them.
#[derive(Clone, Copy, Debug)]
struct Aim {
    axes: [usize; 3],
    shear: [f64; 2],
    scale: f64,
}

/// What a hit is described from.
#[derive(Clone, Copy, Debug)]
struct Blend {
    /// Weights of the corners.
    weights: [f64; 3],
    /// Of any length and on any side.
    normal: [f64; 3],
}

/// What the quick test needs of a ray.
#[derive(Clone, Copy, Debug)]
struct Local {
    axes: [usize; 3],
    /// Along the three axes.
    origin: [Vec4; 3],
    shear: [Vec4; 2],
}

/// Coordinates of three corners, four triangles side by side; NaN in lanes without one.
type Packet = [[Vec4; 3]; 3];

impl Shapes for Mesh {
    type Packet = Packet;
    type Aim = Aim;
    type Local = Local;
    type Hit = Blend;

    fn len(&self) -> usize {
        self.triangles.len()
    }

    fn extent(&self, index: u32) -> Option<[[f64; 2]; 2]> {
        let [p, q, r] = self.corners(index);
        Some([0, 1].map(|c| [p[c].min(q[c]).min(r[c]), p[c].max(q[c]).max(r[c])]))
    }

    fn heights_over(&self, placed: Placed, low: [f64; 2], high: [f64; 2]) -> Option<[f64; 2]> {
        let mut polygon = Polygon::new(self.corners(placed.index).map(|p| placed.place(p)));
        for c in 0..2 {
            polygon = polygon.cut(c, low[c], 1.0).cut(c, high[c], -1.0);
        }
        polygon.heights()
    }

    fn packet(&self, members: [Option<Placed>; LANES]) -> Packet {
        let mut packet = [[Vec4::splat(f32::NAN); 3]; 3];
        for (lane, placed) in members.iter().enumerate() {
            let Some(placed) = placed else { continue };
            for (corner, p) in packet.iter_mut().zip(self.corners(placed.index)) {
                for (coordinate, x) in corner.iter_mut().zip(placed.place(p)) {
                    coordinate[lane] = x as f32;
                }
            }
        }
        packet
    }

    fn aim(&self, direction: [f64; 3]) -> Aim {
        let [x, y, z] = direction.map(f64::abs);
        let along = if z >= x && z >= y { 2 } else { usize::from(y > x) };
        let axes = [(along + 1) % 3, (along + 2) % 3, along];
        let scale = 1.0 / direction[along];
        Aim { axes, shear: [direction[axes[0]] * scale, direction[axes[1]] * scale], scale }
    }

    fn local(&self, aim: &Aim, ray: &CellRay) -> Local {
        let origin = aim.axes.map(|axis| Vec4::splat(ray.origin[axis] as f32));
        Local { axes: aim.axes, origin, shear: aim.shear.map(|s| Vec4::splat(s as f32)) }
    }

    /// The exact test in f32, each edge with a margin for its rounding.
    #[inline]
    fn candidates(&self, packet: &Packet, local: &Local, _: f64) -> u32 {
        let [i, j, k] = local.axes;
        let slack = Vec4::splat(self.slack);
        let sheared = packet.map(|corner| {
            let depth = corner[k] - local.origin[2];
            let x = corner[i] - local.origin[0] - local.shear[0] * depth;
            let y = corner[j] - local.origin[1] - local.shear[1] * depth;
            (x, y, x.abs() + y.abs() + slack)
        });
        let edge = |(bx, by, b): (Vec4, Vec4, Vec4), (cx, cy, c): (Vec4, Vec4, Vec4)| {
            (cx * by - cy * bx, (b + c) * slack)
        };
        let [a, b, c] = sheared;
        let edges = [edge(b, c), edge(c, a), edge(a, b)];
        let [positive, negative] = [1.0, -1.0].map(|sign: f32| {
            let [u, v, w] = edges.map(|(area, margin)| (area * sign).cmpge(-margin));
            u & v & w
        });
        (positive | negative).bitmask()
    }

    #[inline]
    fn intersect(&self, packet: &Packet, lane: usize, aim: &Aim, ray: &CellRay) -> Option<(f64, Blend)> {
        let [i, j, k] = aim.axes;
        let corners = packet.map(|corner| sub(corner.map(|x| f64::from(x[lane])), ray.origin));
        let [a, b, c] =
            corners.map(|p| [p[i] - aim.shear[0] * p[k], p[j] - aim.shear[1] * p[k], p[k] * aim.scale]);
        // Twice the areas opposite the corners. Products are not fused: the same edge gives the same number.
        let u = c[0] * b[1] - c[1] * b[0];
        let v = a[0] * c[1] - a[1] * c[0];
        let w = b[0] * a[1] - b[1] * a[0];
        if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
            return None;
        }
        let sum = u + v + w;
        if sum == 0.0 {
            return None;
        }
        let weights = [u / sum, v / sum, w / sum];
        let t = weights[0] * a[2] + weights[1] * b[2] + weights[2] * c[2];
        let [p, q, r] = corners;
        let hit = || Blend { weights, normal: cross(sub(q, p), sub(r, p)) };
        (t >= ray.near && t <= ray.far).then(|| (t, hit()))
    }
}
