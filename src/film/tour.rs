//! A good view and a good tour of any scene, made from its columns alone.
//!
//! A view is framed by what is solid, taken from a coarse level, so that a scene of any size takes the same short time: an
//! *object* (tall for its width) fills three quarters of the picture, from the front, or from where one sees into it much
//! deeper: a room from its open side; a *terrain* (wide and low) is seen whole, obliquely, with north away from the eye.
//!
//! The tour begins and ends there. Over a terrain the camera flies a loop within the map, above the ground, looking ahead and
//! inwards, toward where the relief is highest. An object is circled at the distance at which it fills the picture, from a
//! height that rises and falls.
//!
//! The loop keeps above the highest solid voxel of every column near it: the height that is needed is taken around
//! each of its points, widened and smoothed by windows of one length, so that the smoothed height nowhere falls below
//! the needed one. The finished path, its stretches between keyframes included, is then checked against the ground
//! and lifted as a whole by what it lacks.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3};
use planecast_encoder::{Columns, Scene};

use crate::Repeat;
use crate::film::path::{Keyframe, Path, Pose};

/// Seconds that a tour takes unless told otherwise.
pub const SECONDS: f64 = 20.0;

/// Keyframes of a loop.
const KEYFRAMES: usize = 48;

/// Points of a loop at which the needed height is taken.
const SAMPLES: usize = 960;

/// What a tour must know of the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Vertical field of view, degrees.
    pub fov: f64,
    /// Pixels.
    pub size: [u32; 2],
    pub repeat: Repeat,
}

/// A tour of the scene, [`SECONDS`] long, a loop that starts and ends at its good view.
pub fn tour(scene: &Scene, view: View) -> Path {
    let ground = Ground::new(&scene.levels[0].solid, view.repeat);
    if view.repeat.x || view.repeat.z {
        // A world without end is not seen whole.
        return lift(over(&ground, view.fov, None), &ground);
    }
    let subject = Subject::new(scene);
    let still = subject.still(view);
    let path = match subject.terrain {
        true => over(&ground, view.fov, Some(still)),
        false => around(&subject, view, still),
    };
    lift(path, &ground)
}

/// A tour that goes once round a point, from `yaw` on, at one pitch and distance.
pub fn round(target: DVec3, yaw: f64, pitch: f64, distance: f64, fov: f64) -> Path {
    closed(|u| from_side(target, yaw + 360.0 * u, pitch, distance, fov))
}

/// A good single view of the scene.
pub fn still(scene: &Scene, view: View) -> Pose {
    if view.repeat.x || view.repeat.z {
        return tour(scene, view).at(0.0);
    }
    Subject::new(scene).still(view)
}

/// The pose that looks at `target` along yaw and pitch from this far.
pub fn from_side(target: DVec3, yaw: f64, pitch: f64, distance: f64, fov: f64) -> Pose {
    let pose = Pose { eye: target, yaw, pitch, roll: 0.0, fov };
    let forward = pose.camera([1, 1]).basis().forward;
    Pose { eye: target - distance * forward, ..pose }
}

/// What of the picture an object takes, and a terrain, along the side that is filled more.
const FILLED_BY_OBJECT: f64 = 0.75;
const FILLED_BY_TERRAIN: f64 = 0.92;

/// Degrees from which an object is seen first, and a terrain.
const SIDE_OF_OBJECT: [f64; 2] = [-29.0, -22.0];
const SIDE_OF_TERRAIN: [f64; 2] = [18.0, -34.0];

/// What is solid in a scene, as coarsely as a picture's frame needs to know.
pub struct Subject {
    /// Corners of the lowest and highest voxel of each column of a coarse level, voxels of level 0.
    corners: Vec<DVec3>,
    pub low: DVec3,
    pub high: DVec3,
    pub terrain: bool,
    /// Yaw and pitch of the good view.
    pub side: [f64; 2],
}

impl Subject {
    /// Columns a side of the level that is looked at, at most.
    const COLUMNS: u32 = 128;

