//! A checkpoint comes back as it went, has the same bytes every time, and a damaged one is refused with a
//! reason.

use crate::materials;
use neumip_export::{Checkpoint, Tensor, read_tensors, write_tensors};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;

fn sample() -> Checkpoint {
    let (_, model, resolution) = materials::cases().remove(4);
    materials::checkpoint(&model, resolution, 7)
}

#[test]
fn every_case_round_trips_and_writes_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    for (name, model, resolution) in materials::cases() {
        let checkpoint = materials::checkpoint(&model, resolution, 7);
        let path = folder.path().join("model.safetensors");
        checkpoint.write(&path).unwrap();
        let back = Checkpoint::read(&path).unwrap();
        assert_eq!(back, checkpoint, "{name}");
        assert_eq!(std::fs::read(&path).unwrap(), back.to_bytes().unwrap(), "{name}");
        let loaded = safetensors::SafeTensors::deserialize(&std::fs::read(&path).unwrap()).map(|t| t.len());
        assert_eq!(loaded.unwrap(), checkpoint.tensors.len(), "{name}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "temporary files stay behind");
}

/// Header JSON and data of a checkpoint's bytes.
fn parts(bytes: &[u8]) -> (Value, Vec<u8>) {
    let length = u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
    (serde_json::from_slice(&bytes[8..8 + length]).unwrap(), bytes[8 + length..].to_vec())
}

fn joined(header: &Value, data: &[u8]) -> Vec<u8> {
    let text = serde_json::to_vec(header).unwrap();
    [&(text.len() as u64).to_le_bytes()[..], &text, data].concat()
}

/// Changes the JSON under the metadata key.
fn with_neumip(header: &mut Value, change: impl Fn(&mut Value)) {
    let text = header["__metadata__"]["neumip"].as_str().unwrap();
    let mut inner: Value = serde_json::from_str(text).unwrap();
    change(&mut inner);
    header["__metadata__"]["neumip"] = Value::String(inner.to_string());
}

type Damage = fn(&mut Value, &mut Vec<u8>);

#[test]
fn damaged_files_are_refused_by_name() {
    let cases: [(&str, &str, Damage); 20] = [
        ("cut data", "does not fit", |_, d| d.truncate(d.len() - 4)),
        ("extra data", "bytes of data where", |_, d| d.extend([0; 8])),
        ("NaN", "tensor decoder.mlp.0.bias: value 0 is NaN", |_, d| {
            d[..4].copy_from_slice(&f32::NAN.to_le_bytes())
        }),
        ("half floats", "tensor decoder.mlp.1.bias: is F16", |h, _| {
            h["decoder.mlp.1.bias"]["dtype"] = json!("F16")
        }),
        ("unknown type", "tensor decoder.mlp.1.bias: is Q3", |h, _| {
            h["decoder.mlp.1.bias"]["dtype"] = json!("Q3")
        }),
        ("wrong shape", "tensor decoder.mlp.1.weight: has shape [5, 125]", |h, _| {
            h["decoder.mlp.1.weight"]["shape"] = json!([5, 125]);
        }),
        ("overflowing shape", "tensor texture.level0: shape", |h, _| {
            h["texture.level0"]["shape"] = json!([u64::MAX, 4, 4]);
        }),
        ("negative shape", "tensor texture.level0", |h, _| h["texture.level0"]["shape"] = json!([-1])),
        ("wild offsets", "tensor texture.level0", |h, _| {
            h["texture.level0"]["data_offsets"] = json!([u64::MAX - 3, u64::MAX]);
        }),
        ("overlapping tensors", "tensor decoder.mlp.", |h, _| {
            h["decoder.mlp.1.bias"]["data_offsets"] = h["decoder.mlp.0.bias"]["data_offsets"].clone();
        }),
        ("missing tensor", "tensor decoder.mlp.2.bias: is missing", |h, _| {
            let entry = h.as_object_mut().unwrap().remove("decoder.mlp.2.bias").unwrap();
            h["decoder.mlp.9.bias"] = entry;
        }),
        ("extra tensor", "tensor more: is not part", |h, _| {
            h["more"] = json!({"dtype": "F32", "shape": [0], "data_offsets": [0, 0]});
        }),
        ("no metadata", "has no `neumip`", |h, _| {
            h.as_object_mut().unwrap().remove("__metadata__");
        }),
        ("second key", "has no `neumip` as its one", |h, _| h["__metadata__"]["other"] = json!("x")),
        ("future version", "format: version 2", |h, _| {
            with_neumip(h, |n| {
                n["format"] = json!(2);
                n["brand new"] = json!(1);
            });
        }),
        ("unknown field", "unknown field `colour`", |h, _| with_neumip(h, |n| n["colour"] = json!(1))),
        ("unknown measure", "unknown variant `lumen`", |h, _| {
            with_neumip(h, |n| n["measure"] = json!("lumen"))
        }),
        ("absurd resolution", "resolution[0]", |h, _| {
            with_neumip(h, |n| n["architecture"]["resolution"] = json!([1u64 << 40, 4]));
        }),
        ("absurd levels", "texture.levels", |h, _| {
            with_neumip(h, |n| n["architecture"]["model"]["texture"]["levels"] = json!(u64::MAX));
        }),
        ("reversed heights", "height_range", |h, _| with_neumip(h, |n| n["height_range"] = json!([1, 0]))),
    ];
    let bytes = sample().to_bytes().unwrap();
    let path = Path::new("some/model.safetensors");
    for (name, reason, damage) in cases {
        let (mut header, mut data) = parts(&bytes);
        assert!(Checkpoint::from_bytes(path, &joined(&header, &data)).is_ok(), "{name}: before");
        damage(&mut header, &mut data);
        let error = Checkpoint::from_bytes(path, &joined(&header, &data)).expect_err(name).to_string();
        assert!(error.starts_with("some/model.safetensors: ") && error.contains(reason), "{name}: {error}");
        assert_eq!(error.lines().count(), 1, "{name}: {error}");
    }
}

#[test]
fn a_file_cut_anywhere_is_refused() {
    let bytes = sample().to_bytes().unwrap();
    let path = Path::new("m");
    for length in (0..bytes.len()).step_by(97).chain(0..16).chain(bytes.len() - 8..bytes.len()) {
        assert!(Checkpoint::from_bytes(path, &bytes[..length]).is_err(), "{length} bytes");
    }
    let mut claims_too_much = bytes.clone();
    claims_too_much[..8].copy_from_slice(&u64::MAX.to_le_bytes());
    assert!(Checkpoint::from_bytes(path, &claims_too_much).is_err());
}

#[test]
fn a_folder_and_a_missing_file_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let error = Checkpoint::read(folder.path()).unwrap_err().to_string();
    assert!(error.ends_with("is not a file"), "{error}");
    let error = Checkpoint::read(&folder.path().join("none")).unwrap_err().to_string();
    assert!(error.contains("none: cannot be read"), "{error}");
}

