//! Stage `shade` for pictures that no pinhole makes: the same light, normals, occlusion, fog and sky as [`crate::cpu::shade`],
//! from where pixels' rays end in the world.

use crate::cpu::shade::{
    AMBIENT, AMBIENT_SUN, SKY_HORIZON, SKY_NADIR, SKY_ZENITH, SSAO_RADIUS, SSAO_STRENGTH, SUN, spiral, towards,
};
use crate::options::{Options, Shading};
use crate::projection::Rays;
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// Rows that one task shades; it looks at as many more above and below as occlusion reaches.
const ROWS_A_TASK: usize = 64;

/// Degrees that a usual picture is high: occlusion reaches as far in all of them.
const USUAL_FOV: f64 = 60.0;

/// Shades a frame of `width` columns: packed colours (0 for sky) and depths along `rays` in, sRGB out.
pub fn shade_rays(
    rays: &Rays,
    [width, height]: [usize; 2],
    options: &Options,
    color: &[u32],
    depth: &[f32],
    out: &mut [[u8; 4]],
) {
    let normals = matches!(options.lit(), Shading::Ssn | Shading::Full);
    let occlusion = matches!(options.lit(), Shading::Ssao | Shading::Full);
    // Lengths across a pixel at depth 1, and pixels that occlusion reaches.
    let (pixel, radius_px) = match rays.pixel() {
        Some(pixel) => (pixel as f32, (SSAO_RADIUS * height as f32).max(2.0)),
        None => {
            let [along, up] = rays.density();
            let density = along.max(up);
            ((1.0 / density) as f32, (SSAO_RADIUS * (USUAL_FOV.to_radians() * density) as f32).clamp(2.0, 64.0))
        }
    };
    let parallel = rays.pixel().is_some();
    let spiral = spiral(radius_px, options.ssao_samples);
    let border = if normals || occlusion {
        spiral.iter().map(|d| d[1].unsigned_abs()).max().unwrap_or(0).max(4) as usize
    } else {
        0
    };
    let sun = options.sun.map_or_else(|| Vec3::from(SUN).normalize().as_dvec3(), towards).as_vec3();
    let ambient = if options.sun.is_some() { AMBIENT_SUN } else { AMBIENT };
    let fog = options.fog.map_or(0.0, |f| (1.0 / f) as f32);
    let samples = options.ssao_samples as usize;
    out.par_chunks_mut(ROWS_A_TASK * width).enumerate().for_each(|(task, out)| {
        let top = task * ROWS_A_TASK;
        let rows = top.saturating_sub(border)..(top + out.len() / width + border).min(height);
        // Where the rays end, from the eye; not finite in the sky.
        let mut ends = vec![Vec3::ZERO; rows.len() * width];
        let mut dir = [vec![0.0; width], vec![0.0; width], vec![0.0; width]];
        for (y, ends) in rows.clone().zip(ends.chunks_exact_mut(width)) {
            let [dx, dy, dz] = &mut dir;
            rays.fill(0, y as u32, [dx, dy, dz]);
            for (x, end) in ends.iter_mut().enumerate() {
                *end = Vec3::new(dir[0][x], dir[1][x], dir[2][x]) * depth[y * width + x];
                if parallel {
                    *end += rays.offset(x as u32, y as u32);
                }
            }
        }
        let at = |x: i32, y: i32| -> Option<(Vec3, f32)> {
            let x = match (0..width as i32).contains(&x) {
                true => x as usize,
                false if rays.is_round() => x.rem_euclid(width as i32) as usize,
                false => return None,
            };
            let row = usize::try_from(y).ok().filter(|y| rows.contains(y))? - rows.start;
            let z = depth[(rows.start + row) * width + x];
            z.is_finite().then(|| (ends[row * width + x], z))
        };
        for (i, out) in out.iter_mut().enumerate() {
            let (x, y) = (i % width, top + i / width);
            let z = depth[y * width + x];
            if !z.is_finite() {
                *out = match options.sky {
                    true => rays.direction(x as u32, y as u32).map_or([0, 0, 0, 255], sky),
                    false => [0; 4],
                };
                continue;
            }
            let [r, g, b, _] = color[y * width + x].to_le_bytes();
            let here = ends[(y - rows.start) * width + x];
            let (x, y) = (x as i32, y as i32);
            let away = if parallel { Vec3::new(dir[0][0], dir[1][0], dir[2][0]) } else { here };
            let mut light = 1.0;
            if normals || occlusion {
                let n = normal(&at, [x, y], (here, z), away);
                if normals {
                    light = ambient + (1.0 - ambient) * (0.25 * n.y + 0.25 + 0.75 * n.dot(sun).max(0.0));
                }
                if occlusion {
                    let radius = radius_px * pixel * if parallel { 1.0 } else { z };
                    let turn = ((((x & 3) * 4 + (y & 3)) * 7) & 15) as usize * samples;
                    let mut sum = 0.0;
                    for &[dx, dy] in &spiral[turn..turn + samples] {
                        let Some((end, _)) = at(x + dx, y + dy) else { continue };
                        let v = end - here;
                        let square = v.length_squared();
                        let fade = (1.0 - square / (radius * radius)).max(0.0);
                        let above = v.dot(n) - 0.02 * radius;
                        sum += (above / (square + 0.01 * radius * radius).sqrt()).max(0.0) * fade;
                    }
                    light *= 1.0 - (SSAO_STRENGTH * 2.0 / samples as f32 * sum).min(0.85);
                }
            }
            let haze = if fog > 0.0 { 1.0 - (-here.length() * fog).exp() } else { 0.0 };
            let lit = |c: u8, sky: f32| {
                let lit = f32::from(c) * light;
                (lit + (sky * 255.0 - lit) * haze).clamp(0.0, 255.0).round_ties_even() as u8
            };
            *out = [lit(r, SKY_HORIZON[0]), lit(g, SKY_HORIZON[1]), lit(b, SKY_HORIZON[2]), 255];
        }
    });
}

