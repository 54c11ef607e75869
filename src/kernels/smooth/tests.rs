use super::*;
use crate::random::{Random, Stream};

/// Sums of some hundred terms of size 1 in f32.
const ROUNDING: f64 = 3e-6;
/// Inner products of as many terms of size 1 as the textures have.
const PRODUCT_ROUNDING: f64 = 1e-4;
/// What the documentation says of halving: rms on white noise, and the largest answer to an impulse, as a share of the
/// exact peak.
const HALVING: [f64; 2] = [0.009, 0.0125];

fn noise(n: usize, index: u64) -> Vec<f32> {
    let mut random = Random::new(3, Stream::Probe, index);
    (0..n).map(|_| random.normal()).collect()
}

/// The Gaussian on a ring, by its definition.
fn weights(sigma: f64, n: usize) -> Vec<f64> {
    let reach = (CUTOFF * sigma).ceil() as i64;
    let mut weights = vec![0.0; n];
    for d in -reach..=reach {
        weights[d.rem_euclid(n as i64) as usize] += (-0.5 * (d as f64 / sigma).powi(2)).exp();
    }
    let total: f64 = weights.iter().sum();
    weights.iter().map(|w| w / total).collect()
}

/// The sum in float64 over every wrapped texel: along rows, then along columns.
fn direct(x: &[f32], [h, w, c]: [usize; 3], sigma: f64) -> Vec<f64> {
    let (rows, columns) = (weights(sigma, h), weights(sigma, w));
    let mut across = vec![0.0; x.len()];
    let mut out = vec![0.0; x.len()];
    for (at, sum) in across.iter_mut().enumerate() {
        let (i, j, k) = (at / c / w, at / c % w, at % c);
        *sum = (0..w).map(|d| columns[d] * f64::from(x[(i * w + (j + d) % w) * c + k])).sum();
    }
    for (at, sum) in out.iter_mut().enumerate() {
        let (i, rest) = (at / c / w, at % (w * c));
        *sum = (0..h).map(|d| rows[d] * across[(i + d) % h * w * c + rest]).sum();
    }
    out
}

fn worst(a: &[f32], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max)
}

fn exact(isa: Isa, x: &[f32], shape: [usize; 3], sigma: f64) -> Vec<f32> {
    let mut out = vec![f32::NAN; x.len()];
    smooth_exact(isa, x, shape, sigma, &mut out);
    out
}

fn smoothed(isa: Isa, x: &[f32], shape: [usize; 3], sigma: f64) -> Vec<f32> {
    let mut out = vec![f32::NAN; x.len()];
    smooth_into(isa, x, shape, sigma, &mut out, &mut Vec::new());
    out
}

const SHAPES: [[usize; 3]; 11] = [
    [1, 1, 1],
    [1, 1, 7],
    [2, 1, 3],
    [1, 3, 8],
    [2, 2, 16],
    [3, 2, 9],
    [9, 12, 3],
    [17, 5, 13],
    [20, 31, 7],
    [40, 24, 7],
    [8, 33, 1],
];

#[test]
fn agrees_with_the_direct_sum_and_notices_one_changed_texel() {
    for shape in SHAPES {
        let x = noise(shape.iter().product(), 0);
        for sigma in [0.1, 0.3, 1.0, 2.2, 8.0, 40.0] {
            let expected = direct(&x, shape, sigma);
            for isa in Isa::all() {
                let found = worst(&exact(isa, &x, shape, sigma), &expected);
                assert!(found < ROUNDING, "{} {shape:?} {sigma}: {found:e}", isa.name());
                if sigma < HALVE_FROM {
                    assert_eq!(smoothed(isa, &x, shape, sigma), exact(isa, &x, shape, sigma));
                }
                let mut moved = x.clone();
                moved[x.len() / 2] += 10.0;
                assert!(worst(&exact(isa, &moved, shape, sigma), &expected) > ROUNDING);
            }
        }
    }
}

#[test]
fn a_sigma_beyond_every_side_gives_the_mean() {
    for shape in SHAPES {
        let [h, w, c] = shape;
        let x = noise(h * w * c, 1);
        let means: Vec<f64> = (0..c)
            .map(|k| x.iter().skip(k).step_by(c).map(|v| f64::from(*v)).sum::<f64>() / (h * w) as f64)
            .collect();
        let expected: Vec<f64> = (0..x.len()).map(|at| means[at % c]).collect();
        for isa in Isa::all() {
            for sigma in [1e3, 1e30, f64::INFINITY] {
                assert!(worst(&smoothed(isa, &x, shape, sigma), &expected) < ROUNDING);
            }
            if h * w > 1 {
                assert!(worst(&smoothed(isa, &x, shape, 0.3), &expected) > ROUNDING);
            }
        }
    }
}

fn dot(a: &[f32], b: &[f32]) -> f64 {
    a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
}

