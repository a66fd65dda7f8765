//! Culling, the number of threads and what was drawn before change no bit of a picture.

mod common;

use common::compare::identical;
use common::{MEDIUM, World, camera, cullings, hills, odd, poses, worlds};
use glam::DVec3;
use planecast::{Culling, Options, Outputs, Planes, Remap, Repeat, Shading};

const SIZE: [u32; 2] = [72, 56];

/// Options that take different ways through the walk.
fn variants() -> Vec<(&'static str, Options)> {
    let lod = Options { shading: Shading::None, ..Options::default() };
    let level0 = Options { lod: None, ..lod };
    vec![
        ("level 0", level0),
        ("levels", lod),
        ("levels, repeat", Options { repeat: Repeat { x: true, z: true }, view_distance: 300.0, ..lod }),
        ("repeat along z", Options { repeat: Repeat { x: false, z: true }, view_distance: 200.0, ..level0 }),
        ("equidistant", Options { equidistant: Some(20.0), ..level0 }),
        (
            "equidistant, levels, few planes, nearest",
            Options { equidistant: Some(0.0), planes: Planes::Factor(0.6), remap: Remap::Nearest, ..lod },
        ),
    ]
}

/// Each variant meets every third pose, each pose two variants.
const STRIDE: usize = 3;

/// Pictures under every combination of switches, from each third pose; text of the first that is not that of `reference`.
fn differing(world: &World, reference: &Options, options: &Options, first: usize) -> Option<String> {
    let mut renderer = world.renderer();
    for pose in poses(world, SIZE).iter().skip(first % STRIDE).step_by(STRIDE) {
        let mut draw = |options: &Options| renderer.render(&pose.camera, options, Outputs { voxel: true }).unwrap();
        let plain = draw(&Options { culling: Culling::NONE, ..*reference });
        for culling in cullings() {
            if let Err(text) = identical(&draw(&Options { culling, ..*options }), &plain) {
                return Some(format!("{}, {}, {culling:?} against none: {text}", world.name, pose.name));
            }
        }
    }
    None
}

#[test]
fn culling_never_changes_a_picture() {
    let mut faults = Vec::new();
    for world in &worlds() {
        for (k, (name, options)) in variants().into_iter().enumerate() {
            faults.extend(differing(world, &options, &options, k).map(|text| format!("{name}: {text}")));
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

/// The check above, given culling that is wrong by a little: a walk that ends a few voxels early, a coarser level.
#[test]
fn culling_check_catches_culling_that_is_wrong() {
    let world = hills(MEDIUM);
    let right = Options { lod: None, shading: Shading::None, ..Options::default() };
    let wrong = [Options { view_distance: 30.0, ..right }, Options { lod: Some(4.0), ..right }];
    for wrong in wrong {
        let text = differing(&world, &right, &wrong, 0).expect("a difference");
        assert!(text.contains("pixels differ\n  pixel ("), "{text}");
    }
}

#[test]
fn culling_saves_work() {
    let world = hills(MEDIUM);
    let camera = camera(world.over(64.5, 64.5, 2.0), [40.0, -5.0, 0.0], [200, 150]);
    let work = |culling| {
        let stats = world.render(&camera, &Options { lod: None, culling, ..Options::default() }).stats;
        [stats.columns_visited, stats.runs_visited, stats.spans_drawn]
    };
    let none = work(Culling::NONE);
    let all = work(Culling::ALL);
    assert!(all[0] < none[0] && 2 * all[1] < none[1] && 2 * all[2] < none[2], "{all:?} of {none:?}");
    for culling in [
        Culling { horizon: true, ..Culling::NONE },
        Culling { coarse: true, ..Culling::ALL },
        Culling { center: true, horizon: true, ..Culling::NONE },
    ] {
        let some = work(culling);
        assert!(some.iter().zip(none).all(|(a, n)| *a <= n), "{culling:?}: {some:?} of {none:?}");
    }
}

#[test]
fn picture_is_the_same_from_one_thread_and_many() {
    let pool = |n| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
    let (one, many) = (pool(1), pool(7));
    for world in [hills(MEDIUM), odd()] {
        for pose in poses(&world, [150, 90]) {
            for options in [Options::default(), Options { planes: Planes::Factor(0.4), ..Options::default() }] {
                let a = one.install(|| world.render(&pose.camera, &options));
                let b = many.install(|| world.render(&pose.camera, &options));
                assert_eq!(identical(&a, &b), Ok(()), "{}", pose.name);
                assert_eq!(
                    (a.stats.columns_visited, a.stats.runs_visited, a.stats.spans_drawn),
                    (b.stats.columns_visited, b.stats.runs_visited, b.stats.spans_drawn)
                );
            }
            let a = one.install(|| world.exact(&pose.camera, &Options::default()));
            let b = many.install(|| world.exact(&pose.camera, &Options::default()));
            assert_eq!(identical(&a, &b), Ok(()), "exact, {}", pose.name);
        }
    }
}

/// What a renderer drew before, larger or smaller, leaves no trace.
#[test]
fn picture_is_the_same_from_a_used_renderer() {
    for world in worlds() {
        let mut used = world.renderer();
        let all = poses(&world, SIZE);
        for (k, pose) in all.iter().enumerate().step_by(2) {
            for (name, options) in variants() {
                let outputs = Outputs { voxel: k % 4 == 0 };
                let mut other = all[(k * 7 + 3) % all.len()].camera;
                (other.width, other.height) = (20 + 11 * k as u32, 90 - k as u32);
                used.render(&other, &options, Outputs { voxel: true }).unwrap();
                let a = used.render(&pose.camera, &options, outputs).unwrap();
                let b = world.renderer().render(&pose.camera, &options, outputs).unwrap();
                assert_eq!(identical(&a, &b), Ok(()), "{}, {}, {name}", world.name, pose.name);
            }
        }
    }
}

/// Asking for voxels changes neither colour nor depth.
#[test]
fn picture_is_the_same_without_voxels() {
    let world = odd();
    let mut renderer = world.renderer();
    for pose in poses(&world, SIZE) {
        for (name, options) in variants() {
            let mut a = renderer.render(&pose.camera, &options, Outputs { voxel: true }).unwrap();
            let b = renderer.render(&pose.camera, &options, Outputs { voxel: false }).unwrap();
            a.voxel.clear();
            assert_eq!(identical(&a, &b), Ok(()), "{}, {name}", pose.name);
        }
    }
}

/// Off to one side of a world that does not fill the view, so that planes start at its edge.
#[test]
fn culling_never_changes_a_picture_from_far_off() {
    let world = hills([40, 24, 56]);
    let mut renderer = world.renderer();
    for k in 0..40 {
        let angle = f64::from(k) * 9.0;
        let eye =
            DVec3::new(20.0, 30.0, 28.0) + 90.0 * DVec3::new(angle.to_radians().sin(), 0.2, -angle.to_radians().cos());
        let camera = camera(eye, [angle + 180.0, -8.0, f64::from(k)], SIZE);
        let mut draw = |culling| {
            let options = Options { culling, ..Options::default() };
            renderer.render(&camera, &options, Outputs { voxel: true }).unwrap()
        };
        let none = draw(Culling::NONE);
        for culling in cullings() {
            assert_eq!(identical(&draw(culling), &none), Ok(()), "{culling:?} at {angle}");
        }
    }
}
