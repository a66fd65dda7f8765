//! `.pcast` files, memory-mapped, and validated before they are trusted.
//!
//! [`PcastFile::open`] proves the header and the directory; [`PcastFile::tile`] proves one tile, every byte of it;
//! [`PcastFile::read_scene`] all tiles, and that the exposed voxels are just those with an exposed face. A
//! [`PcastFile::query`] checks its tile's checksum once and then reads one column.

use std::borrow::Cow;
use std::fs::File;
use std::io::Read;
use std::ops::{Deref, Range};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

use bytemuck::pod_read_unaligned;
use rayon::prelude::*;
use xxhash_rust::xxh3::xxh3_64;

use crate::format::column_rle::{self, Form};
use crate::format::forms::{COLOR_GROUP_SHIFT, Forms, GENERAL, Heights, Lists, Painted, Table, edges, n_edges};
use crate::format::metadata;
use crate::format::{
    self, ALIGN, BlobHeader, COMPRESSED, EMPTY, Grid, Header, MATTER, SPECIALIZED, Section, TileEntry,
};
use crate::model::exposure;
use crate::model::filled::{filled, starts};
use crate::model::matter::Matter;
use crate::model::tiles::{TileKey, TileSource};
use crate::store::guard::Map;
use crate::{About, ColorMode, Columns, ColumnsBuilder, Encoding, Error, Level, MipRule, Result, Rgb, Run, Scene};

mod sound;

/// What [`PcastFile::query`] finds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Voxel {
    pub solid: bool,
    /// None for air, in scenes without colours, and for hidden voxels that have none.
    pub color: Option<Rgb>,
}

/// An open scene file with a valid header and directory.
///
/// The file is mapped: it must not be cut short while it is open. Tiles that are read whole are copied before they are
/// checked, so that no change goes unseen; single voxels are looked up in place, in tiles that were checked once. planecast
/// itself only ever replaces files as a whole, which is safe.
pub struct PcastFile {
    path: PathBuf,
    bytes: Bytes,
    encoding: Encoding,
    color: ColorMode,
    mip_rule: MipRule,
    about: Box<About>,
    grids: Vec<Grid>,
    entries: Vec<TileEntry>,
    /// Tiles whose checksum was found to be right.
    checked: Vec<AtomicBool>,
}

#[cfg(not(target_arch = "wasm32"))]
fn unzstd(bytes: &[u8]) -> std::io::Result<impl Read> {
    zstd::Decoder::with_buffer(bytes)
}

/// The same without C.
#[cfg(target_arch = "wasm32")]
fn unzstd(bytes: &[u8]) -> std::io::Result<impl Read> {
    ruzstd::decoding::StreamingDecoder::new(bytes).map_err(|e| std::io::Error::other(e.to_string()))
}

enum Bytes {
    Mapped(Map),
    Owned(Vec<u8>),
}

impl Deref for Bytes {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        match self {
            Bytes::Mapped(map) => map,
            Bytes::Owned(bytes) => bytes,
        }
    }
}

impl PcastFile {
    /// Maps a file and validates its header and directory.
    pub fn open(path: impl AsRef<Path>) -> Result<PcastFile> {
        let path = path.as_ref();
        let file = File::open(path).map_err(|e| Error::io(path, "open", e))?;
        let meta = file.metadata().map_err(|e| Error::io(path, "read", e))?;
        if !meta.is_file() {
            return Err(Error::format(path, "not a regular file, a .pcast scene was expected"));
        }
        if meta.len() < size_of::<Header>() as u64 {
            return Err(too_short(path, meta.len()));
        }
        let map = Map::new(path, &file).map_err(|e| Error::io(path, "map", e))?;
        PcastFile::new(path, Bytes::Mapped(map))
    }

    /// The same for a file that is open, of which all is there. `path` is what errors call it.
    pub fn from_file(path: impl AsRef<Path>, file: &File) -> Result<PcastFile> {
        let path = path.as_ref();
        let map = Map::new(path, file).map_err(|e| Error::io(path, "map", e))?;
        PcastFile::new(path, Bytes::Mapped(map))
    }

    /// The same for a file in memory. `path` is what errors call it.
    pub fn from_bytes(path: impl AsRef<Path>, bytes: Vec<u8>) -> Result<PcastFile> {
        PcastFile::new(path.as_ref(), Bytes::Owned(bytes))
    }

    fn new(path: &Path, bytes: Bytes) -> Result<PcastFile> {
        let wrong = |at: usize, what: String| Err(Error::format(path, format!("byte {at}: {what}")));
        let Outline { encoding, color, mip_rule, grids, flags } = Outline::check(path, &bytes, bytes.len() as u64)?;
        let header: Header = pod_read_unaligned(&bytes[..size_of::<Header>()]);
        let n_tiles = header.n_tiles;
        let directory = &bytes[header.directory as usize..][..n_tiles as usize * size_of::<TileEntry>()];
        let mut about = About::default();
        if header.version[1] >= format::MINOR_METADATA {
            let metadata = &bytes[size_of::<Header>()..header.directory as usize];
            match metadata::unpack(metadata) {
                Ok(found) => about = found,
                Err((at, what)) => return wrong(size_of::<Header>() + at, format!("metadata: {what}")),
            }
        }
        if xxh3_64(directory) != header.directory_checksum {
            return wrong(48, "the directory does not match its checksum; the file is damaged".into());
        }
        let entries: Vec<TileEntry> = directory.chunks_exact(size_of::<TileEntry>()).map(pod_read_unaligned).collect();
        let directory_at = header.directory as usize;
        let directory_end = header.directory + directory.len() as u64;
        if let Err((tile, what)) = check_entries(&entries, flags, directory_end, header.file_len) {
            return wrong(directory_at + tile * size_of::<TileEntry>(), format!("tile {tile}: {what}"));
        }
        if about.classes.is_none() && entries.iter().any(|e| e.flags & MATTER != 0) {
            return wrong(
                size_of::<Header>(),
                "metadata: no classes (CLAS) of the translucent matter that tiles hold".into(),
            );
        }
        let checked = entries.iter().map(|_| AtomicBool::new(false)).collect();
        Ok(PcastFile {
            path: path.into(),
            bytes,
            encoding,
            color,
            mip_rule,
            about: Box::new(about),
            grids,
            entries,
            checked,
        })
    }

    /// The bytes of a file in memory, of which some come only now; tiles are checked when they are read. None of a mapped
    /// file.
    pub(crate) fn bytes_mut(&mut self) -> &mut [u8] {
        match &mut self.bytes {
            Bytes::Mapped(_) => &mut [],
            Bytes::Owned(bytes) => bytes,
        }
    }

    /// The file's name, as given.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// `[nx, ny, nz]` of level 0.
    pub fn dims(&self) -> [u32; 3] {
        self.grids[0].dims
    }

    pub fn encoding(&self) -> Encoding {
        self.encoding
    }

    pub fn color(&self) -> ColorMode {
        self.color
    }

    pub fn mip_rule(&self) -> MipRule {
        self.mip_rule
    }

    /// What was encoded, and how it was read; nothing is known of files that do not say it.
    pub fn about(&self) -> &About {
        &self.about
    }

    /// The tile grids of all levels, level 0 first.
    pub fn grids(&self) -> &[Grid] {
        &self.grids
    }

    /// The directory: all tiles of level 0, x fastest, then z, then those of level 1, and so on.
    pub fn entries(&self) -> &[TileEntry] {
        &self.entries
    }

    /// Bytes of the file.
    pub fn file_len(&self) -> u64 {
        self.bytes.len() as u64
    }

    pub(crate) fn tile_ix(&self, level: usize, tx: u32, tz: u32) -> usize {
        let grid = &self.grids[level];
        assert!(tx < grid.tiles[0] && tz < grid.tiles[1], "tile ({tx}, {tz}) of level {level} is outside the world");
        grid.first as usize + tz as usize * grid.tiles[0] as usize + tx as usize
    }

