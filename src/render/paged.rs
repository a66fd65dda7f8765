//! Draws a world whose tiles come as they are wanted.

use std::collections::VecDeque;
use std::sync::Arc;

use crate::cpu::renderer::{CpuRenderer, Outputs, check};
use crate::cpu::usage;
use crate::frame::camera::Camera;
use crate::frame::options::{Normals, Options};
#[cfg(feature = "gpu")]
use crate::frame::picture::Stats;
use crate::frame::picture::{Frame, PagingStats};
use crate::frame::plan::FramePlan;
use crate::frame::projection::{Projection, face_cameras, join_faces};
#[cfg(all(feature = "gpu", not(target_arch = "wasm32")))]
use crate::gpu::GpuOptions;
#[cfg(feature = "gpu")]
use crate::gpu::GpuRenderer;
#[cfg(not(target_arch = "wasm32"))]
use crate::render::device::Device;
use crate::world::pager::{Pager, Paging, Patience, Wanted, wanted};
#[cfg(feature = "gpu")]
use crate::world::probe::Probe;
use crate::world::tables::Resident;
use crate::{Error, Result};

/// By how much a view that the budget does not hold is drawn coarser at a time.
const COARSER: f64 = 1.25;

/// Frames until a finer view is tried again after one that the budget does not hold.
const STEADY: u32 = 8;

/// A view with `--lod off` that the budget does not hold begins here.
const FINEST: f64 = 0.25;

/// What draws from the tables.
pub(super) enum Painter {
    Cpu(Box<CpuRenderer>),
    #[cfg(feature = "gpu")]
    Gpu(Box<GpuRenderer>),
}

impl Painter {
    fn tables(&self) -> &Resident {
        match self {
            Painter::Cpu(cpu) => cpu.tables(),
            #[cfg(feature = "gpu")]
            Painter::Gpu(gpu) => gpu.tables(),
        }
    }

    fn tables_mut(&mut self) -> &mut Resident {
        let tables = match self {
            Painter::Cpu(cpu) => cpu.tables_mut(),
            #[cfg(feature = "gpu")]
            Painter::Gpu(gpu) => gpu.tables_mut(),
        };
        tables.expect("nobody else has them between frames")
    }

    /// Decides about a frame.
    fn plan(&mut self, camera: &Camera, options: &Options) -> FramePlan {
        match self {
            Painter::Cpu(cpu) => cpu.plan(camera, options),
            #[cfg(feature = "gpu")]
            Painter::Gpu(gpu) => FramePlan::new(gpu.tables(), camera, options),
        }
    }

    /// Frames that may be on their way at once.
    fn in_flight(&self) -> usize {
        match self {
            Painter::Cpu(_) => 1,
            #[cfg(feature = "gpu")]
            Painter::Gpu(_) => IN_FLIGHT,
        }
    }
}

/// Frames that the device has at once: while it draws one, the host brings the tiles of the next.
#[cfg(feature = "gpu")]
const IN_FLIGHT: usize = 2;

/// A frame whose tiles are there, on its way.
struct Sent {
    job: (Camera, Options, Outputs),
    /// What the CPU draws once its turn comes.
    plan: Option<FramePlan>,
    paging: PagingStats,
    /// See [`Pager::missing_by_slot`]; empty where pixels are not counted.
    missing: Vec<u32>,
}

/// A pager, and what draws from its tables.
pub(super) struct Paged {
    pager: Pager,
    painter: Painter,
    patience: Patience,
    /// How much coarser than asked for the latest frame was.
    coarser: f64,
    /// The latest view that was too fine for the budget, and frames until another is tried finer.
    refused: Option<(Camera, Options)>,
    steady: u32,
    /// Whether pixels are counted by tile.
    count: bool,
    said_left_out: bool,
    ahead: VecDeque<Sent>,
    /// Of the frame that comes after those, once its tiles were asked for.
    next: Option<(FramePlan, Vec<Wanted>)>,
    /// Frames that were left on the device, whose figures have not come yet.
    #[cfg(feature = "gpu")]
    shown: VecDeque<(PagingStats, Vec<u32>)>,
}

