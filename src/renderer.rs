//! One frame from camera to picture, stage by stage.

use crate::camera::Camera;
use crate::clock::Instant;
use crate::cpu::traverse::{Counters, PlaneBuffer, Real, SKY};
use crate::cpu::{gap_fill, raycast, refine, remap, resize, shade};
use crate::error::{Error, Result};
use crate::frame::{Frame, StageTimes, Stats};
use crate::options::{Options, Planes, SAMPLES_LIMIT, SSAO_SAMPLES_LIMIT, Shading};
use crate::plane_setup::{EYE_LIMIT, Plane, Setup, plane_setup_in};
use crate::resident::Resident;
use crate::specialize::{Specialization, Twin};
use crate::tree::Tree;
use planecast_encoder::{ColorMode, Scene};
use std::sync::Arc;

/// Pixels a frame may have.
pub const PIXEL_LIMIT: u64 = 1 << 28;

/// Draws frames of one scene on the CPU. Keeps its buffers from frame to frame.
pub struct CpuRenderer {
    scene: Arc<Scene>,
    resident: Arc<Resident>,
    /// Memory of the latest frame's planes.
    planes: Vec<Plane>,
    buffer: PlaneBuffer,
    color: Vec<u32>,
    index: Vec<u32>,
    doubt: Vec<refine::Doubt>,
    /// A frame whose memory the next one takes.
    spare: Option<Frame>,
    shade: shade::Scratch,
    /// Rays instead of planes, and the tree that they are cast through, once there is one.
    casts_rays: bool,
    tree: Option<Tree>,
}

/// What is wanted beside colour and depth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Outputs {
    pub voxel: bool,
}

/// Whether a camera and options can be drawn at all; the error says what is allowed.
pub fn check(camera: &Camera, options: &Options) -> Result<()> {
    let argument = |text: String| Err(Error::Argument(text));
    if camera.width == 0 || camera.height == 0 {
        return argument(format!("image of {} × {} pixels: both must be at least 1", camera.width, camera.height));
    }
    if u64::from(camera.width) * u64::from(camera.height) > PIXEL_LIMIT {
        return Err(Error::Limit(format!(
            "image of {} × {} pixels: at most {PIXEL_LIMIT} pixels are drawn at once",
            camera.width, camera.height
        )));
    }
    if !(camera.fov > 0.0 && camera.fov < 180.0) {
        return argument(format!("field of view of {} degrees: must be above 0 and below 180", camera.fov));
    }
    if !(-90.0..=90.0).contains(&camera.pitch) || !camera.yaw.is_finite() || !camera.roll.is_finite() {
        return argument(format!(
            "yaw {}, pitch {}, roll {} degrees: must be finite, pitch from -90 to 90",
            camera.yaw, camera.pitch, camera.roll
        ));
    }
    let eye = camera.eye.to_array();
    let repeats = [options.repeat.x, false, options.repeat.z];
    for (axis, name) in ["x", "y", "z"].iter().enumerate() {
        // Beyond 2⁵² an f64 no longer tells neighbouring voxels apart.
        let limit = if repeats[axis] { (1u64 << 52) as f64 } else { EYE_LIMIT };
        if eye[axis].is_nan() || eye[axis].abs() > limit {
            return argument(format!("eye {name} = {:?}: must be within ±{limit:e} voxels", eye[axis]));
        }
    }
    if options.view_distance.is_nan() || options.view_distance <= 0.0 {
        return argument(format!("view distance {}: must be above 0", options.view_distance));
    }
    if options.lod.is_some_and(|px| px.is_nan() || px <= 0.0) {
        return argument(format!("level of detail of {} pixels: must be above 0, or off", options.lod.unwrap_or(0.0)));
    }
    if !(1..=SSAO_SAMPLES_LIMIT).contains(&options.ssao_samples) {
        return argument(format!("{} occlusion samples: must be 1 to {SSAO_SAMPLES_LIMIT}", options.ssao_samples));
    }
    if let Some([azimuth, elevation]) = options.sun
        && !(azimuth.is_finite() && (-90.0..=90.0).contains(&elevation))
    {
        return argument(format!(
            "sun at azimuth {azimuth}, elevation {elevation} degrees: must be finite, elevation from -90 to 90"
        ));
    }
    if !(options.samples > 0.0 && options.samples <= SAMPLES_LIMIT) {
        let most = SAMPLES_LIMIT * 100.0;
        return argument(format!("{} % of samples: must be above 0 and at most {most} %", options.samples * 100.0));
    }
    // Pixels become samples in whole numbers of 32 bits.
    let side = u64::from(camera.width.max(camera.height));
    if options.samples != 1.0 && (2 * side + 1) * (side as f64 * options.samples).ceil() as u64 > u64::from(u32::MAX) {
        let percent = options.samples * 100.0;
        return Err(Error::Limit(format!(
            "{percent} % of samples in a picture of {side} pixels a side: use fewer pixels, or 100 %"
        )));
    }
    match options.planes {
        Planes::Count(n) if !(1..=1_000_000).contains(&n) => argument(format!("{n} planes: must be 1 to 1,000,000")),
        Planes::Factor(f) if !(f > 0.0 && f <= 64.0) => {
            argument(format!("{} % of planes: must be above 0 and at most 6400 %", f * 100.0))
        }
        _ => Ok(()),
    }
}