    pub fn new(scene: &Scene) -> Subject {
        let level = scene.levels.iter().position(|l| l.solid.nx().max(l.solid.nz()) <= Subject::COLUMNS);
        let mut level = level.unwrap_or(scene.levels.len() - 1);
        // By the rule of majorities thin things vanish from coarse levels.
        while level > 0 && scene.levels[level].solid.runs().is_empty() {
            level -= 1;
        }
        let columns = &scene.levels[level].solid;
        let size = f64::from(1u32 << level);
        let dims = DVec3::from(scene.dims().map(f64::from));
        let (mut corners, mut covered, mut low, mut high) = (Vec::new(), 0u64, DVec3::INFINITY, DVec3::NEG_INFINITY);
        for z in 0..columns.nz() {
            for x in 0..columns.nx() {
                let runs = columns.column(x, z);
                let (Some(first), Some(last)) = (runs.first(), runs.last()) else { continue };
                covered += 1;
                // A coarse voxel may reach beyond the world.
                let near = DVec3::new(x.into(), first.first().into(), z.into()) * size;
                let far = (DVec3::new(f64::from(x) + 1.0, last.end().into(), f64::from(z) + 1.0) * size).min(dims);
                for [x, z] in [[near.x, near.z], [near.x, far.z], [far.x, near.z], [far.x, far.z]] {
                    corners.extend([DVec3::new(x, near.y, z), DVec3::new(x, far.y, z)]);
                }
                (low, high) = (low.min(near), high.max(far));
            }
        }
        if corners.is_empty() {
            (low, high) = (DVec3::ZERO, dims); // nothing is solid: the empty world itself is looked at
            corners = (0..8).map(|i| dims * DVec3::new((i & 1).into(), (i >> 1 & 1).into(), (i >> 2).into())).collect();
        }
        let wide = high.y <= 0.4 * dims.x.min(dims.z);
        let terrain = wide && 2 * covered > u64::from(columns.nx()) * u64::from(columns.nz());
        let side = match terrain {
            false => side_of_object(columns, [low, high].map(|at| at / size)),
            true if dims.z > 1.6 * dims.x => [SIDE_OF_TERRAIN[0] + 90.0, SIDE_OF_TERRAIN[1]],
            true => SIDE_OF_TERRAIN,
        };
        Subject { corners, low, high, terrain, side }
    }

    /// The middle of the box around what is solid.
    pub fn center(&self) -> DVec3 {
        (self.low + self.high) / 2.0
    }

    fn still(&self, view: View) -> Pose {
        let [yaw, pitch] = self.side;
        self.framed(yaw, pitch, view)
    }

    /// The pose along yaw and pitch from which all is in the picture, in its middle, and fills it as a good view does.
    pub fn framed(&self, yaw: f64, pitch: f64, view: View) -> Pose {
        let filled = if self.terrain { FILLED_BY_TERRAIN } else { FILLED_BY_OBJECT };
        let pose = Pose { eye: self.center(), yaw, pitch, roll: 0.0, fov: view.fov };
        let camera = pose.camera(view.size);
        let (basis, half) = (camera.basis(), camera.half_extent() * filled);
        // Across, up and along the direction of view.
        let along: Vec<DVec3> = self
            .corners
            .iter()
            .map(|c| c - self.center())
            .map(|d| DVec3::new(d.dot(basis.right), d.dot(basis.up), d.dot(basis.forward)))
            .collect();
        // An eye at (x, y, z) sees a corner within the half extents where |across − x| ≤ half · (along − z): on each axis the
        // nearest eye that the two sides allow.
        let axis = |of: fn(&DVec3) -> f64, half: f64| {
            let sum = along.iter().map(|d| of(d) - half * d.z).fold(f64::NEG_INFINITY, f64::max);
            let difference = along.iter().map(|d| -of(d) - half * d.z).fold(f64::NEG_INFINITY, f64::max);
            // x ≥ sum + half·z and −x ≥ difference + half·z.
            -(sum + difference) / (2.0 * half)
        };
        // And out of the box: the nearest corner is in front of the eye.
        let nearest = along.iter().map(|d| d.z).fold(f64::INFINITY, f64::min);
        let z = axis(|d| d.x, half.x).min(axis(|d| d.y, half.y)).min(nearest - 1e-3 * (self.high - self.low).length());
        // Where both ends of what is seen are equally far from the picture's middle.
        let middle = |of: fn(&DVec3) -> f64| {
            let ends = |at: f64| {
                let seen = along.iter().map(|d| (of(d) - at) / (d.z - z));
                seen.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)))
            };
            let size = (self.high - self.low).length();
            let (mut low, mut high) = (-size, size);
            for _ in 0..24 {
                let at = (low + high) / 2.0;
                let (least, most) = ends(at);
                if least + most > 0.0 { low = at } else { high = at }
            }
            (low + high) / 2.0
        };
        let (x, y) = (middle(|d| d.x), middle(|d| d.y));
        let eye = self.center() + x * basis.right + y * basis.up + z * basis.forward;
        Pose { eye, ..pose }
    }

    /// How far from `target` along yaw and pitch all is in the picture.
    pub fn distance(&self, target: DVec3, yaw: f64, pitch: f64, view: View) -> f64 {
        let pose = Pose { eye: target, yaw, pitch, roll: 0.0, fov: view.fov };
        let camera = pose.camera(view.size);
        let filled = if self.terrain { FILLED_BY_TERRAIN } else { FILLED_BY_OBJECT };
        let (basis, half) = (camera.basis(), camera.half_extent() * filled);
        let needed = |c: &DVec3| {
            let d = c - target;
            (d.dot(basis.right).abs() / half.x).max(d.dot(basis.up).abs() / half.y) - d.dot(basis.forward)
        };
        self.corners.iter().map(needed).fold(1.0, f64::max)
    }
}

