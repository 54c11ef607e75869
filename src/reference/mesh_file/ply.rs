//! PLY, binary or text: vertices and faces. Other elements are skipped.

use super::{Checked, MAX_TRIANGLES, MAX_VERTICES, RawMesh, polygon, too_many};
use serde::Deserialize;
use serde_ply::{DeserializeError, PlyReader};
use std::io::BufRead;

/// Names under which programs store texture coordinates follow each other here.
#[derive(Deserialize)]
struct Vertex {
    x: f64,
    y: f64,
    z: f64,
    #[serde(default)]
    nx: Option<f64>,
    #[serde(default)]
    ny: Option<f64>,
    #[serde(default)]
    nz: Option<f64>,
    #[serde(default)]
    s: Option<f64>,
    #[serde(default)]
    t: Option<f64>,
    #[serde(default)]
    u: Option<f64>,
    #[serde(default)]
    v: Option<f64>,
    #[serde(default)]
    texture_u: Option<f64>,
    #[serde(default)]
    texture_v: Option<f64>,
}

impl Vertex {
    fn normal(&self) -> Option<[f64; 3]> {
        Some([self.nx?, self.ny?, self.nz?])
    }

    fn uv(&self) -> Option<[f64; 2]> {
        let pairs = [(self.s, self.t), (self.u, self.v), (self.texture_u, self.texture_v)];
        pairs.into_iter().find_map(|(u, v)| Some([u?, v?]))
    }
}

#[derive(Deserialize)]
struct Face {
    #[serde(alias = "vertex_index")]
    vertex_indices: Vec<u32>,
}

/// A row of an element that is not looked at.
#[derive(Deserialize)]
struct Skipped {}

/// Reads a file.
pub(super) fn read(input: &mut impl BufRead) -> Checked<RawMesh> {
    let unreadable = |e: DeserializeError| format!("cannot be read as PLY: {}", e.0);
    let mut reader = PlyReader::from_reader(input).map_err(unreadable)?;
    let (mut vertices, mut faces) = (None, None);
    while vertices.is_none() || faces.is_none() {
        let Some(element) = reader.current_element() else {
            let missing = if vertices.is_none() { "vertices" } else { "faces" };
            return Err(format!("has no {missing}; save it as a mesh"));
        };
        let (name, count) = (element.name.clone(), element.count);
        let most = match name.as_str() {
            "vertex" => MAX_VERTICES,
            "face" => MAX_TRIANGLES,
            // Rows without properties take no bytes, so the file's size would not bound them.
            _ if element.properties.is_empty() => 0,
            _ => usize::MAX,
        };
        if count > most {
            return Err(too_many(&format!("rows of {name}"), count, most));
        }
        match name.as_str() {
            "vertex" => vertices = Some(reader.next_element::<Vec<Vertex>>().map_err(unreadable)?),
            "face" => faces = Some(reader.next_element::<Vec<Face>>().map_err(unreadable)?),
            _ => {
                reader.next_element::<Vec<Skipped>>().map_err(unreadable)?;
            }
        }
    }
    join(&vertices.unwrap_or_default(), &faces.unwrap_or_default())
}

