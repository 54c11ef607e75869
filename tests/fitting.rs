//! Fits to scenes: smaller and as good on the scene's own pictures, better than the same size without training, the same bytes on
//! any number of threads and after an interrupt, exported with their domain; several materials share a total of bytes; and what
//! cannot be done is said in one line.

use crate::command_line::{Refusal, complaint, refused, stopped, succeed, workshop};
use neumip::checkpoint;
use neumip::engine::FusedMaterial;
use neumip::export::Checkpoint;
use neumip::fit::need::Need;
use neumip::fit::shape::Shape;
use neumip::fit::transfer::transfer;
use neumip::query::{QueryBuffer, Reflectance};
use neumip::random::{Random, Stream};
use serde_json::{Value, json};
use std::path::Path;

/// A dataset on which a full model and a fit take seconds.
const DATA: &str = "--resolution 32 --field-side 64 --bounces 0 --samples 60000 --spp 4 --held-out-spp 8 --test-pairs 2 --view-size 0";
/// The shortest fit whose figures mean something.
const SHORT: &str = "--unique 20000 --spp 4 --training 600000 --candidates 6 --frames 2 --picture-spp 4";
/// How far the layers of a model of the same size are from those that they are rebuilt from: least squares in double precision
/// with a ridge of 1e-5, on answers of about 1.
const REBUILT: f32 = 0.02;

fn scene(folder: &Path, name: &str, change: impl Fn(&mut Value)) {
    let mut scene = json!({
        "version": 1,
        "objects": [{"shape": "plane", "scale": 4, "tiling": [12, 12]}],
        "lights": [{"directional": {"name": "lamp", "direction": [0.5, 0, 1]}}],
        "camera": {"origin": [0, -1.5, 2], "width": 40, "samples": 2},
        "path": {"frames": 2, "keys": [{"lights": {"lamp": [0.5, 0, 1]}}, {"lights": {"lamp": [-0.5, 0, 1]}}]},
    });
    change(&mut scene);
    std::fs::write(folder.join(name), scene.to_string()).unwrap();
}

fn read(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

fn row<'a>(fit: &'a Value, name: &str) -> &'a Value {
    fit["rows"].as_array().unwrap().iter().find(|row| row["name"] == name).unwrap()
}

fn flip(fit: &Value, name: &str) -> f64 {
    row(fit, name)["errors"]["flip"].as_f64().unwrap()
}

#[test]
fn a_fit_is_small_as_good_and_goes_to_other_renderers() {
    let workshop = workshop();
    let folder = workshop.path();
    scene(folder, "scene.json", |_| {});
    succeed(folder, &format!("generate rocks --out rocks {DATA}"));
    let line = format!("fit rocks --field-side 64 --scene scene.json --target flip=full {SHORT}");
    let said = succeed(folder, &format!("{line} --out fitted --json fitted.json"));
    assert!(said.contains("times fewer bytes") && said.contains("is held"), "{said}");

    let fit = read(&folder.join("fitted/fit.json"));
    assert_eq!(fit, read(&folder.join("fitted.json")));
    let bytes = |name: &str| row(&fit, name)["bytes"].as_f64().unwrap();
    assert!(3.0 * bytes("fitted") < bytes("full"), "{fit}");
    assert!(flip(&fit, "fitted") <= 1.05 * flip(&fit, "full"), "{fit}");
    // The same size without training is no fit.
    assert!(flip(&fit, "truncated") > 1.5 * flip(&fit, "fitted"), "{fit}");
    assert_eq!(fit["truth"], "surface");
    let presented: u64 =
        fit["trials"].as_array().unwrap().iter().map(|trial| trial["samples"].as_u64().unwrap()).sum();
    assert!(presented < 2 * 600_000, "{presented}");
    assert!(fit["elsewhere"][0]["queries"][1].as_u64().unwrap() > 0);
    for left in ["data", "trials", "truth"] {
        assert!(!folder.join("fitted").join(left).exists(), "{left} is left");
    }

    let full = "--full fitted/full";
    for threads in [1, 2] {
        succeed(folder, &format!("{line} {full} --out threads{threads} --threads {threads}"));
    }
    let best = |name: &str| std::fs::read(folder.join(name).join("best.safetensors")).unwrap();
    assert_eq!(best("threads1"), best("threads2"));
    assert_ne!(best("threads1"), std::fs::read(folder.join("threads1/truncated.safetensors")).unwrap());

    let domain = checkpoint::load(&folder.join("fitted")).unwrap().header.architecture.domain.unwrap();
    assert_eq!((domain.scene.as_str(), domain.tile), ("scene", [32, 32]));
    let flag = match fit["rows"][2]["storage"]["textures"].as_str().unwrap() {
        "i8" => "--int8",
        _ => "--half",
    };
    succeed(folder, &format!("export fitted --out handed {flag} --no-sampler --check"));
    assert_eq!(read(&folder.join("handed/material.json"))["domain"]["bounds"]["scene"], "scene");
    succeed(folder, "render handed --scene scene.json --out pictures --json pictures.json");
    let outside = &read(&folder.join("pictures.json"))["materials"][0]["outside"];
    assert!(outside["queries"].as_u64().unwrap() > 0, "{outside}");
}

