//! Materials that were fitted for a scene: every engine and artefact answers a query outside of what was fitted as the domain
//! says, by the fitted query that stands for it.

use crate::command_line::{refused, succeed, workshop};
use crate::onnx::{check_in_python, untrained};
use candle_core::Device;
use neumip::artefacts;
use neumip::dataset::{Dataset, SplitName};
use neumip::engine::FusedMaterial;
use neumip::export::{Checkpoint, Cone, Contents, Domain, Golden, read_bundle};
use neumip::golden::{self, BORDER, TOLERANCE};
use neumip::model::NeuralMaterial;
use neumip::outside::Count;
use neumip::query::{QueryBuffer, Reflectance};
use neumip::render::{Cosine, Model, OpenOptions, Scene, SceneFile};
use neumip::sampler::{self, Options, fit};
use serde_json::{Value, json};
use std::ops::ControlFlow;
use std::path::Path;

/// Queries that engines are compared on.
const QUERIES: usize = 4096;
/// Least and largest share of golden queries outside: a third.
const OUTSIDE: [f64; 2] = [0.3, 0.37];
/// Least share of those outside by position, and by level, of a window.
const EITHER: f64 = 0.1;
/// Steps of a sampler that is to answer, not to sample well.
const STEPS: u64 = 4;
/// Relative difference of sums in 64-bit floats of the same numbers in another order.
const SUMS: f64 = 1e-9;
/// Golden samples of a sampler.
const SAMPLES: usize = 256;

/// Checkpoints with a window over the border of the tile, with a band of it, and with the whole tile.
pub fn materials() -> Vec<(&'static str, Checkpoint)> {
    let places = [
        ("a window over the border", "improved", [24, 40], [64, 48], [50, 20], [0.0, 1.75]),
        ("a band of columns", "neumip", [32, 16], [32, 64], [0, 56], [0.5, 2.0]),
        ("the whole tile", "neumip", [24, 40], [24, 40], [0, 0], [1.0, 1.5]),
    ];
    let fitted = places.map(|(name, preset, resolution, tile, corner, levels)| {
        let mut checkpoint = untrained(preset, |_| (), resolution);
        let cone = Cone { axis: [0.0, 0.0, 1.0], cosine: 0.3 };
        let domain = Domain { scene: "near".into(), tile, corner, levels, wi: cone, wo: cone, floor: 0.1 };
        checkpoint.header.architecture.domain = Some(domain);
        checkpoint.header.architecture.validate().unwrap();
        (name, checkpoint)
    });
    fitted.into()
}

/// The same with its window a texel further, or with another finest level where the window is the whole tile.
pub fn misplaced(checkpoint: &Checkpoint) -> Checkpoint {
    let mut other = checkpoint.clone();
    let resolution = other.header.architecture.resolution;
    let domain = other.header.architecture.domain.as_mut().unwrap();
    match domain.tile == resolution {
        true => domain.levels[0] += 0.25,
        false => domain.corner[1] = (domain.corner[1] + 1) % domain.tile[1],
    }
    other
}

/// The model without its domain, and the queries that a domain leads to.
fn inner(checkpoint: &Checkpoint, queries: &QueryBuffer) -> (Checkpoint, QueryBuffer) {
    let (mut inner, mut led) = (checkpoint.clone(), queries.clone());
    inner.header.architecture.domain = None;
    for (u, level) in led.u.iter_mut().zip(&mut led.level) {
        (*u, *level) = checkpoint.header.architecture.fitted(*u, *level);
    }
    (inner, led)
}

