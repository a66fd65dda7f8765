//! Heights of a map, kept in a file, so that no map need fit into memory: one without a name, or the input's own.

use rayon::prelude::*;

use super::volume::Data;
use crate::store::scratch::{self as file, File, read_at, write_at};
use crate::{Error, Result};

/// A grid of heights, NaN where there is no data.
pub(super) struct Heights {
    pub width: u32,
    pub height: u32,
    /// Columns, rows that are handed out from the last one on.
    pub flips: [bool; 2],
    store: Store,
    /// Least and greatest height; the least above the greatest where there is none.
    pub low: f64,
    pub high: f64,
    /// Heights that are finite.
    pub known: u64,
}

/// Where heights are.
enum Store {
    /// A file of f32 without a name.
    Scratch(File),
    /// 16-bit numbers, row by row, as the input holds them.
    Words { data: Data<'static>, words: Words },
}

/// How 16-bit numbers are stored.
#[derive(Clone, Copy)]
pub(super) struct Words {
    pub signed: bool,
    pub big_endian: bool,
}

impl Words {
    /// The number whose bits, in order, are those of `bits`.
    pub fn value(self, bits: u16) -> f32 {
        if self.signed { f32::from(bits as i16) } else { f32::from(bits) }
    }

    fn bits(self, bytes: [u8; 2]) -> u16 {
        if self.big_endian { u16::from_be_bytes(bytes) } else { u16::from_le_bytes(bytes) }
    }
}

/// Numbers that are looked at together.
const STRETCH: u64 = 1 << 19;

fn scratch(action: &'static str) -> impl Fn(std::io::Error) -> Error {
    move |e| Error::io(std::env::temp_dir(), action, e)
}

impl Heights {
    /// A grid without data.
    pub fn new(width: u32, height: u32) -> Result<Heights> {
        let file = file::file().map_err(scratch("create a file in"))?;
        let (low, high, known) = NOTHING;
        Ok(Heights { width, height, flips: [false; 2], store: Store::Scratch(file), low, high, known })
    }

    /// A grid whose values stay where they are: 16-bit numbers, row by row.
    pub fn of_words(width: u32, height: u32, data: Data<'static>, words: Words) -> Result<Heights> {
        let n = u64::from(width) * u64::from(height);
        let sign = if words.signed { 0x8000 } else { 0 };
        let ends = (0..n.div_ceil(STRETCH)).into_par_iter().map(|i| {
            let (from, mut buffer) = (i * STRETCH, Vec::new());
            let bytes = data.read(2 * from, 2 * STRETCH.min(n - from) as usize, &mut buffer)?;
            // With the sign turned over, numbers with one are in the order of those without.
            let ends = |(low, high): (u16, u16), &b: &[u8; 2]| {
                let order = words.bits(b) ^ sign;
                (low.min(order), high.max(order))
            };
            Ok(bytes.as_chunks().0.iter().fold((u16::MAX, 0), ends))
        });
        let (low, high) = ends.try_reduce(|| (u16::MAX, 0), |a, b| Ok((a.0.min(b.0), a.1.max(b.1))))?;
        let [low, high] = [low, high].map(|order| words.value(order ^ sign).into());
        Ok(Heights { width, height, flips: [false; 2], store: Store::Words { data, words }, low, high, known: n })
    }

    /// How the numbers are stored, where [`Heights::words_of`] gives them.
    pub fn words(&self) -> Option<Words> {
        match &self.store {
            Store::Words { words, .. } => Some(*words),
            Store::Scratch(_) => None,
        }
    }

    /// The bits of values `x .. x + out.len()` of row `z`; of grids that have [`Heights::words`] alone.
    pub fn words_of(&self, x: u32, z: u32, out: &mut [u16]) -> Result<()> {
        let Store::Words { data, words } = &self.store else { unreachable!("heights that are no 16-bit numbers") };
        let [columns, rows] = self.flips;
        let x = if columns { self.width - x - out.len() as u32 } else { x };
        let z = if rows { self.height - 1 - z } else { z };
        data.read_into(self.at(x, z) / 2, bytemuck::cast_slice_mut(out))?;
        if words.big_endian != cfg!(target_endian = "big") {
            out.iter_mut().for_each(|bits| *bits = bits.swap_bytes());
        }
        if columns {
            out.reverse();
        }
        Ok(())
    }

    /// Copies values that the input holds, so that they can be changed.
    fn own(&mut self) -> Result<()> {
        if self.words().is_some() {
            let flips = std::mem::take(&mut self.flips);
            let own = Heights::new(self.width, self.height)?;
            let mut row = vec![0.0; self.width as usize];
            for z in 0..self.height {
                self.row(0, z, &mut row)?;
                own.write(0, z, &row)?;
            }
            (self.store, self.flips) = (own.store, flips);
        }
        Ok(())
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
        let Store::Scratch(file) = &self.store else { unreachable!("an input is not written to") };
        write_at(file, bytemuck::cast_slice(values), self.at(x, z)).map_err(scratch("write a file in"))
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
        let file = match &self.store {
            Store::Scratch(file) => file,
            Store::Words { words, .. } => {
                let mut bits = vec![0; out.len()];
                self.words_of(x, z, &mut bits)?;
                out.iter_mut().zip(bits).for_each(|(v, bits)| *v = words.value(bits));
                return Ok(());
            }
        };
        let [columns, rows] = self.flips;
        let x = if columns { self.width - x - out.len() as u32 } else { x };
        let z = if rows { self.height - 1 - z } else { z };
        read_at(file, bytemuck::cast_slice_mut(out), self.at(x, z)).map_err(scratch("read a file in"))?;
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
        self.own()?;
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
