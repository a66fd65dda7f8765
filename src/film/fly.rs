//! Films of many frames: drawn in order, saved beside the drawing, stopped and resumed.
//!
//! Frames are on their way through three stages at once, each with threads of its own: drawing (the caller's), conversion to
//! 4:2:0, encoding. An MP4 and a folder are made in *parts* that are saved whole: a PNG each frame where the output is a
//! folder, an encoded segment each [`video::segment_frames`] frames where it is an MP4. Parts are encoded side by side, one a
//! core; a part is begun when a core is free for it, so what waits in memory is bounded by the number of cores. Segments lie in
//! `OUT.mp4.parts/` until the film is whole. Beside the parts lies `fly.json`, which says what film they belong to.
//! Other films (Y4M, ffmpeg's, animated pictures) are one stream. Frames' memory goes round from stage to stage.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, BufWriter, IsTerminal, Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, mpsc};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};
use planecast_encoder::Error as FileError;
use serde_json::{Value, json};

use crate::film::video::mp4::{self, Chunk, Data, Form, Note};
use crate::film::video::{self, Codec, Encoder, Rate, Segment, Yuv, loops, padded, pipe};
use crate::{Camera, Error, Frame, Result, Stats, output};

/// What a film is written as.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Kind {
    /// MP4, index first.
    Mp4(Codec),
    /// `000000.png` and on.
    Folder,
    /// Y4M: every frame as it is, in 4:2:0.
    Y4m,
    /// The same, to standard output.
    Stdout,
    /// GIF that moves.
    Gif,
    /// PNG that moves.
    Apng,
    /// A file of this ending, by the program ffmpeg with these arguments.
    Ffmpeg(String, Vec<String>),
}

impl Kind {
    /// By the name: its ending, `-` for standard output, a folder without one (or where one is). Before any work: an ending
    /// that is not known is an error that says what can be written.
    pub fn of(output: &Path, encoder: Option<&Encoder>) -> Result<Kind> {
        let ending = output.extension().map(|e| e.to_string_lossy().to_lowercase());
        let kind = match ending.as_deref() {
            _ if output == Path::new("-") => Kind::Stdout,
            _ if output.is_dir() => Kind::Folder,
            None => Kind::Folder,
            Some("y4m") => Kind::Y4m,
            Some("gif") => Kind::Gif,
            Some("png" | "apng") => Kind::Apng,
            Some(ending) => match encoder.cloned().unwrap_or_else(Encoder::usual) {
                Encoder::Built(codec) if ending == "mp4" => return Ok(Kind::Mp4(codec)),
                Encoder::Ffmpeg(arguments) if pipe::ENDINGS.iter().any(|(e, _)| *e == ending) => {
                    return Ok(Kind::Ffmpeg(ending.into(), arguments));
                }
                _ => {
                    return Err(Error::Argument(format!(
                        "-o {}: cannot write .{ending}; name an .mp4, .y4m, .gif or .png (both move), a folder for PNG frames, or - for \
                         Y4M to standard output; with --encoder ffmpeg .mov, .mkv or .webm too",
                        output.display()
                    )));
                }
            },
        };
        match encoder {
            Some(encoder) => Err(Error::Argument(format!(
                "--encoder {encoder}: {} is not encoded by it; name an .mp4",
                output.display()
            ))),
            None => Ok(kind),
        }
    }

    /// Whether frames are in 4:2:0, of [`padded`] size.
    pub fn is_yuv(&self) -> bool {
        !matches!(self, Kind::Folder | Kind::Gif | Kind::Apng)
    }

    /// Whether it can be written here, as far as that can be known before.
    pub fn check(&self, size: [u32; 2], fps: f64) -> Result<()> {
        match self {
            Kind::Mp4(codec) => Encoder::Built(*codec).check(size)?,
            Kind::Ffmpeg(_, arguments) => Encoder::Ffmpeg(arguments.clone()).check(size)?,
            Kind::Gif if fps > loops::GIF_FPS => {
                let most = loops::GIF_FPS;
                return Err(Error::Argument(format!(
                    "a GIF shows at most {most} frames a second: lower --fps, or name a .png"
                )));
            }
            Kind::Stdout if io::stdout().is_terminal() => {
                return Err(Error::Argument(
                    "-o -: standard output is a terminal; pipe it into a program, or name a file".into(),
                ));
            }
            _ => {}
        }
        Ok(())
    }
}

