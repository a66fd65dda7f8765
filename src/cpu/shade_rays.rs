//! Stage `shade` for pictures that no pinhole makes: the same light, normals, occlusion, fog and sky as [`crate::cpu::shade`],
//! from where pixels' rays end in the world.

use crate::cpu::shade::{
    AMBIENT, AMBIENT_SUN, LANES, Lanes, PHASES, SIGN, SKY_HORIZON, SKY_NADIR, SKY_ZENITH, SSAO_RADIUS, SSAO_STRENGTH,
    SUN, Scratch, ShadeParams, Split, greatest, least, mask, pack, select, spiral, towards,
};
use crate::cpu::traverse::has_avx2;
use crate::frame::camera::Camera;
use crate::frame::options::{Options, Shading};
use crate::frame::projection::Rays;
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// Rows that one task shades; it looks at as many more above and below as occlusion reaches.
const ROWS_A_TASK: usize = 64;

/// Degrees that a usual picture is high: occlusion reaches as far in all of them.
const USUAL_FOV: f64 = 60.0;

/// Length of a pixel at depth 1, and pixels that occlusion reaches: as far as in a usual picture.
fn reach(rays: &Rays) -> (f32, f32) {
    let [along, up] = rays.density();
    let density = along.max(up);
    ((1.0 / density) as f32, (SSAO_RADIUS * (USUAL_FOV.to_radians() * density) as f32).clamp(2.0, 64.0))
}

