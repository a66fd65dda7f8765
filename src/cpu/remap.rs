//! Stage `remap`: each pixel takes the sample of the nearest plane that lies nearest to its ray.
//!
//! The vanishing point and a pixel's place give its fan (the axis of the greater distance), its place on the fan's far
//! edge and so its plane; the sample is the pixel's own row (up, down) or column (left, right). A linear-fractional map,
//! finite for each pixel but one at the vanishing point itself, which any plane of any fan shows.
//! (Forstmann & Ohya 2009 §3.6, with the arrow turned round: they scatter textured lines, here pixels gather.)

use crate::camera::Camera;
use crate::cpu::traverse::{PlaneBuffer, Real, SKY, has_avx2};
use crate::plane_setup::{DOWN, Fan, LEFT, RIGHT, Setup, UP, crowd, vertical};
use rayon::prelude::*;

/// No plane passes within half a pixel.
pub const HOLE: u32 = u32::MAX;

/// Rows that one task remaps: as many samples of a plane as a cache line holds.
const ROWS_A_TASK: usize = 16;

/// Columns of those rows that are remapped together: their planes' samples fit a first-level cache.
const COLUMNS_A_BLOCK: u32 = 128;

/// A pixel row cut at the fans' borders.
pub struct Row<'a> {
    setup: &'a Setup,
    /// Row of pixels, and the height of their centres.
    row: u32,
    y: f64,
    width: u32,
}

/// One stretch of a row: columns `from .. to` lie in `fan`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stretch {
    pub fan: usize,
    pub from: u32,
    pub to: u32,
}

impl<'a> Row<'a> {
    pub fn new(setup: &'a Setup, row: u32, width: u32) -> Row<'a> {
        Row { setup, row, y: f64::from(row) + 0.5, width }
    }

    /// The row's stretches from left to right; together they are the whole row.
    pub fn stretches(&self) -> [Stretch; 3] {
        let [vx, vy, vw] = self.setup.vanishing;
        let fans = &self.setup.fans;
        let w = f64::from(self.width);
        let dy = vy - self.y * vw;
        let has = |f: usize| fans[f].n_planes > 0;
        let mut middle = if dy > 0.0 || (dy == 0.0 && has(UP)) { UP } else { DOWN };
        // |vx − x·vw| ≤ |dy| holds for pixel centres in a stretch around the vanishing point.
        let (mut from, mut to) = if vw > 0.0 {
            (((vx - dy.abs()) / vw - 0.5).ceil().clamp(0.0, w), ((vx + dy.abs()) / vw + 0.5).floor().clamp(0.0, w))
        } else if vx.abs() <= dy.abs() {
            (0.0, w)
        } else if vx > 0.0 {
            (w, w)
        } else {
            (0.0, 0.0)
        };
        to = to.max(from);
        // A fan without planes has no pixel but by rounding; its neighbour shows those.
        if !has(LEFT) {
            from = 0.0;
        }
        if !has(RIGHT) {
            to = w;
        }
        if !has(middle) {
            middle = if middle == UP && has(DOWN) { DOWN } else { middle };
            if !has(middle) {
                if has(LEFT) { from = to } else { to = from }
            }
        }
        let (from, to) = (from as u32, to as u32);
        [
            Stretch { fan: LEFT, from: 0, to: from },
            Stretch { fan: middle, from, to },
            Stretch { fan: RIGHT, from: to, to: self.width },
        ]
    }

    /// Calls `pixel(column, place)` for each column of a stretch.
    #[inline(always)]
    pub fn gather(&self, stretch: Stretch, mut pixel: impl FnMut(usize, Place)) {
        let fan = self.setup.fans[stretch.fan];
        if fan.n_planes == 0 {
            return;
        }
        let last = f64::from(fan.n_planes - 1);
        match fan.readjusted {
            None => {
                let per_pixel = 1.0 / fan.spacing;
                self.places(stretch, &fan, |x, sample, at| {
                    let plane = ((at - fan.start) * per_pixel).truncate(last) as u32;
                    pixel(x, Place { plane, sample, at });
                });
            }
            Some(r) => {
                let (per_distance, per_step) = (1.0 / r.distance, 1.0 / r.step);
                self.places(stretch, &fan, |x, sample, at| {
                    let plane = ((crowd((at - r.centre) * per_distance) - r.start) * per_step).truncate(last) as u32;
                    pixel(x, Place { plane, sample, at });
                });
            }
        }
    }

    /// Calls `place(column, sample, place on the far edge)` for each column of a stretch.
    #[inline(always)]
    fn places(&self, stretch: Stretch, fan: &Fan, mut place: impl FnMut(usize, u32, f64)) {
        let [vx, vy, vw] = self.setup.vanishing;
        let dy = vy - self.y * vw;
        let (n, far) = (fan.n_samples, fan.far);
        if vertical(stretch.fan) {
            let sample = if fan.flip { n - 1 - self.row } else { self.row };
            let across = if dy == 0.0 { 0.0 } else { (far - self.y) / dy };
            // A pixel at x lies on the sight line through x + across·(vx − x·vw) of the far edge.
            let (scale, start) = (1.0 - across * vw, across * vx);
            for x in stretch.from..stretch.to {
                place(x as usize, sample, (f64::from(x as i32) + 0.5) * scale + start);
            }
        } else {
            let (y, flip) = (self.y, fan.flip);
            for x in stretch.from..stretch.to {
                let center = f64::from(x as i32) + 0.5;
                let dx = vx - center * vw;
                let dx = if dx == 0.0 { f64::INFINITY } else { dx };
                let at = y + (far - center) * dy / dx;
                place(x as usize, if flip { n - 1 - x } else { x }, at);
            }
        }
    }

    /// Whether a plane passes within half a pixel of pixel `x`, whose place is given.
    fn covered(&self, stretch: Stretch, x: usize, place: Place) -> bool {
        let [vx, vy, vw] = self.setup.vanishing;
        let fan = &self.setup.fans[stretch.fan];
        // At the pixel stripes are narrower than on the far edge.
        let (here, far) = if vertical(stretch.fan) {
            (vy - self.y * vw, vy - fan.far * vw)
        } else {
            (vx - (x as f64 + 0.5) * vw, vx - fan.far * vw)
        };
        let narrow = if here == 0.0 { 0.0 } else { here / far };
        let (center, _) = fan.place(place.plane);
        // A rounding's width over, so that planes one pixel apart leave no hole.
        ((place.at - center) * narrow).abs() <= 0.5 + 1e-6
    }
}

/// A pixel's place in the plane buffer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Plane of its fan, and sample of that plane.
    pub plane: u32,
    pub sample: u32,
    /// Where the pixel projects to on the fan's far edge.
    pub at: f64,
}

