//! Worlds from files and arrays.

use std::collections::HashSet;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use numpy::PyReadonlyArray1;
use planecast::Error;
use planecast::cli::words;
use planecast_encoder::Error as FileError;
use planecast_encoder::encode::{self, EncodeOptions, Watch};
use planecast_encoder::format;
use planecast_encoder::model::pieces::{Pieces, named};
use planecast_encoder::source::{self, ArrayView, BlockArray, Blocks};
use pyo3::prelude::*;

use crate::world::World;
use crate::{in_python, raise, raise_file, work};

/// What its reader has to tell of a world.
pub fn told(world: &dyn Pieces) -> Vec<String> {
    let about = world.about();
    let about = (!about.format.is_empty()).then(|| about.to_string());
    about.into_iter().chain(world.notes().iter().cloned()).map(|note| in_python(&note)).collect()
}

/// Encodes pieces to a file where one is named, else in a file without a name; only some tiles of them, to a part, which is
/// no world.
fn encoded(
    pieces: &dyn Pieces,
    name: &Path,
    options: &EncodeOptions,
    output: Option<&Path>,
    tiles: Option<(u64, u64)>,
    watch: &Watch,
) -> Result<Option<World>, Error> {
    let notes = told(pieces);
    Ok(match (output, tiles) {
        (None, _) => Some(World::new(planecast::World::from_pieces(pieces, options, name, watch)?, notes, None)),
        (Some(output), None) => {
            encode::encode(pieces, options, output, watch)?;
            Some(World::of_file(pieces.dims(), notes, std::path::absolute(output).unwrap_or(output.to_owned())))
        }
        (Some(output), Some((from, to))) => {
            encode::encode_part(pieces, options, from..to, output, watch)?;
            None
        }
    })
}

/// A file or a name such as `procedural:rocks?size=64`.
#[pyfunction]
pub fn encode_path(
    py: Python<'_>,
    path: PathBuf,
    words: Vec<String>,
    output: Option<PathBuf>,
    tiles: Option<(u64, u64)>,
) -> PyResult<Option<World>> {
    let watch = Watch::default();
    let world = work(py, &watch.stop, || {
        let (read, options) = words::encoding(&words)?;
        let pieces = named(source::open_pieces(&path, &read)?, &path);
        encoded(&*pieces, &path, &options, output.as_deref(), tiles, &watch)
    })?;
    world.map_err(raise)
}

/// An array's bytes, its shape and type as `numpy.dtype` names it.
#[pyfunction]
pub fn encode_array(
    py: Python<'_>,
    bytes: PyReadonlyArray1<'_, u8>,
    shape: Vec<u64>,
    dtype: &str,
    fortran: bool,
    words: Vec<String>,
    output: Option<PathBuf>,
) -> PyResult<Option<World>> {
    // The array stays alive while it is read. Who writes to it meanwhile makes a world of some old and some new values.
    let values = bytes.as_slice()?;
    let watch = Watch::default();
    let name = Path::new("array");
    let world = work(py, &watch.stop, || {
        let (read, options) = words::encoding(&words)?;
        let view = ArrayView { shape: &shape, dtype, fortran, bytes: values };
        let pieces = source::array(name, view, &read)?;
        encoded(&*pieces, name, &options, output.as_deref(), None, &watch)
    })?;
    world.map_err(raise)
}

/// Values that a function of Python's gives: `fetch(starts, ends)` is an array of bytes.
struct Fetch<'a> {
    fetch: &'a Py<PyAny>,
    /// What it raised, if it did.
    failed: Arc<Mutex<Option<PyErr>>>,
    chunk: Vec<u64>,
    /// Numbers of the chunks that were written; None: all.
    written: Option<HashSet<Vec<u64>>>,
}

