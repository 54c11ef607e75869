//! Lights that samplers are measured under.

use crate::random::Random;
use std::f32::consts::TAU;

/// Radiance from all directions of a world whose z points up.
#[derive(Clone, Copy, Debug)]
pub struct Light {
    /// Its name.
    pub name: &'static str,
    /// Radiance from a direction.
    pub radiance: fn([f32; 3]) -> f32,
    /// Cones around what is bright: axes, and cosines of their radii. Measuring draws directions in them.
    pub bright: &'static [([f32; 3], f32)],
}

/// The same from everywhere.
pub const FURNACE: Light = Light { name: "furnace", radiance: |_| 1.0, bright: &[] };

/// A sky that darkens towards the zenith over dim ground, a sun 40 degrees above the horizon that gives as much light as the
/// sky, and a bright window opposite.
pub const SKY: Light = Light { name: "sky", radiance: sky, bright: &[SUN, WINDOW] };

/// 3 degrees in radius: of the true size only the sun's own highlights would count.
const SUN: ([f32; 3], f32) = ([0.766_044_4, 0.0, 0.642_787_6], 0.998_629_5);
/// 25 degrees in radius: all of the window.
const WINDOW: ([f32; 3], f32) = ([-0.887_010_8, 0.0, 0.461_748_6], 0.906_307_8);

fn sky(w: [f32; 3]) -> f32 {
    let [x, y, z] = w;
    if dot(w, SUN.0) > SUN.1 {
        return 250.0;
    }
    // As wide as high, seen from the middle of a room.
    let window = x < 0.0 && y.abs() < -0.2 * x && z > -0.25 * x && z < -0.8 * x;
    match (window, z > 0.0) {
        (true, _) => 12.0,
        (_, true) => 1.0 - 0.6 * z,
        _ => 0.2,
    }
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Two unit vectors that with `n` make a right-handed frame (Duff et al. 2017).
fn around(n: [f32; 3]) -> [[f32; 3]; 2] {
    let sign = 1f32.copysign(n[2]);
    let a = -1.0 / (sign + n[2]);
    let b = n[0] * n[1] * a;
    [[1.0 + sign * n[0] * n[0] * a, sign * b, -sign * n[0]], [b, sign + n[1] * n[1] * a, -n[1]]]
}

/// A light over a surface that lies in its world in some way.
#[derive(Clone, Copy, Debug)]
pub(super) struct Turned<'a> {
    light: &'a Light,
    /// The surface's x, y and normal in the world.
    frame: [[f32; 3]; 3],
}

impl<'a> Turned<'a> {
    /// A light over a surface with any normal.
    pub fn new(light: &'a Light, random: &mut Random) -> Self {
        let z = 2.0 * random.uniform() - 1.0;
        let radius = (1.0 - z * z).max(0.0).sqrt();
        let (sin, cos) = (TAU * random.uniform()).sin_cos();
        let normal = [radius * cos, radius * sin, z];
        let [x, y] = around(normal);
        let (sin, cos) = (TAU * random.uniform()).sin_cos();
        let mix = |p: f32, q: f32| std::array::from_fn(|i| p * x[i] + q * y[i]);
        Self { light, frame: [mix(cos, sin), mix(-sin, cos), normal] }
    }

    /// A light over a surface that lies level.
    #[cfg(test)]
    pub fn level(light: &'a Light) -> Self {
        Self { light, frame: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] }
    }

    fn world(&self, w: [f32; 3]) -> [f32; 3] {
        std::array::from_fn(|i| (0..3).map(|axis| self.frame[axis][i] * w[axis]).sum())
    }

    /// Radiance from a direction of the surface's frame.
    pub fn radiance(&self, wi: [f32; 3]) -> f32 {
        (self.light.radiance)(self.world(wi))
    }

    /// Number of bright cones.
    pub fn cones(&self) -> usize {
        self.light.bright.len()
    }

    /// A direction of the surface's frame, uniform in a bright cone.
    pub fn towards(&self, cone: usize, xi: [f32; 2]) -> [f32; 3] {
        let (axis, edge) = self.light.bright[cone];
        let z = 1.0 - xi[0] * (1.0 - edge);
        let radius = (1.0 - z * z).max(0.0).sqrt();
        let (sin, cos) = (TAU * xi[1]).sin_cos();
        let [x, y] = around(axis);
        let w = std::array::from_fn(|i| radius * (cos * x[i] + sin * y[i]) + z * axis[i]);
        self.frame.map(|axis| dot(axis, w))
    }

    /// Sum over the bright cones of the densities of [`Turned::towards`].
    pub fn density(&self, wi: [f32; 3]) -> f64 {
        let w = self.world(wi);
        let hit = self.light.bright.iter().filter(|(axis, edge)| dot(*axis, w) >= *edge);
        hit.map(|(_, edge)| 1.0 / (std::f64::consts::TAU * f64::from(1.0 - edge))).sum()
    }
}
