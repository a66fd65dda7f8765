//! Inputs that are asked for tile by tile, without being read or encoded as a whole first.

use std::path::Path;
use std::sync::Arc;

use crate::model::tiles::TileSource;
use crate::source::ReadOptions;
use crate::{PcastFile, Result, format, producer};

/// What gives tiles of the world at `name`: a scene file, or a world without end (`procedural:NAME?size=inf&seed=N`). None where it
/// is an input that must be encoded first.
///
/// # Errors
/// What is wrong with it, as far as opening shows.
pub fn open(name: &Path, opts: &ReadOptions) -> Result<Option<Arc<dyn TileSource>>> {
    let _ = opts;
    if let Some(name) = name.to_str().and_then(|name| name.strip_prefix("procedural:")) {
        return producer::from_name(name);
    }
    if is_scene(name) {
        return Ok(Some(Arc::new(PcastFile::open(name)?)));
    }
    Ok(None)
}

/// Whether a file calls itself a scene, by its name or its first bytes.
fn is_scene(name: &Path) -> bool {
    use std::io::Read;
    let named = name.extension().is_some_and(|e| e.eq_ignore_ascii_case("pcast"));
    let mut head = [0; format::MAGIC.len()];
    let mut read = || std::fs::File::open(name).and_then(|mut file| file.read_exact(&mut head));
    name.is_file() && (named || read().is_ok() && head == format::MAGIC)
}
