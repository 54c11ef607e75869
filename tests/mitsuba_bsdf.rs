//! The Mitsuba 3 consumer: what a renderer that we did not write sees through the plugin is what the material answers.
//! `mitsuba_bsdf.py` measures, this file judges. Without network or Python the tests are skipped, and say so; so is the llvm
//! variant where there is no LLVM 17 or newer.

use crate::{fitted, mitsuba};
use neumip::export::{Checkpoint, Contents};
use neumip::golden;
use serde_json::Value;
use std::path::Path;

/// Largest difference of a golden answer: the tolerance that bundles state.
const GOLDEN: f64 = golden::TOLERANCE;
/// What the twin changes one weight by: a percent of a weight of usual size.
const CHANGED_WEIGHT: f32 = 1e-2;
/// Largest disagreement of sample, eval, pdf and eval_pdf: they do the same arithmetic in another order.
const CONSISTENCY: f64 = 1e-4;
/// Largest relative difference of the density from its definition. Measured: 1.0e-5.
const DENSITY: f64 = 1e-4;
/// Largest error of the density's integral by 160,000 midpoints. Measured: 6e-6, with lobes a tenth wide.
const INTEGRAL: f64 = 1e-3;
/// Least p-value of the chi-square test. Its random numbers are the same each time; by chance 1 of 1,000 others falls below.
const LEAST_P: f64 = 1e-3;
/// Largest difference of 99 % of a picture's pixels. Positions of a hit are rounded to 1e-7 of the scene, which the position's
/// highest octave multiplies by 400. Measured: 1.1e-3.
const PICTURE: f64 = 4e-3;
/// Least share of a picture that has to be lit, so that black is not compared with black.
const LIT: f64 = 0.3;
/// Largest mean difference of deferred shading over the mean: noise of 16 samples a pixel at places drawn at random. Measured: 0.11.
const DEFERRED: f64 = 0.2;
/// Largest relative difference of the albedo: noise of 65,536 paths. Measured: 0.013.
const FURNACE: f64 = 0.03;

fn number(result: &Value, pointer: &str) -> f64 {
    // JSON has no NaN: Python writes one as a bare word, which does not parse.
    let value = result.pointer(pointer).and_then(Value::as_f64);
    value.unwrap_or_else(|| panic!("{pointer} is missing in {result}"))
}

/// Asserts that one number is within a bound, and that its twin is not.
fn holds(result: &Value, pointer: &str, twin: &str, most: f64) {
    let [value, spoiled] = [pointer, twin].map(|at| number(result, at));
    assert!(value <= most, "{pointer}: {value} > {most}");
    assert!(spoiled > most, "{twin}: {spoiled} is taken for right, within {most}");
}

/// The bundle of the trained fixture, and of one that differs by a weight and has the same golden answers.
fn bundles(folder: &Path) -> [std::path::PathBuf; 2] {
    let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/tiny.safetensors");
    let checkpoint = Checkpoint::read(&fixture).unwrap();
    let answers = golden::answers(&checkpoint, golden::QUERIES).unwrap();
    let mut changed = checkpoint.clone();
    changed.tensors.get_mut("decoder.mlp.1.weight").unwrap().data[0] += CHANGED_WEIGHT;
    let (_, fitted) = fitted::materials().swap_remove(0);
    let of_fitted = golden::answers(&fitted, golden::QUERIES).unwrap();
    for (name, checkpoint) in [("window", &fitted), ("misplaced", &fitted::misplaced(&fitted))] {
        Contents::new(checkpoint, &of_fitted).write(&folder.join(name), false).unwrap();
    }
    [("bundle", checkpoint), ("twin", changed)].map(|(name, checkpoint)| {
        let path = folder.join(name);
        Contents::new(&checkpoint, &answers).write(&path, false).unwrap();
        path
    })
}

/// What `mitsuba_bsdf.py` measures in a variant; `None` where it cannot run, which is said.
fn measured(variant: &str) -> Option<Value> {
    let python = match mitsuba::environment() {
        Ok(python) => python,
        Err(problem) => {
            println!("SKIPPED: the consumer for Mitsuba 3 needs its Python package: {problem}");
            return None;
        }
    };
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = tempfile::tempdir().unwrap();
    let [bundle, twin] = bundles(folder.path());
    let out = folder.path().join("result.json");
    let mut command = python.script(&root.join("tests/mitsuba_bsdf.py"));
    command.arg(root.join("export/consumers")).arg(variant);
    let run = command.args([&bundle, &twin]).arg(folder.path()).arg(&out).output().unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let result: Value = serde_json::from_slice(&std::fs::read(&out).unwrap()).unwrap();
    if let Some(missing) = result["missing"].as_str() {
        println!("SKIPPED: Mitsuba's {variant}: {missing}");
        return None;
    }
    println!("Mitsuba {variant}: {result:#}");
    Some(result)
}

