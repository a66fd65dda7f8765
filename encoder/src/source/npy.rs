//! NumPy arrays: volumes of three axes, shape (z, y, x), and height maps of two.
//!
//! The header is what `numpy.load` takes: a Python dictionary, with either kind of quotes, blanks anywhere, whole numbers that
//! end in L (Python 2), and a type as `numpy.dtype` knows it. Of an array of records the first field that is a number is read.

use std::borrow::Cow;
use std::io::Write;
use std::path::Path;

use super::heights::{Heights, Words};
use super::tiff::half;
use super::volume::{Data, Sample, Stored, Volume, byte_len, with_sample};
use super::{Dtype, ReadOptions, heightmap, world_dims};
use crate::model::about::Kind;
use crate::model::filled::filled;
use crate::model::pieces::Pieces;
use crate::store::scratch;
use crate::{About, Error, Result};

/// NumPy: an array of shape (z, y, x).
pub(super) fn npy<'a>(path: &Path, bytes: &'a [u8], opts: &ReadOptions) -> Result<Volume<'a>> {
    Volume::new(path, Array::new(path, bytes)?.stored(path)?, opts)
}

/// A volume whose values can be read as they are; None where it is a height map, or they are to be unpacked.
#[cfg(feature = "object-store")]
pub(super) fn plain_volume<'a>(path: &Path, bytes: &'a [u8]) -> Result<Option<Stored<'a>>> {
    let array = Array::new(path, bytes)?;
    if array.rank != 3 || !array.plain() { Ok(None) } else { array.stored(path).map(Some) }
}

/// A NumPy array of two axes as heights, shape (row, column); None where it has three.
pub(super) fn npy_heights(path: &Path, bytes: &[u8], in_file: bool) -> Result<Option<Heights>> {
    let array = Array::new(path, bytes)?;
    if array.rank != 2 { Ok(None) } else { array.heights(path, in_file.then_some(bytes)).map(Some) }
}

/// Values in memory as `numpy.ndarray` has them.
#[derive(Clone, Copy, Debug)]
pub struct ArrayView<'a> {
    /// Three axes (z, y, x), a volume; or two (row, column), a height map.
    pub shape: &'a [u64],
    /// As `numpy.dtype` names it: "<f4", "uint8".
    pub dtype: &'a str,
    /// Whether the first axis is the fastest.
    pub fortran: bool,
    /// Exactly the values, without gaps.
    pub bytes: &'a [u8],
}

/// An array in memory as a world, read as the file that `numpy.save` makes of it would be, without a copy of a volume's
/// values. `path` is what errors call it.
///
/// # Errors
/// [`Error::Format`] where shape, type or the number of bytes is none that can be read; and what the options do not fit.
pub fn array<'a>(path: &Path, view: ArrayView<'a>, opts: &ReadOptions) -> Result<Box<dyn Pieces + 'a>> {
    let fail = |what: String| Error::format(path, what);
    let number = number(view.dtype).map_err(fail)?;
    let (rank, dims) = axes(view.shape).map_err(fail)?;
    byte_len(path, dims, number.dtype)?;
    let expected = dims.iter().try_fold(number.size(), |n, &d| n.checked_mul(d));
    if expected != Some(view.bytes.len() as u64) {
        let (shape, n) = (view.shape, view.bytes.len());
        return Err(fail(format!("{n} bytes of values do not fit the shape {shape:?} of {}", view.dtype)));
    }
    let array = Array {
        rank,
        dims,
        fortran: view.fortran,
        number,
        stride: number.size(),
        offset: 0,
        values: view.bytes,
        left_out: Vec::new(),
    };
    if rank == 2 {
        let mut map = heightmap::Map::of(array.heights(path, None)?);
        map.about.format = "array".to_owned();
        return Ok(Box::new(heightmap::rows(path, map, view.bytes.len() as u64, opts)?));
    }
    let mut stored = array.stored(path)?;
    stored.about.format = "array".to_owned();
    Ok(Box::new(Volume::new(path, stored, opts)?))
}

