//! Whatever draws a scene into a window or a page.

use std::sync::Arc;

use crate::cpu::renderer::{CpuRenderer, Outputs};
use crate::frame::camera::Camera;
use crate::frame::options::Options;
use crate::frame::picture::{Frame, Stats};
use crate::gpu::present::{ByteOrder, Device, Shaded};
use crate::render::paged::{Paged, Painter as PagedPainter};
use crate::world::World;
use crate::world::fetch::Orders;
use crate::world::pager::{Pager, Patience};
use crate::world::parcel::Parcels;
use crate::world::probe::Probe;
#[cfg(not(target_arch = "wasm32"))]
use crate::world::residency::{ResidencyOptions, Tiles};
use crate::world::tables::Resident;
use crate::{Error, GpuOptions, GpuRenderer, Kernel, Result};

enum Painter {
    Gpu(Box<GpuRenderer>),
    Cpu(CpuRenderer),
    Exact(CpuRenderer),
    Tiles(Box<Paged>),
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

/// What draws a world.
pub struct Drawer {
    painter: Painter,
    draws: Draws,
    /// What is to be said of it.
    notices: Vec<String>,
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
    pub fn new(world: &World, draws: Draws, device: Option<&Device>) -> Result<Drawer> {
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
        Ok(Drawer { painter, draws, notices: Vec::new() })
    }

    /// For a world that comes in tiles.
    ///
    /// # Errors
    /// Those of the coarsest tiles and of the device; [`Error::Argument`] where rays shall draw, which need the whole world.
    #[cfg(not(target_arch = "wasm32"))]
    pub fn of_tiles(
        tiles: &Tiles,
        residency: &ResidencyOptions,
        draws: Draws,
        device: Option<&Device>,
    ) -> Result<Drawer> {
        let budget = residency.budget(matches!(draws, Draws::Gpu(_)));
        let tables = Pager::new(Arc::clone(&tiles.source), budget, tiles.tint.clone())?;
        Drawer::of_tables(tables, residency.patience, draws, device)
    }

    /// For a world whose tiles others bring, as they are ordered; at most `budget` bytes of them are kept. Frames wait for none.
    ///
    /// # Errors
    /// As [`Drawer::of_tiles`].
    pub fn of_parcels(
        parcels: Arc<Parcels>,
        budget: u64,
        draws: Draws,
        device: Option<&Device>,
    ) -> Result<(Drawer, Orders)> {
        let (tables, orders) = Pager::of_parcels(parcels, budget)?;
        Ok((Drawer::of_tables(tables, Patience::Deadline(0.0), draws, device)?, orders))
    }

    fn of_tables(
        tables: (Pager, Resident),
        patience: Patience,
        draws: Draws,
        device: Option<&Device>,
    ) -> Result<Drawer> {
        let kernel = match draws {
            Draws::Cpu => None,
            Draws::Gpu(kernel) if kernel == Kernel::default() => Some(kernel),
            Draws::Exact | Draws::Gpu(_) => {
                let what = "rays need the whole world in memory, and this one comes in tiles: planes draw it";
                return Err(Error::Argument(what.into()));
            }
        };
        let mut notices = Vec::new();
        let open = |resident: &Arc<_>, _: &mut dyn FnMut(&str)| match (kernel, device) {
            (None, _) => Ok(PagedPainter::Cpu(Box::new(CpuRenderer::of_tables(Arc::clone(resident))))),
            (Some(_), None) => Err(Error::Device("no usable GPU adapter; try --device cpu".into())),
            (Some(kernel), Some(device)) => {
                let options = GpuOptions { kernel, ..GpuOptions::default() };
                Ok(PagedPainter::Gpu(Box::new(GpuRenderer::of_tables_on(resident, options, device)?)))
            }
        };
        let paged = Paged::new(tables, patience, &mut |what| notices.push(what.to_owned()), open)?;
        Ok(Drawer { painter: Painter::Tiles(Box::new(paged)), draws, notices })
    }

    pub fn draws(&self) -> Draws {
        self.draws
    }

    /// What is to be said since this was asked last: what is left out, which tiles cannot be had.
    pub fn take_notices(&mut self) -> Vec<String> {
        std::mem::take(&mut self.notices)
    }

    /// Looks into the tiles that are there, of a world that comes in tiles.
    pub fn probe(&self) -> Option<Probe<'_>> {
        match &self.painter {
            Painter::Tiles(paged) => Some(paged.probe()),
            _ => None,
        }
    }

    /// The GPU that draws.
    fn gpu(&self) -> Option<&GpuRenderer> {
        match &self.painter {
            Painter::Gpu(gpu) => Some(gpu),
            Painter::Tiles(paged) => paged.gpu(),
            Painter::Cpu(_) | Painter::Exact(_) => None,
        }
    }

    fn gpu_mut(&mut self) -> Option<&mut GpuRenderer> {
        match &mut self.painter {
            Painter::Gpu(gpu) => Some(gpu),
            Painter::Tiles(paged) => paged.gpu_mut(),
            Painter::Cpu(_) | Painter::Exact(_) => None,
        }
    }

    /// Takes another kernel of the GPU's from the next frame on.
    pub fn set_kernel(&mut self, kernel: Kernel) {
        if let Painter::Gpu(gpu) = &mut self.painter {
            gpu.set_kernel(kernel, None);
            self.draws = Draws::Gpu(kernel);
        }
    }

    /// Draws one frame, where it is to be shown. `soon` is where the camera will be soon, as far as that can be told: tiles are
    /// asked for ahead.
    pub fn draw(&mut self, camera: &Camera, soon: Option<&Camera>, options: &Options) -> Result<Drawn> {
        let options = &self.draws.options(options);
        let _ = soon;
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
            Painter::Tiles(paged) => {
                let frame = paged.show(camera, soon, options, &mut |what| self.notices.push(what.to_owned()))?;
                frame.map_or(Drawn::OnDevice, |frame| Drawn::Here(Box::new(frame)))
            }
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
            Painter::Tiles(paged) => {
                // A picture that is kept owes nothing.
                let patience = paged.set_patience(Patience::Wait);
                let frame = paged.draw(camera, &[], options, outputs, &mut |what| self.notices.push(what.to_owned()));
                paged.set_patience(patience);
                frame
            }
        }
    }

    /// How the pixels lie in their bytes that [`Drawer::draw`] leaves on the device.
    pub fn set_order(&mut self, order: ByteOrder) {
        if let Some(gpu) = self.gpu_mut() {
            gpu.set_order(order);
        }
    }

    /// The picture that [`Drawer::draw`] left on the device.
    pub fn with_picture<T>(&self, look: impl FnOnce(Shaded<'_>) -> T) -> Option<T> {
        self.gpu()?.picture().map(look)
    }

    /// Frames on the device that are not done, as far as they are waited for.
    pub fn waiting(&self) -> usize {
        self.gpu().map_or(0, GpuRenderer::waiting)
    }

    /// What the latest frame on the device cost of which that is known by now; an error where the device has failed.
    pub fn figures(&mut self) -> Result<Option<Stats>> {
        match &mut self.painter {
            Painter::Gpu(gpu) => gpu.figures(),
            Painter::Tiles(paged) => paged.figures(),
            Painter::Cpu(_) | Painter::Exact(_) => Ok(None),
        }
    }
}
