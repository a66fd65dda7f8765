//! Worlds in tiles where it gets tight, far, or wrong: what a renderer of them shows then.

use std::path::Path;
use std::sync::{Barrier, LazyLock, Mutex};

use glam::DVec3;
use planecast_encoder::source::ReadOptions;
use planecast_encoder::source::tiles::open;
use planecast_encoder::{BuildOptions, Colors, Columns, Encoding, Input, Scene, build};

use super::mock::{Fault, Mock, bytes_of};
use super::tests::{cameras, scene};
use super::*;
use crate::cpu::renderer::{CpuRenderer, Outputs};
use crate::render::device::{Device, Renderer};
use crate::testing::noise;
use crate::{Camera, Frame, Options};

/// A scene, whole, and as it is written.
struct Whole {
    scene: Arc<Scene>,
    resident: Arc<Resident>,
    bytes: Vec<u8>,
}

impl Whole {
    fn new(scene: Scene) -> Whole {
        let resident = Arc::new(Resident::new(&scene));
        let bytes = bytes_of(&scene);
        Whole { scene: Arc::new(scene), resident, bytes }
    }

    fn tiles(&self, heights: bool) -> Arc<Mock> {
        Mock::of_bytes(self.bytes.clone(), heights, |_| false)
    }

    fn picture_at(&self, camera: &Camera, lod: f64) -> Frame {
        let options = Options { lod: Some(lod), ..Options::default() };
        CpuRenderer::new(&self.scene, &self.resident).render(camera, &options, Outputs { voxel: true }).unwrap()
    }

    fn picture(&self, camera: &Camera) -> Frame {
        self.picture_at(camera, 1.0)
    }
}

/// A world of 30 tiles, and more of its coarser levels.
fn caves() -> &'static Whole {
    static CAVES: LazyLock<Whole> = LazyLock::new(|| Whole::new(scene(true, ColorMode::Voxel, Encoding::Solid)));
    &CAVES
}

fn tiles(source: &Arc<Mock>, slots: u64, patience: Patience) -> Result<Renderer> {
    let budget = slots * slot_bytes(source.is_height_field(), source.color());
    Renderer::of_tiles(source.clone(), Device::Cpu, budget, patience, None, &mut |_| ())
}

fn draw(renderer: &mut Renderer, camera: &Camera) -> Result<Frame> {
    renderer.draw_with(camera, &Options::default(), Outputs { voxel: true }, &mut |_| ())
}

#[track_caller]
fn assert_same(is: &Frame, expected: &Frame, what: &str) {
    assert!(is.voxel == expected.voxel && is.color == expected.color && is.depth == expected.depth, "{what}");
    assert_eq!((is.stats.paging.debt, is.stats.paging.tiles_missing), (0, 0), "{what}");
}

/// Pixels that are sky in one picture and not in the other.
fn differ_in_sky(a: &Frame, b: &Frame) -> usize {
    a.depth.iter().zip(&b.depth).filter(|(a, b)| a.is_finite() != b.is_finite()).count()
}

/// A view that level 0 has many tiles of.
fn wide() -> Camera {
    Camera { eye: DVec3::new(650.0, 600.0, 550.0), pitch: -90.0, width: 960, height: 720, ..cameras()[0] }
}

#[test]
fn a_budget_below_a_views_tiles_gives_a_coarser_picture_that_stays() {
    let world = caves();
    let source = world.tiles(false);
    let mut renderer = tiles(&source, 60, Patience::Wait).unwrap();
    let first = draw(&mut renderer, &wide()).unwrap();
    let lod = first.stats.paging.lod;
    assert!(lod > 1.0 && lod < 20.0, "{:?}", first.stats.paging);
    assert_same(&first, &world.picture_at(&wide(), lod), "first");
    let asked = source.asked();
    for i in 0..4 {
        let frame = draw(&mut renderer, &wide()).unwrap();
        assert_eq!(frame.stats.paging.lod, lod, "frame {i}: a picture that flickers");
        assert!(frame.color == first.color);
    }
    assert_eq!(source.asked(), asked, "a view that stays asks for tiles");
    // A view that needs less is as sharp as it was asked for, after some frames.
    let near = Camera { eye: DVec3::new(640.0, 70.0, 500.0), pitch: -90.0, width: 64, height: 48, ..wide() };
    let last = (0..40).map(|_| draw(&mut renderer, &near).unwrap()).last().unwrap();
    assert_same(&last, &world.picture(&near), "near");
}

