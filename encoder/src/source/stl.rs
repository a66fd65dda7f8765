//! STL, text and binary: any number of solids, one mesh.

use std::path::Path;

use super::mesh::{Mesh, PLAIN};
use super::text::{number, shown, without_bom};
use crate::{Error, Result, Rgb};

/// Bytes before the facets of a binary file, and those of a facet.
const HEAD: usize = 84;
const FACET: usize = 50;

/// STL, text or binary. Binary is what has just the length that its count of facets claims, whatever it starts with: many a binary
/// file starts with "solid", which is what text starts with.
pub(super) fn read(path: &Path, bytes: &[u8]) -> Result<Mesh> {
    let claimed = bytes.get(80..HEAD).map(|n| u32::from_le_bytes(n.try_into().expect("four bytes")));
    let whole = claimed.map(|n| HEAD as u64 + u64::from(n) * FACET as u64);
    let text = without_bom(path, bytes)?.trim_ascii_start();
    let is_text = text.get(..5).is_some_and(|word| word.eq_ignore_ascii_case(b"solid"));
    let (Some(n), Some(whole)) = (claimed, whole) else {
        return if is_text { read_text(path, bytes, text) } else { Err(neither(path, bytes)) };
    };
    if whole == bytes.len() as u64 || !is_text && whole < bytes.len() as u64 {
        return Ok(read_binary(bytes, n));
    }
    if is_text {
        return read_text(path, bytes, text);
    }
    let there = (bytes.len() - HEAD) / FACET;
    let what = format!("byte 80: STL: {n} facets are claimed, {there} are there; it was cut short or is damaged");
    Err(Error::format(path, what))
}

fn neither(path: &Path, bytes: &[u8]) -> Error {
    let what = "STL: neither text, which starts with \"solid\", nor binary, which has at least 84 bytes";
    Error::format(path, format!("{} bytes of {what}", bytes.len()))
}

/// `bytes` hold the facets that are claimed.
fn read_binary(bytes: &[u8], n: u32) -> Mesh {
    let mut mesh = Mesh::new("STL");
    let facets = &bytes[HEAD..][..n as usize * FACET];
    mesh.positions.reserve(3 * n as usize);
    mesh.triangles.reserve(n as usize);
    // Colours as Materialise Magics writes them: that of the whole in the header, and of facets that differ.
    let whole =
        bytes[..80].windows(10).find(|text| text.starts_with(b"COLOR=")).map(|text| [text[6], text[7], text[8]]);
    let mut own = 0u64;
    for (facet, i) in facets.chunks_exact(FACET).zip(0u32..) {
        for corner in facet[12..48].chunks_exact(12) {
            let value = |k: usize| f32::from_le_bytes(corner[4 * k..][..4].try_into().expect("four bytes"));
            mesh.positions.push([0, 1, 2].map(|k| value(k).into()));
        }
        mesh.triangles.push([3 * i, 3 * i + 1, 3 * i + 2]);
        let attribute = u16::from_le_bytes([facet[48], facet[49]]);
        own += u64::from(attribute != 0);
        if let Some(whole) = whole {
            let five = |shift: u16| {
                let v = attribute >> shift & 31;
                (v << 3 | v >> 2) as u8
            };
            let color: Rgb = if attribute >> 15 == 0 { [five(0), five(5), five(10)] } else { whole };
            mesh.mark(i as usize, Some(color), PLAIN);
        }
    }
    if whole.is_none() && own > 0 {
        mesh.about.left_out.push(format!("attributes of {own} facets, which no header explains"));
    }
    let left = bytes.len() - HEAD - facets.len();
    if left > 0 {
        mesh.about.left_out.push(format!("{left} bytes after the last facet"));
    }
    mesh.finish()
}

