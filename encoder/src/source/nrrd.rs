//! NRRD volumes: a text header, and values raw, gzip or written as text, in the same file, in another or in several.
//!
//! The format's text is <https://teem.sourceforge.net/nrrd/format.html>. A patient's space is turned to right, anterior,
//! superior; other spaces are kept.

use std::path::{Path, PathBuf};

use super::place::Place;
use super::values::{first_of, joined, numbers, of_text};
use super::volume::{Data, Facts, Stored, Volume, byte_len, gunzip};
use super::{Dtype, ReadOptions, map};
use crate::model::about::{About, Kind};
use crate::{Error, Result};

/// NRRD: text header, values raw or gzip, in the same file or a detached one.
pub(super) fn read<'a>(path: &Path, bytes: &'a [u8], opts: &ReadOptions) -> Result<Volume<'a>> {
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
        // Names follow, each on a line of its own.
        if header.data_file.as_deref().is_some_and(|name| name.starts_with("LIST")) {
            break at;
        }
    };
    let missing = |what| Error::format(path, format!("byte {header_end}: the NRRD header ends without \"{what}\""));
    let dtype = header.dtype.ok_or_else(|| missing("type"))?;
    let encoding = header.encoding.clone().ok_or_else(|| missing("encoding"))?;
    let sizes = header.sizes.clone().ok_or_else(|| missing("sizes"))?;
    if header.dimension.is_some_and(|d| d != sizes.len()) {
        return fail(0, format!("dimension is {} but there are {} sizes", header.dimension.unwrap_or(0), sizes.len()));
    }
    let mut about = About::new(Kind::Volume, "NRRD".to_owned());
    let mut facts = Facts { measured: true, labels: header.labels, ..Facts::default() };
    let Axes { space, components, series } =
        header.axes(&sizes).map_err(|what| Error::format(path, format!("byte 0: {what}")))?;
    let size_of = |k: usize| space.get(k).map_or(1, |&axis| sizes[axis]);
    let dims = [size_of(0), size_of(1), size_of(2)];
    let one = byte_len(path, dims, dtype)?;
    // With all the values of a voxel, but of a series the first.
    let expected = one.checked_mul(components).ok_or_else(|| {
        Error::Limit(format!("{}: {components} values a voxel are beyond any memory", path.display()))
    })?;
    let all = expected
        .checked_mul(series)
        .ok_or_else(|| Error::Limit(format!("{}: {series} volumes are beyond any memory", path.display())))?;
    let text = matches!(encoding.as_str(), "ascii" | "text" | "txt");
    if dtype.size() > 1 && header.big_endian.is_none() && !text {
        return Err(missing("endian"));
    }
    if components == 0 || series == 0 {
        return fail(0, format!("sizes {sizes:?}: every axis has one value at least"));
    }

    let folder = path.parent().unwrap_or(Path::new(""));
    let files = header.files(bytes, header_end).map_err(|what| Error::format(path, what))?;
    let part = Part { header: &header, encoding: &encoding, dtype, dims };
    let data = match files.as_slice() {
        [] => part.values(path, &bytes[header_end..], header_end, expected, all)?,
        [name] => {
            let path = folder.join(name);
            let whole = map(&path)?;
            part.values(&path, &whole, 0, expected, all)?.in_file(&path, &whole)?
        }
        names => {
            let n = names.len() as u64;
            if !all.is_multiple_of(n) {
                return fail(0, format!("{n} data files for {all} bytes of values: not the same number in each"));
            }
            let each = all / n;
            let needed = names.iter().take(expected.div_ceil(each) as usize);
            let mut data = joined(
                path,
                needed.map(|name| {
                    let path = folder.join(name);
                    let whole = map(&path)?;
                    part.values(&path, &whole, 0, each, each)?.in_file(&path, &whole)
                }),
            )?;
            if let Data::File { len, .. } = &mut data {
                *len = expected;
            }
            data
        }
    };
    let data = if components > 1 { first_of(path, &data, dtype.size(), components)? } else { data };
    if components > 1 {
        about.left_out.push(format!("{} of {components} values a voxel: the first is read", components - 1));
    }
    if series > 1 {
        about.left_out.push(format!("{} of {series} volumes: the first is read", series - 1));
    }
    about.left_out.extend(header.left_out.iter().cloned());
    match header.place(&space) {
        Some(Ok(place)) => {
            about.unit = header.unit.clone().unwrap_or(if place.anatomy { "mm" } else { "" }.to_owned());
            facts.place = Some(place);
        }
        Some(Err(what)) => about.left_out.push(what),
        None => {}
    }
    let notes =
        vec!["NRRD axes without directions are kept as stored: the first is x, the second y, the third z".to_owned()];
    let big_endian = !text && header.big_endian == Some(true);
    let stored = Stored { big_endian, notes, about, ..Stored::new(dims, dtype, data) };
    Volume::with(path, stored, facts, opts)
}

