//! Whole files: where they end up, and what is refused.

use super::*;
use crate::random::{Random, Stream};
use std::f64::consts::TAU;
use std::fmt::Write as _;

const UNIT: Placement = Placement { tile: [0.0, 0.0, 1.0, 1.0], up: Up::Z };

/// A grid of `side` x `side` squares over the unit square, bent in its plane and displaced, both periodically, and then
/// changed by the caller.
struct Sample {
    side: usize,
    points: Vec<[f64; 3]>,
    faces: Vec<Vec<usize>>,
}

impl Sample {
    fn new(side: usize) -> Self {
        Self::bent(side, 0.02)
    }

    fn bent(side: usize, most: f64) -> Self {
        let wave = |x: f64, y: f64| (TAU * x).sin() + (TAU * (2.0 * y - x)).cos();
        let at = |k: usize| {
            let [x, y] = [k % (side + 1), k / (side + 1)].map(|c| c as f64 / side as f64);
            let bend = most * (TAU * x).sin() * (TAU * y).sin();
            [x + bend, y - bend, 0.05 * wave(x, y)]
        };
        let points = (0..(side + 1) * (side + 1)).map(at).collect();
        let corner = |i: usize, j: usize| i * (side + 1) + j;
        let face = |k: usize| {
            let (i, j) = (k / side, k % side);
            vec![corner(i, j), corner(i, j + 1), corner(i + 1, j + 1), corner(i + 1, j)]
        };
        Self { side, points, faces: (0..side * side).map(face).collect() }
    }

    fn corner(&mut self, i: usize, j: usize) -> &mut [f64; 3] {
        &mut self.points[i * (self.side + 1) + j]
    }

    fn moved(mut self, change: impl Fn([f64; 3]) -> [f64; 3]) -> Self {
        self.points.iter_mut().for_each(|p| *p = change(*p));
        self
    }

    fn obj(&self) -> String {
        let mut text = String::new();
        for [x, y, z] in &self.points {
            writeln!(text, "v {x:.6} {y:.6} {z:.6}").unwrap();
        }
        for face in &self.faces {
            let corners: Vec<_> = face.iter().map(|k| (k + 1).to_string()).collect();
            writeln!(text, "f {}", corners.join(" ")).unwrap();
        }
        text
    }

    fn ply(&self) -> Vec<u8> {
        let (vertices, faces) = (self.points.len(), self.faces.len());
        let mut bytes = format!(
            "ply\nformat binary_little_endian 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\n\
             property float z\nelement face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
        )
        .into_bytes();
        self.points.iter().flatten().for_each(|c| bytes.extend((*c as f32).to_le_bytes()));
        for face in &self.faces {
            bytes.push(face.len() as u8);
            face.iter().for_each(|k| bytes.extend((*k as i32).to_le_bytes()));
        }
        bytes
    }

    fn read(&self, placement: &Placement) -> Result<(TriangleMesh, Vec<String>)> {
        read_bytes("mesh.obj", self.obj().as_bytes(), placement)
    }

    fn problem(&self) -> String {
        let problem = self.read(&UNIT).unwrap_err().to_string();
        assert!(problem.contains("mesh.obj") && !problem.contains('\n'));
        problem
    }
}

fn read_bytes(name: &str, bytes: &[u8], placement: &Placement) -> Result<(TriangleMesh, Vec<String>)> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    read(&path, placement)
}

/// Rounding of six digits of a text file and of f32.
const DIGITS: f64 = 2e-6;

/// True if both meshes have the same triangles in the same places.
fn same(a: &TriangleMesh, b: &TriangleMesh) -> bool {
    let near = |a: &[f64; 3], b: &[f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() <= DIGITS);
    a.triangles == b.triangles && a.positions.iter().zip(&b.positions).all(|(a, b)| near(a, b))
}

