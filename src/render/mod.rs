//! The one door to drawing: which device draws, and what falls back to what. Not here: any stage.

#[cfg(not(target_arch = "wasm32"))]
pub mod annotate;
#[cfg(not(target_arch = "wasm32"))]
pub mod device;
#[cfg(feature = "gpu")]
pub mod drawer;
mod paged;
#[cfg(not(target_arch = "wasm32"))]
pub mod scan;

#[cfg(not(target_arch = "wasm32"))]
pub use device::{Device, Renderer};
