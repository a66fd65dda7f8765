//! The poses that a report looks from: every kind of view that is drawn in its own way.

use crate::film::path::{Path, Pose};
use glam::DVec3;
use planecast_encoder::{Columns, Scene};

/// A pose and its name in tables.
#[derive(Clone, Debug, PartialEq)]
pub struct Named {
    pub name: String,
    pub pose: Pose,
}

/// Poses along a path, evenly spread over its time.
pub fn along(path: &Path, n: usize) -> Vec<Named> {
    let poses = path.poses(n).into_iter().enumerate();
    poses.map(|(i, pose)| Named { name: format!("path {}", i + 1), pose }).collect()
}

/// Standing poses over a scene: level, tilted down and up, straight down and up, rolled, grazing, near a wall, far. With
/// `few`, the four that differ most. None has its eye in a solid voxel.
pub fn standing(scene: &Scene, fov: f64, height: u32, few: bool) -> Vec<Named> {
    let columns = &scene.levels[0].solid;
    let [nx, ny, nz] = scene.dims().map(f64::from);
    let above = 3.3 + 0.03 * ny;
    let middle = over(columns, [nx * 0.45, nz * 0.55], above);
    let low = over(columns, [nx * 0.7, nz * 0.3], 1.2);
    let high = middle + DVec3::Y * 0.5 * nx.min(nz);
    let [wall, yaw] = near_wall(columns);
    // A voxel is about a pixel wide from here.
    let focal = f64::from(height) / 2.0 / (fov.to_radians() / 2.0).tan();
    let far = DVec3::new(nx / 2.0 + 0.3, 0.35 * focal + ny, nz / 2.0 + focal);
    let poses = [
        ("level", true, middle, [31.0, 0.0, 0.0]),
        ("tilted down", true, middle, [134.0, -20.0, 0.0]),
        ("tilted up", false, middle, [134.0, 35.0, 0.0]),
        ("straight down", true, high, [10.0, -90.0, 0.0]),
        ("straight up", false, low, [10.0, 90.0, 0.0]),
        ("rolled", true, middle, [250.0, -10.0, 30.0]),
        ("grazing", false, low, [313.0, -4.0, 0.0]),
        ("near a wall", false, wall, [yaw.x, 6.0, 0.0]),
        ("far", false, far, [0.0, -19.0, 0.0]),
    ];
    let kept = poses.into_iter().filter(|&(_, first, ..)| first || !few);
    kept.map(|(name, _, eye, [yaw, pitch, roll])| Named {
        name: name.into(),
        pose: Pose { eye, yaw, pitch, roll, fov },
    })
    .collect()
}

/// A place over the highest solid voxel of a column.
fn over(columns: &Columns, [x, z]: [f64; 2], above: f64) -> DVec3 {
    let top = columns.column(x as u32, z as u32).last().map_or(0, |r| r.end());
    DVec3::new(x.floor() + 0.37, f64::from(top) + above, z.floor() + 0.61)
}

/// An eye before the greatest step between two neighbouring columns, and the yaw (as x) past it at a slant: the wall fills
/// most of the picture.
fn near_wall(columns: &Columns) -> [DVec3; 2] {
    let [nx, _, nz] = columns.dims();
    let top = |x: u32, z: u32| columns.column(x, z).last().map_or(0, |r| r.end());
    let mut best = (0, 0, 0, 0);
    for z in 0..nz {
        for x in 1..nx {
            let step = top(x, z).saturating_sub(top(x - 1, z));
            if step > best.0 {
                best = (step, x, z, top(x - 1, z));
            }
        }
    }
    let (step, x, z, foot) = best;
    let eye = DVec3::new(f64::from(x) - 0.63, f64::from(foot) + 0.5 * f64::from(step) + 0.21, f64::from(z) + 0.43);
    [eye, DVec3::X * 65.0]
}

#[cfg(test)]
mod tests {
    use super::*;
    use planecast_encoder::{BuildOptions, Colors, Input, build};

    #[test]
    fn poses_stand_in_the_air() {
        for (dims, solid) in [
            ([40u32, 24u32, 32u32], (|x, y, z| y < 4 + (x * 3 + z) % 11) as fn(u32, u32, u32) -> bool),
            ([9, 5, 7], |_, _, _| true),
            ([9, 5, 7], |_, _, _| false),
            ([1, 1, 1], |_, _, _| true),
        ] {
            let columns = Columns::from_fn(dims[0], dims[1], dims[2], solid);
            let input = Input { columns, colors: Colors::None, notes: Vec::new() };
            let scene = build(input, &BuildOptions::default()).unwrap();
            let poses = standing(&scene, 60.0, 100, false);
            assert_eq!((poses.len(), standing(&scene, 60.0, 100, true).len()), (9, 4));
            for Named { name, pose } in poses {
                let eye = pose.eye.floor().to_array().map(|v| v as i64);
                assert!(!scene.levels[0].solid.solid(eye[0], eye[1], eye[2]), "{name} at {}", pose.eye);
            }
        }
    }
}
