//! Dense volumes: raw ones, and those whose values others found.
//!
//! Each reader only finds out where the values are and what they are ([`Stored`]); a [`Volume`] makes columns of them,
//! a piece at a time. Its values stay in their file, and are read in stretches as long as the order of the axes allows:
//!
//! | up axis is the file's | read at once | columns are made |
//! |---|---|---|
//! | second (`--up y`) | a slice | row by row of the world, each from one slice |
//! | third (`--up z`) | the piece's rows of a slice | slice by slice, in slabs that are joined |
//! | first (`--up x`) | the piece's rows of a slice | each from one row |

use std::io::{Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};

use flate2::read::MultiGzDecoder;
use rayon::prelude::*;

use super::{Dtype, ReadOptions, Up, world_dims};
use crate::pieces::Pieces;
use crate::scratch::{self, File, read_at};
use crate::{About, Colors, Columns, ColumnsBuilder, Error, Input, Result, Run};

/// A dense volume as a file holds it.
pub(super) struct Stored<'a> {
    /// Values an axis (x, y, z of the input).
    pub dims: [u64; 3],
    /// Whether z is fastest in the file, not x.
    pub z_fastest: bool,
    pub dtype: Dtype,
    pub big_endian: bool,
    /// What a stored value means: `value · slope + inter`.
    pub scale: Option<(f64, f64)>,
    /// The stored value that stands for none: air.
    pub missing: Option<f64>,
    /// Exactly the values.
    pub data: Data<'a>,
    pub notes: Vec<String>,
    /// As far as the reader knows it, of the input's x, y and z: [`Volume::new`] says what it made of it. `rule` is what the
    /// values mean, `axes` which axes of the source they are.
    pub about: About,
}

impl<'a> Stored<'a> {
    /// Values that mean what they are, x fastest, in little-endian order.
    pub fn new(dims: [u64; 3], dtype: Dtype, data: Data<'a>) -> Stored<'a> {
        Stored {
            dims,
            z_fastest: false,
            dtype,
            big_endian: false,
            scale: None,
            missing: None,
            data,
            notes: Vec::new(),
            about: About::default(),
        }
    }
}

/// Where values are.
pub(super) enum Data<'a> {
    Slice(&'a [u8]),
    /// From byte `at` on, `len` bytes.
    File {
        path: PathBuf,
        file: File,
        at: u64,
        len: u64,
    },
    /// The same of an object elsewhere.
    #[cfg(feature = "object-store")]
    Object {
        object: Box<crate::remote::Object>,
        at: u64,
        len: u64,
    },
}

impl Data<'_> {
    pub fn len(&self) -> u64 {
        match self {
            Data::Slice(bytes) => bytes.len() as u64,
            Data::File { len, .. } => *len,
            #[cfg(feature = "object-store")]
            Data::Object { len, .. } => *len,
        }
    }

    /// Bytes to read at once, and whether bytes that nobody asked for are worth one reading less.
    fn stretch(&self) -> (u64, bool) {
        match self {
            #[cfg(feature = "object-store")]
            Data::Object { .. } => (OBJECT_STRETCH, true),
            _ => (STRETCH, false),
        }
    }

    /// The `len` bytes from `at` on, in `buffer` unless they are in memory already.
    pub fn read<'b>(&'b self, at: u64, len: usize, buffer: &'b mut Vec<u8>) -> Result<&'b [u8]> {
        match self {
            Data::Slice(bytes) => Ok(&bytes[at as usize..at as usize + len]),
            Data::File { path, file, at: start, .. } => {
                buffer.resize(len, 0);
                read_at(file, buffer, start + at).map_err(|e| Error::io(path, "read", e))?;
                Ok(buffer)
            }
            #[cfg(feature = "object-store")]
            Data::Object { object, at: start, .. } => {
                object.read(start + at..start + at + len as u64, buffer)?;
                Ok(buffer)
            }
        }
    }

