//! The byte layout of a `.pcast` file, versions 1 to 4.
//!
//! Little-endian throughout. Files are written whole and never changed in place; every blob is readable by itself.
//!
//! ```text
//! | Header 64 B | TileEntry 48 B × n_tiles ]-[ Blob ]-[ Blob …          - = zero bytes to a multiple of 16
//!                                             |
//! | BlobHeader 64 B | geometry table ]-[ geometry columns ]-[ fill ]-[ exposure table ]-[ exposure columns
//!                                                              ]-[ colour table ]-[ colours ]
//! ```
//!
//! # Header and directory
//!
//! ```text
//! Header 64 B                                      TileEntry 48 B
//!   magic              u8 × 8   0                    offset     u64   0  of the blob, from the file's start
//!   version            u16 × 2  8  major, minor      checksum   u64   8  xxh3-64 of the blob
//!   dims               u32 × 3  12 nx, ny, nz        n_solid    u64  16  solid voxels
//!   encoding           u8       24 0 solid,          n_exposed  u64  24  voxels with an exposed face
//!                                  1 surface         len        u32  32  of the blob
//!   color              u8       25 0 none, 1 run,    n_runs     u32  36  geometry runs
//!                                  2 voxel           y_min      u16  40  lowest solid voxel
//!   mip_rule           u8       26 0 any,            y_max      u16  42  highest
//!                                  1 majority        flags      u32  44  bit 0: no solid voxel; there is no blob
//!   n_levels           u8       27                                       and all else is 0
//!   n_tiles            u32      28
//!   directory          u64      32 offset of the first TileEntry
//!   file_len           u64      40
//!   directory_checksum u64      48 xxh3-64 of the directory
//!   checksum           u64      56 xxh3-64 of the 56 bytes before
//! ```
//!
//! A level is half of the one before in x, y and z, rounded up; the last is the first with one column. Its columns
//! are cut into tiles of 256 × 256 (fewer at the far edges). The directory lists the tiles of level 0, x fastest,
//! then z, then those of level 1, and so on. Tiles with equal blobs share one; otherwise blobs do not overlap.
//!
//! Version 2 is version 1 with tiles that may be compressed: bit 1 of a tile's flags says that its blob is a zstd frame
//! (RFC 8878) of what version 1 would hold; `len` and `checksum` are of the frame. Files without such tiles are of version
//! 1.
//!
//! Version 3 is version 2 with tiles that may be specialized: bit 2 of a tile's flags says that sections of its blob have
//! [other forms](#specialized-tiles) than below, or are not there. Files without such tiles are of version 1 or 2.
//!
//! Version 4 is version 3 with tiles that hold [translucent matter](#matter): bit 3 of a tile's flags says so. Files without such
//! tiles are of version 1 to 3, and the same as before there was a version 4.
//!
//! A new major version is one that old readers must refuse; a new minor version adds what they may ignore.
//!
//! # Metadata
//!
//! Minor version 1 has sections between the header and the directory, which then does not follow at once; a file that has
//! nothing to say in them is of minor version 0. No section changes what is solid or coloured, and [`crate::inspect::info::content_hash`]
//! knows nothing of them. Readers pass over sections whose tag they do not know.
//!
//! ```text
//! | Header | Section ]-[ Section ]-[ TileEntry …        Section
//!                                                         tag      u8 × 4   0
//!                                                         len      u32      4   of the bytes that follow
//!                                                         checksum u64      8   xxh3-64 of them
//!                                                         bytes    u8 × len 16
//! ```
//!
//! | tag | bytes |
//! |---|---|
//! | `ABUT` | [`About`](crate::About) as one JSON object in UTF-8, at most 1 MiB: what was encoded, and how it was read. Fields may be left out or be new |
//! | `FRAC` | a byte for each column of level 0, by rows of x: of a height field, how far the surface that it stands for is above a column's top, in 256ths of a voxel, 128 more |
//!
//! | `CLAS` | the classes of translucent matter as one JSON object: `{"window": [low, high] or null, "classes": [{"color": [r, g, b], "opacity": share a voxel takes, "mode": "volumetric", "surface", "additive" or "emissive"}]}`. Files of version 4 have it |
//!
//! # Blob
//!
//! ```text
//! BlobHeader 64 B
//!   width    u16                  0   columns in x
//!   depth    u16                  2   columns in z
//!   forms    u32                  4   bit 0, 1, 2: the geometry, exposure, colour table is a long one;
//!                                     the others for specialized tiles
//!   sections { offset u32,        8   from the blob's start, ascending, multiples of 16; 0 where there is none
//!              len u32 } × 7     12
//! ```
//!
//! | section | holds | present |
//! |---|---|---|
//! | 0 geometry table | where each column starts in section 1 | always |
//! | 1 geometry columns | [two-level lists](crate::format::column_rle): the solid runs, or (surface) the exposed ones | always |
//! | 2 fill | bits, lowest first: whether the gap above a run is solid inside, not air | surface |
//! | 3 exposure table | where each column starts in section 4 | solid with voxel colours |
//! | 4 exposure columns | two-level lists of the exposed runs | solid with voxel colours |
//! | 5 colour table | how many colours come before each column's | run and voxel colours |
//! | 6 colours | `{ r u8, g u8, b u8 }`, sRGB: one a geometry run, or one an exposed voxel | run and voxel colours |
//!
//! Column `(x, z)` of a tile is number `z·width + x`. A **table** gives each column a start; it ends where the next
//! starts, and the last at the section's end.
//!
//! ```text
//! short   base u32 × depth, then offset u16 × depth·width      start = base[z] + offset[z·width + x]
//! long    start u32 × depth·width                              where a row's offsets pass 65,535
//! ```
//!
//! The fill bit of run `i` of the column that starts at byte `b` of section 1 is number `b/2 + i`: a run takes two
//! bytes at least, so no two runs share a bit and no table is needed. Below the first run and above the last of a
//! column all is air.
//!
//! # Specialized tiles
//!
//! A tile whose columns, tables or colours have no use for the general form takes a shorter one, chosen from what the tile
//! holds alone: never from threads, memory or neighbours, so that equal tiles stay equal.
//!
//! ```text
//! forms, by bits
//!   0..3    long                             | 6..9    grouped        of geometry, exposure, colour table
//!   3..6    even                             | 9..11   log2 of a group's columns, less 3 (geometry and exposure)
//!   11..14  lists: 0 as the level's height says, 1 narrow, 2 flat, 3 one height, 4 heights u8, 5 heights u16,
//!           6 packed
//!   14..16  one colour a: 0 run or voxel, as the header says, 1 exposed run, 2 column, 3 tile
//!   16..32  base: lowest voxel (lists 1), least height (lists 3 to 5), else 0; of packed lists
//!           16..20 bits of a boundary, less 4, 20..32 base: a sixteenth of the height that boundaries count from
//! ```
//!
//! **Lists** (1, 2): both kinds of columns are in the form that is named, and starts of runs count from the base. A tile of
//! a high level that spans at most 256 heights needs no first level, and few long runs need none either.
//!
//! **Packed** (6): section 1 holds the starts and ends of runs, of 4 to 17 bits each. They do not number voxels, so there are none in
//! surface scenes with colours a voxel, and in other surface scenes they have 8 bits at least, so that a run takes two bytes. In
//! solid scenes with colours a voxel, section 4 is in the narrow form in levels at most 256 high, in the flat form in higher
//! ones, without a base. No program of version 3 was released before there were packed lists: they are part of it.
//!
//! **Heights** (3 to 5), where every column is empty or one run from y = 0 up: section 1 holds a number a column, or none
//! (3); the column is solid below the sum of that number and the base. There is no table and no fill. Where the scene keeps exposed voxels (surface, or colours a voxel), they are voxel 0 and those from
//! `low` up, with `low` the least height of the four neighbours, at least 1 and below the column's own height. For the
//! columns at the tile's edges, in their order, section 4 holds it as u16 (0 where the height is below 2): their neighbours
//! are in other tiles.
//!
//! **Tables**: where all columns take equally much there is none (even). A grouped table holds a start for each 8, 16 or 32
//! columns, and a byte a column to add to it, in units of two bytes but for narrow and packed lists. Grouped colour tables hold a
//! start for each 16 columns and no bytes: how many colours a column has is known from its runs.
//!
//! ```text
//! grouped  start u32 × ⌈columns / group⌉, then offset u8 × columns
//! ```
//!
//! **Colours** a tile, a column (empty ones, too) or an exposed run, where finer ones say the same. The first two need no
//! table.
//!
//! # Matter
//!
//! The blob of a tile with matter (once unpacked, where it is compressed) is that of what is solid, if anything is, between a header
//! and the matter:
//!
//! ```text
//! solid_len u32, zeros 12 B | blob of solid_len B, as above, or nothing ]-[ end u32 × depth·width | run u32 × n
//!   run: last u16 (low half), code u16 (high half)          end: of the column's runs, counted from the tile's first
//! ```
//!
//! A column's runs go from voxel 0 up, each from behind the one before to its last voxel. Code 0 is nothing, code 8·k class k of
//! `CLAS`, counted from 1; what lies between is a mixture ([`crate::model::matter`]), as coarser levels have. Matter may lie where
//! voxels are solid; what is solid counts.
//!
//! Levels are never left out: with `--lod`, `--view-distance` and `--repeat` any of them may be the one to draw, and readers
//! rely on all. Those above the first that has one tile cost 112 bytes each for entry and header, and together less than a
//! third of that tile: of an elevation map of 998 × 1,058, 8 of 12 levels with 6.5 kB of 1.4 MB; of a volume of 1,024³, 8 of
//! 11 with 148 kB of 20 MB.
//!
//! # Reference decoder
//!
//! ```
//! /// Whether voxel (x, y, z) of level 0 is solid.
//! fn solid(file: &[u8], x: usize, y: usize, z: usize) -> bool {
//!     let u16 = |at: usize| u16::from_le_bytes(file[at..at + 2].try_into().unwrap()) as usize;
//!     let u32 = |at: usize| u32::from_le_bytes(file[at..at + 4].try_into().unwrap()) as usize;
//!     let (nx, ny, surface) = (u32(12), u32(16), file[24] == 1);
//!     let tile = u32(32) + 48 * (z / 256 * nx.div_ceil(256) + x / 256);
//!     if u32(tile + 44) & 1 == 1 {
//!         return false;
//!     }
//!     let blob = u32(tile); // A file of 4 GiB and more needs all eight bytes.
//!     let (width, depth, forms, base) = (u16(blob), u16(blob + 2), u16(blob + 4), u16(blob + 6));
//!     let [table, columns, fill] = [0, 1, 2].map(|i| blob + u32(blob + 8 + 8 * i));
//!     let lists = forms >> 11 & 7;
//!     let (bits, base) = if lists == 6 { (4 + base % 16, base - base % 16) } else { (0, base) };
//!     let (column, len) = (z % 256 * width + x % 256, u32(blob + 20));
//!     let lists = match lists {
//!         3 => return y < base,
//!         4 => return y < base + file[columns + column] as usize,
//!         5 => return y < base + u16(columns + 2 * column),
//!         0 if ny <= 256 => 1,
//!         lists => lists,
//!     };
//!     let shift = 3 + (forms >> 9 & 3);
//!     let start = |column: usize| match forms & 0b1001001 {
//!         _ if column == width * depth => len,
//!         0b1 => u32(table + 4 * column),
//!         0b1000 => len / (width * depth) * column,
//!         0b1000000 => {
//!             let offset = file[table + 4 * (width * depth).div_ceil(1 << shift) + column] as usize;
//!             u32(table + 4 * (column >> shift)) + offset * if lists == 1 || lists == 6 { 1 } else { 2 }
//!         }
//!         _ => u32(table + 4 * (column / width)) + u16(table + 4 * depth + 2 * column),
//!     };
//!     let (at, end) = (columns + start(column), columns + start(column + 1));
//!     let mut runs = Vec::new(); // (start, voxels before)
//!     if at == end || y < base {
//!         return false;
//!     } else if lists == 1 {
//!         runs.extend((at..end - 1).step_by(2).map(|i| (file[i] as usize, file[i + 1] as usize)));
//!         runs.push((ny + 1, match file[end - 1] { 0 => 256, total => total as usize }));
//!     } else if lists == 2 {
//!         runs.extend((at..end - 2).step_by(4).map(|i| (u16(i), u16(i + 2))));
//!         runs.push((ny + 1, match u16(end - 2) { 0 => 65_536, total => total }));
//!     } else if lists == 6 {
//!         let bit = |i: usize| (file[at + i / 8] >> (i % 8) & 1) as usize;
//!         let boundary = |i: usize| (0..bits).map(|b| bit(bits * i + b) << b).sum::<usize>();
//!         let mut before = 0;
//!         for i in 0..(end - at) * 8 / (2 * bits) {
//!             runs.push((boundary(2 * i), before));
//!             before += boundary(2 * i + 1) - boundary(2 * i);
//!         }
//!         runs.push((ny + 1, before));
//!     } else {
//!         let mut run = at + 2 + 6 * u16(at) + 2;
//!         for bucket in (at + 2..).step_by(6).take(u16(at)) {
//!             for _ in 0..file[bucket + 1] {
//!                 runs.push((file[bucket] as usize * 256 + file[run] as usize, u16(bucket + 2) + file[run + 1] as usize));
//!                 run += 2;
//!             }
//!         }
//!         runs.push((ny + 1, match u16(at + 2 + 6 * u16(at)) { 0 => 65_536, total => total }));
//!     }
//!     let Some(i) = runs.iter().rposition(|r| base + r.0 <= y) else { return false };
//!     let bit = start(column) / 2 + i;
//!     y < base + runs[i].0 + runs[i + 1].1 - runs[i].1 || surface && file[fill + bit / 8] >> (bit % 8) & 1 == 1
//! }
//! # use planecast_encoder::{BuildOptions, Colors, Columns, Encoding, Features, Input, build, format::write::write_scene_with};
//! # let caves = |x: u32, y: u32, z: u32| y <= 20 + x % 7 || y > 31 && (x ^ y ^ z) % 5 == 0;
//! # let hills = |x: u32, y: u32, z: u32| y < 10 + x * z % 29 && !(x > 255 && x + z > 265);
//! # let flat = |x: u32, y: u32, _: u32| y < 30 || x < 256 && y >= 280;
//! # let slopes = |x: u32, y: u32, _: u32| y < x && x > 9;
//! # let raised = |x: u32, y: u32, z: u32| y > 45 && (x ^ y ^ z) % 9 < 5;
//! # let sparse = |x: u32, y: u32, z: u32| (y / 24 + x + z) % 3 == 1;
//! # let worlds: [fn(u32, u32, u32) -> bool; 6] = [caves, hills, flat, slopes, raised, sparse];
//! # for (k, world) in (0..48).map(|k| (k, worlds[k / 8])) {
//! #     let (ny, encoding) = ([40, 300][k % 2], [Encoding::Solid, Encoding::Surface][k / 2 % 2]);
//! #     let features = [Features::NONE, Features::ALL][k / 4 % 2];
//! #     let columns = Columns::from_fn(270, ny, 9, world);
//! #     let input = Input { columns, colors: Colors::None, notes: Vec::new() };
//! #     let mut file = std::io::Cursor::new(Vec::new());
//! #     let scene = build(input, &BuildOptions { encoding, ..Default::default() })?;
//! #     write_scene_with(&scene, features, &mut file, "world.pcast".as_ref())?;
//! #     let file = file.into_inner();
//! for (x, y, z) in (0..270).step_by(9).flat_map(|x| (0..ny).flat_map(move |y| (0..9).map(move |z| (x, y, z)))) {
//!     assert_eq!(solid(&file, x as usize, y as usize, z as usize), world(x, y, z));
//! }
//! # }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod arriving;
pub mod column_rle;
pub mod features;
pub mod file;
pub mod forms;
pub(crate) mod lists;
pub mod metadata;
pub mod ranged;
pub mod sheets;
pub mod write;

