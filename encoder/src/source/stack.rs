//! Stacks of TIFF images as volumes: the pages of one file, or the files of a folder, the first being z = 0. Pages go to
//! a file without a name, one after the other, so that the stack need not fit into memory.

use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use tiff::decoder::{Decoder, DecodingResult, Limits};

use super::heightmap::plausible;
use super::pixels::{Stream, stream};
use super::volume::Volume;
use super::{Dtype, ReadOptions, guarded, map};
use crate::scratch::{self as file, File};
use crate::{Error, Result};

/// All pages of these files, which must be equal in size and type.
pub(super) fn read(path: &Path, files: &[PathBuf], opts: &ReadOptions) -> Result<Volume<'static>> {
    let scratch = |action| move |e| Error::io(std::env::temp_dir(), action, e);
    let file = file::file().map_err(scratch("create a file in"))?;
    let mut out = BufWriter::with_capacity(1 << 20, file);
    let mut first: Option<([u32; 2], Dtype)> = None;
    let mut n = 0u64;
    for file in files {
        let bytes = map(file)?;
        guarded(file, "TIFF", || {
            pages(file, stream(file, &bytes, true)?, bytes.len(), |size, dtype, values| {
                let &mut (expected, of) = first.get_or_insert((size, dtype));
                if (expected, of) != (size, dtype) {
                    return Err(Error::format(
                        file,
                        format!("page {n} of the stack is {size:?} of {dtype:?}, the first {expected:?} of {of:?}"),
                    ));
                }
                n += 1;
                out.write_all(values).map_err(scratch("write a file in"))
            })
        })?;
    }
    let Some(([nx, ny], dtype)) = first else {
        return Err(Error::format(path, "no TIFF images; a stack has one at least"));
    };
    let file: File = out.into_inner().map_err(|e| scratch("write a file in")(e.into_error()))?;
    Volume::unpacked(path, file, [nx.into(), ny.into(), n], dtype, opts)
}

/// Calls `each` with the size, type and values of each page.
fn pages(
    path: &Path,
    bytes: Box<dyn Stream + '_>,
    len: usize,
    mut each: impl FnMut([u32; 2], Dtype, &[u8]) -> Result<()>,
) -> Result<()> {
    let fail = |e: tiff::TiffError| Error::format(path, format!("TIFF: {e}"));
    let mut decoder = Decoder::new(bytes).map_err(fail)?;
    loop {
        let (width, height) = decoder.dimensions().map_err(fail)?;
        plausible(path, width, height, len)?;
        let color = decoder.colortype().map_err(fail)?;
        if !matches!(color, tiff::ColorType::Gray(_)) {
            return Err(Error::format(path, format!("TIFF of {color:?}; a volume has one value a voxel")));
        }
        let mut limits = Limits::default();
        limits.decoding_buffer_size = (u64::from(width) * u64::from(height) * 8).max(1 << 20) as usize;
        limits.intermediate_buffer_size = limits.decoding_buffer_size;
        decoder = decoder.with_limits(limits);
        let (dtype, values): (Dtype, Vec<u8>) = match decoder.read_image().map_err(fail)? {
            DecodingResult::U8(v) => (Dtype::U8, v),
            DecodingResult::I8(v) => (Dtype::I8, bytemuck::cast_slice(&v).to_vec()),
            DecodingResult::U16(v) => (Dtype::U16, bytemuck::cast_slice(&v).to_vec()),
            DecodingResult::I16(v) => (Dtype::I16, bytemuck::cast_slice(&v).to_vec()),
            DecodingResult::U32(v) => (Dtype::U32, bytemuck::cast_slice(&v).to_vec()),
            DecodingResult::I32(v) => (Dtype::I32, bytemuck::cast_slice(&v).to_vec()),
            DecodingResult::U64(v) => (Dtype::U64, bytemuck::cast_slice(&v).to_vec()),
            DecodingResult::I64(v) => (Dtype::I64, bytemuck::cast_slice(&v).to_vec()),
            DecodingResult::F32(v) => (Dtype::F32, bytemuck::cast_slice(&v).to_vec()),
            DecodingResult::F64(v) => (Dtype::F64, bytemuck::cast_slice(&v).to_vec()),
            DecodingResult::F16(_) => return Err(Error::format(path, "TIFF of half floats; convert it to f32")),
        };
        if values.len() as u64 != u64::from(width) * u64::from(height) * dtype.size() {
            return Err(Error::format(path, format!("TIFF: {} bytes for {width} × {height} pixels", values.len())));
        }
        each([width, height], dtype, &values)?;
        if !decoder.more_images() {
            return Ok(());
        }
        decoder.next_image().map_err(fail)?;
    }
}
