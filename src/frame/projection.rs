//! Projections: along which ray each pixel looks, for pictures that a pinhole does not make.
//!
//! All but `ortho` look from the eye, in every direction that they have pixels for; their depth is the *range*: the distance
//! along the pixel's ray, of length 1. Angles are about the camera's axes (forward, right, up), whatever its pitch and roll.

use std::fmt;
use std::str::FromStr;

use glam::DVec3;

use crate::cpu::traverse::SKY;
use crate::error::{Error, Result};
use crate::frame::camera::{Basis, Camera, sin_cos_degrees};
use crate::frame::picture::Frame;

/// How directions become pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Projection {
    /// A pinhole: [`Camera::ray`]. Depth is along the camera's forward axis.
    #[default]
    Perspective,
    /// Parallel rays along the forward axis, from the plane through the eye across it; depth is the distance from that plane.
    Ortho {
        /// Voxels that the picture is high; `None`: as high as `perspective` shows at the middle of the world's box.
        height: Option<f64>,
    },
    /// The whole sphere: columns are even in longitude (−180° to 180°, forward in the middle, right of it 90°), rows in
    /// latitude (90° on top).
    Equirect,
    /// Six square faces of 90°, 3 × 2: right, left, up over down, front, back. Up has forward at its bottom, down on top.
    Cube,
    /// A circle in the picture's middle, as wide as its smaller side: the angle to the forward axis is even along its radius
    /// (equidistant), half of `fov` at the rim. Nothing is outside.
    Fisheye,
    /// A scanner that turns about the up axis: a column a step, as `Equirect` has longitudes; a row a channel (beam), whose
    /// elevations go evenly from `fov / 2` to `−fov / 2`. One channel looks level.
    Lidar { channels: u32, steps: u32 },
}

/// Channels and steps of a scanner at most.
const LIDAR_SIDE: u32 = 16_384;

impl Projection {
    pub fn name(self) -> &'static str {
        match self {
            Projection::Perspective => "perspective",
            Projection::Ortho { .. } => "ortho",
            Projection::Equirect => "equirect",
            Projection::Cube => "cube",
            Projection::Fisheye => "fisheye",
            Projection::Lidar { .. } => "lidar",
        }
    }

    /// Width and height of a picture where none are asked for; `None`: as any other.
    pub fn usual_size(self) -> Option<[u32; 2]> {
        match self {
            Projection::Perspective | Projection::Ortho { .. } => None,
            Projection::Equirect => Some([2048, 1024]),
            Projection::Cube => Some([1536, 1024]),
            Projection::Fisheye => Some([1024, 1024]),
            Projection::Lidar { channels, steps } => Some([steps, channels]),
        }
    }

    /// The field of view where none is asked for, degrees.
    pub fn usual_fov(self) -> f64 {
        match self {
            Projection::Fisheye => 180.0,
            Projection::Lidar { .. } => 45.0,
            _ => 60.0,
        }
    }

    /// Whether `fov` means anything to it.
    pub fn has_fov(self) -> bool {
        !matches!(self, Projection::Equirect | Projection::Cube)
    }

    /// Whether a camera's size and field of view go with it; the error says what does.
    pub fn check(self, camera: &Camera) -> Result<()> {
        let (w, h, fov) = (camera.width, camera.height, camera.fov);
        let wrong = |text: String| Err(Error::Argument(text));
        let allowed = match self {
            Projection::Perspective | Projection::Ortho { .. } => (fov > 0.0 && fov < 180.0, "above 0 and below 180"),
            Projection::Fisheye => (fov > 0.0 && fov <= 360.0, "above 0 and at most 360"),
            Projection::Lidar { .. } => ((0.0..=180.0).contains(&fov), "from 0 to 180"),
            Projection::Equirect | Projection::Cube => (true, ""),
        };
        match self {
            _ if !allowed.0 => wrong(format!("field of view of {fov} degrees: must be {}", allowed.1)),
            Projection::Cube if w % 3 != 0 || h % 2 != 0 || w / 3 != h / 2 => wrong(format!(
                "cube of {w} × {h} pixels: its faces are squares, 3 beside each other and 2 over each other, as in 1536x1024"
            )),
            Projection::Lidar { channels, steps } if [w, h] != [steps, channels] => wrong(format!(
                "picture of {w} × {h} pixels: lidar:{channels}x{steps} has a column a step and a row a channel, {steps} × {channels}"
            )),
            Projection::Ortho { height: Some(v) } if !(v.is_finite() && v > 0.0) => {
                wrong(format!("ortho picture of {v} voxels: must be above 0"))
            }
            _ => Ok(()),
        }
    }
}

