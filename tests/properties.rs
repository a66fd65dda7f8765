//! What must hold for any world and camera: symmetries, holes and gap fill, extremes of every input.

mod common;

use common::any::{BOTH, Clumps, agree, any_camera, check, clumps, same, scaled, without_color};
use common::compare::{compare, identical, mirrored, sane, with_voxels};
use common::{MEDIUM, Random, caves, cullings, hills, odd, plain, poses, room, worlds};
use glam::DVec3;
use planecast::measure::stability::measure::off;
use planecast::measure::stability::{self, WorldName};
use planecast::{Camera, Culling, Frame, Options, Outputs, Planes, Remap, Repeat};
use planecast_encoder::{BuildOptions, Columns, Input, Scene, build};
use proptest::prelude::*;
use std::sync::Arc;

#[test]
fn moving_eye_and_repeated_world_by_whole_periods_changes_no_bit() {
    check(60, (clumps(), any_camera(), -1000i32..1000, -1000i32..1000, any::<bool>()), |(c, camera, px, pz, lod)| {
        let world = c.world(c.dims, |x, y, z| Some([x, y, z]));
        let options = Options { repeat: BOTH, view_distance: 120.0, lod: lod.then_some(1.0), ..plain() };
        let camera = scaled(camera, c.dims);
        let [dx, dz] = [px * c.dims[0] as i32, pz * c.dims[2] as i32];
        let moved = Camera { eye: camera.eye + DVec3::new(f64::from(dx), 0.0, f64::from(dz)), ..camera };
        let a = world.render(&camera, &options);
        same(&with_voxels(&a, |[x, y, z, l]| [x + dx, y, z + dz, l]), &world.render(&moved, &options))
    });
}

#[test]
fn moving_eye_and_repeated_world_by_whole_voxels_changes_no_bit() {
    check(60, (clumps(), any_camera(), 0..40u32, 0..40u32), |(c, camera, dx, dz)| {
        let [nx, _, nz] = c.dims;
        let world = c.world(c.dims, |x, y, z| Some([x, y, z]));
        let rolled = c.world(c.dims, |x, y, z| Some([(x + nx * 40 - dx) % nx, y, (z + nz * 40 - dz) % nz]));
        let options = Options { repeat: BOTH, view_distance: 120.0, ..plain() };
        let camera = scaled(camera, c.dims);
        let moved = Camera { eye: camera.eye + DVec3::new(f64::from(dx), 0.0, f64::from(dz)), ..camera };
        let a = without_color(world.render(&camera, &options));
        let a = with_voxels(&a, |[x, y, z, l]| [x + dx as i32, y, z + dz as i32, l]);
        same(&a, &without_color(rolled.render(&moved, &options)))
    });
}

#[test]
fn moving_eye_and_world_by_whole_voxels_in_all_directions_changes_no_bit() {
    check(120, (clumps(), any_camera(), 0..30u32, 0..30u32, 0..30u32), |(c, camera, dx, dy, dz)| {
        let [nx, ny, nz] = c.dims;
        let world = c.world(c.dims, |x, y, z| Some([x, y, z]));
        let moved = c.world([nx + dx + 5, ny + dy + 3, nz + dz + 4], |x, y, z| {
            let [x, y, z] = [x.checked_sub(dx)?, y.checked_sub(dy)?, z.checked_sub(dz)?];
            (x < nx && y < ny && z < nz).then_some([x, y, z])
        });
        let camera = scaled(camera, c.dims);
        let by = DVec3::new(f64::from(dx), f64::from(dy), f64::from(dz));
        let a = without_color(world.render(&camera, &plain()));
        let a = with_voxels(&a, |[x, y, z, l]| [x + dx as i32, y + dy as i32, z + dz as i32, l]);
        same(&a, &without_color(moved.render(&Camera { eye: camera.eye + by, ..camera }, &plain())))
    });
}