    fn place(&self, level: usize, tx: u32, tz: u32) -> Place<'_> {
        let [xs, zs] = self.grids[level].columns(tx, tz);
        let dims = [xs.len() as u32, self.grids[level].dims[1], zs.len() as u32];
        let modes = Modes { encoding: self.encoding, color: self.color };
        let TileEntry { offset, flags, .. } = self.entries[self.tile_ix(level, tx, tz)];
        Place { path: &self.path, level, tx, tz, offset, flags, modes, dims }
    }

    /// A tile's bytes as they are in the file; None for an empty tile.
    fn in_file(&self, ix: usize) -> Option<&[u8]> {
        let entry = &self.entries[ix];
        // The directory's check keeps blobs inside the file.
        (!entry.is_empty()).then(|| &self.bytes[entry.offset as usize..][..entry.len as usize])
    }

    fn check_sum(&self, level: usize, tx: u32, tz: u32, bytes: &[u8]) -> Result<()> {
        if xxh3_64(bytes) == self.entries[self.tile_ix(level, tx, tz)].checksum {
            return Ok(());
        }
        Err(self.place(level, tx, tz).error(0, "does not match its checksum; the file is damaged"))
    }

    /// A tile's bytes as they are stored, their checksum checked on first use; None for an empty tile.
    pub(crate) fn stored(&self, level: usize, tx: u32, tz: u32) -> Result<Option<&[u8]>> {
        let ix = self.tile_ix(level, tx, tz);
        let Some(bytes) = self.in_file(ix) else { return Ok(None) };
        if !self.checked[ix].load(Ordering::Relaxed) {
            self.check_sum(level, tx, tz, bytes)?;
            self.checked[ix].store(true, Ordering::Relaxed);
        }
        Ok(Some(bytes))
    }

    /// A tile's blob, unpacked, to look something up in; None for an empty tile. Where the file is mapped, somebody may change
    /// its bytes from one look to the next.
    pub(crate) fn blob(&self, level: usize, tx: u32, tz: u32) -> Result<Option<Blob<'_>>> {
        let Some(bytes) = self.stored(level, tx, tz)? else { return Ok(None) };
        unpack(self.place(level, tx, tz), Cow::Borrowed(bytes))
    }

    /// The same to be read as a whole: bytes that were found right stay so.
    pub(crate) fn own_blob(&self, level: usize, tx: u32, tz: u32) -> Result<Option<Blob<'_>>> {
        if let Bytes::Owned(_) = self.bytes {
            return self.blob(level, tx, tz);
        }
        let Some(bytes) = self.in_file(self.tile_ix(level, tx, tz)) else { return Ok(None) };
        let bytes = bytes.to_vec();
        self.check_sum(level, tx, tz, &bytes)?;
        unpack(self.place(level, tx, tz), Cow::Owned(bytes))
    }

    /// The matter of a tile, every byte of it checked; None where it has none.
    pub(crate) fn matter(&self, level: usize, tx: u32, tz: u32) -> Result<Option<Matter>> {
        let ix = self.tile_ix(level, tx, tz);
        let (Some(bytes), MATTER) = (self.in_file(ix), self.entries[ix].flags & MATTER) else { return Ok(None) };
        // A copy: what was found right stays so.
        let bytes = bytes.to_vec();
        self.check_sum(level, tx, tz, &bytes)?;
        let place = self.place(level, tx, tz);
        let classes = self.about.classes.as_ref().expect("checked when the file was opened");
        decode_matter(&place, Cow::Owned(bytes), classes.max_code()).map(Some)
    }

    /// Whether any tile holds translucent matter.
    pub fn has_matter(&self) -> bool {
        self.entries.iter().any(|e| e.flags & MATTER != 0)
    }

    /// One tile, after every byte of it was checked. Its columns are those of [`Grid::columns`], counted from 0.
    ///
    /// Panics if the file has no such tile.
    pub fn tile(&self, level: usize, tx: u32, tz: u32) -> Result<Level> {
        let matter = self.matter(level, tx, tz)?.map(Arc::new);
        let entry = &self.entries[self.tile_ix(level, tx, tz)];
        let Some(blob) = self.own_blob(level, tx, tz)? else {
            self.check_no_figures(level, tx, tz)?;
            return Ok(Level { matter, ..self.place(level, tx, tz).empty() });
        };
        let tile = blob.level()?;
        blob.check_figures(&tile, entry)?;
        Ok(Level { matter, ..tile })
    }

    /// Checks every byte of one tile, as [`PcastFile::tile`] does.
    pub(crate) fn check_tile(&self, level: usize, tx: u32, tz: u32) -> Result<()> {
        self.matter(level, tx, tz)?;
        let Some(blob) = self.own_blob(level, tx, tz)? else { return self.check_no_figures(level, tx, tz) };
        let entry = &self.entries[self.tile_ix(level, tx, tz)];
        if blob.is_sound(entry) { Ok(()) } else { blob.check_figures(&blob.level()?, entry) }
    }

    /// A tile without a solid voxel says so.
    fn check_no_figures(&self, level: usize, tx: u32, tz: u32) -> Result<()> {
        let TileEntry { n_solid, n_exposed, n_runs, y_min, y_max, .. } = self.entries[self.tile_ix(level, tx, tz)];
        if (n_solid, n_exposed, n_runs, y_min, y_max) == (0, 0, 0, 0, 0) {
            return Ok(());
        }
        Err(self.place(level, tx, tz).error(0, "the directory's figures are of solid voxels, and the tile has none"))
    }

    /// Bytes of memory that the whole scene takes at least, by its directory alone.
    pub fn scene_bytes_at_least(&self) -> u64 {
        let shows = Modes { encoding: self.encoding, color: self.color }.shows();
        let columns: u64 = self.grids.iter().map(|g| u64::from(g.dims[0]) * u64::from(g.dims[2])).sum();
        let tile = |e: &TileEntry| {
            let colors = match self.color {
                ColorMode::None => 0,
                ColorMode::Run => u64::from(e.n_runs),
                ColorMode::Voxel => e.n_exposed,
            };
            (size_of::<Run>() as u64 * u64::from(e.n_runs))
                .saturating_add(colors.saturating_mul(size_of::<Rgb>() as u64))
        };
        let offsets = size_of::<u32>() as u64 * columns * if shows { 2 } else { 1 };
        self.entries.iter().map(tile).fold(offsets, u64::saturating_add)
    }

    /// The whole scene, every byte of it checked.
    pub fn read_scene(&self) -> Result<Scene> {
        self.read_scene_from(0)
    }

    /// The scene that a level and all coarser ones are.
    pub(crate) fn read_scene_from(&self, level: usize) -> Result<Scene> {
        let levels = (level..self.grids.len()).map(|k| self.level(k, None)).collect::<Result<_>>()?;
        Ok(self.scene(levels))
    }

    fn scene(&self, levels: Vec<Level>) -> Scene {
        let classes = self.about.classes.clone().filter(|_| self.has_matter());
        Scene { encoding: self.encoding, color: self.color, mip_rule: self.mip_rule, levels, classes }
    }

    /// What of the scene can be read, and what is wrong with the rest: broken tiles are empty. Beside them voxels
    /// become visible that have no colour of their own.
    pub fn read_scene_without_broken(&self) -> Result<(Scene, Vec<Error>)> {
        let faults = Mutex::new(Vec::new());
        let levels = (0..self.grids.len()).map(|k| self.level(k, Some(&faults))).collect::<Result<_>>()?;
        Ok((self.scene(levels), faults.into_inner().expect("no thread panics with it")))
    }

    /// One level, whole; where there is a place for faults, with empty tiles instead of broken ones.
    fn level(&self, k: usize, faults: Option<&Mutex<Vec<Error>>>) -> Result<Level> {
        let grid = &self.grids[k];
        let tiles: Vec<(u32, u32)> =
            (0..grid.tiles[1]).flat_map(|tz| (0..grid.tiles[0]).map(move |tx| (tx, tz))).collect();
        // An empty tile costs 48 bytes in the file: its columns are not made before they are needed.
        let mut tiles: Vec<Option<Level>> = tiles
            .into_par_iter()
            .map(|(tx, tz)| {
                let empty = self.entries[self.tile_ix(k, tx, tz)].is_empty();
                match ((!empty).then(|| self.tile(k, tx, tz)).transpose(), faults) {
                    (Err(fault @ Error::Format { .. }), Some(faults)) => {
                        faults.lock().expect("no thread panics with it").push(fault);
                        Ok(None)
                    }
                    (tile, _) => tile,
                }
            })
            .collect::<Result<_>>()?;
        let all_there =
            tiles.iter().zip(&self.entries[grid.first as usize..]).all(|(t, e)| t.is_some() || e.is_empty());
        let number = |tx: u32, tz: u32| tz as usize * grid.tiles[0] as usize + tx as usize;
        let solid = self.join(k, |tx, tz| tiles[number(tx, tz)].as_ref().map(|l| &l.solid))?;
        // Where the colours of each row of columns begin in their tile.
        let rows: Vec<Vec<usize>> = tiles
            .par_iter()
            .map(|level| match (level, self.color) {
                (None, _) | (_, ColorMode::None) => Vec::new(),
                (Some(level), ColorMode::Run) => color_rows(level.geometry(self.encoding), |_| 1),
                (Some(level), ColorMode::Voxel) => {
                    let exposed = level.exposed.as_ref().expect("voxel colours come with exposed runs");
                    color_rows(exposed, |run| run.len() as usize)
                }
            })
            .collect();
        // What has been put together is not kept twice.
        tiles.iter_mut().flatten().for_each(|l| l.solid = Columns::default());
        let shows = self.encoding == Encoding::Surface || self.color == ColorMode::Voxel;
        let exposed = shows
            .then(|| self.join(k, |tx, tz| tiles[number(tx, tz)].as_ref().and_then(|l| l.exposed.as_ref())))
            .transpose()?;
        tiles.iter_mut().flatten().for_each(|l| l.exposed = None);
        if let (Some(exposed), true) = (&exposed, all_there) {
            self.check_exposure(k, &solid, exposed)?;
        }

        let of_row = |tz: usize| tz * grid.tiles[0] as usize..(tz + 1) * grid.tiles[0] as usize;
        let n_colors = |tz| tiles[of_row(tz)].iter().flatten().map(|l| l.colors.len()).sum();
        let n_colors: Vec<usize> = (0..grid.tiles[1] as usize).map(n_colors).collect();
        let colors = filled(&n_colors, "colours", |tz, mut out: &mut [Rgb]| {
            for z in 0..grid.columns(0, tz as u32)[1].len() {
                for (level, rows) in tiles[of_row(tz)].iter().zip(&rows[of_row(tz)]) {
                    let (Some(level), false) = (level, rows.is_empty()) else { continue };
                    let part = &level.colors[rows[z]..rows[z + 1]];
                    let (now, after) = out.split_at_mut(part.len());
                    now.copy_from_slice(part);
                    out = after;
                }
            }
        })?;
        let matter = self.has_matter().then(|| {
            Matter::gather(grid.dims[1], 0..grid.dims[0], 0..grid.dims[2], |x, z| {
                let tile = tiles[number(x / format::TILE, z / format::TILE)].as_ref();
                let (xs, in_row) = (grid.columns(x / format::TILE, 0)[0].len() as u32, x % format::TILE);
                let matter = tile.and_then(|tile| tile.matter.as_deref());
                (matter, (z % format::TILE * xs + in_row) as usize, xs - in_row)
            })
        });
        Ok(Level { solid, exposed, colors, matter: matter.map(Arc::new) })
    }

    /// Puts the columns of a level's tiles together.
    fn join<'a>(&self, k: usize, tile: impl Fn(u32, u32) -> Option<&'a Columns> + Sync) -> Result<Columns> {
        let grid = &self.grids[k];
        let [nx, ny, nz] = grid.dims;
        let of_row = |tz: usize| (0..grid.tiles[0]).map(move |tx| (tx, tz as u32));
        let n_runs = |tz| of_row(tz).filter_map(|(tx, tz)| tile(tx, tz)).map(|c| c.runs().len()).sum();
        let n_runs: Vec<usize> = (0..grid.tiles[1] as usize).map(n_runs).collect();
        let starts = starts(&n_runs);
        let n = starts[n_runs.len()];
        if u32::try_from(n).is_err() {
            return Err(Error::Limit(format!("level {k} has {n} runs, a level holds at most 2³² − 1")));
        }
        // The columns of a row of tiles are a part of the table; before all of them stands a 0.
        let zs = |tz: usize| grid.columns(0, tz as u32)[1].clone();
        let ends = (0..grid.tiles[1] as usize).map(|tz| zs(tz).len() * nx as usize);
        let ends: Vec<usize> = std::iter::once(1).chain(ends).collect();
        let offsets = filled(&ends, "columns", |i, mut out: &mut [u32]| {
            let Some(tz) = i.checked_sub(1) else { return };
            let mut base = starts[tz] as u32;
            for z in zs(tz) {
                for (tx, tz) in of_row(tz) {
                    let (now, after) = out.split_at_mut(grid.columns(tx, tz)[0].len());
                    out = after;
                    let Some(columns) = tile(tx, tz) else {
                        now.fill(base);
                        continue;
                    };
                    let row = row(columns, z);
                    let part = &columns.offsets()[row.start..=row.end];
                    now.iter_mut().zip(&part[1..]).for_each(|(out, o)| *out = base + (o - part[0]));
                    base += part[row.len()] - part[0];
                }
            }
        })?;
        let runs = filled(&n_runs, "runs", |tz, mut out: &mut [Run]| {
            for z in zs(tz) {
                for columns in of_row(tz).filter_map(|(tx, tz)| tile(tx, tz)) {
                    let row = row(columns, z);
                    let part = columns.offsets()[row.start] as usize..columns.offsets()[row.end] as usize;
                    let (now, after) = out.split_at_mut(part.len());
                    now.copy_from_slice(&columns.runs()[part]);
                    out = after;
                }
            }
        })?;
        Ok(Columns::from_parts(nx, ny, nz, offsets, runs))
    }

    /// Checks what [`PcastFile::tile`] cannot: that the exposed voxels of the tiles of row `tz` are just those with an
    /// exposed face. Faults go to `faulty`, by tile. `tile(tx, tz)` is a tile, or None for a broken one, beside which
    /// nothing can be told.
    pub(crate) fn check_exposure_of_row<'a>(
        &self,
        k: usize,
        tz: u32,
        tile: impl Fn(u32, u32) -> Option<&'a Level> + Sync,
    ) -> Vec<Error> {
        let grid = &self.grids[k];
        let [nx, ny, nz] = grid.dims;
        let check = |tx: u32| {
            let [xs, zs] = grid.columns(tx, tz);
            let around = |r: &Range<u32>, n: u32| r.start.saturating_sub(1)..n.min(r.end + 1);
            let (around_xs, around_zs) = (around(&xs, nx), around(&zs, nz));
            let tiles = |r: &Range<u32>| r.start / format::TILE..=(r.end - 1) / format::TILE;
            if tiles(&around_zs).any(|tz| tiles(&around_xs).any(|tx| tile(tx, tz).is_none())) {
                return None;
            }
            let solid = Columns::gather(ny, around_xs.clone(), around_zs.clone(), |x, z| {
                let columns = &tile(x / format::TILE, z / format::TILE).expect("looked at above").solid;
                let in_row = x % format::TILE;
                (columns, (z % format::TILE * columns.nx() + in_row) as usize, columns.nx() - in_row)
            });
            let inner = |r: &Range<u32>, around: &Range<u32>| r.start - around.start..r.end - around.start;
            let expected = exposure::exposed(&solid).crop(inner(&xs, &around_xs), inner(&zs, &around_zs));
            let own = tile(tx, tz).expect("looked at above");
            match &own.exposed {
                Some(exposed) if *exposed != expected => {
                    Some(self.place(k, tx, tz).error(0, "the exposed voxels are not those with an exposed face"))
                }
                None if expected.voxels() != self.entries[self.tile_ix(k, tx, tz)].n_exposed => {
                    Some(self.place(k, tx, tz).error(0, "the directory's number of exposed voxels is wrong"))
                }
                _ => None,
            }
        };
        (0..grid.tiles[0]).into_par_iter().filter_map(check).collect()
    }

    /// The exposed voxels must be just those with an exposed face: renderers look up colours by them.
    fn check_exposure(&self, k: usize, solid: &Columns, exposed: &Columns) -> Result<()> {
        let Some([x, z]) = exposure::find_wrong(solid, exposed) else { return Ok(()) };
        Err(Error::format(
            &self.path,
            format!(
                "level {k} column ({x}, {z}): the exposed voxels are not those with an exposed face; encode the scene again"
            ),
        ))
    }

    /// One voxel of level 0; outside the world is air.
    ///
    /// Reads one column, by two binary searches, after the checksum of its tile was checked once.
    pub fn query(&self, x: i64, y: i64, z: i64) -> Result<Voxel> {
        const AIR: Voxel = Voxel { solid: false, color: None };
        let inside = |v: i64, n: u32| u32::try_from(v).ok().filter(|&v| v < n);
        let [nx, ny, nz] = self.dims();
        let (Some(x), Some(y), Some(z)) = (inside(x, nx), inside(y, ny), inside(z, nz)) else { return Ok(AIR) };
        let Some(blob) = self.blob(0, x / format::TILE, z / format::TILE)? else { return Ok(AIR) };
        let ix = (z % format::TILE) as usize * blob.width + (x % format::TILE) as usize;
        let (solid, shown) = blob.look(ix, y)?;
        let color = match self.color {
            ColorMode::None => None,
            _ => shown.map(|at| blob.color(ix, at)).transpose()?,
        };
        Ok(Voxel { solid, color })
    }
}

