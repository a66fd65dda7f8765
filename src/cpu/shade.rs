//! Stage `shade`: colour, screen-space normals (SSN), screen-space ambient occlusion (SSAO), fog and sky.
//!
//! Works on colour and depth alone (Forstmann & Ohya 2009 §3.8), so it costs the same whatever the scene.
//! Normals: the plane through a pixel's neighbours at 1, 2 and 4 pixels along each screen axis, on each axis the side
//! with the smaller jump in depth. Occlusion: some ([`SSAO_SAMPLES`]) neighbours on a spiral, turned from pixel to pixel in a 4 × 4
//! pattern; each counts by how far it stands above the pixel's tangent plane (McGuire et al. 2011; the paper cites
//! Mittring 2007, which needs no normals). Everything is f32 and a function of the pixel's neighbourhood alone.

use crate::cpu::normal::Occupancy;
use crate::cpu::resize;
use crate::cpu::shadow::{Sunlight, bias, size_at_1};
use crate::cpu::smooth::Normals;
use crate::cpu::traverse::has_avx2;
use crate::frame::camera::Camera;
use crate::frame::options::{Options, Shading};
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
/// The same where the sun's place is given, to show relief.
pub const AMBIENT_SUN: f32 = 0.30;
/// Towards the sun, in the world, unless told otherwise; not normalised.
pub const SUN: [f32; 3] = [0.5, 0.8, 0.35];
/// How fast the sky clears above the horizon where there is fog, by the sine of elevation.
pub const HORIZON_CLEARS: f32 = 24.0;
/// From which share of the view distance on haze hides that it ends.
pub const FADE_BEGINS: f32 = 0.6;
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
    /// Light that reaches a surface whatever its normal.
    pub ambient: f32,
    /// Whether the sky is shown, or transparent.
    pub sky: bool,
    /// 1 / fog distance, 0 for clear air.
    pub fog: f32,
    /// 1 / view distance.
    pub per_view: f32,
    /// The camera's axes (right, up, forward) and the sun in the world.
    pub axes: [Vec3; 3],
    pub sun_world: Vec3,
    /// Size of a voxel drawn at depth 1.
    pub size: f32,
    /// Whether voxels stand for a surface, and are no blocks however near.
    pub smooth: bool,
}

impl ShadeParams {
    pub fn new(camera: &Camera, options: &Options) -> ShadeParams {
        let basis = camera.basis();
        let half = camera.half_extent();
        let axes =
            |v: glam::DVec3| glam::DVec3::new(v.dot(basis.right), v.dot(basis.up), v.dot(basis.forward)).as_vec3();
        let step = [2.0 * half.x / f64::from(camera.width), -2.0 * half.y / f64::from(camera.height)];
        let sun = options.sun.map_or_else(|| Vec3::from(SUN).normalize().as_dvec3(), towards);
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
            normals: matches!(options.lit(), Shading::Ssn | Shading::Full),
            occlusion: matches!(options.lit(), Shading::Ssao | Shading::Full),
            ambient: if options.sun.is_some() { AMBIENT_SUN } else { AMBIENT },
            sky: options.sky,
            fog: options.fog.map_or(0.0, |f| (1.0 / f) as f32),
            per_view: (1.0 / crate::cpu::exact::view_distance(options).min(1e9)) as f32,
            axes: [basis.right, basis.up, basis.forward].map(|v| v.as_vec3()),
            sun_world: sun.as_vec3(),
            size: size_at_1(options, (1.0 / camera.focal()) as f32),
            smooth: options.smooth,
        }
    }
}

/// The direction towards azimuth (clockwise from north, −z) and elevation, in degrees.
pub(super) fn towards([azimuth, elevation]: [f64; 2]) -> glam::DVec3 {
    let ((sin, cos), (up, level)) = (azimuth.to_radians().sin_cos(), elevation.to_radians().sin_cos());
    glam::DVec3::new(sin * level, up, -cos * level)
}

/// Of each [`PHASES`] pixels side by side the first are shaded together, the second together, and so on: the turns of the
/// spiral repeat, so that all of them look at neighbours equally far away.
pub(super) const PHASES: usize = 4;

/// Pixels of a phase that are shaded together. Their depths, normals and light fit a first-level cache many times.
pub(super) const LANES: usize = 64;

/// Rows that one task shades.
const ROWS_A_TASK: usize = 8;