/// What is the same for each file of values.
struct Part<'h> {
    header: &'h NrrdHeader,
    encoding: &'h str,
    dtype: Dtype,
    dims: [u64; 3],
}

impl Part<'_> {
    /// The first `expected` bytes of values of a file that has `all` of them, in `data`, from byte `at` of it on.
    fn values<'a>(&self, path: &Path, mut data: &'a [u8], at: usize, expected: u64, all: u64) -> Result<Data<'a>> {
        let [x, y, z] = self.dims;
        let short = |got: u64| {
            Error::format(path, format!("{got} bytes of values; {x} × {y} × {z} of this type expect {expected}"))
        };
        for _ in 0..self.header.line_skip {
            let Some(len) = data.iter().position(|&b| b == b'\n') else {
                return Err(Error::format(path, format!("fewer lines than \"line skip: {}\"", self.header.line_skip)));
            };
            data = &data[len + 1..];
        }
        let skip = self.header.byte_skip;
        match self.encoding {
            "raw" => {
                let skip = match skip {
                    -1 => (data.len() as u64).checked_sub(all).ok_or_else(|| short(data.len() as u64))?,
                    n => n as u64,
                };
                let values = data.get(skip as usize..).and_then(|v| v.get(..expected as usize));
                Ok(Data::Slice(values.ok_or_else(|| short(data.len() as u64))?))
            }
            "gzip" | "gz" => {
                let skip = skip.max(0) as u64;
                let end = skip.checked_add(expected).ok_or_else(|| short(0))?;
                gunzip(path, data, skip, end)?.map_err(short)
            }
            "ascii" | "text" | "txt" => of_text(path, data, at, self.dtype, expected / self.dtype.size()),
            other => Err(Error::format(
                path,
                format!("byte 0: encoding {other:?} is not supported; save it as raw or gzip (unu save -e gzip)"),
            )),
        }
    }
}

/// What the axes of the file are.
struct Axes {
    /// Those of space, fastest first.
    space: Vec<usize>,
    /// Values a voxel.
    components: u64,
    /// Volumes after the first.
    series: u64,
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
    kinds: Vec<String>,
    spacings: Vec<f64>,
    /// Of each axis; None where it is no axis of space.
    directions: Option<Vec<Option<[f64; 3]>>>,
    origin: Option<[f64; 3]>,
    /// Signs that turn its coordinates to right, anterior, superior; None where it is not a patient's.
    patient: Option<[f64; 3]>,
    unit: Option<String>,
    labels: bool,
    left_out: Vec<String>,
}

