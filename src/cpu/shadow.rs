//! Shadows of the sun, for stage `shade`: from the point that a pixel shows, a walk over columns towards the sun.
//!
//! The walk keeps to the level that the point is drawn at, and passes over squares of columns whose highest voxel lies below
//! it: squares of 8, 16, 32 … columns, whose tops are made when they are first asked for ([`Tops`]). As the ray only rises, its
//! height where it enters a square is what counts. A walk ends above the world's top, at its edge, or at the view distance.
//! Twin: `shaders/shared/shadow.wgsl`.

use crate::frame::options::Options;
use crate::frame::plane_setup::Setup;
use crate::world::tables::{BLOCK_SHIFT, EMPTY, Resident, ResidentLevel, Table};
use glam::Vec3;
use planecast_encoder::Run;

/// Squares and columns that a walk looks at, at most.
pub const STEPS: u32 = 4096;

/// How far before the surface a walk begins, along its normal, in voxels of the level drawn: stairs that stand for a slope are no
/// more than this above it.
pub const BIAS: f32 = 1.5;

/// The same of voxels so large that they are seen as blocks, which shade each other.
pub const BIAS_BLOCKS: f32 = 0.05;

/// How far past a border a walk goes on: at least, and as a share of its length.
pub const PAST: [f32; 2] = [1e-3, 1e-6];

/// Heights of the highest voxels' upper faces, in voxels of level 0: of squares of 8 × 8 columns, then of twice as many a side, up
/// to one square. Squares of `8·2ᵏ` columns are as high as any level up to `k` is there.
#[derive(Clone, Debug, PartialEq)]
pub struct Tops {
    /// Squares a row, and their tops.
    pub levels: Vec<(u32, Vec<u32>)>,
    /// The highest of all.
    pub top: u32,
}

impl Tops {
    pub fn new(resident: &Resident) -> Tops {
        let [nx, _, nz] = resident.dims;
        let side = |n: u32, k: u32| n.div_ceil(1 << BLOCK_SHIFT).div_ceil(1 << k).max(1);
        let mut levels: Vec<(u32, Vec<u32>)> = Vec::new();
        for k in 0.. {
            let (wide, deep) = (side(nx, k), side(nz, k));
            let mut tops = vec![0u32; wide as usize * deep as usize];
            if let Some((finer, of)) = levels.last() {
                for (i, &top) in of.iter().enumerate() {
                    let (x, z) = (i as u32 % finer, i as u32 / finer);
                    let at = &mut tops[((z >> 1).min(deep - 1) * wide + (x >> 1).min(wide - 1)) as usize];
                    *at = top.max(*at);
                }
            }
            if let Some(level) = resident.levels.get(k as usize) {
                let row = level.nx.div_ceil(1 << BLOCK_SHIFT);
                for (i, &block) in level.blocks.iter().enumerate().filter(|(_, b)| **b != EMPTY) {
                    let (x, z) = (i as u32 % row, i as u32 / row);
                    let at = &mut tops[(z.min(deep - 1) * wide + x.min(wide - 1)) as usize];
                    *at = (Run(block).end() << k).max(*at);
                }
            }
            levels.push((wide, tops));
            if wide == 1 && deep == 1 {
                break;
            }
        }
        let top = levels.last().map_or(0, |(_, tops)| tops[0]);
        Tops { levels, top }
    }

    /// As the GPU has them: of each level where its tops begin and how many a row has, then the tops.
    pub fn words(&self) -> Vec<u32> {
        let mut words = vec![0; 2 * self.levels.len()];
        for (k, (row, tops)) in self.levels.iter().enumerate() {
            (words[2 * k], words[2 * k + 1]) = (words.len() as u32, *row);
            words.extend_from_slice(tops);
        }
        words
    }
}

/// How far before the surface a walk begins, in voxels of level 0. `size`: that of a voxel of the level drawn; `pixels`: across a
/// voxel of level 0.
#[inline(always)]
pub fn bias(size: f32, pixels: f32, smooth: bool) -> f32 {
    let far = if smooth { 1.0 } else { ((4.0 - pixels) * 0.5).clamp(0.0, 1.0) };
    size * (BIAS_BLOCKS + (BIAS - BIAS_BLOCKS) * far)
}

/// Where walks towards the sun end, along their rays.
pub fn end(setup: &Setup, sun: Vec3) -> f32 {
    (setup.view_distance.min(1e9) as f32 / sun.x.hypot(sun.z).max(1e-20)).min(1e9)
}

/// What a walk needs to know of a frame.
pub struct Shadows<'a> {
    resident: &'a Resident,
    tops: &'a Tops,
    eye: [i32; 3],
    fract: [f32; 3],
    repeats: [bool; 2],
    /// Towards the sun, in the world, of length 1.
    sun: [f32; 3],
    inverse: [f32; 2],
    /// Where walks end, along the ray.
    end: f32,
    levels: u32,
}

