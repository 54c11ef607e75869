//! Pictures of scenes: queries are the dataset's, light arrives as physics has it, frames are the same on any number of
//! threads and go on where they stopped, and bad scenes are refused in one line.

use crate::command_line::{contents, refused, succeed, workshop};
use crate::materials;
use neumip::dataset::SCENES;
use neumip::engine::FusedMaterial;
use neumip::query::Reflectance;
use neumip::render::{
    Cosine, Directions, Frame, Lobes, Model, OpenOptions, Picture, Scene, SceneFile, View, frame_file,
};
use neumip_export::Checkpoint;
use serde_json::{Value, json};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

fn tiny() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/tiny.safetensors")
}

fn open(scene: &Value, folder: &Path) -> Scene {
    let path = folder.join("scene.json");
    let file = SceneFile::from_json(&scene.to_string(), &path).unwrap();
    let engine = |checkpoint: &Checkpoint, _: &Path| {
        let answers = Box::new(FusedMaterial::from_checkpoint(checkpoint)?);
        Ok(Model { answers, directions: Box::new(Cosine), identity: String::new() })
    };
    Scene::open(file, &path, &OpenOptions { default_material: None, seed: 1, engine: &engine }).unwrap()
}

fn render(scene: &Scene) -> Picture {
    let frame: Frame = scene.frame(0).unwrap();
    scene.render(&frame, &mut |_| ControlFlow::Continue(())).unwrap()
}

/// The mean of a channel over the pixels that are chosen.
fn mean(picture: &Picture, channel: usize) -> f64 {
    let pixels = &picture.rgb.pixels;
    pixels.iter().map(|p| f64::from(p[channel])).sum::<f64>() / pixels.len() as f64
}

/// The plane in NeuMIP's scene, as far as the camera sees.
fn plane(samples: usize) -> Value {
    let (tilt, pan) = (45f64.to_radians(), 30f64.to_radians());
    let wi = [tilt.sin() * pan.cos(), tilt.sin() * pan.sin(), tilt.cos()];
    json!({
        "version": 1,
        "materials": {"tile": {"checkpoint": tiny()}},
        "objects": [{"shape": "plane", "material": "tile", "scale": 21, "tiling": [21, 21]}],
        "lights": [{"directional": {"direction": wi, "irradiance": 1}}],
        "camera": {"width": 48, "samples": samples},
    })
}

/// Products and quotients of a few numbers of size one, stored in single precision.
const STORED: f32 = 2e-6;

#[test]
fn a_plane_asks_what_a_view_of_the_dataset_asks_and_shows_the_answers() {
    let scene = open(&plane(1), Path::new(""));
    let checkpoint = Checkpoint::read(&tiny()).unwrap();
    let resolution = checkpoint.header.architecture.resolution;
    let expected = SCENES[1].queries(48, 1, resolution);
    let frame = scene.frame(0).unwrap();
    let asked = scene.ask(&frame, 0..48 * 48).unwrap();
    let queries = &asked.queries[0];
    assert_eq!(queries.len(), expected.len());
    let coarsest = checkpoint.header.architecture.coarsest() as f32;
    let farthest = |shift: f32| {
        let mut farthest = 0.0f32;
        for k in 0..queries.len() {
            for c in 0..2 {
                let apart = (queries.u[k][c] - expected.u[k][c] + shift).abs();
                farthest = farthest.max(apart.min(1.0 - apart));
                farthest = farthest.max((queries.wi[k][c] - expected.wi[k][c]).abs());
                farthest = farthest.max((queries.wo[k][c] - expected.wo[k][c]).abs());
            }
            farthest = farthest.max((queries.level[k] - expected.level[k].min(coarsest)).abs());
        }
        farthest
    };
    assert!(farthest(0.0) < STORED, "{}", farthest(0.0));
    assert!(farthest(2.0 * STORED) > STORED);

    // The picture is the material's answers, pixel by pixel.
    let answers = FusedMaterial::from_checkpoint(&checkpoint).unwrap().evaluate(queries).unwrap();
    assert_eq!(render(&scene).rgb.pixels, answers.pixels);
    assert!(answers.pixels.iter().any(|p| p[0] > 0.01));
}