fn too_short(path: &Path, len: u64) -> Error {
    Error::format(path, format!("{len} bytes; a .pcast scene has a header of 64"))
}

/// The columns of row `z` of the world in the tile that holds it.
fn row(tile: &Columns, z: u32) -> Range<usize> {
    let row = (z % format::TILE) as usize;
    row * tile.nx() as usize..(row + 1) * tile.nx() as usize
}

/// Where the colours of each row of a tile begin, and where the last ends; a run has as many as `colors` says.
fn color_rows(columns: &Columns, colors: impl Fn(Run) -> usize) -> Vec<usize> {
    let width = columns.nx() as usize;
    let ends = columns.offsets().iter().step_by(width);
    let rows = ends.clone().zip(ends.skip(1)).map(|(&start, &end)| start as usize..end as usize);
    let lens: Vec<usize> = rows.map(|row| columns.runs()[row].iter().map(|&run| colors(run)).sum()).collect();
    starts(&lens)
}

/// Bounds and overlaps; an error names the tile by its number in the directory.
pub(crate) fn check_entries(
    entries: &[TileEntry],
    flags: u32,
    directory_end: u64,
    file_len: u64,
) -> Result<(), (usize, String)> {
    let mut blobs = Vec::new();
    for (i, e) in entries.iter().enumerate() {
        if e.is_empty() {
            if *e != (TileEntry { flags: EMPTY, ..bytemuck::Zeroable::zeroed() }) {
                return Err((i, "an empty tile has figures".into()));
            }
            continue;
        }
        if e.flags & !flags != 0 {
            return Err((i, format!("flags {:#x}, at most {flags:#x} was expected", e.flags)));
        }
        if !e.offset.is_multiple_of(ALIGN) {
            return Err((i, format!("blob at byte {}, a multiple of {ALIGN} was expected", e.offset)));
        }
        let end = e.offset.checked_add(u64::from(e.len));
        if e.offset < directory_end || end.is_none_or(|end| end > file_len) {
            return Err((i, format!("blob of {} bytes at byte {} does not fit the file", e.len, e.offset)));
        }
        blobs.push(i);
    }
    blobs.sort_unstable_by_key(|&i| entries[i].offset);
    for pair in blobs.windows(2) {
        let [a, b] = [entries[pair[0]], entries[pair[1]]];
        let same = (a.offset, a.len, a.checksum) == (b.offset, b.len, b.checksum);
        if !same && b.offset < a.offset + u64::from(a.len) {
            return Err((pair[1], format!("blob at byte {} overlaps that of tile {}", b.offset, pair[0])));
        }
    }
    Ok(())
}

impl TileSource for PcastFile {
    fn name(&self) -> String {
        self.path.display().to_string()
    }

    fn dims(&self) -> [u32; 3] {
        PcastFile::dims(self)
    }

    fn encoding(&self) -> Encoding {
        self.encoding
    }

    fn color(&self) -> ColorMode {
        self.color
    }

    fn about(&self) -> About {
        (*self.about).clone()
    }

    fn heights(&self, level: u32) -> [u32; 2] {
        let grid = &self.grids[level as usize];
        heights(&self.entries[grid.first as usize..][..grid.n_tiles() as usize])
    }

    fn is_height_field(&self) -> bool {
        self.about.may_be_height_field() && self.encoding == Encoding::Solid
    }

    fn is_empty(&self, key: TileKey) -> bool {
        self.entries[self.tile_ix(key.level as usize, key.x, key.z)].is_empty()
    }

    fn tile(&self, key: TileKey) -> Result<Level> {
        PcastFile::tile(self, key.level as usize, key.x, key.z)
    }

    fn bytes(&self, key: TileKey) -> u64 {
        self.entries[self.tile_ix(key.level as usize, key.x, key.z)].len.into()
    }

    fn has_matter(&self) -> bool {
        PcastFile::has_matter(self)
    }
}

/// The lowest voxel of some tiles, and one past the highest; equal where they are empty.
pub(crate) fn heights<'a>(tiles: impl IntoIterator<Item = &'a TileEntry>) -> [u32; 2] {
    let found = tiles.into_iter().filter(|tile| !tile.is_empty());
    let [bottom, top] = found
        .fold([u32::MAX, 0], |[bottom, top], tile| [bottom.min(tile.y_min.into()), top.max(u32::from(tile.y_max) + 1)]);
    [bottom.min(top), top]
}

/// What a header says, after it was found to be right.
pub(crate) struct Outline {
    pub encoding: Encoding,
    pub color: ColorMode,
    pub mip_rule: MipRule,
    pub grids: Vec<Grid>,
    /// That entries of the directory may have.
    pub flags: u32,
}

impl Outline {
    /// From a file's first bytes; `len` is how many it has.
    pub(crate) fn check(path: &Path, head: &[u8], len: u64) -> Result<Outline> {
        let wrong = |at: usize, what: String| Err(Error::format(path, format!("byte {at}: {what}")));
        let Some(header) = head.get(..size_of::<Header>()) else {
            return Err(too_short(path, head.len() as u64));
        };
        let header: Header = pod_read_unaligned(header);
        if header.magic != format::MAGIC {
            return Err(Error::format(
                path,
                "not a .pcast scene (byte 0: other magic number); make one with `planecast encode`",
            ));
        }
        let flags = match header.version[0] {
            1 => EMPTY,
            2 => EMPTY | COMPRESSED,
            3 => EMPTY | COMPRESSED | SPECIALIZED,
            4 => EMPTY | COMPRESSED | SPECIALIZED | MATTER,
            other => return wrong(8, format!("version {other} of .pcast, this program reads versions 1 to 4")),
        };
        if header.checksum != header.checksum() {
            return wrong(56, "the header does not match its checksum; the file is damaged".into());
        }
        if header.file_len != len {
            let (found, expected) = (len, header.file_len);
            return wrong(
                40,
                format!("the file has {found} bytes, its header says {expected}; it was cut short or added to"),
            );
        }
        let dims = header.dims;
        let n_columns = u64::from(dims[0]) * u64::from(dims[2]);
        if dims.contains(&0) || dims[1] > 65_536 || n_columns > format::MAX_COLUMNS {
            return wrong(
                12,
                format!(
                    "{} × {} × {} voxels; 1 to 65,536 high and at most 2³¹ columns were expected",
                    dims[0], dims[1], dims[2]
                ),
            );
        }
        let encodings = [Encoding::Solid, Encoding::Surface];
        let Some(&encoding) = encodings.get(header.encoding as usize) else {
            return wrong(24, format!("encoding {}, 0 or 1 was expected", header.encoding));
        };
        let Some(&color) = [ColorMode::None, ColorMode::Run, ColorMode::Voxel].get(header.color as usize) else {
            return wrong(25, format!("colour mode {}, 0 to 2 was expected", header.color));
        };
        let Some(&mip_rule) = [MipRule::Any, MipRule::Majority].get(header.mip_rule as usize) else {
            return wrong(26, format!("mip rule {}, 0 or 1 was expected", header.mip_rule));
        };
        let grids = format::grids(dims);
        if header.n_levels as usize != grids.len() {
            return wrong(27, format!("{} levels, {} were expected", header.n_levels, grids.len()));
        }
        let n_tiles: u64 = grids.iter().map(Grid::n_tiles).sum();
        if u64::from(header.n_tiles) != n_tiles {
            return wrong(28, format!("{} tiles, {n_tiles} were expected", header.n_tiles));
        }
        let directory = header.directory.checked_add(n_tiles * size_of::<TileEntry>() as u64);
        if header.directory < size_of::<Header>() as u64 || directory.is_none_or(|end| end > len) {
            return wrong(
                32,
                format!("a directory of {n_tiles} tiles at byte {} does not fit the file", header.directory),
            );
        }
        Ok(Outline { encoding, color, mip_rule, grids, flags })
    }
}

/// What the tiles of a scene hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Modes {
    pub encoding: Encoding,
    pub color: ColorMode,
}

impl Modes {
    /// From the codes of a header.
    pub(crate) fn from_codes(encoding: u8, color: u8) -> Option<Modes> {
        let encoding = [Encoding::Solid, Encoding::Surface].get(encoding as usize).copied()?;
        let color = [ColorMode::None, ColorMode::Run, ColorMode::Voxel].get(color as usize).copied()?;
        Some(Modes { encoding, color })
    }

    /// Whether a tile has exposed runs: as its geometry, or to find colours by.
    pub(crate) fn shows(self) -> bool {
        self.encoding == Encoding::Surface || self.color == ColorMode::Voxel
    }
}

/// Where a blob is and what it should hold.
#[derive(Clone, Copy)]
pub(crate) struct Place<'a> {
    /// What errors call the file.
    pub path: &'a Path,
    pub level: usize,
    pub tx: u32,
    pub tz: u32,
    /// Of the blob in the file.
    pub offset: u64,
    /// Of its entry in the directory.
    pub flags: u32,
    pub modes: Modes,
    /// Of the tile.
    pub dims: [u32; 3],
}

/// A blob as it was before it was compressed.
fn unframed<'a>(place: &Place, bytes: Cow<'a, [u8]>) -> Result<Cow<'a, [u8]>> {
    if place.flags & COMPRESSED == 0 {
        return Ok(bytes);
    }
    // Memory grows with what the frame really holds, not with what it claims.
    let mut unpacked = Vec::new();
    unzstd(&bytes)
        .and_then(|frame| frame.take(u64::from(u32::MAX)).read_to_end(&mut unpacked))
        .map_err(|e| place.error(0, format!("zstd, after {} bytes: {e}", unpacked.len())))?;
    Ok(Cow::Owned(unpacked))
}

