//! All columns of one level, as flat run lists.

use std::ops::Range;

use crate::model::filled::{filled, starts};
use crate::{Error, Result, Run, parallel};

/// The run lists of `nx × nz` columns, each `ny` high. Column `(x, z)` is number `z·nx + x`; its runs ascend, do
/// not overlap and do not touch (the encoding is maximal, so equal occupancy gives equal runs).
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct Columns {
    nx: u32,
    ny: u32,
    nz: u32,
    /// `nx·nz + 1` positions in `runs`.
    offsets: Vec<u32>,
    runs: Vec<Run>,
}

impl Columns {
    /// Columns from their parts. Panics where the parts contradict each other: importers and readers build
    /// through [`ColumnsBuilder`] or validate first.
    pub fn from_parts(nx: u32, ny: u32, nz: u32, offsets: Vec<u32>, runs: Vec<Run>) -> Columns {
        assert!(ny <= 65_536, "columns are at most 65,536 high");
        assert_eq!(offsets.len() as u64, u64::from(nx) * u64::from(nz) + 1);
        assert_eq!(offsets.last().copied(), Some(runs.len() as u32));
        Columns { nx, ny, nz, offsets, runs }
    }

    /// A world without one solid voxel.
    pub fn empty(nx: u32, ny: u32, nz: u32) -> Columns {
        Columns::from_parts(nx, ny, nz, vec![0; nx as usize * nz as usize + 1], Vec::new())
    }

    pub fn nx(&self) -> u32 {
        self.nx
    }

    pub fn ny(&self) -> u32 {
        self.ny
    }

    pub fn nz(&self) -> u32 {
        self.nz
    }

    /// Columns made row by row, in parallel: `row(z, out)` ends the `nx` columns of row `z`.
    pub fn from_rows(nx: u32, ny: u32, nz: u32, row: impl Fn(u32, &mut ColumnsBuilder) + Sync) -> Columns {
        let columns = Columns::try_from_rows([nx, ny, nz], |z, out| {
            row(z, out);
            Ok(())
        });
        columns.expect("at most 2³² − 1 runs a level")
    }

    /// The same for rows that can fail.
    pub fn try_from_rows(
        [nx, ny, nz]: [u32; 3],
        row: impl Fn(u32, &mut ColumnsBuilder) -> Result<()> + Sync,
    ) -> Result<Columns> {
        // Enough columns a part that handing it out costs nothing beside making it.
        let rows = (8192 / nx.max(1)).max(1);
        let parts: Vec<Columns> = parallel::try_map(nz.div_ceil(rows) as usize, |part| {
            let part = part as u32;
            let z = part * rows..nz.min(part.saturating_add(1).saturating_mul(rows));
            let mut out = ColumnsBuilder::new(nx, ny, z.end - z.start);
            for z in z {
                row(z, &mut out)?;
            }
            Ok(out.finish())
        })?;
        Columns::concat([nx, ny, nz], &parts)
    }

    /// One world from parts that follow each other in z.
    pub(crate) fn concat([nx, ny, nz]: [u32; 3], parts: &[Columns]) -> Result<Columns> {
        let n_runs: usize = parts.iter().map(|p| p.runs.len()).sum();
        if u32::try_from(n_runs).is_err() {
            return Err(Error::Limit(format!("the world has {n_runs} runs, at most {} can be held", u32::MAX)));
        }
        let n_runs: Vec<usize> = parts.iter().map(|p| p.runs.len()).collect();
        let starts = starts(&n_runs);
        // The first offset is 0 and no column's end.
        let ends: Vec<usize> = std::iter::once(1).chain(parts.iter().map(|p| p.offsets.len() - 1)).collect();
        let offsets = filled(&ends, "columns", |i, out: &mut [u32]| {
            let Some(i) = i.checked_sub(1) else { return };
            let base = starts[i] as u32;
            out.iter_mut().zip(&parts[i].offsets[1..]).for_each(|(out, o)| *out = base + o);
        })?;
        let runs = filled(&n_runs, "runs", |i, out| out.copy_from_slice(&parts[i].runs))?;
        Ok(Columns::from_parts(nx, ny, nz, offsets, runs))
    }

    /// Columns of the voxels `(x, y, z)` for which `solid` holds.
    pub fn from_fn(nx: u32, ny: u32, nz: u32, solid: impl Fn(u32, u32, u32) -> bool + Sync) -> Columns {
        Columns::from_rows(nx, ny, nz, |z, out| {
            for x in 0..nx {
                for y in (0..ny).filter(|&y| solid(x, y, z)) {
                    out.push_run(Run::new(y as u16, y as u16));
                }
                out.end_column();
            }
        })
    }

    /// `[nx, ny, nz]`.
    pub fn dims(&self) -> [u32; 3] {
        [self.nx, self.ny, self.nz]
    }

    /// Start of each column in [`Columns::runs`], and the end of the last.
    pub fn offsets(&self) -> &[u32] {
        &self.offsets
    }

    /// All runs, column by column.
    pub fn runs(&self) -> &[Run] {
        &self.runs
    }

    /// Number of column `(x, z)`.
    #[inline]
    pub fn index(&self, x: u32, z: u32) -> usize {
        z as usize * self.nx as usize + x as usize
    }

