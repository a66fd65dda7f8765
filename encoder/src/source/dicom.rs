//! DICOM: the slices of a series, or the frames of a file, in order of their places along the normal of the slices.
//!
//! x are columns, y rows, z slices. Of a folder the series with most frames is read, of places that several frames share
//! (times, echoes, segments) the first frame; both are said, as are gaps and unequal distances. Values mean stored · slope
//! + intercept (HU, dose). Source: DICOM PS3.3 C.7.6.2 and C.7.6.3, C.7.6.16 for multi-frame files, C.8.8.3 for dose.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use dicom_core::dictionary::{DataDictionary, DataDictionaryEntry};
use dicom_object::{DefaultDicomObject, InMemDicomObject, OpenFileOptions, StandardDataDictionary, Tag};
use dicom_pixeldata::PixelDecoder;

use super::place::Place;
use super::volume::{Data, Facts, Stored, Volume};
use super::{Dtype, ReadOptions, Up, guarded, map, world_dims};
use crate::model::about::Kind;
use crate::store::scratch;
use crate::{About, Error, Result};

mod tags {
    use dicom_object::Tag;
    pub const MODALITY: Tag = Tag(0x0008, 0x0060);
    pub const SLICE_THICKNESS: Tag = Tag(0x0018, 0x0050);
    pub const SPACING_BETWEEN_SLICES: Tag = Tag(0x0018, 0x0088);
    pub const SERIES: Tag = Tag(0x0020, 0x000E);
    pub const ACQUISITION_NUMBER: Tag = Tag(0x0020, 0x0012);
    pub const INSTANCE_NUMBER: Tag = Tag(0x0020, 0x0013);
    pub const POSITION: Tag = Tag(0x0020, 0x0032);
    pub const ORIENTATION: Tag = Tag(0x0020, 0x0037);
    pub const TEMPORAL_POSITION: Tag = Tag(0x0020, 0x0100);
    pub const FRAME_CONTENT: Tag = Tag(0x0020, 0x9111);
    pub const PLANE_POSITION: Tag = Tag(0x0020, 0x9113);
    pub const PLANE_ORIENTATION: Tag = Tag(0x0020, 0x9116);
    pub const TEMPORAL_INDEX: Tag = Tag(0x0020, 0x9128);
    pub const SAMPLES: Tag = Tag(0x0028, 0x0002);
    pub const PHOTOMETRIC: Tag = Tag(0x0028, 0x0004);
    pub const FRAMES: Tag = Tag(0x0028, 0x0008);
    pub const ROWS: Tag = Tag(0x0028, 0x0010);
    pub const COLUMNS: Tag = Tag(0x0028, 0x0011);
    pub const PIXEL_SPACING: Tag = Tag(0x0028, 0x0030);
    pub const BITS_ALLOCATED: Tag = Tag(0x0028, 0x0100);
    pub const BITS_STORED: Tag = Tag(0x0028, 0x0101);
    pub const HIGH_BIT: Tag = Tag(0x0028, 0x0102);
    pub const REPRESENTATION: Tag = Tag(0x0028, 0x0103);
    pub const PADDING: Tag = Tag(0x0028, 0x0120);
    pub const INTERCEPT: Tag = Tag(0x0028, 0x1052);
    pub const SLOPE: Tag = Tag(0x0028, 0x1053);
    pub const RESCALE_TYPE: Tag = Tag(0x0028, 0x1054);
    pub const MODALITY_LUT: Tag = Tag(0x0028, 0x3000);
    pub const PIXEL_MEASURES: Tag = Tag(0x0028, 0x9110);
    pub const VALUE_TRANSFORMATION: Tag = Tag(0x0028, 0x9145);
    pub const SEGMENT_IDENTIFICATION: Tag = Tag(0x0062, 0x000A);
    pub const SEGMENT: Tag = Tag(0x0062, 0x000B);
    pub const FRAME_OFFSETS: Tag = Tag(0x3004, 0x000C);
    pub const DOSE_SCALING: Tag = Tag(0x3004, 0x000E);
    pub const SHARED_GROUPS: Tag = Tag(0x5200, 0x9229);
    pub const FRAME_GROUPS: Tag = Tag(0x5200, 0x9230);
    pub const FLOATS: Tag = Tag(0x7FE0, 0x0008);
    pub const DOUBLES: Tag = Tag(0x7FE0, 0x0009);
    pub const PIXELS: Tag = Tag(0x7FE0, 0x0010);
}

/// Distances along the normal that count as equal, in mm.
const CLOSE: f64 = 1e-3;

/// How the values of a file are stored.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Form {
    /// Columns, rows.
    size: [u32; 2],
    /// 1, 8, 16, 32 or 64.
    allocated: u32,
    stored: u32,
    high: u32,
    signed: bool,
    float: bool,
}

