//! Translucent matter: what classes of it there are, and of which each voxel of a column is.
//!
//! A voxel has a *code*, an eighth of a class: 0 is nothing, `8 · k` class `k` (from 1 on), and what lies between is a mixture, as
//! voxels of coarser levels are. Where classes are steps of a value, code `8 · k + e` is `e` eighths of class `k + 1` and the rest
//! of class `k`; where they are materials, code `8 · (k - 1) + e` is `e` eighths of material `k` and nothing else.

use std::ops::Range;
use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;

use crate::{Columns, Error, Result, Rgb, parallel};

/// Codes of a class.
pub const STEPS: u16 = 8;

/// Classes of a scene, at most.
pub const MAX_CLASSES: usize = 256;

/// What passing through a class does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// Takes light along the way and gives its colour instead.
    #[default]
    Volumetric,
    /// Takes light once where it is entered, however thick it is: a pane.
    Surface,
    /// Gives light along the way and takes none.
    Additive,
    /// As volumetric, and shines by itself: no sun changes its colour.
    Emissive,
}

/// One class of matter.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Class {
    pub color: Rgb,
    /// Share of the light that a way of one voxel takes, 0 to 1; of a [`Mode::Surface`], that each entry takes.
    pub opacity: f64,
    #[serde(default)]
    pub mode: Mode,
}

/// The classes of a scene, from class 1 on.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Classes {
    /// Values at the lower end of the first class and the upper end of the last, in the data's own unit; `None` of materials.
    #[serde(default)]
    pub window: Option<[f64; 2]>,
    pub classes: Vec<Class>,
}

impl Classes {
    /// Of water alone.
    pub fn water() -> Arc<Classes> {
        let class = Class { color: [36, 92, 118], opacity: 0.09, mode: Mode::Volumetric };
        Arc::new(Classes { window: None, classes: vec![class] })
    }

    /// The highest code that a voxel can have.
    pub fn max_code(&self) -> u16 {
        self.classes.len() as u16 * STEPS
    }

    /// The value in the middle of class `k` of a window.
    pub fn value(&self, k: usize) -> Option<f64> {
        let [low, high] = self.window?;
        Some(low + (k as f64 - 0.5) / self.classes.len() as f64 * (high - low))
    }

    /// What must hold for the classes of a file; the error says what was allowed.
    pub fn check(&self) -> Result<(), String> {
        let n = self.classes.len();
        if !(1..=MAX_CLASSES).contains(&n) {
            return Err(format!("{n} classes of matter, 1 to {MAX_CLASSES} were expected"));
        }
        if let Some(class) = self.classes.iter().find(|c| !(0.0..=1.0).contains(&c.opacity)) {
            return Err(format!("a class of matter of opacity {}, 0 to 1 was expected", class.opacity));
        }
        match self.window {
            Some([low, high]) if !(low.is_finite() && high.is_finite() && low < high) => {
                Err(format!("a window of matter from {low} to {high}, two numbers that ascend were expected"))
            }
            _ => Ok(()),
        }
    }

    /// The code of a mixture of eight voxels of the level below.
    fn mixed(&self, codes: [u16; 8]) -> u16 {
        if self.window.is_some() {
            // Of all eight: outside the world there is nothing, and a voxel is twice as wide there, too.
            let sum: u32 = codes.iter().map(|&c| u32::from(c)).sum();
            return ((sum + 4) / 8) as u16;
        }
        let material = |code: u16| usize::from((code - 1) / STEPS);
        let extinction = |code: u16| {
            let class = &self.classes[material(code)];
            extinction(class.opacity).max(1e-12) * f64::from((code - 1) % STEPS + 1)
        };
        let all: f64 = codes.iter().filter(|&&c| c > 0).map(|&c| extinction(c)).sum();
        let of = |m: usize| codes.iter().filter(|&&c| c > 0 && material(c) == m).map(|&c| extinction(c)).sum::<f64>();
        let most = codes.iter().filter(|&&c| c > 0).map(|&c| material(c)).max_by(|&a, &b| {
            // The same whatever the order of children.
            of(a).total_cmp(&of(b)).then(b.cmp(&a))
        });
        let Some(m) = most else { return 0 };
        let whole = extinction(m as u16 * STEPS + STEPS);
        let eighths = (all / whole).round().min(f64::from(STEPS)) as u16;
        if eighths == 0 { 0 } else { m as u16 * STEPS + eighths }
    }
}

