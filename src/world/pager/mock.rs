//! Tiles of a scene in memory, which fail where a test says so.

use std::collections::HashMap;
use std::io::Cursor;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

use planecast_encoder::format::write::write_scene_to;
use planecast_encoder::{ColorMode, Columns, Encoding, Error, Level, PcastFile, Scene, TileKey, TileSource};

/// What is wrong with a tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// It cannot be had.
    Out,
    /// Its source panics.
    Panics,
    /// It has a column less along x than it should.
    Small,
}

/// Which tiles have a fault.
type Faults = Box<dyn Fn(TileKey) -> Option<Fault> + Send>;

const NAME: &str = "mock.pcast";

/// A scene as a file has it.
pub fn bytes_of(scene: &Scene) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    write_scene_to(scene, &mut bytes, Path::new(NAME)).unwrap();
    bytes.into_inner()
}

pub struct Mock {
    file: PcastFile,
    /// Whether it says that it is a height field.
    heights: bool,
    /// Whether it does not say of this tile that it is empty, though it is.
    hides: fn(TileKey) -> bool,
    faults: Mutex<Faults>,
    /// How often it was asked for tiles, in all and for each.
    asked: AtomicUsize,
    of: Mutex<HashMap<TileKey, u32>>,
}

impl Mock {
    pub fn new(scene: &Scene, heights: bool) -> Arc<Mock> {
        Mock::that_hides(scene, heights, |_| false)
    }

    pub fn that_hides(scene: &Scene, heights: bool, hides: fn(TileKey) -> bool) -> Arc<Mock> {
        Mock::of_bytes(bytes_of(scene), heights, hides)
    }

    /// Of a scene that is written already.
    pub fn of_bytes(bytes: Vec<u8>, heights: bool, hides: fn(TileKey) -> bool) -> Arc<Mock> {
        let file = PcastFile::from_bytes(NAME, bytes).unwrap();
        let faults: Faults = Box::new(|_| None);
        let (asked, of) = Default::default();
        Arc::new(Mock { file, heights, hides, faults: Mutex::new(faults), asked, of })
    }

    pub fn set(&self, faults: impl Fn(TileKey) -> Option<Fault> + Send + 'static) {
        *self.faults.lock().unwrap() = Box::new(faults);
    }

    pub fn fault(&self, key: TileKey) -> Option<Fault> {
        self.faults.lock().unwrap()(key)
    }

    pub fn asked(&self) -> usize {
        self.asked.load(Ordering::Relaxed)
    }

    pub fn asked_for(&self, key: TileKey) -> u32 {
        self.of.lock().unwrap().get(&key).copied().unwrap_or(0)
    }
}

impl TileSource for Mock {
    fn name(&self) -> String {
        "mock".into()
    }

    fn dims(&self) -> [u32; 3] {
        self.file.dims()
    }

    fn encoding(&self) -> Encoding {
        TileSource::encoding(&self.file)
    }

    fn color(&self) -> ColorMode {
        TileSource::color(&self.file)
    }

    fn heights(&self, level: u32) -> [u32; 2] {
        self.file.heights(level)
    }

    fn is_height_field(&self) -> bool {
        self.heights
    }

    fn is_empty(&self, key: TileKey) -> bool {
        self.file.is_empty(key) && !(self.hides)(key)
    }

    fn tile(&self, key: TileKey) -> planecast_encoder::Result<Level> {
        self.asked.fetch_add(1, Ordering::Relaxed);
        *self.of.lock().unwrap().entry(key).or_default() += 1;
        match self.fault(key) {
            None => TileSource::tile(&self.file, key),
            Some(Fault::Out) => Err(Error::Limit(format!("tile ({}, {}) of level {} is out", key.x, key.z, key.level))),
            // Without the message that a panic prints.
            Some(Fault::Panics) => std::panic::resume_unwind(Box::new("a fault of the source")),
            Some(Fault::Small) => {
                let level = TileSource::tile(&self.file, key)?;
                let crop = |columns: &Columns| columns.crop(0..columns.nx() - 1, 0..columns.nz());
                Ok(Level { solid: crop(&level.solid), exposed: level.exposed.as_ref().map(crop), ..level })
            }
        }
    }
}
