//! Stage `smooth`: where a height field is so near that its columns are seen one by one, pixels show a surface, not blocks.
//!
//! The surface passes over each column's middle at the column's height (with its fraction, where the scene keeps one) and is
//! bilinear between four of them. A column without voxels is a hole in it, with a wall around, as is the world's edge. A
//! pixel's ray is walked over quarters of columns, in each of which the surface is one bilinear patch and its crossing the root of
//! a quadratic; squares of columns that the ray passes above are stepped over ([`Tops::over_surface`]). Colours are bilinear too.
//! Twin: `shaders/smooth.wgsl`.

use crate::cpu::remap::{Pixels, ray_inverse};
use crate::cpu::shadow::{PAST, Tops};
use crate::cpu::traverse::has_avx2;
use crate::frame::camera::Camera;
use crate::frame::plane_setup::Setup;
use crate::world::tables::{Resident, ResidentLevel, Table};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// A column is drawn as part of a surface where it is wider than so many pixels.
pub const PIXELS: f32 = 1.0;

/// Quarters of columns and squares that a ray is walked over at most.
pub const STEPS: u32 = 8192;

/// log2 of the columns a side of the smallest squares whose tops are known.
pub const SQUARE_SHIFT: u32 = 1;

/// What stands for a column without voxels.
pub const HOLE: f32 = -1e9;

/// The surface over level 0.
#[derive(Clone, Copy)]
pub struct Ground<'a> {
    level: &'a ResidentLevel,
    heights: &'a [u16],
    fractions: &'a [u8],
    pub dims: [i32; 2],
    repeats: [bool; 2],
}

