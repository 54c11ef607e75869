//! Densities are exact, samples follow them, and fitting gains.

use super::golden::{PDF_TOLERANCE, TOLERANCE, golden};
use super::light::{FURNACE, SKY};
use super::*;
use crate::error::Error;
use crate::query::unit;
use crate::random::{Random, Stream};
use neumip_export::checkpoint::Checkpoint;
use neumip_export::sampler::{Frame, OUTPUTS_PER_LOBE, Sampler, SamplerConfig};
use std::f64::consts::TAU;
use std::ops::ControlFlow;
use std::path::Path;

fn config() -> SamplerConfig {
    SamplerConfig {
        features: 3,
        hidden: vec![4],
        lobes: vec![Frame::Surface, Frame::Mirror],
        cosine_floor: 0.1,
        min_z: 0.2,
    }
}

/// Lobes of random shapes; `sharp` is the mean of the logarithms of their widths.
fn lobes(index: u64, sharp: f32) -> Lobes {
    let mut random = Random::new(5, Stream::Probe, index);
    let mut outputs = Vec::new();
    for _ in 0..2 {
        outputs.extend([random.normal(), 0.4 * random.normal(), 0.4 * random.normal()]);
        outputs.extend([sharp + 0.4 * random.normal(), 0.5 * random.normal(), sharp + 0.4 * random.normal()]);
    }
    Lobes::new(&config(), &outputs, random.disc(0.95))
}

/// Unit vector whose squared sine is `a`, at the share `b` of a turn: both uniform for a cosine lobe.
fn direction(a: f64, b: f64) -> [f32; 3] {
    let (sin, cos) = (TAU * b).sin_cos();
    [(a.sqrt() * cos) as f32, (a.sqrt() * sin) as f32, (1.0 - a).sqrt() as f32]
}

/// Integral of a density over the hemisphere by the midpoints of n x n cells. Polar angles gather at the horizon, where wide
/// lobes are steepest.
fn integral(pdf: impl Fn([f32; 3]) -> f32, n: usize) -> f64 {
    let cell = |i: usize| {
        let z = (i as f64 + 0.5) / n as f64;
        // z = y^2: dz = 2 y dy.
        let (height, stretch) = (z * z, 2.0 * z);
        let ring =
            (0..n).map(|j| f64::from(pdf(direction(1.0 - height * height, (j as f64 + 0.5) / n as f64))));
        stretch * ring.sum::<f64>() * TAU / (n * n) as f64
    };
    (0..n).map(cell).sum()
}

/// Midpoints of 400 x 400 cells on lobes no narrower than about a tenth.
const QUADRATURE: f64 = 2e-3;

#[test]
fn densities_integrate_to_one_and_a_wrong_determinant_is_noticed() {
    for index in 0..12 {
        let lobes = lobes(index, -0.6);
        let sum = integral(|w| lobes.pdf(w), 400);
        assert!((sum - 1.0).abs() < QUADRATURE, "{index}: {sum}");
        let wrong = integral(|w| 1.005 * lobes.pdf(w), 400);
        assert!((wrong - 1.0).abs() > QUADRATURE);
    }
    assert!((integral(|w| Lobes::cosine().pdf(w), 400) - 1.0).abs() < QUADRATURE);
}

/// Cells of the chi-square test: squared sine and azimuth.
const CELLS: [usize; 2] = [12, 24];
const SAMPLES: usize = 120_000;
/// Six standard deviations of the statistic: no seed of the test is near, and a density that is a twentieth off is far beyond.
const DEVIATIONS: f64 = 6.0;

