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

pub mod about;
pub mod arriving;
pub mod build;
#[cfg(not(target_arch = "wasm32"))]
pub mod cli;
pub mod column_rle;
pub mod columns;
#[cfg(not(target_arch = "wasm32"))]
pub mod decode;
#[cfg(not(target_arch = "wasm32"))]
pub mod encode;
pub mod error;
pub mod exposure;
pub mod features;
pub mod format;
pub mod forms;
pub mod guard;
#[cfg(not(target_arch = "wasm32"))]
mod height_field;
pub mod info;
pub mod input;
mod lists;
pub mod memory;
pub mod metadata;
pub mod mips;
#[cfg(not(target_arch = "wasm32"))]
pub mod open;
#[cfg(not(target_arch = "wasm32"))]
pub mod part;
#[cfg(not(target_arch = "wasm32"))]
pub mod passing;
pub mod pieces;
pub mod read;
#[cfg(not(target_arch = "wasm32"))]
pub mod remote;
pub mod run;
pub mod say;
pub mod scene;
mod scratch;
pub mod source;
pub mod srgb;
pub mod verify;
pub mod write;

#[cfg(test)]
mod testing;

pub use about::About;
pub use arriving::ArrivingFile;
pub use build::{BuildOptions, build};
pub use columns::{Columns, ColumnsBuilder};
pub use error::{Error, Result};
pub use forms::{Feature, Features};
pub use input::{Colors, Input};
pub use read::PcastFile;
pub use run::Run;
pub use scene::{ColorMode, Encoding, Level, MipRule, Rgb, Scene};
