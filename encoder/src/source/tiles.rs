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
/// | `NAME.pworld`, here or at a URL | of the sheets that it names: see [`sheets`](crate::format::sheets) |
/// | a Zarr folder, with `--iso` and cubes for voxels (feature `zarr`) | read by chunks and thresholded; its resolutions are levels |
/// | `procedural:NAME?size=inf&seed=N`, `procedural:menger?size=3^19` | made: see [`producer`] |
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
    use crate::format::sheets::{MOST_TEXT, Manifest, Sheets, is_manifest};
    use crate::store::ranges::Here;
    use crate::store::{remote, shown};

    /// The world of a manifest; its sheets are opened when they are wanted.
    fn sheets(name: &Path, opts: &ReadOptions) -> Result<Sheets> {
        let text = if remote::is_url(name) {
            remote::text(name, MOST_TEXT)?
        } else {
            let meta = std::fs::metadata(name).map_err(|e| Error::io(name, "open", e))?;
            if meta.len() > MOST_TEXT {
                return Err(Error::format(name, format!("{} bytes, at most {MOST_TEXT} were expected", meta.len())));
            }
            std::fs::read(name).map_err(|e| Error::io(name, "read", e))?
        };
        let name = shown(name);
        // Colours by height are the world's, not each sheet's.
        let opts = ReadOptions { ramp: None, ..opts.clone() };
        let manifest = Manifest::parse(&name, &text)?;
        let open = move |file: &Path| {
            super::open(file, &opts)?.ok_or_else(|| Error::format(shown(file), "no scene, as sheets of a world are"))
        };
        Sheets::new(&name, manifest, Box::new(open))
    }

    pub fn open(name: &Path, opts: &ReadOptions) -> Result<Option<Arc<dyn TileSource>>> {
        if is_manifest(name) {
            return sheets(name, opts).map(|sheets| Some(Arc::new(sheets) as Arc<dyn TileSource>));
        }
        if remote::is_url(name) {
            let Some(ranges) = remote::ranges(name, is_scene)? else { return Ok(None) };
            return Ok(Some(Arc::new(RangedFile::open(ranges)?)));
        }
        if name.is_dir() {
            #[cfg(feature = "zarr")]
            if ["zarr.json", ".zarray", ".zgroup"].iter().any(|file| name.join(file).exists()) {
                let found = crate::source::zarr::lazy::ZarrTiles::open(name, opts)?;
                return Ok(found.map(|zarr| Arc::new(zarr) as Arc<dyn TileSource>));
            }
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

#[cfg(all(test, not(target_arch = "wasm32")))]
mod tests {
    use super::*;
    use crate::encode::{self, EncodeOptions, Watch};
    use crate::model::tiles::TileKey;
    use crate::{Error, PcastFile, source};

    fn found(name: &Path) -> Option<Arc<dyn TileSource>> {
        open(name, &ReadOptions::default()).unwrap()
    }

    #[test]
    fn tiles_are_found_for_what_gives_them_and_not_for_what_must_be_encoded() {
        let dir = tempfile::tempdir().unwrap();
        let scene = dir.path().join("a.pcast");
        let pieces =
            source::open_pieces(Path::new("procedural:hills?size=256&seed=1"), &ReadOptions::default()).unwrap();
        encode::encode(&*pieces, &EncodeOptions::default(), &scene, &Watch::default()).unwrap();
        let whole = PcastFile::open(&scene).unwrap();
        let key = TileKey { level: 1, x: 0, z: 0 };
        assert!(found(&scene).unwrap().tile(key).unwrap() == TileSource::tile(&whole, key).unwrap());

        let world = dir.path().join("w.pworld");
        crate::cli::WorldArgs {
            sheets: vec!["a.pcast".into()],
            output: world.clone(),
            across: None,
            repeat: Some([4, 2]),
        }
        .run_in(dir.path())
        .unwrap();
        let sheets = found(&world).unwrap();
        assert_eq!(sheets.dims(), [1024, 128, 512]);
        assert!(sheets.tile(TileKey { level: 0, x: 3, z: 1 }).unwrap() == whole.tile(0, 0, 0).unwrap());

        assert_eq!(found(Path::new("procedural:hills?size=inf")).unwrap().dims(), [1 << 30, 1024, 1 << 30]);
        assert_eq!(found(Path::new("procedural:menger?size=3^19")).unwrap().dims()[0], 1_162_261_467);
        assert!(found(Path::new("procedural:hills?size=64")).is_none());
        let png = dir.path().join("a.png");
        std::fs::write(&png, b"\x89PNG\r\n\x1a\n").unwrap();
        assert!(found(&png).is_none() && found(dir.path()).is_none());
        let none = open(&dir.path().join("none.pcast"), &ReadOptions::default()).err().unwrap();
        assert!(matches!(none, Error::Io { .. }) && none.to_string().contains("none.pcast: cannot open"), "{none}");
    }
}
