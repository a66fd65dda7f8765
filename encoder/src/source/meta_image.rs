//! MetaImage volumes (`.mha`, `.mhd`): a text header, and values in the same file, in another or one a slice; raw, zlib or
//! written as text.
//!
//! The format's text is <https://itk.org/Wiki/MetaIO/Documentation>. Places are those of ITK: x to the left, y to the back,
//! z to the head of a patient, where the header says that the axes are a patient's.

use std::path::{Path, PathBuf};

use flate2::read::ZlibDecoder;

use super::nrrd::numbered;
use super::place::Place;
use super::values::{first_of, joined, numbers, of_text};
use super::volume::{Data, Facts, Stored, Volume, byte_len, unpack};
use super::{Dtype, ReadOptions, map};
use crate::model::about::{About, Kind};
use crate::{Error, Result};

/// Whether a file that begins so is one of these.
pub(super) fn is_meta_image(head: &[u8]) -> bool {
    let line = head.split(|&b| b == b'\n').next().unwrap_or_default();
    let Some((key, value)) = std::str::from_utf8(line).ok().and_then(|l| l.split_once('=')) else { return false };
    match key.trim() {
        "ObjectType" => value.trim() == "Image",
        "NDims" | "DimSize" | "Comment" | "ObjectSubType" => true,
        _ => false,
    }
}

#[derive(Default)]
struct Header {
    n_dims: Option<usize>,
    sizes: Vec<u64>,
    dtype: Option<Dtype>,
    channels: u64,
    binary: bool,
    big_endian: bool,
    compressed: bool,
    /// Bytes before the values; −1: they end the file.
    skip: i64,
    spacing: Option<Vec<f64>>,
    element_size: Option<Vec<f64>>,
    matrix: Option<Vec<f64>>,
    offset: Option<Vec<f64>>,
    anatomy: bool,
    unit: String,
    scale: [f64; 2],
}

impl Header {
    /// Takes in one line; what is wrong with it is an error.
    fn field(&mut self, key: &str, value: &str) -> Result<(), String> {
        let bad = || format!("{key} = {value:?}");
        let truth = || match value.to_lowercase().as_str() {
            "true" | "t" | "1" => Ok(true),
            "false" | "f" | "0" => Ok(false),
            _ => Err(format!("{}; expected True or False", bad())),
        };
        let reals = || numbers(value).ok_or_else(bad);
        match key {
            "ObjectType" if value != "Image" => return Err(format!("{}; only images are volumes", bad())),
            "NDims" => self.n_dims = Some(value.parse().map_err(|_| bad())?),
            "DimSize" => {
                let sizes: Result<Vec<u64>, _> = value.split_whitespace().map(str::parse).collect();
                self.sizes = sizes.map_err(|_| bad())?;
            }
            "BinaryData" => self.binary = truth()?,
            "BinaryDataByteOrderMSB" | "ElementByteOrderMSB" => self.big_endian = truth()?,
            "CompressedData" => self.compressed = truth()?,
            "HeaderSize" => self.skip = value.parse().ok().filter(|&n| n >= -1).ok_or_else(bad)?,
            "ElementNumberOfChannels" => self.channels = value.parse().ok().filter(|&n| n > 0).ok_or_else(bad)?,
            "ElementSpacing" => self.spacing = Some(reals()?),
            "ElementSize" => self.element_size = Some(reals()?),
            "TransformMatrix" | "Rotation" | "Orientation" => self.matrix = Some(reals()?),
            "Offset" | "Position" | "Origin" => self.offset = Some(reals()?),
            "AnatomicalOrientation" => self.anatomy = !value.is_empty() && !value.contains('?'),
            "DistanceUnits" => {
                self.unit = match value {
                    "?" | "" => String::new(),
                    "um" => "µm".to_owned(),
                    unit => unit.to_owned(),
                };
            }
            "ElementToIntensityFunctionSlope" => self.scale[0] = value.parse().map_err(|_| bad())?,
            "ElementToIntensityFunctionOffset" => self.scale[1] = value.parse().map_err(|_| bad())?,
            "ElementType" => {
                self.dtype = Some(match value {
                    "MET_UCHAR" => Dtype::U8,
                    "MET_CHAR" => Dtype::I8,
                    "MET_USHORT" => Dtype::U16,
                    "MET_SHORT" => Dtype::I16,
                    // As ITK has them: four bytes, on any machine.
                    "MET_UINT" | "MET_ULONG" => Dtype::U32,
                    "MET_INT" | "MET_LONG" => Dtype::I32,
                    "MET_ULONG_LONG" => Dtype::U64,
                    "MET_LONG_LONG" => Dtype::I64,
                    "MET_FLOAT" => Dtype::F32,
                    "MET_DOUBLE" => Dtype::F64,
                    _ => {
                        return Err(format!(
                            "{}; expected a MET_ type of whole numbers, MET_FLOAT or MET_DOUBLE",
                            bad()
                        ));
                    }
                });
            }
            _ => {}
        }
        Ok(())
    }