/// The side from which an object is seen first: the front, unless another shows what is inside of the box around it.
fn side_of_object(columns: &Columns, bounds: [DVec3; 2]) -> [f64; 2] {
    let [yaw, pitch] = SIDE_OF_OBJECT;
    let quarters = [0.0, 90.0, 180.0, -90.0].map(|turn| [yaw + turn, pitch]);
    let depths = quarters.map(|side| depth_behind(columns, bounds, side));
    let deepest = (1..4).fold(0, |best, i| if depths[i] > depths[best] { i } else { best });
    // A box's front is as good as its back; a figure's is better.
    if depths[deepest] > 0.1 && depths[deepest] > 1.8 * depths[0] { quarters[deepest] } else { quarters[0] }
}

/// How far behind the faces of its box an object is seen from one side: the mean over parallel rays that meet it, in diagonals of
/// the box.
fn depth_behind(columns: &Columns, [low, high]: [DVec3; 2], [yaw, pitch]: [f64; 2]) -> f64 {
    const RAYS: i32 = 24;
    let basis = Pose { eye: DVec3::ZERO, yaw, pitch, roll: 0.0, fov: 60.0 }.camera([1, 1]).basis();
    let (center, diagonal) = ((low + high) / 2.0, (high - low).length());
    let depth = |u: i32, v: i32| -> Option<f64> {
        let [u, v] = [u, v].map(|at| (f64::from(at) + 0.5) / f64::from(RAYS) - 0.5);
        let from = center + diagonal * (u * basis.right + v * basis.up - basis.forward);
        let [a, b] = [low, high].map(|corner| (corner - from) / basis.forward);
        let (enters, leaves) = (a.min(b).max_element(), a.max(b).min_element());
        // A step of a voxel is enough to tell sides apart.
        let steps = (leaves - enters).max(0.0).ceil() as u32;
        (0..steps).map(|i| f64::from(i) + 0.5).find(|t| {
            let at = (from + (enters + t) * basis.forward).floor();
            columns.solid(at.x as i64, at.y as i64, at.z as i64)
        })
    };
    let seen: Vec<f64> = (0..RAYS).flat_map(|v| (0..RAYS).filter_map(move |u| depth(u, v))).collect();
    if seen.is_empty() { 0.0 } else { seen.iter().sum::<f64>() / (seen.len() as f64 * diagonal) }
}

/// What a tour shows of its loop at `u`, 0 to 1, and what of its good view: all of that at both ends.
fn near_ends(u: f64) -> f64 {
    let t = 1.0 - (u.min(1.0 - u) / 0.25).min(1.0);
    t * t * (3.0 - 2.0 * t)
}

/// From one pose to another, by the shorter turn.
fn between(a: Pose, b: Pose, part: f64) -> Pose {
    let turn = (b.yaw - a.yaw + 180.0).rem_euclid(360.0) - 180.0;
    Pose {
        eye: a.eye + part * (b.eye - a.eye),
        yaw: a.yaw + part * turn,
        pitch: a.pitch + part * (b.pitch - a.pitch),
        ..a
    }
}

/// The greatest height in each square cell of columns.
struct Ground {
    /// Columns a cell is wide.
    cell: u32,
    cells: [usize; 2],
    /// Voxels, x fastest; the greatest top of a cell and the eight around it.
    near: Vec<f64>,
    /// Voxels, x fastest; the greatest top of a cell.
    tops: Vec<f64>,
    dims: DVec3,
    repeat: Repeat,
    /// Voxels kept between the eye and the ground below.
    clearance: f64,
}

impl Ground {
    /// Cells along the longer side of the map; a power of two of columns goes into each.
    const CELLS: u32 = 512;

