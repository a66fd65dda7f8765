//! Scenes back to volumes.

use std::io::Write;
use std::path::Path;

use rayon::prelude::*;

use crate::format::write::write_atomic;
use crate::{Columns, Error, Result, Scene};

/// About as many bytes as a piece of the volume takes in memory.
const PIECE: u64 = 4 << 20;

/// Writes the occupancy of level 0 as bytes 0 and 1, x fastest, then y, then z: the inverse of encoding such a
/// volume. The file is written whole or not at all, and never held in memory.
pub fn decode_to_raw(scene: &Scene, path: &Path) -> Result<()> {
    let solid = &scene.levels[0].solid;
    let [nx, ny, nz] = solid.dims();
    let rows = (PIECE / u64::from(nx)).clamp(1, u64::from(ny)) as u32;
    let pieces = ny.div_ceil(rows);
    let total = u64::from(nz) * u64::from(pieces);
    write_atomic(path, |out| {
        for batch in (0..total).step_by(16) {
            let bytes: Vec<Vec<u8>> = (batch..total.min(batch + 16))
                .into_par_iter()
                .map(|i| {
                    let y = (i % u64::from(pieces)) as u32 * rows;
                    piece(solid, (i / u64::from(pieces)) as u32, y..ny.min(y + rows))
                })
                .collect();
            for bytes in bytes {
                out.write_all(&bytes).map_err(|e| Error::io(path, "write", e))?;
            }
        }
        Ok(())
    })
}

/// The voxels of rows `ys` of slice `z`.
fn piece(solid: &Columns, z: u32, ys: std::ops::Range<u32>) -> Vec<u8> {
    let nx = solid.nx() as usize;
    let mut bytes = vec![0; nx * ys.len()];
    for x in 0..solid.nx() {
        let column = solid.column(x, z);
        let first = column.partition_point(|r| r.end() <= ys.start);
        for run in column[first..].iter().take_while(|r| u32::from(r.first()) < ys.end) {
            for y in u32::from(run.first()).max(ys.start)..run.end().min(ys.end) {
                bytes[(y - ys.start) as usize * nx + x as usize] = 1;
            }
        }
    }
    bytes
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::{BuildOptions, build, testing};

    fn decoded(columns: Columns) -> Vec<u8> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.raw");
        decode_to_raw(&build(testing::input(columns, false), &BuildOptions::default()).unwrap(), &path).unwrap();
        std::fs::read(path).unwrap()
    }

    fn check(columns: Columns) {
        let [nx, ny, nz] = columns.dims();
        let bytes = decoded(columns.clone());
        assert_eq!(bytes.len(), nx as usize * ny as usize * nz as usize);
        let mut bytes = bytes.into_iter();
        for z in 0..nz {
            for y in 0..ny {
                for x in 0..nx {
                    assert_eq!(bytes.next(), Some(u8::from(columns.find(x, y, z).is_some())), "({x}, {y}, {z})");
                }
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        #[test]
        fn decode_writes_every_voxel(columns in testing::small_world()) {
            check(columns);
        }
    }

    #[test]
    fn decode_in_pieces_is_seamless() {
        // 97 rows a piece, 3 slices of 4 pieces.
        check(Columns::from_fn(43_000, 300, 3, |x, y, z| (x / 1000 + y / 7 + z) % 3 == 0));
    }
}
