//! A flythrough through several kernels, timed by the device.

use crate::cpu::renderer::Outputs;
use crate::error::Result;
use crate::frame::camera::Camera;
use crate::frame::options::Options;
use crate::frame::specialize::Features;
use crate::gpu::{GpuOptions, GpuRenderer, Kernel};
use crate::world::tables::Resident;
use planecast_encoder::Scene;
use std::fmt;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// One kernel to measure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Entry {
    pub kernel: Kernel,
    /// See [`GpuOptions::lanes`].
    pub lanes: Option<u32>,
    /// Whether wgpu's runtime checks are left out.
    pub trusted: bool,
    /// What may be left out where a frame does not need it.
    pub specialize: Features,
}

/// Median, least and greatest of a stage, in milliseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Spread {
    pub median: f64,
    pub min: f64,
    pub max: f64,
}

/// What one kernel took over all poses.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Line {
    pub kernel: String,
    pub setup: Spread,
    pub traverse: Spread,
    pub remap: Spread,
    pub shade: Spread,
    pub total: Spread,
    /// Means over the poses.
    pub columns: f64,
    pub runs: f64,
    pub spans: f64,
    pub bytes_scene_gpu: u64,
}

/// A table of kernels; prints as text.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Table {
    pub device: String,
    pub driver: String,
    pub width: u32,
    pub height: u32,
    pub poses: usize,
    pub lines: Vec<Line>,
}

/// A flight of `n` poses over a scene: a loop over the world, low and high, with the camera turning from straight down to 40 degrees up and rolling in every fifth pose. Never inside a voxel.
pub fn poses(resident: &Resident, n: usize, width: u32, height: u32) -> Vec<Camera> {
    let level = &resident.levels[0];
    let (nx, nz) = (f64::from(level.nx), f64::from(level.nz));
    let pose = |i: usize| {
        let turn = i as f64 / n as f64 * std::f64::consts::TAU;
        let (x, z) = (nx * (0.5 + 0.45 * turn.cos()), nz * (0.5 + 0.45 * (2.0 * turn).sin()));
        let column = |x: f64, z: f64| {
            let ix = z.rem_euclid(nz) as usize * level.nx as usize + x.rem_euclid(nx) as usize;
            level.column(ix).next().map_or(0, |run| run.end())
        };
        let ground = f64::from(column(x, z));
        let y = ground + 3.0 + [0.05, 0.3, 1.0][i % 3] * f64::from(level.top);
        let pitch = [0.0, -15.0, -35.0, 10.0, -60.0, -90.0, -25.0, 40.0, -5.0, -80.0][i % 10];
        let roll = if i % 5 == 4 { 30.0 } else { 0.0 };
        Camera { eye: glam::DVec3::new(x, y, z), yaw: 137.5 * i as f64 % 360.0, pitch, roll, fov: 60.0, width, height }
    };
    (0..n).map(pose).collect()
}

/// A stroll over a map's ground: 8 places, 8 directions each, eyes 10 to 20 voxels above the ground, 48 level and 16 looking
/// 30 degrees down, 90 degrees wide.
pub fn stroll(resident: &Resident, width: u32, height: u32) -> Vec<Camera> {
    let level = &resident.levels[0];
    let (nx, nz) = (level.nx, level.nz);
    let fov = 2.0 * (f64::from(height) / f64::from(width)).atan().to_degrees();
    let pose = |i: u32| {
        let (place, turn) = (i / 8, i % 8);
        let (x, z) = (nx * (1 + place % 4 * 2) / 8, nz * (1 + place / 4 * 2) / 4);
        let ground = level.column((z * nx + x) as usize).next().map_or(0, |run| run.end());
        let y = f64::from(ground + 10 + 10 * place / 7);
        let pitch = if turn % 4 == 3 { -30.0 } else { 0.0 };
        let eye = glam::DVec3::new(f64::from(x) + 0.5, y, f64::from(z) + 0.5);
        Camera { eye, yaw: 45.0 * f64::from(turn) + 20.0, pitch, roll: 0.0, fov, width, height }
    };
    (0..64).map(pose).collect()
}

/// Frames a second over all `poses`, read back, with as many on their way as is said.
pub fn film(
    scene: &Arc<Scene>,
    resident: &Arc<Resident>,
    poses: &[Camera],
    options: &Options,
    in_flight: usize,
) -> Result<f64> {
    let mut gpu = GpuRenderer::new(scene, resident, GpuOptions { in_flight, ..GpuOptions::default() })?;
    let mut round = || -> Result<Duration> {
        let start = Instant::now();
        for camera in poses {
            if gpu.is_full() {
                gpu.collect().expect("frames are on their way")?;
            }
            gpu.submit(camera, options, Outputs::default())?;
        }
        while let Some(frame) = gpu.collect() {
            frame?;
        }
        Ok(start.elapsed())
    };
    // Shaders are compiled and buffers made in the first.
    round()?;
    Ok(poses.len() as f64 / round()?.as_secs_f64())
}

