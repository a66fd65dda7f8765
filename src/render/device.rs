//! Which device draws: the GPU, the CPU, or the exact reference.

use crate::cpu::renderer::{CpuRenderer, Outputs};
use crate::error::{Error, Result};
use crate::frame::camera::Camera;
use crate::frame::options::Options;
use crate::frame::picture::Frame;
#[cfg(feature = "gpu")]
use crate::frame::projection::{Projection, face_cameras, join_faces};
#[cfg(feature = "gpu")]
use crate::gpu::{GpuOptions, GpuRenderer, Kernel};
use crate::render::paged::{self, Paged};
use crate::world::World;
use crate::world::pager::{Pager, Patience};
use crate::world::tables::Resident;
use crate::world::tint::Tint;
use planecast_encoder::{Scene, TileSource};
#[cfg(feature = "gpu")]
use std::collections::VecDeque;
use std::sync::Arc;

/// What was asked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Device {
    /// The GPU where a real one is usable, else the CPU.
    #[default]
    Auto,
    Gpu,
    /// Every GPU at once, a frame on each in turn: for films.
    AllGpus,
    Cpu,
    /// One f64 ray per pixel at level 0, on the CPU.
    Exact,
}

/// Draws frames of one world on the device that was chosen. It owns what it draws, and can be moved into a thread.
pub struct Renderer {
    backend: Backend,
    /// What was decided without being asked for: which device `auto` took, and why.
    notices: Vec<String>,
    /// What replaces a GPU that fails; `None` where it was asked for by name.
    #[cfg(feature = "gpu")]
    fall_back: Option<Box<CpuRenderer>>,
    #[cfg(feature = "gpu")]
    ahead: Ahead,
    /// Draws what the GPU does not.
    #[cfg(feature = "gpu")]
    beside: Option<Box<CpuRenderer>>,
}

enum Backend {
    Planes(CpuRenderer),
    Exact(CpuRenderer),
    /// Of a world that comes in tiles.
    Paged(Box<Paged>),
    #[cfg(feature = "gpu")]
    Gpu(Vec<GpuRenderer>),
}

impl Renderer {
    /// Opens a device to draw a world on. [`Renderer::notices`] says which one `Device::Auto` took, and why.
    ///
    /// # Errors
    /// [`Error::Device`] where there is no usable GPU and `Device::Gpu` was asked for, [`Error::Limit`] where the world does
    /// not fit it.
    pub fn new(world: Arc<World>, device: Device) -> Result<Renderer> {
        let mut notices = Vec::new();
        let tell = &mut |what: &str| notices.push(what.to_owned());
        let renderer = Renderer::with_kernel(&world.scene, &world.resident, device, None, tell)?;
        Ok(Renderer { notices, ..renderer })
    }

    /// Draws a world that comes in tiles, of which at most `budget` bytes are kept in memory; in its own colours, or in a tint's.
    ///
    /// # Errors
    /// Those of the coarsest tiles and of the device; [`Error::Limit`] where the budget holds no view.
    pub fn of_tiles(
        source: Arc<dyn TileSource>,
        device: Device,
        budget: u64,
        patience: Patience,
        tint: Option<Tint>,
        tell: &mut dyn FnMut(&str),
    ) -> Result<Renderer> {
        let tables = Pager::new(source, budget, tint)?;
        let paged = Paged::new(tables, patience, tell, |resident, tell| paged::open(resident, device, tell))?;
        Ok(Renderer::of(Backend::Paged(Box::new(paged))))
    }

    /// Without anything that replaces what draws.
    fn of(backend: Backend) -> Renderer {
        Renderer {
            backend,
            notices: Vec::new(),
            #[cfg(feature = "gpu")]
            fall_back: None,
            #[cfg(feature = "gpu")]
            ahead: Ahead::new(),
            #[cfg(feature = "gpu")]
            beside: None,
        }
    }

    /// What was decided without being asked for: which device was taken or given up, and why.
    pub fn notices(&self) -> &[String] {
        &self.notices
    }

