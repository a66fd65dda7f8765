//! The values of a volume in memory: worlds at other thresholds are made of them in a fraction of a second.
//!
//! Values are held as f32; `encode` compares them as they are stored. A value that no f32 tells from the threshold may fall on the
//! other side here.

use std::sync::Arc;

use rayon::prelude::*;

use crate::{Colors, Columns, Input, Result, Rgb, Run};

/// Values of a sample that says where colours end.
const SAMPLE: usize = 1 << 16;

/// Colours between the ends of a ramp.
const TINTS: usize = 256;

/// The colour of a share of the way from the threshold to the highest values, or of a label.
pub type Tint = Arc<dyn Fn(f64) -> Rgb + Send + Sync>;

/// How voxels of a [`Grid`] are coloured.
#[derive(Clone)]
pub enum Tints {
    None,
    /// By value: the share from the threshold, 0, to where few are beyond, 1.
    Share(Tint),
    /// By the value itself.
    Value(Tint),
}

/// A bit for each of up to 64 values, the first the lowest: whether it is at least that much.
fn at_least(values: &[f32], least: f32) -> u64 {
    // Bytes first, which compilers make of many values at a time; then the eight of a word side by side.
    let mut bytes = [0u8; 64];
    bytes.iter_mut().zip(values).for_each(|(byte, &v)| *byte = u8::from(v >= least));
    let word = |eight: &[u8]| u64::from_le_bytes(eight.try_into().expect("chunks of eight"));
    let packed = |eight: &[u8]| word(eight).wrapping_mul(0x0102_0408_1020_4080) >> 56;
    bytes.chunks_exact(8).enumerate().fold(0, |bits, (i, eight)| bits | packed(eight) << (8 * i))
}

/// Values in the order of the world: y fastest, then x, then z. NaN is air.
pub struct Grid {
    dims: [u32; 3],
    values: Vec<f32>,
    /// Some of them, ascending.
    sample: Vec<f32>,
    tints: Tints,
}

impl Grid {
    /// `values[(z · nx + x) · ny + y]`.
    pub fn new(dims: [u32; 3], values: Vec<f32>, tints: Tints) -> Grid {
        let [nx, ny, nz] = dims.map(|n| n as usize);
        assert_eq!(values.len(), nx * ny * nz, "a value a voxel");
        // In step with no row.
        let step = (values.len() / SAMPLE).max(1) | 1;
        let mut sample: Vec<f32> = values.iter().copied().step_by(step).filter(|v| v.is_finite()).collect();
        sample.sort_unstable_by(f32::total_cmp);
        Grid { dims, values, sample, tints }
    }

    pub fn dims(&self) -> [u32; 3] {
        self.dims
    }

    /// Least and greatest value of a sample.
    pub fn range(&self) -> Option<[f32; 2]> {
        Some([*self.sample.first()?, *self.sample.last()?])
    }

    /// Values of the sample in `n` equal parts of the range.
    pub fn histogram(&self, n: usize) -> Vec<u32> {
        let mut parts = vec![0; n];
        let Some([low, high]) = self.range().filter(|_| n > 0) else { return parts };
        let per = n as f32 / (high - low).max(f32::MIN_POSITIVE);
        self.sample.iter().for_each(|v| parts[(((v - low) * per) as usize).min(n - 1)] += 1);
        parts
    }

    /// The value of a voxel; None outside, and where there is none.
    pub fn at(&self, [x, y, z]: [u32; 3]) -> Option<f32> {
        let [nx, ny, nz] = self.dims;
        let inside = x < nx && y < ny && z < nz;
        let value = inside.then(|| self.values[(z as usize * nx as usize + x as usize) * ny as usize + y as usize])?;
        value.is_finite().then_some(value)
    }

    /// The same with half as many voxels along each axis: means of those that are there.
    pub fn halved(&self) -> Grid {
        let [nx, ny, nz] = self.dims;
        let dims = self.dims.map(|n| n.div_ceil(2));
        let column =
            |x: u32, z: u32| &self.values[(z as usize * nx as usize + x as usize) * ny as usize..][..ny as usize];
        let mut values = vec![0.0; dims.iter().map(|&n| n as usize).product()];
        values.par_chunks_mut(dims[1] as usize).enumerate().for_each(|(i, out)| {
            let (x, z) = (i as u32 % dims[0] * 2, i as u32 / dims[0] * 2);
            let (x1, z1) = ((x + 1).min(nx - 1), (z + 1).min(nz - 1));
            let four = [column(x, z), column(x1, z), column(x, z1), column(x1, z1)];
            for (y, out) in out.iter_mut().enumerate() {
                let (mut sum, mut n) = (0.0, 0.0);
                for column in four {
                    let pair = &column[2 * y..(2 * y + 2).min(column.len())];
                    for v in pair.iter().filter(|v| !v.is_nan()) {
                        (sum, n) = (sum + v, n + 1.0);
                    }
                }
                // 0 / 0 is NaN: none.
                *out = sum / n;
            }
        });
        Grid { dims, values, sample: self.sample.clone(), tints: self.tints.clone() }
    }

