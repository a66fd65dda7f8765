//! Small worlds, poses and comparison for the renderer's tests. Nothing here needs a file.
#![allow(dead_code, reason = "each test binary uses a part")]

pub mod any;
pub mod compare;

use std::sync::Arc;

use glam::DVec3;
use planecast::{Camera, CpuRenderer, Culling, Frame, Options, Outputs, Resident, Shading};
use planecast_encoder::{BuildOptions, ColorMode, Colors, Columns, Encoding, Input, Scene, build};

/// A scene by name.
pub struct World {
    pub name: &'static str,
    pub scene: Arc<Scene>,
    pub resident: Arc<Resident>,
}

impl World {
    /// Solid where `solid(x, y, z)`; each voxel has a colour of its own.
    pub fn new(name: &'static str, dims: [u32; 3], solid: impl Fn(u32, u32, u32) -> bool + Sync) -> World {
        World::encoded(name, dims, &BuildOptions::default(), solid)
    }

    pub fn encoded(
        name: &'static str,
        [nx, ny, nz]: [u32; 3],
        options: &BuildOptions,
        solid: impl Fn(u32, u32, u32) -> bool + Sync,
    ) -> World {
        let columns = Columns::from_fn(nx, ny, nz, solid);
        let colors = Colors::Function(Box::new(|x, y, z| color_of([x as i32, y as i32, z as i32])));
        let scene = build(Input { columns, colors, notes: Vec::new() }, options).unwrap();
        let resident = Arc::new(Resident::new(&scene));
        World { name, scene: Arc::new(scene), resident }
    }

    pub fn dims(&self) -> [u32; 3] {
        self.scene.dims()
    }

    pub fn renderer(&self) -> CpuRenderer {
        CpuRenderer::new(&self.scene, &self.resident)
    }

    pub fn render(&self, camera: &Camera, options: &Options) -> Frame {
        self.renderer().render(camera, options, Outputs { voxel: true }).unwrap()
    }

    pub fn exact(&self, camera: &Camera, options: &Options) -> Frame {
        self.renderer().exact(camera, options, Outputs { voxel: true }).unwrap()
    }

    /// A place `above` voxels over the highest solid voxel of column `(x, z)`.
    pub fn over(&self, x: f64, z: f64, above: f64) -> DVec3 {
        let top = self.scene.levels[0].solid.column(x as u32, z as u32).last().map_or(0, |r| r.end());
        DVec3::new(x, f64::from(top) + above, z)
    }

    /// Whether the eye is in a solid voxel.
    pub fn buries(&self, eye: DVec3) -> bool {
        let cell = eye.floor();
        self.scene.levels[0].solid.solid(cell.x as i64, cell.y as i64, cell.z as i64)
    }
}

/// Level 0 alone, colours as stored: what is compared with `exact`.
pub fn plain() -> Options {
    Options { lod: None, shading: Shading::None, ..Options::default() }
}

/// The colour that test worlds give a voxel.
pub fn color_of(voxel: [i32; 3]) -> [u8; 3] {
    let [r, g, b, _] = hash(7, voxel).to_le_bytes();
    [r, g, b]
}

/// A well-mixed word from a seed and a place (murmur3's finaliser over a linear mix).
pub fn hash(seed: u32, [x, y, z]: [i32; 3]) -> u32 {
    let mut h = seed.wrapping_mul(0x9E37_79B9)
        ^ (x as u32).wrapping_mul(0x8DA6_B343)
        ^ (y as u32).wrapping_mul(0xD816_3841)
        ^ (z as u32).wrapping_mul(0xCB1A_B31F);
    h = (h ^ (h >> 16)).wrapping_mul(0x85EB_CA6B);
    h = (h ^ (h >> 13)).wrapping_mul(0xC2B2_AE35);
    h ^ (h >> 16)
}

/// Seeded numbers for poses.
pub struct Random(u32);

impl Random {
    pub fn new(seed: u32) -> Random {
        Random(seed.wrapping_mul(0x1000_0001))
    }

    pub fn word(&mut self) -> u32 {
        self.0 = self.0.wrapping_add(1);
        hash(self.0, [0x51, 0x07, 0x33])
    }

    /// From `from` up to `to`.
    pub fn within(&mut self, from: f64, to: f64) -> f64 {
        from + (to - from) * f64::from(self.word()) / f64::from(u32::MAX)
    }

    pub fn choose<T: Copy>(&mut self, from: &[T]) -> T {
        from[self.word() as usize % from.len()]
    }
}