    /// The same with a kernel of the device's by name. `tell` hears which device `auto` took, and why.
    pub fn with_kernel(
        scene: &Arc<Scene>,
        resident: &Arc<Resident>,
        device: Device,
        kernel: Option<&str>,
        tell: &mut dyn FnMut(&str),
    ) -> Result<Renderer> {
        let cpu = || {
            let mut cpu = CpuRenderer::new(scene, resident);
            cpu.set_raycast(kernel == Some("raycast"));
            cpu
        };
        let only = |names: &[&str]| match kernel {
            Some(k) if !names.contains(&k) => {
                Err(Error::Argument(format!("kernel {k}: this device has only {}", names.join(", "))))
            }
            _ => Ok(()),
        };
        let backend = match device {
            Device::Exact => {
                only(&["exact"])?;
                Backend::Exact(cpu())
            }
            Device::Cpu => {
                only(&["planes", "raycast"])?;
                Backend::Planes(cpu())
            }
            Device::Auto if kernel == Some("planes") => Backend::Planes(cpu()),
            Device::Auto => match open_gpu(scene, resident, kernel, true) {
                Ok(backend) => backend,
                // A kernel of the GPU's cannot be had elsewhere.
                Err(e) if kernel.is_some() => return Err(e),
                Err(e) => {
                    tell(&format!("drawing on the cpu: {e}"));
                    Backend::Planes(cpu())
                }
            },
            Device::Gpu => open_gpu(scene, resident, kernel, false)?,
            Device::AllGpus => open_gpus(scene, resident, kernel)?,
        };
        #[cfg(feature = "gpu")]
        if let (Backend::Gpu(gpus), Device::Auto | Device::AllGpus) = (&backend, device) {
            let names: Vec<_> = gpus.iter().map(|gpu| gpu.device().0).collect();
            match gpus.len() {
                1 => tell(&format!("drawing on the gpu: {}", names[0])),
                n => tell(&format!("drawing on {n} gpus: {}", names.join(", "))),
            }
        }
        Ok(Renderer {
            #[cfg(feature = "gpu")]
            fall_back: (device == Device::Auto).then(|| Box::new(CpuRenderer::new(scene, resident))),
            ..Renderer::of(backend)
        })
    }

    /// Draws on a GPU that is open already, and goes on with the CPU where it fails, as `auto` does.
    #[cfg(feature = "gpu")]
    pub fn on_gpu(gpu: GpuRenderer) -> Renderer {
        let fall_back = Some(Box::new(gpu.cpu()));
        Renderer { fall_back, ..Renderer::of(Backend::Gpu(vec![gpu])) }
    }

    /// Whether frames' figures say how many columns, runs and spans were visited, and how long each stage took. The CPU has them
    /// in any case: they cost nothing.
    pub fn set_count(&mut self, count: bool) {
        match &mut self.backend {
            Backend::Planes(_) | Backend::Exact(_) => _ = count,
            Backend::Paged(paged) => paged.set_count(count),
            #[cfg(feature = "gpu")]
            Backend::Gpu(gpus) => gpus.iter_mut().for_each(|gpu| {
                gpu.set_count(count);
                gpu.set_stage_times(count);
            }),
        }
    }

    /// How long frames wait for their tiles from now on. A whole world has none to wait for.
    pub fn set_patience(&mut self, patience: Patience) {
        if let Backend::Paged(paged) = &mut self.backend {
            paged.set_patience(patience);
        }
    }

    /// Whether frames have depths; without them the GPU has half as much to read back. The CPU makes them in any case.
    pub fn set_depth(&mut self, depth: bool) {
        match &mut self.backend {
            Backend::Planes(_) | Backend::Exact(_) | Backend::Paged(_) => _ = depth,
            #[cfg(feature = "gpu")]
            Backend::Gpu(gpus) => gpus.iter_mut().for_each(|gpu| gpu.set_depth(depth)),
        }
    }

    /// Gives a frame back that is done with: a later one takes its memory, already touched.
    pub fn reuse(&mut self, frame: Option<Frame>) {
        match &mut self.backend {
            Backend::Planes(cpu) | Backend::Exact(cpu) => cpu.reuse(frame),
            Backend::Paged(paged) => paged.reuse(frame),
            #[cfg(feature = "gpu")]
            Backend::Gpu(gpus) => gpus[self.ahead.front().map_or(0, |sent| sent.gpu)].reuse(frame),
        }
    }

    /// Draws one frame: colour and depth. After `Device::Auto`, a GPU that fails is replaced by the CPU for good, and
    /// [`Renderer::notices`] says why.
    ///
    /// # Errors
    /// [`Error::Argument`] where camera or options cannot be drawn, [`Error::Limit`] where they ask too much of the device,
    /// [`Error::Device`] where that fails.
    pub fn draw(&mut self, camera: &Camera, options: &Options) -> Result<Frame> {
        let mut notices = std::mem::take(&mut self.notices);
        let frame = self.draw_with(camera, options, Outputs::default(), &mut |what| notices.push(what.to_owned()));
        self.notices = notices;
        frame
    }

