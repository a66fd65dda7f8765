//! NIfTI volumes.

use std::path::Path;

use super::volume::{Data, Stored, Volume, byte_len, gunzip, gunzip_prefix};
use super::{Dtype, ReadOptions, guarded, map};
use crate::{Error, Result};

/// Bytes of a NIfTI-1 header.
pub(super) const HEADER: u64 = 348;

/// NIfTI-1, plain or gzip; of a series the first volume.
pub(super) fn read<'a>(path: &Path, bytes: &'a [u8], opts: &ReadOptions) -> Result<Volume<'a>> {
    let fail = |what: String| Err(Error::format(path, what));
    let gz = bytes.starts_with(b"\x1f\x8b");
    let head = if gz { gunzip_prefix(path, bytes, HEADER)? } else { bytes[..bytes.len().min(348)].to_vec() };
    let header = guarded(path, "NIfTI", || {
        ::nifti::NiftiHeader::from_reader(&*head).map_err(|e| Error::format(path, format!("NIfTI header: {e}")))
    })?;
    // "ni1": the values are in a file beside the header's.
    let pair = (&header.magic != ::nifti::header::MAGIC_CODE_NIP1).then(|| path.with_extension("img"));
    let rank = header.dim[0] as usize;
    if !(1..=7).contains(&rank) {
        return fail(format!("byte 40: {rank} axes; expected 1 to 7"));
    }
    let axis = |i: usize| if i <= rank { u64::from(header.dim[i]) } else { 1 };
    let dims = [axis(1), axis(2), axis(3)];
    if (1..=rank).any(|i| header.dim[i] == 0 || header.dim[i] > i16::MAX as u16) {
        return fail(format!("byte 42: axis sizes {:?}; expected 1 to 32767 each", &header.dim[1..=rank]));
    }
    let dtype = match header.datatype {
        2 => Dtype::U8,
        256 => Dtype::I8,
        512 => Dtype::U16,
        4 => Dtype::I16,
        768 => Dtype::U32,
        8 => Dtype::I32,
        1280 => Dtype::U64,
        1024 => Dtype::I64,
        16 => Dtype::F32,
        64 => Dtype::F64,
        other => return fail(format!("byte 70: values of NIfTI type {other}; expected integers, f32 or f64")),
    };
    let beside = pair.is_some() && header.vox_offset == 0.0;
    if !beside && !(HEADER as f32..1e9).contains(&header.vox_offset) {
        return fail(format!("byte 108: values start at byte {}; expected 352 or later", header.vox_offset));
    }
    let start = header.vox_offset as u64;
    let expected = byte_len(path, dims, dtype)?;
    let end = start + expected;
    let short = |got: u64| {
        let [x, y, z] = dims;
        Error::format(path, format!("{got} bytes; {x} × {y} × {z} values from byte {start} on expect {end}"))
    };
    let data = if let Some(pair) = &pair {
        let whole = map(pair)?;
        let values = whole.get(start as usize..).and_then(|v| v.get(..expected as usize));
        Data::Slice(values.ok_or_else(|| short(whole.len() as u64))?).in_file(pair, &whole)?
    } else if gz {
        gunzip(path, bytes, start, end)?.map_err(short)?
    } else {
        let values = bytes.get(start as usize..).and_then(|v| v.get(..expected as usize));
        Data::Slice(values.ok_or_else(|| short(bytes.len() as u64))?)
    };
    let mut notes = Vec::new();
    let volumes = (4..=rank).map(axis).fold(1u64, u64::saturating_mul);
    if volumes > 1 {
        notes.push(format!("the file holds {volumes} volumes; the first is read"));
    }
    let scale = (header.scl_slope != 0.0 && header.scl_slope.is_finite() && header.scl_inter.is_finite())
        .then_some((f64::from(header.scl_slope), f64::from(header.scl_inter)))
        .filter(|&s| s != (1.0, 0.0));
    if let Some((slope, inter)) = scale {
        notes.push(format!("values are stored · {slope} + {inter}"));
    }
    let [_, px, py, pz, ..] = header.pixdim;
    if px != py || py != pz {
        notes.push(format!("voxels of {px} × {py} × {pz} are drawn as cubes"));
    }
    notes.push("NIfTI axes are kept as stored (--up z to stand on the third, usually towards the head)".to_owned());
    let big_endian = header.endianness == ::nifti::Endianness::Big;
    let stored = Stored { big_endian, scale, notes, ..Stored::new(dims, dtype, data) };
    Volume::new(path, stored, opts)
}
