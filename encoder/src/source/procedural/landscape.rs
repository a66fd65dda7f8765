//! Fractal landscapes with what a height map cannot hold: overhangs, caves, floating rocks. They tile in x and z.

use super::noise::{Field, Octaves, hash, sub_seed};
use super::{blend, push_solid, shade};
use crate::{Colors, Columns, Input, Result, Rgb, Run};

#[derive(Clone, Copy, PartialEq)]
pub enum Style {
    /// Rugged, with overhangs, tunnels and a few floating rocks.
    Terrain,
    /// Smooth, under many floating rocks: about 1.4 runs a column.
    Rocks,
    /// Rugged ground alone: a height field.
    Hills,
}

pub fn make(size: u32, seed: u64, style: Style) -> Result<Input> {
    // Half as high as wide, up to what one byte can address.
    let ny = (size / 2).clamp(16, 256);
    let high = ny as f32;
    let octaves = |i: u32, wavelength: f32, n: u32, gain: f32, squash: f32| Octaves {
        seed: sub_seed(seed, i),
        size,
        wavelength,
        n,
        gain,
        squash,
    };
    let rugged = style != Style::Rocks;
    let hollow = style == Style::Terrain;

    // Down to detail of two voxels.
    let n_fine = (ny * 2).ilog2();
    let hills = octaves(1, high * 1.5, n_fine, if rugged { 0.48 } else { 0.42 }, 1.0);
    let ridges = octaves(2, high * 1.2, 4, 0.5, 1.0);
    let regions = octaves(3, high * 2.5, 2, 0.5, 1.0);
    let height = move |x: u32, z: u32| {
        let p = [x as f32 + 0.5, 0.5, z as f32 + 0.5];
        let region = (0.5 + 1.2 * regions.at(p)).clamp(0.0, 1.0);
        let ridge = 1.0 - 2.0 * ridges.at(p).abs();
        let ridge = ridge.max(0.0) * ridge.max(0.0);
        let relief = if rugged { 0.55 } else { 0.34 };
        (high * (0.21 + relief * hills.at(p) + 0.42 * region * region * ridge)).clamp(0.03 * high, 0.64 * high)
    };

    // One field bends the ground into overhangs and, high above it, stands for the floating rocks.
    let spacing = 4.0;
    let stone = octaves(4, high * 0.30, 3, 0.45, 0.7);
    let stone = Field::new(size, 0.0..high, spacing, |p| stone.at(p));
    let tunnel = |i| {
        let o = octaves(i, high * 0.38, 2, 0.4, 0.8);
        hollow.then(|| Field::new(size, 0.0..high * 0.7, spacing, |p| o.at(p)))
    };
    let tunnels = [tunnel(5), tunnel(6)];
    let bend = if rugged { 0.22 * high } else { 0.0 };
    let (rocks_at, rocks_from) = if rugged { (0.80, 0.30) } else { (0.76, 0.15) };

    let columns = Columns::try_from_rows([size, ny, size], |z, columns| {
        let mut buffers: [Vec<f32>; 3] = Default::default();
        let [b0, b1, b2] = &mut buffers;
        for x in 0..size {
            let ground = height(x, z);
            if style == Style::Hills {
                columns.push_run(Run::new(0, ground as u16));
                columns.end_column();
                continue;
            }
            let stone = stone.profile(x, z, b0);
            let tunnels = match &tunnels {
                [Some(a), Some(b)] => Some((a.profile(x, z, b1), b.profile(x, z, b2))),
                _ => None,
            };
            let cave_top = (0.68 * high) as u32;
            push_solid(columns, 0..ny, |y| {
                // The lowest layers are never hollow: nothing falls out of the world.
                if y < 2 {
                    return true;
                }
                let above = y as f32 + 0.5 - ground;
                let n = stone.at(y);
                if above > bend {
                    let from_middle = (y as f32 / high - rocks_at) / 0.16;
                    return n > rocks_from + 0.45 * from_middle * from_middle;
                }
                above <= bend * n
                    && (y >= cave_top
                        || tunnels.as_ref().is_none_or(|(a, b)| {
                            let (a, b) = (a.at(y), b.at(y));
                            a * a + b * b > 0.006
                        }))
            });
            columns.end_column();
        }
        Ok(())
    })?;

    let skin = columns.clone();
    let colors = Colors::Function(Box::new(move |x, y, z| color(&skin, x, y, z)));
    Ok(Input { columns, colors, notes: Vec::new() })
}

/// Grass, sand and snow where a run ends, earth below them, rock where it is steep or deep.
fn color(columns: &Columns, x: u32, y: u32, z: u32) -> Rgb {
    const SAND: Rgb = [214, 196, 142];
    const GRASS: Rgb = [92, 142, 58];
    const DRY_GRASS: Rgb = [150, 152, 78];
    const EARTH: Rgb = [122, 88, 58];
    const ROCK: Rgb = [128, 122, 116];
    const WARM_ROCK: Rgb = [156, 126, 98];
    const SNOW: Rgb = [240, 244, 250];
    let altitude = y as f32 / columns.ny() as f32;
    let grain = (hash(7, x, y, z) >> 28) as i32 - 8;
    let depth = columns.find(x, y, z).map_or(0, |ix| u32::from(columns.runs()[ix].last()) - y);
    // The neighbour columns tile like the scene does.
    let (nx, nz) = (columns.nx(), columns.nz());
    let steep = [(1, 0), (nx - 1, 0), (0, 1), (0, nz - 1)]
        .iter()
        .any(|&(dx, dz)| columns.solid(((x + dx) % nx).into(), i64::from(y) + 3, ((z + dz) % nz).into()));
    let strata = blend(ROCK, WARM_ROCK, (hash(11, 0, y / 3, 0) >> 24) as f32 / 255.0);
    let floating = altitude > 0.64;
    let skin = if floating {
        GRASS
    } else if altitude < 0.13 {
        blend(SAND, GRASS, (altitude - 0.11) * 50.0)
    } else if altitude < 0.36 {
        blend(GRASS, DRY_GRASS, (altitude - 0.16) * 5.0)
    } else {
        blend(DRY_GRASS, SNOW, (altitude - 0.38) * 12.5)
    };
    let c = match depth {
        0..=1 if !steep => skin,
        2..=4 if !steep => blend(EARTH, skin, 0.25),
        _ => strata,
    };
    shade(c, grain * 2)
}
