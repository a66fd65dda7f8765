//! Faults that renderers of this family are known for, each with cases that would show it, and a check that catches it where
//! it is planted; on the CPU and with every kernel of a GPU. (Where they were seen: Voxlap, its ports, the CUDA code of Forstmann & Ohya, and what their authors write.)

use glam::DVec3;
use planecast::cpu::remap::Row;
use planecast::frame::plane_setup::{Setup, plane_setup};
use planecast::measure::stability::measure::{off, sane};
use planecast::measure::stability::{Drawer, World, WorldName};
use planecast::{Camera, Frame, Options, Repeat, Shading};

/// One for all: renderers that share a device compile each shader once.
#[cfg(feature = "gpu")]
static GPU: std::sync::LazyLock<planecast::gpu::present::Device> =
    std::sync::LazyLock::new(|| planecast::gpu::present::Device::headless().unwrap());

const SKY: [i32; 4] = [-1; 4];

fn plain() -> Options {
    Options { lod: None, shading: Shading::None, ..Options::default() }
}

fn without_end(view_distance: f64) -> Options {
    Options { lod: Some(1.0), repeat: Repeat { x: true, z: true }, view_distance, ..plain() }
}

fn camera(eye: [f64; 3], [yaw, pitch, roll]: [f64; 3]) -> Camera {
    Camera { eye: DVec3::from(eye), yaw, pitch, roll, fov: 60.0, width: 80, height: 60 }
}

fn draw(world: &World, camera: &Camera, options: &Options) -> Frame {
    let frame = (Drawer::cpu(world).draw)(camera, options).unwrap();
    assert_eq!(sane(&frame), Ok(()), "{camera:?}");
    frame
}

/// All that draws a world: the CPU each picture, and of the kernels of a GPU one after the other one each `every` pictures.
struct Draws<'a> {
    drawers: Vec<Drawer<'a>>,
    every: usize,
    asked: usize,
}

impl<'a> Draws<'a> {
    fn new(world: &'a World, every: usize) -> Draws<'a> {
        let drawers = std::iter::once(Drawer::cpu(world)).chain(gpu(world)).collect();
        Draws { drawers, every, asked: 0 }
    }

    /// The CPU's frame first. What a GPU refuses for its size (views of seconds) is not among them.
    fn frames(&mut self, camera: &Camera, options: &Options) -> Vec<Frame> {
        let kernels = self.drawers.len() - 1;
        let kernel =
            (kernels > 0 && self.asked.is_multiple_of(self.every)).then(|| 1 + self.asked / self.every % kernels);
        self.asked += 1;
        let mut frames = Vec::new();
        for k in std::iter::once(0).chain(kernel) {
            match (self.drawers[k].draw)(camera, options) {
                Ok(frame) => {
                    assert_eq!(sane(&frame), Ok(()), "{} {camera:?}", self.drawers[k].kernel);
                    frames.push(frame);
                }
                Err(planecast::Error::Limit(_)) if k > 0 => {}
                Err(e) => panic!("{}: {e}", self.drawers[k].kernel),
            }
        }
        frames
    }
}

#[cfg(feature = "gpu")]
fn gpu(world: &World) -> Vec<Drawer<'_>> {
    if std::env::var_os("PLANECAST_NO_GPU").is_some_and(|v| v == "1") {
        eprintln!("without a GPU: PLANECAST_NO_GPU=1");
        return Vec::new();
    }
    planecast::Kernel::ALL.map(|kernel| Drawer::gpu(&GPU, world, kernel, true).unwrap()).into()
}

#[cfg(not(feature = "gpu"))]
fn gpu(_: &World) -> Vec<Drawer<'_>> {
    Vec::new()
}

fn exact(world: &World, camera: &Camera, options: &Options) -> Frame {
    (Drawer::exact(world).draw)(camera, options).unwrap()
}

/// Numbers in 0 .. 1, the same every time (Weyl's sequence: well spread in two and three dimensions).
struct Spread(u32);

