//! Inputs, parts and scenes on object storage: `s3://`, `gs://`, `az://`, `https://`, and `file://`, with the feature
//! `object-store`.
//!
//! A plain `http://` or `https://` address is read by GET alone, in ranges where the server has them, with its query, so that
//! signed addresses work; HEAD and PROPFIND are asked for only by what lists a folder or writes. Without encryption nothing
//! but the address is needed either.
//!
//! | what | how |
//! |---|---|
//! | raw and NPY volumes | in ranges, as they are needed |
//! | other inputs, folders (all below a prefix), parts to merge | fetched to temporary files |
//! | parts and scenes to write | made in a temporary folder, and put under their name when they are whole |
//!
//! Stores show an object when its upload is complete: there is no half one. Places and credentials come from the environment
//! variables that the stores' own tools read (`AWS_ACCESS_KEY_ID`, `AWS_ENDPOINT`, `GOOGLE_SERVICE_ACCOUNT`,
//! `AZURE_STORAGE_ACCOUNT_NAME`, …).

#[cfg(feature = "object-store")]
mod http;
#[cfg(feature = "object-store")]
mod object;

use std::path::{Path, PathBuf};

#[cfg(feature = "object-store")]
pub(crate) use object::Object;

#[cfg(not(feature = "object-store"))]
use crate::Error;
use crate::Result;
use crate::model::pieces::Pieces;
use crate::source::ReadOptions;
use crate::store::ranges::Ranges;

pub use crate::store::is_url;

#[cfg(not(feature = "object-store"))]
fn without<T>(url: &Path) -> Result<T> {
    let url = url.display();
    Err(Error::Argument(format!(
        "{url}: this planecast reaches no object storage; build it with --features object-store"
    )))
}

/// The object at `url`, or all below it, as a world.
#[cfg(feature = "object-store")]
pub(crate) fn open_pieces(url: &Path, opts: &ReadOptions) -> Result<Box<dyn Pieces>> {
    object::open_pieces(url, opts)
}

#[cfg(not(feature = "object-store"))]
pub(crate) fn open_pieces(url: &Path, _: &ReadOptions) -> Result<Box<dyn Pieces>> {
    without(url)
}

/// The scene at `url`; None where `is_scene` says of its name and first bytes that it is none. It is fetched whole, into a file
/// without a name.
#[cfg(feature = "object-store")]
pub(crate) fn scene(url: &Path, is_scene: fn(&Path, &[u8]) -> bool) -> Result<Option<crate::PcastFile>> {
    object::scene(url, is_scene)
}

#[cfg(not(feature = "object-store"))]
pub(crate) fn scene(url: &Path, _: fn(&Path, &[u8]) -> bool) -> Result<Option<crate::PcastFile>> {
    without(url)
}

/// The ranges of the scene at `url`; None where `is_scene` says of its name and first bytes that it is none.
#[cfg(feature = "object-store")]
pub(crate) fn ranges(url: &Path, is_scene: fn(&Path, &[u8]) -> bool) -> Result<Option<Box<dyn Ranges>>> {
    object::ranges(url, is_scene)
}

#[cfg(not(feature = "object-store"))]
pub(crate) fn ranges(url: &Path, _: fn(&Path, &[u8]) -> bool) -> Result<Option<Box<dyn Ranges>>> {
    without(url)
}

/// All bytes of what is at `url`, `most` at most.
#[cfg(feature = "object-store")]
pub(crate) fn text(url: &Path, most: u64) -> Result<Vec<u8>> {
    object::text(url, most)
}

#[cfg(not(feature = "object-store"))]
pub(crate) fn text(url: &Path, _: u64) -> Result<Vec<u8>> {
    without(url)
}

/// What tells one state of an object from another: its size, time and tag.
#[cfg(feature = "object-store")]
pub fn state(url: &Path) -> Result<String> {
    Ok(Object::open(url)?.map(|object| object.state().to_owned()).unwrap_or_default())
}

#[cfg(not(feature = "object-store"))]
pub fn state(url: &Path) -> Result<String> {
    without(url)
}

/// Files that are here: as they were named, or fetched from object storage for as long as this lives.
#[derive(Debug)]
pub struct Here {
    pub files: Vec<PathBuf>,
    _fetched: Vec<tempfile::TempDir>,
}

impl Here {
    /// Brings what is named by a URL here; a URL that ends with a slash stands for all objects below it.
    pub fn bring(names: &[PathBuf]) -> Result<Here> {
        let mut here = Here { files: Vec::new(), _fetched: Vec::new() };
        for name in names {
            match is_url(name) {
                false => here.files.push(name.clone()),
                #[cfg(feature = "object-store")]
                true => {
                    let (files, folder) = object::fetch(name)?;
                    here.files.extend(files);
                    here._fetched.push(folder);
                }
                #[cfg(not(feature = "object-store"))]
                true => without(name)?,
            }
        }
        Ok(here)
    }
}

/// Where a file is made: under its own name, or in a temporary folder to be put on object storage.
pub struct Output {
    file: PathBuf,
    #[cfg(feature = "object-store")]
    upload: Option<object::Upload>,
}

impl Output {
    pub fn new(name: &Path) -> Result<Output> {
        #[cfg(feature = "object-store")]
        if is_url(name) {
            let upload = object::Upload::new(name)?;
            return Ok(Output { file: upload.file().to_owned(), upload: Some(upload) });
        }
        #[cfg(not(feature = "object-store"))]
        if is_url(name) {
            return without(name);
        }
        Ok(Output {
            file: name.to_owned(),
            #[cfg(feature = "object-store")]
            upload: None,
        })
    }

    /// The file to write.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// Puts the file where it belongs, after it was written whole.
    pub fn finish(self) -> Result<()> {
        #[cfg(feature = "object-store")]
        if let Some(upload) = self.upload {
            return upload.finish();
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn remote_names_are_told_from_paths() {
        for url in ["s3://bucket/a.raw", "gs://b/c", "az://b/c", "file:///tmp/a", "https://example.org/a.npy"] {
            assert!(is_url(Path::new(url)), "{url}");
        }
        for path in ["a.raw", "/s3/a", "C:\\a.raw", "procedural:hills?size=4", "s3:/a", "zip://a/b"] {
            assert!(!is_url(Path::new(path)), "{path}");
        }
    }

    #[cfg(not(feature = "object-store"))]
    #[test]
    fn remote_names_without_the_feature_say_which_it_is() {
        let url = Path::new("s3://bucket/a.raw");
        for text in [
            open_pieces(url, &ReadOptions::default()).err().unwrap().to_string(),
            Here::bring(&[url.to_owned()]).unwrap_err().to_string(),
            Output::new(url).err().unwrap().to_string(),
        ] {
            assert!(text.contains("build it with --features object-store"), "{text}");
        }
    }
}
