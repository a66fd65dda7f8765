//! Commands on scene files, shared by `planecast` and `planecast-encode`.

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, Once, Weak};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};
use xxhash_rust::xxh3::xxh3_64;

use crate::encode::memory;
use crate::encode::open::{self, Opened};
use crate::encode::{self, EncodeOptions, Summary, Watch};
use crate::format::sheets::{Manifest, Sheet, Sheets, is_manifest};
use crate::format::write::{keep_input, resolved};
use crate::inspect::decode::decode_to_raw;
use crate::inspect::info;
use crate::inspect::verify;
use crate::inspect::verify::Depth;
use crate::model::pieces::{Grey, Pieces, named};
use crate::source::{self, ReadOptions, tiles};
use crate::store::guard;
use crate::store::remote::{self, Here, Output};
use crate::{BuildOptions, ColorMode, Encoding, Error, Features, MipRule, PcastFile, Result, Scene, format, say};

/// Exit status where the input, the scene or the machine was at fault.
pub const EXIT_INPUT: u8 = 1;
/// Exit status where the command line was (clap's own, too).
pub const EXIT_USAGE: u8 = 2;

/// The exit status that an error stands for.
pub fn exit_status(error: &Error) -> u8 {
    match error {
        Error::Argument(_) => EXIT_USAGE,
        _ => EXIT_INPUT,
    }
}

/// Make a scene of a volume, height map, voxel map or model, or of a seeded function
#[derive(Clone, Debug, clap::Args)]
pub struct EncodeArgs {
    /// Input file, or a name such as procedural:terrain?size=512&seed=7
    pub input: PathBuf,
    /// Scene to write
    #[arg(short, long, value_name = "SCENE.pcast", required_unless_present = "plan")]
    pub output: Option<PathBuf>,
    #[command(flatten)]
    pub read: ReadOptions,
    /// What the runs hold
    #[arg(long, value_enum, default_value = "solid")]
    pub encoding: Encoding,
    /// How finely the scene is coloured [default: voxel if the input has colours, else none]
    #[arg(long, value_enum)]
    pub color: Option<ColorMode>,
    /// When a voxel of a coarser level is solid
    #[arg(long, value_enum, default_value = "any")]
    pub mip_rule: MipRule,
    /// Bytes of memory to stay within, as in 512M or 4G [default: a quarter of what is free]
    #[arg(long, value_name = "SIZE", value_parser = memory::parse)]
    pub memory: Option<u64>,
    /// Go on with what a stopped encode of the same input left
    #[arg(long)]
    pub resume: bool,
    /// Encode these tiles of level 0 alone (256 x 256 columns each, x first), to a part that `merge` joins with others
    #[arg(long, value_name = "A..B", value_parser = tile_range)]
    pub tiles: Option<TileRange>,
    /// Compress tiles with zstd, at this level; such a scene is read more slowly
    #[arg(long, value_name = "LEVEL", value_parser = clap::value_parser!(i32).range(1..=19))]
    pub zstd: Option<i32>,
    /// What tiles may leave out that they do not need: auto (whatever it is), off, or some of heights, lists, tables, colors, packed
    #[arg(long, value_name = "off|FEATURE,...", default_value_t)]
    pub specialize: Features,
    /// Say all that is known of how the input was read
    #[arg(long)]
    pub explain: bool,
    /// Only print what there is to do, as JSON: size, and number of tiles of level 0; no scene is written
    #[arg(long)]
    pub plan: bool,
    /// Threads to encode with [default: one a core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
}

/// Tiles `0 .. 1`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TileRange(u64, u64);

fn tile_range(s: &str) -> Result<TileRange, String> {
    let range = s.split_once("..").and_then(|(a, b)| Some(TileRange(a.trim().parse().ok()?, b.trim().parse().ok()?)));
    range.filter(|r| r.0 < r.1).ok_or_else(|| "expected two numbers that ascend, as in 0..64".to_owned())
}

