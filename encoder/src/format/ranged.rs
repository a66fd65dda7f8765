//! Scene files of which tiles are read as they are asked for: a few bytes at opening, and each tile by the range in which it lies.

use std::borrow::Cow;
use std::collections::{HashMap, VecDeque};
use std::ops::Range;
use std::path::Path;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use bytemuck::pod_read_unaligned;
use xxhash_rust::xxh3::xxh3_64;

use crate::format::MATTER;
use crate::format::file::{Modes, Outline, Place, check_entries, heights, read_tile};
use crate::format::{Grid, Header, TileEntry, metadata};
use crate::model::tiles::{TileKey, TileSource};
use crate::store::ranges::{HEAD, Ranges};
use crate::{About, ColorMode, Encoding, Error, Level, Result};

/// Directories up to this size are read whole at once, and their checksum with them; of others what is wanted, whose tiles have
/// checksums of their own.
const WHOLE: u64 = 256 << 10;

/// Entries of a directory that are read together.
const PAGE: usize = 1024;

/// Tiles that lie together are read together, up to so many bytes.
const TOGETHER: u64 = 512 << 10;

/// How many tiles side by side in the directory are read together, where they are small enough.
const GROUPS: [usize; 2] = [4, 2];

/// Bytes of groups that are kept for their other tiles.
const KEPT: u64 = 8 << 20;

/// A scene file read by ranges.
pub struct RangedFile {
    source: Box<dyn Ranges>,
    outline: Outline,
    about: About,
    /// Where the directory begins, and its entries by pages.
    directory: u64,
    n_tiles: usize,
    pages: Vec<OnceLock<Vec<TileEntry>>>,
    page: usize,
    /// From which tile on all are one group: those of the coarsest levels.
    coarsest: usize,
    groups: Mutex<Groups>,
}

/// How many tiles, and the number of the group among such.
type GroupId = [usize; 2];

/// A group's first byte in the file, and its bytes.
type Group = (u64, Vec<u8>);

/// Groups of tiles, the latest last. Whoever asks for one that is on its way waits for it.
#[derive(Default)]
struct Groups {
    slots: HashMap<GroupId, Arc<Mutex<Option<Arc<Group>>>>>,
    order: VecDeque<(GroupId, u64)>,
    bytes: u64,
}

impl RangedFile {
    /// Reads the header, and as much of the directory as the coarse levels take.
    pub fn open(source: Box<dyn Ranges>) -> Result<RangedFile> {
        RangedFile::with(source, WHOLE, PAGE)
    }

    /// Directories of more than `whole` bytes are read in pages of so many entries.
    fn with(source: Box<dyn Ranges>, whole: u64, page: usize) -> Result<RangedFile> {
        let path = source.name().to_owned();
        let len = source.size();
        let head = source.read(0..len.min(HEAD))?;
        let outline = Outline::check(&path, &head, len)?;
        let header: Header = pod_read_unaligned(&head[..size_of::<Header>()]);
        let n_tiles = header.n_tiles as usize;
        let end = header.directory + (n_tiles * size_of::<TileEntry>()) as u64;
        let read = |range: Range<u64>| match head.get(range.start as usize..range.end as usize) {
            Some(bytes) => Ok(bytes.to_vec()),
            None => source.read(range),
        };
        let mut about = About::default();
        if header.version[1] >= crate::format::MINOR_METADATA {
            let metadata = size_of::<Header>() as u64..header.directory;
            let first = metadata::first(&read(metadata.start..metadata.end.min(metadata.start + 16))?);
            let section = metadata.start..metadata.end.min(metadata.start.saturating_add(first));
            about = metadata::unpack(&read(section)?).map_err(|(at, what)| {
                Error::format(&path, format!("byte {}: metadata: {what}", size_of::<Header>() + at))
            })?;
        }
        let mut file = RangedFile {
            pages: (0..n_tiles.div_ceil(page)).map(|_| OnceLock::new()).collect(),
            page,
            outline,
            about,
            directory: header.directory,
            n_tiles,
            coarsest: n_tiles,
            groups: Mutex::default(),
            source,
        };
        if end - header.directory <= whole || file.source.near() {
            let directory = match head.get(header.directory as usize..end as usize) {
                Some(bytes) => Cow::Borrowed(bytes),
                None => Cow::Owned(file.source.read(header.directory..end)?),
            };
            if xxh3_64(&directory) != header.directory_checksum {
                let what = "byte 48: the directory does not match its checksum; the file is damaged";
                return Err(Error::format(path, what));
            }
            let entries = file.entries_of(&directory, 0)?;
            file.pages = entries.chunks(page).map(|page| OnceLock::from(page.to_vec())).collect();
        } else {
            file.page((n_tiles - 1) / page)?;
        }
        for grid in file.outline.grids.iter().rev() {
            if file.range_of(grid.first as usize..n_tiles).is_none() {
                break;
            }
            file.coarsest = grid.first as usize;
        }
        Ok(file)
    }

