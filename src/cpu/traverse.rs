//! Stage `traverse`: each plane walks its columns near to far and draws their runs as spans into its samples.
//!
//! **Walk.** Amanatides & Woo 1987 in the horizontal grid; crossing parameters are computed anew from the integer cell at
//! each step, never summed up. Blocks of 8 × 8 columns whose height bounds lie outside the window are jumped over. At
//! a change of level the cell numbers are halved and the walk goes on from the same `t`, so nothing is drawn twice.
//!
//! **Draw.** Over `t0 ..= t1` a run between heights `h0` and `h1` shows up to three faces, which meet in sample space
//! exactly: bottom (`h0 > 0`) from `(t1, h0)` to `(t0, h0)`, front to `(t0, h1)`, top (`h1 < 0`) to `(t1, h1)`. A span
//! owns the samples whose centres lie in it, half-open, so neighbours neither overlap nor leave cracks. Points outside
//! the plane's own window are clipped by comparing `h` with `slope · t`, before any division.
//!
//! **Ground.** Heights seen from above the ground's underside ([`Feature::Horizon`]) are walked by the module
//! `ground`.
//!
//! **Cull.** See [`Culling`]. All tests that reject are a sixteenth of a sample looser than the test that draws, far more
//! than rounding takes, so that no combination of switches changes a picture.

mod ground;

use crate::cpu::{chunks_mut, resize};
use crate::frame::options::Culling;
use crate::frame::plane_setup::{Plane, Setup};
use crate::frame::specialize::{Feature, Features, Specialization};
use crate::world::tables::{BLOCK_SHIFT, EMPTY, Paint, Resident, ResidentLevel, UNPAINTED, nearest_exposed};
use planecast_encoder::Run;
use rayon::prelude::*;
use std::cell::RefCell;

/// The number type of a walk: f32 as on the GPU, or f64.
pub trait Real:
    Copy
    + PartialOrd
    + Send
    + Sync
    + std::ops::Add<Output = Self>
    + std::ops::Sub<Output = Self>
    + std::ops::Mul<Output = Self>
    + std::ops::Div<Output = Self>
    + 'static
{
    /// Whether walks have variants for what is usual and for AVX2. f64 is there to measure f32's error, not to be fast.
    const QUICK: bool;
    const ZERO: Self;
    const HALF: Self;
    /// A sixteenth less than a half.
    const BELOW_CENTRE: Self;
    /// Steeper than any slope between voxels, and safe to multiply with any distance.
    const STEEP: Self;
    /// Nearer to zero no direction's component is taken, so that no depth overflows.
    const TINY: Self;
    fn abs(self) -> Self;
    fn from_f64(v: f64) -> Self;
    fn from_i32(v: i32) -> Self;
    /// Rounded down, of numbers brought into ±2³⁰ first (NaN to −2³⁰).
    fn floor_i32(self) -> i32;
    fn to_f32(self) -> f32;
    /// The whole part, of numbers brought into `0 ..= top` first (NaN to 0); `top` is below 2³¹.
    fn truncate(self, top: Self) -> i32;
    /// As [`traverse()`], the same picture without what the frame does not need. With [`Feature::LateColor`] and `voxels` the
    /// buffer has no colours: they are [`crate::cpu::remap::color_of`] the voxels. Over ground it has them.
    // A function of the type is compiled here, not again in each crate that calls it.
    fn traverse(
        resident: &Resident,
        setup: &Setup,
        culling: Culling,
        specialization: Specialization,
        buffer: &mut PlaneBuffer,
        voxels: bool,
    ) -> Counters;
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        if other < self { other } else { self }
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        if other > self { other } else { self }
    }
}

macro_rules! real {
    ($t:ty, $quick:literal) => {
        impl Real for $t {
            const QUICK: bool = $quick;
            const ZERO: $t = 0.0;
            const HALF: $t = 0.5;
            const BELOW_CENTRE: $t = 0.4375;
            const STEEP: $t = 1e18;
            const TINY: $t = 1e-20;
            #[inline(always)]
            fn abs(self) -> $t {
                <$t>::abs(self)
            }
            #[inline(always)]
            fn from_f64(v: f64) -> $t {
                v as $t
            }
            #[inline(always)]
            fn from_i32(v: i32) -> $t {
                v as $t
            }
            // Not `floor()`: without SSE 4.1 that is a library call.
            #[inline(always)]
            fn floor_i32(self) -> i32 {
                const FAR: $t = (1 << 30) as $t;
                let v = if self > -FAR { self } else { -FAR };
                let v = if v < FAR { v } else { FAR };
                // SAFETY: v is in −2³⁰ ..= 2³⁰. The checked cast takes four times the instructions.
                let i = unsafe { v.to_int_unchecked::<i32>() };
                i - i32::from(i as $t > v)
            }
            #[inline(always)]
            fn to_f32(self) -> f32 {
                self as f32
            }
            #[inline(always)]
            fn truncate(self, top: $t) -> i32 {
                let v = if self > 0.0 { self } else { 0.0 };
                let v = if v < top { v } else { top };
                // SAFETY: v is in 0 ..= top, and top is below 2³¹. The checked cast keeps loops from being vectorised.
                unsafe { v.to_int_unchecked::<i32>() }
            }
            fn traverse(
                resident: &Resident,
                setup: &Setup,
                culling: Culling,
                specialization: Specialization,
                buffer: &mut PlaneBuffer,
                voxels: bool,
            ) -> Counters {
                thread_local! {
                    // From frame to frame.
                    static SCRATCH: RefCell<Scratch<$t>> = RefCell::default();
                }
                let with = |walk: &mut dyn FnMut(&mut Scratch<$t>)| SCRATCH.with_borrow_mut(walk);
                traverse_planes::<$t>(resident, setup, culling, specialization, buffer, voxels, with)
            }
        }
    };
}
real!(f32, true);
real!(f64, false);

/// What planes draw into: one entry a sample, plane by plane as [`Plane::base`] says.
#[derive(Default)]
pub struct PlaneBuffer {
    /// Packed sRGB; 0 for sky.
    pub color: Vec<u32>,
    /// Along the camera's forward axis; +inf for sky.
    pub depth: Vec<f32>,
    /// x, y, z of the voxel in its level's cells relative to the reduced world, and the level; empty unless wanted.
    pub voxel: Vec<[i32; 4]>,
}

/// Samples that short spans are written by at once.
const LANES: usize = 8;

/// No voxel.
pub const SKY: [i32; 4] = [-1; 4];

/// Work done.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    pub columns_visited: u64,
    pub runs_visited: u64,
    pub spans_drawn: u64,
}

impl std::ops::AddAssign for Counters {
    fn add_assign(&mut self, other: Counters) {
        self.columns_visited += other.columns_visited;
        self.runs_visited += other.runs_visited;
        self.spans_drawn += other.spans_drawn;
    }
}

/// Planes that one task walks. Small, since neighbouring planes cost alike and far ones do not; large enough that a
/// task's planes share the columns they load.
const PLANES_A_TASK: usize = 8;

/// Beyond any column: equidistant from here on is nowhere.
const EVERYWHERE: f64 = 1e17;

/// Walks all planes of a frame in the general way. `buffer` is resized to fit.
pub fn traverse<R: Real>(
    resident: &Resident,
    setup: &Setup,
    culling: Culling,
    buffer: &mut PlaneBuffer,
    voxels: bool,
) -> Counters {
    R::traverse(resident, setup, culling, Specialization { features: Features::NONE }, buffer, voxels)
}

