//! A scene made ready for drawing: the tables that the kernels read, the same on CPU and GPU.
//!
//! The file's two-level lists are compact but take two dependent look-ups a column. Here the common case, a column
//! whose topmost run decides, costs one 8-byte load (DESIGN: measured to nearly halve the GPU's time):
//!
//! ```text
//! column entry   | top run: first u16, last u16 | more u32 |   8 B a column, z·nx + x
//!                  more = 0: no further run, else a position in `runs`
//! runs           | n | run | run | … n times                   further runs of one column, from the top down
//! height         | voxels u16 |                                2 B a column, instead of both, where each column of
//!                                                              the world is empty or one run from the ground up
//! block          | lowest first u16, highest last u16 |         bounds of 8 × 8 columns
//! ```
//!
//! Where a level's tiles are not all there, its columns stand tile by tile in slots, and [`Pages`] tell which: the same tables
//! otherwise (`src/world/pager.rs`).

use crate::frame::specialize::{Feature, Features};
use crate::world::matter::SceneMatter;
use crate::{Error, Result};
use bytemuck::Zeroable;
use planecast_encoder::format::TILE;
use planecast_encoder::model::filled::{filled, starts};
use planecast_encoder::{ColorMode, Columns, Encoding, Level, Rgb, Run, Scene};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::Arc;

/// Columns a side of a block whose height bounds are kept.
pub const BLOCK_SHIFT: u32 = 3;

/// A column or block without runs: its `first` is above its `last`.
pub const EMPTY: u32 = 0x0000_FFFF;

/// One level's tables.
#[derive(Clone, Debug, PartialEq)]
pub struct ResidentLevel {
    /// Columns along x and z.
    pub nx: u32,
    pub nz: u32,
    pub table: Table,
    /// Height bounds of 8 × 8 columns, `⌈nx/8⌉` a row.
    pub blocks: Vec<u32>,
    /// Lowest voxel and one past the highest, in voxels of this level; equal where the level is empty.
    pub bottom: u32,
    pub top: u32,
    pub paint: Paint,
    /// Where its columns stand, unless that is row by row.
    pub pages: Option<Pages>,
}

/// Columns a side of a tile, as a power of two.
pub const TILE_SHIFT: u32 = TILE.ilog2();

/// Where the tiles of a level stand that are there: of a window over the level, which repeats beyond its ends, the slot of each.
/// Slot 0 is an empty tile.
#[derive(Clone, Debug, PartialEq)]
pub struct Pages {
    /// Tiles a side of the window, as a power of two.
    pub shift: u32,
    /// Slots of the window's tiles, row by row.
    pub slots: Vec<u32>,
}

impl Pages {
    /// Number of a tile's place in the window.
    #[inline(always)]
    pub fn place(&self, x: u32, z: u32) -> usize {
        let mask = (1 << self.shift) - 1;
        (((z & mask) << self.shift) | (x & mask)) as usize
    }

    #[inline(always)]
    pub fn index(&self, x: u32, z: u32) -> usize {
        let slot = self.slots[self.place(x >> TILE_SHIFT, z >> TILE_SHIFT)] as usize;
        (slot << (2 * TILE_SHIFT)) | (((z % TILE) << TILE_SHIFT) | (x % TILE)) as usize
    }

    #[inline(always)]
    fn block(&self, x: u32, z: u32) -> usize {
        const SHIFT: u32 = TILE_SHIFT - BLOCK_SHIFT;
        let slot = self.slots[self.place(x >> TILE_SHIFT, z >> TILE_SHIFT)] as usize;
        let [x, z] = [x, z].map(|v| (v % TILE) >> BLOCK_SHIFT);
        (slot << (2 * SHIFT)) | ((z << SHIFT) | x) as usize
    }
}

