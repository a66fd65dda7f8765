//! Every case of the catalogue on every device, within its bounds, the same from run to run; that the runner sees what is out
//! of them; closed worlds from anywhere; and f32 against f64 walks.

use glam::DVec3;
use planecast::cpu::traverse::{PlaneBuffer, traverse};
use planecast::frame::plane_setup::plane_setup;
use planecast::measure::stability::measure::{Truth, cracks, measure, sane};
use planecast::measure::stability::walks::{Walks, walks};
use planecast::measure::stability::{Case, Drawer, Expect, Row, World, WorldName, cases};
use planecast::{Camera, Culling, Frame, Options, Planes, Repeat, Resident, Shading};
use planecast_encoder::{BuildOptions, Colors, Columns, Input, build};
use std::collections::HashMap;
use std::sync::Arc;

/// One for all: renderers that share a device compile each shader once.
#[cfg(feature = "gpu")]
static GPU: std::sync::LazyLock<planecast::gpu::present::Device> =
    std::sync::LazyLock::new(|| planecast::gpu::present::Device::headless().unwrap());

/// All cases world by world, so that each world is made once.
fn by_world() -> Vec<(WorldName, Vec<Case>)> {
    let mut order: Vec<WorldName> = Vec::new();
    let mut sorted: HashMap<WorldName, Vec<Case>> = HashMap::new();
    for case in cases() {
        if !sorted.contains_key(&case.world) {
            order.push(case.world);
        }
        sorted.entry(case.world).or_default().push(case);
    }
    order.into_iter().map(|w| (w, sorted.remove(&w).unwrap())).collect()
}

fn line(row: &Row) -> String {
    format!(
        "{:62} {:10} off {:6.3} of {:5.1} wrong {:6.3} of {:5.1} cracks {} depth {:.1e} steps {:?} of {} moved {:?} ulps {:?}",
        row.case,
        row.device,
        row.off_percent,
        row.bound_off_percent,
        row.wrong_percent,
        row.bound_wrong_percent,
        row.cracks,
        row.depth,
        row.steps,
        row.bound_steps,
        row.moved_percent,
        row.depth_ulps
    )
}

/// Runs every case on the devices that `drawers` gives for a world, and says what is out of its bounds.
fn run(drawers: impl Fn(&World) -> Vec<Drawer<'_>>) -> (Vec<Row>, Vec<String>) {
    let (mut rows, mut faults) = (Vec::new(), Vec::new());
    for (name, cases) in by_world() {
        let world = name.make();
        let mut drawers = drawers(&world);
        for case in &cases {
            let truth = Truth::new(case, &world).unwrap();
            for drawer in &mut drawers {
                let at = std::time::Instant::now();
                let row = measure(case, &world, &truth, drawer).unwrap();
                println!("{} {:.0?}", line(&row), at.elapsed());
                faults.extend(row.faults.iter().map(|f| format!("{}, {}: {f}", row.case, row.kernel)));
                rows.push(row);
            }
        }
    }
    (rows, faults)
}

#[test]
fn every_case_keeps_its_bounds_on_the_cpu() {
    let (_, faults) = run(|world| vec![Drawer::cpu(world), Drawer::cpu_f64(world), Drawer::exact(world)]);
    assert!(faults.is_empty(), "{} faults\n{}", faults.len(), faults.join("\n"));
}

/// Kernel `raycast`, the baseline through a tree of masks, is left out of the catalogue: its bounds there are not known yet, and
/// a tree of its largest worlds takes long to make. It is compared with `exact` in `tests/gpu` and in `cpu::raycast`.
#[cfg(feature = "gpu")]
const KERNELS: [planecast::Kernel; 3] =
    [planecast::Kernel::Invocation, planecast::Kernel::Workgroup, planecast::Kernel::RaycastRuns];

#[cfg(feature = "gpu")]
fn gpu_wanted() -> bool {
    let skip = std::env::var_os("PLANECAST_NO_GPU").is_some_and(|v| v == "1");
    if skip {
        eprintln!("skipped: PLANECAST_NO_GPU=1");
    }
    !skip
}

