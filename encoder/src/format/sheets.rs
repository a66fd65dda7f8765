//! Worlds of several scene files: sheets side by side, named by a manifest, `.pworld`.
//!
//! ```json
//! {
//!   "pworld": 1,
//!   "sheet": [4096, 4096],         columns of each sheet along x and z, multiples of 256
//!   "grid": [16, 16],              sheets along x and z
//!   "height": 300,                 voxels that all columns are high
//!   "encoding": "solid",           and how they are coloured: none, run, voxel; the same in all
//!   "color": "voxel",
//!   "height_field": false,         whether columns are runs from the ground up
//!   "crs": "EPSG:32617",           of all sheets that say one
//!   "coarse": "coarse.pcast",      a scene of the whole world, or nothing
//!   "coarse_level": 5,             the level of the world that is its level 0
//!   "sheets": [{"file": "a.pcast", "x": 0, "z": 0, "nx": 2, "nz": 3}]
//! }
//! ```
//!
//! File names are as seen from the manifest, or URLs. A sheet may be named many times: at each of `nx × nz` places from (x, z)
//! on (1 × 1 where nothing is said), later lines over earlier ones. Where none is named the world is empty.
//!
//! Tiles of level l lie in one sheet as long as its side is a multiple of 256·2ˡ. Coarser ones are put together from the levels of the
//! sheets until a column is as wide as a sheet, and made of those from there on; all that from the coarse scene, where there is one.
//! Sides of sheets count as exposed, as they are in each file.

use std::collections::{HashMap, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use crate::encode::mips;
use crate::format::TILE;
use crate::model::tiles::{TileKey, TileSource, tile_size};
use crate::store::{is_url, shown};
use crate::{ColorMode, Columns, Encoding, Error, Level, MipRule, Result, Rgb};

/// Bytes of a manifest at most.
pub const MOST_TEXT: u64 = 64 << 20;

/// Columns of a world along a side at most: cells have 31 bits.
const MOST_SIDE: u64 = 1 << 30;

/// Files that are kept open.
const OPEN: usize = 64;

/// Places of which each is looked up at once.
const MOST_INDEXED: usize = 1 << 22;

/// Sheets of which levels coarser than one are made in memory: 50 bytes each.
const MOST_STITCHED: u64 = 1 << 24;

/// A manifest.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Manifest {
    pub pworld: u32,
    pub sheet: [u32; 2],
    pub grid: [u32; 2],
    pub height: u32,
    pub encoding: Encoding,
    pub color: ColorMode,
    #[serde(default)]
    pub height_field: bool,
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub crs: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coarse: Option<PathBuf>,
    #[serde(default)]
    pub coarse_level: u32,
    pub sheets: Vec<Sheet>,
}

/// A scene file at its places.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sheet {
    pub file: PathBuf,
    pub x: u32,
    pub z: u32,
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub nx: u32,
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub nz: u32,
}

fn one() -> u32 {
    1
}

fn is_one(n: &u32) -> bool {
    *n == 1
}

/// Whether a file is a manifest, by its name: a path or a URL.
pub fn is_manifest(name: &Path) -> bool {
    shown(name).extension().is_some_and(|ending| ending.eq_ignore_ascii_case("pworld"))
}

/// Opens a file of the world.
pub type Open = dyn Fn(&Path) -> Result<Arc<dyn TileSource>> + Send + Sync;

/// A world of sheets.
pub struct Sheets {
    path: PathBuf,
    manifest: Manifest,
    dims: [u32; 3],
    /// Levels whose tiles lie in one sheet.
    own: u32,
    /// The level at which a sheet is a column.
    column: u32,
    /// By place which sheet is there, where there are few places and many sheets.
    index: Vec<u32>,
    open: Box<Open>,
    files: Mutex<VecDeque<(PathBuf, Arc<dyn TileSource>)>>,
    /// Levels of one column a sheet and coarser.
    coarsest: OnceLock<Vec<Level>>,
}

impl Manifest {
    /// Reads a manifest; `path` is what errors call it.
    pub fn parse(path: &Path, text: &[u8]) -> Result<Manifest> {
        let manifest: Manifest =
            serde_json::from_slice(text).map_err(|e| Error::format(path, format!("no manifest of a world: {e}")))?;
        manifest.check(path)?;
        Ok(manifest)
    }

