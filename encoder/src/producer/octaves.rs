//! Sums of octaves of noise: at a point, over an area of columns, over a box, and bounds of them. All give the same values.

use super::noise::{self, ONE, after, along, cell, end2, end3, fade, gradient, hash};
use super::{Area, Cells, Interval, Part};

/// Noise in cells of a power of two voxels, each half as wide as those of the octave before.
#[derive(Clone, Debug)]
pub struct Octaves {
    seed: u32,
    /// Two or three dimensions.
    dimensions: usize,
    /// Cells of less than 2^`narrowest` voxels of a level are left out of it.
    narrowest: u32,
    /// By octave: cells of 2^`shift` half voxels, amplitude in 16ths of what is summed.
    octaves: Vec<[u32; 2]>,
}

impl Octaves {
    /// Octaves with cells of 2^`from` to 2^`to` voxels, `to ≤ from ≤ 26`. The first has `amplitude`, 16ths, up to 2¹⁷; each
    /// other `gain` 256ths of the one before.
    pub fn new(seed: u32, dimensions: usize, from: u32, to: u32, amplitude: u32, gain: u32) -> Octaves {
        assert!(to <= from && from <= 26 && amplitude <= 1 << 17 && (2..=3).contains(&dimensions));
        let mut octaves = Vec::new();
        // In 4,096ths, so that small ones do not die of rounding.
        let mut exact = u64::from(amplitude) << 8;
        for k in (to..=from).rev() {
            octaves.push([k + 1, (exact >> 8) as u32]);
            exact = (exact * u64::from(gain)) >> 8;
        }
        Octaves { seed, dimensions, narrowest: 2, octaves }
    }

    /// The octaves that a level shows: their seed, the cells' shift, and the amplitude.
    fn shown(&self, level: u32) -> impl Iterator<Item = (u32, u32, i32)> {
        let (seed, narrowest) = (self.seed, self.narrowest);
        self.octaves
            .iter()
            .filter(move |[shift, _]| *shift > level + narrowest)
            .map(move |&[shift, amplitude]| (hash(seed, shift, 0, 0), shift, amplitude as i32))
    }

    /// Lattices of octaves do not lie on each other: there all noise is 0.
    #[inline(always)]
    fn moved(seed: u32, axis: u32) -> u32 {
        hash(seed, axis, 1, 0)
    }

    /// At a place of two dimensions.
    pub fn at2(&self, [x, z]: [u32; 2], level: u32) -> i32 {
        debug_assert_eq!(self.dimensions, 2);
        let of = |(seed, shift, amplitude)| {
            let at = [x.wrapping_add(Octaves::moved(seed, 0)), z.wrapping_add(Octaves::moved(seed, 2))];
            (noise::noise2(seed, at, shift) * amplitude) >> 4
        };
        self.shown(level).map(of).sum()
    }

    /// At a place of three dimensions.
    pub fn at3(&self, p: [u32; 3], level: u32) -> i32 {
        debug_assert_eq!(self.dimensions, 3);
        let of = |(seed, shift, amplitude)| {
            let at = [0, 1, 2].map(|i| p[i].wrapping_add(Octaves::moved(seed, i as u32)));
            (noise::noise3(seed, at, shift) * amplitude) >> 4
        };
        self.shown(level).map(of).sum()
    }

