//! The reference for translucent matter: each pixel's ray through level 0 in f64, each run × column box by the exact length of the way
//! through it, without an early end. It shares no walk with [`crate::cpu::matter`].

use crate::cpu::exact::{cast, view_distance};
use crate::cpu::matter::{Light, over};
use crate::frame::camera::Camera;
use crate::frame::options::Options;
use crate::frame::picture::Frame;
use crate::frame::projection::Rays;
use crate::world::matter::{Optics, SceneMatter};
use glam::DVec3;
use planecast_encoder::model::matter::{Matter, Mode};
use planecast_encoder::{Columns, Scene};

/// Light of one ray, and the material it is in: which, and where it was left.
struct Ray {
    color: [f64; 3],
    left: f64,
    within: Option<(u16, f64)>,
}

impl Ray {
    /// A way through one box, from `t0` to `t1`, `len` voxels long.
    fn pass(&mut self, optics: &Optics, [t0, t1]: [f64; 2], len: f64) {
        let extinction = optics.extinction;
        let share = match optics.mode {
            Mode::Surface => {
                let goes_on =
                    self.within.is_some_and(|(m, t)| m == optics.material && t0 - t <= 1e-9 * t0.abs().max(1.0));
                self.within = Some((optics.material, t1));
                if goes_on { 0.0 } else { -(-extinction).exp_m1() }
            }
            Mode::Additive => extinction * len,
            Mode::Volumetric | Mode::Emissive => -(-extinction * len).exp_m1(),
        };
        (0..3).for_each(|i| self.color[i] += self.left * share * optics.color[i]);
        if optics.mode != Mode::Additive {
            self.left *= 1.0 - share;
        }
    }
}

/// What the matter of level 0 does to light along a ray, up to `t_end` lengths of `dir`.
pub fn integrate(matter: &Matter, optics: &[Optics], repeats: [bool; 2], eye: DVec3, dir: DVec3, t_end: f64) -> Light {
    let mut ray = Ray { color: [0.0; 3], left: 1.0, within: None };
    let unit = dir.length();
    columns_along(matter.dims(), repeats, eye, dir, t_end, &mut |ix, t0, t1| {
        let runs = matter.column(ix);
        let slab = |i: usize| -> Option<(u16, [f64; 2])> {
            let from = if i == 0 { 0.0 } else { f64::from(runs[i - 1].end()) };
            let end = f64::from(runs[i].end());
            if dir.y == 0.0 {
                return (eye.y >= from && eye.y < end).then_some((runs[i].code(), [t0, t1]));
            }
            let [a, b] = [(from - eye.y) / dir.y, (end - eye.y) / dir.y];
            let ts = [t0.max(a.min(b)), t1.min(a.max(b))];
            (ts[0] < ts[1]).then_some((runs[i].code(), ts))
        };
        let mut each = |i: usize| {
            if let Some((code, ts)) = slab(i) {
                let optics = &optics[usize::from(code)];
                if optics.extinction > 0.0 {
                    ray.pass(optics, ts, (ts[1] - ts[0]) * unit);
                }
            }
        };
        match dir.y < 0.0 {
            true => (0..runs.len()).rev().for_each(&mut each),
            false => (0..runs.len()).for_each(&mut each),
        }
        ray.left > 0.0
    });
    Light { color: ray.color.map(|c| c as f32), left: ray.left as f32 }
}

/// Columns that a ray passes, from near to far, with where it enters and leaves each, while `each` says so.
fn columns_along(
    [nx, ny, nz]: [u32; 3],
    repeats: [bool; 2],
    eye: DVec3,
    dir: DVec3,
    t_end: f64,
    each: &mut dyn FnMut(usize, f64, f64) -> bool,
) {
    let (size, o, d) = ([i64::from(nx), i64::from(nz)], [eye.x, eye.z], [dir.x, dir.z]);
    let (mut t, mut end) = (0.0f64, t_end);
    let mut clip = |o: f64, d: f64, n: f64| {
        if d == 0.0 {
            return o >= 0.0 && o < n;
        }
        let [a, b] = [-o / d, (n - o) / d];
        (t, end) = (t.max(a.min(b)), end.min(a.max(b)));
        true
    };
    let mut meets = clip(eye.y, dir.y, f64::from(ny));
    for k in (0..2).filter(|&k| !repeats[k]) {
        meets &= clip(o[k], d[k], size[k] as f64);
    }
    if !meets {
        return;
    }
    // Which column a stretch lies in is told by its middle, which is on no line.
    let line = |k: usize, t: f64| {
        let at = o[k] + t * d[k];
        if d[k] > 0.0 { at.floor() + 1.0 } else { at.ceil() - 1.0 }
    };
    let mut next = [line(0, t), line(1, t)];
    while t < end {
        let cross = [0, 1].map(|k| if d[k] == 0.0 { f64::INFINITY } else { (next[k] - o[k]) / d[k] });
        let k = usize::from(cross[1] < cross[0]);
        let leaves = cross[k].min(end);
        if leaves > t {
            let column = [0, 1].map(|k| (o[k] + 0.5 * (t + leaves) * d[k]).floor() as i64);
            let inside = [0, 1]
                .map(|k| if repeats[k] { column[k].rem_euclid(size[k]) } else { column[k].clamp(0, size[k] - 1) });
            if !each((inside[1] * size[0] + inside[0]) as usize, t, leaves) {
                return;
            }
            t = leaves;
        }
        next[k] += if d[k] < 0.0 { -1.0 } else { 1.0 };
    }
}

/// Puts a scene's matter over a picture that [`crate::cpu::exact::exact`] made.
pub fn compose(scene: &Scene, matter: &SceneMatter, camera: &Camera, options: &Options, frame: &mut Frame) {
    let look = matter.look();
    let rays = Rays::new(camera, options.projection, scene.dims());
    let columns: &Columns = scene.levels[0].geometry(scene.encoding);
    let repeats = [options.repeat.x, options.repeat.z];
    let view = view_distance(options);
    let of_depth = options.smooth;
    over(&rays, frame, |eye, dir, depth| {
        let horizontal = dir.x.hypot(dir.z);
        let t_max = if horizontal > 0.0 { view / horizontal } else { f64::INFINITY };
        // The depth of the picture is an f32; of a surface there is no other.
        let solid = if of_depth { Some(depth) } else { cast(columns, repeats, eye, dir, t_max).map(|hit| hit.t) };
        integrate(&matter.levels[0], &look.optics, repeats, eye, dir, solid.unwrap_or(f64::INFINITY).min(t_max))
    });
}
