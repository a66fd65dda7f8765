//! The reference: one ray a pixel at level 0, in f64, sharing no code with the planes.

use crate::cpu::smooth::Ground;
use crate::frame::camera::Camera;
use crate::frame::options::Options;
use crate::frame::plane_setup::{FARTHEST_VIEW, REPEATED_VIEW_DISTANCE};
use crate::frame::projection::Rays;
use crate::world::tables::Resident;
use glam::DVec3;
use planecast_encoder::{Columns, Scene};
use rayon::prelude::*;

/// What a ray meets first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Level-0 voxel; along a repeated axis of the unrepeated world.
    pub voxel: [i64; 3],
    /// Parameter along the ray's direction at which it enters the voxel; 0 where it starts inside.
    pub t: f64,
    pub face: Face,
    /// Column number in the level's tables, and which of the column's runs was met, from the bottom up.
    pub column: usize,
    pub run: usize,
}

/// The side of a voxel that a ray enters by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub enum Face {
    /// The ray starts inside the voxel.
    #[serde(rename = "inside")]
    Inside,
    #[serde(rename = "-x")]
    NegX,
    #[serde(rename = "+x")]
    PosX,
    #[serde(rename = "-y")]
    NegY,
    #[serde(rename = "+y")]
    PosY,
    #[serde(rename = "-z")]
    NegZ,
    #[serde(rename = "+z")]
    PosZ,
}

/// The first voxel of `columns` along a ray, if it is entered before `t_max`. `repeats`: whether the world is tiled along x
/// and z. Amanatides & Woo 1987 over columns, crossings recomputed from integers; a tie steps along x first.
pub fn cast(columns: &Columns, repeats: [bool; 2], eye: DVec3, dir: DVec3, t_max: f64) -> Option<Hit> {
    let size = [i64::from(columns.nx()), i64::from(columns.nz())];
    let (origin, direction) = ([eye.x, eye.z], [dir.x, dir.z]);
    let (mut t0, mut t_end) = (0.0, t_max);
    let mut entered = None;
    for axis in 0..2 {
        if repeats[axis] {
            continue;
        }
        let (o, d, n) = (origin[axis], direction[axis], size[axis] as f64);
        if d == 0.0 {
            if o < 0.0 || o >= n {
                return None;
            }
            continue;
        }
        let (near, far) = if d > 0.0 { (0.0, n) } else { (n, 0.0) };
        // At the far border exactly the eye is outside, though at no distance.
        if (near - o) / d > t0 || (o >= n && (near - o) / d == t0) {
            t0 = (near - o) / d;
            entered = Some(axis);
        }
        t_end = f64::min(t_end, (far - o) / d);
    }
    // Far above or below the world there is nothing to walk through; a voxel short of it, no rounding can matter.
    let nearby = if dir.y > 0.0 { (-1.0 - eye.y) / dir.y } else { (f64::from(columns.ny()) + 1.0 - eye.y) / dir.y };
    if dir.y != 0.0 && nearby > t0 {
        (t0, entered) = (nearby, None);
    }
    let mut cell = [0i64; 2];
    for axis in 0..2 {
        cell[axis] = (origin[axis] + t0 * direction[axis]).floor() as i64;
        if entered == Some(axis) {
            cell[axis] = if direction[axis] > 0.0 { 0 } else { size[axis] - 1 };
        } else if !repeats[axis] {
            cell[axis] = cell[axis].clamp(0, size[axis] - 1);
        }
    }
    let step = direction.map(|d| if d < 0.0 { -1 } else { 1 });
    let cross = |axis: usize, cell: i64| {
        let line = cell + i64::from(step[axis] > 0);
        if direction[axis] == 0.0 { f64::INFINITY } else { (line as f64 - origin[axis]) / direction[axis] }
    };
    let side = |axis: Option<usize>| match axis {
        None => Face::Inside,
        Some(0) => {
            if step[0] > 0 {
                Face::NegX
            } else {
                Face::PosX
            }
        }
        Some(_) => {
            if step[1] > 0 {
                Face::NegZ
            } else {
                Face::PosZ
            }
        }
    };
    // A ray that has left the world's heights for good meets nothing more.
    let height = f64::from(columns.ny());
    let y_end = if dir.y > 0.0 {
        (height - eye.y) / dir.y
    } else if dir.y < 0.0 {
        -eye.y / dir.y
    } else if eye.y < 0.0 || eye.y >= height {
        return None;
    } else {
        f64::INFINITY
    };
    t_end = t_end.min(y_end);
    loop {
        if t0 >= t_end {
            return None;
        }
        let next = [cross(0, cell[0]), cross(1, cell[1])];
        let axis = usize::from(next[1] < next[0]);
        let t1 = next[axis].min(t_end);
        if t1 > t0 {
            let column = cell[1].rem_euclid(size[1]) as usize * size[0] as usize + cell[0].rem_euclid(size[0]) as usize;
            if let Some((y, t, run, vertical)) = meet(columns, column, eye.y, dir.y, t0, t1) {
                let face = match vertical {
                    false => side(entered),
                    true if dir.y < 0.0 => Face::PosY,
                    true => Face::NegY,
                };
                return Some(Hit { voxel: [cell[0], y, cell[1]], t, face, column, run });
            }
            t0 = t1;
        }
        cell[axis] += step[axis];
        entered = Some(axis);
    }
}