#[test]
fn levels_follow_the_pixel_or_the_sample() {
    let mut json = plane(16);
    json["objects"][0]["tiling"] = json!([150, 150]);
    let levels = |json: &Value| {
        let scene = open(json, Path::new(""));
        scene.ask(&scene.frame(0).unwrap(), 0..48 * 48).unwrap().queries.swap_remove(0).level
    };
    let pixel = levels(&json);
    json["camera"]["footprint"] = json!("sample");
    let coarsest = pixel.iter().fold(0.0f32, |a, b| a.max(*b));
    let pairs = pixel.into_iter().zip(levels(&json)).filter(|(p, s)| *p < coarsest && *s > 0.0);
    let differences: Vec<f32> = pairs.map(|(p, s)| p - s).collect();
    // A sixteenth of the area is two levels.
    assert!(differences.len() > 1000 && differences.iter().all(|d| (d - 2.0).abs() < 1e-6));
}

/// Light of 1 from everywhere on a matt sphere that fills the picture.
fn furnace(albedo: f64) -> Value {
    json!({
        "version": 1,
        "materials": {"white": {"lambert": albedo}},
        "objects": [{"shape": "sphere", "material": "white", "rotate": [20, 30, 40]}],
        "lights": [{"environment": {"constant": 1}}],
        "camera": {"origin": [0, -6, 0], "fov": 10, "width": 16, "samples": 64},
    })
}

/// Of the mean of 16,384 samples that vary by less than half their size, five standard deviations.
const FURNACE: f64 = 0.02;

#[test]
fn in_a_furnace_a_matt_surface_reflects_its_albedo() {
    for albedo in [1.0, 0.5] {
        let reflected = mean(&render(&open(&furnace(albedo), Path::new(""))), 1);
        assert!((reflected - albedo).abs() < FURNACE, "{albedo}: {reflected}");
        assert!((reflected - 1.05 * albedo).abs() > FURNACE);
    }
    // What misses the sphere sees the light itself.
    let mut json = furnace(0.5);
    json["camera"]["target"] = json!([10, 0, 0]);
    assert!(render(&open(&json, Path::new(""))).rgb.pixels.iter().all(|p| *p == [1.0; 3]));
}

/// An image of a small bright spot over a dim sky.
fn spot(folder: &Path) -> Vec<[f32; 3]> {
    let (width, height) = (32, 16);
    let texel = |x: usize, y: usize| if [x, y] == [5, 4] { 50.0f32 } else { 0.1 + 0.01 * x as f32 };
    exr::prelude::write_rgb_file(folder.join("spot.exr"), width, height, |x, y| {
        (texel(x, y), texel(x, y), 0.5 * texel(x, y))
    })
    .unwrap();
    (0..width * height).map(|k| [texel(k % width, k / width); 3]).collect()
}

