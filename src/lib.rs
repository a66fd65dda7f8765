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
//! | stage | reads → writes | one task per | CPU | GPU |
//! |---|---|---|---|---|
//! | `plane_setup` | camera → planes, fans, in a [`frame::plan`] | frame | [`frame::plane_setup`] | the same, uploaded |
//! | `traverse` | planes, columns → plane buffer | plane | [`cpu::traverse`] | `traverse_invocation.wgsl`, `traverse_workgroup.wgsl` |
//! | `remap` | plane buffer → pixels, doubts | pixel | [`cpu::remap`] | `remap.wgsl` |
//! | `refine` | doubts, columns → pixels | pixel | [`cpu::refine`] | `refine.wgsl` |
//! | `smooth` | height field → pixels, where asked for | pixel | [`cpu::smooth`] | `smooth.wgsl` |
//! | `gap_fill` | pixels → pixels without holes | pixel | [`cpu::gap_fill`] | `gap_fill.wgsl` |
//! | `shade` | colour, depth → picture | pixel | [`cpu::shade`] | `shade.wgsl` |
//! | `usage` | voxels → pixels by tile, of a world in tiles | pixel | [`cpu::usage`] | `usage.wgsl` |
//!
//! Pictures of the whole sphere ([`Projection`]), and views that turn while the eye rests, look planes of all azimuths up by each
//! pixel's ray ([`cpu::sphere`]); `shade` has a part of its own for them ([`cpu::shade_rays`]).
//!
//! [`cpu::exact`] is the reference for all of them: one f64 ray per pixel at level 0, which shares no code with the planes.
//! [`cpu::raycast`] and `raycast.wgsl` are the baseline: one f32 ray per pixel through a sparse [`world::tree`] of 64-bit masks, with
//! the same levels; `raycast_runs.wgsl` casts it over the tables of planes.
//!
//! # Folders
//! | module | what belongs in it |
//! |---|---|
//! | [`encoder`] | the scene format, readers of inputs, tiles and levels |
//! | [`world`] | a scene in memory, as renderers read it |
//! | [`frame`] | one frame: camera, options, planes, picture |
//! | [`cpu`], [`gpu`] | the stages, as twins |
//! | [`render`] | which device draws: [`Renderer`] |
//! | [`film`] | paths, tours, films |
//! | [`measure`] | benches, the report of error against time, whole and in tiles, stability |
//! | [`view`] | the window, and what the page shares with it |
//! | `cli` | the command line |
//!
//! # Features
//! | who | features |
//! |---|---|
//! | draws on GPU and CPU, in a program of one's own | `default-features = false, features = ["gpu"]` |
//! | on the CPU alone | `default-features = false` |
//! | makes films, too | `h264` (builds C++), or `av1` |
//! | measures | `report` (plots, pages, tables) |
//! | opens Zarr, DICOM, object storage | `zarr` (builds C), `dicom`, `object-store` (builds C) |
//! | flies in a window | `view` |
//!
//! # What is stable
//! Versions follow semver from 1.0 on; before, a change of the second number may break. [`World`], [`Renderer`], [`Camera`],
//! [`Options`], [`Frame`], [`Device`] and [`Error`] are meant to stay as they are; other modules are public so that stages can be
//! called, measured and replaced, and move as the renderer does. `.pcast` files of a major version are read by all programs of it.
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
//! For wasm32 (`web/`), what needs files, threads or a command line is left out: `cli`, `film::fly`, `film::video`,
//! `measure::stability`, `output`, `render::device`.
//!
//! # Who validates
//! `planecast_encoder` proves a file before it becomes a `Scene`; [`Resident`] is made from a `Scene` only; kernels trust
//! it. [`cpu::renderer::check`] proves camera and options.
//!
//! # What is exact
//! Plane setup is f64. The walk is f32, as on the GPU, with crossings recomputed from whole cell numbers at each step.
//! At pitch 0 and roll 0 planes are pixel columns and differ from [`cpu::exact`] by rounding alone; elsewhere a pixel shows what
//! a sample less than a pixel away sees, tested against its own ray ([`Remap::Retest`]); where samples show
//! different voxels of level 0, what a short walk of that ray meets ([`Remap::Refine`]). Culling never changes a picture.

#[cfg(not(target_arch = "wasm32"))]
pub mod cli;
mod clock;
pub mod cpu;
pub mod error;
pub mod film;
pub mod frame;
#[cfg(feature = "gpu")]
pub mod gpu;
pub mod measure;
#[cfg(not(target_arch = "wasm32"))]
pub mod output;
pub mod render;
#[cfg(test)]
mod testing;
pub mod view;
pub mod world;

pub use cpu::renderer::{CpuRenderer, Outputs};
pub use error::{Error, Result};
pub use frame::camera::Camera;
pub use frame::options::{Culling, Normals, Options, Planes, Remap, Repeat, Shading};
pub use frame::picture::{Frame, StageTimes, Stats};
pub use frame::projection::Projection;
pub use frame::specialize::{Feature, Features};
#[cfg(feature = "gpu")]
pub use gpu::{GpuOptions, GpuRenderer, Kernel};
#[cfg(not(target_arch = "wasm32"))]
pub use render::device::{Device, Renderer};
pub use world::World;
pub use world::tables::Resident;

/// Vectors, as [`Camera`] has them.
pub use glam;
/// The scene format, and everything that makes scenes.
pub use planecast_encoder as encoder;
