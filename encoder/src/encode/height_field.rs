//! Columns that are solid from 0 up: a number each, where run lists would take ten times as long.

use std::ops::Range;

use crate::{Columns, MipRule};

/// How many voxels of each column are solid, row by row.
pub(crate) struct HeightField {
    pub width: usize,
    pub heights: Vec<u16>,
}

impl HeightField {
    /// Of columns that are solid from 0 up, less than 65,536 high.
    pub fn of(solid: &Columns) -> HeightField {
        let height = |ix: usize| solid.runs()[solid.range(ix)].first().map_or(0, |run| run.end() as u16);
        let heights = (0..solid.offsets().len() - 1).map(height).collect();
        HeightField { width: solid.nx() as usize, heights }
    }

    pub fn bytes(&self) -> u64 {
        2 * self.heights.len() as u64
    }

    /// The columns `xs × zs`, those outside a world of `size` empty. `from(x, z)` gives heights of row `z` from column `x` on, as
    /// far as they stand side by side.
    pub fn gather<'a>(
        xs: Range<i64>,
        zs: Range<i64>,
        size: [u32; 2],
        from: impl Fn(u32, u32) -> &'a [u16],
    ) -> HeightField {
        let width = (xs.end - xs.start) as usize;
        let mut heights = vec![0; width * (zs.end - zs.start) as usize];
        for (row, z) in heights.chunks_mut(width).zip(zs) {
            if !(0..i64::from(size[1])).contains(&z) {
                continue;
            }
            let (mut x, end) = (xs.start.max(0), xs.end.min(size[0].into()));
            while x < end {
                let found = from(x as u32, z as u32);
                let n = found.len().min((end - x) as usize);
                row[(x - xs.start) as usize..][..n].copy_from_slice(&found[..n]);
                x += n as i64;
            }
        }
        HeightField { width, heights }
    }

    /// All but one column on each side, and how many of their voxels are exposed.
    pub fn inner(&self) -> (HeightField, u64) {
        let width = self.width - 2;
        let depth = self.heights.len() / self.width - 2;
        let mut heights = Vec::with_capacity(width * depth);
        let mut n_exposed = 0;
        let row = |z: usize| &self.heights[z * self.width..(z + 1) * self.width];
        for z in 1..=depth {
            let (north, own, south) = (&row(z - 1)[1..=width], row(z), &row(z + 1)[1..=width]);
            heights.extend_from_slice(&own[1..=width]);
            let (west, east) = (&own[..width], &own[2..]);
            let around = north.iter().zip(south).zip(west.iter().zip(east));
            // What is hidden is neither lowest nor highest voxel, and lower than all four neighbours are high.
            let exposed = own[1..=width].iter().zip(around).map(|(&h, ((&n, &s), (&w, &e)))| {
                let lowest = h.saturating_sub(1).min(n.min(s)).min(w.min(e));
                u32::from(h - lowest.saturating_sub(1))
            });
            n_exposed += u64::from(exposed.sum::<u32>());
        }
        (HeightField { width, heights }, n_exposed)
    }

    /// The level above; both sides are even.
    pub fn next(&self, rule: MipRule) -> HeightField {
        let width = self.width / 2;
        let mut heights = Vec::with_capacity(self.heights.len() / 4);
        for rows in self.heights.chunks_exact(2 * self.width) {
            let (a, b) = rows.split_at(self.width);
            let children = a.as_chunks::<2>().0.iter().zip(b.as_chunks::<2>().0);
            match rule {
                MipRule::Any => heights.extend(children.map(|(a, b)| a[0].max(a[1]).max(b[0].max(b[1])).div_ceil(2))),
                MipRule::Majority => heights.extend(children.map(|(a, b)| majority([a[0], a[1], b[0], b[1]]))),
            }
        }
        HeightField { width, heights }
    }
}

/// Up to where at least four of eight children are solid.
fn majority(mut children: [u16; 4]) -> u16 {
    children.sort_unstable();
    let [d, c, b, a] = children;
    // Up to half the second highest the two highest do alone. A voxel on its upper half may be one of four at one height.
    b / 2 + u16::from(b % 2 == 1 && c == b && (a > b || d == b))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::encode::mips;
    use crate::model::exposure;
    use crate::{ColumnsBuilder, Run};

    fn columns(width: u32, heights: &[u16]) -> Columns {
        let mut out = ColumnsBuilder::new(width, 70, heights.len() as u32 / width);
        for &h in heights {
            if h > 0 {
                out.push_run(Run::new(0, h - 1));
            }
            out.end_column();
        }
        out.finish()
    }

    proptest! {
        #[test]
        fn height_fields_are_what_their_runs_are(
            width in 1u32..9,
            heights in proptest::collection::vec(prop_oneof![0u16..4, 0u16..70], 9..80),
        ) {
            let depth = heights.len() as u32 / width;
            let heights = &heights[..(width * depth) as usize];
            let solid = columns(width, heights);
            prop_assert_eq!(&HeightField::of(&solid).heights, heights);
            let from = |x: u32, z: u32| &heights[(z * width + x) as usize..(z * width + (x / 3 * 3 + 3).min(width)) as usize];
            let [w, d] = [width, depth].map(i64::from);
            let (inner, n_exposed) = HeightField::gather(-1..w + 1, -1..d + 1, [width, depth], from).inner();
            prop_assert_eq!(&inner.heights, heights);
            prop_assert_eq!(n_exposed, exposure::exposed(&solid).voxels());
            for rule in [MipRule::Any, MipRule::Majority] {
                let (even_w, even_d) = (w + w % 2, d + d % 2);
                let coarse = HeightField::gather(0..even_w, 0..even_d, [width, depth], from).next(rule);
                let expected = mips::next(&solid, rule);
                prop_assert_eq!(coarse.width as u32, expected.nx());
                let runs = |ix: usize| expected.runs()[expected.range(ix)].to_vec();
                for (ix, &h) in coarse.heights.iter().enumerate() {
                    prop_assert_eq!(runs(ix), if h > 0 { vec![Run::new(0, h - 1)] } else { vec![] });
                }
            }
        }
    }
}