impl FromStr for Projection {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Projection, String> {
        let (name, rest) = text.split_once(':').map_or((text, None), |(name, rest)| (name, Some(rest)));
        let side = |s: &str| s.parse::<u32>().ok().filter(|n| (1..=LIDAR_SIDE).contains(n));
        match (name, rest) {
            ("perspective", None) => Ok(Projection::Perspective),
            ("ortho", None) => Ok(Projection::Ortho { height: None }),
            ("ortho", Some(v)) => match v.parse::<f64>() {
                Ok(v) if v.is_finite() && v > 0.0 => Ok(Projection::Ortho { height: Some(v) }),
                _ => Err("expected ortho:HEIGHT, the voxels that the picture is high, as in ortho:500".into()),
            },
            ("equirect", None) => Ok(Projection::Equirect),
            ("cube", None) => Ok(Projection::Cube),
            ("fisheye", None) => Ok(Projection::Fisheye),
            ("lidar", rest) => {
                let parts = rest.and_then(|r| r.split_once(['x', 'X']));
                let parts = parts.and_then(|(c, s)| Some((side(c)?, side(s)?)));
                let (channels, steps) = parts.ok_or_else(|| {
                    format!("expected lidar:CHANNELSxSTEPS, as in lidar:128x2048, each 1 to {LIDAR_SIDE}")
                })?;
                Ok(Projection::Lidar { channels, steps })
            }
            _ => {
                Err("expected perspective, ortho, ortho:HEIGHT, equirect, cube, fisheye or lidar:CHANNELSxSTEPS".into())
            }
        }
    }
}

impl fmt::Display for Projection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Projection::Ortho { height: Some(v) } => write!(f, "ortho:{v}"),
            Projection::Lidar { channels, steps } => write!(f, "lidar:{channels}x{steps}"),
            other => f.write_str(other.name()),
        }
    }
}

/// The rays of a picture's pixels.
#[derive(Clone, Debug)]
pub struct Rays {
    camera: Camera,
    basis: Basis,
    kind: Kind,
}

#[derive(Clone, Debug)]
enum Kind {
    Pinhole,
    /// Sine and cosine of each column's longitude and of each row's latitude.
    Angles {
        columns: Vec<[f64; 2]>,
        rows: Vec<[f64; 2]>,
    },
    Cube {
        faces: Box<[Basis; 6]>,
    },
    Fisheye {
        /// Radians a pixel, and at the rim.
        step: f64,
        rim: f64,
    },
    /// Where the rays of the upper left corner begin, and steps from pixel to pixel.
    Parallel {
        corner: DVec3,
        right: DVec3,
        down: DVec3,
    },
}

/// Elevation of a scanner's beam, degrees.
pub fn elevation(channel: u32, channels: u32, fov: f64) -> f64 {
    if channels == 1 { 0.0 } else { fov * (0.5 - f64::from(channel) / f64::from(channels - 1)) }
}

/// Azimuth of a scanner's step, degrees clockwise from the forward axis.
pub fn azimuth(step: u32, steps: u32) -> f64 {
    (f64::from(step) + 0.5) / f64::from(steps) * 360.0 - 180.0
}

/// Faces of a cube in the order of [`Projection::Cube`], row by row.
fn faces(b: &Basis) -> [Basis; 6] {
    let face = |right: DVec3, up: DVec3, forward: DVec3| Basis { right, up, forward };
    [
        face(-b.forward, b.up, b.right),
        face(b.forward, b.up, -b.right),
        face(b.right, -b.forward, b.up),
        face(b.right, b.forward, -b.up),
        face(b.right, b.up, b.forward),
        face(-b.right, b.up, -b.forward),
    ]
}