/// What [`shade`] keeps from frame to frame: the depths with a border of sky as wide as the neighbours are far, each row as
/// `PHASES` rows. Pixels of a phase lie side by side there, and so do their neighbours: nothing is gathered.
#[derive(Default)]
pub struct Scratch {
    pub(super) depth: Vec<f32>,
    /// The first component of the rays of a row's pixels, in the same order.
    rays: Vec<f32>,
    pub(super) split: Split,
}

/// Where a pixel stands in [`Scratch`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Split {
    width: usize,
    height: usize,
    /// Pixels around the picture that are sky.
    pub(super) border: usize,
    /// Lanes before the picture's first, and all lanes of a phase.
    left: usize,
    pub(super) lanes: usize,
}

impl Split {
    fn new(p: &ShadeParams) -> Split {
        let farthest = if p.occlusion { p.spiral.iter().flatten().map(|d| d.unsigned_abs()).max() } else { None };
        // Normals look 4 pixels away.
        let border = if p.normals || p.occlusion { farthest.unwrap_or(0).max(4) as usize } else { 0 };
        let left = border.div_ceil(PHASES);
        let (width, height) = (p.width as usize, p.height as usize);
        let lanes = left + width.div_ceil(PHASES).next_multiple_of(LANES) + left + 1;
        Split { width, height, border, left, lanes }
    }

    /// Place of a pixel within its row.
    #[inline(always)]
    pub(super) fn in_row(&self, x: i32) -> usize {
        let lane = (self.left as i32 + x.div_euclid(PHASES as i32)) as usize;
        x.rem_euclid(PHASES as i32) as usize * self.lanes + lane
    }

    #[inline(always)]
    pub(super) fn at(&self, x: i32, y: i32) -> usize {
        (y + self.border as i32) as usize * PHASES * self.lanes + self.in_row(x)
    }
}

impl Scratch {
    pub(super) fn fill(&mut self, p: &ShadeParams, depth: &[f32]) {
        let split = Split::new(p);
        let row = PHASES * split.lanes;
        if split != self.split {
            self.split = split;
            self.depth.clear();
            resize(&mut self.depth, (split.height + 2 * split.border) * row, f32::INFINITY);
        }
        self.rays.resize(row, 0.0);
        for (phase, rays) in self.rays.chunks_exact_mut(split.lanes).enumerate() {
            for (lane, ray) in rays.iter_mut().enumerate() {
                let x = (lane as i32 - split.left as i32) * PHASES as i32 + phase as i32;
                *ray = p.start[0] + p.step[0] * x as f32;
            }
        }
        let picture = split.border * row..(split.border + split.height) * row;
        let tasks = self.depth[picture].par_chunks_mut(ROWS_A_TASK * row);
        tasks.zip(depth.par_chunks(ROWS_A_TASK * split.width)).for_each(|(to, from)| {
            for (to, from) in to.chunks_exact_mut(row).zip(from.chunks_exact(split.width)) {
                let mut phases = to.chunks_exact_mut(split.lanes).map(|phase| &mut phase[split.left..]);
                let [a, b, c, d] = [(); PHASES].map(|()| phases.next().expect("as many as there are phases"));
                let whole = from.chunks_exact(PHASES);
                let rest = whole.remainder();
                for ((((z, a), b), c), d) in whole.zip(&mut *a).zip(&mut *b).zip(&mut *c).zip(&mut *d) {
                    (*a, *b, *c, *d) = (z[0], z[1], z[2], z[3]);
                }
                for (&z, to) in rest.iter().zip([a, b, c, d]) {
                    to[split.width / PHASES] = z;
                }
            }
        });
    }
}

/// What of the scene shading looks at, where it is asked to: the default is nothing.
#[derive(Default)]
pub struct Lighting<'a> {
    /// What is in the shadow.
    pub sunlight: Option<Sunlight<'a>>,
    /// In place of those of the screen.
    pub normals: Option<NormalsOf<'a>>,
}

/// Where normals come from but for the screen.
pub enum NormalsOf<'a> {
    /// The surface that a height field stands for.
    Surface(Normals<'a>),
    /// What is solid around a voxel.
    Occupancy(Occupancy<'a>),
}

impl NormalsOf<'_> {
    #[inline(always)]
    fn at(&self, from_eye: Vec3, ray: Vec3, size: f32) -> Option<Vec3> {
        match self {
            NormalsOf::Surface(normals) => normals.at(from_eye, size),
            NormalsOf::Occupancy(normals) => normals.at(from_eye, ray, size),
        }
    }
}

