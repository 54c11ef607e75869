//! Meshes from files: OBJ and PLY, brought to the tile and checked that they repeat with it.
//!
//! The tile is a square of the file's ground: x and y where z is up, x and z where y is. Seen from above it lies as the
//! pictures of the maps do: x to the right, rows downwards. So our y runs against the file's y where z is up, and along
//! its z where y is. Texture coordinates become (column, row): the v of both formats runs up the picture.
//!
//! A mesh may stick out of its tile, as pebbles do that lie across the border; it is repeated with the tile. Where it
//! is cut along straight borders, either side must continue the other; and no ray from above may fall through.

mod cover;
mod obj;
mod place;
mod ply;
mod polygon;
mod seam;
#[cfg(test)]
mod tests;

pub use place::{Placement, Up};

use super::primitives::TriangleMesh;
use crate::error::{Error, Result};
use std::fs::File;
use std::io::{BufReader, Read, Take};
use std::path::Path;

/// Largest file, in bytes.
pub const MAX_BYTES: u64 = 1 << 30;

/// Most triangles: a 1414 x 1414 grid. With its tree such a mesh takes about a gigabyte.
pub const MAX_TRIANGLES: usize = 4_000_000;

/// Most vertices: no triangle shares one.
const MAX_VERTICES: usize = 3 * MAX_TRIANGLES;

/// Why a mesh is refused; the caller knows the file.
type Checked<T> = std::result::Result<T, String>;

/// A mesh in the file's coordinates, as the file has it: nothing is checked but that indices lie within.
#[derive(Clone, Debug, Default)]
pub struct RawMesh {
    /// Corners.
    pub positions: Vec<[f64; 3]>,
    /// One for each position, or none at all.
    pub normals: Vec<[f64; 3]>,
    /// One for each position, or none at all.
    pub uv: Vec<[f64; 2]>,
    /// Corners of each triangle.
    pub triangles: Vec<[u32; 3]>,
    /// What was done to it, a line each.
    pub notes: Vec<String>,
}

/// Reads a mesh as it is, to be placed anywhere: it need not tile.
///
/// # Errors
/// `File` if it is neither .obj nor .ply, cannot be read as one, or is larger than [`MAX_BYTES`] or [`MAX_TRIANGLES`].
pub fn read_raw(path: &Path) -> Result<RawMesh> {
    parsed(path).map_err(|problem| Error::file(path, one_line(&problem)))
}

/// Reads a mesh, in tile widths, with notes on what was done to it.
///
/// Its triangles keep the side on which the file's run counter-clockwise; seen through our axes, where y runs down the
/// picture, that is the side to which the right-hand normal points.
///
/// # Errors
/// `File` if it is neither .obj nor .ply or cannot be read as one, is larger than [`MAX_BYTES`] or [`MAX_TRIANGLES`], has
/// coordinates that are not finite or too far from the tile, or does not tile.
pub fn read(path: &Path, placement: &Placement) -> Result<(TriangleMesh, Vec<String>)> {
    read_checked(path, placement).map_err(|problem| Error::file(path, one_line(&problem)))
}

fn read_checked(path: &Path, placement: &Placement) -> Checked<(TriangleMesh, Vec<String>)> {
    let frame = place::Frame::new(placement)?;
    let raw = parsed(path)?;
    let mut notes = raw.notes.clone();
    let mesh = frame.place(raw, &mut notes)?;
    seam::check(&mesh, &frame)?;
    cover::check(&mesh, &frame)?;
    Ok((mesh, notes))
}

fn parsed(path: &Path) -> Checked<RawMesh> {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
    let parse: fn(&mut BufReader<Take<File>>) -> Checked<RawMesh> = match extension.as_str() {
        "obj" => obj::read,
        "ply" => ply::read,
        _ => return Err("is neither .obj nor .ply; convert the mesh to one of them".into()),
    };
    let unreadable = |e: std::io::Error| format!("cannot be read: {e}");
    let file = File::open(path).map_err(unreadable)?;
    let bytes = file.metadata().map_err(unreadable)?.len();
    if bytes > MAX_BYTES {
        return Err(format!("has {bytes} bytes; at most {MAX_BYTES} work: reduce the mesh"));
    }
    parse(&mut BufReader::new(file.take(MAX_BYTES)))
}

/// Parts of a damaged file may stand in a problem; they must not break its line.
fn one_line(problem: &str) -> String {
    problem.chars().map(|c| if c.is_control() { '?' } else { c }).collect()
}

fn too_many(what: &str, count: usize, most: usize) -> String {
    format!("has {count} {what}; at most {most} work: reduce the mesh")
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|c| a[c] - b[c])
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
