//! VTK image data (`.vti`): XML that names arrays of values on the points or in the cells of a regular grid.
//!
//! The format's text is the VTK User's Guide, "XML File Formats". Values are text, base64 or raw, within their element or
//! appended after all of them, in blocks of zlib or LZ4 or in one piece. Of the arrays the one is read that the file names as
//! its scalars, else the first, points before cells.

use std::io::Read;
use std::ops::Range;
use std::path::Path;

use flate2::read::ZlibDecoder;
use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};

use super::place::Place;
use super::values::{Unpacked, first_of, numbers, of_text};
use super::volume::{Data, Facts, Stored, Volume, byte_len, unpack};
use super::{Dtype, ReadOptions};
use crate::model::about::{About, Kind};
use crate::{Error, Result};

/// Whether a file that begins so is one of VTK's in XML.
pub(super) fn is_vtk_xml(head: &[u8]) -> bool {
    head[..head.len().min(1024)].windows(8).any(|w| w == b"<VTKFile")
}

/// An array that the file describes.
struct Array {
    name: String,
    dtype: String,
    components: u64,
    format: String,
    offset: Option<u64>,
    cells: bool,
    content: Range<usize>,
}

/// What the XML says.
#[derive(Default)]
struct Described {
    kind: String,
    big_endian: bool,
    wide: bool,
    compressor: String,
    extent: Option<[i64; 6]>,
    pieces: usize,
    origin: [f64; 3],
    spacing: Option<[f64; 3]>,
    direction: Option<[f64; 9]>,
    scalars: [String; 2],
    arrays: Vec<Array>,
    /// Where appended values start, and whether they are base64.
    appended: Option<(usize, bool)>,
}

fn attribute(element: &BytesStart, name: &str) -> Option<String> {
    let value = element.try_get_attribute(name).ok()??;
    let text = String::from_utf8_lossy(&value.value).into_owned();
    Some(quick_xml::escape::unescape(&text).map_or(text.clone(), |t| t.into_owned()))
}

fn described(path: &Path, bytes: &[u8]) -> Result<Described> {
    let fail = |at: usize, what: String| Error::format(path, format!("byte {at}: {what}"));
    let mut reader = Reader::from_reader(bytes);
    let mut found = Described::default();
    // Within the data of points or cells; None elsewhere.
    let mut cells: Option<bool> = None;
    let mut open: Option<usize> = None;
    loop {
        let at = reader.buffer_position() as usize;
        let event = reader.read_event().map_err(|e| fail(at, format!("XML: {e}")))?;
        let after = reader.buffer_position() as usize;
        let (element, is_empty) = match &event {
            Event::Start(element) => (element, false),
            Event::Empty(element) => (element, true),
            Event::End(element) => {
                match element.name().as_ref() {
                    b"PointData" | b"CellData" => cells = None,
                    b"DataArray" => {
                        if let Some(i) = open.take() {
                            found.arrays[i].content.end = at;
                        }
                    }
                    _ => {}
                }
                continue;
            }
            Event::Eof => break,
            _ => continue,
        };
        let text = |name: &str| attribute(element, name).unwrap_or_default();
        let three = |name: &str| -> Result<Option<[f64; 3]>> {
            let Some(text) = attribute(element, name) else { return Ok(None) };
            let three = numbers(&text).and_then(|v| v.try_into().ok());
            three.map(Some).ok_or_else(|| fail(at, format!("{name}={text:?}: expected three numbers")))
        };
        match element.name().as_ref() {
            b"VTKFile" => {
                found.kind = text("type");
                found.big_endian = text("byte_order") == "BigEndian";
                found.wide = text("header_type") == "UInt64";
                found.compressor = text("compressor");
                if found.kind != "ImageData" {
                    return Err(fail(
                        at,
                        format!(
                            "VTK XML of type {:?}; only ImageData is a volume: resample to an image and save that",
                            found.kind
                        ),
                    ));
                }
            }
            b"ImageData" => {
                found.origin = three("Origin")?.unwrap_or_default();
                found.spacing = three("Spacing")?;
                found.direction = numbers(&text("Direction")).and_then(|v| v.try_into().ok());
            }
            b"Piece" => {
                found.pieces += 1;
                let extent = text("Extent");
                let numbers: Option<Vec<i64>> = extent.split_whitespace().map(|w| w.parse().ok()).collect();
                let extent = numbers
                    .and_then(|v| v.try_into().ok())
                    .ok_or_else(|| fail(at, format!("Extent={extent:?}: expected six whole numbers")))?;
                found.extent.get_or_insert(extent);
            }
            b"PointData" | b"CellData" if !is_empty => {
                let of_cells = element.name().as_ref() == b"CellData";
                cells = Some(of_cells);
                found.scalars[usize::from(of_cells)] = text("Scalars");
            }
            b"DataArray" => {
                let Some(cells) = cells.filter(|_| found.pieces == 1) else { continue };
                let components = attribute(element, "NumberOfComponents").map_or(Some(1), |n| n.trim().parse().ok());
                found.arrays.push(Array {
                    name: text("Name"),
                    dtype: text("type"),
                    components: components
                        .filter(|&n| n > 0)
                        .ok_or_else(|| fail(at, "NumberOfComponents: expected 1 or more".to_owned()))?,
                    format: text("format"),
                    offset: attribute(element, "offset").and_then(|o| o.trim().parse().ok()),
                    cells,
                    content: after..after,
                });
                if !is_empty {
                    open = Some(found.arrays.len() - 1);
                }
            }
            b"AppendedData" => {
                let begin = bytes[after..]
                    .iter()
                    .position(|&b| b == b'_')
                    .ok_or_else(|| fail(after, "AppendedData without its mark _".to_owned()))?;
                let encoding = text("encoding");
                let base64 = match encoding.as_str() {
                    "base64" => true,
                    "raw" => false,
                    _ => {
                        return Err(fail(
                            at,
                            format!("AppendedData with encoding {encoding:?}; expected raw or base64"),
                        ));
                    }
                };
                found.appended = Some((after + begin + 1, base64));
                // What follows is no XML.
                break;
            }
            _ => {}
        }
    }
    Ok(found)
}