impl Spread {
    fn next(&mut self, from: f64, to: f64) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9);
        let h = (self.0 ^ (self.0 >> 15)).wrapping_mul(0x2C1B_3C6D);
        from + (to - from) * f64::from(h ^ (h >> 12)) / f64::from(u32::MAX)
    }

    fn turn(&mut self) -> [f64; 3] {
        [self.next(0.0, 360.0), self.next(-90.0, 90.0), self.next(-180.0, 180.0)]
    }
}

fn around(frame: &Frame, i: usize) -> impl Iterator<Item = usize> + use<> {
    let (w, h) = (frame.width as usize, frame.height as usize);
    let near = |v: usize, n: usize| v.saturating_sub(1)..(v + 2).min(n);
    near(i / w, h).flat_map(move |y| near(i % w, w).map(move |x| y * w + x))
}

fn sky(frame: &Frame) -> usize {
    frame.voxel.iter().filter(|&&v| v == SKY).count()
}

/// Pixels on the wrong side of a silhouette by more than `reach` pixels.
fn notches(frame: &Frame, exact: &Frame, reach: usize) -> usize {
    let (w, h) = (frame.width as usize, frame.height as usize);
    let near = |v: usize| v - reach..=v + reach;
    let wrong = |&(x, y): &(usize, usize)| {
        let is_sky = frame.voxel[y * w + x] == SKY;
        near(y).all(|y| near(x).all(|x| (exact.voxel[y * w + x] == SKY) != is_sky))
    };
    // What lies beyond the image's edge is not known.
    let inner = (reach..h - reach).flat_map(|y| (reach..w - reach).map(move |x| (x, y)));
    inner.filter(wrong).count()
}

#[test]
fn silhouettes_have_no_notches() {
    let world = WorldName::Full.make();
    let mut spread = Spread(1);
    let mut draws = Draws::new(&world, 5);
    let mut seen = 0;
    for _ in 0..200 {
        let [yaw, _, roll] = spread.turn();
        let away = spread.next(25.0, 70.0);
        let pitch = spread.next(-80.0, 80.0);
        let mut at = camera([0.0; 3], [yaw, pitch, roll]);
        at.eye = DVec3::new(12.0, 10.0, 20.0) - away * at.basis().forward;
        let truth = exact(&world, &at, &plain());
        // Readjusted planes are up to a pixel and a half apart.
        for (readjust, reach) in [(false, 1), (true, 2)] {
            let options = Options { readjust, ..plain() };
            let frames = draws.frames(&at, &options);
            seen += usize::from((1..truth.voxel.len() / 2).contains(&sky(&frames[0])));
            for frame in frames {
                assert_eq!(notches(&frame, &truth, reach), 0, "{} {at:?}, readjust {readjust}", frame.stats.kernel);
            }
        }
    }
    assert!(seen > 80, "{seen} pictures show a silhouette");
    let at = camera([12.0, 10.0, 80.0], [0.0; 3]);
    let truth = exact(&world, &at, &plain());
    let mut planted = truth.clone();
    planted.voxel[30 * 80 + 40] = SKY;
    assert_eq!([1, 2].map(|reach| notches(&planted, &truth, reach)), [1, 1]);
}

/// Pixels of sky though all rays within a pixel and a half of theirs go down to the floor within the view.
fn hairlines(frame: &Frame, camera: &Camera, above: f64, view: f64) -> usize {
    let basis = camera.basis();
    let floor = |x: f64, y: f64| {
        let ray = camera.ray(&basis, x, y);
        ray.y < 0.0 && above / -ray.y * ray.x.hypot(ray.z) < view
    };
    let missing = |&i: &usize| {
        let (x, y) = ((i % 80) as f64 + 0.5, (i / 80) as f64 + 0.5);
        let corners = [-1.5, 1.5].into_iter().flat_map(|dx| [-1.5, 1.5].map(|dy| (x + dx, y + dy)));
        frame.voxel[i] == SKY && corners.into_iter().all(|(x, y)| floor(x, y))
    };
    (0..frame.voxel.len()).filter(missing).count()
}