/// The solid runs of one level's columns.
#[derive(Clone, Debug, PartialEq)]
pub enum Table {
    Runs {
        /// Two words a column: the topmost run, and where the others stand.
        columns: Vec<[u32; 2]>,
        /// `[n, run × n]` for each column with more than one run. Word 0 is unused, so that 0 can mean "none".
        runs: Vec<u32>,
    },
    /// How many voxels each column has, from the ground up; a 0 more where the columns are odd, so that all are whole words.
    Heights(Vec<u16>),
}

/// Colours of one level.
#[derive(Clone, Debug, PartialEq)]
pub enum Paint {
    None,
    /// Colour of the one run of column `i`: `colors[i]`. Of a level with heights, where voxels have no colours of their own, or
    /// all of a column the same.
    Column {
        colors: Vec<u32>,
    },
    /// Colour of voxel `y` of any column: `colors[y]`. Of a level that is tinted by height.
    Height {
        colors: Vec<u32>,
    },
    /// Of a level with heights: column `i` has the colours `colors[starts[s] .. starts[s + 1]]` with `s` as
    /// [`ResidentLevel::start`] says it: those of its topmost voxels, the lowest first. Where it hides voxels below those, the
    /// first is voxel 0's.
    Top {
        starts: Vec<u32>,
        colors: Vec<u32>,
    },
    /// Colour of run `k` (from the top down) of column `i`: `colors[base[i] + k]`.
    Run {
        base: Vec<u32>,
        colors: Vec<u32>,
    },
    /// Column `i` has exposed runs `exposed[base[s] .. base[s + 1]]` with `s` as [`ResidentLevel::start`] says it, ascending, each
    /// with the place of its lowest voxel's colour.
    Voxel {
        base: Vec<u32>,
        exposed: Vec<[u32; 2]>,
        colors: Vec<u32>,
    },
}

/// All levels of one scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Resident {
    /// `[nx, ny, nz]` of level 0.
    pub dims: [u32; 3],
    pub encoding: Encoding,
    pub color: ColorMode,
    pub levels: Vec<ResidentLevel>,
    /// Whether all levels have heights instead of runs.
    pub heights: bool,
    /// By how much the surface that level 0 stands for is higher than its columns, in 256ths of a voxel, 128 more; empty where that
    /// is not known.
    pub fractions: Vec<u8>,
    /// Translucent matter, where the scene has any.
    pub matter: Option<Arc<SceneMatter>>,
}

/// Packs a colour for the kernels: r in the low byte, alpha 255.
pub fn pack_rgb(c: Rgb) -> u32 {
    u32::from_le_bytes([c[0], c[1], c[2], 255])
}

impl Resident {
    /// The tables with all that the scene does not need left out. Panics where [`Resident::with`] does.
    pub fn new(scene: &Scene) -> Resident {
        Resident::with(scene, Features::ALL)
    }

    /// The tables with nothing left out but what `features` names. Panics where [`Resident::try_with`] has an error.
    pub fn with(scene: &Scene, features: Features) -> Resident {
        Resident::try_with(scene, features).unwrap_or_else(|error| panic!("{error}"))
    }

    /// The same for scenes of any size.
    ///
    /// # Errors
    /// [`Error::Limit`] where memory is out, or a level has more words of runs or colours than 32 bits count.
    pub fn try_with(scene: &Scene, features: Features) -> Result<Resident> {
        let heights = features.has(Feature::Heights)
            && scene.levels.par_iter().all(|level| is_height_field(level.geometry(scene.encoding)));
        let levels = scene.levels.iter().map(|level| ResidentLevel::new(level, scene.encoding, scene.color, heights));
        let levels = levels.collect::<Result<_>>()?;
        let (encoding, color, matter) = (scene.encoding, scene.color, SceneMatter::of(scene));
        Ok(Resident { dims: scene.dims(), encoding, color, levels, heights, fractions: Vec::new(), matter })
    }