#[test]
fn turning_the_world_by_90_degrees_turns_the_picture() {
    check(80, (clumps(), any_camera()), |(c, camera)| {
        let [nx, ny, nz] = c.dims;
        let world = c.world(c.dims, |x, y, z| Some([x, y, z]));
        // −z becomes +x: (x, z) to (nz − z, x).
        let turned = c.world([nz, ny, nx], |x, y, z| Some([z, y, nz - 1 - x]));
        let camera = scaled(camera, c.dims);
        let eye = DVec3::new(f64::from(nz) - camera.eye.z, camera.eye.y, camera.eye.x);
        let a = with_voxels(&world.render(&camera, &plain()), |[x, y, z, l]| [nz as i32 - 1 - z, y, x, l]);
        let b = turned.render(&Camera { eye, yaw: camera.yaw + 90.0, ..camera }, &plain());
        agree(&a, &b, 1)
    });
}

#[test]
fn mirroring_the_world_mirrors_the_picture() {
    check(80, (clumps(), any_camera()), |(c, camera)| {
        let nx = c.dims[0];
        let world = c.world(c.dims, |x, y, z| Some([x, y, z]));
        let other = c.world(c.dims, |x, y, z| Some([nx - 1 - x, y, z]));
        let camera = scaled(camera, c.dims);
        let eye = DVec3::new(f64::from(nx) - camera.eye.x, camera.eye.y, camera.eye.z);
        let b = other.render(&Camera { eye, yaw: -camera.yaw, roll: -camera.roll, ..camera }, &plain());
        let b = mirrored(&with_voxels(&b, |[x, y, z, l]| [nx as i32 - 1 - x, y, z, l]));
        // Ties between samples fall to the other side.
        agree(&world.render(&camera, &plain()), &b, 3)
    });
}

#[test]
fn culling_never_changes_a_picture_of_any_world() {
    let switches: Vec<Culling> = cullings().collect();
    check(250, (clumps(), any_camera(), any_options(), 0..32usize), |(c, camera, options, k)| {
        let world = c.world(c.dims, |x, y, z| Some([x, y, z]));
        let camera = scaled(camera, c.dims);
        let draw = |culling| world.render(&camera, &Options { culling, view_distance: 500.0, ..options });
        same(&draw(switches[k]), &draw(Culling::NONE))
    });
}

/// No more than one pixel in a hundred shows what cannot be seen from there, where planes are pixel columns none.
#[test]
fn planes_show_what_exact_shows_of_any_world() {
    let world_of = |c: &Clumps| {
        let world = c.world(c.dims, |x, y, z| Some([x, y, z]));
        stability::World { name: WorldName::Empty, scene: world.scene, resident: world.resident }
    };
    let (mut all, mut most) = (0, 0.0f64);
    let figures = std::cell::RefCell::new((&mut all, &mut most));
    check(150, (clumps(), any_camera(), any::<bool>()), |(c, camera, level)| {
        let world = world_of(&c);
        let mut camera = scaled(camera, c.dims);
        if level {
            (camera.pitch, camera.roll) = (0.0, 0.0);
        }
        let mut renderer = planecast::CpuRenderer::new(&world.scene, &world.resident);
        let frame = renderer.render(&camera, &plain(), Outputs { voxel: true }).unwrap();
        let exact = renderer.exact(&camera, &plain(), Outputs { voxel: true }).unwrap();
        let wrong = off(&frame, &exact, &world, &camera, &plain()).len();
        let columns = camera.pitch == 0.0 && camera.roll == 0.0;
        let share = wrong as f64 / frame.voxel.len() as f64;
        let mut figures = figures.borrow_mut();
        *figures.0 += wrong;
        *figures.1 = figures.1.max(share);
        let allowed = if columns { 5e-4 } else { 0.01 };
        prop_assert!(share <= allowed, "{} pixels are off: {:?} {:?}", wrong, c, camera);
        Ok(())
    });
    println!("{all} pixels are off, at most {:.2} % of a picture", 100.0 * most);
    // Planted: a picture from another place.
    let c = Clumps { dims: [30, 20, 30], seed: 5, percent: 20 };
    let world = world_of(&c);
    let camera = scaled((DVec3::new(0.5, 1.2, 0.5), [20.0, -40.0, 0.0], 60.0), c.dims);
    let mut renderer = planecast::CpuRenderer::new(&world.scene, &world.resident);
    let beside = Camera { eye: camera.eye + DVec3::X, ..camera };
    let frame = renderer.render(&beside, &plain(), Outputs { voxel: true }).unwrap();
    let exact = renderer.exact(&camera, &plain(), Outputs { voxel: true }).unwrap();
    assert!(off(&frame, &exact, &world, &camera, &plain()).len() > frame.voxel.len() / 100);
}

