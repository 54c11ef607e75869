//! Objects in the scene: placed shapes, what a ray meets, and the frame in which a material is asked there.

use super::format::{ObjectSpec, ShapeSpec};
use super::mesh::Mesh;
use super::shape::{Near, Ray, Shape};
use crate::error::{Error, Result};
use glam::{DAffine3, DMat3, DQuat, DVec3};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// How far rays start from a surface, against the largest coordinate there: far above the rounding of positions, far
/// below anything that is seen.
const LEAVE: f64 = 1e-8;

/// Everything that rays meet.
#[derive(Debug)]
pub struct World {
    objects: Vec<Object>,
    /// Notes on the meshes, a line each.
    pub notes: Vec<String>,
}

#[derive(Debug)]
struct Object {
    shape: Arc<Shape>,
    to_world: DAffine3,
    to_local: DAffine3,
    /// Takes normals to the world.
    normals: DMat3,
    material: usize,
    tiling: [f64; 2],
}

/// What a ray met.
#[derive(Clone, Copy, Debug)]
pub struct Hit {
    near: Near,
    object: usize,
}

impl Hit {
    /// Distance along the ray in lengths of its direction.
    pub fn distance(&self) -> f64 {
        self.near.t
    }
}

/// A point of a surface as a material sees it.
#[derive(Clone, Copy, Debug)]
pub struct Spot {
    /// Place of the material in the scene's list.
    pub material: usize,
    /// The point.
    pub position: DVec3,
    /// Outward unit normal of the surface itself.
    pub geometric: DVec3,
    /// Columns: x along increasing u, y along increasing v, z the normal of shading.
    pub frame: DMat3,
    /// Texture coordinates in tiles, not wrapped.
    pub uv: [f64; 2],
    /// Tiles in a unit of the surface's area; 0 where texture coordinates are degenerate.
    pub density: f64,
}

impl World {
    /// The objects of a scene. `materials` gives the place of a material by its name, and whether it needs texture
    /// coordinates; `base` is the folder of relative paths.
    ///
    /// # Errors
    /// `File`, naming the object's mesh; `Config`, naming an object whose material there is not.
    pub fn new(
        objects: &[ObjectSpec],
        base: &Path,
        materials: impl Fn(&str) -> Option<(usize, bool)>,
    ) -> Result<Self> {
        let mut world = Self { objects: Vec::with_capacity(objects.len()), notes: Vec::new() };
        let mut shapes: HashMap<(PathBuf, bool), Arc<Shape>> = HashMap::new();
        for (k, spec) in objects.iter().enumerate() {
            let Some((material, needs_uv)) = materials(&spec.material) else {
                let problem = format!("there is no material of the name {}", spec.material);
                return Err(Error::config(format!("objects[{k}].material"), problem));
            };
            let shape = match &spec.shape {
                ShapeSpec::Plane => Arc::new(Shape::Plane),
                ShapeSpec::Sphere => Arc::new(Shape::Sphere),
                ShapeSpec::Mesh(file) => {
                    let key = (base.join(file), needs_uv);
                    match shapes.get(&key) {
                        Some(shape) => shape.clone(),
                        None => {
                            let (mesh, notes) =
                                Mesh::read(&key.0, needs_uv).map_err(|error| match error {
                                    Error::File { path, problem } => {
                                        Error::file(path, format!("(objects[{k}]) {problem}"))
                                    }
                                    other => other,
                                })?;
                            let named = |note: &String| format!("objects[{k}] ({}): {note}", file.display());
                            world.notes.extend(notes.iter().map(named));
                            let shape = Arc::new(Shape::Mesh(Box::new(mesh)));
                            shapes.insert(key, shape.clone());
                            shape
                        }
                    }
                }
            };
            let [x, y, z] = spec.rotate.map(f64::to_radians);
            let turn = DQuat::from_rotation_z(z) * DQuat::from_rotation_y(y) * DQuat::from_rotation_x(x);
            let scale = DVec3::from(spec.scale.0);
            let to_world = DAffine3::from_scale_rotation_translation(scale, turn, spec.translate.into());
            let to_local = to_world.inverse();
            let normals = to_local.matrix3.transpose();
            world.objects.push(Object { shape, to_world, to_local, normals, material, tiling: spec.tiling });
        }
        Ok(world)
    }

    /// The nearest hit of a ray.
    pub fn nearest(&self, ray: &Ray) -> Option<Hit> {
        let mut best: Option<Hit> = None;
        for (object, each) in self.objects.iter().enumerate() {
            let far = best.map_or(f64::INFINITY, |hit| hit.near.t);
            if let Some(near) = each.shape.nearest(&each.local(ray), far) {
                best = Some(Hit { near, object });
            }
        }
        best
    }

    /// True if nothing lies on the ray at 0 < t < `far`.
    pub fn is_free(&self, ray: &Ray, far: f64) -> bool {
        !self.objects.iter().any(|object| object.shape.blocks(&object.local(ray), far))
    }

