//! A world that can be drawn and asked.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, OnceLock};

use glam::DVec3;
use numpy::{PyArray1, PyReadonlyArray2};
use planecast::cli::words::{self, Picture};
use planecast::film::fly::{self, Film, Kind};
use planecast::measure::viewshed;
use planecast::{Camera, Device, Error, Frame, Outputs, Renderer};
use planecast_encoder::encode::{self, Watch};
use pyo3::prelude::*;
use rayon::prelude::*;

use crate::encoding::told;
use crate::{raise, work};

/// Rays or voxels that a thread looks at before the next ones.
const AT_ONCE: usize = 1024;

/// What was asked for, whose words need not be read again.
const REMEMBERED: usize = 16;

/// A world that can be drawn and asked.
#[pyclass(frozen)]
pub struct World {
    /// A scene that was encoded to a file is opened when it is first asked for.
    world: OnceLock<Arc<planecast::World>>,
    dims: [u32; 3],
    /// The scene's file, where it has one.
    file: Option<PathBuf>,
    /// It is drawn as a surface unless words say otherwise.
    smooth: bool,
    /// One per device and kernel that was asked for.
    renderers: Mutex<Vec<(Device, Option<String>, Renderer)>>,
    asked: Mutex<Vec<(Vec<String>, Picture)>>,
    notes: Vec<String>,
}

impl World {
    pub fn new(world: Arc<planecast::World>, notes: Vec<String>, file: Option<PathBuf>) -> World {
        let dims = world.dims();
        World { world: world.into(), file, ..World::of_file(dims, notes, PathBuf::new()) }
    }

    /// A scene that lies in a file, not opened yet.
    pub fn of_file(dims: [u32; 3], notes: Vec<String>, file: PathBuf) -> World {
        let (renderers, asked) = Default::default();
        World { world: OnceLock::new(), dims, file: Some(file), smooth: false, renderers, asked, notes }
    }

    fn world(&self) -> Result<&Arc<planecast::World>, Error> {
        if let Some(world) = self.world.get() {
            return Ok(world);
        }
        let world = planecast::World::open(self.file.as_deref().unwrap_or(Path::new("")))?;
        // Who was quicker has opened the same.
        Ok(self.world.get_or_init(|| world))
    }

    /// Draws with the renderer of this device.
    fn with_renderer<T>(
        &self,
        device: Device,
        kernel: &Option<String>,
        draw: impl FnOnce(&mut Renderer) -> Result<T, Error>,
    ) -> Result<T, Error> {
        let mut renderers = self.renderers.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        let at = renderers.iter().position(|(d, k, _)| (d, k) == (&device, kernel));
        let at = match at {
            Some(at) => at,
            None => {
                let planecast::World { scene, resident, .. } = &**self.world()?;
                let renderer = Renderer::with_kernel(scene, resident, device, kernel.as_deref(), &mut |_| {})?;
                renderers.push((device, kernel.clone(), renderer));
                renderers.len() - 1
            }
        };
        draw(&mut renderers[at].2)
    }

    /// What these words ask for.
    fn picture(&self, words: &[String]) -> Result<Picture, Error> {
        let mut asked = self.asked.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        if let Some((_, picture)) = asked.iter().find(|(of, _)| of == words) {
            return Ok(picture.clone());
        }
        let mut picture = words::picture(words, &self.world()?.scene)?;
        let said = |flag: &str| words.iter().any(|word| word.starts_with(flag));
        let perspective = matches!(picture.options.projection, planecast::Projection::Perspective);
        picture.options.smooth |= self.smooth && perspective && !said("--smooth") && !said("--normals");
        if asked.len() == REMEMBERED {
            asked.remove(0);
        }
        asked.push((words.to_vec(), picture.clone()));
        Ok(picture)
    }
}

/// A frame's arrays, flat: colour (RGBA), depth, voxel; and what it cost, as JSON.
type Arrays = (Py<PyArray1<u8>>, Py<PyArray1<f32>>, Option<Py<PyArray1<i32>>>, String);

fn arrays(py: Python<'_>, frame: Frame) -> Arrays {
    let stats = serde_json::to_string(&frame.stats).unwrap_or_default();
    let voxel = (!frame.voxel.is_empty()).then(|| PyArray1::from_vec(py, frame.voxel.into_flattened()).unbind());
    let color = PyArray1::from_vec(py, frame.color.into_flattened()).unbind();
    (color, PyArray1::from_vec(py, frame.depth).unbind(), voxel, stats)
}

fn camera_tuple(camera: &Camera) -> CameraTuple {
    let Camera { eye, yaw, pitch, roll, fov, width, height } = *camera;
    ((eye.x, eye.y, eye.z), yaw, pitch, roll, fov, width, height)
}

type CameraTuple = ((f64, f64, f64), f64, f64, f64, f64, u32, u32);

/// Eye, yaw, pitch, roll.
type Pose = [f64; 6];

fn posed(camera: &Camera, pose: Option<&Pose>) -> Camera {
    match pose {
        None => *camera,
        Some(&[x, y, z, yaw, pitch, roll]) => Camera { eye: DVec3::new(x, y, z), yaw, pitch, roll, ..*camera },
    }
}

