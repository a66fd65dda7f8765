//! Stage `plane_setup`: from a camera to the planes that are cast.
//!
//! A plane holds the eye's vertical axis and one azimuth. Its points are `eye + t·d + h·up` with `d` horizontal and
//! of length 1, `t ≥ 0`. All planes meet the screen in lines through the *vanishing point* of the vertical. Around it
//! stand up to four *fans*, one towards each screen edge, split at 45°; within a fan the planes are spaced along the
//! fan's far edge, and a plane's *samples* are one pixel apart along the axis that its line follows most.
//! (Forstmann & Ohya 2009 §3.2; deviates: fans are split at 45° and not at the screen's corners, so that samples are
//! never more than √2 pixels apart and a level view has exactly one plane a pixel column.)
//!
//! On the line of a plane the place of a point is `u = (A·t + B·h) / (C·t + E·h)`, in samples: sample `j` has its
//! centre at `j + ½`. `u` grows with the slope `h/t` (samples are numbered so). The direction through place `u` is
//! `(t, h) ∝ (B − u·E, u·C − A)`, which has depth `Δ = B·C − A·E > 0`.
//!
//! Everything here is computed once a frame in f64 and handed to every kernel as the same numbers.

pub mod sphere;

use crate::frame::camera::{Basis, Camera};
use crate::frame::options::{Options, Planes, Remap};
use crate::world::tables::Resident;
use glam::DVec3;
use rayon::prelude::*;

/// View distance of a repeated world if none is given, in voxels (the paper's).
pub const REPEATED_VIEW_DISTANCE: f64 = 40_000.0;

/// A repeated world is drawn this far at most, in voxels: column numbers are i32, and crossings beyond no longer tell
/// columns apart.
pub const FARTHEST_VIEW: f64 = 1e9;

/// The eye may stand this far from the origin along an axis that does not repeat, and above or below the world.
pub const EYE_LIMIT: f64 = (1 << 30) as f64;

/// The greatest f32 below 1.
const BELOW_ONE: f64 = 1.0 - f32::EPSILON as f64 / 2.0;

/// Everything about a frame that all its planes share.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    pub planes: Vec<Plane>,
    /// Up, down, left, right.
    pub fans: [Fan; 4],
    /// The vanishing point in pixels, homogeneous `(x, y, w)`, `w ≥ 0`.
    pub vanishing: [f64; 3],
    /// How many planes a spacing of one pixel along each far edge takes.
    pub planes_full: u32,
    /// Samples of all planes together: the plane buffer's length.
    pub samples: usize,
    /// Planes that the buffer has from earlier frames and that are not walked; empty: none.
    pub done: Vec<bool>,
    /// The voxel of level 0 that holds the eye; along a repeated axis in the first period.
    pub eye_cell: [i32; 3],
    /// The eye's place in that voxel, 0 ≤ · < 1, as an f32 too: nearer to the voxel's end it would stand in the next one.
    pub eye_fract: [f64; 3],
    /// What was taken off x and z to bring the eye into the first period.
    pub period_offset: [i64; 2],
    /// Which of x and z repeat.
    pub repeats: [bool; 2],
    /// Levels that may be drawn.
    pub levels: u32,
    /// See [`Options::equidistant`].
    pub equidistant: f64,
    /// See [`Options::view_distance`]; finite where the world repeats.
    pub view_distance: f64,
}

/// Planes, rows or columns that a thread works out at a time: fewer are not worth the handing over.
pub(crate) const AT_ONCE: usize = 256;

/// Planes towards one screen edge.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Fan {
    pub first_plane: u32,
    pub n_planes: u32,
    /// Pixels along a plane: the image's height for up and down, its width for left and right.
    pub pixels: u32,
    /// Samples a plane, evenly along those pixels: as many, unless [`Options::samples`] asks for others.
    pub n_samples: u32,
    /// Start of the fan in the plane buffer.
    pub first_sample: usize,
    /// Samples count against the pixel axis.
    pub flip: bool,
    /// The far edge: y or x, in pixels, of the centres of the outermost row or column.
    pub far: f64,
    /// Where the first plane's stripe begins on the far edge, in pixels along it.
    pub start: f64,
    /// Width of a plane's stripe on the far edge, in pixels; where readjusted, in stripes as the readjustment made them.
    pub spacing: f64,
    /// Which plane is nearest where the stripes are not all of one width; see [`Readjusted`].
    pub readjusted: Option<Readjusted>,
}

