//! PLY, text and binary: meshes, and clouds of points where there are no faces.

use std::io::Read;
use std::path::Path;

use super::mesh::Mesh;
use crate::{Error, Result};

#[derive(Clone, Copy, PartialEq)]
enum Form {
    Text,
    Little,
    Big,
}

#[derive(Clone, Copy)]
enum Type {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Type {
    fn parse(s: &str) -> Option<Type> {
        Some(match s {
            "char" | "int8" => Type::I8,
            "uchar" | "uint8" => Type::U8,
            "short" | "int16" => Type::I16,
            "ushort" | "uint16" => Type::U16,
            "int" | "int32" => Type::I32,
            "uint" | "uint32" => Type::U32,
            "float" | "float32" => Type::F32,
            "double" | "float64" => Type::F64,
            _ => return None,
        })
    }

    /// What a colour of this type is divided by.
    fn white(self) -> f64 {
        match self {
            Type::F32 | Type::F64 => 1.0,
            Type::U16 => 65_535.0,
            _ => 255.0,
        }
    }
}

struct Property {
    name: String,
    /// Type of the count, for lists.
    count: Option<Type>,
    of: Type,
}

struct Element {
    name: String,
    n: u64,
    properties: Vec<Property>,
}

/// Values one after the other, and where they stand.
struct Values<'a> {
    path: &'a Path,
    bytes: &'a [u8],
    at: usize,
    form: Form,
}

impl Values<'_> {
    fn fail<T>(&self, what: impl std::fmt::Display) -> Result<T> {
        Err(Error::format(self.path, format!("byte {}: {what}", self.at)))
    }

    fn next(&mut self, of: Type) -> Result<f64> {
        if self.form == Form::Text {
            while self.bytes.get(self.at).is_some_and(u8::is_ascii_whitespace) {
                self.at += 1;
            }
            let rest = &self.bytes[self.at..];
            let len = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
            let number = std::str::from_utf8(&rest[..len]).ok().and_then(|s| s.parse().ok());
            let Some(number) = number else {
                return self.fail(if len == 0 { "the file ends among its values" } else { "expected a number" });
            };
            self.at += len;
            return Ok(number);
        }
        macro_rules! take {
            ($t:ty) => {{
                let Some(Ok(bytes)) =
                    self.bytes.get(self.at..self.at + size_of::<$t>()).map(<[u8; size_of::<$t>()]>::try_from)
                else {
                    return self.fail("the file ends among its values");
                };
                self.at += bytes.len();
                f64::from(if self.form == Form::Big { <$t>::from_be_bytes(bytes) } else { <$t>::from_le_bytes(bytes) })
            }};
        }
        Ok(match of {
            Type::I8 => take!(i8),
            Type::U8 => take!(u8),
            Type::I16 => take!(i16),
            Type::U16 => take!(u16),
            Type::I32 => take!(i32),
            Type::U32 => take!(u32),
            Type::F32 => take!(f32),
            Type::F64 => take!(f64),
        })
    }
}

