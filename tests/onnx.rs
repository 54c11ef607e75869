//! Exported graphs answer as the model does, in engines that are not ours: in-process and in Python.

use crate::python_environment;
use candle_core::Device;
use neumip::config::Config;
use neumip::export::checkpoint::{FORMAT, Header};
use neumip::export::config::{ModelConfig, OFFSET_TEXTURE, OutputSpace, OutputTransform, ParallaxConfig};
use neumip::export::{
    Architecture, Checkpoint, Contents, Golden, Measure, Precision, Rounding, Storage, read_bundle,
};
use neumip::golden::{self, Rounded, TOLERANCE};
use neumip::inference::answerer;
use neumip::model::{NeuralMaterial, Variables};
use neumip::onnx_material::{OnnxMaterial, largest_difference};
use neumip::query::{QueryBuffer, Reflectance, above_horizon};
use neumip::random::{Random, Stream};
use serde::Deserialize;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::path::Path;
use tempfile::TempDir;

/// Queries that a graph is compared on.
const PROBES: usize = 16_384;
/// Least of them that have to be lit and seen, so that zeros are not compared with zeros.
const LEAST_LIT: usize = 8_000;
/// What a twin changes an answer by: 50 times the tolerance.
const CHANGED_ANSWER: f32 = 1e-3;
/// What a twin changes a parameter by: a percent of a weight of usual size.
const CHANGED_PARAMETER: f32 = 1e-2;
/// Factor on fresh weights: with it answers differ from query to query as much as trained ones do.
const GAIN: f32 = 2.5;
/// Least standard deviation over mean of answers that are worth a comparison.
const LEAST_SPREAD: f64 = 0.2;
/// Largest |difference| / (1 + |value|) by rounding textures to half floats, which moves a texel by 2^-11 of itself at
/// most. Measured: 0.6e-4 on the trained material, 1.1e-4 on fresh weights; ten times that for other materials.
const LARGEST_ROUNDING: f64 = 1e-3;
/// What a twin moves one texel by: a usual value of a texture.
const MOVED_TEXEL: f32 = 0.1;
/// Most of the size of `material.onnx` that is left with half textures where they are nine tenths of it.
const MOST_LEFT: f64 = 0.65;
/// SHA-256 of what the default export makes of the trained checkpoint, without the program's version: an option of the
/// export changes nothing unless it is chosen. Whoever changes the default on purpose puts the new values here.
const DEFAULT_FILES: [(&str, &str); 4] = [
    ("decoder.onnx", "c114f90a48583deb816a7560ce25431a18d7f598886997633dc3b0a7185389f3"),
    ("material.onnx", "da4f2bcc9b5216129c4c9a5e1d22b12014326eed6062190e57bed232bf96c677"),
    ("prepare.onnx", "859763f65f733561987a8e5416361dc21ac7a381ad278c645f3704e1a627236a"),
    ("evaluate.onnx", "01f4f0120331b6496761f3aa25a7061854d586a3e6d0f345a33ef8e1ebdb081d"),
];

/// A checkpoint that was trained.
fn trained() -> Checkpoint {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/tiny.safetensors");
    let checkpoint = Checkpoint::read(&path).unwrap();
    assert!(checkpoint.header.provenance["steps"].as_u64().unwrap() > 1000, "not trained");
    checkpoint
}

/// A preset with fresh weights, and an offset texture that is not 0.
pub fn untrained(preset: &str, change: fn(&mut ModelConfig), resolution: [usize; 2]) -> Checkpoint {
    let mut model = Config::preset(preset).unwrap().model;
    change(&mut model);
    let architecture = Architecture::new(model, resolution).unwrap();
    let mut tensors = Variables::initial(&architecture, 3, &Device::Cpu).unwrap().to_stored().unwrap();
    for weight in tensors.iter_mut().filter(|(name, _)| name.ends_with("weight")) {
        weight.1.data.iter_mut().for_each(|v| *v *= GAIN);
    }
    if let ParallaxConfig::Offset(_) = architecture.model.parallax {
        let mut random = Random::new(3, Stream::Probe, 0);
        tensors.get_mut(OFFSET_TEXTURE).unwrap().data.fill_with(|| random.normal());
    }
    let header = Header {
        format: FORMAT,
        architecture,
        height_range: [-0.1, 0.1],
        measure: Measure::RadianceCosine,
        material: preset.into(),
        provenance: serde_json::Value::Null,
        errors: serde_json::Value::Null,
    };
    Checkpoint { header, tensors }
}

