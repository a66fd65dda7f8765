//! One f32 ray a pixel through the scene's [`Tree`], straight into the picture: the baseline that planes are measured
//! against. Twin: `shaders/raycast.wgsl`.

use crate::cpu::chunks_mut;
use crate::cpu::remap::{Row, ray_inverse};
use crate::cpu::traverse::{Counters, Real, SKY, has_avx2};
use crate::frame::camera::Camera;
use crate::frame::plane_setup::{Plane, Setup};
use crate::world::tables::Resident;
use crate::world::tree::{Cell, Cursor, Tree};
use glam::DVec3;
use rayon::prelude::*;

/// "Never", safe to multiply with.
const STEEP: f32 = 1e18;

/// The view ends here at the latest, in voxels: crossings beyond no longer tell cells apart.
const VIEW_LIMIT: f64 = 1e9;

/// Colour (0: sky), depth and, where they are wanted, voxels of all pixels, as planes have them: in cells of a level. Returns
/// as columns those that rays came into, as runs the cells and empty cubes that they looked at, as spans the rays that met
/// something.
pub fn raycast(
    resident: &Resident,
    tree: &Tree,
    setup: &Setup,
    camera: &Camera,
    color: &mut [u32],
    depth: &mut [f32],
    voxel: &mut [[i32; 4]],
) -> Counters {
    let w = camera.width as usize;
    let basis = camera.basis();
    let scene = View::new(resident, setup);
    let voxels = chunks_mut(voxel, w, camera.height as usize);
    let rows = color.par_chunks_mut(w).zip(depth.par_chunks_mut(w)).zip(voxels);
    let avx2 = has_avx2();
    let counted = rows.enumerate().map(|(r, ((color, depth), voxel))| {
        let y = r as f64 + 0.5;
        let start = camera.ray(&basis, 0.5, y);
        let step = (camera.ray(&basis, w as f64 + 0.5, y) - start) / w as f64;
        let rays = Rays { view: &scene, cursor: Cursor::new(tree), counters: Counters::default() };
        let task = RowTask { setup, row: Row::new(setup, r as u32, camera.width), start, step, color, depth, voxel };
        #[cfg(target_arch = "x86_64")]
        if avx2 {
            // SAFETY: `has_avx2` has seen that the processor can.
            return unsafe { raycast_row_avx2(rays, task) };
        }
        let _ = avx2;
        raycast_row::<false>(rays, task)
    });
    counted.reduce(Counters::default, |mut a, b| {
        a += b;
        a
    })
}

/// A row of a picture.
struct RowTask<'a> {
    setup: &'a Setup,
    row: Row<'a>,
    /// The first pixel's ray, and from one to the next.
    start: DVec3,
    step: DVec3,
    color: &'a mut [u32],
    depth: &'a mut [f32],
    /// Or none.
    voxel: &'a mut [[i32; 4]],
}

/// The same code for processors with AVX2; the same bits.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
fn raycast_row_avx2(rays: Rays<'_>, task: RowTask<'_>) -> Counters {
    raycast_row::<true>(rays, task)
}

/// With a parameter of which nothing depends but that each caller has a closure of its own, which is inlined there.
#[inline(always)]
fn raycast_row<const AVX2: bool>(mut rays: Rays<'_>, task: RowTask<'_>) -> Counters {
    let RowTask { setup, row, start, step, color, depth, voxel } = task;
    for stretch in row.stretches() {
        let fan = &setup.fans[stretch.fan];
        row.gather(stretch, |x, place| {
            let plane = &setup.planes[(fan.first_plane + place.plane) as usize];
            let ray = start + step * x as f64;
            let met = rays.walk([ray.x as f32, ray.y as f32, ray.z as f32], plane);
            let Met { voxel: v, depth: z, color: c } =
                met.unwrap_or(Met { voxel: SKY, depth: f32::INFINITY, color: 0 });
            (color[x], depth[x]) = (c, z);
            if let Some(voxel) = voxel.get_mut(x) {
                *voxel = v;
            }
        });
    }
    rays.counters
}

/// What all rays share.
struct View<'a> {
    resident: &'a Resident,
    levels: usize,
    eye: [i32; 3],
    fract: [f32; 3],
    repeats: [bool; 3],
    distance: f32,
}

impl<'a> View<'a> {
    fn new(resident: &'a Resident, setup: &Setup) -> View<'a> {
        View {
            resident,
            levels: setup.levels as usize,
            eye: setup.eye_cell,
            fract: setup.eye_fract.map(|f| f as f32),
            repeats: [setup.repeats[0], false, setup.repeats[1]],
            distance: setup.view_distance.min(VIEW_LIMIT) as f32,
        }
    }

    /// First cell of a level, and one past the last, along each axis.
    fn bounds(&self, l: usize) -> [[i32; 2]; 3] {
        let level = &self.resident.levels[l];
        [[0, level.nx as i32], [level.bottom as i32, level.top as i32], [0, level.nz as i32]]
    }
}

struct Met {
    voxel: [i32; 4],
    depth: f32,
    color: u32,
}

/// Rays, one after the other.
struct Rays<'a> {
    view: &'a View<'a>,
    cursor: Cursor<'a>,
    counters: Counters,
}