impl Form {
    fn dtype(self) -> Dtype {
        match (self.float, self.allocated, self.signed) {
            (true, 32, _) => Dtype::F32,
            (true, ..) => Dtype::F64,
            (_, 1, _) | (_, 8, false) => Dtype::U8,
            (_, 8, true) => Dtype::I8,
            (_, 16, false) => Dtype::U16,
            (_, 16, true) => Dtype::I16,
            (_, _, false) => Dtype::U32,
            (_, _, true) => Dtype::I32,
        }
    }

    fn values(self) -> u64 {
        u64::from(self.size[0]) * u64::from(self.size[1])
    }
}

/// A frame, before its values are read.
#[derive(Clone, Debug)]
struct Frame {
    file: usize,
    /// Its number in the file.
    index: u32,
    form: Form,
    position: Option<[f64; 3]>,
    /// Directions of a row and of a column.
    orientation: Option<[f64; 6]>,
    /// Sides of a pixel: across, down.
    pixel: Option<[f64; 2]>,
    /// Distance of slices, or their thickness, as far as stated.
    step: Option<f64>,
    rescale: (f64, f64),
    padding: Option<f64>,
    /// What tells frames at one place apart: segment, time, acquisition, instance.
    order: [i64; 4],
    /// Place along the normal, in mm.
    along: f64,
}

/// These files, or the one; `path` is what is said to be read.
pub(super) fn read(path: &Path, files: &[PathBuf], opts: &ReadOptions) -> Result<Volume<'static>> {
    let (mut left_out, mut looks) = (Vec::<String>::new(), BTreeSet::new());
    let mut series: BTreeMap<String, Vec<Frame>> = BTreeMap::new();
    let (mut modality, mut rule, mut without) = (String::new(), String::new(), 0);
    for (i, file) in files.iter().enumerate() {
        let object = guarded(file, "DICOM", || open(file, true))?;
        match frames(file, &object, i)? {
            None => without += 1,
            Some(found) => {
                if let (Some(kind), true) = (text(&object, tags::MODALITY), series.is_empty()) {
                    modality = format!(" ({kind})");
                    rule = text(&object, tags::RESCALE_TYPE).map(|unit| format!(" {unit}")).unwrap_or_default();
                }
                let table = "the modality's look-up table: values are as stored";
                if object.get(tags::MODALITY_LUT).is_some() && !left_out.iter().any(|phrase| phrase == table) {
                    left_out.push(table.to_owned());
                }
                let shown = match text(&object, tags::PHOTOMETRIC).as_deref().map(str::trim) {
                    Some("MONOCHROME1") => "that low values are shown bright (MONOCHROME1): values are as stored",
                    Some(kind) if kind.starts_with("PALETTE") => "the colour table: values are its places",
                    _ => "",
                };
                if !shown.is_empty() {
                    looks.insert(shown);
                }
                series.entry(text(&object, tags::SERIES).unwrap_or_default()).or_default().extend(found);
            }
        }
    }
    let n_series = series.len();
    // The first of those with most frames.
    let all: usize = series.values().map(Vec::len).sum();
    let Some(frames) = series.into_values().rev().max_by_key(Vec::len) else {
        return Err(Error::format(path, "no DICOM file here has pixels; expected the slices of a series"));
    };
    if n_series > 1 {
        left_out.push(format!(
            "{} of {n_series} series, {} frames: the largest is read",
            n_series - 1,
            all - frames.len()
        ));
    }
    if without > 0 {
        left_out.push(format!("{without} files without pixels"));
    }
    let frames = alike(frames, &mut left_out);
    let (frames, step) = in_place(frames, &mut left_out);
    left_out.extend(looks.into_iter().map(str::to_owned));
    let mut about = About::new(Kind::Volume, format!("DICOM{modality}"));
    about.axes = "columns are x, rows y, slices z by position".to_owned();
    if let (Some([x, y]), Some(z)) = (frames[0].pixel, step) {
        about.voxel = Some([x, y, z]);
        "mm".clone_into(&mut about.unit);
    }
    about.left_out = left_out;
    volume(path, files, &frames, about, &rule, opts)
}

fn open(path: &Path, head: bool) -> Result<DefaultDicomObject> {
    check(path, &map(path)?)?;
    let options = OpenFileOptions::new();
    let options = if head { options.read_until(tags::FLOATS) } else { options };
    options.open_file(path).map_err(|e| {
        let mut what = format!("DICOM: {e}");
        let mut cause = std::error::Error::source(&e);
        while let Some(e) = cause {
            what += &format!(": {e}");
            cause = e.source();
        }
        Error::format(path, what.replace('\n', " "))
    })
}

