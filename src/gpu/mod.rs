//! The stages on the GPU, through wgpu compute shaders. A frame stays on the device from camera to shaded picture.
//!
//! [`crate::frame::plane_setup`] runs on the host, in f64, for both twins. The shaders in `shaders/` are the twins of
//! [`crate::cpu`]; [`Kernel`] says how `traverse` is spread over the device. Scene tables and frames are checked against
//! the adapter's limits before memory is asked for.

mod engine;
mod matter;
mod pool;
pub mod present;
pub mod shaders;
pub mod types;

use crate::clock::Instant;
use crate::cpu::renderer::{CpuRenderer, Outputs, check, derives_normals, frame_stats, inside_solid};
use crate::cpu::shade;
use crate::cpu::shadow::Tops;
use crate::cpu::smooth::{self, Ground};
use crate::cpu::traverse::PlaneBuffer;
use crate::cpu::usage;
use crate::error::{Error, Result};
use crate::frame::camera::Camera;
use crate::frame::options::{Options, Shading};
use crate::frame::picture::{Frame, StageTimes, Stats};
use crate::frame::plan::FramePlan;
use crate::frame::plane_setup::Setup;
use crate::frame::projection::Projection;
use crate::frame::specialize::{Feature, Specialization, Twin};
use crate::world::pager::Change;
use crate::world::tables::Resident;
use crate::world::tree::{Roots, Tree};
pub use engine::Shader;
use engine::{Engine, Pipeline};
use planecast_encoder::Scene;
use pool::GpuResident;
use present::ByteOrder;
use rayon::prelude::*;
use shaders::Variant;
use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, mpsc};
use types::{FrameParams, PaintKind, Upload};

/// How `traverse` is spread over the device. All draw the same picture but for float rounding.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Kernel {
    /// One plane per invocation: the paper's mapping.
    Invocation,
    /// One plane per workgroup: all lanes walk slices of the plane's ray at once.
    #[default]
    Workgroup,
    /// One ray per pixel through a sparse tree of 64-bit masks ([`crate::world::tree`]), with the same levels: the baseline.
    Raycast,
    /// One ray per pixel over the tables of planes.
    RaycastRuns,
}

impl Kernel {
    pub const ALL: [Kernel; 4] = [Kernel::Invocation, Kernel::Workgroup, Kernel::Raycast, Kernel::RaycastRuns];

    pub fn name(self) -> &'static str {
        match self {
            Kernel::Invocation => "invocation",
            Kernel::Workgroup => "workgroup",
            Kernel::Raycast => "raycast",
            Kernel::RaycastRuns => "raycast-runs",
        }
    }

    /// Whether each pixel has a ray of its own, and there are no planes.
    pub fn casts_rays(self) -> bool {
        matches!(self, Kernel::Raycast | Kernel::RaycastRuns)
    }
}

impl std::str::FromStr for Kernel {
    type Err = Error;

    fn from_str(name: &str) -> Result<Kernel> {
        Kernel::ALL.into_iter().find(|k| k.name() == name).ok_or_else(|| {
            Error::Argument(format!("kernel {name}: must be one of {}", Kernel::ALL.map(Kernel::name).join(", ")))
        })
    }
}

/// What a renderer is made with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GpuOptions {
    /// `workgroup` unless another is asked for: it was the fastest on every device and scene measured, since it alone has
    /// work for more lanes than there are planes.
    pub kernel: Kernel,
    /// Leaves out wgpu's runtime checks of the shaders. Scenes are validated before they become a [`Resident`].
    pub trusted: bool,
    /// Whether `workgroup` proves to the compiler that its lanes meet at barriers, which browsers ask for: two more barriers
    /// a decision.
    pub proved_uniform: bool,
    /// Whether frames' [`Stats`] say how many columns, runs and spans were visited; 0 where not. Counting takes `workgroup`
    /// 1 to 2 % and `invocation` as long as all else. Software devices always count: that is how they tell of walks that
    /// they cut short.
    pub count: bool,
    /// Whether frames' [`Stats`] say how long each stage took on the device, and not only their sum. Stages are then passes of
    /// their own: 4 to 8 % of a frame's time on an H200.
    pub stage_times: bool,
    /// Lanes of a workgroup: a multiple of 32 up to 256 for `workgroup`, a power of two up to 64 for `invocation`; `None`
    /// for the kernel's own.
    pub lanes: Option<u32>,
    /// Frames that may be on their way at once between [`GpuRenderer::submit`] and [`GpuRenderer::collect`].
    pub in_flight: usize,
    /// Bytes of workgroup memory to use at most, where the device has more. What does not fit goes to a storage buffer.
    pub workgroup_memory: u32,
    /// Bytes of one binding of a scene table at most, where the device allows more. Longer tables are cut into several.
    pub binding_size: u64,
}

impl Default for GpuOptions {
    fn default() -> GpuOptions {
        GpuOptions {
            kernel: Kernel::Workgroup,
            trusted: !cfg!(debug_assertions),
            proved_uniform: cfg!(target_arch = "wasm32"),
            count: true,
            stage_times: true,
            lanes: None,
            in_flight: 3,
            workgroup_memory: u32::MAX,
            binding_size: u64::MAX,
        }
    }
}

/// Draws frames of one scene on the GPU.
pub struct GpuRenderer {
    /// None of a world whose tiles are not all there.
    scene: Option<Arc<Scene>>,
    resident: Arc<Resident>,
    options: GpuOptions,
    engine: Engine,
    tables: GpuResident,
    /// Bytes of the tree that rays are cast through; 0 before one is.
    tree_bytes: u64,
    buffers: HashMap<&'static str, wgpu::Buffer>,
    /// Of pictures that are sent together.
    slots: Vec<HashMap<&'static str, wgpu::Buffer>>,
    queries: Option<wgpu::QuerySet>,
    pending: VecDeque<Pending>,
    /// Read-back buffers that no frame is using.
    free: Vec<wgpu::Buffer>,
    /// Frames whose memory later ones take.
    spare: Vec<Frame>,
    /// Made and sent for the first frame with shadows.
    tops: Option<Tops>,
    /// The same of the first that is smooth, and along which axes its world repeats.
    surface: Option<(Tops, [bool; 2])>,
    /// What translucent matter looks like on the device.
    look: Option<Arc<crate::world::matter::Look>>,
    /// What was worked out for frames to come, in their order.
    prepared: VecDeque<Prepared>,
    /// Whether frames that are read back have depths.
    depth: bool,
    /// Whether frames from now on count the pixels that show each slot, and what the latest that did so counted.
    counts_usage: bool,
    usage: Vec<u32>,
    shown: present::Shown,
    /// Of frames that are shown, and of the picture in the buffer `shaded`.
    live_order: ByteOrder,
    shaded_order: ByteOrder,
}

/// Where a frame begins.
#[derive(Clone, Copy)]
pub enum Begin<'b> {
    Traverse,
    /// With `remap`: planes as `traverse` leaves them.
    Planes(&'b PlaneBuffer),
    /// With `shade`: packed colours and depths as `remap` leaves them.
    Image {
        color: &'b [u32],
        depth: &'b [f32],
    },
}

/// A frame on its way.
enum Pending {
    /// Nothing was left to draw.
    Done(Box<Frame>),
    Drawing(Box<Drawing>),
}

/// A frame as [`GpuRenderer::draw_from`] leaves it.
enum Drawn {
    /// One colour: the eye is inside a voxel.
    Inside(Box<Frame>),
    /// The picture is, or will be, in the buffer `shaded`.
    Sent(Box<Sent>),
}

struct Sent {
    plan: Plan,
    frame: Frame,
    start: Instant,
    setup_ms: f64,
}

struct Drawing {
    frame: Frame,
    start: Instant,
    submission: wgpu::SubmissionIndex,
    mapped: Mapped,
    readback: wgpu::Buffer,
    parts: Parts,
    setup_ms: f64,
}

/// What the host works out of a frame before it is sent.
struct Prepared {
    plan: FramePlan,
    upload: Upload,
}

impl Prepared {
    fn new(resident: &Resident, camera: &Camera, options: &Options) -> Prepared {
        Prepared::of(resident, FramePlan::new(resident, camera, options))
    }

    fn of(resident: &Resident, plan: FramePlan) -> Prepared {
        let upload = Upload::new(resident, &plan.setup, &plan.camera, &plan.options);
        Prepared { plan, upload }
    }
}

