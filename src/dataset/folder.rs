//! The files of a dataset folder: written whole, checked by their length.

use crate::error::{Error, Result};
use std::path::{Path, PathBuf};

/// Longest description that is read, bytes.
const MAX_DESCRIPTION: u64 = 1 << 28;

/// Writes a file that is there whole or not at all; returns its length.
pub(crate) fn write_whole(path: &Path, bytes: &[u8]) -> Result<u64> {
    neumip_export::whole_file::write_whole(path, bytes)?;
    Ok(bytes.len() as u64)
}

/// Checks that a file is there with the length that it was written with.
pub(crate) fn check_bytes(path: &Path, bytes: u64) -> Result<()> {
    let found = std::fs::metadata(path).map_err(|e| Error::file(path, format!("cannot be read: {e}")))?.len();
    if found != bytes {
        return Err(Error::file(
            path,
            format!(
                "has {found} bytes where dataset.json says {bytes}: it is damaged, generate or copy it again"
            ),
        ));
    }
    Ok(())
}

/// Reads a description.
pub(crate) fn read_json(path: &Path) -> Result<serde_json::Value> {
    let failed = |problem: &dyn std::fmt::Display| Error::file(path, problem);
    let bytes = match std::fs::metadata(path) {
        Ok(data) => data.len(),
        Err(e) => return Err(failed(&format!("cannot be read ({e}): is this a dataset folder?"))),
    };
    if bytes > MAX_DESCRIPTION {
        return Err(failed(&format!("has {bytes} bytes, more than any dataset needs")));
    }
    let text = std::fs::read(path).map_err(|e| failed(&format!("cannot be read: {e}")))?;
    serde_json::from_slice(&text).map_err(|e| failed(&format!("is not JSON: {e}")))
}

/// What is in a folder, sorted; nothing if there is no folder.
pub(crate) fn entries(folder: &Path) -> Result<Vec<PathBuf>> {
    let failed = |e: std::io::Error| Error::file(folder, format!("cannot be listed: {e}"));
    let read = match std::fs::read_dir(folder) {
        Ok(read) => read,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(e) => return Err(failed(e)),
    };
    let mut paths =
        read.map(|entry| Ok(entry?.path())).collect::<std::io::Result<Vec<_>>>().map_err(failed)?;
    paths.sort();
    Ok(paths)
}

/// Last part of a path; empty where it is no text.
pub(crate) fn name_of(path: &Path) -> &str {
    path.file_name().and_then(|name| name.to_str()).unwrap_or_default()
}

/// True for what a killed run can leave behind.
pub(crate) fn is_part(name: &str) -> bool {
    name.starts_with(neumip_export::whole_file::PART)
}

/// Removes those of the paths whose names are chosen, the one called `first` before all others.
pub(crate) fn remove(paths: &[PathBuf], first: &str, chosen: impl Fn(&str) -> bool) -> Result<()> {
    let chosen = paths.iter().filter(|path| chosen(name_of(path)));
    let (head, rest): (Vec<_>, Vec<_>) = chosen.partition(|path| name_of(path) == first);
    for path in head.into_iter().chain(rest) {
        std::fs::remove_file(path).map_err(|e| Error::file(path, format!("cannot be removed: {e}")))?;
    }
    Ok(())
}