/// The bundle of a checkpoint, in `bundle` of the folder.
fn bundle(checkpoint: &Checkpoint) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let golden = golden::answers(checkpoint, golden::QUERIES).unwrap();
    Contents::new(checkpoint, &golden).write(&folder.path().join("bundle"), false).unwrap();
    folder
}

/// What candle answers.
fn answers(checkpoint: &Checkpoint, queries: &QueryBuffer) -> Vec<[f32; 3]> {
    let material = NeuralMaterial::from_checkpoint(checkpoint, &Device::Cpu).unwrap();
    material.evaluate(queries).unwrap().pixels
}

/// What the exported graph answers in another engine.
fn graph_answers(checkpoint: &Checkpoint, queries: &QueryBuffer) -> Vec<[f32; 3]> {
    let folder = bundle(checkpoint);
    let graph = OnnxMaterial::open(&folder.path().join("bundle/material.onnx")).unwrap();
    graph.evaluate(queries).unwrap().pixels
}

fn probes(checkpoint: &Checkpoint) -> QueryBuffer {
    golden::probes(PROBES, checkpoint.header.architecture.coarsest(), 7)
}

fn lit(rgb: &[[f32; 3]]) -> usize {
    rgb.iter().filter(|p| p.iter().any(|v| *v > 0.0)).count()
}

/// Standard deviation over mean of lit answers.
fn spread(rgb: &[[f32; 3]]) -> f64 {
    let lit: Vec<f64> = rgb.as_flattened().iter().filter(|v| **v > 0.0).map(|v| f64::from(*v)).collect();
    let mean = lit.iter().sum::<f64>() / lit.len() as f64;
    (lit.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / lit.len() as f64).sqrt() / mean
}

#[test]
fn probes_reach_every_edge_of_the_domain() {
    let coarsest = 4;
    let queries = golden::probes(PROBES, coarsest, 7);
    let least = PROBES / 100;
    let u = |test: fn(f32) -> bool| queries.u.iter().filter(|u| u.iter().any(|x| test(*x))).count();
    let level = |test: &dyn Fn(f32) -> bool| queries.level.iter().filter(|l| test(**l)).count();
    let grazing = |w: &&[f32; 2]| above_horizon(**w) && w[0].hypot(w[1]) > 0.99;
    let below = |w: &&[f32; 2]| !above_horizon(**w);
    for (edge, count) in [
        ("negative u", u(|x| x < 0.0)),
        ("u beyond a hundred tiles", u(|x| x.abs() > 100.0)),
        ("u within the tile", u(|x| (0.0..1.0).contains(&x))),
        ("level below 0", level(&|l| l < 0.0)),
        ("level beyond the last", level(&|l| l > coarsest as f32)),
        ("fractional level", level(&|l| l > 0.0 && l < coarsest as f32 && l.fract() != 0.0)),
        ("whole level", level(&|l| l.fract() == 0.0)),
        ("grazing light", queries.wi.iter().filter(grazing).count()),
        ("grazing view", queries.wo.iter().filter(grazing).count()),
        ("light below the horizon", queries.wi.iter().filter(below).count()),
        ("view below the horizon", queries.wo.iter().filter(below).count()),
    ] {
        assert!(count > least, "{edge}: {count} of {PROBES}");
    }
}

#[test]
fn the_graph_of_a_trained_material_answers_as_the_model_does() {
    let checkpoint = trained();
    let queries = probes(&checkpoint);
    let expected = answers(&checkpoint, &queries);
    let difference = largest_difference(&graph_answers(&checkpoint, &queries), &expected);
    let (lit, spread) = (lit(&expected), spread(&expected));
    println!("in-process, trained: {difference:.2e} on {PROBES} queries, {lit} lit, spread {spread:.3}");
    assert!(lit > LEAST_LIT && spread > LEAST_SPREAD);
    assert!(difference <= TOLERANCE, "{difference:e}");
    for (k, (wi, wo)) in queries.wi.iter().zip(&queries.wo).enumerate() {
        assert!((above_horizon(*wi) && above_horizon(*wo)) || expected[k] == [0.0; 3]);
    }
}