    /// The same with voxels, if they are asked for. `tell` hears why a GPU is given up.
    pub fn draw_with(
        &mut self,
        camera: &Camera,
        options: &Options,
        outputs: Outputs,
        tell: &mut dyn FnMut(&str),
    ) -> Result<Frame> {
        self.draw_first(std::slice::from_ref(camera), options, outputs, tell)
    }

    /// Draws the first of some frames. The GPU goes on to those that follow meanwhile: the next call should ask for them.
    pub fn draw_first(
        &mut self,
        cameras: &[Camera],
        options: &Options,
        outputs: Outputs,
        tell: &mut dyn FnMut(&str),
    ) -> Result<Frame> {
        let camera = &cameras[0];
        match &mut self.backend {
            Backend::Planes(cpu) => cpu.render(camera, options, outputs),
            Backend::Exact(cpu) => cpu.exact(camera, options, outputs),
            Backend::Paged(paged) => paged.draw(camera, &cameras[1..], options, outputs, tell),
            #[cfg(feature = "gpu")]
            Backend::Gpu(gpus) if options.projection == Projection::Cube => {
                // One after the other into the device, each as soon as there is room.
                crate::cpu::renderer::check(camera, options)?;
                let options = Options { projection: Projection::Perspective, ..*options };
                let faces = face_cameras(camera);
                let faces = (0..6).map(|i| draw_ahead(&mut gpus[..1], &mut self.ahead, &faces[i..], &options, outputs));
                Ok(join_faces(camera, faces.collect::<Result<_>>()?))
            }
            #[cfg(feature = "gpu")]
            Backend::Gpu(gpus) if !gpu_draws(options) => {
                let cpu = self.beside.get_or_insert_with(|| {
                    tell(&format!(
                        "drawing {} on the cpu: the gpu draws perspective and cube",
                        options.projection.name()
                    ));
                    Box::new(gpus[0].cpu())
                });
                cpu.render(camera, options, outputs)
            }
            #[cfg(feature = "gpu")]
            Backend::Gpu(gpus) => match draw_ahead(gpus, &mut self.ahead, cameras, options, outputs) {
                Err(e @ (Error::Device(_) | Error::Limit(_))) => {
                    let Some(cpu) = self.fall_back.take() else { return Err(e) };
                    tell(&format!("going on with the cpu: {e}"));
                    self.backend = Backend::Planes(*cpu);
                    self.draw_with(camera, options, outputs, tell)
                }
                frame => frame,
            },
        }
    }

    /// Draws pictures of any sizes, one a camera, and gives them in that order. On the GPU they are sent together, on the CPU
    /// each thread draws one whole: for many small pictures that takes much less than one after the other.
    ///
    /// # Errors
    /// Those of [`Renderer::draw`], of the first picture that has one.
    pub fn draw_many(&mut self, cameras: &[Camera], options: &Options) -> Result<Vec<Frame>> {
        let frames = std::sync::Mutex::new((0..cameras.len()).map(|_| None).collect::<Vec<Option<Frame>>>());
        self.draw_each(cameras, options, Outputs::default(), &|i, frame| {
            frames.lock().expect("no holder panics")[i] = Some(frame);
            Ok(None)
        })?;
        let frames = frames.into_inner().expect("no holder panics");
        Ok(frames.into_iter().map(|frame| frame.expect("all were drawn")).collect())
    }

    /// As [`Renderer::draw_many`], handing each picture on when it is done, in any order and from several threads at once;
    /// `done` may give the frame back, whose memory another takes. Its first error ends the work.
    pub fn draw_each(
        &mut self,
        cameras: &[Camera],
        options: &Options,
        outputs: Outputs,
        done: &(dyn Fn(usize, Frame) -> Result<Option<Frame>> + Sync),
    ) -> Result<()> {
        match &mut self.backend {
            Backend::Planes(cpu) => cpu.each(cameras, false, options, outputs, done),
            Backend::Exact(cpu) => cpu.each(cameras, true, options, outputs, done),
            #[cfg(feature = "gpu")]
            Backend::Gpu(gpus) if gpu_draws(options) => gpus[0].each(cameras, options, outputs, done),
            _ => {
                for (i, camera) in cameras.iter().enumerate() {
                    let frame = self.draw_with(camera, options, outputs, &mut |_| ())?;
                    _ = done(i, frame)?;
                }
                Ok(())
            }
        }
    }

    /// The GPU's adapter and driver, where it draws.
    pub fn adapter(&self) -> Option<String> {
        #[cfg(feature = "gpu")]
        if let Backend::Gpu(gpus) = &self.backend {
            let (name, driver) = gpus[0].device();
            return Some(format!("{name} ({driver})"));
        }
        None
    }

