//! Whatever is left out, what planes draw stays the same, bit for bit.

use glam::DVec3;
use planecast::cpu::remap::color_of;
use planecast::cpu::traverse::{PlaneBuffer, Real, traverse};
use planecast::frame::plane_setup::plane_setup;
use planecast::frame::specialize::{Specialization, Twin};
use planecast::{Camera, Feature, Features, Options, Repeat, Resident};
use planecast_encoder::{BuildOptions, ColorMode, Colors, Columns, ColumnsBuilder, Encoding, Input, Run, Scene, build};
use proptest::prelude::*;

/// A height field `n` columns a side.
fn field(n: u32, ny: u32, color: ColorMode, height: impl Fn(u32, u32) -> u32) -> Scene {
    oblong([n, ny, n], color, height)
}

/// A height field of `nx` by `nz` columns.
fn oblong([nx, ny, nz]: [u32; 3], color: ColorMode, height: impl Fn(u32, u32) -> u32) -> Scene {
    let mut columns = ColumnsBuilder::new(nx, ny, nz);
    for (z, x) in (0..nz).flat_map(|z| (0..nx).map(move |x| (z, x))) {
        if let Some(last) = height(x, z).min(ny).checked_sub(1) {
            columns.push_run(Run::new(0, last as u16));
        }
        columns.end_column();
    }
    scene(columns.finish(), color)
}

fn scene(columns: Columns, color: ColorMode) -> Scene {
    let shade = |x: u32, y: u32, z: u32| [(x * 5 + y) as u8, (y * 7 + z) as u8, (z * 3 + x * y) as u8];
    let colors = if color == ColorMode::None { Colors::None } else { Colors::Function(Box::new(shade)) };
    let options = BuildOptions { color: Some(color), encoding: Encoding::Solid, ..Default::default() };
    build(Input { columns, colors, notes: Vec::new() }, &options).unwrap()
}

fn hills(x: u32, z: u32) -> u32 {
    9 + (x * x * 7 + z * 13 + x * z) % 17 + if (x / 9 + z / 5).is_multiple_of(6) { 14 } else { 0 }
}

/// Pits down to nothing, behind which feet of columns show.
fn pits(x: u32, z: u32) -> u32 {
    if (x / 5 + z / 7).is_multiple_of(3) && (x + z) % 4 != 1 { 0 } else { hills(x, z) }
}

fn camera(scene: &Scene, at: [f64; 3], yaw: f64, pitch: f64, roll: f64) -> Camera {
    let [nx, ny, nz] = scene.dims().map(f64::from);
    let eye = DVec3::new(nx * at[0] + 0.3, ny * at[1] + 0.2, nz * at[2] + 0.4);
    Camera { eye, yaw, pitch, roll, fov: 75.0, width: 61, height: 46 }
}

fn cameras(scene: &Scene) -> Vec<Camera> {
    let at = |at, yaw, pitch, roll| camera(scene, at, yaw, pitch, roll);
    vec![
        at([0.5, 1.1, 0.5], 30.0, 0.0, 0.0),
        at([0.5, 0.75, 0.5], 200.0, -35.0, 20.0),
        at([0.5, 1.5, 0.5], 100.0, -90.0, 0.0),
        at([-0.4, 0.4, 0.5], 85.0, -5.0, 0.0),
        at([-2.0, 3.0, 0.4], 92.0, -40.0, 0.0),
        at([0.5, -0.3, 0.5], 60.0, 20.0, 0.0),
        at([1.5, 0.0, 1.2], -50.0, 10.0, 0.0),
        at([1.5, 0.0, 0.3], -95.0, 0.0, 90.0),
    ]
}

fn options() -> [Options; 5] {
    let repeat = Repeat { x: true, z: true };
    let near = Options { lod: None, ..Options::default() };
    [
        near,
        Options { lod: Some(3.0), ..near },
        Options { lod: Some(2.0), repeat, view_distance: 900.0, ..near },
        Options { equidistant: Some(7.0), ..near },
        Options { culling: planecast::Culling { center: false, ..planecast::Culling::ALL }, ..near },
    ]
}

