//! Inputs, parts and scenes on object storage: below `file://`, and on a server that speaks as much of S3's protocol as is
//! needed here.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::Command;
use std::sync::{Arc, Mutex};

/// What the server holds, and what was asked of it.
#[derive(Default)]
struct Bucket {
    objects: BTreeMap<String, Vec<u8>>,
    /// Uploads under way: pieces by number.
    uploads: BTreeMap<String, BTreeMap<u32, Vec<u8>>>,
    /// Method, key, and range or query, one a request.
    log: Vec<String>,
    /// Refuses what would write.
    read_only: bool,
}

/// Serves a bucket named `b` until the test ends; the port.
fn serve(bucket: Arc<Mutex<Bucket>>) -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let bucket = Arc::clone(&bucket);
            std::thread::spawn(move || while answer(stream.as_ref().unwrap(), &bucket).is_some() {});
        }
    });
    port
}

/// One request; None where the connection has ended.
fn answer(stream: &TcpStream, bucket: &Mutex<Bucket>) -> Option<()> {
    let mut reader = BufReader::new(stream);
    let mut line = String::new();
    reader.read_line(&mut line).ok().filter(|&n| n > 0)?;
    let mut words = line.split_whitespace();
    let (method, target) = (words.next()?.to_owned(), words.next()?.to_owned());
    let mut headers = BTreeMap::new();
    loop {
        let mut line = String::new();
        reader.read_line(&mut line).ok()?;
        let Some((name, value)) = line.trim().split_once(':') else { break };
        headers.insert(name.to_lowercase(), value.trim().to_owned());
    }
    let len = headers.get("content-length").map_or(0, |n| n.parse().unwrap());
    let mut body = vec![0; len];
    reader.read_exact(&mut body).ok()?;
    assert!(headers.contains_key("authorization"), "requests are signed");

    let (path, query) = target.split_once('?').unwrap_or((&target, ""));
    let key = path.strip_prefix("/b").unwrap().trim_start_matches('/').to_owned();
    let query: BTreeMap<&str, &str> = query.split('&').map(|q| q.split_once('=').unwrap_or((q, ""))).collect();
    let mut bucket = bucket.lock().unwrap();
    let about = headers.get("range").cloned().unwrap_or_else(|| query.keys().copied().collect::<Vec<_>>().join(","));
    bucket.log.push(format!("{method} {key} {about}").trim_end().to_owned());
    let (mut status, mut more, mut content) = (200, String::new(), Vec::new());
    if bucket.read_only && matches!(method.as_str(), "PUT" | "POST") {
        status = 403;
        content = b"<Error><Code>AccessDenied</Code><Message>no</Message></Error>".to_vec();
    } else {
        match method.as_str() {
            "GET" | "HEAD" if query.contains_key("list-type") => {
                let prefix = query["prefix"].replace("%2F", "/");
                let one = |(key, bytes): (&String, &Vec<u8>)| {
                    let rest = "<LastModified>2026-11-22T00:00:00.000Z</LastModified><ETag>\"e\"</ETag>";
                    format!("<Contents><Key>{key}</Key><Size>{}</Size>{rest}</Contents>", bytes.len())
                };
                let all: String = bucket.objects.iter().filter(|(key, _)| key.starts_with(&prefix)).map(one).collect();
                content = format!("<ListBucketResult>{all}</ListBucketResult>").into_bytes();
            }
            "GET" | "HEAD" => match bucket.objects.get(&key) {
                None => status = 404,
                Some(bytes) => {
                    more = "Last-Modified: Sun, 22 Nov 2026 00:00:00 GMT\r\nETag: \"e\"\r\n".to_owned();
                    content = bytes.clone();
                    if let Some(range) = headers.get("range") {
                        let (from, to) = range.strip_prefix("bytes=").unwrap().split_once('-').unwrap();
                        let (from, to) = (from.parse::<usize>().unwrap(), to.parse::<usize>().unwrap());
                        (status, content) = (206, bytes[from..=to].to_vec());
                        more += &format!("Content-Range: bytes {from}-{to}/{}\r\n", bytes.len());
                    }
                }
            },
            "PUT" if query.contains_key("partNumber") => {
                let pieces = bucket.uploads.get_mut(query["uploadId"]).unwrap();
                pieces.insert(query["partNumber"].parse().unwrap(), body);
                more = "ETag: \"e\"\r\n".to_owned();
            }
            "PUT" => {
                bucket.objects.insert(key, body);
                more = "ETag: \"e\"\r\n".to_owned();
            }
            "POST" if query.contains_key("uploads") => {
                let id = format!("u{}", bucket.uploads.len());
                bucket.uploads.insert(id.clone(), BTreeMap::new());
                let result = format!("<UploadId>{id}</UploadId>");
                content =
                    format!("<InitiateMultipartUploadResult>{result}</InitiateMultipartUploadResult>").into_bytes();
            }
            "POST" => {
                let pieces = bucket.uploads.remove(query["uploadId"]).unwrap();
                bucket.objects.insert(key, pieces.into_values().collect::<Vec<_>>().concat());
                content = b"<CompleteMultipartUploadResult><ETag>\"e\"</ETag></CompleteMultipartUploadResult>".to_vec();
            }
            _ => status = 405,
        }
    }
    drop(bucket);
    let mut answer = format!("HTTP/1.1 {status} x\r\nContent-Length: {}\r\n{more}\r\n", content.len()).into_bytes();
    if method != "HEAD" {
        answer.extend(content);
    }
    let mut stream = stream;
    stream.write_all(&answer).ok()?;
    Some(())
}

