//! Worlds of any size to scene files, within a budget of memory.
//!
//! Level 0 is read in jobs, each a rectangle of tiles with one column around it, which tells what is exposed at its
//! edges. Finished tiles go to a log beside the output ([`crate::encode::part`]). As soon as all tiles that a tile of the next
//! level needs are there, it is made of them, from memory or from the log. At the end the blobs are put in the order of
//! the directory, so that the file depends on the input and the modes alone: not on threads, budget or interruptions.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::fs::{File, OpenOptions};
use std::io::{BufWriter, Seek, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use rayon::prelude::*;

use crate::encode::build::input_colors;
use crate::encode::height_field::HeightField;
use crate::encode::memory;
use crate::encode::mips;
use crate::encode::part::{Finished, Part, Plan, Stored, WORK};
use crate::format::file::Modes;
use crate::format::write::heights_blob;
use crate::format::write::{SceneWriter, compressed, tile_blob, too_long, with_matter, write_atomic};
use crate::format::{self, Grid, TILE, TileEntry};
use crate::model::exposure;
use crate::model::matter::Matter;
use crate::model::pieces::Pieces;
use crate::store::scratch;
use crate::{
    About, BuildOptions, ColorMode, Colors, Columns, Encoding, Error, Feature, Features, Input, Level, PcastFile,
    Result, Rgb,
};

/// How to encode.
#[derive(Clone, Copy, Debug, Default)]
pub struct EncodeOptions {
    pub build: BuildOptions,
    /// What tiles may leave out.
    pub features: Features,
    /// Bytes of memory to stay within; None: a quarter of what is free. One tile with its neighbours a thread is the
    /// least that can be worked on, whatever the budget.
    pub memory: Option<u64>,
    /// Go on with what an interrupted encoding of the same input left.
    pub resume: bool,
    /// Level of zstd to compress tiles with, 1 to 19; None: they stay as they are, to be mapped.
    pub compress: Option<i32>,
    /// Hash of how the input is read, so that parts and logs of different readings are told apart.
    pub settings: u64,
    /// Hash of the input's name and time, for `resume`.
    pub source: u64,
}

/// What others may watch, and stop, while an encoding is under way.
#[derive(Debug, Default)]
pub struct Watch {
    /// Set to end after the job under way.
    pub stop: AtomicBool,
    /// Columns done, over all levels.
    pub columns: AtomicU64,
    /// Columns of all levels.
    pub total: AtomicU64,
    /// Runs of level 0 so far.
    pub runs: AtomicU64,
}

/// What was done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Summary {
    /// Tiles of all levels.
    pub tiles: u64,
    /// Tiles that a resumed encoding found finished.
    pub resumed: u64,
    pub runs: u64,
}

/// Bytes of memory to stay within where nobody says.
pub fn default_memory() -> u64 {
    memory::available().map_or(1 << 30, |free| free / 4).max(64 << 20)
}

/// Encodes a world to a scene file, which is written whole or not at all.
pub fn encode(world: &dyn Pieces, opts: &EncodeOptions, output: &Path, watch: &Watch) -> Result<Summary> {
    let plan = plan(world, opts, None)?;
    logged(world, plan, opts, output, watch, |scene, _| scene.assemble(output, opts.compress))
}

/// The same into a file without a name, in the folder for temporary files: nothing is left of it once it is closed. `name` is
/// what errors call it.
pub fn encode_unnamed(world: &dyn Pieces, opts: &EncodeOptions, name: &Path, watch: &Watch) -> Result<PcastFile> {
    let plan = plan(world, opts, None)?;
    let scratch = || scratch::file().map_err(|e| Error::io(std::env::temp_dir(), "create a file in", e));
    let mut scene = Tiles::create(name, scratch()?, plan, world.about())?;
    scene.encode(world, opts.memory.unwrap_or_else(default_memory), watch)?;
    let file = scratch()?;
    let mut out = BufWriter::with_capacity(1 << 20, &file);
    scene.assemble_to(&mut out, name, opts.compress)?;
    out.flush().map_err(|e| Error::io(std::env::temp_dir(), "write a file in", e))?;
    drop(out);
    PcastFile::from_file(name, &file)
}

/// Encodes some tiles of level 0 to a part of a scene, which is written whole or not at all.
pub fn encode_part(
    world: &dyn Pieces,
    opts: &EncodeOptions,
    tiles: Range<u64>,
    output: &Path,
    watch: &Watch,
) -> Result<Summary> {
    let n_tiles = format::grids(world.dims())[0].n_tiles();
    if tiles.is_empty() || tiles.end > n_tiles {
        return Err(Error::Argument(format!(
            "--tiles {}..{}: the scene has tiles 0..{n_tiles} at level 0",
            tiles.start, tiles.end
        )));
    }
    let plan = plan(world, opts, Some(tiles))?;
    logged(world, plan, opts, output, watch, |scene, log| {
        scene.parts[0].finish()?;
        std::fs::rename(log, output).map_err(|e| Error::io(output, "create", e))
    })
}

/// Makes the tiles that `plan` asks for in the log beside `output`, of which `finish` makes the output.
fn logged(
    world: &dyn Pieces,
    plan: Plan,
    opts: &EncodeOptions,
    output: &Path,
    watch: &Watch,
    finish: impl FnOnce(&mut Tiles, &Path) -> Result<()>,
) -> Result<Summary> {
    let log = log_path(output);
    let (file, fresh) = lock_log(&log, output)?;
    let mut scene = match opts.resume && !fresh {
        true => Tiles::resume(&log, file, plan, output)?,
        false => Tiles::create(&log, file, plan, world.about())?,
    };
    let resumed = scene.stored.len() as u64;
    let memory = opts.memory.unwrap_or_else(default_memory);
    let done = scene.encode(world, memory, watch).and_then(|()| finish(&mut scene, &log));
    // What is finished can be gone on with, unless it is the input or the command that must change.
    let keep = matches!(done, Err(Error::Interrupted | Error::Io { .. })) && !scene.stored.is_empty();
    if !keep && log.exists() {
        std::fs::remove_file(&log).map_err(|e| Error::io(&log, "remove", e))?;
    }
    done?;
    Ok(Summary { tiles: scene.stored.len() as u64, resumed, runs: watch.runs.load(Ordering::Relaxed) })
}