/// The blob of a tile's solid part, from its bytes as they are stored; None of a tile that has matter alone.
fn unpack<'a>(mut place: Place<'a>, bytes: Cow<'a, [u8]>) -> Result<Option<Blob<'a>>> {
    let stored = bytes.len();
    let bytes = unframed(&place, bytes)?;
    if place.flags & MATTER == 0 {
        return Blob::new(place, bytes, stored).map(Some);
    }
    let solid = parts(&place, &bytes)?.0;
    place.offset += solid.start as u64;
    let bytes = match bytes {
        Cow::Borrowed(bytes) => Cow::Borrowed(&bytes[solid]),
        Cow::Owned(bytes) => Cow::Owned(bytes[solid].to_vec()),
    };
    if bytes.is_empty() { Ok(None) } else { Blob::new(place, bytes, stored).map(Some) }
}

/// Where the solid part and the matter of a blob with both are.
fn parts(place: &Place, bytes: &[u8]) -> Result<(Range<usize>, Range<usize>)> {
    let header = format::MATTER_HEADER;
    if bytes.len() < header || bytes[4..header].iter().any(|&b| b != 0) {
        let what = format!("{} bytes; matter has a header of {header}, whose last 12 are 0", bytes.len());
        return Err(place.error(0, what));
    }
    let end = header as u64 + u64::from(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]));
    let start = end.next_multiple_of(ALIGN);
    if start > bytes.len() as u64 || bytes[end as usize..start as usize].iter().any(|&b| b != 0) {
        return Err(place.error(0, format!("a solid part up to {end} of {} bytes, with zeros behind it", bytes.len())));
    }
    Ok((header..end as usize, start as usize..bytes.len()))
}

/// The matter of a blob that has any.
pub(crate) fn decode_matter(place: &Place, bytes: Cow<[u8]>, max_code: u16) -> Result<Matter> {
    let bytes = unframed(place, bytes)?;
    let (_, matter) = parts(place, &bytes)?;
    let at = matter.start;
    Matter::unpack(&bytes[matter], place.dims, max_code).map_err(|(byte, what)| place.error(at + byte, what))
}

/// A tile from its bytes as they are stored, every one of them checked; from none an empty one. Matter is left out.
pub(crate) fn read_tile(place: Place, bytes: Option<Vec<u8>>, entry: &TileEntry) -> Result<Level> {
    let Some(bytes) = bytes else { return Ok(place.empty()) };
    if xxh3_64(&bytes) != entry.checksum {
        return Err(place.error(0, "does not match its checksum; the file is damaged"));
    }
    let Some(blob) = unpack(place, Cow::Owned(bytes))? else { return Ok(place.empty()) };
    let tile = blob.level()?;
    blob.check_figures(&tile, entry)?;
    Ok(tile)
}

/// A tile from its blob, every byte of it checked; from no bytes an empty one. Of matter, `max_code` is the highest code.
pub(crate) fn decode_tile(mut place: Place, bytes: &[u8], max_code: u16) -> Result<Level> {
    if place.flags & MATTER != 0 {
        let matter = decode_matter(&place, Cow::Borrowed(bytes), max_code)?;
        let bytes = unframed(&place, Cow::Borrowed(bytes))?;
        let solid = parts(&place, &bytes)?.0;
        place.flags &= !(MATTER | COMPRESSED);
        return Ok(Level { matter: Some(Arc::new(matter)), ..decode_tile(place, &bytes[solid], max_code)? });
    }
    if bytes.is_empty() { Ok(place.empty()) } else { Blob::new(place, Cow::Borrowed(bytes), bytes.len())?.level() }
}

impl Place<'_> {
    fn error(&self, at: usize, what: impl std::fmt::Display) -> Error {
        let (level, tx, tz, at) = (self.level, self.tx, self.tz, self.offset + at as u64);
        Error::format(self.path, format!("tile ({tx}, {tz}) of level {level}, byte {at}: {what}"))
    }

    fn empty(&self) -> Level {
        let [nx, ny, nz] = self.dims;
        let none = Columns::empty(nx, ny, nz);
        Level { exposed: self.modes.shows().then(|| none.clone()), solid: none, colors: Vec::new(), matter: None }
    }
}

/// A tile's bytes, cut into sections that lie inside it. What the sections hold is not yet checked.
pub(crate) struct Blob<'a> {
    place: Place<'a>,
    bytes: Cow<'a, [u8]>,
    /// Bytes in the file.
    stored: usize,
    header: BlobHeader,
    forms: Forms,
    width: usize,
    depth: usize,
}