    /// The same values, still in the file at `path` where they are a part of its bytes `whole`.
    pub fn in_file(self, path: &Path, whole: &[u8]) -> Result<Data<'static>> {
        match self {
            Data::Slice(bytes) => {
                let at = (bytes.as_ptr() as usize - whole.as_ptr() as usize) as u64;
                let file = File::open(path).map_err(|e| Error::io(path, "open", e))?;
                Ok(Data::File { path: path.to_owned(), file, at, len: bytes.len() as u64 })
            }
            Data::File { path, file, at, len } => Ok(Data::File { path, file, at, len }),
            #[cfg(feature = "object-store")]
            Data::Object { object, at, len } => Ok(Data::Object { object, at, len }),
        }
    }
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
                    let $read = $t::from_le_bytes;
                    $body
                }
                (Dtype::$variant, true) => {
                    let $read = $t::from_be_bytes;
                    $body
                }
            )*
        }
    };
}

pub(super) use with_sample;

/// Bytes of a volume's values.
pub(super) fn byte_len(path: &Path, dims: [u64; 3], dtype: Dtype) -> Result<u64> {
    let voxels = dims.iter().try_fold(1u64, |n, &d| n.checked_mul(d));
    voxels.and_then(|n| n.checked_mul(dtype.size())).ok_or_else(|| {
        let [x, y, z] = dims;
        Error::Limit(format!("{}: {x} × {y} × {z} values are beyond any memory", path.display()))
    })
}

/// `--dims`, `--dtype`: values without a header.
pub(super) fn raw<'a>(path: &Path, bytes: &'a [u8], opts: &ReadOptions) -> Result<Volume<'a>> {
    Volume::new(path, raw_array(path, bytes, opts)?, opts)
}

/// A volume of which `bytes` are no more than the head right, and whose values are in `object`; None where it is a height
/// map, or values are to be unpacked.
#[cfg(feature = "object-store")]
pub(super) fn in_object(
    path: &Path,
    bytes: &[u8],
    format: super::Format,
    object: crate::remote::Object,
    opts: &ReadOptions,
) -> Result<Option<Volume<'static>>> {
    let stored = match format {
        super::Format::Raw => raw_array(path, bytes, opts)?,
        _ => match super::npy::plain_volume(path, bytes)? {
            Some(stored) => stored,
            None => return Ok(None),
        },
    };
    let dtype = stored.dtype;
    if opts.iso.is_none() && dtype != Dtype::U8 {
        // Looking for the range would read it all.
        let what = "values of this type need --iso V, voxels of at least V are solid";
        return Err(Error::Argument(format!("{}: {what}", path.display())));
    }
    let Data::Slice(values) = stored.data else { unreachable!("nothing of it was unpacked") };
    let at = (values.as_ptr() as usize - bytes.as_ptr() as usize) as u64;
    let data = Data::Object { object: Box::new(object), at, len: values.len() as u64 };
    Volume::new(path, Stored { data, ..stored }, opts).map(Some)
}

fn raw_array<'a>(path: &Path, bytes: &'a [u8], opts: &ReadOptions) -> Result<Stored<'a>> {
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
    let data = Data::Slice(bytes);
    Ok(Stored::new(dims, dtype, data))
}

/// The first `len` bytes of a gzip stream.
pub(super) fn gunzip_prefix(path: &Path, bytes: &[u8], len: u64) -> Result<Vec<u8>> {
    // Memory grows with what the stream really holds, not with what a header claims.
    let mut out = Vec::new();
    MultiGzDecoder::new(bytes)
        .take(len)
        .read_to_end(&mut out)
        .map_err(|e| Error::format(path, format!("gzip stream, after {} bytes: {e}", out.len())))?;
    Ok(out)
}

/// Bytes `start..end` of a gzip stream, unpacked into a file without a name; an inner error is the number of bytes that
/// there are, too few. The stream's end and checksum are looked at where it holds no more than these.
pub(super) fn gunzip(path: &Path, bytes: &[u8], start: u64, end: u64) -> Result<Result<Data<'static>, u64>> {
    let mut file = scratch::file().map_err(|e| Error::io(std::env::temp_dir(), "create a file in", e))?;
    let mut stream = MultiGzDecoder::new(bytes).take(end.saturating_add(1));
    let mut buffer = vec![0; 1 << 20];
    let mut n = 0u64;
    loop {
        let got = match stream.read(&mut buffer) {
            Ok(0) => break,
            Ok(got) => got,
            Err(e) if e.kind() == std::io::ErrorKind::Interrupted => continue,
            Err(e) => return Err(Error::format(path, format!("gzip stream, after {n} bytes: {e}"))),
        };
        file.write_all(&buffer[..got]).map_err(|e| Error::io(std::env::temp_dir(), "write a file in", e))?;
        n += got as u64;
    }
    file.seek(SeekFrom::Start(0)).map_err(|e| Error::io(std::env::temp_dir(), "read a file in", e))?;
    if n < end {
        return Ok(Err(n));
    }
    Ok(Ok(Data::File { path: path.to_owned(), file, at: start, len: end - start }))
}