/// What holds in every variant.
fn judge(result: &Value) {
    assert_eq!(number(result, "/golden/1"), GOLDEN, "the bundle states another tolerance");
    holds(result, "/golden/0", "/twin/0", GOLDEN);
    holds(result, "/fitted/window", "/fitted/misplaced", GOLDEN);
    for sampler in ["cosine", "mixture"] {
        let at = |name: &str| format!("/sampling/{sampler}/{name}");
        holds(result, &at("consistency"), &at("inconsistency"), CONSISTENCY);
        assert_eq!(number(result, &at("below")), 0.0, "light from below the horizon");
    }
    holds(result, "/sampling/mixture/density", "/sampling/mixture/density_twin", DENSITY);
    for scene in ["plane", "sphere"] {
        let at = |name: &str| format!("/pictures/{scene}/{name}");
        assert!(number(result, &at("lit")) >= LIT, "{scene} is dark");
        holds(result, &at("difference"), &at("flipped"), PICTURE);
        holds(result, &at("difference"), &at("blurred"), PICTURE);
    }
}

#[test]
fn the_plugin_answers_in_scalar_mitsuba() {
    let Some(result) = measured("scalar_rgb") else { return };
    judge(&result);
    holds(&result, "/deferred/0", "/deferred/1", DEFERRED);
    assert_eq!(result["refusals"], Value::Array(Vec::new()), "said of bad input");
}

#[test]
fn the_plugin_answers_in_compiled_mitsuba() {
    let Some(result) = measured("llvm_ad_rgb") else { return };
    judge(&result);
    for sampler in ["cosine", "mixture"] {
        let at = |name: &str| format!("/sampling/{sampler}/{name}");
        holds(&result, &at("integral"), &at("part"), INTEGRAL);
        let [p, spoiled] = [at("chi2"), at("chi2_twin")].map(|at| number(&result, &at));
        assert!(p >= LEAST_P, "{sampler}: samples do not follow the density, p = {p}");
        assert!(spoiled < LEAST_P, "{sampler}: spoiled samples are taken for right, p = {spoiled}");
    }
    holds(&result, "/furnace/difference", "/furnace/twin", FURNACE);
    for albedo in result["furnace"]["albedo"].as_array().unwrap() {
        let albedo = albedo.as_f64().unwrap();
        assert!(albedo > 0.0 && albedo <= 1.0, "an albedo of {albedo}");
    }
}

/// Largest `mse` between pictures of two programs. Measured: 1.2e-6 for Mitsuba, whose footprints are differences; 3e-12 for the
/// browser.
const SAME_PICTURE: f64 = 1e-5;

#[test]
fn three_programs_make_the_same_pictures() {
    let python = match mitsuba::environment() {
        Ok(python) => python,
        Err(problem) => return println!("SKIPPED: pictures of Mitsuba 3 need its Python package: {problem}"),
    };
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = tempfile::tempdir().unwrap();
    let [bundle, _] = bundles(folder.path());
    let mut command = python.script(&root.join("scripts/side_by_side.py"));
    command.arg(&bundle).args([
        "--size",
        "64",
        "--variant",
        "scalar_rgb",
        "--neumip",
        env!("CARGO_BIN_EXE_neumip"),
    ]);
    let run = command.arg("--out").arg(folder.path().join("side.png")).output().unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let table = std::fs::read(folder.path().join("side.json")).unwrap();
    let table: Value = serde_json::from_slice(&table).unwrap();
    let rows = table.as_array().unwrap();
    assert!(rows.iter().filter(|row| row["program"] == "Mitsuba 3").count() == 2, "{table:#}");
    for row in rows {
        println!("{row}");
        holds(row, "/mse", "/mirrored", SAME_PICTURE);
    }
    if rows.len() < 4 {
        println!("SKIPPED: there is no Chromium for the viewer's pictures");
    }
}