/// Adds [`CHANGED_PARAMETER`] to a parameter of a tensor that is in use: most are, but a neuron may never fire.
fn changed(checkpoint: &Checkpoint, name: &str, queries: &QueryBuffer, expected: &[[f32; 3]]) -> Checkpoint {
    let data = &checkpoint.tensors[name].data;
    let mut largest_first: Vec<usize> = (0..data.len()).collect();
    largest_first.sort_by(|&a, &b| data[b].abs().total_cmp(&data[a].abs()));
    for place in largest_first {
        let mut changed = checkpoint.clone();
        changed.tensors.get_mut(name).unwrap().data[place] += CHANGED_PARAMETER;
        if largest_difference(&answers(&changed, queries), expected) > 2.0 * TOLERANCE {
            return changed;
        }
    }
    panic!("no answer depends on {name}");
}

#[test]
fn one_changed_parameter_of_any_tensor_is_noticed() {
    let checkpoint = trained();
    let queries = probes(&checkpoint);
    let expected = answers(&checkpoint, &queries);
    for name in checkpoint.tensors.keys() {
        let changed = changed(&checkpoint, name, &queries, &expected);
        let answer = graph_answers(&changed, &queries);
        let difference = largest_difference(&answer, &expected);
        println!("one value of {name} changed: {difference:.2e}");
        assert!(difference > TOLERANCE, "{name}: {difference:e}");
        assert!(largest_difference(&answer, &answers(&changed, &queries)) <= TOLERANCE, "{name}");
    }
}

#[test]
fn graphs_of_every_architecture_answer_as_the_model_does() {
    type Change = fn(&mut ModelConfig);
    let cases: [(&str, &str, Change); 7] = [
        ("neumip", "masked, in YUV", |m| (m.output.mask, m.output.space) = (true, OutputSpace::Yuv)),
        ("neumip", "without parallax and exponential", |m| {
            m.parallax = ParallaxConfig::None {};
            m.output.transform = OutputTransform::Identity;
        }),
        ("paper", "as it is", |_| ()),
        ("paper", "without pi, z of directions", |m| (m.encoding.pi, m.encoding.components) = (false, 3)),
        ("improved", "as it is", |_| ()),
        ("improved", "without its finest level", |m| m.texture.finest = 1),
        ("improved", "raw u, one level, in RGB", |m| {
            (m.encoding.u.raw, m.texture.levels, m.output.space) = (true, Some(1), OutputSpace::Rgb);
        }),
    ];
    for (preset, name, change) in cases {
        let checkpoint = untrained(preset, change, [24, 40]);
        let queries = probes(&checkpoint);
        let expected = answers(&checkpoint, &queries);
        let mut answer = graph_answers(&checkpoint, &queries);
        let difference = largest_difference(&answer, &expected);
        let spread = spread(&expected);
        println!("in-process, {preset} {name}: {difference:.2e}, spread {spread:.3}, {} lit", lit(&expected));
        assert!(spread > LEAST_SPREAD, "{preset} {name}: {spread}");
        assert!(difference <= TOLERANCE, "{preset} {name}: {difference:e}");
        answer[PROBES / 2][1] += CHANGED_ANSWER;
        assert!(largest_difference(&answer, &expected) > TOLERANCE);
    }
}

