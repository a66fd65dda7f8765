//! Scenes to `.pcast` files, and files written whole or not at all.

use std::borrow::Cow;
use std::collections::HashMap;
use std::io::{Seek, SeekFrom, Write};
use std::path::Path;
#[cfg(not(target_arch = "wasm32"))]
use std::{
    fs::{self, File},
    io::BufWriter,
    path::PathBuf,
};

use bytemuck::Zeroable;
use rayon::prelude::*;
use xxhash_rust::xxh3::{xxh3_64, xxh3_128};

use crate::format::column_rle::{self, Form};
use crate::format::file::Modes;
use crate::format::forms::{COLOR_GROUP_SHIFT, Forms, GENERAL, GROUP_SHIFTS, HeightBytes, Lists, Painted, Table};
use crate::format::metadata;
use crate::format::{self, ALIGN, BlobHeader, Grid, Header, Section, TileEntry};
use crate::model::exposure;
use crate::model::matter::Matter;
#[cfg(not(target_arch = "wasm32"))]
use crate::store::passing::Unfinished;
use crate::{About, ColorMode, Columns, Encoding, Error, Feature, Features, Level, MipRule, Result, Rgb, Run, Scene};

/// Writes `path` whole or not at all: into a new file beside it, which is synced and then takes its name. What
/// stood under the name stays until then.
#[cfg(not(target_arch = "wasm32"))]
pub fn write_atomic(path: &Path, write: impl FnOnce(&mut BufWriter<&File>) -> Result<()>) -> Result<()> {
    let (target, folder) = check_target(path)?;
    let file = Unfinished::new(&folder, &target).map_err(|e| Error::io(path, "create", e))?;
    let mut out = BufWriter::with_capacity(1 << 20, file.file());
    write(&mut out)?;
    out.flush().map_err(|e| Error::io(path, "write", e))?;
    drop(out);
    file.finish(&target).map_err(|e| Error::io(path, "create", e))
}

/// The file that writing to `path` makes or replaces, and its folder, if it can be written.
#[cfg(not(target_arch = "wasm32"))]
pub(crate) fn check_target(path: &Path) -> Result<(PathBuf, PathBuf)> {
    let refuse = |kind, text: &str| Err(Error::io(path, "write", std::io::Error::new(kind, text)));
    // A rename would replace a link, or a device such as /dev/null, by a plain file.
    let target = match fs::metadata(path) {
        Ok(m) if m.is_dir() => {
            return refuse(std::io::ErrorKind::IsADirectory, "it is a directory, a file name was expected");
        }
        Ok(m) if !m.is_file() => {
            return refuse(std::io::ErrorKind::InvalidInput, "it is not a regular file");
        }
        Ok(_) => fs::canonicalize(path).map_err(|e| Error::io(path, "open", e))?,
        Err(_) => path.to_path_buf(),
    };
    let folder = target.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new(".")).to_path_buf();
    if !folder.is_dir() {
        return refuse(std::io::ErrorKind::NotFound, "its folder does not exist");
    }
    Ok((target, folder))
}

/// What a path leads to, links and dots resolved; a file that is not there yet is taken to be in its folder.
#[cfg(not(target_arch = "wasm32"))]
pub fn resolved(path: &Path) -> PathBuf {
    fs::canonicalize(path).unwrap_or_else(|_| {
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        match (fs::canonicalize(folder), path.file_name()) {
            (Ok(folder), Some(name)) => folder.join(name),
            _ => path.to_path_buf(),
        }
    })
}

/// Refuses to write `output` over `input`, which would be lost.
#[cfg(not(target_arch = "wasm32"))]
pub fn keep_input(input: &Path, flag: &str, output: &Path) -> Result<()> {
    if resolved(input) == resolved(output) {
        let output = output.display();
        return Err(Error::Argument(format!("{flag} {output}: is the input itself; name another file to write")));
    }
    Ok(())
}

/// Writes a scene, atomically. The bytes depend on the scene alone, not on the number of threads.
#[cfg(not(target_arch = "wasm32"))]
pub fn write_scene(scene: &Scene, path: &Path) -> Result<()> {
    write_atomic(path, |out| write_scene_to(scene, out, path))
}

