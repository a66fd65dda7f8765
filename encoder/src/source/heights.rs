//! Heights of a map, kept in a file without a name, so that no map need fit into memory.

use rayon::prelude::*;

use crate::scratch::{self as file, File, read_at, write_at};
use crate::{Error, Result};

/// A grid of heights, NaN where there is no data.
pub(super) struct Heights {
    pub width: u32,
    pub height: u32,
    file: File,
    /// Least and greatest height; the least above the greatest where there is none.
    pub low: f64,
    pub high: f64,
    /// Heights that are finite.
    pub known: u64,
}

fn scratch(action: &'static str) -> impl Fn(std::io::Error) -> Error {
    move |e| Error::io(std::env::temp_dir(), action, e)
}

impl Heights {
    /// A grid without data.
    pub fn new(width: u32, height: u32) -> Result<Heights> {
        let file = file::file().map_err(scratch("create a file in"))?;
        Ok(Heights { width, height, file, low: f64::INFINITY, high: f64::NEG_INFINITY, known: 0 })
    }

    /// A grid from all its values.
    pub fn of(width: u32, height: u32, values: &[f32]) -> Result<Heights> {
        let mut out = Heights::new(width, height)?;
        out.put(0, 0, width, values)?;
        Ok(out)
    }

    fn at(&self, x: u32, z: u32) -> u64 {
        4 * (u64::from(z) * u64::from(self.width) + u64::from(x))
    }

    /// Marks everything as without data: needed where not every value is put.
    pub fn clear(&mut self) -> Result<()> {
        let nothing = vec![f32::NAN; self.width as usize];
        (0..self.height).try_for_each(|z| self.write(0, z, &nothing))
    }

    fn write(&self, x: u32, z: u32, values: &[f32]) -> Result<()> {
        write_at(&self.file, bytemuck::cast_slice(values), self.at(x, z)).map_err(scratch("write a file in"))
    }

    /// Puts rows of `stride` values from `(x, z)` on; what lies outside the grid is left away.
    pub fn put(&mut self, x: u32, z: u32, stride: u32, values: &[f32]) -> Result<()> {
        let wide = stride.min(self.width - x) as usize;
        for (i, row) in values.chunks(stride as usize).take((self.height - z) as usize).enumerate() {
            let row = &row[..wide.min(row.len())];
            self.write(x, z + i as u32, row)?;
        }
        let rows = values.par_chunks(stride as usize).take((self.height - z) as usize);
        let (low, high, known) = rows
            .map(|row| {
                let finite = row[..wide.min(row.len())].iter().copied().filter(|v| v.is_finite()).map(f64::from);
                finite.fold(NOTHING, |(low, high, n), v| (low.min(v), high.max(v), n + 1))
            })
            .reduce(|| NOTHING, |a, b| (a.0.min(b.0), a.1.max(b.1), a.2 + b.2));
        (self.low, self.high, self.known) = (self.low.min(low), self.high.max(high), self.known + known);
        Ok(())
    }

    /// Values `x .. x + out.len()` of row `z`.
    pub fn row(&self, x: u32, z: u32, out: &mut [f32]) -> Result<()> {
        read_at(&self.file, bytemuck::cast_slice_mut(out), self.at(x, z)).map_err(scratch("read a file in"))
    }
}

const NOTHING: (f64, f64, u64) = (f64::INFINITY, f64::NEG_INFINITY, 0);
