//! A report's files: tables as CSV and JSON, plots, pictures of the worst places, and the page that holds it all.

use super::metrics::{Errors, Truth};
use super::run::{Draw, Plan, Row, SUPERSAMPLING};
use super::sweep::{Backend, Config, SOURCES, Source};
use crate::error::{Error, Result};
use crate::frame::picture::{Frame, StageTimes};
use crate::frame::preset::Preset;
use crate::measure::machine::Machine;
use crate::measure::page::{Mark, Page, Row as TableRow, Table};
use crate::measure::plot::{Axis, BarRow, Bars, Front, Group, Lines, Point, Scatter, Series, pareto};
use crate::{Options, output};
use serde_json::{Value, json};
use std::path::Path;

/// A file of the report, in memory.
pub struct Content {
    pub name: String,
    pub bytes: Vec<u8>,
}

/// A plot of the page.
struct Plot {
    name: &'static str,
    caption: String,
    svg: String,
}

/// What the figures are of.
pub struct Subject<'s> {
    pub machine: &'s Machine,
    /// The scene as it was named, and its content's hash.
    pub scene: &'s str,
    pub content: &'s str,
    pub dims: [u32; 3],
    /// Notes on the choice that was asked for, if one was.
    pub choice: Option<&'s str>,
}

/// All files, the page last.
pub fn files(plan: &Plan<'_>, rows: &[Row], subject: &Subject<'_>, draw: &mut dyn Draw) -> Result<Vec<Content>> {
    let sources: Vec<(Source, &Row, &Row)> = SOURCES
        .iter()
        .filter_map(|&s| {
            let find = |name: &str| rows.iter().find(|r| r.config.name == name);
            Some((s, find(s.without)?, find(s.with)?))
        })
        .collect();
    let mut files = vec![
        Content { name: "report.csv".into(), bytes: csv(plan, rows)? },
        Content { name: "report.json".into(), bytes: to_json(plan, rows, &sources, subject) },
    ];
    let exact = rows.iter().find(|r| r.config.backend == Backend::Exact).map_or(f64::INFINITY, Row::total);
    let mut plots = vec![
        Plot {
            name: "error-time",
            caption: format!(
                "Error of the shaded colour against time; one exact ray a pixel takes {exact:.0} ms on the CPU. Pale lines \
                 span the rounds; red rings mark the front: nothing measured is faster with less error."
            ),
            svg: scatter(rows, "Error against time", "FLIP against one exact ray a pixel, mean", &|r| r.flip()),
        },
        Plot {
            name: "supersampled-time",
            caption:
                "The same against several exact rays a pixel. What is common to all is the error of aliasing, which \
                      one exact ray a pixel has too."
                    .into(),
            svg: scatter(rows, "Error against time, with aliasing", "FLIP against 4 exact rays a pixel, mean", &|r| {
                r.mean(|e| e.errors.flip)
            }),
        },
        Plot {
            name: "voxels-time",
            caption: "Voxels against time. A coarser voxel that holds the truth's voxel counts as right.".into(),
            svg: scatter(rows, "Wrong voxels against time", "pixels with another voxel, %", &|r| r.other()),
        },
        Plot {
            name: "stages",
            caption: "Median of the rounds, each the mean over the poses.".into(),
            svg: stages(rows, false),
        },
    ];
    if rows.iter().any(|r| matches!(r.config.backend, Backend::Gpu(_))) {
        let caption = "On the GPU, by its own clock.".into();
        plots.push(Plot { name: "stages-gpu", caption, svg: stages(rows, true) });
    }
    if !sources.is_empty() {
        let caption = "What each source of error adds alone, everything else at its most exact.".into();
        plots.push(Plot { name: "sources", caption, svg: source_bars(&sources) });
    }
    let pixels = f64::from(plan.size[0]) * f64::from(plan.size[1]);
    let caption = "Shares of pixels over the number of planes, everything else as usual.".into();
    plots.push(Plot { name: "planes", caption, svg: sweep_lines(rows, pixels) });
    for plot in &plots {
        files.push(Content { name: format!("{}.svg", plot.name), bytes: plot.svg.clone().into_bytes() });
    }
    let pictures = pictures(plan, rows, draw)?;
    let thumbnail = thumbnail(plan, rows, draw)?;
    let page = page(plan, rows, &sources, subject, &plots, &pictures, &thumbnail);
    files.extend(pictures.into_iter().flat_map(|p| p.files));
    files.push(Content { name: "report.html".into(), bytes: page.into_bytes() });
    Ok(files)
}

