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

/// Files that are remembered as opened.
const RECENT: usize = 10;

/// Where the list of files lies that were opened: beside the views.
pub fn recent_file() -> Option<PathBuf> {
    Some(file()?.with_file_name("recent.json"))
}

/// Files that were opened, the latest first.
pub fn recent(file: &Path) -> Vec<PathBuf> {
    let text = std::fs::read_to_string(file).unwrap_or_default();
    serde_json::from_str(&text).unwrap_or_default()
}

/// Remembers that a file was opened; the list as it is then.
pub fn opened(file: &Path, path: &Path) -> Result<Vec<PathBuf>> {
    let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let mut list = recent(file);
    list.retain(|p| *p != path);
    list.insert(0, path);
    list.truncate(RECENT);
    if let Some(folder) = file.parent() {
        std::fs::create_dir_all(folder).map_err(|e| planecast_encoder::Error::io(folder, "create the folder", e))?;
    }
    let text = serde_json::to_string_pretty(&list).expect("plain values have a JSON form") + "\n";
    output::write(file, |out| out.write_all(text.as_bytes()))?.finish()?;
    Ok(list)
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
    fn recent_files_are_kept_once_each_the_latest_first() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("a/recent.json");
        assert!(recent(&file).is_empty());
        for i in 0..RECENT + 3 {
            opened(&file, Path::new(&format!("/data/{i}.tif"))).unwrap();
        }
        let list = opened(&file, Path::new("/data/7.tif")).unwrap();
        assert_eq!(
            (list.len(), list[0].as_path(), list[1].as_path()),
            (RECENT, Path::new("/data/7.tif"), Path::new("/data/12.tif"))
        );
        assert!(list == recent(&file) && list.iter().filter(|p| p.ends_with("7.tif")).count() == 1);
        std::fs::write(&file, "{").unwrap();
        assert!(recent(&file).is_empty());
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