/// Holds the lengths of all elements against the file's, since the crate takes memory for what each claims; and against the sizes
/// of their values, since it goes on after the last whole one and takes what is left for an element.
fn check(path: &Path, bytes: &[u8]) -> Result<()> {
    let fail = |at: usize, what: String| Error::format(path, format!("byte {at}: {what}"));
    if bytes.get(128..132) != Some(b"DICM") {
        return Err(fail(128, "expected DICM, so this is no DICOM file".to_owned()));
    }
    let short = |(at, claims)| {
        fail(at, format!("an element of {claims} bytes: more than the file holds, or no whole number of values"))
    };
    let meta = Walk { bytes, big_endian: false, explicit: true };
    let (mut at, mut syntax) = (132, String::new());
    while meta.number(at, 2) == Some(2) {
        let (tag, _, from, len) = meta.header(at).ok_or((at, 0)).map_err(short)?;
        let value = bytes.get(from..).and_then(|v| v.get(..len as usize)).ok_or((at, len)).map_err(short)?;
        if tag == 0x0002_0010 {
            syntax = String::from_utf8_lossy(value).trim_end_matches(['\0', ' ']).to_owned();
        }
        at = from + len as usize;
    }
    let mut inflated = Vec::new();
    let (bytes, at) = match syntax.as_str() {
        "1.2.840.10008.1.2.1.99" => {
            let rest = &bytes[at..];
            let most = rest.len() as u64 * 1100;
            let mut stream = flate2::read::DeflateDecoder::new(rest).take(most);
            stream.read_to_end(&mut inflated).map_err(|e| fail(at, format!("deflated elements: {e}")))?;
            (&inflated[..], 0)
        }
        _ => (bytes, at),
    };
    let (big_endian, explicit) = (syntax == "1.2.840.10008.1.2.2", syntax != "1.2.840.10008.1.2");
    let walk = Walk { bytes, big_endian, explicit };
    walk.elements(at, bytes.len(), 0).map(drop).map_err(short)
}

/// The elements of a data set, as far as their lengths go.
struct Walk<'a> {
    bytes: &'a [u8],
    big_endian: bool,
    explicit: bool,
}

/// Bytes of one value of a type.
fn size_of_value(kind: [u8; 2]) -> u64 {
    match &kind {
        b"US" | b"SS" | b"OW" => 2,
        b"AT" | b"UL" | b"SL" | b"FL" | b"OF" | b"OL" => 4,
        b"FD" | b"OD" | b"OV" | b"SV" | b"UV" => 8,
        _ => 1,
    }
}

/// Where an element is, and the bytes that it claims.
type Claim = (usize, u64);

/// A length that is not stated: up to a delimiter.
const UNDEFINED: u64 = 0xffff_ffff;