/// Number of axes, 2 or 3, and their lengths, last axis first; axes of one place are left out where there are more.
pub(super) fn axes(shape: &[u64]) -> Result<(usize, [u64; 3]), String> {
    let mut axes = shape.to_vec();
    while axes.len() > 3
        && let Some(one) = axes.iter().position(|&n| n == 1)
    {
        axes.remove(one);
    }
    match *axes {
        [y, x] => Ok((2, [x, y, 1])),
        [z, y, x] => Ok((3, [x, y, z])),
        _ => {
            let what = format!("an array of shape {shape:?}; expected three axes (z, y, x), or two, a height map");
            let hint = if axes.len() > 3 { "; save one channel or time: numpy.save(name, a[0])" } else { "" };
            Err(what + hint)
        }
    }
}

/// What a header says, and the values.
struct Array<'a> {
    /// Number of axes, 2 or 3, without those of one place where there are more.
    rank: usize,
    /// Shape, last axis first.
    dims: [u64; 3],
    fortran: bool,
    number: Number,
    /// Bytes from a value to the next, and to the number in it: more than the number's own in records.
    stride: u64,
    offset: u64,
    /// Exactly the values.
    values: &'a [u8],
    left_out: Vec<String>,
}

/// A number as `numpy.dtype` names it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Number {
    dtype: Dtype,
    /// Half floats, which become `dtype`.
    half: bool,
    /// Any value but 0 is true.
    boolean: bool,
    big_endian: bool,
}

impl Number {
    fn size(self) -> u64 {
        if self.half { 2 } else { self.dtype.size() }
    }
}

impl<'a> Array<'a> {
    fn new(path: &Path, bytes: &'a [u8]) -> Result<Array<'a>> {
        let fail = |at: usize, what: String| Error::format(path, format!("byte {at}: {what}"));
        if !bytes.starts_with(b"\x93NUMPY") {
            return Err(fail(0, "expected the NPY signature \\x93NUMPY".to_owned()));
        }
        let (text_at, text_len) = match (bytes.get(6), bytes.get(8..12)) {
            (Some(1), Some(n)) => (10, u16::from_le_bytes([n[0], n[1]]) as usize),
            (Some(2 | 3), Some(n)) => (12, u32::from_le_bytes([n[0], n[1], n[2], n[3]]) as usize),
            (Some(n), Some(_)) => return Err(fail(6, format!("NPY version {n}; expected 1, 2 or 3"))),
            _ => return Err(fail(bytes.len(), "the file ends inside the NPY header".to_owned())),
        };
        let data_at = text_at + text_len;
        let text = bytes.get(text_at..data_at).ok_or_else(|| {
            fail(text_at, format!("expected {text_len} bytes of header text, the file has {}", bytes.len() - text_at))
        })?;
        let header = Python { text, at: 0, depth: 0 }.whole().map_err(|(at, what)| fail(text_at + at, what))?;
        let Value::Dict(fields) = header else {
            return Err(fail(text_at, "expected a dictionary of 'descr', 'fortran_order' and 'shape'".to_owned()));
        };
        let field = |name: &str| {
            let found = fields.iter().rev().find(|(key, _)| *key == Value::Text(name.to_owned())).map(|(_, v)| v);
            found.ok_or_else(|| fail(text_at, format!("the header's dictionary has no '{name}'")))
        };
        let (descr, order, shape) = (field("descr")?, field("fortran_order")?, field("shape")?);
        let Value::Bool(fortran) = *order else {
            return Err(fail(text_at, "fortran_order is neither True nor False".to_owned()));
        };
        let Value::Tuple(shape) = shape else {
            return Err(fail(text_at, format!("shape is {shape}; expected a tuple of whole numbers")));
        };
        let whole = |v: &Value| if let Value::Int(n) = v { Some(*n) } else { None };
        let shape: Vec<u64> = shape.iter().map(whole).collect::<Option<_>>().ok_or_else(|| {
            fail(text_at, "shape has what is no whole number; expected as many as there are axes".to_owned())
        })?;
        let mut left_out = Vec::new();
        let (number, stride, offset) = record(descr, &mut left_out).map_err(|what| fail(text_at, what))?;
        let (rank, dims) = axes(&shape).map_err(|what| fail(text_at, what))?;
        let [x, y, z] = dims;
        let of = [x, y, z].iter().try_fold(stride, |n, &d| n.checked_mul(d));
        byte_len(path, dims, number.dtype)?;
        let expected = of.ok_or_else(|| fail(text_at, format!("shape {shape:?} is beyond any memory")))?;
        let values = &bytes[data_at..];
        if (values.len() as u64) < expected {
            let what = format!("{} bytes of values, shape ({z}, {y}, {x}) expects {expected}", values.len());
            return Err(fail(data_at, what));
        }
        let after = values.len() as u64 - expected;
        if after > 0 {
            left_out.push(format!("{after} bytes after the array"));
        }
        let values = &values[..expected as usize];
        Ok(Array { rank, dims, fortran, number, stride, offset, values, left_out })
    }

    /// Whether values are stored as a volume takes them.
    fn plain(&self) -> bool {
        self.stride == self.number.dtype.size() && !self.number.half
    }

    /// Of two axes, as heights. Values that lie in `file`, the file's bytes, are read from there.
    fn heights(self, path: &Path, file: Option<&[u8]>) -> Result<Heights> {
        let Stored { dims: [width, height, _], dtype, big_endian, z_fastest, data, .. } = self.stored(path)?;
        // Columns of an array that is stored by columns are gathered from all over it.
        world_dims(path, [width, 1, height], "")?;
        let data = match file.filter(|_| !z_fastest) {
            Some(file) => {
                let data = data.in_file(path, file)?;
                if let Dtype::U16 | Dtype::I16 = dtype {
                    let words = Words { signed: dtype == Dtype::I16, big_endian };
                    return Heights::of_words(width as u32, height as u32, data, words);
                }
                data
            }
            None => data,
        };
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
                let rows = filled(&vec![n; end - z], "heights", |row, out: &mut [f32]| {
                    out.iter_mut().enumerate().for_each(|(x, out)| *out = value(x, z + row));
                })?;
                out.put(0, z as u32, width as u32, &rows)?;
            }
        });
        Ok(out)
    }

    fn stored(self, path: &Path) -> Result<Stored<'a>> {
        let plain = self.plain();
        let Array { dims, fortran, number, stride, offset, values, left_out, .. } = self;
        let mut about = About::new(Kind::Volume, "NPY");
        about.axes = "shape is (z, y, x)".to_owned();
        about.rule = if number.boolean { "booleans".to_owned() } else { String::new() };
        about.left_out = left_out;
        let (data, big_endian) = match plain {
            true => (Data::Slice(values), number.big_endian),
            false => (unpacked(path, values, number, stride as usize, offset as usize)?, cfg!(target_endian = "big")),
        };
        Ok(Stored { z_fastest: fortran, big_endian, about, ..Stored::new(dims, number.dtype, data) })
    }
}