impl EncodeArgs {
    pub fn run(&self) -> Result<()> {
        let Some(output) = self.output.as_ref().filter(|_| !self.plan) else {
            return in_pool(self.threads, || self.print_plan());
        };
        for input in [Some(&self.input), self.read.colors.as_ref()].into_iter().flatten() {
            keep_input(input, "--output", output)?;
        }
        in_pool(self.threads, || self.encode(output))
    }

    fn print_plan(&self) -> Result<()> {
        #[derive(serde::Serialize)]
        struct Plan {
            dims: [u32; 3],
            tiles: u64,
        }
        let dims = source::open_pieces(&self.input, &self.read)?.dims();
        print(&json(&Plan { dims, tiles: format::grids(dims)[0].n_tiles() }))
    }

    fn encode(&self, output: &Path) -> Result<()> {
        let begun = Instant::now();
        let output = Output::new(output)?;
        let mut world = source::open_pieces(&self.input, &self.read)?;
        tell_of(&*world, self.explain);
        world = named(world, &self.input);
        if !world.colored() && matches!(self.color, Some(ColorMode::Run | ColorMode::Voxel)) {
            crate::note!("note: the input has no colours: all voxels are grey");
            world = Box::new(Grey(world));
        }
        let opts = EncodeOptions {
            build: BuildOptions { encoding: self.encoding, color: self.color, mip_rule: self.mip_rule },
            features: self.specialize,
            memory: self.memory,
            resume: self.resume,
            compress: self.zstd,
            settings: self.settings(&*world),
            source: self.source()?,
        };
        let bytes = world.input_bytes();
        let summary = watched(bytes, |watch| match self.tiles {
            None => encode::encode(&*world, &opts, output.file(), watch),
            Some(TileRange(from, to)) => encode::encode_part(&*world, &opts, from..to, output.file(), watch),
        })?;
        let made = Made::new(self.output.as_deref(), output.file());
        output.finish()?;
        report(made, &summary, if self.tiles.is_some() { 0 } else { bytes }, begun);
        Ok(())
    }

    /// Of all that the scene depends on, as far as it is the same on every machine.
    fn settings(&self, world: &dyn Pieces) -> u64 {
        let mut read = self.read.clone();
        read.colors = read.colors.and_then(|path| Some(PathBuf::from(path.file_name()?)));
        let name = self.input.to_str().filter(|name| name.starts_with("procedural:"));
        let build = (self.encoding, self.color, self.mip_rule);
        xxh3_64(format!("{read:?} {name:?} {build:?} {:?} {}", world.dims(), world.input_bytes()).as_bytes())
    }

    /// Of the input's files as they lie here.
    fn source(&self) -> Result<u64> {
        let state = |path: &PathBuf| {
            if remote::is_url(path) {
                return remote::state(path).map(|state| format!("{path:?} {state}"));
            }
            let meta = std::fs::metadata(path).ok();
            let time = meta.as_ref().and_then(|m| m.modified().ok());
            Ok(format!("{:?}", (resolved(path), meta.map(|m| m.len()), time)))
        };
        let colors = self.read.colors.as_ref().map(state).transpose()?;
        Ok(xxh3_64(format!("{} {colors:?}", state(&self.input)?).as_bytes()))
    }
}

/// How an input was read, in a line or two; with `explain`, and of readers that do not say it, all that is known.
fn tell_of(world: &dyn Pieces, explain: bool) {
    let about = world.about();
    let known = !about.format.is_empty();
    if known {
        crate::note!("{about}");
    }
    if explain || !known {
        world.notes().iter().for_each(|note| crate::note!("note: {note}"));
    }
}

/// The options of [`ReadOptions`], for a command that has others, too: one whose name the command has taken already is called
/// `--input-…`. To be flattened behind all others.
#[derive(Clone, Debug, Default)]
pub struct InputArgs {
    pub read: ReadOptions,
    /// What was typed: each flag as [`ReadOptions`] calls it, with its values, for a command line that reads the same.
    pub words: Vec<Vec<String>>,
}

