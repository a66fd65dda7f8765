//! Inputs that are asked for tile by tile, without being read or encoded as a whole first.

use std::path::Path;
use std::sync::Arc;

use crate::model::tiles::TileSource;
use crate::source::ReadOptions;
use crate::{Result, producer};

/// What gives tiles of the world at `name`; None where it is an input that must be encoded first.
///
/// | name | tiles |
/// |---|---|
/// | a scene file | read at their places; no map, so that memory holds what was read last alone |
/// | a URL of one | by ranges of bytes, neighbours together (feature `object-store`) |
/// | `procedural:NAME?size=inf&seed=N` | made: see [`producer`] |
///
/// # Errors
/// What is wrong with it, as far as opening shows.
pub fn open(name: &Path, opts: &ReadOptions) -> Result<Option<Arc<dyn TileSource>>> {
    if let Some(name) = name.to_str().and_then(|name| name.strip_prefix("procedural:")) {
        return producer::from_name(name);
    }
    #[cfg(not(target_arch = "wasm32"))]
    {
        files::open(name, opts)
    }
    #[cfg(target_arch = "wasm32")]
    {
        let _ = opts;
        Ok(None)
    }
}

#[cfg(not(target_arch = "wasm32"))]
mod files {
    use std::fs::File;
    use std::io::Read;

    use super::*;
    use crate::Error;
    use crate::encode::open::is_scene;
    use crate::format::ranged::RangedFile;
    use crate::store::ranges::Here;
    use crate::store::remote;

    pub fn open(name: &Path, opts: &ReadOptions) -> Result<Option<Arc<dyn TileSource>>> {
        let _ = opts;
        if remote::is_url(name) {
            let Some(ranges) = remote::ranges(name, is_scene)? else { return Ok(None) };
            return Ok(Some(Arc::new(RangedFile::open(ranges)?)));
        }
        if name.is_dir() {
            return Ok(None);
        }
        let mut head = Vec::new();
        let file = File::open(name).map_err(|e| Error::io(name, "open", e))?;
        file.take(16).read_to_end(&mut head).map_err(|e| Error::io(name, "read", e))?;
        if is_scene(name, &head) {
            return Ok(Some(Arc::new(RangedFile::open(Box::new(Here::open(name)?))?)));
        }
        Ok(None)
    }
}