/// The numbers alone, in a file without a name, in this machine's byte order.
fn unpacked(path: &Path, values: &[u8], number: Number, stride: usize, offset: usize) -> Result<Data<'static>> {
    let failed = |action| move |e| Error::io(std::env::temp_dir(), action, e);
    let mut file = scratch::file().map_err(failed("create a file in"))?;
    let (size, swap) = (number.size() as usize, number.big_endian != cfg!(target_endian = "big"));
    let mut len = 0;
    for some in values.chunks(stride << 16) {
        let mut out = Vec::with_capacity(some.len() / stride * number.dtype.size() as usize);
        for record in some.chunks_exact(stride) {
            let mut bytes = [0; 8];
            let bytes = &mut bytes[..size];
            bytes.copy_from_slice(&record[offset..offset + size]);
            if swap {
                bytes.reverse();
            }
            match number.half {
                true => out.extend_from_slice(&half(u16::from_ne_bytes([bytes[0], bytes[1]])).to_ne_bytes()),
                false => out.extend_from_slice(bytes),
            }
        }
        len += out.len() as u64;
        file.write_all(&out).map_err(failed("write a file in"))?;
    }
    Ok(Data::File { path: path.to_owned(), file, at: 0, len })
}

/// The number to read of a value, bytes of a value, and where in it the number is.
fn record(descr: &Value, left_out: &mut Vec<String>) -> Result<(Number, u64, u64), String> {
    let fields = match descr {
        Value::Text(name) => {
            let number = number(name)?;
            return Ok((number, number.size(), 0));
        }
        Value::List(fields) => fields,
        other => return Err(format!("values of type {other}; expected integers, booleans or floats")),
    };
    let (mut at, mut found, mut others) = (0u64, None, Vec::new());
    for field in fields {
        let Value::Tuple(parts) = field else { return Err(format!("a record's field is {field}; expected a tuple")) };
        let (name, of, shape) = match &parts[..] {
            [name, of] => (name, of, None),
            [name, of, shape] => (name, of, Some(shape)),
            _ => return Err(format!("a record's field is {field}; expected a name and a type")),
        };
        let bytes = bytes_of(of)?;
        let times = match shape {
            None => 1,
            Some(Value::Int(n)) => *n,
            Some(Value::Tuple(sizes)) => sizes.iter().try_fold(1u64, |n, v| match v {
                Value::Int(m) => n.checked_mul(*m).ok_or("a record beyond any memory"),
                _ => Err("a record's field has a shape that is no tuple of whole numbers"),
            })?,
            Some(other) => return Err(format!("a record's field has the shape {other}")),
        };
        // A title and a name; padding has none.
        let name = match name {
            Value::Tuple(both) => both.last().unwrap_or(name),
            one => one,
        };
        let scalar = match of {
            Value::Text(of) if shape.is_none() => number(of).ok(),
            _ => None,
        };
        match (scalar, &found) {
            (Some(number), None) => found = Some((number, at)),
            _ if *name == Value::Text(String::new()) => {}
            _ => others.push(name.to_string()),
        }
        at = bytes.checked_mul(times).and_then(|n| at.checked_add(n)).ok_or("a record beyond any memory")?;
    }
    let (number, offset) = found.ok_or_else(|| {
        format!("records of {descr}, none of whose fields is a number; save one field: numpy.save(name, a['field'])")
    })?;
    if !others.is_empty() {
        left_out.push(format!("fields {} of the records: the first number is read", others.join(", ")));
    }
    if at > 1 << 20 {
        return Err(format!("records of {at} bytes; at most {} are read", 1 << 20));
    }
    Ok((number, at, offset))
}

