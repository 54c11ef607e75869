//! Wavefront OBJ: positions, normals, texture coordinates and faces of any number of corners. Groups, materials, lines
//! and curves are left aside.
//!
//! Read here and not by `tobj` 4.0: that takes polylines (`l`) for faces, shifts the normals of meshes where only some
//! corners have one, overflows on relative indices that reach before the first vertex, and does not say which line is
//! wrong.

use super::{Checked, MAX_TRIANGLES, MAX_VERTICES, RawMesh, polygon, too_many};
use std::collections::HashMap;
use std::io::{BufRead, Read};

/// Longest line, in bytes: ten times the longest face that is taken.
const MAX_LINE: u64 = 1 << 16;

/// Position, texture coordinate and normal of a corner, from 0.
type Corner = [Option<u32>; 3];

#[derive(Default)]
struct Reader {
    positions: Vec<[f64; 3]>,
    coordinates: Vec<[f64; 2]>,
    normals: Vec<[f64; 3]>,
    vertices: HashMap<Corner, u32>,
    corners: Vec<Corner>,
    triangles: Vec<[u32; 3]>,
    folded: usize,
}

/// Reads a file.
pub(super) fn read(input: &mut impl BufRead) -> Checked<RawMesh> {
    let mut reader = Reader::default();
    let (mut line, mut number) = (Vec::new(), 0_u64);
    loop {
        let start = line.len();
        let count = input.by_ref().take(MAX_LINE + 1).read_until(b'\n', &mut line);
        let count = count.map_err(|e| format!("cannot be read: {e}"))?;
        number += u64::from(count > 0);
        if line.len() as u64 > MAX_LINE {
            return Err(format!("line {number} is longer than {MAX_LINE} bytes"));
        }
        let end = line.trim_ascii_end().len().max(start);
        if count > 0 && line[start..end].ends_with(b"\\") {
            line.truncate(end - 1);
            line.push(b' ');
            continue;
        }
        reader.line(&line).map_err(|problem| format!("line {number}: {problem}"))?;
        line.clear();
        if count == 0 {
            return Ok(reader.finish());
        }
    }
}

impl Reader {
    fn line(&mut self, line: &[u8]) -> Checked<()> {
        // Comments and names may be in any encoding.
        let line = String::from_utf8_lossy(line);
        let mut words = line.split_ascii_whitespace();
        match words.next() {
            Some("v") => push(&mut self.positions, numbers(words)?),
            Some("vt") => push(&mut self.coordinates, numbers(words)?),
            Some("vn") => push(&mut self.normals, numbers(words)?),
            Some("f") => self.face(words),
            _ => Ok(()),
        }
    }

    fn face<'a>(&mut self, words: impl Iterator<Item = &'a str>) -> Checked<()> {
        let mut corners = Vec::new();
        for word in words.take_while(|word| !word.starts_with('#')) {
            let corner = self.corner(word)?;
            let next = self.corners.len() as u32;
            let vertex = *self.vertices.entry(corner).or_insert(next);
            if vertex == next {
                self.corners.push(corner);
            }
            corners.push(vertex);
        }
        if self.corners.len() > MAX_VERTICES {
            return Err(too_many("different corners", self.corners.len(), MAX_VERTICES));
        }
        let position = |corner: u32| {
            let [place, ..] = self.corners[corner as usize];
            place.map_or([0.0; 3], |place| self.positions[place as usize])
        };
        self.folded += usize::from(!polygon::triangulate(&corners, position, &mut self.triangles)?);
        if self.triangles.len() > MAX_TRIANGLES {
            return Err(too_many("triangles", self.triangles.len(), MAX_TRIANGLES));
        }
        Ok(())
    }

    /// `p`, `p/t`, `p//n` or `p/t/n`; from 1, or from -1 backwards.
    fn corner(&self, word: &str) -> Checked<Corner> {
        let counts = [self.positions.len(), self.coordinates.len(), self.normals.len()];
        let mut corner = [None; 3];
        for (k, part) in word.split('/').enumerate() {
            if part.is_empty() && k > 0 {
                continue;
            }
            let (Some(&count), Ok(index)) = (counts.get(k), part.parse::<i64>()) else {
                return Err(format!("{word} is not the corner of a face"));
            };
            let place = if index < 0 { index.checked_add(count as i64) } else { index.checked_sub(1) };
            match place {
                Some(place) if (0..count as i64).contains(&place) => corner[k] = Some(place as u32),
                _ => {
                    let what = ["positions", "texture coordinates", "normals"][k];
                    return Err(format!("index {index} of {count} {what}"));
                }
            }
        }
        Ok(corner)
    }

    fn finish(self) -> RawMesh {
        let mut notes = polygon::note(self.folded).into_iter().collect::<Vec<_>>();
        let normals = gather(&self.corners, &self.normals, 2, "normals", &mut notes);
        let uv = gather(&self.corners, &self.coordinates, 1, "texture coordinates", &mut notes);
        let place = |corner: &Corner| corner[0].map_or([0.0; 3], |place| self.positions[place as usize]);
        let positions = self.corners.iter().map(place).collect();
        RawMesh { positions, normals, uv, triangles: self.triangles, notes }
    }
}