    /// Over the columns of an area, by rows of x.
    pub fn over(&self, area: &Area) -> Vec<i32> {
        debug_assert_eq!(self.dimensions, 2);
        let [width, depth] = area.size.map(|n| n as usize);
        let mut sums = vec![0i32; width * depth];
        for (seed, shift, amplitude) in self.shown(area.level) {
            let [dx, dz] = [0, 2].map(|axis| Octaves::moved(seed, axis));
            let across: Vec<(u32, i32)> =
                (0..width as u32).map(|i| cell(area.middle(0, i).wrapping_add(dx), shift)).collect();
            let fades: Vec<i32> = across.iter().map(|&(_, f)| fade(f)).collect();
            let fractions: Vec<i32> = across.iter().map(|&(_, f)| f).collect();
            // Columns of one cell, and their corners.
            let mut spans: Vec<(std::ops::Range<usize>, u32)> = Vec::new();
            for (i, &(cell, _)) in across.iter().enumerate() {
                match spans.last_mut() {
                    Some((span, of)) if *of == cell => span.end = i + 1,
                    _ => spans.push((i..i + 1, cell)),
                }
            }
            let corners: Vec<u32> = spans.iter().map(|s| s.1).chain(spans.last().map(|s| after(s.1, shift))).collect();
            let mut gradients: [Vec<[i32; 3]>; 2] = Default::default();
            let mut ends = vec![[0; 2]; corners.len()];
            let mut loaded = None;
            for (i, row) in sums.chunks_exact_mut(width).enumerate() {
                let (z, fz) = cell(area.middle(1, i as u32).wrapping_add(dz), shift);
                if loaded != Some(z) {
                    loaded = Some(z);
                    gradients =
                        [z, after(z, shift)].map(|z| corners.iter().map(|&x| gradient(hash(seed, x, 0, z))).collect());
                }
                let w = fade(fz);
                let pairs = gradients[0].iter().zip(&gradients[1]);
                ends.iter_mut().zip(pairs).for_each(|(end, (&g0, &g1))| *end = end2(g0, g1, fz, w));
                for (at, (span, _)) in spans.iter().enumerate() {
                    let (e0, e1) = (ends[at], ends[at + 1]);
                    let places = fractions[span.clone()].iter().zip(&fades[span.clone()]);
                    for (sum, (&t, &u)) in row[span.clone()].iter_mut().zip(places) {
                        *sum += (along(e0, e1, t, u) * amplitude) >> 4;
                    }
                }
            }
        }
        sums
    }

    /// What a level leaves out is not farther from 0.
    pub fn left_out(&self, level: u32) -> i32 {
        let most = noise::MOST[self.dimensions - 2];
        let out = self.octaves.iter().filter(|[shift, _]| *shift <= level + self.narrowest);
        out.map(|&[_, amplitude]| ((most * amplitude as i32) >> 4) + 1).sum()
    }

    /// Adds the sums at the places of a box of voxels, `(z·nx + x)·ny + y`.
    pub fn fill(&self, cells: &Cells, sums: &mut [i32]) {
        let places = |axis: usize| move |i: u32| cells.middle(axis, i);
        self.add(cells.level, cells.size, [&places(0), &places(1), &places(2)], sums);
    }

    /// The same at places along each axis of which two that follow each other are nowhere more than a cell apart.
    fn add(&self, level: u32, size: [u32; 3], places: [&dyn Fn(u32) -> u32; 3], sums: &mut [i32]) {
        debug_assert_eq!(self.dimensions, 3);
        for (seed, shift, amplitude) in self.shown(level) {
            let axis = |i: usize| Axis::new(size[i], places[i], Octaves::moved(seed, i as u32), shift);
            add(seed, amplitude, &[axis(0), axis(1), axis(2)], sums);
        }
    }

    /// No sum is farther from 0, at any level.
    pub fn most(&self) -> i32 {
        let most = noise::MOST[self.dimensions - 2];
        self.octaves.iter().map(|&[_, amplitude]| ((most * amplitude as i32) >> 4) + 1).sum()
    }

