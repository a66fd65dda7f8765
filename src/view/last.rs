//! The last view of each scene, kept from one time to the next.
//!
//! One small JSON file in the user's folder for such things: an object from a scene's content hash to the pose, in the
//! fields of a path's keyframe and with the time that it was left, seconds of Unix time.

use std::path::{Path, PathBuf};

use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

use crate::film::path::Pose;
use crate::{Result, output};
use std::io::Write;

/// Scenes that are remembered; the one left longest ago is forgotten first.
const SCENES: usize = 256;

#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Left {
    t: u64,
    eye: [f64; 3],
    yaw: f64,
    pitch: f64,
    roll: f64,
    fov: f64,
}

impl Left {
    fn pose(self) -> Option<Pose> {
        let Left { eye, yaw, pitch, roll, fov, .. } = self;
        let sound = eye.iter().chain([&yaw, &roll]).all(|v| v.is_finite())
            && (-90.0..=90.0).contains(&pitch)
            && fov > 0.0
            && fov < 180.0;
        sound.then_some(Pose { eye: DVec3::from(eye), yaw, pitch, roll, fov })
    }
}

/// Where the file lies: `$XDG_STATE_HOME` or `~/.local/state`, on macOS `~/Library/Application Support`, on Windows
/// `%LOCALAPPDATA%`; `None` where the environment names none.
pub fn file() -> Option<PathBuf> {
    let var = |name: &str| std::env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from);
    let folder = match std::env::consts::OS {
        "windows" => var("LOCALAPPDATA"),
        "macos" => var("XDG_STATE_HOME").or_else(|| Some(var("HOME")?.join("Library/Application Support"))),
        _ => var("XDG_STATE_HOME").or_else(|| Some(var("HOME")?.join(".local/state"))),
    };
    Some(folder?.join("planecast").join("views.json"))
}

/// All views; none where the file is not there or not of this form: it is no more than a convenience.
fn all(file: &Path) -> BTreeMap<String, Left> {
    let text = std::fs::read_to_string(file).unwrap_or_default();
    serde_json::from_str(&text).unwrap_or_default()
}

/// Where a scene was looked at last.
pub fn recall(file: &Path, scene: &str) -> Option<Pose> {
    all(file).remove(scene)?.pose()
}

/// Remembers where a scene was looked at; `now`: seconds of Unix time.
pub fn remember(file: &Path, scene: &str, pose: &Pose, now: u64) -> Result<()> {
    let mut views = all(file);
    let Pose { eye, yaw, pitch, roll, fov } = *pose;
    views.insert(scene.to_owned(), Left { t: now, eye: eye.to_array(), yaw, pitch, roll, fov });
    while views.len() > SCENES {
        let Some(oldest) = views.iter().min_by_key(|(_, v)| v.t).map(|(k, _)| k.clone()) else { break };
        views.remove(&oldest);
    }
    if let Some(folder) = file.parent() {
        std::fs::create_dir_all(folder).map_err(|e| planecast_encoder::Error::io(folder, "create the folder", e))?;
    }
    let text = serde_json::to_string_pretty(&views).expect("plain values have a JSON form") + "\n";
    output::write(file, |out| out.write_all(text.as_bytes()))?.finish()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn last_views_are_kept_by_scene_and_the_oldest_forgotten() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("a/b/views.json");
        assert_eq!(recall(&file, "x"), None);
        let pose = |v: f64| Pose { eye: DVec3::splat(v), yaw: v, pitch: -v, roll: 1.0, fov: 70.0 };
        remember(&file, "x", &pose(1.5), 10).unwrap();
        remember(&file, "y", &pose(2.5), 11).unwrap();
        remember(&file, "x", &pose(3.25), 12).unwrap();
        assert_eq!((recall(&file, "x"), recall(&file, "y")), (Some(pose(3.25)), Some(pose(2.5))));
        for i in 0..SCENES as u64 - 1 {
            remember(&file, &format!("{i}"), &pose(0.0), 20 + i).unwrap();
        }
        assert_eq!((recall(&file, "y"), recall(&file, "x")), (None, Some(pose(3.25))));
    }

    #[test]
    fn last_views_that_are_broken_are_as_none() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("views.json");
        for text in [
            "{",
            "[]",
            r#"{"x":{"t":1}}"#,
            r#"{"x":{"t":1,"eye":[1,2,3],"yaw":0,"pitch":91,"roll":0,"fov":60}}"#,
            r#"{"x":{"t":1,"eye":[1,2,3],"yaw":0,"pitch":9,"roll":0,"fov":180}}"#,
        ] {
            std::fs::write(&file, text).unwrap();
            assert_eq!(recall(&file, "x"), None, "{text}");
        }
        let pose = Pose { eye: DVec3::ONE, yaw: 0.0, pitch: 0.0, roll: 0.0, fov: 60.0 };
        remember(&file, "x", &pose, 1).unwrap();
        assert_eq!(recall(&file, "x"), Some(pose));
    }
}