    fn new(columns: &Columns, repeat: Repeat) -> Ground {
        let [nx, ny, nz] = columns.dims();
        let cell = nx.max(nz).div_ceil(Ground::CELLS).next_power_of_two();
        let cells = [nx.div_ceil(cell) as usize, nz.div_ceil(cell) as usize];
        let mut tops = vec![0.0f64; cells[0] * cells[1]];
        for z in 0..nz {
            for x in 0..nx {
                let Some(last) = columns.column(x, z).last() else { continue };
                let at = (z / cell) as usize * cells[0] + (x / cell) as usize;
                tops[at] = tops[at].max(f64::from(last.end()));
            }
        }
        let dims = DVec3::new(nx.into(), ny.into(), nz.into());
        let clearance = (0.035 * dims.x.min(dims.z)).max(2.0);
        let mut ground = Ground { cell, cells, near: Vec::new(), tops, dims, repeat, clearance };
        ground.near = (0..cells[0] * cells[1])
            .map(|i| {
                let (x, z) = ((i % cells[0]) as i64, (i / cells[0]) as i64);
                let around = (-1..=1).flat_map(|dz| (-1..=1).map(move |dx| (x + dx, z + dz)));
                around.filter_map(|(x, z)| ground.index(x, z)).map(|i| ground.tops[i]).fold(0.0, f64::max)
            })
            .collect();
        ground
    }

    /// Number of a cell; outside the map there is none unless the world repeats.
    fn index(&self, x: i64, z: i64) -> Option<usize> {
        let wrap = |v: i64, n: usize, repeat: bool| {
            let n = n as i64;
            if repeat { Some(v.rem_euclid(n)) } else { (0..n).contains(&v).then_some(v) }
        };
        let x = wrap(x, self.cells[0], self.repeat.x)?;
        let z = wrap(z, self.cells[1], self.repeat.z)?;
        Some(z as usize * self.cells[0] + x as usize)
    }

    /// The greatest height of the columns around `(x, z)`, at least one column's width around it; 0 off the map.
    fn near(&self, x: f64, z: f64) -> f64 {
        // The last cell of a row may be narrower than the others, so a repeated world wraps in columns first.
        let wrap = |v: f64, n: f64, repeat: bool| if repeat { v.rem_euclid(n) } else { v };
        let cell = |v: f64| (v / f64::from(self.cell)).floor() as i64;
        let x = cell(wrap(x, self.dims.x, self.repeat.x));
        let z = cell(wrap(z, self.dims.z, self.repeat.z));
        self.index(x, z).map_or(0.0, |i| self.near[i])
    }

    /// Where the relief is: the centroid of the cells above the mean height, weighted by the square of what they rise.
    fn interest(&self) -> DVec2 {
        let mean = self.tops.iter().sum::<f64>() / self.tops.len() as f64;
        let (mut sum, mut weights) = (DVec2::ZERO, 0.0);
        for (i, top) in self.tops.iter().enumerate().filter(|(_, t)| **t > mean) {
            let weight = (top - mean) * (top - mean);
            let at = DVec2::new((i % self.cells[0]) as f64 + 0.5, (i / self.cells[0]) as f64 + 0.5);
            sum += weight * at * f64::from(self.cell);
            weights += weight;
        }
        if weights > 0.0 { sum / weights } else { self.center() }
    }

    /// The middle of the map, x and z.
    fn center(&self) -> DVec2 {
        DVec2::new(self.dims.x, self.dims.z) / 2.0
    }
}

/// The pose at `eye` that looks at `target`.
pub fn look(eye: DVec3, target: DVec3, fov: f64) -> Pose {
    let d = target - eye;
    let yaw = d.x.atan2(-d.z).to_degrees();
    let pitch = d.y.atan2(d.x.hypot(d.z)).to_degrees();
    Pose { eye, yaw, pitch, roll: 0.0, fov }
}

/// A path from poses at equal times; the first is repeated at the end.
fn closed(pose: impl Fn(f64) -> Pose) -> Path {
    let keyframes = (0..=KEYFRAMES).map(|i| {
        let u = i as f64 / KEYFRAMES as f64;
        Keyframe { t: u * SECONDS, pose: pose(u % 1.0) }
    });
    Path::new(keyframes.collect()).expect("a tour's keyframes are finite and in order")
}