/// The same bytes into `out`, from its start. `path` is what errors call it.
pub fn write_scene_to(scene: &Scene, out: &mut (impl Write + Seek), path: &Path) -> Result<()> {
    write_scene_with(scene, Features::ALL, out, path)
}

/// The same with tiles that leave out only what `features` says.
pub fn write_scene_with(scene: &Scene, features: Features, out: &mut (impl Write + Seek), path: &Path) -> Result<()> {
    let grids = format::grids(scene.dims());
    let levels = scene
        .levels
        .iter()
        .zip(&grids)
        .enumerate()
        .map(|(k, (level, grid))| LevelSource::new(scene, k, level, grid))
        .collect::<Result<Vec<_>>>()?;
    if scene.levels.len() != grids.len() {
        return Err(Error::Argument(format!("the scene has {} levels, {} were expected", levels.len(), grids.len())));
    }
    let modes = Modes { encoding: scene.encoding, color: scene.color };
    let mut file = SceneWriter::new(
        out,
        path,
        scene.dims(),
        modes,
        scene.mip_rule,
        &About { classes: scene.classes.clone(), ..About::default() },
    )?;
    let mut tiles = Vec::new();
    for level in &levels {
        let [across, along] = level.grid.tiles;
        tiles.extend((0..along).flat_map(|tz| (0..across).map(move |tx| (level, tx, tz))));
    }
    // Some at a time, so that a scene's blobs need not all fit into memory beside it.
    for batch in tiles.chunks(128) {
        file.push(batch.par_iter().map(|&(level, tx, tz)| level.blob(tx, tz, features)).collect::<Result<_>>()?)?;
    }
    file.finish()
}

/// A scene file under construction: blobs in the order of the directory, those that are equal stored once.
pub(crate) struct SceneWriter<'a, W> {
    out: &'a mut W,
    path: &'a Path,
    header: Header,
    entries: Vec<TileEntry>,
    /// Where the file ends so far.
    at: u64,
    /// By 128 bits of hash: two different blobs of a scene never meet by chance.
    stored: HashMap<u128, u64>,
    metadata: Vec<u8>,
}

impl<'a, W: Write + Seek> SceneWriter<'a, W> {
    /// Starts a file at the start of `out`. `path` is what errors call it.
    pub fn new(
        out: &'a mut W,
        path: &'a Path,
        dims: [u32; 3],
        modes: Modes,
        rule: MipRule,
        about: &About,
    ) -> Result<Self> {
        let metadata = metadata::pack(about);
        let grids = format::grids(dims);
        let n_tiles: u64 = grids.iter().map(Grid::n_tiles).sum();
        let n_tiles = u32::try_from(n_tiles)
            .map_err(|_| Error::Limit(format!("the scene has {n_tiles} tiles, a file holds 2³² − 1")))?;
        let header = Header {
            magic: format::MAGIC,
            version: format::VERSION,
            dims,
            encoding: format::encoding_code(modes.encoding),
            color: format::color_code(modes.color),
            mip_rule: format::mip_rule_code(rule),
            n_levels: grids.len() as u8,
            n_tiles,
            directory: (size_of::<Header>() + metadata.len()) as u64,
            ..Header::zeroed()
        };
        let at = header.directory + u64::from(n_tiles) * size_of::<TileEntry>() as u64;
        // The directory is known last and stands first.
        out.seek(SeekFrom::Start(at)).map_err(|e| Error::io(path, "write", e))?;
        let entries = Vec::with_capacity(n_tiles as usize);
        Ok(SceneWriter { out, path, header, entries, at, stored: HashMap::new(), metadata })
    }

    fn write(&mut self, bytes: &[u8]) -> Result<()> {
        self.out.write_all(bytes).map_err(|e| Error::io(self.path, "write", e))
    }

    /// The next tiles, some of them [`compressed`].
    pub fn push(&mut self, tiles: Vec<(TileEntry, Vec<u8>)>) -> Result<()> {
        for (mut entry, blob) in tiles {
            if !blob.is_empty() {
                entry.offset = *self.stored.entry(xxh3_128(&blob)).or_insert(self.at.next_multiple_of(ALIGN));
                if entry.offset >= self.at {
                    self.write(&[0; ALIGN as usize][..(entry.offset - self.at) as usize])?;
                    self.write(&blob)?;
                    self.at = entry.offset + blob.len() as u64;
                }
            }
            let version = match entry.flags {
                flags if flags & format::MATTER != 0 => format::VERSION_MATTER,
                flags if flags & format::SPECIALIZED != 0 => format::VERSION_SPECIALIZED,
                flags if flags & format::COMPRESSED != 0 => format::VERSION_COMPRESSED,
                _ => format::VERSION,
            };
            self.header.version = self.header.version.max(version);
            self.entries.push(entry);
        }
        Ok(())
    }

