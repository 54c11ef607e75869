//! The command line: bad input is refused in one line and changes nothing on disk, an interrupt loses nothing, the same
//! seed gives the same bytes on any number of threads, and what is written as JSON says what it promises.

use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::LazyLock;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// The smallest dataset that has every split and the views.
const SMALL: &str = "--samples 4000 --spp 2 --held-out-spp 2 --test-pairs 2 --view-size 8";
/// The shortest training.
const SHORT: &str = "--preset neumip --steps 4 --batch 256 --set train.validations=1";
/// Far beyond what any command here needs on a busy machine: what takes longer hangs.
const PATIENCE: Duration = Duration::from_secs(120);

/// How the folders of these tests are called.
const WORKSHOP: &str = "command-line-";

struct Answer {
    code: Option<i32>,
    said: String,
    complained: String,
}

fn command(folder: &Path, line: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_neumip"));
    // What an error says must not depend on it.
    command.args(line.split_whitespace()).current_dir(folder).env("RUST_BACKTRACE", "1").stdin(Stdio::null());
    command
}

/// Runs `neumip LINE` in a folder.
fn neumip(folder: &Path, line: &str) -> Answer {
    answer(command(folder, line).output().unwrap())
}

fn answer(output: std::process::Output) -> Answer {
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    Answer { code: output.status.code(), said: text(output.stdout), complained: text(output.stderr) }
}

/// As [`neumip`], and it must succeed.
pub fn succeed(folder: &Path, line: &str) -> String {
    let Answer { code, said, complained } = neumip(folder, line);
    assert_eq!((code, complained.as_str()), (Some(0), ""), "neumip {line}");
    said
}

/// Every file (with its bytes) and folder under a folder.
pub fn contents(folder: &Path) -> BTreeMap<PathBuf, Option<Vec<u8>>> {
    let mut found = BTreeMap::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(contents(&path));
            found.insert(path, None);
        } else {
            let bytes = std::fs::read(&path).unwrap();
            found.insert(path, Some(bytes));
        }
    }
    found
}

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for (path, bytes) in contents(from) {
        let place = to.join(path.strip_prefix(from).unwrap());
        match bytes {
            None => std::fs::create_dir_all(place).unwrap(),
            Some(bytes) => {
                std::fs::create_dir_all(place.parent().unwrap()).unwrap();
                std::fs::write(place, bytes).unwrap();
            }
        }
    }
}

fn empty_workshop() -> TempDir {
    tempfile::Builder::new().prefix(WORKSHOP).tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap()
}

/// Removes what earlier runs of these tests left: a static is never dropped.
fn remove_old_workshops() {
    for entry in std::fs::read_dir(env!("CARGO_TARGET_TMPDIR")).unwrap().flatten() {
        let ours = entry.file_name().to_str().is_some_and(|name| name.starts_with(WORKSHOP));
        let age =
            entry.metadata().and_then(|about| about.modified()).ok().and_then(|then| then.elapsed().ok());
        if ours && age.is_some_and(|age| age > 10 * PATIENCE) {
            let _ = std::fs::remove_dir_all(entry.path());
        }
    }
}

/// Made once: a material, datasets of two resolutions, a run and a bundle, and things that are none of these.
static SHARED: LazyLock<TempDir> = LazyLock::new(|| {
    remove_old_workshops();
    let workshop = empty_workshop();
    let folder = workshop.path();
    write_material(folder, "tile", &json!({}));
    let height = image::GrayImage::from_fn(16, 16, |x, y| image::Luma([(16 * x + y * y) as u8]));
    height.save(folder.join("tile/height.png")).unwrap();
    succeed(folder, &format!("generate tile --out data --resolution 16 {SMALL}"));
    succeed(folder, &format!("generate tile --out coarse --resolution 8 {SMALL}"));
    succeed(folder, &format!("train data --out run {SHORT}"));
    succeed(folder, "export run --out bundle --no-sampler");
    std::fs::create_dir(folder.join("precious")).unwrap();
    std::fs::write(folder.join("precious/thesis.txt"), "years").unwrap();
    std::fs::write(folder.join("file"), "text").unwrap();
    workshop
});

/// A copy of [`SHARED`] for one test.
pub fn workshop() -> TempDir {
    let workshop = empty_workshop();
    copy(SHARED.path(), workshop.path());
    workshop
}

/// `FOLDER/NAME/material.json` with some fields set, or removed where null.
pub fn write_material(folder: &Path, name: &str, fields: &Value) {
    let mut material = json!({
        "version": 1, "name": "tile", "height": "height.png", "displacement": 0.05,
        "base_colour": [0.5, 0.4, 0.3], "roughness": 0.5,
    });
    for (field, value) in fields.as_object().unwrap() {
        material[field] = value.clone();
    }
    material.as_object_mut().unwrap().retain(|_, value| !value.is_null());
    std::fs::create_dir_all(folder.join(name)).unwrap();
    std::fs::write(folder.join(name).join("material.json"), material.to_string()).unwrap();
}

/// A line that is refused, its exit code, and what the one line of the error holds: the file, flag or field at fault.
pub type Refusal<'a> = (&'a str, i32, &'a [&'a str]);

