//! Errors of the renderer, split by who must act, as in the encoder.

pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Texts are one line: what, where, what was expected, what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    #[error(transparent)]
    Scene(#[from] planecast_encoder::Error),
    /// The caller asked for something that cannot be drawn.
    #[error("{0}")]
    Argument(String),
    /// A size is beyond what the program or the device allows.
    #[error("{0}")]
    Limit(String),
    /// The driver or the adapter.
    #[error("{0}")]
    Device(String),
}
