//! One case, drawn and measured.

use crate::cpu::exact::cast;
use crate::cpu::renderer::{CpuRenderer, Outputs};
use crate::cpu::traverse::{PlaneBuffer, SKY, traverse};
use crate::error::{Error, Result};
use crate::frame::camera::{Basis, Camera};
use crate::frame::options::Options;
use crate::frame::picture::Frame;
use crate::frame::plane_setup::{Fan, Plane, REPEATED_VIEW_DISTANCE, Setup, plane_setup};
use crate::measure::stability::catalogue::{Case, Expect};
use crate::measure::stability::worlds::World;
use glam::DVec3;

/// How far beside its centre a pixel may look, in pixels.
pub const REACH: f64 = 1.0;

/// As [`REACH`] where pixels test their own rays: what such a pixel shows is off by rounding alone, wherever its samples are.
pub const CENTRE: f64 = 1.0 / 16.0;

/// Rays that are cast across twice the reach, along each axis.
const RAYS: u32 = 9;

/// Greatest relative error of depth: some 80 units in the last place of an f32 (2⁻²³). A crossing takes four rounded
/// operations; near the horizon a sight line's slope is a difference of two numbers up to as large as the image's half.
pub const BOUND_DEPTH: f64 = 1e-5;

/// What [`Case::bound_moved`] is unless a case says otherwise.
pub const BOUND_MOVED: f64 = 0.5;

/// Draws one frame.
pub type Draw<'a> = Box<dyn FnMut(&Camera, &Options) -> Result<Frame> + 'a>;

/// Something that draws frames with voxels.
pub struct Drawer<'a> {
    /// The adapter's name, or "cpu".
    pub device: String,
    pub kernel: String,
    /// Whether it is `exact` itself.
    pub exact: bool,
    pub draw: Draw<'a>,
}