/// A film to make.
pub struct Film<'a> {
    pub output: &'a Path,
    pub kind: Kind,
    /// One a frame of the whole film, at least one, all of one size.
    pub cameras: &'a [Camera],
    /// The frames to make, at least one.
    pub range: Range<usize>,
    /// Frames a second.
    pub fps: f64,
    /// Frames are pictures of the whole sphere: MP4 says so to players.
    pub spherical: bool,
    /// Keep the parts that an earlier run has saved.
    pub resume: bool,
    /// What makes the film beside its cameras (scene, options); a resumed film must have the same.
    pub source: Value,
    /// Set from outside to stop after the frame under way.
    pub stop: &'a AtomicBool,
}

/// What was made.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// Frames in the output, from the range's first on without a gap.
    pub frames: usize,
    /// Frames that were kept from an earlier run.
    pub kept: usize,
    /// Of the last frame drawn.
    pub stats: Option<Stats>,
    /// Whoever read standard output has gone.
    pub closed: bool,
}

/// Gets the cameras of all frames that are left and draws the first; and a frame whose memory it may take.
pub type Draw<'d> = dyn FnMut(&[Camera], Option<Frame>) -> Result<Frame> + 'd;

/// Where the parts of an MP4 lie until it is whole.
pub fn parts_folder(output: &Path) -> PathBuf {
    let mut name = output.as_os_str().to_owned();
    name.push(".parts");
    name.into()
}

/// One picture on its way to be saved.
#[expect(clippy::large_enum_variant, reason = "moved a few times per frame; a box would be one more allocation each")]
enum Picture {
    Rgb(Frame),
    Yuv(Yuv),
}

/// Pictures of one part, in order whatever the order in which they come.
struct InOrder {
    receiver: mpsc::Receiver<(usize, Picture)>,
    early: BTreeMap<usize, Picture>,
    next: usize,
}

impl Iterator for InOrder {
    type Item = Picture;