use bytemuck::{Pod, Zeroable};
use xxhash_rust::xxh3::xxh3_64;

use crate::encode::mips;
use crate::{ColorMode, Encoding, MipRule};

#[cfg(target_endian = "big")]
compile_error!("the structures of .pcast are little-endian and used as they lie in the file");

/// PNG's idea: the high bit, line ends and control-Z show a transfer that was not binary.
pub const MAGIC: [u8; 8] = *b"\x89PCV\r\n\x1a\n";
pub const VERSION: [u16; 2] = [1, 0];
/// Of files with compressed tiles.
pub const VERSION_COMPRESSED: [u16; 2] = [2, 0];
/// Of files with specialized tiles.
pub const VERSION_SPECIALIZED: [u16; 2] = [3, 0];
/// Of files with translucent matter.
pub const VERSION_MATTER: [u16; 2] = [4, 0];
/// Minor version of files with metadata.
pub const MINOR_METADATA: u16 = 1;
/// Columns of a tile along x and z.
pub const TILE: u32 = 256;
/// Blobs start at multiples of this in the file, sections in their blob.
pub const ALIGN: u64 = 16;
/// Columns of a level: their offsets alone take 8 GiB in memory.
pub const MAX_COLUMNS: u64 = 1 << 31;
/// [`TileEntry::flags`]: no solid voxel, no blob.
pub const EMPTY: u32 = 1;
/// [`TileEntry::flags`]: the blob is a zstd frame.
pub const COMPRESSED: u32 = 2;
/// [`TileEntry::flags`]: the blob has forms other than those of the general layout.
pub const SPECIALIZED: u32 = 4;
/// [`TileEntry::flags`]: translucent matter follows what is solid.
pub const MATTER: u32 = 8;
/// Bytes before the solid part of a blob with matter.
pub const MATTER_HEADER: usize = 16;

