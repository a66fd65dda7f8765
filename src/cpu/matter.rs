//! Translucent matter over a picture of what is solid: spans of columns, front to back, composited by the exact length of each
//! pixel's way through them.
//!
//! A pixel's ray walks the columns of the level that its distance asks for, from where it meets the matter's box to what is solid
//! there. Blocks of columns without matter at the ray's heights are jumped over. Neighbouring spans of one code are one: their length is
//! added up before it becomes a share of light, so that fog costs an addition a column. Where less than 1/256 of the light is left,
//! the ray ends, and what it has seen stands for the rest.

use crate::cpu::exact::view_distance;
use crate::cpu::traverse::has_avx2;
use crate::frame::camera::Camera;
use crate::frame::options::Options;
use crate::frame::picture::Frame;
use crate::frame::projection::{Projection, Rays};
use crate::world::matter::{BLOCK_SHIFT, Look, SceneMatter};
use glam::DVec3;
use planecast_encoder::model::matter::Mode;
use rayon::prelude::*;

/// Optical depth at which a pixel is closed: 1/256 of the light is left.
pub(crate) const CLOSED: f32 = 5.545_177_4;

/// [`crate::world::matter::Optics`] in the precision of pictures.
#[derive(Clone, Copy)]
struct Entry {
    color: [f32; 3],
    extinction: f32,
    mode: Mode,
    material: u16,
}

/// What matter does to the light of one pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    /// What it sends, 0 to 255.
    pub color: [f32; 3],
    /// The share of what is behind that comes through.
    pub left: f32,
}

impl Light {
    pub const CLEAR: Light = Light { color: [0.0; 3], left: 1.0 };

    /// The colour of a pixel behind, through the matter.
    pub fn over(self, behind: [u8; 4]) -> [u8; 4] {
        if self == Light::CLEAR {
            return behind;
        }
        let rounded = |v: f32| (v + 0.5).clamp(0.0, 255.0) as u8;
        let [r, g, b, alpha] = behind.map(f32::from);
        let alpha = alpha / 255.0;
        // Of what is transparent nothing comes through, and the picture keeps how much is missing.
        let through = self.left * alpha;
        let whole = 1.0 - self.left + through;
        let mix = |own: f32, behind: f32| rounded(if whole > 0.0 { (own + through * behind) / whole } else { 0.0 });
        let [red, green, blue] = self.color;
        [mix(red, r), mix(green, g), mix(blue, b), rounded(whole * 255.0)]
    }
}

/// A walk through the matter of a scene.
struct Walk<'a> {
    matter: &'a SceneMatter,
    look: &'a Look,
    entries: Vec<Entry>,
    repeats: [bool; 2],
    /// The coarsest level that is walked.
    coarsest: u32,
    /// Distance at which a voxel of level 0 is as large as the level of detail asks for, in units of a ray's length; infinite: level 0
    /// everywhere.
    finest: f32,
    view: f64,
}

/// Light on its way.
struct Ray {
    light: Light,
    /// Optical depth so far.
    depth: f32,
    code: usize,
    /// Length of the span under way, voxels.
    len: f32,
}

impl Ray {
    /// The span ends.
    #[inline(always)]
    fn flush(&mut self, entries: &[Entry]) {
        let entry = &entries[self.code];
        let taken = entry.extinction * self.len;
        self.len = 0.0;
        if taken > 0.0 && entry.mode != Mode::Surface {
            self.add(entry, taken);
        }
    }

    #[inline(always)]
    fn add(&mut self, entry: &Entry, taken: f32) {
        if entry.mode == Mode::Additive {
            (0..3).for_each(|i| self.light.color[i] += self.light.left * taken * entry.color[i]);
            return;
        }
        self.depth += taken;
        let left = self.light.left * (-taken).exp();
        let share = self.light.left - left;
        (0..3).for_each(|i| self.light.color[i] += share * entry.color[i]);
        self.light.left = left;
    }