impl<'a> Ground<'a> {
    /// `None` where the world is no height field.
    pub fn new(resident: &'a Resident, repeats: [bool; 2]) -> Option<Ground<'a>> {
        let level = resident.levels.first()?;
        let Table::Heights(heights) = &level.table else { return None };
        let dims = [level.nx as i32, level.nz as i32];
        Some(Ground { level, heights, fractions: &resident.fractions, dims, repeats })
    }

    /// Where in the world a place lies, if it does.
    #[inline(always)]
    fn place(&self, [x, z]: [i32; 2]) -> Option<[i32; 2]> {
        let [nx, nz] = self.dims;
        if (x as u32) < nx as u32 && (z as u32) < nz as u32 {
            return Some([x, z]);
        }
        let x = if self.repeats[0] { x.rem_euclid(nx) } else { x };
        let z = if self.repeats[1] { z.rem_euclid(nz) } else { z };
        ((x as u32) < nx as u32 && (z as u32) < nz as u32).then_some([x, z])
    }

    /// Number of the column at a place, if there is one.
    #[inline(always)]
    pub fn index(&self, cell: [i32; 2]) -> Option<usize> {
        self.place(cell).map(|[x, z]| (z * self.dims[0] + x) as usize)
    }

    /// Height of the surface over a column's middle, [`HOLE`] where it has no voxels.
    #[inline(always)]
    pub fn height(&self, ix: usize) -> f32 {
        let fraction = self.fractions.get(ix).map_or(0.0, |&f| (f32::from(f) - 128.0) * (1.0 / 256.0));
        if self.heights[ix] == 0 { HOLE } else { f32::from(self.heights[ix]) + fraction }
    }

    /// Columns at the corners of the patch that begins at a column's middle: beyond the world's edge it goes on level.
    #[inline(always)]
    pub fn columns(&self, [x, z]: [i32; 2]) -> [usize; 4] {
        let [nx, nz] = self.dims;
        if x >= 0 && z >= 0 && x < nx - 1 && z < nz - 1 {
            let ix = (z * nx + x) as usize;
            return [ix, ix + 1, ix + nx as usize, ix + nx as usize + 1];
        }
        self.columns_at_an_edge([x, z])
    }

    #[cold]
    fn columns_at_an_edge(&self, [x, z]: [i32; 2]) -> [usize; 4] {
        let put = |axis: usize, v: i32| match self.repeats[axis] {
            true => v.rem_euclid(self.dims[axis]),
            false => v.clamp(0, self.dims[axis] - 1),
        };
        let (x0, x1, z0, z1) = (put(0, x), put(0, x + 1), put(1, z), put(1, z + 1));
        [[x0, z0], [x1, z0], [x0, z1], [x1, z1]].map(|[x, z]| (z * self.dims[0] + x) as usize)
    }

    /// `a + b·u + c·v + d·u·v` of that patch; a corner without voxels is as high as the mean of the others.
    #[inline(always)]
    pub fn patch(&self, [i, j, k, l]: [usize; 4]) -> [f32; 4] {
        let mut h = [self.height(i), self.height(j), self.height(k), self.height(l)];
        if h[0] == HOLE || h[1] == HOLE || h[2] == HOLE || h[3] == HOLE {
            h = filled(h);
        }
        [h[0], h[1] - h[0], h[2] - h[0], h[0] - h[1] - h[2] + h[3]]
    }

    /// The patch that holds a place of level 0, given by its column and what is left over: where it begins, and how far in.
    #[inline(always)]
    fn corner([x, z]: [i32; 2], [u, v]: [f32; 2]) -> ([i32; 2], [f32; 2]) {
        let (u, v) = (u - 0.5, v - 0.5);
        let floor = [u.floor(), v.floor()];
        ([x.wrapping_add(floor[0] as i32), z.wrapping_add(floor[1] as i32)], [u - floor[0], v - floor[1]])
    }

    /// Height of the surface at a place of level 0: columns, and what is left over.
    #[inline(always)]
    pub fn at(&self, cell: [i32; 2], rest: [f32; 2]) -> f32 {
        let (corner, [u, v]) = Ground::corner(cell, rest);
        let [a, b, c, d] = self.patch(self.columns(corner));
        a + b * u + c * v + d * u * v
    }

    /// The surface's normal where a point stands, given by column and what is left over, and its height; slopes are those over
    /// about `apart` columns to either side.
    #[inline(always)]
    pub fn normal(&self, cell: [i32; 2], rest: [f32; 2], apart: f32) -> (Vec3, f32) {
        let ([x, z], [u, v]) = Ground::corner(cell, rest);
        // Whole columns: the same place in each patch.
        let away = (apart + 0.5).min(65_536.0) as i32;
        let height = |dx: i32, dz: i32| {
            let [a, b, c, d] = self.patch(self.columns([x.wrapping_add(dx), z.wrapping_add(dz)]));
            a + b * u + c * v + d * u * v
        };
        let per = 0.5 / away as f32;
        let slope = [(height(away, 0) - height(-away, 0)) * per, (height(0, away) - height(0, -away)) * per];
        let scale = 1.0 / (1.0 + slope[0] * slope[0] + slope[1] * slope[1]).sqrt();
        (Vec3::new(-slope[0] * scale, scale, -slope[1] * scale), height(0, 0))
    }

    /// Colours of four columns' tops, mixed; those without voxels have no part.
    #[inline(always)]
    pub fn color(&self, columns: [usize; 4], [u, v]: [f32; 2]) -> u32 {
        let (mut sum, mut all) = ([0.0f32; 3], 0.0f32);
        for (ix, share) in columns.into_iter().zip([(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v]) {
            let height = self.heights[ix];
            if height > 0 {
                let color = self.level.color(ix, 0, u32::from(height) - 1);
                for (sum, shift) in sum.iter_mut().zip([0, 8, 16]) {
                    *sum += share * ((color >> shift) & 255) as f32;
                }
                all += share;
            }
        }
        // A place at the rim of a hole, where the others weigh nothing.
        let scale = 1.0 / all.max(1e-6);
        let [r, g, b] = sum.map(|sum| ((sum * scale + 0.5) as u32).min(255));
        r | g << 8 | b << 16 | 0xFF00_0000
    }
}

/// Heights with the mean of the others in place of those of holes.
#[cold]
fn filled(h: [f32; 4]) -> [f32; 4] {
    let whole = h.map(|h| if h == HOLE { 0.0 } else { 1.0f32 });
    let mean = h.iter().zip(whole).map(|(h, w)| h * w).sum::<f32>() / whole.iter().sum::<f32>().max(1.0);
    h.map(|h| if h == HOLE { mean } else { h })
}

impl Tops {
    /// The same of the surface that `smooth` draws, which reaches from column to column.
    pub fn over_surface(resident: &Resident, repeats: [bool; 2]) -> Option<Tops> {
        let ground = Ground::new(resident, repeats)?;
        let [nx, nz] = ground.dims;
        let side = |n: i32| (n as u32).div_ceil(1 << SQUARE_SHIFT).max(1);
        let (mut wide, mut deep) = (side(nx), side(nz));
        let of_square = |i: usize| {
            let [x, z] = [i as u32 % wide, i as u32 / wide].map(|v| (v << SQUARE_SHIFT) as i32);
            let wide = (1 << SQUARE_SHIFT) + 1;
            let cells = (z - 1..z + wide).flat_map(|z| (x - 1..x + wide).map(move |x| [x, z]));
            cells.filter_map(|cell| ground.index(cell)).map(|ix| u32::from(ground.heights[ix])).max().unwrap_or(0)
        };
        // A fraction is at most a half.
        let raised = |top: u32| if top == 0 { 0 } else { top + 1 };
        let mut tops: Vec<u32> =
            (0..wide as usize * deep as usize).into_par_iter().map(|i| raised(of_square(i))).collect();
        let mut levels = Vec::new();
        while wide > 1 || deep > 1 {
            let (w, d) = (wide.div_ceil(2), deep.div_ceil(2));
            let mut coarse = vec![0; w as usize * d as usize];
            for (i, &top) in tops.iter().enumerate() {
                let at = &mut coarse[((i as u32 / wide / 2) * w + (i as u32 % wide) / 2) as usize];
                *at = top.max(*at);
            }
            levels.push((wide, std::mem::replace(&mut tops, coarse)));
            (wide, deep) = (w, d);
        }
        let top = tops[0];
        levels.push((wide, tops));
        Some(Tops { levels, top })
    }
}

/// The surface's normals, for `shade`.
pub struct Normals<'a> {
    ground: Ground<'a>,
    eye: [i32; 3],
    fract: [f32; 3],
}

impl<'a> Normals<'a> {
    pub fn new(ground: Ground<'a>, eye_cell: [i32; 3], eye_fract: [f64; 3]) -> Normals<'a> {
        Normals { ground, eye: eye_cell, fract: eye_fract.map(|f| f as f32) }
    }

    /// At a point given from the eye that is drawn with voxels so large, in the world; `None` where that is a wall.
    #[inline(always)]
    pub fn at(&self, from_eye: Vec3, size: f32) -> Option<Vec3> {
        let (x, z) = (from_eye.x + self.fract[0], from_eye.z + self.fract[2]);
        let floor = [x.floor(), z.floor()];
        let cell = [self.eye[0].wrapping_add(floor[0] as i32), self.eye[2].wrapping_add(floor[1] as i32)];
        self.ground.index(cell).filter(|&ix| self.ground.heights[ix] > 0)?;
        let (normal, height) = self.ground.normal(cell, [x - floor[0], z - floor[1]], size);
        let y = from_eye.y + (self.eye[1] as f32 + self.fract[1]);
        let steep = (1.0 - normal.y * normal.y).max(0.0).sqrt() / normal.y;
        (y > height - (1.5 + steep) * size).then_some(normal)
    }
}

/// What a ray meets first.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Met {
    Surface {
        depth: f32,
        column: [i32; 2],
        color: u32,
        y: i32,
    },
    Nothing,
    /// The eye is below the surface: blocks are drawn.
    Inside,
}

/// Draws the surface over what blocks show where that is near.
pub fn smooth(resident: &Resident, tops: &Tops, setup: &Setup, camera: &Camera, pixels: &mut Pixels<'_>) {
    let Some(ground) = Ground::new(resident, setup.repeats) else { return };
    if is_below(ground, setup) {
        return;
    }
    let walk = Walk::new(ground, tops, setup);
    let Pixels { color, depth, voxel, .. } = pixels;
    let w = camera.width as usize;
    let basis = camera.basis();
    let near = near(camera);
    let mut voxels = voxel.chunks_mut(w);
    let rows = color.chunks_mut(w).zip(depth.chunks_mut(w));
    let rows: Vec<_> = rows.map(|row| (row, voxels.next().unwrap_or_default())).collect();
    let avx2 = has_avx2();
    rows.into_par_iter().enumerate().for_each(|(r, ((color, depth), voxel))| {
        let y = r as f64 + 0.5;
        let start = camera.ray(&basis, 0.5, y);
        let step = (camera.ray(&basis, w as f64 + 0.5, y) - start) / w as f64;
        let row = Row { walk: &walk, start, step, near, color, depth, voxel };
        #[cfg(target_arch = "x86_64")]
        if avx2 {
            // SAFETY: `has_avx2` has seen that the processor can.
            return unsafe { smooth_row_avx2(row) };
        }
        let _ = avx2;
        smooth_row(row);
    });
}

/// A row of a picture.
struct Row<'a> {
    walk: &'a Walk<'a>,
    /// The first pixel's ray, and from one to the next.
    start: DVec3,
    step: DVec3,
    near: f32,
    color: &'a mut [u32],
    depth: &'a mut [f32],
    /// Or none.
    voxel: &'a mut [[i32; 4]],
}

