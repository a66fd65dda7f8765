//! Which device draws: the GPU, the CPU, or the exact reference.

use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::frame::Frame;
#[cfg(feature = "gpu")]
use crate::gpu::{GpuOptions, GpuRenderer, Kernel};
use crate::options::Options;
use crate::renderer::{CpuRenderer, Outputs};
use crate::resident::Resident;
use planecast_encoder::Scene;
#[cfg(feature = "gpu")]
use std::collections::VecDeque;

/// What was asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Device {
    /// The GPU where a real one is usable, else the CPU.
    Auto,
    Gpu,
    Cpu,
    /// One f64 ray a pixel at level 0, on the CPU.
    Exact,
}

/// Draws frames of one scene on the device that was chosen.
pub struct Renderer<'a> {
    backend: Backend<'a>,
    /// What replaces a GPU that fails; `None` where it was asked for by name.
    #[cfg(feature = "gpu")]
    fall_back: Option<(&'a Scene, &'a Resident)>,
    #[cfg(feature = "gpu")]
    ahead: Ahead,
}

enum Backend<'a> {
    Planes(CpuRenderer<'a>),
    Exact(CpuRenderer<'a>),
    #[cfg(feature = "gpu")]
    Gpu(Box<GpuRenderer<'a>>),
}

impl<'a> Renderer<'a> {
    /// Opens a device. `tell` hears which one `auto` took, and why.
    pub fn new(
        scene: &'a Scene,
        resident: &'a Resident,
        device: Device,
        kernel: Option<&str>,
        tell: &mut dyn FnMut(&str),
    ) -> Result<Renderer<'a>> {
        let cpu = || CpuRenderer::new(scene, resident);
        let only = |name: &str| match kernel {
            Some(k) if k != name => Err(Error::Argument(format!("kernel {k}: this device has only {name}"))),
            _ => Ok(()),
        };
        let backend = match device {
            Device::Exact => {
                only("exact")?;
                Backend::Exact(cpu())
            }
            Device::Cpu => {
                only("planes")?;
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
        };
        #[cfg(feature = "gpu")]
        if let (Backend::Gpu(gpu), Device::Auto) = (&backend, device) {
            tell(&format!("drawing on the gpu: {}", gpu.device().0));
        }
        Ok(Renderer {
            backend,
            #[cfg(feature = "gpu")]
            fall_back: (device == Device::Auto).then_some((scene, resident)),
            #[cfg(feature = "gpu")]
            ahead: Ahead::new(),
        })
    }

    /// Draws on a GPU that is open already, and goes on with the CPU where it fails, as `auto` does.
    #[cfg(feature = "gpu")]
    pub fn on_gpu(gpu: GpuRenderer<'a>) -> Renderer<'a> {
        let fall_back = Some(gpu.draws());
        Renderer { backend: Backend::Gpu(Box::new(gpu)), fall_back, ahead: Ahead::new() }
    }

    /// Whether frames' figures say how many columns, runs and spans were visited. The CPU counts in any case: it costs nothing.
    pub fn set_count(&mut self, count: bool) {
        match &mut self.backend {
            Backend::Planes(_) | Backend::Exact(_) => _ = count,
            #[cfg(feature = "gpu")]
            Backend::Gpu(gpu) => gpu.set_count(count),
        }
    }

    /// Draws one frame. After `auto`, a GPU that fails is replaced by the CPU for good, and `tell` hears why.
    pub fn draw(
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
        #[cfg(not(feature = "gpu"))]
        let _ = tell;
        match &mut self.backend {
            Backend::Planes(cpu) => cpu.render(camera, options, outputs),
            Backend::Exact(cpu) => cpu.exact(camera, options, outputs),
            #[cfg(feature = "gpu")]
            Backend::Gpu(gpu) => match draw_ahead(gpu, &mut self.ahead, cameras, options, outputs) {
                Err(e @ (Error::Device(_) | Error::Limit(_))) => {
                    let Some((scene, resident)) = self.fall_back else { return Err(e) };
                    tell(&format!("going on with the cpu: {e}"));
                    self.backend = Backend::Planes(CpuRenderer::new(scene, resident));
                    self.draw(camera, options, outputs, tell)
                }
                frame => frame,
            },
        }
    }

    /// The GPU's adapter and driver, where it draws.
    pub fn adapter(&self) -> Option<String> {
        #[cfg(feature = "gpu")]
        if let Backend::Gpu(gpu) = &self.backend {
            let (name, driver) = gpu.device();
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
            #[cfg(feature = "gpu")]
            Backend::Gpu(_) => "gpu",
        }
    }
}

/// Frames on their way, in the order in which they were submitted.
#[cfg(feature = "gpu")]
type Ahead = VecDeque<(Camera, Options, Outputs)>;

#[cfg(feature = "gpu")]
fn draw_ahead(
    gpu: &mut GpuRenderer<'_>,
    ahead: &mut Ahead,
    cameras: &[Camera],
    options: &Options,
    outputs: Outputs,
) -> Result<Frame> {
    let job = |camera: &Camera| (*camera, *options, outputs);
    if ahead.len() > cameras.len() || ahead.iter().zip(cameras).any(|(sent, camera)| *sent != job(camera)) {
        // Nobody asks for these any more.
        while gpu.collect().is_some() {}
        ahead.clear();
    }
    for camera in &cameras[ahead.len()..] {
        if gpu.is_full() {
            break;
        }
        match gpu.submit(camera, options, outputs) {
            Ok(()) => ahead.push_back(job(camera)),
            Err(e) if ahead.is_empty() => return Err(e),
            // It will be asked for once more when its turn comes.
            Err(_) => break,
        }
    }
    ahead.pop_front();
    gpu.collect().expect("the first frame was submitted")
}

/// The GPU; with `real_only`, none that a processor plays.
#[cfg(feature = "gpu")]
fn open_gpu<'a>(
    scene: &'a Scene,
    resident: &'a Resident,
    kernel: Option<&str>,
    real_only: bool,
) -> Result<Backend<'a>> {
    let kernel = kernel.map_or(Ok(GpuOptions::default().kernel), str::parse::<Kernel>)?;
    let gpu = GpuRenderer::new(scene, resident, GpuOptions { kernel, ..GpuOptions::default() })?;
    if real_only && gpu.is_software() {
        return Err(Error::Device(format!("the only adapter is software ({})", gpu.device().0)));
    }
    Ok(Backend::Gpu(Box::new(gpu)))
}

#[cfg(not(feature = "gpu"))]
fn open_gpu<'a>(_: &'a Scene, _: &'a Resident, _: Option<&str>, _: bool) -> Result<Backend<'a>> {
    Err(Error::Device("this planecast was built without the feature gpu; use --device cpu".into()))
}
