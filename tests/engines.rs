//! On the command line: engines and instruction sets are chosen, say who they are, and agree; a wrong choice is named.

use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};

/// Errors of two engines, or of two instruction sets, relative to each other: answers differ by roundings of 2e-5.
const AGREEMENT: f64 = 1e-3;
/// The same with f16 textures, which move answers by up to 1e-3.
const HALF_AGREEMENT: f64 = 1e-2;

fn run(folder: &Path, set: Option<&str>, line: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_neumip"));
    command.args(line.split_whitespace()).current_dir(folder).env_remove("NEUMIP_ISA");
    if let Some(set) = set {
        command.env("NEUMIP_ISA", set);
    }
    command.output().unwrap()
}

fn succeed(folder: &Path, set: Option<&str>, line: &str) -> Value {
    let output = run(folder, set, &format!("{line} --quiet --json out.json"));
    assert!(output.status.success(), "{line}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_str(&std::fs::read_to_string(folder.join("out.json")).unwrap()).unwrap()
}

fn refused(folder: &Path, set: Option<&str>, line: &str, words: &[&str]) {
    let output = run(folder, set, line);
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{line}: {said}");
    assert!(words.iter().all(|w| said.contains(w)) && said.trim_end().lines().count() == 1, "{line}: {said}");
}

/// Engine, and `mse_linear` of every row.
fn errors(evaluation: &Value) -> (String, Vec<f64>) {
    let rows = evaluation[0]["rows"].as_array().unwrap();
    let of = rows.iter().map(|r| r["mse_linear"].as_f64().unwrap()).collect();
    (evaluation[0]["engine"].as_str().unwrap().to_string(), of)
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    assert!(a.len() == b.len() && !a.is_empty());
    a.iter().zip(b).map(|(a, b)| (a - b).abs() / b).fold(0.0, f64::max)
}

#[test]
fn every_engine_and_set_gives_the_same_errors_and_another_run_does_not() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let data = "generate rocks --out data --resolution 16 --samples 4000 --spp 2 --held-out-spp 2 --test-pairs 2 --view-size 8";
    assert!(run(folder, None, data).status.success());
    let train = "--preset improved --steps 40 --batch 256 --set train.validations=1";
    succeed(folder, None, &format!("train data --out run {train}"));
    succeed(folder, None, &format!("train data --out other {train} --seed 2"));
    let evaluate = |set: Option<&str>, run: &str, flags: &str| {
        errors(&succeed(folder, set, &format!("evaluate {run} --data data --rounds 0 {flags}")))
    };
    let (engine, candle) = evaluate(None, "run", "--engine candle");
    assert_eq!(engine, "candle");
    for isa in neumip::kernels::simd::Isa::all() {
        let set = Some(isa.name());
        let (engine, fused) = evaluate(set, "run", "");
        assert_eq!(engine, format!("fused {}", isa.name()));
        assert!(distance(&fused, &candle) < AGREEMENT, "{engine}");
        let (engine, half) = evaluate(set, "run", "--half-textures");
        assert_eq!(engine, format!("fused {}, f16 textures", isa.name()));
        assert!(distance(&half, &candle) < HALF_AGREEMENT && half != fused, "{engine}");
    }
    assert!(distance(&evaluate(None, "other", "").1, &candle) > HALF_AGREEMENT);

    let rows = succeed(folder, Some("portable"), "bench --quick --bare");
    assert!(rows.as_array().unwrap().iter().all(|r| r["isa"] == "portable" && r["engine"] == "fused"));
    refused(folder, Some("sse9"), "bench --quick", &["NEUMIP_ISA=sse9", "avx512, avx2 or portable"]);
    refused(folder, Some("sse9"), "evaluate run --data data", &["NEUMIP_ISA=sse9"]);
    refused(folder, Some("sse9"), &format!("train data --out new {train}"), &["NEUMIP_ISA=sse9"]);
    assert!(!folder.join("new").exists());
    refused(folder, None, "evaluate run --data data --half-textures --engine candle", &["--half-textures"]);
    refused(folder, None, "train data --out new --set train.texture_every=0", &["train.texture_every"]);
    assert!(!folder.join("new").exists());
}