fn join(vertices: &[Vertex], faces: &[Face]) -> Checked<RawMesh> {
    let mut mesh = RawMesh {
        positions: vertices.iter().map(|v| [v.x, v.y, v.z]).collect(),
        normals: vertices.iter().map_while(Vertex::normal).collect(),
        uv: vertices.iter().map_while(Vertex::uv).collect(),
        ..RawMesh::default()
    };
    let mut folded = 0;
    for (k, Face { vertex_indices: corners }) in faces.iter().enumerate() {
        if let Some(index) = corners.iter().find(|&&index| index as usize >= vertices.len()) {
            return Err(format!("face {k} names vertex {index} of {}, counted from 0", vertices.len()));
        }
        let position = |corner: u32| mesh.positions[corner as usize];
        let whole = polygon::triangulate(corners, position, &mut mesh.triangles);
        folded += usize::from(!whole.map_err(|problem| format!("face {k}: {problem}"))?);
        if mesh.triangles.len() > MAX_TRIANGLES {
            return Err(too_many("triangles", mesh.triangles.len(), MAX_TRIANGLES));
        }
    }
    mesh.notes.extend(polygon::note(folded));
    Ok(mesh)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(bytes: &[u8]) -> Checked<RawMesh> {
        read(&mut &bytes[..])
    }

    /// A text file with the given header lines after the format, and rows.
    fn text(header: &str, rows: &str) -> String {
        format!("ply\nformat ascii 1.0\ncomment made by hand\n{header}\nend_header\n{rows}\n")
    }

    const XYZ: &str = "element vertex 4\nproperty float x\nproperty float y\nproperty float z";
    const FACE: &str = "element face 1\nproperty list uchar int vertex_indices";
    const ROWS: &str = "0 0 0\n1 0 0\n1 1 0.5\n0 1 0\n4 0 1 2 3";

    #[test]
    fn text_and_binary_agree() {
        let want = parse(text(&format!("{XYZ}\n{FACE}"), ROWS).as_bytes()).unwrap();
        assert_eq!((want.triangles.len(), want.positions[2]), (2, [1.0, 1.0, 0.5]));
        for (format, big) in [("binary_little_endian", false), ("binary_big_endian", true)] {
            let header = format!("{}\n{}", XYZ.replace("float", "double"), FACE.replace("int v", "ushort v"));
            let mut bytes = format!("ply\nformat {format} 1.0\n{header}\nend_header\n").into_bytes();
            let put = |little: &[u8], bytes: &mut Vec<u8>| {
                if big { bytes.extend(little.iter().rev()) } else { bytes.extend(little) }
            };
            want.positions.iter().flatten().for_each(|c| put(&c.to_le_bytes(), &mut bytes));
            bytes.push(4);
            (0..4_u16).for_each(|k| put(&k.to_le_bytes(), &mut bytes));
            let got = parse(&bytes).unwrap();
            assert_eq!((&got.positions, &got.triangles), (&want.positions, &want.triangles), "{format}");
        }
    }

    #[test]
    fn properties_and_elements_may_come_in_any_order() {
        let vertex = "element vertex 3\nproperty uchar red\nproperty float nz\nproperty float y\nproperty float x\n\
                      property double z\nproperty float nx\nproperty float ny\nproperty float u\nproperty float v";
        let header = format!(
            "element edge 2\nproperty int a\n{}\nproperty uchar flag\n{vertex}",
            FACE.replace("indices", "index")
        );
        let rows = "7\n8\n3 0 1 2 1\n255 1 0 0 0 0 0 0.5 0.25\n255 1 0 1 0 0 0 0 0\n255 1 1 0 0 0 0 0 0";
        let mesh = parse(text(&header, rows).as_bytes()).unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2]]);
        assert_eq!(
            (mesh.positions[1], mesh.normals[1], mesh.uv[0]),
            ([1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.5, 0.25])
        );
    }

    #[test]
    fn wrong_files_are_told() {
        let good = text(&format!("{XYZ}\n{FACE}"), ROWS);
        for (from, to, word) in [
            ("0 1 2 3", "0 1 2 4", "face 0 names vertex 4 of 4"),
            ("0 1 2 3", "0 1 2 -1", "PLY"),
            ("4 0 1 2 3", "2 0 1", "2 corners"),
            ("4 0 1 2 3", "4 0 1", "PLY"),
            ("ply\n", "pay\n", "PLY"),
            ("face 1", "face 99999999", "at most"),
            ("vertex 4", "vertex 18446744073709551615", "at most"),
            ("property float z", "property float w", "`z`"),
            (FACE, "", "has no faces"),
            ("element face", "element void 18446744073709551615\nelement face", "rows of void"),
        ] {
            assert!(good.contains(from));
            let problem = parse(good.replace(from, to).as_bytes()).unwrap_err();
            assert!(problem.contains(word), "{to}: {problem}");
        }
    }
}