#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct Header {
    pub magic: [u8; 8],
    pub version: [u16; 2],
    pub dims: [u32; 3],
    pub encoding: u8,
    pub color: u8,
    pub mip_rule: u8,
    pub n_levels: u8,
    pub n_tiles: u32,
    pub directory: u64,
    pub file_len: u64,
    pub directory_checksum: u64,
    pub checksum: u64,
}

impl Header {
    /// What `checksum` should be.
    pub fn checksum(&self) -> u64 {
        xxh3_64(&bytemuck::bytes_of(self)[..56])
    }
}

#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct TileEntry {
    pub offset: u64,
    pub checksum: u64,
    pub n_solid: u64,
    pub n_exposed: u64,
    pub len: u32,
    pub n_runs: u32,
    pub y_min: u16,
    pub y_max: u16,
    pub flags: u32,
}

impl TileEntry {
    pub fn is_empty(&self) -> bool {
        self.flags & EMPTY != 0
    }
}

/// Numbers of the sections of a blob.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Section {
    GeometryTable,
    Geometry,
    Fill,
    ExposureTable,
    Exposure,
    ColorTable,
    Colors,
}

impl Section {
    pub const ALL: [Section; 7] = [
        Section::GeometryTable,
        Section::Geometry,
        Section::Fill,
        Section::ExposureTable,
        Section::Exposure,
        Section::ColorTable,
        Section::Colors,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Section::GeometryTable => "geometry table",
            Section::Geometry => "geometry columns",
            Section::Fill => "fill",
            Section::ExposureTable => "exposure table",
            Section::Exposure => "exposure columns",
            Section::ColorTable => "colour table",
            Section::Colors => "colours",
        }
    }

    /// Whether the blobs of such a scene have this section.
    pub fn present(self, encoding: Encoding, color: ColorMode) -> bool {
        match self {
            Section::GeometryTable | Section::Geometry => true,
            Section::Fill => encoding == Encoding::Surface,
            Section::ExposureTable | Section::Exposure => encoding == Encoding::Solid && color == ColorMode::Voxel,
            Section::ColorTable | Section::Colors => color != ColorMode::None,
        }
    }

    /// The section that a table leads into; itself for others.
    pub fn columns(self) -> Section {
        match self {
            Section::GeometryTable => Section::Geometry,
            Section::ExposureTable => Section::Exposure,
            Section::ColorTable => Section::Colors,
            section => section,
        }
    }

    /// The bit of [`BlobHeader::forms`] that says that a table is a long one.
    pub fn long_bit(self) -> u32 {
        match self {
            Section::GeometryTable => 1,
            Section::ExposureTable => 2,
            Section::ColorTable => 4,
            _ => 0,
        }
    }
}