    fn next(&mut self) -> Option<Picture> {
        loop {
            if let Some(picture) = self.early.remove(&self.next) {
                self.next += 1;
                return Some(picture);
            }
            let (i, picture) = self.receiver.recv().ok()?;
            self.early.insert(i, picture);
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().expect("no holder panics")
}

/// What the threads of a film share.
struct Line<'a> {
    stop: &'a AtomicBool,
    progress: Progress,
    /// Memory of pictures that are done with.
    frames: Mutex<Vec<Frame>>,
    yuvs: Mutex<Vec<Yuv>>,
    failure: Mutex<Option<Error>>,
    failed: AtomicBool,
}

/// What is made of some frames in order, one job of a film.
struct Job {
    /// Names the part.
    part: usize,
    frames: Range<usize>,
}

impl<'a> Line<'a> {
    fn new(film: &Film<'a>, kept: usize) -> Line<'a> {
        let progress = Progress::new(film.range.len(), kept);
        let (frames, yuvs, failure, failed) = Default::default();
        Line { stop: film.stop, progress, frames, yuvs, failure, failed }
    }

    fn fail(&self, e: Error) {
        lock(&self.failure).get_or_insert(e);
        self.failed.store(true, Ordering::Relaxed);
    }

    fn halted(&self) -> bool {
        self.stop.load(Ordering::Relaxed) || self.failed.load(Ordering::Relaxed)
    }

    /// A picture is saved.
    fn done(&self, picture: Picture) {
        match picture {
            Picture::Rgb(frame) => lock(&self.frames).push(frame),
            Picture::Yuv(yuv) => lock(&self.yuvs).push(yuv),
        }
        self.progress.advance();
    }

    /// Draws the frames of all jobs, in order, and has each job saved on a thread of its own. `ahead`: pictures of a job that
    /// may wait. Returns the figures of the last frame.
    fn run(
        &self,
        film: &Film,
        jobs: &[Job],
        ahead: usize,
        draw: &mut Draw,
        save: &(dyn Fn(usize, &mut InOrder) -> Result<()> + Sync),
    ) -> Option<Stats> {
        let cores = std::thread::available_parallelism().map_or(1, |n| n.get());
        let mut stats = None;
        std::thread::scope(|scope| {
            // Holds nothing: a job is taken when a thread is free.
            let (job_sender, job_receiver) = mpsc::sync_channel::<(usize, InOrder)>(0);
            let job_receiver = std::sync::Arc::new(Mutex::new(job_receiver));
            for _ in 0..cores.min(jobs.len()) {
                let jobs = job_receiver.clone();
                scope.spawn(move || {
                    loop {
                        let next = lock(&jobs).recv();
                        let Ok((part, mut pictures)) = next else { return };
                        // After a failure what comes is only taken off, so that the drawing side never waits.
                        if !self.failed.load(Ordering::Relaxed)
                            && let Err(e) = save(part, &mut pictures)
                        {
                            self.fail(e);
                        }
                    }
                });
            }
            type Raw = (mpsc::SyncSender<(usize, Picture)>, usize, Frame);
            let converters = if film.kind.is_yuv() { (cores / 8).clamp(1, 4) } else { 0 };
            let (raw_sender, raw_receiver) = mpsc::sync_channel::<Raw>(converters);
            let raw_receiver = std::sync::Arc::new(Mutex::new(raw_receiver));
            for _ in 0..converters {
                let raw = raw_receiver.clone();
                scope.spawn(move || {
                    loop {
                        let next = lock(&raw).recv();
                        let Ok((sender, i, frame)) = next else { return };
                        let mut yuv = lock(&self.yuvs).pop().unwrap_or_default();
                        yuv.fill(&frame);
                        lock(&self.frames).push(frame);
                        // Nobody takes it any more where its job failed.
                        _ = sender.send((i, Picture::Yuv(yuv)));
                    }
                });
            }
            drop(raw_receiver);

            let cameras: Vec<Camera> = jobs.iter().flat_map(|job| &film.cameras[job.frames.clone()]).copied().collect();
            let mut left = &cameras[..];
            for job in jobs {
                if self.halted() {
                    break;
                }
                let (sender, receiver) = mpsc::sync_channel(ahead);
                _ = job_sender.send((job.part, InOrder { receiver, early: BTreeMap::new(), next: 0 }));
                for i in 0..job.frames.len() {
                    if self.halted() {
                        break;
                    }
                    let spare = lock(&self.frames).pop();
                    let drawn = draw(left, spare);
                    left = &left[1..];
                    match drawn {
                        Ok(mut frame) => {
                            stats = Some(std::mem::take(&mut frame.stats));
                            if converters > 0 {
                                _ = raw_sender.send((sender.clone(), i, frame));
                            } else {
                                _ = sender.send((i, Picture::Rgb(frame)));
                            }
                        }
                        Err(e) => self.fail(e),
                    }
                }
            }
        });
        stats
    }

    /// Ends the progress and gives the first failure.
    fn end(self) -> Result<()> {
        self.progress.finish();
        self.failure.into_inner().expect("no holder panics").map_or(Ok(()), Err)
    }
}

/// Draws and saves a film. Stopped, it leaves a whole film of the frames up to there; an MP4 and a folder can be resumed.
pub fn fly(film: &Film, draw: &mut Draw) -> Result<Outcome> {
    match &film.kind {
        Kind::Mp4(codec) => mp4_film(film, *codec, draw),
        Kind::Folder => folder_film(film, draw),
        _ => stream_film(film, draw),
    }
}

fn size(film: &Film) -> [u32; 2] {
    [film.cameras[0].width, film.cameras[0].height]
}

fn mp4_film(film: &Film, codec: Codec, draw: &mut Draw) -> Result<Outcome> {
    let [width, height] = size(film);
    let rate = Rate::new(film.fps);
    output::check(film.output)?;
    let folder = parts_folder(film.output);
    let manifest = manifest(film, Some(codec));
    open_parts(&folder, film, &manifest)?;
    // Segments begin at the same frames whatever part of the film is made.
    let n = video::segment_frames(width, height);
    let Range { start, end } = film.range;
    let parts: BTreeMap<usize, Range<usize>> =
        (start / n..end.div_ceil(n)).map(|k| (k, (k * n).max(start)..((k + 1) * n).min(end))).collect();
    let path = |part: usize| folder.join(format!("{part:06}.segment"));

    let mut segments: BTreeMap<usize, (Vec<u8>, Chunk)> = BTreeMap::new();
    let mut jobs = Vec::new();
    for (&part, frames) in &parts {
        match stored(&path(part)).filter(|(_, chunk)| chunk.sizes.len() == frames.len()) {
            Some(segment) => _ = segments.insert(part, segment),
            None => jobs.push(Job { part, frames: frames.clone() }),
        }
    }
    let kept = film.range.len() - jobs.iter().map(|job| job.frames.len()).sum::<usize>();
    let line = Line::new(film, kept);
    let segments = Mutex::new(segments);
    let stats = line.run(film, &jobs, n, draw, &|part, pictures| {
        let size = [padded(width), padded(height)];
        let mut yuvs = pictures.filter_map(|p| if let Picture::Yuv(yuv) = p { Some(yuv) } else { None });
        let segment =
            video::encode(codec, size, rate, parts[&part].len(), &mut yuvs, &mut |yuv| line.done(Picture::Yuv(yuv)))?;
        // A segment cut short by a stop still belongs to the film that is left.
        let Segment { config, sizes, data } = segment;
        if sizes.is_empty() {
            return Ok(());
        }
        let entry = if sizes.len() == parts[&part].len() {
            let segment = Segment { config, sizes, data };
            output::write_one_of_many(&path(part), |out| video::write_segment(out, &segment))?.finish()?;
            let at = 16 + segment.config.len() as u64 + 4 * segment.sizes.len() as u64;
            (segment.config, Chunk { sizes: segment.sizes, data: Data::File(path(part), at) })
        } else {
            (config, Chunk { sizes, data: Data::Bytes(data) })
        };
        lock(&segments).insert(part, entry);
        Ok(())
    });
    line.end()?;

    let mut segments = segments.into_inner().expect("no holder panics");
    let (mut form, mut chunks, mut frames) = (None, Vec::new(), 0);
    for (part, range) in &parts {
        let Some((config, chunk)) = segments.remove(part) else { break };
        let size = [padded(width) as u16, padded(height) as u16];
        let spherical = film.spherical;
        let form = form.get_or_insert_with(|| Form { codec, config: config.clone(), size, rate, spherical });
        if form.config != config {
            let what =
                "was encoded otherwise than those before it, by another version; remove it and use --resume again";
            return Err(FileError::format(path(*part), what).into());
        }
        frames += chunk.sizes.len();
        let whole = chunk.sizes.len() == range.len();
        chunks.push(chunk);
        if !whole {
            break;
        }
    }
    if let Some(form) = form {
        let made = start..start + frames;
        let of = film.cameras.len();
        let note = (made != (0..of)).then(|| Note { film: number(&manifest), frames: made, of });
        output::write(film.output, |out| mp4::mux(out, &form, &chunks, note.as_ref()))?.finish()?;
    }
    if frames == film.range.len() {
        remove_parts(&folder)?;
        fs::remove_dir(&folder).map_err(|e| FileError::io(&folder, "remove", e))?;
    }
    Ok(Outcome { frames, kept, stats, closed: false })
}

/// A whole segment of an earlier run.
fn stored(path: &Path) -> Option<(Vec<u8>, Chunk)> {
    let file = File::open(path).ok()?;
    let length = file.metadata().ok()?.len();
    let segment = video::read_segment_head(io::BufReader::new(file), length)?;
    let at = 16 + segment.config.len() as u64 + 4 * segment.sizes.len() as u64;
    Some((segment.config, Chunk { sizes: segment.sizes, data: Data::File(path.to_path_buf(), at) }))
}

fn folder_film(film: &Film, draw: &mut Draw) -> Result<Outcome> {
    let folder = film.output;
    open_parts(folder, film, &manifest(film, None))?;
    let path = |frame: usize| folder.join(format!("{frame:06}.png"));
    let jobs: Vec<Job> =
        film.range.clone().filter(|&i| !is_whole_png(&path(i))).map(|i| Job { part: i, frames: i..i + 1 }).collect();
    let kept = film.range.len() - jobs.len();
    let line = Line::new(film, kept);
    let stats = line.run(film, &jobs, 1, draw, &|part, pictures| {
        for picture in pictures {
            if let Picture::Rgb(frame) = &picture {
                output::write_one_of_many(&path(part), |out| output::png(out, frame))?.finish()?;
            }
            line.done(picture);
        }
        Ok(())
    });
    line.end()?;
    let frames = film.range.clone().take_while(|&i| path(i).is_file()).count();
    Ok(Outcome { frames, kept, stats, closed: false })
}

/// A PNG gets its name when it is written, but not when it is on the disk: after a loss of power its end may be missing.
fn is_whole_png(path: &Path) -> bool {
    const END: [u8; 12] = *b"\0\0\0\0IEND\xae\x42\x60\x82";
    let mut end = [0; 12];
    File::open(path)
        .and_then(|mut file| {
            file.seek(SeekFrom::End(-12))?;
            file.read_exact(&mut end)
        })
        .is_ok_and(|()| end == END)
}

/// Films that are one stream.
fn stream_film(film: &Film, draw: &mut Draw) -> Result<Outcome> {
    if film.resume {
        let what = "only an .mp4 or a folder goes on where it was stopped; leave --resume out";
        return Err(FileError::format(film.output, what).into());
    }
    let [width, height] = size(film);
    let rate = Rate::new(film.fps);
    let (frames, closed) = (AtomicUsize::new(0), AtomicBool::new(false));
    let line = Line::new(film, 0);
    let pending = Mutex::new(None);
    let count = |picture: Picture| {
        frames.fetch_add(1, Ordering::Relaxed);
        line.done(picture);
    };
    let y4m = |out: &mut dyn Write, pictures: &mut InOrder| -> io::Result<()> {
        let mut out = out;
        video::y4m_head(&mut out, padded(width), padded(height), rate)?;
        for picture in pictures {
            if let Picture::Yuv(yuv) = &picture {
                video::y4m_frame(&mut out, yuv)?;
            }
            count(picture);
        }
        out.flush()
    };
    // Pictures that move are told how many they are.
    let rgb = |pictures: &mut InOrder, each: &mut dyn FnMut(&Frame) -> io::Result<()>| -> io::Result<()> {
        for picture in pictures {
            if let Picture::Rgb(frame) = &picture {
                each(frame)?;
            }
            count(picture);
        }
        Ok(())
    };
    let n = film.range.len();
    let jobs = [Job { part: 0, frames: film.range.clone() }];
    let stats = line.run(film, &jobs, 4, draw, &|_, pictures| {
        let file = match &film.kind {
            Kind::Stdout => {
                let out = &mut BufWriter::with_capacity(1 << 20, io::stdout().lock());
                return match y4m(out, pictures) {
                    Err(e) if e.kind() == io::ErrorKind::BrokenPipe => {
                        // Whoever read it has seen enough.
                        closed.store(true, Ordering::Relaxed);
                        line.failed.store(true, Ordering::Relaxed);
                        Ok(())
                    }
                    done => Ok(done.map_err(|e| FileError::io("standard output", "write", e))?),
                };
            }
            Kind::Gif => output::write(film.output, |out| {
                let mut gif = loops::Gif::new(out, rate)?;
                rgb(pictures, &mut |frame| gif.frame(frame))
            })?,
            Kind::Apng => output::write(film.output, |out| {
                let mut apng = loops::Apng::new(out, [width, height], rate, n as u32)?;
                rgb(pictures, &mut |frame| apng.frame(frame))?;
                if frames.load(Ordering::Relaxed) < n {
                    return Ok(()); // it is thrown away
                }
                apng.finish()
            })?,
            Kind::Ffmpeg(ending, arguments) => output::write_by(film.output, |path| {
                let mut pipe = pipe::Pipe::open(path, ending, arguments, [padded(width), padded(height)], rate)?;
                for picture in &mut *pictures {
                    // What is wrong is in what ffmpeg says.
                    if let Picture::Yuv(yuv) = &picture
                        && pipe.frame(yuv).is_err()
                    {
                        break;
                    }
                    count(picture);
                }
                pipe.finish()
            })?,
            _ => output::write(film.output, |out| y4m(out, pictures))?,
        };
        *lock(&pending) = Some(file);
        Ok(())
    });
    let (frames, closed) = (frames.load(Ordering::Relaxed), closed.load(Ordering::Relaxed));
    line.end()?;
    if let Some(file) = pending.into_inner().expect("no holder panics")
        && frames > 0
    {
        if film.kind == Kind::Apng && frames < n {
            return Err(Error::Limit(format!(
                "stopped with {frames} of {n} frames: a PNG that moves cannot be cut short, nothing was written"
            )));
        }
        file.finish()?;
    }
    Ok(Outcome { frames, kept: 0, stats, closed })
}

/// Puts the parts of a film together, in any order, without encoding them again. The file is the one that a single `fly` of the
/// whole film makes where parts begin at multiples of its segments' frames; else it has a key frame more for each.
pub fn join(parts: &[PathBuf], output: &Path) -> Result<usize> {
    if parts.is_empty() {
        return Err(Error::Argument("no parts of a film to join".to_owned()));
    }
    let parts = parts.iter().map(|path| Ok(mp4::open_part(path)?)).collect::<Result<Vec<_>>>()?;
    let frames = parts.iter().map(|p| p.note.frames.len()).sum();
    let (form, chunks) = mp4::whole(parts)?;
    output::write(output, |out| mp4::mux(out, &form, &chunks, None))?.finish()?;
    Ok(frames)
}

const MANIFEST: &str = "fly.json";

/// What makes a film, all of it.
fn manifest(film: &Film, codec: Option<Codec>) -> Value {
    let cameras: Vec<Value> =
        film.cameras.iter().map(|c| json!([c.eye.x, c.eye.y, c.eye.z, c.yaw, c.pitch, c.roll, c.fov])).collect();
    let mut manifest = json!({"size": size(film), "frames": cameras.len(), "source": film.source, "cameras": cameras});
    if let Some(codec) = codec {
        manifest["fps"] = json!(film.fps); // a folder of pictures has no pace
        manifest["encoder"] = json!(Encoder::Built(codec).to_string());
    }
    manifest
}

/// A number that tells films apart.
fn number(manifest: &Value) -> String {
    format!("{:016x}", xxhash_rust::xxh3::xxh3_64(manifest.to_string().as_bytes()))
}

/// Whether a file of this name belongs to a film's parts.
fn is_part(name: &str) -> bool {
    let number = name.strip_suffix(".png").or(name.strip_suffix(".segment"));
    name == MANIFEST || number.is_some_and(|n| n.len() >= 6 && n.bytes().all(|b| b.is_ascii_digit()))
}

/// Names of the parts in a folder.
fn parts_in(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut parts = Vec::new();
    for entry in fs::read_dir(folder).map_err(|e| FileError::io(folder, "read", e))? {
        let entry = entry.map_err(|e| FileError::io(folder, "read", e))?;
        if entry.file_name().to_str().is_some_and(is_part) {
            parts.push(entry.path());
        }
    }
    Ok(parts)
}

fn remove_parts(folder: &Path) -> Result<()> {
    for part in parts_in(folder)? {
        fs::remove_file(&part).map_err(|e| FileError::io(&part, "remove", e))?;
    }
    Ok(())
}

/// Makes the folder for the parts ready: empty of parts and with its manifest, or, to resume, with the same one. Some frames of
/// a film may go to a folder where others of it lie.
fn open_parts(folder: &Path, film: &Film, manifest: &Value) -> Result<()> {
    let mut manifest = manifest.clone();
    let frames_apart = film.kind == Kind::Folder && film.range.len() < film.cameras.len();
    if film.kind != Kind::Folder {
        manifest["range"] = json!([film.range.start, film.range.end]);
    }
    let path = folder.join(MANIFEST);
    match fs::create_dir(folder) {
        Err(e) if e.kind() == io::ErrorKind::AlreadyExists => {
            if (film.resume || frames_apart) && path.exists() {
                let text = fs::read_to_string(&path).map_err(|e| FileError::io(&path, "read", e))?;
                let earlier: Value = serde_json::from_str(&text)
                    .map_err(|e| FileError::format(&path, format!("is not the record of a film: {e}")))?;
                // Through text as well: a number read back may differ from what was written in its last bit.
                let now: Value = serde_json::from_str(&manifest.to_string()).expect("what was written can be read");
                let keys = ["size", "fps", "frames", "range", "encoder", "source", "cameras"];
                if let Some(what) = keys.into_iter().find(|key| now.get(key) != earlier.get(key)) {
                    let what = if what == "source" { "scene or options" } else { what };
                    return Err(FileError::format(
                        &path,
                        format!(
                            "is of a film with other {what}; --resume needs the same command, or name another output"
                        ),
                    )
                    .into());
                }
                return Ok(());
            }
            let parts = parts_in(folder)?;
            if !parts.is_empty() && film.kind == Kind::Folder {
                let n = parts.len();
                let what =
                    format!("holds {n} files of an earlier film; go on with it by --resume, or name another folder");
                return Err(FileError::format(folder, what).into());
            }
            remove_parts(folder)?;
        }
        made => made.map_err(|e| FileError::io(folder, "create the folder", e))?,
    }
    output::write(&path, |out| output::json(out, &manifest))?.finish()?;
    Ok(())
}

/// A bar with the time left on a terminal, a plain line every few seconds elsewhere; on stderr.
struct Progress {
    bar: Option<ProgressBar>,
    start: Instant,
    told: Mutex<Instant>,
    done: AtomicUsize,
    kept: usize,
    total: usize,
}

impl Progress {
    const PAUSE: Duration = Duration::from_secs(5);

