//! Dense volumes: raw, NPY, NRRD, NIfTI.
//!
//! Each reader only finds out where the values are and what they are ([`Volume`]); [`build`] makes columns of them.

use std::io::Read;
use std::path::Path;

use flate2::read::MultiGzDecoder;
use rayon::prelude::*;

use super::{Dtype, ReadOptions, Up, concat_rows, guarded, map, world_dims};
use crate::{Colors, Columns, Error, Input, Result, Run};

/// Bytes of a NIfTI-1 header.
pub(super) const NIFTI_HEADER: u64 = 348;

/// A dense volume, x fastest, then y, then z.
struct Volume<'a> {
    /// Values an axis (x, y, z of the file).
    dims: [u64; 3],
    dtype: Dtype,
    big_endian: bool,
    /// What a stored value means: `value · slope + inter`.
    scale: Option<(f64, f64)>,
    /// Exactly the values.
    bytes: &'a [u8],
    notes: Vec<String>,
}

/// Bytes of a volume's values.
fn byte_len(path: &Path, dims: [u64; 3], dtype: Dtype) -> Result<u64> {
    let voxels = dims.iter().try_fold(1u64, |n, &d| n.checked_mul(d));
    voxels.and_then(|n| n.checked_mul(dtype.size())).ok_or_else(|| {
        let [x, y, z] = dims;
        Error::Limit(format!("{}: {x} × {y} × {z} values are beyond any memory", path.display()))
    })
}

/// `--dims`, `--dtype`: values without a header.
pub(super) fn raw(path: &Path, bytes: &[u8], opts: &ReadOptions) -> Result<Input> {
    let dims = opts.dims.ok_or_else(|| {
        Error::Argument(format!("{}: a raw volume needs --dims X,Y,Z (and --dtype, unless u8)", path.display()))
    })?;
    let dtype = opts.dtype.unwrap_or(Dtype::U8);
    let expected = byte_len(path, dims, dtype)?;
    if bytes.len() as u64 != expected {
        let [x, y, z] = dims;
        return Err(Error::format(
            path,
            format!(
                "{} bytes; --dims {x},{y},{z} with {} byte a value (--dtype) expects exactly {expected}",
                bytes.len(),
                dtype.size()
            ),
        ));
    }
    build(path, Volume { dims, dtype, big_endian: false, scale: None, bytes, notes: Vec::new() }, opts)
}

/// NumPy: an array of shape (z, y, x).
pub(super) fn npy(path: &Path, bytes: &[u8], opts: &ReadOptions) -> Result<Input> {
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
    let Ok(&[z, y, x]) = shape.as_deref() else {
        return fail(text_at, "expected an array of three axes, shape (z, y, x)");
    };
    let dims = [x, y, z];
    let expected = byte_len(path, dims, dtype)?;
    let data = &bytes[data_at..];
    if data.len() as u64 != expected {
        return fail(data_at, &format!("{} bytes of values, shape ({z}, {y}, {x}) expects {expected}", data.len()));
    }
    let transposed;
    let data = if order.starts_with("True") {
        transposed = transpose(data, dims, dtype.size() as usize);
        &transposed
    } else if order.starts_with("False") {
        data
    } else {
        return fail(text_at, "fortran_order is neither True nor False");
    };
    let big_endian = descr.starts_with('>');
    build(path, Volume { dims, dtype, big_endian, scale: None, bytes: data, notes: Vec::new() }, opts)
}

/// Values stored z fastest, then y, then x, put into x fastest, then y, then z.
fn transpose(data: &[u8], dims: [u64; 3], size: usize) -> Vec<u8> {
    let [nx, ny, nz] = dims.map(|d| d as usize);
    let mut out = vec![0; data.len()];
    if out.is_empty() {
        return out;
    }
    out.par_chunks_mut(nx * ny * size).enumerate().for_each(|(z, slice)| {
        for (i, value) in slice.chunks_exact_mut(size).enumerate() {
            let (x, y) = (i % nx, i / nx);
            let from = ((x * ny + y) * nz + z) * size;
            value.copy_from_slice(&data[from..from + size]);
        }
    });
    out
}