impl Fan {
    #[inline(always)]
    fn index(&self, plane: u32, sample: u32) -> usize {
        self.first_sample + plane as usize * self.n_samples as usize + sample as usize
    }

    /// The plane on a place's other side; at a fan's end, the place's own.
    #[inline(always)]
    fn beside(&self, place: Place) -> u32 {
        if place.at < self.place(place.plane).0 {
            place.plane.saturating_sub(1)
        } else {
            (place.plane + 1).min(self.n_planes - 1)
        }
    }
}

/// Colour and depth of each pixel, `width` a row: those of the nearest plane's sample.
pub fn remap(setup: &Setup, buffer: &PlaneBuffer, width: u32, color: &mut [u32], depth: &mut [f32]) {
    let w = width as usize;
    let avx2 = has_avx2();
    let tasks = color.par_chunks_mut(ROWS_A_TASK * w).zip(depth.par_chunks_mut(ROWS_A_TASK * w)).enumerate();
    tasks.for_each(|(task, (color, depth))| {
        let task = RowsTask { setup, buffer, first_row: (task * ROWS_A_TASK) as u32, width, color, depth };
        #[cfg(target_arch = "x86_64")]
        if avx2 {
            // SAFETY: `has_avx2` has seen that the processor can.
            return unsafe { remap_rows_avx2(task) };
        }
        let _ = avx2;
        remap_rows(task);
    });
}

/// Some rows of a picture.
struct RowsTask<'a> {
    setup: &'a Setup,
    buffer: &'a PlaneBuffer,
    first_row: u32,
    width: u32,
    color: &'a mut [u32],
    depth: &'a mut [f32],
}

/// The same code for processors with AVX2; the same bits.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
fn remap_rows_avx2(task: RowsTask<'_>) {
    remap_rows(task);
}