impl Rays {
    /// `dims`: voxels of the world; [`Projection::Ortho`] may ask for them.
    pub fn new(camera: &Camera, projection: Projection, dims: [u32; 3]) -> Rays {
        let basis = camera.basis();
        let (w, h) = (camera.width, camera.height);
        let turn = |steps: u32| (0..steps).map(|x| azimuth(x, steps)).map(pair).collect();
        let kind = match projection {
            Projection::Perspective => Kind::Pinhole,
            Projection::Equirect => {
                let latitude = |y: u32| 90.0 - (f64::from(y) + 0.5) / f64::from(h) * 180.0;
                Kind::Angles { columns: turn(w), rows: (0..h).map(latitude).map(pair).collect() }
            }
            Projection::Lidar { channels, .. } => {
                let rows = (0..h).map(|y| elevation(y, channels, camera.fov));
                Kind::Angles { columns: turn(w), rows: rows.map(pair).collect() }
            }
            Projection::Cube => Kind::Cube { faces: Box::new(faces(&basis)) },
            Projection::Fisheye => {
                let fov = camera.fov.to_radians();
                Kind::Fisheye { step: fov / f64::from(w.min(h)), rim: fov / 2.0 }
            }
            Projection::Ortho { height } => {
                let middle = DVec3::from(dims.map(f64::from)) / 2.0;
                let distance = (middle - camera.eye).dot(basis.forward).max(1.0);
                let height = height.unwrap_or(2.0 * camera.half_extent().y * distance);
                let pixel = height / f64::from(h);
                let (right, down) = (basis.right * pixel, -basis.up * pixel);
                Kind::Parallel { corner: camera.eye - (right * f64::from(w) + down * f64::from(h)) / 2.0, right, down }
            }
        };
        Rays { camera: *camera, basis, kind }
    }

    /// Where the ray of a pixel begins.
    pub fn origin(&self, x: u32, y: u32) -> DVec3 {
        match self.kind {
            Kind::Parallel { corner, right, down } => {
                corner + right * (f64::from(x) + 0.5) + down * (f64::from(y) + 0.5)
            }
            _ => self.camera.eye,
        }
    }

    /// Its direction, whose length is one unit of depth; `None` where the pixel shows nothing.
    pub fn direction(&self, x: u32, y: u32) -> Option<DVec3> {
        let b = &self.basis;
        let centre = |v: u32| f64::from(v) + 0.5;
        match &self.kind {
            Kind::Pinhole => Some(self.camera.ray(b, centre(x), centre(y))),
            Kind::Parallel { .. } => Some(b.forward),
            Kind::Angles { columns, rows } => {
                let ([sin_lon, cos_lon], [sin_lat, cos_lat]) = (columns[x as usize], rows[y as usize]);
                Some(cos_lat * (cos_lon * b.forward + sin_lon * b.right) + sin_lat * b.up)
            }
            Kind::Cube { faces } => {
                let side = self.camera.height / 2;
                let face = &faces[(y / side * 3 + x / side) as usize];
                let at = |v: u32| 2.0 * centre(v % side) / f64::from(side) - 1.0;
                Some((face.forward + at(x) * face.right - at(y) * face.up).normalize())
            }
            Kind::Fisheye { step, rim } => {
                let dx = centre(x) - f64::from(self.camera.width) / 2.0;
                let dy = f64::from(self.camera.height) / 2.0 - centre(y);
                let r = dx.hypot(dy);
                let angle = r * step;
                if angle > *rim {
                    return None;
                }
                let (sin, cos) = angle.sin_cos();
                let across = if r > 0.0 { (dx * b.right + dy * b.up) / r } else { DVec3::ZERO };
                Some(cos * b.forward + sin * across)
            }
        }
    }

    /// Whether a pixel shows anything; else it is as the sky.
    pub fn shows_all(&self) -> bool {
        !matches!(self.kind, Kind::Fisheye { .. })
    }

    /// Whether the first column is beside the last.
    pub fn is_round(&self) -> bool {
        matches!(self.kind, Kind::Angles { .. })
    }

    /// Directions of `dir[0].len()` pixels of row `y` from column `from` on, for kernels; of what shows nothing, some direction.
    #[inline(always)]
    pub fn fill(&self, from: u32, y: u32, [dx, dy, dz]: [&mut [f32]; 3]) {
        let b = &self.basis;
        let all = dx.iter_mut().zip(dy).zip(dz).enumerate();
        match &self.kind {
            Kind::Pinhole => {
                let (w, y) = (f64::from(self.camera.width), f64::from(y) + 0.5);
                let start = self.camera.ray(b, 0.5, y);
                let step = (self.camera.ray(b, w + 0.5, y) - start) / w;
                for (i, ((dx, dy), dz)) in all {
                    let x = f64::from((from as i32).wrapping_add(i as i32));
                    (*dx, *dy, *dz) =
                        ((start.x + step.x * x) as f32, (start.y + step.y * x) as f32, (start.z + step.z * x) as f32);
                }
            }
            Kind::Angles { columns, rows } => {
                let [sin, cos] = rows[y as usize];
                let (f, r, u) = (b.forward * cos, b.right * cos, b.up * sin);
                let columns = &columns[from as usize..];
                for ((_, ((dx, dy), dz)), [s, c]) in all.zip(columns) {
                    (*dx, *dy, *dz) = (
                        (c * f.x + s * r.x + u.x) as f32,
                        (c * f.y + s * r.y + u.y) as f32,
                        (c * f.z + s * r.z + u.z) as f32,
                    );
                }
            }
            _ => {
                for (i, ((dx, dy), dz)) in all {
                    let d = self.direction(from + i as u32, y).unwrap_or(b.forward).as_vec3();
                    (*dx, *dy, *dz) = (d.x, d.y, d.z);
                }
            }
        }
    }