/// A stored value, as far as comparing goes.
pub(super) trait Sample: Copy + PartialOrd {
    fn to_f64(self) -> f64;

    /// The least and the greatest value that mean at least `iso`, where those between do, too; an inner None where no
    /// value does.
    fn solid_between(iso: f64, scale: Option<(f64, f64)>) -> Option<Option<(Self, Self)>>;
}

fn meaning(v: f64, scale: Option<(f64, f64)>) -> f64 {
    scale.map_or(v, |(slope, inter)| v * slope + inter)
}

macro_rules! integer_samples {
    ($($t:ident),*) => { $(
        impl Sample for $t {
            fn to_f64(self) -> f64 {
                self as f64
            }

            fn solid_between(iso: f64, scale: Option<(f64, f64)>) -> Option<Option<($t, $t)>> {
                let solid = |v: $t| meaning(v.to_f64(), scale) >= iso;
                // What a value means grows with it, or falls: a search for where it passes `iso`.
                let (mut no, mut yes) = match (solid($t::MIN), solid($t::MAX)) {
                    (true, true) => return Some(Some(($t::MIN, $t::MAX))),
                    (false, false) => return Some(None),
                    (false, true) => (i128::from($t::MIN), i128::from($t::MAX)),
                    (true, false) => (i128::from($t::MAX), i128::from($t::MIN)),
                };
                while (yes - no).abs() > 1 {
                    let mid = no + (yes - no) / 2;
                    *(if solid(mid as $t) { &mut yes } else { &mut no }) = mid;
                }
                Some(Some(if yes > no { (yes as $t, $t::MAX) } else { ($t::MIN, yes as $t) }))
            }
        }
    )* };
}
integer_samples!(u8, i8, u16, i16, u32, i32, u64, i64);

macro_rules! float_samples {
    ($($t:ident),*) => { $(
        impl Sample for $t {
            fn to_f64(self) -> f64 {
                f64::from(self)
            }

            /// `iso` in the precision of the values: 0.7 means the f32 nearest to 0.7 in a volume of f32.
            fn solid_between(iso: f64, scale: Option<(f64, f64)>) -> Option<Option<($t, $t)>> {
                scale.is_none().then_some(Some((iso as $t, $t::INFINITY)))
            }
        }
    )* };
}
float_samples!(f32, f64);

/// Turns a row of stored values into bits, 1 where solid: bit `i % 64` of word `i / 64`.
type Masks = Box<dyn Fn(&[u8], &mut [u64]) + Send + Sync>;

/// A volume whose columns can be made.
pub(super) struct Volume<'a> {
    /// Values along the file's axes, fastest first.
    stored: [u64; 3],
    size: u64,
    data: Data<'a>,
    masks: Masks,
    dims: [u32; 3],
    /// The file's axis of world x, y, z.
    axes: [usize; 3],
    /// Whether world z runs against its axis.
    flip_z: bool,
    pub(super) notes: Vec<String>,
    pub(super) about: About,
}