impl Walk<'_> {
    fn number(&self, at: usize, size: usize) -> Option<u64> {
        let bytes = self.bytes.get(at..at.checked_add(size)?)?;
        let fold = |n: u64, &b: &u8| n << 8 | u64::from(b);
        Some(if self.big_endian { bytes.iter().fold(0, fold) } else { bytes.iter().rev().fold(0, fold) })
    }

    /// Tag, type (of those stated), where the value starts, its length.
    fn header(&self, at: usize) -> Option<(u64, [u8; 2], usize, u64)> {
        let tag = self.number(at, 2)? << 16 | self.number(at + 2, 2)?;
        // Items and delimiters have no type.
        if tag >> 16 == 0xfffe {
            return Some((tag, *b"??", at + 8, self.number(at + 4, 4)?));
        }
        if !self.explicit {
            let known = StandardDataDictionary.by_tag(Tag((tag >> 16) as u16, tag as u16));
            let kind = known.map_or(*b"UN", |entry| entry.vr().relaxed().to_bytes());
            return Some((tag, kind, at + 8, self.number(at + 4, 4)?));
        }
        let kind: [u8; 2] = self.bytes.get(at + 4..at + 6)?.try_into().ok()?;
        // Types that are not known have long lengths, too.
        const SHORT: [&[u8; 2]; 21] = [
            b"AE", b"AS", b"AT", b"CS", b"DA", b"DS", b"DT", b"FL", b"FD", b"IS", b"LO", b"LT", b"PN", b"SH", b"SL",
            b"SS", b"ST", b"TM", b"UI", b"UL", b"US",
        ];
        let long = !SHORT.contains(&&kind);
        match long {
            true => Some((tag, kind, at + 12, self.number(at + 8, 4)?)),
            false => Some((tag, kind, at + 8, self.number(at + 6, 2)?)),
        }
    }

    /// Elements up to `end` or a delimiter; where they end.
    fn elements(&self, mut at: usize, end: usize, depth: u32) -> Result<usize, Claim> {
        while at + 8 <= end {
            let (tag, kind, from, len) = self.header(at).ok_or((at, 8))?;
            if tag == 0xfffe_e00d {
                return Ok(from);
            }
            let pixels = tag == 0x7fe0_0010;
            let to = (from as u64).checked_add(len);
            let fits = len == UNDEFINED || to.is_some_and(|to| to <= end as u64);
            // At the end, nothing comes that could be taken for something else.
            let whole = len == UNDEFINED || len.is_multiple_of(size_of_value(kind)) || to == Some(end as u64);
            if !fits || !whole || depth > 32 {
                return Err((at, len));
            }
            let items = || self.number(from, 2) == Some(0xfffe) && self.number(from + 2, 2) == Some(0xe000);
            let sequence = match self.explicit {
                true => kind == *b"SQ" || len == UNDEFINED,
                false => len == UNDEFINED || (tag >> 16 & 1 == 0 && tag >> 16 != 0x7fe0 && items()),
            };
            let to = if len == UNDEFINED { end } else { from + len as usize };
            at = match sequence {
                // Those of a type that is not known have items without types.
                true if kind == *b"UN" => {
                    Walk { explicit: false, big_endian: false, ..*self }.items(from, to, pixels, depth + 1)?
                }
                true => self.items(from, to, pixels, depth + 1)?,
                false => to,
            };
        }
        Ok(end)
    }

    /// Items up to `end` or a delimiter; where they end. Those of packed pixels hold bytes alone.
    fn items(&self, mut at: usize, end: usize, pixels: bool, depth: u32) -> Result<usize, Claim> {
        while at + 8 <= end {
            let (tag, _, from, len) = self.header(at).ok_or((at, 8))?;
            if tag == 0xfffe_e0dd {
                return Ok(from);
            }
            let fits = len == UNDEFINED && !pixels || (from as u64).checked_add(len).is_some_and(|to| to <= end as u64);
            if tag != 0xfffe_e000 || !fits {
                return Err((at, len));
            }
            let to = if len == UNDEFINED { end } else { from + len as usize };
            at = match pixels {
                true => to,
                false => {
                    let ends = self.elements(from, to, depth + 1)?;
                    if len == UNDEFINED { ends } else { to }
                }
            };
        }
        Ok(end)
    }
}

fn text(object: &InMemDicomObject, tag: Tag) -> Option<String> {
    let text = object.get(tag)?.to_str().ok()?;
    let text = text.trim_matches([' ', '\0']);
    (!text.is_empty()).then(|| text.to_owned())
}

fn int(object: &InMemDicomObject, tag: Tag) -> Option<i64> {
    object.get(tag)?.to_int::<i64>().ok()
}

fn numbers<const N: usize>(object: &InMemDicomObject, tag: Tag) -> Option<[f64; N]> {
    let values = object.get(tag)?.to_multi_float64().ok()?;
    let values: [f64; N] = values.get(..N)?.try_into().ok()?;
    values.iter().all(|v| v.is_finite()).then_some(values)
}

fn number(object: &InMemDicomObject, tag: Tag) -> Option<f64> {
    numbers::<1>(object, tag).map(|[v]| v)
}

/// The only item of a sequence, of the frame's own groups or of those that all frames share.
fn group<'a>(groups: &[Option<&'a InMemDicomObject>], tag: Tag) -> Option<&'a InMemDicomObject> {
    groups.iter().flatten().find_map(|group| group.get(tag)?.items()?.first())
}

