//! Planes against one ray a pixel, and that against brute force. Figures: `cargo test --release --test against_exact --
//! --nocapture`.

mod common;

use common::compare::{Agreement, compare, sane};
use common::{
    Kind, MEDIUM, Pose, Random, World, blocks, caves, hills, noisy, odd, plain, poses, rocks, room, rough, sheets,
    single_things, sponge, staircase, wide_poses,
};
use glam::DVec3;
use planecast::cpu::exact::cast;
use planecast::{Camera, Frame, Options, Planes, Projection, Remap, Repeat};
use planecast_encoder::Columns;

const SIZE: [u32; 2] = [300, 240];

/// Least share of pixels with the same voxel, and of those with it within one pixel, in percent: what is promised of any
/// world.
fn bounds(kind: Kind) -> [f64; 2] {
    match kind {
        Kind::Level => [99.8, 99.8],
        Kind::Turned => [95.0, 99.5],
        Kind::Far => [90.0, 97.0],
    }
}

/// The same as the standing poses reach it, but for a little.
fn reached(kind: Kind) -> [f64; 2] {
    match kind {
        Kind::Level => [99.99, 99.99],
        Kind::Turned => [99.5, 99.95],
        Kind::Far => [99.8, 99.9],
    }
}

fn check(worlds: &[World], options: &Options, size: [u32; 2]) {
    let mut below = Vec::new();
    let mut total: [Agreement; 3] = Default::default();
    for world in worlds {
        for pose in poses(world, size) {
            let (frame, exact) = (world.render(&pose.camera, options), world.exact(&pose.camera, options));
            let agreement = compare(&frame, &exact);
            let line = format!("{:16} {:48} {agreement}", world.name, pose.name);
            println!("{line}");
            assert_eq!(sane(&frame), Ok(()), "{line}");
            assert_eq!(sane(&exact), Ok(()), "{line}");
            let [same, near] = reached(pose.kind);
            if agreement.same_percent() < same || agreement.near_percent() < near || agreement.depth > 1e-3 {
                below.push(format!("{line}  (at least {same} and {near}, depth 1e-3)"));
            }
            let sum = &mut total[pose.kind as usize];
            sum.pixels += agreement.pixels;
            sum.same += agreement.same;
            sum.near += agreement.near;
            sum.sky += agreement.sky;
            sum.depth = sum.depth.max(agreement.depth);
        }
    }
    for (kind, sum) in [Kind::Level, Kind::Turned, Kind::Far].iter().zip(total) {
        println!("all {:60} {sum}", format!("{kind:?}"));
    }
    assert!(below.is_empty(), "{} poses are beyond their bounds:\n{}", below.len(), below.join("\n"));
}

#[test]
fn planes_show_the_voxels_of_exact() {
    check(&[hills(MEDIUM), caves(), rocks()], &plain(), SIZE);
}

#[test]
fn planes_a_pixel_apart_show_the_voxels_of_exact() {
    check(&[hills(MEDIUM), caves()], &Options { readjust: false, ..plain() }, SIZE);
}

#[test]
fn planes_show_thin_and_regular_things_as_exact_does() {
    check(&[staircase(), sheets(), odd(), room()], &plain(), SIZE);
}

/// How wide a voxel is in the middle one of the pixels that show any, in pixels.
fn voxel_width(camera: &Camera, exact: &Frame) -> f64 {
    let mut depth: Vec<f32> = exact.depth.iter().copied().filter(|d| d.is_finite()).collect();
    depth.sort_by(f32::total_cmp);
    depth.get(depth.len() / 2).map_or(f64::INFINITY, |&d| camera.focal() / f64::from(d))
}