/// The paper's readjusted spacing (Fig. 4) as a map from the far edge to plane numbers. Planes crowd towards the
/// vanishing point and towards a fan's corners; equal mean distance over what a plane covers needs fewer of them. With
/// `q` the tangent of a plane's angle to its fan's axis, plane `k` stands where `crowd(q) = start + (k + ½)·step`.
/// Even distances measured across the planes ask for `asinh q`; [`crowd`] is within 0.02 of it and costs one division.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Readjusted {
    /// The vanishing point's place along the far edge, and its distance from it, in pixels.
    pub centre: f64,
    pub distance: f64,
    pub start: f64,
    pub step: f64,
}

/// One plane. `t`: horizontal distance from the eye; `h`: height above the eye; both in voxels of level 0.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Plane {
    /// Azimuth, of length 1.
    pub dir: [f64; 2],
    /// See the module's doc.
    pub a: f64,
    pub b: f64,
    pub c: f64,
    pub e: f64,
    /// Samples that pixels can ask for: `first .. end`.
    pub first: u32,
    pub end: u32,
    /// Where the plane's samples stand in the plane buffer.
    pub base: usize,
    /// The part of the plane that lies in the world and the view: `t_start .. t_end`, empty where equal.
    pub t_start: f64,
    pub t_end: f64,
    /// The column of level 0 at `t_start`.
    pub cell: [i32; 2],
    /// Level `k` may be drawn from `t = lod_t · 2^k` on, and those up to `lod_first` from the start.
    pub lod_t: f64,
    pub lod_first: u32,
}

/// `q / (1 + α·|q|)`, with α such that it equals `asinh q` at 0 and ±1, the ends of a fan.
#[inline(always)]
pub fn crowd(q: f64) -> f64 {
    q / (1.0 + CROWD * q.abs())
}

/// The inverse of [`crowd`].
pub fn uncrowd(v: f64) -> f64 {
    v / (1.0 - CROWD * v.abs())
}

/// `1 / asinh 1 − 1`.
const CROWD: f64 = 0.134_592_657_106_511_03;

pub const UP: usize = 0;
pub const DOWN: usize = 1;
pub const LEFT: usize = 2;
pub const RIGHT: usize = 3;

/// Whether fan `f`'s planes run along pixel columns.
pub const fn vertical(f: usize) -> bool {
    f == UP || f == DOWN
}

/// Planes and fans of one frame. The eye must be within [`EYE_LIMIT`] along axes that do not repeat.
pub fn plane_setup(resident: &Resident, camera: &Camera, options: &Options) -> Setup {
    plane_setup_in(Vec::new(), resident, camera, options)
}