pub(super) fn read<'a>(path: &Path, bytes: &'a [u8], opts: &ReadOptions) -> Result<Volume<'a>> {
    let fail = |what: String| Err(Error::format(path, what));
    let found = described(path, bytes)?;
    if found.pieces > 1 {
        return fail(format!(
            "VTK image data in {} pieces; save it as one (ParaView: Save Data of the merged image)",
            found.pieces
        ));
    }
    let Some(extent) = found.extent else {
        return fail("VTK image data without a Piece and its Extent".to_owned());
    };
    let named = |cells: bool| {
        let scalars = &found.scalars[usize::from(cells)];
        let mut of = found.arrays.iter().filter(|a| a.cells == cells);
        of.clone().find(|a| !scalars.is_empty() && a.name == *scalars).or_else(|| of.next())
    };
    let Some(array) = named(false).or_else(|| named(true)) else {
        return fail("VTK image data without an array on its points or cells".to_owned());
    };
    let what = format!("array {:?}", array.name);
    let mut dims = [0u64; 3];
    for (k, n) in dims.iter_mut().enumerate() {
        let span = extent[2 * k + 1].checked_sub(extent[2 * k]).filter(|&s| (0..1 << 40).contains(&s));
        let Some(span) = span else {
            return fail(format!("Extent {extent:?}: expected first and last of each axis, ascending"));
        };
        *n = if array.cells { span.max(1) } else { span + 1 } as u64;
    }
    let dtype = match array.dtype.as_str() {
        "UInt8" => Dtype::U8,
        "Int8" => Dtype::I8,
        "UInt16" => Dtype::U16,
        "Int16" => Dtype::I16,
        "UInt32" => Dtype::U32,
        "Int32" => Dtype::I32,
        "UInt64" => Dtype::U64,
        "Int64" => Dtype::I64,
        "Float32" => Dtype::F32,
        "Float64" => Dtype::F64,
        other => return fail(format!("{what} of type {other:?}; expected Int8 to UInt64, Float32 or Float64")),
    };
    let beyond = || Error::Limit(format!("{}: {what} is beyond any memory", path.display()));
    let expected = byte_len(path, dims, dtype)?.checked_mul(array.components).ok_or_else(beyond)?;
    let coded = Coded { path, what: &what, found: &found, expected };
    let mut big_endian = found.big_endian;
    let content = &bytes[array.content.clone()];
    let data = match (array.format.as_str(), found.appended) {
        ("ascii", _) => {
            big_endian = false;
            of_text(path, content, array.content.start, dtype, expected / dtype.size())?
        }
        ("binary" | "", _) => coded.values(content, array.content.start, true)?,
        ("appended", Some((start, base64))) => {
            let at = array
                .offset
                .and_then(|offset| usize::try_from(offset).ok()?.checked_add(start))
                .filter(|&at| at <= bytes.len());
            let Some(at) = at else {
                return fail(format!("{what}: offset {:?} is not inside the appended data", array.offset));
            };
            coded.values(&bytes[at..], at, base64)?
        }
        ("appended", None) => return fail(format!("{what} is appended, but there is no AppendedData")),
        (other, _) => return fail(format!("{what}: format {other:?}; expected ascii, binary or appended")),
    };
    let data = match array.components {
        1 => data,
        n => first_of(path, &data, dtype.size(), n)?,
    };

    let on = if array.cells { "cells" } else { "points" };
    let mut about = About::new(Kind::Volume, format!("VTK image data, {what} of its {on}"));
    let mut facts = Facts { measured: true, ..Facts::default() };
    if array.components > 1 {
        about.left_out.push(format!(
            "{} of {} values a voxel: the first is read",
            array.components - 1,
            array.components
        ));
    }
    let others: Vec<&str> = found.arrays.iter().filter(|a| !std::ptr::eq(*a, array)).map(|a| a.name.as_str()).collect();
    if !others.is_empty() {
        let shown = others.iter().take(5).map(|n| format!("{n:?}")).collect::<Vec<_>>().join(", ");
        let more = if others.len() > 5 { ", …" } else { "" };
        about.left_out.push(format!("{} other arrays: {shown}{more}", others.len()));
    }
    let direction = found.direction.unwrap_or([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    let spacing = found.spacing.unwrap_or([1.0; 3]);
    let steps = [0, 1, 2].map(|f| [0, 1, 2].map(|c| direction[3 * c + f] * spacing[f].abs()));
    let mut origin = found.origin;
    for (f, step) in steps.iter().enumerate() {
        let first = extent[2 * f] as f64 + if array.cells { 0.5 } else { 0.0 };
        (0..3).for_each(|c| origin[c] += first * step[c]);
    }
    match (Place { steps, origin, anatomy: false, stated: "Direction" }).checked() {
        Ok(place) => facts.place = Some(place),
        Err(what) => about.left_out.push(what),
    }
    let stored = Stored { big_endian, about, ..Stored::new(dims, dtype, data) };
    Volume::with(path, stored, facts, opts)
}

/// Values behind a head that says how long they are.
struct Coded<'f> {
    path: &'f Path,
    what: &'f str,
    found: &'f Described,
    expected: u64,
}

