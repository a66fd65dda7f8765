//! From an input to levels and tiles: what a scene is made of. Not here: what inputs are read from ([`crate::source`]), and
//! what the bytes of a tile mean ([`crate::format`]).

pub mod build;
#[cfg(not(target_arch = "wasm32"))]
pub(crate) mod height_field;
pub mod memory;
pub mod mips;
#[cfg(not(target_arch = "wasm32"))]
pub mod open;
#[cfg(not(target_arch = "wasm32"))]
pub mod part;
#[cfg(not(target_arch = "wasm32"))]
mod tiles;

#[cfg(not(target_arch = "wasm32"))]
pub use tiles::{EncodeOptions, Summary, Watch, default_memory, encode, encode_part, encode_unnamed, merge};
