//! Triangle meshes that rays meet: a tree of boxes by `obvhs` in single precision over triangles in double.

#[cfg(test)]
mod tests;

use super::shape::{Near, Patch, Ray};
use crate::error::{Error, Result};
use crate::reference::mesh_file::{RawMesh, read_raw};
use glam::{DVec3, Vec3A};
use obvhs::{BvhBuildParams, aabb::Aabb, bvh2::Bvh2, bvh2::builder::build_bvh2, ray::RayHit};
use std::path::Path;
use std::time::Duration;

/// How far boxes exceed their triangles, in sizes of the mesh: a ray's rounding to single precision near the mesh.
const BOX_MARGIN: f64 = 1e-6;
/// How far outside its edges a triangle is still met: the rounding of double precision, so that neighbours leave no gap.
const EDGE: f64 = 1e-12;
/// Area against the longest side squared below which a triangle is a line.
const FLAT: f64 = 1e-13;
/// Largest coordinate.
const MOST: f64 = 1e6;

/// A mesh.
pub struct Mesh {
    positions: Vec<DVec3>,
    /// As many as positions, or none.
    normals: Vec<DVec3>,
    /// As many as positions, or none.
    uv: Vec<[f64; 2]>,
    triangles: Vec<[u32; 3]>,
    tree: Bvh2,
    low: DVec3,
    high: DVec3,
}

impl std::fmt::Debug for Mesh {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "mesh of {} triangles", self.triangles.len())
    }
}

impl Mesh {
    /// Reads a mesh, with notes on what is odd about it.
    ///
    /// # Errors
    /// As [`read_raw`] and [`Mesh::new`].
    pub fn read(path: &Path, needs_uv: bool) -> Result<(Self, Vec<String>)> {
        Self::new(read_raw(path)?, needs_uv).map_err(|problem| Error::file(path, problem))
    }

