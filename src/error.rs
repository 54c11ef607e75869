//! One error type; its variants are chosen by what the caller can do.

use std::path::{Path, PathBuf};

/// Everything that can go wrong.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A flag or argument is missing, contradictory or out of range: change the call.
    #[error("{0}")]
    Usage(String),
    /// A configuration field has a value that cannot work: change the field.
    #[error("{field}: {problem}")]
    Config {
        /// Dotted name of the field.
        field: String,
        /// What is wrong and what to do.
        problem: String,
    },
    /// The named file cannot be read or written, or is not what it should be: mend the file.
    #[error("{}: {problem}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong and what to do.
        problem: String,
    },
    /// Training left the finite numbers; the last good checkpoint is kept.
    #[error("{0}")]
    Diverged(String),
    /// The user stopped the work; what was finished is on disk.
    #[error("interrupted: {0}")]
    Interrupted(String),
    /// The tensor library refused an operation.
    #[error("tensor operation failed: {0}")]
    Tensor(#[from] candle_core::Error),
}

/// Result with [`Error`].
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

    /// An error about the call.
    pub fn usage(problem: impl std::fmt::Display) -> Self {
        Self::Usage(problem.to_string())
    }

    /// The process's exit code: 2 for misuse, 130 after an interrupt, 1 otherwise.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Usage(_) | Self::Config { .. } => 2,
            Self::Interrupted(_) => 130,
            _ => 1,
        }
    }
}

impl From<neumip_export::Error> for Error {
    fn from(error: neumip_export::Error) -> Self {
        match error {
            neumip_export::Error::File { path, problem } => Self::File { path, problem },
            neumip_export::Error::Config { field, problem } => Self::Config { field, problem },
        }
    }
}
