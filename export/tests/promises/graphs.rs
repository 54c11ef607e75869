//! The ONNX graphs answer as the material does.

use crate::{materials, plain};
use neumip_export::config::{DECODER_MLP, weight_name};
use neumip_export::{Checkpoint, Golden, onnx};
use rten::{Model, Value, ValueOrView};

/// |difference| / (1 + |value|) of 32-bit graphs against 64-bit loops. Measured: at most 2e-6, from three
/// doublings of an angle and from texel weights (positions rounded to 2^-24 of a tile); ten times that for
/// other processors and seeds.
pub const TOLERANCE: f64 = 2e-5;
/// Queries a case: every kind of position, level and direction dozens of times.
const QUERIES: usize = 1024;

/// An input's name, extents and values.
pub type Feed<'a> = (&'a str, Vec<usize>, Vec<f32>);

/// Feeds a graph by input names and returns the outputs that are asked for.
pub fn values(graph: Vec<u8>, feeds: &[Feed], outputs: &[&str]) -> Vec<Value> {
    let model = Model::load(graph).unwrap();
    let inputs = feeds
        .iter()
        .map(|(name, shape, data)| {
            let value = Value::from_shape(shape, data.clone()).unwrap();
            (model.node_id(name).unwrap(), ValueOrView::Value(value))
        })
        .collect();
    let nodes: Vec<_> = outputs.iter().map(|name| model.node_id(name).unwrap()).collect();
    model.run(inputs, &nodes, None).unwrap()
}

/// Feeds a graph by input names and returns rgb.
pub fn run(graph: Vec<u8>, feeds: &[Feed]) -> Vec<f32> {
    let rgb = values(graph, feeds, &["rgb"]).remove(0);
    if feeds[0].1.len() == 4 {
        let (shape, data) = rgb.into_shape_vec::<f32, 4>().unwrap();
        assert_eq!(shape[..], [&feeds[0].1[..3], &[3]].concat());
        return data;
    }
    let (shape, data) = rgb.into_shape_vec::<f32, 2>().unwrap();
    assert_eq!(shape, [feeds[0].1[0], 3]);
    data
}

pub fn feeds(queries: &Golden) -> Vec<(&'static str, Vec<usize>, Vec<f32>)> {
    let extents = extents(queries);
    let with = |columns: usize| [&extents[..], &[columns]].concat();
    vec![
        ("u", with(2), queries.u.concat()),
        ("wi", with(2), queries.wi.concat()),
        ("wo", with(2), queries.wo.concat()),
        ("level", extents.clone(), queries.level.clone()),
    ]
}

fn extents(queries: &Golden) -> Vec<usize> {
    queries.images.map_or(vec![queries.u.len()], Vec::from)
}

/// Features as the decoder graph gets them, and the answers to them and to the whole query.
pub fn expected(checkpoint: &Checkpoint, queries: &Golden) -> (Vec<f32>, Vec<f64>, Vec<f64>) {
    let (mut features, mut decoder, mut material) = (vec![], vec![], vec![]);
    if queries.images.is_some() {
        let exact = |i| plain::features(checkpoint, queries.u[i], queries.wo[i], queries.level[i]);
        let exact: Vec<Vec<f64>> = (0..queries.u.len()).map(exact).collect();
        let rounded = |f: &Vec<f64>| f.iter().map(|f| f64::from(*f as f32)).collect();
        let rounded: Vec<Vec<f64>> = exact.iter().map(rounded).collect();
        let [decoder, material] =
            [&rounded, &exact].map(|f| plain::decode_images(checkpoint, f, queries).concat());
        return (rounded.concat().iter().map(|f| *f as f32).collect(), decoder, material);
    }
    for i in 0..queries.u.len() {
        let (u, wi, wo, level) = (queries.u[i], queries.wi[i], queries.wo[i], queries.level[i]);
        let exact = plain::features(checkpoint, u, wo, level);
        let given: Vec<f32> = exact.iter().map(|f| *f as f32).collect();
        let rounded: Vec<f64> = given.iter().map(|f| f64::from(*f)).collect();
        features.extend(given);
        decoder.extend(plain::decode(checkpoint, &rounded, u, wi, wo, level));
        material.extend(plain::decode(checkpoint, &exact, u, wi, wo, level));
    }
    (features, decoder, material)
}

pub fn largest_difference(answers: &[f32], expected: &[f64]) -> f64 {
    assert_eq!(answers.len(), expected.len());
    let error = |(a, e): (&f32, &f64)| (f64::from(*a) - e).abs() / (1.0 + e.abs());
    // total_cmp puts NaN above everything: one cannot hide.
    answers.iter().zip(expected).map(error).max_by(f64::total_cmp).unwrap()
}

#[test]
fn graphs_answer_like_plain_loops() {
    for (name, model, resolution) in materials::cases() {
        let checkpoint = materials::checkpoint(&model, resolution, 1);
        let queries = materials::queries(&checkpoint.header.architecture, QUERIES, 2);
        let (features, decoder, material) = expected(&checkpoint, &queries);
        assert!(
            material.iter().filter(|v| **v > 0.0).count() > QUERIES / 4,
            "{name}: hardly anything to compare"
        );

        let mut with_features = vec![("features", vec![QUERIES, model.texture.channels], features)];
        with_features.extend(feeds(&queries));
        let answers =
            run(onnx::decoder_graph(&checkpoint, onnx::Options::default()).unwrap(), &with_features);
        let of_decoder = largest_difference(&answers, &decoder);
        let answers =
            run(onnx::material_graph(&checkpoint, onnx::Options::default()).unwrap(), &feeds(&queries));
        let of_material = largest_difference(&answers, &material);
        println!("{name}: decoder {of_decoder:.1e}, material {of_material:.1e}");
        assert!(of_decoder < TOLERANCE && of_material < TOLERANCE, "{name}: {of_decoder:e} {of_material:e}");
    }
}