/// Joins parts, in any order, to the scene that encoding the whole input would give, byte for byte. Parts may overlap
/// where they agree.
pub fn merge(
    parts: &[PathBuf],
    memory: Option<u64>,
    compress: Option<i32>,
    output: &Path,
    watch: &Watch,
) -> Result<Summary> {
    let mut scene: Option<Tiles> = None;
    for path in parts {
        let file = File::open(path).map_err(|e| Error::io(path, "open", e))?;
        let number = scene.as_ref().map_or(0, |s| s.parts.len());
        let mut found: Vec<(u64, Stored)> = Vec::new();
        let part = Part::open(path, file, |tile, stored| found.push((tile, stored)))?;
        let plan = *part.plan();
        if !part.is_finished() {
            return Err(Error::format(path, "the part is unfinished or cut short; encode it again"));
        }
        let scene = scene.get_or_insert_with(|| Tiles::new(plan));
        let first = &scene.parts.first().map_or(plan, |p| *p.plan());
        if (plan.dims, plan.modes, plan.mip_rule, plan.features, plan.settings)
            != (first.dims, first.modes, first.mip_rule, first.features, first.settings)
        {
            let other = scene.parts[0].path().display();
            return Err(Error::format(path, format!("a part of another scene than {other}, or encoded otherwise")));
        }
        let held: HashSet<u64> = found.iter().map(|f| f.0).collect();
        if let Some(tile) = (plan.tiles[0]..plan.tiles[1]).find(|tile| !held.contains(tile)) {
            return Err(Error::format(path, format!("tile {tile} is missing from the part; encode it again")));
        }
        for (tile, stored) in found {
            if let Some((other, known)) = scene.stored.get(&tile)
                && known.entry != stored.entry
            {
                let other = scene.parts[*other].path().display();
                return Err(Error::format(
                    path,
                    format!("tile {tile} is not the same as in {other}; encode both again"),
                ));
            }
            scene.stored.insert(tile, (number, stored));
        }
        scene.parts.push(part);
    }
    let Some(mut scene) = scene else {
        return Err(Error::Argument("no parts to merge".to_owned()));
    };
    let n_tiles = scene.grids[0].n_tiles();
    let missing: Vec<u64> = (0..n_tiles).filter(|t| !scene.stored.contains_key(t)).collect();
    if let (Some(first), Some(last)) = (missing.first(), missing.last()) {
        return Err(Error::Argument(format!(
            "{} of {n_tiles} tiles are in no part, the first {first}, the last {last}; encode them with --tiles {first}..{}",
            missing.len(),
            last + 1
        )));
    }
    let log_path = log_path(output);
    let (file, _) = lock_log(&log_path, output)?;
    scene.log = scene.parts.len();
    // Its own tiles are read by them.
    let classes = scene.parts.first().and_then(|part| part.about().classes.clone());
    scene.parts.push(Part::create(&log_path, file, scene.plan, About { classes, ..About::default() })?);
    let memory = memory.unwrap_or_else(default_memory);
    let done = scene.count(watch).levels(memory, watch).and_then(|()| scene.assemble(output, compress));
    std::fs::remove_file(&log_path).map_err(|e| Error::io(&log_path, "remove", e))?;
    done?;
    Ok(Summary { tiles: scene.stored.len() as u64, resumed: n_tiles, runs: watch.runs.load(Ordering::Relaxed) })
}

/// What is to be made of a world, after the options were found to fit it.
fn plan(world: &dyn Pieces, opts: &EncodeOptions, tiles: Option<Range<u64>>) -> Result<Plan> {
    let dims = world.dims();
    let [nx, ny, nz] = dims;
    if dims.contains(&0) {
        return Err(Error::Argument(format!("the input is {nx} × {ny} × {nz}; a world has at least one voxel")));
    }
    let n_tiles: u64 = format::grids(dims).iter().map(Grid::n_tiles).sum();
    if u32::try_from(n_tiles).is_err() {
        return Err(Error::Limit(format!("the scene has {n_tiles} tiles, a file holds 2³² − 1")));
    }
    let color = opts.build.color_of(world.colored())?;
    Ok(Plan {
        dims,
        modes: Modes { encoding: opts.build.encoding, color },
        mip_rule: opts.build.mip_rule,
        features: opts.features,
        settings: opts.settings,
        source: opts.source,
        tiles: tiles.map_or([0, format::grids(dims)[0].n_tiles()], |t| [t.start, t.end]),
    })
}

/// The log of an encoding to `output`, beside it.
fn log_path(output: &Path) -> PathBuf {
    let name = output.file_name().unwrap_or_default().to_string_lossy();
    output.with_file_name(format!(".{name}.unfinished"))
}

/// The log's file, for this process alone, and whether it is new.
fn lock_log(log: &Path, output: &Path) -> Result<(File, bool)> {
    format::write::check_target(output)?;
    let fresh = !log.exists();
    let file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(log);
    let file = file.map_err(|e| Error::io(output, "create a log beside", e))?;
    match file.try_lock() {
        Ok(()) => Ok((file, fresh)),
        Err(std::fs::TryLockError::WouldBlock) => {
            Err(Error::Argument(format!("{}: is being written by another process already", output.display())))
        }
        Err(std::fs::TryLockError::Error(e)) => Err(Error::io(log, "lock", e)),
    }
}

/// The tiles of a scene, as far as they are finished, and where they stand.
struct Tiles {
    plan: Plan,
    grids: Vec<Grid>,
    parts: Vec<Part>,
    /// The part that new tiles go to.
    log: usize,
    /// By number in the directory: the part and the place in it.
    stored: BTreeMap<u64, (usize, Stored)>,
    /// Columns are solid from 0 up, and nothing is kept of them but that.
    by_heights: bool,
    cache: Cache,
}

/// A finished tile, as the level above takes it.
enum Tile {
    Runs(Level),
    Heights(HeightField),
}

impl Tile {
    fn bytes(&self) -> u64 {
        match self {
            Tile::Runs(level) => level_bytes(level),
            Tile::Heights(field) => field.bytes(),
        }
    }

    fn level(&self) -> &Level {
        match self {
            Tile::Runs(level) => level,
            Tile::Heights(_) => unreachable!("a scene's tiles are all of one kind"),
        }
    }

    fn heights(&self) -> &HeightField {
        match self {
            Tile::Heights(field) => field,
            Tile::Runs(_) => unreachable!("a scene's tiles are all of one kind"),
        }
    }
}

impl Tiles {
    fn new(plan: Plan) -> Tiles {
        let grids = format::grids(plan.dims);
        Tiles {
            plan,
            grids,
            parts: Vec::new(),
            log: 0,
            stored: BTreeMap::new(),
            by_heights: false,
            cache: Cache::default(),
        }
    }

    fn create(path: &Path, file: File, plan: Plan, about: About) -> Result<Tiles> {
        let mut tiles = Tiles::new(plan);
        tiles.parts.push(Part::create(path, file, plan, about)?);
        Ok(tiles)
    }

    /// With what the log holds already.
    fn resume(path: &Path, file: File, plan: Plan, output: &Path) -> Result<Tiles> {
        let mut tiles = Tiles::new(plan);
        let stored = &mut tiles.stored;
        let part = Part::open(path, file, |tile, at| {
            stored.insert(tile, (0, at));
        })?;
        if *part.plan() != plan {
            return Err(Error::Argument(format!(
                "--resume: {} was begun with another input or other options; encode without --resume to start anew",
                output.display()
            )));
        }
        tiles.parts.push(part);
        Ok(tiles)
    }

    fn has(&self, level: usize, tx: u32, tz: u32) -> bool {
        self.stored.contains_key(&self.number(level, tx, tz))
    }

    fn number(&self, level: usize, tx: u32, tz: u32) -> u64 {
        let grid = &self.grids[level];
        grid.first + u64::from(tz) * u64::from(grid.tiles[0]) + u64::from(tx)
    }

