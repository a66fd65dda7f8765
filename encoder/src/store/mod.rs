//! Bytes and where they lie: mapped files, files without a name, files on their way to their name, object storage. Not here:
//! what the bytes mean.

pub mod guard;
#[cfg(not(target_arch = "wasm32"))]
pub mod passing;
pub mod ranges;
#[cfg(not(target_arch = "wasm32"))]
pub mod remote;
pub(crate) mod scratch;

use std::path::{Path, PathBuf};

const SCHEMES: [&str; 11] = ["s3", "s3a", "gs", "az", "adl", "azure", "abfs", "abfss", "http", "https", "file"];

/// Whether a name is the URL of an object.
pub fn is_url(path: &Path) -> bool {
    let scheme = path.to_str().and_then(|text| text.split_once("://"));
    scheme.is_some_and(|(scheme, _)| SCHEMES.contains(&scheme))
}

/// A name as it may be told: of a URL without its query, which may be secret. A page knows files by URLs alone.
pub fn shown(name: &Path) -> PathBuf {
    if !is_url(name) && cfg!(not(target_arch = "wasm32")) {
        return name.to_owned();
    }
    let text = name.to_string_lossy();
    PathBuf::from(text.split(['?', '#']).next().unwrap_or_default())
}
