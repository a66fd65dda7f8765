//! Errors, split by who must act.

use std::path::PathBuf;

pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Texts are one line, lower case, subject first: what, where, what was expected, what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The file is not what it should be. `what` names the place (byte offset, tile, column) and what was expected.
    #[error("{path}: {what}", path = path.display())]
    Format { path: PathBuf, what: String },
    /// The caller asked for something that does not fit the input.
    #[error("{0}")]
    Argument(String),
    /// A size is beyond what the program or the machine allows.
    #[error("{0}")]
    Limit(String),
    /// Somebody stopped the work; what is done can be gone on with.
    #[error("interrupted; the same command with --resume goes on")]
    Interrupted,
    /// The operating system refused.
    #[error("{path}: cannot {action}: {source}", path = path.display())]
    Io {
        path: PathBuf,
        /// "open", "read", "write", …
        action: &'static str,
        source: std::io::Error,
    },
}

impl Error {
    pub fn format(path: impl Into<PathBuf>, what: impl Into<String>) -> Error {
        Error::Format { path: path.into(), what: what.into() }
    }

    pub fn io(path: impl Into<PathBuf>, action: &'static str, source: std::io::Error) -> Error {
        Error::Io { path: path.into(), action, source }
    }
}
