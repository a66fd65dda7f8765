//! Rows as CSV, JSON, plots and one page.

use super::measure::Config;
use super::paper::{self, FORSTMANN_2009, FORSTMANN_2010};
use super::parts::{Extent, Machine, Part, groups, table1_configs, table1_ours};
use super::row::{Row, Source};
use super::scenes::{Name, View};
use crate::measure::page::{self, Mark, Page, Table};
use crate::measure::plot::{Axis, BarRow, Bars, Lines, Series};
use planecast_encoder::Encoding;
use std::collections::BTreeMap;

/// Everything that a page tells of.
pub struct Results<'a> {
    pub extent: &'a Extent,
    pub machine: &'a Machine,
    /// By key.
    pub rows: &'a BTreeMap<String, Row>,
    /// Lines on the machine: name and value.
    pub about: &'a [(String, String)],
    /// Scenes that came from files.
    pub files: &'a BTreeMap<Name, std::path::PathBuf>,
    /// PNG files with their captions.
    pub pictures: &'a [(Vec<u8>, String)],
}

/// A plot's file name and content.
pub type Plot = (&'static str, String);

/// A group of the speed-up part.
struct SpeedUps<'a> {
    title: String,
    rows: Vec<(Config, &'a Row)>,
    /// Milliseconds of the basic version on one thread, and of all threads with all culling.
    base: Option<f64>,
    all: Option<f64>,
}

fn dataset(encoding: Encoding) -> &'static str {
    match encoding {
        Encoding::Solid => "Full",
        Encoding::Surface => "Surface",
    }
}

/// All figures of the papers that belong to `part`.
pub fn quoted(part: Part) -> Vec<Row> {
    let row = |name: String, citation: &str| Row {
        part: part.text().into(),
        key: format!("{}/quoted/{name}", part.text()),
        source: Source::Quoted,
        citation: citation.into(),
        variant: name,
        ..Row::default()
    };
    let stated = paper::STATED.iter().filter(|s| s.part == part.text());
    let mut rows: Vec<Row> = stated
        .map(|s| {
            let [fps, fps_low, fps_high] = s.fps;
            let size = (Some(1024), Some(768));
            let base = row(s.what.into(), s.citation);
            Row {
                scene: s.scene.into(),
                device: "GPU".into(),
                width: size.0,
                height: size.1,
                fps,
                fps_low,
                fps_high,
                ..base
            }
        })
        .collect();
    match part {
        Part::Table1 => rows.extend(paper::TABLE1.iter().flat_map(|r| {
            [("far", r.far), ("near", r.near)].map(|(view, fps)| {
                let [w, h] = r.screen;
                let culling = paper::letters(r.letters);
                let name = format!("{} {culling} {:?} {w}x{h} {view}", dataset(r.dataset), r.version);
                Row {
                    scene: "artificial scene, 1024³ repeated".into(),
                    encoding: dataset(r.dataset).to_lowercase(),
                    device: format!("{:?}", r.version).to_uppercase(),
                    width: Some(w),
                    height: Some(h),
                    view: view.into(),
                    culling: culling.into(),
                    fps: Some(fps),
                    ..row(name, FORSTMANN_2009)
                }
            })
        })),
        Part::Ieice => rows.extend(paper::IEICE.iter().map(|r| Row {
            scene: format!("{}, {}", r.scene, r.size),
            device: "GPU".into(),
            width: Some(1024),
            height: Some(768),
            scene_runs: Some(r.total * 1e6),
            runs: Some(r.processed * 1e6),
            spans: Some(r.drawn * 1e6),
            fps: Some(r.fps),
            runs_per_s: Some(r.rate * 1e6),
            bits_per_voxel: Some(r.bits_per_voxel),
            ..row(r.scene.into(), FORSTMANN_2010)
        })),
        Part::Down => rows.push(Row {
            x: Some(paper::READJUSTED_SAVES),
            ..row("readjusted planes: speed-up up to, %".into(), FORSTMANN_2009)
        }),
        Part::Shading => rows.push(Row {
            shade_ms: Some(paper::SSN_SSAO_MS),
            device: "GPU".into(),
            width: Some(1024),
            height: Some(768),
            ..row("SSN + SSAO".into(), FORSTMANN_2009)
        }),
        Part::Speedup => {
            let factor = |name: &str, x, citation| Row { x: Some(x), ..row(name.into(), citation) };
            let [low, high] = paper::GPU_OVER_QUAD_CORE;
            rows.push(factor("GPU over CPU, about", paper::GPU_OVER_CPU, FORSTMANN_2009));
            rows.push(factor("GPU over the basic CPU version, about", paper::GPU_OVER_BASIC, FORSTMANN_2009));
            rows.push(factor("GPU over a quad-core Q6600, least", low, FORSTMANN_2010));
            rows.push(factor("GPU over a quad-core Q6600, greatest", high, FORSTMANN_2010));
        }
        Part::Landscape | Part::Mixing | Part::Scaling => {}
    }
    rows
}

