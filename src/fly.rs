//! Films of many frames: drawn in order, saved beside the drawing, stopped and resumed.
//!
//! A film is made in *parts* that are saved whole: a PNG each frame where the output is a folder, an encoded segment
//! each [`video::segment_frames`] frames where it is an MP4. While one part is drawn, others are encoded, one a core;
//! the channel between holds nothing, so what waits in memory is bounded by the number of cores. Segments lie in
//! `OUT.mp4.parts/` until the film is whole. Beside the parts lies `fly.json`, which says what film they belong to.

use std::collections::BTreeMap;
use std::fs;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, mpsc};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};
use planecast_encoder::Error as FileError;
use serde_json::{Value, json};

use crate::video::{self, Packet, Yuv};
use crate::{Camera, Error, Frame, Result, Stats, output};

/// What a film is written as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// AV1 in MP4.
    Mp4,
    /// `000000.png` and on.
    Folder,
}

impl Kind {
    /// By the name: `.mp4`, or without an extension (or an existing folder).
    pub fn of(output: &Path) -> Result<Kind> {
        match output.extension() {
            _ if output.is_dir() => Ok(Kind::Folder),
            Some(e) if e.eq_ignore_ascii_case("mp4") => Ok(Kind::Mp4),
            None => Ok(Kind::Folder),
            Some(e) => {
                let e = e.display();
                Err(Error::Argument(format!("-o {}: cannot write .{e}; name an .mp4 or a folder", output.display())))
            }
        }
    }
}

/// A film to make.
pub struct Film<'a> {
    pub output: &'a Path,
    /// One a frame, at least one, all of one size.
    pub cameras: &'a [Camera],
    /// Frames a second.
    pub fps: f64,
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
    /// Frames in the output, from the first on without a gap.
    pub frames: usize,
    /// Frames that were kept from an earlier run.
    pub kept: usize,
    /// Of the last frame drawn.
    pub stats: Option<Stats>,
}

/// Where the parts of an MP4 lie until it is whole.
pub fn parts_folder(output: &Path) -> PathBuf {
    let mut name = output.as_os_str().to_owned();
    name.push(".parts");
    name.into()
}

/// One part's pictures on their way to be saved.
enum Work {
    Png(Box<Frame>),
    Segment(Vec<Yuv>),
}

/// Draws and saves a film. Stopped, it leaves a whole film of the frames up to there, and can be resumed. `draw` gets the
/// cameras of all frames that are left and draws the first.
pub fn fly(film: &Film, draw: &mut dyn FnMut(&[Camera]) -> Result<Frame>) -> Result<Outcome> {
    let kind = Kind::of(film.output)?;
    let total = film.cameras.len();
    let [width, height] = [film.cameras[0].width, film.cameras[0].height];
    let (folder, part_frames) = match kind {
        Kind::Folder => (film.output.to_path_buf(), 1),
        Kind::Mp4 => {
            output::check(film.output)?;
            (parts_folder(film.output), video::segment_frames(width, height))
        }
    };
    open_parts(&folder, kind, film)?;
    let parts: Vec<&[Camera]> = film.cameras.chunks(part_frames).collect();
    let part_path = |i: usize| match kind {
        Kind::Folder => folder.join(format!("{i:06}.png")),
        Kind::Mp4 => folder.join(format!("{i:06}.segment")),
    };

    // Whole segments of an earlier run; of a PNG its name is enough, as it was given only to a whole file.
    let mut segments: BTreeMap<usize, Vec<Packet>> = BTreeMap::new();
    let mut missing = Vec::new();
    for (i, part) in parts.iter().enumerate() {
        match kind {
            Kind::Folder if part_path(i).is_file() => {}
            Kind::Mp4 => match fs::read(part_path(i)).ok().and_then(|b| video::read_segment(&b)) {
                Some(packets) if packets.len() == part.len() => _ = segments.insert(i, packets),
                _ => missing.push(i),
            },
            Kind::Folder => missing.push(i),
        }
    }
    let kept = total - missing.iter().map(|&i| parts[i].len()).sum::<usize>();

    let progress = Progress::new(total, kept);
    let segments = Mutex::new(segments);
    let failure: Mutex<Option<Error>> = Mutex::new(None);
    let failed = AtomicBool::new(false);
    let fail = |e: Error| {
        failure.lock().expect("no holder panics").get_or_insert(e);
        failed.store(true, Ordering::Relaxed);
    };
    let halted = || film.stop.load(Ordering::Relaxed) || failed.load(Ordering::Relaxed);
    let save = |i: usize, work: Work| -> Result<()> {
        match work {
            Work::Png(frame) => {
                output::write(&part_path(i), |out| output::png(out, &frame))?.finish()?;
                progress.advance();
            }
            Work::Segment(pictures) => {
                let packets = video::encode(&pictures, film.fps, &mut || progress.advance())?;
                if packets.len() == parts[i].len() {
                    output::write(&part_path(i), |out| video::write_segment(out, &packets))?.finish()?;
                }
                segments.lock().expect("no holder panics").insert(i, packets);
            }
        }
        Ok(())
    };

    let mut stats = None;
    let workers = std::thread::available_parallelism().map_or(1, |n| n.get()).min(missing.len().max(1));
    let (sender, receiver) = mpsc::sync_channel::<(usize, Work)>(0);
    let receiver = Mutex::new(receiver);
    std::thread::scope(|scope| {
        for _ in 0..workers {
            scope.spawn(|| {
                loop {
                    let next = receiver.lock().expect("no holder panics").recv();
                    let Ok((i, work)) = next else { return };
                    // After a failure what comes is only taken off, so that the drawing side never waits.
                    if !failed.load(Ordering::Relaxed)
                        && let Err(e) = save(i, work)
                    {
                        fail(e);
                    }
                }
            });
        }
        let cameras: Vec<Camera> = missing.iter().flat_map(|&i| parts[i]).copied().collect();
        let mut left = &cameras[..];
        for &i in &missing {
            let mut pictures = Vec::new();
            for _ in parts[i] {
                if halted() {
                    break;
                }
                let drawn = draw(left);
                left = &left[1..];
                match drawn {
                    Ok(mut frame) => {
                        stats = Some(std::mem::take(&mut frame.stats));
                        match kind {
                            Kind::Folder => _ = sender.send((i, Work::Png(Box::new(frame)))),
                            Kind::Mp4 => pictures.push(Yuv::new(&frame)),
                        }
                    }
                    Err(e) => fail(e),
                }
            }
            // A segment cut short by a stop still belongs to the film that is left.
            if !pictures.is_empty() {
                _ = sender.send((i, Work::Segment(pictures)));
            }
            if halted() {
                break;
            }
        }
        drop(sender);
    });
    progress.finish();
    if let Some(e) = failure.into_inner().expect("no holder panics") {
        return Err(e);
    }

    let frames = match kind {
        Kind::Folder => (0..total).take_while(|&i| part_path(i).is_file()).count(),
        Kind::Mp4 => {
            let segments = segments.into_inner().expect("no holder panics");
            let mut packets = Vec::new();
            for (i, part) in parts.iter().enumerate() {
                let Some(segment) = segments.get(&i) else { break };
                packets.extend_from_slice(segment);
                if segment.len() < part.len() {
                    break;
                }
            }
            if !packets.is_empty() {
                output::write(film.output, |out| video::mux(out, &packets, width, height, film.fps))?.finish()?;
            }
            if packets.len() == total {
                remove_parts(&folder)?;
                fs::remove_dir(&folder).map_err(|e| FileError::io(&folder, "remove", e))?;
            }
            packets.len()
        }
    };
    Ok(Outcome { frames, kept, stats })
}

