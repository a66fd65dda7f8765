//! A mixing layer like that of a Richtmyer–Meshkov instability: heavy fluid (solid) below, light fluid above, between
//! them spikes and bubbles with mushroom caps that break up into smaller ones. Tiles in x and z.

use std::ops::Range;
use std::sync::Arc;

use super::blend;
use super::noise::{Field, Octaves, sub_seed};
use super::push_solid;
use crate::model::pieces::{RowColors, Rows};
use crate::{About, ColumnsBuilder, Rgb};

/// Half the height of the layer, as a part of the cube's side.
const HALF_LAYER: f32 = 0.27;

/// How much of the horizontal pattern is still heavy fluid at `t`, the height over the middle in half layers: a
/// stem that narrows, a cap that is wide again, then nothing. Odd, so that bubbles mirror spikes.
fn threshold(t: f32) -> f32 {
    let up = t.abs();
    let value = if up < 0.30 {
        up * (0.36 / 0.30)
    } else if up < 0.55 {
        0.36 - (up - 0.30) * (0.26 / 0.25)
    } else {
        let rest = (up - 0.55) / 0.45;
        0.10 + rest * rest * 0.9
    };
    if t < 0.0 { -value } else { value }
}

/// Rows are made when they are asked for; only the coarse field is kept: 52 MB at most.
pub fn make(size: u32, seed: u64) -> Rows {
    let side = size as f32;
    let octaves = |i: u32, wavelength: f32, n: u32, gain: f32, squash: f32| Octaves {
        seed: sub_seed(seed, i),
        size,
        wavelength: side * wavelength,
        n,
        gain,
        squash,
    };
    let (middle, half) = (side * 0.5, side * HALF_LAYER);
    let low = (middle - half).max(0.0) as u32;
    let high = ((middle + half) as u32 + 1).min(size);

    // Where spikes and bubbles stand; swirls that move this pattern sideways with height; and turbulence.
    let pattern = octaves(1, 1.0 / 9.0, 2, 0.5, 1.0);
    let swirl = [octaves(2, 1.0 / 14.0, 2, 0.5, 1.0), octaves(3, 1.0 / 14.0, 2, 0.5, 1.0)];
    let turbulence = octaves(4, 1.0 / 20.0, 3, 0.6, 1.0);
    let reach = side / 22.0;
    let field = Field::new(size, low as f32..high as f32, (side / 288.0).max(1.0), |[x, y, z]| {
        let p = [x, y, z];
        let t = (y - middle) / half;
        // Sideways by less than a side, so adding one keeps coordinates positive.
        let moved = [x + side + reach * swirl[0].at(p), 0.5, z + side + reach * swirl[1].at(p)];
        1.6 * pattern.at(moved) + 0.77 * turbulence.at(p) - threshold(t)
    });
    let row = move |xs: Range<u32>, z: u32, columns: &mut ColumnsBuilder| {
        let mut buffer = Vec::new();
        for x in xs {
            let field = field.profile(x, z, &mut buffer);
            push_solid(columns, 0..high, |y| y < low || field.at(y) > 0.0);
            columns.end_column();
        }
        Ok(())
    };
    let color = move |_: u32, y: u32, _: u32| {
        const STOPS: [Rgb; 5] = [[38, 30, 92], [150, 36, 92], [230, 96, 48], [250, 190, 86], [255, 246, 214]];
        let t = (((y as f32 + 0.5 - middle) / half) * 0.5 + 0.5).clamp(0.0, 0.999) * 4.0;
        blend(STOPS[t as usize], STOPS[t as usize + 1], t - (t as u32) as f32)
    };
    Rows {
        dims: [size; 3],
        row: Box::new(row),
        heights: None,
        color: RowColors::Voxel(Arc::new(color)),
        notes: Vec::new(),
        about: About::default(),
        input_bytes: 0,
        water: None,
    }
}
