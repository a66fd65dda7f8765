//! Poses for many pictures at once: what `render --cameras` reads.
//!
//! JSON: a list of `{"eye": [x, y, z], "yaw", "pitch", "roll", "fov", "size": [width, height]}`. What is left out but the eye is
//! 0, and for field of view and size what the flags say.

use std::path::Path as FilePath;

use planecast_encoder::{Error, Result};
use serde_json::{Map, Value};

use crate::Camera;

/// Poses at most: file names have six digits.
const MOST: usize = 1_000_000;

/// Longest file that is read: 100 bytes a pose, and more.
const LONGEST: u64 = 1 << 28;

/// Reads a file of poses; `usual` has the field of view and the size of those that say none.
pub fn read(file: &FilePath, usual: &Camera) -> Result<Vec<Camera>> {
    let length = std::fs::metadata(file).map_err(|e| Error::io(file, "read", e))?.len();
    if length > LONGEST {
        return Err(Error::format(file, format!("{length} bytes: files of poses have at most {LONGEST}")));
    }
    let text = std::fs::read_to_string(file).map_err(|e| Error::io(file, "read", e))?;
    parse(&text, usual).map_err(|what| Error::format(file, what))
}

/// Poses from the text of such a file. What is wrong is told as `pose N, field: …`, N from 0 as files are numbered.
pub fn parse(text: &str, usual: &Camera) -> Result<Vec<Camera>, String> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let value: Value = serde_json::from_str(text).map_err(|e| format!("is not JSON: {e}"))?;
    let Value::Array(list) = value else { return Err("expected a list of poses, as in [{\"eye\": [1, 2, 3]}]".into()) };
    if list.is_empty() || list.len() > MOST {
        return Err(format!("has {} poses: must be 1 to {MOST}", list.len()));
    }
    list.iter().enumerate().map(|(i, v)| pose(v, usual).map_err(|e| format!("pose {i}{e}"))).collect()
}

fn pose(value: &Value, usual: &Camera) -> Result<Camera, String> {
    let Value::Object(fields) = value else { return Err(": expected an object with \"eye\"".into()) };
    const FIELDS: [&str; 6] = ["eye", "yaw", "pitch", "roll", "fov", "size"];
    if let Some(other) = fields.keys().find(|key| !FIELDS.contains(&key.as_str())) {
        return Err(format!(", {other:?}: is not known; there are {}", FIELDS.join(", ")));
    }
    let number = |field: &str, usual: f64| match fields.get(field) {
        None => Ok(usual),
        Some(v) => {
            v.as_f64().filter(|v| v.is_finite()).ok_or_else(|| format!(", {field}: expected a number, found {v}"))
        }
    };
    let eye = numbers::<3>(fields, "eye", "three numbers")?.ok_or(", eye: is missing; expected [x, y, z] in voxels")?;
    let size = numbers::<2>(fields, "size", "[width, height] in pixels")?;
    let whole = |v: f64| (1.0..=16_384.0).contains(&v) && v.fract() == 0.0;
    if let Some(size) = size.filter(|size| !size.iter().all(|&v| whole(v))) {
        return Err(format!(", size: {size:?} must be two whole numbers from 1 to 16384"));
    }
    let pitch = number("pitch", 0.0)?;
    if !(-90.0..=90.0).contains(&pitch) {
        return Err(format!(", pitch: {pitch} is not in -90 to 90"));
    }
    let [width, height] = size.map_or([usual.width, usual.height], |size| size.map(|v| v as u32));
    Ok(Camera {
        eye: eye.into(),
        yaw: number("yaw", 0.0)?,
        pitch,
        roll: number("roll", 0.0)?,
        fov: number("fov", usual.fov)?,
        width,
        height,
    })
}

fn numbers<const N: usize>(fields: &Map<String, Value>, field: &str, what: &str) -> Result<Option<[f64; N]>, String> {
    let Some(value) = fields.get(field) else { return Ok(None) };
    let list = value.as_array().map(|list| list.iter().filter_map(Value::as_f64).collect::<Vec<_>>());
    let list = list
        .and_then(|list| <[f64; N]>::try_from(list).ok())
        .filter(|_| value.as_array().is_some_and(|l| l.len() == N));
    list.filter(|list| list.iter().all(|v| v.is_finite()))
        .map(Some)
        .ok_or_else(|| format!(", {field}: expected {what}, found {value}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poses_take_what_they_leave_out_from_the_flags() {
        let usual = Camera { fov: 40.0, width: 8, height: 6, ..Camera::default() };
        let text = r#"[{"eye": [1, 2.5, -3]}, {"eye": [0, 0, 0], "yaw": 10, "pitch": -90, "roll": 3, "fov": 50, "size": [20, 10]}]"#;
        let poses = parse(text, &usual).unwrap();
        assert_eq!(poses[0], Camera { eye: [1.0, 2.5, -3.0].into(), ..usual });
        let eye = [0.0; 3].into();
        assert_eq!(poses[1], Camera { eye, yaw: 10.0, pitch: -90.0, roll: 3.0, fov: 50.0, width: 20, height: 10 });
    }

    #[test]
    fn poses_that_are_wrong_are_named() {
        for (text, what) in [
            ("{}", "expected a list"),
            ("[]", "0 poses"),
            ("[1]", "pose 0: expected an object"),
            (r#"[{"eye": [0, 0, 0]}, {"yaw": 1}]"#, "pose 1, eye: is missing"),
            (r#"[{"eye": [0, 0]}]"#, "pose 0, eye: expected three"),
            (r#"[{"eye": [0, 0, 0], "Yaw": 1}]"#, "\"Yaw\": is not known"),
            (r#"[{"eye": [0, 0, 0], "pitch": 91}]"#, "pitch: 91"),
            (r#"[{"eye": [0, 0, 0], "size": [0, 5]}]"#, "size: [0.0, 5.0]"),
            (r#"[{"eye": [0, 0, 0], "fov": "wide"}]"#, "fov: expected a number"),
        ] {
            let e = parse(text, &Camera::default()).unwrap_err();
            assert!(e.contains(what), "{e}");
        }
    }
}