/// Writes all files in full before the first gets its name.
pub fn write(folder: &Path, files: &[Content]) -> Result<()> {
    let pending: planecast_encoder::Result<Vec<output::Pending>> = files
        .iter()
        .map(|f| output::write(&folder.join(&f.name), |out| std::io::Write::write_all(out, &f.bytes)))
        .collect();
    for file in pending? {
        file.finish()?;
    }
    Ok(())
}

/// A stage's name, and its time among all.
type Stage = (&'static str, fn(&StageTimes) -> f64);

const STAGES: [Stage; 5] = [
    ("setup", |t| t.setup),
    ("traverse", |t| t.traverse),
    ("remap", |t| t.remap),
    ("shade", |t| t.shade),
    ("total", |t| t.total),
];

/// Every configuration at every pose.
fn csv(plan: &Plan<'_>, rows: &[Row]) -> Result<Vec<u8>> {
    let failed = |e: csv::Error| Error::Limit(format!("the table cannot be made: {e}"));
    let mut out = csv::Writer::from_writer(Vec::new());
    let mut head: Vec<String> =
        ["configuration", "sweep", "device", "flags", "beside the flags", "pose"].map(String::from).to_vec();
    head.extend(figures(&super::journal::ErrorFigures::default()).into_iter().map(|(name, _)| name.to_owned()));
    for (stage, _) in STAGES {
        head.extend(["min", "median", "max"].map(|q| format!("{stage}_ms_{q}")));
    }
    out.write_record(&head).map_err(failed)?;
    for row in rows {
        let c = &row.config;
        for (p, (pose, errors)) in plan.poses.iter().zip(&row.errors).enumerate() {
            let text = |s: Option<String>| s.unwrap_or_default();
            let mut record = vec![
                c.name.clone(),
                c.sweep.into(),
                c.backend.name().into(),
                c.flags(),
                text(c.beside_flags()),
                pose.name.clone(),
            ];
            record.extend(figures(errors).into_iter().map(|(_, v)| v.to_string()));
            let here = Row { errors: Vec::new(), times: row.times.iter().map(|t| vec![t[p]]).collect(), ..row.clone() };
            for (_, stage) in STAGES {
                match here.time(stage) {
                    Some(t) => record.extend(t.map(|v| v.to_string())),
                    None => record.extend([const { String::new() }; 3]),
                }
            }
            out.write_record(&record).map_err(failed)?;
        }
    }
    out.into_inner().map_err(|e| Error::Limit(format!("the table cannot be made: {e}")))
}

/// Figures of one picture, by the names that the tables have for them.
fn figures(f: &super::journal::ErrorFigures) -> Vec<(&'static str, f64)> {
    let e = &f.errors;
    vec![
        ("other_voxel_percent", e.other),
        ("other_voxel_within_a_pixel_percent", e.other_near),
        ("other_voxel_level_0_percent", e.other_level0),
        ("other_voxel_level_0_within_a_pixel_percent", e.other_level0_near),
        ("coarser_percent", e.coarser),
        ("sky_mismatch_percent", e.sky),
        ("depth_error_median_voxels", e.depth[0]),
        ("depth_error_p99_voxels", e.depth[1]),
        ("depth_error_max_voxels", e.depth[2]),
        ("depth_error_median_relative", e.depth_relative[0]),
        ("depth_error_p99_relative", e.depth_relative[1]),
        ("depth_error_max_relative", e.depth_relative[2]),
        ("psnr_db", e.psnr()),
        ("ssim", e.ssim),
        ("flip", e.flip),
        ("flip_of_one_ray", e.flip_exact),
        ("holes_before", f.holes[0] as f64),
        ("holes_after", f.holes[1] as f64),
        ("planes", f64::from(f.planes)),
        ("columns_visited", f.columns_visited as f64),
        ("runs_visited", f.runs_visited as f64),
        ("spans_drawn", f.spans_drawn as f64),
    ]
}

fn to_json(plan: &Plan<'_>, rows: &[Row], sources: &[(Source, &Row, &Row)], subject: &Subject<'_>) -> Vec<u8> {
    let times = |row: &Row| -> Value {
        let stage = |&(name, f): &Stage| {
            let [min, median, max] = row.time(f)?;
            Some((name.to_owned(), json!({ "min": min, "median": median, "max": max })))
        };
        Value::Object(STAGES.iter().filter_map(stage).collect())
    };
    let object = |f: &super::journal::ErrorFigures| -> Value {
        Value::Object(figures(f).into_iter().map(|(name, v)| (name.to_owned(), json!(v))).collect())
    };
    let configs: Vec<Value> = (rows.iter())
        .map(|row| {
            let c = &row.config;
            let names = figures(&row.errors[0]);
            let mean = names.iter().enumerate().map(|(i, (name, _))| {
                let mean = if *name == "psnr_db" { row.psnr() } else { row.mean(|e| figures(e)[i].1) };
                ((*name).to_owned(), json!(mean))
            });
            json!({
                "name": c.name, "sweep": c.sweep, "device": c.backend.name(), "flags": c.flags(),
                "beside_flags": c.beside_flags(), "ms": times(row), "mean": Value::Object(mean.collect()),
                "poses": row.errors.iter().map(object).collect::<Vec<_>>(),
            })
        })
        .collect();
    let sources: Vec<Value> = (sources.iter())
        .map(|(s, without, with)| {
            let d = Difference::new(without, with);
            json!({
                "source": s.name, "without": s.without, "with": s.with, "other_voxel_percent": d.other,
                "other_voxel_within_a_pixel_percent": d.other_near, "flip": d.flip, "depth_p99_voxels": d.depth,
                "saved_ms": d.saved, "saved_percent": d.saved_percent,
            })
        })
        .collect();
    let poses: Vec<Value> = (plan.poses.iter())
        .map(|p| {
            let pose = &p.pose;
            json!({ "name": p.name, "eye": pose.eye.to_array(), "yaw": pose.yaw, "pitch": pose.pitch, "roll": pose.roll, "fov": pose.fov })
        })
        .collect();
    let value = json!({
        "machine": subject.machine, "scene": subject.scene, "content_hash": subject.content, "dims": subject.dims,
        "size": plan.size, "rounds": plan.rounds, "rays_a_pixel": SUPERSAMPLING * SUPERSAMPLING, "poses": poses,
        "configurations": configs, "sources": sources, "choice": subject.choice,
    });
    let mut text = serde_json::to_vec_pretty(&value).expect("plain values have a JSON form");
    text.push(b'\n');
    text
}

/// What one source of error costs and saves.
struct Difference {
    other: f64,
    other_near: f64,
    flip: f64,
    depth: f64,
    /// Milliseconds; none where nothing was timed.
    saved: Option<f64>,
    saved_percent: Option<f64>,
}

impl Difference {
    fn new(without: &Row, with: &Row) -> Difference {
        let by = |f: &dyn Fn(&Errors) -> f64| with.mean(|e| f(&e.errors)) - without.mean(|e| f(&e.errors));
        let saved = with.time(|t| t.total).and(Some(without.total() - with.total()));
        Difference {
            other: by(&|e| e.other),
            other_near: by(&|e| e.other_near),
            flip: by(&|e| e.flip_exact),
            depth: by(&|e| e.depth[1]),
            saved,
            saved_percent: saved.map(|s| 100.0 * s / without.total()),
        }
    }
}

fn scatter(rows: &[Row], title: &str, label: &str, figure: &dyn Fn(&Row) -> f64) -> String {
    let group = |name: &str, is: &dyn Fn(&Config) -> bool| Group {
        name: name.into(),
        quoted: false,
        points: (rows.iter().filter(|r| is(&r.config)))
            .filter_map(|r| {
                let [lo, x, hi] = r.time(|t| t.total)?;
                let label = r.config.name.trim_start_matches("gpu, ").into();
                Some(Point { x, y: figure(r), spread: Some([lo, hi]), label })
            })
            .collect(),
    };
    let groups = [
        group("CPU", &|c| c.candidate && c.backend == Backend::Cpu),
        group("GPU", &|c| c.candidate && matches!(c.backend, Backend::Gpu(_))),
    ];
    let groups = groups.into_iter().filter(|g| !g.points.is_empty()).collect();
    let scatter = Scatter {
        title: title.into(),
        x: Axis::log("milliseconds a frame, median"),
        y: Axis::log(label),
        groups,
        front: Front::OfAll,
    };
    scatter.svg()
}

fn stages(rows: &[Row], gpu: bool) -> String {
    let shown = |r: &&Row| match r.config.backend {
        Backend::Gpu(_) => gpu,
        // Sources of error, measured at their most exact, and the exact renderer are slower by far: the table has them.
        _ => !gpu && !["source", "exact"].contains(&r.config.sweep),
    };
    let mut rows: Vec<&Row> = rows.iter().filter(shown).collect();
    rows.sort_by(|a, b| a.total().total_cmp(&b.total()));
    let bar = |r: &&Row| BarRow {
        name: r.config.name.trim_start_matches("gpu, ").into(),
        quoted: false,
        values: STAGES[..4].iter().map(|(_, f)| r.time(f).map_or(0.0, |t| t[1])).collect(),
    };
    let bars = Bars {
        title: if gpu { "Time by stage, GPU" } else { "Time by stage, CPU" }.into(),
        value: Axis::linear("milliseconds a frame"),
        parts: STAGES[..4].iter().map(|(name, _)| (*name).into()).collect(),
        rows: rows.iter().map(bar).collect(),
        stacked: true,
    };
    bars.svg()
}

fn source_bars(sources: &[(Source, &Row, &Row)]) -> String {
    let bars = Bars {
        title: "Error by source".into(),
        value: Axis::log("pixels with another voxel, points of a percent added"),
        parts: vec!["another voxel".into(), "not within a pixel either".into()],
        rows: (sources.iter())
            .map(|(s, without, with)| {
                let d = Difference::new(without, with);
                BarRow { name: s.name.into(), quoted: false, values: vec![d.other.max(0.0), d.other_near.max(0.0)] }
            })
            .collect(),
        stacked: false,
    };
    bars.svg()
}

/// Error over the number of planes, for pictures of so many pixels.
fn sweep_lines(rows: &[Row], pixels: f64) -> String {
    let mut swept: Vec<(f64, &Row)> = (rows.iter())
        .filter(|r| r.config.backend == Backend::Cpu && (r.config.sweep == "planes" || r.config.sweep == "default"))
        .map(|r| {
            let share = match r.config.options.planes {
                crate::Planes::Factor(f) => f,
                _ => 1.0,
            };
            (100.0 * share, r)
        })
        .collect();
    swept.sort_by(|a, b| a.0.total_cmp(&b.0));
    let line = |name: &str, figure: &dyn Fn(&Row) -> f64| Series {
        name: name.into(),
        quoted: false,
        points: swept.iter().map(|&(x, r)| [x, figure(r)]).collect(),
    };
    let lines = Lines {
        title: "Error over the number of planes".into(),
        x: Axis::log("planes, % of one a pixel"),
        y: Axis::log("pixels, %"),
        series: vec![
            line("another voxel", &|r| r.other()),
            line("not within a pixel either", &|r| r.mean(|e| e.errors.other_near)),
            line("no plane passes, before gap fill", &|r| 100.0 * r.mean(|e| e.holes[0] as f64) / pixels),
        ],
    };
    lines.svg()
}

/// One place of one picture: as drawn, the truth, and FLIP between the two.
struct Triple {
    title: String,
    files: Vec<Content>,
}

/// Pixels of a cut-out.
const CUT: [u32; 2] = [256, 192];

/// The worst poses of the usual configuration, and the worst of one with few planes and of one with coarse levels, each
/// where it is worst.
fn pictures(plan: &Plan<'_>, rows: &[Row], draw: &mut dyn Draw) -> Result<Vec<Triple>> {
    let mut wanted: Vec<(&Config, usize)> = Vec::new();
    for name in ["default", "planes 25 %", "lod 8"] {
        let Some(row) = rows.iter().find(|r| r.config.name == name) else { continue };
        wanted.push((&row.config, row.worst(|e| e.errors.flip_exact).0));
    }
    let mut triples = Vec::new();
    for (n, (config, pose)) in wanted.into_iter().enumerate() {
        let pose = &plan.poses[pose];
        let truth = plan.truth(draw, pose)?;
        let frame = plan.picture(draw, config, pose)?;
        let (map, [x, y], mean) = worst_place(&truth, &frame);
        let cut = |color: &[[u8; 4]]| cut_out(color, plan.size, [x, y]);
        let parts = [("rendered", cut(&frame.color)), ("truth", cut(&truth.color)), ("difference", cut(&map))];
        let files = parts.into_iter().map(|(part, frame)| {
            let mut bytes = Vec::new();
            output::png(&mut bytes, &frame).expect("a picture is written into memory");
            Content { name: format!("worst-{}-{part}.png", n + 1), bytes }
        });
        let files = files.collect();
        let title = format!("{}, {}: mean FLIP {mean:.3}, cut out from pixel {x}, {y}", config.name, pose.name);
        triples.push(Triple { title, files });
    }
    Ok(triples)
}

/// FLIP in colours, the corner of the cut-out with the greatest sum, and the mean over the picture.
fn worst_place(truth: &Truth, frame: &Frame) -> (Vec<[u8; 4]>, [u32; 2], f64) {
    let flip = truth.flip(&frame.color);
    let [w, h] = [frame.width as usize, frame.height as usize];
    let [cw, ch] = [w.min(CUT[0] as usize), h.min(CUT[1] as usize)];
    // Sums over everything above and to the left.
    let mut sums = vec![0.0f64; (w + 1) * (h + 1)];
    for y in 0..h {
        for x in 0..w {
            let at = |x: usize, y: usize| y * (w + 1) + x;
            sums[at(x + 1, y + 1)] =
                f64::from(flip[y * w + x]) + sums[at(x, y + 1)] + sums[at(x + 1, y)] - sums[at(x, y)];
        }
    }
    let sum = |x: usize, y: usize| {
        let at = |x: usize, y: usize| sums[y * (w + 1) + x];
        at(x + cw, y + ch) - at(x, y + ch) - at(x + cw, y) + at(x, y)
    };
    let places = (0..=h - ch).step_by(8).flat_map(|y| (0..=w - cw).step_by(8).map(move |x| (x, y)));
    let (x, y) = places.max_by(|&a, &b| sum(a.0, a.1).total_cmp(&sum(b.0, b.1))).unwrap_or_default();
    let mean = sums[sums.len() - 1] / (w * h) as f64;
    (flip.iter().map(|&v| heat(v)).collect(), [x as u32, y as u32], mean)
}

fn cut_out(color: &[[u8; 4]], [w, h]: [u32; 2], [x, y]: [u32; 2]) -> Frame {
    let (width, height) = (w.min(CUT[0]), h.min(CUT[1]));
    let rows = (y..y + height).flat_map(|y| &color[(y * w + x) as usize..(y * w + x + width) as usize]);
    let color = rows.copied().collect();
    Frame { width, height, color, depth: Vec::new(), voxel: Vec::new(), stats: crate::Stats::default() }
}

/// 0 black, over violet and orange, 1 pale yellow.
fn heat(v: f32) -> [u8; 4] {
    const STOPS: [[f32; 3]; 5] =
        [[0.0, 0.0, 8.0], [82.0, 20.0, 124.0], [182.0, 55.0, 122.0], [251.0, 136.0, 97.0], [252.0, 253.0, 191.0]];
    let at = v.clamp(0.0, 1.0) * (STOPS.len() - 1) as f32;
    let i = (at as usize).min(STOPS.len() - 2);
    let c = |k: usize| (STOPS[i][k] + (STOPS[i + 1][k] - STOPS[i][k]) * (at - i as f32) + 0.5) as u8;
    [c(0), c(1), c(2), 255]
}

/// Which configurations no other beats on both time and FLIP, among those of one kind.
pub fn front<'r>(rows: &'r [Row], gpu: bool) -> Vec<&'r Row> {
    let of_kind = |r: &&Row| r.config.candidate && matches!(r.config.backend, Backend::Gpu(_)) == gpu;
    let candidates: Vec<&'r Row> = rows.iter().filter(of_kind).collect();
    let points: Vec<[f64; 2]> = candidates.iter().map(|r| [r.total(), r.flip()]).collect();
    pareto(&points).into_iter().map(|i| candidates[i]).collect()
}