    fn new(total: usize, kept: usize) -> Progress {
        let bar = io::stderr().is_terminal().then(|| {
            let style = "{bar:40} frame {pos} of {len}, {per_sec}, {eta} left";
            let style = ProgressStyle::with_template(style).expect("the template is valid");
            let bar = ProgressBar::new(total as u64).with_style(style).with_position(kept as u64);
            bar.reset_eta();
            bar
        });
        let start = Instant::now();
        Progress { bar, start, told: Mutex::new(start), done: AtomicUsize::new(kept), kept, total }
    }

    fn advance(&self) {
        let done = self.done.fetch_add(1, Ordering::Relaxed) + 1;
        if let Some(bar) = &self.bar {
            bar.inc(1);
            return;
        }
        let mut told = self.told.lock().expect("no holder panics");
        if told.elapsed() >= Progress::PAUSE {
            *told = Instant::now();
            let rate = (done - self.kept) as f64 / self.start.elapsed().as_secs_f64();
            let left = (self.total - done) as f64 / rate;
            planecast_encoder::note!("frame {done} of {}, {rate:.1} a second, {left:.0} s left", self.total);
        }
    }

    fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    fn cameras(n: usize) -> Vec<Camera> {
        let camera = |i: usize| Camera {
            eye: DVec3::new(i as f64 / 3.0, 0.0, 0.0),
            yaw: 0.0,
            pitch: 0.0,
            roll: 0.0,
            fov: 60.0,
            width: 32,
            height: 18,
        };
        (0..n).map(camera).collect()
    }