/// Runs lines that must be refused and must leave everything in the folder as it was, temporary siblings included.
pub fn refused(folder: &Path, cases: &[Refusal]) {
    let before = contents(folder);
    for (line, code, named) in cases {
        let Answer { code: given, complained, .. } = neumip(folder, line);
        assert_eq!(given, Some(*code), "neumip {line}: {complained}");
        assert!(!complained.contains("panicked"), "neumip {line}: {complained}");
        // What the parser of flags refuses comes with its hint at --help, or is that.
        if !complained.starts_with("error: ") && !complained.contains("Usage: neumip ") {
            assert!(complained.starts_with("neumip: ") && complained.ends_with('\n'), "{line}: {complained}");
            assert_eq!(complained.lines().count(), 1, "neumip {line}: {complained}");
        }
        for part in *named {
            assert!(complained.contains(part), "neumip {line} does not name {part}: {complained}");
        }
        let after = contents(folder);
        let changed = |path: &&PathBuf| before.get(*path) != after.get(*path);
        let difference: Vec<_> = before.keys().chain(after.keys()).filter(changed).collect();
        assert!(difference.is_empty(), "neumip {line} left changes behind: {difference:?}");
    }
}

/// The exit code of a line that fails, and what it complains of.
pub fn complaint(folder: &Path, line: &str) -> (Option<i32>, String) {
    let Answer { code, complained, .. } = neumip(folder, line);
    (code, complained)
}

#[test]
fn bad_materials_are_refused() {
    let workshop = workshop();
    let folder = workshop.path();
    let height = |name: &str, values: [f32; 4]| {
        let value = |x: usize, y: usize| values[2 * y + x];
        let texel = |x, y| (value(x, y), value(x, y), value(x, y));
        exr::prelude::write_rgb_file(folder.join(name), 2, 2, texel).unwrap();
    };
    height("nan.exr", [0.0, f32::NAN, 0.0, 0.0]);
    height("negative.exr", [0.0, 0.0, -1.0, 0.0]);
    height("whole.exr", [0.0, 0.1, 0.2, 0.3]);
    let whole = std::fs::read(folder.join("whole.exr")).unwrap();
    std::fs::write(folder.join("cut.exr"), &whole[..whole.len() - 9]).unwrap();
    let png = std::fs::read(folder.join("tile/height.png")).unwrap();
    std::fs::write(folder.join("cut.png"), &png[..png.len() / 2]).unwrap();
    image::GrayImage::new(1, 1).save(folder.join("speck.png")).unwrap();
    let whole = json!({ "height": "../whole.exr" });
    write_material(folder, "good", &whole);

    let cases: [(Value, &[&str]); 16] = [
        (json!({ "height": "absent.png" }), &["absent.png"]),
        (json!({ "height": "../cut.png" }), &["cut.png"]),
        (json!({ "height": "../cut.exr" }), &["cut.exr"]),
        (json!({ "height": "../nan.exr" }), &["nan.exr", "not finite at row 0, column 1"]),
        (json!({ "height": "../negative.exr" }), &["material.json", "height", "-1"]),
        (json!({ "height": "../speck.png" }), &["speck.png", "1 x 1"]),
        (json!({ "height": "../file" }), &["file", ".png nor .exr"]),
        (json!({ "height": -0.5 }), &["material.json", "height", "-0.5"]),
        (json!({ "height": null }), &["material.json", "height"]),
        (json!({ "base_colour": "absent.exr" }), &["absent.exr"]),
        (json!({ "roughness": 2 }), &["material.json", "roughness", "2"]),
        (json!({ "metalness": [1] }), &["material.json"]),
        (json!({ "displacement": -1 }), &["material.json", "displacement"]),
        (json!({ "gloss": 1 }), &["material.json", "gloss"]),
        (json!({ "version": 7 }), &["material.json", "version", "7"]),
        (json!({ "name": "two\nlines" }), &["material.json", "name"]),
    ];
    for (k, (fields, _)) in cases.iter().enumerate() {
        let name = format!("bad{k}");
        let mut all = whole.clone();
        all.as_object_mut().unwrap().extend(fields.as_object().unwrap().clone());
        write_material(folder, &name, &all);
    }
    for (name, text) in [("broken", "{\"version\": 1,"), ("binary", "\u{1}\u{2}"), ("void", "")] {
        std::fs::create_dir(folder.join(name)).unwrap();
        std::fs::write(folder.join(name).join("material.json"), text).unwrap();
    }

    let line = |name: &str| format!("generate {name} --out out/made --resolution 8 {SMALL}");
    for (k, (_, named)) in cases.iter().enumerate() {
        refused(folder, &[(&line(&format!("bad{k}")), 1, named)]);
    }
    for name in ["broken", "binary", "void", "precious"] {
        refused(folder, &[(&line(name), 1, &[&format!("{name}/material.json")])]);
    }
    refused(
        folder,
        &[
            (&line("file"), 1, &["file"]),
            (&line("sand"), 2, &["sand", "rocks"]),
            (&line("no.json"), 2, &["no.json"]),
        ],
    );
    succeed(folder, &line("good"));
}