/// First voxel of one column that a ray meets between `t0` and `t1`: its y, the parameter, its run, and whether the ray
/// comes through a horizontal face.
fn meet(columns: &Columns, column: usize, eye: f64, dy: f64, t0: f64, t1: f64) -> Option<(i64, f64, usize, bool)> {
    let runs = &columns.runs()[columns.range(column)];
    let (y0, y1) = (eye + t0 * dy, eye + t1 * dy);
    if dy >= 0.0 {
        // The first run that ends above y0.
        let k = runs.partition_point(|r| f64::from(r.end()) <= y0);
        let first = f64::from(runs.get(k)?.first());
        if first <= y0 {
            return Some((y0.floor() as i64, t0, k, false));
        }
        (first < y1).then(|| (first as i64, (first - eye) / dy, k, true))
    } else {
        // The last run that starts below y0.
        let k = runs.partition_point(|r| f64::from(r.first()) < y0).checked_sub(1)?;
        let end = f64::from(runs[k].end());
        if end > y0 {
            return Some((y0.floor().max(f64::from(runs[k].first())) as i64, t0, k, false));
        }
        (end > y1).then(|| (end as i64 - 1, (end - eye) / dy, k, true))
    }
}

/// How far is drawn, in voxels.
pub fn view_distance(options: &Options) -> f64 {
    let repeats = options.repeat.x || options.repeat.z;
    match repeats {
        false => options.view_distance,
        true if options.view_distance.is_finite() => options.view_distance.min(FARTHEST_VIEW),
        true => REPEATED_VIEW_DISTANCE,
    }
}

