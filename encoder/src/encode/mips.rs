//! The next coarser level: occupancy and colours.

use crate::model::srgb::Mean;
use crate::{Columns, ColumnsBuilder, MipRule, Rgb, Run, parallel};

/// The level above one with dimensions `dims`: each halved, rounded up.
pub fn next_dims(dims: [u32; 3]) -> [u32; 3] {
    dims.map(|n| n.div_ceil(2))
}

/// Number of levels of a world: the last is the first that is a single column.
pub fn n_levels(dims: [u32; 3]) -> u32 {
    let widest = dims[0].max(dims[2]);
    1 + (u32::BITS - widest.saturating_sub(1).leading_zeros())
}

/// The occupancy of the level above `fine`.
pub fn next(fine: &Columns, rule: MipRule) -> Columns {
    let [nx, ny, nz] = next_dims(fine.dims());
    Columns::from_rows(nx, ny, nz, |z, out| {
        let mut changes = Vec::new();
        for x in 0..nx {
            match rule {
                MipRule::Any => union(children(fine, x, z), out),
                MipRule::Majority => majority(children(fine, x, z), &mut changes, out),
            }
            out.end_column();
        }
    })
}

/// The up to four columns of `fine` under column `(x, z)` of the level above, empty ones outside the world.
fn children(fine: &Columns, x: u32, z: u32) -> [&[Run]; 4] {
    child_columns(fine, x, z).map(|ix| ix.map_or(&[][..], |ix| &fine.runs()[fine.range(ix)]))
}

fn child_columns(fine: &Columns, x: u32, z: u32) -> [Option<usize>; 4] {
    [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dz)| {
        let (x, z) = (2 * x + dx, 2 * z + dz);
        (x < fine.nx() && z < fine.nz()).then(|| fine.index(x, z))
    })
}

fn union(mut children: [&[Run]; 4], out: &mut ColumnsBuilder) {
    while let Some(lowest) = children.iter_mut().filter(|c| !c.is_empty()).min_by_key(|c| c[0].first()) {
        let run = lowest[0];
        *lowest = &lowest[1..];
        out.push_run(Run::new(run.first() / 2, run.last() / 2));
    }
}

/// `changes` is scratch: where the number of solid children changes, and by how much.
fn majority(children: [&[Run]; 4], changes: &mut Vec<(u32, i32)>, out: &mut ColumnsBuilder) {
    changes.clear();
    // A run's end at an odd height splits the pair of children that it lies in.
    let mut change = |y: u32, sign: i32| {
        let odd = (y & 1) as i32;
        changes.push((y / 2, sign * (2 - odd)));
        if odd == 1 {
            changes.push((y / 2 + 1, sign));
        }
    };
    for run in children.into_iter().flatten() {
        change(u32::from(run.first()), 1);
        change(run.end(), -1);
    }
    changes.sort_unstable_by_key(|&(y, _)| y);
    let mut n_solid = 0;
    let mut first = None;
    for at in changes.chunk_by(|a, b| a.0 == b.0) {
        let y = at[0].0;
        n_solid += at.iter().map(|c| c.1).sum::<i32>();
        match first {
            None if n_solid >= 4 => first = Some(y),
            Some(start) if n_solid < 4 => {
                out.push_run(Run::new(start as u16, (y - 1) as u16));
                first = None;
            }
            _ => {}
        }
    }
}

/// Colours of the exposed voxels of a level, from those of the finer one: the mean in linear light of the exposed
/// ones among a voxel's eight children; where there is none, the colour nearest in height (the upper one of two
/// equally near) in the columns under it.
///
/// `coarse` and `fine` are the exposed voxels of the two levels; colours come and go in their order.
pub fn next_colors(coarse: &Columns, fine: &Columns, fine_colors: &[Rgb]) -> Vec<Rgb> {
    let first_color = fine.voxel_offsets();
    rows(coarse, |x, z, colors| {
        let mut cursors = child_columns(fine, x, z).map(|ix| match ix {
            Some(ix) => Cursor { runs: &fine.runs()[fine.range(ix)], next: 0, color: first_color[ix] as usize },
            None => Cursor { runs: &[], next: 0, color: 0 },
        });
        for run in coarse.column(x, z) {
            for y in u32::from(run.first())..run.end() {
                let mut mean = Mean::default();
                for cursor in &mut cursors {
                    cursor.advance(2 * y);
                    fine_colors[cursor.pair(2 * y)].iter().for_each(|&c| mean.add(c));
                }
                let color = mean.get().unwrap_or_else(|| {
                    let nearest = cursors.iter().filter_map(|c| c.nearest(2 * y)).min_by_key(|n| n.0);
                    fine_colors[nearest.expect("a solid voxel has a child column with an exposed voxel").1]
                });
                colors.push(color);
            }
        }
    })
}