/// Where a frame's stages are recorded.
struct Recorder {
    /// One pass for all stages; else each has its own. Dropped before what it records into.
    pass: Option<wgpu::ComputePass<'static>>,
    encoder: wgpu::CommandEncoder,
}

/// Tells when a read-back buffer is mapped.
type Mapped = mpsc::Receiver<Result<(), wgpu::BufferAsyncError>>;

/// Where things stand in a read-back buffer, in bytes.
#[derive(Clone, Copy, Default)]
struct Parts {
    color: u64,
    depth: u64,
    voxel: u64,
    counters: u64,
    holes: u64,
    times: u64,
    usage: u64,
    end: u64,
    /// Slots whose pixels are counted.
    n_slots: usize,
    /// Entries of the counters.
    n_counters: usize,
    /// Times are those of each stage, not of all.
    stage_times: bool,
}

impl Parts {
    /// Pixels by slot, in a read-back buffer; `memory` is taken for them.
    fn usage_in(&self, bytes: &[u8], memory: Vec<u32>) -> Vec<u32> {
        refilled(memory, &bytes[self.usage as usize..][..4 * self.n_slots])
    }
}

/// A vector's memory with other values.
fn refilled<T: bytemuck::Pod>(mut memory: Vec<T>, bytes: &[u8]) -> Vec<T> {
    memory.clear();
    memory.extend_from_slice(bytemuck::cast_slice(bytes));
    memory
}

/// Timestamps: begin and end of traverse, remap and shade.
const TIMES: u32 = 6;

/// Pictures that are sent together at most, and their pixels: each has buffers of its own meanwhile.
const BATCH: usize = 64;
const BATCH_PIXELS: u64 = 1 << 22;

/// A frame of no pixels.
fn empty() -> Frame {
    let (color, depth, voxel) = Default::default();
    Frame { width: 0, height: 0, color, depth, voxel, stats: Stats::default() }
}

/// Asks for a read-back buffer to be mapped.
fn map(readback: &wgpu::Buffer, parts: Parts) -> Mapped {
    let (send, mapped) = mpsc::channel();
    readback.map_async(wgpu::MapMode::Read, ..parts.end, move |result| {
        // The renderer may be gone by now: then nobody waits for the answer.
        let _ = send.send(result);
    });
    mapped
}

/// A size in pixels or planes over groups of `by`.
fn groups(n: u32, by: u32) -> u32 {
    n.div_ceil(by)
}

/// Lanes of the kernel `workgroup` for a picture of so many pixels: more slices at once bring the longest planes to their
/// end sooner, but are more often drawn in vain, behind what a nearer one of the same batch closes. On an H100, of 96,
/// 128, 160, 192 and 256 lanes, terrain and mixing layer: 640 × 480 and 1,024 × 768 take least with 128 to 160 lanes,
/// 1,920 × 1,080 with 192, 3,840 × 2,160 with 256.
fn workgroup_lanes(pixels: u64) -> u32 {
    match pixels {
        0..1_500_000 => 128,
        1_500_000..5_000_000 => 192,
        _ => 256,
    }
}

/// Lanes of the kernel `invocation`: planes side by side in a subgroup, as the paper has them on its GPU. On a large GPU
/// few planes a workgroup are faster by far (an H100 takes a seventh of the time with one), as lanes of one subgroup wait
/// for each other's walks; but then it is no longer the mapping that the kernel is here to be compared by, and
/// `workgroup` is faster than both.
const INVOCATION_LANES: u32 = 32;

/// Bytes of workgroup memory that the kernel `workgroup` takes beside its keys, at most.
fn workgroup_other(lanes: u32) -> u32 {
    4 * lanes + 1024
}

/// Workgroups of one dimension: wgpu allows 65,535.
const GROUPS_A_ROW: u32 = 32_768;

impl GpuRenderer {
    /// Opens the adapter and uploads the scene. Without a usable adapter, or where the scene does not fit, the error says
    /// so.
    pub fn new(scene: &Arc<Scene>, resident: &Arc<Resident>, options: GpuOptions) -> Result<GpuRenderer> {
        GpuRenderer::with_engine(Some(scene), resident, options, || Engine::new(options.trusted))
    }

    /// One on every adapter.
    pub fn on_all(scene: &Arc<Scene>, resident: &Arc<Resident>, options: GpuOptions) -> Result<Vec<GpuRenderer>> {
        let open = |adapter: &wgpu::Adapter| {
            GpuRenderer::with_engine(Some(scene), resident, options, || Engine::on(adapter, options.trusted))
        };
        Engine::adapters(&engine::instance())?.iter().map(open).collect()
    }