#[test]
fn an_environment_gives_the_irradiance_of_its_picture() {
    let folder = tempfile::tempdir().unwrap();
    let texels = spot(folder.path());
    let map = neumip::render::environment::Environment::new(32, 16, texels);
    // A fine grid of directions, turned back by what the scene turns the picture by.
    let (turn, n) = (50f64.to_radians(), 600);
    let mut irradiance = 0.0;
    for i in 0..n {
        for j in 0..2 * n {
            // z goes by equal steps of its square: each cell has the same part of the cosine's integral.
            let z = ((i as f64 + 0.5) / n as f64).sqrt();
            let (angle, radius) =
                ((j as f64 + 0.5) / n as f64 * std::f64::consts::PI - turn, (1.0 - z * z).sqrt());
            let direction = [radius * angle.cos(), radius * angle.sin(), z];
            irradiance += f64::from(map.radiance(direction.into())[0]) / (2 * n * n) as f64;
        }
    }
    // Over pi, times pi: radiance of a white plane.
    let json = json!({
        "version": 1,
        "materials": {"white": {"lambert": 1}},
        "objects": [{"shape": "plane", "material": "white"}],
        "lights": [{"environment": {"image": "spot.exr", "rotate": 50}}],
        "camera": {"fov": 5, "width": 16, "samples": 64},
    });
    let scene = open(&json, folder.path());
    let reflected = mean(&render(&scene), 0);
    // 16,384 samples of both kinds vary by less than a third of their mean.
    assert!((reflected / irradiance - 1.0).abs() < FURNACE, "{reflected} {irradiance}");
    let mut other = json.clone();
    other["lights"][0]["environment"]["rotate"] = json!(230);
    other["objects"][0]["rotate"] = json!([30, 0, 0]);
    let other = mean(&render(&open(&other, folder.path())), 0);
    assert!((other / irradiance - 1.0).abs() > FURNACE, "turning it changes nothing: {other}");
    // The blue of the picture is half of it, and so is the light.
    assert!((mean(&render(&scene), 2) / reflected - 0.5).abs() < 1e-3);

    // Whatever directions a material asks for, the picture is the same as long as it knows their density.
    let drawn = |claimed: f32| {
        let mut scene = open(&json, folder.path());
        scene.materials[0].directions = Box::new(Uniform { claimed });
        mean(&render(&scene), 0)
    };
    assert!((drawn(1.0) / irradiance - 1.0).abs() < FURNACE, "{} {irradiance}", drawn(1.0));
    assert!((drawn(2.0) / irradiance - 1.0).abs() > FURNACE);
}

/// Directions uniform in solid angle, with a density that may be wrong by a factor.
struct Uniform {
    claimed: f32,
}

impl Directions for Uniform {
    fn lobes<'a>(&'a self, views: &[View]) -> neumip::Result<Box<dyn Lobes + 'a>> {
        assert!(views.iter().all(|view| view.level == 0.0));
        Ok(Box::new(Uniform { claimed: self.claimed }))
    }
}

impl Lobes for Uniform {
    fn sample(&self, k: usize, [x, y]: [f32; 2]) -> Option<([f32; 3], f32)> {
        let (sin, cos) = (std::f32::consts::TAU * x).sin_cos();
        let (z, radius) = (1.0 - y, (y * (2.0 - y)).sqrt());
        let wi = [radius * cos, radius * sin, z];
        Some((wi, self.pdf(k, wi)))
    }

    fn pdf(&self, _: usize, _: [f32; 3]) -> f32 {
        self.claimed / std::f32::consts::TAU
    }
}

/// Part of a hemisphere's cosine that a polygon above the horizon covers, seen from the origin with normal z (Lambert).
fn form_factor(corners: &[[f64; 3]]) -> f64 {
    let unit = |v: &[f64; 3]| {
        let length = v.iter().map(|x| x * x).sum::<f64>().sqrt();
        v.map(|x| x / length)
    };
    let edge = |k: usize| {
        let (a, b) = (unit(&corners[k]), unit(&corners[(k + 1) % corners.len()]));
        let cross = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
        let angle = (0..3).map(|c| a[c] * b[c]).sum::<f64>().acos();
        angle * cross[2] / cross.iter().map(|x| x * x).sum::<f64>().sqrt()
    };
    ((0..corners.len()).map(edge).sum::<f64>() / std::f64::consts::TAU).abs()
}

#[test]
fn light_bounces_from_a_wall_to_the_floor_as_its_form_factor_says() {
    // A wall at y = 1 from x = -1 to 1 and z = 0 to 2 faces -y; the light skims the floor.
    let (floor, wall) = (0.6, 0.5);
    let json = |bounces: usize| {
        json!({
            "version": 1,
            "materials": {"floor": {"lambert": floor}, "wall": {"lambert": wall}},
            "objects": [
                {"shape": "plane", "material": "floor", "scale": 4},
                {"shape": "plane", "material": "wall", "rotate": [90, 0, 0], "translate": [0, 1, 1]}
            ],
            "lights": [{"directional": {"direction": [0, -1, 0], "irradiance": std::f64::consts::PI}}],
            "camera": {"origin": [0.0, -0.1, 3], "target": [0.2, 0.3, 0], "fov": 0.05, "width": 16, "samples": 64},
            "bounces": bounces,
        })
    };
    let seen = mean(&render(&open(&json(1), Path::new(""))), 0);
    let corners = [[-1.2, 0.7, 0.0], [0.8, 0.7, 0.0], [0.8, 0.7, 2.0], [-1.2, 0.7, 2.0]];
    let exact = floor * wall * form_factor(&corners);
    // 16,384 samples of which a third meet the wall: a hundredth of their mean, five times.
    const NOISE: f64 = 0.06;
    assert!((seen / exact - 1.0).abs() < NOISE, "{seen} {exact}");
    assert!((1.15 * seen / exact - 1.0).abs() > NOISE);
    assert_eq!(mean(&render(&open(&json(0), Path::new(""))), 0), 0.0);
}

