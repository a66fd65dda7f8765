//! Bytes and where they lie: mapped files, files without a name, files on their way to their name, object storage. Not here:
//! what the bytes mean.

pub mod guard;
#[cfg(not(target_arch = "wasm32"))]
pub mod passing;
#[cfg(not(target_arch = "wasm32"))]
pub mod ranges;
#[cfg(not(target_arch = "wasm32"))]
pub mod remote;
pub(crate) mod scratch;