    /// Where the runs of column number `ix` stand in [`Columns::runs`].
    #[inline]
    pub fn range(&self, ix: usize) -> Range<usize> {
        self.offsets[ix] as usize..self.offsets[ix + 1] as usize
    }

    /// The runs of column `(x, z)`, lowest first.
    #[inline]
    pub fn column(&self, x: u32, z: u32) -> &[Run] {
        &self.runs[self.range(self.index(x, z))]
    }

    /// The run of column `(x, z)` that holds voxel `y`, as a position in [`Columns::runs`].
    pub fn find(&self, x: u32, y: u32, z: u32) -> Option<usize> {
        let range = self.range(self.index(x, z));
        let start = range.start;
        let column = &self.runs[range];
        let after = column.partition_point(|r| u32::from(r.first()) <= y);
        (after > 0 && column[after - 1].end() > y).then(|| start + after - 1)
    }

    /// Whether voxel `(x, y, z)` is solid; outside the world nothing is.
    pub fn solid(&self, x: i64, y: i64, z: i64) -> bool {
        let inside = |v: i64, n: u32| (0..i64::from(n)).contains(&v);
        inside(x, self.nx)
            && inside(y, self.ny)
            && inside(z, self.nz)
            && self.find(x as u32, y as u32, z as u32).is_some()
    }

    /// The columns `xs × zs` as a world of their own.
    pub fn crop(&self, xs: Range<u32>, zs: Range<u32>) -> Columns {
        Columns::gather(self.ny, xs, zs, |x, z| (self, z as usize * self.nx as usize + x as usize, self.nx - x))
    }

    /// Columns put together from pieces: `at(x, z)` is where column `(x, z)` stands: in which columns, as which
    /// number, and how many columns from there on continue its row.
    pub fn gather<'a>(
        ny: u32,
        xs: Range<u32>,
        zs: Range<u32>,
        at: impl Fn(u32, u32) -> (&'a Columns, usize, u32),
    ) -> Columns {
        let (nx, nz) = (xs.len() as u32, zs.len() as u32);
        let mut offsets = Vec::with_capacity(xs.len() * zs.len() + 1);
        let mut runs: Vec<Run> = Vec::new();
        offsets.push(0);
        for z in zs {
            let mut x = xs.start;
            while x < xs.end {
                let (from, ix, n) = at(x, z);
                let n = n.min(xs.end - x);
                let part = &from.offsets[ix..=ix + n as usize];
                let base = u32::try_from(runs.len()).expect("at most 2³² − 1 runs a level");
                offsets.extend(part[1..].iter().map(|o| base + (o - part[0])));
                runs.extend_from_slice(&from.runs[part[0] as usize..part[n as usize] as usize]);
                x += n;
            }
        }
        Columns::from_parts(nx, ny, nz, offsets, runs)
    }

    /// Bytes in memory.
    pub fn bytes(&self) -> u64 {
        4 * (self.offsets.capacity() + self.runs.capacity()) as u64
    }

    /// Number of solid voxels.
    pub fn voxels(&self) -> u64 {
        self.runs.iter().map(|r| u64::from(r.len())).sum()
    }

    /// Number of solid voxels before each column, and in all: `nx·nz + 1` entries. Where the columns hold exposed
    /// voxels, the position of each column's first colour.
    pub fn voxel_offsets(&self) -> Vec<u64> {
        let mut offsets = Vec::with_capacity(self.offsets.len());
        let mut n = 0;
        offsets.push(n);
        for column in self.offsets.windows(2) {
            n += self.runs[column[0] as usize..column[1] as usize].iter().map(|r| u64::from(r.len())).sum::<u64>();
            offsets.push(n);
        }
        offsets
    }
}

/// Builds [`Columns`] one column after the other, x fastest, then z.
pub struct ColumnsBuilder {
    columns: Columns,
}

impl ColumnsBuilder {
    pub fn new(nx: u32, ny: u32, nz: u32) -> ColumnsBuilder {
        assert!((1..=65_536).contains(&ny), "columns are 1 to 65,536 high");
        let mut offsets = Vec::with_capacity(nx as usize * nz as usize + 1);
        offsets.push(0);
        ColumnsBuilder { columns: Columns { nx, ny, nz, offsets, runs: Vec::new() } }
    }

    /// Adds a run to the column under construction. Runs come lowest first; one that touches or overlaps the run
    /// before it is merged with it.
    #[inline]
    pub fn push_run(&mut self, run: Run) {
        let c = &mut self.columns;
        debug_assert!(run.end() <= c.ny);
        let column_start = *c.offsets.last().expect("offsets start with 0") as usize;
        if c.runs.len() > column_start {
            let before = c.runs.last_mut().expect("the column has a run");
            debug_assert!(before.first() <= run.first());
            if u32::from(run.first()) <= before.end() {
                *before = Run::new(before.first(), before.last().max(run.last()));
                return;
            }
        }
        c.runs.push(run);
    }

    /// Ends the column under construction and starts the next.
    #[inline]
    pub fn end_column(&mut self) {
        let n = u32::try_from(self.columns.runs.len()).expect("at most 2³² − 1 runs a level");
        self.columns.offsets.push(n);
    }

    /// All columns; panics if fewer or more than `nx·nz` were ended.
    pub fn finish(self) -> Columns {
        let Columns { nx, ny, nz, offsets, runs } = self.columns;
        Columns::from_parts(nx, ny, nz, offsets, runs)
    }
}
