//! What a scene asks of its materials: figures add up, are the same on any number of threads, say where nothing is asked,
//! and an older analysis is kept until it is forced away.

use crate::command_line::{contents, refused, succeed, workshop};
use serde_json::{Value, json};
use std::path::Path;

/// Shares are sums of thousands of numbers in double precision, written in full.
const ROUNDED: f64 = 1e-9;
/// Degrees that directions in single precision are off.
const STORED: f64 = 0.01;

/// A floor that needs places, a ball that does not, and a lamp that moves.
fn scene(folder: &Path, name: &str, change: impl Fn(&mut Value)) {
    let mut scene = json!({
        "version": 1,
        "materials": {
            "floor": {"reference": "rocks", "resolution": 32, "field_side": 32, "spp": 1},
            "ball": {"lambert": 0.4}
        },
        "objects": [
            {"shape": "plane", "material": "floor", "scale": 4, "tiling": [4, 4]},
            {"shape": "sphere", "material": "ball", "scale": 0.5, "translate": [0, 0, 0.5]}
        ],
        "lights": [{"directional": {"name": "lamp", "direction": [0.5, 0, 1]}}],
        "camera": {"width": 32, "samples": 2},
        "path": {"frames": 2, "keys": [{"lights": {"lamp": [0.5, 0, 1]}}, {"lights": {"lamp": [-0.5, 0, 1]}}]},
    });
    change(&mut scene);
    std::fs::write(folder.join(name), scene.to_string()).unwrap();
}

fn read(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

fn sum(values: &Value) -> f64 {
    values.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).sum()
}

#[test]
fn every_query_is_in_every_histogram() {
    let workshop = workshop();
    let folder = workshop.path();
    scene(folder, "scene.json", |_| {});
    let said = succeed(folder, "analyze --scene scene.json --out asked --json same.json");
    for part in ["floor: reference rocks at 32 x 32", "ball: matt", "level, by weight", "texels a pixel"] {
        assert!(said.contains(part), "{part}: {said}");
    }
    let analysis = read(&folder.join("asked/analysis.json"));
    assert_eq!(analysis, read(&folder.join("same.json")));
    // A path is looked at in nine places at least.
    assert_eq!(analysis["frames"], 9);
    let materials = analysis["materials"].as_array().unwrap();
    assert_eq!(materials.len(), 2);
    for asked in materials {
        let kept = asked["kept"].as_u64().unwrap();
        assert_eq!(asked["asked"].as_u64(), Some(kept));
        assert_eq!(asked["rays"], 9 * 32 * 32 * 2);
        let levels = &asked["levels"];
        for histogram in [
            &levels["histogram"],
            &levels["whole"],
            &asked["position"]["map"],
            &asked["wi"]["disc"],
            &asked["wo"]["disc"],
        ] {
            assert_eq!(sum(&histogram["queries"]), kept as f64);
            let apart = |factor: f64| (factor * sum(&histogram["weight"]) - 1.0).abs();
            assert!(apart(1.0) < ROUNDED && apart(1.001) > ROUNDED);
        }
        let shares = levels["quantiles"]["queries"].as_array().unwrap();
        assert!(shares.windows(2).all(|pair| pair[0].as_f64() <= pair[1].as_f64()));
        let picture = folder.join("asked").join(asked["picture"].as_str().unwrap());
        assert!(image::open(picture).unwrap().width() == 1200);
        let page = std::fs::read_to_string(folder.join("asked/index.html")).unwrap();
        assert!(page.contains(&format!("src=\"{}\"", asked["picture"].as_str().unwrap())));
    }

    // The lamp moves by twice its tilt, on a floor that turns nothing.
    let floor = &materials[1];
    assert_eq!(floor["material"], "floor");
    let width = 2.0 * floor["wi"]["all"]["cosine"].as_f64().unwrap().acos().to_degrees();
    let tilt = 0.5f64.atan().to_degrees();
    assert!((width - 2.0 * tilt).abs() < STORED, "{width} {tilt}");
    assert!((width - 2.02 * tilt).abs() > STORED);
    assert_eq!(sum(&json!([floor["position"]["window"]["length"][0]])), 1.0);
}

#[test]
fn a_lamp_that_stands_still_is_one_direction_and_a_near_camera_reads_fine_levels() {
    let workshop = workshop();
    let folder = workshop.path();
    scene(folder, "still.json", |scene| {
        scene.as_object_mut().unwrap().remove("path");
        // An eighth of a tile under the camera, at a corner of it.
        scene["objects"] = json!([{"shape": "plane", "material": "floor", "scale": 4}]);
        scene["materials"]["floor"]["resolution"] = json!(128);
        scene["camera"] = json!({"origin": [-4, -4, 3], "target": [-4, -4, 0], "up": [0, 1, 0], "fov": 10,
            "width": 32, "samples": 2});
    });
    let said = succeed(folder, "analyze --scene still.json --out asked");
    assert!(said.contains("light comes from one direction, 26.6 degrees from the normal"), "{said}");
    let analysis = read(&folder.join("asked/analysis.json"));
    assert_eq!(analysis["frames"], 1);
    let window = &analysis["materials"][0]["position"]["window"];
    // The plane ends in its corner: a quarter of the picture is of it, a sixteenth of its side or a little more.
    let length = |axis: usize| window["length"][axis].as_f64().unwrap();
    assert!((0..2).all(|axis| length(axis) > 0.02 && length(axis) < 0.08), "{window}");
    assert!(said.contains("of the tile is asked, within"), "{said}");
    assert!(said.contains("at level 0, where a pixel is no larger than a texel"), "{said}");
}

