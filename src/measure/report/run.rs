//! Measuring: errors of each configuration at each pose, then their times, in turn.

use super::journal::{self, ErrorFigures, Figures, Journal};
use super::metrics::Truth;
use super::poses::Named;
use super::sweep::{Backend, Config};
use crate::cpu::renderer::{CpuRenderer, Outputs};
use crate::cpu::{gap_fill, remap};
use crate::error::{Error, Result};
use crate::frame::camera::Camera;
use crate::frame::picture::{Frame, StageTimes};
use crate::frame::plane_setup::plane_setup;
use crate::render::device::{Device, Renderer};
use crate::world::tables::Resident;
use planecast_encoder::{BuildOptions, ColorMode, Colors, Columns, Encoding, Input, MipRule, Scene, build};
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Rays a pixel of the truth's colour along each axis.
pub const SUPERSAMPLING: u32 = 2;

/// Draws configurations.
pub trait Draw {
    /// One frame. The camera has the configuration's own size already.
    fn draw(&mut self, config: &Config, camera: &Camera, outputs: Outputs) -> Result<Frame>;

    /// Pixels that no plane reaches, before gap fill and after.
    fn holes(&mut self, config: &Config, camera: &Camera) -> [u64; 2];
}

/// How long an idle GPU takes to reach its clock, or longer.
pub(crate) const GPU_WAKES: Duration = Duration::from_millis(200);

/// A scene with its levels built by one rule.
pub struct World {
    pub scene: Arc<Scene>,
    pub resident: Arc<Resident>,
}

impl World {
    pub fn new(scene: Scene) -> World {
        let resident = Arc::new(Resident::new(&scene));
        World { scene: Arc::new(scene), resident }
    }

    /// The same world with its levels built anew.
    pub fn with_rule(scene: &Scene, rule: MipRule) -> Result<World> {
        let level = &scene.levels[0];
        let colors = match (scene.color, scene.encoding) {
            (ColorMode::None, _) => Colors::None,
            (ColorMode::Run, Encoding::Solid) => Colors::Run(level.colors.clone()),
            (ColorMode::Run, Encoding::Surface) => voxel_colors(level.geometry(scene.encoding), &level.colors, false),
            (ColorMode::Voxel, _) => {
                let exposed = level.exposed.as_ref().expect("voxel colours come with exposed runs");
                voxel_colors(exposed, &level.colors, true)
            }
        };
        let input = Input { columns: level.solid.clone(), colors, notes: Vec::new() };
        let options = BuildOptions { encoding: scene.encoding, color: Some(scene.color), mip_rule: rule };
        Ok(World::new(build(input, &options)?))
    }
}

/// Colours of exposed runs, one a voxel or one a run, for the encoder.
fn voxel_colors(exposed: &Columns, colors: &[[u8; 3]], a_voxel: bool) -> Colors {
    let mut entries = Vec::new();
    let mut offsets = vec![0];
    let mut next = 0;
    for column in 0..exposed.offsets().len() - 1 {
        for run in &exposed.runs()[exposed.range(column)] {
            for y in run.first()..=run.last() {
                entries.push((y, colors[next]));
                next += usize::from(a_voxel);
            }
            next += usize::from(!a_voxel);
        }
        offsets.push(entries.len() as u32);
    }
    Colors::Voxel { offsets, entries }
}

/// Draws with the project's own renderers.
pub struct Drawer<'a> {
    file: &'a World,
    other: &'a World,
    cpu: [CpuRenderer; 2],
    gpu: HashMap<(&'static str, bool), Renderer>,
}

impl<'a> Drawer<'a> {
    /// `other`: the same world by the other rule.
    pub fn new(file: &'a World, other: &'a World) -> Drawer<'a> {
        let cpu = [file, other].map(|w| CpuRenderer::new(&w.scene, &w.resident));
        Drawer { file, other, cpu, gpu: HashMap::new() }
    }

    fn is_other(&self, config: &Config) -> bool {
        config.rule.is_some_and(|rule| rule != self.file.scene.mip_rule)
    }
}

