//! Whole sets of maps: what they become, what is said about them, and what is refused.

use super::*;
use crate::reference::material::{Paint, Part};
use crate::reference::mesh_file;
use crate::reference::texture::Texture;
use std::f64::consts::TAU;

const SIDE: usize = 64;

/// A folder with maps to choose from and the materials made of them.
struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        let this = Self(tempfile::tempdir().unwrap());
        this.grey("waves.png", |x, y| 0.5 + 0.4 * wave(x, y));
        this.grey("slope.png", |x, y| 0.2 + 0.3 * x + 0.2 * y);
        this.grey(
            "holes.png",
            |x, y| if (4.0 * x).fract() < 0.5 && (4.0 * y).fract() < 0.5 { 0.1 } else { 0.9 },
        );
        let normal = |sign: f64| {
            move |x: f64, y: f64| {
                let [sx, sy] = slopes(x, y);
                let length = (1.0 + sx * sx + sy * sy).sqrt();
                [-sx, -sign * sy, 1.0].map(|c| 0.5 + 0.5 * c / length)
            }
        };
        this.rgb("normal_dx.png", normal(1.0));
        this.rgb("normal_gl.png", normal(-1.0));
        this.rgb("red.png", |_, _| [1.0, 0.2, 0.1]);
        this
    }

    fn rgb(&self, name: &str, value: impl Fn(f64, f64) -> [f64; 3]) {
        let side = SIDE as u32;
        let texel = |x: u32, y: u32| {
            let [x, y] = [x, y].map(|c| (f64::from(c) + 0.5) / SIDE as f64);
            image::Rgb(value(x, y).map(|v| (v * 65535.0).round() as u16))
        };
        type Rgb16 = image::ImageBuffer<image::Rgb<u16>, Vec<u16>>;
        Rgb16::from_fn(side, side, texel).save(self.0.path().join(name)).unwrap();
    }

    fn grey(&self, name: &str, value: impl Fn(f64, f64) -> f64) {
        self.rgb(name, |x, y| [value(x, y); 3]);
    }

    fn read_with(&self, fields: &str, make_tileable: bool) -> Result<Material> {
        let path = self.0.path().join("material.json");
        std::fs::write(&path, format!("{{\"version\": 1, \"name\": \"test\", {fields}}}")).unwrap();
        ReadOptions { make_tileable }.read(&path)
    }

    fn read(&self, fields: &str) -> Material {
        self.read_with(fields, false).unwrap()
    }

    fn problem(&self, fields: &str) -> String {
        let problem = self.read_with(fields, false).unwrap_err().to_string();
        assert!(!problem.contains('\n'), "{problem}");
        problem
    }
}

/// The waves of the maps, from -1 to 1, and what displaces by a tenth of them.
fn wave(x: f64, y: f64) -> f64 {
    0.5 * (TAU * x).sin() + 0.5 * (TAU * (2.0 * y + x)).cos()
}

const DISPLACEMENT: f64 = 0.1;

/// Slopes of a displaced wave in tile widths.
fn slopes(x: f64, y: f64) -> [f64; 2] {
    let [a, b] = [(TAU * x).cos(), -(TAU * (2.0 * y + x)).sin()];
    [0.5 * TAU * (a + b), TAU * b].map(|slope| 0.4 * DISPLACEMENT * slope)
}

const WAVES: &str =
    r#""height": "waves.png", "displacement": 0.1, "base_colour": [0.5, 0.4, 0.3], "roughness": 0.5"#;

fn with(more: &str) -> String {
    format!("{WAVES}, {more}")
}

fn paint(material: &Material) -> &Paint {
    match &material.parts[0] {
        Part::Solid(layer) | Part::Sheet(layer, _) => &layer.paint,
        Part::Mesh(_, paint) => paint,
        Part::Fibres(..) => panic!("no fibres in files"),
    }
}

fn heights(material: &Material) -> &[f32] {
    match &material.parts[0] {
        Part::Solid(layer) | Part::Sheet(layer, _) => &layer.height.values,
        other => panic!("no heights: {other:?}"),
    }
}

#[test]
fn normals_of_both_conventions_are_those_of_the_field() {
    // Half a step of 16 bits, doubled, and the rounding of the sums.
    const SIXTEEN_BITS: f64 = 2e-5;
    let folder = Folder::new();
    let largest_error = |material: &Material| {
        let normal = paint(material).normal.as_ref().unwrap();
        let mut largest: f64 = 0.0;
        for k in 0..SIDE * SIDE {
            let [x, y] = [k % SIDE, k / SIDE].map(|c| (c as f64 + 0.5) / SIDE as f64);
            let [sx, sy] = slopes(x, y);
            let length = (1.0 + sx * sx + sy * sy).sqrt();
            for (got, want) in normal.at(x, y).iter().zip([-sx, -sy, 1.0]) {
                largest = largest.max((f64::from(*got) - want / length).abs());
            }
        }
        largest
    };
    for (map, convention) in [("normal_dx.png", "directx"), ("normal_gl.png", "opengl")] {
        let right =
            folder.read(&with(&format!("\"normal\": \"{map}\", \"normal_convention\": \"{convention}\"")));
        assert!(largest_error(&right) < SIXTEEN_BITS && right.notes.is_empty(), "{:?}", right.notes);
    }
    // Read the other way, it is far off, and a note tells.
    let wrong = folder.read(&with("\"normal\": \"normal_dx.png\""));
    assert!(largest_error(&wrong) > 0.1);
    assert!(wrong.notes[0].starts_with("normal: its green runs against the heights"), "{:?}", wrong.notes);
    assert!(wrong.notes[0].contains("\"directx\""));
}