#[cfg(feature = "gpu")]
#[test]
fn every_case_keeps_its_bounds_on_the_gpu() {
    if !gpu_wanted() {
        return;
    }
    let (rows, faults) = run(|world| KERNELS.map(|k| Drawer::gpu(&GPU, world, k, true).unwrap()).into());
    assert!(faults.is_empty(), "{} faults\n{}", faults.len(), faults.join("\n"));
    // What a device does not draw it refuses with the figure and a way out; that is the rare case.
    let refused: Vec<_> = rows.iter().filter_map(|r| r.refused.as_deref()).collect();
    assert!(refused.iter().all(|text| ["allows", "at most"].iter().any(|w| text.contains(w))), "{refused:?}");
    assert!(refused.iter().all(|text| text.contains("; try ")), "{refused:?}");
    assert!(30 * refused.len() < rows.len(), "{refused:?}");
}

#[cfg(feature = "gpu")]
#[test]
fn walks_of_seconds_are_refused_on_the_gpu() {
    if !gpu_wanted() {
        return;
    }
    let world = WorldName::Floor.make();
    let eye = DVec3::new(16.3, 4.5, 15.7);
    let camera = Camera { eye, yaw: 25.0, pitch: 0.0, roll: 0.0, fov: 60.0, width: 16, height: 9 };
    let inside_solid = Camera { eye: DVec3::new(16.3, 3.5, 15.7), ..camera };
    let repeat = Repeat { x: true, z: true };
    let far = Options { lod: None, repeat, view_distance: 1e9, ..Options::default() };
    for kernel in KERNELS {
        let mut drawer = Drawer::gpu(&GPU, &world, kernel, true).unwrap();
        let inside = (drawer.draw)(&inside_solid, &far).unwrap();
        assert_eq!(inside.stats.kernel, "inside", "an eye in solid walks nothing");
        let tall = Camera { eye: DVec3::new(16.3, 1e7, 15.7), pitch: -60.0, ..camera };
        let text = (drawer.draw)(&tall, &far).unwrap_err().to_string();
        assert!(text.contains("columns along one plane") && text.contains("try levels (--lod 1)"), "{text}");
        // The renderer goes on.
        (drawer.draw)(&camera, &Options { view_distance: 500.0, ..far }).unwrap();
    }
}

/// llvmpipe ends the loops of a lane after 65,535 turns and draws on: such a picture never comes out as a whole one.
#[cfg(feature = "gpu")]
#[test]
fn walks_that_a_software_gpu_cuts_short_are_refused() {
    if !gpu_wanted() {
        return;
    }
    let world = WorldName::Floor.make();
    let above = 1e5;
    let eye = DVec3::new(16.3, 4.0 + above, 15.7);
    let repeat = Repeat { x: true, z: true };
    let options = Options { repeat, view_distance: above, shading: Shading::None, ..Options::default() };
    let mut refused = 0;
    for kernel in KERNELS {
        let mut drawer = Drawer::gpu(&GPU, &world, kernel, true).unwrap();
        for pitch in [-90.0, -89.0, -85.0] {
            let camera = Camera { eye, yaw: 25.0, pitch, roll: 0.0, fov: 30.0, width: 80, height: 60 };
            match (drawer.draw)(&camera, &options) {
                // The floor fills the view.
                Ok(frame) => assert_eq!(cracks(&frame, Expect::Closed), 0, "{} {camera:?}", kernel.name()),
                Err(planecast::Error::Limit(text)) => {
                    println!("{text}");
                    assert!(text.contains("turns") && text.contains("; try ") && text.contains("(65535)"), "{text}");
                    refused += 1;
                }
                Err(e) => panic!("{e}"),
            }
        }
        // The renderer goes on.
        let near = Camera {
            eye: DVec3::new(16.3, 30.0, 15.7),
            yaw: 25.0,
            pitch: -80.0,
            roll: 0.0,
            fov: 30.0,
            width: 80,
            height: 60,
        };
        assert_eq!(cracks(&(drawer.draw)(&near, &options).unwrap(), Expect::Closed), 0);
    }
    println!("{refused} frames are refused");
}

/// What a case says of a drawer that spoils each frame, the n-th it draws, as told.
fn spoiled(spoil: impl Fn(&mut Frame, usize) + 'static) -> Vec<String> {
    let case = cases().into_iter().find(|c| c.name == "pitch -90").unwrap();
    let world = case.world.make();
    let truth = Truth::new(&case, &world).unwrap();
    let Drawer { mut draw, device, kernel, exact } = Drawer::cpu(&world);
    let mut n = 0;
    let draw = Box::new(move |camera: &Camera, options: &Options| {
        let mut frame = draw(camera, options)?;
        spoil(&mut frame, n);
        n += 1;
        Ok(frame)
    });
    measure(&case, &world, &truth, &mut Drawer { device, kernel, exact, draw }).unwrap().faults
}