/// Extinction per voxel of what takes this share of the light in one; at most 10⁹, so that nothing is infinite.
pub fn extinction(opacity: f64) -> f64 {
    (-(-opacity).ln_1p()).min(1e9)
}

/// Voxels of one code: those after the run before up to `last`.
///
/// ```text
///  31       16 15        0
/// |   code    |   last    |
/// ```
#[repr(transparent)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct MatterRun(pub u32);

impl MatterRun {
    pub const fn new(last: u16, code: u16) -> MatterRun {
        MatterRun(last as u32 | (code as u32) << 16)
    }

    /// One past the highest voxel.
    #[inline]
    pub const fn end(self) -> u32 {
        (self.0 & 0xFFFF) + 1
    }

    #[inline]
    pub const fn code(self) -> u16 {
        (self.0 >> 16) as u16
    }
}

/// The matter of `nx × nz` columns of one level, each `ny` high. A column's runs follow each other from voxel 0 up, neighbours of
/// different codes; above the last there is nothing, and the last is not of code 0: equal matter has equal runs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Matter {
    dims: [u32; 3],
    offsets: Vec<u32>,
    runs: Vec<MatterRun>,
}

impl Matter {
    pub fn empty([nx, ny, nz]: [u32; 3]) -> Matter {
        Matter { dims: [nx, ny, nz], offsets: vec![0; nx as usize * nz as usize + 1], runs: Vec::new() }
    }

    /// `[nx, ny, nz]`.
    pub fn dims(&self) -> [u32; 3] {
        self.dims
    }

    pub fn is_empty(&self) -> bool {
        self.runs.is_empty()
    }

    /// Where each column's runs begin, and the last's end.
    pub fn offsets(&self) -> &[u32] {
        &self.offsets
    }

    pub fn runs(&self) -> &[MatterRun] {
        &self.runs
    }

    /// The runs of column number `z · nx + x`.
    #[inline]
    pub fn column(&self, ix: usize) -> &[MatterRun] {
        &self.runs[self.offsets[ix] as usize..self.offsets[ix + 1] as usize]
    }

    /// The code of a voxel; outside there is nothing.
    pub fn at(&self, x: u32, y: u32, z: u32) -> u16 {
        let [nx, ny, nz] = self.dims;
        if x >= nx || y >= ny || z >= nz {
            return 0;
        }
        let column = self.column(z as usize * nx as usize + x as usize);
        column.get(column.partition_point(|r| r.end() <= y)).map_or(0, |r| r.code())
    }

    /// Voxels that hold any.
    pub fn voxels(&self) -> u64 {
        let column = |ix: usize| {
            let mut from = 0;
            self.column(ix).iter().fold(0, |n, run| {
                let len = u64::from(run.end() - from);
                from = run.end();
                if run.code() > 0 { n + len } else { n }
            })
        };
        (0..self.offsets.len() - 1).into_par_iter().map(column).sum()
    }

    pub fn bytes(&self) -> u64 {
        4 * (self.offsets.len() + self.runs.len()) as u64
    }

    /// The columns `xs × zs` as matter of their own.
    pub fn crop(&self, xs: Range<u32>, zs: Range<u32>) -> Matter {
        let [nx, ny, _] = self.dims;
        Matter::gather(ny, xs, zs, |x, z| (Some(self), z as usize * nx as usize + x as usize, nx - x))
    }