#[test]
fn formats_and_axes_agree() {
    let sample = Sample::new(8);
    let (want, notes) = sample.read(&UNIT).unwrap();
    assert_eq!((want.triangles.len(), notes.len()), (128, 0));
    assert!(same(&read_bytes("mesh.PLY", &sample.ply(), &UNIT).unwrap().0, &want));
    // The same mesh, of another size, elsewhere, with y up: x, y, z becomes x, z, -y.
    let turned = Sample::new(8).moved(|[x, y, z]| [7.0 * x + 3.0, 7.0 * z, -7.0 * y + 1.0]);
    let placement = Placement { tile: [3.0, -6.0, 10.0, 1.0], up: Up::Y };
    assert!(same(&turned.read(&placement).unwrap().0, &want));
    let mut other = Sample::new(8);
    other.corner(4, 4)[2] += 1e-5;
    assert!(!same(&other.read(&UNIT).unwrap().0, &want), "a hundred thousandth must show");
}

#[test]
fn the_picture_from_above_is_kept() {
    let mut sample = Sample::new(4).moved(|[x, y, _]| [x, y, 0.0]);
    // A peak near the upper left corner of what one sees: x small, y large.
    sample.corner(3, 1)[2] = 0.25;
    let (mesh, _) = sample.read(&UNIT).unwrap();
    let peak = mesh.positions.iter().find(|p| p[2] > 0.2).unwrap();
    assert!(peak[0] < 0.3 && peak[1] < 0.3, "{peak:?}");
    for t in &mesh.triangles {
        let [a, b, c] = t.map(|k| mesh.positions[k as usize]);
        assert!(cross(minus(b, a), minus(c, a))[2] > 0.0, "counter-clockwise faces look up");
    }
    let text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0.6 0.8\n\
                f 1/1/1 2/2/1 3/3/1 4/4/1\n";
    let (mesh, _) = read_bytes("a.obj", text.as_bytes(), &UNIT).unwrap();
    for (p, uv) in mesh.positions.iter().zip(mesh.uv.unwrap()) {
        assert_eq!([p[0], p[1]], uv, "a flat unfolding lies as the tile does");
    }
    assert_eq!(mesh.normals.unwrap()[0], [0.0, -0.6, 0.8]);
}

#[test]
fn shifted_and_overhanging_meshes_tile() {
    Sample::new(8).moved(|[x, y, z]| [x - 0.4, y + 0.3, z]).read(&UNIT).unwrap();
    // Interlocking ends: both borders wave alike.
    let wavy = Sample::new(8).moved(|[x, y, z]| [x + 0.03 * (TAU * y).sin(), y, z]);
    wavy.read(&UNIT).unwrap();
    // One side of the border is divided more finely, but along the same line.
    let mut sample = Sample::new(2).moved(|[x, y, _]| [x, y, 0.0]);
    sample.points.push([0.0, 0.25, 0.0]);
    let middle = sample.points.len() - 1;
    sample.faces[0] = vec![0, 1, 4, 3, middle];
    sample.read(&UNIT).unwrap();
    sample.points[middle][2] = 2e-5;
    assert!(sample.problem().contains("does not tile"));
}

#[test]
fn borders_that_do_not_meet_are_refused() {
    for (i, j, sides) in [(3, 0, "left and right"), (0, 5, "top and bottom"), (8, 5, "top and bottom")] {
        let mut sample = Sample::new(8);
        sample.corner(i, j)[2] += 0.01;
        let problem = sample.problem();
        assert!(problem.contains(&format!("4 open edges on its {sides} borders")), "{problem}");
        assert!(problem.contains("gap is 0.0"), "{problem}");
        let mut sample = Sample::new(8);
        sample.corner(i, j)[2] += 0.5e-5;
        sample.read(&UNIT).unwrap();
    }
    // The whole of one border is missing.
    let mut sample = Sample::new(8);
    sample.faces.retain(|face| face[0] % 9 != 7);
    assert!(sample.problem().contains("no edge there at all"));
}

#[test]
fn holes_are_refused_and_floors_close_them() {
    let mut sample = Sample::bent(16, 0.0);
    sample.faces.remove(16 * 5 + 3);
    let problem = sample.problem();
    // The square from 3/16 to 4/16 in x and from 5/16 to 6/16 in y has 64 x 64 rays.
    assert!(problem.contains("has holes: 4096 of 1048576"), "{problem}");
    assert!(problem.contains("the first at x = 0.1879, y = 0.3746"), "{problem}");
    let below = sample.points.len();
    sample.points.extend([[0.0, 0.0, -0.4], [1.0, 0.0, -0.4], [1.0, 1.0, -0.4], [0.0, 1.0, -0.4]]);
    sample.faces.push((below..below + 4).collect());
    sample.read(&UNIT).unwrap();
}