/// A ray: direction with component 1 along the camera's forward axis, so that its parameter is depth.
struct Ray<'a> {
    view: &'a View<'a>,
    dir: [f32; 3],
    inverse: [f32; 3],
    /// 1 or -1 along each axis; 1 where the far side of a cell has the greater number.
    step: [i32; 3],
    ahead: [i32; 3],
}

impl Ray<'_> {
    /// Depth at which grid line `line` of level 0 is crossed.
    #[inline(always)]
    fn cross(&self, axis: usize, line: i32) -> f32 {
        let at = line.wrapping_sub(self.view.eye[axis]) as f32 - self.view.fract[axis];
        if self.dir[axis] == 0.0 { STEEP } else { at * self.inverse[axis] }
    }

    /// The cell of level `l` that holds depth `q`: estimated, then put right by the crossings.
    #[inline(always)]
    fn locate(&self, axis: usize, q: f32, l: usize) -> i32 {
        let mut at = (self.view.fract[axis] + q * self.dir[axis]).floor_i32().wrapping_add(self.view.eye[axis]) >> l;
        if self.dir[axis] == 0.0 {
            return at;
        }
        if self.cross(axis, at.wrapping_add(self.ahead[axis]) << l) <= q {
            at = at.wrapping_add(self.step[axis]);
        } else if self.cross(axis, at.wrapping_add(1 - self.ahead[axis]) << l) > q {
            at = at.wrapping_sub(self.step[axis]);
        }
        at
    }

    /// The part of `q0 .. q1` in which the ray lies between two grid lines of level 0.
    #[inline(always)]
    fn within(&self, axis: usize, [low, high]: [i32; 2], [q0, q1]: [f32; 2]) -> [f32; 2] {
        if self.dir[axis] == 0.0 {
            let eye = self.view.eye[axis];
            return if (low..high).contains(&eye) { [q0, q1] } else { [q0, f32::NEG_INFINITY] };
        }
        let (from, to) = if self.step[axis] > 0 { (low, high) } else { (high, low) };
        [Real::max(q0, self.cross(axis, from)), Real::min(q1, self.cross(axis, to))]
    }
}