    /// The same with what is known of the surface that a height field stands for.
    pub fn with_fractions(self, fractions: &[u8]) -> Resident {
        let columns = self.levels.first().map_or(0, |level| level.nx as usize * level.nz as usize);
        let fits = self.heights && fractions.len() == columns;
        Resident { fractions: if fits { fractions.to_vec() } else { Vec::new() }, ..self }
    }

    /// Bytes that the tables take.
    pub fn bytes(&self) -> u64 {
        let level = |l: &ResidentLevel| {
            let paint = match &l.paint {
                Paint::None => 0,
                Paint::Column { colors } | Paint::Height { colors } => 4 * colors.len(),
                Paint::Top { starts, colors } => 4 * (starts.len() + colors.len()),
                Paint::Run { base, colors } => 4 * (base.len() + colors.len()),
                Paint::Voxel { base, exposed, colors, .. } => 4 * (base.len() + colors.len()) + 8 * exposed.len(),
            };
            let table = match &l.table {
                Table::Runs { columns, runs } => 8 * columns.len() + 4 * runs.len(),
                Table::Heights(heights) => 2 * heights.len(),
            };
            (table + 4 * l.blocks.len() + paint) as u64
        };
        self.levels.iter().map(level).sum::<u64>()
            + self.fractions.len() as u64
            + self.matter.as_ref().map_or(0, |m| m.bytes())
    }
}

impl ResidentLevel {
    /// The tables of a level, or of one tile of it; as heights only where [`is_height_field`].
    ///
    /// # Errors
    /// [`Error::Limit`] as [`Resident::try_with`] has it.
    pub fn new(level: &Level, encoding: Encoding, color: ColorMode, heights: bool) -> Result<ResidentLevel> {
        let geometry = level.geometry(encoding);
        let (nx, nz) = (geometry.nx(), geometry.nz());
        let table = if heights { height_table(geometry)? } else { run_table(geometry)? };
        let paint = match color {
            ColorMode::None => Paint::None,
            ColorMode::Run if heights => column_paint(geometry, |ix| level.colors[geometry.range(ix)].first())?,
            ColorMode::Run => run_paint(geometry, &level.colors)?,
            ColorMode::Voxel => {
                let exposed = level.exposed.as_ref().expect("voxel colours come with exposed runs");
                let first = first_voxels(exposed)?;
                if !heights {
                    voxel_paint(exposed, &first, &level.colors)?
                } else if one_color_each(&first, &level.colors) {
                    column_paint(geometry, |ix| level.colors[first[ix] as usize..first[ix + 1] as usize].first())?
                } else {
                    Paint::Top { starts: first, colors: packed(&level.colors) }
                }
            }
        };
        let blocks = blocks(geometry)?;
        let found = blocks.par_iter().filter(|&&block| block != EMPTY);
        let (bottom, top) = found
            .map(|&block| (block & 0xFFFF, (block >> 16) + 1))
            .reduce(|| (u32::MAX, 0), |a, b| (a.0.min(b.0), a.1.max(b.1)));
        Ok(ResidentLevel { nx, nz, table, blocks, bottom: bottom.min(top), top, paint, pages: None })
    }

    /// Columns that the tables have room for.
    pub fn n_columns(&self) -> usize {
        match &self.table {
            Table::Runs { columns, .. } => columns.len(),
            Table::Heights(heights) => heights.len(),
        }
    }

    /// Number of a column in the tables; `x` and `z` lie within the level.
    #[inline(always)]
    pub fn index(&self, x: u32, z: u32) -> usize {
        match &self.pages {
            None => (z * self.nx + x) as usize,
            Some(pages) => pages.index(x, z),
        }
    }

    /// Number of the block that holds a column.
    #[inline(always)]
    pub fn block(&self, x: u32, z: u32) -> usize {
        match &self.pages {
            None => {
                (z >> BLOCK_SHIFT) as usize * (self.nx as usize).div_ceil(1 << BLOCK_SHIFT)
                    + (x >> BLOCK_SHIFT) as usize
            }
            Some(pages) => pages.block(x, z),
        }
    }