    /// Tells how much there is to do, and how much is done.
    fn count(&mut self, watch: &Watch) -> &mut Tiles {
        let columns = |grid: &Grid| u64::from(grid.dims[0]) * u64::from(grid.dims[2]);
        watch.total.store(self.grids.iter().map(columns).sum(), Ordering::Relaxed);
        for (&tile, (_, stored)) in &self.stored {
            let level = self.grids.partition_point(|g| g.first <= tile) - 1;
            let grid = &self.grids[level];
            let (tx, tz) = ((tile - grid.first) as u32 % grid.tiles[0], (tile - grid.first) as u32 / grid.tiles[0]);
            let [xs, zs] = grid.columns(tx, tz);
            watch.columns.fetch_add((xs.len() * zs.len()) as u64, Ordering::Relaxed);
            if level == 0 {
                watch.runs.fetch_add(u64::from(stored.entry.n_runs), Ordering::Relaxed);
            }
        }
        self
    }

    /// Makes all tiles that the plan asks for and that are not there.
    fn encode(&mut self, world: &dyn Pieces, memory: u64, watch: &Watch) -> Result<()> {
        self.count(watch);
        self.cache.limit = memory / 2;
        let [from, to] = self.plan.tiles;
        let grid = self.grids[0];
        let across = u64::from(grid.tiles[0]);
        let wanted = |tx: u32, tz: u32| (from..to).contains(&(u64::from(tz) * across + u64::from(tx)));
        let whole = from == 0 && to == grid.n_tiles();
        let modes = Modes { encoding: Encoding::Solid, color: ColorMode::None };
        self.by_heights = world.heights().is_some()
            && world.about().classes.is_none()
            && self.plan.modes == modes
            && self.plan.features.has(Feature::Heights)
            && self.plan.dims[1] <= 0xFFFF;
        // Bytes a column while a job is under way; the first job tells more.
        let mut cost = if self.by_heights { HEIGHTS_COST } else { FIRST_COST };
        let bands = world.rows_together().div_ceil(TILE).max(1);
        let mut tz = (from / across) as u32;
        let end = to.div_ceil(across) as u32;
        let mut first = true;
        while tz < end {
            let budget = (memory / 4) as f64;
            let row = f64::from(grid.dims[0]) * f64::from(TILE) * cost;
            let tall = if first { 1 } else { (budget / row).clamp(1.0, f64::from(bands)) as u32 }.min(end - tz);
            let mut tx = 0;
            while tx < grid.tiles[0] {
                let column = f64::from(TILE) * f64::from(TILE) * f64::from(tall) * cost;
                let wide = (budget / column).clamp(1.0, f64::from(grid.tiles[0] - tx)) as u32;
                let mut job = Vec::new();
                for (x, z) in (tz..tz + tall).flat_map(|z| (tx..tx + wide).map(move |x| (x, z))) {
                    if wanted(x, z) && !self.has(0, x, z) {
                        job.push((x, z));
                    }
                }
                if !job.is_empty() {
                    stopped(watch)?;
                    cost = self.level_0(world, &job, watch)?.max(cost * 0.5);
                    first = false;
                }
                tx += wide;
            }
            tz += tall;
            if whole {
                self.levels_up_to(tz, watch)?;
            }
        }
        Ok(())
    }

    /// Makes the levels above of a complete level 0.
    fn levels(&mut self, memory: u64, watch: &Watch) -> Result<()> {
        self.cache.limit = memory * 3 / 4;
        self.levels_up_to(self.grids[0].tiles[1], watch)
    }

    /// Makes tiles of level 0, which lie in a rectangle, and returns how many bytes a column that took.
    fn level_0(&mut self, world: &dyn Pieces, job: &[(u32, u32)], watch: &Watch) -> Result<f64> {
        let grid = self.grids[0];
        let [nx, _, nz] = grid.dims;
        let bound = |of: fn(&(u32, u32)) -> u32, n: u32| {
            let (low, high) = (job.iter().map(of).min().unwrap_or(0), job.iter().map(of).max().unwrap_or(0));
            (low * TILE).saturating_sub(1)..n.min((high + 1).saturating_mul(TILE).saturating_add(1))
        };
        let (xs, zs) = (bound(|t| t.0, nx), bound(|t| t.1, nz));
        if self.by_heights {
            let heights = world.heights().expect("looked at before");
            let width = xs.len();
            let mut rows = vec![0; width * zs.len()];
            let each = rows.par_chunks_mut(width).zip(zs.clone());
            each.try_for_each(|(row, z)| heights(xs.start, z, row))?;
            let from = |x: u32, z: u32| {
                let row = (z - zs.start) as usize * width;
                &rows[row + (x - xs.start) as usize..row + width]
            };
            self.make(0, job, None, watch, |tiles, tx, tz| {
                let [tile_xs, tile_zs] = grid.columns(tx, tz);
                let around = |r: Range<u32>| i64::from(r.start) - 1..i64::from(r.end) + 1;
                tiles.of_heights(0, tx, tz, &HeightField::gather(around(tile_xs), around(tile_zs), [nx, nz], from))
            })?;
            return Ok(HEIGHTS_COST);
        }
        let Input { columns, colors, .. } = world.piece(xs.clone(), zs.clone())?;
        let matter = world.matter(xs.clone(), zs.clone())?.map(|matter| match columns.runs().is_empty() {
            true => matter,
            false => matter.without(&columns),
        });
        let modes = self.plan.modes;
        let exposed = exposure::exposed(&columns);
        // Those of the surrounding columns are made, too, and not used.
        let colors = match (modes.color, colors) {
            (ColorMode::None, _) => Vec::new(),
            (_, Colors::None) => return Err(Error::Argument("a piece of the input has no colours".to_owned())),
            (_, colors) => input_colors(&colors, &columns, &exposed)?,
        };
        let starts = if colors.is_empty() { Vec::new() } else { exposed.voxel_offsets() };
        let made = self.make(0, job, None, watch, |tiles, tx, tz| {
            let [tile_xs, tile_zs] = grid.columns(tx, tz);
            let local = |r: Range<u32>, at: u32| r.start - at..r.end - at;
            let (tile_xs, tile_zs) = (local(tile_xs, xs.start), local(tile_zs, zs.start));
            let mut own: Vec<Rgb> = Vec::new();
            if !colors.is_empty() {
                for z in tile_zs.clone() {
                    let row = columns.index(tile_xs.start, z);
                    own.extend_from_slice(&colors[starts[row] as usize..starts[row + tile_xs.len()] as usize]);
                }
            }
            let tile = Level {
                solid: columns.crop(tile_xs.clone(), tile_zs.clone()),
                exposed: Some(exposed.crop(tile_xs.clone(), tile_zs.clone())),
                colors: own,
                matter: matter.as_ref().map(|m| Arc::new(m.crop(tile_xs, tile_zs))),
            };
            tiles.finished(0, tx, tz, tile)
        })?;
        let of_matter = matter.as_ref().map_or(0, Matter::bytes);
        let bytes =
            columns.bytes() + exposed.bytes() + of_matter + 8 * starts.len() as u64 + 3 * colors.len() as u64 + made;
        // Half as much again for what comes and goes on the way.
        Ok(bytes as f64 * 1.5 / (xs.len() as f64 * zs.len() as f64))
    }

