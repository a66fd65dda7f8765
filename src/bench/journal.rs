//! What has been measured so far, a line a row, so that a run that was stopped goes on where it was.
//!
//! The first line states what the run is of; a folder with another first line is refused, since its figures are not
//! comparable. A last line without an end, of a run that was killed, is dropped.

use super::row::Row;
use crate::{Error, Result};
use planecast_encoder::Error as FileError;
use std::collections::HashMap;
use std::fs::{self, File, OpenOptions};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

pub struct Journal {
    path: PathBuf,
    file: File,
    rows: HashMap<String, Row>,
}

impl Journal {
    /// Opens the journal at `path`, or begins one for `settings`.
    pub fn open(path: &Path, settings: &serde_json::Value) -> Result<Journal> {
        let head = settings.to_string();
        let text = match fs::read_to_string(path) {
            Ok(text) => text,
            Err(e) if e.kind() == ErrorKind::NotFound => String::new(),
            Err(e) => return Err(FileError::io(path, "read", e).into()),
        };
        let whole = &text[..text.rfind('\n').map_or(0, |at| at + 1)];
        let mut lines = whole.lines();
        let mut rows = HashMap::new();
        if let Some(first) = lines.next() {
            if first != head {
                return Err(Error::Argument(format!(
                    "{}: is of another run ({first}); give -o another folder, or delete this one",
                    path.display()
                )));
            }
            for (i, line) in lines.enumerate() {
                let row: Row = serde_json::from_str(line).map_err(|e| {
                    let line = i + 2;
                    FileError::format(path, format!("line {line}: {e}; delete the file to measure anew"))
                })?;
                rows.insert(row.key.clone(), row);
            }
        }
        let write = |e| Error::from(FileError::io(path, "write", e));
        let file = OpenOptions::new().append(true).create(true).open(path).map_err(write)?;
        file.set_len(whole.len() as u64).map_err(write)?;
        let mut journal = Journal { path: path.into(), file, rows };
        if whole.is_empty() {
            journal.append(&(head + "\n"))?;
        }
        Ok(journal)
    }

    fn append(&mut self, text: &str) -> Result<()> {
        let written = self.file.write_all(text.as_bytes()).and_then(|()| self.file.flush());
        written.map_err(|e| FileError::io(&self.path, "write", e).into())
    }

    /// Adds rows that were measured together; a later row replaces one of the same key.
    pub fn add(&mut self, rows: impl IntoIterator<Item = Row>) -> Result<()> {
        let mut text = String::new();
        for row in rows {
            text += &serde_json::to_string(&row).expect("plain values have a JSON form");
            text.push('\n');
            self.rows.insert(row.key.clone(), row);
        }
        self.append(&text)
    }

    pub fn get(&self, key: &str) -> Option<&Row> {
        self.rows.get(key)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(key: &str, ms: f64) -> Row {
        Row { key: key.into(), total_ms: Some(ms), ..Row::default() }
    }

    #[test]
    fn journal_goes_on_and_drops_half_a_line() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("journal.jsonl");
        let settings = serde_json::json!({"quick": true});
        let mut journal = Journal::open(&path, &settings).unwrap();
        journal.add([row("a", 1.0), row("b", 2.0)]).unwrap();
        journal.add([row("a", 3.0)]).unwrap();
        drop(journal);
        let whole = fs::read_to_string(&path).unwrap();
        fs::write(&path, format!("{whole}{{\"key\":\"c\",\"to")).unwrap();

        let mut journal = Journal::open(&path, &settings).unwrap();
        let ms = |j: &Journal, key: &str| j.get(key).and_then(|r| r.total_ms);
        assert_eq!((ms(&journal, "a"), ms(&journal, "b"), ms(&journal, "c")), (Some(3.0), Some(2.0), None));
        journal.add([row("c", 4.0)]).unwrap();
        drop(journal);
        assert_eq!(ms(&Journal::open(&path, &settings).unwrap(), "c"), Some(4.0));
    }

    #[test]
    fn journal_of_another_run_or_with_a_broken_line_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("journal.jsonl");
        let settings = serde_json::json!({"quick": true});
        Journal::open(&path, &settings).unwrap().add([row("a", 1.0)]).unwrap();
        let refused = |settings: &serde_json::Value| Journal::open(&path, settings).err().expect("refused").to_string();
        assert!(refused(&serde_json::json!({"quick": false})).contains("is of another run"));
        let broken = fs::read_to_string(&path).unwrap().replace("\"a\"", "a");
        fs::write(&path, broken).unwrap();
        assert!(refused(&settings).contains("line 2: "));
    }
}
