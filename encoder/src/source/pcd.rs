//! Clouds of points of the Point Cloud Library (`.pcd`): text, binary, and binary packed by LZF.
//!
//! Fields have any order; x, y and z are needed. Colours are `rgb` or `rgba`, three bytes in one word (blue lowest; written as
//! text, those of type F are the word's bits read as a float), or fields r, g, b. Points without a place (NaN) are how such
//! files say that a beam came back from nowhere. z is up, as robots have it (REP 103), unless `--up` says otherwise. Packed values
//! stand field by field. Source: the PCL's description of the format.

use std::path::Path;

use super::points::{Cloud, Has, Point, Points, Spacing};
use super::{ReadOptions, Up};
use crate::model::about::Kind;
use crate::{About, Error, Result};

/// LZF makes at most 264 bytes of 3.
const LZF_MOST: u64 = 88;
/// Lines of a header, and bytes of all of them.
const MAX_HEADER: usize = 1 << 16;

#[derive(Clone, Copy, PartialEq)]
enum Type {
    Signed,
    Unsigned,
    Float,
}

#[derive(Clone)]
struct Field {
    name: String,
    size: usize,
    of: Type,
    count: usize,
    /// Where it stands: byte of a record, value of a line.
    byte: usize,
    value: usize,
}

#[derive(PartialEq)]
enum Form {
    Text,
    Binary,
    Packed,
}

struct Header {
    fields: Vec<Field>,
    n: u64,
    form: Form,
    viewpoint: Option<String>,
    /// Where the points begin.
    at: usize,
    version: String,
}

impl Header {
    fn read(path: &Path, bytes: &[u8]) -> Result<Header> {
        let mut at = 0;
        let (mut names, mut sizes, mut types, mut counts) = (Vec::new(), Vec::new(), Vec::new(), None);
        let (mut width, mut height, mut points, mut viewpoint) = (None, None, None, None);
        let mut version = String::new();
        loop {
            let fail = |what: String| Err(Error::format(path, format!("byte {at}: PCD header: {what}")));
            let len = bytes[at..].iter().position(|&b| b == b'\n').filter(|len| at + len < MAX_HEADER);
            let Some(len) = len else { return fail("no line \"DATA\"".to_owned()) };
            let line = String::from_utf8_lossy(&bytes[at..at + len]).into_owned();
            let mut words = line.split_whitespace();
            let Some(key) = words.next() else {
                at += len + 1;
                continue;
            };
            let values: Vec<&str> = words.collect();
            let wrong = || fail(format!("{:?} is not understood", line.trim_end()));
            fn numbers<T: std::str::FromStr>(values: &[&str]) -> Option<Vec<T>> {
                values.iter().map(|v| v.parse().ok()).collect()
            }
            let one = || values.first().and_then(|v| v.parse::<u64>().ok());
            match key {
                _ if key.starts_with('#') => {}
                "VERSION" => version = values.first().copied().unwrap_or_default().trim_start_matches('.').to_owned(),
                "FIELDS" | "COLUMNS" => names = values.iter().map(|v| (*v).to_owned()).collect(),
                "SIZE" => match numbers::<usize>(&values) {
                    Some(v) => sizes = v,
                    None => return wrong(),
                },
                "TYPE" => types = values.iter().map(|v| (*v).to_owned()).collect(),
                "COUNT" => match numbers::<usize>(&values) {
                    Some(v) => counts = Some(v),
                    None => return wrong(),
                },
                "WIDTH" => width = one(),
                "HEIGHT" => height = one(),
                "POINTS" => points = one(),
                "VIEWPOINT" => {
                    let same = numbers::<f64>(&values).is_some_and(|v| v == [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]);
                    viewpoint = (!same).then(|| values.join(" "));
                }
                "DATA" => {
                    let form = match values.as_slice() {
                        ["ascii"] => Form::Text,
                        ["binary"] => Form::Binary,
                        ["binary_compressed"] => Form::Packed,
                        _ => return wrong(),
                    };
                    let n = points.or_else(|| width?.checked_mul(height.unwrap_or(1)));
                    let Some(n) = n else { return fail("neither POINTS nor WIDTH says how many there are".to_owned()) };
                    let counts = counts.unwrap_or_else(|| vec![1; names.len()]);
                    if names.is_empty() || [sizes.len(), types.len(), counts.len()] != [names.len(); 3] {
                        let of = [names.len(), sizes.len(), types.len(), counts.len()];
                        return fail(format!(
                            "FIELDS, SIZE, TYPE and COUNT have {of:?} values; expected the same number"
                        ));
                    }
                    let (mut fields, mut byte, mut value) = (Vec::new(), 0usize, 0usize);
                    for (i, name) in names.into_iter().enumerate() {
                        let of = match (types[i].as_str(), sizes[i]) {
                            ("I", 1 | 2 | 4 | 8) => Type::Signed,
                            ("U", 1 | 2 | 4 | 8) => Type::Unsigned,
                            ("F", 4 | 8) => Type::Float,
                            (of, size) => return fail(format!("field {name:?} of type {of} and {size} bytes")),
                        };
                        if counts[i] > 1 << 16 {
                            return fail(format!(
                                "field {name:?} has {} values a point, at most 65536 are read",
                                counts[i]
                            ));
                        }
                        fields.push(Field { name, size: sizes[i], of, count: counts[i], byte, value });
                        byte += sizes[i] * counts[i];
                        value += counts[i];
                    }
                    return Ok(Header { fields, n, form, viewpoint, at: at + len + 1, version });
                }
                _ => return wrong(),
            }
            at += len + 1;
        }
    }