/// The same code for processors with AVX2; the same bits.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
fn smooth_row_avx2(row: Row<'_>) {
    smooth_row(row);
}

#[inline(always)]
fn smooth_row(row: Row<'_>) {
    let Row { walk, start, step, near, color, depth, voxel } = row;
    for x in 0..color.len() {
        let ray = start + step * x as f64;
        let ray = [ray.x as f32, ray.y as f32, ray.z as f32];
        // What lies behind a block that the surface does not reach, the ray may find far away.
        let end = if depth[x] < near { f32::INFINITY } else { near };
        let none = match walk.meet(ray, end) {
            Met::Surface { depth: met, column, color: shown, y } => {
                (color[x], depth[x]) = (shown, met);
                if let Some(voxel) = voxel.get_mut(x) {
                    *voxel = [column[0], y, column[1], 0];
                }
                false
            }
            Met::Nothing => depth[x] < near,
            Met::Inside => false,
        };
        if none {
            (color[x], depth[x]) = (0, f32::INFINITY);
            if let Some(voxel) = voxel.get_mut(x) {
                *voxel = [-1; 4];
            }
        }
    }
}

/// Which squares a walk begins with: those of `2^SQUARE_SHIFT · 2^FIRST` columns a side.
pub const FIRST: u32 = 3;

