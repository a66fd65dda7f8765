//! The Menger sponge: a cube of 3^L, with every voxel hollow that has two or more digits 1 at one place of its
//! base-3 coordinates.

use std::ops::Range;
use std::sync::Arc;

use crate::model::pieces::{RowColors, Rows};
use crate::{About, ColumnsBuilder, Error, Result, Run};

/// 2,187 a side, 1.28 billion voxels.
pub const MAX_LEVEL: u32 = 7;

pub fn make(size: u32) -> Result<Rows> {
    let Some(level) = (0..=MAX_LEVEL).find(|&l| 3u32.pow(l) == size) else {
        return Err(Error::Argument(format!("a Menger sponge of size {size}: expected a power of 3, or level=L")));
    };
    let row = move |xs: Range<u32>, z: u32, columns: &mut ColumnsBuilder| {
        for x in xs {
            // At each place: 2 ones in (x, z) leave nothing, one leaves y's digits 0 and 2, none leaves all.
            let ones = |place: u32| {
                let digit = |v: u32| v / 3u32.pow(place) % 3;
                u32::from(digit(x) == 1) + u32::from(digit(z) == 1)
            };
            if (0..level).all(|place| ones(place) < 2) {
                push(columns, &ones, level, 0);
            }
            columns.end_column();
        }
        Ok(())
    };
    let scale = 215.0 / size as f32;
    let color = move |x: u32, y: u32, z: u32| [x, y, z].map(|v| (40.0 + v as f32 * scale) as u8);
    Ok(Rows {
        dims: [size; 3],
        row: Box::new(row),
        heights: None,
        color: RowColors::Voxel(Arc::new(color)),
        notes: Vec::new(),
        about: About::default(),
        input_bytes: 0,
        water: None,
    })
}

/// The runs of the 3^places voxels from `first` on.
fn push(columns: &mut ColumnsBuilder, ones: &impl Fn(u32) -> u32, places: u32, first: u32) {
    if (0..places).all(|place| ones(place) == 0) {
        return columns.push_run(Run::new(first as u16, (first + 3u32.pow(places) - 1) as u16));
    }
    for digit in 0..3 {
        if digit != 1 || ones(places - 1) == 0 {
            push(columns, ones, places - 1, first + digit * 3u32.pow(places - 1));
        }
    }
}
