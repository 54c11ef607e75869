//! Perspective pictures of a tiled plane as query buffers: NeuMIP's evaluation scenes.
//!
//! The plane is z = 0, its square \[-1, 1\]^2 holds `tiles` x `tiles` tiles and goes on for ever. The camera
//! looks at the origin, from distance 2.3, tilted 45 degrees from the normal towards -y, where nothing else is said;
//! field of view 45 degrees, square pixels.

use crate::{
    error::{Error, Result},
    query::QueryBuffer,
};
use std::{borrow::Cow, f64::consts::FRAC_PI_4};

/// Full field of view.
const FIELD_OF_VIEW: f64 = FRAC_PI_4;

/// Where a camera stands that looks at the origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Angle from the normal towards -y, degrees.
    pub tilt: f64,
    /// Distance from the origin.
    pub distance: f64,
}

impl Camera {
    /// NeuMIP's.
    pub const NEUMIP: Self = Self { tilt: 45.0, distance: 2.3 };
}

/// A scene: a light over the plane, and a camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// Name: NeuMIP's where the light is, `light-TILT-PAN` elsewhere, with a p for the point of a fraction.
    pub name: Cow<'static, str>,
    /// Angle of the light from the normal, degrees.
    pub tilt: f64,
    /// Azimuth of the light from x towards y, degrees.
    pub pan: f64,
    /// The camera.
    pub camera: Camera,
}

/// NeuMIP's: light along the normal, and light tilted by 45 and panned by 30 degrees.
pub const SCENES: [Scene; 2] = [
    Scene { name: Cow::Borrowed("s2"), tilt: 0.0, pan: 0.0, camera: Camera::NEUMIP },
    Scene { name: Cow::Borrowed("s4"), tilt: 45.0, pan: 30.0, camera: Camera::NEUMIP },
];

/// The scenes of lights \[tilt, pan\] in degrees.
pub(crate) fn scenes(lights: &[[f32; 2]]) -> Result<Vec<Scene>> {
    let mut all: Vec<Scene> = Vec::with_capacity(lights.len());
    for (k, [tilt, pan]) in lights.iter().enumerate() {
        let wrong = |problem: String| Error::config(format!("lights[{k}]"), problem);
        if !(0.0..90.0).contains(tilt) || !(0.0..=360.0).contains(pan) {
            let problem = "tilt is from 0 to below 90 degrees, pan from 0 to 360";
            return Err(wrong(format!("is tilted by {tilt} and panned by {pan}: {problem}")));
        }
        let scene = Scene::new(f64::from(*tilt), f64::from(*pan));
        if all.iter().any(|other| other.name == scene.name) {
            return Err(wrong(format!("is there twice: {}", scene.name)));
        }
        all.push(scene);
    }
    Ok(all)
}

impl Scene {
    /// The scene of a light under NeuMIP's camera.
    pub fn new(tilt: f64, pan: f64) -> Self {
        let known = SCENES.into_iter().find(|scene| scene.tilt == tilt && scene.pan == pan);
        known.unwrap_or_else(|| {
            // Names are lower-case letters, digits and dashes.
            let name = format!("light-{tilt}-{pan}").replace('.', "p");
            Self { name: Cow::Owned(name), tilt, pan, camera: Camera::NEUMIP }
        })
    }

