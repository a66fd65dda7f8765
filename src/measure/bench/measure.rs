//! Drawing what is compared, turn by turn, and what it took.

use super::row::Row;
use super::scenes::{Key, Loaded, Scenes, View};
use crate::frame::picture::Stats;
#[cfg(feature = "gpu")]
use crate::gpu::{GpuOptions, GpuRenderer, Kernel};
use crate::measure::report::run::GPU_WAKES;
use crate::{Camera, CpuRenderer, Culling, Error, Options, Outputs, Result, StageTimes};
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::collections::HashMap;
use std::time::Instant;

/// What draws.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Engine {
    Cpu {
        threads: usize,
    },
    /// One f32 ray a pixel through a tree of masks, on the CPU.
    Rays {
        threads: usize,
    },
    /// One f64 ray a pixel at level 0, on the CPU.
    Exact {
        threads: usize,
    },
    #[cfg(feature = "gpu")]
    Gpu(Kernel),
}

impl Engine {
    pub fn name(self) -> String {
        let threads = |n: usize| if n == 1 { "1 thread".into() } else { format!("{n} threads") };
        match self {
            Engine::Cpu { threads: n } => format!("CPU, {}", threads(n)),
            Engine::Rays { threads: n } => format!("CPU, rays, {}", threads(n)),
            Engine::Exact { threads: n } => format!("exact rays, CPU, {}", threads(n)),
            #[cfg(feature = "gpu")]
            Engine::Gpu(kernel) => format!("GPU, {}", kernel.name()),
        }
    }

    fn threads(self) -> Option<usize> {
        match self {
            Engine::Cpu { threads } | Engine::Rays { threads } | Engine::Exact { threads } => Some(threads),
            #[cfg(feature = "gpu")]
            Engine::Gpu(_) => None,
        }
    }
}

/// One line to measure.
#[derive(Clone, Debug)]
pub struct Config {
    pub part: &'static str,
    pub scene: Key,
    pub view: View,
    pub size: [u32; 2],
    pub engine: Engine,
    pub options: Options,
    /// What else this differs in from its neighbours, and its amount where it is one.
    pub variant: String,
    pub x: Option<f64>,
}

impl Config {
    /// Unique in a run as long as configurations that differ in other options have different variants.
    pub fn key(&self) -> String {
        let Key { name, side, encoding, .. } = self.scene;
        let [w, h] = self.size;
        format!(
            "{}/{}-{side}-{encoding:?}/{}/{w}x{h}/{}/{}/{}",
            self.part,
            name.text(),
            self.view.name(),
            switches(self.options.culling),
            self.variant,
            self.engine.name()
        )
        .to_lowercase()
    }
}

/// The culling switches that are on.
pub fn switches(c: Culling) -> String {
    let all =
        [(c.horizon, "horizon"), (c.center, "center"), (c.forward, "forward"), (c.bits, "bits"), (c.coarse, "coarse")];
    let on: Vec<&str> = all.iter().filter(|(on, _)| *on).map(|(_, name)| *name).collect();
    if on.is_empty() { "none".into() } else { on.join("+") }
}

/// Frames of a line: at least and at most, and milliseconds after which no more than the least are drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rounds {
    pub least: u32,
    pub most: u32,
    pub budget_ms: f64,
}

/// Least, greatest and median of `values`, which are not empty.
fn spread(mut values: Vec<f64>) -> [f64; 3] {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    let median = (values[(n - 1) / 2] + values[n / 2]) / 2.0;
    [median, values[0], values[n - 1]]
}

#[derive(Default)]
struct Samples {
    times: Vec<StageTimes>,
    /// Sums of planes, columns, runs and spans.
    work: [f64; 4],
    spent_ms: f64,
    rounds: u32,
    device: String,
}

/// Pools of rendering threads, made once.
#[derive(Default)]
pub struct Pools(HashMap<usize, ThreadPool>);

impl Pools {
    fn get(&mut self, threads: usize) -> Result<&ThreadPool> {
        use std::collections::hash_map::Entry;
        Ok(match self.0.entry(threads) {
            Entry::Occupied(pool) => pool.into_mut(),
            Entry::Vacant(place) => {
                let pool = ThreadPoolBuilder::new().num_threads(threads).build();
                place.insert(pool.map_err(|e| Error::Limit(format!("{threads} threads: {e}")))?)
            }
        })
    }
}