fn point(row: &[f64]) -> DVec3 {
    DVec3::new(row[0], row[1], row[2])
}

#[pymethods]
impl World {
    /// `(nx, ny, nz)`, y up.
    #[getter]
    fn dims(&self) -> (u32, u32, u32) {
        self.dims.into()
    }

    #[getter]
    fn notes(&self) -> Vec<String> {
        self.notes.clone()
    }

    /// The scene's file, where it has one.
    #[getter]
    fn file(&self) -> Option<PathBuf> {
        self.file.clone()
    }

    /// A frame as flat arrays, and the camera it was drawn with; from `pose` in place of what the words say.
    #[pyo3(signature = (words, voxel, pose=None))]
    fn draw(
        &self,
        py: Python<'_>,
        words: Vec<String>,
        voxel: bool,
        pose: Option<Pose>,
    ) -> PyResult<(Arrays, CameraTuple)> {
        let stop = AtomicBool::new(false);
        let drawn = work(py, &stop, || {
            let asked = self.picture(&words)?;
            let camera = posed(&asked.camera, pose.as_ref());
            let frame = self.with_renderer(asked.device, &asked.kernel, |renderer| {
                renderer.draw_with(&camera, &asked.options, Outputs { voxel }, &mut |_| {})
            })?;
            Ok((frame, camera))
        })?;
        let (frame, camera) = drawn.map_err(raise)?;
        Ok((arrays(py, frame), camera_tuple(&camera)))
    }

    /// Frames from several poses, drawn together, in order.
    fn draw_many(
        &self,
        py: Python<'_>,
        words: Vec<String>,
        voxel: bool,
        poses: Vec<Pose>,
    ) -> PyResult<Vec<(Arrays, CameraTuple)>> {
        let stop = AtomicBool::new(false);
        let drawn = work(py, &stop, || {
            let asked = self.picture(&words)?;
            let cameras: Vec<Camera> = poses.iter().map(|pose| posed(&asked.camera, Some(pose))).collect();
            let frames = Mutex::new((0..cameras.len()).map(|_| None).collect::<Vec<Option<Frame>>>());
            self.with_renderer(asked.device, &asked.kernel, |renderer| {
                renderer.draw_each(&cameras, &asked.options, Outputs { voxel }, &|i, frame| {
                    frames.lock().expect("no holder panics")[i] = Some(frame);
                    Ok(None)
                })
            })?;
            let frames = frames.into_inner().expect("no holder panics");
            Ok((frames.into_iter().map(|frame| frame.expect("all were drawn")).collect::<Vec<Frame>>(), cameras))
        })?;
        let (frames, cameras) = drawn.map_err(raise)?;
        let each = frames.into_iter().zip(&cameras);
        Ok(each.map(|(frame, camera)| (arrays(py, frame), camera_tuple(camera))).collect())
    }

    /// The cameras of a flight, and how many frames are encoded as one.
    fn cameras(&self, words: Vec<String>, path: Option<&str>) -> PyResult<(Vec<CameraTuple>, usize)> {
        let world = self.world().map_err(raise)?;
        let flight = words::flight(&words, path, &world.scene).map_err(raise)?;
        let segment = flight.cameras.first().map_or(1, |c| planecast::film::video::segment_frames(c.width, c.height));
        Ok((flight.cameras[flight.range].iter().map(camera_tuple).collect(), segment))
    }

    /// A film or a folder of frames; how many frames it has.
    fn fly(&self, py: Python<'_>, output: PathBuf, words: Vec<String>, path: Option<String>) -> PyResult<usize> {
        let stop = AtomicBool::new(false);
        let made = work(py, &stop, || {
            let flight = words::flight(&words, path.as_deref(), &self.world()?.scene)?;
            let kind = Kind::of(&output, flight.encoder.as_ref())?;
            let size = [flight.cameras[0].width, flight.cameras[0].height];
            kind.check(size, flight.fps)?;
            planecast::output::check(&output)?;
            let film = Film {
                spherical: flight.options.projection == planecast::Projection::Equirect,
                output: &output,
                kind,
                cameras: &flight.cameras,
                range: flight.range.clone(),
                fps: flight.fps,
                resume: false,
                source: serde_json::Value::Null,
                stop: &stop,
            };
            self.with_renderer(flight.device, &flight.kernel, |renderer| {
                fly::fly(&film, &mut |cameras: &[Camera], spare| {
                    renderer.reuse(spare);
                    renderer.draw_first(cameras, &flight.options, Outputs::default(), &mut |_| {})
                })
            })
        })?;
        Ok(made.map_err(raise)?.frames)
    }

