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
const COLORS: &[u8] = include_bytes!("../../assets/jacksboro-colors.png");

/// Voxels a metre: a voxel is 30 m wide and 10 m high, so that the hills show.
const HEIGHT_SCALE: f64 = 0.1;

const STILL: [u32; 2] = [1280, 720];
const FILM: [u32; 2] = [1280, 720];
const FRAMES: usize = 240;
const FPS: f64 = 30.0;

/// Makes the demo's files in `folder` and tells of each.
pub fn demo(folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder).map_err(|e| FileError::io(folder, "create the folder", e))?;
    let file = |name: &str| folder.join(name);
    let (elevation, colors) = (file("elevation.png"), file("colors.png"));
    let (scene_file, still, film) = (file("jacksboro.pcast"), file("still.png"), file("flight.mp4"));
    output::check(&still)?;
    output::check(&film)?;
    let kind = Kind::of(&film, None)?;
    kind.check(FILM, FPS)?;
    let start = Instant::now();
    let tell = |what: String| cli::print(&format!("{:5.1} s  {what}\n", start.elapsed().as_secs_f64()));

    output::write(&elevation, |out| out.write_all(ELEVATION))?.finish()?;
    output::write(&colors, |out| out.write_all(COLORS))?.finish()?;
    tell(format!("{}, {}: hills near Jacksboro, Tennessee (SRTM)", elevation.display(), colors.display()))?;

    let read = ReadOptions { colors: Some(colors), height_scale: Some(HEIGHT_SCALE), ..ReadOptions::default() };
    let scene = build(source::open(&elevation, &read)?, &BuildOptions::default())?;
    write::write_scene(&scene, &scene_file)?;
    let [nx, ny, nz] = scene.dims();
    tell(format!("{}: {nx} x {ny} x {nz} voxels, {} levels", scene_file.display(), scene.levels.len()))?;

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
