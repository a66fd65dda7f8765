//! Every case of the catalogue on every device, within its bounds; that the runner sees what is out of them; and f32
//! against f64 walks.

use glam::DVec3;
use planecast::cpu::traverse::{PlaneBuffer, traverse};
use planecast::plane_setup::{Plane, plane_setup};
use planecast::stability::measure::{Truth, measure};
use planecast::stability::{Case, Drawer, Row, World, WorldName, cases};
use planecast::{Camera, Culling, Frame, Options, Repeat, Shading};
use std::collections::HashMap;

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
        "{:62} {:10} off {:6.3} of {:5.1} cracks {} depth {:.1e} steps {:?} of {} moved {:?} ulps {:?}",
        row.case,
        row.device,
        row.off_percent,
        row.bound_off_percent,
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
    let (rows, faults) = run(|world| planecast::Kernel::ALL.map(|k| Drawer::gpu(world, k, true).unwrap()).into());
    assert!(faults.is_empty(), "{} faults\n{}", faults.len(), faults.join("\n"));
    // What a device does not draw it refuses with the figure and a way out; that is the rare case.
    let refused: Vec<_> = rows.iter().filter_map(|r| r.refused.as_deref()).collect();
    assert!(refused.iter().all(|text| text.contains("allows") || text.contains("at most")), "{refused:?}");
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
    for kernel in planecast::Kernel::ALL {
        let mut drawer = Drawer::gpu(&world, kernel, true).unwrap();
        let inside = (drawer.draw)(&inside_solid, &far).unwrap();
        assert_eq!(inside.stats.kernel, "inside", "an eye in solid walks nothing");
        let tall = Camera { eye: DVec3::new(16.3, 1e7, 15.7), pitch: -60.0, ..camera };
        let text = (drawer.draw)(&tall, &far).unwrap_err().to_string();
        assert!(text.contains("columns along one plane") && text.contains("try levels (--lod 1)"), "{text}");
        // The renderer goes on.
        (drawer.draw)(&camera, &Options { view_distance: 500.0, ..far }).unwrap();
    }
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

/// How far beside its sample, in samples, the edge of a span may stand by rounding to f32, where it is seen along sample
/// `s`. With unit roundoff `u` = 2⁻²⁴ a crossing takes `(line − fract) · inverse`, four roundings, `h` one, the coefficients
/// of `(A·t + B·h) / (C·t + E·h)` one each, products and sums two: at most 8u of each product, above and below.
fn span_bound(plane: &Plane, s: f64) -> f64 {
    let (t, h) = (plane.b - s * plane.e, s * plane.c - plane.a);
    let above = (plane.a * t).abs() + (plane.b * h).abs();
    let below = (plane.c * t).abs() + (plane.e * h).abs();
    8.0 * 2f64.powi(-24) * (above + s * below) / (plane.b * plane.c - plane.a * plane.e)
}

const SKY: [i32; 4] = [-1; 4];

/// Where a plane sees a voxel of level 0, in samples from and to, and how far away. A voxel that the plane only touches, by
/// rounding, has an extent too.
fn sight_of(plane: &Plane, eye: DVec3, voxel: [i32; 4]) -> (f64, f64, f64) {
    let (mut t0, mut t1) = (0.0f64, f64::INFINITY);
    for (axis, d) in [(0, plane.dir[0]), (2, plane.dir[1])] {
        let from = f64::from(voxel[axis]) - eye[axis];
        let (a, b) = (from / d, (from + 1.0) / d);
        (t0, t1) = (t0.max(a.min(b)), t1.min(a.max(b)));
    }
    let at = |t: f64, h: f64| (plane.a * t + plane.b * h) / (plane.c * t + plane.e * h);
    let from = f64::from(voxel[1]) - eye.y;
    let corners = [t0, t1].into_iter().flat_map(|t| [from, from + 1.0].map(|h| at(t, h)));
    let (from, to) = corners.fold((f64::INFINITY, f64::NEG_INFINITY), |(from, to), u| (from.min(u), to.max(u)));
    (from, to, t0)
}

#[test]
fn f32_walks_differ_from_f64_ones_by_no_more_than_rounding() {
    let repeat = Repeat { x: true, z: true };
    let options = Options { lod: None, repeat, view_distance: 50_000.0, shading: Shading::None, ..Options::default() };
    let (mut all, mut differing, mut first, mut worst) = (0, 0, f64::INFINITY, 0.0f64);
    for name in [WorldName::Rocks, WorldName::Floor, WorldName::Poles] {
        let world = name.make();
        let top = f64::from(name.dims()[1]);
        for (k, pitch) in [0.0, -1e-3, -2.0, -20.0, -89.0].into_iter().enumerate() {
            let eye = DVec3::new(12.3 + k as f64, top + 17.2, 20.7);
            let camera =
                Camera { eye, yaw: 33.0 + 45.0 * k as f64, pitch, roll: 0.0, fov: 60.0, width: 200, height: 400 };
            let setup = plane_setup(&world.resident, &camera, &options);
            let walk = |f64_walk: bool| {
                let mut buffer = PlaneBuffer::default();
                if f64_walk {
                    traverse::<f64>(&world.resident, &setup, Culling::ALL, &mut buffer, true);
                } else {
                    traverse::<f32>(&world.resident, &setup, Culling::ALL, &mut buffer, true);
                }
                buffer
            };
            let (a, b) = (walk(false), walk(true));
            for plane in &setup.planes {
                for j in plane.first..plane.end {
                    let (i, s) = (plane.base + j as usize, f64::from(j) + 0.5);
                    all += 1;
                    if a.voxel[i] == b.voxel[i] {
                        continue;
                    }
                    differing += 1;
                    // Whichever shows a voxel: the sample lies at one of its edges.
                    let edges = |voxel: [i32; 4]| sight_of(plane, camera.eye, voxel);
                    let (near, distance) = match (a.voxel[i], b.voxel[i]) {
                        (SKY, voxel) => {
                            let (from, to, distance) = edges(voxel);
                            ((s - from).abs().min((s - to).abs()), distance)
                        }
                        (voxel, _) => {
                            let (from, to, distance) = edges(voxel);
                            ((from - s).max(s - to).max(0.0), distance)
                        }
                    };
                    worst = worst.max(near / span_bound(plane, s));
                    first = first.min(distance);
                    assert!(
                        near <= span_bound(plane, s),
                        "{name:?} pitch {pitch}, sample {j}: f32 {:?}, f64 {:?}, {near:.1e} samples beside, bound {:.1e}",
                        a.voxel[i],
                        b.voxel[i],
                        span_bound(plane, s)
                    );
                }
            }
        }
    }
    println!(
        "{differing} of {all} samples differ, the nearest {first:.0} voxels away, by at most {:.0} % of the bound",
        100.0 * worst
    );
    assert!(all > 500_000 && differing > 0, "{differing} of {all}");
    assert!(2_000 * differing < all, "{differing} of {all}");
}
