//! Objects and their stores.

use std::fs::{self, File};
use std::future::Future;
use std::io::{Read, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Arc, LazyLock};
use std::time::Duration;

use futures_util::TryStreamExt;
use object_store::path::Path as Key;
use object_store::{ObjectStore, ObjectStoreExt, WriteMultipart};
use tokio::runtime::Runtime;
use xxhash_rust::xxh3::xxh3_64;

use super::http::Http;
use crate::encode::memory;
use crate::model::pieces::{Pieces, keeping};
use crate::source::{self, Format, ReadOptions};
use crate::store::ranges::{HEAD, Ranges};
use crate::store::{scratch, shown};
use crate::{Error, PcastFile, Result};

/// Objects up to this size are put in one request, larger ones in pieces of it or more.
const PIECE: u64 = 16 << 20;
/// Pieces of an upload that S3 allows are 10,000.
const MAX_PIECES: u64 = 9_000;

static RUNTIME: LazyLock<std::io::Result<Runtime>> =
    LazyLock::new(|| tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build());

pub(super) fn runtime() -> Result<&'static Runtime> {
    RUNTIME.as_ref().map_err(|e| Error::Limit(format!("no threads for object storage: {e}")))
}

fn wait<T>(url: &Path, action: &'static str, work: impl Future<Output = object_store::Result<T>>) -> Result<T> {
    runtime()?.block_on(work).map_err(|e| failed(url, action, e))
}

/// A store's error on one line: the innermost causes of some fill a page.
fn failed(url: &Path, action: &'static str, e: object_store::Error) -> Error {
    let text = one_line(&e.to_string());
    let kind = match e {
        object_store::Error::NotFound { .. } => std::io::ErrorKind::NotFound,
        _ => std::io::ErrorKind::Other,
    };
    Error::io(url, action, std::io::Error::new(kind, text))
}

pub(super) fn one_line(text: &str) -> String {
    let mut text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    if let Some((at, _)) = text.char_indices().nth(400) {
        text.truncate(at);
        text.push('…');
    }
    text
}

fn parse(url: &Path) -> Result<url::Url> {
    let parsed = url::Url::parse(&url.to_string_lossy());
    parsed.map_err(|e| Error::Argument(format!("{}: no URL: {e}", shown(url).display())))
}

/// The store that a URL names, and the object in it.
fn resolve(url: &Path) -> Result<(Arc<dyn ObjectStore>, Key)> {
    // Who writes http:// means it, in a URL as in the address of an endpoint.
    let options = std::env::vars().chain([("allow_http".to_owned(), "true".to_owned())]);
    let (store, key) = object_store::parse_url_opts(&parse(url)?, options).map_err(|e| failed(url, "reach", e))?;
    Ok((store.into(), key))
}

/// The address of what is read by plain GET: of no store that is known by its name, or signed.
fn plain(url: &Path) -> Result<Option<url::Url>> {
    let parsed = parse(url)?;
    let web = matches!(parsed.scheme(), "http" | "https");
    let known = || {
        object_store::ObjectStoreScheme::parse(&parsed).is_ok_and(|(s, _)| s != object_store::ObjectStoreScheme::Http)
    };
    Ok((web && (parsed.query().is_some() || !known())).then_some(parsed))
}

/// One object, for reading.
pub(crate) struct Object {
    url: PathBuf,
    place: Place,
    len: u64,
    state: String,
}

enum Place {
    Store(Arc<dyn ObjectStore>, Key),
    Http(Box<Http>),
}

