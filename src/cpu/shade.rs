//! Stage `shade`: colour, screen-space normals (SSN), screen-space ambient occlusion (SSAO), fog and sky.
//!
//! Works on colour and depth alone (Forstmann & Ohya 2009 §3.8), so it costs the same whatever the scene.
//! Normals: the plane through a pixel's neighbours at 1, 2 and 4 pixels along each screen axis, on each axis the side
//! with the smaller jump in depth. Occlusion: some ([`SSAO_SAMPLES`]) neighbours on a spiral, turned from pixel to pixel in a 4 × 4
//! pattern; each counts by how far it stands above the pixel's tangent plane (McGuire et al. 2011; the paper cites
//! Mittring 2007, which needs no normals). Everything is f32 and a function of the pixel's neighbourhood alone.

use crate::camera::Camera;
use crate::options::{Options, Shading};
use glam::Vec3;
use rayon::prelude::*;

/// Neighbours looked at for occlusion unless told otherwise.
pub const SSAO_SAMPLES: u32 = 10;
/// Radius of the occlusion spiral as a share of the image's height.
pub const SSAO_RADIUS: f32 = 0.035;
/// How much of a surface's light occlusion can take.
pub const SSAO_STRENGTH: f32 = 1.1;
/// Light that reaches a surface whatever its normal.
pub const AMBIENT: f32 = 0.50;
/// Towards the sun, in the world; not normalised.
pub const SUN: [f32; 3] = [0.5, 0.8, 0.35];
/// Sky at the horizon, at the zenith and below the horizon; sRGB.
pub const SKY_HORIZON: [f32; 3] = [0.78, 0.86, 0.93];
pub const SKY_ZENITH: [f32; 3] = [0.30, 0.52, 0.84];
pub const SKY_NADIR: [f32; 3] = [0.52, 0.56, 0.60];

/// What all pixels of a frame share.
#[derive(Clone, Debug, PartialEq)]
pub struct ShadeParams {
    pub width: i32,
    pub height: i32,
    /// Image plane position `(a, b)` of a pixel's centre: `start + step · pixel`.
    pub start: [f32; 2],
    pub step: [f32; 2],
    /// The world's up and the sun in camera axes (right, up, forward).
    pub up: Vec3,
    pub sun: Vec3,
    /// Radius of the spiral in pixels, and of one pixel at depth 1.
    pub radius_px: f32,
    pub pixel: f32,
    /// See [`spiral`].
    pub spiral: Vec<[i32; 2]>,
    pub samples: u32,
    pub normals: bool,
    pub occlusion: bool,
    /// 1 / fog distance, 0 for clear air.
    pub fog: f32,
}

impl ShadeParams {
    pub fn new(camera: &Camera, options: &Options) -> ShadeParams {
        let basis = camera.basis();
        let half = camera.half_extent();
        let axes =
            |v: glam::DVec3| glam::DVec3::new(v.dot(basis.right), v.dot(basis.up), v.dot(basis.forward)).as_vec3();
        let step = [2.0 * half.x / f64::from(camera.width), -2.0 * half.y / f64::from(camera.height)];
        let sun = Vec3::from(SUN).normalize().as_dvec3();
        ShadeParams {
            width: camera.width as i32,
            height: camera.height as i32,
            start: [(0.5 * step[0] - half.x) as f32, (0.5 * step[1] + half.y) as f32],
            step: step.map(|s| s as f32),
            up: axes(glam::DVec3::Y),
            sun: axes(sun),
            radius_px: radius_px(camera),
            pixel: (1.0 / camera.focal()) as f32,
            spiral: spiral(radius_px(camera), options.ssao_samples),
            samples: options.ssao_samples,
            normals: matches!(options.shading, Shading::Ssn | Shading::Full),
            occlusion: matches!(options.shading, Shading::Ssao | Shading::Full),
            fog: options.fog.map_or(0.0, |f| (1.0 / f) as f32),
        }
    }

    /// The pixel's ray in camera axes, forward component 1.
    fn ray(&self, x: i32, y: i32) -> Vec3 {
        Vec3::new(self.start[0] + self.step[0] * x as f32, self.start[1] + self.step[1] * y as f32, 1.0)
    }
}

/// Shades a frame: packed colours (0 for sky) and depths in, sRGB out.
pub fn shade(p: &ShadeParams, color: &[u32], depth: &[f32], out: &mut [[u8; 4]]) {
    let w = p.width as usize;
    out.par_chunks_mut(w).enumerate().for_each(|(y, row)| {
        for (x, out) in row.iter_mut().enumerate() {
            *out = shade_one(p, color[y * w + x], depth, x as i32, y as i32);
        }
    });
}

