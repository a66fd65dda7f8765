//! Objects and their stores.

use std::fs::{self, File};
use std::future::Future;
use std::io::{Read, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Arc, LazyLock};

use futures_util::TryStreamExt;
use object_store::path::Path as Key;
use object_store::{ObjectStore, ObjectStoreExt, WriteMultipart};
use tokio::runtime::Runtime;
use xxhash_rust::xxh3::xxh3_64;

use crate::pieces::Pieces;
use crate::source::{self, Format, ReadOptions};
use crate::{Error, Input, Result, memory};

/// Bytes of an object that tell what it is.
const HEAD: u64 = 64 << 10;
/// Objects up to this size are put in one request, larger ones in pieces of it or more.
const PIECE: u64 = 16 << 20;
/// Pieces of an upload that S3 allows are 10,000.
const MAX_PIECES: u64 = 9_000;

static RUNTIME: LazyLock<std::io::Result<Runtime>> =
    LazyLock::new(|| tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build());

fn wait<T>(url: &Path, action: &'static str, work: impl Future<Output = object_store::Result<T>>) -> Result<T> {
    let runtime = RUNTIME.as_ref().map_err(|e| Error::Limit(format!("no threads for object storage: {e}")))?;
    runtime.block_on(work).map_err(|e| failed(url, action, e))
}

/// A store's error on one line: the innermost causes of some fill a page.
fn failed(url: &Path, action: &'static str, e: object_store::Error) -> Error {
    let mut text = e.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
    if let Some((at, _)) = text.char_indices().nth(400) {
        text.truncate(at);
        text.push('…');
    }
    let kind = match e {
        object_store::Error::NotFound { .. } => std::io::ErrorKind::NotFound,
        _ => std::io::ErrorKind::Other,
    };
    Error::io(url, action, std::io::Error::new(kind, text))
}

/// The store that a URL names, and the object in it.
fn resolve(url: &Path) -> Result<(Arc<dyn ObjectStore>, Key)> {
    let wrong = |what: String| Error::Argument(format!("{}: {what}", url.display()));
    let parsed = url::Url::parse(&url.to_string_lossy()).map_err(|e| wrong(format!("no URL: {e}")))?;
    let (store, key) = object_store::parse_url_opts(&parsed, std::env::vars()).map_err(|e| failed(url, "reach", e))?;
    Ok((store.into(), key))
}

/// One object, for reading.
pub(crate) struct Object {
    url: PathBuf,
    store: Arc<dyn ObjectStore>,
    key: Key,
    len: u64,
    state: String,
}