    /// Writes header and directory, after all tiles.
    pub fn finish(mut self) -> Result<()> {
        assert_eq!(self.entries.len(), self.header.n_tiles as usize, "every tile was pushed");
        let entries = std::mem::take(&mut self.entries);
        let entries: &[u8] = bytemuck::cast_slice(&entries);
        let metadata = std::mem::take(&mut self.metadata);
        if !metadata.is_empty() {
            self.header.version[1] = format::MINOR_METADATA;
        }
        self.header.file_len = self.at;
        self.header.directory_checksum = xxh3_64(entries);
        self.header.checksum = self.header.checksum();
        self.out.seek(SeekFrom::Start(0)).map_err(|e| Error::io(self.path, "write", e))?;
        let header = self.header;
        self.write(bytemuck::bytes_of(&header))?;
        self.write(&metadata)?;
        self.write(entries)
    }
}

/// A tile with its blob as a zstd frame, where that is smaller.
#[cfg(not(target_arch = "wasm32"))]
pub(crate) fn compressed(mut entry: TileEntry, blob: Vec<u8>, level: i32) -> (TileEntry, Vec<u8>) {
    if blob.is_empty() {
        return (entry, blob);
    }
    let frame = zstd::bulk::compress(&blob, level).expect("zstd compresses whatever fits into memory");
    if frame.len() >= blob.len() {
        return (entry, blob);
    }
    entry.flags |= format::COMPRESSED;
    entry.len = frame.len() as u32;
    entry.checksum = xxh3_64(&frame);
    (entry, frame)
}

/// A tile with its matter behind what is solid. An error is the number of bytes, beyond 32 bits.
pub(crate) fn with_matter(
    (mut entry, blob): (TileEntry, Vec<u8>),
    matter: &Matter,
) -> Result<(TileEntry, Vec<u8>), usize> {
    let mut bytes = vec![0; format::MATTER_HEADER];
    bytes[..4].copy_from_slice(&(blob.len() as u32).to_le_bytes());
    bytes.extend_from_slice(&blob);
    bytes.resize(bytes.len().next_multiple_of(ALIGN as usize), 0);
    bytes.extend_from_slice(&matter.pack());
    if u32::try_from(bytes.len()).is_err() {
        return Err(bytes.len());
    }
    entry.flags = entry.flags & !format::EMPTY | format::MATTER;
    (entry.len, entry.checksum) = (bytes.len() as u32, xxh3_64(&bytes));
    Ok((entry, bytes))
}

/// One level, with what its tiles need to be cut out.
struct LevelSource<'a> {
    scene: &'a Scene,
    k: usize,
    level: &'a Level,
    grid: Grid,
    exposed: Cow<'a, Columns>,
    /// Position of each column's first colour in `level.colors`; empty without colours.
    first_color: Vec<u64>,
}