impl NrrdHeader {
    /// Which axes are of space, and what the others are.
    fn axes(&self, sizes: &[u64]) -> Result<Axes, String> {
        let n = sizes.len();
        let kind = |axis: usize| self.kinds.get(axis).map_or("", String::as_str);
        let directed = self.directions.as_ref().filter(|d| d.len() == n);
        let is_space = |axis: usize| match (directed, kind(axis)) {
            (Some(directions), _) => directions[axis].is_some(),
            (None, "" | "domain" | "space" | "none" | "???") => true,
            (None, _) => false,
        };
        let mut space: Vec<usize> = (0..n).filter(|&axis| is_space(axis)).collect();
        // Axes of one value are none where there are too many.
        if space.len() > 3 {
            space.retain(|&axis| sizes[axis] != 1);
        }
        let others = || (0..n).filter(|axis| !space.contains(axis) && sizes[*axis] != 1);
        let said = |axis: usize| {
            format!(
                "axis {axis} (of {n}, sizes {sizes:?}{}{})",
                if kind(axis).is_empty() { "" } else { ", kind " },
                kind(axis)
            )
        };
        match space.len() {
            3 => {}
            2 if others().next().is_some() => {
                return Err(format!("sizes {sizes:?}: a picture of several values, not a volume"));
            }
            _ => {
                return Err(format!(
                    "sizes {sizes:?}: expected three axes of space; where more are stored, \"kinds\" says which others there are (list, vector, …)"
                ));
            }
        }
        let mut axes = Axes { components: 1, series: 1, space: space.clone() };
        for axis in others() {
            if space.iter().all(|&s| s > axis) {
                axes.components = axes.components.saturating_mul(sizes[axis]);
            } else if space.iter().all(|&s| s < axis) {
                axes.series = axes.series.saturating_mul(sizes[axis]);
            } else {
                return Err(format!(
                    "{} stands between those of space; permute it to the front (unu permute)",
                    said(axis)
                ));
            }
        }
        Ok(axes)
    }

    /// Names of the files that hold the values, none where this one does.
    fn files(&self, bytes: &[u8], header_end: usize) -> Result<Vec<PathBuf>, String> {
        let Some(text) = &self.data_file else { return Ok(Vec::new()) };
        if text.split_whitespace().next() == Some("LIST") {
            if text.split_whitespace().count() > 1 {
                return Err(format!(
                    "data file {text:?}: files of parts of slices are not supported; save it as one file"
                ));
            }
            let names = String::from_utf8_lossy(&bytes[header_end.min(bytes.len())..]).into_owned();
            let names: Vec<PathBuf> =
                names.lines().map(str::trim).filter(|n| !n.is_empty()).map(PathBuf::from).collect();
            return if names.is_empty() { Err("data file: LIST, but no names follow".to_owned()) } else { Ok(names) };
        }
        if !text.contains('%') {
            return Ok(vec![PathBuf::from(text)]);
        }
        let words: Vec<&str> = text.split_whitespace().collect();
        let number = |i: usize| words.get(i).and_then(|w| w.parse::<i64>().ok());
        let (&[pattern, _, _, _], Some(first), Some(last), Some(step)) =
            (words.as_slice(), number(1), number(2), number(3))
        else {
            return Err(format!("data file {text:?}: expected a name with %d, first, last, step"));
        };
        numbered(pattern, first, last, step)
            .ok_or_else(|| format!("data file {text:?}: expected a name with %d or %03d, at most a million of them"))
    }

    /// Where the axes of space lie; None where nothing is said.
    fn place(&self, space: &[usize]) -> Option<Result<Place, String>> {
        let steps: Option<Vec<[f64; 3]>> =
            self.directions.as_ref().and_then(|d| space.iter().map(|&axis| *d.get(axis)?).collect());
        if let Some(steps) = steps.and_then(|s| <[[f64; 3]; 3]>::try_from(s).ok()) {
            let sign = self.patient.unwrap_or([1.0; 3]);
            let turned = |v: [f64; 3]| [0, 1, 2].map(|c| v[c] * sign[c]);
            let place = Place {
                steps: steps.map(turned),
                origin: turned(self.origin.unwrap_or_default()),
                anatomy: self.patient.is_some(),
                stated: "space directions",
            };
            return Some(place.checked());
        }
        let spacing: Option<Vec<f64>> = space.iter().map(|&axis| self.spacings.get(axis).copied()).collect();
        let spacing = <[f64; 3]>::try_from(spacing?).ok()?;
        // Nobody said anything of an axis that has NaN.
        if spacing.iter().any(|s| s.is_nan()) {
            return None;
        }
        Some(Place::spaced(spacing.map(f64::abs), [0.0; 3]).checked())
    }