fn milliseconds(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e3
}

impl CpuRenderer {
    pub fn new(scene: &Arc<Scene>, resident: &Arc<Resident>) -> CpuRenderer {
        let (scene, resident) = (Arc::clone(scene), Arc::clone(resident));
        let (color, index, doubt) = (Vec::new(), Vec::new(), Vec::new());
        let (buffer, shade) = (PlaneBuffer::default(), shade::Scratch::default());
        let (casts_rays, tree) = (false, None);
        CpuRenderer {
            scene,
            resident,
            planes: Vec::new(),
            buffer,
            color,
            index,
            doubt,
            spare: None,
            shade,
            casts_rays,
            tree,
        }
    }

    /// Draws by one ray a pixel through a [`Tree`] from the next frame on, or by planes. The first such frame makes the tree.
    pub fn set_raycast(&mut self, casts_rays: bool) {
        self.casts_rays = casts_rays;
    }

    /// The tree that rays are cast through.
    ///
    /// # Errors
    /// [`Error::Limit`] where it takes more than 2³² words.
    pub fn tree(&mut self) -> Result<&Tree> {
        if self.tree.is_none() {
            self.tree = Some(Tree::new(&self.resident)?);
        }
        Ok(self.tree.as_ref().expect("it was made above"))
    }

    /// Gives a frame back that is done with: the next one takes its memory, already touched.
    pub fn reuse(&mut self, frame: Option<Frame>) {
        self.spare = frame.or(self.spare.take());
    }

    /// Draws one frame by forward projection in planes.
    pub fn render(&mut self, camera: &Camera, options: &Options, outputs: Outputs) -> Result<Frame> {
        check(camera, options)?;
        if let Some(frame) = inside_solid(&self.scene, &self.resident, camera, options, outputs) {
            return Ok(frame);
        }
        if self.casts_rays {
            self.tree()?;
        }
        let mut frame = self.frame(camera, outputs);
        let start = Instant::now();

        let setup = plane_setup_in(std::mem::take(&mut self.planes), &self.resident, camera, options);
        let setup_ms = milliseconds(start);

        let at = Instant::now();
        let retest = setup.retests(camera, options);
        let voxels = outputs.voxel || retest;
        let traverse = if options.f64_traversal { f64::traverse } else { f32::traverse };
        let specialization = Specialization::new(&self.resident, &setup, camera, options, Twin::Cpu);
        let counters = match self.tree.as_ref().filter(|_| self.casts_rays) {
            Some(tree) => {
                let (color, depth, voxel) = (&mut self.color, &mut frame.depth, &mut frame.voxel);
                raycast::raycast(&self.resident, tree, &setup, camera, color, depth, voxel)
            }
            None => traverse(&self.resident, &setup, options.culling, specialization, &mut self.buffer, voxels),
        };
        let traverse_ms = milliseconds(at);

        let at = Instant::now();
        let holes = match self.casts_rays {
            true => {
                frame.voxel.iter_mut().for_each(|v| *v = world_voxel(&setup, *v));
                [0, 0]
            }
            false => self.remap(&setup, camera, options, retest, &mut frame),
        };
        let remap_ms = milliseconds(at);

        let at = Instant::now();
        self.shade(camera, options, &mut frame);
        let shade_ms = milliseconds(at);

        let kernel = if self.casts_rays { "raycast" } else { "planes" };
        frame.stats = frame_stats(&self.scene, &self.resident, camera, options, "cpu", kernel);
        frame.stats.planes = setup.planes.len() as u32;
        frame.stats.planes_full = setup.planes_full;
        frame.stats.levels = self.resident.levels.len() as u32;
        frame.stats.levels_drawn = setup.levels;
        frame.stats.left_out = specialization.left_out();
        [frame.stats.holes, _] = holes;
        frame.stats.count(counters);
        frame.stats.cpu_ms = Some(StageTimes {
            setup: setup_ms,
            traverse: traverse_ms,
            remap: remap_ms,
            shade: shade_ms,
            total: milliseconds(start),
        });
        self.planes = setup.planes;
        Ok(frame)
    }