/// Shades a frame: packed colours (0 for sky) and depths in, sRGB out.
pub fn shade(
    p: &ShadeParams,
    color: &[u32],
    depth: &[f32],
    lighting: &Lighting<'_>,
    scratch: &mut Scratch,
    out: &mut [[u8; 4]],
) {
    scratch.fill(p, depth);
    let w = p.width as usize;
    let avx2 = has_avx2();
    let tasks = out.par_chunks_mut(ROWS_A_TASK * w).zip(color.par_chunks(ROWS_A_TASK * w)).enumerate();
    tasks.for_each(|(task, (out, color))| {
        let task = RowsTask { p, lighting, scratch, first_row: task * ROWS_A_TASK, color, out };
        #[cfg(target_arch = "x86_64")]
        if avx2 {
            // SAFETY: `has_avx2` has seen that the processor can.
            return unsafe { shade_rows_avx2(task) };
        }
        let _ = avx2;
        shade_rows(task);
    });
}

/// Some rows of a picture.
struct RowsTask<'a> {
    p: &'a ShadeParams,
    lighting: &'a Lighting<'a>,
    scratch: &'a Scratch,
    first_row: usize,
    color: &'a [u32],
    out: &'a mut [[u8; 4]],
}

/// The same code for processors with AVX2; the same bits.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
fn shade_rows_avx2(task: RowsTask<'_>) {
    shade_rows(task);
}

#[inline(always)]
fn shade_rows(task: RowsTask<'_>) {
    let RowsTask { p, lighting, scratch, first_row, color, out } = task;
    let w = p.width as usize;
    let mut words = [[0u32; LANES]; PHASES];
    for (r, (color, out)) in color.chunks_exact(w).zip(out.chunks_exact_mut(w)).enumerate() {
        let blocks = color.chunks(PHASES * LANES).zip(out.chunks_mut(PHASES * LANES));
        for (block, (color, out)) in blocks.enumerate() {
            // Whole ones.
            let lanes = color.len() / PHASES;
            let whole = color.chunks_exact(PHASES);
            for (words, &color) in words.iter_mut().zip(whole.remainder()) {
                words[lanes] = color;
            }
            for (lane, color) in whole.enumerate().take(LANES) {
                [words[0][lane], words[1][lane], words[2][lane], words[3][lane]] =
                    [color[0], color[1], color[2], color[3]];
            }
            for (phase, words) in words.iter_mut().enumerate() {
                let x = (block * PHASES * LANES + phase) as i32;
                Block { p, lighting, scratch, x, y: (first_row + r) as i32 }.shade(words);
            }
            let mut whole = out.chunks_exact_mut(PHASES);
            for (lane, out) in whole.by_ref().enumerate() {
                for (out, words) in out.iter_mut().zip(&words) {
                    *out = words[lane].to_le_bytes();
                }
            }
            for (out, words) in whole.into_remainder().iter_mut().zip(&words) {
                *out = words[lanes].to_le_bytes();
            }
        }
    }
}

pub(super) type Lanes = [f32; LANES];

/// The lesser and the greater of two numbers, and the second where the first is none: as vectors have it.
#[inline(always)]
pub(super) fn least(v: f32, most: f32) -> f32 {
    if v < most { v } else { most }
}

#[inline(always)]
pub(super) fn greatest(v: f32, least: f32) -> f32 {
    if v > least { v } else { least }
}

/// All bits set or none: compilers make branches of what chooses between numbers in other ways.
#[inline(always)]
pub(super) fn mask(set: bool) -> u32 {
    0u32.wrapping_sub(u32::from(set))
}

#[inline(always)]
pub(super) fn select(mask: u32, set: f32, clear: f32) -> f32 {
    f32::from_bits((set.to_bits() & mask) | (clear.to_bits() & !mask))
}

/// The sign of an f32.
pub(super) const SIGN: u32 = 1 << 31;

/// From three components, 0 to 255, to a packed colour.
#[inline(always)]
pub(super) fn pack(c: [f32; 3]) -> u32 {
    // In f32 numbers beside 2²³ are whole: the sum rounds, and its low bits are the number.
    let byte = |v: f32| (least(greatest(v, 0.0), 255.0) + 8_388_608.0).to_bits() & 255;
    byte(c[0]) | byte(c[1]) << 8 | byte(c[2]) << 16 | 0xFF00_0000
}