#[test]
fn bad_generation_is_refused() {
    let workshop = workshop();
    let folder = workshop.path();
    // Other programs call their files so too.
    std::fs::create_dir(folder.join("theirs")).unwrap();
    std::fs::write(folder.join("theirs/dataset.json"), "{\"format\": 1, \"rows\": 12}").unwrap();
    let line = |rest: &str| format!("generate tile {SMALL} {rest}");
    let cases: [(&str, i32, &[&str]); 20] = [
        ("--out new --resolution 100", 2, &["resolution", "100"]),
        ("--out new --resolution 3", 2, &["resolution", "3"]),
        ("--out new --resolution 100000", 2, &["resolution", "100000"]),
        ("--out new --regime slices-1", 2, &["regime", "1"]),
        ("--out new --regime slices-0", 2, &["regime", "0"]),
        ("--out new --regime stripes", 2, &["regime", "stripes"]),
        ("--out new --view-tiles 0", 2, &["view_tiles"]),
        ("--out new --threads 0", 2, &["--threads 0"]),
        ("--out new --threads many", 2, &["--threads"]),
        ("--out new --resolution -8", 2, &["-8"]),
        ("--resolution 8", 2, &["--out"]),
        ("--out new --resume --force", 2, &["--force"]),
        ("--out data --resolution 16", 1, &["data", "resume", "force"]),
        ("--out data --resolution 16 --seed 9 --resume", 1, &["data/dataset.json", "generation"]),
        ("--out precious --resolution 8", 1, &["precious"]),
        ("--out precious --resolution 8 --force", 1, &["precious"]),
        ("--out theirs --resolution 8 --force", 1, &["theirs", "dataset.json"]),
        ("--out file --resolution 8 --force", 1, &["file"]),
        ("--out file/below --resolution 8", 1, &["file/below"]),
        ("--out new --resolution 8 --json file/below.json", 1, &["file/below.json"]),
    ];
    for (rest, code, named) in cases {
        refused(folder, &[(&line(rest), code, named)]);
    }
    let seldom = "--out new --resolution 8";
    refused(
        folder,
        &[
            (&format!("generate tile {seldom} --samples 0"), 2, &["samples"]),
            (&format!("generate tile {seldom} --spp 0"), 2, &["spp"]),
            (&format!("generate tile {seldom} --held-out-spp 0"), 2, &["held_out_spp"]),
            ("generate", 2, &["--out"]),
            ("", 2, &["Usage"]),
            ("paint tile", 2, &["paint"]),
        ],
    );
}

#[test]
fn bad_training_is_refused() {
    let workshop = workshop();
    let folder = workshop.path();
    std::fs::create_dir(folder.join("theirs")).unwrap();
    std::fs::write(folder.join("theirs/run.json"), "{\"miles\": 26}").unwrap();
    std::fs::write(folder.join("theirs/splits.csv"), "5 km").unwrap();
    std::fs::write(folder.join("half.json"), "{\"model\": {}").unwrap();
    copy(&folder.join("run"), &folder.join("cut"));
    let state = "cut/last-000000004.state.safetensors";
    cut(folder.join(state));
    copy(&folder.join("run"), &folder.join("zero"));
    change_json(&folder.join("zero/run.json"), |run| run["config"]["train"]["piece"] = json!(0));
    copy(&folder.join("run"), &folder.join("later"));
    change_json(&folder.join("later/run.json"), |run| run["format"] = json!(99));

    let line = |rest: &str| format!("train data {rest}");
    let cases: [(&str, i32, &[&str]); 33] = [
        ("--out new --set model.texture.chanels=3", 2, &["model.texture.chanels"]),
        ("--out new --set train.batch", 2, &["--set train.batch"]),
        ("--out new --set train.batch=many", 2, &["train.batch", "many"]),
        ("--out new --set =", 2, &["no such field"]),
        ("--out new --set model.texture.channels=0", 2, &["texture.channels"]),
        ("--out new --set model.decoder.hidden=[]", 2, &["decoder.hidden"]),
        ("--out new --set model.decoder.kind=forest", 2, &["model.decoder.kind", "forest"]),
        ("--out new --set train.validations=0", 2, &["train.validations"]),
        ("--out new --batch 100", 2, &["train.batch", "100"]),
        ("--out new --batch 0", 2, &["train.batch"]),
        ("--out new --steps 0", 2, &["train.budget"]),
        ("--out new --minutes nan", 2, &["train.budget"]),
        ("--out new --steps 1 --samples 1", 2, &["--steps", "--samples"]),
        ("--out new --learning-rate=-1", 2, &["train.learning_rate.peak"]),
        ("--out new --stages s9", 2, &["train.stages", "s9"]),
        ("--out new --memory junk", 2, &["--memory", "junk"]),
        ("--out new --device cuda", 2, &["--device cuda"]),
        ("--out new --device abacus", 2, &["--device abacus"]),
        ("--out new --threads 0", 2, &["--threads 0"]),
        ("--out new --preset best", 2, &["--preset best", "improved"]),
        ("--out new --preset absent.json", 1, &["absent.json"]),
        ("--out new --preset half.json", 1, &["half.json"]),
        ("--out new --json file/below.json", 1, &["file/below.json"]),
        ("--out run", 1, &["run", "--force", "--resume"]),
        ("--out precious --force", 1, &["precious", "thesis.txt"]),
        ("--out theirs --force", 1, &["theirs", "splits.csv"]),
        ("--out file --force", 1, &["file"]),
        ("--out file/below", 1, &["file/below"]),
        ("--out new --resume", 1, &["new/run.json"]),
        ("--out run --resume --steps 9", 2, &["--resume", "--steps"]),
        ("--out cut --resume", 1, &["last-000000004.state.safetensors"]),
        ("--out zero --resume", 1, &["zero/run.json", "train.piece"]),
        ("--out later --resume", 1, &["later/run.json", "99"]),
    ];
    for (rest, code, named) in cases {
        refused(folder, &[(&line(rest), code, named)]);
    }
    refused(folder, &[("train coarse --out new --steps 4", 2, &["train.piece", "16", "8"])]);
    refused(folder, &[("train coarse --out run --resume", 1, &["coarse", "run"])]);
    refused(folder, &[("train absent --out new", 1, &["absent/dataset.json"])]);
    refused(folder, &[("train run --out new", 1, &["run/dataset.json"])]);
}

