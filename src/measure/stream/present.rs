//! Rows as files: JSON, CSV, a table to read, plots of error against time, and the page that holds it all.

use planecast_encoder::encode::memory;
use serde_json::json;

use super::run::{Measured, Plan, Row, Worst};
use crate::measure::machine::Machine;
use crate::measure::page::{Mark, Page, Row as TableRow, Table};
use crate::measure::plot::{Axis, Front, Group, Lines, Point, Scatter, Series, stacked};
use crate::measure::report::present::Content;
use crate::world::fetch;
use crate::{Frame, output};

/// How frames follow one another.
const PACE: &str =
    "Frames are drawn back to back: the next is asked for as soon as one is there, with no clock in between.";

/// A plot of the page.
struct Plot {
    name: String,
    caption: String,
    svg: String,
}

/// `stream.json`, `.csv`, `.md`, plots, pictures of the worst frame, and the page last.
pub fn files(plan: &Plan<'_>, measured: &Measured, machine: &Machine) -> Vec<Content> {
    let rows = &measured.rows;
    let mut plots: Vec<Plot> = plan.velocities.iter().map(|&velocity| error_time(rows, velocity)).collect();
    plots.extend([over_velocity(rows), over_memory(rows)]);
    let table = table(rows);
    let text = format!("{}\n\n{}\n\n{}", result(rows), conditions(plan, measured).join("\n\n"), table.markdown());
    let mut files = vec![
        Content { name: "stream.json".into(), bytes: to_json(plan, measured, machine) },
        Content { name: "stream.csv".into(), bytes: csv(rows) },
        Content { name: "stream.md".into(), bytes: text.into_bytes() },
    ];
    files.extend(
        plots.iter().map(|plot| Content { name: format!("{}.svg", plot.name), bytes: plot.svg.clone().into_bytes() }),
    );
    let pictures = measured.worst.as_ref().map(|worst| [png(&worst.drawn), png(&worst.reference)]);
    let page = page(plan, measured, machine, &plots, &table, pictures.as_ref());
    for (name, bytes) in ["drawn", "reference"].into_iter().zip(pictures.into_iter().flatten()) {
        files.push(Content { name: format!("stream-worst-{name}.png"), bytes });
    }
    files.push(Content { name: "stream.html".into(), bytes: page.into_bytes() });
    files
}

fn png(frame: &Frame) -> Vec<u8> {
    let mut bytes = Vec::new();
    output::png(&mut bytes, frame).expect("a picture is written into memory");
    bytes
}

fn csv(rows: &[Row]) -> Vec<u8> {
    let mut out = csv::Writer::from_writer(Vec::new());
    rows.iter().for_each(|row| out.serialize(row).expect("memory takes it"));
    out.into_inner().expect("memory takes it")
}

fn to_json(plan: &Plan<'_>, measured: &Measured, machine: &Machine) -> Vec<u8> {
    let value = json!({
        "machine": machine, "scene": plan.world.name, "dims": plan.world.source.dims(), "device": measured.device,
        "size": plan.size, "frames": plan.frames, "flags": plan.options.flags(), "pace": PACE,
        "tiles_at_once": fetch::threads(), "working_set_bytes": plan.working_set, "flight_voxels": plan.flight.length(),
        "reference_lod": measured.reference_lod, "result": result(&measured.rows), "rows": measured.rows,
    });
    let mut text = serde_json::to_vec_pretty(&value).expect("plain values have a JSON form");
    text.push(b'\n');
    text
}

/// Rows that were flown.
fn flown(rows: &[Row]) -> impl Iterator<Item = &Row> {
    rows.iter().filter(|row| row.refused.is_none())
}

/// The hardest of what was flown: at the greatest velocity over the link that brings least, with the most memory.
fn hardest(rows: &[Row]) -> impl Iterator<Item = &Row> {
    let velocity = flown(rows).map(|row| row.voxels_per_frame).fold(0.0, f64::max);
    let late = |row: &Row| (row.bytes_per_second.unwrap_or(f64::INFINITY), -row.latency_ms);
    let link = flown(rows).min_by(|a, b| late(a).partial_cmp(&late(b)).unwrap_or(std::cmp::Ordering::Equal));
    let link = link.map(|row| row.link.clone()).unwrap_or_default();
    let memory = flown(rows).map(|row| row.memory_bytes).max().unwrap_or(0);
    flown(rows).filter(move |row| (row.voxels_per_frame, row.memory_bytes) == (velocity, memory) && row.link == link)
}