/// The sky in a direction.
fn sky(dir: DVec3) -> [u8; 4] {
    let elevation = (dir.y / dir.length()) as f32;
    let share = elevation.abs().sqrt().min(1.0);
    let to = if elevation >= 0.0 { SKY_ZENITH } else { SKY_NADIR };
    let c = [0, 1, 2].map(|c| ((SKY_HORIZON[c] + (to[c] - SKY_HORIZON[c]) * share) * 255.0).round_ties_even() as u8);
    [c[0], c[1], c[2], 255]
}

/// Unit normal towards the eye at a pixel whose ray ends `here`: as in [`crate::cpu::shade`], from neighbours at 1, 2 and 4
/// pixels, on each axis of the picture the side with the smaller jump in depth.
fn normal(
    at: &impl Fn(i32, i32) -> Option<(Vec3, f32)>,
    [x, y]: [i32; 2],
    (here, z): (Vec3, f32),
    away: Vec3,
) -> Vec3 {
    let tangent = |dx: i32, dy: i32| {
        let mut sum = Vec3::ZERO;
        for k in [1, 2, 4] {
            let sides = [1, -1].map(|side| {
                at(x + side * k * dx, y + side * k * dy).map(|(end, depth)| ((depth - z).abs(), (end - here) * side as f32))
            });
            let [forward, back] = sides.map(|side| side.unwrap_or((f32::INFINITY, Vec3::ZERO)));
            let (jump, step) = if forward.0 <= back.0 { forward } else { back };
            if jump < 0.02 * k as f32 * z + 1.5 {
                sum += step;
            }
        }
        sum
    };
    let n = tangent(1, 0).cross(tangent(0, 1));
    let n = if n.dot(away) > 0.0 { -n } else { n };
    n.try_normalize().unwrap_or_else(|| (-away).normalize_or(Vec3::Y))
}