/// What the corners point to, if all of them do.
fn gather<T: Copy>(
    corners: &[Corner],
    values: &[T],
    part: usize,
    what: &str,
    notes: &mut Vec<String>,
) -> Vec<T> {
    let found: Vec<T> = corners.iter().filter_map(|c| c[part].map(|k| values[k as usize])).collect();
    if found.len() == corners.len() {
        return found;
    }
    if !found.is_empty() {
        notes.push(format!("only some corners have {what}; all of them are left aside"));
    }
    Vec::new()
}

fn push<T>(list: &mut Vec<T>, value: T) -> Checked<()> {
    if list.len() == MAX_VERTICES {
        return Err(too_many("vertices", list.len() + 1, MAX_VERTICES));
    }
    list.push(value);
    Ok(())
}

/// The first N numbers of a line; what follows (a weight, a colour) is left aside.
fn numbers<'a, const N: usize>(mut words: impl Iterator<Item = &'a str>) -> Checked<[f64; N]> {
    let mut numbers = [0.0; N];
    for number in &mut numbers {
        let word = words.next().ok_or_else(|| format!("has fewer than {N} numbers"))?;
        *number = word.parse().map_err(|_| format!("{word} is not a number"))?;
    }
    Ok(numbers)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Checked<RawMesh> {
        read(&mut text.as_bytes())
    }

    const SQUARE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0.5\nv 0 1 0\n";

    #[test]
    fn corners_are_joined_where_all_of_them_agree() {
        let text = format!("{SQUARE}vt 0 0\nvt 1 1\nvn 0 0 1\nf 1/1/1 2/2/1 3/2/1\nf -4/-2/-1 3/2/1 4/2/1\n");
        let mesh = parse(&text).unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!((mesh.positions.len(), mesh.uv.len(), mesh.normals.len()), (4, 4, 4));
        assert_eq!((mesh.positions[2], mesh.uv[1]), ([1.0, 1.0, 0.5], [1.0, 1.0]));
        assert!(mesh.notes.is_empty());
        // Another texture coordinate is another vertex.
        assert_eq!(parse(&text.replace("-4/-2", "-4/-1")).unwrap().positions.len(), 5);
    }

    #[test]
    fn only_faces_make_triangles() {
        let text = format!(
            "# caf\u{e9}\nmtllib a.mtl\no thing\n{SQUARE}usemtl red\ns 1\nl 1 2 3\np 1\nf 1 \\\n 2 \\\r\n 3 4 # a quad"
        );
        assert_eq!(parse(&text).unwrap().triangles.len(), 2);
        assert_eq!(parse("v 0 0 0 1 0.5 0.5\n").unwrap().triangles.len(), 0);
    }

    #[test]
    fn normals_of_some_corners_are_left_aside() {
        let mesh = parse(&format!("{SQUARE}vn 0 0 1\nf 1//1 2//1 3\n")).unwrap();
        assert!(mesh.normals.is_empty() && mesh.notes[0].contains("only some corners have normals"));
    }

    #[test]
    fn wrong_lines_are_named() {
        for (line, word) in [
            ("f 1 2 5", "index 5 of 4 positions"),
            ("f 1 2 -5", "index -5 of 4 positions"),
            ("f 1 2 0", "index 0 of 4"),
            ("f 1/1 2/1 3/1", "index 1 of 0 texture coordinates"),
            ("f 1 2 9223372036854775807", "of 4 positions"),
            ("f 1 2 -9223372036854775808", "of 4 positions"),
            ("f 1 2 99999999999999999999", "not the corner"),
            ("f 1///4 2 3", "not the corner"),
            ("f /1 2 3", "not the corner"),
            ("f 1 2", "2 corners"),
            ("v 1 2", "fewer than 3 numbers"),
            ("v 1 2 x", "x is not a number"),
        ] {
            let problem = parse(&format!("{SQUARE}{line}\n")).unwrap_err();
            assert!(problem.contains("line 5") && problem.contains(word), "{line}: {problem}");
        }
        assert!(parse(&"f ".repeat(1 << 16)).unwrap_err().contains("longer"));
        assert!(parse(&"\\\n".repeat(1 << 16)).unwrap_err().contains("longer"));
    }
}
