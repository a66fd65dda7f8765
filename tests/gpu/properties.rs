//! What must hold for any world and camera, with each kernel: culling, shifts, turns and mirrors. (The CPU's twin:
//! `tests/properties.rs`.)

use super::common::any::{BOTH, Clumps, agree, any_camera, check, clumps, same, scaled, without_color};
use super::common::compare::{mirrored, with_voxels};
use super::common::{self, cullings, plain};
use super::{VOXEL, gpu_options, gpu_wanted, open};
use glam::DVec3;
use planecast::{Camera, Culling, Frame, GpuRenderer, Kernel, Options};
use proptest::prelude::*;

/// Worlds per property: each takes a renderer per kernel.
const WORLDS: u32 = 8;

/// Cameras per world.
fn cameras() -> impl Strategy<Value = Vec<(DVec3, [f64; 3], f64)>> {
    proptest::collection::vec(any_camera(), 5)
}

fn renderer(world: &common::World, kernel: Kernel) -> GpuRenderer {
    open(&world.scene, &world.resident, gpu_options(kernel))
}

/// Draws `a` and `b` with each kernel, each camera with what belongs to it, and compares.
fn pairs(
    [a, b]: [&common::World; 2],
    cameras: &[(Camera, Camera)],
    options: &Options,
    compare: impl Fn(Frame, Frame) -> Result<(), TestCaseError>,
) -> Result<(), TestCaseError> {
    for kernel in Kernel::ALL {
        let (mut draw_a, mut draw_b) = (renderer(a, kernel), renderer(b, kernel));
        for (of_a, of_b) in cameras {
            let frames = (draw_a.render(of_a, options, VOXEL).unwrap(), draw_b.render(of_b, options, VOXEL).unwrap());
            compare(frames.0, frames.1).map_err(|e| TestCaseError::fail(format!("{}: {e}", kernel.name())))?;
        }
    }
    Ok(())
}

fn whole(c: &Clumps) -> common::World {
    c.world(c.dims, |x, y, z| Some([x, y, z]))
}

#[test]
fn culling_never_changes_a_picture_of_any_world_on_the_gpu() {
    if !gpu_wanted() {
        return;
    }
    let switches: Vec<Culling> = cullings().collect();
    // Each combination of switches is shaders of its own: six per world.
    let some = proptest::sample::subsequence(switches, 6);
    check(WORLDS, (clumps(), cameras(), some, any::<bool>(), any::<bool>()), |(c, cameras, switches, lod, repeat)| {
        let world = whole(&c);
        let repeat = if repeat { BOTH } else { plain().repeat };
        let options = Options { lod: lod.then_some(1.0), repeat, view_distance: 400.0, ..plain() };
        for kernel in Kernel::ALL {
            let mut renderer = renderer(&world, kernel);
            for camera in &cameras {
                let camera = scaled(*camera, c.dims);
                let mut draw = |culling| renderer.render(&camera, &Options { culling, ..options }, VOXEL).unwrap();
                let none = draw(Culling::NONE);
                for culling in &switches {
                    same(&draw(*culling), &none)
                        .map_err(|e| TestCaseError::fail(format!("{} {culling:?}: {e}", kernel.name())))?;
                }
            }
        }
        Ok(())
    });
}

#[test]
fn moving_eye_and_world_by_whole_voxels_changes_no_bit_on_the_gpu() {
    if !gpu_wanted() {
        return;
    }
    check(WORLDS, (clumps(), cameras(), 0..30u32, 0..30u32, 0..30u32), |(c, cameras, dx, dy, dz)| {
        let [nx, ny, nz] = c.dims;
        let moved = c.world([nx + dx + 5, ny + dy + 3, nz + dz + 4], |x, y, z| {
            let [x, y, z] = [x.checked_sub(dx)?, y.checked_sub(dy)?, z.checked_sub(dz)?];
            (x < nx && y < ny && z < nz).then_some([x, y, z])
        });
        let by = DVec3::new(f64::from(dx), f64::from(dy), f64::from(dz));
        let cameras: Vec<_> = (cameras.iter())
            .map(|&camera| scaled(camera, c.dims))
            .map(|camera| (camera, Camera { eye: camera.eye + by, ..camera }))
            .collect();
        pairs([&whole(&c), &moved], &cameras, &plain(), |a, b| {
            let a = with_voxels(&without_color(a), |[x, y, z, l]| [x + dx as i32, y + dy as i32, z + dz as i32, l]);
            same(&a, &without_color(b))
        })
    });
}

#[test]
fn moving_eye_and_repeated_world_by_whole_periods_changes_no_bit_on_the_gpu() {
    if !gpu_wanted() {
        return;
    }
    check(WORLDS, (clumps(), cameras(), -100_000i32..100_000, -1000i32..1000), |(c, cameras, px, pz)| {
        let world = whole(&c);
        let [dx, dz] = [px * c.dims[0] as i32, pz * c.dims[2] as i32];
        let by = DVec3::new(f64::from(dx), 0.0, f64::from(dz));
        let cameras: Vec<_> = (cameras.iter())
            .map(|&camera| scaled(camera, c.dims))
            .map(|camera| (camera, Camera { eye: camera.eye + by, ..camera }))
            .collect();
        let options = Options { repeat: BOTH, view_distance: 120.0, lod: Some(1.0), ..plain() };
        pairs([&world, &world], &cameras, &options, |a, b| {
            same(&with_voxels(&a, |[x, y, z, l]| [x + dx, y, z + dz, l]), &b)
        })
    });
}

#[test]
fn turning_the_world_by_90_degrees_turns_the_picture_on_the_gpu() {
    if !gpu_wanted() {
        return;
    }
    check(WORLDS, (clumps(), cameras()), |(c, cameras)| {
        let [nx, ny, nz] = c.dims;
        // −z becomes +x: (x, z) to (nz − z, x).
        let turned = c.world([nz, ny, nx], |x, y, z| Some([z, y, nz - 1 - x]));
        let turn = |camera: Camera| {
            let eye = DVec3::new(f64::from(nz) - camera.eye.z, camera.eye.y, camera.eye.x);
            (camera, Camera { eye, yaw: camera.yaw + 90.0, ..camera })
        };
        let cameras: Vec<_> = cameras.iter().map(|&camera| turn(scaled(camera, c.dims))).collect();
        pairs([&whole(&c), &turned], &cameras, &plain(), |a, b| {
            agree(&with_voxels(&a, |[x, y, z, l]| [nz as i32 - 1 - z, y, x, l]), &b, 3)
        })
    });
}

#[test]
fn mirroring_the_world_mirrors_the_picture_on_the_gpu() {
    if !gpu_wanted() {
        return;
    }
    check(WORLDS, (clumps(), cameras()), |(c, cameras)| {
        let nx = c.dims[0];
        let other = c.world(c.dims, |x, y, z| Some([nx - 1 - x, y, z]));
        let mirror = |camera: Camera| {
            let eye = DVec3::new(f64::from(nx) - camera.eye.x, camera.eye.y, camera.eye.z);
            (camera, Camera { eye, yaw: -camera.yaw, roll: -camera.roll, ..camera })
        };
        let cameras: Vec<_> = cameras.iter().map(|&camera| mirror(scaled(camera, c.dims))).collect();
        pairs([&whole(&c), &other], &cameras, &plain(), |a, b| {
            agree(&a, &mirrored(&with_voxels(&b, |[x, y, z, l]| [nx as i32 - 1 - x, y, z, l])), 3)
        })
    });
}