fn page(
    plan: &Plan<'_>,
    rows: &[Row],
    sources: &[(Source, &Row, &Row)],
    subject: &Subject<'_>,
    plots: &[Plot],
    pictures: &[Triple],
    thumbnail: &[u8],
) -> String {
    let mut page = Page::new("planecast: error against time");
    let [w, h] = plan.size;
    let [nx, ny, nz] = subject.dims;
    page.paragraph(&result(plan, rows));
    if !thumbnail.is_empty() {
        page.pictures(&[(thumbnail, "the first pose, as render draws it without flags")]);
    }
    page.paragraph(&format!(
        "{}, {nx} × {ny} × {nz} voxels, content {}. {w} × {h} pixels, {} poses, {} configurations, {} timed rounds in turn \
         after a frame that is not counted. All figures on this page were measured on the machine named here.",
        subject.scene,
        subject.content,
        plan.poses.len(),
        rows.len(),
        plan.rounds
    ));
    page.paragraph(&subject.machine.to_string());
    page.code(&subject.machine.command);
    if let Some(choice) = subject.choice {
        page.heading(2, "The choice that was asked for");
        page.code(choice);
    }
    page.heading(2, "Error against time");
    for Plot { name, caption, svg } in plots {
        match *name {
            "stages" => page.heading(2, "Time by stage"),
            "sources" => page.heading(2, "Error by source"),
            "planes" => page.heading(2, "Planes"),
            _ => {}
        }
        page.svg(svg, caption);
        match *name {
            "error-time" => front_table(&mut page, rows),
            "sources" => source_table(&mut page, sources),
            _ => {}
        }
    }
    page.heading(2, "Worst places");
    for triple in pictures {
        page.heading(3, &triple.title);
        let captions = ["rendered", "truth", "difference (FLIP: black 0, yellow 1)"];
        let parts: Vec<(&[u8], &str)> = triple.files.iter().map(|f| &*f.bytes).zip(captions).collect();
        page.pictures(&parts);
    }
    levels_table(&mut page, rows);
    page.heading(2, "All configurations");
    config_table(&mut page, rows);
    pose_table(&mut page, plan, rows);
    page.heading(2, "What the figures mean");
    page.list([
        format!(
            "Truth: one f64 ray a pixel at level 0 for voxels and depth; for colour {} such rays a pixel, each picture \
             shaded, averaged in linear light. The exact renderer with one ray a pixel has an error of colour too: that of \
             aliasing.",
            SUPERSAMPLING * SUPERSAMPLING
        ),
        "Another voxel: pixels that show neither the truth's voxel nor a coarser one that holds it; near: nor that of one of \
         the eight pixels around. Level 0: the truth's voxel itself."
            .into(),
        "Depth: where neither shows sky, in voxels; median, 99th percentile and greatest of a picture, mean over the poses \
         (greatest: over all)."
            .into(),
        "SSIM: of luma, Gaussian window of 11 × 11 pixels (Wang et al. 2004). FLIP: mean, at 67 pixels a degree (Andersson \
         et al. 2020); of one ray: against the exact renderer with one ray a pixel, which leaves out aliasing. PSNR: of the mean squared error over all poses."
            .into(),
        "Time: mean over the poses of a frame without voxel output; median, least and greatest of the rounds. Configurations \
         take turns at each pose of each round."
            .into(),
        "Resolution: drawn smaller and enlarged by repetition of pixels, which is not timed.".into(),
    ]);
    page.heading(2, "Poses");
    page.table(&Table {
        caption: String::new(),
        head: ["pose", "eye", "yaw", "pitch", "roll", "field of view"].map(String::from).to_vec(),
        rows: (plan.poses.iter())
            .map(|p| {
                let pose = &p.pose;
                let eye = pose.eye.to_array().map(|v| format!("{v:.2}")).join(", ");
                let angles = [pose.yaw, pose.pitch, pose.roll, pose.fov].map(|v| v.to_string());
                TableRow::new([p.name.clone(), eye].into_iter().chain(angles))
            })
            .collect(),
    });
    page.finish()
}