/// Hundreds of poses in worlds smooth and without any order, the worst first: all within what is promised.
#[test]
#[ignore = "takes a minute: cargo test --release --test against_exact -- --ignored --nocapture"]
fn planes_show_the_voxels_of_exact_in_a_wide_sweep() {
    let worlds = [hills(MEDIUM), rough(), noisy(), caves(), blocks(), sponge(), single_things(), rocks()];
    let mut rows = Vec::new();
    let mut below = 0;
    for world in &worlds {
        for Pose { name, kind, camera } in wide_poses(world, SIZE) {
            let (frame, exact) = (world.render(&camera, &plain()), world.exact(&camera, &plain()));
            let (agreement, back) = (compare(&frame, &exact), compare(&exact, &frame));
            let width = voxel_width(&camera, &exact);
            let kind = match kind {
                Kind::Level => Kind::Level,
                _ if width < 2.0 => Kind::Far,
                _ => Kind::Turned,
            };
            let [same, near] = bounds(kind);
            let falls = agreement.same_percent() < same || agreement.near_percent() < near;
            below += usize::from(falls);
            let row = format!(
                "{:14} {name:44} {width:6.2} px {kind:?} {agreement}  back {:7.3} %  {}",
                world.name,
                back.near_percent(),
                if falls { "below" } else { "" },
            );
            rows.push((agreement.near_percent(), row));
        }
    }
    rows.sort_by(|a, b| a.0.total_cmp(&b.0));
    rows.iter().for_each(|(_, row)| println!("{row}"));
    println!("{} poses, {below} below their bounds", rows.len());
    assert_eq!(below, 0, "poses below their bounds");
}

/// Figures of the other ways to remap: what retest and planes twice as close gain.
#[test]
fn retest_and_more_planes_come_nearer_to_exact() {
    let worlds = [hills(MEDIUM), caves(), sheets()];
    let mut same = Vec::new();
    for (name, options) in [
        ("nearest, half the planes", Options { planes: Planes::Factor(0.5), remap: Remap::Nearest, ..plain() }),
        ("nearest", Options { remap: Remap::Nearest, ..plain() }),
        ("retest", Options { remap: Remap::Retest, ..plain() }),
        ("retest, twice the planes", Options { remap: Remap::Retest, planes: Planes::Factor(2.0), ..plain() }),
        ("refine, half the planes", Options { planes: Planes::Factor(0.5), ..plain() }),
        ("refine", plain()),
        ("refine, twice the planes", Options { planes: Planes::Factor(2.0), ..plain() }),
    ] {
        let mut sum = Agreement::default();
        for world in &worlds {
            for pose in poses(world, [150, 120]).iter().filter(|p| p.kind != Kind::Level) {
                let agreement = compare(&world.render(&pose.camera, &options), &world.exact(&pose.camera, &options));
                sum.pixels += agreement.pixels;
                sum.same += agreement.same;
                sum.near += agreement.near;
                sum.sky += agreement.sky;
            }
        }
        println!("{name:28} {sum}");
        same.push(sum.same);
    }
    assert!(same.is_sorted(), "{same:?} of as many pixels");
}

/// A fault of the planes that the bounds must catch: the picture stands one pixel too far to the left.
#[test]
fn bounds_catch_planes_beside_their_place() {
    let world = hills(MEDIUM);
    let mut caught = 0;
    let poses = poses(&world, SIZE);
    for pose in &poses {
        let mut beside = pose.camera;
        let e = 2.0 * beside.half_extent().x / f64::from(beside.width);
        beside.yaw += e.atan().to_degrees();
        let agreement = compare(&world.render(&beside, &plain()), &world.exact(&pose.camera, &plain()));
        let [same, near] = reached(pose.kind);
        caught += usize::from(agreement.same_percent() < same || agreement.near_percent() < near);
    }
    assert!(caught * 2 > poses.len(), "{caught} of {} poses", poses.len());
}

