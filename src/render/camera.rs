//! The camera: rays through pixels, and how large a pixel is on what they meet.

use super::format::CameraSpec;
use super::shape::Ray;
use glam::{DMat3, DVec3};

/// Cosine of the angle to z within which a camera without a stated up takes y for it.
const ALONG_Z: f64 = 1.0 - 1e-9;

/// A camera at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    origin: DVec3,
    /// Columns: right, up, forward.
    axes: DMat3,
    width: usize,
    height: usize,
    /// Side of a pixel at distance 1.
    pitch: f64,
}

impl Camera {
    /// The camera of a checked spec.
    pub fn new(spec: &CameraSpec) -> Self {
        let origin = DVec3::from(spec.origin);
        let forward = (DVec3::from(spec.target) - origin).normalize_or(-DVec3::Z);
        let up = match spec.up {
            Some(up) => DVec3::from(up),
            None if forward.z.abs() < ALONG_Z => DVec3::Z,
            None => DVec3::Y,
        };
        let right = forward.cross(up).normalize_or(DVec3::X);
        let (width, height) = (spec.width, spec.height.unwrap_or(spec.width));
        Self {
            origin,
            axes: DMat3::from_cols(right, right.cross(forward), forward),
            width,
            height,
            pitch: 2.0 * (0.5 * spec.fov.to_radians()).tan() / width as f64,
        }
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// The ray through a point of the picture in pixels, x to the right and y down. Its direction has length 1 along the
    /// camera's axis, so that distances are depths.
    pub fn ray(&self, x: f64, y: f64) -> Ray {
        let x = (x - 0.5 * self.width as f64) * self.pitch;
        let y = (0.5 * self.height as f64 - y) * self.pitch;
        Ray { origin: self.origin, direction: self.axes * DVec3::new(x, y, 1.0) }
    }

    /// Area of a pixel's footprint on the plane that touches a surface: of the parallelogram that its sides cast on it along
    /// [`Camera::ray`] to distance `t`. Infinite at grazing angles.
    pub fn footprint(&self, ray: &Ray, t: f64, normal: DVec3) -> f64 {
        (self.pitch * t).powi(2) / normal.dot(ray.direction).abs()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_picture_is_as_wide_as_the_field_of_view() {
        let spec = CameraSpec { fov: 90.0, width: 200, height: Some(100), ..CameraSpec::default() };
        let camera = Camera::new(&spec);
        let middle = camera.ray(100.0, 50.0);
        assert!((middle.at(2.3)).length() < 1e-12);
        let angle = |x, y| camera.ray(x, y).direction.angle_between(middle.direction).to_degrees();
        assert!((angle(0.0, 50.0) - 45.0).abs() < 1e-9 && (angle(200.0, 50.0) - 45.0).abs() < 1e-9);
        assert!((angle(100.0, 0.0) - 0.5f64.atan().to_degrees()).abs() < 1e-9);
        // Right is +x and up is away for a camera that stands at -y.
        assert!(
            camera.ray(200.0, 50.0).direction.x > 0.0
                && camera.ray(100.0, 0.0).direction.z > middle.direction.z
        );
    }

    #[test]
    fn looking_along_z_needs_no_up() {
        for z in [-3.0, 3.0] {
            let spec = CameraSpec { origin: [0.0, 0.0, z], ..CameraSpec::default() };
            let top = Camera::new(&spec).ray(256.0, 0.0);
            assert!(top.direction.y > 0.1 && top.direction.x.abs() < 1e-12);
        }
    }
}