/// The same, in the memory of planes that are done with.
pub(crate) fn plane_setup_in(mut planes: Vec<Plane>, resident: &Resident, camera: &Camera, options: &Options) -> Setup {
    let basis = camera.basis();
    let (w, h) = (f64::from(camera.width), f64::from(camera.height));
    let focal = camera.focal();

    // Image of ±V: direction of the vertical in camera axes, projected.
    let v = [basis.right.y, basis.up.y, basis.forward.y];
    let mut vanishing = [w / 2.0 * v[2] + focal * v[0], h / 2.0 * v[2] - focal * v[1], v[2]];
    if vanishing[2] < 0.0 {
        vanishing = vanishing.map(|x| -x);
    }

    let mut fans = [Fan::default(); 4];
    let mut widths = [None; 4];
    for f in 0..4 {
        // Where pixels have their centres: planes that run diagonally, as of a level camera rolled by 45°, then pass through
        // those of all pixels, and else half-way between them.
        let far = [0.5, h - 0.5, 0.5, w - 0.5][f];
        fans[f].far = far;
        let pixels = if vertical(f) { camera.height } else { camera.width };
        fans[f].pixels = pixels;
        fans[f].n_samples = ((f64::from(pixels) * options.samples).round() as u32).max(1);
        fans[f].spacing = 1.0;
        widths[f] = fan_extent(f, far, vanishing, w, h);
    }
    let full = |e: Option<(f64, f64)>| e.map_or(0, |(lo, hi)| ((hi.ceil() - lo.floor()) as u32).max(1));
    let planes_full: u32 = widths.iter().map(|&e| full(e)).sum();

    // How many planes each fan gets, and where on the far edge they stand.
    for f in 0..4 {
        let Some((lo, hi)) = widths[f] else { continue };
        let fan = &mut fans[f];
        fan.start = lo.floor();
        fan.n_planes = full(widths[f]);
        if options.readjust {
            readjust(fan, f, vanishing, (lo, hi), w, h);
        }
    }
    let cast: u32 = fans.iter().map(|f| f.n_planes).sum();
    let wanted = match options.planes {
        Planes::Auto => cast,
        Planes::Factor(factor) => (f64::from(cast) * factor).round().clamp(1.0, 1e6) as u32,
        Planes::Count(n) => n,
    };
    if wanted != cast {
        share_planes(&mut fans, &widths, wanted, cast);
    }

    planes.clear();
    planes.reserve(fans.iter().map(|f| f.n_planes as usize).sum());
    let world = World::new(resident, camera, options);
    let mut samples = 0;
    for (f, fan) in fans.iter_mut().enumerate() {
        fan.first_plane = planes.len() as u32;
        fan.first_sample = samples;
        let flips = |plane: &Plane| plane.b * plane.c - plane.a * plane.e < 0.0;
        let plane = |k: u32| {
            let mut fan = *fan;
            let (at, stripe) = fan.place(k);
            let mut plane = line(f, at, fan.far, camera, &basis);
            fan.flip = flips(&plane);
            let n = f64::from(fan.n_samples);
            let per_pixel = n / f64::from(fan.pixels);
            (plane.a, plane.b) = (plane.a * per_pixel, plane.b * per_pixel);
            if fan.flip {
                (plane.a, plane.b) = (n * plane.c - plane.a, n * plane.e - plane.b);
            }
            (plane.first, plane.end) = window(f, at, stripe, &fan, vanishing, w, h);
            plane.base = samples + k as usize * fan.n_samples as usize;
            world.clip(&mut plane);
            world.choose_levels(&mut plane, focal, options.lod);
            plane
        };
        planes.par_extend((0..fan.n_planes).into_par_iter().with_min_len(AT_ONCE).map(plane));
        samples += fan.n_planes as usize * fan.n_samples as usize;
        if let Some(last) = fan.n_planes.checked_sub(1) {
            fan.flip = flips(&line(f, fan.place(last).0, fan.far, camera, &basis));
        }
    }
    Setup {
        planes,
        fans,
        vanishing,
        planes_full,
        samples,
        done: Vec::new(),
        eye_cell: world.eye_cell,
        eye_fract: world.eye_fract,
        period_offset: world.period_offset,
        repeats: [options.repeat.x, options.repeat.z],
        levels: world.levels,
        equidistant: options.equidistant.unwrap_or(f64::INFINITY),
        view_distance: world.view_distance,
    }
}

impl Setup {
    /// Between which distances the walk of `plane` is at level `l`; nowhere where the second is not beyond the first.
    pub fn part(&self, plane: &Plane, l: u32) -> [f64; 2] {
        let begin = |l: u32| if l > plane.lod_first { plane.lod_t * f64::from(1u32 << l) } else { plane.t_start };
        let to = if l + 1 < self.levels { begin(l + 1).min(plane.t_end) } else { plane.t_end };
        [begin(l).max(plane.t_start), to]
    }

    /// At most so many columns the walk of `plane` looks at. Of level `l` it walks the part between the distances where that
    /// level begins and ends. A part of length `T` crosses at most `⌈T·|x| / 2ˡ⌉` grid planes along x and as many along z,
    /// and looks at one column more than it crosses; the ends can be cut in two by a change of level or a rounding. So a
    /// walk ends, however its numbers round.
    pub fn step_bound(&self, plane: &Plane) -> u64 {
        let steps = |l: u32| {
            let [from, to] = self.part(plane, l);
            let crossed = |d: f64| ((to - from) * d.abs() / f64::from(1u32 << l)).ceil() as u64;
            if to > from { crossed(plane.dir[0]) + crossed(plane.dir[1]) + 6 } else { 0 }
        };
        (plane.lod_first..self.levels).map(steps).sum()
    }

