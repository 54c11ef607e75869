//! Gradients of the stored variables, through smoothing and chunks, against differences of the loss itself.

use super::{Job, Step};
use crate::config::{Config, Remap, Term, TermKind};
use crate::dataset::{Block, Layout, Patch};
use crate::model::texture::Sigmas;
use crate::model::{Networks, Tables, Variables};
use crate::random::{Random, Stream};
use candle_core::{Device, Tensor};
use half::f16;
use neumip_export::config::Architecture;

/// Differences of an f32 loss over a step that some ReLUs bend within.
const TOLERANCE: f64 = 2e-2;
/// Length of the step along a random direction of one variable.
const STEP: f64 = 4e-3;
const SIDE: usize = 8;
const PIECES: u64 = 24;

fn pieces() -> Vec<Block> {
    let piece = |k: u64| {
        let mut random = Random::new(21, Stream::Probe, k);
        let patches = (0..4)
            .map(|_| Patch {
                corner: [random.uniform(), random.uniform()],
                wi: random.disc(0.9),
                wo: random.disc(0.9),
            })
            .collect();
        let layout = Layout::new(SIDE, SIDE / 2, (k % 3) as f32 * 0.75, patches).unwrap();
        let rgb = (0..SIDE * SIDE).map(|_| [0; 3].map(|_| f16::from_f32(random.uniform()))).collect();
        Block::new(layout, rgb, 0.0).unwrap()
    };
    (0..PIECES).map(piece).collect()
}

/// Loss and gradients by variable with the textures read through `sigmas`.
fn gradients(
    architecture: &Architecture,
    variables: &Variables,
    sigmas: &Sigmas,
) -> (f64, Vec<(String, Tensor)>) {
    let terms = [
        Term { kind: TermKind::L2, remap: Remap::Linear, weight: 1.0 },
        Term { kind: TermKind::Gradient, remap: Remap::Root4Signed(0.1), weight: 0.1 },
    ];
    let pieces = pieces();
    let step = Step {
        pieces: &pieces,
        terms: &terms,
        target_range: [0.0, 1000.0],
        highest_level: None,
        offset_texture: true,
    };
    let job = Job {
        networks: &Networks::new(architecture, variables).unwrap(),
        variables,
        tables: &Tables::new(architecture, variables, sigmas).unwrap(),
        step: &step,
        device: &Device::Cpu,
    };
    let mut result = job.gradients().unwrap();
    assert!(result.finite());
    let networks = std::mem::take(&mut result.networks);
    let loss = result.loss;
    let mut all = result.of_textures(architecture, sigmas).unwrap();
    all.extend(networks);
    (loss, all)
}

#[test]
fn gradients_are_the_slopes_of_the_loss_through_smoothing_and_not_without_it() {
    let architecture = Architecture::new(Config::preset("improved").unwrap().model, [16, 16]).unwrap();
    let variables = Variables::initial(&architecture, 5, &Device::Cpu).unwrap();
    let sigmas = Sigmas { pyramid: vec![1.5, 0.75, 0.4, 0.0], offset: 1.5 };
    let (_, smoothed) = gradients(&architecture, &variables, &sigmas);
    let (_, plain) = gradients(&architecture, &variables, &Sigmas::none(&architecture));
    let mut checked = 0;
    for ((name, gradient), (_, other)) in smoothed.iter().zip(&plain) {
        let var = variables.get(name).unwrap();
        // Along its own gradient the slope is the gradient's length, and no sum of opposites.
        let length =
            |t: &Tensor| f64::from(t.sqr().unwrap().sum_all().unwrap().to_scalar::<f32>().unwrap()).sqrt();
        let slope = length(gradient);
        if slope < 1e-5 {
            continue;
        }
        let direction = (gradient / slope).unwrap();
        let home = var.as_tensor().copy().unwrap();
        let at = |step: f64| {
            var.set(&(&home + (&direction * step).unwrap()).unwrap()).unwrap();
            gradients(&architecture, &variables, &sigmas).0
        };
        let measured = (at(STEP) - at(-STEP)) / (2.0 * STEP);
        var.set(&home).unwrap();
        assert!((measured - slope).abs() < TOLERANCE * slope, "{name}: {measured} {slope}");
        if name == "texture.level0" {
            let wrong = (other * &direction).unwrap().sum_all().unwrap().to_scalar::<f32>().unwrap();
            assert!((measured - f64::from(wrong)).abs() > TOLERANCE * slope, "{name} without smoothing");
        }
        checked += 1;
    }
    assert!(checked > 10, "{checked}");
}