/// Exit status and standard error.
fn run(dir: &Path, port: u16, args: &[&str]) -> (Option<i32>, String) {
    let out = Command::new(env!("CARGO_BIN_EXE_planecast-encode"))
        .args(args)
        .current_dir(dir)
        .env("TMPDIR", dir)
        .env("AWS_ENDPOINT", format!("http://127.0.0.1:{port}"))
        .env("AWS_ALLOW_HTTP", "true")
        .env("AWS_ACCESS_KEY_ID", "key")
        .env("AWS_SECRET_ACCESS_KEY", "secret")
        .env("AWS_REGION", "nowhere")
        .output()
        .unwrap();
    (out.status.code(), String::from_utf8_lossy(&out.stderr).into_owned())
}

fn ok(dir: &Path, port: u16, args: &[&str]) -> String {
    let (status, text) = run(dir, port, args);
    assert_eq!(status, Some(0), "{args:?}: {text}");
    text
}

const DIMS: [usize; 3] = [600, 70, 300];

/// Three by two tiles of noise, as u8 and as NPY of u16.
fn volume() -> (Vec<u8>, Vec<u8>) {
    let raw: Vec<u8> = (0..DIMS.iter().product::<usize>()).map(|i| (i * i / 7 + i / 600) as u8).collect();
    let header =
        format!("{{'descr': '<u2', 'fortran_order': False, 'shape': ({}, {}, {}), }}", DIMS[2], DIMS[1], DIMS[0]);
    let mut npy = b"\x93NUMPY\x01\0".to_vec();
    npy.extend((header.len() as u16).to_le_bytes());
    npy.extend(header.bytes());
    npy.extend(raw.iter().flat_map(|&v| u16::from(v).to_le_bytes()));
    (raw, npy)
}

/// Files that the command left in its temporary folder.
fn left_over(dir: &Path) -> Vec<String> {
    let names = std::fs::read_dir(dir).unwrap().map(|e| e.unwrap().file_name().to_string_lossy().into_owned());
    names.filter(|name| name.contains("planecast")).collect()
}

