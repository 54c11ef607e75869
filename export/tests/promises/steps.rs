//! The material in the steps of a renderer: prepare, evaluate, sample, pdf.

use crate::graphs::{Feed, TOLERANCE, expected, largest_difference, values};
use crate::lobes::{Lobe, density, lobes, sample, sampler};
use crate::materials::{self, Numbers};
use crate::plain;
use neumip_export::onnx::{self, Opset, Options};
use neumip_export::sampler::Frame;
use neumip_export::weights::{self, Layout, PAD};
use neumip_export::{Checkpoint, Golden, Sampler, Storage};
use rten::{Model, Value};

/// Queries a case.
const QUERIES: usize = 512;
/// Relative difference of a density in 32-bit floats from one in 64-bit floats: it is the fourth power of a distance that
/// is a difference of nearly equal numbers at the centre of a narrow lobe (1/12 here). Measured: 2e-5; ten times that for
/// other seeds.
const DENSITY: f64 = 2e-4;
/// Difference of a component of wi. Measured: 2e-5, because xi within a lobe of small weight is a small difference of
/// rounded sums; ten times that.
const DIRECTION: f64 = 2e-4;

/// Lobes of the samplers here.
const FRAMES: [Frame; 3] = [Frame::Surface, Frame::Mirror, Frame::Mirror];

/// Runs a graph and gives the outputs that are asked for.
fn run(graph: Vec<u8>, feeds: &[Feed], outputs: &[&str]) -> Vec<Vec<f32>> {
    let values = values(graph, feeds, outputs);
    values.into_iter().zip(outputs).map(|(value, name)| flat(value, name)).collect()
}

/// The data of an output, whose rank its name says.
fn flat(value: Value, name: &str) -> Vec<f32> {
    match name {
        "visible" | "pdf" => value.into_shape_vec::<f32, 1>().unwrap().1,
        "lobes" => value.into_shape_vec::<f32, 3>().unwrap().1,
        _ => value.into_shape_vec::<f32, 2>().unwrap().1,
    }
}

fn prepared_feeds(queries: &Golden) -> Vec<Feed<'static>> {
    let n = queries.u.len();
    vec![
        ("u", vec![n, 2], queries.u.concat()),
        ("wo", vec![n, 2], queries.wo.concat()),
        ("level", vec![n], queries.level.clone()),
    ]
}

#[test]
fn prepare_and_evaluate_answer_as_the_whole_does() {
    for (name, model, resolution) in materials::cases() {
        for storage in [Storage::SINGLE, Storage::BYTE] {
            let checkpoint = storage.round(materials::checkpoint(&model, resolution, 1)).unwrap();
            let queries = materials::queries(&checkpoint.header.architecture, QUERIES, 2);
            let options = Options { storage, ..Options::default() };
            let graph = onnx::prepare_graph(&checkpoint, None, options).unwrap();
            let mut prepared = run(graph, &prepared_feeds(&queries), &["partial", "visible"]);
            let answer = |prepared: &[Vec<f32>]| {
                let partial = prepared[0].clone();
                let feeds = [
                    ("partial", vec![QUERIES, partial.len() / QUERIES], partial),
                    ("visible", vec![QUERIES], prepared[1].clone()),
                    ("wi", vec![QUERIES, 2], queries.wi.concat()),
                ];
                run(onnx::evaluate_graph(&checkpoint, options).unwrap(), &feeds, &["rgb"]).remove(0)
            };
            let material = expected(&checkpoint, &queries).2;
            let difference = largest_difference(&answer(&prepared), &material);
            println!("{name}: {difference:.1e}");
            assert!(difference < TOLERANCE, "{name}: {difference:e}");
            prepared[0].iter_mut().for_each(|sum| *sum += 0.02);
            assert!(largest_difference(&answer(&prepared), &material) > TOLERANCE, "{name}");
        }
    }
}

/// Largest relative difference of densities.
fn relative(answers: &[f32], expected: &[f64]) -> f64 {
    let error = |(a, e): (&f32, &f64)| (f64::from(*a) - e).abs() / e.abs().max(1e-6);
    answers.iter().zip(expected).map(error).max_by(f64::total_cmp).unwrap()
}

