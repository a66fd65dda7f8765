//! Stage `refine`: where the samples around a pixel disagree, its own ray is walked over the few columns in which they say
//! that the surface lies.
//!
//! A pixel between two planes may see a voxel that neither shows: one that is narrower there than the planes are apart, as
//! most are that are seen at a grazing angle. The samples around the pixel tell about how far away it is, so that a short
//! walk at level 0 finds it. (Not in the papers.) Twin: `shaders/refine.wgsl`.

use crate::cpu::chunks_mut;
use crate::cpu::remap::{Pixels, ray_inverse};
use crate::cpu::traverse::Real;
use crate::frame::camera::Camera;
use crate::frame::plane_setup::{FARTHEST_VIEW, Setup};
use crate::world::tables::{EMPTY, Resident, ResidentLevel};
use planecast_encoder::Run;
use rayon::prelude::*;

/// Columns that a ray is walked over at most, from where the nearest sample lies, and again up to what remap chose.
pub const COLUMNS: u32 = 64;

/// How much nearer than the nearest sample a walk begins, in voxels along the ray's steepest axis.
pub const MARGIN: f32 = 1.0;

/// Voxels from the eye that nothing drawn is beyond, along an axis.
pub const FARTHEST: f32 = FARTHEST_VIEW as f32;

/// What remap says of a pixel whose samples agree: [`Doubt::NONE`], else the least depth among them, its sign set where the
/// pixel's ray meets none of their voxels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Doubt(pub f32);

impl Doubt {
    pub const NONE: Doubt = Doubt(f32::INFINITY);

    /// None where no sample around is at any depth, or `nearest` is negative.
    #[inline(always)]
    pub fn new(nearest: f32, met: bool) -> Doubt {
        match nearest < 0.0 || nearest == f32::INFINITY {
            true => Doubt::NONE,
            false => Doubt(if met { nearest } else { -nearest }),
        }
    }
}

/// Walks the rays of all pixels in doubt.
pub fn refine(resident: &Resident, setup: &Setup, camera: &Camera, pixels: &mut Pixels<'_>) {
    let Pixels { color, depth, voxel, doubt } = pixels;
    let w = camera.width as usize;
    let basis = camera.basis();
    let walk = Walk::new(resident, setup);
    if doubt.is_empty() {
        return;
    }
    let height = doubt.len() / w;
    let rows = color.par_chunks_mut(w).zip(depth.par_chunks_mut(w)).zip(doubt.par_chunks(w));
    rows.zip(chunks_mut(voxel, w, height)).enumerate().for_each(|(r, (((color, depth), doubt), voxel))| {
        let y = r as f64 + 0.5;
        let start = camera.ray(&basis, 0.5, y);
        let step = (camera.ray(&basis, w as f64 + 0.5, y) - start) / w as f64;
        for x in 0..w {
            if doubt[x] == Doubt::NONE {
                continue;
            }
            let ray = Ray::new((start + step * x as f64).to_array().map(|d| d as f32), setup.view_distance as f32);
            if let Some(met) = walk.settle(&ray, doubt[x], depth[x]) {
                (color[x], depth[x]) = (met.color, met.depth);
                if let Some(voxel) = voxel.get_mut(x) {
                    *voxel = met.voxel;
                }
            }
        }
    });
}

/// A pixel's ray; its parameter is depth.
pub(super) struct Ray {
    dir: [f32; 3],
    inverse: [f32; 3],
    /// Depth at which the view ends.
    end: f32,
    /// [`MARGIN`] as depth.
    margin: f32,
}

impl Ray {
    #[inline(always)]
    pub(super) fn new(dir: [f32; 3], view_distance: f32) -> Ray {
        let inverse = dir.map(ray_inverse);
        let horizontal = (dir[0] * dir[0] + dir[2] * dir[2]).sqrt();
        let steepest = dir.into_iter().map(f32::abs).fold(0.0, Real::max);
        Ray { dir, inverse, end: view_distance / Real::max(horizontal, 1e-20), margin: MARGIN / steepest }
    }
}

/// What a ray meets first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Met {
    pub(super) voxel: [i32; 4],
    pub(super) depth: f32,
    pub(super) color: u32,
}

/// What a stretch of a ray shows.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Stretch {
    Met(Met),
    /// Nothing up to this depth.
    Free(f32),
    /// It begins within something solid: where the ray came in, it does not tell.
    Inside,
}

/// Level 0 around the eye.
pub(super) struct Walk<'a> {
    level: &'a ResidentLevel,
    eye: [i32; 3],
    fract: [f32; 3],
    repeats: [bool; 2],
}

