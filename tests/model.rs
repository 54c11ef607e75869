//! The candle model answers and differentiates as plain float64 loops do; it wraps, and is continuous in u and level.

use crate::{materials, plain};
use candle_core::{Device, Tensor, Var};
use neumip::model::texture::Sigmas;
use neumip::model::{Inputs, Networks, NeuralMaterial, Tables, Variables};
use neumip::query::{QueryBuffer, Reflectance};
use neumip::random::{Random, Stream};
use neumip_export::Checkpoint;
use neumip_export::config::{OFFSET_TEXTURE, texture_name};

/// |difference| / (1 + |value|) of f32 tensors against float64: the exporter's tolerance, for the same reasons.
const ANSWER_TOLERANCE: f64 = 2e-5;
/// Gradients relative to their tensor's largest: f32 back-propagation, and differences over a step that a ReLU or a texel's
/// edge may fall into.
const GRADIENT_TOLERANCE: f64 = 2e-3;
/// Step of the central differences: float64 has digits to spare, and hardly a ReLU bends within it.
const STEP: f32 = 1e-6;

fn material(checkpoint: &Checkpoint) -> NeuralMaterial {
    NeuralMaterial::from_checkpoint(checkpoint, &Device::Cpu).unwrap()
}

fn buffer(checkpoint: &Checkpoint, n: usize, seed: u64) -> QueryBuffer {
    let golden = materials::queries(&checkpoint.header.architecture, n, seed);
    QueryBuffer::new(1, n, golden.u, golden.wi, golden.wo, golden.level).unwrap()
}

fn answer64(checkpoint: &Checkpoint, q: &QueryBuffer, k: usize) -> [f64; 3] {
    let features = plain::features(checkpoint, q.u[k], q.wo[k], q.level[k]);
    plain::decode(checkpoint, &features, q.u[k], q.wi[k], q.wo[k], q.level[k])
}

/// Largest |difference| / (1 + |value|) of candle's answers with `changed` from the float64 answers of `checkpoint`.
fn answer_error(checkpoint: &Checkpoint, changed: &Checkpoint, q: &QueryBuffer) -> f64 {
    let answers = material(changed).evaluate(q).unwrap();
    (0..q.len())
        .flat_map(|k| {
            let exact = answer64(checkpoint, q, k);
            let given = answers.pixels[k];
            (0..3).map(move |c| (f64::from(given[c]) - exact[c]).abs() / (1.0 + exact[c].abs()))
        })
        .max_by(f64::total_cmp)
        .unwrap()
}

#[test]
fn answers_follow_float64_and_a_changed_weight_is_noticed() {
    for (name, model, resolution) in materials::cases() {
        let checkpoint = materials::checkpoint(&model, resolution, 3);
        let q = buffer(&checkpoint, 1024, 4);
        let error = answer_error(&checkpoint, &checkpoint, &q);
        assert!(error < ANSWER_TOLERANCE, "{name}: {error:e}");
        let mut changed = checkpoint.clone();
        changed.tensors.get_mut("decoder.mlp.1.weight").unwrap().data[7] += 1e-2;
        assert!(answer_error(&checkpoint, &changed, &q) > ANSWER_TOLERANCE, "{name}");
    }
}