/// The device that draws, as `Device` has it.
#[cfg(not(target_arch = "wasm32"))]
pub(super) fn open(resident: &Arc<Resident>, device: Device, tell: &mut dyn FnMut(&str)) -> Result<Painter> {
    let cpu = || Painter::Cpu(Box::new(CpuRenderer::of_tables(Arc::clone(resident))));
    match device {
        Device::Cpu => return Ok(cpu()),
        Device::Exact => {
            let what = "exact: rays need the whole world in memory; this one comes in tiles";
            return Err(Error::Argument(what.into()));
        }
        Device::Auto | Device::Gpu | Device::AllGpus => {}
    }
    #[cfg(feature = "gpu")]
    let gpu = GpuRenderer::of_tables(resident, GpuOptions::default()).and_then(|gpu| match device {
        Device::Auto if gpu.is_software() => {
            Err(Error::Device(format!("the only adapter is software ({})", gpu.device().0)))
        }
        _ => Ok(gpu),
    });
    #[cfg(not(feature = "gpu"))]
    let gpu: Result<Painter> = Err(Error::Device("this planecast was built without the feature gpu".into()));
    match gpu {
        #[cfg(feature = "gpu")]
        Ok(gpu) => {
            if device == Device::Auto {
                tell(&format!("drawing on the gpu: {}", gpu.device().0));
            }
            Ok(Painter::Gpu(Box::new(gpu)))
        }
        #[cfg(not(feature = "gpu"))]
        Ok(painter) => Ok(painter),
        Err(e) if device == Device::Auto => {
            tell(&format!("drawing on the cpu: {e}"));
            Ok(cpu())
        }
        Err(e) => Err(e),
    }
}

/// What a frame owes, once it is known how many of its pixels show each slot.
fn settle(paging: &mut PagingStats, usage: &[u32], missing: &[u32]) {
    let debt = usage.iter().zip(missing).map(|(&pixels, &levels)| u64::from(pixels) * u64::from(levels));
    paging.debt = debt.sum();
    paging.tiles_used = usage.iter().filter(|&&pixels| pixels > 0).count() as u32;
}

impl Paged {
    /// `open` is told of the tables, and opens what draws from them.
    pub fn new(
        (pager, resident): (Pager, Resident),
        patience: Patience,
        tell: &mut dyn FnMut(&str),
        open: impl FnOnce(&Arc<Resident>, &mut dyn FnMut(&str)) -> Result<Painter>,
    ) -> Result<Paged> {
        if pager.source().has_matter() {
            tell("translucent matter is left out: it needs the whole world, and this one comes in tiles");
        }
        let resident = Arc::new(resident);
        let painter = open(&resident, tell)?;
        drop(resident);
        Ok(Paged {
            pager,
            painter,
            patience,
            coarser: 1.0,
            refused: None,
            steady: 0,
            count: false,
            said_left_out: false,
            ahead: VecDeque::new(),
            next: None,
            #[cfg(feature = "gpu")]
            shown: VecDeque::new(),
        })
    }

    #[cfg(not(target_arch = "wasm32"))]
    pub fn set_count(&mut self, count: bool) {
        self.count = count;
        #[cfg(feature = "gpu")]
        if let Painter::Gpu(gpu) = &mut self.painter {
            gpu.set_count(count);
            gpu.set_stage_times(count);
        }
    }

