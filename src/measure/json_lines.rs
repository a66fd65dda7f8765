//! A file of JSON values, one a line, that grows as work is done and survives a kill in the midst of a line.

use crate::Result;
use planecast_encoder::Error as FileError;
use serde::Serialize;
use std::fs::{self, File, OpenOptions};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

pub struct JsonLines {
    path: PathBuf,
    file: File,
    /// Length of the whole lines, where a line without an end follows them.
    torn: Option<u64>,
}

impl JsonLines {
    /// Opens a file, or begins one; gives its whole lines. A last line without an end goes when the next is written.
    pub fn open(path: &Path) -> Result<(JsonLines, Vec<String>)> {
        let text = match fs::read(path) {
            Ok(bytes) => bytes,
            Err(e) if e.kind() == ErrorKind::NotFound => Vec::new(),
            Err(e) => return Err(FileError::io(path, "read", e).into()),
        };
        let whole = text.iter().rposition(|&b| b == b'\n').map_or(0, |at| at + 1);
        let lines = String::from_utf8_lossy(&text[..whole]).lines().map(String::from).collect();
        let write = |e| FileError::io(path, "write", e);
        let file = OpenOptions::new().create(true).append(true).open(path).map_err(write)?;
        let torn = (whole < text.len()).then_some(whole as u64);
        Ok((JsonLines { path: path.into(), file, torn }, lines))
    }

    /// Adds values that belong together.
    pub fn append<T: Serialize>(&mut self, values: impl IntoIterator<Item = T>) -> Result<()> {
        let line = |v: T| serde_json::to_string(&v).expect("plain values have a JSON form") + "\n";
        let text: String = values.into_iter().map(line).collect();
        let cut = self.torn.take().map_or(Ok(()), |whole| self.file.set_len(whole));
        let written = cut.and_then(|()| self.file.write_all(text.as_bytes())).and_then(|()| self.file.flush());
        written.map_err(|e| FileError::io(&self.path, "write", e).into())
    }

    /// What is wrong with line `i`, counted from 0, and what to do.
    pub fn broken(&self, i: usize, e: impl std::fmt::Display, remedy: &str) -> crate::Error {
        FileError::format(&self.path, format!("line {}: {e}; {remedy}", i + 1)).into()
    }
}
