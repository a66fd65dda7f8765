//! The CPU's stages, each with its input ready-made, and whole frames.
//!
//! Scenes are procedural, so the benches need no files: `terrain` (caves and overhangs, level 0 only) and `rocks` (floating
//! rocks, tiled without end, seen 40,000 voxels far with levels). `PLANECAST_BENCH_SCENE=FILE.pcast` adds a scene of your own.
//! Beside each time stands the work of the frame: a change of work that was not meant is a fault that the bench found.

use criterion::{Criterion, criterion_group, criterion_main};
use planecast::cpu::traverse::{PlaneBuffer, traverse};
use planecast::cpu::{remap, shade};
use planecast::frame::plane_setup::plane_setup;
use planecast::{Camera, CpuRenderer, Options, Outputs, Remap, Repeat, Resident, Shading};
use planecast_encoder::source::{self, ReadOptions};
use planecast_encoder::{BuildOptions, PcastFile, Scene, build};
use std::hint::black_box;
use std::path::Path;
use std::sync::Arc;

const SIZE: [u32; 2] = [1024, 768];

struct Case {
    name: String,
    scene: Arc<Scene>,
    options: Options,
}

fn cases() -> Vec<Case> {
    let procedural = |name: &str| {
        let input = source::open(Path::new(name), &ReadOptions::default()).expect("procedural scenes need no file");
        Arc::new(build(input, &BuildOptions::default()).expect("procedural scenes can be encoded"))
    };
    let near = Options { lod: None, remap: Remap::Nearest, shading: Shading::None, ..Options::default() };
    let far = Options {
        lod: Some(1.0),
        repeat: Repeat { x: true, z: true },
        view_distance: 40_000.0,
        remap: Remap::Nearest,
        shading: Shading::None,
        ..Options::default()
    };
    let mut cases = vec![
        Case { name: "terrain".into(), scene: procedural("procedural:terrain?size=1024&seed=1"), options: near },
        Case { name: "rocks_tiled".into(), scene: procedural("procedural:rocks?size=1024&seed=1"), options: far },
    ];
    if let Ok(file) = std::env::var("PLANECAST_BENCH_SCENE") {
        let read = PcastFile::open(Path::new(&file)).and_then(|f| f.read_scene());
        let scene = read.unwrap_or_else(|e| panic!("PLANECAST_BENCH_SCENE: {e}"));
        cases.push(Case {
            name: file.rsplit('/').next().unwrap_or("file").into(),
            scene: Arc::new(scene),
            options: near,
        });
    }
    cases
}

/// Twenty voxels above the ground at the world's middle.
fn camera(scene: &Scene, pitch: f64) -> Camera {
    let [nx, _, nz] = scene.dims();
    let ground = scene.levels[0].solid.column(nx / 2, nz / 2).last().map_or(0, |run| run.end());
    let eye = glam::DVec3::new(f64::from(nx / 2) + 0.3, f64::from(ground) + 20.0, f64::from(nz / 2) + 0.4);
    Camera { eye, yaw: 37.0, pitch, roll: 0.0, fov: 60.0, width: SIZE[0], height: SIZE[1] }
}

fn stages(c: &mut Criterion) {
    // Listing and filtering benches must not build scenes: criterion runs this function once for all.
    let cases = cases();
    for case in &cases {
        let resident = Arc::new(Resident::new(&case.scene));
        let options = case.options;
        for pitch in [0.0, -30.0, -90.0, 30.0] {
            let camera = camera(&case.scene, pitch);
            let id = |stage: &str| format!("{stage}/cpu/{}/pitch {pitch}", case.name);
            let setup = plane_setup(&resident, &camera, &options);
            let mut buffer = PlaneBuffer::default();
            let work = traverse::<f32>(&resident, &setup, options.culling, &mut buffer, false);
            println!("{} pitch {pitch}: {} planes, {work:?}", case.name, setup.planes.len());

            c.bench_function(&id("plane_setup"), |b| {
                b.iter(|| plane_setup(&resident, black_box(&camera), &options));
            });
            c.bench_function(&id("traverse"), |b| {
                b.iter(|| traverse::<f32>(&resident, &setup, options.culling, &mut buffer, false));
            });
            let n = (SIZE[0] * SIZE[1]) as usize;
            let (mut color, mut depth) = (vec![0; n], vec![0.0; n]);
            c.bench_function(&id("remap"), |b| {
                b.iter(|| remap::remap(&setup, &buffer, SIZE[0], &mut color, &mut depth));
            });
            let params = shade::ShadeParams::new(&camera, &Options { shading: Shading::Full, ..options });
            let mut out = vec![[0; 4]; n];
            let mut scratch = shade::Scratch::default();
            c.bench_function(&id("shade"), |b| {
                b.iter(|| shade::shade(&params, &color, &depth, &mut scratch, &mut out));
            });
            let mut renderer = CpuRenderer::new(&case.scene, &resident);
            c.bench_function(&id("frame"), |b| {
                b.iter(|| renderer.render(&camera, &options, Outputs::default()).expect("the camera is valid"));
            });
        }
    }
}

criterion_group! { name = benches; config = Criterion::default().sample_size(20); targets = stages }
criterion_main!(benches);