/// The result in a sentence or two: what is paid where it is hardest, in time by frames that wait and in error by those that do not.
pub fn result(rows: &[Row]) -> String {
    let find = |wait: bool| hardest(rows).find(|row| (row.stream == "wait") == wait);
    let (Some(waits), Some(goes)) = (find(true), find(false)) else {
        return "Nothing was flown both with and without waiting for tiles.".into();
    };
    format!(
        "At {} voxels per frame over {}, with {} for tiles ({:.0} % of what the first view needs), a frame that waits for its tiles takes \
         {:.1} ms (mean; p99 {:.1}) and shows {:.2} % wrong voxels; with {} it takes {:.1} ms (p99 {:.1}) and shows {:.2} % wrong voxels, \
         a FLIP of {:.4}.",
        waits.voxels_per_frame,
        if waits.bytes_per_second.is_some() { &waits.link } else { "a link without limit" },
        memory::display(waits.memory_bytes),
        waits.memory_percent,
        waits.ms_mean,
        waits.ms_p99,
        waits.wrong_voxel_percent,
        goes.stream,
        goes.ms_mean,
        goes.ms_p99,
        goes.wrong_voxel_percent,
        goes.flip,
    )
}

/// What all rows have in common, a sentence each.
fn conditions(plan: &Plan<'_>, measured: &Measured) -> Vec<String> {
    let [w, h] = plan.size;
    let [nx, ny, nz] = plan.world.source.dims();
    let mut said = vec![
        format!(
            "{}, {nx} × {ny} × {nz} voxels; {w} × {h} pixels on {}; {} rows of {} frames each.",
            plan.world.name,
            measured.device,
            measured.rows.len(),
            plan.frames
        ),
        format!(
            "{PACE} A row begins with the tiles of its first view there, and asks for those of the next frame while it draws one; \
             {} tiles are asked for at once.",
            fetch::threads()
        ),
        format!(
            "The first view needs {} for tiles: with less it is drawn coarser, or not at all. The flight is {:.0} voxels long; at its ends \
             it goes back.",
            memory::display(plan.working_set),
            plan.flight.length()
        ),
    ];
    let asked = plan.options.lod.unwrap_or(0.0);
    if measured.reference_lod > asked {
        said.push(format!(
            "The references themselves are drawn at a level of detail of up to {:.1} pixels, for {asked} asked for: so large a view is \
             drawn coarser whatever the memory.",
            measured.reference_lod
        ));
    }
    let mut refused: Vec<(u64, &str)> =
        measured.rows.iter().filter_map(|row| Some((row.memory_bytes, row.refused.as_deref()?))).collect();
    refused.sort_unstable();
    refused.dedup_by_key(|(bytes, _)| *bytes);
    said.extend(refused.into_iter().map(|(bytes, why)| format!("{} was refused: {why}.", memory::display(bytes))));
    said
}

/// Error against time at one velocity: what memory and patience give, link by link.
fn error_time(rows: &[Row], velocity: f64) -> Plot {
    let mut groups: Vec<Group> = Vec::new();
    for row in flown(rows).filter(|row| row.voxels_per_frame == velocity) {
        let label = format!("{}, {:.0} %", row.stream, row.memory_percent);
        let spread = Some([row.ms_median, row.ms_p99]);
        let point = Point { x: row.ms_mean, y: row.flip, spread, label };
        match groups.iter_mut().find(|group| group.name == row.link) {
            Some(group) => group.points.push(point),
            None => groups.push(Group { name: row.link.clone(), quoted: false, points: vec![point] }),
        }
    }
    let scatter = Scatter {
        title: format!("Error against time at {velocity} voxels per frame"),
        x: Axis::log("milliseconds per frame, mean"),
        y: Axis::log("FLIP against the frame with all tiles there, mean"),
        groups,
        front: Front::OfEach,
    };
    Plot {
        name: format!("stream-error-time-{velocity}"),
        caption: format!(
            "At {velocity} voxels per frame: patience and memory in percent of what the first view needs. Pale lines go from the median to p99. \
             Red rings mark each link's Pareto front: over it nothing measured is faster with less error."
        ),
        svg: scatter.svg(),
    }
}

/// A line for each name that `of` gives a row, over `x`.
fn lines<'r>(
    title: &str,
    [x_label, y_label]: [&str; 2],
    rows: impl Iterator<Item = &'r Row>,
    name: &dyn Fn(&Row) -> String,
    at: &dyn Fn(&Row) -> [f64; 2],
) -> Lines {
    let mut series: Vec<Series> = Vec::new();
    for row in rows {
        let name = name(row);
        match series.iter_mut().find(|s| s.name == name) {
            Some(s) => s.points.push(at(row)),
            None => series.push(Series { name, quoted: false, points: vec![at(row)] }),
        }
    }
    series.iter_mut().for_each(|s| s.points.sort_by(|a, b| a[0].total_cmp(&b[0])));
    Lines { title: title.into(), x: Axis::log(x_label), y: Axis::log(y_label), series }
}

