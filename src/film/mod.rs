//! Flights: paths of the camera, the tour of a scene, frame after frame into a film. Not here: how one frame is drawn.

#[cfg(not(target_arch = "wasm32"))]
pub mod fly;
pub mod path;
pub mod timeline;
pub mod tour;
#[cfg(not(target_arch = "wasm32"))]
pub mod video;