#[test]
fn a_budget_of_nothing_is_an_error_with_figures() {
    let world = caves();
    let source = world.tiles(false);
    for slots in [0, 5] {
        let error = tiles(&source, slots, Patience::Wait).err().unwrap().to_string();
        let allowed = slots * slot_bytes(false, ColorMode::Voxel) / 1024;
        assert!(error.starts_with("mock: 12 levels take at least "), "{error}");
        assert!(error.ends_with(&format!(" KiB of memory, {allowed} KiB are allowed")), "{error}");
    }
    assert_eq!(source.asked(), 0, "tiles are read though there is no room for them");
}

#[test]
fn a_world_whose_coarsest_tiles_are_too_much_is_an_error() {
    // One tile a level, whose runs take more than its slot: the slots fit, and what stands in them does not.
    let columns = Columns::from_fn(64, 400, 64, |x, y, z| (y + x + z) % 2 == 0);
    let input = Input { columns, colors: Colors::None, notes: Vec::new() };
    let scene = build(input, &BuildOptions::default()).unwrap();
    let source = Mock::new(&scene, false);
    let mut renderer = tiles(&source, scene.levels.len() as u64, Patience::Wait).unwrap();
    for _ in 0..2 {
        let error = draw(&mut renderer, &cameras()[0]).unwrap_err().to_string();
        assert_eq!(error, "mock: the memory allowed does not hold the tiles of one view, however coarse");
    }
    assert!(draw(&mut tiles(&source, 20, Patience::Wait).unwrap(), &cameras()[0]).is_ok());
}

#[test]
fn an_eye_that_jumps_each_frame_sees_what_is_there() {
    let world = caves();
    let source = world.tiles(false);
    let camera = |i: u32| {
        let at = |k: u32, from: f64, to: f64| from + (to - from) * f64::from(noise(i, k, 4) % 1000) / 1000.0;
        let eye = DVec3::new(at(0, -50.0, 1350.0), at(1, 60.0, 300.0), at(2, -50.0, 1150.0));
        Camera { eye, yaw: at(3, 0.0, 360.0), pitch: at(4, -80.0, 5.0), width: 80, height: 60, ..cameras()[0] }
    };
    let mut waits = tiles(&source, 100, Patience::Wait).unwrap();
    let mut hurries = tiles(&source, 100, Patience::Deadline(0.0)).unwrap();
    let mut evicted = 0;
    for i in 0..12 {
        let expected = world.picture(&camera(i));
        let frame = draw(&mut waits, &camera(i)).unwrap();
        assert_same(&frame, &expected, &format!("frame {i}"));
        evicted += frame.stats.paging.tiles_evicted;
        // At once, from whatever there is: as whole as it should be, but for edges.
        let frame = draw(&mut hurries, &camera(i)).unwrap();
        let off = differ_in_sky(&frame, &expected);
        assert!(off < 400, "frame {i}: {off} of 4,800 pixels are sky in one and not in the other");
    }
    assert!(evicted > 0, "a budget that holds all shows nothing");
    // Once it rests, it is sharp.
    let expected = world.picture(&camera(11));
    for turn in 0.. {
        let frame = draw(&mut hurries, &camera(11)).unwrap();
        if frame.stats.paging.tiles_missing == 0 {
            assert_same(&frame, &expected, "at rest");
            break;
        }
        assert!(turn < 100_000, "the tiles never came");
        std::thread::yield_now();
    }
}