#[test]
fn floors_have_no_hairlines_whatever_the_slope() {
    let world = WorldName::Floor.make();
    let mut draws = Draws::new(&world, 1);
    for above in [1e-9, 1e-4, 0.3, 20.0, 3e3, 1e5] {
        for pitch in [1.0, 0.0, -1e-6, -0.3, -20.0, -89.0, -90.0] {
            for roll in [0.0, 45.0, 91.0] {
                let at = camera([16.3, 4.0 + above, 15.7], [25.0, pitch, roll]);
                let view = 20_000.0f64.max(above);
                for frame in draws.frames(&at, &without_end(view)) {
                    // The floor's height above which the eye is, as it is after rounding.
                    let n = hairlines(&frame, &at, at.eye.y - 4.0, 0.99 * view);
                    assert_eq!(n, 0, "{}, {above} above, pitch {pitch}, roll {roll}", frame.stats.kernel);
                }
            }
        }
    }
    let at = camera([16.3, 24.0, 15.7], [25.0, -20.0, 0.0]);
    let mut planted = draw(&world, &at, &without_end(5e3));
    planted.voxel[50 * 80 + 7] = SKY;
    assert_eq!(hairlines(&planted, &at, 20.0, 5e3), 1);
}

/// Pixels whose depth is not the floor's within two pixels of theirs, give or take two voxels of the level shown.
fn beams(frame: &Frame, camera: &Camera, above: f64) -> usize {
    let basis = camera.basis();
    let depth = |x: f64, y: f64| {
        let down = -camera.ray(&basis, x, y).y;
        if down > 0.0 { above / down } else { f64::INFINITY }
    };
    let wrong = |&i: &usize| {
        let (x, y, z) = ((i % 80) as f64 + 0.5, (i / 80) as f64 + 0.5, f64::from(frame.depth[i]));
        let size = 2.0 * f64::from(1u32 << frame.voxel[i][3].max(0));
        frame.voxel[i] != SKY && !(depth(x, y + 2.0) - size..=depth(x, y - 2.0) + size).contains(&z)
    };
    (0..frame.voxel.len()).filter(wrong).count()
}

#[test]
fn axes_have_no_beams_at_deep_levels() {
    let world = WorldName::Floor.make();
    let mut draws = Draws::new(&world, 1);
    for yaw in [0.0, 1e-7, 45.0, 45.0 - 1e-7, 90.0, 180.0 + 1e-4, 270.0] {
        for [x, z] in [[16.0, 16.0], [16.5, 3.0], [1e6, -1e6], [16.0f64.next_up(), 16.0f64.next_down()]] {
            for pitch in [0.0, -1.0] {
                let at = camera([x, 64.5, z], [yaw, pitch, 0.0]);
                for frame in draws.frames(&at, &without_end(180_000.0)) {
                    assert_eq!(beams(&frame, &at, 60.5), 0, "{} {at:?}", frame.stats.kernel);
                }
            }
        }
    }
    let at = camera([16.0, 64.5, 16.0], [0.0; 3]);
    let mut planted = draw(&world, &at, &without_end(180_000.0));
    (35..60).for_each(|y| planted.depth[y * 80 + 40] *= 2.0);
    assert_eq!(beams(&planted, &at, 60.5), 25);
}

/// Share of pixels that show what no pixel around them shows in the other picture, in percent.
fn strange(a: &Frame, b: &Frame) -> f64 {
    let n = (0..a.voxel.len()).filter(|&i| !around(b, i).any(|j| b.voxel[j] == a.voxel[i])).count();
    100.0 * n as f64 / a.voxel.len() as f64
}

