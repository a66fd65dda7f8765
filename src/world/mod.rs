//! A world that can be drawn: from a scene file, from whatever `encode` reads, or from memory. The one door to a scene; renderers
//! share it.

pub(crate) mod fetch;
pub mod matter;
pub mod pager;
pub mod parcel;
pub mod preview;
pub mod probe;
#[cfg(not(target_arch = "wasm32"))]
pub mod residency;
pub mod tables;
pub mod tint;
pub mod tree;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use planecast_encoder::encode::memory;
use planecast_encoder::inspect::info::{self, ByteCounts};
use planecast_encoder::model::about::Kind;
use planecast_encoder::model::matter::{Classes, Matter};
use planecast_encoder::source::{self, ReadOptions};
use planecast_encoder::{About, Colors, Columns, ColumnsBuilder, Input, PcastFile, Run, Scene};

use crate::frame::specialize::Features;
#[cfg(not(target_arch = "wasm32"))]
use crate::world::residency::{Held, ResidencyOptions};
use crate::world::tables::Resident;
#[cfg(not(target_arch = "wasm32"))]
use crate::world::tint::Tint;
use crate::{Error, Result};

#[cfg(not(target_arch = "wasm32"))]
use planecast_encoder::ColorMode;
#[cfg(not(target_arch = "wasm32"))]
use planecast_encoder::encode::open::Opened;
#[cfg(not(target_arch = "wasm32"))]
use planecast_encoder::encode::{EncodeOptions, Watch};
#[cfg(not(target_arch = "wasm32"))]
use planecast_encoder::model::pieces::Pieces;

/// A scene with all its levels, ready to be drawn and walked on.
pub struct World {
    /// Where it came from.
    pub path: PathBuf,
    /// Whether that was an input that had to be encoded.
    pub encoded: bool,
    /// Whether it is a height field that stands for a surface, and is best drawn as one ([`crate::Options::smooth`]).
    pub smooth: bool,
    pub scene: Arc<Scene>,
    pub resident: Arc<Resident>,
    /// As `info` has it.
    pub content_hash: String,
    /// Bytes of the scene file by section.
    pub bytes: ByteCounts,
    /// What the input is, and how it was read.
    pub about: About,
    /// Facts about the reading of an input.
    pub notes: Vec<String>,
    /// The ramp of which a scene has its colours, instead of its own.
    pub ramp: Option<String>,
}

/// How a file is opened.
#[derive(Clone, Debug)]
pub struct OpenOptions {
    /// Of an input that has to be encoded; the ramp of a scene too.
    pub read: ReadOptions,
    /// Broken tiles of a scene file are empty.
    pub skip_broken: bool,
    /// What may be left out of the tables that are drawn from.
    pub specialize: Features,
}

impl Default for OpenOptions {
    fn default() -> OpenOptions {
        OpenOptions { read: ReadOptions::default(), skip_broken: false, specialize: Features::ALL }
    }
}

/// The first bytes of a scene file.
fn is_scene(head: &[u8]) -> bool {
    head.starts_with(&planecast_encoder::format::MAGIC)
}

impl World {
    fn of_file(file: &PcastFile, path: &Path, encoded: bool, skip_broken: bool, specialize: Features) -> Result<World> {
        let need = file.scene_bytes_at_least();
        if let Some(free) = memory::available().filter(|&free| free < need) {
            let [nx, ny, nz] = file.dims();
            let (path, need, free) = (path.display(), need.div_ceil(1 << 20), free >> 20);
            return Err(Error::Limit(format!(
                "{path}: {nx} × {ny} × {nz} voxels take at least {need} MiB of memory, {free} MiB are free; encode it smaller, \
                 or open it on a machine that has more"
            )));
        }
        let info = info::info(file);
        let (scene, info) = if skip_broken {
            let (scene, _) = file.read_scene_without_broken()?;
            (scene, info.ok())
        } else {
            (file.read_scene()?, Some(info?))
        };
        let about = file.about().clone();
        let resident = Arc::new(Resident::try_with(&scene, specialize)?.with_fractions(&about.fractions));
        let smooth = resident.heights && is_surface(&about, encoded);
        let (content_hash, bytes) = info.map_or_else(Default::default, |i| (i.content_hash, i.bytes));
        let scene = Arc::new(scene);
        let (path, notes) = (path.to_owned(), Vec::new());
        Ok(World { path, encoded, smooth, scene, resident, content_hash, bytes, about, notes, ramp: None })
    }