/// The frames of a file; None where it has no pixels.
fn frames(path: &Path, object: &DefaultDicomObject, file: usize) -> Result<Option<Vec<Frame>>> {
    let fail = |what: String| Err(Error::format(path, format!("DICOM: {what}")));
    let (Some(rows), Some(columns)) = (int(object, tags::ROWS), int(object, tags::COLUMNS)) else { return Ok(None) };
    let side = |n: i64| u32::try_from(n).ok().filter(|n| (1..=65_535).contains(n));
    let (Some(height), Some(width)) = (side(rows), side(columns)) else {
        return fail(format!("{columns} columns × {rows} rows"));
    };
    let kind = text(object, tags::PHOTOMETRIC).unwrap_or_else(|| "MONOCHROME2".to_owned());
    if int(object, tags::SAMPLES).unwrap_or(1) != 1 || !(kind.starts_with("MONOCHROME") || kind.starts_with("PALETTE"))
    {
        return fail(format!("colours ({kind}) are not read; save it as grey"));
    }
    let syntax = syntax_of(object);
    let codec = match syntax.strip_prefix("1.2.840.10008.1.2.4.") {
        Some("80" | "81") => "JPEG-LS",
        Some("90" | "91" | "92" | "93") => "JPEG 2000",
        Some("94" | "95") => "JPIP",
        Some("201" | "202" | "203" | "204" | "205") => "High-Throughput JPEG 2000",
        Some("110" | "111" | "112") => "JPEG XL",
        Some(n) if n.starts_with("10") => "MPEG film",
        _ => "",
    };
    if !codec.is_empty() {
        return fail(format!(
            "values are packed as {codec} ({syntax}), which is not read; unpack them, as gdcmconv --raw does"
        ));
    }
    // Floats have no bits to be stored in.
    let bits = int(object, tags::BITS_ALLOCATED).unwrap_or(0);
    let stored = int(object, tags::BITS_STORED).unwrap_or(bits);
    let high = int(object, tags::HIGH_BIT).unwrap_or(stored - 1);
    if !matches!(bits, 1 | 8 | 16 | 32 | 64) || !(1..=bits).contains(&stored) || !(stored - 1..bits).contains(&high) {
        return fail(format!("{bits} bits a value, {stored} stored, highest {high}; expected 1, 8, 16 or 32 bits"));
    }
    let form = Form {
        size: [width, height],
        allocated: bits as u32,
        stored: stored as u32,
        high: high as u32,
        signed: int(object, tags::REPRESENTATION) == Some(1),
        float: false,
    };
    let n = int(object, tags::FRAMES).unwrap_or(1).max(1);
    let own = object.get(tags::FRAME_GROUPS).and_then(|e| e.items()).unwrap_or_default();
    let shared = object.get(tags::SHARED_GROUPS).and_then(|e| e.items()).and_then(<[_]>::first);
    if n > 1 << 20 {
        return fail(format!("{n} frames; at most {} are read", 1 << 20));
    }
    let offsets =
        object.get(tags::FRAME_OFFSETS).and_then(|e| e.to_multi_float64().ok()).filter(|v| v.len() as i64 == n);
    let frames = (0..n as usize).map(|i| {
        let groups = [own.get(i), shared];
        let of = |sequence: Tag| group(&groups, sequence);
        let root: &InMemDicomObject = object;
        let first = |sequence: Tag, tag: Tag| of(sequence).and_then(|g| number(g, tag));
        let measures = of(tags::PIXEL_MEASURES).unwrap_or(root);
        let transformation = of(tags::VALUE_TRANSFORMATION).unwrap_or(root);
        let orientation = of(tags::PLANE_ORIENTATION).and_then(|g| numbers(g, tags::ORIENTATION));
        let orientation: Option<[f64; 6]> = orientation.or_else(|| numbers(root, tags::ORIENTATION));
        let position = of(tags::PLANE_POSITION).and_then(|g| numbers(g, tags::POSITION));
        let mut position = position.or_else(|| numbers(root, tags::POSITION).filter(|_| n == 1 || offsets.is_some()));
        if let (Some(p), Some(o), Some(offsets)) = (&mut position, orientation, &offsets) {
            // Distances from the first frame, or, in old files, places along the patient.
            let from = if offsets[0] == 0.0 { offsets[i] } else { offsets[i] - offsets[0] };
            normal(o).iter().zip(p).for_each(|(n, p)| *p += n * from);
        }
        let scaling = number(root, tags::DOSE_SCALING);
        let slope = number(transformation, tags::SLOPE).or(scaling).filter(|&v| v != 0.0).unwrap_or(1.0);
        let segment = first(tags::SEGMENT_IDENTIFICATION, tags::SEGMENT).unwrap_or(0.0) as i64;
        let time = first(tags::FRAME_CONTENT, tags::TEMPORAL_INDEX).or_else(|| number(root, tags::TEMPORAL_POSITION));
        Frame {
            file,
            index: i as u32,
            form,
            position,
            orientation,
            pixel: numbers::<2>(measures, tags::PIXEL_SPACING)
                .filter(|v| v[0] > 0.0 && v[1] > 0.0)
                .map(|[y, x]| [x, y]),
            step: [tags::SPACING_BETWEEN_SLICES, tags::SLICE_THICKNESS]
                .into_iter()
                .find_map(|tag| number(measures, tag).map(f64::abs).filter(|&v| v > 0.0)),
            rescale: (slope, number(transformation, tags::INTERCEPT).unwrap_or(0.0)),
            padding: int(root, tags::PADDING).map(|v| {
                // Stored as unsigned in some signed files.
                let signed = form.signed && form.allocated == 16 && v > 32_767;
                (if signed { v - 65_536 } else { v }) as f64
            }),
            order: [
                segment,
                time.unwrap_or(0.0) as i64,
                int(root, tags::ACQUISITION_NUMBER).unwrap_or(0),
                int(root, tags::INSTANCE_NUMBER).unwrap_or(0),
            ],
            along: 0.0,
        }
    });
    Ok(Some(frames.collect()))
}

