//! Voxels of models as editors store them: each with a place and a colour of its own, the last one at a place showing.

use std::path::Path;

use rayon::prelude::*;

use super::spots::Spot;
use super::world_dims;
use crate::model::pieces::InMemory;
use crate::{About, Colors, ColumnsBuilder, Error, Input, Result, Rgb, Run};

/// Most columns of a model: few bytes can place two voxels very far apart. Fuzzing wants many small models.
const MAX_COLUMNS: u64 = if cfg!(fuzzing) { 1 << 14 } else { 1 << 26 };
/// Columns, and columns a voxel, beyond which parts that a file places lie too far apart to be meant so.
const MANY_COLUMNS: u64 = 1 << 22;
const COLUMNS_A_VOXEL: u64 = 1024;
/// Most voxels of formats that can say many in a few bytes.
const MAX_PLACED: usize = if cfg!(fuzzing) { 1 << 14 } else { 1 << 26 };

/// Checks that a model of `sides` (x, y up, z) can be held.
pub(super) fn dims(path: &Path, sides: [u64; 3]) -> Result<[u32; 3]> {
    let dims = world_dims(path, sides, "its parts lie too far apart")?;
    let [nx, _, nz] = sides;
    if nx * nz > MAX_COLUMNS {
        let what = format!("{nx} × {nz} columns, at most {MAX_COLUMNS} in a model; its parts lie too far apart");
        return Err(Error::Limit(format!("{}: {what}", path.display())));
    }
    Ok(dims)
}

/// The model of `spots`, the last of which shows where there are several at a voxel, and of runs `inside`, by their columns,
/// that are solid without colours of their own.
pub(super) fn input(dims: [u32; 3], mut spots: Vec<Spot>, mut inside: Vec<(u32, Run)>) -> Input {
    spots.par_sort_by_key(|s| (s.column, s.y));
    inside.sort_unstable_by_key(|(column, run)| (*column, run.first()));
    let [nx, ny, nz] = dims;
    let mut columns = ColumnsBuilder::new(nx, ny, nz);
    let (mut offsets, mut entries) = (Vec::with_capacity((nx * nz) as usize + 1), Vec::new());
    offsets.push(0u32);
    let colored = !spots.is_empty();
    let (mut spots, mut inside) = (spots.into_iter().peekable(), inside.into_iter().peekable());
    for column in 0..nx * nz {
        loop {
            let run = inside.peek().filter(|(of, _)| *of == column).map(|&(_, run)| run);
            let spot = spots.next_if(|s| s.column == column && run.is_none_or(|run| s.y <= run.first()));
            if let Some(Spot { y, color, .. }) = spot {
                if spots.peek().is_none_or(|next| (next.column, next.y) != (column, y)) {
                    columns.push_run(Run::new(y, y));
                    entries.push((y, color));
                }
            } else if let Some(run) = run {
                inside.next();
                columns.push_run(run);
            } else {
                break;
            }
        }
        columns.end_column();
        offsets.push(entries.len() as u32);
    }
    let colors = if colored { Colors::Voxel { offsets, entries } } else { Colors::None };
    Input { columns: columns.finish(), colors, notes: Vec::new() }
}

/// Voxels anywhere, in right-handed axes with y up.
#[derive(Default)]
pub(super) struct Placed {
    voxels: Vec<([i32; 3], Rgb)>,
    /// The box that is shown: of all parts, empty ones too.
    low: Option<[i64; 3]>,
    high: [i64; 3],
}

impl Placed {
    /// Widens the box by cells `low ..= high`.
    pub fn part(&mut self, low: [i64; 3], high: [i64; 3]) {
        let before = self.low.unwrap_or(low);
        self.high = if self.low.is_none() { high } else { [0, 1, 2].map(|a| self.high[a].max(high[a])) };
        self.low = Some([0, 1, 2].map(|a| before[a].min(low[a])));
    }

    pub fn push(&mut self, path: &Path, at: [i64; 3], color: Rgb) -> Result<()> {
        let far = |v: i64| i32::try_from(v).map_err(|_| Error::format(path, format!("a voxel lies at {at:?}")));
        let at = [far(at[0])?, far(at[1])?, far(at[2])?];
        if self.voxels.len() == MAX_PLACED {
            let what = format!("more than {MAX_PLACED} voxels; give it as a volume (NPY, NRRD)");
            return Err(Error::Limit(format!("{}: {what}", path.display())));
        }
        self.voxels.push((at, color));
        Ok(())
    }

    pub fn len(&self) -> usize {
        self.voxels.len()
    }

    /// The model, as large as the box of its parts. None where there is no part.
    pub fn model(self, path: &Path, about: About) -> Result<Option<InMemory>> {
        let Some(low) = self.low else { return Ok(None) };
        let sides = [0, 1, 2].map(|a| (self.high[a] - low[a] + 1) as u64);
        let dims = dims(path, sides)?;
        let columns = sides[0] * sides[2];
        if columns > MANY_COLUMNS && columns / COLUMNS_A_VOXEL > self.voxels.len() as u64 {
            let what = format!(
                "{} × {} columns for {} voxels; its parts lie too far apart",
                sides[0],
                sides[2],
                self.voxels.len()
            );
            return Err(Error::Limit(format!("{}: {what}", path.display())));
        }
        let spot = |&(at, color): &([i32; 3], Rgb)| {
            let [x, y, z] = [0, 1, 2].map(|a| (i64::from(at[a]) - low[a]) as u32);
            Spot { column: z * dims[0] + x, y: y as u16, color }
        };
        let spots = self.voxels.iter().map(spot).collect();
        drop(self.voxels);
        Ok(Some(InMemory::new(input(dims, spots, Vec::new())).about(about)))
    }
}
