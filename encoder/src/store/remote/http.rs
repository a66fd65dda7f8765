//! What a plain server has at an address: read by GET, in ranges where it gives them.

use std::fs::File;
use std::io::Write;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::Duration;

use reqwest::header::{CONTENT_LENGTH, CONTENT_RANGE, ETAG, LAST_MODIFIED, RANGE};
use reqwest::{Client, Response, StatusCode};

use super::object::{one_line, runtime};
use crate::encode::memory;
use crate::store::scratch;
use crate::{Error, Result};

/// Bytes that the first request asks for: enough to tell what a file is, and whether the server gives ranges at all.
const HEAD: u64 = 64 << 10;

/// One file on a server.
pub struct Http {
    client: Client,
    address: url::Url,
    /// The address as errors call it.
    name: PathBuf,
    len: u64,
    state: String,
    /// Its first bytes, where the server gives ranges.
    head: Vec<u8>,
    /// Where it gives none: the whole file, once it was asked for.
    whole: Option<Mutex<Whole>>,
}

enum Whole {
    Coming(Option<Response>),
    Here(File),
}

impl Http {
    /// Asks for the first bytes; None where there is no such file. A server without ranges starts to send all of it, which is
    /// taken when somebody reads on, and a file of unknown length at once.
    pub fn open(address: url::Url, name: &Path) -> Result<Option<Http>> {
        let client = Client::builder()
            .user_agent(concat!("planecast/", env!("CARGO_PKG_VERSION")))
            .connect_timeout(Duration::from_secs(30))
            .read_timeout(Duration::from_secs(60))
            .build()
            .map_err(|e| failed(name, "reach", e))?;
        let mut http = Http {
            client,
            address,
            name: name.to_owned(),
            len: 0,
            state: String::new(),
            head: Vec::new(),
            whole: None,
        };
        let mut response = http.get(Some(0..HEAD))?;
        if response.status() == StatusCode::RANGE_NOT_SATISFIABLE {
            // An empty file has no first byte.
            response = http.get(None)?;
        }
        if matches!(response.status(), StatusCode::NOT_FOUND | StatusCode::GONE) {
            return Ok(None);
        }
        let header = |name| response.headers().get(name).and_then(|v| v.to_str().ok()).map(str::to_owned);
        let (tag, time) = (header(ETAG), header(LAST_MODIFIED));
        if response.status() == StatusCode::PARTIAL_CONTENT {
            let range = header(CONTENT_RANGE).unwrap_or_default();
            let Some(len) = range.rsplit_once('/').and_then(|(_, len)| len.parse().ok()) else {
                return Err(http.wrong(format!("answers with a part of a file, but not how long it is ({range:?})")));
            };
            http.len = len;
            http.head = http.body(response, len.min(HEAD))?;
        } else if response.status().is_success() {
            let len = header(CONTENT_LENGTH).and_then(|len| len.parse().ok());
            let whole = Mutex::new(Whole::Coming(Some(response)));
            http.whole = Some(whole);
            http.len = match len {
                Some(len) => len,
                None => http.with_whole(|file| file.metadata().map(|m| m.len()))?,
            };
        } else {
            return Err(http.refused(response.status()));
        }
        http.state = format!("{} {time:?} {tag:?}", http.len);
        Ok(Some(http))
    }

    pub fn len(&self) -> u64 {
        self.len
    }

    pub fn state(&self) -> &str {
        &self.state
    }

    fn wrong(&self, what: String) -> Error {
        Error::format(&self.name, format!("the server {what}"))
    }

    fn refused(&self, status: StatusCode) -> Error {
        self.wrong(format!("refuses with {status}"))
    }

    fn get(&self, range: Option<Range<u64>>) -> Result<Response> {
        let mut request = self.client.get(self.address.clone());
        if let Some(range) = range {
            request = request.header(RANGE, format!("bytes={}-{}", range.start, range.end - 1));
        }
        // Its clock is set when it is sent: within the runtime.
        runtime()?.block_on(async { request.send().await }).map_err(|e| failed(&self.name, "reach", e))
    }

