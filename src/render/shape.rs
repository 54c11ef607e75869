//! Shapes in their own coordinates: where a ray meets them, and how the surface lies there.

use super::mesh::Mesh;
use glam::DVec3;
use std::f64::consts::{PI, TAU};

/// A ray; the direction may have any length, and distances count in it.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    /// Where it starts.
    pub origin: DVec3,
    /// Where it goes.
    pub direction: DVec3,
}

impl Ray {
    /// The point at a distance.
    pub fn at(&self, t: f64) -> DVec3 {
        self.origin + t * self.direction
    }
}

/// A shape.
#[derive(Debug)]
pub enum Shape {
    /// The square \[-1, 1\]^2 at z = 0.
    Plane,
    /// Radius 1 around the origin.
    Sphere,
    /// Triangles.
    Mesh(Box<Mesh>),
}

/// Where a ray meets a shape.
#[derive(Clone, Copy, Debug)]
pub struct Near {
    /// Distance along the ray.
    pub t: f64,
    /// Triangle of a mesh.
    pub triangle: u32,
    /// Weights of the triangle's second and third corner.
    pub weights: [f64; 2],
}

/// The surface around a point, in the shape's coordinates.
#[derive(Clone, Copy, Debug)]
pub struct Patch {
    /// The point.
    pub position: DVec3,
    /// Outward normal of the surface itself; any length.
    pub geometric: DVec3,
    /// Outward normal of shading; any length.
    pub normal: DVec3,
    /// Texture coordinates.
    pub uv: [f64; 2],
    /// Change of the position by u; 0 where texture coordinates are degenerate.
    pub du: DVec3,
    /// Change of the position by v; 0 where texture coordinates are degenerate.
    pub dv: DVec3,
}

impl Shape {
    /// First point at 0 < t < `far` where the ray meets the shape.
    pub fn nearest(&self, ray: &Ray, far: f64) -> Option<Near> {
        let near = |t: f64| (t > 0.0 && t < far).then_some(Near { t, triangle: 0, weights: [0.0; 2] });
        match self {
            Self::Plane => {
                let hit = near(-ray.origin.z / ray.direction.z)?;
                let point = ray.at(hit.t);
                (point.x.abs() <= 1.0 && point.y.abs() <= 1.0).then_some(hit)
            }
            Self::Sphere => sphere(ray)?.into_iter().find_map(near),
            Self::Mesh(mesh) => mesh.nearest(ray, far),
        }
    }

    /// True if the ray meets the shape at 0 < t < `far`.
    pub fn blocks(&self, ray: &Ray, far: f64) -> bool {
        match self {
            Self::Plane | Self::Sphere => self.nearest(ray, far).is_some(),
            Self::Mesh(mesh) => mesh.blocks(ray, far),
        }
    }

    /// The surface where a ray met the shape.
    pub fn patch(&self, ray: &Ray, near: &Near) -> Patch {
        match self {
            Self::Plane => {
                let position = ray.at(near.t).with_z(0.0);
                Patch {
                    position,
                    geometric: DVec3::Z,
                    normal: DVec3::Z,
                    uv: [0.5 * (position.x + 1.0), 0.5 * (position.y + 1.0)],
                    du: 2.0 * DVec3::X,
                    dv: 2.0 * DVec3::Y,
                }
            }
            Self::Sphere => on_sphere(ray.at(near.t)),
            Self::Mesh(mesh) => mesh.patch(near),
        }
    }
}

/// Both distances at which a line meets the unit sphere, in rising order.
fn sphere(ray: &Ray) -> Option<[f64; 2]> {
    let Ray { origin, direction } = ray;
    // Around the point of the line that is nearest to the centre, little is lost however far the ray comes from.
    let squared = direction.length_squared();
    let middle = -origin.dot(*direction) / squared;
    let apart = 1.0 - ray.at(middle).length_squared();
    if apart < 0.0 {
        return None;
    }
    let half = (apart / squared).sqrt();
    Some([middle - half, middle + half])
}

