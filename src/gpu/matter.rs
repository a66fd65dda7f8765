//! Translucent matter on the device: its columns once, and what it looks like whenever that changes.
//!
//! ```text
//! matter       each level: where its columns begin u32 × (columns + 1), runs u32 × n
//! matter_look  coarsest level | distance of the first step (f32) | lowest, highest voxel that is seen | where levels begin | where
//!              optics begin | nx | nz | 8 words a level: nx, nz, columns, runs (in `matter`), masks (here), blocks a row, shift, 0
//!              | optics 6 words a code: r, g, b, extinction (f32), mode, material | masks, two words a block
//! ```

use crate::cpu::matter::{coarsest, finest};
use crate::frame::camera::Camera;
use crate::frame::options::Options;
use crate::world::matter::{Look, SceneMatter};

/// Words of the header.
const HEADER: usize = 8;

/// Where the columns and runs of each level are in [`columns`].
fn places(matter: &SceneMatter) -> impl Iterator<Item = [u32; 2]> {
    let mut at = 0;
    matter.levels.iter().map(move |level| {
        let columns = at as u32;
        at += level.offsets().len();
        let runs = at as u32;
        at += level.runs().len();
        [columns, runs]
    })
}

/// The words of `matter`.
pub fn columns(matter: &SceneMatter) -> Vec<u32> {
    let mut words = Vec::with_capacity(matter.bytes() as usize / 4);
    for level in &matter.levels {
        words.extend_from_slice(level.offsets());
        words.extend_from_slice(bytemuck::cast_slice(level.runs()));
    }
    words
}

/// The words of `matter_look`, whose header is of no frame yet.
pub fn look(matter: &SceneMatter, look: &Look) -> Vec<u32> {
    let [nx, _, nz] = matter.levels[0].dims();
    let heights = look.levels[0].heights;
    let optics = HEADER + 8 * matter.levels.len();
    let mut masks = optics + 6 * look.optics.len();
    let mut words = vec![0, 0, heights[0], heights[1], HEADER as u32, optics as u32, nx, nz];
    for ((level, seen), [columns, runs]) in matter.levels.iter().zip(&look.levels).zip(places(matter)) {
        let [nx, _, nz] = level.dims();
        words.extend([nx, nz, columns, runs, masks as u32, seen.across, seen.shift, 0]);
        masks += 2 * seen.blocks.len();
    }
    for o in &look.optics {
        words.extend(o.color.map(|c| (c as f32).to_bits()));
        words.extend([(o.extinction as f32).to_bits(), o.mode as u32, o.material.into()]);
    }
    for seen in &look.levels {
        words.extend(seen.blocks.iter().flat_map(|&mask| [mask as u32, (mask >> 32) as u32]));
    }
    words
}

/// What a frame puts into the first two words.
pub fn frame(matter: &SceneMatter, camera: &Camera, options: &Options) -> [u32; 2] {
    // Infinite distances are none that shaders know.
    [coarsest(matter, options), finest(camera, options).min(f32::MAX).to_bits()]
}