    /// Makes the tiles of a job, some at a time: while these are made those before are written. Returns how many bytes all took.
    fn make(
        &mut self,
        level: usize,
        job: &[(u32, u32)],
        stop: Option<&Watch>,
        watch: &Watch,
        tile: impl Fn(&Tiles, u32, u32) -> Result<(Finished, Tile)> + Sync,
    ) -> Result<u64> {
        let mut bytes = 0;
        let mut before: Vec<(Finished, Tile)> = Vec::new();
        let mut some = job.chunks(2 * rayon::current_num_threads());
        let mut kept = 0;
        loop {
            let next = some.next();
            if next.is_none() && before.is_empty() {
                return Ok(bytes);
            }
            if let Some(watch) = stop {
                stopped(watch)?;
            }
            let log = &self.parts[self.log];
            let (stored, made) = rayon::join(
                || before.iter().map(|(finished, _)| log.push(finished)).collect::<Result<Vec<Stored>>>(),
                || next.unwrap_or_default().par_iter().map(|&(tx, tz)| tile(self, tx, tz)).collect::<Result<Vec<_>>>(),
            );
            for ((finished, tile), stored) in std::mem::take(&mut before).into_iter().zip(stored?) {
                bytes += (finished.blob.len() + finished.work.len()) as u64 + tile.bytes();
                let (tx, tz) = job[kept];
                self.keep([level as u32, tx, tz], &finished, stored, tile, watch);
                kept += 1;
            }
            before = made?;
        }
    }

    /// The blob of a tile that has one column around it.
    fn of_heights(&self, level: usize, tx: u32, tz: u32, field: &HeightField) -> Result<(Finished, Tile)> {
        let (field, n_exposed) = field.inner();
        let depth = field.heights.len() / field.width;
        let dims = [field.width as u32, self.grids[level].dims[1], depth as u32];
        let made = heights_blob(dims, &field.heights, n_exposed, self.plan.features);
        let (entry, blob) = made.map_err(|len| too_long(level, tx, tz, len))?;
        let finished = Finished { tile: self.number(level, tx, tz), entry, blob, work: Vec::new() };
        Ok((finished, Tile::Heights(field)))
    }

    /// The blobs of a tile that has its exposed voxels, with voxel colours where the scene has any.
    fn finished(&self, level: usize, tx: u32, tz: u32, mut tile: Level) -> Result<(Finished, Tile)> {
        let Plan { modes, features, .. } = self.plan;
        let Modes { encoding, color } = modes;
        let too_long = |len| too_long(level, tx, tz, len);
        let mut work = Vec::new();
        let (entry, blob) = if color == ColorMode::Run {
            let exposed = tile.exposed.as_ref().expect("tiles have exposed runs");
            (_, work) = tile_blob(&tile, WORK, Features::NONE).map_err(too_long)?;
            let of_voxels = mips::run_colors(tile.geometry(encoding), exposed, &tile.colors);
            let of_voxels = std::mem::replace(&mut tile.colors, of_voxels);
            let made = tile_blob(&tile, modes, features).map_err(too_long)?;
            tile.colors = of_voxels;
            made
        } else {
            tile_blob(&tile, modes, features).map_err(too_long)?
        };
        let (entry, blob) = match tile.matter.as_ref().filter(|m| !m.is_empty()) {
            Some(matter) => with_matter((entry, blob), matter).map_err(too_long)?,
            None => (entry, blob),
        };
        if color == ColorMode::None {
            tile.exposed = None;
        }
        Ok((Finished { tile: self.number(level, tx, tz), entry, blob, work }, Tile::Runs(tile)))
    }

    fn keep(&mut self, [level, tx, tz]: [u32; 3], finished: &Finished, stored: Stored, tile: Tile, watch: &Watch) {
        let level = level as usize;
        self.stored.insert(finished.tile, (self.log, stored));
        let [xs, zs] = self.grids[level].columns(tx, tz);
        watch.columns.fetch_add((xs.len() * zs.len()) as u64, Ordering::Relaxed);
        if level == 0 {
            watch.runs.fetch_add(u64::from(finished.entry.n_runs), Ordering::Relaxed);
        }
        if level + 1 < self.grids.len() {
            self.cache.insert(finished.tile, Arc::new(tile));
        }
    }

    /// Makes what can be made of the levels above once the first `bands` rows of tiles of level 0 are there.
    fn levels_up_to(&mut self, bands: u32, watch: &Watch) -> Result<()> {
        let mut done = bands;
        for level in 1..self.grids.len() {
            let (below, grid) = (self.grids[level - 1], self.grids[level]);
            // A tile takes two rows of tiles and one column from each side of them.
            let ready = |tz: u32| done >= below.tiles[1].min(2 * tz + 3);
            let mut next = 0;
            while next < grid.tiles[1] && ready(next) {
                let missing: Vec<(u32, u32)> =
                    (0..grid.tiles[0]).map(|tx| (tx, next)).filter(|&(tx, tz)| !self.has(level, tx, tz)).collect();
                self.make(level, &missing, Some(watch), watch, |tiles, tx, tz| tiles.coarser(level, tx, tz))?;
                if !missing.is_empty() {
                    // The row after this one starts with the last row of tiles that this one took.
                    let rows = 0..(2 * next + 1).min(below.tiles[1]);
                    let tiles = rows.start * below.tiles[0]..rows.end * below.tiles[0];
                    self.cache.forget(below.first + u64::from(tiles.start)..below.first + u64::from(tiles.end));
                }
                next += 1;
            }
            done = next;
        }
        Ok(())
    }

