//! One solid interval of a column.

use bytemuck::{Pod, Zeroable};

/// Solid voxels `first ..= last` of a column, in voxels of the run's level, 0 at the bottom.
///
/// ```text
///  31       16 15        0
/// |   last    |   first   |      inclusive at both ends, so that a full column of 65,536 fits
/// ```
#[repr(transparent)]
#[derive(Clone, Copy, PartialEq, Eq, Hash, Pod, Zeroable)]
pub struct Run(pub u32);

impl Run {
    /// A run over `first ..= last`; `first <= last`.
    #[inline]
    pub const fn new(first: u16, last: u16) -> Run {
        debug_assert!(first <= last);
        Run(first as u32 | (last as u32) << 16)
    }

    /// Lowest solid voxel.
    #[inline]
    pub const fn first(self) -> u16 {
        self.0 as u16
    }

    /// Highest solid voxel.
    #[inline]
    pub const fn last(self) -> u16 {
        (self.0 >> 16) as u16
    }

    /// One past the highest solid voxel, up to 65,536.
    #[inline]
    pub const fn end(self) -> u32 {
        (self.0 >> 16) + 1
    }

    /// Number of voxels, 1 to 65,536.
    #[inline]
    #[expect(clippy::len_without_is_empty, reason = "a run is never empty")]
    pub const fn len(self) -> u32 {
        self.end() - self.first() as u32
    }
}

impl std::fmt::Debug for Run {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}..={}", self.first(), self.last())
    }
}
