//! GPU time by kernel and stage, from timestamp queries.
//!
//! `cargo bench --bench gpu` runs criterion over one pose a scene. `cargo bench --bench gpu -- --table [rocks|mixing …]` flies
//! through whole worlds with every kernel and prints medians with work counters beside them (`PLANECAST_BENCH_SIZE`,
//! `PLANECAST_BENCH_POSES` and `PLANECAST_BENCH_PIXELS=WxH` change the columns a side, the poses and the picture). Neither
//! counts the host's plane setup, the upload or the read-back. Where a name is that of a file (any that `encode` reads), the
//! flight is a stroll over the ground at level 0, not repeated: [`stroll`]; `--poses` writes it as JSON, for peers.
//! `PLANECAST_BENCH_VIEW=single` leaves procedural worlds unrepeated too; `PLANECAST_BENCH_REMAP` names another remap.
//! `--film` counts frames a second with their read-back, one at a time and several on their way.

use criterion::{BenchmarkId, Criterion};
use planecast::measure::flythrough::{Entry, film, flythrough, poses, stroll};
use planecast::world::tree::Tree;
use planecast::{
    Camera, Features, GpuOptions, GpuRenderer, Kernel, Options, Outputs, Planes, Remap, Repeat, Resident, StageTimes,
};
use planecast_encoder::source;
use planecast_encoder::{BuildOptions, Scene, build};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

fn setting<T: std::str::FromStr>(name: &str, default: T) -> T {
    std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(default)
}

fn scene(name: &str, size: u32) -> (Arc<Scene>, Arc<Resident>) {
    let name = match name {
        _ if is_file(name) => name.into(),
        _ if name.contains('?') => format!("procedural:{name}"),
        _ => format!("procedural:{name}?size={size}"),
    };
    let input = source::open(Path::new(&name), &source::ReadOptions::default()).expect("a scene");
    let scene = build(input, &BuildOptions::default()).expect("a scene");
    let resident = Arc::new(Resident::new(&scene));
    (Arc::new(scene), resident)
}

fn is_file(name: &str) -> bool {
    Path::new(name).extension().is_some()
}

/// The paper's view: repeated without end, 40,000 voxels far, levels at one pixel.
fn options(name: &str) -> Options {
    let remap = std::env::var("PLANECAST_BENCH_REMAP")
        .map(|name| Remap::ALL.into_iter().find(|r| r.name() == name).expect("a remap's name"));
    let usual = Options {
        planes: Planes::Factor(setting("PLANECAST_BENCH_PLANES", 1.0)),
        remap: remap.unwrap_or(Options::default().remap),
        ..Options::default()
    };
    if is_file(name) {
        return Options { lod: None, ..usual };
    }
    if std::env::var("PLANECAST_BENCH_VIEW").is_ok_and(|view| view == "single") {
        return usual;
    }
    Options { repeat: Repeat { x: true, z: true }, view_distance: 40_000.0, ..usual }
}

/// Every kernel: `workgroup` also with other numbers of lanes and with wgpu's runtime checks, `invocation` with the paper's
/// mapping (its default, 32 planes a workgroup) and with one plane a workgroup.
const KERNELS: &str = "workgroup workgroup:32 workgroup:64 workgroup:128 workgroup:192 workgroup:256 workgroup:checked raycast \
                       raycast-runs invocation invocation:1";

/// `KERNEL[:LANES|:checked|:FEATURES]`, features as `--specialize` takes them.
fn entry(text: &str) -> Entry {
    let (kernel, rest) = text.split_once(':').unwrap_or((text, ""));
    let kernel = kernel.parse().expect("a kernel's name");
    let usual = Entry { kernel, lanes: None, trusted: true, specialize: Features::ALL };
    match rest {
        "" => usual,
        "checked" => Entry { trusted: false, ..usual },
        lanes if lanes.starts_with(char::is_numeric) => {
            Entry { lanes: Some(lanes.parse().expect("a number of lanes")), ..usual }
        }
        features => Entry { specialize: features.parse().expect("features"), ..usual },
    }
}

fn pixels() -> (u32, u32) {
    let pixels = std::env::var("PLANECAST_BENCH_PIXELS").unwrap_or("1024x768".into());
    let (w, h) = pixels.split_once('x').expect("WxH");
    (w.parse().expect("a width"), h.parse().expect("a height"))
}

fn films(names: &[String]) {
    let (w, h) = pixels();
    for name in names {
        let (scene, resident) = scene(name, setting("PLANECAST_BENCH_SIZE", 1024));
        let poses = poses(&resident, setting("PLANECAST_BENCH_POSES", 120), w, h);
        for in_flight in [1, 2, 3, 4] {
            let rate = film(&scene, &resident, &poses, &options(name), in_flight).expect("a film");
            println!("{name}: {w} × {h}, {in_flight} on their way: {rate:.0} frames a second");
        }
    }
}

