//! planecast for Python: the compiled half. What a person calls is in `planecast/__init__.py`, which makes arrays plain and words of
//! keyword arguments; here they become worlds and pictures, with the interpreter's lock released.

mod encoding;
mod world;

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use planecast::{Error, cli::words, film::fly};
use planecast_encoder::Error as FileError;
use planecast_encoder::inspect::info;
use pyo3::exceptions::{PyMemoryError, PyOSError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;

use world::World;

/// An error's text in Python's terms: `--height-scale` is `height_scale=`.
fn in_python(text: &str) -> String {
    let mut out = String::new();
    // The output's short flag, which names it.
    let text = match text.strip_prefix("-o ") {
        Some(rest) => format!("output {rest}"),
        None => text.replace(" -o ", " output "),
    };
    let mut rest = &text[..];
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

/// What `planecast info --json` says of a scene file.
#[pyfunction]
fn scene_info(py: Python<'_>, path: PathBuf) -> PyResult<String> {
    let info = work(py, &AtomicBool::new(false), || {
        let file = planecast_encoder::PcastFile::open(&path)?;
        info::info(&file)
    })?;
    serde_json::to_string(&info.map_err(raise_file)?).map_err(|e| PyRuntimeError::new_err(e.to_string()))
}

/// The report of a scene in a folder; what was chosen, if a choice was asked for, as JSON.
#[pyfunction]
fn report(py: Python<'_>, scene: PathBuf, folder: PathBuf, words: Vec<String>) -> PyResult<Option<String>> {
    // Between two configurations nobody looks at it: Ctrl-C is raised when the work is done.
    let made = work(py, &AtomicBool::new(false), || words::report(&scene, &folder, &words, &mut |_| {}))?;
    made.map_err(raise)
}

/// Parts of a film put together; how many frames it has.
#[pyfunction]
fn join(py: Python<'_>, parts: Vec<PathBuf>, output: PathBuf) -> PyResult<usize> {
    work(py, &AtomicBool::new(false), || fly::join(&parts, &output))?.map_err(raise)
}

#[pymodule]
fn _planecast(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<World>()?;
    module.add_function(wrap_pyfunction!(world::open, module)?)?;
    module.add_function(wrap_pyfunction!(encoding::encode_path, module)?)?;
    module.add_function(wrap_pyfunction!(encoding::encode_array, module)?)?;
    module.add_function(wrap_pyfunction!(encoding::encode_blocks, module)?)?;
    module.add_function(wrap_pyfunction!(encoding::merge, module)?)?;
    module.add_function(wrap_pyfunction!(encoding::tiles, module)?)?;
    module.add_function(wrap_pyfunction!(scene_info, module)?)?;
    module.add_function(wrap_pyfunction!(report, module)?)?;
    module.add_function(wrap_pyfunction!(join, module)?)?;
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
        assert_eq!(in_python("-o a.xyz: name an .mp4"), "output a.xyz: name an .mp4");
    }
}
