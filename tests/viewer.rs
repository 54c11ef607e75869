//! The viewer's page in a browser that we did not write: golden answers by its own shaders, its picture of a plane against
//! the dataset's scene. Without Chromium or Python these are skipped, and say so.

use crate::command_line::{refused, succeed};
use crate::fitted;
use neumip::config::Config;
use neumip::dataset::{Scene, write_query_frame};
use neumip::export::{Architecture, Bundle, Checkpoint, Contents, Precision, read_bundle};
use neumip::golden;
use neumip::inference::answerer;
use neumip::query::{QueryBuffer, RgbImage};
use neumip::view::{MOST_PIXELS, Reference, html};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::Command;
use tempfile::TempDir;

/// What a twin moves a bias of the decoder's first layer by.
const CHANGED_PARAMETER: f32 = 1e-2;
/// Largest |difference| / (1 + |value|) of the fast shader's golden answers: filtering in 8-bit steps moves a feature by
/// 0.004 of what its neighbours differ by. Measured on the software rasteriser, which is finer: 2e-4.
const LARGEST_FAST: f64 = 2e-2;
/// Largest |difference| / (1 + |value|) of a pixel: positions in 32-bit floats, in which a tile of 64 texels has an error of
/// 1e-5 texels and the highest band turns by 2e-4. Measured: 7e-6.
const LARGEST_PIXEL: f32 = 2e-4;
/// Degrees by which the twin turns the light.
const TURNED: f64 = 1.0;
/// Pixels of the plane's picture, and tiles along it.
const SIDE: usize = 48;
const TILES: usize = 3;
/// Half of the field of view of the dataset's scenes, degrees.
const HALF_VIEW: f64 = 22.5;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn trained() -> Checkpoint {
    Checkpoint::read(&root().join("fixtures/tiny.safetensors")).unwrap()
}

fn bundle(folder: &Path) -> Bundle {
    bundle_of(&trained(), folder)
}

fn bundle_of(checkpoint: &Checkpoint, folder: &Path) -> Bundle {
    let golden = golden::answers(checkpoint, 256).unwrap();
    let out = folder.join("bundle");
    Contents::new(checkpoint, &golden).write(&out, false).unwrap();
    read_bundle(&out).unwrap()
}

/// What the page says to the arguments of `view_page.py`; none where there is no browser or no Python.
fn open(page: &Path, arguments: &[&str]) -> Option<String> {
    let interpreter = std::env::var_os("NEUMIP_PYTHON").unwrap_or_else(|| "python3".into());
    let mut command = Command::new(interpreter);
    command.args(["-B", "-s"]).arg(root().join("scripts/view_page.py")).arg(page).args(arguments);
    match command.output() {
        Ok(output) if output.status.success() => Some(String::from_utf8(output.stdout).unwrap()),
        Ok(output) if output.status.code() == Some(3) => {
            eprintln!("skipped: {}", String::from_utf8_lossy(&output.stderr).trim());
            None
        }
        Ok(output) => panic!("{}", String::from_utf8_lossy(&output.stderr)),
        Err(error) => {
            eprintln!("skipped: no Python: {error}");
            None
        }
    }
}

fn page(folder: &TempDir, name: &str, bundle: &Bundle) -> PathBuf {
    let path = folder.path().join(name);
    std::fs::write(&path, html(bundle, None).unwrap()).unwrap();
    path
}

