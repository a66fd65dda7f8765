//! One frame from camera to picture, stage by stage.

use crate::clock::Instant;
use crate::cpu::normal::Occupancy;
use crate::cpu::shade::NormalsOf;
use crate::cpu::shadow::{ExactShadows, Shadows, Sunlight, Tops};
use crate::cpu::smooth::{self, Ground};
use crate::cpu::sphere::Sphere;
use crate::cpu::traverse::{Counters, PlaneBuffer, Real, SKY};
use crate::cpu::{exact_matter, gap_fill, matter, raycast, refine, remap, resize, shade, shade_rays};
use crate::error::{Error, Result};
use crate::frame::camera::Camera;
use crate::frame::options::{Normals, Options, Planes, Remap, SAMPLES_LIMIT, SSAO_SAMPLES_LIMIT, Shading};
use crate::frame::picture::{Frame, PagingStats, StageTimes, Stats};
use crate::frame::plan::FramePlan;
use crate::frame::plane_setup::sphere::Layout;
use crate::frame::plane_setup::{EYE_LIMIT, Plane, Setup, plane_setup};
use crate::frame::projection::{Projection, Rays, face_cameras, join_faces};
use crate::frame::specialize::{Specialization, Twin};
use crate::world::tables::{Paint, Resident};
use crate::world::tree::Tree;
use planecast_encoder::{ColorMode, Encoding, Run, Scene};
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

/// Pixels a frame may have.
pub const PIXEL_LIMIT: u64 = 1 << 28;

/// Pixels up to which a picture of many is drawn by one thread.
const ALONE_PIXELS: u64 = 1 << 20;

/// Samples of the sphere that is kept while the eye rests, for each pixel in the middle of a picture.
const SPHERE_DENSITY: f64 = 1.2;

/// Samples of a sphere at most: at 24 bytes each, 6 GiB.
const SPHERE_LIMIT: u64 = 1 << 28;

