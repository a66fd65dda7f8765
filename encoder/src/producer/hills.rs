//! Mountains, plains and lakes: one height a column.

use super::noise::{ONE, hash};
use super::octaves::Octaves;
use super::{Area, Density, Interval, Part, SIDE};
use crate::{ColorMode, Rgb};

/// Voxels that the world is high.
const HEIGHT: u32 = 1024;

/// Lakes end here.
const WATER: i32 = 96;

/// Rugged mountains that rise out of gentle plains, with flat lakes.
pub struct Hills {
    seed: u32,
    /// Ground everywhere, in 4,096ths of a voxel.
    ground: Octaves,
    /// Where mountains are, and their ridges, in 4,096ths.
    regions: Octaves,
    ridges: Octaves,
}

impl Hills {
    pub fn new(seed: u32) -> Hills {
        Hills {
            seed,
            ground: Octaves::new(hash(seed, 1, 0, 0), 2, 11, 2, 400 << 4, 126),
            regions: Octaves::new(hash(seed, 2, 0, 0), 2, 13, 12, 16, 128),
            ridges: Octaves::new(hash(seed, 3, 0, 0), 2, 11, 8, 16, 118),
        }
    }

    /// Height in 4,096ths of a voxel, from sums of the octaves.
    #[inline(always)]
    fn surface(ground: i32, region: i32, ridge: i32) -> i32 {
        let mountains = (ONE / 2 + region * 2).clamp(0, ONE);
        let crest = (ONE - 3 * ridge.abs()).max(0);
        let crest = (crest * crest) >> 12;
        // A quarter of the ground's relief in the plains, all of it in the mountains.
        let rough = ONE / 4 + ((mountains * 3) >> 2);
        let height = 150 * ONE + (ground >> 6) * (rough >> 6) + ((mountains * crest) >> 12) * 560;
        height.clamp(WATER * ONE, (HEIGHT as i32 - 1) * ONE)
    }

    fn least_and_most(ground: Interval, region: Interval, ridge: Interval) -> Interval {
        let grounds = [ground.least, ground.most];
        let regions = [region.least, region.most];
        // Crests are highest at 0.
        let near = if ridge.least <= 0 && ridge.most >= 0 { 0 } else { ridge.least.abs().min(ridge.most.abs()) };
        let ridges = [near, ridge.least.abs().max(ridge.most.abs())];
        let mut all = Interval { least: i32::MAX, most: i32::MIN };
        for corner in 0..8 {
            let height = Hills::surface(grounds[corner & 1], regions[corner >> 1 & 1], ridges[corner >> 2]);
            all = Interval { least: all.least.min(height), most: all.most.max(height) };
        }
        // Rounding of products.
        Interval { least: all.least - ONE / 8, most: all.most + ONE / 8 }
    }

    fn at(&self, [x, z]: [u32; 2], level: u32) -> i32 {
        let of = |octaves: &Octaves| octaves.at2([x, z], level);
        Hills::surface(of(&self.ground), of(&self.regions), of(&self.ridges))
    }

    /// Height of the ground at a column, in voxels.
    pub fn height_at(&self, x: u32, z: u32) -> u32 {
        (self.at([2 * x + 1, 2 * z + 1], 0) >> 12) as u32
    }
}

impl Density for Hills {
    fn height(&self) -> u32 {
        HEIGHT
    }

    /// How far the middle of the voxel is under the surface, in 4,096ths of a voxel.
    fn value(&self, [x, y, z]: [u32; 3], level: u32) -> i32 {
        self.at([x, z], level) - y.min(1 << 17) as i32 * (ONE / 2)
    }

    fn bounds(&self, part: &Part) -> Interval {
        let of = |octaves: &Octaves| octaves.bounds(part);
        let Interval { least, most } = Hills::least_and_most(of(&self.ground), of(&self.regions), of(&self.ridges));
        Interval { least: least - part.to[1] as i32 * (ONE / 2), most: most - part.from[1] as i32 * (ONE / 2) }
    }

