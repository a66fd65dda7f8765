//! The `planecast` command: what may be typed, what it means, and doing it.
//!
//! Parsing is in two layers. The `…Args` types hold what was typed, each flag checked by itself; their `run`
//! resolves it (device, camera, outputs, all before any work) and does it.

pub mod demo;
pub mod help;
pub mod residency;
pub mod words;

use std::ffi::{OsStr, OsString};
use std::io::{self, IsTerminal, Write};
use std::path::{Path as FilePath, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use clap::{Args, FromArgMatches, Parser, Subcommand, ValueEnum};
use glam::DVec3;
use planecast_encoder::cli::{InputArgs, Made};
#[cfg(feature = "report")]
use planecast_encoder::encode::memory;
use planecast_encoder::format::write::{keep_input, resolved};
use planecast_encoder::inspect::info;
use planecast_encoder::model::transfer::Transfer;
use planecast_encoder::source::ReadOptions;
use planecast_encoder::store::guard;
use planecast_encoder::{About, Error as FileError, Scene, note, say};
use serde_json::json;

use self::residency::{Loaded, ResidencyArgs};
use crate::cpu::pick;
use crate::cpu::renderer;
use crate::film::fly::{self, Film, Kind};
use crate::film::path::{Path, Pose};
use crate::film::timeline::Timeline;
use crate::film::tour::{self, View};
use crate::film::video::{Encoder, padded, segment_frames};
use crate::frame::aim::{AimArgs, Typed};
use crate::frame::cameras;
use crate::frame::options::SAMPLES_LIMIT;
use crate::frame::preset::Preset;
use crate::frame::projection::Rays;
#[cfg(feature = "report")]
use crate::measure::bench::{
    self,
    parts::{Extent, Part},
};
#[cfg(feature = "report")]
use crate::measure::report;
#[cfg(feature = "report")]
use crate::measure::stability;
#[cfg(feature = "report")]
use crate::measure::stream::{self, flight::Flight};
use crate::measure::viewshed;
use crate::output::Picture;
use crate::render::annotate::annotate;
use crate::render::device::{Device, Renderer};
use crate::render::scan;
#[cfg(feature = "report")]
use crate::world::residency::Tiles;
use crate::world::tint::Tint;
use crate::world::{is_plain, is_surface};
use crate::{
    Camera, Culling, Error, Features, Frame, Normals, Options, Outputs, Planes, Projection, Remap, Repeat, Resident,
    Result, Shading, output, view,
};

/// Voxel terrains and volumes as run-length-encoded columns, drawn by forward projection in vertical planes
#[derive(Debug, Parser)]
#[command(name = "planecast", version)]
pub struct Cli {
    /// Say nothing but what is wrong
    #[arg(short, long, global = true)]
    pub quiet: bool,
    #[command(subcommand)]
    pub command: Command,
}

/// Which cargo features this program was built with, and without.
pub(crate) fn features_built() -> String {
    let all = [
        ("gpu", cfg!(feature = "gpu")),
        ("h264", cfg!(feature = "h264")),
        ("av1", cfg!(feature = "av1")),
        ("report", cfg!(feature = "report")),
        ("view", cfg!(feature = "view")),
        ("zarr", cfg!(feature = "zarr")),
        ("dicom", cfg!(feature = "dicom")),
        ("object-store", cfg!(feature = "object-store")),
    ];
    let names = |on: bool| {
        let names: Vec<_> = all.iter().filter(|f| f.1 == on).map(|f| f.0).collect();
        if names.is_empty() { "none".into() } else { names.join(", ") }
    };
    format!("built with {}, without {}", names(true), names(false))
}

#[derive(Debug, Subcommand)]
pub enum Command {
    Encode(planecast_encoder::cli::EncodeArgs),
    Merge(planecast_encoder::cli::MergeArgs),
    World(planecast_encoder::cli::WorldArgs),
    Verify(planecast_encoder::cli::VerifyArgs),
    Decode(planecast_encoder::cli::DecodeArgs),
    Info(planecast_encoder::cli::InfoArgs),
    Query(planecast_encoder::cli::QueryArgs),
    Render(RenderArgs),
    Fly(FlyArgs),
    Join(JoinArgs),
    Viewshed(ViewshedArgs),
    View(ViewArgs),
    Pick(PickArgs),
    Demo(DemoArgs),
    #[cfg(feature = "report")]
    Bench(BenchArgs),
    #[cfg(feature = "report")]
    Report(ReportArgs),
    Completions(help::CompletionsArgs),
    Man(help::ManArgs),
}

/// Draw one picture of a scene
#[derive(Debug, Args)]
pub struct RenderArgs {
    /// Scene file (.pcast), or an input that encode takes, or the URL of either
    scene: PathBuf,
    /// Picture to write (.png, .jpg), or - for PNG on standard output; of --projection lidar also .ply, .las or .npy; with --cameras
    /// a folder
    #[arg(short, long, value_name = "OUT.png|-|DIR")]
    output: PathBuf,
    /// Draw a picture from each pose in this file (JSON: a list of {"eye": [x, y, z], "yaw", "pitch", "roll", "fov", "size":
    /// [width, height]}) into the folder of -o: 000000.png and on
    #[arg(long, value_name = "POSES.json", conflicts_with_all = ["eye", "yaw", "pitch", "look_at", "orbit", "fit", "top"])]
    cameras: Option<PathBuf>,
    /// Where the camera is, voxels [default: a good view, found from the scene]
    #[arg(long, value_name = "X,Y,Z", value_parser = vector)]
    eye: Option<DVec3>,
    /// Degrees; 0 looks along -z, 90 along +x [default: 0 with --eye, else that of the good view]
    #[arg(long, value_name = "D", value_parser = finite)]
    yaw: Option<f64>,
    /// Degrees, -90 to 90, up is positive [default: 0 with --eye, else that of the good view]
    #[arg(long, value_name = "D", value_parser = pitch)]
    pitch: Option<f64>,
    /// Degrees
    #[arg(long, value_name = "D", value_parser = finite, default_value = "0")]
    roll: f64,
    /// Picture's width and height, pixels [default: 1280x720, or what the projection asks for]
    #[arg(long, value_name = "WxH", value_parser = size)]
    size: Option<[u32; 2]>,
    #[command(flatten)]
    draw: DrawArgs,
    /// Draw a scale bar, an arrow to the north and, for heights, colours with their values into the picture
    #[arg(long)]
    annotate: bool,
    /// Also write the depth of every pixel (NPY, f4, H x W); with --cameras a folder [default there: that of -o], 000000.depth.npy and
    /// on
    #[arg(long, value_name = "D.npy|DIR", num_args = 0..=1, default_missing_value = "-")]
    depth: Option<PathBuf>,
    /// Also write the voxel of every pixel (NPY, i4, H x W x 4: x, y, z, level); with --cameras as --depth, 000000.voxel.npy
    #[arg(long, value_name = "V.npy|DIR", num_args = 0..=1, default_missing_value = "-")]
    voxel: Option<PathBuf>,
    /// Also write what the frame cost (JSON)
    #[arg(long, value_name = "S.json")]
    stats: Option<PathBuf>,
    #[command(flatten)]
    aim: AimArgs,
    #[command(flatten)]
    input: InputArgs,
}

/// Make a film of a scene, or a folder of its frames
///
/// Ctrl-C stops after the frame under way and leaves a whole film up to there; --resume goes on with an .mp4 or a folder.
///
/// MP4 films are H.264. It is patented in some countries: private use is free everywhere, but who sells or streams such films
/// for money, or gives away programs that make them, may owe a licence fee to the patents' holders (Via LA), which no
/// open-source licence covers. --encoder av1 is free of that, and much slower.
///
/// A path file is JSON: a list of keyframes {"t": seconds, "eye": [x, y, z], "yaw": degrees, "pitch": degrees,
/// "roll": degrees (0 if left out), "fov": degrees (that of --fov if left out)} with increasing times. Between them
/// the camera follows a natural cubic spline.
#[derive(Debug, Args)]
pub struct FlyArgs {
    /// Scene file (.pcast), or an input that encode takes, or the URL of either
    scene: PathBuf,
    /// Film to write (.mp4, .y4m; .gif or .png that move), a folder for PNG frames, or - for Y4M to standard output
    #[arg(short, long, value_name = "OUT.mp4|OUTDIR|-")]
    output: PathBuf,
    /// What encodes: h264, av1, or the program ffmpeg, with arguments for its output after a colon [default: h264]
    #[arg(long, value_name = "h264|av1|ffmpeg[:ARGS]")]
    encoder: Option<Encoder>,
    /// Fly along the keyframes in this file
    #[arg(long, value_name = "P.json", conflicts_with = "tour")]
    path: Option<PathBuf>,
    /// Fly a tour made from the scene itself [default without --path]
    #[arg(long)]
    tour: bool,
    /// Frames in all, spread evenly over the path [default: as many as its time takes at --fps]; or A..B: only those of the
    /// whole film, from 0, without B; A..B/N: the same of a film of N frames. Parts in MP4 are put together by join
    #[arg(long, value_name = "N|A..B[/N]", value_parser = frames)]
    frames: Option<Frames>,
    /// Only print how many frames the whole film has, and the multiple of frames at which parts are best cut (JSON)
    #[arg(long)]
    plan: bool,
    /// Frames a second, 1 to 240
    #[arg(long, value_name = "F", value_parser = fps, default_value = "30")]
    fps: f64,
    /// Go on with a film that was stopped: the same command, with this
    #[arg(long)]
    resume: bool,
    /// Also write the path that is flown, as --path reads it
    #[arg(long, value_name = "P.json")]
    save_path: Option<PathBuf>,
    /// Frames' width and height, pixels [default: 640x360, or what the projection asks for]
    #[arg(long, value_name = "WxH", value_parser = size)]
    size: Option<[u32; 2]>,
    #[command(flatten)]
    draw: DrawArgs,
    /// Draw a scale bar, an arrow to the north and, for heights, colours with their values into each frame
    #[arg(long)]
    annotate: bool,
    /// Also write what the last frame drawn cost (JSON)
    #[arg(long, value_name = "S.json")]
    stats: Option<PathBuf>,
    /// Also write what each frame took, one a line (CSV): stages in ms; tiles wanted, used and evicted; bytes; debt; lod
    #[arg(long, value_name = "T.csv")]
    timeline: Option<PathBuf>,
    #[command(flatten)]
    aim: AimArgs,
    #[command(flatten)]
    input: InputArgs,
}

/// Put parts of a film together that fly --frames A..B has made, without encoding them again
#[derive(Debug, Args)]
pub struct JoinArgs {
    /// Parts of one film, in any order (.mp4)
    #[arg(required = true, value_name = "SEGMENT.mp4")]
    segments: Vec<PathBuf>,
    /// Film to write
    #[arg(short, long, value_name = "FILM.mp4")]
    output: PathBuf,
}

/// Open a window to fly in
///
/// F1 lists the keys. A scene file, or anything that encode reads, can be given or be dropped on the window.
#[derive(Debug, Args)]
pub struct ViewArgs {
    /// Scene file (.pcast), or an input or name that encode takes
    input: Option<PathBuf>,
    /// Where the camera is first, voxels [default: where the scene was left, else a good view]
    #[arg(long, value_name = "X,Y,Z", value_parser = vector)]
    eye: Option<DVec3>,
    /// Degrees; 0 looks along -z, 90 along +x
    #[arg(long, value_name = "D", value_parser = finite)]
    yaw: Option<f64>,
    /// Degrees, -90 to 90, up is positive
    #[arg(long, value_name = "D", value_parser = pitch)]
    pitch: Option<f64>,
    /// Degrees
    #[arg(long, value_name = "D", value_parser = finite)]
    roll: Option<f64>,
    /// Window's width and height, pixels
    #[arg(long, value_name = "WxH", value_parser = size, default_value = "1280x720")]
    window: [u32; 2],
    /// Fill the screen
    #[arg(long)]
    full_screen: bool,
    /// Hold this many frames a second: with fewer pixels and planes where it must be
    #[arg(long, value_name = "F", value_parser = fps)]
    target_fps: Option<f64>,
    /// Screenshots' width and height, pixels [default: the window's]
    #[arg(long, value_name = "WxH", value_parser = size)]
    screenshot_size: Option<[u32; 2]>,
    /// Do what this file says (JSON), as a person would: keys, sizes, screenshots
    #[arg(long, value_name = "S.json")]
    script: Option<PathBuf>,
    #[command(flatten)]
    draw: DrawArgs,
    #[command(flatten)]
    aim: AimArgs,
    #[command(flatten)]
    input_options: InputArgs,
}

/// Find the first solid voxel along a ray
#[derive(Debug, Args)]
pub struct PickArgs {
    /// Scene file (.pcast), or an input that encode takes, or the URL of either
    scene: PathBuf,
    /// Where the ray starts, voxels
    #[arg(long, value_name = "X,Y,Z", value_parser = vector)]
    from: DVec3,
    /// Where it points; any length but 0
    #[arg(long, value_name = "X,Y,Z", value_parser = vector)]
    dir: DVec3,
    #[command(flatten)]
    input: InputArgs,
}

/// Encode the terrain that comes with planecast, draw a picture of it and fly through it
#[derive(Debug, Args)]
pub struct DemoArgs {
    /// Folder for the files; made if it is not there
    #[arg(short, long, value_name = "DIR", default_value = "demo")]
    output: PathBuf,
}

/// Measure the tables of Forstmann & Ohya 2009 and 2010 here, beside their own figures
///
/// Leaves CSV, JSON, plots and one page (bench.html) in a folder. A run that was stopped goes on: the same command again.
#[cfg(feature = "report")]
#[derive(Debug, Args)]
pub struct BenchArgs {
    /// Folder for the files; made if it is not there
    #[arg(short, long, value_name = "DIR", default_value = "bench")]
    output: PathBuf,
    /// Within two minutes on two cores: smaller scenes and pictures, fewer frames
    #[arg(long)]
    quick: bool,
    /// Parts to measure [default: all]
    #[arg(long, value_enum, value_name = "PART,...", value_delimiter = ',')]
    only: Vec<Part>,
    /// What draws beside the CPU
    #[arg(long, value_enum, value_name = "DEVICE", default_value = "auto")]
    device: bench::Device,
    /// Take a file (any that encode reads, or .pcast) in place of a procedural scene: shapes, landscape, mixing, scan,
    /// serpent or city
    #[arg(long, value_name = "NAME=FILE", value_parser = bench::scene_file)]
    scene: Vec<(bench::scenes::Name, PathBuf)>,
}

/// Measure error against time: which flags give which error in how long, on this machine and scene
///
/// Leaves report.html, report.csv, report.json, plots (SVG) and pictures (PNG) in a folder. What is measured is kept there
/// at once: a run that was stopped goes on when it is typed again.
///
/// With --stream, instead of flags, worlds that come in tiles: how much error and how much time a flight pays for little memory, a
/// great velocity and a slow link, where its frames wait for their tiles and where they do not. Leaves stream.html, stream.md,
/// stream.csv, stream.json, plots and pictures, once all rows are there: with a scene that takes long, name fewer with --memory.
#[cfg(feature = "report")]
#[derive(Debug, Args)]
pub struct ReportArgs {
    /// Scene file (.pcast), or an input that encode takes, or the URL of either
    #[arg(required_unless_present = "stability", conflicts_with = "stability")]
    scene: Option<PathBuf>,
    /// Instead of a scene, draw the catalogue of stiff and extreme cases: stability.json, .csv, .md and plots
    #[arg(long)]
    stability: bool,
    /// Measure the scene as a world in tiles: error against time over memory, velocity, link and patience
    #[arg(long, conflicts_with_all = ["stability", "rounds", "budget_ms", "max_error"])]
    stream: bool,
    /// With --stream: memory for tiles, as in 64M or 64M,1G [default: 25, 50, 100 and 200 % of what the first view needs, with
    /// --quick the last two]
    #[arg(long, value_name = "SIZE[,SIZE]", value_delimiter = ',', value_parser = memory::parse, requires = "stream")]
    memory: Vec<u64>,
    /// Folder for the report; made if it is not there
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Fewer configurations, poses and pixels: a minute or two
    #[arg(long)]
    quick: bool,
    /// Look along the keyframes in this file [default: standing poses over the scene, with --stream a straight flight over it]
    #[arg(long, value_name = "P.json")]
    path: Option<PathBuf>,
    /// Pictures' width and height, pixels [default: 640x480, with --quick or --stream 320x240]
    #[arg(long, value_name = "WxH", value_parser = size)]
    size: Option<[u32; 2]>,
    /// Times that each configuration is timed at each pose [default: 5, with --quick 3]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1000))]
    rounds: Option<u32>,
    /// Vertical field of view, degrees
    #[arg(long, value_name = "D", value_parser = fov, default_value = "60")]
    fov: f64,
    /// What is measured beside the CPU: auto takes a real GPU where one is usable, gpu any
    #[arg(long, value_enum, value_name = "DEVICE", default_value = "auto")]
    device: Device,
    /// Columns farther away than this are not drawn, voxels [default: no limit]
    #[arg(long, value_name = "V", value_parser = positive)]
    view_distance: Option<f64>,
    /// Tile the world without end along these axes
    #[arg(long, value_enum, value_name = "AXES", default_value = "none")]
    repeat: RepeatArg,
    /// Choose: the least error that takes at most this long a frame
    #[arg(long, value_name = "T", value_parser = positive)]
    budget_ms: Option<f64>,
    /// Choose: the fastest whose mean FLIP against one exact ray a pixel is at most this (0 to 1)
    #[arg(long, value_name = "E", value_parser = positive)]
    max_error: Option<f64>,
    /// Threads to draw with [default: one a core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    #[command(flatten)]
    input: InputArgs,
}

/// Find which columns are seen from a place, or from how many of several places
///
/// A column is seen where any of its voxels' faces is. GeoTIFF and NPY have counts, one a column, rows along z; GeoTIFF has the
/// georeference that the scene keeps of its source. PNG is white where all places see. A place inside something solid sees the
/// column that it is in.
#[derive(Debug, Args)]
pub struct ViewshedArgs {
    /// Scene file (.pcast), or an input that encode takes, or the URL of either
    scene: PathBuf,
    /// A place to see from, voxels; may be given again
    #[arg(long, required = true, value_name = "X,Y,Z", value_parser = vector)]
    eye: Vec<DVec3>,
    /// File to write: .tif, .png or .npy
    #[arg(short, long, value_name = "V.tif|V.png|V.npy")]
    output: PathBuf,
    /// Threads to work with [default: one a core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    #[command(flatten)]
    input: InputArgs,
}

/// How to draw, for pictures and films alike.
#[derive(Debug, Args)]
pub struct DrawArgs {
    /// Vertical field of view, degrees; of fisheye all of its circle, of lidar from the highest beam to the lowest [default: 60, of
    /// fisheye 180, of lidar 45]
    #[arg(long, value_name = "D", value_parser = any_fov)]
    fov: Option<f64>,
    /// Which ray each pixel shows: perspective; ortho, HEIGHT voxels high; equirect, cube (3 x 2 faces), fisheye, and lidar, whose
    /// depth is the distance along the ray
    #[arg(
        long,
        value_name = "perspective|ortho[:HEIGHT]|equirect|cube|fisheye|lidar:CHANNELSxSTEPS",
        default_value = "perspective"
    )]
    projection: Projection,
    /// What draws; auto takes the GPU where one is usable, exact is one ray a pixel
    #[arg(long, value_enum, value_name = "DEVICE", default_value = "auto")]
    device: Device,
    /// Which of the device's kernels draws [default: its fastest]
    #[arg(long, value_name = "NAME")]
    kernel: Option<String>,
    /// Columns farther away than this are not drawn, voxels [default: no limit]
    #[arg(long, value_name = "V", value_parser = positive)]
    view_distance: Option<f64>,
    /// Tile the world without end along these axes
    #[arg(long, value_enum, value_name = "AXES", default_value = "none")]
    repeat: RepeatArg,
    /// Pixels that a voxel may cover at most before a finer level is drawn; off draws level 0 everywhere
    #[arg(long, value_name = "PX|off", value_parser = lod, default_value = "1")]
    lod: Lod,
    /// Speed against error as a whole, in place of --planes, --lod and --remap
    #[arg(long, value_enum, value_name = "PRESET", conflicts_with_all = ["planes", "lod", "remap"])]
    preset: Option<Preset>,
    /// Planes to cast: a number, auto (one a pixel) or a percentage of auto
    #[arg(long, value_name = "N|auto|FACTOR%", value_parser = planes, default_value = "auto")]
    planes: Planes,
    /// Distance between planes: a pixel everywhere, or wider where planes would crowd
    #[arg(long, value_enum, value_name = "SPACING", default_value = "readjusted")]
    spacing: Spacing,
    /// Samples of a plane, as a percentage of the pixels along it
    #[arg(long, value_name = "FACTOR%", value_parser = samples, default_value = "100%")]
    samples: f64,
    /// Culling, for measuring: all, none, or some of horizon,center,forward,bits,coarse
    #[arg(long, value_name = "LIST", value_parser = culling, default_value = "all")]
    cull: Culling,
    /// Beyond this distance, voxels, look at one column a slice [default: never]
    #[arg(long, value_name = "V", value_parser = positive)]
    equidistant: Option<f64>,
    /// How a pixel picks among the planes around it
    #[arg(long, value_enum, value_name = "RULE", default_value = "refine")]
    remap: RemapArg,
    /// Leave pixels that no plane reaches open
    #[arg(long)]
    no_gap_fill: bool,
    /// Walk planes in f64, on the CPU alone
    #[arg(long)]
    f64: bool,
    /// Colour as stored, screen-space normals, screen-space ambient occlusion, or both; or both with the light that shows a terrain,
    /// a model, a scan best, of which --sun, --shadows and --normals change what they name
    #[arg(long, value_enum, value_name = "SHADING", default_value = "full")]
    shading: ShadingArg,
    /// Neighbours that occlusion is taken from, 1 to 64
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=64), default_value = "10")]
    ssao_samples: u32,
    /// Colours and opacities of a volume's values, where it was encoded with --classes: a JSON file, or bone, soft-tissue, smoke, cloud
    #[arg(long, value_name = "FILE.json|PRESET")]
    transfer: Option<String>,
    /// Distance, voxels, at which fog has taken 63 % of a colour [default: clear air]
    #[arg(long, value_name = "V", value_parser = positive)]
    fog: Option<f64>,
    /// Where a sun stands that lights surfaces, degrees: azimuth clockwise from north (-z), elevation; shows relief [default: soft
    /// light]
    #[arg(long, value_name = "AZIMUTH,ELEVATION", value_parser = sun)]
    sun: Option<[f64; 2]>,
    /// What stands before the sun throws shadows; of the usual light without --sun [default: off]
    #[arg(long, value_enum, value_name = "on|off")]
    shadows: Option<Switch>,
    /// What surfaces are lit by: depths of the pixels around, or what is solid around each voxel [default: screen]
    #[arg(long, value_enum, value_name = "FROM")]
    normals: Option<NormalsArg>,
    /// A height field as a surface where it is near, and lit as one, not as blocks [default: on for height maps that are opened to
    /// be looked at]
    #[arg(long, value_enum, value_name = "on|off")]
    smooth: Option<Switch>,
    /// The sky in pictures; none leaves it transparent in PNG files
    #[arg(long, value_enum, value_name = "SKY", default_value = "shown")]
    sky: SkyArg,
    /// What may be left out where the frame does not need it, for measuring: auto, off, or some of
    /// heights,horizon,bounded,one-level,upright,packed,late-color
    #[arg(long, value_name = "LIST", default_value = "auto")]
    specialize: Features,
    /// Draw a scene with broken tiles, those as empty
    #[arg(long)]
    skip_broken: bool,
    #[command(flatten)]
    residency: ResidencyArgs,
    /// Threads to draw with [default: one a core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
}

