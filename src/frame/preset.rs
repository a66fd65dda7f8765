//! Presets of `render` and `fly`: points on the front of error against time.

use crate::frame::options::{Options, Planes, Remap};

/// Speed against error, points of the report in `benches/runs/2026-11-22-report`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Preset {
    /// Half the planes, levels at two pixels, and no rays walked.
    Fast,
    /// What is drawn without flags.
    Balanced,
    /// Twice the planes, and levels at half a pixel.
    Best,
}

impl Preset {
    pub const ALL: [Preset; 3] = [Preset::Fast, Preset::Balanced, Preset::Best];

    pub fn name(self) -> &'static str {
        match self {
            Preset::Fast => "fast",
            Preset::Balanced => "balanced",
            Preset::Best => "best",
        }
    }

    /// Planes, levels and remap of the preset, the rest as in `base`.
    pub fn options(self, base: Options) -> Options {
        // `Remap::Nearest` saves little more and is wrong several times as often; with few planes more rays are walked.
        let (planes, lod, remap) = match self {
            Preset::Fast => (Planes::Factor(0.5), 2.0, Remap::Retest),
            Preset::Balanced => (Planes::Auto, 1.0, Remap::Refine),
            Preset::Best => (Planes::Factor(2.0), 0.5, Remap::Refine),
        };
        Options { planes, lod: Some(lod), remap, ..base }
    }
}
