//! Worlds whose pictures have a closed form.

mod common;

use common::compare::sane;
use common::{World, camera, color_of, empty, plain};
use glam::DVec3;
use planecast::{Camera, Features, Options, Remap, Repeat, Shading};
use planecast_encoder::{BuildOptions, ColorMode, Encoding};

const SKY: [i32; 4] = [-1; 4];
const BOTH: Repeat = Repeat { x: true, z: true };
const PITCHES: [f64; 13] = [-90.0, -89.999, -70.0, -45.0, -20.0, -1e-6, 0.0, 1e-6, 20.0, 45.0, 70.0, 89.999, 90.0];
const ROLLS: [f64; 6] = [0.0, 17.0, 45.0, 90.0, 180.0, -135.0];

/// Solid up to height 4.
fn floor(n: u32) -> World {
    World::new("floor", [n, 8, n], |_, y, _| y < 4)
}

/// Each pixel with its ray.
fn rays(camera: &Camera) -> impl Iterator<Item = (usize, DVec3)> {
    let (basis, camera) = (camera.basis(), *camera);
    (0..(camera.width * camera.height) as usize).map(move |i| {
        let (x, y) = (i as u32 % camera.width, i as u32 / camera.width);
        (i, camera.ray(&basis, f64::from(x) + 0.5, f64::from(y) + 0.5))
    })
}

fn close(a: f32, b: f64) -> bool {
    (f64::from(a) - b).abs() <= 1e-5 * b.abs()
}

#[test]
fn empty_world_is_sky() {
    let world = empty();
    for pitch in PITCHES {
        for repeat in [Repeat::default(), BOTH] {
            let options = Options { repeat, ..Options::default() };
            let frame = world.render(&camera(DVec3::new(3.5, 2.5, 9.0), [33.0, pitch, 5.0], [40, 30]), &options);
            assert!(frame.depth.iter().all(|&d| d == f32::INFINITY), "pitch {pitch}");
            assert!(frame.voxel.iter().all(|&v| v == SKY), "pitch {pitch}");
            assert_eq!(frame.stats.spans_drawn, 0);
        }
    }
}

#[test]
fn floor_has_its_horizon_and_depths() {
    let world = floor(512);
    let eye = DVec3::new(256.3, 14.0, 255.8);
    for yaw in [0.0, 90.0, 211.0] {
        let camera = camera(eye, [yaw, 0.0, 0.0], [120, 90]);
        let frame = world.render(&camera, &plain());
        assert!(frame.voxel[..45 * 120].iter().all(|&v| v == SKY), "the horizon is row 45");
        for (i, ray) in rays(&camera).skip(45 * 120) {
            let depth = -10.0 / ray.y;
            let hit = eye + depth * ray;
            let inside = hit.x.min(hit.z).min(512.0 - hit.x).min(512.0 - hit.z);
            if inside.abs() < 1e-3 {
                continue; // rounding decides
            }
            if inside > 0.0 {
                assert!(close(frame.depth[i], depth), "yaw {yaw} pixel {i}: {} / {depth}", frame.depth[i]);
            } else {
                assert_eq!(frame.voxel[i], SKY, "yaw {yaw} pixel {i}");
            }
            // The voxel too, but where the ray meets the floor on a grid line.
            let edge = (hit.x - hit.x.round()).abs().min((hit.z - hit.z.round()).abs());
            if inside > 0.0 && edge > 1e-4 * depth {
                let voxel = [hit.x.floor() as i32, 3, hit.z.floor() as i32];
                assert_eq!(frame.voxel[i], [voxel[0], voxel[1], voxel[2], 0], "yaw {yaw} pixel {i}");
                let [r, g, b] = color_of(voxel);
                assert_eq!(frame.color[i], [r, g, b, 255]);
            }
        }
    }
}

