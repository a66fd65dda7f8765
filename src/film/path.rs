//! Camera paths: keyframes and the smooth curve through them.
//!
//! A path file is JSON: a list of keyframes in the order of their times.
//!
//! ```json
//! [
//!   {"t": 0, "eye": [10, 60, 200], "yaw": 30, "pitch": -15},
//!   {"t": 2.5, "eye": [90, 70, 120], "yaw": 75, "pitch": -20, "roll": 5, "fov": 50}
//! ]
//! ```
//!
//! | field | unit | |
//! | --- | --- | --- |
//! | `t` | seconds | must increase from keyframe to keyframe |
//! | `eye` | voxels of level 0 | x, y, z |
//! | `yaw`, `pitch` | degrees | pitch from −90 to 90 |
//! | `roll` | degrees | 0 if left out |
//! | `fov` | degrees, vertical | above 0, below 180; that of `--fov` if left out |
//!
//! Between keyframes each of the seven numbers follows the natural cubic spline over time: position, speed and
//! acceleration are continuous, and the acceleration is 0 at both ends. Yaw and roll take the shorter turn from
//! one keyframe to the next. As the spline may swing past its keyframes, pitch is kept within ±90 and the field
//! of view within the least and the greatest of the keyframes.

use std::path::Path as FilePath;

use glam::DVec3;
use planecast_encoder::{Error, Result};
use serde_json::{Map, Value, json};

use crate::Camera;

/// Where the camera is and looks; degrees and voxels as in [`Camera`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    pub eye: DVec3,
    pub yaw: f64,
    pub pitch: f64,
    pub roll: f64,
    pub fov: f64,
}

impl Pose {
    /// Pixels wide and high.
    pub fn camera(&self, [width, height]: [u32; 2]) -> Camera {
        let Pose { eye, yaw, pitch, roll, fov } = *self;
        Camera { eye, yaw, pitch, roll, fov, width, height }
    }

    /// The pose that comes `times` as far after this one as this came after another.
    #[must_use]
    pub fn ahead(self, before: Pose, times: f64) -> Pose {
        let turn = (self.yaw - before.yaw + 180.0).rem_euclid(360.0) - 180.0;
        Pose {
            eye: self.eye + (self.eye - before.eye) * times,
            yaw: self.yaw + turn * times,
            pitch: (self.pitch + (self.pitch - before.pitch) * times).clamp(-90.0, 90.0),
            ..self
        }
    }
}

/// A pose and its time in seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keyframe {
    pub t: f64,
    pub pose: Pose,
}

/// A smooth curve through keyframes.
#[derive(Clone, Debug)]
pub struct Path {
    keyframes: Vec<Keyframe>,
    /// eye x, y, z, yaw, pitch, roll, fov
    curves: [Spline; 7],
}

impl Path {
    /// A path through these keyframes. What is wrong is told as `keyframe N, field: …`, N from 1.
    pub fn new(keyframes: Vec<Keyframe>) -> Result<Path, String> {
        if keyframes.is_empty() {
            return Err("has no keyframe; at least one is needed".into());
        }
        for (i, k) in keyframes.iter().enumerate() {
            let n = i + 1;
            let p = &k.pose;
            for (field, value) in [("t", k.t), ("eye", p.eye.x + p.eye.y + p.eye.z), ("yaw", p.yaw), ("roll", p.roll)] {
                if !value.is_finite() {
                    return Err(format!("keyframe {n}, {field}: is not a finite number"));
                }
            }
            if !(-90.0..=90.0).contains(&p.pitch) {
                return Err(format!("keyframe {n}, pitch: {} is not in -90 to 90", p.pitch));
            }
            if !(p.fov > 0.0 && p.fov < 180.0) {
                return Err(format!("keyframe {n}, fov: {} is not above 0 and below 180", p.fov));
            }
            if i > 0 && k.t <= keyframes[i - 1].t {
                let before = keyframes[i - 1].t;
                return Err(format!("keyframe {n}, t: {} is not after {before}, the time of keyframe {i}", k.t));
            }
        }
        let times: Vec<f64> = keyframes.iter().map(|k| k.t).collect();
        let curve = |of: fn(&Pose) -> f64| Spline::new(&times, keyframes.iter().map(|k| of(&k.pose)).collect());
        let turn = |of: fn(&Pose) -> f64| Spline::new(&times, unwrap(keyframes.iter().map(|k| of(&k.pose))));
        let curves = [
            curve(|p| p.eye.x),
            curve(|p| p.eye.y),
            curve(|p| p.eye.z),
            turn(|p| p.yaw),
            curve(|p| p.pitch),
            turn(|p| p.roll),
            curve(|p| p.fov),
        ];
        Ok(Path { keyframes, curves })
    }

