//! Frame times over 24 yaws × 9 pitches from one place: the poses by which ports of Voxlap were timed.
//!
//! `cargo bench --bench views -- [SCENE [x,y,z]] [--threads N] [--lod PX] [--tiled VIEW] [--size WxH] [--fov D] [--retest | --refine]`.
//! `SCENE` is a `.pcast`, an input or `procedural:…` (the default: a terrain of 1,024 columns a side). Prints per pitch the
//! median, the 95th percentile and the greatest of setup + traverse + remap with colour, in milliseconds, traverse alone, and
//! the work of a plane. Each frame is drawn three times and its least time counts, so that a stall of the machine does not.
//! Not measured: shading and writing pictures.

use glam::DVec3;
use planecast::cpu::traverse::{Counters, PlaneBuffer, traverse};
use planecast::cpu::{refine, remap};
use planecast::frame::plane_setup::plane_setup;
use planecast::{Camera, Options, Remap, Repeat, Resident};
use planecast_encoder::source::{self, ReadOptions};
use planecast_encoder::{BuildOptions, PcastFile, Scene, build};
use std::path::Path;
use std::time::Instant;

const PITCHES: [f64; 9] = [-89.5, -80.0, -60.0, -30.0, -10.0, 0.0, 10.0, 30.0, 60.0];
const YAWS: usize = 24;

struct Args {
    scene: String,
    eye: Option<DVec3>,
    threads: usize,
    fov: f64,
    size: [u32; 2],
    options: Options,
}

fn args() -> Args {
    // Level 0 and a horizontal field of view of 90 degrees, unless told otherwise.
    let mut args = Args {
        scene: "procedural:terrain?size=1024&seed=1".into(),
        eye: None,
        threads: 1,
        fov: 2.0 * 0.75f64.atan().to_degrees(),
        size: [1024, 768],
        options: Options { lod: None, remap: Remap::Nearest, ..Options::default() },
    };
    let numbers = |text: &str, by: char| -> Vec<f64> {
        text.split(by).map(|v| v.parse().unwrap_or_else(|_| panic!("{text}: expected numbers"))).collect()
    };
    let mut rest = std::env::args().skip(1).filter(|a| a != "--bench");
    let mut plain = 0;
    while let Some(arg) = rest.next() {
        let mut value = || rest.next().unwrap_or_else(|| panic!("{arg}: expected a value"));
        match arg.as_str() {
            "--threads" => args.threads = numbers(&value(), ',')[0] as usize,
            "--lod" => args.options.lod = Some(numbers(&value(), ',')[0]),
            "--fov" => args.fov = numbers(&value(), ',')[0],
            "--retest" => args.options.remap = Remap::Retest,
            "--refine" => args.options.remap = Remap::Refine,
            "--tiled" => {
                args.options.repeat = Repeat { x: true, z: true };
                args.options.view_distance = numbers(&value(), ',')[0];
            }
            "--size" => {
                let v = numbers(&value(), 'x');
                args.size = [v[0] as u32, v[1] as u32];
            }
            _ if plain == 0 => (args.scene, plain) = (arg, 1),
            _ => args.eye = Some(DVec3::from_slice(&numbers(&arg, ','))),
        }
    }
    args
}

fn open(name: &str) -> Scene {
    let path = Path::new(name);
    let scene = if name.ends_with(".pcast") {
        PcastFile::open(path).and_then(|f| f.read_scene())
    } else {
        source::open(path, &ReadOptions::default()).and_then(|input| build(input, &BuildOptions::default()))
    };
    scene.unwrap_or_else(|e| panic!("{e}"))
}

fn main() {
    let args = args();
    let scene = open(&args.scene);
    let resident = Resident::new(&scene);
    let [nx, ny, nz] = scene.dims();
    let eye = args.eye.unwrap_or_else(|| {
        let ground = scene.levels[0].solid.column(nx / 2, nz / 2).last().map_or(0, |run| run.end());
        DVec3::new(f64::from(nx / 2) + 0.3, f64::from(ground) + 20.0, f64::from(nz / 2) + 0.4)
    });
    let pool = rayon::ThreadPoolBuilder::new().num_threads(args.threads).build().expect("threads can be started");
    println!("{}: {nx} x {ny} x {nz}, eye {eye}, {:?}, {} threads", args.scene, args.size, args.threads);
    println!("{:?}", args.options);
    println!("  pitch   median      p95      max  traverse  planes  columns/plane  runs/plane  spans/plane");

    let n = (args.size[0] * args.size[1]) as usize;
    let (mut buffer, mut color, mut depth) = (PlaneBuffer::default(), vec![0; n], vec![0.0; n]);
    let mut doubt = vec![refine::Doubt::NONE; n];
    let mut all = Vec::new();
    for pitch in PITCHES {
        let (mut times, mut walks) = (Vec::new(), Vec::new());
        let (mut work, mut planes) = (Counters::default(), 0);
        for yaw in 0..YAWS {
            let yaw = yaw as f64 * 360.0 / YAWS as f64;
            let camera =
                Camera { eye, yaw, pitch, roll: 0.0, fov: args.fov, width: args.size[0], height: args.size[1] };
            let (mut least, mut walk) = (f64::INFINITY, f64::INFINITY);
            for repetition in 0..3 {
                pool.install(|| {
                    let start = Instant::now();
                    let setup = plane_setup(&resident, &camera, &args.options);
                    let at = Instant::now();
                    let retest = setup.retests(&camera, &args.options);
                    let counters = traverse::<f32>(&resident, &setup, args.options.culling, &mut buffer, retest);
                    walk = walk.min(at.elapsed().as_secs_f64() * 1e3);
                    if retest {
                        let doubts = if setup.refines(&camera, &args.options) { n } else { 0 };
                        let (doubt, voxel) = (&mut doubt[..doubts], &mut []);
                        let mut pixels = remap::Pixels { color: &mut color, depth: &mut depth, voxel, doubt };
                        remap::remap_retest(&resident, &setup, &buffer, &camera, &mut pixels);
                        refine::refine(&resident, &setup, &camera, &mut pixels);
                    } else {
                        remap::remap(&setup, &buffer, args.size[0], &mut color, &mut depth);
                    }
                    least = least.min(start.elapsed().as_secs_f64() * 1e3);
                    if repetition == 0 {
                        work += counters;
                        planes += setup.planes.len();
                    }
                });
            }
            times.push(least);
            walks.push(walk);
        }
        all.extend(&times);
        let a_plane = |n: u64| n as f64 / planes as f64;
        println!(
            "{pitch:7} {:8.2} {:8.2} {:8.2} {:9.2} {:7} {:14.0} {:11.0} {:12.0}",
            quantile(&mut times, 0.5),
            quantile(&mut times, 0.95),
            quantile(&mut times, 1.0),
            quantile(&mut walks, 0.5),
            planes / YAWS,
            a_plane(work.columns_visited),
            a_plane(work.runs_visited),
            a_plane(work.spans_drawn)
        );
    }
    println!(
        "    all {:8.2} {:8.2} {:8.2}",
        quantile(&mut all, 0.5),
        quantile(&mut all, 0.95),
        quantile(&mut all, 1.0)
    );
}

fn quantile(values: &mut [f64], q: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * q) as usize]
}
