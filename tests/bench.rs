//! `planecast bench` from outside: its files, going on after a stop, and quoted figures told apart.

#![cfg(feature = "report")]

use planecast::Result;
use planecast::measure::bench::measure::Rounds;
use planecast::measure::bench::parts::{Extent, Part};
use planecast::measure::bench::row::{Row, Source};
use planecast::measure::bench::scenes::Name;
use planecast::measure::bench::{Device, Settings, run};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

/// Everything, in seconds: scenes of 32 columns a side, pictures of 32 × 24 pixels.
fn tiny(output: &Path) -> Settings {
    let rounds = Rounds { least: 1, most: 2, budget_ms: 0.0 };
    Settings {
        output: output.into(),
        parts: Part::ALL.into(),
        device: Device::Cpu,
        extent: Extent { scene_shrink: 32, picture_shrink: 32, cpu: rounds, gpu: rounds },
        files: BTreeMap::new(),
    }
}

fn told(settings: &Settings) -> Result<Vec<String>> {
    let mut lines = Vec::new();
    run(settings, &mut |line| lines.push(line.to_owned()))?;
    Ok(lines)
}

fn rows(dir: &Path) -> Vec<Row> {
    let mut reader = csv::Reader::from_path(dir.join("bench.csv")).unwrap();
    reader.deserialize().map(|row| row.unwrap()).collect()
}

#[test]
fn bench_leaves_every_file_and_tells_quoted_from_measured() {
    let dir = tempfile::tempdir().unwrap();
    let settings = tiny(dir.path());
    told(&settings).unwrap();
    let read = |name: &str| fs::read_to_string(dir.path().join(name)).unwrap();

    let rows = rows(dir.path());
    for part in Part::ALL {
        let measured = rows.iter().filter(|r| r.part == part.text() && r.source == Source::Measured);
        assert!(measured.clone().count() > 1, "{}", part.text());
        for row in measured {
            assert!(row.n > 0 && row.total_ms.is_some_and(|ms| ms > 0.0) && row.citation.is_empty(), "{row:?}");
            assert!(row.total_min_ms <= row.total_ms && row.total_ms <= row.total_max_ms, "{row:?}");
            assert!(row.planes.is_some_and(|n| n > 0.0) || row.kernel == "exact", "{row:?}");
        }
    }
    for row in rows.iter().filter(|r| r.source == Source::Quoted) {
        assert!(row.citation.starts_with("Forstmann & Ohya") && row.n == 0 && row.total_ms.is_none(), "{row:?}");
    }
    // The same rows in JSON.
    let json: serde_json::Value = serde_json::from_str(&read("bench.json")).unwrap();
    let as_json: Vec<Row> = serde_json::from_value(json["rows"].clone()).unwrap();
    assert_eq!(as_json.len(), rows.len());
    assert!(as_json.iter().zip(&rows).all(|(a, b)| (&a.key, a.source, a.n) == (&b.key, b.source, b.n)));

    let page = read("bench.html");
    // All 18 rows of Table 1, and wherever a row says quoted it also looks so, and the other way round.
    let quoted: Vec<&str> = page.lines().filter(|l| l.contains("(quoted)</td>")).collect();
    assert!(quoted.iter().filter(|l| l.contains("of the paper (quoted)")).count() == 18);
    assert!(quoted.iter().all(|l| l.starts_with("<tr class=\"quoted\">")), "a quoted row looks measured");
    assert_eq!(page.matches("<tr class=\"quoted\">").count(), quoted.len(), "a row looks quoted and does not say so");
    assert!(page.contains("This was a shortened run"));
    // Nothing is fetched: all pictures are in the page.
    assert!(page.split("src=\"").skip(1).all(|rest| rest.starts_with("data:")), "a picture lies elsewhere");
    assert!(!page.contains("<script") && !page.contains("<link") && !page.contains("href="));

    for plot in [
        "table1",
        "elements",
        "speedup",
        "scaling-planes",
        "scaling-pixels",
        "scaling-distance",
        "scaling-size",
        "scaling-threads",
    ] {
        let svg = read(&format!("plots/{plot}.svg"));
        assert!(svg.contains("<svg") && svg.trim_end().ends_with("</svg>"), "{plot}");
    }
    for picture in fs::read_dir(dir.path().join("pictures")).unwrap() {
        let bytes = fs::read(picture.unwrap().path()).unwrap();
        assert!(bytes.starts_with(b"\x89PNG"));
    }
}

