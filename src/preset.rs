//! Presets of `render` and `fly`: points on the front of error against time.

use crate::options::{Options, Planes, Remap};

/// Speed against error, points of the report in `benches/runs/2026-11-22-report`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Preset {
    /// Half the planes, and levels at two pixels.
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
        let (planes, lod) = match self {
            Preset::Fast => (Planes::Factor(0.5), 2.0),
            Preset::Balanced => (Planes::Auto, 1.0),
            Preset::Best => (Planes::Factor(2.0), 0.5),
        };
        // `Remap::Nearest` saves little time and is wrong several times as often.
        Options { planes, lod: Some(lod), remap: Remap::Refine, ..base }
    }
}