    /// What is solid at a threshold.
    pub fn columns(&self, least: f32) -> Columns {
        let [nx, ny, _] = self.dims;
        let columns = Columns::try_from_rows(self.dims, |z, out| -> Result<()> {
            let row = &self.values[z as usize * nx as usize * ny as usize..][..nx as usize * ny as usize];
            for column in row.chunks_exact(ny as usize) {
                let mut first = None;
                for (block, values) in column.chunks(64).enumerate() {
                    let bits = at_least(values, least);
                    // Where solid and air change, one after the other.
                    let mut changed = bits ^ (bits << 1 | u64::from(first.is_some()));
                    if values.len() < 64 {
                        changed &= (1 << values.len()) - 1;
                    }
                    while changed != 0 {
                        let y = (block * 64) as u32 + changed.trailing_zeros();
                        match first.take() {
                            None => first = Some(y as u16),
                            Some(from) => out.push_run(Run::new(from, (y - 1) as u16)),
                        }
                        changed &= changed - 1;
                    }
                }
                if let Some(from) = first {
                    out.push_run(Run::new(from, (ny - 1) as u16));
                }
                out.end_column();
            }
            Ok(())
        });
        columns.expect("no row fails")
    }

    /// The world at a threshold, coloured.
    pub fn input(self: &Arc<Grid>, least: f32) -> Input {
        let columns = self.columns(least);
        let grid = self.clone();
        let value = move |x, y, z| f64::from(grid.at([x, y, z]).unwrap_or(0.0));
        let colors = match &self.tints {
            Tints::None => Colors::None,
            Tints::Value(tint) => {
                let tint = tint.clone();
                Colors::Function(Box::new(move |x, y, z| tint(value(x, y, z))))
            }
            Tints::Share(tint) => {
                let shown = &self.sample[self.sample.partition_point(|&v| v < least)..];
                let most = shown.get(((shown.len().max(1) - 1) as f64 * 0.995) as usize).copied().unwrap_or(least);
                let table: Vec<Rgb> = (0..TINTS).map(|i| tint(i as f64 / (TINTS - 1) as f64)).collect();
                let (from, per) =
                    (f64::from(least), (TINTS - 1) as f64 / f64::from((most - least).max(f32::MIN_POSITIVE)));
                Colors::Function(Box::new(move |x, y, z| {
                    let at = ((value(x, y, z) - from) * per).clamp(0.0, (TINTS - 1) as f64);
                    table[at.round() as usize]
                }))
            }
        };
        Input { columns, colors, notes: Vec::new() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_grid_is_solid_where_its_values_are_at_least_the_threshold() {
        let [nx, ny, nz] = [5, 150, 3];
        let value = |x: u32, y: u32, z: u32| match (x, y) {
            (2, 9) => f32::NAN,
            _ => ((x * 7 + y * 13 + z * 29) % 101) as f32,
        };
        let each = || (0..nz).flat_map(|z| (0..nx).flat_map(move |x| (0..ny).map(move |y| (x, y, z))));
        let values = each().map(|(x, y, z)| value(x, y, z)).collect();
        let grid = Arc::new(Grid::new([nx, ny, nz], values, Tints::None));
        assert_eq!(grid.range(), Some([0.0, 100.0]));
        assert_eq!(grid.histogram(2).iter().sum::<u32>(), nx * ny * nz - 3);
        assert_eq!((grid.at([2, 9, 1]), grid.at([5, 0, 0]), grid.at([1, 2, 0])), (None, None, Some(33.0)));
        for least in [-1.0, 0.5, 50.0, 100.0, 101.0] {
            let columns = grid.input(least).columns;
            assert!(
                each().all(|(x, y, z)| columns.solid(x.into(), y.into(), z.into()) == (value(x, y, z) >= least)),
                "{least}"
            );
        }
    }

    #[test]
    fn a_grid_is_halved_by_means_of_what_is_there() {
        let mut values = vec![f32::NAN; 27];
        // (z · 3 + x) · 3 + y
        (values[0], values[1], values[3]) = (1.0, 3.0, 8.0);
        values[26] = 5.0;
        let half = Grid::new([3; 3], values, Tints::None).halved();
        assert_eq!(half.dims(), [2; 3]);
        assert_eq!((half.at([0, 0, 0]), half.at([1, 1, 1]), half.at([1, 0, 0])), (Some(4.0), Some(5.0), None));
    }

    #[test]
    fn a_grid_is_coloured_from_the_threshold_up() {
        let tint: Tint = Arc::new(|t| [(t * 255.0).round() as u8, 0, 0]);
        let grid = Arc::new(Grid::new([1, 11, 1], (0..11).map(|v| v as f32).collect(), Tints::Share(tint)));
        let Colors::Function(color) = grid.input(5.0).colors else { panic!("by value") };
        assert_eq!([color(0, 5, 0), color(0, 9, 0), color(0, 10, 0)].map(|c| c[0]), [0, 255, 255]);
        assert!((120..136).contains(&color(0, 7, 0)[0]), "{:?}", color(0, 7, 0));
    }
}
