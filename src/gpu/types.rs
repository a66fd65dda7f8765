//! What host and shaders exchange. The WGSL sides stand in `shaders/shared/`; tests below join them field by field.

use crate::cpu::remap::Row;
use crate::cpu::shade::ShadeParams;
use crate::cpu::{shadow, smooth};
use crate::frame::camera::Camera;
use crate::frame::options::Options;
use crate::frame::plane_setup::{AT_ONCE, DOWN, Fan, LEFT, RIGHT, Setup, UP, uncrowd, vertical};
use crate::world::tables::Resident;
use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;

/// Levels a scene can have on the GPU: an extent of 2³¹ halves down to 1.
pub const MAX_LEVELS: usize = 32;

/// No index.
pub const NONE: u32 = u32::MAX;

/// What stands for "never" and "as steep as can be": safe to multiply with any distance, as in the CPU's walk.
pub const STEEP: f32 = 1e18;

/// The view ends here at the latest, in voxels: crossings beyond no longer tell columns apart.
const VIEW_LIMIT: f64 = 1e9;

/// How the shaders look a colour up, `PAINT_*` there: [`crate::world::tables::Paint`] says what each means.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PaintKind {
    #[default]
    None,
    Run,
    Voxel,
    Column,
    Height,
    Top,
}

impl PaintKind {
    pub const ALL: [(PaintKind, &'static str); 6] = [
        (PaintKind::None, "PAINT_NONE"),
        (PaintKind::Run, "PAINT_RUN"),
        (PaintKind::Voxel, "PAINT_VOXEL"),
        (PaintKind::Column, "PAINT_COLUMN"),
        (PaintKind::Height, "PAINT_HEIGHT"),
        (PaintKind::Top, "PAINT_TOP"),
    ];

    /// As a shader's constant.
    pub fn constant(self) -> f64 {
        f64::from(self as u32)
    }
}

/// A level's extent and where its tables begin, in elements of the tables of all levels.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
pub struct Level {
    pub size: [i32; 2],
    pub columns: u32,
    pub runs: u32,
    pub blocks: u32,
    /// Blocks a row; where tiles stand in slots, tiles a side of the window, as a power of two.
    pub blocks_row: u32,
    pub bottom: i32,
    pub top: i32,
    /// [`NONE`]: this level has a colour a column, though others have more.
    pub paint: u32,
    pub exposed: u32,
    pub colors: u32,
    /// Slots of the window's tiles, among the runs.
    pub pages: u32,
}

/// See [`crate::frame::plane_setup::Plane`].
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
pub struct Plane {
    pub dir: [f32; 2],
    pub inverse: [f32; 2],
    pub a: f32,
    pub b: f32,
    pub c: f32,
    pub e: f32,
    pub delta: f32,
    pub t_start: f32,
    pub t_end: f32,
    pub lod_t: f32,
    pub first: i32,
    pub end: i32,
    pub base: u32,
    pub lod_first: u32,
    pub cell: [i32; 2],
    /// The plane that is walked in this one's place: see `turns`.
    pub turn: u32,
    pub _pad0: u32,
}

/// See [`crate::frame::plane_setup::Fan`].
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
pub struct FanParams {
    pub first_plane: u32,
    pub n_planes: u32,
    pub n_samples: u32,
    pub first_sample: u32,
    pub flip: u32,
    pub bounds: u32,
    pub spacing: f32,
    pub pixels: u32,
}

/// What all planes and pixels of a frame share.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
pub struct FrameParams {
    pub fans: [FanParams; 4],
    pub eye_cell: [i32; 3],
    pub n_planes: u32,
    pub eye_fract: [f32; 3],
    pub levels: u32,
    pub ray_origin: [f32; 3],
    pub width: u32,
    pub ray_right: [f32; 3],
    pub height: u32,
    pub ray_down: [f32; 3],
    pub equidistant: f32,
    pub bottom: f32,
    pub top: f32,
    pub repeat_x: u32,
    pub repeat_z: u32,
    pub offset_x: i32,
    pub offset_z: i32,
    pub samples: u32,
    pub sparse: u32,
    pub start: [f32; 2],
    pub step: [f32; 2],
    pub up: [f32; 3],
    pub pixel: f32,
    pub sun: [f32; 3],
    pub radius_px: f32,
    pub fog: f32,
    pub ambient: f32,
    pub sky: u32,
    pub view_distance: f32,
    pub axis_right: [f32; 3],
    pub size: f32,
    pub axis_up: [f32; 3],
    pub top_levels: u32,
    pub axis_forward: [f32; 3],
    pub world_top: f32,
    pub sun_world: [f32; 3],
    pub shadow_end: f32,
    pub surface_levels: u32,
    pub surface_top: f32,
    pub smooth_near: f32,
    pub _pad0: u32,
}

/// A plane number (or a place on the far edge) as a linear function along a row or a column of pixels, in 32.32 fixed
/// point: `at + step · (pixel − anchor)`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Line {
    pub at_hi: i32,
    pub at_lo: u32,
    pub step_hi: i32,
    pub step_lo: u32,
    pub anchor: i32,
    /// Of a row: columns `anchor .. to` lie in `fan`, those before in [`LEFT`], those after in [`RIGHT`].
    pub to: i32,
    pub fan: u32,
    /// Pixels of the far edge that one pixel here is wide, inverted.
    pub narrow: f32,
}