    /// A tile of a level above 0, from the tiles below it and around those.
    fn coarser(&self, level: usize, tx: u32, tz: u32) -> Result<(Finished, Tile)> {
        let (below, grid) = (self.grids[level - 1], self.grids[level]);
        let [xs, zs] = grid.columns(tx, tz);
        // One column more on each side, in columns of the level below.
        let around = |r: &Range<u32>, n: u32, n_below: u32| {
            let (low, high) = (r.start.saturating_sub(1), n.min(r.end + 1));
            (low..high, 2 * low..n_below.min(2 * high))
        };
        let (around_xs, below_xs) = around(&xs, grid.dims[0], below.dims[0]);
        let (around_zs, below_zs) = around(&zs, grid.dims[2], below.dims[2]);
        let mut tiles: HashMap<(u32, u32), Arc<Tile>> = HashMap::new();
        for z in below_zs.start / TILE..=(below_zs.end - 1) / TILE {
            for x in below_xs.start / TILE..=(below_xs.end - 1) / TILE {
                tiles.insert((x, z), self.tile(level - 1, x, z)?);
            }
        }
        if self.by_heights {
            let twice = |r: Range<u32>| 2 * (i64::from(r.start) - 1)..2 * (i64::from(r.end) + 1);
            let fine = HeightField::gather(twice(xs), twice(zs), [below.dims[0], below.dims[2]], |x, z| {
                let field = tiles[&(x / TILE, z / TILE)].heights();
                let row = (z % TILE) as usize * field.width;
                &field.heights[row + (x % TILE) as usize..row + field.width]
            });
            return self.of_heights(level, tx, tz, &fine.next(self.plan.mip_rule));
        }
        let gather = |xs: Range<u32>, zs: Range<u32>, of: fn(&Level) -> &Columns| {
            Columns::gather(below.dims[1], xs, zs, |x, z| {
                let columns = of(tiles[&(x / TILE, z / TILE)].level());
                let ix = (z % TILE) as usize * columns.nx() as usize + (x % TILE) as usize;
                (columns, ix, columns.nx() - x % TILE)
            })
        };
        let solid = mips::next(&gather(below_xs, below_zs, |l| &l.solid), self.plan.mip_rule);
        let exposed = exposure::exposed(&solid);
        let inner = |r: &Range<u32>, around: &Range<u32>| r.start - around.start..r.end - around.start;
        let (inner_xs, inner_zs) = (inner(&xs, &around_xs), inner(&zs, &around_zs));
        let solid = solid.crop(inner_xs.clone(), inner_zs.clone());
        let exposed = exposed.crop(inner_xs, inner_zs);
        let finer = |r: &Range<u32>, axis: usize| 2 * r.start..below.dims[axis].min(2 * r.end);
        let mut colors = Vec::new();
        if self.plan.modes.color != ColorMode::None {
            let (xs, zs) = (finer(&xs, 0), finer(&zs, 2));
            let fine =
                gather(xs.clone(), zs.clone(), |l| l.exposed.as_ref().expect("coloured tiles have exposed runs"));
            let starts: HashMap<(u32, u32), Vec<u64>> = tiles
                .iter()
                .map(|(&at, l)| {
                    (at, l.level().exposed.as_ref().expect("coloured tiles have exposed runs").voxel_offsets())
                })
                .collect();
            let mut fine_colors: Vec<Rgb> = Vec::new();
            for z in zs {
                for x in xs.clone().step_by(TILE as usize) {
                    let at = (x / TILE, z / TILE);
                    let (tile, starts) = (tiles[&at].level(), &starts[&at]);
                    let row = (z % TILE) as usize * tile.solid.nx() as usize;
                    let end = row + tile.solid.nx() as usize;
                    fine_colors.extend_from_slice(&tile.colors[starts[row] as usize..starts[end] as usize]);
                }
            }
            colors = mips::next_colors(&exposed, &fine, &fine_colors);
        }
        // Parts of one scene have the same classes.
        let matter = self.parts[0].about().classes.as_ref().map(|classes| {
            let fine = Matter::gather(below.dims[1], finer(&xs, 0), finer(&zs, 2), |x, z| {
                let level = tiles[&(x / TILE, z / TILE)].level();
                let ix = (z % TILE) as usize * level.solid.nx() as usize + (x % TILE) as usize;
                (level.matter.as_deref(), ix, level.solid.nx() - x % TILE)
            });
            Arc::new(fine.next(classes))
        });
        self.finished(level, tx, tz, Level { solid, exposed: Some(exposed), colors, matter })
    }

    /// A finished tile, from memory or from where it is stored.
    fn tile(&self, level: usize, tx: u32, tz: u32) -> Result<Arc<Tile>> {
        let number = self.number(level, tx, tz);
        if let Some(tile) = self.cache.get(number) {
            return Ok(tile);
        }
        let (part, stored) = &self.stored[&number];
        let tile = self.parts[*part].work_level(stored, &self.grids[level], level, tx, tz)?;
        let tile = match self.by_heights {
            true => Tile::Heights(HeightField::of(&tile.solid)),
            false => Tile::Runs(tile),
        };
        let tile = Arc::new(tile);
        self.cache.insert(number, Arc::clone(&tile));
        Ok(tile)
    }

    /// Puts all tiles in the order of the directory.
    fn assemble(&self, output: &Path, compress: Option<i32>) -> Result<()> {
        write_atomic(output, |out| self.assemble_to(out, output, compress))
    }

    fn assemble_to(&self, out: &mut (impl Write + Seek + Send), output: &Path, compress: Option<i32>) -> Result<()> {
        let Plan { dims, modes, mip_rule, .. } = self.plan;
        // Parts of one scene say the same.
        let about = self.parts[0].about();
        let mut scene = SceneWriter::new(out, output, dims, modes, mip_rule, about)?;
        let all: Vec<&(usize, Stored)> = self.stored.values().collect();
        let read = |some: &[&(usize, Stored)]| {
            let blob = |(part, stored): &(usize, Stored)| {
                let (entry, blob) = (stored.entry, self.parts[*part].blob(stored)?);
                Ok(match compress {
                    Some(level) => compressed(entry, blob, level),
                    None => (entry, blob),
                })
            };
            some.par_iter().map(|&tile| blob(tile)).collect::<Result<Vec<(TileEntry, Vec<u8>)>>>()
        };
        // While some are written the next are read.
        let mut chunks = all.chunks(32);
        let mut before = Vec::new();
        loop {
            let next = chunks.next();
            let (pushed, blobs) = rayon::join(|| scene.push(before), || read(next.unwrap_or_default()));
            pushed?;
            before = blobs?;
            if next.is_none() {
                break;
            }
        }
        scene.finish()
    }
}

/// Bytes a column that the first job is thought to take: a few dozen runs with their colours.
const FIRST_COST: f64 = 256.0;

/// The same of columns that are a number of two bytes: as read, around its tile, in it, in the blob; and half as much again.
const HEIGHTS_COST: f64 = 12.0;

fn stopped(watch: &Watch) -> Result<()> {
    if watch.stop.load(Ordering::Relaxed) { Err(Error::Interrupted) } else { Ok(()) }
}

fn level_bytes(level: &Level) -> u64 {
    let matter = level.matter.as_ref().map_or(0, |m| m.bytes());
    level.solid.bytes() + level.exposed.as_ref().map_or(0, Columns::bytes) + 3 * level.colors.len() as u64 + matter
}

/// Tiles kept in memory for the levels above, those used last.
#[derive(Default)]
struct Cache {
    limit: u64,
    tiles: Mutex<CachedTiles>,
}

#[derive(Default)]
struct CachedTiles {
    by_number: HashMap<u64, (Arc<Tile>, u64)>,
    bytes: u64,
    clock: u64,
}

impl Cache {
    fn get(&self, number: u64) -> Option<Arc<Tile>> {
        let mut tiles = self.tiles.lock().expect("no thread panics with the cache");
        tiles.clock += 1;
        let clock = tiles.clock;
        let (tile, used) = tiles.by_number.get_mut(&number)?;
        *used = clock;
        Some(Arc::clone(tile))
    }

    fn insert(&self, number: u64, tile: Arc<Tile>) {
        let mut tiles = self.tiles.lock().expect("no thread panics with the cache");
        tiles.clock += 1;
        tiles.bytes += tile.bytes();
        let clock = tiles.clock;
        if let Some((old, _)) = tiles.by_number.insert(number, (tile, clock)) {
            tiles.bytes -= old.bytes();
        }
        if tiles.bytes <= self.limit {
            return;
        }
        // A quarter at once: finding the oldest takes a look at all.
        let mut by_age: Vec<(u64, u64)> = tiles.by_number.iter().map(|(&n, t)| (t.1, n)).collect();
        by_age.sort_unstable();
        for (_, number) in by_age {
            if tiles.bytes <= self.limit / 4 * 3 {
                break;
            }
            let (old, _) = tiles.by_number.remove(&number).expect("listed above");
            tiles.bytes -= old.bytes();
        }
    }