impl InputArgs {
    const HEADING: &str = "Reading an input that is no scene";

    fn own() -> clap::Command {
        <ReadOptions as clap::Args>::augment_args(clap::Command::new("input"))
    }

    /// Ids of the stand-in for an option: where its name is free, and where it is taken. A command is made once, and ids are
    /// to live as long as it.
    fn ids(long: &str) -> [&'static str; 2] {
        [format!("input option {long}"), format!("input-{long}")].map(|id| &*id.leak())
    }

    /// [`InputArgs::words`] with the names that they have in `command`, which takes these options, too.
    pub fn words_of(command: &clap::Command, words: &[Vec<String>]) -> Vec<Vec<String>> {
        let is_taken = |long: &str| {
            let stand_in = InputArgs::ids(long)[1];
            command.get_arguments().any(|arg| arg.get_id().as_str() == stand_in)
        };
        let named = |words: &Vec<String>| {
            let mut words = words.clone();
            let long = words[0].strip_prefix("--").unwrap_or_default();
            let long = long.split('=').next().unwrap_or_default();
            if is_taken(long) {
                words[0].insert_str(2, "input-");
            }
            words
        };
        words.iter().map(named).collect()
    }
}

impl clap::Args for InputArgs {
    fn augment_args(mut cmd: clap::Command) -> clap::Command {
        for arg in InputArgs::own().get_arguments() {
            let Some(long) = arg.get_long() else { continue };
            let taken = cmd.get_arguments().any(|a| a.get_long() == Some(long));
            let id = InputArgs::ids(long)[usize::from(taken)];
            let mut stand_in = clap::Arg::new(id)
                .long(if taken { id } else { long.to_owned().leak() })
                .action(arg.get_action().clone())
                .help_heading(InputArgs::HEADING);
            if let Some(help) = arg.get_help() {
                stand_in = stand_in.help(help.clone());
            }
            if arg.get_action().takes_values() {
                let names =
                    arg.get_value_names().unwrap_or_default().iter().map(|name| &*name.as_str().to_owned().leak());
                stand_in = stand_in.value_names(names.collect::<Vec<&'static str>>());
                let values = arg.get_possible_values();
                stand_in = match values.is_empty() {
                    true => stand_in.value_parser(clap::builder::ValueParser::os_string()),
                    false => stand_in.value_parser(clap::builder::PossibleValuesParser::new(values)),
                };
                if let Some(n) = arg.get_num_args() {
                    stand_in = stand_in.num_args(n);
                }
            }
            cmd = cmd.arg(stand_in);
        }
        cmd
    }

    fn augment_args_for_update(cmd: clap::Command) -> clap::Command {
        InputArgs::augment_args(cmd)
    }
}

impl clap::FromArgMatches for InputArgs {
    /// Types them again, as `encode` takes them: checks and errors are the same.
    fn from_arg_matches(matches: &clap::ArgMatches) -> Result<InputArgs, clap::Error> {
        let mut own = InputArgs::own();
        let mut line = vec![std::ffi::OsString::from("input")];
        let mut typed = Vec::new();
        let args: Vec<clap::Arg> = own.get_arguments().cloned().collect();
        for arg in &args {
            let Some(long) = arg.get_long() else { continue };
            let ids = InputArgs::ids(long);
            let Some(taken) = ids.iter().position(|id| matches.try_contains_id(id).is_ok()) else { continue };
            let id = ids[taken];
            let shown = if taken == 1 { id } else { long };
            if taken == 1 {
                own = own.mut_arg(arg.get_id(), |a| a.long(id));
            }
            if matches.value_source(id) != Some(clap::parser::ValueSource::CommandLine) {
                continue;
            }
            if !arg.get_action().takes_values() {
                line.push(format!("--{shown}").into());
                typed.push(vec![format!("--{long}")]);
                continue;
            }
            for values in matches.get_raw_occurrences(id).into_iter().flatten() {
                let mut words = Vec::new();
                for (i, value) in values.enumerate() {
                    let mut word = std::ffi::OsString::new();
                    if i == 0 {
                        word.push(format!("--{shown}="));
                    }
                    word.push(value);
                    line.push(word);
                    let value = value.to_string_lossy();
                    words.push(if i == 0 { format!("--{long}={value}") } else { value.into_owned() });
                }
                typed.push(words);
            }
        }
        let found = own.disable_help_flag(true).try_get_matches_from(line)?;
        Ok(InputArgs { read: <ReadOptions as clap::FromArgMatches>::from_arg_matches(&found)?, words: typed })
    }

