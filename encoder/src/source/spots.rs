//! Voxels given one by one, in any order and more than once: what meshes and point clouds become.

use rayon::prelude::*;

use crate::model::srgb::Mean;
use crate::{Colors, ColumnsBuilder, Input, Rgb, Run};

/// A solid voxel of a piece. The order is that of columns, then of height.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Spot {
    /// Number of the column in the piece.
    pub column: u32,
    pub y: u16,
    pub color: Rgb,
}

/// Voxels of a column of a piece that are solid without a colour of their own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Filled {
    pub column: u32,
    pub run: Run,
}

/// The piece `dims` whose solid voxels are `spots`. One given several times has the mean of its colours, in linear
/// light; the result does not depend on the order.
pub(super) fn piece(dims: [u32; 3], spots: Vec<Spot>, colored: bool) -> Input {
    piece_filled(dims, spots, &[], colored)
}

/// The same, and solid where `filled`, whose columns and runs ascend, says so.
pub(super) fn piece_filled(dims: [u32; 3], mut spots: Vec<Spot>, filled: &[Filled], colored: bool) -> Input {
    spots.par_sort_unstable();
    let [nx, ny, nz] = dims;
    let mut columns = ColumnsBuilder::new(nx, ny, nz);
    let (mut offsets, mut entries) = (vec![0u32], Vec::new());
    let mut voxels = spots.chunk_by(|a, b| (a.column, a.y) == (b.column, b.y)).peekable();
    let mut filled = filled.iter().peekable();
    for column in 0..nx * nz {
        while let Some(same) = voxels.next_if(|v| v[0].column == column) {
            let y = same[0].y;
            while let Some(below) = filled.next_if(|f| f.column == column && f.run.first() <= y) {
                columns.push_run(below.run);
            }
            columns.push_run(Run::new(y, y));
            if colored {
                let mut mean = Mean::default();
                same.iter().for_each(|spot| mean.add(spot.color));
                entries.push((y, mean.get().expect("one spot at least")));
            }
        }
        while let Some(above) = filled.next_if(|f| f.column == column) {
            columns.push_run(above.run);
        }
        columns.end_column();
        offsets.push(entries.len() as u32);
    }
    let colors = if colored { Colors::Voxel { offsets, entries } } else { Colors::None };
    Input { columns: columns.finish(), colors, notes: Vec::new() }
}