impl<'a> Walk<'a> {
    pub(super) fn new(resident: &'a Resident, setup: &Setup) -> Walk<'a> {
        let fract = setup.eye_fract.map(|f| f as f32);
        Walk { level: &resident.levels[0], eye: setup.eye_cell, fract, repeats: setup.repeats }
    }

    /// What the ray of a pixel in doubt meets, if the walk finds it; `depth` is that of what remap chose.
    #[inline(always)]
    pub(super) fn settle(&self, ray: &Ray, doubt: Doubt, depth: f32) -> Option<Met> {
        // What the ray meets there, it cannot see through.
        let end = if doubt.0.is_sign_negative() { ray.end } else { Real::min(depth, ray.end) };
        let from = Real::max(doubt.0.abs() - ray.margin, 0.0);
        if from >= ray.end {
            return None;
        }
        match self.stretch(ray, from, end) {
            // Between two surfaces lies nothing that a sample has shown.
            Stretch::Free(to) if to < depth && depth < ray.end => {
                match self.stretch(ray, Real::max(depth - ray.margin, to), end) {
                    Stretch::Met(met) => Some(met),
                    _ => None,
                }
            }
            Stretch::Met(met) => Some(met),
            _ => None,
        }
    }

    /// Place of a grid plane along an axis, from the eye.
    #[inline(always)]
    fn place(&self, axis: usize, line: i32) -> f32 {
        line.wrapping_sub(self.eye[axis]) as f32 - self.fract[axis]
    }

    /// At most [`COLUMNS`] columns of a ray, from the one that holds depth `from` to `end`.
    #[inline(always)]
    fn stretch(&self, ray: &Ray, from: f32, end: f32) -> Stretch {
        let size = [self.level.nx, self.level.nz];
        let (mut cell, mut step, mut next) = ([0i32; 2], [0; 2], [0.0; 2]);
        let mut q0 = 0.0f32;
        for k in 0..2 {
            let axis = 2 * k;
            let forward = ray.dir[axis] >= 0.0;
            step[k] = if forward { 1 } else { -1 };
            // A sample along the horizon may claim any depth.
            let at = (self.fract[axis] + from * ray.dir[axis]).clamp(-FARTHEST, FARTHEST);
            let floor = at as i32 - i32::from(at < (at as i32) as f32);
            cell[k] = self.eye[axis].wrapping_add(floor);
            let (near, far) = if forward { (0, 1) } else { (1, 0) };
            q0 = Real::max(q0, self.place(axis, cell[k].wrapping_add(near)) * ray.inverse[axis]);
            next[k] = self.place(axis, cell[k].wrapping_add(far)) * ray.inverse[axis];
        }
        for turn in 0..COLUMNS {
            let k = usize::from(next[1] < next[0]);
            let q1 = next[k];
            if q1 > q0 {
                let wrapped = [0, 1].map(|k| match self.repeats[k] {
                    true => cell[k].rem_euclid(size[k] as i32) as u32,
                    false => cell[k] as u32,
                });
                if wrapped[0] < size[0] && wrapped[1] < size[1] {
                    let ix = self.level.index(wrapped[0], wrapped[1]);
                    if let Some((run, y, depth)) = self.column(ray, ix, q0, q1) {
                        if turn == 0 && depth == q0 && q0 > 0.0 {
                            return Stretch::Inside;
                        }
                        let color = self.level.color(ix, run, y as u32);
                        return Stretch::Met(Met { voxel: [cell[0], y, cell[1], 0], depth, color });
                    }
                }
                q0 = q1;
            }
            if q0 >= end {
                break;
            }
            cell[k] = cell[k].wrapping_add(step[k]);
            next[k] = self.place(2 * k, cell[k].wrapping_add(i32::from(step[k] > 0))) * ray.inverse[2 * k];
        }
        Stretch::Free(q0)
    }

    /// The first voxel of column number `ix` that a ray meets between two depths: which run it is of, from the top down, its
    /// y, and at which depth.
    #[inline(always)]
    fn column(&self, ray: &Ray, ix: usize, q0: f32, q1: f32) -> Option<(u32, i32, f32)> {
        let [top, more] = self.level.entry(ix);
        if top == EMPTY {
            return None;
        }
        let (bottom_of, top_of) =
            (|run: u32| self.place(1, i32::from(Run(run).first())), |run: u32| self.place(1, Run(run).end() as i32));
        let (h0, h1) = (ray.dir[1] * q0, ray.dir[1] * q1);
        let (low, high) = (Real::min(h0, h1), Real::max(h0, h1));
        if top_of(top) <= low {
            return None;
        }
        let rest = match more as usize {
            0 => &[][..],
            at => &self.level.runs()[at + 1..at + 1 + self.level.runs()[at] as usize],
        };
        // Going down the highest run that begins below where the ray comes in; going up the lowest that ends above it.
        let below = |run: u32| bottom_of(run) < high || (bottom_of(run) == high && low == high);
        let k = match ray.dir[1] > 0.0 {
            false if below(top) => 0,
            false => 1 + rest.partition_point(|&run| !below(run)),
            true => rest.partition_point(|&run| top_of(run) > low),
        };
        let run = if k == 0 { top } else { *rest.get(k - 1)? };
        let (bottom, end) = (bottom_of(run), top_of(run));
        if end <= low || !below(run) {
            return None;
        }
        let (first, last) = (i32::from(Run(run).first()), i32::from(Run(run).last()));
        let (y, depth) = if h0 >= end {
            (last, end * ray.inverse[1])
        } else if h0 < bottom {
            (first, bottom * ray.inverse[1])
        } else {
            ((first + (h0 - bottom) as i32).min(last), q0)
        };
        Some((k as u32, y, depth))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::exact::cast;
    use crate::frame::plane_setup::plane_setup;
    use crate::testing::noise;
    use crate::{Features, Options, Repeat};
    use glam::DVec3;
    use planecast_encoder::{BuildOptions, Colors, Columns, Input, Scene, build};

    fn scene(dims: [u32; 3], solid: impl Fn(u32, u32, u32) -> bool + Sync) -> Scene {
        let columns = Columns::from_fn(dims[0], dims[1], dims[2], solid);
        build(Input { columns, colors: Colors::None, notes: Vec::new() }, &BuildOptions::default()).unwrap()
    }

    /// Rays from all over a world, of those that meet something how many there are and how many of them the walk settles
    /// on the same voxel: from a doubt that is too near by up to two voxels, for what remap saw farther away.
    fn settled(scene: &Scene, features: Features, repeats: bool, spoil: impl Fn(&mut Walk<'_>)) -> [u32; 2] {
        let resident = Resident::with(scene, features);
        let columns = &scene.levels[0].solid;
        let dims = scene.dims().map(f64::from);
        let options = Options { repeat: Repeat { x: repeats, z: repeats }, lod: None, ..Options::default() };
        let (mut met, mut same) = (0, 0);
        for k in 0..20_000 {
            let random = |n: u32| f64::from(noise(k, n, 77)) / f64::from(u32::MAX);
            let eye = DVec3::new(random(0) * dims[0], random(1) * 1.5 * dims[1], random(2) * dims[2]);
            let dir = DVec3::new(random(3) - 0.5, random(4) - 0.7, random(5) - 0.5);
            let Some(hit) = cast(columns, [repeats; 2], eye, dir, 200.0 / dir.x.hypot(dir.z)) else { continue };
            if hit.t == 0.0 {
                continue;
            }
            let camera = Camera { eye, yaw: 0.0, pitch: 0.0, roll: 0.0, fov: 60.0, width: 4, height: 4 };
            let setup = plane_setup(&resident, &camera, &options);
            let mut walk = Walk::new(&resident, &setup);
            spoil(&mut walk);
            let ray = Ray::new(dir.to_array().map(|d| d as f32), f32::INFINITY);
            let near = (hit.t as f32 - 2.0 * random(6) as f32 * ray.margin).max(0.0);
            let found = walk.settle(&ray, Doubt::new(near, k % 2 == 0), hit.t as f32 * 1.5);
            met += 1;
            same += u32::from(found.is_some_and(|found| found.voxel[..3] == hit.voxel.map(|v| v as i32)));
        }
        [met, same]
    }

    /// Single voxels, long runs, columns of very many runs, heights.
    fn scenes() -> [Scene; 4] {
        [
            scene([40, 30, 40], |x, y, z| noise(x, y, z).is_multiple_of(40)),
            scene([40, 60, 40], |x, y, z| noise(x, y / 9, z).is_multiple_of(5)),
            scene([12, 3000, 12], |x, y, z| y.is_multiple_of(4) && !noise(x, 0, z).is_multiple_of(3)),
            scene([40, 30, 40], |x, y, z| y < 5 + noise(x, 0, z) % 9),
        ]
    }

    #[test]
    fn walks_settle_on_the_voxels_of_exact() {
        for (i, scene) in scenes().iter().enumerate() {
            for (features, repeats) in [(Features::ALL, false), (Features::NONE, true)] {
                let [met, same] = settled(scene, features, repeats, |_| ());
                println!("world {i}, repeats {repeats}: {same} of {met}");
                // Roundings on edges.
                assert!(met > 2000 && met - same <= 5, "world {i}: {same} of {met}");
            }
        }
    }

    #[test]
    fn walks_beside_their_rays_do_not() {
        for (i, scene) in scenes().iter().enumerate() {
            let [met, same] = settled(scene, Features::ALL, false, |walk| walk.fract[0] += 0.1);
            assert!(f64::from(same) < 0.97 * f64::from(met), "world {i}: {same} of {met}");
        }
    }

    #[test]
    fn doubts_say_how_near_and_whether_anything_was_met() {
        assert_eq!(Doubt::new(f32::INFINITY, false), Doubt::NONE);
        assert_eq!(Doubt::new(-1.0, true), Doubt::NONE);
        assert_eq!(Doubt::new(3.0, true), Doubt(3.0));
        assert_eq!(Doubt::new(0.0, false).0.to_bits(), (-0.0f32).to_bits());
    }
}