    fn check(&self, path: &Path) -> Result<()> {
        let wrong = |what: String| Err(Error::format(path, what));
        let Manifest { pworld, sheet, grid, height, .. } = self;
        if *pworld != 1 {
            return wrong(format!("\"pworld\": {pworld}, this program reads version 1"));
        }
        if sheet.iter().any(|&n| n == 0 || n % TILE != 0) {
            return wrong(format!("\"sheet\": {sheet:?}, multiples of {TILE} were expected"));
        }
        let sides = [0, 1].map(|i| u64::from(sheet[i]) * u64::from(grid[i]));
        if sides.iter().any(|&n| n == 0 || n > MOST_SIDE) {
            return wrong(format!("\"grid\": {grid:?} of sheets of {sheet:?}; 1 to 2³⁰ columns a side were expected"));
        }
        if *height == 0 || *height > 65_536 {
            return wrong(format!("\"height\": {height}, 1 to 65,536 was expected"));
        }
        for (i, Sheet { file, x, z, nx, nz }) in self.sheets.iter().enumerate() {
            let inside = |at: u32, n: u32, of: u32| n > 0 && at.checked_add(n).is_some_and(|end| end <= of);
            if !inside(*x, *nx, grid[0]) || !inside(*z, *nz, grid[1]) {
                let file = file.display();
                return wrong(format!(
                    "sheet {i}, {file}: {nx} × {nz} places from ({x}, {z}) on are not in a grid of {grid:?}"
                ));
            }
        }
        Ok(())
    }
}

impl Sheets {
    /// A world from its manifest; files are opened by `open` when they are wanted.
    pub fn new(path: &Path, manifest: Manifest, open: Box<Open>) -> Result<Sheets> {
        manifest.check(path)?;
        let [w, d] = manifest.sheet;
        let dims = [w * manifest.grid[0], manifest.height, d * manifest.grid[1]];
        let own = (w / TILE).trailing_zeros().min((d / TILE).trailing_zeros());
        let column = w.max(d).next_power_of_two().trailing_zeros();
        let many = manifest.grid[0] > 1 || manifest.grid[1] > 1;
        let seen = manifest.coarse.is_some() && manifest.coarse_level <= own + 1;
        if many && !seen && (w != d || !w.is_power_of_two()) {
            let what = format!(
                "\"sheet\": [{w}, {d}]; square sheets of a power of two columns a side were expected, or a coarse scene from level {} on",
                own + 1
            );
            return Err(Error::format(path, what));
        }
        let mut index = Vec::new();
        let places = manifest.grid[0] as usize * manifest.grid[1] as usize;
        if manifest.sheets.len() > 8 && places <= MOST_INDEXED {
            index.resize(places, u32::MAX);
            for (i, s) in (0..).zip(&manifest.sheets) {
                for z in s.z..s.z + s.nz {
                    let row = (z * manifest.grid[0] + s.x) as usize;
                    index[row..row + s.nx as usize].fill(i);
                }
            }
        }
        Ok(Sheets {
            path: path.into(),
            dims,
            own,
            column,
            index,
            open,
            files: Mutex::default(),
            coarsest: OnceLock::new(),
            manifest,
        })
    }

    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// What is named at a place of the grid.
    fn at(&self, x: u32, z: u32) -> Option<&Path> {
        if !self.index.is_empty() {
            let sheet = self.index[(z * self.manifest.grid[0] + x) as usize];
            return self.manifest.sheets.get(sheet as usize).map(|s| s.file.as_path());
        }
        let holds = |s: &&Sheet| (s.x..s.x + s.nx).contains(&x) && (s.z..s.z + s.nz).contains(&z);
        self.manifest.sheets.iter().rev().find(holds).map(|s| s.file.as_path())
    }

    fn file(&self, file: &Path) -> Result<Arc<dyn TileSource>> {
        let lock = || self.files.lock().unwrap_or_else(PoisonError::into_inner);
        {
            let mut files = lock();
            if let Some(at) = files.iter().position(|f| f.0 == file) {
                let found = files.remove(at).expect("it was found");
                let source = Arc::clone(&found.1);
                files.push_back(found);
                return Ok(source);
            }
        }
        let path = if is_url(file) { file.to_owned() } else { self.path.parent().unwrap_or(Path::new("")).join(file) };
        if is_manifest(&path) {
            return Err(Error::format(shown(&path), "no scene, as sheets of a world are"));
        }
        let source = (self.open)(&path)?;
        let mut files = lock();
        files.push_back((file.to_owned(), Arc::clone(&source)));
        if files.len() > OPEN {
            files.pop_front();
        }
        Ok(source)
    }