fn table(names: &[String]) {
    let size = setting("PLANECAST_BENCH_SIZE", 1024);
    let n = setting("PLANECAST_BENCH_POSES", 120);
    let (w, h) = pixels();
    let kernels = std::env::var("PLANECAST_BENCH_KERNELS").unwrap_or(KERNELS.into());
    let entries: Vec<Entry> = kernels.split_whitespace().map(entry).collect();
    let pitches = std::env::var("PLANECAST_BENCH_PITCHES").unwrap_or_default();
    let pitches: Vec<f64> = pitches.split_whitespace().map(|p| p.parse().expect("degrees")).collect();
    for name in names {
        let (scene, resident) = scene(name, size);
        let poses = if is_file(name) { stroll(&resident, w, h) } else { poses(&resident, n, w, h) };
        let options = options(name);
        if entries.iter().any(|entry| entry.kernel == Kernel::Raycast) {
            let start = std::time::Instant::now();
            let tree = Tree::new(&resident).expect("a tree");
            let (ms, mib) = (start.elapsed().as_secs_f64() * 1e3, tree.bytes() as f64 / f64::from(1 << 20));
            println!(
                "{name}: tree of raycast {mib:.1} MiB, all levels, without colours; built in {ms:.0} ms on all threads"
            );
        }
        let fly = |what: &str, poses: &[Camera]| match flythrough(&scene, &resident, poses, &options, &entries) {
            Ok(table) => println!("{name}{what}: {table}"),
            Err(e) => println!("{name}{what}: {e}"),
        };
        if pitches.is_empty() {
            fly("", &poses);
        }
        for &pitch in &pitches {
            let turned: Vec<_> = poses.iter().map(|&pose| Camera { pitch, roll: 0.0, ..pose }).collect();
            fly(&format!(", pitch {pitch}"), &turned);
        }
    }
}

/// A stroll's cameras as JSON: axes of the world, y up, and angles in degrees; `depth`: voxels from bottom to top.
fn write_poses(names: &[String]) {
    let (width, height) = pixels();
    for name in names {
        let (scene, resident) = scene(name, 0);
        let pose = |camera: &Camera| {
            let Camera { eye, yaw, pitch, fov, .. } = *camera;
            let axes = camera.basis();
            let [eye, right, up, forward] = [eye, axes.right, axes.up, axes.forward].map(|v| v.to_array());
            serde_json::json!({"eye": eye, "yaw": yaw, "pitch": pitch, "fov": fov, "right": right, "up": up, "forward": forward})
        };
        let poses: Vec<_> = stroll(&resident, width, height).iter().map(pose).collect();
        let depth = scene.dims()[1];
        println!("{}", serde_json::json!({"width": width, "height": height, "depth": depth, "poses": poses}));
    }
}

fn stages(c: &mut Criterion) {
    let size = setting("PLANECAST_BENCH_SIZE", 256);
    for name in ["rocks", "mixing"] {
        let (scene, resident) = scene(name, size);
        let camera = poses(&resident, 12, 640, 480)[1];
        for kernel in Kernel::ALL {
            let mut gpu = match GpuRenderer::new(&scene, &resident, GpuOptions { kernel, ..GpuOptions::default() }) {
                Ok(gpu) => gpu,
                Err(e) => return println!("no GPU benches: {e}"),
            };
            let mut bench = |stage: &str, time: fn(&StageTimes) -> f64| {
                let mut group = c.benchmark_group(format!("{stage}/gpu"));
                group.sample_size(10);
                group.bench_function(BenchmarkId::new(kernel.name(), format!("{name}_{size}")), |b| {
                    b.iter_custom(|n| {
                        let mut total = Duration::ZERO;
                        for _ in 0..n {
                            let frame = gpu.render(&camera, &options(name), Outputs::default()).expect("a frame");
                            total += Duration::from_secs_f64(time(&frame.stats.gpu_ms.expect("times")) * 1e-3);
                        }
                        total
                    });
                });
            };
            bench("traverse", |t| t.traverse);
            if kernel == Kernel::default() {
                bench("remap", |t| t.remap);
                bench("shade", |t| t.shade);
            }
            bench("frame", |t| t.total);
        }
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    for (flag, run) in [("--table", table as fn(&[String])), ("--film", films), ("--poses", write_poses)] {
        if let Some(at) = arguments.iter().position(|a| a == flag) {
            let mut names = arguments[at + 1..].to_vec();
            if names.is_empty() {
                names = vec!["rocks".into(), "mixing".into()];
            }
            return run(&names);
        }
    }
    let mut criterion = Criterion::default().configure_from_args();
    stages(&mut criterion);
    criterion.final_summary();
}