    /// Names of the GPU's kernels, the usual one first.
    pub fn gpu_kernels() -> Vec<&'static str> {
        #[cfg(feature = "gpu")]
        {
            let usual = GpuOptions::default().kernel;
            let others = Kernel::ALL.into_iter().filter(|k| *k != usual);
            [usual].into_iter().chain(others).map(Kernel::name).collect()
        }
        #[cfg(not(feature = "gpu"))]
        Vec::new()
    }

    /// The name of what draws, for records.
    pub fn name(&self) -> &'static str {
        match &self.backend {
            Backend::Planes(_) => "cpu",
            Backend::Exact(_) => "exact",
            Backend::Paged(paged) => paged.name(),
            #[cfg(feature = "gpu")]
            Backend::Gpu(_) => "gpu",
        }
    }
}

/// Whether the GPU's own kernels draw it.
#[cfg(feature = "gpu")]
fn gpu_draws(options: &Options) -> bool {
    options.projection == Projection::Perspective
}

/// Frames on their way, in the order in which they were submitted.
#[cfg(feature = "gpu")]
type Ahead = VecDeque<Sent>;

#[cfg(feature = "gpu")]
struct Sent {
    job: (Camera, Options, Outputs),
    /// Which of the GPUs draws it.
    gpu: usize,
}

#[cfg(feature = "gpu")]
fn draw_ahead(
    gpus: &mut [GpuRenderer],
    ahead: &mut Ahead,
    cameras: &[Camera],
    options: &Options,
    outputs: Outputs,
) -> Result<Frame> {
    let job = |camera: &Camera| (*camera, *options, outputs);
    if ahead.len() > cameras.len() || ahead.iter().zip(cameras).any(|(sent, camera)| sent.job != job(camera)) {
        // Nobody asks for these any more.
        gpus.iter_mut().for_each(|gpu| while gpu.collect().is_some() {});
        ahead.clear();
    }
    // In turn: so frames come back in order, whichever GPU is faster.
    for camera in &cameras[ahead.len()..] {
        let gpu = ahead.back().map_or(0, |sent| (sent.gpu + 1) % gpus.len());
        if gpus[gpu].is_full() {
            break;
        }
        match gpus[gpu].submit(camera, options, outputs) {
            Ok(()) => ahead.push_back(Sent { job: job(camera), gpu }),
            Err(e) if ahead.is_empty() => return Err(e),
            // It will be asked for once more when its turn comes.
            Err(_) => break,
        }
    }
    // Those that the GPU which gives a frame now draws next.
    let next: Vec<Camera> = cameras[ahead.len()..].iter().step_by(gpus.len()).take(4).copied().collect();
    let first = ahead.pop_front().expect("the first frame was submitted");
    gpus[first.gpu].collect_and_prepare(&next, options).expect("the first frame was submitted")
}

/// The GPU; with `real_only`, none that a processor plays.
#[cfg(feature = "gpu")]
fn open_gpu(scene: &Arc<Scene>, resident: &Arc<Resident>, kernel: Option<&str>, real_only: bool) -> Result<Backend> {
    let kernel = kernel.map_or(Ok(GpuOptions::default().kernel), str::parse::<Kernel>)?;
    let gpu = GpuRenderer::new(scene, resident, GpuOptions { kernel, ..GpuOptions::default() })?;
    if real_only && gpu.is_software() {
        return Err(Error::Device(format!("the only adapter is software ({})", gpu.device().0)));
    }
    Ok(Backend::Gpu(vec![gpu]))
}

/// Every GPU, of those that a processor plays only where there is no other.
#[cfg(feature = "gpu")]
fn open_gpus(scene: &Arc<Scene>, resident: &Arc<Resident>, kernel: Option<&str>) -> Result<Backend> {
    let kernel = kernel.map_or(Ok(GpuOptions::default().kernel), str::parse::<Kernel>)?;
    Ok(Backend::Gpu(GpuRenderer::on_all(scene, resident, GpuOptions { kernel, ..GpuOptions::default() })?))
}

#[cfg(not(feature = "gpu"))]
fn open_gpus(scene: &Arc<Scene>, resident: &Arc<Resident>, kernel: Option<&str>) -> Result<Backend> {
    open_gpu(scene, resident, kernel, false)
}

#[cfg(not(feature = "gpu"))]
fn open_gpu(_: &Arc<Scene>, _: &Arc<Resident>, _: Option<&str>, _: bool) -> Result<Backend> {
    Err(Error::Device("this planecast was built without the feature gpu; use --device cpu".into()))
}