    /// All sums in a part of the world lie in it, whichever octaves the level shows.
    ///
    /// Of octaves with cells much wider than the part, the values at its corners bound those between by how much noise can
    /// bend; of the others, the amplitude counts.
    pub fn bounds(&self, part: &Part) -> Interval {
        let axes: &[usize] = if self.dimensions == 2 { &[0, 2] } else { &[0, 1, 2] };
        let widest = axes.iter().map(|&a| part.to[a].wrapping_sub(part.from[a])).max().unwrap_or(0);
        let mut bounds = Interval { least: 0, most: 0 };
        for &[shift, amplitude] in &self.octaves {
            let (amplitude, seed) = (amplitude as i32, hash(self.seed, shift, 0, 0));
            let most = ((noise::MOST[self.dimensions - 2] * amplitude) >> 4) + 1;
            // Second derivatives are at most 25 a cell² along each axis, of which an eighth counts.
            let part_of_cell = ((i64::from(widest) << 12 >> shift) + 1).min(4 * i64::from(ONE));
            let bend = 25 * self.dimensions as i64 * part_of_cell * part_of_cell / (8 * i64::from(ONE));
            let mut of = Interval { least: -most, most };
            if bend < i64::from(ONE) {
                let bend = bend as i32 + 2 * noise::ROUNDING;
                let mut seen = Interval { least: i32::MAX, most: i32::MIN };
                for corner in 0..1u32 << self.dimensions {
                    let mut at = part.from;
                    for (bit, &axis) in axes.iter().enumerate() {
                        let p = if corner >> bit & 1 == 1 { part.to[axis] } else { part.from[axis] };
                        at[axis] = p.wrapping_add(Octaves::moved(seed, axis as u32));
                    }
                    let n = if self.dimensions == 2 {
                        noise::noise2(seed, [at[0], at[2]], shift)
                    } else {
                        noise::noise3(seed, at, shift)
                    };
                    seen = Interval { least: seen.least.min(n), most: seen.most.max(n) };
                }
                // Towards below and above, whatever the sign.
                of.least = of.least.max((((seen.least - bend) * amplitude) >> 4) - 1);
                of.most = of.most.min((((seen.most + bend) * amplitude) >> 4) + 1);
            }
            // A level may leave the octave out.
            bounds.least = bounds.least.saturating_add(of.least.min(0));
            bounds.most = bounds.most.saturating_add(of.most.max(0));
        }
        bounds
    }
}

/// Places of a lattice along a side of a box at most.
const LATTICE: usize = Cells::MOST / 2 + 2;

/// Noise of three dimensions that is made at every fourth voxel of level 0, and every second of others, along each axis, and is linear
/// between: for what is smooth.
#[derive(Clone, Debug)]
pub struct Field(Octaves);

impl Field {
    /// Of octaves with cells of eight voxels and more.
    pub fn new(octaves: Octaves) -> Field {
        Field(octaves)
    }

    /// A lattice of so many half voxels, as a power of two.
    fn shift(level: u32) -> u32 {
        // Coarse levels are lower, and have less to be smooth.
        if level == 0 { 3 } else { (level + 2).min(31) }
    }

    /// At a place.
    pub fn at(&self, p: [u32; 3], level: u32) -> i32 {
        let shift = Field::shift(level);
        let [(x, fx), (y, fy), (z, fz)] = p.map(|v| cell(v, shift));
        let at = |dx: u32, dy: u32, dz: u32| {
            let next = |v: u32, d: u32| v.wrapping_add(d) << shift;
            self.0.at3([next(x, dx), next(y, dy), next(z, dz)], level)
        };
        let end = |dy| between(between(at(0, dy, 0), at(1, dy, 0), fx), between(at(0, dy, 1), at(1, dy, 1), fx), fz);
        between(end(0), end(1), fy)
    }

    /// The values at the places of a box of voxels, `(z·nx + x)·ny + y`.
    pub fn fill(&self, cells: &Cells, values: &mut [i32]) {
        let shift = Field::shift(cells.level);
        let first = [0, 1, 2].map(|axis| cells.middle(axis, 0) >> shift);
        let size = [0, 1, 2].map(|axis| {
            let last = cells.middle(axis, cells.size[axis] - 1) >> shift;
            (last.wrapping_sub(first[axis]) & (u32::MAX >> shift)) + 2
        });
        let place = |axis: usize| move |i: u32| first[axis].wrapping_add(i) << shift;
        let [nx, ny, nz] = size.map(|n| n as usize);
        let mut lattice = vec![0; nx * ny * nz];
        self.0.add(cells.level, size, [&place(0), &place(1), &place(2)], &mut lattice);
        let axis = |axis: usize, i: u32| {
            let (at, fraction) = cell(cells.middle(axis, i), shift);
            ((at.wrapping_sub(first[axis]) & (u32::MAX >> shift)) as usize, fraction)
        };
        let ys: Vec<(usize, i32)> = (0..cells.size[1]).map(|y| axis(1, y)).collect();
        let mut profile = [0; LATTICE];
        let mut columns = values.chunks_exact_mut(ys.len());
        for z in 0..cells.size[2] {
            let (z, fz) = axis(2, z);
            for x in 0..cells.size[0] {
                let (x, fx) = axis(0, x);
                let line = |x: usize, z: usize| &lattice[(z * nx + x) * ny..][..ny];
                let (a, b, c, d) = (line(x, z), line(x + 1, z), line(x, z + 1), line(x + 1, z + 1));
                for (y, value) in profile.iter_mut().enumerate().take(ny) {
                    *value = between(between(a[y], b[y], fx), between(c[y], d[y], fx), fz);
                }
                let column = columns.next().expect("a value a voxel");
                for (value, &(y, fy)) in column.iter_mut().zip(&ys) {
                    *value = between(profile[y], profile[y + 1], fy);
                }
            }
        }
    }