    /// A sheet, after it was found to be as the manifest says.
    fn sheet(&self, file: &Path) -> Result<Arc<dyn TileSource>> {
        let source = self.file(file)?;
        let Manifest { sheet: [w, d], height, encoding, color, .. } = self.manifest;
        let (found, expected) = ((source.dims(), source.encoding(), source.color()), ([w, height, d], encoding, color));
        if found != expected {
            let ([x, y, z], encoding, color) = found;
            let what = format!(
                "sheet {}: {x} × {y} × {z} voxels, encoding {encoding:?}, colours {color:?}; the manifest says {w} × {height} × {d}, \
                 {:?}, {:?}",
                file.display(),
                expected.1,
                expected.2
            );
            return Err(Error::format(&self.path, what));
        }
        Ok(source)
    }

    fn coarse(&self, key: TileKey) -> Result<Option<Level>> {
        let (Some(file), Some(level)) = (&self.manifest.coarse, key.level.checked_sub(self.manifest.coarse_level))
        else {
            return Ok(None);
        };
        let source = self.file(file)?;
        let n = |n: u32| u64::from(n).div_ceil(1 << self.manifest.coarse_level) as u32;
        let expected = self.dims.map(n);
        if (source.dims(), source.color(), source.encoding()) != (expected, self.color(), self.encoding()) {
            let what = format!(
                "coarse scene {}: {:?} voxels, {:?}, {:?}; {expected:?}, {:?}, {:?} were expected",
                file.display(),
                source.dims(),
                source.encoding(),
                source.color(),
                self.encoding(),
                self.color()
            );
            return Err(Error::format(&self.path, what));
        }
        source.tile(TileKey { level, ..key }).map(Some)
    }

    fn empty(&self, [nx, nz]: [u32; 2], level: u32) -> Level {
        let none = Columns::empty(nx, self.dims[1].div_ceil(1 << level.min(31)), nz);
        let shows = self.manifest.encoding == Encoding::Surface || self.manifest.color == ColorMode::Voxel;
        Level { exposed: shows.then(|| none.clone()), solid: none, colors: Vec::new(), matter: None }
    }

    /// Sheets `xs × zs` at a level at which each is a tile or less, side by side.
    fn stitched(&self, level: u32, from: [u32; 2], n: [u32; 2]) -> Result<Level> {
        let side = self.manifest.sheet[0] >> level;
        let mut found: HashMap<PathBuf, Arc<Parts>> = HashMap::new();
        let none = Arc::new(Parts::new(self.empty([side; 2], level), self.manifest.encoding, self.manifest.color));
        let mut places = Vec::with_capacity(n[0] as usize * n[1] as usize);
        for (x, z) in (0..n[1]).flat_map(|z| (0..n[0]).map(move |x| (x, z))) {
            let Some(file) = self.at(from[0] + x, from[1] + z) else {
                places.push(Arc::clone(&none));
                continue;
            };
            if let Some(parts) = found.get(file) {
                places.push(Arc::clone(parts));
                continue;
            }
            let tile = self.sheet(file)?.tile(TileKey { level, x: 0, z: 0 })?;
            let parts = Arc::new(Parts::new(tile, self.manifest.encoding, self.manifest.color));
            found.insert(file.to_owned(), Arc::clone(&parts));
            places.push(parts);
        }
        let size = n.map(|n| n * side);
        let place = |x: u32, z: u32| &places[(z / side * n[0] + x / side) as usize];
        let join = |of: &dyn for<'a> Fn(&'a Level) -> &'a Columns| {
            Columns::gather(none.level.solid.ny(), 0..size[0], 0..size[1], |x, z| {
                let columns = of(&place(x, z).level);
                (columns, columns.index(x % side, z % side), side - x % side)
            })
        };
        let mut colors = Vec::new();
        if self.manifest.color != ColorMode::None {
            for (z, x) in (0..size[1]).flat_map(|z| (0..n[0]).map(move |x| (z, x))) {
                let parts = place(x * side, z);
                let row = (z % side) as usize;
                colors.extend_from_slice(&parts.level.colors[parts.rows[row]..parts.rows[row + 1]]);
            }
        }
        let solid = join(&|level| &level.solid);
        let exposed = none.level.exposed.is_some();
        let exposed = exposed.then(|| join(&|level| level.exposed.as_ref().expect("all sheets have them")));
        Ok(Level { solid, exposed, colors, matter: None })
    }

    /// Levels of a column a sheet and coarser.
    fn coarsest(&self) -> Result<&[Level]> {
        if let Some(levels) = self.coarsest.get() {
            return Ok(levels);
        }
        let [nx, nz] = self.manifest.grid;
        if u64::from(nx) * u64::from(nz) > MOST_STITCHED {
            let what = format!(
                "{}: {nx} × {nz} sheets; levels coarser than a sheet are made for up to {MOST_STITCHED} of them: name a coarse scene",
                self.path.display()
            );
            return Err(Error::Limit(what));
        }
        let first = self.stitched(self.column, [0, 0], self.manifest.grid)?;
        let mut levels = vec![first];
        while levels.last().is_some_and(|l| l.solid.nx().max(l.solid.nz()) > 1) {
            let fine = levels.last().expect("there is one");
            levels.push(coarser(fine, self.manifest.encoding, self.manifest.color));
        }
        Ok(self.coarsest.get_or_init(|| levels))
    }
}