#[test]
fn object_store_parts_are_made_and_joined_to_the_bytes_of_local_files() {
    let bucket = Arc::new(Mutex::new(Bucket::default()));
    let port = serve(Arc::clone(&bucket));
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let (raw, npy) = volume();
    std::fs::write(dir.join("v.raw"), &raw).unwrap();
    std::fs::create_dir(dir.join("store")).unwrap();
    std::fs::write(dir.join("store/v.npy"), &npy).unwrap();
    bucket.lock().unwrap().objects.extend([("in/v.raw".to_owned(), raw), ("in/v.npy".to_owned(), npy)]);
    let dims = format!("{},{},{}", DIMS[0], DIMS[1], DIMS[2]);
    let file_url = format!("file://{}/store", dir.display());

    for (up, n_tiles) in [("y", 6), ("z", 3), ("x", 2)] {
        let how = |name: &'static str| match name.ends_with("npy") {
            true => vec!["--iso", "90", "--up", up],
            false => vec!["--dims", &dims, "--iso", "90", "--up", up],
        };
        // A scene says what it was made of: each input has its own.
        let expected = ["v.raw", "store/v.npy"].map(|local| {
            ok(dir, port, &[&["encode", local, "-o", "local.pcast"], &how(local)[..]].concat());
            std::fs::read(dir.join("local.pcast")).unwrap()
        });

        let inputs = [("s3://b/in/v.raw", "s3://b/out"), ("s3://b/in/v.npy", &file_url)];
        for ((input, store), expected) in inputs.into_iter().zip(&expected) {
            bucket.lock().unwrap().log.clear();
            let parts = format!("{store}/scene.parts/");
            for (i, tiles) in ["0..1".to_owned(), format!("1..{n_tiles}")].iter().enumerate() {
                let part = format!("{parts}{i}.part");
                let text =
                    ok(dir, port, &[&["encode", input, "--tiles", tiles, "-o", &part], &how(input)[..]].concat());
                assert!(!text.contains("fetched"), "{text}");
            }
            let reads = bucket.lock().unwrap().log.clone();
            let whole = |line: &&String| line.starts_with("GET in/") && !line.contains("bytes=");
            assert_eq!(reads.iter().find(whole), None, "the input is read in ranges alone");
            assert!(reads.iter().any(|line| line.starts_with("GET in/v.") && line.contains("bytes=")), "{reads:?}");

            let scene = format!("{store}/scene.pcast");
            let text = ok(dir, port, &["merge", &parts, "-o", &scene]);
            assert!(text.contains("2 objects below"), "{text}");
            let found = match store.starts_with("s3") {
                true => bucket.lock().unwrap().objects["out/scene.pcast"].clone(),
                false => std::fs::read(dir.join("store/scene.pcast")).unwrap(),
            };
            assert!(found == *expected, "{input} --up {up}");
        }
    }
    assert_eq!(left_over(dir), [""; 0]);
}

#[test]
fn object_store_takes_large_files_in_pieces_and_shows_none_that_is_not_whole() {
    let bucket = Arc::new(Mutex::new(Bucket::default()));
    let port = serve(Arc::clone(&bucket));
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let input = "procedural:rocks?size=720";
    ok(dir, port, &["encode", input, "-o", "local.pcast", "--specialize", "off"]);
    let expected = std::fs::read(dir.join("local.pcast")).unwrap();
    assert!(expected.len() > 16 << 20, "{} bytes are put in one piece", expected.len());
    ok(dir, port, &["encode", input, "-o", "s3://b/scene.pcast", "--specialize", "off"]);
    let held = bucket.lock().unwrap();
    assert!(held.objects["scene.pcast"] == expected && held.uploads.is_empty());
    assert!(held.log.iter().any(|line| line.contains("partNumber")), "{:?}", held.log);
    drop(held);
    ok(dir, port, &["verify", "s3://b/scene.pcast", "--quick"]);
    ok(dir, port, &["encode", "procedural:rocks?size=64", "-o", "small.pcast"]);
    ok(dir, port, &["decode", "small.pcast", "-o", "small.raw"]);
    ok(dir, port, &["decode", "small.pcast", "-o", "s3://b/small.raw"]);
    assert!(bucket.lock().unwrap().objects["small.raw"] == std::fs::read(dir.join("small.raw")).unwrap());

    bucket.lock().unwrap().read_only = true;
    let (status, text) = run(dir, port, &["encode", "procedural:rocks?size=64", "-o", "s3://b/other.pcast"]);
    assert_eq!(status, Some(1));
    let last = text.lines().last().unwrap();
    assert!(last.contains("s3://b/other.pcast: cannot write: ") && last.contains("AccessDenied"), "{text}");
    assert!(text.contains("the finished file is "), "{text}");
    assert!(!bucket.lock().unwrap().objects.contains_key("other.pcast"));
}