/// The result in a sentence: what the usual settings take and how far they are off, and how much of that is their levels'.
fn result(plan: &Plan<'_>, rows: &[Row]) -> String {
    let find = |name: &str| rows.iter().find(|r| r.config.name == name);
    let Some(usual) = find("default") else { return "The usual settings were not measured.".into() };
    let [w, h] = plan.size;
    let [least, _, most] = usual.over_poses(|e| e.errors.other);
    let time = usual.time_over_poses().map_or(String::new(), |[a, b, c]| {
        format!("takes {b:.1} ms on the CPU (median pose; {a:.1} to {c:.1} ms) and ")
    });
    let mut text = format!(
        "With its usual settings a frame of {w} × {h} pixels {time}shows another voxel than exact rays do in {:.3} % of the \
         pixels ({least:.3} to {most:.3} % by pose)",
        usual.other()
    );
    match find("lod off") {
        Some(exact) => {
            text += &format!(
                ", and with --lod off in {:.3} %: the rest are coarser levels far away. Its colours are off by a FLIP of {:.4}, of \
                 which {:.4} are the method's and the rest the levels'.",
                exact.other(),
                usual.flip(),
                exact.flip().min(usual.flip())
            )
        }
        None => text += &format!("; its colours are off by a FLIP of {:.4}.", usual.flip()),
    }
    text
}

