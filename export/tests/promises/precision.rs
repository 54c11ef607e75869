//! Textures as half floats: rounded before everything else, stored in half the bytes, read by 32-bit arithmetic.

use crate::graphs::{TOLERANCE, expected, feeds, largest_difference, run};
use crate::materials;
use half::f16;
use neumip_export::config::{OFFSET_TEXTURE, texture_name};
use neumip_export::{
    Checkpoint, Golden, Precision, TexturePrecision, onnx, read_bundle, write_bundle, write_bundle_as,
};

/// Queries a case.
const QUERIES: usize = 512;
/// What a test says that rounding costs; bundles only carry it.
const COST: TexturePrecision =
    TexturePrecision { storage: Precision::Half, largest_difference: 3e-3, mean_difference: 2e-4 };

/// A case's checkpoint, rounded, and queries that it is golden for by definition.
fn rounded(case: usize) -> (Checkpoint, Golden) {
    let (_, model, resolution) = materials::cases().remove(case);
    let checkpoint = Precision::Half.round(materials::checkpoint(&model, resolution, 8)).unwrap();
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
        assert_eq!(Precision::Single.round(before.clone()).unwrap(), before, "{name}");
        let after = Precision::Half.round(before.clone()).unwrap();
        assert_eq!(after.header, before.header, "{name}");
        for (tensor, old) in &before.tensors {
            let new = &after.tensors[tensor];
            let nearest = old.data.iter().map(|v| f16::from_f32(*v).to_f32());
            match is_texture(tensor) {
                true => assert!(nearest.eq(new.data.iter().copied()) && new != old, "{name}: {tensor}"),
                false => assert_eq!(new, old, "{name}: {tensor}"),
            }
        }
        assert_eq!(Precision::Half.round(after.clone()).unwrap(), after, "{name}: rounded twice");
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
        match Precision::Half.round(checkpoint) {
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
fn graphs_with_halfs_answer_like_plain_loops_on_rounded_textures() {
    for (name, model, resolution) in materials::cases() {
        let exact = materials::checkpoint(&model, resolution, 1);
        let checkpoint = Precision::Half.round(exact.clone()).unwrap();
        let queries = materials::queries(&checkpoint.header.architecture, QUERIES, 2);
        let graph = onnx::material_graph_as(&checkpoint, Precision::Half).unwrap();
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

#[test]
fn the_graph_stores_two_bytes_a_texture_value() {
    for (name, model, resolution) in materials::cases() {
        let checkpoint = Precision::Half.round(materials::checkpoint(&model, resolution, 1)).unwrap();
        let values = checkpoint.header.architecture.texture_values();
        let single = onnx::material_graph(&checkpoint).unwrap();
        assert_eq!(onnx::material_graph_as(&checkpoint, Precision::Single).unwrap(), single, "{name}");
        let half = onnx::material_graph_as(&checkpoint, Precision::Half).unwrap();
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
        let graph = onnx::material_graph_as(&checkpoint, Precision::Half).unwrap_err().to_string();
        let bundle = write_bundle_as(&checkpoint, &golden, Some(COST), &out, false).unwrap_err().to_string();
        for error in [graph, bundle] {
            assert!(error.contains(tensor) && error.contains("0.1 is not a half"), "{error}");
        }
    }
    let (checkpoint, golden) = rounded(0);
    for wrong in [f64::NAN, f64::INFINITY, -1e-3] {
        let cost = TexturePrecision { mean_difference: wrong, ..COST };
        let error = write_bundle_as(&checkpoint, &golden, Some(cost), &out, false).unwrap_err().to_string();
        assert!(error.contains("texture_precision.mean_difference"), "{error}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "something stays behind");
}

#[test]
fn a_bundle_with_halfs_says_so_and_reads_back() {
    let folder = tempfile::tempdir().unwrap();
    let (checkpoint, golden) = rounded(1);
    let out = folder.path().join("half");
    let files = write_bundle_as(&checkpoint, &golden, Some(COST), &out, false).unwrap();
    let bundle = read_bundle(&out).unwrap();
    assert_eq!((&bundle.checkpoint, &bundle.golden), (&checkpoint, &golden));
    assert_eq!((bundle.sidecar.texture_precision, bundle.sidecar.storage()), (Some(COST), Precision::Half));
    let architecture = &checkpoint.header.architecture;
    let bytes = 4 * architecture.network_weights() + 2 * architecture.texture_values();
    assert_eq!((bundle.sidecar.cost.bytes, architecture.bytes_as(Precision::Half)), (bytes, bytes));
    assert!(bundle.sidecar.conventions.iter().any(|c| c.contains("16-bit floats in material.onnx")));
    let text = |name: &str| std::fs::read_to_string(out.join(name)).unwrap();
    assert!(text("material.json").contains("\"storage\": \"f16\""));
    let readme = text("README.txt");
    assert!(readme.contains("3.0e-3 (1 + |value|)") && readme.contains("2.0e-4 (1 + |value|)"), "{readme}");
    assert!(!readme.contains("in the EXR files only"), "{readme}");
    let again = folder.path().join("again");
    let twice = write_bundle_as(&checkpoint, &golden, Some(COST), &again, false).unwrap();
    assert_eq!(twice, files, "not the same bytes");

    // The same files by default: all of them but the graph with the textures and the pages are equal.
    let single = write_bundle(&checkpoint, &golden, &folder.path().join("single"), false).unwrap();
    let differ: Vec<&str> =
        files.iter().zip(&single).filter(|(a, b)| a != b).map(|(a, _)| a.name.as_str()).collect();
    assert_eq!(differ, ["material.onnx", "README.txt", "material.json"]);
    let single = read_bundle(&folder.path().join("single")).unwrap().sidecar;
    assert_eq!((single.texture_precision, single.cost.bytes), (None, architecture.bytes()));
}

#[test]
fn a_bundle_that_claims_halfs_without_having_them_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (_, model, resolution) = materials::cases().remove(6);
    let checkpoint = materials::checkpoint(&model, resolution, 8);
    let (_, golden) = rounded(6);
    let out = folder.path().join("bundle");
    write_bundle(&checkpoint, &golden, &out, false).unwrap();
    let sidecar = out.join("material.json");
    let text = std::fs::read_to_string(&sidecar).unwrap();
    for (claim, part) in [
        (
            r#""storage":"f16","largest_difference":0.1,"mean_difference":0.1"#,
            "model.safetensors: tensor texture",
        ),
        (
            r#""storage":"f16","largest_difference":-1,"mean_difference":0.1"#,
            "texture_precision.largest_difference",
        ),
        (r#""storage":"f8","largest_difference":0.1,"mean_difference":0.1"#, "f8"),
    ] {
        let claimed = text.replacen('{', &format!("{{\"texture_precision\":{{{claim}}},"), 1);
        std::fs::write(&sidecar, claimed).unwrap();
        let error = read_bundle(&out).unwrap_err().to_string();
        assert!(error.contains(part), "{error}");
    }
}
