//! What a scene file holds, in figures.

use std::fmt;

use rayon::prelude::*;
use serde::Serialize;
use xxhash_rust::xxh3::Xxh3;

use crate::encode::memory;
use crate::format::features::Named;
use crate::format::file::{Blob, Modes};
use crate::format::forms::{Forms, Lists, Painted, Table};
use crate::format::write::general_lens;
use crate::format::{self, Section, TileEntry};
use crate::model::about::Short;
use crate::model::tiles::TileSource;
use crate::{About, ColorMode, Encoding, Feature, MipRule, PcastFile, Result};

/// The figures of `planecast info`. Byte counts are those of the file: tiles with equal content are stored, and
/// counted, once.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Info {
    /// `[nx, ny, nz]` of level 0, in voxels.
    pub dims: [u32; 3],
    /// What was encoded, and how it was read; absent where the file does not say it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub about: Option<About>,
    /// Sides of the world along x, y, z, in the unit of [`About::unit`]; absent where the size of a voxel is not known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub extent: Option<[f64; 3]>,
    /// Number of levels.
    pub levels: usize,
    pub encoding: Encoding,
    pub color: ColorMode,
    pub mip_rule: MipRule,
    /// Columns of level 0.
    pub columns: u64,
    /// Geometry runs of level 0.
    pub runs: u64,
    /// Solid voxels of level 0.
    pub solid_voxels: u64,
    /// Voxels of level 0 with an exposed face.
    pub surface_voxels: u64,
    /// Translucent matter, where there is any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub matter: Option<MatterInfo>,
    /// All levels.
    pub bytes: ByteCounts,
    /// Geometry with column tables of level 0; none where no voxel is exposed.
    pub bytes_per_surface_voxel: Option<f64>,
    /// What the file needs and what it leaves out.
    pub specialization: Specialization,
    /// xxh3-64 over dimensions, modes and the checksums of all tiles, in hex: equal for equal scenes that are stored alike.
    pub content_hash: String,
    pub per_level: Vec<LevelInfo>,
}

/// Translucent matter of a file.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MatterInfo {
    pub classes: usize,
    /// Values at the ends of the classes; absent of materials.
    pub window: Option<[f64; 2]>,
    /// Of level 0.
    pub runs: u64,
    pub voxels: u64,
    /// Of all levels, unpacked.
    pub bytes: u64,
}

impl MatterInfo {
    fn of(file: &PcastFile) -> Result<Option<MatterInfo>> {
        let Some(classes) = file.about().classes.as_ref().filter(|_| file.has_matter()) else { return Ok(None) };
        let mut found =
            MatterInfo { classes: classes.classes.len(), window: classes.window, runs: 0, voxels: 0, bytes: 0 };
        for (k, grid) in file.grids().iter().enumerate() {
            for (tx, tz) in (0..grid.tiles[1]).flat_map(|tz| (0..grid.tiles[0]).map(move |tx| (tx, tz))) {
                let Some(matter) = file.matter(k, tx, tz)? else { continue };
                found.bytes += matter.bytes() - 4;
                if k == 0 {
                    found.runs += matter.runs().len() as u64;
                    found.voxels += matter.voxels();
                }
            }
        }
        Ok(Some(found))
    }
}

/// What the tiles of a file need, and what they leave out. Tiles are those with a blob of their own, of all levels.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Specialization {
    pub left_out: Vec<Part>,
    pub needed: Vec<Part>,
}

/// One part of tiles.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Part {
    pub what: &'static str,
    /// The feature that leaves it out, where `encode --specialize` can tell.
    pub feature: Option<Feature>,
    pub why: &'static str,
    /// In how many tiles, of how many.
    pub tiles: u64,
    pub of_tiles: u64,
    /// Bytes of what is needed; bytes saved, beside the general layout and before compression, of what is left out.
    pub bytes: u64,
}