/// With levels, a pixel's cell holds the voxel that exact shows there or in a pixel around.
#[test]
fn levels_show_cells_that_hold_the_voxels_of_exact() {
    for world in [hills(MEDIUM), caves(), odd()] {
        for pose in poses(&world, [150, 120]) {
            let options = Options { lod: Some(1.0), ..plain() };
            let (frame, exact) = (world.render(&pose.camera, &options), world.exact(&pose.camera, &options));
            let holds = |i: usize, j: usize| {
                let (cell, voxel) = (frame.voxel[i], exact.voxel[j]);
                if cell[3] < 0 || voxel[3] < 0 {
                    return cell == voxel;
                }
                // A coarse cell is solid where any of its voxels is, so it may show up to a cell further out.
                let n = 1 << cell[3];
                let margin = if n > 1 { n } else { 0 };
                (0..3).all(|k| (cell[k] - margin..cell[k] + n + margin).contains(&voxel[k]))
            };
            let around = |i: usize| {
                let (x, y) = (i % 150, i / 150);
                let near = |v: usize, n: usize| v.saturating_sub(1)..(v + 2).min(n);
                near(y, 120).any(|y| near(x, 150).any(|x| holds(i, y * 150 + x)))
            };
            let n = (0..frame.voxel.len()).filter(|&i| around(i)).count();
            let percent = 100.0 * n as f64 / frame.voxel.len() as f64;
            let coarse = frame.voxel.iter().filter(|v| v[3] > 0).count();
            println!("{:16} {:48} {percent:.3} %  coarse {coarse}", world.name, pose.name);
            let least = if pose.kind == Kind::Far { 90.0 } else { 97.0 };
            assert!(percent > least, "{} {}: {percent} %", world.name, pose.name);
        }
    }
}

/// Edges and corners that a ray touches for less than this may count or not.
const TOUCH: f64 = 1e-9;

/// The entries of a ray into every voxel of a world, from each voxel's six faces: `(near, far, voxel)`.
fn boxes(columns: &Columns, eye: DVec3, dir: DVec3) -> Vec<(f64, f64, [i64; 3])> {
    let mut met = Vec::new();
    let [nx, ny, nz] = columns.dims().map(i64::from);
    for (x, y, z) in (0..nx).flat_map(|x| (0..ny).flat_map(move |y| (0..nz).map(move |z| (x, y, z)))) {
        if !columns.solid(x, y, z) {
            continue;
        }
        let (mut near, mut far) = (0.0f64, f64::INFINITY);
        for (axis, v) in [x, y, z].into_iter().enumerate() {
            let (from, to) = (v as f64 - eye[axis], v as f64 + 1.0 - eye[axis]);
            if dir[axis] == 0.0 {
                if from > 0.0 || to <= 0.0 {
                    far = f64::NEG_INFINITY;
                }
                continue;
            }
            let (a, b) = (from / dir[axis], to / dir[axis]);
            near = near.max(a.min(b));
            far = far.min(a.max(b));
        }
        // A rounding's width over: what is only touched is for the caller to judge.
        if near <= far + TOUCH {
            met.push((near, far, [x, y, z]));
        }
    }
    met
}

/// Compares one ray of `exact` with all voxels of the world; what is wrong, if anything is.
fn disagrees(columns: &Columns, eye: DVec3, dir: DVec3, hit: Option<([i64; 3], f64)>) -> Option<String> {
    let met = boxes(columns, eye, dir);
    let first = met.iter().filter(|b| b.1 - b.0 > TOUCH).map(|b| b.0).fold(f64::INFINITY, f64::min);
    match hit {
        None => (first < f64::INFINITY).then(|| format!("nothing, but a voxel is met at {first}")),
        Some((voxel, t)) => match met.iter().find(|b| b.2 == voxel) {
            None => Some(format!("{voxel:?}, which the ray does not meet")),
            Some(b) if (b.0 - t).abs() > TOUCH * (1.0 + t) => Some(format!("{voxel:?} at {t}, not at {}", b.0)),
            Some(_) => (first < t - TOUCH * (1.0 + t)).then(|| format!("{voxel:?} at {t}, but one is met at {first}")),
        },
    }
}

/// Worlds of a few voxels, one the size of a single column.
fn tiny() -> Vec<World> {
    let share = |dims, percent: u32| {
        World::new("tiny", dims, move |x, y, z| common::hash(percent, [x as i32, y as i32, z as i32]) % 100 < percent)
    };
    vec![share([7, 6, 5], 5), share([5, 9, 8], 30), share([6, 6, 6], 70), share([1, 12, 1], 40), share([9, 1, 3], 50)]
}