#[test]
fn runner_sees_every_kind_of_fault() {
    assert_eq!(spoiled(|_, _| {}), Vec::<String>::new());
    let sees = |text: &str, spoil: fn(&mut Frame, usize)| {
        let faults = spoiled(spoil);
        assert!(faults.iter().any(|f| f.contains(text)), "{text}: {faults:?}");
    };
    sees("has depth NaN", |f, _| f.depth[100] = f32::NAN);
    sees("has depth -1", |f, _| f.depth[100] = -1.0);
    sees("at depth inf", |f, _| f.depth[100] = f32::INFINITY);
    sees("has alpha 0", |f, _| f.color[100][3] = 0);
    sees("is not whole", |f, _| f.voxel.clear());
    sees("1 pixels are not Closed", |f, _| (f.voxel[100], f.depth[100]) = ([-1; 4], f32::INFINITY));
    sees("are off", |f, _| f.voxel[..40].fill([3, 17, 5, 0]));
    // A row lower everywhere: within a pixel of what is seen, but not what the pixels' own rays meet.
    sees("show what their own rays do not", |f, _| {
        let w = f.width as usize;
        f.voxel.copy_within(..f.depth.len() - w, w);
    });
    sees("a depth is", |f, _| f.depth[100] *= 1.0001);
    sees("drawn twice, 1 pixels differ", |f, n| f.color[7][0] ^= u8::from(n == 1));
    sees("drawn twice, 0 pixels differ", |f, n| f.depth[7] = f32::from_bits(f.depth[7].to_bits() ^ u32::from(n == 1)));
    sees("one ulp of pitch moves", |f, n| {
        if n == 3 {
            f.voxel[..40].fill([3, 17, 5, 0])
        }
    });
    sees("the frame looks at", |f, _| f.stats.columns_visited = 1 << 40);
}

#[test]
fn f32_walks_differ_from_f64_ones_by_no_more_than_rounding() {
    let walks = walks();
    let all = walks.all();
    println!(
        "{} of {} samples differ, the nearest {:.0} voxels away, by at most {:.0} % of the bound, which lets {} differ, the \
         nearest {:.0} voxels away",
        all.differ,
        all.samples,
        walks.first_does,
        100.0 * walks.worst,
        all.may_differ,
        walks.first_may
    );
    assert!(walks.faults.is_empty(), "{} samples\n{}", walks.faults.len(), walks.faults.join("\n"));
    assert!(all.samples > 500_000 && all.differ > 0, "{all:?}");
    assert!(1_000 * all.differ < all.samples, "{all:?}");
    walks.bins.iter().for_each(|bin| println!("{bin:?}"));
    assert!(walks.bins.iter().all(|bin| bin.differ <= bin.may_differ), "{:?}", walks.bins);
    assert!(walks.first_may <= walks.first_does && walks.first_does.is_finite());
}

#[test]
fn f32_walks_check_catches_a_voxel_beside_its_place() {
    let world = WorldName::Floor.make();
    let eye = DVec3::new(12.3, 25.2, 20.7);
    let camera = Camera { eye, yaw: 33.0, pitch: -20.0, roll: 0.0, fov: 60.0, width: 200, height: 400 };
    let repeat = Repeat { x: true, z: true };
    let options = Options { lod: None, repeat, view_distance: 5_000.0, shading: Shading::None, ..Options::default() };
    let setup = plane_setup(&world.resident, &camera, &options);
    let mut right = PlaneBuffer::default();
    traverse::<f64>(&world.resident, &setup, Culling::ALL, &mut right, true);
    // Each sample shows what the last but one should.
    let plane = &setup.planes[7];
    let samples = plane.base + plane.first as usize..plane.base + plane.end as usize;
    let mut wrong = right.voxel.clone();
    wrong[samples].rotate_right(2);
    let mut walks = Walks { first_may: f64::INFINITY, first_does: f64::INFINITY, ..Walks::default() };
    (plane.first..plane.end).for_each(|j| walks.sample(plane, eye, [&wrong, &right.voxel], j));
    assert!(walks.faults.len() > 8, "{:?}", walks.faults);
    assert!(walks.all().differ as usize >= walks.faults.len());
    let mut walks = Walks::default();
    (plane.first..plane.end).for_each(|j| walks.sample(plane, eye, [&right.voxel, &right.voxel], j));
    assert!(walks.faults.is_empty() && walks.all().differ == 0);
}