    fn find(&self, names: &[&str]) -> Option<&Field> {
        self.fields.iter().find(|f| f.count > 0 && names.contains(&f.name.as_str()))
    }

    fn record(&self) -> usize {
        self.fields.iter().map(|f| f.size * f.count).sum()
    }
}

/// A value in binary, as a number and as its bits.
fn value(bytes: &[u8], field: &Field) -> (f64, u32) {
    let mut word = [0; 8];
    word[..field.size].copy_from_slice(&bytes[..field.size]);
    let bits = u64::from_le_bytes(word);
    let shift = 64 - 8 * field.size as u32;
    let number = match (field.of, field.size) {
        (Type::Float, 4) => f32::from_bits(bits as u32).into(),
        (Type::Float, _) => f64::from_bits(bits),
        (Type::Unsigned, _) => bits as f64,
        (Type::Signed, _) => ((bits << shift) as i64 >> shift) as f64,
    };
    (number, bits as u32)
}

/// A value in text, likewise.
fn text_value(text: &str, field: &Field) -> Option<(f64, u32)> {
    Some(match field.of {
        Type::Float => (text.parse().ok()?, text.parse::<f32>().ok()?.to_bits()),
        _ => {
            let number: i128 = text.parse().or_else(|_| text.parse::<f64>().map(|v| v as i128)).ok()?;
            (number as f64, number as u32)
        }
    })
}

/// What LZF packed into `packed`: runs of bytes, and repetitions of what came before.
fn unpack(packed: &[u8], len: usize) -> Option<Vec<u8>> {
    let mut out = Vec::with_capacity(len);
    let mut at = 0;
    while at < packed.len() {
        let control = usize::from(packed[at]);
        at += 1;
        if control < 32 {
            out.extend_from_slice(packed.get(at..at + control + 1)?);
            at += control + 1;
        } else {
            let mut n = control >> 5;
            if n == 7 {
                n += usize::from(*packed.get(at)?);
                at += 1;
            }
            let back = ((control & 31) << 8 | usize::from(*packed.get(at)?)) + 1;
            at += 1;
            let from = out.len().checked_sub(back)?;
            for i in from..from + n + 2 {
                out.push(out[i]);
            }
        }
        if out.len() > len {
            return None;
        }
    }
    (out.len() == len).then_some(out)
}

/// Gives the value of a field of one point, as a number and as its bits.
type Get<'a> = &'a dyn Fn(&Field) -> (f64, u32);