#[test]
fn the_far_corner_of_a_world_without_end_is_where_it_should_be() {
    let name = Path::new("procedural:hills?size=inf&seed=1");
    let source = open(name, &ReadOptions::default()).unwrap().unwrap();
    let end = 1u32 << 30;
    assert_eq!(source.dims(), [end, 1024, end]);
    let mut renderer =
        Renderer::of_tiles(source.clone(), Device::Cpu, 256 << 20, Patience::Wait, None, &mut |_| ()).unwrap();
    let corner = source.tile(TileKey { level: 0, x: end / TILE - 1, z: end / TILE - 1 }).unwrap();
    let top = |x: u32, z: u32| {
        let run = corner.solid.column(x % TILE, z % TILE).last();
        run.map(|run| i32::from(run.last()))
    };
    // Straight down on the corner itself: a quarter of the picture is world. And from beside it.
    for (eye, least) in [([end; 2], 800), ([end - 40; 2], 2500), ([end - 1, end - 100], 1500)] {
        let eye = DVec3::new(f64::from(eye[0]), 1000.0, f64::from(eye[1]));
        let camera = Camera { eye, yaw: 0.0, pitch: -90.0, roll: 0.0, fov: 3.0, width: 64, height: 64 };
        let frame = draw(&mut renderer, &camera).unwrap();
        assert_eq!((frame.stats.paging.debt, frame.stats.paging.lod), (0, 1.0));
        let mut seen = 0;
        for &[x, y, z, level] in frame.voxel.iter().filter(|voxel| voxel[3] >= 0) {
            assert!([x, z].iter().all(|&v| (end - TILE..end).contains(&(v as u32))), "({x}, {z}) is outside");
            assert_eq!(level, 0);
            // A wall's voxel lies below its top.
            assert!(top(x as u32, z as u32).is_some_and(|top| y <= top && y > top - 12), "({x}, {y}, {z})");
            seen += 1;
        }
        assert!(seen >= least, "{eye}: {seen} pixels show the world");
        assert_eq!(seen, frame.depth.iter().filter(|z| z.is_finite()).count());
    }
    // Outward there is nothing.
    let eye = DVec3::new(f64::from(end), 1000.0, f64::from(end) - 50.0);
    let out = Camera { eye, yaw: 90.0, pitch: 0.0, roll: 0.0, fov: 60.0, width: 32, height: 32 };
    assert!(draw(&mut renderer, &out).unwrap().depth.iter().all(|z| z.is_infinite()));
}

#[test]
fn eyes_outside_of_a_world_see_it_as_a_whole_one_is_seen() {
    let world = caves();
    let source = world.tiles(false);
    let mut renderer = tiles(&source, 400, Patience::Wait).unwrap();
    let pose = |eye: [f64; 3], yaw: f64, pitch: f64| Camera { eye: eye.into(), yaw, pitch, ..cameras()[0] };
    let beyond = -f64::from(1 << 30);
    let poses = [
        pose([-40.0, 60.0, -70.0], 135.0, -10.0),
        pose([-3000.25, 900.0, -2500.75], 130.0, -12.0),
        pose([650.0, -300.0, 500.0], 20.0, 60.0),
        pose([1400.0, 50.0, -0.5], 225.0, -5.0),
        pose([-40.0, 60.0, -70.0], 315.0, -10.0),
        pose([beyond, 100.0, beyond], 135.0, 0.0),
    ];
    let seen = poses.iter().enumerate().map(|(i, camera)| {
        let frame = draw(&mut renderer, camera).unwrap();
        assert_same(&frame, &world.picture(camera), &format!("pose {i}"));
        frame.depth.iter().filter(|z| z.is_finite()).count()
    });
    let seen: Vec<usize> = seen.collect();
    assert!(seen[..4].iter().all(|&n| n > 40) && seen[4] == 0, "{seen:?}");
}

#[test]
fn columns_of_as_many_runs_as_fit_are_drawn() {
    let solid = |x: u32, y: u32, z: u32| if (x + z) % 3 == 1 { y.is_multiple_of(2) } else { y < 30_000 };
    let columns = Columns::from_fn(48, 65_536, 3, solid);
    assert_eq!(columns.column(1, 0).len(), 32_768);
    let of = |x, y, z| noise(x, y, z).to_le_bytes()[..3].try_into().unwrap();
    let input = Input { columns, colors: Colors::Function(Box::new(of)), notes: Vec::new() };
    let world =
        Whole::new(build(input, &BuildOptions { color: Some(ColorMode::Run), ..BuildOptions::default() }).unwrap());
    let source = world.tiles(false);
    let mut renderer = tiles(&source, 100, Patience::Wait).unwrap();
    for (height, pitch) in [(29_990.0, -20.0), (65_560.0, -35.0), (40_000.5, 0.0), (-20.0, 50.0)] {
        let eye = DVec3::new(-30.0, height, 1.5);
        let camera = Camera { eye, yaw: 90.0, pitch, ..cameras()[0] };
        let frame = draw(&mut renderer, &camera).unwrap();
        assert_same(&frame, &world.picture(&camera), &format!("from {height}"));
        assert!(frame.depth.iter().filter(|z| z.is_finite()).count() > 100, "from {height}");
    }
}