/// Whether the eye is below the surface: blocks are drawn then.
pub fn is_below(ground: Ground<'_>, setup: &Setup) -> bool {
    let [x, y, z] = setup.eye_fract.map(|f| f as f32);
    let eye = [setup.eye_cell[0], setup.eye_cell[2]];
    let over = ground.index(eye).is_some_and(|ix| ground.height(ix) != HOLE);
    over && setup.eye_cell[1] as f32 + y <= ground.at(eye, [x, z])
}

/// Up to what depth the surface is drawn.
pub fn near(camera: &Camera) -> f32 {
    (camera.focal() / f64::from(PIXELS)) as f32
}

struct Walk<'a> {
    ground: Ground<'a>,
    tops: &'a Tops,
    eye: [i32; 2],
    fract: [f32; 2],
    /// Of the eye.
    height: f32,
    view: f32,
}

impl<'a> Walk<'a> {
    fn new(ground: Ground<'a>, tops: &'a Tops, setup: &Setup) -> Walk<'a> {
        let [x, y, z] = setup.eye_fract.map(|f| f as f32);
        Walk {
            ground,
            tops,
            eye: [setup.eye_cell[0], setup.eye_cell[2]],
            fract: [x, z],
            height: setup.eye_cell[1] as f32 + y,
            view: setup.view_distance.min(1e9) as f32,
        }
    }

    #[inline(always)]
    fn meet(&self, ray: [f32; 3], end: f32) -> Met {
        let [dx, dy, dz] = ray;
        let ([fx, fz], [nx, nz]) = (self.fract, self.ground.dims);
        let [ix, iz] = [inverse(dx), inverse(dz)];
        let (forth_x, forth_z) = (i32::from(dx >= 0.0), i32::from(dz >= 0.0));
        let mut end = end.min(self.view / (dx * dx + dz * dz).sqrt().max(1e-20));
        let mut t = 0.0f32;
        // From above the world's top to it; no farther than to its top, or its ground.
        let top = (self.tops.top as f32 - self.height) * ray_inverse(dy);
        let bottom = -self.height * ray_inverse(dy);
        if dy < 0.0 {
            t = t.max(top);
            end = end.min(bottom);
        } else if dy > 0.0 {
            end = end.min(top);
            t = t.max(bottom);
        } else if self.height >= self.tops.top as f32 {
            return Met::Nothing;
        }
        for (axis, inverse, forth) in [(0, ix, forth_x), (1, iz, forth_z)] {
            let n = self.ground.dims[axis];
            if !self.ground.repeats[axis] && !(0..n).contains(&self.eye[axis]) {
                let near = if forth == 1 { 0 } else { n };
                let enter = (near.wrapping_sub(self.eye[axis]) as f32 - self.fract[axis]) * inverse;
                if enter < 0.0 {
                    return Met::Nothing;
                }
                t = t.max(enter + PAST[0] + enter * PAST[1]);
            }
        }
        let most = self.tops.levels.len() as u32 - 1;
        let mut k = FIRST.min(most);
        for _ in 0..STEPS {
            if t >= end {
                return Met::Nothing;
            }
            // In quarters of columns.
            let (at_x, at_z) = (fx + dx * t, fz + dz * t);
            let (half_x, half_z) = ((at_x + at_x).floor() as i32, (at_z + at_z).floor() as i32);
            let (off_x, off_z) = (half_x >> 1, half_z >> 1);
            let column = [self.eye[0].wrapping_add(off_x), self.eye[1].wrapping_add(off_z)];
            let Some([x, z]) = self.ground.place(column) else { return Met::Nothing };
            // From a column's number in the world to its number from the eye.
            let (base_x, base_z) = (off_x.wrapping_sub(x), off_z.wrapping_sub(z));
            let shift = SQUARE_SHIFT + k;
            let (row, tops) = &self.tops.levels[k as usize];
            let top = tops[((z >> shift) as u32 * row + (x >> shift) as u32) as usize] as f32;
            let line_x = (((x >> shift) + forth_x) << shift).min(nx);
            let line_z = (((z >> shift) + forth_z) << shift).min(nz);
            let leave = forward(
                t,
                ((base_x.wrapping_add(line_x) as f32 - fx) * ix).min((base_z.wrapping_add(line_z) as f32 - fz) * iz),
            );
            if self.height + (dy * t).min(dy * leave) >= top {
                (t, k) = (leave, (k + 1).min(most));
                continue;
            }
            if k > 0 {
                k -= 1;
                continue;
            }
            let next = forward(
                t,
                ((0.5 * (half_x + forth_x) as f32 - fx) * ix).min((0.5 * (half_z + forth_z) as f32 - fz) * iz),
            );
            let under = self.ground.heights[(z * nx + x) as usize];
            if under == 0 {
                t = next;
                continue;
            }
            // The patch that holds this quarter begins at the middle of the column before its own, or of its own.
            let (before_x, before_z) = ((half_x - 1) >> 1, (half_z - 1) >> 1);
            let columns = self.ground.columns([self.eye[0].wrapping_add(before_x), self.eye[1].wrapping_add(before_z)]);
            let [a, b, c, d] = self.ground.patch(columns);
            let (u, v) = (at_x - (before_x as f32 + 0.5), at_z - (before_z as f32 + 0.5));
            let above = self.height + dy * t - (a + b * u + c * v + d * u * v);
            // Above all of the patch.
            let top = a + b.max(0.0) + c.max(0.0) + d.max(0.0);
            if self.height + (dy * t).min(dy * next) > top {
                t = next;
                continue;
            }
            let root = match above > 0.0 {
                true => first_root(above, dy - (b * dx + c * dz + d * (u * dz + v * dx)), -d * dx * dz, next - t),
                false if t == 0.0 => return Met::Inside,
                // A wall.
                false => Some(0.0),
            };
            if let Some(s) = root {
                let depth = t + s;
                let place = [(u + dx * s).clamp(0.0, 1.0), (v + dz * s).clamp(0.0, 1.0)];
                let y = ((self.height + dy * depth) as i32).clamp(0, i32::from(under) - 1);
                return Met::Surface { depth, column, color: self.ground.color(columns, place), y };
            }
            t = next;
        }
        Met::Nothing
    }
}