impl Coded<'_> {
    /// What `code` holds, which starts at byte `at` of the file.
    fn values<'a>(&self, code: &'a [u8], at: usize, base64: bool) -> Result<Data<'a>> {
        let Coded { path, what, expected, .. } = *self;
        let fail = |said: String| Error::format(path, format!("byte {at}: {what}: {said}"));
        let mut stream: Box<dyn Read + 'a> = if base64 { Box::new(Base64::new(code)) } else { Box::new(code) };
        let wide = self.found.wide;
        if self.found.compressor.is_empty() {
            let len = self.word(&mut stream).ok_or_else(|| fail("its length is missing".to_owned()))?;
            if len != expected {
                return Err(fail(format!("{len} bytes of values; its extent and type expect {expected}")));
            }
            if !base64 {
                let values = code.get(if wide { 8 } else { 4 }..).and_then(|v| v.get(..expected as usize));
                return Ok(Data::Slice(
                    values.ok_or_else(|| fail(format!("the file ends within its {expected} bytes")))?,
                ));
            }
            return unpack(path, what, stream, 0, expected)?
                .map_err(|got| fail(format!("{got} bytes; {expected} were expected")));
        }
        let zlib = match self.found.compressor.as_str() {
            "vtkZLibDataCompressor" => true,
            "vtkLZ4DataCompressor" => false,
            other => return Err(fail(format!("compressor {other:?}; save it with zlib, LZ4 or none"))),
        };
        let mut word = |name: &str| self.word(&mut stream).ok_or_else(|| fail(format!("{name} is missing")));
        let (blocks, size, last) =
            (word("the number of blocks")?, word("the size of blocks")?, word("the size of the last block")?);
        let total = match (blocks, last) {
            (0, _) => Some(0),
            (_, 0) => blocks.checked_mul(size),
            _ => (blocks - 1).checked_mul(size).and_then(|n| n.checked_add(last)),
        };
        if total != Some(expected) {
            return Err(fail(format!(
                "{blocks} blocks of {size} bytes, the last of {last}; its extent and type expect {expected} in all"
            )));
        }
        // Grows with what is there, not with what is claimed.
        let mut packed = Vec::new();
        for _ in 0..blocks {
            packed.push(word("the packed size of a block")?);
        }
        let mut out = Unpacked::new()?;
        let (mut from, mut block) = (Vec::new(), Vec::new());
        for (i, &len) in packed.iter().enumerate() {
            let want = if i as u64 == blocks - 1 && last > 0 { last } else { size };
            let damaged = |why: String| fail(format!("block {i} of {blocks}: {why}"));
            from.clear();
            stream.by_ref().take(len).read_to_end(&mut from).map_err(|e| damaged(e.to_string()))?;
            if (from.len() as u64) < len {
                return Err(damaged(format!("the file ends within its {len} bytes")));
            }
            block.clear();
            if zlib {
                ZlibDecoder::new(&*from).take(want + 1).read_to_end(&mut block).map_err(|e| damaged(e.to_string()))?;
            } else {
                // A byte of LZ4 stands for 255 at most.
                if want > len.saturating_mul(255).saturating_add(64) {
                    return Err(damaged(format!("{len} bytes of LZ4 are no {want} bytes")));
                }
                block.resize(want as usize, 0);
                let n = lz4_flex::block::decompress_into(&from, &mut block).map_err(|e| damaged(e.to_string()))?;
                block.truncate(n);
            }
            if block.len() as u64 != want {
                return Err(damaged(format!("{} bytes; {want} were expected", block.len())));
            }
            out.put(&block)?;
        }
        out.finish(path)
    }

    /// The next word of a head.
    fn word(&self, stream: &mut impl Read) -> Option<u64> {
        let (wide, big) = (self.found.wide, self.found.big_endian);
        let mut bytes = [0; 8];
        let word = &mut bytes[..if wide { 8 } else { 4 }];
        stream.read_exact(word).ok()?;
        if big {
            word.reverse();
        }
        Some(u64::from_le_bytes(bytes))
    }
}