    /// Draws one frame with one f64 ray a pixel at level 0.
    pub fn exact(&mut self, camera: &Camera, options: &Options, outputs: Outputs) -> Result<Frame> {
        check(camera, options)?;
        if let Some(frame) = inside_solid(&self.scene, &self.resident, camera, options, outputs) {
            return Ok(frame);
        }
        let mut frame = self.frame(camera, outputs);
        let start = Instant::now();
        let (color, depth, voxel) = (&mut self.color, &mut frame.depth, &mut frame.voxel);
        crate::exact::exact(&self.scene, &self.resident, camera, options, color, depth, voxel);
        let traverse_ms = milliseconds(start);
        let at = Instant::now();
        self.shade(camera, options, &mut frame);
        frame.stats = frame_stats(&self.scene, &self.resident, camera, options, "exact", "exact");
        frame.stats.cpu_ms = Some(StageTimes {
            traverse: traverse_ms,
            shade: milliseconds(at),
            total: milliseconds(start),
            ..StageTimes::default()
        });
        Ok(frame)
    }

    fn shade(&mut self, camera: &Camera, options: &Options, frame: &mut Frame) {
        let params = shade::ShadeParams::new(camera, options);
        shade::shade(&params, &self.color, &frame.depth, &mut self.shade, &mut frame.color);
    }

    fn frame(&mut self, camera: &Camera, outputs: Outputs) -> Frame {
        let frame = match self.spare.take() {
            Some(mut spare) => {
                let n = camera.width as usize * camera.height as usize;
                (spare.width, spare.height, spare.stats) = (camera.width, camera.height, Stats::default());
                // What is there is drawn over, all of it; of voxels only those that are not sky.
                resize(&mut spare.color, n, [0; 4]);
                resize(&mut spare.depth, n, 0.0);
                spare.voxel.clear();
                spare.voxel.resize(if outputs.voxel { n } else { 0 }, SKY);
                spare
            }
            None => empty_frame(camera, outputs),
        };
        resize(&mut self.color, frame.depth.len(), 0);
        frame
    }

    /// Remap and, where planes are more than a pixel apart, gap fill. Returns holes before and after.
    fn remap(
        &mut self,
        setup: &Setup,
        camera: &Camera,
        options: &Options,
        retest: bool,
        frame: &mut Frame,
    ) -> [u64; 2] {
        let width = frame.width;
        // Planes at most a pixel apart reach every pixel.
        let sparse = setup.is_sparse();
        if retest {
            let doubts = if setup.refines(camera, options) { self.color.len() } else { 0 };
            resize(&mut self.doubt, doubts, refine::Doubt::NONE);
            let mut pixels = remap::Pixels {
                color: &mut self.color,
                depth: &mut frame.depth,
                voxel: &mut frame.voxel,
                doubt: &mut self.doubt,
            };
            remap::remap_retest(&self.resident, setup, &self.buffer, camera, &mut pixels);
            refine::refine(&self.resident, setup, camera, &mut pixels);
            for v in &mut frame.voxel {
                *v = world_voxel(setup, *v);
            }
            return [0, 0];
        }
        if !sparse && frame.voxel.is_empty() {
            remap::remap(setup, &self.buffer, width, &mut self.color, &mut frame.depth);
            return [0, 0];
        }
        resize(&mut self.index, self.color.len(), 0);
        remap::remap_index(setup, width, &mut self.index);
        let mut holes = [self.index.iter().filter(|&&i| i == remap::HOLE).count() as u64; 2];
        if options.gap_fill {
            holes = gap_fill::gap_fill(setup, width, &mut self.index);
        }
        for (pixel, &i) in self.index.iter().enumerate() {
            let i = i as usize;
            if i == remap::HOLE as usize {
                (self.color[pixel], frame.depth[pixel]) = (0, f32::INFINITY);
                continue;
            }
            (self.color[pixel], frame.depth[pixel]) = (self.buffer.color[i], self.buffer.depth[i]);
            if let Some(voxel) = frame.voxel.get_mut(pixel) {
                *voxel = world_voxel(setup, self.buffer.voxel[i]);
            }
        }
        holes
    }
}

