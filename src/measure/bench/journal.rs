//! What has been measured so far, a line a row, so that a run that was stopped goes on where it was.
//!
//! The first line states what the run is of; a folder with another first line is refused, since its figures are not
//! comparable. A last line without an end, of a run that was killed, is dropped.

use super::row::Row;
use crate::measure::json_lines::JsonLines;
use crate::{Error, Result};
use std::collections::HashMap;
use std::path::Path;

pub struct Journal {
    file: JsonLines,
    rows: HashMap<String, Row>,
}

impl Journal {
    /// Opens the journal at `path`, or begins one for `settings`.
    pub fn open(path: &Path, settings: &serde_json::Value) -> Result<Journal> {
        let (file, lines) = JsonLines::open(path)?;
        let mut journal = Journal { file, rows: HashMap::new() };
        let Some(first) = lines.first() else {
            journal.file.append([settings])?;
            return Ok(journal);
        };
        let head = settings.to_string();
        if *first != head {
            return Err(Error::Argument(format!(
                "{}: is of another run ({first}); give -o another folder, or delete this one",
                path.display()
            )));
        }
        for (i, line) in lines.iter().enumerate().skip(1) {
            let row: Row =
                serde_json::from_str(line).map_err(|e| journal.file.broken(i, e, "delete the file to measure anew"))?;
            journal.rows.insert(row.key.clone(), row);
        }
        Ok(journal)
    }

    /// Adds rows that were measured together; a later row replaces one of the same key.
    pub fn add(&mut self, rows: impl IntoIterator<Item = Row>) -> Result<()> {
        let rows: Vec<Row> = rows.into_iter().collect();
        self.file.append(&rows)?;
        self.rows.extend(rows.into_iter().map(|row| (row.key.clone(), row)));
        Ok(())
    }

    pub fn get(&self, key: &str) -> Option<&Row> {
        self.rows.get(key)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

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