    /// Columns put together from pieces, as [`Columns::gather`] does; where there is no piece there is nothing.
    pub fn gather<'a>(
        ny: u32,
        xs: Range<u32>,
        zs: Range<u32>,
        at: impl Fn(u32, u32) -> (Option<&'a Matter>, usize, u32),
    ) -> Matter {
        let mut out = MatterBuilder::new(xs.len() as u32, ny, zs.len() as u32);
        for z in zs {
            let mut x = xs.start;
            while x < xs.end {
                let (from, ix, n) = at(x, z);
                let n = n.min(xs.end - x);
                match from {
                    Some(from) => out.append(from, ix..ix + n as usize),
                    None => (0..n).for_each(|_| out.end_column()),
                }
                x += n;
            }
        }
        out.finish()
    }

    /// Matter made row by row, in parallel.
    pub fn try_from_rows(
        [nx, ny, nz]: [u32; 3],
        row: impl Fn(u32, &mut MatterBuilder) -> Result<()> + Sync,
    ) -> Result<Matter> {
        let rows = (8192 / nx.max(1)).max(1);
        let parts: Vec<Matter> = parallel::try_map(nz.div_ceil(rows) as usize, |part| {
            let part = part as u32;
            let zs = part * rows..nz.min(part.saturating_add(1).saturating_mul(rows));
            let mut out = MatterBuilder::new(nx, ny, zs.len() as u32);
            for z in zs {
                row(z, &mut out)?;
            }
            Ok(out.finish())
        })?;
        Matter::concat([nx, ny, nz], &parts)
    }

    /// Matter of parts that follow each other in z.
    pub fn concat(dims: [u32; 3], parts: &[Matter]) -> Result<Matter> {
        let n: usize = parts.iter().map(|p| p.runs.len()).sum();
        if u32::try_from(n).is_err() {
            return Err(Error::Limit(format!("the world has {n} runs of matter, at most {} can be held", u32::MAX)));
        }
        let mut out = MatterBuilder::new(dims[0], dims[1], dims[2]);
        out.matter.runs.reserve(n);
        parts.iter().for_each(|part| out.append(part, 0..part.offsets.len() - 1));
        Ok(out.finish())
    }

    /// The same without what lies in solid voxels.
    pub fn without(&self, solid: &Columns) -> Matter {
        let [nx, ny, _] = self.dims;
        let row = |z: u32, out: &mut MatterBuilder| {
            for x in 0..nx {
                let (ix, mut at) = (z as usize * nx as usize + x as usize, 0);
                let mut runs = solid.column(x, z).iter().copied().peekable();
                for own in self.column(ix) {
                    while at < own.end() {
                        // Solid runs that end at or below are done with.
                        while runs.next_if(|run| run.end() <= at).is_some() {}
                        let (first, end) = runs.peek().map_or((ny, ny), |run| (u32::from(run.first()), run.end()));
                        let inside = first <= at;
                        let next = own.end().min(if inside { end } else { first });
                        out.push(next - at, if inside { 0 } else { own.code() });
                        at = next;
                    }
                }
                out.end_column();
            }
            Ok(())
        };
        Matter::try_from_rows(self.dims, row).expect("a run can be cut in two by each solid one")
    }

