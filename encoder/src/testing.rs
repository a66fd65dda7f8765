//! Random worlds for the tests of this crate.

use std::collections::BTreeMap;

use bytemuck::pod_read_unaligned;
use proptest::prelude::*;
use xxhash_rust::xxh3::xxh3_64;

use crate::format::{Header, TileEntry};
use crate::{Colors, Columns, ColumnsBuilder, Input, Rgb, Run};

/// Worlds small enough to check voxel by voxel, from sparse to full.
pub fn small_world() -> impl Strategy<Value = Columns> {
    (1u32..7, 1u32..14, 1u32..7, 1u8..=20).prop_flat_map(|(nx, ny, nz, density)| {
        prop::collection::vec(0u8..20, (nx * ny * nz) as usize).prop_map(move |noise| {
            Columns::from_fn(nx, ny, nz, |x, y, z| noise[((z * ny + y) * nx + x) as usize] < density)
        })
    })
}

/// A few columns of the given height, with runs of very unequal lengths.
pub fn tall_world(ny: u32) -> impl Strategy<Value = Columns> {
    let column = prop::collection::vec((1u32..600, prop_oneof![1u32..4, 1u32..600]), 0..300);
    (1u32..4, 1u32..4).prop_flat_map(move |(nx, nz)| {
        prop::collection::vec(column.clone(), (nx * nz) as usize).prop_map(move |columns| {
            let mut out = ColumnsBuilder::new(nx, ny, nz);
            for column in columns {
                let mut y = 0;
                for (gap, len) in column {
                    let (first, last) = (y + gap - 1, y + gap + len - 2);
                    if last >= ny {
                        break;
                    }
                    out.push_run(Run::new(first as u16, last as u16));
                    y = last + 2;
                }
                out.end_column();
            }
            out.finish()
        })
    })
}

/// Columns of any height from the ground up, some of them of equal heights.
pub fn height_field() -> impl Strategy<Value = Columns> {
    (1u32..9, 1u32..7, prop_oneof![1u32..5, 250u32..260, 900u32..1000]).prop_flat_map(|(nx, nz, ny)| {
        prop::collection::vec(prop_oneof![0..=ny, ny - ny.min(4)..=ny], (nx * nz) as usize)
            .prop_map(move |heights| Columns::from_fn(nx, ny, nz, |x, y, z| y < heights[(z * nx + x) as usize]))
    })
}

/// A colour that tells where it comes from.
pub fn color_of(x: u32, y: u32, z: u32) -> Rgb {
    [(x * 37 + 11) as u8, (y * 5 + 3) as u8, (z * 53 + x + 7 * y) as u8]
}

pub fn input(columns: Columns, colored: bool) -> Input {
    let colors = if colored { Colors::Function(Box::new(color_of)) } else { Colors::None };
    Input { columns, colors, notes: Vec::new() }
}

/// The voxels of `columns` as `(x, y, z)`, in the order of colours, with the position of each.
pub fn voxel_positions(columns: &Columns) -> BTreeMap<(u32, u32, u32), usize> {
    let mut positions = BTreeMap::new();
    for z in 0..columns.nz() {
        for x in 0..columns.nx() {
            for run in columns.column(x, z) {
                for y in u32::from(run.first())..run.end() {
                    let n = positions.len();
                    positions.insert((x, y, z), n);
                }
            }
        }
    }
    positions
}

/// Makes every checksum right again, so that what is behind them is reached.
pub fn reseal(bytes: &mut [u8]) {
    let header: Header = pod_read_unaligned(&bytes[..64]);
    let start = header.directory as usize;
    let Some(end) = start.checked_add(48 * header.n_tiles as usize).filter(|&end| end <= bytes.len()) else {
        return;
    };
    for at in (start..end).step_by(48) {
        let entry: TileEntry = pod_read_unaligned(&bytes[at..at + 48]);
        let blob = (entry.offset as usize)
            .checked_add(entry.len as usize)
            .and_then(|end| bytes.get(entry.offset as usize..end));
        if let Some(checksum) = blob.filter(|_| !entry.is_empty()).map(xxh3_64) {
            bytes[at + 8..at + 16].copy_from_slice(&checksum.to_le_bytes());
        }
    }
    let checksum = xxh3_64(&bytes[start..end]);
    bytes[48..56].copy_from_slice(&checksum.to_le_bytes());
    let checksum = xxh3_64(&bytes[..56]);
    bytes[56..64].copy_from_slice(&checksum.to_le_bytes());
}