impl<'a> Drawer<'a> {
    /// Planes on the CPU.
    pub fn cpu(world: &'a World) -> Drawer<'a> {
        let mut renderer = CpuRenderer::new(&world.scene, &world.resident);
        let draw = move |camera: &Camera, options: &Options| renderer.render(camera, options, Outputs { voxel: true });
        Drawer { device: "cpu".into(), kernel: "planes".into(), exact: false, draw: Box::new(draw) }
    }

    /// Planes on the CPU, walked in f64.
    pub fn cpu_f64(world: &'a World) -> Drawer<'a> {
        let mut planes = Drawer::cpu(world);
        planes.kernel = "planes, f64".into();
        let mut draw = planes.draw;
        planes.draw = Box::new(move |camera: &Camera, options: &Options| {
            draw(camera, &Options { f64_traversal: true, ..*options })
        });
        planes
    }

    /// One f32 ray a pixel through a tree of masks, on the CPU.
    pub fn rays(world: &'a World) -> Drawer<'a> {
        let mut renderer = CpuRenderer::new(&world.scene, &world.resident);
        renderer.set_raycast(true);
        let draw = move |camera: &Camera, options: &Options| renderer.render(camera, options, Outputs { voxel: true });
        Drawer { device: "cpu".into(), kernel: "raycast".into(), exact: false, draw: Box::new(draw) }
    }

    /// A kernel on a GPU, with wgpu's runtime checks or without.
    #[cfg(feature = "gpu")]
    pub fn gpu(
        gpu: &crate::gpu::present::Device,
        world: &'a World,
        kernel: crate::Kernel,
        trusted: bool,
    ) -> Result<Drawer<'a>> {
        let options = crate::GpuOptions { kernel, trusted, ..crate::GpuOptions::default() };
        let mut renderer = crate::GpuRenderer::on_device(&world.scene, &world.resident, options, gpu)?;
        let (device, kernel) = (renderer.device().0.to_string(), kernel.name().to_string());
        let draw = move |camera: &Camera, options: &Options| renderer.render(camera, options, Outputs { voxel: true });
        Ok(Drawer { device, kernel, exact: false, draw: Box::new(draw) })
    }

    /// One f64 ray a pixel.
    pub fn exact(world: &'a World) -> Drawer<'a> {
        let mut renderer = CpuRenderer::new(&world.scene, &world.resident);
        let draw = move |camera: &Camera, options: &Options| renderer.exact(camera, options, Outputs { voxel: true });
        Drawer { device: "cpu".into(), kernel: "exact".into(), exact: true, draw: Box::new(draw) }
    }
}

/// What a case must agree with: its picture by `exact`, and that one ulp of yaw, of pitch and of the eye's x further.
pub struct Truth {
    pub frame: Frame,
    pub further: [Frame; 3],
}

impl Truth {
    pub fn new(case: &Case, world: &World) -> Result<Truth> {
        let mut exact = Drawer::exact(world);
        let mut draw = |camera: &Camera| (exact.draw)(camera, &case.options);
        let [yaw, pitch, eye] = further(&case.camera);
        Ok(Truth { frame: draw(&case.camera)?, further: [draw(&yaw)?, draw(&pitch)?, draw(&eye)?] })
    }
}

/// The camera one ulp further in yaw, in pitch (towards level) and in x.
pub fn further(camera: &Camera) -> [Camera; 3] {
    let pitch = if camera.pitch > 0.0 { camera.pitch.next_down() } else { camera.pitch.next_up() };
    let eye = DVec3::new(camera.eye.x.next_up(), camera.eye.y, camera.eye.z);
    [Camera { yaw: camera.yaw.next_up(), ..*camera }, Camera { pitch, ..*camera }, Camera { eye, ..*camera }]
}

/// What came of a case.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct Row {
    pub case: String,
    pub reason: String,
    pub device: String,
    pub kernel: String,
    pub pixels: usize,
    /// Pixels that show what cannot be seen from there, in percent, and at most how many may.
    pub off_percent: f64,
    pub bound_off_percent: f64,
    /// Pixels that show what cannot be seen from there within [`CENTRE`], in percent, and at most how many may: those that
    /// test their own rays; 0 where none do.
    pub wrong_percent: f64,
    pub bound_wrong_percent: f64,
    /// Pixels of sky in a closed surface, or of anything where nothing is.
    pub cracks: usize,
    /// Greatest relative error of depth.
    pub depth: f64,
    pub bound_depth: f64,
    /// Columns that the frame looked at, those of the plane that looked at most (on the CPU), and at most how many one
    /// plane can.
    pub columns: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steps: Option<u64>,
    pub bound_steps: u64,
    /// Share of pixels, in percent, that one ulp of yaw, pitch and eye moves beyond those that it moves in `exact`.
    pub moved_percent: [f64; 3],
    /// By how many ulps (of f32) a depth grows more than that of `exact` then, at most.
    pub depth_ulps: [u32; 3],
    /// The variable that a family of cases sweeps, and its value.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sweep: Option<(&'static str, f64)>,
    /// Why the device does not draw it: it is beyond a limit that it states.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refused: Option<String>,
    /// What is wrong, in words; empty where all is within its bounds.
    pub faults: Vec<String>,
}

/// Draws a case and measures it against `truth`. An error is one of the device; whatever is wrong with the picture stands
/// in [`Row::faults`].
pub fn measure(case: &Case, world: &World, truth: &Truth, drawer: &mut Drawer<'_>) -> Result<Row> {
    let mut row = Row {
        case: case.name.clone(),
        reason: case.reason.into(),
        device: drawer.device.clone(),
        kernel: drawer.kernel.clone(),
        bound_off_percent: case.bound_off,
        bound_wrong_percent: case.bound_wrong,
        bound_depth: case.bound_depth,
        sweep: case.sweep,
        ..Row::default()
    };
    let frame = match (drawer.draw)(&case.camera, &case.options) {
        Err(Error::Limit(text)) => {
            row.refused = Some(text);
            return Ok(row);
        }
        drawn => drawn?,
    };
    (row.pixels, row.columns) = (frame.depth.len(), frame.stats.columns_visited);
    if let Err(fault) = sane(&frame) {
        row.faults.push(fault);
        return Ok(row);
    }
    let percent = |n: usize| 100.0 * n as f64 / row.pixels as f64;

    row.cracks = cracks(&frame, case.expect);
    let off = off(&frame, &truth.frame, world, &case.camera, &case.options);
    row.off_percent = percent(off.len());
    let wrong = match frame.stats.kernel != "inside" && (drawer.exact || tests_rays(case, world)) {
        true => wrong(&frame, &truth.frame, world, &case.camera, &case.options),
        false => Vec::new(),
    };
    row.wrong_percent = percent(wrong.len());
    row.depth = depth_error(&frame, &truth.frame);
    let again = (drawer.draw)(&case.camera, &case.options)?;
    let same = same_bits(&frame, &again);
    let cameras = further(&case.camera);
    for (k, (camera, truth_further)) in cameras.iter().zip(&truth.further).enumerate() {
        let moved = (drawer.draw)(camera, &case.options)?;
        let beyond = self::moved(&frame, &moved).saturating_sub(self::moved(&truth.frame, truth_further));
        row.moved_percent[k] = percent(beyond);
        row.depth_ulps[k] = depth_ulps(&frame, &moved).saturating_sub(depth_ulps(&truth.frame, truth_further));
    }

    let shown = |i: usize| {
        let pixel = (i % frame.width as usize, i / frame.width as usize);
        let [(voxel, depth), (exact, exact_depth)] = [&frame, &truth.frame].map(|f| (f.voxel[i], f.depth[i]));
        format!("the first, {pixel:?}, shows {voxel:?} at {depth}, exact {exact:?} at {exact_depth}")
    };
    if row.cracks > 0 {
        row.faults.push(format!("{} pixels are not {:?}", row.cracks, case.expect));
    }
    if row.off_percent > case.bound_off {
        row.faults.push(format!(
            "{:.3} % of the pixels are off, at most {} % may be; {}",
            row.off_percent,
            case.bound_off,
            shown(off[0])
        ));
    }
    if row.wrong_percent > case.bound_wrong {
        row.faults.push(format!(
            "{:.3} % of the pixels show what their own rays do not, at most {} % may; {}",
            row.wrong_percent,
            case.bound_wrong,
            shown(wrong[0])
        ));
    }
    if row.depth > case.bound_depth {
        row.faults.push(format!("a depth is {:.1e} wrong, at most {:e} may be", row.depth, case.bound_depth));
    }
    if let Err(what) = same {
        row.faults.push(format!("drawn twice, {what}"));
    }
    for (k, what) in ["yaw", "pitch", "the eye's x"].iter().enumerate() {
        if row.moved_percent[k] > case.bound_moved {
            row.faults.push(format!("one ulp of {what} moves {:.3} % of the pixels", row.moved_percent[k]));
        }
    }
    if !drawer.exact && frame.stats.kernel != "inside" {
        let setup = plane_setup(&world.resident, &case.camera, &case.options);
        row.bound_steps = setup.planes.iter().map(|p| setup.step_bound(p)).max().unwrap_or(0);
        if frame.stats.kernel == "planes" {
            let steps = most_steps(world, &case.camera, &case.options);
            row.steps = Some(steps);
            if steps > row.bound_steps {
                row.faults.push(format!("a plane looks at {steps} columns, at most {} can be", row.bound_steps));
            }
        }
        // Rays are as many as pixels; planes as the setup says.
        let all = match frame.stats.kernel.as_str() {
            "raycast" | "raycast-runs" => row.bound_steps * row.pixels as u64,
            // Two columns a slice of the plane's longer axis, looked at before it is known whether nearer ones hide them.
            "workgroup" => 2 * setup.planes.iter().map(|p| setup.step_bound(p)).sum::<u64>(),
            _ => setup.planes.iter().map(|p| setup.step_bound(p)).sum(),
        };
        if row.columns > all {
            row.faults.push(format!("the frame looks at {} columns, at most {all} can be", row.columns));
        }
    }
    Ok(row)
}

/// Whether each pixel holds something a frame may hold: depth 0 or more and not NaN, alpha 255, and voxel and depth agreeing
/// on sky. If not, the first pixel that does not.
pub fn sane(frame: &Frame) -> Result<(), String> {
    let w = frame.width as usize;
    let n = w * frame.height as usize;
    if [frame.color.len(), frame.depth.len(), frame.voxel.len()] != [n; 3] {
        return Err("the frame is not whole".into());
    }
    for (i, (&depth, color)) in frame.depth.iter().zip(&frame.color).enumerate() {
        let (voxel, at) = (frame.voxel[i], (i % w, i / w));
        if depth.is_nan() || depth < 0.0 {
            return Err(format!("pixel {at:?} has depth {depth}"));
        }
        if color[3] != 255 {
            return Err(format!("pixel {at:?} has alpha {}", color[3]));
        }
        if (voxel == SKY) != (depth == f32::INFINITY) {
            return Err(format!("pixel {at:?} shows {voxel:?} at depth {depth}"));
        }
    }
    Ok(())
}

/// Pixels that are not what all must be.
pub fn cracks(frame: &Frame, expect: Expect) -> usize {
    let wrong = |i: &usize| match expect {
        Expect::Any => false,
        Expect::Closed => frame.voxel[*i] == SKY,
        Expect::Sky => frame.voxel[*i] != SKY,
        Expect::Inside => frame.depth[*i] != 0.0 || frame.voxel[*i] != frame.voxel[0],
    };
    (0..frame.depth.len()).filter(wrong).count()
}

fn same_bits(a: &Frame, b: &Frame) -> Result<(), String> {
    let bits = |f: &Frame| f.depth.iter().map(|d| d.to_bits()).collect::<Vec<_>>();
    if a.color != b.color || a.voxel != b.voxel || bits(a) != bits(b) {
        let n = (0..a.depth.len()).filter(|&i| a.color[i] != b.color[i] || a.voxel[i] != b.voxel[i]).count();
        return Err(format!("{n} pixels differ in colour or voxel, others perhaps in depth"));
    }
    Ok(())
}

/// The pixels around one, itself included.
fn around(frame: &Frame, i: usize) -> impl Iterator<Item = usize> + use<> {
    let (w, h) = (frame.width as usize, frame.height as usize);
    let near = |v: usize, n: usize| v.saturating_sub(1)..(v + 2).min(n);
    near(i / w, h).flat_map(move |y| near(i % w, w).map(move |x| y * w + x))
}

/// Pixels of `frame` that show what no ray within [`REACH`] of theirs meets. A voxel of a coarse level counts as met where
/// a ray meets its box before it is two such voxels behind what it meets at level 0: the rule that builds levels thickens.
pub fn off(frame: &Frame, exact: &Frame, world: &World, camera: &Camera, options: &Options) -> Vec<usize> {
    let sight = Sight::new(world, camera, options);
    let shown = |i: &usize| {
        let voxel = frame.voxel[*i];
        around(exact, *i).any(|j| exact.voxel[j] == voxel) || sight.can_show(*i, voxel)
    };
    (0..frame.voxel.len()).filter(|i| !shown(i)).collect()
}

/// As [`off`], of the pixels' own rays: what a ray within [`CENTRE`] of a pixel's centre meets.
pub fn wrong(frame: &Frame, exact: &Frame, world: &World, camera: &Camera, options: &Options) -> Vec<usize> {
    let sight = Sight { reach: CENTRE, ..Sight::new(world, camera, options) };
    let shown = |i: &usize| exact.voxel[*i] == frame.voxel[*i] || sight.can_show(*i, frame.voxel[*i]);
    (0..frame.voxel.len()).filter(|i| !shown(i)).collect()
}

/// Whether the pixels of a case test voxels against their own rays.
fn tests_rays(case: &Case, world: &World) -> bool {
    plane_setup(&world.resident, &case.camera, &case.options).retests(&case.camera, &case.options)
}

/// f64 rays into a world.
struct Sight<'a> {
    world: &'a World,
    camera: &'a Camera,
    basis: Basis,
    repeats: [bool; 2],
    view: f64,
    reach: f64,
}

impl<'a> Sight<'a> {
    fn new(world: &'a World, camera: &'a Camera, options: &Options) -> Sight<'a> {
        let repeats = [options.repeat.x, options.repeat.z];
        let without_end = !options.view_distance.is_finite() && repeats != [false; 2];
        let view = if without_end { REPEATED_VIEW_DISTANCE } else { options.view_distance };
        Sight { world, camera, basis: camera.basis(), repeats, view, reach: REACH }
    }