/// A frame's inputs, ready to upload.
#[derive(Clone, Debug, Default)]
pub struct Upload {
    pub frame: FrameParams,
    pub planes: Vec<Plane>,
    pub lines: Vec<Line>,
    /// Start and middle of each stripe of the fans whose stripes differ in width; they follow the lines.
    pub stripes: Vec<[[u32; 2]; 2]>,
}

/// 32.32 fixed point, saturating.
fn fixed(v: f64) -> i64 {
    (v * 4_294_967_296.0).round() as i64
}

impl Line {
    fn new(at: f64, step: f64, anchor: i32, narrow: f64) -> Line {
        // Beyond any number of planes; keeps a line through the vanishing point from wrapping round.
        let at = fixed(at.clamp(-1e6, 1e8));
        let step = fixed(step.clamp(-1e6, 1e6));
        Line {
            at_hi: (at >> 32) as i32,
            at_lo: at as u32,
            step_hi: (step >> 32) as i32,
            step_lo: step as u32,
            anchor,
            narrow: narrow as f32,
            ..Line::default()
        }
    }
}

impl Upload {
    /// Rounds a frame's setup to what the shaders read, once, from the f64 of the host.
    pub fn new(resident: &Resident, setup: &Setup, camera: &Camera, options: &Options) -> Upload {
        let mut up = Upload { frame: frame_params(resident, setup, camera, options), ..Upload::default() };
        up.planes = setup.planes.par_iter().with_min_len(AT_ONCE).map(Plane::new).collect();
        for (plane, turn) in up.planes.iter_mut().zip(turns(setup, &up.frame)) {
            plane.turn = turn;
        }
        for f in 0..4 {
            up.frame.fans[f].bounds = NONE;
            if setup.fans[f].n_planes > 0 && setup.fans[f].readjusted.is_some() {
                // In elements of 16 bytes: a line takes two.
                up.frame.fans[f].bounds = 2 * (camera.height + 2 * camera.width) + up.stripes.len() as u32;
                up.stripes.par_extend(stripes(&setup.fans[f]));
            }
        }
        up.lines(setup, camera);
        up
    }

    /// Rows and columns of the remap, as `Row::gather` has them.
    fn lines(&mut self, setup: &Setup, camera: &Camera) {
        let [vx, vy, vw] = setup.vanishing;
        let (w, h) = (camera.width, camera.height);
        self.lines.reserve((h + 2 * w) as usize);
        let row = |y: u32| {
            let [_, middle, _] = Row::new(setup, y, w).stretches();
            let fan = &setup.fans[middle.fan];
            let center = f64::from(y) + 0.5;
            let dy = vy - center * vw;
            let across = if dy == 0.0 { 0.0 } else { (fan.far - center) / dy };
            let (scale, start) = (1.0 - across * vw, across * vx);
            let at = (f64::from(middle.from) + 0.5) * scale + start;
            let narrow = narrowing(dy, vy - fan.far * vw);
            let mut line = fan_line(fan, at, scale, middle.from as i32, narrow);
            line.to = middle.to as i32;
            line.fan = middle.fan as u32;
            line
        };
        self.lines.par_extend((0..h).into_par_iter().with_min_len(AT_ONCE).map(row));
        // Near the vanishing point's height, where values are small.
        let anchor = if vw > 0.0 { (vy / vw).clamp(0.0, f64::from(h - 1)) as i32 } else { 0 };
        let y = f64::from(anchor) + 0.5;
        for f in [LEFT, RIGHT] {
            let fan = &setup.fans[f];
            if fan.n_planes == 0 {
                self.lines.extend(std::iter::repeat_n(Line::default(), w as usize));
                continue;
            }
            let column = |x: u32| {
                let center = f64::from(x) + 0.5;
                let dx = vx - center * vw;
                let across = if dx == 0.0 { 0.0 } else { (fan.far - center) / dx };
                let narrow = narrowing(dx, vx - fan.far * vw);
                fan_line(fan, y + across * (vy - y * vw), 1.0 - across * vw, anchor, narrow)
            };
            self.lines.par_extend((0..w).into_par_iter().with_min_len(AT_ONCE).map(column));
        }
    }
}

