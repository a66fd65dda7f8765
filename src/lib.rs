//! Voxel terrains and volumes as run-length-encoded columns, drawn by forward projection in vertical planes.
//!
//! ```
//! use planecast::{Camera, Device, Options, Renderer, World};
//!
//! # fn main() -> Result<(), planecast::Error> {
//! # let folder = std::env::temp_dir().join(format!("planecast-door-{}", std::process::id()));
//! # std::fs::create_dir_all(&folder).unwrap();
//! # let path = "procedural:rocks?size=64";
//! // A scene file, or anything that `planecast encode` reads.
//! let world = World::open(path)?;
//! let mut renderer = Renderer::new(world, Device::Auto)?;
//! let camera = Camera { eye: [32.0, 60.0, 90.0].into(), pitch: -20.0, width: 320, height: 200, ..Camera::default() };
//! let frame = renderer.draw(&camera, &Options::default())?;
//! # let path = folder.join("view.png");
//! frame.save_png(path)?;
//! # assert_eq!(frame.color.len(), 320 * 200);
//! # assert!(frame.depth.iter().any(|d| d.is_finite()), "the rocks are in view");
//! # std::fs::remove_dir_all(&folder).unwrap();
//! # Ok(())
//! # }
//! ```
//!
//! A world can come from memory, too ([`World::from_heights`], [`World::from_voxels`]); it is shared by `Arc`, and a renderer that
//! owns its share can move into a thread:
//!
//! ```
//! use planecast::{Camera, Device, Options, Renderer, World};
//!
//! # fn main() -> Result<(), planecast::Error> {
//! let heights: Vec<u16> = (0..64 * 64).map(|i| 8 + (i % 64 + i / 64) as u16 / 8).collect();
//! let world = World::from_heights([64, 64], &heights)?;
//! let mut renderer = Renderer::new(world, Device::Cpu)?;
//! let drawn = std::thread::spawn(move || {
//!     let camera = Camera { eye: [32.0, 40.0, 80.0].into(), pitch: -30.0, width: 64, height: 48, ..Camera::default() };
//!     renderer.draw(&camera, &Options::default())
//! });
//! let frame = drawn.join().expect("drawing does not panic")?;
//! assert!(frame.depth.iter().any(|d| d.is_finite()));
//! # Ok(())
//! # }
//! ```
//!
//! The method is that of Voxlap (Silverman) and of Forstmann & Ohya, *Parallel Forward Projection of Large Voxel-Volumes on
//! the GPU*, 2009. One plane holds the eye's vertical axis and one azimuth; it crosses the screen in one line. A walk over
//! the columns that it cuts, near to far, draws their runs as spans into that line until the line is full. Planes do not
//! depend on each other.
//!
//! # Stages
//! Each stage has one name, here and in `shaders/`, in [`Stats`] and in the benches.
//!
//! | stage | reads → writes | one task is | CPU | GPU |
//! |---|---|---|---|---|
//! | `plane_setup` | camera → planes, fans | a frame | [`plane_setup`] | the same, uploaded |
//! | `traverse` | planes, columns → plane buffer | a plane | [`cpu::traverse`] | `traverse_invocation.wgsl`, `traverse_workgroup.wgsl` |
//! | `remap` | plane buffer → pixels, doubts | a pixel | [`cpu::remap`] | `remap.wgsl` |
//! | `refine` | doubts, columns → pixels | a pixel | [`cpu::refine`] | `refine.wgsl` |
//! | `gap_fill` | pixels → pixels without holes | a pixel | [`cpu::gap_fill`] | `gap_fill.wgsl` |
//! | `shade` | colour, depth → picture | a pixel | [`cpu::shade`] | `shade.wgsl` |
//!
//! [`exact`] is the reference for all of them: one f64 ray a pixel at level 0, which shares no code with the planes.
//! [`cpu::raycast`] and `raycast.wgsl` are the baseline: one f32 ray a pixel through a sparse [`tree`] of 64-bit masks, with the
//! same levels; `raycast_runs.wgsl` casts it over the tables of planes.
//!
//! # Words
//! *Column*: one (x, z) of the world, y up. *Run*: a solid interval of a column. *Level*: the world at half the resolution
//! of the level before, in x, y and z. *Plane*: see above. *Fan*: planes towards one screen edge. *Sample*: one place of a
//! plane's line, a pixel apart. *Span*: a run as projected into a plane. *Vanishing point*: where the lines of all planes
//! meet on the screen.
//!
//! # Units and spaces
//! Lengths are voxels of level 0, angles degrees. The world is right-handed with y up; *t* is the horizontal distance from
//! the eye along a plane, *h* the height above the eye; *depth* is the distance along the camera's forward axis. Kernels
//! see the eye as a whole voxel and a fraction, so that far from the origin nothing is lost. Colours are sRGB bytes,
//! averaged in linear light.
//!
//! # In a page
//! For wasm32 (`web/`), what needs files, threads or a command line is left out: `cli`, `demo`, `device`, `fly`, `output`,
//! `stability`, `video`.
//!
//! # Who validates
//! `planecast_encoder` proves a file before it becomes a `Scene`; [`Resident`] is made from a `Scene` only; kernels trust
//! it. [`renderer::check`] proves camera and options.
//!
//! # What is exact
//! Plane setup is f64. The walk is f32, as on the GPU, with crossings recomputed from whole cell numbers at each step.
//! At pitch 0 and roll 0 planes are pixel columns and differ from [`exact`] by rounding alone; elsewhere a pixel shows what
//! a sample less than a pixel away sees, tested against its own ray ([`Remap::Retest`]); where samples show
//! different voxels of level 0, what a short walk of that ray meets ([`Remap::Refine`]). Culling never changes a picture.