impl<'a> Blob<'a> {
    fn new(place: Place<'a>, bytes: Cow<'a, [u8]>, stored: usize) -> Result<Blob<'a>> {
        let Some(header) = bytes.get(..size_of::<BlobHeader>()) else {
            return Err(place.error(0, format!("{} bytes; a blob has a header of 64", bytes.len())));
        };
        let header: BlobHeader = pod_read_unaligned(header);
        let (width, depth) = (place.dims[0] as usize, place.dims[2] as usize);
        if (header.width as usize, header.depth as usize) != (width, depth) {
            let (w, d) = (header.width, header.depth);
            return Err(place.error(0, format!("{w} × {d} columns, {width} × {depth} were expected")));
        }
        let specialized = place.flags & SPECIALIZED != 0;
        if !specialized && header.forms & !GENERAL != 0 {
            let what = format!(
                "forms {:#x} of a tile that is not specialized, at most {GENERAL:#x} was expected",
                header.forms
            );
            return Err(place.error(4, what));
        }
        let Some(forms) = Forms::unpack(header.forms, place.dims[1]) else {
            return Err(place.error(4, format!("forms {:#x}, which no tile of this height has", header.forms)));
        };
        let painted = match place.modes.color {
            ColorMode::None => forms.painted == Painted::Each,
            ColorMode::Run => forms.painted != Painted::Run,
            ColorMode::Voxel => true,
        };
        if !painted {
            return Err(place.error(4, format!("forms {:#x}, with colours that the scene does not have", header.forms)));
        }
        if let Lists::Packed { bits, .. } = forms.lists
            && Lists::least_bits(place.modes).is_none_or(|least| bits < least)
        {
            let what = format!("forms {:#x}, with packed lists that scenes of this kind do not have", header.forms);
            return Err(place.error(4, what));
        }
        let blob = Blob { place, bytes, stored, header, forms, width, depth };
        blob.check_sections()?;
        Ok(blob)
    }

    /// Sections that are there, in order, in the blob, and of the length that their forms ask for.
    fn check_sections(&self) -> Result<()> {
        let Blob { place, header, .. } = self;
        let mut end = size_of::<BlobHeader>() as u64;
        for section in Section::ALL {
            let [offset, len] = header.sections[section as usize].map(u64::from);
            let wrong = |what: String| {
                Err(place.error(8 + 8 * section as usize, format!("section {}: {what}", section.name())))
            };
            if !self.has(section) {
                if offset != 0 || len != 0 {
                    return wrong("present, but not in scenes of this kind".into());
                }
                continue;
            }
            if offset < end || !offset.is_multiple_of(ALIGN) || offset + len > self.bytes.len() as u64 {
                return wrong(format!("{len} bytes at {offset} of a blob with {}", self.bytes.len()));
            }
            end = offset + len;
            let expected = self.expected_len(section, len as usize);
            if len != expected as u64 {
                return wrong(format!("{len} bytes, {expected} were expected"));
            }
        }
        if end != self.bytes.len() as u64 {
            return Err(place.error(0, format!("{} bytes, its sections end at {end}", self.bytes.len())));
        }
        let Modes { encoding, color } = place.modes;
        let tables = [Section::GeometryTable, Section::ExposureTable, Section::ColorTable];
        for table in tables.into_iter().filter(|&table| !self.has(table)) {
            let even =
                self.forms.table(table) == Table::Even && table.present(encoding, color) && self.has_starts(table);
            if self.forms.table(table) != Table::Short && !even {
                let what = format!("forms {:#x} for a {} that is not there", header.forms, table.name());
                return Err(place.error(4, what));
            }
            if even && !self.len_of(table.columns()).is_multiple_of(self.n_columns()) {
                let what = format!("{} bytes are not the same for all columns", self.section(table.columns()).len());
                return Err(place.error(self.offset(table.columns()), what));
            }
        }
        if let (Some(heights), true) = (self.heights(), place.modes.shows()) {
            for ix in edges(self.width, self.depth) {
                let (h, low) = (heights.height(ix), heights.low(ix));
                if (h < 2 && low != 0) || (h >= 2 && !(1..h).contains(&low)) {
                    let what = format!("lowest exposed voxel {low} of a height of {h}");
                    return Err(self.column_error(Section::Exposure, 0, ix, what));
                }
            }
        }
        Ok(())
    }

    /// Whether the blob has a section.
    fn has(&self, section: Section) -> bool {
        let Modes { encoding, color } = self.place.modes;
        match section {
            Section::Exposure if self.heights_form().is_some() => self.place.modes.shows(),
            Section::Fill if self.heights_form().is_some() => false,
            Section::GeometryTable | Section::ExposureTable | Section::ColorTable => {
                section.present(encoding, color) && self.has_starts(section) && self.forms.table(section) != Table::Even
            }
            _ => section.present(encoding, color),
        }
    }

    /// Whether the columns of a section start where a table says, or evenly.
    fn has_starts(&self, table: Section) -> bool {
        match table {
            Section::ColorTable => matches!(self.forms.painted, Painted::Each | Painted::Run),
            _ => self.heights_form().is_none(),
        }
    }

    /// Bytes that a section should have; those that it has, where the forms do not tell.
    fn expected_len(&self, section: Section, len: usize) -> usize {
        let n = self.n_columns();
        match section {
            Section::GeometryTable | Section::ExposureTable | Section::ColorTable => match self.forms.table(section) {
                Table::Short => 4 * self.depth + 2 * n,
                Table::Long => 4 * n,
                Table::Even => 0,
                Table::Grouped if section == Section::ColorTable => 4 * n.div_ceil(1 << COLOR_GROUP_SHIFT),
                Table::Grouped => 4 * n.div_ceil(1 << self.forms.group_shift) + n,
            },
            Section::Fill => (self.header.sections[Section::Geometry as usize][1] as usize).div_ceil(16),
            Section::Geometry => self.heights_form().map_or(len, |(bytes, _)| bytes * n),
            Section::Exposure if self.heights_form().is_some() => 2 * n_edges(self.width, self.depth),
            Section::Exposure => len,
            Section::Colors => match self.forms.painted {
                Painted::Tile => 3,
                Painted::Column => 3 * n,
                Painted::Each | Painted::Run => len - len % 3,
            },
        }
    }

    fn n_columns(&self) -> usize {
        self.width * self.depth
    }

    /// Bytes a column and base, of a tile of heights.
    fn heights_form(&self) -> Option<(usize, u32)> {
        match self.forms.lists {
            Lists::Heights { bytes, base } => Some((bytes, base)),
            Lists::Runs { .. } | Lists::Packed { .. } => None,
        }
    }

    fn heights(&self) -> Option<Heights<'_>> {
        let (bytes, base) = self.heights_form()?;
        let (above, edges) = (self.section(Section::Geometry), self.section(Section::Exposure));
        Some(Heights { width: self.width, depth: self.depth, bytes, base, above, edges })
    }

    /// Form and base of the runs of a section, of a tile of lists.
    fn list_form(&self, section: Section) -> (Form, u32) {
        self.forms.lists.of(section, self.place.dims[1])
    }

    /// All that the tile holds, checked.
    pub(crate) fn level(&self) -> Result<Level> {
        let Modes { encoding, color } = self.place.modes;
        let shows = self.place.modes.shows();
        let ny = self.place.dims[1];
        let (solid, exposed) = match (self.heights(), encoding) {
            (Some(heights), _) => {
                self.check_highest(&heights)?;
                (heights.solid(ny), shows.then(|| heights.exposed(ny)))
            }
            (None, Encoding::Surface) => {
                let geometry = self.columns(Section::GeometryTable, Section::Geometry)?;
                (self.filled(&geometry)?, Some(geometry))
            }
            (None, Encoding::Solid) => {
                let geometry = self.columns(Section::GeometryTable, Section::Geometry)?;
                let exposed = shows.then(|| self.columns(Section::ExposureTable, Section::Exposure));
                (geometry, exposed.transpose()?)
            }
        };
        let mut level = Level { solid, exposed, colors: Vec::new(), matter: None };
        level.colors = match color {
            ColorMode::None => Vec::new(),
            ColorMode::Run => self.colors(level.geometry(encoding), false)?,
            ColorMode::Voxel => self.colors(level.exposed.as_ref().expect("read above for this mode"), true)?,
        };
        Ok(level)
    }

    fn check_highest(&self, heights: &Heights) -> Result<()> {
        let ny = self.place.dims[1];
        match (0..self.n_columns()).find(|&ix| heights.height(ix) > ny) {
            None => Ok(()),
            Some(ix) => {
                let what = format!("{} high, at most {ny} was expected", heights.height(ix));
                Err(self.column_error(Section::Geometry, heights.bytes * ix, ix, what))
            }
        }
    }

    pub(crate) fn section(&self, section: Section) -> &[u8] {
        let [offset, len] = self.header.sections[section as usize].map(|n| n as usize);
        &self.bytes[offset..offset + len]
    }

    #[cfg(test)]
    pub(crate) fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Of the blob in the file.
    pub(crate) fn file_offset(&self) -> u64 {
        self.place.offset
    }

    /// Bytes in the file, and unpacked.
    pub(crate) fn lens(&self) -> [usize; 2] {
        [self.stored, self.bytes.len()]
    }

    pub(crate) fn forms(&self) -> Forms {
        self.forms
    }

    /// Height of its level.
    pub(crate) fn ny(&self) -> u32 {
        self.place.dims[1]
    }

    fn offset(&self, section: Section) -> usize {
        self.header.sections[section as usize][0] as usize
    }

    /// What tables count in a section: bytes, or colours.
    fn len_of(&self, section: Section) -> usize {
        let len = self.section(section).len();
        if section == Section::Colors { len / 3 } else { len }
    }

    /// The start that `table` gives to column number `ix`; past the last, the end.
    fn start(&self, table: Section, ix: usize) -> usize {
        let bytes = self.section(table);
        let u32_at = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes")) as usize;
        let n = self.n_columns();
        if ix == n {
            return self.len_of(table.columns());
        }
        match self.forms.table(table) {
            Table::Short => {
                let at = 4 * self.depth + 2 * ix;
                u32_at(4 * (ix / self.width)) + u16::from_le_bytes([bytes[at], bytes[at + 1]]) as usize
            }
            Table::Long => u32_at(4 * ix),
            Table::Even => self.len_of(table.columns()) / n * ix,
            Table::Grouped if table == Section::ColorTable => {
                let group = ix >> COLOR_GROUP_SHIFT;
                let before = (group << COLOR_GROUP_SHIFT..ix).map(|ix| self.n_colors(ix)).sum::<usize>();
                u32_at(4 * group) + before
            }
            Table::Grouped => {
                let shift = self.forms.group_shift;
                let offset = bytes[4 * n.div_ceil(1 << shift) + ix] as usize;
                u32_at(4 * (ix >> shift)) + self.forms.unit() * offset
            }
        }
    }

    /// The starts that a table gives, and the end; of grouped colour tables those of groups. A start past 32 bits, which no
    /// section reaches, is the highest there is.
    fn starts(&self, table: Section) -> Vec<u32> {
        let n = self.n_columns();
        let bytes = self.section(table);
        let len = self.len_of(table.columns()) as u32;
        let u32s = |bytes: &[u8]| bytes.as_chunks().0.iter().map(|&b| u32::from_le_bytes(b)).collect::<Vec<_>>();
        let mut starts = Vec::with_capacity(n + 1);
        match self.forms.table(table) {
            Table::Short => {
                let (bases, offsets) = bytes.split_at(4 * self.depth);
                let rows = offsets.as_chunks::<2>().0.chunks(self.width);
                for (base, row) in u32s(bases).into_iter().zip(rows) {
                    starts.extend(row.iter().map(|&offset| base.saturating_add(u16::from_le_bytes(offset).into())));
                }
            }
            Table::Long => starts.extend(u32s(bytes)),
            Table::Even => starts.extend((0..n as u32).map(|ix| len / n as u32 * ix)),
            Table::Grouped if table == Section::ColorTable => starts.extend(u32s(bytes)),
            Table::Grouped => {
                let unit = self.forms.unit() as u32;
                let shift = self.forms.group_shift;
                let (bases, offsets) = bytes.split_at(4 * n.div_ceil(1 << shift));
                for (base, group) in u32s(bases).into_iter().zip(offsets.chunks(1 << shift)) {
                    starts.extend(group.iter().map(|&offset| base.saturating_add(unit * u32::from(offset))));
                }
            }
        }
        starts.push(len);
        starts
    }

    /// Colours of column number `ix`, by its runs; arbitrary where those are forged.
    fn n_colors(&self, ix: usize) -> usize {
        let Modes { encoding, color } = self.place.modes;
        let exposes = color == ColorMode::Voxel || encoding == Encoding::Surface;
        let [runs, voxels] = match self.heights() {
            Some(heights) if exposes => heights.count_exposed(ix),
            Some(heights) => [usize::from(heights.height(ix) > 0), 0],
            None => {
                let lists = match encoding {
                    Encoding::Solid if exposes => Section::Exposure,
                    _ => Section::Geometry,
                };
                let table = if lists == Section::Exposure { Section::ExposureTable } else { Section::GeometryTable };
                self.column(table, lists, ix).map_or([0; 2], |c| column_rle::count(c.1, self.list_form(lists).0))
            }
        };
        if color == ColorMode::Voxel && self.forms.painted == Painted::Each { voxels } else { runs }
    }

    /// Start and bytes of column number `ix`.
    fn column(&self, table: Section, lists: Section, ix: usize) -> Result<(usize, &[u8])> {
        let bytes = self.section(lists);
        let (start, end) = (self.start(table, ix), self.start(table, ix + 1));
        let column = bytes.get(start..end).ok_or_else(|| {
            let what = format!("bytes {start} to {end} of {} in section {}", bytes.len(), lists.name());
            self.column_error(table, 0, ix, what)
        })?;
        Ok((start, column))
    }

    fn column_error(&self, section: Section, at: usize, ix: usize, what: impl std::fmt::Display) -> Error {
        let (x, z) = (ix % self.width, ix / self.width);
        self.place.error(self.offset(section) + at, format!("column ({x}, {z}) of the tile: {what}"))
    }

    /// All columns of a list, checked.
    fn columns(&self, table: Section, lists: Section) -> Result<Columns> {
        let ny = self.place.dims[1];
        let (form, base) = self.list_form(lists);
        let highest = if form == Form::Narrow { (ny - base).min(256) } else { ny - base };
        let n_columns = self.n_columns();
        let mut offsets = Vec::with_capacity(n_columns + 1);
        let mut runs: Vec<Run> = Vec::new();
        offsets.push(0);
        let mut end = 0;
        let bytes = self.section(lists);
        for (ix, pair) in self.starts(table).windows(2).enumerate() {
            let start = pair[0] as usize;
            let len = match bytes.get(start..pair[1] as usize) {
                Some(column) => column.len(),
                None => self.column(table, lists, ix)?.1.len(),
            };
            if start != end {
                return Err(self.column_error(table, 0, ix, format!("starts at byte {start}, {end} was expected")));
            }
            end = start + len;
            let before = runs.len();
            column_rle::decode_first(&bytes[start..], len, form, highest, &mut runs)
                .map_err(|fault| self.column_error(lists, start + fault.at, ix, fault.what))?;
            if base > 0 {
                let raised = |r: Run| Run::new(r.first() + base as u16, r.last() + base as u16);
                runs[before..].iter_mut().for_each(|r| *r = raised(*r));
            }
            // A tile has at most 65,536 columns of 32,768 runs.
            offsets.push(runs.len() as u32);
        }
        if end != self.section(lists).len() {
            return Err(self.place.error(self.offset(lists) + end, "bytes that belong to no column"));
        }
        Ok(Columns::from_parts(self.width as u32, ny, self.depth as u32, offsets, runs))
    }

    fn fill(&self, bit: usize) -> bool {
        self.section(Section::Fill).get(bit / 8).is_some_and(|b| b >> (bit % 8) & 1 == 1)
    }

    /// The solid runs of a surface tile: its runs and the gaps whose fill bit is set.
    fn filled(&self, shown: &Columns) -> Result<Columns> {
        let mut solid = ColumnsBuilder::new(shown.nx(), shown.ny(), shown.nz());
        let starts = self.starts(Section::GeometryTable);
        for (ix, &start) in starts[..self.n_columns()].iter().enumerate() {
            let runs = &shown.runs()[shown.range(ix)];
            for (i, run) in runs.iter().enumerate() {
                let mut run = *run;
                let bit = start as usize / 2 + i;
                if self.fill(bit) {
                    let Some(above) = runs.get(i + 1) else {
                        let what = "the gap above the last run is marked as solid";
                        return Err(self.column_error(Section::Fill, bit / 8, ix, what));
                    };
                    // Merges with the run above when that is pushed.
                    run = Run::new(run.first(), above.first() - 1);
                }
                solid.push_run(run);
            }
            solid.end_column();
        }
        Ok(solid.finish())
    }

    /// Whether voxel `y` of column number `ix` is solid; and which run and which voxel it is of those that have colours,
    /// counted in the column.
    fn look(&self, ix: usize, y: u32) -> Result<(bool, Option<[usize; 2]>)> {
        let Modes { encoding, color } = self.place.modes;
        let exposes = color == ColorMode::Voxel || encoding == Encoding::Surface;
        if let Some(heights) = self.heights() {
            let solid = y < heights.height(ix);
            let shown = if exposes { heights.find_exposed(ix, y) } else { solid.then_some([0, y as usize]) };
            return Ok((solid, shown));
        }
        let (form, base) = self.list_form(Section::Geometry);
        let Some(above_base) = y.checked_sub(base) else { return Ok((false, None)) };
        let (start, column) = self.column(Section::GeometryTable, Section::Geometry, ix)?;
        let Some(place) = column_rle::at_or_below(column, form, above_base) else { return Ok((false, None)) };
        // A forged column's run may start above y.
        let above = above_base.checked_sub(place.start).filter(|&above| above < place.len);
        let shown = above.map(|above| [place.run, place.color.wrapping_add(above) as usize]);
        if shown.is_none() {
            return Ok((encoding == Encoding::Surface && self.fill(start / 2 + place.run), None));
        }
        if encoding == Encoding::Solid && color == ColorMode::Voxel {
            let (_, column) = self.column(Section::ExposureTable, Section::Exposure, ix)?;
            let (form, base) = self.list_form(Section::Exposure);
            let found = y.checked_sub(base).and_then(|y| column_rle::find(column, form, y));
            return Ok((true, found.map(|(run, voxel)| [run, voxel as usize])));
        }
        Ok((true, shown))
    }

    /// The colour of a run and voxel that [`Blob::look`] found.
    fn color(&self, ix: usize, [run, voxel]: [usize; 2]) -> Result<Rgb> {
        let in_column = if self.place.modes.color == ColorMode::Voxel { voxel } else { run };
        let i = match self.forms.painted {
            Painted::Tile => 0,
            Painted::Column => ix,
            Painted::Run => self.start(Section::ColorTable, ix) + run,
            Painted::Each => self.start(Section::ColorTable, ix) + in_column,
        };
        let color = self.section(Section::Colors).get(3 * i..3 * i + 3);
        let color =
            color.ok_or_else(|| self.column_error(Section::ColorTable, 0, ix, format!("has no colour {in_column}")))?;
        Ok([color[0], color[1], color[2]])
    }

    /// One colour a run of `of`, or one a voxel of them.
    fn colors(&self, of: &Columns, voxels: bool) -> Result<Vec<Rgb>> {
        let (colors, _) = self.section(Section::Colors).as_chunks::<3>();
        let starts = match voxels {
            true => of.voxel_offsets(),
            false => of.offsets().iter().map(|&n| u64::from(n)).collect(),
        };
        // What the file holds one colour of, and how many of each follow it.
        let stored = match self.forms.painted {
            Painted::Tile => return Ok(vec![colors[0]; starts[starts.len() - 1] as usize]),
            Painted::Column => {
                let columns = colors.iter().zip(starts.windows(2));
                return Ok(columns.flat_map(|(&c, n)| std::iter::repeat_n(c, (n[1] - n[0]) as usize)).collect());
            }
            Painted::Run => of.offsets().iter().map(|&n| u64::from(n)).collect(),
            Painted::Each => starts,
        };
        let n = stored[stored.len() - 1];
        if colors.len() as u64 != n {
            let what = format!("{} bytes of colours, {} were expected", 3 * colors.len(), 3 * n);
            return Err(self.place.error(self.offset(Section::Colors), what));
        }
        // A grouped table tells where groups start, the rest is counted in what was checked already.
        let step = if self.forms.table(Section::ColorTable) == Table::Grouped { 1 << COLOR_GROUP_SHIFT } else { 1 };
        for (ix, &expected) in stored[..stored.len() - 1].iter().enumerate().step_by(step) {
            let found = self.start(Section::ColorTable, ix);
            if found as u64 != expected {
                let what = format!("{found} colours before it, {expected} were expected");
                return Err(self.column_error(Section::ColorTable, 0, ix, what));
            }
        }
        Ok(match self.forms.painted {
            Painted::Run => {
                let runs = colors.iter().zip(of.runs());
                runs.flat_map(|(&c, run)| std::iter::repeat_n(c, run.len() as usize)).collect()
            }
            _ => colors.to_vec(),
        })
    }

    /// The figures of the directory must be those of the tile.
    fn check_figures(&self, level: &Level, entry: &TileEntry) -> Result<()> {
        let place = &self.place;
        let runs = level.solid.runs();
        let found = TileEntry {
            n_solid: level.solid.voxels(),
            // Without exposed runs only the neighbour tiles could tell.
            n_exposed: level.exposed.as_ref().map_or(entry.n_exposed, Columns::voxels),
            n_runs: level.geometry(place.modes.encoding).runs().len() as u32,
            y_min: runs.iter().map(|r| r.first()).min().unwrap_or(u16::MAX),
            y_max: runs.iter().map(|r| r.last()).max().unwrap_or(0),
            ..*entry
        };
        match found == *entry {
            true => Ok(()),
            false => {
                let what = format!("holds {}, its directory entry says {}", figures(&found), figures(entry));
                Err(self.place.error(0, what))
            }
        }
    }
}

