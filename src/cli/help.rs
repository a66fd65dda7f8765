//! What the command line shows of itself: examples, groups of flags, manual pages, completions, the version.

use std::path::{Path, PathBuf};

use clap::{Args, Command, CommandFactory};
use planecast_encoder::Error as FileError;

use crate::cli::{Cli, features_built, print};
use crate::{Result, output};

/// `planecast` alone.
pub const SHORT: &str = "\
planecast draws voxel worlds: terrains, volumes, point clouds, meshes, models.

  planecast dem.tif                              open it: a window, or a still beside it
  planecast render dem.tif -o dem.png            draw a picture
  planecast fly dem.tif -o flight.mp4            fly over it
  planecast info scan.nii.gz                     say what it is and how it is read
  planecast encode dem.tif -o dem.pcast          keep it as a scene, which opens at once

planecast --help lists all commands, planecast COMMAND --help what one can do.
";

/// By command, what its help begins with.
const EXAMPLES: &[(&str, &str)] = &[
    (
        "encode",
        "  planecast encode dem.tif -o dem.pcast
  planecast encode scan.raw --dims 256,256,113 --dtype u16 --iso 1150 -o scan.pcast
  planecast encode https://example.org/bunny.ply --size 1024 -o bunny.pcast",
    ),
    ("merge", "  planecast merge part0 part1 part2 -o whole.pcast"),
    ("verify", "  planecast verify dem.pcast\n  planecast verify https://example.org/dem.pcast --deep"),
    ("decode", "  planecast decode scan.pcast -o scan.raw"),
    ("info", "  planecast info dem.pcast\n  planecast info scan.nii.gz --json"),
    ("query", "  planecast query dem.pcast 10 25 300"),
    (
        "render",
        "  planecast render dem.pcast -o dem.png
  planecast render knight.vox -o knight.png --orbit 30,-20
  planecast render dem.tif -o map.png --top --size 1920x1080
  planecast render dem.pcast -o all.png --projection equirect --eye 10,90,200
  planecast render dem.pcast --cameras poses.json -o pictures --depth
  planecast render dem.pcast -o - --eye 10,90,200 --yaw 30 --pitch -15 >dem.png",
    ),
    (
        "fly",
        "  planecast fly dem.pcast -o flight.mp4
  planecast fly knight.vox -o turn.mp4 --orbit 0,-20
  planecast fly dem.pcast -o frames --path path.json --frames 300",
    ),
    ("join", "  planecast join part0.mp4 part1.mp4 -o film.mp4"),
    ("viewshed", "  planecast viewshed dem.pcast --eye 500,130,500 -o seen.tif"),
    ("view", "  planecast view dem.pcast\n  planecast view scan.nii.gz --iso 300"),
    ("pick", "  planecast pick dem.pcast --from 10,200,10 --dir 0,-1,0"),
    ("demo", "  planecast demo\n  planecast demo -o folder"),
    ("bench", "  planecast bench --quick -o bench"),
    (
        "report",
        "  planecast report dem.pcast -o report --quick
  planecast report --stream dem.pcast -o stream --quick
  planecast report --stability -o stability",
    ),
    ("completions", "  planecast completions bash >~/.local/share/bash-completion/completions/planecast"),
    ("world", "  planecast world north.pcast south.pcast -o land.pworld --across 1"),
    ("man", "  planecast man -o ~/.local/share/man/man1"),
];

/// Groups of flags, by their names; what is in none of them stays where it is.
const GROUPS: &[(&str, &[&str])] = &[
    (
        "Camera",
        &[
            "eye",
            "yaw",
            "pitch",
            "roll",
            "fov",
            "look-at",
            "orbit",
            "fit",
            "top",
            "path",
            "tour",
            "cameras",
            "projection",
        ],
    ),
    (
        "Picture",
        &[
            "size",
            "shading",
            "fog",
            "sun",
            "shadows",
            "sky",
            "view-distance",
            "repeat",
            "frames",
            "fps",
            "ramp",
            "exaggeration",
            "smooth",
            "annotate",
            "encoder",
            "window",
            "full-screen",
            "screenshot-size",
            "transfer",
        ],
    ),
    (
        "Quality",
        &["preset", "lod", "planes", "samples", "remap", "device", "threads", "target-fps", "ssao-samples", "memory"],
    ),
    (
        "Expert",
        &[
            "kernel",
            "spacing",
            "cull",
            "equidistant",
            "no-gap-fill",
            "f64",
            "specialize",
            "skip-broken",
            "script",
            "residency",
            "memory-gpu",
            "stream",
            "timeline",
        ],
    ),
];

/// Commands whose flags are many enough for groups.
const GROUPED: [&str; 3] = ["render", "fly", "view"];

/// The commit that this program was built from, where that is known.
const COMMIT: Option<&str> = option_env!("PLANECAST_COMMIT");

fn version() -> String {
    let commit = COMMIT.map(|commit| format!(" ({commit})")).unwrap_or_default();
    format!("{}{commit}\n{}", env!("CARGO_PKG_VERSION"), features_built())
}

/// The command line with all that its help shows.
pub fn command() -> Command {
    let mut command = Cli::command().version(&*version().leak());
    let names: Vec<String> = command.get_subcommands().map(|c| c.get_name().to_owned()).collect();
    for name in names {
        command = command.mut_subcommand(&name, |mut sub| {
            if let Some((_, examples)) = EXAMPLES.iter().find(|(command, _)| *command == name) {
                sub = sub.before_help(format!("Examples:\n{examples}"));
            }
            if !GROUPED.contains(&&*name) {
                return sub;
            }
            sub.mut_args(|arg| {
                let group = |long: &str| GROUPS.iter().find(|(_, flags)| flags.contains(&long)).map(|g| g.0);
                match arg.get_long().and_then(group) {
                    Some(group) if arg.get_help_heading().is_none() => arg.help_heading(group),
                    _ => arg,
                }
            })
        });
    }
    command
}

/// Print what makes a shell complete planecast's commands and flags
#[derive(Debug, Args)]
pub struct CompletionsArgs {
    /// The shell
    shell: clap_complete::Shell,
}

impl CompletionsArgs {
    pub fn run(&self) -> Result<()> {
        let mut text = Vec::new();
        clap_complete::generate(self.shell, &mut command(), "planecast", &mut text);
        print(&String::from_utf8_lossy(&text))
    }
}

/// Write the manual pages, one a command
#[derive(Debug, Args)]
pub struct ManArgs {
    /// Folder for them; made if it is not there [default: that of planecast alone to standard output]
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
}

impl ManArgs {
    pub fn run(&self) -> Result<()> {
        let mut command = command();
        command.build();
        let failed = |path: &Path, e| FileError::io(path, "write", e);
        let Some(folder) = &self.output else {
            let mut text = Vec::new();
            clap_mangen::Man::new(command).render(&mut text).map_err(|e| failed("standard output".as_ref(), e))?;
            return print(&String::from_utf8_lossy(&text));
        };
        std::fs::create_dir_all(folder).map_err(|e| FileError::io(folder, "create the folder", e))?;
        let mut pages = vec![("planecast.1".to_owned(), command.clone())];
        for sub in command.get_subcommands().filter(|c| c.get_name() != "help") {
            let name = format!("planecast-{}", sub.get_name());
            let examples = sub.get_before_help().cloned().unwrap_or_default();
            pages.push((format!("{name}.1"), sub.clone().name(&*name.leak()).after_help(examples)));
        }
        for (name, page) in pages {
            output::write(&folder.join(name), |out| clap_mangen::Man::new(page).render(out))?.finish()?;
        }
        Ok(())
    }
}