/// The pixels of a phase from (`x`, `y`) on. Loops over lanes have no branches: compilers make vectors of them.
struct Block<'a> {
    p: &'a ShadeParams,
    lighting: &'a Lighting<'a>,
    scratch: &'a Scratch,
    x: i32,
    y: i32,
}

impl<'a> Block<'a> {
    /// Depths of the neighbours `dx`, `dy` pixels away; outside the picture and in the sky, +inf.
    #[inline(always)]
    fn depth(&self, dx: i32, dy: i32) -> &'a Lanes {
        let at = self.scratch.split.at(self.x + dx, self.y + dy);
        self.scratch.depth[at..at + LANES].try_into().expect("as long as it is")
    }

    /// The neighbours' rays in camera axes; the third component is 1.
    #[inline(always)]
    fn rays(&self, dx: i32, dy: i32) -> (&'a Lanes, f32) {
        let at = self.scratch.split.in_row(self.x + dx);
        let rays = self.scratch.rays[at..at + LANES].try_into().expect("as long as it is");
        (rays, self.p.start[1] + self.p.step[1] * (self.y + dy) as f32)
    }

    /// From packed colours to shaded ones.
    #[inline(always)]
    fn shade(&self, words: &mut [u32; LANES]) {
        let z = self.depth(0, 0);
        let sky = z.iter().map(|&z| u32::from(z == f32::INFINITY)).sum::<u32>();
        if sky > 0 {
            let mut shown = [0; LANES];
            self.sky(&mut shown);
            if (sky as usize) < LANES {
                self.surface(words);
            }
            for ((word, &sky), &z) in words.iter_mut().zip(&shown).zip(z) {
                *word = if z == f32::INFINITY { sky } else { *word };
            }
        } else {
            self.surface(words);
        }
    }

    /// Sky along the rays, where it is shown; `words` are transparent before.
    #[inline(always)]
    fn sky(&self, words: &mut [u32; LANES]) {
        let p = self.p;
        if !p.sky {
            return;
        }
        let (rx, ry) = self.rays(0, 0);
        for (word, &rx) in words.iter_mut().zip(rx) {
            let elevation = (rx * p.up.x + ry * p.up.y + p.up.z) / (rx * rx + ry * ry + 1.0).sqrt();
            let mut share = least(elevation.abs().sqrt(), 1.0);
            if p.fog > 0.0 {
                // The horizon lies in the haze, and below it there is nothing else.
                let clear = 1.0 - (-HORIZON_CLEARS * greatest(elevation, 0.0)).exp();
                share *= clear;
            }
            *word = pack([0, 1, 2].map(|c| {
                let to = if elevation >= 0.0 { SKY_ZENITH[c] } else { SKY_NADIR[c] };
                (SKY_HORIZON[c] + (to - SKY_HORIZON[c]) * share) * 255.0
            }));
        }
    }

    /// Lit surface; of lanes in the sky, anything.
    #[inline(always)]
    fn surface(&self, words: &mut [u32; LANES]) {
        let p = self.p;
        if !p.normals && !p.occlusion && p.fog == 0.0 {
            words.iter_mut().for_each(|word| *word |= 0xFF00_0000);
            return;
        }
        let mut light = [1.0; LANES];
        if p.normals || p.occlusion {
            let n = match &self.lighting.normals {
                None => self.normal(),
                Some(normals) => self.normal_of_scene(normals),
            };
            if let Some(sunlight) = &self.lighting.sunlight {
                self.light_of_sun(&n, sunlight, &mut light);
            } else if p.normals {
                let [nx, ny, nz] = &n;
                for (light, ((&nx, &ny), &nz)) in light.iter_mut().zip(nx.iter().zip(ny).zip(nz)) {
                    let up = nx * p.up.x + ny * p.up.y + nz * p.up.z;
                    let sun = greatest(nx * p.sun.x + ny * p.sun.y + nz * p.sun.z, 0.0);
                    *light = p.ambient + (1.0 - p.ambient) * (0.25 * up + 0.25 + 0.75 * sun);
                }
            }
            if p.occlusion {
                self.occlude(&n, &mut light);
            }
        }
        let mut haze = [0.0; LANES];
        if p.fog > 0.0 {
            let (rx, ry) = self.rays(0, 0);
            for ((haze, &z), &rx) in haze.iter_mut().zip(self.depth(0, 0)).zip(rx) {
                let square = rx * rx + ry * ry + 1.0;
                let up = rx * p.up.x + ry * p.up.y + p.up.z;
                // Where the view ends, nothing is left to end.
                let far = greatest(z * greatest(square - up * up, 0.0).sqrt() * p.per_view - FADE_BEGINS, 0.0);
                let fade = least(far * (1.0 / (1.0 - FADE_BEGINS)), 1.0);
                *haze = 1.0 - (-z * square.sqrt() * p.fog).exp() * (1.0 - fade * fade * (3.0 - 2.0 * fade));
            }
        }
        for ((word, &light), &haze) in words.iter_mut().zip(&light).zip(&haze) {
            let color = *word;
            *word = pack([0, 1, 2].map(|c| {
                let lit = ((color >> (8 * c)) & 255) as i32 as f32 * light;
                lit + (SKY_HORIZON[c as usize] * 255.0 - lit) * haze
            }));
        }
    }

    /// Unit normals as the scene has them, in camera axes; those of the screen where it has none.
    #[inline(always)]
    fn normal_of_scene(&self, normals: &NormalsOf<'_>) -> [Lanes; 3] {
        let p = self.p;
        let z = self.depth(0, 0);
        let (rx, ry) = self.rays(0, 0);
        let mut out = [[0.0; LANES]; 3];
        let mut walls = false;
        for i in (0..LANES).filter(|&i| z[i] < f32::INFINITY) {
            let ray = p.axes[0] * rx[i] + p.axes[1] * ry + p.axes[2];
            match normals.at(ray * z[i], ray, greatest(p.size * z[i], 1.0)) {
                Some(n) => [out[0][i], out[1][i], out[2][i]] = p.axes.map(|axis| axis.dot(n)),
                None => walls = true,
            }
        }
        if walls {
            let screen = self.normal();
            for i in 0..LANES {
                if [out[0][i], out[1][i], out[2][i]] == [0.0; 3] {
                    [out[0][i], out[1][i], out[2][i]] = [screen[0][i], screen[1][i], screen[2][i]];
                }
            }
        }
        out
    }

    /// Light of the sun where it shines, and of the sky.
    #[inline(always)]
    fn light_of_sun(&self, [nx, ny, nz]: &[Lanes; 3], sunlight: &Sunlight<'_>, light: &mut Lanes) {
        let p = self.p;
        let z = self.depth(0, 0);
        let (rx, ry) = self.rays(0, 0);
        let world = |v: Vec3| p.axes[0] * v.x + p.axes[1] * v.y + p.axes[2] * v.z;
        for i in 0..LANES {
            let n = Vec3::new(nx[i], ny[i], nz[i]);
            let up = n.x * p.up.x + n.y * p.up.y + n.z * p.up.z;
            let mut sun = greatest(n.x * p.sun.x + n.y * p.sun.y + n.z * p.sun.z, 0.0);
            if sun > 0.0 && z[i] < f32::INFINITY {
                let size = greatest(p.size * z[i], 1.0);
                let start = Vec3::new(rx[i], ry, 1.0) * z[i] + n * bias(size, 1.0 / (p.pixel * z[i]), p.smooth);
                sun = if sunlight.lit(world(start), size) { sun } else { 0.0 };
            }
            light[i] = p.ambient + (1.0 - p.ambient) * (0.25 * up + 0.25 + 0.75 * sun);
        }
    }

    /// Sums of the differences to the neighbours along an axis of the screen.
    #[inline(always)]
    fn tangent(&self, dx: i32, dy: i32) -> [Lanes; 3] {
        let z = self.depth(0, 0);
        let (rx, ry) = self.rays(0, 0);
        let [mut sx, mut sy, mut sz] = [[0.0; LANES]; 3];
        for k in [1, 2, 4] {
            let (zf, zb) = (self.depth(k * dx, k * dy), self.depth(-k * dx, -k * dy));
            let ((xf, yf), (xb, yb)) = (self.rays(k * dx, k * dy), self.rays(-k * dx, -k * dy));
            let per_depth = 0.02 * k as f32;
            for i in 0..LANES {
                let (z, zf, zb) = (z[i], zf[i], zb[i]);
                // The side on the same surface, if one is: a jump of more than what a steep slope makes is an edge.
                let (jump_f, jump_b) = ((zf - z).abs(), (zb - z).abs());
                let forward = mask(jump_f <= jump_b);
                let near = mask(least(jump_f, jump_b) < per_depth * z + 1.5);
                let zs = select(forward, zf, zb);
                let (xs, ys) = (select(forward, xf[i], xb[i]), select(forward, yf, yb));
                let sign = !forward & SIGN;
                let take = |v: f32| f32::from_bits((v.to_bits() ^ sign) & near);
                sx[i] += take(xs * zs - rx[i] * z);
                sy[i] += take(ys * zs - ry * z);
                sz[i] += take(zs - z);
            }
        }
        [sx, sy, sz]
    }

    /// Unit normals towards the eye, in camera axes.
    #[inline(always)]
    fn normal(&self) -> [Lanes; 3] {
        let z = self.depth(0, 0);
        let (rx, ry) = self.rays(0, 0);
        let [ax, ay, az] = self.tangent(1, 0);
        let [bx, by, bz] = self.tangent(0, 1);
        let [mut nx, mut ny, mut nz] = [[0.0; LANES]; 3];
        let mut flat = [0u32; LANES];
        for i in 0..LANES {
            let (x, y) = (ay[i] * bz[i] - az[i] * by[i], az[i] * bx[i] - ax[i] * bz[i]);
            let n = [x, y, ax[i] * by[i] - ay[i] * bx[i]];
            let length2 = n[0] * n[0] + n[1] * n[1] + n[2] * n[2];
            let away = n[0] * (rx[i] * z[i]) + n[1] * (ry * z[i]) + n[2] * z[i] > 0.0;
            let scale = 1.0 / length2.sqrt();
            let scale = if away { -scale } else { scale };
            [nx[i], ny[i], nz[i]] = n.map(|v| v * scale);
            flat[i] = u32::from(!(length2 > 0.0 && length2 < f32::INFINITY));
        }
        if flat.iter().sum::<u32>() > 0 {
            for i in 0..LANES {
                let n = Vec3::new(nx[i], ny[i], nz[i]);
                if !(n.is_finite() && n != Vec3::ZERO) {
                    // Towards the eye.
                    let here = Vec3::new(rx[i], ry, 1.0) * z[i];
                    [nx[i], ny[i], nz[i]] = (-here.normalize_or(Vec3::Z)).to_array();
                }
            }
        }
        [nx, ny, nz]
    }

    /// Takes from the light what the surroundings take.
    #[inline(always)]
    fn occlude(&self, [nx, ny, nz]: &[Lanes; 3], light: &mut Lanes) {
        let p = self.p;
        let z = self.depth(0, 0);
        let (rx, ry) = self.rays(0, 0);
        let [mut bias, mut per_square, mut least_square, mut sum] = [[0.0; LANES]; 4];
        for i in 0..LANES {
            let radius = p.radius_px * p.pixel * z[i];
            let square = radius * radius;
            (bias[i], least_square[i], per_square[i]) = (0.02 * radius, 0.01 * square, 1.0 / square);
        }
        // One of 16 turns in a 4 × 4 pattern.
        let turn = ((((self.x & 3) * 4 + (self.y & 3)) * 7) & 15) as usize * p.samples as usize;
        for &[dx, dy] in &p.spiral[turn..turn + p.samples as usize] {
            let zs = self.depth(dx, dy);
            let (xs, ys) = self.rays(dx, dy);
            for i in 0..LANES {
                // A neighbour in the sky makes NaN or nothing of both factors: it takes no light.
                let v = [xs[i] * zs[i] - rx[i] * z[i], ys * zs[i] - ry * z[i], zs[i] - z[i]];
                let square = v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
                let above = v[0] * nx[i] + v[1] * ny[i] + v[2] * nz[i] - bias[i];
                let fade = greatest(1.0 - square * per_square[i], 0.0);
                sum[i] += greatest(above / (square + least_square[i]).sqrt(), 0.0) * fade;
            }
        }
        let share = SSAO_STRENGTH * 2.0 / p.samples as f32;
        for (light, &sum) in light.iter_mut().zip(&sum) {
            *light *= 1.0 - least(share * sum, 0.85);
        }
    }
}

