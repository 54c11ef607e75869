//! The folder of an analysis.
//!
//! | file | what |
//! | --- | --- |
//! | `analysis.json` | all figures |
//! | `MATERIAL.png` | the picture of a material |
//! | `index.html` | figures and pictures of all materials |

use super::{Analysis, KIND, page, plate};
use crate::error::{Error, Result};
use neumip_export::whole_file::{write_json, write_whole};
use serde::Deserialize;
use std::path::Path;

const JSON: &str = "analysis.json";
const PAGE: &str = "index.html";
/// Longest name of a picture without its ending and number.
const LONGEST: usize = 40;

/// What an older analysis says of itself.
#[derive(Deserialize)]
struct Record {
    kind: String,
    materials: Vec<Drawn>,
}

#[derive(Deserialize)]
struct Drawn {
    picture: String,
}

/// Whether an analysis may be written to a folder.
///
/// # Errors
/// `File` if it is a file, holds something else, or holds an analysis and `force` is not set.
pub fn free(folder: &Path, force: bool) -> Result<()> {
    older(folder, force).map(|_| ())
}

/// Writes an analysis; it replaces an older one with `force`.
///
/// # Errors
/// As [`free`]; `File` if something cannot be written.
pub fn write(analysis: &Analysis, folder: &Path, force: bool) -> Result<()> {
    let older = older(folder, force)?;
    let pictures = analysis.materials.iter().map(plate::png).collect::<Result<Vec<_>>>()?;
    std::fs::create_dir_all(folder).map_err(|e| Error::file(folder, format!("cannot be made: {e}")))?;
    for name in older {
        let path = folder.join(name);
        std::fs::remove_file(&path).map_err(|e| Error::file(path, format!("cannot be removed: {e}")))?;
    }
    // The record goes first: what holds one can be replaced, also when the rest was not finished.
    write_json(&folder.join(JSON), analysis)?;
    for (asked, png) in analysis.materials.iter().zip(pictures) {
        write_whole(&folder.join(&asked.picture), &png)?;
    }
    Ok(write_whole(&folder.join(PAGE), page::html(analysis).as_bytes())?)
}

/// The pictures and the page of the older analysis that is to be replaced.
fn older(folder: &Path, force: bool) -> Result<Vec<String>> {
    if !folder.exists() {
        return Ok(Vec::new());
    }
    if !folder.is_dir() {
        return Err(Error::file(folder, "is a file; choose another --out"));
    }
    let entries = std::fs::read_dir(folder)
        .and_then(|entries| entries.map(|entry| Ok(entry?.file_name())).collect::<std::io::Result<Vec<_>>>())
        .map_err(|e| Error::file(folder, format!("cannot be read: {e}")))?;
    let mut names: Vec<String> = entries.iter().map(|name| name.to_string_lossy().into_owned()).collect();
    names.sort();
    if names.is_empty() {
        return Ok(names);
    }
    let record = std::fs::read(folder.join(JSON)).ok();
    let record: Option<Record> = record.and_then(|bytes| serde_json::from_slice(&bytes).ok());
    let record = record.filter(|record| record.kind == KIND);
    let ours = |name: &String| {
        let drawn = |record: &Record| record.materials.iter().any(|drawn| drawn.picture == *name);
        [JSON, PAGE].contains(&name.as_str()) || record.as_ref().is_some_and(drawn)
    };
    if record.is_none() || !names.iter().all(ours) {
        return Err(Error::file(folder, "exists and holds more than an analysis; choose another --out"));
    }
    if !force {
        return Err(Error::file(folder, "holds an analysis: choose another --out or add --force"));
    }
    names.retain(|name| name != JSON);
    Ok(names)
}

/// The name of a material's picture: what no file system minds, and none that is `taken`, on any file system.
pub(super) fn picture(material: &str, taken: &[&str]) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() || c == '-' { c.to_ascii_lowercase() } else { '_' };
    let stem: String = material.chars().take(LONGEST).map(plain).collect();
    let numbered = (2..).map(|k| format!("{stem}_{k}.png"));
    let mut names = std::iter::once(format!("{stem}.png")).chain(numbered);
    names.find(|name| !taken.contains(&name.as_str())).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_have_names_of_their_own() {
        assert_eq!(picture("ball", &[]), "ball.png");
        assert_eq!(picture("../Ball \u{e4}", &[]), "___ball__.png");
        assert_eq!(picture("Ball", &["ball.png", "ball_2.png"]), "ball_3.png");
        assert_eq!(picture(&"x".repeat(500), &[]).len(), LONGEST + 4);
    }

    #[test]
    fn nothing_else_is_replaced() {
        let root = tempfile::tempdir().unwrap();
        let refused = |force: bool| free(root.path(), force).err().map(|e| e.to_string());
        assert_eq!(refused(false), None);
        let record = format!(r#"{{"kind": "{KIND}", "materials": [{{"picture": "ball.png"}}]}}"#);
        std::fs::write(root.path().join(JSON), &record).unwrap();
        std::fs::write(root.path().join("ball.png"), "").unwrap();
        assert!(refused(false).unwrap().contains("--force"));
        assert_eq!(refused(true), None);
        std::fs::write(root.path().join("holiday.png"), "").unwrap();
        assert!(refused(true).unwrap().contains("more than an analysis"));
        std::fs::remove_file(root.path().join("holiday.png")).unwrap();
        std::fs::write(root.path().join(JSON), record.replace(KIND, "other")).unwrap();
        assert!(refused(true).unwrap().contains("more than an analysis"));
    }
}
