//! Rates of single kernels that docs/speed.md quotes: layers of a tile, and adding texels' gradients by owners.
//! `cargo run --release --example kernels`

use neumip::kernels::fetch::{Aim, Found, Owned, Places, Pyramid, Taps, Texels, aim, padded, read};
use neumip::kernels::mlp::{End, Packed, Start, weight_gradient};
use neumip::kernels::simd::Isa;
use neumip::random::{Random, Stream};
use rayon::prelude::*;
use std::time::Instant;

/// Samples of a tile, as in training.
const STRIDE: usize = 256;
const ROUNDS: usize = 21;
const CHANNELS: usize = 7;
const SIDE: usize = 512;
/// Tiles of a batch of 65,536.
const TILES: usize = 256;

/// Median seconds of a round.
fn median(mut work: impl FnMut()) -> f64 {
    let mut times: Vec<f64> = (0..ROUNDS)
        .map(|_| {
            let clock = Instant::now();
            work();
            clock.elapsed().as_secs_f64()
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[ROUNDS / 2]
}

fn layers(isa: Isa) {
    for (inputs, outputs) in [(79, 25), (25, 25), (9, 25), (25, 3)] {
        let (weight, bias) = (vec![0.01; inputs * outputs], vec![0.1; outputs]);
        let (x, mut out) = (vec![0.5; inputs * STRIDE], vec![0.0; outputs * STRIDE]);
        let packed = Packed::layer(isa, &weight, &bias, 0..inputs);
        let repeats = 10_000_000 / (inputs * outputs * STRIDE) + 1;
        let rate = |seconds: f64| 2.0 * (inputs * outputs * STRIDE * repeats) as f64 / seconds / 1e9;
        let forward = rate(median(|| {
            (0..repeats).for_each(|_| packed.apply(STRIDE, &x, Start::Bias, End::Relu, &mut out));
        }));
        let (mut of_weight, mut of_bias) = (weight.clone(), bias.clone());
        let gradient = rate(median(|| {
            (0..repeats).for_each(|_| weight_gradient(isa, STRIDE, &x, &out, &mut of_weight, &mut of_bias));
        }));
        println!("{} {inputs} to {outputs}: {forward:.0} GFLOP/s, weight gradient {gradient:.0}", isa.name());
    }
}

/// Taps and gradients of a batch in patches at random places of a 512 x 512 pyramid.
fn batch(isa: Isa, levels: &[Vec<f32>]) -> Vec<(Vec<Taps>, Vec<f32>)> {
    let levels = levels.iter().map(|l| Texels::Single(l)).collect();
    let pyramid = Pyramid { levels, height: SIDE, width: SIDE };
    let tile = |k: usize| {
        let mut random = Random::new(1, Stream::Probe, k as u64);
        let (corner, level) = ([random.uniform(), random.uniform()], 3.0 * random.uniform());
        let step = level.exp2() / SIDE as f32;
        let x: Vec<f32> = (0..STRIDE).map(|i| corner[0] + step * (i % 16) as f32).collect();
        let y: Vec<f32> = (0..STRIDE).map(|i| corner[1] + step * (i / 16) as f32).collect();
        let at = Places { x: &x, y: &y, level: &[level; STRIDE] };
        let (mut aimed, mut features) = (Aim::default(), vec![0.0; CHANNELS * STRIDE]);
        let mut taps = vec![Taps::default(); 2 * STRIDE];
        aim(isa, STRIDE, CHANNELS, &pyramid, at, &mut aimed);
        let found = Found { features: &mut features, slopes: &mut [], taps: &mut taps };
        read(isa, STRIDE, CHANNELS, &pyramid, &aimed, found);
        (taps, (0..STRIDE * padded(CHANNELS)).map(|_| random.normal()).collect())
    };
    (0..TILES).map(tile).collect()
}

fn main() -> neumip::Result<()> {
    let isa = Isa::chosen()?;
    layers(isa);
    let sides = || (0..10).map(|l| SIDE >> l);
    let levels: Vec<Vec<f32>> = sides().map(|s| vec![0.1; s * s * CHANNELS]).collect();
    let tiles = batch(isa, &levels);
    let mut table = vec![0.0; sides().map(|s| s * s).sum::<usize>() * padded(CHANNELS)];
    for number in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(number).build();
        let Ok(pool) = pool else { continue };
        let seconds = median(|| {
            let mut owners = Owned::split(&mut table, padded(CHANNELS), number);
            pool.install(|| {
                owners.par_iter_mut().for_each(|owner| {
                    for (taps, gradients) in &tiles {
                        taps.chunks(STRIDE).for_each(|of_level| owner.scatter(isa, of_level, gradients));
                    }
                });
            });
        });
        println!(
            "{number} owners on as many threads: {:.2} ms for {} samples",
            1e3 * seconds,
            TILES * STRIDE
        );
    }
    Ok(())
}