    /// Whether fewer planes were asked for than reach every pixel, so that there are gaps to fill.
    pub fn is_sparse(&self) -> bool {
        self.fans.iter().any(|f| f.n_planes > 0 && f.spacing > 1.0)
    }

    /// Whether pixels test samples against their own rays: not where planes are pixel columns, whose samples are those rays,
    /// nor where holes are to be left open.
    pub fn retests(&self, camera: &Camera, options: &Options) -> bool {
        options.remap != Remap::Nearest && !self.is_pixel_columns(camera) && (!self.is_sparse() || options.gap_fill)
    }

    /// Whether pixels whose samples disagree walk their own rays: where they test samples, and any shows level 0.
    pub fn refines(&self, camera: &Camera, options: &Options) -> bool {
        let finest = self.planes.iter().any(|plane| plane.lod_first == 0);
        options.remap == Remap::Refine && self.retests(camera, options) && finest
    }

    /// Whether each pixel column is a plane and each pixel its sample (a level, upright camera).
    pub fn is_pixel_columns(&self, camera: &Camera) -> bool {
        let fan = &self.fans[if self.fans[UP].n_planes > 0 { UP } else { DOWN }];
        self.vanishing[2] == 0.0
            && self.planes.len() == camera.width as usize
            && fan.n_planes == camera.width
            && fan.spacing == 1.0
            && fan.n_samples == fan.pixels
            && camera.roll.rem_euclid(180.0) == 0.0
    }
}

/// Range of places on the far edge that a fan's pixel centres project to from the vanishing point; `None` where no
/// pixel lies in the fan.
fn fan_extent(f: usize, far: f64, vanishing: [f64; 3], w: f64, h: f64) -> Option<(f64, f64)> {
    let [vx, vy, vw] = vanishing;
    // Distances towards the fan's edge (main) and across (side), times w: both linear in the pixel.
    let towards = |x: f64, y: f64| -> (f64, f64) {
        let (dx, dy) = (vx - x * vw, vy - y * vw);
        match f {
            UP => (dy, dx),
            DOWN => (-dy, dx),
            LEFT => (dx, dy),
            _ => (-dx, dy),
        }
    };
    let mut polygon = vec![(0.5, 0.5), (w - 0.5, 0.5), (w - 0.5, h - 0.5), (0.5, h - 0.5)];
    for sign in [1.0, -1.0] {
        let side = |p: (f64, f64)| {
            let (main, side) = towards(p.0, p.1);
            main - sign * side
        };
        let mut clipped = Vec::with_capacity(8);
        for i in 0..polygon.len() {
            let (p, q) = (polygon[i], polygon[(i + 1) % polygon.len()]);
            let (gp, gq) = (side(p), side(q));
            if gp >= 0.0 {
                clipped.push(p);
            }
            if (gp >= 0.0) != (gq >= 0.0) {
                let k = gp / (gp - gq);
                clipped.push((p.0 + k * (q.0 - p.0), p.1 + k * (q.1 - p.1)));
            }
        }
        polygon = clipped;
    }
    let mut extent: Option<(f64, f64)> = None;
    for (x, y) in polygon {
        let (main, side) = towards(x, y);
        let along = if vertical(f) { x } else { y };
        // A corner that is the vanishing point itself belongs to every azimuth; the other corners span them.
        let at = if main > 0.0 {
            let across = if vertical(f) { far - y } else { far - x };
            let slope = if f == UP || f == LEFT { side / main } else { -side / main };
            along + across * slope.clamp(-1.0, 1.0)
        } else {
            along
        };
        extent = Some(extent.map_or((at, at), |(lo, hi)| (lo.min(at), hi.max(at))));
    }
    extent
}