/// How many standard deviations the chi-square statistic of samples is above its mean.
fn deviations(lobes: &Lobes, pdf: impl Fn([f32; 3]) -> f32, seed: u64) -> f64 {
    let [rings, sectors] = CELLS;
    let mut counts = vec![0.0f64; rings * sectors];
    let mut random = Random::new(seed, Stream::Probe, 0);
    for _ in 0..SAMPLES {
        let ([x, y, _], _) = lobes.sample([random.uniform(), random.uniform()]);
        let a = f64::from(x * x + y * y);
        let b = f64::from(y).atan2(f64::from(x)).rem_euclid(TAU) / TAU;
        let at = |share: f64, n: usize| ((share * n as f64) as usize).min(n - 1);
        counts[at(a, rings) * sectors + at(b, sectors)] += 1.0;
    }
    const PARTS: usize = 16;
    let expected = |cell: usize| {
        let part = |i: usize, n: usize, k: usize| (i as f64 + (k as f64 + 0.5) / PARTS as f64) / n as f64;
        let mut sum = 0.0;
        for (i, j) in (0..PARTS * PARTS).map(|k| (k / PARTS, k % PARTS)) {
            let w = direction(part(cell / sectors, rings, i), part(cell % sectors, sectors, j));
            // In the squared sine and the azimuth the cosine lobe is uniform.
            sum += f64::from(pdf(w) / Lobes::cosine().pdf(w));
        }
        SAMPLES as f64 * sum / (PARTS * PARTS * rings * sectors) as f64
    };
    // Cells of few samples share one, as the statistic wants at least some in each.
    let (mut statistic, mut freedom, mut rest) = (0.0, -1.0, [0.0f64; 2]);
    for (cell, count) in counts.iter().enumerate() {
        let expected = expected(cell);
        if expected < 10.0 {
            rest = [rest[0] + count, rest[1] + expected];
            continue;
        }
        statistic += (count - expected).powi(2) / expected;
        freedom += 1.0;
    }
    if rest[1] > 0.0 {
        statistic += (rest[0] - rest[1]).powi(2) / rest[1].max(10.0);
        freedom += 1.0;
    }
    (statistic - freedom) / (2.0f64 * freedom).sqrt()
}

#[test]
fn samples_follow_their_density_and_a_wrong_one_is_noticed() {
    for index in 0..6 {
        let lobes = lobes(index, -0.3);
        let right = deviations(&lobes, |w| lobes.pdf(w), 1 + index);
        assert!(right.abs() < DEVIATIONS, "{index}: {right}");
        // A twentieth more on one side, as a wrong centre or shear gives.
        let wrong = deviations(&lobes, |w| lobes.pdf(w) * if w[0] > 0.0 { 1.05 } else { 0.95 }, 1 + index);
        assert!(wrong > DEVIATIONS, "{index}: {wrong}");
    }
}

#[test]
fn no_outputs_and_no_numbers_give_anything_but_unit_vectors_with_densities() {
    // Roundings of three squares.
    const UNIT: f32 = 1e-6;
    let extreme = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30, -1e30, 0.0, 3.0, -3.0];
    let last = 1.0 - f32::EPSILON / 2.0;
    for index in 0..1_000_000u64 {
        let mut random = Random::new(9, Stream::Probe, index);
        let outputs: [f32; 2 * OUTPUTS_PER_LOBE] = std::array::from_fn(|_| match random.below(4) {
            0 => extreme[random.below(extreme.len())],
            _ => 4.0 * random.normal(),
        });
        let wo = match random.below(4) {
            0 => [0.999_999_9, 0.0],
            1 => [1.2, -1.2],
            _ => random.disc(1.0),
        };
        let number = |random: &mut Random| match random.below(8) {
            0 => 0.0,
            1 => last,
            _ => random.uniform(),
        };
        let xi = [number(&mut random), number(&mut random)];
        let lobes = Lobes::new(&config(), &outputs, wo);
        let (wi, pdf) = lobes.sample(xi);
        let length: f32 = wi.iter().map(|w| w * w).sum();
        assert!(wi[2] > 0.0 && (length - 1.0).abs() < UNIT, "{outputs:?} {wo:?} {xi:?}: {wi:?}");
        assert!(pdf.is_finite() && pdf > 0.0 && pdf == lobes.pdf(wi), "{outputs:?} {wo:?} {xi:?}: {pdf}");
        let sum: f32 = lobes.weights().iter().sum();
        assert!((sum - 1.0).abs() < UNIT && lobes.weights()[0] >= 0.0999, "{:?}", lobes.weights());
    }
    let lobes = lobes(1, -1.0);
    assert_eq!((lobes.pdf([1.0, 0.0, 0.0]), lobes.pdf([0.6, 0.0, -0.8])), (0.0, 0.0));
}