#[test]
fn damaged_datasets_are_refused() {
    let workshop = workshop();
    let folder = workshop.path();
    type Damage<'a> = (&'a str, fn(&Path), &'a [&'a str]);
    fn describe(data: &Path, change: fn(&mut Value)) {
        change_json(&data.join("dataset.json"), change);
    }
    let damages: [Damage; 10] = [
        ("short-frame", |d| cut(d.join("train-00000.exr")), &["train-00000.exr", "bytes"]),
        ("short-table", |d| cut(d.join("test-00000.safetensors")), &["test-00000.safetensors", "bytes"]),
        ("short-view", |d| cut(d.join("views-s4.exr")), &["views-s4.exr"]),
        ("short-json", |d| cut(d.join("dataset.json")), &["dataset.json", "JSON"]),
        ("lost", |d| std::fs::remove_file(d.join("grazing-00000.exr")).unwrap(), &["grazing-00000.exr"]),
        ("later", |d| describe(d, |m| m["format"] = json!(99)), &["dataset.json", "99"]),
        ("other", |d| describe(d, |m| m["colour"] = json!(1)), &["dataset.json", "colour"]),
        (
            "empty",
            |d| describe(d, |m| m["splits"]["train"]["files"] = json!([])),
            &["dataset.json", "no training data"],
        ),
        (
            "huge",
            |d| describe(d, |m| m["splits"]["train"]["side"] = json!(1u64 << 40)),
            &["dataset.json", "side"],
        ),
        ("single", |d| one_direction(&d.join("train-00000.safetensors")), &["dataset.json", "single pair"]),
    ];
    for (name, damage, named) in damages {
        let data = folder.join(name);
        copy(&folder.join("data"), &data);
        damage(&data);
        refused(
            folder,
            &[
                (&format!("train {name} --out new {SHORT}"), 1, named),
                (&format!("evaluate run --data {name} --rounds 0 --json new.json"), 1, named),
                (&format!("info {name} --json new.json"), 1, named),
            ],
        );
    }
    // The length is right and the description is; only the values are not.
    copy(&folder.join("data"), &folder.join("flipped"));
    let frame = folder.join("flipped/test-00000.exr");
    let mut bytes = std::fs::read(&frame).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0xff;
    std::fs::write(frame, bytes).unwrap();
    copy(&folder.join("data"), &folder.join("unvalidated"));
    describe(&folder.join("unvalidated"), |m| {
        m["splits"].as_object_mut().unwrap().remove("validation");
    });
    refused(
        folder,
        &[
            ("evaluate run --data flipped --rounds 0 --json new.json", 1, &["flipped/test-00000.exr"]),
            (
                "evaluate run --data unvalidated --rounds 0 --splits validation",
                1,
                &["unvalidated", "validation"],
            ),
            (&format!("train unvalidated --out new {SHORT}"), 1, &["unvalidated", "validation"]),
        ],
    );
}

#[test]
fn bad_checkpoints_and_bundles_are_refused() {
    let workshop = workshop();
    let folder = workshop.path();
    let best = std::fs::read(folder.join("run/best.safetensors")).unwrap();
    std::fs::write(folder.join("cut.safetensors"), &best[..best.len() / 2]).unwrap();
    std::fs::write(folder.join("header.safetensors"), &best[..100]).unwrap();
    std::fs::write(folder.join("noise"), &best[best.len() - 999..]).unwrap();
    let changed = |name: &str, change: &dyn Fn(&mut Value)| {
        std::fs::write(folder.join(name), change_header(&best, change)).unwrap();
    };
    changed("shape.safetensors", &|header| header["texture.level0"]["shape"] = json!([16, 8, 14]));
    changed("later.safetensors", &|header| change_metadata(header, |h| h["format"] = json!(99)));
    changed("wide.safetensors", &|header| {
        change_metadata(header, |h| h["architecture"]["model"]["decoder"]["hidden"] = json!([1u64 << 40]));
    });
    let beyond = change_value(&best, "texture.level0", 70_000.0);
    std::fs::write(folder.join("beyond.safetensors"), beyond).unwrap();
    copy(&folder.join("bundle"), &folder.join("altered"));
    std::fs::write(folder.join("altered/decoder.onnx"), "0").unwrap();
    copy(&folder.join("bundle"), &folder.join("annotated"));
    std::fs::write(folder.join("annotated/notes.txt"), "mine").unwrap();

    for (name, named) in [
        ("cut.safetensors", "cut.safetensors"),
        ("header.safetensors", "header"),
        ("noise", "noise"),
        ("file", "file"),
        ("shape.safetensors", "texture.level0"),
        ("later.safetensors", "99"),
        ("wide.safetensors", "decoder.hidden"),
        ("absent", "absent"),
        ("tile", "tile"),
        ("precious", "precious"),
    ] {
        refused(
            folder,
            &[
                (&format!("info {name} --json new.json"), 1, &[name, named]),
                (&format!("evaluate {name} --data data --rounds 0 --json new.json"), 1, &[name, named]),
                (&format!("export {name} --out new"), 1, &[name, named]),
            ],
        );
    }
    refused(
        folder,
        &[
            ("evaluate run --data coarse --rounds 0", 1, &["coarse", "[8, 8]", "[16, 16]"]),
            ("evaluate run --data absent --rounds 0", 1, &["absent/dataset.json"]),
            ("evaluate run --data data --splits middle", 2, &["--splits", "middle"]),
            ("evaluate run --data data --rounds 1 --queries 0", 2, &["--queries 0"]),
            ("evaluate run --data data --rounds 1 --queries 99999999999", 2, &["--queries 99999999999"]),
            ("evaluate run --data data --device cuda", 2, &["--device cuda"]),
            ("evaluate --data data", 2, &["<RUNS>"]),
            ("evaluate run --data data --rounds 0 --json precious", 1, &["precious"]),
            ("evaluate run --data data --rounds 0 --json file/below.json", 1, &["file/below.json"]),
            ("info altered", 1, &["altered/decoder.onnx"]),
            ("info run --json file/below.json", 1, &["file/below.json"]),
            ("export run --out bundle", 1, &["bundle", "exists"]),
            ("export run --out data --force", 1, &["data", "not a bundle"]),
            ("export run --out precious --force", 1, &["precious", "not a bundle"]),
            // It has a material.json, as a bundle has.
            ("export run --out tile --force", 1, &["tile", "not a bundle"]),
            ("export run --out annotated --force", 1, &["annotated", "notes.txt"]),
            ("export run --out file --force", 1, &["file"]),
            ("export run --out file/below", 1, &["file/below"]),
            ("export run --out new --json file/below.json", 1, &["file/below.json"]),
            ("export beyond.safetensors --out new --half-textures", 2, &["tensor texture.level0", "70000"]),
            ("export beyond.safetensors --out bundle --half-textures --force", 2, &["tensor texture.level0"]),
            ("export run --out bundle --half-textures", 1, &["bundle", "exists"]),
            ("export run --out precious --half-textures --force", 1, &["precious", "not a bundle"]),
            ("export run --out new --half --int8", 2, &["--half", "--int8"]),
            ("export run --out new --opset 16", 2, &["--opset", "13, 17 and 21"]),
            ("export run", 2, &["--out"]),
            ("export run --check", 1, &["run", "no bundle"]),
            ("export bundle --check --force", 2, &["--force", "--out"]),
            ("export altered --check", 1, &["altered/decoder.onnx"]),
        ],
    );
}

