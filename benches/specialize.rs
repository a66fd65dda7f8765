//! Traversal with all that a frame does not need left out against the general kernel: the same planes in turn, the same
//! picture.
//!
//! `cargo bench --bench specialize -- [SCENE …] [--threads N] [--rounds N] [--voxels]`. `SCENE` is a `.pcast`, an input or
//! `procedural:…` (the default: hills, terrain, rocks, a mixing layer). Prints a Markdown table: a row a scene and view,
//! medians of milliseconds over rounds of eight yaws, and the median of the ratios of neighbouring rounds. Not measured:
//! the other stages.

use glam::DVec3;
use planecast::cpu::traverse::{PlaneBuffer, Real};
use planecast::frame::plane_setup::plane_setup;
use planecast::frame::specialize::{Specialization, Twin};
use planecast::{Camera, Features, Options, Repeat, Resident};
use planecast_encoder::source::{self, ReadOptions};
use planecast_encoder::{BuildOptions, PcastFile, Scene, build};
use std::path::Path;
use std::time::Instant;

const SIZE: [u32; 2] = [1024, 768];
const YAWS: usize = 8;

fn scene(name: &str) -> Scene {
    let path = Path::new(name);
    let read = match path.extension() {
        Some(end) if end == "pcast" => PcastFile::open(path).and_then(|f| f.read_scene()),
        _ => source::open(path, &ReadOptions::default()).and_then(|input| build(input, &BuildOptions::default())),
    };
    read.unwrap_or_else(|e| panic!("{name}: {e}"))
}

/// A view's name, its options and its cameras.
fn views(scene: &Scene) -> Vec<(&'static str, Options, Vec<Camera>)> {
    let [nx, ny, nz] = scene.dims();
    let ground = scene.levels[0].solid.column(nx / 2, nz / 2).last().map_or(0, |run| run.end());
    let middle = |y: f64| DVec3::new(f64::from(nx / 2) + 0.3, y, f64::from(nz / 2) + 0.4);
    let turn = |pitch: f64, eye: DVec3| -> Vec<Camera> {
        let yaw = |k: usize| 360.0 * (k as f64 + 0.3) / YAWS as f64;
        (0..YAWS)
            .map(|k| Camera { eye, yaw: yaw(k), pitch, roll: 0.0, fov: 60.0, width: SIZE[0], height: SIZE[1] })
            .collect()
    };
    let outside = |pitch: f64| -> Vec<Camera> {
        let out = |camera: Camera| Camera { eye: camera.eye - camera.basis().forward * f64::from(nx), ..camera };
        turn(pitch, middle(f64::from(ny) * 0.5)).into_iter().map(out).collect()
    };
    let above = f64::from(ground) + 20.0;
    let top = f64::from(ny) + 40.0;
    let near = Options { lod: None, ..Options::default() };
    let far =
        Options { lod: Some(1.0), repeat: Repeat { x: true, z: true }, view_distance: 40_000.0, ..Options::default() };
    vec![
        ("level, near the ground", near, turn(0.0, middle(above))),
        ("15° down, over the hills", near, turn(-15.0, middle(top))),
        ("40° down, over the hills", near, turn(-40.0, middle(top))),
        ("straight down", near, turn(-90.0, middle(2.0 * top))),
        ("from outside, 30° down", near, outside(-30.0)),
        ("tiled, 40,000 far, level", far, turn(0.0, middle(top))),
        ("tiled, 40,000 far, 15° down", far, turn(-15.0, middle(top))),
    ]
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn main() {
    let (mut scenes, mut threads, mut rounds, mut voxels) = (Vec::new(), 1, 15, false);
    let mut rest = std::env::args().skip(1).filter(|a| a != "--bench");
    while let Some(arg) = rest.next() {
        let mut number =
            || rest.next().and_then(|v| v.parse().ok()).unwrap_or_else(|| panic!("{arg}: expected a number"));
        match arg.as_str() {
            "--threads" => threads = number(),
            "--rounds" => rounds = number(),
            "--voxels" => voxels = true,
            _ => scenes.push(arg),
        }
    }
    if scenes.is_empty() {
        scenes = ["hills?size=1024", "terrain?size=1024", "rocks?size=1024", "mixing?size=512"]
            .map(|name| format!("procedural:{name}"))
            .into();
    }
    rayon::ThreadPoolBuilder::new().num_threads(threads).build_global().expect("no pool before");
    println!("| scene | view | left out | general, ms | specialized, ms | ratio |");
    println!("|---|---|---|---|---|---|");
    for name in &scenes {
        let scene = scene(name);
        let residents = [Features::NONE, Features::ALL].map(|f| Resident::with(&scene, f));
        for (view, options, cameras) in views(&scene) {
            let mut buffers = [PlaneBuffer::default(), PlaneBuffer::default()];
            let mut left_out = String::new();
            let frames: [Vec<_>; 2] = [0, 1].map(|i| {
                let options = Options { specialize: [Features::NONE, Features::ALL][i], ..options };
                let frame = |camera| {
                    let setup = plane_setup(&residents[i], camera, &options);
                    let features = Specialization::new(&residents[i], &setup, camera, &options, Twin::Cpu);
                    left_out = features.features.to_string();
                    (setup, features)
                };
                cameras.iter().map(frame).collect()
            });
            let mut round = |i: usize| {
                let start = Instant::now();
                for (setup, features) in &frames[i] {
                    f32::traverse(&residents[i], setup, options.culling, *features, &mut buffers[i], voxels);
                }
                start.elapsed().as_secs_f64() * 1e3 / YAWS as f64
            };
            let times: Vec<[f64; 2]> = (0..rounds + 1).map(|_| [round(0), round(1)]).skip(1).collect();
            let of = |i: usize| median(times.iter().map(|t| t[i]).collect());
            let ratio = median(times.iter().map(|t| t[0] / t[1]).collect());
            println!("| {name} | {view} | {left_out} | {:.2} | {:.2} | {ratio:.2} |", of(0), of(1));
            assert!(
                buffers[0].color == buffers[1].color && buffers[0].voxel == buffers[1].voxel,
                "the pictures differ"
            );
        }
    }
}
