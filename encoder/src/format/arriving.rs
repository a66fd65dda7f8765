//! Scene files that come in parts, coarse to fine: from a server that answers ranges of bytes.
//!
//! The coarser levels of a scene are a scene by themselves, and take little: a third of what level 0 takes, all together.
//! [`ArrivingFile`] says which ranges to fetch next, and what is there can be read meanwhile.

use std::collections::BTreeSet;
use std::ops::Range;
use std::path::{Path, PathBuf};

use bytemuck::pod_read_unaligned;

use crate::format::{self, Header, TileEntry};
use crate::{Error, PcastFile, Result, Scene};

/// Bytes that the levels of the first picture take together at most, unless the coarsest alone takes more.
const FIRST: u64 = 1 << 18;

/// Bytes of one range at most.
const RANGE: u64 = 1 << 22;

/// Unwanted bytes between two blobs that are fetched rather than asked around.
const GAP: u64 = 1 << 14;

/// A scene file of which some is there.
pub struct ArrivingFile {
    path: PathBuf,
    state: State,
    /// What is on its way, or to be asked for.
    wanted: Vec<Range<u64>>,
    /// Blobs that are there or wanted, by where they begin.
    blobs: BTreeSet<u64>,
    /// The finest level that will be there with what is wanted.
    coming: usize,
    /// The finest level that is there.
    here: Option<usize>,
    /// Bytes that were there from the begin, and that are there.
    head: u64,
    fetched: u64,
}

enum State {
    /// The directory is not there yet; the file's bytes, zero where they are not there.
    Opening(Vec<u8>),
    Open(PcastFile),
}

impl ArrivingFile {
    /// From the first bytes of a file, [`HEAD`](crate::store::ranges::HEAD) or all of them; `len` is how many there are, where that is known. `path` is
    /// what errors call it. An error where they are not the begin of a scene file.
    pub fn new(path: impl AsRef<Path>, head: Vec<u8>, len: Option<u64>) -> Result<ArrivingFile> {
        let path = path.as_ref();
        let fetched = head.len() as u64;
        let header = head.get(..size_of::<Header>()).map(pod_read_unaligned::<Header>);
        let header = match header.filter(|h| h.magic == format::MAGIC && h.checksum == h.checksum()) {
            Some(Header { file_len, .. }) if len.is_some_and(|len| len != file_len) => {
                let len = len.unwrap_or_default();
                let what = format!(
                    "byte 40: the file has {len} bytes, its header says {file_len}; it was cut short or added to"
                );
                return Err(Error::format(path, what));
            }
            Some(header) if header.file_len > fetched => header,
            // All of a file, or nothing of a scene: who reads files knows what to say.
            _ => {
                let state = State::Open(PcastFile::from_bytes(path, head)?);
                let (wanted, blobs) = Default::default();
                let (coming, here) = (0, Some(0));
                return Ok(ArrivingFile {
                    path: path.into(),
                    state,
                    wanted,
                    blobs,
                    coming,
                    here,
                    head: fetched,
                    fetched,
                });
            }
        };
        let directory = u64::from(header.n_tiles) * size_of::<TileEntry>() as u64;
        let Some(end) = header.directory.checked_add(directory).filter(|&end| end <= header.file_len) else {
            let what = format!("byte 32: a directory at byte {} does not fit the file", header.directory);
            return Err(Error::format(path, what));
        };
        let mut bytes = Vec::new();
        let room = usize::try_from(header.file_len).ok().filter(|&n| bytes.try_reserve_exact(n).is_ok());
        let Some(room) = room else {
            return Err(Error::Limit(format!("{}: no memory for {} bytes", path.display(), header.file_len)));
        };
        bytes.extend_from_slice(&head);
        bytes.resize(room, 0);
        let mut file = ArrivingFile {
            path: path.into(),
            state: State::Opening(bytes),
            wanted: Some(fetched..end).filter(|r| !r.is_empty()).into_iter().collect(),
            blobs: BTreeSet::new(),
            coming: 0,
            here: None,
            head: fetched,
            fetched,
        };
        file.go_on()?;
        Ok(file)
    }

    /// Ranges of bytes to fetch for the next step; none when all is there.
    pub fn wanted(&self) -> &[Range<u64>] {
        &self.wanted
    }

    /// The finest level that is there; all coarser ones are, too.
    pub fn level(&self) -> Option<usize> {
        self.here
    }

