//! What a picture is drawn with.

use crate::cpu::shade::SSAO_SAMPLES;
use crate::frame::projection::Projection;
use crate::frame::specialize::Features;

/// Neighbours that occlusion may look at.
pub const SSAO_SAMPLES_LIMIT: u32 = 64;

/// Samples of a plane for each pixel, at most.
pub const SAMPLES_LIMIT: f64 = 8.0;

/// Which worlds repeat: the scene is tiled without end along the axes named.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Repeat {
    pub x: bool,
    pub z: bool,
}

/// Culling, each part with its own switch; no combination changes the picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Culling {
    /// Floating horizon: the open window's ends move in as samples at the ends fill.
    pub horizon: bool,
    /// Center segment: runs inside the largest filled segment that touches no end are skipped.
    pub center: bool,
    /// Forward skip: filled stretches are jumped over, as in shear-warp.
    pub forward: bool,
    /// Visibility bits: one bit a sample, instead of looking at the plane buffer itself.
    pub bits: bool,
    /// Coarse cells: blocks of columns whose height range lies outside the window are skipped whole.
    pub coarse: bool,
}

impl Culling {
    pub const ALL: Culling = Culling { horizon: true, center: true, forward: true, bits: true, coarse: true };
    pub const NONE: Culling = Culling { horizon: false, center: false, forward: false, bits: false, coarse: false };
}

/// How many planes are cast.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Planes {
    /// One pixel apart along the far edge of each fan.
    Auto,
    /// This many in all, shared among the fans as `Auto` would.
    Count(u32),
    /// A multiple of what `Auto` takes; 1.0 is `Auto`.
    Factor(f64),
}

/// How a pixel picks a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Remap {
    /// The nearest plane's.
    Nearest,
    /// The one among the nearest whose voxel the pixel's own ray meets.
    Retest,
    /// The same and, where a pixel's samples show different voxels of level 0, what its own ray meets of them and between.
    Refine,
}

impl Remap {
    pub const ALL: [Remap; 3] = [Remap::Nearest, Remap::Retest, Remap::Refine];

    pub fn name(self) -> &'static str {
        match self {
            Remap::Nearest => "nearest",
            Remap::Retest => "retest",
            Remap::Refine => "refine",
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shading {
    /// Colour as stored.
    None,
    /// Screen-space normals.
    Ssn,
    /// Screen-space ambient occlusion.
    Ssao,
    /// Both.
    Full,
}

/// What surfaces are lit by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Normals {
    /// The depths of the pixels around ([`Shading::Ssn`]).
    #[default]
    Screen,
    /// What is solid around each voxel, where the scene has its solid interior.
    Derived,
}

/// Everything but the camera and the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Columns farther than this (horizontal distance, voxels) are not drawn.
    pub view_distance: f64,
    pub repeat: Repeat,
    /// A voxel may project to about this many pixels before a finer level is used; `None` draws level 0 only.
    pub lod: Option<f64>,
    pub planes: Planes,
    /// The paper's readjusted spacing (§3.2, Fig. 4): fewer planes where fans would crowd.
    pub readjust: bool,
    /// Samples of a plane for each pixel along it, above 0 and at most [`SAMPLES_LIMIT`].
    pub samples: f64,
    pub culling: Culling,
    /// Beyond this horizontal distance one column is looked at a slice, instead of each that the plane cuts.
    pub equidistant: Option<f64>,
    pub remap: Remap,
    pub gap_fill: bool,
    /// Walk planes in f64 instead of f32: what rounding costs. On the CPU alone.
    pub f64_traversal: bool,
    pub shading: Shading,
    /// Neighbours that a pixel's occlusion is taken from, 1 to [`SSAO_SAMPLES_LIMIT`].
    pub ssao_samples: u32,
    /// Distance at which fog has taken 1 − 1/e of a colour; `None` for clear air.
    pub fog: Option<f64>,
    /// Where a sun stands that lights surfaces by their screen-space normals, in degrees: azimuth clockwise from north (−z),
    /// and elevation above the horizon. It shows relief: there is less light from elsewhere than without it.
    pub sun: Option<[f64; 2]>,
    /// Whether what stands before the sun throws shadows; of the usual light where no sun is given.
    pub shadows: bool,
    /// Where normals come from.
    pub normals: Normals,
    /// Whether a height field is drawn as a surface where it is near, and lit as one, instead of as blocks.
    pub smooth: bool,
    /// Whether pixels of sky show it; else they are transparent.
    pub sky: bool,
    /// What may be left out where the frame does not need it; the picture is the same.
    pub specialize: Features,
    /// How directions become pixels.
    pub projection: Projection,
}