#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct BlobHeader {
    pub width: u16,
    pub depth: u16,
    /// Which forms the sections have.
    pub forms: u32,
    /// `[offset, len]`, by [`Section`].
    pub sections: [[u32; 2]; 7],
}

pub fn encoding_code(encoding: Encoding) -> u8 {
    encoding as u8
}

pub fn color_code(color: ColorMode) -> u8 {
    color as u8
}

pub fn mip_rule_code(rule: MipRule) -> u8 {
    rule as u8
}

/// The tiles of one level.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Grid {
    /// `[nx, ny, nz]` of the level.
    pub dims: [u32; 3],
    /// Tiles along x and z.
    pub tiles: [u32; 2],
    /// Number of the level's first tile in the directory.
    pub first: u64,
}

impl Grid {
    pub fn n_tiles(&self) -> u64 {
        u64::from(self.tiles[0]) * u64::from(self.tiles[1])
    }

    /// The columns of a tile, along x and z.
    pub fn columns(&self, tx: u32, tz: u32) -> [std::ops::Range<u32>; 2] {
        let cut = |t: u32, n: u32| t * TILE..n.min((t * TILE).saturating_add(TILE));
        [cut(tx, self.dims[0]), cut(tz, self.dims[2])]
    }
}

/// The grids of all levels of a world.
pub fn grids(dims: [u32; 3]) -> Vec<Grid> {
    let mut grids = Vec::new();
    let (mut dims, n, mut first) = (dims, mips::n_levels(dims), 0);
    for _ in 0..n {
        let grid = Grid { dims, tiles: [dims[0].div_ceil(TILE), dims[2].div_ceil(TILE)], first };
        first += grid.n_tiles();
        grids.push(grid);
        dims = mips::next_dims(dims);
    }
    grids
}