impl<'a> LevelSource<'a> {
    fn new(scene: &'a Scene, k: usize, level: &'a Level, grid: &Grid) -> Result<LevelSource<'a>> {
        let wrong = |what: String| Err(Error::Argument(format!("level {k} of the scene {what}")));
        if level.solid.dims() != grid.dims {
            return wrong(format!("is {:?}, {:?} was expected", level.solid.dims(), grid.dims));
        }
        let n_columns = u64::from(grid.dims[0]) * u64::from(grid.dims[2]);
        if n_columns > format::MAX_COLUMNS {
            return Err(Error::Limit(format!("level {k} has {n_columns} columns, a scene has at most 2³¹")));
        }
        if level.exposed.as_ref().is_some_and(|e| e.dims() != grid.dims) {
            return wrong("has exposed runs of another size".into());
        }
        if level.exposed.is_none() && (scene.encoding == Encoding::Surface || scene.color == ColorMode::Voxel) {
            return wrong("has no exposed runs".into());
        }
        let exposed = match &level.exposed {
            Some(exposed) => Cow::Borrowed(exposed),
            None => Cow::Owned(exposure::exposed(&level.solid)),
        };
        let first_color = match scene.color {
            ColorMode::None => Vec::new(),
            ColorMode::Run => level.geometry(scene.encoding).offsets().iter().map(|&n| u64::from(n)).collect(),
            ColorMode::Voxel => exposed.voxel_offsets(),
        };
        let n_colors = first_color.last().copied().unwrap_or(0);
        if level.colors.len() as u64 != n_colors {
            return wrong(format!("has {} colours, {n_colors} were expected", level.colors.len()));
        }
        Ok(LevelSource { scene, k, level, grid: *grid, exposed, first_color })
    }

    /// The directory entry of a tile, less its offset, and its blob; no bytes where the tile is empty.
    fn blob(&self, tx: u32, tz: u32, features: Features) -> Result<(TileEntry, Vec<u8>)> {
        let [xs, zs] = self.grid.columns(tx, tz);
        let mut colors: Vec<Rgb> = Vec::new();
        if !self.first_color.is_empty() {
            for z in zs.clone() {
                let row = self.level.solid.index(xs.start, z);
                let (from, to) = (self.first_color[row], self.first_color[row + xs.len()]);
                colors.extend_from_slice(&self.level.colors[from as usize..to as usize]);
            }
        }
        let tile = Level {
            solid: self.level.solid.crop(xs.clone(), zs.clone()),
            exposed: Some(self.exposed.crop(xs.clone(), zs.clone())),
            colors,
            matter: None,
        };
        let modes = Modes { encoding: self.scene.encoding, color: self.scene.color };
        let matter = self.level.matter.as_ref().filter(|_| self.scene.classes.is_some()).map(|m| m.crop(xs, zs));
        let made = tile_blob(&tile, modes, features).and_then(|made| match matter.filter(|m| !m.is_empty()) {
            Some(matter) => with_matter(made, &matter),
            None => Ok(made),
        });
        made.map_err(|len| too_long(self.k, tx, tz, len))
    }
}

pub(crate) fn too_long(level: usize, tx: u32, tz: u32, len: usize) -> Error {
    Error::Limit(format!("tile ({tx}, {tz}) of level {level} takes {len} bytes, a tile holds at most 2³² − 1"))
}

/// The directory entry of a tile, less its offset, and its blob; no bytes where the tile is empty. The tile has its
/// exposed runs whatever the modes. An error is the number of bytes, beyond 32 bits.
pub(crate) fn tile_blob(tile: &Level, modes: Modes, features: Features) -> Result<(TileEntry, Vec<u8>), usize> {
    let solid = &tile.solid;
    let exposed = tile.exposed.as_ref().expect("tiles to write have exposed runs");
    let geometry = tile.geometry(modes.encoding);
    if solid.runs().is_empty() {
        return Ok((TileEntry { flags: format::EMPTY, ..TileEntry::zeroed() }, Vec::new()));
    }
    let mut entry = TileEntry {
        n_exposed: exposed.voxels(),
        n_runs: geometry.runs().len() as u32,
        y_min: u16::MAX,
        ..TileEntry::zeroed()
    };
    for run in solid.runs() {
        entry.n_solid += u64::from(run.len());
        entry.y_min = entry.y_min.min(run.first());
        entry.y_max = entry.y_max.max(run.last());
    }

    let mut blob = Blob::new(solid.dims(), features);
    let shown = modes.shows().then_some(exposed);
    match features.has(Feature::Heights).then(|| HeightBytes::of(solid, shown)).flatten() {
        Some(heights) => {
            blob.forms.lists = Lists::Heights { bytes: heights.bytes, base: heights.base };
            blob.section(Section::Geometry, &heights.above);
            if shown.is_some() {
                blob.section(Section::Exposure, &heights.edges);
            }
        }
        None => blob.lists(tile, modes, entry.y_min..=entry.y_max),
    }
    blob.colors(tile, modes);
    blob.entry(entry)
}

