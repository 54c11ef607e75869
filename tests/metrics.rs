//! Metrics of images say what independent implementations of them say.

use crate::python_environment;
use neumip::lpips::Lpips;
use neumip::metrics::flip::{flip, flip_map};
use neumip::random::{Random, Stream};
use serde::{Deserialize, Serialize};
use std::f32::consts::TAU;
use std::path::Path;

/// Largest difference of a pixel's FLIP from that of its authors' code: f32 on both sides, and small differences enter
/// with exponents down to 0.35 (most where images are grey, which the way through sRGB leaves a tint of 1e-6).
/// Measured: 0.2e-4 at most.
const FLIP_PIXEL: f64 = 1e-4;
/// Largest difference of the mean, in which the pixels' differences cancel. Measured: 5e-7 at most.
const FLIP_MEAN: f64 = 1e-5;
/// Largest difference of LPIPS from numpy's in f64, relative: sums of up to 363 products in f32. Measured: 7e-7 at most.
const LPIPS: f64 = 1e-5;
/// What a twin changes a channel of one pixel by: a difference that can just be seen.
const CHANGED: f32 = 0.05;

/// Two images, linear RGB in \[0, 1\].
#[derive(Serialize)]
struct Pair {
    height: usize,
    width: usize,
    answer: Vec<[f32; 3]>,
    reference: Vec<[f32; 3]>,
}

impl Pair {
    /// Waves under a channel's own phase, which the answer has a little other of, with noise of a standard deviation.
    fn waves(height: usize, width: usize, noise: f32) -> Self {
        let image = |phase: f32, stream: u64| {
            let mut random = Random::new(stream, Stream::Probe, 0);
            let pixel = |k: usize| {
                let [y, x] = [k / width, k % width].map(|v| v as f32);
                [0.05, 0.08, 0.13].map(|f| {
                    let wave = (TAU * f * (x + 0.7 * y) + phase + 9.0 * f).sin();
                    (0.45 + 0.4 * wave + noise * random.normal()).clamp(0.0, 1.0)
                })
            };
            // In order: the numbers are drawn one after the other.
            (0..height * width).map(pixel).collect()
        };
        Self { height, width, answer: image(0.3, 1), reference: image(0.0, 2) }
    }

    /// One colour each.
    fn plain(answer: [f32; 3], reference: [f32; 3]) -> Self {
        Self { height: 16, width: 16, answer: vec![answer; 256], reference: vec![reference; 256] }
    }
}

/// Pairs that between them have smooth and sharp parts, dark ones, no colour, and borders of every kind.
fn pairs() -> Vec<Pair> {
    let mut dark = Pair::waves(33, 20, 0.1);
    let mut grey = Pair::waves(24, 40, 0.2);
    for image in [&mut dark.answer, &mut dark.reference] {
        image.iter_mut().flatten().for_each(|v| *v *= 0.01);
    }
    for image in [&mut grey.answer, &mut grey.reference] {
        image.iter_mut().for_each(|p| *p = [p[0]; 3]);
    }
    let farthest = Pair::plain([0.0, 1.0, 0.0], [0.0, 0.0, 1.0]);
    let near = Pair::plain([0.2, 0.5, 0.1], [0.25, 0.3, 0.6]);
    vec![
        Pair::waves(48, 64, 0.0),
        Pair::waves(40, 31, 0.1),
        Pair::waves(8, 9, 0.3),
        dark,
        grey,
        farthest,
        near,
    ]
}

