//! Finished tiles on their way to a scene: the log of an encoding under way, and the parts that `merge` joins.
//!
//! ```text
//! | PartHeader 80 B | RecordHeader 80 B | blob | work blob | RecordHeader …        | end record 80 B |
//! ```
//!
//! One record a tile, in any order, each with checksums of its own, so that what a crash left whole can be told from
//! what it did not. The blob is the scene's; where the scene has run colours, from which coarser levels cannot be made,
//! a work blob (solid, voxel colours) follows it. The end record, whose tile number is 2⁶⁴ − 1, counts the records: a
//! part without one is unfinished. The record of tile 2⁶⁴ − 2 holds what is known of the input, as the scene's metadata.
//! Little-endian.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard};

use bytemuck::{Pod, Zeroable, bytes_of};
use xxhash_rust::xxh3::xxh3_64;

use crate::format::file::{Modes, Place, decode_matter, decode_tile};
use crate::format::metadata;
use crate::format::{self, Grid, TileEntry};
use crate::store::scratch::{read_at, write_at};
use crate::{About, ColorMode, Encoding, Error, Features, Level, MipRule, Result};

pub const MAGIC: [u8; 8] = *b"\x89PCT\r\n\x1a\n";
/// Version 1 had no [`Features`]: its parts are of the general layout; version 2 nothing of the input.
pub const VERSION: [u16; 2] = [3, 0];
const END: u64 = u64::MAX;
const ABOUT: u64 = u64::MAX - 1;

#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
struct PartHeader {
    magic: [u8; 8],
    version: [u16; 2],
    dims: [u32; 3],
    encoding: u8,
    color: u8,
    mip_rule: u8,
    features: u8,
    pad2: u32,
    /// Of what was encoded and how: parts of one scene have the same.
    settings: u64,
    /// Of the input's file as it lay there: an encoding goes on only over the same.
    source: u64,
    /// Tiles of level 0 that the part is to hold.
    tiles: [u64; 2],
    pad3: u64,
    /// xxh3-64 of the 72 bytes before.
    checksum: u64,
}

#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
struct RecordHeader {
    /// Number in the scene's directory.
    tile: u64,
    /// Its offset is 0. Of the end record: `n_solid` is the number of records.
    entry: TileEntry,
    work_len: u32,
    pad: u32,
    work_checksum: u64,
    /// xxh3-64 of the 72 bytes before.
    checksum: u64,
}

/// What a part is a part of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Plan {
    pub dims: [u32; 3],
    pub modes: Modes,
    pub mip_rule: MipRule,
    /// What tiles may leave out.
    pub features: Features,
    /// Hash of the input's size and the options.
    pub settings: u64,
    /// Hash of the input's name and time.
    pub source: u64,
    /// Tiles of level 0, `from .. to`.
    pub tiles: [u64; 2],
}

impl Plan {
    fn header(&self) -> PartHeader {
        let mut header = PartHeader {
            magic: MAGIC,
            version: VERSION,
            dims: self.dims,
            encoding: format::encoding_code(self.modes.encoding),
            color: format::color_code(self.modes.color),
            mip_rule: format::mip_rule_code(self.mip_rule),
            features: self.features.code(),
            settings: self.settings,
            source: self.source,
            tiles: self.tiles,
            ..PartHeader::zeroed()
        };
        header.checksum = xxh3_64(&bytes_of(&header)[..72]);
        header
    }

    fn from_header(path: &Path, header: &PartHeader) -> Result<Plan> {
        let wrong = |what: &str| Error::format(path, what);
        if header.magic != MAGIC {
            return Err(wrong("byte 0: not a part of a scene; make one with `planecast encode --tiles A..B`"));
        }
        if !(1..=VERSION[0]).contains(&header.version[0]) {
            return Err(wrong("byte 8: a part made by another version of planecast; encode it again"));
        }
        if header.checksum != xxh3_64(&bytes_of(header)[..72]) {
            return Err(wrong("byte 72: the part's header does not match its checksum; the file is damaged"));
        }
        let modes = Modes::from_codes(header.encoding, header.color);
        let rule = [MipRule::Any, MipRule::Majority].get(header.mip_rule as usize).copied();
        let (Some(modes), Some(mip_rule), Some(features)) = (modes, rule, Features::from_code(header.features)) else {
            return Err(wrong("byte 24: modes that this program does not know"));
        };
        let [nx, ny, nz] = header.dims;
        let n_columns = u64::from(nx) * u64::from(nz);
        if header.dims.contains(&0) || ny > 65_536 || n_columns > format::MAX_COLUMNS {
            return Err(wrong("byte 12: a world of a size that a scene cannot have"));
        }
        let PartHeader { dims, settings, source, tiles, .. } = *header;
        Ok(Plan { dims, modes, mip_rule, features, settings, source, tiles })
    }
}