/// Smooth noise in 0 ..= 1 over lattice cells of `size` voxels, periodic in x and z with `period` cells.
fn noise(seed: u32, [x, y, z]: [f64; 3], size: f64, period: i32) -> f64 {
    let p = [x / size, y / size, z / size];
    let cell = p.map(|v| v.floor() as i32);
    let f: [f64; 3] = std::array::from_fn(|i| {
        let t = p[i] - p[i].floor();
        t * t * (3.0 - 2.0 * t)
    });
    let mut sum = 0.0;
    for corner in 0..8 {
        let d = [corner & 1, corner >> 1 & 1, corner >> 2];
        let weight: f64 = (0..3).map(|i| if d[i] == 1 { f[i] } else { 1.0 - f[i] }).product();
        let at = [(cell[0] + d[0]).rem_euclid(period), cell[1] + d[1], (cell[2] + d[2]).rem_euclid(period)];
        sum += weight * f64::from(hash(seed, at)) / f64::from(u32::MAX);
    }
    sum
}

/// Height of the hills' ground, about 4 to 44 voxels; periodic where sizes are multiples of 32.
fn ground(x: u32, z: u32, [nx, ..]: [u32; 3]) -> f64 {
    let n =
        |size: f64, seed| noise(seed, [f64::from(x), 0.5, f64::from(z)], size, (f64::from(nx) / size).ceil() as i32);
    4.0 + 28.0 * n(32.0, 1) + 8.0 * n(8.0, 2) + 4.0 * n(4.0, 3)
}

pub const MEDIUM: [u32; 3] = [128, 64, 128];

pub fn hills(dims: [u32; 3]) -> World {
    World::new("hills", dims, move |x, y, z| f64::from(y) < ground(x, z, dims))
}

/// Hills with tunnels and overhangs.
pub fn caves() -> World {
    World::new("caves", MEDIUM, |x, y, z| {
        let carved = noise(4, [f64::from(x), f64::from(y), f64::from(z)], 12.0, 1 << 20) > 0.55;
        f64::from(y) < ground(x, z, MEDIUM) + 14.0 && !(carved && y > 2)
    })
}

/// Hills under floating rocks.
pub fn rocks() -> World {
    World::new("floating rocks", MEDIUM, |x, y, z| {
        let rock = |i: i32| {
            let at = |axis, n: u32| i64::from(hash(5, [i, axis, 0]) % n);
            let r = 2 + i64::from(hash(6, [i, 0, 0]) % 6);
            let d = [i64::from(x) - at(0, 128), i64::from(y) - 36 - at(1, 20), i64::from(z) - at(2, 128)];
            d.iter().map(|v| v * v).sum::<i64>() <= r * r
        };
        f64::from(y) < 0.6 * ground(x, z, MEDIUM) || (0..24).any(rock)
    })
}

/// A height of its own for each column.
pub fn rough() -> World {
    World::new("rough", MEDIUM, |x, y, z| y < 8 + hash(12, [x as i32, 0, z as i32]) % 24)
}

/// One voxel in six, without order, over a floor.
pub fn noisy() -> World {
    World::new("white noise", MEDIUM, |x, y, z| y == 0 || hash(13, [x as i32, y as i32, z as i32]).is_multiple_of(6))
}

/// Boxes of 2 to 25 voxels a side that stand, hang and meet over a floor.
pub fn blocks() -> World {
    World::new("boxes", MEDIUM, |x, y, z| {
        let inside = |i: i32| {
            (0..3).all(|axis| {
                let from = (hash(9, [i, axis, 0]) % [120, 50, 120][axis as usize]) as i32;
                let size = 2 + (hash(9, [i, axis, 1]) % 24) as i32;
                (from..from + size).contains(&([x, y, z][axis as usize] as i32))
            })
        };
        y < 3 || (0..40).any(inside)
    })
}

/// Menger's sponge, four times divided.
pub fn sponge() -> World {
    World::new("sponge", [81; 3], |x, y, z| {
        (0..4).all(|k| [x, y, z].iter().filter(|&&v| v / 3u32.pow(k) % 3 == 1).count() < 2)
    })
}

/// A pole, a wall, a beam, a slab and 80 voxels, each by itself.
pub fn single_things() -> World {
    World::new("single things", MEDIUM, |x, y, z| {
        let p = [x, y, z].map(|v| v as i32);
        let voxel = |i: i32| p == [0, 1, 2].map(|axis| (hash(10, [i, axis, 0]) % [128, 64, 128][axis as usize]) as i32);
        (x == 40 && z == 70 && y < 50)
            || (x == 90 && (20..100).contains(&z) && y < 20)
            || (y == 40 && z == 50 && (10..120).contains(&x))
            || (y == 5 && (50..80).contains(&x) && (90..120).contains(&z))
            || (0..80).any(voxel)
    })
}

/// Every second voxel, so that no two share a face.
pub fn checkerboard() -> World {
    World::new("checkerboard", [32, 16, 32], |x, y, z| (x + y + z) % 2 == 0)
}