/// Of a direction that is taken for a little more than none.
#[inline(always)]
fn inverse(d: f32) -> f32 {
    1.0 / if d.abs() < 1e-12 { if d < 0.0 { -1e-12 } else { 1e-12 } } else { d }
}

/// Past a border, and never back.
#[inline(always)]
fn forward(t: f32, border: f32) -> f32 {
    let next = if border > t { border } else { t };
    next + (1e-5 + next * PAST[1])
}

/// The least s of 0 to `most` at which `c + b·s + a·s²`, above 0 at 0, is 0.
#[inline(always)]
fn first_root(c: f32, b: f32, a: f32, most: f32) -> Option<f32> {
    let square = b * b - 4.0 * a * c;
    if square < 0.0 {
        return None;
    }
    let q = -0.5 * (b + if b < 0.0 { -square.sqrt() } else { square.sqrt() });
    let one = if a == 0.0 { f32::INFINITY } else { q / a };
    let other = if q == 0.0 { f32::INFINITY } else { c / q };
    let least = (if one >= 0.0 { one } else { f32::INFINITY }).min(if other >= 0.0 { other } else { f32::INFINITY });
    (least <= most).then_some(least)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{CpuRenderer, Options, Outputs, Shading};
    use glam::DVec3;
    use planecast_encoder::{BuildOptions, Colors, ColumnsBuilder, Input, Run, Scene, build};
    use std::sync::Arc;

    /// A height field with fractions; columns of a height below 0 are empty.
    fn field([nx, nz]: [u32; 2], height: impl Fn(f64, f64) -> f64) -> (Arc<Scene>, Arc<Resident>) {
        let (mut columns, mut fractions) = (ColumnsBuilder::new(nx, 300, nz), Vec::new());
        for i in 0..nx * nz {
            let h = height(f64::from(i % nx) + 0.5, f64::from(i / nx) + 0.5);
            if h >= 0.5 {
                columns.push_run(Run::new(0, h.round() as u16 - 1));
            }
            columns.end_column();
            fractions.push(((h - h.round()) * 256.0 + 128.0).clamp(0.0, 255.0) as u8);
        }
        let colors = Colors::Function(Box::new(|x, y, z| [(x * 9) as u8, (y * 5) as u8, (z * 7) as u8]));
        let input = Input { columns: columns.finish(), colors, notes: Vec::new() };
        let scene = build(input, &BuildOptions::default()).unwrap();
        let resident = Resident::new(&scene).with_fractions(&fractions);
        (Arc::new(scene), Arc::new(resident))
    }

    fn hills(x: f64, z: f64) -> f64 {
        40.0 + 12.0 * (x / 9.0).sin() * (z / 7.0).cos() + 3.0 * (x * 0.9 + z * 0.4).sin()
    }

    fn camera(eye: [f64; 3], yaw: f64, pitch: f64) -> Camera {
        Camera { eye: DVec3::from(eye), yaw, pitch, roll: 4.0, fov: 60.0, width: 160, height: 120 }
    }

    /// On a slope of a quarter, depth is that of the plane, and normals are its own; blocks are not.
    #[test]
    fn slopes_are_planes() {
        let (scene, resident) = field([128, 128], |x, _| 10.0 + 0.25 * x);
        let mut renderer = CpuRenderer::new(&scene, &resident);
        let at = camera([50.0, 40.0, 64.0], 100.0, -30.0);
        let options = Options { shading: Shading::None, smooth: true, ..Options::default() };
        let frame = renderer.render(&at, &options, Outputs { voxel: true }).unwrap();
        let blocks = renderer.render(&at, &Options { smooth: false, ..options }, Outputs { voxel: true }).unwrap();
        let basis = at.basis();
        let (mut n, mut worst, mut worst_blocks) = (0, 0.0f64, 0.0f64);
        for i in 0..frame.depth.len() {
            let ray = at.ray(&basis, (i % 160) as f64 + 0.5, (i / 160) as f64 + 0.5);
            // y = 10 + x / 4, fractions to 1 / 256.
            let depth = (10.0 + 0.25 * at.eye.x - at.eye.y) / (ray.y - 0.25 * ray.x);
            let [x, y, z, _] = frame.voxel[i];
            if depth > 0.0 && (1..127).contains(&x) && (1..127).contains(&z) {
                n += 1;
                let off = |shown: f32| (f64::from(shown) - depth).abs() * (ray.y - 0.25 * ray.x).abs();
                (worst, worst_blocks) = (worst.max(off(frame.depth[i])), worst_blocks.max(off(blocks.depth[i])));
                assert!((f64::from(y) - (10.0 + 0.25 * f64::from(x))).abs() < 2.0);
            }
        }
        assert!(n > 10_000 && worst < 0.006 && worst_blocks > 0.4, "{n} pixels, {worst}, blocks {worst_blocks}");
        let ground = Ground::new(&resident, [false; 2]).unwrap();
        let normal = ground.normal([60, 60], [0.3, 0.9], 1.0).0;
        assert!((normal - Vec3::new(-0.25, 1.0, 0.0).normalize()).length() < 0.005, "{normal}");
    }

    /// Against one f64 ray through the same surface, holes, walls and world's end included.
    #[test]
    fn surfaces_are_those_of_exact() {
        let holes = |x: f64, z: f64| if (x * 0.21).sin() * (z * 0.17).sin() > 0.8 { -1.0 } else { hills(x, z) };
        let mut all = [0usize; 3];
        for (scene, resident) in [field([96, 80], hills), field([96, 80], holes)] {
            let mut renderer = CpuRenderer::new(&scene, &resident);
            for (eye, yaw, pitch) in [
                ([48.0, 70.0, 40.0], 30.0, -40.0),
                ([20.0, 62.0, 60.0], 140.0, -12.0),
                ([-30.0, 60.0, 40.0], 90.0, -15.0),
                ([48.0, 90.0, 40.0], 0.0, -90.0),
                ([48.0, 58.5, 41.0], 260.0, 5.0),
            ] {
                for repeat in [false, true] {
                    let repeat = crate::Repeat { x: repeat, z: repeat };
                    let options = Options {
                        shading: Shading::None,
                        smooth: true,
                        repeat,
                        view_distance: 150.0,
                        ..Options::default()
                    };
                    let camera = camera(eye, yaw, pitch);
                    let drawn = renderer.render(&camera, &options, Outputs { voxel: true }).unwrap();
                    let exact = renderer.exact(&camera, &options, Outputs { voxel: true }).unwrap();
                    // Farther away blocks are drawn.
                    let near = |i: &usize| exact.depth[*i] < near(&camera) - 2.0;
                    for i in (0..drawn.depth.len()).filter(near) {
                        let [a, b] = [drawn.depth[i], exact.depth[i]];
                        let same = if a.is_infinite() || b.is_infinite() { a == b } else { (a - b).abs() < 2e-3 };
                        // Pixels on edges, where rounding decides.
                        all = [
                            all[0] + 1,
                            all[1] + usize::from(!same),
                            all[2] + usize::from(drawn.color[i] != exact.color[i]),
                        ];
                    }
                }
            }
        }
        println!("{all:?}");
        assert!(all[1] <= all[0] / 1000 && all[2] <= all[0] / 200, "{all:?}");
    }

    #[test]
    fn eyes_below_the_surface_see_blocks() {
        let (scene, resident) = field([64, 64], |x, _| 5.0 + 3.0 * x);
        let mut renderer = CpuRenderer::new(&scene, &resident);
        // Over its column's top, below the surface that rises to the next.
        let at = camera([20.9, 67.2, 30.0], 90.0, 0.0);
        let options = Options { shading: Shading::None, ..Options::default() };
        let blocks = renderer.render(&at, &options, Outputs::default()).unwrap();
        let smooth = renderer.render(&at, &Options { smooth: true, ..options }, Outputs::default()).unwrap();
        assert!(blocks.color == smooth.color && blocks.depth == smooth.depth);
        let above = camera([20.9, 69.5, 30.0], 90.0, 0.0);
        let [blocks, smooth] = [false, true]
            .map(|smooth| renderer.render(&above, &Options { smooth, ..options }, Outputs::default()).unwrap());
        assert!(blocks.depth != smooth.depth);
    }
}