    /// The queries of a picture of `size` x `size` pixels of a tile with \[H, W\] texels.
    ///
    /// A pixel's level is log2 of the square root of its footprint's area in texels, from 0 to the tile's
    /// coarsest. A pixel that misses the plane looks from below the horizon, where the answer is 0.
    pub fn queries(&self, size: usize, tiles: usize, resolution: [usize; 2]) -> QueryBuffer {
        let Camera { tilt, distance } = self.camera;
        let (sin, cos) = tilt.to_radians().sin_cos();
        let eye = [0.0, -distance * sin, distance * cos];
        let (forward, right, up) = ([0.0, sin, -cos], [1.0, 0.0, 0.0], [0.0, cos, sin]);
        let half = (0.5 * FIELD_OF_VIEW).tan();
        let pitch = 2.0 * half / size as f64;
        let texels = [resolution[1], resolution[0]].map(|n| 0.5 * (tiles * n) as f64);
        let coarsest = f64::from(resolution[0].min(resolution[1]).max(2).ilog2() - 1);
        let (tilt, pan) = (self.tilt.to_radians(), self.pan.to_radians());
        let wi = [tilt.sin() * pan.cos(), tilt.sin() * pan.sin()].map(|v| v as f32);

        let mut queries = QueryBuffer::slice(size, size, wi, [2.0, 0.0], 0.0);
        for k in 0..size * size {
            let x = ((k % size) as f64 + 0.5) * pitch - half;
            let y = half - ((k / size) as f64 + 0.5) * pitch;
            let ray: [f64; 3] = std::array::from_fn(|c| forward[c] + x * right[c] + y * up[c]);
            if ray[2] >= 0.0 {
                continue;
            }
            let t = -eye[2] / ray[2];
            let hit = [0, 1].map(|c| eye[c] + t * ray[c]);
            queries.u[k] = hit.map(|p| super::block::wrap(0.5 * (p + 1.0) * tiles as f64));
            let length = ray.iter().map(|v| v * v).sum::<f64>().sqrt();
            queries.wo[k] = [0, 1].map(|c| (-ray[c] / length) as f32);

            // Move the ray by a pixel to the right and up; the hit stays on the plane.
            let moved = |axis: [f64; 3]| {
                [0, 1].map(|c| pitch * t * (axis[c] - ray[c] * axis[2] / ray[2]) * texels[c])
            };
            let (a, b) = (moved(right), moved(up));
            let area = (a[0] * b[1] - a[1] * b[0]).abs();
            queries.level[k] = (0.5 * area.log2()).clamp(0.0, coarsest) as f32;
        }
        queries
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lights_have_names() {
        let lights = [[0.0, 0.0], [45.0, 30.0], [60.0, 210.0], [22.5, 0.0], [45.0, 0.0]];
        let names: Vec<_> = scenes(&lights).unwrap().into_iter().map(|scene| scene.name).collect();
        assert_eq!(names, ["s2", "s4", "light-60-210", "light-22p5-0", "light-45-0"]);
        for wrong in [[90.0, 0.0], [-1.0, 0.0], [f32::NAN, 0.0], [0.0, 361.0], [45.0, 30.0]] {
            let error = scenes(&[[45.0, 30.0], wrong]).unwrap_err().to_string();
            assert!(error.starts_with("lights[1]"), "{error}");
        }
    }

    #[test]
    fn a_camera_stands_where_it_is_put() {
        // Exactly: the views of older datasets must come out again.
        assert_eq!(Camera::NEUMIP.tilt.to_radians(), FRAC_PI_4);
        let above = Scene { camera: Camera { tilt: 0.0, distance: 1.0 }, ..SCENES[0].clone() };
        let queries = above.queries(129, 1, [512, 512]);
        let (middle, top) = (64 * 129 + 64, 64);
        assert!(queries.wo[middle].iter().all(|v| v.abs() < 1e-6));
        // Half a pixel inside the edge of a field of 22.5 degrees to each side, at distance 1.
        let edge = 0.5 + 0.5 * (0.5 * FIELD_OF_VIEW).tan() * 128.0 / 129.0;
        assert!((f64::from(queries.u[top][1]) - edge).abs() < 1e-6, "{}", queries.u[top][1]);
    }

    /// Half a pixel at the picture's centre, where the ray is not exactly the axis.
    const HALF_PIXEL: f32 = 0.01;

    #[test]
    fn the_centre_sees_the_middle_of_the_square() {
        let queries = SCENES[1].queries(128, 1, [512, 512]);
        let k = 64 * 128 + 64;
        assert!((queries.u[k][0] - 0.5).abs() < HALF_PIXEL && (queries.u[k][1] - 0.5).abs() < HALF_PIXEL);
        let wo = queries.wo[k];
        assert!(wo[0].abs() < HALF_PIXEL && (wo[1] + 0.5f32.sqrt()).abs() < HALF_PIXEL);
        assert!((queries.u[0][0] - 0.5).abs() > HALF_PIXEL);
    }

    #[test]
    fn a_footprint_is_the_distance_of_neighbouring_hits() {
        let resolution = [512, 512];
        let queries = SCENES[0].queries(256, 1, resolution);
        let k = 100 * 256 + 90;
        let apart = |a: usize, b: usize| {
            let d = [0, 1].map(|c| f64::from(queries.u[b][c] - queries.u[a][c]) * 512.0);
            (d[0], d[1])
        };
        let (right, down) = (apart(k, k + 1), apart(k, k + 256));
        let level = 0.5 * (right.0 * down.1 - right.1 * down.0).abs().log2();
        // Neighbouring hits are finite differences of a perspective map; a pixel changes the area by under 1
        // %.
        const FINITE: f64 = 0.02;
        assert!((f64::from(queries.level[k]) - level).abs() < FINITE);
        assert!((f64::from(queries.level[k]) + 0.05 - level).abs() > FINITE);
    }
}