/// NRRD: text header, values raw or gzip, in the same file or a detached one.
pub(super) fn nrrd(path: &Path, bytes: &[u8], opts: &ReadOptions) -> Result<Input> {
    let fail = |at: usize, what: String| Err(Error::format(path, format!("byte {at}: {what}")));
    if !bytes.starts_with(b"NRRD000") {
        return fail(0, "expected the NRRD signature NRRD000".to_owned());
    }
    let mut header = NrrdHeader::default();
    let mut at = 0;
    // The header ends with an empty line; a detached one may end with its file.
    let header_end = loop {
        let Some(len) = bytes[at..].iter().position(|&b| b == b'\n') else {
            if bytes.len() - at > 0 && header.data_file.is_none() {
                return fail(at, "the file ends inside the NRRD header".to_owned());
            }
            break bytes.len();
        };
        let line = String::from_utf8_lossy(&bytes[at..at + len]);
        let line = line.trim_end();
        if line.is_empty() {
            break at + len + 1;
        }
        if at > 0
            && let Err(what) = header.field(line)
        {
            return fail(at, what);
        }
        at += len + 1;
    };
    let missing = |what| Error::format(path, format!("byte {header_end}: the NRRD header ends without \"{what}\""));
    let dtype = header.dtype.ok_or_else(|| missing("type"))?;
    let encoding = header.encoding.clone().ok_or_else(|| missing("encoding"))?;
    let mut sizes = header.sizes.clone().ok_or_else(|| missing("sizes"))?;
    if header.dimension.is_some_and(|d| d != sizes.len()) {
        return fail(0, format!("dimension is {} but there are {} sizes", header.dimension.unwrap_or(0), sizes.len()));
    }
    if sizes.len() > 3 {
        sizes.retain(|&n| n != 1);
    }
    let &[x, y, z] = sizes.as_slice() else {
        return fail(
            0,
            format!("sizes {:?}: expected three axes, one value a voxel", header.sizes.unwrap_or_default()),
        );
    };
    let dims = [x, y, z];
    let expected = byte_len(path, dims, dtype)?;
    if dtype.size() > 1 && header.big_endian.is_none() {
        return Err(missing("endian"));
    }

    let detached;
    let (data_path, mut data) = match &header.data_file {
        Some(name) => {
            let data_path = path.parent().unwrap_or(Path::new("")).join(name);
            detached = map(&data_path)?;
            (data_path, &*detached)
        }
        None => (path.to_owned(), &bytes[header_end..]),
    };
    for _ in 0..header.line_skip {
        let Some(len) = data.iter().position(|&b| b == b'\n') else {
            return Err(Error::format(data_path, format!("fewer lines than \"line skip: {}\"", header.line_skip)));
        };
        data = &data[len + 1..];
    }
    let short = |got: usize| {
        Error::format(&data_path, format!("{got} bytes of values; {x} × {y} × {z} of this type expect {expected}"))
    };
    let inflated;
    let values = match encoding.as_str() {
        "raw" => {
            let skip = match header.byte_skip {
                -1 => (data.len() as u64).checked_sub(expected).ok_or_else(|| short(data.len()))?,
                n => n as u64,
            };
            let end =
                skip.checked_add(expected).filter(|&e| e <= data.len() as u64).ok_or_else(|| short(data.len()))?;
            &data[skip as usize..end as usize]
        }
        "gzip" | "gz" => {
            let skip = header.byte_skip.max(0) as u64;
            let end = skip.checked_add(expected).ok_or_else(|| short(0))?;
            inflated = gunzip(&data_path, data, end)?;
            inflated.get(skip as usize..).filter(|v| v.len() as u64 == expected).ok_or_else(|| short(inflated.len()))?
        }
        other => {
            return fail(0, format!("encoding {other:?} is not supported; save it as raw or gzip (unu save -e gzip)"));
        }
    };
    let mut notes = header.notes;
    notes.push(
        "NRRD axes are kept as stored: the first is x, the second y, the third z (--up z to stand on the third)"
            .to_owned(),
    );
    let big_endian = header.big_endian == Some(true);
    build(path, Volume { dims, dtype, big_endian, scale: None, bytes: values, notes }, opts)
}

#[derive(Default)]
struct NrrdHeader {
    dtype: Option<Dtype>,
    dimension: Option<usize>,
    sizes: Option<Vec<u64>>,
    encoding: Option<String>,
    big_endian: Option<bool>,
    data_file: Option<String>,
    line_skip: u64,
    byte_skip: i64,
    notes: Vec<String>,
}

