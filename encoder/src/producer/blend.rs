//! One world here, another there, and between them what is between.

use super::noise::{ONE, hash};
use super::octaves::Octaves;
use super::{Area, Cells, Density, Interval, Part, Spot};
use crate::{ColorMode, Rgb};

/// Two worlds and a mask: the first where it is 0, the second where it is one.
pub struct Blend<A, B> {
    pub first: A,
    pub second: B,
    mask: Octaves,
}

impl<A: Density, B: Density> Blend<A, B> {
    /// Regions are some 2^`width` voxels wide.
    pub fn new(first: A, second: B, seed: u32, width: u32) -> Blend<A, B> {
        Blend { first, second, mask: Octaves::new(hash(seed, 77, 0, 0), 2, width, width - 2, 16, 128) }
    }

    /// The mask from its sum, 0 to [`ONE`].
    #[inline(always)]
    fn share(sum: i32) -> i32 {
        (ONE / 2 + 6 * sum).clamp(0, ONE)
    }

    /// Between two values.
    #[inline(always)]
    fn mixed(a: i32, b: i32, share: i32) -> i32 {
        // Far from its surface a world has no say in where that of the other is.
        let [a, b] = [a, b].map(near);
        if share == 0 {
            a
        } else if share == ONE {
            b
        } else {
            a + (((b - a) * share) >> 12)
        }
    }
}

impl<A: Density, B: Density> Density for Blend<A, B> {
    fn height(&self) -> u32 {
        self.first.height().max(self.second.height())
    }

    fn value(&self, p: [u32; 3], level: u32) -> i32 {
        let share = Blend::<A, B>::share(self.mask.at2([p[0], p[2]], level));
        let a = if share < ONE { self.first.value(p, level) } else { 0 };
        let b = if share > 0 { self.second.value(p, level) } else { 0 };
        Blend::<A, B>::mixed(a, b, share)
    }

    fn bounds(&self, part: &Part) -> Interval {
        let mask = self.mask.bounds(part);
        let shares = [mask.least, mask.most].map(Blend::<A, B>::share);
        within(shares, || self.first.bounds(part), || self.second.bounds(part))
    }

    fn shared(&self, area: &Area) -> Vec<i32> {
        let (mask, a, b) = (self.mask.over(area), self.first.shared(area), self.second.shared(area));
        let (na, nb) = (self.first.n_shared(), self.second.n_shared());
        let mut all = Vec::with_capacity(mask.len() + a.len() + b.len());
        for (i, &sum) in mask.iter().enumerate() {
            all.push(Blend::<A, B>::share(sum));
            all.extend_from_slice(&a[i * na..(i + 1) * na]);
            all.extend_from_slice(&b[i * nb..(i + 1) * nb]);
        }
        all
    }

    fn n_shared(&self) -> usize {
        1 + self.first.n_shared() + self.second.n_shared()
    }

    fn bounds_in(&self, shared: &[i32], cells: &Cells) -> Interval {
        let [shares, a, b] = self.split(shared);
        let ends = [shares.iter().copied().min().unwrap_or(0), shares.iter().copied().max().unwrap_or(ONE)];
        within(ends, || self.first.bounds_in(&a, cells), || self.second.bounds_in(&b, cells))
    }

    fn fill(&self, shared: &[i32], cells: &Cells, values: &mut [i32]) {
        let [shares, a, b] = self.split(shared);
        let mut other = vec![0; values.len()];
        if shares.iter().any(|&s| s < ONE) {
            self.first.fill(&a, cells, values);
        }
        if shares.iter().any(|&s| s > 0) {
            self.second.fill(&b, cells, &mut other);
        }
        let ny = cells.size[1] as usize;
        for ((column, other), &share) in values.chunks_exact_mut(ny).zip(other.chunks_exact(ny)).zip(&shares) {
            for (value, &other) in column.iter_mut().zip(other) {
                *value = Blend::<A, B>::mixed(*value, other, share);
            }
        }
    }

    fn color_mode(&self) -> ColorMode {
        ColorMode::Voxel
    }

    fn color(&self, spot: &Spot) -> Rgb {
        let share = Blend::<A, B>::share(self.mask.at2([spot.at[0], spot.at[2]], spot.level));
        if share < ONE / 2 { self.first.color(spot) } else { self.second.color(spot) }
    }

    fn start(&self) -> [u32; 3] {
        let [a, b] = [self.first.start(), self.second.start()];
        [a[0], a[1].max(b[1]), a[2]]
    }
}

impl<A: Density, B: Density> Blend<A, B> {
    /// Shares, numbers of the first and of the second world.
    fn split(&self, shared: &[i32]) -> [Vec<i32>; 3] {
        let na = self.first.n_shared();
        let columns = || shared.chunks_exact(self.n_shared());
        [
            columns().map(|c| c[0]).collect(),
            columns().flat_map(|c| &c[1..1 + na]).copied().collect(),
            columns().flat_map(|c| &c[1 + na..]).copied().collect(),
        ]
    }
}

/// Products with a share stay below 2³¹.
#[inline(always)]
fn near(v: i32) -> i32 {
    v.clamp(-(1 << 17), 1 << 17)
}

/// What a blend is within, where the second world's share is.
fn within([least, most]: [i32; 2], first: impl Fn() -> Interval, second: impl Fn() -> Interval) -> Interval {
    let near = |i: Interval| Interval { least: near(i.least), most: near(i.most) };
    if most == 0 {
        return near(first());
    }
    if least == ONE {
        return near(second());
    }
    let (a, b) = (near(first()), near(second()));
    // Rounding is towards below.
    Interval { least: a.least.min(b.least) - 1, most: a.most.max(b.most) }
}
