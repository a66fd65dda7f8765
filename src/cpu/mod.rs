//! The stages on the CPU, with rayon over planes or rows. Each has its GPU twin in `shaders/` under the same name.

pub mod exact;
pub mod gap_fill;
pub mod normal;
pub mod pick;
pub mod refine;
pub mod remap;
pub mod renderer;
pub mod shade;
pub mod shade_rays;
pub mod shadow;
pub mod smooth;
pub mod sphere;
pub mod traverse;