/// What of one tile, or of more, is needed and what is not: tiles and bytes.
#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    tiles: u64,
    /// Left out, by [`Feature`].
    saved: [[u64; 2]; Feature::ALL.len()],
    lists: [u64; 2],
    tables: [u64; 2],
    colors: [u64; 2],
}

impl Tally {
    fn of(blob: &Blob, entry: &TileEntry, modes: Modes) -> Result<Tally> {
        let Forms { lists, painted, .. } = blob.forms();
        let mut found = Tally { tiles: 1, ..Tally::default() };
        let len = |sections: &[Section]| sections.iter().map(|&s| blob.section(s).len() as u64).sum::<u64>();
        const LISTS: [Section; 3] = [Section::Geometry, Section::Fill, Section::Exposure];
        const TABLES: [Section; 2] = [Section::GeometryTable, Section::ExposureTable];
        let needed = |bytes: u64| [u64::from(bytes > 0), bytes];
        let heights = matches!(lists, Lists::Heights { .. });
        if !heights {
            found.lists = needed(len(&LISTS));
        }
        found.tables = needed(len(&TABLES) + len(&[Section::ColorTable]));
        found.colors = needed(len(&[Section::Colors]));
        if entry.flags & format::SPECIALIZED == 0 {
            return Ok(found);
        }
        let general = general_lens(&blob.level()?, modes);
        let saved = |sections: &[Section]| {
            let general = sections.iter().map(|&s| general[s as usize]).sum::<u64>();
            general.saturating_sub(len(sections))
        };
        let mut left_out = |feature: Feature, holds: bool, bytes: u64| {
            if holds {
                let [tiles, sum] = &mut found.saved[feature as usize];
                (*tiles, *sum) = (1, *sum + bytes);
            }
        };
        let narrow = |section: Section| matches!(blob.forms().table(section), Table::Even | Table::Grouped);
        if heights {
            left_out(Feature::Heights, true, saved(&LISTS) + saved(&TABLES));
        } else {
            let packed = matches!(lists, Lists::Packed { .. });
            let of_lists = if packed { Feature::Packed } else { Feature::Lists };
            let tables = if TABLES.into_iter().any(narrow) { Feature::Tables } else { of_lists };
            left_out(of_lists, lists != Lists::general(blob.ny()), saved(&LISTS));
            left_out(tables, tables == Feature::Tables || saved(&TABLES) > 0, saved(&TABLES));
        }
        match painted {
            Painted::Each => left_out(Feature::Tables, narrow(Section::ColorTable), saved(&[Section::ColorTable])),
            _ => left_out(Feature::Colors, true, saved(&[Section::ColorTable, Section::Colors])),
        }
        Ok(found)
    }

    fn add(mut self, other: Tally) -> Tally {
        let add = |a: &mut [u64; 2], b: [u64; 2]| a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
        self.tiles += other.tiles;
        self.saved.iter_mut().zip(other.saved).for_each(|(a, b)| add(a, b));
        add(&mut self.lists, other.lists);
        add(&mut self.tables, other.tables);
        add(&mut self.colors, other.colors);
        self
    }
}

/// Figures of one level.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LevelInfo {
    pub dims: [u32; 3],
    pub columns: u64,
    pub tiles: u64,
    pub empty_tiles: u64,
    pub runs: u64,
    pub solid_voxels: u64,
    pub surface_voxels: u64,
    pub bytes: ByteCounts,
}

/// Bytes by section.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct ByteCounts {
    /// Two-level lists, and in surface scenes the fill bits.
    pub geometry: u64,
    /// Column tables of the geometry.
    pub columns: u64,
    /// Lists and tables of the exposed runs, where solid scenes need them to find colours.
    pub exposure: u64,
    /// Colours and their tables.
    pub color: u64,
    /// Header, directory, headers of tiles, alignment.
    pub other: u64,
    pub total: u64,
}

impl ByteCounts {
    fn add(&mut self, section: Section, len: u64) {
        match section {
            Section::Geometry | Section::Fill => self.geometry += len,
            Section::GeometryTable => self.columns += len,
            Section::ExposureTable | Section::Exposure => self.exposure += len,
            Section::ColorTable | Section::Colors => self.color += len,
        }
    }

