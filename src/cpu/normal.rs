//! Normals from what is solid around a voxel, for stage `shade`: away from the middle of the solid voxels in a ball of [`REACH`]
//! voxels around it, at the level that it is drawn at. All of it is in whole numbers, so that both twins have the same; a voxel has
//! one normal from whichever pixel it is seen. Of a ball of radius 50 they are 2.0° off on average, those of the screen more (a
//! test says how much). Twin: `shaders/shared/normal.wgsl`.

use crate::frame::plane_setup::Setup;
use crate::world::tables::{EMPTY, Resident, ResidentLevel, Table};
use glam::Vec3;
use planecast_encoder::Run;

/// Radius of the ball in voxels.
pub const REACH: f32 = 3.5;

/// Columns of the ball: beside its middle, and how many voxels above and below.
pub const COLUMNS: [[i32; 3]; 37] = columns();

/// How far into the surface the voxel that is shown is looked for, in voxels along the ray.
pub const INTO: f32 = 0.02;

const fn columns() -> [[i32; 3]; 37] {
    let mut out = [[0; 3]; 37];
    let (mut n, mut i) = (0, 0);
    while i < 49 {
        let (dx, dz) = (i % 7 - 3, i / 7 - 3);
        // 3.5² = 12.25.
        let left = 12 - dx * dx - dz * dz;
        if left >= 0 {
            let mut h = 0;
            while (h + 1) * (h + 1) <= left {
                h += 1;
            }
            out[n] = [dx, dz, h];
            n += 1;
        }
        i += 1;
    }
    assert!(n == 37);
    out
}

/// What is solid around the eye.
pub struct Occupancy<'a> {
    resident: &'a Resident,
    eye: [i32; 3],
    fract: [f32; 3],
    repeats: [bool; 2],
    levels: u32,
}

