//! Every term and remap against float64: values by direct sums over patches, gradients by central differences.

use super::{Means, Patches, Target};
use crate::config::{Remap, Term, TermKind};
use crate::random::{Random, Stream};
use candle_core::{Device, Tensor, Var};

/// f32 sums of a few hundred terms, and slopes of roots near their guard.
const TOLERANCE: f64 = 2e-4;
/// Step of the central differences; images are kept this far from every kink.
const STEP: f64 = 1e-6;

const SIDE: usize = 8;
/// One piece of a single patch, one of four, one of sixteen without interior pixels, one whose border does not count.
const PATCHES: [Patches; 4] = [of_side(8, 0), of_side(4, 0), of_side(2, 0), of_side(8, 2)];
const WEIGHTS: [f32; 4] = [1.0, 1.0, 0.0, 1.0];
const PIXELS: usize = PATCHES.len() * SIDE * SIDE;

const fn of_side(side: usize, margin: usize) -> Patches {
    Patches { side, margin }
}

fn remap64(x: f64, remap: Remap) -> f64 {
    let signed = |e: f64, p: f64| x.signum() * ((x.abs() + e).powf(p) - e.powf(p));
    match remap {
        Remap::Linear => x,
        Remap::Root4Literal => x.powf(0.25),
        Remap::Root4Guarded => x.max(1e-7).powf(0.25),
        Remap::Root4Signed(e) => signed(e, 0.25),
        Remap::Sqrt(e) => signed(e, 0.5),
        Remap::Log => (1.0 + x.max(-0.1)).ln(),
    }
}

/// Its slope; past a guard, the slope at it.
fn slope64(x: f64, remap: Remap) -> f64 {
    let signed = |e: f64, p: f64| p * (x.abs() + e).powf(p - 1.0);
    match remap {
        Remap::Linear => 1.0,
        Remap::Root4Literal => 0.25 * x.powf(-0.75),
        Remap::Root4Guarded => 0.25 * x.max(1e-7).powf(-0.75),
        Remap::Root4Signed(e) => signed(e, 0.25),
        Remap::Sqrt(e) => signed(e, 0.5),
        Remap::Log => 1.0 / (1.0 + x.max(-0.1)),
    }
}

/// The term summed patch by patch, as the paper's equation 1 reads; `held` is where slopes that are held constant are taken.
fn term64(term: Term, prediction: &[f64], target: &[f64], held: &[f64]) -> f64 {
    let difference = |piece: usize, row: usize, column: usize, c: usize| {
        let k = ((piece * SIDE + row) * SIDE + column) * 3 + c;
        if term.kind == TermKind::L2Mean {
            return (prediction[k] - target[k]) * slope64(held[k], term.remap);
        }
        remap64(prediction[k], term.remap) - remap64(target[k], term.remap)
    };
    let (mut sum, mut interior, mut counted) = (0.0, 0usize, 0usize);
    for (piece, Patches { side: patch, margin }) in PATCHES.into_iter().enumerate() {
        let weight = f64::from(WEIGHTS[piece]);
        for row in 0..SIDE {
            for column in 0..SIDE {
                let pixelwise =
                    |f: fn(f64) -> f64| (0..3).map(|c| f(difference(piece, row, column, c))).sum::<f64>();
                let within = |border: usize| {
                    [row, column].iter().all(|x| x % patch >= border && x % patch + border < patch)
                };
                if !within(margin) {
                    continue;
                }
                let inside = within(margin + 1);
                interior += usize::from(inside);
                counted += 1;
                sum += weight
                    * match term.kind {
                        TermKind::L1 => pixelwise(f64::abs),
                        TermKind::L2 | TermKind::L2Mean => pixelwise(|d| d * d),
                        _ if !inside => 0.0,
                        TermKind::Gradient => (0..3)
                            .map(|c| sobel64(&|r, q| difference(piece, r, q, c), row, column))
                            .map(|[x, y]| x * x + y * y)
                            .sum(),
                        TermKind::GradientLuma => {
                            let luma = |r: usize, q: usize| {
                                [0.299, 0.587, 0.114]
                                    .iter()
                                    .enumerate()
                                    .map(|(c, w)| w * difference(piece, r, q, c))
                                    .sum()
                            };
                            let [x, y] = sobel64(&luma, row, column);
                            0.5 * (x.abs() + y.abs())
                        }
                    };
            }
        }
    }
    let count = match term.kind {
        TermKind::L1 | TermKind::L2 | TermKind::L2Mean => 3 * counted,
        TermKind::Gradient => 3 * interior,
        TermKind::GradientLuma => interior,
    };
    term.weight * sum / count as f64
}

fn sobel64(image: &dyn Fn(usize, usize) -> f64, row: usize, column: usize) -> [f64; 2] {
    let kernel = [[1.0, 0.0, -1.0], [2.0, 0.0, -2.0], [1.0, 0.0, -1.0]];
    let (mut x, mut y) = (0.0, 0.0);
    for (i, line) in kernel.iter().enumerate() {
        for (j, k) in line.iter().enumerate() {
            x += k * image(row + i - 1, column + j - 1);
            y += k * image(row + j - 1, column + i - 1);
        }
    }
    [x, y]
}

