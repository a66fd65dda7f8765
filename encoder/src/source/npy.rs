//! NumPy arrays: volumes of three axes, shape (z, y, x), and height maps of two.

use std::path::Path;

use rayon::prelude::*;

use super::heights::Heights;
use super::volume::{Data, Sample, Stored, Volume, byte_len, with_sample};
use super::{Dtype, ReadOptions, world_dims};
use crate::{Error, Result};

/// NumPy: an array of shape (z, y, x).
pub(super) fn npy<'a>(path: &Path, bytes: &'a [u8], opts: &ReadOptions) -> Result<Volume<'a>> {
    Volume::new(path, npy_array(path, bytes)?.1, opts)
}

/// A NumPy array of two axes as heights, shape (row, column); None where it has three.
pub(super) fn npy_heights(path: &Path, bytes: &[u8], in_file: bool) -> Result<Option<Heights>> {
    let (2, stored) = npy_array(path, bytes)? else { return Ok(None) };
    let Stored { dims: [width, height, _], dtype, big_endian, z_fastest, data, .. } = stored;
    // Columns of an array that is stored by columns are gathered from all over it.
    let data = if in_file && !z_fastest { data.in_file(path, bytes)? } else { data };
    world_dims(path, [width, 1, height], "")?;
    let mut out = Heights::new(width as u32, height as u32)?;
    let n = width as usize;
    with_sample!(dtype, big_endian, |read| {
        let size = dtype.size() as usize;
        let mut buffer = Vec::new();
        // Some rows at a time, so that a large map is not in memory twice.
        for z in (0..height as usize).step_by(64) {
            let end = (z + 64).min(height as usize);
            let from = if z_fastest { 0 } else { z };
            let len = if z_fastest { data.len() as usize } else { (end - z) * n * size };
            let bytes = data.read((from * n * size) as u64, len, &mut buffer)?;
            let value = |x: usize, z: usize| {
                let at = size * if z_fastest { x * height as usize + z } else { (z - from) * n + x };
                read(bytes[at..at + size].try_into().expect("as long as a value")).to_f64() as f32
            };
            let rows: Vec<f32> = (z * n..end * n).into_par_iter().map(|i| value(i % n, i / n)).collect();
            out.put(0, z as u32, width as u32, &rows)?;
        }
    });
    Ok(Some(out))
}

/// Number of axes, and the values, with one z where there are two.
pub(super) fn npy_array<'a>(path: &Path, bytes: &'a [u8]) -> Result<(usize, Stored<'a>)> {
    let fail = |at: usize, what: &str| Err(Error::format(path, format!("byte {at}: {what}")));
    if !bytes.starts_with(b"\x93NUMPY") {
        return fail(0, "expected the NPY signature \\x93NUMPY");
    }
    let (text_at, text_len) = match (bytes.get(6), bytes.get(8..12)) {
        (Some(1), Some(n)) => (10, u16::from_le_bytes([n[0], n[1]]) as usize),
        (Some(2 | 3), Some(n)) => (12, u32::from_le_bytes([n[0], n[1], n[2], n[3]]) as usize),
        (Some(_), Some(_)) => return fail(6, "NPY version is not 1, 2 or 3"),
        _ => return fail(bytes.len(), "the file ends inside the NPY header"),
    };
    let data_at = text_at + text_len;
    let Some(Ok(text)) = bytes.get(text_at..data_at).map(std::str::from_utf8) else {
        return fail(text_at, &format!("expected {text_len} bytes of header text"));
    };
    let field = |name: &str| {
        let at = text.find(&format!("'{name}'"))? + name.len() + 2;
        Some(text[at..].trim_start().strip_prefix(':')?.trim_start())
    };
    let (Some(descr), Some(order), Some(shape)) = (
        field("descr").and_then(|s| s.strip_prefix('\'')?.split('\'').next()),
        field("fortran_order"),
        field("shape").and_then(|s| s.strip_prefix('(')?.split(')').next()),
    ) else {
        return fail(text_at, "expected a dictionary of 'descr', 'fortran_order' and 'shape'");
    };
    let dtype = match descr.trim_start_matches(['<', '>', '|', '=']) {
        "u1" | "b1" => Dtype::U8,
        "i1" => Dtype::I8,
        "u2" => Dtype::U16,
        "i2" => Dtype::I16,
        "u4" => Dtype::U32,
        "i4" => Dtype::I32,
        "u8" => Dtype::U64,
        "i8" => Dtype::I64,
        "f4" => Dtype::F32,
        "f8" => Dtype::F64,
        _ => return fail(text_at, &format!("values of type {descr:?}; expected integers, f4 or f8")),
    };
    let shape: Result<Vec<u64>, _> =
        shape.split(',').map(str::trim).filter(|s| !s.is_empty()).map(str::parse).collect();
    let (rank, [z, y, x]) = match shape.as_deref() {
        Ok(&[y, x]) => (2, [1, y, x]),
        Ok(&[z, y, x]) => (3, [z, y, x]),
        _ => return fail(text_at, "expected an array of three axes, shape (z, y, x), or two, a height map"),
    };
    let dims = [x, y, z];
    let expected = byte_len(path, dims, dtype)?;
    let data = &bytes[data_at..];
    if data.len() as u64 != expected {
        return fail(data_at, &format!("{} bytes of values, shape ({z}, {y}, {x}) expects {expected}", data.len()));
    }
    let z_fastest = if order.starts_with("True") {
        true
    } else if order.starts_with("False") {
        false
    } else {
        return fail(text_at, "fortran_order is neither True nor False");
    };
    let (big_endian, data) = (descr.starts_with('>'), Data::Slice(data));
    Ok((rank, Stored { dims, z_fastest, dtype, big_endian, scale: None, data, notes: Vec::new() }))
}
