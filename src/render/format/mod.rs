//! `scene.json`.
//!
//! ```json
//! {"version": 1,
//!  "materials": {"rings": {"bundle": "bundles/metal-rings"}},
//!  "objects": [{"shape": "plane", "material": "rings", "tiling": [2, 2]}],
//!  "lights": [{"directional": {"direction": [0.6, 0.35, 0.7]}}],
//!  "camera": {"origin": [0, -2, 2], "width": 512, "samples": 16}}
//! ```
//! Everything but the version and the objects has a default. Paths are relative to the file. Lengths are in the scene's
//! own unit, angles in degrees, colours linear RGB, three numbers or one for all three. z is up.

mod camera;
mod check;
mod light;
mod material;
mod value;

pub use camera::{CameraSpec, FootprintSpec, Interpolation, KeySpec, PathSpec};
pub use light::{DirectionalSpec, EnvironmentSpec, LightSpec, PointSpec, SkySpec};
pub use material::{MaterialSpec, Source};
pub use value::{Rgb, Scale};

use crate::error::{Error, Result};
use light::one_light;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Version of the format.
pub const VERSION: u32 = 1;
/// Largest file that is read, in bytes.
const MAX_BYTES: u64 = 16 << 20;
/// The material of objects that name none.
pub const DEFAULT_MATERIAL: &str = "default";

/// A scene as it is written.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneFile {
    /// Version of the format: [`VERSION`].
    pub version: u32,
    /// Materials by name.
    #[serde(default)]
    pub materials: BTreeMap<String, MaterialSpec>,
    /// What there is to see.
    pub objects: Vec<ObjectSpec>,
    /// Lights; one directional light if none is stated.
    #[serde(default = "one_light")]
    pub lights: Vec<LightSpec>,
    /// The camera.
    #[serde(default)]
    pub camera: CameraSpec,
    /// What moves; without it there is one frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub path: Option<PathSpec>,
    /// Indirect bounces of light between objects, 0 or 1.
    #[serde(default)]
    pub bounces: usize,
    /// Exposure of the PNG files in stops.
    #[serde(default)]
    pub stops: f32,
}

/// An object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectSpec {
    /// What it is.
    pub shape: ShapeSpec,
    /// Name of its material.
    #[serde(default = "default_material")]
    pub material: String,
    /// Where its origin is put.
    #[serde(default)]
    pub translate: [f64; 3],
    /// Turns about x, then y, then z, in degrees.
    #[serde(default)]
    pub rotate: [f64; 3],
    /// Scale before the turns.
    #[serde(default)]
    pub scale: Scale,
    /// Tiles along u and v.
    #[serde(default = "one_tile")]
    pub tiling: [f64; 2],
}

/// A shape in its own coordinates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ShapeSpec {
    /// The square \[-1, 1\]^2 at z = 0; uv = ((x + 1) / 2, (y + 1) / 2).
    Plane,
    /// Radius 1 around the origin; u = azimuth / 2 pi from x towards y, v = angle from z / pi.
    Sphere,
    /// Triangles of an OBJ or PLY file, with its texture coordinates and, where it has them, its normals.
    Mesh(PathBuf),
}

impl SceneFile {
    /// Reads and checks a scene.
    ///
    /// # Errors
    /// `File`, naming the path and the field: unreadable, of an unknown version, an unknown or missing field, a value that
    /// is out of bounds or contradicts another.
    pub fn read(path: &Path) -> Result<Self> {
        let mut text = String::new();
        std::fs::File::open(path)
            .and_then(|file| file.take(MAX_BYTES).read_to_string(&mut text))
            .map_err(|e| Error::file(path, format!("cannot be read: {e}")))?;
        Self::from_json(&text, path)
    }

    /// A scene from its text; `path` is named by errors.
    ///
    /// # Errors
    /// As [`SceneFile::read`].
    pub fn from_json(text: &str, path: &Path) -> Result<Self> {
        #[derive(Deserialize)]
        struct Version {
            version: u32,
        }
        let refuse = |problem: String| Error::file(path, problem.replace(char::is_control, " "));
        let Version { version } =
            serde_json::from_str(text).map_err(|e| refuse(format!("is no scene: {e}")))?;
        if version != VERSION {
            return Err(refuse(format!("version: {version}; this program reads {VERSION}")));
        }
        let mut json = serde_json::Deserializer::from_str(text);
        let file: Self = serde_path_to_error::deserialize(&mut json).map_err(|e| {
            let (field, problem) = (e.path().to_string(), e.into_inner());
            // What is unknown or missing at the top has no field to be named by.
            refuse(if field == "." { problem.to_string() } else { format!("{field}: {problem}") })
        })?;
        file.check().map_err(|e| Error::file(path, e))?;
        Ok(file)
    }

    /// Checks every bound.
    ///
    /// # Errors
    /// `Config`, naming the field.
    pub fn check(&self) -> Result<()> {
        check::scene(self)
    }
}

fn default_material() -> String {
    DEFAULT_MATERIAL.into()
}

fn one_tile() -> [f64; 2] {
    [1.0; 2]
}