impl NrrdHeader {
    /// Takes in one line after the signature.
    fn field(&mut self, line: &str) -> Result<(), String> {
        if line.starts_with('#') || line.contains(":=") {
            return Ok(());
        }
        let (name, value) = line.split_once(':').ok_or_else(|| format!("expected \"field: value\", found {line:?}"))?;
        let value = value.trim();
        let bad = || format!("\"{}\" has the value {value:?}", name.trim());
        match name.trim().to_lowercase().as_str() {
            "type" => {
                self.dtype = Some(match value {
                    "uchar" | "unsigned char" | "uint8" | "uint8_t" => Dtype::U8,
                    "signed char" | "int8" | "int8_t" => Dtype::I8,
                    "ushort" | "unsigned short" | "unsigned short int" | "uint16" | "uint16_t" => Dtype::U16,
                    "short" | "short int" | "signed short" | "signed short int" | "int16" | "int16_t" => Dtype::I16,
                    "uint" | "unsigned int" | "uint32" | "uint32_t" => Dtype::U32,
                    "int" | "signed int" | "int32" | "int32_t" => Dtype::I32,
                    "ulonglong" | "unsigned long long" | "unsigned long long int" | "uint64" | "uint64_t" => Dtype::U64,
                    "longlong"
                    | "long long"
                    | "long long int"
                    | "signed long long"
                    | "signed long long int"
                    | "int64"
                    | "int64_t" => Dtype::I64,
                    "float" => Dtype::F32,
                    "double" => Dtype::F64,
                    _ => return Err(format!("{}; expected an integer type, float or double", bad())),
                });
            }
            "dimension" => self.dimension = Some(value.parse().map_err(|_| bad())?),
            "sizes" => {
                let sizes: Result<Vec<u64>, _> = value.split_whitespace().map(str::parse).collect();
                self.sizes = Some(sizes.map_err(|_| bad())?);
            }
            "encoding" => self.encoding = Some(value.to_lowercase()),
            "endian" => {
                self.big_endian = Some(match value {
                    "little" => false,
                    "big" => true,
                    _ => return Err(bad()),
                });
            }
            "data file" | "datafile" => {
                if value.starts_with("LIST") || value.contains('%') {
                    return Err(format!("{}; values spread over several files are not supported", bad()));
                }
                self.data_file = Some(value.to_owned());
            }
            "line skip" | "lineskip" => self.line_skip = value.parse().map_err(|_| bad())?,
            "byte skip" | "byteskip" => {
                self.byte_skip = value.parse().ok().filter(|&n| n >= -1).ok_or_else(bad)?;
            }
            "spacings" | "space directions" => {
                self.notes.push(format!("{}: {value}; voxels are drawn as cubes", name.trim()))
            }
            // Further fields say nothing about where the values are.
            _ => {}
        }
        Ok(())
    }
}