    pub fn about(&self) -> &About {
        &self.about
    }

    /// Entries from their bytes; the first is that of tile `first`.
    fn entries_of(&self, bytes: &[u8], first: usize) -> Result<Vec<TileEntry>> {
        let entries: Vec<TileEntry> = bytes.chunks_exact(size_of::<TileEntry>()).map(pod_read_unaligned).collect();
        let end = self.directory + (self.n_tiles * size_of::<TileEntry>()) as u64;
        check_entries(&entries, self.outline.flags, end, self.source.size()).map_err(|(tile, what)| {
            let (tile, at) = (first + tile, self.directory + ((first + tile) * size_of::<TileEntry>()) as u64);
            Error::format(self.source.name(), format!("byte {at}: tile {tile}: {what}"))
        })?;
        Ok(entries)
    }

    /// A page of the directory, read when it is first wanted.
    fn page(&self, page: usize) -> Result<&[TileEntry]> {
        if let Some(entries) = self.pages[page].get() {
            return Ok(entries);
        }
        let tiles = page * self.page..self.n_tiles.min((page + 1) * self.page);
        let at = |tile: usize| self.directory + (tile * size_of::<TileEntry>()) as u64;
        let entries = self.entries_of(&self.source.read(at(tiles.start)..at(tiles.end))?, tiles.start)?;
        Ok(self.pages[page].get_or_init(|| entries))
    }

    fn number(&self, key: TileKey) -> Option<usize> {
        let grid = self.outline.grids.get(key.level as usize)?;
        (key.x < grid.tiles[0] && key.z < grid.tiles[1])
            .then(|| grid.first as usize + key.z as usize * grid.tiles[0] as usize + key.x as usize)
    }

    /// What is known of a tile.
    fn known(&self, tile: usize) -> Option<&TileEntry> {
        self.pages[tile / self.page].get().map(|page| &page[tile % self.page])
    }

    /// The bytes of a tile as they are stored.
    fn stored(&self, tile: usize, entry: &TileEntry) -> Result<Vec<u8>> {
        let own = entry.offset..entry.offset + u64::from(entry.len);
        let group = if self.source.near() { None } else { self.group(tile) };
        let Some((group, range)) = group else { return self.source.read(own) };
        let slot = Arc::clone(self.locked().slots.entry(group).or_default());
        let mut slot = slot.lock().unwrap_or_else(PoisonError::into_inner);
        let bytes = match &*slot {
            Some(bytes) => Arc::clone(bytes),
            None => {
                let bytes = match self.source.read(range.clone()) {
                    Ok(bytes) => Arc::new((range.start, bytes)),
                    Err(e) => {
                        // Whoever waits tries it, too; nobody after them finds this slot.
                        self.locked().slots.remove(&group);
                        return Err(e);
                    }
                };
                *slot = Some(Arc::clone(&bytes));
                let mut groups = self.locked();
                groups.order.push_back((group, range.end - range.start));
                groups.bytes += range.end - range.start;
                while groups.bytes > KEPT && groups.order.len() > 1 {
                    let Some((old, n)) = groups.order.pop_front() else { break };
                    groups.slots.remove(&old);
                    groups.bytes -= n;
                }
                bytes
            }
        };
        let at = (own.start - bytes.0) as usize;
        Ok(bytes.1[at..at + entry.len as usize].to_vec())
    }

    /// What was read was wrong: the next who asks for it reads it again.
    fn forget(&self, tile: usize) {
        let Some((group, _)) = self.group(tile) else { return };
        let mut groups = self.locked();
        groups.slots.remove(&group);
        if let Some(at) = groups.order.iter().position(|g| g.0 == group) {
            groups.bytes -= groups.order[at].1;
            groups.order.remove(at);
        }
    }