/// What [`tile_blob`] gives for a tile without colours whose columns are solid from 0 up, in the order of columns, where
/// features have [`Feature::Heights`].
pub(crate) fn heights_blob(
    dims: [u32; 3],
    heights: &[u16],
    n_exposed: u64,
    features: Features,
) -> Result<(TileEntry, Vec<u8>), usize> {
    let ends = heights.iter().fold((u16::MAX, 0), |(low, high): (u16, u16), &h| (low.min(h), high.max(h)));
    let (base, top) = ends;
    if top == 0 {
        return Ok((TileEntry { flags: format::EMPTY, ..TileEntry::zeroed() }, Vec::new()));
    }
    let mut blob = Blob::new(dims, features);
    let n_bytes = usize::from(top > base) + usize::from(top - base > 0xFF);
    blob.forms.lists = Lists::Heights { bytes: n_bytes, base: base.into() };
    match n_bytes {
        0 => blob.section(Section::Geometry, &[]),
        1 => blob.section(Section::Geometry, &heights.iter().map(|h| (h - base) as u8).collect::<Vec<_>>()),
        _ => {
            let above: Vec<u16> = heights.iter().map(|h| (h - base).to_le()).collect();
            blob.section(Section::Geometry, bytemuck::cast_slice(&above));
        }
    }
    let n_solid = heights.iter().map(|&h| u64::from(h)).sum();
    let n_runs = heights.iter().map(|&h| u32::from(h > 0)).sum();
    let entry = TileEntry { n_solid, n_exposed, n_runs, y_max: top - 1, ..TileEntry::zeroed() };
    blob.entry(entry)
}

/// A blob under construction. Offsets may pass 32 bits until [`Blob::finish`] looks.
struct Blob {
    header: BlobHeader,
    /// Height of the level.
    ny: u32,
    n_columns: usize,
    features: Features,
    forms: Forms,
    bytes: Vec<u8>,
}

impl Blob {
    fn new([width, ny, depth]: [u32; 3], features: Features) -> Blob {
        Blob {
            header: BlobHeader { width: width as u16, depth: depth as u16, ..BlobHeader::zeroed() },
            ny,
            n_columns: width as usize * depth as usize,
            features,
            forms: Forms::general(ny),
            bytes: vec![0; size_of::<BlobHeader>()],
        }
    }

    fn section(&mut self, section: Section, bytes: &[u8]) {
        self.bytes.resize(self.bytes.len().next_multiple_of(ALIGN as usize), 0);
        self.header.sections[section as usize] = [self.bytes.len() as u32, bytes.len() as u32];
        self.bytes.extend(bytes);
    }

    /// The sections of a tile's run lists, whose runs lie between `heights`.
    fn lists(&mut self, tile: &Level, modes: Modes, heights: std::ops::RangeInclusive<u16>) {
        let (solid, geometry) = (&tile.solid, tile.geometry(modes.encoding));
        let exposed =
            tile.exposed.as_ref().filter(|_| modes == Modes { encoding: Encoding::Solid, color: ColorMode::Voxel });
        let kinds = [(Section::Geometry, Some(geometry)), (Section::Exposure, exposed)];
        let mut choices = vec![self.forms.lists];
        if self.features.has(Feature::Lists) && self.ny > 256 {
            let narrow = heights.end() - heights.start() < 256;
            choices.push(match narrow {
                true => Lists::Runs { form: Form::Narrow, base: u32::from(*heights.start()) },
                false => Lists::Runs { form: Form::Flat, base: 0 },
            });
        }
        if self.features.has(Feature::Packed) {
            choices.extend(Lists::packed(modes, &heights));
        }
        if choices.len() > 1 {
            let bytes = |lists: &Lists| {
                let len = |(section, of): (Section, Option<&Columns>)| {
                    of.map_or(0, |of| list_lens(of, lists.of(section, self.ny).0).sum::<usize>())
                };
                kinds.into_iter().map(len).sum::<usize>()
            };
            self.forms.lists = choices.into_iter().min_by_key(bytes).expect("the general layout is one");
        }
        let made = kinds.map(|(section, of)| of.map(|of| self.encoded(section, of)));
        if self.features.has(Feature::Tables) {
            // One size of group for both tables, small enough for both.
            let fits =
                |shift: u32| made.iter().flatten().all(|(starts, _)| fits_groups(starts, shift, self.forms.unit()));
            self.forms.group_shift = GROUP_SHIFTS.into_iter().find(|&shift| fits(shift)).unwrap_or(GROUP_SHIFTS[2]);
        }
        let [of_geometry, of_exposed] = made;
        let (starts, bytes) = of_geometry.expect("every tile has geometry");
        self.table(Section::GeometryTable, &starts, bytes.len() as u64);
        self.section(Section::Geometry, &bytes);
        if modes.encoding == Encoding::Surface {
            let mut fill = vec![0; bytes.len().div_ceil(16)];
            for (ix, start) in starts.iter().enumerate() {
                let mut inside = solid.runs()[solid.range(ix)].iter();
                let mut run = inside.next();
                for (i, shown) in geometry.runs()[geometry.range(ix)].iter().enumerate() {
                    while run.is_some_and(|r| r.last() < shown.first()) {
                        run = inside.next();
                    }
                    // The ends of a solid run are exposed, so what follows inside it is hidden.
                    if run.is_some_and(|r| r.last() > shown.last()) {
                        let bit = *start as usize / 2 + i;
                        fill[bit / 8] |= 1 << (bit % 8);
                    }
                }
            }
            self.section(Section::Fill, &fill);
        }
        if let Some((starts, bytes)) = of_exposed {
            self.table(Section::ExposureTable, &starts, bytes.len() as u64);
            self.section(Section::Exposure, &bytes);
        }
        // What is not there has no form.
        if exposed.is_none() {
            self.forms.tables[1] = Table::Short;
        }
        if !self.forms.tables[..2].contains(&Table::Grouped) {
            self.forms.group_shift = Forms::general(self.ny).group_shift;
        }
    }