    /// The next coarser level.
    pub fn next(&self, classes: &Classes) -> Matter {
        let [nx, ny, nz] = self.dims;
        let [cx, cy, cz] = self.dims.map(|n| n.div_ceil(2));
        let row = |z: u32, out: &mut MatterBuilder| {
            for x in 0..cx {
                let four = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dz)| {
                    let (x, z) = (2 * x + dx, 2 * z + dz);
                    let inside = x < nx && z < nz;
                    Cursor::new(if inside { self.column(z as usize * nx as usize + x as usize) } else { &[] }, ny)
                });
                halved(four, cy, classes, out);
                out.end_column();
            }
            Ok(())
        };
        Matter::try_from_rows([cx, cy, cz], row).expect("no row fails, and there are fewer runs than below")
    }

    /// The bytes of a tile's matter: the end of each column's runs as u32, then the runs.
    pub fn pack(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(self.bytes() as usize);
        bytes.extend_from_slice(bytemuck::cast_slice(&self.offsets[1..]));
        bytes.extend_from_slice(bytemuck::cast_slice(&self.runs));
        bytes
    }

    /// What [`Matter::pack`] gave, every byte checked; an error names the byte, from the start.
    pub fn unpack(bytes: &[u8], dims: [u32; 3], max_code: u16) -> Result<Matter, (usize, String)> {
        let n_columns = dims[0] as usize * dims[2] as usize;
        if bytes.len() < 4 * n_columns || !bytes.len().is_multiple_of(4) {
            return Err((0, format!("{} bytes of matter, {n_columns} columns take four each at least", bytes.len())));
        }
        let word = |at: usize| u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
        let n_runs = bytes.len() / 4 - n_columns;
        let mut offsets = Vec::with_capacity(n_columns + 1);
        offsets.push(0);
        for ix in 0..n_columns {
            let (end, before) = (word(4 * ix), offsets[ix]);
            if end < before || end as usize > n_runs {
                return Err((
                    4 * ix,
                    format!("matter of column {ix} ends at run {end}, {before} to {n_runs} were expected"),
                ));
            }
            offsets.push(end);
        }
        if offsets[n_columns] as usize != n_runs {
            return Err((0, format!("{n_runs} runs of matter, the columns have {}", offsets[n_columns])));
        }
        let runs: Vec<MatterRun> = (0..n_runs).map(|i| MatterRun(word(4 * (n_columns + i)))).collect();
        for ix in 0..n_columns {
            let range = offsets[ix] as usize..offsets[ix + 1] as usize;
            let (mut end, mut code) = (0, u16::MAX);
            for i in range.clone() {
                let run = runs[i];
                if run.end() <= end || run.end() > dims[1] || run.code() == code || run.code() > max_code {
                    let what = format!(
                        "matter of code {} up to {}, in column {ix}: codes up to {max_code} that change and heights that ascend up \
                         to {} were expected",
                        run.code(),
                        run.end(),
                        dims[1]
                    );
                    return Err((4 * (n_columns + i), what));
                }
                (end, code) = (run.end(), run.code());
            }
            if !range.is_empty() && code == 0 {
                return Err((4 * (n_columns + range.end - 1), format!("nothing on top of the matter of column {ix}")));
            }
        }
        Ok(Matter { dims, offsets, runs })
    }
}

/// The codes of a column from below.
struct Cursor<'a> {
    runs: &'a [MatterRun],
    ny: u32,
}

impl Cursor<'_> {
    fn new(runs: &[MatterRun], ny: u32) -> Cursor<'_> {
        Cursor { runs, ny }
    }

    /// The code of voxel `y`, not below one that was asked for before, and where it ends.
    fn at(&mut self, y: u32) -> (u16, u32) {
        while self.runs.first().is_some_and(|r| r.end() <= y) {
            self.runs = &self.runs[1..];
        }
        self.runs.first().map_or((0, self.ny.next_multiple_of(2)), |r| (r.code(), r.end()))
    }
}

/// Four columns to one of half the height.
fn halved(mut four: [Cursor; 4], height: u32, classes: &Classes, out: &mut MatterBuilder) {
    let mut y = 0;
    while y < height {
        let lower = four.each_mut().map(|c| c.at(2 * y));
        let end = lower.iter().map(|l| l.1).min().expect("of four") / 2;
        if end > y {
            // All four stay the same for a while.
            let codes = lower.map(|l| l.0);
            let [a, b, c, d] = codes;
            out.push(end.min(height) - y, classes.mixed([a, b, c, d, a, b, c, d]));
            y = end;
            continue;
        }
        let upper = four.each_mut().map(|c| c.at(2 * y + 1).0);
        let [a, b, c, d] = lower.map(|l| l.0);
        let [e, f, g, h] = upper;
        out.push(1, classes.mixed([a, b, c, d, e, f, g, h]));
        y += 1;
    }
}