#[test]
fn half_textures_are_an_option_of_the_export_that_says_what_it_costs() {
    let workshop = workshop();
    let folder = workshop.path();
    let said = succeed(folder, "export run --out half --half-textures --no-sampler --json half.json");
    assert!(said.contains("half textures move the answers by at most"), "{said}");
    let read =
        |name: &str| -> Value { serde_json::from_slice(&std::fs::read(folder.join(name)).unwrap()).unwrap() };
    let half = read("half/material.json");
    let precision = &half["rounding"];
    assert_eq!(precision["storage"], json!({"textures": "f16", "weights": "f32"}));
    let number = |name: &str| precision[name].as_f64().unwrap();
    let (largest, mean) = (number("largest_difference"), number("mean_difference"));
    assert!(mean > 0.0 && mean < largest, "{precision}");
    assert!(said.contains(&format!("{largest:.1e}")) && said.contains(&format!("{mean:.1e}")), "{said}");
    assert_eq!(&read("half.json")["rounding"], precision);
    let described: Value = serde_json::from_str(&succeed(folder, "info half")).unwrap();
    assert_eq!(&described["material"]["rounding"], precision);

    let single = read("bundle/material.json");
    assert_eq!(single.get("rounding"), None);
    let values = single["cost"]["texture_values"].as_u64().unwrap();
    let bytes = |bundle: &Value| bundle["cost"]["bytes"].as_u64().unwrap();
    assert_eq!(bytes(&single) - bytes(&half), 2 * values);

    // Without the flag, it is the bundle that it was.
    let made = |name: &str| -> Vec<(PathBuf, Option<Vec<u8>>)> {
        let all = contents(&folder.join(name)).into_iter();
        all.map(|(path, bytes)| (path.file_name().unwrap().into(), bytes)).collect()
    };
    let said = succeed(folder, "export run --out again --no-sampler");
    assert!(!said.contains("half textures"), "{said}");
    assert!(made("again") == made("bundle") && made("half") != made("bundle"));
    // What is rounded already loses nothing by being rounded again.
    succeed(folder, "export half/model.safetensors --out twice --half-textures --no-sampler");
    let twice = read("twice/material.json");
    assert_eq!(twice["rounding"]["largest_difference"], json!(0.0));
    let graph = |name: &str| std::fs::read(folder.join(name).join("material.onnx")).unwrap();
    assert!(graph("twice") == graph("half"));
}

