//! What is measured of the renderer, and how it is shown: benches, the report of error against time, the same of worlds in tiles,
//! stability. Not here: the stages themselves.

#[cfg(feature = "report")]
pub mod bench;
pub mod compare;
#[cfg(feature = "gpu")]
pub mod flythrough;
#[cfg(feature = "report")]
mod json_lines;
#[cfg(feature = "report")]
pub mod machine;
#[cfg(feature = "report")]
pub mod page;
#[cfg(feature = "report")]
pub mod plot;
#[cfg(feature = "report")]
pub mod report;
#[cfg(not(target_arch = "wasm32"))]
pub mod stability;
#[cfg(feature = "report")]
pub mod stream;
#[cfg(not(target_arch = "wasm32"))]
pub mod viewshed;