#[test]
fn nearly_level_views_show_what_level_ones_show() {
    let world = WorldName::Rocks.make();
    let mut draws = Draws::new(&world, 1);
    for eye in [[30.3, 62.2, 60.4], [20.3, 40.2, 62.6]] {
        for options in [plain(), without_end(20_000.0)] {
            let level = draw(&world, &camera(eye, [31.0, 0.0, 0.0]), &options);
            for k in 4..=12 {
                for pitch in [10f64.powi(-k), -(10f64.powi(-k))] {
                    for near in draws.frames(&camera(eye, [31.0, pitch, 0.0]), &options) {
                        let (kernel, percent) = (&near.stats.kernel, strange(&near, &level));
                        // Rays, not planes: of voxels less than a pixel wide they show others.
                        let allowed = if kernel.starts_with("raycast") { 4.0 } else { 0.5 };
                        assert!(percent <= allowed, "{kernel}, pitch {pitch:e}: {percent} %");
                    }
                }
            }
            let other = draw(&world, &camera(eye, [31.0, -12.0, 0.0]), &options);
            assert!(strange(&other, &level) > 0.5, "a view of another pitch is caught");
        }
    }
}

/// Pixels that do not lie between the planes beside the one that they take, or that are taken by no stretch of a row, or by several.
fn beside_their_stripe(setup: &Setup, camera: &Camera) -> usize {
    let mut wrong = 0;
    for row in 0..camera.height {
        let row = Row::new(setup, row, camera.width);
        let mut taken = vec![0; camera.width as usize];
        for stretch in row.stretches() {
            let fan = &setup.fans[stretch.fan];
            row.gather(stretch, |x, place| {
                taken[x] += 1;
                let (centre, stripe) = fan.place(place.plane);
                let (below, above) = match (fan.readjusted, place.plane) {
                    // Even stripes: the half around the plane.
                    (None, _) => (centre - 0.5 * stripe, centre + 0.5 * stripe),
                    (_, 0) => (centre - stripe, centre + stripe),
                    (_, k) => (fan.place(k - 1).0, centre + stripe),
                };
                let between = (below - 1e-6..=above + 1e-6).contains(&place.at);
                wrong += usize::from(!between || place.sample >= fan.n_samples);
            });
        }
        wrong += taken.iter().filter(|&&n| n != 1).count();
    }
    wrong
}

#[test]
fn fans_are_even_and_whole_however_they_degenerate() {
    let world = WorldName::SingleVoxel.make();
    let mut spread = Spread(2);
    for k in 0..1500 {
        let mut turn = spread.turn();
        // On, and a little beside, what makes fans vanish.
        let tiny = [0.0, 1e-14, -1e-9, 1e-4][k % 4];
        match k / 4 % 5 {
            0 => turn[1] = tiny,
            1 => turn[1] = 90.0 - tiny.abs(),
            2 => turn[2] = (turn[2] / 45.0).round() * 45.0 + tiny,
            3 => turn = [turn[0], tiny, (turn[2] / 45.0).round() * 45.0],
            _ => {}
        }
        let mut at = camera([5.0; 3], turn);
        [at.width, at.height] = [[80, 60], [81, 61], [1, 1], [7, 90], [90, 7], [2, 1]][k % 6];
        at.fov = [60.0, 0.01, 179.0, 100.0][k % 4];
        for readjust in [false, true] {
            let setup = plane_setup(&world.resident, &at, &Options { readjust, ..plain() });
            assert_eq!(beside_their_stripe(&setup, &at), 0, "{at:?} readjust {readjust}");
            assert!(setup.planes.iter().all(|p| p.a.is_finite() && p.b.is_finite() && p.dir[0].hypot(p.dir[1]) > 0.9));
        }
    }
    let at = camera([5.0; 3], [20.0, -30.0, 5.0]);
    let mut planted = plane_setup(&world.resident, &at, &Options { readjust: false, ..plain() });
    planted.fans.iter_mut().for_each(|fan| fan.start += 3.0);
    assert!(beside_their_stripe(&planted, &at) > 0);
}