#[test]
fn a_bundle_is_put_to_the_test_however_it_is_stored() {
    let workshop = workshop();
    let folder = workshop.path();
    let read =
        |name: &str| -> Value { serde_json::from_slice(&std::fs::read(folder.join(name)).unwrap()).unwrap() };
    let bytes = |name: &str| read(name)["cost"]["bytes"].as_u64().unwrap();
    succeed(folder, "export bundle --check --json found.json");
    let found = read("found.json");
    let files: Vec<&str> = found.as_array().unwrap().iter().map(|a| a["files"].as_str().unwrap()).collect();
    for name in ["model.safetensors", "material.onnx", "decoder.onnx", "prepare.onnx, evaluate.onnx"] {
        assert!(files.contains(&name), "{name}: {files:?}");
    }
    assert!(files.contains(&"texture-0.exr") && files.contains(&"weights-f16.bin"), "{files:?}");

    succeed(folder, "export run --out halfs --half --check --opset 13 --no-sampler");
    succeed(folder, "export run --out bytes --int8 --check --opset 21 --sampler-steps 20 --json bytes.json");
    let single = bytes("bundle/material.json");
    assert_eq!(bytes("halfs/material.json") * 2, single);
    assert!(bytes("bytes/material.json") < bytes("halfs/material.json"));
    assert_eq!(read("bytes/material.json")["graphs"][0]["opset"], json!(21));
    assert!(!read("bytes.json")["artefacts"].as_array().unwrap().is_empty());
    let stored = json!({"textures": "i8", "weights": "f16"});
    assert_eq!(read("bytes/material.json")["rounding"]["storage"], stored);

    // A bundle that answers otherwise than its golden file says: every checksum is right, and it is found out.
    let golden = folder.join("bytes/golden.json");
    let mut answers: Value = serde_json::from_slice(&std::fs::read(&golden).unwrap()).unwrap();
    answers["rgb"][3][1] = json!(answers["rgb"][3][1].as_f64().unwrap() + 0.01);
    let text = serde_json::to_vec(&answers).unwrap();
    let mut sidecar = read("bytes/material.json");
    let entry =
        sidecar["files"].as_array_mut().unwrap().iter_mut().find(|f| f["name"] == "golden.json").unwrap();
    entry["bytes"] = json!(text.len());
    let digest = Sha256::digest(&text);
    entry["sha256"] = json!(digest.iter().map(|b| format!("{b:02x}")).collect::<String>());
    std::fs::write(&golden, &text).unwrap();
    std::fs::write(folder.join("bytes/material.json"), serde_json::to_vec(&sidecar).unwrap()).unwrap();
    refused(folder, &[("export bytes --check", 1, &["bytes", "is off by"])]);
}

#[test]
fn a_sampler_is_fitted_measured_and_put_into_a_bundle() {
    let workshop = workshop();
    let folder = workshop.path();
    let said = succeed(folder, "sampler run --out lobes.safetensors --steps 20 --json lobes.json");
    assert!(said.contains("furnace") && said.contains("sky"), "{said}");
    let read =
        |name: &str| -> Value { serde_json::from_slice(&std::fs::read(folder.join(name)).unwrap()).unwrap() };
    assert_eq!(read("lobes.json")["gains"].as_array().unwrap().len(), 2);
    let described: Value = serde_json::from_str(&succeed(folder, "info lobes.safetensors")).unwrap();
    assert_eq!(described["kind"], json!("sampler"));
    succeed(folder, "export run --out sampled --sampler lobes.safetensors --check");
    let bundled = std::fs::read(folder.join("sampled/sampler.safetensors")).unwrap();
    assert_eq!(bundled, std::fs::read(folder.join("lobes.safetensors")).unwrap());
    assert_eq!(read("sampled/material.json")["sampler"]["config"]["hidden"], json!([16, 16]));
    let plain = read("bundle/material.json");
    assert_eq!(plain.get("sampler"), None, "the shared bundle has none");
    // Another material's: it reads another number of channels.
    succeed(
        folder,
        "train data --out narrow --preset neumip --steps 2 --batch 256 --set train.validations=1 \
                     --set model.texture.channels=3",
    );
    refused(
        folder,
        &[
            ("sampler run --out lobes.safetensors", 1, &["lobes.safetensors", "--force"]),
            ("sampler run --out new.safetensors --steps 0", 2, &["steps"]),
            ("sampler missing --out new.safetensors", 1, &["missing"]),
            ("export narrow --out new --sampler lobes.safetensors", 2, &["sampler.features", "7"]),
            ("export run --out new --sampler absent.safetensors", 1, &["absent.safetensors"]),
            ("export run --out new --sampler run/best.safetensors", 1, &["best.safetensors"]),
            ("export run --out new --sampler lobes.safetensors --no-sampler", 2, &["--no-sampler"]),
        ],
    );
}

#[test]
fn force_replaces_what_it_names_and_nothing_else() {
    let workshop = workshop();
    let folder = workshop.path();
    for name in ["data", "run"] {
        std::fs::write(folder.join(name).join("notes.txt"), "mine").unwrap();
    }
    std::fs::write(folder.join("run/last-000000002.safetensors"), "a killed run left it").unwrap();
    std::fs::write(folder.join("run/.neumip-killed"), "a killed run left it").unwrap();
    succeed(folder, &format!("generate tile --out data --force --resolution 8 {SMALL}"));
    succeed(folder, &format!("train data --out run --force {SHORT} --seed 5 --set train.piece=8"));
    succeed(folder, "export run --out bundle --force --no-sampler");
    succeed(folder, "export run --out bundles/of/mine --no-sampler");
    let names = |name: &str| -> Vec<String> {
        let all = contents(&folder.join(name)).into_keys();
        all.map(|path| path.file_name().unwrap().to_str().unwrap().to_string()).collect()
    };
    assert!(names("data").contains(&"notes.txt".into()));
    assert_eq!(
        names("run"),
        [
            "best.safetensors",
            "history.json",
            "last-000000004.safetensors",
            "last-000000004.state.safetensors",
            "notes.txt",
            "run.json",
            "stability.json"
        ]
    );
    assert_eq!(contents(&folder.join("bundle")).len(), contents(&folder.join("bundles/of/mine")).len());
    let described: Value = serde_json::from_str(&succeed(folder, "info bundle")).unwrap();
    assert_eq!(described["material"]["resolution"], json!([8, 8]));
}

#[test]
fn a_reader_that_leaves_is_no_failure() {
    let shared = SHARED.path();
    for line in ["info data", "export run --out ../unread --no-sampler", "--help"] {
        let workshop = empty_workshop();
        copy(shared, &workshop.path().join("inner"));
        let mut command = command(&workshop.path().join("inner"), line);
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        drop(child.stdout.take());
        let Answer { code, complained, .. } = answer(child.wait_with_output().unwrap());
        assert_eq!((code, complained.as_str()), (Some(0), ""), "neumip {line}");
    }
}