#[test]
fn graphs_of_images_answer_as_the_model_does_in_every_engine() {
    type Change = fn(&mut ModelConfig);
    let cases: [(&str, Change, [usize; 2]); 3] = [
        ("inception-small", |_| (), [64, 64]),
        ("inception-small", |m| (m.output.mask, m.texture.finest) = (true, 1), [16, 48]),
        // Whole tiles of two texels: margins wrap more than once.
        ("inception-small", |m| m.encoding.u.attenuate = false, [2, 4]),
    ];
    for (preset, change, resolution) in cases {
        let checkpoint = untrained(preset, change, resolution);
        let folder = bundle(&checkpoint);
        let read = read_bundle(&folder.path().join("bundle")).unwrap();
        assert_eq!(read.sidecar.neighbourhood, Some(4));
        assert!(read.sidecar.graphs[0].inputs.iter().all(|port| port.shape[..3] == ["N", "H", "W"]));
        let Golden { tolerance, u, wi, wo, level, rgb, images } = read.golden.clone();
        let queries = QueryBuffer::new(1, rgb.len(), u, wi, wo, level).unwrap();
        let graph = OnnxMaterial::open(&folder.path().join("bundle/material.onnx")).unwrap();
        let difference = largest_difference(&graph.answers(&queries, images).unwrap(), &rgb);
        println!("in-process, {preset} on {resolution:?}, {images:?}: {difference:.2e}, {} lit", lit(&rgb));
        assert!(difference <= tolerance && lit(&rgb) > rgb.len() / 3, "{difference:e}");
        // Images of another size wrap elsewhere.
        let [count, height, width] = images.unwrap();
        let other = graph.answers(&queries, Some([2 * count, height / 2, width])).unwrap();
        assert!(height < 4 || largest_difference(&other, &rgb) > tolerance);

        let mut expected = read.golden;
        let checked = check_in_python(folder.path(), &expected).unwrap();
        println!("in Python: {checked:?}");
        for difference in checked.differences() {
            assert!(difference <= tolerance, "{checked:?}");
        }
        expected.rgb[7][0] += CHANGED_ANSWER;
        let checked = check_in_python(folder.path(), &expected).unwrap();
        assert!(checked.differences().iter().all(|d| *d > tolerance));
    }
}

#[test]
fn the_golden_file_is_what_candle_and_the_graph_answer() {
    let checkpoint = trained();
    let folder = bundle(&checkpoint);
    let read = read_bundle(&folder.path().join("bundle")).unwrap();
    assert_eq!(read.checkpoint, checkpoint);
    assert_eq!(read.golden, golden::answers(&checkpoint, golden::QUERIES).unwrap());
    let Golden { tolerance, u, wi, wo, level, rgb, .. } = read.golden;
    assert_eq!((tolerance, rgb.len()), (TOLERANCE, golden::QUERIES));
    let queries = QueryBuffer::new(1, rgb.len(), u, wi, wo, level).unwrap();
    let graph = OnnxMaterial::open(&folder.path().join("bundle/material.onnx")).unwrap();
    let mut answer = graph.evaluate(&queries).unwrap().pixels;
    assert!(largest_difference(&answer, &rgb) <= tolerance);
    answer[10][2] += CHANGED_ANSWER;
    assert!(largest_difference(&answer, &rgb) > tolerance);
    answer[10][2] = f32::NAN;
    assert!(largest_difference(&answer, &rgb).is_nan());
}

/// The bundle of a checkpoint with half textures, in `bundle` of the folder, and what it says that costs.
fn half_bundle(checkpoint: &Checkpoint) -> (TempDir, Rounding) {
    let folder = tempfile::tempdir().unwrap();
    let Rounded { checkpoint, golden, cost } =
        golden::rounded(checkpoint, Storage::HALF_TEXTURES, golden::QUERIES).unwrap();
    Contents { rounding: Some(cost), ..Contents::new(&checkpoint, &golden) }
        .write(&folder.path().join("bundle"), false)
        .unwrap();
    (folder, cost)
}

#[test]
fn a_bundle_with_half_textures_is_one_model_and_says_how_far_it_is_from_the_other() {
    for (name, checkpoint) in [("trained", trained()), ("improved", untrained("improved", |_| (), [24, 40]))]
    {
        let (folder, cost) = half_bundle(&checkpoint);
        let read = read_bundle(&folder.path().join("bundle")).unwrap();
        assert_eq!(read.checkpoint, Storage::HALF_TEXTURES.round(checkpoint.clone()).unwrap());
        assert_eq!(read.golden, golden::answers(&read.checkpoint, golden::QUERIES).unwrap());
        assert_eq!(read.sidecar.rounding, Some(cost));

        let before = golden::answers(&checkpoint, golden::QUERIES).unwrap();
        let largest = largest_difference(&read.golden.rgb, &before.rgb);
        let Rounding { largest_difference: said, mean_difference: mean, .. } = cost;
        println!("half textures, {name}: at most {said:.2e}, mean {mean:.2e}");
        // One is a difference of 32-bit floats, the other of 64-bit ones.
        assert!((said - largest).abs() < 1e-6, "{name}: {said:e} is said, {largest:e} is true");
        assert!(mean > 0.0 && mean < said && said < LARGEST_ROUNDING, "{name}: {cost:?}");
        assert!(said > TOLERANCE, "{name}: a bundle that was not rounded would pass");
        let mut moved = read.checkpoint;
        moved.tensors.values_mut().rfind(|tensor| tensor.shape.len() == 3).unwrap().data[0] += MOVED_TEXEL;
        let moved = golden::answers(&moved, golden::QUERIES).unwrap();
        assert!(largest_difference(&moved.rgb, &before.rgb) > LARGEST_ROUNDING, "{name}: one texel moved");

        let Golden { u, wi, wo, level, rgb, .. } = read.golden;
        let queries = QueryBuffer::new(1, rgb.len(), u, wi, wo, level).unwrap();
        let graph = OnnxMaterial::open(&folder.path().join("bundle/material.onnx")).unwrap();
        let mut answer = graph.evaluate(&queries).unwrap().pixels;
        assert!(largest_difference(&answer, &rgb) <= TOLERANCE, "{name}");
        assert!(largest_difference(&answer, &before.rgb) > TOLERANCE, "{name}");
        answer[10][1] += CHANGED_ANSWER;
        assert!(largest_difference(&answer, &rgb) > TOLERANCE, "{name}");
    }
}