    /// What a ray meets at level 0, and at which parameter.
    fn meet(&self, ray: DVec3) -> ([i32; 4], f64) {
        let horizontal = ray.x.hypot(ray.z);
        let t_max = if horizontal > 0.0 { self.view / horizontal } else { f64::INFINITY };
        let columns = self.world.scene.levels[0].geometry(self.world.scene.encoding);
        match cast(columns, self.repeats, self.camera.eye, ray, t_max) {
            None => (SKY, f64::INFINITY),
            Some(hit) => ([hit.voxel[0] as i32, hit.voxel[1] as i32, hit.voxel[2] as i32, 0], hit.t),
        }
    }

    fn can_show(&self, i: usize, voxel: [i32; 4]) -> bool {
        let w = self.camera.width as usize;
        let (x, y) = ((i % w) as f64 + 0.5, (i / w) as f64 + 0.5);
        if voxel[3] > 0 && !self.solid(voxel) {
            return false;
        }
        // From the centre outwards, since most pixels are settled by the first ray: 0, −1, 1, −2, …
        let step = 2.0 * self.reach / f64::from(RAYS - 1);
        let beside = |k: u32| step * f64::from(k.div_ceil(2)) * if k.is_multiple_of(2) { 1.0 } else { -1.0 };
        (0..RAYS * RAYS).any(|k| {
            let ray = self.camera.ray(&self.basis, x + beside(k % RAYS), y + beside(k / RAYS));
            if voxel == SKY {
                return self.meet(ray).0 == SKY;
            }
            let Some(enter) = self.enter(voxel, ray) else { return false };
            let (met, t) = self.meet(ray);
            met == voxel || (voxel[3] > 0 && enter <= t + 2.0 * f64::from(1u32 << voxel[3]))
        })
    }