/// With the most memory: the error of frames that wait for nothing, and the time of those that wait for all.
fn over_velocity(rows: &[Row]) -> Plot {
    let most = flown(rows).map(|row| row.memory_bytes).max().unwrap_or(0);
    let of = |wait: bool| flown(rows).filter(move |row| row.memory_bytes == most && is_end(row, wait));
    let name = |row: &Row| row.link.clone();
    let velocity = "voxels per frame";
    let error = lines(
        "Error of frames that wait for no tile",
        [velocity, "pixels with a wrong voxel, %"],
        of(false),
        &name,
        &|row| [row.voxels_per_frame, row.wrong_voxel_percent],
    );
    let time = lines(
        "Time of frames that wait for all tiles",
        [velocity, "milliseconds per frame, mean"],
        of(true),
        &name,
        &|row| [row.voxels_per_frame, row.ms_mean],
    );
    Plot {
        name: "stream-velocity".into(),
        caption: format!("What is paid over velocity, with {} for tiles.", memory::display(most)),
        svg: stacked(&[error, time]),
    }
}

/// Where it is hardest: error and time over memory.
fn over_memory(rows: &[Row]) -> Plot {
    let hard = hardest(rows).next();
    let (velocity, link) = hard.map_or((0.0, String::new()), |row| (row.voxels_per_frame, row.link.clone()));
    let of = || flown(rows).filter(|row| row.voxels_per_frame == velocity && row.link == link);
    let name = |row: &Row| row.stream.clone();
    let mib = |row: &Row| row.memory_bytes as f64 / f64::from(1 << 20);
    let label = "memory for tiles, MiB";
    let error = lines("Error over memory", [label, "pixels with a wrong voxel, %"], of(), &name, &|row| {
        [mib(row), row.wrong_voxel_percent]
    });
    let time =
        lines("Time over memory", [label, "milliseconds per frame, mean"], of(), &name, &|row| [mib(row), row.ms_mean]);
    Plot {
        name: "stream-memory".into(),
        caption: format!("What memory does for it at {velocity} voxels per frame over {link}."),
        svg: stacked(&[error, time]),
    }
}

/// Whether a row's frames wait for all tiles, or for none.
fn is_end(row: &Row, wait: bool) -> bool {
    row.stream == if wait { "wait" } else { "deadline:0" }
}

fn table(rows: &[Row]) -> Table {
    let row = |r: &Row| {
        let bytes = |bytes: f64| memory::display(bytes as u64);
        let mut cells = vec![
            r.voxels_per_frame.to_string(),
            r.link.clone(),
            format!("{} ({:.0} %)", bytes(r.memory_bytes as f64), r.memory_percent),
            r.stream.clone(),
        ];
        cells.extend([
            format!("{:.2}", r.ms_mean),
            format!("{:.2}", r.ms_median),
            format!("{:.2}", r.ms_p99),
            format!("{:.0}", r.wall_ms),
            bytes(r.bytes_per_frame),
            format!("{:.3}", r.wrong_voxel_percent),
            format!("{:.3}", r.other_voxel_percent),
            format!("{:.4}", r.flip),
            format!("{:.4}", r.flip_max),
            format!("{:.4}", r.debt_per_pixel),
            format!("{:.1}", r.tiles_missing),
            format!("{:.2}", r.lod),
        ]);
        TableRow::marked(if r.front { Mark::Strong } else { Mark::Plain }, cells)
    };
    let head = [
        "voxels per frame",
        "link",
        "memory",
        "--stream",
        "ms mean",
        "median",
        "p99",
        "ms all frames",
        "read per frame",
        "wrong voxel %",
        "other voxel %",
        "FLIP",
        "worst frame",
        "debt per pixel",
        "tiles missing",
        "lod",
    ];
    Table {
        caption: "All rows that were flown. At each velocity over each link, the Pareto front of FLIP against mean time stands out.".into(),
        head: head.map(String::from).to_vec(),
        rows: flown(rows).map(row).collect(),
    }
}