#[test]
fn every_pixel_is_written_straight_up_and_down() {
    let world = WorldName::Room.make();
    let mut draws = Draws::new(&world, 3);
    for width in 1..=9 {
        for height in 1..=9 {
            for pitch in [-90.0, 90.0] {
                for roll in [0.0, 33.0, 90.0] {
                    let at = Camera { width, height, ..camera([12.5, 7.5, 9.5], [0.0, pitch, roll]) };
                    for frame in draws.frames(&at, &plain()) {
                        assert_eq!(sky(&frame), 0, "{} {at:?}", frame.stats.kernel);
                    }
                }
            }
        }
    }
    // A wall away, and the count is not 0.
    let open = WorldName::Rocks.make();
    assert!(sky(&draw(&open, &camera([30.3, 62.2, 31.4], [0.0, 90.0, 0.0]), &plain())) > 0);
}

#[test]
fn eyes_above_beside_and_below_a_world_see_it_right() {
    let world = WorldName::Rocks.make();
    let mut spread = Spread(3);
    let mut draws = Draws::new(&world, 2);
    let mut seen = 0;
    for k in 0..120 {
        let eye = DVec3::from([0; 3].map(|_| spread.next(-60.0, 124.0)));
        if (0..3).all(|i| (0.0..64.0).contains(&eye[i])) {
            continue;
        }
        // Towards the world's middle, more or less.
        let to = DVec3::from([0; 3].map(|_| spread.next(12.0, 52.0))) - eye;
        let (yaw, pitch) = (to.x.atan2(-to.z).to_degrees(), to.y.atan2(to.x.hypot(to.z)).to_degrees());
        let at = camera(eye.to_array(), [yaw, pitch, [0.0, 20.0, -90.0][k % 3]]);
        let truth = exact(&world, &at, &plain());
        seen += usize::from(sky(&truth) < truth.voxel.len());
        let frames = draws.frames(&at, &plain());
        for frame in &frames {
            let wrong = off(frame, &truth, &world, &at, &plain());
            assert!(wrong.len() <= frame.voxel.len() / 25, "{}: {} pixels, {at:?}", frame.stats.kernel, wrong.len());
        }
        if k == 0 {
            let mut planted = frames[0].clone();
            planted.voxel.iter_mut().take(200).for_each(|v| *v = [1, 0, 1, 0]);
            assert!(off(&planted, &truth, &world, &at, &plain()).len() >= 190);
        }
    }
    assert!(seen > 50, "{seen} pictures show the world");
}

#[test]
fn runs_through_the_near_plane_are_drawn() {
    let world = WorldName::Room.make();
    let mut spread = Spread(4);
    let mut draws = Draws::new(&world, 2);
    for k in 0..300 {
        let d = [0.0, 1e-12, 1e-6, 1e-3][k % 4];
        let free = [spread.next(1.1, 4.9), spread.next(1.1, 11.9), spread.next(1.1, 3.9)];
        let eye = match k / 4 % 3 {
            0 => [1.0 + d, free[1], free[2]],
            1 => [free[0], 1.0 + d, free[2]],
            _ => [free[0], free[1], 1.0 + d],
        };
        let at = Camera { fov: [60.0, 120.0, 170.0][k % 3], ..camera(eye, spread.turn()) };
        for frame in draws.frames(&at, &plain()) {
            assert_eq!(sky(&frame), 0, "{} {at:?}", frame.stats.kernel);
        }
    }
    // The eye beyond the wall: what it stood before is behind it, and the sky shows.
    let at = camera([-1.0, 7.3, 9.4], [270.0, 0.0, 0.0]);
    assert!(sky(&draw(&world, &at, &plain())) > 0);
}

