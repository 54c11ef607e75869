//! Samples a second of the Inception decoder's kernels, as `scripts/inception_peer.py` times PyTorch's.
//!
//! ```sh
//! cargo build --release --example inception
//! python scripts/inception_peer.py --beside "target/release/examples/inception {shape} {side} {work}"
//! ```

use neumip::kernels::inception::{Border, Images, Network, Room, Shape};
use neumip::kernels::simd::Isa;
use neumip::random::{Random, Stream};
use std::time::Instant;

/// Inputs of the decoder: a presets' features and encodings are about so many.
const INPUTS: usize = 25;
/// Least seconds and steps of a timing.
const SECONDS: f64 = 0.5;
const STEPS: usize = 3;
const USAGE: &str =
    "use: inception SHAPE SIDE WORK, with SHAPE inception or inception-small and WORK infer or train";

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [shape, side, work] = arguments.as_slice() else { return Err(USAGE.into()) };
    let (width, modules, paths, reduce) = match shape.as_str() {
        "inception" => (256, 6, [64, 128, 32, 32], [96, 16]),
        "inception-small" => (25, 2, [7, 12, 3, 3], [9, 2]),
        _ => return Err(USAGE.into()),
    };
    let shape = Shape { inputs: INPUTS, width, modules, paths, reduce, outputs: 3 };
    let side: usize = side.parse()?;
    let images = Images::new(1, side, side, Border::Zero)?;
    let mut random = Random::new(1, Stream::Probe, 0);
    let mut numbers = |n: usize, size: f32| (0..n).map(|_| size * random.normal()).collect::<Vec<f32>>();
    let weights: Vec<(Vec<f32>, Vec<f32>)> = shape
        .convolutions()
        .iter()
        .map(|c| {
            let size = (2.0 / (c.inputs * c.kernel * c.kernel) as f32).sqrt();
            (numbers(c.weights(), size), numbers(c.outputs, 0.01))
        })
        .collect();
    let weights: Vec<(&[f32], &[f32])> = weights.iter().map(|(w, b)| (&w[..], &b[..])).collect();
    let (input, by_output) = (numbers(images.pixels() * INPUTS, 1.0), numbers(images.pixels() * 3, 1.0));
    let (mut output, mut by_input) = (vec![0.0; by_output.len()], vec![0.0; input.len()]);
    let mut by_weights = vec![0.0; shape.parameters()];
    let mut network = Network::learning(Isa::chosen()?, &shape, INPUTS, &weights)?;
    let mut room = Room::default();
    let mut step = || -> neumip::Result<()> {
        if work == "train" {
            // An optimiser's step changes the weights, so that they are packed anew.
            network.repack(&weights)?;
            network.forward_keeping(images, &input, &mut room, &mut output);
            by_weights.fill(0.0);
            network.backward(images, &mut room, &by_output, &mut by_weights, &mut by_input);
        } else {
            network.forward(images, &input, &mut room, &mut output);
        }
        Ok(())
    };
    step()?;
    let begun = Instant::now();
    let mut times = Vec::new();
    while begun.elapsed().as_secs_f64() < SECONDS || times.len() < STEPS {
        let clock = Instant::now();
        step()?;
        times.push(clock.elapsed().as_secs_f64());
    }
    times.sort_by(f64::total_cmp);
    println!("{:.0}", images.pixels() as f64 / times[times.len() / 2]);
    Ok(())
}