    /// A way of `len` through `code`, behind what was before. Whether the pixel stays open.
    #[inline(always)]
    fn pass(&mut self, code: usize, len: f32, entries: &[Entry]) -> bool {
        if code == self.code {
            self.len += len;
        } else {
            self.flush(entries);
            let (entry, before) = (&entries[code], entries[self.code].material);
            if entry.mode == Mode::Surface && entry.extinction > 0.0 && entry.material != before {
                self.add(entry, entry.extinction);
            }
            (self.code, self.len) = (code, len);
        }
        let entry = &entries[code];
        let under_way =
            if matches!(entry.mode, Mode::Volumetric | Mode::Emissive) { entry.extinction * self.len } else { 0.0 };
        self.depth + under_way < CLOSED
    }

    fn finish(mut self, entries: &[Entry]) -> Light {
        self.flush(entries);
        if self.depth >= CLOSED {
            // What was not looked at is taken to be as what was.
            let seen = 1.0 / (1.0 - self.light.left);
            self.light = Light { color: self.light.color.map(|c| c * seen), left: 0.0 };
        }
        self.light
    }
}

/// The coarsest level that can be walked: one repeats with the world only where its voxels do.
pub(crate) fn coarsest(matter: &SceneMatter, options: &Options) -> u32 {
    let [nx, _, nz] = matter.levels[0].dims();
    let whole = |n: u32, repeats: bool| if repeats { n.trailing_zeros() } else { u32::MAX };
    (matter.levels.len() as u32 - 1).min(whole(nx, options.repeat.x)).min(whole(nz, options.repeat.z))
}

/// Distance, in lengths of a ray's direction, at which a voxel of level 0 is as large as the level of detail asks for; infinite where
/// level 0 is drawn everywhere.
pub(crate) fn finest(camera: &Camera, options: &Options) -> f32 {
    let pixel = match options.projection {
        Projection::Perspective => 2.0 * camera.half_extent().y / f64::from(camera.height),
        Projection::Ortho { .. } => 0.0,
        Projection::Fisheye => camera.fov.to_radians() / f64::from(camera.width.min(camera.height)),
        Projection::Cube => 4.0 / f64::from(camera.height),
        Projection::Equirect | Projection::Lidar { .. } => std::f64::consts::TAU / f64::from(camera.width),
    };
    options.lod.map_or(f64::INFINITY, |lod| 1.0 / (lod * pixel)) as f32
}