/// One voxel in 300.
pub fn dust() -> World {
    World::new("dust", [64, 48, 64], |x, y, z| hash(8, [x as i32, y as i32, z as i32]).is_multiple_of(300))
}

pub fn staircase() -> World {
    World::new("staircase", [64, 64, 64], |x, y, z| y <= x && (y + 6 >= x || z < 20))
}

/// Sheets one voxel thick, across each axis.
pub fn sheets() -> World {
    World::new("sheets", [64, 48, 64], |x, y, z| {
        (z % 16 == 9 && y < 30 && x > 8) || (y % 12 == 5 && x < 40 && z > 20) || (x == 50 && y < 40 && z < 50)
    })
}

/// Columns one voxel wide.
pub fn poles() -> World {
    World::new("poles", [64, 64, 64], |x, y, z| y == 0 || (x % 8 == 3 && z % 8 == 5 && y < 40 + x / 8))
}

pub fn single_voxel() -> World {
    World::new("single voxel", [33, 17, 41], |x, y, z| [x, y, z] == [16, 8, 20])
}

pub fn empty() -> World {
    World::new("empty", [40, 20, 24], |_, _, _| false)
}

pub fn full() -> World {
    World::new("full", [24, 20, 40], |_, _, _| true)
}

/// Closed on all six sides, with pillars and a beam in it.
pub fn room() -> World {
    World::new("room", [28, 18, 22], |x, y, z| {
        let shell = [x, y, z].contains(&0) || x == 27 || y == 17 || z == 21;
        shell || (x % 9 == 5 && z % 7 == 4) || (y == 12 && z == 10)
    })
}

/// Neither side a power of two.
pub fn odd() -> World {
    let dims = [77, 40, 53];
    World::encoded(
        "odd sizes, surface, run colours",
        dims,
        &BuildOptions { encoding: Encoding::Surface, color: Some(ColorMode::Run), ..BuildOptions::default() },
        move |x, y, z| f64::from(y) < 0.7 * ground(x, z, dims) || (y == 36 && (x / 5 + z / 3) % 4 == 0),
    )
}

/// Without colours.
pub fn bare() -> World {
    World::encoded(
        "surface, no colours",
        [48, 32, 48],
        &BuildOptions { encoding: Encoding::Surface, color: Some(ColorMode::None), ..BuildOptions::default() },
        |x, y, z| y < 6 + (x * z / 40) % 14 || (y > 24 && (x / 4 + z / 4) % 3 == 0),
    )
}

/// All small and medium worlds.
pub fn worlds() -> Vec<World> {
    vec![
        hills(MEDIUM),
        caves(),
        rocks(),
        checkerboard(),
        dust(),
        staircase(),
        sheets(),
        poles(),
        single_voxel(),
        empty(),
        full(),
        room(),
        odd(),
        bare(),
    ]
}

/// A camera and where it came from.
#[derive(Clone, Debug)]
pub struct Pose {
    pub name: String,
    pub kind: Kind,
    pub camera: Camera,
}

/// Which bound a pose falls under.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// Pitch and roll 0: planes are pixel columns.
    Level,
    Turned,
    /// Voxels project to about a pixel.
    Far,
}

pub fn camera(eye: DVec3, [yaw, pitch, roll]: [f64; 3], [width, height]: [u32; 2]) -> Camera {
    Camera { eye, yaw, pitch, roll, fov: 60.0, width, height }
}