fn normal([a, b, c, d, e, f]: [f64; 6]) -> [f64; 3] {
    [b * f - c * e, c * d - a * f, a * e - b * d]
}

/// Those frames that are alike in size, form and direction, as most are.
fn alike(frames: Vec<Frame>, left_out: &mut Vec<String>) -> Vec<Frame> {
    let same = |a: &Frame, b: &Frame| {
        let close = |(a, b): (f64, f64)| (a - b).abs() < 1e-3;
        let turned = match (a.orientation, b.orientation) {
            (Some(a), Some(b)) => a.into_iter().zip(b).all(close),
            (a, b) => a.is_none() == b.is_none(),
        };
        turned && a.form == b.form && a.position.is_some() == b.position.is_some()
    };
    let mut groups: Vec<Vec<Frame>> = Vec::new();
    let all = frames.len();
    for frame in frames {
        match groups.iter_mut().find(|group| same(&group[0], &frame)) {
            Some(group) => group.push(frame),
            None => groups.push(vec![frame]),
        }
    }
    let most = groups.into_iter().rev().max_by_key(Vec::len).expect("a series has a frame");
    if most.len() < all {
        left_out.push(format!("{} frames of another size, type or direction", all - most.len()));
    }
    most
}

/// Frames in order of their places, one at each, and the distance of neighbours.
fn in_place(mut frames: Vec<Frame>, left_out: &mut Vec<String>) -> (Vec<Frame>, Option<f64>) {
    let segments = frames.iter().map(|f| f.order[0]).collect::<BTreeSet<_>>();
    if segments.len() > 1 {
        let first = segments.first().copied();
        left_out.push(format!("{} of {} segments: the first is read", segments.len() - 1, segments.len()));
        frames.retain(|f| Some(f.order[0]) == first);
    }
    let stated = frames[0].step;
    let placed = frames.len() > 1 && frames[0].position.is_some() && frames[0].orientation.is_some();
    if !placed {
        frames.sort_by_key(|f| (f.order, f.file, f.index));
        if frames.len() > 1 {
            left_out
                .push("places of slices, which the files do not state: they are in order of their numbers".to_owned());
        }
        return (frames, stated);
    }
    let n = normal(frames[0].orientation.expect("all have one"));
    for frame in &mut frames {
        frame.along = frame.position.expect("all have one").iter().zip(n).map(|(p, n)| p * n).sum();
    }
    frames.sort_by(|a, b| {
        a.along.total_cmp(&b.along).then_with(|| (a.order, a.file, a.index).cmp(&(b.order, b.file, b.index)))
    });
    let all = frames.len();
    // Of frames at one place the one that comes first.
    let mut places: Vec<Frame> = Vec::new();
    let mut group: Vec<Frame> = Vec::new();
    let mut close = |group: &mut Vec<Frame>| {
        places.extend(group.drain(..).min_by_key(|f| (f.order, f.file, f.index)));
    };
    for frame in frames {
        if group.first().is_some_and(|f| frame.along - f.along > CLOSE) {
            close(&mut group);
        }
        group.push(frame);
    }
    close(&mut group);
    if places.len() < all {
        let (n, of) = (all - places.len(), places.len());
        left_out.push(format!(
            "{n} frames at the places of others (times, echoes): of {all} the first at each of {of} places is read"
        ));
    }
    let steps: Vec<f64> = places.windows(2).map(|w| w[1].along - w[0].along).collect();
    if steps.is_empty() {
        return (places, stated);
    }
    let mut sorted = steps.clone();
    sorted.sort_by(f64::total_cmp);
    let (least, middle, most) = (sorted[0], sorted[sorted.len() / 2], sorted[sorted.len() - 1]);
    if most - least > 0.01 * middle + CLOSE {
        let whole = steps.iter().all(|s| ((s / middle).round() - s / middle).abs() < 0.02 && s / middle > 0.5);
        let missing: f64 = steps.iter().map(|s| (s / middle).round() - 1.0).sum();
        left_out.push(match whole {
            true => format!("gaps: {missing} slices are missing, those on both sides are drawn as neighbours"),
            false => format!("unequal distances of slices, {} to {} mm, are drawn as equal", short(least), short(most)),
        });
    }
    // What slices are shifted along themselves, as a tilted gantry does it.
    let (a, b) = (places[0].position.expect("all"), places[places.len() - 1].position.expect("all"));
    let along = places[places.len() - 1].along - places[0].along;
    let aside: f64 = (0..3).map(|i| (b[i] - a[i] - n[i] * along).powi(2)).sum::<f64>().sqrt();
    if aside > places[0].pixel.map_or(1.0, |p| p[0].max(p[1])) {
        left_out.push(format!(
            "the tilt of the slices ({:.1}°): they are stacked upright",
            (aside / along).atan().to_degrees()
        ));
    }
    (places, Some(short(middle)))
}