#[test]
fn inside_solid_every_pixel_shows_the_eyes_own_voxel() {
    let world = WorldName::Tower.make();
    let mut draws = Draws::new(&world, 1);
    for y in [0.0, 0.5, 255.9, 256.0, 65_535.5] {
        for pitch in [-90.0, 0.0, 45.0] {
            for frame in draws.frames(&camera([1.5, y, 1.5], [10.0, pitch, 0.0]), &plain()) {
                assert!(frame.depth.iter().all(|&d| d == 0.0));
                assert!(frame.voxel.iter().all(|&v| v == [1, y as i32, 1, 0]));
            }
        }
    }
}

/// Pixels beside another fan's that show what cannot be seen from there.
fn seams(frame: &Frame, truth: &Frame, world: &World, camera: &Camera) -> [usize; 2] {
    let setup = plane_setup(&world.resident, camera, &plain());
    let mut fan = vec![0; frame.voxel.len()];
    for r in 0..camera.height {
        for s in Row::new(&setup, r, camera.width).stretches() {
            (s.from..s.to).for_each(|x| fan[(r * camera.width + x) as usize] = s.fan);
        }
    }
    let beside = |i: usize| around(frame, i).any(|j| fan[j] != fan[i]);
    let wrong = off(frame, truth, world, camera, &plain());
    [wrong.iter().filter(|&&i| beside(i)).count(), (0..fan.len()).filter(|&i| beside(i)).count()]
}

#[test]
fn fans_meet_without_seams() {
    let world = WorldName::Room.make();
    let mut spread = Spread(5);
    let mut draws = Draws::new(&world, 2);
    let (mut wrong, mut all) = (0, 0);
    for _ in 0..150 {
        let at = camera([12.37, 7.61, 9.43], spread.turn());
        let truth = exact(&world, &at, &plain());
        for frame in draws.frames(&at, &plain()) {
            let [w, n] = seams(&frame, &truth, &world, &at);
            (wrong, all) = (wrong + w, all + n);
        }
    }
    assert!(all > 5_000, "{all} pixels lie beside another fan's");
    assert!(1000 * wrong <= all, "{wrong} of {all} pixels");
    let at = camera([12.37, 7.61, 9.43], [10.0, -50.0, 0.0]);
    let truth = exact(&world, &at, &plain());
    let mut planted = truth.clone();
    planted.voxel.fill(SKY);
    let [w, n] = seams(&planted, &truth, &world, &at);
    assert!(w == n && n > 50);
}

#[test]
fn far_silhouettes_hold_where_levels_change() {
    let world = WorldName::Fence.make();
    let options = Options { lod: Some(1.0), ..plain() };
    let mut draws = Draws::new(&world, 1);
    // Pixels of sky in the midst of the fence.
    let holes = |frame: &Frame, truth: &Frame| {
        let hole = |&i: &usize| frame.voxel[i] == SKY && around(truth, i).all(|j| truth.voxel[j] != SKY);
        (0..frame.voxel.len()).filter(hole).count()
    };
    for yaw in [-2.0, 0.0, 0.7, 2.0, 5.0, 30.0] {
        for pitch in [-6.0, -1.0, 0.0, 3.0] {
            for roll in [0.0, 40.0] {
                let at = Camera { fov: 20.0, ..camera([30.3, 12.5, 2040.4], [yaw, pitch, roll]) };
                let truth = exact(&world, &at, &options);
                for frame in draws.frames(&at, &options) {
                    assert_eq!(holes(&frame, &truth), 0, "{} {at:?}", frame.stats.kernel);
                }
            }
        }
    }
    let at = Camera { fov: 20.0, ..camera([30.3, 12.5, 2040.4], [2.0, 0.0, 0.0]) };
    let truth = exact(&world, &at, &options);
    let inner = (0..4800).find(|&i| around(&truth, i).all(|j| truth.voxel[j] != SKY)).expect("fence");
    let mut planted = draw(&world, &at, &options);
    planted.voxel[inner] = SKY;
    assert_eq!(holes(&planted, &truth), 1);
    assert!(planted.voxel.iter().map(|v| v[3]).max() >= Some(2), "levels change in the picture");
}
