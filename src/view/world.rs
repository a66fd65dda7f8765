//! A scene as it is flown through, from a scene file or from whatever `encode` reads.

use std::path::{Path, PathBuf};

use planecast_encoder::info::{self, ByteCounts};
use planecast_encoder::source::{self, ReadOptions};
use planecast_encoder::{PcastFile, Scene};

use crate::Result;
use crate::resident::Resident;
use crate::specialize::Features;

#[cfg(not(target_arch = "wasm32"))]
use {crate::Error, planecast_encoder::encode::Watch, std::sync::Arc};

/// A scene, ready to be drawn and walked on.
pub struct World {
    /// Where it came from.
    pub path: PathBuf,
    /// Whether that was an input that had to be encoded.
    pub encoded: bool,
    pub scene: Scene,
    pub resident: Resident,
    /// As `info` has it.
    pub content_hash: String,
    /// Bytes of the scene file by section.
    pub bytes: ByteCounts,
}

/// How a file is opened.
#[derive(Clone, Debug)]
pub struct How {
    /// Of an input that has to be encoded.
    pub read: ReadOptions,
    /// Broken tiles of a scene file are empty.
    pub skip_broken: bool,
    /// What may be left out of the tables that are drawn from.
    pub specialize: Features,
}

impl Default for How {
    fn default() -> How {
        How { read: ReadOptions::default(), skip_broken: false, specialize: Features::ALL }
    }
}

/// The first bytes of a scene file.
fn is_scene(head: &[u8]) -> bool {
    head.starts_with(&planecast_encoder::format::MAGIC)
}

impl World {
    fn of_file(file: &PcastFile, path: &Path, encoded: bool, skip_broken: bool, specialize: Features) -> Result<World> {
        let info = info::info(file);
        let (scene, info) = if skip_broken {
            let (scene, _) = file.read_scene_without_broken()?;
            (scene, info.ok())
        } else {
            (file.read_scene()?, Some(info?))
        };
        let resident = Resident::with(&scene, specialize);
        let (content_hash, bytes) = info.map_or_else(Default::default, |i| (i.content_hash, i.bytes));
        Ok(World { path: path.to_owned(), encoded, scene, resident, content_hash, bytes })
    }

    /// From the bytes of a scene file or of an input; `name` is what errors call it, and its ending may tell its format.
    pub fn from_bytes(name: &Path, bytes: Vec<u8>) -> Result<World> {
        if is_scene(&bytes) || name.extension().is_some_and(|e| e.eq_ignore_ascii_case("pcast")) {
            return World::of_file(&PcastFile::from_bytes(name, bytes)?, name, false, false, Features::ALL);
        }
        let input = source::read(name, &bytes, &Default::default())?;
        World::of_input(name, input)
    }

    /// From an input as an importer gives it.
    pub fn of_input(name: &Path, input: planecast_encoder::Input) -> Result<World> {
        let scene = planecast_encoder::build(input, &Default::default())?;
        let resident = Resident::new(&scene);
        let (content_hash, bytes) = Default::default();
        Ok(World { path: name.to_owned(), encoded: true, scene, resident, content_hash, bytes })
    }

    /// Opens a scene file, or encodes an input as `encode` would, into a passing file. `watch` tells how far that is, and
    /// stops it.
    #[cfg(not(target_arch = "wasm32"))]
    pub fn open(path: &Path, how: &How, watch: &Watch) -> Result<World> {
        let opened = planecast_encoder::open::open(path, &how.read, watch, &mut |_| {})?;
        let skip_broken = how.skip_broken && !opened.encoded;
        World::of_file(&opened.file, path, opened.encoded, skip_broken, how.specialize)
    }

    /// What a window calls it.
    pub fn name(&self) -> String {
        self.path.file_name().map_or_else(|| self.path.display().to_string(), |n| n.to_string_lossy().into_owned())
    }

    /// What a command is given for it: the scene file, or one that `encode` would make.
    pub fn scene_file(&self) -> PathBuf {
        if self.encoded { PathBuf::from(self.name()).with_extension("pcast") } else { self.path.clone() }
    }
}

/// A world on its way, opened by a thread of its own.
#[cfg(not(target_arch = "wasm32"))]
pub struct Opening {
    pub path: PathBuf,
    watch: Arc<Watch>,
    answer: std::sync::mpsc::Receiver<Result<World>>,
}

#[cfg(not(target_arch = "wasm32"))]
impl Opening {
    pub fn begin(path: &Path, how: &How) -> Opening {
        let watch = Arc::new(Watch::default());
        let (send, answer) = std::sync::mpsc::channel();
        let (owned, how, watching) = (path.to_owned(), how.clone(), watch.clone());
        std::thread::spawn(move || {
            // Nobody may wait any more.
            let _ = send.send(World::open(&owned, &how, &watching));
        });
        Opening { path: path.to_owned(), watch, answer }
    }

    /// The world, or why there is none; `None` while it is on its way.
    pub fn poll(&self) -> Option<Result<World>> {
        use std::sync::mpsc::TryRecvError;
        match self.answer.try_recv() {
            Ok(world) => Some(world),
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => {
                Some(Err(Error::Limit(format!("{}: the thread that opened it has ended early", self.path.display()))))
            }
        }
    }

    /// Share of the encoding that is done, 0 to 1; 0 where nothing is encoded.
    pub fn progress(&self) -> f32 {
        use std::sync::atomic::Ordering::Relaxed;
        let (done, total) = (self.watch.columns.load(Relaxed), self.watch.total.load(Relaxed));
        if total == 0 { 0.0 } else { done as f32 / total as f32 }
    }
}

#[cfg(not(target_arch = "wasm32"))]
impl Drop for Opening {
    fn drop(&mut self) {
        self.watch.stop.store(true, std::sync::atomic::Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use planecast_encoder::encode::{self, EncodeOptions};

    use super::*;

    #[test]
    fn world_of_an_input_is_that_of_its_scene_file() {
        let dir = tempfile::tempdir().unwrap();
        let name = Path::new("procedural:rocks?size=64&seed=3");
        let direct = World::open(name, &How::default(), &Watch::default()).unwrap();
        assert!(direct.encoded && !direct.content_hash.is_empty());
        let file = dir.path().join("rocks.pcast");
        let pieces = source::open_pieces(name, &ReadOptions::default()).unwrap();
        encode::encode(&*pieces, &EncodeOptions::default(), &file, &Watch::default()).unwrap();
        let opening = Opening::begin(&file, &How::default());
        let read = loop {
            match opening.poll() {
                Some(world) => break world.unwrap(),
                None => std::thread::yield_now(),
            }
        };
        assert!(!read.encoded && read.scene == direct.scene && read.content_hash == direct.content_hash);
        let bytes = World::from_bytes(Path::new("dropped"), std::fs::read(&file).unwrap()).unwrap();
        assert_eq!(bytes.content_hash, direct.content_hash);
    }

    #[test]
    fn world_that_cannot_be_opened_says_why() {
        let open = |name: &str| World::open(Path::new(name), &How::default(), &Watch::default());
        assert!(open("/no/such/file").err().unwrap().to_string().contains("/no/such/file"));
        assert!(open("procedural:nothing").is_err());
        let other = World::from_bytes(Path::new("b.pcast"), b"garbage".to_vec());
        assert!(other.err().unwrap().to_string().starts_with("b.pcast"));
        let broken = World::from_bytes(Path::new("b.pcast"), planecast_encoder::format::MAGIC.to_vec());
        assert!(broken.err().unwrap().to_string().contains("b.pcast"));
    }
}