#[test]
fn invalid_checkpoints_are_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.safetensors");
    let good = sample();
    good.write(&path).unwrap();
    let before = std::fs::read(&path).unwrap();
    type Change = fn(&mut Checkpoint);
    let changes: [(&str, Change); 4] = [
        ("tensor texture.level0: value 3 is inf", |c| {
            c.tensors.get_mut("texture.level0").unwrap().data[3] = f32::INFINITY;
        }),
        ("tensor texture.level1: is missing", |c| drop(c.tensors.remove("texture.level1"))),
        ("tensor texture.level0: has 1 values", |c| {
            c.tensors.get_mut("texture.level0").unwrap().data.truncate(1)
        }),
        ("height_range", |c| c.header.height_range = [f32::NAN, 0.0]),
    ];
    for (reason, change) in changes {
        let mut bad = good.clone();
        change(&mut bad);
        let error = bad.write(&path).unwrap_err().to_string();
        assert!(error.contains("model.safetensors: ") && error.contains(reason), "{error}");
        assert_eq!(std::fs::read(&path).unwrap(), before, "{reason}");
    }
}

#[test]
fn plain_tensor_files_round_trip_under_their_own_key() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("state.safetensors");
    let tensors = BTreeMap::from([
        ("m".to_string(), Tensor { shape: vec![2, 3], data: vec![1.0, -2.5, 3e-30, 0.0, -0.0, 7.0] }),
        ("empty".to_string(), Tensor { shape: vec![0, 4], data: vec![] }),
        ("scalar".to_string(), Tensor { shape: vec![], data: vec![5.0] }),
    ]);
    write_tensors(&path, "adam", "{\"step\":3}", &tensors).unwrap();
    let (json, back) = read_tensors(&path, "adam").unwrap();
    assert_eq!((json.as_str(), &back), ("{\"step\":3}", &tensors));
    assert!(read_tensors(&path, "neumip").is_err());
    let error = Checkpoint::read(&path).unwrap_err().to_string();
    assert!(error.contains("has no `neumip`"), "{error}");

    let poisoned = BTreeMap::from([("m".to_string(), Tensor { shape: vec![1], data: vec![f32::NAN] })]);
    let error = write_tensors(&path, "adam", "{}", &poisoned).unwrap_err().to_string();
    assert!(error.contains("state.safetensors: m: value 0 is NaN"), "{error}");
}