    /// From the bytes of a scene file or of an input; `name` is what errors call it, and its ending may tell its format.
    pub fn from_bytes(name: &Path, bytes: Vec<u8>) -> Result<World> {
        if is_scene(&bytes) || name.extension().is_some_and(|e| e.eq_ignore_ascii_case("pcast")) {
            return World::of_file(&PcastFile::from_bytes(name, bytes)?, name, false, false, Features::ALL);
        }
        let read = ReadOptions { show: true, ..ReadOptions::default() };
        let (input, matter, about) = source::read_all(name, &bytes, &read)?;
        World::with_matter(name, input, matter.zip(about.classes))
    }

    /// From an input as an importer gives it.
    pub fn of_input(name: &Path, input: Input) -> Result<World> {
        World::with_matter(name, input, None)
    }

    /// The same with translucent matter of some classes.
    pub fn with_matter(name: &Path, input: Input, matter: Option<(Matter, Arc<Classes>)>) -> Result<World> {
        let mut scene = planecast_encoder::build(input, &Default::default())?;
        if let Some((matter, classes)) = matter {
            scene = scene.with_matter(matter, classes);
        }
        let resident = Arc::new(Resident::try_with(&scene, Features::ALL)?);
        let (content_hash, bytes, about, notes) = Default::default();
        let (path, scene) = (name.to_owned(), Arc::new(scene));
        Ok(World { path, encoded: true, smooth: false, scene, resident, content_hash, bytes, about, notes, ramp: None })
    }

    /// A height field from memory: `heights[z · nx + x]` voxels from the ground up, 0 for an empty column.
    ///
    /// # Errors
    /// [`Error::Argument`] where there are not `nx · nz` heights, or none at all.
    pub fn from_heights([nx, nz]: [u32; 2], heights: &[u16]) -> Result<Arc<World>> {
        expected(&[nx, nz], heights.len())?;
        let top = heights.iter().copied().max().unwrap_or(0);
        let mut columns = ColumnsBuilder::new(nx, u32::from(top).max(1), nz);
        for &height in heights {
            if height > 0 {
                columns.push_run(Run::new(0, height - 1));
            }
            columns.end_column();
        }
        World::of_columns("heights in memory", columns.finish())
    }

    /// A volume from memory: `voxels[(z · ny + y) · nx + x]`, y up, solid where not 0.
    ///
    /// # Errors
    /// [`Error::Argument`] where there are not `nx · ny · nz` voxels, or none at all; [`Error::Scene`] where it is higher
    /// than 65,536.
    pub fn from_voxels([nx, ny, nz]: [u32; 3], voxels: &[u8]) -> Result<Arc<World>> {
        expected(&[nx, ny, nz], voxels.len())?;
        if u64::from(ny) > source::MAX_HEIGHT {
            let most = source::MAX_HEIGHT;
            return Err(Error::Limit(format!("a world {ny} voxels high: at most {most} can be held")));
        }
        let [row, slice] = [nx as usize, nx as usize * ny as usize];
        let solid = |x: u32, y: u32, z: u32| voxels[z as usize * slice + y as usize * row + x as usize] != 0;
        World::of_columns("voxels in memory", Columns::from_fn(nx, ny, nz, solid))
    }

    fn of_columns(name: &str, columns: Columns) -> Result<Arc<World>> {
        let input = Input { columns, colors: Colors::None, notes: Vec::new() };
        Ok(Arc::new(World::of_input(Path::new(name), input)?))
    }

    /// `[nx, ny, nz]`, voxels of level 0.
    pub fn dims(&self) -> [u32; 3] {
        self.resident.dims
    }

    /// Opens a scene file, or encodes an input as `encode` would.
    ///
    /// # Errors
    /// [`Error::Scene`] says what is wrong with the file, and where.
    #[cfg(not(target_arch = "wasm32"))]
    pub fn open(path: impl AsRef<Path>) -> Result<Arc<World>> {
        World::open_with(path.as_ref(), &OpenOptions::default(), &Watch::default()).map(Arc::new)
    }