/// What the catalogue's level changes claim: the level changes at the wall's very face, and a little decides.
#[test]
fn levels_change_under_a_walls_face_where_the_cases_say() {
    let world = WorldName::Hall.make();
    let cases = cases();
    let shown = |name: &str| {
        let case = cases.iter().find(|c| c.name == format!("{name}, pitch 0")).unwrap();
        let frame = (Drawer::cpu(&world).draw)(&case.camera, &case.options).unwrap();
        // The wall straight ahead.
        let i = (frame.width * (frame.height / 2) + frame.width / 2) as usize;
        (frame.voxel[i], frame.depth[i])
    };
    for level in 1..=2 {
        let of = |what: &str| shown(&format!("level {level} begins {what} a wall's face"));
        let (behind, before) = (of("1e-4 behind"), of("1e-4 before"));
        println!("level {level}: behind {behind:?}, before {before:?}");
        assert_eq!([behind.0[3], before.0[3]], [level - 1, level]);
        for what in ["at", "one ulp behind", "one ulp before", "within"] {
            let (voxel, depth) = of(what);
            assert!([level - 1, level].contains(&voxel[3]), "{what}: {voxel:?}");
            // A level further on the same wall is thicker by no more than its own voxel.
            assert!((depth - behind.1).abs() <= f32::from(1u8 << level), "{what}: {depth}");
        }
    }
}

/// Poses anywhere in the air of a closed world, turned anyhow, through lenses of all kinds.
fn poses_within(world: &World, n: u32, seed: u32) -> Vec<Camera> {
    let mut state = seed;
    let mut next = |from: f64, to: f64| {
        state = state.wrapping_mul(0x0019_660D).wrapping_add(0x3C6E_F35F);
        let h = (state ^ (state >> 15)).wrapping_mul(0x2C1B_3C6D);
        from + (to - from) * f64::from(h ^ (h >> 12)) / f64::from(u32::MAX)
    };
    let solid = &world.scene.levels[0].solid;
    let [nx, ny, nz] = world.name.dims().map(f64::from);
    let mut poses = Vec::new();
    for k in 0.. {
        let mut eye = DVec3::new(next(1.0, nx - 1.0), next(1.0, ny - 1.0), next(1.0, nz - 1.0));
        // On faces, edges and corners too, and a little beside.
        for axis in 0..3 {
            if next(0.0, 1.0) < 0.25 {
                eye[axis] = eye[axis].round() + [0.0, 1e-12, -1e-12, 1e-6, -1e-4][k % 5];
            }
        }
        let cell = eye.floor();
        if solid.solid(cell.x as i64, cell.y as i64, cell.z as i64) {
            continue;
        }
        let turned = |v: f64, step: f64, k: usize| if k == 0 { (v / step).round() * step } else { v };
        let (yaw, pitch, roll) = (next(0.0, 360.0), next(-90.0, 90.0), next(-180.0, 180.0));
        let [width, height] = [[64, 48], [33, 31], [48, 64], [7, 90], [90, 7]][k % 5];
        poses.push(Camera {
            eye,
            yaw: turned(yaw, 45.0, k % 4),
            pitch: turned(pitch, 90.0, k % 7),
            roll: turned(roll, 45.0, k % 3),
            fov: [60.0, 100.0, 20.0, 150.0, 1.0][k / 5 % 5],
            width,
            height,
        });
        if poses.len() == n as usize {
            break;
        }
    }
    poses
}

/// Options that close what they draw: each with its own way through the walk.
fn closing() -> [Options; 4] {
    let level0 = Options { lod: None, shading: Shading::None, ..Options::default() };
    [
        level0,
        Options { lod: Some(1.0), ..level0 },
        Options { lod: Some(6.0), readjust: false, ..level0 },
        Options { planes: Planes::Factor(0.5), lod: Some(2.0), ..level0 },
    ]
}

/// Pixels of sky from `n` poses in each closed world, and pixels in all. Frames that the device refuses count as neither.
fn leaks(n: u32, drawers: impl Fn(&World) -> Vec<Drawer<'_>>) -> (Vec<String>, usize) {
    let (mut leaks, mut pixels) = (Vec::new(), 0);
    for name in [WorldName::Room, WorldName::Hall] {
        let world = name.make();
        for drawer in &mut drawers(&world) {
            for (k, camera) in poses_within(&world, n, 11).iter().enumerate() {
                let frame = (drawer.draw)(camera, &closing()[k % 4]).unwrap();
                assert_eq!(sane(&frame), Ok(()), "{name:?}, {}, {camera:?}", drawer.kernel);
                let sky = cracks(&frame, Expect::Closed);
                pixels += frame.depth.len();
                if sky > 0 {
                    leaks.push(format!("{sky} pixels: {name:?}, {}, options {}, {camera:?}", drawer.kernel, k % 4));
                }
            }
        }
    }
    (leaks, pixels)
}

