//! Heights of a map, kept in a file without a name, so that no map need fit into memory.

use rayon::prelude::*;

use crate::store::scratch::{self as file, File, read_at, write_at};
use crate::{Error, Result};

/// A grid of heights, NaN where there is no data.
pub(super) struct Heights {
    pub width: u32,
    pub height: u32,
    /// Columns, rows that are handed out from the last one on.
    pub flips: [bool; 2],
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
        Ok(Heights { width, height, flips: [false; 2], file, low: f64::INFINITY, high: f64::NEG_INFINITY, known: 0 })
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

    /// Overwrites values of row `z` as it is stored; [`Heights::recount`] is due then.
    pub fn write(&self, x: u32, z: u32, values: &[f32]) -> Result<()> {
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
        let [columns, rows] = self.flips;
        let x = if columns { self.width - x - out.len() as u32 } else { x };
        let z = if rows { self.height - 1 - z } else { z };
        read_at(&self.file, bytemuck::cast_slice_mut(out), self.at(x, z)).map_err(scratch("read a file in"))?;
        if columns {
            out.reverse();
        }
        Ok(())
    }

    /// Finds least and greatest height again.
    pub fn recount(&mut self) -> Result<()> {
        self.each_row(|_| false)
    }

    /// Takes all heights of this value for no data.
    pub fn drop(&mut self, value: f64) -> Result<()> {
        self.each_row(|v| f64::from(v) == value || v == value as f32)
    }

    fn each_row(&mut self, none: impl Fn(f32) -> bool) -> Result<()> {
        let (flips, mut row) = (std::mem::take(&mut self.flips), vec![0.0; self.width as usize]);
        (self.low, self.high, self.known) = NOTHING;
        for z in 0..self.height {
            self.row(0, z, &mut row)?;
            let mut changed = false;
            for v in row.iter_mut().filter(|v| none(**v)) {
                (*v, changed) = (f32::NAN, true);
            }
            if changed {
                self.write(0, z, &row)?;
            }
            for v in row.iter().copied().filter(|v| v.is_finite()).map(f64::from) {
                (self.low, self.high, self.known) = (self.low.min(v), self.high.max(v), self.known + 1);
            }
        }
        self.flips = flips;
        Ok(())
    }
}

const NOTHING: (f64, f64, u64) = (f64::INFINITY, f64::NEG_INFINITY, 0);