    /// How many columns a block's next row is further.
    #[inline(always)]
    pub fn row(&self) -> usize {
        if self.pages.is_some() { TILE as usize } else { self.nx as usize }
    }

    /// Where [`Paint::Top`] and [`Paint::Voxel`] say where column number `ix` begins; the next entry is its end. A slot has one entry
    /// more than columns.
    #[inline(always)]
    pub fn start(&self, ix: usize) -> usize {
        if self.pages.is_some() { ix + (ix >> (2 * TILE_SHIFT)) } else { ix }
    }

    /// Colour of voxel `y` (of this level) in run number `k` (from the top down) of column number `ix`. A voxel without
    /// a colour of its own (interior: the eye is inside it) takes that of the nearest exposed run below.
    #[inline(always)]
    pub fn color(&self, ix: usize, k: u32, y: u32) -> u32 {
        match &self.paint {
            Paint::None => UNPAINTED,
            Paint::Column { colors } => colors[ix],
            Paint::Height { colors } => colors[y as usize],
            Paint::Top { starts, colors } => {
                let (own, hidden) = self.own_colors(starts, colors, ix);
                own.get(y.saturating_sub(hidden) as usize).copied().unwrap_or(UNPAINTED)
            }
            Paint::Run { base, colors } => colors[(base[ix] + k) as usize],
            Paint::Voxel { base, exposed, colors } => {
                let column = self.exposed(base, exposed, ix);
                if column.is_empty() {
                    return UNPAINTED;
                }
                let [run, start] = column[nearest_exposed(column, y)];
                let (first, last) = (u32::from(Run(run).first()), u32::from(Run(run).last()));
                colors[(start + y.clamp(first, last) - first) as usize]
            }
        }
    }

    /// The exposed runs of a column of [`Paint::Voxel`].
    #[inline(always)]
    pub fn exposed<'a>(&self, base: &[u32], exposed: &'a [[u32; 2]], ix: usize) -> &'a [[u32; 2]] {
        let at = self.start(ix);
        &exposed[base[at] as usize..base[at + 1] as usize]
    }

    /// Of a column of [`Paint::Top`] its colours, and the voxel from which on there is one each; those below have the first.
    #[inline(always)]
    pub fn own_colors<'a>(&self, starts: &[u32], colors: &'a [u32], ix: usize) -> (&'a [u32], u32) {
        let at = self.start(ix);
        let own = &colors[starts[at] as usize..starts[at + 1] as usize];
        let [top, _] = self.entry(ix);
        (own, ((top >> 16) + 1).saturating_sub(own.len() as u32))
    }

    /// The topmost run of column number `ix`, [`EMPTY`] where it has none, and where the others stand in the table's runs.
    #[inline(always)]
    pub fn entry(&self, ix: usize) -> [u32; 2] {
        match &self.table {
            Table::Runs { columns, .. } => columns[ix],
            Table::Heights(heights) => [run_of_height(heights[ix]), 0],
        }
    }

    /// The table's runs; those of heights are none.
    #[inline(always)]
    pub fn runs(&self) -> &[u32] {
        match &self.table {
            Table::Runs { runs, .. } => runs,
            Table::Heights(_) => &[],
        }
    }

    /// The runs of column number `ix`, from the top down.
    pub fn column(&self, ix: usize) -> impl Iterator<Item = Run> + '_ {
        let [top, more] = self.entry(ix);
        let rest = match more as usize {
            0 => &[][..],
            at => &self.runs()[at + 1..at + 1 + self.runs()[at] as usize],
        };
        (top != EMPTY).then_some(Run(top)).into_iter().chain(rest.iter().map(|&r| Run(r)))
    }
}

/// A run of so many voxels from the ground up.
#[inline(always)]
pub fn run_of_height(height: u16) -> u32 {
    if height == 0 { EMPTY } else { (u32::from(height) - 1) << 16 }
}