fn page(
    plan: &Plan<'_>,
    measured: &Measured,
    machine: &Machine,
    plots: &[Plot],
    table: &Table,
    worst: Option<&[Vec<u8>; 2]>,
) -> String {
    let mut page = Page::new("planecast: error against time of a world in tiles");
    page.paragraph(&result(&measured.rows));
    page.pictures(&[(&*png(&measured.first), "the first view, all tiles there")]);
    conditions(plan, measured).iter().for_each(|said| page.paragraph(said));
    page.paragraph(&machine.to_string());
    page.code(&machine.command);
    page.heading(2, "Error against time");
    plots.iter().for_each(|plot| page.svg(&plot.svg, &plot.caption));
    if let (Some(Worst { row, frame, flip, .. }), Some([drawn, reference])) = (&measured.worst, worst) {
        let row = &measured.rows[*row];
        page.heading(2, "The worst frame");
        page.paragraph(&format!(
            "Frame {} of {} at {} voxels per frame, {}, {} for tiles, {}: FLIP {flip:.4}.",
            frame + 1,
            row.frames,
            row.voxels_per_frame,
            row.link,
            memory::display(row.memory_bytes),
            row.stream
        ));
        page.pictures(&[(drawn, "as drawn"), (reference, "all tiles there")]);
    }
    page.heading(2, "All rows");
    page.table(table);
    page.heading(2, "What the figures mean");
    page.list([
        "Reference: the same frame, drawn by the same device with the same options and all tiles there, at the level of detail asked for.",
        "Wrong voxel: pixels that do not show the reference's voxel, its level included. Other voxel: those that do not show a coarser \
         one that holds it either. FLIP: mean over the frames, at 67 pixels per degree (Andersson et al. 2020); worst frame: the greatest \
         of a frame.",
        "Debt per pixel: levels by which a pixel's tile is coarser than it should be, mean over all pixels. It says nothing of a level of \
         detail that was raised for lack of memory: that is in lod (pixels), and in the error.",
        "Time: from asking for a frame to having it, tiles included, and the voxels that the comparison needs. Frames are compared once a row \
         is flown.",
        "Link: bytes per second that all tiles share, and how late the first byte of each is. A tile is as many bytes as its file has for \
         it, or, where it is made on the way, as its lists take in memory. Unlimited: as fast as the source itself.",
        "wait: each frame waits until its tiles are there. deadline:MS: it is drawn after so many milliseconds with what is there. Both are \
         flags of fly: --stream and, for memory, --memory.",
    ]);
    page.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::stream::link::Link;
    use crate::measure::stream::run::Setting;
    use crate::world::pager::Patience;

    fn rows() -> Vec<Row> {
        let mut rows = Vec::new();
        for velocity in [4.0, 100.0] {
            for link in [Link::UNLIMITED, Link::new(100.0, 50)] {
                for patience in [Patience::Wait, Patience::Deadline(0.0)] {
                    let memory = 3 << 20;
                    let setting = Setting { velocity, memory, link, patience };
                    let late = velocity * link.latency.as_secs_f64();
                    let (ms, flip) = if patience == Patience::Wait { (9.0 + late, 0.0) } else { (9.0, late / 100.0) };
                    rows.push(Row { ms_mean: ms, flip, ms_median: ms, ms_p99: 2.0 * ms, ..Row::of(&setting, 2 << 20) });
                    let refused = Some("too little".into());
                    rows.push(Row { refused, ..Row::of(&Setting { memory: 1 << 20, ..setting }, 2 << 20) });
                }
            }
        }
        rows
    }

    #[test]
    fn the_result_is_of_the_hardest_that_was_flown() {
        let text = result(&rows());
        for part in
            ["At 100 voxels", "100 Mbit/s, 50 ms", "3.0 MiB", "takes 14.0 ms (mean; p99 28.0)", "FLIP of 0.0500"]
        {
            assert!(text.contains(part), "{part} is not in {text}");
        }
        assert!(result(&[]).contains("Nothing was flown"));
        let only: Vec<Row> = rows().into_iter().filter(|row| row.stream == "wait").collect();
        assert!(result(&only).contains("Nothing was flown both"));
    }

    #[test]
    fn tables_have_a_line_for_each_row_that_was_flown_and_csv_all() {
        let rows = rows();
        let text = table(&rows).markdown();
        assert!(text.lines().count() == 4 + 8 && !text.contains("1.0 MiB"), "{text}");
        let csv = String::from_utf8(csv(&rows)).unwrap();
        assert!(
            csv.starts_with("voxels_per_frame,memory_bytes,memory_percent,link,bytes_per_second,latency_ms,stream,"),
            "{csv}"
        );
        assert!(
            csv.lines().count() == 17 && csv.lines().filter(|line| line.ends_with("too little")).count() == 8,
            "{csv}"
        );
        let plot = error_time(&rows, 100.0);
        // Two points on a front for each link; without a link both are at one place.
        assert!(plot.name == "stream-error-time-100" && plot.svg.contains("100 Mbit/s, 50 ms"), "{}", plot.svg);
        assert_eq!(plot.svg.matches("<circle").count(), 4 + 3, "{}", plot.svg);
        for plot in [over_velocity(&rows), over_memory(&rows), over_velocity(&[]), over_memory(&[])] {
            assert!(plot.svg.contains("</svg>") && !plot.svg.contains("NaN"), "{}", plot.name);
        }
    }
}
