//! Stages `traverse` and `remap` of the whole sphere around an eye ([`crate::frame::plane_setup::sphere`]): planes are walked where a
//! picture shows what nobody filled, and kept; any projection's pixels look them up by their rays.
//!
//! A pixel finds its plane by the azimuth of its ray, its sample by the slope; from there on it does what
//! [`crate::cpu::remap::remap_retest`] does: its own ray tests the voxels of the samples around.

use crate::cpu::refine::{self, Doubt};
use crate::cpu::remap::{BLOCK, Boxes, MISS, Pixels, SETTLED, all_sky, color_of, missed, ray_inverse};
use crate::cpu::traverse::{Counters, PlaneBuffer, Real, SKY, has_avx2};
use crate::frame::camera::Camera;
use crate::frame::options::{Options, Remap};
use crate::frame::plane_setup::Setup;
use crate::frame::plane_setup::sphere::{BANDS, Layout, sphere_setup};
use crate::frame::projection::Rays;
use crate::frame::specialize::{Specialization, Twin};
use crate::world::tables::Resident;
use glam::DVec3;
use rayon::prelude::*;

/// What planes around one eye show, as far as pictures asked for it.
pub struct Sphere {
    pub setup: Setup,
    pub specialization: Specialization,
    layout: Layout,
    eye: DVec3,
    options: Options,
    buffer: PlaneBuffer,
}

/// Rows that one task remaps.
const ROWS_A_TASK: usize = 16;

/// What of the options planes depend on.
fn planes_of(options: &Options) -> Options {
    let usual = Options::default();
    Options {
        view_distance: options.view_distance,
        repeat: options.repeat,
        lod: options.lod,
        culling: options.culling,
        equidistant: options.equidistant,
        f64_traversal: options.f64_traversal,
        specialize: options.specialize,
        // Pixels test voxels, whatever is asked for: samples are not theirs.
        remap: Remap::Retest,
        gap_fill: true,
        ..usual
    }
}

impl Sphere {
    /// Whether it is of this eye and world as drawn with these options, as fine as `layout`.
    pub fn serves(&self, camera: &Camera, options: &Options, layout: &Layout) -> bool {
        self.eye == camera.eye && self.options == planes_of(options) && self.layout.serves(layout)
    }

    /// Nothing is filled; takes the memory of one that is done with.
    pub fn new(
        resident: &Resident,
        camera: &Camera,
        options: &Options,
        layout: Layout,
        old: Option<Box<Sphere>>,
    ) -> Sphere {
        let options = planes_of(options);
        let mut setup = sphere_setup(resident, camera, &layout, &options);
        setup.done = vec![false; setup.planes.len()];
        let specialization = Specialization::new(resident, &setup, camera, &options, Twin::Cpu);
        let buffer = match old {
            Some(old) if old.setup.samples == setup.samples => old.buffer,
            // Zeros: memory is touched where it is filled.
            _ => PlaneBuffer {
                color: vec![0; setup.samples],
                depth: vec![0.0; setup.samples],
                voxel: vec![[0; 4]; setup.samples],
            },
        };
        Sphere { setup, specialization, layout, eye: camera.eye, options, buffer }
    }

    /// Walks the planes that a picture asks for and that are not filled.
    pub fn fill(&mut self, resident: &Resident, camera: &Camera, rays: &Rays) -> Counters {
        if !self.setup.done.contains(&false) {
            return Counters::default();
        }
        let wanted = self.wanted(camera, rays);
        let before = std::mem::take(&mut self.setup.done);
        self.setup.done = before.iter().zip(&wanted).map(|(&done, &wanted)| done || wanted == 0).collect();
        let traverse = if self.options.f64_traversal { f64::traverse } else { f32::traverse };
        let counters = match self.setup.done.contains(&false) {
            true => traverse(resident, &self.setup, self.options.culling, self.specialization, &mut self.buffer, true),
            false => Counters::default(),
        };
        self.setup.done = before.into_iter().zip(wanted).map(|(done, wanted)| done || wanted != 0).collect();
        counters
    }

