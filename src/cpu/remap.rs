//! Stage `remap`: each pixel takes the sample of the nearest plane that lies nearest to its ray.
//!
//! The vanishing point and a pixel's place give its fan (the axis of the greater distance), its place on the fan's far
//! edge and so its plane; the sample is the pixel's own row (up, down) or column (left, right). A linear-fractional map,
//! finite for each pixel but one at the vanishing point itself, which any plane of any fan shows.
//! (Forstmann & Ohya 2009 §3.6, with the arrow turned round: they scatter textured lines, here pixels gather.)

use crate::cpu::chunks_mut;
use crate::cpu::refine::Doubt;
use crate::cpu::traverse::{PlaneBuffer, Real, SKY, has_avx2};
use crate::frame::camera::Camera;
use crate::frame::plane_setup::{DOWN, Fan, LEFT, RIGHT, Setup, UP, crowd, vertical};
use crate::world::tables::Resident;
use rayon::prelude::*;
use std::cell::Cell;

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
                    pixel(x, Place::new((at - fan.start) * per_pixel, last, sample, at));
                });
            }
            Some(r) => {
                let (per_distance, per_step) = (1.0 / r.distance, 1.0 / r.step);
                self.places(stretch, &fan, |x, sample, at| {
                    let k = (crowd((at - r.centre) * per_distance) - r.start) * per_step;
                    pixel(x, Place::new(k, last, sample, at));
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
            let sample = fan.sample_at(self.row);
            let sample = if fan.flip { n - 1 - sample } else { sample };
            let across = if dy == 0.0 { 0.0 } else { (far - self.y) / dy };
            // A pixel at x lies on the sight line through x + across·(vx − x·vw) of the far edge.
            let (scale, start) = (1.0 - across * vw, across * vx);
            for x in stretch.from..stretch.to {
                place(x as usize, sample, (f64::from(x as i32) + 0.5) * scale + start);
            }
        } else {
            let y = self.y;
            let at = |x: u32| {
                let center = f64::from(x as i32) + 0.5;
                let dx = vx - center * vw;
                let dx = if dx == 0.0 { f64::INFINITY } else { dx };
                y + (far - center) * dy / dx
            };
            let flip = |sample: u32| if fan.flip { n - 1 - sample } else { sample };
            if n == fan.pixels {
                // A sample a pixel: a loop that compilers make vectors of.
                let (first, step) = if fan.flip { (n - 1, u32::MAX) } else { (0, 1) };
                for x in stretch.from..stretch.to {
                    place(x as usize, first.wrapping_add(x.wrapping_mul(step)), at(x));
                }
            } else {
                for x in stretch.from..stretch.to {
                    place(x as usize, flip(fan.sample_at(x)), at(x));
                }
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
    /// Nearest plane of its fan, and sample of that plane.
    pub plane: u32,
    pub sample: u32,
    /// The plane on the pixel's other side; at a fan's end, `plane`.
    pub second: u32,
    /// Where the pixel projects to on the fan's far edge.
    pub at: f64,
}

impl Place {
    /// A place `k` stripes from a fan's start, whose last plane has number `last`.
    #[inline(always)]
    fn new(k: f64, last: f64, sample: u32, at: f64) -> Place {
        let plane = k.truncate(last);
        // A stripe's plane runs along its middle.
        let side = if k - f64::from(plane) < 0.5 { -1 } else { 1 };
        let second = (plane + side).max(0).min(last as i32);
        Place { plane: plane as u32, sample, second: second as u32, at }
    }
}

impl Fan {
    #[inline(always)]
    fn index(&self, plane: u32, sample: u32) -> usize {
        self.first_sample + plane as usize * self.n_samples as usize + sample as usize
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
    let (rows, stretches) = task_rows(setup, first_row, width);
    let mut index = [0u32; COLUMNS_A_BLOCK as usize];
    for (r, part) in parts(&stretches[..color.len() / w], width) {
        let fan = &setup.fans[part.fan];
        let n = fan.n_samples;
        let own = fan.first_sample..fan.first_sample + fan.n_planes as usize * n as usize;
        let (colors, depths) = (&buffer.color[own.clone()], &buffer.depth[own]);
        // First where to look, in vectors; then the looking.
        rows[r].gather(part, |x, place| {
            index[(x as u32 - part.from) as usize % COLUMNS_A_BLOCK as usize] = place.plane * n + place.sample;
        });
        let index = &index[..(part.to - part.from) as usize];
        let out = r * w + part.from as usize..r * w + part.to as usize;
        for ((c, z), &i) in color[out.clone()].iter_mut().zip(&mut depth[out]).zip(index) {
            (*c, *z) = (colors[i as usize], depths[i as usize]);
        }
    }
}

/// The rows of a task, and how they are cut.
fn task_rows(setup: &Setup, first_row: u32, width: u32) -> ([Row<'_>; ROWS_A_TASK], [[Stretch; 3]; ROWS_A_TASK]) {
    let rows = std::array::from_fn(|r| Row::new(setup, first_row + r as u32, width));
    let stretches = rows.each_ref().map(Row::stretches);
    (rows, stretches)
}

/// The rows' stretches, block of columns by block, each as far as it lies in the block, with its row's number.
fn parts(stretches: &[[Stretch; 3]], width: u32) -> impl Iterator<Item = (usize, Stretch)> + '_ {
    (0..width).step_by(COLUMNS_A_BLOCK as usize).flat_map(move |from| {
        let to = (from + COLUMNS_A_BLOCK).min(width);
        let all = stretches.iter().enumerate().flat_map(|(r, stretches)| stretches.iter().map(move |s| (r, s)));
        let part = move |(r, s): (usize, &Stretch)| (r, Stretch { from: s.from.max(from), to: s.to.min(to), ..*s });
        all.map(part).filter(|(_, part)| part.from < part.to)
    })
}

/// The voxels' boxes as a pixel's ray meets them.
pub(super) struct Boxes {
    /// The eye in level-0 voxels: whole, and rest.
    pub(super) eye: [i32; 3],
    pub(super) fract: [f32; 3],
}

/// The reciprocal of a component of a ray. A ray along an axis' grid planes crosses none of them, and is in or out of a
/// voxel's slab whatever its parameter.
#[inline(always)]
pub fn ray_inverse(d: f32) -> f32 {
    1.0 / (if d.abs() < 1e-30 { 1e-30 } else { d })
}

/// The depth of a voxel that a ray does not meet.
pub(super) const MISS: f32 = f32::INFINITY;

impl Boxes {
    /// Depths at which a ray (inverse components given) enters a voxel's box, at least 0, and leaves it; the first is
    /// greater where it passes by.
    #[inline(always)]
    fn cut(&self, voxel: [i32; 4], inverse: [f32; 3]) -> [f32; 2] {
        let l = voxel[3];
        let (mut near, mut far) = (0.0f32, f32::INFINITY);
        for axis in 0..3 {
            // Each face from whole numbers: a sum with the other one would lose a face at hand.
            let face = |cell: i32| cell.wrapping_shl(l as u32).wrapping_sub(self.eye[axis]) as f32 - self.fract[axis];
            let (from, to) = (face(voxel[axis]), face(voxel[axis].wrapping_add(1)));
            let (a, b) = (from * inverse[axis], to * inverse[axis]);
            near = Real::max(near, Real::min(a, b));
            far = Real::min(far, Real::max(a, b));
        }
        [near, far]
    }

    /// Depth at which a ray enters a voxel, at least 0; [`MISS`] where it misses it or there is none. One that the eye touches
    /// and the ray leaves at once is missed: faces belong to the voxels above them.
    #[inline(always)]
    fn enter(&self, voxel: [i32; 4], inverse: [f32; 3]) -> f32 {
        let [near, far] = self.cut(voxel, inverse);
        // Rounding must not let a ray slip between two voxels.
        if near <= far * (1.0 + 1e-6) && far > 0.0 && voxel[3] >= 0 { near } else { MISS }
    }

    /// [`Boxes::enter`] of the voxels at `at`, each with the ray at its place, in vectors. `voxel` is scratch.
    #[inline(always)]
    pub(super) fn enter_each(
        &self,
        shown: &[[i32; 4]],
        at: &[u32],
        inverse: &[[f32; BLOCK]; 3],
        voxel: &mut [[i32; BLOCK]; 4],
        near: &mut [f32; BLOCK],
    ) {
        let m = at.len();
        turned(shown, at, voxel);
        let [x, y, z, l] = voxel;
        let voxel = x[..m].iter().zip(&y[..m]).zip(&z[..m]).zip(&l[..m]);
        let [dx, dy, dz] = inverse;
        let inverse = dx[..m].iter().zip(&dy[..m]).zip(&dz[..m]);
        for ((near, (((&x, &y), &z), &l)), ((&dx, &dy), &dz)) in near[..m].iter_mut().zip(voxel).zip(inverse) {
            *near = self.enter([x, y, z, l], [dx, dy, dz]);
        }
    }
}

/// The voxels at `at`, each component in an array of its own.
#[inline(always)]
fn turned(shown: &[[i32; 4]], at: &[u32], [x, y, z, l]: &mut [[i32; BLOCK]; 4]) {
    let m = at.len();
    #[cfg(target_arch = "x86_64")]
    let (done, [x, y, z, l]) = {
        use std::arch::x86_64::{_mm_loadu_ps, _mm_storeu_ps, _mm_unpackhi_ps, _mm_unpacklo_ps};
        use std::arch::x86_64::{_mm_movehl_ps, _mm_movelh_ps};
        let whole = at.as_chunks::<4>().0;
        for (k, four) in whole.iter().enumerate() {
            let voxels = four.map(|at| &shown[at as usize]);
            let places = [&mut *x, &mut *y, &mut *z, &mut *l].map(|of| &mut of[4 * k..4 * k + 4]);
            // SAFETY: four words each, read and written; every x86-64 has SSE2.
            unsafe {
                let [a, b, c, d] = voxels.map(|v| _mm_loadu_ps(v.as_ptr().cast()));
                let (xy, xy_next) = (_mm_unpacklo_ps(a, b), _mm_unpacklo_ps(c, d));
                let (zl, zl_next) = (_mm_unpackhi_ps(a, b), _mm_unpackhi_ps(c, d));
                let turned = [
                    _mm_movelh_ps(xy, xy_next),
                    _mm_movehl_ps(xy_next, xy),
                    _mm_movelh_ps(zl, zl_next),
                    _mm_movehl_ps(zl_next, zl),
                ];
                for (place, turned) in places.into_iter().zip(turned) {
                    _mm_storeu_ps(place.as_mut_ptr().cast(), turned);
                }
            }
        }
        (4 * whole.len(), [x, y, z, l])
    };
    #[cfg(not(target_arch = "x86_64"))]
    let done = 0;
    let rest = x[done..m].iter_mut().zip(&mut y[done..m]).zip(&mut z[done..m]).zip(&mut l[done..m]);
    for ((((x, y), z), l), &at) in rest.zip(&at[done..]) {
        [*x, *y, *z, *l] = shown[at as usize];
    }
}

/// A picture's pixels, row by row.
pub struct Pixels<'a> {
    pub color: &'a mut [u32],
    pub depth: &'a mut [f32],
    /// As planes have it, a cell of a level; empty where it is not wanted.
    pub voxel: &'a mut [[i32; 4]],
    /// For `refine`: where something else may be seen than the samples around show; empty where it is not to be refined.
    pub doubt: &'a mut [Doubt],
}

/// Like [`remap`], but each pixel tests voxels against its own ray: those of its sample in the two planes beside it and,
/// unless it meets both, those of the samples next to them. It takes the nearest that it meets: what it truly shows is no
/// farther, since each voxel of the buffer is there. Where it meets none, it takes the sky if one of the two planes shows
/// it, else the voxel of theirs that it misses less. Depth is where the pixel's own ray enters the voxel. (Not in the
/// papers.) Needs [`PlaneBuffer::voxel`]. Where planes
/// have no colours they are looked up here, for the samples that are taken.
pub fn remap_retest(
    resident: &Resident,
    setup: &Setup,
    buffer: &PlaneBuffer,
    camera: &Camera,
    pixels: &mut Pixels<'_>,
) {
    let Pixels { color, depth, voxel, doubt } = pixels;
    let w = camera.width as usize;
    let avx2 = has_avx2();
    let mut drawn = DRAWN.take();
    drawn.clear();
    drawn.extend(setup.planes.iter().map(|plane| [plane.first, plane.end]));
    let whole = [UP, DOWN, LEFT, RIGHT].map(|f| {
        let fan = &setup.fans[f];
        let planes = &drawn[fan.first_plane as usize..(fan.first_plane + fan.n_planes) as usize];
        planes.iter().all(|&plane| plane == [0, fan.n_samples])
    });
    let (n, count) = (ROWS_A_TASK * w, color.len().div_ceil(ROWS_A_TASK * w));
    let tasks = color.par_chunks_mut(n).zip(depth.par_chunks_mut(n));
    let tasks = tasks.zip(chunks_mut(voxel, n, count).zip(chunks_mut(doubt, n, count)));
    tasks.enumerate().for_each(|(task, ((color, depth), (voxel, doubt)))| {
        let first_row = (task * ROWS_A_TASK) as u32;
        let rows = RowsTask { setup, buffer, first_row, width: camera.width, color, depth };
        let task = RetestTask { rows, resident, camera, drawn: &drawn, whole, voxel, doubt };
        #[cfg(target_arch = "x86_64")]
        if avx2 {
            // SAFETY: `has_avx2` has seen that the processor can.
            return unsafe { retest_rows_avx2(task) };
        }
        let _ = avx2;
        retest_rows(task);
    });
    DRAWN.set(drawn);
}

thread_local! {
    /// What is drawn of each plane: memory, from frame to frame.
    static DRAWN: Cell<Vec<[u32; 2]>> = const { Cell::new(Vec::new()) };
}

/// Some rows of a picture whose pixels test voxels.
struct RetestTask<'a> {
    rows: RowsTask<'a>,
    resident: &'a Resident,
    camera: &'a Camera,
    /// First sample of each plane, and one past its last: beyond them its part of the buffer is not drawn.
    drawn: &'a [[u32; 2]],
    /// Whether all planes of a fan are drawn from end to end.
    whole: [bool; 4],
    voxel: &'a mut [[i32; 4]],
    doubt: &'a mut [Doubt],
}

/// The same code for processors with AVX2; the same bits.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
fn retest_rows_avx2(task: RetestTask<'_>) {
    retest_rows(task);
}

/// Colour of a voxel as planes keep it, 0 of the sky; of scenes whose runs have no colours of their own.
#[inline(always)]
pub fn color_of(resident: &Resident, [x, y, z, l]: [i32; 4]) -> u32 {
    let Some(level) = resident.levels.get(l as usize) else { return 0 };
    // Whole periods away where the world repeats.
    let wrap = |v: i32, n: u32| if (v as u32) < n { v as u32 } else { v.rem_euclid(n as i32) as u32 };
    level.color(level.index(wrap(x, level.nx), wrap(z, level.nz)), 0, y as u32)
}

pub(super) const BLOCK: usize = COLUMNS_A_BLOCK as usize;

/// A stretch's pixels, one after the other in each array, so that they are worked on in vectors.
struct Block {
    /// The two planes beside a pixel, within its fan, the nearest first; which of their samples; where those stand in the
    /// fan's part of the buffer.
    planes: [[u32; BLOCK]; 2],
    sample: [u32; BLOCK],
    at: [[u32; BLOCK]; 2],
    inverse: [[f32; BLOCK]; 3],
    near: [[f32; BLOCK]; 2],
    /// Least depth of the samples around a pixel whose two planes disagree, [`SETTLED`] elsewhere.
    nearest: [f32; BLOCK],
    again: Again,
    /// Of the two planes.
    voxel: [[[i32; BLOCK]; 4]; 2],
}

/// Less than any depth.
pub(super) const SETTLED: f32 = -1.0;

/// Those of a block's pixels whose rays do not meet both planes' voxels, and so look at the samples next to them.
struct Again {
    pixel: [u8; BLOCK],
    at: [u32; BLOCK],
    inverse: [[f32; BLOCK]; 3],
    near: [f32; BLOCK],
}

impl Block {
    const EMPTY: Block = Block {
        planes: [[0; BLOCK]; 2],
        sample: [0; BLOCK],
        at: [[0; BLOCK]; 2],
        inverse: [[0.0; BLOCK]; 3],
        near: [[0.0; BLOCK]; 2],
        nearest: [SETTLED; BLOCK],
        again: Again { pixel: [0; BLOCK], at: [0; BLOCK], inverse: [[0.0; BLOCK]; 3], near: [0.0; BLOCK] },
        voxel: [[[0; BLOCK]; 4]; 2],
    };
}

#[inline(always)]
fn retest_rows(task: RetestTask<'_>) {
    let RetestTask {
        rows: RowsTask { setup, buffer, first_row, width, color, depth },
        resident,
        camera,
        drawn,
        whole,
        voxel,
        doubt,
    } = task;
    let doubts = !doubt.is_empty();
    let w = width as usize;
    let basis = camera.basis();
    let boxes = Boxes { eye: setup.eye_cell, fract: setup.eye_fract.map(|f| f as f32) };
    let (rows, stretches) = task_rows(setup, first_row, width);
    let mut block = Block::EMPTY;
    for (r, part) in parts(&stretches[..color.len() / w], width) {
        let y = f64::from(rows[r].row) + 0.5;
        let start = camera.ray(&basis, 0.5, y);
        let step = (camera.ray(&basis, f64::from(width) + 0.5, y) - start) / f64::from(width);
        let fan = &setup.fans[part.fan];
        let (n, m) = (fan.n_samples, (part.to - part.from) as usize);
        let drawn = &drawn[fan.first_plane as usize..(fan.first_plane + fan.n_planes) as usize];
        let samples = fan.first_sample..fan.first_sample + fan.n_planes as usize * n as usize;
        let shown = &buffer.voxel[samples.clone()];
        let (colors, depths) = (buffer.color.get(samples.clone()), &buffer.depth[samples]);

        let ([own, beside], [planes, seconds]) = (&mut block.at, &mut block.planes);
        rows[r].gather(part, |x, place| {
            let i = (x as u32 - part.from) as usize % BLOCK;
            own[i] = place.plane * n + place.sample;
            beside[i] = place.second * n + place.sample;
            (planes[i], seconds[i], block.sample[i]) = (place.plane, place.second, place.sample);
        });
        if !whole[part.fan] {
            let places = own[..m].iter().zip(&block.sample[..m]).zip(&seconds[..m]);
            for (beside, ((own, sample), &second)) in beside[..m].iter_mut().zip(places) {
                let [first, end] = drawn[second as usize];
                if !(first..end).contains(sample) {
                    *beside = *own;
                }
            }
        }
        let [dx, dy, dz] = &mut block.inverse;
        for (i, ((dx, dy), dz)) in dx[..m].iter_mut().zip(&mut dy[..m]).zip(&mut dz[..m]).enumerate() {
            let x = f64::from((part.from as i32).wrapping_add(i as i32));
            let inverse = |start: f64, step: f64| ray_inverse((start + step * x) as f32);
            (*dx, *dy, *dz) = (inverse(start.x, step.x), inverse(start.y, step.y), inverse(start.z, step.z));
        }
        for ((at, near), voxel) in block.at.iter().zip(&mut block.near).zip(&mut block.voxel) {
            boxes.enter_each(shown, &at[..m], &block.inverse, voxel, near);
        }
        let ([own, beside], [near, near_beside], again) = (&mut block.at, &mut block.near, &mut block.again);
        let mut n_again = 0;
        for i in 0..m {
            let (one, other) = (near[i], near_beside[i]);
            if one != MISS && other != MISS {
                continue;
            }
            // Sky all around, as in most of a sky: nothing else to find.
            let sky = one == other && own[i] != beside[i] && all_sky(shown, own[i]) && all_sky(shown, beside[i]);
            again.pixel[n_again] = i as u8;
            n_again += usize::from(!sky);
        }
        if doubts {
            settle(&block.voxel, [&near[..m], &near_beside[..m]], &mut block.nearest);
            for (i, nearest) in block.nearest[..m].iter_mut().enumerate().filter(|(_, n)| **n != SETTLED) {
                *nearest = Real::min(depths[own[i] as usize], depths[beside[i] as usize]);
            }
        }
        // Of voxels in both planes the nearer is what the ray sees: behind it the other lies inside the surface.
        for (((at, beside), z), near) in
            own[..m].iter_mut().zip(&beside[..m]).zip(&mut near[..m]).zip(&near_beside[..m])
        {
            (*at, *z) = if *near < *z { (*beside, *near) } else { (*at, *z) };
        }
        for (j, &i) in again.pixel[..n_again].iter().enumerate() {
            for (compact, all) in again.inverse.iter_mut().zip(&block.inverse) {
                compact[j] = all[usize::from(i)];
            }
        }
        for (planes, step) in block.planes.iter().flat_map(|planes| [(planes, -1), (planes, 1)]) {
            for (at, &i) in again.at.iter_mut().zip(&again.pixel[..n_again]) {
                let i = usize::from(i);
                let (plane, sample) = (planes[i], block.sample[i].wrapping_add_signed(step));
                let [first, end] = drawn[plane as usize];
                *at = if (first..end).contains(&sample) { plane * n + sample } else { own[i] };
            }
            boxes.enter_each(shown, &again.at[..n_again], &again.inverse, &mut block.voxel[0], &mut again.near);
            for ((&at, &z), &i) in again.at.iter().zip(&again.near).zip(&again.pixel[..n_again]) {
                let i = usize::from(i);
                (own[i], near[i]) = if z < near[i] { (at, z) } else { (own[i], near[i]) };
            }
            if doubts {
                for (&at, &i) in again.at.iter().zip(&again.pixel[..n_again]) {
                    let nearest = &mut block.nearest[usize::from(i)];
                    let coarse = shown[at as usize][3] > 0;
                    *nearest = Real::min(*nearest, if coarse { MISS } else { depths[at as usize] });
                }
            }
        }
        let out = r * w + part.from as usize..r * w + part.to as usize;
        if doubts {
            let nearest = block.nearest[..m].iter().zip(&near[..m]);
            for (doubt, (&nearest, &near)) in doubt[out.clone()].iter_mut().zip(nearest) {
                *doubt = Doubt::new(nearest, near != MISS);
            }
        }
        for (j, &i) in again.pixel[..n_again].iter().enumerate() {
            let i = usize::from(i);
            if near[i] == MISS {
                let inverse = [0, 1, 2].map(|axis| again.inverse[axis][j]);
                own[i] = missed(shown, &boxes, [own[i], beside[i]], inverse);
                near[i] = depths[own[i] as usize];
            }
        }
        depth[out.clone()].copy_from_slice(&near[..m]);
        let pixels = color[out.clone()].iter_mut().zip(&own[..m]);
        match colors {
            Some(colors) => pixels.for_each(|(c, &at)| *c = colors[at as usize]),
            None => {
                // Pixels side by side mostly show the same voxel, or one whose colour is near in memory.
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
            for (v, &at) in voxel[out].iter_mut().zip(&own[..m]) {
                *v = shown[at as usize];
            }
        }
    }
}

/// Marks with [`SETTLED`] the pixels whose two planes leave no doubt: those that meet the same voxel in both, and those that
/// meet one of two that share a face, between which there is nothing else to see. Nor do cells of coarser levels, which are
/// about a pixel wide.
#[inline(always)]
fn settle([own, beside]: &[[[i32; BLOCK]; 4]; 2], [near, near_beside]: [&[f32]; 2], nearest: &mut [f32; BLOCK]) {
    for i in 0..near.len() {
        let apart = |axis: usize| own[axis][i].wrapping_sub(beside[axis][i]).unsigned_abs();
        let neighbours =
            (apart(0) | apart(1) | apart(2)) <= 1 && apart(0) + apart(1) + apart(2) <= 1 && own[3][i] == beside[3][i];
        let (one, other) = (near[i], near_beside[i]);
        // A ray enters one voxel at one depth.
        let coarse = own[3][i].max(beside[3][i]) > 0;
        let settled = coarse || (Real::min(one, other) != MISS && (neighbours || one == other));
        nearest[i] = if settled { SETTLED } else { MISS };
    }
}

/// Whether a sample and its two neighbours along the plane show the sky; false at the ends of `shown`.
#[inline(always)]
pub(super) fn all_sky(shown: &[[i32; 4]], at: u32) -> bool {
    let at = at as usize;
    let around = shown.get(at.wrapping_sub(1)..at + 2);
    around.is_some_and(|samples| samples.iter().all(|voxel| voxel[3] < 0))
}

/// Of the two planes' own samples, whose voxels the ray misses, as it does those next to them: the one that shows the sky, else
/// the one that it misses less. (Not one of those next to them: its depth and, of a silhouette, its sky are not the pixel's.)
#[cold]
pub(super) fn missed(shown: &[[i32; 4]], boxes: &Boxes, [own, beside]: [u32; 2], inverse: [f32; 3]) -> u32 {
    let [by, by_beside] = [own, beside].map(|at| match shown[at as usize] {
        SKY => f32::NEG_INFINITY,
        voxel => {
            let [near, far] = boxes.cut(voxel, inverse);
            // As an angle: a share of the distance. A voxel behind the eye, or one that it touches, is missed most.
            if near > 0.0 { (near - far) / near } else { f32::INFINITY }
        }
    });
    if by_beside < by { beside } else { own }
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
        let scene = std::sync::Arc::new(build(input, &BuildOptions::default()).unwrap());
        let resident = std::sync::Arc::new(Resident::new(&scene));
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