#[test]
fn a_narrow_lobe_lies_around_the_mirrored_viewer_and_where_its_facets_reflect() {
    let config = SamplerConfig { lobes: vec![Frame::Mirror], ..config() };
    let outputs = [20.0, 0.0, 0.0, -4.0, 0.0, -4.0];
    let wo = [0.5, 0.3];
    let lobes = Lobes::new(&config, &outputs, wo);
    let [x, y, z] = unit(wo);
    // At the lobe's middle xi.y is 0; a bit of the first number leads past the cosine.
    let (wi, _) = lobes.sample([0.5, 0.0]);
    let off = (wi[0] + x).abs() + (wi[1] + y).abs() + (wi[2] - z).abs();
    assert!(off < 1e-6, "{wi:?}");
    // A facet of slope t exp(-4) / 2 sends light from there to first order; twice the slope does not.
    let (wi, _) = lobes.sample([0.1 + 0.9 * 0.2, 0.5]);
    let (sin, cos) = (std::f32::consts::TAU * 0.2).sin_cos();
    let miss = |factor: f32| {
        let h = [-factor * cos * (-4f32).exp(), -factor * sin * (-4f32).exp(), 1.0];
        let n = h.map(|v| v / (h[0] * h[0] + h[1] * h[1] + 1.0).sqrt());
        // The normal of a surface of that slope points away from where it rises.
        let n = [-n[0], -n[1], n[2]];
        let along = 2.0 * (n[0] * x + n[1] * y + n[2] * z);
        (0..3).map(|i| (along * n[i] - [x, y, z][i] - wi[i]).abs()).sum::<f32>()
    };
    assert!(miss(0.5) < 1e-3 && miss(1.0) > 1e-2, "{} {}", miss(0.5), miss(1.0));
}

fn tiny() -> Checkpoint {
    Checkpoint::read(&Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/tiny.safetensors")).unwrap()
}

fn quick() -> Options {
    Options { steps: 120, hidden: vec![8, 8], measured: 64, ..Options::default() }
}

fn go(_: u64, _: f64) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

#[test]
fn fitting_beats_the_cosine_and_its_bytes_do_not_depend_on_threads() {
    let fitted: Vec<Sampler> = [1, 3]
        .into_iter()
        .map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| fit(&tiny(), &quick(), &mut go)).unwrap()
        })
        .collect();
    assert!(fitted[0].to_bytes().unwrap() == fitted[1].to_bytes().unwrap());
    let other = fit(&tiny(), &Options { seed: 2, steps: 1, ..quick() }, &mut go).unwrap();
    assert_ne!(other.tensors, fitted[0].tensors);
    assert_eq!(fitted[0].header.provenance["fallback"], false);
    let sampler = MaterialSampler::from_checkpoint(&tiny(), &fitted[0]).unwrap();
    for light in [FURNACE, SKY] {
        let gain = gain(&sampler, &light, 256, 77).unwrap();
        println!("{gain:?}");
        assert!(gain.ratio + 3.0 * gain.error < 1.0, "{gain:?}");
    }
}

#[test]
fn the_measured_variance_is_that_of_samples() {
    /// Of the direct estimate: some four standard errors of 200 variances, each of 2000 samples.
    const RELATIVE: f64 = 0.05;
    let sampler =
        MaterialSampler::from_checkpoint(&tiny(), &fit(&tiny(), &quick(), &mut go).unwrap()).unwrap();
    let (n, each) = (200, 2000);
    // Dark where it grazes: there, rare large values would make the direct estimate useless.
    let light = Light { name: "high", radiance: |w| f32::from(u8::from(w[2] > 0.3)), bright: &[] };
    let coarsest = sampler.material().architecture().coarsest();
    let asked = condition::conditions(coarsest, Part::HeldOut, 5, 0, n);
    let (mut direct, mut told) = (0.0, [0.0; 2]);
    for k in 0..n {
        let mut random = Random::new(3, Stream::Probe, k as u64);
        let lobes = sampler.lobes_at(asked.u[k], asked.level[k], asked.wo[k]).unwrap();
        let level = light::Turned::level(&light);
        let both = gain::variances(&sampler, &asked, k, &lobes, &level, &mut random).unwrap();
        told = [told[0] + both[0], told[1] + both[1]];
        let (u, levels, wo) = (vec![asked.u[k]; each], vec![asked.level[k]; each], vec![asked.wo[k]; each]);
        let xi: Vec<[f32; 2]> = (0..each).map(|_| [random.uniform(), random.uniform()]).collect();
        let drawn = sampler.sample(&u, &levels, &wo, &xi).unwrap();
        let wi: Vec<[f32; 2]> = drawn.iter().map(|(w, _)| [w[0], w[1]]).collect();
        let prepared = sampler.material().prepare(&u, &levels, &wo).unwrap();
        let rgb = sampler.material().light(&prepared, &wi).unwrap();
        let values: Vec<f64> = rgb
            .iter()
            .zip(&drawn)
            .map(|(rgb, (wi, pdf))| f64::from(value(*rgb) * (light.radiance)(*wi) / pdf))
            .collect();
        let mean = values.iter().sum::<f64>() / each as f64;
        direct += values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (each - 1) as f64;
    }
    assert!((direct / told[1] - 1.0).abs() < RELATIVE, "{direct} and {told:?}");
    assert!((direct / told[0] - 1.0).abs() > RELATIVE, "{direct} and {told:?}");
}