impl<'a> Volume<'a> {
    /// Which axis is up, and where a value is solid, from the options.
    pub(super) fn new(path: &Path, stored: Stored<'a>, opts: &ReadOptions) -> Result<Volume<'a>> {
        // World x, y, z as axes of the input.
        let (axes, flip_z) = match opts.up.unwrap_or_default() {
            Up::X => ([2, 0, 1], false),
            Up::Y => ([0, 1, 2], false),
            Up::Z => ([0, 2, 1], true),
        };
        let dims = world_dims(path, axes.map(|a| stored.dims[a]), "--up chooses another axis")?;
        let Stored { dtype, big_endian, scale, .. } = stored;
        let mut stored = stored;
        // In the precision of the values, as in text it has more digits or fewer.
        let missing = stored.missing.map(|v| if dtype == Dtype::F32 { f64::from(v as f32) } else { v });
        stored.missing = missing;
        let masks = match opts.iso {
            Some(iso) if iso.is_nan() => return Err(Error::Argument("--iso is not a number".to_owned())),
            Some(iso) => with_sample!(dtype, big_endian, |read| iso_masks(read, iso, scale, missing)),
            None if dtype == Dtype::U8 && scale.is_none() && missing.is_none() => masks(u8::from_le_bytes, |v| v > 0),
            // The least number above 0.
            None if dtype == Dtype::U8 => iso_masks(u8::from_le_bytes, f64::from_bits(1), scale, missing),
            None => {
                let (low, high) = with_sample!(dtype, big_endian, |read| range(&stored, read))?;
                return Err(Error::Argument(format!(
                    "{}: values range from {low} to {high}; give --iso V, voxels of at least V are solid",
                    path.display()
                )));
            }
        };
        let about = about_volume(&stored, axes, opts);
        let Stored { dims: [x, y, z], z_fastest, data, notes, .. } = stored;
        let (stored, axes) = if z_fastest { ([z, y, x], axes.map(|a| 2 - a)) } else { ([x, y, z], axes) };
        Ok(Volume { stored, size: dtype.size(), data, masks, dims, axes, flip_z, notes, about })
    }

    /// The same volume, its values read from the file at `path`, which holds `whole`.
    pub(super) fn in_file(self, path: &Path, whole: &[u8]) -> Result<Volume<'static>> {
        let Volume { stored, size, data, masks, dims, axes, flip_z, notes, about } = self;
        let data = data.in_file(path, whole)?;
        Ok(Volume { stored, size, data, masks, dims, axes, flip_z, notes, about })
    }

    /// Values `us` of row `v` of slice `w`, in the file's order.
    fn row<'b>(&'b self, us: Range<u64>, v: u64, w: u64, buffer: &'b mut Vec<u8>) -> Result<&'b [u8]> {
        let [nu, nv, _] = self.stored;
        let at = ((w * nv + v) * nu + us.start) * self.size;
        self.data.read(at, ((us.end - us.start) * self.size) as usize, buffer)
    }

    /// Calls `each` with values `us` of the rows `vs` of slice `w`, in stretches that fit a core's cache.
    fn rows(
        &self,
        us: Range<u64>,
        vs: Range<u64>,
        w: u64,
        buffer: &mut Vec<u8>,
        mut each: impl FnMut(u64, &[u8]),
    ) -> Result<()> {
        let [nu, ..] = self.stored;
        let n = us.end - us.start;
        let (stretch, wasteful) = self.data.stretch();
        let together = if wasteful || n == nu { (stretch / (nu * self.size)).max(1) } else { 1 };
        let mut v = vs.start;
        while v < vs.end {
            let end = vs.end.min(v + together);
            // Rows follow each other in the file, with what lies between their parts.
            let bytes = self.row(us.start..us.start + nu * (end - v - 1) + n, v, w, buffer)?;
            for (i, row) in bytes.chunks((nu * self.size) as usize).enumerate() {
                each(v + i as u64, &row[..(n * self.size) as usize]);
            }
            v = end;
        }
        Ok(())
    }