    /// Whether a cell of a coarse level is solid.
    fn solid(&self, [x, y, z, l]: [i32; 4]) -> bool {
        let Some(level) = self.world.scene.levels.get(l as usize) else { return false };
        let [nx, _, nz] = self.world.scene.dims().map(i64::from);
        let place =
            |v: i32, n: i64, repeats: bool| if repeats { i64::from(v).rem_euclid(n) } else { i64::from(v) } >> l;
        level.solid.solid(place(x, nx, self.repeats[0]), i64::from(y >> l), place(z, nz, self.repeats[1]))
    }

    /// The parameter at which a ray enters a voxel's box. One that the eye touches and the ray leaves is not entered.
    fn enter(&self, voxel: [i32; 4], ray: DVec3) -> Option<f64> {
        let (mut near, mut far) = (0.0f64, f64::INFINITY);
        for axis in 0..3 {
            let from = f64::from(voxel[axis]) - self.camera.eye[axis];
            let to = from + f64::from(1u32 << voxel[3]);
            if ray[axis] == 0.0 {
                if from > 0.0 || to <= 0.0 {
                    return None;
                }
                continue;
            }
            let (a, b) = (from / ray[axis], to / ray[axis]);
            (near, far) = (near.max(a.min(b)), far.min(a.max(b)));
        }
        (near <= far && far > 0.0).then_some(near)
    }
}