#[test]
fn the_same_seed_gives_the_same_bytes_on_any_number_of_threads() {
    let mut first: Option<BTreeMap<String, Vec<u8>>> = None;
    for threads in [1, 2, 4] {
        let workshop = empty_workshop();
        let folder = workshop.path();
        // The run's name is the same everywhere, as the folder is.
        let lines = [
            format!("generate rocks --out data --resolution 16 {SMALL} --seed 3"),
            "train data --out run --steps 20 --batch 1024 --seed 3 --set train.validations=2".into(),
            "export run --out bundle".into(),
        ];
        for line in lines {
            succeed(folder, &format!("{line} --threads {threads} --quiet"));
        }
        let mut made = BTreeMap::new();
        for (path, bytes) in contents(folder) {
            let name = path.strip_prefix(folder).unwrap().to_str().unwrap().to_string();
            // The rest of a run tells the time.
            if let Some(bytes) = bytes.filter(|_| !name.starts_with("run/") || name == "run/best.safetensors")
            {
                made.insert(name, bytes);
            }
        }
        assert!(made.len() > 20 && made.contains_key("run/best.safetensors"), "{:?}", made.keys());
        let first = first.get_or_insert_with(|| made.clone());
        let differ: Vec<_> = made.keys().filter(|name| made.get(*name) != first.get(*name)).collect();
        assert!(differ.is_empty() && made.len() == first.len(), "{threads} threads: {differ:?}");
    }
}

