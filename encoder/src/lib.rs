//! The scene format of planecast and everything that makes one.
//!
//! A *column* is one `(x, z)` of the world, y up; a *run* is a solid interval of a column; a *level* is the
//! world at half the resolution of the level before, in x, y and z. [`Scene`] holds all levels of one world in
//! memory as flat run lists; the file form (`.pcast`) holds the same runs as the two-level lists of Forstmann &
//! Ohya 2009 §3.1, in tiles.
//!
//! ```text
//! file ──source──► Input ──build──► Scene ──write──► .pcast ──read──► Scene
//! file ──source──► Pieces ──────encode, by tiles──────► .pcast           within a budget of memory, the same bytes
//! ```

#![cfg_attr(
    target_arch = "wasm32",
    allow(dead_code, reason = "a page reads scenes, and neither logs nor merges parts")
)]

#[cfg(not(target_arch = "wasm32"))]
pub mod cli;
pub mod encode;
pub mod error;
pub mod format;
pub mod inspect;
pub mod model;
pub mod parallel;
pub mod producer;
pub mod say;
pub mod source;
pub mod store;

#[cfg(test)]
mod testing;

pub use encode::build::{BuildOptions, build};
pub use error::{Error, Result};
pub use format::arriving::ArrivingFile;
pub use format::file::PcastFile;
pub use format::forms::{Feature, Features};
pub use model::about::About;
pub use model::columns::{Columns, ColumnsBuilder};
pub use model::input::{Colors, Input};
pub use model::matter::Matter;
pub use model::run::Run;
pub use model::scene::{ColorMode, Encoding, Level, MipRule, Rgb, Scene};
pub use model::tiles::{TileKey, TileSource};
