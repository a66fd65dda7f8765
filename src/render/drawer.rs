//! Whatever draws a scene into a window or a page.

use std::sync::Arc;

use crate::cpu::renderer::{CpuRenderer, Outputs};
use crate::frame::camera::Camera;
use crate::frame::options::Options;
use crate::frame::picture::{Frame, Stats};
use crate::gpu::present::{ByteOrder, Device, Shaded};
use crate::world::World;
use crate::{Error, GpuOptions, GpuRenderer, Kernel, Result};

enum Painter {
    Gpu(Box<GpuRenderer>),
    Cpu(CpuRenderer),
    Exact(CpuRenderer),
}

/// What shall draw.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Draws {
    Gpu(Kernel),
    Cpu,
    /// One f64 ray a pixel, on the CPU.
    Exact,
}

impl Draws {
    /// Flags of `render` that choose the same.
    pub fn flags(self) -> String {
        match self {
            Draws::Gpu(kernel) => format!("--device gpu --kernel {}", kernel.name()),
            Draws::Cpu => "--device cpu".into(),
            Draws::Exact => "--device exact".into(),
        }
    }

    /// Options without what the GPU cannot do, where that draws: switches stay where they are when it changes.
    pub fn options(self, options: &Options) -> Options {
        match self {
            Draws::Gpu(_) => Options { f64_traversal: false, ..*options },
            Draws::Cpu | Draws::Exact => *options,
        }
    }
}

/// A scene and what draws it.
pub struct Drawer {
    world: Arc<World>,
    painter: Painter,
    draws: Draws,
}

/// A frame as it was drawn.
pub enum Drawn {
    /// The picture is on the device: [`Drawer::with_picture`].
    OnDevice,
    /// The picture is here.
    Here(Box<Frame>),
}

impl Drawer {
    /// `device`: where the GPU shall draw.
    pub fn new(world: Arc<World>, draws: Draws, device: Option<&Device>) -> Result<Drawer> {
        let cpu = || CpuRenderer::new(&world.scene, &world.resident);
        let painter = match (draws, device) {
            (Draws::Cpu, _) => Painter::Cpu(cpu()),
            (Draws::Exact, _) => Painter::Exact(cpu()),
            (Draws::Gpu(_), None) => return Err(Error::Device("no usable GPU adapter; try --device cpu".into())),
            (Draws::Gpu(kernel), Some(device)) => {
                let options = GpuOptions { kernel, ..GpuOptions::default() };
                Painter::Gpu(Box::new(GpuRenderer::on_device(&world.scene, &world.resident, options, device)?))
            }
        };
        Ok(Drawer { world, painter, draws })
    }

    pub fn draws(&self) -> Draws {
        self.draws
    }

    pub fn world(&self) -> &Arc<World> {
        &self.world
    }

    /// Takes another kernel of the GPU's from the next frame on.
    pub fn set_kernel(&mut self, kernel: Kernel) {
        if let Painter::Gpu(gpu) = &mut self.painter {
            gpu.set_kernel(kernel, None);
            self.draws = Draws::Gpu(kernel);
        }
    }

    /// Draws one frame, where it is to be shown.
    pub fn draw(&mut self, camera: &Camera, options: &Options) -> Result<Drawn> {
        let options = &self.draws.options(options);
        Ok(match &mut self.painter {
            Painter::Gpu(gpu) => {
                gpu.draw(camera, options)?;
                Drawn::OnDevice
            }
            Painter::Cpu(cpu) => {
                // While the eye rests, turning looks up what planes have shown.
                cpu.keep_sphere(true);
                Drawn::Here(Box::new(cpu.render(camera, options, Outputs::default())?))
            }
            Painter::Exact(cpu) => Drawn::Here(Box::new(cpu.exact(camera, options, Outputs::default())?)),
        })
    }

    /// Draws one frame as `render` would, and brings it here; with voxels if they are asked for.
    pub fn render(&mut self, camera: &Camera, options: &Options, outputs: Outputs) -> Result<Frame> {
        let options = &self.draws.options(options);
        match &mut self.painter {
            Painter::Gpu(gpu) => gpu.render(camera, options, outputs),
            Painter::Cpu(cpu) => {
                // A picture that is kept is drawn as `render` draws it.
                cpu.keep_sphere(false);
                cpu.render(camera, options, outputs)
            }
            Painter::Exact(cpu) => cpu.exact(camera, options, outputs),
        }
    }

    /// How the pixels lie in their bytes that [`Drawer::draw`] leaves on the device.
    pub fn set_order(&mut self, order: ByteOrder) {
        if let Painter::Gpu(gpu) = &mut self.painter {
            gpu.set_order(order);
        }
    }

    /// The picture that [`Drawer::draw`] left on the device.
    pub fn with_picture<T>(&self, look: impl FnOnce(Shaded<'_>) -> T) -> Option<T> {
        match &self.painter {
            Painter::Gpu(gpu) => gpu.picture().map(look),
            _ => None,
        }
    }

    /// Frames on the device that are not done, as far as they are waited for.
    pub fn waiting(&self) -> usize {
        match &self.painter {
            Painter::Gpu(gpu) => gpu.waiting(),
            _ => 0,
        }
    }

    /// What the latest frame on the device cost of which that is known by now; an error where the device has failed.
    pub fn figures(&mut self) -> Result<Option<Stats>> {
        match &mut self.painter {
            Painter::Gpu(gpu) => gpu.figures(),
            _ => Ok(None),
        }
    }
}