impl<'a> Occupancy<'a> {
    pub fn new(resident: &'a Resident, setup: &Setup) -> Occupancy<'a> {
        let fract = setup.eye_fract.map(|f| f as f32);
        Occupancy { resident, eye: setup.eye_cell, fract, repeats: setup.repeats, levels: setup.levels.max(1) }
    }

    /// The normal of the voxel at a point given from the eye, along a ray, drawn so large; `None` where what is around it has no side.
    #[inline(always)]
    pub fn at(&self, from_eye: Vec3, ray: Vec3, size: f32) -> Option<Vec3> {
        let l = (((size.to_bits() >> 23) as i32 - 127).max(0) as u32).min(self.levels - 1);
        let level = &self.resident.levels[l as usize];
        let into = ray * ((1u32 << l) as f32 * INTO / ray.length());
        let at = from_eye + into;
        let mut cell = [0; 3];
        for k in 0..3 {
            let floor = (at[k] + self.fract[k]).floor() as i32;
            cell[k] = self.eye[k].wrapping_add(floor) >> l;
        }
        let mut sum = [0i32; 3];
        for [dx, dz, reach] in COLUMNS {
            let Some(ix) = self.index(level, [cell[0].wrapping_add(dx), cell[2].wrapping_add(dz)]) else { continue };
            let [n, twice] = solid(level, ix, cell[1], reach);
            sum = [sum[0] + 2 * dx * n, sum[1] + twice, sum[2] + 2 * dz * n];
        }
        if sum == [0; 3] {
            return None;
        }
        let n = -Vec3::from(sum.map(|v| v as f32)).normalize();
        (n.dot(ray) < 0.0).then_some(n)
    }

    #[inline(always)]
    fn index(&self, level: &ResidentLevel, cell: [i32; 2]) -> Option<usize> {
        let dims = [level.nx as i32, level.nz as i32];
        let mut at = [0; 2];
        for axis in 0..2 {
            at[axis] = match self.repeats[axis] {
                true => cell[axis].rem_euclid(dims[axis]),
                false if (0..dims[axis]).contains(&cell[axis]) => cell[axis],
                false => return None,
            };
        }
        Some(level.index(at[0] as u32, at[1] as u32))
    }
}

/// Of a column's voxels up to `reach` above and below `y`: how many are solid, and twice the sum of how far they are above it.
#[inline(always)]
fn solid(level: &ResidentLevel, ix: usize, y: i32, reach: i32) -> [i32; 2] {
    let (low, high) = (y.wrapping_sub(reach), y.wrapping_add(reach + 1));
    let of = |first: i32, end: i32| {
        let (first, end) = (first.max(low), end.min(high));
        // Of y far from all nothing is worked out.
        if end <= first { [0; 2] } else { [end - first, (end - first) * (first + end - 1 - 2 * y)] }
    };
    match &level.table {
        Table::Heights(heights) => of(0, i32::from(heights[ix])),
        Table::Runs { columns, runs } => {
            let [top, more] = columns[ix];
            if top == EMPTY {
                return [0; 2];
            }
            let bounds = |run: u32| (i32::from(Run(run).first()), Run(run).end() as i32);
            let (first, end) = bounds(top);
            let [mut n, mut twice] = of(first, end);
            if more != 0 && first > low {
                let at = more as usize;
                let rest = &runs[at + 1..at + 1 + runs[at] as usize];
                for &run in &rest[rest.partition_point(|&run| bounds(run).0 >= high)..] {
                    let (first, end) = bounds(run);
                    if end <= low {
                        break;
                    }
                    let [own, own_twice] = of(first, end);
                    (n, twice) = (n + own, twice + own_twice);
                }
            }
            [n, twice]
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::plane_setup::plane_setup;
    use crate::{Camera, CpuRenderer, Features, Options, Outputs};
    use glam::DVec3;
    use planecast_encoder::{BuildOptions, Colors, Columns, Input, build};

    /// Mean angles, in degrees, between the normals of a ball of radius 50 and those derived, and those of the screen.
    #[test]
    fn normals_of_a_ball_are_right_to_three_degrees() {
        let middle = DVec3::new(58.3, 57.9, 58.1);
        let solid = |x: u32, y: u32, z: u32| (DVec3::new(x.into(), y.into(), z.into()) + 0.5 - middle).length() <= 50.0;
        let columns = Columns::from_fn(116, 116, 116, solid);
        let scene =
            build(Input { columns, colors: Colors::None, notes: Vec::new() }, &BuildOptions::default()).unwrap();
        let resident = Resident::with(&scene, Features::ALL);
        let (scene, resident) = (std::sync::Arc::new(scene), std::sync::Arc::new(resident));
        let (width, height) = (320, 240);
        let eye = DVec3::new(58.0, 110.0, 190.0);
        let camera = Camera { eye, yaw: 0.0, pitch: -20.0, roll: 0.0, fov: 50.0, width, height };
        let options = Options { lod: None, ..Options::default() };
        let frame = CpuRenderer::new(&scene, &resident).exact(&camera, &options, Outputs { voxel: true }).unwrap();
        let setup = plane_setup(&resident, &camera, &options);
        let derived = Occupancy::new(&resident, &setup);
        let screen = crate::cpu::shade::screen_normals(&camera, &options, &frame.depth);
        let basis = camera.basis();
        let (mut n, mut without, mut sums) = (0.0, 0, [0.0; 2]);
        for (i, &depth) in frame.depth.iter().enumerate().filter(|(_, z)| z.is_finite()) {
            let ray = camera.ray(&basis, f64::from(i as u32 % width) + 0.5, f64::from(i as u32 / width) + 0.5);
            let [x, y, z, _] = frame.voxel[i].map(f64::from);
            let truth = (DVec3::new(x, y, z) + 0.5 - middle).normalize();
            // At the rim it may point away: then that of the screen is taken.
            let Some(own) = derived.at((ray * f64::from(depth)).as_vec3(), ray.as_vec3(), 1.0) else {
                without += 1;
                continue;
            };
            let of_screen = screen[i];
            let of_screen = basis.right * f64::from(of_screen.x)
                + basis.up * f64::from(of_screen.y)
                + basis.forward * f64::from(of_screen.z);
            n += 1.0;
            for (sum, normal) in sums.iter_mut().zip([own.as_dvec3(), of_screen]) {
                *sum += normal.dot(truth).clamp(-1.0, 1.0).acos().to_degrees();
            }
        }
        let [own, of_screen] = sums.map(|sum| sum / n);
        println!("of {n} pixels: derived {own:.2} degrees off, of the screen {of_screen:.2}");
        assert!(n > 10_000.0 && f64::from(without) < 0.03 * n && own < 2.5 && own < of_screen, "{own} {of_screen}");
    }

    #[test]
    fn columns_are_those_of_the_ball() {
        let mut n = 0;
        for [dx, dz, reach] in COLUMNS {
            let inside = |dy: i32| ((dx * dx + dy * dy + dz * dz) as f32) <= REACH * REACH;
            assert!(inside(reach) && !inside(reach + 1));
            n += 2 * reach + 1;
        }
        assert_eq!(n, 179);
    }

    #[test]
    fn normals_of_flat_things_are_theirs_and_sheets_have_none() {
        let floor = Columns::from_fn(20, 20, 20, |_, y, z| y < 5 || (y == 12 && z > 10));
        let scene =
            build(Input { columns: floor, colors: Colors::None, notes: Vec::new() }, &BuildOptions::default()).unwrap();
        for features in [Features::ALL, Features::NONE] {
            let resident = Resident::with(&scene, features);
            let eye = DVec3::new(10.5, 18.25, 8.5);
            let setup = plane_setup(&resident, &Camera { eye, ..Camera::default() }, &Options::default());
            let derived = Occupancy::new(&resident, &setup);
            let down = |z: f32, depth: f32| derived.at(Vec3::new(0.0, -depth, z), Vec3::new(0.0, -1.0, 0.0), 1.0);
            assert_eq!(down(-2.0, 13.25), Some(Vec3::Y));
            assert_eq!(down(6.0, 5.25), None);
        }
    }
}