#[test]
fn a_point_light_falls_with_its_squared_distance_and_casts_shadows() {
    let json = |height: f64| {
        json!({
            "version": 1,
            "materials": {"white": {"lambert": 1}},
            "objects": [
                {"shape": "plane", "material": "white", "scale": 4},
                {"shape": "sphere", "material": "white", "scale": 0.1, "translate": [0, 0, 4]}
            ],
            "lights": [{"point": {"position": [0, 0, height], "intensity": std::f64::consts::PI}}],
            "camera": {"origin": [2, 0, 2], "fov": 0.05, "width": 4, "samples": 1},
        })
    };
    let below = mean(&render(&open(&json(2.0), Path::new(""))), 0);
    // A camera of a twentieth of a degree sees a spot of two thousandths.
    assert!((below - 0.25).abs() < 1e-5, "{below}");
    assert_eq!(mean(&render(&open(&json(8.0), Path::new(""))), 0), 0.0);
}

/// A square in two triangles as an OBJ, with texture coordinates like the plane's.
const SQUARE: &str = "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n";

#[test]
fn a_mesh_of_a_plane_is_a_plane() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: String| std::fs::write(folder.path().join(name), text).unwrap();
    write("square.obj", format!("{SQUARE}f 1/1 2/2 3/3 4/4\n"));
    write("normals.obj", format!("{SQUARE}vn 0 0 3\nf 1/1/1 2/2/1 3/3/1\nf 1/1/1 3/3/1 4/4/1\n"));
    // Its triangles run the other way round, but the normals say which side is out.
    write("turned.obj", format!("{SQUARE}vn 0 0 1\nf 3/3/1 2/2/1 1/1/1\nf 4/4/1 3/3/1 1/1/1\n"));
    let mut json = plane(4);
    json["objects"][0]["scale"] = json!(3);
    json["objects"][0]["rotate"] = json!([10, -20, 30]);
    let plane = render(&open(&json, folder.path())).rgb.pixels;
    assert!(plane.iter().any(|p| p[0] > 0.01));
    for name in ["square.obj", "normals.obj", "turned.obj"] {
        json["objects"][0]["shape"] = json!({"mesh": name});
        let mesh = render(&open(&json, folder.path())).rgb.pixels;
        let apart = |scale: f32| {
            let pairs = plane.as_flattened().iter().zip(mesh.as_flattened());
            pairs.map(|(a, b)| (a - scale * b).abs()).fold(0.0, f32::max)
        };
        // Texture coordinates differ by their rounding, which the texture's slope makes a little larger.
        const ROUNDED: f32 = 1e-4;
        assert!(apart(1.0) < ROUNDED, "{name}: {}", apart(1.0));
        assert!(apart(1.01) > ROUNDED);
    }
}

fn still_life(folder: &Path) {
    std::fs::write(folder.join("square.obj"), format!("{SQUARE}f 1/1 2/2 3/3 4/4\n")).unwrap();
    spot(folder);
    let scene = json!({
        "version": 1,
        "materials": {"tile": {"bundle": "bundle"}, "cloth": {"reference": "rocks", "field_side": 32, "spp": 2}},
        "objects": [
            {"shape": {"mesh": "square.obj"}, "material": "cloth", "scale": 3},
            {"shape": "sphere", "material": "tile", "translate": [0, 0, 1], "tiling": [4, 2]}
        ],
        "lights": [
            {"environment": {"image": "spot.exr"}},
            {"directional": {"name": "sun", "direction": [1, -1, 2]}}
        ],
        "camera": {"origin": [1, -4, 3], "width": 24, "height": 20, "samples": 4},
        "path": {"frames": 3, "keys": [{"lights": {"sun": [1, -1, 2]}}, {"origin": [-1, -4, 3], "lights": {"sun": [-1, 0, 1]}}]},
        "bounces": 1,
    });
    std::fs::write(folder.join("scene.json"), scene.to_string()).unwrap();
}