    /// Sine and cosine of columns' longitudes and of rows' latitudes, where each has one.
    pub fn angles(&self) -> Option<[&[[f64; 2]]; 2]> {
        match &self.kind {
            Kind::Angles { columns, rows } => Some([columns, rows]),
            _ => None,
        }
    }

    /// Voxels that a pixel is wide, of parallel rays.
    pub fn pixel(&self) -> Option<f64> {
        match self.kind {
            Kind::Parallel { right, .. } => Some(right.length()),
            _ => None,
        }
    }

    /// Where the ray of a pixel begins, from the eye.
    pub fn offset(&self, x: u32, y: u32) -> glam::Vec3 {
        (self.origin(x, y) - self.camera.eye).as_vec3()
    }

    /// Pixels a radian, at least: of longitude where it is even, and of what is seen up and down.
    pub fn density(&self) -> [f64; 2] {
        let (w, h) = (f64::from(self.camera.width), f64::from(self.camera.height));
        let tau = std::f64::consts::TAU;
        match &self.kind {
            Kind::Pinhole => [self.camera.focal(); 2],
            Kind::Angles { rows, .. } => {
                let [top, bottom] = [rows[0], rows[rows.len() - 1]].map(|[s, c]| s.atan2(c));
                let down = if h > 1.0 { (h - 1.0) / (top - bottom).max(1e-3) } else { 1.0 };
                [w / tau, down.max(w / tau)]
            }
            Kind::Fisheye { step, .. } => [1.0 / step; 2],
            Kind::Cube { .. } => [h / 4.0; 2],
            Kind::Parallel { .. } => [1.0; 2],
        }
    }

    /// Slopes between which all pixels look, where that is less than the whole sphere; upright pictures of even longitude alone.
    pub fn slopes(&self) -> Option<[f64; 2]> {
        match &self.kind {
            Kind::Angles { rows, .. } if self.basis.forward.y == 0.0 && self.basis.right.y == 0.0 => {
                let [high, low] = [rows[0], rows[rows.len() - 1]].map(|[s, c]| s / c.max(1e-9));
                Some(if self.basis.up.y > 0.0 { [low, high] } else { [-high, -low] })
            }
            _ => None,
        }
    }
}

fn pair(degrees: f64) -> [f64; 2] {
    let (s, c) = sin_cos_degrees(degrees);
    [s, c]
}

/// The cameras of a cube's faces, as [`Projection::Cube`] has them.
pub fn face_cameras(camera: &Camera) -> [Camera; 6] {
    let side = camera.height / 2;
    faces(&camera.basis()).map(|face| {
        let [yaw, pitch, roll] = angles(&face);
        Camera { yaw, pitch, roll, fov: 90.0, width: side, height: side, ..*camera }
    })
}

/// Yaw, pitch and roll of axes.
fn angles(b: &Basis) -> [f64; 3] {
    let whole = |v: f64| {
        // Right angles stay what they are.
        let quarter = (v / 90.0).round() * 90.0;
        if (v - quarter).abs() < 1e-9 { quarter } else { v }
    };
    let level = b.forward.x.hypot(b.forward.z);
    let pitch = whole(b.forward.y.atan2(level).to_degrees());
    if pitch.abs() == 90.0 {
        // All of the turn is in the yaw: up is (∓sin yaw, 0, ±cos yaw).
        let up = if pitch > 0.0 { -b.up } else { b.up };
        return [whole(up.x.atan2(-up.z).to_degrees()), pitch, 0.0];
    }
    let yaw = whole(b.forward.x.atan2(-b.forward.z).to_degrees());
    // right = right0·cos r − up0·sin r; the y of right0 is 0, that of up0 is cos pitch.
    let roll = whole((-b.right.y).atan2(b.up.y).to_degrees());
    [yaw, pitch, roll]
}

