//! A material of one's own is examined: after a training, as a run, a checkpoint and a bundle, and badly trained ones are
//! found.

use crate::command_line::{contents, refused, succeed, workshop};
use serde_json::Value;
use std::path::Path;
use std::process::Command;

const DATA: &str = "generate metal-rings --resolution 32 --samples 100000 --spp 4 --held-out-spp 4 --test-pairs 2 --view-size 0 \
                    --field-side 64 --bounces 0 --out rings";
const TRAIN: &str = "train rings --batch 1024 --steps 200 --set train.validations=2";

/// Runs an examination, whose exit code says what was found, and gives what it said.
fn examine(folder: &Path, line: &str) -> String {
    let mut command = Command::new(env!("CARGO_BIN_EXE_neumip"));
    let output = command.args(line.split_whitespace()).current_dir(folder).output().unwrap();
    let said = String::from_utf8(output.stdout).unwrap();
    let wrong = said.contains("should not ship");
    assert_eq!(output.status.code(), Some(i32::from(wrong)), "neumip {line}: {said}");
    said
}

fn read(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

fn verdict(report: &Value, name: &str) -> String {
    let findings = report["findings"].as_array().unwrap();
    let found = findings.iter().find(|finding| finding["name"] == name);
    found.unwrap_or_else(|| panic!("{name} is not in {report}"))["verdict"].as_str().unwrap().into()
}

#[test]
fn a_trained_material_is_examined() {
    let workshop = workshop();
    let folder = workshop.path();
    succeed(folder, DATA);
    let said = succeed(folder, &format!("{TRAIN} --out mine"));
    assert!(said.contains("\nstability: "), "{said}");
    let quick = read(&folder.join("mine/stability.json"));
    assert_eq!((quick["kind"].as_str(), quick["extent"].as_str()), (Some("examination"), Some("quick")));
    for (name, expected) in [("numbers", "fine"), ("horizon", "fine"), ("range", "fine"), ("engines", "fine")]
    {
        assert_eq!(verdict(&quick, name), expected, "{name}");
    }
    let left: Vec<&Value> = quick["left_out"].as_array().unwrap().iter().map(|left| &left["name"]).collect();
    assert!(
        left.iter().any(|name| *name == "truth-off-grid"),
        "choices see the validation split only: {left:?}"
    );
    // The file is a run's own: it opens, resumes and is replaced.
    succeed(folder, "info mine");
    succeed(folder, "train rings --out mine --resume --no-stability");
    succeed(folder, &format!("{TRAIN} --out mine --force --no-stability"));
    assert!(!folder.join("mine/stability.json").exists());

    let some = "--quick --probe numbers --probe range --probe energy";
    let wide = "--probe truth-means --probe truth-off-grid --data rings";
    std::fs::copy(folder.join("mine/best.safetensors"), folder.join("one.safetensors")).unwrap();
    succeed(folder, "export mine --out packed --no-sampler");
    for (k, subject) in ["mine", "one.safetensors", "packed"].into_iter().enumerate() {
        let said =
            examine(folder, &format!("stability {subject} {some} {wide} --out out{k} --json out{k}.json"));
        assert!(said.contains("energy") && said.contains("ship"), "{said}");
        assert!(folder.join(format!("out{k}/pictures/energy.png")).is_file());
        let page = std::fs::read_to_string(folder.join(format!("out{k}/STABILITY.md"))).unwrap();
        assert!(page.contains("pictures/energy.png") && page.contains("truth-off-grid"), "{page}");
        let report = read(&folder.join(format!("out{k}/stability.json")));
        assert_eq!(report, read(&folder.join(format!("out{k}.json"))));
        assert_eq!(report["findings"].as_array().unwrap().len(), 5);
    }
    assert!(
        contents(&folder.join("out0")).values().eq(contents(&folder.join("out1")).values()),
        "the same model"
    );
    succeed(folder, "stability mine --quick --probe range --out out0 --force");
    assert!(!folder.join("out0/pictures/energy.png").exists());

    refused(
        folder,
        &[
            ("stability mine --quick --out out1", 1, &["out1", "--force"]),
            ("stability mine --quick --out precious --force", 1, &["precious", "--out"]),
            ("stability rings --quick --out new", 1, &["rings", "run.json"]),
            ("stability nothing --quick --out new", 1, &["nothing"]),
            ("stability file --quick --out new", 1, &["file"]),
            ("stability mine --quick --probe root-slope --out new", 2, &["root-slope", "seam"]),
            ("stability mine --data precious --out new", 1, &["precious"]),
            ("stability --data rings --quick --out new", 2, &["RUN"]),
            ("stability --out new", 2, &["--quick", "run"]),
        ],
    );

    // The paper's encoding of positions aliases between the texels of slices.
    let literal = "--set model.encoding.u.limit_to_resolution=false --set model.encoding.u.attenuate=false --set model.encoding.pi=false";
    succeed(
        folder,
        "generate metal-rings --resolution 32 --regime slices-24 --spp 4 --held-out-spp 4 --test-pairs 2 --view-size 0 --field-side 64 --bounces 0 --out slices",
    );
    succeed(folder, &format!("{} --out bad {literal} --no-stability", TRAIN.replace("rings", "slices")));
    refused(folder, &[("stability bad --quick --probe nowhere --out new", 2, &["nowhere"])]);
    let said = examine(folder, "stability bad --quick --probe between-texels --out worse");
    assert_eq!(verdict(&read(&folder.join("worse/stability.json")), "between-texels"), "wrong");
    assert!(said.contains("attenuate=true") && said.contains("should not ship"), "{said}");
}