impl<'a> Shadows<'a> {
    pub fn new(resident: &'a Resident, tops: &'a Tops, setup: &Setup, sun: Vec3) -> Shadows<'a> {
        let inverse =
            [sun.x, sun.z].map(|d| 1.0 / if d.abs() < 1e-12 { if d < 0.0 { -1e-12 } else { 1e-12 } } else { d });
        Shadows {
            resident,
            tops,
            eye: setup.eye_cell,
            fract: setup.eye_fract.map(|f| f as f32),
            repeats: setup.repeats,
            sun: sun.to_array(),
            inverse,
            end: end(setup, sun),
            levels: setup.levels.max(1),
        }
    }

    /// Whether the sun shines on a point, given from the eye, that is drawn with voxels so large.
    #[inline(always)]
    pub fn lit(&self, from_eye: Vec3, size: f32) -> bool {
        let [dx, dy, dz] = self.sun;
        if dy <= 0.0 {
            return false;
        }
        let level = (((size.to_bits() >> 23) as i32 - 127).max(0) as u32).min(self.levels - 1);
        let at = [from_eye.x + self.fract[0], from_eye.z + self.fract[2]];
        let floor = [at[0].floor(), at[1].floor()];
        let start = [at[0] - floor[0], at[1] - floor[1]];
        let cell = [self.eye[0].wrapping_add(floor[0] as i32), self.eye[2].wrapping_add(floor[1] as i32)];
        let height = from_eye.y + (self.eye[1] as f32 + self.fract[1]);
        let end = ((self.tops.top as f32 - height) / dy).min(self.end);
        let dims = [self.resident.dims[0] as i32, self.resident.dims[2] as i32];
        let dir = [dx, dz];
        let mut t = 0.0f32;
        for axis in 0..2 {
            // From outside to where the world begins.
            if !self.repeats[axis] && !(0..dims[axis]).contains(&cell[axis]) {
                let near = if dir[axis] >= 0.0 { 0 } else { dims[axis] };
                let enter = (near.wrapping_sub(cell[axis]) as f32 - start[axis]) * self.inverse[axis];
                if enter < 0.0 {
                    return true;
                }
                t = t.max(enter + PAST[0] + enter * PAST[1]);
            }
        }
        let most = self.tops.levels.len() as u32 - 1;
        let level = level.min(most);
        let table = &self.resident.levels[level as usize];
        let mut k = level;
        for _ in 0..STEPS {
            if t >= end {
                return true;
            }
            let mut here = [0i32; 2];
            let mut base = [0i32; 2];
            for axis in 0..2 {
                let off = (start[axis] + dir[axis] * t).floor() as i32;
                let world = cell[axis].wrapping_add(off);
                here[axis] = match self.repeats[axis] {
                    true => world.rem_euclid(dims[axis]),
                    false if (0..dims[axis]).contains(&world) => world,
                    false => return true,
                };
                // What brings a place of the first period to where the walk counts from.
                base[axis] = off.wrapping_sub(here[axis]);
            }
            let shift = BLOCK_SHIFT + k;
            let (row, tops) = &self.tops.levels[k as usize];
            let top = tops[((here[1] >> shift) as u32 * row + (here[0] >> shift) as u32) as usize];
            let now = height + dy * t;
            let leave = |shift: u32| {
                let mut out = f32::INFINITY;
                for axis in 0..2 {
                    let first = (here[axis] >> shift) << shift;
                    let past = first.saturating_add(1 << shift).min(dims[axis]);
                    let line = base[axis].wrapping_add(if dir[axis] >= 0.0 { past } else { first });
                    let at = (line as f32 - start[axis]) * self.inverse[axis];
                    out = if at < out { at } else { out };
                }
                out
            };
            if now >= top as f32 {
                t = forward(t, leave(shift));
                k = (k + 1).min(most);
            } else if k > level {
                k -= 1;
            } else {
                let next = forward(t, leave(level));
                if blocks(table, level, here, now, height + dy * next) {
                    return false;
                }
                t = next;
            }
        }
        true
    }
}

/// Past a border, and never back.
#[inline(always)]
fn forward(t: f32, border: f32) -> f32 {
    let next = if border > t { border } else { t };
    next + (PAST[0] + next * PAST[1])
}