/// A material that reflects nothing.
fn black() -> Checkpoint {
    let mut checkpoint = tiny();
    for tensor in checkpoint.tensors.values_mut() {
        tensor.data.fill(0.0);
    }
    checkpoint
}

#[test]
fn a_material_that_gives_nothing_keeps_the_cosine() {
    let sampler = fit(&black(), &Options { steps: 2, ..quick() }, &mut go).unwrap();
    assert_eq!(sampler.header.provenance["fallback"], true);
    let sampler = MaterialSampler::from_checkpoint(&black(), &sampler).unwrap();
    let lobes = sampler.lobes_at([0.3, 0.4], 0.0, [0.5, -0.2]).unwrap();
    assert!(lobes.weights()[0] > 1.0 - 1e-6, "{:?}", lobes.weights());
}

#[test]
fn golden_samples_hold_in_double_precision_and_a_changed_one_is_noticed() {
    let sampler = fit(&tiny(), &Options { steps: 30, ..quick() }, &mut go).unwrap();
    let golden = golden(&tiny(), &sampler, 64, 1).unwrap();
    assert_eq!((golden.u.len(), golden.pdf.len()), (64, 64));
    assert!(golden.wo.iter().any(|w| unit(*w)[2] < 0.2), "no grazing viewer");
    assert!(golden.xi.iter().any(|xi| xi[0] == 0.0 || xi[1] == 0.0 || xi[0] > 0.999_999), "no edge");
    let material = crate::engine::FusedMaterial::from_checkpoint(&tiny()).unwrap();
    let features = material.features(&golden.u, &golden.level, &golden.wo).unwrap();
    let channels = sampler.header.config.features;
    for k in 0..64 {
        let own = &features[k * channels..][..channels];
        let (wi, pdf) = double(&sampler, own, golden.wo[k], golden.xi[k], golden.wi[k]);
        let told = golden.wi[k].map(f64::from);
        let off = (0..3).map(|i| (wi[i] - told[i]).abs()).fold(0.0, f64::max);
        assert!(off <= TOLERANCE, "{k}: {wi:?} and {told:?}");
        assert!((0..3).any(|i| (wi[i] + 1e-3 - told[i]).abs() > TOLERANCE));
        let told = f64::from(golden.pdf[k]);
        assert!((pdf / told - 1.0).abs() <= PDF_TOLERANCE, "{k}: {pdf} and {told}");
        assert!((1.01 * pdf / told - 1.0).abs() > PDF_TOLERANCE);
    }
}