fn figures(e: &TileEntry) -> String {
    format!(
        "{} solid and {} exposed voxels, {} runs, heights {} to {}",
        e.n_solid, e.n_exposed, e.n_runs, e.y_min, e.y_max
    )
}

#[cfg(test)]
mod tests {
    use std::mem::offset_of;

    use proptest::prelude::*;

    use super::*;
    use crate::format::write::{self, SceneWriter, write_scene, write_scene_with};
    use crate::testing::{self, reseal, voxel_positions};
    use crate::{BuildOptions, Feature, Features, build};

    const MODES: [(Encoding, ColorMode); 6] = [
        (Encoding::Solid, ColorMode::None),
        (Encoding::Solid, ColorMode::Run),
        (Encoding::Solid, ColorMode::Voxel),
        (Encoding::Surface, ColorMode::None),
        (Encoding::Surface, ColorMode::Run),
        (Encoding::Surface, ColorMode::Voxel),
    ];

    fn scene(columns: Columns, (encoding, color): (Encoding, ColorMode)) -> Scene {
        let opts = BuildOptions { encoding, color: Some(color), ..Default::default() };
        build(testing::input(columns, color != ColorMode::None), &opts).unwrap()
    }

    fn written_with(scene: &Scene, features: Features) -> Vec<u8> {
        let mut bytes = std::io::Cursor::new(Vec::new());
        write_scene_with(scene, features, &mut bytes, Path::new("a.pcast")).unwrap();
        bytes.into_inner()
    }

    /// In the general layout.
    fn written(scene: &Scene) -> Vec<u8> {
        written_with(scene, Features::NONE)
    }

    fn features() -> impl Iterator<Item = Features> {
        let single = Feature::ALL.map(|f| Features::from_iter([f]));
        let without = Feature::ALL.map(|f| Feature::ALL.into_iter().filter(|&other| other != f).collect());
        [Features::NONE, Features::ALL].into_iter().chain(single).chain(without)
    }

    fn opened(bytes: Vec<u8>) -> Result<PcastFile> {
        PcastFile::from_bytes("a.pcast", bytes)
    }

    fn read(bytes: Vec<u8>) -> Result<Scene> {
        opened(bytes)?.read_scene()
    }

    /// Text of the error that `bytes` must give.
    fn refused(bytes: Vec<u8>) -> String {
        read(bytes).expect_err("a planted fault must be found").to_string()
    }

    fn check_round_trip(columns: Columns) {
        for mode in MODES {
            let scene = scene(columns.clone(), mode);
            check_round_trip_of(&scene);
        }
    }

    fn check_round_trip_of(scene: &Scene) {
        for features in features() {
            let file = opened(written_with(scene, features)).unwrap();
            assert_eq!(&file.read_scene().unwrap(), scene, "{:?} {:?} {features}", scene.encoding, scene.color);
            check_queries(&file, scene);
        }
    }

    /// The same scene in colours that are finer than they need to be.
    fn repainted(scene: &Scene, by: u32) -> Scene {
        let mut scene = scene.clone();
        for level in &mut scene.levels {
            let of = if scene.color == ColorMode::Voxel { level.exposed.as_ref() } else { None };
            let of = of.unwrap_or(level.geometry(scene.encoding));
            let mut i = 0;
            let mut colors = Vec::new();
            for (ix, k) in (0..of.offsets().len() - 1).flat_map(|ix| of.range(ix).map(move |k| (ix, k))) {
                let n = if scene.color == ColorMode::Voxel { of.runs()[k].len() } else { 1 };
                for _ in 0..n {
                    let seed = [0, ix as u32, k as u32, i][by as usize];
                    colors.push(testing::color_of(seed, seed / 7, seed / 3));
                    i += 1;
                }
            }
            assert_eq!(colors.len(), level.colors.len());
            level.colors = colors;
        }
        scene
    }