/// What `neumip evaluate --half-textures` measures is what `neumip export --half-textures` writes.
#[test]
fn the_engine_with_half_textures_answers_as_the_bundle_with_them() {
    let checkpoint = trained();
    let queries = probes(&checkpoint);
    let bundled = answers(&Storage::HALF_TEXTURES.round(checkpoint.clone()).unwrap(), &queries);
    let engine = |precision| {
        let answerer = answerer(&checkpoint, None, precision, &Device::Cpu).unwrap();
        answerer.material.evaluate(&queries).unwrap().pixels
    };
    let difference = largest_difference(&engine(Precision::Half), &bundled);
    println!("fused with half textures against the rounded checkpoint: {difference:.2e}");
    assert!(difference <= TOLERANCE, "{difference:e}");
    assert!(largest_difference(&engine(Precision::Single), &bundled) > TOLERANCE);
}

#[test]
fn half_textures_halve_the_graph_where_they_are_most_of_it() {
    let checkpoint = untrained("neumip", |_| (), [64, 64]);
    let size = |folder: &TempDir| {
        std::fs::metadata(folder.path().join("bundle/material.onnx")).unwrap().len() as f64
    };
    let (single, half) = (size(&bundle(&checkpoint)), size(&half_bundle(&checkpoint).0));
    println!("material.onnx: {single} bytes, {half} with half textures ({:.3})", half / single);
    assert!(half < MOST_LEFT * single, "{half} of {single}");
    assert!(half > 0.5 * single, "{half} of {single}: something is missing");
}

#[test]
fn the_default_bundle_is_what_it_was() {
    let checkpoint = trained();
    let folder = bundle(&checkpoint);
    let out = folder.path().join("bundle");
    let version = env!("CARGO_PKG_VERSION").as_bytes();
    // Field 3 of the model, a string.
    let field = [&[3 << 3 | 2, version.len() as u8], version].concat();
    let read = |name: &str| std::fs::read(out.join(name)).unwrap();
    for (name, expected) in DEFAULT_FILES {
        let mut bytes = read(name);
        if let Some(at) = bytes.windows(field.len()).position(|part| part == field) {
            bytes.drain(at..at + field.len());
        }
        let digest: String = Sha256::digest(&bytes).iter().map(|b| format!("{b:02x}")).collect();
        assert_eq!(digest, expected, "{name}");
    }
    let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/tiny.safetensors");
    assert_eq!(read("model.safetensors"), std::fs::read(fixture).unwrap());
    let sidecar = String::from_utf8(read("material.json")).unwrap();
    let keys: Vec<&str> = sidecar.lines().filter_map(|l| l.strip_prefix("  \"")?.split('"').next()).collect();
    let expected = [
        "format",
        "material",
        "measure",
        "height_range",
        "resolution",
        "levels",
        "cost",
        "errors",
        "conventions",
        "evaluate",
        "graphs",
        "textures",
        "weights",
        "shaders",
        "architecture",
        "files",
    ];
    assert_eq!(keys, expected);
}

