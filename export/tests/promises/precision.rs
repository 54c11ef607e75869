//! Textures as half floats: rounded before everything else, stored in half the bytes, read by 32-bit arithmetic.

use crate::graphs::{TOLERANCE, expected, feeds, largest_difference, run};
use crate::materials;
use half::f16;
use neumip_export::config::{OFFSET_TEXTURE, texture_name};
use neumip_export::{Checkpoint, Contents, Golden, Rounding, Storage, onnx, read_bundle};

/// Queries a case.
const QUERIES: usize = 512;
/// Graphs whose textures are half floats.
const HALFS: onnx::Options = onnx::Options { storage: Storage::HALF_TEXTURES, opset: onnx::Opset::V17 };
/// Every way to store a model that is not as it was trained.
const STORAGES: [(&str, Storage); 3] =
    [("half textures", Storage::HALF_TEXTURES), ("halfs", Storage::HALF), ("bytes", Storage::BYTE)];
/// What a test says that rounding costs; bundles only carry it.
const COST: Rounding =
    Rounding { storage: Storage::HALF_TEXTURES, largest_difference: 3e-3, mean_difference: 2e-4 };

/// A case's checkpoint, rounded, and queries that it is golden for by definition.
fn rounded(case: usize) -> (Checkpoint, Golden) {
    let (_, model, resolution) = materials::cases().remove(case);
    let checkpoint = Storage::HALF_TEXTURES.round(materials::checkpoint(&model, resolution, 8)).unwrap();
    let mut golden = materials::queries(&checkpoint.header.architecture, 64, 9);
    golden.rgb = vec![[0.5; 3]; golden.u.len()];
    (checkpoint, golden)
}

fn is_texture(name: &str) -> bool {
    name.starts_with("texture.") || name == OFFSET_TEXTURE
}

#[test]
fn rounding_changes_textures_and_nothing_else() {
    for (name, model, resolution) in materials::cases() {
        let before = materials::checkpoint(&model, resolution, 8);
        assert_eq!(Storage::SINGLE.round(before.clone()).unwrap(), before, "{name}");
        let after = Storage::HALF_TEXTURES.round(before.clone()).unwrap();
        assert_eq!(after.header, before.header, "{name}");
        for (tensor, old) in &before.tensors {
            let new = &after.tensors[tensor];
            let nearest = old.data.iter().map(|v| f16::from_f32(*v).to_f32());
            match is_texture(tensor) {
                true => assert!(nearest.eq(new.data.iter().copied()) && new != old, "{name}: {tensor}"),
                false => assert_eq!(new, old, "{name}: {tensor}"),
            }
        }
        assert_eq!(Storage::HALF_TEXTURES.round(after.clone()).unwrap(), after, "{name}: rounded twice");
    }
}

#[test]
fn what_halfs_cannot_hold_is_refused_by_name() {
    let (_, model, resolution) = materials::cases().remove(0);
    for (tensor, value, fits) in [
        (texture_name(0), 65519.9, true),
        (texture_name(0), 65520.0, false),
        (texture_name(2), -7e4, false),
        (OFFSET_TEXTURE.to_string(), f32::MAX, false),
        (OFFSET_TEXTURE.to_string(), -1e-30, true),
        (texture_name(1), f32::NAN, false),
        ("decoder.mlp.0.weight".to_string(), 7e4, true),
    ] {
        let mut checkpoint = materials::checkpoint(&model, resolution, 8);
        checkpoint.tensors.get_mut(&tensor).unwrap().data[5] = value;
        match Storage::HALF_TEXTURES.round(checkpoint) {
            Ok(_) => assert!(fits, "{tensor}: {value}"),
            Err(e) => {
                let (error, part) =
                    (e.to_string(), if value.is_nan() { "NaN".into() } else { value.to_string() });
                assert!(!fits && error.contains(&tensor) && error.contains(&part), "{error}");
                assert_eq!(error.lines().count(), 1, "{error}");
            }
        }
    }
}

#[test]
fn graphs_answer_like_plain_loops_on_the_rounded_numbers() {
    for (stored, storage) in STORAGES {
        for (name, model, resolution) in materials::cases() {
            let name = format!("{name}, {stored}");
            let exact = materials::checkpoint(&model, resolution, 1);
            let checkpoint = storage.round(exact.clone()).unwrap();
            let queries = materials::queries(&checkpoint.header.architecture, QUERIES, 2);
            let options = onnx::Options { storage, ..HALFS };
            let graph = onnx::material_graph(&checkpoint, options).unwrap();
            let answers = run(graph, &feeds(&queries));
            let difference = largest_difference(&answers, &expected(&checkpoint, &queries).2);
            let rounding = largest_difference(&answers, &expected(&exact, &queries).2);
            println!("{name}: {difference:.1e}, off the model before rounding by {rounding:.1e}");
            assert!(difference < TOLERANCE, "{name}: {difference:e}");
            assert!(rounding > TOLERANCE, "{name}: answers as if nothing were rounded");

            let mut perturbed = checkpoint;
            let data = &mut perturbed.tensors.get_mut("texture.level0").unwrap().data;
            data.iter_mut().for_each(|v| *v = f16::from_f32(*v + 0.03).to_f32());
            let changed = largest_difference(&answers, &expected(&perturbed, &queries).2);
            assert!(changed > TOLERANCE, "{name}: {changed:e}");
        }
    }
}

