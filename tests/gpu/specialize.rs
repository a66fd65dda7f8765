//! Whatever is left out, pictures stay the same, bit for bit.

use super::*;
use planecast::frame::plane_setup::plane_setup;
use planecast::frame::specialize::{Specialization, Twin};
use planecast::{Feature, Features};
use planecast_encoder::format::features::Named;
use std::collections::HashSet;
use std::sync::Arc;

/// Ground of uneven height, with pits down to nothing.
fn pits() -> World {
    let (n, ny) = (48u32, 40u32);
    let mut columns = Vec::new();
    for z in 0..n {
        for x in 0..n {
            let h = (x * x * 7 + z * 13 + x * z) % 29;
            let pit = (x / 5 + z / 7) % 3 == 0;
            columns.push(if pit && h % 2 == 0 { 0 } else { h + u32::from(!pit) });
        }
    }
    let scene = scene_of(n, ny, |x, y, z| y < columns[(z * n + x) as usize]);
    World { resident: Arc::new(Resident::new(&scene)), scene }
}

fn scene_of(n: u32, ny: u32, solid: impl Fn(u32, u32, u32) -> bool + Sync) -> Arc<Scene> {
    let columns = Columns::from_fn(n, ny, n, solid);
    let input = Input { columns, colors: Colors::None, notes: Vec::new() };
    Arc::new(build(input, &BuildOptions::default()).unwrap())
}

fn cameras(world: &World) -> Vec<Camera> {
    let [nx, ny, nz] = world.scene.dims().map(f64::from);
    let at = |x: f64, y: f64, z: f64, yaw, pitch, roll| Camera {
        eye: DVec3::new(nx * x + 0.3, y, nz * z + 0.4),
        yaw,
        pitch,
        roll,
        fov: 75.0,
        width: 61,
        height: 46,
    };
    vec![
        at(0.5, ny + 3.7, 0.5, 30.0, 0.0, 0.0),
        at(0.5, ny * 0.75, 0.5, 200.0, -35.0, 20.0),
        at(0.5, ny * 1.5, 0.5, 100.0, -90.0, 0.0),
        at(-0.4, ny * 0.4, 0.5, 85.0, -5.0, 0.0),
        at(0.5, -9.0, 0.5, 60.0, 20.0, 0.0),
        at(1.5, 0.0, 1.2, -50.0, 10.0, 0.0),
    ]
}

fn option_grid() -> Vec<(&'static str, Options)> {
    let repeat = Repeat { x: true, z: true };
    vec![
        ("level 0", Options { lod: None, ..flat() }),
        ("levels", Options { lod: Some(3.0), ..flat() }),
        ("repeated", Options { lod: Some(2.0), repeat, view_distance: 900.0, ..flat() }),
        ("equidistant", Options { lod: None, equidistant: Some(7.0), ..flat() }),
    ]
}

/// All features, each of some alone, all but each of them.
fn sets(some: &[Feature]) -> Vec<Features> {
    let but = |&left: &Feature| Feature::ALL.into_iter().filter(|&f| f != left).collect();
    let alone = some.iter().map(|&f| Features::NONE.with(f));
    std::iter::once(Features::ALL).chain(alone).chain(some.iter().map(but)).collect()
}

/// The first difference between two frames of one pose.
fn differs(a: &Frame, b: &Frame) -> Option<String> {
    (0..a.depth.len()).find_map(|i| {
        let of = |f: &Frame| (f.color[i], f.depth[i].to_bits(), f.voxel[i]);
        (of(a) != of(b)).then(|| format!("pixel {i}: {:?} against {:?}", of(a), of(b)))
    })
}

/// Draws a grid of poses and options with each set of features; what was drawn, and what differs from the general kernel.
fn differing(world: &World, kernel: Kernel, sets: &[Features]) -> (HashSet<Features>, Vec<String>) {
    let general = Arc::new(Resident::with(&world.scene, Features::NONE));
    let mut plain = open(&world.scene, &general, gpu_options(kernel));
    let mut special = open(&world.scene, &world.resident, gpu_options(kernel));
    let (mut met, mut faults) = (HashSet::new(), Vec::new());
    // The others take ways that `workgroup` takes too.
    let every = if kernel == Kernel::Workgroup { 1 } else { 3 };
    for (k, (name, options)) in option_grid().into_iter().enumerate() {
        for camera in cameras(world).into_iter().skip(k % every).step_by(every) {
            let off = Options { specialize: Features::NONE, ..options };
            let expected = plain.render(&camera, &off, VOXEL).unwrap();
            assert!(expected.stats.left_out.is_empty());
            let mut seen = HashSet::new();
            for &specialize in sets {
                let options = Options { specialize, ..options };
                for (renderer, resident) in [(&mut plain, &general), (&mut special, &world.resident)] {
                    let setup = plane_setup(resident, &camera, &options);
                    let features = Specialization::new(resident, &setup, &camera, &options, Twin::Gpu).features;
                    if !seen.insert(features) {
                        continue;
                    }
                    met.insert(features);
                    let drawn = renderer.render(&camera, &options, VOXEL).unwrap();
                    if let Some(text) = differs(&drawn, &expected) {
                        faults.push(format!("{name}, {features}, {camera:?}: {text}"));
                    }
                }
            }
        }
    }
    (met, faults)
}

#[test]
fn specialization_changes_no_bit_of_a_picture() {
    if !gpu_wanted() {
        return;
    }
    let worlds = [
        ("pits", pits()),
        ("hills, run colours", world(Kind::Hills, 64, Encoding::Solid, ColorMode::Run)),
        ("hills, voxel colours", world(Kind::Hills, 64, Encoding::Solid, ColorMode::Voxel)),
        ("rocks", world(Kind::Rocks, 64, Encoding::Solid, ColorMode::Voxel)),
    ];
    let mut met = HashSet::new();
    for kernel in Kernel::ALL {
        for (name, world) in &worlds {
            assert_eq!(world.resident.heights, *name != "rocks", "{name}");
            // One by one where each has code of its own, which takes a software device seconds to compile.
            let sets = match kernel {
                Kernel::Workgroup if name.contains("colours") => sets(&[Feature::LateColor, Feature::Packed]),
                Kernel::Workgroup => sets(&Feature::ALL),
                _ => vec![Features::ALL],
            };
            let (features, faults) = differing(world, kernel, &sets);
            assert!(faults.is_empty(), "{} {name}: {} differ\n{}", kernel.name(), faults.len(), faults.join("\n"));
            met.extend(features);
        }
    }
    for feature in Feature::ALL {
        assert!(met.iter().any(|f| f.has(feature)), "{} was never drawn", feature.name());
    }
}

/// The comparison above, given a world that is one voxel higher at one place.
#[test]
fn specialization_check_catches_a_picture_that_differs() {
    if !gpu_wanted() {
        return;
    }
    let [mut right, wrong] = [0, 1].map(|more| {
        let scene = scene_of(48, 40, |x, y, z| y < 9 + more * u32::from(x == 24 && z == 20));
        World { resident: Arc::new(Resident::new(&scene)), scene }
    });
    right.resident = wrong.resident;
    let (_, faults) = differing(&right, Kernel::Workgroup, &[Features::ALL]);
    assert!(!faults.is_empty());
}