/// A floor without end: in each pixel below the horizon the floor's depth, up to a stripe and a pixel beside it: the
/// reach of a retest.
#[test]
fn repeated_floor_is_a_plane_from_every_pose() {
    let world = floor(32);
    let eye = DVec3::new(-777.3, 14.0, 1e6 + 0.8);
    let tolerance = 1e-4;
    for lod in [None, Some(1.0)] {
        let options = Options { lod, repeat: BOTH, view_distance: 500.0, shading: Shading::None, ..Options::default() };
        for pitch in PITCHES {
            for roll in ROLLS {
                let camera = camera(eye, [29.0, pitch, roll], [75, 60]);
                let basis = camera.basis();
                let frame = world.render(&camera, &options);
                assert_eq!(sane(&frame), Ok(()));
                for (i, ray) in rays(&camera) {
                    let (x, y) = (f64::from(i as u32 % 75) + 0.5, f64::from(i as u32 / 75) + 0.5);
                    // What is seen around the pixel: nearest and farthest depth, and whether sky.
                    let (mut least, mut most, mut sky) = (f64::INFINITY, 0.0f64, false);
                    for (dx, dy) in (0..9).map(|k| (2.5 * f64::from(k % 3 - 1), 2.5 * f64::from(k / 3 - 1))) {
                        let near = camera.ray(&basis, x + dx, y + dy);
                        let depth = -10.0 / near.y;
                        let horizontal = depth * near.x.hypot(near.z);
                        if near.y < 0.0 && horizontal < 500.0 * (1.0 + tolerance) {
                            (least, most) = (least.min(depth), most.max(depth));
                        }
                        sky |= near.y >= 0.0 || horizontal > 500.0 * (1.0 - tolerance);
                    }
                    if sky {
                        most = f64::INFINITY;
                    }
                    let depth = f64::from(frame.depth[i]);
                    let ok = if depth == f64::INFINITY {
                        sky
                    } else {
                        // A retested pixel may show a neighbour of the voxel that its ray meets (see `flat`), and that
                        // voxel is met somewhere between its corners.
                        let across = 1.5 * f64::from(1 << frame.voxel[i][3]) / ray.x.hypot(ray.z).max(ray.y.abs());
                        (least * (1.0 - tolerance) - across..=most * (1.0 + tolerance) + across).contains(&depth)
                    };
                    assert!(
                        ok,
                        "lod {lod:?} pitch {pitch} roll {roll} pixel {i}: {depth} not in {least} ..= {most}, {ray}"
                    );
                }
            }
        }
    }
}

#[test]
fn one_voxel_covers_focal_over_distance_pixels() {
    let world = World::new("one", [96, 32, 96], |x, y, z| [x, y, z] == [40, 16, 20]);
    for distance in [2.0, 5.0, 17.0, 60.0] {
        let eye = DVec3::new(40.5, 16.5, 21.0 + distance);
        let camera = camera(eye, [0.0; 3], [200, 150]);
        let frame = world.render(&camera, &plain());
        // Its front face is a square around the image's middle.
        let half = camera.focal() / distance / 2.0;
        for i in 0..frame.depth.len() {
            let off = [(i % 200) as f64 - 99.5, (i / 200) as f64 - 74.5].map(f64::abs);
            let expected = off[0] < half && off[1] < half;
            assert!((off[0] - half).abs() > 1e-4 && (off[1] - half).abs() > 1e-4, "not a case on the edge");
            assert_eq!(frame.voxel[i] == [40, 16, 20, 0], expected, "distance {distance} pixel {i}");
            assert!(!expected || close(frame.depth[i], distance), "{}", frame.depth[i]);
        }
    }
}

#[test]
fn wall_fills_the_view_and_ends_each_plane() {
    let world = World::new("wall", [64, 64, 64], |_, _, z| z < 40);
    let camera = camera(DVec3::new(32.5, 32.5, 43.25), [0.0; 3], [90, 70]);
    // 4 rows of columns, in each at most the columns across which a plane moves, and one more. Over ground whole strips of 8
    // slices, each one column or two.
    let across = (3.25 * camera.half_extent().x).ceil() as u64;
    for (specialize, most) in [(Features::NONE, 4 + across + 1), (Features::ALL, 16)] {
        let frame = world.render(&camera, &Options { specialize, ..plain() });
        assert!(frame.depth.iter().all(|&d| close(d, 3.25)));
        assert!(frame.voxel.iter().all(|v| v[2] == 39));
        assert!(frame.stats.columns_visited <= 90 * most, "{} columns", frame.stats.columns_visited);
        assert!(frame.stats.spans_drawn <= 2 * 90, "{} spans", frame.stats.spans_drawn);
    }
}