/// Standing poses over a world: level, tilted, straight up and down, rolled, near a surface, far, beside, above, below.
/// None has its eye in a solid voxel.
pub fn poses(world: &World, size: [u32; 2]) -> Vec<Pose> {
    let [nx, ny, nz] = world.dims().map(f64::from);
    let eye = world.over((nx * 0.45).floor() + 0.37, (nz * 0.55).floor() + 0.61, 3.3);
    let low = world.over((nx * 0.7).floor() + 0.08, (nz * 0.3).floor() + 0.93, 0.2);
    let mut poses = Vec::new();
    let mut add = |name: &str, kind, eye: DVec3, turn: [f64; 3]| {
        let [yaw, pitch, roll] = turn;
        let name = format!("{name}, yaw {yaw} pitch {pitch} roll {roll}");
        poses.push(Pose { name, kind, camera: camera(eye, turn, size) });
    };
    for yaw in [0.0, 31.0, 45.0, 90.0, 134.3, 180.0, 201.7, 270.0, 313.0, 359.999] {
        add("inside", Kind::Level, eye, [yaw, 0.0, 0.0]);
    }
    for (k, pitch) in [-0.3, 4.0, -12.0, -35.0, 28.0, -58.0, 60.0, -77.0, 82.0, -89.9].into_iter().enumerate() {
        add("inside", Kind::Turned, eye, [37.0 * k as f64, pitch, 0.0]);
    }
    for pitch in [-90.0, 90.0] {
        for (yaw, roll) in [(0.0, 0.0), (23.0, 0.0), (0.0, 45.0)] {
            add("inside", Kind::Turned, eye, [yaw, pitch, roll]);
        }
    }
    for (pitch, roll) in [(0.0, 11.0), (0.0, 45.0), (0.0, 90.0), (0.0, 180.0), (-24.0, 30.0), (15.0, -100.0)] {
        add("inside", Kind::Turned, eye, [70.0 + pitch, pitch, roll]);
    }
    add("near a surface", Kind::Level, low, [250.0, 0.0, 0.0]);
    add("near a surface", Kind::Turned, low, [20.0, -40.0, 5.0]);
    let middle = DVec3::new(nx, ny, nz) / 2.0;
    add("beside", Kind::Level, DVec3::new(-0.4 * nx, 0.6 * ny, 0.4 * nz), [80.0, 0.0, 0.0]);
    // From half a world beside it on, most voxels are less than two pixels wide.
    add("beside", Kind::Far, DVec3::new(1.3 * nx, 0.9 * ny, 1.2 * nz), [315.0, -18.0, 0.0]);
    add("above", Kind::Turned, middle + DVec3::Y * 1.5 * ny, [10.0, -62.0, 0.0]);
    add("above", Kind::Turned, middle + DVec3::new(0.25, 1.5 * ny, 0.25), [0.0, -90.0, 0.0]);
    add("below", Kind::Turned, middle - DVec3::Y * 1.2 * ny, [130.0, 55.0, 0.0]);
    add("below", Kind::Turned, middle - DVec3::new(0.25, 1.2 * ny, 0.25), [0.0, 90.0, 20.0]);
    // At depth `focal` a voxel is one pixel.
    let far = camera(eye, [0.0; 3], size).focal();
    add("far", Kind::Far, middle + DVec3::new(0.3, 0.35 * far, far), [0.0, -19.0, 0.0]);
    add("far", Kind::Far, middle + DVec3::new(-0.8 * far, 0.5 * far, 0.2), [92.0, -31.0, 8.0]);
    poses
}

/// More of them, for a wide sweep: far off from each side with voxels of one and two pixels, and anywhere.
pub fn wide_poses(world: &World, size: [u32; 2]) -> Vec<Pose> {
    let mut list = poses(world, size);
    let [nx, ny, nz] = world.dims().map(f64::from);
    let middle = DVec3::new(nx, ny, nz) / 2.0;
    let mut add = |name: &str, eye: DVec3, turn: [f64; 3]| {
        let [yaw, pitch, roll] = turn;
        let name = format!("{name}, yaw {yaw:.1} pitch {pitch:.1} roll {roll:.1}");
        list.push(Pose { name, kind: Kind::Turned, camera: camera(eye, turn, size) });
    };
    // At depth `focal` a voxel is one pixel.
    let focal = camera(middle, [0.0; 3], size).focal();
    for (name, far) in [("2 px", 0.5 * focal), ("1 px", focal)] {
        add(name, middle + DVec3::new(0.3, far, 0.2), [0.0, -90.0, 0.0]);
        add(name, middle + DVec3::new(0.3, far, 0.2), [33.0, -90.0, 10.0]);
        add(name, middle - DVec3::new(0.3, far, 0.2), [33.0, 90.0, 10.0]);
        add(name, middle + DVec3::new(far, 0.1, 0.2), [270.0, 0.0, 30.0]);
        add(name, middle + DVec3::new(0.6, 0.7, 0.4) * far, [-56.0, -44.0, 0.0]);
        add(name, middle + DVec3::new(-0.6, 0.7, 0.4) * far, [56.0, -44.0, 45.0]);
    }
    let mut random = Random::new(21);
    for _ in 0..12 {
        let (eye, turn) = loop {
            let place = [(-0.2, 1.2), (0.0, 1.6), (-0.2, 1.2)].map(|(from, to)| random.within(from, to));
            let turn = [(0.0, 360.0), (-90.0, 60.0), (-180.0, 180.0)].map(|(from, to)| random.within(from, to));
            let eye = DVec3::from_array(place) * DVec3::new(nx, ny, nz);
            if !world.buries(eye) {
                break (eye, turn);
            }
        };
        add("anywhere", eye, turn);
    }
    list
}

/// All 32 combinations of culling switches.
pub fn cullings() -> impl Iterator<Item = Culling> {
    (0..32u32).map(|bits| {
        let on = |k: u32| bits >> k & 1 == 1;
        Culling { horizon: on(0), center: on(1), forward: on(2), bits: on(3), coarse: on(4) }
    })
}