    /// The lists of all columns, and where each starts.
    fn encoded(&self, section: Section, of: &Columns) -> (Vec<u64>, Vec<u8>) {
        let (form, base) = self.forms.lists.of(section, self.ny);
        let mut starts = Vec::with_capacity(self.n_columns);
        let mut bytes = Vec::with_capacity(4 * of.runs().len());
        let mut lowered = Vec::new();
        for ix in 0..self.n_columns {
            starts.push(bytes.len() as u64);
            let runs = &of.runs()[of.range(ix)];
            if base == 0 {
                column_rle::encode(runs, form, &mut bytes);
            } else {
                let base = base as u16;
                lowered.clear();
                lowered.extend(runs.iter().map(|r| Run::new(r.first() - base, r.last() - base)));
                column_rle::encode(&lowered, form, &mut bytes);
            }
        }
        (starts, bytes)
    }

    /// A table of where columns start in the section that follows it, which holds `total`.
    fn table(&mut self, section: Section, starts: &[u64], total: u64) {
        let n = starts.len() as u64;
        let shift = self.forms.group_shift;
        let rows = || starts.chunks(self.header.width as usize);
        let mut bytes = Vec::with_capacity(starts.len() * 4);
        let form = if self.features.has(Feature::Tables) && evenly(starts, total) {
            *self.forms.table_mut(section) = Table::Even;
            return;
        } else if self.features.has(Feature::Tables) && section == Section::ColorTable {
            bytes.extend(starts.iter().step_by(1 << COLOR_GROUP_SHIFT).flat_map(|&s| (s as u32).to_le_bytes()));
            Table::Grouped
        } else if self.features.has(Feature::Tables) && fits_groups(starts, shift, self.forms.unit()) {
            let unit = self.forms.unit() as u64;
            bytes.extend(starts.iter().step_by(1 << shift).flat_map(|&s| (s as u32).to_le_bytes()));
            bytes.extend(starts.chunks(1 << shift).flat_map(|g| g.iter().map(|s| ((s - g[0]) / unit) as u8)));
            Table::Grouped
        } else if rows().all(|row| row[row.len() - 1] - row[0] <= u64::from(u16::MAX)) {
            rows().for_each(|row| bytes.extend((row[0] as u32).to_le_bytes()));
            rows().for_each(|row| bytes.extend(row.iter().flat_map(|s| ((s - row[0]) as u16).to_le_bytes())));
            Table::Short
        } else {
            bytes.extend(starts.iter().flat_map(|&s| (s as u32).to_le_bytes()));
            Table::Long
        };
        debug_assert_eq!(n as usize, self.n_columns);
        *self.forms.table_mut(section) = form;
        self.section(section, &bytes);
    }