fn traverse_planes<R: Real>(
    resident: &Resident,
    setup: &Setup,
    culling: Culling,
    specialization: Specialization,
    buffer: &mut PlaneBuffer,
    voxels: bool,
    with_scratch: impl Fn(&mut dyn FnMut(&mut Scratch<R>)) + Sync,
) -> Counters {
    let ground = specialization.has(Feature::Horizon) && culling == Culling::ALL && setup.equidistant >= EVERYWHERE;
    let colors = !(specialization.has(Feature::LateColor) && voxels && culling == Culling::ALL && !ground);
    resize(&mut buffer.color, if colors { setup.samples } else { 0 }, 0);
    resize(&mut buffer.depth, setup.samples, f32::INFINITY);
    resize(&mut buffer.voxel, if voxels { setup.samples } else { 0 }, SKY);

    let (mut color, mut depth, mut voxel) =
        (buffer.color.as_mut_slice(), buffer.depth.as_mut_slice(), buffer.voxel.as_mut_slice());
    let [up, down, left, right] = setup.fans.each_ref().map(|fan| {
        let own = fan.first_plane as usize..(fan.first_plane + fan.n_planes) as usize;
        // As [`Setup::done`], of this fan's planes.
        let done = setup.done.get(own.clone()).unwrap_or_default();
        let planes = &setup.planes[own];
        let n = planes.len() * fan.n_samples as usize;
        let (c, d, v);
        (c, color) = std::mem::take(&mut color).split_at_mut(if colors { n } else { 0 });
        (d, depth) = std::mem::take(&mut depth).split_at_mut(n);
        (v, voxel) = std::mem::take(&mut voxel).split_at_mut(if voxels { n } else { 0 });
        let (n, tasks) = (PLANES_A_TASK * fan.n_samples.max(1) as usize, planes.len().div_ceil(PLANES_A_TASK));
        planes
            .par_chunks(PLANES_A_TASK)
            .zip(d.par_chunks_mut(n))
            .zip(chunks_mut(c, n, tasks).zip(chunks_mut(v, n, tasks)))
            .enumerate()
            .map(move |(i, task)| (done.get(i * PLANES_A_TASK..).unwrap_or_default(), task))
    });
    let tasks = up.chain(down).chain(left.chain(right)).with_max_len(1);
    let avx2 = has_avx2();
    type Task<'t> = (&'t [bool], ((&'t [Plane], &'t mut [f32]), (&'t mut [u32], &'t mut [[i32; 4]])));
    let run = |(done, ((planes, depth), (color, voxel))): Task| {
        let n = depth.len() / planes.len();
        let mut counters = Counters::default();
        with_scratch(&mut |scratch| {
            for (k, plane) in planes.iter().enumerate() {
                if done.get(k) == Some(&true) {
                    continue;
                }
                let at = k * n..(k + 1) * n;
                let color = if colors { &mut color[at.clone()] } else { &mut [][..] };
                let depth = &mut depth[at.clone()];
                let voxel = if voxels { &mut voxel[at] } else { &mut [][..] };
                let task = Task1 { resident, setup, plane, culling, ground, color, depth, voxel };
                counters += walk_plane::<R>(task, scratch, avx2);
            }
        });
        counters
    };
    tasks.map(run).reduce(Counters::default, |mut a, b| {
        a += b;
        a
    })
}

fn walk_plane<R: Real>(task: Task1<'_>, scratch: &mut Scratch<R>, avx2: bool) -> Counters {
    macro_rules! walk {
        ($voxel:literal, $fast:literal, $color:literal) => {{
            #[cfg(target_arch = "x86_64")]
            if R::QUICK && avx2 {
                // SAFETY: `has_avx2` has seen that the processor can.
                return unsafe { traverse_one_avx2::<R, $voxel, $fast, $color>(task, scratch) };
            }
            traverse_one::<R, $voxel, $fast, $color>(task, scratch)
        }};
    }
    if task.ground {
        #[cfg(target_arch = "x86_64")]
        if R::QUICK && avx2 {
            // SAFETY: as above.
            return unsafe { ground_one_avx2::<R>(task, scratch) };
        }
        return ground_one::<R>(task, scratch);
    }
    let _ = avx2;
    // All variants there are, each a function of its own, so that none is compiled within another. Terms of tilted cameras, the
    // seam of repeated worlds and the change of levels are met once a span, a block or a level, not once a column, and have none.
    let (voxel, color) = (!task.voxel.is_empty(), !task.color.is_empty());
    if R::QUICK && task.culling == Culling::ALL {
        return match (voxel, color) {
            (false, _) => walk!(false, true, true),
            (true, false) => walk!(true, true, false),
            (true, true) => walk!(true, true, true),
        };
    }
    match (voxel, color) {
        (false, _) => walk!(false, false, true),
        (true, false) if !R::QUICK => walk!(true, false, false),
        (true, _) => walk!(true, false, true),
    }
}

#[inline(always)]
fn ground_one<R: Real>(task: Task1<'_>, scratch: &mut Scratch<R>) -> Counters {
    if task.voxel.is_empty() { ground::walk::<R, false>(task, scratch) } else { ground::walk::<R, true>(task, scratch) }
}

/// Memory that the planes of a thread take one after the other.
struct Scratch<R> {
    walk: WalkScratch<R>,
    ground: ground::Scratch<R>,
}

impl<R> Default for Scratch<R> {
    fn default() -> Self {
        let sight = Sight { depth_t: Vec::new(), slope: Vec::new(), depth_h: Vec::new() };
        let walk = WalkScratch { open: Vec::new(), skip: Vec::new(), sight };
        Scratch { walk, ground: ground::Scratch::default() }
    }
}

/// What [`Walk`] takes of it.
struct WalkScratch<R> {
    open: Vec<u64>,
    skip: Vec<u32>,
    sight: Sight<R>,
}

/// The samples' sight lines: the directions `(t, h)` through their centres, which have depth Δ.
struct Sight<R> {
    /// `Δ / t`: depth a unit of horizontal distance.
    depth_t: Vec<R>,
    /// `h / t`.
    slope: Vec<R>,
    /// `|Δ / h|`: depth a unit of height.
    depth_h: Vec<R>,
}

/// One plane's inputs and outputs.
struct Task1<'a> {
    resident: &'a Resident,
    setup: &'a Setup,
    plane: &'a Plane,
    culling: Culling,
    /// Heights seen from above the ground.
    ground: bool,
    color: &'a mut [u32],
    depth: &'a mut [f32],
    voxel: &'a mut [[i32; 4]],
}

#[inline(always)]
fn walk_one<R: Real, const VOXEL: bool, const FAST: bool, const COLOR: bool>(
    task: Task1<'_>,
    scratch: &mut Scratch<R>,
) -> Counters {
    let plane = task.plane;
    let mut walk = Walk::<R, VOXEL, FAST, COLOR>::new(task, &mut scratch.walk);
    walk.run(Start::of(plane));
    walk.finish()
}

#[inline(never)]
fn traverse_one<R: Real, const VOXEL: bool, const FAST: bool, const COLOR: bool>(
    task: Task1<'_>,
    scratch: &mut Scratch<R>,
) -> Counters {
    walk_one::<R, VOXEL, FAST, COLOR>(task, scratch)
}

/// The same code for processors with AVX2 and BMI: wider loops over samples, cheaper bit scans. No fused operations, so
/// the same bits.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
#[inline(never)]
fn traverse_one_avx2<R: Real, const VOXEL: bool, const FAST: bool, const COLOR: bool>(
    task: Task1<'_>,
    scratch: &mut Scratch<R>,
) -> Counters {
    walk_one::<R, VOXEL, FAST, COLOR>(task, scratch)
}

/// As [`traverse_one_avx2`].
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
fn ground_one_avx2<R: Real>(task: Task1<'_>, scratch: &mut Scratch<R>) -> Counters {
    ground_one::<R>(task, scratch)
}