impl<'a> Walk<'a> {
    fn new(matter: &'a SceneMatter, look: &'a Look, camera: &Camera, options: &Options) -> Walk<'a> {
        let entries = look.optics.iter().map(|o| Entry {
            color: o.color.map(|c| c as f32),
            extinction: o.extinction as f32,
            mode: o.mode,
            material: o.material,
        });
        let repeats = [options.repeat.x, options.repeat.z];
        let (coarsest, finest) = (coarsest(matter, options), finest(camera, options));
        Walk { matter, look, entries: entries.collect(), repeats, coarsest, finest, view: view_distance(options) }
    }

    /// What the ray from `origin` along `dir` meets before `t_end`, in lengths of `dir`.
    #[inline(always)]
    fn light(&self, origin: DVec3, dir: DVec3, t_end: f64) -> Light {
        let [nx, _, nz] = self.matter.levels[0].dims().map(f64::from);
        let (mut start, mut end) = (0.0f64, t_end);
        let horizontal = dir.x.hypot(dir.z);
        if horizontal > 0.0 {
            end = end.min(self.view / horizontal);
        }
        for k in 0..3 {
            let (o, d, [low, high]) = match k {
                0 if !self.repeats[0] => (origin.x, dir.x, [0.0, nx]),
                1 if !self.repeats[1] => (origin.z, dir.z, [0.0, nz]),
                2 => (origin.y, dir.y, self.heights(end as f32)),
                _ => continue,
            };
            if d == 0.0 {
                if o < low || o >= high {
                    return Light::CLEAR;
                }
                continue;
            }
            let [a, b] = [(low - o) / d, (high - o) / d];
            (start, end) = (start.max(a.min(b)), end.min(a.max(b)));
        }
        if start >= end {
            return Light::CLEAR;
        }
        // From here on near the matter, where f32 is fine enough: whole voxels apart from what is left of them.
        let place = origin + start * dir;
        let cell = place.floor();
        let near = Near {
            cell: [cell.x as i64 as i32, cell.z as i64 as i32],
            fract: [(place.x - cell.x) as f32, (place.z - cell.z) as f32],
            y: place.y as f32,
            dir: [dir.x as f32, dir.y as f32, dir.z as f32],
            before: start as f32,
            unit: dir.length() as f32,
        };
        let mut ray = Ray { light: Light::CLEAR, depth: 0.0, code: 0, len: 0.0 };
        let (mut t, end) = (0.0, (end - start) as f32);
        loop {
            let (level, next) = self.level(near.before + t);
            let stop = end.min(next - near.before);
            let open = self.walk(level, &near, t, stop, &mut ray);
            t = stop;
            if !open || t >= end {
                return ray.finish(&self.entries);
            }
        }
    }

    /// Between which heights matter is seen up to a distance: whole voxels of the level that is drawn there.
    fn heights(&self, t: f32) -> [f64; 2] {
        let level = self.level(t).0;
        let [low, high] = self.look.levels[0].heights;
        [
            f64::from(low >> level << level),
            (f64::from(high) / f64::from(1u32 << level)).ceil() * f64::from(1u32 << level),
        ]
    }

    /// The level to draw at a distance, and where the next begins.
    #[inline(always)]
    fn level(&self, t: f32) -> (u32, f32) {
        if t < self.finest * 2.0 || self.coarsest == 0 {
            return (0, if self.coarsest == 0 { f32::INFINITY } else { self.finest * 2.0 });
        }
        let level = ((t / self.finest).log2().min(31.0) as u32).clamp(1, self.coarsest);
        // The bound again, lest rounding make a step of nothing.
        let next = self.finest * (2u64 << level) as f32;
        match level == self.coarsest {
            true => (level, f32::INFINITY),
            false if next > t => (level, next),
            false => (level + 1, next * 2.0),
        }
    }

    /// Columns of a level from `t` to `stop`; whether the pixel stays open.
    #[inline(always)]
    fn walk(&self, level: u32, near: &Near, mut t: f32, stop: f32, ray: &mut Ray) -> bool {
        let matter = &*self.matter.levels[level as usize];
        let look = &self.look.levels[level as usize];
        let [nx, _, nz] = matter.dims();
        let size = [nx as i32, nz as i32];
        let d = [near.dir[0], near.dir[2]];
        let inverse = d.map(|d| 1.0 / d);
        let scale = 1.0 / (1u32 << level) as f32;
        let (y0, dy) = (near.y * scale, near.dir[1] * scale);
        // Where the line before cell `c` of blocks of `1 << shift` voxels is crossed.
        let cross = |axis: usize, c: i32, shift: u32| -> f32 {
            if d[axis] == 0.0 {
                return f32::INFINITY;
            }
            let line = (c + i32::from(d[axis] > 0.0)) << shift;
            ((line - near.cell[axis]) as f32 - near.fract[axis]) * inverse[axis]
        };
        let step = d.map(|d| if d < 0.0 { -1 } else { 1 });
        let at = |axis: usize, t: f32| ((near.fract[axis] + t * d[axis]).floor() as i32 + near.cell[axis]) >> level;
        let inside = |axis: usize, c: i32| match self.repeats[axis] {
            true => c,
            false => c.clamp(0, size[axis] - 1),
        };
        let mut cell = [inside(0, at(0, t)), inside(1, at(1, t))];
        let mut block = [i32::MAX; 2];
        let mut mask = 0;
        while t < stop {
            // A block of columns, once for all of them.
            let now = cell.map(|c| c >> BLOCK_SHIFT);
            if now != block {
                block = now;
                let whole = [0, 1].map(|k| if self.repeats[k] { cell[k].rem_euclid(size[k]) } else { cell[k] });
                // Where the world repeats, a block may end before eight columns.
                let fits = [0, 1].map(|k| !self.repeats[k] || size[k] % (1 << BLOCK_SHIFT) == 0);
                mask = match fits {
                    [true, true] => {
                        look.blocks[(whole[1] >> BLOCK_SHIFT) as usize * look.across as usize
                            + (whole[0] >> BLOCK_SHIFT) as usize]
                    }
                    _ => u64::MAX,
                };
                let leaves = cross(0, now[0], level + BLOCK_SHIFT).min(cross(1, now[1], level + BLOCK_SHIFT)).min(stop);
                let [a, b] = [y0 + t * dy, y0 + leaves * dy];
                if mask & layers(a.min(b), a.max(b), look.shift) == 0 {
                    ray.pass(0, 0.0, &self.entries);
                    t = t.max(leaves);
                    let before = cell;
                    cell = [inside(0, at(0, t)), inside(1, at(1, t))];
                    // On the line itself, rounding may leave it on this side, or put it back behind a line of the other axis that it
                    // has passed: at a corner of blocks it would go to and fro.
                    for k in 0..2 {
                        cell[k] = if step[k] > 0 { cell[k].max(before[k]) } else { cell[k].min(before[k]) };
                        if cell[k] >> BLOCK_SHIFT == now[k] && cross(k, now[k], level + BLOCK_SHIFT) <= t {
                            cell[k] =
                                if step[k] > 0 { (now[k] + 1) << BLOCK_SHIFT } else { (now[k] << BLOCK_SHIFT) - 1 };
                        }
                        if !self.repeats[k] && !(0..size[k]).contains(&cell[k]) {
                            return true;
                        }
                    }
                    if cell == before && t < stop {
                        // No step is taken twice.
                        block = now;
                        mask = u64::MAX;
                    } else {
                        continue;
                    }
                }
            }
            let next = [cross(0, cell[0], level), cross(1, cell[1], level)];
            let axis = usize::from(next[1] < next[0]);
            let leaves = next[axis].min(stop);
            if leaves > t {
                let whole = [0, 1].map(|k| if self.repeats[k] { cell[k].rem_euclid(size[k]) } else { cell[k] });
                let runs = matter.column(whole[1] as usize * nx as usize + whole[0] as usize);
                let [a, b] = [y0 + t * dy, y0 + leaves * dy];
                if mask & layers(a.min(b), a.max(b), look.shift) == 0 || runs.is_empty() {
                    ray.pass(0, leaves - t, &self.entries);
                } else {
                    // Ways along the ray for each voxel of height, and in all.
                    let whole = (leaves - t) * near.unit;
                    let per = if dy == 0.0 { 0.0 } else { near.unit / dy.abs() };
                    if dy >= 0.0 {
                        let mut y = a;
                        let mut i = runs.partition_point(|r| r.end() as f32 <= a);
                        loop {
                            let (code, end) = runs.get(i).map_or((0, f32::INFINITY), |r| (r.code(), r.end() as f32));
                            let len = if end >= b {
                                if y == a { whole } else { ((b - y) * per).min(whole) }
                            } else {
                                ((end - y) * per).min(whole)
                            };
                            if !ray.pass(code.into(), len, &self.entries) {
                                return false;
                            }
                            if end >= b {
                                break;
                            }
                            (y, i) = (end, i + 1);
                        }
                    } else {
                        let mut y = a;
                        let mut i = runs.partition_point(|r| (r.end() as f32) < a);
                        loop {
                            let code = runs.get(i).map_or(0, |r| r.code());
                            let from = if i == 0 { f32::NEG_INFINITY } else { runs[i - 1].end() as f32 };
                            let len = if from <= b {
                                if y == a { whole } else { ((y - b) * per).min(whole) }
                            } else {
                                ((y - from) * per).min(whole)
                            };
                            if !ray.pass(code.into(), len, &self.entries) {
                                return false;
                            }
                            if from <= b {
                                break;
                            }
                            (y, i) = (from, i - 1);
                        }
                    }
                }
                t = leaves;
            }
            if t >= stop {
                break;
            }
            cell[axis] += step[axis];
            if !self.repeats[axis] && !(0..size[axis]).contains(&cell[axis]) {
                return true;
            }
        }
        true
    }
}

