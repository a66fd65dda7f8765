//! Tiles of a density.

use std::ops::Range;

use super::{Area, Cells, Density, Interval, SIDE, Spot, height, middle};
use crate::model::exposure;
use crate::{ColorMode, Columns, ColumnsBuilder, Level, Rgb, Run};

/// Columns of a block along x and z, and voxels of one along y that are evaluated together.
const BLOCK: u32 = 16;
const LEAF: u32 = 32;

/// Columns `xs × zs` of a level, with colours.
pub fn level(density: &dyn Density, level: u32, xs: Range<u32>, zs: Range<u32>) -> Level {
    let area = Area { level, from: [xs.start, zs.start], size: [xs.len() as u32, zs.len() as u32] };
    let around = Area { from: area.from.map(|v| v.wrapping_sub(1)), size: area.size.map(|n| n + 2), ..area };
    match density.is_height_field().then(|| density.heights(&around)).flatten() {
        Some(heights) => of_heights(density, &area, &heights),
        None => of_values(density, level, xs, zs),
    }
}

fn ny(density: &dyn Density, level: u32) -> u32 {
    density.height().div_ceil(1 << level.min(31))
}

/// From the heights of an area with one column more on each side.
fn of_heights(density: &dyn Density, area: &Area, heights: &[u16]) -> Level {
    let ny = ny(density, area.level);
    let [width, depth] = area.size.map(|n| n as usize);
    let mut offsets = Vec::with_capacity(width * depth + 1);
    offsets.push(0);
    let mut runs = Vec::with_capacity(width * depth);
    let colored = density.color_mode() != ColorMode::None;
    let mut colors = if colored { density.top_colors(area, heights) } else { Vec::new() };
    let mut holes = false;
    for row in heights.chunks_exact(width + 2).skip(1).take(depth) {
        for &height in &row[1..=width] {
            match height {
                0 => holes = true,
                _ => runs.push(Run::new(0, (u32::from(height).min(ny) - 1) as u16)),
            }
            offsets.push(runs.len() as u32);
        }
    }
    if holes && colored {
        let mut column = 0;
        colors.retain(|_| {
            column += 1;
            offsets[column] > offsets[column - 1]
        });
    }
    let solid = Columns::from_parts(area.size[0], ny, area.size[1], offsets, runs);
    Level { solid, exposed: None, colors, matter: None }
}

fn of_values(density: &dyn Density, level: u32, xs: Range<u32>, zs: Range<u32>) -> Level {
    let mode = density.color_mode();
    // What is beside the world is air, so that its sides are exposed.
    let side = (SIDE >> level.min(30)).max(1);
    let around = |r: &Range<u32>| r.start.saturating_sub(1)..side.min(r.end + 1);
    let (axs, azs) = match mode {
        ColorMode::None => (xs.clone(), zs.clone()),
        _ => (around(&xs), around(&zs)),
    };
    let inner = |r: &Range<u32>, a: &Range<u32>| r.start - a.start..r.end - a.start;
    let all = columns(density, level, axs.clone(), azs.clone());
    if mode == ColorMode::None {
        return Level { solid: all, exposed: None, colors: Vec::new(), matter: None };
    }
    let (ixs, izs) = (inner(&xs, &axs), inner(&zs, &azs));
    let solid = all.crop(ixs.clone(), izs.clone());
    let mut spots = Spots { density, level, all: &all, from: [axs.start, azs.start] };
    if mode == ColorMode::Run {
        let mut colors = Vec::with_capacity(solid.runs().len());
        for (x, z) in izs.flat_map(|z| ixs.clone().map(move |x| (x, z))) {
            colors.extend(all.column(x, z).iter().map(|run| spots.color(x, z, *run, run.last().into())));
        }
        return Level { solid, exposed: None, colors, matter: None };
    }
    let exposed = exposure::exposed_by_one(&all).crop(ixs.clone(), izs.clone());
    let mut colors = Vec::with_capacity(exposed.runs().len());
    for (x, z) in izs.clone().flat_map(|z| ixs.clone().map(move |x| (x, z))) {
        let mut runs = all.column(x, z).iter();
        let mut run = runs.next();
        for shown in exposed.column(x - ixs.start, z - izs.start) {
            while run.is_some_and(|run| run.last() < shown.first()) {
                run = runs.next();
            }
            let run = *run.expect("what is exposed is solid");
            colors.extend((u32::from(shown.first())..shown.end()).map(|y| spots.color(x, z, run, y)));
        }
    }
    Level { solid, exposed: Some(exposed), colors, matter: None }
}

struct Spots<'a> {
    density: &'a dyn Density,
    level: u32,
    all: &'a Columns,
    from: [u32; 2],
}

impl Spots<'_> {
    fn color(&mut self, x: u32, z: u32, run: Run, y: u32) -> Rgb {
        let depth = (u32::from(run.last()) - y).checked_shl(self.level).unwrap_or(0);
        let above = i64::from(y) + 3;
        let higher = |dx: i64, dz: i64| self.all.solid(i64::from(x) + dx, above, i64::from(z) + dz);
        let steep = depth < 6 && (higher(1, 0) || higher(-1, 0) || higher(0, 1) || higher(0, -1));
        let [i, j] = [self.from[0] + x, self.from[1] + z].map(|v| middle(v, self.level));
        let at = [i, height(y, self.level), j];
        self.density.color(&Spot { level: self.level, at, depth, steep })
    }
}

