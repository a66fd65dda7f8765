//! Stiff and extreme cases: what they are, what each must keep to, and how that is measured.
//!
//! *Stiff*: one frame mixes scales many orders apart (grazing slopes, rays almost along an axis, a near voxel beside a far
//! view). *Extreme*: every limit of every input. [`catalogue::cases`] names them with a reason and a bound each;
//! [`measure`] draws one with a [`Drawer`] and says what came of it as a [`Row`]. Tests and the report share both.
//!
//! # What is measured
//! - **off**: pixels that show what no ray within [`measure::REACH`] pixels of theirs meets, in f64 at level 0
//!   ([`measure::off`]). Planes sample beside a pixel's ray, so that a voxel thinner than a pixel may well be another one
//!   than `exact` shows in its centre; a voxel that cannot be seen from there at all is a fault.
//! - **cracks**: pixels of sky where a surface is closed, or of anything where there is nothing.
//! - **depth**: greatest relative error of depth against `exact`, where both show one voxel.
//! - **steps**: columns looked at by the plane that looks at most, at most `bound_steps`, which follows from the geometry
//!   ([`crate::plane_setup::Setup::step_bound`]).
//! - **ulp**: pixels that a change of yaw, of pitch or of the eye by one ulp moves to a voxel that was not within a pixel
//!   before, beyond those that move in `exact`; and by how many of its own ulps a depth grows beyond what `exact` gains.

pub mod catalogue;
pub mod measure;
pub mod worlds;

pub use catalogue::{Case, Expect, cases};
pub use measure::{Drawer, Row, measure};
pub use worlds::{World, WorldName};
