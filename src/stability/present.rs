//! Rows as files: JSON, CSV, a table to read, and plots over what families of cases sweep.

use crate::plot::{Axis, Lines, Series};
use crate::report::present::Content;
use crate::stability::measure::Row;
use std::fmt::Write;

/// `stability.json`, `stability.csv`, `stability.md`, and a plot for each variable that is swept.
pub fn files(rows: &[Row]) -> Vec<Content> {
    let json = serde_json::to_string_pretty(rows).expect("plain values have a JSON form") + "\n";
    let mut files = vec![
        Content { name: "stability.json".into(), bytes: json.into_bytes() },
        Content { name: "stability.csv".into(), bytes: csv(rows) },
        Content { name: "stability.md".into(), bytes: table(rows).into_bytes() },
    ];
    let mut swept: Vec<&str> = rows.iter().filter_map(|r| r.sweep).map(|s| s.0).collect();
    swept.dedup();
    swept.sort_unstable();
    swept.dedup();
    for variable in swept {
        let name = format!("stability-{}.svg", variable.replace(|c: char| !c.is_ascii_alphanumeric(), "-"));
        files.push(Content { name, bytes: plot(rows, variable).into_bytes() });
    }
    files
}

fn csv(rows: &[Row]) -> Vec<u8> {
    let mut out = csv::Writer::from_writer(Vec::new());
    let head = [
        "case",
        "device",
        "kernel",
        "off_percent",
        "bound_off_percent",
        "cracks",
        "depth",
        "bound_depth",
        "steps",
        "bound_steps",
        "moved_yaw_percent",
        "moved_pitch_percent",
        "moved_eye_percent",
        "ulps_yaw",
        "ulps_pitch",
        "ulps_eye",
        "refused",
        "faults",
    ];
    let lines = rows.iter().map(|r| {
        let mut line = vec![
            r.case.clone(),
            r.device.clone(),
            r.kernel.clone(),
            format!("{:.4}", r.off_percent),
            r.bound_off_percent.to_string(),
            r.cracks.to_string(),
            format!("{:.2e}", r.depth),
            format!("{:e}", r.bound_depth),
            r.steps.map_or(String::new(), |s| s.to_string()),
            r.bound_steps.to_string(),
        ];
        line.extend(r.moved_percent.map(|m| format!("{m:.4}")));
        line.extend(r.depth_ulps.map(|u| u.to_string()));
        line.extend([r.refused.clone().unwrap_or_default(), r.faults.join("; ")]);
        line
    });
    // Writing to memory does not fail.
    out.write_record(head).expect("memory takes it");
    lines.for_each(|line| out.write_record(line).expect("memory takes it"));
    out.into_inner().expect("memory takes it")
}

/// A row a case; a column a device and kernel.
fn table(rows: &[Row]) -> String {
    let mut columns: Vec<(&str, &str)> = Vec::new();
    let mut cases: Vec<&Row> = Vec::new();
    for row in rows {
        if !columns.contains(&(&row.device, &row.kernel)) {
            columns.push((&row.device, &row.kernel));
        }
        if !cases.iter().any(|c| c.case == row.case) {
            cases.push(row);
        }
    }
    let mut text = String::from(
        "Pixels that show what cannot be seen from there, in percent, and the greatest relative error of depth; at most the \
         bounds may be. A cell that says more is out of its bounds.\n\n| case | why | bound |",
    );
    let name =
        |&(device, kernel): &(&str, &str)| if device == kernel { device.into() } else { format!("{device}, {kernel}") };
    columns.iter().for_each(|c| write!(text, " {} |", name(c)).expect("a string takes it"));
    text += "\n|---|---|---|";
    text += &"---|".repeat(columns.len());
    for case in cases {
        let (name, why) = (&case.case, &case.reason);
        write!(text, "\n| {name} | {why} | {} %, {:.0e} |", case.bound_off_percent, case.bound_depth)
            .expect("a string takes it");
        for &(device, kernel) in &columns {
            let cell =
                rows.iter().find(|r| r.case == case.case && (r.device.as_str(), r.kernel.as_str()) == (device, kernel));
            text += &match cell {
                None => " |".to_string(),
                Some(Row { refused: Some(_), .. }) => " beyond its limits |".to_string(),
                Some(r) if r.faults.is_empty() => format!(" {:.3} %, {:.0e} |", r.off_percent, r.depth),
                Some(r) => format!(" **{}** |", r.faults.join("; ")),
            };
        }
    }
    text + "\n"
}

/// Depth's error over the variable, a line a kernel.
fn plot(rows: &[Row], variable: &str) -> String {
    let mut series: Vec<Series> = Vec::new();
    for row in rows.iter().filter(|r| r.refused.is_none()) {
        let Some((_, value)) = row.sweep.filter(|s| s.0 == variable && s.1 > 0.0) else { continue };
        // A logarithm has no 0: less than f32 can tell.
        let point = [value, row.depth.max(1e-9)];
        match series.iter_mut().find(|s| s.name == row.kernel) {
            Some(s) => s.points.push(point),
            None => series.push(Series { name: row.kernel.clone(), quoted: false, points: vec![point] }),
        }
    }
    series.iter_mut().for_each(|s| s.points.sort_by(|a, b| a[0].total_cmp(&b[0])));
    let title = format!("Error of depth over {variable}");
    Lines { title, x: Axis::log(variable), y: Axis::log("greatest relative error of depth"), series }.svg()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn table_tells_cases_out_of_bounds_from_others() {
        let row = |case: &str, kernel: &str| Row {
            case: case.into(),
            device: "gpu".into(),
            kernel: kernel.into(),
            bound_off_percent: 0.5,
            bound_depth: 1e-5,
            sweep: Some(("x", 0.1)),
            ..Row::default()
        };
        let refused = Row { refused: Some("too large".into()), ..row("b", "k") };
        let faulty = Row { faults: vec!["it cracks".into()], ..row("b", "l") };
        let rows = [row("a", "k"), row("a", "l"), refused, faulty];
        let text = table(&rows);
        assert!(text.contains("| gpu, k | gpu, l |"), "{text}");
        assert!(text.contains("| a |  | 0.5 %, 1e-5 | 0.000 %, 0e0 | 0.000 %, 0e0 |"), "{text}");
        assert!(text.ends_with("| beyond its limits | **it cracks** |\n"), "{text}");
        let names: Vec<_> = files(&rows).iter().map(|f| f.name.clone()).collect();
        assert_eq!(names, ["stability.json", "stability.csv", "stability.md", "stability-x.svg"]);
        let csv = String::from_utf8(csv(&rows)).unwrap();
        assert!(csv.lines().count() == 5 && csv.contains("it cracks"), "{csv}");
    }
}