/// A loop over a terrain; where it begins with a view of the whole, from that down and back to it.
fn over(ground: &Ground, fov: f64, still: Option<Pose>) -> Path {
    let center = ground.center();
    // Half way to the interest from the centre: near enough to be looked at from all of the loop, and never so near
    // to the loop that the view swings round.
    let interest = center + 0.5 * (ground.interest() - center);
    let away = center - interest;
    let start = if let Some(still) = still {
        // Below the view from which it comes.
        let (sin, cos) = still.yaw.to_radians().sin_cos();
        cos.atan2(-sin)
    } else if away.length() > 0.02 * center.length() {
        away.y.atan2(away.x)
    } else {
        TAU / 8.0
    };
    let place = |u: f64| {
        let angle = start + u * TAU;
        center + 0.66 * center * (1.0 + 0.1 * (3.0 * angle).sin()) * DVec2::from_angle(angle)
    };

    let needed: Vec<f64> = (0..SAMPLES)
        .map(|i| {
            let at = place(i as f64 / SAMPLES as f64);
            ground.near(at.x, at.y) + ground.clearance
        })
        .collect();
    let heights = smoothed(&needed, SAMPLES / 16, |i| i.rem_euclid(SAMPLES as isize) as usize);

    let mean = ground.tops.iter().sum::<f64>() / ground.tops.len() as f64;
    closed(|u| {
        let (at, ahead) = (place(u), place(u + 1.0 / 6.0));
        let target = (ahead + interest) / 2.0;
        let eye = DVec3::new(at.x, heights[(u * SAMPLES as f64).round() as usize % SAMPLES], at.y);
        let pose = look(eye, DVec3::new(target.x, mean, target.y), fov);
        let pose = Pose { pitch: pose.pitch.clamp(-35.0, -5.0), ..pose };
        still.map_or(pose, |still| between(pose, still, near_ends(u)))
    })
}

/// Heights of a line's points, none lower than is needed there: the greatest that is needed within `half` points, smoothed. `point`
/// says which point stands before the first and past the last.
fn smoothed(needed: &[f64], half: usize, point: impl Fn(isize) -> usize) -> Vec<f64> {
    let around = |i: usize, half: usize| {
        let (i, half) = (i as isize, half as isize);
        (i - half..=i + half).map(&point)
    };
    let all = 0..needed.len();
    let widest: Vec<f64> = all.clone().map(|i| around(i, half).map(|j| needed[j]).fold(0.0, f64::max)).collect();
    // Two boxes of half the length make a smoother curve than one, and reach as far.
    let smooth = |v: &[f64]| -> Vec<f64> {
        all.clone().map(|i| around(i, half / 2).map(|j| v[j]).sum::<f64>() / (half / 2 * 2 + 1) as f64).collect()
    };
    smooth(&smooth(&widest))
}

/// A straight way over the middle of a scene, along its longer side from edge to edge in [`SECONDS`], looking ahead and a little
/// down. It is lower than a tour: what is nearest takes the finest level.
pub fn across(scene: &Scene, fov: f64) -> Path {
    let mut ground = Ground::new(&scene.levels[0].solid, Repeat::default());
    ground.clearance = (0.01 * ground.dims.x.min(ground.dims.z)).max(2.0);
    let center = ground.center();
    let along_x = ground.dims.x >= ground.dims.z;
    let place = |i: usize| {
        let part = i as f64 / SAMPLES as f64;
        if along_x { DVec2::new(part * ground.dims.x, center.y) } else { DVec2::new(center.x, part * ground.dims.z) }
    };
    let needed: Vec<f64> = (0..=SAMPLES)
        .map(|i| {
            let at = place(i);
            ground.near(at.x, at.y) + ground.clearance
        })
        .collect();
    let heights = smoothed(&needed, SAMPLES / 32, |i| i.clamp(0, SAMPLES as isize) as usize);
    let keyframes = (0..=KEYFRAMES).map(|k| {
        let i = k * SAMPLES / KEYFRAMES;
        let at = place(i);
        let yaw = if along_x { 90.0 } else { 180.0 };
        let pose = Pose { eye: DVec3::new(at.x, heights[i], at.y), yaw, pitch: -10.0, roll: 0.0, fov };
        Keyframe { t: k as f64 / KEYFRAMES as f64 * SECONDS, pose }
    });
    lift(Path::new(keyframes.collect()).expect("keyframes on a line are finite and in order"), &ground)
}

/// A loop around an object.
fn around(subject: &Subject, view: View, still: Pose) -> Path {
    let center = subject.center();
    let [yaw, pitch] = subject.side;
    let side = |u: f64| [yaw - 360.0 * u, pitch - 6.0 + 6.0 * (u * TAU).cos()];
    // Near enough that from everywhere on the loop all of it is in the picture; 0.6 diagonals keep the eye out of the object at
    // any field of view.
    let needed = |i: usize| {
        let [yaw, pitch] = side(i as f64 / KEYFRAMES as f64);
        subject.distance(center, yaw, pitch, view)
    };
    let distance = (0..KEYFRAMES).map(needed).fold(0.6 * (subject.high - subject.low).length(), f64::max);
    closed(|u| {
        let [yaw, pitch] = side(u);
        between(from_side(center, yaw, pitch, distance, view.fov), still, near_ends(u))
    })
}

