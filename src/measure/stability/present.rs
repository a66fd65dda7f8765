//! Rows as files: JSON, CSV, tables to read, and plots over what families of cases sweep.

use crate::error::Result;
use crate::measure::plot::{Axis, Lines, Series, stacked};
use crate::measure::report::present::Content;
use crate::measure::stability::catalogue::cases;
use crate::measure::stability::measure::Row;
use crate::measure::stability::walks::Walks;
use planecast_encoder::Error as FileError;
use std::fmt::Write;
use std::path::Path;

/// `stability.json`, `stability.csv`, `stability.md`, a plot for each variable that is swept, and one of `walks`, where
/// they were walked.
pub fn files(rows: &[Row], walks: Option<&Walks>) -> Vec<Content> {
    let json = serde_json::to_string_pretty(rows).expect("plain values have a JSON form") + "\n";
    let mut files = vec![
        Content { name: "stability.json".into(), bytes: json.into_bytes() },
        Content { name: "stability.csv".into(), bytes: csv(rows) },
        Content { name: "stability.md".into(), bytes: (table(rows) + &conditioning(rows)).into_bytes() },
    ];
    if let Some(walks) = walks {
        files.push(Content { name: "stability-walks.csv".into(), bytes: walks_csv(walks) });
        files.push(Content { name: "stability-walks.svg".into(), bytes: walks_plot(walks).svg().into_bytes() });
    }
    let mut swept: Vec<&str> = rows.iter().filter_map(|r| r.sweep).map(|s| s.0).collect();
    swept.dedup();
    swept.sort_unstable();
    swept.dedup();
    for variable in swept {
        let name = format!("stability-{}.svg", variable.replace(|c: char| !c.is_ascii_alphanumeric(), "-"));
        files.push(Content { name, bytes: stacked(&plots(rows, variable)).into_bytes() });
    }
    files
}