/// A checkpoint, queries and numbers, the lobes of the graph and those of the text.
struct Case {
    checkpoint: Checkpoint,
    sampler: Sampler,
    xi: Vec<[f32; 2]>,
    graph: Vec<f32>,
    text: Vec<Vec<Lobe>>,
}

fn case(index: usize) -> Case {
    let (_, model, resolution) = materials::cases().remove(index);
    let checkpoint = materials::checkpoint(&model, resolution, 1);
    let sampler = sampler(model.texture.channels, &FRAMES, 3 + index as u64);
    let mut queries = materials::queries(&checkpoint.header.architecture, QUERIES, 2);
    let mut numbers = Numbers::new(17);
    queries.wo.fill_with(|| numbers.direction(0.0, 0.999));
    // Away from 1, where a slope is infinite.
    let xi = (0..QUERIES).map(|_| [numbers.uniform(), numbers.between(0.001, 0.999)]).collect();
    let graph = onnx::prepare_graph(&checkpoint, Some(&sampler), Options::default()).unwrap();
    let graph = run(graph, &prepared_feeds(&queries), &["lobes"]).remove(0);
    let text = (0..QUERIES)
        .map(|i| {
            let features = plain::features(&checkpoint, queries.u[i], queries.wo[i], queries.level[i]);
            lobes(&sampler, &features, queries.wo[i])
        })
        .collect();
    Case { checkpoint, sampler, xi, graph, text }
}

#[test]
fn directions_are_sampled_and_weighed_as_the_text_says() {
    for index in 0..materials::cases().len() {
        let Case { sampler, xi, graph, text, .. } = case(index);
        let count = sampler.header.config.lobes.len() + 1;
        let lobes = ("lobes", vec![QUERIES, count, onnx::LOBE_COLUMNS], graph);
        let feeds = [lobes.clone(), ("xi", vec![QUERIES, 2], xi.concat())];
        let answers = run(onnx::sample_graph(&sampler, Opset::V17).unwrap(), &feeds, &["wi", "pdf"]);
        let wi: Vec<[f32; 3]> = answers[0].as_chunks::<3>().0.to_vec();
        // A number within a rounding of a border may choose the other lobe.
        let border = |i: usize| {
            let mut end = 0.0;
            text[i].iter().any(|lobe| {
                end += lobe.weight;
                (end - f64::from(xi[i][0])).abs() < 1e-5
            })
        };
        let far: Vec<usize> = (0..QUERIES).filter(|i| !border(*i)).collect();
        assert!(far.len() > QUERIES - 10);
        let direction = |changed: f64| {
            let error = |i: &usize| {
                let exact = sample(&text[*i], xi[*i]);
                (0..3).map(|c| (f64::from(wi[*i][c]) + changed - exact[c]).abs()).fold(0.0, f64::max)
            };
            far.iter().map(error).max_by(f64::total_cmp).unwrap()
        };
        let exact: Vec<f64> = wi.iter().zip(&text).map(|(wi, l)| density(l, wi.map(f64::from))).collect();
        let of_sample = relative(&answers[1], &exact);
        println!("case {index}: directions {:.1e}, densities {of_sample:.1e}", direction(0.0));
        assert!(
            direction(0.0) < DIRECTION && direction(1e-3) > DIRECTION,
            "case {index}: {:e}",
            direction(0.0)
        );
        assert!(of_sample < DENSITY, "case {index}: {of_sample:e}");
        assert!(wi.iter().all(|w| w[2] > 0.0));

        let mut wi = answers[0].clone();
        wi[2] = -wi[2];
        let feeds = [lobes, ("wi", vec![QUERIES, 3], wi)];
        let mut answer = run(onnx::pdf_graph(&sampler, Opset::V17).unwrap(), &feeds, &["pdf"]).remove(0);
        assert_eq!(answer[0], 0.0, "below the horizon");
        let difference = relative(&answer[1..], &exact[1..]);
        assert!(difference < DENSITY, "case {index}: {difference:e}");
        answer[7] *= 1.001;
        assert!(relative(&answer[1..], &exact[1..]) > DENSITY);
    }
}