/// Draws frames of one scene on the CPU. Keeps its buffers from frame to frame.
pub struct CpuRenderer {
    /// None of a world whose tiles are not all there.
    scene: Option<Arc<Scene>>,
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
    /// Made for the first frame with shadows.
    tops: Option<Arc<Tops>>,
    /// The same of the first that is smooth, and along which axes its world repeats.
    surface: Option<(Arc<Tops>, [bool; 2])>,
    /// Of the latest eye.
    sphere: Option<Box<Sphere>>,
    /// The latest view, while frames may keep their sphere.
    rests: Option<(Camera, Options)>,
    keeps: bool,
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
    options.projection.check(camera)?;
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
        CpuRenderer::of(Some(Arc::clone(scene)), Arc::clone(resident))
    }

    /// Draws from tables alone: by planes, in perspective, without shadows and surfaces.
    pub fn of_tables(resident: Arc<Resident>) -> CpuRenderer {
        CpuRenderer::of(None, resident)
    }

    pub fn tables(&self) -> &Resident {
        &self.resident
    }

    /// The tables, to be changed between frames; `None` while others have them too.
    pub fn tables_mut(&mut self) -> Option<&mut Resident> {
        Arc::get_mut(&mut self.resident)
    }

    pub(crate) fn of(scene: Option<Arc<Scene>>, resident: Arc<Resident>) -> CpuRenderer {
        let (color, index, doubt) = (Vec::new(), Vec::new(), Vec::new());
        let (buffer, shade) = (PlaneBuffer::default(), shade::Scratch::default());
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
            tops: None,
            surface: None,
            sphere: None,
            rests: None,
            keeps: false,
            casts_rays: false,
            tree: None,
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
        let options = &options.drawn();
        match options.projection {
            Projection::Perspective if self.rests_at(camera, options) => {
                return self.render_sphere(camera, options, outputs);
            }
            Projection::Perspective => {}
            Projection::Cube => return self.render_cube(camera, options, outputs),
            Projection::Ortho { .. } => return self.rays(camera, options, outputs, "cpu"),
            _ => return self.render_sphere(camera, options, outputs),
        }
        let plan = self.plan(camera, options);
        self.draw(plan, outputs)
    }

    /// Decides about one frame in perspective.
    pub(crate) fn plan(&mut self, camera: &Camera, options: &Options) -> FramePlan {
        FramePlan::new_in(std::mem::take(&mut self.planes), &self.resident, camera, options)
    }

    /// Draws what was decided about a frame in perspective.
    pub(crate) fn draw(&mut self, plan: FramePlan, outputs: Outputs) -> Result<Frame> {
        let (camera, options) = (&plan.camera, &plan.options);
        if let Some(frame) = inside_solid(self.scene.as_deref(), &self.resident, camera, options, outputs) {
            self.planes = plan.setup.planes;
            return Ok(frame);
        }
        if self.casts_rays {
            self.tree()?;
        }
        let mut frame = self.frame(camera, outputs);

        let at = Instant::now();
        let start = at;
        let retest = plan.retests();
        let voxels = outputs.voxel || retest;
        let traverse = if options.f64_traversal { f64::traverse } else { f32::traverse };
        let specialization = plan.specialization(&self.resident, Twin::Cpu);
        let setup = &plan.setup;
        let counters = match self.tree.as_ref().filter(|_| self.casts_rays) {
            Some(tree) => {
                let (color, depth, voxel) = (&mut self.color, &mut frame.depth, &mut frame.voxel);
                raycast::raycast(&self.resident, tree, setup, camera, color, depth, voxel)
            }
            None => traverse(&self.resident, setup, options.culling, specialization, &mut self.buffer, voxels),
        };
        let traverse_ms = milliseconds(at);

        let at = Instant::now();
        let holes = match self.casts_rays {
            true => {
                frame.voxel.iter_mut().for_each(|v| *v = world_voxel(setup, *v));
                [0, 0]
            }
            false => self.remap(&plan, retest, &mut frame),
        };
        if options.smooth {
            self.smooth(setup, camera, &mut frame);
        }
        let remap_ms = milliseconds(at);

        let at = Instant::now();
        self.shade(camera, options, Some(setup), &mut frame);
        self.matter(camera, options, &mut frame);
        let shade_ms = milliseconds(at);

        let kernel = if self.casts_rays { "raycast" } else { "planes" };
        frame.stats = frame_stats(&self.resident, camera, options, "cpu", kernel);
        of_planes(&mut frame.stats, setup, specialization, counters);
        [frame.stats.holes, _] = holes;
        frame.stats.cpu_ms = Some(StageTimes {
            setup: plan.setup_ms,
            traverse: traverse_ms,
            remap: remap_ms,
            shade: shade_ms,
            total: plan.setup_ms + milliseconds(start),
        });
        self.planes = plan.setup.planes;
        Ok(frame)
    }

    /// Draws pictures of any sizes, each thread one whole at a time, and hands them on as they are done, in any order; `done` may
    /// give the frame back, whose memory another takes. Its first error ends the work.
    pub fn each(
        &mut self,
        cameras: &[Camera],
        exact: bool,
        options: &Options,
        outputs: Outputs,
        done: &(dyn Fn(usize, Frame) -> Result<Option<Frame>> + Sync),
    ) -> Result<()> {
        let threads = rayon::current_num_threads().min(cameras.len());
        let (next, failure) = (AtomicUsize::new(0), Mutex::new(None::<(usize, Error)>));
        let work = |cpu: &mut CpuRenderer| {
            loop {
                let i = next.fetch_add(1, Ordering::Relaxed);
                let Some(camera) = cameras.get(i) else { return };
                let drawn = match exact {
                    true => cpu.exact(camera, options, outputs),
                    false => cpu.render(camera, options, outputs),
                };
                match drawn.and_then(|frame| done(i, frame)) {
                    Ok(spare) => cpu.reuse(spare),
                    Err(e) => {
                        // None begins another.
                        next.store(cameras.len(), Ordering::Relaxed);
                        let mut failure = failure.lock().expect("no holder panics");
                        if failure.as_ref().is_none_or(|(before, _)| i < *before) {
                            *failure = Some((i, e));
                        }
                        return;
                    }
                }
            }
        };
        // Larger pictures are spread over the threads by themselves, in less memory.
        let large = |c: &Camera| u64::from(c.width) * u64::from(c.height) > ALONE_PIXELS;
        if threads < 2 || cameras.iter().any(large) {
            work(self);
        } else {
            std::thread::scope(|scope| {
                for _ in 0..threads {
                    let mut cpu = CpuRenderer::of(self.scene.clone(), Arc::clone(&self.resident));
                    let work = &work;
                    scope.spawn(move || {
                        // What would be spread over all threads stays in one.
                        match rayon::ThreadPoolBuilder::new().num_threads(1).build() {
                            Ok(pool) => pool.install(|| work(&mut cpu)),
                            Err(_) => work(&mut cpu),
                        }
                    });
                }
            });
        }
        failure.into_inner().expect("no holder panics").map_or(Ok(()), |(_, e)| Err(e))
    }

    /// Whether planes are kept while the eye rests, so that turning costs little: [`CpuRenderer::render`] then takes them from
    /// the second frame of an eye on. Their memory is that of ten pictures.
    pub fn keep_sphere(&mut self, keeps: bool) {
        self.keeps = keeps;
        if !keeps {
            (self.sphere, self.rests) = (None, None);
        }
    }

    /// Whether the eye has not moved since the frame before, though the view has turned.
    fn rests_at(&mut self, camera: &Camera, options: &Options) -> bool {
        // These need the planes of the view itself.
        let by_view = options.smooth || options.shadows || options.normals == Normals::Derived;
        if !self.keeps
            || by_view
            || self.casts_rays
            || options.planes != Planes::Auto
            || options.samples != 1.0
            || options.remap == Remap::Nearest
        {
            return false;
        }
        let before = self.rests.replace((*camera, *options));
        // A view that does not turn costs least as it is; one that is wide is mostly its corners.
        let same = |(old, how): (Camera, Options)| old.eye == camera.eye && how == *options;
        before.is_some_and(same)
            && camera.fov <= 100.0
            && (before.is_some_and(|b| b.0 != *camera) || self.sphere.is_some())
    }

    /// Draws one frame from the planes around the eye, and fills those that it is the first to show.
    fn render_sphere(&mut self, camera: &Camera, options: &Options, outputs: Outputs) -> Result<Frame> {
        if let Some(frame) = inside_solid(self.scene.as_deref(), &self.resident, camera, options, outputs) {
            return Ok(frame);
        }
        let perspective = options.projection == Projection::Perspective;
        let start = Instant::now();
        let rays = Rays::new(camera, options.projection, self.resident.dims);
        // Pixels of a perspective stand closer towards its corners.
        let layout = match perspective {
            true => Layout::new(&rays, 0.0, SPHERE_DENSITY),
            false => Layout::new(&rays, camera.yaw, 1.0),
        };
        if layout.total() > SPHERE_LIMIT {
            return Err(Error::Limit(format!(
                "{} picture of {} × {} pixels: its sphere takes {} samples, {SPHERE_LIMIT} are drawn at once; try a smaller --size",
                options.projection,
                camera.width,
                camera.height,
                layout.total()
            )));
        }
        let mut frame = self.frame(camera, outputs);
        let mut sphere = match self.sphere.take() {
            Some(sphere) if sphere.serves(camera, options, &layout) => sphere,
            old => Box::new(Sphere::new(&self.resident, camera, options, layout, old)),
        };
        let setup_ms = milliseconds(start);

        let at = Instant::now();
        let counters = sphere.fill(&self.resident, camera, &rays);
        let traverse_ms = milliseconds(at);

        let at = Instant::now();
        let doubts = if sphere.refines(options) { self.color.len() } else { 0 };
        resize(&mut self.doubt, doubts, refine::Doubt::NONE);
        let mut pixels = remap::Pixels {
            color: &mut self.color,
            depth: &mut frame.depth,
            voxel: &mut frame.voxel,
            doubt: &mut self.doubt,
        };
        sphere.remap(&self.resident, camera, &rays, &mut pixels);
        sphere.refine(&self.resident, camera, &rays, &mut pixels);
        frame.voxel.par_iter_mut().for_each(|v| *v = world_voxel(&sphere.setup, *v));
        let remap_ms = milliseconds(at);

        let at = Instant::now();
        match perspective {
            true => self.shade(camera, options, None, &mut frame),
            false => self.shade_rays(camera, options, &rays, &mut frame),
        }
        self.matter(camera, options, &mut frame);
        let shade_ms = milliseconds(at);
        frame.stats = frame_stats(&self.resident, camera, options, "cpu", "sphere");
        of_planes(&mut frame.stats, &sphere.setup, sphere.specialization, counters);
        frame.stats.cpu_ms = Some(StageTimes {
            setup: setup_ms,
            traverse: traverse_ms,
            remap: remap_ms,
            shade: shade_ms,
            total: milliseconds(start),
        });
        self.sphere = Some(sphere);
        Ok(frame)
    }

    /// Draws the six faces of a cube, each as a picture of its own.
    fn render_cube(&mut self, camera: &Camera, options: &Options, outputs: Outputs) -> Result<Frame> {
        let options = Options { projection: Projection::Perspective, ..*options };
        let keeps = std::mem::replace(&mut self.keeps, false);
        let faces: Result<Vec<Frame>> =
            face_cameras(camera).iter().map(|face| self.render(face, &options, outputs)).collect();
        self.keeps = keeps;
        Ok(join_faces(camera, faces?))
    }

    fn shade_rays(&mut self, camera: &Camera, options: &Options, rays: &Rays, frame: &mut Frame) {
        if let Some(angles) = rays.angles() {
            let params = shade_rays::round_params(camera, rays, options);
            let (color, depth) = (&self.color, &frame.depth);
            return shade_rays::shade_round(angles, &params, color, depth, &mut self.shade, &mut frame.color);
        }
        let size = [camera.width, camera.height].map(|v| v as usize);
        shade_rays::shade_rays(rays, size, options, &self.color, &frame.depth, &mut frame.color);
    }

    /// Draws one frame with one f64 ray a pixel at level 0.
    pub fn exact(&mut self, camera: &Camera, options: &Options, outputs: Outputs) -> Result<Frame> {
        check(camera, options)?;
        self.rays(camera, &options.drawn(), outputs, "exact")
    }

    fn rays(&mut self, camera: &Camera, options: &Options, outputs: Outputs, device: &str) -> Result<Frame> {
        let Some(scene) = self.scene.clone() else {
            return Err(Error::Argument(format!(
                "{device}: rays need the whole world in memory; this one comes in tiles"
            )));
        };
        // Parallel rays begin beside the eye.
        let inside = match options.projection {
            Projection::Ortho { .. } => None,
            _ => inside_solid(self.scene.as_deref(), &self.resident, camera, options, outputs),
        };
        if let Some(frame) = inside {
            return Ok(frame);
        }
        let mut frame = self.frame(camera, outputs);
        let start = Instant::now();
        let (color, depth, voxel) = (&mut self.color, &mut frame.depth, &mut frame.voxel);
        crate::cpu::exact::exact(&scene, &self.resident, camera, options, color, depth, voxel);
        let traverse_ms = milliseconds(start);
        let at = Instant::now();
        match options.projection {
            Projection::Perspective => self.shade(camera, options, None, &mut frame),
            projection => {
                let rays = Rays::new(camera, projection, self.resident.dims);
                self.shade_rays(camera, options, &rays, &mut frame);
            }
        }
        match &self.resident.matter {
            Some(matter) if device == "exact" => {
                exact_matter::compose(&scene, matter, camera, options, &mut frame);
            }
            _ => self.matter(camera, options, &mut frame),
        }
        frame.stats = frame_stats(&self.resident, camera, options, device, "exact");
        frame.stats.cpu_ms = Some(StageTimes {
            traverse: traverse_ms,
            shade: milliseconds(at),
            total: milliseconds(start),
            ..StageTimes::default()
        });
        Ok(frame)
    }

    /// Translucent matter, over what is solid.
    fn matter(&self, camera: &Camera, options: &Options, frame: &mut Frame) {
        if let Some(matter) = &self.resident.matter {
            matter::compose(matter, camera, options, frame);
        }
    }

    /// The surface of a height field, over its blocks.
    fn smooth(&mut self, setup: &Setup, camera: &Camera, frame: &mut Frame) {
        let known = self.surface.take().filter(|(_, repeats)| *repeats == setup.repeats);
        self.surface =
            known.or_else(|| Some((Arc::new(Tops::over_surface(&self.resident, setup.repeats)?), setup.repeats)));
        let Some((tops, _)) = &self.surface else { return };
        let (color, doubt) = (&mut self.color, &mut self.doubt);
        let mut pixels = remap::Pixels { color, depth: &mut frame.depth, voxel: &mut frame.voxel, doubt };
        smooth::smooth(&self.resident, tops, setup, camera, &mut pixels);
    }

    /// Shades what a walk in planes drew, or, without a setup, what `exact` did.
    fn shade(&mut self, camera: &Camera, options: &Options, setup: Option<&Setup>, frame: &mut Frame) {
        let params = shade::ShadeParams::new(camera, options);
        let sunlight = match (options.shadows, setup) {
            (false, _) => None,
            (true, Some(setup)) => {
                let tops = self.tops.get_or_insert_with(|| Arc::new(Tops::new(&self.resident)));
                Some(Sunlight::Walk(Shadows::new(&self.resident, tops, setup, params.sun_world)))
            }
            (true, None) => self.scene.as_deref().map(|scene| {
                Sunlight::Exact(ExactShadows {
                    columns: scene.levels[0].geometry(scene.encoding),
                    repeats: [options.repeat.x, options.repeat.z],
                    eye: camera.eye,
                    sun: params.sun_world.as_dvec3(),
                    view: crate::cpu::exact::view_distance(options),
                })
            }),
        };
        let repeats = [options.repeat.x, options.repeat.z];
        let ground = options.smooth.then(|| Ground::new(&self.resident, repeats)).flatten();
        let surface = ground.map(|ground| match setup {
            Some(setup) => smooth::Normals::new(ground, setup.eye_cell, setup.eye_fract),
            None => {
                let cell = camera.eye.floor();
                smooth::Normals::new(ground, cell.to_array().map(|v| v as i32), (camera.eye - cell).to_array())
            }
        });
        let of_exact;
        let derived = derives_normals(&self.resident, options) && surface.is_none();
        let setup = match setup {
            None if derived => {
                of_exact = plane_setup(&self.resident, camera, options);
                Some(&of_exact)
            }
            setup => setup,
        };
        let occupancy = setup.filter(|_| derived).map(|setup| Occupancy::new(&self.resident, setup));
        let normals = surface.map(NormalsOf::Surface).or(occupancy.map(NormalsOf::Occupancy));
        let lighting = shade::Lighting { sunlight, normals };
        shade::shade(&params, &self.color, &frame.depth, &lighting, &mut self.shade, &mut frame.color);
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
    fn remap(&mut self, plan: &FramePlan, retest: bool, frame: &mut Frame) -> [u64; 2] {
        let FramePlan { camera, options, setup, .. } = plan;
        let width = frame.width;
        // Planes at most a pixel apart reach every pixel.
        let sparse = setup.is_sparse();
        if retest {
            let doubts = if plan.refines() { self.color.len() } else { 0 };
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

/// Whether normals come from what is solid: not where the interior was left out, nor where nothing is lit by them.
pub(crate) fn derives_normals(resident: &Resident, options: &Options) -> bool {
    let lit = options.lit() != Shading::None;
    options.normals == Normals::Derived && lit && resident.encoding == Encoding::Solid
}

/// An eye inside a solid voxel sees that voxel at depth 0 in every pixel.
pub(crate) fn inside_solid(
    scene: Option<&Scene>,
    resident: &Resident,
    camera: &Camera,
    options: &Options,
    outputs: Outputs,
) -> Option<Frame> {
    let [nx, ny, nz] = resident.dims;
    let cell = camera.eye.floor();
    let place = |v: f64, n: u32, repeat: bool| {
        let v = v as i64;
        if repeat { Some(v.rem_euclid(i64::from(n)) as u32) } else { u32::try_from(v).ok().filter(|&v| v < n) }
    };
    let x = place(cell.x, nx, options.repeat.x)?;
    let y = place(cell.y, ny, false)?;
    let z = place(cell.z, nz, options.repeat.z)?;
    let column = resident.levels[0].index(x, z);
    let k = match scene {
        Some(scene) => {
            scene.levels[0].solid.find(x, y, z)?;
            // Which run of the geometry holds it: a surface scene's interior lies in none.
            let geometry = scene.levels[0].geometry(scene.encoding);
            let range = geometry.range(geometry.index(x, z));
            geometry.find(x, y, z).map_or(0, |run| (range.end - 1 - run) as u32)
        }
        None => {
            let holds = |run: Run| (u32::from(run.first())..run.end()).contains(&y);
            resident.levels[0].column(column).position(holds)? as u32
        }
    };
    let color = resident.levels[0].color(column, k, y);
    let mut frame = empty_frame(camera, outputs);
    frame.depth.fill(0.0);
    frame.color.fill((color | 0xFF00_0000).to_le_bytes());
    frame.voxel.fill([cell.x as i32, cell.y as i32, cell.z as i32, 0]);
    frame.stats = frame_stats(resident, camera, options, "cpu", "inside");
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

/// What is known of a frame once its planes are walked.
fn of_planes(stats: &mut Stats, setup: &Setup, specialization: Specialization, counters: Counters) {
    stats.planes = setup.planes.len() as u32;
    stats.planes_full = setup.planes_full;
    stats.levels_drawn = setup.levels;
    stats.left_out = specialization.left_out();
    stats.count(counters);
}

/// What is known of a frame before it is drawn.
pub(crate) fn frame_stats(
    resident: &Resident,
    camera: &Camera,
    options: &Options,
    device: &str,
    kernel: &str,
) -> Stats {
    let mut specialization = Vec::new();
    match resident.color {
        ColorMode::None => {}
        ColorMode::Run => specialization.push("color-run".into()),
        ColorMode::Voxel => specialization.push("color-voxel".into()),
    }
    if matches!(resident.levels[0].paint, Paint::Height { .. }) {
        specialization.push("color-height".into());
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
    specialization.extend(options.shadows.then(|| "shadows".into()));
    specialization.extend(derives_normals(resident, options).then(|| "derived-normals".into()));
    specialization.extend(options.smooth.then(|| "smooth".into()));
    specialization.extend(resident.matter.is_some().then(|| "matter".into()));
    Stats {
        device: device.into(),
        kernel: kernel.into(),
        levels: resident.levels.len() as u32,
        width: camera.width,
        height: camera.height,
        specialization,
        paging: PagingStats { bytes_resident: resident.bytes(), ..PagingStats::default() },
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