fn shade_one(p: &ShadeParams, color: u32, depth: &[f32], x: i32, y: i32) -> [u8; 4] {
    let z = depth[(y * p.width + x) as usize];
    let ray = p.ray(x, y);
    if z == f32::INFINITY {
        return pack(sky(p, ray));
    }
    let [r, g, b, _] = color.to_le_bytes();
    if !p.normals && !p.occlusion && p.fog == 0.0 {
        return [r, g, b, 255];
    }
    let mut light = 1.0;
    if p.normals || p.occlusion {
        let n = normal(p, depth, x, y, z);
        if p.normals {
            light = AMBIENT + (1.0 - AMBIENT) * (0.25 * n.dot(p.up) + 0.25 + 0.75 * n.dot(p.sun).max(0.0));
        }
        if p.occlusion {
            light *= 1.0 - occlusion(p, depth, x, y, z, n);
        }
    }
    let lit = Vec3::new(f32::from(r), f32::from(g), f32::from(b)) / 255.0 * light;
    let haze = if p.fog > 0.0 { 1.0 - (-z * ray.length() * p.fog).exp() } else { 0.0 };
    pack(lit + (Vec3::from(SKY_HORIZON) - lit) * haze)
}

fn pack(c: Vec3) -> [u8; 4] {
    let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
    [byte(c.x), byte(c.y), byte(c.z), 255]
}

/// Sky along a ray.
fn sky(p: &ShadeParams, ray: Vec3) -> Vec3 {
    let elevation = ray.dot(p.up) / ray.length();
    let to = if elevation >= 0.0 { SKY_ZENITH } else { SKY_NADIR };
    Vec3::from(SKY_HORIZON).lerp(Vec3::from(to), elevation.abs().sqrt().min(1.0))
}

/// Depth at a pixel; outside the image and in the sky, +inf.
fn depth_at(p: &ShadeParams, depth: &[f32], x: i32, y: i32) -> f32 {
    let inside = (0..p.width).contains(&x) && (0..p.height).contains(&y);
    if inside { depth[(y * p.width + x) as usize] } else { f32::INFINITY }
}

/// Unit normal towards the eye, in camera axes.
fn normal(p: &ShadeParams, depth: &[f32], x: i32, y: i32, z: f32) -> Vec3 {
    let here = p.ray(x, y) * z;
    let tangent = |dx: i32, dy: i32| {
        let mut sum = Vec3::ZERO;
        for k in [1, 2, 4] {
            let (xf, yf, xb, yb) = (x + k * dx, y + k * dy, x - k * dx, y - k * dy);
            let (zf, zb) = (depth_at(p, depth, xf, yf), depth_at(p, depth, xb, yb));
            // The side on the same surface, if one is: a jump of more than what a steep slope makes is an edge.
            let (jump_f, jump_b) = ((zf - z).abs(), (zb - z).abs());
            let limit = 0.02 * k as f32 * z + 1.5;
            if jump_f.min(jump_b) < limit {
                sum += if jump_f <= jump_b { p.ray(xf, yf) * zf - here } else { here - p.ray(xb, yb) * zb };
            }
        }
        sum
    };
    let (right, down) = (tangent(1, 0), tangent(0, 1));
    let n = right.cross(down);
    let length = n.length();
    if !(length > 0.0 && length.is_finite()) {
        return -here.normalize_or(Vec3::Z);
    }
    let n = n / length;
    if n.dot(here) > 0.0 { -n } else { n }
}

/// Share of a pixel's light that its surroundings take, 0 to 1.
fn occlusion(p: &ShadeParams, depth: &[f32], x: i32, y: i32, z: f32, n: Vec3) -> f32 {
    let here = p.ray(x, y) * z;
    let radius = p.radius_px * p.pixel * z;
    // One of 16 turns in a 4 × 4 pattern.
    let turn = ((((x & 3) * 4 + (y & 3)) * 7) & 15) as usize * p.samples as usize;
    let mut sum = 0.0;
    for [dx, dy] in &p.spiral[turn..turn + p.samples as usize] {
        let (sx, sy) = (x + dx, y + dy);
        let zs = depth_at(p, depth, sx, sy);
        if zs == f32::INFINITY {
            continue;
        }
        let v = p.ray(sx, sy) * zs - here;
        let d2 = v.length_squared();
        let above = v.dot(n) - 0.02 * radius;
        let fade = (1.0 - d2 / (radius * radius)).max(0.0);
        sum += (above / (d2 + 0.01 * radius * radius).sqrt()).max(0.0) * fade;
    }
    (SSAO_STRENGTH * 2.0 * sum / p.samples as f32).min(0.85)
}

/// Radius of the occlusion spiral in pixels.
pub fn radius_px(camera: &Camera) -> f32 {
    (SSAO_RADIUS * camera.height as f32).max(2.0)
}

/// Offsets in pixels of the `samples` neighbours for each of 16 turns of the spiral.
pub fn spiral(radius_px: f32, samples: u32) -> Vec<[i32; 2]> {
    let mut out = vec![[0; 2]; 16 * samples as usize];
    for (turn, out) in out.chunks_mut(samples as usize).enumerate() {
        let (mut s, mut c) = (turn as f32 * (std::f32::consts::TAU / 16.0)).sin_cos();
        let (ds, dc) = (0.675_490_3, -0.737_368_9); // the golden angle
        for (k, out) in out.iter_mut().enumerate() {
            let r = radius_px * (k as f32 + 0.75) / samples as f32;
            *out = [round(r * c), round(r * s)];
            (c, s) = (c * dc - s * ds, s * dc + c * ds);
        }
    }
    out
}

fn round(v: f32) -> i32 {
    (v + 0.5 + 1024.0) as i32 - 1024
}
