//! A serpent in three coils, scaly outside and hollow inside: a closed surface, as of a voxelised mesh.

use super::noise::{Field, Octaves, sub_seed};
use super::{blend, push_solid};
use crate::{Colors, Columns, Input, Result, Rgb};

/// Balls that the body is made of, tail to head.
const BALLS: u32 = 420;
const TURNS: f32 = 3.2;

/// Like the sine of `turns` whole turns, from arithmetic alone: 0, 1, 0, −1 at the quarters, smooth between.
fn wave(turns: f32) -> f32 {
    let f = turns - (turns as i32) as f32;
    let f = if f < 0.0 { f + 1.0 } else { f };
    let half = if f < 0.5 { f } else { f - 0.5 };
    let up = 16.0 * half * (0.5 - half);
    // A parabola alone bulges; this is within 0.1 % of a sine.
    let up = up * (0.775 + 0.225 * up);
    if f < 0.5 { up } else { -up }
}

/// Middle and radius of a ball of the body.
fn ball(i: u32, side: f32) -> ([f32; 3], f32) {
    let t = i as f32 / (BALLS - 1) as f32;
    let coil = 0.34 - 0.16 * t;
    let turn = t * TURNS;
    let rise = 0.12 + 0.66 * t + 0.02 * wave(5.0 * t);
    let thick = if t < 0.85 { 0.012 + 0.085 * t } else { 0.085 + 0.03 * wave((t - 0.85) / 0.3) };
    let middle = [0.5 + coil * wave(turn + 0.25), rise, 0.5 + coil * wave(turn)];
    (middle.map(|v| v * side), thick * side)
}

pub fn make(size: u32, seed: u64) -> Result<Input> {
    let side = size as f32;
    let bumps = Octaves { seed: sub_seed(seed, 0), size, wavelength: side / 40.0, n: 3, gain: 0.6, squash: 1.0 };
    let scales = Field::new(size, 0.0..side, (side / 256.0).max(1.0), |p| bumps.at(p));
    let balls: Vec<_> = (0..BALLS).map(|i| ball(i, side)).collect();
    let bump = side * 0.012;
    // Two voxels: no ray slips through between voxels that touch at an edge.
    let skin = 2.0;

    let columns = Columns::try_from_rows([size; 3], |z, columns| {
        let (mut buffer, mut depth) = (Vec::new(), vec![f32::NEG_INFINITY; size as usize]);
        for x in 0..size {
            let (px, pz) = (x as f32 + 0.5, z as f32 + 0.5);
            let near = balls.iter().filter(|([cx, _, cz], r)| {
                let (dx, dz, reach) = (px - cx, pz - cz, r + bump);
                dx * dx + dz * dz < reach * reach
            });
            // How deep each voxel lies within the body.
            let (mut low, mut high) = (size, 0);
            for &([cx, cy, cz], r) in near {
                let flat = (px - cx) * (px - cx) + (pz - cz) * (pz - cz);
                let reach = r + bump;
                let from = (cy - reach).max(0.0) as u32;
                let to = ((cy + reach).max(0.0) as u32 + 1).min(size);
                (low, high) = (low.min(from), high.max(to));
                for y in from..to {
                    let dy = y as f32 + 0.5 - cy;
                    let inside = r - (flat + dy * dy).sqrt();
                    depth[y as usize] = depth[y as usize].max(inside);
                }
            }
            if low < high {
                let rough = scales.profile(x, z, &mut buffer);
                push_solid(columns, low..high, |y| {
                    let inside = depth[y as usize] + bump * rough.at(y);
                    (0.0..skin).contains(&inside)
                });
                depth[low as usize..high as usize].fill(f32::NEG_INFINITY);
            }
            columns.end_column();
        }
        Ok(())
    })?;
    let color = move |x: u32, y: u32, z: u32| {
        const STOPS: [Rgb; 3] = [[34, 96, 78], [120, 150, 60], [214, 150, 66]];
        let t = (y as f32 / side).clamp(0.0, 0.999) * 2.0;
        let c = blend(STOPS[t as usize], STOPS[t as usize + 1], t - (t as u32) as f32);
        // Rings.
        let ring = (x / 12 + y / 12 + z / 12) % 2;
        if ring == 0 { c } else { super::shade(c, 24) }
    };
    Ok(Input { columns, colors: Colors::Function(Box::new(color)), notes: Vec::new() })
}

#[cfg(test)]
mod tests {
    use super::wave;

    #[test]
    fn wave_is_near_a_sine() {
        for i in -400..400 {
            let turns = i as f32 / 100.0;
            let sine = (turns * std::f32::consts::TAU).sin();
            assert!((wave(turns) - sine).abs() < 2e-3, "{turns}: {} {sine}", wave(turns));
        }
    }
}