/// An eye inside a solid voxel sees that voxel at depth 0 in every pixel.
pub(crate) fn inside_solid(
    scene: &Scene,
    resident: &Resident,
    camera: &Camera,
    options: &Options,
    outputs: Outputs,
) -> Option<Frame> {
    let [nx, ny, nz] = scene.dims();
    let cell = camera.eye.floor();
    let place = |v: f64, n: u32, repeat: bool| {
        let v = v as i64;
        if repeat { Some(v.rem_euclid(i64::from(n)) as u32) } else { u32::try_from(v).ok().filter(|&v| v < n) }
    };
    let x = place(cell.x, nx, options.repeat.x)?;
    let y = place(cell.y, ny, false)?;
    let z = place(cell.z, nz, options.repeat.z)?;
    let solid = &scene.levels[0].solid;
    solid.find(x, y, z)?;
    // Which run of the geometry holds it: a surface scene's interior lies in none.
    let geometry = scene.levels[0].geometry(scene.encoding);
    let column = geometry.index(x, z);
    let range = geometry.range(column);
    let k = geometry.find(x, y, z).map_or(0, |run| (range.end - 1 - run) as u32);
    let color = resident.levels[0].paint.color(column, k, y);
    let mut frame = empty_frame(camera, outputs);
    frame.depth.fill(0.0);
    frame.color.fill((color | 0xFF00_0000).to_le_bytes());
    frame.voxel.fill([cell.x as i32, cell.y as i32, cell.z as i32, 0]);
    frame.stats = frame_stats(scene, resident, camera, options, "cpu", "inside");
    frame.stats.cpu_ms = Some(StageTimes::default());
    Some(frame)
}

/// A frame without a picture yet.
fn empty_frame(camera: &Camera, outputs: Outputs) -> Frame {
    let n = camera.width as usize * camera.height as usize;
    let (mut color, mut depth) = (Vec::new(), Vec::new());
    resize(&mut color, n, [0; 4]);
    resize(&mut depth, n, 0.0);
    Frame {
        width: camera.width,
        height: camera.height,
        color,
        depth,
        voxel: vec![SKY; if outputs.voxel { n } else { 0 }],
        stats: Stats::default(),
    }
}

/// What is known of a frame before it is drawn.
pub(crate) fn frame_stats(
    scene: &Scene,
    resident: &Resident,
    camera: &Camera,
    options: &Options,
    device: &str,
    kernel: &str,
) -> Stats {
    let mut specialization = Vec::new();
    match scene.color {
        ColorMode::None => {}
        ColorMode::Run => specialization.push("color-run".into()),
        ColorMode::Voxel => specialization.push("color-voxel".into()),
    }
    if options.repeat.x || options.repeat.z {
        specialization.push("repeat".into());
    }
    if options.lod.is_some() {
        specialization.push("levels".into());
    }
    match options.shading {
        Shading::None => {}
        Shading::Ssn => specialization.push("ssn".into()),
        Shading::Ssao => specialization.push("ssao".into()),
        Shading::Full => specialization.extend(["ssn".into(), "ssao".into()]),
    }
    Stats {
        device: device.into(),
        kernel: kernel.into(),
        levels: resident.levels.len() as u32,
        width: camera.width,
        height: camera.height,
        specialization,
        ..Stats::default()
    }
}

/// From a voxel as planes store it, in cells of its level, to level-0 world coordinates and the level.
fn world_voxel(setup: &Setup, voxel: [i32; 4]) -> [i32; 4] {
    if voxel == SKY {
        return SKY;
    }
    let [x, y, z, l] = voxel;
    let world = |v: i32, axis: usize| ((i64::from(v) << l) + setup.period_offset[axis]) as i32;
    [world(x, 0), y << l, world(z, 1), l]
}

impl Stats {
    fn count(&mut self, counters: Counters) {
        self.columns_visited = counters.columns_visited;
        self.runs_visited = counters.runs_visited;
        self.spans_drawn = counters.spans_drawn;
    }
}