/// Starts a line, interrupts it as soon as a file is there, and waits for its end.
#[cfg(unix)]
fn interrupted(folder: &Path, line: &str, sign: &str) -> Answer {
    let mut command = command(folder, line);
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let begun = Instant::now();
    while !folder.join(sign).is_file() && begun.elapsed() < PATIENCE {
        assert_eq!(child.try_wait().unwrap(), None, "neumip {line} ended without {sign}");
        std::thread::sleep(Duration::from_millis(1));
    }
    let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(sent.success());
    while child.try_wait().unwrap().is_none() {
        if begun.elapsed() > PATIENCE {
            child.kill().unwrap();
            panic!("neumip {line} does not stop");
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    answer(child.wait_with_output().unwrap())
}

/// The exit code of a line that is interrupted as soon as a file is there.
#[cfg(unix)]
pub fn stopped(folder: &Path, line: &str, sign: &str) -> Option<i32> {
    interrupted(folder, line, sign).code
}

/// One line that says how to go on.
#[cfg(unix)]
fn check_interrupted(Answer { code, complained, .. }: Answer) {
    assert_eq!(code, Some(130), "{complained}");
    assert!(
        complained.starts_with("neumip: interrupted: ") && complained.contains("--resume"),
        "{complained}"
    );
    assert_eq!(complained.lines().count(), 1, "{complained}");
}

#[cfg(unix)]
#[test]
fn an_interrupted_training_goes_on() {
    let workshop = workshop();
    let folder = workshop.path();
    let line = "train data --out long --preset neumip --steps 1500 --batch 256 --set train.validations=1";
    check_interrupted(interrupted(folder, line, "long/run.json"));
    let states = contents(&folder.join("long")).into_keys();
    let states = states.filter(|path| path.to_str().unwrap().ends_with(".state.safetensors"));
    assert_eq!(states.count(), 1);
    succeed(folder, "train data --out long --resume");
    let described: Value = serde_json::from_str(&succeed(folder, "info long")).unwrap();
    assert_eq!(described["answers"]["provenance"]["steps"], json!(1500));
}

#[cfg(unix)]
#[test]
fn an_interrupted_dataset_goes_on_to_the_same_bytes() {
    let workshop = workshop();
    let folder = workshop.path();
    let line = "generate tile --resolution 16 --samples 200000 --spp 16 --held-out-spp 8 --test-pairs 2 --view-size 8";
    check_interrupted(interrupted(folder, &format!("{line} --out stopped"), "stopped/dataset.json"));
    let partial: Value =
        serde_json::from_slice(&std::fs::read(folder.join("stopped/dataset.json")).unwrap()).unwrap();
    assert_eq!(partial["complete"], json!(false));
    succeed(folder, &format!("{line} --out stopped --resume"));
    succeed(folder, &format!("{line} --out straight"));
    let made = |name: &str| -> Vec<(PathBuf, Option<Vec<u8>>)> {
        let all = contents(&folder.join(name)).into_iter();
        all.map(|(path, bytes)| (path.file_name().unwrap().into(), bytes)).collect()
    };
    assert!(made("stopped") == made("straight"), "the bytes differ");
}

#[test]
fn evaluations_are_told_in_a_table_and_in_json() {
    let workshop = workshop();
    let folder = workshop.path();
    copy(&folder.join("run"), &folder.join("twin"));
    let said = succeed(
        folder,
        "evaluate run twin/best.safetensors --data data --rounds 2 --queries 512 --json errors.json",
    );
    for part in [
        "[1] run: tile",
        "[2] twin/best.safetensors: tile",
        "mse[1]",
        "mse[2]",
        "ns a query",
        "grazing",
        "views/s4",
    ] {
        assert!(said.contains(part), "{part} is missing: {said}");
    }
    let all: Value = serde_json::from_slice(&std::fs::read(folder.join("errors.json")).unwrap()).unwrap();
    assert_eq!(all.as_array().unwrap().len(), 2);
    for one in all.as_array().unwrap() {
        has(
            one,
            &["run", "material", "resolution", "samples_per_texel", "weights", "flops", "bytes", "engine"],
        );
        has(&one["cost"], &["ns_per_query", "ns_low", "ns_high", "rounds", "queries"]);
        let rows = one["rows"].as_array().unwrap();
        for split in ["validation", "test", "offgrid", "grazing", "views/s2", "views/s4"] {
            let row = rows.iter().find(|row| row["split"] == split && row["level"].is_null()).unwrap();
            has(row, &["queries", "mse", "mse_linear", "mse_log1p", "psnr", "noise"]);
        }
    }
    assert_eq!(all[0]["rows"], all[1]["rows"]);
    assert_eq!(succeed(folder, "evaluate run --data data --rounds 0 --quiet"), "");
}

#[test]
fn info_describes_everything_that_is_made() {
    let workshop = workshop();
    let folder = workshop.path();
    let describe = |path: &str| -> Value {
        let said = succeed(folder, &format!("info {path} --json info.json"));
        let written: Value =
            serde_json::from_slice(&std::fs::read(folder.join("info.json")).unwrap()).unwrap();
        assert_eq!(written, serde_json::from_str::<Value>(&said).unwrap());
        written
    };
    let checkpoint = describe("run/best.safetensors");
    assert_eq!(checkpoint["kind"], "checkpoint");
    let sizes = ["resolution", "levels", "weights", "texture_values", "bytes", "flops_per_query", "tensors"];
    has(&checkpoint, &sizes);
    has(&checkpoint, &["format", "material", "measure", "height_range", "model", "provenance", "errors"]);
    has(&checkpoint["provenance"], &["data", "seed", "steps", "samples", "train"]);
    let run = describe("run");
    assert_eq!((&run["kind"], &run["checkpoint"]), (&json!("run"), &json!("best.safetensors")));
    has(&run["config"], &["model", "train"]);
    assert_eq!(run["answers"], checkpoint);
    let data = describe("data");
    assert_eq!(data["kind"], "dataset");
    has(
        &data["dataset"],
        &["format", "generator", "complete", "material", "resolution", "measure", "splits", "views"],
    );
    let bundle = describe("bundle");
    assert_eq!(bundle["kind"], "bundle");
    has(&bundle["material"], &["conventions", "evaluate", "graphs", "textures", "cost", "errors", "files"]);
}

#[test]
fn every_verb_has_help_with_an_example() {
    for verb in ["demo", "generate", "train", "evaluate", "export", "info"] {
        let help = succeed(SHARED.path(), &format!("{verb} --help"));
        let example =
            help.lines().any(|line| line.contains(&format!("neumip {verb} ")) && !line.contains("Usage"));
        assert!(example, "{help}");
        for flag in ["--threads", "--quiet", "--json"] {
            assert!(help.contains(flag), "{verb} lacks {flag}");
        }
    }
}

fn has(object: &Value, keys: &[&str]) {
    for key in keys {
        assert!(object.get(key).is_some_and(|value| !value.is_null()), "{key} is missing: {object:#}");
    }
}

/// Leaves the first half of a file.
fn cut(path: PathBuf) {
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(path, &bytes[..bytes.len() / 2]).unwrap();
}

fn change_json(path: &Path, change: impl Fn(&mut Value)) {
    let mut value: Value = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
    change(&mut value);
    std::fs::write(path, value.to_string()).unwrap();
}

/// A safetensors file with another header.
fn change_header(file: &[u8], change: impl Fn(&mut Value)) -> Vec<u8> {
    let length = u64::from_le_bytes(file[..8].try_into().unwrap()) as usize;
    let mut header: Value = serde_json::from_slice(&file[8..8 + length]).unwrap();
    change(&mut header);
    let header = header.to_string();
    [&(header.len() as u64).to_le_bytes(), header.as_bytes(), &file[8 + length..]].concat()
}

/// A safetensors file with the first value of a tensor replaced.
fn change_value(file: &[u8], tensor: &str, value: f32) -> Vec<u8> {
    let length = u64::from_le_bytes(file[..8].try_into().unwrap()) as usize;
    let header: Value = serde_json::from_slice(&file[8..8 + length]).unwrap();
    let begin = 8 + length + header[tensor]["data_offsets"][0].as_u64().unwrap() as usize;
    let mut changed = file.to_vec();
    changed[begin..begin + 4].copy_from_slice(&value.to_le_bytes());
    changed
}

/// Changes the JSON inside the metadata of a checkpoint's header.
fn change_metadata(header: &mut Value, change: impl Fn(&mut Value)) {
    let text = header["__metadata__"]["neumip"].as_str().unwrap();
    let mut inner: Value = serde_json::from_str(text).unwrap();
    change(&mut inner);
    header["__metadata__"]["neumip"] = json!(inner.to_string());
}

/// Gives every patch of a table the first patch's directions.
fn one_direction(table: &Path) {
    let mut file = std::fs::read(table).unwrap();
    let length = u64::from_le_bytes(file[..8].try_into().unwrap()) as usize;
    let header: Value = serde_json::from_slice(&file[8..8 + length]).unwrap();
    for name in ["wi", "wo"] {
        let offset = |k: usize| header[name]["data_offsets"][k].as_u64().unwrap() as usize;
        let data = &mut file[8 + length..][offset(0)..offset(1)];
        let (first, rest) = data.split_at_mut(8);
        rest.chunks_exact_mut(8).for_each(|direction| direction.copy_from_slice(first));
    }
    std::fs::write(table, file).unwrap();
}
