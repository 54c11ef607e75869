//! The user's own materials: `material.json` beside maps as texture sites hand them out, or beside a mesh.
//!
//! A height map and its shading maps:
//! ```json
//! {"version": 1, "name": "bricks", "height": "height.png", "displacement": 0.08, "midlevel": 0.5,
//!  "base_colour": "colour.png", "roughness": "roughness.png", "metalness": 0, "specular": 0.04,
//!  "normal": "normal.png", "normal_convention": "opengl", "height_range": [-0.05, 0.05]}
//! ```
//! Paths are relative to the file. `base_colour` and `roughness` must be stated; `metalness` is 0, `specular` 0.04 and
//! `midlevel` 0.5 otherwise. All but the normal are maps or constants. A height value v lies at
//! z = displacement (v - midlevel) tile widths. Colours in PNG are sRGB; all other maps, and all EXR, are linear.
//!
//! `normal` replaces the field's own normal for shading; nothing is added to it. In PNG, and in EXR unless it holds
//! values below 0, v stands for 2 v - 1. Its red points right; its green points up the picture (`"opengl"`, the
//! default) or down (`"directx"`).
//!
//! `height_range` is the range of heights that is stored, in tile widths, and must hold the surface; without it the
//! surface's own is.
//!
//! A displaced tileable mesh, OBJ or PLY, instead of `height` (see [`super::mesh_file`]):
//! ```json
//! {"version": 1, "name": "pebbles", "mesh": "pebbles.obj", "tile": [-1, -1, 1, 1], "up": "y",
//!  "base_colour": "colour.png", "roughness": 0.6}
//! ```
//! `tile` is \[x0, y0, x1, y1\], the square of the mesh that repeats (the unit square if it is not stated), in x and y, or
//! in x and z where `up` is `"y"`. Its maps follow the mesh's texture coordinates if it has any, and lie over the tile
//! as seen from above otherwise.
//!
//! A sheet with holes over another material, whose file must not name a `base` itself:
//! ```json
//! {"version": 1, "name": "lace", "height": "height.png", "displacement": 0.02, "opacity": "opacity.png",
//!  "base": "../felt/material.json", "base_colour": "colour.png", "roughness": 0.8}
//! ```
//! The sheet is there where its opacity is one half or more.
//!
//! Every map must tile (see [`super::tiling`]); [`ReadOptions::make_tileable`] crops and blends a set that does not.

mod file;
mod lookalikes;
mod normals;
mod reader;
mod sources;
#[cfg(test)]
mod tests;
mod words;

use super::material::Material;
use crate::error::Result;
use std::path::Path;

/// How a material is read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReadOptions {
    /// Where a map does not tile, crops all of them by an eighth and cross-fades what was cropped into the rest.
    pub make_tileable: bool,
}

impl ReadOptions {
    /// Reads a material from its `material.json`.
    ///
    /// # Errors
    /// `File`, naming the map, the mesh, or the json and the field: unreadable or unknown content, a value that is out
    /// of range or not finite, a data map whose channels differ, normals that are none, a map or mesh that does not tile,
    /// or a surface that leaves its `height_range` or [`super::heightfield::MAX_DEPTH`].
    pub fn read(&self, path: &Path) -> Result<Material> {
        reader::read(path, self, true)
    }
}

/// Reads a material from its `material.json`, as it is.
///
/// # Errors
/// As [`ReadOptions::read`].
pub fn read(path: &Path) -> Result<Material> {
    ReadOptions::default().read(path)
}
