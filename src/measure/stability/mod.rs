//! Stiff and extreme cases: what they are, what each must keep to, and how that is measured.
//!
//! *Stiff*: one frame mixes scales many orders apart (grazing slopes, rays almost along an axis, a near voxel beside a far
//! view). *Extreme*: every limit of every input. [`catalogue::cases`] names them with a reason and a bound each;
//! [`measure()`] draws one with a [`Drawer`] and says what came of it as a [`Row`]. Tests and the report share both.
//!
//! # What is measured
//! - **off**: pixels that show what no ray within [`measure::REACH`] pixels of theirs meets, in f64 at level 0
//!   ([`measure::off`]). Planes sample beside a pixel's ray, so that a voxel thinner than a pixel may well be another one
//!   than `exact` shows in its centre; a voxel that cannot be seen from there at all is a fault.
//! - **wrong**: where pixels test voxels against their own rays, those that show what no ray within [`measure::CENTRE`] meets
//!   ([`measure::wrong`]): a horizon that stands a row too high is within a pixel of what is seen, and yet wrong.
//! - **cracks**: pixels of sky where a surface is closed, or of anything where there is nothing.
//! - **depth**: greatest relative error of depth against `exact`, where both show one voxel.
//! - **steps**: columns looked at by the plane that looks at most, at most `bound_steps`, which follows from the geometry
//!   ([`crate::frame::plane_setup::Setup::step_bound`]).
//! - **ulp**: pixels that a change of yaw, of pitch or of the eye by one ulp moves to a voxel that was not within a pixel
//!   before, beyond those that move in `exact`; and by how many of its own ulps a depth grows beyond what `exact` gains.
//!
//! [`walks`] are walks in f32 against walks in f64, over distance.

pub mod catalogue;
pub mod measure;
#[cfg(feature = "report")]
pub mod present;
pub mod walks;
pub mod worlds;

pub use catalogue::{Case, Expect, cases};
pub use measure::{Drawer, Row, measure};
pub use worlds::{World, WorldName};

use crate::error::Result;
#[cfg(feature = "gpu")]
use crate::gpu::present::Device as Gpu;
use crate::render::device::Device;
use measure::Truth;

/// Runs the whole catalogue on a device with all its kernels; `Auto` takes the CPU, `exact`, and a GPU where there is one.
/// `tell` hears of each world.
pub fn run(device: Device, tell: &mut dyn FnMut(&str)) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    let cases = cases();
    let mut names: Vec<WorldName> = Vec::new();
    for case in &cases {
        if !names.contains(&case.world) {
            names.push(case.world);
        }
    }
    let gpu = opened(device)?;
    for (k, name) in names.iter().enumerate() {
        tell(&format!("world {} of {}: {name:?}", k + 1, names.len()));
        let world = name.make();
        let mut drawers = drawers(&world, device, gpu.as_ref())?;
        for case in cases.iter().filter(|c| c.world == *name) {
            let truth = Truth::new(case, &world)?;
            for drawer in &mut drawers {
                rows.push(measure(case, &world, &truth, drawer)?);
            }
        }
    }
    Ok(rows)
}

#[cfg(not(feature = "gpu"))]
enum Gpu {}

/// The GPU, where it is to draw and there is one.
fn opened(device: Device) -> Result<Option<Gpu>> {
    #[cfg(feature = "gpu")]
    match device {
        Device::Gpu => return Gpu::headless().map(Some),
        Device::Auto => return Ok(Gpu::headless().ok()),
        Device::Cpu | Device::Exact | Device::AllGpus => {}
    }
    #[cfg(not(feature = "gpu"))]
    if device == Device::Gpu {
        return Err(crate::Error::Device("this program was built without the gpu feature; try --device cpu".into()));
    }
    Ok(None)
}

/// All that a device draws with.
fn drawers<'a>(world: &'a World, device: Device, gpu: Option<&Gpu>) -> Result<Vec<Drawer<'a>>> {
    let mut drawers = Vec::new();
    if matches!(device, Device::Cpu | Device::Auto) {
        drawers.extend([Drawer::cpu(world), Drawer::cpu_f64(world)]);
    }
    if matches!(device, Device::Exact | Device::Auto) {
        drawers.push(Drawer::exact(world));
    }
    #[cfg(feature = "gpu")]
    if let Some(gpu) = gpu {
        // Of the baseline through a tree of masks the catalogue's bounds are not known.
        for kernel in crate::Kernel::ALL.into_iter().filter(|&k| k != crate::Kernel::Raycast) {
            match Drawer::gpu(gpu, world, kernel, true) {
                Ok(drawer) => drawers.push(drawer),
                Err(_) if device == Device::Auto => break,
                Err(e) => return Err(e),
            }
        }
    }
    #[cfg(not(feature = "gpu"))]
    let _ = gpu;
    Ok(drawers)
}