/// The renderers of one scene, opened as they are needed.
struct Drawers<'a> {
    loaded: &'a Loaded,
    cpu: CpuRenderer,
    #[cfg(feature = "gpu")]
    gpu: Option<GpuRenderer>,
}

impl Drawers<'_> {
    fn draw(&mut self, pools: &mut Pools, engine: Engine, camera: &Camera, options: &Options) -> Result<Stats> {
        let frame = match engine {
            Engine::Cpu { threads } | Engine::Rays { threads } => {
                let cpu = &mut self.cpu;
                cpu.set_raycast(matches!(engine, Engine::Rays { .. }));
                pools.get(threads)?.install(|| cpu.render(camera, options, Outputs::default()))
            }
            Engine::Exact { threads } => {
                let cpu = &mut self.cpu;
                pools.get(threads)?.install(|| cpu.exact(camera, options, Outputs::default()))
            }
            #[cfg(feature = "gpu")]
            Engine::Gpu(kernel) => {
                if self.gpu.is_none() {
                    let Loaded { scene, resident, .. } = self.loaded;
                    self.gpu = Some(GpuRenderer::new(scene, resident, GpuOptions::default())?);
                }
                let gpu = self.gpu.as_mut().expect("opened above");
                gpu.set_kernel(kernel, None);
                gpu.render(camera, options, Outputs::default())
            }
        }?;
        if frame.stats.kernel == "inside" {
            let eye = camera.eye;
            return Err(Error::Argument(format!(
                "the eye at {eye} is inside a solid voxel: nothing would be measured"
            )));
        }
        Ok(frame.stats)
    }
}

/// Draws each of `group` once, unmeasured, then in turns, so that a drift of the machine hits all alike. A GPU that fails ends
/// its own lines only: they become rows of no frames whose variant says why.
pub fn measure(
    scenes: &Scenes,
    loaded: &HashMap<Key, Loaded>,
    group: &[Config],
    rounds: impl Fn(Engine) -> Rounds,
    pools: &mut Pools,
) -> Result<Vec<Row>> {
    let mut drawers: HashMap<Key, Drawers<'_>> = HashMap::new();
    let mut failed: Vec<Row> = Vec::new();
    let mut lines = Vec::new();
    for config in group {
        let scene = &loaded[&config.scene];
        let mut options = config.options;
        if let Some(distance) = config.view.distance(scene, config.size) {
            options.view_distance = distance;
        }
        drawers.entry(config.scene).or_insert_with(|| Drawers {
            loaded: scene,
            cpu: CpuRenderer::new(&scene.scene, &scene.resident),
            #[cfg(feature = "gpu")]
            gpu: None,
        });
        lines.push((config, options, config.view.cameras(scene, config.size), Some(Samples::default())));
    }
    // The GPU's lines after one another: the CPU's between them would let its clock sink.
    lines.sort_by_key(|(config, ..)| config.engine.threads().is_none());
    let mut gpu_awake = false;
    for round in 0.. {
        let mut drawn = false;
        for (config, options, cameras, line) in &mut lines {
            let limits = rounds(config.engine);
            let Some(samples) = line else { continue };
            let enough =
                samples.rounds >= limits.most || samples.rounds >= limits.least && samples.spent_ms > limits.budget_ms;
            if enough {
                continue;
            }
            drawn = true;
            let drawer = drawers.get_mut(&config.scene).expect("one a scene");
            let mut turn = || -> Result<()> {
                let on_gpu = config.engine.threads().is_none();
                if on_gpu && !gpu_awake {
                    let clock = Instant::now();
                    while clock.elapsed() < GPU_WAKES {
                        drawer.draw(pools, config.engine, &cameras[0], options)?;
                    }
                }
                gpu_awake = on_gpu;
                let start = Instant::now();
                for camera in cameras.iter() {
                    let stats = drawer.draw(pools, config.engine, camera, options)?;
                    if round == 0 {
                        continue;
                    }
                    samples.times.push(stats.gpu_ms.or(stats.cpu_ms).unwrap_or_default());
                    let work = [u64::from(stats.planes), stats.columns_visited, stats.runs_visited, stats.spans_drawn];
                    for (sum, n) in samples.work.iter_mut().zip(work) {
                        *sum += n as f64;
                    }
                    samples.device = stats.device;
                }
                if round > 0 {
                    samples.rounds += 1;
                    samples.spent_ms += start.elapsed().as_secs_f64() * 1e3;
                }
                Ok(())
            };
            match turn() {
                Err(Error::Device(what) | Error::Limit(what)) if config.engine.threads().is_none() => {
                    failed.push(Row { part: config.part.into(), key: config.key(), variant: what, ..Row::default() });
                    *line = None;
                }
                other => other?,
            }
        }
        if !drawn {
            break;
        }
    }
    let drawn = lines
        .into_iter()
        .filter_map(|(config, _, _, samples)| Some(row(scenes, &loaded[&config.scene], config, samples?)));
    Ok(drawn.chain(failed).collect())
}