/// A ray from where it meets the matter's box.
struct Near {
    cell: [i32; 2],
    fract: [f32; 2],
    y: f32,
    dir: [f32; 3],
    /// How far the box is from the eye.
    before: f32,
    /// Voxels of a length of the direction.
    unit: f32,
}

/// Bits of the layers between two heights.
#[inline(always)]
fn layers(low: f32, high: f32, shift: u32) -> u64 {
    let of = |y: f32| ((y.max(0.0) as u32) >> shift).min(63);
    (u64::MAX << of(low)) & (u64::MAX >> (63 - of(high)))
}

/// Puts a scene's matter over a picture of what is solid, of which depths say where it is.
pub fn compose(matter: &SceneMatter, camera: &Camera, options: &Options, frame: &mut Frame) {
    let look = matter.look();
    if look.is_clear() {
        return;
    }
    let walk = Walk::new(matter, &look, camera, options);
    let rays = Rays::new(camera, options.projection, matter.levels[0].dims());
    let avx2 = has_avx2();
    rows(frame).for_each(|(y, (color, depth))| {
        let row = Row { rays: &rays, y: y as u32, color, depth };
        #[cfg(target_arch = "x86_64")]
        if avx2 {
            // SAFETY: `has_avx2` has seen that the processor can.
            return unsafe { compose_row_avx2(&walk, row) };
        }
        let _ = avx2;
        row.over(|origin, dir, depth| walk.light(origin, dir, depth));
    });
}

