//! Draws a world whose tiles come as they are wanted.

use std::collections::HashSet;
use std::sync::Arc;

use planecast_encoder::format::TILE;
use planecast_encoder::{TileKey, TileSource};

use crate::cpu::renderer::{CpuRenderer, Outputs, check};
use crate::frame::camera::Camera;
use crate::frame::options::{Normals, Options};
use crate::frame::picture::{Frame, PagingStats};
use crate::frame::plane_setup::plane_setup;
use crate::frame::projection::{Projection, face_cameras, join_faces};
#[cfg(feature = "gpu")]
use crate::gpu::{GpuOptions, GpuRenderer};
use crate::render::device::Device;
use crate::world::pager::{Change, Pager, Paging, Patience};
use crate::world::tables::Resident;
use crate::world::tint::Tint;
use crate::{Error, Result};

/// By how much a view that the budget does not hold is drawn coarser at a time.
const COARSER: f64 = 1.25;

/// A view with `--lod off` that the budget does not hold begins here.
const FINEST: f64 = 0.25;

/// What draws from the tables.
enum Painter {
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

    /// Draws, after what has changed in the tables was brought to where it is drawn; and how many bytes that was.
    fn draw(
        &mut self,
        changes: &[Change],
        camera: &Camera,
        options: &Options,
        outputs: Outputs,
    ) -> Result<(Frame, u64)> {
        // The CPU draws from the tables themselves.
        #[cfg(not(feature = "gpu"))]
        let _ = changes;
        match self {
            Painter::Cpu(cpu) => Ok((cpu.render(camera, options, outputs)?, 0)),
            #[cfg(feature = "gpu")]
            Painter::Gpu(gpu) => {
                let uploaded = gpu.bring(changes)?;
                Ok((gpu.render(camera, options, outputs)?, uploaded))
            }
        }
    }
}

/// A pager, and what draws from its tables.
pub(super) struct Paged {
    pager: Pager,
    painter: Painter,
    patience: Patience,
    /// How much coarser than asked for the latest frame was.
    coarser: f64,
    /// Whether pixels are counted by tile.
    count: bool,
    said_left_out: bool,
}

/// The device that draws, as `Device` has it.
fn open(resident: &Arc<Resident>, device: Device, tell: &mut dyn FnMut(&str)) -> Result<Painter> {
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

impl Paged {
    pub fn new(
        source: Arc<dyn TileSource>,
        device: Device,
        budget: u64,
        patience: Patience,
        tint: Option<Tint>,
        tell: &mut dyn FnMut(&str),
    ) -> Result<Paged> {
        if source.has_matter() {
            tell("translucent matter is left out: it needs the whole world, and this one comes in tiles");
        }
        let (pager, resident) = Pager::new(source, budget, tint)?;
        let resident = Arc::new(resident);
        let painter = open(&resident, device, tell)?;
        drop(resident);
        Ok(Paged { pager, painter, patience, coarser: 1.0, count: false, said_left_out: false })
    }

    pub fn set_count(&mut self, count: bool) {
        self.count = count;
        #[cfg(feature = "gpu")]
        if let Painter::Gpu(gpu) = &mut self.painter {
            gpu.set_count(count);
            gpu.set_stage_times(count);
        }
    }

    /// The name of what draws, for records.
    pub fn name(&self) -> &'static str {
        match self.painter {
            Painter::Cpu(_) => "cpu",
            #[cfg(feature = "gpu")]
            Painter::Gpu(_) => "gpu",
        }
    }

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
        let (options, paging) = self.bring(camera, &options)?;
        self.pager.take_notices().iter().for_each(|what| tell(what));
        let voxel = outputs.voxel || self.count || paging.missing > 0;
        let changes = self.pager.take_changes();
        let (mut frame, bytes_uploaded) = self.painter.draw(&changes, camera, &options, Outputs { voxel })?;
        frame.stats.paging = PagingStats {
            tiles_wanted: paging.wanted,
            tiles_missing: paging.missing,
            tiles_arrived: paging.arrived,
            tiles_evicted: paging.evicted,
            bytes_read: paging.bytes_read,
            bytes_resident: paging.bytes_resident,
            bytes_uploaded,
            unpack_ms: paging.unpack_ms,
            upload_ms: paging.install_ms,
            lod: options.lod.unwrap_or(0.0),
            ..PagingStats::default()
        };
        if voxel {
            self.count_shown(&mut frame);
        }
        if !outputs.voxel {
            frame.voxel.clear();
        }
        if let (Some(next), Patience::Deadline(_)) = (next.last(), self.patience) {
            let resident = self.painter.tables();
            let setup = plane_setup(resident, next, &options);
            self.pager.prefetch(resident, &setup);
        }
        Ok(frame)
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

    /// Brings the tiles of a frame, and says how fine it can be drawn.
    fn bring(&mut self, camera: &Camera, options: &Options) -> Result<(Options, Paging)> {
        let patience = self.patience;
        // Back to what was asked for bit by bit, so that no two frames differ much.
        self.coarser = (self.coarser / COARSER.sqrt()).max(1.0);
        loop {
            let lod = match (options.lod, self.coarser > 1.0) {
                (lod, false) => lod,
                (lod, true) => Some(lod.unwrap_or(FINEST) * self.coarser),
            };
            let drawn = Options { lod, ..*options };
            let resident = self.painter.tables_mut();
            let setup = plane_setup(resident, camera, &drawn);
            if let Some(paging) = self.pager.update(resident, &setup, patience)? {
                return Ok((drawn, paging));
            }
            self.coarser *= COARSER;
            if self.coarser > 1e6 {
                return Err(Error::Limit(format!(
                    "{}: the memory allowed does not hold the tiles of one view, however coarse",
                    self.pager.source().name()
                )));
            }
        }
    }

    /// Counts the tiles that pixels show, and what they are short of.
    fn count_shown(&mut self, frame: &mut Frame) {
        let mut used = HashSet::new();
        let mut last = (None, 0);
        let mut debt = 0;
        let resident = self.painter.tables();
        for &[x, _, z, level] in frame.voxel.iter().filter(|voxel| voxel[3] >= 0) {
            let [x, z] = [x, z].map(|v| (v as u32 >> level) / TILE);
            let key = TileKey { level: level as u32, x, z };
            if last.0 != Some(key) {
                used.insert(key);
                last = (Some(key), self.pager.missing(resident, key).unwrap_or(0));
            }
            debt += u64::from(last.1);
        }
        frame.stats.paging.debt = debt;
        frame.stats.paging.tiles_used = used.len() as u32;
    }
}
