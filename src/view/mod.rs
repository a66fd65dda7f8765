//! Flying through a scene live: `planecast view`, and what the web page shares with it.
//!
//! | module | what it is |
//! |---|---|
//! | [`crate::world`] | a scene, opened or encoded while the window is there already |
//! | [`control`] | keys and mouse → pose; walking and collision |
//! | [`record`] | a flight → a path of keyframes, and back |
//! | [`pace`] | frame times → fewer or more pixels and planes |
//! | [`last`] | the last view of each scene |
//! | [`map`] | a frame and the exact one → a picture of the errors |
//! | [`script`] | what tests and demonstrations do in the window |
//! | [`live`] | a volume at other thresholds, as a slider moves |
//! | [`tune`] | what of the reading of an input is changed while it is looked at |
//! | [`crate::render::drawer`] | whatever draws a scene: the GPU, the CPU, or the exact reference |
//! | `window`, `panel`, `browse`, `overlay`, `canvas` | the window, what egui draws beside and on the picture, the surface below (feature `view`) |
//!
//! There is no second renderer: frames are those of [`crate::GpuRenderer`], left on the device and shown by one copy
//! ([`crate::gpu::present`]), or those of [`crate::CpuRenderer`].

#[cfg(feature = "view")]
mod browse;
#[cfg(feature = "view")]
mod canvas;
pub mod control;
#[cfg(not(target_arch = "wasm32"))]
pub mod last;
#[cfg(not(target_arch = "wasm32"))]
pub mod live;
pub mod map;
#[cfg(feature = "view")]
mod overlay;
pub mod pace;
#[cfg(feature = "view")]
mod panel;
pub mod record;
pub mod script;
pub mod tune;
#[cfg(feature = "view")]
mod window;

#[cfg(not(target_arch = "wasm32"))]
use std::path::PathBuf;

#[cfg(not(target_arch = "wasm32"))]
use crate::Result;
#[cfg(not(target_arch = "wasm32"))]
use crate::frame::options::Options;
#[cfg(not(target_arch = "wasm32"))]
use crate::render::device::Device;
#[cfg(not(target_arch = "wasm32"))]
use crate::world::OpenOptions;
#[cfg(not(target_arch = "wasm32"))]
use crate::world::pager::Patience;
#[cfg(not(target_arch = "wasm32"))]
use crate::world::residency::ResidencyOptions;

/// Milliseconds that a frame of the window waits for its tiles, unless others are given: half of one at 60 frames a second.
#[cfg(not(target_arch = "wasm32"))]
pub const PATIENCE: Patience = Patience::Deadline(8.0);

/// Words of a command line that say how an input is read, each flag with its value, as the commands call them that draw the same.
#[cfg(not(target_arch = "wasm32"))]
#[derive(Clone, Debug, Default)]
pub struct Reading {
    pub render: Vec<Vec<String>>,
    pub fly: Vec<Vec<String>>,
}

/// What `planecast view` is told.
#[cfg(not(target_arch = "wasm32"))]
#[derive(Clone, Debug)]
pub struct Settings {
    /// A scene file, or an input to encode; `None` for a window that waits for a file to be dropped on it.
    pub input: Option<PathBuf>,
    pub how: OpenOptions,
    pub reading: Reading,
    pub residency: ResidencyOptions,
    /// Where to begin; without an eye, where the scene was left, or a good view.
    pub eye: Option<glam::DVec3>,
    pub yaw: Option<f64>,
    pub pitch: Option<f64>,
    pub roll: Option<f64>,
    pub aim: crate::frame::aim::AimArgs,
    pub fov: f64,
    pub device: Device,
    pub kernel: Option<String>,
    pub options: Options,
    /// Whether height fields are drawn as a surface; `None`: those that stand for one.
    pub smooth: Option<bool>,
    /// The window, pixels.
    pub size: [u32; 2],
    pub full_screen: bool,
    /// Frames a second to hold.
    pub target_fps: Option<f64>,
    /// Pixels of screenshots; `None` for those of the window.
    pub screenshot_size: Option<[u32; 2]>,
    pub script: Option<PathBuf>,
}

/// Opens a window on a scene and stays until it is closed.
#[cfg(not(target_arch = "wasm32"))]
pub fn view(settings: Settings) -> Result<()> {
    #[cfg(feature = "view")]
    return window::run(settings);
    #[cfg(not(feature = "view"))]
    {
        let _ = settings;
        Err(crate::Error::Device(
            "this planecast was built without its window; build it with: cargo build --release --features view".into(),
        ))
    }
}

/// Flags that reproduce a view with `render`, `--eye` to `--fov`, as exact as they can be typed.
pub fn pose_flags(pose: &crate::film::path::Pose) -> String {
    let crate::film::path::Pose { eye, yaw, pitch, roll, fov } = pose;
    format!("--eye {},{},{} --yaw {yaw} --pitch {pitch} --roll {roll} --fov {fov}", eye.x, eye.y, eye.z)
}
