//! `neumip stability`: the quick suite holds, is resumed where it was stopped, and bad calls are refused in a line.

use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};

fn neumip(arguments: &[&str], folder: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_neumip")).args(arguments).current_dir(folder).output().unwrap()
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

#[test]
fn the_quick_suite_holds() {
    let there = tempfile::tempdir().unwrap();
    let output = neumip(&["stability", "--quick", "--out", "suite"], there.path());
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{said}{}", String::from_utf8_lossy(&output.stderr));
    println!("{said}");
    let report = json(&there.path().join("suite/stability.json"));
    let probes = report["probes"].as_array().unwrap();
    let page = std::fs::read_to_string(there.path().join("suite/STABILITY.md")).unwrap();
    for probe in probes {
        let name = probe["probe"].as_str().unwrap();
        assert!(page.contains(&format!("### {name}\n")), "{name}");
        // Right by its own figures, whatever word it carries.
        let holds = |of: &str| probe[of].as_f64().is_some_and(|v| v <= probe["bound"].as_f64().unwrap());
        assert!(holds("cured"), "{probe}");
        assert!(!holds("naive") || probe["safe"].is_string(), "{probe}");
        for picture in ["png", "svg"].map(|kind| format!("pictures/{name}.{kind}")) {
            assert_eq!(page.contains(&picture), there.path().join("suite").join(&picture).is_file());
        }
    }
    assert!(probes.len() >= 40 && !report["prices"].as_array().unwrap().is_empty());

    // A finished probe is not run again; one that is missing is.
    let suite = there.path().join("suite/probes");
    let kept = suite.join("root-slope.json");
    let before = std::fs::metadata(&kept).unwrap().modified().unwrap();
    std::fs::remove_file(suite.join("root-dead-zone.json")).unwrap();
    let again =
        ["stability", "--quick", "--out", "suite", "--probe", "root-slope", "--probe", "root-dead-zone"];
    let output = neumip(&[&again[..], &["--json", "two.json"]].concat(), there.path());
    assert!(output.status.success() && suite.join("root-dead-zone.json").is_file());
    assert_eq!(std::fs::metadata(&kept).unwrap().modified().unwrap(), before);
    assert_eq!(json(&there.path().join("two.json"))["probes"].as_array().unwrap().len(), 2);
    let full = neumip(&["stability", "--full", "--out", "suite", "--probe", "root-slope"], there.path());
    assert_eq!(full.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&full.stderr).contains("choose another --out"));
}

#[test]
fn calls_that_make_no_sense_are_refused() {
    let there = tempfile::tempdir().unwrap();
    for (arguments, expected) in [
        (&["stability"][..], "--quick"),
        (&["stability", "--quick", "--full"], "--full"),
        (&["stability", "--quick", "--probe", "rot-slope"], "rot-slope"),
    ] {
        let output = neumip(arguments, there.path());
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(said.contains(expected) && !there.path().join("stability").exists(), "{said}");
    }
    let listed = neumip(&["stability", "--list"], there.path());
    assert!(String::from_utf8_lossy(&listed.stdout).contains("root-slope: "));
}