#[test]
fn absurd_meshes_are_refused() {
    let problem = |change: fn([f64; 3]) -> [f64; 3]| Sample::new(4).moved(change).problem();
    assert!(problem(|[x, y, z]| [2.0 * x - 1.0, 2.0 * y - 1.0, z]).contains("state the square that repeats"));
    assert!(problem(|[x, y, z]| [x, y, z + 3.0]).contains("at most 1 works"));
    assert!(problem(|[x, y, z]| [x, y, 1e300 * z * 1e10]).contains("not finite"));
    assert!(problem(|[x, y, _]| [x, y, f64::NAN]).contains("not finite"));
    assert!(problem(|[_, y, z]| [0.0, y, z]).contains("does not tile"));
    assert!(problem(|[x, y, z]| [0.3 + 0.2 * x, y, z]).contains("fall through"));
    assert!(problem(|_| [0.5, 0.5, 0.0]).contains("no triangle with an area"));
    let text = |text: &str| read_bytes("mesh.obj", text.as_bytes(), &UNIT).unwrap_err().to_string();
    assert!(text("").contains("no triangles"));
    assert!(text("v 0 0 0\nf 1 1 1\n").contains("no triangle with an area"));
    assert!(read_bytes("mesh.stl", b"", &UNIT).unwrap_err().to_string().contains("neither .obj nor .ply"));
    assert!(read(Path::new("/no such folder/mesh.obj"), &UNIT).is_err());
    let tile = |tile| Sample::new(4).read(&Placement { tile, up: Up::Z }).unwrap_err().to_string();
    assert!(tile([0.0, 0.0, 1.0, 2.0]).contains("must be square"));
    assert!(tile([0.0, 0.0, 1.0, f64::NAN]).contains("x0 < x1"));
    assert!(tile([1.0, 0.0, 0.0, 1.0]).contains("x0 < x1"));
    assert!(tile([-1e308, -1e308, 1e308, 1e308]).contains("x0 < x1"));
}

#[test]
fn triangles_without_area_are_counted() {
    let mut sample = Sample::new(4);
    sample.faces.push(vec![0, 1, 1]);
    sample.points.push([9.0, 9.0, 9.0]);
    let (mesh, notes) = sample.read(&UNIT).unwrap();
    assert_eq!((mesh.triangles.len(), mesh.positions.len()), (32, 25));
    assert_eq!(notes, ["1 of 33 triangles have no area and are left out"]);
}

/// Cut and flipped files are read or refused in one line, and what is read is whole.
#[test]
fn damaged_files_do_no_harm() {
    let sample = Sample::new(3);
    let obj = sample.obj().replace("f 1 ", "vn 0 0 1\nvt 0.5 0.5\nf 1/-1/1 ").into_bytes();
    let mut refused = 0;
    for (name, bytes) in [("mesh.obj", obj), ("mesh.ply", sample.ply())] {
        read_bytes(name, &bytes, &UNIT).unwrap();
        for k in 0..90 {
            let mut random = Random::new(8, Stream::Probe, k);
            let mut damaged = bytes.clone();
            if k % 3 == 0 {
                damaged.truncate(random.below(bytes.len()));
            }
            for _ in 0..random.below(4) + usize::from(k % 3 != 0) {
                if let Some(byte) = damaged.len().checked_sub(1).map(|last| random.below(last + 1)) {
                    damaged[byte] ^= 1 << random.below(8);
                }
            }
            match read_bytes(name, &damaged, &UNIT) {
                Ok((mesh, _)) => {
                    let count = mesh.positions.len();
                    assert!(mesh.positions.iter().flatten().all(|c| c.is_finite() && c.abs() <= 1.5));
                    assert!(mesh.triangles.iter().flatten().all(|&k| (k as usize) < count));
                    assert!(mesh.normals.is_none_or(|n| n.len() == count));
                    assert!(mesh.uv.is_none_or(|uv| uv.len() == count));
                }
                Err(error) => {
                    refused += 1;
                    assert!(!error.to_string().contains(char::is_control), "{error}");
                }
            }
        }
    }
    assert!(refused > 60, "most damage must show: {refused}");
}