    /// The path with other poses at the same times.
    #[must_use]
    pub fn with_poses(&self, pose: impl Fn(Pose) -> Pose) -> Path {
        let keyframes = self.keyframes.iter().map(|key| Keyframe { pose: pose(key.pose), ..*key });
        Path::new(keyframes.collect()).expect("a pose that is elsewhere is still one")
    }

    /// Reads a path file; keyframes without `fov` take `default_fov`.
    pub fn read(file: &FilePath, default_fov: f64) -> Result<Path> {
        let text = std::fs::read_to_string(file).map_err(|e| Error::io(file, "read", e))?;
        Path::parse(&text, default_fov).map_err(|what| Error::format(file, what))
    }

    /// A path from the text of a path file.
    pub fn parse(text: &str, default_fov: f64) -> Result<Path, String> {
        // Editors of some systems put a byte order mark first.
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let value: Value = serde_json::from_str(text).map_err(|e| format!("is not JSON: {e}"))?;
        let Value::Array(list) = value else {
            return Err(format!("expected a list of keyframes, found {}", kind(&value)));
        };
        let keyframes: Result<Vec<Keyframe>, String> = list
            .iter()
            .enumerate()
            .map(|(i, v)| keyframe(v, default_fov).map_err(|e| format!("keyframe {}{e}", i + 1)))
            .collect();
        Path::new(keyframes?)
    }

    /// The path as the text of a path file.
    pub fn to_json(&self) -> String {
        let lines: Vec<String> = self
            .keyframes
            .iter()
            .map(|Keyframe { t, pose: p }| {
                let eye = p.eye.to_array();
                json!({"t": t, "eye": eye, "yaw": p.yaw, "pitch": p.pitch, "roll": p.roll, "fov": p.fov}).to_string()
            })
            .collect();
        format!("[\n  {}\n]\n", lines.join(",\n  "))
    }

    pub fn keyframes(&self) -> &[Keyframe] {
        &self.keyframes
    }

    /// Seconds from the first keyframe to the last.
    pub fn duration(&self) -> f64 {
        self.keyframes[self.keyframes.len() - 1].t - self.keyframes[0].t
    }

    /// The pose at time `t`, seconds; before the first and after the last keyframe the path stands still.
    pub fn at(&self, t: f64) -> Pose {
        let v = |i: usize| self.curves[i].at(t);
        let fovs = || self.keyframes.iter().map(|k| k.pose.fov);
        let (narrow, wide) = (fovs().fold(f64::INFINITY, f64::min), fovs().fold(0.0, f64::max));
        Pose {
            eye: DVec3::new(v(0), v(1), v(2)),
            yaw: v(3),
            pitch: v(4).clamp(-90.0, 90.0),
            roll: v(5),
            fov: v(6).clamp(narrow, wide),
        }
    }

    /// `frames` poses evenly over the whole path, its ends included.
    pub fn poses(&self, frames: usize) -> Vec<Pose> {
        let start = self.keyframes[0].t;
        let step = self.duration() / frames.saturating_sub(1).max(1) as f64;
        (0..frames).map(|i| self.at(start + step * i as f64)).collect()
    }
}

/// Angles in degrees, each a whole number of turns away from what it was, at most half a turn from its predecessor.
fn unwrap(angles: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut unwrapped: Vec<f64> = Vec::new();
    for angle in angles {
        unwrapped.push(unwrapped.last().map_or(angle, |last| angle - ((angle - last) / 360.0).round() * 360.0));
    }
    unwrapped
}

fn kind(value: &Value) -> &'static str {
    match value {
        Value::Null => "null",
        Value::Bool(_) => "true or false",
        Value::Number(_) => "a number",
        Value::String(_) => "text",
        Value::Array(_) => "a list",
        Value::Object(_) => "an object",
    }
}

fn number(value: &Value) -> Result<f64, String> {
    value.as_f64().ok_or_else(|| format!("expected a number, found {}", kind(value)))
}