    pub fn most(&self) -> i32 {
        self.0.most()
    }

    /// All values in a part lie in it, and those of finer levels: they are between those of a lattice that may reach beyond it.
    pub fn bounds(&self, part: &Part) -> Interval {
        let all = Interval { least: -self.most(), most: self.most() };
        let Some(more) = 1u32.checked_shl(Field::shift(part.level).max(3)) else { return all };
        let (from, to) = (part.from.map(|v: u32| v.wrapping_sub(more)), part.to.map(|v| v.wrapping_add(more)));
        let widest = (u32::MAX / 2).saturating_sub(more);
        if (0..3).any(|i| part.to[i].wrapping_sub(part.from[i]) > widest) {
            return all;
        }
        self.0.bounds(&Part { from, to, ..*part })
    }
}

/// Between two values, in 256ths of the way: products stay below 2³¹ for values up to 2²¹.
#[inline(always)]
fn between(a: i32, b: i32, t: i32) -> i32 {
    a + (((b - a) * (t >> 4)) >> 8)
}

/// Places of a box along an axis, in cells of one octave.
struct Axis {
    n: usize,
    fractions: [i32; Cells::MOST],
    fades: [i32; Cells::MOST],
    /// Where the places of each cell end, and the corners of the cells: there are 64 places in cells of four, or [`LATTICE`].
    ends: [u8; LATTICE],
    corners: [u32; LATTICE + 1],
    n_spans: usize,
}

impl Axis {
    #[inline(always)]
    fn new(n: u32, places: &dyn Fn(u32) -> u32, moved: u32, shift: u32) -> Axis {
        let n = n as usize;
        let none = [0; Cells::MOST];
        let (ends, corners) = ([0; LATTICE], [0; LATTICE + 1]);
        let mut all = Axis { n, fractions: none, fades: none, ends, corners, n_spans: 0 };
        for i in 0..n {
            let (at, fraction) = cell(places(i as u32).wrapping_add(moved), shift);
            if all.n_spans == 0 || all.corners[all.n_spans - 1] != at {
                all.corners[all.n_spans] = at;
                all.n_spans += 1;
            }
            all.ends[all.n_spans - 1] = (i + 1) as u8;
            all.fractions[i] = fraction;
            all.fades[i] = fade(fraction);
        }
        all.corners[all.n_spans] = after(all.corners[all.n_spans - 1], shift);
        all
    }
}

/// One octave over a box.
fn add(seed: u32, amplitude: i32, axes: &[Axis; 3], sums: &mut [i32]) {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2")]
        fn wide(seed: u32, amplitude: i32, axes: &[Axis; 3], sums: &mut [i32]) {
            add_here(seed, amplitude, axes, sums);
        }
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has been asked.
            return unsafe { wide(seed, amplitude, axes, sums) };
        }
    }
    add_here(seed, amplitude, axes, sums);
}

