//! Error against run time: every way to draw, compared with the truth and timed, on one scene and machine.
//!
//! ```text
//! scene ─► poses × configurations ─► errors, times ─► journal ─► rows ─► CSV, JSON, plots, page
//!          (`poses`)  (`sweep`)       (`metrics`)  (`run`)        (`present`)
//! ```

pub mod journal;
pub mod metrics;
pub mod poses;
pub mod present;
pub mod run;
pub mod sweep;

use crate::cpu::renderer;
use crate::error::{Error, Result};
use crate::film::path::Path;
use crate::frame::options::Options;
use crate::measure::machine::Machine;
use crate::render::device::{Device, Renderer};
use journal::Journal;
use planecast_encoder::inspect::info;
use planecast_encoder::source::ReadOptions;
use planecast_encoder::{Error as FileError, MipRule};
use run::{Draw, Drawer, Plan, Row, World};
use std::path::Path as FilePath;

/// What a report is to be made of.
#[derive(Clone, Copy, Debug)]
pub struct Job<'j> {
    /// Where it goes.
    pub folder: &'j FilePath,
    /// Fewer configurations, poses and pixels.
    pub quick: bool,
    /// Poses along a path in place of the standing ones.
    pub path: Option<&'j Path>,
    pub size: Option<[u32; 2]>,
    pub rounds: Option<u32>,
    /// Degrees.
    pub fov: f64,
    pub device: Device,
    /// View distance, repetition and fog of all configurations.
    pub base: Options,
    /// Choose the least error within so many milliseconds a frame.
    pub budget_ms: Option<f64>,
    /// Choose the fastest with at most this mean FLIP against one exact ray a pixel.
    pub max_error: Option<f64>,
}

/// Poses taken along a path.
const PATH_POSES: [usize; 2] = [9, 4];

/// Makes a report of a scene file, or of an input read so, or goes on with one. Returns what was chosen, if a choice was asked for. `tell` hears of
/// the progress.
pub fn report(
    scene: &FilePath,
    read: &ReadOptions,
    job: &Job<'_>,
    tell: &mut dyn FnMut(&str),
) -> Result<Option<String>> {
    check_folder(job.folder)?;
    let file = planecast_encoder::cli::open(scene, read, false)?.file;
    let content = info::info(&file)?.content_hash;
    let world = World::new(file.read_scene()?);
    drop(file);
    let (gpu, kernels) = gpu(&world, job.device, tell)?;
    let dims = world.scene.dims();
    let (size, rounds) = if job.quick { ([320, 240], 3) } else { ([640, 480], 5) };
    let (size, rounds) = (job.size.unwrap_or(size), job.rounds.unwrap_or(rounds));
    let poses = match job.path {
        Some(path) => poses::along(path, PATH_POSES[usize::from(job.quick)]),
        None => poses::standing(&world.scene, job.fov, size[1], job.quick),
    };
    let configs = sweep::configs(dims[0].max(dims[2]), &job.base, &kernels, job.quick);
    for pose in &poses {
        let largest = pose.pose.camera(size.map(|n| n.saturating_mul(run::SUPERSAMPLING)));
        renderer::check(&largest, &job.base)?;
    }
    let other = match world.scene.mip_rule {
        MipRule::Any => MipRule::Majority,
        MipRule::Majority => MipRule::Any,
    };
    let other = World::with_rule(&world.scene, other)?;
    let machine = Machine::new(gpu);
    let identity = format!("{content} {} {} {} {:?}", machine.program, machine.cpu, machine.threads, machine.gpu);
    let plan = Plan { configs: &configs, poses: &poses, size, rounds, identity };

    std::fs::create_dir_all(job.folder).map_err(|e| FileError::io(job.folder, "make", e))?;
    let mut journal = Journal::open(job.folder)?;
    let mut draw = Drawer::new(&world, &other);
    plan.run(&mut draw, &mut journal, tell)?;
    let rows = plan.rows(&journal)?;
    let choice = choose(&rows, job.budget_ms, job.max_error);
    let name = scene.file_name().unwrap_or_default().to_string_lossy();
    let subject = present::Subject {
        machine: &machine,
        scene: &name,
        content: &content,
        dims,
        choice: choice.as_ref().ok().and_then(|c| c.as_deref()),
    };
    present::write(job.folder, &present::files(&plan, &rows, &subject, &mut draw as &mut dyn Draw)?)?;
    tell(&format!("the report is {}", job.folder.join("report.html").display()));
    choice
}