    /// Columns `us × vs`, axes of the file other than the up axis, the faster first.
    fn scan(&self, us: Range<u64>, vs: Range<u64>) -> Result<Columns> {
        let ny = self.dims[1];
        let (nu, nv) = ((us.end - us.start) as u32, (vs.end - vs.start) as u32);
        let words = nu.div_ceil(64) as usize;
        match self.axes[1] {
            // A row is a column.
            0 => {
                let parts: Vec<Columns> = vs
                    .into_par_iter()
                    .map(|w| {
                        let mut out = ColumnsBuilder::new(nu, ny, 1);
                        let mut bits = vec![0u64; (ny as usize).div_ceil(64)];
                        let mut buffer = Vec::new();
                        self.rows(0..self.stored[0], us.clone(), w, &mut buffer, |_, row| {
                            (self.masks)(row, &mut bits);
                            push_bits(&bits, ny, &mut out);
                            out.end_column();
                        })?;
                        Ok(out.finish())
                    })
                    .collect::<Result<_>>()?;
                Columns::concat([nu, ny, nv], &parts)
            }
            // A slice is a row of columns.
            1 => {
                let parts: Vec<Columns> = vs
                    .into_par_iter()
                    .map(|w| {
                        let mut layers = Layers::new(nu, 1);
                        let mut bits = vec![0u64; words];
                        let mut buffer = Vec::new();
                        self.rows(us.clone(), 0..u64::from(ny), w, &mut buffer, |y, row| {
                            (self.masks)(row, &mut bits);
                            layers.row(y as u32, 0, &bits);
                        })?;
                        Ok(layers.finish(ny, ny))
                    })
                    .collect::<Result<_>>()?;
                Columns::concat([nu, ny, nv], &parts)
            }
            // A slice is a layer of all columns.
            _ => {
                let slabs = (rayon::current_num_threads() as u32 * 2).min(ny.div_ceil(32));
                let cut = |slab: u32| (u64::from(slab) * u64::from(ny) / u64::from(slabs)) as u32;
                let slabs: Vec<Columns> = (0..slabs)
                    .into_par_iter()
                    .map(|slab| {
                        let mut layers = Layers::new(nu, nv);
                        let mut bits = vec![0u64; words];
                        let mut buffer = Vec::new();
                        for y in cut(slab)..cut(slab + 1) {
                            self.rows(us.clone(), vs.clone(), y.into(), &mut buffer, |v, row| {
                                (self.masks)(row, &mut bits);
                                layers.row(y, (v - vs.start) as u32, &bits);
                            })?;
                        }
                        Ok(layers.finish(cut(slab + 1), ny))
                    })
                    .collect::<Result<_>>()?;
                Columns::try_from_rows([nu, ny, nv], |v, out| {
                    for u in 0..nu {
                        // A run that goes on in the next slab touches it, and is merged.
                        slabs.iter().flat_map(|slab| slab.column(u, v)).for_each(|&run| out.push_run(run));
                        out.end_column();
                    }
                    Ok(())
                })
            }
        }
    }
}

/// Bytes read at once: what a core's cache holds.
const STRETCH: u64 = 256 << 10;
/// The same of an object elsewhere: what takes longer to come than to ask for.
#[cfg(feature = "object-store")]
const OBJECT_STRETCH: u64 = 8 << 20;

impl Pieces for Volume<'_> {
    fn dims(&self) -> [u32; 3] {
        self.dims
    }

    fn colored(&self) -> bool {
        false
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }

    fn about(&self) -> About {
        self.about.clone()
    }

    fn piece(&self, xs: Range<u32>, zs: Range<u32>) -> Result<Input> {
        let range = |r: &Range<u32>| u64::from(r.start)..u64::from(r.end);
        let nz = self.dims[2];
        let file_zs = if self.flip_z { nz - zs.end..nz - zs.start } else { zs.clone() };
        let x_is_faster = self.axes[0] < self.axes[2];
        let columns =
            if x_is_faster { self.scan(range(&xs), range(&file_zs)) } else { self.scan(range(&file_zs), range(&xs)) }?;
        let columns = if x_is_faster && !self.flip_z {
            columns
        } else {
            Columns::try_from_rows([xs.len() as u32, self.dims[1], zs.len() as u32], |z, out| {
                let z = if self.flip_z { zs.len() as u32 - 1 - z } else { z };
                for x in 0..xs.len() as u32 {
                    let column = if x_is_faster { columns.column(x, z) } else { columns.column(z, x) };
                    column.iter().for_each(|&run| out.push_run(run));
                    out.end_column();
                }
                Ok(())
            })?
        };
        Ok(Input { columns, colors: Colors::None, notes: Vec::new() })
    }

    fn input_bytes(&self) -> u64 {
        self.data.len()
    }

    /// Where a slice is a layer, rows enough that a stretch of them is worth going to.
    fn rows_together(&self) -> u32 {
        match self.axes[1] {
            1 => 1,
            _ => (LONG_STRETCH / (self.stored[0] * self.size)).clamp(1, 1 << 16) as u32,
        }
    }
}

