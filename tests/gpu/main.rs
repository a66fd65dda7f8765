//! The GPU path against its CPU twin and against exact rays, on whatever adapter there is (a software one in CI).
//! Without an adapter these tests fail; `PLANECAST_NO_GPU=1` skips them and says so.
#![cfg(feature = "gpu")]

mod compare;

use compare::{Difference, compare};
use glam::DVec3;
use planecast::gpu::Begin;
use planecast::plane_setup::plane_setup;
use planecast::{
    Camera, CpuRenderer, Culling, Frame, GpuOptions, GpuRenderer, Kernel, Options, Outputs, Planes, Remap, Repeat,
    Resident, Shading,
};
use planecast_encoder::source::procedural::{Kind, procedural};
use planecast_encoder::{BuildOptions, ColorMode, Encoding, Scene, build};

const VOXEL: Outputs = Outputs { voxel: true };

/// Whether GPU tests are wanted here.
fn gpu_wanted() -> bool {
    let skip = std::env::var_os("PLANECAST_NO_GPU").is_some_and(|v| v == "1");
    if skip {
        eprintln!("skipped: PLANECAST_NO_GPU=1");
    }
    !skip
}

struct World {
    scene: Scene,
    resident: Resident,
}

fn world(kind: Kind, size: u32, encoding: Encoding, color: ColorMode) -> World {
    let input = procedural(kind, size, 7).unwrap();
    let scene = build(input, &BuildOptions { encoding, color: Some(color), ..BuildOptions::default() }).unwrap();
    let resident = Resident::new(&scene);
    World { scene, resident }
}

fn rocks() -> World {
    world(Kind::Rocks, 128, Encoding::Solid, ColorMode::Voxel)
}

fn camera(world: &World, yaw: f64, pitch: f64, roll: f64) -> Camera {
    let [nx, ny, nz] = world.scene.dims().map(f64::from);
    let eye = DVec3::new(nx * 0.5 + 0.3, ny + 9.7, nz * 0.5 + 0.4);
    Camera { eye, yaw, pitch, roll, fov: 70.0, width: 121, height: 90 }
}

fn poses(world: &World) -> Vec<Camera> {
    let angles = [
        (0.0, 0.0, 0.0),
        (33.0, -20.0, 0.0),
        (123.0, -55.0, 17.0),
        (250.0, -90.0, 0.0),
        (71.0, -89.0, 40.0),
        (310.0, 35.0, -80.0),
        (90.0, 90.0, 10.0),
        (45.0, -30.0, 180.0),
    ];
    angles.into_iter().map(|(yaw, pitch, roll)| camera(world, yaw, pitch, roll)).collect()
}

fn gpu_options(kernel: Kernel) -> GpuOptions {
    GpuOptions { kernel, ..GpuOptions::default() }
}

fn flat() -> Options {
    Options { shading: Shading::None, ..Options::default() }
}

/// Draws all poses with CPU and GPU and passes each pair on.
fn against_cpu(world: &World, gpu: GpuOptions, options: &Options, mut see: impl FnMut(&Camera, Frame, Frame)) {
    let mut gpu = GpuRenderer::new(&world.scene, &world.resident, gpu).unwrap();
    let mut cpu = CpuRenderer::new(&world.scene, &world.resident);
    for camera in poses(world) {
        let drawn = gpu.render(&camera, options, VOXEL).unwrap();
        let expected = cpu.render(&camera, options, VOXEL).unwrap();
        see(&camera, drawn, expected);
    }
}

/// Rounding decides a sample on a voxel's edge one way or the other: about one of 10⁴, as measured, and no more than one
/// of 500 in any picture.
fn agrees(what: &str, camera: &Camera, d: &Difference) {
    println!("{what} yaw {} pitch {} roll {}: {d}", camera.yaw, camera.pitch, camera.roll);
    let allowed = d.pixels / 500;
    assert!(d.voxel <= allowed && d.depth <= allowed && d.color <= allowed, "{what} {camera:?}: {d}");
}

#[test]
fn planes_kernels_draw_what_the_cpu_draws() {
    if !gpu_wanted() {
        return;
    }
    let world = rocks();
    for kernel in [Kernel::Workgroup, Kernel::Invocation] {
        for (name, options) in [
            ("levels off", Options { lod: None, ..flat() }),
            ("levels", flat()),
            (
                "coarse levels, repeated",
                Options { lod: Some(4.0), repeat: Repeat { x: true, z: true }, view_distance: 2000.0, ..flat() },
            ),
            ("nearest plane", Options { remap: Remap::Nearest, ..flat() }),
            ("few planes, gap fill", Options { remap: Remap::Nearest, planes: Planes::Factor(0.4), ..flat() }),
            (
                "few planes, holes",
                Options { remap: Remap::Nearest, planes: Planes::Factor(0.4), gap_fill: false, ..flat() },
            ),
            ("readjusted", Options { readjust: true, ..flat() }),
            ("readjusted, gap fill", Options { readjust: true, remap: Remap::Nearest, ..flat() }),
            ("equidistant", Options { equidistant: Some(60.0), ..flat() }),
            ("shaded", Options::default()),
            ("fog", Options { fog: Some(200.0), ..Options::default() }),
        ] {
            against_cpu(&world, gpu_options(kernel), &options, |camera, drawn, expected| {
                agrees(&format!("{} {name}", kernel.name()), camera, &compare(&drawn, &expected));
                assert_eq!(drawn.stats.holes, expected.stats.holes, "{name} {camera:?}");
            });
        }
    }
}