/// Greatest relative error of depth where both frames show one voxel and are not in touch with it.
fn depth_error(frame: &Frame, exact: &Frame) -> f64 {
    let same = (0..frame.voxel.len()).filter(|&i| frame.voxel[i] == exact.voxel[i] && frame.voxel[i] != SKY);
    // Nearer than this the relative error of a depth says nothing: it is that of the eye's place in its voxel.
    same.map(|i| (f64::from(frame.depth[i]), f64::from(exact.depth[i])))
        .map(|(a, b)| (a - b).abs() / b.abs().max(1e-3))
        .fold(0.0, f64::max)
}

/// Pixels that show in `after` what none around showed in `before`.
fn moved(before: &Frame, after: &Frame) -> usize {
    (0..after.voxel.len()).filter(|&i| !around(before, i).any(|j| before.voxel[j] == after.voxel[i])).count()
}

/// Greatest change of a depth, in ulps, where both frames show one voxel.
fn depth_ulps(before: &Frame, after: &Frame) -> u32 {
    let same = (0..after.voxel.len()).filter(|&i| before.voxel[i] == after.voxel[i]);
    same.map(|i| before.depth[i].to_bits().abs_diff(after.depth[i].to_bits())).max().unwrap_or(0)
}

/// Columns that the plane looks at that looks at most of them: each is walked alone.
pub fn most_steps(world: &World, camera: &Camera, options: &Options) -> u64 {
    let Setup { planes, fans, .. } = plane_setup(&world.resident, camera, options);
    let mut alone = plane_setup(&world.resident, camera, options);
    let mut buffer = PlaneBuffer::default();
    let mut most = 0;
    for fan in &fans {
        alone.fans = Default::default();
        alone.fans[0] = Fan { first_plane: 0, n_planes: 1, first_sample: 0, ..*fan };
        alone.samples = fan.n_samples as usize;
        for plane in &planes[fan.first_plane as usize..(fan.first_plane + fan.n_planes) as usize] {
            alone.planes = vec![Plane { base: 0, ..*plane }];
            let counters = traverse::<f32>(&world.resident, &alone, options.culling, &mut buffer, true);
            most = most.max(counters.columns_visited);
        }
    }
    most
}
