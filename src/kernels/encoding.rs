//! Input encoding gamma (improved NeuMIP, section 3.1), by double angles with exact restarts.
//!
//! For bands k = 0..L in order: the sines of all components, then their cosines, at frequency 2^k pi (or 2^k).
//! sin(2a) = 2 sin a cos a and cos(2a) = 1 - 2 sin^2 a double the angle; every [`RESTART`] octaves the angle is reduced
//! exactly (2^k p is exact in binary) and the sine is taken anew.

/// Octaves between restarts: three doublings keep the drift under [`DRIFT`].
pub const RESTART: usize = 4;

/// Largest difference from float64, for any p in \[-1, 1\]: each doubling at most doubles an error of about 1e-7 and
/// rounds once more.
pub const DRIFT: f32 = 2e-6;

/// Appends the encoding of `p` to `out`; `factor(k, component)` multiplies both the sine and the cosine.
pub fn encode<const D: usize>(
    out: &mut Vec<f32>,
    p: [f32; D],
    bands: usize,
    pi: bool,
    factor: impl Fn(usize, usize) -> f32,
) {
    let (mut sin, mut cos) = ([0.0f32; D], [0.0f32; D]);
    for band in 0..bands {
        for d in 0..D {
            if band % RESTART == 0 {
                let t = p[d] * (1u32 << band) as f32;
                let angle = if pi { std::f32::consts::PI * (t - 2.0 * ((t + 1.0) * 0.5).floor()) } else { t };
                (sin[d], cos[d]) = angle.sin_cos();
            } else {
                (sin[d], cos[d]) = (2.0 * sin[d] * cos[d], 1.0 - 2.0 * sin[d] * sin[d]);
            }
        }
        out.extend((0..D).map(|d| sin[d] * factor(band, d)));
        out.extend((0..D).map(|d| cos[d] * factor(band, d)));
    }
}

/// Attenuation of band `band` for a footprint whose standard deviation is `sigma` in units of p:
/// exp(-(frequency sigma)^2 / 2), the mean of a wave under a Gaussian (mip-NeRF, equation 13).
pub fn attenuation(band: usize, pi: bool, sigma: f32) -> f32 {
    let frequency = (1u32 << band) as f32 * if pi { std::f32::consts::PI } else { 1.0 };
    let x = frequency * sigma;
    (-0.5 * x * x).exp()
}

/// Standard deviation, in units of p = 2u - 1, of the box footprint of a level on a side of `texels`.
pub fn footprint_sigma(level: f32, texels: usize) -> f32 {
    level.exp2() * 2.0 / texels as f32 / 12f32.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn worst(perturb: f32) -> f32 {
        let mut worst = 0.0f32;
        for i in 0..2001 {
            let p = (i as f32 - 1000.0) / 1000.0;
            let mut out = Vec::new();
            encode(&mut out, [p + perturb], 10, true, |_, _| 1.0);
            for (k, pair) in out.chunks(2).enumerate() {
                let angle = f64::from(1 << k) * std::f64::consts::PI * f64::from(p);
                worst = worst.max((f64::from(pair[0]) - angle.sin()).abs() as f32);
                worst = worst.max((f64::from(pair[1]) - angle.cos()).abs() as f32);
            }
        }
        worst
    }

    #[test]
    fn ten_octaves_agree_with_float64() {
        assert!(worst(0.0) < DRIFT, "{}", worst(0.0));
    }

    #[test]
    fn a_shifted_position_is_noticed() {
        assert!(worst(1e-6) > DRIFT);
    }

    #[test]
    fn order_is_sines_then_cosines_a_band() {
        let mut out = Vec::new();
        encode(&mut out, [0.5, 0.0], 1, true, |_, _| 1.0);
        let expected = [1.0, 0.0, 0.0, 1.0];
        assert!(out.iter().zip(expected).all(|(a, b): (&f32, f32)| (a - b).abs() < DRIFT));
    }

    #[test]
    fn attenuation_is_the_mean_over_a_gaussian() {
        let (sigma, band) = (0.07f32, 2);
        let frequency = 4.0 * std::f64::consts::PI;
        let (mut sum, mut weight) = (0.0, 0.0);
        for i in -4000..=4000 {
            let x = f64::from(i) / 4000.0 * 6.0 * f64::from(sigma);
            let w = (-0.5 * (x / f64::from(sigma)).powi(2)).exp();
            sum += w * (frequency * x).cos();
            weight += w;
        }
        assert!((sum / weight - f64::from(attenuation(band, true, sigma))).abs() < 1e-6);
    }
}