/// What planes draw generally and with `features`, as far as these can be in force: the features, and where they differ.
fn compare<R: Real>(
    worlds: [(&Resident, Features); 2],
    camera: &Camera,
    options: &Options,
    voxels: bool,
) -> (Features, Option<String>) {
    let mut found = [PlaneBuffer::default(), PlaneBuffer::default()];
    let [(general, _), (resident, specialize)] = worlds;
    let setup = plane_setup(general, camera, options);
    traverse::<R>(general, &setup, options.culling, &mut found[0], voxels);
    let options = Options { specialize, ..*options };
    let setup = plane_setup(resident, camera, &options);
    let specialization = Specialization::new(resident, &setup, camera, &options, Twin::Cpu);
    R::traverse(resident, &setup, options.culling, specialization, &mut found[1], voxels);
    let differs = setup.planes.iter().enumerate().find_map(|(k, plane)| {
        let (first, end) = (plane.base + plane.first as usize, plane.base + plane.end as usize);
        (first..end).find_map(|i| {
            let [a, b] = [0, 1].map(|w| {
                let PlaneBuffer { color, depth, voxel } = &found[w];
                let color = color.get(i).copied().unwrap_or_else(|| color_of(resident, voxel[i]));
                (color, depth[i].to_bits(), voxel.get(i).copied())
            });
            (a != b).then(|| format!("plane {k} sample {}: {a:?} against {b:?}", i - plane.base))
        })
    });
    (specialization.features, differs)
}

#[test]
fn specialize_draws_the_same_bits_over_a_grid_of_scenes_and_options() {
    let caves = Columns::from_fn(40, 40, 40, |x, y, z| y < hills(x, z) && (x + 2 * y + z) % 11 > 1);
    let mut worlds = vec![scene(caves, ColorMode::Voxel)];
    for color in [ColorMode::None, ColorMode::Run, ColorMode::Voxel] {
        worlds.push(field(48, 40, color, hills));
        worlds.push(field(48, 40, color, pits));
    }
    let mut met = Features::NONE;
    for world in &worlds {
        let general = Resident::with(world, Features::NONE);
        let special = Resident::new(world);
        for (camera, options) in cameras(world).iter().flat_map(|c| options().map(|o| (c, o))) {
            for voxels in [true, false] {
                for features in [Features::ALL, Features::from_iter([Feature::Heights, Feature::Horizon])] {
                    let pair = [(&general, Features::NONE), (&special, features)];
                    let (used, differs) = compare::<f32>(pair, camera, &options, voxels);
                    assert_eq!(differs, None, "{features} {camera:?} {options:?}");
                    met = used.iter().fold(met, Features::with);
                }
            }
            let (_, differs) =
                compare::<f64>([(&general, Features::NONE), (&special, Features::ALL)], camera, &options, true);
            assert_eq!(differs, None, "f64 {camera:?} {options:?}");
        }
    }
    let of_cpu: Features = Feature::ALL.into_iter().filter(|f| f.is_of(Twin::Cpu)).collect();
    assert_eq!(met, of_cpu, "every feature was in force somewhere");
}

/// The comparison above, given a world that is one voxel higher at one place.
#[test]
fn specialize_comparison_finds_a_column_that_is_one_voxel_higher() {
    let [right, wrong] =
        [0, 1].map(|more| field(48, 40, ColorMode::None, |x, z| 9 + if (x, z) == (24, 20) { more } else { 0 }));
    let (general, special) = (Resident::with(&right, Features::NONE), Resident::new(&wrong));
    let camera = camera(&right, [0.5, 0.5, 0.5], 0.0, -45.0, 0.0);
    let pair = [(&general, Features::NONE), (&special, Features::ALL)];
    let (used, differs) = compare::<f32>(pair, &camera, &options()[0], true);
    assert!(used.has(Feature::Horizon) && differs.is_some_and(|text| text.contains("sample")));
}

