//! A scene made ready for drawing: the tables that the kernels read, the same on CPU and GPU.
//!
//! The file's two-level lists are compact but take two dependent look-ups a column. Here the common case, a column
//! whose topmost run decides, costs one 8-byte load (DESIGN: measured to nearly halve the GPU's time):
//!
//! ```text
//! column entry   | top run: first u16, last u16 | more u32 |   8 B a column, z·nx + x
//!                  more = 0: no further run, else a position in `runs`
//! runs           | n | run | run | … n times                   further runs of one column, from the top down
//! block          | lowest first u16, highest last u16 |         bounds of 8 × 8 columns
//! ```

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
    /// Two words a column: the topmost run, and where the others stand.
    pub columns: Vec<[u32; 2]>,
    /// `[n, run × n]` for each column with more than one run. Word 0 is unused, so that 0 can mean "none".
    pub runs: Vec<u32>,
    /// Height bounds of 8 × 8 columns, `⌈nx/8⌉` a row.
    pub blocks: Vec<u32>,
    /// Lowest voxel and one past the highest, in voxels of this level; equal where the level is empty.
    pub bottom: u32,
    pub top: u32,
    pub paint: Paint,
}

/// Colours of one level.
#[derive(Clone, Debug, PartialEq)]
pub enum Paint {
    None,
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
}

/// Packs a colour for the kernels: r in the low byte, alpha 255.
pub fn pack_rgb(c: Rgb) -> u32 {
    u32::from_le_bytes([c[0], c[1], c[2], 255])
}

impl Resident {
    pub fn new(scene: &Scene) -> Resident {
        let levels = scene.levels.par_iter().map(|level| {
            let geometry = level.geometry(scene.encoding);
            let paint = match scene.color {
                ColorMode::None => Paint::None,
                ColorMode::Run => run_paint(geometry, &level.colors),
                ColorMode::Voxel => {
                    let exposed = level.exposed.as_ref().expect("voxel colours come with exposed runs");
                    voxel_paint(exposed, &level.colors)
                }
            };
            resident_level(geometry, paint)
        });
        Resident { dims: scene.dims(), color: scene.color, levels: levels.collect() }
    }

    /// Bytes that the tables take.
    pub fn bytes(&self) -> u64 {
        let level = |l: &ResidentLevel| {
            let paint = match &l.paint {
                Paint::None => 0,
                Paint::Run { base, colors } => 4 * (base.len() + colors.len()),
                Paint::Voxel { base, exposed, colors } => 4 * (base.len() + colors.len()) + 8 * exposed.len(),
            };
            (8 * l.columns.len() + 4 * (l.runs.len() + l.blocks.len()) + paint) as u64
        };
        self.levels.iter().map(level).sum()
    }
}

impl ResidentLevel {
    /// The runs of column number `ix`, from the top down.
    pub fn column(&self, ix: usize) -> impl Iterator<Item = Run> + '_ {
        let [top, more] = self.columns[ix];
        let rest = match more as usize {
            0 => &[][..],
            at => &self.runs[at + 1..at + 1 + self.runs[at] as usize],
        };
        (top != EMPTY).then_some(Run(top)).into_iter().chain(rest.iter().map(|&r| Run(r)))
    }
}

fn resident_level(geometry: &Columns, paint: Paint) -> ResidentLevel {
    let (nx, nz) = (geometry.nx(), geometry.nz());
    let mut columns = Vec::with_capacity(nx as usize * nz as usize);
    let mut runs = vec![0];
    for ix in 0..nx as usize * nz as usize {
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
    ResidentLevel { nx, nz, columns, runs, blocks, bottom: bottom.min(top), top, paint }
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
    /// Colour of voxel `y` (of this level) in run number `k` (from the top down) of column number `ix`. A voxel without
    /// a colour of its own (interior: the eye is inside it) takes that of the nearest exposed run.
    #[inline(always)]
    pub fn color(&self, ix: usize, k: u32, y: u32) -> u32 {
        match self {
            Paint::None => UNPAINTED,
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