/// Renders into `color` (packed, 0 for sky), `depth` and, unless empty, `voxel`.
pub fn exact(
    scene: &Scene,
    resident: &Resident,
    camera: &Camera,
    options: &Options,
    color: &mut [u32],
    depth: &mut [f32],
    voxel: &mut [[i32; 4]],
) {
    let rays = Rays::new(camera, options.projection, resident.dims);
    let columns = scene.levels[0].geometry(scene.encoding);
    let repeats = [options.repeat.x, options.repeat.z];
    let view = view_distance(options);
    let surface = options.smooth.then(|| Surface::new(scene, resident, repeats, camera.eye)).flatten();
    let wants_voxel = !voxel.is_empty();
    let width = camera.width as usize;
    let mut no_voxel = vec![[0; 4]; if wants_voxel { 0 } else { color.len() }];
    let voxel = if wants_voxel { voxel } else { &mut no_voxel };
    let rows = color.par_chunks_mut(width).zip(depth.par_chunks_mut(width)).zip(voxel.par_chunks_mut(width));
    rows.enumerate().for_each(|(r, ((color, depth), voxel))| {
        for c in 0..width {
            let Some(dir) = rays.direction(c as u32, r as u32) else {
                (color[c], depth[c], voxel[c]) = (0, f32::INFINITY, [-1; 4]);
                continue;
            };
            let origin = rays.origin(c as u32, r as u32);
            let horizontal = dir.x.hypot(dir.z);
            let t_max = if horizontal > 0.0 { view / horizontal } else { f64::INFINITY };
            if let Some(surface) = &surface {
                (color[c], depth[c], voxel[c]) = match surface.meet(camera.eye, dir, t_max) {
                    Some(met) => (met.color, met.t as f32, [met.column[0] as i32, met.y, met.column[1] as i32, 0]),
                    None => (0, f32::INFINITY, [-1; 4]),
                };
                continue;
            }
            match cast(columns, repeats, origin, dir, t_max) {
                None => (color[c], depth[c], voxel[c]) = (0, f32::INFINITY, [-1; 4]),
                Some(hit) => {
                    let n = columns.range(hit.column).len();
                    color[c] = resident.levels[0].color(hit.column, (n - 1 - hit.run) as u32, hit.voxel[1] as u32);
                    depth[c] = hit.t as f32;
                    voxel[c] = [hit.voxel[0] as i32, hit.voxel[1] as i32, hit.voxel[2] as i32, 0];
                }
            }
        }
    });
}

/// The bilinear surface that a height field stands for with [`Options::smooth`], met by one f64 ray without any step left out.
struct Surface<'a> {
    ground: Ground<'a>,
    dims: [i64; 2],
    repeats: [bool; 2],
    /// Above every place of it.
    top: f64,
}

struct Met {
    t: f64,
    column: [i64; 2],
    y: i32,
    color: u32,
}

