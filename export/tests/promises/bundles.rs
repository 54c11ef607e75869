//! A bundle is complete, verifies itself, and replaces nothing by accident.

use crate::{materials, plain};
use neumip_export::{Checkpoint, Contents, Golden, read_bundle};
use std::path::Path;

/// A case's checkpoint, with golden answers by plain loops.
fn material(case: usize) -> (&'static str, Checkpoint, Golden) {
    let (name, model, resolution) = materials::cases().remove(case);
    let checkpoint = materials::checkpoint(&model, resolution, 11);
    let mut golden = materials::queries(&checkpoint.header.architecture, 256, 12);
    golden.rgb = (0..golden.u.len())
        .map(|i| {
            let (u, wi, wo, level) = (golden.u[i], golden.wi[i], golden.wo[i], golden.level[i]);
            let features = plain::features(&checkpoint, u, wo, level);
            plain::decode(&checkpoint, &features, u, wi, wo, level).map(|v| v as f32)
        })
        .collect();
    (name, checkpoint, golden)
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn a_bundle_is_complete_and_reads_back() {
    let folder = tempfile::tempdir().unwrap();
    let (_, checkpoint, golden) = material(1);
    let out = folder.path().join("bundle");
    let files = Contents::new(&checkpoint, &golden).write(&out, false).unwrap();
    let expected = [
        "README.txt",
        "decoder.onnx",
        "evaluate.onnx",
        "exact.es.glsl",
        "exact.glsl",
        "exact.hlsl",
        "exact.wgsl",
        "fast.es.glsl",
        "fast.glsl",
        "fast.hlsl",
        "fast.wgsl",
        "golden.json",
        "material.json",
        "material.onnx",
        "model.safetensors",
        "offset-0.exr",
        "offset-1.exr",
        "prepare.onnx",
        "texture-0.exr",
        "texture-1.exr",
        "weights-f16.bin",
        "weights-f32.bin",
    ];
    assert_eq!(names(&out), expected);
    assert_eq!(files.len(), expected.len());
    assert_eq!(names(folder.path()), ["bundle"], "something stays behind");
    let bundle = read_bundle(&out).unwrap();
    assert_eq!((&bundle.checkpoint, &bundle.golden), (&checkpoint, &golden));
    assert_eq!(bundle.sidecar.errors, checkpoint.header.errors);
    let again = folder.path().join("again");
    assert_eq!(
        Contents::new(&checkpoint, &golden).write(&again, false).unwrap(),
        files,
        "not the same bytes"
    );
}

#[test]
fn missing_altered_and_foreign_files_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let (_, checkpoint, golden) = material(6);
    let out = folder.path().join("bundle");
    for entry in Contents::new(&checkpoint, &golden).write(&out, false).unwrap() {
        let path = out.join(&entry.name);
        let bytes = std::fs::read(&path).unwrap();
        let check = |what: &str| {
            let error = read_bundle(&out).expect_err(&entry.name).to_string();
            assert!(error.contains(&format!("bundle/{}: ", entry.name)), "{what}: {error}");
        };
        std::fs::remove_file(&path).unwrap();
        check("missing");
        let mut altered = bytes.clone();
        let middle = altered.len() / 2;
        altered[middle] = altered[middle].wrapping_add(1) & 0x7f;
        // One altered byte of the description may still be a valid description, so that one is cut.
        if entry.name == "material.json" {
            altered.truncate(middle);
        }
        std::fs::write(&path, &altered).unwrap();
        check("altered");
        std::fs::write(&path, &bytes[..bytes.len() - 1]).unwrap();
        check("cut");
        std::fs::write(&path, &bytes).unwrap();
        read_bundle(&out).unwrap();
    }
    let sidecar = out.join("material.json");
    let text = std::fs::read_to_string(&sidecar).unwrap();
    for (from, to, reason) in [
        ("\"format\": 1", "\"format\": 2", "version 2"),
        ("\"name\": \"README.txt\"", "\"name\": \"../README.txt\"", "is not the name"),
        ("\"name\": \"README.txt\"", "\"name\": \"golden.json\"", "is not the name"),
        ("\"name\": \"decoder.onnx\"", "\"name\": \"other.onnx\"", "is described and not listed"),
        ("\"flops_per_query\"", "\"flips_per_query\"", "unknown field"),
    ] {
        assert!(text.contains(from));
        std::fs::write(&sidecar, text.replace(from, to)).unwrap();
        let error = read_bundle(&out).unwrap_err().to_string();
        assert!(error.contains("material.json: ") && error.contains(reason), "{error}");
    }
}

#[test]
fn nothing_is_replaced_by_accident() {
    let folder = tempfile::tempdir().unwrap();
    let (_, checkpoint, golden) = material(6);
    let out = folder.path().join("bundle");
    Contents::new(&checkpoint, &golden).write(&out, false).unwrap();
    let error = Contents::new(&checkpoint, &golden).write(&out, false).unwrap_err().to_string();
    assert!(error.contains("bundle: exists"), "{error}");

    let mut other = checkpoint.clone();
    other.header.material = "other".into();
    Contents::new(&other, &golden).write(&out, true).unwrap();
    assert_eq!(read_bundle(&out).unwrap().sidecar.material, "other");

    let mut bad = checkpoint.clone();
    bad.tensors.get_mut("texture.level0").unwrap().data[0] = 1e6;
    let error = Contents::new(&bad, &golden).write(&out, true).unwrap_err().to_string();
    assert!(error.contains("texture.level0"), "{error}");
    assert_eq!(read_bundle(&out).unwrap().sidecar.material, "other", "a failed write lost the old bundle");

    let precious = folder.path().join("precious");
    std::fs::create_dir(&precious).unwrap();
    std::fs::write(precious.join("thesis.txt"), "years").unwrap();
    assert!(Contents::new(&checkpoint, &golden).write(&precious, true).is_err());
    assert_eq!(names(&precious), ["thesis.txt"]);
    assert_eq!(names(folder.path()), ["bundle", "precious"], "something stays behind");
}

#[test]
fn golden_answers_are_checked() {
    let (_, _, golden) = material(6);
    golden.validate().unwrap();
    type Change = fn(&mut Golden);
    let changes: [(&str, Change); 5] = [
        ("golden.tolerance", |g| g.tolerance = 0.0),
        ("golden.level", |g| g.level.truncate(9)),
        ("golden.rgb[3]", |g| g.rgb[3][1] = f32::NAN),
        ("golden.u", |g| g.u.clear()),
        ("golden.wi", |g| g.wi.push([0.0; 2])),
    ];
    for (reason, change) in changes {
        let mut bad = golden.clone();
        change(&mut bad);
        let error = bad.validate().unwrap_err().to_string();
        assert!(error.contains(reason), "{reason}: {error}");
    }
}

/// Writes a bundle of every case into the folder named by `NEUMIP_BUNDLES`, for consumers in other languages.
#[test]
#[ignore = "writes where NEUMIP_BUNDLES says"]
fn write_every_case() {
    let Ok(folder) = std::env::var("NEUMIP_BUNDLES") else { return };
    for case in 0..materials::cases().len() {
        let (name, checkpoint, golden) = material(case);
        Contents::new(&checkpoint, &golden)
            .write(&Path::new(&folder).join(name.replace([' ', ','], "-")), true)
            .unwrap();
    }
}