/// The definition in `neumip_export::sampler`, word by word in double precision: the sample of `xi`, and the density at `at`.
fn double(sampler: &Sampler, features: &[f32], wo: [f32; 2], xi: [f32; 2], at: [f32; 3]) -> ([f64; 3], f64) {
    let config = &sampler.header.config;
    let mut x: Vec<f64> = features.iter().chain(&wo).map(|v| f64::from(*v)).collect();
    for layer in 0..=config.hidden.len() {
        let weight = &sampler.tensors[&format!("sampler.mlp.{layer}.weight")].data;
        let bias = &sampler.tensors[&format!("sampler.mlp.{layer}.bias")].data;
        let sums = weight.chunks(x.len()).zip(bias).map(|(row, bias)| {
            f64::from(*bias) + row.iter().zip(&x).map(|(w, x)| f64::from(*w) * x).sum::<f64>()
        });
        x = sums.map(|sum| if layer < config.hidden.len() { sum.max(0.0) } else { sum }).collect();
    }
    let wo = wo.map(f64::from);
    let height = (1.0 - wo[0] * wo[0] - wo[1] * wo[1]).max(0.0).sqrt().max(f64::from(config.min_z));
    let mut weights = vec![1.0];
    let mut shapes = vec![([[1.0, 0.0], [0.0, 1.0]], [0.0, 0.0])];
    for (out, frame) in x.chunks(OUTPUTS_PER_LOBE).zip(&config.lobes) {
        let [logit, cx, cy, p, r, q] = out else { panic!("six outputs a lobe") };
        let (p, q, r) = (p.clamp(-5.0, 2.0).exp(), q.clamp(-5.0, 2.0).exp(), r.clamp(-4.0, 4.0));
        let [cx, cy] = [cx, cy].map(|c| c.clamp(-8.0, 8.0));
        let (m, stretch) = match frame {
            Frame::Surface => ([0.0, 0.0], 0.0),
            Frame::Mirror => ([-wo[0] / height, -wo[1] / height], 1.0),
        };
        let t = |v: [f64; 2]| {
            let along = stretch * (m[0] * v[0] + m[1] * v[1]);
            [v[0] + m[0] * along, v[1] + m[1] * along]
        };
        let (first, second, centre) = (t([p, r * p]), t([0.0, q]), t([cx, cy]));
        shapes.push(([[first[0], second[0]], [first[1], second[1]]], [m[0] + centre[0], m[1] + centre[1]]));
        weights.push(logit.clamp(-20.0, 20.0).exp());
    }
    let sum: f64 = weights.iter().sum();
    let floor = f64::from(config.cosine_floor);
    for (k, weight) in weights.iter_mut().enumerate() {
        *weight = *weight / sum * (1.0 - floor) + if k == 0 { floor } else { 0.0 };
    }
    let [mut rest, along] = xi.map(f64::from);
    let mut k = 0;
    while rest >= weights[k] && k + 1 < weights.len() {
        rest -= weights[k];
        k += 1;
    }
    let (sin, cos) = (TAU * (rest / weights[k]).min(1.0)).sin_cos();
    let length = (along / (1.0 - along)).sqrt();
    let (a, b) = shapes[k];
    let s: [f64; 2] = std::array::from_fn(|i| length * (a[i][0] * cos + a[i][1] * sin) + b[i]);
    let z = 1.0 / (1.0 + s[0] * s[0] + s[1] * s[1]).sqrt();
    let [x, y, up] = at.map(f64::from);
    let pdf = weights.iter().zip(&shapes).map(|(weight, (a, b))| {
        let det = a[0][0] * a[1][1] - a[0][1] * a[1][0];
        let (dx, dy) = (x - b[0] * up, y - b[1] * up);
        let v = (a[1][1] * dx - a[0][1] * dy) / det;
        let w = (a[0][0] * dy - a[1][0] * dx) / det;
        weight * up / (TAU / 2.0 * det.abs() * (up * up + v * v + w * w).powi(2))
    });
    ([s[0] * z, s[1] * z, z], pdf.sum())
}

#[test]
fn what_is_wrong_is_named() {
    let says = |result: crate::error::Result<Sampler>, words: &str| {
        let problem = result.unwrap_err().to_string();
        assert!(problem.contains(words) && !problem.contains('\n'), "{problem}");
    };
    says(fit(&tiny(), &Options { steps: 0, ..quick() }, &mut go), "sampler.steps");
    says(fit(&tiny(), &Options { hidden: vec![], ..quick() }, &mut go), "sampler.hidden");
    says(fit(&tiny(), &Options { lobes: vec![], ..quick() }, &mut go), "sampler.lobes");
    says(fit(&tiny(), &Options { cosine_floor: f32::NAN, ..quick() }, &mut go), "cosine_floor");
    let stopped = fit(&tiny(), &quick(), &mut |_, _| ControlFlow::Break(()));
    assert!(matches!(stopped, Err(Error::Interrupted(_))));
    let mut foreign = fit(&tiny(), &Options { steps: 1, ..quick() }, &mut go).unwrap();
    assert!(golden(&tiny(), &foreign, 0, 1).is_err());
    foreign.header.config.features += 1;
    assert!(MaterialSampler::from_checkpoint(&tiny(), &foreign).is_err());
    foreign.header.config.features -= 1;
    let sampler = MaterialSampler::from_checkpoint(&tiny(), &foreign).unwrap();
    assert!(sampler.lobes(&[[0.0; 2]], &[f32::NAN], &[[0.0; 2]]).is_err());
    assert!(sampler.lobes(&[[0.0; 2]], &[], &[[0.0; 2]]).is_err());
    assert!(sampler.lobes_of(&[0.0; 4], &[[0.0; 2]]).is_err());
    assert!(gain(&sampler, &FURNACE, 1, 1).is_err());
}