    fn with_engine(
        scene: Option<&Arc<Scene>>,
        resident: &Arc<Resident>,
        mut options: GpuOptions,
        engine: impl FnOnce() -> Result<Engine>,
    ) -> Result<GpuRenderer> {
        if let Some(lanes) = options.lanes {
            let invocation = options.kernel == Kernel::Invocation;
            let fits =
                if invocation { lanes.is_power_of_two() && lanes <= 64 } else { lanes % 32 == 0 && lanes <= 256 };
            if lanes == 0 || !fits {
                let allowed = if invocation { "a power of two up to 64" } else { "a multiple of 32 up to 256" };
                return Err(Error::Argument(format!(
                    "{lanes} lanes a workgroup: kernel {} takes {allowed}",
                    options.kernel.name()
                )));
            }
        }
        let engine = engine()?;
        options.count |= engine.software;
        let tables = GpuResident::new(&engine, resident, options.binding_size)?;
        let queries = engine.tick_ns.map(|_| {
            engine.device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("stages"),
                ty: wgpu::QueryType::Timestamp,
                count: TIMES,
            })
        });
        let (buffers, pending, free) = (HashMap::new(), VecDeque::new(), Vec::new());
        let shown = present::Shown::default();
        let (live_order, shaded_order) = Default::default();
        Ok(GpuRenderer {
            scene: scene.cloned(),
            resident: Arc::clone(resident),
            options,
            engine,
            tables,
            tree_bytes: 0,
            buffers,
            slots: Vec::new(),
            queries,
            pending,
            free,
            spare: Vec::new(),
            tops: None,
            surface: None,
            look: None,
            prepared: VecDeque::new(),
            depth: true,
            counts_usage: false,
            usage: Vec::new(),
            shown,
            live_order,
            shaded_order,
        })
    }

    /// Draws from tables alone, whose tiles are not all there: by planes, in perspective, without shadows and surfaces.
    pub fn of_tables(resident: &Arc<Resident>, options: GpuOptions) -> Result<GpuRenderer> {
        GpuRenderer::with_engine(None, resident, options, || Engine::new(options.trusted))
    }

    pub fn tables(&self) -> &Resident {
        &self.resident
    }

    /// The tables on the host, to be changed between frames; `None` while others have them too.
    pub fn tables_mut(&mut self) -> Option<&mut Resident> {
        Arc::get_mut(&mut self.resident)
    }

    /// Brings what has changed in the tables to the device; how many bytes that was.
    ///
    /// # Errors
    /// [`Error::Limit`] where the device has no room for them.
    pub fn bring(&mut self, changes: &[Change]) -> Result<u64> {
        self.tables.sync(&self.engine, &self.resident, changes, self.options.binding_size)
    }

    /// Whether frames count how many pixels show the tile of each slot, from the next one on.
    pub(crate) fn set_usage(&mut self, counts: bool) {
        self.counts_usage = counts && self.tables.is_paged();
    }

    /// What the latest frame that was collected counted, as [`crate::cpu::usage::usage`] has it; empty where it did not.
    pub(crate) fn usage(&self) -> &[u32] {
        &self.usage
    }

    /// The adapter's name, and its driver.
    pub fn device(&self) -> (&str, &str) {
        (&self.engine.name, &self.engine.driver)
    }

    /// What draws the same on the CPU.
    pub fn cpu(&self) -> CpuRenderer {
        CpuRenderer::of(self.scene.clone(), Arc::clone(&self.resident))
    }

    /// Gives the device up at once, with all its memory. Later frames are an [`Error::Device`], as after a device is lost.
    pub fn destroy(&self) {
        self.engine.device.destroy();
    }

    /// Whether the adapter is a processor that plays GPU: the CPU's own stages are faster then.
    pub fn is_software(&self) -> bool {
        self.engine.software
    }

    /// The shaders that frames on this device needed so far.
    pub fn shaders(&self) -> Vec<Shader> {
        self.engine.shaders()
    }

    /// Takes another kernel from the next frame on.
    pub fn set_kernel(&mut self, kernel: Kernel, lanes: Option<u32>) {
        (self.options.kernel, self.options.lanes) = (kernel, lanes);
    }

    /// Counts work or not ([`GpuOptions::count`]) from the next frame on.
    pub fn set_count(&mut self, count: bool) {
        self.options.count = count || self.engine.software;
    }

    /// Times stages one by one or not ([`GpuOptions::stage_times`]) from the next frame on.
    pub fn set_stage_times(&mut self, stage_times: bool) {
        self.options.stage_times = stage_times;
    }

    /// Whether frames have depths from the next on; without them there is half as much to read back.
    pub fn set_depth(&mut self, depth: bool) {
        self.depth = depth;
    }

    /// Gives a frame back that is done with: a later one takes its memory, already touched.
    pub fn reuse(&mut self, frame: Option<Frame>) {
        // More are never on their way at once.
        if self.spare.len() < self.options.in_flight.max(1) {
            self.spare.extend(frame);
        }
    }

    /// Draws one frame. Frames submitted before are drawn first and must have been collected.
    pub fn render(&mut self, camera: &Camera, options: &Options, outputs: Outputs) -> Result<Frame> {
        assert!(self.pending.is_empty(), "frames on their way must be collected first");
        self.submit(camera, options, outputs)?;
        self.collect().expect("a frame was submitted")
    }

    /// Frames submitted and not yet collected.
    pub fn in_flight(&self) -> usize {
        self.pending.len()
    }

    /// Whether [`GpuRenderer::submit`] would keep more frames on their way than [`GpuOptions::in_flight`] allows.
    pub fn is_full(&self) -> bool {
        self.pending.len() >= self.options.in_flight.max(1)
    }

    /// The oldest frame on its way, once it is done; `None` where there is none.
    pub fn collect(&mut self) -> Option<Result<Frame>> {
        Some(match self.pending.pop_front()? {
            Pending::Done(frame) => {
                self.usage.clear();
                Ok(*frame)
            }
            Pending::Drawing(drawing) => self.finish(*drawing),
        })
    }

    /// As [`GpuRenderer::collect`]; meanwhile other threads work out what the host has to know of the next few of `cameras`.
    pub fn collect_and_prepare(&mut self, cameras: &[Camera], options: &Options) -> Option<Result<Frame>> {
        /// As many at a time, so that each thread has one whole.
        const AHEAD: usize = 4;
        let known = |camera: &Camera| self.prepared.iter().any(|p| p.plan.is_of(camera, options));
        if cameras.first().is_none_or(known) {
            return self.collect();
        }
        let resident = Arc::clone(&self.resident);
        let resident = &*resident;
        let mut made: Vec<Option<Prepared>> = cameras.iter().take(AHEAD).map(|_| None).collect();
        let collected = rayon::in_place_scope(|scope| {
            for (made, camera) in made.iter_mut().zip(cameras) {
                // What cannot be drawn is told of when its turn comes.
                scope.spawn(move |_| {
                    *made = check(camera, options).is_ok().then(|| Prepared::new(resident, camera, options))
                });
            }
            self.collect()
        });
        self.prepared = made.into_iter().flatten().collect();
        collected
    }

    /// Sends one frame to the device and returns at once; [`GpuRenderer::collect`] gives frames in the order of submission.
    pub fn submit(&mut self, camera: &Camera, options: &Options, outputs: Outputs) -> Result<()> {
        self.submit_from(Begin::Traverse, None, camera, options, outputs)
    }

    /// The same for a frame that is decided already.
    pub(crate) fn submit_plan(&mut self, plan: FramePlan, outputs: Outputs) -> Result<()> {
        let (camera, options) = (plan.camera, plan.options);
        self.submit_from(Begin::Traverse, Some(plan), &camera, &options, outputs)
    }

    /// Draws pictures of any sizes and hands them on in order; `done` may give a frame back. Several are sent to the device in
    /// one submission, stage by stage, so that their walks run side by side.
    pub fn each(
        &mut self,
        cameras: &[Camera],
        options: &Options,
        outputs: Outputs,
        done: &dyn Fn(usize, Frame) -> Result<Option<Frame>>,
    ) -> Result<()> {
        assert!(self.pending.is_empty(), "frames on their way must be collected first");
        if self.resident.matter.is_some() {
            // Its tables are not made for each picture of a batch.
            for (i, camera) in cameras.iter().enumerate() {
                let frame = self.render(camera, options, outputs)?;
                self.reuse(done(i, frame)?);
            }
            return Ok(());
        }
        let mut from = 0;
        while from < cameras.len() {
            let mut pixels = 0;
            let fits = |camera: &&Camera| {
                pixels += u64::from(camera.width) * u64::from(camera.height);
                pixels <= BATCH_PIXELS
            };
            let n = cameras[from..].iter().take(BATCH).take_while(fits).count().max(1);
            for (i, frame) in self.batch(&cameras[from..from + n], options, outputs)?.into_iter().enumerate() {
                self.reuse(done(from + i, frame)?);
            }
            from += n;
        }
        Ok(())
    }

    /// Draws some pictures in one submission, each in buffers of its own.
    fn batch(&mut self, cameras: &[Camera], options: &Options, outputs: Outputs) -> Result<Vec<Frame>> {
        struct Job {
            at: usize,
            plan: Plan,
            readback: wgpu::Buffer,
            parts: Parts,
        }
        let start = Instant::now();
        cameras.iter().try_for_each(|camera| self.check(camera, options))?;
        let resident = Arc::clone(&self.resident);
        let prepared: Vec<_> = cameras.par_iter().map(|camera| Prepared::new(&resident, camera, options)).collect();
        let (mut frames, mut jobs) = (Vec::with_capacity(cameras.len()), Vec::with_capacity(cameras.len()));
        self.slots.resize_with(self.slots.len().max(cameras.len()), HashMap::new);
        for (at, Prepared { plan: FramePlan { camera, setup, .. }, upload }) in prepared.iter().enumerate() {
            if let Some(frame) = self.inside(camera, options, outputs) {
                frames.push(*frame);
                continue;
            }
            self.check_steps(setup, options)?;
            let mut plan = Plan::new(&self.resident, setup, camera, options, outputs, &self.options, &self.engine);
            plan.stage_times = false;
            self.in_slot(at, |gpu| {
                gpu.reserve(&plan)?;
                gpu.upload(upload, camera, options.ssao_samples);
                Ok(())
            })?;
            let parts = plan.parts(true, self.depth);
            frames.push(self.empty_frame(&plan, setup, camera, options));
            jobs.push(Job { at, readback: self.readback(&parts)?, plan, parts });
        }
        let mut encoder = self.engine.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default()).forget_lifetime();
        let mut recorder = Recorder { pass: Some(pass), encoder };
        // Stage by stage: nothing that one picture's walks write is another's to wait for.
        for job in &jobs {
            self.in_slot(job.at, |gpu| gpu.traverse(&mut recorder, &job.plan, options))?;
        }
        for job in &jobs {
            self.in_slot(job.at, |gpu| gpu.remap(&mut recorder, &job.plan))?;
        }
        for job in &jobs {
            self.in_slot(job.at, |gpu| gpu.shade(&mut recorder, &job.plan, ByteOrder::Rgba))?;
        }
        let Recorder { pass, mut encoder } = recorder;
        drop(pass);
        for job in &jobs {
            self.in_slot(job.at, |gpu| {
                gpu.copy(&mut encoder, &job.plan, job.parts, &job.readback, false);
                Ok(())
            })?;
        }
        let submission = self.engine.queue.submit([encoder.finish()]);
        let mapped: Vec<_> = jobs.iter().map(|job| map(&job.readback, job.parts)).collect();
        let setup_ms = start.elapsed().as_secs_f64() * 1e3 / cameras.len() as f64;
        let mut begun = Some(submission);
        for (job, mapped) in jobs.into_iter().zip(mapped) {
            let frame = std::mem::replace(&mut frames[job.at], empty());
            frames[job.at] = self.read(frame, mapped, job.readback, job.parts, begun.take(), setup_ms, start)?;
        }
        // Stages are not told apart, nor are pictures.
        let total = start.elapsed().as_secs_f64() * 1e3 / cameras.len() as f64;
        for frame in &mut frames {
            frame.stats.gpu_ms = Some(StageTimes { setup: setup_ms, total, ..StageTimes::default() });
        }
        Ok(frames)
    }

    /// Works with the buffers of picture `at` of a batch.
    fn in_slot<T>(&mut self, at: usize, work: impl FnOnce(&mut GpuRenderer) -> Result<T>) -> Result<T> {
        std::mem::swap(&mut self.buffers, &mut self.slots[at]);
        let result = work(self);
        std::mem::swap(&mut self.buffers, &mut self.slots[at]);
        result
    }

    /// Draws one frame from what an earlier stage left, on the CPU perhaps: to compare stages one by one.
    pub fn render_from(
        &mut self,
        begin: Begin<'_>,
        camera: &Camera,
        options: &Options,
        outputs: Outputs,
    ) -> Result<Frame> {
        self.submit_from(begin, None, camera, options, outputs)?;
        self.collect().expect("a frame was submitted")
    }

    /// What `traverse` left of the latest frame, `samples` long; voxels only where the frame needed them.
    pub fn plane_buffer(&self, samples: usize, voxels: bool) -> Result<PlaneBuffer> {
        let read = |name: &str, size: u64| -> Result<Vec<u8>> {
            let copy = self.engine.checked("read-back buffer", || {
                self.engine.device.create_buffer(&wgpu::BufferDescriptor {
                    label: Some("read-back"),
                    size,
                    usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
                    mapped_at_creation: false,
                })
            })?;
            let mut encoder = self.engine.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            encoder.copy_buffer_to_buffer(&self.buffers[name], 0, &copy, 0, size);
            let submission = self.engine.queue.submit([encoder.finish()]);
            copy.map_async(wgpu::MapMode::Read, .., |_| {});
            self.engine.wait(Some(submission))?;
            let bytes = copy.get_mapped_range(..).map_err(|e| Error::Device(e.to_string()))?;
            Ok(bytes.to_vec())
        };
        let n = samples as u64;
        Ok(PlaneBuffer {
            color: bytemuck::pod_collect_to_vec(&read("plane_color", 4 * n)?),
            depth: bytemuck::pod_collect_to_vec(&read("plane_depth", 4 * n)?),
            voxel: if voxels { bytemuck::pod_collect_to_vec(&read("plane_voxel", 16 * n)?) } else { Vec::new() },
        })
    }

    /// Refuses a frame whose longest walk would keep the device busy for seconds: kernels cannot be interrupted.
    fn check_steps(&self, setup: &Setup, options: &Options) -> Result<()> {
        let steps = setup.planes.iter().map(|p| setup.step_bound(p)).max().unwrap_or(0);
        let at_once = match self.options.kernel {
            // At least 32 lanes have a slice each, in which there are two columns.
            Kernel::Workgroup => 16,
            Kernel::Invocation | Kernel::Raycast | Kernel::RaycastRuns => 1,
        };
        let allowed = at_once * if self.engine.software { MAX_STEPS_SOFTWARE } else { MAX_STEPS };
        if steps <= allowed {
            return Ok(());
        }
        let levels = if options.lod.is_none() { "levels (--lod 1), " } else { "" };
        Err(Error::Limit(format!(
            "view of {steps} columns along one plane: kernel {} draws at most {allowed} on {}; try {levels}a smaller \
             --view-distance or --device cpu",
            self.options.kernel.name(),
            self.engine.name
        )))
    }

    fn submit_from(
        &mut self,
        begin: Begin<'_>,
        plan: Option<FramePlan>,
        camera: &Camera,
        options: &Options,
        outputs: Outputs,
    ) -> Result<()> {
        match self.draw_from(begin, plan, camera, options, outputs, ByteOrder::Rgba)? {
            Drawn::Inside(frame) => self.pending.push_back(Pending::Done(frame)),
            Drawn::Sent(sent) => {
                let Sent { plan, frame, start, setup_ms } = *sent;
                self.read_back(&plan, frame, start, setup_ms)?;
            }
        }
        Ok(())
    }

    /// Whether a frame can be drawn here at all.
    fn check(&self, camera: &Camera, options: &Options) -> Result<()> {
        check(camera, options)?;
        if options.projection != Projection::Perspective {
            let what = format!("the gpu draws no {} picture; use the cpu", options.projection.name());
            return Err(Error::Argument(what));
        }
        if options.f64_traversal {
            return Err(Error::Argument("the gpu walks in f32; use the cpu for f64".into()));
        }
        Ok(())
    }

    /// The frame of an eye inside a voxel.
    fn inside(&self, camera: &Camera, options: &Options, outputs: Outputs) -> Option<Box<Frame>> {
        let mut frame = inside_solid(self.scene.as_deref(), &self.resident, camera, options, outputs)?;
        frame.stats.device = self.engine.name.clone();
        frame.stats.cpu_ms = None;
        frame.stats.gpu_ms = Some(StageTimes::default());
        frame.stats.bytes_scene_gpu = self.tables.bytes + self.tree_bytes;
        Some(Box::new(frame))
    }

    /// A frame without its picture.
    fn empty_frame(&self, plan: &Plan, setup: &Setup, camera: &Camera, options: &Options) -> Frame {
        let mut frame = Frame { width: camera.width, height: camera.height, ..empty() };
        frame.stats = frame_stats(&self.resident, camera, options, &self.engine.name, plan.kernel.name());
        frame.stats.planes = setup.planes.len() as u32;
        frame.stats.planes_full = setup.planes_full;
        frame.stats.levels_drawn = setup.levels;
        frame.stats.left_out = plan.specialization.left_out();
        frame.stats.bytes_scene_gpu = self.tables.bytes + self.tree_bytes;
        frame
    }

    /// Sends a frame's stages to the device; the picture stays there. With no `plan`, what was prepared for such a frame is
    /// taken, or it is decided now.
    fn draw_from(
        &mut self,
        begin: Begin<'_>,
        plan: Option<FramePlan>,
        camera: &Camera,
        options: &Options,
        outputs: Outputs,
        order: ByteOrder,
    ) -> Result<Drawn> {
        self.check(camera, options)?;
        let start = Instant::now();
        if let Some(frame) = self.inside(camera, options, outputs) {
            return Ok(Drawn::Inside(frame));
        }
        let known = || self.prepared.iter().position(|p| p.plan.is_of(camera, options));
        let Prepared { plan: FramePlan { setup, .. }, mut upload } = match plan {
            Some(plan) => Prepared::of(&self.resident, plan),
            None => match known() {
                Some(i) => self.prepared.drain(..=i).next_back().expect("it is there"),
                None => Prepared::new(&self.resident, camera, options),
            },
        };
        self.check_steps(&setup, options)?;
        let mut plan = Plan::new(&self.resident, &setup, camera, options, outputs, &self.options, &self.engine);
        plan.derived = derives_normals(&self.resident, options);
        if self.counts_usage {
            plan.n_slots = usage::slots(&self.resident).1;
            (plan.image_voxel, plan.plane_voxel) = (true, true);
        }
        self.reserve(&plan)?;
        if plan.shadows {
            self.shadows(&mut upload.frame)?;
        }
        if plan.smooth {
            self.surface(&setup, &mut upload.frame)?;
        }
        if plan.kernel == Kernel::Raycast && self.tree_bytes == 0 {
            self.plant()?;
        }
        self.upload(&upload, camera, options.ssao_samples);
        let matter = self.matter(camera, options)?;

        let mut encoder = self.engine.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        if plan.n_slots > 0 {
            encoder.clear_buffer(&self.buffers["usage"], 0, None);
        }
        let pass = (!plan.stage_times).then(|| self.pass(&mut encoder, "frame", 0).forget_lifetime());
        let mut recorder = Recorder { pass, encoder };
        match begin {
            Begin::Traverse => {
                self.traverse(&mut recorder, &plan, options)?;
                self.remap(&mut recorder, &plan)?;
            }
            Begin::Planes(buffer) => {
                self.write("plane_color", bytemuck::cast_slice(&buffer.color));
                self.write("plane_depth", bytemuck::cast_slice(&buffer.depth));
                if plan.plane_voxel {
                    self.write("plane_voxel", bytemuck::cast_slice(&buffer.voxel));
                }
                self.remap(&mut recorder, &plan)?;
            }
            Begin::Image { color, depth } => {
                self.write("image_color", bytemuck::cast_slice(color));
                self.write("image_depth", bytemuck::cast_slice(depth));
            }
        }
        self.shade(&mut recorder, &plan, order)?;
        if matter {
            self.compose(&mut recorder, &plan, order)?;
        }
        if plan.n_slots > 0 {
            self.count_usage(&mut recorder, &plan)?;
        }
        let Recorder { pass, mut encoder } = recorder;
        drop(pass);
        if let Some(queries) = &self.queries {
            let times = if plan.stage_times { TIMES } else { 2 };
            encoder.resolve_query_set(queries, 0..times, &self.buffers["times"], 0);
        }
        self.engine.queue.submit([encoder.finish()]);
        let setup_ms = start.elapsed().as_secs_f64() * 1e3;

        let frame = self.empty_frame(&plan, &setup, camera, options);
        Ok(Drawn::Sent(Box::new(Sent { plan, frame, start, setup_ms })))
    }
}