    fn check_queries(file: &PcastFile, scene: &Scene) {
        let level = &scene.levels[0];
        let [nx, ny, nz] = scene.dims();
        let shown = level.exposed.as_ref().map(voxel_positions);
        for (x, z) in (0..nx).flat_map(|x| (0..nz).map(move |z| (x, z))) {
            for y in 0..ny {
                let solid = level.solid.find(x, y, z).is_some();
                let color = match scene.color {
                    ColorMode::None => None,
                    ColorMode::Run => level.geometry(scene.encoding).find(x, y, z).map(|i| level.colors[i]),
                    ColorMode::Voxel => shown.as_ref().unwrap().get(&(x, y, z)).map(|&i| level.colors[i]),
                };
                let found = file.query(x.into(), y.into(), z.into()).unwrap();
                assert_eq!(found, Voxel { solid, color }, "({x}, {y}, {z})");
            }
        }
        let outside = [(-1, 0, 0), (0, -1, 0), (0, 0, -1), (nx.into(), 0, 0), (0, ny.into(), 0), (0, 0, nz.into())];
        for (x, y, z) in outside {
            assert_eq!(file.query(x, y, z).unwrap(), Voxel { solid: false, color: None });
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        #[test]
        fn pcast_gives_back_small_scenes(columns in testing::small_world()) {
            check_round_trip(columns);
        }

        #[test]
        fn pcast_gives_back_tall_scenes(columns in testing::tall_world(900)) {
            check_round_trip(columns);
        }

        #[test]
        fn pcast_gives_back_height_fields(columns in testing::height_field()) {
            check_round_trip(columns);
        }

        #[test]
        fn pcast_gives_back_colors_that_are_finer_than_they_need_to_be(columns in testing::small_world()) {
            for mode in MODES.into_iter().filter(|m| m.1 != ColorMode::None) {
                let scene = scene(columns.clone(), mode);
                (0..4).for_each(|by| check_round_trip_of(&repainted(&scene, by)));
            }
        }
    }

    /// Several tiles, some of them empty, hidden voxels across tile borders.
    fn hills() -> Columns {
        Columns::from_fn(530, 24, 270, |x, y, z| x < 300 && (y < 12 + (x * z) % 5 || (x ^ z) % 31 == y))
    }

    #[test]
    fn pcast_gives_back_scenes_of_several_tiles() {
        for mode in MODES {
            let scene = scene(hills(), mode);
            let file = opened(written(&scene)).unwrap();
            assert!(file.entries().iter().any(TileEntry::is_empty));
            assert!(file.read_scene().unwrap() == scene, "{mode:?}");
            let tile = file.tile(0, 1, 1).unwrap();
            assert_eq!(tile.solid.dims(), [256, 24, 14]);
            assert_eq!(tile.solid.column(3, 5), scene.levels[0].solid.column(259, 261));
            assert!(file.tile(0, 2, 0).unwrap().solid.runs().is_empty());
        }
    }

    #[test]
    fn pcast_gives_back_the_tallest_columns() {
        // Full, every second voxel (32,768 runs), empty, one run a bucket.
        let columns = Columns::from_fn(2, 65_536, 2, |x, y, z| match (x, z) {
            (0, 0) => true,
            (1, 0) => y % 2 == 1,
            (0, _) => false,
            _ => y % 256 < 3,
        });
        for mode in MODES {
            let scene = Scene { mip_rule: MipRule::Majority, ..scene(columns.clone(), mode) };
            for features in [Features::NONE, Features::ALL] {
                let file = opened(written_with(&scene, features)).unwrap();
                assert!(file.read_scene().unwrap() == scene, "{mode:?}");
                let solid = |x, y, z| file.query(x, y, z).unwrap().solid;
                assert!(solid(0, 0, 0) && solid(0, 40_000, 0) && solid(0, 65_535, 0));
                assert!(!solid(1, 65_534, 0) && solid(1, 65_535, 0) && !solid(0, 9, 1));
                assert!(solid(1, 65_282, 1) && !solid(1, 65_283, 1) && !solid(1, 65_535, 1));
            }
            // Heights that 16 bits do not hold, and those that just fit.
            for low in [0, 1, 65_535, 65_536] {
                let full = Columns::from_fn(2, 65_536, 1, |x, y, _| x == 1 || y < low);
                let scene = self::scene(full, mode);
                for features in [Features::NONE, Features::ALL] {
                    let file = opened(written_with(&scene, features)).unwrap();
                    assert!(file.read_scene().unwrap() == scene, "{mode:?} {low}");
                    for y in [0, 1, 32_767, 65_534, 65_535] {
                        assert_eq!(file.query(0, y, 0).unwrap().solid, y < i64::from(low), "{low}");
                        assert!(file.query(1, y, 0).unwrap().solid);
                    }
                }
            }
        }
    }

    /// A height field with a few caves in one of its tiles, and heights far from 0 in another.
    fn mixed() -> Columns {
        Columns::from_fn(520, 400, 20, |x, y, z| match x / 256 {
            0 => y < 20 + (x * z) % 90 && !(x == 9 && z == 4),
            1 => y > 130 && y < 180 + x % 100 && (y + x + z) % 40 > 5,
            _ => y < 40,
        })
    }

    #[test]
    fn pcast_gives_back_mixtures_of_tiles_and_specializes_each() {
        for mode in MODES {
            let scene = scene(mixed(), mode);
            for features in features() {
                let bytes = written_with(&scene, features);
                let file = opened(bytes.clone()).unwrap();
                assert!(file.read_scene().unwrap() == scene, "{mode:?} {features}");
                let report = crate::inspect::verify::verify(&file, crate::inspect::verify::Depth::Exposure);
                assert!(report.faults.is_empty(), "{mode:?} {features}: {report:?}");
            }
            let file = opened(written_with(&scene, Features::ALL)).unwrap();
            assert_eq!(file.bytes[8], 3);
            let lists = |tx| file.blob(0, tx, 0).unwrap().unwrap().forms().lists;
            assert_eq!(lists(0), Lists::Heights { bytes: 1, base: 0 });
            // Of one run more than half a byte is saved by packing it; colours a voxel ask for lists with a base.
            let narrow = Lists::Runs { form: Form::Narrow, base: 131 };
            let packed = Lists::Packed { bits: 8, base: 128 };
            assert_eq!(lists(1), if mode.1 == ColorMode::Voxel { narrow } else { packed });
            assert_eq!(lists(2), Lists::Heights { bytes: 0, base: 40 });
            let general = opened(written(&scene)).unwrap();
            assert_eq!(general.bytes[8], 1);
            assert!(file.file_len() < general.file_len(), "{mode:?}");
        }
    }

    #[test]
    fn pcast_with_nothing_left_out_is_of_version_1() {
        // Two runs in one column, other runs in others: no table of the general layout is longer than it must be.
        let scene = scene(Columns::from_fn(2, 3, 1, |x, y, _| x == 1 || y != 1), MODES[0]);
        let only_heights = written_with(&scene, Features::from_iter([Feature::Heights, Feature::Lists]));
        let file = opened(only_heights).unwrap();
        assert_eq!(file.entries()[0].flags, 0);
        for (features, version) in [(Features::NONE, 1), (Features::ALL, 3)] {
            assert_eq!(written_with(&scene, features)[8], version);
        }
    }

    #[test]
    fn pcast_packed_lists_are_taken_where_they_are_shorter_and_nothing_numbers_voxels() {
        let layers = Columns::from_fn(7, 700, 5, |x, y, z| y > 40 && (y / 24 + x + z) % 3 == 1);
        for (mode, bits) in MODES.into_iter().zip([Some(10), Some(10), Some(10), Some(10), Some(10), None]) {
            let scene = scene(layers.clone(), mode);
            let good = written_with(&scene, Features::ALL);
            let file = opened(good.clone()).unwrap();
            let forms = file.blob(0, 0, 0).unwrap().unwrap().forms();
            let found = match forms.lists {
                Lists::Packed { bits, base: 32 } => Some(bits),
                _ => None,
            };
            assert_eq!(found, bits, "{mode:?} {forms:?}");
            // A scene of another kind that claims to have them, or with fewer bits than a fill bit a run asks for.
            let at = file.entries()[0].offset as usize + 4;
            let modes = Modes { encoding: mode.0, color: mode.1 };
            for bits in 4..=17 {
                let mut bytes = good.clone();
                let forged = Forms { lists: Lists::Packed { bits, base: 32 }, ..forms };
                bytes[at..at + 4].copy_from_slice(&forged.pack(700).to_le_bytes());
                reseal(&mut bytes);
                let what = "packed lists that scenes of this kind do not have";
                let allowed = Lists::least_bits(modes).is_some_and(|least| bits >= least);
                match read(bytes) {
                    Ok(found) => assert!(found == scene && allowed, "{mode:?} {bits}"),
                    Err(e) => assert_eq!(!e.to_string().contains(what), allowed, "{mode:?} {bits} {e}"),
                }
            }
        }
    }

    #[test]
    fn pcast_height_field_takes_a_byte_a_column() {
        let field = Columns::from_fn(512, 200, 256, |x, y, z| y < 60 + (x + z) % 90);
        let file = opened(written_with(&scene(field, MODES[0]), Features::ALL)).unwrap();
        let level_0: u64 = file.entries()[..2].iter().map(|e| u64::from(e.len)).sum();
        assert_eq!(level_0, 2 * (64 + 65_536));
        let empty = scene(Columns::empty(4096, 65_536, 4096), MODES[0]);
        assert!(written_with(&empty, Features::ALL).len() <= 64 << 10);
    }

    #[test]
    fn pcast_rows_over_64_kib_have_long_tables() {
        // 528 bytes a column; 33 are enough for colours, none for the narrow top levels.
        let columns = Columns::from_fn(256, 512, 3, |x, y, z| (x + y + z) % 2 == 0);
        for mode in MODES {
            let scene = scene(columns.clone(), mode);
            let file = opened(written(&scene)).unwrap();
            let blob = file.blob(0, 0, 0).unwrap().unwrap();
            let long = |s: Section| if s.present(mode.0, mode.1) { s.long_bit() } else { 0 };
            let colors = if mode.1 == ColorMode::None { 0 } else { 256 * 255 };
            assert!(colors < 65_536, "a row of colours still fits 16 bits");
            assert_eq!(blob.header.forms, long(Section::GeometryTable) | long(Section::ExposureTable));
            assert!(file.read_scene().unwrap() == scene, "{mode:?}");
        }
    }

    #[test]
    fn pcast_mapped_files_are_read_like_bytes() {
        let scene = scene(hills(), (Encoding::Solid, ColorMode::Voxel));
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.pcast");
        write_scene(&scene, &path).unwrap();
        assert!(std::fs::read(&path).unwrap() == written_with(&scene, Features::ALL));
        assert!(PcastFile::open(&path).unwrap().read_scene().unwrap() == scene);
        let error = |path: &Path| PcastFile::open(path).err().expect("no scene here").to_string();
        assert!(error(&dir.path().join("none")).contains("cannot open: "));
        assert!(error(dir.path()).ends_with("not a regular file, a .pcast scene was expected"));
        std::fs::write(&path, "").unwrap();
        assert!(error(&path).ends_with("0 bytes; a .pcast scene has a header of 64"));
    }

    #[test]
    fn pcast_bytes_do_not_depend_on_threads() {
        let scene = scene(hills(), (Encoding::Solid, ColorMode::Voxel));
        let with = |n: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
            let build = || build(testing::input(hills(), true), &BuildOptions::default()).unwrap();
            pool.install(|| written_with(&build(), Features::ALL))
        };
        let bytes = with(1);
        assert!(bytes == with(4));
        assert!(bytes == written_with(&scene, Features::ALL));
    }

    #[test]
    fn pcast_stores_equal_tiles_once() {
        for features in [Features::NONE, Features::ALL] {
            let bytes = written_with(&scene(Columns::from_fn(1024, 9, 512, |_, y, _| y < 5), MODES[0]), features);
            let file = opened(bytes).unwrap();
            let offsets: Vec<u64> = file.entries()[..8].iter().map(|e| e.offset).collect();
            assert_eq!(offsets, [offsets[0]; 8]);
            assert_ne!(file.entries()[8].offset, offsets[0]);
            file.read_scene().unwrap();
        }
    }

    #[test]
    fn pcast_blobs_and_sections_are_aligned() {
        for mode in MODES {
            for features in features() {
                let file = opened(written_with(&scene(hills(), mode), features)).unwrap();
                assert!(file.entries().iter().all(|e| e.offset % 16 == 0));
                let blob = file.blob(0, 0, 0).unwrap().unwrap();
                for section in Section::ALL {
                    let present = section.present(mode.0, mode.1);
                    assert!(present == (blob.offset(section) > 0) || features != Features::NONE);
                    assert_eq!(blob.offset(section) % 16, 0);
                }
            }
        }
    }

    #[test]
    fn pcast_compressed_tiles_hold_the_same_and_damage_to_them_is_found() {
        for mode in MODES {
            let (features, version) = if mode.1 == ColorMode::Run { (Features::ALL, 3) } else { (Features::NONE, 2) };
            let scene = scene(small(), mode);
            let plain = opened(written_with(&scene, features)).unwrap();
            let mut bytes = std::io::Cursor::new(Vec::new());
            let modes = Modes { encoding: mode.0, color: mode.1 };
            let mut out =
                SceneWriter::new(&mut bytes, Path::new("a"), scene.dims(), modes, scene.mip_rule, &About::default())
                    .unwrap();
            for entry in plain.entries() {
                let blob = plain.bytes[entry.offset as usize..][..entry.len as usize].to_vec();
                out.push(vec![write::compressed(*entry, blob, 3)]).unwrap();
            }
            out.finish().unwrap();
            let good = bytes.into_inner();
            assert_eq!(good[8], version);
            let file = opened(good.clone()).unwrap();
            assert!(file.read_scene().unwrap() == scene, "{mode:?}");
            check_queries(&file, &scene);
            crate::inspect::info::info(&file).unwrap();
            for at in 0..good.len() {
                let mut bytes = good.clone();
                bytes[at] ^= 0x11;
                // Padding between blobs belongs to nobody.
                assert!(read(bytes.clone()).is_err() || read(bytes).is_ok_and(|found| found == scene));
                // Behind the checksums, whatever zstd makes of it.
                let mut bytes = good.clone();
                bytes[at] ^= 0x11;
                reseal(&mut bytes);
                let _ = read(bytes);
            }
            // A file of version 1 has no compressed tiles.
            let mut old = good;
            old[8] = 1;
            reseal(&mut old);
            let flags = if version == 3 { "flags 0x6" } else { "flags 0x2" };
            assert!(refused(old).contains(&format!("{flags}, at most 0x1 was expected")));
        }
    }

    /// Whether each tile is sound is whether it is read, also where it is not. Returns how many are and are not.
    fn check_verdicts(bytes: Vec<u8>) -> [usize; 2] {
        let Ok(file) = opened(bytes) else { return [0; 2] };
        let mut found = [0; 2];
        for (k, grid) in file.grids.iter().enumerate() {
            for (tx, tz) in (0..grid.tiles[1]).flat_map(|tz| (0..grid.tiles[0]).map(move |tx| (tx, tz))) {
                let Ok(Some(blob)) = file.blob(k, tx, tz) else { continue };
                let entry = &file.entries[file.tile_ix(k, tx, tz)];
                let read = blob.level().and_then(|tile| blob.check_figures(&tile, entry));
                assert_eq!(blob.is_sound(entry), read.is_ok(), "tile ({tx}, {tz}) of level {k}: {read:?}");
                found[usize::from(read.is_err())] += 1;
            }
        }
        found
    }