/// The order in which planes are walked, those that reach farthest first: whatever runs to the end of the view is then not
/// begun last. Planes that reach about as far stay side by side, where they meet the same columns.
fn turns(setup: &Setup, frame: &FrameParams) -> Vec<u32> {
    let reach = |p: &crate::frame::plane_setup::Plane| {
        let sight = |u: u32| (p.b - f64::from(u) * p.e, f64::from(u) * p.c - p.a);
        let ((t_low, h_low), (t_high, h_high)) = (sight(p.first), sight(p.end));
        let mut end = p.t_end;
        // All that it sees lies below the eye, or above.
        if h_high < 0.0 {
            end = end.min(f64::from(frame.bottom) * t_high / h_high);
        }
        if h_low > 0.0 {
            end = end.min(f64::from(frame.top) * t_low / h_low);
        }
        (end - p.t_start).max(1.0).log2() as u32
    };
    let reaches: Vec<u32> = setup.planes.par_iter().with_min_len(AT_ONCE).map(reach).collect();
    let mut turns: Vec<u32> = (0..setup.planes.len() as u32).collect();
    turns.par_sort_by_key(|&p| std::cmp::Reverse(reaches[p as usize]));
    turns
}

fn narrowing(here: f64, far: f64) -> f64 {
    if here == 0.0 { 0.0 } else { here / far }
}

/// `at`: place on the far edge at the anchor, `step`: from pixel to pixel.
fn fan_line(fan: &Fan, at: f64, step: f64, anchor: i32, narrow: f64) -> Line {
    match fan.readjusted {
        None => Line::new((at - fan.start) / fan.spacing, step / fan.spacing, anchor, narrow),
        Some(_) => Line::new(at, step, anchor, narrow),
    }
}

/// Start and middle of each stripe of a fan whose stripes differ in width, as places on the far edge.
fn stripes(fan: &Fan) -> impl IndexedParallelIterator<Item = [[u32; 2]; 2]> + '_ {
    let r = fan.readjusted.expect("only fans whose stripes differ have bounds");
    let place = move |half: f64| {
        let at = fixed(r.centre + r.distance * uncrowd(r.start + half * 0.5 * r.step));
        [(at >> 32) as u32, at as u32]
    };
    let pair = move |k: u32| [f64::from(2 * k), f64::from(2 * k + 1)].map(place);
    (0..fan.n_planes).into_par_iter().with_min_len(AT_ONCE).map(pair)
}

impl Plane {
    fn new(p: &crate::frame::plane_setup::Plane) -> Plane {
        let dir = p.dir.map(|d| d as f32);
        Plane {
            dir,
            inverse: p.dir.map(|d| if d == 0.0 { f32::MAX } else { (1.0 / d) as f32 }),
            a: p.a as f32,
            b: p.b as f32,
            c: p.c as f32,
            e: p.e as f32,
            delta: (p.b * p.c - p.a * p.e) as f32,
            t_start: p.t_start.min(VIEW_LIMIT) as f32,
            t_end: p.t_end.min(VIEW_LIMIT) as f32,
            lod_t: p.lod_t.min(1e17) as f32,
            first: p.first as i32,
            end: p.end as i32,
            base: p.base as u32,
            lod_first: p.lod_first,
            cell: p.cell,
            ..Plane::default()
        }
    }
}