/// Builds [`Matter`] one column after the other, x fastest, then z.
pub struct MatterBuilder {
    matter: Matter,
    /// Voxels of the column under construction.
    at: u32,
}

impl MatterBuilder {
    pub fn new(nx: u32, ny: u32, nz: u32) -> MatterBuilder {
        assert!((1..=65_536).contains(&ny), "columns are 1 to 65,536 high");
        let mut offsets = Vec::with_capacity(nx as usize * nz as usize + 1);
        offsets.push(0);
        MatterBuilder { matter: Matter { dims: [nx, ny, nz], offsets, runs: Vec::new() }, at: 0 }
    }

    /// Puts `n` voxels of a code on the column.
    #[inline]
    pub fn push(&mut self, n: u32, code: u16) {
        if n == 0 {
            return;
        }
        self.at += n;
        debug_assert!(self.at <= self.matter.dims[1]);
        let run = MatterRun::new((self.at - 1) as u16, code);
        let first = *self.matter.offsets.last().expect("offsets start with 0") as usize;
        match self.matter.runs[first..].last_mut() {
            Some(before) if before.code() == code => *before = run,
            _ => self.matter.runs.push(run),
        }
    }

    /// Ends the column under construction and starts the next.
    pub fn end_column(&mut self) {
        let first = *self.matter.offsets.last().expect("offsets start with 0") as usize;
        if self.matter.runs[first..].last().is_some_and(|r| r.code() == 0) {
            self.matter.runs.pop();
        }
        self.at = 0;
        self.matter.offsets.push(u32::try_from(self.matter.runs.len()).expect("at most 2³² − 1 runs a level"));
    }

    /// Whole columns of other matter.
    fn append(&mut self, from: &Matter, columns: Range<usize>) {
        let (first, base) = (from.offsets[columns.start], self.matter.runs.len() as u32);
        let ends = &from.offsets[columns.start + 1..=columns.end];
        self.matter.offsets.extend(ends.iter().map(|end| base + (end - first)));
        self.matter.runs.extend_from_slice(&from.runs[first as usize..from.offsets[columns.end] as usize]);
    }

    pub fn finish(self) -> Matter {
        let [nx, _, nz] = self.matter.dims;
        assert_eq!(self.matter.offsets.len(), nx as usize * nz as usize + 1);
        self.matter
    }
}

