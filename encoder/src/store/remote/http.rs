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
use crate::store::ranges::HEAD;
use crate::store::scratch;
use crate::{Error, Result};

/// What errors say of a file that is another by now.
pub const CHANGED: &str = "has another file there by now; open it again";

/// One file on a server.
pub struct Http {
    client: Client,
    address: url::Url,
    /// The address as errors call it.
    name: PathBuf,
    len: u64,
    state: String,
    /// Its tag and time, as the server told them first.
    told: [Option<String>; 2],
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
            told: Default::default(),
            head: Vec::new(),
            whole: None,
        };
        let mut response = http.get(Some(0..HEAD), None)?;
        if response.status() == StatusCode::RANGE_NOT_SATISFIABLE {
            // An empty file has no first byte.
            response = http.get(None, None)?;
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
        http.told = [tag, time];
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

    /// The answer, all of which must have come after `within`, where that is given.
    fn get(&self, range: Option<Range<u64>>, within: Option<Duration>) -> Result<Response> {
        let mut request = self.client.get(self.address.clone());
        if let Some(within) = within {
            request = request.timeout(within);
        }
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
                None => self.get(None, None)?,
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
        self.read_within(range, None, buffer)
    }

    /// The same, `within` a time.
    pub fn read_within(&self, range: Range<u64>, within: Option<Duration>, buffer: &mut Vec<u8>) -> Result<()> {
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
        let response = self.get(Some(range.clone()), within)?;
        let header = |name| response.headers().get(name).and_then(|v| v.to_str().ok());
        let now = [header(ETAG), header(LAST_MODIFIED)];
        let changed = self
            .told
            .iter()
            .zip(now)
            .any(|(then, now)| then.as_deref().zip(now).is_some_and(|(then, now)| then != now));
        if response.status().is_success() && changed {
            return Err(self.wrong(CHANGED.to_owned()));
        }
        let got = header(CONTENT_RANGE).unwrap_or_default().trim_start_matches("bytes ").to_owned();
        let asked = format!("{}-{}/", range.start, range.end - 1);
        if response.status() == StatusCode::PARTIAL_CONTENT && !got.starts_with(&asked) {
            return Err(self.wrong(format!("sends bytes {got} where {asked}{} was asked for", self.len)));
        }
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
        let response = self.get(None, None)?;
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

#[cfg(test)]
mod tests {
    use std::io::{BufRead, BufReader};
    use std::net::{TcpListener, TcpStream};
    use std::sync::Arc;
    use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};

    use super::*;
    use crate::model::tiles::{TileKey, TileSource};
    use crate::source::procedural::{Kind, procedural};
    use crate::source::tiles;
    use crate::{BuildOptions, build};

    /// Serves one file, as far away as a test says, and as badly.
    #[derive(Default)]
    struct Server {
        file: Mutex<Vec<u8>>,
        tag: AtomicUsize,
        /// Milliseconds before each answer, and bytes a millisecond.
        latency: AtomicU64,
        rate: AtomicU64,
        sent: AtomicU64,
        requests: AtomicUsize,
        /// Answers that are: lies, cut short, refused, of another range.
        lies: AtomicUsize,
        cuts: AtomicUsize,
        refusals: AtomicUsize,
        others: AtomicUsize,
    }

    fn take(n: &AtomicUsize) -> bool {
        n.fetch_update(Ordering::SeqCst, Ordering::SeqCst, |n| n.checked_sub(1)).is_ok()
    }

    impl Server {
        fn start(file: Vec<u8>) -> (Arc<Server>, PathBuf) {
            let server =
                Arc::new(Server { file: Mutex::new(file), rate: AtomicU64::new(1 << 30), ..Server::default() });
            let listener = TcpListener::bind("127.0.0.1:0").unwrap();
            let address = format!("http://{}/world.pcast", listener.local_addr().unwrap());
            let own = Arc::clone(&server);
            std::thread::spawn(move || {
                for stream in listener.incoming() {
                    let server = Arc::clone(&own);
                    std::thread::spawn(move || while server.answer(stream.as_ref().unwrap()).is_some() {});
                }
            });
            (server, address.into())
        }

        fn answer(&self, mut stream: &TcpStream) -> Option<()> {
            let mut reader = BufReader::new(stream);
            let mut range = None;
            loop {
                let mut line = String::new();
                reader.read_line(&mut line).ok().filter(|&n| n > 0)?;
                let Some((name, value)) = line.trim().split_once(": ") else {
                    if line.trim().is_empty() {
                        break;
                    }
                    continue;
                };
                if name.eq_ignore_ascii_case("range") {
                    let (from, to) = value.strip_prefix("bytes=")?.split_once('-')?;
                    range = Some([from.parse::<usize>().ok()?, to.parse::<usize>().ok()?]);
                }
            }
            self.requests.fetch_add(1, Ordering::SeqCst);
            std::thread::sleep(Duration::from_millis(self.latency.load(Ordering::SeqCst)));
            let file = self.file.lock().unwrap().clone();
            let [from, to] = range?;
            let to = to.min(file.len() - 1);
            let mut body = file[from..=to].to_vec();
            let status = if take(&self.refusals) { "503 Busy" } else { "206 Partial Content" };
            if take(&self.lies) {
                let n = body.len();
                body[n / 2] ^= 0x10;
            }
            let moved = usize::from(take(&self.others));
            let tag = self.tag.load(Ordering::SeqCst);
            let head = format!(
                "HTTP/1.1 {status}\r\nContent-Length: {}\r\nContent-Range: bytes {}-{}/{}\r\nETag: \"{tag}\"\r\n\r\n",
                body.len(),
                from + moved,
                to + moved,
                file.len()
            );
            stream.write_all(head.as_bytes()).ok()?;
            let cut = take(&self.cuts);
            let end = if cut { body.len() / 2 } else { body.len() };
            for part in body[..end].chunks(16 << 10) {
                stream.write_all(part).ok()?;
                self.sent.fetch_add(part.len() as u64, Ordering::SeqCst);
                std::thread::sleep(Duration::from_micros(1000 * part.len() as u64 / self.rate.load(Ordering::SeqCst)));
            }
            (!cut).then_some(())
        }
    }

    fn scene() -> Vec<u8> {
        let scene = build(procedural(Kind::Rocks, 1100, 3).unwrap(), &BuildOptions::default()).unwrap();
        let mut out = std::io::Cursor::new(Vec::new());
        crate::format::write::write_scene_to(&scene, &mut out, Path::new("s.pcast")).unwrap();
        out.into_inner()
    }

    fn open(url: &Path) -> Result<Arc<dyn TileSource>> {
        tiles::open(url, &Default::default()).map(|found| found.expect("a scene gives tiles"))
    }

    #[test]
    fn http_tiles_come_by_ranges_and_the_first_picture_takes_little() {
        let (server, url) = Server::start(scene());
        server.latency.store(50, Ordering::SeqCst);
        // 100 Mbit/s.
        server.rate.store(12_500, Ordering::SeqCst);
        let from_file = crate::PcastFile::from_bytes("s.pcast", server.file.lock().unwrap().clone()).unwrap();
        let world = open(&url).unwrap();
        // Coarse levels, as a picture of the whole shows first.
        for level in (3..world.levels()).rev() {
            let n = world.dims()[0].div_ceil(256 << level);
            for (x, z) in (0..n).flat_map(|z| (0..n).map(move |x| (x, z))) {
                let key = TileKey { level, x, z };
                assert!(world.tile(key).unwrap() == TileSource::tile(&from_file, key).unwrap());
            }
        }
        let (sent, requests) = (server.sent.load(Ordering::SeqCst), server.requests.load(Ordering::SeqCst));
        assert!(sent <= 1 << 20, "{sent} bytes for the first picture");
        assert!(requests <= 4, "{requests} requests for the first picture");
        let key = TileKey { level: 0, x: 1, z: 2 };
        assert!(world.tile(key).unwrap() == TileSource::tile(&from_file, key).unwrap());
    }

    #[test]
    fn http_servers_that_fail_are_asked_again_and_those_that_lie_are_named() {
        let (server, url) = Server::start(scene());
        let world = open(&url).unwrap();
        let key = |x, z| TileKey { level: 0, x, z };
        // Passing trouble is not seen.
        server.refusals.store(1, Ordering::SeqCst);
        server.cuts.store(1, Ordering::SeqCst);
        world.tile(key(0, 0)).unwrap();
        server.others.store(1, Ordering::SeqCst);
        world.tile(key(0, 1)).unwrap();
        // What stays is told with the tile's name; the next who asks has it.
        server.refusals.store(3, Ordering::SeqCst);
        let refused = world.tile(key(0, 2)).unwrap_err().to_string();
        assert!(refused.contains("tile (0, 2) of level 0") && refused.contains("503"), "{refused}");
        world.tile(key(0, 2)).unwrap();
        server.lies.store(1, Ordering::SeqCst);
        let lied: Vec<_> = (0..4).map(|x| world.tile(key(x, 3))).collect();
        let lied: Vec<String> = lied.into_iter().filter_map(|tile| Some(tile.err()?.to_string())).collect();
        assert!(lied.len() == 1 && lied[0].contains("of level 0") && lied[0].contains("checksum"), "{lied:?}");
        assert!((0..4).all(|x| world.tile(key(x, 3)).is_ok()));
        server.tag.store(1, Ordering::SeqCst);
        let requests = server.requests.load(Ordering::SeqCst);
        let changed = world.tile(key(0, 4)).unwrap_err().to_string();
        assert!(changed.contains("tile (0, 4)") && changed.contains(CHANGED), "{changed}");
        assert_eq!(
            server.requests.load(Ordering::SeqCst),
            requests + 1,
            "what has changed is not asked for at once again"
        );
        server.tag.store(0, Ordering::SeqCst);
        world.tile(key(0, 4)).unwrap();
        server.file.lock().unwrap().truncate(5000);
        assert!(open(&url).err().unwrap().to_string().contains("it was cut short or added to"));
    }

    #[test]
    fn http_servers_that_never_answer_are_given_up() {
        let (server, url) = Server::start(scene());
        let address = url::Url::parse(&url.to_string_lossy()).unwrap();
        let http = Http::open(address, &url).unwrap().unwrap();
        server.latency.store(60_000, Ordering::SeqCst);
        let mut bytes = Vec::new();
        let slow = http.read_within(70_000..80_000, Some(Duration::from_millis(60)), &mut bytes).unwrap_err();
        assert!(slow.to_string().contains("timed out") || slow.to_string().contains("cannot"), "{slow}");
    }
}
