//! Moving the camera by hand: keys, mouse, walking, flying to a place.
//!
//! Plain state without a window, so that the window, the web page and tests move the same way. Keys have the names that
//! browsers give them (`KeyboardEvent.code`), after where they lie on the keyboard and not what is printed on them.

use glam::DVec3;
use planecast_encoder::Columns;
use planecast_encoder::model::about::Kind;

use crate::film::path::Pose;
use crate::frame::options::Repeat;

/// Degrees that a pixel of mouse movement turns at a field of view of 60 degrees.
const DEGREES_A_PIXEL: f64 = 0.12;

/// Degrees a second that a held key rolls.
const ROLL: f64 = 60.0;

/// What Shift multiplies the speed by.
const FASTER: f64 = 4.0;

/// Voxels a second that speeds are kept within.
const SPEEDS: (f64, f64) = (0.25, 1e6);

/// Voxels from the eye up, and from the eye to each side, that a body takes.
const HEAD: f64 = 0.2;
const SIDE: f64 = 0.3;

/// Voxels that a walker climbs without a jump.
const STEP: f64 = 1.05;

/// Seconds that a flight to a picked place takes.
const FLIGHT: f64 = 1.2;

/// A movement is tested against voxels at least this often, voxels.
const STRIDE: f64 = 0.4;

/// Tests of one step of time at most: beyond, a body goes no farther.
const STRIDES: usize = 4096;

/// How far a notch of the wheel brings an orbit nearer, and how far it may come: voxels.
const NEARER: f64 = 0.88;
const DISTANCES: (f64, f64) = (0.5, 1e7);

/// Degrees a pixel that an orbit turns, and degrees a second of a held key.
const TURN: f64 = 0.3;
const TURNS: f64 = 60.0;

/// How the camera meets the world.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// Round what is looked at, always in the middle.
    Orbit,
    /// Through everything.
    #[default]
    Fly,
    /// Solid voxels are in the way.
    Solid,
    /// On the ground: gravity, steps of one voxel climbed, Space jumps.
    Walk,
}

impl Mode {
    pub const ALL: [Mode; 4] = [Mode::Orbit, Mode::Fly, Mode::Solid, Mode::Walk];

    pub fn name(self) -> &'static str {
        match self {
            Mode::Orbit => "orbit",
            Mode::Fly => "fly",
            Mode::Solid => "fly, solid ground",
            Mode::Walk => "walk",
        }
    }

    /// What suits a thing of that kind: round models and scans, over the ground of terrains, through everything else.
    pub fn of(kind: Option<Kind>) -> Mode {
        match kind {
            Some(Kind::Volume | Kind::Labels | Kind::Mesh | Kind::Points | Kind::Model) => Mode::Orbit,
            Some(Kind::Terrain) => Mode::Solid,
            Some(Kind::Procedural) | None => Mode::Fly,
        }
    }
}

/// Keys that act as long as they are held.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u16)]
enum Held {
    Forward = 1,
    Back = 2,
    Left = 4,
    Right = 8,
    Up = 16,
    Down = 32,
    Faster = 64,
    RollLeft = 128,
    RollRight = 256,
}

fn held(code: &str) -> Option<Held> {
    Some(match code {
        "KeyW" | "ArrowUp" => Held::Forward,
        "KeyS" | "ArrowDown" => Held::Back,
        "KeyA" | "ArrowLeft" => Held::Left,
        "KeyD" | "ArrowRight" => Held::Right,
        "Space" | "PageUp" => Held::Up,
        "ControlLeft" | "ControlRight" | "PageDown" => Held::Down,
        "ShiftLeft" | "ShiftRight" => Held::Faster,
        "KeyQ" => Held::RollLeft,
        "KeyE" => Held::RollRight,
        _ => return None,
    })
}

/// Whether a key moves the camera as long as it is held.
pub fn moves(code: &str) -> bool {
    held(code).is_some()
}

/// What is solid, for a body.
#[derive(Clone, Copy)]
pub struct Ground<'a> {
    solids: Solids<'a>,
    dims: [u32; 3],
    repeat: Repeat,
}