/// Runs a script of this folder on pairs of images and `arguments`.
fn ask<T: for<'a> Deserialize<'a>>(script: &str, pairs: &[Pair], arguments: &[&Path]) -> T {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("pairs.json");
    std::fs::write(&file, serde_json::to_vec(pairs).unwrap()).unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests").join(script);
    let output =
        python_environment::environment().script(&script).arg(file).args(arguments).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn flip_is_what_its_authors_code_says() {
    #[derive(Deserialize)]
    struct Theirs {
        mean: f64,
        map: Vec<f32>,
    }
    /// Largest difference of a pixel, and of the mean.
    fn apart(pair: &Pair, theirs: &Theirs) -> [f64; 2] {
        let map = flip_map(pair.height, pair.width, &pair.answer, &pair.reference);
        assert_eq!(map.len(), theirs.map.len());
        let pixels = map.iter().zip(&theirs.map).map(|(a, b)| f64::from((a - b).abs()));
        let mean = flip(pair.height, pair.width, &pair.answer, &pair.reference).unwrap();
        [pixels.fold(0.0, f64::max), (mean - theirs.mean).abs()]
    }
    let mut pairs = pairs();
    let theirs: Vec<Theirs> = ask("check_flip.py", &pairs, &[]);
    for (pair, theirs) in pairs.iter().zip(&theirs) {
        let [pixel, mean] = apart(pair, theirs);
        println!("{} x {}: {:.4}, pixel {pixel:.1e}, mean {mean:.1e}", pair.height, pair.width, theirs.mean);
        assert!(pixel <= FLIP_PIXEL && mean <= FLIP_MEAN, "{pixel:e} {mean:e}");
    }
    for (pair, theirs) in pairs.iter_mut().zip(&theirs) {
        let value = &mut pair.answer[pair.width * pair.height / 2][1];
        *value = if *value > 0.5 { value.min(1.0) - CHANGED } else { value.max(0.0) + CHANGED };
        assert!(apart(pair, theirs)[0] > FLIP_PIXEL);
    }
    // The mean of a small image shows one pixel.
    assert!(apart(&pairs[2], &theirs[2])[1] > FLIP_MEAN);
}

#[test]
fn lpips_is_what_numpy_says() {
    fn apart(network: &Lpips, pair: &Pair, theirs: f64) -> f64 {
        let ours = network.distance(pair.height, pair.width, &pair.answer, &pair.reference).unwrap();
        (ours.unwrap() - theirs).abs() / theirs
    }
    let folder = tempfile::tempdir().unwrap();
    let weights = folder.path().join("weights.safetensors");
    let scripts = Path::new(env!("CARGO_MANIFEST_DIR")).join("scripts");
    let mut pairs = vec![Pair::waves(31, 31, 0.1), Pair::waves(48, 64, 0.0), Pair::waves(40, 77, 0.3)];
    // Values beyond [0, 1] are clamped on both sides.
    pairs[2].answer.as_flattened_mut().iter_mut().for_each(|v| *v = 1.4 * *v - 0.2);
    let theirs: Vec<f64> = ask("lpips_numpy.py", &pairs, &[&scripts, &weights]);
    let network = Lpips::open(&weights).unwrap();
    for (pair, theirs) in pairs.iter().zip(&theirs) {
        let apart = apart(&network, pair, *theirs);
        println!("{} x {}: LPIPS {theirs:.4}, apart {apart:.1e}", pair.height, pair.width);
        assert!(apart <= LPIPS && *theirs > 0.01);
    }
    for (pair, theirs) in pairs.iter_mut().zip(&theirs) {
        let same = network.distance(pair.height, pair.width, &pair.reference, &pair.reference).unwrap();
        assert_eq!(same, Some(0.0));
        let value = &mut pair.answer[pair.width * pair.height / 2][1];
        *value = if *value > 0.5 { value.min(1.0) - CHANGED } else { value.max(0.0) + CHANGED };
        assert!(apart(&network, pair, *theirs) > LPIPS);
    }

    assert_eq!(network.least_side(), 31);
    let (Pair { answer, reference, .. }, small) = (&pairs[0], 30 * 31);
    assert_eq!(network.distance(30, 31, &answer[..small], &reference[..small]).unwrap(), None);
    assert_eq!(network.distance(31, 32, answer, reference).unwrap(), None);
    let broken = vec![[f32::NAN; 3]; answer.len()];
    assert_eq!(network.distance(31, 31, &broken, reference).unwrap(), None);
}