/// Bytes of a value of any type.
fn bytes_of(of: &Value) -> Result<u64, String> {
    match of {
        Value::Text(name) => {
            if let Ok(number) = number(name) {
                return Ok(number.size());
            }
            let bare = name.trim_start_matches(['<', '>', '|', '=']);
            let count = |s: &str| s.split('[').next().and_then(|s| s.parse::<u64>().ok());
            let bytes = match bare.split_at_checked(1) {
                Some(("c" | "f" | "V" | "S" | "a", n)) => count(n),
                Some(("U", n)) => count(n).and_then(|n| n.checked_mul(4)),
                Some(("M" | "m", _)) => Some(8),
                _ => None,
            };
            bytes.ok_or_else(|| format!("values of type {name:?} in a record; their length is not known"))
        }
        Value::List(_) => record(of, &mut Vec::new()).map(|(_, bytes, _)| bytes),
        other => Err(format!("values of type {other}; expected a name or a list of fields")),
    }
}

/// A type whose values are those of a volume as they lie, in this machine's byte order.
pub(super) fn plain_type(name: &str) -> Result<Dtype, String> {
    let Number { dtype, half, big_endian, .. } = number(name)?;
    if half || big_endian != cfg!(target_endian = "big") {
        return Err(format!(
            "values of type {name:?}; expected 8 bits, or more in this machine's byte order, and no half floats"
        ));
    }
    Ok(dtype)
}