#[test]
fn is_its_own_adjoint_and_keeps_constants() {
    for shape in [[8, 6, 2], [5, 9, 3], [32, 48, 7], [64, 64, 3], [20, 12, 9], [2, 2, 1]] {
        let n = shape.iter().product();
        let (x, y, ones) = (noise(n, 2), noise(n, 3), vec![1.5f32; n]);
        for sigma in [1.3, 4.0, 8.0, 17.0] {
            for isa in Isa::all() {
                let (sx, sy) = (smoothed(isa, &x, shape, sigma), smoothed(isa, &y, shape, sigma));
                let difference = (dot(&sx, &y) - dot(&x, &sy)).abs();
                assert!(difference < PRODUCT_ROUNDING, "{} {shape:?} {sigma}: {difference:e}", isa.name());
                let mut wrong = sy.clone();
                wrong[n / 2] += 0.01 / x[n / 2];
                assert!((dot(&sx, &y) - dot(&x, &wrong)).abs() > PRODUCT_ROUNDING);
                let constant = smoothed(isa, &ones, shape, sigma);
                assert!(worst(&constant, &vec![1.5; n]) < ROUNDING);
                let mut uneven = ones.clone();
                uneven[0] += 1.0;
                assert!(worst(&smoothed(isa, &uneven, shape, sigma), &vec![1.5; n]) > ROUNDING);
            }
        }
    }
}

/// rms difference of the halved from the exact Gaussian on white noise, relative to the exact answer, and the largest
/// difference of the answers to an impulse at every place of the coarsest texel, relative to the peak.
fn difference(isa: Isa, taken: f64, sigma: f64) -> [f64; 2] {
    let shape = [128, 128, 1];
    let x = noise(128 * 128, 4);
    let expected = direct(&x, shape, sigma);
    let squares: f64 = expected.iter().map(|v| v * v).sum();
    let found = smoothed(isa, &x, shape, taken);
    let rms = found.iter().zip(&expected).map(|(a, b)| (f64::from(*a) - b).powi(2)).sum::<f64>() / squares;
    let impulses = (0..4).map(|place| {
        let mut x = vec![0.0; 128 * 128];
        x[(60 + place) * 128 + 60 + place] = 1.0;
        let expected = direct(&x, shape, sigma);
        let peak = expected.iter().copied().fold(0.0, f64::max);
        worst(&smoothed(isa, &x, shape, taken), &expected) / peak
    });
    [rms.sqrt(), impulses.fold(0.0, f64::max)]
}

#[test]
fn halving_stays_near_the_gaussian_and_a_changed_sigma_is_noticed() {
    for isa in Isa::all() {
        for sigma in [3.5, 4.0, 6.9, 7.2, 8.0, 15.0] {
            let found = difference(isa, sigma, sigma);
            assert!(found[0] < HALVING[0] && found[1] < HALVING[1], "{} {sigma}: {found:?}", isa.name());
            let wrong = difference(isa, sigma * 1.02, sigma);
            assert!(wrong[0] > HALVING[0] && wrong[1] > HALVING[1], "{} {sigma}: {wrong:?}", isa.name());
        }
    }
}

#[test]
fn padding_is_neither_read_nor_left() {
    for (shape, [wide, out_wide]) in
        [([12, 10, 7], [8, 8]), ([5, 3, 9], [16, 11]), ([32, 32, 7], [8, 7]), ([1, 2, 1], [1, 8])]
    {
        let [h, w, c] = shape;
        let x = noise(h * w * c, 5);
        let mut padded = vec![f32::NAN; h * w * wide];
        for (to, from) in padded.chunks_mut(wide).zip(x.chunks(c)) {
            to[..c].copy_from_slice(from);
        }
        let mut back = vec![0.0; x.len()];
        compact(&padded, wide, c, &mut back);
        assert_eq!(back, x);
        for isa in Isa::all() {
            for sigma in [0.0, 1.0, 8.0] {
                let mut out = vec![f32::NAN; h * w * out_wide];
                let mut scratch = vec![f32::NAN; 7];
                smooth_strided(isa, (&padded, wide), shape, sigma, (&mut out, out_wide), &mut scratch);
                let expected = smoothed(isa, &x, shape, sigma);
                for (texel, expected) in out.chunks(out_wide).zip(expected.chunks(c)) {
                    assert_eq!(&texel[..c], expected, "{} {shape:?} {sigma}", isa.name());
                    assert!(texel[c..].iter().all(|v| *v == 0.0));
                }
            }
        }
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    let shape = [70, 66, 7];
    let x = noise(shape.iter().product(), 6);
    for isa in Isa::all() {
        for sigma in [1.0, 8.0] {
            let run = |threads: usize| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                let out = pool.install(|| smoothed(isa, &x, shape, sigma));
                out.into_iter().map(f32::to_bits).collect::<Vec<_>>()
            };
            let one = run(1);
            assert!(run(2) == one && run(4) == one, "{} {sigma}", isa.name());
        }
    }
}

#[test]
fn nothing_no_sigma_and_what_is_no_number() {
    assert!(ring(1.0, 0).is_empty() && smooth(&[], 0, 5, 7, 1.0).is_empty());
    assert!(smooth(&[], 3, 3, 0, 8.0).is_empty());
    let x = noise(6 * 6, 7);
    for sigma in [0.0, -1.0, f64::NAN] {
        assert_eq!(smooth(&x, 6, 6, 1, sigma), x);
    }
    for poison in [f32::NAN, f32::INFINITY, 1e-40, f32::MAX] {
        let mut x = vec![0.0; 64 * 64];
        x[5] = poison;
        for isa in Isa::all() {
            for sigma in [1.0, 3.6] {
                let out = smoothed(isa, &x, [64, 64, 1], sigma);
                assert!(out[5].is_nan() || out[5] >= 0.0);
                assert_eq!(out[32 * 64 + 32], 0.0, "what lies far is not touched");
            }
        }
    }
}