    fn heights(&self, area: &Area) -> Option<Vec<u16>> {
        let (ground, regions, ridges) = (self.ground.over(area), self.regions.over(area), self.ridges.over(area));
        let sums = ground.iter().zip(&regions).zip(&ridges);
        let half = (ONE / 2) << area.level.min(18);
        // A voxel is solid where its middle is under the surface; the ground has no holes at any level.
        let height = |((&g, &m), &r): ((&i32, &i32), &i32)| {
            ((Hills::surface(g, m, r) + half - 1) >> (12 + area.level.min(19))).max(1) as u16
        };
        Some(sums.map(height).collect())
    }

    fn is_height_field(&self) -> bool {
        true
    }

    fn color_mode(&self) -> ColorMode {
        ColorMode::Run
    }

    fn top_colors(&self, area: &Area, heights: &[u16]) -> Vec<Rgb> {
        let [width, depth] = area.size.map(|n| n as usize);
        let around = width + 2;
        let mut colors = Vec::with_capacity(width * depth);
        for z in 0..depth {
            for x in 0..width {
                let at = |dx: usize, dz: usize| i32::from(heights[(z + dz) * around + x + dx]);
                let steep = (at(0, 1) - at(2, 1)).abs().max((at(1, 0) - at(1, 2)).abs());
                let grain = match area.level {
                    0 => {
                        (hash(self.seed, area.from[0].wrapping_add(x as u32), 9, area.from[1].wrapping_add(z as u32))
                            >> 28) as i32
                            - 8
                    }
                    _ => 0,
                };
                colors.push(land((at(1, 1) << area.level.min(15)).min(HEIGHT as i32), steep, grain));
            }
        }
        colors
    }

    fn start(&self) -> [u32; 3] {
        // The first land from the middle on along x, and above what is around it.
        let z = SIDE / 2;
        let x =
            (0..64).map(|i| SIDE / 2 + 256 * i).find(|&x| self.height_at(x, z) > WATER as u32 + 8).unwrap_or(SIDE / 2);
        let around = (0..=8).map(|i| self.height_at(x, z - 64 * i)).max().unwrap_or(0);
        [x, around + 60, z]
    }
}

/// Between `a` (t = 0) and `b` (t = 256).
pub(super) fn mix(a: Rgb, b: Rgb, t: i32) -> Rgb {
    let t = t.clamp(0, 256);
    [0, 1, 2].map(|i| (i32::from(a[i]) + (((i32::from(b[i]) - i32::from(a[i])) * t) >> 8)) as u8)
}

/// Lighter or darker by `by` 256ths.
pub(super) fn shade(c: Rgb, by: i32) -> Rgb {
    c.map(|v| (i32::from(v) + ((i32::from(v) * by) >> 8)).clamp(0, 255) as u8)
}

/// Water, sand, grass, rock and snow: by height in voxels of level 0, and by how far neighbours on both sides differ in height, in
/// voxels of the level.
pub(super) fn land(height: i32, steep: i32, grain: i32) -> Rgb {
    const LAKE: Rgb = [46, 92, 128];
    const SAND: Rgb = [206, 190, 140];
    const GRASS: Rgb = [88, 132, 58];
    const MEADOW: Rgb = [140, 146, 76];
    const ROCK: Rgb = [122, 114, 106];
    const SNOW: Rgb = [240, 244, 250];
    if height <= WATER {
        return LAKE;
    }
    let flat = if height <= 102 {
        mix(SAND, GRASS, (height - 99) * 64)
    } else if height <= 280 {
        mix(GRASS, MEADOW, (height - 130) * 2)
    } else {
        mix(MEADOW, SNOW, (height - 380) * 3)
    };
    shade(mix(flat, ROCK, (steep - 1) * 128), grain)
}