/// A type as `numpy.dtype` takes it: "<f4", "uint8", "h".
fn number(name: &str) -> Result<Number, String> {
    let bare = name.trim_start_matches(['<', '>', '|', '=', '!']);
    let big_endian = name.starts_with(['>', '!']) || (cfg!(target_endian = "big") && !name.starts_with('<'));
    let dtype = match bare {
        "b1" | "?" | "bool" | "bool_" | "bool8" | "u1" | "B" | "uint8" | "ubyte" => Dtype::U8,
        "i1" | "b" | "int8" | "byte" => Dtype::I8,
        "u2" | "H" | "uint16" | "ushort" => Dtype::U16,
        "i2" | "h" | "int16" | "short" => Dtype::I16,
        "u4" | "I" | "uint32" | "uintc" => Dtype::U32,
        "i4" | "i" | "int32" | "intc" => Dtype::I32,
        // Of eight bytes where numpy runs on 64 bits (since its version 2 on Windows, too).
        "u8" | "L" | "Q" | "N" | "P" | "uint64" | "uint" | "ulong" | "ulonglong" | "uintp" => Dtype::U64,
        "i8" | "l" | "q" | "n" | "p" | "int64" | "int" | "int_" | "long" | "longlong" | "intp" => Dtype::I64,
        "f2" | "e" | "float16" | "half" | "f4" | "f" | "float32" | "single" => Dtype::F32,
        "f8" | "d" | "float64" | "float" | "double" => Dtype::F64,
        _ => {
            let what = match bare.chars().next() {
                Some('O') => "Python objects (pickled)",
                Some('c' | 'F' | 'D' | 'G') => "complex numbers",
                Some('M' | 'm') => "dates or times",
                Some('S' | 'U' | 'a') => "text",
                Some('V') => "bytes without a meaning",
                Some('f' | 'g') => "floats of more than 64 bits",
                _ => "a kind that is not known",
            };
            return Err(format!(
                "values of type {name:?} ({what}); expected integers, booleans or floats: numpy.save(name, a.astype('f4'))"
            ));
        }
    };
    let half = matches!(bare, "f2" | "e" | "float16" | "half");
    let boolean = matches!(bare, "b1" | "?" | "bool" | "bool_" | "bool8");
    Ok(Number { dtype, half, boolean, big_endian })
}

/// A Python literal, as far as headers hold them.
#[derive(Clone, Debug, PartialEq)]
enum Value {
    Text(String),
    Bool(bool),
    None,
    Int(u64),
    Tuple(Vec<Value>),
    List(Vec<Value>),
    Dict(Vec<(Value, Value)>),
}

impl std::fmt::Display for Value {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let list = |v: &[Value]| v.iter().map(Value::to_string).collect::<Vec<_>>().join(", ");
        let text: Cow<str> = match self {
            Value::Text(s) => format!("'{s}'").into(),
            Value::Bool(true) => "True".into(),
            Value::Bool(false) => "False".into(),
            Value::None => "None".into(),
            Value::Int(n) => n.to_string().into(),
            Value::Tuple(v) => format!("({})", list(v)).into(),
            Value::List(v) => format!("[{}]", list(v)).into(),
            Value::Dict(_) => "a dictionary".into(),
        };
        // What is said in an error stays a line.
        f.write_str(text.char_indices().nth(200).map_or(&text, |(end, _)| &text[..end]))
    }
}

struct Python<'a> {
    text: &'a [u8],
    at: usize,
    depth: u32,
}

type Wrong = (usize, String);

