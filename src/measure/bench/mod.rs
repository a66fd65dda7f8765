//! `planecast bench`: the papers' tables measured here, beside the papers' own figures.
//!
//! A run leaves a folder: `bench.csv` and `bench.json` with every row, measured or quoted; `plots/*.svg`; `pictures/*.png` of the
//! scenes; `bench.html`, one page with all of it; `journal.jsonl`, what is measured so far, from which a run that was stopped
//! goes on; and `scenes/`, encoded scenes, which may be deleted.
//!
//! | part | scenes and views |
//! |---|---|
//! | `table1` | Forstmann & Ohya 2009, Table 1: all rows, what its letters mean here is in [`paper`] |
//! | `landscape`, `mixing` | its other scenes |
//! | `down` | straight down with and without readjusted planes |
//! | `shading` | screen-space normals and ambient occlusion |
//! | `ieice` | Forstmann & Ohya 2010, Table 1: elements met, drawn, a second |
//! | `speedup` | GPU against CPU, kernels against each other |
//! | `scaling` | time over planes, pixels, view distance, scene size, threads |

mod journal;
pub mod measure;
pub mod paper;
pub mod parts;
mod present;
pub mod row;
pub mod scenes;

#[cfg(not(feature = "gpu"))]
use crate::Error;
use crate::{Camera, CpuRenderer, Options, Outputs, Result, Shading, output};
use journal::Journal;
use measure::{Config, Pools, measure};
use parts::{Extent, Machine, Part};
use planecast_encoder::Error as FileError;
use present::Results;
use scenes::{Key, Loaded, Name, Scenes, View};
use std::collections::hash_map::Entry;
use std::collections::{BTreeMap, HashMap};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// What draws beside the CPU.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Device {
    /// The GPU, too, where there is a real one
    Auto,
    /// The GPU, too, even one that a processor plays; an error where there is none
    Gpu,
    /// Nothing
    Cpu,
}

/// What to measure, and where to leave it.
#[derive(Clone, Debug)]
pub struct Settings {
    pub output: PathBuf,
    pub parts: Vec<Part>,
    pub device: Device,
    pub extent: Extent,
    /// Files to take in place of procedural scenes.
    pub files: BTreeMap<Name, PathBuf>,
}

/// Pixels of the pictures that show the scenes.
const PICTURE: [u32; 2] = [480, 360];

/// Measures what the folder's journal does not have yet, then writes all files anew. `tell` hears of the progress.
pub fn run(settings: &Settings, tell: &mut dyn FnMut(&str)) -> Result<()> {
    let folder = |name: &str| -> Result<PathBuf> {
        let path = settings.output.join(name);
        std::fs::create_dir_all(&path).map_err(|e| FileError::io(&path, "create the folder", e))?;
        Ok(path)
    };
    let (plots, pictures) = (folder("plots")?, folder("pictures")?);
    let start = Instant::now();
    let mut say = |what: &str| tell(&format!("{:6.1} s  {what}", start.elapsed().as_secs_f64()));

    let threads = std::thread::available_parallelism().map_or(1, |n| n.get());
    let gpu = adapter(settings.device)?;
    say(match &gpu {
        Ok(name) => format!("measuring the cpu and the gpu: {name}"),
        Err(why) => format!("measuring the cpu alone: {why}"),
    }
    .as_str());
    let machine = Machine { threads, gpu: gpu.is_ok() };
    let gpu = gpu.unwrap_or_else(|why| format!("not measured: {why}"));
    let about = [
        ("processor".to_owned(), format!("{}, {threads} threads", processor())),
        ("graphics".to_owned(), gpu),
        ("planecast".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
        ("system".to_owned(), format!("{} {}", std::env::consts::OS, std::env::consts::ARCH)),
        ("extent".to_owned(), settings.extent.name()),
    ];
    let head = serde_json::json!({ "about": about, "files": settings.files });
    let mut journal = Journal::open(&settings.output.join("journal.jsonl"), &head)?;

    let scenes = Scenes { folder: settings.output.join("scenes"), files: settings.files.clone() };
    let rounds = |engine| match engine {
        measure::Engine::Cpu { .. } | measure::Engine::Rays { .. } | measure::Engine::Exact { .. } => {
            settings.extent.cpu
        }
        #[cfg(feature = "gpu")]
        measure::Engine::Gpu(_) => settings.extent.gpu,
    };
    let mut pools = Pools::default();
    let mut loaded: HashMap<Key, Loaded> = HashMap::new();
    let mut todo: Vec<parts::Group> =
        settings.parts.iter().flat_map(|&p| parts::groups(p, &settings.extent, &machine)).collect();
    let n_groups = todo.len();
    todo.retain(|g| {
        let done = g.configs.iter().all(|c| journal.get(&c.key()).is_some());
        !done || g.configs.iter().any(|c| missing_picture(&pictures, c).is_some())
    });
    if todo.len() < n_groups {
        say(&format!("{} of {n_groups} groups were measured before", n_groups - todo.len()));
    }
    let n_todo = todo.len();
    for (i, group) in todo.into_iter().enumerate() {
        say(&format!("{} of {n_todo}: {}, {} lines", i + 1, group.title, group.configs.len()));
        loaded.retain(|key, _| group.configs.iter().any(|c| c.scene == *key));
        for config in &group.configs {
            if let Entry::Vacant(place) = loaded.entry(config.scene) {
                place.insert(scenes.load(&config.scene)?);
            }
        }
        if group.configs.iter().any(|c| journal.get(&c.key()).is_none()) {
            journal.add(measure(&scenes, &loaded, &group.configs, rounds, &mut pools)?)?;
        }
        for config in &group.configs {
            if let Some(path) = missing_picture(&pictures, config) {
                picture(&path, &loaded[&config.scene], config)?;
            }
        }
    }

    // All that this folder has, parts of earlier runs with it.
    let mut rows = BTreeMap::new();
    let mut shown = Vec::new();
    for config in Part::ALL.iter().flat_map(|&p| parts::groups(p, &settings.extent, &machine)).flat_map(|g| g.configs) {
        if let Some(row) = journal.get(&config.key()) {
            rows.insert(row.key.clone(), row.clone());
            let path = pictures.join(picture_name(&config));
            let known = shown.iter().any(|(known, _)| *known == path);
            if !known && path.exists() {
                shown.push((path, format!("{}: {}", row.scene, config.view.name())));
            }
        }
    }
    let pictures = shown.into_iter().map(|(path, text)| {
        let bytes = std::fs::read(&path).map_err(|e| FileError::io(&path, "read", e))?;
        Ok((bytes, text))
    });
    let pictures = pictures.collect::<Result<Vec<_>>>()?;
    let results = Results {
        extent: &settings.extent,
        machine: &machine,
        rows: &rows,
        about: &about,
        files: &settings.files,
        pictures: &pictures,
    };
    write_all(settings, &results, &plots)?;
    say(&format!("{} rows in {}", rows.len(), settings.output.join("bench.html").display()));
    Ok(())
}

fn write_all(settings: &Settings, results: &Results<'_>, plots: &Path) -> Result<()> {
    let all = results.all_rows();
    let svgs = results.plots();
    let mut files = Vec::new();
    for (name, svg) in &svgs {
        files.push(output::write(&plots.join(name), |out| out.write_all(svg.as_bytes()))?);
    }
    files.push(output::write(&settings.output.join("bench.csv"), |out| {
        let mut csv = csv::Writer::from_writer(out);
        all.iter().try_for_each(|row| csv.serialize(row)).map_err(io::Error::other)?;
        csv.flush()
    })?);
    let json = serde_json::json!({ "about": results.about, "rows": all });
    files.push(output::write(&settings.output.join("bench.json"), |out| output::json(out, &json))?);
    let page = results.page(&svgs);
    files.push(output::write(&settings.output.join("bench.html"), |out| out.write_all(page.as_bytes()))?);
    files.into_iter().try_for_each(|f| f.finish())?;
    Ok(())
}

fn picture_name(config: &Config) -> String {
    let view: String = config.view.name().chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).collect();
    format!("{}-{view}.png", config.scene.name.text())
}