/// Spreads `wanted` planes over the fans in the ratio in which `cast` planes were spread, at least one each.
fn share_planes(fans: &mut [Fan; 4], extents: &[Option<(f64, f64)>; 4], wanted: u32, cast: u32) {
    let mut fans_left = fans.iter().filter(|f| f.n_planes > 0).count() as u32;
    let (mut left, mut from) = (wanted.max(fans_left), cast);
    for (fan, extent) in fans.iter_mut().zip(extents) {
        let Some((lo, hi)) = *extent else { continue };
        fans_left -= 1;
        let share = (f64::from(left) * f64::from(fan.n_planes) / f64::from(from)).round() as u32;
        let share = share.clamp(1, left - fans_left);
        from -= fan.n_planes;
        left -= share;
        match &mut fan.readjusted {
            Some(r) => {
                fan.spacing = f64::from(fan.n_planes) / f64::from(share);
                r.step *= fan.spacing;
            }
            None => {
                fan.start = (lo - 0.5).min(hi - 0.5);
                fan.spacing = (hi - lo + 1.0) / f64::from(share);
            }
        }
        fan.n_planes = share;
    }
}

/// Puts the paper's readjusted spacing on a fan: see [`Readjusted`]. A fan whose near end is `ρ` times as wide as its
/// far end has a mean stripe of `⅔·(1 + ρ + ρ²)/(1 + ρ)` times the far one; the spacing makes that one pixel.
fn readjust(fan: &mut Fan, f: usize, vanishing: [f64; 3], extent: (f64, f64), w: f64, h: f64) {
    let [vx, vy, vw] = vanishing;
    if vw == 0.0 {
        return; // parallel planes: nothing crowds
    }
    let (x, y) = (vx / vw, vy / vw);
    let (centre, distance, depth) = if vertical(f) { (x, (y - fan.far).abs(), h) } else { (y, (x - fan.far).abs(), w) };
    // As good as parallel, and so far that places beside the centre would be lost to rounding.
    if distance > 1e6 * (w + h) {
        return;
    }
    let rho = ((distance - depth) / distance).clamp(0.0, 1.0);
    let pixels = 1.5 * (1.0 + rho) / (1.0 + rho + rho * rho);
    let q = |at: f64| crowd((at - centre) / distance);
    let (lo, hi) = (q(extent.0 - 0.5), q(extent.1 + 0.5));
    // An odd number: a vanishing point on a pixel's centre, between extents that are alike, would else put that pixel's
    // column on the border of two stripes, and rounding would choose.
    let n = 2.0 * ((hi - lo) * distance / pixels / 2.0).floor() + 1.0;
    if !(n.is_finite() && n < f64::from(fan.n_planes)) {
        return;
    }
    fan.n_planes = n as u32;
    fan.readjusted = Some(Readjusted { centre, distance, start: lo, step: (hi - lo) / n });
}

impl Fan {
    /// Place of plane `k` of the fan on the far edge, and the width of its stripe, in pixels.
    pub fn place(&self, k: u32) -> (f64, f64) {
        match self.readjusted {
            None => (self.start + (f64::from(k) + 0.5) * self.spacing, self.spacing),
            Some(r) => {
                let at = |i: f64| r.centre + r.distance * uncrowd(r.start + i * r.step);
                let k = f64::from(k);
                (at(k + 0.5), at(k + 1.0) - at(k))
            }
        }
    }

    /// The sample at whose place pixel `p` along the planes has its centre, counted as pixels are.
    #[inline]
    pub fn sample_at(&self, p: u32) -> u32 {
        if self.n_samples == self.pixels {
            return p;
        }
        ((2 * u64::from(p) + 1) * u64::from(self.n_samples) / (2 * u64::from(self.pixels))) as u32
    }

    /// The plane of the fan whose stripe holds place `at` of the far edge.
    #[inline]
    pub fn plane_at(&self, at: f64) -> u32 {
        let k = match self.readjusted {
            None => (at - self.start) / self.spacing,
            Some(r) => (crowd((at - r.centre) / r.distance) - r.start) / r.step,
        };
        (k.max(0.0) as u32).min(self.n_planes - 1)
    }
}