#[inline(always)]
fn add_here(seed: u32, amplitude: i32, [xs, ys, zs]: &[Axis; 3], sums: &mut [i32]) {
    const SIDE: usize = LATTICE + 1;
    let mut gradients = [[[0; 3]; 4]; SIDE];
    let mut ends = [[0; 2]; SIDE];
    for sz in 0..zs.n_spans {
        let z_places = if sz == 0 { 0 } else { zs.ends[sz - 1] as usize }..zs.ends[sz] as usize;
        for sx in 0..xs.n_spans {
            let x_places = if sx == 0 { 0 } else { xs.ends[sx - 1] as usize }..xs.ends[sx] as usize;
            for (g, &y) in gradients.iter_mut().zip(&ys.corners[..=ys.n_spans]) {
                let corner = |i: usize, k: usize| gradient(hash(seed, xs.corners[sx + i], y, zs.corners[sz + k]));
                *g = [corner(0, 0), corner(1, 0), corner(0, 1), corner(1, 1)];
            }
            for z in z_places.clone() {
                for x in x_places.clone() {
                    let (f, u) = ([xs.fractions[x], zs.fractions[z]], [xs.fades[x], zs.fades[z]]);
                    for (end, g) in ends.iter_mut().zip(&gradients[..=ys.n_spans]) {
                        *end = end3(g, f, u);
                    }
                    let sums = &mut sums[(z * xs.n + x) * ys.n..][..ys.n];
                    let mut from = 0;
                    for sy in 0..ys.n_spans {
                        let to = ys.ends[sy] as usize;
                        let places = ys.fractions[from..to].iter().zip(&ys.fades[from..to]);
                        for (sum, (&t, &fade)) in sums[from..to].iter_mut().zip(places) {
                            *sum += (along(ends[sy], ends[sy + 1], t, fade) * amplitude) >> 4;
                        }
                        from = to;
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn octaves_over_an_area_are_those_at_its_columns(x in any::<u32>(), z in any::<u32>(), level in 0u32..9, seed in any::<u32>()) {
            let octaves = Octaves::new(seed, 2, 9, 2, 1600, 120);
            let area = Area { level, from: [x >> 2 >> level, z >> 2 >> level], size: [37, 11] };
            let sums = octaves.over(&area);
            for (i, &sum) in sums.iter().enumerate() {
                let at = [area.middle(0, i as u32 % 37), area.middle(1, i as u32 / 37)];
                prop_assert_eq!(sum, octaves.at2(at, level));
            }
        }

        #[test]
        fn octaves_lie_in_their_bounds(
            from in any::<[u32; 3]>(), size in any::<[u16; 3]>(), by in 0u32..12, level in 0u32..6, seed in any::<u32>(),
            at in proptest::collection::vec(any::<[u16; 3]>(), 40),
        ) {
            let size = size.map(|s| u32::from(s) >> by);
            let part = Part { level, from, to: [0, 1, 2].map(|i| from[i].wrapping_add(size[i])) };
            prop_assume!((0..3).all(|i| part.to[i] >= part.from[i]));
            for dimensions in [2, 3] {
                let octaves = Octaves::new(seed, dimensions, 12, 2, 3000, 128);
                let Interval { least, most } = octaves.bounds(&part);
                prop_assert!(-octaves.most() <= least && most <= octaves.most());
                for at in &at {
                    let p = [0, 1, 2].map(|i| from[i] + u32::from(at[i]) % (size[i] + 1));
                    let v = if dimensions == 2 { octaves.at2([p[0], p[2]], level) } else { octaves.at3(p, level) };
                    prop_assert!((least..=most).contains(&v), "{v} in {least}..={most}, {dimensions} dimensions");
                    if dimensions == 3 {
                        let field = Field::new(octaves.clone());
                        let Interval { least, most } = field.bounds(&part);
                        prop_assert!((least..=most).contains(&field.at(p, level)));
                    }
                }
            }
        }
    }

    proptest! {
        #[test]
        fn octaves_over_a_box_are_those_at_its_voxels(from in any::<[u32; 3]>(), level in 0u32..7, seed in any::<u32>()) {
            let octaves = Octaves::new(seed, 3, 7, 2, 16 << 4, 150);
            let cells = Cells { level, from: from.map(|v| v >> 2 >> level), size: [7, 33, 5] };
            let mut sums = vec![3; 7 * 33 * 5];
            octaves.fill(&cells, &mut sums);
            for (i, &sum) in (0u32..).zip(&sums) {
                let [x, y, z] = [(i / 33) % 7, i % 33, i / 33 / 7];
                prop_assert_eq!(sum - 3, octaves.at3([cells.middle(0, x), cells.middle(1, y), cells.middle(2, z)], level));
            }
            let field = Field::new(octaves);
            field.fill(&cells, &mut sums);
            for (i, &sum) in (0u32..).zip(&sums) {
                let [x, y, z] = [(i / 33) % 7, i % 33, i / 33 / 7];
                prop_assert_eq!(sum, field.at([cells.middle(0, x), cells.middle(1, y), cells.middle(2, z)], level));
            }
        }
    }
}
