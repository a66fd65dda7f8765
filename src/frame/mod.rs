//! One frame, decided in f64: the camera, what is asked for, the planes, and the picture that comes back. Not here: who draws it.

#[cfg(not(target_arch = "wasm32"))]
pub mod aim;
pub mod camera;
#[cfg(not(target_arch = "wasm32"))]
pub mod cameras;
pub mod options;
pub mod picture;
pub mod plan;
pub mod plane_setup;
pub mod preset;
pub mod projection;
pub mod specialize;