    /// Where the volume lies; None where nothing is said.
    fn place(&self) -> Option<Result<Place, String>> {
        let n = self.sizes.len();
        let get = |of: &Option<Vec<f64>>, i: usize| of.as_ref().and_then(|v| v.get(i).copied());
        let stated = self.spacing.is_some() || self.element_size.is_some() || self.matrix.is_some();
        if !stated {
            return None;
        }
        let spacing = [0, 1, 2].map(|f| get(&self.spacing, f).or(get(&self.element_size, f)).unwrap_or(1.0).abs());
        // Rows of the matrix are the directions of the axes.
        let cell = |f: usize, c: usize| match (f < n && c < n, &self.matrix) {
            (true, Some(m)) if m.len() == n * n => m[f * n + c],
            _ => f64::from(u8::from(f == c)),
        };
        let sign = if self.anatomy { [-1.0, -1.0, 1.0] } else { [1.0; 3] };
        let place = Place {
            steps: [0, 1, 2].map(|f| [0, 1, 2].map(|c| cell(f, c) * spacing[f] * sign[c])),
            origin: [0, 1, 2].map(|c| get(&self.offset, c).unwrap_or(0.0) * sign[c]),
            anatomy: self.anatomy,
            stated: "TransformMatrix",
        };
        Some(place.checked())
    }
}

pub(super) fn read<'a>(path: &Path, bytes: &'a [u8], opts: &ReadOptions) -> Result<Volume<'a>> {
    let fail = |at: usize, what: String| Err(Error::format(path, format!("byte {at}: {what}")));
    let mut header =
        Header { binary: true, channels: 1, unit: "mm".to_owned(), scale: [1.0, 0.0], ..Header::default() };
    let mut at = 0;
    // The header ends with the line that says where the values are.
    let (file, values_at) = loop {
        let Some(len) = bytes[at..].iter().position(|&b| b == b'\n').or((at < bytes.len()).then_some(bytes.len() - at))
        else {
            return fail(at, "the MetaImage header ends without ElementDataFile".to_owned());
        };
        let line = String::from_utf8_lossy(&bytes[at..at + len.min(1 << 16)]);
        if !line.trim().is_empty() {
            let Some((key, value)) = line.split_once('=') else {
                return fail(
                    at,
                    format!("expected \"key = value\", found {:?}", line.trim().chars().take(60).collect::<String>()),
                );
            };
            let (key, value) = (key.trim(), value.trim());
            if key == "ElementDataFile" {
                break (value.to_owned(), (at + len + 1).min(bytes.len()));
            }
            if let Err(what) = header.field(key, value) {
                return fail(at, what);
            }
        }
        at = (at + len + 1).min(bytes.len());
    };
    let missing = |what| Error::format(path, format!("byte {at}: the MetaImage header has no {what}"));
    let dtype = header.dtype.ok_or_else(|| missing("ElementType"))?;
    if header.sizes.is_empty() {
        return Err(missing("DimSize"));
    }
    let n = header.sizes.len();
    if header.n_dims.is_some_and(|d| d != n) || !(2..=10).contains(&n) {
        return fail(
            0,
            format!("NDims is {}, and DimSize has {n} sizes; expected 2 or more, the same", header.n_dims.unwrap_or(0)),
        );
    }
    let size = |f: usize| header.sizes.get(f).copied().unwrap_or(1);
    let dims = [size(0), size(1), size(2)];
    let series = header.sizes.iter().skip(3).fold(1u64, |n, &d| n.saturating_mul(d));
    let beyond = || Error::Limit(format!("{}: sizes {:?} are beyond any memory", path.display(), header.sizes));
    let expected = byte_len(path, dims, dtype)?.checked_mul(header.channels).ok_or_else(beyond)?;
    let all = expected.checked_mul(series).ok_or_else(beyond)?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let part = Part { header: &header, dtype };
    let data = match file.split_whitespace().next() {
        Some("LOCAL" | "Local" | "local") => part.values(path, &bytes[values_at..], values_at, expected, all)?,
        Some("LIST") => {
            let names = String::from_utf8_lossy(&bytes[values_at..]).into_owned();
            let names: Vec<PathBuf> =
                names.lines().map(str::trim).filter(|n| !n.is_empty()).map(PathBuf::from).collect();
            let axes = file.split_whitespace().nth(1).map_or(Ok(n - 1), str::parse);
            if axes.ok() != Some(n - 1) {
                return fail(
                    at,
                    format!("ElementDataFile = {file}: expected a file a slice (LIST, or LIST {})", n - 1),
                );
            }
            part.slices(path, folder, &names, expected, all)?
        }
        Some(pattern) if pattern.contains('%') => {
            let words: Vec<i64> = file.split_whitespace().skip(1).filter_map(|w| w.parse().ok()).collect();
            let names = match words.as_slice() {
                &[first, last, step] => numbered(pattern, first, last, step),
                _ => None,
            };
            let Some(names) = names else {
                return fail(at, format!("ElementDataFile = {file}: expected a name with %d, first, last, step"));
            };
            part.slices(path, folder, &names, expected, all)?
        }
        Some(_) => {
            let path = folder.join(&file);
            let whole = map(&path)?;
            part.values(&path, &whole, 0, expected, all)?.in_file(&path, &whole)?
        }
        None => return fail(at, "ElementDataFile has no value; expected LOCAL, LIST or a file".to_owned()),
    };
    let data = match header.channels {
        1 => data,
        n => first_of(path, &data, dtype.size(), n)?,
    };

    let mut about = About::new(Kind::Volume, "MetaImage".to_owned());
    let mut facts = Facts { measured: true, ..Facts::default() };
    if header.channels > 1 {
        about.left_out.push(format!(
            "{} of {} values a voxel: the first is read",
            header.channels - 1,
            header.channels
        ));
    }
    if series > 1 {
        about.left_out.push(format!("{} of {series} volumes: the first is read", series - 1));
    }
    match header.place() {
        Some(Ok(place)) => {
            about.unit = header.unit.clone();
            facts.place = Some(place);
        }
        Some(Err(what)) => about.left_out.push(what),
        None => {}
    }
    let mut notes = Vec::new();
    let [slope, inter] = header.scale;
    let scale =
        (slope != 0.0 && slope.is_finite() && inter.is_finite()).then_some((slope, inter)).filter(|&s| s != (1.0, 0.0));
    if scale.is_some() {
        notes.push(format!("values are stored · {slope} + {inter} (ElementToIntensityFunction)"));
    }
    let big_endian = header.binary && header.big_endian;
    Volume::with(path, Stored { big_endian, scale, notes, about, ..Stored::new(dims, dtype, data) }, facts, opts)
}