    /// What of `total` bytes is in no section.
    fn finish(&mut self, total: u64) {
        self.total = total;
        self.other = total - self.geometry - self.columns - self.exposure - self.color;
    }
}

/// [`Info::content_hash`], from the directory alone: broken tiles have it, too.
pub fn content_hash(file: &PcastFile) -> String {
    let mut hash = Xxh3::new();
    file.dims().iter().for_each(|n| hash.update(&n.to_le_bytes()));
    hash.update(&[
        format::encoding_code(file.encoding()),
        format::color_code(file.color()),
        format::mip_rule_code(file.mip_rule()),
    ]);
    file.entries().iter().for_each(|e| hash.update(&e.checksum.to_le_bytes()));
    format!("{:016x}", hash.digest())
}

/// The figures of `file`, after the checksum of every tile was checked.
pub fn info(file: &PcastFile) -> Result<Info> {
    let mut bytes = ByteCounts::default();
    let mut per_level = Vec::new();
    let mut seen = std::collections::HashSet::new();
    let mut distinct = Vec::new();
    let mut equal = [0; 2];
    for (k, grid) in file.grids().iter().enumerate() {
        let mut of_level = ByteCounts::default();
        let mut stored = 0;
        for (tx, tz) in (0..grid.tiles[1]).flat_map(|tz| (0..grid.tiles[0]).map(move |tx| (tx, tz))) {
            let Some(blob) = file.blob(k, tx, tz)? else { continue };
            let [in_file, unpacked] = blob.lens().map(|n| n as u64);
            if !seen.insert(blob.file_offset()) {
                equal[0] += 1;
                equal[1] += unpacked;
                continue;
            }
            distinct.push((k, tx, tz));
            for section in Section::ALL {
                // The bytes of a compressed tile are shared out as the unpacked ones are.
                let len = blob.section(section).len() as u64 * in_file / unpacked;
                of_level.add(section, len);
                bytes.add(section, len);
            }
            stored += in_file;
        }
        of_level.finish(stored);
        let entries = &file.entries()[grid.first as usize..][..grid.n_tiles() as usize];
        let sum = |of: fn(&TileEntry) -> u64| entries.iter().map(of).sum::<u64>();
        per_level.push(LevelInfo {
            dims: grid.dims,
            columns: u64::from(grid.dims[0]) * u64::from(grid.dims[2]),
            tiles: grid.n_tiles(),
            empty_tiles: sum(|e| u64::from(e.is_empty())),
            runs: sum(|e| u64::from(e.n_runs)),
            solid_voxels: sum(|e| e.n_solid),
            surface_voxels: sum(|e| e.n_exposed),
            bytes: of_level,
        });
    }
    bytes.finish(file.file_len());

    let modes = Modes { encoding: file.encoding(), color: file.color() };
    let tally = distinct
        .into_par_iter()
        .map(|(k, tx, tz)| match file.own_blob(k, tx, tz)? {
            Some(blob) => Tally::of(&blob, &file.entries()[file.tile_ix(k, tx, tz)], modes),
            None => Ok(Tally::default()),
        })
        .try_reduce(Tally::default, |a, b| Ok(a.add(b)))?;
    let finest = &per_level[0];
    let geometry = finest.bytes.geometry + finest.bytes.columns;
    let about = Some(file.about()).filter(|about| **about != About::default()).cloned();
    let sides = |voxel: [f64; 3]| std::array::from_fn(|axis| voxel[axis] * f64::from(file.dims()[axis]));
    Ok(Info {
        dims: file.dims(),
        extent: about.as_ref().and_then(|about| about.voxel).map(sides),
        about,
        levels: per_level.len(),
        encoding: file.encoding(),
        color: file.color(),
        mip_rule: file.mip_rule(),
        columns: finest.columns,
        runs: finest.runs,
        solid_voxels: finest.solid_voxels,
        surface_voxels: finest.surface_voxels,
        matter: MatterInfo::of(file)?,
        bytes,
        bytes_per_surface_voxel: (finest.surface_voxels > 0).then(|| geometry as f64 / finest.surface_voxels as f64),
        specialization: specialization(file, &tally, equal, &per_level),
        content_hash: content_hash(file),
        per_level,
    })
}

