//! The camera: where the eye is and along which ray each pixel looks.

use glam::{DVec2, DVec3};

/// A pinhole camera in the world frame: right-handed, y up, units are voxels of level 0, angles in degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    pub eye: DVec3,
    /// 0 looks along −z, 90 along +x.
    pub yaw: f64,
    /// Positive looks up; −90 ..= 90.
    pub pitch: f64,
    /// Positive turns the camera clockwise as seen from behind: what is above moves to the left.
    pub roll: f64,
    /// Vertical field of view, above 0 and below 180.
    pub fov: f64,
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
}

impl Default for Camera {
    /// At the origin, level, looking along −z; 60° high, 1280 × 720 pixels.
    fn default() -> Camera {
        Camera { eye: DVec3::ZERO, yaw: 0.0, pitch: 0.0, roll: 0.0, fov: 60.0, width: 1280, height: 720 }
    }
}

/// The camera's axes in the world frame, orthonormal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Basis {
    pub right: DVec3,
    pub up: DVec3,
    pub forward: DVec3,
}

/// Sine and cosine of an angle in degrees, exact at the multiples of 90 (so that a level, an upright and a
/// straight-down camera have components that are exactly 0).
pub fn sin_cos_degrees(degrees: f64) -> (f64, f64) {
    let turns = degrees.rem_euclid(360.0);
    let quadrant = (turns / 90.0).round();
    let (s, c) = (turns - quadrant * 90.0).to_radians().sin_cos();
    match quadrant as i64 & 3 {
        0 => (s, c),
        1 => (c, -s),
        2 => (-s, -c),
        _ => (-c, s),
    }
}

impl Camera {
    /// Axes from yaw, pitch and roll: `forward = (sin yaw · cos pitch, sin pitch, −cos yaw · cos pitch)`.
    pub fn basis(&self) -> Basis {
        let (sy, cy) = sin_cos_degrees(self.yaw);
        let (sp, cp) = sin_cos_degrees(self.pitch);
        let (sr, cr) = sin_cos_degrees(self.roll);
        let forward = DVec3::new(sy * cp, sp, -cy * cp);
        let right0 = DVec3::new(cy, 0.0, sy);
        let up0 = DVec3::new(-sy * sp, cp, cy * sp); // right0 × forward, written out: no −0 from the product
        Basis { right: right0 * cr - up0 * sr, up: up0 * cr + right0 * sr, forward }
    }

    /// Half the image plane's extent at distance 1: `(W/H · tan(fov/2), tan(fov/2))`.
    pub fn half_extent(&self) -> DVec2 {
        let v = (self.fov.to_radians() / 2.0).tan();
        DVec2::new(v * f64::from(self.width) / f64::from(self.height), v)
    }

    /// Pixels a unit of image plane at distance 1: a voxel at depth d is `focal() / d` pixels wide.
    pub fn focal(&self) -> f64 {
        f64::from(self.height) / 2.0 / self.half_extent().y
    }

    /// Direction through image position `(x, y)` in pixels, `(0, 0)` the upper left corner of the image, pixel
    /// centres at `+½`. Its component along `forward` is 1, so a parameter along it is a depth.
    pub fn ray(&self, basis: &Basis, x: f64, y: f64) -> DVec3 {
        let e = self.half_extent();
        let a = (2.0 * x / f64::from(self.width) - 1.0) * e.x;
        let b = (1.0 - 2.0 * y / f64::from(self.height)) * e.y;
        basis.forward + a * basis.right + b * basis.up
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(yaw: f64, pitch: f64, roll: f64) -> Camera {
        Camera { eye: DVec3::ZERO, yaw, pitch, roll, fov: 60.0, width: 4, height: 3 }
    }

    #[test]
    fn basis_is_orthonormal_and_right_handed() {
        for (yaw, pitch, roll) in [(0.0, 0.0, 0.0), (33.0, -71.0, 12.0), (270.0, 90.0, 45.0), (-720.5, -90.0, 360.0)] {
            let b = camera(yaw, pitch, roll).basis();
            assert!((b.right.cross(b.up) + b.forward).length() < 1e-15, "{yaw} {pitch} {roll}");
            assert!((b.right.length() - 1.0).abs() < 1e-15 && b.right.dot(b.forward).abs() < 1e-15);
        }
    }

    #[test]
    fn basis_follows_the_contract() {
        assert_eq!(camera(0.0, 0.0, 0.0).basis().forward, DVec3::new(0.0, 0.0, -1.0));
        assert_eq!(camera(90.0, 0.0, 0.0).basis().forward, DVec3::X);
        assert_eq!(camera(0.0, -90.0, 0.0).basis().up, DVec3::new(0.0, 0.0, -1.0));
        let rolled = camera(0.0, 0.0, 90.0).basis();
        assert_eq!((rolled.right, rolled.up), (DVec3::NEG_Y, DVec3::X));
    }

    #[test]
    fn basis_is_exact_at_right_angles() {
        for quarter in -8..=8 {
            let (s, c) = sin_cos_degrees(f64::from(quarter) * 90.0);
            assert!(s * c == 0.0 && (s.abs() == 1.0 || c.abs() == 1.0), "{quarter}: {s} {c}");
        }
    }
}
