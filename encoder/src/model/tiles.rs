//! A world that is asked for tile by tile: of a file, of a server, or made on the way.

use crate::format::{TILE, grids};
use crate::{About, ColorMode, Encoding, Level, Result};

/// Whose tiles they are: of level `level` those columns whose number along x starts at `x · TILE`, and along z at `z · TILE`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TileKey {
    pub level: u32,
    pub x: u32,
    pub z: u32,
}

impl TileKey {
    /// The tile of the next coarser level that holds this one.
    #[must_use]
    pub fn parent(self) -> TileKey {
        TileKey { level: self.level + 1, x: self.x / 2, z: self.z / 2 }
    }
}

/// What gives tiles of a world, in any order and from any thread. The same tile is always the same.
pub trait TileSource: Send + Sync {
    /// What errors call it.
    fn name(&self) -> String;

    /// `[nx, ny, nz]`, voxels of level 0.
    fn dims(&self) -> [u32; 3];

    /// How many levels it has; the last is one column.
    fn levels(&self) -> u32 {
        grids(self.dims()).len() as u32
    }

    fn encoding(&self) -> Encoding {
        Encoding::Solid
    }

    fn color(&self) -> ColorMode;

    /// What is known of where it came from.
    fn about(&self) -> About {
        About::default()
    }

    /// Lowest voxel and one past the highest of a level, in voxels of that level; may be more than there is, never less.
    fn heights(&self, level: u32) -> [u32; 2];

    /// Whether each column is probably empty or one run from the ground up, so that heights can stand for runs. A tile may
    /// show otherwise.
    fn is_height_field(&self) -> bool {
        false
    }

    /// Where to stand first: a place in the air with something to see, voxels of level 0. None where any is as good.
    fn start(&self) -> Option<[u32; 3]> {
        None
    }

    /// Whether a tile holds nothing, as far as that is known without reading or making it.
    fn is_empty(&self, key: TileKey) -> bool;

    /// One tile, checked; its columns count from 0. Those of the world's far edges are as small as the world leaves them.
    ///
    /// # Errors
    /// What is wrong with the tile, or with the way to it; asked again, it may come.
    fn tile(&self, key: TileKey) -> Result<Level>;

    /// Whether it holds translucent matter, which tiles leave out.
    fn has_matter(&self) -> bool {
        false
    }

    /// Bytes that a tile takes to read, as far as that is known.
    fn bytes(&self, _: TileKey) -> u64 {
        0
    }
}

/// Columns of a tile along x and z, in a world of these dimensions.
pub fn tile_size(dims: [u32; 3], key: TileKey) -> [u32; 2] {
    let side = |n: u32, at: u32| {
        let n = u64::from(n).div_ceil(1 << key.level.min(63));
        n.saturating_sub(u64::from(at) * u64::from(TILE)).min(TILE.into()) as u32
    };
    [side(dims[0], key.x), side(dims[2], key.z)]
}
