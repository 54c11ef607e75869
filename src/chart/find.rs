//! Where results are: every `results.json` below the folders given.

use crate::error::{Error, Result};
use crate::results::{FILE, Results};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Folders inside each other that are looked into; links are not followed, so that only a strange disk has more.
const DEEPEST: usize = 32;

/// Merges all that is found below `paths`, which are folders or files; later ones replace what earlier ones say of the
/// same cell, and inside a folder later names. Returns the files too.
///
/// # Errors
/// `File` if a path does not exist, cannot be read or holds no results, and as [`Results::read`].
pub fn gather(paths: &[PathBuf]) -> Result<(Results, Vec<PathBuf>)> {
    let mut files = Vec::new();
    for path in paths {
        if path.is_file() {
            files.push(path.clone());
            continue;
        }
        if !path.is_dir() {
            return Err(Error::file(path, "no such file or folder"));
        }
        let before = files.len();
        collect(path, 0, &mut files)?;
        if files.len() == before {
            let problem = format!("holds no {FILE}, and no folder below it does: name a folder of results");
            return Err(Error::file(path, problem));
        }
    }
    let mut merged = Results::default();
    let mut seen = BTreeSet::new();
    // A file that two of the paths lead to counts once.
    files.retain(|file| seen.insert(file.canonicalize().unwrap_or_else(|_| file.clone())));
    for file in &files {
        merged.merge(Results::read(file)?);
    }
    if merged.cells.is_empty() {
        let named: Vec<String> = files.iter().map(|f| f.display().to_string()).collect();
        return Err(Error::usage(format!("{}: no cells to draw", named.join(", "))));
    }
    Ok((merged, files))
}

fn collect(folder: &Path, depth: usize, files: &mut Vec<PathBuf>) -> Result<()> {
    let failed = |e: std::io::Error| Error::file(folder, format!("cannot be read: {e}"));
    let mut entries =
        std::fs::read_dir(folder).and_then(|all| all.collect::<std::io::Result<Vec<_>>>()).map_err(failed)?;
    // The order in which a disk names its files is not the same everywhere.
    entries.sort_by_key(std::fs::DirEntry::file_name);
    for entry in entries {
        let kind = entry.file_type().map_err(failed)?;
        let hidden = entry.file_name().to_string_lossy().starts_with('.');
        if kind.is_file() && entry.file_name() == FILE {
            files.push(entry.path());
        } else if kind.is_dir() && !hidden && depth < DEEPEST {
            collect(&entry.path(), depth + 1, files)?;
        }
    }
    Ok(())
}