/// Whether the variants for AVX2 may be called.
pub fn has_avx2() -> bool {
    #[cfg(test)]
    if tests::WITHOUT_AVX2.get() {
        return false;
    }
    #[cfg(target_arch = "x86_64")]
    return is_x86_feature_detected!("avx2")
        && is_x86_feature_detected!("bmi1")
        && is_x86_feature_detected!("bmi2")
        && is_x86_feature_detected!("lzcnt")
        && is_x86_feature_detected!("popcnt");
    #[cfg(not(target_arch = "x86_64"))]
    return false;
}

/// Where a plane's walk begins or goes on: the distance, the level, and its column there.
struct Start<R> {
    t0: R,
    level: u32,
    cell: [i32; 2],
}

impl<R: Real> Start<R> {
    fn of(plane: &Plane) -> Self {
        let level = plane.lod_first;
        Start { t0: R::from_f64(plane.t_start), level, cell: plane.cell.map(|c| c >> level) }
    }
}

/// Faces of a run, as drawn.
#[derive(Clone, Copy)]
enum Face {
    Bottom,
    Front,
    Top,
}

/// A run about to be drawn.
#[derive(Clone, Copy)]
struct Drawn<R> {
    run: Run,
    /// Which run of its column, from the top down.
    k: u32,
    /// Column number in the level's tables.
    column: usize,
    h0: R,
    h1: R,
    t0: R,
}

/// One plane on its way. Fields in this order: `s_lo` and `s_hi` are written one by one and read together, and side by side
/// a compiler would read them as one word, which then waits for both writes to reach the cache. `FAST` stands for
/// [`Culling::ALL`], so that the compiler drops the switches, `COLOR` for planes that have colours.
#[repr(C)]
struct Walk<'a, R: Real, const VOXEL: bool, const FAST: bool, const COLOR: bool> {
    resident: &'a Resident,
    setup: &'a Setup,
    plane: &'a Plane,
    culling: Culling,
    a: R,
    b: R,
    c: R,
    e: R,
    delta: R,
    eye_y: i32,
    fract_y: R,
    /// More samples than any plane has.
    limit: R,
    /// The open window: samples, and slopes near its ends: of what stays below `s_lo` or above `s_hi`, no sample in it shows
    /// anything.
    lo: i32,
    hi: i32,
    s_lo: R,
    /// The center segment; empty where equal.
    center: [i32; 2],
    /// All samples outside `hull` and inside the open window are unfilled, whatever `open` says of those outside the window.
    hull: [i32; 2],
    /// Unfilled samples left, where `lo` and `hi` do not tell.
    left: i32,
    /// One bit a sample, set while it is unfilled.
    open: &'a mut [u64],
    /// For a filled sample, one that may be unfilled, or a step towards it.
    skip: &'a mut [u32],
    /// Sight lines of the samples.
    sight: &'a mut Sight<R>,
    color: &'a mut [u32],
    s_hi: R,
    depth: &'a mut [f32],
    voxel: &'a mut [[i32; 4]],
    /// What stays between these slopes shows nothing outside the center segment.
    s_center: [R; 2],
    /// Level and column of the run being drawn.
    level: u32,
    cell: [i32; 2],
    counters: Counters,
}

impl<'a, R: Real, const VOXEL: bool, const FAST: bool, const COLOR: bool> Walk<'a, R, VOXEL, FAST, COLOR> {
    #[inline(always)]
    fn new(task: Task1<'a>, scratch: &'a mut WalkScratch<R>) -> Self {
        let Task1 { resident, setup, plane, culling, ground, color, depth, voxel } = task;
        let n = depth.len();
        scratch.open.clear();
        scratch.open.resize(n.div_ceil(64), 0);
        for j in plane.first as usize / 64..(plane.end as usize).div_ceil(64) {
            let from = (plane.first as usize).saturating_sub(64 * j).min(64);
            let to = (plane.end as usize - 64 * j).min(64);
            scratch.open[j] = low_bits(to) & !low_bits(from);
        }
        let Sight { depth_t, slope, depth_h } = &mut scratch.sight;
        for v in [depth_t, slope, depth_h] {
            v.resize(n + LANES, R::ZERO);
        }
        scratch.skip.clear();
        if !FAST {
            scratch.skip.extend(0..=n as u32);
            depth[plane.first as usize..plane.end as usize].fill(f32::INFINITY);
        }
        let mut walk = Walk {
            resident,
            setup,
            plane,
            culling,
            a: R::from_f64(plane.a),
            b: R::from_f64(plane.b),
            c: R::from_f64(plane.c),
            e: R::from_f64(plane.e),
            delta: R::from_f64(plane.b * plane.c - plane.a * plane.e),
            eye_y: setup.eye_cell[1],
            fract_y: R::from_f64(setup.eye_fract[1]),
            limit: R::from_i32(1 << 24),
            lo: plane.first as i32,
            hi: plane.end as i32,
            s_lo: R::ZERO,
            s_hi: R::ZERO,
            center: [0; 2],
            hull: [i32::MAX, i32::MIN],
            s_center: [R::ZERO; 2],
            left: plane.end as i32 - plane.first as i32,
            open: &mut scratch.open,
            skip: &mut scratch.skip,
            sight: &mut scratch.sight,
            color,
            depth,
            voxel,
            level: 0,
            cell: [0; 2],
            counters: Counters::default(),
        };
        if !ground {
            walk.look(walk.lo as usize..walk.hi as usize);
        }
        walk.s_lo = walk.below(walk.lo);
        walk.s_hi = walk.above(walk.hi);
        walk
    }

    /// Sight lines of some samples: here the divisions are, for whole vectors of samples at once.
    #[inline(always)]
    fn look(&mut self, range: std::ops::Range<usize>) {
        let (ray_t, ray_h) = (self.b - R::HALF * self.e, R::HALF * self.c - self.a);
        let first = range.start as i32;
        let Sight { depth_t, slope, depth_h } = &mut *self.sight;
        let sights = depth_t[range.clone()].iter_mut().zip(&mut slope[range.clone()]).zip(&mut depth_h[range]);
        for (i, ((depth_t, slope), depth_h)) in sights.enumerate() {
            let u = R::from_i32(first + i as i32);
            let (t, h) = (ray_t - u * self.e, ray_h + u * self.c);
            let t = if t > R::TINY { t } else { R::TINY };
            let up = if h.abs() > R::TINY { h.abs() } else { R::TINY };
            (*depth_t, *slope, *depth_h) = (self.delta / t, h / t, self.delta / up);
        }
    }

    /// Slope of the sight line between samples `j − 1` and `j`.
    #[inline(always)]
    fn edge_slope(&self, j: i32) -> R {
        self.slope_at(R::from_i32(j))
    }

    /// Slope of a sight line a sixteenth of a sample below the centre of sample `j`: far more than rounding takes, so that
    /// what stays below shows in none from `j` on.
    #[inline(always)]
    fn below(&self, j: i32) -> R {
        self.slope_at(R::from_i32(j) + R::BELOW_CENTRE)
    }

    /// Slope of a sight line as far above the centre of the sample before `j`: what stays above shows in none before `j`.
    #[inline(always)]
    fn above(&self, j: i32) -> R {
        self.slope_at(R::from_i32(j) - R::BELOW_CENTRE)
    }

    /// `s_lo`, read by itself as it was written: a compiler would load it as a part of a vector, which waits until the write
    /// has reached the cache.
    #[inline(always)]
    fn low_slope(&self) -> R {
        // SAFETY: a reference to a number that is there.
        unsafe { std::ptr::read_volatile(&self.s_lo) }
    }