    fn update_from_arg_matches(&mut self, matches: &clap::ArgMatches) -> Result<(), clap::Error> {
        *self = <InputArgs as clap::FromArgMatches>::from_arg_matches(matches)?;
        Ok(())
    }
}

/// A scene, or anything else encoded as `encode` would, with a bar on the terminal and a line or two on how it was read. Of a
/// scene it says which flags were of no use: all that say how an input is read, but --ramp where `tints`.
pub fn open(name: &Path, read: &ReadOptions, tints: bool) -> Result<Opened> {
    let watch = Arc::new(Watch::default());
    let opened = with_bar(&watch, 0, || open::open(name, read, &watch, &mut |world| tell_of(world, false)))?;
    let ramp = read.ramp.clone().filter(|_| !tints);
    if !opened.encoded && (ReadOptions { ramp, ..read.clone() }).is_given() {
        crate::note!(
            "{}: is a scene already; --exaggeration, --iso and what else says how an input is read belong to encode, and change nothing here",
            name.display()
        );
    }
    Ok(opened)
}

/// Runs `work` with that many threads; None: one a core.
fn in_pool<T: Send>(threads: Option<u16>, work: impl FnOnce() -> Result<T> + Send) -> Result<T> {
    let Some(n) = threads else { return work() };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(n.into()).build();
    pool.map_err(|e| Error::Limit(format!("--threads {n}: {e}")))?.install(work)
}

/// Does work that Ctrl-C stops in good order, with a bar on the terminal that says how far it is.
fn watched<T>(input_bytes: u64, work: impl FnOnce(&Watch) -> Result<T>) -> Result<T> {
    static WATCH: Mutex<Weak<Watch>> = Mutex::new(Weak::new());
    static HANDLER: Once = Once::new();
    let watch = Arc::new(Watch::default());
    *WATCH.lock().expect("nothing panics with it") = Arc::downgrade(&watch);
    HANDLER.call_once(|| {
        let stop = || {
            let watch = WATCH.lock().expect("nothing panics with it").upgrade();
            match watch {
                Some(watch) if !watch.stop.swap(true, Ordering::Relaxed) => {}
                // A second time, at once.
                Some(_) => guard::leave(1),
                None => {
                    guard::last_word();
                    crate::say!("planecast: interrupted; what it has finished stays");
                    guard::leave(1);
                }
            }
        };
        if let Err(e) = ctrlc::set_handler(stop) {
            crate::note!("note: Ctrl-C will not be caught: {e}");
        }
    });
    with_bar(&watch, input_bytes, || work(&watch))
}

/// A bar on the terminal while work is under way.
fn with_bar<T>(watch: &Watch, input_bytes: u64, work: impl FnOnce() -> Result<T>) -> Result<T> {
    let style = "{percent:>3} % {wide_bar} {elapsed} gone, {eta} left, {msg}";
    let bar = if say::is_quiet() { ProgressBar::hidden() } else { ProgressBar::new(1) };
    let bar = bar.with_style(ProgressStyle::with_template(style).expect("a template that parses"));
    let begun = Instant::now();
    let done = AtomicBool::new(false);
    let outcome = std::thread::scope(|scope| {
        scope.spawn(|| {
            while !done.load(Ordering::Relaxed) && !bar.is_hidden() {
                if watch.total.load(Ordering::Relaxed) == 0 {
                    // Nothing is known to do yet, and there may be nothing.
                    std::thread::sleep(Duration::from_millis(20));
                    continue;
                }
                let (columns, total) = (watch.columns.load(Ordering::Relaxed), watch.total.load(Ordering::Relaxed));
                bar.set_length(total.max(1));
                bar.set_position(columns);
                let part = columns as f64 / total.max(1) as f64;
                let rate = match input_bytes {
                    0 => format!("{:.2} M columns/s", columns as f64 / begun.elapsed().as_secs_f64() / 1e6),
                    n => format!("{:.2} GB/s", n as f64 * part / begun.elapsed().as_secs_f64() / 1e9),
                };
                let runs = watch.runs.load(Ordering::Relaxed) as f64 / 1e6;
                let memory = memory::used().map(|n| format!("{} of memory, ", memory::display(n))).unwrap_or_default();
                bar.set_message(format!("{rate}, {memory}{runs:.1} M runs"));
                std::thread::sleep(Duration::from_millis(100));
            }
        });
        let outcome = work();
        done.store(true, Ordering::Relaxed);
        outcome
    });
    bar.finish_and_clear();
    outcome
}

/// A file that a command made, as a person is told of it.
pub struct Made(String);

impl Made {
    /// `name` is what was typed, `file` where it lies.
    pub fn new(name: Option<&Path>, file: &Path) -> Made {
        let name = name.unwrap_or(file).display();
        match std::fs::metadata(file) {
            Ok(m) if m.is_file() => Made(format!("{name}: {}", memory::display(m.len()))),
            // A folder of frames.
            _ => Made(format!("{name}: made")),
        }
    }
}

impl Made {
    /// Path, size and time on one line, and what else there is to say.
    pub fn tell(&self, begun: Instant, more: &str) {
        let seconds = begun.elapsed().as_secs_f64();
        crate::note!("{}, {seconds:.2} s{}{more}", self.0, if more.is_empty() { "" } else { "; " });
    }
}

fn report(made: Made, summary: &Summary, input_bytes: u64, begun: Instant) {
    let seconds = begun.elapsed().as_secs_f64();
    let mut text = format!("{} tiles, {} runs at level 0", summary.tiles, summary.runs);
    if input_bytes > 0 {
        text += &format!(", {:.2} GB/s of {}", input_bytes as f64 / seconds / 1e9, memory::display(input_bytes));
    }
    if let Some(peak) = memory::peak() {
        text += &format!(", at most {} of memory", memory::display(peak));
    }
    if summary.resumed > 0 {
        text += &format!("; {} tiles were there already", summary.resumed);
    }
    made.tell(begun, &text);
}

/// Join parts made by `encode --tiles` to the scene that one encode would give
#[derive(Clone, Debug, clap::Args)]
pub struct MergeArgs {
    /// Parts, in any order; every tile of level 0 must be in one at least
    #[arg(required = true)]
    pub parts: Vec<PathBuf>,
    /// Scene to write
    #[arg(short, long, value_name = "SCENE.pcast")]
    pub output: PathBuf,
    /// Bytes of memory to stay within, as in 512M or 4G [default: a quarter of what is free]
    #[arg(long, value_name = "SIZE", value_parser = memory::parse)]
    pub memory: Option<u64>,
    /// Compress tiles with zstd, at this level; such a scene is read more slowly
    #[arg(long, value_name = "LEVEL", value_parser = clap::value_parser!(i32).range(1..=19))]
    pub zstd: Option<i32>,
}

impl MergeArgs {
    pub fn run(&self) -> Result<()> {
        self.parts.iter().try_for_each(|part| keep_input(part, "--output", &self.output))?;
        let begun = Instant::now();
        let (output, parts) = (Output::new(&self.output)?, Here::bring(&self.parts)?);
        let summary = watched(0, |watch| encode::merge(&parts.files, self.memory, self.zstd, output.file(), watch))?;
        let made = Made::new(Some(&self.output), output.file());
        output.finish()?;
        report(made, &Summary { resumed: 0, ..summary }, 0, begun);
        Ok(())
    }
}

/// Lay scenes side by side as sheets of one world, without copying them
#[derive(Clone, Debug, clap::Args)]
pub struct WorldArgs {
    /// Scenes of equal size, row by row from the north-west; - for a place where there is none
    #[arg(required = true)]
    pub sheets: Vec<PathBuf>,
    /// World to write
    #[arg(short, long, value_name = "WORLD.pworld")]
    pub output: PathBuf,
    /// Sheets of a row [default: all of them]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub across: Option<u32>,
    /// How often all of it is there along x and z
    #[arg(long, value_name = "X,Z", value_parser = two)]
    pub repeat: Option<[u32; 2]>,
}

fn two(s: &str) -> Result<[u32; 2], String> {
    let numbers: Option<Vec<u32>> = s.split(',').map(|n| n.trim().parse().ok().filter(|&n| n > 0)).collect();
    numbers.and_then(|n| n.try_into().ok()).ok_or_else(|| "expected two whole numbers, as in 4,4".to_owned())
}

impl WorldArgs {
    pub fn run(&self) -> Result<()> {
        self.run_in(Path::new(""))
    }