/// The path, raised by what it lacks to keep half the clearance over the ground everywhere: the smoothing leaves the
/// whole clearance at the keyframes, and the spline between them strays by less than the other half.
fn lift(path: Path, ground: &Ground) -> Path {
    let lack = deficit(&path, ground);
    if lack <= 0.0 {
        return path;
    }
    let raised = path.keyframes().iter().map(|k| {
        let mut k = *k;
        k.pose.eye.y += lack;
        k
    });
    Path::new(raised.collect()).expect("a raised path is as valid as before")
}

/// By how many voxels at most the path comes nearer to the ground than half the clearance, looked at so often that
/// it moves less than half a column between two looks; `Ground::near` answers for a whole column around. Between two looks the path
/// is taken to go down by half of what they differ, below the lower one.
fn deficit(path: &Path, ground: &Ground) -> f64 {
    let keys = path.keyframes();
    let length: f64 = keys.windows(2).map(|k| (k[1].pose.eye - k[0].pose.eye).length()).sum();
    let looks = (4.0 * length / f64::from(ground.cell)).clamp(4000.0, 200_000.0) as usize;
    let floor = ground.clearance / 2.0;
    let lacks = |p: &[Pose]| {
        let [a, b] = [p[0].eye, p[1].eye];
        let lowest = a.y.min(b.y) - (a.y - b.y).abs() / 2.0;
        ground.near(a.x, a.z).max(ground.near(b.x, b.z)) + floor - lowest
    };
    path.poses(looks).windows(2).map(lacks).fold(f64::NEG_INFINITY, f64::max)
}

/// A place over the middle of a scene, a tenth of its height above what stands there.
pub fn within(scene: &Scene) -> DVec3 {
    let [nx, ny, nz] = scene.dims();
    let top = scene.levels[0].solid.column(nx / 2, nz / 2).last().map_or(0, |run| run.end());
    let above = f64::from(top) + 0.1 * f64::from(ny) + 2.0;
    DVec3::new(f64::from(nx) / 2.0, above, f64::from(nz) / 2.0)
}

#[cfg(test)]
mod tests {
    use planecast_encoder::{ColorMode, ColumnsBuilder, Encoding, Level, MipRule, Run};
    use proptest::prelude::*;

    use super::*;

    fn scene(solid: Columns) -> Scene {
        let level = Level { solid, exposed: None, colors: Vec::new(), matter: None };
        Scene {
            encoding: Encoding::Solid,
            color: ColorMode::None,
            mip_rule: MipRule::Any,
            levels: vec![level],
            classes: None,
        }
    }

    fn view(fov: f64, size: [u32; 2], repeat: Repeat) -> View {
        View { fov, size, repeat }
    }

    const USUAL: View = View { fov: 60.0, size: [640, 360], repeat: Repeat { x: false, z: false } };

    fn terrain(nx: u32, ny: u32, nz: u32, height: impl Fn(u32, u32) -> u32) -> Columns {
        let mut b = ColumnsBuilder::new(nx, ny, nz);
        for z in 0..nz {
            for x in 0..nx {
                if height(x, z) > 0 {
                    b.push_run(Run::new(0, (height(x, z) - 1).min(ny - 1) as u16));
                }
                b.end_column();
            }
        }
        b.finish()
    }

    /// The least distance from an eye down to the column below it, over many times off the keyframes; the repeated
    /// world where one repeats.
    fn least_clearance(columns: &Columns, path: &Path, repeat: Repeat) -> f64 {
        let cell = |v: f64, n: u32, repeat: bool| {
            let v = v.floor() as i64;
            if repeat { Some(v.rem_euclid(n.into())) } else { (0..i64::from(n)).contains(&v).then_some(v) }
        };
        (0..7919)
            .map(|i| path.at(path.duration() * f64::from(i) / 7918.0).eye)
            .map(|eye| match (cell(eye.x, columns.nx(), repeat.x), cell(eye.z, columns.nz(), repeat.z)) {
                (Some(x), Some(z)) => {
                    eye.y - columns.column(x as u32, z as u32).last().map_or(0.0, |r| f64::from(r.end()))
                }
                _ => f64::INFINITY,
            })
            .fold(f64::INFINITY, f64::min)
    }

