//! What a scene file holds, in figures.

use std::fmt;

use serde::Serialize;
use xxhash_rust::xxh3::Xxh3;

use crate::format::{self, Section, TileEntry};
use crate::{ColorMode, Encoding, MipRule, PcastFile, Result};

/// The figures of `planecast info`. Byte counts are those of the file: tiles with equal content are stored, and
/// counted, once.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Info {
    /// `[nx, ny, nz]` of level 0, in voxels.
    pub dims: [u32; 3],
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
    /// All levels.
    pub bytes: ByteCounts,
    /// Geometry with column tables of level 0; none where no voxel is exposed.
    pub bytes_per_surface_voxel: Option<f64>,
    /// xxh3-64 over dimensions, modes and the checksums of all tiles, in hex: equal for equal scenes.
    pub content_hash: String,
    pub per_level: Vec<LevelInfo>,
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

/// The figures of `file`, after the checksum of every tile was checked.
pub fn info(file: &PcastFile) -> Result<Info> {
    let mut bytes = ByteCounts::default();
    let mut per_level = Vec::new();
    let mut seen = std::collections::HashSet::new();
    for (k, grid) in file.grids().iter().enumerate() {
        let mut of_level = ByteCounts::default();
        let mut stored = 0;
        for (tx, tz) in (0..grid.tiles[1]).flat_map(|tz| (0..grid.tiles[0]).map(move |tx| (tx, tz))) {
            let Some(blob) = file.blob(k, tx, tz)? else { continue };
            if !seen.insert(blob.file_offset()) {
                continue;
            }
            let [in_file, unpacked] = blob.lens().map(|n| n as u64);
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

    let mut hash = Xxh3::new();
    file.dims().iter().for_each(|n| hash.update(&n.to_le_bytes()));
    hash.update(&[
        format::encoding_code(file.encoding()),
        format::color_code(file.color()),
        format::mip_rule_code(file.mip_rule()),
    ]);
    file.entries().iter().for_each(|e| hash.update(&e.checksum.to_le_bytes()));

    let finest = &per_level[0];
    let geometry = finest.bytes.geometry + finest.bytes.columns;
    Ok(Info {
        dims: file.dims(),
        levels: per_level.len(),
        encoding: file.encoding(),
        color: file.color(),
        mip_rule: file.mip_rule(),
        columns: finest.columns,
        runs: finest.runs,
        solid_voxels: finest.solid_voxels,
        surface_voxels: finest.surface_voxels,
        bytes,
        bytes_per_surface_voxel: (finest.surface_voxels > 0).then(|| geometry as f64 / finest.surface_voxels as f64),
        content_hash: format!("{:016x}", hash.digest()),
        per_level,
    })
}

impl fmt::Display for Info {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = |value: &dyn fmt::Debug| format!("{value:?}").to_lowercase();
        let [nx, ny, nz] = self.dims;
        writeln!(f, "world     {nx} × {ny} × {nz} voxels (y up), {} levels", self.levels)?;
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
        let b = &self.bytes;
        writeln!(
            f,
            "bytes     {} geometry, {} column tables, {} exposure, {} colour, {} other, {} in all",
            b.geometry, b.columns, b.exposure, b.color, b.other, b.total
        )?;
        if let Some(bytes) = self.bytes_per_surface_voxel {
            writeln!(f, "density   {bytes:.3} bytes of geometry with column tables a surface voxel")?;
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
    use crate::write::write_scene;
    use crate::{BuildOptions, Columns, Scene, build, exposure, testing};

    fn of(scene: &Scene) -> Info {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.pcast");
        write_scene(scene, &path).unwrap();
        info(&PcastFile::open(&path).unwrap()).unwrap()
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
        assert!(text.starts_with("world     300 × 20 × 260 voxels (y up), 10 levels\nmodes     encoding solid, color none, mip rule any\n"), "{text}");
        assert_eq!(text.lines().count(), 9 + 10, "{text}");
    }
}
