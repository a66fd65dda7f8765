//! The Menger sponge as large as cells allow, from the digits of base 3, at any level.
//!
//! A voxel of level l is solid where any voxel of level 0 in it is, as [`MipRule::Any`](crate::MipRule::Any) has it, and exactly
//! so: levels are halvings, and the sponge's own steps are thirds, but of a cube of the sponge that a box cuts through to an end
//! the box holds as much as of the whole, so that few digits tell.
//!
//! Columns are 65,536 high at most: of a sponge of more than 3¹⁰ voxels a side the lowest 3¹⁰ = 59,049 are there.

use std::ops::Range;

use crate::format::TILE;
use crate::model::tiles::{TileKey, TileSource, tile_size};
use crate::{ColorMode, Columns, ColumnsBuilder, Error, Level, Result, Rgb, Run};

/// The largest sponge has 3 to this many voxels a side: cells have 31 bits.
pub const MOST: u32 = 19;

/// Digits of a height.
const HIGH: u32 = 10;

/// A Menger sponge of 3 to `places` voxels a side.
pub struct Menger {
    name: String,
    places: u32,
}

impl Menger {
    /// `places` is 1 to 19; `name` is what errors call it.
    pub fn new(name: impl Into<String>, places: u32) -> Menger {
        assert!((1..=MOST).contains(&places));
        Menger { name: name.into(), places }
    }

    fn side(&self) -> u32 {
        3u32.pow(self.places)
    }

    fn high(&self) -> u32 {
        self.places.min(HIGH)
    }

    /// Of the columns of a box, at which places of their height no digit may be 1: sets of bits, none of which holds another.
    fn masks(&self, xs: &Range<u32>, zs: &Range<u32>) -> Vec<u32> {
        let mut masks = Vec::new();
        look([0, 0], self.places, 0, xs, zs, &mut masks);
        // What is forbidden beyond the world's height forbids nothing: digits there are 0.
        let high = (1 << self.high()) - 1;
        let mut least: Vec<u32> = Vec::new();
        masks.iter_mut().for_each(|mask| *mask &= high);
        masks.sort_unstable_by_key(|mask| mask.count_ones());
        for mask in masks {
            if !least.iter().any(|l| l & mask == *l) {
                least.push(mask);
            }
        }
        least
    }

    fn color(&self, x: u32, y: u32, z: u32) -> Rgb {
        let of = |v: u32, side: u32| (40 + u64::from(v) * 215 / u64::from(side)) as u8;
        [of(x, self.side()), of(y, 3u32.pow(self.high())), of(z, self.side())]
    }
}

/// Adds the masks of the columns of a box in the square of 3^`places` columns at `at`, of which the digits before forbid `mask`.
fn look(at: [u32; 2], places: u32, mask: u32, xs: &Range<u32>, zs: &Range<u32>, masks: &mut Vec<u32>) {
    let side = 3u32.pow(places);
    let within = |r: &Range<u32>, at: u32| r.start.max(at)..r.end.min(at + side);
    let inner = [within(xs, at[0]), within(zs, at[1])];
    if inner.iter().any(Range::is_empty) || masks.iter().any(|m| m & mask == *m) {
        return;
    }
    // To an end all digits may be 0, or 2: nothing more is forbidden.
    let to_an_end = |i: usize| inner[i].start == at[i] || inner[i].end == at[i] + side;
    if to_an_end(0) && to_an_end(1) {
        masks.push(mask);
        return;
    }
    let third = side / 3;
    for (dx, dz) in [(0, 0), (2, 0), (0, 2), (2, 2), (1, 0), (0, 1), (1, 2), (2, 1)] {
        let more = u32::from(dx == 1 || dz == 1) << (places - 1);
        look([at[0] + dx * third, at[1] + dz * third], places - 1, mask | more, xs, zs, masks);
    }
}

/// Adds the runs of a level in the 3^`places` voxels from `first` on, whose digits are bound by one of `masks` at least.
fn push(masks: &[u32], places: u32, first: u32, level: u32, out: &mut ColumnsBuilder) {
    let last = first + 3u32.pow(places) - 1;
    // Both ends of it are solid, whatever the masks.
    let whole = masks.iter().any(|mask| mask & ((1 << places) - 1) == 0);
    if whole || first >> level == last >> level {
        return out.push_run(Run::new((first >> level) as u16, (last >> level) as u16));
    }
    let third = 3u32.pow(places - 1);
    push(masks, places - 1, first, level, out);
    let free: Vec<u32> = masks.iter().copied().filter(|mask| mask >> (places - 1) & 1 == 0).collect();
    if !free.is_empty() {
        push(&free, places - 1, first + third, level, out);
    }
    push(masks, places - 1, first + 2 * third, level, out);
}

impl TileSource for Menger {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn dims(&self) -> [u32; 3] {
        [self.side(), 3u32.pow(self.high()), self.side()]
    }

    fn color(&self) -> ColorMode {
        ColorMode::Run
    }

    fn heights(&self, level: u32) -> [u32; 2] {
        [0, self.dims()[1].div_ceil(1 << level.min(31))]
    }