/// Where the picture of a configuration's scene and view belongs, if it is not there yet. Views that are measured for another
/// reason than to be looked at have none.
fn missing_picture(folder: &Path, config: &Config) -> Option<PathBuf> {
    let path = folder.join(picture_name(config));
    (config.view != View::Pitches && !path.exists()).then_some(path)
}

/// Draws a scene as a configuration sees it, small and shaded.
fn picture(path: &Path, loaded: &Loaded, config: &Config) -> Result<()> {
    let camera: Camera = config.view.cameras(loaded, PICTURE)[0];
    let view_distance = config.view.distance(loaded, PICTURE).unwrap_or(config.options.view_distance);
    let options =
        Options { view_distance, repeat: config.options.repeat, shading: Shading::Full, ..Options::default() };
    let frame = CpuRenderer::new(&loaded.scene, &loaded.resident).render(&camera, &options, Outputs::default())?;
    Ok(output::write(path, |out| output::png(out, &frame))?.finish()?)
}

/// The adapter's name, or why none is measured; an error where one was asked for and there is none.
#[cfg(feature = "gpu")]
fn adapter(device: Device) -> Result<Result<String, String>> {
    use crate::{GpuOptions, GpuRenderer, Resident};
    use planecast_encoder::{BuildOptions, Colors, Columns, Input, build};
    use std::sync::Arc;
    if device == Device::Cpu {
        return Ok(Err("--device cpu".into()));
    }
    let input = Input { columns: Columns::empty(1, 1, 1), colors: Colors::None, notes: Vec::new() };
    let scene = Arc::new(build(input, &BuildOptions::default())?);
    let resident = Arc::new(Resident::new(&scene));
    let opened = GpuRenderer::new(&scene, &resident, GpuOptions::default());
    match (opened, device) {
        (Err(e), Device::Gpu) => Err(e),
        (Err(e), _) => Ok(Err(e.to_string())),
        (Ok(gpu), Device::Auto) if gpu.is_software() => {
            Ok(Err(format!("the only adapter is software ({}); --device gpu measures it all the same", gpu.device().0)))
        }
        (Ok(gpu), _) => Ok(Ok(format!("{} ({})", gpu.device().0, gpu.device().1))),
    }
}

#[cfg(not(feature = "gpu"))]
fn adapter(device: Device) -> Result<Result<String, String>> {
    let why = "this planecast was built without the feature gpu";
    match device {
        Device::Gpu => Err(Error::Device(format!("{why}; use --device cpu"))),
        _ => Ok(Err(why.into())),
    }
}

/// The processor's name, as far as the system tells it.
fn processor() -> String {
    let told = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name =
        told.lines().find_map(|line| line.strip_prefix("model name")?.split_once(": ").map(|(_, name)| name.trim()));
    name.unwrap_or("unnamed").to_owned()
}

/// `NAME=FILE` as a scene and the file to take for it.
pub fn scene_file(s: &str) -> Result<(Name, PathBuf), String> {
    use clap::ValueEnum;
    let names = || Name::ALL.map(Name::text).join(", ");
    let wrong = || format!("expected NAME=FILE, NAME one of {}", names());
    let (name, file) = s.split_once('=').filter(|(_, file)| !file.is_empty()).ok_or_else(wrong)?;
    Ok((Name::from_str(name, false).map_err(|_| wrong())?, file.into()))
}