/// Columns that a thread makes at a time, about.
const PART: usize = 1 << 14;

/// A level's rows, some at a time, so that all threads make tables: whole blocks, and enough columns each.
struct Parts {
    nx: usize,
    nz: usize,
    rows: usize,
}

impl Parts {
    fn new(geometry: &Columns) -> Parts {
        let (nx, nz) = (geometry.nx() as usize, geometry.nz() as usize);
        let block = 1 << BLOCK_SHIFT;
        Parts { nx, nz, rows: (PART / nx).max(1).next_multiple_of(block) }
    }

    fn n(&self) -> usize {
        self.nz.div_ceil(self.rows)
    }

    /// Numbers of the columns of a part.
    fn columns(&self, part: usize) -> Range<usize> {
        part * self.rows * self.nx..((part + 1) * self.rows).min(self.nz) * self.nx
    }

    /// How many values each part has.
    fn lens(&self, of: impl Fn(Range<usize>) -> usize + Sync) -> Vec<usize> {
        (0..self.n()).into_par_iter().map(|part| of(self.columns(part))).collect()
    }

    /// A value for each column.
    fn map<T: Zeroable + Send>(&self, what: &str, value: impl Fn(usize) -> T + Sync) -> Result<Vec<T>> {
        let lens = self.lens(|columns| columns.len());
        Ok(filled(&lens, what, |part, out| {
            self.columns(part).zip(out).for_each(|(ix, out)| *out = value(ix));
        })?)
    }
}

/// Whether each column is empty or one run from the ground up, whose height fits 16 bits.
pub fn is_height_field(geometry: &Columns) -> bool {
    let parts = Parts::new(geometry);
    let has_height = |ix| match &geometry.runs()[geometry.range(ix)] {
        [] => true,
        [run] => run.first() == 0 && run.end() <= u32::from(u16::MAX),
        _ => false,
    };
    (0..parts.n()).into_par_iter().all(|part| parts.columns(part).all(has_height))
}

fn height_table(geometry: &Columns) -> Result<Table> {
    let parts = Parts::new(geometry);
    let mut lens = parts.lens(|columns| columns.len());
    lens.push(parts.nx * parts.nz % 2);
    let heights = filled(&lens, "columns", |part, out: &mut [u16]| {
        let columns = if part < parts.n() { parts.columns(part) } else { 0..0 };
        let height = |ix| geometry.runs()[geometry.range(ix)].first().map_or(0, |run| run.end() as u16);
        columns.zip(out).for_each(|(ix, out)| *out = height(ix));
    })?;
    Ok(Table::Heights(heights))
}

fn run_table(geometry: &Columns) -> Result<Table> {
    let parts = Parts::new(geometry);
    let column = |ix| &geometry.runs()[geometry.range(ix)];
    // A column of one run has no word of its own, one of n runs their number and n − 1 of them.
    let words = |ix| if column(ix).len() > 1 { column(ix).len() } else { 0 };
    let mut lens = parts.lens(|columns| columns.map(words).sum());
    lens.insert(0, 1);
    let starts = starts(&lens);
    let n = starts[lens.len()];
    if u32::try_from(n).is_err() {
        return Err(Error::Limit(format!("a level with {n} words of runs, at most 2³² − 1 can be drawn")));
    }
    let lens_of_columns = parts.lens(|columns| columns.len());
    let columns = filled(&lens_of_columns, "columns", |part, out: &mut [[u32; 2]]| {
        let mut at = starts[part + 1];
        for (ix, out) in parts.columns(part).zip(out) {
            let more = if words(ix) > 0 { at as u32 } else { 0 };
            *out = [column(ix).last().map_or(EMPTY, |top| top.0), more];
            at += words(ix);
        }
    })?;
    // Word 0 stays 0.
    let runs = filled(&lens, "runs", |part, mut out: &mut [u32]| {
        let Some(part) = part.checked_sub(1) else { return };
        for ix in parts.columns(part) {
            let Some((_, rest @ [_, ..])) = column(ix).split_last() else { continue };
            let (now, after) = out.split_at_mut(1 + rest.len());
            now[0] = rest.len() as u32;
            now[1..].iter_mut().zip(rest.iter().rev()).for_each(|(out, run)| *out = run.0);
            out = after;
        }
    })?;
    Ok(Table::Runs { columns, runs })
}