    /// Bytes that are there, and of the file.
    pub fn progress(&self) -> [u64; 2] {
        let len = match &self.state {
            State::Opening(bytes) => bytes.len() as u64,
            State::Open(file) => file.file_len(),
        };
        [self.fetched, len]
    }

    /// Takes one of the ranges that are wanted, whole. With the last of them a level is there.
    pub fn put(&mut self, at: u64, part: &[u8]) -> Result<()> {
        let end = at.saturating_add(part.len() as u64);
        let Some(ix) = self.wanted.iter().position(|r| *r == (at..end)) else {
            let what = format!("byte {at}: {} bytes, which nobody asked for; the server answers otherwise", part.len());
            return Err(Error::format(&self.path, what));
        };
        let bytes = match &mut self.state {
            State::Opening(bytes) => bytes.as_mut_slice(),
            State::Open(file) => file.bytes_mut(),
        };
        // What is wanted lies in the file, which is in memory.
        bytes[at as usize..end as usize].copy_from_slice(part);
        self.wanted.swap_remove(ix);
        self.fetched += part.len() as u64;
        if self.wanted.is_empty() { self.go_on() } else { Ok(()) }
    }

    /// All that was wanted is there: opens the file, or wants what is finer.
    fn go_on(&mut self) -> Result<()> {
        if !self.wanted.is_empty() {
            return Ok(());
        }
        let n_levels = match &mut self.state {
            State::Opening(bytes) => {
                let file = PcastFile::from_bytes(&self.path, std::mem::take(bytes))?;
                self.coming = file.grids().len();
                self.state = State::Open(file);
                self.coming
            }
            State::Open(file) => {
                self.here = Some(self.coming);
                file.grids().len()
            }
        };
        // Levels without a blob of their own come with the one before.
        let mut taken = 0;
        while self.coming > 0 {
            let blobs = self.blobs_of(self.coming - 1);
            let bytes: u64 = blobs.iter().map(|b| b.end - b.start).sum();
            if taken > 0 && bytes > 0 && (self.here.is_some() || taken + bytes > FIRST) {
                break;
            }
            taken += bytes;
            self.coming -= 1;
            self.blobs.extend(blobs.iter().map(|b| b.start));
            self.wanted.extend(blobs);
        }
        debug_assert!(self.coming < n_levels || self.here == Some(0));
        let rest = |r: Range<u64>| Some(r.start.max(self.head)..r.end).filter(|r| !r.is_empty());
        self.wanted = ranges(self.wanted.drain(..).filter_map(rest).collect());
        if self.wanted.is_empty() {
            self.here = Some(self.coming);
        }
        Ok(())
    }

    /// Where the blobs of a level are that were not wanted before.
    fn blobs_of(&self, level: usize) -> Vec<Range<u64>> {
        let State::Open(file) = &self.state else { return Vec::new() };
        let grid = &file.grids()[level];
        let entries = &file.entries()[grid.first as usize..][..grid.n_tiles() as usize];
        let new = entries.iter().filter(|e| !e.is_empty() && !self.blobs.contains(&e.offset));
        let mut blobs: Vec<Range<u64>> = new.map(|e| e.offset..e.offset + u64::from(e.len)).collect();
        blobs.sort_unstable_by_key(|b| b.start);
        blobs.dedup();
        blobs
    }

    /// The scene from its finest level that is there on, every byte of it checked; level 0 of it is level
    /// [`ArrivingFile::level`] of the file. `None` where none is there.
    pub fn read_scene(&self) -> Result<Option<Scene>> {
        match (&self.state, self.here) {
            (State::Open(file), Some(level)) => file.read_scene_from(level).map(Some),
            _ => Ok(None),
        }
    }
}

