//! What of a world is in memory while it is drawn: all of it, or the tiles that frames show.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::DVec3;
use planecast_encoder::encode::{Watch, memory};
use planecast_encoder::format::sheets::is_manifest;
use planecast_encoder::source::{ReadOptions, tiles};
use planecast_encoder::{About, PcastFile, TileSource};

use crate::film::path::Pose;
use crate::film::tour::{self, View};
use crate::frame::aim::{AimArgs, Typed};
use crate::world::pager::Patience;
use crate::world::preview::Preview;
use crate::world::tint::Tint;
use crate::world::{OpenOptions, World, name_of};
use crate::{Error, Result};

/// Bytes that a scene takes in memory once it is ready to be drawn, for each byte of its lists.
const READY: u64 = 3;

/// Bytes of tiles on a GPU unless others are given.
const USUAL_GPU: u64 = 1 << 30;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Residency {
    Whole,
    Paged,
    /// Whole where it fits.
    #[default]
    Auto,
}

/// How a world is kept in memory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResidencyOptions {
    pub residency: Residency,
    /// Bytes for the tiles of a world that is not whole; `None`: half of what is free.
    pub memory: Option<u64>,
    /// The same on a GPU; `None`: 1 GiB.
    pub memory_gpu: Option<u64>,
    pub patience: Patience,
}

impl ResidencyOptions {
    /// The tiles of what is never whole, and of what was asked for in tiles; `None` of what is to be opened as a file.
    ///
    /// # Errors
    /// Those of the source, and [`Error::Argument`] where what is never whole was asked for whole.
    pub fn tiles(&self, path: &Path, read: &ReadOptions) -> Result<Option<Tiles>> {
        let made = path.to_str().is_some_and(|name| name.starts_with("procedural:"));
        if !(is_manifest(path) || made || self.residency == Residency::Paged) {
            return Ok(None);
        }
        let Some(source) = tiles::open(path, read)? else { return Ok(None) };
        if self.residency == Residency::Whole {
            let what = format!("{}: is drawn in tiles alone; leave out --residency whole", path.display());
            return Err(Error::Argument(what));
        }
        Tiles::new(path, source, read).map(Some)
    }

    /// Whether a scene file is drawn in tiles; `tell` hears why, where nobody asked for it.
    pub fn pages(&self, file: &PcastFile, skip_broken: bool, tell: &mut dyn FnMut(&str)) -> bool {
        let need = file.scene_bytes_at_least().saturating_mul(READY);
        let room = self.memory.or_else(memory::available).unwrap_or(u64::MAX);
        match self.residency {
            Residency::Whole => false,
            Residency::Paged => true,
            // A small world is drawn faster as a whole.
            Residency::Auto => {
                let pages = !skip_broken && need > room;
                if pages {
                    let [need, room] = [need, room].map(memory::display);
                    tell(&format!(
                        "the world takes some {need} of memory, {room} are allowed: tiles are read as frames show them"
                    ));
                }
                pages
            }
        }
    }

    /// Bytes of tiles that are kept at once.
    pub fn budget(&self, on_gpu: bool) -> u64 {
        let host = self.memory.unwrap_or_else(|| memory::available().map_or(1 << 30, |free| free / 2));
        // The GPU's tiles are on the host too.
        if on_gpu { host.min(self.memory_gpu.unwrap_or(USUAL_GPU)) } else { host }
    }
}

/// A world that comes in tiles.
pub struct Tiles {
    /// Where it came from.
    pub path: PathBuf,
    pub source: Arc<dyn TileSource>,
    pub preview: Preview,
    pub about: About,
    /// Colours instead of its own.
    pub tint: Option<Tint>,
}

impl Tiles {
    /// # Errors
    /// Those of the coarse tiles that the preview is made of, and of a ramp that is not known.
    pub fn new(path: &Path, source: Arc<dyn TileSource>, read: &ReadOptions) -> Result<Tiles> {
        let about = source.about();
        let tint = Tint::asked(read.ramp.as_deref(), &about)?;
        let preview = Preview::new(&*source)?;
        Ok(Tiles { path: path.to_owned(), source, preview, about, tint })
    }