#[test]
fn graphs_of_images_answer_like_plain_loops_and_every_tensor_of_them_matters() {
    for (name, model, resolution) in materials::image_cases() {
        let checkpoint = materials::checkpoint(&model, resolution, 1);
        for images in [[2, 9, 13], [3, 4, 4], [1, 1, 3]] {
            let queries = materials::images(&checkpoint.header.architecture, images, 2);
            let (features, decoder, material) = expected(&checkpoint, &queries);
            let with_channels = [&images[..], &[model.texture.channels]].concat();
            let mut with_features = vec![("features", with_channels, features)];
            with_features.extend(feeds(&queries));
            let answers =
                run(onnx::decoder_graph(&checkpoint, onnx::Options::default()).unwrap(), &with_features);
            let of_decoder = largest_difference(&answers, &decoder);
            let answers =
                run(onnx::material_graph(&checkpoint, onnx::Options::default()).unwrap(), &feeds(&queries));
            let of_material = largest_difference(&answers, &material);
            println!("{name} {images:?}: decoder {of_decoder:.1e}, material {of_material:.1e}");
            assert!(of_decoder < TOLERANCE && of_material < TOLERANCE, "{name} {images:?}: {of_material:e}");
            if images[0] != 2 {
                continue;
            }
            assert!(material.iter().filter(|v| **v > 0.0).count() > material.len() / 4, "{name}");
            for tensor in checkpoint.tensors.keys() {
                let mut perturbed = checkpoint.clone();
                let data = &mut perturbed.tensors.get_mut(tensor).unwrap().data;
                data.iter_mut().for_each(|v| *v += 0.03);
                let (_, _, material) = expected(&perturbed, &queries);
                assert!(largest_difference(&answers, &material) > TOLERANCE, "{name}: {tensor}");
            }
        }
    }
}

#[test]
fn every_tensor_matters() {
    for (name, model, resolution) in materials::cases() {
        let checkpoint = materials::checkpoint(&model, resolution, 1);
        let queries = materials::queries(&checkpoint.header.architecture, QUERIES / 4, 2);
        let answers =
            run(onnx::material_graph(&checkpoint, onnx::Options::default()).unwrap(), &feeds(&queries));
        for tensor in checkpoint.tensors.keys() {
            let mut perturbed = checkpoint.clone();
            let data = &mut perturbed.tensors.get_mut(tensor).unwrap().data;
            data.iter_mut().for_each(|v| *v += 0.03);
            let (_, _, material) = expected(&perturbed, &queries);
            assert!(largest_difference(&answers, &material) > TOLERANCE, "{name}: {tensor}");
        }
    }
}

#[test]
fn one_perturbed_weight_exceeds_the_tolerance() {
    for (name, model, resolution) in materials::cases() {
        let checkpoint = materials::checkpoint(&model, resolution, 1);
        let queries = materials::queries(&checkpoint.header.architecture, QUERIES / 4, 2);
        let mut perturbed = checkpoint.clone();
        let first = weight_name(DECODER_MLP, 0);
        // The largest: the first may be of a neuron that hardly fires.
        let data = &mut perturbed.tensors.get_mut(&first).unwrap().data;
        *data.iter_mut().max_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap() *= 1.01;
        let answers =
            run(onnx::material_graph(&perturbed, onnx::Options::default()).unwrap(), &feeds(&queries));
        let (_, _, material) = expected(&checkpoint, &queries);
        assert!(largest_difference(&answers, &material) > TOLERANCE, "{name}");
    }
}

#[test]
fn one_query_and_every_batch_size_work() {
    let (_, model, resolution) = materials::cases().remove(1);
    let checkpoint = materials::checkpoint(&model, resolution, 1);
    let graph = onnx::material_graph(&checkpoint, onnx::Options::default()).unwrap();
    let all = materials::queries(&checkpoint.header.architecture, 40, 3);
    let answers = run(graph.clone(), &feeds(&all));
    for i in [3, 17] {
        let one = Golden {
            u: vec![all.u[i]],
            wi: vec![all.wi[i]],
            wo: vec![all.wo[i]],
            level: vec![all.level[i]],
            rgb: vec![],
            tolerance: 1.0,
            images: None,
        };
        let expected: Vec<f64> = answers[3 * i..3 * i + 3].iter().map(|v| f64::from(*v)).collect();
        assert!(largest_difference(&run(graph.clone(), &feeds(&one)), &expected) < TOLERANCE);
    }
}

#[test]
fn same_checkpoint_same_graph() {
    let (_, model, resolution) = materials::cases().remove(3);
    let checkpoint = materials::checkpoint(&model, resolution, 1);
    assert_eq!(
        onnx::material_graph(&checkpoint, onnx::Options::default()).unwrap(),
        onnx::material_graph(&checkpoint, onnx::Options::default()).unwrap()
    );
    assert_eq!(
        onnx::decoder_graph(&checkpoint, onnx::Options::default()).unwrap(),
        onnx::decoder_graph(&checkpoint, onnx::Options::default()).unwrap()
    );
}