/// Columns that one lane may have to look at one after the other. Each waits for memory once or twice, about a
/// microsecond: more of them and drivers that reset a device after two seconds would.
const MAX_STEPS: u64 = 1 << 21;

/// Turns after which llvmpipe, the software device, ends every loop, counted over all loops of a lane. It then draws on
/// with what it has, a wrong picture: walks say when that has happened.
const SOFTWARE_TURNS: u64 = 65_535;

/// Columns of a walk that is sure to take more, and is not begun.
const MAX_STEPS_SOFTWARE: u64 = 60_000;

/// What a walk that was cut short says it visited: `CUT_SHORT` in the shaders.
const CUT_SHORT: u32 = u32::MAX;

/// A frame's sizes and variants.
struct Plan {
    kernel: Kernel,
    width: u32,
    height: u32,
    n_planes: u32,
    samples: u64,
    /// Samples of the longest plane.
    longest: u32,
    lanes: u32,
    /// Visibility bits or keys stand in a storage buffer: they do not fit in workgroup memory.
    spill: bool,
    /// Words of bits, or keys, a plane.
    words: u32,
    /// Planes write voxels; the picture has them.
    plane_voxel: bool,
    image_voxel: bool,
    /// The picture's voxels are read back.
    read_voxel: bool,
    /// Slots whose pixels are counted; 0 where they are not.
    n_slots: u32,
    retest: bool,
    refine: bool,
    sparse: bool,
    gap_fill: bool,
    n_counters: u32,
    count: bool,
    stage_times: bool,
    shading: Shading,
    ssao_samples: u32,
    shadows: bool,
    smooth: bool,
    derived: bool,
    specialization: Specialization,
}