/// Normals of the screen, of each pixel, in camera axes; of the sky anything.
#[cfg(test)]
pub(crate) fn screen_normals(camera: &Camera, options: &Options, depth: &[f32]) -> Vec<Vec3> {
    let p = ShadeParams::new(camera, options);
    let mut scratch = Scratch::default();
    scratch.fill(&p, depth);
    let lighting = Lighting::default();
    let mut out = vec![Vec3::ZERO; depth.len()];
    for y in 0..p.height {
        for first in (0..p.width).step_by(PHASES * LANES) {
            for phase in 0..PHASES as i32 {
                let x = first + phase;
                let n = Block { p: &p, lighting: &lighting, scratch: &scratch, x, y }.normal();
                for lane in (0..LANES).filter(|&lane| x + ((PHASES * lane) as i32) < p.width) {
                    let at = (y * p.width + x) as usize + PHASES * lane;
                    out[at] = Vec3::new(n[0][lane], n[1][lane], n[2][lane]);
                }
            }
        }
    }
    out
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall across the view, of one colour, and sky beside it.
    fn wall(camera: &Camera, options: &Options, scratch: &mut Scratch) -> Vec<[u8; 4]> {
        let n = (camera.width * camera.height) as usize;
        let beside = |i: usize| i as u32 % camera.width < camera.width / 4;
        let depth: Vec<f32> = (0..n).map(|i| if beside(i) { f32::INFINITY } else { 30.0 }).collect();
        let color: Vec<u32> =
            (0..n).map(|i| if beside(i) { 0 } else { u32::from_le_bytes([204, 104, 50, 255]) }).collect();
        let mut out = vec![[1; 4]; n];
        shade(&ShadeParams::new(camera, options), &color, &depth, &Lighting::default(), scratch, &mut out);
        out
    }

    fn camera(yaw: f64, pitch: f64, [width, height]: [u32; 2]) -> Camera {
        Camera { eye: glam::DVec3::ZERO, yaw, pitch, roll: 0.0, fov: 60.0, width, height }
    }

    /// Light is 0.3 + 0.7 · (0.25 · up + 0.25 + 0.75 · towards the sun), of a wall that faces the camera.
    #[test]
    fn sun_lights_what_faces_it() {
        let lit = |yaw, pitch, sun| {
            let options = Options { shading: Shading::None, sun: Some(sun), ..Options::default() };
            wall(&camera(yaw, pitch, [61, 41]), &options, &mut Scratch::default())[20 * 61 + 40]
        };
        // Looking north, one sees walls that face south.
        assert_eq!(lit(0.0, 0.0, [180.0, 0.0]), [204, 104, 50, 255]);
        assert_eq!(lit(0.0, 0.0, [0.0, 0.0]), [97, 49, 24, 255]);
        assert_eq!(lit(0.0, 0.0, [90.0, 0.0]), [97, 49, 24, 255]);
        // Looking east, west.
        assert_eq!(lit(90.0, 0.0, [270.0, 0.0]), [204, 104, 50, 255]);
        assert_eq!(lit(90.0, 0.0, [270.0, 60.0]), [150, 77, 37, 255]);
        // The ground under the sun; 255 is the end.
        assert_eq!(lit(0.0, -90.0, [33.0, 90.0]), [240, 122, 59, 255]);
    }

    #[test]
    fn sky_is_transparent_where_it_is_not_shown() {
        for shading in [Shading::None, Shading::Full] {
            let at = camera(20.0, -10.0, [300, 5]);
            let [shown, none] = [true, false]
                .map(|sky| wall(&at, &Options { shading, sky, ..Options::default() }, &mut Scratch::default()));
            for (i, (shown, none)) in shown.iter().zip(&none).enumerate() {
                assert_eq!(*none, if i % 300 < 75 { [0; 4] } else { *shown });
                assert_eq!(shown[3], 255);
            }
        }
    }

    /// Frames of any size, one after the other.
    #[test]
    fn scratch_that_is_used_again_changes_nothing() {
        let mut scratch = Scratch::default();
        let sizes = [[300, 70], [1, 1], [300, 70], [3, 2], [257, 9], [1, 40], [256, 8], [4, 4], [5, 4]];
        for (size, shading) in
            sizes.into_iter().flat_map(|s| [(s, Shading::Full), (s, Shading::None), (s, Shading::Ssn)])
        {
            let options = Options { shading, ..Options::default() };
            let at = camera(20.0, -10.0, size);
            assert!(
                wall(&at, &options, &mut scratch) == wall(&at, &options, &mut Scratch::default()),
                "{size:?} {shading:?}"
            );
        }
    }
}
