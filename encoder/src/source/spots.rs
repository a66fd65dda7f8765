//! Voxels given one by one, in any order and more than once: what meshes and point clouds become.

use rayon::prelude::*;

use crate::srgb::Mean;
use crate::{Colors, ColumnsBuilder, Input, Rgb, Run};

/// A solid voxel of a piece. The order is that of columns, then of height.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Spot {
    /// Number of the column in the piece.
    pub column: u32,
    pub y: u16,
    pub color: Rgb,
}

/// The piece `dims` whose solid voxels are `spots`. One given several times has the mean of its colours, in linear
/// light; the result does not depend on the order.
pub(super) fn piece(dims: [u32; 3], mut spots: Vec<Spot>, colored: bool) -> Input {
    spots.par_sort_unstable();
    let [nx, ny, nz] = dims;
    let mut columns = ColumnsBuilder::new(nx, ny, nz);
    let (mut offsets, mut entries) = (vec![0u32], Vec::new());
    let mut voxels = spots.chunk_by(|a, b| (a.column, a.y) == (b.column, b.y)).peekable();
    for column in 0..nx * nz {
        while let Some(same) = voxels.next_if(|v| v[0].column == column) {
            let y = same[0].y;
            columns.push_run(Run::new(y, y));
            if colored {
                let mut mean = Mean::default();
                same.iter().for_each(|spot| mean.add(spot.color));
                entries.push((y, mean.get().expect("one spot at least")));
            }
        }
        columns.end_column();
        offsets.push(entries.len() as u32);
    }
    let colors = if colored { Colors::Voxel { offsets, entries } } else { Colors::None };
    Input { columns: columns.finish(), colors, notes: Vec::new() }
}