#[cfg(unix)]
#[test]
fn an_interrupted_fit_goes_on_to_the_same_bytes() {
    let workshop = workshop();
    let folder = workshop.path();
    scene(folder, "scene.json", |_| {});
    let line = format!("fit data --full run --surface none --scene scene.json --budget-bytes 20K {SHORT}");
    succeed(folder, &format!("{line} --out whole"));
    let code = stopped(folder, &format!("{line} --out stopped"), "stopped/truth/choice-0000.exr");
    assert_eq!(code, Some(130));
    assert!(!folder.join("stopped/fit.json").exists());
    succeed(folder, &format!("{line} --out stopped"));
    let best = |name: &str| std::fs::read(folder.join(name).join("best.safetensors")).unwrap();
    assert_eq!(best("whole"), best("stopped"));
    assert_eq!(read(&folder.join("whole/fit.json"))["truth"], "full model");
}

#[test]
fn several_materials_share_their_bytes() {
    let workshop = workshop();
    let folder = workshop.path();
    scene(folder, "two.json", |scene| {
        scene["materials"] = json!({"floor": {"lambert": 0.5}, "ball": {"lambert": 0.5}});
        scene["objects"] = json!([
            {"shape": "plane", "material": "floor", "scale": 4, "tiling": [12, 12]},
            {"shape": "sphere", "material": "ball", "scale": 0.4, "translate": [0, 0, 0.4], "tiling": [4, 2]}
        ]);
    });
    let line = format!(
        "fit floor=data ball=data --full floor=run --full ball=run --scene two.json {SHORT} --surface floor=none --surface ball=none"
    );
    succeed(folder, &format!("{line} --total-bytes 4000 --out both"));
    let bytes = |name: &str| {
        let fit = read(&folder.join("both").join(name).join("fit.json"));
        row(&fit, "fitted")["bytes"].as_u64().unwrap()
    };
    assert!(bytes("floor") + bytes("ball") <= 4000, "{} and {}", bytes("floor"), bytes("ball"));
    let too_few = format!("{line} --total-bytes 300 --out few");
    refused_but_for_its_folder(folder, &(&too_few, 2, &["300", "bytes"]));
}

#[test]
fn what_cannot_be_fitted_is_said_in_one_line() {
    let workshop = workshop();
    let folder = workshop.path();
    scene(folder, "scene.json", |_| {});
    scene(folder, "away.json", |scene| {
        scene["camera"]["target"] = json!([0, -1.5, 9]);
        scene["camera"]["origin"] = json!([0, -1.5, 2]);
    });
    scene(folder, "named.json", |scene| {
        scene["materials"] = json!({"floor": {"lambert": 0.5}});
        scene["objects"][0]["material"] = json!("floor");
    });
    let all = format!("fit data --full run --surface none {SHORT}");
    let with = |rest: &str| format!("{all} {rest}");
    let lines = [
        (with("--scene scene.json --out a"), 2, vec!["--target", "--budget-ns", "--budget-bytes"]),
        (with("--scene scene.json --out a --target psnr=30"), 2, vec!["psnr", "flip and mse"]),
        (with("--scene scene.json --out a --target flip=-1"), 2, vec!["-1", "above 0"]),
        (
            with("--scene scene.json --out a --budget-bytes 10"),
            2,
            vec!["--budget-bytes 10", "smallest model"],
        ),
        (with("--scene scene.json --out b --budget-ns 0.5"), 2, vec!["--budget-ns 0.5", "fastest model"]),
        (with("--scene scene.json --out b --budget-ns 0"), 2, vec!["--budget-ns 0", "above 0"]),
        (
            with("--scene scene.json --out c --target flip=1e-7"),
            1,
            vec!["flip=1.00e-7", "the nearest", "--training"],
        ),
        (with("--scene away.json --out d --target flip=0.5"), 2, vec!["materials.default", "never shows"]),
        (with("--scene named.json --out e --target flip=full"), 2, vec!["named.json", "default", "floor"]),
        (with("--scene nowhere.json --out e --target flip=full"), 2, vec!["nowhere.json"]),
        (with("--scene scene.json --out e --target flip=full --full ball=run"), 2, vec!["ball"]),
        (with("--scene scene.json --out c --target flip=0.5"), 1, vec!["another goal", "--force"]),
        (
            with("--scene scene.json --out g --target flip=full"),
            2,
            vec!["flip=full", "full model is the truth"],
        ),
        (with("--scene scene.json --out precious --target flip=full"), 1, vec!["precious", "thesis.txt"]),
        (with("--scene scene.json --out f --target flip=full --floor 2"), 2, vec!["--floor 2", "0 to 0.9"]),
    ];
    let lines: Vec<Refusal> =
        lines.iter().map(|(line, code, parts)| (line.as_str(), *code, parts.as_slice())).collect();
    // What was asked too much of is fitted as far as it went, so folders change.
    for line in &lines {
        refused_but_for_its_folder(folder, line);
    }
}