impl Rays<'_> {
    fn walk(&mut self, dir: [f32; 3], plane: &Plane) -> Option<Met> {
        let view = self.view;
        let step = dir.map(|d| if d < 0.0 { -1 } else { 1 });
        let ray = Ray { view, dir, inverse: dir.map(ray_inverse), step, ahead: step.map(|s| i32::from(s > 0)) };
        let horizontal = Real::max((dir[0] * dir[0] + dir[2] * dir[2]).sqrt(), 1e-20);
        let mut part = [0.0, Real::min(view.distance / horizontal, 1e17)];
        for axis in [0, 2] {
            if !view.repeats[axis] {
                part = ray.within(axis, view.bounds(0)[axis], part);
            }
        }
        let [mut q, q_end] = part;
        // Levels begin where those of the pixel's plane do.
        let lod = plane.lod_t.min(1e17) as f32 / horizontal;
        let end_of = |l: usize| if l + 1 < view.levels { lod * (1u32 << (l + 1)) as f32 } else { STEEP };
        let mut l = plane.lod_first as usize;
        while q < q_end {
            let limit = Real::min(q_end, end_of(l));
            if q < limit {
                let [bottom, top] = view.bounds(l)[1];
                let [from, to] = ray.within(1, [bottom << l, top << l], [q, limit]);
                if from < to
                    && let Some(met) = self.level(&ray, l, from, to)
                {
                    return Some(met);
                }
                q = limit;
            }
            if l + 1 >= view.levels {
                break;
            }
            l += 1;
        }
        None
    }

    /// What the ray meets of a level between two depths.
    #[inline(always)]
    fn level(&mut self, ray: &Ray<'_>, l: usize, from: f32, to: f32) -> Option<Met> {
        let view = self.view;
        let bounds = view.bounds(l);
        let mut cell = [0, 1, 2].map(|axis| {
            let at = ray.locate(axis, from, l);
            if view.repeats[axis] { at } else { at.clamp(bounds[axis][0], bounds[axis][1] - 1) }
        });
        let mut q = from;
        self.counters.columns_visited += 1;
        while q < to {
            self.counters.runs_visited += 1;
            let within = [0, 1, 2].map(|axis| {
                let n = bounds[axis][1];
                if view.repeats[axis] && !(0..n).contains(&cell[axis]) { cell[axis].rem_euclid(n) } else { cell[axis] }
            });
            let found = self.cursor.find(l, within.map(|v| v as u32));
            let shift = match found {
                Cell::Solid => 0,
                Cell::Empty(shift) => shift,
            };
            // Out of the cube, or of the world, which may repeat from there on.
            let side = (1 << shift) - 1;
            let stop = [0, 1, 2].map(|axis| {
                let [low, high] = bounds[axis];
                let v = within[axis];
                cell[axis]
                    + if ray.step[axis] > 0 { (v | side).min(high - 1) + 1 - v } else { (v & !side).max(low) - 1 - v }
            });
            let exit = [0, 1, 2].map(|axis| ray.cross(axis, (stop[axis] + 1 - ray.ahead[axis]) << l));
            let axis = match exit {
                [x, y, z] if x <= y && x <= z => 0,
                [_, y, z] if y <= z => 1,
                _ => 2,
            };
            // A cell of which the ray has no more than a point is not met.
            if found == Cell::Solid && exit[axis] > q {
                let level = &view.resident.levels[l];
                let ix = (within[2] * level.nx as i32 + within[0]) as usize;
                let y = within[1] as u32;
                // Runs are numbered from the top down.
                let run = level.column(ix).position(|run| u32::from(run.first()) <= y).unwrap_or(0);
                let color = level.color(ix, run as u32, y);
                return Some(Met {
                    voxel: [cell[0], cell[1], cell[2], l as i32],
                    depth: q.clamp(0.0, f32::MAX),
                    color,
                });
            }
            if exit[axis] >= to {
                return None;
            }
            q = Real::max(q, exit[axis]);
            self.counters.columns_visited += u64::from(axis != 1);
            for other in 0..3 {
                if other == axis {
                    cell[axis] = stop[axis];
                } else if shift > 0 {
                    let inner = stop[other] - ray.step[other];
                    let [low, high] = [cell[other].min(inner), cell[other].max(inner)];
                    cell[other] = ray.locate(other, q, l).clamp(low, high);
                }
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use crate::{Camera, CpuRenderer, Options, Outputs, Repeat, Resident, Shading};
    use glam::DVec3;
    use planecast_encoder::source::procedural::{Kind, procedural};
    use planecast_encoder::{BuildOptions, ColorMode, build};
    use std::sync::Arc;

    /// Voxels, colours and depths of exact rays, in every mode of colour, in a world that ends and in one that repeats.
    #[test]
    fn raycast_meets_what_exact_rays_meet() {
        for (kind, color) in
            [(Kind::Rocks, ColorMode::Voxel), (Kind::Mixing, ColorMode::Run), (Kind::Hills, ColorMode::Run)]
        {
            let options = BuildOptions { color: Some(color), ..Default::default() };
            let scene = Arc::new(build(procedural(kind, 48, 3).unwrap(), &options).unwrap());
            let resident = Arc::new(Resident::new(&scene));
            let mut renderer = CpuRenderer::new(&scene, &resident);
            renderer.set_raycast(true);
            let poses =
                [(20.0, -35.0, 0.0), (200.0, -90.0, 0.0), (90.0, 0.0, 0.0), (310.0, 25.0, 40.0), (0.0, -5.0, 90.0)];
            for (repeats, (yaw, pitch, roll)) in poses.into_iter().flat_map(|pose| [(false, pose), (true, pose)]) {
                let eye = DVec3::new(20.37, 41.61, 25.13);
                let camera = Camera { eye, yaw, pitch, roll, fov: 75.0, width: 96, height: 64 };
                let repeat = Repeat { x: repeats, z: repeats };
                let view_distance = if repeats { 300.0 } else { f64::INFINITY };
                let options =
                    Options { lod: None, repeat, view_distance, shading: Shading::None, ..Options::default() };
                let drawn = renderer.render(&camera, &options, Outputs { voxel: true }).unwrap();
                let exact = renderer.exact(&camera, &options, Outputs { voxel: true }).unwrap();
                let same: Vec<usize> = (0..exact.voxel.len()).filter(|&i| drawn.voxel[i] == exact.voxel[i]).collect();
                let what = format!("{kind:?} {color:?} {camera:?} repeats {repeats}");
                assert!(same.len() as f64 >= 0.998 * exact.voxel.len() as f64, "{what}: {}", same.len());
                for i in same {
                    let (z, expected) = (drawn.depth[i], exact.depth[i]);
                    assert!(
                        z == expected || (z - expected).abs() <= 1e-5 * expected.max(1.0),
                        "{what}: {z} {expected}"
                    );
                    assert_eq!(drawn.color[i], exact.color[i], "{what}, pixel {i}");
                }
            }
        }
    }
}
