//! Poses at equal steps along a path.

use crate::film::path::{Path, Pose};

/// Looks along a path at which the way so far is known.
const LOOKS: usize = 8192;

/// Voxels of rounding alone, at most: an eye that stands still seems to move by as much.
const STILL: f64 = 0.1;

/// A path by the way that the eye has flown.
pub struct Flight {
    path: Path,
    /// Voxels flown until each of [`LOOKS`] equal times.
    flown: Vec<f64>,
}

impl Flight {
    /// # Errors
    /// A path whose eye does not move.
    pub fn new(path: Path) -> Result<Flight, String> {
        let poses = path.poses(LOOKS);
        let mut flown = vec![0.0];
        for pair in poses.windows(2) {
            flown.push(flown[flown.len() - 1] + (pair[1].eye - pair[0].eye).length());
        }
        match flown[LOOKS - 1] > STILL {
            true => Ok(Flight { path, flown }),
            false => {
                Err("the eye stands still; a flight of so many voxels per frame needs a path along which it moves"
                    .into())
            }
        }
    }

    /// Voxels from one end to the other.
    pub fn length(&self) -> f64 {
        self.flown[LOOKS - 1]
    }

    /// So many poses, each so many voxels after the one before; at an end of the path the way goes back, with the path's own
    /// directions of view.
    pub fn poses(&self, voxels_per_frame: f64, frames: usize) -> Vec<Pose> {
        (0..frames).map(|i| self.at(voxels_per_frame * i as f64)).collect()
    }

    fn at(&self, way: f64) -> Pose {
        let length = self.length();
        let turned = way.rem_euclid(2.0 * length);
        let way = turned.min(2.0 * length - turned);
        let after = self.flown.partition_point(|&flown| flown <= way).clamp(1, LOOKS - 1);
        let [from, to] = [self.flown[after - 1], self.flown[after]];
        let part = if to > from { (way - from) / (to - from) } else { 0.0 };
        let start = self.path.keyframes()[0].t;
        self.path.at(start + self.path.duration() * ((after - 1) as f64 + part) / (LOOKS - 1) as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::film::path::Keyframe;
    use glam::DVec3;

    fn path(keys: &[(f64, f64)]) -> Path {
        let key = |&(t, x): &(f64, f64)| Keyframe {
            t,
            pose: Pose { eye: DVec3::new(x, 1.0, 2.0), yaw: 90.0, pitch: -t, roll: 0.0, fov: 60.0 },
        };
        Path::new(keys.iter().map(key).collect()).unwrap()
    }

    #[test]
    fn steps_are_equal_however_the_path_is_timed_and_turn_at_its_ends() {
        // Slow at first, then fast.
        let flight = Flight::new(path(&[(3.0, 10.0), (5.0, 30.0), (7.0, 110.0)])).unwrap();
        assert!((flight.length() - 100.0).abs() < 1e-6);
        let eyes: Vec<f64> = flight.poses(30.0, 9).iter().map(|pose| pose.eye.x).collect();
        let expected = [10.0, 40.0, 70.0, 100.0, 90.0, 60.0, 30.0, 20.0, 50.0];
        assert!(eyes.iter().zip(expected).all(|(a, b)| (a - b).abs() < 0.05), "{eyes:?}");
        // There and back looks the same way.
        let [there, back] = [4, 16].map(|i| flight.poses(10.0, 17)[i]);
        assert!(
            (there.eye - back.eye).length() < 1e-6 && (there.pitch - back.pitch).abs() < 1e-6,
            "{there:?} {back:?}"
        );
    }

    #[test]
    fn a_path_that_stands_still_is_none() {
        for keys in [&[(0.0, 5.0)][..], &[(0.0, 5.0), (1.0, 5.0)]] {
            assert!(Flight::new(path(keys)).err().unwrap().contains("stands still"));
        }
    }
}