/// Eyes and directions: at random, on grid lines and planes, along axes and diagonals, one ulp beside them.
fn tricky_rays(world: &World, n: usize) -> Vec<(DVec3, DVec3)> {
    let mut random = Random::new(11);
    let dims = world.dims().map(f64::from);
    let on_grid = [0.0, 0.5, 1.0, 1e-9, -1e-9, f64::EPSILON];
    let component = [0.0, -0.0, 1.0, -1.0, 0.5, 1e-7, -1e-7, 1e-300];
    let mut rays = Vec::new();
    while rays.len() < n {
        let mut eye = DVec3::ZERO;
        let mut dir = DVec3::ZERO;
        let (grid, axis) = (random.word().is_multiple_of(2), random.word().is_multiple_of(2));
        for k in 0..3 {
            let v = random.within(-0.7, 1.7) * dims[k];
            eye[k] = if grid { v.floor() + random.choose(&on_grid) } else { v };
            dir[k] = if axis { random.choose(&component) } else { random.within(-1.0, 1.0) };
        }
        if dir != DVec3::ZERO && !world.buries(eye) {
            // At length 1, so that parameters are distances.
            rays.push((eye, dir.normalize()));
        }
    }
    rays
}

#[test]
fn exact_agrees_with_every_voxel_tested_by_itself() {
    for world in tiny() {
        let columns = &world.scene.levels[0].solid;
        let mut hits = 0;
        for (eye, dir) in tricky_rays(&world, 6000) {
            let hit = cast(columns, [false; 2], eye, dir, f64::INFINITY).map(|h| (h.voxel, h.t));
            hits += u32::from(hit.is_some());
            let fault = disagrees(columns, eye, dir, hit);
            assert_eq!(fault, None, "{:?}: eye {eye:?} along {dir:?}", world.dims());
        }
        assert!((100..5900).contains(&hits), "{hits} hits of 6000 say little");
    }
}

#[test]
fn brute_force_catches_a_wrong_voxel_depth_and_miss() {
    let world = &tiny()[1];
    let columns = &world.scene.levels[0].solid;
    let (eye, dir, hit) = tricky_rays(world, 500)
        .into_iter()
        .find_map(|(eye, dir)| Some((eye, dir, cast(columns, [false; 2], eye, dir, f64::INFINITY)?)))
        .expect("a ray that hits");
    let [x, y, z] = hit.voxel;
    let fault = |hit| disagrees(columns, eye, dir, hit).expect("a fault");
    assert!(fault(Some(([x + 90, y, z], hit.t))).contains("does not meet"));
    assert!(fault(Some((hit.voxel, hit.t + 1e-6))).contains("not at"));
    assert!(fault(None).starts_with("nothing, but"));
    let behind = boxes(columns, eye, dir).into_iter().find(|b| b.0 > hit.t + 1e-3);
    if let Some((t, _, voxel)) = behind {
        assert!(fault(Some((voxel, t))).contains("but one is met at"));
    }
}

/// A repeated world is the same as copies of it side by side.
#[test]
fn exact_repeats_a_world_as_copies_of_it() {
    let world = &tiny()[1];
    let [nx, ny, nz] = world.dims();
    let one = &world.scene.levels[0].solid;
    let copies = Columns::from_fn(7 * nx, ny, 5 * nz, |x, y, z| one.find(x % nx, y, z % nz).is_some());
    let mut random = Random::new(3);
    let shift = DVec3::new(f64::from(3 * nx), 0.0, f64::from(2 * nz));
    for _ in 0..2000 {
        let eye = DVec3::new(random.within(0.0, 5.0), random.within(-2.0, 14.0), random.within(0.0, 8.0));
        let dir = DVec3::from_array(std::array::from_fn(|_| random.within(-1.0, 1.0)));
        let t_max = 14.0 / dir.x.hypot(dir.z);
        let a = cast(one, [true; 2], eye, dir, t_max);
        let b = cast(&copies, [false; 2], eye + shift, dir, t_max);
        let [dx, dz] = [i64::from(3 * nx), i64::from(2 * nz)];
        assert_eq!(
            a.map(|h| ([h.voxel[0] + dx, h.voxel[1], h.voxel[2] + dz], h.face)),
            b.map(|h| (h.voxel, h.face)),
            "eye {eye:?} along {dir:?}"
        );
    }
}