#[inline(always)]
fn remap_rows(task: RowsTask<'_>) {
    let RowsTask { setup, buffer, first_row, width, color, depth } = task;
    let w = width as usize;
    let rows: Vec<_> = (first_row..first_row + (color.len() / w) as u32).map(|r| Row::new(setup, r, width)).collect();
    let stretches: Vec<_> = rows.iter().map(Row::stretches).collect();
    let mut index = [0u32; COLUMNS_A_BLOCK as usize];
    for from in (0..width).step_by(COLUMNS_A_BLOCK as usize) {
        let to = (from + COLUMNS_A_BLOCK).min(width);
        for (r, row) in rows.iter().enumerate() {
            for s in stretches[r] {
                let part = Stretch { from: s.from.max(from), to: s.to.min(to), ..s };
                if part.from >= part.to {
                    continue;
                }
                let fan = &setup.fans[s.fan];
                let n = fan.n_samples;
                let own = fan.first_sample..fan.first_sample + fan.n_planes as usize * n as usize;
                let (colors, depths) = (&buffer.color[own.clone()], &buffer.depth[own]);
                // First where to look, in vectors; then the looking.
                row.gather(part, |x, place| {
                    index[(x as u32 - from) as usize % COLUMNS_A_BLOCK as usize] = place.plane * n + place.sample;
                });
                let index = &index[(part.from - from) as usize..(part.to - from) as usize];
                let out = r * w + part.from as usize..r * w + part.to as usize;
                for ((c, z), &i) in color[out.clone()].iter_mut().zip(&mut depth[out]).zip(index) {
                    (*c, *z) = (colors[i as usize], depths[i as usize]);
                }
            }
        }
    }
}

/// The voxels' boxes as a pixel's ray meets them.
struct Boxes {
    /// The eye in level-0 voxels: whole, and rest.
    eye: [i32; 3],
    fract: [f32; 3],
}

impl Boxes {
    /// Depth at which a ray (inverse components given) enters a voxel, at least 0; `None` where it misses it.
    #[inline(always)]
    fn enter(&self, voxel: [i32; 4], inverse: [f32; 3]) -> Option<f32> {
        let l = voxel[3];
        let (mut near, mut far) = (0.0f32, f32::INFINITY);
        for axis in 0..3 {
            // Each face from whole numbers: a sum with the other one would lose a face at hand.
            let face = |cell: i32| (cell << l).wrapping_sub(self.eye[axis]) as f32 - self.fract[axis];
            let (from, to) = (face(voxel[axis]), face(voxel[axis] + 1));
            let (a, b) = (from * inverse[axis], to * inverse[axis]);
            near = near.max(a.min(b));
            far = far.min(a.max(b));
        }
        // Rounding must not let a ray slip between two voxels.
        (near <= far * (1.0 + 1e-6)).then_some(near)
    }
}

/// Like [`remap`], but each pixel tests the voxels of the samples around its place against its own ray: it takes the
/// nearest plane's if the ray meets it, else the nearest that it does meet among the two nearest planes' samples beside
/// it. Depth is where the pixel's own ray enters the voxel. (Not in the papers.) Needs [`PlaneBuffer::voxel`]; the voxel of
/// each pixel goes to `voxel` unless that is empty, in the same form.
pub fn remap_retest(
    setup: &Setup,
    buffer: &PlaneBuffer,
    camera: &Camera,
    color: &mut [u32],
    depth: &mut [f32],
    voxel: &mut [[i32; 4]],
) {
    let (width, w) = (camera.width, camera.width as usize);
    let basis = camera.basis();
    let boxes = Boxes { eye: setup.eye_cell, fract: setup.eye_fract.map(|f| f as f32) };
    let tasks: Vec<_> = if voxel.is_empty() {
        color.chunks_mut(w).zip(depth.chunks_mut(w)).map(|(c, d)| (c, d, &mut [][..])).collect()
    } else {
        let rows = color.chunks_mut(w).zip(depth.chunks_mut(w)).zip(voxel.chunks_mut(w));
        rows.map(|((c, d), v)| (c, d, v)).collect()
    };
    tasks.into_par_iter().enumerate().with_min_len(ROWS_A_TASK).for_each(|(r, (color, depth, voxel))| {
        let row = Row::new(setup, r as u32, width);
        let start = camera.ray(&basis, 0.5, r as f64 + 0.5);
        let step = (camera.ray(&basis, f64::from(width) + 0.5, r as f64 + 0.5) - start) / f64::from(width);
        for stretch in row.stretches() {
            let fan = &setup.fans[stretch.fan];
            row.gather(stretch, |x, place| {
                let ray = start + step * x as f64;
                // A ray along an axis' grid planes is in or out of a voxel's slab whatever its parameter.
                let inverse = ray.to_array().map(|d| if d.abs() < 1e-30 { 1e30 } else { (1.0 / d) as f32 });
                let own = fan.index(place.plane, place.sample);
                let second = fan.beside(place);
                let beside = fan.index(second, place.sample);
                let plane = &setup.planes[(fan.first_plane + second) as usize];
                // Beyond a plane's own samples its part of the buffer is not drawn.
                let drawn = (plane.first..plane.end).contains(&place.sample);
                let enter = |i: usize| match buffer.voxel[i] {
                    SKY => None,
                    voxel => boxes.enter(voxel, inverse),
                };
                // The ray may meet the own plane's voxel inside the surface, behind a voxel that only the plane on its
                // other side shows: the nearer of the two is what it sees.
                let (chosen, z) = match (enter(own), drawn.then(|| enter(beside)).flatten()) {
                    (Some(a), Some(b)) if b < a => (beside, b),
                    (Some(a), _) => (own, a),
                    (None, Some(b)) => (beside, b),
                    _ => {
                        let (found, near) = retest(setup, fan, buffer, &boxes, place, inverse, own);
                        (found, near.unwrap_or(buffer.depth[found]))
                    }
                };
                color[x] = buffer.color[chosen];
                depth[x] = z;
                if let Some(v) = voxel.get_mut(x) {
                    *v = buffer.voxel[chosen];
                }
            });
        }
    });
}

