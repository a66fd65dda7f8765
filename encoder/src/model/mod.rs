//! The words of the encoder: runs, columns, levels, colours, and a world in pieces. Not here: files, formats, threads.

pub mod about;
pub mod columns;
pub mod exposure;
pub mod filled;
pub mod grid;
pub mod input;
pub mod matter;
pub mod pieces;
pub mod run;
pub mod scene;
pub mod srgb;
pub mod tiles;
pub mod transfer;