/// Three significant digits.
fn figure(v: f64) -> String {
    if v == 0.0 || !v.is_finite() {
        return if v == 0.0 { "0".into() } else { "–".into() };
    }
    let digits = (2 - v.abs().log10().floor() as i32).clamp(0, 6) as usize;
    format!("{v:.digits$}")
}

fn cell(v: Option<f64>) -> String {
    v.map_or("–".into(), figure)
}

fn millions(v: Option<f64>) -> String {
    cell(v.map(|v| v / 1e6))
}

/// Median with least and greatest.
fn times(row: &Row) -> String {
    match (row.total_ms, row.total_min_ms, row.total_max_ms) {
        (Some(median), Some(min), Some(max)) => format!("{} ({}–{})", figure(median), figure(min), figure(max)),
        _ => "–".into(),
    }
}

fn marked(mark: Mark, cells: Vec<String>) -> page::Row {
    page::Row { cells, mark }
}

fn head(cells: &[&str]) -> Vec<String> {
    cells.iter().map(|&c| c.into()).collect()
}

impl Results<'_> {
    fn get(&self, config: &Config) -> Option<&Row> {
        self.rows.get(&config.key()).filter(|row| row.n > 0)
    }

    /// Configurations of a part that were measured, by group.
    fn part(&self, part: Part) -> Vec<(String, Vec<(Config, &Row)>)> {
        let measured = groups(part, self.extent, self.machine).into_iter().map(|g| {
            let rows = g.configs.into_iter().filter_map(|c| self.get(&c).map(|row| (c, row)));
            (g.title, rows.collect::<Vec<_>>())
        });
        measured.filter(|(_, rows)| !rows.is_empty()).collect()
    }

    fn has(&self, part: Part) -> bool {
        self.rows.values().any(|row| row.part == part.text())
    }

    /// Measured rows with, for each part that was measured, the papers' figures.
    pub fn all_rows(&self) -> Vec<Row> {
        let mut all = Vec::new();
        for part in Part::ALL.into_iter().filter(|&p| self.has(p)) {
            all.extend(self.rows.values().filter(|row| row.part == part.text()).cloned());
            all.extend(quoted(part));
        }
        all
    }

    pub fn plots(&self) -> Vec<Plot> {
        let mut plots = Vec::new();
        if self.has(Part::Table1) {
            plots.push(("table1.svg", self.table1_plot()));
        }
        if self.has(Part::Ieice) {
            plots.push(("elements.svg", self.ieice_plot()));
        }
        if self.has(Part::Speedup) {
            plots.push(("speedup.svg", self.speedup_plot()));
        }
        let files = [
            ("planes", "scaling-planes.svg", Axis::log("planes, % of one a pixel")),
            ("pixels", "scaling-pixels.svg", Axis::log("pixels, millions")),
            ("distance", "scaling-distance.svg", Axis::log("view distance, voxels")),
            ("size", "scaling-size.svg", Axis::log("side of the scene, columns")),
            ("threads", "scaling-threads.svg", Axis::linear("threads")),
        ];
        for (axis, file, x) in files {
            if let Some(plot) = self.scaling_plot(axis, x) {
                plots.push((file, plot));
            }
        }
        plots
    }

    /// A page of all that was measured; `plots` as [`Results::plots`] gave them.
    pub fn page(&self, plots: &[Plot]) -> String {
        let mut page = Page::new("planecast bench");
        page.paragraph(
            "Figures of this run beside those of the papers whose method planecast uses. Rows in italics on a tinted ground are \
             quoted from the source named in them; all others were measured by this run, on the machine below. In CSV and \
             JSON the column source says measured or quoted.",
        );
        let mut about = Table { head: head(&["machine and run", ""]), ..Table::default() };
        about.rows = self.about.iter().map(|(k, v)| page::Row::new([k.clone(), v.clone()])).collect();
        page.table(&about);
        if *self.extent != Extent::FULL {
            page.paragraph(&format!(
                "This was a shortened run: scenes and view distances are {} times, pictures {} times smaller a side than \
                 the papers', and few frames were drawn. Its figures are a first look and not comparable with the quoted ones.",
                self.extent.scene_shrink, self.extent.picture_shrink
            ));
        }
        page.paragraph(
            "Times are milliseconds a frame: median, and least to greatest in brackets, after a warm-up, configurations of a \
             table drawn in turns. Frames a second are of the median frame. Of the CPU, a frame is plane setup to shading; of \
             the GPU, traverse to shading by the device's own clock. Display and read-back are in neither.",
        );
        self.scenes(&mut page);
        let plot = |page: &mut Page, name: &str, caption: &str| {
            if let Some((_, svg)) = plots.iter().find(|(file, _)| *file == name) {
                page.svg(svg, caption);
            }
        };
        for part in Part::ALL.into_iter().filter(|&p| self.has(p)) {
            match part {
                Part::Table1 => {
                    self.table1(&mut page);
                    plot(&mut page, "table1.svg", "Frames a second, mean of far and near view. Pale: quoted.");
                }
                Part::Landscape => self.plain(
                    &mut page,
                    part,
                    "Landscape seen to 180,000 voxels",
                    "The landscape repeats without end. Spread is over eight directions.",
                ),
                Part::Mixing => self.plain(
                    &mut page,
                    part,
                    "Mixing layer: once, repeated, 400 copies",
                    "Geometry without colours, drawn with SSN and SSAO. The paper's data set is 2,048³; repeated, it is seen to \
                     40,000 voxels; 400 copies are those in the sector in sight. Spread is over directions.",
                ),
                Part::Down => self.down(&mut page),
                Part::Shading => self.shading(&mut page),
                Part::Ieice => {
                    self.ieice(&mut page);
                    plot(&mut page, "elements.svg", "RLE elements processed a second, millions. Pale: quoted.");
                }
                Part::Speedup => {
                    self.speedup(&mut page);
                    plot(&mut page, "speedup.svg", "Times faster than the basic version on one thread. Pale: quoted.");
                }
                Part::Scaling => {
                    page.heading(2, "Scaling");
                    page.paragraph(
                        "The landscape, repeated, level, 20° and 60° down: the median frame of the three views as one thing \
                         varies and the rest stays (100 % of planes, 1,024 × 768 pixels, 40,000 voxels, 1,024 columns a side, \
                         all threads; less in a shortened run). All measured.",
                    );
                    for (file, svg) in plots.iter().filter(|(file, _)| file.starts_with("scaling")) {
                        page.svg(svg, &format!("plots/{file}"));
                    }
                }
            }
        }
        let failed: Vec<&Row> = self.rows.values().filter(|row| row.n == 0).collect();
        if !failed.is_empty() {
            page.heading(2, "Not measured");
            page.list(failed.iter().map(|row| format!("{}: {}", row.key, row.variant)));
        }
        page.finish()
    }

    fn scenes(&self, page: &mut Page) {
        page.heading(2, "Scenes");
        page.list(Name::ALL.iter().map(|name| match self.files.get(name) {
            Some(file) => {
                let file = file.file_name().unwrap_or(file.as_os_str()).to_string_lossy();
                format!("{}: from the file {file}", name.text())
            }
            None => format!("{}: procedural; {}", name.text(), name.about()),
        }));
        let pictures: Vec<(&[u8], &str)> = self.pictures.iter().map(|(png, text)| (&**png, &**text)).collect();
        for row in pictures.chunks(3) {
            page.pictures(row);
        }
    }

    /// Far and near row of one engine.
    fn pairs<'c>(&self, configs: &'c [Config]) -> Vec<(&'c Config, [&Row; 2])> {
        let view = |v: View, of: &Config| {
            let wanted = configs.iter().find(|c| c.view == v && c.engine == of.engine)?;
            self.get(wanted)
        };
        let far = configs.iter().filter(|c| c.view == View::Far);
        far.filter_map(|c| Some((c, [view(View::Far, c)?, view(View::Near, c)?]))).collect()
    }

    fn table1(&self, page: &mut Page) {
        page.heading(2, "Table 1 of Forstmann & Ohya 2009");
        page.paragraph(
            "A coloured scene of many complex shapes, repeated and seen to 40,000 voxels, a colour a run. The paper's letters \
             are these switches: (F)orward is forward, (C)entersegment is center, (S)haremem is bits; the floating horizon has \
             no letter and is on in every row. Coarse cells are not in the paper: they are on in the last rows only. Deviations: \
             the scene and both views are modelled on the paper's Fig. 6, not the same; far columns are all walked, none \
             equidistantly; on the CPU, bits stand in the cache; frames a second are of stages alone. GPU rows were measured with \
             the kernel that gives a plane to an invocation, as the paper does, and all rows with all threads of the CPU.",
        );
        if !self.machine.gpu {
            page.paragraph(
                "No GPU was measured in this run: beside the paper's GPU stand this machine's CPU rows alone.",
            );
        }
        let columns = [
            "dataset",
            "optim.",
            "screen",
            "drawn by",
            "far, fps",
            "near, fps",
            "mean",
            "far, ms",
            "near, ms",
            "runs met, M",
        ];
        let mut table = Table { head: head(&columns), ..Table::default() };
        let line = |cells: [String; 4], rows: [&Row; 2]| {
            let [far, near] = rows;
            let mean = far.fps.zip(near.fps).map(|(a, b)| (a + b) / 2.0);
            let runs = far.runs.zip(near.runs).map(|(a, b)| (a + b) / 2.0);
            let figures = [cell(far.fps), cell(near.fps), cell(mean), times(far), times(near), millions(runs)];
            cells.into_iter().chain(figures).collect::<Vec<_>>()
        };
        let screen = |[w, h]: [u32; 2]| format!("{w} × {h}");
        for row in paper::TABLE1 {
            let letters = paper::letters(row.letters);
            let device = format!("{} of the paper (quoted)", format!("{:?}", row.version).to_uppercase());
            let cells = [dataset(row.dataset).into(), letters.into(), screen(row.screen), device];
            let fps = [row.far, row.near, row.average].map(figure);
            let none = ["–", "–", "–"].map(String::from);
            table.rows.push(marked(Mark::Quoted, cells.into_iter().chain(fps).chain(none).collect()));
            for (config, rows) in self.pairs(&table1_configs(&row, self.extent, self.machine)) {
                let cells = [String::new(), String::new(), screen(config.size), config.engine.name()];
                table.rows.push(marked(Mark::Plain, line(cells, rows)));
            }
        }
        for size in [[512, 512], [1024, 768]] {
            for (config, rows) in self.pairs(&table1_ours(size, self.extent, self.machine)) {
                let cells = ["Full".into(), "all, coarse".into(), screen(config.size), config.engine.name()];
                table.rows.push(marked(Mark::Strong, line(cells, rows)));
            }
        }
        table.caption = format!("Quoted: {FORSTMANN_2009}, Table 1.");
        page.table(&table);
    }

    fn table1_plot(&self) -> String {
        let mut rows = Vec::new();
        let mean = |[far, near]: [&Row; 2]| Some((far.fps? + near.fps?) / 2.0);
        for row in paper::TABLE1 {
            let [w, h] = row.screen;
            let what = format!("{} {}, {w} × {h}", dataset(row.dataset), paper::letters(row.letters));
            let device = format!("{:?}", row.version).to_uppercase();
            rows.push(BarRow { name: format!("{what}, {device}"), quoted: true, values: vec![row.average] });
            for (config, pair) in self.pairs(&table1_configs(&row, self.extent, self.machine)) {
                rows.extend(mean(pair).map(|fps| BarRow {
                    name: config.engine.name(),
                    quoted: false,
                    values: vec![fps],
                }));
            }
        }
        for (config, pair) in self.pairs(&table1_ours([1024, 768], self.extent, self.machine)) {
            let name = format!("Full all, 1024 × 768: {}", config.engine.name());
            rows.extend(mean(pair).map(|fps| BarRow { name, quoted: false, values: vec![fps] }));
        }
        let value = Axis::log("frames a second");
        let title = "Table 1: frames a second, paper and here".into();
        Bars { title, value, parts: vec!["frames a second".into()], rows, stacked: false }.svg()
    }

    /// A table of configurations, each with the quoted row of the same variant before it.
    fn plain(&self, page: &mut Page, part: Part, title: &str, text: &str) {
        page.heading(2, title);
        page.paragraph(text);
        let columns = [
            "what",
            "drawn by",
            "scene",
            "fps",
            "slowest",
            "fastest",
            "ms",
            "planes",
            "columns, k",
            "runs, k",
            "spans, k",
        ];
        let mut table = Table { head: head(&columns), ..Table::default() };
        let quotes = quoted(part);
        let rows: Vec<(Config, &Row)> = self.part(part).into_iter().flat_map(|(_, rows)| rows).collect();
        let mut whats: Vec<&str> = rows.iter().map(|(c, _)| &*c.variant).collect();
        let mut seen = std::collections::HashSet::new();
        whats.retain(|what| seen.insert(*what));
        for what in whats {
            for q in quotes.iter().filter(|q| q.variant == what) {
                let figures = [q.fps, q.fps_low, q.fps_high].map(cell);
                let cells = [what.into(), format!("{}, {} (quoted)", q.device, q.citation), q.scene.clone()];
                let none = std::iter::repeat_n("–".to_owned(), 5);
                table.rows.push(marked(Mark::Quoted, cells.into_iter().chain(figures).chain(none).collect()));
            }
            for (config, row) in rows.iter().filter(|(c, _)| c.variant == what) {
                let cells = [what.into(), config.engine.name(), row.scene.clone()];
                let figures = [row.fps, row.fps_low, row.fps_high].map(cell);
                let thousands = |v: Option<f64>| cell(v.map(|v| v / 1e3));
                let work =
                    [times(row), cell(row.planes), thousands(row.columns), thousands(row.runs), thousands(row.spans)];
                table.rows.push(marked(Mark::Plain, cells.into_iter().chain(figures).chain(work).collect()));
            }
        }
        page.table(&table);
    }

    fn down(&self, page: &mut Page) {
        page.heading(2, "Straight down: readjusted planes");
        page.paragraph(
            "Looking straight down, a pixel's spacing along each screen edge crowds planes in the middle; readjusted, they are \
             farther apart (paper, Fig. 4). The speed-up is time as they fall over time readjusted, less one.",
        );
        let columns = [
            "scene",
            "drawn by",
            "planes",
            "readjusted",
            "traverse, ms",
            "readjusted",
            "speed-up",
            "frame, ms",
            "readjusted",
            "speed-up",
        ];
        let mut table = Table { head: head(&columns), ..Table::default() };
        let mut cells = vec!["its scene".to_owned(), format!("{FORSTMANN_2009} (quoted)")];
        cells.resize(9, "–".into());
        cells.push(format!("up to {} %", paper::READJUSTED_SAVES));
        table.rows.push(marked(Mark::Quoted, cells));
        for (_, rows) in self.part(Part::Down) {
            for (config, full) in rows.iter().filter(|(c, _)| !c.options.readjust) {
                let same = |c: &Config| c.engine == config.engine && c.options.readjust;
                let Some((_, fewer)) = rows.iter().find(|(c, _)| same(c)) else { continue };
                let gain = |a: Option<f64>, b: Option<f64>| {
                    a.zip(b)
                        .filter(|(_, b)| *b > 0.0)
                        .map_or("–".into(), |(a, b)| format!("{:.0} %", (a / b - 1.0) * 100.0))
                };
                table.rows.push(page::Row::new([
                    config.scene.name.text().to_owned(),
                    config.engine.name(),
                    cell(full.planes),
                    cell(fewer.planes),
                    cell(full.traverse_ms),
                    cell(fewer.traverse_ms),
                    gain(full.traverse_ms, fewer.traverse_ms),
                    times(full),
                    times(fewer),
                    gain(full.total_ms, fewer.total_ms),
                ]));
            }
        }
        page.table(&table);
    }

    fn shading(&self, page: &mut Page) {
        page.heading(2, "SSN and SSAO");
        page.paragraph("The stage shade on the mixing layer, by what it computes. none still writes colours and sky.");
        let mut table = Table {
            head: head(&["shading", "drawn by", "shade, ms", "over none, ms", "frame, ms"]),
            ..Table::default()
        };
        let quote = ["SSN + SSAO".to_owned(), format!("GPU, {FORSTMANN_2009} (quoted)")];
        let figures = [format!("about {}", paper::SSN_SSAO_MS), "–".into(), "–".into()];
        table.rows.push(marked(Mark::Quoted, quote.into_iter().chain(figures).collect()));
        for (_, rows) in self.part(Part::Shading) {
            for (config, row) in &rows {
                let none = rows.iter().find(|(c, _)| c.engine == config.engine && c.variant == "none");
                let over = row.shade_ms.zip(none.and_then(|(_, r)| r.shade_ms)).map(|(a, b)| a - b);
                table.rows.push(page::Row::new([
                    config.variant.clone(),
                    config.engine.name(),
                    cell(row.shade_ms),
                    cell(over),
                    times(row),
                ]));
            }
        }
        page.table(&table);
    }

    fn ieice(&self, page: &mut Page) {
        page.heading(2, "Elements met and drawn: Table 1 of Forstmann & Ohya 2010");
        page.paragraph(
            "An RLE element is a run here. Whether the paper counts those of all levels is not stated: both are given. Bits a voxel \
             are of the scene's file by surface voxels of level 0: geometry with column tables of level 0, and everything (all \
             levels, 24-bit colours, tables). Fewer elements a second at more frames a second means that more was culled before it \
             was looked at. Views are from eight sides of each scene, alone; those of the \
             paper are not known.",
        );
        let columns = [
            "scene",
            "drawn by",
            "elements, M: level 0",
            "all levels",
            "processed, M",
            "drawn, M",
            "fps",
            "M elements/s",
            "bits/voxel: geometry",
            "everything",
        ];
        let mut table = Table { head: head(&columns), ..Table::default() };
        for q in quoted(Part::Ieice) {
            table.rows.push(marked(
                Mark::Quoted,
                vec![
                    q.scene.clone(),
                    "GTX 285 (quoted)".into(),
                    millions(q.scene_runs),
                    "–".into(),
                    millions(q.runs),
                    millions(q.spans),
                    cell(q.fps),
                    millions(q.runs_per_s),
                    "–".into(),
                    cell(q.bits_per_voxel),
                ],
            ));
        }
        for (config, row) in self.part(Part::Ieice).into_iter().flat_map(|(_, rows)| rows) {
            table.rows.push(page::Row::new([
                row.scene.clone(),
                format!("{}, {}", config.engine.name(), config.variant),
                millions(row.scene_runs),
                millions(row.scene_runs_all),
                millions(row.runs),
                millions(row.spans),
                cell(row.fps),
                millions(row.runs_per_s),
                cell(row.geometry_bits_per_voxel),
                cell(row.bits_per_voxel),
            ]));
        }
        table.caption = format!("Quoted: {FORSTMANN_2010}.");
        page.table(&table);
    }

    fn ieice_plot(&self) -> String {
        let bar =
            |name: String, quoted, rate: Option<f64>| rate.map(|r| BarRow { name, quoted, values: vec![r / 1e6] });
        let mut rows: Vec<BarRow> =
            quoted(Part::Ieice).into_iter().filter_map(|q| bar(q.scene, true, q.runs_per_s)).collect();
        for (config, row) in self.part(Part::Ieice).into_iter().flat_map(|(_, rows)| rows) {
            let name = format!("{}, {}, {}", config.scene.name.text(), config.engine.name(), config.variant);
            rows.extend(bar(name, false, row.runs_per_s));
        }
        let value = Axis::log("million elements processed a second");
        Bars { title: "RLE elements a second".into(), value, parts: vec!["rate".into()], rows, stacked: false }.svg()
    }

    fn speedups(&self) -> Vec<SpeedUps<'_>> {
        let groups = self.part(Part::Speedup).into_iter().map(|(title, rows)| {
            let ms = |engine, basic: bool| {
                let of = |c: &Config| {
                    c.engine == engine && (c.variant == "basic") == basic && c.variant != "the papers' culling"
                };
                rows.iter().find(|(c, _)| of(c)).and_then(|(_, r)| r.total_ms)
            };
            // At level 0 there is no basic version: planes on one thread are the measure.
            let base = ms(self.machine.one(), true).or(ms(self.machine.one(), false));
            let all = ms(self.machine.all(), false);
            SpeedUps { title, rows, base, all }
        });
        groups.collect()
    }

    fn speedup(&self, page: &mut Page) {
        page.heading(2, "GPU against CPU");
        page.paragraph(
            "basic culls with the floating horizon alone; the papers' culling adds forward, center and bits; all culling adds coarse \
             cells. invocation is the paper's mapping, a plane an invocation; workgroup gives a plane to a workgroup; raycast casts \
             a ray a pixel through a sparse tree of 64-bit masks with the same levels, raycast-runs through the columns of planes. exact rays are one f64 ray a pixel at level 0.",
        );
        let mut table = Table {
            head: head(&["scene and view", "drawn by", "", "ms", "× one thread, basic", "× all threads"]),
            ..Table::default()
        };
        for q in quoted(Part::Speedup) {
            let factor = cell(q.x);
            let basic = q.variant.contains("basic");
            let (one, all) = if basic { (factor, "–".into()) } else { ("–".into(), factor) };
            let cells =
                vec!["the papers' scenes".into(), format!("{} (quoted)", q.variant), q.citation, "–".into(), one, all];
            table.rows.push(marked(Mark::Quoted, cells));
        }
        for SpeedUps { title, rows, base, all } in self.speedups() {
            for (config, row) in rows {
                let over =
                    |base: Option<f64>| cell(base.zip(row.total_ms).filter(|(_, ms)| *ms > 0.0).map(|(b, ms)| b / ms));
                table.rows.push(page::Row::new([
                    title.trim_start_matches("speed-up").trim_start_matches([',', ' ']).to_owned(),
                    config.engine.name(),
                    config.variant.clone(),
                    times(row),
                    over(base),
                    over(all),
                ]));
            }
        }
        page.table(&table);
    }

    fn speedup_plot(&self) -> String {
        let mut rows = vec![BarRow {
            name: "paper: GPU over basic CPU".into(),
            quoted: true,
            values: vec![paper::GPU_OVER_BASIC],
        }];
        for SpeedUps { title, rows: group, base, .. } in self.speedups() {
            let title = title.trim_start_matches("speed-up").trim_start_matches([',', ' ']).to_owned();
            for (config, row) in group {
                let Some((base, ms)) = base.zip(row.total_ms).filter(|(_, ms)| *ms > 0.0) else { continue };
                let name = format!("{title}: {}, {}", config.engine.name(), config.variant);
                rows.push(BarRow { name, quoted: false, values: vec![base / ms] });
            }
        }
        let value = Axis::log("times faster than one thread, basic");
        Bars { title: "Speed-up".into(), value, parts: vec!["times".into()], rows, stacked: false }.svg()
    }

    fn scaling_plot(&self, axis: &str, x: Axis) -> Option<String> {
        let (title, rows) = self.part(Part::Scaling).into_iter().find(|(title, _)| title.ends_with(axis))?;
        let mut series: Vec<Series> = Vec::new();
        for (config, row) in rows {
            let name = if axis == "threads" { "CPU".into() } else { config.engine.name() };
            let point = [config.x?, row.total_ms?];
            match series.iter_mut().find(|s| s.name == name) {
                Some(s) => s.points.push(point),
                None => series.push(Series { name, quoted: false, points: vec![point] }),
            }
        }
        let title = format!("Time a frame, {title}");
        Some(Lines { title, x, y: Axis::log("ms a frame, median"), series }.svg())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn present_quotes_every_figure_of_the_papers_with_its_source() {
        let all: Vec<Row> = Part::ALL.into_iter().flat_map(quoted).collect();
        assert_eq!(all.iter().filter(|r| r.part == "table1").count(), 36);
        assert_eq!(all.iter().filter(|r| r.part == "ieice").count(), 5);
        assert_eq!(all.len(), 36 + 5 + 4 + 1 + 1 + 4);
        let mut keys = std::collections::HashSet::new();
        for row in &all {
            assert!(row.source == Source::Quoted && row.citation.starts_with("Forstmann"), "{row:?}");
            assert!(keys.insert(&row.key), "{} is there twice", row.key);
        }
    }

    #[test]
    fn figures_have_three_digits() {
        for (v, text) in
            [(0.0, "0"), (0.012345, "0.0123"), (1.5, "1.50"), (19.35, "19.4"), (1234.5, "1234"), (f64::NAN, "–")]
        {
            assert_eq!(figure(v), text);
        }
    }
}