    /// Takes in one line after the signature.
    fn field(&mut self, line: &str) -> Result<(), String> {
        if line.starts_with('#') {
            return Ok(());
        }
        if let Some((key, _)) = line.split_once(":=") {
            // As 3D Slicer marks segmentations.
            self.labels |= key.starts_with("Segment") && key.contains('_');
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
            "data file" | "datafile" => self.data_file = Some(value.to_owned()),
            "line skip" | "lineskip" => self.line_skip = value.parse().map_err(|_| bad())?,
            "byte skip" | "byteskip" => {
                self.byte_skip = value.parse().ok().filter(|&n| n >= -1).ok_or_else(bad)?;
            }
            "kinds" => self.kinds = value.split_whitespace().map(str::to_lowercase).collect(),
            "spacings" => self.spacings = value.split_whitespace().map(|v| v.parse().unwrap_or(f64::NAN)).collect(),
            "space" => {
                let value = value.to_lowercase();
                let long = value.trim_end_matches("-time");
                self.patient = match long {
                    "right-anterior-superior" | "ras" | "rast" => Some([1.0, 1.0, 1.0]),
                    "left-anterior-superior" | "las" | "last" => Some([-1.0, 1.0, 1.0]),
                    "left-posterior-superior" | "lps" | "lpst" => Some([-1.0, -1.0, 1.0]),
                    _ => None,
                };
            }
            "space directions" => {
                let vectors = vectors(value);
                let of = |text: &String| match text.as_str() {
                    "none" => Ok(None),
                    text => numbers(text).and_then(|v| v.try_into().ok()).map(Some).ok_or(()),
                };
                match vectors.iter().map(of).collect::<Result<Vec<_>, ()>>() {
                    Ok(directions) => self.directions = Some(directions),
                    Err(()) => self.left_out.push(format!("space directions {value}: no three numbers an axis")),
                }
            }
            "space origin" => self.origin = numbers(value).and_then(|v| v.try_into().ok()),
            "space units" | "units" => {
                let unit = value.split('"').map(str::trim).find(|u| !u.is_empty() && *u != "???").unwrap_or_default();
                self.unit.get_or_insert(match unit {
                    "um" | "microns" | "micron" | "micrometer" => "µm".to_owned(),
                    unit => unit.to_owned(),
                });
            }
            "old min" | "oldmin" | "old max" | "oldmax" => {
                self.left_out.push(format!("{} {value}: values are taken as they are stored", name.trim()));
            }
            // Further fields say nothing about where the values are.
            _ => {}
        }
        Ok(())
    }
}

/// Texts like "(1,0,0)" and "none", as they follow each other.
fn vectors(text: &str) -> Vec<String> {
    let mut out: Vec<String> = Vec::new();
    let mut open = false;
    for word in text.split_whitespace() {
        match out.last_mut() {
            Some(last) if open => last.push_str(word),
            _ => out.push(word.to_owned()),
        }
        open = out.last().is_some_and(|w| w.starts_with('(') && !w.ends_with(')'));
    }
    out
}

/// Names that a pattern like "slice%03d.raw" stands for.
pub(super) fn numbered(pattern: &str, first: i64, last: i64, step: i64) -> Option<Vec<PathBuf>> {
    let (before, rest) = pattern.split_once('%')?;
    let (width, after) = rest.split_once('d')?;
    let zeros = width.starts_with('0');
    let width: usize = if width.is_empty() { 0 } else { width.parse().ok().filter(|&w| w < 64)? };
    let n = last.checked_sub(first)?.checked_div(step).filter(|n| (0..=1_000_000).contains(n))?;
    let name = |i: i64| {
        // No further than `last`.
        let n = first + i * step;
        PathBuf::from(if zeros { format!("{before}{n:0width$}{after}") } else { format!("{before}{n:width$}{after}") })
    };
    Some((0..=n).map(name).collect())
}