#[test]
fn the_same_on_any_number_of_threads_and_kept_until_it_is_forced_away() {
    let workshop = workshop();
    let folder = workshop.path();
    scene(folder, "scene.json", |_| {});
    let line = "analyze --scene scene.json --frames 3 --samples 1 --queries 500";
    succeed(folder, &format!("{line} --threads 1 --out one"));
    succeed(folder, &format!("{line} --threads 2 --out two"));
    let named = |out: &str| {
        let root = folder.join(out);
        let files = contents(&root).into_iter();
        files
            .map(|(path, bytes)| (path.strip_prefix(&root).unwrap().to_path_buf(), bytes))
            .collect::<Vec<_>>()
    };
    assert_eq!(named("one").len(), 4);
    assert!(named("one") == named("two"));
    let before = named("one");
    refused(folder, &[(&format!("{line} --out one"), 1, &["one", "--force"])]);
    succeed(folder, &format!("{line} --seed 2 --out one --force"));
    assert!(named("one") != before);
    assert_eq!(read(&folder.join("one/analysis.json"))["materials"][0]["kept"], 500);
    assert_eq!(succeed(folder, &format!("{line} --out quiet --quiet")), "");
}

#[test]
fn a_surface_stands_in_for_models() {
    let workshop = workshop();
    let folder = workshop.path();
    // The run is not even there.
    scene(folder, "models.json", |scene| {
        scene["materials"] = json!({"floor": {"run": "gone"}, "ball": {"lambert": 0.4}});
    });
    refused(folder, &[("analyze --scene models.json --out out", 1, &["gone", "no such run"])]);
    let line = "analyze --scene models.json --out out --frames 1";
    let said = succeed(folder, &format!("{line} --surface tile/material.json --resolution 16"));
    assert!(said.contains("floor: reference tile at 16 x 16"), "{said}");
    succeed(folder, "analyze run --scene plane --samples 1 --queries 100 --out plane");
    let plane = read(&folder.join("plane/analysis.json"));
    assert_eq!(plane["materials"][0]["material"], "default");
    assert_eq!(plane["materials"][0]["kept"], 100);
}

#[test]
fn bad_input_is_refused_in_one_line() {
    let workshop = workshop();
    let folder = workshop.path();
    scene(folder, "scene.json", |_| {});
    scene(folder, "hidden.json", |scene| scene["objects"][1]["translate"] = json!([0, 0, -3]));
    scene(folder, "dark.json", |scene| {
        scene.as_object_mut().unwrap().remove("path");
        scene["lights"] = json!([{"directional": {"direction": [0, 0, -1]}}]);
    });
    scene(folder, "still.json", |scene| {
        scene.as_object_mut().unwrap().remove("path");
    });
    std::fs::write(folder.join("broken.json"), "{\"version\": 1,").unwrap();
    refused(
        folder,
        &[
            (
                "analyze --scene hidden.json --out out",
                1,
                &["hidden.json", "materials.ball", "no ray meets it"],
            ),
            ("analyze --scene dark.json --out out", 1, &["dark.json", "no ray meets it"]),
            ("analyze --scene gone.json --out out", 2, &["gone.json", "moving-light"]),
            ("analyze --scene broken.json --out out", 1, &["broken.json"]),
            ("analyze --scene plane --out out", 2, &["plane", "no material"]),
            ("analyze gone --scene plane --out out", 1, &["gone", "no such run"]),
            ("analyze run --scene scene.json --out out", 2, &["scene.json", "material of its own"]),
            ("analyze run --surface rocks --scene plane --out out", 2, &["--surface"]),
            ("analyze --surface rocks --scene scene.json --out out", 2, &["--surface", "scene.json"]),
            ("analyze --surface gone.json --scene plane --out out", 2, &["gone.json"]),
            ("analyze --surface rocks --resolution 0 --scene plane --out out", 1, &["resolution"]),
            ("analyze --resolution 64 --scene scene.json --out out", 2, &["--surface"]),
            ("analyze --scene scene.json --out out --frames 0", 2, &["--frames 0"]),
            ("analyze --scene still.json --out out --frames 2", 2, &["--frames 2", "no path"]),
            ("analyze --scene scene.json --out out --samples 0", 2, &["--samples 0"]),
            ("analyze --scene scene.json --out out --queries 0", 2, &["--queries 0"]),
            ("analyze --scene scene.json --out out --json gone/x.json", 1, &["gone"]),
            ("analyze --scene scene.json --out file", 1, &["file", "is a file"]),
            ("analyze --scene scene.json --out precious --force", 1, &["precious", "more than an analysis"]),
        ],
    );
}