#[test]
fn symmetry_checks_catch_a_world_that_is_not_turned() {
    let c = Clumps { dims: [30, 20, 30], seed: 5, percent: 20 };
    let world = c.world(c.dims, |x, y, z| Some([x, y, z]));
    let turned = c.world(c.dims, |x, y, z| Some([z, y, 29 - x]));
    let camera = scaled((DVec3::new(0.5, 1.2, 0.5), [20.0, -40.0, 0.0], 60.0), c.dims);
    let (a, b) = (world.render(&camera, &plain()), turned.render(&camera, &plain()));
    assert!(agree(&a, &b, 3).is_err());
    assert!(same(&a, &b).is_err());
    let mut b = a.clone();
    let ground = b.depth.iter().position(|d| d.is_finite()).expect("a picture of the world");
    b.depth[ground] *= 1.001;
    assert!(agree(&b, &a, 3).is_err());
}

#[test]
fn fewer_planes_with_gap_fill_leave_no_hole() {
    let room = room();
    let mut random = Random::new(9);
    for k in 0..60 {
        let turn = [random.within(0.0, 360.0), random.within(-90.0, 90.0), random.within(-50.0, 50.0)];
        let mut camera = common::camera(DVec3::new(12.4, 7.3, 10.6), turn, [91, 67]);
        camera.fov = random.within(20.0, 110.0);
        for remap in Remap::ALL {
            let fewer = Options { planes: Planes::Factor(0.5), readjust: k % 2 == 0, remap, ..plain() };
            let sky = |f: &Frame| f.depth.iter().filter(|&&d| d == f32::INFINITY).count() as u64;
            let filled = room.render(&camera, &fewer);
            let open = room.render(&camera, &Options { gap_fill: false, ..fewer });
            assert_eq!(sky(&filled), 0, "{camera:?} {fewer:?}");
            assert!(open.stats.holes > 0 && sky(&open) == open.stats.holes, "{camera:?}: {} holes", open.stats.holes);
            assert!(filled.stats.planes <= filled.stats.planes_full.div_ceil(2) + 4);
            let full =
                room.render(&camera, &Options { gap_fill: false, planes: Planes::Auto, readjust: false, ..fewer });
            assert_eq!((full.stats.holes, sky(&full)), (0, 0), "planes one pixel apart leave none");
        }
    }
}

#[test]
fn plane_counts_are_as_asked() {
    let world = hills([64, 32, 64]);
    for pose in poses(&world, [80, 60]) {
        // From one a fan on.
        for n in [4, 5, 8, 17, 100, 1000] {
            let stats = world.render(&pose.camera, &Options { planes: Planes::Count(n), ..plain() }).stats;
            assert_eq!(stats.planes, n, "{}", pose.name);
        }
        let even = Options { readjust: false, ..plain() };
        let auto = world.render(&pose.camera, &even).stats;
        assert_eq!(auto.planes, auto.planes_full, "{}", pose.name);
        let double = world.render(&pose.camera, &Options { planes: Planes::Factor(2.0), ..even }).stats;
        assert_eq!(double.planes, 2 * auto.planes, "{}", pose.name);
    }
}