/// The columns of a level, evaluated where bounds do not tell.
pub fn columns(density: &dyn Density, level: u32, xs: Range<u32>, zs: Range<u32>) -> Columns {
    let (ny, n_shared) = (ny(density, level), density.n_shared());
    let area = Area { level, from: [xs.start, zs.start], size: [xs.len() as u32, zs.len() as u32] };
    let shared = density.shared(&area);
    assert_eq!(shared.len(), n_shared * xs.len() * zs.len(), "numbers of columns that were promised");
    let words = ny.div_ceil(64) as usize;
    let mut out = ColumnsBuilder::new(area.size[0], ny, area.size[1]);
    let mut block = Block { density, bits: Vec::new(), values: Vec::new(), words };
    let mut of_block = Vec::new();
    for z in (0..area.size[1]).step_by(BLOCK as usize) {
        let depth = BLOCK.min(area.size[1] - z);
        let mut row: Vec<Vec<Run>> = vec![Vec::new(); depth as usize];
        let mut ends: Vec<Vec<u32>> = vec![Vec::new(); depth as usize];
        for x in (0..area.size[0]).step_by(BLOCK as usize) {
            let width = BLOCK.min(area.size[0] - x);
            of_block.clear();
            for j in z..z + depth {
                let at = (j * area.size[0] + x) as usize * n_shared;
                of_block.extend_from_slice(&shared[at..at + width as usize * n_shared]);
            }
            let cells = Cells { level, from: [xs.start + x, 0, zs.start + z], size: [width, ny, depth] };
            block.bits.clear();
            block.bits.resize((width * depth) as usize * words, 0);
            block.look(&of_block, cells);
            for (i, bits) in block.bits.chunks_exact(words).enumerate() {
                let j = i / width as usize;
                push_runs(bits, ny, &mut row[j]);
                ends[j].push(row[j].len() as u32);
            }
        }
        for (runs, ends) in row.iter().zip(&ends) {
            let mut from = 0;
            for &end in ends {
                runs[from as usize..end as usize].iter().for_each(|&run| out.push_run(run));
                out.end_column();
                from = end;
            }
        }
    }
    out.finish()
}

/// A few columns under evaluation.
struct Block<'a> {
    density: &'a dyn Density,
    /// A bit a voxel, `words` words a column.
    bits: Vec<u64>,
    values: Vec<i32>,
    words: usize,
}

impl Block<'_> {
    /// Sets the bits of what is solid in `cells`, which may be higher than what is evaluated together.
    fn look(&mut self, shared: &[i32], cells: Cells) {
        let [width, height, depth] = cells.size;
        let Interval { least, most } = self.density.bounds_in(shared, &cells);
        if most <= 0 {
            return;
        }
        if least > 0 {
            for bits in self.bits.chunks_exact_mut(self.words) {
                set(bits, cells.from[1], cells.from[1] + height);
            }
            return;
        }
        if height > LEAF {
            let half = (height.div_ceil(2)).next_multiple_of(LEAF).min(height);
            let low = Cells { size: [width, half, depth], ..cells };
            self.look(shared, low);
            if half < height {
                let [x, y, z] = cells.from;
                self.look(shared, Cells { from: [x, y + half, z], size: [width, height - half, depth], ..cells });
            }
            return;
        }
        self.values.clear();
        self.values.resize((width * height * depth) as usize, 0);
        self.density.fill(shared, &cells, &mut self.values);
        for (bits, values) in self.bits.chunks_exact_mut(self.words).zip(self.values.chunks_exact(height as usize)) {
            let mut solid = 0u64;
            for (i, &v) in values.iter().enumerate() {
                solid |= u64::from(v > 0) << i;
            }
            // A leaf lies in one word: words are a whole number of leaves.
            bits[cells.from[1] as usize / 64] |= solid << (cells.from[1] % 64);
        }
    }
}

fn set(bits: &mut [u64], from: u32, to: u32) {
    for (i, word) in bits.iter_mut().enumerate().take(to.div_ceil(64) as usize).skip(from as usize / 64) {
        let at = i as u32 * 64;
        let (low, high) = (from.max(at) - at, to.min(at + 64) - at);
        *word |= (u64::MAX >> (64 - (high - low))) << low;
    }
}

/// The runs of a column's bits.
fn push_runs(bits: &[u64], ny: u32, runs: &mut Vec<Run>) {
    let mut first = None;
    let mut before = 0;
    for (i, &word) in bits.iter().enumerate() {
        let mut changed = word ^ (word << 1 | before);
        before = word >> 63;
        while changed != 0 {
            let y = i as u32 * 64 + changed.trailing_zeros();
            match first.take() {
                None => first = Some(y),
                Some(from) => runs.push(Run::new(from as u16, (y - 1) as u16)),
            }
            changed &= changed - 1;
        }
    }
    if let Some(from) = first {
        runs.push(Run::new(from as u16, (ny - 1) as u16));
    }
}