/// Bytes behind base64, which may be several texts one after the other, each padded by itself.
struct Base64<'a> {
    code: std::slice::Iter<'a, u8>,
    /// Bytes that were not asked for yet.
    left: [u8; 3],
    n: usize,
}

impl<'a> Base64<'a> {
    fn new(code: &'a [u8]) -> Base64<'a> {
        Base64 { code: code.iter(), left: [0; 3], n: 0 }
    }

    /// The next one to three bytes, turned round; 0 where the text ends.
    fn group(&mut self) -> std::io::Result<usize> {
        let (mut bits, mut n) = (0u32, 0);
        while n < 4 {
            let Some(&byte) = self.code.next() else { break };
            let six = match byte {
                b'A'..=b'Z' => byte - b'A',
                b'a'..=b'z' => byte - b'a' + 26,
                b'0'..=b'9' => byte - b'0' + 52,
                b'+' => 62,
                b'/' => 63,
                b'=' => {
                    // One or two of them end a group.
                    if n == 2 && self.code.as_slice().first() == Some(&b'=') {
                        self.code.next();
                    }
                    break;
                }
                b' ' | b'\t' | b'\r' | b'\n' => continue,
                // The end of the element.
                b'<' => {
                    self.code = [].iter();
                    break;
                }
                _ => {
                    return Err(std::io::Error::new(
                        std::io::ErrorKind::InvalidData,
                        format!("{:?} is not base64", char::from(byte)),
                    ));
                }
            };
            bits |= u32::from(six) << (18 - 6 * n);
            n += 1;
        }
        let [_, a, b, c] = bits.to_be_bytes();
        let bytes = n.max(1) - 1;
        self.left = match bytes {
            3 => [c, b, a],
            2 => [b, a, 0],
            _ => [a, 0, 0],
        };
        self.n = bytes;
        Ok(bytes)
    }
}

impl Read for Base64<'_> {
    fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
        let mut done = 0;
        while done < out.len() {
            if self.n == 0 && self.group()? == 0 {
                break;
            }
            self.n -= 1;
            out[done] = self.left[self.n];
            done += 1;
        }
        Ok(done)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_is_read_over_blanks_and_padding_between() {
        let read = |code: &str| {
            let mut out = Vec::new();
            Base64::new(code.as_bytes()).read_to_end(&mut out).map(|_| String::from_utf8(out).unwrap())
        };
        assert_eq!(read("aGVs\n  bG8=").unwrap(), "hello");
        assert_eq!(read("aA==aGVsbG8=eA==").unwrap(), "hhellox");
        assert_eq!(read("aGVsbG8h</DataArray>").unwrap(), "hello!");
        assert!(read("a?==").is_err());
    }
}
