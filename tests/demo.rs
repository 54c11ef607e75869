//! The demo, in miniature: every stage runs, the page stands alone, the figures are there, it resumes, it refuses to mix.

use std::path::Path;
use std::process::{Command, Output};

fn demo(out: &Path, extra: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_neumip"))
        .args([
            "demo",
            "--resolution",
            "16",
            "--steps",
            "40",
            "--batch",
            "1024",
            "--samples",
            "20000",
            "--out",
        ])
        .arg(out)
        .args(extra)
        .output()
        .unwrap()
}

#[test]
fn a_small_demo_runs_to_its_report_and_resumes() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("demo");
    let first = demo(&out, &[]);
    let said = String::from_utf8_lossy(&first.stdout);
    assert!(first.status.success(), "{said}{}", String::from_utf8_lossy(&first.stderr));
    assert!(said.contains("On held-out directions"), "{said}");

    let figures: serde_json::Value =
        serde_json::from_slice(&std::fs::read(out.join("report.json")).unwrap()).unwrap();
    for model in ["neumip", "improved"] {
        let of = |list: &str| {
            let rows = figures[list].as_array().unwrap().iter();
            rows.filter(|row| row["model"] == model).cloned().collect::<Vec<_>>()
        };
        for split in ["test", "offgrid", "grazing", "views/s2", "views/s4"] {
            let row = of("table").into_iter().find(|r| r["split"] == split && r["level"] == "all").unwrap();
            assert!(row["mse"].as_f64().unwrap() > 0.0 && row["noise"].as_f64().unwrap() > 0.0, "{row}");
        }
        assert_eq!(of("costs").len(), 1);
        assert!(of("costs")[0]["ns"].as_f64().unwrap() > 0.0);
        assert!(of("exports").iter().any(|row| row["file"].as_str().unwrap().ends_with("material.onnx")));
        assert!(out.join(format!("{model}-bundle/material.onnx")).is_file());
    }
    let page = std::fs::read_to_string(out.join("report.html")).unwrap();
    assert!(
        page.contains("data:image/png;base64,") && page.contains("improved") && !page.contains("<script")
    );
    assert!(std::fs::read(out.join("picture.png")).unwrap().starts_with(b"\x89PNG"));

    let second = demo(&out, &[]);
    assert_eq!(second.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&second.stderr).contains("exists"));
    let best = |model: &str| std::fs::read(out.join(model).join("best.safetensors")).unwrap();
    let before = (best("neumip"), best("improved"));
    let third = demo(&out, &["--resume"]);
    assert!(third.status.success(), "{}", String::from_utf8_lossy(&third.stderr));
    assert_eq!(before, (best("neumip"), best("improved")));
    let other = demo(&out, &["--resume", "--seed", "2"]);
    assert_ne!(other.status.code(), Some(0));
}

#[test]
fn force_replaces_only_a_demo_and_bad_options_leave_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let project = folder.path().join("project");
    std::fs::create_dir_all(project.join("data")).unwrap();
    std::fs::write(project.join("notes.txt"), "precious").unwrap();
    let refused = demo(&project, &["--force"]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("notes.txt"));
    assert_eq!(std::fs::read_to_string(project.join("notes.txt")).unwrap(), "precious");

    let fresh = folder.path().join("fresh");
    for bad in [["--material", "sand"], ["--resolution", "100"], ["--batch", "100"], ["--steps", "0"]] {
        let refused = Command::new(env!("CARGO_BIN_EXE_neumip"))
            .args(["demo", "--out"])
            .arg(&fresh)
            .args(bad)
            .output()
            .unwrap();
        assert_eq!(refused.status.code(), Some(2), "{bad:?}");
        assert!(!fresh.exists(), "{bad:?}");
    }
}