#[test]
fn maps_that_do_not_tile_are_refused_or_mended() {
    let folder = Folder::new();
    let sloping = with("\"specular\": \"slope.png\"");
    let problem = folder.problem(&sloping);
    assert!(
        problem.contains("slope.png: does not tile as specular: from its right edge to the left"),
        "{problem}"
    );
    assert!(problem.contains("step by 0.295") && problem.contains("at most 0.005"), "{problem}");
    assert!(problem.contains("--make-tileable"), "{problem}");

    let mended = folder.read_with(&sloping, true).unwrap();
    assert!(mended.notes.iter().any(|note| note.contains("made tileable")), "{:?}", mended.notes);
    assert!(mended.notes.iter().any(|note| note.contains("waves.png is 56 x 56")), "{:?}", mended.notes);
    // Where nothing was faded, the new tile is the old one's first seven eighths, read between texels.
    const INTERPOLATION: f64 = 5e-4;
    let plain = folder.read(WAVES);
    let old = 0.7 / 0.8 * 40.5 / SIDE as f64;
    let z = 0.4 * DISPLACEMENT * wave(old, old);
    let near = |want: f64| (f64::from(heights(&mended)[40 * SIDE + 40]) - want).abs() < INTERPOLATION;
    assert!(near(z * 8.0 / 7.0));
    assert!(!near(z), "heights grow as the tile shrinks");

    let kept = folder.read_with(WAVES, true).unwrap();
    assert_eq!(heights(&kept), heights(&plain));
    assert!(kept.notes[0].contains("changed nothing"));
    // Sloping heights are measured against their own range.
    assert!(folder.problem(&WAVES.replace("waves", "slope")).contains("as height"));
    folder.grey("faint.png", |x, _| 0.001 * x);
    assert!(folder.problem(&WAVES.replace("waves", "faint")).contains("as height"));
    folder.read(&with("\"specular\": \"faint.png\""));
}

#[test]
fn mended_normals_are_unit_vectors() {
    let folder = Folder::new();
    let material =
        folder.read_with(&with("\"specular\": \"slope.png\", \"normal\": \"normal_gl.png\""), true).unwrap();
    let normal: &Texture<3> = paint(&material).normal.as_ref().unwrap();
    assert_eq!(normal.side(), SIDE);
    // Rounding of f32 in a unit vector.
    let is_unit = |n: &[f32; 3]| (n.iter().map(|c| c * c).sum::<f32>() - 1.0).abs() < 1e-6 && n[2] > 0.0;
    assert!(normal.texels().iter().all(is_unit));
    assert!(!is_unit(&[0.5, 0.5, 0.7]));
}

#[test]
fn the_stated_range_is_kept() {
    let folder = Folder::new();
    assert_eq!(folder.read(WAVES).height_range, None);
    let material = folder.read(&with("\"height_range\": [-0.06, 0.1]"));
    assert_eq!(material.height_range, Some([-0.06, 0.1]));
    // Waves reach from 0.1 to 0.9: 0.04 from the plane.
    let problem = folder.problem(&with("\"height_range\": [-0.06, 0.03]"));
    assert!(
        problem.contains("height_range is -0.06 to 0.03") && problem.contains(": 0.0100 tile widths"),
        "{problem}"
    );
    assert!(problem.contains("above its high end"), "{problem}");
    assert!(folder.problem(&with("\"height_range\": [0, 0.1]")).contains("below its low end"));
    assert!(folder.problem(&with("\"height_range\": [0.1, -0.1]")).contains("it goes up"));
    assert!(folder.problem(&with("\"height_range\": [-2, 2]")).contains("within -1 to 1"));
}