#[test]
fn bytes_are_whole_multiples_of_a_channels_factor_and_half_floats_too() {
    for (name, model, resolution) in materials::cases() {
        let exact = materials::checkpoint(&model, resolution, 8);
        let rounded = Storage::BYTE.round(exact.clone()).unwrap();
        Storage::BYTE.check(&rounded).unwrap();
        Storage::HALF.check(&rounded).unwrap();
        assert!(Storage::BYTE.check(&exact).is_err(), "{name}");
        let textures = rounded.tensors.iter().filter(|(name, _)| is_texture(name));
        for (tensor, values) in textures {
            let channels = values.shape[2];
            for channel in 0..channels {
                let of = |data: &[f32]| -> Vec<f32> {
                    data.iter().skip(channel).step_by(channels).copied().collect()
                };
                let (before, after) = (of(&exact.tensors[tensor].data), of(&values.data));
                let mut distinct: Vec<u32> = after.iter().map(|v| v.abs().to_bits()).collect();
                distinct.sort_unstable();
                distinct.dedup();
                assert!(distinct.len() <= 128, "{name}: {tensor}");
                // A factor is at most 1/127 of the largest value, rounded up to four bits: 9/8 of that.
                let group = exact
                    .tensors
                    .iter()
                    .filter(|(n, _)| (*n == OFFSET_TEXTURE) == (tensor == OFFSET_TEXTURE));
                let group = group.filter(|(n, _)| is_texture(n)).flat_map(|(_, t)| of(&t.data));
                let step = group.fold(0.0f32, |m, v| m.max(v.abs())) / 127.0 * 1.125;
                let furthest = before.iter().zip(&after).map(|(b, a)| (b - a).abs()).fold(0.0, f32::max);
                assert!(furthest <= 0.5 * step * 1.001, "{name}: {tensor}: {furthest} of {step}");
                assert!(furthest > 0.0, "{name}: {tensor} was not rounded");
            }
        }
    }
    let wrong = Storage { weights: neumip_export::Precision::Byte, ..Storage::BYTE };
    assert!(wrong.validate().unwrap_err().to_string().contains("storage.weights"));
}

#[test]
fn every_storage_takes_the_bytes_that_it_says() {
    let (_, model, resolution) = materials::cases().remove(0);
    let exact = materials::checkpoint(&model, resolution, 8);
    let architecture = &exact.header.architecture;
    let single = onnx::material_graph(&exact, onnx::Options::default()).unwrap().len() as f64;
    for (stored, storage) in STORAGES {
        let checkpoint = storage.round(exact.clone()).unwrap();
        let graph = onnx::material_graph(&checkpoint, onnx::Options { storage, ..HALFS }).unwrap();
        let saved = single - graph.len() as f64;
        let said = (architecture.bytes() - architecture.bytes_as(storage)) as f64;
        println!("{stored}: {saved} bytes fewer, {said} said");
        // Casts and factors take some; columns of the first layer stay 32-bit floats where they are reordered.
        assert!(saved <= said && saved > 0.8 * said - 1500.0, "{stored}: {saved} of {said}");
    }
}

#[test]
fn the_graph_stores_two_bytes_a_texture_value() {
    for (name, model, resolution) in materials::cases() {
        let checkpoint = Storage::HALF_TEXTURES.round(materials::checkpoint(&model, resolution, 1)).unwrap();
        let values = checkpoint.header.architecture.texture_values();
        let single = onnx::material_graph(&checkpoint, onnx::Options::default()).unwrap();
        assert_eq!(onnx::material_graph(&checkpoint, onnx::Options::default()).unwrap(), single, "{name}");
        let half = onnx::material_graph(&checkpoint, HALFS).unwrap();
        // A Cast node a texture is what it costs beside.
        let saved = single.len() as f64 - half.len() as f64;
        assert!(
            saved <= 2.0 * values as f64 && saved > 2.0 * values as f64 - 400.0,
            "{name}: {saved}, {values}"
        );
    }
}