/// The plane through place `at` of fan `f`'s far edge: azimuth and projection, samples not yet flipped.
fn line(f: usize, at: f64, far: f64, camera: &Camera, basis: &Basis) -> Plane {
    let (x, y) = if vertical(f) { (at, far) } else { (far, at) };
    let ray = camera.ray(basis, x, y);
    let horizontal = DVec3::new(ray.x, 0.0, ray.z);
    // The far point is the vanishing point only where the fan has no extent; any azimuth will do.
    let dir = horizontal.try_normalize().unwrap_or_else(|| {
        let away = if basis.forward.y > 0.0 { -basis.up } else { basis.up };
        DVec3::new(away.x, 0.0, away.z).try_normalize().unwrap_or(DVec3::NEG_Z)
    });
    let focal = camera.focal();
    let (w, h) = (f64::from(camera.width), f64::from(camera.height));
    let (c, e) = (dir.dot(basis.forward), basis.forward.y);
    let (a, b) = if vertical(f) {
        (h / 2.0 * c - focal * dir.dot(basis.up), h / 2.0 * e - focal * basis.up.y)
    } else {
        (w / 2.0 * c + focal * dir.dot(basis.right), w / 2.0 * e + focal * basis.right.y)
    };
    Plane { dir: [dir.x, dir.z], a, b, c, e, ..Plane::default() }
}

/// Samples of the plane at `at` that pixels can ask for, widened for rounding and for pixels that look beside their place.
fn window(f: usize, at: f64, stripe: f64, fan: &Fan, vanishing: [f64; 3], w: f64, h: f64) -> (u32, u32) {
    let [vx, vy, vw] = vanishing;
    let (n, pixels) = (i64::from(fan.n_samples), f64::from(fan.pixels));
    // Along: the axis samples count along. Across: the axis of the far edge.
    let (v_along, v_across, across_size) = if vertical(f) { (vy, vx, w) } else { (vx, vy, h) };
    let (mut lo, mut hi) = (0.0, pixels);
    // On the fan's side of the vanishing point.
    let main = |s: f64| v_along - s * vw;
    let towards_zero = f == UP || f == LEFT;
    if vw > 0.0 {
        let v = v_along / vw;
        if towards_zero {
            hi = hi.min((v + 0.5).floor());
        } else {
            lo = f64::max(lo, (v - 0.5).ceil());
        }
    }
    // Across the screen, half a stripe beyond its edges included.
    let m = (v_across - at * vw) / main(fan.far);
    // A stripe and a half: pixels also look at the second nearest plane, and one sample to either side.
    let margin = 1.5 * stripe;
    if m.is_finite() && m != 0.0 {
        let s0 = fan.far + (-margin - at) / m;
        let s1 = fan.far + (across_size + margin - at) / m;
        lo = lo.max(s0.min(s1).floor() - 2.0);
        hi = hi.min(s0.max(s1).ceil() + 2.0);
    }
    // From pixels to samples.
    let per_pixel = n as f64 / pixels;
    let (lo, hi) = ((lo * per_pixel).floor().clamp(0.0, n as f64), (hi * per_pixel).ceil().clamp(0.0, n as f64));
    let (lo, hi) = (lo as i64, hi as i64);
    let hi = hi.max(lo);
    let (lo, hi) = if fan.flip { (n - hi, n - lo) } else { (lo, hi) };
    (lo as u32, hi as u32)
}

/// The world around the eye: what clips planes and what levels they may draw.
struct World {
    eye_cell: [i32; 3],
    eye_fract: [f64; 3],
    period_offset: [i64; 2],
    /// Extent along x and z, `None` where it repeats.
    bounds: [Option<i32>; 2],
    /// Height of the lowest and the highest solid voxel's far face above the eye, of each level that may be drawn: a coarse
    /// level's world is higher than a fine one's.
    heights: Vec<(f64, f64)>,
    view_distance: f64,
    levels: u32,
    /// Walks are in f64, not f32.
    f64_walk: bool,
}

