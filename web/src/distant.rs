//! Worlds that are read by ranges, or made, tile by tile: in a worker, where a request may wait for its answer.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use planecast::world::parcel::Packer;
use planecast_encoder::format::ranged::RangedFile;
use planecast_encoder::format::sheets::{Manifest, Sheets, is_manifest};
use planecast_encoder::source::{ReadOptions, tiles};
use planecast_encoder::store::ranges::{HEAD, Ranges};
use planecast_encoder::{Error, Result, TileKey, TileSource};
use wasm_bindgen::prelude::*;
use web_sys::{XmlHttpRequest, XmlHttpRequestResponseType};

use super::failed;

/// How often a request is sent that comes to nothing.
const TRIES: u32 = 3;

/// Bytes that came over the network.
static FETCHED: AtomicU64 = AtomicU64::new(0);

/// The answer to a request for a range, or for all, of a file: status, bytes and how many the file has.
fn ask(url: &str, range: Option<Range<u64>>) -> std::result::Result<(u16, Vec<u8>, Option<u64>), String> {
    let told = |e: JsValue| format!("{e:?}");
    let request = XmlHttpRequest::new().map_err(told)?;
    request.open_with_async("GET", url, false).map_err(told)?;
    request.set_response_type(XmlHttpRequestResponseType::Arraybuffer);
    if let Some(range) = range {
        request.set_request_header("Range", &format!("bytes={}-{}", range.start, range.end - 1)).map_err(told)?;
    }
    request.send().map_err(|_| "the server does not answer".to_owned())?;
    let bytes = js_sys::Uint8Array::new(&request.response().map_err(told)?).to_vec();
    FETCHED.fetch_add(bytes.len() as u64, Ordering::Relaxed);
    let of = request.get_response_header("content-range").ok().flatten();
    let of = of.and_then(|text| text.rsplit_once('/')?.1.parse().ok());
    Ok((request.status().map_err(told)?, bytes, of))
}

/// The same, again where that may help; an error says what came.
fn fetch(url: &str, range: Option<Range<u64>>) -> Result<(u16, Vec<u8>, Option<u64>)> {
    let mut why = String::new();
    for _ in 0..TRIES {
        match ask(url, range.clone()) {
            Ok((status, ..)) if status >= 500 || status == 429 => why = format!("the server answers {status}"),
            Ok((status @ (200 | 206), bytes, of)) => return Ok((status, bytes, of)),
            Ok((status, ..)) => {
                why = format!("the server answers {status}");
                break;
            }
            Err(what) => why = what,
        }
    }
    Err(Error::io(url, "read", std::io::Error::other(why)))
}

/// A file on a server.
struct Distant {
    name: PathBuf,
    url: String,
    size: u64,
    /// What was asked for first: the header, and most directories.
    head: Vec<u8>,
}

impl Distant {
    fn open(url: &str) -> Result<Distant> {
        let (status, head, of) = fetch(url, Some(0..HEAD))?;
        let Some(size) = of.filter(|_| status == 206) else {
            let what = "the server gives no parts of files, and this one comes in tiles";
            return Err(Error::io(url, "read", std::io::Error::other(what)));
        };
        Ok(Distant { name: url.into(), url: url.into(), size, head })
    }
}

impl Ranges for Distant {
    fn name(&self) -> &Path {
        &self.name
    }

    fn size(&self) -> u64 {
        self.size
    }

    fn near(&self) -> bool {
        false
    }

    fn read(&self, range: Range<u64>) -> Result<Vec<u8>> {
        if let Some(part) = self.head.get(range.start as usize..range.end as usize) {
            return Ok(part.to_vec());
        }
        let n = range.end - range.start;
        let (status, bytes, _) = fetch(&self.url, Some(range))?;
        if status != 206 || bytes.len() as u64 != n {
            let what = format!("the server gives {} bytes with status {status} where {n} were asked for", bytes.len());
            return Err(Error::io(&self.url, "read", std::io::Error::other(what)));
        }
        Ok(bytes)
    }
}

fn open(name: &str) -> Result<Arc<dyn TileSource>> {
    if name.starts_with("procedural:") {
        let none =
            || Error::Argument(format!("{name}: no world that is made tile by tile; try procedural:hills?size=inf"));
        return tiles::open(Path::new(name), &ReadOptions::default())?.ok_or_else(none);
    }
    if !is_manifest(Path::new(name)) {
        return Ok(Arc::new(RangedFile::open(Box::new(Distant::open(name)?))?));
    }
    let manifest = Manifest::parse(Path::new(name), &fetch(name, None)?.1)?;
    let open = |file: &Path| open(&file.to_string_lossy());
    Ok(Arc::new(Sheets::new(Path::new(name), manifest, Box::new(open))?))
}

/// A world whose tiles are read or made here, for [`super::Page`] to draw.
#[wasm_bindgen]
pub struct Tiles {
    packer: Packer,
}

#[wasm_bindgen]
impl Tiles {
    /// The address of a scene file or of a `.pworld`, or `procedural:NAME?size=inf`.
    #[wasm_bindgen(constructor)]
    pub fn new(name: &str) -> std::result::Result<Tiles, JsValue> {
        Ok(Tiles { packer: Packer::new(open(name).map_err(failed)?) })
    }

    /// For [`super::Page::load_tiles`].
    pub fn facts(&self) -> std::result::Result<Vec<u8>, JsValue> {
        self.packer.facts().map_err(failed)
    }

    /// The parcel of a tile, for [`super::Page::deliver`].
    pub fn tile(&self, level: u32, x: u32, z: u32, heights: bool) -> std::result::Result<Vec<u8>, JsValue> {
        self.packer.tile(TileKey { level, x, z }, heights).map_err(failed)
    }

    /// Bytes that came over the network so far.
    pub fn fetched() -> f64 {
        FETCHED.load(Ordering::Relaxed) as f64
    }
}