const MANIFEST: &str = "fly.json";

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

/// Makes the folder for the parts ready: empty of parts and with its manifest, or, to resume, with the same one.
fn open_parts(folder: &Path, kind: Kind, film: &Film) -> Result<()> {
    let cameras: Vec<Value> =
        film.cameras.iter().map(|c| json!([c.eye.x, c.eye.y, c.eye.z, c.yaw, c.pitch, c.roll, c.fov])).collect();
    let size = [film.cameras[0].width, film.cameras[0].height];
    let mut manifest = json!({"size": size, "frames": cameras.len(), "source": film.source, "cameras": cameras});
    if kind == Kind::Mp4 {
        manifest["fps"] = json!(film.fps); // a folder of pictures has no pace
    }
    let path = folder.join(MANIFEST);
    if folder.exists() {
        if film.resume && path.exists() {
            let text = fs::read_to_string(&path).map_err(|e| FileError::io(&path, "read", e))?;
            let earlier: Value = serde_json::from_str(&text)
                .map_err(|e| FileError::format(&path, format!("is not the record of a film: {e}")))?;
            // Through text as well: a number read back may differ from what was written in its last bit.
            let now: Value = serde_json::from_str(&manifest.to_string()).expect("what was written can be read");
            let keys = ["size", "fps", "frames", "source", "cameras"];
            if let Some(what) = keys.into_iter().find(|key| now.get(key) != earlier.get(key)) {
                let what = if what == "source" { "scene or options" } else { what };
                return Err(FileError::format(
                    &path,
                    format!("is of a film with other {what}; --resume needs the same command, or name another output"),
                )
                .into());
            }
            return Ok(());
        }
        let parts = parts_in(folder)?;
        if !parts.is_empty() && kind == Kind::Folder {
            let n = parts.len();
            let what = format!("holds {n} files of an earlier film; go on with it by --resume, or name another folder");
            return Err(FileError::format(folder, what).into());
        }
        remove_parts(folder)?;
    } else {
        fs::create_dir(folder).map_err(|e| FileError::io(folder, "create the folder", e))?;
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
        let bar = std::io::stderr().is_terminal().then(|| {
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
    }

    impl Run {
        fn new(n: usize) -> Run {
            Run { cameras: cameras(n), source: json!("a"), resume: false, stop_after: usize::MAX }
        }

        fn fly(&self, output: &Path) -> (Result<Outcome>, usize) {
            let stop = AtomicBool::new(false);
            let mut drawn = 0;
            let source = self.source.clone();
            let film = Film { output, cameras: &self.cameras, fps: 25.0, resume: self.resume, source, stop: &stop };
            let outcome = fly(&film, &mut |cameras| {
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
        let film = Film { output: &out, cameras: &cameras, fps: 25.0, resume: false, source: Value::Null, stop: &stop };
        let error = fly(&film, &mut |c| match c[0].eye.x {
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
        assert!(error("a.webm").contains("cannot write .webm; name an .mp4 or a folder"));
        assert!(error("no/film").contains("cannot create the folder"));
        assert!(error("no/film.mp4").contains("does not exist; create it first"));
        fs::write(dir.path().join("file"), "").unwrap();
        assert!(error("file").contains("cannot read"), "{}", error("file"));
    }

    #[cfg(feature = "av1")]
    #[test]
    fn fly_to_an_mp4_leaves_only_the_mp4() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("film.mp4");
        let (outcome, drawn) = Run::new(50).fly(&out);
        assert_eq!((outcome.unwrap().frames, drawn, samples(&out)), (50, 50, 50));
        assert_eq!(names(dir.path()), ["film.mp4"]);
    }

    #[cfg(feature = "av1")]
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

    #[cfg(feature = "av1")]
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