const HEAD: [&str; 20] = [
    "case",
    "device",
    "kernel",
    "off_percent",
    "bound_off_percent",
    "wrong_percent",
    "bound_wrong_percent",
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

fn csv(rows: &[Row]) -> Vec<u8> {
    let mut out = csv::Writer::from_writer(Vec::new());
    let lines = rows.iter().map(|r| {
        let mut line = vec![
            r.case.clone(),
            r.device.clone(),
            r.kernel.clone(),
            format!("{:.4}", r.off_percent),
            r.bound_off_percent.to_string(),
            format!("{:.4}", r.wrong_percent),
            r.bound_wrong_percent.to_string(),
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
    out.write_record(HEAD).expect("memory takes it");
    lines.for_each(|line| out.write_record(line).expect("memory takes it"));
    out.into_inner().expect("memory takes it")
}

/// `rows`, and before them those of other devices and of cases that there still are from `stability.csv` in `folder`, so
/// that one table has what several machines drew.
pub fn with_earlier(folder: &Path, rows: Vec<Row>) -> Result<Vec<Row>> {
    let path = folder.join("stability.csv");
    let bytes = match std::fs::read(&path) {
        Ok(bytes) => bytes,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(rows),
        Err(e) => return Err(FileError::io(path, "read", e).into()),
    };
    let mut all = read_csv(&bytes)
        .map_err(|what| FileError::format(&path, format!("{what}; it is kept from another version: move it away")))?;
    all.retain(|row| rows.iter().all(|r| r.device != row.device));
    all.extend(rows);
    Ok(all)
}

fn read_csv(bytes: &[u8]) -> Result<Vec<Row>, String> {
    let mut reader = csv::Reader::from_reader(bytes);
    if reader.headers().is_ok_and(|head| head != HEAD[..]) {
        return Err("line 1: other columns than this program's".into());
    }
    let cases = cases();
    let mut rows = Vec::new();
    for (k, record) in reader.records().enumerate() {
        let record = record.map_err(|e| e.to_string())?;
        let number = |column: usize| -> Result<f64, String> {
            let wrong = |_| format!("line {}: {} is {:?}, a number was expected", k + 2, HEAD[column], &record[column]);
            record[column].parse().map_err(wrong)
        };
        let Some(case) = cases.iter().find(|c| c.name == record[0]) else { continue };
        let text = |column: usize| Some(record[column].to_string()).filter(|t| !t.is_empty());
        rows.push(Row {
            case: case.name.clone(),
            reason: case.reason.into(),
            device: record[1].into(),
            kernel: record[2].into(),
            off_percent: number(3)?,
            bound_off_percent: number(4)?,
            wrong_percent: number(5)?,
            bound_wrong_percent: number(6)?,
            cracks: number(7)? as usize,
            depth: number(8)?,
            bound_depth: number(9)?,
            steps: if record[10].is_empty() { None } else { Some(number(10)? as u64) },
            bound_steps: number(11)? as u64,
            moved_percent: [number(12)?, number(13)?, number(14)?],
            depth_ulps: [number(15)? as u32, number(16)? as u32, number(17)? as u32],
            sweep: case.sweep,
            refused: text(18),
            faults: text(19).into_iter().collect(),
            ..Row::default()
        });
    }
    Ok(rows)
}

/// The devices and kernels that rows are of, and the first row of each case.
fn columns_and_cases(rows: &[Row]) -> (Vec<(&str, &str)>, Vec<&Row>) {
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
    (columns, cases)
}

fn find<'r>(rows: &'r [Row], case: &Row, column: (&str, &str)) -> Option<&'r Row> {
    rows.iter().find(|r| r.case == case.case && (r.device.as_str(), r.kernel.as_str()) == column)
}

/// The head of a table whose last columns are devices and kernels.
fn head(first: &[&str], columns: &[(&str, &str)]) -> String {
    let mut text = String::from("|");
    first.iter().for_each(|name| write!(text, " {name} |").expect("a string takes it"));
    columns.iter().for_each(|(device, kernel)| write!(text, " {device}, {kernel} |").expect("a string takes it"));
    text + "\n|" + &"---|".repeat(first.len() + columns.len())
}

/// A row a case; a column a device and kernel.
fn table(rows: &[Row]) -> String {
    let (columns, cases) = columns_and_cases(rows);
    let mut text = String::from(
        "Pixels that show what cannot be seen from there, in percent; where pixels test their own rays, those that show what \
         these do not; and the greatest relative error of depth; at most the bounds may be. A cell that says more is out of its \
         bounds.\n\n",
    );
    text += &head(&["case", "why", "bound"], &columns);
    for case in cases {
        let (name, why) = (&case.case, &case.reason);
        let [off, wrong] = [case.bound_off_percent, case.bound_wrong_percent];
        write!(text, "\n| {name} | {why} | {off} %, {wrong} %, {:.0e} |", case.bound_depth).expect("a string takes it");
        for &column in &columns {
            text += &match find(rows, case, column) {
                None => " |".to_string(),
                Some(Row { refused: Some(_), .. }) => " beyond its limits |".to_string(),
                Some(r) if r.faults.is_empty() => {
                    format!(" {:.3} %, {:.3} %, {:.0e} |", r.off_percent, r.wrong_percent, r.depth)
                }
                Some(r) => format!(" **{}** |", r.faults.join("; ")),
            };
        }
    }
    text + "\n"
}

/// A row a case: steps, and what one ulp amplifies to, a column a device and kernel.
fn conditioning(rows: &[Row]) -> String {
    let (mut columns, cases) = columns_and_cases(rows);
    columns.retain(|column| column.1 != "exact");
    let mut text = String::from(
        "\nConditioning. Steps: columns looked at by the plane that looks at most, and at most how many it can. Then by how many \
         ulps a depth changes more than that of `exact` where yaw, pitch and the eye's x change by one, and what share of the \
         pixels moves beyond those that move in `exact`, where any do.\n\n",
    );
    text += &head(&["case", "steps", "bound"], &columns);
    for case in cases {
        let mine = || rows.iter().filter(|r| r.case == case.case);
        let steps = mine().filter_map(|r| r.steps).max().map_or(String::new(), |s| s.to_string());
        let bound = mine().map(|r| r.bound_steps).max().unwrap_or(0);
        write!(text, "\n| {} | {steps} | {bound} |", case.case).expect("a string takes it");
        for &column in &columns {
            let Some(row) = find(rows, case, column).filter(|r| r.refused.is_none()) else {
                text += " |";
                continue;
            };
            let [yaw, pitch, eye] = row.depth_ulps;
            write!(text, " {yaw}, {pitch}, {eye}").expect("a string takes it");
            let moved = row.moved_percent.into_iter().fold(0.0, f64::max);
            if moved > 0.0 {
                write!(text, "; {moved:.2} %").expect("a string takes it");
            }
            text += " |";
        }
    }
    text + "\n"
}

/// Over the variable, a line a device and kernel: depth's error, what one ulp amplifies to, and steps.
fn plots(rows: &[Row], variable: &str) -> [Lines; 3] {
    let mut swept: Vec<(f64, &Row)> = rows
        .iter()
        .filter(|r| r.refused.is_none())
        .filter_map(|r| Some((r.sweep.filter(|s| s.0 == variable && s.1 > 0.0)?.1, r)))
        .collect();
    swept.sort_by(|a, b| a.0.total_cmp(&b.0));
    let lines = |title: &str, of: &dyn Fn(&Row) -> Vec<(String, f64)>| {
        let mut series: Vec<Series> = Vec::new();
        for (x, row) in &swept {
            for (name, y) in of(row) {
                match series.iter_mut().find(|s| s.name == name) {
                    Some(s) => s.points.push([*x, y]),
                    None => series.push(Series { name, quoted: false, points: vec![[*x, y]] }),
                }
            }
        }
        Lines { title: format!("{title} over {variable}"), x: Axis::log(variable), y: Axis::log(title), series }
    };
    let name = |r: &Row| format!("{}, {}", r.device, r.kernel);
    // A logarithm has no 0: less than f32 can tell.
    let error = |r: &Row| vec![(name(r), r.depth.max(1e-9))];
    let ulps = |r: &Row| match r.kernel.as_str() {
        "exact" => Vec::new(),
        _ => vec![(name(r), f64::from(r.depth_ulps.into_iter().max().unwrap_or(0)).max(0.5))],
    };
    let steps = |r: &Row| match r.steps {
        Some(steps) => vec![(name(r), steps as f64), ("bound".into(), r.bound_steps as f64)],
        None => Vec::new(),
    };
    [
        lines("greatest relative error of depth", &error),
        lines("ulps of depth for one of the camera", &ulps),
        lines("steps of the longest walk", &steps),
    ]
}

fn walks_csv(walks: &Walks) -> Vec<u8> {
    let mut text = String::from("from_voxels,samples,may_differ,differ\n");
    for bin in &walks.bins {
        writeln!(text, "{},{},{},{}", bin.from, bin.samples, bin.may_differ, bin.differ).expect("a string takes it");
    }
    text.into_bytes()
}

fn walks_plot(walks: &Walks) -> Lines {
    let series = |name: &str, count: fn(&crate::measure::stability::walks::Bin) -> u64| Series {
        name: name.into(),
        quoted: false,
        points: (walks.bins.iter().filter(|b| count(b) > 0))
            .map(|b| [1.5 * b.from, count(b) as f64 / b.samples as f64])
            .collect(),
    };
    Lines {
        title: "Samples that show another voxel in f32 than in f64, over distance".into(),
        x: Axis::log("distance, voxels"),
        y: Axis::log("share of samples"),
        series: vec![series("may, by the bound on rounding", |b| b.may_differ), series("do", |b| b.differ)],
    }
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
        assert!(text.contains("| gpu, k | gpu, l |\n|---|---|---|---|---|\n"), "{text}");
        assert!(text.contains("| a |  | 0.5 %, 0 %, 1e-5 | 0.000 %, 0.000 %, 0e0 | 0.000 %, 0.000 %, 0e0 |"), "{text}");
        assert!(text.ends_with("| beyond its limits | **it cracks** |\n"), "{text}");
        let names: Vec<_> = files(&rows, Some(&Walks::default())).iter().map(|f| f.name.clone()).collect();
        let expected = ["json", "csv", "md", "walks.csv", "walks.svg", "x.svg"];
        assert_eq!(names, expected.map(|n| format!("stability{}{n}", if n.len() > 4 { "-" } else { "." })));
        let csv = String::from_utf8(csv(&rows)).unwrap();
        assert!(csv.lines().count() == 5 && csv.contains("it cracks"), "{csv}");
    }

    #[test]
    fn conditioning_tells_what_one_ulp_amplifies_to() {
        let row =
            |kernel: &str| Row { case: "a".into(), device: "cpu".into(), kernel: kernel.into(), ..Row::default() };
        let planes = Row {
            steps: Some(12),
            bound_steps: 34,
            depth_ulps: [1, 2, 3],
            moved_percent: [0.0, 0.25, 0.0],
            sweep: Some(("x", 0.1)),
            ..row("planes")
        };
        let refused = Row { refused: Some("too large".into()), ..row("other") };
        let text = conditioning(&[planes.clone(), refused, row("exact")]);
        assert!(text.ends_with("| a | 12 | 34 | 1, 2, 3; 0.25 % | |\n"), "{text}");
        let points = plots(&[planes], "x").map(|lines| lines.series.iter().map(|s| s.points[0][1]).collect::<Vec<_>>());
        assert_eq!(points, [vec![1e-9], vec![3.0], vec![12.0, 34.0]]);
    }

    #[test]
    fn rows_of_other_devices_stay_in_their_folder() {
        let folder = tempfile::tempdir().unwrap();
        let row = |device: &str, off_percent: f64| Row {
            case: cases()[0].name.clone(),
            reason: cases()[0].reason.into(),
            device: device.into(),
            kernel: "planes".into(),
            off_percent,
            depth: 2e-7,
            steps: Some(5),
            depth_ulps: [1, 2, 3],
            sweep: cases()[0].sweep,
            faults: vec!["it cracks".into()],
            ..Row::default()
        };
        let path = folder.path().join("stability.csv");
        assert_eq!(with_earlier(folder.path(), vec![row("a", 0.0)]).unwrap().len(), 1);
        std::fs::write(&path, csv(&[row("a", 0.125), row("b", 0.25)])).unwrap();
        let rows = with_earlier(folder.path(), vec![row("b", 0.5)]).unwrap();
        assert_eq!(format!("{rows:?}"), format!("{:?}", [row("a", 0.125), row("b", 0.5)]));
        for (from, to) in [("off_percent", "elsewhere"), ("0.1250", "much")] {
            let spoiled = String::from_utf8(csv(&[row("a", 0.125)])).unwrap().replacen(from, to, 1);
            std::fs::write(&path, spoiled).unwrap();
            let text = with_earlier(folder.path(), Vec::new()).unwrap_err().to_string();
            assert!(text.contains("stability.csv: line"), "{text}");
        }
    }
}