/// Blobs as ranges to ask for: joined where they are near each other, cut where they are long.
fn ranges(mut blobs: Vec<Range<u64>>) -> Vec<Range<u64>> {
    blobs.sort_unstable_by_key(|b| b.start);
    let mut joined: Vec<Range<u64>> = Vec::new();
    for blob in blobs {
        match joined.last_mut() {
            Some(last) if blob.start <= last.end + GAP => last.end = last.end.max(blob.end),
            _ => joined.push(blob),
        }
    }
    let cut = |r: Range<u64>| {
        let end = r.end;
        r.step_by(RANGE as usize).map(move |at| at..end.min(at + RANGE))
    };
    joined.into_iter().flat_map(cut).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::write;
    use crate::source::procedural::{Kind, procedural};
    use crate::store::ranges::HEAD;
    use crate::{BuildOptions, build};

    fn scene() -> (Scene, Vec<u8>) {
        let scene = build(procedural(Kind::Rocks, 600, 3).unwrap(), &BuildOptions::default()).unwrap();
        let mut out = std::io::Cursor::new(Vec::new());
        write::write_scene_to(&scene, &mut out, Path::new("s.pcast")).unwrap();
        (scene, out.into_inner())
    }

    fn head(bytes: &[u8], n: u64) -> ArrivingFile {
        let n = bytes.len().min(n as usize);
        ArrivingFile::new("s.pcast", bytes[..n].to_vec(), Some(bytes.len() as u64)).unwrap()
    }

    /// Levels in the order in which they came, with the bytes that were there by then.
    fn fetch(file: &mut ArrivingFile, bytes: &[u8], mut each: impl FnMut(&ArrivingFile)) -> Vec<(usize, u64)> {
        let mut steps = Vec::new();
        while !file.wanted().is_empty() {
            // In any order.
            for r in file.wanted().to_vec().into_iter().rev() {
                file.put(r.start, &bytes[r.start as usize..r.end as usize]).unwrap();
            }
            if let Some(level) = file.level() {
                steps.push((level, file.progress()[0]));
                each(file);
            }
        }
        steps
    }

    #[test]
    fn arriving_levels_come_coarse_to_fine_and_are_the_scenes() {
        let (scene, bytes) = scene();
        for first in [64, 100, HEAD] {
            let mut file = head(&bytes, first);
            let steps = fetch(&mut file, &bytes, |file| {
                let part = file.read_scene().unwrap().unwrap();
                assert!(part.levels == scene.levels[file.level().unwrap()..]);
            });
            assert!(steps.len() > 1 && steps.last().unwrap().0 == 0, "{steps:?}");
            assert!(steps.windows(2).all(|s| s[0].0 > s[1].0), "{steps:?}");
            assert!(steps[0].1 < bytes.len() as u64 / 2, "the first picture takes few bytes: {steps:?}");
            assert!(steps.last().unwrap().1 <= bytes.len() as u64, "nothing comes twice: {steps:?}");
        }
    }

    #[test]
    fn arriving_file_that_is_there_at_once_wants_nothing() {
        let (scene, bytes) = scene();
        let file = head(&bytes, u64::MAX);
        assert!(file.wanted().is_empty() && file.level() == Some(0));
        assert!(file.read_scene().unwrap().unwrap() == scene);
    }

    #[test]
    fn arriving_parts_that_are_wrong_are_told_of() {
        let (_, bytes) = scene();
        let new = |head: &[u8], len: Option<u64>| ArrivingFile::new("s.pcast", head.to_vec(), len).err().unwrap();
        assert!(new(b"garbage", None).to_string().starts_with("s.pcast: 7 bytes"));
        let other = new(&[0; 1000], Some(5000));
        assert!(other.to_string().contains("not a .pcast scene"), "{other}");
        let cut = new(&bytes[..1000], Some(5000));
        assert!(cut.to_string().contains("the file has 5000 bytes, its header says"), "{cut}");
        let mut forged = bytes[..1000].to_vec();
        forged[12] ^= 1;
        assert!(new(&forged, None).to_string().contains("does not match its checksum"));

        let mut file = head(&bytes, 64);
        let r = file.wanted()[0].clone();
        let refused = file.put(r.start, &bytes[r.start as usize..r.end as usize - 1]).unwrap_err();
        assert!(refused.to_string().contains("which nobody asked for"), "{refused}");
        assert!(file.put(u64::MAX, &[1]).is_err());
        let mut planted = bytes[r.start as usize..r.end as usize].to_vec();
        planted[20] ^= 1;
        let broken = file.put(r.start, &planted).unwrap_err();
        assert!(broken.to_string().contains("directory does not match its checksum"), "{broken}");

        // A byte of a blob: its tile is told of when it is read.
        let mut file = head(&bytes, HEAD);
        let at = file.wanted()[0].start as usize + 100;
        let mut planted = bytes.clone();
        planted[at] ^= 1;
        fetch(&mut file, &planted, |_| {});
        let broken = file.read_scene().err().unwrap();
        assert!(broken.to_string().contains("does not match its checksum"), "{broken}");
    }
}