impl Draw for Drawer<'_> {
    fn draw(&mut self, config: &Config, camera: &Camera, outputs: Outputs) -> Result<Frame> {
        let other = self.is_other(config);
        let cpu = &mut self.cpu[usize::from(other)];
        match config.backend {
            Backend::Cpu => cpu.render(camera, &config.options, outputs),
            Backend::Exact => cpu.exact(camera, &config.options, outputs),
            Backend::Gpu(kernel) => {
                let world = if other { self.other } else { self.file };
                let renderer = match self.gpu.entry((kernel, other)) {
                    Entry::Occupied(entry) => entry.into_mut(),
                    Entry::Vacant(entry) => {
                        let (scene, resident) = (&world.scene, &world.resident);
                        entry.insert(Renderer::with_kernel(scene, resident, Device::Gpu, Some(kernel), &mut |_| {})?)
                    }
                };
                renderer.draw_with(camera, &config.options, outputs, &mut |_| {})
            }
        }
    }

    fn holes(&mut self, config: &Config, camera: &Camera) -> [u64; 2] {
        if config.backend == Backend::Exact {
            return [0; 2];
        }
        let world = if self.is_other(config) { self.other } else { self.file };
        let setup = plane_setup(&world.resident, camera, &config.options);
        let mut index = vec![0; camera.width as usize * camera.height as usize];
        remap::remap_index(&setup, camera.width, &mut index);
        let open = index.iter().filter(|&&i| i == remap::HOLE).count() as u64;
        match config.options.gap_fill {
            true => gap_fill::gap_fill(&setup, camera.width, &mut index),
            false => [open; 2],
        }
    }
}

/// A frame enlarged by repetition of pixels.
fn enlarged(frame: Frame, width: u32, height: u32) -> Frame {
    if (frame.width, frame.height) == (width, height) {
        return frame;
    }
    let place = |i: usize| {
        let (x, y) = ((i % width as usize) as u64, (i / width as usize) as u64);
        let from = |v: u64, n: u32, of: u32| (2 * v + 1) * u64::from(n) / (2 * u64::from(of));
        (from(y, frame.height, height) * u64::from(frame.width) + from(x, frame.width, width)) as usize
    };
    let n = width as usize * height as usize;
    Frame {
        width,
        height,
        color: (0..n).map(|i| frame.color[place(i)]).collect(),
        depth: (0..n).map(|i| frame.depth[place(i)]).collect(),
        voxel: (0..n).map(|i| frame.voxel[place(i)]).collect(),
        stats: frame.stats,
    }
}

/// What is measured, and how often.
pub struct Plan<'p> {
    pub configs: &'p [Config],
    pub poses: &'p [Named],
    /// Pixels of the whole picture.
    pub size: [u32; 2],
    pub rounds: u32,
    /// Program, machine and scene: figures of others are not taken over.
    pub identity: String,
}

impl Plan<'_> {
    pub fn key(&self, config: &Config, pose: &Named) -> String {
        let Config { backend, options, scale, rule, .. } = config;
        let all = format!(
            "{} {backend:?} {options:?} {scale} {rule:?} {:?} {:?} {SUPERSAMPLING}",
            self.identity, pose.pose, self.size
        );
        format!("{:016x}", xxhash_rust::xxh3::xxh3_64(all.as_bytes()))
    }

    fn camera(&self, config: &Config, pose: &Named) -> Camera {
        pose.pose.camera(self.size.map(|n| ((f64::from(n) * config.scale).round() as u32).max(1)))
    }

    /// The truth at a pose.
    pub fn truth(&self, draw: &mut dyn Draw, pose: &Named) -> Result<Truth> {
        let exact =
            self.configs.iter().find(|c| c.backend == Backend::Exact).expect("exact is among the configurations");
        let camera = pose.pose.camera(self.size);
        let frame = draw.draw(exact, &camera, Outputs { voxel: true })?;
        let camera = pose.pose.camera(self.size.map(|n| n * SUPERSAMPLING));
        let supersampled = draw.draw(exact, &camera, Outputs { voxel: false })?;
        Ok(Truth::new(frame, &supersampled))
    }

    /// A configuration's whole picture, with voxels.
    pub fn picture(&self, draw: &mut dyn Draw, config: &Config, pose: &Named) -> Result<Frame> {
        let frame = draw.draw(config, &self.camera(config, pose), Outputs { voxel: true })?;
        Ok(enlarged(frame, self.size[0], self.size[1]))
    }

    /// Measures what the journal does not have yet. `tell` hears of each step.
    pub fn run(&self, draw: &mut dyn Draw, journal: &mut Journal, tell: &mut dyn FnMut(&str)) -> Result<()> {
        for (p, pose) in self.poses.iter().enumerate() {
            let missing = |c: &&Config| journal.error(&self.key(c, pose)).is_none();
            let missing: Vec<&Config> = self.configs.iter().filter(missing).collect();
            let n = missing.len();
            if n == 0 {
                continue;
            }
            tell(&format!("errors: pose {} of {}, {}: {n} configurations", p + 1, self.poses.len(), pose.name));
            let truth = self.truth(draw, pose)?;
            for config in missing {
                let frame = self.picture(draw, config, pose)?;
                let stats = &frame.stats;
                let figures = ErrorFigures {
                    errors: truth.errors(&frame),
                    holes: draw.holes(config, &self.camera(config, pose)),
                    planes: stats.planes,
                    columns_visited: stats.columns_visited,
                    runs_visited: stats.runs_visited,
                    spans_drawn: stats.spans_drawn,
                };
                journal.add(self.entry(config, pose, Figures::Error(figures)))?;
            }
        }
        let start = Instant::now();
        let mut gpu_awake = false;
        for round in 0..self.rounds {
            let mut told = false;
            for pose in self.poses {
                // Configurations take turns, so that a drift of the machine's speed hits all alike.
                for config in self.configs {
                    if journal.time(&self.key(config, pose), round).is_some() {
                        continue;
                    }
                    if !told {
                        let since = start.elapsed().as_secs();
                        tell(&format!("times: round {} of {}, {since} s so far", round + 1, self.rounds));
                        told = true;
                    }
                    let camera = self.camera(config, pose);
                    // Buffers take their sizes and caches fill in a frame that is not counted. A GPU takes its time to reach
                    // its clock once the CPU was busy.
                    let on_gpu = matches!(config.backend, Backend::Gpu(_));
                    let clock = Instant::now();
                    loop {
                        draw.draw(config, &camera, Outputs::default())?;
                        if !on_gpu || gpu_awake || clock.elapsed() > GPU_WAKES {
                            break;
                        }
                    }
                    gpu_awake = on_gpu;
                    let stats = draw.draw(config, &camera, Outputs::default())?.stats;
                    let stages = stats.gpu_ms.or(stats.cpu_ms).unwrap_or_default();
                    journal.add(self.entry(config, pose, Figures::Time { round, stages }))?;
                }
            }
        }
        Ok(())
    }

    fn entry(&self, config: &Config, pose: &Named, figures: Figures) -> journal::Entry {
        journal::Entry { key: self.key(config, pose), config: config.name.clone(), pose: pose.name.clone(), figures }
    }

    /// All measurements of all configurations.
    pub fn rows(&self, journal: &Journal) -> Result<Vec<Row>> {
        let missing = || Error::Limit("the report's measurements are not complete; run it again".into());
        let row = |config: &Config| {
            let errors: Option<Vec<ErrorFigures>> =
                self.poses.iter().map(|pose| journal.error(&self.key(config, pose))).collect();
            let times = (0..self.rounds).map(|round| {
                let times = self.poses.iter().map(|pose| journal.time(&self.key(config, pose), round));
                times.collect::<Option<Vec<StageTimes>>>()
            });
            let times: Option<Vec<Vec<StageTimes>>> = times.collect();
            Ok(Row { config: config.clone(), errors: errors.ok_or_else(missing)?, times: times.ok_or_else(missing)? })
        };
        self.configs.iter().map(row).collect()
    }
}

