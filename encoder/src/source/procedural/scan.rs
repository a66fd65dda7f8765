//! A tree in a pot as a CT scanner sees it: leaves as thin, torn sheets, soil as grain, specks of noise in the air.

use super::noise::{Field, Octaves, hash, sub_seed, unit};
use super::{push_solid, shade};
use crate::{Colors, Columns, Input, Result, Rgb};

/// Middles and radii of the crown's parts, in sides of the cube.
const CROWN: [([f32; 3], f32); 5] = [
    ([0.50, 0.74, 0.50], 0.22),
    ([0.30, 0.60, 0.44], 0.16),
    ([0.70, 0.58, 0.56], 0.17),
    ([0.46, 0.56, 0.72], 0.14),
    ([0.56, 0.62, 0.28], 0.15),
];
const POT_TOP: f32 = 0.22;

pub fn make(size: u32, seed: u64) -> Result<Input> {
    let side = size as f32;
    let seed = sub_seed(seed, 0);
    // Sheets are where this is near 0.
    let wrinkles = Octaves { seed, size, wavelength: side / 16.0, n: 3, gain: 0.55, squash: 0.7 };
    let field = Field::new(size, 0.0..side, (side / 256.0).max(1.0), |p| wrinkles.at(p));

    // What is at voxel (x, y, z), whose place in the field is `sheet`: 0 air, 1 pot, 2 soil, 3 wood, 4 leaf, 5 speck.
    let what = move |x: u32, y: u32, z: u32, sheet: f32| {
        let [u, v, w] = [x, y, z].map(|c| (c as f32 + 0.5) / side);
        let (dx, dz) = (u - 0.5, w - 0.5);
        let flat = dx * dx + dz * dz;
        let grain = unit(hash(seed, x, y, z));
        if v < POT_TOP {
            let wide = 0.20 + 0.4 * v;
            let inside = wide - 0.018;
            if flat < wide * wide && (flat > inside * inside || v < 0.02) {
                return 1;
            }
            return if flat < inside * inside && v < POT_TOP - 0.02 && grain < 0.72 { 2 } else { 0 };
        }
        // The trunk leans to and fro; boughs lead from it to the middles of the crown.
        let lean = 0.10 * (v - POT_TOP) * (0.6 - v) * 8.0;
        let trunk = 0.045 * (1.2 - v);
        if v < 0.66 && (dx - lean) * (dx - lean) + dz * dz < trunk * trunk {
            return 3;
        }
        for ([cx, cy, cz], r) in CROWN {
            let (ax, ay, az) = (u - cx, v - cy, w - cz);
            let d = ax * ax + ay * ay * 1.6 + az * az;
            if d < r * r {
                // A bough: near the line from the crown's middle down to the trunk.
                let (bx, by, bz) = (0.5 - cx, 0.45 - cy, 0.5 - cz);
                let along = ((ax * bx + ay * by + az * bz) / (bx * bx + by * by + bz * bz)).clamp(0.0, 1.0);
                let off = [ax - along * bx, ay - along * by, az - along * bz];
                if off.iter().map(|o| o * o).sum::<f32>() < 0.0002 {
                    return 3;
                }
                if sheet.abs() < 0.035 && grain < 0.9 {
                    return 4;
                }
            }
        }
        if grain > 0.9999 { 5 } else { 0 }
    };
    let columns = Columns::try_from_rows([size; 3], |z, columns| {
        let mut buffer = Vec::new();
        for x in 0..size {
            let sheets = field.profile(x, z, &mut buffer);
            push_solid(columns, 0..size, |y| what(x, y, z, sheets.at(y)) != 0);
            columns.end_column();
        }
        Ok(())
    })?;
    let color = move |x: u32, y: u32, z: u32| {
        const COLORS: [Rgb; 6] = [[0; 3], [168, 92, 58], [92, 70, 50], [120, 86, 54], [86, 148, 62], [200, 200, 205]];
        // What is solid and none of the rest without a sheet is leaf, or a speck, which lies outside the crown.
        let kind = what(x, y, z, 0.0);
        shade(COLORS[kind], (hash(seed, x, y, z) >> 27) as i32 - 16)
    };
    Ok(Input { columns, colors: Colors::Function(Box::new(color)), notes: Vec::new() })
}