#[cfg(not(target_arch = "wasm32"))]
pub mod aim;
#[cfg(feature = "report")]
pub mod bench;
pub mod camera;
#[cfg(not(target_arch = "wasm32"))]
pub mod cli;
mod clock;
pub mod compare;
pub mod cpu;
#[cfg(not(target_arch = "wasm32"))]
pub mod demo;
#[cfg(not(target_arch = "wasm32"))]
pub mod device;
pub mod error;
pub mod exact;
#[cfg(not(target_arch = "wasm32"))]
pub mod fly;
pub mod frame;
#[cfg(feature = "gpu")]
pub mod gpu;
#[cfg(not(target_arch = "wasm32"))]
pub mod help;
#[cfg(feature = "report")]
mod json_lines;
#[cfg(feature = "report")]
pub mod machine;
pub mod options;
#[cfg(not(target_arch = "wasm32"))]
pub mod output;
#[cfg(feature = "report")]
pub mod page;
pub mod path;
pub mod pick;
pub mod plane_setup;
#[cfg(feature = "report")]
pub mod plot;
pub mod preset;
pub mod renderer;
#[cfg(feature = "report")]
pub mod report;
pub mod resident;
pub mod specialize;
#[cfg(not(target_arch = "wasm32"))]
pub mod stability;
pub mod tour;
pub mod tree;
#[cfg(not(target_arch = "wasm32"))]
pub mod video;
pub mod view;
pub mod world;

pub use camera::Camera;
#[cfg(not(target_arch = "wasm32"))]
pub use device::{Device, Renderer};
pub use error::{Error, Result};
pub use frame::{Frame, StageTimes, Stats};
#[cfg(feature = "gpu")]
pub use gpu::{GpuOptions, GpuRenderer, Kernel};
pub use options::{Culling, Options, Planes, Remap, Repeat, Shading};
pub use renderer::{CpuRenderer, Outputs};
pub use resident::Resident;
pub use specialize::{Feature, Features};
pub use world::World;

/// Vectors, as [`Camera`] has them.
pub use glam;
/// The scene format, and everything that makes scenes.
pub use planecast_encoder as encoder;