fn spread(mut v: Vec<f64>) -> Spread {
    v.sort_by(f64::total_cmp);
    match v[..] {
        [] => Spread::default(),
        [first, .., last] => Spread { median: v[v.len() / 2], min: first, max: last },
        [one] => Spread { median: one, min: one, max: one },
    }
}

/// How long a device is kept busy before each kernel, by rays, which take it longest: between short frames that are read back
/// it idles, and an H100 then lowers its clock to a third for seconds.
const WARM_UP: Duration = Duration::from_millis(1500);

/// Draws all `poses` with each kernel, once counting work, then twice without, and times the last round; with each frame
/// alone on the device.
pub fn flythrough(
    scene: &Arc<Scene>,
    resident: &Arc<Resident>,
    poses: &[Camera],
    options: &Options,
    entries: &[Entry],
) -> Result<Table> {
    let first = poses.first();
    let mut table = Table {
        device: String::new(),
        driver: String::new(),
        width: first.map_or(0, |c| c.width),
        height: first.map_or(0, |c| c.height),
        poses: poses.len(),
        lines: Vec::new(),
    };
    for entry in entries {
        let Entry { kernel, lanes, trusted, specialize } = *entry;
        let options = &Options { specialize, ..*options };
        let own = (specialize != Features::ALL).then(|| Arc::new(Resident::with(scene, specialize)));
        let resident = own.as_ref().unwrap_or(resident);
        let mut gpu =
            GpuRenderer::new(scene, resident, GpuOptions { kernel, lanes, trusted, ..GpuOptions::default() })?;
        (table.device, table.driver) = (gpu.device().0.into(), gpu.device().1.into());
        let mut times = Vec::new();
        let mut work = [0.0; 3];
        let mut bytes_scene_gpu = 0;
        let mut warm_up =
            GpuRenderer::new(scene, resident, GpuOptions { kernel: Kernel::RaycastRuns, ..GpuOptions::default() })?;
        let start = Instant::now();
        for camera in poses.iter().cycle().take_while(|_| start.elapsed() < WARM_UP) {
            warm_up.render(camera, options, Outputs::default())?;
        }
        drop(warm_up);
        for camera in poses {
            let stats = gpu.render(camera, options, Outputs::default())?.stats;
            bytes_scene_gpu = stats.bytes_scene_gpu;
            for (sum, n) in work.iter_mut().zip([stats.columns_visited, stats.runs_visited, stats.spans_drawn]) {
                *sum += n as f64 / poses.len() as f64;
            }
        }
        // Once more without counting: its shaders are others, so they are drawn with once before they are timed.
        gpu.set_count(false);
        for round in 0..2 {
            for camera in poses {
                let stats = gpu.render(camera, options, Outputs::default())?.stats;
                if round == 1 {
                    times.push(stats.gpu_ms.expect("frames of the GPU say what they took"));
                }
            }
        }
        let of = |stage: fn(&crate::frame::picture::StageTimes) -> f64| spread(times.iter().map(stage).collect());
        let mut name = kernel.name().to_string();
        if let Some(lanes) = lanes {
            name += &format!(" {lanes}");
        }
        if !trusted {
            name += " checked";
        }
        if specialize != Features::ALL {
            name += &format!(" {specialize}");
        }
        table.lines.push(Line {
            kernel: name,
            setup: of(|t| t.setup),
            traverse: of(|t| t.traverse),
            remap: of(|t| t.remap),
            shade: of(|t| t.shade),
            total: of(|t| t.total),
            columns: work[0],
            runs: work[1],
            spans: work[2],
            bytes_scene_gpu,
        });
    }
    Ok(table)
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{} ({}), {} × {}, {} poses", self.device, self.driver, self.width, self.height, self.poses)?;
        writeln!(
            f,
            "{:24} {:>23} {:>8} {:>8} {:>8} {:>8} {:>10} {:>10} {:>10} {:>10}",
            "kernel (median ms)",
            "traverse (min–max)",
            "remap",
            "shade",
            "total",
            "setup",
            "columns",
            "runs",
            "spans",
            "scene KiB"
        )?;
        for l in &self.lines {
            writeln!(
                f,
                "{:24} {:7.3} ({:.3}–{:.3}) {:8.3} {:8.3} {:8.3} {:8.3} {:10.0} {:10.0} {:10.0} {:10}",
                l.kernel,
                l.traverse.median,
                l.traverse.min,
                l.traverse.max,
                l.remap.median,
                l.shade.median,
                l.total.median,
                l.setup.median,
                l.columns,
                l.runs,
                l.spans,
                l.bytes_scene_gpu >> 10
            )?;
        }
        Ok(())
    }
}