#[test]
fn frames_are_the_same_on_any_number_of_threads_and_go_on_where_they_stopped() {
    let workshop = workshop();
    let folder = workshop.path();
    still_life(folder);
    succeed(folder, "render --scene scene.json --out one --threads 1 --json one.json");
    succeed(folder, "render --scene scene.json --out three --threads 3");
    let frames = contents(&folder.join("one"));
    assert_eq!(frames.len(), 3 * 2 + 2);
    let named = |folder: PathBuf| -> Vec<_> {
        contents(&folder)
            .into_iter()
            .map(|(path, bytes)| (path.file_name().unwrap().to_owned(), bytes))
            .collect()
    };
    for (one, three) in named(folder.join("one")).into_iter().zip(named(folder.join("three"))) {
        assert!(one == three, "{:?} differs", one.0);
    }
    let said: Value = serde_json::from_slice(&std::fs::read(folder.join("one.json")).unwrap()).unwrap();
    assert!(
        said["frames"]
            .as_array()
            .unwrap()
            .iter()
            .all(|f| f["kept"] == false && f["queries"].as_u64() > Some(2000))
    );

    // A frame that is missing or damaged is rendered again, and no other.
    let frame = |k: usize| folder.join(format!("one/frame-000{k}.exr"));
    std::fs::remove_file(frame(1)).unwrap();
    succeed(folder, "render --scene scene.json --out one --json one.json");
    assert!(contents(&folder.join("one")) == frames);
    let said: Value = serde_json::from_slice(&std::fs::read(folder.join("one.json")).unwrap()).unwrap();
    let kept: Vec<_> = said["frames"].as_array().unwrap().iter().map(|f| f["kept"] == true).collect();
    assert_eq!(kept, [true, false, true]);

    // Another seed is another picture: nothing is mixed.
    refused(
        folder,
        &[("render --scene scene.json --out one --seed 2", 1, &["one", "frame-0000.exr", "--force"])],
    );
    succeed(folder, "render --scene scene.json --out one --seed 2 --force");
    let moved = |k: usize| {
        let pixels = frame_file::read(&frame(k)).unwrap().pixels;
        let before = frame_file::read(&folder.join(format!("three/frame-000{k}.exr"))).unwrap().pixels;
        pixels != before
    };
    assert!((0..3).all(moved));
}

#[test]
fn a_model_is_compared_with_the_surface_that_it_was_trained_on() {
    let workshop = workshop();
    let folder = workshop.path();
    let line = "render run --scene plane --width 16 --samples 1 --out out --compare=tile/material.json --compare-spp 8";
    let table = succeed(folder, &format!("{line} --json out.json"));
    assert!(table.contains("psnr") && table.contains("mean"), "{table}");
    let said: Value = serde_json::from_slice(&std::fs::read(folder.join("out.json")).unwrap()).unwrap();
    let comparison = &said["frames"][0]["comparison"];
    for metric in ["mse", "psnr", "ssim", "flip", "noise"] {
        assert!(comparison[metric].as_f64().is_some_and(|v| v > 0.0), "{metric}: {comparison}");
    }
    assert_eq!(said["comparison"], *comparison);
    for name in ["frame-0000.png", "frame-0000-reference.exr", "frame-0000-compare.png"] {
        assert!(folder.join("out").join(name).is_file(), "{name}");
    }
    // Kept frames compare as they did.
    assert!(succeed(folder, line).contains(&table[table.find("psnr").unwrap()..]));
}