    fn locked(&self) -> std::sync::MutexGuard<'_, Groups> {
        self.groups.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The group of a tile, and where it lies; None where the others are far, many, or not known yet.
    fn group(&self, tile: usize) -> Option<(GroupId, Range<u64>)> {
        if tile >= self.coarsest {
            return Some(([self.n_tiles, 0], self.range_of(self.coarsest..self.n_tiles)?));
        }
        GROUPS.into_iter().find_map(|n| {
            let group = tile / n;
            Some(([n, group], self.range_of(group * n..self.coarsest.min((group + 1) * n))?))
        })
    }

    /// Where tiles lie, if all are known and close together.
    fn range_of(&self, tiles: Range<usize>) -> Option<Range<u64>> {
        let [mut from, mut to, mut n] = [u64::MAX, 0, 0];
        for tile in tiles {
            let e = self.known(tile)?;
            if !e.is_empty() {
                [from, to, n] = [from.min(e.offset), to.max(e.offset + u64::from(e.len)), n + u64::from(e.len)];
            }
        }
        // Tiles that are stored elsewhere, as they are like others, would bring all between.
        (from < to && to - from <= TOGETHER && n * 2 >= to - from).then_some(from..to)
    }
}

impl TileSource for RangedFile {
    fn name(&self) -> String {
        self.source.name().display().to_string()
    }

    fn dims(&self) -> [u32; 3] {
        self.outline.grids[0].dims
    }

    fn encoding(&self) -> Encoding {
        self.outline.encoding
    }

    fn color(&self) -> ColorMode {
        self.outline.color
    }

    fn about(&self) -> About {
        self.about.clone()
    }

    fn heights(&self, level: u32) -> [u32; 2] {
        let grid: &Grid = &self.outline.grids[level as usize];
        let tiles = grid.first as usize..(grid.first + grid.n_tiles()) as usize;
        let known: Option<Vec<&TileEntry>> = tiles.map(|tile| self.known(tile)).collect();
        known.map_or([0, grid.dims[1]], heights)
    }

    fn is_height_field(&self) -> bool {
        self.about.may_be_height_field() && self.outline.encoding == Encoding::Solid
    }

    fn is_empty(&self, key: TileKey) -> bool {
        self.number(key).and_then(|tile| self.known(tile)).is_some_and(TileEntry::is_empty)
    }

    fn tile(&self, key: TileKey) -> Result<Level> {
        let TileKey { level, x: tx, z: tz } = key;
        let Some(tile) = self.number(key) else {
            return Err(Error::Argument(format!("{}: there is no tile ({tx}, {tz}) of level {level}", self.name())));
        };
        let named = |e: Error| match e {
            Error::Io { path, action, source } => {
                let text = format!("tile ({tx}, {tz}) of level {level}: {source}");
                Error::Io { path, action, source: std::io::Error::new(source.kind(), text) }
            }
            Error::Format { path, what } if !what.starts_with("tile") => {
                Error::format(path, format!("tile ({tx}, {tz}) of level {level}: {what}"))
            }
            e => e,
        };
        let entry = self.page(tile / self.page).map_err(named)?[tile % self.page];
        let [xs, zs] = self.outline.grids[level as usize].columns(tx, tz);
        let dims = [xs.len() as u32, self.outline.grids[level as usize].dims[1], zs.len() as u32];
        let modes = Modes { encoding: self.outline.encoding, color: self.outline.color };
        let TileEntry { offset, flags, .. } = entry;
        let path: &Path = self.source.name();
        let place = Place { path, level: level as usize, tx, tz, offset, flags, modes, dims };
        let bytes = if entry.is_empty() { None } else { Some(self.stored(tile, &entry).map_err(named)?) };
        read_tile(place, bytes, &entry).inspect_err(|_| self.forget(tile))
    }

    fn has_matter(&self) -> bool {
        self.outline.flags & MATTER != 0
    }