/// Gradient of sum(coefficients * rgb) by every tensor of the checkpoint, as training takes it.
fn gradients(checkpoint: &Checkpoint, q: &QueryBuffer, coefficients: &[f32]) -> Vec<(String, Vec<f64>)> {
    let (architecture, device) = (&checkpoint.header.architecture, Device::Cpu);
    let variables = Variables::from_stored(architecture, &checkpoint.tensors, &device).unwrap();
    let networks = Networks::new(architecture, &variables).unwrap();
    let tables = Tables::new(architecture, &variables, &Sigmas::none(architecture)).unwrap();
    let pyramid = Var::from_tensor(&tables.pyramid).unwrap();
    let offset = tables.offset.as_ref().map(|o| Var::from_tensor(o).unwrap());
    let read = Tables {
        pyramid: pyramid.as_tensor().clone(),
        offset: offset.as_ref().map(|o| o.as_tensor().clone()),
    };
    let inputs = Inputs::new(architecture, &q.u, &q.wi, &q.wo, &q.level, &device).unwrap();
    let rgb = networks.forward(&inputs, &read).unwrap();
    let weights = Tensor::from_slice(coefficients, (q.len(), 3), &device).unwrap();
    let store = (rgb * weights).unwrap().sum_all().unwrap().backward().unwrap();
    let values = |var: &Var| -> Vec<f64> {
        let flat: Vec<f32> = store.get(var.as_tensor()).unwrap().flatten_all().unwrap().to_vec1().unwrap();
        flat.into_iter().map(f64::from).collect()
    };
    let mut all = Vec::new();
    let whole = values(&pyramid);
    let channels = architecture.model.texture.channels;
    for (level, size) in architecture.level_sizes().iter().enumerate() {
        let range = size.base * channels..(size.base + size.height * size.width) * channels;
        all.push((texture_name(level), whole[range].to_vec()));
    }
    if let Some(offset) = &offset {
        all.push((OFFSET_TEXTURE.into(), values(offset)));
    }
    for (name, var) in variables.iter() {
        if name.contains(".mlp.") {
            all.push((name.to_string(), values(var)));
        }
    }
    all
}

/// The same functional in float64.
fn functional64(checkpoint: &Checkpoint, q: &QueryBuffer, coefficients: &[f32]) -> f64 {
    (0..q.len())
        .map(|k| {
            let features = plain::features(checkpoint, q.u[k], q.wo[k], q.level[k]);
            let rgb = plain::colour(checkpoint, &features, q.u[k], q.wi[k], q.wo[k], q.level[k]);
            (0..3).map(|c| rgb[c] * f64::from(coefficients[3 * k + c])).sum::<f64>()
        })
        .sum()
}

#[test]
fn gradients_follow_float64_and_a_changed_one_does_not() {
    const QUERIES: usize = 48;
    const ENTRIES: usize = 4;
    for (name, model, resolution) in materials::cases() {
        let checkpoint = materials::checkpoint(&model, resolution, 5);
        let mut q = buffer(&checkpoint, QUERIES, 6);
        // Training asks nothing below the horizon, where only the clamped answer is defined.
        for w in q.wi.iter_mut().chain(&mut q.wo) {
            let length = (w[0] * w[0] + w[1] * w[1]).sqrt().max(1.0);
            *w = w.map(|x| 0.9 * x / length);
        }
        let mut random = Random::new(7, Stream::Probe, 0);
        let coefficients: Vec<f32> = (0..3 * QUERIES).map(|_| random.normal()).collect();
        for (tensor, gradient) in gradients(&checkpoint, &q, &coefficients) {
            let scale = gradient.iter().fold(0.0f64, |m, g| m.max(g.abs()));
            if scale == 0.0 {
                continue;
            }
            let mut order: Vec<usize> = (0..gradient.len()).collect();
            order.sort_by(|a, b| gradient[*b].abs().total_cmp(&gradient[*a].abs()));
            for &entry in order.iter().take(ENTRIES) {
                let mut moved = checkpoint.clone();
                let at = checkpoint.tensors[&tensor].data[entry];
                let mut difference = |to: f32| {
                    moved.tensors.get_mut(&tensor).unwrap().data[entry] = to;
                    functional64(&moved, &q, &coefficients)
                };
                let (up, down) = (at + STEP, at - STEP);
                let slope = (difference(up) - difference(down)) / (f64::from(up) - f64::from(down));
                let error = (gradient[entry] - slope).abs() / scale;
                assert!(error < GRADIENT_TOLERANCE, "{name} {tensor}[{entry}]: {} {slope}", gradient[entry]);
                // The largest entry of each tensor, wrong by a hundredth, must be noticed.
                if gradient[entry].abs() == scale {
                    assert!(
                        (1.01 * gradient[entry] - slope).abs() / scale > GRADIENT_TOLERANCE,
                        "{name} {tensor}"
                    );
                }
            }
        }
    }
}