impl Object {
    /// None where there is no such object.
    pub fn open(url: &Path) -> Result<Option<Object>> {
        if let Some(address) = plain(url)? {
            let Some(http) = Http::open(address, &shown(url))? else { return Ok(None) };
            let (len, state) = (http.len(), http.state().to_owned());
            return Ok(Some(Object { url: shown(url), place: Place::Http(Box::new(http)), len, state }));
        }
        let (store, key) = resolve(url)?;
        let found = match wait(url, "open", store.head(&key)) {
            Ok(found) => found,
            Err(Error::Io { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(e) => return Err(e),
        };
        let state = format!("{} {} {:?} {:?}", found.size, found.last_modified, found.e_tag, found.version);
        Ok(Some(Object { url: url.to_owned(), place: Place::Store(store, key), len: found.size, state }))
    }

    pub fn state(&self) -> &str {
        &self.state
    }

    /// The bytes of a range, all of them.
    pub fn read(&self, range: Range<u64>, buffer: &mut Vec<u8>) -> Result<()> {
        let n = range.end - range.start;
        buffer.clear();
        if n > 0 {
            match &self.place {
                Place::Store(store, key) => {
                    buffer.extend_from_slice(&wait(&self.url, "read", store.get_range(key, range))?);
                }
                Place::Http(http) => http.read(range, buffer)?,
            }
        }
        if buffer.len() as u64 != n {
            return Err(Error::format(
                &self.url,
                format!("{} bytes of {n} asked for; it changed meanwhile", buffer.len()),
            ));
        }
        Ok(())
    }

    fn fetch(&self, out: &mut File) -> Result<()> {
        match &self.place {
            Place::Store(store, key) => fetch_object(&self.url, &**store, key, out),
            Place::Http(http) => http.fetch(out),
        }
    }
}

/// Times that a range is asked for, and how long is waited before the second; each time twice as long as before.
const TRIES: u32 = 3;
const PAUSE: Duration = Duration::from_millis(100);

/// Bytes a second below which a server is as good as none, and the time that it has for an answer beside.
const SLOWEST: u64 = 32 << 10;
const PATIENCE: Duration = Duration::from_secs(8);

/// An object whose ranges are read for a scene.
pub(super) struct Far(pub Object);

impl Ranges for Far {
    fn name(&self) -> &Path {
        &self.0.url
    }

    fn size(&self) -> u64 {
        self.0.len
    }

    fn near(&self) -> bool {
        self.0.url.to_string_lossy().starts_with("file:")
    }

    fn read(&self, range: Range<u64>) -> Result<Vec<u8>> {
        let mut bytes = Vec::new();
        let mut tried = 1;
        loop {
            let Place::Http(http) = &self.0.place else {
                // Stores have their own patience.
                self.0.read(range, &mut bytes)?;
                return Ok(bytes);
            };
            let within = PATIENCE + Duration::from_secs((range.end - range.start) / SLOWEST);
            bytes.clear();
            match http.read_within(range.clone(), Some(within), &mut bytes) {
                Ok(()) if bytes.len() as u64 == range.end - range.start => return Ok(bytes),
                Err(e) if tried == TRIES || e.to_string().contains(super::http::CHANGED) => return Err(e),
                _ if tried == TRIES => {
                    let what = format!("{} bytes of {} came", bytes.len(), range.end - range.start);
                    return Err(Error::format(&self.0.url, what));
                }
                _ => std::thread::sleep(PAUSE * 2u32.pow(tried - 1)),
            }
            tried += 1;
        }
    }
}

/// See [`super::ranges`].
pub(super) fn ranges(url: &Path, is_scene: fn(&Path, &[u8]) -> bool) -> Result<Option<Box<dyn Ranges>>> {
    if url.to_string_lossy().ends_with('/') {
        return Ok(None);
    }
    let Some(object) = Object::open(url)? else { return Err(missing(url)) };
    let mut head = Vec::new();
    object.read(0..object.len.min(16), &mut head)?;
    Ok(is_scene(&shown(url), &head).then(|| Box::new(Far(object)) as Box<dyn Ranges>))
}

/// The whole of an object, which has at most `most` bytes.
pub(super) fn text(url: &Path, most: u64) -> Result<Vec<u8>> {
    let Some(object) = Object::open(url)? else { return Err(missing(url)) };
    if object.len > most {
        let what = format!("{} bytes, at most {most} were expected", object.len);
        return Err(Error::format(shown(url), what));
    }
    let mut bytes = Vec::new();
    object.read(0..object.len, &mut bytes)?;
    Ok(bytes)
}

fn fetch_object(url: &Path, store: &dyn ObjectStore, key: &Key, out: &mut File) -> Result<()> {
    let mut stream = wait(url, "read", store.get(key))?.into_stream();
    while let Some(bytes) = wait(url, "read", stream.try_next())? {
        out.write_all(&bytes).map_err(|e| Error::io(std::env::temp_dir(), "write a file in", e))?;
    }
    Ok(())
}

fn create(file: &Path) -> Result<File> {
    File::create(file).map_err(|e| Error::io(file, "create", e))
}

/// See [`super::scene`].
pub(super) fn scene(url: &Path, is_scene: fn(&Path, &[u8]) -> bool) -> Result<Option<PcastFile>> {
    if url.to_string_lossy().ends_with('/') {
        return Ok(None);
    }
    let Some(object) = Object::open(url)? else { return Err(missing(url)) };
    let mut head = Vec::new();
    object.read(0..object.len.min(16), &mut head)?;
    if !is_scene(&shown(url), &head) {
        return Ok(None);
    }
    let mut file = scratch::file().map_err(|e| Error::io(std::env::temp_dir(), "create a file in", e))?;
    object.fetch(&mut file)?;
    crate::note!("note: {} was fetched, {}", shown(url).display(), memory::display(object.len));
    PcastFile::from_file(shown(url), &file).map(Some)
}

fn temporary() -> Result<tempfile::TempDir> {
    let built = tempfile::Builder::new().prefix("planecast-").tempdir();
    built.map_err(|e| Error::io(std::env::temp_dir(), "create a folder in", e))
}

fn name_of(url: &Path) -> PathBuf {
    PathBuf::from(shown(url).file_name().unwrap_or("object".as_ref()))
}

/// Fetches an object, or all below a URL that ends with a slash, and says so.
pub(super) fn fetch(url: &Path) -> Result<(Vec<PathBuf>, tempfile::TempDir)> {
    if url.to_string_lossy().ends_with('/') {
        return fetch_folder(url);
    }
    let Some(object) = Object::open(url)? else { return Err(missing(url)) };
    let folder = temporary()?;
    let file = folder.path().join(name_of(url));
    object.fetch(&mut create(&file)?)?;
    crate::note!("note: {} was fetched to a temporary file, {}", shown(url).display(), memory::display(object.len));
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
        fetch_object(url, &*store, &object.location, &mut create(&file)?)?;
        total += object.size;
        files.push(file);
    }
    let (n, total) = (objects.len(), memory::display(total));
    crate::note!("note: {n} objects below {} were fetched to a temporary folder, {total}", url.display());
    Ok((files, folder))
}

fn missing(url: &Path) -> Error {
    let none = std::io::Error::new(std::io::ErrorKind::NotFound, "there is no such object");
    Error::io(shown(url), "open", none)
}

pub(super) fn open_pieces(url: &Path, opts: &ReadOptions) -> Result<Box<dyn Pieces>> {
    let object = match url.to_string_lossy().ends_with('/') {
        true => None,
        false => Object::open(url)?,
    };
    let Some(object) = object else {
        // A server of pages lists nothing: what it does not have is not there.
        if plain(url)?.is_some() && !url.to_string_lossy().ends_with('/') {
            return Err(missing(url));
        }
        let (_, folder) = fetch_folder(url)?;
        return Ok(keeping(source::open_pieces(folder.path(), opts)?, folder));
    };
    let name = &*shown(url);
    let mut head = Vec::new();
    object.read(0..object.len.min(HEAD), &mut head)?;
    let format = match opts.format {
        Some(format) => format,
        None if opts.dims.is_some() && !source::is_r16(name) => Format::Raw,
        None => source::detect(name, &head)?,
    };
    if matches!(format, Format::Raw | Format::Npy) {
        // Readers look at the header alone, and at how long the file is: a file of holes behind the head.
        let mut holes = tempfile::tempfile().map_err(|e| Error::io(std::env::temp_dir(), "create a file in", e))?;
        let made = holes.write_all(&head).and_then(|()| holes.set_len(object.len));
        made.map_err(|e| Error::io(std::env::temp_dir(), "write a file in", e))?;
        // SAFETY: the map is read-only, and nobody else knows the file.
        let map = unsafe { memmap2::Mmap::map(&holes) };
        let map = map.map_err(|e| Error::io(std::env::temp_dir(), "map a file in", e))?;
        if let Some(volume) = source::remote_volume(name, &map, format, object, opts)? {
            return Ok(volume);
        }
    }
    let (files, folder) = fetch(url)?;
    Ok(keeping(source::open_pieces(&files[0], opts)?, folder))
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
        if let Some(address) = plain(url)?.filter(|address| address.query().is_some()) {
            let what = "an address with a query is read, not written; write a file and put it there";
            return Err(Error::Argument(format!(
                "{}{}: {what}",
                address.host_str().unwrap_or_default(),
                address.path()
            )));
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
            crate::say!("note: the finished file is {}", self.file.display());
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
