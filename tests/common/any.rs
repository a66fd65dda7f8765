//! Any world and any camera, for properties that hold for all of them; and how near two frames must be.

use super::compare::{compare, identical};
use super::{World, hash};
use glam::DVec3;
use planecast::{Camera, Frame, Repeat};
use proptest::prelude::*;
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};

/// Runs a property on `cases` inputs, the same ones every time.
pub fn check<S: Strategy>(cases: u32, inputs: S, property: impl Fn(S::Value) -> Result<(), TestCaseError>) {
    let config = Config { cases, failure_persistence: None, ..Config::default() };
    let mut runner = TestRunner::new_with_rng(config, TestRng::from_seed(RngAlgorithm::ChaCha, &[7; 32]));
    runner.run(&inputs, property).unwrap_or_else(|fault| panic!("{fault}"));
}

pub const BOTH: Repeat = Repeat { x: true, z: true };

/// A world of clumps with about `percent` of its voxels solid, before anything is done to it.
#[derive(Clone, Copy, Debug)]
pub struct Clumps {
    pub dims: [u32; 3],
    pub seed: u32,
    pub percent: u32,
}

impl Clumps {
    pub fn solid(&self, x: u32, y: u32, z: u32) -> bool {
        let at = [x / 2, y / 3, z / 2].map(|v| v as i32);
        hash(self.seed, at) % 100 < self.percent || y == 0
    }

    /// With the coordinates of the voxel asked for put through `map`.
    pub fn world(&self, dims: [u32; 3], map: impl Fn(u32, u32, u32) -> Option<[u32; 3]> + Sync) -> World {
        World::new("clumps", dims, |x, y, z| map(x, y, z).is_some_and(|[x, y, z]| self.solid(x, y, z)))
    }
}

pub fn clumps() -> impl Strategy<Value = Clumps> {
    (4..40u32, 4..30u32, 4..40u32, any::<u32>(), 1..40u32).prop_map(|(nx, ny, nz, seed, percent)| Clumps {
        dims: [nx, ny, nz],
        seed,
        percent,
    })
}

/// A camera in a world of size 1 × 1 × 1: to be scaled. Fractions of the eye are multiples of 1/64, so that moving it by whole
/// voxels loses nothing.
pub fn any_camera() -> impl Strategy<Value = (DVec3, [f64; 3], f64)> {
    let pitch = prop_oneof![4 => -90.0..90.0, 1 => Just(0.0), 1 => Just(-90.0), 1 => Just(90.0)];
    let roll = prop_oneof![2 => Just(0.0), 2 => -180.0..180.0];
    let eye = (-0.2..1.2, -0.2..1.4, -0.2..1.2);
    (eye, 0.0..360.0, pitch, roll, 20.0..100.0)
        .prop_map(|((x, y, z), yaw, pitch, roll, fov)| (DVec3::new(x, y, z), [yaw, pitch, roll], fov))
}

pub fn scaled((eye, [yaw, pitch, roll], fov): (DVec3, [f64; 3], f64), dims: [u32; 3]) -> Camera {
    let eye = (eye * DVec3::from(dims.map(f64::from)) * 64.0).floor() / 64.0 + DVec3::splat(1.0 / 256.0);
    Camera { eye, yaw, pitch, roll, fov, width: 60, height: 44 }
}

/// Frames agree in all but `permille` of the pixels; rounding may decide ties differently.
pub fn agree(a: &Frame, b: &Frame, permille: usize) -> Result<(), TestCaseError> {
    let agreement = compare(a, b);
    let different = agreement.pixels - agreement.same;
    prop_assert!(1000 * different <= permille * agreement.pixels, "{} pixels differ: {}", different, agreement);
    prop_assert!(agreement.depth < 1e-4, "depth {} at {:?}", agreement.depth, agreement.depth_at);
    Ok(())
}

pub fn same(a: &Frame, b: &Frame) -> Result<(), TestCaseError> {
    identical(a, b).map_err(TestCaseError::fail)
}

pub fn without_color(mut frame: Frame) -> Frame {
    frame.color.fill([0, 0, 0, 255]);
    frame
}