/// One colour a run of `geometry`: the mean in linear light of the exposed voxels in it.
pub fn run_colors(geometry: &Columns, exposed: &Columns, colors: &[Rgb]) -> Vec<Rgb> {
    let first_color = exposed.voxel_offsets();
    rows(geometry, |x, z, out| {
        let mut shown = exposed.column(x, z).iter().peekable();
        let mut at = first_color[exposed.index(x, z)] as usize;
        for run in geometry.column(x, z) {
            let mut mean = Mean::default();
            while let Some(r) = shown.next_if(|r| r.last() <= run.last()) {
                let len = r.len() as usize;
                colors[at..at + len].iter().for_each(|&c| mean.add(c));
                at += len;
            }
            out.push(mean.get().expect("the ends of a run are exposed"));
        }
    })
}

/// Colours made column by column, in parallel by rows.
pub(crate) fn rows(columns: &Columns, column: impl Fn(u32, u32, &mut Vec<Rgb>) + Sync) -> Vec<Rgb> {
    let rows: Vec<Vec<Rgb>> = parallel::map(columns.nz() as usize, |z| {
        let mut colors = Vec::new();
        (0..columns.nx()).for_each(|x| column(x, z as u32, &mut colors));
        colors
    });
    rows.concat()
}

/// A walk up a column of exposed runs.
struct Cursor<'a> {
    runs: &'a [Run],
    next: usize,
    /// Position of the colour of `runs[next]`'s first voxel.
    color: usize,
}