    /// The name of what draws, for records.
    #[cfg(not(target_arch = "wasm32"))]
    pub fn name(&self) -> &'static str {
        match self.painter {
            Painter::Cpu(_) => "cpu",
            #[cfg(feature = "gpu")]
            Painter::Gpu(_) => "gpu",
        }
    }

    #[cfg(not(target_arch = "wasm32"))]
    pub fn reuse(&mut self, frame: Option<Frame>) {
        match &mut self.painter {
            Painter::Cpu(cpu) => cpu.reuse(frame),
            #[cfg(feature = "gpu")]
            Painter::Gpu(gpu) => gpu.reuse(frame),
        }
    }

    /// Draws one frame. `next` are the cameras of those that follow, as far as they are known.
    pub fn draw(
        &mut self,
        camera: &Camera,
        next: &[Camera],
        options: &Options,
        outputs: Outputs,
        tell: &mut dyn FnMut(&str),
    ) -> Result<Frame> {
        check(camera, options)?;
        let options = self.drawn(options, tell)?;
        if options.projection == Projection::Cube {
            let options = Options { projection: Projection::Perspective, ..options };
            let faces = face_cameras(camera);
            let faces = faces.iter().map(|face| self.draw(face, &[], &options, outputs, tell));
            return Ok(join_faces(camera, faces.collect::<Result<_>>()?));
        }
        let job = |camera: &Camera| (*camera, options, outputs);
        let cameras = || std::iter::once(camera).chain(next);
        if !self.ahead.iter().zip(cameras()).all(|(sent, camera)| sent.job == job(camera)) {
            self.forget();
        }
        for camera in cameras().skip(self.ahead.len()) {
            if self.ahead.len() >= self.painter.in_flight() {
                break;
            }
            match self.send(job(camera)) {
                Ok(sent) => self.ahead.push_back(sent),
                Err(e) if self.ahead.is_empty() => return Err(e),
                // It will be asked for once more when its turn comes.
                Err(_) => break,
            }
        }
        self.pager.take_notices().iter().for_each(|what| tell(what));
        // What comes after those meanwhile.
        if let Some(next) = cameras().nth(self.ahead.len()) {
            self.next = self.prefetch(next, &options);
        }
        let sent = self.ahead.pop_front().expect("the first frame was sent");
        self.finish(sent)
    }

    /// Asks for the tiles of a frame to come; `None` where no window holds them.
    fn prefetch(&mut self, camera: &Camera, options: &Options) -> Option<(FramePlan, Vec<Wanted>)> {
        // As fine as the latest was: the budget may hold no more.
        let options = Options { lod: self.lod(options), ..*options };
        let plan = FramePlan::new(self.painter.tables(), camera, &options);
        let wants = wanted(&plan.setup, self.painter.tables().dims)?;
        self.pager.prefetch(self.painter.tables(), &wants);
        Some((plan, wants))
    }

    /// Draws one frame for a window: here, or on the device, which keeps it ([`Paged::gpu`]). `soon` is where the camera will be
    /// soon, as far as that can be told.
    #[cfg(feature = "gpu")]
    pub fn show(
        &mut self,
        camera: &Camera,
        soon: Option<&Camera>,
        options: &Options,
        tell: &mut dyn FnMut(&str),
    ) -> Result<Option<Frame>> {
        check(camera, options)?;
        let options = self.drawn(options, tell)?;
        self.forget();
        let frame = match self.painter {
            Painter::Cpu(_) => {
                let sent = self.send((*camera, options, Outputs::default()))?;
                Some(self.finish(sent)?)
            }
            Painter::Gpu(_) => {
                let (plan, mut paging, missing) = self.ready(camera, &options)?;
                let Painter::Gpu(gpu) = &mut self.painter else { unreachable!("it is a GPU") };
                paging.bytes_uploaded = gpu.bring(&self.pager.take_changes())?;
                gpu.set_usage(!missing.is_empty());
                if gpu.draw_plan(plan)? {
                    self.shown.push_back((paging, missing));
                }
                None
            }
        };
        self.pager.take_notices().iter().for_each(|what| tell(what));
        if let Some(soon) = soon.filter(|soon| check(soon, &options).is_ok()) {
            self.prefetch(soon, &options);
        }
        Ok(frame)
    }

    /// What the latest frame that was left on the device cost of which that is known by now.
    #[cfg(feature = "gpu")]
    pub fn figures(&mut self) -> Result<Option<Stats>> {
        let Painter::Gpu(gpu) = &mut self.painter else { return Ok(None) };
        let mut latest = None;
        while let Some(mut stats) = gpu.next_figures()? {
            let (mut paging, missing) = self.shown.pop_front().expect("frames' figures come in their order");
            settle(&mut paging, gpu.usage(), &missing);
            stats.paging = paging;
            latest = Some(stats);
        }
        Ok(latest)
    }

    /// What draws, where that is a GPU.
    #[cfg(feature = "gpu")]
    pub fn gpu(&self) -> Option<&GpuRenderer> {
        match &self.painter {
            Painter::Gpu(gpu) => Some(gpu),
            Painter::Cpu(_) => None,
        }
    }

    #[cfg(feature = "gpu")]
    pub fn gpu_mut(&mut self) -> Option<&mut GpuRenderer> {
        match &mut self.painter {
            Painter::Gpu(gpu) => Some(gpu),
            Painter::Cpu(_) => None,
        }
    }

    /// How long frames from the next one on wait for their tiles; how long they did so far.
    pub fn set_patience(&mut self, patience: Patience) -> Patience {
        std::mem::replace(&mut self.patience, patience)
    }

    /// Looks into the tiles that are there.
    #[cfg(feature = "gpu")]
    pub fn probe(&self) -> Probe<'_> {
        Probe::new(&self.pager, self.painter.tables())
    }

    /// Brings the tiles of a frame. Of each slot, how many levels coarser it is than it should be; none where pixels need not be
    /// counted.
    fn ready(&mut self, camera: &Camera, options: &Options) -> Result<(FramePlan, PagingStats, Vec<u32>)> {
        let (plan, paging) = self.bring(camera, options)?;
        let count = self.count || paging.missing > 0;
        let missing = if count { self.pager.missing_by_slot() } else { Vec::new() };
        let paging = PagingStats {
            tiles_wanted: paging.wanted,
            tiles_missing: paging.missing,
            tiles_arrived: paging.arrived,
            tiles_evicted: paging.evicted,
            bytes_read: paging.bytes_read,
            bytes_resident: paging.bytes_resident,
            unpack_ms: paging.unpack_ms,
            upload_ms: paging.install_ms,
            lod: plan.options.lod.unwrap_or(0.0),
            ..PagingStats::default()
        };
        Ok((plan, paging, missing))
    }

    /// Brings the tiles of a frame and, where a device draws beside the host, has it begin.
    fn send(&mut self, job: (Camera, Options, Outputs)) -> Result<Sent> {
        let (camera, options, outputs) = job;
        let (plan, mut paging, missing) = self.ready(&camera, &options)?;
        let changes = self.pager.take_changes();
        let plan = match &mut self.painter {
            Painter::Cpu(_) => Some(plan),
            #[cfg(feature = "gpu")]
            Painter::Gpu(gpu) => {
                paging.bytes_uploaded = gpu.bring(&changes)?;
                gpu.set_usage(!missing.is_empty());
                gpu.submit_plan(plan, outputs)?;
                None
            }
        };
        // The CPU draws from the tables themselves.
        #[cfg(not(feature = "gpu"))]
        let _ = (changes, outputs, &mut paging);
        Ok(Sent { job, plan, paging, missing })
    }

    /// The frame that was sent first.
    fn finish(&mut self, Sent { job: (.., outputs), plan, mut paging, missing }: Sent) -> Result<Frame> {
        let counts = !missing.is_empty();
        let (mut frame, usage) = match &mut self.painter {
            Painter::Cpu(cpu) => {
                let plan = plan.expect("the CPU draws by it");
                let mut frame = cpu.draw(plan, Outputs { voxel: outputs.voxel || counts })?;
                let usage = if counts { usage::usage(cpu.tables(), &frame.voxel) } else { Vec::new() };
                if !outputs.voxel {
                    frame.voxel.clear();
                }
                (frame, usage)
            }
            #[cfg(feature = "gpu")]
            Painter::Gpu(gpu) => {
                let frame = gpu.collect().expect("a frame was submitted")?;
                (frame, gpu.usage().to_vec())
            }
        };
        settle(&mut paging, &usage, &missing);
        frame.stats.paging = paging;
        Ok(frame)
    }

    /// Gives up what is on its way: other frames are asked for.
    fn forget(&mut self) {
        self.ahead.clear();
        #[cfg(feature = "gpu")]
        if let Painter::Gpu(gpu) = &mut self.painter {
            while gpu.collect().is_some() {}
        }
    }

    /// Options without what needs the whole world.
    fn drawn(&mut self, options: &Options, tell: &mut dyn FnMut(&str)) -> Result<Options> {
        let options = options.drawn();
        if !matches!(options.projection, Projection::Perspective | Projection::Cube) {
            return Err(Error::Argument(format!(
                "projection {}: a world that comes in tiles is drawn in perspective and cube; open it whole for others",
                options.projection
            )));
        }
        if options.repeat.x || options.repeat.z {
            return Err(Error::Argument("a world that comes in tiles is not repeated; open it whole for that".into()));
        }
        let left_out = options.shadows || options.smooth;
        if left_out && !std::mem::replace(&mut self.said_left_out, true) {
            tell("shadows and surfaces are left out: they need the whole world, and this one comes in tiles");
        }
        let normals = if options.normals == Normals::Derived { Normals::Screen } else { options.normals };
        Ok(Options { shadows: false, smooth: false, normals, ..options })
    }

    /// The level of detail that is drawn of what was asked for.
    fn lod(&self, options: &Options) -> Option<f64> {
        match self.coarser > 1.0 {
            false => options.lod,
            true => Some(options.lod.unwrap_or(FINEST) * self.coarser),
        }
    }

    /// Brings the tiles of a frame, and says how fine it can be drawn.
    fn bring(&mut self, camera: &Camera, options: &Options) -> Result<(FramePlan, Paging)> {
        let patience = self.patience;
        let latest = self.coarser;
        // Back to what was asked for bit by bit, so that no two frames differ much. A view that rests stays as it is: to try it finer
        // once more would have it flicker, and bring tiles that are not held.
        self.steady = self.steady.saturating_sub(1);
        if self.steady == 0 && self.refused != Some((*camera, *options)) {
            self.coarser = (latest / COARSER.sqrt()).max(1.0);
        }
        loop {
            let drawn = Options { lod: self.lod(options), ..*options };
            let (plan, wants) = match self.next.take().filter(|(plan, _)| plan.is_of(camera, &drawn)) {
                Some((plan, wants)) => (plan, Some(wants)),
                None => {
                    let plan = self.painter.plan(camera, &drawn);
                    let wants = wanted(&plan.setup, self.painter.tables().dims);
                    (plan, wants)
                }
            };
            // None of so many that no window holds them.
            if let Some(wants) = wants
                && let Some(paging) = self.pager.update(self.painter.tables_mut(), &wants, patience)?
            {
                return Ok((plan, paging));
            }
            (self.refused, self.steady) = (Some((*camera, *options)), STEADY);
            self.coarser = if self.coarser < latest { latest } else { self.coarser * COARSER };
            if self.coarser > 1e6 {
                self.coarser = latest;
                return Err(Error::Limit(format!(
                    "{}: the memory allowed does not hold the tiles of one view, however coarse",
                    self.pager.source().name()
                )));
            }
        }
    }
}