/// The first pose with the usual settings, as a small PNG; empty where these were not measured.
fn thumbnail(plan: &Plan<'_>, rows: &[Row], draw: &mut dyn Draw) -> Result<Vec<u8>> {
    let (Some(usual), Some(pose)) = (rows.iter().find(|r| r.config.name == "default"), plan.poses.first()) else {
        return Ok(Vec::new());
    };
    let frame = plan.picture(draw, &usual.config, pose)?;
    let mut bytes = Vec::new();
    output::png(&mut bytes, &frame).map_err(|e| Error::Limit(format!("a picture of the report: {e}")))?;
    Ok(bytes)
}

/// Least, median and greatest.
fn spread([least, median, most]: [f64; 3], decimals: usize) -> String {
    format!("{least:.decimals$} / {median:.decimals$} / {most:.decimals$}")
}

/// Configurations beside themselves without levels of detail: what error is the levels', what the method's.
fn levels_table(page: &mut Page, rows: &[Row]) {
    let without = |r: &Row| {
        let options = Options { lod: None, ..r.config.options };
        let same = |o: &&Row| {
            let (a, b) = (&o.config, &r.config);
            a.options == options && (a.backend, a.scale, a.rule) == (b.backend, b.scale, b.rule)
        };
        rows.iter().find(same)
    };
    let pairs: Vec<(&Row, &Row)> =
        rows.iter().filter(|r| r.config.options.lod.is_some()).filter_map(|r| Some((r, without(r)?))).collect();
    if pairs.is_empty() {
        return;
    }
    page.heading(2, "Levels of detail, and the method");
    page.table(&Table {
        caption: "The method's error is that of the same settings at level 0 everywhere; the rest comes from coarser levels. \
                  Means over the poses, and least / median / greatest by pose."
            .into(),
        head: ["configuration", "FLIP of one ray", "of the method", "of levels", "method by pose", "level 0 %", "of the method", "of levels"]
            .map(String::from)
            .to_vec(),
        rows: (pairs.iter())
            .map(|(with, without)| {
                let level0 = |r: &Row| r.mean(|e| e.errors.other_level0);
                TableRow::new([
                    with.config.name.clone(),
                    format!("{:.4}", with.flip()),
                    format!("{:.4}", without.flip()),
                    format!("{:+.4}", with.flip() - without.flip()),
                    spread(without.over_poses(|e| e.errors.flip_exact), 4),
                    format!("{:.2}", level0(with)),
                    format!("{:.2}", level0(without)),
                    format!("{:+.2}", level0(with) - level0(without)),
                ])
            })
            .collect(),
    });
}