#[test]
fn two_renderers_of_one_source_draw_what_each_would_alone() {
    let world = caves();
    let source = world.tiles(false);
    let both = Barrier::new(2);
    let drawn = |first: usize| -> Vec<(usize, Frame)> {
        let mut renderer = tiles(&source, 90, Patience::Wait).unwrap();
        both.wait();
        let n = cameras().len();
        let turn = (0..n).map(|i| (first + i) % n);
        turn.map(|i| (i, draw(&mut renderer, &cameras()[i]).unwrap())).collect()
    };
    let frames = std::thread::scope(|scope| {
        let other = scope.spawn(|| drawn(3));
        [drawn(0), other.join().unwrap()].concat()
    });
    assert_eq!(frames.len(), 2 * cameras().len());
    for (i, frame) in frames {
        assert_same(&frame, &world.picture(&cameras()[i]), &format!("camera {i}"));
    }
}

#[test]
fn a_source_that_goes_and_comes_back_costs_frames_and_nothing_else() {
    for fault in [Fault::Out, Fault::Panics, Fault::Small] {
        let world = caves();
        let source = world.tiles(false);
        let mut renderer = tiles(&source, 500, Patience::Wait).unwrap();
        let [near, far] = [cameras()[1], cameras()[0]];
        let expected = [near, far].map(|camera| world.picture(&camera));
        assert_same(&draw(&mut renderer, &near).unwrap(), &expected[0], "before");
        // All of it goes. The next view is stood in for, or refused, and no more than that.
        source.set(move |_| Some(fault));
        let mut said = Vec::new();
        let mut tell = |what: &str| said.push(what.to_owned());
        match renderer.draw_with(&far, &Options::default(), Outputs::default(), &mut tell) {
            Ok(frame) => {
                assert!(frame.stats.paging.debt > 0 && differ_in_sky(&frame, &expected[1]) < 200);
                assert!(!said.is_empty());
            }
            Err(e) => {
                let what = match fault {
                    Fault::Out => "is out",
                    Fault::Panics => "could not be made",
                    Fault::Small => "were expected",
                };
                assert!(e.to_string().contains(what), "{e}");
                // What was seen before is there still.
                assert_same(&draw(&mut renderer, &near).unwrap(), &expected[0], "meanwhile");
            }
        }
        source.set(|_| None);
        assert_same(&draw(&mut renderer, &far).unwrap(), &expected[1], "afterwards");
    }
}

#[test]
fn a_view_that_needs_larger_tables_keeps_what_is_there() {
    let world = caves();
    let source = world.tiles(false);
    let mut renderer = tiles(&source, 500, Patience::Wait).unwrap();
    let near = Camera { width: 32, height: 24, pitch: -90.0, eye: DVec3::new(300.0, 70.0, 300.0), ..cameras()[0] };
    let expected = [near, wide()].map(|camera| world.picture(&camera));
    assert_same(&draw(&mut renderer, &near).unwrap(), &expected[0], "before");
    source.set(|_| Some(Fault::Out));
    for _ in 0..2 {
        let frame = draw(&mut renderer, &wide()).unwrap();
        assert!(frame.stats.paging.debt > 0);
        let frame = draw(&mut renderer, &near).unwrap();
        assert_same(&frame, &expected[0], "meanwhile");
        assert_eq!((frame.stats.paging.tiles_arrived, frame.stats.paging.debt), (0, 0));
    }
    source.set(|_| None);
    assert_same(&draw(&mut renderer, &wide()).unwrap(), &expected[1], "afterwards");
}

#[test]
fn a_source_that_panics_for_a_tile_that_stays_is_an_error() {
    let world = caves();
    let source = world.tiles(false);
    source.set(|key| (key.level == 5).then_some(Fault::Panics));
    let error = tiles(&source, 500, Patience::Wait).err().unwrap().to_string();
    assert_eq!(error, "mock: tile (0, 0) of level 5 could not be made");
    source.set(|key| (key.level == 5).then_some(Fault::Small));
    let error = tiles(&source, 500, Patience::Wait).err().unwrap().to_string();
    assert_eq!(error, "mock: tile (0, 0) of level 5 has 40 × 35 columns, 41 × 35 were expected");
}