    /// A picture that tells its camera.
    fn picture(camera: &Camera) -> Frame {
        let shade = (camera.eye.x * 30.0) as u8;
        Frame {
            width: camera.width,
            height: camera.height,
            color: (0..camera.width * camera.height).map(|i| [shade, i as u8, 99, 255]).collect(),
            depth: Vec::new(),
            voxel: Vec::new(),
            stats: Stats { planes: camera.eye.x as u32, ..Stats::default() },
        }
    }

    struct Run {
        cameras: Vec<Camera>,
        source: Value,
        resume: bool,
        /// Frames drawn before somebody stops the film.
        stop_after: usize,
        /// Frames to make.
        range: Range<usize>,
    }

    impl Run {
        fn new(n: usize) -> Run {
            Run { cameras: cameras(n), source: json!("a"), resume: false, stop_after: usize::MAX, range: 0..n }
        }

        fn fly(&self, output: &Path) -> (Result<Outcome>, usize) {
            let stop = AtomicBool::new(false);
            let mut drawn = 0;
            let source = self.source.clone();
            let kind = match Kind::of(output, None) {
                Ok(kind) => kind,
                Err(e) => return (Err(e), 0),
            };
            let (cameras, range, resume) = (&self.cameras[..], self.range.clone(), self.resume);
            let film = Film { output, kind, cameras, range, fps: 25.0, spherical: false, resume, source, stop: &stop };
            let outcome = fly(&film, &mut |cameras, _| {
                drawn += 1;
                stop.store(drawn >= self.stop_after, Ordering::Relaxed);
                Ok(picture(&cameras[0]))
            });
            (outcome, drawn)
        }
    }

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> =
            fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    /// Samples of an MP4, from its sample size box.
    fn samples(mp4: &Path) -> usize {
        let bytes = fs::read(mp4).unwrap();
        let at = bytes.windows(4).position(|w| w == b"stsz").unwrap();
        u32::from_be_bytes(bytes[at + 12..at + 16].try_into().unwrap()) as usize
    }

