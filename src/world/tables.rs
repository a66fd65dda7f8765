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

use crate::frame::specialize::{Feature, Features};
use planecast_encoder::{ColorMode, Columns, Rgb, Run, Scene};
use rayon::prelude::*;

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
    /// Of heights with a colour a voxel: how many colours come before each column's, and in all; else empty. A column's own
    /// colours are those of its topmost voxels and, below those that are hidden, of voxel 0.
    pub column_colors: Vec<u32>,
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
    /// Colour of the one run of column `i`: `colors[i]`. Of a level with heights.
    Column {
        colors: Vec<u32>,
    },
    /// Colour of run `k` (from the top down) of column `i`: `colors[base[i] + k]`.
    Run {
        base: Vec<u32>,
        colors: Vec<u32>,
    },
    /// Column `i` has exposed runs `exposed[base[i] .. base[i+1]]`, ascending, each with the place of its lowest
    /// voxel's colour.
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
    pub color: ColorMode,
    pub levels: Vec<ResidentLevel>,
    /// Whether all levels have heights instead of runs.
    pub heights: bool,
}

/// Packs a colour for the kernels: r in the low byte, alpha 255.
pub fn pack_rgb(c: Rgb) -> u32 {
    u32::from_le_bytes([c[0], c[1], c[2], 255])
}

impl Resident {
    /// The tables with all that the scene does not need left out.
    pub fn new(scene: &Scene) -> Resident {
        Resident::with(scene, Features::ALL)
    }

    /// The tables with nothing left out but what `features` names.
    pub fn with(scene: &Scene, features: Features) -> Resident {
        let heights = features.has(Feature::Heights)
            && scene.levels.par_iter().all(|level| is_height_field(level.geometry(scene.encoding)));
        let levels = scene.levels.par_iter().map(|level| {
            let geometry = level.geometry(scene.encoding);
            let paint = match scene.color {
                ColorMode::None => Paint::None,
                ColorMode::Run if heights => column_paint(geometry, &level.colors),
                ColorMode::Run => run_paint(geometry, &level.colors),
                ColorMode::Voxel => {
                    let exposed = level.exposed.as_ref().expect("voxel colours come with exposed runs");
                    voxel_paint(exposed, &level.colors)
                }
            };
            let column_colors = match (&level.exposed, scene.color) {
                (Some(exposed), ColorMode::Voxel) if heights => {
                    exposed.voxel_offsets().into_iter().map(|n| n as u32).collect()
                }
                _ => Vec::new(),
            };
            ResidentLevel { column_colors, ..resident_level(geometry, paint, heights) }
        });
        Resident { dims: scene.dims(), color: scene.color, levels: levels.collect(), heights }
    }

    /// Bytes that the tables take.
    pub fn bytes(&self) -> u64 {
        let level = |l: &ResidentLevel| {
            let paint = match &l.paint {
                Paint::None => 0,
                Paint::Column { colors } => 4 * colors.len(),
                Paint::Run { base, colors } => 4 * (base.len() + colors.len()),
                Paint::Voxel { base, exposed, colors } => 4 * (base.len() + colors.len()) + 8 * exposed.len(),
            };
            let table = match &l.table {
                Table::Runs { columns, runs } => 8 * columns.len() + 4 * runs.len(),
                Table::Heights(heights) => 2 * heights.len(),
            };
            (table + 4 * (l.blocks.len() + l.column_colors.len()) + paint) as u64
        };
        self.levels.iter().map(level).sum()
    }
}

