//! The command line's flags by name and value, for those who call the library from another language: the same words, checks
//! and defaults as typed.

use std::ops::Range;

use clap::{FromArgMatches, Subcommand};
use planecast_encoder::encode::EncodeOptions;
use planecast_encoder::source::ReadOptions;
use planecast_encoder::{BuildOptions, Scene};

use super::{Command, DrawArgs, Frames, RenderArgs, plain};
use crate::film::path::Path;
use crate::film::tour;
use crate::film::video::Encoder;
use crate::frame::aim::{AimArgs, Typed};
use crate::render::device::Device;
use crate::{Camera, Error, Options, Result};

/// What `render` was told.
#[derive(Clone, Debug)]
pub struct Picture {
    pub camera: Camera,
    pub options: Options,
    pub device: Device,
    pub kernel: Option<String>,
}

/// What `fly` was told.
#[derive(Clone, Debug)]
pub struct Flight {
    pub cameras: Vec<Camera>,
    /// Of the frames, which to draw.
    pub range: Range<usize>,
    pub fps: f64,
    pub encoder: Option<Encoder>,
    pub options: Options,
    pub device: Device,
    pub kernel: Option<String>,
}

/// Words as a command takes them: `--name=value`, or `--name` alone.
fn command(name: &str, places: &[&str], words: &[String]) -> Result<Command> {
    let line = std::iter::once(name).chain(words.iter().map(String::as_str)).chain(places.iter().copied());
    let parser = Command::augment_subcommands(clap::Command::new("planecast")).no_binary_name(true);
    let found = parser.disable_help_flag(true).try_get_matches_from(line);
    found.and_then(|matches| Command::from_arg_matches(&matches)).map_err(|e| Error::Argument(plain(&e)))
}

/// What `encode` would do with these words: how to read, and how to encode.
///
/// # Errors
/// [`Error::Argument`] says which word was wrong, and what is allowed.
pub fn encoding(words: &[String]) -> Result<(ReadOptions, EncodeOptions)> {
    let Command::Encode(args) = command("encode", &["--output=world.pcast", "--", "world"], words)? else {
        unreachable!("the command is encode");
    };
    let build = BuildOptions { encoding: args.encoding, color: args.color, mip_rule: args.mip_rule };
    let options = EncodeOptions {
        build,
        features: args.specialize,
        memory: args.memory,
        compress: args.zstd,
        ..EncodeOptions::default()
    };
    Ok((args.read, options))
}

/// What `render` would draw of a scene, told by these words.
///
/// # Errors
/// As [`encoding`].
pub fn picture(words: &[String], scene: &Scene) -> Result<Picture> {
    let Command::Render(args) = command("render", &["--output=picture.png", "--", "world"], words)? else {
        unreachable!("the command is render");
    };
    let RenderArgs { eye, yaw, pitch, roll, size, draw, aim, .. } = args;
    let size = draw.size(size, [1280, 720]);
    draw.check_projection(size)?;
    let pose = aim.pose(Typed { eye, yaw, pitch, roll }, scene, draw.view(size))?;
    let camera = draw.camera(draw.looking_round(pose, eye, pitch, aim.is_given(), scene), size);
    let options = draw.options();
    let DrawArgs { device, kernel, .. } = draw;
    Ok(Picture { camera, options, device, kernel })
}

