//! Whatever a command is given, as a scene: a scene file as it lies there or on a server; any other input encoded, into a file
//! without a name that lives as long as it is open.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use crate::encode::{self, EncodeOptions, Watch};
use crate::model::pieces::{Pieces, named};
use crate::source::{self, ReadOptions};
use crate::store::{remote, shown};
use crate::{Error, PcastFile, Result, format};

/// How an input is read, and what was left out, for a person to be told before it is encoded.
pub type Tell<'a> = &'a mut dyn FnMut(&dyn Pieces);

/// A scene at hand.
pub struct Opened {
    pub file: PcastFile,
    /// Whether it was an input that had to be encoded.
    pub encoded: bool,
}

/// Whether a name leads to something that can be opened, as far as the name and a look at the folder tell.
pub fn is_there(name: &Path) -> bool {
    is_procedural(name) || remote::is_url(name) || name.exists()
}

pub fn is_procedural(name: &Path) -> bool {
    name.to_str().is_some_and(|name| name.starts_with("procedural:"))
}

/// What calls itself a scene is told what is wrong with it as one.
pub(crate) fn is_scene(name: &Path, head: &[u8]) -> bool {
    head.starts_with(&format::MAGIC) || name.extension().is_some_and(|e| e.eq_ignore_ascii_case("pcast"))
}

/// Opens a scene, here or at a URL; other inputs are refused.
pub fn scene(name: &Path) -> Result<PcastFile> {
    if !remote::is_url(name) {
        return PcastFile::open(name);
    }
    remote::scene(name, is_scene)?.ok_or_else(|| {
        let what = "this is no scene, which is what this command takes; make one with encode";
        Error::format(shown(name), what)
    })
}

/// Opens a scene, or encodes an input as `encode` would. `watch` tells how far that is, and stops it.
///
/// Errors are those of [`PcastFile::open`], of the reader, and of the network.
pub fn open(name: &Path, read: &ReadOptions, watch: &Watch, tell: Tell<'_>) -> Result<Opened> {
    if remote::is_url(name) {
        if let Some(file) = remote::scene(name, is_scene)? {
            return Ok(Opened { file, encoded: false });
        }
    } else if !is_procedural(name) && !name.is_dir() {
        let mut head = Vec::new();
        let file = File::open(name).map_err(|e| Error::io(name, "open", e))?;
        file.take(16).read_to_end(&mut head).map_err(|e| Error::io(name, "read", e))?;
        if is_scene(name, &head) {
            return Ok(Opened { file: PcastFile::open(name)?, encoded: false });
        }
    }
    let world = source::open_pieces(name, read)?;
    tell(&*world);
    let world = named(world, name);
    let file = encode::encode_unnamed(&*world, &EncodeOptions::default(), name, watch)?;
    Ok(Opened { file, encoded: true })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::inspect::info::content_hash;

    #[test]
    fn open_takes_a_scene_as_it_is_and_anything_else_as_encode_would() {
        let dir = tempfile::tempdir().unwrap();
        let name = Path::new("procedural:rocks?size=64&seed=3");
        let mut told = 0;
        let direct = open(name, &ReadOptions::default(), &Watch::default(), &mut |_| told += 1).unwrap();
        assert!(direct.encoded && told == 1);
        let file = dir.path().join("rocks.pcast");
        let world = source::open_pieces(name, &ReadOptions::default()).unwrap();
        encode::encode(&*world, &EncodeOptions::default(), &file, &Watch::default()).unwrap();
        let read = open(&file, &ReadOptions::default(), &Watch::default(), &mut |_| told += 1).unwrap();
        assert!(!read.encoded && told == 1);
        assert_eq!(content_hash(&read.file), content_hash(&direct.file));
        assert_eq!(read.file.read_scene().unwrap(), direct.file.read_scene().unwrap());
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
    }

    #[test]
    fn open_of_what_is_not_there_or_no_scene_says_so() {
        let dir = tempfile::tempdir().unwrap();
        let open = |name: &Path| {
            open(name, &ReadOptions::default(), &Watch::default(), &mut |_| {}).err().unwrap().to_string()
        };
        assert!(open(&dir.path().join("none.tif")).contains("none.tif: cannot open"));
        let scene = dir.path().join("bad.pcast");
        std::fs::write(&scene, [7; 100]).unwrap();
        assert!(open(&scene).contains("not a .pcast scene"));
    }
}