impl Blocks for Fetch<'_> {
    fn read(&self, places: &[Range<u64>]) -> Result<Vec<u8>, FileError> {
        let stopped = || FileError::Argument("the array's values could not be read".to_owned());
        if self.failed.lock().is_ok_and(|failed| failed.is_some()) {
            return Err(stopped());
        }
        let ends = |of: fn(&Range<u64>) -> u64| places.iter().map(of).collect::<Vec<u64>>();
        let read = |py: Python<'_>| -> PyResult<Vec<u8>> {
            let bytes = self.fetch.bind(py).call1((ends(|r| r.start), ends(|r| r.end)))?;
            Ok(bytes.extract::<PyReadonlyArray1<'_, u8>>()?.as_slice()?.to_vec())
        };
        Python::attach(read).map_err(|error| {
            if let Ok(mut failed) = self.failed.lock() {
                failed.get_or_insert(error);
            }
            stopped()
        })
    }

    fn holds(&self, places: &[Range<u64>]) -> bool {
        let Some(written) = &self.written else { return true };
        let numbers: Vec<Range<u64>> =
            places.iter().zip(&self.chunk).map(|(p, c)| p.start / c..p.end.div_ceil(*c)).collect();
        let mut at: Vec<u64> = numbers.iter().map(|r| r.start).collect();
        loop {
            if written.contains(&at) {
                return true;
            }
            let Some(axis) = (0..at.len()).rev().find(|&i| at[i] + 1 < numbers[i].end) else { return false };
            at[axis] += 1;
            (axis + 1..at.len()).for_each(|i| at[i] = numbers[i].start);
        }
    }
}

/// An array that is read block by block; of a height map of which a region alone is read, `heights` are its least and greatest.
#[pyfunction]
#[allow(clippy::too_many_arguments, reason = "called from one place, by name")]
pub fn encode_blocks(
    py: Python<'_>,
    fetch: Py<PyAny>,
    shape: Vec<u64>,
    chunk: Vec<u64>,
    dtype: &str,
    fill: f64,
    written: Option<Vec<Vec<u64>>>,
    region: Vec<(u64, u64)>,
    heights: Option<(f64, f64)>,
    labels: bool,
    words: Vec<String>,
    output: Option<PathBuf>,
    tiles: Option<(u64, u64)>,
) -> PyResult<Option<World>> {
    let watch = Watch::default();
    let name = Path::new("array");
    let failed = Arc::new(Mutex::new(None));
    let written = written.map(|chunks| chunks.into_iter().collect());
    let source = Fetch { fetch: &fetch, failed: Arc::clone(&failed), chunk: chunk.clone(), written };
    let region: Vec<Range<u64>> = region.into_iter().map(|(from, to)| from..to).collect();
    let world = work(py, &watch.stop, || {
        let (read, options) = words::encoding(&words)?;
        let heights = heights.map(|(low, high)| [low, high]);
        let array = BlockArray { shape: &shape, chunk: &chunk, dtype, fill, region: &region, heights, labels };
        let pieces = source::blocks(name, &array, Box::new(source), &read)?;
        encoded(&*pieces, name, &options, output.as_deref(), tiles, &watch)
    })?;
    // What the array's own code raised says more than that it did.
    if let Some(error) = failed.lock().ok().and_then(|mut failed| failed.take()) {
        return Err(error);
    }
    world.map_err(raise)
}

/// Parts put together to a scene.
#[pyfunction]
pub fn merge(py: Python<'_>, parts: Vec<PathBuf>, output: PathBuf, words: Vec<String>) -> PyResult<()> {
    let watch = Watch::default();
    let made = work(py, &watch.stop, || -> Result<(), Error> {
        let (_, options) = words::encoding(&words)?;
        encode::merge(&parts, options.memory, options.compress, &output, &watch)?;
        Ok(())
    })?;
    made.map_err(raise)
}

/// Of a world of this size `(nx, ny, nz)`, or of an input, the tiles of level 0 along x and z; and columns along a tile's side.
#[pyfunction]
pub fn tiles(
    py: Python<'_>,
    dims: Option<[u32; 3]>,
    path: Option<PathBuf>,
    words: Vec<String>,
) -> PyResult<([u32; 2], u32)> {
    let dims = match (dims, path) {
        (Some(dims), _) => dims,
        (None, path) => {
            let path = path.unwrap_or_default();
            let opened = work(py, &Watch::default().stop, || {
                let (read, _) = words::encoding(&words)?;
                Ok(source::open_pieces(&path, &read)?.dims())
            })?;
            opened.map_err(raise)?
        }
    };
    if dims.contains(&0) {
        return Err(raise_file(FileError::Argument(format!(
            "a world of {dims:?} voxels; every side must be at least 1"
        ))));
    }
    Ok((format::grids(dims)[0].tiles, format::TILE))
}