#[test]
fn golden_answers_come_out_of_the_page_and_a_changed_weight_is_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let mut bundle = bundle(folder.path());
    let tested = |bundle: &Bundle| -> Option<Value> {
        let said = open(&page(&folder, "page.html", bundle), &["--selftest"])?;
        Some(serde_json::from_str(&said).unwrap())
    };
    let number = |value: &Value| value.as_str().unwrap().parse::<f64>().unwrap();
    let Some(right) = tested(&bundle) else { return };
    let exact = &right["modes"]["exact"]["golden"];
    assert_eq!((&right["right"], &exact["beyond"], &right["problem"]), (&json!(true), &json!(0), &json!(0)));
    assert_eq!(exact["values"], json!(3 * bundle.golden.level.len()));
    assert!(number(&exact["largest"]) <= bundle.golden.tolerance, "{right}");
    let fast = number(&right["modes"]["fast"]["golden"]["largest"]);
    assert!(fast <= LARGEST_FAST, "{right}");
    println!("{right}");

    let bias = bundle.checkpoint.tensors.get_mut("decoder.mlp.0.bias").unwrap();
    bias.data[0] += CHANGED_PARAMETER;
    let wrong = tested(&bundle).unwrap();
    assert_eq!(wrong["right"], json!(false));
    assert!(wrong["modes"]["exact"]["golden"]["beyond"].as_u64().unwrap() > 0, "{wrong}");
}

/// The page's picture of the plane under the camera and light of a scene.
fn picture(folder: &TempDir, page: &Path, scene: &Scene) -> Option<Vec<[f32; 3]>> {
    let (sin, cos) = scene.camera.tilt.to_radians().sin_cos();
    let (tilt, pan) = (scene.tilt.to_radians(), scene.pan.to_radians());
    let scene = json!({
        "shape": "plane", "tiling": [TILES, TILES], "width": SIDE, "height": SIDE, "mode": "exact",
        "light": [tilt.sin() * pan.cos(), tilt.sin() * pan.sin(), tilt.cos()],
        "camera": {
            "origin": [0.0, -scene.camera.distance * sin, scene.camera.distance * cos],
            "target": [0, 0, 0], "up": [0, 0, 1], "fov": 2.0 * HALF_VIEW,
        },
    });
    let [scene_path, out] = ["scene.json", "picture.npy"].map(|name| folder.path().join(name));
    std::fs::write(&scene_path, scene.to_string()).unwrap();
    open(page, &["--render", scene_path.to_str().unwrap(), "--out", out.to_str().unwrap()])?;
    let bytes = std::fs::read(out).unwrap();
    let values = &bytes[bytes.len() - 12 * SIDE * SIDE..];
    let values: Vec<f32> = values.as_chunks::<4>().0.iter().map(|v| f32::from_le_bytes(*v)).collect();
    Some(values.as_chunks::<3>().0.to_vec())
}

#[test]
fn a_plane_is_the_scene_of_the_dataset_and_a_turned_light_is_noticed() {
    let (_, fitted) = fitted::materials().swap_remove(0);
    [trained(), fitted].iter().for_each(a_plane_is_the_scene);
}

fn a_plane_is_the_scene(checkpoint: &Checkpoint) {
    let folder = tempfile::tempdir().unwrap();
    let page = page(&folder, "page.html", &bundle_of(checkpoint, folder.path()));
    let architecture = &checkpoint.header.architecture;
    let scene = Scene::new(45.0, 30.0);
    let Some(mut drawn) = picture(&folder, &page, &scene) else { return };
    let asked = scene.queries(SIDE, TILES, architecture.tile());
    // On the border of a window the page and the scene may be on two sides of it.
    if let Some(guide) = architecture.guide() {
        let pixels = drawn.iter_mut().zip(&asked.u).filter(|(_, u)| guide.border(**u) < golden::BORDER);
        pixels.for_each(|(pixel, _)| *pixel = [0.0; 3]);
    }
    let answers = |scene: &Scene| {
        let queries = scene.queries(SIDE, TILES, architecture.tile());
        let answerer = answerer(checkpoint, None, Precision::Single, &candle_core::Device::Cpu).unwrap();
        answerer.material.evaluate(&queries).unwrap().pixels
    };
    // The scene goes on for ever, the page's plane is its square.
    let on_square = drawn.iter().filter(|p| p.iter().any(|v| *v > 0.0)).count();
    assert!(on_square > SIDE * SIDE / 4, "{on_square} pixels are lit");
    let largest = |answers: &[[f32; 3]]| {
        let pairs = drawn.iter().zip(answers).filter(|(p, _)| p.iter().any(|v| *v > 0.0));
        let apart = pairs.flat_map(|(p, q)| (0..3).map(|c| (p[c] - q[c]).abs() / (1.0 + q[c].abs())));
        apart.fold(0.0, f32::max)
    };
    let apart = largest(&answers(&scene));
    println!("largest difference of a pixel: {apart:.1e} (1 + |value|)");
    assert!(apart < LARGEST_PIXEL, "{apart}");
    assert!(largest(&answers(&Scene::new(45.0 + TURNED, 30.0))) > LARGEST_PIXEL);
}