    /// Opens a scene file, or encodes an input as `encode` would, into a passing file. `watch` tells how far that is, and
    /// stops it.
    #[cfg(not(target_arch = "wasm32"))]
    pub fn open_with(path: &Path, how: &OpenOptions, watch: &Watch) -> Result<World> {
        let mut notes = Vec::new();
        let opened =
            planecast_encoder::encode::open::open(path, &how.read, watch, &mut |of| notes = of.notes().to_vec())?;
        World::of_opened_with(&opened, path, how, notes)
    }

    /// The same of what was found at `path`, and of what its reader noted.
    #[cfg(not(target_arch = "wasm32"))]
    fn of_opened_with(opened: &Opened, path: &Path, how: &OpenOptions, notes: Vec<String>) -> Result<World> {
        let skip_broken = how.skip_broken && !opened.encoded;
        let mut world = World::of_file(&opened.file, path, opened.encoded, skip_broken, how.specialize)?;
        // An input has the ramp's colours by now.
        let plain = is_plain(&world.about, world.scene.color);
        let ramp = how.read.ramp.as_deref().or((how.read.show && plain).then_some("terrain"));
        let ramp = ramp.filter(|_| !opened.encoded);
        if let Some(tint) = Tint::asked(ramp, &world.about)? {
            tint.paint(Arc::get_mut(&mut world.resident).expect("nobody else has the tables yet"));
        }
        let ramp = ramp.map(str::to_owned);
        Ok(World { notes, ramp, ..world })
    }

    /// What [`planecast_encoder::encode::open::open`] found at `path`.
    ///
    /// # Errors
    /// As [`World::open`].
    #[cfg(not(target_arch = "wasm32"))]
    pub fn of_opened(opened: Opened, path: &Path) -> Result<Arc<World>> {
        World::of_file(&opened.file, path, opened.encoded, false, Features::ALL).map(Arc::new)
    }

    /// A world that comes in pieces, encoded as `encode` would, within its budget of memory; `name` is what errors call it.
    ///
    /// # Errors
    /// Those of the pieces, and [`Error::Limit`] where memory or room for temporary files is out.
    #[cfg(not(target_arch = "wasm32"))]
    pub fn from_pieces(pieces: &dyn Pieces, options: &EncodeOptions, name: &Path, watch: &Watch) -> Result<Arc<World>> {
        let file = planecast_encoder::encode::encode_unnamed(pieces, options, name, watch)?;
        World::of_file(&file, name, true, false, Features::ALL).map(Arc::new)
    }

    /// What a window calls it.
    pub fn name(&self) -> String {
        name_of(&self.path)
    }
}

/// What a window calls a file.
fn name_of(path: &Path) -> String {
    path.file_name().map_or_else(|| path.display().to_string(), |n| n.to_string_lossy().into_owned())
}

/// Whether a world is land without colours.
#[cfg(not(target_arch = "wasm32"))]
pub(crate) fn is_plain(about: &About, color: ColorMode) -> bool {
    about.kind == Some(Kind::Terrain) && color == ColorMode::None
}

/// Whether a world stands for a surface: a map of heights that was opened to be looked at, or one that was encoded with fractions.
pub(crate) fn is_surface(about: &About, encoded: bool) -> bool {
    !about.fractions.is_empty() || (encoded && about.kind == Some(Kind::Terrain))
}

/// That `n` values fill these sides, none of them 0.
fn expected(sides: &[u32], n: usize) -> Result<()> {
    let product = sides.iter().try_fold(1usize, |product, &side| product.checked_mul(side as usize));
    if product != Some(n) || n == 0 {
        let sides = sides.iter().map(u32::to_string).collect::<Vec<_>>().join(" × ");
        return Err(Error::Argument(format!("{n} values for {sides}: expected one each, and no side of 0")));
    }
    Ok(())
}

/// A world on its way, opened by a thread of its own.
#[cfg(not(target_arch = "wasm32"))]
pub struct Opening {
    pub path: PathBuf,
    watch: Arc<Watch>,
    answer: std::sync::mpsc::Receiver<Result<Held>>,
}

#[cfg(not(target_arch = "wasm32"))]
impl Opening {
    pub fn begin(path: &Path, how: &OpenOptions, residency: &ResidencyOptions) -> Opening {
        let watch = Arc::new(Watch::default());
        let (send, answer) = std::sync::mpsc::channel();
        let (owned, how, residency, watching) = (path.to_owned(), how.clone(), *residency, watch.clone());
        std::thread::spawn(move || {
            // Nobody may wait any more.
            let _ = send.send(Held::open(&owned, &how, &residency, &watching));
        });
        Opening { path: path.to_owned(), watch, answer }
    }