impl ResidentLevel {
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

/// Whether each column is empty or one run from the ground up, whose height fits 16 bits.
fn is_height_field(geometry: &Columns) -> bool {
    let n = geometry.offsets().len() - 1;
    (0..n).all(|ix| match &geometry.runs()[geometry.range(ix)] {
        [] => true,
        [run] => run.first() == 0 && run.end() <= u32::from(u16::MAX),
        _ => false,
    })
}

fn height_table(geometry: &Columns) -> Table {
    let n = geometry.offsets().len() - 1;
    let height = |ix| geometry.runs()[geometry.range(ix)].first().map_or(0, |run| run.end() as u16);
    Table::Heights((0..n).map(height).chain((n % 2 == 1).then_some(0)).collect())
}

fn run_table(geometry: &Columns) -> Table {
    let n = geometry.offsets().len() - 1;
    let mut columns = Vec::with_capacity(n);
    let mut runs = vec![0];
    for ix in 0..n {
        let column = &geometry.runs()[geometry.range(ix)];
        let Some((top, rest)) = column.split_last() else {
            columns.push([EMPTY, 0]);
            continue;
        };
        let mut more = 0;
        if !rest.is_empty() {
            more = u32::try_from(runs.len()).expect("at most 2³² words of runs a level");
            runs.push(rest.len() as u32);
            runs.extend(rest.iter().rev().map(|r| r.0));
        }
        columns.push([top.0, more]);
    }
    Table::Runs { columns, runs }
}

fn resident_level(geometry: &Columns, paint: Paint, heights: bool) -> ResidentLevel {
    let (nx, nz) = (geometry.nx(), geometry.nz());
    let table = if heights { height_table(geometry) } else { run_table(geometry) };
    let (bx, bz) = (nx.div_ceil(1 << BLOCK_SHIFT), nz.div_ceil(1 << BLOCK_SHIFT));
    let mut blocks = vec![EMPTY; bx as usize * bz as usize];
    let (mut bottom, mut top) = (u32::MAX, 0);
    for z in 0..nz {
        for x in 0..nx {
            let column = geometry.column(x, z);
            let (Some(lowest), Some(highest)) = (column.first(), column.last()) else { continue };
            let block = &mut blocks[((z >> BLOCK_SHIFT) * bx + (x >> BLOCK_SHIFT)) as usize];
            let (first, last) = (*block as u16, (*block >> 16) as u16);
            *block = u32::from(first.min(lowest.first())) | u32::from(last.max(highest.last())) << 16;
            bottom = bottom.min(u32::from(lowest.first()));
            top = top.max(highest.end());
        }
    }
    ResidentLevel { nx, nz, table, blocks, bottom: bottom.min(top), top, paint, column_colors: Vec::new() }
}

fn column_paint(geometry: &Columns, colors: &[Rgb]) -> Paint {
    let n = geometry.offsets().len() - 1;
    let color = |ix| colors[geometry.range(ix)].first().map_or(0, |&c| pack_rgb(c));
    Paint::Column { colors: (0..n).map(color).collect() }
}

fn run_paint(geometry: &Columns, colors: &[Rgb]) -> Paint {
    let n = geometry.offsets().len() - 1;
    let base = geometry.offsets()[..n].to_vec();
    let colors = (0..n).flat_map(|ix| colors[geometry.range(ix)].iter().rev().map(|&c| pack_rgb(c))).collect();
    Paint::Run { base, colors }
}

fn voxel_paint(exposed: &Columns, colors: &[Rgb]) -> Paint {
    let mut at = 0;
    let runs = exposed.runs().iter().map(|r| {
        let start = at;
        at += r.len();
        [r.0, start]
    });
    Paint::Voxel {
        base: exposed.offsets().to_vec(),
        exposed: runs.collect(),
        colors: colors.iter().map(|&c| pack_rgb(c)).collect(),
    }
}

impl Paint {
    /// All colours; where there are none, the one that is shown instead.
    pub fn colors(&self) -> &[u32] {
        match self {
            Paint::None => &[UNPAINTED],
            Paint::Column { colors } | Paint::Run { colors, .. } | Paint::Voxel { colors, .. } => colors,
        }
    }

    /// Colour of voxel `y` (of this level) in run number `k` (from the top down) of column number `ix`. A voxel without
    /// a colour of its own (interior: the eye is inside it) takes that of the nearest exposed run.
    #[inline(always)]
    pub fn color(&self, ix: usize, k: u32, y: u32) -> u32 {
        match self {
            Paint::None => UNPAINTED,
            Paint::Column { colors } => colors[ix],
            Paint::Run { base, colors } => colors[(base[ix] + k) as usize],
            Paint::Voxel { base, exposed, colors } => {
                let column = &exposed[base[ix] as usize..base[ix + 1] as usize];
                if column.is_empty() {
                    return UNPAINTED;
                }
                let [run, start] = column[nearest_exposed(column, y)];
                let (first, last) = (u32::from(Run(run).first()), u32::from(Run(run).last()));
                colors[(start + y.clamp(first, last) - first) as usize]
            }
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