#[test]
fn readjusted_spacing_casts_fewer_planes_looking_down() {
    for world in [hills(MEDIUM), caves()] {
        for pitch in [-90.0, -80.0, -65.0] {
            let eye = world.over(60.5, 70.5, 25.0);
            let camera = common::camera(eye, [20.0, pitch, 0.0], [200, 150]);
            let exact = world.exact(&camera, &plain());
            let even = world.render(&camera, &Options { readjust: false, ..plain() });
            let fewer = world.render(&camera, &Options { readjust: true, ..plain() });
            let saved = 1.0 - f64::from(fewer.stats.planes) / f64::from(even.stats.planes);
            let agreement = compare(&fewer, &exact);
            println!(
                "{} pitch {pitch}: {:.1} % fewer planes, {agreement}; even {}",
                world.name,
                100.0 * saved,
                compare(&even, &exact)
            );
            assert!(saved > 0.2, "{} of {} planes", fewer.stats.planes, even.stats.planes);
            assert!(agreement.same_percent() >= 90.0, "{agreement}");
            assert_eq!(fewer.stats.planes_full, even.stats.planes);
        }
    }
}

/// Cameras at every limit that [`planecast::cpu::renderer::check`] allows.
fn extreme_camera() -> impl Strategy<Value = Camera> {
    let around = |limit: f64| {
        let whole = prop_oneof![3 => -20i32..60, 1 => Just(0), 1 => Just(32)].prop_map(f64::from);
        (whole, 0..6u32, -1.0..1.0, any::<bool>()).prop_map(move |(whole, kind, fract, far)| {
            let v = match kind {
                0 => whole,
                1 => whole.next_up(),
                2 => whole.next_down(),
                3 => whole + 0.5,
                _ => whole + fract,
            };
            if far && kind > 3 { fract * limit } else { v }
        })
    };
    let near = |v: f64| prop_oneof![Just(v), Just(v + 1e-8), Just(v - 1e-8), Just(v + 0.1), Just(v - 1e-3)];
    let yaw = prop_oneof![0.0..360.0, (0..8).prop_flat_map(move |k| near(f64::from(k) * 45.0))];
    let pitch = prop_oneof![
        -90.0..90.0,
        (-2..=2).prop_flat_map(move |k| near(f64::from(k) * 45.0)).prop_map(|v| f64::clamp(v, -90.0, 90.0))
    ];
    let roll = prop_oneof![Just(0.0), -180.0..180.0, (-4..=4).prop_flat_map(move |k| near(f64::from(k) * 45.0))];
    let fov = prop_oneof![Just(0.01), Just(179.0), Just(1e-9), Just(90.0), 0.01..179.0];
    let size = prop_oneof![
        Just([1, 1]),
        Just([1, 2048]),
        Just([2048, 1]),
        Just([2, 2]),
        Just([33, 31]),
        Just([64, 48]),
        Just([128, 2])
    ];
    let eye = (around(f64::from(1 << 29)), around(f64::from(1 << 29)), around(f64::from(1 << 29)));
    (eye, yaw, pitch, roll, fov, size).prop_map(|((x, y, z), yaw, pitch, roll, fov, [width, height])| Camera {
        eye: DVec3::new(x, y, z),
        yaw,
        pitch,
        roll,
        fov,
        width,
        height,
    })
}

fn any_options() -> impl Strategy<Value = Options> {
    let repeat = prop_oneof![2 => Just([false; 2]), 1 => Just([true, false]), 1 => Just([true; 2])];
    let planes = prop_oneof![
        4 => Just(Planes::Auto),
        1 => Just(Planes::Factor(0.3)),
        1 => Just(Planes::Factor(3.0)),
        1 => (1..60u32).prop_map(Planes::Count)
    ];
    let lod = prop_oneof![Just(None), Just(Some(1.0)), Just(Some(1e-6)), Just(Some(1e6))];
    let far = prop_oneof![Just(f64::INFINITY), Just(1e-3), Just(300.0), Just(1e7)];
    let switches = (any::<bool>(), any::<bool>(), any::<bool>(), any::<bool>());
    (repeat, planes, lod, far, switches, prop_oneof![Just(None), Just(Some(0.0)), Just(Some(30.0))]).prop_map(
        |([x, z], planes, lod, far, (readjust, gap_fill, retest, all), equidistant)| Options {
            view_distance: if x || z { f64::min(far, 3000.0) } else { far },
            repeat: Repeat { x, z },
            planes,
            lod,
            readjust,
            gap_fill,
            equidistant,
            remap: if retest { Remap::Refine } else { Remap::Nearest },
            culling: if all { Culling::ALL } else { Culling::NONE },
            f64_traversal: gap_fill,
            ssao_samples: if all { 64 } else { 1 },
            fog: readjust.then_some(100.0),
            ..Options::default()
        },
    )
}

