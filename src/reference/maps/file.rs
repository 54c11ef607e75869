//! The fields of material.json.

use crate::error::{Error, Result};
use crate::reference::mesh_file::Up;
use serde::Deserialize;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Largest material.json that is read, in bytes.
const MAX_JSON_BYTES: u64 = 1 << 20;
/// Longest name, which is carried into every file that is made of the material.
const MAX_NAME_BYTES: usize = 256;

/// material.json. Fields that one kind of material needs and another must not have are optional here.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MaterialFile {
    version: u32,
    pub name: String,
    pub height: Option<Scalar>,
    // As f64, so that a number too large for f32 is refused by its field's name.
    pub displacement: Option<f64>,
    pub midlevel: Option<f64>,
    pub height_range: Option<[f64; 2]>,
    pub mesh: Option<PathBuf>,
    pub tile: Option<[f64; 4]>,
    pub up: Option<Up>,
    pub base_colour: Option<Colour>,
    pub roughness: Option<Scalar>,
    pub metalness: Option<Scalar>,
    pub specular: Option<Scalar>,
    pub normal: Option<PathBuf>,
    pub normal_convention: Option<Convention>,
    pub opacity: Option<PathBuf>,
    pub base: Option<PathBuf>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(untagged, expecting = "expected a number or the name of a map")]
pub(super) enum Scalar {
    Constant(f32),
    Map(PathBuf),
}

#[derive(Clone, Debug, Deserialize)]
#[serde(untagged, expecting = "expected [r, g, b] or the name of a map")]
pub(super) enum Colour {
    Constant([f32; 3]),
    Map(PathBuf),
}

/// Which way the green of a normal map points.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub(super) enum Convention {
    /// Up in the picture, against the rows.
    #[default]
    OpenGl,
    /// Down in the picture, along the rows.
    DirectX,
}

impl Convention {
    /// The convention's name in the file.
    pub fn name(self) -> &'static str {
        match self {
            Self::OpenGl => "opengl",
            Self::DirectX => "directx",
        }
    }

    /// The one that it is not.
    pub fn other(self) -> Self {
        match self {
            Self::OpenGl => Self::DirectX,
            Self::DirectX => Self::OpenGl,
        }
    }
}

impl MaterialFile {
    /// Reads the file and checks which fields it has.
    pub fn read(path: &Path) -> Result<Self> {
        let mut text = String::new();
        let unreadable = |e: std::io::Error| Error::file(path, format!("cannot be read as a material: {e}"));
        let file = std::fs::File::open(path).map_err(unreadable)?;
        file.take(MAX_JSON_BYTES + 1).read_to_string(&mut text).map_err(unreadable)?;
        if text.len() as u64 > MAX_JSON_BYTES {
            let problem = format!("is longer than the {MAX_JSON_BYTES} bytes of a material.json");
            return Err(Error::file(path, problem));
        }
        let file: Self =
            serde_json::from_str(&text).map_err(|e| Error::file(path, format!("is not a material: {e}")))?;
        if file.version != 1 {
            let problem = format!("version is {}; this program reads version 1", file.version);
            return Err(Error::file(path, problem));
        }
        if file.name.is_empty() || file.name.len() > MAX_NAME_BYTES || file.name.chars().any(char::is_control)
        {
            return Err(Error::file(path, format!("name must be one line of 1 to {MAX_NAME_BYTES} bytes")));
        }
        file.check_fields().map_err(|problem| Error::file(path, problem))?;
        Ok(file)
    }

    fn check_fields(&self) -> std::result::Result<(), String> {
        let flat = [
            ("height", self.height.is_some()),
            ("displacement", self.displacement.is_some()),
            ("midlevel", self.midlevel.is_some()),
            ("opacity", self.opacity.is_some()),
        ];
        let solid = [("tile", self.tile.is_some()), ("up", self.up.is_some())];
        let (foreign, other) = if self.mesh.is_some() {
            (&flat[..], "is for a height map")
        } else {
            (&solid[..], "is for a mesh")
        };
        if let Some((field, _)) = foreign.iter().find(|(_, stated)| *stated) {
            let kind = if self.mesh.is_some() { "mesh" } else { "height" };
            return Err(format!("{field} {other}, and the file states {kind}; leave one of them out"));
        }
        if self.normal_convention.is_some() && self.normal.is_none() {
            return Err("normal_convention is stated without normal; name the normal map".into());
        }
        match (&self.base, &self.opacity) {
            (Some(_), None) => {
                Err("base is stated without opacity; name the map of the sheet's holes".into())
            }
            (None, Some(_)) => {
                Err("opacity is stated without base; name what is seen through the holes".into())
            }
            _ => Ok(()),
        }
    }
}
