//! `planecast demo`: the whole way from an elevation map to a film, with data that comes along.
//!
//! The terrain, its source and its licence are described in `assets/README.md`.

use std::io::Write;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use planecast_encoder::format::write;
use planecast_encoder::source::{self, ReadOptions};
use planecast_encoder::{BuildOptions, Error as FileError, PcastFile, build};
use serde_json::Value;

use crate::film::fly::{self, Film, Kind};
use crate::film::tour::{self, View};
use crate::{Camera, CpuRenderer, Options, Outputs, Repeat, Resident, Result, cli, output};

/// Metres above the sea, 16 bits, one pixel each 30 m.
const ELEVATION: &[u8] = include_bytes!("../../assets/jacksboro-elevation.png");

/// Flags of `encode` that make the scene of it: voxels are 30 m wide; hills are drawn three times as high, so that they show.
const FLAGS: &str = "--height-scale 0.0333333 --exaggeration 3 --ramp terrain";

const STILL: [u32; 2] = [1280, 720];
const FILM: [u32; 2] = [1280, 720];
const FRAMES: usize = 240;
const FPS: f64 = 30.0;

/// [`FLAGS`], as `encode` reads them.
fn read_options() -> ReadOptions {
    #[derive(clap::Parser)]
    struct Flags {
        #[command(flatten)]
        read: ReadOptions,
    }
    let words = ["encode"].into_iter().chain(FLAGS.split(' '));
    <Flags as clap::Parser>::parse_from(words).read
}

/// Makes the demo's files in `folder` and tells of each.
pub fn demo(folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder).map_err(|e| FileError::io(folder, "create the folder", e))?;
    let file = |name: &str| folder.join(name);
    let elevation = file("elevation.png");
    let (scene_file, still, film) = (file("jacksboro.pcast"), file("still.png"), file("flight.mp4"));
    output::check(&still)?;
    output::check(&film)?;
    let kind = Kind::of(&film, None)?;
    kind.check(FILM, FPS)?;
    let start = Instant::now();
    let tell = |what: String| cli::print(&format!("{:5.1} s  {what}\n", start.elapsed().as_secs_f64()));

    output::write(&elevation, |out| out.write_all(ELEVATION))?.finish()?;
    tell(format!("{}: hills near Jacksboro, Tennessee (SRTM)", elevation.display()))?;

    let read = read_options();
    let scene = build(source::open(&elevation, &read)?, &BuildOptions::default())?;
    write::write_scene(&scene, &scene_file)?;
    let [nx, ny, nz] = scene.dims();
    let (from, to) = (elevation.display(), scene_file.display());
    tell(format!(
        "{to}: {nx} x {ny} x {nz} voxels, {} levels: planecast encode {from} -o {to} {FLAGS}",
        scene.levels.len()
    ))?;

    // From the file, as any other command would.
    let scene = Arc::new(PcastFile::open(&scene_file)?.read_scene()?);
    let resident = Arc::new(Resident::new(&scene));
    let mut renderer = CpuRenderer::new(&scene, &resident);
    let options = Options::default();
    let view = |size| View { fov: 60.0, size, repeat: Repeat::default() };

    let pose = tour::still(&scene, view(STILL));
    let frame = renderer.render(&pose.camera(STILL), &options, Outputs::default())?;
    output::write(&still, |out| output::png(out, &frame))?.finish()?;
    tell(format!("{}: {} x {} pixels", still.display(), STILL[0], STILL[1]))?;

    let path = tour::tour(&scene, view(FILM));
    let cameras: Vec<Camera> = path.poses(FRAMES).iter().map(|p| p.camera(FILM)).collect();
    let stop = AtomicBool::new(false);
    let (film_output, source, range) = (&film, Value::String("demo".into()), 0..FRAMES);
    let plan = Film {
        output: film_output,
        kind,
        cameras: &cameras,
        range,
        fps: FPS,
        spherical: false,
        resume: false,
        source,
        stop: &stop,
    };
    fly::fly(&plan, &mut |cameras, spare| {
        renderer.reuse(spare);
        renderer.render(&cameras[0], &options, Outputs::default())
    })?;
    tell(format!("{}: {FRAMES} frames of {} x {} pixels", film.display(), FILM[0], FILM[1]))
}