/// A mesh; one without triangles is a cloud of points. The bytes may be packed by gzip.
pub(super) fn read(path: &Path, bytes: &[u8]) -> Result<Mesh> {
    let mut unpacked = Vec::new();
    let bytes = if bytes.starts_with(b"\x1f\x8b") {
        let done = flate2::read::MultiGzDecoder::new(bytes).read_to_end(&mut unpacked);
        done.map_err(|e| Error::format(path, format!("gzip stream, after {} bytes: {e}", unpacked.len())))?;
        &unpacked
    } else {
        bytes
    };
    let (form, elements, at) = header(path, bytes)?;
    let mut values = Values { path, bytes, at, form };
    let mut mesh = Mesh::default();
    let mut corners: Vec<u32> = Vec::new();
    for element in &elements {
        let find = |names: &[&str]| element.properties.iter().position(|p| names.contains(&p.name.as_str()));
        let place = ["x", "y", "z"].map(|name| find(&[name]));
        let color = [["red", "r", "diffuse_red"], ["green", "g", "diffuse_green"], ["blue", "b", "diffuse_blue"]]
            .map(|names| find(&names));
        let is_vertex = element.name == "vertex";
        if is_vertex && place.contains(&None) {
            return Err(Error::format(path, "PLY: vertices without x, y and z"));
        }
        let list = (element.name == "face").then(|| find(&["vertex_indices", "vertex_index"])).flatten();
        // An element takes a byte at least, so that no header makes this program wait for more than the file has.
        if element.n > bytes.len() as u64 && !element.properties.is_empty() {
            return values.fail(format!("{} of {} do not fit the file", element.n, element.name));
        }
        for _ in 0..element.n.min(bytes.len() as u64) {
            let (mut p, mut c) = ([0f32; 3], [0u8; 3]);
            for (i, property) in element.properties.iter().enumerate() {
                let n = match property.count {
                    None => 1,
                    Some(count) => {
                        let n = values.next(count)?;
                        if !(0.0..=bytes.len() as f64).contains(&n) {
                            return values.fail(format!("a list of {n} values"));
                        }
                        n as usize
                    }
                };
                corners.clear();
                for _ in 0..n {
                    let value = values.next(property.of)?;
                    if list == Some(i) {
                        if !(0.0..=f64::from(u32::MAX)).contains(&value) {
                            return values.fail(format!("a face with corner {value}"));
                        }
                        corners.push(value as u32);
                    }
                    if let Some(axis) = place.iter().position(|&a| a == Some(i)) {
                        p[axis] = value as f32;
                    }
                    if let Some(channel) = color.iter().position(|&a| a == Some(i)) {
                        c[channel] = (value / property.of.white() * 255.0).clamp(0.0, 255.0).round() as u8;
                    }
                }
                if list == Some(i) {
                    mesh.push_polygon(&corners);
                }
            }
            if is_vertex {
                mesh.positions.push(p);
                if !color.contains(&None) {
                    mesh.colors.push(c);
                }
            }
        }
    }
    Ok(mesh)
}

/// Form, elements, and where the values start.
fn header(path: &Path, bytes: &[u8]) -> Result<(Form, Vec<Element>, usize)> {
    let (mut form, mut elements) = (None, Vec::<Element>::new());
    let mut at = 0;
    let mut line_ix = 0;
    loop {
        let fail = |what: String| Err(Error::format(path, format!("byte {at}: {what}")));
        let Some(len) = bytes[at..].iter().position(|&b| b == b'\n') else {
            return fail("the file ends inside the PLY header".to_owned());
        };
        let line = String::from_utf8_lossy(&bytes[at..at + len]);
        let words: Vec<&str> = line.split_whitespace().collect();
        let wrong = || fail(format!("PLY header: {:?} is not understood", line.trim_end()));
        match words.as_slice() {
            ["ply"] if line_ix == 0 => {}
            _ if line_ix == 0 => return fail("expected \"ply\"".to_owned()),
            ["format", name, _] => {
                form = Some(match *name {
                    "ascii" => Form::Text,
                    "binary_little_endian" => Form::Little,
                    "binary_big_endian" => Form::Big,
                    _ => return wrong(),
                });
            }
            ["comment" | "obj_info", ..] | [] => {}
            ["element", name, n] => {
                let Ok(n) = n.parse() else { return wrong() };
                elements.push(Element { name: (*name).to_owned(), n, properties: Vec::new() });
            }
            ["property", rest @ ..] => {
                let property = match rest {
                    ["list", count, of, name] => Some((Type::parse(count).map(Some), Type::parse(of), name)),
                    [of, name] => Some((Some(None), Type::parse(of), name)),
                    _ => None,
                };
                let (Some((Some(count), Some(of), name)), Some(element)) = (property, elements.last_mut()) else {
                    return wrong();
                };
                element.properties.push(Property { name: (*name).to_owned(), count, of });
            }
            ["end_header"] => {
                let Some(form) = form else { return fail("the PLY header ends without \"format\"".to_owned()) };
                return Ok((form, elements, at + len + 1));
            }
            _ => return wrong(),
        }
        at += len + 1;
        line_ix += 1;
    }
}