fn ms(t: Option<[f64; 3]>) -> String {
    t.map_or("–".into(), |[lo, mid, hi]| format!("{mid:.2} ({lo:.2}–{hi:.2})"))
}

fn front_table(page: &mut Page, rows: &[Row]) {
    for gpu in [false, true] {
        let front = front(rows, gpu);
        if front.is_empty() {
            continue;
        }
        let device = if gpu { "GPU" } else { "CPU" };
        page.table(&Table {
            caption: format!("The Pareto front on the {device}: nothing measured is faster with a smaller FLIP against one exact ray a pixel."),
            head: ["configuration", "ms", "FLIP of one ray", "another voxel %", "near %", "flags"].map(String::from).to_vec(),
            rows: (front.iter())
                .map(|r| {
                    let flags = [Some(r.config.flags()), r.config.beside_flags()];
                    TableRow::new([
                        r.config.name.clone(),
                        ms(r.time(|t| t.total)),
                        format!("{:.4}", r.flip()),
                        format!("{:.3}", r.other()),
                        format!("{:.3}", r.mean(|e| e.errors.other_near)),
                        flags.into_iter().flatten().collect::<Vec<_>>().join("; "),
                    ])
                })
                .collect(),
        });
    }
    let presets = Preset::ALL.into_iter().filter_map(|preset| {
        let same = |r: &&Row| {
            let (c, o) = (&r.config, r.config.options);
            c.candidate && c.scale == 1.0 && c.rule.is_none() && preset.options(o) == o && is_usual_else(&o)
        };
        let row = rows.iter().filter(same).find(|r| r.config.backend == Backend::Cpu)?;
        Some(TableRow::new([
            preset.name().to_owned(),
            row.config.name.clone(),
            ms(row.time(|t| t.total)),
            format!("{:.4}", row.flip()),
            format!("{:.3}", row.other()),
        ]))
    });
    page.table(&Table {
        caption: "Presets of render and fly".into(),
        head: ["--preset", "configuration", "ms on the CPU", "FLIP of one ray", "another voxel %"]
            .map(String::from)
            .to_vec(),
        rows: presets.collect(),
    });
}

