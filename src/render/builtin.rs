//! Scenes that need no file: those of docs/scenes.

use super::format::SceneFile;
use crate::error::{Error, Result};
use std::path::{Path, PathBuf};

/// Names and texts.
const SCENES: [(&str, &str); 13] = [
    ("plane", include_str!("../../docs/scenes/plane.json")),
    ("sphere", include_str!("../../docs/scenes/sphere.json")),
    ("moving-light", include_str!("../../docs/scenes/moving-light.json")),
    ("zoom", include_str!("../../docs/scenes/zoom.json")),
    ("still-life", include_str!("../../docs/scenes/still-life.json")),
    ("far-floor", include_str!("../../docs/scenes/far-floor.json")),
    ("far-ball", include_str!("../../docs/scenes/far-ball.json")),
    ("middle-floor", include_str!("../../docs/scenes/middle-floor.json")),
    ("middle-ball", include_str!("../../docs/scenes/middle-ball.json")),
    ("near-corner", include_str!("../../docs/scenes/near-corner.json")),
    ("near-slope", include_str!("../../docs/scenes/near-slope.json")),
    ("fixed-floor", include_str!("../../docs/scenes/fixed-floor.json")),
    ("fixed-ball", include_str!("../../docs/scenes/fixed-ball.json")),
];

/// The names.
pub fn names() -> Vec<&'static str> {
    SCENES.iter().map(|(name, _)| *name).collect()
}

/// A scene by its built-in name or its file, with the path by which its errors and relative paths go. A file of a built-in
/// name is named by its folder too, as in `./plane`.
///
/// # Errors
/// As [`SceneFile::read`]; `Usage` for a name that is neither, listing the built-in ones.
pub fn scene(spec: &str) -> Result<(SceneFile, PathBuf)> {
    let path = Path::new(spec);
    if let Some((_, text)) = SCENES.iter().find(|(name, _)| *name == spec) {
        return Ok((SceneFile::from_json(text, path)?, path.to_path_buf()));
    }
    if path.is_file() {
        return Ok((SceneFile::read(path)?, path.to_path_buf()));
    }
    let names = names().join(", ");
    Err(Error::usage(format!("--scene {spec}: no such file, and no built-in scene; built in are {names}")))
}