impl Plan {
    fn new(
        resident: &Resident,
        setup: &Setup,
        camera: &Camera,
        options: &Options,
        outputs: Outputs,
        gpu: &GpuOptions,
        engine: &Engine,
    ) -> Plan {
        let retest = setup.retests(camera, options);
        // Planes at most a pixel apart reach every pixel.
        let sparse = setup.is_sparse();
        let longest = setup.fans.iter().filter(|f| f.n_planes > 0).map(|f| f.n_samples).max().unwrap_or(0).max(1);
        let memory = engine.limits.max_compute_workgroup_storage_size.min(gpu.workgroup_memory);
        let most = engine.limits.max_compute_invocations_per_workgroup;
        let mut plan = Plan {
            kernel: gpu.kernel,
            width: camera.width,
            height: camera.height,
            n_planes: setup.planes.len() as u32,
            samples: setup.samples as u64,
            longest,
            lanes: 0,
            spill: false,
            words: 0,
            plane_voxel: outputs.voxel || retest,
            image_voxel: outputs.voxel,
            read_voxel: outputs.voxel,
            n_slots: 0,
            retest,
            refine: !gpu.kernel.casts_rays() && setup.refines(camera, options),
            sparse,
            gap_fill: options.gap_fill,
            n_counters: 0,
            count: gpu.count,
            stage_times: gpu.stage_times,
            shading: options.lit(),
            ssao_samples: options.ssao_samples,
            shadows: options.shadows,
            smooth: false,
            derived: false,
            specialization: Specialization::new(resident, setup, camera, options, Twin::Gpu),
        };
        // The surface is that of heights.
        plan.smooth = options.smooth && plan.specialization.has(Feature::Heights);
        match gpu.kernel {
            Kernel::Invocation => {
                plan.words = longest.div_ceil(32);
                plan.lanes = gpu.lanes.unwrap_or(INVOCATION_LANES).min(most);
                while plan.lanes > 1 && plan.lanes * plan.words * 4 > memory {
                    plan.lanes /= 2;
                }
                plan.spill = plan.words * 4 * plan.lanes > memory;
                plan.n_counters = plan.n_planes;
            }
            Kernel::Workgroup => {
                plan.lanes = gpu.lanes.unwrap_or(workgroup_lanes(plan.pixels())).min(most);
                // Keys begin at a whole block.
                let keys = setup.planes.iter().map(|p| p.end - (p.first & !15));
                plan.longest = keys.max().unwrap_or(0).max(1);
                let fine = plan.fine();
                // As the shader lays them out.
                let ground = plan.specialization.has(Feature::Horizon);
                plan.words = if ground { fine } else { fine + fine / 4 + 3 * (fine / 16) };
                plan.spill = plan.words * 4 + workgroup_other(plan.lanes) > memory;
                plan.n_counters = plan.n_planes;
            }
            Kernel::Raycast | Kernel::RaycastRuns => {
                plan.lanes = 8;
                plan.n_counters = groups(plan.width, 8) * groups(plan.height, 8);
            }
        }
        plan
    }

    fn pixels(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height)
    }

    /// Keys of a plane's samples, in steps: few sizes make few pipelines.
    fn fine(&self) -> u32 {
        self.longest.next_multiple_of(64)
    }

    /// What the shaders' text depends on beside the stage.
    fn defines(&self) -> Vec<&'static str> {
        let defines = [(Feature::Heights, "HEIGHTS"), (Feature::Packed, "PACKED"), (Feature::LateColor, "LATE_COLOR")];
        defines.into_iter().filter(|(f, _)| self.specialization.has(*f)).map(|(_, name)| name).collect()
    }

    /// Bytes of the lines that lead from pixels to planes.
    fn lines(&self) -> u64 {
        u64::from(self.height + 2 * self.width) * size_of::<types::Line>() as u64
    }

    fn gathers(&self) -> bool {
        self.sparse && !self.retest && !self.kernel.casts_rays()
    }

    /// What is read back, with the picture or only the figures.
    fn parts(&self, picture: bool, depth: bool) -> Parts {
        let n_counters = if self.count { self.n_counters } else { 0 };
        let pixels = if picture { self.pixels() } else { 0 };
        let mut at = 0u64;
        let mut take = |bytes: u64| {
            let from = at;
            at += bytes.next_multiple_of(16);
            from
        };
        Parts {
            color: take(4 * pixels),
            depth: take(if depth { 4 * pixels } else { 0 }),
            voxel: take(if self.read_voxel { 16 * pixels } else { 0 }),
            counters: take(12 * u64::from(n_counters)),
            holes: take(4),
            times: take(8 * u64::from(TIMES)),
            usage: take(4 * u64::from(self.n_slots)),
            n_slots: self.n_slots as usize,
            end: at,
            n_counters: n_counters as usize,
            stage_times: self.stage_times,
        }
    }
}