    /// `s_hi` likewise.
    #[inline(always)]
    fn high_slope(&self) -> R {
        // SAFETY: a reference to a number that is there.
        unsafe { std::ptr::read_volatile(&self.s_hi) }
    }

    /// Slope of the sight line at place `u`.
    #[inline(always)]
    fn slope_at(&self, u: R) -> R {
        let (t, h) = (self.b - u * self.e, u * self.c - self.a);
        let steep = if h < R::ZERO { R::ZERO - R::STEEP } else { R::STEEP };
        if t > R::ZERO { (h / t).min(R::STEEP).max(R::ZERO - R::STEEP) } else { steep }
    }

    /// Height above the eye of the face below voxel `y` of level 0.
    #[inline(always)]
    fn height(&self, y: u32) -> R {
        R::from_i32(y as i32 - self.eye_y) - self.fract_y
    }

    /// What does not reach above this height shows nowhere between `t0` and `t1`.
    #[inline(always)]
    fn lowest(&self, t0: R, t1: R) -> R {
        let slope = self.low_slope();
        slope * if slope > R::ZERO { t0 } else { t1 }
    }

    /// Nor does what does not reach below this one.
    #[inline(always)]
    fn highest(&self, t0: R, t1: R) -> R {
        let slope = self.high_slope();
        slope * if slope > R::ZERO { t1 } else { t0 }
    }

    /// Heights as whole voxels, rounded outwards.
    #[inline(always)]
    fn whole(&self, lo: R, hi: R) -> (i32, i32) {
        let floor = |h: R| (h + self.fract_y).floor_i32().saturating_add(self.eye_y);
        (floor(lo), floor(hi).saturating_add(1))
    }

    /// For a point `(t, h)` above the slope `s_lo`, the first sample of the open window whose centre is at or above it. A point
    /// beyond the window's upper end is clipped by its slope: whatever its quotient, which may lie behind the camera, it is
    /// not used.
    #[inline(always)]
    fn sample_above(&self, t: R, h: R) -> i32 {
        let inside = self.place(t, h).max(self.lo).min(self.hi);
        if h >= self.high_slope() * t { self.hi } else { inside }
    }

    /// For a point in front of the camera, the first sample whose centre is at or above it.
    #[inline(always)]
    fn place(&self, t: R, h: R) -> i32 {
        // ⌈u − ½⌉ of a u above −½, as a whole part: u + ½ rounds down to it but where it is whole itself.
        let u = (self.a * t + self.b * h) / (self.c * t + self.e * h) + R::HALF;
        let whole = u.truncate(self.limit);
        whole - i32::from(R::from_i32(whole) == u)
    }

    /// The same for any point.
    #[inline(always)]
    fn sample(&self, t: R, h: R) -> i32 {
        if h <= self.low_slope() * t { self.lo } else { self.sample_above(t, h) }
    }

    #[inline(always)]
    fn closed(&self) -> bool {
        self.lo >= self.hi || (!FAST && self.left == 0)
    }

    /// Where level `l` gives way to the next.
    #[inline(always)]
    fn next_level(&self, l: u32) -> R {
        if l + 1 < self.setup.levels {
            R::from_f64((self.plane.lod_t * f64::from(1u32 << (l + 1))).min(1e17))
        } else {
            R::STEEP
        }
    }

    /// Between which heights level `l` and those that follow lie: a coarser one can reach beyond a finer.
    #[inline(always)]
    fn heights_from(&self, l: u32) -> (R, R) {
        let left = (l..self.setup.levels).map(|k| (k, &self.resident.levels[k as usize]));
        let (bottom, top) = left
            .fold((u32::MAX, 0), |(bottom, top), (k, level)| (bottom.min(level.bottom << k), top.max(level.top << k)));
        (self.height(bottom), self.height(top))
    }

    /// Walks the plane until its window is closed or its world ends.
    #[inline(always)]
    fn run(&mut self, from: Start<R>) {
        let plane = self.plane;
        let setup = self.setup;
        let dir = plane.dir.map(R::from_f64);
        let inverse = plane.dir.map(|d| R::from_f64(if d == 0.0 { f64::from(f32::MAX) } else { 1.0 / d }));
        let fract = [R::from_f64(setup.eye_fract[0]), R::from_f64(setup.eye_fract[2])];
        let eye = [setup.eye_cell[0], setup.eye_cell[2]];
        // Where the plane runs along an axis, nothing that could make the distance to its lines 0.
        let within = [0, 1].map(|axis| if plane.dir[axis] == 0.0 { R::ZERO } else { fract[axis] });
        let step = plane.dir.map(|d| if d < 0.0 { -1 } else { 1 });
        let ahead = step.map(|s| i32::from(s > 0));
        // Where the plane crosses the grid line at cell number `line` of level 0; never, if it runs along it.
        let cross = |axis: usize, line: i32| -> R {
            if plane.dir[axis] == 0.0 {
                return R::STEEP;
            }
            (R::from_i32(line.wrapping_sub(eye[axis])) - fract[axis]) * inverse[axis]
        };
        let t_end = R::from_f64(plane.t_end.min(1e17));
        let Start { mut t0, level: mut l, mut cell } = from;
        let equidistant = R::from_f64(setup.equidistant.min(1e17));

        while l < setup.levels {
            let level = &self.resident.levels[l as usize];
            self.level = l;
            let size = [level.nx as i32, level.nz as i32];
            let next_level = self.next_level(l);
            let (bottom, top) = self.heights_from(l);
            loop {
                if t0 >= t_end || self.closed() {
                    return;
                }
                if t0 >= next_level {
                    break;
                }
                // Rounding may let a step across the world's edge end before the walk does.
                if (0..2).any(|axis| !setup.repeats[axis] && !(0..size[axis]).contains(&cell[axis])) {
                    return;
                }
                // Nothing left can come into the window.
                if (FAST || self.culling.coarse)
                    && ((self.s_lo > R::ZERO && self.s_lo * t0 >= top)
                        || (self.s_hi < R::ZERO && self.s_hi * t0 <= bottom))
                {
                    return;
                }
                // Where this way of walking ends, in the midst of a column if need be: not the walk decides what is drawn
                // at which level, but the distance.
                let limit = t_end.min(next_level).min(if t0 < equidistant { equidistant } else { R::STEEP });
                if t0 >= equidistant {
                    t0 = self.slice(level, l, t0, limit, &mut cell, dir, cross);
                    continue;
                }

                // Rounding can put the world's far edge a little before `t_end`.
                let outside = |axis: usize| !setup.repeats[axis] && !(0..size[axis]).contains(&cell[axis]);
                if outside(0) || outside(1) {
                    return;
                }
                // The block of columns that `cell` lies in, cut off where the world repeats.
                let wrapped = [cell[0].rem_euclid(size[0]), cell[1].rem_euclid(size[1])];
                let mut stop = [0; 2];
                for axis in 0..2 {
                    let w = wrapped[axis];
                    stop[axis] = cell[axis]
                        + if step[axis] > 0 {
                            ((w | ((1 << BLOCK_SHIFT) - 1)) + 1).min(size[axis]) - w
                        } else {
                            -(w & ((1 << BLOCK_SHIFT) - 1)) - 1
                        };
                }
                let [wx, wz] = wrapped.map(|v| v as u32);
                let bounds = Run(level.blocks[level.block(wx, wz)]);
                let stop_line = |axis: usize| (stop[axis] + 1 - ahead[axis]) << l;
                let exit = [cross(0, stop_line(0)), cross(1, stop_line(1))];
                let t_exit = exit[0].min(exit[1]);
                if FAST || self.culling.coarse {
                    let t1 = t_exit.min(limit);
                    let (lo, hi) = (self.lowest(t0, t1), self.highest(t0, t1));
                    if bounds.0 == EMPTY
                        || self.height(bounds.end() << l) <= lo
                        || self.height(u32::from(bounds.first()) << l) >= hi
                    {
                        // The cell that stepping would have come to at `t`: estimated, then put right.
                        let reached = |axis: usize, t: R| {
                            let passed = |line: i32| {
                                let at = cross(axis, line << l);
                                if axis == 0 { at <= t } else { at < t }
                            };
                            let at = (fract[axis] + t * dir[axis]).floor_i32().wrapping_add(eye[axis]) >> l;
                            let (from, to) = (cell[axis], stop[axis] - step[axis]);
                            let mut at = at.clamp(from.min(to), from.max(to));
                            while at != from && !passed(at + 1 - ahead[axis]) {
                                at -= step[axis];
                            }
                            while at != to && passed(at + ahead[axis]) {
                                at += step[axis];
                            }
                            at
                        };
                        if t_exit > limit {
                            cell = [reached(0, limit), reached(1, limit)];
                            t0 = limit;
                            continue;
                        }
                        let axis = usize::from(exit[1] < exit[0]);
                        let other = 1 - axis;
                        cell[other] = reached(other, t_exit);
                        cell[axis] = stop[axis];
                        t0 = t0.max(t_exit);
                        continue;
                    }
                }

                // Column by column through the block. Both axes in variables of their own: an array indexed by axis would live
                // in memory.
                let mut index = level.index(wx, wz) as isize;
                let [mut x, mut z] = cell;
                let (mut next_x, mut next_z) = (cross(0, (x + ahead[0]) << l), cross(1, (z + ahead[1]) << l));
                let steps = [step[0] as isize, step[1] as isize * level.row() as isize];
                // Both lines ahead, from the eye, and both crossings anew at each step: that is less than to choose between them.
                let from_eye = |axis: usize, at: i32| ((at + ahead[axis]) << l).wrapping_sub(eye[axis]);
                let (mut line_x, mut line_z) = (from_eye(0, x), from_eye(1, z));
                let (stop_x, stop_z) = (from_eye(0, stop[0]), from_eye(1, stop[1]));
                let (step_x, step_z) = (step[0] << l, step[1] << l);
                let cell_of = |axis: usize, line: i32| (line.wrapping_add(eye[axis]) >> l) - ahead[axis];
                loop {
                    let along_z = next_z < next_x;
                    let t1 = next_x.min(next_z).min(limit);
                    if t1 > t0 {
                        if VOXEL {
                            self.cell = [cell_of(0, line_x), cell_of(1, line_z)];
                        }
                        self.column(level, l, index as usize, t0, t1);
                        t0 = t1;
                        if self.closed() {
                            return;
                        }
                    }
                    if t0 >= limit {
                        break;
                    }
                    let z_only = -i32::from(along_z);
                    line_x = line_x.wrapping_add(step_x & !z_only);
                    line_z = line_z.wrapping_add(step_z & z_only);
                    if line_x == stop_x || line_z == stop_z {
                        break;
                    }
                    index += if along_z { steps[1] } else { steps[0] };
                    next_x = (R::from_i32(line_x) - within[0]) * inverse[0];
                    next_z = (R::from_i32(line_z) - within[1]) * inverse[1];
                }
                (x, z) = (cell_of(0, line_x), cell_of(1, line_z));
                cell = [x, z];
            }
            l += 1;
            cell = cell.map(|c| c >> 1);
        }
    }

