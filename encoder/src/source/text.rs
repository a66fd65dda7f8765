//! Words of text formats, and where they stand.

use std::path::Path;

use crate::{Error, Result};

/// What many editors put in front of text in UTF-8.
const BOM: &[u8] = b"\xef\xbb\xbf";

/// Text in UTF-8 or something like it; that in UTF-16 is refused.
pub(super) fn without_bom<'a>(path: &Path, bytes: &'a [u8]) -> Result<&'a [u8]> {
    if bytes.starts_with(b"\xff\xfe") || bytes.starts_with(b"\xfe\xff") {
        return Err(Error::format(path, "byte 0: text in UTF-16; save it as UTF-8"));
    }
    Ok(bytes.strip_prefix(BOM).unwrap_or(bytes))
}

/// Lines of text that end in LF, CR or both, without blanks around them, and with where they start; empty ones are left out.
/// Where `continued` says so, one that ends in `\` goes on with the next.
pub(super) struct Lines<'a> {
    bytes: &'a [u8],
    at: usize,
    continued: bool,
    /// A line that was put together.
    joined: Vec<u8>,
}

impl<'a> Lines<'a> {
    pub fn new(bytes: &'a [u8], continued: bool) -> Lines<'a> {
        Lines { bytes, at: 0, continued, joined: Vec::new() }
    }

    fn part(&mut self) -> Option<&'a [u8]> {
        let rest = self.bytes.get(self.at..).filter(|rest| !rest.is_empty())?;
        let len = rest.iter().position(|&b| b == b'\n' || b == b'\r').unwrap_or(rest.len());
        let end = if rest[len..].starts_with(b"\r\n") { 2 } else { 1 };
        self.at = (self.at + len + end).min(self.bytes.len());
        Some(&rest[..len])
    }

    pub fn next(&mut self) -> Option<(usize, &[u8])> {
        loop {
            let at = self.at;
            let line = self.part()?.trim_ascii();
            if self.continued && line.ends_with(b"\\") {
                self.joined.clear();
                self.joined.extend(&line[..line.len() - 1]);
                while let Some(more) = self.part() {
                    let more = more.trim_ascii_end();
                    self.joined.push(b' ');
                    match more.strip_suffix(b"\\") {
                        Some(more) => self.joined.extend(more),
                        None => {
                            self.joined.extend(more);
                            break;
                        }
                    }
                }
                return Some((at, self.joined.trim_ascii()));
            }
            if !line.is_empty() {
                return Some((at, line));
            }
        }
    }
}

/// Words between blanks.
pub(super) fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty())
}

/// A number, as any of these formats writes it.
pub(super) fn number<T: std::str::FromStr>(word: &[u8]) -> Option<T> {
    std::str::from_utf8(word).ok()?.parse().ok()
}

/// As it may be shown: at most so many characters that a message stays a line.
pub(super) fn shown(text: &[u8]) -> String {
    let text: String = String::from_utf8_lossy(text).chars().filter(|c| !c.is_control()).collect();
    match text.char_indices().nth(60) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_end_in_any_way_and_go_on() {
        let all = |text: &str, continued| {
            let mut lines = Lines::new(text.as_bytes(), continued);
            let mut out = Vec::new();
            while let Some((at, line)) = lines.next() {
                out.push((at, String::from_utf8(line.to_vec()).unwrap()));
            }
            out
        };
        let expected = |lines: &[(usize, &str)]| lines.iter().map(|&(at, s)| (at, s.to_owned())).collect::<Vec<_>>();
        assert_eq!(all("a b\n\n c", false), expected(&[(0, "a b"), (5, "c")]));
        assert_eq!(all("a b\r\rc\r", false), expected(&[(0, "a b"), (5, "c")]));
        assert_eq!(all("a b\r\nc\r\n", false), expected(&[(0, "a b"), (5, "c")]));
        assert_eq!(all("f 1 \\\n 2\\\r\n3\nf", true), expected(&[(0, "f 1   2 3"), (13, "f")]));
        assert_eq!(all("f 1 \\\n2", false), expected(&[(0, "f 1 \\"), (6, "2")]));
        assert_eq!(all("f 1 \\", true), expected(&[(0, "f 1")]));
        assert_eq!(words(b" a\tbc  d ").collect::<Vec<_>>(), [&b"a"[..], b"bc", b"d"]);
    }
}