impl GpuRenderer {
    /// Makes sure that every buffer of a frame exists and is long enough.
    fn reserve(&mut self, plan: &Plan) -> Result<()> {
        use wgpu::BufferUsages as U;
        let pixels = plan.pixels();
        let planes = if plan.kernel.casts_rays() { 0 } else { plan.samples };
        let plane_voxel = if plan.plane_voxel { planes } else { 0 };
        let image_voxel = if plan.image_voxel { pixels } else { 0 };
        let index = if plan.gathers() { pixels } else { 0 };
        let spill = if plan.spill { 4 * u64::from(plan.words) * u64::from(plan.n_planes) } else { 0 };
        let sizes = [
            ("frame", size_of::<FrameParams>() as u64, U::UNIFORM),
            ("times", 8 * u64::from(TIMES), U::QUERY_RESOLVE),
            ("planes", u64::from(plan.n_planes) * size_of::<types::Plane>() as u64, U::STORAGE),
            ("lines", plan.lines() + 16 * u64::from(plan.n_planes), U::STORAGE),
            ("spiral", 8 * 16 * u64::from(plan.ssao_samples), U::STORAGE),
            ("plane_color", if plan.specialization.has(Feature::LateColor) { 0 } else { 4 * planes }, U::STORAGE),
            ("plane_depth", 4 * planes, U::STORAGE),
            ("plane_voxel", if plan.specialization.has(Feature::Packed) { 8 } else { 16 } * plane_voxel, U::STORAGE),
            ("image_color", 4 * pixels, U::STORAGE),
            ("image_depth", if plan.refine { 8 } else { 4 } * pixels, U::STORAGE),
            ("image_voxel", 16 * image_voxel, U::STORAGE),
            ("shaded", 4 * pixels, U::STORAGE),
            ("index", 4 * index, U::STORAGE),
            ("filled", 4 * index, U::STORAGE),
            ("holes", 4, U::STORAGE),
            ("usage", 4 * u64::from(plan.n_slots), U::STORAGE),
            ("scratch", 12 * u64::from(plan.n_counters) + spill, U::STORAGE),
        ];
        let limit = self.engine.limits.max_storage_buffer_binding_size.min(self.engine.limits.max_buffer_size);
        for (name, size, usage) in sizes {
            let size = size.max(64);
            if self.buffers.get(name).is_some_and(|b| b.size() >= size) {
                continue;
            }
            if size > limit {
                return Err(Error::Limit(format!(
                    "image of {} × {} pixels: {name} takes {} MiB, {} allows {} MiB (max_storage_buffer_binding_size); \
                     try a smaller --size or --device cpu",
                    plan.width,
                    plan.height,
                    size >> 20,
                    self.engine.name,
                    limit >> 20
                )));
            }
            let buffer = self.engine.checked(&format!("{name} of {} MiB", size.div_ceil(1 << 20)), || {
                self.engine.buffer(name, size, usage)
            })?;
            self.buffers.insert(name, buffer);
        }
        Ok(())
    }

    /// Sends what walks towards the sun need, once, and tells the frame of it.
    fn shadows(&mut self, frame: &mut FrameParams) -> Result<()> {
        if self.tops.is_none() {
            let tops = Tops::new(&self.resident);
            self.send("tops", &tops.words())?;
            self.tops = Some(tops);
        }
        if let Some(tops) = &self.tops {
            (frame.top_levels, frame.world_top) = (tops.levels.len() as u32, tops.top as f32);
        }
        Ok(())
    }

    /// The same of the surface of a height field.
    fn surface(&mut self, setup: &Setup, frame: &mut FrameParams) -> Result<()> {
        let repeats = setup.repeats;
        if self.surface.as_ref().is_none_or(|(_, known)| *known != repeats)
            && let Some(tops) = Tops::over_surface(&self.resident, repeats)
        {
            self.send("surface_tops", &tops.words())?;
            let fractions: Vec<u32> = self
                .resident
                .fractions
                .chunks(4)
                .map(|four| four.iter().zip([0, 8, 16, 24]).map(|(&f, shift)| u32::from(f) << shift).sum())
                .collect();
            self.send("fractions", &fractions)?;
            self.surface = Some((tops, repeats));
        }
        let below = Ground::new(&self.resident, repeats).is_none_or(|ground| smooth::is_below(ground, setup));
        if let Some((tops, _)) = &self.surface
            && !below
        {
            (frame.surface_levels, frame.surface_top) = (tops.levels.len() as u32, tops.top as f32);
        }
        Ok(())
    }

    /// Sends the scene's translucent matter once, and what it looks like when that has changed. Whether there is any to see.
    fn matter(&mut self, camera: &Camera, options: &Options) -> Result<bool> {
        let Some(matter) = self.resident.matter.clone() else { return Ok(false) };
        let look = matter.look();
        if look.is_clear() {
            return Ok(false);
        }
        let [nx, _, nz] = matter.levels[0].dims();
        let limit = self.engine.limits.max_storage_buffer_binding_size.min(self.engine.limits.max_buffer_size);
        if matter.bytes() > limit {
            return Err(Error::Limit(format!(
                "translucent matter of {} MiB: {} allows {} MiB (max_storage_buffer_binding_size); try --device cpu",
                matter.bytes() >> 20,
                self.engine.name,
                limit >> 20
            )));
        }
        // Spans of columns take turns, too.
        if self.engine.software && u64::from(nx) + u64::from(nz) > MAX_STEPS_SOFTWARE / 8 {
            return Err(Error::Limit(format!(
                "translucent matter of {nx} × {nz} columns: too many for {}, try --device cpu",
                self.engine.name
            )));
        }
        if !self.buffers.contains_key("matter") {
            self.send("matter", &matter::columns(&matter))?;
        }
        if self.look.as_ref().is_none_or(|known| !Arc::ptr_eq(known, &look)) {
            self.send("matter_look", &matter::look(&matter, &look))?;
            self.look = Some(look);
        }
        self.write("matter_look", bytemuck::cast_slice(&matter::frame(&matter, camera, options)));
        Ok(true)
    }

    /// Records the stage that puts matter over the picture.
    fn compose(&mut self, recorder: &mut Recorder, plan: &Plan, order: ByteOrder) -> Result<()> {
        let bgra = f64::from(u8::from(order == ByteOrder::Bgra));
        let pipeline = self.engine.pipeline("matter", &self.variant(&[]), &[("BGRA", bgra)])?;
        let grid = [groups(plan.width, 8), groups(plan.height, 8)];
        self.record(recorder, "matter", 2, |pass| self.dispatch(pass, &pipeline, &[], grid));
        Ok(())
    }

    /// Records the stage that counts pixels by slot.
    fn count_usage(&mut self, recorder: &mut Recorder, plan: &Plan) -> Result<()> {
        let pipeline = self.engine.pipeline("usage", &self.variant(&plan.defines()), &[])?;
        let grid = [groups(plan.width, 16), groups(plan.height, 16)];
        match &mut recorder.pass {
            Some(pass) => self.dispatch(pass, &pipeline, &[], grid),
            // In no stage's time.
            None => {
                let mut pass = recorder.encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
                self.dispatch(&mut pass, &pipeline, &[], grid);
            }
        }
        Ok(())
    }

    /// Makes a buffer of the scene's that only some frames need.
    fn send(&mut self, name: &'static str, words: &[u32]) -> Result<()> {
        let size = (4 * words.len() as u64).max(64);
        let buffer = self.engine.checked(name, || self.engine.buffer(name, size, wgpu::BufferUsages::STORAGE))?;
        self.engine.queue.write_buffer(&buffer, 0, bytemuck::cast_slice(words));
        self.buffers.insert(name, buffer);
        Ok(())
    }

    /// Makes the tree that rays are cast through and brings it to the device.
    fn plant(&mut self) -> Result<()> {
        let tree = Tree::new(&self.resident)?;
        let limit = self.engine.limits.max_storage_buffer_binding_size.min(self.engine.limits.max_buffer_size);
        if tree.bytes() > limit {
            return Err(Error::Limit(format!(
                "tree of {} MiB for kernel raycast: {} allows {} MiB (max_storage_buffer_binding_size); try --kernel raycast-runs",
                tree.bytes() >> 20,
                self.engine.name,
                limit >> 20
            )));
        }
        let mut roots = [Roots::default(); types::MAX_LEVELS];
        roots[..tree.levels.len()].copy_from_slice(&tree.levels);
        let sizes = [
            ("tree", size_of_val(&tree.words[..]), wgpu::BufferUsages::STORAGE),
            ("roots", size_of_val(&roots), wgpu::BufferUsages::UNIFORM),
        ];
        for (name, size, usage) in sizes {
            let buffer = self.engine.checked(&format!("{name} of {} MiB", size.div_ceil(1 << 20)), || {
                self.engine.buffer(name, size as u64, usage)
            })?;
            self.buffers.insert(name, buffer);
        }
        self.write("roots", bytemuck::cast_slice(&roots));
        // What is on its way takes host memory too.
        for (part, i) in tree.words.chunks(8 << 20).zip(0..) {
            self.write_at("tree", i * (32 << 20), bytemuck::cast_slice(part));
            self.engine.flush()?;
        }
        self.tree_bytes = tree.bytes();
        Ok(())
    }

    fn upload(&self, upload: &Upload, camera: &Camera, ssao_samples: u32) {
        self.write("frame", bytemuck::bytes_of(&upload.frame));
        self.write("planes", bytemuck::cast_slice(&upload.planes));
        self.write("lines", bytemuck::cast_slice(&upload.lines));
        self.write_at("lines", size_of_val(&upload.lines[..]) as u64, bytemuck::cast_slice(&upload.stripes));
        self.write("holes", &[0; 4]);
        self.write("spiral", bytemuck::cast_slice(&shade::spiral(shade::radius_px(camera), ssao_samples)));
    }