    /// Of a scene file, or of an input that was `encoded` into one.
    ///
    /// # Errors
    /// As [`Tiles::new`].
    pub fn of_file(path: &Path, file: PcastFile, encoded: bool, read: &ReadOptions) -> Result<Tiles> {
        // An input has the ramp's colours by now.
        let read = if encoded { &ReadOptions::default() } else { read };
        Tiles::new(path, Arc::new(file), read)
    }

    /// What is aimed at with these flags.
    ///
    /// # Errors
    /// As [`AimArgs::pose`].
    pub fn pose(&self, aim: &AimArgs, typed: Typed, view: View) -> Result<Pose> {
        let inner = Typed { eye: typed.eye.map(|eye| self.preview.within(eye)), ..typed };
        Ok(self.preview.pose(self.preview.aim(aim).pose(inner, &self.preview.scene, view)?))
    }
}

/// A world as it is kept in memory.
pub enum Held {
    Whole(World),
    Tiles(Tiles),
}

impl Held {
    /// Opens a scene or an input. `watch` tells how far the encoding of an input is, and stops it.
    ///
    /// # Errors
    /// As [`World::open`], and those of tiles.
    pub fn open(path: &Path, how: &OpenOptions, residency: &ResidencyOptions, watch: &Watch) -> Result<Held> {
        if let Some(tiles) = residency.tiles(path, &how.read)? {
            return Ok(Held::Tiles(tiles));
        }
        let mut notes = Vec::new();
        let opened =
            planecast_encoder::encode::open::open(path, &how.read, watch, &mut |of| notes = of.notes().to_vec())?;
        if residency.pages(&opened.file, how.skip_broken && !opened.encoded, &mut |_| ()) {
            return Tiles::of_file(path, opened.file, opened.encoded, &how.read).map(Held::Tiles);
        }
        World::of_opened_with(&opened, path, how, notes).map(Held::Whole)
    }

    pub fn whole(&self) -> Option<&World> {
        match self {
            Held::Whole(world) => Some(world),
            Held::Tiles(_) => None,
        }
    }

    /// Where it came from.
    pub fn path(&self) -> &Path {
        match self {
            Held::Whole(world) => &world.path,
            Held::Tiles(tiles) => &tiles.path,
        }
    }

    /// What a window calls it.
    pub fn name(&self) -> String {
        name_of(self.path())
    }

    /// Whether it is an input that had to be encoded, and can be read in another way.
    pub fn encoded(&self) -> bool {
        self.whole().is_some_and(|world| world.encoded)
    }

    pub fn about(&self) -> &About {
        match self {
            Held::Whole(world) => &world.about,
            Held::Tiles(tiles) => &tiles.about,
        }
    }

    /// `[nx, ny, nz]`, voxels of level 0.
    pub fn dims(&self) -> [u32; 3] {
        match self {
            Held::Whole(world) => world.dims(),
            Held::Tiles(tiles) => tiles.source.dims(),
        }
    }

    /// A view of it that shows what there is.
    pub fn good_view(&self, view: View) -> Pose {
        match self {
            Held::Whole(world) => tour::still(&world.scene, view),
            Held::Tiles(Tiles { preview, .. }) => preview.pose(tour::still(&preview.scene, view)),
        }
    }

    /// What is aimed at with these flags.
    ///
    /// # Errors
    /// As [`AimArgs::pose`].
    pub fn pose(&self, aim: &AimArgs, typed: Typed, view: View) -> Result<Pose> {
        match self {
            Held::Whole(world) => aim.pose(typed, &world.scene, view),
            Held::Tiles(tiles) => tiles.pose(aim, typed, view),
        }
    }

    /// The middle of what there is.
    pub fn center(&self) -> DVec3 {
        match self {
            Held::Whole(world) => tour::Subject::new(&world.scene).center(),
            Held::Tiles(Tiles { preview, .. }) => {
                preview.origin + tour::Subject::new(&preview.scene).center() * preview.scale
            }
        }
    }
}