    /// The sections of a tile's colours.
    fn colors(&mut self, tile: &Level, modes: Modes) {
        let exposed = tile.exposed.as_ref().expect("tiles to write have exposed runs");
        let counts = |of: &Columns| of.offsets().iter().map(|&n| u64::from(n)).collect::<Vec<u64>>();
        let mut starts: Vec<u64> = match modes.color {
            ColorMode::None => return,
            ColorMode::Run => counts(tile.geometry(modes.encoding)),
            ColorMode::Voxel => exposed.voxel_offsets(),
        };
        let colors = &tile.colors;
        let same = |colors: &[Rgb]| colors.windows(2).all(|pair| pair[0] == pair[1]);
        let first_of = |starts: &[u64]| -> Option<Vec<Rgb>> {
            let mut first = Vec::with_capacity(starts.len());
            for part in starts.windows(2) {
                let part = &colors[part[0] as usize..part[1] as usize];
                if !same(part) {
                    return None;
                }
                first.push(part.first().copied().unwrap_or_default());
            }
            Some(first)
        };
        let mut kept: Cow<[Rgb]> = Cow::Borrowed(colors);
        if self.features.has(Feature::Colors) {
            let n_runs = if modes.color == ColorMode::Voxel { exposed.runs().len() } else { colors.len() };
            if same(colors) {
                (self.forms.painted, kept) = (Painted::Tile, vec![colors[0]].into());
            } else if self.n_columns <= n_runs
                && let Some(of_columns) = first_of(&starts)
            {
                (self.forms.painted, kept) = (Painted::Column, of_columns.into());
            } else if modes.color == ColorMode::Voxel
                && n_runs < colors.len()
                && let Some(of_runs) = first_of(&run_starts(exposed))
            {
                (self.forms.painted, kept) = (Painted::Run, of_runs.into());
                starts = counts(exposed);
            }
        }
        if let Painted::Each | Painted::Run = self.forms.painted {
            let total = starts.pop().expect("one more than there are columns");
            self.table(Section::ColorTable, &starts, total);
        }
        self.section(Section::Colors, kept.as_flattened());
    }

    /// The bytes, with what the directory says of them beside `entry`.
    fn entry(self, entry: TileEntry) -> Result<(TileEntry, Vec<u8>), usize> {
        let (blob, specialized) = self.finish()?;
        let flags = if specialized { format::SPECIALIZED } else { 0 };
        Ok((TileEntry { flags, len: blob.len() as u32, checksum: xxh3_64(&blob), ..entry }, blob))
    }

    /// The bytes, and whether any form is another than in the general layout. An error is their number, beyond 32 bits.
    fn finish(mut self) -> Result<(Vec<u8>, bool), usize> {
        if u32::try_from(self.bytes.len()).is_err() {
            return Err(self.bytes.len());
        }
        self.header.forms = self.forms.pack(self.ny);
        self.bytes[..size_of::<BlobHeader>()].copy_from_slice(bytemuck::bytes_of(&self.header));
        Ok((self.bytes, self.header.forms & !GENERAL != 0))
    }
}

/// Bytes that the sections of a tile take in the general layout.
pub(crate) fn general_lens(tile: &Level, modes: Modes) -> [u64; 7] {
    let mut lens = [0; 7];
    let form = Form::of(tile.solid.ny());
    let (width, depth) = (tile.solid.nx() as usize, tile.solid.nz() as usize);
    // From what each column takes of a section, in units of so many bytes.
    let mut columns = |table: Section, each: Vec<u64>, unit: u64| {
        let before_last = |row: &[u64]| row[..row.len() - 1].iter().sum::<u64>();
        let short = each.chunks(width).all(|row| before_last(row) <= u64::from(u16::MAX));
        lens[table as usize] = (if short { 4 * depth + 2 * width * depth } else { 4 * width * depth }) as u64;
        lens[table.columns() as usize] = unit * each.iter().sum::<u64>();
    };
    let lists = |of: &Columns| list_lens(of, form).map(|n| n as u64).collect();
    columns(Section::GeometryTable, lists(tile.geometry(modes.encoding)), 1);
    if let (Some(exposed), Encoding::Solid) = (&tile.exposed, modes.encoding) {
        columns(Section::ExposureTable, lists(exposed), 1);
    }
    match (modes.color, &tile.exposed) {
        (ColorMode::Voxel, Some(exposed)) => {
            let n_colors = exposed.voxel_offsets().windows(2).map(|n| n[1] - n[0]).collect();
            columns(Section::ColorTable, n_colors, 3);
        }
        (ColorMode::Run, _) => {
            let offsets = tile.geometry(modes.encoding).offsets();
            columns(Section::ColorTable, offsets.windows(2).map(|n| u64::from(n[1] - n[0])).collect(), 3);
        }
        _ => {}
    }
    if modes.encoding == Encoding::Surface {
        lens[Section::Fill as usize] = lens[Section::Geometry as usize].div_ceil(16);
    }
    lens
}