/// The keyframe in `value`; errors continue the words "keyframe N".
fn keyframe(value: &Value, default_fov: f64) -> Result<Keyframe, String> {
    const FIELDS: [&str; 6] = ["t", "eye", "yaw", "pitch", "roll", "fov"];
    let object: &Map<String, Value> =
        value.as_object().ok_or_else(|| format!(": expected an object, found {}", kind(value)))?;
    if let Some(unknown) = object.keys().find(|k| !FIELDS.contains(&k.as_str())) {
        return Err(format!(", {unknown}: is not a field of a keyframe (t, eye, yaw, pitch, roll, fov)"));
    }
    let field = |name: &str, default: Option<f64>| match (object.get(name), default) {
        (Some(v), _) => number(v).map_err(|e| format!(", {name}: {e}")),
        (None, Some(default)) => Ok(default),
        (None, None) => Err(format!(", {name}: is missing")),
    };
    let eye = match object.get("eye") {
        None => return Err(", eye: is missing".into()),
        Some(Value::Array(v)) if v.len() == 3 => {
            let part = |i: usize| number(&v[i]).map_err(|e| format!(", eye: {e}"));
            DVec3::new(part(0)?, part(1)?, part(2)?)
        }
        Some(Value::Array(v)) => return Err(format!(", eye: expected three numbers, found {}", v.len())),
        Some(v) => return Err(format!(", eye: expected a list of three numbers, found {}", kind(v))),
    };
    Ok(Keyframe {
        t: field("t", None)?,
        pose: Pose {
            eye,
            yaw: field("yaw", None)?,
            pitch: field("pitch", None)?,
            roll: field("roll", Some(0.0))?,
            fov: field("fov", Some(default_fov))?,
        },
    })
}

/// The natural cubic spline through values at increasing times.
#[derive(Clone, Debug)]
struct Spline {
    times: Vec<f64>,
    values: Vec<f64>,
    /// Second derivatives at the times.
    bends: Vec<f64>,
}

impl Spline {
    fn new(times: &[f64], values: Vec<f64>) -> Spline {
        let n = times.len();
        let mut bends = vec![0.0; n];
        if n > 2 {
            // The tridiagonal system of continuous first derivatives, eliminated downwards, then solved upwards.
            let width = |i: usize| times[i + 1] - times[i];
            let slope = |i: usize| (values[i + 1] - values[i]) / width(i);
            let mut above = vec![0.0; n];
            for i in 1..n - 1 {
                let pivot = 2.0 * (width(i - 1) + width(i)) - width(i - 1) * above[i - 1];
                above[i] = width(i) / pivot;
                bends[i] = (6.0 * (slope(i) - slope(i - 1)) - width(i - 1) * bends[i - 1]) / pivot;
            }
            for i in (1..n - 1).rev() {
                bends[i] -= above[i] * bends[i + 1];
            }
        }
        Spline { times: times.to_vec(), values, bends }
    }