#[test]
fn an_altered_file_of_a_bundle_is_refused_by_name() {
    let checkpoint = trained();
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("bundle");
    let golden = golden::answers(&checkpoint, golden::QUERIES).unwrap();
    let files = Contents::new(&checkpoint, &golden).write(&out, false).unwrap();
    for name in files.iter().map(|f| &f.name).filter(|name| *name != neumip::export::bundle::SIDECAR) {
        let whole = std::fs::read(out.join(name)).unwrap();
        let mut altered = whole.clone();
        altered[whole.len() / 2] ^= 1;
        std::fs::write(out.join(name), &altered).unwrap();
        let error = read_bundle(&out).unwrap_err().to_string();
        assert!(error.contains(name.as_str()) && error.contains("was altered"), "{name}: {error}");
        std::fs::write(out.join(name), &whole).unwrap();
    }
    assert!(files.len() > 6);
    read_bundle(&out).unwrap();
}

/// What `check_bundle.py` prints.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Checked {
    queries: usize,
    /// Of what answered, for the one who reads a failure.
    #[allow(dead_code)]
    versions: BTreeMap<String, String>,
    material: f64,
    decoder: f64,
    reference: f64,
    /// Of `prepare.onnx` and `evaluate.onnx`, where the decoder does not read neighbours.
    steps: Option<f64>,
}

impl Checked {
    pub fn differences(&self) -> Vec<f64> {
        [self.material, self.decoder, self.reference].into_iter().chain(self.steps).collect()
    }
}

/// Runs `check_bundle.py` on the bundle in `folder`.
pub fn check_in_python(folder: &Path, queries: &Golden) -> Result<Checked, String> {
    let file = folder.join("queries.json");
    std::fs::write(&file, serde_json::to_vec(queries).unwrap()).unwrap();
    let repository = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut command = python_environment::environment().script(&repository.join("tests/check_bundle.py"));
    command.arg(repository.join("export/consumers/python")).arg(folder.join("bundle")).arg(file);
    let output = command.output().unwrap();
    if !output.status.success() {
        return Err(String::from_utf8_lossy(&output.stderr).into_owned());
    }
    Ok(serde_json::from_slice(&output.stdout).unwrap())
}

#[test]
fn onnxruntime_and_numpy_answer_as_the_model_does() {
    let checkpoint = trained();
    let folder = bundle(&checkpoint);
    let mut expected = golden::answers(&checkpoint, PROBES).unwrap();
    let checked = check_in_python(folder.path(), &expected).unwrap();
    println!("in Python, trained: {checked:?}");
    assert_eq!((checked.queries, checked.differences().len()), (PROBES, 4));
    for difference in checked.differences() {
        assert!(difference <= TOLERANCE, "{checked:?}");
    }

    expected.rgb[PROBES / 2][0] += CHANGED_ANSWER;
    let checked = check_in_python(folder.path(), &expected).unwrap();
    for difference in checked.differences() {
        assert!(difference > TOLERANCE, "{checked:?}");
    }
}

#[test]
fn onnxruntime_and_numpy_answer_as_the_model_with_half_textures_does() {
    let checkpoint = trained();
    let (folder, _) = half_bundle(&checkpoint);
    let rounded = Storage::HALF_TEXTURES.round(checkpoint.clone()).unwrap();
    let checked = check_in_python(folder.path(), &golden::answers(&rounded, PROBES).unwrap()).unwrap();
    println!("in Python, half textures: {checked:?}");
    for difference in checked.differences() {
        assert!(difference <= TOLERANCE, "{checked:?}");
    }
    let checked = check_in_python(folder.path(), &golden::answers(&checkpoint, PROBES).unwrap()).unwrap();
    for difference in checked.differences() {
        assert!(difference > TOLERANCE, "answers as if nothing were rounded: {checked:?}");
    }
}

#[test]
fn the_checker_in_python_refuses_a_graph_that_is_none() {
    let checkpoint = trained();
    for graph in ["decoder.onnx", "material.onnx"] {
        let folder = bundle(&checkpoint);
        let path = folder.path().join("bundle").join(graph);
        let mut bytes = std::fs::read(&path).unwrap();
        let relu = bytes.windows(4).position(|w| w == b"Relu").unwrap();
        bytes[relu..relu + 4].copy_from_slice(b"Rely");
        std::fs::write(&path, bytes).unwrap();
        let golden = golden::answers(&checkpoint, golden::QUERIES).unwrap();
        let problem = check_in_python(folder.path(), &golden).unwrap_err();
        assert!(problem.contains("Rely"), "{problem}");
    }
}