    fn write(&self, name: &str, bytes: &[u8]) {
        self.write_at(name, 0, bytes);
    }

    fn write_at(&self, name: &str, at: u64, bytes: &[u8]) {
        if !bytes.is_empty() {
            self.engine.queue.write_buffer(&self.buffers[name], at, bytes);
        }
    }

    /// Records one dispatch. `names` maps what a shader calls a buffer to what it is called here, where that differs.
    fn dispatch(
        &self,
        pass: &mut wgpu::ComputePass<'_>,
        pipeline: &Pipeline,
        names: &[(&str, &str)],
        [x, y]: [u32; 2],
    ) {
        let entries: Vec<_> = pipeline
            .bindings
            .iter()
            .map(|(binding, name)| {
                let name = names.iter().find(|(own, _)| own == name).map_or(name.as_str(), |(_, here)| here);
                let buffer = self.tables.buffer(name).or_else(|| self.buffers.get(name));
                let buffer =
                    buffer.unwrap_or_else(|| unreachable!("shaders name only buffers that `reserve` makes: {name}"));
                wgpu::BindGroupEntry { binding: *binding, resource: buffer.as_entire_binding() }
            })
            .collect();
        let group = self.engine.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &pipeline.pipeline.get_bind_group_layout(0),
            entries: &entries,
        });
        pass.set_pipeline(&pipeline.pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.dispatch_workgroups(x, y, 1);
    }

    fn pass<'e>(&self, encoder: &'e mut wgpu::CommandEncoder, label: &str, stage: u32) -> wgpu::ComputePass<'e> {
        encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some(label),
            timestamp_writes: self.queries.as_ref().map(|query_set| wgpu::ComputePassTimestampWrites {
                query_set,
                beginning_of_pass_write_index: Some(2 * stage),
                end_of_pass_write_index: Some(2 * stage + 1),
            }),
        })
    }

    /// Records a stage, in the frame's pass or in one of its own.
    fn record(
        &self,
        recorder: &mut Recorder,
        label: &str,
        stage: u32,
        record: impl FnOnce(&mut wgpu::ComputePass<'_>),
    ) {
        match &mut recorder.pass {
            Some(pass) => record(pass),
            None => record(&mut self.pass(&mut recorder.encoder, label, stage)),
        }
    }

    fn variant(&self, defines: &[&'static str]) -> Variant {
        let paged = self.tables.is_paged().then_some("PAGED");
        Variant { defines: defines.iter().copied().chain(paged).collect(), pages: self.tables.pages }
    }

    fn traverse(&mut self, recorder: &mut Recorder, plan: &Plan, options: &Options) -> Result<()> {
        let on = |b: bool| f64::from(u8::from(b));
        let culling = options.culling;
        let voxel = if plan.kernel.casts_rays() { plan.image_voxel } else { plan.plane_voxel };
        let mut constants = vec![
            ("PAINT", self.tables.paint.constant()),
            ("VOXEL", on(voxel)),
            ("COUNT", on(self.options.count)),
            ("COARSE", on(culling.coarse)),
            ("WIDTH", f64::from(plan.lanes)),
            ("REPEATS", on(!plan.specialization.has(Feature::Bounded))),
            ("ONE_LEVEL", on(plan.specialization.has(Feature::OneLevel))),
            ("UPRIGHT", on(plan.specialization.has(Feature::Upright))),
            ("ENDS_LOOPS", on(self.engine.software)),
        ];
        let mut defines = plan.defines();
        let (name, groups) = match plan.kernel {
            Kernel::Invocation => {
                constants.extend([
                    ("HORIZON", on(culling.horizon)),
                    ("CENTER", on(culling.center)),
                    ("FORWARD", on(culling.forward)),
                    ("BITS", on(culling.bits)),
                    ("WORDS", f64::from(plan.words)),
                ]);
                if plan.spill {
                    defines.push("STORAGE_BITS");
                }
                ("traverse_invocation", [groups(plan.n_planes, plan.lanes), 1])
            }
            Kernel::Workgroup => {
                constants.extend([("HORIZON", on(culling.horizon)), ("FINE", f64::from(plan.fine()))]);
                if plan.spill {
                    defines.push("STORAGE_KEYS");
                }
                if plan.specialization.has(Feature::Horizon) {
                    defines.push("GROUND");
                }
                if self.options.proved_uniform {
                    defines.push("UNIFORM");
                }
                let x = plan.n_planes.min(GROUPS_A_ROW);
                ("traverse_workgroup", [x, groups(plan.n_planes, x.max(1))])
            }
            Kernel::Raycast => {
                if self.tables.paint == PaintKind::Run {
                    defines.push("RUN_COLORS");
                }
                ("raycast", [groups(plan.width, 8), groups(plan.height, 8)])
            }
            Kernel::RaycastRuns => ("raycast_runs", [groups(plan.width, 8), groups(plan.height, 8)]),
        };
        let pipeline = self.engine.pipeline(name, &self.variant(&defines), &constants)?;
        self.record(recorder, "traverse", 0, |pass| self.dispatch(pass, &pipeline, &[], groups));
        Ok(())
    }

    fn remap(&mut self, recorder: &mut Recorder, plan: &Plan) -> Result<()> {
        let grid = [groups(plan.width, 16), groups(plan.height, 16)];
        let voxel = ("VOXEL", f64::from(u8::from(plan.image_voxel)));
        let surface = self.smooth(plan)?;
        if plan.kernel.casts_rays() {
            self.record(recorder, "remap", 1, |pass| surface.iter().for_each(|s| self.dispatch(pass, s, &[], grid)));
            return Ok(());
        }
        if !plan.gathers() {
            let mut defines = plan.defines();
            if plan.retest {
                defines.push("RETEST");
            }
            if plan.refine {
                defines.push("REFINE");
            }
            let on = f64::from(u8::from(!plan.specialization.has(Feature::Bounded)));
            let constants = [voxel, ("PAINT", self.tables.paint.constant()), ("REPEATS", on)];
            let pipeline = self.engine.pipeline("remap", &self.variant(&defines), &constants)?;
            let refine = match plan.refine {
                true => Some(self.engine.pipeline("refine", &self.variant(&plan.defines()), &constants)?),
                false => None,
            };
            self.record(recorder, "remap", 1, |pass| {
                self.dispatch(pass, &pipeline, &[], grid);
                refine.iter().chain(&surface).for_each(|stage| self.dispatch(pass, stage, &[], grid));
            });
            return Ok(());
        }
        let index = self.engine.pipeline("remap", &self.variant(&["INDEX"]), &[voxel])?;
        let gather = self.engine.pipeline("remap", &self.variant(&["GATHER"]), &[voxel])?;
        let fill = self.engine.pipeline("gap_fill", &self.variant(&[]), &[])?;
        self.record(recorder, "remap", 1, |pass| {
            self.dispatch(pass, &index, &[], grid);
            if plan.gap_fill {
                self.dispatch(pass, &fill, &[("before", "index"), ("index", "filled")], grid);
            }
            let chosen = if plan.gap_fill { "filled" } else { "index" };
            self.dispatch(pass, &gather, &[("index", chosen)], grid);
            surface.iter().for_each(|stage| self.dispatch(pass, stage, &[], grid));
        });
        Ok(())
    }

    /// What draws the surface of a height field over its blocks, where that is asked for.
    fn smooth(&mut self, plan: &Plan) -> Result<Option<Arc<Pipeline>>> {
        if !plan.smooth {
            return Ok(None);
        }
        let on = |b: bool| f64::from(u8::from(b));
        let mut defines = vec!["HEIGHTS"];
        defines.extend((!self.resident.fractions.is_empty()).then_some("FRACTIONS"));
        let repeats = on(!plan.specialization.has(Feature::Bounded));
        let constants =
            [("VOXEL", on(plan.image_voxel)), ("PAINT", self.tables.paint.constant()), ("REPEATS", repeats)];
        self.engine.pipeline("smooth", &self.variant(&defines), &constants).map(Some)
    }

    fn shade(&mut self, recorder: &mut Recorder, plan: &Plan, order: ByteOrder) -> Result<()> {
        let normals = matches!(plan.shading, Shading::Ssn | Shading::Full);
        let occlusion = matches!(plan.shading, Shading::Ssao | Shading::Full);
        let on = |b: bool| f64::from(u8::from(b));
        let bgra = on(order == ByteOrder::Bgra);
        let samples = f64::from(plan.ssao_samples);
        let mut constants =
            vec![("NORMALS", on(normals)), ("OCCLUSION", on(occlusion)), ("SSAO_SAMPLES", samples), ("BGRA", bgra)];
        let mut defines = Vec::new();
        if plan.shadows || plan.smooth || plan.derived {
            defines.push("SCENE");
            defines.extend(plan.specialization.has(Feature::Heights).then_some("HEIGHTS"));
            constants.push(("REPEATS", on(!plan.specialization.has(Feature::Bounded))));
        }
        if plan.shadows {
            defines.push("SHADOWS");
            constants.push(("SMOOTH", on(plan.smooth)));
        }
        if plan.smooth {
            defines.push("SMOOTH_NORMALS");
            defines.extend((!self.resident.fractions.is_empty()).then_some("FRACTIONS"));
        } else if plan.derived {
            defines.push("DERIVED_NORMALS");
        }
        let pipeline = self.engine.pipeline("shade", &self.variant(&defines), &constants)?;
        let grid = [groups(plan.width, 16), groups(plan.height, 16)];
        self.record(recorder, "shade", 2, |pass| self.dispatch(pass, &pipeline, &[], grid));
        self.shaded_order = order;
        Ok(())
    }

    /// Copies what is asked for into a read-back buffer and asks for it to be mapped; does not wait.
    fn read_back(&mut self, plan: &Plan, frame: Frame, start: Instant, setup_ms: f64) -> Result<()> {
        let parts = plan.parts(true, self.depth);
        let readback = self.readback(&parts)?;
        let (submission, mapped) = self.ask(plan, parts, &readback);
        let drawing = Drawing { frame, start, submission, mapped, readback, parts, setup_ms };
        self.pending.push_back(Pending::Drawing(Box::new(drawing)));
        Ok(())
    }

    /// A read-back buffer that is long enough.
    fn readback(&mut self, parts: &Parts) -> Result<wgpu::Buffer> {
        match self.free.iter().position(|b| b.size() >= parts.end) {
            Some(i) => Ok(self.free.swap_remove(i)),
            None => {
                self.free.clear();
                self.engine.checked(&format!("read-back buffer of {} MiB", parts.end >> 20), || {
                    self.engine.device.create_buffer(&wgpu::BufferDescriptor {
                        label: Some("read-back"),
                        size: parts.end,
                        usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
                        mapped_at_creation: false,
                    })
                })
            }
        }
    }

    /// Copies a frame's parts into a read-back buffer and asks for it to be mapped.
    fn ask(&self, plan: &Plan, parts: Parts, readback: &wgpu::Buffer) -> (wgpu::SubmissionIndex, Mapped) {
        // A submission of its own: timestamps copied in the one that resolves them can read 0 (wgpu issue 6406).
        let mut encoder = self.engine.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        self.copy(&mut encoder, plan, parts, readback, true);
        let submission = self.engine.queue.submit([encoder.finish()]);
        (submission, map(readback, parts))
    }

    /// Records the copies of a frame's parts.
    fn copy(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        plan: &Plan,
        parts: Parts,
        readback: &wgpu::Buffer,
        times: bool,
    ) {
        // Figures alone begin with the counters.
        let pixels = if parts.counters > 0 { plan.pixels() } else { 0 };
        let mut copy = |name: &str, at: u64, bytes: u64| {
            if bytes > 0 {
                encoder.copy_buffer_to_buffer(&self.buffers[name], 0, readback, at, bytes);
            }
        };
        copy("shaded", parts.color, 4 * pixels);
        copy("image_depth", parts.depth, if parts.voxel > parts.depth { 4 * pixels } else { 0 });
        copy("image_voxel", parts.voxel, if plan.read_voxel { 16 * pixels } else { 0 });
        copy("scratch", parts.counters, 12 * parts.n_counters as u64);
        copy("holes", parts.holes, 4);
        copy("times", parts.times, if times { 8 * u64::from(TIMES) } else { 0 });
        copy("usage", parts.usage, 4 * parts.n_slots as u64);
    }

    fn finish(&mut self, drawing: Drawing) -> Result<Frame> {
        let Drawing { frame, start, submission, mapped, readback, parts, setup_ms } = drawing;
        self.read(frame, mapped, readback, parts, Some(submission), setup_ms, start)
    }

    /// Reads a frame back; waits for a submission, if there is one to wait for.
    #[expect(clippy::too_many_arguments, reason = "the fields of a frame on its way")]
    fn read(
        &mut self,
        mut frame: Frame,
        mapped: Mapped,
        readback: wgpu::Buffer,
        parts: Parts,
        submission: Option<wgpu::SubmissionIndex>,
        setup_ms: f64,
        start: Instant,
    ) -> Result<Frame> {
        if submission.is_some() {
            self.engine.wait(submission)?;
        }
        let lost = |e: String| {
            Error::Device(format!("{}: cannot read the frame back ({e}); try --device cpu", self.engine.name))
        };
        mapped.recv().map_err(|e| lost(e.to_string()))?.map_err(|e| lost(e.to_string()))?;
        let whole;
        {
            let bytes = readback.get_mapped_range(..parts.end).map_err(|e| lost(e.to_string()))?;
            let part = |from: u64, n: usize| &bytes[from as usize..from as usize + n];
            let pixels = frame.width as usize * frame.height as usize;
            let spare = self.spare.pop();
            let (color, depth, voxel) = spare.map(|f| (f.color, f.depth, f.voxel)).unwrap_or_default();
            frame.color = refilled(color, part(parts.color, 4 * pixels));
            frame.depth = refilled(depth, part(parts.depth, if parts.voxel > parts.depth { 4 * pixels } else { 0 }));
            frame.voxel =
                refilled(voxel, part(parts.voxel, if parts.counters > parts.voxel { 16 * pixels } else { 0 }));
            whole = self.figures_of(&bytes, parts, &mut frame.stats, setup_ms, start);
            self.usage = parts.usage_in(&bytes, std::mem::take(&mut self.usage));
        }
        readback.unmap();
        self.free.push(readback);
        whole.map(|()| frame)
    }

    /// Fills in what the device counted and timed, from a read-back buffer. An error where walks were cut short.
    fn figures_of(&self, bytes: &[u8], parts: Parts, stats: &mut Stats, setup_ms: f64, start: Instant) -> Result<()> {
        let part = |from: u64, n: usize| &bytes[from as usize..from as usize + n];
        let counters: &[[u32; 3]] = bytemuck::cast_slice(part(parts.counters, 12 * parts.n_counters));
        let sum = |i: usize| counters.iter().map(|c| u64::from(c[i])).sum();
        (stats.columns_visited, stats.runs_visited, stats.spans_drawn) = (sum(0), sum(1), sum(2));
        stats.holes = u64::from(bytemuck::pod_read_unaligned::<u32>(part(parts.holes, 4)));
        let times: Vec<u64> = bytemuck::pod_collect_to_vec(part(parts.times, 8 * TIMES as usize));
        stats.gpu_ms = Some(self.stage_times(&times, parts.stage_times, setup_ms, start));
        match counters.iter().filter(|c| c[0] == CUT_SHORT).count() {
            0 => Ok(()),
            n => Err(Error::Limit(format!(
                "kernel {}: {n} of {} walks took more turns than {} allows ({SOFTWARE_TURNS}); try a smaller \
                 --view-distance or --device cpu",
                stats.kernel,
                counters.len(),
                self.engine.name
            ))),
        }
    }

    /// Milliseconds by stage, or of all; without timestamps only what the host sees.
    fn stage_times(&self, times: &[u64], by_stage: bool, setup: f64, start: Instant) -> StageTimes {
        let Some(tick) = self.engine.tick_ns else {
            return StageTimes { setup, total: start.elapsed().as_secs_f64() * 1e3, ..StageTimes::default() };
        };
        // Some drivers order timestamps wrongly (wgpu issue 5660).
        let between = |from: u64, to: u64| to.saturating_sub(from) as f64 * f64::from(tick) * 1e-6;
        if !by_stage {
            return StageTimes { setup, total: between(times[0], times[1]), ..StageTimes::default() };
        }
        let stage = |s: usize| between(times[2 * s], times[2 * s + 1]);
        StageTimes { setup, traverse: stage(0), remap: stage(1), shade: stage(2), total: between(times[0], times[5]) }
    }
}
