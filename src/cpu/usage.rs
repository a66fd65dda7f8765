//! Stage `usage`: how many pixels show the tile of each slot, of a world whose tiles come and go. From it a frame's debt is
//! counted. Twin: `shaders/usage.wgsl`.

use rayon::prelude::*;

use crate::world::tables::{Resident, TILE_SHIFT};

/// Pixels that a thread counts at a time.
const AT_ONCE: usize = 1 << 14;

/// Of each level the number of its first slot, and how many slots there are.
pub fn slots(resident: &Resident) -> (Vec<u32>, u32) {
    let mut n = 0;
    let slots = |level: &crate::world::tables::ResidentLevel| {
        n += (level.n_columns() >> (2 * TILE_SHIFT)) as u32;
        n
    };
    let mut first = vec![0];
    first.extend(resident.levels.iter().map(slots));
    let n = first.pop().unwrap_or(0);
    (first, n)
}

/// Pixels by number of the slot they show, among those of all levels; of voxels as frames have them.
pub fn usage(resident: &Resident, voxels: &[[i32; 4]]) -> Vec<u32> {
    let (first, n) = slots(resident);
    let of_part = |voxels: &[[i32; 4]]| {
        let mut counts = vec![0u32; n as usize];
        let (mut last, mut slot) = ([-1; 3], 0);
        for &[x, _, z, l] in voxels.iter().filter(|voxel| voxel[3] >= 0) {
            let tile = [x, z].map(|v| v >> l >> TILE_SHIFT);
            if [tile[0], tile[1], l] != last {
                last = [tile[0], tile[1], l];
                let pages = resident.levels[l as usize].pages.as_ref().expect("its tiles stand in slots");
                slot = first[l as usize] + pages.slots[pages.place(tile[0] as u32, tile[1] as u32)];
            }
            counts[slot as usize] += 1;
        }
        counts
    };
    let add = |mut a: Vec<u32>, b: Vec<u32>| {
        a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
        a
    };
    voxels.par_chunks(AT_ONCE).map(of_part).reduce(|| vec![0; n as usize], add)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::tables::{Pages, Paint, ResidentLevel, Table};
    use planecast_encoder::{ColorMode, Encoding};

    #[test]
    fn pixels_are_counted_by_the_slot_that_holds_their_tile() {
        // Two levels: one of 2 × 2 tiles in slots 3, 1, none and 2, then one of a single tile.
        let level = |slots: usize, pages: Vec<u32>| ResidentLevel {
            nx: 512,
            nz: 512,
            table: Table::Heights(vec![0; slots << (2 * TILE_SHIFT)]),
            blocks: Vec::new(),
            bottom: 0,
            top: 0,
            paint: Paint::None,
            pages: Some(Pages { shift: pages.len().ilog2() / 2, slots: pages }),
        };
        let resident = Resident {
            dims: [512, 1, 512],
            encoding: Encoding::Solid,
            color: ColorMode::None,
            levels: vec![level(4, vec![3, 1, 0, 2]), level(2, vec![1])],
            heights: true,
            fractions: Vec::new(),
            matter: None,
        };
        assert_eq!(slots(&resident), (vec![0, 4], 6));
        let mut voxels = vec![[-1; 4]; 40_000];
        voxels.extend([[0, 0, 0, 0], [255, 9, 255, 0], [256, 0, 0, 0], [300, 0, 400, 0], [511, 0, 511, 1]]);
        voxels.extend(vec![[510, 3, 2, 1]; 20_000]);
        assert_eq!(usage(&resident, &voxels), [0, 1, 1, 2, 0, 20_001]);
    }
}