/// A pose anywhere in the room's air.
fn random_pose(random: &mut Random, room: &World) -> Camera {
    let [nx, ny, nz] = room.dims().map(f64::from);
    loop {
        let mut eye =
            DVec3::new(random.within(1.0, nx - 1.0), random.within(1.0, ny - 1.0), random.within(1.0, nz - 1.0));
        // Also on grid lines.
        if random.word().is_multiple_of(5) {
            eye = eye.floor();
        }
        let (any_pitch, tiny_pitch) = (random.within(-90.0, 90.0), random.within(-1e-6, 1e-6));
        let pitch = random.choose(&[any_pitch, any_pitch, tiny_pitch, 90.0, -90.0, 0.0]);
        let any_roll = random.within(-180.0, 180.0);
        let roll = random.choose(&[any_roll, any_roll, 0.0, 45.0, 90.0, 1e-7]);
        let [width, height] = random.choose(&[[64, 48], [47, 63], [33, 33], [120, 5]]);
        let (yaw, fov) = (random.within(0.0, 360.0), random.within(10.0, 120.0));
        if !room.buries(eye) {
            return Camera { eye, yaw, pitch, roll, fov, width, height };
        }
    }
}

#[test]
fn closed_room_shows_no_sky() {
    let room = room();
    let mut random = Random::new(1);
    for k in 0..800 {
        let camera = random_pose(&mut random, &room);
        let mut options = [plain(), Options { lod: Some(1.0), ..plain() }][k % 2];
        options.remap = Remap::ALL[k / 2 % 3];
        options.readjust = k / 6 % 2 == 1;
        options.planes = [Planes::Auto, Planes::Auto, Planes::Factor(0.5), Planes::Factor(2.0)][k / 12 % 4];
        let frame = room.render(&camera, &options);
        let sky = frame.voxel.iter().filter(|v| v[3] < 0).count();
        assert_eq!(sky, 0, "pose {k}: pixels of sky, {camera:?} {options:?}");
        assert_eq!(sane(&frame), Ok(()), "pose {k}: {camera:?}");
    }
}

#[test]
fn open_room_shows_sky() {
    let room = room();
    let hole = World::new("room with a hole", room.dims(), |x, y, z| {
        room.scene.levels[0].solid.find(x, y, z).is_some() && [x, y, z] != [0, 8, 10]
    });
    let camera = common::camera(DVec3::new(12.5, 8.5, 10.5), [270.0, 0.0, 0.0], [64, 48]);
    assert!(hole.render(&camera, &plain()).voxel.contains(&[-1; 4]), "one missing voxel is seen");
    assert!(!room.render(&camera, &plain()).voxel.contains(&[-1; 4]));
}

/// Each pixel's depth is where its own ray enters the voxel that it shows, if it meets it at all.
#[test]
fn depth_is_where_the_ray_enters_the_voxel_shown() {
    for world in [hills(MEDIUM), caves(), sheets()] {
        for pose in poses(&world, [150, 120]) {
            let frame = world.render(&pose.camera, &plain());
            let basis = pose.camera.basis();
            let (mut met, mut shown) = (0, 0);
            for (i, voxel) in frame.voxel.iter().enumerate().filter(|(_, v)| v[3] == 0) {
                shown += 1;
                let ray = pose.camera.ray(&basis, (i % 150) as f64 + 0.5, (i / 150) as f64 + 0.5);
                let (mut near, mut far) = (0.0f64, f64::INFINITY);
                for k in 0..3 {
                    let from = f64::from(voxel[k]) - pose.camera.eye[k];
                    let (a, b) = (from / ray[k], (from + 1.0) / ray[k]);
                    near = near.max(a.min(b));
                    far = far.min(a.max(b));
                }
                // Rays along grid planes give NaN, which min and max pass over.
                if near < far * (1.0 - 1e-5) {
                    met += 1;
                    let depth = f64::from(frame.depth[i]);
                    assert!((depth - near).abs() <= 1e-3 * near, "{} pixel {i}: {depth}, not {near}", pose.name);
                }
            }
            assert!(100 * met >= 90 * shown, "{}: {met} of {shown} rays meet their voxel", pose.name);
        }
    }
}