/// Whether a column of level `l` at a place of level 0 is solid anywhere between two heights, the lower first.
#[inline(always)]
fn blocks(level: &ResidentLevel, l: u32, here: [i32; 2], low: f32, high: f32) -> bool {
    let (x, z) = ((here[0] >> l) as u32, (here[1] >> l) as u32);
    if x >= level.nx || z >= level.nz {
        return false;
    }
    let ix = (z * level.nx + x) as usize;
    match &level.table {
        Table::Heights(heights) => ((u32::from(heights[ix]) << l) as f32) > low,
        Table::Runs { columns, runs } => {
            let [top, more] = columns[ix];
            let end = |run: u32| (Run(run).end() << l) as f32;
            let first = |run: u32| (u32::from(Run(run).first()) << l) as f32;
            if top == EMPTY || end(top) <= low {
                return false;
            }
            if first(top) < high {
                return true;
            }
            let Some(at) = (more as usize).checked_sub(1).map(|at| at + 1) else { return false };
            let rest = &runs[at + 1..at + 1 + runs[at] as usize];
            // The highest run that begins below where the ray leaves.
            rest.get(rest.partition_point(|&run| first(run) >= high)).is_some_and(|&run| end(run) > low)
        }
    }
}

/// The same by one f64 ray at level 0: what `exact` has, and what the walk is measured by.
pub struct ExactShadows<'a> {
    pub columns: &'a planecast_encoder::Columns,
    pub repeats: [bool; 2],
    pub eye: glam::DVec3,
    pub sun: glam::DVec3,
    /// See [`Options::view_distance`].
    pub view: f64,
}

impl ExactShadows<'_> {
    pub fn lit(&self, from_eye: Vec3) -> bool {
        let across = self.sun.x.hypot(self.sun.z);
        let end = if across > 0.0 { self.view / across } else { f64::INFINITY };
        self.sun.y > 0.0
            && crate::cpu::exact::cast(self.columns, self.repeats, self.eye + from_eye.as_dvec3(), self.sun, end)
                .is_none()
    }
}

/// Who tells what is in the sun.
pub enum Sunlight<'a> {
    Walk(Shadows<'a>),
    Exact(ExactShadows<'a>),
}

impl Sunlight<'_> {
    #[inline(always)]
    pub fn lit(&self, from_eye: Vec3, size: f32) -> bool {
        match self {
            Sunlight::Walk(walk) => walk.lit(from_eye, size),
            Sunlight::Exact(exact) => exact.lit(from_eye),
        }
    }
}

