//! planecast for Python: the compiled half. What a person calls is in `planecast/__init__.py`, which makes arrays plain and words of
//! keyword arguments; here they become worlds and pictures, with the interpreter's lock released.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use glam::DVec3;
use numpy::{PyArray1, PyReadonlyArray1, PyReadonlyArray2};
use planecast::cli::words;
use planecast::film::fly::{self, Film, Kind};
use planecast::{Camera, Device, Error, Frame, Outputs, Renderer};
use planecast_encoder::Error as FileError;
use planecast_encoder::encode::{self, Watch};
use planecast_encoder::inspect::info;
use planecast_encoder::model::pieces::{Pieces, named};
use planecast_encoder::source::{self, ArrayView};
use pyo3::exceptions::{PyMemoryError, PyOSError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;

/// An error's text in Python's terms: `--height-scale` is `height_scale=`.
fn in_python(text: &str) -> String {
    let mut out = String::new();
    let mut rest = text;
    while let Some(at) = rest.find("--") {
        let name = &rest[at + 2..];
        let len = name.find(|c: char| !c.is_ascii_lowercase() && !c.is_ascii_digit() && c != '-').unwrap_or(name.len());
        let before = rest[..at].chars().next_back();
        if len == 0 || before.is_some_and(|c| c.is_alphanumeric() || c == '-') {
            out.push_str(&rest[..at + 2]);
            rest = name;
            continue;
        }
        out.push_str(&rest[..at]);
        out.push_str(&name[..len].trim_end_matches('-').replace('-', "_"));
        // `--iso V` and `--iso=V` become `iso=V`.
        out.push('=');
        rest = name[len..].strip_prefix(['=', ' ']).unwrap_or(&name[len..]);
        if rest.len() < name.len() - len && name[len..].starts_with(' ') && !starts_with_value(rest) {
            out.push(' ');
        }
    }
    out + rest
}

/// Whether what follows a flag is its value and not the next word of the sentence.
fn starts_with_value(rest: &str) -> bool {
    rest.starts_with(|c: char| c.is_ascii_uppercase() || c.is_ascii_digit() || c == '"' || c == '-')
}

fn raise(error: Error) -> PyErr {
    let text = in_python(&error.to_string());
    match error {
        Error::Scene(FileError::Io { .. }) => PyOSError::new_err(text),
        Error::Scene(FileError::Limit(_)) | Error::Limit(_) => PyMemoryError::new_err(text),
        Error::Device(_) => PyRuntimeError::new_err(text),
        _ => PyValueError::new_err(text),
    }
}

fn raise_file(error: FileError) -> PyErr {
    raise(error.into())
}

/// Does work without the interpreter's lock, which Ctrl-C stops through `stop`.
fn work<T: Send>(py: Python<'_>, stop: &AtomicBool, work: impl FnOnce() -> T + Send) -> PyResult<T> {
    /// How often to look whether somebody typed Ctrl-C.
    const LOOK: Duration = Duration::from_millis(20);
    let mut interrupted = None;
    let caller = std::thread::current();
    let out = std::thread::scope(|scope| {
        let worker = scope.spawn(|| {
            let out = work();
            caller.unpark();
            out
        });
        while !worker.is_finished() {
            py.detach(|| std::thread::park_timeout(LOOK));
            if interrupted.is_none() {
                interrupted = py.check_signals().err();
                if interrupted.is_some() {
                    stop.store(true, Ordering::Relaxed);
                }
            }
        }
        worker.join()
    });
    let out = out.map_err(|_| PyRuntimeError::new_err("a fault in planecast itself; please report it"))?;
    interrupted.map_or(Ok(out), Err)
}

/// A world that can be drawn and asked.
#[pyclass(frozen)]
struct World {
    world: Arc<planecast::World>,
    /// One per device and kernel that was asked for.
    renderers: Mutex<Vec<(Device, Option<String>, Renderer)>>,
    notes: Vec<String>,
}

impl World {
    fn new(world: Arc<planecast::World>, notes: Vec<String>) -> World {
        World { world, renderers: Mutex::default(), notes }
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
                let (scene, resident) = (&self.world.scene, &self.world.resident);
                let renderer = Renderer::with_kernel(scene, resident, device, kernel.as_deref(), &mut |_| {})?;
                renderers.push((device, kernel.clone(), renderer));
                renderers.len() - 1
            }
        };
        draw(&mut renderers[at].2)
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

fn camera_json(camera: &Camera) -> (DVec3Tuple, f64, f64, f64, f64, u32, u32) {
    let Camera { eye, yaw, pitch, roll, fov, width, height } = *camera;
    ((eye.x, eye.y, eye.z), yaw, pitch, roll, fov, width, height)
}

type DVec3Tuple = (f64, f64, f64);
type CameraTuple = (DVec3Tuple, f64, f64, f64, f64, u32, u32);

fn point(row: &[f64]) -> DVec3 {
    DVec3::new(row[0], row[1], row[2])
}

#[pymethods]
impl World {
    /// `(nx, ny, nz)`, y up.
    #[getter]
    fn dims(&self) -> (u32, u32, u32) {
        self.world.dims().into()
    }

    #[getter]
    fn notes(&self) -> Vec<String> {
        self.notes.clone()
    }

    /// A frame as flat arrays, and the camera it was drawn with.
    fn draw(&self, py: Python<'_>, words: Vec<String>, voxel: bool) -> PyResult<(Arrays, CameraTuple)> {
        let stop = AtomicBool::new(false);
        let drawn = work(py, &stop, || {
            let asked = words::picture(&words, &self.world.scene)?;
            let frame = self.with_renderer(asked.device, &asked.kernel, |renderer| {
                renderer.draw_with(&asked.camera, &asked.options, Outputs { voxel }, &mut |_| {})
            })?;
            Ok((frame, asked.camera))
        })?;
        let (frame, camera) = drawn.map_err(raise)?;
        Ok((arrays(py, frame), camera_json(&camera)))
    }

    /// The cameras of a flight.
    fn cameras(&self, words: Vec<String>, path: Option<&str>) -> PyResult<Vec<CameraTuple>> {
        let flight = words::flight(&words, path, &self.world.scene).map_err(raise)?;
        Ok(flight.cameras[flight.range].iter().map(camera_json).collect())
    }

    /// A film or a folder of frames; how many frames it has.
    fn fly(&self, py: Python<'_>, output: PathBuf, words: Vec<String>, path: Option<String>) -> PyResult<usize> {
        let stop = AtomicBool::new(false);
        let made = work(py, &stop, || {
            let flight = words::flight(&words, path.as_deref(), &self.world.scene)?;
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
        let points = points.as_slice()?.to_vec();
        let found = work(py, &AtomicBool::new(false), || {
            let level = &self.world.scene.levels[0];
            let mut colors = Vec::with_capacity(points.len());
            let solid: Vec<bool> = points
                .chunks_exact(3)
                .map(|p| {
                    let solid = level.solid.solid(p[0], p[1], p[2]);
                    let color = solid
                        .then(|| {
                            planecast::cpu::pick::color(&self.world.scene, [p[0] as u32, p[1] as u32, p[2] as u32])
                        })
                        .flatten();
                    colors.extend(color.map_or([-1; 3], |c| c.map(i16::from)));
                    solid
                })
                .collect();
            (solid, colors)
        })?;
        Ok((PyArray1::from_vec(py, found.0), PyArray1::from_vec(py, found.1)))
    }

    /// For each ray: the distance to the first solid voxel (+inf where there is none), that voxel (−1), and the face's normal.
    #[allow(clippy::type_complexity, reason = "three arrays")]
    fn pick<'py>(
        &self,
        py: Python<'py>,
        origins: PyReadonlyArray2<'py, f64>,
        dirs: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<(Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<i32>>)> {
        let (origins, dirs) = (origins.as_slice()?.to_vec(), dirs.as_slice()?.to_vec());
        let found = work(py, &AtomicBool::new(false), || {
            let columns = &self.world.scene.levels[0].solid;
            let (mut distances, mut voxels) = (Vec::new(), Vec::new());
            for (from, dir) in origins.chunks_exact(3).zip(dirs.chunks_exact(3)) {
                let hit = planecast::cpu::pick::pick(columns, point(from), point(dir))?;
                distances.push(hit.as_ref().map_or(f64::INFINITY, |hit| hit.distance));
                voxels.extend(hit.map_or([-1; 3], |hit| hit.voxel.map(|v| v as i32)));
            }
            Ok((distances, voxels))
        })?;
        let (distances, voxels) = found.map_err(raise_file)?;
        Ok((PyArray1::from_vec(py, distances), PyArray1::from_vec(py, voxels)))
    }

    /// One past the highest solid voxel of each column, x fastest; 0 where a column is empty.
    fn heights<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<i32>>> {
        let heights = work(py, &AtomicBool::new(false), || {
            let columns = &self.world.scene.levels[0].solid;
            let n = columns.offsets().len() - 1;
            let top = |ix| columns.runs()[columns.range(ix)].last().map_or(0, |run| run.end() as i32);
            (0..n).map(top).collect::<Vec<i32>>()
        })?;
        Ok(PyArray1::from_vec(py, heights))
    }
}

/// Opens a scene file, or encodes an input in a file without a name.
#[pyfunction]
fn open(py: Python<'_>, path: PathBuf, words: Vec<String>) -> PyResult<World> {
    let watch = Watch::default();
    let world = work(py, &watch.stop, || {
        let (read, _) = words::encoding(&words)?;
        let mut notes = Vec::new();
        let opened = encode::open::open(&path, &read, &watch, &mut |world| notes = told(world))?;
        Ok((planecast::World::of_opened(opened, &path)?, notes))
    })?;
    let (world, notes) = world.map_err(raise)?;
    Ok(World::new(world, notes))
}

/// What its reader has to tell of a world.
fn told(world: &dyn Pieces) -> Vec<String> {
    let about = world.about();
    let about = (!about.format.is_empty()).then(|| about.to_string());
    about.into_iter().chain(world.notes().iter().cloned()).map(|note| in_python(&note)).collect()
}

/// Encodes pieces to a file where one is named, else in a file without a name.
fn encoded(
    pieces: &dyn Pieces,
    name: &Path,
    words: &[String],
    output: Option<&Path>,
    watch: &Watch,
) -> Result<World, Error> {
    let (_, options) = words::encoding(words)?;
    let notes = told(pieces);
    let world = match output {
        None => planecast::World::from_pieces(pieces, &options, name, watch)?,
        Some(output) => {
            encode::encode(pieces, &options, output, watch)?;
            planecast::World::open(output)?
        }
    };
    Ok(World::new(world, notes))
}

/// A file or a name such as `procedural:rocks?size=64`.
#[pyfunction]
fn encode_path(py: Python<'_>, path: PathBuf, words: Vec<String>, output: Option<PathBuf>) -> PyResult<World> {
    let watch = Watch::default();
    let world = work(py, &watch.stop, || {
        let (read, _) = words::encoding(&words)?;
        let pieces = named(source::open_pieces(&path, &read)?, &path);
        encoded(&*pieces, &path, &words, output.as_deref(), &watch)
    })?;
    world.map_err(raise)
}

/// An array's bytes, its shape and type as `numpy.dtype` names it.
#[pyfunction]
fn encode_array(
    py: Python<'_>,
    bytes: PyReadonlyArray1<'_, u8>,
    shape: Vec<u64>,
    dtype: &str,
    fortran: bool,
    words: Vec<String>,
    output: Option<PathBuf>,
) -> PyResult<World> {
    // The array stays alive while it is read. Who writes to it meanwhile makes a world of some old and some new values.
    let values = bytes.as_slice()?;
    let watch = Watch::default();
    let name = Path::new("array");
    let world = work(py, &watch.stop, || {
        let (read, _) = words::encoding(&words)?;
        let view = ArrayView { shape: &shape, dtype, fortran, bytes: values };
        let pieces = source::array(name, view, &read)?;
        encoded(&*pieces, name, &words, output.as_deref(), &watch)
    })?;
    world.map_err(raise)
}

/// What `planecast info --json` says of a scene file.
#[pyfunction]
fn scene_info(py: Python<'_>, path: PathBuf) -> PyResult<String> {
    let info = work(py, &AtomicBool::new(false), || {
        let file = planecast_encoder::PcastFile::open(&path)?;
        info::info(&file)
    })?;
    serde_json::to_string(&info.map_err(raise_file)?).map_err(|e| PyRuntimeError::new_err(e.to_string()))
}

#[pymodule]
fn _planecast(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<World>()?;
    module.add_function(wrap_pyfunction!(open, module)?)?;
    module.add_function(wrap_pyfunction!(encode_path, module)?)?;
    module.add_function(wrap_pyfunction!(encode_array, module)?)?;
    module.add_function(wrap_pyfunction!(scene_info, module)?)?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_speak_of_keyword_arguments() {
        assert_eq!(in_python("--iso red: expected a number"), "iso= red: expected a number");
        assert_eq!(in_python("a.raw: expected --dims X,Y,Z"), "a.raw: expected dims=X,Y,Z");
        assert_eq!(
            in_python("--height-scale: must not be 0; try --no-gap-fill"),
            "height_scale=: must not be 0; try no_gap_fill="
        );
        assert_eq!(in_python("1 -- 2, a--b"), "1 -- 2, a--b");
    }
}
