//! Tiles of a density.

use std::ops::Range;

use super::{Area, Density, SIDE};
use crate::{ColorMode, Columns, Level, Result, Run};

/// Columns `xs × zs` of a level, with colours.
pub fn level(density: &dyn Density, level: u32, xs: Range<u32>, zs: Range<u32>) -> Result<Level> {
    let area = Area { level, from: [xs.start, zs.start], size: [xs.len() as u32, zs.len() as u32] };
    let ny = density.height().div_ceil(1 << level.min(31));
    let around = Area { from: area.from.map(|v| v.wrapping_sub(1)), size: area.size.map(|n| n + 2), ..area };
    let heights = density.heights(&around).expect("height fields alone so far");
    let width = around.size[0] as usize;
    let inner = || heights.chunks_exact(width).skip(1).take(zs.len()).map(|row| &row[1..width - 1]);
    let mut offsets = Vec::with_capacity(xs.len() * zs.len() + 1);
    offsets.push(0);
    let mut runs = Vec::with_capacity(xs.len() * zs.len());
    for &height in inner().flatten() {
        if height > 0 {
            runs.push(Run::new(0, (u32::from(height).min(ny) - 1) as u16));
        }
        offsets.push(runs.len() as u32);
    }
    let colors = match density.color_mode() {
        ColorMode::None => Vec::new(),
        _ => density.top_colors(&area, &heights),
    };
    debug_assert!(colors.len() == runs.len() && xs.end <= SIDE && zs.end <= SIDE);
    let solid = Columns::from_parts(area.size[0], ny, area.size[1], offsets, runs);
    Ok(Level { solid, exposed: None, colors })
}