/// Repeated worlds whose extents no level divides, and ones that some levels divide.
#[test]
fn repeated_worlds_of_any_size_agree_with_exact() {
    for dims in [[77, 40, 53], [96, 40, 36], [64, 40, 1], [3, 40, 5]] {
        let world = World::new("odd", dims, |x, y, z| y < 6 + common::hash(1, [x as i32 / 2, 0, z as i32 / 2]) % 9);
        let eye = DVec3::new(1000.4, 22.0, -700.7);
        let repeat = Repeat { x: true, z: true };
        for turn in [[25.0, 0.0, 0.0], [300.0, -30.0, 0.0], [100.0, -75.0, 20.0]] {
            let camera = common::camera(eye, turn, [150, 120]);
            let options = Options { repeat, view_distance: 150.0, ..plain() };
            let agreement = compare(&world.render(&camera, &options), &world.exact(&camera, &options));
            let [same, near] = bounds(if turn[1] == 0.0 { Kind::Level } else { Kind::Far });
            assert!(
                agreement.same_percent() >= same && agreement.near_percent() >= near,
                "{dims:?} {turn:?} {agreement}"
            );
            // With levels: only those whose cells fit the period, and the ground stays closed.
            let levels = world.render(&camera, &Options { lod: Some(1.0), ..options });
            let fits = |n: u32| n.trailing_zeros();
            assert_eq!(levels.stats.levels_drawn, 1 + fits(dims[0]).min(fits(dims[2])).min(levels.stats.levels - 1));
            let exact = world.exact(&camera, &options);
            let sky = compare(&levels, &exact).sky as f64 / 18_000.0;
            assert!(sky < 0.005, "{dims:?} {turn:?}: {sky} of the pixels");
        }
    }
}

/// Percent of the pixels of all turned poses whose voxel is not that of `exact`.
fn wrong(world: &World, options: &Options) -> f64 {
    let mut sum = Agreement::default();
    for pose in poses(world, SIZE).into_iter().filter(|p| p.kind == Kind::Turned) {
        let agreement = compare(&world.render(&pose.camera, options), &world.exact(&pose.camera, options));
        sum.pixels += agreement.pixels;
        sum.same += agreement.same;
    }
    100.0 - sum.same_percent()
}

#[test]
fn samples_that_are_few_show_fewer_of_the_voxels_of_exact() {
    let world = rocks();
    for remap in Remap::ALL {
        let of = |samples: f64| wrong(&world, &Options { samples, remap, ..plain() });
        let [few, usual, three] = [0.4, 1.0, 3.0].map(of);
        println!("{remap:?}: 40 % {few:.2}, 100 % {usual:.2}, 300 % {three:.2} % of pixels");
        assert!(few > 1.5 * usual, "{remap:?} {few} {usual}");
        // Every third sample stands where a pixel's own does; the others are there to be looked at again.
        match remap {
            Remap::Nearest => assert!((usual - three).abs() < 0.02, "{usual} {three}"),
            Remap::Retest | Remap::Refine => assert!(three < 1.1 * usual, "{usual} {three}"),
        }
    }
}

#[test]
fn samples_of_any_number_leave_no_pixel_open() {
    let (world, mut random) = (room(), Random::new(5));
    let [nx, ny, nz] = world.dims().map(f64::from);
    for k in 0..120 {
        let eye = DVec3::new(nx * random.within(0.3, 0.7), ny * random.within(0.3, 0.7), nz * random.within(0.3, 0.7));
        let camera = Camera {
            eye,
            yaw: random.within(0.0, 360.0),
            pitch: [90.0, -90.0, random.within(-90.0, 90.0)][k % 3],
            roll: [0.0, random.within(0.0, 360.0)][k % 2],
            fov: random.within(20.0, 120.0),
            width: 61,
            height: 47,
        };
        if world.buries(eye) {
            continue;
        }
        let samples = [0.02, 0.37, 0.99, 1.01, 1.6, 7.9][k % 6];
        let remap = Remap::ALL[k / 6 % 3];
        let frame = world.render(&camera, &Options { samples, remap, ..plain() });
        assert_eq!(sane(&frame), Ok(()));
        let open = frame.depth.iter().filter(|d| d.is_infinite()).count();
        assert_eq!(open, 0, "{samples} samples a pixel, {remap:?}, {camera:?}");
    }
}

