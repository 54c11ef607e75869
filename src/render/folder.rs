//! A folder of frames, which can be left and gone on with.
//!
//! | file | what |
//! | --- | --- |
//! | `frame-NNNN.exr` | linear radiance, with the identity of its scene |
//! | `frame-NNNN.png` | the same as it is shown |
//! | `frame-NNNN-reference.exr`, `.png` | the reference surface in place of the model |
//! | `frame-NNNN-compare.png` | model, reference, difference |
//! | `sheet.png`, `animation.png` | all frames of a path |

use super::frame_file::{self, Label};
use crate::error::{Error, Result};
use std::path::{Path, PathBuf};

const SHEET: &str = "sheet.png";
const ANIMATION: &str = "animation.png";

/// The folder.
#[derive(Clone, Debug)]
pub struct Folder {
    root: PathBuf,
}

impl Folder {
    /// Opens or makes the folder. With `force`, frames of other scenes are removed from it, and no other files.
    ///
    /// # Errors
    /// `File` if it cannot be made, is a file, or holds frames of other scenes than `identities`.
    pub fn open(root: &Path, identities: &[&str], force: bool) -> Result<Self> {
        let failed = |e: std::io::Error| Error::file(root, format!("cannot be made or read: {e}"));
        std::fs::create_dir_all(root).map_err(failed)?;
        let mut stale = Vec::new();
        for entry in std::fs::read_dir(root).map_err(failed)?.flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            let known = || {
                let label = frame_file::label(&root.join(&name));
                label.is_some_and(|label| identities.contains(&label.identity.as_str()))
            };
            if is_frame(&name) && name.ends_with(".exr") && !known() {
                stale.push(name);
            }
        }
        stale.sort();
        if let (Some(name), false) = (stale.first(), force) {
            let problem = format!(
                "holds {name} of another scene, seed or material; choose another --out, or replace its frames with --force"
            );
            return Err(Error::file(root, problem));
        }
        let this = Self { root: root.to_path_buf() };
        if !stale.is_empty() {
            this.clear()?;
        }
        Ok(this)
    }

    fn clear(&self) -> Result<()> {
        let failed = |e: std::io::Error| Error::file(&self.root, format!("cannot be cleared: {e}"));
        for entry in std::fs::read_dir(&self.root).map_err(failed)?.flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            if is_frame(&name) || [SHEET, ANIMATION].contains(&name.as_str()) {
                std::fs::remove_file(entry.path()).map_err(failed)?;
            }
        }
        Ok(())
    }

    /// The path of a frame's file: `kind` is empty, `-reference` or `-compare`.
    pub fn path(&self, frame: usize, kind: &str, extension: &str) -> PathBuf {
        self.root.join(format!("frame-{frame:04}{kind}.{extension}"))
    }

    /// The path of the contact sheet.
    pub fn sheet(&self) -> PathBuf {
        self.root.join(SHEET)
    }

    /// The path of the animation.
    pub fn animation(&self) -> PathBuf {
        self.root.join(ANIMATION)
    }

    /// The label of a frame that is finished.
    pub fn finished(&self, frame: usize, kind: &str, identity: &str) -> Option<Label> {
        let path = self.path(frame, kind, "exr");
        frame_file::label(&path).filter(|label| label.identity == identity)
    }
}

/// True for names of frames.
fn is_frame(name: &str) -> bool {
    let Some(rest) = name.strip_prefix("frame-") else { return false };
    let digits = rest.bytes().take_while(u8::is_ascii_digit).count();
    let endings = [".exr", ".png", "-reference.exr", "-reference.png", "-compare.png"];
    digits >= 4 && endings.contains(&&rest[digits..])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::query::RgbImage;

    #[test]
    fn frames_of_other_scenes_are_kept_until_they_are_forced_away() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().join("out");
        let opened = Folder::open(&root, &["a"], false).unwrap();
        let image = RgbImage { height: 1, width: 1, pixels: vec![[1.0; 3]] };
        let label = Label { identity: "a".into(), variance: None };
        frame_file::write(&opened.path(3, "", "exr"), &image, false, &label).unwrap();
        std::fs::write(root.join("notes.txt"), "mine").unwrap();
        std::fs::write(root.join("frame-mine.png"), "mine").unwrap();
        assert!(opened.finished(3, "", "a").is_some() && opened.finished(3, "", "b").is_none());
        assert!(opened.finished(2, "", "a").is_none());
        Folder::open(&root, &["b", "a"], false).unwrap();
        let problem = Folder::open(&root, &["b"], false).unwrap_err().to_string();
        assert!(problem.contains("frame-0003.exr") && problem.contains("--force"), "{problem}");
        Folder::open(&root, &["b"], true).unwrap();
        assert!(!root.join("frame-0003.exr").exists());
        assert!(root.join("notes.txt").exists() && root.join("frame-mine.png").exists());
    }
}