#[test]
fn a_page_needs_nothing_else_and_holds_its_text() {
    let folder = tempfile::tempdir().unwrap();
    let mut bundle = bundle(folder.path());
    bundle.checkpoint.header.material = "</script><b>{{DATA}}".into();
    let queries = QueryBuffer::slice(2, 3, [0.1, 0.2], [0.0, 0.0], 0.0);
    let rgb = RgbImage { height: 2, width: 3, pixels: vec![[0.5; 3]; 6] };
    let mut reference = Reference { name: "views </script>".into(), queries, rgb };
    let text = html(&bundle, Some(&reference)).unwrap();
    for address in ["http://", "https://", "src=", "@import", "url("] {
        assert!(!text.contains(address), "{address}");
    }
    assert_eq!(text.matches("</script>").count(), 3);
    assert!(
        text.contains("&lt;/script&gt;&lt;b&gt;{{DATA}}") && text.contains("views \\u003c/script\\u003e")
    );
    assert_eq!(text, html(&bundle, Some(&reference)).unwrap());

    reference.rgb.pixels.pop();
    assert!(html(&bundle, Some(&reference)).unwrap_err().to_string().starts_with("reference: "));
    let queries = QueryBuffer::slice(1, MOST_PIXELS + 1, [0.0; 2], [0.0; 2], 0.0);
    let rgb = RgbImage { height: 1, width: MOST_PIXELS + 1, pixels: vec![[0.0; 3]; MOST_PIXELS + 1] };
    let problem =
        html(&bundle, Some(&Reference { name: String::new(), queries, rgb })).unwrap_err().to_string();
    assert!(problem.contains("more than"), "{problem}");

    let model = Config::preset("inception-small").unwrap().model;
    bundle.checkpoint.header.architecture = Architecture::new(model, [16, 16]).unwrap();
    assert!(html(&bundle, None).unwrap_err().to_string().contains("reads neighbours"));
}

#[test]
fn bad_input_is_refused_and_leaves_no_page() {
    let folder = tempfile::tempdir().unwrap();
    bundle(folder.path());
    let queries = QueryBuffer::slice(2, 2, [0.1, 0.2], [0.0, 0.0], 0.0);
    let rgb = RgbImage { height: 2, width: 2, pixels: vec![[0.5; 3]; 4] };
    write_query_frame(&folder.path().join("frame.exr"), &queries, &rgb).unwrap();
    succeed(folder.path(), "view bundle --reference frame.exr --out page.html");
    let cases: [(&str, i32, &[&str]); 6] = [
        ("view bundle --out page.html", 1, &["page.html", "--force"]),
        ("view nowhere --out other.html", 1, &["nowhere"]),
        ("view bundle --reference bundle/golden.json --out other.html", 1, &["golden.json"]),
        ("view bundle --reference absent.exr --out other.html", 1, &["absent.exr"]),
        ("view bundle --out absent/page.html", 1, &["absent"]),
        ("view bundle", 2, &["--out"]),
    ];
    refused(folder.path(), &cases);
    std::fs::write(folder.path().join("bundle/decoder.onnx"), "altered").unwrap();
    refused(folder.path(), &[("view bundle --out other.html", 1, &["decoder.onnx", "altered"])]);
}