impl Cursor<'_> {
    /// Skips the runs that end below `y`.
    fn advance(&mut self, y: u32) {
        while let Some(run) = self.runs.get(self.next).filter(|r| r.end() <= y) {
            self.color += run.len() as usize;
            self.next += 1;
        }
    }

    /// Positions of the colours of the voxels `y` and `y + 1`. Both are in the next run if exposed at all: runs do
    /// not touch.
    fn pair(&self, y: u32) -> std::ops::Range<usize> {
        let Some(run) = self.runs.get(self.next) else { return 0..0 };
        let first = u32::from(run.first());
        let (low, high) = (first.max(y), run.end().min(y + 2));
        if low >= high { 0..0 } else { self.color + (low - first) as usize..self.color + (high - first) as usize }
    }

    /// Distance from the pair `y`, `y + 1` to the nearest exposed voxel, and the position of its colour.
    fn nearest(&self, y: u32) -> Option<(u32, usize)> {
        let above = self.runs.get(self.next).map(|r| (u32::from(r.first()).saturating_sub(y + 1), self.color));
        let below = self.next.checked_sub(1).map(|i| (y - u32::from(self.runs[i].last()), self.color - 1));
        [above, below].into_iter().flatten().min_by_key(|n| n.0)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::model::exposure::exposed;
    use crate::testing::{self, color_of, voxel_positions};

    fn solid_children(fine: &Columns, x: u32, y: u32, z: u32) -> usize {
        let at = |i: i64| (2 * i64::from(x) + (i & 1), 2 * i64::from(y) + (i >> 1 & 1), 2 * i64::from(z) + (i >> 2));
        (0..8).map(at).filter(|&(x, y, z)| fine.solid(x, y, z)).count()
    }

    fn voxel_by_voxel(fine: &Columns, least: usize) -> Columns {
        let [nx, ny, nz] = next_dims(fine.dims());
        Columns::from_fn(nx, ny, nz, |x, y, z| solid_children(fine, x, y, z) >= least)
    }

    proptest! {
        #[test]
        fn mips_of_runs_equal_mips_of_voxels(fine in testing::small_world()) {
            prop_assert_eq!(next(&fine, MipRule::Any), voxel_by_voxel(&fine, 1));
            prop_assert_eq!(next(&fine, MipRule::Majority), voxel_by_voxel(&fine, 4));
        }

        #[test]
        fn mips_of_tall_runs_equal_mips_of_voxels(fine in testing::tall_world(3001)) {
            prop_assert_eq!(next(&fine, MipRule::Any), voxel_by_voxel(&fine, 1));
            prop_assert_eq!(next(&fine, MipRule::Majority), voxel_by_voxel(&fine, 4));
        }

        #[test]
        fn mips_colors_are_means_of_children_or_nearest(fine in testing::small_world(), thick in any::<bool>()) {
            let coarse = exposed(&next(&fine, if thick { MipRule::Any } else { MipRule::Majority }));
            let fine = exposed(&fine);
            let colors: Vec<Rgb> = rows(&fine, |x, z, out| {
                out.extend(fine.column(x, z).iter().flat_map(|r| u32::from(r.first())..r.end()).map(|y| color_of(x, y, z)));
            });
            let next = next_colors(&coarse, &fine, &colors);
            let fine = voxel_positions(&fine);
            for ((x, y, z), position) in voxel_positions(&coarse) {
                let under = |p: &(u32, u32, u32)| p.0 / 2 == x && p.2 / 2 == z;
                let mut mean = Mean::default();
                for (p, &i) in fine.iter().filter(|(p, _)| under(p) && p.1 / 2 == y) {
                    prop_assert_eq!(color_of(p.0, p.1, p.2), colors[i]);
                    mean.add(colors[i]);
                }
                match mean.get() {
                    Some(mean) => prop_assert_eq!(next[position], mean),
                    None => {
                        let distance = |p: &(u32, u32, u32)| (2 * y).saturating_sub(p.1).max(p.1.saturating_sub(2 * y + 1));
                        let least = fine.keys().filter(|p| under(p)).map(distance).min().unwrap();
                        let near = fine.keys().filter(|p| under(p) && distance(p) == least);
                        prop_assert!(near.into_iter().any(|p| color_of(p.0, p.1, p.2) == next[position]));
                    }
                }
            }
        }
    }

    #[test]
    fn mips_of_a_full_tall_column_stay_full() {
        let fine = Columns::from_fn(2, 65_536, 2, |_, _, _| true);
        for rule in [MipRule::Any, MipRule::Majority] {
            assert_eq!(next(&fine, rule).column(0, 0), [Run::new(0, 32_767)]);
        }
    }

    #[test]
    fn mips_end_with_one_column() {
        for (dims, n) in [([1, 9, 1], 1), ([2, 1, 1], 2), ([5, 1, 3], 4), ([1024, 256, 1024], 11), ([1, 7, 1025], 12)] {
            let mut at = dims;
            (1..n).for_each(|_| at = next_dims(at));
            assert_eq!(n_levels(dims), n);
            assert_eq!((at[0], at[2]), (1, 1));
        }
    }

    #[test]
    fn mips_color_of_a_buried_child_is_the_nearest_above() {
        // Voxel 3 of the coarse column shows (say, beside air), its children 6 and 7 do not.
        let column = |runs: &[(u16, u16)], ny| {
            let mut out = ColumnsBuilder::new(1, ny, 1);
            runs.iter().for_each(|&(a, b)| out.push_run(Run::new(a, b)));
            out.end_column();
            out.finish()
        };
        let fine = column(&[(0, 2), (10, 11)], 12);
        let colors = [[0; 3], [1; 3], [2; 3], [10; 3], [11; 3]];
        assert_eq!(next_colors(&column(&[(3, 3)], 6), &fine, &colors), [[10; 3]]);
        assert_eq!(next_colors(&column(&[(2, 2)], 6), &fine, &colors), [[2; 3]]);
    }
}
