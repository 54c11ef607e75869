//! Files and folders that appear whole or not at all: written beside their place, synced, then renamed.

use crate::error::{Error, Result};
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

/// How the names of temporary siblings start; a killed program can leave one behind.
pub const PART: &str = ".neumip-";

/// Writes `bytes` to `path`; a reader sees the old file or the new one, never a part.
///
/// # Errors
/// `File`, naming the path.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<()> {
    let parent = parent_of(path);
    let failed = |e: std::io::Error| Error::file(path, format!("cannot be written: {e}"));
    let mut file = builder(0o666).tempfile_in(&parent).map_err(|e| failed(plain(&e)))?;
    file.write_all(bytes).map_err(failed)?;
    file.as_file().sync_all().map_err(failed)?;
    file.persist(path).map_err(|e| failed(e.error))?;
    sync_folder(&parent);
    Ok(())
}

/// Writes `value` to `path` as indented JSON, whole.
///
/// # Errors
/// `File`, naming the path.
pub fn write_json(path: &Path, value: &impl serde::Serialize) -> Result<()> {
    let text = serde_json::to_string_pretty(value).map_err(|e| Error::file(path, e))?;
    write_whole(path, format!("{text}\n").as_bytes())
}

/// A new folder beside `path`, removed when dropped unless it was renamed to its place.
pub(crate) fn sibling_folder(path: &Path) -> Result<tempfile::TempDir> {
    builder(0o777)
        .tempdir_in(parent_of(path))
        .map_err(|e| Error::file(path, format!("cannot be written: {}", plain(&e))))
}

/// The error without the random temporary name, which would say nothing to the reader.
fn plain(error: &std::io::Error) -> std::io::Error {
    std::io::Error::from(error.kind())
}

/// The folder that holds `path`.
pub(crate) fn parent_of(path: &Path) -> PathBuf {
    match path.parent() {
        Some(parent) if parent.as_os_str().is_empty() => PathBuf::from("."),
        Some(parent) => parent.to_path_buf(),
        None => path.to_path_buf(),
    }
}

/// Makes a rename durable where the system can; elsewhere the data is safe all the same.
pub(crate) fn sync_folder(folder: &Path) {
    if let Ok(handle) = File::open(folder) {
        let _ = handle.sync_all();
    }
}

/// Temporary names of ours, with the permissions that an ordinary new file or folder gets under the user's
/// umask.
fn builder(mode: u32) -> tempfile::Builder<'static, 'static> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(PART);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(std::fs::Permissions::from_mode(mode));
    }
    #[cfg(not(unix))]
    let _ = mode;
    builder
}