    /// Worlds of columns of all lengths: of a word or more, long and short runs, with and without air below.
    fn varied_world() -> impl Strategy<Value = Columns> {
        let tall =
            prop_oneof![Just(40u32), Just(256), Just(300), Just(3000), Just(65_536)].prop_flat_map(testing::tall_world);
        let dense = (1u32..12, 3u32..140, 1u32..9, 2u32..7).prop_map(|(nx, ny, nz, k)| {
            Columns::from_fn(nx, ny, nz, |x, y, z| (x * 7 + z * 3 + y * (1 + (x + z) % 3)) % k == 0 || y < x % 4)
        });
        let raised = (1u32..20, 200u32..900, 1u32..9)
            .prop_map(|(nx, base, nz)| Columns::from_fn(nx, base + 60, nz, |x, y, z| y > base && (x ^ y ^ z) % 9 < 5));
        prop_oneof![testing::small_world(), testing::height_field(), tall, dense, raised]
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

        #[test]
        fn pcast_tiles_are_sound_just_where_they_are_read(
            columns in varied_world(),
            mode in 0..MODES.len(),
            features in 0..=Features::ALL.code(),
            damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0..5u8), 1..60),
        ) {
            let scene = scene(columns, MODES[mode]);
            let good = written_with(&scene, Features::from_code(features).unwrap());
            let [right, wrong] = check_verdicts(good.clone());
            prop_assert!(right > 0 || scene.levels[0].solid.runs().is_empty());
            prop_assert_eq!(wrong, 0);
            for (at, value, kind) in damage {
                let mut bytes = good.clone();
                // Behind the file's header, which is checked elsewhere.
                let at = size_of::<Header>() + at.index(bytes.len() - size_of::<Header>());
                bytes[at] = match kind {
                    0 => bytes[at].wrapping_add(1),
                    1 => bytes[at].wrapping_sub(1),
                    2 => bytes[at] ^ 1 << (value % 8),
                    3 => 0,
                    _ => value,
                };
                reseal(&mut bytes);
                check_verdicts(bytes);
            }
        }
    }

    #[test]
    fn pcast_damage_to_any_byte_is_judged_alike_by_both_ways_to_check() {
        let tall = || Columns::from_fn(5, 300, 4, |x, y, z| (y + x) % 26 < 3 + z && y % 7 != x);
        let packed = || Columns::from_fn(9, 60, 4, |x, y, z| (y * (1 + x % 4) + z) % 9 < 2);
        let mut found = [0; 2];
        for mode in MODES {
            let worlds = [small(), small_heights(), tall(), packed()];
            for (world, features) in worlds.into_iter().flat_map(|w| [(w.clone(), Features::NONE), (w, Features::ALL)])
            {
                let good = written_with(&scene(world, mode), features);
                for at in size_of::<Header>()..good.len() {
                    for value in
                        [0, 0xFF, good[at] ^ 1, good[at] ^ 0x80, good[at].wrapping_add(1), good[at].wrapping_sub(1)]
                    {
                        let mut bytes = good.clone();
                        bytes[at] = value;
                        reseal(&mut bytes);
                        let [right, wrong] = check_verdicts(bytes);
                        found = [found[0] + right, found[1] + wrong];
                    }
                }
            }
        }
        assert!(found.iter().all(|&n| n > 1000), "{found:?}");
    }

    /// Small, but with every section, a hidden voxel, both edges of a level.
    fn small() -> Columns {
        Columns::from_fn(5, 9, 3, |x, y, z| y < 4 + x % 2 || y == 7 && z == 1)
    }

    /// A height field with hidden voxels.
    fn small_heights() -> Columns {
        Columns::from_fn(5, 9, 4, |x, y, z| y < 2 + (x * z) % 6)
    }

    #[test]
    fn pcast_damage_to_any_byte_is_found() {
        let worlds = [(small(), Features::NONE), (small(), Features::ALL), (small_heights(), Features::ALL)];
        for (mode, (world, features)) in MODES.into_iter().flat_map(|m| worlds.clone().map(|w| (m, w))) {
            let scene = scene(world, mode);
            let good = written_with(&scene, features);
            for at in 0..good.len() {
                for flip in [0x01, 0x80, 0xFF] {
                    let mut bytes = good.clone();
                    bytes[at] ^= flip;
                    match read(bytes) {
                        // Padding between blobs belongs to nobody.
                        Ok(found) => assert!(found == scene, "{mode:?} byte {at} ^ {flip:#x}"),
                        Err(e) => assert!(matches!(e, Error::Format { .. }), "{mode:?} byte {at} ^ {flip:#x}: {e}"),
                    }
                }
            }
            for len in 0..good.len() {
                assert!(read(good[..len].to_vec()).is_err(), "{mode:?} cut to {len}");
            }
            let longer = [&good[..], &[0]].concat();
            assert!(refused(longer).contains("it was cut short or added to"));
        }
    }

    #[test]
    fn pcast_forged_bytes_never_panic_and_never_give_a_broken_scene() {
        let tall = || Columns::from_fn(2, 300, 2, |x, y, _| y % 260 < 3 + x);
        let raised = || Columns::from_fn(18, 300, 2, |x, y, z| y > 260 && (x + y + z) % 9 < 4);
        let worlds = [
            (small(), Features::NONE),
            (small(), Features::ALL),
            (tall(), Features::NONE),
            (tall(), Features::ALL),
            (raised(), Features::ALL),
            (small_heights(), Features::ALL),
        ];
        for (mode, (world, features)) in MODES.into_iter().flat_map(|m| worlds.clone().map(|w| (m, w))) {
            let good = written_with(&scene(world, mode), features);
            for at in 0..good.len() {
                for value in [0, 1, 2, 0x7F, 0xFF, good[at] ^ 1, good[at].wrapping_add(1), good[at].wrapping_sub(1)] {
                    let mut bytes = good.clone();
                    bytes[at] = value;
                    reseal(&mut bytes);
                    let Ok(file) = opened(bytes) else { continue };
                    for (x, y, z) in [(0, 0, 0), (1, 8, 1), (1, 259, 1), (4, 4, 2)] {
                        let _ = file.query(x, y, z);
                    }
                    if let Ok(scene) = file.read_scene() {
                        // Whatever was accepted is a scene like any other.
                        assert!(read(written(&scene)).unwrap() == scene, "{mode:?} byte {at} = {value:#x}");
                    }
                }
            }
        }
    }

    #[test]
    fn pcast_errors_name_place_and_expectation() {
        let good = written(&scene(small(), (Encoding::Surface, ColorMode::Voxel)));
        let header = |at: usize, value: &[u8]| {
            let mut bytes = good.clone();
            bytes[at..at + value.len()].copy_from_slice(value);
            reseal(&mut bytes);
            refused(bytes)
        };
        assert_eq!(refused(vec![1; 20]), "a.pcast: 20 bytes; a .pcast scene has a header of 64");
        assert_eq!(
            header(0, b"P"),
            "a.pcast: not a .pcast scene (byte 0: other magic number); make one with `planecast encode`"
        );
        assert_eq!(header(8, &[5]), "a.pcast: byte 8: version 5 of .pcast, this program reads versions 1 to 4");
        assert_eq!(header(24, &[7]), "a.pcast: byte 24: encoding 7, 0 or 1 was expected");
        assert_eq!(header(27, &[9]), "a.pcast: byte 27: 9 levels, 4 were expected");
        assert_eq!(header(32, &[8]), "a.pcast: byte 32: a directory of 4 tiles at byte 8 does not fit the file");
        assert!(header(12, &[0, 0]).starts_with("a.pcast: byte 12: 0 × 9 × 3 voxels;"));
        let mut bytes = good.clone();
        bytes[20] ^= 1;
        assert_eq!(refused(bytes), "a.pcast: byte 56: the header does not match its checksum; the file is damaged");

        let entry = |field: usize, value: &[u8]| header(64 + field, value);
        assert_eq!(
            entry(offset_of!(TileEntry, offset), &[1]),
            "a.pcast: byte 64: tile 0: blob at byte 257, a multiple of 16 was expected"
        );
        assert!(entry(offset_of!(TileEntry, len), &[0xFF; 4]).contains("does not fit the file"));
        assert!(entry(offset_of!(TileEntry, flags), &[1]).contains("an empty tile has figures"));
        assert!(entry(offset_of!(TileEntry, n_runs), &[0xFE]).contains("its directory entry says"));
        let second = u64::from_le_bytes(good[64 + 48..64 + 56].try_into().unwrap());
        let third = (second + 16).to_le_bytes();
        assert!(header(64 + 2 * 48, &third).contains("overlaps that of tile"));

        let mut bytes = good.clone();
        bytes[second as usize + 70] ^= 1;
        let damaged =
            format!("a.pcast: tile (0, 0) of level 1, byte {second}: does not match its checksum; the file is damaged");
        assert_eq!(refused(bytes), damaged);
    }

    /// Level 0's blob with one byte of a section replaced, checksums made right.
    fn forged(mode: (Encoding, ColorMode), section: Section, at: usize, value: u8) -> String {
        let bytes = written(&scene(small(), mode));
        let file = opened(bytes.clone()).unwrap();
        let at = file.entries()[0].offset as usize + file.blob(0, 0, 0).unwrap().unwrap().offset(section) + at;
        let mut bytes = bytes;
        assert_ne!(bytes[at], value, "nothing would change");
        bytes[at] = value;
        reseal(&mut bytes);
        refused(bytes)
    }

    #[test]
    fn pcast_finds_every_kind_of_forged_section() {
        let solid = (Encoding::Solid, ColorMode::Voxel);
        let surface = (Encoding::Surface, ColorMode::Voxel);
        // Column 1 starts one byte late: column 0 is then of even length.
        assert!(
            forged(solid, Section::GeometryTable, 4 * 3 + 2, 4)
                .contains("column (0, 0) of the tile: 4 bytes; a narrow column")
        );
        assert!(forged(solid, Section::GeometryTable, 0, 1).contains("starts at byte 1, 0 was expected"));
        assert!(forged(solid, Section::Geometry, 1, 1).contains("first colour offset 1, 0 was expected"));
        assert!(forged(solid, Section::Exposure, 2, 3).contains("bytes of colours"));
        assert!(forged(solid, Section::ColorTable, 4 * 3 + 2, 9).contains("9 colours before it, 4 were expected"));
        // The gap of a hidden voxel called air, and the air above a column called solid.
        assert!(forged(surface, Section::Fill, 0, 0xFF).contains("the gap above the last run is marked as solid"));
        let hidden = Columns::from_fn(3, 3, 3, |_, _, _| true);
        let bytes = written(&scene(hidden, surface));
        let file = opened(bytes.clone()).unwrap();
        let at = file.entries()[0].offset as usize + file.blob(0, 0, 0).unwrap().unwrap().offset(Section::Fill);
        let mut bytes = bytes;
        bytes[at..at + 2].fill(0);
        reseal(&mut bytes);
        assert!(refused(bytes).contains("its directory entry says 27 solid"));
    }

    #[test]
    fn pcast_exposed_voxels_must_have_an_exposed_face() {
        // Two runs of exposed voxels with a hidden one between; the hidden one shown instead of the upper end.
        let good = scene(Columns::from_fn(3, 4, 3, |_, _, _| true), (Encoding::Solid, ColorMode::Voxel));
        let mut bad = good.clone();
        let exposed = bad.levels[0].exposed.take().unwrap();
        bad.levels[0].exposed = Some(Columns::from_rows(3, 4, 3, |z, out| {
            for x in 0..3 {
                match (x, z) {
                    (1, 1) => out.push_run(Run::new(0, 1)),
                    _ => exposed.column(x, z).iter().for_each(|&r| out.push_run(r)),
                }
                out.end_column();
            }
        }));
        let expected = "a.pcast: level 0 column (1, 1): the exposed voxels are not those with an exposed face; encode the scene again";
        assert_eq!(refused(written(&bad)), expected);
        assert_eq!(read(written(&good)).unwrap(), good);
    }
}