    /// Which planes the pixels of a picture look at, not 0.
    fn wanted(&self, camera: &Camera, rays: &Rays) -> Vec<u8> {
        let n = self.setup.planes.len();
        if rays.is_round() && rays.shows_all() && self.layout.azimuths >= camera.width / 2 {
            // All azimuths; and all bands, but those that nothing is drawn of.
            return self.setup.planes.iter().map(|p| u8::from(p.first < p.end)).collect();
        }
        let looks = Looks::new(&self.layout);
        let (w, h) = (camera.width, camera.height);
        let tasks = (0..h.div_ceil(ROWS_A_TASK as u32)).into_par_iter();
        let one = |task: u32| {
            let mut wanted = vec![0; n];
            let mut dir = [[0.0; BLOCK]; 3];
            for y in task * ROWS_A_TASK as u32..((task + 1) * ROWS_A_TASK as u32).min(h) {
                for from in (0..w).step_by(BLOCK) {
                    let m = BLOCK.min((w - from) as usize);
                    let [dx, dy, dz] = &mut dir;
                    rays.fill(from, y, [&mut dx[..m], &mut dy[..m], &mut dz[..m]]);
                    for i in 0..m {
                        let look = looks.at([dx[i], dy[i], dz[i]]);
                        let band = |sample: u32| sample / self.layout.band;
                        let last = self.layout.samples() - 1;
                        let (low, high) = (band(look.sample.saturating_sub(1)), band((look.sample + 1).min(last)));
                        for plane in [look.plane, look.second] {
                            for band in low..=high {
                                wanted[(plane * BANDS + band) as usize] = 1;
                            }
                        }
                    }
                }
            }
            wanted
        };
        tasks.map(one).reduce(Vec::new, |mut a, b| {
            if a.is_empty() {
                return b;
            }
            a.iter_mut().zip(b).for_each(|(a, b)| *a |= b);
            a
        })
    }

    /// Colour, depth along the ray and, where wanted, voxel and doubt of each pixel. What it looks at must be filled.
    pub fn remap(&self, resident: &Resident, camera: &Camera, rays: &Rays, pixels: &mut Pixels<'_>) {
        let w = camera.width as usize;
        let avx2 = has_avx2();
        let looks = Looks::new(&self.layout);
        let Pixels { color, depth, voxel, doubt } = pixels;
        let tasks = color.chunks_mut(ROWS_A_TASK * w).zip(depth.chunks_mut(ROWS_A_TASK * w));
        let (mut voxels, mut doubts) = (voxel.chunks_mut(ROWS_A_TASK * w), doubt.chunks_mut(ROWS_A_TASK * w));
        let tasks = tasks.map(|(color, depth)| Pixels {
            color,
            depth,
            voxel: voxels.next().unwrap_or_default(),
            doubt: doubts.next().unwrap_or_default(),
        });
        let tasks: Vec<_> = tasks.collect();
        tasks.into_par_iter().enumerate().for_each(|(task, pixels)| {
            let task = Task { sphere: self, looks, resident, rays, first_row: (task * ROWS_A_TASK) as u32, w, pixels };
            #[cfg(target_arch = "x86_64")]
            if avx2 {
                // SAFETY: `has_avx2` has seen that the processor can.
                return unsafe { remap_rows_avx2(task) };
            }
            let _ = avx2;
            remap_rows(task);
        });
    }

    /// Walks the rays of all pixels in doubt.
    pub fn refine(&self, resident: &Resident, camera: &Camera, rays: &Rays, pixels: &mut Pixels<'_>) {
        let Pixels { color, depth, voxel, doubt } = pixels;
        if doubt.is_empty() {
            return;
        }
        let w = camera.width as usize;
        let walk = refine::Walk::new(resident, &self.setup);
        let mut voxels = voxel.chunks_mut(w);
        let rows = color.chunks_mut(w).zip(depth.chunks_mut(w)).zip(doubt.chunks(w));
        let rows: Vec<_> = rows.map(|row| (row, voxels.next().unwrap_or_default())).collect();
        rows.into_par_iter().enumerate().for_each(|(y, (((color, depth), doubt), voxel))| {
            for x in 0..w {
                if doubt[x] == Doubt::NONE {
                    continue;
                }
                let mut dir = [[0.0f32]; 3];
                let [dx, dy, dz] = &mut dir;
                rays.fill(x as u32, y as u32, [dx, dy, dz]);
                let ray = refine::Ray::new(dir.map(|[d]| d), self.setup.view_distance as f32);
                if let Some(met) = walk.settle(&ray, doubt[x], depth[x]) {
                    (color[x], depth[x]) = (met.color, met.depth);
                    if let Some(voxel) = voxel.get_mut(x) {
                        *voxel = met.voxel;
                    }
                }
            }
        });
    }