#[test]
fn bench_goes_on_where_it_was_stopped() {
    let dir = tempfile::tempdir().unwrap();
    let mut settings = tiny(dir.path());
    settings.parts = vec![Part::Down];
    told(&settings).unwrap();
    let journal = dir.path().join("journal.jsonl");
    let whole = fs::read_to_string(&journal).unwrap();

    // Nothing is left to do.
    let lines = told(&settings).unwrap();
    assert!(lines.iter().any(|l| l.contains("3 of 3 groups were measured before")), "{lines:?}");
    assert_eq!(fs::read_to_string(&journal).unwrap(), whole);

    // Stopped within the last group: the first two stay as they are, the last is measured anew as a whole.
    let groups = |text: &str, scene: &str| -> Vec<String> {
        text.lines().filter(|l| l.contains(&format!("\"key\":\"down/{scene}"))).map(str::to_owned).collect()
    };
    fs::write(&journal, &whole[..whole.len() - 20]).unwrap();
    let lines = told(&settings).unwrap();
    assert!(lines.iter().any(|l| l.contains("2 of 3 groups were measured before")), "{lines:?}");
    let after = fs::read_to_string(&journal).unwrap();
    for scene in ["shapes", "mixing"] {
        assert_eq!(groups(&after, scene), groups(&whole, scene));
    }
    assert_eq!(groups(&after, "landscape").len(), 2 * groups(&whole, "landscape").len() - 1);
    assert_eq!(rows(dir.path()).iter().filter(|r| r.source == Source::Measured).count(), whole.lines().count() - 1);

    // Another part adds to the folder; a run of another extent is not mixed in.
    settings.parts = vec![Part::Landscape];
    told(&settings).unwrap();
    let parts: std::collections::HashSet<String> = rows(dir.path()).into_iter().map(|r| r.part).collect();
    assert!(parts.contains("down") && parts.contains("landscape"), "{parts:?}");
    settings.extent.picture_shrink = 16;
    assert!(told(&settings).unwrap_err().to_string().contains("is of another run"));
}

#[test]
fn bench_takes_a_file_in_place_of_a_procedural_scene() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("block.raw.npy");
    // An NPY volume of 4 × 3 × 4 voxels, all solid.
    let mut npy = b"\x93NUMPY\x01\x00".to_vec();
    let head = format!("{:<117}\n", "{'descr': '|u1', 'fortran_order': False, 'shape': (4, 3, 4), }");
    npy.extend((head.len() as u16).to_le_bytes());
    npy.extend(head.as_bytes());
    npy.extend([1u8; 48]);
    fs::write(&file, npy).unwrap();

    let mut settings = tiny(&dir.path().join("out"));
    settings.parts = vec![Part::Ieice];
    settings.files = [(Name::Scan, file.clone())].into();
    told(&settings).unwrap();
    let rows = rows(&settings.output);
    let of_file: Vec<&Row> = rows.iter().filter(|r| r.scene == "scan (block.raw.npy)").collect();
    assert!(of_file.len() >= 2 && of_file.iter().all(|r| r.scene_runs == Some(16.0)), "{of_file:?}");
    assert!(
        fs::read_to_string(settings.output.join("bench.html")).unwrap().contains("scan: from the file block.raw.npy")
    );

    fs::write(&file, "no volume").unwrap();
    settings.output = dir.path().join("other");
    let error = told(&settings).unwrap_err().to_string();
    assert!(error.contains("block.raw.npy"), "{error}");
}