/// Poses that are level, tilted, and along the poles.
fn standing(world: &World) -> Vec<Camera> {
    let [nx, _, nz] = world.dims().map(f64::from);
    let over = world.over(nx * 0.4 + 0.3, nz * 0.55 + 0.2, 9.7);
    let beside = DVec3::new(-20.3, 40.6, nz * 0.5 + 0.1);
    let camera = |eye, yaw, pitch, roll| Camera { eye, yaw, pitch, roll, ..Camera::default() };
    vec![
        camera(over, 0.0, 0.0, 0.0),
        camera(over, 77.0, -31.0, 12.0),
        camera(over, 10.0, 90.0, 0.0),
        camera(beside, 120.0, -90.0, 30.0),
    ]
}

const PROJECTIONS: [(Projection, f64, [u32; 2]); 5] = [
    (Projection::Equirect, 60.0, [640, 320]),
    (Projection::Cube, 60.0, [480, 320]),
    (Projection::Fisheye, 200.0, [350, 330]),
    (Projection::Lidar { channels: 64, steps: 600 }, 70.0, [600, 64]),
    (Projection::Lidar { channels: 1, steps: 90 }, 0.0, [90, 1]),
];

#[test]
fn projections_show_the_voxels_of_exact() {
    let mut below = Vec::new();
    for world in [hills(MEDIUM), caves(), rocks(), blocks(), odd()] {
        for (projection, fov, [width, height]) in PROJECTIONS {
            let mut sum = Agreement::default();
            for camera in standing(&world) {
                let camera = Camera { fov, width, height, ..camera };
                let options = Options { projection, ..plain() };
                let (frame, exact) = (world.render(&camera, &options), world.exact(&camera, &options));
                assert_eq!(sane(&frame), Ok(()), "{} {projection} {camera:?}", world.name);
                let agreement = compare(&frame, &exact);
                // Of 90 beams one is more than a hundredth.
                let few = width * height < 1000;
                if agreement.depth > 1e-3 || agreement.same_percent() < if few { 96.0 } else { 99.0 } {
                    below.push(format!("{} {projection} {camera:?}: {agreement}", world.name));
                }
                sum.pixels += agreement.pixels;
                sum.same += agreement.same;
            }
            println!("{:32} {projection:24} {:.3} % the same", world.name, sum.same_percent());
            if sum.same_percent() < if width * height < 1000 { 99.0 } else { 99.9 } {
                below.push(format!("{} {projection}: {:.3} %", world.name, sum.same_percent()));
            }
        }
    }
    assert!(below.is_empty(), "{}", below.join("\n"));
}

#[test]
fn projections_of_extreme_worlds_show_the_voxels_of_exact() {
    let column = World::new("one column", [1, 20, 1], |_, y, _| y < 9 || y == 14);
    let line = World::new("one line", [1, 12, 60], |_, y, z| y < 2 + z % 7);
    let deep = hills(MEDIUM);
    let buried = DVec3::new(64.5, 1.5, 64.5);
    assert!(deep.buries(buried));
    for (projection, fov, [width, height]) in PROJECTIONS {
        let options = Options { projection, ..plain() };
        for (world, eye) in [
            (&column, DVec3::new(0.5, 11.2, 0.5)),
            (&column, DVec3::new(4.25, 30.0, -6.5)),
            (&line, DVec3::new(0.5, 15.0, 30.5)),
            // On a grid line, above the world and far away.
            (&line, DVec3::new(0.0, 20.0, 30.0)),
            (&line, DVec3::new(3000.5, 20.0, 30.0)),
        ] {
            let camera = Camera { eye, fov, width, height, ..Camera::default() };
            let (frame, exact) = (world.render(&camera, &options), world.exact(&camera, &options));
            assert_eq!(sane(&frame), Ok(()));
            let agreement = compare(&frame, &exact);
            assert!(
                agreement.same_percent() >= 99.5 && agreement.depth < 1e-3,
                "{} {projection} {eye}: {agreement}",
                world.name
            );
        }
        let camera = Camera { eye: buried, fov, width, height, ..Camera::default() };
        for frame in [deep.render(&camera, &options), deep.exact(&camera, &options)] {
            assert!(
                frame.depth.iter().all(|&d| d == 0.0) && frame.voxel.iter().all(|&v| v == [64, 1, 64, 0]),
                "{projection}"
            );
        }
    }
}

