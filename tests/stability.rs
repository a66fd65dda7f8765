//! Every case of the catalogue on every device, within its bounds; that the runner sees what is out of them; and f32
//! against f64 walks.

use glam::DVec3;
use planecast::cpu::traverse::{PlaneBuffer, traverse};
use planecast::exact::cast;
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
#[test]
fn every_case_keeps_its_bounds_on_the_gpu() {
    if std::env::var_os("PLANECAST_NO_GPU").is_some_and(|v| v == "1") {
        eprintln!("skipped: PLANECAST_NO_GPU=1");
        return;
    }
    let (_, faults) = run(|world| planecast::Kernel::ALL.map(|k| Drawer::gpu(world, k, true).unwrap()).into());
    assert!(faults.is_empty(), "{} faults\n{}", faults.len(), faults.join("\n"));
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

#[test]
fn f32_walks_differ_from_f64_ones_by_no_more_than_rounding() {
    let repeat = Repeat { x: true, z: true };
    let options = Options { lod: None, repeat, view_distance: 50_000.0, shading: Shading::None, ..Options::default() };
    let (mut all, mut differing, mut first) = (0, 0, f64::INFINITY);
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
                    // A ray that leaves its sample or its azimuth by no more than rounding meets what f32 shows.
                    let bound = span_bound(plane, s);
                    let turn = 8.0 * 2f64.powi(-24);
                    let parts = (0..24).map(|k| 2f64.powi(-k)).flat_map(|d| [d, -d]).chain([0.0]);
                    let explained = parts.into_iter().any(|du| {
                        [0.0, 1.0, -1.0].into_iter().any(|dphi| {
                            let u = s + du * bound;
                            let (t, h) = (plane.b - u * plane.e, u * plane.c - plane.a);
                            let [x, z] = plane.dir;
                            let ray = DVec3::new((x - dphi * turn * z) * t, h, (z + dphi * turn * x) * t);
                            let hit = cast(
                                &world.scene.levels[0].solid,
                                [true; 2],
                                camera.eye,
                                ray,
                                options.view_distance / t,
                            );
                            let met = hit.map_or([-1; 4], |hit| {
                                first = first.min(hit.t * t);
                                [hit.voxel[0] as i32, hit.voxel[1] as i32, hit.voxel[2] as i32, 0]
                            });
                            met == a.voxel[i]
                        })
                    });
                    assert!(
                        explained,
                        "{name:?} pitch {pitch}, sample {j}: f32 {:?}, f64 {:?}, bound {bound:.1e} samples",
                        a.voxel[i], b.voxel[i]
                    );
                }
            }
        }
    }
    println!("{differing} of {all} samples differ, the nearest {first:.0} voxels away");
    assert!(all > 500_000 && differing > 0, "{differing} of {all}");
    assert!(2_000 * differing < all, "{differing} of {all}");
}