/// Whether nothing is unusual but what a preset sets.
fn is_usual_else(options: &Options) -> bool {
    let usual = Options::default();
    let rest = Options { planes: usual.planes, lod: usual.lod, remap: usual.remap, ..*options };
    rest == Options { view_distance: options.view_distance, repeat: options.repeat, fog: options.fog, ..usual }
}

fn source_table(page: &mut Page, sources: &[(Source, &Row, &Row)]) {
    page.table(&Table {
        caption: "What each source adds alone (everything else: four planes a pixel, level 0, f64, tested against the pixel's \
                  own ray), mean over the poses; and the time that it saves."
            .into(),
        head: ["source", "another voxel, points", "near, points", "FLIP of one ray", "depth p99, voxels", "saves ms", "saves %"]
            .map(String::from)
            .to_vec(),
        rows: (sources.iter())
            .map(|(s, without, with)| {
                let d = Difference::new(without, with);
                let saved = |v: Option<f64>| v.map_or("–".into(), |v| format!("{v:.1}"));
                TableRow::new([
                    s.name.to_owned(),
                    format!("{:+.4}", d.other),
                    format!("{:+.4}", d.other_near),
                    format!("{:+.5}", d.flip),
                    format!("{:+.3}", d.depth),
                    saved(d.saved),
                    saved(d.saved_percent),
                ])
            })
            .collect(),
    });
}