    fn bytes(&self, key: TileKey) -> u64 {
        self.number(key).and_then(|tile| self.known(tile)).map_or(0, |e| e.len.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::write;
    use crate::source::procedural::{Kind, procedural};
    use crate::store::ranges::Here;
    use crate::{BuildOptions, PcastFile, build};

    /// A file that is far, and what was asked of it.
    struct Far(Vec<u8>, Arc<Mutex<Vec<Range<u64>>>>);

    impl Ranges for Far {
        fn name(&self) -> &Path {
            Path::new("far.pcast")
        }

        fn size(&self) -> u64 {
            self.0.len() as u64
        }

        fn near(&self) -> bool {
            false
        }

        fn read(&self, range: Range<u64>) -> Result<Vec<u8>> {
            self.1.lock().unwrap().push(range.clone());
            Ok(self.0[range.start as usize..range.end as usize].to_vec())
        }
    }

    fn scene() -> Vec<u8> {
        let scene = build(procedural(Kind::Rocks, 1100, 3).unwrap(), &BuildOptions::default()).unwrap();
        let mut out = std::io::Cursor::new(Vec::new());
        write::write_scene_to(&scene, &mut out, Path::new("s.pcast")).unwrap();
        out.into_inner()
    }

    fn keys(file: &PcastFile) -> Vec<TileKey> {
        let tiles = |(level, grid): (usize, &Grid)| {
            let [nx, nz] = grid.tiles;
            (0..nz).flat_map(move |z| (0..nx).map(move |x| TileKey { level: level as u32, x, z }))
        };
        file.grids().iter().enumerate().flat_map(tiles).collect()
    }

    #[test]
    fn ranged_files_give_the_tiles_of_the_file() {
        let bytes = scene();
        let whole = PcastFile::from_bytes("s.pcast", bytes.clone()).unwrap();
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("s.pcast");
        std::fs::write(&path, &bytes).unwrap();
        let log = Arc::new(Mutex::new(Vec::new()));
        let far = || Box::new(Far(bytes.clone(), Arc::clone(&log)));
        let files = [
            RangedFile::open(Box::new(Here::open(&path).unwrap())).unwrap(),
            RangedFile::open(far()).unwrap(),
            RangedFile::with(far(), 0, 7).unwrap(),
        ];
        log.lock().unwrap().clear();
        let mut requests = Vec::new();
        for file in &files {
            assert_eq!(
                (file.dims(), file.levels(), file.color()),
                (whole.dims(), whole.grids().len() as u32, whole.color())
            );
            // Coarse to fine, as a picture asks.
            for key in keys(&whole).into_iter().rev() {
                assert!(file.tile(key).unwrap() == TileSource::tile(&whole, key).unwrap(), "{key:?}");
                assert_eq!(
                    (file.bytes(key), file.is_empty(key)),
                    (TileSource::bytes(&whole, key), TileSource::is_empty(&whole, key))
                );
            }
            requests.push(log.lock().unwrap().len());
            assert!((0..whole.grids().len() as u32).all(|l| file.heights(l) == TileSource::heights(&whole, l)));
        }
        let read: u64 = log.lock().unwrap().iter().map(|r| r.end - r.start).sum();
        let n = keys(&whole).len();
        assert!(requests[0] == 0 && requests[1] < n, "neighbours come together: {requests:?} for {n} tiles");
        assert!(read < 3 * bytes.len() as u64, "{read} bytes of twice {}", bytes.len());
        let none = files[0].tile(TileKey { level: 0, x: 99, z: 0 }).unwrap_err().to_string();
        assert!(none.contains("there is no tile (99, 0) of level 0"), "{none}");
    }

    #[test]
    fn ranged_files_know_coarse_levels_without_the_whole_directory() {
        let log = Arc::new(Mutex::new(Vec::new()));
        let file = RangedFile::with(Box::new(Far(scene(), Arc::clone(&log))), 0, 7).unwrap();
        let fine = TileKey { level: 0, x: 0, z: 0 };
        assert_eq!((file.bytes(fine), file.is_empty(fine), file.heights(0)[0]), (0, false, 0));
        let coarse = TileKey { level: file.levels() - 1, x: 0, z: 0 };
        assert!(file.bytes(coarse) > 0);
    }

    #[test]
    fn ranged_files_name_the_tile_that_is_damaged() {
        let mut bytes = scene();
        let whole = PcastFile::from_bytes("s.pcast", bytes.clone()).unwrap();
        let at = whole.entries()[3].offset as usize + 70;
        bytes[at] ^= 1;
        let file = RangedFile::open(Box::new(Far(bytes.clone(), Arc::default()))).unwrap();
        let broken = file.tile(TileKey { level: 0, x: 3, z: 0 }).unwrap_err().to_string();
        assert!(broken.contains("far.pcast: tile (3, 0) of level 0") && broken.contains("checksum"), "{broken}");
        assert!(file.tile(TileKey { level: 0, x: 2, z: 0 }).is_ok());
        bytes[50] ^= 1;
        let broken = RangedFile::open(Box::new(Far(bytes, Arc::default()))).err().unwrap().to_string();
        assert!(broken.contains("byte 56"), "{broken}");
    }
}