/// A finished tile, to be stored.
pub struct Finished {
    /// Number in the directory.
    pub tile: u64,
    pub entry: TileEntry,
    pub blob: Vec<u8>,
    pub work: Vec<u8>,
}

/// Where a tile stands.
#[derive(Clone, Copy, Debug)]
pub struct Stored {
    pub entry: TileEntry,
    /// Of the blob in the file.
    at: u64,
    work_len: u32,
}

/// A file of finished tiles.
pub struct Part {
    path: PathBuf,
    file: File,
    plan: Plan,
    records: Mutex<Records>,
    finished: bool,
    about: About,
}

struct Records {
    n: u64,
    /// Where the next one goes.
    end: u64,
}

impl Part {
    /// A part of which no record is known.
    fn new(path: &Path, file: File, plan: Plan) -> Part {
        let records = Mutex::new(Records { n: 0, end: size_of::<PartHeader>() as u64 });
        Part { path: path.to_owned(), file, plan, records, finished: false, about: About::default() }
    }

    fn records(&self) -> MutexGuard<'_, Records> {
        self.records.lock().expect("no thread panics with the records")
    }

    /// A new part in an empty file.
    pub fn create(path: &Path, file: File, plan: Plan, about: About) -> Result<Part> {
        let mut part = Part::new(path, file, plan);
        part.file.set_len(0).map_err(|e| Error::io(path, "write", e))?;
        part.write(0, bytes_of(&plan.header()))?;
        let blob = metadata::pack(&about);
        if !blob.is_empty() {
            let entry = TileEntry { len: blob.len() as u32, checksum: xxh3_64(&blob), ..TileEntry::zeroed() };
            part.push(&Finished { tile: ABOUT, entry, blob, work: Vec::new() })?;
        }
        part.about = about;
        Ok(part)
    }

    /// An existing part: each whole record goes to `found`, the last one of a tile that has several. What a crash left
    /// behind the last whole record is not looked at, and is overwritten by [`Part::push`].
    pub fn open(path: &Path, file: File, mut found: impl FnMut(u64, Stored)) -> Result<Part> {
        let len = file.metadata().map_err(|e| Error::io(path, "read", e))?.len();
        let failed = |e| Error::io(path, "read", e);
        let mut header = PartHeader::zeroed();
        if len < size_of::<PartHeader>() as u64 {
            return Err(Error::format(path, format!("{len} bytes; a part has a header of 80")));
        }
        read_at(&file, bytemuck::bytes_of_mut(&mut header), 0).map_err(failed)?;
        let plan = Plan::from_header(path, &header)?;
        let n_tiles: u64 = format::grids(plan.dims).iter().map(Grid::n_tiles).sum();
        let mut part = Part::new(path, file, plan);
        let mut buffer = Vec::new();
        let mut records = Records { n: 0, end: part.records().end };
        while records.end + size_of::<RecordHeader>() as u64 <= len {
            let mut record = RecordHeader::zeroed();
            read_at(&part.file, bytemuck::bytes_of_mut(&mut record), records.end).map_err(failed)?;
            if record.checksum != xxh3_64(&bytes_of(&record)[..72]) {
                break;
            }
            if record.tile == END {
                part.finished = record.entry.n_solid == records.n;
                break;
            }
            let at = records.end + size_of::<RecordHeader>() as u64;
            let body = u64::from(record.entry.len) + u64::from(record.work_len);
            if record.tile >= n_tiles && record.tile != ABOUT || at + body > len {
                break;
            }
            buffer.resize(body as usize, 0);
            read_at(&part.file, &mut buffer, at).map_err(failed)?;
            let (blob, work) = buffer.split_at(record.entry.len as usize);
            let whole = (record.entry.is_empty() || xxh3_64(blob) == record.entry.checksum)
                && (work.is_empty() || xxh3_64(work) == record.work_checksum);
            if !whole {
                break;
            }
            match record.tile {
                ABOUT => part.about = metadata::unpack(blob).unwrap_or_default(),
                tile => found(tile, Stored { entry: record.entry, at, work_len: record.work_len }),
            }
            records.n += 1;
            records.end = at + body;
        }
        part.records = Mutex::new(records);
        Ok(part)
    }

    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// What is known of the input.
    pub fn about(&self) -> &About {
        &self.about
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether the part has its end record.
    pub fn is_finished(&self) -> bool {
        self.finished
    }

    fn write(&self, at: u64, bytes: &[u8]) -> Result<()> {
        write_at(&self.file, bytes, at).map_err(|e| Error::io(&self.path, "write", e))
    }

    /// Appends a tile.
    pub fn push(&self, tile: &Finished) -> Result<Stored> {
        let mut header = RecordHeader {
            tile: tile.tile,
            entry: tile.entry,
            work_len: tile.work.len() as u32,
            work_checksum: xxh3_64(&tile.work),
            ..RecordHeader::zeroed()
        };
        header.checksum = xxh3_64(&bytes_of(&header)[..72]);
        let mut records = self.records();
        let at = records.end + size_of::<RecordHeader>() as u64;
        self.write(records.end, bytes_of(&header))?;
        self.write(at, &tile.blob)?;
        self.write(at + tile.blob.len() as u64, &tile.work)?;
        records.end = at + (tile.blob.len() + tile.work.len()) as u64;
        records.n += 1;
        Ok(Stored { entry: tile.entry, at, work_len: header.work_len })
    }

    /// Writes the end record, and all of it to the disk.
    pub fn finish(&mut self) -> Result<()> {
        let Records { n, end } = *self.records();
        let entry = TileEntry { n_solid: n, ..TileEntry::zeroed() };
        let mut header = RecordHeader { tile: END, entry, ..RecordHeader::zeroed() };
        header.checksum = xxh3_64(&bytes_of(&header)[..72]);
        self.write(end, bytes_of(&header))?;
        self.file.set_len(end + size_of::<RecordHeader>() as u64).map_err(|e| Error::io(&self.path, "write", e))?;
        self.finished = true;
        self.file.sync_all().map_err(|e| Error::io(&self.path, "write", e))
    }

    /// The blob of a tile, as the scene's file holds it.
    pub fn blob(&self, stored: &Stored) -> Result<Vec<u8>> {
        let mut bytes = vec![0; stored.entry.len as usize];
        read_at(&self.file, &mut bytes, stored.at).map_err(|e| Error::io(&self.path, "read", e))?;
        if !stored.entry.is_empty() && xxh3_64(&bytes) != stored.entry.checksum {
            return Err(Error::format(&self.path, format!("byte {}: a tile changed while it was read", stored.at)));
        }
        Ok(bytes)
    }

    /// A tile for making the coarser level of: its solid runs, and its exposed voxels and their colours where the scene
    /// has colours.
    pub fn work_level(&self, stored: &Stored, grid: &Grid, level: usize, tx: u32, tz: u32) -> Result<Level> {
        let (modes, flags, bytes) = if stored.work_len > 0 {
            let mut bytes = vec![0; stored.work_len as usize];
            let at = stored.at + u64::from(stored.entry.len);
            read_at(&self.file, &mut bytes, at).map_err(|e| Error::io(&self.path, "read", e))?;
            (WORK, 0, bytes)
        } else {
            (self.plan.modes, stored.entry.flags, self.blob(stored)?)
        };
        let [xs, zs] = grid.columns(tx, tz);
        let dims = [xs.len() as u32, grid.dims[1], zs.len() as u32];
        let place = Place { path: &self.path, level, tx, tz, offset: stored.at, flags, modes, dims };
        let max_code = self.about.classes.as_ref().map_or(0, |classes| classes.max_code());
        let mut level = decode_tile(place, &bytes, max_code)?;
        if stored.work_len > 0 && stored.entry.flags & format::MATTER != 0 {
            let place = Place { flags: stored.entry.flags, ..place };
            level.matter = Some(Arc::new(decode_matter(&place, self.blob(stored)?.into(), max_code)?));
        }
        if self.plan.modes.color == ColorMode::None {
            level.exposed = None;
        } else if level.exposed.is_none() {
            // An empty tile has no work blob.
            level.exposed = Some(level.solid.clone());
        }
        Ok(level)
    }
}

/// What work blobs hold.
pub const WORK: Modes = Modes { encoding: Encoding::Solid, color: ColorMode::Voxel };
