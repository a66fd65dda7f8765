//! Finished measurements, one JSON object a line, so that a run that was stopped goes on where it was.

use super::metrics::Errors;
use crate::Result;
use crate::frame::picture::StageTimes;
use crate::measure::json_lines::JsonLines;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::path::Path;

/// Name of the journal in a report's folder; a folder with it is a report's.
pub const NAME: &str = "measurements.jsonl";

/// One measurement of one configuration at one pose.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// Hash of all that the figures depend on: program, machine, scene, configuration, pose, size.
    pub key: String,
    pub config: String,
    pub pose: String,
    #[serde(flatten)]
    pub figures: Figures,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Figures {
    Error(ErrorFigures),
    /// Milliseconds by stage in one round.
    Time {
        round: u32,
        stages: StageTimes,
    },
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ErrorFigures {
    #[serde(flatten)]
    pub errors: Errors,
    /// Pixels that no plane reaches, before gap fill and after.
    pub holes: [u64; 2],
    pub planes: u32,
    pub columns_visited: u64,
    pub runs_visited: u64,
    pub spans_drawn: u64,
}

/// What was measured, in the file and in memory.
pub struct Journal {
    file: JsonLines,
    errors: HashMap<String, ErrorFigures>,
    times: HashMap<(String, u32), StageTimes>,
}

impl Journal {
    /// Opens a folder's journal, or begins one. A last line that was not finished is dropped.
    pub fn open(folder: &Path) -> Result<Journal> {
        let (file, lines) = JsonLines::open(&folder.join(NAME))?;
        let mut journal = Journal { file, errors: HashMap::new(), times: HashMap::new() };
        for (i, line) in lines.iter().enumerate().filter(|(_, line)| !line.is_empty()) {
            let entry = serde_json::from_str(line)
                .map_err(|e| journal.file.broken(i, e, "remove the line, or the folder to measure anew"))?;
            journal.keep(entry);
        }
        Ok(journal)
    }

    pub fn add(&mut self, entry: Entry) -> Result<()> {
        self.file.append([&entry])?;
        self.keep(entry);
        Ok(())
    }

    fn keep(&mut self, entry: Entry) {
        match entry.figures {
            Figures::Error(e) => _ = self.errors.insert(entry.key, e),
            Figures::Time { round, stages } => _ = self.times.insert((entry.key, round), stages),
        }
    }

    pub fn error(&self, key: &str) -> Option<ErrorFigures> {
        self.errors.get(key).copied()
    }

    pub fn time(&self, key: &str, round: u32) -> Option<StageTimes> {
        self.times.get(&(key.to_owned(), round)).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(key: &str, round: u32) -> Entry {
        let stages = StageTimes { total: 3.25, ..StageTimes::default() };
        let figures = Figures::Time { round, stages };
        Entry { key: key.into(), config: "c".into(), pose: "p".into(), figures }
    }

    #[test]
    fn journal_goes_on_after_a_torn_line() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join(NAME);
        let mut journal = Journal::open(dir.path()).unwrap();
        let error = ErrorFigures {
            holes: [7, 1],
            errors: Errors { flip: 0.125, ..Errors::default() },
            ..ErrorFigures::default()
        };
        journal.add(Entry { figures: Figures::Error(error), ..entry("a", 0) }).unwrap();
        journal.add(entry("a", 0)).unwrap();
        journal.add(entry("a", 1)).unwrap();
        drop(journal);
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, &text[..text.len() - 9]).unwrap();

        let mut journal = Journal::open(dir.path()).unwrap();
        assert_eq!((journal.error("a"), journal.time("a", 0).map(|t| t.total)), (Some(error), Some(3.25)));
        assert_eq!((journal.time("a", 1), journal.error("b")), (None, None));
        journal.add(entry("a", 1)).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
    }

    #[test]
    fn journal_names_a_line_that_is_not_its_own() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join(NAME), "{\"key\":1}\n").unwrap();
        let error = Journal::open(dir.path()).err().unwrap().to_string();
        assert!(error.contains("line 1") && error.contains("remove the line"), "{error}");
    }
}
