//! A frame's plan: what is decided about it once, before any of it is drawn. CPU and GPU draw from the same one, and tiles are
//! asked for by it.

use crate::clock::Instant;
use crate::frame::camera::Camera;
use crate::frame::options::Options;
use crate::frame::plane_setup::{Plane, Setup, plane_setup_in};
use crate::frame::specialize::{Specialization, Twin};
use crate::world::tables::Resident;

/// One frame, decided. Good for as long as the world's extents and the heights of its levels are what they were.
#[derive(Clone, Debug)]
pub struct FramePlan {
    pub camera: Camera,
    /// What is drawn: see [`Options::drawn`].
    pub options: Options,
    pub setup: Setup,
    /// Milliseconds that deciding took.
    pub setup_ms: f64,
}

impl FramePlan {
    /// For a camera and options that [`crate::cpu::renderer::check`] has no objection to.
    pub fn new(resident: &Resident, camera: &Camera, options: &Options) -> FramePlan {
        FramePlan::new_in(Vec::new(), resident, camera, options)
    }

    /// The same in the memory of planes that are done with.
    pub(crate) fn new_in(planes: Vec<Plane>, resident: &Resident, camera: &Camera, options: &Options) -> FramePlan {
        let start = Instant::now();
        let options = options.drawn();
        let setup = plane_setup_in(planes, resident, camera, &options);
        FramePlan { camera: *camera, options, setup, setup_ms: start.elapsed().as_secs_f64() * 1e3 }
    }

    /// Whether it is the plan of such a frame.
    pub fn is_of(&self, camera: &Camera, options: &Options) -> bool {
        self.camera == *camera && self.options == options.drawn()
    }

    /// See [`Setup::retests`].
    pub fn retests(&self) -> bool {
        self.setup.retests(&self.camera, &self.options)
    }

    /// See [`Setup::refines`].
    pub fn refines(&self) -> bool {
        self.setup.refines(&self.camera, &self.options)
    }

    /// What a twin leaves out of it.
    pub fn specialization(&self, resident: &Resident, twin: Twin) -> Specialization {
        Specialization::new(resident, &self.setup, &self.camera, &self.options, twin)
    }
}