impl World {
    fn new(resident: &Resident, camera: &Camera, options: &Options) -> World {
        let [nx, _, nz] = resident.dims;
        let mut period_offset = [0; 2];
        let mut reduce = |axis: usize, v: f64, n: u32, repeat: bool| -> (i32, f64) {
            let cell = v.floor();
            let fract = v - cell;
            let mut cell = cell as i64;
            if repeat {
                let first = cell.rem_euclid(i64::from(n));
                period_offset[axis] = cell - first;
                cell = first;
            }
            (cell.clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32, fract)
        };
        let (x, fx) = reduce(0, camera.eye.x, nx, options.repeat.x);
        let (z, fz) = reduce(1, camera.eye.z, nz, options.repeat.z);
        let y = camera.eye.y.floor();
        let repeats = options.repeat.x || options.repeat.z;
        let view_distance = match (options.view_distance, repeats) {
            (view, false) => view,
            (view, true) if view.is_finite() => view.min(FARTHEST_VIEW),
            _ => REPEATED_VIEW_DISTANCE,
        };
        // A level whose cells do not divide a repeated extent would straddle the seam.
        let fits = |k: u32| {
            (!options.repeat.x || nx.is_multiple_of(1 << k)) && (!options.repeat.z || nz.is_multiple_of(1 << k))
        };
        let levels = match options.lod {
            None => 1,
            Some(_) => (0..resident.levels.len() as u32).take_while(|&k| fits(k)).count() as u32,
        };
        let height = |y: u32, k: usize| f64::from(y << k) - camera.eye.y;
        let heights = resident.levels[..levels as usize].iter().enumerate();
        World {
            eye_cell: [x, y as i32, z],
            eye_fract: [fx, camera.eye.y - y, fz].map(|fract| fract.min(BELOW_ONE)),
            period_offset,
            bounds: [(!options.repeat.x).then_some(nx as i32), (!options.repeat.z).then_some(nz as i32)],
            heights: heights.map(|(k, level)| (height(level.bottom, k), height(level.top, k))).collect(),
            view_distance,
            levels,
            f64_walk: options.f64_traversal,
        }
    }

    /// Finds where a plane enters and leaves the world, and the column it starts in. Where it crosses the world's edges is
    /// rounded as where it crosses any other grid line: in a larger world, empty around this one, the walk is the same.
    fn clip(&self, plane: &mut Plane) {
        let (mut t_start, mut t_end) = (0.0, self.view_distance);
        let mut entered = None;
        for axis in 0..2 {
            let Some(n) = self.bounds[axis] else { continue };
            let d = plane.dir[axis];
            if d == 0.0 {
                if !(0..n).contains(&self.eye_cell[2 * axis]) {
                    t_end = 0.0;
                }
                continue;
            }
            let (near, far) = if d > 0.0 { (0, n) } else { (n, 0) };
            let t_near = self.cross(plane, axis, near);
            if t_near > t_start {
                t_start = t_near;
                entered = Some(axis);
            }
            t_end = f64::min(t_end, self.cross(plane, axis, far));
        }
        let (from, to) = self.sight(plane);
        t_end = t_end.min(to);
        if from.min(t_end) > t_start {
            (t_start, entered) = (from.min(t_end), None);
        }
        plane.t_start = t_start;
        plane.t_end = t_end.max(t_start);
        for axis in 0..2 {
            let d = plane.dir[axis];
            let along = self.eye_fract[2 * axis] + t_start * d;
            let cell = f64::from(self.eye_cell[2 * axis]) + along.floor();
            plane.cell[axis] = match self.bounds[axis] {
                Some(n) if entered == Some(axis) => {
                    if d > 0.0 {
                        0
                    } else {
                        n - 1
                    }
                }
                Some(n) => {
                    let cell = cell.clamp(0.0, f64::from((n - 1).max(0))) as i32;
                    if entered.is_some() { self.reached(plane, axis, t_start, cell, n) } else { cell }
                }
                None => cell as i32,
            };
        }
    }

    /// Where a plane crosses grid line `line` of an axis that it does not run across, with the walk's own rounding.
    fn cross(&self, plane: &Plane, axis: usize, line: i32) -> f64 {
        let (cells, fract) = (line.wrapping_sub(self.eye_cell[2 * axis]), self.eye_fract[2 * axis]);
        let inverse = 1.0 / plane.dir[axis];
        if self.f64_walk {
            return (f64::from(cells) - fract) * inverse;
        }
        f64::from((cells as f32 - fract as f32) * inverse as f32)
    }

    /// The cell that steps of the walk have come to at `t`, `near` it: of lines crossed at once that of x comes first.
    fn reached(&self, plane: &Plane, axis: usize, t: f64, near: i32, n: i32) -> i32 {
        let d = plane.dir[axis];
        if d == 0.0 {
            return near;
        }
        let (step, ahead) = if d > 0.0 { (1, 1) } else { (-1, 0) };
        let passed = |line: i32| {
            let at = self.cross(plane, axis, line);
            if axis == 0 { at <= t } else { at < t }
        };
        let mut cell = near;
        // One step at most: the estimate is out by a rounding.
        if !passed(cell + 1 - ahead) {
            cell -= step;
        } else if passed(cell + ahead) {
            cell += step;
        }
        cell.clamp(0, n - 1)
    }