impl Object {
    /// None where there is no such object.
    pub fn open(url: &Path) -> Result<Option<Object>> {
        let (store, key) = resolve(url)?;
        let found = match wait(url, "open", store.head(&key)) {
            Ok(found) => found,
            Err(Error::Io { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(e) => return Err(e),
        };
        let state = format!("{} {} {:?} {:?}", found.size, found.last_modified, found.e_tag, found.version);
        Ok(Some(Object { url: url.to_owned(), store, key, len: found.size, state }))
    }

    pub fn state(&self) -> &str {
        &self.state
    }

    /// The bytes of a range, all of them.
    pub fn read(&self, range: Range<u64>, buffer: &mut Vec<u8>) -> Result<()> {
        let n = range.end - range.start;
        buffer.clear();
        if n > 0 {
            buffer.extend_from_slice(&wait(&self.url, "read", self.store.get_range(&self.key, range))?);
        }
        if buffer.len() as u64 != n {
            return Err(Error::format(
                &self.url,
                format!("{} bytes of {n} asked for; it changed meanwhile", buffer.len()),
            ));
        }
        Ok(())
    }

    fn fetch(&self, file: &Path) -> Result<()> {
        fetch_object(&self.url, &*self.store, &self.key, file)
    }
}

fn fetch_object(url: &Path, store: &dyn ObjectStore, key: &Key, file: &Path) -> Result<()> {
    let mut out = File::create(file).map_err(|e| Error::io(file, "create", e))?;
    let mut stream = wait(url, "read", store.get(key))?.into_stream();
    while let Some(bytes) = wait(url, "read", stream.try_next())? {
        out.write_all(&bytes).map_err(|e| Error::io(file, "write", e))?;
    }
    Ok(())
}

fn temporary() -> Result<tempfile::TempDir> {
    let built = tempfile::Builder::new().prefix("planecast-").tempdir();
    built.map_err(|e| Error::io(std::env::temp_dir(), "create a folder in", e))
}

fn name_of(url: &Path) -> PathBuf {
    PathBuf::from(url.file_name().unwrap_or("object".as_ref()))
}

/// Fetches an object, or all below a URL that ends with a slash, and says so.
pub(super) fn fetch(url: &Path) -> Result<(Vec<PathBuf>, tempfile::TempDir)> {
    if url.to_string_lossy().ends_with('/') {
        return fetch_folder(url);
    }
    let Some(object) = Object::open(url)? else { return Err(missing(url)) };
    let folder = temporary()?;
    let file = folder.path().join(name_of(url));
    object.fetch(&file)?;
    eprintln!("note: {} was fetched to a temporary file, {}", url.display(), memory::display(object.len));
    Ok((vec![file], folder))
}

/// All objects below a URL, as files below a folder, by name.
fn fetch_folder(url: &Path) -> Result<(Vec<PathBuf>, tempfile::TempDir)> {
    let (store, prefix) = resolve(url)?;
    let mut objects: Vec<_> = wait(url, "list", store.list(Some(&prefix)).try_collect())?;
    if objects.is_empty() {
        return Err(missing(url));
    }
    objects.sort_by(|a: &object_store::ObjectMeta, b| a.location.cmp(&b.location));
    let folder = temporary()?;
    let (mut files, mut total) = (Vec::new(), 0);
    for object in &objects {
        // Parts of a key are names: none of them is a dot or has a slash.
        let below = object.location.prefix_match(&prefix).into_iter().flatten();
        let file = below.fold(folder.path().to_owned(), |path, part| path.join(part.as_ref()));
        let parent = file.parent().unwrap_or(folder.path());
        fs::create_dir_all(parent).map_err(|e| Error::io(parent, "create", e))?;
        fetch_object(url, &*store, &object.location, &file)?;
        total += object.size;
        files.push(file);
    }
    let (n, total) = (objects.len(), memory::display(total));
    eprintln!("note: {n} objects below {} were fetched to a temporary folder, {total}", url.display());
    Ok((files, folder))
}

fn missing(url: &Path) -> Error {
    let none = std::io::Error::new(std::io::ErrorKind::NotFound, "there is no such object");
    Error::io(url, "open", none)
}

/// A world in files that live as long as it does.
struct Fetched {
    world: Box<dyn Pieces>,
    _folder: tempfile::TempDir,
}

impl Pieces for Fetched {
    fn dims(&self) -> [u32; 3] {
        self.world.dims()
    }

    fn colored(&self) -> bool {
        self.world.colored()
    }

    fn notes(&self) -> &[String] {
        self.world.notes()
    }

    fn piece(&self, xs: Range<u32>, zs: Range<u32>) -> Result<Input> {
        self.world.piece(xs, zs)
    }

    fn input_bytes(&self) -> u64 {
        self.world.input_bytes()
    }

    fn rows_together(&self) -> u32 {
        self.world.rows_together()
    }
}

pub(super) fn open_pieces(url: &Path, opts: &ReadOptions) -> Result<Box<dyn Pieces>> {
    let Some(object) = Object::open(url)? else {
        let (_, folder) = fetch_folder(url)?;
        return Ok(Box::new(Fetched { world: source::open_pieces(folder.path(), opts)?, _folder: folder }));
    };
    let mut head = Vec::new();
    object.read(0..object.len.min(HEAD), &mut head)?;
    let format = match opts.format {
        Some(format) => format,
        None if opts.dims.is_some() && !source::is_r16(url) => Format::Raw,
        None => source::detect(url, &head)?,
    };
    if matches!(format, Format::Raw | Format::Npy) {
        // Readers look at the header alone, and at how long the file is: a file of holes behind the head.
        let mut holes = tempfile::tempfile().map_err(|e| Error::io(std::env::temp_dir(), "create a file in", e))?;
        let made = holes.write_all(&head).and_then(|()| holes.set_len(object.len));
        made.map_err(|e| Error::io(std::env::temp_dir(), "write a file in", e))?;
        // SAFETY: the map is read-only, and nobody else knows the file.
        let map = unsafe { memmap2::Mmap::map(&holes) };
        let map = map.map_err(|e| Error::io(std::env::temp_dir(), "map a file in", e))?;
        if let Some(volume) = source::remote_volume(url, &map, format, object, opts)? {
            return Ok(volume);
        }
    }
    let (files, folder) = fetch(url)?;
    Ok(Box::new(Fetched { world: source::open_pieces(&files[0], opts)?, _folder: folder }))
}

/// A file to be put under a URL. It is made in a folder that a later try for the same URL finds again.
pub(super) struct Upload {
    url: PathBuf,
    store: Arc<dyn ObjectStore>,
    key: Key,
    folder: PathBuf,
    file: PathBuf,
}

impl Drop for Upload {
    fn drop(&mut self) {
        // It stays where it holds what can be gone on with.
        let _ = fs::remove_dir(&self.folder);
    }
}

impl Upload {
    /// Finds out before the work whether the store can be reached.
    pub fn new(url: &Path) -> Result<Upload> {
        if url.to_string_lossy().ends_with('/') {
            return Err(Error::Argument(format!("{}: names a folder, an object was expected", url.display())));
        }
        let (store, key) = resolve(url)?;
        Object::open(url)?;
        let hash = xxh3_64(url.to_string_lossy().as_bytes());
        let folder = std::env::temp_dir().join(format!("planecast-to-{hash:016x}"));
        fs::create_dir_all(&folder).map_err(|e| Error::io(&folder, "create", e))?;
        let file = folder.join(name_of(url));
        Ok(Upload { url: url.to_owned(), store, key, folder, file })
    }

    pub fn file(&self) -> &Path {
        &self.file
    }

    pub fn finish(self) -> Result<()> {
        if let Err(e) = self.put() {
            eprintln!("note: the finished file is {}", self.file.display());
            return Err(e);
        }
        fs::remove_file(&self.file).map_err(|e| Error::io(&self.file, "remove", e))
    }

    fn put(&self) -> Result<()> {
        let Upload { url, store, key, .. } = self;
        let failed = |e| Error::io(&self.file, "read", e);
        let mut file = File::open(&self.file).map_err(failed)?;
        let len = file.metadata().map_err(failed)?.len();
        let piece = PIECE.max(len / MAX_PIECES);
        let mut buffer = vec![0; len.min(piece) as usize];
        if len <= piece {
            file.read_exact(&mut buffer).map_err(failed)?;
            wait(url, "write", store.put(key, buffer.into()))?;
            return Ok(());
        }
        let mut upload =
            WriteMultipart::new_with_chunk_size(wait(url, "write", store.put_multipart(key))?, piece as usize);
        let mut left = len;
        let sent = (|| {
            while left > 0 {
                let n = left.min(piece) as usize;
                file.read_exact(&mut buffer[..n]).map_err(failed)?;
                wait(url, "write", async {
                    upload.wait_for_capacity(4).await?;
                    upload.write(&buffer[..n]);
                    Ok(())
                })?;
                left -= n as u64;
            }
            Ok(())
        })();
        match sent {
            Ok(()) => wait(url, "write", upload.finish()).map(drop),
            Err(e) => {
                // The error that counts is the first.
                let _ = wait(url, "write", upload.abort());
                Err(e)
            }
        }
    }
}
