//! Voxel terrains and volumes as run-length-encoded columns, drawn by forward projection in vertical planes.

pub mod camera;
pub mod cpu;
pub mod error;
pub mod exact;
pub mod frame;
#[cfg(feature = "gpu")]
pub mod gpu;
pub mod options;
pub mod plane_setup;
pub mod renderer;
pub mod resident;

pub use camera::Camera;
pub use error::{Error, Result};
pub use frame::{Frame, StageTimes, Stats};
#[cfg(feature = "gpu")]
pub use gpu::{GpuOptions, GpuRenderer, Kernel};
pub use options::{Culling, Options, Planes, Remap, Repeat, Shading};
pub use renderer::{CpuRenderer, Outputs};
pub use resident::Resident;