    /// For each voxel (x, y, z): whether it is solid, and its colour, −1 where it has none.
    #[allow(clippy::type_complexity, reason = "two arrays")]
    fn query<'py>(
        &self,
        py: Python<'py>,
        points: PyReadonlyArray2<'py, i64>,
    ) -> PyResult<(Bound<'py, PyArray1<bool>>, Bound<'py, PyArray1<i16>>)> {
        let points = points.as_slice()?;
        let found = work(py, &AtomicBool::new(false), || {
            let scene = &self.world()?.scene;
            let level = &scene.levels[0];
            let mut solid = vec![false; points.len() / 3];
            let mut colors = vec![-1i16; points.len()];
            let parts = points
                .par_chunks(3 * AT_ONCE)
                .zip(solid.par_chunks_mut(AT_ONCE))
                .zip(colors.par_chunks_mut(3 * AT_ONCE));
            parts.for_each(|((points, solid), colors)| {
                for ((p, solid), color) in points.chunks_exact(3).zip(solid).zip(colors.chunks_exact_mut(3)) {
                    *solid = level.solid.solid(p[0], p[1], p[2]);
                    let place = [p[0] as u32, p[1] as u32, p[2] as u32];
                    let found = solid.then(|| planecast::cpu::pick::color(scene, place)).flatten();
                    if let Some(rgb) = found {
                        color.copy_from_slice(&rgb.map(i16::from));
                    }
                }
            });
            Ok((solid, colors))
        })?;
        let (solid, colors) = found.map_err(raise)?;
        Ok((PyArray1::from_vec(py, solid), PyArray1::from_vec(py, colors)))
    }

    /// For each ray: the distance to the first solid voxel (+inf where there is none) and that voxel (−1).
    #[allow(clippy::type_complexity, reason = "two arrays")]
    fn pick<'py>(
        &self,
        py: Python<'py>,
        origins: PyReadonlyArray2<'py, f64>,
        dirs: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<(Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<i32>>)> {
        let (origins, dirs) = (origins.as_slice()?, dirs.as_slice()?);
        let found = work(py, &AtomicBool::new(false), || {
            let columns = &self.world()?.scene.levels[0].solid;
            let rays = origins.par_chunks(3).zip(dirs.par_chunks(3)).with_min_len(64);
            let hits: Vec<(f64, [i32; 3])> = rays
                .map(|(from, dir)| {
                    let hit = planecast::cpu::pick::pick(columns, point(from), point(dir))?;
                    Ok(hit.map_or((f64::INFINITY, [-1; 3]), |hit| (hit.distance, hit.voxel.map(|v| v as i32))))
                })
                .collect::<Result<_, planecast_encoder::Error>>()?;
            let voxels: Vec<i32> = hits.iter().flat_map(|hit| hit.1).collect();
            Ok((hits.into_iter().map(|hit| hit.0).collect::<Vec<f64>>(), voxels))
        })?;
        let (distances, voxels) = found.map_err(raise)?;
        Ok((PyArray1::from_vec(py, distances), PyArray1::from_vec(py, voxels)))
    }

    /// One past the highest solid voxel of each column, x fastest; 0 where a column is empty.
    fn heights<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<i32>>> {
        let heights = work(py, &AtomicBool::new(false), || {
            let columns = &self.world()?.scene.levels[0].solid;
            let n = columns.offsets().len() - 1;
            let top = |ix| columns.runs()[columns.range(ix)].last().map_or(0, |run| run.end() as i32);
            Ok((0..n).into_par_iter().map(top).collect::<Vec<i32>>())
        })?;
        Ok(PyArray1::from_vec(py, heights.map_err(raise)?))
    }

    /// How many of these places see each column, x fastest.
    fn viewshed<'py>(&self, py: Python<'py>, eyes: PyReadonlyArray2<'py, f64>) -> PyResult<Bound<'py, PyArray1<u16>>> {
        let eyes: Vec<DVec3> = eyes.as_slice()?.chunks_exact(3).map(point).collect();
        let seen = work(py, &AtomicBool::new(false), || {
            let seen = viewshed::viewshed(&self.world()?.resident.levels[0], &eyes)?;
            Ok((0..seen.counts.len()).map(|column| seen.counts.get(column)).collect::<Vec<u16>>())
        })?;
        Ok(PyArray1::from_vec(py, seen.map_err(raise)?))
    }

    /// Writes the scene.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let written = work(py, &AtomicBool::new(false), || {
            Ok(planecast_encoder::format::write::write_scene(&self.world()?.scene, &path)?)
        })?;
        written.map_err(raise)
    }
}

/// Opens a scene file, or encodes an input in a file without a name, to be looked at: a map of heights has colours.
#[pyfunction]
pub fn open(py: Python<'_>, path: PathBuf, words: Vec<String>) -> PyResult<World> {
    let watch = Watch::default();
    let world = work(py, &watch.stop, || {
        let (mut read, _) = words::encoding(&words)?;
        read.show = true;
        let mut notes = Vec::new();
        let opened = encode::open::open(&path, &read, &watch, &mut |world| notes = told(world))?;
        let encoded = opened.encoded;
        Ok((planecast::World::of_opened(opened, &path)?, notes, encoded))
    })?;
    let (world, notes, encoded) = world.map_err(raise)?;
    let smooth = world.smooth;
    Ok(World { smooth, ..World::new(world, notes, (!encoded).then_some(path)) })
}