/// Fields that a point is made of.
struct Wanted<'a> {
    place: [&'a Field; 3],
    packed_color: Option<&'a Field>,
    color: Option<[&'a Field; 3]>,
    intensity: Option<&'a Field>,
    class: Option<&'a Field>,
}

pub(super) fn read(path: &Path, bytes: &[u8], opts: &ReadOptions) -> Result<Points> {
    let header = Header::read(path, bytes)?;
    let fail = |at: usize, what: String| Error::format(path, format!("byte {at}: PCD: {what}"));
    let [Some(x), Some(y), Some(z)] = ["x", "y", "z"].map(|name| header.find(&[name])) else {
        let names: Vec<&str> = header.fields.iter().map(|f| f.name.as_str()).collect();
        return Err(fail(0, format!("fields {names:?}; x, y and z are needed")));
    };
    let color = [["r", "red"], ["g", "green"], ["b", "blue"]].map(|names| header.find(&names));
    let wanted = Wanted {
        place: [x, y, z],
        packed_color: header.find(&["rgb", "rgba"]).filter(|f| f.size == 4),
        color: if let [Some(r), Some(g), Some(b)] = color { Some([r, g, b]) } else { None },
        intensity: header.find(&["intensity", "Intensity", "i", "reflectivity"]),
        class: header.find(&["label", "class", "classification"]),
    };
    let (record, n, start) = (header.record(), header.n, header.at);
    let rest = &bytes[start..];
    let need = n.checked_mul(record as u64).filter(|&len| usize::try_from(len).is_ok());
    let short = |have: u64| {
        let what =
            format!("{n} points of {record} bytes, {have} bytes are there; the file was cut short or is damaged");
        fail(start, what)
    };
    let mut unpacked = Vec::new();
    match header.form {
        Form::Text if n > rest.len() as u64 => return Err(short(rest.len() as u64)),
        Form::Text => {}
        Form::Binary => {
            if need.is_none_or(|len| len > rest.len() as u64) {
                return Err(short(rest.len() as u64));
            }
        }
        Form::Packed => {
            let word = |at: usize| rest.get(at..at + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
            let (Some(packed), Some(len)) = (word(0), word(4)) else { return Err(short(rest.len() as u64)) };
            let Some(packed) = rest.get(8..8 + packed as usize) else {
                return Err(fail(
                    start,
                    format!("{packed} packed bytes, {} are left; the file was cut short", rest.len() - 8),
                ));
            };
            if need != Some(len.into()) || u64::from(len) > LZF_MOST * packed.len() as u64 {
                return Err(fail(
                    start + 4,
                    format!("{} bytes packed from {len} for {n} points of {record}", packed.len()),
                ));
            }
            match unpack(packed, len as usize) {
                Some(bytes) => unpacked = bytes,
                None => {
                    return Err(fail(start + 8, format!("the packed bytes do not make {len}; the file is damaged")));
                }
            }
        }
    }

    let mut about = About::new(Kind::Points, format!("PCD {}", header.version).trim_end());
    if let Some(viewpoint) = &header.viewpoint {
        about.left_out.push(format!("the pose of the sensor (VIEWPOINT {viewpoint})"));
    }
    let has = Has {
        rgb: wanted.packed_color.is_some() || wanted.color.is_some(),
        class: wanted.class.is_some(),
        intensity: wanted.intensity.is_some(),
    };
    let range = std::cell::Cell::new([f64::INFINITY, f64::NEG_INFINITY]);
    // A point from whatever gives the value of a field.
    let point = |get: &dyn Fn(&Field) -> (f64, u32)| {
        let byte = |f: &Field| {
            let v = get(f).0;
            if f.of == Type::Float && v <= 1.0 { v * 255.0 } else { v }.clamp(0.0, 255.0).round() as u16
        };
        let color = match (wanted.packed_color, wanted.color) {
            (Some(field), _) => [16, 8, 0].map(|shift| (get(field).1 >> shift & 255) as u16),
            (_, Some(fields)) => fields.map(byte),
            _ => [0; 3],
        };
        let [low, high] = range.get();
        let intensity = wanted.intensity.map_or(0.0, |f| get(f).0);
        let intensity = ((intensity - low) / (high - low) * 65_535.0).round() as u16;
        let class = wanted.class.map_or(0.0, |f| get(f).0) as u8;
        Point { at: wanted.place.map(|f| get(f).0), color, intensity, class }
    };
    let each_value = |then: &mut dyn FnMut(Get<'_>) -> Result<()>| -> Result<()> {
        match header.form {
            Form::Binary => rest[..record * n as usize]
                .chunks_exact(record.max(1))
                .try_for_each(|r| then(&|f| value(&r[f.byte..], f))),
            Form::Packed => (0..n as usize)
                .try_for_each(|i| then(&|f| value(&unpacked[f.byte * n as usize + i * f.size * f.count..], f))),
            Form::Text => {
                let mut at = start;
                let mut words = Vec::new();
                for i in 0..n {
                    // Blank lines and comments are no points.
                    let line = loop {
                        let len = bytes[at..].iter().position(|&b| b == b'\n').unwrap_or(bytes.len() - at);
                        let line = std::str::from_utf8(&bytes[at..at + len]).map(str::trim);
                        let Ok(line) = line else { return Err(fail(at, format!("point {i} is no text"))) };
                        if !line.is_empty() && !line.starts_with('#') {
                            break line;
                        }
                        at += len + 1;
                        if at >= bytes.len() {
                            return Err(fail(bytes.len(), format!("the file ends after {i} of {n} points")));
                        }
                    };
                    words.clear();
                    words.extend(line.split_ascii_whitespace());
                    let values = header.fields.iter().map(|f| f.count).sum::<usize>();
                    if words.len() != values {
                        return Err(fail(at, format!("point {i} has {} values, expected {values}", words.len())));
                    }
                    for f in header.fields.iter().filter(|f| f.count > 0) {
                        if text_value(words[f.value], f).is_none() {
                            return Err(fail(at, format!("point {i}: {:?} is no number", words[f.value])));
                        }
                    }
                    then(&|f| text_value(words[f.value], f).unwrap_or((f64::NAN, 0)))?;
                    at = (at + bytes[at..].iter().position(|&b| b == b'\n').unwrap_or(bytes.len() - at) + 1)
                        .min(bytes.len());
                }
                Ok(())
            }
        }
    };
    if let Some(field) = wanted.intensity {
        each_value(&mut |get| {
            let (v, [low, high]) = (get(field).0, range.get());
            if v.is_finite() {
                range.set([low.min(v), high.max(v)]);
            }
            Ok(())
        })?;
    }
    let cloud = Cloud { about, has, claimed: None, quantum: [0.0; 3], metres: [1.0; 3], spacing: Spacing::Longest };
    let mut points =
        Points::new(path, opts, opts.up.unwrap_or(Up::Z), cloud, |then| each_value(&mut |get| then(point(get))))?;
    points.input_bytes = bytes.len() as u64;
    Ok(points)
}