    /// Equidistant traversal: one column a slice of the plane's longer axis, the one at the slice's middle. Returns the
    /// slice's end.
    #[expect(clippy::too_many_arguments, reason = "the walk's state")]
    #[inline(always)]
    fn slice(
        &mut self,
        level: &'a ResidentLevel,
        l: u32,
        t0: R,
        limit: R,
        cell: &mut [i32; 2],
        dir: [R; 2],
        cross: impl Fn(usize, i32) -> R,
    ) -> R {
        let (plane, setup) = (self.plane, self.setup);
        let major = usize::from(plane.dir[1].abs() > plane.dir[0].abs());
        let minor = 1 - major;
        let step = if plane.dir[major] < 0.0 { -1 } else { 1 };
        let t1 = cross(major, (cell[major] + i32::from(step > 0)) << l).min(limit).max(t0);
        let middle = (t0 + t1) * R::HALF;
        let along = R::from_f64(setup.eye_fract[2 * minor]) + middle * dir[minor];
        cell[minor] = along.floor_i32().wrapping_add(setup.eye_cell[2 * minor]) >> l;
        let (nx, nz) = (level.nx as i32, level.nz as i32);
        // A slice's middle can lie beside a world that the slice still touches.
        let inside = |axis: usize, n: i32| setup.repeats[axis] || (0..n).contains(&cell[axis]);
        if t1 > t0 && inside(0, nx) && inside(1, nz) {
            let index = level.index(cell[0].rem_euclid(nx) as u32, cell[1].rem_euclid(nz) as u32);
            self.cell = *cell;
            self.column_apart(level, l, index, t0, t1);
        }
        if t1 < limit {
            cell[major] += step;
        }
        t1
    }

    /// Once more [`Walk::column`], not inlined: the equidistant walk is rare, and the code long.
    #[inline(never)]
    fn column_apart(&mut self, level: &'a ResidentLevel, l: u32, column: usize, t0: R, t1: R) {
        self.column(level, l, column, t0, t1);
    }

    /// Looks at one column between `t0` and `t1`.
    #[inline(always)]
    fn column(&mut self, level: &'a ResidentLevel, l: u32, column: usize, t0: R, t1: R) {
        self.counters.columns_visited += 1;
        let [top, more] = level.entry(column);
        let top = Run(top);
        let h1 = self.height(top.end() << l);
        if h1 <= self.lowest(t0, t1) || top.0 == EMPTY {
            return;
        }
        let rest: &[u32] = match more as usize {
            0 => &[],
            at => &level.runs()[at + 1..at + 1 + level.runs()[at] as usize],
        };
        self.runs(level, l, column, top, rest, t0, t1);
    }

    /// Draws the runs of one column, from the top down `top` and `rest`: nearest to the eye's height first, since that is the order in which sight
    /// lines meet them. Down from the eye, then up from it.
    #[expect(clippy::too_many_arguments, reason = "what `column` knows already")]
    #[inline(always)]
    fn runs(&mut self, level: &'a ResidentLevel, l: u32, column: usize, top: Run, rest: &[u32], t0: R, t1: R) {
        let n = rest.len() + 1;
        let run = |k: usize| if k == 0 { top } else { Run(rest[k - 1]) };
        let first = |run: Run| (u32::from(run.first()) << l) as i32;
        let eye = self.eye_y;
        let (mut lo, mut hi) = (self.lowest(t0, t1), self.highest(t0, t1));
        // Of many runs, binary search for those that the window holds.
        const MANY: usize = 8;
        // How many runs, from the top down, start at `y` or above.
        let starting = |y: i32| if first(top) < y { 0 } else { 1 + rest.partition_point(|&r| first(Run(r)) >= y) };
        // Those from `over` on do not start above the eye.
        let mut over = 0;
        if n > MANY {
            over = starting(eye.saturating_add(1));
        } else {
            while over < n && first(run(over)) > eye {
                over += 1;
            }
        }
        let mut k = over;
        if n > MANY {
            k = k.max(starting(self.whole(lo, hi).1));
        }
        while k < n {
            self.counters.runs_visited += 1;
            let run = run(k);
            let h1 = self.height(run.end() << l);
            if h1 <= lo {
                break;
            }
            let h0 = self.height(u32::from(run.first()) << l);
            if h0 < hi && self.draw::<false>(level, l, t1, Drawn { run, k: k as u32, column, h0, h1, t0 }) {
                if self.closed() {
                    return;
                }
                lo = self.lowest(t0, t1);
            }
            k += 1;
        }
        if over == 0 {
            return;
        }
        hi = self.highest(t0, t1);
        let mut k = over;
        if n > MANY {
            let below = self.whole(lo, hi).0;
            k = k.min(1 + rest.partition_point(|&r| (Run(r).end() << l) as i32 > below));
        }
        while k > 0 {
            k -= 1;
            self.counters.runs_visited += 1;
            let run = run(k);
            let h0 = self.height(u32::from(run.first()) << l);
            if h0 >= hi {
                break;
            }
            let h1 = self.height(run.end() << l);
            if h1 > lo && self.draw::<true>(level, l, t1, Drawn { run, k: k as u32, column, h0, h1, t0 }) {
                if self.closed() {
                    return;
                }
                hi = self.highest(t0, t1);
            }
        }
    }

