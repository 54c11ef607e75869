//! `neumip reproduce`: a small study runs to its tables, is stopped and shared out without loss, and its figures are sane.

use neumip::results::{Cell, Results};
use std::path::Path;
use std::process::{Command, Output};

fn neumip(arguments: &[&str], folder: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_neumip")).args(arguments).current_dir(folder).output().unwrap()
}

fn well(output: &Output) -> String {
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{said}{}", String::from_utf8_lossy(&output.stderr));
    said
}

fn results(folder: &Path) -> Results {
    Results::read(&folder.join("results.json")).unwrap()
}

/// What is measured and not timed: everything that must be the same again.
fn untimed(results: &Results) -> Vec<Cell> {
    results.cells.iter().cloned().map(|cell| Cell { ns_per_query: None, ..cell }).collect()
}

const TINY: &[&str] = &[
    "reproduce",
    "--quick",
    "--quiet",
    "--questions",
    "presets",
    "--materials",
    "rocks",
    "--presets",
    "neumip,improved",
    "--regimes",
    "scattered",
    "--resolution",
    "32",
    "--budget",
    "40",
    "--unique",
    "20",
    "--bounces",
    "0",
    "--rounds",
    "1",
];

#[test]
fn parts_of_a_study_are_the_whole_study() {
    let there = tempfile::tempdir().unwrap();
    let run = |out: &str, more: &[&str]| {
        neumip(&[TINY, &["--out", out, "--seeds", "2"], more].concat(), there.path())
    };
    well(&run("whole", &[]));
    well(&run("first", &["--cells", "1/2"]));
    well(&run("second", &["--cells", "2/2"]));
    let part = results(&there.path().join("first"));
    well(&run("first", &["--merge", "second"]));
    let (whole, merged) = (results(&there.path().join("whole")), results(&there.path().join("first")));
    assert!(part.cells.len() < whole.cells.len());
    assert_eq!(untimed(&whole), untimed(&merged));
    assert_eq!(whole.trials, merged.trials);
    assert!(whole.cells.iter().all(|c| c.ns_per_query.is_some_and(|ns| ns > 0.0)));

    // A finished cell is not run again, and a study of other values does not mix with it.
    let cell = there.path().join("whole/cells/rocks.scattered.neumip.s1.json");
    let before = std::fs::metadata(&cell).unwrap().modified().unwrap();
    well(&run("whole", &[]));
    assert_eq!(std::fs::metadata(&cell).unwrap().modified().unwrap(), before);
    let other = neumip(&[TINY, &["--out", "whole", "--trials", "3"]].concat(), there.path());
    assert_eq!(other.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&other.stderr).contains("trials 2"));
    let unknown = neumip(&["reproduce", "--quick", "--materials", "rokcs", "--out", "new"], there.path());
    assert_eq!(unknown.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&unknown.stderr).contains("rokcs") && !there.path().join("new").exists());
}

#[test]
fn a_quick_study_answers_every_question_sanely() {
    let there = tempfile::tempdir().unwrap();
    well(&neumip(&["reproduce", "--quick", "--quiet", "--out", "quick"], there.path()));
    let folder = there.path().join("quick");
    let results = results(&folder);
    let find = |material: &str, preset: &str, regime: &str, split: &str| {
        let cell = results.cells.iter().find(|c| {
            c.material == material
                && c.preset == preset
                && c.regime.starts_with(regime)
                && c.split == split
                && c.level.is_none()
        });
        cell.unwrap_or_else(|| panic!("{material} {preset} {regime} {split}")).clone()
    };
    for material in ["metal-rings", "rocks"] {
        for preset in ["neumip", "paper", "improved"] {
            for regime in ["scattered", "slices"] {
                for split in ["train", "test", "offgrid", "grazing", "views/s2", "views/s4"] {
                    let cell = find(material, preset, regime, split);
                    let (mse, flip) = (cell.metrics.mse.unwrap(), cell.metrics.flip);
                    assert!(mse > 0.0 && mse < 0.1, "{cell:?}");
                    assert!(split != "views/s2" || flip.is_some_and(|f| f > 0.0 && f < 1.0), "{cell:?}");
                }
            }
            let cell = find(material, preset, "scattered", "motion/light-arc");
            assert!(cell.metrics.flicker.is_some_and(|f| f > 0.0 && f.is_finite()), "{cell:?}");
        }
        // Half of the texture values' bytes, hardly another answer.
        let (single, half) = (
            find(material, "neumip", "scattered", "test"),
            find(material, "neumip-f16", "scattered", "test"),
        );
        assert!(half.bytes < single.bytes * 2 / 3);
        assert!((half.metrics.mse.unwrap() / single.metrics.mse.unwrap() - 1.0).abs() < HALF_CHANGES);
    }
    let (wide, narrow) =
        (find("rocks", "neumip-w64", "scattered", "test"), find("rocks", "neumip-w8", "scattered", "test"));
    assert!(wide.flops > 4 * narrow.flops && wide.metrics.mse < narrow.metrics.mse, "{wide:?} {narrow:?}");
    assert!(results.trials.iter().any(|t| t.chosen) && results.trials.iter().any(|t| !t.chosen));

    let markdown = std::fs::read_to_string(folder.join("RESULTS.md")).unwrap();
    for title in
        ["Table 1: mse", "Table 1: FLIP", "Table 2", "Figure 3", "Figure 8", "Flicker", "Speed and accuracy"]
    {
        assert!(markdown.contains(title), "{title}");
    }
    let page = std::fs::read_to_string(folder.join("results.html")).unwrap();
    assert!(page.contains("data:image/png;base64,") && !page.contains("<script"));
}

/// Relative change of `mse` by textures in half precision: their rounding is a thousandth of the values.
const HALF_CHANGES: f64 = 0.05;