impl Python<'_> {
    fn whole(mut self) -> Result<Value, Wrong> {
        let value = self.value()?;
        self.blanks();
        match self.text.get(self.at) {
            None | Some(0) => Ok(value),
            Some(_) => self.wrong("something after the header's dictionary"),
        }
    }

    fn wrong<T>(&self, what: &str) -> Result<T, Wrong> {
        Err((self.at, format!("NPY header: {what}")))
    }

    fn blanks(&mut self) {
        while self.text.get(self.at).is_some_and(|b| b.is_ascii_whitespace() || *b == 0x0b) {
            self.at += 1;
        }
    }

    /// Takes the next byte that is no blank, if it is this one.
    fn take(&mut self, byte: u8) -> bool {
        self.blanks();
        let there = self.text.get(self.at) == Some(&byte);
        self.at += usize::from(there);
        there
    }

    fn word(&mut self) -> &str {
        let from = self.at;
        while self.text.get(self.at).is_some_and(|b| b.is_ascii_alphanumeric() || *b == b'_') {
            self.at += 1;
        }
        std::str::from_utf8(&self.text[from..self.at]).expect("letters and digits")
    }

    fn value(&mut self) -> Result<Value, Wrong> {
        self.depth += 1;
        if self.depth > 32 {
            return self.wrong("lists in lists, more than 32 deep");
        }
        self.blanks();
        let from = self.at;
        let value = match self.text.get(self.at) {
            Some(&open @ (b'(' | b'[')) => {
                self.at += 1;
                let (items, comma) = self.items(if open == b'(' { b')' } else { b']' })?;
                match (open, items.len()) {
                    (b'[', _) => Value::List(items),
                    // A value in parentheses.
                    (_, 1) if !comma => items.into_iter().next().expect("one"),
                    _ => Value::Tuple(items),
                }
            }
            Some(b'{') => {
                self.at += 1;
                let mut fields = Vec::new();
                while !self.take(b'}') {
                    let key = self.value()?;
                    if !self.take(b':') {
                        return self.wrong("expected a colon after a key");
                    }
                    fields.push((key, self.value()?));
                    if !self.take(b',') && !matches!(self.text.get(self.at), Some(b'}')) {
                        return self.wrong("expected a comma or the end of the dictionary");
                    }
                }
                Value::Dict(fields)
            }
            Some(b'\'' | b'"') => Value::Text(self.text()?),
            Some(b'0'..=b'9') => {
                let word = self.word().replace('_', "");
                let digits = word.trim_end_matches(['L', 'l']);
                match digits.parse() {
                    Ok(n) => Value::Int(n),
                    Err(_) => return Err((from, format!("NPY header: {word:?} is no whole number"))),
                }
            }
            _ => match self.word().to_owned().as_str() {
                "True" => Value::Bool(true),
                "False" => Value::Bool(false),
                "None" => Value::None,
                // Of Python 2: u'descr', b'descr'.
                "u" | "b" | "r" if matches!(self.text.get(self.at), Some(b'\'' | b'"')) => Value::Text(self.text()?),
                _ => return Err((from, "NPY header: expected a Python literal".to_owned())),
            },
        };
        self.depth -= 1;
        Ok(value)
    }

    /// Values up to `close`, and whether a comma stood after the last.
    fn items(&mut self, close: u8) -> Result<(Vec<Value>, bool), Wrong> {
        let (mut items, mut comma) = (Vec::new(), false);
        while !self.take(close) {
            if !items.is_empty() && !comma {
                return self.wrong("expected a comma or the end of the list");
            }
            items.push(self.value()?);
            comma = self.take(b',');
        }
        Ok((items, comma))
    }

    fn text(&mut self) -> Result<String, Wrong> {
        let quote = self.text[self.at];
        let from = self.at + 1;
        let mut out = Vec::new();
        let mut at = from;
        loop {
            match self.text.get(at) {
                None | Some(b'\n') => return self.wrong("text without an end"),
                Some(b'\\') => {
                    // As it stands: names of fields are said, not looked up.
                    out.extend(self.text.get(at + 1));
                    at += 2;
                }
                Some(&b) if b == quote => break,
                Some(&b) => {
                    out.push(b);
                    at += 1;
                }
            }
        }
        self.at = at + 1;
        Ok(String::from_utf8_lossy(&out).into_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn types_are_those_of_numpy() {
        let plain = |dtype, big_endian| Number { dtype, half: false, boolean: false, big_endian };
        for (name, expected) in [
            ("<i2", plain(Dtype::I16, false)),
            (">f8", plain(Dtype::F64, true)),
            ("=u4", plain(Dtype::U32, false)),
            ("float32", plain(Dtype::F32, false)),
            ("|b1", Number { boolean: true, ..plain(Dtype::U8, false) }),
            ("<f2", Number { half: true, ..plain(Dtype::F32, false) }),
        ] {
            assert_eq!(number(name), Ok(expected), "{name}");
        }
        assert!(number("|O").unwrap_err().contains("pickled"));
        assert!(number("<c8").unwrap_err().contains("complex"));
    }

    #[test]
    fn headers_are_python_literals() {
        let read = |text: &str| Python { text: text.as_bytes(), at: 0, depth: 0 }.whole();
        let int = |n| Value::Int(n);
        assert_eq!(read("( 6L ,\n17, 2_3,)"), Ok(Value::Tuple(vec![int(6), int(17), int(23)])));
        assert_eq!(read("(7)"), Ok(int(7)));
        assert_eq!(read("(7,) "), Ok(Value::Tuple(vec![int(7)])));
        assert_eq!(
            read("{\"a\": [u'b', None]}"),
            Ok(Value::Dict(vec![(
                Value::Text("a".to_owned()),
                Value::List(vec![Value::Text("b".to_owned()), Value::None])
            )]))
        );
        for bad in ["", "(1", "{'a' 1}", "'a", "(1 2)", "{'a': 1", "x", "-1", "(1,) 2", &"(".repeat(99)] {
            assert!(read(bad).is_err(), "{bad}");
        }
    }
}