#[test]
fn tiles_are_asked_for_once_however_the_frames_wait() {
    let scene = scene(false, ColorMode::Run, Encoding::Solid);
    for patience in [Patience::Wait, Patience::Deadline(0.0), Patience::Deadline(3.0)] {
        let source = Mock::new(&scene, true);
        let mut renderer = tiles(&source, 500, patience).unwrap();
        // It turns so little that the tables stay as large as they are.
        let view = Camera { width: 480, height: 320, ..cameras()[0] };
        let camera = |turn: u32| Camera { yaw: 30.0 + f64::from(turn % 2), ..view };
        for turn in 0.. {
            // The next frame is known: its tiles are asked for ahead.
            let two = [camera(turn), camera(turn + 1)];
            let frame = renderer.draw_first(&two, &Options::default(), Outputs::default(), &mut |_| ()).unwrap();
            if turn > 3 && frame.stats.paging.tiles_missing == 0 {
                break;
            }
            assert!(turn < 100_000, "the tiles never came");
            std::thread::yield_now();
        }
        // Those that stay are read when the tables are made.
        let comes = |key: &TileKey| grids(source.dims())[key.level as usize].n_tiles() > PINNED;
        let asked: Vec<(TileKey, u32)> =
            all_tiles(&source).filter(comes).map(|key| (key, source.asked_for(key))).filter(|&(_, n)| n > 0).collect();
        assert!(asked.len() > 5 && asked.iter().all(|&(_, n)| n == 1), "{patience:?}: {asked:?}");
    }
}

fn all_tiles(source: &Arc<Mock>) -> impl Iterator<Item = TileKey> + use<> {
    (0..).zip(grids(source.dims())).flat_map(|(level, grid)| {
        let [tx, tz] = grid.tiles;
        (0..tz).flat_map(move |z| (0..tx).map(move |x| TileKey { level, x, z }))
    })
}

#[test]
fn a_tile_that_shows_that_heights_do_not_do_costs_no_more_slots_than_runs_may_have() {
    // Flat, but for a gap that is so thin that no coarser level has it.
    let solid = |x: u32, y: u32, z: u32| y < 20 && !(y == 7 && x / TILE == 4 && z / TILE == 3);
    let columns = Columns::from_fn(1300, 64, 1100, solid);
    let input = Input { columns, colors: Colors::None, notes: Vec::new() };
    let world = Whole::new(build(input, &BuildOptions::default()).unwrap());
    let source = world.tiles(true);
    // Heights take a quarter of what runs take: the slots of a view as heights are more than the budget has as runs.
    let mut renderer = tiles(&source, 110, Patience::Wait).unwrap();
    let frame = draw(&mut renderer, &wide()).unwrap();
    let lod = frame.stats.paging.lod;
    assert!(lod > 1.0 && lod < 20.0, "{lod}");
    assert_same(&frame, &world.picture_at(&wide(), lod), "coarser, and whole");
}

#[test]
fn a_frame_that_waits_asks_three_times_and_no_more() {
    let world = caves();
    // Another answer each time, from whichever thread.
    for fails in [2, 3] {
        let source = world.tiles(false);
        let answers = Mutex::new(HashMap::<TileKey, u32>::new());
        source.set(move |key| {
            let mut answers = answers.lock().unwrap();
            let n = answers.entry(key).or_default();
            *n += 1;
            (key.level < 2 && *n <= fails).then_some(Fault::Out)
        });
        let mut renderer = tiles(&source, 500, Patience::Wait).unwrap();
        let frame = draw(&mut renderer, &cameras()[0]).unwrap();
        let asked: Vec<u32> =
            all_tiles(&source).filter(|key| key.level == 0).map(|key| source.asked_for(key)).collect();
        assert!(asked.contains(&3) && asked.iter().all(|&n| n == 0 || n == 3), "{asked:?}");
        assert_eq!(frame.stats.paging.debt > 0, fails == 3);
        assert_same(&draw(&mut renderer, &cameras()[0]).unwrap(), &world.picture(&cameras()[0]), "afterwards");
    }
}