/// Bytes after which going elsewhere in a file costs little beside reading them, on a disk that turns, too.
const LONG_STRETCH: u64 = 4 << 20;

/// [`Masks`] of values for which `solid` holds.
fn masks<T: Copy + 'static, const N: usize>(
    read: impl Fn([u8; N]) -> T + Send + Sync + 'static,
    solid: impl Fn(T) -> bool + Send + Sync + 'static,
) -> Masks {
    Box::new(move |bytes, out| {
        let (values, _) = bytes.as_chunks::<N>();
        let (words, rest) = values.as_chunks::<64>();
        for (out, values) in out.iter_mut().zip(words) {
            // One byte a value first: compilers know how to do that for many at once.
            let mut flags = [0; 64];
            for (flag, &value) in flags.iter_mut().zip(values) {
                *flag = u8::from(solid(read(value)));
            }
            *out = pack(&flags);
        }
        if !rest.is_empty() {
            let mut flags = [0; 64];
            for (flag, &value) in flags.iter_mut().zip(rest) {
                *flag = u8::from(solid(read(value)));
            }
            out[words.len()] = pack(&flags);
        }
    })
}

/// Bytes of 0 and 1 as bits, eight by one multiplication: bit `8·i` times `2^(56 − 7·i)` is bit `56 + i`, and no two
/// products meet.
fn pack(flags: &[u8; 64]) -> u64 {
    let eights = flags.as_chunks::<8>().0.iter().enumerate();
    eights.fold(0, |bits, (i, &eight)| {
        bits | (u64::from_le_bytes(eight).wrapping_mul(0x0102_0408_1020_4080) >> 56) << (8 * i)
    })
}

/// [`Masks`] of values that mean at least `iso`.
fn iso_masks<T: Sample + Send + Sync + 'static, const N: usize>(
    read: impl Fn([u8; N]) -> T + Send + Sync + 'static,
    iso: f64,
    scale: Option<(f64, f64)>,
    missing: Option<f64>,
) -> Masks {
    match (T::solid_between(iso, scale), missing) {
        (Some(Some((low, high))), None) => masks(read, move |v| low <= v && v <= high),
        (Some(Some((low, high))), Some(none)) => masks(read, move |v| low <= v && v <= high && v.to_f64() != none),
        (Some(None), _) => masks(read, |_| false),
        (None, None) => masks(read, move |v| meaning(v.to_f64(), scale) >= iso),
        (None, Some(none)) => masks(read, move |v| meaning(v.to_f64(), scale) >= iso && v.to_f64() != none),
    }
}

/// What a volume is, with its axes turned to the world's, and why voxels are solid.
fn about_volume(stored: &Stored, axes: [usize; 3], opts: &ReadOptions) -> About {
    let mut about = stored.about.clone();
    if about.format.is_empty() {
        return about;
    }
    about.voxel = about.voxel.map(|v| axes.map(|a| v[a]));
    if let Some(sides) = about.voxel.filter(|v| v[0] != v[1] || v[1] != v[2]) {
        let [x, y, z] = sides.map(|v| format!("{v:.5e}").parse().unwrap_or(v));
        let unit = if about.unit.is_empty() { "units" } else { &about.unit };
        about.left_out.push(format!("voxels of {x} × {y} × {z} {unit} are drawn as cubes"));
    }
    let up = ["x", "y", "z"][axes[1]];
    about.axes = match about.axes.as_str() {
        "" => format!("axis {up} is up"),
        of => format!("{of}, {up} is up"),
    };
    let solid = match opts.iso {
        Some(iso) => format!("solid where at least {iso}"),
        None => "solid above 0".to_owned(),
    };
    about.rule = if about.rule.is_empty() { solid } else { format!("{}; {solid}", about.rule) };
    about
}

