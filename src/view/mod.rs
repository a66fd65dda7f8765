//! Flying through a scene live: `planecast view`, and what the web page shares with it.
//!
//! | module | what it is |
//! |---|---|
//! | [`world`] | a scene, opened or encoded while the window is there already |
//! | [`control`] | keys and mouse → pose; walking and collision |
//! | [`record`] | a flight → a path of keyframes, and back |
//! | [`pace`] | frame times → fewer or more pixels and planes |
//! | [`last`] | the last view of each scene |
//! | [`map`] | a frame and the exact one → a picture of the errors |
//! | [`script`] | what tests and demonstrations do in the window |
//! | `window` | the window itself, its panel and its device (feature `view`) |
//!
//! There is no second renderer: frames are those of [`crate::GpuRenderer`], left on the device and shown by one pass
//! ([`crate::gpu::present`]), or those of [`crate::CpuRenderer`].

pub mod control;
pub mod last;
pub mod map;
pub mod pace;
pub mod record;
pub mod script;
pub mod world;
