//! Voxel terrains and volumes as run-length-encoded columns, drawn by forward projection in vertical planes.

pub mod camera;
pub mod cli;
pub mod cpu;
pub mod demo;
pub mod error;
pub mod exact;
pub mod fly;
pub mod frame;
#[cfg(feature = "gpu")]
pub mod gpu;
pub mod options;
pub mod output;
pub mod path;
pub mod pick;
pub mod plane_setup;
pub mod renderer;
pub mod resident;
pub mod tour;
pub mod video;

pub use camera::Camera;
pub use error::{Error, Result};
pub use frame::{Frame, StageTimes, Stats};
#[cfg(feature = "gpu")]
pub use gpu::{GpuOptions, GpuRenderer, Kernel};
pub use options::{Culling, Options, Planes, Remap, Repeat, Shading};
pub use renderer::{CpuRenderer, Outputs};
pub use resident::Resident;
