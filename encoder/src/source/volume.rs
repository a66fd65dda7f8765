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
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use flate2::read::MultiGzDecoder;
use rayon::prelude::*;

use super::measure::{Meant, Measured, Paint, Solid};
use super::place::{self, Along, Oriented, Place};
use super::relief::{Ramp, RampTable};
use super::{Dtype, ReadOptions, Up, world_dims};
use crate::model::about::{Kind, Short};
use crate::model::exposure;
use crate::model::grid::{Grid, Tints};
use crate::model::matter::{Classes, Matter, MatterBuilder, STEPS};
use crate::model::pieces::Pieces;
use crate::model::transfer::Transfer;
use crate::store::scratch::{self, File, read_at};
use crate::{About, Colors, Columns, ColumnsBuilder, Error, Input, Result, Rgb, Run, parallel};

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
        object: Box<crate::store::remote::Object>,
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

    /// The bytes from `at` on, to `out`.
    pub fn read_into(&self, at: u64, out: &mut [u8]) -> Result<()> {
        match self {
            Data::File { path, file, at: start, .. } => {
                read_at(file, out, start + at).map_err(|e| Error::io(path, "read", e))
            }
            _ => {
                let len = out.len();
                out.copy_from_slice(self.read(at, len, &mut Vec::new())?);
                Ok(())
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
    object: crate::store::remote::Object,
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
    if let [x, y, 0] = dims {
        let path = path.display();
        return Err(Error::Argument(format!(
            "{path}: --dims {x},{y}: a volume has three sides; expected --dims X,Y,Z"
        )));
    }
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
    let about = About::new(Kind::Volume, "raw volume");
    Ok(Stored { about, ..Stored::new(dims, dtype, Data::Slice(bytes)) })
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

/// Bytes `start..end` of a gzip stream: see [`unpack`].
pub(super) fn gunzip(path: &Path, bytes: &[u8], start: u64, end: u64) -> Result<Result<Data<'static>, u64>> {
    unpack(path, "gzip stream", MultiGzDecoder::new(bytes), start, end)
}

/// Bytes `start..end` of a stream, unpacked into a file without a name; an inner error is the number of bytes that there
/// are, too few. The stream's end and checksum are looked at where it holds no more than these.
pub(super) fn unpack(
    path: &Path,
    what: &str,
    stream: impl Read,
    start: u64,
    end: u64,
) -> Result<Result<Data<'static>, u64>> {
    let mut file = scratch::file().map_err(|e| Error::io(std::env::temp_dir(), "create a file in", e))?;
    let mut stream = stream.take(end.saturating_add(1));
    let mut buffer = vec![0; 1 << 20];
    let mut n = 0u64;
    loop {
        let got = match stream.read(&mut buffer) {
            Ok(0) => break,
            Ok(got) => got,
            Err(e) if e.kind() == std::io::ErrorKind::Interrupted => continue,
            Err(e) => return Err(Error::format(path, format!("{what}, after {n} bytes: {e}"))),
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

/// Appends what stored values mean.
type Decode = Box<dyn Fn(&[u8], &mut Vec<f64>) + Send + Sync>;

/// What a header says of a volume beside what is said of it ([`Stored::about`]).
#[derive(Debug, Default)]
pub(super) struct Facts {
    pub place: Option<Place>,
    /// The file's axis that is x, y, z of the input, where that is another order.
    pub order: Option<[usize; 3]>,
    /// Whether a sample of the values says what is solid, and gives colours ([`super::measure`]). Else bytes are solid above
    /// 0, and other values need `--iso`.
    pub measured: bool,
    pub labels: bool,
    pub density: bool,
}

/// A volume whose columns can be made.
pub(super) struct Volume<'a> {
    /// Values along the file's axes, fastest first.
    stored: [u64; 3],
    /// Voxels of the world along the same axes.
    along: [Along; 3],
    between: Between,
    size: u64,
    data: Data<'a>,
    masks: Masks,
    decode: Decode,
    /// Which values are solid, where they are not as stored.
    solid: Solid,
    paint: Paint,
    /// In place of the colours of [`Paint::Ramp`]: those of `--ramp`, over the values and as shares of them.
    ramp: Option<Arc<[RampTable; 2]>>,
    dims: [u32; 3],
    /// The file's axis of world x, y, z.
    axes: [usize; 3],
    /// Whether the world's axis runs against the file's.
    flips: [bool; 3],
    pub(super) notes: Vec<String>,
    pub(super) about: About,
}

/// What stands between values of the file.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Between {
    /// Nothing: a voxel is a value.
    Nothing,
    /// The nearest.
    Nearest,
    /// What lies on straight lines between them.
    Linear,
}

/// A row of values.
#[derive(Clone, Copy)]
enum Row<'a> {
    Stored(&'a [u8]),
    /// As they are meant.
    Meant(&'a [f64]),
}

/// What reading rows needs to remember.
#[derive(Default)]
struct Buffers {
    bytes: Vec<u8>,
    gathered: Vec<u8>,
    /// Rows of the file that values were found between, with their numbers.
    lines: [(u64, Vec<f64>); 2],
    other: Vec<f64>,
    mixed: Vec<f64>,
    row: Vec<f64>,
}

impl<'a> Volume<'a> {
    /// Which axis is up, and where a value is solid, from the options.
    pub(super) fn new(path: &Path, stored: Stored<'a>, opts: &ReadOptions) -> Result<Volume<'a>> {
        Volume::with(path, stored, Facts::default(), opts)
    }

    /// The same, as far as the header does not say it.
    pub(super) fn with(path: &Path, stored: Stored<'a>, facts: Facts, opts: &ReadOptions) -> Result<Volume<'a>> {
        if opts.iso.is_some_and(f64::is_nan) {
            return Err(Error::Argument("--iso is not a number".to_owned()));
        }
        let Stored { dims: [x, y, z], z_fastest, dtype, big_endian, scale, missing, data, notes, about: said } = stored;
        // In the precision of the values, as in text it has more digits or fewer.
        let missing = missing.map(|v| if dtype == Dtype::F32 { f64::from(v as f32) } else { v });
        let (stored, order) = if z_fastest { ([z, y, x], [2, 1, 0]) } else { ([x, y, z], [0, 1, 2]) };
        let order = facts.order.unwrap_or(order);
        let Facts { mut place, measured, labels, density, .. } = facts;
        let mut left_out = said.left_out.clone();
        if let Some(sides) = said.voxel.filter(|_| place.is_none()) {
            let mut spacing = [0.0; 3];
            (0..3).for_each(|k| spacing[order[k]] = sides[k]);
            match Place::spaced(spacing, [0.0; 3]).checked() {
                Ok(spaced) => place = Some(spaced),
                Err(what) => left_out.push(what),
            }
        }
        // Who says how large voxels are has pictured something.
        let measured = measured || said.voxel.is_some();

        // World x, y, z as axes of the file.
        let (axes, flips, words) = match (opts.up, &place) {
            (None, Some(place)) if !place.stated.is_empty() => {
                let Oriented { axes, flips, words } = place.orient();
                (axes, flips, words)
            }
            (up, place) => {
                let (axes, flip_z, words) = match up.unwrap_or_default() {
                    Up::X => ([2, 0, 1], false, "axis x is up"),
                    Up::Y => ([0, 1, 2], false, "axis y is up"),
                    Up::Z => ([0, 2, 1], true, "axis z is up"),
                };
                if let Some(place) = place.as_ref().filter(|p| p.anatomy) {
                    let mirror = if place.mirrored() { ", a mirror image" } else { "" };
                    left_out.push(format!(
                        "the orientation by its {}, {}: --up was given{mirror}",
                        place.stated,
                        place.letters()
                    ));
                }
                let words = match said.axes.as_str() {
                    "" => words.to_owned(),
                    of => format!("{of}, {}", words.trim_start_matches("axis ")),
                };
                (axes.map(|a| order[a]), [false, false, flip_z], words)
            }
        };

        let stated = place.as_ref().map(Place::spacing);
        let spacing = place::spacing(stated, opts.spacing, order);
        let along = spacing.map_or_else(|| stored.map(Along::as_stored), |spacing| place::cubes(stored, spacing));
        let hint = if along.iter().all(Along::is_as_stored) {
            "--up chooses another axis"
        } else {
            "--spacing as-is draws voxels as cubes"
        };
        let dims = world_dims(path, axes.map(|a| along[a].n), hint)?;

        let size = dtype.size();
        let decode: Decode = with_sample!(dtype, big_endian, |read| decoder(read, scale, missing));
        let clear = opts.classes.is_some() && opts.iso.is_none();
        let (solid, mut paint, rule, values) = if clear {
            let found = Measured::of(&data, size, &*decode)?;
            // No value is at least what is no number.
            (Solid::AtLeast(f64::NAN), Paint::None, "nothing is solid (--iso)".to_owned(), found.range())
        } else if measured {
            let found = Measured::of(&data, size, &*decode)?;
            let is_float = matches!(dtype, Dtype::F32 | Dtype::F64);
            let zero = !is_float && scale.is_some_and(|(_, inter)| size == 1 || inter != 0.0);
            let meant = Meant { labels, scaled: scale.is_some(), zero, bytes: size == 1, density };
            let (solid, paint, rule) = found.rule(opts.iso, &meant);
            (solid, paint, rule, found.range())
        } else {
            match opts.iso {
                Some(iso) => (Solid::AtLeast(iso), Paint::None, format!("solid where at least {iso}"), None),
                None if dtype == Dtype::U8 && scale.is_none() => {
                    (Solid::NotZero, Paint::None, "solid above 0".to_owned(), None)
                }
                None if dtype == Dtype::U8 => (Solid::ABOVE_0, Paint::None, "solid above 0".to_owned(), None),
                None => {
                    let (low, high) = with_sample!(dtype, big_endian, |read| range(&data, scale, missing, read))?;
                    return Err(Error::Argument(format!(
                        "{}: values range from {low} to {high}; give --iso V, voxels of at least V are solid",
                        path.display()
                    )));
                }
            }
        };
        let mut rule = rule;
        let mut classes = None;
        if let Some(n) = opts.classes {
            let range = values.or(Measured::of(&data, size, &*decode)?.range()).unwrap_or([0.0, 1.0]);
            let [low, high] = opts.window.unwrap_or(range);
            // Values that are all the same have a step as any others.
            let window = if low < high { [low, high] } else { [low, low + 1.0] };
            rule = format!("{rule}; {n} steps of matter from {} to {} (--window)", Short(window[0]), Short(window[1]));
            classes = Some(Transfer::usual().classes(window, n.into()));
        }
        let mut ramp = None;
        if let Some(name) = opts.ramp.as_ref().filter(|_| !clear) {
            if paint == Paint::None && !measured {
                let least = if let Solid::AtLeast(least) = solid { least } else { f64::from_bits(1) };
                paint = Measured::of(&data, size, &*decode)?.rule(Some(least), &Meant::default()).1;
            }
            match (Ramp::find(name)?, paint) {
                (Some(of), Paint::Ramp(low, high)) => {
                    // A surface is mostly of values near the threshold, and shading shows on nothing black.
                    let begin = low - DARK * (high - low);
                    ramp = Some(Arc::new([of.over(begin, high), of.over(-DARK, 1.0)]));
                }
                (None, Paint::Ramp(..)) => paint = Paint::None,
                (_, Paint::Labels) => left_out.push("--ramp: labels have a colour each".to_owned()),
                (_, Paint::None) => left_out.push("--ramp: values are not different enough".to_owned()),
            }
        }
        let masks = match solid {
            Solid::AtLeast(iso) => with_sample!(dtype, big_endian, |read| iso_masks(read, iso, scale, missing)),
            Solid::NotZero if dtype == Dtype::U8 && scale.is_none() && missing.is_none() => {
                masks(u8::from_le_bytes, |v| v > 0)
            }
            Solid::NotZero => with_sample!(dtype, big_endian, |read| {
                masks(read, move |v| {
                    let v = v.to_f64();
                    Some(v) != missing && Solid::NotZero.holds(meaning(v, scale))
                })
            }),
        };
        let between = match (along.iter().all(Along::is_as_stored), solid) {
            (true, _) => Between::Nothing,
            (false, Solid::NotZero) => Between::Nearest,
            (false, Solid::AtLeast(_)) => Between::Linear,
        };

        let mut about = said;
        about.classes = classes.map(Arc::new);
        if !about.format.is_empty() {
            about.kind = Some(if paint == Paint::Labels { Kind::Labels } else { Kind::Volume });
            about.rule = if about.rule.is_empty() { rule } else { format!("{}; {rule}", about.rule) };
            (about.axes, about.values, about.left_out) = (words, values, left_out);
            let known = spacing.or(stated);
            let sides = known.unwrap_or([1.0; 3]);
            about.voxel = known.map(|sides| axes.map(|f| sides[f] * along[f].step()));
            let unit = if about.unit.is_empty() { "units" } else { &about.unit };
            if between != Between::Nothing {
                let [x, y, z] = stored;
                let [a, b, c] = sides;
                let how = if between == Between::Nearest { "the nearest" } else { "linearly" };
                about.axes.push_str(&format!(
                    "; {x} × {y} × {z} voxels of {a} × {b} × {c} {unit} become cubes, taken {how} (--spacing as-is: they are drawn as cubes)"
                ));
            } else if spacing.is_none() && known.is_some() && place::cubes(stored, sides) != along {
                let [a, b, c] = axes.map(|f| sides[f]);
                about.left_out.push(format!("voxels of {a} × {b} × {c} {unit} are drawn as cubes (--spacing as-is)"));
            }
            about.affine = place.as_ref().map(|place| affine(place, &along, axes, flips)).or(about.affine);
        }
        Ok(Volume {
            stored,
            along,
            between,
            size,
            data,
            masks,
            decode,
            solid,
            paint,
            ramp,
            dims,
            axes,
            flips,
            notes,
            about,
        })
    }

    /// The same volume, its values read from the file at `path`, which holds `whole`.
    pub(super) fn in_file(self, path: &Path, whole: &[u8]) -> Result<Volume<'static>> {
        let data = self.data.in_file(path, whole)?;
        let Volume {
            stored,
            along,
            between,
            size,
            masks,
            decode,
            solid,
            paint,
            ramp,
            dims,
            axes,
            flips,
            notes,
            about,
            ..
        } = self;
        Ok(Volume {
            stored,
            along,
            between,
            size,
            data,
            masks,
            decode,
            solid,
            paint,
            ramp,
            dims,
            axes,
            flips,
            notes,
            about,
        })
    }

    /// Values `us` of row `v` of slice `w`, in the file's order.
    fn row<'b>(&'b self, us: Range<u64>, v: u64, w: u64, buffer: &'b mut Vec<u8>) -> Result<&'b [u8]> {
        let [nu, nv, _] = self.stored;
        let at = ((w * nv + v) * nu + us.start) * self.size;
        self.data.read(at, ((us.end - us.start) * self.size) as usize, buffer)
    }

    /// Calls `each` with voxels `us` of the rows `vs` of slice `w` along the file's axes.
    fn rows(
        &self,
        us: Range<u64>,
        vs: Range<u64>,
        w: u64,
        buffers: &mut Buffers,
        each: impl FnMut(u64, Row),
    ) -> Result<()> {
        match self.between {
            Between::Nothing => self.stored_rows(us, vs, w, &mut buffers.bytes, each),
            Between::Nearest => self.nearest_rows(us, vs, w, buffers, each),
            Between::Linear => self.linear_rows(us, vs, w, buffers, each),
        }
    }

    /// The same of values as they are stored, in stretches that fit a core's cache.
    fn stored_rows(
        &self,
        us: Range<u64>,
        vs: Range<u64>,
        w: u64,
        buffer: &mut Vec<u8>,
        mut each: impl FnMut(u64, Row),
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
                each(v + i as u64, Row::Stored(&row[..(n * self.size) as usize]));
            }
            v = end;
        }
        Ok(())
    }

    /// The same of the nearest values.
    fn nearest_rows(
        &self,
        us: Range<u64>,
        vs: Range<u64>,
        w: u64,
        buffers: &mut Buffers,
        mut each: impl FnMut(u64, Row),
    ) -> Result<()> {
        let [u_axis, v_axis, w_axis] = self.along;
        let from = u_axis.nearest(us.start);
        let end = u_axis.nearest(us.end - 1) + 1;
        let (w, size) = (w_axis.nearest(w), self.size as usize);
        let Buffers { bytes, gathered, .. } = buffers;
        let mut last = None;
        for v in vs {
            let of = v_axis.nearest(v);
            if last != Some(of) {
                let row = self.row(from..end, of, w, bytes)?;
                gathered.clear();
                for u in us.clone() {
                    let at = (u_axis.nearest(u) - from) as usize * size;
                    gathered.extend_from_slice(&row[at..at + size]);
                }
                last = Some(of);
            }
            each(v, Row::Stored(gathered));
        }
        Ok(())
    }

    /// The same of what lies on straight lines between values along each axis, one after the other.
    fn linear_rows(
        &self,
        us: Range<u64>,
        vs: Range<u64>,
        w: u64,
        buffers: &mut Buffers,
        mut each: impl FnMut(u64, Row),
    ) -> Result<()> {
        let [u_axis, v_axis, w_axis] = self.along;
        let (from, end) = (u_axis.between(us.start).0, u_axis.between(us.end - 1).1 + 1);
        let (w0, w1, w_part) = w_axis.between(w);
        let Buffers { bytes, lines, other, mixed, row, .. } = buffers;
        lines.iter_mut().for_each(|(v, _)| *v = u64::MAX);
        let mut load = |v: u64, out: &mut Vec<f64>| -> Result<()> {
            out.clear();
            (self.decode)(self.row(from..end, v, w0, bytes)?, out);
            if w_part > 0.0 {
                other.clear();
                (self.decode)(self.row(from..end, v, w1, bytes)?, other);
                out.iter_mut().zip(&*other).for_each(|(a, b)| *a = mix(*a, *b, w_part));
            }
            Ok(())
        };
        for v in vs {
            let (v0, v1, v_part) = v_axis.between(v);
            // The line that both need is kept.
            if lines[0].0 != v0 {
                lines.swap(0, 1);
            }
            if lines[0].0 != v0 {
                load(v0, &mut lines[0].1)?;
                lines[0].0 = v0;
            }
            let line = if v_part > 0.0 {
                if lines[1].0 != v1 {
                    load(v1, &mut lines[1].1)?;
                    lines[1].0 = v1;
                }
                mixed.clear();
                mixed.extend(lines[0].1.iter().zip(&lines[1].1).map(|(a, b)| mix(*a, *b, v_part)));
                &*mixed
            } else {
                &lines[0].1
            };
            if u_axis.is_as_stored() {
                // The last voxel has one after it, which nobody asked for.
                each(v, Row::Meant(&line[..(us.end - us.start) as usize]));
                continue;
            }
            row.clear();
            row.extend(us.clone().map(|u| {
                let (u0, u1, u_part) = u_axis.between(u);
                mix(line[(u0 - from) as usize], line[(u1 - from) as usize], u_part)
            }));
            each(v, Row::Meant(row));
        }
        Ok(())
    }

    /// Sets the bits of voxels that are solid.
    fn mask(&self, row: Row, bits: &mut [u64]) {
        match row {
            Row::Stored(bytes) => (self.masks)(bytes, bits),
            Row::Meant(values) => {
                for (bits, values) in bits.iter_mut().zip(values.chunks(64)) {
                    let solid = values.iter().enumerate().map(|(i, &v)| u64::from(self.solid.holds(v)) << i);
                    *bits = solid.fold(0, |a, b| a | b);
                }
            }
        }
    }

    /// What voxel `i` of a row means.
    fn value(&self, row: Row, i: usize, one: &mut Vec<f64>) -> f64 {
        match row {
            Row::Meant(values) => values[i],
            Row::Stored(bytes) => {
                let size = self.size as usize;
                one.clear();
                (self.decode)(&bytes[i * size..(i + 1) * size], one);
                one[0]
            }
        }
    }

    /// Colours of those voxels of a piece that may be seen: rows are read once more, what lies inside costs nothing.
    fn colors(&self, xs: Range<u32>, zs: Range<u32>, columns: &Columns) -> Result<Colors> {
        let seen = exposure::exposed(columns);
        let [nx, ny, nz] = columns.dims();
        let mut offsets = Vec::with_capacity(nx as usize * nz as usize + 1);
        let mut ys: Vec<u16> = Vec::new();
        offsets.push(0u32);
        for ix in 0..nx as usize * nz as usize {
            ys.extend(seen.runs()[seen.range(ix)].iter().flat_map(|run| run.first()..=run.last()));
            let end = u32::try_from(ys.len())
                .map_err(|_| Error::Limit("more coloured voxels than a piece holds".to_owned()))?;
            offsets.push(end);
        }
        // Threads meet in no voxel; that the compiler cannot know.
        let found: Vec<AtomicU32> = ys.iter().map(|_| AtomicU32::new(0)).collect();
        let put = |at: usize, value: f64| {
            let [r, g, b] = match &self.ramp {
                Some(ramp) => rounded(ramp[0].tint(value)),
                None => self.paint.color(value),
            };
            found[at].store(u32::from_le_bytes([r, g, b, 0]), Ordering::Relaxed);
        };
        let [x_axis, y_axis, z_axis] = self.axes;
        let range = |k: usize, of: &Range<u32>| {
            let n = self.along[self.axes[k]].n;
            let (start, end) = (u64::from(of.start), u64::from(of.end));
            if self.flips[k] { n - end..n - start } else { start..end }
        };
        let ranges = {
            let mut ranges = [0..0, 0..0, 0..0];
            ranges[x_axis] = range(0, &xs);
            ranges[y_axis] = 0..u64::from(ny);
            ranges[z_axis] = range(2, &zs);
            ranges
        };
        let [us, vs, ws] = ranges;
        // From places along the file's axes to the piece's.
        let start = [us.start, vs.start, ws.start];
        let world = |k: usize, place: [u64; 3]| {
            let i = (place[self.axes[k]] - start[self.axes[k]]) as u32;
            let n = [nx, ny, nz][k];
            if self.flips[k] { n - 1 - i } else { i }
        };
        let column = |place: [u64; 3]| world(2, place) as usize * nx as usize + world(0, place) as usize;
        let count = |ix: usize| (offsets[ix + 1] - offsets[ix]) as usize;
        // The `done`-th voxel that the file comes to in a column.
        let next = |ix: usize, done: u32| match self.flips[1] {
            false => (offsets[ix] + done) as usize,
            true => (offsets[ix + 1] - 1 - done) as usize,
        };
        let read = |us: Range<u64>, vs: Range<u64>, ws: Range<u64>| -> Result<()> {
            let (mut buffers, mut one) = (Buffers::default(), Vec::new());
            let width = (us.end - us.start) as usize;
            let lines = if y_axis == 1 { 1 } else { (vs.end - vs.start) as usize };
            let mut done = vec![0u32; width * lines];
            for w in ws {
                let first = vs.start;
                self.rows(us.clone(), vs.clone(), w, &mut buffers, |v, row| {
                    if y_axis == 0 {
                        let ix = column([us.start, v, w]);
                        let places = offsets[ix] as usize..offsets[ix + 1] as usize;
                        for (&y, at) in ys[places.clone()].iter().zip(places) {
                            let y = u32::from(y);
                            let u = if self.flips[1] { ny - 1 - y } else { y };
                            put(at, self.value(row, u as usize, &mut one));
                        }
                        return;
                    }
                    let y = world(1, [us.start, v, w]) as u16;
                    let line = if y_axis == 1 { 0 } else { (v - first) as usize * width };
                    for (i, done) in done[line..line + width].iter_mut().enumerate() {
                        let ix = column([us.start + i as u64, v, w]);
                        if (*done as usize) < count(ix) {
                            let at = next(ix, *done);
                            if ys[at] == y {
                                put(at, self.value(row, i, &mut one));
                                *done += 1;
                            }
                        }
                    }
                })?;
            }
            Ok(())
        };
        // Columns are never parted: of slices that are layers, rows are.
        match y_axis {
            2 => {
                let band = (vs.end - vs.start).div_ceil(rayon::current_num_threads() as u64 * 2).max(1);
                let bands: Vec<u64> = (vs.start..vs.end).step_by(band as usize).collect();
                let read = |i: usize| read(us.clone(), bands[i]..vs.end.min(bands[i] + band), ws.clone());
                parallel::try_each(bands.len(), read)?;
            }
            _ => {
                let at = |i: usize| ws.start + i as u64;
                let n = (ws.end - ws.start) as usize;
                parallel::try_each(n, |i| read(us.clone(), vs.clone(), at(i)..at(i) + 1))?;
            }
        }
        let entries = ys.iter().zip(&found).map(|(&y, found)| {
            let [r, g, b, _] = found.load(Ordering::Relaxed).to_le_bytes();
            (y, [r, g, b])
        });
        let entries = entries.collect();
        Ok(Colors::Voxel { offsets, entries })
    }

    /// The steps of values of the columns `xs × zs`.
    fn steps(&self, xs: Range<u32>, zs: Range<u32>, classes: &Classes) -> Result<Matter> {
        let Some([low, high]) = classes.window else { unreachable!("classes of values") };
        let (ny, width, n) = (self.dims[1], xs.len(), classes.classes.len());
        let per = n as f64 / (high - low);
        let class = |v: f64| match v > low {
            true => (((v - low) * per) as usize).min(n - 1) as u16 + 1,
            // No number, too.
            false => 0,
        };
        // Some rows at a time, as bytes of all heights.
        let rows = (STEPS_AT_ONCE / (2 * width * ny as usize)).clamp(1, zs.len()) as u32;
        let parts: Vec<Range<u32>> = zs.clone().step_by(rows as usize).map(|z| z..zs.end.min(z + rows)).collect();
        let part = |zs: &Range<u32>| {
            let mut ranges = [0..0, 0..0, 0..0];
            // From places along the file's axes to those of `found`: heights first, then x, then z.
            let (mut first, mut stride) = (0i64, [0i64; 3]);
            let sides = [(0, xs.clone(), i64::from(ny)), (1, 0..ny, 1), (2, zs.clone(), i64::from(ny) * width as i64)];
            for (k, of, step) in sides {
                let f = self.axes[k];
                let (start, end, n) = (u64::from(of.start), u64::from(of.end), self.along[f].n);
                let flips = self.flips[k];
                ranges[f] = if flips { n - end..n - start } else { start..end };
                stride[f] = if flips { -step } else { step };
                first += if flips { step * (of.len() as i64 - 1) } else { 0 };
            }
            let [us, vs, ws] = ranges;
            let mut found = vec![0u16; width * ny as usize * zs.len()];
            let (mut buffers, mut values) = (Buffers::default(), Vec::new());
            for w in ws.clone() {
                self.rows(us.clone(), vs.clone(), w, &mut buffers, |v, row| {
                    values.clear();
                    match row {
                        Row::Stored(bytes) => (self.decode)(bytes, &mut values),
                        Row::Meant(of) => values.extend_from_slice(of),
                    }
                    let mut at = first + stride[1] * (v - vs.start) as i64 + stride[2] * (w - ws.start) as i64;
                    for &value in &values {
                        found[at as usize] = class(value);
                        at += stride[0];
                    }
                })?;
            }
            let mut out = MatterBuilder::new(width as u32, ny, zs.len() as u32);
            for column in found.chunks_exact(ny as usize) {
                column.chunk_by(|a, b| a == b).for_each(|same| out.push(same.len() as u32, same[0] * STEPS));
                out.end_column();
            }
            Ok(out.finish())
        };
        let parts: Vec<Matter> = parallel::try_map(parts.len(), |i| part(&parts[i]))?;
        Matter::concat([width as u32, ny, zs.len() as u32], &parts)
    }

    /// Columns `us × vs`, axes of the file other than the up axis, the faster first.
    fn scan(&self, us: Range<u64>, vs: Range<u64>) -> Result<Columns> {
        let ny = self.dims[1];
        let (nu, nv) = ((us.end - us.start) as u32, (vs.end - vs.start) as u32);
        let words = nu.div_ceil(64) as usize;
        let at = |i: usize| vs.start + i as u64;
        match self.axes[1] {
            // A row is a column.
            0 => {
                let parts: Vec<Columns> = parallel::try_map(nv as usize, |i| {
                    let mut out = ColumnsBuilder::new(nu, ny, 1);
                    let mut bits = vec![0u64; (ny as usize).div_ceil(64)];
                    let mut buffer = Buffers::default();
                    self.rows(0..self.along[0].n, us.clone(), at(i), &mut buffer, |_, row| {
                        self.mask(row, &mut bits);
                        push_bits(&bits, ny, &mut out);
                        out.end_column();
                    })?;
                    Ok(out.finish())
                })?;
                Columns::concat([nu, ny, nv], &parts)
            }
            // A slice is a row of columns.
            1 => {
                let parts: Vec<Columns> = parallel::try_map(nv as usize, |i| {
                    let mut layers = Layers::new(nu, 1);
                    let mut bits = vec![0u64; words];
                    let mut buffer = Buffers::default();
                    self.rows(us.clone(), 0..u64::from(ny), at(i), &mut buffer, |y, row| {
                        self.mask(row, &mut bits);
                        layers.row(y as u32, 0, &bits);
                    })?;
                    Ok(layers.finish(ny, ny))
                })?;
                Columns::concat([nu, ny, nv], &parts)
            }
            // A slice is a layer of all columns.
            _ => {
                let slabs = (rayon::current_num_threads() as u32 * 2).min(ny.div_ceil(32));
                let cut = |slab: u32| (u64::from(slab) * u64::from(ny) / u64::from(slabs)) as u32;
                let slabs: Vec<Columns> = parallel::try_map(slabs as usize, |slab| {
                    let slab = slab as u32;
                    let mut layers = Layers::new(nu, nv);
                    let mut bits = vec![0u64; words];
                    let mut buffer = Buffers::default();
                    for y in cut(slab)..cut(slab + 1) {
                        self.rows(us.clone(), vs.clone(), y.into(), &mut buffer, |v, row| {
                            self.mask(row, &mut bits);
                            layers.row(y, (v - vs.start) as u32, &bits);
                        })?;
                    }
                    Ok(layers.finish(cut(slab + 1), ny))
                })?;
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

/// Bytes of steps that a thread finds at once.
const STEPS_AT_ONCE: usize = 16 << 20;
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
        self.paint != Paint::None
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }

    fn about(&self) -> About {
        self.about.clone()
    }

    fn matter(&self, xs: Range<u32>, zs: Range<u32>) -> Result<Option<Matter>> {
        self.about.classes.as_ref().map(|classes| self.steps(xs, zs, classes)).transpose()
    }

    fn piece(&self, xs: Range<u32>, zs: Range<u32>) -> Result<Input> {
        let [nx, ny, nz] = self.dims;
        let range = |of: &Range<u32>, n: u32, flip: bool| {
            let of = if flip { n - of.end..n - of.start } else { of.clone() };
            u64::from(of.start)..u64::from(of.end)
        };
        let [flip_x, flip_y, flip_z] = self.flips;
        let (file_xs, file_zs) = (range(&xs, nx, flip_x), range(&zs, nz, flip_z));
        let x_is_faster = self.axes[0] < self.axes[2];
        let columns = if x_is_faster { self.scan(file_xs, file_zs) } else { self.scan(file_zs, file_xs) }?;
        let columns = if x_is_faster && self.flips == [false; 3] {
            columns
        } else {
            Columns::try_from_rows([xs.len() as u32, ny, zs.len() as u32], |z, out| {
                let z = if flip_z { zs.len() as u32 - 1 - z } else { z };
                for x in 0..xs.len() as u32 {
                    let x = if flip_x { xs.len() as u32 - 1 - x } else { x };
                    let column = if x_is_faster { columns.column(x, z) } else { columns.column(z, x) };
                    if flip_y {
                        let turned = |y: u16| (ny - 1 - u32::from(y)) as u16;
                        column
                            .iter()
                            .rev()
                            .for_each(|run| out.push_run(Run::new(turned(run.last()), turned(run.first()))));
                    } else {
                        column.iter().for_each(|&run| out.push_run(run));
                    }
                    out.end_column();
                }
                Ok(())
            })?
        };
        let colors = if self.colored() { self.colors(xs, zs, &columns)? } else { Colors::None };
        Ok(Input { columns, colors, notes: Vec::new() })
    }

    fn input_bytes(&self) -> u64 {
        self.data.len()
    }

    fn grid(&self, most: u64) -> Result<Option<Grid>> {
        if self.dims.iter().map(|&n| u64::from(n)).product::<u64>() > most {
            return Ok(None);
        }
        let [nu, nv, nw] = [0, 1, 2].map(|f| self.along[f].n);
        let slices: Vec<Vec<f32>> = parallel::try_map(nw as usize, |w| {
            let (mut slice, mut meant) = (Vec::with_capacity((nu * nv) as usize), Vec::new());
            self.rows(0..nu, 0..nv, w as u64, &mut Buffers::default(), |_, row| {
                let values = match row {
                    Row::Meant(values) => values,
                    Row::Stored(bytes) => {
                        meant.clear();
                        (self.decode)(bytes, &mut meant);
                        &meant
                    }
                };
                slice.extend(values.iter().map(|&v| v as f32));
            })?;
            Result::Ok(slice)
        })?;
        let [nx, ny, _] = self.dims.map(|n| n as usize);
        let mut values = vec![f32::NAN; nx * ny * self.dims[2] as usize];
        // The file's place of a world's, along each axis.
        let place = |k: usize, v: usize| if self.flips[k] { self.dims[k] as usize - 1 - v } else { v };
        values.par_chunks_mut(nx * ny).enumerate().for_each(|(z, layer)| {
            let mut at = [0; 3];
            at[self.axes[2]] = place(2, z);
            for (x, column) in layer.chunks_mut(ny).enumerate() {
                at[self.axes[0]] = place(0, x);
                for (y, value) in column.iter_mut().enumerate() {
                    at[self.axes[1]] = place(1, y);
                    *value = slices[at[2]][at[1] * nu as usize + at[0]];
                }
            }
        });
        let tints = match (self.paint, &self.ramp) {
            (Paint::None, _) => Tints::None,
            (Paint::Labels, _) => Tints::Value(Arc::new(|v| Paint::Labels.color(v))),
            (Paint::Ramp(..), None) => Tints::Share(Arc::new(Paint::share)),
            (Paint::Ramp(..), Some(ramp)) => {
                let ramp = Arc::clone(ramp);
                Tints::Share(Arc::new(move |t| rounded(ramp[1].tint(t))))
            }
        };
        Ok(Some(Grid::new(self.dims, values, tints)))
    }

    /// Where a slice is a layer, rows enough that a stretch of them is worth going to.
    fn rows_together(&self) -> u32 {
        match self.axes[1] {
            1 => 1,
            _ => (LONG_STRETCH / (self.stored[0] * self.size)).clamp(1, 1 << 16) as u32,
        }
    }
}

/// Of the values that are shown, how many more a ramp has colours for below them.
const DARK: f64 = 0.35;

fn rounded(color: [f64; 3]) -> Rgb {
    color.map(|c| c.round().clamp(0.0, 255.0) as u8)
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

/// [`Decode`] of values that `read` makes of bytes.
fn decoder<T: Sample + 'static, const N: usize>(
    read: impl Fn([u8; N]) -> T + Send + Sync + 'static,
    scale: Option<(f64, f64)>,
    missing: Option<f64>,
) -> Decode {
    let of = move |v: f64| if Some(v) == missing { f64::NAN } else { meaning(v, scale) };
    Box::new(move |bytes, out| out.extend(bytes.as_chunks::<N>().0.iter().map(|&b| of(read(b).to_f64()))))
}

/// What lies between `a` and `b`.
fn mix(a: f64, b: f64, part: f64) -> f64 {
    if part == 0.0 { a } else { a + (b - a) * part }
}

/// From places in the world, in voxels, to coordinates of the source.
fn affine(place: &Place, along: &[Along; 3], axes: [usize; 3], flips: [bool; 3]) -> [[f64; 4]; 3] {
    let mut rows = [0, 1, 2].map(|c| [0.0, 0.0, 0.0, place.origin[c]]);
    for (k, (f, flip)) in axes.into_iter().zip(flips).enumerate() {
        let step = along[f].step();
        let first = if flip { along[f].n as f64 * step } else { 0.0 } - 0.5;
        for (c, row) in rows.iter_mut().enumerate() {
            row[k] = place.steps[f][c] * if flip { -step } else { step };
            row[3] += place.steps[f][c] * first;
        }
    }
    rows
}

/// Least and greatest value (NaN left out).
fn range<T: Sample, const N: usize>(
    data: &Data,
    scale: Option<(f64, f64)>,
    missing: Option<f64>,
    read: impl Fn([u8; N]) -> T + Sync,
) -> Result<(f64, f64)> {
    const NONE: (f64, f64) = (f64::INFINITY, f64::NEG_INFINITY);
    let piece = (N as u64) << 16;
    let len = data.len();
    let (slope, inter) = scale.unwrap_or((1.0, 0.0));
    let missing = missing.unwrap_or(f64::NAN);
    let ends: Vec<(f64, f64)> = parallel::try_map(len.div_ceil(piece) as usize, |i| {
        let (mut buffer, at) = (Vec::new(), i as u64 * piece);
        let bytes = data.read(at, (len - at).min(piece) as usize, &mut buffer)?;
        let (values, _) = bytes.as_chunks::<N>();
        Result::Ok(values.iter().fold(NONE, |(low, high), &v| {
            let v = read(v).to_f64();
            if v == missing { (low, high) } else { (low.min(v), high.max(v)) }
        }))
    })?;
    let (a, b) = ends.into_iter().fold(NONE, |a, b| (a.0.min(b.0), a.1.max(b.1)));
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
