//! Wrapped Gaussian smoothing of a texture \[height, width, channels\].
//!
//! The kernel is even and the grid is periodic, so the operator is symmetric: it is its own adjoint.

use rayon::prelude::*;

/// Where the Gaussian is cut off, in sigmas: what is left out weighs 6e-5.
const CUTOFF: f64 = 4.0;

/// Non-zero (offset, weight) pairs of the Gaussian folded onto a ring of `n` texels; the weights sum to 1.
pub fn ring(sigma: f64, n: usize) -> Vec<(usize, f32)> {
    let radius = (CUTOFF * sigma).ceil() as i64;
    let mut folded = vec![0.0f64; n];
    for d in -radius..=radius {
        folded[d.rem_euclid(n as i64) as usize] += (-0.5 * (d as f64 / sigma).powi(2)).exp();
    }
    let total: f64 = folded.iter().sum();
    folded
        .iter()
        .enumerate()
        .filter(|(_, w)| **w > 0.0)
        .map(|(offset, w)| (offset, (w / total) as f32))
        .collect()
}

/// `texture` smoothed with a Gaussian of `sigma` texels. Every output is summed in one fixed order, whatever the threads.
pub fn smooth(texture: &[f32], height: usize, width: usize, channels: usize, sigma: f64) -> Vec<f32> {
    let row = width * channels;
    let mut across = vec![0.0f32; texture.len()];
    let columns = ring(sigma, width);
    across.par_chunks_mut(row).zip(texture.par_chunks(row)).for_each(|(out, source)| {
        for &(offset, weight) in &columns {
            let (wrapped, straight) = source.split_at(offset * channels);
            add_scaled(&mut out[..straight.len()], straight, weight);
            add_scaled(&mut out[straight.len()..], wrapped, weight);
        }
    });
    let mut down = vec![0.0f32; texture.len()];
    let rows = ring(sigma, height);
    down.par_chunks_mut(row).enumerate().for_each(|(i, out)| {
        for &(offset, weight) in &rows {
            let source = (i + offset) % height * row;
            add_scaled(out, &across[source..source + row], weight);
        }
    });
    down
}

fn add_scaled(out: &mut [f32], source: &[f32], weight: f32) {
    for (o, s) in out.iter_mut().zip(source) {
        *o += weight * s;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Random, Stream};

    /// Sums of a hundred terms of size 1 in f32.
    const ROUNDING: f64 = 2e-6;

    fn noise(n: usize) -> Vec<f32> {
        let mut random = Random::new(3, Stream::Probe, 0);
        (0..n).map(|_| random.normal()).collect()
    }

    /// Direct two-dimensional sum in float64 over every wrapped texel.
    fn direct(x: &[f32], h: usize, w: usize, c: usize, sigma: f64) -> Vec<f64> {
        let (rows, columns) = (ring(sigma, h), ring(sigma, w));
        let mut out = vec![0.0; x.len()];
        for i in 0..h {
            for j in 0..w {
                for k in 0..c {
                    for &(di, wi) in &rows {
                        for &(dj, wj) in &columns {
                            let source = (((i + di) % h) * w + (j + dj) % w) * c + k;
                            out[(i * w + j) * c + k] += f64::from(wi) * f64::from(wj) * f64::from(x[source]);
                        }
                    }
                }
            }
        }
        out
    }

    fn worst(a: &[f32], b: &[f64]) -> f64 {
        a.iter().zip(b).map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn agrees_with_the_direct_sum_and_notices_one_changed_texel() {
        let (h, w, c) = (9, 12, 3);
        let mut x = noise(h * w * c);
        for sigma in [0.3, 1.0, 8.0] {
            let expected = direct(&x, h, w, c, sigma);
            assert!(worst(&smooth(&x, h, w, c, sigma), &expected) < ROUNDING);
        }
        let expected = direct(&x, h, w, c, 1.0);
        x[17] += 1e-3;
        assert!(worst(&smooth(&x, h, w, c, 1.0), &expected) > ROUNDING);
    }

    #[test]
    fn is_its_own_adjoint() {
        let (h, w, c) = (8, 6, 2);
        let (x, y) = (noise(h * w * c), noise(2 * h * w * c)[h * w * c..].to_vec());
        let dot =
            |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
        let (left, right) = (dot(&smooth(&x, h, w, c, 1.3), &y), dot(&x, &smooth(&y, h, w, c, 1.3)));
        assert!((left - right).abs() < ROUNDING * 10.0, "{left} {right}");
        assert!((left - dot(&smooth(&x, h, w, c, 1.4), &y)).abs() > ROUNDING * 10.0);
    }
}