fn row(scenes: &Scenes, loaded: &Loaded, config: &Config, samples: Samples) -> Row {
    let n = samples.times.len();
    let of = |stage: fn(&StageTimes) -> f64| spread(samples.times.iter().map(stage).collect());
    let (total, traverse) = (of(|t| t.total), of(|t| t.traverse));
    let [planes, columns, runs, spans] = samples.work.map(|sum| Some(sum / n as f64));
    let fps = |ms: f64| (ms > 0.0).then(|| 1e3 / ms);
    let Loaded { scene, info, .. } = loaded;
    let surface = info.surface_voxels as f64;
    let scene_runs = |level: &planecast_encoder::Level| level.geometry(scene.encoding).runs().len() as f64;
    let named = |v: &dyn std::fmt::Debug| format!("{v:?}").to_lowercase();
    let [width, height] = config.size;
    Row {
        part: config.part.into(),
        key: config.key(),
        scene: format!("{} ({})", config.scene.name.text(), scenes.source(&config.scene)),
        encoding: named(&scene.encoding),
        device: samples.device,
        kernel: match config.engine {
            Engine::Cpu { .. } => "planes".into(),
            Engine::Rays { .. } => "raycast".into(),
            Engine::Exact { .. } => "exact".into(),
            #[cfg(feature = "gpu")]
            Engine::Gpu(kernel) => kernel.name().into(),
        },
        threads: config.engine.threads().map(|n| n as u32),
        width: Some(width),
        height: Some(height),
        view: config.view.name().into(),
        culling: switches(config.options.culling),
        variant: config.variant.clone(),
        x: config.x,
        n: n as u32,
        total_ms: Some(total[0]),
        total_min_ms: Some(total[1]),
        total_max_ms: Some(total[2]),
        setup_ms: Some(of(|t| t.setup)[0]),
        traverse_ms: Some(traverse[0]),
        traverse_min_ms: Some(traverse[1]),
        traverse_max_ms: Some(traverse[2]),
        remap_ms: Some(of(|t| t.remap)[0]),
        shade_ms: Some(of(|t| t.shade)[0]),
        fps: fps(total[0]),
        fps_low: fps(total[2]),
        fps_high: fps(total[1]),
        planes,
        columns,
        runs,
        spans,
        scene_runs: scene.levels.first().map(scene_runs),
        scene_runs_all: Some(scene.levels.iter().map(scene_runs).sum()),
        runs_per_s: runs.zip(fps(total[0])).map(|(runs, fps)| runs * fps),
        geometry_bits_per_voxel: info.bytes_per_surface_voxel.map(|bytes| 8.0 * bytes),
        bits_per_voxel: (surface > 0.0).then(|| 8.0 * info.bytes.total as f64 / surface),
        ..Row::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spread_is_median_least_and_greatest() {
        assert_eq!(spread(vec![5.0, 1.0, 2.0]), [2.0, 1.0, 5.0]);
        assert_eq!(spread(vec![4.0, 1.0, 2.0, 9.0]), [3.0, 1.0, 9.0]);
        assert_eq!(spread(vec![7.0]), [7.0; 3]);
    }

    #[test]
    fn switches_are_named_as_the_command_line_names_them() {
        assert_eq!(switches(Culling::ALL), "horizon+center+forward+bits+coarse");
        assert_eq!(switches(Culling { bits: true, ..Culling::NONE }), "bits");
        assert_eq!(switches(Culling::NONE), "none");
    }
}
