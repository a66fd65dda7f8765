//! Voxel terrains and volumes as run-length-encoded columns, drawn by forward projection in vertical planes.

pub mod camera;
pub mod frame;
pub mod options;
pub mod output;
pub mod path;
pub mod pick;
pub mod tour;

pub use camera::Camera;
pub use frame::{Frame, StageTimes, Stats};
pub use options::{Culling, Options, Planes, Repeat, Shading};