/// The surface of the unit sphere in a direction. Texture coordinates are degenerate at the poles, where the directions of
/// u and v are taken from the azimuth 0.
fn on_sphere(position: DVec3) -> Patch {
    let position = position.normalize_or(DVec3::Z);
    let sin_theta = position.x.hypot(position.y);
    let [cos_phi, sin_phi] =
        if sin_theta > 0.0 { [position.x / sin_theta, position.y / sin_theta] } else { [1.0, 0.0] };
    let u = sin_phi.atan2(cos_phi) / TAU;
    Patch {
        position,
        geometric: position,
        normal: position,
        uv: [if u < 0.0 { u + 1.0 } else { u }, sin_theta.atan2(position.z) / PI],
        // A pole's own direction of u: long enough to have one.
        du: TAU * sin_theta.max(POLE) * DVec3::new(-sin_phi, cos_phi, 0.0),
        dv: PI * DVec3::new(position.z * cos_phi, position.z * sin_phi, -sin_theta),
    }
}

/// Sine of the angle to a pole within which u has the length that it has there.
const POLE: f64 = 1e-9;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Random, Stream};

    /// Central differences over 1e-5 of smooth functions: 1e-10 of truncation and 1e-11 of rounding, with room.
    const DIFFERENCE: f64 = 1e-8;

    fn point(u: f64, v: f64) -> DVec3 {
        let ((sin_phi, cos_phi), (sin, cos)) = ((TAU * u).sin_cos(), (PI * v).sin_cos());
        DVec3::new(sin * cos_phi, sin * sin_phi, cos)
    }

    #[test]
    fn a_sphere_has_the_uv_of_its_points_and_their_derivatives() {
        let mut random = Random::new(1, Stream::Probe, 0);
        for _ in 0..100 {
            let uv = [random.uniform_f64(), 0.05 + 0.9 * random.uniform_f64()];
            let patch = on_sphere(point(uv[0], uv[1]));
            for c in 0..2 {
                assert!((patch.uv[c] - uv[c]).abs() < DIFFERENCE, "{uv:?} {:?}", patch.uv);
                let step = [0.0, 1.0].map(|k| if k as usize == c { 1e-5 } else { 0.0 });
                let ahead = point(uv[0] + step[0], uv[1] + step[1]);
                let behind = point(uv[0] - step[0], uv[1] - step[1]);
                let slope = (ahead - behind) / 2e-5;
                let exact = [patch.du, patch.dv][c];
                assert!((slope - exact).length() < DIFFERENCE, "{uv:?} {slope} {exact}");
                assert!((slope - 1.001 * exact).length() > DIFFERENCE);
            }
            // u, v and the outward normal are a left-handed frame: the contract's mirrored one.
            assert!(patch.du.cross(patch.dv).dot(patch.normal) < 0.0);
        }
    }

    #[test]
    fn rays_meet_shapes_from_either_side() {
        let ray = |origin: [f64; 3], direction: [f64; 3]| Ray {
            origin: origin.into(),
            direction: direction.into(),
        };
        let t = |shape: &Shape, ray: &Ray| shape.nearest(ray, f64::INFINITY).map(|near| near.t);
        assert_eq!(t(&Shape::Sphere, &ray([0.0, 0.0, 3.0], [0.0, 0.0, -2.0])), Some(1.0));
        assert_eq!(t(&Shape::Sphere, &ray([0.0; 3], [0.0, 0.5, 0.0])), Some(2.0));
        assert_eq!(t(&Shape::Sphere, &ray([0.0, 0.0, 3.0], [0.0, 0.0, 1.0])), None);
        assert_eq!(t(&Shape::Sphere, &ray([1.1, 0.0, 3.0], [0.0, 0.0, -1.0])), None);
        assert_eq!(t(&Shape::Plane, &ray([0.9, -0.9, -2.0], [0.0, 0.0, 1.0])), Some(2.0));
        assert_eq!(t(&Shape::Plane, &ray([1.1, 0.0, -2.0], [0.0, 0.0, 1.0])), None);
        assert_eq!(t(&Shape::Plane, &ray([0.0, 0.0, 1.0], [1.0, 0.0, 0.0])), None);
        assert!(Shape::Sphere.nearest(&ray([0.0, 0.0, 3.0], [0.0, 0.0, -2.0]), 0.9).is_none());
    }
}