/// Matter between the ground and a level: water over columns that end below `level`.
pub fn water(columns: &Columns, level: u32) -> Matter {
    let [nx, ny, nz] = columns.dims();
    let row = |z: u32, out: &mut MatterBuilder| {
        for x in 0..nx {
            let runs = columns.column(x, z);
            let below = runs.partition_point(|run| u32::from(run.first()) < level);
            // A column that has nothing there stands for a hole in the data.
            let ground = below.checked_sub(1).map_or(0, |i| runs[i].end());
            if ground > 0 && ground < level {
                out.push(ground, 0);
                out.push(level.min(ny) - ground, STEPS);
            }
            out.end_column();
        }
        Ok(())
    };
    Matter::try_from_rows([nx, ny, nz], row).expect("two runs a column at most")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn window(n: usize) -> Classes {
        let class = Class { color: [9; 3], opacity: 0.5, mode: Mode::Volumetric };
        Classes { window: Some([0.0, 1.0]), classes: vec![class; n] }
    }

    fn of(dims: [u32; 3], code: impl Fn(u32, u32, u32) -> u16 + Sync) -> Matter {
        Matter::try_from_rows(dims, |z, out| {
            for x in 0..dims[0] {
                (0..dims[1]).for_each(|y| out.push(1, code(x, y, z)));
                out.end_column();
            }
            Ok(())
        })
        .unwrap()
    }

    fn speckled(x: u32, y: u32, z: u32) -> u16 {
        8 * ((x / 3 * 7 + y / 2 * 5 + z * 3) % 11 / 2) as u16
    }

    #[test]
    fn matter_holds_what_it_was_given_and_comes_back_from_its_bytes() {
        let dims = [13, 29, 7];
        let matter = of(dims, speckled);
        for (x, y, z) in (0..13).flat_map(|x| (0..29).flat_map(move |y| (0..7).map(move |z| (x, y, z)))) {
            assert_eq!(matter.at(x, y, z), speckled(x, y, z));
        }
        assert_eq!(Matter::unpack(&matter.pack(), dims, 40), Ok(matter.clone()));
        assert_eq!(matter.crop(2..9, 3..5).at(1, 6, 1), speckled(3, 6, 4));
        let packed = matter.pack();
        assert!(Matter::unpack(&packed[..packed.len() - 4], dims, 40).is_err());
        assert!(Matter::unpack(&packed, dims, 8).unwrap_err().1.contains("codes up to 8"));
        for at in 0..packed.len() {
            let mut wrong = packed.clone();
            wrong[at] ^= 0x5A;
            // Refused, or read as what it says: never a panic, and never the same.
            if let Ok(other) = Matter::unpack(&wrong, dims, 40) {
                assert_ne!(other, matter);
            }
        }
    }

    #[test]
    fn matter_is_not_where_voxels_are_solid() {
        let dims = [13, 29, 7];
        let solid = Columns::from_fn(13, 29, 7, |x, y, z| (x + y / 3 + z) % 4 == 1);
        let cut = of(dims, speckled).without(&solid);
        for (x, y, z) in (0..13).flat_map(|x| (0..29).flat_map(move |y| (0..7).map(move |z| (x, y, z)))) {
            let expected = if solid.find(x, y, z).is_some() { 0 } else { speckled(x, y, z) };
            assert_eq!(cut.at(x, y, z), expected);
        }
    }

    #[test]
    fn coarser_matter_has_the_mean_of_eight_voxels() {
        let classes = window(8);
        let dims = [9, 14, 6];
        let (fine, coarse) = (of(dims, speckled), of(dims, speckled).next(&classes));
        assert_eq!(coarse.dims(), [5, 7, 3]);
        for (x, y, z) in (0..5).flat_map(|x| (0..7).flat_map(move |y| (0..3).map(move |z| (x, y, z)))) {
            let children = (0..8).map(|i| fine.at(2 * x + (i & 1), 2 * y + (i >> 1 & 1), 2 * z + (i >> 2)));
            assert_eq!(coarse.at(x, y, z), (children.sum::<u16>() + 4) / 8, "{x} {y} {z}");
        }
    }

    #[test]
    fn coarser_materials_keep_extinction_under_the_strongest() {
        let class = |opacity| Class { color: [0; 3], opacity, mode: Mode::Volumetric };
        // The second takes twice as much of the light's logarithm.
        let classes = Classes { window: None, classes: vec![class(0.5), class(0.75)] };
        assert_eq!(classes.mixed([8; 8]), 8);
        assert_eq!(classes.mixed([8, 8, 8, 8, 0, 0, 0, 0]), 4);
        assert_eq!(classes.mixed([8, 8, 16, 0, 0, 0, 0, 0]), 4);
        assert_eq!(classes.mixed([16, 16, 8, 8, 0, 0, 0, 0]), 8 + 3);
        assert_eq!(classes.mixed([0; 8]), 0);
    }

    #[test]
    fn water_lies_over_low_ground_alone() {
        let ground = Columns::from_fn(4, 9, 1, |x, y, _| y < [3, 7, 5, 0][x as usize]);
        let water = water(&ground, 5);
        let codes = |x| (0..9).map(|y| water.at(x, y, 0)).collect::<Vec<_>>();
        assert_eq!(codes(0), [0, 0, 0, 8, 8, 0, 0, 0, 0]);
        assert!([1, 2, 3].into_iter().all(|x| codes(x) == [0; 9]));
        assert_eq!(water.voxels(), 2);
    }
}