/// Bytes of the list of each column.
pub(crate) fn list_lens(of: &Columns, form: Form) -> impl Iterator<Item = usize> {
    (0..of.offsets().len() - 1).map(move |ix| form.len(&of.runs()[of.range(ix)]))
}

/// Whether all columns take the same of `total`.
fn evenly(starts: &[u64], total: u64) -> bool {
    let n = starts.len() as u64;
    total.is_multiple_of(n) && starts.iter().zip(0..).all(|(&start, ix)| start == total / n * ix)
}

/// Whether offsets within groups of columns, in units, fit a byte.
fn fits_groups(starts: &[u64], shift: u32, unit: usize) -> bool {
    starts.chunks(1 << shift).all(|group| group[group.len() - 1] - group[0] <= 255 * unit as u64)
}

/// Voxels before each run, and in all.
fn run_starts(columns: &Columns) -> Vec<u64> {
    let mut n = 0;
    let ends = columns.runs().iter().map(|r| {
        n += u64::from(r.len());
        n
    });
    std::iter::once(0).chain(ends).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;
    use crate::{BuildOptions, build};

    fn scene() -> Scene {
        build(testing::input(Columns::from_fn(9, 9, 9, |x, y, _| y <= x), true), &BuildOptions::default()).unwrap()
    }

    #[test]
    fn write_refuses_what_is_no_file_and_leaves_it() {
        let dir = tempfile::tempdir().unwrap();
        let refused = |path: &Path| write_scene(&scene(), path).unwrap_err().to_string();
        assert!(refused(dir.path()).ends_with("cannot write: it is a directory, a file name was expected"));
        assert!(refused(&dir.path().join("no/a.pcast")).ends_with("cannot write: its folder does not exist"));
        #[cfg(unix)]
        assert!(refused(Path::new("/dev/null")).ends_with("cannot write: it is not a regular file"));
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
    }

    #[test]
    fn write_that_fails_keeps_the_file_that_was() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.pcast");
        fs::write(&path, "before").unwrap();
        let failed = write_atomic(&path, |out| {
            out.write_all(b"half").unwrap();
            Err(Error::Limit("disk full, say".into()))
        });
        assert!(failed.is_err());
        assert_eq!(fs::read(&path).unwrap(), b"before");
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
        write_atomic(&path, |out| out.write_all(b"after").map_err(|e| Error::io(&path, "write", e))).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"after");
    }

    #[cfg(unix)]
    #[test]
    fn write_through_a_link_keeps_the_link() {
        let dir = tempfile::tempdir().unwrap();
        let (file, link) = (dir.path().join("file"), dir.path().join("link"));
        fs::write(&file, "before").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        write_scene(&scene(), &link).unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert!(fs::read(&file).unwrap().starts_with(&format::MAGIC));
    }

    #[test]
    fn write_refuses_scenes_that_contradict_themselves() {
        let refused = |change: fn(&mut Scene)| {
            let mut scene = scene();
            change(&mut scene);
            let dir = tempfile::tempdir().unwrap();
            write_scene(&scene, &dir.path().join("a")).unwrap_err().to_string()
        };
        assert_eq!(refused(|s| s.levels[1].colors.truncate(1)), "level 1 of the scene has 1 colours, 66 were expected");
        assert_eq!(refused(|s| s.levels[2].exposed = None), "level 2 of the scene has no exposed runs");
        assert_eq!(refused(|s| s.levels.truncate(2)), "the scene has 2 levels, 5 were expected");
        assert!(refused(|s| s.levels.swap(0, 1)).starts_with("level 1 of the scene is [9, 9, 9], [3, 3, 3] was"));
    }
}