/// A prediction and a target away from every kink: 0, the guards, and each other.
fn images(signed: bool) -> (Vec<f32>, Vec<f32>) {
    let mut random = Random::new(11, Stream::Probe, 0);
    let mut pair = || {
        let target = 0.1 + random.uniform();
        let sign = if random.uniform() < 0.5 { -1.0 } else { 1.0 };
        let prediction = target + sign * (0.02 + 0.06 * random.uniform());
        let flip = if signed && random.uniform() < 0.3 { -0.5 } else { 1.0 };
        (prediction * flip, target)
    };
    (0..3 * PIXELS).map(|_| pair()).unzip()
}

/// Largest error of value and gradient, relative to the largest gradient; `perturb` is added to one gradient entry.
fn worst(term: Term, perturb: f64) -> f64 {
    let signed = matches!(term.remap, Remap::Root4Signed(_) | Remap::Sqrt(_) | Remap::Linear);
    let (prediction, target) = images(signed);
    let pixels = target.as_chunks::<3>().0.to_vec();
    let means = Means::of(SIDE, PATCHES.into_iter());
    let device = Device::Cpu;
    let stored = Target::new(pixels, SIDE, &PATCHES, &WEIGHTS, means, &device).unwrap();
    let var = Var::from_tensor(&Tensor::from_slice(&prediction, (PIXELS, 3), &device).unwrap()).unwrap();
    let loss = stored.loss(var.as_tensor(), &[term]).unwrap();
    let store = loss.backward().unwrap();
    let mut gradient: Vec<f64> = store
        .get(var.as_tensor())
        .unwrap()
        .flatten_all()
        .unwrap()
        .to_vec1::<f32>()
        .unwrap()
        .into_iter()
        .map(f64::from)
        .collect();
    let mut x: Vec<f64> = prediction.iter().map(|v| f64::from(*v)).collect();
    let held = x.clone();
    let t: Vec<f64> = target.iter().map(|v| f64::from(*v)).collect();
    let expected: Vec<f64> = (0..x.len())
        .map(|k| {
            let at = x[k];
            x[k] = at + STEP;
            let up = term64(term, &x, &t, &held);
            x[k] = at - STEP;
            let down = term64(term, &x, &t, &held);
            x[k] = at;
            (up - down) / (2.0 * STEP)
        })
        .collect();
    let scale = expected.iter().fold(0.0f64, |m, g| m.max(g.abs()));
    gradient[5] += perturb * scale;
    let value = f64::from(loss.to_scalar::<f32>().unwrap());
    let exact = term64(term, &x, &t, &held);
    let of_value = (value - exact).abs() / exact.abs();
    gradient.iter().zip(&expected).map(|(a, b)| (a - b).abs() / scale).fold(of_value, f64::max)
}

#[test]
fn values_and_gradients_follow_float64_and_a_perturbed_one_does_not() {
    let remaps = [
        Remap::Linear,
        Remap::Root4Literal,
        Remap::Root4Guarded,
        Remap::Root4Signed(1e-3),
        Remap::Sqrt(1e-3),
        Remap::Log,
    ];
    for kind in [TermKind::L1, TermKind::L2, TermKind::L2Mean, TermKind::Gradient, TermKind::GradientLuma] {
        for remap in remaps {
            let term = Term { kind, remap, weight: 0.7 };
            let error = worst(term, 0.0);
            assert!(error < TOLERANCE, "{term:?}: {error}");
            assert!(worst(term, 0.01) > TOLERANCE, "{term:?}");
        }
    }
}

#[test]
fn parts_of_a_batch_add_up_to_the_whole() {
    let (prediction, target) = images(false);
    let terms = [
        Term { kind: TermKind::L1, remap: Remap::Linear, weight: 1.0 },
        Term { kind: TermKind::Gradient, remap: Remap::Root4Signed(1e-3), weight: 0.1 },
    ];
    let means = Means::of(SIDE, PATCHES.into_iter());
    let part = |range: std::ops::Range<usize>| -> f32 {
        let pixels = range.start * SIDE * SIDE..range.end * SIDE * SIDE;
        let rgb = target.as_chunks::<3>().0[pixels.clone()].to_vec();
        let (patches, weights) = (&PATCHES[range.clone()], &WEIGHTS[range]);
        let stored = Target::new(rgb, SIDE, patches, weights, means, &Device::Cpu).unwrap();
        let values = prediction[3 * pixels.start..3 * pixels.end].to_vec();
        let tensor = Tensor::from_vec(values, (pixels.len(), 3), &Device::Cpu).unwrap();
        stored.loss(&tensor, &terms).unwrap().to_scalar().unwrap()
    };
    let (whole, parts) = (part(0..4), part(0..1) + part(1..2) + part(2..4));
    assert!((whole - parts).abs() < 1e-6 * whole, "{whole} {parts}");
}
