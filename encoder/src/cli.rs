//! Commands on scene files, shared by `planecast` and `planecast-encode`.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use crate::build::UNCOLORED;
use crate::decode::decode_to_raw;
use crate::source::{self, ReadOptions};
use crate::write::{keep_input, write_scene};
use crate::{BuildOptions, ColorMode, Colors, Encoding, Error, MipRule, PcastFile, Result, build, info};

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
    #[arg(short, long, value_name = "SCENE.pcast")]
    pub output: PathBuf,
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
}

impl EncodeArgs {
    pub fn run(&self) -> Result<()> {
        for input in [Some(&self.input), self.read.colors.as_ref()].into_iter().flatten() {
            keep_input(input, "--output", &self.output)?;
        }
        let mut input = source::open(&self.input, &self.read)?;
        if matches!((&input.colors, self.color), (Colors::None, Some(ColorMode::Run | ColorMode::Voxel))) {
            input.colors = Colors::Function(Box::new(|_, _, _| UNCOLORED));
            input.notes.push("the input has no colours: all voxels are grey".to_owned());
        }
        input.notes.iter().for_each(|note| eprintln!("note: {note}"));
        let opts = BuildOptions { encoding: self.encoding, color: self.color, mip_rule: self.mip_rule };
        write_scene(&build(input, &opts)?, &self.output)
    }
}

/// Write a scene's occupancy as a raw volume: bytes 0 and 1, x fastest, then y, then z
#[derive(Clone, Debug, clap::Args)]
pub struct DecodeArgs {
    /// Scene file (.pcast)
    pub scene: PathBuf,
    /// Raw volume to write
    #[arg(short, long, value_name = "VOLUME.raw")]
    pub output: PathBuf,
}

impl DecodeArgs {
    pub fn run(&self) -> Result<()> {
        keep_input(&self.scene, "--output", &self.output)?;
        decode_to_raw(&PcastFile::open(&self.scene)?.read_scene()?, &self.output)
    }
}

/// Show what a scene holds and how many bytes it takes
#[derive(Clone, Debug, clap::Args)]
pub struct InfoArgs {
    /// Scene file (.pcast)
    pub scene: PathBuf,
    /// As one JSON object
    #[arg(long)]
    pub json: bool,
}

impl InfoArgs {
    pub fn run(&self) -> Result<()> {
        let info = info::info(&PcastFile::open(&self.scene)?)?;
        print(&if self.json { json(&info) } else { info.to_string() })
    }
}

/// Look up one voxel of level 0
#[derive(Clone, Debug, clap::Args)]
pub struct QueryArgs {
    /// Scene file (.pcast)
    pub scene: PathBuf,
    /// Voxel; outside the world is air
    #[arg(allow_negative_numbers = true, value_parser = whole)]
    pub x: i64,
    #[arg(allow_negative_numbers = true, value_parser = whole)]
    pub y: i64,
    #[arg(allow_negative_numbers = true, value_parser = whole)]
    pub z: i64,
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
        let voxel = PcastFile::open(&self.scene)?.query(self.x, self.y, self.z)?;
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