    /// Draws a run that starts above the eye (`UP`) or does not, and whose heights the window holds, unless it lies in the
    /// center segment; whether it drew.
    #[inline(always)]
    fn draw<const UP: bool>(&mut self, level: &'a ResidentLevel, l: u32, t1: R, d: Drawn<R>) -> bool {
        let Drawn { h0, h1, t0, .. } = d;
        // Slopes of the run's ends: its highest and its lowest place in the window. Of what starts above the eye both are
        // above it, and it shows no top; of what does not, no bottom.
        if (FAST || self.culling.center)
            && self.center[1] > self.center[0]
            && h1 <= self.s_center[1] * if !UP && h1 < R::ZERO { t1 } else { t0 }
            && h0 >= self.s_center[0] * if UP { t1 } else { t0 }
        {
            return false;
        }
        // At the eye's own height any distance has slope 0, but for 0, where an eye on a run's face would see nothing of it.
        let (t_foot, t_top) = (if UP || h0 == R::ZERO { t1 } else { t0 }, if !UP && h1 <= R::ZERO { t1 } else { t0 });
        let j0 = self.sample(t_foot, h0);
        let j1 = self.sample_above(t_top, h1);
        if j0 >= j1 {
            return false;
        }
        self.counters.spans_drawn += 1;
        let f0 = if UP && h0 > R::ZERO { self.sample(t0, h0).max(j0).min(j1) } else { j0 };
        let f1 = if !UP && h1 < R::ZERO { self.sample(t0, h1).max(j0).min(j1) } else { j1 };
        // The common case: a span at an end of the window, beyond all that was drawn within it, just moves the end.
        if FAST && (j1 <= self.hull[0] || j0 >= self.hull[1]) && (j0 == self.lo || j1 == self.hi) {
            if !self.emit_short::<UP>(level, l, d, j0, if UP { f0 } else { f1 }, j1) {
                self.emit_faces::<UP>(level, l, d, [j0, f0, f1, j1]);
            }
            if j0 == self.lo {
                self.lo = j1;
                if j1 == self.hull[0] {
                    self.lo = self.first_open(j1);
                }
                self.s_lo = self.below(self.lo);
            } else {
                self.hi = j0;
                if j0 == self.hull[1] {
                    self.hi = self.last_open(j0) + 1;
                }
                self.s_hi = self.above(self.hi);
            }
            return true;
        }
        self.hull = [self.hull[0].min(j0), self.hull[1].max(j1)];
        if UP && j0 < f0 {
            self.fill(level, l, Face::Bottom, d, j0, f0);
        }
        if f0 < f1 {
            self.fill(level, l, Face::Front, d, f0, f1);
        }
        if !UP && f1 < j1 {
            self.fill(level, l, Face::Top, d, f1, j1);
        }
        self.cull(j0, j1);
        true
    }

    /// Writes a span at an end of the window whose faces have at most [`LANES`] samples each, in whole lanes: what is written
    /// beyond the span is open, not drawn yet, and will be. So there are no loops whose ends nobody can foretell. Below
    /// sample `turn` lies the front of a run that does not start above the eye, and its top from there on; of one that does
    /// (`UP`), the bottom, and its front from there on. `false` where it did nothing, for want of room.
    #[inline(always)]
    fn emit_short<const UP: bool>(
        &mut self,
        level: &ResidentLevel,
        l: u32,
        d: Drawn<R>,
        j0: i32,
        turn: i32,
        j1: i32,
    ) -> bool {
        const N: i32 = LANES as i32;
        if turn - j0 > N || j1 - turn > N {
            return false;
        }
        if j0 == self.lo {
            if turn + N > self.hull[0].min(self.hi) {
                return false;
            }
            if j0 < turn {
                self.emit_lanes::<UP>(level, l, !UP, d, j0 as usize);
            }
            if turn < j1 {
                self.emit_lanes::<UP>(level, l, UP, d, turn as usize);
            }
        } else {
            if turn - N < self.hull[1].max(self.lo) {
                return false;
            }
            if turn < j1 {
                self.emit_lanes::<UP>(level, l, UP, d, (j1 - N) as usize);
            }
            if j0 < turn {
                self.emit_lanes::<UP>(level, l, !UP, d, (turn - N) as usize);
            }
        }
        true
    }

    /// Writes one face to [`LANES`] samples from `from` on: the front, or the bottom (`UP`) or top.
    #[inline(always)]
    fn emit_lanes<const UP: bool>(&mut self, level: &ResidentLevel, l: u32, front: bool, d: Drawn<R>, from: usize) {
        let lanes = from..from + LANES;
        let (first, last) = (u32::from(d.run.first()), u32::from(d.run.last()));
        let Sight { depth_t, slope, depth_h } = &*self.sight;
        if !front {
            let (h, y) = if UP { (d.h0, first) } else { (d.h1, last) };
            let up = h.abs();
            self.depth[lanes.clone()].copy_from_slice(&scaled(up, &depth_h[lanes.clone()]));
            if VOXEL {
                self.voxel[lanes.clone()].fill([self.cell[0], y as i32, self.cell[1], l as i32]);
            }
            if COLOR {
                self.color[lanes].fill(level.color(d.column, d.k, y));
            }
            return;
        }
        self.depth[lanes.clone()].copy_from_slice(&scaled(d.t0, &depth_t[lanes.clone()]));
        let voxel_paint =
            COLOR && matches!(level.paint, Paint::Voxel { .. } | Paint::Top { .. } | Paint::Height { .. });
        let mut ys = [0; LANES];
        if VOXEL || voxel_paint {
            let highest = R::from_i32(((last - first + 1) << l) as i32 - 1);
            for (y, &slope) in ys.iter_mut().zip(&slope[lanes.clone()]) {
                *y = first + (((slope * d.t0 - d.h0).truncate(highest) as u32) >> l);
            }
        }
        if VOXEL {
            for (v, &y) in self.voxel[lanes.clone()].iter_mut().zip(&ys) {
                *v = [self.cell[0], y as i32, self.cell[1], l as i32];
            }
        }
        if !COLOR {
            return;
        }
        let color = &mut self.color[lanes];
        if let Paint::Height { colors } = &level.paint {
            color.iter_mut().zip(ys).for_each(|(c, y)| *c = colors[y as usize]);
            return;
        }
        if let Paint::Top { starts, colors } = &level.paint {
            let (own, hidden) = level.own_colors(starts, colors, d.column);
            color.iter_mut().zip(ys).for_each(|(c, y)| *c = own[y.saturating_sub(hidden) as usize]);
            return;
        }
        let Paint::Voxel { base, exposed, colors } = &level.paint else {
            color.fill(level.color(d.column, d.k, first));
            return;
        };
        let exposed = level.exposed(base, exposed, d.column);
        // Mostly all lie in one exposed run.
        let mut paint = Exposed::default();
        paint.find(exposed, if UP { first } else { last });
        let own = &colors[paint.start as usize..(paint.start + paint.end - paint.first) as usize];
        if ys.iter().all(|y| y.wrapping_sub(paint.first) < own.len() as u32) {
            for (c, y) in color.iter_mut().zip(ys) {
                *c = own[(y - paint.first) as usize];
            }
        } else {
            for (c, y) in color.iter_mut().zip(ys) {
                *c = colors[paint.find(exposed, y)];
            }
        }
    }

