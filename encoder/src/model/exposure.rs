//! Which voxels show a face.

use rayon::prelude::*;

use crate::{Columns, ColumnsBuilder, Run};

/// The voxels of `solid` with an exposed face: one of the six neighbours is air or lies outside the world.
///
/// Works on whole runs: a voxel is hidden where it is no end of its run and lies in a run of each of the four
/// neighbour columns.
pub fn exposed(solid: &Columns) -> Columns {
    let [nx, ny, nz] = solid.dims();
    Columns::from_rows(nx, ny, nz, |z, out| expose_row(solid, z, out))
}

/// The same by this thread alone, for who has other threads busy.
pub(crate) fn exposed_by_one(solid: &Columns) -> Columns {
    let [nx, ny, nz] = solid.dims();
    let mut out = ColumnsBuilder::new(nx, ny, nz);
    (0..nz).for_each(|z| expose_row(solid, z, &mut out));
    out.finish()
}

/// The first column whose runs in `exposed` are not just its voxels with an exposed face.
pub fn find_wrong(solid: &Columns, exposed: &Columns) -> Option<[u32; 2]> {
    let [nx, ny, nz] = solid.dims();
    (0..nz).into_par_iter().find_map_first(|z| {
        let mut row = ColumnsBuilder::new(nx, ny, 1);
        expose_row(solid, z, &mut row);
        let row = row.finish();
        (0..nx).find(|&x| row.column(x, 0) != exposed.column(x, z)).map(|x| [x, z])
    })
}

fn expose_row(solid: &Columns, z: u32, out: &mut ColumnsBuilder) {
    let [nx, _, nz] = solid.dims();
    for x in 0..nx {
        let column = solid.column(x, z);
        if x == 0 || z == 0 || x == nx - 1 || z == nz - 1 {
            column.iter().for_each(|&run| out.push_run(run));
        } else {
            let neighbours = [(x - 1, z), (x + 1, z), (x, z - 1), (x, z + 1)].map(|(x, z)| solid.column(x, z));
            expose(column, neighbours, out);
        }
        out.end_column();
    }
}

fn expose(column: &[Run], mut neighbours: [&[Run]; 4], out: &mut ColumnsBuilder) {
    for run in column {
        let last = run.last();
        // Everything in `from..y` is exposed.
        let mut from = run.first();
        let mut y = u32::from(from) + 1;
        'run: while y < u32::from(last) {
            let mut low = 0;
            let mut high = last - 1;
            for neighbour in &mut neighbours {
                while neighbour.first().is_some_and(|r| r.end() <= y) {
                    *neighbour = &neighbour[1..];
                }
                let Some(r) = neighbour.first() else { break 'run };
                low = low.max(r.first());
                high = high.min(r.last());
            }
            if u32::from(low) > y {
                y = u32::from(low);
            } else {
                out.push_run(Run::new(from, (y - 1) as u16));
                // Some neighbour ends at `high`, or this run does above it: the next voxel is exposed.
                from = high + 1;
                y = u32::from(from) + 1;
            }
        }
        out.push_run(Run::new(from, last));
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::testing;

    fn voxel_by_voxel(solid: &Columns) -> Columns {
        let [nx, ny, nz] = solid.dims();
        Columns::from_fn(nx, ny, nz, |x, y, z| {
            let at = |dx: i64, dy: i64, dz: i64| solid.solid(i64::from(x) + dx, i64::from(y) + dy, i64::from(z) + dz);
            at(0, 0, 0) && !(at(-1, 0, 0) && at(1, 0, 0) && at(0, -1, 0) && at(0, 1, 0) && at(0, 0, -1) && at(0, 0, 1))
        })
    }

    proptest! {
        #[test]
        fn exposure_of_runs_equals_exposure_of_voxels(solid in testing::small_world()) {
            prop_assert_eq!(exposed(&solid), voxel_by_voxel(&solid));
        }

        #[test]
        fn exposure_of_tall_runs_equals_exposure_of_voxels(solid in testing::tall_world(2000)) {
            prop_assert_eq!(exposed(&solid), voxel_by_voxel(&solid));
        }
    }

    #[test]
    fn exposure_of_a_full_world_is_its_shell() {
        let solid = Columns::from_fn(5, 65_536, 4, |_, _, _| true);
        assert_eq!(exposed(&solid).voxels(), 5 * 65_536 * 4 - 3 * 65_534 * 2);
        assert_eq!(exposed(&solid).column(2, 1), [Run::new(0, 0), Run::new(65_535, 65_535)]);
    }
}