/// One picture of six faces, in order.
pub fn join_faces(camera: &Camera, faces: Vec<Frame>) -> Frame {
    let side = (camera.height / 2) as usize;
    let w = camera.width as usize;
    let n = w * camera.height as usize;
    let voxels = faces.iter().any(|f| !f.voxel.is_empty());
    let mut joined = Frame {
        width: camera.width,
        height: camera.height,
        color: vec![[0; 4]; n],
        depth: vec![f32::INFINITY; if faces.iter().all(|f| f.depth.is_empty()) { 0 } else { n }],
        voxel: vec![SKY; if voxels { n } else { 0 }],
        stats: crate::Stats::default(),
    };
    for (k, face) in faces.into_iter().enumerate() {
        for y in 0..side {
            let (from, to) = (y * side..(y + 1) * side, ((k / 3 * side + y) * w + k % 3 * side)..);
            let to = to.start..to.start + side;
            joined.color[to.clone()].copy_from_slice(&face.color[from.clone()]);
            if voxels {
                joined.voxel[to.clone()].copy_from_slice(&face.voxel[from.clone()]);
            }
            if !joined.depth.is_empty() {
                let at = |v: usize| 2.0 * (v as f64 + 0.5) / side as f64 - 1.0;
                for (x, (to, depth)) in joined.depth[to].iter_mut().zip(&face.depth[from]).enumerate() {
                    *to = (f64::from(*depth) * (1.0 + at(x).powi(2) + at(y).powi(2)).sqrt()) as f32;
                }
            }
        }
        joined.stats = crate::Stats { width: camera.width, height: camera.height, ..joined.stats.joined(face.stats) };
    }
    joined
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(yaw: f64, pitch: f64, roll: f64, [width, height]: [u32; 2]) -> Camera {
        Camera { eye: DVec3::new(1.0, 2.0, 3.0), yaw, pitch, roll, fov: 90.0, width, height }
    }

    fn near(a: DVec3, b: DVec3) -> bool {
        (a - b).length() < 1e-12
    }

    #[test]
    fn projections_read_what_they_write() {
        for text in ["perspective", "ortho", "ortho:12.5", "equirect", "cube", "fisheye", "lidar:128x2048"] {
            assert_eq!(text.parse::<Projection>().unwrap().to_string(), text);
        }
        for text in ["lidar", "lidar:0x5", "lidar:128", "ortho:-1", "ortho:nan", "equirect:2", "sphere", ""] {
            assert!(text.parse::<Projection>().is_err(), "{text}");
        }
    }

    #[test]
    fn equirect_looks_where_its_longitudes_and_latitudes_say() {
        // Odd numbers: a pixel in the very middle, one at 90° to each side.
        let c = camera(0.0, 0.0, 0.0, [360, 181]);
        let rays = Rays::new(&c, Projection::Equirect, [1; 3]);
        let at = |lon: f64, lat: f64| {
            let (x, y) = ((lon + 180.0) as u32, ((90.0 - lat) / 180.0 * 181.0) as u32);
            rays.direction(x, y).unwrap()
        };
        let (s, k) = sin_cos_degrees(0.5);
        assert!(near(at(0.5, 0.0), DVec3::new(s, 0.0, -k)));
        assert!(near(at(90.5, 0.0), DVec3::new(k, 0.0, s)));
        assert!(near(at(-89.5, 0.0), DVec3::new(-k, 0.0, -s)));
        assert!(near(at(179.5, 0.0), DVec3::new(s, 0.0, k)));
        assert!(at(0.5, 90.0).y > 0.9999 && at(0.5, -89.9).y < -0.9999);
        assert!((0..360 * 181).all(|i| (rays.direction(i % 360, i / 360).unwrap().length() - 1.0).abs() < 1e-12));
    }

    #[test]
    fn cube_faces_are_cameras_of_their_own() {
        for (yaw, pitch, roll) in
            [(0.0, 0.0, 0.0), (30.0, 0.0, 0.0), (200.0, -35.0, 0.0), (10.0, 20.0, 70.0), (5.0, 90.0, 10.0)]
        {
            let c = camera(yaw, pitch, roll, [24, 16]);
            let rays = Rays::new(&c, Projection::Cube, [1; 3]);
            for (k, face) in face_cameras(&c).into_iter().enumerate() {
                let basis = face.basis();
                for (x, y) in [(0, 0), (7, 0), (3, 5), (7, 7)] {
                    let own = face.ray(&basis, f64::from(x) + 0.5, f64::from(y) + 0.5).normalize();
                    let (px, py) = (k as u32 % 3 * 8 + x, k as u32 / 3 * 8 + y);
                    let joined = rays.direction(px, py).unwrap();
                    assert!((own - joined).length() < 1e-9, "{yaw} {pitch} {roll}: face {k} {own} {joined}");
                }
            }
        }
        // Right, left, up over down, front, back of a camera that looks along −z.
        let mid = |k: u32| {
            let rays = Rays::new(&camera(0.0, 0.0, 0.0, [3, 2]), Projection::Cube, [1; 3]);
            rays.direction(k % 3, k / 3).unwrap()
        };
        let expected = [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::NEG_Z, DVec3::Z];
        assert!((0..6).all(|k| near(mid(k), expected[k as usize])));
    }

    #[test]
    fn fisheye_is_even_in_the_angle_and_ends_at_its_rim() {
        let c = Camera { fov: 180.0, ..camera(0.0, 0.0, 0.0, [121, 101]) };
        let rays = Rays::new(&c, Projection::Fisheye, [1; 3]);
        assert!(near(rays.direction(60, 50).unwrap(), DVec3::NEG_Z));
        let (s, k) = (25.0 / 101.0 * 180.0f64).to_radians().sin_cos();
        assert!(near(rays.direction(85, 50).unwrap(), DVec3::new(s, 0.0, -k)));
        assert!(near(rays.direction(60, 25).unwrap(), DVec3::new(0.0, s, -k)));
        assert!(rays.direction(0, 50).is_none() && rays.direction(60, 0).is_some() && !rays.shows_all());
    }

    #[test]
    fn lidar_has_beams_from_the_highest_to_the_lowest() {
        assert_eq!([0, 1, 2].map(|c| elevation(c, 3, 40.0)), [20.0, 0.0, -20.0]);
        assert_eq!(elevation(0, 1, 40.0), 0.0);
        assert_eq!([0, 1, 2, 3].map(|s| azimuth(s, 4)), [-135.0, -45.0, 45.0, 135.0]);
        let c = Camera { fov: 40.0, ..camera(90.0, 0.0, 0.0, [4, 3]) };
        let rays = Rays::new(&c, Projection::Lidar { channels: 3, steps: 4 }, [1; 3]);
        let [s, k] = pair(45.0);
        // 45° to the right of +x is (x, z) = (cos, sin).
        assert!(near(rays.direction(2, 1).unwrap(), DVec3::new(k, 0.0, s)));
        assert_eq!(rays.slopes().map(|v| v.map(|v| (v * 1e6).round())), Some([-363_970.0, 363_970.0]));
    }

    #[test]
    fn ortho_is_as_high_as_it_says_and_as_perspective_at_the_middle() {
        let c = Camera { eye: DVec3::new(50.0, 300.0, 50.0), ..camera(0.0, -90.0, 0.0, [200, 100]) };
        let rays = Rays::new(&c, Projection::Ortho { height: Some(100.0) }, [100; 3]);
        assert!(
            near(rays.origin(0, 0), DVec3::new(-49.5, 300.0, 0.5))
                && near(rays.origin(199, 99), DVec3::new(149.5, 300.0, 99.5))
        );
        assert_eq!(rays.direction(3, 4), Some(DVec3::NEG_Y));
        // 250 voxels away; a field of view of 90° shows 500 there.
        let rays = Rays::new(&c, Projection::Ortho { height: None }, [100; 3]);
        assert!(near(rays.origin(0, 1) - rays.origin(0, 0), DVec3::new(0.0, 0.0, 5.0)));
    }

    #[test]
    fn sizes_and_fields_of_view_that_do_not_fit_are_refused_by_name() {
        let says =
            |p: Projection, size, fov| p.check(&Camera { fov, ..camera(0.0, 0.0, 0.0, size) }).unwrap_err().to_string();
        assert!(says(Projection::Cube, [300, 100], 60.0).contains("1536x1024"));
        assert!(says(Projection::Fisheye, [9, 9], 361.0).contains("at most 360"));
        assert!(says(Projection::Lidar { channels: 2, steps: 3 }, [2, 3], 1.0).contains("3 × 2"));
        assert!(says(Projection::Lidar { channels: 2, steps: 3 }, [3, 2], 181.0).contains("0 to 180"));
        assert!(says(Projection::Perspective, [3, 2], 180.0).contains("below 180"));
    }
}