    /// The world, or why there is none; `None` while it is on its way.
    pub fn poll(&self) -> Option<Result<Held>> {
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
    use crate::world::pager::Patience;
    use crate::world::residency::Residency;

    #[test]
    fn world_of_an_input_is_that_of_its_scene_file() {
        let dir = tempfile::tempdir().unwrap();
        let name = Path::new("procedural:rocks?size=64&seed=3");
        let direct = World::open_with(name, &OpenOptions::default(), &Watch::default()).unwrap();
        assert!(direct.encoded && !direct.content_hash.is_empty());
        let file = dir.path().join("rocks.pcast");
        let pieces = source::open_pieces(name, &ReadOptions::default()).unwrap();
        encode::encode(&*pieces, &EncodeOptions::default(), &file, &Watch::default()).unwrap();
        let residency =
            |residency| ResidencyOptions { residency, memory: None, memory_gpu: None, patience: Patience::Wait };
        let poll = |asked| {
            let opening = Opening::begin(&file, &OpenOptions::default(), &residency(asked));
            loop {
                match opening.poll() {
                    Some(world) => break world.unwrap(),
                    None => std::thread::yield_now(),
                }
            }
        };
        let Held::Tiles(tiles) = poll(Residency::Paged) else { panic!("asked for in tiles") };
        assert_eq!(tiles.source.dims(), direct.dims());
        let Held::Whole(read) = poll(Residency::Auto) else { panic!("it is small") };
        assert!(!read.encoded && read.scene == direct.scene && read.content_hash == direct.content_hash);
        let bytes = World::from_bytes(Path::new("dropped"), std::fs::read(&file).unwrap()).unwrap();
        assert_eq!(bytes.content_hash, direct.content_hash);
    }

    #[test]
    fn world_from_memory_holds_what_it_was_given() {
        let heights = World::from_heights([3, 2], &[1, 0, 4, 2, 2, 7]).unwrap();
        assert_eq!(heights.dims(), [3, 7, 2]);
        let top = |x, z| heights.scene.levels[0].solid.column(x, z).last().map_or(0, |run| run.end());
        assert_eq!([top(0, 0), top(1, 0), top(2, 0), top(2, 1)], [1, 0, 4, 7]);
        let mut voxels = vec![0; 4 * 3 * 2];
        voxels[(3 + 1) * 4 + 2] = 9; // x = 2, y = 1, z = 1
        let volume = World::from_voxels([4, 3, 2], &voxels).unwrap();
        let solid = &volume.scene.levels[0].solid;
        assert_eq!(solid.runs().len(), 1);
        assert!(solid.solid(2, 1, 1));
        for (sides, n) in [([3, 3], 8), ([0, 3], 0)] {
            let error = World::from_heights(sides, &vec![1; n]).err().unwrap().to_string();
            assert!(error.contains(&format!("{n} values for {} × {}", sides[0], sides[1])), "{error}");
        }
        assert!(World::from_voxels([1, 70_000, 1], &[1; 70_000]).err().unwrap().to_string().contains("at most 65536"));
    }

    #[test]
    fn renderers_own_their_world_and_can_be_sent() {
        fn sent<T: Send + 'static>() {}
        fn shared<T: Send + Sync + 'static>() {}
        sent::<crate::render::device::Renderer>();
        shared::<World>();
    }

    #[test]
    fn world_that_cannot_be_opened_says_why() {
        let open = |name: &str| World::open_with(Path::new(name), &OpenOptions::default(), &Watch::default());
        assert!(open("/no/such/file").err().unwrap().to_string().contains("/no/such/file"));
        assert!(open("procedural:nothing").is_err());
        let other = World::from_bytes(Path::new("b.pcast"), b"garbage".to_vec());
        assert!(other.err().unwrap().to_string().starts_with("b.pcast"));
        let broken = World::from_bytes(Path::new("b.pcast"), planecast_encoder::format::MAGIC.to_vec());
        assert!(broken.err().unwrap().to_string().contains("b.pcast"));
    }
}