/// The same code for processors with AVX2; the same bits.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
fn compose_row_avx2(walk: &Walk<'_>, row: Row<'_>) {
    row.over(|origin, dir, depth| walk.light(origin, dir, depth));
}

/// A row of a picture.
struct Row<'a> {
    rays: &'a Rays,
    y: u32,
    color: &'a mut [[u8; 4]],
    depth: &'a [f32],
}

impl Row<'_> {
    #[inline(always)]
    fn over(self, light: impl Fn(DVec3, DVec3, f64) -> Light) {
        for (x, (color, &depth)) in (0..).zip(self.color.iter_mut().zip(self.depth)) {
            let Some(dir) = self.rays.direction(x, self.y) else { continue };
            *color = light(self.rays.origin(x, self.y), dir, depth.into()).over(*color);
        }
    }
}

/// Colours and depths of each row of a picture.
fn rows(frame: &mut Frame) -> impl IndexedParallelIterator<Item = (usize, (&mut [[u8; 4]], &[f32]))> {
    let width = frame.width as usize;
    frame.color.par_chunks_mut(width).zip(frame.depth.par_chunks(width)).enumerate()
}

/// Each pixel that shows anything behind the light that `light` finds along its ray up to its depth.
pub fn over(rays: &Rays, frame: &mut Frame, light: impl Fn(DVec3, DVec3, f64) -> Light + Sync) {
    rows(frame).for_each(|(y, (color, depth))| Row { rays, y: y as u32, color, depth }.over(&light));
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::sync::Arc;

    use super::*;
    use crate::cpu::renderer::{CpuRenderer, Outputs};
    use crate::frame::options::{Repeat, Shading};
    use crate::world::World;
    use planecast_encoder::model::matter::{Class, Classes, Matter, STEPS};
    use planecast_encoder::{Colors, Columns, Input};

    fn class(color: [u8; 3], opacity: f64, mode: Mode) -> Class {
        Class { color, opacity, mode }
    }

    /// A world of class `of` of each voxel, and what is solid.
    fn world(
        dims: [u32; 3],
        window: Option<[f64; 2]>,
        classes: Vec<Class>,
        of: impl Fn(u32, u32, u32) -> u16 + Sync,
        solid: impl Fn(u32, u32, u32) -> bool + Sync,
    ) -> World {
        let [nx, ny, nz] = dims;
        let matter = Matter::try_from_rows(dims, |z, out| {
            for x in 0..nx {
                (0..ny).for_each(|y| out.push(1, STEPS * of(x, y, z)));
                out.end_column();
            }
            Ok(())
        });
        let input = Input { columns: Columns::from_fn(nx, ny, nz, solid), colors: Colors::None, notes: Vec::new() };
        let classes = Arc::new(Classes { window, classes });
        World::with_matter(Path::new("world"), input, Some((matter.unwrap(), classes))).unwrap()
    }

    fn camera(eye: [f64; 3], yaw: f64, pitch: f64) -> Camera {
        Camera { eye: eye.into(), yaw, pitch, fov: 50.0, width: 65, height: 49, ..Camera::default() }
    }

    fn plain() -> Options {
        Options { shading: Shading::None, ..Options::default() }
    }

    fn both(world: &World, camera: &Camera, options: &Options) -> [Frame; 2] {
        let mut renderer = CpuRenderer::new(&world.scene, &world.resident);
        [
            renderer.render(camera, options, Outputs::default()).unwrap(),
            renderer.exact(camera, options, Outputs::default()).unwrap(),
        ]
    }

    /// Mean and greatest difference of channels.
    fn difference(a: &Frame, b: &Frame) -> (f64, u8) {
        let all = a.color.as_flattened().iter().zip(b.color.as_flattened());
        let each: Vec<u8> = all.map(|(a, b)| a.abs_diff(*b)).collect();
        (each.iter().map(|&d| f64::from(d)).sum::<f64>() / each.len() as f64, each.into_iter().max().unwrap())
    }

    fn speckle(n: u16) -> impl Fn(u32, u32, u32) -> u16 + Sync {
        move |x, y, z| {
            ((x / 2).wrapping_mul(31) ^ (y / 3).wrapping_mul(17) ^ (z / 2).wrapping_mul(57)) as u16 % 13 % (n + 1)
        }
    }

    #[test]
    fn fog_that_fills_all_takes_by_the_length_of_the_way() {
        let world =
            world([64; 3], None, vec![class([200, 100, 0], 0.02, Mode::Volumetric)], |_, _, _| 1, |_, _, _| false);
        // From outside, along z through all 64 voxels; from the middle through half of them.
        for (eye, way) in [([32.0, 32.0, 100.0], 64.0), ([32.0, 32.0, 32.0], 32.0)] {
            let taken = 1.0 - 0.98f64.powf(way);
            for frame in both(&world, &camera(eye, 0.0, 0.0), &Options { sky: false, ..plain() }) {
                let [r, g, b, a] = frame.color[24 * 65 + 32];
                assert_eq!([r, g, b], [200, 100, 0]);
                assert!((f64::from(a) - 255.0 * taken).abs() <= 0.51, "{a} of {taken}");
            }
        }
    }

    #[test]
    fn pictures_are_those_of_exact_integration() {
        let classes: Vec<Class> = (0..4)
            .map(|k| class([60 * k, 200, 255 - 60 * k], [0.004, 0.03, 0.2, 0.9][usize::from(k)], Mode::Volumetric))
            .collect();
        let solid = |x: u32, y: u32, z: u32| (x / 9 + y / 5 + z / 7).is_multiple_of(5) && !(x + z).is_multiple_of(3);
        let world = world([43, 57, 38], Some([0.0, 4.0]), classes, speckle(4), solid);
        for (eye, yaw, pitch) in [
            ([80.0, 70.0, 90.0], -40.0, -25.0),
            ([20.3, 30.2, 19.7], 130.0, 12.0),
            ([21.0, 90.0, 19.0], 0.0, -90.0),
            ([20.0, -30.0, 19.0], 0.0, 90.0),
            ([-30.0, 28.0, 20.0], 90.0, 0.0),
        ] {
            let options = Options { lod: None, ..plain() };
            let [fast, exact] = both(&world, &camera(eye, yaw, pitch), &options);
            // Where planes show another voxel than a ray there is another colour behind.
            let pairs = fast.color.iter().zip(&exact.color).zip(fast.depth.iter().zip(&exact.depth));
            let same: Vec<_> = pairs.filter(|(_, (a, b))| *a == *b || (*a - *b).abs() < 1e-2).map(|(c, _)| c).collect();
            assert!(same.len() * 20 > fast.color.len() * 19, "{eye:?}: {} pixels", same.len());
            let most = same.iter().flat_map(|(a, b)| (0..4).map(|i| a[i].abs_diff(b[i]))).max();
            assert!(most <= Some(2), "{eye:?}: {most:?}");
        }
        let round = Camera { width: 64, height: 32, ..camera([20.0, 60.0, 20.0], 10.0, 0.0) };
        let options = Options { projection: Projection::Equirect, ..plain() };
        let [fast, exact] = both(&world, &round, &options);
        assert!(difference(&fast, &exact).0 < 0.5);
        let options = Options { repeat: Repeat { x: true, z: true }, view_distance: 90.0, lod: None, ..plain() };
        let [fast, exact] = both(&world, &camera([-15.0, 62.0, 75.0], 200.0, -10.0), &options);
        let (mean, _) = difference(&fast, &exact);
        assert!(mean < 0.2, "{mean}");
    }

    #[test]
    fn coarser_levels_take_as_much_as_what_they_are_made_of() {
        // Extinction that grows as the steps do: their mean has the mean of it.
        let classes = [0.01, 0.0199].map(|opacity| class([250, 250, 250], opacity, Mode::Volumetric)).to_vec();
        let world = world([64; 3], Some([0.0, 2.0]), classes, speckle(2), |_, _, _| false);
        let camera = camera([32.0, 32.0, 400.0], 0.0, 0.0);
        let [coarse, exact] = both(&world, &Camera { fov: 12.0, ..camera }, &Options { lod: Some(16.0), ..plain() });
        let mean =
            |frame: &Frame| frame.color.as_flattened().iter().map(|&v| f64::from(v)).sum::<f64>() / (4.0 * 65.0 * 49.0);
        let (a, b) = (mean(&coarse), mean(&exact));
        assert!(coarse.color != exact.color && (a - b).abs() < 3.0, "{a} {b}");
    }

    #[test]
    fn zero_extinction_leaves_every_bit_and_infinite_shows_its_colour() {
        let hills = |x: u32, y: u32, z: u32| y < 5 + x * z % 7;
        let classes = vec![class([9, 9, 9], 0.0, Mode::Volumetric)];
        let clear = world([32, 24, 32], Some([0.0, 1.0]), classes, |_, _, _| 1, hills);
        let input = Input { columns: Columns::from_fn(32, 24, 32, hills), colors: Colors::None, notes: Vec::new() };
        let opaque = World::of_input(Path::new("opaque"), input).unwrap();
        let camera = camera([16.0, 30.0, 60.0], 5.0, -20.0);
        for (a, b) in
            both(&clear, &camera, &Options::default()).iter().zip(&both(&opaque, &camera, &Options::default()))
        {
            assert!(a.color == b.color && a.depth == b.depth);
        }
        let wall = vec![class([10, 20, 30], 1.0, Mode::Volumetric)];
        let wall = world([32, 24, 32], Some([0.0, 1.0]), wall, |_, _, _| 1, |_, _, _| false);
        for frame in both(&wall, &Camera { eye: [16.0, 12.0, 60.0].into(), pitch: 0.0, ..camera }, &plain()) {
            assert_eq!(frame.color[24 * 65 + 32], [10, 20, 30, 255]);
        }
    }

    /// At a corner rounding may tell one axis from the other either way. (The walk once went to and fro there without end.)
    #[test]
    fn rays_through_corners_of_empty_blocks_go_on() {
        let fog = vec![class([200, 100, 0], 0.02, Mode::Volumetric)];
        let in_the_middle = |x: u32, _: u32, z: u32| u16::from(x / 8 == 16 && z / 8 == 16);
        let world = world([264, 20, 264], None, fog, in_the_middle, |_, _, _| false);
        let matter = world.resident.matter.as_ref().unwrap();
        let look = matter.look();
        let walk = Walk::new(matter, &look, &camera([0.0; 3], 0.0, 0.0), &Options { lod: None, ..plain() });
        let mut met = 0;
        for n in 0..200_000 {
            let [x, y, z, i, k] =
                [0, 1, 2, 3, 4].map(|of| f64::from(crate::testing::noise(n, of, 7)) * 0.5f64.powi(32));
            let origin = DVec3::new(264.0 * x, 20.0 * y, 264.0 * z);
            let corner = DVec3::new(8.0 * (33.0 * i).floor(), origin.y, 8.0 * (33.0 * k).floor());
            let light = walk.light(origin, (corner - origin).normalize(), f64::INFINITY);
            assert!((0.0..=1.0).contains(&light.left), "{light:?}");
            met += usize::from(light.left < 1.0);
        }
        assert!((2_000..100_000).contains(&met), "{met}");
    }

    #[test]
    fn panes_take_once_however_thick_they_are() {
        for thick in [1, 5] {
            let glass = vec![class([0, 0, 255], 0.25, Mode::Surface)];
            let pane = |_: u32, _: u32, z: u32| u16::from(z >= 10 && z < 10 + thick);
            let world = world([20; 3], None, glass, pane, |_, _, _| false);
            for frame in both(&world, &camera([10.0, 10.0, 40.0], 0.0, 0.0), &Options { sky: false, ..plain() }) {
                assert_eq!(frame.color[24 * 65 + 32], [0, 0, 255, 64], "{thick}");
            }
        }
    }

    #[test]
    fn additive_matter_gives_light_and_takes_none() {
        let camera = camera([8.0, 8.0, 30.0], 0.0, 0.0);
        let drawn = |opacity: f64| {
            let glow = vec![class([100, 0, 0], opacity, Mode::Additive)];
            let world = world([16; 3], None, glow, |_, _, _| 1, |_, _, z| z == 0);
            both(&world, &camera, &plain()).map(|frame| frame.color[24 * 65 + 32])
        };
        for (dark, lit) in drawn(0.0).into_iter().zip(drawn(0.01)) {
            let expected = f64::from(dark[0]) + 15.0 * -(0.99f64.ln()) * 100.0;
            assert!((f64::from(lit[0]) - expected).abs() <= 1.0 && lit[1..] == dark[1..], "{lit:?} {dark:?}");
        }
    }

    #[test]
    fn a_hundred_thousand_layers_along_one_ray_add_up() {
        let classes = vec![class([255, 0, 0], 1e-5, Mode::Volumetric), class([0, 0, 255], 2e-5, Mode::Volumetric)];
        let layers = world([100_000, 2, 2], None, classes, |x, _, _| 1 + (x % 2) as u16, |_, _, _| false);
        let look = layers.resident.matter.as_ref().unwrap().look();
        let options = Options { lod: None, ..plain() };
        let matter = layers.resident.matter.as_ref().unwrap();
        let walk = Walk::new(matter, &look, &camera([-5.0, 1.0, 1.0], 90.0, 0.0), &options);
        let (eye, dir) = (DVec3::new(-5.0, 0.9, 1.1), DVec3::new(1.0, 1e-9, -1e-9));
        let fast = walk.light(eye, dir, f64::INFINITY);
        let exact =
            crate::cpu::exact_matter::integrate(&matter.levels[0], &look.optics, [false; 2], eye, dir, f64::INFINITY);
        let left = (0.99999f64 * 0.99998).powi(50_000);
        assert!((f64::from(exact.left) - left).abs() < 1e-6, "{exact:?} {left}");
        assert!((fast.left - exact.left).abs() < 1e-3, "{fast:?} {exact:?}");
        (0..3).for_each(|i| assert!((fast.color[i] - exact.color[i]).abs() < 0.5, "{fast:?} {exact:?}"));
    }
}
