//! A clear sky with a sun, painted as an environment.

use super::environment::Environment;
use super::format::{Rgb, SkySpec};
use glam::DVec3;
use std::f64::consts::{PI, TAU};

/// Size of the picture: the smallest sun covers two texels.
const WIDTH: usize = 1024;
const HEIGHT: usize = 512;
/// How steeply the sky fades from the horizon.
const FADE: f64 = 0.4;
/// Points along a side of a texel at which the sun is looked at.
const POINTS: usize = 4;

/// Paints a checked sky.
pub fn paint(spec: &SkySpec) -> Environment {
    let sun = DVec3::from(spec.sun).normalize_or(DVec3::Z);
    let limb = spec.sun_radius.to_radians().cos();
    // A texel is less than half a degree across.
    let around = (spec.sun_radius + 0.5).to_radians().cos();
    let mut discs = vec![0.0f64; WIDTH * HEIGHT];
    let (mut facing, mut texels) = (0.0, Vec::with_capacity(WIDTH * HEIGHT));
    for row in 0..HEIGHT {
        let border = |row: usize| (PI * row as f64 / HEIGHT as f64).cos();
        let solid_angle = (border(row) - border(row + 1)) * TAU / WIDTH as f64;
        for column in 0..WIDTH {
            let at = |x: f64, y: f64| {
                let (turn, down) =
                    (TAU * (column as f64 + x) / WIDTH as f64, PI * (row as f64 + y) / HEIGHT as f64);
                DVec3::new(down.sin() * turn.sin(), down.sin() * turn.cos(), down.cos())
            };
            texels.push(background(spec, at(0.5, 0.5)));
            // Brightest in the middle and 0 at the limb, so that the sun has no hard edge.
            let near = at(0.5, 0.5).dot(sun) > around;
            let disc: f64 = (0..if near { POINTS * POINTS } else { 0 })
                .map(|k| {
                    let point = [k % POINTS, k / POINTS].map(|i| (i as f64 + 0.5) / POINTS as f64);
                    ((at(point[0], point[1]).dot(sun) - limb) / (1.0 - limb)).max(0.0)
                })
                .sum();
            discs[row * WIDTH + column] = disc;
            facing += disc * solid_angle * at(0.5, 0.5).dot(sun).max(0.0);
        }
    }
    // A plane that faces the sun gets what was asked for.
    let Rgb(irradiance) = spec.sun_irradiance;
    for (texel, disc) in texels.iter_mut().zip(&discs) {
        if *disc > 0.0 && facing > 0.0 {
            (0..3).for_each(|c| texel[c] += (f64::from(irradiance[c]) * disc / facing) as f32);
        }
    }
    Environment::new(WIDTH, HEIGHT, texels)
}

fn background(spec: &SkySpec, direction: DVec3) -> [f32; 3] {
    if direction.z < 0.0 {
        return spec.ground.0;
    }
    let up = direction.z.powf(FADE) as f32;
    std::array::from_fn(|c| spec.horizon.0[c] + up * (spec.zenith.0[c] - spec.horizon.0[c]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Random, Stream};

    #[test]
    fn the_sun_gives_the_irradiance_that_was_asked_for() {
        let black = Rgb([0.0; 3]);
        let spec = SkySpec { zenith: black, horizon: black, ground: black, ..SkySpec::default() };
        let sky = paint(&spec);
        let sun = DVec3::from(spec.sun).normalize();
        let mut random = Random::new(1, Stream::Probe, 0);
        let n = 20_000;
        let mut irradiance = [0.0f64; 3];
        for _ in 0..n {
            let (direction, radiance, pdf) = sky.sample([random.uniform_f64(), random.uniform_f64()]);
            (0..3)
                .for_each(|c| irradiance[c] += f64::from(radiance[c]) * direction.dot(sun) / pdf / n as f64);
        }
        // The density follows the neighbours' luminance too: the estimate varies by less than half its size.
        const NOISE: f64 = 0.02;
        for (found, asked) in irradiance.into_iter().zip(spec.sun_irradiance.0) {
            let ratio = found / f64::from(asked);
            assert!((ratio - 1.0).abs() < NOISE, "{ratio}");
            assert!((ratio - 1.05).abs() > NOISE);
        }
    }
}