/// Height bounds of 8 × 8 columns.
fn blocks(geometry: &Columns) -> Result<Vec<u32>> {
    let parts = Parts::new(geometry);
    let row = parts.nx.div_ceil(1 << BLOCK_SHIFT);
    let lens = parts.lens(|columns| (columns.len() / parts.nx).div_ceil(1 << BLOCK_SHIFT) * row);
    Ok(filled(&lens, "blocks", |part, out: &mut [u32]| {
        out.fill(EMPTY);
        let columns = parts.columns(part);
        for (i, column) in columns.map(|ix| &geometry.runs()[geometry.range(ix)]).enumerate() {
            let [lowest, .., highest] = column else {
                let [run] = column else { continue };
                widen(&mut out[block_of(i, parts.nx, row)], *run, *run);
                continue;
            };
            widen(&mut out[block_of(i, parts.nx, row)], *lowest, *highest);
        }
    })?)
}

/// Number of the block of the `i`th column of a part.
fn block_of(i: usize, nx: usize, row: usize) -> usize {
    ((i / nx) >> BLOCK_SHIFT) * row + ((i % nx) >> BLOCK_SHIFT)
}

pub(crate) fn widen(block: &mut u32, lowest: Run, highest: Run) {
    let (first, last) = (*block as u16, (*block >> 16) as u16);
    *block = u32::from(first.min(lowest.first())) | u32::from(last.max(highest.last())) << 16;
}

/// Number of the first colour of each column, and of all colours.
fn first_voxels(exposed: &Columns) -> Result<Vec<u32>> {
    let parts = Parts::new(exposed);
    let voxels = |ix| exposed.runs()[exposed.range(ix)].iter().map(|run| run.len() as usize).sum::<usize>();
    let starts = starts(&parts.lens(|columns| columns.map(voxels).sum()));
    let n = starts[parts.n()];
    if u32::try_from(n).is_err() {
        return Err(Error::Limit(format!("a level with {n} colours, at most 2³² − 1 can be drawn")));
    }
    let mut lens = parts.lens(|columns| columns.len());
    lens.push(1);
    Ok(filled(&lens, "columns", |part, out: &mut [u32]| {
        let mut at = starts[part];
        out[0] = at as u32;
        let columns = if part < parts.n() { parts.columns(part) } else { 0..0 };
        for (ix, out) in columns.zip(out) {
            *out = at as u32;
            at += voxels(ix);
        }
    })?)
}

/// Whether all voxels of each column have one colour, as those of a map that is laid over heights have.
fn one_color_each(first: &[u32], colors: &[Rgb]) -> bool {
    first.par_windows(2).all(|column| {
        let column = &colors[column[0] as usize..column[1] as usize];
        column.iter().all(|color| *color == column[0])
    })
}

fn column_paint<'a>(geometry: &Columns, color: impl Fn(usize) -> Option<&'a Rgb> + Sync) -> Result<Paint> {
    let colors = Parts::new(geometry).map("colours", |ix| color(ix).map_or(0, |&c| pack_rgb(c)))?;
    Ok(Paint::Column { colors })
}