/// `equal` is the number of tiles that share the blob of another, and the bytes that their own would take.
fn specialization(file: &PcastFile, tally: &Tally, equal: [u64; 2], per_level: &[LevelInfo]) -> Specialization {
    let of_tiles = tally.tiles;
    let all = file.entries().len() as u64;
    let part =
        |what, feature, why, [tiles, bytes]: [u64; 2], of_tiles| Part { what, feature, why, tiles, of_tiles, bytes };
    let empty = per_level.iter().map(|l| l.empty_tiles).sum();
    let mut left_out = vec![
        part("empty tiles", None, "no voxel is solid", [empty, 0], all),
        part("equal tiles", None, "stored once", equal, all),
    ];
    for feature in Feature::ALL {
        let (what, why) = match feature {
            Feature::Heights => ("run lists", "every column is empty or one run from y = 0 up"),
            Feature::Lists => {
                ("first level of run lists", "the tile spans at most 256 heights, or lists are shorter without")
            }
            Feature::Tables => ("wide column tables", "columns take equal bytes, or few enough for a byte a column"),
            Feature::Colors => ("fine colours", "all voxels of a tile, column or run have the same"),
            Feature::Packed => {
                ("run lists", "starts and ends of few bits are shorter, and nothing numbers voxels by them")
            }
        };
        left_out.push(part(what, Some(feature), why, tally.saved[feature as usize], of_tiles));
    }
    if file.dims()[1] <= 256 {
        left_out.push(part("first level of run lists", None, "the world is at most 256 high", [of_tiles, 0], of_tiles));
    }
    if file.color() == ColorMode::None {
        left_out.push(part("colours", None, "the scene has none", [of_tiles, 0], of_tiles));
    }
    let coarse = &per_level[1..];
    let coarse = [coarse.iter().map(|l| l.tiles - l.empty_tiles).sum(), coarse.iter().map(|l| l.bytes.total).sum()];
    let needed = [
        part("run lists", None, "columns of several runs, or above y = 0", tally.lists, of_tiles),
        part("column tables", None, "columns of unequal bytes", tally.tables, of_tiles),
        part("colours", None, "those that differ", tally.colors, of_tiles),
        part("coarser levels", None, "no bound on distance, --lod or --repeat is known", coarse, all),
    ];
    left_out.retain(|p| p.tiles > 0);
    Specialization { left_out, needed: needed.into_iter().filter(|p| p.tiles > 0).collect() }
}

/// The figures of a world that no file holds as a whole, as far as they are known without its tiles.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct WorldInfo {
    /// `[nx, ny, nz]` of level 0, in voxels.
    pub dims: [u32; 3],
    pub levels: u32,
    pub encoding: Encoding,
    pub color: ColorMode,
}

impl WorldInfo {
    pub fn of(world: &dyn TileSource) -> WorldInfo {
        let (dims, levels) = (world.dims(), world.levels());
        WorldInfo { dims, levels, encoding: world.encoding(), color: world.color() }
    }
}

impl fmt::Display for WorldInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [nx, ny, nz] = self.dims;
        writeln!(f, "what      world of sheets, drawn in tiles")?;
        writeln!(f, "size      {nx} × {ny} × {nz} voxels (y up)")?;
        writeln!(f, "colours   {}", colors(self.color))?;
        writeln!(f, "levels    {}", self.levels)
    }
}

/// How many colours there are.
fn colors(color: ColorMode) -> &'static str {
    match color {
        ColorMode::None => "none",
        ColorMode::Run => "one per run",
        ColorMode::Voxel => "one per voxel",
    }
}