    /// Whether pixels in doubt can be told more: where any shows level 0.
    pub fn refines(&self, options: &Options) -> bool {
        options.remap == Remap::Refine && self.setup.planes.iter().any(|plane| plane.lod_first == 0)
    }
}

/// From a direction to planes and samples.
#[derive(Clone, Copy)]
struct Looks {
    azimuths: f32,
    /// Azimuths a radian, and the first one's start, in azimuths.
    per_radian: f32,
    start: f32,
    band: f32,
    drawn: [f32; 2],
}

/// What a direction looks at: azimuths of the two planes beside it, the nearest first, the samples of each, and the depth along
/// the direction that is one of the plane. The second plane's sample is the one on the direction's other side: where it and the
/// first show the same, what is between them does.
#[derive(Clone, Copy)]
struct Look {
    plane: u32,
    second: u32,
    sample: u32,
    beside: u32,
    scale: f32,
}

impl Looks {
    fn new(layout: &Layout) -> Looks {
        let n = f64::from(layout.azimuths);
        let per_radian = n / std::f64::consts::TAU;
        Looks {
            azimuths: n as f32,
            per_radian: per_radian as f32,
            // 0 to n, so that what is taken from it stays small.
            start: (layout.start * per_radian).rem_euclid(n) as f32,
            band: layout.band as f32,
            drawn: [layout.drawn[0] as f32, f64::from(layout.drawn[1].max(layout.drawn[0] + 1) - 1) as f32],
        }
    }

    #[inline(always)]
    fn at(&self, [dx, dy, dz]: [f32; 3]) -> Look {
        let level = (dx * dx + dz * dz).sqrt();
        let k = azimuth(dx, -dz) * self.per_radian - self.start;
        let k = if k < 0.0 { k + self.azimuths } else { k };
        let k = if k < 0.0 { k + self.azimuths } else { k };
        let last = self.azimuths - 1.0;
        let plane = k.truncate(last);
        let side = if k - plane as f32 >= 0.5 { 1 } else { -1 };
        let n = self.azimuths as i32;
        let second = plane + side;
        let second = if second < 0 {
            n - 1
        } else if second >= n {
            0
        } else {
            second
        };
        let up = dy.abs();
        let steep = up > level;
        let most = Real::max(if steep { up } else { level }, 1e-30);
        let quotient = (if steep { level } else { dy }) / most;
        let place = if !steep {
            2.0 + quotient
        } else if dy > 0.0 {
            4.0 - quotient
        } else {
            quotient
        };
        let place = Real::min(Real::max(place * self.band, self.drawn[0]), self.drawn[1] + 0.99);
        let sample = place.truncate(self.drawn[1]) as f32;
        let beside = if place - sample >= 0.5 { sample + 1.0 } else { sample - 1.0 };
        let beside = Real::min(Real::max(beside, self.drawn[0]), self.drawn[1]).truncate(self.drawn[1]);
        let [plane, second, sample, beside] = [plane, second, sample as i32, beside].map(|v| v as u32);
        Look { plane, second, sample, beside, scale: 1.0 / most }
    }
}

/// The angle from `y` to `x`, −π to π, within 2·10⁻⁶: planes are hundreds of times as far apart, and a pixel in the middle
/// between two may take either.
#[inline(always)]
fn azimuth(x: f32, y: f32) -> f32 {
    use std::f32::consts::{FRAC_PI_2, PI};
    let (ax, ay) = (x.abs(), y.abs());
    let (low, high) = (Real::min(ax, ay), Real::max(ax, ay));
    let q = low / Real::max(high, 1e-30);
    let s = q * q;
    // Minimax of the arc tangent on 0 to 1.
    let p = 0.007_825_483;
    let p = -0.036_898_629 + s * p;
    let p = 0.083_741_56 + s * p;
    let p = -0.134_804_06 + s * p;
    let p = 0.198_798_72 + s * p;
    let p = -0.333_263_75 + s * p;
    let p = 0.999_999_3 + s * p;
    let angle = q * p;
    let angle = if ax > ay { FRAC_PI_2 - angle } else { angle };
    let angle = if y < 0.0 { PI - angle } else { angle };
    if x < 0.0 { -angle } else { angle }
}

/// Some rows of a picture.
struct Task<'a> {
    sphere: &'a Sphere,
    looks: Looks,
    resident: &'a Resident,
    rays: &'a Rays,
    first_row: u32,
    w: usize,
    pixels: Pixels<'a>,
}