fn run_paint(geometry: &Columns, colors: &[Rgb]) -> Result<Paint> {
    let parts = Parts::new(geometry);
    let base = parts.map("columns", |ix| geometry.offsets()[ix])?;
    let lens =
        parts.lens(|columns| geometry.offsets()[columns.end] as usize - geometry.offsets()[columns.start] as usize);
    let colors = filled(&lens, "colours", |part, out: &mut [u32]| {
        let of_column = |ix| colors[geometry.range(ix)].iter().rev();
        parts.columns(part).flat_map(of_column).zip(out).for_each(|(&c, out)| *out = pack_rgb(c));
    })?;
    Ok(Paint::Run { base, colors })
}

fn voxel_paint(exposed: &Columns, first: &[u32], colors: &[Rgb]) -> Result<Paint> {
    let parts = Parts::new(exposed);
    let mut lens = parts.lens(|columns| columns.len());
    lens.push(1);
    let base = filled(&lens, "columns", |part, out: &mut [u32]| {
        let start = part * parts.rows * parts.nx;
        let start = start.min(parts.nx * parts.nz);
        out.copy_from_slice(&exposed.offsets()[start..start + out.len()]);
    })?;
    let lens =
        parts.lens(|columns| exposed.offsets()[columns.end] as usize - exposed.offsets()[columns.start] as usize);
    let runs = filled(&lens, "runs", |part, out: &mut [[u32; 2]]| {
        let columns = parts.columns(part);
        let mut at = first[columns.start];
        let runs = exposed.offsets()[columns.start] as usize..exposed.offsets()[columns.end] as usize;
        for (run, out) in exposed.runs()[runs].iter().zip(out) {
            *out = [run.0, at];
            at += run.len();
        }
    })?;
    Ok(Paint::Voxel { base, exposed: runs, colors: packed(colors) })
}

fn packed(colors: &[Rgb]) -> Vec<u32> {
    let mut packed = vec![0; colors.len()];
    packed.par_chunks_mut(PART).zip(colors.par_chunks(PART)).for_each(|(out, colors)| {
        out.iter_mut().zip(colors).for_each(|(out, &c)| *out = pack_rgb(c));
    });
    packed
}

impl Paint {
    /// All colours; where there are none, the one that is shown instead.
    pub fn colors(&self) -> &[u32] {
        match self {
            Paint::None => &[UNPAINTED],
            Paint::Column { colors }
            | Paint::Height { colors }
            | Paint::Top { colors, .. }
            | Paint::Run { colors, .. }
            | Paint::Voxel { colors, .. } => colors,
        }
    }
}

/// Colour of geometry without paint: a light grey that shading can work on.
pub const UNPAINTED: u32 = u32::from_le_bytes([200, 200, 200, 255]);

/// Which of a column's exposed runs (at least one) holds voxel `y` or is nearest below it.
#[inline(always)]
pub fn nearest_exposed(column: &[[u32; 2]], y: u32) -> usize {
    // Most columns have one or two exposed runs, and what is seen is mostly near the top.
    if column.len() > 8 {
        return column.partition_point(|&[run, _]| u32::from(Run(run).first()) <= y).saturating_sub(1);
    }
    let mut k = column.len() - 1;
    while k > 0 && u32::from(Run(column[k][0]).first()) > y {
        k -= 1;
    }
    k
}

#[cfg(test)]
mod tests {
    use super::*;
    use planecast_encoder::{BuildOptions, Colors, Encoding, Input, build};

    fn noise(x: u32, y: u32, z: u32) -> u32 {
        let v = x.wrapping_mul(0x9E37_79B1) ^ y.wrapping_mul(0x85EB_CA77) ^ z.wrapping_mul(0xC2B2_AE3D);
        (v ^ (v >> 15)).wrapping_mul(0x2C1B_3C6D) >> 8
    }