    /// Drops tiles that nobody will ask for.
    fn forget(&self, numbers: Range<u64>) {
        let mut tiles = self.tiles.lock().expect("no thread panics with the cache");
        let mut freed = 0;
        tiles.by_number.retain(|number, (tile, _)| {
            let keep = !numbers.contains(number);
            freed += if keep { 0 } else { tile.bytes() };
            keep
        });
        tiles.bytes -= freed;
    }
}

#[cfg(test)]
mod tests {
    use std::sync::LazyLock;

    use super::*;
    use crate::format::write::{write_scene, write_scene_with};
    use crate::model::matter::{Class, Classes, Mode};
    use crate::model::pieces::{InMemory, RowColors, Rows};
    use crate::{ColumnsBuilder, Feature, MipRule, PcastFile, Run, build, testing};

    /// Three tiles on both axes, the last ones narrow; runs of all kinds.
    fn world() -> Columns {
        static WORLD: LazyLock<Columns> = LazyLock::new(|| {
            Columns::from_fn(520, 24, 515, |x, y, z| {
                y < 3 + (x * z / 300) % 9 || (y > 15 && (x / 3 + y + z / 5) % 11 == 0)
            })
        });
        WORLD.clone()
    }

    fn modes() -> impl Iterator<Item = BuildOptions> {
        let colors = [ColorMode::None, ColorMode::Run, ColorMode::Voxel];
        let encodings = [Encoding::Solid, Encoding::Surface];
        encodings.into_iter().flat_map(move |encoding| {
            colors.map(|color| {
                let mip_rule = if color == ColorMode::Run { MipRule::Majority } else { MipRule::Any };
                BuildOptions { encoding, color: Some(color), mip_rule }
            })
        })
    }

    fn options(build: BuildOptions, memory: u64) -> EncodeOptions {
        EncodeOptions { build, memory: Some(memory), ..Default::default() }
    }

    /// Names of the files in a folder, in order.
    fn names(dir: &Path) -> Vec<String> {
        let mut names: Vec<String> =
            std::fs::read_dir(dir).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn encode_gives_the_bytes_of_a_scene_in_memory_whatever_threads_and_budget() {
        let dir = tempfile::tempdir().unwrap();
        let (expected, found) = (dir.path().join("a.pcast"), dir.path().join("b.pcast"));
        let colored = InMemory::new(testing::input(world(), true));
        for opts in modes() {
            write_scene(&build(testing::input(world(), true), &opts).unwrap(), &expected).unwrap();
            let expected = std::fs::read(&expected).unwrap();
            for (threads, memory) in [(1, 1 << 30), (3, 1 << 30), (2, 1)] {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                let encode = || encode(&colored, &options(opts, memory), &found, &Watch::default());
                pool.install(encode).unwrap();
                assert!(std::fs::read(&found).unwrap() == expected, "{opts:?} {threads} threads, {memory} bytes");
            }
        }
        assert_eq!(names(dir.path()), ["a.pcast", "b.pcast"], "nothing else is left behind");
    }

    /// [`world`] with matter of three classes beside what is solid.
    struct Hazy {
        world: InMemory,
        classes: Arc<Classes>,
    }

    fn hazy(window: Option<[f64; 2]>) -> Hazy {
        let class = |k: u8| Class { color: [k; 3], opacity: 0.1 * f64::from(k), mode: Mode::Volumetric };
        let classes = Arc::new(Classes { window, classes: (1..4).map(class).collect() });
        let about = About { classes: Some(Arc::clone(&classes)), ..About::default() };
        let matter = Matter::try_from_rows([520, 24, 515], |z, out| {
            for x in 0..520 {
                (0..24).for_each(|y| {
                    out.push(1, 8 * ((x / 2 + y * z / 90) % 9 / 2 % 4) as u16 * u16::from(x < 256 || z > 255))
                });
                out.end_column();
            }
            Ok(())
        });
        Hazy { world: InMemory::new(testing::input(world(), true)).about(about).matter(matter.unwrap()), classes }
    }

    #[test]
    fn encode_of_matter_gives_the_bytes_of_a_scene_in_memory_whatever_budget_and_parts() {
        let dir = tempfile::tempdir().unwrap();
        let (expected, found) = (dir.path().join("a.pcast"), dir.path().join("b.pcast"));
        for (opts, window) in modes().zip([Some([0.0, 3.0]), None].into_iter().cycle()) {
            let hazy = hazy(window);
            let scene = build(testing::input(world(), true), &opts).unwrap();
            let matter = Pieces::matter(&hazy.world, 0..520, 0..515).unwrap().unwrap();
            let scene = scene.with_matter(matter, Arc::clone(&hazy.classes));
            write_scene(&scene, &expected).unwrap();
            let bytes = std::fs::read(&expected).unwrap();
            assert_eq!(bytes[8], 4);
            for memory in [1 << 30, 1] {
                encode(&hazy.world, &options(opts, memory), &found, &Watch::default()).unwrap();
                assert!(std::fs::read(&found).unwrap() == bytes, "{opts:?} {memory} bytes");
            }
            let parts = [0..4, 4..9].map(|tiles| {
                let part = dir.path().join(format!("{}.part", tiles.start));
                encode_part(&hazy.world, &options(opts, 1), tiles, &part, &Watch::default()).unwrap();
                part
            });
            merge(&parts, Some(1), None, &found, &Watch::default()).unwrap();
            assert!(std::fs::read(&found).unwrap() == bytes, "{opts:?} parts");
            let packed = EncodeOptions { compress: Some(1), ..options(opts, 1 << 30) };
            encode(&hazy.world, &packed, &found, &Watch::default()).unwrap();
            for path in [&expected, &found] {
                let file = PcastFile::open(path).unwrap();
                assert!(file.read_scene().unwrap() == scene, "{opts:?} {}", path.display());
            }
        }
    }

    #[test]
    fn matter_with_a_byte_changed_is_refused_and_without_its_classes_the_file() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.pcast");
        encode(&hazy(None).world, &EncodeOptions::default(), &path, &Watch::default()).unwrap();
        let good = std::fs::read(&path).unwrap();
        let file = PcastFile::from_bytes("a.pcast", good.clone()).unwrap();
        let entry = file.entries()[0];
        for at in [0, 4, 15, entry.len / 2, entry.len - 1] {
            let mut bytes = good.clone();
            bytes[(entry.offset + u64::from(at)) as usize] ^= 0x21;
            let broken = PcastFile::from_bytes("a.pcast", bytes.clone()).unwrap();
            assert!(broken.read_scene().is_err(), "byte {at}");
            // With its checksum made right: an error, or something else to see, never a panic.
            testing::reseal(&mut bytes);
            if let Ok(scene) = PcastFile::from_bytes("a.pcast", bytes).and_then(|file| file.read_scene()) {
                assert!(scene != file.read_scene().unwrap(), "byte {at}");
            }
        }
        let tag = good.windows(4).position(|w| w == b"CLAS").unwrap();
        let mut bytes = good;
        bytes[tag] = b'X';
        let error = PcastFile::from_bytes("a.pcast", bytes).err().unwrap().to_string();
        assert!(error.contains("no classes (CLAS)"), "{error}");
    }

