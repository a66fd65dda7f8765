//! What each frame of a film took, as a table.

use std::fmt::Write as _;

use crate::frame::picture::Stats;

/// Columns of the table, in order.
const COLUMNS: &str = "frame,total_ms,setup_ms,traverse_ms,remap_ms,shade_ms,unpack_ms,upload_ms,tiles_wanted,tiles_used,\
                       tiles_evicted,bytes_read,bytes_uploaded,debt,lod";

/// Rows of a table that grows with the film.
pub struct Timeline {
    rows: String,
    lod: Option<f64>,
}

impl Timeline {
    /// `lod`: the level of detail that was asked for.
    pub fn new(lod: Option<f64>) -> Timeline {
        Timeline { rows: format!("{COLUMNS}\n"), lod }
    }

    /// Adds frame number `frame`, which took `total_ms` from being asked for to being there; stages are the device's own.
    pub fn push(&mut self, frame: usize, total_ms: f64, stats: &Stats) {
        let stages = stats.gpu_ms.or(stats.cpu_ms).unwrap_or_default();
        let p = &stats.paging;
        // Of a whole world no level of detail is chosen anew.
        let lod = if p.lod > 0.0 { p.lod } else { self.lod.unwrap_or(0.0) };
        let _ = write!(self.rows, "{frame},{total_ms:.3}");
        for ms in [stages.setup, stages.traverse, stages.remap, stages.shade, p.unpack_ms, p.upload_ms] {
            let _ = write!(self.rows, ",{ms:.3}");
        }
        for n in [p.tiles_wanted, p.tiles_used, p.tiles_evicted] {
            let _ = write!(self.rows, ",{n}");
        }
        let _ = writeln!(self.rows, ",{},{},{},{lod}", p.bytes_read, p.bytes_uploaded, p.debt);
    }

    pub fn csv(self) -> String {
        self.rows
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::picture::{PagingStats, StageTimes};

    #[test]
    fn rows_have_a_value_for_each_column() {
        let mut timeline = Timeline::new(Some(1.0));
        let cpu_ms = Some(StageTimes { setup: 0.5, traverse: 2.25, remap: 1.0, shade: 3.0, total: 6.75 });
        let paging = PagingStats { debt: 7, tiles_wanted: 20, bytes_read: 4096, lod: 1.25, ..PagingStats::default() };
        timeline.push(0, 7.0, &Stats { cpu_ms, paging, ..Stats::default() });
        timeline.push(1, 6.0, &Stats { cpu_ms, ..Stats::default() });
        let csv = timeline.csv();
        let rows: Vec<Vec<&str>> = csv.lines().map(|line| line.split(',').collect()).collect();
        assert!(rows.len() == 3 && rows.iter().all(|row| row.len() == 15), "{csv}");
        let value = |row: usize, name: &str| rows[row][rows[0].iter().position(|column| *column == name).unwrap()];
        assert_eq!((value(1, "debt"), value(1, "lod"), value(1, "traverse_ms")), ("7", "1.25", "2.250"));
        assert_eq!((value(2, "frame"), value(2, "lod"), value(2, "bytes_read")), ("1", "1", "0"));
    }
}