    /// The body of an answer, which has `n` bytes.
    fn body(&self, mut response: Response, n: u64) -> Result<Vec<u8>> {
        let mut bytes = Vec::new();
        while let Some(part) =
            runtime()?.block_on(async { response.chunk().await }).map_err(|e| failed(&self.name, "read", e))?
        {
            bytes.extend_from_slice(&part);
            if bytes.len() as u64 > n {
                break;
            }
        }
        match bytes.len() as u64 == n {
            true => Ok(bytes),
            false => {
                Err(self.wrong(format!("sends {} bytes, {n} were asked for; the file changed meanwhile", bytes.len())))
            }
        }
    }

    /// All bytes of an answer into a file.
    fn save(&self, mut response: Response, out: &mut File) -> Result<()> {
        while let Some(part) =
            runtime()?.block_on(async { response.chunk().await }).map_err(|e| failed(&self.name, "read", e))?
        {
            out.write_all(&part).map_err(|e| Error::io(std::env::temp_dir(), "write a file in", e))?;
        }
        Ok(())
    }

    fn with_whole<T>(&self, work: impl FnOnce(&mut File) -> std::io::Result<T>) -> Result<T> {
        let here = |e| Error::io(std::env::temp_dir(), "use a file in", e);
        let whole = self.whole.as_ref().ok_or_else(|| self.wrong("gives ranges".to_owned()))?;
        let mut whole = whole.lock().unwrap_or_else(|e| e.into_inner());
        if let Whole::Coming(response) = &mut *whole {
            let response = match response.take() {
                Some(response) => response,
                // A try before this one failed.
                None => self.get(None)?,
            };
            let mut file = scratch::file().map_err(here)?;
            self.save(response, &mut file)?;
            let len = file.metadata().map_err(here)?.len();
            if self.len != 0 && len != self.len {
                return Err(self.wrong(format!("sends {len} bytes of {}", self.len)));
            }
            crate::note!(
                "note: {} was fetched whole: its server gives no ranges; {}",
                self.name.display(),
                memory::display(len)
            );
            *whole = Whole::Here(file);
        }
        match &mut *whole {
            Whole::Here(file) => work(file).map_err(here),
            Whole::Coming(_) => Err(self.wrong("sends nothing".to_owned())),
        }
    }

    /// Appends the bytes of a range, all of them.
    pub fn read(&self, range: Range<u64>, buffer: &mut Vec<u8>) -> Result<()> {
        let n = range.end - range.start;
        if range.end <= self.head.len() as u64 {
            buffer.extend_from_slice(&self.head[range.start as usize..range.end as usize]);
            return Ok(());
        }
        if self.whole.is_some() {
            let from = buffer.len();
            buffer.resize(from + n as usize, 0);
            return self.with_whole(|file| scratch::read_at(file, &mut buffer[from..], range.start));
        }
        let response = self.get(Some(range))?;
        match response.status() {
            StatusCode::PARTIAL_CONTENT => buffer.extend(self.body(response, n)?),
            StatusCode::OK => return Err(self.wrong("gives ranges no longer; try again".to_owned())),
            status => return Err(self.refused(status)),
        }
        Ok(())
    }

    /// Writes the whole file.
    pub fn fetch(&self, out: &mut File) -> Result<()> {
        if self.whole.is_some() {
            return self.with_whole(|file| {
                use std::io::Seek;
                file.rewind()?;
                std::io::copy(file, out).map(drop)
            });
        }
        if self.len == self.head.len() as u64 {
            return out.write_all(&self.head).map_err(|e| Error::io(std::env::temp_dir(), "write a file in", e));
        }
        let response = self.get(None)?;
        if !response.status().is_success() {
            return Err(self.refused(response.status()));
        }
        self.save(response, out)
    }
}

/// Why a request came to nothing, without the address, which may be signed.
fn failed(name: &Path, action: &'static str, e: reqwest::Error) -> Error {
    let e = e.without_url();
    let mut text = e.to_string();
    let mut cause: Option<&dyn std::error::Error> = std::error::Error::source(&e);
    while let Some(inner) = cause {
        text = inner.to_string();
        cause = inner.source();
    }
    Error::io(name, action, std::io::Error::other(one_line(&text)))
}