/// All that was measured of one configuration.
#[derive(Clone, Debug)]
pub struct Row {
    pub config: Config,
    /// One a pose.
    pub errors: Vec<ErrorFigures>,
    /// Rounds of one a pose; empty where nothing was timed.
    pub times: Vec<Vec<StageTimes>>,
}

impl Row {
    /// Mean over the poses.
    pub fn mean(&self, figure: impl Fn(&ErrorFigures) -> f64) -> f64 {
        self.errors.iter().map(figure).sum::<f64>() / self.errors.len() as f64
    }

    /// The pose with the greatest figure, and the figure.
    pub fn worst(&self, figure: impl Fn(&ErrorFigures) -> f64) -> (usize, f64) {
        let all = self.errors.iter().map(figure).enumerate();
        all.fold((0, f64::NEG_INFINITY), |worst, now| if now.1 > worst.1 { now } else { worst })
    }

    /// Milliseconds a frame, mean over the poses: least, median and greatest of the rounds. `None` where nothing was timed.
    pub fn time(&self, stage: impl Fn(&StageTimes) -> f64) -> Option<[f64; 3]> {
        let round = |times: &Vec<StageTimes>| times.iter().map(&stage).sum::<f64>() / times.len() as f64;
        let mut means: Vec<f64> = self.times.iter().map(round).collect();
        means.sort_unstable_by(f64::total_cmp);
        let n = means.len();
        (n > 0).then(|| [means[0], (means[(n - 1) / 2] + means[n / 2]) / 2.0, means[n - 1]])
    }

    /// Median of the whole frame; infinite where nothing was timed.
    pub fn total(&self) -> f64 {
        self.time(|t| t.total).map_or(f64::INFINITY, |t| t[1])
    }

    /// FLIP against the exact renderer with one ray a pixel: the error that the method adds.
    pub fn flip(&self) -> f64 {
        self.mean(|e| e.errors.flip_exact)
    }

    pub fn other(&self) -> f64 {
        self.mean(|e| e.errors.other)
    }

    /// PSNR of the mean squared error over all poses, decibels.
    pub fn psnr(&self) -> f64 {
        -10.0 * self.mean(|e| e.errors.mse).log10()
    }
}