#[test]
fn object_store_fetches_what_cannot_be_read_in_ranges() {
    let bucket = Arc::new(Mutex::new(Bucket::default()));
    let port = serve(Arc::clone(&bucket));
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let mesh = "v 0 0 0\nv 40 0 3\nv 5 33 30\nf 1 2 3\n";
    std::fs::write(dir.join("m.obj"), mesh).unwrap();
    bucket.lock().unwrap().objects.insert("a/m.obj".to_owned(), mesh.as_bytes().to_vec());
    ok(dir, port, &["encode", "m.obj", "-o", "local.pcast"]);
    let text = ok(dir, port, &["encode", "s3://b/a/m.obj", "-o", "fetched.pcast"]);
    assert!(text.contains("note: s3://b/a/m.obj was fetched to a temporary file, "), "{text}");
    let [a, b] = ["local.pcast", "fetched.pcast"].map(|name| std::fs::read(dir.join(name)).unwrap());
    assert!(a == b);

    let fails = |args: &[&str], status: i32, what: &str| {
        let (found, text) = run(dir, port, args);
        assert_eq!(found, Some(status), "{text}");
        assert!(text.contains(what) && text.lines().count() == 1, "{text}");
    };
    fails(&["encode", "s3://b/none.obj", "-o", "x.pcast"], 1, "s3://b/none.obj: cannot open: there is no such object");
    fails(&["merge", "s3://b/none.part", "-o", "x.pcast"], 1, "cannot open: there is no such object");
    fails(&["encode", "m.obj", "-o", "s3://b/folder/"], 2, "names a folder, an object was expected");
    fails(&["encode", "s3://", "-o", "x.pcast"], 1, "s3://");
    fails(&["encode", "s3://b/a/m.obj", "-o", "s3://b/a/m.obj"], 2, "is the input itself");
    assert_eq!(left_over(dir), [""; 0]);
}

/// What a plain server of files is able to do.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Server {
    Ranges,
    /// Sends all of a file, whatever was asked for.
    Whole,
    /// The same without saying how long it is.
    Chunked,
}

/// Serves one file under `/a/FILE?sig=1%2F2`, GET alone, and keeps the first line of each request.
fn serve_file(server: Server, bytes: Vec<u8>) -> (u16, Arc<Mutex<Vec<String>>>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    let log = Arc::new(Mutex::new(Vec::new()));
    let kept = Arc::clone(&log);
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let (bytes, log) = (bytes.clone(), Arc::clone(&kept));
            std::thread::spawn(move || {
                let mut stream = stream.unwrap();
                let mut reader = BufReader::new(stream.try_clone().unwrap());
                let (mut line, mut range) = (String::new(), None);
                reader.read_line(&mut line).unwrap();
                loop {
                    let mut header = String::new();
                    reader.read_line(&mut header).unwrap();
                    let header = header.trim().to_lowercase();
                    if header.is_empty() {
                        break;
                    }
                    if let Some(asked) = header.strip_prefix("range: bytes=") {
                        let (from, to) = asked.split_once('-').unwrap();
                        let (from, to) = (from.parse::<usize>().unwrap(), to.parse::<usize>().unwrap());
                        range = Some((from, to.min(bytes.len() - 1)));
                    }
                }
                let line = line.trim().to_owned();
                log.lock().unwrap().push(line.clone());
                let right = line.starts_with("GET /a/") && line.contains("?sig=1%2F2 ");
                let answer = match (right, server, range) {
                    (false, ..) if !line.starts_with("GET ") => {
                        b"HTTP/1.1 405 no\r\nContent-Length: 0\r\n\r\n".to_vec()
                    }
                    (false, ..) => b"HTTP/1.1 403 no\r\nContent-Length: 0\r\n\r\n".to_vec(),
                    (true, Server::Ranges, Some((from, to))) => {
                        let part = &bytes[from..=to];
                        let head = format!(
                            "HTTP/1.1 206 part\r\nContent-Length: {}\r\nContent-Range: bytes {from}-{to}/{}\r\nConnection: close\r\n\r\n",
                            part.len(),
                            bytes.len()
                        );
                        [head.as_bytes(), part].concat()
                    }
                    (true, Server::Chunked, _) => {
                        let mut body =
                            b"HTTP/1.1 200 ok\r\nTransfer-Encoding: chunked\r\nConnection: close\r\n\r\n".to_vec();
                        for part in bytes.chunks(50_000) {
                            body.extend(format!("{:x}\r\n", part.len()).into_bytes());
                            body.extend(part);
                            body.extend(b"\r\n");
                        }
                        body.extend(b"0\r\n\r\n");
                        body
                    }
                    _ => {
                        let head =
                            format!("HTTP/1.1 200 ok\r\nContent-Length: {}\r\nConnection: close\r\n\r\n", bytes.len());
                        [head.as_bytes(), &bytes].concat()
                    }
                };
                // Who has seen enough goes away.
                let _ = stream.write_all(&answer);
            });
        }
    });
    (port, log)
}