#[test]
fn closed_worlds_show_no_sky_from_anywhere_on_the_cpu() {
    let (leaks, pixels) = leaks(1_500, |world| vec![Drawer::cpu(world), Drawer::cpu_f64(world), Drawer::rays(world)]);
    println!("{pixels} pixels");
    assert!(leaks.is_empty(), "{} frames\n{}", leaks.len(), leaks.join("\n"));
}

#[cfg(feature = "gpu")]
#[test]
fn closed_worlds_show_no_sky_from_anywhere_on_the_gpu() {
    if !gpu_wanted() {
        return;
    }
    let (leaks, pixels) = leaks(200, |world| KERNELS.map(|k| Drawer::gpu(&GPU, world, k, true).unwrap()).into());
    println!("{pixels} pixels");
    assert!(leaks.is_empty(), "{} frames\n{}", leaks.len(), leaks.join("\n"));
}

/// A wall of one voxel gone: the check must see it.
#[test]
fn watertightness_check_catches_one_missing_voxel() {
    let name = WorldName::Room;
    let room = name.make();
    let [nx, ny, nz] = name.dims();
    let whole = &room.scene.levels[0].solid;
    let solid = |x: u32, y: u32, z: u32| whole.solid(x.into(), y.into(), z.into()) && [x, y, z] != [0, 7, 9];
    let columns = Columns::from_fn(nx, ny, nz, solid);
    let input = Input { columns, colors: Colors::None, notes: Vec::new() };
    let scene = Arc::new(build(input, &BuildOptions::default()).unwrap());
    let resident = Arc::new(Resident::new(&scene));
    let world = World { name, scene, resident };
    let level0 = closing()[0];
    let caught = poses_within(&world, 1_500, 11)
        .iter()
        .filter(|camera| cracks(&(Drawer::cpu(&world).draw)(camera, &level0).unwrap(), Expect::Closed) > 0)
        .count();
    assert!(caught > 10, "{caught} of 1,500");
}

/// The bytes of a frame.
fn bytes(frame: &Frame) -> (Vec<[u8; 4]>, Vec<u32>, Vec<[i32; 4]>) {
    (frame.color.clone(), frame.depth.iter().map(|d| d.to_bits()).collect(), frame.voxel.clone())
}

#[test]
fn every_case_is_the_same_from_one_thread_and_many() {
    let pools = [1, 5].map(|n| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap());
    for (name, cases) in by_world() {
        let world = name.make();
        for case in &cases {
            for draw in [Drawer::cpu, Drawer::exact] {
                let [one, many] = [0, 1]
                    .map(|k| pools[k].install(|| bytes(&(draw(&world).draw)(&case.camera, &case.options).unwrap())));
                assert!(one == many, "{}", case.name);
            }
        }
    }
}

/// Two runs, and one with wgpu's runtime checks: bounds of arrays, ends of loops.
#[cfg(feature = "gpu")]
#[test]
fn every_case_is_the_same_from_two_gpu_runs_and_with_runtime_checks() {
    if !gpu_wanted() {
        return;
    }
    let mut drawn = 0;
    for (name, cases) in by_world() {
        let world = name.make();
        for kernel in KERNELS {
            let mut drawers = [true, true, false].map(|trusted| Drawer::gpu(&GPU, &world, kernel, trusted).unwrap());
            for case in &cases {
                let frames: Vec<_> = (drawers.iter_mut())
                    .map(|d| match (d.draw)(&case.camera, &case.options) {
                        Ok(frame) => Some(bytes(&frame)),
                        Err(planecast::Error::Limit(_)) => None,
                        Err(e) => panic!("{}: {e}", case.name),
                    })
                    .collect();
                assert!(frames[0] == frames[1], "{}, {}: two runs", case.name, kernel.name());
                assert!(frames[0] == frames[2], "{}, {}: with checks", case.name, kernel.name());
                drawn += usize::from(frames[0].is_some());
            }
        }
    }
    assert!(drawn > 750, "{drawn} frames");
}