    /// Columns solid from 0 up: a plain, a plain of nothing, steps of one and of two bytes.
    fn hills(x: u32, z: u32) -> u16 {
        match (x / 256, z / 256) {
            (0, 0) => 7,
            (1, 0) => 0,
            (2, _) => (x * z % 700) as u16,
            _ => 300 + (x * 7 + z * z / 5) as u16 % 90,
        }
    }

    #[test]
    fn encode_of_heights_gives_the_bytes_of_runs() {
        let dir = tempfile::tempdir().unwrap();
        let (expected, found) = (dir.path().join("a.pcast"), dir.path().join("b.pcast"));
        let dims = [520, 700, 515];
        let row = |xs: Range<u32>, z: u32, out: &mut ColumnsBuilder| {
            for h in xs.map(|x| hills(x, z)) {
                if h > 0 {
                    out.push_run(Run::new(0, h - 1));
                }
                out.end_column();
            }
            Ok(())
        };
        let columns = Columns::try_from_rows(dims, |z, out| row(0..dims[0], z, out)).unwrap();
        let heights = |x: u32, z: u32, out: &mut [u16]| {
            out.iter_mut().zip(x..).for_each(|(h, x)| *h = hills(x, z));
            Ok(())
        };
        let world = Rows {
            dims,
            row: Box::new(row),
            heights: Some(Box::new(heights)),
            color: RowColors::None,
            notes: Vec::new(),
            about: About::default(),
            input_bytes: 0,
            water: None,
        };
        for (encoding, mip_rule, features) in [
            (Encoding::Solid, MipRule::Any, Features::ALL),
            (Encoding::Solid, MipRule::Majority, Features::ALL),
            (Encoding::Surface, MipRule::Any, Features::ALL),
            (Encoding::Solid, MipRule::Any, Features::NONE),
        ] {
            let build_as = BuildOptions { encoding, mip_rule, ..Default::default() };
            let input = Input { columns: columns.clone(), colors: Colors::None, notes: Vec::new() };
            let scene = build(input, &build_as).unwrap();
            write_atomic(&expected, |out| write_scene_with(&scene, features, out, &expected)).unwrap();
            let expected = std::fs::read(&expected).unwrap();
            for memory in [1 << 30, 1] {
                let opts = EncodeOptions { features, ..options(build_as, memory) };
                encode(&world, &opts, &found, &Watch::default()).unwrap();
                assert!(std::fs::read(&found).unwrap() == expected, "{build_as:?} {features} {memory} bytes");
                let parts = [0..4, 4..9].map(|tiles| {
                    let part = dir.path().join(format!("{}.part", tiles.start));
                    encode_part(&world, &opts, tiles, &part, &Watch::default()).unwrap();
                    part
                });
                merge(&parts, Some(memory), None, &found, &Watch::default()).unwrap();
                assert!(std::fs::read(&found).unwrap() == expected, "{build_as:?} {features} parts");
            }
        }
    }