impl Default for Options {
    fn default() -> Options {
        Options {
            view_distance: f64::INFINITY,
            repeat: Repeat::default(),
            lod: Some(1.0),
            planes: Planes::Auto,
            readjust: true,
            samples: 1.0,
            culling: Culling::ALL,
            equidistant: None,
            remap: Remap::Refine,
            gap_fill: true,
            f64_traversal: false,
            shading: Shading::Full,
            ssao_samples: SSAO_SAMPLES,
            fog: None,
            sun: None,
            shadows: false,
            normals: Normals::Screen,
            smooth: false,
            sky: true,
            specialize: Features::ALL,
            projection: Projection::Perspective,
        }
    }
}

impl Options {
    /// What is drawn of these options: surfaces, shadows and derived normals follow the planes of a perspective, of which a cube
    /// has six; other projections go without.
    pub fn drawn(&self) -> Options {
        match self.projection {
            Projection::Perspective | Projection::Cube => *self,
            _ => Options { smooth: false, shadows: false, normals: Normals::Screen, ..*self },
        }
    }

    /// The shading, with normals where a sun needs them.
    pub fn lit(&self) -> Shading {
        match (self.sun.is_some() || self.shadows, self.shading) {
            (true, Shading::None) => Shading::Ssn,
            (true, Shading::Ssao) => Shading::Full,
            (_, shading) => shading,
        }
    }

    /// The flags of `render` and `fly` that stand for these options; those at their defaults are left out.
    pub fn flags(&self) -> String {
        let (o, usual) = (self, Options::default());
        let mut flags: Vec<String> = Vec::new();
        let mut add = |changed: bool, flag: String| flags.extend(changed.then_some(flag));
        add(o.view_distance != usual.view_distance, format!("--view-distance {}", o.view_distance));
        let repeat = match (o.repeat.x, o.repeat.z) {
            (false, false) => "none",
            (true, false) => "x",
            (false, true) => "z",
            (true, true) => "xz",
        };
        add(o.repeat != usual.repeat, format!("--repeat {repeat}"));
        let planes = match o.planes {
            Planes::Auto => "auto".into(),
            Planes::Count(n) => n.to_string(),
            Planes::Factor(f) => format!("{}%", f * 100.0),
        };
        add(o.planes != usual.planes, format!("--planes {planes}"));
        add(o.lod != usual.lod, format!("--lod {}", o.lod.map_or("off".into(), |px| px.to_string())));
        add(!o.readjust, "--spacing full".into());
        add(o.samples != usual.samples, format!("--samples {}%", o.samples * 100.0));
        add(o.culling != usual.culling, format!("--cull {}", culling_names(o.culling)));
        add(o.equidistant.is_some(), format!("--equidistant {}", o.equidistant.unwrap_or_default()));
        add(o.remap != usual.remap, format!("--remap {}", o.remap.name()));
        add(!o.gap_fill, "--no-gap-fill".into());
        add(o.f64_traversal, "--f64".into());
        let shading = match o.shading {
            Shading::None => "none",
            Shading::Ssn => "ssn",
            Shading::Ssao => "ssao",
            Shading::Full => "full",
        };
        add(o.shading != usual.shading, format!("--shading {shading}"));
        add(o.ssao_samples != usual.ssao_samples, format!("--ssao-samples {}", o.ssao_samples));
        add(o.fog.is_some(), format!("--fog {}", o.fog.unwrap_or_default()));
        let [azimuth, elevation] = o.sun.unwrap_or_default();
        add(o.sun.is_some(), format!("--sun={azimuth},{elevation}"));
        add(o.shadows, "--shadows on".into());
        add(o.normals == Normals::Derived, "--normals derived".into());
        add(o.smooth, "--smooth on".into());
        add(!o.sky, "--sky none".into());
        add(o.specialize != usual.specialize, format!("--specialize {}", o.specialize));
        add(o.projection != usual.projection, format!("--projection {}", o.projection));
        flags.join(" ")
    }
}

fn culling_names(c: Culling) -> String {
    let parts =
        [(c.horizon, "horizon"), (c.center, "center"), (c.forward, "forward"), (c.bits, "bits"), (c.coarse, "coarse")];
    let names: Vec<&str> = parts.into_iter().filter_map(|(on, name)| on.then_some(name)).collect();
    if names.is_empty() { "none".into() } else { names.join(",") }
}