/// A sheet's level, and where the colours of its rows begin.
struct Parts {
    level: Level,
    rows: Vec<usize>,
}

impl Parts {
    fn new(level: Level, encoding: Encoding, color: ColorMode) -> Parts {
        let [nx, _, nz] = level.solid.dims().map(|n| n as usize);
        let of: Vec<u64> = match color {
            ColorMode::None => vec![0; nx * nz + 1],
            ColorMode::Run => level.geometry(encoding).offsets().iter().map(|&o| o.into()).collect(),
            ColorMode::Voxel => level.exposed.as_ref().map(Columns::voxel_offsets).unwrap_or_default(),
        };
        let rows = (0..=nz).map(|z| of.get(z * nx).map_or(0, |&o| o as usize)).collect();
        Parts { level, rows }
    }
}

/// The level above one. Colours of runs are those of the highest run below in the columns under them.
fn coarser(fine: &Level, encoding: Encoding, color: ColorMode) -> Level {
    let solid = mips::next(&fine.solid, MipRule::Any);
    let exposed = fine.exposed.as_ref().map(|_| crate::model::exposure::exposed(&solid));
    let colors = match (color, &exposed, &fine.exposed) {
        (ColorMode::None, ..) => Vec::new(),
        (ColorMode::Voxel, Some(shown), Some(fine_shown)) => mips::next_colors(shown, fine_shown, &fine.colors),
        _ => {
            let level = Level { solid: solid.clone(), exposed: exposed.clone(), colors: Vec::new(), matter: None };
            let (coarse, below) = (level.geometry(encoding), fine.geometry(encoding));
            let mut colors: Vec<Rgb> = Vec::with_capacity(coarse.runs().len());
            for (x, z) in (0..coarse.nz()).flat_map(|z| (0..coarse.nx()).map(move |x| (x, z))) {
                for run in coarse.column(x, z) {
                    let children = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dz)| (2 * x + dx, 2 * z + dz));
                    let inside = children.into_iter().filter(|&(x, z)| x < below.nx() && z < below.nz());
                    let runs = inside.flat_map(|(x, z)| below.range(below.index(x, z)));
                    let under = runs.filter(|&i| u32::from(below.runs()[i].first()) / 2 < run.end());
                    let best = under.max_by_key(|&i| below.runs()[i].last());
                    colors.push(best.map_or(crate::encode::build::UNCOLORED, |i| fine.colors[i]));
                }
            }
            colors
        }
    };
    Level { solid, exposed, colors, matter: None }
}

/// A part of a level.
fn crop(
    level: &Level,
    xs: std::ops::Range<u32>,
    zs: std::ops::Range<u32>,
    encoding: Encoding,
    color: ColorMode,
) -> Level {
    let colored = match color {
        ColorMode::None => None,
        ColorMode::Run => Some(level.geometry(encoding).offsets().iter().map(|&o| o as usize).collect::<Vec<_>>()),
        ColorMode::Voxel => level.exposed.as_ref().map(|e| e.voxel_offsets().into_iter().map(|o| o as usize).collect()),
    };
    let row = |z: u32| level.solid.index(xs.start, z)..level.solid.index(xs.start, z) + xs.len();
    let colors = colored.map_or(Vec::new(), |of| {
        zs.clone().flat_map(|z| level.colors[of[row(z).start]..of[row(z).end]].iter().copied()).collect()
    });
    let exposed = level.exposed.as_ref().map(|e| e.crop(xs.clone(), zs.clone()));
    Level { solid: level.solid.crop(xs, zs), exposed, colors, matter: None }
}

impl TileSource for Sheets {
    fn name(&self) -> String {
        self.path.display().to_string()
    }

