//! Rays against geometry that repeats with the tile: fibres ([`Curves`]) and triangle meshes ([`Triangles`]).
//!
//! Every primitive, in all its copies that touch the unit cell, stands in that cell's columns (`columns`); a ray walks
//! over the cells it crosses (`tiled`) and takes the first hit inside the first of them that has one. What may be hit
//! is decided in f32, with margins; what is hit, and where, in f64 from the point where the ray enters the cell.

mod columns;
mod segment;
mod shapes;
#[cfg(test)]
mod tests;
mod tiled;
mod triangle;
mod tube;

pub use segment::{Curve, CurveHit, Curves, MAX_RADIUS, MIN_RADIUS, TUBE_DEPTH};
pub use triangle::{MeshHit, TriangleMesh, Triangles};

use crate::error::{Error, Result};
use crate::reference::heightfield::MAX_DEPTH;

/// Most points of all curves together, most triangles of a mesh.
pub const MAX_PRIMITIVES: usize = 1 << 22;

/// Farthest that geometry may lie from the origin in x and y, in tile widths.
pub const MAX_EXTENT: f64 = 64.0;

/// # Errors
/// `Config` if the point is not finite or too far away; `field` names it.
fn check_point(point: [f64; 3], field: impl FnOnce() -> String) -> Result<()> {
    let [x, y, z] = point;
    if !(x.is_finite() && y.is_finite() && z.is_finite()) {
        return Err(Error::config(field(), "is not finite"));
    }
    if x.abs() > MAX_EXTENT || y.abs() > MAX_EXTENT {
        return Err(Error::config(
            field(),
            format!("({x}, {y}) lies more than {MAX_EXTENT} tile widths from the origin; one tile is 1 wide"),
        ));
    }
    if z.abs() > f64::from(MAX_DEPTH) {
        return Err(Error::config(
            field(),
            format!("z = {z} lies more than {MAX_DEPTH} tile widths above or below the plane; scale it down"),
        ));
    }
    Ok(())
}

#[inline]
fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline]
fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[inline]
fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// The unit vector along `v`; None if it has no length.
fn normalise(v: [f64; 3]) -> Option<[f64; 3]> {
    let length = dot(v, v).sqrt();
    (length > 0.0 && length.is_finite()).then(|| v.map(|x| x / length))
}
