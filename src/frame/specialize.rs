//! What a scene, a camera and options do not need, and what is therefore left out: every variant is named here, once.
//!
//! A [`Feature`] has tables or kernels of its own, which draw the same picture with less. [`Features`] says which of them
//! may be used, [`Specialization`] which are, and why the others are not. Culling switches that are off ask for the general
//! walk, since they are there to be measured one by one.
//!
//! What else a frame does not pay for needs no choice: colours are looked up as the scene has them (none, per column, per
//! run, per voxel), shading without normals or occlusion has no code for them, voxels are written where they are read,
//! visibility bits and keys are as many as the picture's planes have samples, and passes for gap fill run where planes
//! are sparse.

use crate::frame::camera::Camera;
use crate::frame::options::{Culling, Options};
use crate::frame::plane_setup::{Plane, Setup};
use crate::world::tables::Resident;
use planecast_encoder::ColorMode;
use planecast_encoder::format::features::{FeatureSet, Named};

/// One thing that can be left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Feature {
    /// Run lists, where each column is empty or one run from the ground up: its height alone is kept.
    Heights,
    /// Upper window, visibility bits, center segment and the loop over runs, where heights are seen from above the
    /// ground: whatever a column shows begins where what was drawn before it ends.
    Horizon,
    /// The seam of a repeated world, where it does not repeat.
    Bounded,
    /// The change of levels, where the view ends in the first.
    OneLevel,
    /// Terms of tilted cameras, where pitch and roll are 0.
    Upright,
    /// Half of each voxel that planes keep for remap, where no cell that can be drawn is 2²⁰ of its level from the eye.
    Packed,
    /// Colours of samples that no pixel takes: remap looks them up by voxel, where runs have no colours of their own.
    LateColor,
}

/// Which of the twins draws.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Twin {
    Cpu,
    Gpu,
}

impl Feature {
    pub const ALL: [Feature; 7] = [
        Feature::Heights,
        Feature::Horizon,
        Feature::Bounded,
        Feature::OneLevel,
        Feature::Upright,
        Feature::Packed,
        Feature::LateColor,
    ];

    /// What is not paid for.
    pub fn leaves_out(self) -> &'static str {
        match self {
            Feature::Heights => "run lists: each column is one run from the ground up",
            Feature::Horizon => "upper window, visibility bits, center segment: heights seen from above the ground",
            Feature::Bounded => "repeated worlds: this one does not repeat",
            Feature::OneLevel => "change of levels: the view ends in the first",
            Feature::Upright => "tilted cameras: pitch and roll are 0",
            Feature::Packed => "half of each sample's voxel: no cell is 2^20 from the eye",
            Feature::LateColor => "colours of samples that no pixel takes: found by voxel",
        }
    }

    /// Whether a twin has tables or kernels for it.
    pub fn is_of(self, twin: Twin) -> bool {
        twin == Twin::Gpu || matches!(self, Feature::Heights | Feature::Horizon | Feature::LateColor)
    }
}

impl Named for Feature {
    const ALL: &'static [Feature] = &Feature::ALL;

    fn name(self) -> &'static str {
        match self {
            Feature::Heights => "heights",
            Feature::Horizon => "horizon",
            Feature::Bounded => "bounded",
            Feature::OneLevel => "one-level",
            Feature::Upright => "upright",
            Feature::Packed => "packed",
            Feature::LateColor => "late-color",
        }
    }
}

/// [`Feature`]s that frames may use.
pub type Features = FeatureSet<Feature>;

/// The features in force for one frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Specialization {
    pub features: Features,
}

impl Specialization {
    /// Of what `options` allow, all that the frame can do without.
    pub fn new(resident: &Resident, setup: &Setup, camera: &Camera, options: &Options, twin: Twin) -> Specialization {
        let can = |feature: Feature| match feature {
            Feature::Heights => resident.heights,
            Feature::Horizon => {
                // The CPU's walk has slices of equidistant columns in its general form alone.
                let steps = twin == Twin::Gpu || options.equidistant.is_none();
                let numbered = resident.levels[0].pages.is_some()
                    || u64::from(resident.dims[0]) * u64::from(resident.dims[2]) <= u64::from(u32::MAX);
                resident.heights && options.culling == Culling::ALL && above_ground(setup) && steps && numbered
            }
            Feature::Bounded => !setup.repeats[0] && !setup.repeats[1],
            Feature::OneLevel => setup.levels == 1,
            Feature::Upright => setup.planes.iter().all(|p| p.e as f32 == 0.0),
            Feature::Packed => {
                setup.retests(camera, options) && setup.planes.iter().all(|p| farthest_cell(setup, p) < PACKED)
            }
            Feature::LateColor => {
                // On the CPU a height field's colours are found faster by span than by pixel.
                let pays = twin == Twin::Gpu || (options.culling == Culling::ALL && !resident.heights);
                setup.retests(camera, options) && pays && resident.color != ColorMode::Run
            }
        };
        // The tables are what they are by now.
        let may = |feature: Feature| feature == Feature::Heights || options.specialize.has(feature);
        let features = Feature::ALL.into_iter().filter(|&f| f.is_of(twin) && may(f) && can(f));
        Specialization { features: features.collect() }
    }

    pub fn has(self, feature: Feature) -> bool {
        self.features.has(feature)
    }

    /// What was left out, and why.
    pub fn left_out(self) -> Vec<String> {
        self.features.iter().map(|f| format!("{}: {}", f.name(), f.leaves_out())).collect()
    }
}

/// Cells from the eye to either side that a packed voxel can say.
const PACKED: f64 = (1 << 20) as f64;

/// Beyond how many cells of its level from the eye a plane draws nothing.
fn farthest_cell(setup: &Setup, plane: &Plane) -> f64 {
    let last = setup.levels.max(1) - 1;
    let cells = |l: u32| {
        let end = if l < last { plane.t_end.min(plane.lod_t * f64::from(2u32 << l)) } else { plane.t_end };
        // Two more for the cell at hand and for rounding.
        end / f64::from(1u32 << l) + 2.0
    };
    (plane.lod_first..=last).map(cells).fold(0.0, f64::max)
}

/// Whether the ground's underside, at height 0, lies below the eye, as the walk's own numbers have it.
fn above_ground(setup: &Setup) -> bool {
    (-setup.eye_cell[1]) as f32 - (setup.eye_fract[1] as f32) < 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn features_read_what_they_write() {
        assert_eq!(Features::sets().count(), 128);
        for set in Features::sets() {
            assert_eq!(set.to_string().parse::<Features>().unwrap(), set);
        }
    }

    #[test]
    fn features_that_are_unknown_are_refused_by_name() {
        let e = "heights,hills".parse::<Features>().unwrap_err().to_string();
        assert!(e.contains("hills") && e.contains("one-level"), "{e}");
    }
}
