//! Datasets and pictures from the command line: shards, appending, lights, noise, meshes, maps that do not tile.

use crate::command_line::{contents, refused, succeed, workshop, write_material};
use serde_json::{Value, json};
use std::path::Path;

/// A small dataset of a material in the folder of a test.
const SMALL: &str = "--resolution 16 --spp 2 --held-out-spp 2 --test-pairs 2 --view-size 8";

fn read(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

fn files(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let name = |path: &Path| path.file_name().unwrap().to_str().unwrap().to_string();
    contents(folder).into_iter().filter_map(|(path, bytes)| Some((name(&path), bytes?))).collect()
}

#[test]
fn shards_in_one_folder_make_the_dataset_of_one_run() {
    let workshop = workshop();
    let folder = workshop.path();
    let line = format!("generate tile {SMALL} --samples 6000");
    succeed(folder, &format!("{line} --out whole"));
    for shard in ["2/3", "1/3", "3/3"] {
        let said = succeed(folder, &format!("{line} --out parts --shard {shard}"));
        assert!(said.contains(shard) && said.contains("--resume"), "{said}");
    }
    assert!(!folder.join("parts/dataset.json").exists());
    succeed(folder, &format!("{line} --out parts --resume"));
    assert!(files(&folder.join("parts")) == files(&folder.join("whole")), "the bytes differ");
    succeed(folder, &format!("{line} --out other --seed 5"));
    assert!(files(&folder.join("other")) != files(&folder.join("whole")), "another seed must show");
}

#[test]
fn a_dataset_is_appended_to_and_keeps_its_files() {
    let workshop = workshop();
    let folder = workshop.path();
    let line = format!("generate tile {SMALL} --out grown");
    succeed(folder, &format!("{line} --samples 12000"));
    let before = files(&folder.join("grown"));
    succeed(folder, &format!("{line} --samples 40000 --append"));
    let after = files(&folder.join("grown"));
    let kept = before.iter().filter(|(name, _)| name.ends_with(".exr") || name.ends_with(".safetensors"));
    assert!(kept.clone().count() > 0 && kept.clone().all(|file| after.contains(file)));
    let samples = |manifest: &Value| -> u64 {
        let blocks = |file: &Value| file["blocks"].as_u64().unwrap() * 16 * 16;
        manifest["splits"]["train"]["files"].as_array().unwrap().iter().map(blocks).sum()
    };
    assert!(samples(&read(&folder.join("grown/dataset.json"))) >= 40_000);
    refused(folder, &[(&format!("{line} --samples 50000 --append --seed 8"), 1, &["grown", "seed"])]);
}

#[test]
fn views_have_any_light_and_samples_the_noise_that_is_asked_for() {
    let workshop = workshop();
    let folder = workshop.path();
    let line = format!("generate metal-rings {SMALL} --field-side 64 --samples 4000");
    succeed(folder, &format!("{line} --out lit --light 60,-90"));
    let manifest = read(&folder.join("lit/dataset.json"));
    let names: Vec<_> = manifest["views"].as_array().unwrap().iter().map(|view| &view["name"]).collect();
    assert!(names.len() == 3 && names[2].as_str().unwrap().contains("60"), "{names:?}");
    assert!(folder.join("lit/contact-sheet.png").is_file());

    succeed(folder, &format!("{line} --out quiet --noise 0.02 --most-spp 256"));
    let noise =
        |name: &str| read(&folder.join(name).join("dataset.json"))["splits"]["train"]["noise"].clone();
    let (noisy, quiet) = (noise("lit").as_f64().unwrap(), noise("quiet").as_f64().unwrap());
    assert!(quiet < 0.7 * noisy, "{quiet} {noisy}");

    succeed(folder, &format!("{line} --out dark --bounces 0"));
    let mean = |name: &str| {
        let files = read(&folder.join(name).join("dataset.json"))["splits"]["train"]["files"].clone();
        files[0]["summary"]["mean"][0].as_f64().unwrap()
    };
    assert!(mean("dark") < mean("lit"), "indirect light must show");
}

#[test]
fn bad_flags_of_surfaces_are_refused() {
    let workshop = workshop();
    let folder = workshop.path();
    let line = |rest: &str| format!("generate tile {SMALL} --out new {rest}");
    for (rest, code, named) in [
        ("--shard 0/3", 2, "shard"),
        ("--shard 4/3", 2, "shard"),
        ("--shard half", 2, "shard"),
        ("--shard 1/2 --append", 2, "--append"),
        ("--resume --append", 2, "--append"),
        ("--append", 1, "new"),
        ("--light 45", 2, "45"),
        ("--light 95,0", 2, "light"),
        ("--noise 0", 2, "noise"),
        ("--noise nan", 2, "noise"),
        ("--most-spp 64", 2, "--noise"),
        ("--grazing-floor 2", 2, "grazing_floor"),
        ("--bounces 1000", 2, "bounces"),
        ("--regime slices --samples 10", 2, "samples"),
    ] {
        refused(folder, &[(&line(rest), code, &[named])]);
    }
    refused(
        folder,
        &[
            ("look metal-rings --out sheet.png --size 2", 2, &["--size"]),
            ("look metal-rings --out sheet.png --stops nan", 2, &["--stops"]),
            ("look metal-rings --out sheet.png --spp 0", 2, &["spp"]),
            ("look marble --out sheet.png", 2, &["marble", "basket-cloth"]),
            ("look metal-rings --out file", 1, &["file", "--force"]),
            ("generate metal-rings --field-side 1 --out new", 2, &["field_side"]),
        ],
    );
}

#[test]
fn a_sheet_shows_materials_of_every_source() {
    let workshop = workshop();
    let folder = workshop.path();
    let obj = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0.5 0.5 0.1\nf 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\n";
    std::fs::create_dir(folder.join("tent")).unwrap();
    std::fs::write(folder.join("tent/tent.obj"), obj).unwrap();
    let mesh = json!({ "mesh": "tent.obj", "height": null, "displacement": null });
    write_material(folder, "tent", &mesh);
    let line = "look tile tent rocks --field-side 64 --size 16 --spp 2 --out sheet.png";
    let said = succeed(folder, line);
    assert!(said.contains("3 materials"), "{said}");
    let sheet = image::open(folder.join("sheet.png")).unwrap().into_rgb8();
    assert!(sheet.width() > 4 * 16 && sheet.height() > 3 * 16 && sheet.height() < 4 * 20);
    let cell = |row: u32| (0..16).map(|k| sheet.get_pixel(k, row * 20 + 8).0).collect::<Vec<_>>();
    assert!(cell(0) != cell(1) && cell(1) != cell(2));

    // A mesh with a gap, and a map whose borders do not meet.
    std::fs::write(folder.join("tent/tent.obj"), obj.replace("f 4 1 5\n", "")).unwrap();
    refused(folder, &[("look tent --out gap.png", 1, &["tent.obj"])]);
    let ramp = image::GrayImage::from_fn(32, 32, |x, _| image::Luma([(8 * x) as u8]));
    write_material(folder, "ramp", &json!({}));
    ramp.save(folder.join("ramp/height.png")).unwrap();
    refused(folder, &[("look ramp --out ramp.png", 1, &["height.png", "--make-tileable"])]);
    let said = succeed(folder, "look ramp --out ramp.png --size 16 --spp 1 --make-tileable");
    assert!(said.contains("note"), "{said}");
}