/// A report goes into a new or an empty folder, or into one of an earlier report.
fn check_folder(folder: &FilePath) -> Result<()> {
    if folder.join(journal::NAME).is_file() {
        return Ok(());
    }
    match std::fs::read_dir(folder).map(Iterator::count) {
        Ok(1..) => {
            let what = "is a folder with other files and no report's; name a new folder";
            Err(FileError::format(folder, what).into())
        }
        Ok(0) => Ok(()),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(()),
        Err(e) if e.kind() == std::io::ErrorKind::NotADirectory => {
            Err(FileError::format(folder, "is a file; name a folder for the report").into())
        }
        Err(e) => Err(FileError::io(folder, "look into", e).into()),
    }
}

/// The GPU's name and its kernels, the fastest first; none where it is not to be measured.
fn gpu(world: &World, device: Device, tell: &mut dyn FnMut(&str)) -> Result<(Option<String>, Vec<&'static str>)> {
    let open =
        |device, tell: &mut dyn FnMut(&str)| Renderer::with_kernel(&world.scene, &world.resident, device, None, tell);
    match device {
        Device::Cpu => return Ok((None, Vec::new())),
        Device::Exact => {
            return Err(Error::Argument(
                "--device exact: a report always has the exact renderer; use cpu or gpu".into(),
            ));
        }
        Device::Auto if open(Device::Auto, tell)?.name() != "gpu" => return Ok((None, Vec::new())),
        Device::Auto | Device::Gpu | Device::AllGpus => {}
    }
    let name = open(Device::Gpu, tell)?.adapter();
    Ok((name, Renderer::gpu_kernels()))
}

/// The configuration that a budget or a greatest error asks for, in words; `None` where nothing is asked for.
pub fn choose(rows: &[Row], budget_ms: Option<f64>, max_error: Option<f64>) -> Result<Option<String>> {
    let fits = |r: &&Row| {
        r.config.candidate && budget_ms.is_none_or(|t| r.total() <= t) && max_error.is_none_or(|e| r.flip() <= e)
    };
    let fitting = rows.iter().filter(fits);
    let best = match (budget_ms, max_error) {
        (None, None) => return Ok(None),
        (Some(_), _) => fitting.min_by(|a, b| a.flip().total_cmp(&b.flip()).then(a.total().total_cmp(&b.total()))),
        (None, Some(_)) => fitting.min_by(|a, b| a.total().total_cmp(&b.total())),
    };
    let Some(row) = best else {
        let candidates = || rows.iter().filter(|r| r.config.candidate);
        let fastest = candidates().map(Row::total).fold(f64::INFINITY, f64::min);
        let least = candidates().map(Row::flip).fold(f64::INFINITY, f64::min);
        return Err(Error::Limit(format!(
            "no configuration is within the budget or error asked for: the fastest takes {fastest:.2} ms, the least FLIP is {least:.4}"
        )));
    };
    let beside = row.config.beside_flags().map_or(String::new(), |b| format!("   (and {b})"));
    Ok(Some(format!(
        "{}: {:.2} ms a frame, mean FLIP {:.4}, {:.3} % of pixels with another voxel\n{}{beside}",
        row.config.name,
        row.total(),
        row.flip(),
        row.other(),
        row.config.flags(),
    )))
}