    /// The surface where a ray met it.
    pub fn spot(&self, ray: &Ray, hit: &Hit) -> Spot {
        let object = &self.objects[hit.object];
        let patch = object.shape.patch(&object.local(ray), &hit.near);
        let geometric = (object.normals * patch.geometric).normalize_or(DVec3::Z);
        let normal = (object.normals * patch.normal).normalize_or(geometric);
        let linear = object.to_world.matrix3;
        let [a, b] = object.tiling;
        let (du, dv) = (linear * patch.du / a, linear * patch.dv / b);
        let stretch = du.cross(dv).length();
        Spot {
            material: object.material,
            position: object.to_world.transform_point3(patch.position),
            geometric,
            frame: frame(normal, du, dv),
            uv: [patch.uv[0] * a, patch.uv[1] * b],
            density: if stretch > 0.0 { 1.0 / stretch } else { 0.0 },
        }
    }
}

impl Object {
    fn local(&self, ray: &Ray) -> Ray {
        Ray {
            origin: self.to_local.transform_point3(ray.origin),
            direction: self.to_local.transform_vector3(ray.direction),
        }
    }
}

impl Spot {
    /// The ray that leaves the surface in a direction; None if it would start into the surface.
    pub fn leave(&self, direction: DVec3) -> Option<Ray> {
        let reach = LEAVE * (1.0 + self.position.abs().max_element());
        (direction.dot(self.geometric) > 0.0)
            .then(|| Ray { origin: self.position + reach * self.geometric, direction })
    }
}

/// The local frame: x = du without its part along the normal, y normal to both towards dv, whatever the handedness. Where
/// du gives no direction, x is any.
pub fn frame(normal: DVec3, du: DVec3, dv: DVec3) -> DMat3 {
    let along = du - normal * normal.dot(du);
    let x = if along.length_squared() > DEGENERATE * du.length_squared() {
        along.normalize()
    } else {
        normal.any_orthonormal_vector()
    };
    let y = normal.cross(x);
    DMat3::from_cols(x, if y.dot(dv) < 0.0 { -y } else { y }, normal)
}

/// Squared sine of the angle to the normal below which the direction of u is rounding.
const DEGENERATE: f64 = 1e-20;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::format::Scale;

    /// Products of a few numbers of size one in f64.
    const ROUNDING: f64 = 1e-12;

    fn object(shape: ShapeSpec) -> ObjectSpec {
        ObjectSpec {
            shape,
            material: "m".into(),
            translate: [1.0, -2.0, 0.5],
            rotate: [30.0, -40.0, 70.0],
            scale: Scale([2.0, 3.0, 0.5]),
            tiling: [3.0, 5.0],
        }
    }

    fn world(spec: ObjectSpec) -> World {
        World::new(&[spec], Path::new(""), |_| Some((0, true))).unwrap()
    }

    /// Hits around the middle of what is seen from afar.
    fn spots(world: &World) -> Vec<Spot> {
        let origin = DVec3::new(4.0, -20.0, 30.0);
        let rays = (0..100).map(|k| {
            let aim = DVec3::new(1.0 + (k % 10) as f64 * 0.1, -2.0 + (k / 10) as f64 * 0.1, 0.5);
            Ray { origin, direction: aim - origin }
        });
        let found: Vec<Spot> =
            rays.filter_map(|ray| world.nearest(&ray).map(|hit| world.spot(&ray, &hit))).collect();
        assert!(found.len() > 20, "{}", found.len());
        found
    }

    #[test]
    fn frames_are_unit_follow_uv_and_may_be_mirrored() {
        for (shape, handedness) in [(ShapeSpec::Plane, 1.0), (ShapeSpec::Sphere, -1.0)] {
            for spot in spots(&world(object(shape.clone()))) {
                let product = spot.frame.transpose() * spot.frame;
                assert!(product.abs_diff_eq(DMat3::IDENTITY, ROUNDING));
                assert!((spot.frame.determinant() - handedness).abs() < ROUNDING);
                assert!((spot.frame.z_axis - spot.geometric).length() < ROUNDING);
            }
        }
    }

    #[test]
    fn density_is_the_tiles_on_an_area() {
        // The plane is 4 x 6 with 3 x 5 tiles.
        for spot in spots(&world(object(ShapeSpec::Plane))) {
            assert!((spot.density - 15.0 / 24.0).abs() < ROUNDING);
        }
        let unit = ObjectSpec { scale: Scale([2.0; 3]), ..object(ShapeSpec::Sphere) };
        for spot in spots(&world(unit)) {
            let theta = spot.uv[1] / 5.0 * std::f64::consts::PI;
            let exact = 15.0 / (2.0 * std::f64::consts::PI.powi(2) * theta.sin() * 4.0);
            assert!((spot.density / exact - 1.0).abs() < 1e3 * ROUNDING, "{} {exact}", spot.density);
        }
    }

    #[test]
    fn degenerate_directions_of_u_give_a_frame_all_the_same() {
        let normal = DVec3::new(0.6, 0.0, 0.8);
        for du in [DVec3::ZERO, normal] {
            let frame = frame(normal, du, DVec3::ZERO);
            assert!((frame.transpose() * frame).abs_diff_eq(DMat3::IDENTITY, ROUNDING));
        }
    }
}