/// A picture of parallel rays from straight above is a map: pixel (x, z) shows the top of column (x, z).
#[test]
fn ortho_from_above_is_a_map() {
    let world = hills(MEDIUM);
    let [nx, ny, nz] = world.dims();
    let eye = DVec3::new(f64::from(nx) / 2.0, f64::from(ny) + 7.0, f64::from(nz) / 2.0);
    let camera = Camera { eye, pitch: -90.0, width: nx, height: nz, ..Camera::default() };
    let options = Options { projection: Projection::Ortho { height: Some(nz.into()) }, ..plain() };
    for frame in [world.render(&camera, &options), world.exact(&camera, &options)] {
        for (i, (voxel, depth)) in frame.voxel.iter().zip(&frame.depth).enumerate() {
            let (x, z) = (i as u32 % nx, i as u32 / nx);
            let top = world.scene.levels[0].solid.column(x, z).last().unwrap().end();
            assert_eq!((*voxel, *depth), ([x as i32, top as i32 - 1, z as i32, 0], (ny + 7 - top) as f32));
        }
    }
}

#[test]
fn views_that_turn_at_rest_show_the_voxels_of_exact_and_walk_little() {
    for world in [hills(MEDIUM), caves(), rocks()] {
        let mut cpu = world.renderer();
        cpu.keep_sphere(true);
        let start = Camera { pitch: -12.0, width: 320, height: 240, ..standing(&world)[0] };
        let mut sum = Agreement::default();
        let mut walked = Vec::new();
        let turns = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (2.5, 0.7, 0.0), (2.5, -1.0, 2.0), (4.0, -1.0, 2.0)];
        for (i, (yaw, pitch, roll)) in turns.into_iter().enumerate() {
            let camera = Camera { yaw: start.yaw + yaw, pitch: start.pitch + pitch, roll, ..start };
            let frame = cpu.render(&camera, &plain(), planecast::Outputs { voxel: true }).unwrap();
            assert_eq!(frame.stats.kernel, if i == 0 { "planes" } else { "sphere" });
            walked.push(frame.stats.columns_visited);
            if i > 0 {
                let agreement = compare(&frame, &world.exact(&camera, &plain()));
                assert!(agreement.depth < 1e-3, "{}: {agreement}", world.name);
                sum.pixels += agreement.pixels;
                sum.same += agreement.same;
            }
        }
        println!("{}: {:.3} % the same, columns {walked:?}", world.name, sum.same_percent());
        assert!(sum.same_percent() >= 99.9, "{}: {sum}", world.name);
        assert!(walked[2..].iter().all(|&n| 8 * n <= walked[0]), "{}: {walked:?}", world.name);
        // What moved, or another world's options, is drawn anew.
        let moved = Camera { eye: start.eye + DVec3::new(0.5, 0.0, 0.0), ..start };
        let drawn = cpu.render(&moved, &plain(), planecast::Outputs { voxel: true }).unwrap();
        assert_eq!(common::compare::identical(&drawn, &world.render(&moved, &plain())), Ok(()));
    }
}

#[test]
fn many_pictures_are_those_drawn_one_by_one() {
    let world = hills(MEDIUM);
    let mut cameras: Vec<Camera> = Vec::new();
    for (i, camera) in standing(&world).into_iter().cycle().take(11).enumerate() {
        cameras.push(Camera {
            yaw: camera.yaw + 9.0 * i as f64,
            width: 40 + 7 * i as u32,
            height: 50 + i as u32,
            ..camera
        });
    }
    let mut many =
        planecast::Renderer::with_kernel(&world.scene, &world.resident, planecast::Device::Cpu, None, &mut |_| ())
            .unwrap();
    let options = Options::default();
    let frames = many.draw_many(&cameras, &options).unwrap();
    for (camera, frame) in cameras.iter().zip(&frames) {
        let alone = world.renderer().render(camera, &options, planecast::Outputs::default()).unwrap();
        assert_eq!(common::compare::identical(frame, &alone), Ok(()));
    }
    cameras[5].fov = 190.0;
    let e = many.draw_many(&cameras, &options).unwrap_err().to_string();
    assert!(e.contains("190"), "{e}");
    assert!(many.draw_many(&[], &options).unwrap().is_empty());
}