    /// The distances between which a sample's sight line lies within the heights of the world, whatever is drawn. Far above
    /// or below the world there is nothing to walk through for long; beyond where the sight line nearest to level has left
    /// it, nothing more can show.
    fn sight(&self, plane: &Plane) -> (f64, f64) {
        let bottom = self.heights.iter().fold(f64::INFINITY, |b, h| b.min(h.0));
        let top = self.heights.iter().fold(f64::NEG_INFINITY, |t, h| t.max(h.1));
        // A sight line's height over its distance, as a fraction.
        let sight = |u: f64| (u * plane.c - plane.a, plane.b - u * plane.e);
        // The lowest one goes down to a world below the eye first, the highest one up to one above.
        let from = match (bottom, top) {
            (_, top) if top < 0.0 => (top, sight(f64::from(plane.first))),
            (bottom, _) if bottom > 0.0 => (bottom, sight(f64::from(plane.end))),
            _ => (0.0, (1.0, 1.0)),
        };
        let from = match from {
            (0.0, _) => 0.0,
            (near, (h, _)) if h * near <= 0.0 => f64::INFINITY,
            // A little earlier: the walk rounds to f32.
            (near, (h, t)) => f64::max(near / h * t * (1.0 - 1e-6), 0.0),
        };
        // The samples beside the place of the horizon, their centres moved a little towards it.
        let horizon = plane.a / plane.c;
        let leaves = |centre: f64, side: f64, edge: f64| {
            let (h, t) = sight(centre - side * 0.05);
            if edge * side <= 0.0 {
                0.0
            } else if h * side <= 0.0 {
                f64::INFINITY
            } else {
                edge / h * t
            }
        };
        let (first, last) = (f64::from(plane.first) + 0.5, f64::from(plane.end) - 0.5);
        if !horizon.is_finite() || plane.c <= 0.0 || last < first {
            return (from, f64::INFINITY);
        }
        let above = ((horizon - 0.5).ceil() + 0.5).max(first);
        let below = ((horizon - 0.5).floor() + 0.5).min(last);
        let up = if above <= last { leaves(above, 1.0, top) } else { 0.0 };
        let down = if below >= first { leaves(below, -1.0, bottom) } else { 0.0 };
        (from, up.max(down) * (1.0 + 1e-6))
    }

    /// From where on each level's voxels project to at most `lod` pixels, for everything that the plane can see.
    fn choose_levels(&self, plane: &mut Plane, focal: f64, lod: Option<f64>) {
        plane.lod_t = f64::INFINITY;
        plane.lod_first = 0;
        let Some(lod) = lod else { return };
        // Depth of a voxel one wide that projects to `lod` pixels.
        let depth = focal / lod;
        let direction = |u: f64| (plane.b - u * plane.e, u * plane.c - plane.a);
        let ends = [direction(f64::from(plane.first)), direction(f64::from(plane.end))];
        // A point at distance t on a sight line has depth t·Δ/(t component), least where that is greatest.
        let delta = plane.b * plane.c - plane.a * plane.e;
        let widest = ends[0].0.max(ends[1].0);
        plane.lod_t = depth * widest / delta;
        // With a level's whole world below (above) the eye, nothing of it is nearer than where sight lines reach its top
        // (bottom).
        let nearest = |k: u32| {
            let (bottom, top) = self.heights[k as usize];
            if bottom <= 0.0 && top >= 0.0 {
                return 0.0;
            }
            let near = if top < 0.0 { top } else { bottom };
            // A sight line that never reaches the world shows only sky; the other end, the steeper, is the bound.
            let reached = ends.iter().map(|&(_, h)| near / h).filter(|&q| q > 0.0);
            reached.fold(f64::INFINITY, f64::min) * delta
        };
        let may_start = |k: u32| k < self.levels && nearest(k) >= depth * f64::from(1u32 << k);
        while may_start(plane.lod_first + 1) {
            plane.lod_first += 1;
        }
    }
}