    #[test]
    fn encode_counts_what_it_does() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.pcast");
        let watch = Watch::default();
        let world = InMemory::new(testing::input(world(), false));
        let summary = encode(&world, &EncodeOptions::default(), &path, &watch).unwrap();
        let file = PcastFile::open(&path).unwrap();
        let columns: u64 = file.grids().iter().map(|g| u64::from(g.dims[0]) * u64::from(g.dims[2])).sum();
        let runs: u64 = file.entries()[..9].iter().map(|e| u64::from(e.n_runs)).sum();
        assert_eq!([&watch.columns, &watch.total].map(|n| n.load(Ordering::Relaxed)), [columns; 2]);
        assert_eq!(summary, Summary { tiles: file.entries().len() as u64, resumed: 0, runs });
    }

    /// A world that stops the encoding, or fails, at one of its pieces.
    struct Faulty<'a> {
        world: InMemory,
        watch: &'a Watch,
        left: AtomicU64,
        fails: bool,
    }

    impl Pieces for Faulty<'_> {
        fn dims(&self) -> [u32; 3] {
            self.world.dims()
        }
        fn colored(&self) -> bool {
            self.world.colored()
        }
        fn notes(&self) -> &[String] {
            &[]
        }
        fn piece(&self, xs: Range<u32>, zs: Range<u32>) -> Result<Input> {
            if self.left.fetch_sub(1, Ordering::Relaxed) == 1 {
                if self.fails {
                    return Err(Error::format("a.raw", "a fault"));
                }
                self.watch.stop.store(true, Ordering::Relaxed);
            }
            self.world.piece(xs, zs)
        }
    }

    #[test]
    fn encode_that_was_stopped_anywhere_goes_on_to_the_same_bytes() {
        let dir = tempfile::tempdir().unwrap();
        let (whole, path) = (dir.path().join("whole.pcast"), dir.path().join("a.pcast"));
        let log = dir.path().join(".a.pcast.unfinished");
        let world = || InMemory::new(testing::input(world(), true));
        let build = BuildOptions { color: Some(ColorMode::Run), ..Default::default() };
        let fresh = options(build, 1);
        let goes_on = EncodeOptions { resume: true, ..fresh };
        encode(&world(), &fresh, &whole, &Watch::default()).unwrap();
        let expected = std::fs::read(&whole).unwrap();
        for stop_at in [1, 2, 5, 9] {
            let watch = Watch::default();
            let faulty = Faulty { world: world(), watch: &watch, left: AtomicU64::new(stop_at), fails: false };
            assert!(matches!(encode(&faulty, &fresh, &path, &watch), Err(Error::Interrupted)));
            assert!(!path.exists() && log.exists());
            // A crash while a tile was being written: the end of the log is lost, or its last bytes are.
            let mut bytes = std::fs::read(&log).unwrap();
            bytes.truncate(bytes.len() - 7 * stop_at as usize);
            let last = bytes.len() - 1;
            bytes[last] ^= 1;
            std::fs::write(&log, bytes).unwrap();
            let summary = encode(&world(), &goes_on, &path, &Watch::default()).unwrap();
            assert!(summary.resumed < summary.tiles && (stop_at == 1 || summary.resumed > 0), "{summary:?}");
            assert!(std::fs::read(&path).unwrap() == expected, "stopped at {stop_at}");
            assert!(!log.exists());
            std::fs::remove_file(&path).unwrap();
        }
    }

    #[test]
    fn encode_does_not_go_on_with_other_options_and_leaves_nothing_of_a_bad_input() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.pcast");
        let watch = Watch::default();
        let faulty = |left, fails| Faulty {
            world: InMemory::new(testing::input(world(), true)),
            watch: &watch,
            left: AtomicU64::new(left),
            fails,
        };
        let fresh = options(BuildOptions::default(), 1);
        let error = encode(&faulty(3, true), &fresh, &path, &watch).unwrap_err();
        assert_eq!(error.to_string(), "a.raw: a fault");
        assert_eq!(names(dir.path()), [""; 0]);
        encode(&faulty(3, false), &fresh, &path, &watch).unwrap_err();
        watch.stop.store(false, Ordering::Relaxed);
        for other in [
            EncodeOptions { resume: true, settings: 1, ..fresh },
            EncodeOptions { resume: true, source: 1, ..fresh },
            EncodeOptions { resume: true, build: BuildOptions { mip_rule: MipRule::Majority, ..fresh.build }, ..fresh },
        ] {
            let error = encode(&faulty(0, false), &other, &path, &watch).unwrap_err().to_string();
            assert!(error.contains("was begun with another input or other options"), "{error}");
        }
        // The log of the stopped one is still there.
        let summary = encode(&faulty(0, false), &EncodeOptions { resume: true, ..fresh }, &path, &watch).unwrap();
        assert!(summary.resumed > 0);
    }

    #[test]
    fn encode_refuses_an_output_that_another_writes() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.pcast");
        let lock = lock_log(&log_path(&path), &path).unwrap();
        let world = InMemory::new(testing::input(Columns::empty(2, 2, 2), false));
        let again = || encode(&world, &EncodeOptions::default(), &path, &Watch::default());
        assert!(again().unwrap_err().to_string().ends_with("is being written by another process already"));
        drop(lock);
        again().unwrap();
    }

    /// Parts of `world()` for these ranges of its nine tiles, as files `0.part`, `1.part`, …
    fn parts(dir: &Path, opts: &EncodeOptions, ranges: &[Range<u64>]) -> Vec<PathBuf> {
        let world = InMemory::new(testing::input(world(), true));
        let part = |(i, range): (usize, &Range<u64>)| {
            let path = dir.join(format!("{i}.part"));
            encode_part(&world, opts, range.clone(), &path, &Watch::default()).unwrap();
            path
        };
        ranges.iter().enumerate().map(part).collect()
    }

    #[test]
    fn merge_of_parts_in_any_order_gives_the_bytes_of_one_encode() {
        let dir = tempfile::tempdir().unwrap();
        let (whole, path) = (dir.path().join("whole.pcast"), dir.path().join("a.pcast"));
        for build in modes() {
            let opts = options(build, 1 << 30);
            encode(&InMemory::new(testing::input(world(), true)), &opts, &whole, &Watch::default()).unwrap();
            let expected = std::fs::read(&whole).unwrap();
            let mut parts = parts(dir.path(), &opts, &[0..2, 2..3, 3..7, 5..9]);
            for memory in [1 << 30, 1] {
                parts.rotate_left(1);
                parts.push(parts[0].clone());
                for _ in 0..2 {
                    merge(&parts, Some(memory), None, &path, &Watch::default()).unwrap();
                    assert!(std::fs::read(&path).unwrap() == expected, "{build:?}");
                }
            }
        }
    }

    #[test]
    fn merge_and_resume_keep_to_what_tiles_may_leave_out() {
        let dir = tempfile::tempdir().unwrap();
        let (whole, path) = (dir.path().join("whole.pcast"), dir.path().join("a.pcast"));
        for build in modes() {
            let mut sizes = Vec::new();
            let tables = Features::from_iter([Feature::Tables]);
            for (features, version) in [(Features::NONE, 1), (tables, 3), (Features::ALL, 3)] {
                let opts = EncodeOptions { features, ..options(build, 1) };
                encode(&InMemory::new(testing::input(world(), true)), &opts, &whole, &Watch::default()).unwrap();
                let expected = std::fs::read(&whole).unwrap();
                assert_eq!(expected[8], version);
                let parts = parts(dir.path(), &opts, &[0..5, 5..9]);
                merge(&parts, Some(1), None, &path, &Watch::default()).unwrap();
                assert!(std::fs::read(&path).unwrap() == expected, "{build:?} {features}");
                sizes.push(expected.len());
            }
            assert!(sizes.is_sorted_by(|a, b| a > b), "{build:?} {sizes:?}");
        }
        let opts = |features| EncodeOptions { features, ..options(BuildOptions::default(), 1) };
        let mut mixed = parts(dir.path(), &opts(Features::NONE), std::slice::from_ref(&(0..5)));
        let sub = dir.path().join("sub");
        std::fs::create_dir(&sub).unwrap();
        mixed.extend(parts(&sub, &opts(Features::ALL), std::slice::from_ref(&(5..9))));
        let refused = merge(&mixed, None, None, &path, &Watch::default()).unwrap_err().to_string();
        assert!(refused.contains("a part of another scene than"), "{refused}");
    }

    #[test]
    fn merge_refuses_parts_that_are_missing_broken_or_of_another_scene() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.pcast");
        let opts = options(BuildOptions::default(), 1 << 30);
        let good = parts(dir.path(), &opts, &[0..4, 4..9]);
        let refused = |parts: &[PathBuf]| merge(parts, None, None, &path, &Watch::default()).unwrap_err().to_string();
        assert_eq!(refused(&[]), "no parts to merge");
        assert_eq!(
            refused(&good[..1]),
            "5 of 9 tiles are in no part, the first 4, the last 8; encode them with --tiles 4..9"
        );
        let bytes = std::fs::read(&good[1]).unwrap();
        let bad = dir.path().join("bad.part");
        let with = |bytes: &[u8]| {
            std::fs::write(&bad, bytes).unwrap();
            refused(&[good[0].clone(), bad.clone()])
        };
        for cut in [bytes.len() - 1, bytes.len() - 80, bytes.len() / 2, 200] {
            assert!(with(&bytes[..cut]).ends_with("unfinished or cut short; encode it again"), "{cut}");
        }
        assert!(with(&bytes[..50]).ends_with("50 bytes; a part has a header of 80"));
        assert!(with(b"P").contains("a part has a header"));
        for at in (0..bytes.len()).step_by(bytes.len() / 50) {
            let mut bytes = bytes.clone();
            bytes[at] ^= 0x10;
            assert!(with(&bytes).contains("bad.part"), "byte {at}");
        }
        let other = EncodeOptions { settings: 7, ..opts };
        let sub = dir.path().join("sub");
        std::fs::create_dir(&sub).unwrap();
        let others = parts(&sub, &other, std::slice::from_ref(&(4..9)));
        assert!(refused(&[good[0].clone(), others[0].clone()]).contains("a part of another scene than"));
        // The same name for another world: tiles that overlap differ.
        let world = InMemory::new(testing::input(Columns::from_fn(520, 24, 515, |_, y, _| y < 3), true));
        encode_part(&world, &opts, 3..9, &others[0], &Watch::default()).unwrap();
        assert!(refused(&[good[0].clone(), others[0].clone()]).contains("tile 3 is not the same as in"));
        assert!(!path.exists());
        assert!(!log_path(&path).exists());
    }

    #[test]
    fn encode_of_tiles_that_are_not_there_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let world = InMemory::new(testing::input(Columns::empty(300, 2, 2), false));
        let part =
            |range| encode_part(&world, &EncodeOptions::default(), range, &dir.path().join("a"), &Watch::default());
        assert_eq!(part(1..3).unwrap_err().to_string(), "--tiles 1..3: the scene has tiles 0..2 at level 0");
        assert_eq!(part(1..2).unwrap().tiles, 1);
    }
}