#[derive(Clone, Copy)]
enum Solids<'a> {
    Columns(&'a Columns),
    Voxels(&'a dyn Fn(u32, u32, u32) -> bool),
}

impl<'a> Ground<'a> {
    /// `columns`: level 0.
    pub fn new(columns: &'a Columns, repeat: Repeat) -> Ground<'a> {
        Ground { solids: Solids::Columns(columns), dims: columns.dims(), repeat }
    }

    /// Of a world of these sides, voxel by voxel.
    pub fn of_voxels(dims: [u32; 3], solid: &'a dyn Fn(u32, u32, u32) -> bool) -> Ground<'a> {
        Ground { solids: Solids::Voxels(solid), dims, repeat: Repeat::default() }
    }

    /// Whether a voxel is solid: two binary searches.
    pub fn solid(&self, x: i64, y: i64, z: i64) -> bool {
        let [nx, ny, nz] = self.dims;
        let place = |v: i64, n: u32, repeat: bool| {
            if repeat { Some(v.rem_euclid(i64::from(n)) as u32) } else { u32::try_from(v).ok().filter(|&v| v < n) }
        };
        let at = (place(x, nx, self.repeat.x), place(y, ny, false), place(z, nz, self.repeat.z));
        let (Some(x), Some(y), Some(z)) = at else { return false };
        match self.solids {
            Solids::Columns(columns) => columns.find(x, y, z).is_some(),
            Solids::Voxels(solid) => solid(x, y, z),
        }
    }

    /// Whether a body with its eye there, `below` voxels tall to the eye, holds a part of a solid voxel.
    fn blocks(&self, eye: DVec3, below: f64) -> bool {
        if !eye.is_finite() || eye.abs().max_element() > 1e15 {
            return false;
        }
        let (low, high) = (eye - DVec3::new(SIDE, below, SIDE), eye + DVec3::new(SIDE, HEAD, SIDE));
        let cells = |axis: usize| (low[axis].floor() as i64)..(high[axis].ceil() as i64);
        cells(0).any(|x| cells(2).any(|z| cells(1).any(|y| self.solid(x, y, z))))
    }
}

/// A flight to a place, looking the same way.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Flight {
    from: DVec3,
    to: DVec3,
    seconds: f64,
}

/// The camera and what moves it.
#[derive(Clone, Debug, PartialEq)]
pub struct Control {
    pub pose: Pose,
    /// Voxels a second.
    pub speed: f64,
    /// Voxels from the ground to a walker's eye.
    pub eye_height: f64,
    /// What an orbit goes round.
    pub target: DVec3,
    mode: Mode,
    held: u16,
    /// Voxels a second upwards, of a walker.
    rise: f64,
    grounded: bool,
    flight: Option<Flight>,
}

impl Control {
    /// At a pose, at a speed that crosses a world of that many voxels in ten seconds.
    pub fn new(pose: Pose, dims: [u32; 3]) -> Control {
        let extent = f64::from(dims.into_iter().max().unwrap_or(1));
        let speed = (extent / 10.0).clamp(4.0, 200.0);
        let target = DVec3::from(dims.map(f64::from)) / 2.0;
        Control {
            pose,
            speed,
            eye_height: 1.7,
            target,
            mode: Mode::Fly,
            held: 0,
            rise: 0.0,
            grounded: false,
            flight: None,
        }
    }

    pub fn mode(&self) -> Mode {
        self.mode
    }

    pub fn set_mode(&mut self, mode: Mode) {
        (self.mode, self.rise, self.grounded, self.flight) = (mode, 0.0, false, None);
        if mode == Mode::Orbit {
            self.aim();
        }
    }

    /// Gives an orbit what lies straight ahead to go round, as far away as its target.
    fn aim(&mut self) {
        let ahead = self.forward();
        let distance = (self.target - self.pose.eye).dot(ahead).clamp(DISTANCES.0, DISTANCES.1);
        self.target = self.pose.eye + ahead * distance;
    }

    fn forward(&self) -> DVec3 {
        Pose { roll: 0.0, ..self.pose }.camera([1, 1]).basis().forward
    }

    /// The eye of an orbit at this distance of its target.
    fn swing(&mut self, distance: f64) {
        self.pose.eye = self.target - self.forward() * distance.clamp(DISTANCES.0, DISTANCES.1);
    }

    /// Moves an orbit and what it goes round across the picture: the target follows the mouse over so many pixels, of a picture
    /// `height` pixels high. Other modes go sideways.
    pub fn pan(&mut self, dx: f64, dy: f64, height: f64) {
        if !(dx.is_finite() && dy.is_finite() && height >= 1.0) {
            return;
        }
        let camera = self.pose.camera([1, 1]);
        let (basis, half) = (camera.basis(), camera.half_extent());
        let distance = if self.mode == Mode::Orbit { (self.target - self.pose.eye).length() } else { self.speed };
        let moved = (basis.up * dy - basis.right * dx) * (2.0 * half.y * distance / height);
        self.pose.eye += moved;
        self.target += moved;
    }

    /// Comes nearer by so many notches: an orbit to its target, others along their way.
    pub fn nearer(&mut self, notches: f64) {
        if !notches.is_finite() {
            return;
        }
        let notches = notches.clamp(-20.0, 20.0);
        if self.mode == Mode::Orbit {
            self.swing((self.target - self.pose.eye).length() * NEARER.powf(notches));
        } else {
            self.pose.eye += self.forward() * self.speed * 0.1 * notches;
        }
    }

    /// A key went down or up; false where it moves nothing.
    pub fn key(&mut self, code: &str, down: bool) -> bool {
        let Some(held) = held(code) else { return false };
        if down {
            self.held |= held as u16;
            if held != Held::Faster {
                self.flight = None;
            }
        } else {
            self.held &= !(held as u16);
        }
        true
    }

    /// Lets go of all keys, as when the window loses the keyboard.
    pub fn release(&mut self) {
        self.held = 0;
    }

    /// The mouse moved so many pixels while it looks around.
    pub fn look(&mut self, dx: f64, dy: f64) {
        if !(dx.is_finite() && dy.is_finite()) {
            return;
        }
        let orbits = self.mode == Mode::Orbit;
        let distance = (self.target - self.pose.eye).length();
        let degrees = if orbits { TURN } else { DEGREES_A_PIXEL * self.pose.fov / 60.0 };
        // As seen: a rolled camera turns about its own axes, as far as yaw and pitch go.
        let (s, c) = crate::frame::camera::sin_cos_degrees(self.pose.roll);
        let (dx, dy) = (dx * c + dy * s, dy * c - dx * s);
        self.pose.yaw = (self.pose.yaw + dx * degrees).rem_euclid(360.0);
        self.pose.pitch = (self.pose.pitch - dy * degrees).clamp(-90.0, 90.0);
        if orbits {
            self.swing(distance);
        }
    }

    /// The wheel turned by so many notches: the speed changes by a quarter each, or an orbit comes nearer.
    pub fn wheel(&mut self, notches: f64) {
        if self.mode == Mode::Orbit {
            self.nearer(notches);
        } else if notches.is_finite() {
            self.speed = (self.speed * 1.25f64.powf(notches.clamp(-20.0, 20.0))).clamp(SPEEDS.0, SPEEDS.1);
        }
    }

    /// Goes to a place and looks from there, at once.
    pub fn place(&mut self, pose: Pose) {
        self.pose = pose;
        self.aim();
        (self.rise, self.grounded, self.flight) = (0.0, false, None);
    }

    /// The same place, pace and way in a world whose voxels are `times` as many along each axis.
    pub fn scale(&mut self, times: f64) {
        self.pose.eye *= times;
        self.target *= times;
        self.speed = (self.speed * times).clamp(SPEEDS.0, SPEEDS.1);
        (self.rise, self.grounded) = (self.rise * times, false);
        if let Some(flight) = &mut self.flight {
            flight.from *= times;
            flight.to *= times;
        }
    }

    /// Flies along the ray toward a place that was picked, so far away, and stops before it.
    pub fn fly_to(&mut self, direction: DVec3, distance: f64) {
        let direction = direction.normalize_or_zero();
        let before = (0.1 * distance).max(3.0);
        if direction == DVec3::ZERO || !distance.is_finite() || distance <= before {
            return;
        }
        let to = self.pose.eye + direction * (distance - before);
        self.target = self.pose.eye + direction * distance;
        self.flight = Some(Flight { from: self.pose.eye, to, seconds: 0.0 });
    }

    /// Whether anything would move the camera now without further input.
    pub fn is_moving(&self) -> bool {
        self.flight.is_some() || self.held & !(Held::Faster as u16) != 0 || (self.mode == Mode::Walk && !self.grounded)
    }

    fn holds(&self, key: Held) -> f64 {
        f64::from(u8::from(self.held & key as u16 != 0))
    }

    /// Lets `dt` seconds pass.
    pub fn step(&mut self, dt: f64, ground: &Ground<'_>) {
        let dt = if dt.is_finite() { dt.clamp(0.0, 0.25) } else { 0.0 };
        let roll = self.holds(Held::RollRight) - self.holds(Held::RollLeft);
        if roll != 0.0 {
            self.pose.roll = (self.pose.roll + roll * ROLL * dt + 180.0).rem_euclid(360.0) - 180.0;
        }
        if let Some(flight) = &mut self.flight {
            flight.seconds += dt;
            let part = (flight.seconds / FLIGHT).min(1.0);
            let eased = part * part * (3.0 - 2.0 * part);
            self.pose.eye = flight.from.lerp(flight.to, eased);
            if part == 1.0 {
                self.flight = None;
                if self.mode == Mode::Orbit {
                    self.aim();
                }
            }
            return;
        }
        let speed = self.speed * if self.holds(Held::Faster) > 0.0 { FASTER } else { 1.0 };
        let along = self.holds(Held::Forward) - self.holds(Held::Back);
        let across = self.holds(Held::Right) - self.holds(Held::Left);
        let up = self.holds(Held::Up) - self.holds(Held::Down);
        if self.mode == Mode::Orbit {
            // Keys turn it, and come nearer: a third of the way a second.
            let fast = if self.holds(Held::Faster) > 0.0 { FASTER } else { 1.0 };
            let distance = (self.target - self.pose.eye).length() * (1.0 - 0.9 * fast * dt * along).clamp(0.2, 5.0);
            if along != 0.0 || across != 0.0 || up != 0.0 {
                self.pose.yaw = (self.pose.yaw - across * TURNS * fast * dt).rem_euclid(360.0);
                self.pose.pitch = (self.pose.pitch - up * TURNS * fast * dt).clamp(-90.0, 90.0);
                self.swing(distance);
            }
            return;
        }
        if self.mode == Mode::Walk {
            self.walk(along, across, speed, dt, ground);
            return;
        }
        let camera = Pose { roll: 0.0, ..self.pose }.camera([1, 1]).basis();
        let way = camera.forward * along + camera.right * across + DVec3::Y * up;
        let moved = way.normalize_or_zero() * speed * dt;
        if self.mode == Mode::Fly {
            self.pose.eye += moved;
        } else {
            self.push(moved, HEAD, ground);
        }
    }

    fn walk(&mut self, along: f64, across: f64, speed: f64, dt: f64, ground: &Ground<'_>) {
        let (s, c) = crate::frame::camera::sin_cos_degrees(self.pose.yaw);
        let way = DVec3::new(s, 0.0, -c) * along + DVec3::new(c, 0.0, s) * across;
        let moved = way.normalize_or_zero() * speed * dt;
        // A fall that suits voxels of which a body is some two tall: 25 voxels/s².
        const GRAVITY: f64 = 25.0;
        if self.grounded && self.holds(Held::Up) > 0.0 {
            self.rise = 9.0;
        }
        self.rise = (self.rise - GRAVITY * dt).max(-200.0);
        let below = self.eye_height;
        if ground.blocks(self.pose.eye, below) {
            // Inside the ground, as after flying into it: up to its top.
            self.pose.eye.y = self.pose.eye.y.floor() + 1.0 + below.fract();
            (self.rise, self.grounded) = (0.0, true);
            return;
        }
        let strides = ((moved.length() / STRIDE).ceil() as usize).clamp(1, STRIDES);
        let stride = moved.clamp_length_max(STRIDE * STRIDES as f64) / strides as f64;
        for _ in 0..strides {
            for axis in [DVec3::X, DVec3::Z] {
                let next = self.pose.eye + stride * axis;
                if !ground.blocks(next, below) {
                    self.pose.eye = next;
                } else if self.grounded || self.rise <= 0.0 {
                    // Up onto the step, if there is room above it.
                    let lifted = next + DVec3::Y * STEP;
                    if !ground.blocks(self.pose.eye + DVec3::Y * STEP, below) && !ground.blocks(lifted, below) {
                        self.pose.eye = lifted;
                        self.drop_by(STEP, below, ground);
                    }
                }
            }
        }
        let fall = self.rise * dt;
        if fall > 0.0 {
            let before = self.pose.eye.y;
            self.push(DVec3::Y * fall, below, ground);
            self.grounded = false;
            if self.pose.eye.y - before < 0.5 * fall {
                self.rise = 0.0;
            }
        } else {
            self.grounded = self.drop_by(-fall, below, ground);
            if self.grounded {
                self.rise = 0.0;
            }
        }
        // Below the world there is nothing to land on.
        let floor = below + 0.001;
        if self.pose.eye.y < floor && fall <= 0.0 {
            self.pose.eye.y = floor;
            (self.rise, self.grounded) = (0.0, true);
        }
    }

    /// Falls by at most `by`, down to what is solid; whether that was met.
    fn drop_by(&mut self, by: f64, below: f64, ground: &Ground<'_>) -> bool {
        let mut left = by;
        while left > 0.0 {
            let next = left.min(STRIDE);
            let eye = self.pose.eye - DVec3::Y * next;
            if ground.blocks(eye, below) {
                // Feet on top of the voxel.
                let feet = (eye.y - below).floor() + 1.0;
                self.pose.eye.y = self.pose.eye.y.min(feet + below + 1e-6);
                return true;
            }
            self.pose.eye = eye;
            left -= next;
        }
        false
    }

    /// Moves as far as nothing is in the way, axis by axis, so that a body slides along walls.
    fn push(&mut self, moved: DVec3, below: f64, ground: &Ground<'_>) {
        let strides = ((moved.length() / STRIDE).ceil() as usize).clamp(1, STRIDES);
        let stride = moved.clamp_length_max(STRIDE * STRIDES as f64) / strides as f64;
        for _ in 0..strides {
            for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
                let next = self.pose.eye + stride * axis;
                // A body that is stuck may leave.
                if !ground.blocks(next, below) || ground.blocks(self.pose.eye, below) {
                    self.pose.eye = next;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use planecast_encoder::{ColumnsBuilder, Run};

    /// Ground 10 high, a step of one voxel at x = 20, a wall of 30 at x = 30.
    fn world() -> Columns {
        let mut b = ColumnsBuilder::new(64, 64, 64);
        for _z in 0..64 {
            for x in 0..64 {
                let top = match x {
                    30.. => 40,
                    20.. => 11,
                    _ => 10,
                };
                b.push_run(Run::new(0, top - 1));
                b.end_column();
            }
        }
        b.finish()
    }

    fn control(eye: DVec3, yaw: f64, pitch: f64) -> Control {
        Control::new(Pose { eye, yaw, pitch, roll: 0.0, fov: 60.0 }, [64; 3])
    }

    fn steps(c: &mut Control, n: usize, columns: &Columns) {
        (0..n).for_each(|_| c.step(1.0 / 30.0, &Ground::new(columns, Repeat::default())));
    }

    #[test]
    fn control_scaled_flies_the_same_way_through_finer_voxels() {
        let pose = Pose { eye: DVec3::new(3.0, 5.0, 7.0), yaw: 30.0, pitch: -10.0, roll: 0.0, fov: 60.0 };
        let air = Columns::empty(1, 1, 1);
        let mut coarse = Control::new(pose, [100; 3]);
        let mut fine = coarse.clone();
        fine.scale(4.0);
        let ray = DVec3::new(0.6, 0.0, 0.8);
        for (control, distance) in [(&mut coarse, 100.0), (&mut fine, 400.0)] {
            control.key("KeyW", true);
            control.step(0.1, &Ground::new(&air, Repeat::default()));
            control.fly_to(ray, distance);
            control.step(0.1, &Ground::new(&air, Repeat::default()));
        }
        assert!((4.0 * coarse.pose.eye - fine.pose.eye).length() < 1e-9);
        // One that is on its way is scaled with it.
        coarse.scale(4.0);
        for control in [&mut coarse, &mut fine] {
            control.step(0.2, &Ground::new(&air, Repeat::default()));
        }
        assert!((coarse.pose.eye - fine.pose.eye).length() < 1e-9);
        assert!(coarse.pose.eye.x != pose.eye.x);
    }

    #[test]
    fn control_moves_along_the_camera_at_its_speed() {
        let columns = world();
        let mut c = control(DVec3::new(5.0, 50.0, 40.0), 90.0, 0.0);
        c.speed = 3.0;
        assert!(c.key("KeyW", true) && !c.key("KeyZ", true));
        steps(&mut c, 30, &columns);
        assert!((c.pose.eye - DVec3::new(8.0, 50.0, 40.0)).length() < 1e-9, "{:?}", c.pose.eye);
        c.key("ShiftLeft", true);
        steps(&mut c, 30, &columns);
        assert!((c.pose.eye.x - 20.0).abs() < 1e-9);
        c.release();
        assert!(!c.is_moving());
        for (code, way) in
            [("KeyD", DVec3::Z), ("KeyS", DVec3::NEG_X), ("Space", DVec3::Y), ("ControlLeft", DVec3::NEG_Y)]
        {
            let before = c.pose.eye;
            c.key(code, true);
            steps(&mut c, 30, &columns);
            c.key(code, false);
            assert!((c.pose.eye - before - 3.0 * way).length() < 1e-9, "{code}");
        }
    }

    #[test]
    fn control_orbits_what_it_looks_at() {
        let columns = world();
        let middle = DVec3::splat(32.0);
        let mut c = control(DVec3::new(32.0, 32.0, 132.0), 0.0, 0.0);
        c.set_mode(Mode::Orbit);
        assert!((c.target - middle).length() < 1e-9);
        let at = |c: &Control| (c.target - c.pose.eye).normalize().dot(c.forward());
        for (dx, dy) in [(40.0, 0.0), (0.0, -25.0), (-300.0, 90.0), (0.0, 4000.0), (f64::NAN, 1.0)] {
            c.look(dx, dy);
            assert!((c.target - middle).length() < 1e-9 && ((c.pose.eye - middle).length() - 100.0).abs() < 1e-6);
            assert!((at(&c) - 1.0).abs() < 1e-9, "the target stays in the middle");
        }
        c.wheel(1.0);
        assert!(((c.pose.eye - middle).length() - 88.0).abs() < 1e-6);
        c.look(0.0, -700.0);
        let before = c.pose;
        for code in ["KeyA", "KeyW", "Space"] {
            c.key(code, true);
            steps(&mut c, 10, &columns);
            c.key(code, false);
        }
        assert!((at(&c) - 1.0).abs() < 1e-9 && (c.pose.eye - middle).length() < 88.0 && c.pose.yaw != before.yaw);
        // The mouse takes what is in the middle along: half a picture is half of what is seen there.
        let mut c = control(DVec3::new(32.0, 32.0, 132.0), 0.0, 0.0);
        c.set_mode(Mode::Orbit);
        c.pan(0.0, 50.0, 100.0);
        let half = 100.0 * 30f64.to_radians().tan();
        assert!((c.target - middle - DVec3::Y * half).length() < 1e-9 && (c.pose.eye.y - 32.0 - half).abs() < 1e-9);
        c.place(Pose { eye: DVec3::new(0.0, 32.0, 32.0), yaw: 90.0, pitch: 0.0, ..c.pose });
        c.look(10.0, 10.0);
        assert!((at(&c) - 1.0).abs() < 1e-9, "another place has another target");
        assert_eq!(Mode::of(Some(Kind::Mesh)), Mode::Orbit);
        assert_eq!((Mode::of(Some(Kind::Terrain)), Mode::of(None)), (Mode::Solid, Mode::Fly));
    }

    #[test]
    fn control_looks_and_rolls_within_bounds() {
        let columns = world();
        let mut c = control(DVec3::splat(50.0), 350.0, 80.0);
        c.look(200.0, -1000.0);
        assert!((c.pose.yaw - 14.0).abs() < 1e-9 && c.pose.pitch == 90.0);
        c.look(f64::NAN, f64::INFINITY);
        assert!(c.pose.yaw.is_finite() && c.pose.pitch == 90.0);
        c.key("KeyE", true);
        steps(&mut c, 105, &columns);
        assert!((c.pose.roll + 150.0).abs() < 1e-9, "{}", c.pose.roll);
        let mut c = control(DVec3::splat(50.0), 0.0, 0.0);
        c.pose.roll = 90.0;
        c.look(0.0, 10.0);
        assert!((c.pose.yaw - 1.2).abs() < 1e-9 && c.pose.pitch.abs() < 1e-9, "down the screen is along the yaw");
    }

    #[test]
    fn control_wheel_keeps_the_speed_within_bounds() {
        let mut c = control(DVec3::ZERO, 0.0, 0.0);
        c.speed = 4.0;
        c.wheel(1.0);
        assert_eq!(c.speed, 5.0);
        (0..200).for_each(|_| c.wheel(20.0));
        assert_eq!(c.speed, SPEEDS.1);
        (0..200).for_each(|_| c.wheel(-20.0));
        c.wheel(f64::NAN);
        assert_eq!(c.speed, SPEEDS.0);
    }

    #[test]
    fn control_walks_up_a_step_and_not_through_a_wall() {
        let columns = world();
        let mut c = control(DVec3::new(5.0, 20.0, 32.0), 90.0, -30.0);
        c.set_mode(Mode::Walk);
        c.speed = 8.0;
        steps(&mut c, 60, &columns);
        assert!((c.pose.eye.y - 11.7).abs() < 1e-3 && !c.is_moving(), "fallen to the ground: {:?}", c.pose.eye);
        c.key("KeyW", true);
        steps(&mut c, 70, &columns);
        assert!((c.pose.eye.y - 12.7).abs() < 1e-3 && c.pose.eye.x > 21.0, "on the step: {:?}", c.pose.eye);
        steps(&mut c, 300, &columns);
        assert!(c.pose.eye.x < 30.0 - SIDE + 1e-9 && c.pose.eye.x > 29.0, "at the wall: {:?}", c.pose.eye);
        assert_eq!(c.pose.eye.z, 32.0);
        c.key("KeyW", false);
        c.key("Space", true);
        steps(&mut c, 8, &columns);
        assert!(c.pose.eye.y > 13.5, "a jump: {:?}", c.pose.eye);
        c.key("Space", false);
        steps(&mut c, 60, &columns);
        assert!((c.pose.eye.y - 12.7).abs() < 1e-3);
    }

    #[test]
    fn control_slides_along_walls_and_leaves_what_it_is_stuck_in() {
        let columns = world();
        let mut c = control(DVec3::new(25.0, 20.0, 32.0), 45.0, 0.0);
        c.set_mode(Mode::Solid);
        c.speed = 100.0;
        c.key("KeyW", true);
        steps(&mut c, 10, &columns);
        assert!(c.pose.eye.x < 30.0 && c.pose.eye.z < 10.0, "{:?}", c.pose.eye);
        let mut stuck = control(DVec3::new(40.5, 38.5, 32.0), 0.0, 0.0);
        stuck.set_mode(Mode::Solid);
        stuck.key("Space", true);
        steps(&mut stuck, 60, &columns);
        assert!(stuck.pose.eye.y > 41.0);
        let mut thrown = control(DVec3::new(25.0, 20.0, 32.0), 90.0, 0.0);
        thrown.set_mode(Mode::Solid);
        thrown.speed = 1e6;
        thrown.key("KeyW", true);
        steps(&mut thrown, 30, &columns);
        assert!(thrown.pose.eye.x < 30.0, "no speed goes through a wall");
    }

    #[test]
    fn control_walks_out_of_the_ground_and_not_below_the_world() {
        let columns = world();
        let mut c = control(DVec3::new(5.0, 3.2, 32.0), 90.0, 0.0);
        c.set_mode(Mode::Walk);
        steps(&mut c, 60, &columns);
        assert!((c.pose.eye.y - 11.7).abs() < 1e-3, "{:?}", c.pose.eye);
        c.place(Pose { eye: DVec3::new(-20.0, 50.0, 32.0), ..c.pose });
        steps(&mut c, 400, &columns);
        assert!(c.pose.eye.y > 0.0 && !c.is_moving(), "{:?}", c.pose.eye);
    }

    #[test]
    fn control_ground_repeats_where_the_world_does() {
        let columns = world();
        let (once, tiled) =
            (Ground::new(&columns, Repeat::default()), Ground::new(&columns, Repeat { x: true, z: false }));
        assert!(!once.solid(-1, 5, 5) && tiled.solid(-1, 39, 5) && tiled.solid(64 * 9 + 31, 39, 5));
        assert!(!tiled.solid(5, 5, -1) && !tiled.solid(5, -1, 5) && !tiled.solid(5, 64, 5));
    }

    #[test]
    fn control_flies_to_a_place_and_stops_before_it() {
        let columns = world();
        let mut c = control(DVec3::new(5.0, 60.0, 60.0), 0.0, 0.0);
        c.fly_to(DVec3::NEG_Z * 7.0, 50.0);
        assert!(c.is_moving());
        steps(&mut c, 60, &columns);
        assert!((c.pose.eye - DVec3::new(5.0, 60.0, 15.0)).length() < 1e-9 && !c.is_moving(), "{:?}", c.pose.eye);
        c.fly_to(DVec3::NEG_Z, 50.0);
        c.key("KeyS", true);
        steps(&mut c, 1, &columns);
        assert!(c.pose.eye.z > 15.0, "a key ends the flight");
    }
}