fn refused_but_for_its_folder(folder: &Path, (line, code, parts): &Refusal) {
    let (found, complained) = complaint(folder, line);
    assert_eq!(found, Some(*code), "neumip {line}: {complained}");
    // What the parser of flags refuses comes with its hint at --help.
    let lines = if complained.starts_with("error: ") { 3 } else { 1 };
    assert_eq!(complained.trim_end().lines().count(), lines, "neumip {line}: {complained}");
    for part in *parts {
        assert!(complained.contains(part), "neumip {line}: {complained} without {part}");
    }
}

#[test]
fn a_quick_table_is_filled_and_kept() {
    let workshop = workshop();
    let folder = workshop.path();
    let line = "fit-table --quick --scenes far-floor --out table";
    succeed(folder, line);
    let page = std::fs::read_to_string(folder.join("table/FIT.md")).unwrap();
    assert!(page.contains("| far |") && page.contains("| far-floor | `rocks` |"), "{page}");
    let before = std::fs::read(folder.join("table/table.json")).unwrap();
    succeed(folder, line);
    assert_eq!(before, std::fs::read(folder.join("table/table.json")).unwrap());
    refused(folder, &[("fit-table --scenes moon --out other", 2, &["--scenes moon", "far-floor"])]);
}

/// A trained model without an encoding of the position, and a need of a window of its tile.
fn model_and_need(folder: &Path) -> (Checkpoint, Need, QueryBuffer) {
    succeed(folder, &format!("generate rocks --out rocks {DATA}"));
    succeed(folder, "train rocks --out trained --preset neumip --steps 300 --batch 1024 --no-stability");
    let full = checkpoint::load(&folder.join("trained")).unwrap();
    let cone = neumip::export::Cone { axis: [0.0, 0.0, 1.0], cosine: -1.0 };
    let need = Need {
        tile: [32, 32],
        corner: [8, 12],
        size: [16, 16],
        levels: [0.0, 1.0],
        wi: cone,
        wo: cone,
        span: 32.0,
    };
    let n = 4096;
    let mut queries = QueryBuffer::slice(1, n, [0.0; 2], [0.0; 2], 0.0);
    for k in 0..n {
        let mut random = Random::new(1, Stream::Probe, k as u64);
        // In the window, but for the texels at its border that wrap.
        queries.u[k] = [0.4375 + 0.375 * random.uniform(), 0.3125 + 0.375 * random.uniform()];
        queries.wi[k] = random.disc(0.9);
        queries.wo[k] = random.disc(0.9);
        queries.level[k] = random.uniform();
    }
    (full, need, queries)
}

#[test]
fn a_model_of_the_same_size_is_rebuilt_on_its_window() {
    let workshop = workshop();
    let (full, need, queries) = model_and_need(workshop.path());
    let whole = Shape::of(&full.header.architecture.model).unwrap();
    let answers = |shape: &Shape| {
        let architecture = shape.model(&full.header.architecture.model, &need).unwrap();
        let tensors = transfer(&full, &architecture, &need, &queries).unwrap();
        let fitted =
            neumip::fit::model::checkpoint(&full, &architecture, tensors, &need, ("near", 0.1)).unwrap();
        FusedMaterial::from_checkpoint(&fitted).unwrap().evaluate(&queries).unwrap().pixels
    };
    let truth = FusedMaterial::from_checkpoint(&full).unwrap().evaluate(&queries).unwrap().pixels;
    let difference = |answers: &[[f32; 3]]| {
        let pairs = answers.as_flattened().iter().zip(truth.as_flattened());
        let scale =
            truth.as_flattened().iter().map(|v| v.abs()).sum::<f32>() / truth.as_flattened().len() as f32;
        pairs.map(|(a, b)| (a - b).abs()).sum::<f32>() / truth.as_flattened().len() as f32 / scale
    };
    let same = difference(&answers(&whole));
    assert!(same < REBUILT, "{same}");
    let narrow =
        difference(&answers(&Shape { channels: 2, hidden: vec![8], offset: None, bands: 0, ..whole }));
    assert!(narrow > REBUILT, "{narrow}");
}