impl<'a> Surface<'a> {
    /// `None` where the world is no height field, or the eye is below the surface: blocks are drawn then.
    fn new(scene: &Scene, resident: &'a Resident, repeats: [bool; 2], eye: DVec3) -> Option<Surface<'a>> {
        let ground = Ground::new(resident, repeats)?;
        let [nx, ny, nz] = scene.dims();
        let surface = Surface { ground, dims: [nx.into(), nz.into()], repeats, top: f64::from(ny) + 1.0 };
        let cell = [eye.x, eye.z].map(|v| v.floor() as i64);
        let below = surface
            .column(cell)
            .is_some_and(|ix| ground.height(ix) >= 0.0 && eye.y <= surface.patch_at([eye.x, eye.z]).0);
        (!below).then_some(surface)
    }

    fn column(&self, cell: [i64; 2]) -> Option<usize> {
        self.ground.index([0, 1].map(|k| match self.repeats[k] {
            true => cell[k].rem_euclid(self.dims[k]) as i32,
            false => cell[k].clamp(-1, self.dims[k]) as i32,
        }))
    }

    /// Height of the surface at a place; its patch's corners, where the patch begins, and its terms.
    fn patch_at(&self, at: [f64; 2]) -> (f64, [usize; 4], [f64; 2], [f64; 4]) {
        let first = at.map(|v| (v - 0.5).floor());
        let corner = [0, 1].map(|k| match self.repeats[k] {
            true => (first[k] as i64).rem_euclid(self.dims[k]) as i32,
            false => (first[k] as i64).clamp(-1, self.dims[k]) as i32,
        });
        let columns = self.ground.columns(corner);
        let terms = self.ground.patch(columns).map(f64::from);
        let [u, v] = [0, 1].map(|k| at[k] - first[k] - 0.5);
        (terms[0] + terms[1] * u + terms[2] * v + terms[3] * u * v, columns, [u, v], terms)
    }

    fn meet(&self, eye: DVec3, dir: DVec3, t_max: f64) -> Option<Met> {
        let (origin, direction) = ([eye.x, eye.z], [dir.x, dir.z]);
        let (mut t, mut end) = (0.0f64, t_max);
        for k in (0..2).filter(|&k| !self.repeats[k]) {
            if direction[k] == 0.0 {
                if origin[k] < 0.0 || origin[k] >= self.dims[k] as f64 {
                    return None;
                }
                continue;
            }
            let [a, b] = [0.0, self.dims[k] as f64].map(|side| (side - origin[k]) / direction[k]);
            (t, end) = (t.max(a.min(b)), end.min(a.max(b)));
        }
        let (to_top, to_ground) = ((self.top - eye.y) / dir.y, -eye.y / dir.y);
        if dir.y < 0.0 {
            (t, end) = (t.max(to_top), end.min(to_ground));
        } else if dir.y > 0.0 {
            (t, end) = (t.max(to_ground), end.min(to_top));
        } else if eye.y >= self.top {
            return None;
        }
        // The middle of each stretch between lines half a column apart tells where it lies.
        let step = direction.map(|d| if d < 0.0 { -1.0 } else { 1.0 });
        let mut line = [0, 1].map(|k| {
            let at = (origin[k] + t * direction[k]) * 2.0;
            if step[k] > 0.0 { at.floor() + 1.0 } else { at.ceil() - 1.0 }
        });
        let cross = |k: usize, line: f64| match direction[k] == 0.0 {
            true => f64::INFINITY,
            false => (0.5 * line - origin[k]) / direction[k],
        };
        while t < end {
            let lines = [cross(0, line[0]), cross(1, line[1])];
            let k = usize::from(lines[1] < lines[0]);
            let next = lines[k].min(end);
            if next > t {
                let middle = [0, 1].map(|k| origin[k] + 0.5 * (t + next) * direction[k]);
                let column = middle.map(|v| v.floor() as i64);
                if let Some(ix) = self.column(column).filter(|&ix| self.ground.height(ix) >= 0.0) {
                    let (_, columns, [u, v], [a, b, c, d]) = self.patch_at(middle);
                    let half = 0.5 * (t - next);
                    let [u, v] = [u + half * dir.x, v + half * dir.z];
                    let above = eye.y + t * dir.y - (a + b * u + c * v + d * u * v);
                    let slope = dir.y - (b * dir.x + c * dir.z + d * (u * dir.z + v * dir.x));
                    if let Some(s) = first_below(above, slope, -d * dir.x * dir.z, next - t) {
                        let top = self.ground.height(ix).round() as i32 - 1;
                        let place = [u + s * dir.x, v + s * dir.z].map(|v| v.clamp(0.0, 1.0) as f32);
                        let y = ((eye.y + (t + s) * dir.y) as i32).clamp(0, top.max(0));
                        return Some(Met { t: t + s, column, y, color: self.ground.color(columns, place) });
                    }
                }
                t = next;
            }
            line[k] += step[k];
        }
        None
    }
}

/// The least s of 0 to `most` at which `c + b·s + a·s²` is not above 0.
fn first_below(c: f64, b: f64, a: f64, most: f64) -> Option<f64> {
    if c <= 0.0 {
        return Some(0.0);
    }
    if a.abs() < 1e-300 {
        return Some(-c / b).filter(|s| b < 0.0 && *s <= most);
    }
    let square = b * b - 4.0 * a * c;
    let q = -0.5 * (b + b.signum() * square.max(0.0).sqrt());
    let roots = [q / a, c / q].into_iter().filter(|s| *s >= 0.0 && *s <= most);
    roots.fold(None, |least: Option<f64>, s| Some(least.map_or(s, |l| l.min(s)))).filter(|_| square >= 0.0)
}