    /// The same with names as seen from a folder.
    pub(crate) fn run_in(&self, here: &Path) -> Result<()> {
        if !is_manifest(&self.output) {
            let output = self.output.display();
            return Err(Error::Argument(format!("--output {output}: a name that ends with .pworld was expected")));
        }
        let across = self.across.unwrap_or(self.sheets.len() as u32);
        let rows = (self.sheets.len() as u32).div_ceil(across);
        let [times_x, times_z] = self.repeat.unwrap_or([1, 1]);
        let mut manifest: Option<Manifest> = None;
        let mut first = PathBuf::new();
        let places = (0..).flat_map(|z| (0..across).map(move |x| (x, z)));
        let mut named = Vec::new();
        for (name, (x, z)) in self.sheets.iter().zip(places).filter(|(name, _)| *name != Path::new("-")) {
            let file = if remote::is_url(name) { open::scene(name)? } else { PcastFile::open(here.join(name))? };
            let (dims, about) = (file.dims(), file.about());
            let found = Manifest {
                pworld: 1,
                sheet: [dims[0], dims[2]],
                grid: [across.saturating_mul(times_x), rows.saturating_mul(times_z)],
                height: dims[1],
                encoding: file.encoding(),
                color: file.color(),
                height_field: crate::TileSource::is_height_field(&file),
                crs: about.crs.clone(),
                coarse: None,
                coarse_level: 0,
                sheets: Vec::new(),
            };
            match &mut manifest {
                None => (manifest, first) = (Some(found), name.clone()),
                Some(all) => {
                    all.height_field &= found.height_field;
                    let differ = |what: &str, a: &dyn std::fmt::Debug, b: &dyn std::fmt::Debug| {
                        let what = format!("{what} {a:?}, {} has {b:?}; sheets of a world are alike", first.display());
                        Err(Error::format(name, what))
                    };
                    if (found.sheet, found.height) != (all.sheet, all.height) {
                        let dims = |m: &Manifest| [m.sheet[0], m.height, m.sheet[1]];
                        return differ("has voxels", &dims(&found), &dims(all));
                    }
                    if (found.encoding, found.color) != (all.encoding, all.color) {
                        return differ(
                            "has encoding and colours",
                            &(found.encoding, found.color),
                            &(all.encoding, all.color),
                        );
                    }
                    if found.crs != all.crs {
                        return differ("has the coordinate system", &found.crs, &all.crs);
                    }
                }
            }
            named.push((name, x, z));
        }
        let Some(mut manifest) = manifest else {
            return Err(Error::Argument("no sheets: all places are empty".to_owned()));
        };
        // Files are named as seen from the manifest.
        let folder = resolved(&self.output).parent().map(Path::to_path_buf).unwrap_or_default();
        let seen = |name: &Path| match remote::is_url(name) {
            true => name.to_owned(),
            false => {
                let file = resolved(&here.join(name));
                file.strip_prefix(&folder).map(Path::to_path_buf).unwrap_or(file)
            }
        };
        let all = u64::from(times_z).saturating_mul(times_x.into()).saturating_mul(named.len() as u64);
        if named.len() == 1 && across == 1 && rows == 1 {
            let (name, ..) = named[0];
            manifest.sheets.push(Sheet { file: seen(name), x: 0, z: 0, nx: times_x, nz: times_z });
        } else if all > 1 << 20 {
            return Err(Error::Argument(format!("{all} sheets by name, at most {} were expected", 1 << 20)));
        } else {
            for (i, j) in (0..times_z).flat_map(|j| (0..times_x).map(move |i| (i, j))) {
                let at = |&(name, x, z): &(&PathBuf, u32, u32)| Sheet {
                    file: seen(name),
                    x: i * across + x,
                    z: j * rows + z,
                    nx: 1,
                    nz: 1,
                };
                manifest.sheets.extend(named.iter().map(at));
            }
        }
        let no_files = |file: &Path| Err(Error::Argument(format!("{}: nobody asks for it", file.display())));
        let world = Sheets::new(&self.output, manifest.clone(), Box::new(no_files))?;
        let text = serde_json::to_vec_pretty(&manifest).expect("plain values have a JSON form");
        format::write::write_atomic(&self.output, |out| {
            out.write_all(&text).map_err(|e| Error::io(&self.output, "write", e))
        })?;
        let [nx, ny, nz] = crate::TileSource::dims(&world);
        crate::note!("{}: {nx} × {ny} × {nz} voxels, {} sheets", self.output.display(), all);
        Ok(())
    }
}

/// Check every byte of a scene, and name all tiles that are broken
#[derive(Clone, Debug, clap::Args)]
pub struct VerifyArgs {
    /// Scene file (.pcast), or the URL of one
    pub scene: PathBuf,
    /// Checksums alone: finds damage, not what a faulty program wrote
    #[arg(long)]
    pub quick: bool,
    /// Also that exposed voxels are those with an exposed face, as tiles and their neighbours have it; takes longer
    #[arg(long, conflicts_with = "quick")]
    pub deep: bool,
}

impl VerifyArgs {
    pub fn run(&self) -> Result<()> {
        let begun = Instant::now();
        let file = open::scene(&self.scene)?;
        let depth = match (self.quick, self.deep) {
            (true, _) => Depth::Checksums,
            (_, true) => Depth::Exposure,
            _ => Depth::Tiles,
        };
        let found = verify::verify(&file, depth);
        let seconds = begun.elapsed().as_secs_f64();
        let rate = file.file_len() as f64 / seconds / 1e9;
        found.faults.iter().for_each(|fault| crate::say!("{fault}"));
        match found.faults.len() {
            0 => print(&format!("{} tiles are right, {seconds:.2} s, {rate:.2} GB/s\n", found.tiles)),
            n => Err(Error::format(
                file.path(),
                format!("{n} of {} tiles are broken, the others can be read (--skip-broken)", found.tiles),
            )),
        }
    }
}

/// Write a scene's occupancy as a raw volume: bytes 0 and 1, x fastest, then y, then z
#[derive(Clone, Debug, clap::Args)]
pub struct DecodeArgs {
    /// Scene file (.pcast), or the URL of one
    pub scene: PathBuf,
    /// Raw volume to write, a file or the URL of an object
    #[arg(short, long, value_name = "VOLUME.raw")]
    pub output: PathBuf,
    /// Take broken tiles as empty, and name them
    #[arg(long)]
    pub skip_broken: bool,
}

impl DecodeArgs {
    pub fn run(&self) -> Result<()> {
        keep_input(&self.scene, "--output", &self.output)?;
        let begun = Instant::now();
        let output = Output::new(&self.output)?;
        let scene = read_scene(&open::scene(&self.scene)?, self.skip_broken)?;
        if scene.classes.is_some() {
            crate::note!(
                "note: {}: translucent matter is left out, the volume says what is solid",
                self.scene.display()
            );
        }
        decode_to_raw(&scene, output.file())?;
        let made = Made::new(Some(&self.output), output.file());
        output.finish()?;
        made.tell(begun, "");
        Ok(())
    }
}

/// The whole scene; with `skip_broken` its broken tiles are empty, and named on standard error.
pub fn read_scene(file: &PcastFile, skip_broken: bool) -> Result<Scene> {
    if !skip_broken {
        return file.read_scene();
    }
    let (scene, faults) = file.read_scene_without_broken()?;
    faults.iter().for_each(|fault| crate::say!("note: taken as empty: {fault}"));
    Ok(scene)
}

/// Show what a scene is, what it holds and how many bytes it takes
#[derive(Clone, Debug, clap::Args)]
pub struct InfoArgs {
    /// Scene file (.pcast), or an input that encode takes, or the URL of either
    pub scene: PathBuf,
    /// As one JSON object
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub input: InputArgs,
}

impl InfoArgs {
    pub fn run(&self) -> Result<()> {
        // Of a world of sheets, which no file holds as a whole.
        if is_manifest(&self.scene)
            && let Some(world) = tiles::open(&self.scene, &self.input.read)?
        {
            let info = info::WorldInfo::of(&*world);
            return print(&if self.json { json(&info) } else { info.to_string() });
        }
        let info = info::info(&open(&self.scene, &self.input.read, false)?.file)?;
        print(&if self.json { json(&info) } else { info.to_string() })
    }
}

/// Look up one voxel of level 0
#[derive(Clone, Debug, clap::Args)]
pub struct QueryArgs {
    /// Scene file (.pcast), or an input that encode takes, or the URL of either
    pub scene: PathBuf,
    /// Voxel; outside the world is air
    #[arg(allow_negative_numbers = true, value_parser = whole)]
    pub x: i64,
    #[arg(allow_negative_numbers = true, value_parser = whole)]
    pub y: i64,
    #[arg(allow_negative_numbers = true, value_parser = whole)]
    pub z: i64,
    #[command(flatten)]
    pub input: InputArgs,
}

fn whole(s: &str) -> Result<i64, String> {
    s.parse().map_err(|_| "expected a whole number".to_owned())
}

/// What `query` prints.
#[derive(serde::Serialize)]
struct QueryAnswer {
    solid: bool,
    /// `#rrggbb`
    color: Option<String>,
}

impl QueryArgs {
    pub fn run(&self) -> Result<()> {
        let voxel = open(&self.scene, &self.input.read, false)?.file.query(self.x, self.y, self.z)?;
        let color = voxel.color.map(|[r, g, b]| format!("#{r:02x}{g:02x}{b:02x}"));
        print(&json(&QueryAnswer { solid: voxel.solid, color }))
    }
}

fn json(value: &impl serde::Serialize) -> String {
    let mut text = serde_json::to_string(value).expect("plain structs have a JSON form");
    text.push('\n');
    text
}

/// Standard output, where a reader that has seen enough (`| head`) is no error.
fn print(text: &str) -> Result<()> {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != io::ErrorKind::BrokenPipe => Err(Error::io(Path::new("standard output"), "write", e)),
        _ => Ok(()),
    }
}