/// NIfTI-1, plain or gzip; of a series the first volume.
pub(super) fn nifti(path: &Path, bytes: &[u8], opts: &ReadOptions) -> Result<Input> {
    let fail = |what: String| Err(Error::format(path, what));
    let gz = bytes.starts_with(b"\x1f\x8b");
    let head = if gz { gunzip_prefix(path, bytes, NIFTI_HEADER)? } else { bytes[..bytes.len().min(348)].to_vec() };
    let header = guarded(path, "NIfTI", || {
        nifti::NiftiHeader::from_reader(&*head).map_err(|e| Error::format(path, format!("NIfTI header: {e}")))
    })?;
    if &header.magic != nifti::header::MAGIC_CODE_NIP1 {
        return fail(
            "byte 344: the header's values are in a second file (.hdr/.img); convert it to one .nii".to_owned(),
        );
    }
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
    if !(NIFTI_HEADER as f32..1e9).contains(&header.vox_offset) {
        return fail(format!("byte 108: values start at byte {}; expected 352 or later", header.vox_offset));
    }
    let start = header.vox_offset as u64;
    let expected = byte_len(path, dims, dtype)?;
    let end = start + expected;
    let inflated;
    let whole: &[u8] = if gz {
        inflated = gunzip(path, bytes, end)?;
        &inflated
    } else {
        bytes
    };
    let Some(values) = whole.get(start as usize..).and_then(|v| v.get(..expected as usize)) else {
        let [x, y, z] = dims;
        return fail(format!("{} bytes; {x} × {y} × {z} values from byte {start} on expect {end}", whole.len()));
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
    let big_endian = header.endianness == nifti::Endianness::Big;
    build(path, Volume { dims, dtype, big_endian, scale, bytes: values, notes }, opts)
}

/// The first `len` bytes of a gzip stream.
fn gunzip_prefix(path: &Path, bytes: &[u8], len: u64) -> Result<Vec<u8>> {
    // Memory grows with what the stream really holds, not with what a header claims.
    let mut out = Vec::new();
    MultiGzDecoder::new(bytes)
        .take(len)
        .read_to_end(&mut out)
        .map_err(|e| Error::format(path, format!("gzip stream, after {} bytes: {e}", out.len())))?;
    Ok(out)
}

/// The first `len` bytes of a gzip stream, whose end and checksum are looked at where it holds no more than these.
fn gunzip(path: &Path, bytes: &[u8], len: u64) -> Result<Vec<u8>> {
    let mut out = gunzip_prefix(path, bytes, len.saturating_add(1))?;
    out.truncate(usize::try_from(len).unwrap_or(usize::MAX));
    Ok(out)
}

/// Which values are solid.
#[derive(Clone, Copy)]
enum Solid {
    /// Stored value above 0.
    Positive,
    AtLeast {
        iso: f64,
        scale: Option<(f64, f64)>,
    },
}

/// `$body` with `$read` the function from bytes to a value of the volume's type.
macro_rules! with_sample {
    ($dtype:expr, $big:expr, |$read:ident| $body:expr) => {
        with_sample!(@ $dtype, $big, |$read| $body; U8 u8, I8 i8, U16 u16, I16 i16, U32 u32, I32 i32, U64 u64,
            I64 i64, F32 f32, F64 f64)
    };
    (@ $dtype:expr, $big:expr, |$read:ident| $body:expr; $($variant:ident $t:ident),*) => {
        match ($dtype, $big) {
            $(
                (Dtype::$variant, false) => {
                    let $read = &|bytes: [u8; size_of::<$t>()]| $t::from_le_bytes(bytes);
                    $body
                }
                (Dtype::$variant, true) => {
                    let $read = &|bytes: [u8; size_of::<$t>()]| $t::from_be_bytes(bytes);
                    $body
                }
            )*
        }
    };
}

/// A stored value, as far as comparing goes.
trait Sample: Copy {
    fn to_f64(self) -> f64;
    /// `iso` in the precision of the values: 0.7 means the f32 nearest to 0.7 in a volume of f32.
    fn threshold(iso: f64) -> f64 {
        iso
    }
}

macro_rules! samples {
    ($($t:ident),*) => { $(impl Sample for $t { fn to_f64(self) -> f64 { self as f64 } })* };
}
samples!(u8, i8, u16, i16, u32, i32, u64, i64, f64);

impl Sample for f32 {
    fn to_f64(self) -> f64 {
        f64::from(self)
    }
    fn threshold(iso: f64) -> f64 {
        f64::from(iso as f32)
    }
}

/// Columns of a volume: where a value is solid, and which axis is up, from the options.
fn build(path: &Path, volume: Volume, opts: &ReadOptions) -> Result<Input> {
    let up = opts.up.unwrap_or_default();
    let [x, y, z] = volume.dims;
    let dims = match up {
        Up::Y => [x, y, z],
        Up::Z => [x, z, y],
    };
    let dims = world_dims(path, dims, "--up chooses another axis")?;
    let solid = match opts.iso {
        Some(iso) if iso.is_nan() => return Err(Error::Argument("--iso is not a number".to_owned())),
        Some(iso) => Solid::AtLeast { iso, scale: volume.scale },
        None if volume.dtype == Dtype::U8 => Solid::Positive,
        None => {
            let (low, high) = with_sample!(volume.dtype, volume.big_endian, |read| range(&volume, read));
            return Err(Error::Argument(format!(
                "{}: values range from {low} to {high}; give --iso V, voxels of at least V are solid",
                path.display()
            )));
        }
    };
    let columns = with_sample!(volume.dtype, volume.big_endian, |read| {
        let scan = Scan { volume: &volume, dims, up };
        match solid {
            Solid::Positive => scan.columns(read, &|v| v.to_f64() > 0.0),
            Solid::AtLeast { iso, scale: None } => {
                let iso = threshold_of(read, iso);
                scan.columns(read, &move |v| v.to_f64() >= iso)
            }
            Solid::AtLeast { iso, scale: Some((slope, inter)) } => {
                scan.columns(read, &move |v| v.to_f64() * slope + inter >= iso)
            }
        }
    })?;
    Ok(Input { columns, colors: Colors::None, notes: volume.notes })
}

fn threshold_of<T: Sample, const N: usize>(_: &impl Fn([u8; N]) -> T, iso: f64) -> f64 {
    T::threshold(iso)
}

/// Least and greatest value (NaN left out).
fn range<T: Sample, const N: usize>(volume: &Volume, read: &(impl Fn([u8; N]) -> T + Sync)) -> (f64, f64) {
    let (slope, inter) = volume.scale.unwrap_or((1.0, 0.0));
    let (a, b) = volume
        .bytes
        .par_chunks(N << 16)
        .map(|chunk| {
            let (values, _) = chunk.as_chunks::<N>();
            values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &v| {
                let v = read(v).to_f64();
                (low.min(v), high.max(v))
            })
        })
        .reduce(|| (f64::INFINITY, f64::NEG_INFINITY), |a, b| (a.0.min(b.0), a.1.max(b.1)));
    let (a, b) = (a * slope + inter, b * slope + inter);
    (a.min(b), a.max(b))
}