    fn start(&self) -> Option<[u32; 3]> {
        // In the middle of a cube's hollow, from which its shafts are seen.
        let side = self.side().min(3u32.pow(7));
        Some([side / 2; 3])
    }

    fn is_empty(&self, key: TileKey) -> bool {
        let [xs, zs] = self.columns(key);
        self.masks(
            &(xs.start << key.level..self.end(xs.end, key.level)),
            &(zs.start << key.level..self.end(zs.end, key.level)),
        )
        .is_empty()
    }

    fn tile(&self, key: TileKey) -> Result<Level> {
        let TileKey { level, x, z } = key;
        let [xs, zs] = self.columns(key);
        if level >= self.levels() || xs.is_empty() || zs.is_empty() {
            return Err(Error::Argument(format!("{}: there is no tile ({x}, {z}) of level {level}", self.name)));
        }
        let ny = self.heights(level)[1];
        let mut out = ColumnsBuilder::new(xs.len() as u32, ny, zs.len() as u32);
        for z in zs.clone() {
            for x in xs.clone() {
                let of = |v: u32| v << level..self.end(v + 1, level);
                let masks = self.masks(&of(x), &of(z));
                if !masks.is_empty() {
                    push(&masks, self.high(), 0, level, &mut out);
                }
                out.end_column();
            }
        }
        let solid: Columns = out.finish();
        let mut colors = Vec::with_capacity(solid.runs().len());
        let columns = zs.clone().flat_map(|z| xs.clone().map(move |x| (x, z)));
        for (i, (x, z)) in columns.enumerate() {
            let runs = &solid.runs()[solid.range(i)];
            colors.extend(runs.iter().map(|run| self.color(x << level, u32::from(run.last()) << level, z << level)));
        }
        Ok(Level { solid, exposed: None, colors, matter: None })
    }
}

impl Menger {
    /// The tile's columns, in voxels of its level; none outside the world.
    fn columns(&self, key: TileKey) -> [Range<u32>; 2] {
        let size = tile_size(self.dims(), key);
        [(key.x, size[0]), (key.z, size[1])].map(|(at, n)| {
            let from = at.saturating_mul(TILE);
            from..from.saturating_add(n)
        })
    }

    /// Where voxels of a level end that end before number `v`, in voxels of level 0.
    fn end(&self, v: u32, level: u32) -> u32 {
        (u64::from(v) << level).min(self.side().into()) as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MipRule;
    use crate::encode::mips;

    fn hollow(mut x: u32, mut y: u32, mut z: u32) -> bool {
        while x + y + z > 0 {
            if [x % 3, y % 3, z % 3].iter().filter(|&&d| d == 1).count() >= 2 {
                return true;
            }
            (x, y, z) = (x / 3, y / 3, z / 3);
        }
        false
    }

    #[test]
    fn menger_tiles_are_what_halving_all_voxels_gives() {
        for places in [1, 2, 4, 5] {
            let sponge = Menger::new("sponge", places);
            let n = 3u32.pow(places);
            let mut all = Columns::from_fn(n, n, n, |x, y, z| !hollow(x, y, z));
            for level in 0..sponge.levels() {
                let [tile, dims] = [sponge.tile(TileKey { level, x: 0, z: 0 }).unwrap().solid, all.clone()];
                assert_eq!(tile, dims, "3^{places}, level {level}");
                all = mips::next(&all, MipRule::Any);
            }
        }
    }

    #[test]
    fn menger_of_all_that_cells_allow_has_exact_voxels_everywhere() {
        let sponge = Menger::new("sponge", MOST);
        assert_eq!(sponge.dims(), [1_162_261_467, 59_049, 1_162_261_467]);
        assert_eq!(sponge.levels(), 32);
        let middle = sponge.side() / 2 / TILE;
        assert!(sponge.is_empty(TileKey { level: 0, x: middle, z: middle }), "the shaft through the middle");
        // Of some columns of a far tile, level 0 against the definition, and level 5 against level 0.
        let key = TileKey { level: 0, x: sponge.side() / TILE - 1, z: 1_000_000 };
        let tile = sponge.tile(key).unwrap();
        for (i, y) in (0..256u32).flat_map(|i| (0..400u32).map(move |y| (i, y * 147))) {
            let (x, z) = (i, i * 7 % 256);
            let solid = tile.solid.find(x, y, z).is_some();
            assert_eq!(solid, !hollow(key.x * TILE + x, y, key.z * TILE + z), "({x}, {y}, {z})");
        }
        let mut fine = tile.solid;
        for _ in 0..3 {
            fine = mips::next(&fine, MipRule::Any);
        }
        let coarse = sponge.tile(TileKey { level: 3, x: key.x / 8, z: key.z / 8 }).unwrap().solid;
        let [x, z] = [key.x % 8 * 32, key.z % 8 * 32];
        assert_eq!(coarse.crop(x..x + 32, z..z + 32), fine);
        for level in [12, 25, 31] {
            assert!(!sponge.tile(TileKey { level, x: 0, z: 0 }).unwrap().solid.runs().is_empty());
        }
        assert!(sponge.tile(TileKey { level: 31, x: 1, z: 0 }).is_err());
    }
}