    /// A mesh from its parts.
    ///
    /// # Errors
    /// What is wrong: no triangles, coordinates that are not finite or too large, or, where a material needs them, texture
    /// coordinates that are missing or the same all over every triangle.
    pub fn new(raw: RawMesh, needs_uv: bool) -> std::result::Result<(Self, Vec<String>), String> {
        let RawMesh { positions, normals, uv, mut triangles, mut notes } = raw;
        let bounded = |values: &[f64]| values.iter().all(|v| v.abs() <= MOST);
        for (what, at) in [
            ("position", positions.iter().position(|v| !bounded(v))),
            ("normal", normals.iter().position(|v| !bounded(v))),
            ("texture coordinate", uv.iter().position(|v| !bounded(v))),
        ] {
            if let Some(at) = at {
                return Err(format!("the {what} of corner {at} is not finite or larger than {MOST}"));
            }
        }
        if needs_uv && uv.is_empty() {
            return Err("has no texture coordinates, which its material needs; unwrap the mesh".into());
        }
        let positions: Vec<DVec3> = positions.into_iter().map(DVec3::from).collect();
        let all = triangles.len();
        triangles.retain(|t| !is_flat(t.map(|k| positions[k as usize])));
        if triangles.is_empty() {
            return Err(format!("has no triangles with an area, of {all}"));
        }
        if triangles.len() < all {
            notes.push(format!(
                "{} of {all} triangles have no area; they are left out",
                all - triangles.len()
            ));
        }
        let degenerate = triangles.iter().filter(|t| needs_uv && uv_area(&uv, t) == 0.0).count();
        if degenerate == triangles.len() {
            return Err(
                "all its texture coordinates are degenerate: no triangle covers any of the tile; unwrap it"
                    .into(),
            );
        }
        if degenerate > 0 {
            notes.push(format!(
                "{degenerate} of {} triangles have degenerate texture coordinates; their u runs anywhere",
                triangles.len()
            ));
        }
        let used = || triangles.iter().flatten().map(|k| positions[*k as usize]);
        let (low, high) =
            used().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(a, b), p| (a.min(p), b.max(p)));
        let margin = DVec3::splat(BOX_MARGIN * (high - low).max_element());
        let boxes: Vec<Aabb> = triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|k| positions[k as usize]);
                // In single precision coordinates count from the mesh's corner, where they are as small as the mesh.
                let single = |v: DVec3| Vec3A::from((v - low).as_vec3());
                Aabb::new(single(a.min(b).min(c) - margin), single(a.max(b).max(c) + margin))
            })
            .collect();
        let tree = build_bvh2(&boxes, BvhBuildParams::medium_build(), &mut Duration::default());
        let normals = normals.into_iter().map(|n| DVec3::from(n).normalize_or_zero()).collect();
        let mesh = Self { positions, normals, uv, triangles, tree, low: low - margin, high: high + margin };
        Ok((mesh, notes))
    }

    /// Number of triangles.
    pub fn triangles(&self) -> usize {
        self.triangles.len()
    }

    /// First point at 0 < t < `far` where the ray meets the mesh.
    pub fn nearest(&self, ray: &Ray, far: f64) -> Option<Near> {
        let (single, start, unit) = self.single(ray, far)?;
        let mut best: Option<Near> = None;
        self.tree.ray_traverse(single, &mut RayHit::none(), |_, index| {
            let triangle = self.tree.primitive_indices[index];
            let reach = best.map_or(far, |near| near.t);
            match self.meet(ray, triangle).filter(|near| near.t > 0.0 && near.t < reach) {
                Some(near) => {
                    best = Some(near);
                    above((near.t - start) * unit)
                }
                None => f32::INFINITY,
            }
        });
        best
    }

    /// True if the ray meets the mesh at 0 < t < `far`.
    pub fn blocks(&self, ray: &Ray, far: f64) -> bool {
        let Some((single, ..)) = self.single(ray, far) else { return false };
        !self.tree.ray_traverse_miss(single, |_, index| {
            let met = self.meet(ray, self.tree.primitive_indices[index]);
            if met.is_some_and(|near| near.t > 0.0 && near.t < far) { -1.0 } else { f32::INFINITY }
        })
    }

    /// The ray in single precision from where it enters the mesh's box, with the distance there, and its length in the
    /// single ray's units.
    fn single(&self, ray: &Ray, far: f64) -> Option<(obvhs::ray::Ray, f64, f64)> {
        let (mut enter, mut leave) = (0.0f64, far);
        for c in 0..3 {
            let inverse = 1.0 / ray.direction[c];
            let (a, b) = ((self.low[c] - ray.origin[c]) * inverse, (self.high[c] - ray.origin[c]) * inverse);
            // f64::max and min pass over the NaN of a ray within a side of the box.
            enter = enter.max(a.min(b));
            leave = leave.min(a.max(b));
        }
        if enter > leave {
            return None;
        }
        let unit = ray.direction.length();
        let (origin, direction) = (ray.at(enter) - self.low, ray.direction / unit);
        let reach = above((leave - enter) * unit);
        let [origin, direction] = [origin, direction].map(|v| Vec3A::from(v.as_vec3()));
        Some((obvhs::ray::Ray::new(origin, direction, 0.0, reach), enter, unit))
    }

    /// Where the ray's line meets a triangle (Moeller and Trumbore 1997).
    fn meet(&self, ray: &Ray, triangle: u32) -> Option<Near> {
        let [a, b, c] = self.triangles[triangle as usize].map(|k| self.positions[k as usize]);
        let (ab, ac) = (b - a, c - a);
        let p = ray.direction.cross(ac);
        let inverse = 1.0 / ab.dot(p);
        let s = ray.origin - a;
        let v = s.dot(p) * inverse;
        let q = s.cross(ab);
        let w = ray.direction.dot(q) * inverse;
        let inside = v >= -EDGE && w >= -EDGE && v + w <= 1.0 + EDGE;
        inside.then(|| Near { t: ac.dot(q) * inverse, triangle, weights: [v, w] })
    }

    /// The surface where a ray met the mesh. Normals and texture coordinates are interpolated.
    pub fn patch(&self, near: &Near) -> Patch {
        let corners = self.triangles[near.triangle as usize];
        let [a, b, c] = corners.map(|k| self.positions[k as usize]);
        let [v, w] = near.weights;
        let (ab, ac) = (b - a, c - a);
        let geometric = ab.cross(ac);
        let normal = match self.normals.as_slice() {
            [] => geometric,
            normals => {
                let [x, y, z] = corners.map(|k| normals[k as usize]);
                let normal = (1.0 - v - w) * x + v * y + w * z;
                if normal.length_squared() > FLAT { normal } else { geometric }
            }
        };
        let mut patch = Patch {
            position: a + v * ab + w * ac,
            // Where they disagree, the file's normals say which side is out.
            geometric: if geometric.dot(normal) < 0.0 { -geometric } else { geometric },
            normal,
            uv: [0.0; 2],
            du: DVec3::ZERO,
            dv: DVec3::ZERO,
        };
        if self.uv.is_empty() {
            return patch;
        }
        let [x, y, z] = corners.map(|k| self.uv[k as usize]);
        patch.uv = std::array::from_fn(|i| x[i] + v * (y[i] - x[i]) + w * (z[i] - x[i]));
        let area = uv_area(&self.uv, &corners);
        if area != 0.0 {
            patch.du = ((z[1] - x[1]) * ab - (y[1] - x[1]) * ac) / area;
            patch.dv = ((y[0] - x[0]) * ac - (z[0] - x[0]) * ab) / area;
        }
        patch
    }
}

/// Twice the signed area of a triangle on the tile.
fn uv_area(uv: &[[f64; 2]], corners: &[u32; 3]) -> f64 {
    let [x, y, z] = corners.map(|k| uv[k as usize]);
    (y[0] - x[0]) * (z[1] - x[1]) - (z[0] - x[0]) * (y[1] - x[1])
}

fn is_flat([a, b, c]: [DVec3; 3]) -> bool {
    let longest = (b - a).length_squared().max((c - a).length_squared()).max((c - b).length_squared());
    (b - a).cross(c - a).length() <= FLAT * longest
}

/// The next single-precision number above.
fn above(value: f64) -> f32 {
    (value as f32).next_up()
}