#[test]
fn positions_wrap() {
    for (name, model, resolution) in materials::cases() {
        let checkpoint = materials::checkpoint(&model, resolution, 8);
        let mut q = buffer(&checkpoint, 256, 9);
        // Quarters of a tile survive a shift by whole tiles without rounding.
        for (k, u) in q.u.iter_mut().enumerate() {
            *u = [(k % 16) as f32 / 16.0, (k / 16) as f32 / 16.0];
        }
        let home = material(&checkpoint).evaluate(&q).unwrap();
        for shift in [-3.0, 1.0, 1000.0] {
            let mut away = q.clone();
            away.u.iter_mut().for_each(|u| *u = [u[0] + shift, u[1] - shift]);
            assert_eq!(material(&checkpoint).evaluate(&away).unwrap(), home, "{name}");
        }
        q.u.iter_mut().for_each(|u| u[0] += 0.03);
        assert_ne!(material(&checkpoint).evaluate(&q).unwrap(), home, "{name}");
    }
}

#[test]
fn answers_are_continuous_in_level_and_clamp_at_its_ends() {
    /// A change of the level by 1e-4 changes no answer by more: slopes are below 50 for weights of this size.
    const JUMP: f32 = 5e-3;
    let largest = |a: &[[f32; 3]], b: &[[f32; 3]]| {
        a.as_flattened().iter().zip(b.as_flattened()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    };
    for (name, model, resolution) in materials::cases() {
        let checkpoint = materials::checkpoint(&model, resolution, 10);
        let last = checkpoint.header.architecture.coarsest() as f32;
        let at = |level: f32| {
            let mut q = buffer(&checkpoint, 256, 11);
            q.level.fill(level);
            material(&checkpoint).evaluate(&q).unwrap().pixels
        };
        for level in 0..=last as usize {
            let level = level as f32;
            assert!(largest(&at(level - 1e-4), &at(level + 1e-4)) < JUMP, "{name} at {level}");
        }
        if last > 0.0 {
            assert!(largest(&at(0.0), &at(last)) > JUMP, "{name}");
        }
        assert_eq!(at(-7.5), at(0.0), "{name}");
        assert_eq!(at(last + 3.3), at(last), "{name}");
    }
}

#[test]
fn below_the_horizon_is_black() {
    let (_, model, resolution) = materials::cases().remove(0);
    let checkpoint = materials::checkpoint(&model, resolution, 12);
    let q = QueryBuffer::new(
        1,
        3,
        vec![[0.3, 0.4]; 3],
        vec![[1.0, 0.0], [0.0, 0.0], [0.1, 0.2]],
        vec![[0.0, 0.0], [0.0, 1.5], [0.1, 0.2]],
        vec![0.0; 3],
    )
    .unwrap();
    let pixels = material(&checkpoint).evaluate(&q).unwrap().pixels;
    assert_eq!(pixels[..2], [[0.0; 3]; 2]);
    assert_ne!(pixels[2], [0.0; 3]);
}

#[test]
fn an_answer_does_not_depend_on_the_buffer_it_is_asked_in() {
    let (_, model, resolution) = materials::cases().remove(1);
    let checkpoint = materials::checkpoint(&model, resolution, 13);
    let q = buffer(&checkpoint, 3000, 14);
    let whole = material(&checkpoint).evaluate(&q).unwrap().pixels;
    for (start, end) in [(0, 1), (1000, 1031), (2990, 3000)] {
        let part = material(&checkpoint).evaluate(&q.range(start, end)).unwrap().pixels;
        for (k, (a, b)) in part.iter().zip(&whole[start..end]).enumerate() {
            let error = (0..3).map(|c| (a[c] - b[c]).abs() / (1.0 + b[c].abs())).fold(0.0, f32::max);
            assert!(f64::from(error) < ANSWER_TOLERANCE, "query {}", start + k);
        }
    }
}