    /// Of several parts, whose sides are no whole blocks.
    fn scene(
        solid: impl Fn(u32, u32, u32) -> bool + Sync,
        encoding: Encoding,
        color: ColorMode,
        draped: bool,
    ) -> Scene {
        let columns = Columns::from_fn(203, 11, 190, solid);
        let of = move |x, y, z| {
            let y = if draped { 0 } else { y };
            noise(x, y, z).to_le_bytes()[..3].try_into().unwrap()
        };
        let input = Input { columns, colors: Colors::Function(Box::new(of)), notes: Vec::new() };
        build(input, &BuildOptions { encoding, color: Some(color), ..BuildOptions::default() }).unwrap()
    }

    /// Each column, block and colour, as the scene's own lists have them.
    fn check(scene: &Scene, features: Features) -> Resident {
        let resident = Resident::with(scene, features);
        for (level, tables) in scene.levels.iter().zip(&resident.levels) {
            let geometry = level.geometry(scene.encoding);
            let shown = level.exposed.as_ref().map(|exposed| (exposed, exposed.voxel_offsets()));
            let mut blocks = vec![EMPTY; tables.blocks.len()];
            for ix in 0..geometry.offsets().len() - 1 {
                let (x, z) = (ix as u32 % geometry.nx(), ix as u32 / geometry.nx());
                let expected: Vec<Run> = geometry.column(x, z).iter().rev().copied().collect();
                assert_eq!(tables.column(ix).collect::<Vec<_>>(), expected);
                let (Some(highest), Some(lowest)) = (expected.first(), expected.last()) else { continue };
                let block =
                    ((z >> BLOCK_SHIFT) * geometry.nx().div_ceil(1 << BLOCK_SHIFT) + (x >> BLOCK_SHIFT)) as usize;
                widen(&mut blocks[block], *lowest, *highest);
                for (k, run) in expected.iter().enumerate() {
                    let color = |y| tables.color(ix, k as u32, y);
                    match scene.color {
                        ColorMode::None => assert_eq!(color(run.first().into()), UNPAINTED),
                        ColorMode::Run => {
                            let at = geometry.range(ix).end - 1 - k;
                            assert_eq!(color(run.first().into()), pack_rgb(level.colors[at]));
                        }
                        ColorMode::Voxel => {
                            let (exposed, first) = shown.as_ref().unwrap();
                            let shown = exposed.column(x, z).iter().flat_map(|r| u32::from(r.first())..r.end());
                            for (at, y) in (first[ix] as usize..).zip(shown) {
                                let inside = (u32::from(run.first())..run.end()).contains(&y);
                                assert!(!inside || color(y) == pack_rgb(level.colors[at]), "column {ix} voxel {y}");
                            }
                        }
                    }
                }
            }
            assert_eq!(tables.blocks, blocks);
            let ends = geometry.runs().iter().map(|r| r.end()).max().unwrap_or(0);
            assert_eq!((tables.top, tables.bottom.min(ends)), (ends, tables.bottom));
        }
        resident
    }

    #[test]
    fn tables_hold_the_scenes_columns_and_colors() {
        let caves = |x, y, z| noise(x / 3, y, z / 3) % 5 < 2;
        let hills = |x: u32, y: u32, z: u32| y <= noise(x / 40, 0, z / 40) % 9;
        for encoding in [Encoding::Solid, Encoding::Surface] {
            for color in [ColorMode::None, ColorMode::Run, ColorMode::Voxel] {
                for draped in [false, true] {
                    check(&scene(caves, encoding, color, draped), Features::ALL);
                }
            }
        }
        for (color, draped) in [(ColorMode::Run, false), (ColorMode::Voxel, false), (ColorMode::Voxel, true)] {
            let hills = scene(hills, Encoding::Solid, color, draped);
            check(&hills, Features::NONE);
            let resident = check(&hills, Features::ALL);
            assert!(resident.heights);
            // Of level 0, whose colours are those of the map itself.
            let one_each = matches!(resident.levels[0].paint, Paint::Column { .. });
            assert_eq!(one_each, draped || color == ColorMode::Run);
            assert_eq!(matches!(resident.levels[0].paint, Paint::Top { .. }), !one_each);
        }
    }
}
