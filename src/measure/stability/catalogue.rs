//! The cases.

use crate::frame::camera::Camera;
use crate::frame::options::{Options, Remap, Repeat, Shading};
use crate::measure::stability::measure::{BOUND_DEPTH, BOUND_MOVED};
use crate::measure::stability::worlds::WorldName;
use glam::DVec3;

/// What a picture must be, whatever else it shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Expect {
    Any,
    /// No pixel of sky: the eye stands among closed surfaces.
    Closed,
    /// Nothing but sky.
    Sky,
    /// The eye's own voxel everywhere, at depth 0.
    Inside,
}

/// One case.
#[derive(Clone, Debug)]
pub struct Case {
    pub name: String,
    /// Why it is in the catalogue.
    pub reason: &'static str,
    pub world: WorldName,
    pub camera: Camera,
    pub options: Options,
    pub expect: Expect,
    /// Greatest share of pixels that may be off, in percent.
    pub bound_off: f64,
    /// Greatest share of pixels whose own rays meet something else, in percent, where they are tested.
    pub bound_wrong: f64,
    /// Greatest relative error of depth.
    pub bound_depth: f64,
    /// Greatest share of pixels, in percent, that one ulp may move beyond those that it moves in `exact`. An ulp takes an eye
    /// off a face or into it, and `exact` itself tells no smaller distances.
    pub bound_moved: f64,
    /// The variable that a family of cases sweeps, and its value.
    pub sweep: Option<(&'static str, f64)>,
}

const BOTH: Repeat = Repeat { x: true, z: true };
const SIZE: [u32; 2] = [64, 48];

/// Greatest shares of pixels that may be off, in percent, by kind of view. A level view has pixel columns for planes:
/// only rounding differs. Elsewhere a retest reaches a sample and a stripe beside the pixel, which is more than
/// [`crate::measure::stability::measure::REACH`] where voxels are less than a pixel wide.
const LEVEL: f64 = 0.05;
const TURNED: f64 = 0.5;
const FINE: f64 = 4.0;

/// Greatest share of pixels, in percent, whose own rays meet something else than they show, where the eye touches what it
/// sees: less than a row, which is 2 %.
const TOUCHED: f64 = 0.1;

/// The same, and the greatest error of depth, where the eye is a hair before a face: its distance from the face is rounded to a step
/// of f32, and a ray along the face comes to it at that distance over the sine of a small angle. Measured: 0.39 % (`raycast` on a
/// GPU) and 9.3 thousandths of a voxel.
const HAIR: [f64; 2] = [0.5, 20.0];

/// Greatest share of pixels, in percent, whose own rays meet something else than they show, where cells of coarser levels
/// are drawn: about a pixel wide, they are tested but not refined.
const LEVELS: f64 = 20.0;

/// Greatest relative error of depth where rays run almost along a wall. On the GPU directions are f32: the component of one
/// across the wall is a difference, and wrong by 2⁻²⁴ of the ray's length.
const ALONG: f64 = 1e-3;

/// Level 0 alone, colours as stored.
fn plain() -> Options {
    Options { lod: None, shading: Shading::None, ..Options::default() }
}

/// Levels at one pixel, a world without end.
fn far(view_distance: f64) -> Options {
    Options { lod: Some(1.0), repeat: BOTH, view_distance, ..plain() }
}

fn camera(eye: [f64; 3], [yaw, pitch, roll]: [f64; 3]) -> Camera {
    Camera { eye: DVec3::from(eye), yaw, pitch, roll, fov: 60.0, width: SIZE[0], height: SIZE[1] }
}

struct List(Vec<Case>);

impl List {
    /// Adds a case with the bound that its camera's kind has.
    fn add(
        &mut self,
        name: impl Into<String>,
        reason: &'static str,
        world: WorldName,
        camera: Camera,
        options: Options,
    ) -> &mut Case {
        let expect = match world {
            WorldName::Room | WorldName::Hall => Expect::Closed,
            WorldName::Empty => Expect::Sky,
            _ => Expect::Any,
        };
        let level = camera.pitch == 0.0 && camera.roll.rem_euclid(180.0) == 0.0;
        let bound_off = if level { LEVEL } else { TURNED };
        self.0.push(Case {
            name: name.into(),
            reason,
            world,
            camera,
            options,
            expect,
            bound_off,
            bound_wrong: 0.0,
            bound_depth: BOUND_DEPTH,
            bound_moved: BOUND_MOVED,
            sweep: None,
        });
        self.0.last_mut().expect("just added")
    }
}

/// All cases. Names are unique.
pub fn cases() -> Vec<Case> {
    let mut list = List(Vec::new());
    pitches(&mut list);
    vanishing_points(&mut list);
    rolls(&mut list);
    eyes(&mut list);
    touches(&mut list);
    directions(&mut list);
    lenses(&mut list);
    places(&mut list);
    distances(&mut list);
    worlds(&mut list);
    level_changes(&mut list);
    slopes(&mut list);
    for case in list.0.iter_mut().filter(|case| case.bound_wrong == 0.0) {
        case.bound_wrong = f64::max(case.bound_off, if case.options.lod.is_some() { LEVELS } else { 0.0 });
    }
    list.0
}

fn pitches(list: &mut List) {
    let room = [12.37, 7.61, 9.43];
    for pitch in [-90.0, 0.0, 90.0] {
        list.add(
            format!("pitch {pitch}"),
            "fans vanish or meet in one point",
            WorldName::Room,
            camera(room, [33.0, pitch, 0.0]),
            plain(),
        );
    }
    for k in 1..=8 {
        let d = 10f64.powi(-k);
        for (at, sign) in [(0.0, 1.0), (0.0, -1.0), (90.0, -1.0), (-90.0, 1.0)] {
            let near = if at == 0.0 {
                "0"
            } else if at > 0.0 {
                "90"
            } else {
                "-90"
            };
            let sign_name = if sign > 0.0 { "+" } else { "-" };
            let case = list.add(
                format!("pitch {near} {sign_name} 1e-{k}"),
                "the vanishing point runs to infinity, or across a pixel",
                WorldName::Room,
                camera(room, [33.0, at + sign * d, 0.0]),
                plain(),
            );
            case.sweep = Some((if at == 0.0 { "degrees from level" } else { "degrees from upright" }, d));
        }
        let case = list.add(
            format!("far view, pitch -1e-{k}"),
            "a far vanishing point costs precision where voxels are small",
            WorldName::Rocks,
            camera([20.3, 70.2, 30.6], [211.0, -d, 0.0]),
            far(20_000.0),
        );
        (case.bound_off, case.sweep) = (FINE, Some(("degrees below level, far", d)));
    }
}

fn vanishing_points(list: &mut List) {
    // Sizes that put the vanishing point of an upright view on a pixel's centre, edge or corner.
    for (width, height, what) in [(65, 49, "centre"), (64, 49, "edge"), (65, 48, "other edge"), (64, 48, "corner")] {
        for pitch in [-90.0, 90.0] {
            let at = Camera { width, height, ..camera([12.5, 7.5, 9.5], [0.0, pitch, 0.0]) };
            list.add(
                format!("vanishing point on a pixel's {what}, pitch {pitch}"),
                "the pixel at the point itself has no azimuth",
                WorldName::Room,
                at,
                plain(),
            );
        }
    }
    // Looking down by p, the point stands focal / tan p below the image's middle.
    let base = camera([12.37, 7.61, 9.43], [33.0, 0.0, 0.0]);
    for (rows, what) in [
        (24.0, "on the last row's edge"),
        (23.5, "on the last row's centre"),
        (24.0 + 1e-9, "just below the image"),
        (24.0 - 1e-9, "just in the image"),
        (24.5, "half a pixel below the image"),
        (12.0, "within the image"),
    ] {
        for sign in [-1.0, 1.0] {
            let pitch = sign * (base.focal() / rows).atan().to_degrees();
            let side = if sign < 0.0 { "nadir" } else { "zenith" };
            list.add(
                format!("{side} {what}"),
                "a fan has no extent, or one pixel's",
                WorldName::Room,
                Camera { pitch, ..base },
                plain(),
            );
        }
    }
}

fn rolls(list: &mut List) {
    for eighth in 0..8 {
        let roll = f64::from(eighth) * 45.0;
        for pitch in [0.0, -37.0, -90.0] {
            list.add(
                format!("roll {roll}, pitch {pitch}"),
                "fans change places at multiples of 45 degrees",
                WorldName::Room,
                camera([12.37, 7.61, 9.43], [33.0, pitch, roll]),
                plain(),
            );
        }
    }
    for d in [1e-3, 1e-7, 1e-12] {
        list.add(
            format!("roll 45 + {d:e}"),
            "a fan of almost no extent",
            WorldName::Room,
            camera([12.37, 7.61, 9.43], [33.0, 0.0, 45.0 + d]),
            plain(),
        );
        list.add(
            format!("roll {d:e}"),
            "planes almost pixel columns",
            WorldName::Room,
            camera([12.37, 7.61, 9.43], [33.0, 0.0, d]),
            plain(),
        );
    }
}

fn eyes(list: &mut List) {
    let reason = "which side of a grid plane the eye is on decides whole columns";
    for (what, free) in
        [("face", [false, true, true]), ("edge", [false, true, false]), ("corner", [false, false, false])]
    {
        for (nudge, where_) in [(0, "on"), (1, "one ulp above"), (-1, "one ulp below")] {
            for pitch in [0.0, -52.0] {
                let place = |whole: f64, fract: f64, free: bool| match (free, nudge) {
                    (true, _) => whole + fract,
                    (_, 0) => whole,
                    (_, 1) => whole.next_up(),
                    _ => whole.next_down(),
                };
                let eye = [place(12.0, 0.37, free[0]), place(8.0, 0.61, free[1]), place(9.0, 0.43, free[2])];
                list.add(
                    format!("eye {where_} a voxel's {what}, pitch {pitch}"),
                    reason,
                    WorldName::Room,
                    camera(eye, [31.0, pitch, 0.0]),
                    plain(),
                );
            }
        }
    }
    for (d, name) in [(1e-3, "1e-3"), (1e-6, "1e-6"), (1e-12, "1e-12"), (0.0, "0")] {
        let case = list.add(
            format!("eye {name} from a wall, steeply down"),
            "runs reach through the near plane",
            WorldName::Room,
            Camera { fov: 120.0, ..camera([1.0 + d, 7.3, 9.4], [5.0, -60.0, 0.0]) },
            plain(),
        );
        (case.bound_depth, case.sweep) = (ALONG, Some(("voxels from a wall", d)));
    }
}

/// Eyes on the faces, edges and corners of what they see, where a ray enters at no distance or leaves at once.
fn touches(list: &mut List) {
    let reason = "what the eye touches is met at depth 0 by rays into it, and by no others";
    // Nearer than f32 tells from the face itself.
    let below = |v: f64| v.next_down();
    let block = WorldName::Block;
    let eyes = [
        ("a top face", block, [12.3, 12.0, 12.4]),
        ("a line of a top face", block, [12.0, 12.0, 12.4]),
        ("four top faces", block, [12.0, 12.0, 12.0]),
        ("a top edge", block, [16.0, 12.0, 12.4]),
        ("the opposite top edge", block, [12.3, 12.0, 8.0]),
        ("a top corner", block, [16.0, 12.0, 16.0]),
        ("the opposite top corner", block, [8.0, 12.0, 8.0]),
        ("a side across x", block, [16.0, 10.4, 12.4]),
        ("four sides across x", block, [16.0, 10.0, 12.0]),
        ("a side across z", block, [12.3, 10.4, 16.0]),
        ("an upright edge", block, [16.0, 10.4, 16.0]),
        ("a bottom edge", block, [16.0, 8.0, 12.4]),
        ("a bottom corner", block, [16.0, 8.0, 16.0]),
        ("another bottom corner", block, [8.0, 8.0, 16.0]),
        ("a bottom face, an ulp below it", block, [12.3, below(8.0), 12.4]),
        ("a bottom corner, an ulp from it", block, [below(8.0), below(8.0), below(8.0)]),
        ("the far side across x, an ulp from it", block, [below(8.0), 10.4, 12.4]),
        ("the far side across z, an ulp from it", block, [12.3, 10.4, below(8.0)]),
        ("a wall from within", WorldName::Room, [1.0, 7.4, 9.4]),
        ("a corner from within", WorldName::Room, [1.0, 1.0, 1.0]),
        // Heights on a wall are known to an f32's step, 2e-6 here: nearer, the voxel beside the true one may be shown.
        ("the opposite corner from within, 1e-4 from it", WorldName::Room, [26.9999, 16.9999, 20.9999]),
    ];
    let turns = [
        [45.0, -5.0, 0.0],
        [225.0, 5.0, 0.0],
        [0.0, -5.0, 0.0],
        [90.0, 5.0, 90.0],
        [123.0, -52.0, 30.0],
        [300.5, 35.0, -63.0],
        [211.0, -89.0, 10.0],
        [33.0, 80.0, 0.0],
    ];
    for (what, world, eye) in eyes {
        for (k, turn) in turns.into_iter().enumerate() {
            let [yaw, pitch, roll] = turn;
            let mut add = |how: &str, options: Options| {
                let name = format!("eye touches {what}, yaw {yaw}, pitch {pitch}, roll {roll}{how}");
                let case = list.add(name, reason, world, camera(eye, turn), options);
                (case.bound_wrong, case.bound_moved) = (TOUCHED, 100.0);
                if what.contains(" from it") || what.contains(" below it") {
                    [case.bound_wrong, case.bound_depth] = HAIR;
                }
            };
            add("", plain());
            if k < 2 && world == block {
                add(", retest", Options { remap: Remap::Retest, ..plain() });
                add(", levels", Options { lod: Some(20.0), ..plain() });
            }
        }
    }
}

fn directions(list: &mut List) {
    let reason = "one crossing parameter is many orders above the other, or infinite";
    for (yaw, name) in [(0.0, "x = 0"), (90.0, "z = 0"), (45.0, "diagonal")] {
        for (d, what) in [(0.0, "exactly"), (1e-6, "+ 1e-6"), (-1e-9, "- 1e-9"), (1e-13, "+ 1e-13")] {
            // On a voxel's edge, so that the middle rays run in grid planes.
            let at = Camera { width: 65, height: 49, ..camera([12.0, 7.5, 9.0], [yaw + d, 0.0, 0.0]) };
            list.add(format!("yaw along {name} {what}"), reason, WorldName::Room, at, plain());
        }
    }
    // On a voxel's corner, rays through the middle of an odd size: components are what the angles' sines are.
    for (yaw, pitch, what) in [
        (-0.0, -0.0, "-0 along x and up"),
        (180.0, -0.0, "-0 along x, backwards"),
        (270.0, 0.0, "-0 along z"),
        (1e-307, 0.0, "subnormal along x"),
        (-1e-307, 1e-307, "subnormal and negative along x, subnormal up"),
        (90.0, -1e-307, "subnormal down"),
        (1e-38, 0.0, "subnormal in f32 along x"),
        (-1e-38, -1e-38, "subnormal in f32 and negative along x and up"),
        (5e-324, 5e-324, "0 from the least angle"),
    ] {
        for [x, z] in [[12.5, 9.5], [12.0, 9.0]] {
            let at = Camera { width: 65, height: 49, ..camera([x, 7.5, z], [yaw, pitch, 0.0]) };
            let place = if x == 12.0 { "on an edge" } else { "within a voxel" };
            let reason = "a direction's component divides as 0 does, or overflows where it is divided by";
            let name = format!("a direction {what}, eye {place}");
            list.add(name, reason, WorldName::Room, at, plain());
        }
    }
    for yaw in [135.0, 225.0, 315.0] {
        let at = Camera { width: 65, height: 49, ..camera([12.0, 7.5, 9.0], [yaw, 0.0, 0.0]) };
        list.add(format!("yaw along the diagonal {yaw}"), reason, WorldName::Room, at, plain());
    }
    for yaw in [0.0, 1e-6, 45.0, 45.0 + 1e-9] {
        let at = Camera { width: 65, height: 49, ..camera([256.0, 9.5, 300.0], [yaw, -2.0, 0.0]) };
        list.add(
            format!("180,000 along yaw {yaw:e}"),
            "differences of large crossings leave beams along an axis",
            WorldName::Floor,
            at,
            far(180_000.0),
        )
        .bound_off = FINE;
    }
}

fn lenses(list: &mut List) {
    for fov in [0.01, 1.0, 120.0, 170.0, 179.0] {
        for pitch in [0.0, -40.0] {
            let at = Camera { fov, ..camera([12.37, 7.61, 9.43], [33.0, pitch, 0.0]) };
            let case = list.add(
                format!("fov {fov}, pitch {pitch}"),
                "the narrowest and the widest lens",
                WorldName::Room,
                at,
                plain(),
            );
            case.sweep = Some(("degrees of view", fov));
            if fov > 160.0 {
                case.bound_off = FINE;
            }
        }
    }
    for [width, height] in [[1, 1], [2, 2], [1, 8192], [8192, 1]] {
        for pitch in [0.0, -40.0, -90.0] {
            let at = Camera { width, height, ..camera([12.37, 7.61, 9.43], [33.0, pitch, 0.0]) };
            let case = list.add(
                format!("{width} x {height}, pitch {pitch}"),
                "an image of one line or one pixel",
                WorldName::Room,
                at,
                plain(),
            );
            // A pixel as wide as the view holds more voxels than are looked for.
            case.bound_off = if height <= 2 { 25.0 } else { FINE };
            if width == 8192 {
                case.bound_depth = ALONG;
            }
        }
    }
}

fn places(list: &mut List) {
    for pitch in [-90.0, 0.0, 45.0] {
        list.add(
            format!("inside solid, pitch {pitch}"),
            "nothing in front of the eye is air",
            WorldName::Full,
            camera([12.4, 10.2, 20.9], [40.0, pitch, 10.0]),
            plain(),
        )
        .expect = Expect::Inside;
    }
    for (name, eye, turn) in [
        ("under the world", [30.3, -25.2, 31.4], [40.0, 50.0, 0.0]),
        ("under the world, straight up", [30.3, -25.2, 31.4], [40.0, 90.0, 0.0]),
        ("above the world, straight down", [30.3, 150.2, 31.4], [40.0, -90.0, 0.0]),
        ("3,000 above the world", [30.3, 3064.2, 31.4], [40.0, -90.0, 0.0]),
        ("half a voxel beside the world", [-0.5, 30.2, 31.4], [100.0, -10.0, 0.0]),
        ("20 voxels beside the world", [-20.0, 30.2, 31.4], [95.0, -10.0, 0.0]),
        ("on the world's far corner", [64.0, 40.0, 64.0], [315.0, -20.0, 0.0]),
        ("on the world's near corner", [0.0, 40.0, 0.0], [135.0, -20.0, 0.0]),
        ("with the back to the world", [-20.0, 30.2, 31.4], [275.0, -10.0, 0.0]),
    ] {
        let case = list.add(
            name,
            "planes begin outside the world, or never meet it",
            WorldName::Rocks,
            camera(eye, turn),
            plain(),
        );
        if name.contains("3,000") {
            // Voxels 73 to a pixel.
            case.bound_off = FINE;
        }
        if name.contains("back") {
            case.expect = Expect::Sky;
        }
    }
    for (exponent, fov, bound) in [(20, 0.01, FINE), (30, 0.01, 100.0), (30, 2e-6, 100.0)] {
        // The last fills the image with 64 voxels at 2³⁰, where steps of f32 are 64 voxels too: it may show anything of
        // them, but must end.
        let eye = [32.5, 20.5, (1u64 << exponent) as f64];
        let at = Camera { fov, ..camera(eye, [0.0, 0.0, 0.0]) };
        let case = list.add(
            format!("2^{exponent} voxels away, fov {fov}"),
            "the eye's own limit",
            WorldName::Rocks,
            at,
            plain(),
        );
        case.bound_off = bound;
    }
}

fn distances(list: &mut List) {
    let reason = "nothing may depend on absolute coordinates";
    for (name, x) in [("2^24", (1 << 24) as f64), ("2^30", (1 << 30) as f64), ("10^9", 1e9), ("-10^9", -1e9)] {
        for pitch in [0.0, -35.0] {
            let eye = [x + 0.37, 58.3, 30.4 - x];
            let options = Options { repeat: BOTH, view_distance: 300.0, ..plain() };
            list.add(
                format!("at the seam {name} of a repeated world, pitch {pitch}"),
                reason,
                WorldName::Rocks,
                camera(eye, [40.0, pitch, 0.0]),
                options,
            )
            .bound_off = FINE;
        }
    }
    // Seams are multiples of the world's size, as these are.
    for (name, x) in [("2^24", f64::from(1 << 24)), ("2^30", f64::from(1 << 30)), ("-2^30", -f64::from(1 << 30))] {
        for (where_, x) in [("on", x), ("one ulp above", x.next_up()), ("one ulp below", x.next_down())] {
            let eye = [x, 58.3, x];
            let options = Options { repeat: BOTH, view_distance: 300.0, ..plain() };
            let at = camera(eye, [40.0, -20.0, 0.0]);
            list.add(format!("eye {where_} the seam {name}"), reason, WorldName::Rocks, at, options).bound_off = FINE;
        }
    }
    // A world that ends at 2²⁴, where f32 no longer tells columns apart, seen from within, from the end and from beyond.
    let end = f64::from(1 << 24);
    for (name, x, yaw) in [
        ("20 before", end - 20.3, 90.0),
        ("on", end, 270.0),
        ("one ulp before", end.next_down(), 270.0),
        ("20 beyond", end + 20.3, 270.0),
    ] {
        for pitch in [0.0, -25.0] {
            let at = camera([x, 9.2, 1.4], [yaw + 3.0, pitch, 0.0]);
            let options = Options { view_distance: 400.0, ..plain() };
            list.add(
                format!("{name} the world's edge at 2^24, pitch {pitch}"),
                reason,
                WorldName::Plank,
                at,
                options,
            )
            .bound_off = FINE;
        }
    }
    for (view, name) in [(180_000.0, "180,000"), (1e7, "10^7")] {
        for pitch in [0.0, -20.0, -90.0] {
            let at = camera([30.3, 80.2, 31.4], [40.0, pitch, 0.0]);
            list.add(format!("view of {name}, pitch {pitch}"), "the longest walks", WorldName::Rocks, at, far(view))
                .bound_off = FINE;
        }
        // The pole's corner is a hundredth of a voxel away.
        let at = camera([255.99, 8.5, 255.99], [40.0, -3.0, 0.0]);
        list.add(
            format!("a voxel at 0.01 beside a view of {name}"),
            "scales 7 orders apart in one frame",
            WorldName::Pole,
            at,
            far(view),
        )
        .bound_off = FINE;
    }
}

fn worlds(list: &mut List) {
    let reason = "runs as long, as many, as small or as sparse as can be";
    let tall = Options { ..plain() };
    for (name, eye, turn) in [
        ("full column from above", [1.5, 65_546.0, 1.5], [0.0, -90.0, 0.0]),
        ("full column beside", [1.5, 32_768.5, 3.4], [0.0, 0.0, 0.0]),
        ("full column, steeply up along it", [1.5, 10.5, 2.001], [0.0, 89.0, 0.0]),
        ("full column, level with its top", [1.5, 65_536.0, 3.4], [0.0, 0.0, 0.0]),
        ("32,768 runs from below", [2.5, -10.0, 1.5], [0.0, 90.0, 0.0]),
        ("32,768 runs beside", [2.5, 32_768.5, 3.4], [10.0, -20.0, 0.0]),
        ("32,768 runs, steeply down along them", [2.5, 65_000.5, 2.01], [0.0, -88.0, 0.0]),
    ] {
        list.add(name, reason, WorldName::Tower, camera(eye, turn), tall).bound_off = FINE;
    }
    for (world, name, eye) in [
        (WorldName::Checkerboard, "checkerboard", [16.3, 24.2, 15.4]),
        (WorldName::Dust, "dust", [30.3, 20.2, 31.4]),
        (WorldName::SingleVoxel, "single voxel", [18.3, 12.2, 26.4]),
        (WorldName::Empty, "empty world", [10.3, 10.2, 20.4]),
        (WorldName::Mixing, "mixing layer", [30.3, 70.2, 31.4]),
    ] {
        for pitch in [0.0, -30.0, -90.0] {
            let at = camera(eye, [337.0, pitch, 0.0]);
            list.add(format!("{name}, pitch {pitch}"), reason, world, at, plain()).bound_off = FINE;
        }
    }
    list.add("full world from above", reason, WorldName::Full, camera([12.3, 30.2, 20.4], [40.0, -50.0, 0.0]), plain());
    for (name, eye, turn) in [
        ("on the sheet's lower face", [20.3, 5.0, 40.4], [60.0, 0.0, 0.0]),
        ("on the sheet's upper face", [20.3, 6.0, 40.4], [60.0, 0.0, 0.0]),
        ("at the sheet's middle, from its edge on", [41.0, 5.5, 40.4], [270.0, 0.0, 0.0]),
        ("along an upright sheet's face", [50.0, 20.5, 60.4], [0.0, 0.0, 0.0]),
        ("along an upright sheet's face, down", [51.0, 20.5, 30.4], [180.0, -20.0, 0.0]),
        ("just above a sheet", [20.3, 6.0 + 1e-7, 40.4], [60.0, -5.0, 0.0]),
    ] {
        list.add(
            format!("sheets: {name}"),
            "a surface seen edge-on has no width",
            WorldName::Sheets,
            camera(eye, turn),
            plain(),
        )
        .bound_off = FINE;
    }
    // From the stairs' foot, 45 degrees up their slope, on it and an ulp beside.
    for (y, name) in [(1.0, "on it"), (1.0f64.next_up(), "one ulp above"), (1.5, "half a voxel above")] {
        list.add(
            format!("stairs along their slope, {name}"),
            "every edge lies on one sight line",
            WorldName::Stairs,
            camera([0.0, y, 30.4], [90.0, 45.0, 0.0]),
            plain(),
        )
        .bound_off = FINE;
    }
    for (name, at) in [
        ("far off", camera([32.5, 30.5, 1300.4], [0.0, 0.0, 0.0])),
        ("far off, rolled", camera([32.5, 30.5, 1300.4], [0.0, 0.0, 20.0])),
    ] {
        list.add(
            format!("poles thinner than a pixel, {name}"),
            "a pole falls between samples",
            WorldName::Poles,
            Camera { fov: 5.0, ..at },
            plain(),
        )
        .bound_off = FINE;
    }
    for (name, eye, turn) in [
        ("from above", [16.3, 270.2, 15.4], [40.0, -70.0, 0.0]),
        ("at its height", [6.3, 256.0, 4.6], [40.0, 0.0, 0.0]),
        ("from below it", [5.3, 200.0, 4.6], [40.0, 80.0, 0.0]),
    ] {
        list.add(
            format!("columns that end at the world's top, {name}"),
            "the end of a run is one past what its type holds",
            WorldName::Top,
            camera(eye, turn),
            plain(),
        )
        .bound_off = FINE;
    }
}

fn level_changes(list: &mut List) {
    // The wall's face at level k − 1 at just the distance where level k begins: eyes further off see the level begin nearer.
    let focal = camera([0.0; 3], [0.0; 3]).focal();
    for k in 1..=2 {
        let z = f64::from(1 << (k - 1)) + focal * f64::from(1 << k);
        for (z, name) in [
            (z, "at"),
            (z.next_down(), "one ulp behind"),
            (z.next_up(), "one ulp before"),
            // More than f32 rounds off.
            (z - 1e-4, "1e-4 behind"),
            (z + 1e-4, "1e-4 before"),
            (z + 0.5, "within"),
        ] {
            for pitch in [0.0, -15.0] {
                let at = camera([96.4, 48.6, z], [0.0, pitch, 0.0]);
                let options = Options { lod: Some(1.0), ..plain() };
                list.add(
                    format!("level {k} begins {name} a wall's face, pitch {pitch}"),
                    "a thin wall between two levels shows on neither",
                    WorldName::Hall,
                    at,
                    options,
                )
                .bound_off = FINE;
            }
        }
    }
    for lod in [1e-6, 8.0, 1e6] {
        let options = Options { lod: Some(lod), ..plain() };
        list.add(
            format!("levels at {lod:e} pixels"),
            "no level, or only the coarsest",
            WorldName::Hall,
            camera([96.4, 48.6, 80.3], [20.0, -10.0, 0.0]),
            options,
        )
        .bound_off = 100.0;
    }
    for pitch in [0.0, -3.0] {
        let at = camera([30.3, 26.5, 2040.4], [2.0, pitch, 0.0]);
        list.add(
            format!("a fence through all levels, pitch {pitch}"),
            "far silhouettes break where levels change",
            WorldName::Fence,
            at,
            Options { lod: Some(1.0), ..plain() },
        )
        .bound_off = FINE;
    }
    for equidistant in [0.0, 20.0] {
        let options = Options { equidistant: Some(equidistant), remap: Remap::Nearest, ..plain() };
        list.add(
            format!("equidistant from {equidistant}"),
            "the other way of walking",
            WorldName::Hall,
            camera([96.4, 48.6, 80.3], [20.0, -10.0, 0.0]),
            options,
        );
        // Without a retest depth is that of the sample, up to a pixel away.
        let case = list.0.last_mut().expect("just added");
        (case.bound_off, case.bound_depth) = (100.0, 0.05);
    }
}

fn slopes(list: &mut List) {
    for k in [0, 2, 4, 6, 9, 12] {
        let d = 10f64.powi(-k);
        for pitch in [0.0, -1.0] {
            let case = list.add(
                format!("1e-{k} above a floor without end, pitch {pitch}"),
                "slopes over and under any range of a fixed point",
                WorldName::Floor,
                camera([16.3, 4.0 + d, 15.4], [25.0, pitch, 0.0]),
                far(5_000.0),
            );
            (case.bound_off, case.sweep) = (FINE, Some(("voxels above a floor", d)));
        }
    }
    for h in [1e3, 1e5, 1e6] {
        let at = camera([16.3, h, 15.4], [25.0, -89.0, 0.0]);
        let case = list.add(
            format!("{h:e} above a floor without end"),
            "slopes as steep as can be",
            WorldName::Floor,
            at,
            far(1e9),
        );
        (case.bound_off, case.sweep) = (100.0, Some(("voxels above a floor", h)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique_and_cameras_can_be_drawn() {
        let cases = cases();
        let mut names: Vec<&str> = cases.iter().map(|c| c.name.as_str()).collect();
        names.sort_unstable();
        assert_eq!(names.windows(2).find(|w| w[0] == w[1]), None);
        for case in &cases {
            crate::cpu::renderer::check(&case.camera, &case.options).unwrap_or_else(|e| panic!("{}: {e}", case.name));
        }
    }
}