    /// Writes the faces of a span between samples `j0 <= f0 <= f1 <= j1`: bottom, front and top.
    #[inline(always)]
    fn emit_faces<const UP: bool>(&mut self, level: &ResidentLevel, l: u32, d: Drawn<R>, at: [i32; 4]) {
        let [j0, f0, f1, j1] = at.map(|j| j as usize);
        if UP && j0 < f0 {
            self.emit(level, l, Face::Bottom, d, j0, f0);
        }
        if f0 < f1 {
            self.emit(level, l, Face::Front, d, f0, f1);
        }
        if !UP && f1 < j1 {
            self.emit(level, l, Face::Top, d, f1, j1);
        }
    }

    /// Draws one face into the unfilled samples of `from .. to`.
    #[inline(always)]
    fn fill(&mut self, level: &'a ResidentLevel, l: u32, face: Face, d: Drawn<R>, from: i32, to: i32) {
        if FAST || (self.culling.bits && self.culling.forward) {
            let (from, to) = (from as usize, to as usize);
            for w in from / 64..=(to - 1) / 64 {
                let mask = low_bits((to - 64 * w).min(64)) & !low_bits(from.saturating_sub(64 * w).min(64));
                let mut open = self.open[w] & mask;
                if open == 0 {
                    continue;
                }
                self.open[w] &= !mask;
                if !FAST {
                    self.left -= open.count_ones() as i32;
                }
                while open != 0 {
                    let start = open.trailing_zeros() as usize;
                    let n = (!(open >> start)).trailing_zeros() as usize;
                    self.emit(level, l, face, d, 64 * w + start, 64 * w + start + n);
                    open &= !low_bits(start + n);
                }
            }
            return;
        }
        let mut j = from as usize;
        while j < to as usize {
            if self.is_open(j) {
                self.open[j / 64] &= !(1 << (j % 64));
                self.skip[j] = j as u32 + 1;
                self.left -= 1;
                self.emit(level, l, face, d, j, j + 1);
                j += 1;
            } else if self.culling.forward {
                j = self.next_open(j);
            } else {
                j += 1;
            }
        }
    }

    #[inline(always)]
    fn is_open(&self, j: usize) -> bool {
        if FAST || self.culling.bits { self.open[j / 64] >> (j % 64) & 1 == 1 } else { self.depth[j] == f32::INFINITY }
    }

    /// The first unfilled sample from the filled sample `j` on: shear-warp's forwarding, with paths shortened on the way.
    #[inline(always)]
    fn next_open(&mut self, j: usize) -> usize {
        let mut end = j;
        while self.skip[end] as usize != end {
            end = self.skip[end] as usize;
        }
        let mut at = j;
        while at != end {
            at = std::mem::replace(&mut self.skip[at], end as u32) as usize;
        }
        end
    }

    /// Writes samples `from .. to`, all unfilled until now.
    #[inline(always)]
    fn emit(&mut self, level: &ResidentLevel, l: u32, face: Face, d: Drawn<R>, from: usize, to: usize) {
        let (first, last) = (u32::from(d.run.first()), u32::from(d.run.last()));
        let depth = &mut self.depth[from..to];
        let color = if COLOR { &mut self.color[from..to] } else { &mut [][..] };
        if let Face::Front = face {
            let (depth_t, slope) = (&self.sight.depth_t[from..to], &self.sight.slope[from..to]);
            // How far above the run's foot each sight line meets it, in voxels of level 0.
            let top = R::from_i32(((last - first + 1) << l) as i32 - 1);
            let y = |&slope: &R| first + (((slope * d.t0 - d.h0).truncate(top) as u32) >> l);
            // Most spans are short: for them a loop over vectors costs more than it saves.
            if to - from < 16
                && COLOR
                && let Paint::Voxel { base, exposed, colors } = &level.paint
            {
                let exposed = level.exposed(base, exposed, d.column);
                let mut paint = Exposed::default();
                for (((c, z), sight), slope) in color.iter_mut().zip(depth).zip(depth_t).zip(slope) {
                    *z = (d.t0 * *sight).to_f32();
                    *c = colors[paint.find(exposed, y(slope))];
                }
                if VOXEL {
                    for (v, s) in self.voxel[from..to].iter_mut().zip(slope) {
                        *v = [self.cell[0], y(s) as i32, self.cell[1], l as i32];
                    }
                }
                return;
            }
            for (z, &s) in depth.iter_mut().zip(depth_t) {
                *z = (d.t0 * s).to_f32();
            }
            match &level.paint {
                _ if !COLOR => {}
                Paint::None => color.fill(UNPAINTED),
                Paint::Column { colors } => color.fill(colors[d.column]),
                Paint::Height { colors } => {
                    color.iter_mut().zip(slope).for_each(|(c, s)| *c = colors[y(s) as usize]);
                }
                Paint::Run { base, colors } => color.fill(colors[(base[d.column] + d.k) as usize]),
                Paint::Top { starts, colors } => {
                    let (own, hidden) = level.own_colors(starts, colors, d.column);
                    color.iter_mut().zip(slope).for_each(|(c, s)| *c = own[y(s).saturating_sub(hidden) as usize]);
                }
                Paint::Voxel { base, exposed, colors } => {
                    let exposed = level.exposed(base, exposed, d.column);
                    let mut paint = Exposed::default();
                    for (c, s) in color.iter_mut().zip(slope) {
                        *c = colors[paint.find(exposed, y(s))];
                    }
                }
            }
            if VOXEL {
                for (v, s) in self.voxel[from..to].iter_mut().zip(slope) {
                    *v = [self.cell[0], y(s) as i32, self.cell[1], l as i32];
                }
            }
        } else {
            let (h, y) = if let Face::Top = face { (d.h1, last) } else { (d.h0, first) };
            let up = h.abs();
            for (z, &s) in depth.iter_mut().zip(&self.sight.depth_h[from..to]) {
                *z = (up * s).to_f32();
            }
            if COLOR {
                color.fill(level.color(d.column, d.k, y));
            }
            if VOXEL {
                self.voxel[from..to].fill([self.cell[0], y as i32, self.cell[1], l as i32]);
            }
        }
    }

    /// Takes note that samples `j0 .. j1` are filled.
    #[inline(always)]
    fn cull(&mut self, j0: i32, j1: i32) {
        if FAST || self.culling.horizon {
            if j0 <= self.lo {
                self.lo = self.first_open(j1);
                self.s_lo = self.below(self.lo);
            }
            if j1 >= self.hi && self.lo < self.hi {
                self.hi = self.last_open(j0) + 1;
                self.s_hi = self.above(self.hi);
            }
        }
        if (FAST || self.culling.center) && j0 > self.lo && j1 < self.hi {
            let [from, to] = self.center;
            let merged = if j0 <= to && j1 >= from && to > from { [from.min(j0), to.max(j1)] } else { [j0, j1] };
            if merged[1] - merged[0] > to - from {
                self.center = merged;
                self.s_center = [self.above(merged[0]), self.below(merged[1])];
            }
        }
    }