/// A pass over a volume, one row of x at a time, in planes of constant world z.
struct Scan<'a> {
    volume: &'a Volume<'a>,
    /// World size.
    dims: [u32; 3],
    up: Up,
}

impl Scan<'_> {
    fn columns<T: Sample, const N: usize>(
        &self,
        read: &(impl Fn([u8; N]) -> T + Sync),
        solid: &(impl Fn(T) -> bool + Sync),
    ) -> Result<Columns> {
        let planes: Vec<Columns> =
            (0..self.dims[2]).into_par_iter().map(|z| self.plane(z, &|bytes| solid(read(bytes)))).collect();
        concat_rows(self.dims, &planes)
    }

    /// The columns of world row `z`. The rows of the file are read as they lie in it, from the lowest y up, and
    /// compared 64 voxels at a time with the row below: only changes cost more than that.
    fn plane<const N: usize>(&self, z: u32, solid: &impl Fn([u8; N]) -> bool) -> Columns {
        let [nx, ny, _] = self.dims;
        let words = (nx as usize).div_ceil(64);
        let (mut below, mut start) = (vec![0u64; words], vec![0u16; nx as usize]);
        let mut found: Vec<(u32, Run)> = Vec::new();
        let mut offsets = vec![0u32; nx as usize + 1];
        // One row beyond the top, all air, ends what still runs.
        for y in 0..=ny {
            let row = if y < ny { self.row(y, z).as_chunks::<N>().0 } else { &[] };
            for (word_ix, below) in below.iter_mut().enumerate() {
                let values = row.get(word_ix * 64..).unwrap_or_default();
                let mut here = 0u64;
                for (i, &value) in values.iter().take(64).enumerate() {
                    here |= u64::from(solid(value)) << i;
                }
                let mut changed = here ^ *below;
                while changed != 0 {
                    let bit = changed.trailing_zeros();
                    let x = word_ix as u32 * 64 + bit;
                    if here >> bit & 1 == 1 {
                        start[x as usize] = y as u16;
                    } else {
                        found.push((x, Run::new(start[x as usize], (y - 1) as u16)));
                        offsets[x as usize + 1] += 1;
                    }
                    changed &= changed - 1;
                }
                *below = here;
            }
        }
        // A counting sort by column keeps each column's runs ascending.
        for x in 0..nx as usize {
            offsets[x + 1] += offsets[x];
        }
        let mut next = offsets.clone();
        let mut runs = vec![Run::new(0, 0); found.len()];
        for (x, run) in found {
            runs[next[x as usize] as usize] = run;
            next[x as usize] += 1;
        }
        Columns::from_parts(nx, ny, 1, offsets, runs)
    }

    /// The bytes of world row (all x, `y`, `z`).
    fn row(&self, y: u32, z: u32) -> &[u8] {
        let [nx, ny, _] = self.volume.dims;
        let (file_y, file_z) = match self.up {
            Up::Y => (u64::from(y), u64::from(z)),
            Up::Z => (ny - 1 - u64::from(z), u64::from(y)),
        };
        let size = self.volume.dtype.size();
        let at = ((file_z * ny + file_y) * nx * size) as usize;
        &self.volume.bytes[at..at + (nx * size) as usize]
    }
}