impl fmt::Display for Info {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = |value: &dyn fmt::Debug| format!("{value:?}").to_lowercase();
        let [nx, ny, nz] = self.dims;
        let about = self.about.clone().unwrap_or_default();
        let kind = about.kind.map_or("scene", |kind| kind.name());
        let source = [&about.source, &about.format].into_iter().filter(|s| !s.is_empty());
        let source = source.map(String::as_str).collect::<Vec<_>>().join(", ");
        let line = |f: &mut fmt::Formatter<'_>, name: &str, text: &str| match text {
            "" => Ok(()),
            text => writeln!(f, "{name:<9} {text}"),
        };
        line(f, "what", &if source.is_empty() { kind.to_owned() } else { format!("{kind} from {source}") })?;
        let voxels = format!("{nx} × {ny} × {nz} voxels (y up)");
        let size = match (self.extent, about.voxel) {
            (Some([x, y, z]), Some([vx, vy, vz])) => {
                let unit = if about.unit.is_empty() { "units" } else { &about.unit };
                let voxel = match vx == vy && vy == vz {
                    true => Short(vx).to_string(),
                    false => format!("{} × {} × {}", Short(vx), Short(vy), Short(vz)),
                };
                format!("{} × {} × {} {unit}, {voxels} of {voxel} {unit}", Short(x), Short(y), Short(z))
            }
            _ => voxels,
        };
        line(f, "size", &size)?;
        line(f, "axes", &about.axes)?;
        line(f, "crs", &about.crs)?;
        line(f, "values", &about.values.map(|[a, b]| format!("{} to {}", Short(a), Short(b))).unwrap_or_default())?;
        line(f, "solid", &about.rule)?;
        line(f, "not in it", &about.left_out.join("; "))?;
        line(f, "colours", colors(self.color))?;
        line(f, "levels", &self.levels.to_string())?;
        line(f, "file", &memory::display(self.bytes.total))?;
        writeln!(f)?;
        let (encoding, color, rule) = (name(&self.encoding), name(&self.color), name(&self.mip_rule));
        writeln!(f, "modes     encoding {encoding}, color {color}, mip rule {rule}")?;
        writeln!(
            f,
            "level 0   {} columns, {} runs ({:.2} a column)",
            self.columns,
            self.runs,
            self.runs as f64 / self.columns as f64
        )?;
        writeln!(f, "voxels    {} solid, {} with an exposed face", self.solid_voxels, self.surface_voxels)?;
        if let Some(m) = &self.matter {
            let of = match m.window {
                Some([low, high]) => format!("steps from {} to {}", Short(low), Short(high)),
                None => "materials".to_owned(),
            };
            writeln!(
                f,
                "matter    {} {of}; {} voxels, {} runs, {} bytes of all levels",
                m.classes, m.voxels, m.runs, m.bytes
            )?;
        }
        let b = &self.bytes;
        writeln!(
            f,
            "bytes     {} geometry, {} column tables, {} exposure, {} colour, {} other, {} in all",
            b.geometry, b.columns, b.exposure, b.color, b.other, b.total
        )?;
        if let Some(bytes) = self.bytes_per_surface_voxel {
            writeln!(f, "density   {bytes:.3} bytes of geometry with column tables a surface voxel")?;
        }
        for part in &self.specialization.needed {
            let Part { what, why, tiles, of_tiles, bytes, .. } = part;
            writeln!(f, "needed    {what}: {bytes} bytes, {tiles} of {of_tiles} tiles; {why}")?;
        }
        for part in &self.specialization.left_out {
            let Part { what, why, tiles, of_tiles, bytes, feature } = part;
            let feature = feature.map(|f| format!(" [{}]", f.name())).unwrap_or_default();
            writeln!(f, "left out  {what}{feature}: {bytes} bytes saved, {tiles} of {of_tiles} tiles; {why}")?;
        }
        writeln!(f, "content   {}", self.content_hash)?;
        writeln!(f)?;
        writeln!(
            f,
            "level  {:>22}  {:>13}  {:>11}  {:>12}  {:>11}",
            "dims", "tiles (empty)", "runs", "surface", "bytes"
        )?;
        for (k, l) in self.per_level.iter().enumerate() {
            let dims = format!("{} × {} × {}", l.dims[0], l.dims[1], l.dims[2]);
            let tiles = format!("{} ({})", l.tiles, l.empty_tiles);
            writeln!(
                f,
                "{k:>5}  {dims:>22}  {tiles:>13}  {:>11}  {:>12}  {:>11}",
                l.runs, l.surface_voxels, l.bytes.total
            )?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::write::write_scene_with;
    use crate::model::exposure;
    use crate::{BuildOptions, Columns, Features, Scene, build, testing};

    /// In the general layout.
    fn of(scene: &Scene) -> Info {
        with(scene, Features::NONE)
    }

    fn with(scene: &Scene, features: Features) -> Info {
        let mut bytes = std::io::Cursor::new(Vec::new());
        write_scene_with(scene, features, &mut bytes, "a.pcast".as_ref()).unwrap();
        info(&PcastFile::from_bytes("a.pcast", bytes.into_inner()).unwrap()).unwrap()
    }

    fn hills(color: ColorMode, encoding: Encoding) -> Scene {
        let columns = Columns::from_fn(300, 20, 260, |x, y, z| y < 4 + (x * z) % 9);
        let opts = BuildOptions { encoding, color: Some(color), ..Default::default() };
        build(testing::input(columns, color != ColorMode::None), &opts).unwrap()
    }

    #[test]
    fn info_counts_what_is_there() {
        for (color, encoding) in [
            (ColorMode::None, Encoding::Solid),
            (ColorMode::Run, Encoding::Solid),
            (ColorMode::Voxel, Encoding::Solid),
            (ColorMode::Voxel, Encoding::Surface),
        ] {
            let scene = hills(color, encoding);
            let info = of(&scene);
            assert_eq!((info.dims, info.levels, info.columns), ([300, 20, 260], 10, 300 * 260));
            for (k, level) in scene.levels.iter().enumerate() {
                let found = &info.per_level[k];
                assert_eq!(found.dims, level.solid.dims());
                assert_eq!(found.runs, level.geometry(encoding).runs().len() as u64);
                assert_eq!(found.solid_voxels, level.solid.voxels());
                assert_eq!(found.surface_voxels, exposure::exposed(&level.solid).voxels());
            }
            let b = info.bytes;
            assert_eq!(b.geometry + b.columns + b.exposure + b.color + b.other, b.total);
            assert_eq!(b.color > 0, color != ColorMode::None);
            assert_eq!(b.exposure > 0, (color, encoding) == (ColorMode::Voxel, Encoding::Solid));
            if (color, encoding) == (ColorMode::None, Encoding::Solid) {
                // One run a column: 3 bytes, and 2 for its place, 4 a row of a tile.
                assert_eq!(info.per_level[0].bytes.geometry, 3 * 300 * 260);
                assert_eq!(info.per_level[0].bytes.columns, 2 * 300 * 260 + 4 * 260 * 2);
                let per_voxel = (5 * 300 * 260 + 4 * 260 * 2) as f64 / info.surface_voxels as f64;
                assert_eq!(info.bytes_per_surface_voxel, Some(per_voxel));
            }
        }
    }

    #[test]
    fn info_says_what_was_left_out_and_how_many_bytes_that_saves() {
        let mixed = Columns::from_fn(600, 300, 20, |x, y, z| match x / 256 {
            0 => y < 20 + (x * z) % 90,
            1 => y > 130 && (y + x + z) % 70 > 5 && y < 140 + x % 70,
            _ => (y + x * z) % 29 < 5 + x % 3,
        });
        let in_sections = |info: &Info| info.bytes.total - info.bytes.other;
        for color in [ColorMode::None, ColorMode::Run, ColorMode::Voxel] {
            for encoding in [Encoding::Solid, Encoding::Surface] {
                let opts = BuildOptions { encoding, color: Some(color), ..Default::default() };
                let mut scene = build(testing::input(mixed.clone(), color != ColorMode::None), &opts).unwrap();
                scene.levels[2].colors.fill([7; 3]);
                let general = of(&scene);
                assert!(general.specialization.left_out.iter().all(|p| p.feature.is_none()));
                for features in [Features::ALL].into_iter().chain(Feature::ALL.map(|f| Features::from_iter([f]))) {
                    let found = with(&scene, features);
                    let left_out = &found.specialization.left_out;
                    assert!(left_out.iter().filter_map(|p| p.feature).all(|f| features.has(f)));
                    let saved: u64 = left_out.iter().filter(|p| p.feature.is_some()).map(|p| p.bytes).sum();
                    let case = format!("{color:?} {encoding:?} {features} {left_out:?}");
                    assert_eq!(in_sections(&general) - in_sections(&found), saved, "{case}");
                    let only = |feature| features == Features::from_iter([feature]);
                    let none = only(Feature::Colors) && color == ColorMode::None
                        || only(Feature::Packed) && (encoding, color) == (Encoding::Surface, ColorMode::Voxel);
                    assert_eq!(saved == 0, none, "{case}");
                    let needed: u64 = found.specialization.needed.iter().map(|p| p.bytes).sum();
                    assert!(needed > 0, "{case}");
                }
            }
        }
        let text = with(&hills(ColorMode::None, Encoding::Solid), Features::ALL).to_string();
        assert!(text.contains("left out  run lists [heights]: "), "{text}");
        assert!(text.contains("left out  colours: 0 bytes saved, "), "{text}");
    }

    #[test]
    fn info_hash_is_that_of_the_content() {
        let scene = hills(ColorMode::Voxel, Encoding::Solid);
        let mut other = scene.clone();
        assert_eq!(of(&scene).content_hash, of(&other).content_hash);
        other.levels[0].colors[5][1] ^= 1;
        assert_ne!(of(&scene).content_hash, of(&other).content_hash);
        assert_eq!(of(&scene).content_hash.len(), 16);
        let empty = |nx| build(testing::input(Columns::empty(nx, 3, 3), false), &BuildOptions::default()).unwrap();
        assert_ne!(of(&empty(3)).content_hash, of(&empty(4)).content_hash);
        assert_eq!(of(&empty(3)).bytes_per_surface_voxel, None);
    }

    #[test]
    fn info_json_has_the_promised_fields() {
        let json = serde_json::to_value(of(&hills(ColorMode::Voxel, Encoding::Surface))).unwrap();
        for field in [
            "dims",
            "levels",
            "encoding",
            "color",
            "columns",
            "runs",
            "solid_voxels",
            "surface_voxels",
            "bytes",
            "bytes_per_surface_voxel",
            "content_hash",
        ] {
            assert!(!json[field].is_null(), "{field}");
        }
        for field in ["geometry", "color", "columns", "total"] {
            assert!(json["bytes"][field].is_u64(), "{field}");
        }
        assert_eq!((&json["encoding"], &json["color"]), (&"surface".into(), &"voxel".into()));
    }

    #[test]
    fn info_text_names_the_world() {
        let text = of(&hills(ColorMode::None, Encoding::Solid)).to_string();
        let text: String = text
            .lines()
            .filter(|l| !l.starts_with("needed") && !l.starts_with("left out"))
            .fold(String::new(), |text, line| text + line + "\n");
        let first = "what      scene\nsize      300 × 20 × 260 voxels (y up)\ncolours   none\nlevels    10\nfile      ";
        assert!(text.starts_with(first), "{text}");
        assert!(text.contains("\n\nmodes     encoding solid, color none, mip rule any\n"), "{text}");
        assert_eq!(text.lines().count(), 5 + 9 + 10, "{text}");
    }
}