    #[test]
    fn fly_to_a_folder_saves_every_frame() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("film");
        let (outcome, drawn) = Run::new(5).fly(&out);
        let outcome = outcome.unwrap();
        assert_eq!((outcome.frames, outcome.kept, drawn, outcome.stats.unwrap().planes), (5, 0, 5, 1));
        assert_eq!(names(&out), ["000000.png", "000001.png", "000002.png", "000003.png", "000004.png", "fly.json"]);
        let last = image::open(out.join("000004.png")).unwrap().into_rgb8();
        assert_eq!(last.get_pixel(7, 0).0, [40, 7, 99]);
    }

    #[test]
    fn fly_resumes_a_folder_without_drawing_twice() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("film");
        let (outcome, drawn) = Run { stop_after: 3, ..Run::new(7) }.fly(&out);
        assert_eq!((outcome.unwrap().frames, drawn), (3, 3));
        fs::remove_file(out.join("000001.png")).unwrap();
        let (outcome, drawn) = Run { resume: true, ..Run::new(7) }.fly(&out);
        let outcome = outcome.unwrap();
        assert_eq!((outcome.frames, outcome.kept, drawn), (7, 2, 5));
    }

    #[test]
    fn fly_resumes_only_the_same_film() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("film");
        Run { stop_after: 1, ..Run::new(3) }.fly(&out).0.unwrap();
        let error = |run: Run| run.fly(&out).0.unwrap_err().to_string();
        assert!(error(Run::new(3)).contains("holds 2 files of an earlier film; go on with it by --resume"));
        assert!(error(Run { resume: true, ..Run::new(4) }).contains("a film with other frames"));
        assert!(error(Run { resume: true, source: json!("b"), ..Run::new(3) }).contains("other scene or options"));
        let mut moved = Run { resume: true, ..Run::new(3) };
        moved.cameras[2].pitch = -1.0;
        assert!(error(moved).contains("other cameras"));
        assert_eq!(Run { resume: true, ..Run::new(3) }.fly(&out).0.unwrap().frames, 3);
    }

    #[test]
    fn fly_reports_a_failed_frame_and_keeps_the_others() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("film");
        let (stop, cameras) = (AtomicBool::new(false), cameras(9));
        let (kind, range, source) = (Kind::Folder, 0..9, Value::Null);
        let film = Film {
            output: &out,
            kind,
            cameras: &cameras,
            range,
            fps: 25.0,
            spherical: false,
            resume: false,
            source,
            stop: &stop,
        };
        let error = fly(&film, &mut |c, _| match c[0].eye.x {
            1.0 => Err(Error::Limit("too far".into())),
            _ => Ok(picture(&c[0])),
        });
        assert_eq!(error.unwrap_err().to_string(), "too far");
        assert!(names(&out).iter().all(|n| is_part(n)), "no half file");
    }

    #[test]
    fn fly_says_what_it_cannot_write() {
        let dir = tempfile::tempdir().unwrap();
        let error = |name: &str| Run::new(1).fly(&dir.path().join(name)).0.unwrap_err().to_string();
        assert!(error("a.webm").contains("cannot write .webm; name an .mp4, .y4m, .gif or .png"));
        assert!(error("no/film").contains("cannot create the folder"));
        assert!(error("no/film.mp4").contains("does not exist; create it first"));
        fs::write(dir.path().join("file"), "").unwrap();
        assert!(error("file").contains("cannot read"), "{}", error("file"));
    }

    #[cfg(any(feature = "h264", feature = "av1"))]
    #[test]
    fn fly_to_an_mp4_leaves_only_the_mp4() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("film.mp4");
        let (outcome, drawn) = Run::new(50).fly(&out);
        assert_eq!((outcome.unwrap().frames, drawn, samples(&out)), (50, 50, 50));
        assert_eq!(names(dir.path()), ["film.mp4"]);
    }

    #[cfg(any(feature = "h264", feature = "av1"))]
    #[test]
    fn fly_stopped_leaves_a_film_and_resumes_to_the_same_one() {
        let dir = tempfile::tempdir().unwrap();
        let (out, whole) = (dir.path().join("film.mp4"), dir.path().join("whole.mp4"));
        let (outcome, drawn) = Run { stop_after: 30, ..Run::new(53) }.fly(&out);
        assert_eq!((outcome.unwrap().frames, drawn, samples(&out)), (30, 30, 30));
        assert_eq!(names(&parts_folder(&out)), ["000000.segment", "fly.json"]);
        let (outcome, drawn) = Run { resume: true, ..Run::new(53) }.fly(&out);
        let outcome = outcome.unwrap();
        assert_eq!((outcome.frames, outcome.kept, drawn), (53, 24, 29));
        Run::new(53).fly(&whole).0.unwrap();
        assert_eq!(fs::read(&out).unwrap(), fs::read(&whole).unwrap());
    }

    #[cfg(any(feature = "h264", feature = "av1"))]
    #[test]
    fn fly_redoes_a_damaged_segment() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("film.mp4");
        Run { stop_after: 49, ..Run::new(72) }.fly(&out).0.unwrap();
        let segment = parts_folder(&out).join("000001.segment");
        let bytes = fs::read(&segment).unwrap();
        fs::write(&segment, &bytes[..bytes.len() - 1]).unwrap();
        let (outcome, drawn) = Run { resume: true, ..Run::new(72) }.fly(&out);
        let outcome = outcome.unwrap();
        assert_eq!((outcome.frames, outcome.kept, drawn), (72, 24, 48));
    }
}