fn frame_params(resident: &Resident, setup: &Setup, camera: &Camera, options: &Options) -> FrameParams {
    let fans = [UP, DOWN, LEFT, RIGHT].map(|f| {
        let fan = &setup.fans[f];
        FanParams {
            first_plane: fan.first_plane,
            n_planes: fan.n_planes,
            n_samples: fan.n_samples,
            first_sample: fan.first_sample as u32,
            flip: u32::from(fan.flip),
            spacing: fan.spacing as f32,
            pixels: fan.pixels,
            ..FanParams::default()
        }
    });
    debug_assert!(vertical(UP) && !vertical(LEFT));
    let basis = camera.basis();
    let origin = camera.ray(&basis, 0.5, 0.5);
    let half = camera.half_extent();
    let right = basis.right * (2.0 * half.x / f64::from(camera.width));
    let down = basis.up * (-2.0 * half.y / f64::from(camera.height));
    let eye_y = f64::from(setup.eye_cell[1]) + setup.eye_fract[1];
    let levels = &resident.levels[..setup.levels as usize];
    let top = levels.iter().enumerate().map(|(l, level)| u64::from(level.top) << l).max().unwrap_or(0);
    let bottom = levels.iter().enumerate().map(|(l, level)| u64::from(level.bottom) << l).min().unwrap_or(0);
    let shade = ShadeParams::new(camera, options);
    FrameParams {
        fans,
        eye_cell: setup.eye_cell,
        n_planes: setup.planes.len() as u32,
        eye_fract: setup.eye_fract.map(|f| f as f32),
        levels: setup.levels,
        ray_origin: origin.as_vec3().to_array(),
        width: camera.width,
        ray_right: right.as_vec3().to_array(),
        height: camera.height,
        ray_down: down.as_vec3().to_array(),
        equidistant: setup.equidistant.min(1e17) as f32,
        bottom: (bottom as f64 - eye_y) as f32,
        top: (top as f64 - eye_y) as f32,
        repeat_x: u32::from(setup.repeats[0]),
        repeat_z: u32::from(setup.repeats[1]),
        offset_x: setup.period_offset[0] as i32,
        offset_z: setup.period_offset[1] as i32,
        samples: setup.samples as u32,
        sparse: 0,
        start: shade.start,
        step: shade.step,
        up: shade.up.to_array(),
        pixel: shade.pixel,
        sun: shade.sun.to_array(),
        radius_px: shade.radius_px,
        fog: shade.fog,
        ambient: shade.ambient,
        sky: u32::from(shade.sky),
        view_distance: setup.view_distance.min(VIEW_LIMIT) as f32,
        axis_right: shade.axes[0].to_array(),
        size: shade.size,
        axis_up: shade.axes[1].to_array(),
        axis_forward: shade.axes[2].to_array(),
        sun_world: shade.sun_world.to_array(),
        shadow_end: shadow::end(setup, shade.sun_world),
        smooth_near: smooth::near(camera),
        // Where there are shadows or a surface, they are known when the frame is sent.
        top_levels: 0,
        world_top: 0.0,
        surface_levels: 0,
        surface_top: 0.0,
        _pad0: 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::plane_setup::plane_setup;
    use planecast_encoder::source::procedural::{Kind, procedural};
    use planecast_encoder::{BuildOptions, build};

    #[test]
    fn turns_take_every_plane_once_and_those_that_see_the_horizon_first() {
        let scene = build(procedural(Kind::Terrain, 64, 1).unwrap(), &BuildOptions::default()).unwrap();
        let resident = Resident::new(&scene);
        let eye = glam::DVec3::new(20.3, 70.2, 30.1);
        let camera = Camera { eye, yaw: 20.0, pitch: -35.0, roll: 25.0, fov: 70.0, width: 160, height: 120 };
        let repeat = crate::frame::options::Repeat { x: true, z: true };
        let options = Options { repeat, view_distance: 9000.0, ..Options::default() };
        let setup = plane_setup(&resident, &camera, &options);
        let turns: Vec<usize> =
            Upload::new(&resident, &setup, &camera, &options).planes.iter().map(|p| p.turn as usize).collect();
        let mut sorted = turns.clone();
        sorted.sort();
        assert!(sorted.into_iter().eq(0..setup.planes.len()));
        // How far a plane sees over ground that lies 70 voxels below the eye.
        let sees = |&p: &usize| {
            let p = &setup.planes[p];
            let (t, h) = (p.b - f64::from(p.end) * p.e, f64::from(p.end) * p.c - p.a);
            if h < 0.0 { -70.0 * t / h } else { f64::INFINITY }
        };
        let far = turns.iter().rposition(|p| sees(p) > 9000.0).unwrap();
        let near = turns.iter().position(|p| sees(p) < 4000.0).unwrap();
        assert!(far > 10 && near < turns.len() - 10 && far < near, "{far} {near} of {}", turns.len());
    }
}
