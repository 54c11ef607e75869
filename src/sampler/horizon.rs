//! Directions near the horizon. Displaced surfaces answer light that grazes the plane, where every lobe's density falls like z:
//! terms (answer / density)^2 grow like 1 / z^2, and the few that are met would decide every mean. Drawn by a density that
//! grows like 1 / z they are all alike.

use std::f32::consts::TAU;

/// Lowest z: two 32-bit floats (x, y) tell no lower one from 0.
pub(super) const LOWEST: f32 = 4e-4;

/// A unit vector, uniform in azimuth and in the logarithm of z.
pub(super) fn sample(xi: [f32; 2]) -> [f32; 3] {
    let z = LOWEST.powf(xi[0]);
    let radius = (1.0 - z * z).max(0.0).sqrt();
    let (sin, cos) = (TAU * xi[1]).sin_cos();
    [radius * cos, radius * sin, z]
}

/// Its density over solid angle.
pub(super) fn density(wi: [f32; 3]) -> f32 {
    // The lowest of all may have been rounded.
    if wi[2] >= 0.999 * LOWEST { 1.0 / (-TAU * LOWEST.ln() * wi[2]) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Random, Stream};

    /// Four standard errors of a mean of 40,000 shares.
    const NOISE: f64 = 0.01;

    #[test]
    fn samples_have_the_density_that_is_told() {
        let mut random = Random::new(1, Stream::Probe, 0);
        let n = 40_000;
        // The mean of solid angle over density is the solid angle: here of what is below z = 0.1, and above.
        let mut areas = [0.0f64; 2];
        for _ in 0..n {
            let wi = sample([random.uniform(), random.uniform()]);
            areas[usize::from(wi[2] > 0.1)] += 1.0 / f64::from(density(wi)) / f64::from(n);
        }
        let told = [0.1 - f64::from(LOWEST), 0.9].map(|height| height * f64::from(TAU));
        for (area, told) in areas.iter().zip(told) {
            let off = (area / told - 1.0).abs();
            assert!(off < 2.0 * NOISE && (1.05 * area / told - 1.0).abs() > 2.0 * NOISE, "{area} and {told}");
        }
    }
}