/// Size of a voxel drawn at depth 1, in voxels of level 0; 0 where only those are drawn.
pub fn size_at_1(options: &Options, pixel: f32) -> f32 {
    options.lod.map_or(0.0, |px| px as f32 * pixel)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::plane_setup::plane_setup;
    use crate::testing::noise;
    use crate::{Camera, Features, Repeat};
    use glam::DVec3;
    use planecast_encoder::{BuildOptions, Colors, Columns, Input, Scene, build};

    fn scene(dims: [u32; 3], solid: impl Fn(u32, u32, u32) -> bool + Sync) -> Scene {
        let columns = Columns::from_fn(dims[0], dims[1], dims[2], solid);
        build(Input { columns, colors: Colors::None, notes: Vec::new() }, &BuildOptions::default()).unwrap()
    }

    fn sun(azimuth: f64, elevation: f64) -> DVec3 {
        let ((s, c), (up, level)) = (azimuth.to_radians().sin_cos(), elevation.to_radians().sin_cos());
        DVec3::new(s * level, up, -c * level)
    }

    fn looking_from(eye: DVec3) -> Camera {
        Camera { eye, ..Camera::default() }
    }

    /// Points all over a world that are not solid, how many of them the sun shines on, and of how many the walk says another thing
    /// than one f64 ray.
    fn judged(scene: &Scene, features: Features, repeats: bool, wrong: f32) -> [u32; 3] {
        let resident = Resident::with(scene, features);
        let tops = Tops::new(&resident);
        let columns = &scene.levels[0].solid;
        let options = Options { repeat: Repeat { x: repeats, z: repeats }, lod: None, ..Options::default() };
        let dims = scene.dims().map(f64::from);
        let mut counts = [0; 3];
        for k in 0..20_000 {
            let random = |n: u32| f64::from(noise(k, n, 77)) / f64::from(u32::MAX);
            let eye = DVec3::new(random(0) * dims[0], (0.5 + random(1)) * dims[1], random(2) * dims[2]);
            let away = DVec3::new((random(3) - 0.5) * 2.0 * dims[0], 0.0, (random(4) - 0.5) * 2.0 * dims[2]);
            let point = (eye + away).with_y(random(5) * 1.1 * dims[1]);
            let cell = point.floor().as_i64vec3();
            let wrap = |v: i64, n: f64| if repeats { v.rem_euclid(n as i64) } else { v };
            if columns.solid(wrap(cell.x, dims[0]), cell.y, wrap(cell.z, dims[2])) {
                continue;
            }
            let sun = sun(random(6) * 360.0, [0.5, 5.0, 30.0, 90.0][k as usize % 4]);
            let setup = plane_setup(&resident, &looking_from(eye), &options);
            let from_eye = (point - eye).as_vec3();
            let walk = Shadows::new(&resident, &tops, &setup, sun.as_vec3());
            let exact = ExactShadows {
                columns,
                repeats: [repeats; 2],
                eye,
                sun,
                view: crate::cpu::exact::view_distance(&options),
            };
            let expected = exact.lit(from_eye);
            let lit = walk.lit(from_eye + Vec3::X * wrong, 1.0);
            counts = [counts[0] + 1, counts[1] + u32::from(expected), counts[2] + u32::from(lit != expected)];
        }
        counts
    }

    fn worlds() -> [Scene; 4] {
        [
            scene([64, 40, 64], |x, y, z| {
                y < 4 + noise(x / 3, 0, z / 3) % 9 || (y < 36 && noise(x / 2, 0, z).is_multiple_of(30))
            }),
            scene([40, 30, 40], |x, y, z| noise(x, y, z).is_multiple_of(40)),
            scene([40, 60, 40], |x, y, z| noise(x, y / 9, z).is_multiple_of(9)),
            scene([13, 300, 12], |x, y, z| y.is_multiple_of(4) && noise(x, 0, z).is_multiple_of(3)),
        ]
    }

    #[test]
    fn shadows_lie_where_one_ray_says() {
        for (i, scene) in worlds().iter().enumerate() {
            for (features, repeats) in [(Features::ALL, false), (Features::ALL, true), (Features::NONE, false)] {
                let [n, lit, wrong] = judged(scene, features, repeats, 0.0);
                println!("world {i}, repeats {repeats}: {lit} of {n} lit, {wrong} wrong");
                assert!(n > 5000 && lit > n / 50 && lit < n - n / 50, "world {i}: {lit} of {n}");
                // Corners that a step past a border cuts.
                assert!(wrong <= n / 500, "world {i}, repeats {repeats}: {wrong} of {n}");
            }
        }
    }

    #[test]
    fn shadows_of_points_beside_are_others() {
        for (i, scene) in worlds().iter().enumerate() {
            let [n, _, wrong] = judged(scene, Features::ALL, false, 0.3);
            assert!(wrong > n / 200, "world {i}: {wrong} of {n}");
        }
    }

    /// A wall of 20 voxels over a floor: at 45° its shadow is as long as it is high.
    #[test]
    fn shadows_are_as_long_as_the_sun_is_low() {
        let scene = scene([200, 30, 64], |x, y, _| y < 2 || (x == 100 && y < 22));
        let resident = Resident::new(&scene);
        let tops = Tops::new(&resident);
        let eye = DVec3::new(30.0, 25.0, 32.0);
        let setup = plane_setup(&resident, &looking_from(eye), &Options::default());
        // Sun in the east: shadows fall to the west, lower x.
        for (elevation, length) in [(45.0, 20.0), (30.0, 20.0 * 3f64.sqrt()), (80.0, 20.0 / 80f64.to_radians().tan())] {
            let walk = Shadows::new(&resident, &tops, &setup, sun(90.0, elevation).as_vec3());
            for (x, lit) in [(100.0 - length - 0.1, true), (100.0 - length + 0.1, false), (101.1, true), (150.0, true)]
            {
                let point = DVec3::new(x, 2.0, 32.4);
                assert_eq!(walk.lit((point - eye).as_vec3(), 1.0), lit, "{elevation}: {x}");
            }
        }
        let night = Shadows::new(&resident, &tops, &setup, sun(90.0, -1.0).as_vec3());
        assert!(!night.lit(Vec3::ZERO, 1.0));
    }

    #[test]
    fn tops_are_those_of_every_level() {
        let scene = scene([37, 50, 21], |x, y, z| y < 1 + noise(x, 0, z) % 49);
        let resident = Resident::new(&scene);
        let tops = Tops::new(&resident);
        for (l, level) in resident.levels.iter().enumerate() {
            for k in l..tops.levels.len() {
                for (ix, (x, z)) in (0..level.nz).flat_map(|z| (0..level.nx).map(move |x| (x, z))).enumerate() {
                    let top = level.column(ix).next().map_or(0, |run| run.end() << l);
                    let (row, of) = &tops.levels[k];
                    let shift = BLOCK_SHIFT as usize + k - l;
                    assert!(of[((z >> shift) * row + (x >> shift)) as usize] >= top);
                }
            }
        }
        let highest = resident.levels[..tops.levels.len()].iter().enumerate().map(|(l, level)| level.top << l).max();
        assert_eq!(Some(tops.top), highest);
    }
}