/// The same code for processors with AVX2; the same bits.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
fn remap_rows_avx2(task: Task<'_>) {
    remap_rows(task);
}

/// A stretch of a row, as `remap` has it.
struct Block {
    dir: [[f32; BLOCK]; 3],
    inverse: [[f32; BLOCK]; 3],
    planes: [[u32; BLOCK]; 2],
    sample: [u32; BLOCK],
    scale: [f32; BLOCK],
    at: [[u32; BLOCK]; 2],
    near: [[f32; BLOCK]; 2],
    nearest: [f32; BLOCK],
    voxel: [[[i32; BLOCK]; 4]; 2],
    /// Of pixels that look again.
    again: [u8; BLOCK],
    again_at: [u32; BLOCK],
    again_inverse: [[f32; BLOCK]; 3],
    again_near: [f32; BLOCK],
}

#[inline(always)]
fn remap_rows(task: Task<'_>) {
    let Task { sphere, looks, resident, rays, first_row, w, pixels } = task;
    let Pixels { color, depth, voxel, doubt } = pixels;
    let (setup, layout) = (&sphere.setup, &sphere.layout);
    let (shown, depths) = (&sphere.buffer.voxel[..], &sphere.buffer.depth[..]);
    let colors = Some(&sphere.buffer.color[..]).filter(|colors| !colors.is_empty());
    let n = layout.samples();
    let [first, end] = layout.drawn;
    let doubts = !doubt.is_empty();
    let boxes = Boxes { eye: setup.eye_cell, fract: setup.eye_fract.map(|f| f as f32) };
    let mut b = Block {
        dir: [[0.0; BLOCK]; 3],
        inverse: [[0.0; BLOCK]; 3],
        planes: [[0; BLOCK]; 2],
        sample: [0; BLOCK],
        scale: [0.0; BLOCK],
        at: [[0; BLOCK]; 2],
        near: [[0.0; BLOCK]; 2],
        nearest: [SETTLED; BLOCK],
        voxel: [[[0; BLOCK]; 4]; 2],
        again: [0; BLOCK],
        again_at: [0; BLOCK],
        again_inverse: [[0.0; BLOCK]; 3],
        again_near: [0.0; BLOCK],
    };
    for (r, from) in (0..depth.len() / w).flat_map(|r| (0..w).step_by(BLOCK).map(move |from| (r, from))) {
        let m = BLOCK.min(w - from);
        let y = first_row + r as u32;
        let [dx, dy, dz] = &mut b.dir;
        rays.fill(from as u32, y, [&mut dx[..m], &mut dy[..m], &mut dz[..m]]);
        for i in 0..m {
            let look = looks.at([dx[i], dy[i], dz[i]]);
            (b.planes[0][i], b.planes[1][i], b.sample[i], b.scale[i]) =
                (look.plane, look.second, look.sample, look.scale);
            (b.at[0][i], b.at[1][i]) = (look.plane * n + look.sample, look.second * n + look.beside);
        }
        for (inverse, dir) in b.inverse.iter_mut().zip(&b.dir) {
            for (inverse, &dir) in inverse[..m].iter_mut().zip(&dir[..m]) {
                *inverse = ray_inverse(dir);
            }
        }
        for ((at, near), voxel) in b.at.iter().zip(&mut b.near).zip(&mut b.voxel) {
            boxes.enter_each(shown, &at[..m], &b.inverse, voxel, near);
        }
        let ([own, beside], [near, near_beside]) = (&mut b.at, &mut b.near);
        let mut n_again = 0;
        for i in 0..m {
            let (one, other) = (near[i], near_beside[i]);
            let sky = one == other && all_sky(shown, own[i]) && all_sky(shown, beside[i]);
            b.again[n_again] = i as u8;
            n_again += usize::from((one == MISS || other == MISS) && !sky);
        }
        if doubts {
            // No doubt where all four samples around show one voxel, and the ray meets it; nor of coarser levels.
            for i in 0..m {
                let (one, other) = (own[i] as usize, beside[i] as usize);
                let third = (b.planes[0][i] * n + beside[i] % n) as usize;
                let fourth = (b.planes[1][i] * n + b.sample[i]) as usize;
                let voxel = shown[one];
                let same = voxel == shown[other] && voxel == shown[third] && voxel == shown[fourth];
                let coarse = voxel[3].max(shown[other][3]) > 0;
                b.nearest[i] = match coarse || (same && near[i] != MISS) || (same && voxel[3] < 0) {
                    true => SETTLED,
                    false => {
                        let pairs = [[one, other], [third, fourth]].map(|[a, b]| Real::min(depths[a], depths[b]));
                        Real::min(pairs[0], pairs[1]) * b.scale[i]
                    }
                };
            }
        }
        for i in 0..m {
            (own[i], near[i]) = if near_beside[i] < near[i] { (beside[i], near_beside[i]) } else { (own[i], near[i]) };
        }
        for (j, &i) in b.again[..n_again].iter().enumerate() {
            for (compact, all) in b.again_inverse.iter_mut().zip(&b.inverse) {
                compact[j] = all[usize::from(i)];
            }
        }
        for (planes, step) in [(0, -1), (0, 1), (1, -1), (1, 0), (1, 1)].map(|(k, step)| (&b.planes[k], step)) {
            for (at, &i) in b.again_at.iter_mut().zip(&b.again[..n_again]) {
                let i = usize::from(i);
                let sample = b.sample[i].wrapping_add_signed(step);
                *at = if (first..end).contains(&sample) { planes[i] * n + sample } else { own[i] };
            }
            boxes.enter_each(shown, &b.again_at[..n_again], &b.again_inverse, &mut b.voxel[0], &mut b.again_near);
            for ((&at, &z), &i) in b.again_at.iter().zip(&b.again_near).zip(&b.again[..n_again]) {
                let i = usize::from(i);
                (own[i], near[i]) = if z < near[i] { (at, z) } else { (own[i], near[i]) };
                if doubts {
                    let coarse = shown[at as usize][3] > 0;
                    let depth = if coarse { MISS } else { depths[at as usize] * b.scale[i] };
                    b.nearest[i] = Real::min(b.nearest[i], depth);
                }
            }
        }
        let out = r * w + from..r * w + from + m;
        if doubts {
            for ((doubt, &nearest), &near) in doubt[out.clone()].iter_mut().zip(&b.nearest[..m]).zip(&near[..m]) {
                *doubt = Doubt::new(nearest, near != MISS);
            }
        }
        for (j, &i) in b.again[..n_again].iter().enumerate() {
            let i = usize::from(i);
            if near[i] == MISS {
                let inverse = [0, 1, 2].map(|axis| b.again_inverse[axis][j]);
                own[i] = missed(shown, &boxes, [own[i], beside[i]], inverse);
                near[i] = depths[own[i] as usize] * b.scale[i];
            }
        }
        depth[out.clone()].copy_from_slice(&near[..m]);
        let pixels = color[out.clone()].iter_mut().zip(&own[..m]);
        match colors {
            Some(colors) => pixels.for_each(|(c, &at)| *c = colors[at as usize]),
            None => {
                let mut last = (SKY, 0);
                for (c, &at) in pixels {
                    let voxel = shown[at as usize];
                    if voxel != last.0 {
                        last = (voxel, color_of(resident, voxel));
                    }
                    *c = last.1;
                }
            }
        }
        if !voxel.is_empty() {
            for (v, &at) in voxel[out.clone()].iter_mut().zip(&own[..m]) {
                *v = shown[at as usize];
            }
        }
        if !rays.shows_all() {
            for (_, i) in out.enumerate().filter(|(x, _)| rays.direction((from + x) as u32, y).is_none()) {
                (color[i], depth[i]) = (0, f32::INFINITY);
                if let Some(voxel) = voxel.get_mut(i) {
                    *voxel = SKY;
                }
                if doubts {
                    doubt[i] = Doubt::NONE;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn azimuths_are_those_of_the_arc_tangent() {
        let worst = (0..200_000).map(|i| {
            let (s, c) = (f64::from(i) / 200_000.0 * std::f64::consts::TAU - std::f64::consts::PI).sin_cos();
            let error = f64::from(azimuth(s as f32 * 3.0, c as f32 * 3.0)) - (s as f32 as f64).atan2(c as f32 as f64);
            // Either end of the circle.
            error.abs().min((error.abs() - std::f64::consts::TAU).abs())
        });
        let worst = worst.fold(0.0, f64::max);
        assert!(worst < 1e-5, "{worst}");
        assert_eq!([azimuth(0.0, 1.0), azimuth(0.0, 0.0)], [0.0, 0.0]);
    }
}