/// What is the same for each file of values.
struct Part<'h> {
    header: &'h Header,
    dtype: Dtype,
}

impl Part<'_> {
    /// The first `expected` bytes of values of a file that has `all` of them, in `data`, from byte `at` of it on.
    fn values<'a>(&self, path: &Path, data: &'a [u8], at: usize, expected: u64, all: u64) -> Result<Data<'a>> {
        let short = |got: u64| {
            Error::format(path, format!("byte {at}: {got} bytes of values; DimSize and ElementType expect {expected}"))
        };
        let skip = match self.header.skip {
            -1 if self.header.compressed => 0,
            -1 => (data.len() as u64).checked_sub(all).ok_or_else(|| short(data.len() as u64))?,
            n => n as u64,
        };
        let data = data.get(skip as usize..).ok_or_else(|| short(0))?;
        if self.header.compressed {
            return unpack(path, "zlib stream", ZlibDecoder::new(data), 0, expected)?.map_err(short);
        }
        if !self.header.binary {
            return of_text(path, data, at + skip as usize, self.dtype, expected / self.dtype.size());
        }
        Ok(Data::Slice(data.get(..expected as usize).ok_or_else(|| short(data.len() as u64))?))
    }

    /// Values of which each file holds a slice.
    fn slices(&self, path: &Path, folder: &Path, names: &[PathBuf], expected: u64, all: u64) -> Result<Data<'static>> {
        let n = *self.header.sizes.last().expect("there are two at least");
        if names.len() as u64 != n {
            return Err(Error::format(path, format!("{} data files for {n} slices", names.len())));
        }
        let each = all / n.max(1);
        let needed = names.iter().take(expected.div_ceil(each.max(1)) as usize);
        let mut data = joined(
            path,
            needed.map(|name| {
                let path = folder.join(name);
                let whole = map(&path)?;
                self.values(&path, &whole, 0, each, each)?.in_file(&path, &whole)
            }),
        )?;
        if let Data::File { len, .. } = &mut data {
            *len = expected.min(*len);
        }
        Ok(data)
    }
}