    fn dims(&self) -> [u32; 3] {
        self.dims
    }

    fn encoding(&self) -> Encoding {
        self.manifest.encoding
    }

    fn color(&self) -> ColorMode {
        self.manifest.color
    }

    fn heights(&self, level: u32) -> [u32; 2] {
        [0, self.dims[1].div_ceil(1 << level.min(31))]
    }

    fn is_height_field(&self) -> bool {
        self.manifest.height_field
    }

    fn is_empty(&self, key: TileKey) -> bool {
        if self.manifest.grid == [1, 1] {
            return self.manifest.sheets.is_empty();
        }
        let [w, d] = self.manifest.sheet.map(|n| (n / TILE) >> key.level.min(31));
        key.level <= self.own && self.at(key.x / w.max(1), key.z / d.max(1)).is_none()
    }

    fn tile(&self, key: TileKey) -> Result<Level> {
        let TileKey { level, x, z } = key;
        let size = tile_size(self.dims, key);
        if level >= self.levels() || size.contains(&0) {
            let path = self.path.display();
            return Err(Error::Argument(format!("{path}: there is no tile ({x}, {z}) of level {level}")));
        }
        if self.manifest.grid == [1, 1] {
            return self.at(0, 0).map_or_else(|| Ok(self.empty(size, level)), |file| self.sheet(file)?.tile(key));
        }
        if level <= self.own {
            let [w, d] = self.manifest.sheet.map(|n| (n / TILE) >> level);
            return match self.at(x / w, z / d) {
                None => Ok(self.empty(size, level)),
                Some(file) => self.sheet(file)?.tile(TileKey { level, x: x % w, z: z % d }),
            };
        }
        if let Some(tile) = self.coarse(key)? {
            return Ok(tile);
        }
        if level <= self.column {
            let side = self.manifest.sheet[0] >> level;
            // At the level of one column a sheet a tile is of 256 × 256 of them.
            let from = [x, z].map(|v| v * (TILE / side));
            return self.stitched(level, from, size.map(|n| n / side));
        }
        let levels = self.coarsest()?;
        let of = &levels[(level - self.column) as usize];
        let range = |at: u32, n: u32| at * TILE..at * TILE + n;
        Ok(crop(of, range(x, size[0]), range(z, size[1]), self.manifest.encoding, self.manifest.color))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::write;
    use crate::source::procedural::{Kind, procedural};
    use crate::{BuildOptions, PcastFile, Scene, build};

    fn scene(seed: u64, color: ColorMode) -> Scene {
        let opts = BuildOptions { color: Some(color), ..Default::default() };
        build(procedural(Kind::Rocks, 512, seed).unwrap(), &opts).unwrap()
    }

    fn file(scene: &Scene) -> Arc<dyn TileSource> {
        let mut out = std::io::Cursor::new(Vec::new());
        write::write_scene_to(scene, &mut out, Path::new("s.pcast")).unwrap();
        Arc::new(PcastFile::from_bytes("s.pcast", out.into_inner()).unwrap())
    }

    fn manifest(grid: [u32; 2], color: ColorMode, sheets: &[(&str, [u32; 4])]) -> Manifest {
        let sheet = |&(file, [x, z, nx, nz]): &(&str, [u32; 4])| Sheet { file: file.into(), x, z, nx, nz };
        let text = serde_json::to_vec(&Manifest {
            pworld: 1,
            sheet: [512; 2],
            grid,
            height: 256,
            encoding: Encoding::Solid,
            color,
            height_field: false,
            crs: String::new(),
            coarse: None,
            coarse_level: 0,
            sheets: sheets.iter().map(sheet).collect(),
        });
        Manifest::parse(Path::new("w.pworld"), &text.unwrap()).unwrap()
    }

    #[test]
    fn sheets_side_by_side_are_one_world_at_every_level() {
        for color in [ColorMode::Run, ColorMode::Voxel] {
            let scenes = [1, 2].map(|seed| scene(seed, color));
            let files = scenes.each_ref().map(file);
            let open = move |path: &Path| Ok(Arc::clone(&files[usize::from(path == Path::new("b.pcast"))]));
            let manifest = manifest([3, 2], color, &[("a.pcast", [0, 0, 2, 2]), ("b.pcast", [1, 1, 1, 1])]);
            let world = Sheets::new(Path::new("w.pworld"), manifest, Box::new(open)).unwrap();
            assert_eq!(world.dims(), [1536, 256, 1024]);
            // All levels from the sheets' solid voxels, put side by side at level 0.
            let at = |x: u32, z: u32| match (x / 512, z / 512) {
                (1, 1) => Some(&scenes[1]),
                (0 | 1, _) => Some(&scenes[0]),
                _ => None,
            };
            let empty = Columns::empty(512, 256, 512);
            let mut all = Columns::gather(256, 0..1536, 0..1024, |x, z| {
                let solid = at(x, z).map_or(&empty, |s| &s.levels[0].solid);
                (solid, solid.index(x % 512, z % 512), 512 - x % 512)
            });
            for level in 0..world.levels() {
                let [nx, _, nz] = all.dims();
                for (x, z) in (0..nz.div_ceil(TILE)).flat_map(|z| (0..nx.div_ceil(TILE)).map(move |x| (x, z))) {
                    let key = TileKey { level, x, z };
                    let tile = world.tile(key).unwrap();
                    let cut = |v: u32, n: u32| v * TILE..n.min((v + 1) * TILE);
                    assert_eq!(tile.solid, all.crop(cut(x, nx), cut(z, nz)), "{key:?}");
                    let n = match color {
                        ColorMode::Run => tile.solid.runs().len() as u64,
                        _ => tile.exposed.as_ref().unwrap().voxels(),
                    };
                    assert_eq!(tile.colors.len() as u64, n, "{key:?}");
                    assert!(!world.is_empty(key) || tile.solid.runs().is_empty());
                }
                all = mips::next(&all, MipRule::Any);
            }
            assert!(world.is_empty(TileKey { level: 0, x: 5, z: 0 }));
            assert!(world.tile(TileKey { level: 0, x: 6, z: 0 }).is_err());
            let fine = TileSource::tile(&world, TileKey { level: 0, x: 3, z: 2 }).unwrap();
            assert!(fine == file(&scenes[1]).tile(TileKey { level: 0, x: 1, z: 0 }).unwrap());
        }
    }

    #[test]
    fn sheets_named_many_times_make_a_world_of_a_trillion_columns() {
        let a = file(&scene(1, ColorMode::Run));
        let n = (1 << 20) / 512;
        let manifest = manifest([n; 2], ColorMode::Run, &[("a.pcast", [0, 0, n, n])]);
        let open = move |_: &Path| Ok(Arc::clone(&a));
        let world = Sheets::new(Path::new("w.pworld"), manifest, Box::new(open)).unwrap();
        assert_eq!((world.dims(), world.levels()), ([1 << 20, 256, 1 << 20], 21));
        let far = world.tile(TileKey { level: 0, x: 4095, z: 4094 }).unwrap();
        assert!(far == world.tile(TileKey { level: 0, x: 1, z: 0 }).unwrap());
        for level in [1, 2, 8, 9] {
            let tile = world.tile(TileKey { level, x: 3, z: 2 }).unwrap();
            assert_eq!(tile.solid.nx(), TILE);
        }
    }

    #[test]
    fn sheets_that_are_not_as_the_manifest_says_are_named() {
        let parse = |text: &str| Manifest::parse(Path::new("w.pworld"), text.as_bytes()).unwrap_err().to_string();
        assert!(parse("{").contains("no manifest of a world"));
        let text = |sheet: &str, grid: &str, at: u32| {
            format!(
                r#"{{"pworld":1,"sheet":{sheet},"grid":{grid},"height":9,"encoding":"solid","color":"none","sheets":[{{"file":"a","x":{at},"z":0}}]}}"#
            )
        };
        assert!(parse(&text("[500,512]", "[1,1]", 0)).contains("multiples of 256"));
        assert!(parse(&text("[512,512]", "[4000000,1]", 0)).contains("2³⁰"));
        assert!(parse(&text("[512,512]", "[2,2]", 2)).contains("sheet 0, a: 1 × 1 places from (2, 0)"));
        let small = build(procedural(Kind::Hills, 256, 1).unwrap(), &BuildOptions::default()).unwrap();
        let small = file(&small);
        let manifest = manifest([1, 1], ColorMode::Run, &[("small.pcast", [0, 0, 1, 1])]);
        let world =
            Sheets::new(Path::new("w.pworld"), manifest, Box::new(move |_: &Path| Ok(Arc::clone(&small)))).unwrap();
        let wrong = world.tile(TileKey { level: 0, x: 0, z: 0 }).unwrap_err().to_string();
        assert!(wrong.contains("w.pworld: sheet small.pcast: 256 × 128 × 256 voxels"), "{wrong}");
    }
}