    fn at(&self, t: f64) -> f64 {
        let last = self.times.len() - 1;
        if t <= self.times[0] {
            return self.values[0];
        }
        if t >= self.times[last] {
            return self.values[last];
        }
        let i = self.times.partition_point(|&v| v <= t) - 1;
        let width = self.times[i + 1] - self.times[i];
        let b = (t - self.times[i]) / width;
        let a = 1.0 - b;
        let bend = (a * a * a - a) * self.bends[i] + (b * b * b - b) * self.bends[i + 1];
        a * self.values[i] + b * self.values[i + 1] + bend * width * width / 6.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(t: f64, x: f64, yaw: f64, pitch: f64) -> Keyframe {
        Keyframe { t, pose: Pose { eye: DVec3::new(x, 0.0, 0.0), yaw, pitch, roll: 0.0, fov: 60.0 } }
    }

    #[test]
    fn path_goes_through_its_keyframes() {
        let keys = vec![key(1.0, 5.0, 10.0, -5.0), key(2.0, -3.0, 40.0, 20.0), key(4.5, 8.0, 90.0, 90.0)];
        let path = Path::new(keys.clone()).unwrap();
        for k in &keys {
            let p = path.at(k.t);
            assert!((p.eye - k.pose.eye).length() < 1e-12 && (p.yaw - k.pose.yaw).abs() < 1e-12, "{p:?}");
        }
        assert_eq!((path.at(-9.0), path.at(99.0)), (keys[0].pose, keys[2].pose));
        assert_eq!(Path::new(keys[..1].to_vec()).unwrap().poses(3), vec![keys[0].pose; 3]);
    }

    #[test]
    fn path_is_smooth_to_the_second_derivative() {
        let x = [0.0, 4.0, -2.0, 3.0, 3.0];
        let path =
            Path::new(x.iter().zip([0.0, 1.0, 1.5, 4.0, 5.0]).map(|(&x, t)| key(t, x, 0.0, 0.0)).collect()).unwrap();
        let (e, f) = (1e-4, |t: f64| path.at(t).eye.x);
        let bend = |t: f64| (f(t - e) - 2.0 * f(t) + f(t + e)) / (e * e);
        for t in [1.0, 1.5, 4.0] {
            assert!(((f(t) - f(t - e)) - (f(t + e) - f(t))).abs() < 1e-5, "speed at {t}");
            assert!((bend(t - 2.0 * e) - bend(t + 2.0 * e)).abs() < 0.1, "acceleration at {t}");
        }
        assert!(bend(2.0 * e).abs() < 0.1, "natural at the ends");
    }

    #[test]
    fn path_turns_the_shorter_way() {
        let path =
            Path::new(vec![key(0.0, 0.0, 350.0, 0.0), key(1.0, 0.0, 10.0, 0.0), key(2.0, 0.0, -320.0, 0.0)]).unwrap();
        let mut last = 350.0;
        for i in 0..=20 {
            let yaw = path.at(f64::from(i) / 10.0).yaw;
            assert!(yaw >= last - 1e-9 && yaw - last < 5.0, "{last} {yaw}");
            last = yaw;
        }
        assert!((last - 400.0).abs() < 1e-9);
    }

    #[test]
    fn path_keeps_pitch_within_straight_up_and_down() {
        let path = Path::new(vec![
            key(0.0, 0.0, 0.0, 0.0),
            key(1.0, 0.0, 0.0, 90.0),
            key(1.5, 0.0, 0.0, 90.0),
            key(2.0, 0.0, 0.0, 0.0),
        ])
        .unwrap();
        assert!((0..=200).all(|i| path.at(f64::from(i) / 100.0).pitch.abs() <= 90.0));
        assert_eq!(path.at(1.25).pitch, 90.0, "the spline alone swings past");
    }

    #[test]
    fn path_survives_a_round_trip_through_json() {
        let mut keys = vec![key(0.1, 1.0 / 3.0, 359.5, -12.0), key(0.3, -7e-3, 2.0, 33.0)];
        keys[1].pose.roll = -3.25;
        keys[1].pose.fov = 35.0;
        let path = Path::new(keys.clone()).unwrap();
        assert_eq!(Path::parse(&path.to_json(), 90.0).unwrap().keyframes(), keys);
        let short = r#"[{"t":0,"eye":[1,2,3],"yaw":4,"pitch":5}]"#;
        assert_eq!(Path::parse(short, 77.0).unwrap().keyframes()[0].pose.fov, 77.0);
    }

    #[test]
    fn path_errors_name_the_keyframe_and_the_field() {
        for (text, error) in [
            ("[", "is not JSON: EOF while parsing a list at line 1 column 1"),
            ("{}", "expected a list of keyframes, found an object"),
            ("[]", "has no keyframe; at least one is needed"),
            ("[3]", "keyframe 1: expected an object, found a number"),
            (r#"[{"t":0,"yaw":0,"pitch":0}]"#, "keyframe 1, eye: is missing"),
            (r#"[{"t":0,"eye":[1,2],"yaw":0,"pitch":0}]"#, "keyframe 1, eye: expected three numbers, found 2"),
            (r#"[{"t":0,"eye":[1,"2",3],"yaw":0,"pitch":0}]"#, "keyframe 1, eye: expected a number, found text"),
            (r#"[{"t":0,"eye":[1,2,3],"yaw":0}]"#, "keyframe 1, pitch: is missing"),
            (r#"[{"t":0,"eye":[1,2,3],"yaw":0,"pitch":91}]"#, "keyframe 1, pitch: 91 is not in -90 to 90"),
            (
                r#"[{"t":0,"eye":[1,2,3],"yaw":0,"pitch":0,"fov":180}]"#,
                "keyframe 1, fov: 180 is not above 0 and below 180",
            ),
            (
                r#"[{"t":0,"eye":[1,2,3],"yaw":0,"pitch":0,"tilt":1}]"#,
                "keyframe 1, tilt: is not a field of a keyframe (t, eye, yaw, pitch, roll, fov)",
            ),
            (
                r#"[{"t":0,"eye":[1,2,3],"yaw":0,"pitch":0},{"t":0,"eye":[1,2,3],"yaw":0,"pitch":0}]"#,
                "keyframe 2, t: 0 is not after 0, the time of keyframe 1",
            ),
        ] {
            assert_eq!(Path::parse(text, 60.0).unwrap_err(), error, "{text}");
        }
    }
}