#[test]
fn sheets_lie_over_their_base() {
    let folder = Folder::new();
    std::fs::create_dir(folder.0.path().join("felt")).unwrap();
    let base = |fields: &str| {
        let text = format!("{{\"version\": 1, \"name\": \"felt\", {fields}}}");
        std::fs::write(folder.0.path().join("felt/material.json"), text).unwrap();
    };
    let flat = r#""height": 0, "displacement": 0.2, "base_colour": [0.1, 0.1, 0.1], "roughness": 0"#;
    base(flat);
    let sheet = with("\"opacity\": \"holes.png\", \"base\": \"felt/material.json\"");
    let material = folder.read(&sheet);
    let Part::Sheet(_, opacity) = &material.parts[0] else { panic!("no sheet") };
    assert_eq!(opacity.side(), SIDE);
    assert!(matches!(&material.parts[1], Part::Solid(layer) if layer.height.values == [-0.1; 4]));
    assert_eq!(material.parts.len(), 2);
    assert!(material.notes[0].starts_with("felt: roughness: all of it"), "{:?}", material.notes);
    let ranged = folder.read(&with(
        "\"opacity\": \"holes.png\", \"base\": \"felt/material.json\", \"height_range\": [-0.05, 0.05]",
    ));
    assert_eq!(ranged.height_range, Some([-0.1, 0.05]));

    assert!(folder.problem(&with("\"opacity\": \"holes.png\"")).contains("without base"));
    assert!(folder.problem(&with("\"base\": \"felt/material.json\"")).contains("without opacity"));
    base(&format!("{flat}, \"opacity\": \"../holes.png\", \"base\": \"../felt/material.json\""));
    assert!(folder.problem(&sheet).contains("only one level"));
}

const MESH: &str = r#""mesh": "mesh.obj", "base_colour": [0.5, 0.4, 0.3], "roughness": 0.5"#;

#[test]
fn meshes_carry_paint() {
    let folder = Folder::new();
    let write = |text: &str| std::fs::write(folder.0.path().join("mesh.obj"), text).unwrap();
    let square = "v -1 0.1 -1\nv 1 0.1 -1\nv 1 0.1 1\nv -1 0.1 1\n";
    write(&format!("{square}f 4 3 2 1\n"));
    let tile = r#", "tile": [-1, -1, 1, 1], "up": "y""#;
    let material = folder.read(&format!("{MESH}{tile}, \"height_range\": [0, 0.06]"));
    let Part::Mesh(mesh, _) = &material.parts[0] else { panic!("no mesh") };
    assert!(mesh.positions.iter().all(|p| p[2] == 0.05), "heights are scaled as the tile is");
    assert_eq!(material.height_range, Some([0.0, 0.06]));
    assert!(
        folder
            .problem(&format!("{MESH}{tile}, \"height_range\": [0, 0.01]"))
            .contains("0.0400 tile widths above")
    );
    assert!(folder.problem(MESH).contains("mesh.obj: reaches"));
    assert!(
        folder.problem(&format!("{MESH}, \"displacement\": 1")).contains("displacement is for a height map")
    );
    assert!(folder.problem(&with("\"up\": \"y\"")).contains("up is for a mesh"));
    assert!(folder.problem(&format!("{MESH}, \"up\": \"x\"")).contains("`z` or `y`"));
    // Paint that does not tile cannot be cropped, unless the mesh says where it goes.
    let sloping = format!("{MESH}{tile}, \"specular\": \"slope.png\"");
    assert!(folder.read_with(&sloping, true).unwrap_err().to_string().contains("without its mesh"));
    write(&format!("{square}vt 0 0\nvt 1 1\nf 4/1 3/1 2/2 1/2\n"));
    folder.read(&sloping);
    assert!(
        folder.problem(&format!("{MESH}{tile}, \"normal\": \"normal_gl.png\"")).contains("normal is over")
    );
    write("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n");
    assert!(folder.problem(MESH).contains("mesh.obj: line 4: index 9"));
    assert!(mesh_file::read(&folder.0.path().join("waves.png"), &mesh_file::Placement::default()).is_err());
}

#[test]
fn missing_maps_are_looked_for() {
    let folder = Folder::new();
    folder.grey("Wall_Rough.png", |_, _| 0.5);
    let problem = folder.problem(&WAVES.replace("\"roughness\": 0.5", "\"roughness\": \"r.png\""));
    assert!(
        problem.contains("r.png: does not exist, and roughness names it; that folder has Wall_Rough.png")
    );
    let problem = folder.problem(&WAVES.replace(", \"roughness\": 0.5", ""));
    assert!(problem.contains("has no roughness") && problem.contains("Wall_Rough.png"), "{problem}");
    let problem = folder.problem(&WAVES.replace("\"base_colour\": [0.5, 0.4, 0.3],", ""));
    assert!(problem.contains("has no base_colour; state a value or a map"), "{problem}");
    assert!(!problem.contains("that folder"));
    assert!(folder.problem(&WAVES.replace("\"height\": \"waves.png\",", "")).contains("height is missing"));
    assert!(folder.problem(&with("\"normal\": \"red.png\"")).contains("red.png: "));
    assert!(folder.problem(&with("\"normal_convention\": \"opengl\"")).contains("without normal"));
    let steep =
        folder.read(&WAVES.replace("waves", "noise").replace("0.1,", "2,").replace("\"noise.png\"", "0.6"));
    assert!(steep.notes.is_empty());
    folder.grey("noise.png", |x, y| f64::from(((x * 64.0) as u32 + (y * 64.0) as u32) % 2));
    let steep = folder.read(&WAVES.replace("waves", "noise"));
    assert!(steep.notes[0].contains("steeper than 80 degrees"), "{:?}", steep.notes);
}