#[test]
fn eye_inside_solid_sees_it_at_depth_0() {
    for (encoding, color) in [
        (Encoding::Solid, ColorMode::Voxel),
        (Encoding::Solid, ColorMode::Run),
        (Encoding::Solid, ColorMode::None),
        (Encoding::Surface, ColorMode::Voxel),
        (Encoding::Surface, ColorMode::Run),
        (Encoding::Surface, ColorMode::None),
    ] {
        let options = BuildOptions { encoding, color: Some(color), ..BuildOptions::default() };
        let world = World::encoded("block", [20, 20, 20], &options, |x, y, z| x.min(y).min(z) > 2);
        // On a face, an edge and a corner a voxel's lower side counts as inside it.
        for eye in [[10.5, 10.2, 10.9], [3.0, 10.5, 10.5], [3.0, 3.0, 3.0], [19.999_999, 19.5, 5.0]] {
            for pitch in [-90.0, -30.0, 0.0, 90.0] {
                let camera = camera(DVec3::from(eye), [40.0, pitch, 10.0], [30, 20]);
                for frame in [world.render(&camera, &plain()), world.exact(&camera, &plain())] {
                    assert!(frame.depth.iter().all(|&d| d == 0.0), "{encoding:?} {color:?} {eye:?} {pitch}");
                    let cell = eye.map(|v| v.floor() as i32);
                    assert!(frame.voxel.iter().all(|&v| v == [cell[0], cell[1], cell[2], 0]));
                    assert!(frame.color.iter().all(|&c| c == frame.color[0] && c[3] == 255));
                }
            }
        }
        let outside = camera(DVec3::new(2.999_999, 10.5, 10.5), [90.0, 0.0, 0.0], [30, 20]);
        let frame = world.render(&outside, &plain());
        assert!(frame.depth.iter().all(|&d| d > 0.0 && d < 0.01), "just outside is not inside");
    }
}

/// Sizes that put the vanishing point on a pixel's centre, on an edge, on a corner.
const SIZES: [[u32; 2]; 6] = [[64, 48], [65, 49], [64, 49], [65, 48], [1, 1], [12, 3]];

/// Each pixel shows a voxel of layer `y`, whose face is at `depth`. A retested pixel may show a neighbour of the
/// voxel that its ray meets, and then has the depth at which its ray enters that one: less than a voxel more.
fn flat(world: &World, camera: &Camera, depth: f64, y: i32) {
    for remap in Remap::ALL {
        let frame = world.render(camera, &Options { remap, ..plain() });
        let mut neighbours = 0;
        for (i, &d) in frame.depth.iter().enumerate() {
            if remap != Remap::Nearest && !close(d, depth) {
                neighbours += 1;
                assert!((depth..depth + 1.0).contains(&f64::from(d)), "{camera:?}, pixel {i}: {d}, expected {depth}");
            } else {
                assert!(close(d, depth), "{remap:?} {camera:?}, pixel {i}: {d}, expected {depth}");
            }
            assert_eq!(frame.voxel[i][1], y, "{remap:?} {camera:?}, pixel {i}");
        }
        // Voxels are down to 1.2 pixels wide here: as for a far view.
        let share = if remap == Remap::Refine { 200 } else { 10 };
        assert!(share * neighbours <= frame.depth.len(), "{remap:?} {camera:?}: {neighbours} pixels");
    }
}

#[test]
fn floor_from_straight_above_is_written_whole() {
    let world = floor(256);
    for size in SIZES {
        for roll in ROLLS {
            for [x, z] in [[128.0, 128.0], [127.5, 130.25], [128.0, 99.75]] {
                let camera = camera(DVec3::new(x, 14.5, z), [0.0, -90.0, roll], size);
                flat(&world, &camera, 10.5, 3);
            }
        }
    }
}

#[test]
fn ceiling_from_straight_below_is_written_whole() {
    let world = World::new("ceiling", [256, 32, 256], |_, y, _| y >= 20);
    for size in SIZES {
        for roll in ROLLS {
            for y in [-15.0, 0.0, 8.125] {
                let camera = camera(DVec3::new(128.0, y, 127.5), [77.0, 90.0, roll], size);
                flat(&world, &camera, 20.0 - y, 20);
            }
        }
    }
}