    fn random_height([x, z]: [u32; 2], rough: u32, seed: u32) -> u32 {
        let cell = (x >> (2 * rough)).wrapping_mul(0x9e37_79b1) ^ (z >> (2 * rough)).wrapping_mul(0x85eb_ca77) ^ seed;
        cell.wrapping_mul(0xc2b2_ae3d) >> 7
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn tour_keeps_its_clearance_over_any_world(
            (nx, ny, nz) in (1u32..90, 1u32..200, 1u32..90),
            seed in any::<u32>(),
            rough in 0u32..3,
            fov in 10.0..150.0f64,
            repeat in (any::<bool>(), any::<bool>()),
        ) {
            let columns = terrain(nx, ny, nz, |x, z| random_height([x, z], rough, seed) % (ny + 1));
            let repeat = Repeat { x: repeat.0, z: repeat.1 };
            let scene = scene(columns);
            let path = tour(&scene, view(fov, [320, 200], repeat));
            let columns = &scene.levels[0].solid;
            let clearance = 0.5 * (0.035 * f64::from(nx.min(nz))).max(2.0);
            let least = least_clearance(columns, &path, repeat);
            prop_assert!(least >= clearance, "{least} of {clearance}");
        }
    }

    #[test]
    fn tour_keeps_its_clearance_between_the_looks_of_its_own_check() {
        // Seen once in a random world: it goes down so steeply there that a look every 50th of a second missed the lowest place.
        let (nx, ny, nz, seed) = (9, 1, 28, 28_904_522);
        let columns = terrain(nx, ny, nz, |x, z| random_height([x, z], 1, seed) % (ny + 1));
        let path = tour(&scene(columns.clone()), view(145.701_320_626_223_23, [320, 200], Repeat::default()));
        let least = least_clearance(&columns, &path, Repeat::default());
        assert!(least >= 1.0, "{least} of 1");
    }

    #[test]
    fn tour_clearance_check_catches_a_spike() {
        let flat = terrain(256, 64, 256, |_, _| 4);
        let path = tour(&scene(flat), USUAL);
        let eye = path.at(9.87).eye; // over the map, half way round
        let spiked = terrain(256, 64, 256, |x, z| if (x, z) == (eye.x as u32, eye.z as u32) { 60 } else { 4 });
        assert!(deficit(&path, &Ground::new(&spiked, Repeat::default())) > 40.0);
        assert!(least_clearance(&spiked, &path, Repeat::default()) < 0.0, "the test's own check sees it too");
    }

    #[test]
    fn tour_is_a_loop_without_jumps() {
        let hills = terrain(300, 80, 200, |x, z| {
            20 + ((f64::from(x) / 17.0).sin() * 18.0 + (f64::from(z) / 11.0).cos() * 12.0) as u32
        });
        for columns in [hills, terrain(20, 40, 20, |_, _| 40)] {
            let path = tour(&scene(columns), USUAL);
            let poses = path.poses(600);
            let length: f64 = poses.windows(2).map(|p| (p[1].eye - p[0].eye).length()).sum();
            for p in poses.windows(2) {
                assert!((p[1].eye - p[0].eye).length() < 3.0 * length / 599.0);
                assert!((p[1].yaw - p[0].yaw).abs() < 4.0 && (p[1].pitch - p[0].pitch).abs() < 2.0, "{p:?}");
            }
            let turns = (poses[599].yaw - poses[0].yaw) / 360.0;
            assert!((poses[599].eye - poses[0].eye).length() < 1e-9 && (turns.abs() - 1.0).abs() < 1e-9, "{turns}");
        }
    }

    #[test]
    fn tour_begins_with_the_good_view_of_the_whole() {
        let hills = terrain(300, 40, 260, |x, z| 4 + (x * 7 + z * 5) % 23);
        for columns in [hills, terrain(20, 60, 20, |x, _| 30 + x)] {
            let scene = scene(columns);
            let (first, still) = (tour(&scene, USUAL).at(0.0), still(&scene, USUAL));
            let turn = (first.yaw - still.yaw + 180.0).rem_euclid(360.0) - 180.0;
            assert!((first.eye - still.eye).length() < 1e-6, "{first:?} {still:?}");
            assert!(turn.abs() < 1e-9 && (first.pitch - still.pitch).abs() < 1e-9, "{first:?} {still:?}");
            let camera = still.camera(USUAL.size);
            let (basis, half) = (camera.basis(), camera.half_extent());
            let dims = DVec3::from(scene.dims().map(f64::from));
            let columns = &scene.levels[0].solid;
            let mut ends = [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY];
            for (x, z) in (0..columns.nz()).flat_map(|z| (0..columns.nx()).map(move |x| (x, z))) {
                let top = f64::from(columns.column(x, z)[0].end());
                for corner in 0..8u32 {
                    let at = DVec3::new(
                        f64::from(x + (corner & 1)),
                        f64::from(corner >> 2) * top,
                        f64::from(z + (corner >> 1 & 1)),
                    );
                    let d = at - still.eye;
                    let (x, y) = (d.dot(basis.right) / half.x, d.dot(basis.up) / half.y);
                    let depth = d.dot(basis.forward);
                    assert!(depth > 0.0);
                    ends = [
                        ends[0].min(x / depth),
                        ends[1].max(x / depth),
                        ends[2].min(y / depth),
                        ends[3].max(y / depth),
                    ];
                }
            }
            let filled = ((ends[1] - ends[0]) / 2.0).max((ends[3] - ends[2]) / 2.0);
            let expected = if dims.x > 100.0 { FILLED_BY_TERRAIN } else { FILLED_BY_OBJECT };
            assert!((filled - expected).abs() < 0.02, "{filled} of {expected}");
            assert!((ends[0] + ends[1]).abs() < 0.02 && (ends[2] + ends[3]).abs() < 0.02, "{ends:?}");
        }
    }