/// Least and greatest value (NaN left out).
fn range<T: Sample, const N: usize>(stored: &Stored, read: impl Fn([u8; N]) -> T + Sync) -> Result<(f64, f64)> {
    const NONE: (f64, f64) = (f64::INFINITY, f64::NEG_INFINITY);
    let piece = (N as u64) << 16;
    let len = stored.data.len();
    let (slope, inter) = stored.scale.unwrap_or((1.0, 0.0));
    let missing = stored.missing.unwrap_or(f64::NAN);
    let (a, b) = (0..len.div_ceil(piece))
        .into_par_iter()
        .map(|i| {
            let mut buffer = Vec::new();
            let bytes = stored.data.read(i * piece, (len - i * piece).min(piece) as usize, &mut buffer)?;
            let (values, _) = bytes.as_chunks::<N>();
            Ok(values.iter().fold(NONE, |(low, high), &v| {
                let v = read(v).to_f64();
                if v == missing { (low, high) } else { (low.min(v), high.max(v)) }
            }))
        })
        .try_reduce(|| NONE, |a, b| Ok((a.0.min(b.0), a.1.max(b.1))))?;
    let (a, b) = (a * slope + inter, b * slope + inter);
    Ok((a.min(b), a.max(b)))
}

/// The runs of one column from its bits.
fn push_bits(bits: &[u64], ny: u32, out: &mut ColumnsBuilder) {
    let mut start = None;
    let mut below = 0;
    for (i, &word) in bits.iter().enumerate() {
        let mut changed = word ^ (word << 1 | below);
        below = word >> 63;
        while changed != 0 {
            let y = i as u32 * 64 + changed.trailing_zeros();
            match start.take() {
                None => start = Some(y),
                Some(first) => out.push_run(Run::new(first as u16, (y - 1) as u16)),
            }
            changed &= changed - 1;
        }
    }
    if let Some(first) = start {
        out.push_run(Run::new(first as u16, (ny - 1) as u16));
    }
}

/// Columns made from the bottom up, layer by layer. Rows are compared 64 voxels at a time with those of the layer
/// below: only changes cost more than that.
struct Layers {
    nu: u32,
    nv: u32,
    words: usize,
    below: Vec<u64>,
    /// Where the run that is open in a column began.
    start: Vec<u16>,
    found: Vec<(u32, Run)>,
    /// Runs found in a column; then, where they stand.
    offsets: Vec<u32>,
}

impl Layers {
    fn new(nu: u32, nv: u32) -> Layers {
        let words = nu.div_ceil(64) as usize;
        let n = nu as usize * nv as usize;
        Layers {
            nu,
            nv,
            words,
            below: vec![0; words * nv as usize],
            start: vec![0; n],
            found: Vec::new(),
            offsets: vec![0; n + 1],
        }
    }

    /// Row `v` of layer `y`; each row is given once a layer.
    #[inline]
    fn row(&mut self, y: u32, v: u32, bits: &[u64]) {
        let below = &mut self.below[v as usize * self.words..][..self.words];
        for (i, (below, &here)) in below.iter_mut().zip(bits).enumerate() {
            let mut changed = here ^ *below;
            *below = here;
            while changed != 0 {
                let bit = changed.trailing_zeros();
                let column = v * self.nu + i as u32 * 64 + bit;
                if here >> bit & 1 == 1 {
                    self.start[column as usize] = y as u16;
                } else {
                    self.found.push((column, Run::new(self.start[column as usize], (y - 1) as u16)));
                    self.offsets[column as usize + 1] += 1;
                }
                changed &= changed - 1;
            }
        }
    }

    /// The columns, `ny` high, after the layers below `end`.
    fn finish(mut self, end: u32, ny: u32) -> Columns {
        let air = vec![0; self.words];
        (0..self.nv).for_each(|v| self.row(end, v, &air));
        // A counting sort by column keeps each column's runs ascending.
        for column in 1..self.offsets.len() {
            self.offsets[column] += self.offsets[column - 1];
        }
        let mut next = self.offsets.clone();
        let mut runs = vec![Run::new(0, 0); self.found.len()];
        for (column, run) in self.found {
            runs[next[column as usize] as usize] = run;
            next[column as usize] += 1;
        }
        Columns::from_parts(self.nu, ny, self.nv, self.offsets, runs)
    }
}