/// What `fly` would film of a scene, told by these words; `path` is a path file's text.
///
/// # Errors
/// As [`encoding`].
pub fn flight(words: &[String], path: Option<&str>, scene: &Scene) -> Result<Flight> {
    let Command::Fly(args) = command("fly", &["--output=film.mp4", "--", "world"], words)? else {
        unreachable!("the command is fly");
    };
    let size = args.draw.size(args.size, [640, 360]);
    args.draw.check_projection(size)?;
    let view = args.draw.view(size);
    let given = path.map(|text| Path::parse(text, view.fov).map_err(|e| Error::Argument(format!("path: {e}"))));
    let path = match given.transpose()? {
        Some(path) => path,
        None => AimArgs::path(&args.aim, scene, view).unwrap_or_else(|| tour::tour(scene, view)),
    };
    let Frames(range, all) = args.frames.unwrap_or(Frames(None, None));
    let frames = all.unwrap_or_else(|| (path.duration() * args.fps).round().clamp(1.0, 1e6) as usize);
    let range = range.unwrap_or(0..frames);
    if range.end > frames {
        let Range { start, end } = range;
        return Err(Error::Argument(format!("--frames {start}..{end}: the film has frames 0..{frames}")));
    }
    let cameras = path.poses(frames).iter().map(|p| args.draw.camera(*p, size)).collect();
    let options = args.draw.options();
    let DrawArgs { device, kernel, .. } = args.draw;
    Ok(Flight { cameras, range, fps: args.fps, encoder: args.encoder, options, device, kernel })
}

/// Makes the report of a scene in a folder, told by these words; what was chosen, if they ask for a choice, or with `--stream` the
/// result. `tell` hears of the progress.
///
/// # Errors
/// As [`encoding`], and those of [`crate::measure::report::report`] and [`crate::measure::stream::report`].
#[cfg(feature = "report")]
pub fn report(
    scene: &std::path::Path,
    folder: &std::path::Path,
    words: &[String],
    tell: &mut dyn FnMut(&str),
) -> Result<Option<String>> {
    let Command::Report(mut args) = command("report", &["--output=folder", "--", "world"], words)? else {
        unreachable!("the command is report");
    };
    args.output = folder.to_owned();
    args.outcome(scene, tell)
}

/// A flag's name as it is typed, for a word of another language.
pub fn flag(name: &str) -> String {
    format!("--{}", name.replace('_', "-"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::World;

    fn words(line: &str) -> Vec<String> {
        line.split_whitespace().map(str::to_owned).collect()
    }

    #[test]
    fn words_mean_what_flags_mean() {
        let (read, encode) = encoding(&words("--iso=0.5 --up=z --color=run --memory=64M")).unwrap();
        assert_eq!(read.iso, Some(0.5));
        assert_eq!(read.up, Some(planecast_encoder::source::Up::Z));
        assert_eq!((encode.build.color, encode.memory), (Some(planecast_encoder::ColorMode::Run), Some(64 << 20)));
        let world = World::from_heights([8, 8], &[3; 64]).unwrap();
        let all = "--eye=1,2.5,-3 --yaw=-90 --size=32x16 --fov=40 --device=exact --sky=none";
        let drawn = picture(&words(all), &world.scene).unwrap();
        assert_eq!(drawn.camera.eye.to_array(), [1.0, 2.5, -3.0]);
        assert_eq!((drawn.camera.width, drawn.camera.height, drawn.camera.fov), (32, 16, 40.0));
        assert_eq!((drawn.device, drawn.options.sky), (Device::Exact, false));
        let film = flight(&words("--frames=2..5/9 --size=32x32"), None, &world.scene).unwrap();
        assert_eq!((film.cameras.len(), film.range), (9, 2..5));
        let keys = r#"[{"t":0,"eye":[0,9,0],"yaw":0,"pitch":0},{"t":2,"eye":[4,9,0],"yaw":0,"pitch":0}]"#;
        let film = flight(&words("--fps=5"), Some(keys), &world.scene).unwrap();
        assert_eq!((film.cameras.len(), film.cameras[0].eye.x, film.cameras[9].eye.x), (10, 0.0, 4.0));
    }

    #[test]
    fn words_that_are_wrong_are_told_as_flags_are() {
        let error = encoding(&words("--iso=red")).unwrap_err().to_string();
        assert!(error.contains("--iso") && error.contains("expected a number"), "{error}");
        let world = World::from_heights([8, 8], &[3; 64]).unwrap();
        let error = picture(&words("--yew=3"), &world.scene).unwrap_err().to_string();
        assert!(error.contains("--yew") && error.contains("--yaw"), "{error}");
    }
}