#[test]
fn tall_columns_show_both_ends() {
    // A full column of 65,536 beside one of 32,768 runs.
    let world = World::new("tall", [4, 65_536, 4], |x, y, z| (x == 1 && z == 1) || (x == 2 && z == 1 && y % 2 == 0));
    for (eye, pitch, top) in [([1.5, 65_546.0, 1.5], -90.0, 65_535), ([2.5, -10.0, 1.5], 90.0, 0)] {
        let camera = camera(DVec3::from(eye), [0.0, pitch, 0.0], [33, 33]);
        let frame = world.render(&camera, &plain());
        let middle = 16 * 33 + 16;
        assert_eq!(frame.voxel[middle], [eye[0] as i32, top, 1, 0]);
        assert!(close(frame.depth[middle], 10.0), "{}", frame.depth[middle]);
        assert_eq!(sane(&frame), Ok(()));
    }
    for y in [0.5, 256.5, 32_768.5, 65_535.5] {
        let camera = camera(DVec3::new(1.5, y, 3.5), [0.0; 3], [33, 33]);
        let frame = world.render(&camera, &plain());
        assert_eq!(frame.voxel[16 * 33 + 16], [1, y as i32, 1, 0]);
        assert!(close(frame.depth[16 * 33 + 16], 1.5));
    }
}

/// Ceilings one voxel thick, one over the other: the lowest hides the others, near the vanishing point too.
#[test]
fn lower_of_two_ceilings_is_seen_from_below() {
    let world = World::new("ceilings", [64, 64, 64], |x, y, z| y % 3 == 1 && y > 18 && x.min(z) > 0);
    for pitch in [90.0, 85.0, 60.0] {
        let camera = camera(DVec3::new(32.3, 2.5, 31.6), [20.0, pitch, 0.0], [81, 61]);
        let frame = world.render(&camera, &plain());
        for (i, ray) in rays(&camera) {
            let hit = camera.eye + 16.5 / ray.y * ray;
            if ray.y > 0.0 && hit.x.min(hit.z) > 3.0 && hit.x.max(hit.z) < 62.0 {
                assert_eq!(frame.voxel[i][1], 19, "pitch {pitch} pixel {i}");
            }
        }
    }
}

/// An eye on a floor's face, an edge and a corner of it, and one ulp above: below the horizon it sees the floor at depth 0.
#[test]
fn eye_on_a_face_sees_it_at_depth_0() {
    let world = World::new("slab and lid", [16, 16, 16], |_, y, _| !(4..12).contains(&y));
    for [x, z] in [[8.5, 8.5], [8.0, 8.5], [8.0, 8.0]] {
        for (y, sign) in [(4.0f64, -1.0), (4.0f64.next_up(), -1.0), (12.0f64.next_down(), 1.0)] {
            for pitch in [-90.0, -40.0, 0.0, 40.0, 90.0] {
                let camera = camera(DVec3::new(x, y, z), [33.0, pitch, 0.0], [40, 30]);
                let frame = world.render(&camera, &Options { remap: Remap::Nearest, readjust: false, ..plain() });
                for (i, ray) in rays(&camera) {
                    // Planes may stand half a pixel beside a ray near the horizon.
                    if ray.y * sign > 0.05 {
                        assert!(frame.depth[i] < 1e-5, "{x} {y} {z} pitch {pitch} pixel {i}: {}", frame.depth[i]);
                    }
                }
            }
        }
    }
}

/// An eye on the plane of a block's top: the horizon is where `exact` has it, to the row, whatever picks the samples.
#[test]
fn eye_on_the_plane_of_a_top_face_has_its_horizon_in_the_right_row() {
    let world = World::new("block", [16, 8, 16], |_, _, _| true);
    for (pitch, remap) in [-5.0, 5.0].into_iter().flat_map(|pitch| Remap::ALL.map(|remap| (pitch, remap))) {
        let camera = camera(DVec3::new(7.0, 8.0, 7.0), [45.0, pitch, 0.0], [300, 240]);
        let exact = world.exact(&camera, &plain());
        let frame = world.render(&camera, &Options { remap, ..plain() });
        assert!(frame.voxel == exact.voxel, "pitch {pitch}, {remap:?}");
        let sky = exact.voxel.iter().filter(|voxel| voxel[3] < 0).count();
        assert!(sky.is_multiple_of(300) && sky > 0 && sky < exact.voxel.len(), "{sky} pixels of sky are whole rows");
    }
}

#[test]
fn view_distance_ends_the_floor() {
    let world = floor(32);
    let options = Options { repeat: BOTH, view_distance: 100.0, ..plain() };
    let camera = camera(DVec3::new(16.0, 14.0, 16.0), [0.0; 3], [61, 200]);
    let frame = world.render(&camera, &options);
    for (i, ray) in rays(&camera) {
        let distance = -10.0 / ray.y * ray.x.hypot(ray.z);
        let shown = ray.y < 0.0 && distance < 100.0;
        assert_eq!(frame.depth[i] < f32::INFINITY, shown, "pixel {i} at {distance}");
    }
}