    /// The first unfilled sample from `j` on, `hi` if there is none.
    #[inline(always)]
    fn first_open(&mut self, j: i32) -> i32 {
        let mut j = j;
        if FAST || self.culling.bits {
            while j < self.hi {
                let w = j as usize / 64;
                let open = self.open[w] & !low_bits(j as usize % 64);
                if open != 0 {
                    return (64 * w as i32 + open.trailing_zeros() as i32).min(self.hi);
                }
                j = 64 * (w as i32 + 1);
            }
            return self.hi;
        }
        while j < self.hi && !self.is_open(j as usize) {
            j += 1;
        }
        j
    }

    /// The last unfilled sample before `j`, `lo − 1` if there is none.
    #[inline(always)]
    fn last_open(&mut self, j: i32) -> i32 {
        let mut j = j - 1;
        if FAST || self.culling.bits {
            while j >= self.lo {
                let w = j as usize / 64;
                let open = self.open[w] & low_bits(j as usize % 64 + 1);
                if open != 0 {
                    return (64 * w as i32 + 63 - open.leading_zeros() as i32).max(self.lo - 1);
                }
                j = 64 * w as i32 - 1;
            }
            return self.lo - 1;
        }
        while j >= self.lo && !self.is_open(j as usize) {
            j -= 1;
        }
        j
    }

    /// What is still unfilled shows the sky.
    #[inline(always)]
    fn finish(self) -> Counters {
        let (lo, hi) = (self.lo.min(self.hi) as usize, self.hi as usize);
        for (w, &open) in self.open.iter().enumerate() {
            // Bits outside the window are out of date: the window's ends moved over those samples because they are filled.
            let mut open =
                open & low_bits(hi.saturating_sub(64 * w).min(64)) & !low_bits(lo.saturating_sub(64 * w).min(64));
            while open != 0 {
                let j = 64 * w + open.trailing_zeros() as usize;
                if COLOR {
                    self.color[j] = 0;
                }
                self.depth[j] = f32::INFINITY;
                if VOXEL {
                    self.voxel[j] = SKY;
                }
                open &= open - 1;
            }
        }
        self.counters
    }
}

/// The exposed run that was looked up last: neighbouring samples mostly share it.
#[derive(Default)]
struct Exposed {
    first: u32,
    /// One past the last voxel.
    end: u32,
    start: u32,
}

impl Exposed {
    /// Where the colour of voxel `y` stands; a column that is drawn has an exposed run.
    #[inline(always)]
    fn find(&mut self, column: &[[u32; 2]], y: u32) -> usize {
        if y.wrapping_sub(self.first) >= self.end - self.first {
            let [run, start] = column[nearest_exposed(column, y)];
            let run = Run(run);
            (self.first, self.end, self.start) = (u32::from(run.first()), run.end(), start);
            let y = y.clamp(self.first, self.end - 1);
            return (self.start + y - self.first) as usize;
        }
        (self.start + y - self.first) as usize
    }
}

/// `by` times each of [`LANES`] numbers. Through an array of its own: where they are written could be where they are read,
/// as far as a compiler knows, and one after the other they would cost four times as much.
#[inline(always)]
fn scaled<R: Real>(by: R, lanes: &[R]) -> [f32; LANES] {
    let mut scaled = [0.0; LANES];
    for (z, &s) in scaled.iter_mut().zip(&lanes[..LANES]) {
        *z = (by * s).to_f32();
    }
    scaled
}

/// The lowest `n` bits, 0 to 64.
#[inline(always)]
fn low_bits(n: usize) -> u64 {
    if n >= 64 { !0 } else { (1 << n) - 1 }
}

#[cfg(test)]
mod tests {
    use super::has_avx2;
    use crate::{Camera, CpuRenderer, Feature, Features, Frame, Options, Outputs, Remap, Resident};
    use glam::DVec3;
    use planecast_encoder::format::features::Named;
    use planecast_encoder::{BuildOptions, Colors, Columns, Input, build};
    use std::cell::Cell;

    thread_local! {
        /// Whether frames that this thread asks for are drawn as on a processor without AVX2.
        pub static WITHOUT_AVX2: Cell<bool> = const { Cell::new(false) };
    }

    /// What must be the same: work, picture, depth as bits, voxels.
    type Drawn = ([u64; 3], Vec<[u8; 4]>, Vec<u32>, Vec<[i32; 4]>);

    fn drawn(frame: Frame) -> Drawn {
        let stats = &frame.stats;
        let work = [stats.columns_visited, stats.runs_visited, stats.spans_drawn];
        (work, frame.color, frame.depth.iter().map(|z| z.to_bits()).collect(), frame.voxel)
    }

    /// One with AVX2 runs code of its own, so that there no other test sees what one without runs.
    #[test]
    fn processors_with_avx2_and_without_draw_the_same_bits() {
        if !has_avx2() {
            println!("nothing compared: this processor has no AVX2");
            return;
        }
        let hills = |x: u32, z: u32| 5 + (x * x + 3 * z) % 11 + if (x / 7 + z / 5).is_multiple_of(4) { 9 } else { 0 };
        let ground = Columns::from_fn(96, 40, 80, |x, y, z| y < hills(x, z));
        let caves = Columns::from_fn(64, 40, 64, |x, y, z| y < hills(x, z) && (x + 2 * y + z) % 11 > 1);
        let mut over_ground = [0, 0];
        for columns in [ground, caves] {
            let colors = Colors::Function(Box::new(|x, y, z| [x as u8 * 2, y as u8 * 5, z as u8 * 3]));
            let built = build(Input { columns, colors, notes: Vec::new() }, &BuildOptions::default()).unwrap();
            let scene = std::sync::Arc::new(built);
            let resident = std::sync::Arc::new(Resident::new(&scene));
            let mut renderer = CpuRenderer::new(&scene, &resident);
            let mut draw = |without, camera: &Camera, options: &Options, outputs| {
                WITHOUT_AVX2.set(without);
                assert_eq!(has_avx2(), !without);
                let frame = renderer.render(camera, options, outputs).unwrap();
                WITHOUT_AVX2.set(false);
                frame
            };
            for (eye, pitch, roll) in [([40.3, 27.2, 30.4], -8.0, 0.0), ([20.0, 90.0, 21.5], -60.0, 20.0)] {
                let camera =
                    Camera { eye: DVec3::from(eye), yaw: 33.0, pitch, roll, fov: 75.0, width: 117, height: 90 };
                let turned = Camera { yaw: camera.yaw + 0.01, ..camera };
                let [one, other] =
                    [camera, turned].map(|camera| drawn(draw(false, &camera, &Options::default(), Outputs::default())));
                assert!(one != other, "the comparison sees a hundredth of a degree");
                for (remap, f64_traversal, specialize, voxel) in Remap::ALL.into_iter().flat_map(|remap| {
                    [
                        (remap, false, Features::ALL, false),
                        (remap, false, Features::NONE, true),
                        (remap, true, Features::ALL, true),
                    ]
                }) {
                    let options = Options { remap, f64_traversal, specialize, ..Options::default() };
                    let outputs = Outputs { voxel };
                    let [with, without] = [false, true].map(|without| draw(without, &camera, &options, outputs));
                    let left_out = with.stats.left_out.iter().any(|f| f.starts_with(Feature::Horizon.name()));
                    over_ground[usize::from(left_out)] += 1;
                    let (with, without) = (drawn(with), drawn(without));
                    assert!(with.0[2] > 100, "spans drawn: {:?}", with.0);
                    assert!(with == without, "{camera:?} {options:?}");
                }
            }
        }
        assert!(over_ground[0] > 0 && over_ground[1] > 0, "both walks were met: {over_ground:?}");
    }
}