#[cfg(test)]
mod tests {
    use std::mem::{offset_of, size_of};

    use super::*;

    /// The byte map in this module's documentation is the promise; the structs keep it.
    #[test]
    fn format_structs_lie_as_documented() {
        assert_eq!(size_of::<Header>(), 64);
        assert_eq!(offset_of!(Header, magic), 0);
        assert_eq!(offset_of!(Header, version), 8);
        assert_eq!(offset_of!(Header, dims), 12);
        assert_eq!(offset_of!(Header, encoding), 24);
        assert_eq!(offset_of!(Header, color), 25);
        assert_eq!(offset_of!(Header, mip_rule), 26);
        assert_eq!(offset_of!(Header, n_levels), 27);
        assert_eq!(offset_of!(Header, n_tiles), 28);
        assert_eq!(offset_of!(Header, directory), 32);
        assert_eq!(offset_of!(Header, file_len), 40);
        assert_eq!(offset_of!(Header, directory_checksum), 48);
        assert_eq!(offset_of!(Header, checksum), 56);

        assert_eq!(size_of::<TileEntry>(), 48);
        assert_eq!(offset_of!(TileEntry, offset), 0);
        assert_eq!(offset_of!(TileEntry, checksum), 8);
        assert_eq!(offset_of!(TileEntry, n_solid), 16);
        assert_eq!(offset_of!(TileEntry, n_exposed), 24);
        assert_eq!(offset_of!(TileEntry, len), 32);
        assert_eq!(offset_of!(TileEntry, n_runs), 36);
        assert_eq!(offset_of!(TileEntry, y_min), 40);
        assert_eq!(offset_of!(TileEntry, y_max), 42);
        assert_eq!(offset_of!(TileEntry, flags), 44);

        assert_eq!(size_of::<BlobHeader>(), 64);
        assert_eq!(offset_of!(BlobHeader, width), 0);
        assert_eq!(offset_of!(BlobHeader, depth), 2);
        assert_eq!(offset_of!(BlobHeader, forms), 4);
        assert_eq!(offset_of!(BlobHeader, sections), 8);
    }

    #[test]
    fn format_codes_are_as_documented() {
        assert_eq!([Encoding::Solid, Encoding::Surface].map(encoding_code), [0, 1]);
        assert_eq!([ColorMode::None, ColorMode::Run, ColorMode::Voxel].map(color_code), [0, 1, 2]);
        assert_eq!([MipRule::Any, MipRule::Majority].map(mip_rule_code), [0, 1]);
        assert_eq!(Section::ALL.map(|s| s as usize), [0, 1, 2, 3, 4, 5, 6]);
    }

    #[test]
    fn format_grids_cover_every_column_once() {
        let grids = grids([600, 9, 256]);
        assert_eq!(grids.len(), 11);
        assert_eq!(grids[0].tiles, [3, 1]);
        assert_eq!(grids[0].columns(2, 0), [512..600, 0..256]);
        assert_eq!((grids[1].first, grids[1].tiles, grids[1].dims), (3, [2, 1], [300, 5, 128]));
        assert_eq!((grids[10].first, grids[10].tiles, grids[10].dims), (13, [1, 1], [1, 1, 1]));
    }
}