/// Without what rounding left.
fn short(v: f64) -> f64 {
    (v * 1e5).round() / 1e5
}

fn volume(
    path: &Path,
    files: &[PathBuf],
    frames: &[Frame],
    mut about: About,
    unit: &str,
    opts: &ReadOptions,
) -> Result<Volume<'static>> {
    let failed = |action| move |e| Error::io(std::env::temp_dir(), action, e);
    let form = frames[0].form;
    let [x, y] = form.size.map(u64::from);
    let n = frames.len() as u64;
    let dims = match opts.up.unwrap_or_default() {
        Up::X => [n, x, y],
        Up::Y => [x, y, n],
        Up::Z => [x, n, y],
    };
    world_dims(path, dims, "choose another axis with --up")?;
    // One straight line for all, or values that mean themselves.
    let scale = frames[0].rescale;
    let one_scale = frames.iter().all(|f| f.rescale == scale);
    let missing = frames[0].padding.filter(|_| one_scale && frames.iter().all(|f| f.padding == frames[0].padding));
    let mut file = scratch::file().map_err(failed("create a file in"))?;
    let mut open_now: Option<(usize, DefaultDicomObject)> = None;
    let mut dtype = form.dtype();
    let mut len = 0;
    for frame in frames {
        let source = &files[frame.file];
        if open_now.as_ref().is_none_or(|(i, _)| *i != frame.file) {
            open_now = Some((frame.file, guarded(source, "DICOM", || open(source, false))?));
        }
        let (_, object) = open_now.as_ref().expect("just opened");
        let (own, values) = guarded(source, "DICOM", || pixels(source, object, frame))?;
        if len == 0 {
            dtype = own;
        } else if own != dtype {
            return Err(Error::format(source, format!("DICOM: values of {own:?}, in the first slice {dtype:?}")));
        }
        let values = match one_scale {
            true => values,
            false => rescaled(&values, own, frame),
        };
        len += values.len() as u64;
        file.write_all(&values).map_err(failed("write a file in"))?;
    }
    if !one_scale {
        dtype = Dtype::F32;
        about.rule = format!("each slice rescaled by its own line{unit}");
    } else if scale != (1.0, 0.0) {
        about.rule = format!("values are stored · {} + {}{unit}", scale.0, scale.1);
    }
    if let Some(v) = missing {
        let and = if about.rule.is_empty() { "" } else { "; " };
        about.rule += &format!("{and}stored {v} is air (padding)");
    }
    let data = Data::File { path: path.to_owned(), file, at: 0, len };
    let big_endian = cfg!(target_endian = "big");
    let scale = Some(scale).filter(|&s| one_scale && s != (1.0, 0.0));
    let facts = Facts { place: place(&frames[0], about.voxel), measured: true, ..Facts::default() };
    Volume::with(path, Stored { big_endian, scale, missing, about, ..Stored::new([x, y, n], dtype, data) }, facts, opts)
}

/// Where slices of that size and direction lie that are stacked upright on the first; None where nothing is said of it.
/// DICOM's coordinates run to the left and the back of a patient.
fn place(first: &Frame, sides: Option<[f64; 3]>) -> Option<Place> {
    let ([x, y, z], [a, b, c, d, e, f]) = (sides?, first.orientation?);
    let turned = |v: [f64; 3], side: f64| [-v[0] * side, -v[1] * side, v[2] * side];
    let steps = [turned([a, b, c], x), turned([d, e, f], y), turned(normal([a, b, c, d, e, f]), z)];
    let origin = turned(first.position.unwrap_or_default(), 1.0);
    (Place { steps, origin, anatomy: true, stated: "ImageOrientationPatient" }).checked().ok()
}

/// Values as f32, by the line of their own frame; padding is no number.
fn rescaled(values: &[u8], dtype: Dtype, frame: &Frame) -> Vec<u8> {
    let size = dtype.size() as usize;
    let value = |b: &[u8]| -> f64 {
        match dtype {
            Dtype::U8 => b[0].into(),
            Dtype::I8 => (b[0] as i8).into(),
            Dtype::U16 => u16::from_ne_bytes([b[0], b[1]]).into(),
            Dtype::I16 => i16::from_ne_bytes([b[0], b[1]]).into(),
            Dtype::U32 => u32::from_ne_bytes([b[0], b[1], b[2], b[3]]).into(),
            Dtype::I32 => i32::from_ne_bytes([b[0], b[1], b[2], b[3]]).into(),
            Dtype::F32 => f32::from_ne_bytes([b[0], b[1], b[2], b[3]]).into(),
            _ => b.try_into().map_or(f64::NAN, f64::from_ne_bytes),
        }
    };
    let (slope, inter) = frame.rescale;
    let meaning = |v: f64| if Some(v) == frame.padding { f32::NAN } else { (v * slope + inter) as f32 };
    values.chunks_exact(size).flat_map(|b| meaning(value(b)).to_ne_bytes()).collect()
}

