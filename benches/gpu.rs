//! GPU time by kernel and stage, from timestamp queries.
//!
//! `cargo bench --bench gpu` runs criterion over one pose a scene. `cargo bench --bench gpu -- --table [rocks|mixing …]` flies
//! through whole worlds with every kernel and prints medians with work counters beside them (`PLANECAST_BENCH_SIZE`,
//! `PLANECAST_BENCH_POSES` and `PLANECAST_BENCH_PIXELS=WxH` change the columns a side, the poses and the picture). Neither
//! counts the host's plane setup, the upload or the read-back.

use criterion::{BenchmarkId, Criterion};
use planecast::gpu::bench::{Entry, flythrough, poses};
use planecast::{GpuOptions, GpuRenderer, Kernel, Options, Outputs, Repeat, Resident, StageTimes};
use planecast_encoder::source::procedural::from_name;
use planecast_encoder::{BuildOptions, Scene, build};
use std::time::Duration;

fn setting<T: std::str::FromStr>(name: &str, default: T) -> T {
    std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(default)
}

fn scene(name: &str, size: u32) -> (Scene, Resident) {
    let input = from_name(&format!("{name}?size={size}")).expect("a procedural scene");
    let scene = build(input, &BuildOptions::default()).expect("a scene");
    let resident = Resident::new(&scene);
    (scene, resident)
}

/// The paper's view: repeated without end, 40,000 voxels far, levels at one pixel.
fn options() -> Options {
    Options { repeat: Repeat { x: true, z: true }, view_distance: 40_000.0, ..Options::default() }
}

fn table(names: &[String]) {
    let size = setting("PLANECAST_BENCH_SIZE", 1024);
    let n = setting("PLANECAST_BENCH_POSES", 120);
    let pixels = std::env::var("PLANECAST_BENCH_PIXELS").unwrap_or("1024x768".into());
    let (w, h) = pixels.split_once('x').expect("WxH");
    let (w, h) = (w.parse().expect("a width"), h.parse().expect("a height"));
    let entry = |kernel, lanes| Entry { kernel, lanes, trusted: true };
    let mut entries = vec![entry(Kernel::Raycast, None)];
    entries.extend([8, 32].map(|n| entry(Kernel::Invocation, Some(n))));
    entries.extend([32, 64, 128, 256].map(|n| entry(Kernel::Workgroup, Some(n))));
    entries.push(Entry { kernel: Kernel::Workgroup, lanes: Some(128), trusted: false });
    for name in names {
        let (scene, resident) = scene(name, size);
        let poses = poses(&resident, n, w, h);
        match flythrough(&scene, &resident, &poses, &options(), &entries) {
            Ok(table) => println!("{name} {size}: {table}"),
            Err(e) => println!("{name} {size}: {e}"),
        }
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
                            let frame = gpu.render(&camera, &options(), Outputs::default()).expect("a frame");
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
    if let Some(at) = arguments.iter().position(|a| a == "--table") {
        let mut names = arguments[at + 1..].to_vec();
        if names.is_empty() {
            names = vec!["rocks".into(), "mixing".into()];
        }
        return table(&names);
    }
    let mut criterion = Criterion::default().configure_from_args();
    stages(&mut criterion);
    criterion.final_summary();
}