/// Every way in which our engines answer.
fn answers(checkpoint: &Checkpoint, q: &QueryBuffer) -> [(&'static str, Vec<[f32; 3]>); 3] {
    let candle = NeuralMaterial::from_checkpoint(checkpoint, &Device::Cpu).unwrap();
    let fused = FusedMaterial::from_checkpoint(checkpoint).unwrap();
    let prepared = fused.prepare(&q.u, &q.level, &q.wo).unwrap();
    [
        ("candle", candle.evaluate(q).unwrap().pixels),
        ("fused", fused.evaluate(q).unwrap().pixels),
        ("fused in steps", fused.light(&prepared, &q.wi).unwrap()),
    ]
}

#[test]
fn engines_answer_fitted_materials_as_the_model_answers_the_queries_that_stand_for_theirs() {
    for (name, checkpoint) in materials() {
        let queries = golden::queries(&checkpoint.header.architecture, QUERIES, 3);
        let (inner, led) = inner(&checkpoint, &queries);
        let other = misplaced(&checkpoint);
        let ours = answers(&checkpoint, &queries).into_iter().zip(answers(&other, &queries));
        for (((by, answer), (_, moved)), (_, expected)) in ours.zip(answers(&inner, &led)) {
            // The same numbers go the same way.
            assert!(answer == expected, "{name}, {by}");
            assert!(moved != expected, "{name}, {by}: a window elsewhere answers the same");
        }
        let features = |checkpoint: &Checkpoint, q: &QueryBuffer| {
            FusedMaterial::from_checkpoint(checkpoint).unwrap().features(&q.u, &q.level, &q.wo).unwrap()
        };
        assert!(features(&checkpoint, &queries) == features(&inner, &led), "{name}");
        assert!(features(&other, &queries) != features(&inner, &led), "{name}");
    }
}

#[test]
fn a_third_of_the_golden_queries_is_outside_and_none_near_the_border() {
    for (name, checkpoint) in materials() {
        let architecture = &checkpoint.header.architecture;
        let guide = architecture.guide().unwrap();
        let queries = golden::queries(architecture, QUERIES, 1);
        assert!(queries.u.iter().all(|u| guide.border(*u) >= BORDER), "{name}");
        let of = |k: usize| architecture.outside(queries.u[k], [0.0; 2], [0.0; 2], queries.level[k]);
        let share =
            |test: &dyn Fn(usize) -> bool| (0..QUERIES).filter(|k| test(*k)).count() as f64 / QUERIES as f64;
        let all = share(&|k| of(k).any());
        assert!((OUTSIDE[0]..OUTSIDE[1]).contains(&all), "{name}: {all}");
        assert!(share(&|k| of(k).finer) + share(&|k| of(k).coarser) > EITHER, "{name}");
        assert_eq!(share(&|k| of(k).position) > EITHER, guide.is_window(), "{name}");
        assert!(share(&|k| of(k).finer) > 0.0 && share(&|k| of(k).coarser) > 0.0, "{name}");
    }
}

/// The bundle of a checkpoint with a sampler, in `bundle` of the folder.
fn write(checkpoint: &Checkpoint, folder: &Path) {
    let golden = golden::answers(checkpoint, golden::QUERIES).unwrap();
    let options = Options { steps: STEPS, ..Options::default() };
    let sampler = fit(checkpoint, &options, &mut |_, _| ControlFlow::Continue(())).unwrap();
    let samples = sampler::golden::golden(checkpoint, &sampler, SAMPLES, 1).unwrap();
    let contents = Contents { sampler: Some((&sampler, &samples)), ..Contents::new(checkpoint, &golden) };
    contents.write(&folder.join("bundle"), false).unwrap();
}

#[test]
fn every_artefact_of_a_fitted_material_answers_outside_of_what_was_fitted_too() {
    for (name, checkpoint) in materials() {
        let folder = tempfile::tempdir().unwrap();
        write(&checkpoint, folder.path());
        let path = folder.path().join("bundle");
        let mut bundle = read_bundle(&path).unwrap();
        let checked = artefacts::check(&path, &bundle).unwrap();
        for artefact in &checked {
            println!("{name}: {} ({}) {:.1e}", artefact.files, artefact.by, artefact.difference);
            assert!(artefact.is_right(), "{name}: {artefact:?}");
        }
        assert!(checked.iter().any(|a| a.files.contains("sample.onnx")), "{name}");
        let in_python = |golden: &Golden| check_in_python(folder.path(), golden).unwrap();
        let right = in_python(&bundle.golden);
        println!("{name}, in Python: {right:?}");
        assert!(right.differences().iter().all(|d| *d <= TOLERANCE), "{name}: {right:?}");
        assert_eq!(right.differences().len(), 4);

        // The answers of a window that is a texel further are those of no file here.
        bundle.golden = golden::answers(&misplaced(&checkpoint), golden::QUERIES).unwrap();
        let queries = golden::queries(&checkpoint.header.architecture, golden::QUERIES, 1);
        (bundle.golden.u, bundle.golden.level) = (queries.u.clone(), queries.level.clone());
        bundle.golden.rgb = answers(&misplaced(&checkpoint), &queries)[0].1.clone();
        let wrong = artefacts::check(&path, &bundle).unwrap();
        let answering = wrong.iter().filter(|a| !a.files.contains("sample") && !a.files.contains("pdf"));
        assert!(answering.filter(|a| a.bound == TOLERANCE).all(|a| !a.is_right()), "{name}: {wrong:?}");
        let wrong = in_python(&bundle.golden);
        assert!(wrong.differences().iter().all(|d| *d > TOLERANCE), "{name}: {wrong:?}");
    }
}

#[test]
fn a_bundle_says_what_it_was_fitted_for() {
    let (_, checkpoint) = materials().swap_remove(0);
    let folder = tempfile::tempdir().unwrap();
    write(&checkpoint, folder.path());
    let path = folder.path().join("bundle");
    let sidecar = read_bundle(&path).unwrap().sidecar;
    let domain = sidecar.domain.unwrap();
    assert_eq!((sidecar.resolution, domain.window), ([64, 48], [24, 40]));
    assert_eq!(Some(domain.bounds), checkpoint.header.architecture.domain);
    assert!(sidecar.evaluate[0].contains("elsewhere level = 3"), "{}", sidecar.evaluate[0]);
    let page = std::fs::read_to_string(path.join("README.txt")).unwrap();
    assert!(page.contains("FITTED FOR ONE SCENE") && page.contains("\"near\""), "{page}");
    let shader = std::fs::read_to_string(path.join("exact.glsl")).unwrap();
    assert!(shader.contains("finest level (64 x 48)") && shader.contains("fitted for one scene"), "{shader}");
}

/// A part of the tile of the command line's dataset.
fn small() -> Checkpoint {
    let mut checkpoint = untrained("neumip", |_| (), [8, 8]);
    let [wi, wo] = [0.6, 0.7].map(|cosine| Cone { axis: [0.0, 0.0, 1.0], cosine });
    let (tile, corner, levels) = ([16, 16], [12, 4], [0.0, 1.0]);
    let domain = Domain { scene: "near".into(), tile, corner, levels, wi, wo, floor: 0.1 };
    checkpoint.header.architecture.domain = Some(domain);
    checkpoint
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

#[test]
fn evaluations_tell_errors_inside_and_outside_apart() {
    let workshop = workshop();
    let folder = workshop.path();
    let checkpoint = small();
    checkpoint.write(&folder.join("fitted.safetensors")).unwrap();
    let said = succeed(folder, "evaluate fitted.safetensors run --data data --rounds 0 --json errors.json");
    assert!(said.contains("[1] by what it was fitted for") && !said.contains("[2] by what"), "{said}");
    let all = json(&folder.join("errors.json"));
    assert!(all[1].get("fitted").is_none());
    let table = all[0]["fitted"].as_array().unwrap();

    // Counted once more, split by split.
    let data = Dataset::open(folder.join("data")).unwrap();
    let material = FusedMaterial::from_checkpoint(&checkpoint).unwrap();
    let splits = data.split_names().into_iter().filter(|name| *name != SplitName::Train);
    for name in splits {
        let split = data.split(name).unwrap();
        let (mut asked, mut outside) = (0u64, 0u64);
        let (mut squares, mut values) = ([0.0f64; 2], [0u64; 2]);
        for file in 0..split.files() {
            for block in split.read_file(file).unwrap() {
                let q = block.queries(data.resolution());
                let answer = material.evaluate(&q).unwrap().pixels;
                for (k, target) in block.target().iter().enumerate() {
                    let architecture = &checkpoint.header.architecture;
                    let out = architecture.outside(q.u[k], q.wi[k], q.wo[k], q.level[k]).any();
                    asked += 1;
                    outside += u64::from(out);
                    for c in 0..3 {
                        let apart = f64::from(answer[k][c]) - f64::from(target[c]);
                        squares[usize::from(out)] += apart * apart;
                        values[usize::from(out)] += 1;
                    }
                }
            }
        }
        let row = table.iter().find(|row| row["split"] == name.as_str()).unwrap();
        assert_eq!([row["queries"].as_u64(), row["outside"].as_u64()], [Some(asked), Some(outside)]);
        assert!(outside > 0, "{name:?}");
        for (side, field) in ["errors_inside", "errors_outside"].into_iter().enumerate() {
            let Some(errors) = row[field].as_object() else {
                assert_eq!(values[side], 0, "{name:?}");
                continue;
            };
            let mean = squares[side] / values[side] as f64;
            let told = errors["mse_linear"].as_f64().unwrap();
            assert!((told - mean).abs() <= SUMS * mean, "{name:?}, {field}: {told} for {mean}");
            assert!((1.01 * told - mean).abs() > SUMS * mean, "{name:?}, {field}");
        }
    }
    assert!(table.iter().any(|row| row["split"] == "views/s4" && row["outside"].as_u64() > Some(0)));

    // Its resolution is the tile's, not the window's.
    refused(
        folder,
        &[("evaluate fitted.safetensors --data coarse --rounds 0", 1, &["coarse", "[8, 8]", "[16, 16]"])],
    );
}

#[test]
fn pictures_say_what_was_asked_outside_and_levels_count_the_texels_of_the_tile() {
    let workshop = workshop();
    let folder = workshop.path();
    let checkpoint = small();
    checkpoint.write(&folder.join("fitted.safetensors")).unwrap();
    let scene = json!({
        "version": 1,
        "materials": {"floor": {"checkpoint": "fitted.safetensors"}, "wall": {"lambert": 0.5}},
        "objects": [{"shape": "plane", "material": "floor", "scale": 4, "tiling": [6, 6]},
            {"shape": "sphere", "material": "wall", "scale": 0.3, "translate": [0, 0, 1]}],
        "lights": [{"directional": {"direction": [0, 0.5, 1], "irradiance": 1}}],
        "camera": {"width": 24, "samples": 1},
    });
    std::fs::write(folder.join("scene.json"), scene.to_string()).unwrap();
    let said = succeed(folder, "render --scene scene.json --out out --json out.json");
    assert!(
        said.contains("floor: outside of what it was fitted for: ") && !said.contains("wall: outside"),
        "{said}"
    );

    let path = folder.join("scene.json");
    let file = SceneFile::from_json(&scene.to_string(), &path).unwrap();
    let engine = |checkpoint: &Checkpoint, _: &Path| {
        let answers = Box::new(FusedMaterial::from_checkpoint(checkpoint)?);
        Ok(Model { answers, directions: Box::new(Cosine), identity: String::new() })
    };
    let options = OpenOptions { default_material: None, seed: 1, engine: &engine };
    let scene = Scene::open(file, &path, &options).unwrap();
    assert_eq!((scene.materials[0].resolution, scene.materials[0].coarsest), ([16, 16], 3.0));
    let frame = scene.frame(0).unwrap();
    let asked = scene.ask(&frame, 0..24 * 24).unwrap();
    let mut count = Count::default();
    count.add(&checkpoint.header.architecture, &asked.queries[0]);
    assert!(
        0 < count.position && count.position <= count.outside && count.outside < count.queries,
        "{count:?}"
    );
    let rows = json(&folder.join("out.json"));
    assert_eq!(rows["materials"][0]["outside"], serde_json::to_value(count).unwrap());
    assert!(rows["materials"][1].get("outside").is_none());
}

#[test]
fn info_says_what_a_checkpoint_was_fitted_for() {
    let workshop = workshop();
    let folder = workshop.path();
    let mut checkpoint = small();
    checkpoint.write(&folder.join("fitted.safetensors")).unwrap();
    let said: Value = serde_json::from_str(&succeed(folder, "info fitted.safetensors")).unwrap();
    assert_eq!(said["domain"]["bounds"]["tile"], json!([16, 16]));
    assert!(said["domain"]["meaning"][0].as_str().unwrap().contains("\"near\""));
    checkpoint.header.architecture.domain = None;
    checkpoint.write(&folder.join("plain.safetensors")).unwrap();
    let said: Value = serde_json::from_str(&succeed(folder, "info plain.safetensors")).unwrap();
    assert!(said.get("domain").is_none());
}
