//! What an importer hands to the encoder.

use crate::{Columns, Rgb};

/// A world as read from an input, before levels: already y-up in world coordinates.
pub struct Input {
    /// Occupancy. In `solid` form always: every solid voxel, interior ones too.
    pub columns: Columns,
    pub colors: Colors,
    /// Facts a person should be told about the reading (a derived height scale, no-data pixels, models skipped).
    pub notes: Vec<String>,
}

/// Where an input's colours come from. The encoder asks only for voxels with an exposed face.
pub enum Colors {
    /// The input has none.
    None,
    /// One colour a column (height maps), `z·nx + x`.
    Column(Vec<Rgb>),
    /// One colour a run, in the order of `Columns::runs`.
    Run(Vec<Rgb>),
    /// Sparse colours: column `i` has `entries[offsets[i] .. offsets[i+1]]`, ascending in y. A voxel without an
    /// entry of its own takes that of the nearest y in its column (the upper one where two are equally near).
    Voxel { offsets: Vec<u32>, entries: Vec<(u16, Rgb)> },
    /// A pure function of the voxel `(x, y, z)` (procedural scenes).
    Function(Box<dyn Fn(u32, u32, u32) -> Rgb + Send + Sync>),
}