impl ValueEnum for Device {
    fn value_variants<'a>() -> &'a [Device] {
        &[Device::Auto, Device::Gpu, Device::AllGpus, Device::Cpu, Device::Exact]
    }

    fn to_possible_value(&self) -> Option<clap::builder::PossibleValue> {
        let (name, help) = match self {
            Device::Auto => ("auto", "The GPU where a real one is usable, else the CPU"),
            Device::Gpu => ("gpu", "The GPU; an error where there is none"),
            Device::AllGpus => ("gpu:all", "Every GPU at once, a frame on each in turn: for films"),
            Device::Cpu => ("cpu", "The CPU"),
            Device::Exact => ("exact", "One f64 ray per pixel at level 0, on the CPU"),
        };
        Some(clap::builder::PossibleValue::new(name).help(help))
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum RepeatArg {
    None,
    X,
    Z,
    Xz,
}

impl RepeatArg {
    fn axes(self) -> Repeat {
        Repeat { x: matches!(self, RepeatArg::X | RepeatArg::Xz), z: matches!(self, RepeatArg::Z | RepeatArg::Xz) }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Spacing {
    Full,
    Readjusted,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum RemapArg {
    /// The nearest plane's sample
    Nearest,
    /// The sample around whose voxel the pixel's own ray meets
    Retest,
    /// The same; where samples show different voxels of level 0, a short walk of that ray
    Refine,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum ShadingArg {
    None,
    Ssn,
    Ssao,
    Full,
    /// A sun in the north-west, and its shadows
    Terrain,
    /// A sun from behind the left shoulder of one who looks north, and its shadows
    Model,
    /// Derived normals
    Scan,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum NormalsArg {
    Screen,
    Derived,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Switch {
    On,
    Off,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum SkyArg {
    Shown,
    None,
}

/// A number of pixels, or off. Its own type, as clap takes an `Option` for a flag that may be left out.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Lod(Option<f64>);

pub(crate) fn finite(s: &str) -> Result<f64, String> {
    let v: f64 = s.trim().parse().map_err(|_| "expected a number".to_owned())?;
    if v.is_finite() { Ok(v) } else { Err("expected a finite number".into()) }
}

pub(crate) fn positive(s: &str) -> Result<f64, String> {
    finite(s).and_then(|v| if v > 0.0 { Ok(v) } else { Err("expected a number above 0".into()) })
}

fn sun(s: &str) -> Result<[f64; 2], String> {
    let (azimuth, elevation) = s.split_once(',').ok_or("expected AZIMUTH,ELEVATION in degrees, as 315,45")?;
    Ok([finite(azimuth)?, pitch(elevation)?])
}

pub(crate) fn pitch(s: &str) -> Result<f64, String> {
    finite(s).and_then(|v| if v.abs() <= 90.0 { Ok(v) } else { Err("expected -90 to 90 degrees".into()) })
}

#[cfg(feature = "report")]
fn fov(s: &str) -> Result<f64, String> {
    let allowed = |v: &f64| *v > 0.0 && *v < 180.0;
    finite(s).and_then(|v| Some(v).filter(allowed).ok_or_else(|| "expected above 0 and below 180 degrees".into()))
}

fn any_fov(s: &str) -> Result<f64, String> {
    let allowed = |v: &f64| (0.0..=360.0).contains(v);
    finite(s).and_then(|v| Some(v).filter(allowed).ok_or_else(|| "expected 0 to 360 degrees".into()))
}

fn fps(s: &str) -> Result<f64, String> {
    let allowed = |v: &f64| (1.0..=240.0).contains(v);
    finite(s).and_then(|v| Some(v).filter(allowed).ok_or_else(|| "expected 1 to 240".into()))
}

/// What `--frames` names: some of the frames, how many in all.
#[derive(Clone, Debug, PartialEq)]
struct Frames(Option<std::ops::Range<usize>>, Option<usize>);

fn frames(s: &str) -> Result<Frames, String> {
    let number = |s: &str| s.trim().parse::<usize>().ok().filter(|n| (0..=1_000_000).contains(n));
    let whole = |s: &str| number(s).filter(|n: &usize| *n > 0);
    let parse = || match s.split_once("..") {
        None => Some(Frames(None, Some(whole(s)?))),
        Some((from, to)) => {
            let (to, all) = to.split_once('/').map_or((to, None), |(to, all)| (to, Some(all)));
            let (range, all) = (number(from)?..number(to)?, all.map(whole));
            let fits = !range.is_empty() && all.is_none_or(|all| all.is_some_and(|all| range.end <= all));
            fits.then_some(Frames(Some(range), all.flatten()))
        }
    };
    parse().ok_or_else(|| "expected a number from 1 to 1000000, or frames as in 48..96 or 48..96/300".into())
}

pub(crate) fn vector(s: &str) -> Result<DVec3, String> {
    let parts: Result<Vec<f64>, String> = s.split(',').map(finite).collect();
    let parts: [f64; 3] = parts
        .and_then(|v| v.try_into().map_err(|_| String::new()))
        .map_err(|_| "expected three numbers, as in 10,-2.5,7".to_owned())?;
    Ok(parts.into())
}

/// Pixels of a picture at most; at 32 bytes a pixel while it is drawn, 2 GiB.
const PIXELS: u64 = 1 << 26;

fn size(s: &str) -> Result<[u32; 2], String> {
    let parse = |v: &str| v.parse().ok().filter(|v: &u32| (1..=16_384).contains(v));
    let parts = s.split_once(['x', 'X']).and_then(|(w, h)| Some([parse(w)?, parse(h)?]));
    let [w, h] = parts.ok_or("expected WxH, as in 640x360, each 1 to 16384")?;
    if u64::from(w) * u64::from(h) > PIXELS {
        return Err(format!("expected at most {PIXELS} pixels in all"));
    }
    Ok([w, h])
}

fn lod(s: &str) -> Result<Lod, String> {
    match s {
        "off" => Ok(Lod(None)),
        _ => positive(s).map(|v| Lod(Some(v))).map_err(|_| "expected pixels above 0, or off".into()),
    }
}

fn planes(s: &str) -> Result<Planes, String> {
    let wrong = || "expected a number of planes from 1 to 1000000, auto, or a percentage up to 6400%".to_owned();
    match s.strip_suffix('%') {
        _ if s == "auto" => Ok(Planes::Auto),
        Some(percent) => {
            let v = positive(percent).ok().filter(|v| *v <= 6400.0).ok_or_else(wrong)?;
            Ok(Planes::Factor(v / 100.0))
        }
        None => s.parse().ok().filter(|n| (1..=1_000_000).contains(n)).map(Planes::Count).ok_or_else(wrong),
    }
}

fn samples(s: &str) -> Result<f64, String> {
    let percent = s.strip_suffix('%').and_then(|percent| positive(percent).ok());
    let factor = percent.map(|v| v / 100.0).filter(|v| *v <= SAMPLES_LIMIT);
    factor.ok_or_else(|| format!("expected a percentage above 0% and up to {}%", SAMPLES_LIMIT * 100.0))
}

fn culling(s: &str) -> Result<Culling, String> {
    match s {
        "all" => return Ok(Culling::ALL),
        "none" => return Ok(Culling::NONE),
        _ => {}
    }
    let mut culling = Culling::NONE;
    for part in s.split(',') {
        *match part {
            "horizon" => &mut culling.horizon,
            "center" => &mut culling.center,
            "forward" => &mut culling.forward,
            "bits" => &mut culling.bits,
            "coarse" => &mut culling.coarse,
            _ => return Err("expected all, none, or a list of horizon,center,forward,bits,coarse".into()),
        } = true;
    }
    Ok(culling)
}

impl DrawArgs {
    fn options(&self) -> Options {
        let options = Options {
            view_distance: self.view_distance.unwrap_or(f64::INFINITY),
            repeat: self.repeat(),
            lod: self.lod.0,
            planes: self.planes,
            readjust: self.spacing == Spacing::Readjusted,
            samples: self.samples,
            culling: self.cull,
            equidistant: self.equidistant,
            remap: match self.remap {
                RemapArg::Nearest => Remap::Nearest,
                RemapArg::Retest => Remap::Retest,
                RemapArg::Refine => Remap::Refine,
            },
            gap_fill: !self.no_gap_fill,
            shading: match self.shading {
                ShadingArg::None => Shading::None,
                ShadingArg::Ssn => Shading::Ssn,
                ShadingArg::Ssao => Shading::Ssao,
                ShadingArg::Full | ShadingArg::Terrain | ShadingArg::Model | ShadingArg::Scan => Shading::Full,
            },
            f64_traversal: self.f64,
            ssao_samples: self.ssao_samples,
            fog: self.fog,
            sun: self.sun.or(match self.shading {
                ShadingArg::Terrain => Some([315.0, 40.0]),
                ShadingArg::Model => Some([205.0, 50.0]),
                _ => None,
            }),
            shadows: self
                .shadows
                .map_or(matches!(self.shading, ShadingArg::Terrain | ShadingArg::Model), |s| s == Switch::On),
            normals: match (self.normals, self.shading) {
                (Some(NormalsArg::Derived), _) | (None, ShadingArg::Scan) => Normals::Derived,
                _ => Normals::Screen,
            },
            // Where nothing is said, that is decided when the scene is known.
            smooth: self.smooth == Some(Switch::On),
            sky: self.sky == SkyArg::Shown,
            specialize: self.specialize,
            projection: self.projection,
        };
        self.preset.map_or(options, |preset| preset.options(options))
    }

    fn repeat(&self) -> Repeat {
        self.repeat.axes()
    }

    fn fov(&self) -> f64 {
        self.fov.unwrap_or(self.projection.usual_fov())
    }

    fn size(&self, typed: Option<[u32; 2]>, usual: [u32; 2]) -> [u32; 2] {
        typed.or_else(|| self.projection.usual_size()).unwrap_or(usual)
    }

    /// Whether directions alone make the picture, all round: a camera for it need not frame anything.
    fn looks_round(&self) -> bool {
        !matches!(self.projection, Projection::Perspective | Projection::Ortho { .. })
    }

    /// Whether projection, field of view and size go together, before any other work.
    fn check_projection(&self, size: [u32; 2]) -> Result<()> {
        if let (Some(fov), false) = (self.fov, self.projection.has_fov()) {
            let name = self.projection.name();
            return Err(Error::Argument(format!("--fov {fov}: {name} shows the whole sphere; leave it out")));
        }
        let camera = Camera { fov: self.fov(), width: size[0], height: size[1], ..Camera::default() };
        self.projection.check(&camera)
    }

    /// The camera of a pose.
    fn camera(&self, pose: Pose, size: [u32; 2]) -> Camera {
        let fov = if self.looks_round() { self.fov() } else { pose.fov };
        Camera { fov, ..pose.camera(size) }
    }

    /// A good view looks at all from outside and down; a picture of all directions is taken within and upright.
    fn looking_round(&self, pose: Pose, eye: Option<DVec3>, pitch: Option<f64>, aimed: bool, scene: &Scene) -> Pose {
        if !self.looks_round() || aimed {
            return pose;
        }
        let eye = eye.unwrap_or_else(|| tour::within(scene));
        Pose { eye, pitch: pitch.unwrap_or(0.0), ..pose }
    }

    /// Scale and north hold for one direction of view.
    fn check_annotate(&self, annotate: bool) -> Result<()> {
        if annotate && self.projection != Projection::Perspective {
            let name = self.projection;
            return Err(Error::Argument(format!(
                "--annotate: is for perspective, not for --projection {name}; leave it out"
            )));
        }
        Ok(())
    }

    /// A sky that is left out needs an output that has transparency.
    fn check_sky(&self, transparent: bool, output: &FilePath) -> Result<()> {
        if self.sky == SkyArg::Shown || transparent {
            return Ok(());
        }
        let output = output.display();
        Err(Error::Argument(format!("--sky none: {output} has no transparency; write PNG, or a folder of them")))
    }

    /// What needs the whole world, of one that comes in tiles.
    fn check_tiles(&self, annotate: bool) -> Result<()> {
        let needs =
            [(annotate, "--annotate"), (self.kernel.is_some(), "--kernel"), (self.looks_round(), "--projection")];
        match needs.into_iter().find(|(given, _)| *given) {
            Some((_, "--projection")) if self.projection == Projection::Cube => Ok(()),
            Some((_, flag)) => Err(Error::Argument(format!(
                "{flag}: needs the whole world in memory, and this one comes in tiles; leave it out, or give --residency whole"
            ))),
            None => Ok(()),
        }
    }

    fn view(&self, size: [u32; 2]) -> View {
        let fov = if self.looks_round() { Projection::Perspective.usual_fov() } else { self.fov() };
        View { fov, size, repeat: self.repeat() }
    }

    /// Opens the device that draws; what it has to tell goes to stderr.
    fn renderer(&self, scene: &Arc<Scene>, resident: &Arc<Resident>) -> Result<Renderer> {
        Renderer::with_kernel(scene, resident, self.device, self.kernel.as_deref(), &mut tell)
    }

    /// A scene and its tables, as renderers share them. Options that it or the projection has nothing for are taken back, with a
    /// word. Who measures what is there is shown no surface unless it was asked for.
    fn shared(
        &self,
        scene: Scene,
        surface: &Surface,
        measured: bool,
        options: &mut Options,
    ) -> Result<(Arc<Scene>, Arc<Resident>)> {
        let drawn = options.drawn();
        if *options != drawn {
            *options = drawn;
            tell(&format!(
                "projection {}: shadows, derived normals and --smooth are for perspective and cube; left out",
                options.projection
            ));
        }
        options.smooth |= self.smooth.is_none() && !measured && surface.stands;
        *options = options.drawn();
        // A surface is drawn from heights alone.
        let features = if options.smooth { self.specialize.with(crate::Feature::Heights) } else { self.specialize };
        let mut resident = Resident::with(&scene, features).with_fractions(&surface.about.fractions);
        if let Some(tint) = &surface.tint {
            tint.paint(&mut resident);
        }
        if surface.plain {
            tell("the scene has no colours; --ramp terrain gives it some by height");
        }
        self.set_transfer(&resident)?;
        if options.smooth && !resident.heights {
            options.smooth = false;
            if !surface.stands {
                tell(
                    "--smooth on: not every column is one run from the ground up, so that there is no surface; blocks are drawn",
                );
            }
        }
        if options.normals == Normals::Derived && scene.encoding != planecast_encoder::Encoding::Solid {
            options.normals = Normals::Screen;
            tell(
                "derived normals: the scene has no solid interior (--encoding surface); those of the screen are drawn",
            );
        }
        Ok((Arc::new(scene), Arc::new(resident)))
    }

    /// What is said of translucent matter instead of what the scene says.
    fn set_transfer(&self, resident: &Resident) -> Result<()> {
        let Some(name) = &self.transfer else { return Ok(()) };
        let window = resident.matter.as_ref().and_then(|matter| matter.classes.window);
        let Some((matter, window)) = resident.matter.as_ref().zip(window) else {
            return Err(Error::Argument(format!(
                "--transfer {name}: the scene has no steps of values to colour; encode a volume with --classes N"
            )));
        };
        let transfer = Transfer::open(name, window)?;
        transfer.left_out.iter().for_each(|what| tell(&format!("--transfer {name}: left out {what}")));
        matter.set_transfer(&transfer);
        if matter.look().is_clear() {
            let [low, high] = window;
            tell(&format!("--transfer {name}: all is clear; the steps of the scene go from {low} to {high}"));
        }
        Ok(())
    }

    fn set_threads(&self) -> Result<()> {
        set_threads(self.threads)
    }
}

fn set_threads(threads: Option<u16>) -> Result<()> {
    let Some(n) = threads else { return Ok(()) };
    // Fails only if the pool was used before, which main() does not.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(n.into());
    pool.build_global().map_err(|e| Error::Limit(format!("--threads {n}: {e}")))
}

fn tell(what: &str) {
    note!("{what}");
}

fn open_scene(path: &FilePath, read: &ReadOptions, skip_broken: bool) -> Result<(Scene, Surface)> {
    let opened = planecast_encoder::cli::open(path, read, true)?;
    let surface = Surface::of(&opened, read)?;
    Ok((planecast_encoder::cli::read_scene(&opened.file, skip_broken)?, surface))
}

/// What is known of the surface that a scene stands for.
pub struct Surface {
    stands: bool,
    about: About,
    /// As `info` has it.
    content: String,
    /// Colours instead of the scene's.
    tint: Option<Tint>,
    /// Whether it is a scene of land that has no colours, and nobody said which.
    plain: bool,
}

impl Surface {
    fn of(opened: &planecast_encoder::encode::open::Opened, read: &ReadOptions) -> Result<Surface> {
        let about = opened.file.about().clone();
        let content = info::content_hash(&opened.file);
        // An input has them by now.
        let ramp = read.ramp.as_deref().filter(|_| !opened.encoded);
        let tint = Tint::asked(ramp, &about)?;
        let plain = is_plain(&about, opened.file.color()) && !opened.encoded && read.ramp.is_none();
        Ok(Surface { stands: is_surface(&about, opened.encoded), about, content, tint, plain })
    }
}

/// How an input is read that a person is to look at.
fn shown(read: &ReadOptions) -> ReadOptions {
    ReadOptions { show: true, ..read.clone() }
}

/// The files of a command that are not standard output.
fn named_file(path: &PathBuf) -> Option<&PathBuf> {
    Some(path).filter(|path| **path != FilePath::new(output::STDOUT))
}

/// Every output once and over no input, and each can be written as far as that can be known before.
fn check_outputs(inputs: &[Option<&PathBuf>], outputs: &[(&str, Option<&PathBuf>)]) -> Result<()> {
    let given: Vec<(&str, &PathBuf)> = outputs.iter().filter_map(|(flag, p)| Some((*flag, (*p)?))).collect();
    for (i, (flag, path)) in given.iter().enumerate() {
        if let Some((other, _)) = given[..i].iter().find(|(_, p)| resolved(p) == resolved(path)) {
            let path = path.display();
            return Err(Error::Argument(format!("{flag} {path}: is the file of {other} too; give each its own")));
        }
        inputs.iter().flatten().try_for_each(|input| keep_input(input, flag, path))?;
        output::check(path)?;
    }
    Ok(())
}

impl RenderArgs {
    fn run(&self) -> Result<()> {
        if let Some(poses) = &self.cameras {
            return self.run_many(poses);
        }
        let begun = Instant::now();
        let size = self.draw.size(self.size, [1280, 720]);
        self.draw.check_projection(size)?;
        self.draw.check_annotate(self.annotate)?;
        let lidar = matches!(self.draw.projection, Projection::Lidar { .. });
        let scan = scan::Kind::of(&self.output).filter(|_| lidar);
        let picture = if scan.is_some() { Picture::Png } else { Picture::of(&self.output)? };
        self.draw.check_sky(picture == Picture::Png, &self.output)?;
        for (flag, file) in [("--depth", &self.depth), ("--voxel", &self.voxel)] {
            if file.as_ref().is_some_and(|file| file.as_os_str() == output::STDOUT) {
                return Err(Error::Argument(format!("{flag}: name the .npy file to write")));
            }
        }
        let beams = scan.map(|_| scan::beams_file(&self.output));
        let outputs = [
            ("--output", named_file(&self.output)),
            ("--depth", self.depth.as_ref()),
            ("--voxel", self.voxel.as_ref()),
            ("--stats", self.stats.as_ref()),
            ("the beams", beams.as_ref()),
        ];
        check_outputs(&[Some(&self.scene)], &outputs)?;
        self.draw.set_threads()?;
        let mut options = self.draw.options();
        let typed = Typed { eye: self.eye, yaw: self.yaw, pitch: self.pitch, roll: self.roll };
        let view = self.draw.view(size);
        let outputs = Outputs { voxel: self.voxel.is_some() };
        let (mut frame, camera, dims, about);
        let mut shows_matter = false;
        match self.draw.residency.open(&self.scene, &shown(&self.input.read), self.draw.skip_broken)? {
            Loaded::Whole { scene, surface } => {
                let pose = self.aim.pose(typed, &scene, view)?;
                let pose = self.draw.looking_round(pose, self.eye, self.pitch, self.aim.is_given(), &scene);
                camera = self.draw.camera(pose, size);
                // Who asks for depths or voxels measures what is there.
                let measured = self.depth.is_some() || self.voxel.is_some();
                let (scene, resident) = self.draw.shared(scene, &surface, measured, &mut options)?;
                shows_matter = resident.matter.is_some();
                let mut renderer = self.draw.renderer(&scene, &resident)?;
                frame = renderer.draw_with(&camera, &options, outputs, &mut tell)?;
                if self.annotate {
                    annotate(&mut frame, &camera, &resident, &surface.about);
                }
                (dims, about) = (scene.dims(), surface.about);
            }
            Loaded::Tiles(tiles) => {
                self.draw.check_tiles(self.annotate)?;
                camera = self.draw.camera(tiles.pose(&self.aim, typed, view)?, size);
                let mut renderer = self.draw.residency.renderer(&tiles, self.draw.device)?;
                renderer.set_count(self.stats.is_some());
                frame = renderer.draw_with(&camera, &options, outputs, &mut tell)?;
                // Scans, which say what they are of, are not made of tiles.
                (dims, about) = (tiles.source.dims(), About::default());
            }
        }

        let mut files = Vec::new();
        match (scan, named_file(&self.output)) {
            (Some(kind), Some(path)) => {
                let rays = Rays::new(&camera, options.projection, dims);
                let bytes = scan::write(kind, &frame, &rays, &about)?;
                files.push(output::write(path, |out| out.write_all(&bytes))?);
                files
                    .push(output::write(&scan::beams_file(path), |out| scan::beams(out, &camera, options.projection))?);
            }
            (_, Some(path)) => files.push(output::write(path, |out| picture.write(out, &frame))?),
            _ => {}
        }
        if let Some(path) = &self.depth {
            files.push(output::write(path, |out| output::npy_depth(out, &frame))?);
        }
        if let Some(path) = &self.voxel {
            files.push(output::write(path, |out| output::npy_voxel(out, &frame))?);
        }
        if let Some(path) = &self.stats {
            files.push(output::write(path, |out| output::json(out, &frame.stats))?);
        }
        for file in files {
            file.finish()?;
        }
        match named_file(&self.output) {
            Some(path) => {
                let [width, height] = size;
                let what = match scan {
                    Some(_) => format!("{} points", frame.depth.iter().filter(|d| d.is_finite()).count()),
                    None => format!("{width} x {height} pixels"),
                };
                Made::new(None, path).tell(begun, &what);
            }
            None => {
                let mut bytes = Vec::new();
                let failed = |e| FileError::io("standard output", "write", e);
                picture.write(&mut bytes, &frame).map_err(failed)?;
                print_bytes(&bytes)?;
            }
        }
        if !shows_matter && frame.depth.iter().all(|d| d.is_infinite()) {
            let dims = dims.map(|v| v.to_string()).join(" x ");
            note!(
                "nothing but sky is in the picture: the scene is {dims} voxels from 0,0,0, the eye is at {:?}",
                camera.eye.to_array()
            );
        }
        Ok(())
    }

    /// A picture from each pose of a file.
    fn run_many(&self, poses: &PathBuf) -> Result<()> {
        let begun = Instant::now();
        let size = self.draw.size(self.size, [1280, 720]);
        self.draw.check_projection(size)?;
        if self.output.as_os_str() == output::STDOUT {
            return Err(Error::Argument("-o -: --cameras makes many pictures; name a folder".into()));
        }
        let stats_file = self.stats.as_ref();
        check_outputs(&[Some(&self.scene), Some(poses)], &[("--stats", stats_file)])?;
        let mut options = self.draw.options();
        let usual = Camera { fov: self.draw.fov(), width: size[0], height: size[1], ..Camera::default() };
        let cameras = cameras::read(poses, &usual)?;
        for (i, camera) in cameras.iter().enumerate() {
            let wrong = |what: String| Error::from(FileError::format(poses, format!("pose {i}: {what}")));
            renderer::check(camera, &options).map_err(|e| wrong(e.to_string()))?;
            if u64::from(camera.width) * u64::from(camera.height) > PIXELS {
                return Err(wrong(format!("{} x {} pixels: at most {PIXELS} in all", camera.width, camera.height)));
            }
        }
        let folder = |given: &Option<PathBuf>| {
            given.as_ref().map(|dir| if dir.as_os_str() == output::STDOUT { self.output.clone() } else { dir.clone() })
        };
        let (depth, voxel) = (folder(&self.depth), folder(&self.voxel));
        for dir in [Some(&self.output), depth.as_ref(), voxel.as_ref()].into_iter().flatten() {
            if dir.exists() && !dir.is_dir() {
                let what = "is a file; --cameras writes into a folder";
                return Err(FileError::format(dir, what).into());
            }
        }
        self.draw.set_threads()?;
        let (scene, surface) = open_scene(&self.scene, &shown(&self.input.read), self.draw.skip_broken)?;
        for dir in [Some(&self.output), depth.as_ref(), voxel.as_ref()].into_iter().flatten() {
            std::fs::create_dir_all(dir).map_err(|e| FileError::io(dir, "make", e))?;
        }
        let (scene, resident) = self.draw.shared(scene, &surface, depth.is_some() || voxel.is_some(), &mut options)?;
        let mut renderer = self.draw.renderer(&scene, &resident)?;
        renderer.set_depth(depth.is_some());
        renderer.set_count(stats_file.is_some());
        let outputs = Outputs { voxel: voxel.is_some() };
        let stats = std::sync::Mutex::new(vec![None; if stats_file.is_some() { cameras.len() } else { 0 }]);
        renderer.draw_each(&cameras, &options, outputs, &|i, frame| {
            let name = |dir: &PathBuf, ending: &str| dir.join(format!("{i:06}.{ending}"));
            let mut files =
                vec![output::write_one_of_many(&name(&self.output, "png"), |out| output::png(out, &frame))?];
            if let Some(dir) = &depth {
                files.push(output::write_one_of_many(&name(dir, "depth.npy"), |out| output::npy_depth(out, &frame))?);
            }
            if let Some(dir) = &voxel {
                files.push(output::write_one_of_many(&name(dir, "voxel.npy"), |out| output::npy_voxel(out, &frame))?);
            }
            for file in files {
                file.finish()?;
            }
            if let Some(stats) = stats.lock().expect("no holder panics").get_mut(i) {
                *stats = Some(frame.stats.clone());
            }
            Ok(Some(frame))
        })?;
        if let Some(file) = stats_file {
            let stats = stats.into_inner().expect("no holder panics");
            output::write(file, |out| output::json(out, &stats))?.finish()?;
        }
        Made::new(None, &self.output).tell(begun, &format!("{} pictures", cameras.len()));
        Ok(())
    }
}

impl ViewshedArgs {
    fn run(&self) -> Result<()> {
        let begun = Instant::now();
        let kind = viewshed::Kind::of(&self.output)?;
        check_outputs(&[Some(&self.scene)], &[("--output", Some(&self.output))])?;
        set_threads(self.threads)?;
        let file = planecast_encoder::cli::open(&self.scene, &self.input.read, false)?.file;
        let about = file.about().clone();
        // Of heights level 0 alone is read.
        let level = match viewshed::heights(&file)? {
            Some(level) => level,
            None => Resident::new(&planecast_encoder::cli::read_scene(&file, false)?).levels.swap_remove(0),
        };
        drop(file);
        let seen = viewshed::viewshed(&level, &self.eye)?;
        for &i in &seen.inside {
            note!("--eye {:?} is inside something solid: it sees its own column", self.eye[i].to_array());
        }
        if kind == viewshed::Kind::Tiff && about.affine.is_none() {
            note!("the scene keeps no georeference of its source: pixels of {} are columns", self.output.display());
        }
        output::write(&self.output, |out| seen.write(kind, out, &about))?.finish()?;
        let all = seen.counts.len();
        let share = seen.seen() as f64 / all as f64 * 100.0;
        let what = format!("{share:.1} % of {all} columns seen from {} places", self.eye.len());
        Made::new(None, &self.output).tell(begun, &what);
        Ok(())
    }
}

impl FlyArgs {
    fn run(&self) -> Result<()> {
        let begun = Instant::now();
        let kind = Kind::of(&self.output, self.encoder.as_ref())?;
        let size = self.draw.size(self.size, [640, 360]);
        self.draw.check_projection(size)?;
        self.draw.check_annotate(self.annotate)?;
        self.draw.check_sky(matches!(kind, Kind::Folder), &self.output)?;
        if !self.plan {
            kind.check(size, self.fps)?;
        }
        let mut outputs = vec![
            ("--save-path", self.save_path.as_ref()),
            ("--stats", self.stats.as_ref()),
            ("--timeline", self.timeline.as_ref()),
        ];
        if !matches!(kind, Kind::Folder | Kind::Stdout) {
            outputs.push(("--output", Some(&self.output)));
        }
        check_outputs(&[Some(&self.scene), self.path.as_ref()], &outputs)?;
        self.draw.set_threads()?;
        let mut options = self.draw.options();
        let given = self
            .path
            .as_ref()
            .map(|file| Path::read(file, self.draw.fov.filter(|_| !self.draw.looks_round()).unwrap_or(60.0)))
            .transpose()?;
        if self.aim.is_given() && (self.path.is_some() || self.tour) {
            let what = "--look-at, --orbit, --fit and --top make a path of their own; leave out --path and --tour";
            return Err(Error::Argument(what.to_owned()));
        }
        let view = self.draw.view(size);
        let held = self.draw.residency.open(&self.scene, &shown(&self.input.read), self.draw.skip_broken)?;
        let (path, content) = match &held {
            Loaded::Whole { scene, surface } => {
                let path = given.or_else(|| self.aim.path(scene, view)).unwrap_or_else(|| tour::tour(scene, view));
                (path, surface.content.clone())
            }
            Loaded::Tiles(tiles) => {
                self.draw.check_tiles(self.annotate)?;
                let preview = &tiles.preview;
                let found = || {
                    let path = preview.aim(&self.aim).path(&preview.scene, view);
                    preview.path(&path.unwrap_or_else(|| tour::tour(&preview.scene, view)))
                };
                (given.unwrap_or_else(found), format!("{} {:?}", tiles.source.name(), tiles.source.dims()))
            }
        };
        if let Some(file) = &self.save_path {
            output::write(file, |out| out.write_all(path.to_json().as_bytes()))?.finish()?;
        }
        let Frames(range, all) = self.frames.clone().unwrap_or(Frames(None, None));
        let frames = all.unwrap_or_else(|| (path.duration() * self.fps).round().clamp(1.0, 1e6) as usize);
        let range = range.unwrap_or(0..frames);
        if self.plan {
            return print(&format!("{}\n", json!({"frames": frames, "segment": segment_frames(size[0], size[1])})));
        }
        if range.end > frames {
            let std::ops::Range { start, end } = range;
            return Err(Error::Argument(format!("--frames {start}..{end}: the film has frames 0..{frames}")));
        }
        let [width, height] = size;
        if kind.is_yuv() && size.map(padded) != size.map(|v| v as usize) {
            let [w, h] = size.map(padded);
            tell(&format!(
                "film of {width} x {height} pixels is written as {w} x {h}, its last column and row repeated: 4:2:0 takes even sizes of \
                 at least 16; use --size {w}x{h} to draw them"
            ));
        }
        let cameras: Vec<Camera> = path.poses(frames).iter().map(|p| self.draw.camera(*p, size)).collect();
        for camera in &cameras {
            renderer::check(camera, &options).map_err(|e| match (e, &self.path) {
                (Error::Argument(what), Some(file)) => FileError::format(file, what).into(),
                (e, _) => e,
            })?;
        }

        let mut whole = None;
        let mut renderer = match held {
            Loaded::Whole { scene, surface } => {
                let (scene, resident) = self.draw.shared(scene, &surface, false, &mut options)?;
                let renderer = self.draw.renderer(&scene, &resident)?;
                whole = Some((resident, surface.about));
                renderer
            }
            Loaded::Tiles(tiles) => self.draw.residency.renderer(&tiles, self.draw.device)?,
        };
        renderer.set_count(self.stats.is_some() || self.timeline.is_some());
        renderer.set_depth(self.annotate);
        let mut timeline = self.timeline.as_ref().map(|_| Timeline::new(options.lod));
        let spherical = self.draw.projection == Projection::Equirect;
        if spherical && size[0] != 2 * size[1] {
            tell("players show a film of the whole sphere as twice as wide as high; --size 3840x1920 is");
        }
        let film = Film {
            spherical,
            output: &self.output,
            kind,
            cameras: &cameras,
            range: range.clone(),
            fps: self.fps,
            resume: self.resume,
            source: json!({
                "scene": content,
                "device": renderer.name(),
                "options": format!("{options:?}{}", if self.annotate { ", annotated" } else { "" }),
            }),
            stop: stop_on_ctrl_c(),
        };
        let draw = &mut |cameras: &[Camera], spare: Option<Frame>| {
            renderer.reuse(spare);
            let at = Instant::now();
            let mut frame = renderer.draw_first(cameras, &options, Outputs::default(), &mut tell)?;
            if let Some(timeline) = &mut timeline {
                timeline.push(film.range.end - cameras.len(), at.elapsed().as_secs_f64() * 1e3, &frame.stats);
            }
            if let (true, Some((resident, about))) = (self.annotate, &whole) {
                annotate(&mut frame, &cameras[0], resident, about);
            }
            Ok(frame)
        };
        let outcome = fly::fly(&film, draw)?;
        if let (Some(file), Some(timeline)) = (&self.timeline, timeline) {
            output::write(file, |out| out.write_all(timeline.csv().as_bytes()))?.finish()?;
        }
        if let (Some(file), Some(stats)) = (&self.stats, &outcome.stats) {
            output::write(file, |out| output::json(out, stats))?.finish()?;
        }
        if outcome.frames < range.len() && !outcome.closed {
            let resumes = matches!(film.kind, Kind::Mp4(_) | Kind::Folder);
            return Err(Error::Limit(format!(
                "stopped with {} of {} frames in {}{}",
                outcome.frames,
                range.len(),
                self.output.display(),
                if resumes { "; the same command with --resume goes on" } else { "" }
            )));
        }
        if let Some(path) = named_file(&self.output) {
            let [width, height] = size;
            Made::new(None, path).tell(begun, &format!("{} frames of {width} x {height} pixels", outcome.frames));
        }
        Ok(())
    }
}

impl JoinArgs {
    fn run(&self) -> Result<()> {
        let inputs: Vec<Option<&PathBuf>> = self.segments.iter().map(Some).collect();
        check_outputs(&inputs, &[("--output", Some(&self.output))])?;
        if Kind::of(&self.output, None)? != Kind::of(FilePath::new("x.mp4"), None)? {
            return Err(Error::Argument(format!("-o {}: parts are put together to an .mp4", self.output.display())));
        }
        let frames = fly::join(&self.segments, &self.output)?;
        tell(&format!("{}: {frames} frames of {} parts", self.output.display(), self.segments.len()));
        Ok(())
    }
}

/// Words that say how an input is read, as `command` calls them.
fn words_of(command: &str, words: &[Vec<String>]) -> Vec<Vec<String>> {
    let cli = help::command();
    InputArgs::words_of(cli.find_subcommand(command).expect("one of planecast's"), words)
}

impl ViewArgs {
    fn run(&self) -> Result<()> {
        if self.draw.projection != Projection::Perspective {
            let name = self.draw.projection;
            return Err(Error::Argument(format!("--projection {name}: a window shows perspective; use render or fly")));
        }
        self.draw.check_projection(self.window)?;
        self.draw.set_threads()?;
        view::view(view::Settings {
            input: self.input.clone(),
            how: crate::world::OpenOptions {
                read: shown(&self.input_options.read),
                skip_broken: self.draw.skip_broken,
                specialize: self.draw.specialize,
            },
            reading: view::Reading {
                render: words_of("render", &self.input_options.words),
                fly: words_of("fly", &self.input_options.words),
            },
            residency: self.draw.residency.options(view::PATIENCE),
            eye: self.eye,
            yaw: self.yaw,
            pitch: self.pitch,
            roll: self.roll,
            aim: self.aim,
            fov: self.draw.fov(),
            device: self.draw.device,
            kernel: self.draw.kernel.clone(),
            options: self.draw.options(),
            smooth: self.draw.smooth.map(|smooth| smooth == Switch::On),
            size: self.window,
            full_screen: self.full_screen,
            target_fps: self.target_fps,
            screenshot_size: self.screenshot_size,
            script: self.script.clone(),
        })
    }
}

#[cfg(feature = "report")]
impl BenchArgs {
    fn run(&self) -> Result<()> {
        let settings = bench::Settings {
            output: self.output.clone(),
            parts: if self.only.is_empty() { Part::ALL.into() } else { self.only.clone() },
            device: self.device,
            extent: if self.quick { Extent::QUICK } else { Extent::FULL },
            files: self.scene.iter().cloned().collect(),
        };
        bench::run(&settings, &mut tell)
    }
}

#[cfg(feature = "report")]
impl ReportArgs {
    fn run(&self) -> Result<()> {
        set_threads(self.threads)?;
        let Some(scene) = &self.scene else {
            return self.stability();
        };
        let outcome = self.outcome(scene, &mut tell)?;
        outcome.map_or(Ok(()), |text| print(&(text + "\n")))
    }

    /// What was chosen, if a choice was asked for; of a world in tiles the result.
    fn outcome(&self, scene: &FilePath, tell: &mut dyn FnMut(&str)) -> Result<Option<String>> {
        let path = self.path.as_ref().map(|file| Path::read(file, self.fov)).transpose()?;
        let base = Options {
            view_distance: self.view_distance.unwrap_or(f64::INFINITY),
            repeat: self.repeat.axes(),
            ..Options::default()
        };
        if self.stream {
            return self.streamed(scene, path, base, tell).map(Some);
        }
        let job = report::Job {
            folder: &self.output,
            quick: self.quick,
            path: path.as_ref(),
            size: self.size,
            rounds: self.rounds,
            fov: self.fov,
            device: self.device,
            base,
            budget_ms: self.budget_ms,
            max_error: self.max_error,
        };
        report::report(scene, &self.input.read, &job, tell)
    }

    fn streamed(
        &self,
        scene: &FilePath,
        path: Option<Path>,
        options: Options,
        tell: &mut dyn FnMut(&str),
    ) -> Result<String> {
        let Tiles { source, preview, tint, .. } = residency::tiles(scene, &self.input.read)?;
        let path = path.unwrap_or_else(|| preview.path(&tour::across(&preview.scene, self.fov)));
        let flight =
            Flight::new(path).map_err(|what| FileError::format(self.path.as_deref().unwrap_or(scene), what))?;
        let name = scene.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let job = stream::Job {
            folder: &self.output,
            quick: self.quick,
            size: self.size,
            device: self.device,
            options,
            memories: &self.memory,
        };
        stream::report(&stream::run::World { name, source, tint }, &flight, &job, tell)
    }

    fn stability(&self) -> Result<()> {
        std::fs::create_dir_all(&self.output).map_err(|e| FileError::io(&self.output, "make", e))?;
        let rows = stability::run(self.device, &mut tell)?;
        let rows = stability::present::with_earlier(&self.output, rows)?;
        let walks = matches!(self.device, Device::Cpu | Device::Auto).then(stability::walks::walks);
        if let Some(fault) = walks.as_ref().and_then(|w| w.faults.first()) {
            return Err(Error::Limit(format!("walks in f32: {fault}")));
        }
        report::present::write(&self.output, &stability::present::files(&rows, walks.as_ref()))?;
        match rows.iter().filter(|r| !r.faults.is_empty()).count() {
            0 => Ok(()),
            n => Err(Error::Limit(format!(
                "{n} of {} rows are out of their bounds; {} says which",
                rows.len(),
                self.output.join("stability.md").display()
            ))),
        }
    }
}

/// A flag that Ctrl-C sets; a second one ends the program at once.
fn stop_on_ctrl_c() -> &'static AtomicBool {
    static STOP: AtomicBool = AtomicBool::new(false);
    // A handler that cannot be set leaves Ctrl-C as it was: it ends the program, and whole parts stay.
    _ = ctrlc::set_handler(|| {
        if STOP.swap(true, Ordering::Relaxed) {
            guard::leave(1);
        }
        note!("stopping: what is drawn is still being saved; Ctrl-C again ends at once");
    });
    &STOP
}

/// For commands that have nothing to bring to an end: Ctrl-C ends them with one line, and leaves no file that is not whole.
fn end_on_ctrl_c() {
    _ = ctrlc::set_handler(|| {
        guard::last_word();
        say!("planecast: interrupted; what it was to write is as it was before");
        guard::leave(1);
    });
}

impl PickArgs {
    fn run(&self) -> Result<()> {
        let report = pick::report(&open_scene(&self.scene, &self.input.read, false)?.0, self.from, self.dir)?;
        print(&(serde_json::to_string(&report).expect("plain values have a JSON form") + "\n"))
    }
}

/// Standard output, where a reader that has seen enough (`| head`) is no error.
pub(crate) fn print(text: &str) -> Result<()> {
    print_bytes(text.as_bytes())
}

fn print_bytes(bytes: &[u8]) -> Result<()> {
    let mut out = io::stdout().lock();
    match out.write_all(bytes).and_then(|()| out.flush()) {
        Err(e) if e.kind() != io::ErrorKind::BrokenPipe => Err(FileError::io("standard output", "write", e).into()),
        _ => Ok(()),
    }
}

/// Runs the command with the program's arguments, the program's name first. Errors go to stderr.
pub fn run(args: impl IntoIterator<Item = impl AsRef<OsStr>>) -> ExitCode {
    let args = join_negative(args.into_iter().map(|a| a.as_ref().to_owned()));
    if args.len() <= 1 {
        return exit(print(help::SHORT));
    }
    if args.iter().any(|arg| matches!(arg.to_str(), Some("-q" | "--quiet"))) {
        say::be_quiet();
    }
    let parse = |args| help::command().try_get_matches_from(args).and_then(|matches| Cli::from_arg_matches(&matches));
    let cli = match opens(args).and_then(parse) {
        Ok(cli) => cli,
        Err(e) if !e.use_stderr() => {
            let text = e.render();
            let text = if io::stdout().is_terminal() { text.ansi().to_string() } else { text.to_string() };
            return exit(print(&text));
        }
        Err(e) => {
            say!("planecast: {}", plain(&e));
            return ExitCode::from(2);
        }
    };
    guard::explain_lost_files();
    if !matches!(cli.command, Command::Encode(_) | Command::Merge(_) | Command::Fly(_)) {
        end_on_ctrl_c();
    }
    exit(match cli.command {
        Command::Encode(args) => args.run().map_err(Error::from),
        Command::Merge(args) => args.run().map_err(Error::from),
        Command::World(args) => args.run().map_err(Error::from),
        Command::Verify(args) => args.run().map_err(Error::from),
        Command::Decode(args) => args.run().map_err(Error::from),
        Command::Info(args) => args.run().map_err(Error::from).inspect(|()| {
            if !args.json {
                // Nobody may be listening any more.
                let _ = writeln!(
                    io::stdout(),
                    "\nprogram   no GPU driver and no film encoder loaded; {}",
                    features_built()
                );
            }
        }),
        Command::Query(args) => args.run().map_err(Error::from),
        Command::Render(args) => args.run(),
        Command::Fly(args) => args.run(),
        Command::Join(args) => args.run(),
        Command::Viewshed(args) => args.run(),
        Command::View(args) => args.run(),
        Command::Pick(args) => args.run(),
        Command::Demo(args) => demo::demo(&args.output),
        #[cfg(feature = "report")]
        Command::Bench(args) => args.run(),
        #[cfg(feature = "report")]
        Command::Report(args) => args.run(),
        Command::Completions(args) => args.run(),
        Command::Man(args) => args.run(),
    })
}

/// `planecast FILE …` as the command that opens it: the window where one can be shown, else a picture beside it.
fn opens(mut args: Vec<OsString>) -> Result<Vec<OsString>, clap::Error> {
    let is_flag = |arg: &OsString| arg.as_encoded_bytes().starts_with(b"-");
    let Some(at) = args.iter().skip(1).position(|arg| !matches!(arg.to_str(), Some("-q" | "--quiet"))).map(|i| i + 1)
    else {
        return Ok(args);
    };
    let first = &args[at];
    let command = first
        .to_str()
        .is_some_and(|name| name == "help" || help::command().get_subcommands().any(|c| c.get_name() == name));
    if is_flag(first) || command {
        return Ok(args);
    }
    let name = PathBuf::from(first);
    if !planecast_encoder::encode::open::is_there(&name) {
        // What has an ending or a folder is a file's name; anything else may be a command, mistyped.
        if name.extension().is_some() || name.components().count() > 1 {
            let what = format!("{}: there is no such file, and no command of this name\n", name.display());
            return Err(clap::Error::raw(clap::error::ErrorKind::InvalidSubcommand, what));
        }
        return Ok(args);
    }
    let set = |name| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    let shown = set("DISPLAY") || set("WAYLAND_DISPLAY") || cfg!(any(target_os = "macos", windows));
    let window = cfg!(feature = "view") && shown;
    args.insert(at, if window { "view" } else { "render" }.into());
    let given = args.iter().any(|arg| matches!(arg.to_str(), Some("-o" | "--output")));
    if !window && !given {
        let text = name.to_string_lossy();
        let elsewhere = planecast_encoder::encode::open::is_procedural(&name) || text.contains("://");
        let beside = match elsewhere {
            true => {
                let path = text.split('?').next().unwrap_or_default().trim_end_matches('/');
                PathBuf::from(path.rsplit(['/', ':']).next().unwrap_or("picture"))
            }
            false => name.clone(),
        };
        let still = beside.with_extension("png");
        // A picture that is the input itself is not written over.
        let still = if still == name { beside.with_extension("still.png") } else { still };
        let why = if cfg!(feature = "view") { "there is no display for a window" } else { "built without its window" };
        note!("{why}: drawing {} instead", still.display());
        args.extend(["-o".into(), still.into_os_string()]);
    }
    Ok(args)
}

/// `--flag -5,3` as `--flag=-5,3`: clap takes what starts with a hyphen for a flag. (Told to allow hyphens in values,
/// it would take a flag for the value where one was forgotten.)
fn join_negative(args: impl Iterator<Item = OsString>) -> Vec<OsString> {
    let mut joined: Vec<OsString> = Vec::new();
    for arg in args {
        let number = matches!(arg.as_encoded_bytes(), [b'-', b'0'..=b'9' | b'.', ..]);
        let flag = |last: &OsString| last.as_encoded_bytes().starts_with(b"--") && last.len() > 2;
        match joined.last_mut() {
            Some(last) if number && flag(last) && !last.as_encoded_bytes().contains(&b'=') => {
                last.push("=");
                last.push(arg);
            }
            _ => joined.push(arg),
        }
    }
    joined
}

/// What clap has to say, on one line: its first paragraph.
fn plain(error: &clap::Error) -> String {
    if error.kind() == clap::error::ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand {
        return "a command is missing; planecast --help lists them".into();
    }
    let text = error.render().to_string();
    let mut paragraphs = text.split("\n\n");
    let first = paragraphs.next().unwrap_or_default();
    // "tip: a similar argument exists: …"
    let tips = paragraphs.filter(|p| p.trim_start().starts_with("tip: ") && p.contains("similar"));
    let line = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
    let tips: String = tips.map(|tip| format!("; {}", line(tip).trim_start_matches("tip: "))).collect();
    line(first.trim_start_matches("error: ")) + &tips
}

fn exit(done: Result<()>) -> ExitCode {
    let Err(error) = done else { return ExitCode::SUCCESS };
    guard::last_word();
    say!("planecast: {error}");
    match error {
        Error::Argument(_) => ExitCode::from(2),
        Error::Scene(e) => ExitCode::from(planecast_encoder::cli::exit_status(&e)),
        _ => ExitCode::FAILURE,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::film::path::Pose;

    fn parse(line: &str) -> Result<Cli, String> {
        let args = opens(join_negative(line.split_whitespace().map(OsString::from)));
        let parse = |args| help::command().try_get_matches_from(args).and_then(|m| Cli::from_arg_matches(&m));
        args.and_then(parse).map_err(|e| plain(&e))
    }

    #[test]
    fn words_that_say_how_an_input_is_read_have_the_names_of_the_command_they_are_for() {
        let line = "planecast view mesh.stl --yaw 30 --height-scale 0.1 --colors=a.png --device cpu --iso=-20 --input-spacing as-is \
                    --full-screen --window 320x200 --input-window=-5,9 --classes 32 --fill --voxel 2";
        let Command::View(view) = parse(line).unwrap().command else { panic!("not view") };
        let words = |command| {
            let mut words: Vec<String> = words_of(command, &view.input_options.words).into_iter().flatten().collect();
            words.sort();
            words
        };
        let both = ["--classes=32", "--colors=a.png", "--fill", "--height-scale=0.1", "--input-spacing=as-is"];
        assert_eq!(words("render"), [&both[..], &["--input-voxel=2", "--iso=-20", "--window=-5,9"]].concat());
        assert_eq!(words("fly"), [&both[..], &["--iso=-20", "--voxel=2", "--window=-5,9"]].concat());
        for command in ["render", "fly"] {
            let line = format!("planecast {command} mesh.stl -o o.png {}", words(command).join(" "));
            let read = match parse(&line).unwrap().command {
                Command::Render(args) => args.input.read,
                Command::Fly(args) => args.input.read,
                other => panic!("{other:?}"),
            };
            assert_eq!(format!("{read:?}"), format!("{:?}", view.input_options.read), "{line}");
        }
    }

    fn render(flags: &str) -> RenderArgs {
        match parse(&format!("planecast render s.pcast -o o.png {flags}")).unwrap().command {
            Command::Render(args) => args,
            other => panic!("{other:?}"),
        }
    }

    fn refused(flags: &str) -> String {
        parse(&format!("planecast render s.pcast -o o.png {flags}")).unwrap_err()
    }

    #[test]
    fn cli_definition_is_sound() {
        help::command().debug_assert();
    }

    #[test]
    fn cli_takes_negative_values_with_a_space_or_an_equals_sign() {
        for flags in
            ["--eye -5,3,-2 --yaw -30 --pitch -9e1 --roll -.5", "--eye=-5,3,-2 --yaw=-30 --pitch=-9e1 --roll=-.5"]
        {
            let args = render(flags);
            assert_eq!(args.eye, Some(DVec3::new(-5.0, 3.0, -2.0)), "{flags}");
            assert_eq!((args.yaw, args.pitch, args.roll), (Some(-30.0), Some(-90.0), -0.5), "{flags}");
        }
        let Command::Pick(args) = parse("planecast pick s.pcast --from -1,-2,-3 --dir -0.5,0,1e-3").unwrap().command
        else {
            panic!()
        };
        assert_eq!((args.from.y, args.dir), (-2.0, DVec3::new(-0.5, 0.0, 1e-3)));
    }

    #[test]
    fn cli_swallows_no_flag_as_a_value() {
        let args = render("--eye -5,3,-2 --yaw 30 --size 7x5");
        assert_eq!((args.yaw, args.size), (Some(30.0), Some([7, 5])));
        assert_eq!(refused("--eye --yaw 30"), "a value is required for '--eye <X,Y,Z>' but none was supplied");
        assert!(refused("--yaw --pitch 3").starts_with("a value is required for '--yaw <D>'"));
    }

    #[test]
    fn cli_resolves_every_drawing_flag() {
        let usual = render("").draw.options();
        assert_eq!(usual, Options::default());
        let all = "--view-distance 40000 --repeat xz --lod off --planes 50% --spacing readjusted --samples 150% --cull horizon,bits \
                   --equidistant 900 --remap nearest --no-gap-fill --f64 --shading ssao --ssao-samples 5 --fog 2500 \
                   --sun 315,-4.5 --shadows on --normals derived --smooth on --sky none --specialize heights,upright";
        let expected = Options {
            view_distance: 40_000.0,
            repeat: Repeat { x: true, z: true },
            lod: None,
            planes: Planes::Factor(0.5),
            readjust: true,
            samples: 1.5,
            culling: Culling { horizon: true, bits: true, ..Culling::NONE },
            equidistant: Some(900.0),
            remap: Remap::Nearest,
            gap_fill: false,
            f64_traversal: true,
            shading: Shading::Ssao,
            ssao_samples: 5,
            fog: Some(2500.0),
            sun: Some([315.0, -4.5]),
            shadows: true,
            normals: Normals::Derived,
            smooth: true,
            sky: false,
            specialize: [crate::Feature::Heights, crate::Feature::Upright].into_iter().collect(),
            projection: Projection::Perspective,
        };
        assert_eq!(render(all).draw.options(), expected);
        assert_eq!(render("--planes 77 --lod 2.5 --cull none").draw.options().planes, Planes::Count(77));
    }

    #[test]
    fn cli_presets_stand_in_place_of_their_flags() {
        for preset in Preset::ALL {
            let flags = format!("--preset {} --cull none", preset.name());
            let expected = preset.options(Options { culling: Culling::NONE, ..Options::default() });
            assert_eq!(render(&flags).draw.options(), expected);
            assert!(refused(&format!("{flags} --lod 2")).contains("cannot be used with"));
        }
    }

    #[test]
    fn cli_flags_that_options_give_draw_with_them() {
        let all = "--view-distance 40000.25 --repeat x --lod 0.7 --planes 55.5% --spacing full --samples 62.5% --cull horizon,coarse \
                   --equidistant 900.5 --remap nearest --no-gap-fill --f64 --shading ssn --ssao-samples 5 --fog 2500.125 --sun=-45.5,0.1 --shadows on --normals derived --smooth on --sky none --specialize heights,packed";
        for flags in ["", all, "--planes 7 --lod off --cull none --repeat xz --shading none"] {
            let options = render(flags).draw.options();
            assert_eq!(render(&options.flags()).draw.options(), options, "{}", options.flags());
        }
        let pose =
            Pose { eye: DVec3::new(0.1 + 0.2, -1e-9, 1e7 / 3.0), yaw: 359.9, pitch: -1.0 / 3.0, roll: -0.0, fov: 60.1 };
        let args = render(&view::pose_flags(&pose));
        let typed = (args.eye, args.yaw, args.pitch, args.roll, args.draw.fov);
        assert_eq!(typed, (Some(pose.eye), Some(pose.yaw), Some(pose.pitch), pose.roll, Some(pose.fov)));
    }

    #[cfg(feature = "report")]
    #[test]
    fn cli_flags_of_a_report_draw_what_it_measured() {
        use crate::measure::report::sweep::{Backend, configs};
        for config in configs(512, &Options::default(), &["workgroup"], false) {
            let flags = config.flags();
            let args = render(&flags);
            assert_eq!(args.draw.options(), config.options, "{flags}");
            let device = match config.backend {
                Backend::Gpu(_) => Device::Gpu,
                Backend::Exact => Device::Exact,
                _ => Device::Cpu,
            };
            assert_eq!(args.draw.device, device, "{flags}");
        }
    }

    #[test]
    fn cli_refuses_what_cannot_be_drawn() {
        for (flags, what) in [
            ("--pitch 90.1", "expected -90 to 90 degrees"),
            ("--pitch nan", "expected a finite number"),
            ("--fov=-1", "expected 0 to 360 degrees"),
            ("--fov 361", "expected 0 to 360 degrees"),
            ("--eye 1,2", "expected three numbers"),
            ("--eye 1,2,inf", "expected three numbers"),
            ("--size 0x5", "each 1 to 16384"),
            ("--size 16385x5", "each 1 to 16384"),
            ("--size 16384x16384", "at most 67108864 pixels"),
            ("--size 640", "expected WxH"),
            ("--samples 0%", "a percentage above 0%"),
            ("--samples 801%", "a percentage above 0%"),
            ("--samples 2", "a percentage above 0%"),
            ("--planes 0", "a number of planes from 1"),
            ("--planes -5", "a number of planes from 1"),
            ("--planes 0%", "a percentage"),
            ("--lod 0", "expected pixels above 0, or off"),
            ("--view-distance -1", "expected a number above 0"),
            ("--cull horizont", "a list of horizon,center,forward,bits,coarse"),
            ("--repeat y", "possible values: none, x, z, xz"),
            ("--device tpu", "possible values: auto, gpu, gpu:all, cpu, exact"),
            ("--threads 0", "0 is not in 1..=1024"),
            ("--nosuch", "unexpected argument '--nosuch' found"),
        ] {
            let error = refused(flags);
            assert!(error.contains(what) && !error.contains('\n'), "{flags}: {error}");
        }
        assert_eq!(parse("planecast").unwrap_err(), "a command is missing; planecast --help lists them");
        assert!(parse("planecast fly s -o d --path p.json --tour").unwrap_err().contains("cannot be used with"));
        assert!(parse("planecast render s.pcast").unwrap_err().ends_with("not provided: --output <OUT.png|-|DIR>"));
    }

    #[test]
    fn cli_gives_each_output_its_own_file() {
        let (a, b) = (PathBuf::from("a.png"), PathBuf::from("b.npy"));
        let error =
            check_outputs(&[], &[("--output", Some(&a)), ("--depth", Some(&b)), ("--voxel", Some(&b))]).unwrap_err();
        assert_eq!(error.to_string(), "--voxel b.npy: is the file of --depth too; give each its own");
    }
}