/// `text` is what `bytes` end in.
fn read_text(path: &Path, bytes: &[u8], text: &[u8]) -> Result<Mesh> {
    let mut mesh = Mesh::new("STL");
    let mut words = Words { path, text, before: bytes.len() - text.len(), at: 0, word: (0, &[]) };
    let (mut corners, mut solids, mut ended) = (Vec::new(), 0u64, true);
    while let Some(word) = words.next() {
        let is = |name: &str| word.eq_ignore_ascii_case(name.as_bytes());
        if is("solid") {
            (solids, ended) = (solids + 1, false);
            words.skip_name();
        } else if is("endsolid") {
            ended = true;
            words.skip_name();
        } else if is("facet") {
            words.expect("normal")?;
            // Normals are those of the corners; some writers put no numbers there.
            while !words.peek().is_some_and(|word| word.eq_ignore_ascii_case(b"outer")) {
                if words.next().is_none() {
                    return words.fail("the file ends inside a facet");
                }
            }
            words.expect("outer")?;
            words.expect("loop")?;
            corners.clear();
            loop {
                match words.next() {
                    Some(word) if word.eq_ignore_ascii_case(b"vertex") => {
                        let mut p = [0.0; 3];
                        for v in &mut p {
                            *v = words.number()?;
                        }
                        corners.push(mesh.positions.len() as u32);
                        mesh.positions.push(p);
                    }
                    Some(word) if word.eq_ignore_ascii_case(b"endloop") => break,
                    Some(word) => return words.wrong("\"vertex\" or \"endloop\"", word),
                    None => return words.fail("the file ends inside a facet"),
                }
            }
            words.expect("endfacet")?;
            if mesh.positions.len() > u32::MAX as usize / 4 {
                return Err(Error::Limit(format!("{}: more facets than can be held", path.display())));
            }
            mesh.push_polygon(&corners);
        } else {
            return words.wrong("\"facet\", \"endsolid\" or \"solid\"", word);
        }
    }
    if !ended {
        mesh.about.left_out.push("whatever came after the last facet: there is no \"endsolid\"".to_owned());
    }
    mesh.notes.push(format!("{solids} solids"));
    Ok(mesh.finish())
}

/// Words of a text, whatever lies between them.
struct Words<'a> {
    path: &'a Path,
    text: &'a [u8],
    /// Bytes of the file before the text.
    before: usize,
    at: usize,
    /// The last word, and where it stands.
    word: (usize, &'a [u8]),
}

impl<'a> Words<'a> {
    fn peek(&self) -> Option<&'a [u8]> {
        let start = self.at + self.text[self.at..].iter().position(|b| !b.is_ascii_whitespace())?;
        let rest = &self.text[start..];
        Some(&rest[..rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len())])
    }

    fn next(&mut self) -> Option<&'a [u8]> {
        self.at += self.text[self.at..].iter().position(|b| !b.is_ascii_whitespace())?;
        let rest = &self.text[self.at..];
        let len = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
        self.word = (self.at, &rest[..len]);
        self.at += len;
        Some(&rest[..len])
    }

    /// A name ends with its line, or where a facet follows in the same line.
    fn skip_name(&mut self) {
        let rest = &self.text[self.at..];
        let len = rest.iter().position(|&b| b == b'\n' || b == b'\r').unwrap_or(rest.len());
        let lower = rest[..len].to_ascii_lowercase();
        // A name may have the word, too: the facet's goes on with numbers, or with nothing that was one.
        let facet =
            lower.windows(7).zip(0..).filter(|(word, _)| word.starts_with(b" facet") && word[6].is_ascii_whitespace());
        let mut facets = facet.map(|(_, at)| at);
        let starts = |at: usize| {
            let mut words = lower[at + 7..].split(u8::is_ascii_whitespace).filter(|w| !w.is_empty());
            let normal = words.next() == Some(b"normal");
            normal && words.next().is_none_or(|w| number::<f64>(w).is_some() || w == b"outer" || w.ends_with(b")"))
        };
        self.at += facets.find(|&at| starts(at)).unwrap_or(len);
    }

    fn fail<T>(&self, what: impl std::fmt::Display) -> Result<T> {
        Err(Error::format(self.path, format!("byte {}: STL: {what}", self.before + self.word.0)))
    }

    fn wrong<T>(&self, expected: &str, found: &[u8]) -> Result<T> {
        self.fail(format!("expected {expected}, found {:?}", shown(found)))
    }

    fn expect(&mut self, name: &str) -> Result<()> {
        match self.next() {
            Some(word) if word.eq_ignore_ascii_case(name.as_bytes()) => Ok(()),
            Some(word) => self.wrong(&format!("{name:?}"), word),
            None => self.fail("the file ends inside a facet"),
        }
    }

    fn number(&mut self) -> Result<f64> {
        match self.next() {
            Some(word) => number(word).map_or_else(|| self.wrong("a number", word), Ok),
            None => self.fail("the file ends inside a facet"),
        }
    }
}
