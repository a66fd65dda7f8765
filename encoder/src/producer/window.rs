//! A part of a world without end, as an input to be encoded.

use std::ops::Range;

use super::{Density, make};
use crate::model::pieces::Pieces;
use crate::{ColorMode, Colors, Input, Result};

pub struct Window<D> {
    density: D,
    /// First column along x and z, and how many.
    at: [u32; 2],
    size: [u32; 2],
}

impl<D: Density> Window<D> {
    pub fn new(density: D, [x, z, width, depth]: [u32; 4]) -> Window<D> {
        Window { density, at: [x, z], size: [width, depth] }
    }
}

impl<D: Density> Pieces for Window<D> {
    fn dims(&self) -> [u32; 3] {
        [self.size[0], self.density.height(), self.size[1]]
    }

    fn colored(&self) -> bool {
        self.density.color_mode() != ColorMode::None
    }

    fn notes(&self) -> &[String] {
        &[]
    }

    fn piece(&self, xs: Range<u32>, zs: Range<u32>) -> Result<Input> {
        let moved = |r: Range<u32>, by: u32| r.start + by..r.end + by;
        let level = make::level(&self.density, 0, moved(xs, self.at[0]), moved(zs, self.at[1]));
        let colors = match (self.density.color_mode(), &level.exposed) {
            (ColorMode::None, _) => Colors::None,
            (ColorMode::Voxel, Some(exposed)) => {
                // What only the window's sides expose takes the nearest colour.
                let voxels = exposed.runs().iter().flat_map(|run| run.first()..=run.last());
                let offsets = exposed.voxel_offsets().into_iter().map(|n| n as u32).collect();
                Colors::Voxel { offsets, entries: voxels.zip(level.colors).collect() }
            }
            _ => Colors::Run(level.colors),
        };
        Ok(Input { columns: level.solid, colors, notes: Vec::new() })
    }
}
