//! What a scene file is asked: its figures, whether it is whole, its voxels. Not here: drawing, and anything that changes a file.

#[cfg(not(target_arch = "wasm32"))]
pub mod decode;
pub mod info;
pub mod verify;
