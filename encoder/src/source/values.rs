//! Values that do not lie in their file as a volume reads them: written as text, several a voxel, spread over files. They
//! go to a file without a name, so that they need not fit into memory.

use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use super::Dtype;
use super::volume::Data;
use crate::store::scratch::{self, File};
use crate::{Error, Result};

/// A file without a name that is being filled.
pub(super) struct Unpacked {
    out: BufWriter<File>,
    len: u64,
}

fn failed(action: &'static str) -> impl Fn(std::io::Error) -> Error {
    move |e| Error::io(std::env::temp_dir(), action, e)
}

impl Unpacked {
    pub fn new() -> Result<Unpacked> {
        let file = scratch::file().map_err(failed("create a file in"))?;
        Ok(Unpacked { out: BufWriter::with_capacity(1 << 20, file), len: 0 })
    }

    pub fn put(&mut self, bytes: &[u8]) -> Result<()> {
        self.len += bytes.len() as u64;
        self.out.write_all(bytes).map_err(failed("write a file in"))
    }

    /// What was put there, of the file at `path`.
    pub fn finish(self, path: &Path) -> Result<Data<'static>> {
        let file = self.out.into_inner().map_err(|e| failed("write a file in")(e.into_error()))?;
        Ok(Data::File { path: PathBuf::from(path), file, at: 0, len: self.len })
    }
}

/// `n` numbers written as text, little-endian.
pub(super) fn of_text(path: &Path, text: &[u8], at: usize, dtype: Dtype, n: u64) -> Result<Data<'static>> {
    let mut out = Unpacked::new()?;
    let mut found = 0;
    let mut words = text.split(|b| b.is_ascii_whitespace() || *b == b',').filter(|word| !word.is_empty());
    while found < n {
        let Some(word) = words.next() else {
            return Err(Error::format(path, format!("byte {at}: {found} numbers written as text; {n} were expected")));
        };
        let text = std::str::from_utf8(word).ok();
        let wrong = || {
            let word = String::from_utf8_lossy(word);
            Error::format(
                path,
                format!("byte {at} and on: number {found} of the values is {word:?}, which no {dtype:?} is"),
            )
        };
        macro_rules! put {
            ($t:ident) => {
                match text.and_then(|t| t.parse::<$t>().ok()) {
                    Some(v) => out.put(&v.to_le_bytes())?,
                    None => return Err(wrong()),
                }
            };
        }
        match dtype {
            Dtype::U8 => put!(u8),
            Dtype::I8 => put!(i8),
            Dtype::U16 => put!(u16),
            Dtype::I16 => put!(i16),
            Dtype::U32 => put!(u32),
            Dtype::I32 => put!(i32),
            Dtype::U64 => put!(u64),
            Dtype::I64 => put!(i64),
            Dtype::F32 => put!(f32),
            Dtype::F64 => put!(f64),
        }
        found += 1;
    }
    out.finish(path)
}

/// The first of the `components` values of each voxel.
pub(super) fn first_of(path: &Path, data: &Data, size: u64, components: u64) -> Result<Data<'static>> {
    let mut out = Unpacked::new()?;
    let (mut buffer, mut firsts) = (Vec::new(), Vec::new());
    let voxel = size * components;
    let together = ((1 << 20) / voxel).max(1) * voxel;
    let mut at = 0;
    while at < data.len() {
        let len = together.min(data.len() - at);
        firsts.clear();
        for voxel in data.read(at, len as usize, &mut buffer)?.chunks_exact(voxel as usize) {
            firsts.extend_from_slice(&voxel[..size as usize]);
        }
        out.put(&firsts)?;
        at += len;
    }
    out.finish(path)
}

/// Values of several files, one after the other.
pub(super) fn joined(path: &Path, parts: impl Iterator<Item = Result<Data<'static>>>) -> Result<Data<'static>> {
    let mut out = Unpacked::new()?;
    let mut buffer = Vec::new();
    for part in parts {
        let part = part?;
        let mut at = 0;
        while at < part.len() {
            let len = (part.len() - at).min(1 << 20);
            out.put(part.read(at, len as usize, &mut buffer)?)?;
            at += len;
        }
    }
    out.finish(path)
}

/// Three or any number of numbers in a text like "(1, 0.5 ,2)" or "1 0.5 2".
pub(super) fn numbers(text: &str) -> Option<Vec<f64>> {
    let words = text.trim_matches(['(', ')', ' ', '\t']).split([' ', ',', '\t']).filter(|w| !w.is_empty());
    words.map(|word| word.parse().ok()).collect()
}