/// What all pixels of a picture for [`shade_round`] share.
pub fn round_params(camera: &Camera, rays: &Rays, options: &Options) -> ShadeParams {
    let (pixel, radius_px) = reach(rays);
    let spiral = spiral(radius_px, options.ssao_samples);
    ShadeParams { pixel, radius_px, spiral, ..ShadeParams::new(camera, options) }
}

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
        None => reach(rays),
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
fn normal(at: &impl Fn(i32, i32) -> Option<(Vec3, f32)>, [x, y]: [i32; 2], (here, z): (Vec3, f32), away: Vec3) -> Vec3 {
    let tangent = |dx: i32, dy: i32| {
        let mut sum = Vec3::ZERO;
        for k in [1, 2, 4] {
            let sides = [1, -1].map(|side| {
                at(x + side * k * dx, y + side * k * dy)
                    .map(|(end, depth)| ((depth - z).abs(), (end - here) * side as f32))
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

/// The same for pictures whose columns are even in longitude all round and whose rows are of one latitude each: where a pixel's
/// neighbours lie, seen from it, depends on its row alone, so that pixels are shaded in vectors as [`crate::cpu::shade`] does.
pub fn shade_round(
    [columns, rows]: [&[[f64; 2]]; 2],
    p: &ShadeParams,
    color: &[u32],
    depth: &[f32],
    scratch: &mut Scratch,
    out: &mut [[u8; 4]],
) {
    scratch.fill(p, depth);
    let split = scratch.split;
    let w = columns.len();
    // Beyond either end stand the columns of the other.
    for (y, row) in depth.chunks_exact(w).enumerate() {
        for i in 0..split.border as i32 {
            for (to, from) in [(-1 - i, w as i32 - 1 - i), (w as i32 + i, i)] {
                let from = from.rem_euclid(w as i32) as usize;
                scratch.depth[split.at(to, y as i32)] = row[from];
            }
        }
    }
    let mut turned = [vec![0.0; PHASES * split.lanes], vec![0.0; PHASES * split.lanes]];
    for (x, pair) in columns.iter().enumerate() {
        for (turned, v) in turned.iter_mut().zip(pair) {
            turned[split.in_row(x as i32)] = *v as f32;
        }
    }
    let [sin, cos] = &turned;
    let step = std::f64::consts::TAU / w as f64;
    let scratch = &*scratch;
    let avx2 = has_avx2();
    out.par_chunks_mut(w).zip(color.par_chunks(w)).enumerate().for_each(|(y, (out, color))| {
        let look = |dx: i32, dy: i32| -> [f32; 3] {
            // A row beyond the poles is sky, wherever it is.
            let to = rows[(y as i64 + i64::from(dy)).clamp(0, rows.len() as i64 - 1) as usize];
            let ([s1, c1], [s2, c2], (s, c)) = (rows[y], to, (f64::from(dx) * step).sin_cos());
            [(c2 * s) as f32, (s2 * c1 - c2 * s1 * c) as f32, (s2 * s1 + c2 * c1 * c) as f32]
        };
        let beside = [1, 2, 4].map(|k| [look(k, 0), look(-k, 0), look(0, k), look(0, -k)]);
        let turns = if p.occlusion { 4 } else { 0 };
        let spiral: Vec<_> = (0..turns)
            .flat_map(|x| {
                let turn = ((((x & 3) * 4 + (y & 3)) * 7) & 15) * p.samples as usize;
                p.spiral[turn..turn + p.samples as usize].iter().map(|&[dx, dy]| ([dx, dy], look(dx, dy)))
            })
            .collect();
        let row = Round {
            p,
            scratch,
            split,
            sin,
            cos,
            latitude: rows[y].map(|v| v as f32),
            beside,
            spiral: &spiral,
            y: y as i32,
        };
        #[cfg(target_arch = "x86_64")]
        if avx2 {
            // SAFETY: `has_avx2` has seen that the processor can.
            return unsafe { round_row_avx2(&row, color, out) };
        }
        let _ = avx2;
        round_row(&row, color, out);
    });
}

/// A row of [`shade_round`]. Vectors are in the axes of each pixel: along its row, up its column, away from the eye.
struct Round<'a> {
    p: &'a ShadeParams,
    scratch: &'a Scratch,
    split: Split,
    /// Sine and cosine of the columns' longitudes, phase by phase.
    sin: &'a [f32],
    cos: &'a [f32],
    latitude: [f32; 2],
    /// Directions of the neighbours 1, 2 and 4 pixels to the right, left, below and above.
    beside: [[[f32; 3]; 4]; 3],
    /// Those that occlusion is taken from, of each phase.
    spiral: &'a [([i32; 2], [f32; 3])],
    y: i32,
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
fn round_row_avx2(row: &Round<'_>, color: &[u32], out: &mut [[u8; 4]]) {
    round_row(row, color, out);
}

#[inline(always)]
fn round_row(row: &Round<'_>, color: &[u32], out: &mut [[u8; 4]]) {
    let mut words = [0u32; LANES];
    for from in (0..color.len()).step_by(PHASES * LANES) {
        for phase in 0..PHASES {
            let x = from + phase;
            for (word, color) in words.iter_mut().zip(color.get(x..).unwrap_or_default().iter().step_by(PHASES)) {
                *word = *color;
            }
            row.shade(x as i32, phase, &mut words);
            for (word, out) in words.iter().zip(out.get_mut(x..).unwrap_or_default().iter_mut().step_by(PHASES)) {
                *out = word.to_le_bytes();
            }
        }
    }
}

impl Round<'_> {
    #[inline(always)]
    fn depth(&self, x: i32, dx: i32, dy: i32) -> &[f32; LANES] {
        let at = self.split.at(x + dx, self.y + dy);
        self.scratch.depth[at..at + LANES].try_into().expect("as long as it is")
    }

    /// What a vector in the camera's axes is in those of each pixel.
    #[inline(always)]
    fn turned(&self, v: Vec3, x: i32) -> [Lanes; 3] {
        let at = self.split.in_row(x);
        let (sin, cos) = (&self.sin[at..at + LANES], &self.cos[at..at + LANES]);
        let [s, c] = self.latitude;
        let mut turned = [[0.0; LANES]; 3];
        for i in 0..LANES {
            let level = v.x * sin[i] + v.z * cos[i];
            turned[0][i] = v.x * cos[i] - v.z * sin[i];
            turned[1][i] = c * v.y - s * level;
            turned[2][i] = c * level + s * v.y;
        }
        turned
    }

    #[inline(always)]
    fn shade(&self, x: i32, phase: usize, words: &mut [u32; LANES]) {
        let p = self.p;
        let z = self.depth(x, 0, 0);
        let mut light = [1.0; LANES];
        let up = self.turned(p.up, x);
        if p.normals || p.occlusion {
            let n = self.normal(x);
            if p.normals {
                let sun = self.turned(p.sun, x);
                for i in 0..LANES {
                    let dot = |v: &[Lanes; 3]| n[0][i] * v[0][i] + n[1][i] * v[1][i] + n[2][i] * v[2][i];
                    light[i] =
                        p.ambient + (1.0 - p.ambient) * (0.25 * dot(&up) + 0.25 + 0.75 * greatest(dot(&sun), 0.0));
                }
            }
            if p.occlusion {
                self.occlude(x, phase, &n, &mut light);
            }
        }
        for i in 0..LANES {
            let sky = z[i] == f32::INFINITY;
            let haze = if p.fog > 0.0 { 1.0 - (-z[i] * p.fog).exp() } else { 0.0 };
            let elevation = up[2][i];
            let share = least(elevation.abs().sqrt(), 1.0);
            let color = words[i];
            let surface = pack([0, 1, 2].map(|c| {
                let lit = ((color >> (8 * c)) & 255) as i32 as f32 * light[i];
                lit + (SKY_HORIZON[c as usize] * 255.0 - lit) * haze
            }));
            let above = pack([0, 1, 2].map(|c: usize| {
                let to = if elevation >= 0.0 { SKY_ZENITH[c] } else { SKY_NADIR[c] };
                (SKY_HORIZON[c] + (to - SKY_HORIZON[c]) * share) * 255.0
            }));
            words[i] = if !sky {
                surface
            } else if p.sky {
                above
            } else {
                0
            };
        }
    }

    /// Unit normals towards the eye.
    #[inline(always)]
    fn normal(&self, x: i32) -> [Lanes; 3] {
        let z = self.depth(x, 0, 0);
        let mut sums = [[[0.0; LANES]; 3]; 2];
        for (k, sides) in [1, 2, 4].into_iter().zip(&self.beside) {
            let per_depth = 0.02 * k as f32;
            for (axis, sum) in sums.iter_mut().enumerate() {
                let (dx, dy) = [(k, 0), (0, k)][axis];
                let (zf, zb) = (self.depth(x, dx, dy), self.depth(x, -dx, -dy));
                let (f, b) = (sides[2 * axis], sides[2 * axis + 1]);
                for i in 0..LANES {
                    let (jump_f, jump_b) = ((zf[i] - z[i]).abs(), (zb[i] - z[i]).abs());
                    let forward = mask(jump_f <= jump_b);
                    let near = mask(least(jump_f, jump_b) < per_depth * z[i] + 1.5);
                    let zs = select(forward, zf[i], zb[i]);
                    let sign = !forward & SIGN;
                    let take = |v: f32| f32::from_bits((v.to_bits() ^ sign) & near);
                    sum[0][i] += take(select(forward, f[0], b[0]) * zs);
                    sum[1][i] += take(select(forward, f[1], b[1]) * zs);
                    sum[2][i] += take(select(forward, f[2], b[2]) * zs - z[i]);
                }
            }
        }
        let [a, b] = &sums;
        let mut n = [[0.0; LANES]; 3];
        for i in 0..LANES {
            let c = [
                a[1][i] * b[2][i] - a[2][i] * b[1][i],
                a[2][i] * b[0][i] - a[0][i] * b[2][i],
                a[0][i] * b[1][i] - a[1][i] * b[0][i],
            ];
            let square = c[0] * c[0] + c[1] * c[1] + c[2] * c[2];
            let scale = 1.0 / square.sqrt();
            let scale = if c[2] > 0.0 { -scale } else { scale };
            let flat = mask(!(square > 0.0 && square < f32::INFINITY));
            n[0][i] = select(flat, 0.0, c[0] * scale);
            n[1][i] = select(flat, 0.0, c[1] * scale);
            n[2][i] = select(flat, -1.0, c[2] * scale);
        }
        n
    }

    #[inline(always)]
    fn occlude(&self, x: i32, phase: usize, n: &[Lanes; 3], light: &mut Lanes) {
        let p = self.p;
        let z = self.depth(x, 0, 0);
        let mut sum = [0.0; LANES];
        let samples = p.samples as usize;
        let (scale, square_scale) = (p.radius_px * p.pixel, (p.radius_px * p.pixel).powi(2));
        for &([dx, dy], to) in &self.spiral[phase * samples..(phase + 1) * samples] {
            let zs = self.depth(x, dx, dy);
            for i in 0..LANES {
                let radius2 = square_scale * z[i] * z[i];
                let v = [to[0] * zs[i], to[1] * zs[i], to[2] * zs[i] - z[i]];
                let square = v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
                let above = v[0] * n[0][i] + v[1] * n[1][i] + v[2] * n[2][i] - 0.02 * scale * z[i];
                let fade = greatest(1.0 - square / radius2, 0.0);
                sum[i] += greatest(above / (square + 0.01 * radius2).sqrt(), 0.0) * fade;
            }
        }
        let share = SSAO_STRENGTH * 2.0 / p.samples as f32;
        for (light, &sum) in light.iter_mut().zip(&sum) {
            *light *= 1.0 - least(share * sum, 0.85);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Camera, Projection};

    /// A closed room of 20 × 12 × 16, seen from within: ranges from its six walls.
    fn room(rays: &Rays, [w, h]: [u32; 2], open: bool) -> (Vec<u32>, Vec<f32>) {
        let eye = DVec3::new(7.0, 4.0, 9.0);
        let range = |i: u32| {
            let d = rays.direction(i % w, i / w).unwrap();
            let to = |axis: usize, n: f64| if d[axis] > 0.0 { (n - eye[axis]) / d[axis] } else { -eye[axis] / d[axis] };
            let y = if open && d.y > 0.0 { f64::INFINITY } else { to(1, 12.0) };
            let r = to(0, 20.0).min(y).min(to(2, 16.0));
            if open && d.y > 0.5 { f32::INFINITY } else { r as f32 }
        };
        let depth: Vec<f32> = (0..w * h).map(range).collect();
        let color = (0..w * h).map(|i| u32::from_le_bytes([(i % 200) as u8 + 20, 120, 180, 255])).collect();
        (color, depth)
    }

    #[test]
    fn round_pictures_are_shaded_as_any_other() {
        for (size, pitch) in [([301, 90], 0.0), ([512, 256], -20.0), ([64, 32], 0.0)] {
            let camera = Camera { yaw: 30.0, pitch, width: size[0], height: size[1], ..Camera::default() };
            let rays = Rays::new(&camera, Projection::Equirect, [1; 3]);
            for (shading, fog, open, sky) in [
                (Shading::Full, None, false, true),
                (Shading::Full, Some(30.0), true, true),
                (Shading::Ssn, None, true, false),
                (Shading::Ssao, None, true, true),
                (Shading::None, None, true, true),
            ] {
                let options = Options { shading, fog, sky, ..Options::default() };
                let (color, depth) = room(&rays, size, open);
                let mut outs = [vec![[0; 4]; color.len()], vec![[1; 4]; color.len()]];
                let [any, round] = &mut outs;
                shade_rays(&rays, size.map(|v| v as usize), &options, &color, &depth, any);
                let p = round_params(&camera, &rays, &options);
                let tables = rays.angles().unwrap();
                shade_round(tables, &p, &color, &depth, &mut Scratch::default(), round);
                let apart = any.as_flattened().iter().zip(round.as_flattened()).map(|(a, b)| a.abs_diff(*b));
                let far = apart.clone().filter(|&d| d > 2).count();
                println!(
                    "{size:?} {shading:?}: at most {:?}, {far} of {} by more than 2",
                    apart.max(),
                    4 * color.len()
                );
                // Where two walls meet rounding decides which side a tangent is taken from.
                assert!(far * 200 <= 4 * color.len(), "{size:?} {shading:?}");
            }
        }
    }
}