fn config_table(page: &mut Page, rows: &[Row]) {
    let head = [
        "configuration",
        "ms (rounds)",
        "ms by pose",
        "another voxel %",
        "by pose",
        "near %",
        "level 0 %",
        "coarser %",
        "sky %",
        "depth median",
        "p99",
        "max",
        "relative p99",
        "PSNR dB",
        "SSIM",
        "FLIP",
        "of one ray",
        "by pose",
        "holes",
        "left",
        "planes",
        "columns",
        "runs",
        "spans",
    ];
    let fronts: Vec<String> =
        [false, true].into_iter().flat_map(|gpu| front(rows, gpu)).map(|r| r.config.name.clone()).collect();
    let row = |r: &Row| {
        let mean = |f: &dyn Fn(&Errors) -> f64| r.mean(|e| f(&e.errors));
        let cells = [
            r.config.name.clone(),
            ms(r.time(|t| t.total)),
            r.time_over_poses().map_or("–".into(), |t| spread(t, 1)),
            format!("{:.3}", r.other()),
            spread(r.over_poses(|e| e.errors.other), 3),
            format!("{:.3}", mean(&|e| e.other_near)),
            format!("{:.2}", mean(&|e| e.other_level0)),
            format!("{:.2}", mean(&|e| e.coarser)),
            format!("{:.3}", mean(&|e| e.sky)),
            format!("{:.4}", mean(&|e| e.depth[0])),
            format!("{:.3}", mean(&|e| e.depth[1])),
            format!("{:.1}", r.worst(|e| e.errors.depth[2]).1),
            format!("{:.5}", mean(&|e| e.depth_relative[1])),
            format!("{:.2}", r.psnr()),
            format!("{:.4}", mean(&|e| e.ssim)),
            format!("{:.4}", mean(&|e| e.flip)),
            format!("{:.4}", r.flip()),
            spread(r.over_poses(|e| e.errors.flip_exact), 4),
            format!("{:.0}", r.mean(|e| e.holes[0] as f64)),
            format!("{:.0}", r.mean(|e| e.holes[1] as f64)),
            format!("{:.0}", r.mean(|e| f64::from(e.planes))),
            format!("{:.0}", r.mean(|e| e.columns_visited as f64)),
            format!("{:.0}", r.mean(|e| e.runs_visited as f64)),
            format!("{:.0}", r.mean(|e| e.spans_drawn as f64)),
        ];
        TableRow::marked(if fronts.contains(&r.config.name) { Mark::Strong } else { Mark::Plain }, cells)
    };
    page.table(&Table {
        caption: "Means over the poses, and least / median / greatest by pose; the Pareto front of FLIP of one ray against time is green.".into(),
        head: head.map(String::from).to_vec(),
        rows: rows.iter().map(row).collect(),
    });
}

fn pose_table(page: &mut Page, plan: &Plan<'_>, rows: &[Row]) {
    let Some(usual) = rows.iter().find(|r| r.config.name == "default") else { return };
    let find = |name: &str| rows.iter().find(|r| r.config.name == name);
    let shown: Vec<&Row> =
        [Some(usual), find("lod off"), find("remap nearest"), find("planes 50 %")].into_iter().flatten().collect();
    let mut head = vec!["pose".to_owned()];
    head.extend(shown.iter().flat_map(|r| [format!("{}: another voxel %", r.config.name), "FLIP of one ray".into()]));
    page.table(&Table {
        caption: "Some configurations pose by pose (all of them: report.csv)".into(),
        head,
        rows: (plan.poses.iter().enumerate())
            .map(|(p, pose)| {
                let figures = shown.iter().flat_map(|r| {
                    let e = &r.errors[p].errors;
                    [format!("{:.3}", e.other), format!("{:.4}", e.flip_exact)]
                });
                TableRow::new([pose.name.clone()].into_iter().chain(figures))
            })
            .collect(),
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heat_goes_from_dark_to_light() {
        let sum = |v: f32| heat(v)[..3].iter().map(|&c| u32::from(c)).sum::<u32>();
        assert!((0..20).all(|i| sum(i as f32 / 20.0) < sum((i + 1) as f32 / 20.0)));
    }
}