/// A scene with some fields set.
fn write_scene(folder: &Path, name: &str, fields: Value) {
    let mut scene = json!({"version": 1, "objects": [{"shape": "plane"}]});
    for (field, value) in fields.as_object().unwrap() {
        scene[field] = value.clone();
    }
    std::fs::write(folder.join(name), scene.to_string()).unwrap();
}

#[test]
fn bad_scenes_are_refused_in_one_line() {
    let workshop = workshop();
    let folder = workshop.path();
    let object = |extra: Value| {
        let mut object = json!({"shape": "plane"});
        extra.as_object().unwrap().iter().for_each(|(k, v)| object[k] = v.clone());
        json!({"objects": [object]})
    };
    std::fs::write(folder.join("bare.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    std::fs::write(folder.join("point.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0.5 0.5\nf 1/1 2/1 3/1\n")
        .unwrap();
    std::fs::write(folder.join("flat.obj"), "v 0 0 0\nv 1 0 0\nv 2 0 0\nvt 0 0\nf 1/1 2/1 3/1\n").unwrap();
    std::fs::write(folder.join("huge.obj"), "v 0 0 0\nv 1 0 0\nv 0 1e300 0\nvt 0 0\nf 1/1 2/1 3/1\n")
        .unwrap();
    let (_, model, resolution) = materials::image_cases().remove(0);
    materials::checkpoint(&model, resolution, 1).write(&folder.join("inception.safetensors")).unwrap();
    let scenes: Vec<(&str, Value, i32, &[&str])> = vec![
        ("version", json!({"version": 7}), 1, &["version: 7", "reads 1"]),
        ("unknown", json!({"objets": []}), 1, &["objets"]),
        ("nested", object(json!({"shpe": 1})), 1, &["objects[0]", "shpe"]),
        ("shape", object(json!({"shape": "cube"})), 1, &["objects[0].shape", "cube"]),
        ("empty", json!({"objects": []}), 1, &["objects: 0"]),
        ("scale", object(json!({"scale": [1, 0, 1]})), 1, &["objects[0].scale"]),
        ("tiling", object(json!({"tiling": [0, 1]})), 1, &["objects[0].tiling"]),
        ("translate", object(json!({"translate": [1, 2]})), 1, &["objects[0].translate", "length 2"]),
        ("far", object(json!({"translate": [1e300, 0, 0]})), 1, &["objects[0].translate"]),
        ("material", object(json!({"material": "gold"})), 1, &["objects[0].material", "gold"]),
        (
            "sources",
            json!({"materials": {"a": {"lambert": 1, "run": "run"}}}),
            1,
            &["materials.a", "2 sources"],
        ),
        ("option", json!({"materials": {"a": {"lambert": 1, "spp": 4}}}), 1, &["materials.a", "spp"]),
        ("albedo", json!({"materials": {"a": {"lambert": 2}}}), 1, &["materials.a.lambert"]),
        ("mesh", object(json!({"shape": {"mesh": "gone.obj"}})), 1, &["gone.obj", "objects[0]"]),
        ("bare", object(json!({"shape": {"mesh": "bare.obj"}})), 1, &["bare.obj", "no texture coordinates"]),
        ("point", object(json!({"shape": {"mesh": "point.obj"}})), 1, &["point.obj", "degenerate"]),
        (
            "flat",
            object(json!({"shape": {"mesh": "flat.obj"}})),
            1,
            &["flat.obj", "no triangles with an area"],
        ),
        ("huge", object(json!({"shape": {"mesh": "huge.obj"}})), 1, &["huge.obj", "corner 2"]),
        ("dark", json!({"lights": []}), 1, &["lights: 0"]),
        ("light", json!({"lights": [{"spot": {}}]}), 1, &["lights[0]", "spot"]),
        (
            "still",
            json!({"lights": [{"directional": {"direction": [0, 0, 0]}}]}),
            1,
            &["lights[0].directional.direction"],
        ),
        (
            "twins",
            json!({"lights": [{"environment": {"constant": 1}}, {"environment": {"name": "b", "constant": 1}}]}),
            1,
            &["lights[1]", "second environment"],
        ),
        (
            "names",
            json!({"lights": [{"directional": {"direction": [0, 0, 1]}}, {"directional": {"direction": [0, 1, 1]}}]}),
            1,
            &["lights[1].name"],
        ),
        (
            "none",
            json!({"lights": [{"environment": {}}]}),
            1,
            &["lights[0].environment", "image, constant and sky"],
        ),
        ("texture", json!({"lights": [{"environment": {"image": "gone.exr"}}]}), 1, &["gone.exr"]),
        ("text", json!({"lights": [{"environment": {"image": "file"}}]}), 1, &["file", ".exr"]),
        (
            "negative",
            json!({"lights": [{"environment": {"constant": [1, -1, 1]}}]}),
            1,
            &["lights[0].environment.constant"],
        ),
        ("target", json!({"camera": {"origin": [0, 0, 0]}}), 1, &["camera.target"]),
        ("up", json!({"camera": {"up": [0, -1, 1]}}), 1, &["camera.up"]),
        ("fov", json!({"camera": {"fov": 180}}), 1, &["camera.fov"]),
        ("width", json!({"camera": {"width": 0}}), 1, &["camera.width"]),
        ("samples", json!({"camera": {"samples": 0}}), 1, &["camera.samples"]),
        ("bounces", json!({"bounces": 2}), 1, &["bounces: 2"]),
        (
            "key",
            json!({"path": {"frames": 2, "keys": [{"lights": {"moon": [0, 0, 1]}}]}}),
            1,
            &["path.keys[0].lights.moon"],
        ),
        (
            "times",
            json!({"path": {"frames": 2, "keys": [{"at": 0.5}, {"at": 0.1}]}}),
            1,
            &["path.keys[1].at"],
        ),
        ("frames", json!({"path": {"frames": 0, "keys": [{}]}}), 1, &["path.frames"]),
        (
            "through",
            json!({"path": {"frames": 5, "keys": [{"origin": [1, 0, 0]}, {"origin": [-1, 0, 0]}]}}),
            1,
            &["path.keys", "opposite"],
        ),
        ("rotate", json!({"path": {"frames": 2, "keys": [{"rotate": 5}]}}), 1, &["path.keys[0].rotate"]),
    ];
    let lines: Vec<(String, i32, &[&str])> = scenes
        .into_iter()
        .map(|(name, fields, code, named)| {
            write_scene(folder, &format!("{name}.json"), fields);
            (format!("render run --scene {name}.json --out out"), code, named)
        })
        .collect();
    write_scene(folder, "good.json", json!({}));
    write_scene(
        folder,
        "own.json",
        json!({"objects": [{"shape": "plane", "material": "a"}], "materials": {"a": {"lambert": 1}}}),
    );
    std::fs::write(folder.join("broken.json"), "{\"version\": 1,").unwrap();
    let more: [(&str, i32, &[&str]); 13] = [
        ("render run --scene broken.json --out out", 1, &["broken.json"]),
        ("render run --scene gone.json --out out", 2, &["gone.json", "moving-light"]),
        ("render --scene good.json --out out", 2, &["objects[0]", "no material"]),
        ("render run --scene own.json --out out", 2, &["own.json", "material of its own"]),
        ("render gone --scene good.json --out out", 1, &["gone", "no such run"]),
        ("render precious --scene good.json --out out", 1, &["precious"]),
        ("render inception.safetensors --scene good.json --out out", 1, &["Inception", "materials.default"]),
        ("render run --scene good.json --out file", 1, &["file"]),
        ("render run --scene good.json --out out --samples 0", 1, &["camera.samples"]),
        ("render run --scene good.json --out out --width 99999", 1, &["camera.width"]),
        ("render run --scene good.json --out out --json gone/x.json", 1, &["gone"]),
        (
            "render run --scene plane --out out --compare",
            2,
            &["tile", "no built-in material", "--compare=material.json"],
        ),
        ("render --scene own.json --out out --compare", 2, &["--compare", "no model"]),
    ];
    let mut cases: Vec<_> = lines.iter().map(|(line, code, named)| (line.as_str(), *code, *named)).collect();
    cases.extend(more);
    refused(folder, &cases);
}
