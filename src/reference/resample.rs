//! Maps of any shape brought to a square with a power of two a side.

use super::heightfield::SIDES;

/// The power of two nearest to the larger side (by ratio), within the sides that work.
pub fn nearest_side(width: usize, height: usize) -> usize {
    let exponent = (width.max(height) as f64).log2().round() as u32;
    (1_usize << exponent).clamp(*SIDES.start(), *SIDES.end())
}

/// Resamples rows of texels to `side` x `side`, each axis on its own and wrapping: an axis that shrinks averages the
/// texels that a new one covers, by area; an axis that grows is read linearly between texel centres.
pub fn resample<const N: usize>(
    texels: &[[f32; N]],
    width: usize,
    height: usize,
    side: usize,
) -> Vec<[f32; N]> {
    let across = weights(width, side);
    let down = weights(height, side);
    let rows: Vec<[f32; N]> =
        texels.chunks(width).flat_map(|row| across.iter().map(|taps| gather(taps, |k| row[k]))).collect();
    (0..side * side).map(|at| gather(&down[at / side], |k| rows[k * side + at % side])).collect()
}

type Taps = Vec<(usize, f64)>;

/// For each new texel of an axis, the old ones it is made of; their weights add up to 1.
fn weights(old: usize, new: usize) -> Vec<Taps> {
    let scale = old as f64 / new as f64;
    (0..new)
        .map(|k| {
            if old > new {
                let (start, end) = (k as f64 * scale, (k + 1) as f64 * scale);
                let first = start as usize;
                (first..old.min(end.ceil() as usize))
                    .map(|t| (t, (end.min((t + 1) as f64) - start.max(t as f64)) / scale))
                    .collect()
            } else {
                let place = (k as f64 + 0.5) * scale - 0.5;
                let share = place - place.floor();
                let at = |offset: f64| (place.floor() + offset).rem_euclid(old as f64) as usize;
                vec![(at(0.0), 1.0 - share), (at(1.0), share)]
            }
        })
        .collect()
}

fn gather<const N: usize>(taps: &Taps, texel: impl Fn(usize) -> [f32; N]) -> [f32; N] {
    let mut sum = [0.0; N];
    for &(k, weight) in taps {
        let value = texel(k);
        for c in 0..N {
            sum[c] += weight * f64::from(value[c]);
        }
    }
    sum.map(|s| s as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sides_go_to_the_nearest_power_of_two() {
        assert_eq!(nearest_side(640, 480), 512);
        assert_eq!(nearest_side(300, 800), 1024);
        assert_eq!(nearest_side(3, 2), 4);
        assert_eq!(nearest_side(4096, 4096), 4096);
    }

    #[test]
    fn shrinking_averages_and_growing_interpolates() {
        let ramp: Vec<_> = (0..6).map(|k| [k as f32]).collect();
        assert_eq!(resample(&ramp, 6, 1, 2), [[1.0], [4.0], [1.0], [4.0]]);
        assert_eq!(resample(&[[0.0], [1.0]], 2, 1, 4)[..4], [[0.25], [0.25], [0.75], [0.75]]);
        // 3 to 2: the middle texel is shared.
        assert_eq!(resample(&[[0.0], [3.0], [6.0]], 3, 1, 2)[..2], [[1.0], [5.0]]);
    }

    #[test]
    fn means_survive() {
        let values: Vec<_> = (0..35).map(|k| [((k * 7919) % 31) as f32]).collect();
        let mean = |v: &[[f32; 1]]| v.iter().map(|t| f64::from(t[0])).sum::<f64>() / v.len() as f64;
        // Shrinking by area keeps the mean up to the rounding of f32.
        assert!((mean(&resample(&values, 7, 5, 4)) - mean(&values)).abs() < 1e-5);
        assert!((mean(&resample(&values[..34], 17, 2, 2)) - mean(&values)).abs() > 1e-5);
    }
}
