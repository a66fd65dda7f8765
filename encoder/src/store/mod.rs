//! Bytes and where they lie: mapped files, files without a name, files on their way to their name, object storage. Not here:
//! what the bytes mean.

pub mod guard;
#[cfg(not(target_arch = "wasm32"))]
pub mod passing;
pub mod ranges;
#[cfg(not(target_arch = "wasm32"))]
pub mod remote;
pub(crate) mod scratch;

use std::path::Path;

const SCHEMES: [&str; 11] = ["s3", "s3a", "gs", "az", "adl", "azure", "abfs", "abfss", "http", "https", "file"];

/// Whether a name is the URL of an object.
pub fn is_url(path: &Path) -> bool {
    let scheme = path.to_str().and_then(|text| text.split_once("://"));
    scheme.is_some_and(|(scheme, _)| SCHEMES.contains(&scheme))
}
