//! A mixing layer without end, like that of a Richtmyer–Meshkov instability: heavy fluid below, light fluid above, between them spikes
//! and bubbles that break up into smaller ones.

use super::hills::{mix, shade};
use super::noise::{ONE, hash};
use super::octaves::{Field, Octaves};
use super::{Cells, Density, Interval, Part, SIDE, Spot};
use crate::{ColorMode, Rgb};

/// Voxels high; the layer reaches a quarter of them up and down from the middle.
const HEIGHT: u32 = 512;
const HALF: i32 = 144;

pub struct Mixing {
    /// In 4,096ths.
    pattern: Field,
    turbulence: Field,
}

/// How much of the pattern is still heavy fluid at a height in half voxels, in 4,096ths: a stem that narrows, a cap that is wide again, then
/// nothing. Odd about the middle.
fn threshold(y: i32) -> i32 {
    let away = y - HEIGHT as i32;
    let t = away.abs().min(4 * HALF) * (ONE / 4) / (HALF / 2);
    let value = if t < 1229 {
        t * 6 / 5
    } else if t < 2253 {
        1475 - (t - 1229)
    } else {
        451 + (t - 2253) * 2
    };
    if away < 0 { -value } else { value }
}

impl Mixing {
    pub fn new(seed: u32) -> Mixing {
        Mixing {
            pattern: Field::new(Octaves::new(hash(seed, 1, 0, 3), 3, 6, 5, 30, 128)),
            turbulence: Field::new(Octaves::new(hash(seed, 2, 0, 3), 3, 5, 3, 11, 150)),
        }
    }
}

impl Density for Mixing {
    fn height(&self) -> u32 {
        HEIGHT
    }

    fn value(&self, p: [u32; 3], level: u32) -> i32 {
        self.pattern.at(p, level) + self.turbulence.at(p, level) - threshold(p[1].min(1 << 17) as i32)
    }

    fn bounds(&self, part: &Part) -> Interval {
        let [low, high] = [part.from[1], part.to[1]].map(|y| y.min(1 << 17) as i32);
        // The threshold turns at four heights.
        let turns = [-2253, -1229, 1229, 2253].map(|t: i32| HEIGHT as i32 + t * (HALF / 2) / (ONE / 4));
        let near = turns.into_iter().flat_map(|y| [y - 1, y, y + 1]).filter(|y| (low..=high).contains(y));
        let ends = [low, high].into_iter().chain(near).map(threshold);
        let limit = ends.fold([i32::MAX, i32::MIN], |[a, b], t| [a.min(t), b.max(t)]);
        let most = self.pattern.most() + self.turbulence.most();
        let first = Interval { least: -most - limit[1], most: most - limit[0] };
        if first.least > 0 || first.most <= 0 {
            return first;
        }
        let (a, b) = (self.pattern.bounds(part), self.turbulence.bounds(part));
        Interval { least: a.least + b.least - limit[1], most: a.most + b.most - limit[0] }
    }

    fn fill(&self, _: &[i32], cells: &Cells, values: &mut [i32]) {
        let mut turbulence = vec![0; values.len()];
        self.pattern.fill(cells, values);
        self.turbulence.fill(cells, &mut turbulence);
        values.iter_mut().zip(turbulence).for_each(|(value, more)| *value += more);
        let limits: Vec<i32> = (0..cells.size[1]).map(|y| threshold(cells.middle(1, y).min(1 << 17) as i32)).collect();
        for column in values.chunks_exact_mut(limits.len()) {
            column.iter_mut().zip(&limits).for_each(|(value, limit)| *value -= limit);
        }
    }

    fn color_mode(&self) -> ColorMode {
        ColorMode::Voxel
    }

    fn color(&self, spot: &Spot) -> Rgb {
        const STOPS: [Rgb; 5] = [[38, 30, 92], [150, 36, 92], [230, 96, 48], [250, 190, 86], [255, 246, 214]];
        let t = ((spot.at[1] as i32 - HEIGHT as i32 + 2 * HALF) * 256 / HALF).clamp(0, 1023);
        shade(mix(STOPS[t as usize >> 8], STOPS[(t as usize >> 8) + 1], t & 255), 0)
    }

    fn start(&self) -> [u32; 3] {
        [SIDE / 2, HEIGHT / 2 + HALF as u32, SIDE / 2]
    }
}