#[test]
fn plain_servers_are_read_by_get_alone_with_the_query_of_the_address() {
    let dir = tempfile::tempdir().unwrap();
    let (raw, npy) = volume();
    let dims = DIMS.map(|n| n.to_string()).join(",");
    std::fs::write(dir.path().join("a.raw"), &raw).unwrap();
    std::fs::write(dir.path().join("a.npy"), &npy).unwrap();
    let local = |name: &str, more: &[&str]| {
        let args = [&["encode", name, "-o", "local.pcast"][..], more].concat();
        ok(dir.path(), 9, &args);
        std::fs::read(dir.path().join("local.pcast")).unwrap()
    };
    for server in [Server::Ranges, Server::Whole, Server::Chunked] {
        for (name, bytes, more) in
            [("a.raw", &raw, &["--dims", &dims, "--iso", "99"][..]), ("a.npy", &npy, &["--iso", "900"])]
        {
            let scene = local(name, more);
            let (port, log) = serve_file(server, bytes.clone());
            let url = format!("http://127.0.0.1:{port}/a/{name}?sig=1%2F2");
            let said = ok(dir.path(), 9, &[&["encode", &url, "-o", "there.pcast"][..], more].concat());
            assert!(std::fs::read(dir.path().join("there.pcast")).unwrap() == scene, "{server:?} {name}: {said}");
            assert!(said.contains("read as "), "{said}");
            assert!(!said.contains("sig="), "what is secret is not told: {said}");
            let log = log.lock().unwrap();
            assert!(log.iter().all(|line| line.starts_with("GET ") && line.contains("?sig=1%2F2")), "{log:?}");
            assert!(said.contains("its server gives no ranges") == (server != Server::Ranges), "{server:?}: {said}");
            // The scene itself, on such a server.
            let (port, _) = serve_file(server, scene);
            let url = format!("http://127.0.0.1:{port}/a/s.pcast?sig=1%2F2");
            ok(dir.path(), 9, &["info", &url]);
            ok(dir.path(), 9, &["query", &url, "1", "2", "3"]);
            ok(dir.path(), 9, &["verify", &url]);
            ok(dir.path(), 9, &["decode", &url, "-o", "there.raw"]);
            ok(dir.path(), 9, &["decode", "local.pcast", "-o", "here.raw"]);
            let raw = |name: &str| std::fs::read(dir.path().join(name)).unwrap();
            assert!(raw("there.raw") == raw("here.raw"), "{server:?} {name}");
        }
    }
    let (port, _) = serve_file(Server::Ranges, raw.clone());
    for command in [&["verify"][..], &["decode", "-o", "none.raw"]] {
        let url = format!("http://127.0.0.1:{port}/a/a.raw?sig=1%2F2");
        let (status, said) = run(dir.path(), 9, &[&[command[0], &url], &command[1..]].concat());
        assert!(status == Some(1) && said.contains("this is no scene") && !said.contains("sig="), "{said}");
    }
    let (port, _) = serve_file(Server::Ranges, raw);
    let (status, said) = run(dir.path(), 9, &["info", &format!("http://127.0.0.1:{port}/a/a.raw?sig=other")]);
    assert!(status == Some(1) && said.contains("the server refuses with 403") && !said.contains("sig="), "{said}");
}