#[test]
fn what_was_not_rounded_is_not_written_as_halfs() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("bundle");
    for tensor in ["texture.level1", OFFSET_TEXTURE] {
        let (mut checkpoint, golden) = rounded(0);
        checkpoint.tensors.get_mut(tensor).unwrap().data[3] = 0.1;
        let graph = onnx::material_graph(&checkpoint, HALFS).unwrap_err().to_string();
        let bundle = Contents { rounding: Some(COST), ..Contents::new(&checkpoint, &golden) }
            .write(&out, false)
            .unwrap_err()
            .to_string();
        for error in [graph, bundle] {
            assert!(error.contains(tensor) && error.contains("0.1 is not a half"), "{error}");
        }
    }
    let (checkpoint, golden) = rounded(0);
    for wrong in [f64::NAN, f64::INFINITY, -1e-3] {
        let cost = Rounding { mean_difference: wrong, ..COST };
        let error = Contents { rounding: Some(cost), ..Contents::new(&checkpoint, &golden) }
            .write(&out, false)
            .unwrap_err()
            .to_string();
        assert!(error.contains("rounding.mean_difference"), "{error}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "something stays behind");
}

#[test]
fn a_bundle_with_halfs_says_so_and_reads_back() {
    let folder = tempfile::tempdir().unwrap();
    let (checkpoint, golden) = rounded(1);
    let out = folder.path().join("half");
    let files =
        Contents { rounding: Some(COST), ..Contents::new(&checkpoint, &golden) }.write(&out, false).unwrap();
    let bundle = read_bundle(&out).unwrap();
    assert_eq!((&bundle.checkpoint, &bundle.golden), (&checkpoint, &golden));
    assert_eq!((bundle.sidecar.rounding, bundle.sidecar.storage()), (Some(COST), Storage::HALF_TEXTURES));
    let architecture = &checkpoint.header.architecture;
    let bytes = 4 * architecture.network_weights() + 2 * architecture.texture_values();
    assert_eq!((bundle.sidecar.cost.bytes, architecture.bytes_as(Storage::HALF_TEXTURES)), (bytes, bytes));
    assert!(
        bundle
            .sidecar
            .conventions
            .iter()
            .any(|c| c
                .contains("Texture values are 16-bit floats and weights are 32-bit floats in the graphs"))
    );
    let text = |name: &str| std::fs::read_to_string(out.join(name)).unwrap();
    assert!(text("material.json").contains("\"textures\": \"f16\""));
    // Lines are broken anywhere.
    let readme = text("README.txt").split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(readme.contains("3.0e-3 (1 + |value|)") && readme.contains("2.0e-4 (1 + |value|)"), "{readme}");
    assert!(!readme.contains("Only the EXR files"), "{readme}");
    let again = folder.path().join("again");
    let twice = Contents { rounding: Some(COST), ..Contents::new(&checkpoint, &golden) }
        .write(&again, false)
        .unwrap();
    assert_eq!(twice, files, "not the same bytes");

    // The same files by default: all of them but the graph with the textures and the pages are equal.
    let single = Contents::new(&checkpoint, &golden).write(&folder.path().join("single"), false).unwrap();
    let differ: Vec<&str> =
        files.iter().zip(&single).filter(|(a, b)| a != b).map(|(a, _)| a.name.as_str()).collect();
    assert_eq!(differ, ["material.onnx", "prepare.onnx", "README.txt", "material.json"]);
    let single = read_bundle(&folder.path().join("single")).unwrap().sidecar;
    assert_eq!((single.rounding, single.cost.bytes), (None, architecture.bytes()));
}

#[test]
fn a_bundle_that_claims_halfs_without_having_them_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (_, model, resolution) = materials::cases().remove(6);
    let checkpoint = materials::checkpoint(&model, resolution, 8);
    let (_, golden) = rounded(6);
    let out = folder.path().join("bundle");
    Contents::new(&checkpoint, &golden).write(&out, false).unwrap();
    let sidecar = out.join("material.json");
    let text = std::fs::read_to_string(&sidecar).unwrap();
    for (claim, part) in [
        (
            r#""storage":{"textures":"f16","weights":"f32"},"largest_difference":0.1,"mean_difference":0.1"#,
            "model.safetensors: tensor texture",
        ),
        (
            r#""storage":{"textures":"f16","weights":"f32"},"largest_difference":-1,"mean_difference":0.1"#,
            "rounding.largest_difference",
        ),
        (
            r#""storage":{"textures":"f8","weights":"f32"},"largest_difference":0.1,"mean_difference":0.1"#,
            "f8",
        ),
    ] {
        let claimed = text.replacen('{', &format!("{{\"rounding\":{{{claim}}},"), 1);
        std::fs::write(&sidecar, claimed).unwrap();
        let error = read_bundle(&out).unwrap_err().to_string();
        assert!(error.contains(part), "{error}");
    }
}