#[test]
fn extreme_cameras_draw_whole_frames() {
    let worlds = worlds();
    check(600, (0..worlds.len(), extreme_camera(), any_options()), |(w, camera, options)| {
        let frame = worlds[w].render(&camera, &options);
        sane(&frame).map_err(|text| TestCaseError::fail(format!("{}: {text}", worlds[w].name)))?;
        let exact = worlds[w].exact(&camera, &Options { view_distance: options.view_distance.min(1000.0), ..options });
        sane(&exact).map_err(|text| TestCaseError::fail(format!("{} exact: {text}", worlds[w].name)))
    });
}

#[test]
fn repeated_world_is_the_same_from_10_to_the_9_away() {
    let world = odd();
    let options = Options { repeat: BOTH, view_distance: 200.0, ..plain() };
    let camera = common::camera(DVec3::new(20.25, 39.5, 30.75), [40.0, -25.0, 3.0], [80, 60]);
    let near = world.render(&camera, &options);
    let far = |k: i32| k * (1_000_000_000 / k.abs() / 77 / 53) * 77 * 53;
    for (dx, dz) in [(far(1), far(-1)), (far(-2), far(1))] {
        let eye = camera.eye + DVec3::new(f64::from(dx), 0.0, f64::from(dz));
        let moved = with_voxels(&near, |[x, y, z, l]| [x + dx, y, z + dz, l]);
        assert_eq!(identical(&world.render(&Camera { eye, ..camera }, &options), &moved), Ok(()));
    }
}

#[test]
fn check_refuses_what_cannot_be_drawn() {
    let columns = Columns::empty(4, 4, 4);
    let input = Input { columns, colors: planecast_encoder::Colors::None, notes: Vec::new() };
    let scene: Arc<Scene> = Arc::new(build(input, &BuildOptions::default()).unwrap());
    let resident = Arc::new(planecast::Resident::new(&scene));
    let mut renderer = planecast::CpuRenderer::new(&scene, &resident);
    let good = common::camera(DVec3::ZERO, [0.0; 3], [8, 8]);
    let mut refused = |camera: Camera, options: Options| {
        let text = renderer.render(&camera, &options, Outputs::default()).unwrap_err().to_string();
        assert_eq!(renderer.exact(&camera, &options, Outputs::default()).unwrap_err().to_string(), text);
        text
    };
    let options = Options::default();
    for fov in [0.0, 180.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(refused(Camera { fov, ..good }, options).contains("must be above 0 and below 180"));
    }
    for pitch in [90.1, -91.0, f64::NAN] {
        assert!(refused(Camera { pitch, ..good }, options).contains("pitch from -90 to 90"));
    }
    assert!(refused(Camera { yaw: f64::INFINITY, ..good }, options).contains("must be finite"));
    assert!(refused(Camera { roll: f64::NAN, ..good }, options).contains("must be finite"));
    assert!(refused(Camera { width: 0, ..good }, options).contains("at least 1"));
    assert!(refused(Camera { width: 1 << 20, height: 1 << 20, ..good }, options).contains("at most 268435456 pixels"));
    for eye in [DVec3::new(2e9, 0.0, 0.0), DVec3::new(0.0, -2e9, 0.0), DVec3::new(0.0, 0.0, f64::NAN)] {
        assert!(refused(Camera { eye, ..good }, options).contains("must be within"));
    }
    for planes in [Planes::Count(0), Planes::Count(2_000_000), Planes::Factor(0.0), Planes::Factor(f64::NAN)] {
        assert!(refused(good, Options { planes, ..options }).contains("must be"));
    }
    assert!(refused(good, Options { view_distance: f64::NAN, ..options }).contains("view distance NaN"));
    assert!(refused(good, Options { lod: Some(0.0), ..options }).contains("level of detail"));
}
