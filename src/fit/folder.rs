//! The folder of a fit: what is finished is there, so that a stopped fit goes on.
//!
//! | path | what |
//! | --- | --- |
//! | `settings.json` | what was asked for |
//! | `full/` | the full model's run, where it was trained here |
//! | `data/`, `truth/`, `trials/` | measured training data, the truth's pictures, trials |
//! | `best.safetensors` | the fitted model, with its domain |
//! | `truncated.safetensors` | the full model cut down to its size |
//! | `pictures/` | truth, full, fitted, truncated side by side |
//! | `fit.json`, `report.html` | every figure; the same to look at |

use super::job::Fitted;
use super::page;
use crate::error::{Error, Result};
use crate::fit::model::material;
use crate::query::{Reflectance, RgbImage};
use crate::report::picture;
use neumip_export::checkpoint::Checkpoint;
use neumip_export::whole_file::{write_json, write_whole};
use serde::Serialize;
use serde_json::Value;
use std::path::{Path, PathBuf};

const SETTINGS: &str = "settings.json";
const OURS: [&str; 10] = [
    SETTINGS,
    "full",
    "data",
    "truth",
    "trials",
    "best.safetensors",
    "truncated.safetensors",
    "pictures",
    "fit.json",
    "report.html",
];
/// Difference that is shown as pale yellow.
const WORST: f32 = 0.2;

/// The folder.
#[derive(Clone, Debug)]
pub struct Folder {
    root: PathBuf,
}

impl Folder {
    /// The folder of a fit with these settings, new or as it was left. With `force` a fit of other settings is replaced.
    ///
    /// # Errors
    /// `File` if it cannot be made, holds a fit of other settings, or something else.
    pub fn open(root: &Path, settings: &impl Serialize, force: bool) -> Result<Self> {
        let this = Self { root: root.to_path_buf() };
        let path = root.join(SETTINGS);
        let failed = |e: serde_json::Error| Error::file(&path, e);
        // Both have gone through a text, where a number may lose its last bit.
        let text = serde_json::to_string(settings).map_err(failed)?;
        let wanted: Value = serde_json::from_str(&text).map_err(failed)?;
        let there: Option<Value> =
            std::fs::read(&path).ok().and_then(|bytes| serde_json::from_slice(&bytes).ok());
        if there.as_ref() == Some(&wanted) {
            return Ok(this);
        }
        if root.exists() {
            let failed = |e: std::io::Error| Error::file(root, format!("cannot be read: {e}"));
            let names: Vec<String> = std::fs::read_dir(root)
                .map_err(failed)?
                .flatten()
                .map(|entry| entry.file_name().to_string_lossy().into_owned())
                .collect();
            if let Some(name) = names.iter().find(|name| !OURS.contains(&name.as_str())) {
                let problem = format!("holds {name}, which is of no fit; choose another --out");
                return Err(Error::file(root, problem));
            }
            if !names.is_empty() && !force {
                let field = there.as_ref().and_then(|there| differing(there, &wanted));
                let problem = format!(
                    "holds a fit with another {}; choose another --out, or replace it with --force",
                    field.unwrap_or_else(|| "setting".into())
                );
                return Err(Error::file(root, problem));
            }
            this.clear(&names)?;
        }
        std::fs::create_dir_all(root).map_err(|e| Error::file(root, format!("cannot be made: {e}")))?;
        write_json(&path, settings)?;
        Ok(this)
    }

    fn clear(&self, names: &[String]) -> Result<()> {
        // The settings go last: until then the folder is a fit's and can be replaced again.
        for name in names.iter().filter(|name| *name != SETTINGS) {
            let path = self.root.join(name);
            let removed =
                if path.is_dir() { std::fs::remove_dir_all(&path) } else { std::fs::remove_file(&path) };
            removed.map_err(|e| Error::file(&path, format!("cannot be removed: {e}")))?;
        }
        Ok(())
    }

    /// Its path.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Writes what a fit gave, its figures last.
    ///
    /// # Errors
    /// `File` for what cannot be written.
    pub fn write(&self, fitted: &Fitted, full: &Checkpoint, stops: f32) -> Result<()> {
        let folder = self.root.join("pictures");
        std::fs::create_dir_all(&folder).map_err(|e| Error::file(&folder, format!("cannot be made: {e}")))?;
        let storage = fitted.storage;
        let answerers: [Box<dyn Reflectance>; 3] = [
            Box::new(material(full, neumip_export::Storage::SINGLE)?),
            Box::new(material(&fitted.checkpoint, storage)?),
            Box::new(material(&fitted.truncated, storage)?),
        ];
        let shown = answerers.iter().map(|a| fitted.pictures.of(&**a)).collect::<Result<Vec<_>>>()?;
        let mut rows = Vec::new();
        for (k, truth) in fitted.pictures.truths().enumerate() {
            let images: Vec<&RgbImage> = std::iter::once(truth).chain(shown.iter().map(|s| &s[k])).collect();
            let row = images.iter().map(|image| picture::srgb(image, stops)).collect::<Result<Vec<_>>>()?;
            let mut differences = vec![row[0].clone()];
            for image in &images[1..] {
                differences.push(picture::difference(image, truth, WORST)?);
            }
            let sheet = picture::sheet(&[row.clone(), differences])?;
            write_whole(&folder.join(format!("picture-{k:04}.png")), &picture::png(&sheet)?)?;
            rows.push(row);
        }
        let sheet = picture::png(&picture::sheet(&rows)?)?;
        write_whole(&folder.join("all.png"), &sheet)?;
        fitted.truncated.write(&self.root.join("truncated.safetensors"))?;
        fitted.checkpoint.write(&self.root.join("best.safetensors"))?;
        let html = page::html(&fitted.outcome, &sheet)?;
        write_whole(&self.root.join("report.html"), html.as_bytes())?;
        Ok(write_json(&self.root.join("fit.json"), &fitted.outcome)?)
    }
}

/// The first field in which two objects differ.
fn differing(a: &Value, b: &Value) -> Option<String> {
    let fields = b.as_object()?.iter();
    fields.filter(|(name, value)| a.get(name) != Some(value)).map(|(name, _)| name.clone()).next()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn fits_of_other_settings_are_kept_until_they_are_forced_away() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().join("fit");
        let (a, b) = (json!({"seed": 1, "target": "flip=full"}), json!({"seed": 2, "target": "flip=full"}));
        Folder::open(&root, &a, false).unwrap();
        std::fs::create_dir(root.join("data")).unwrap();
        Folder::open(&root, &a, false).unwrap();
        assert!(root.join("data").exists());
        let problem = Folder::open(&root, &b, false).unwrap_err().to_string();
        assert!(problem.contains("another seed") && problem.contains("--force"), "{problem}");
        Folder::open(&root, &b, true).unwrap();
        assert!(!root.join("data").exists());
        std::fs::write(root.join("notes.txt"), "mine").unwrap();
        let problem = Folder::open(&root, &a, true).unwrap_err().to_string();
        assert!(problem.contains("notes.txt"), "{problem}");
    }
}