#[test]
fn the_last_number_before_one_and_the_first_choose_a_lobe() {
    let Case { sampler, graph, .. } = case(0);
    let count = sampler.header.config.lobes.len() + 1;
    let lobes = ("lobes", vec![QUERIES, count, onnx::LOBE_COLUMNS], graph);
    for xi in [[0.0, 0.0], [1.0 - f32::EPSILON / 2.0; 2], [1.0, 1.0]] {
        let feeds = [lobes.clone(), ("xi", vec![QUERIES, 2], vec![xi; QUERIES].concat())];
        let answers = run(onnx::sample_graph(&sampler, Opset::V17).unwrap(), &feeds, &["wi", "pdf"]);
        for (wi, pdf) in answers[0].as_chunks::<3>().0.iter().zip(&answers[1]) {
            let length: f32 = wi.iter().map(|w| w * w).sum();
            assert!((length - 1.0).abs() < 1e-5 && *pdf >= 0.0 && pdf.is_finite(), "{xi:?}: {wi:?} {pdf}");
        }
    }
}

#[test]
fn opsets_differ_in_their_number_only() {
    let Case { checkpoint, sampler, .. } = case(1);
    for build in [
        |c: &Checkpoint, _: &Sampler, o| onnx::material_graph(c, o).unwrap(),
        |c: &Checkpoint, s: &Sampler, o| onnx::prepare_graph(c, Some(s), o).unwrap(),
        |_: &Checkpoint, s: &Sampler, o: Options| onnx::sample_graph(s, o.opset).unwrap(),
    ] {
        let sizes = [Opset::V13, Opset::V17, Opset::V21].map(|opset| {
            let graph = build(&checkpoint, &sampler, Options { opset, ..Options::default() });
            Model::load(graph.clone()).unwrap();
            graph.len()
        });
        assert!(sizes.iter().all(|size| *size == sizes[0]), "{sizes:?}");
    }
    assert!(Opset::try_from(14).unwrap_err().contains("13, 17 and 21"));
}

#[test]
fn a_decoder_that_reads_neighbours_is_not_split() {
    let (_, model, resolution) = materials::image_cases().remove(0);
    let checkpoint = materials::checkpoint(&model, resolution, 1);
    for problem in [
        onnx::prepare_graph(&checkpoint, None, Options::default()).unwrap_err(),
        onnx::evaluate_graph(&checkpoint, Options::default()).unwrap_err(),
    ] {
        assert!(problem.to_string().contains("neighbours"), "{problem}");
    }
}

#[test]
fn weights_are_row_by_row_and_padded() {
    let Case { checkpoint, sampler, .. } = case(0);
    let layout = Layout::new(&checkpoint.header.architecture, Some(&sampler.header.config));
    let block = layout.fill(&checkpoint, Some(&sampler)).unwrap();
    assert_eq!(block.len(), layout.values);
    let mut seen = 0;
    for layer in &layout.layers {
        assert!(layer.weight % PAD == 0 && layer.bias % PAD == 0);
        let of = |name: String| checkpoint.tensors.get(&name).or_else(|| sampler.tensors.get(&name)).unwrap();
        let weight = of(format!("{}.{}.weight", layer.network, layer.layer));
        assert_eq!(weight.shape, [layer.outputs, layer.inputs]);
        for row in 0..layer.padded_outputs {
            for column in 0..layer.padded_inputs {
                let inside = row < layer.outputs && column < layer.inputs;
                let expected = if inside { weight.data[row * layer.inputs + column] } else { 0.0 };
                assert_eq!(block[layer.weight + row * layer.padded_inputs + column], expected);
            }
        }
        let bias = of(format!("{}.{}.bias", layer.network, layer.layer));
        assert_eq!(&block[layer.bias..layer.bias + layer.outputs], &bias.data[..]);
        seen += layer.padded_outputs * (layer.padded_inputs + 1);
    }
    assert_eq!(seen, layout.values);
    assert_eq!(weights::single_bytes(&block).len(), 4 * block.len());
    let halfs = weights::half_bytes(&block);
    assert_eq!(halfs.len(), 2 * block.len());
    let first = half::f16::from_le_bytes([halfs[0], halfs[1]]);
    assert_eq!(first, half::f16::from_f32(block[0]));
}