/// The values of a frame, without bits that are no part of them, and their type.
fn pixels(path: &Path, object: &DefaultDicomObject, frame: &Frame) -> Result<(Dtype, Vec<u8>)> {
    let fail = |what: String| Error::format(path, format!("DICOM: frame {}: {what}", frame.index));
    let form = frame.form;
    let floats = [(tags::FLOATS, Dtype::F32), (tags::DOUBLES, Dtype::F64)];
    let floats = floats.into_iter().find_map(|(tag, dtype)| object.get(tag).map(|e| (e, dtype)));
    let element = match &floats {
        Some((element, _)) => *element,
        None => object.get(tags::PIXELS).ok_or_else(|| fail("no pixels (7FE0,0010)".to_owned()))?,
    };
    let n = form.values() as usize;
    let dtype = floats.as_ref().map_or(form.dtype(), |f| f.1);
    let size = if form.allocated == 1 { 1 } else { dtype.size() as usize };
    let short =
        |got: usize| fail(format!("{got} bytes of pixels, {} × {} of them expect more", form.size[0], form.size[1]));
    if let Some(fragments) = element.fragments() {
        if form.allocated == 1 {
            return Err(fail("packed bits of 1 bit a value; unpack them".to_owned()));
        }
        // The decoder takes memory for as many segments as a head claims. A segment is a byte of each value.
        if syntax_of(object) == RLE {
            let head: Option<[u8; 4]> =
                fragments.get(frame.index as usize).and_then(|f| f.get(..64)?.first_chunk()).copied();
            let (claimed, right) = (head.map_or(0, u32::from_le_bytes), form.allocated / 8);
            if claimed != right {
                return Err(fail(format!("RLE of {claimed} segments; {right} were expected, the file is damaged")));
            }
        }
        let decoded = object.decode_pixel_data_frame(frame.index).map_err(|e| {
            let cause = std::error::Error::source(&e).map(|e| format!(": {e}")).unwrap_or_default();
            let syntax = object.meta().transfer_syntax();
            fail(format!("{e}{cause} ({syntax}); unpack the values, as gdcmconv --raw does").replace('\n', " "))
        })?;
        let bytes = decoded.into_data();
        let bytes = bytes.get(..n * size).ok_or_else(|| short(bytes.len()))?;
        return Ok((dtype, masked(bytes, form)));
    }
    let bytes = element.to_bytes().map_err(|e| fail(e.to_string()))?;
    let at = frame.index as usize * n;
    if form.allocated == 1 && floats.is_none() {
        // The least bit first, frames without a gap between them.
        let bit = |i: usize| bytes.get(i / 8).map(|b| b >> (i % 8) & 1);
        return (at..at + n).map(bit).collect::<Option<_>>().map(|v| (dtype, v)).ok_or_else(|| short(bytes.len()));
    }
    let bytes = bytes.get(at * size..(at + n) * size).ok_or_else(|| short(bytes.len()))?;
    Ok((dtype, if floats.is_some() { bytes.to_vec() } else { masked(bytes, form) }))
}

/// RLE Lossless.
const RLE: &str = "1.2.840.10008.1.2.5";

fn syntax_of(object: &DefaultDicomObject) -> &str {
    object.meta().transfer_syntax().trim_end_matches(['\0', ' '])
}

/// Values of the bits from `high` down, `stored` of them, with their sign.
fn masked(bytes: &[u8], form: Form) -> Vec<u8> {
    if form.stored == form.allocated {
        return bytes.to_vec();
    }
    let (up, down) = (form.allocated - 1 - form.high, form.allocated - form.stored);
    macro_rules! each {
        ($unsigned:ident, $signed:ident) => {{
            const N: usize = std::mem::size_of::<$unsigned>();
            let value = |b: &[u8; N]| {
                let v = $unsigned::from_ne_bytes(*b) << up;
                if form.signed { ((v as $signed) >> down) as $unsigned } else { v >> down }
            };
            bytes.as_chunks::<N>().0.iter().flat_map(|b| value(b).to_ne_bytes()).collect()
        }};
    }
    match form.allocated {
        8 => each!(u8, i8),
        16 => each!(u16, i16),
        _ => each!(u32, i32),
    }
}

#[cfg(test)]
mod tests;
