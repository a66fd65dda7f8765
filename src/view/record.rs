//! Recording a flight as the path that `fly --path` takes, and playing it.

use crate::film::path::{Keyframe, Path, Pose};

/// Seconds between keyframes.
const EVERY: f64 = 0.25;

/// Keyframes at most: an hour and more.
const KEYFRAMES: usize = 16_384;

/// Records or plays a path.
#[derive(Clone, Debug, Default)]
pub enum Recorder {
    #[default]
    Idle,
    Recording {
        keyframes: Vec<Keyframe>,
        t: f64,
    },
    Playing {
        t: f64,
    },
}

impl Recorder {
    /// Begins to record.
    pub fn record(&mut self) {
        *self = Recorder::Recording { keyframes: Vec::new(), t: 0.0 };
    }

    /// Begins to play.
    pub fn play(&mut self) {
        *self = Recorder::Playing { t: 0.0 };
    }

    /// Ends what is under way; the path, if one was being recorded. `pose`: where the camera is now.
    pub fn stop(&mut self, pose: Pose) -> Option<Path> {
        let Recorder::Recording { mut keyframes, t } = std::mem::take(self) else { return None };
        match keyframes.last_mut() {
            // So close to one before: the end takes its place.
            Some(last) if t - last.t < 0.5 * EVERY && last.t > 0.0 => *last = Keyframe { t, pose },
            Some(last) if t <= last.t => {}
            _ => keyframes.push(Keyframe { t, pose }),
        }
        Path::new(keyframes).ok()
    }

    /// Lets `dt` seconds pass with the camera at `pose`. While a path plays, the pose to take; `None` from its end on.
    pub fn step(&mut self, dt: f64, pose: Pose, played: Option<&Path>) -> Option<Pose> {
        match self {
            Recorder::Idle => None,
            Recorder::Recording { keyframes, t } => {
                let due = keyframes.last().is_none_or(|last| *t - last.t >= EVERY - 1e-9);
                if due && keyframes.len() < KEYFRAMES {
                    keyframes.push(Keyframe { t: *t, pose });
                }
                *t += dt;
                None
            }
            Recorder::Playing { t } => {
                let path = played?;
                let begin = path.keyframes()[0].t;
                let at = *t;
                *t += dt;
                if at > path.duration() {
                    *self = Recorder::Idle;
                    return None;
                }
                Some(path.at(begin + at))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn pose(x: f64) -> Pose {
        Pose { eye: DVec3::new(x, 1.0, 2.0), yaw: 10.0 * x, pitch: 0.0, roll: 0.0, fov: 60.0 }
    }

    #[test]
    fn recorder_makes_a_path_that_fly_reads_and_that_plays_the_same() {
        let mut r = Recorder::default();
        r.record();
        let dt = 1.0 / 60.0;
        for i in 0..100 {
            assert_eq!(r.step(dt, pose(f64::from(i) * dt), None), None);
        }
        let path = r.stop(pose(100.0 * dt)).unwrap();
        assert!((path.duration() - 100.0 * dt).abs() < 1e-9, "{}", path.duration());
        assert!(path.keyframes().len() >= 7);
        let read = Path::parse(&path.to_json(), 45.0).unwrap();
        for (read, written) in read.keyframes().iter().zip(path.keyframes()) {
            assert!((read.t - written.t).abs() < 1e-12 && (read.pose.eye - written.pose.eye).length() < 1e-12);
        }
        assert_eq!(read.keyframes().len(), path.keyframes().len());
        r.play();
        for i in 0..=100 {
            let at = r.step(dt, pose(0.0), Some(&read)).expect("plays");
            assert!((at.eye.x - f64::from(i) * dt).abs() < 1e-6, "{i}: {at:?}");
        }
        assert_eq!(r.step(dt, pose(0.0), Some(&read)), None);
        assert!(matches!(r, Recorder::Idle));
    }

    #[test]
    fn recorder_stopped_at_once_keeps_one_keyframe() {
        let mut r = Recorder::default();
        assert!(r.stop(pose(0.0)).is_none(), "nothing was being recorded");
        r.record();
        assert_eq!(r.stop(pose(3.0)).unwrap().keyframes().len(), 1);
        r.record();
        r.step(0.0, pose(1.0), None);
        assert_eq!(r.stop(pose(3.0)).unwrap().keyframes().len(), 1);
    }
}