/// The best sample around a place whose own sample the ray does not meet, and the depth at which the ray meets it: the
/// nearest one met; else one that shows the sky; else the own one.
#[cold]
fn retest(
    setup: &Setup,
    fan: &Fan,
    buffer: &PlaneBuffer,
    boxes: &Boxes,
    place: Place,
    inverse: [f32; 3],
    own: usize,
) -> (usize, Option<f32>) {
    let second = fan.beside(place);
    let mut best: Option<(usize, f32)> = None;
    let mut sky = (buffer.voxel[own] == SKY).then_some(own);
    for k in [place.plane, second] {
        let plane = &setup.planes[(fan.first_plane + k) as usize];
        for sample in place.sample.saturating_sub(1)..=place.sample + 1 {
            if !(plane.first..plane.end).contains(&sample) {
                continue;
            }
            let i = fan.index(k, sample);
            let voxel = buffer.voxel[i];
            if voxel == SKY {
                sky = sky.or(Some(i));
            } else if let Some(near) = boxes.enter(voxel, inverse)
                && best.is_none_or(|(_, z)| near < z)
            {
                best = Some((i, near));
            }
        }
    }
    match (best, sky) {
        (Some((i, near)), _) => (i, Some(near)),
        (None, Some(i)) => (i, None),
        (None, None) => (own, None),
    }
}

/// Which sample of the plane buffer each pixel takes; with fewer planes than reach every pixel, [`HOLE`] where none passes
/// within half a pixel.
pub fn remap_index(setup: &Setup, width: u32, index: &mut [u32]) {
    let sparse = setup.is_sparse();
    index.par_chunks_mut(width as usize).enumerate().for_each(|(r, out)| {
        let row = Row::new(setup, r as u32, width);
        for stretch in row.stretches() {
            let fan = &setup.fans[stretch.fan];
            row.gather(stretch, |x, place| {
                let covered = !sparse || row.covered(stretch, x, place);
                out[x] = if covered { fan.index(place.plane, place.sample) as u32 } else { HOLE };
            });
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{CpuRenderer, Options, Outputs, Resident};
    use glam::DVec3;
    use planecast_encoder::{BuildOptions, Colors, Columns, Input, build};

    #[test]
    fn retest_sees_no_voxel_behind_the_surface() {
        let columns = Columns::from_fn(64, 64, 16, |_, _, z| z < 8);
        let input = Input { columns, colors: Colors::None, notes: Vec::new() };
        let scene = build(input, &BuildOptions::default()).unwrap();
        let resident = Resident::new(&scene);
        let mut renderer = CpuRenderer::new(&scene, &resident);
        for (pitch, roll) in [(-20.0, 0.0), (30.0, 25.0), (0.0, 90.0)] {
            let eye = DVec3::new(31.3, 33.7, 24.2);
            let camera = Camera { eye, yaw: 11.0, pitch, roll, fov: 60.0, width: 200, height: 150 };
            let options = Options { lod: None, ..Options::default() };
            let frame = renderer.render(&camera, &options, Outputs::default()).unwrap();
            let basis = camera.basis();
            let behind = (0..frame.depth.len()).filter(|&i| {
                let (x, y) = ((i % 200) as f64 + 0.5, (i / 200) as f64 + 0.5);
                let wall = (8.0 - eye.z) / camera.ray(&basis, x, y).z;
                let z = f64::from(frame.depth[i]);
                z.is_finite() && z > wall + 1e-3
            });
            let behind = behind.count() as f64 / frame.depth.len() as f64;
            assert!(behind < 0.01, "pitch {pitch}, roll {roll}: {behind} of the pixels");
        }
    }
}