    #[test]
    fn a_way_across_is_straight_and_over_all_that_stands_there() {
        let spiked = |nx, nz| terrain(nx, 90, nz, |x, z| if (x + z) % 37 == 0 { 80 } else { 5 });
        for columns in [spiked(300, 90), spiked(90, 300), terrain(1, 1, 1, |_, _| 1), Columns::empty(50, 30, 40)] {
            let scene = scene(columns);
            let path = across(&scene, 60.0);
            let (columns, poses) = (&scene.levels[0].solid, path.poses(200));
            let (first, last) = (poses[0].eye, poses[199].eye);
            let forward = poses[0].camera([4, 3]).basis().forward;
            assert!((last - first).normalize().dot(forward) > 0.9, "{first} {last}");
            assert!(
                poses
                    .iter()
                    .all(|p| (p.yaw - poses[0].yaw).abs() < 1e-9 && (p.eye - first).cross(last - first).y.abs() < 1e-6)
            );
            let [nx, _, nz] = columns.dims().map(f64::from);
            assert!(((last - first).x.hypot((last - first).z) - nx.max(nz)).abs() < 1e-6);
            assert!(least_clearance(columns, &path, Repeat::default()) >= 1.0);
        }
    }

    #[test]
    fn tour_fits_an_object_into_the_picture() {
        let tower = terrain(12, 90, 20, |_, _| 90);
        for size in [[640, 360], [200, 400]] {
            let path = tour(&scene(tower.clone()), view(60.0, size, Repeat::default()));
            for pose in path.poses(50) {
                let camera = pose.camera(size);
                let (basis, half) = (camera.basis(), camera.half_extent());
                for corner in 0..8 {
                    let corner = DVec3::new(12.0, 90.0, 20.0)
                        * DVec3::new((corner & 1).into(), (corner >> 1 & 1).into(), (corner >> 2).into());
                    let d = corner - pose.eye;
                    let (x, y, depth) = (d.dot(basis.right), d.dot(basis.up), d.dot(basis.forward));
                    assert!(x.abs() <= half.x * depth && y.abs() <= half.y * depth, "{pose:?}");
                }
            }
        }
    }

    #[test]
    fn a_room_is_seen_from_its_open_side_and_all_else_from_the_front() {
        // Walls on all sides but one, half as thick as the room is high.
        for (open, turn) in [(2, 0.0), (1, -90.0), (0, 180.0), (3, 90.0)] {
            let room = Columns::from_fn(40, 30, 40, |x, y, z| {
                let walls = [z < 4, x > 35, z > 35, x < 4];
                y < 3 || walls.iter().enumerate().any(|(side, &wall)| wall && side != open)
            });
            let yaw = Subject::new(&scene(room)).side[0];
            assert_eq!((yaw - SIDE_OF_OBJECT[0] - turn).rem_euclid(360.0), 0.0, "open to {open}: {yaw}");
        }
        let figures = [
            Columns::from_fn(20, 40, 20, |_, _, _| true),
            Columns::from_fn(20, 40, 20, |x, y, z| (x + z) / 3 == y / 5),
            Columns::from_fn(30, 30, 30, |x, y, z| [x, y, z].iter().map(|&v| v.abs_diff(15).pow(2)).sum::<u32>() < 200),
        ];
        for figure in figures {
            assert_eq!(Subject::new(&scene(figure)).side, SIDE_OF_OBJECT);
        }
    }

    #[test]
    fn tour_of_a_voxel_and_of_nothing_are_finite() {
        for columns in [terrain(1, 1, 1, |_, _| 1), Columns::empty(1, 1, 1), Columns::empty(500, 30, 400)] {
            let middle = DVec3::from(columns.dims().map(f64::from)) / 2.0;
            let pose = still(&scene(columns), USUAL);
            let toward = (middle - pose.eye).normalize();
            assert!(toward.dot(pose.camera([4, 3]).basis().forward) > 0.7, "{pose:?}");
        }
    }
}
