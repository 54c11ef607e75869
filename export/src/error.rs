//! What can go wrong with a file or a configuration, divided by what the caller can do about it.

use std::path::{Path, PathBuf};

/// Errors of the checkpoint format and the exporters.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The named file cannot be read or written, or is not what it should be.
    #[error("{}: {problem}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong and what to do.
        problem: String,
    },
    /// The named configuration field has a value that cannot work.
    #[error("{field}: {problem}")]
    Config {
        /// Dotted name of the field.
        field: String,
        /// What is wrong and what to do.
        problem: String,
    },
}

/// Result of the checkpoint format and the exporters.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// An error about a file.
    pub fn file(path: impl AsRef<Path>, problem: impl std::fmt::Display) -> Self {
        Self::File { path: path.as_ref().to_path_buf(), problem: problem.to_string() }
    }

    /// An error about a configuration field.
    pub fn config(field: impl Into<String>, problem: impl std::fmt::Display) -> Self {
        Self::Config { field: field.into(), problem: problem.to_string() }
    }
}