/// Planes whose sight lines hardly tell one slope from another: looking up past the vertical from a corner of the grid.
#[test]
fn specialize_draws_the_same_bits_where_a_plane_is_seen_along_itself() {
    let world =
        field(24, 30, ColorMode::Voxel, |x, z| if (x * 7 + z * 3) % 7 == 0 { 0 } else { 1 + (x * 5 + z * 11) % 28 });
    let (general, special) = (Resident::with(&world, Features::NONE), Resident::new(&world));
    let pair = [(&general, Features::NONE), (&special, Features::ALL)];
    for (yaw, pitch) in
        (0..72).flat_map(|k| (0..40).map(move |i| (5.0 * f64::from(k) + 0.37, 70.0 + 0.5 * f64::from(i))))
    {
        let eye = DVec3::new(2.0, 1e-5, 21.0);
        let camera = Camera { eye, yaw, pitch, roll: 0.0, fov: 70.0, width: 1, height: 7 };
        let (used, differs) = compare::<f32>(pair, &camera, &options()[0], true);
        assert!(used.has(Feature::Horizon));
        assert_eq!(differs, None, "{camera:?}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    /// Eyes anywhere about ground with pits, close to its underside and to grid lines, too.
    #[test]
    fn specialize_draws_the_same_bits_from_anywhere(
        seed in any::<u32>(),
        pit in 0u32..4,
        eye in [-30.0..60.0f64, 0.0..40.0f64, -30.0..60.0f64],
        low in prop_oneof![Just(1.0), Just(0.0), Just(1e-3)],
        whole in any::<bool>(),
        (yaw, pitch, roll) in (0.0..360.0f64, prop_oneof![Just(0.0), -90.0..90.0f64], prop_oneof![Just(0.0), -180.0..180.0f64]),
        size in (1u32..70, 1u32..60),
        which in 0usize..3,
    ) {
        let noise = |x: u32, z: u32| (x.wrapping_mul(0x9E37_79B1) ^ z.wrapping_mul(0x85EB_CA77) ^ seed).wrapping_mul(0xC2B2_AE35) >> 16;
        let world = field(24, 30, ColorMode::Voxel, |x, z| {
            let n = noise(x, z);
            if n % 7 < pit { 0 } else { 1 + (noise(x / 4, z / 4) % 20 + n % 9) }
        });
        let eye = DVec3::from(eye) * DVec3::new(1.0, low, 1.0) + DVec3::new(0.0, 1e-4, 0.0);
        let eye = if whole { eye.round().max(DVec3::new(-99.0, 1e-5, -99.0)) } else { eye };
        let camera = Camera { eye, yaw, pitch, roll, fov: 70.0, width: size.0, height: size.1 };
        let (general, special) = (Resident::with(&world, Features::NONE), Resident::new(&world));
        let pair = [(&general, Features::NONE), (&special, Features::ALL)];
        let (used, differs) = compare::<f32>(pair, &camera, &options()[which], true);
        prop_assert!(used.has(Feature::Heights));
        prop_assert_eq!(differs, None);
    }

    /// Oblong worlds wider than blocks and not of whole ones, seen from within and from far outside, as they are and tiled
    /// far away, with few levels and with many.
    #[test]
    fn specialize_draws_the_same_bits_over_wide_ground(
        seed in any::<u32>(),
        (nx, nz) in (1u32..150, 1u32..150),
        (rough, pit) in (1u32..40, 0u32..3),
        at in [-0.8..1.8f64, 0.0..2.5f64, -0.8..1.8f64],
        away in prop_oneof![Just(0.0), -1e5..1e5f64],
        (yaw, pitch, roll) in (prop_oneof![0.0..360.0f64, (0u32..8).prop_map(|k| 45.0 * f64::from(k))],
            prop_oneof![Just(0.0), -90.0..90.0f64], prop_oneof![Just(0.0), -180.0..180.0f64]),
        size in (1u32..70, 1u32..60),
        (lod, distance) in (prop_oneof![Just(None), (0.5..8.0f64).prop_map(Some)], prop_oneof![100.0..3e3f64, 1e3..1e6f64]),
        (along_x, along_z, double) in (any::<bool>(), any::<bool>(), any::<bool>()),
    ) {
        let noise = |x: u32, z: u32| (x.wrapping_mul(0x9E37_79B1) ^ z.wrapping_mul(0x85EB_CA77) ^ seed).wrapping_mul(0xC2B2_AE35) >> 16;
        let world = oblong([nx, 90, nz], ColorMode::Voxel, |x, z| {
            let n = noise(x, z);
            if n % 19 < pit { 0 } else { 1 + noise(x / 16, z / 16) % 50 + n % rough }
        });
        let repeat = Repeat { x: along_x, z: along_z };
        let mut camera = camera(&world, at, yaw, pitch, roll);
        (camera.width, camera.height) = size;
        for (axis, repeats) in [(0, along_x), (2, along_z)] {
            camera.eye[axis] += if repeats { away } else { 0.0 };
        }
        // Far views of few levels visit every column on the way.
        let view_distance = if lod.is_some() { distance } else { distance.min(3e3) };
        let options = Options { lod, repeat, view_distance, ..Options::default() };
        let (general, special) = (Resident::with(&world, Features::NONE), Resident::new(&world));
        let pair = [(&general, Features::NONE), (&special, Features::ALL)];
        let (used, differs) =
            if double { compare::<f64>(pair, &camera, &options, true) } else { compare::<f32>(pair, &camera, &options, false) };
        prop_assert!(used.has(Feature::Horizon));
        prop_assert_eq!(differs, None);
    }
}
