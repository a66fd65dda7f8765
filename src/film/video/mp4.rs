//! Films in MP4: the index first, then one chunk for each segment. A film's parts are MP4 too, with a note of the film they
//! belong to, and are joined without being encoded again.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};

use mp4_atom::{
    Atom, Av01, Av1c, Avc1, Avcc, Co64, Codec as Entry, Colr, Decode, Dinf, Dref, DrefEntry, Encode, Equi, FixedPoint,
    FourCC, Ftyp, Hdlr, Mdhd, Mdia, Minf, Moov, Mvhd, Prhd, Proj, ProjKind, Spatial, St3d, Stbl, Stco, Stsc, StscEntry,
    Stsd, Stss, Stsz, StszSamples, Stts, SttsEntry, Sv3d, Svhd, Tkhd, Trak, Url, Visual, Vmhd,
};
use planecast_encoder::{Error, Result};
use serde::{Deserialize, Serialize};

use super::{Codec, Rate};

/// What all segments of a film have in common.
#[derive(Clone, Debug, PartialEq)]
pub struct Form {
    pub codec: Codec,
    /// The body of `avcC` or `av1C`.
    pub config: Vec<u8>,
    /// Of the frames as they are encoded.
    pub size: [u16; 2],
    pub rate: Rate,
    /// Frames are equirectangular pictures of the whole sphere.
    pub spherical: bool,
}

/// A segment's frames: where they lie, and the bytes of each.
#[derive(Clone, Debug, PartialEq)]
pub struct Chunk {
    pub sizes: Vec<u32>,
    pub data: Data,
}

#[derive(Clone, Debug, PartialEq)]
pub enum Data {
    Bytes(Vec<u8>),
    /// In a file, from this byte on.
    File(PathBuf, u64),
}

/// Which film a part belongs to.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Note {
    /// A number of all that makes the film.
    pub film: String,
    /// Its frames.
    pub frames: Range<usize>,
    /// Frames of the whole film.
    pub of: usize,
}

/// Of the box that holds a [`Note`].
const NOTE: &[u8; 16] = b"planecast segm 1";

fn fault(e: impl std::fmt::Display) -> io::Error {
    io::Error::other(e.to_string())
}

impl Form {
    fn entry(&self) -> io::Result<Entry> {
        let [width, height] = self.size;
        let visual = Visual {
            data_reference_index: 1,
            width,
            height,
            horizresolution: FixedPoint::new(72, 0),
            vertresolution: FixedPoint::new(72, 0),
            frame_count: 1,
            compressor: Default::default(),
            depth: 24,
        };
        // BT.709, limited range.
        let colr = Some(Colr::new(1, 1, 1, false).map_err(fault)?);
        let mut config = &self.config[..];
        Ok(match self.codec {
            Codec::H264 => {
                let avcc = Avcc::decode_body(&mut config).map_err(fault)?;
                let (btrt, pasp, taic, fiel) = Default::default();
                let spatial = self.spatial();
                Entry::Avc1(Avc1 { visual, avcc, btrt, colr, pasp, taic, fiel, spatial })
            }
            Codec::Av1 => {
                let av1c = Av1c::decode_body(&mut config).map_err(fault)?;
                let (btrt, ccst, pasp, taic) = Default::default();
                let spatial = self.spatial();
                Entry::Av01(Av01 { visual, av1c, btrt, ccst, colr, pasp, taic, spatial })
            }
        })
    }

    /// What tells players to show the picture as a sphere: Google's Spherical Video V2, one eye.
    fn spatial(&self) -> Option<Box<Spatial>> {
        if !self.spherical {
            return None;
        }
        let proj = Proj { prhd: Some(Prhd::default()), kind: Some(ProjKind::Equi(Equi::default())), ..Proj::default() };
        let svhd = Some(Svhd { metadata_source: "planecast".into() });
        Some(Box::new(Spatial {
            st3d: Some(St3d { stereo_mode: St3d::MONO }),
            sv3d: Some(Sv3d { svhd, proj: Some(proj), ..Sv3d::default() }),
            ..Spatial::default()
        }))
    }

    /// The index. `first` is where the first chunk begins in the file.
    fn index(&self, chunks: &[Chunk], first: u64) -> io::Result<Moov> {
        let Rate { ticks, frame } = self.rate;
        let frames: usize = chunks.iter().map(|c| c.sizes.len()).sum();
        let duration = frames as u64 * u64::from(frame);
        let (mut offsets, mut keys, mut runs) = (Vec::new(), Vec::new(), Vec::<StscEntry>::new());
        let (mut at, mut key) = (first, 1);
        for (i, chunk) in chunks.iter().enumerate() {
            offsets.push(at);
            keys.push(key);
            let n = chunk.sizes.len() as u32;
            if runs.last().is_none_or(|run| run.samples_per_chunk != n) {
                let first_chunk = i as u32 + 1;
                runs.push(StscEntry { first_chunk, samples_per_chunk: n, sample_description_index: 1 });
            }
            at += chunk.sizes.iter().map(|&s| u64::from(s)).sum::<u64>();
            key += n;
        }
        let far = at > u64::from(u32::MAX);
        let sizes = chunks.iter().flat_map(|c| c.sizes.iter().copied()).collect();
        let stbl = Stbl {
            stsd: Stsd { codecs: vec![self.entry()?] },
            stts: Stts { entries: vec![SttsEntry { sample_count: frames as u32, sample_delta: frame }] },
            stss: Some(Stss { entries: keys }),
            stsc: Stsc { entries: runs },
            stsz: Stsz { samples: StszSamples::Different { sizes } },
            stco: (!far).then(|| Stco { entries: offsets.iter().map(|&o| o as u32).collect() }),
            co64: far.then_some(Co64 { entries: offsets }),
            ..Stbl::default()
        };
        let [width, height] = self.size.map(|v| FixedPoint::new(v, 0));
        Ok(Moov {
            mvhd: Mvhd {
                timescale: ticks,
                duration,
                rate: FixedPoint::new(1, 0),
                volume: FixedPoint::new(1, 0),
                next_track_id: 2,
                creation_time: 0,
                modification_time: 0,
                matrix: Default::default(),
            },
            trak: vec![Trak {
                tkhd: Tkhd { track_id: 1, duration, enabled: true, in_movie: true, width, height, ..Tkhd::default() },
                mdia: Mdia {
                    mdhd: Mdhd { timescale: ticks, duration, language: "und".into(), ..Mdhd::default() },
                    hdlr: Hdlr { handler: FourCC::new(b"vide"), name: "planecast".into() },
                    minf: Minf {
                        vmhd: Some(Vmhd::default()),
                        dinf: Dinf { dref: Dref { entries: vec![DrefEntry::Url(Url::default())] } },
                        stbl,
                        ..Minf::default()
                    },
                },
                ..Trak::default()
            }],
            ..Moov::default()
        })
    }
}

/// Writes a film. The same frames make the same bytes.
pub fn mux(out: &mut impl Write, form: &Form, chunks: &[Chunk], note: Option<&Note>) -> io::Result<()> {
    let mut head = Vec::new();
    let compatible_brands: &[&[u8; 4]] = match form.codec {
        Codec::H264 => &[b"isom", b"iso2", b"avc1", b"mp41"],
        Codec::Av1 => &[b"isom", b"iso2", b"av01", b"mp41"],
    };
    let ftyp = Ftyp {
        major_brand: FourCC::new(b"isom"),
        minor_version: 512,
        compatible_brands: compatible_brands.iter().map(|b| FourCC::new(b)).collect(),
    };
    ftyp.encode(&mut head).map_err(fault)?;
    if let Some(note) = note {
        let text = serde_json::to_vec(note)?;
        head.extend_from_slice(&(24 + text.len() as u32).to_be_bytes());
        head.extend_from_slice(b"uuid");
        head.extend_from_slice(NOTE);
        head.extend_from_slice(&text);
    }
    let data: u64 = chunks.iter().flat_map(|c| &c.sizes).map(|&s| u64::from(s)).sum();
    let mdat = if data + 8 > u64::from(u32::MAX) { 16 } else { 8 };
    // How long the index is depends on where the data end, and on nothing else of where they begin.
    let mut index = Vec::new();
    for _ in 0..2 {
        let first = (head.len() + index.len() + mdat) as u64;
        index.clear();
        form.index(chunks, first)?.encode(&mut index).map_err(fault)?;
    }
    let first = (head.len() + index.len() + mdat) as u64;
    index.clear();
    form.index(chunks, first)?.encode(&mut index).map_err(fault)?;
    out.write_all(&head)?;
    out.write_all(&index)?;
    if mdat == 8 {
        out.write_all(&(data as u32 + 8).to_be_bytes())?;
        out.write_all(b"mdat")?;
    } else {
        out.write_all(&1u32.to_be_bytes())?;
        out.write_all(b"mdat")?;
        out.write_all(&(data + 16).to_be_bytes())?;
    }
    let mut open: Option<(&Path, File)> = None;
    for chunk in chunks {
        let length: u64 = chunk.sizes.iter().map(|&s| u64::from(s)).sum();
        match &chunk.data {
            Data::Bytes(bytes) => out.write_all(bytes)?,
            Data::File(path, at) => {
                if open.as_ref().is_none_or(|(p, _)| p != path) {
                    open = Some((path, File::open(path)?));
                }
                let file = &mut open.as_mut().expect("just opened").1;
                file.seek(SeekFrom::Start(*at))?;
                if io::copy(&mut file.take(length), out)? != length {
                    return Err(io::Error::new(
                        io::ErrorKind::UnexpectedEof,
                        format!("{} was cut short", path.display()),
                    ));
                }
            }
        }
    }
    Ok(())
}

/// A part of a film, as `fly --frames A..B` writes it.
#[derive(Debug)]
pub struct Part {
    pub path: PathBuf,
    pub form: Form,
    pub chunks: Vec<Chunk>,
    pub note: Note,
}

/// Longest index and note that are read: an hour's has a hundredth of it.
const HEAD_LIMIT: u64 = 1 << 28;

/// Reads a part's head; its frames stay in the file.
pub fn open_part(path: &Path) -> Result<Part> {
    let wrong = |what: &str| {
        Error::format(path, format!("is not a part of a film as fly --frames A..B -o PART.mp4 writes it ({what})"))
    };
    let mut file = File::open(path).map_err(|e| Error::io(path, "read", e))?;
    let length = file.metadata().map_err(|e| Error::io(path, "read", e))?.len();
    let (mut note, mut index, mut at) = (None, None, 0u64);
    while at + 8 <= length {
        let mut head = [0; 16];
        file.seek(SeekFrom::Start(at)).map_err(|e| Error::io(path, "read", e))?;
        let have = head.len().min((length - at) as usize);
        file.read_exact(&mut head[..have]).map_err(|e| Error::io(path, "read", e))?;
        let kind = &head[4..8];
        let (size, skip) = match u32::from_be_bytes(head[..4].try_into().expect("four bytes")) {
            1 if have == 16 => (u64::from_be_bytes(head[8..].try_into().expect("eight bytes")), 16),
            size => (size.into(), 8),
        };
        if size < skip || size > length - at {
            return Err(wrong(&format!("byte {at}: a box of {size} bytes, {} are left", length - at)));
        }
        if kind == b"uuid" || kind == b"moov" {
            if size > HEAD_LIMIT {
                return Err(wrong(&format!("byte {at}: an index of {size} bytes")));
            }
            let mut body = vec![0; size as usize];
            file.seek(SeekFrom::Start(at)).map_err(|e| Error::io(path, "read", e))?;
            file.read_exact(&mut body).map_err(|e| Error::io(path, "read", e))?;
            if kind == b"moov" {
                index = Some(Moov::decode(&mut &body[..]).map_err(|e| wrong(&format!("its index: {e}")))?);
            } else if body.get(8..24) == Some(NOTE) {
                note = Some(serde_json::from_slice::<Note>(&body[24..]).map_err(|e| wrong(&format!("its note: {e}")))?);
            }
        }
        at += size;
    }
    let note = note.ok_or_else(|| wrong("it has no note of its film"))?;
    let index = index.ok_or_else(|| wrong("it has no index"))?;
    let (form, chunks) = read_index(path, &index, length).map_err(|what| wrong(&what))?;
    let frames: usize = chunks.iter().map(|c| c.sizes.len()).sum();
    if frames != note.frames.len() || note.frames.end > note.of || frames == 0 {
        let Range { start, end } = note.frames;
        return Err(wrong(&format!("{frames} frames for {start}..{end} of {}", note.of)));
    }
    Ok(Part { path: path.to_path_buf(), form, chunks, note })
}

/// A part's form and chunks from its index, which must be one that [`mux`] writes.
fn read_index(path: &Path, index: &Moov, length: u64) -> std::result::Result<(Form, Vec<Chunk>), String> {
    let [trak] = &index.trak[..] else { return Err(format!("{} tracks", index.trak.len())) };
    let stbl = &trak.mdia.minf.stbl;
    let mut config = Vec::new();
    let (codec, visual, spatial) = match &stbl.stsd.codecs[..] {
        [Entry::Avc1(e)] => {
            e.avcc.encode_body(&mut config).map_err(|e| e.to_string())?;
            (Codec::H264, &e.visual, &e.spatial)
        }
        [Entry::Av01(e)] => {
            e.av1c.encode_body(&mut config).map_err(|e| e.to_string())?;
            (Codec::Av1, &e.visual, &e.spatial)
        }
        _ => return Err("neither H.264 nor AV1".into()),
    };
    let [SttsEntry { sample_delta: frame, .. }] = stbl.stts.entries[..] else {
        return Err("frames of different lengths".into());
    };
    let StszSamples::Different { sizes } = &stbl.stsz.samples else { return Err("frames without sizes".into()) };
    let offsets: Vec<u64> = match (&stbl.stco, &stbl.co64) {
        (Some(stco), None) => stco.entries.iter().map(|&o| o.into()).collect(),
        (None, Some(co64)) => co64.entries.clone(),
        _ => return Err("no places of frames".into()),
    };
    let (mut chunks, mut left) = (Vec::new(), &sizes[..]);
    for (i, &offset) in offsets.iter().enumerate() {
        let run = stbl.stsc.entries.iter().rev().find(|run| run.first_chunk as usize <= i + 1);
        let n = run.map_or(0, |run| run.samples_per_chunk) as usize;
        let (sizes, rest) = left.split_at_checked(n).ok_or("more chunks than frames")?;
        let bytes: u64 = sizes.iter().map(|&s| u64::from(s)).sum();
        if offset.checked_add(bytes).is_none_or(|end| end > length) {
            return Err(format!("frames at byte {offset} end behind the file"));
        }
        chunks.push(Chunk { sizes: sizes.to_vec(), data: Data::File(path.to_path_buf(), offset) });
        left = rest;
    }
    if !left.is_empty() {
        return Err("more frames than chunks".into());
    }
    let rate = Rate { ticks: trak.mdia.mdhd.timescale, frame };
    let spherical = spatial.as_ref().is_some_and(|s| s.sv3d.is_some());
    Ok((Form { codec, config, size: [visual.width, visual.height], rate, spherical }, chunks))
}

/// The parts of one whole film, in order; the error says what is missing or does not belong.
pub fn whole(mut parts: Vec<Part>) -> Result<(Form, Vec<Chunk>)> {
    parts.sort_by_key(|p| p.note.frames.start);
    let first = &parts[0];
    let of = first.note.of;
    let mut next = 0;
    let missing = |from: usize, to: usize| {
        Error::Argument(format!(
            "frames {from}..{to} of the film's {of} are in none of the parts; make them by fly --frames {from}..{to}"
        ))
    };
    for (i, part) in parts.iter().enumerate() {
        let Note { film, frames, of } = &part.note;
        if (film, of) != (&first.note.film, &first.note.of) {
            let other = first.path.display();
            return Err(Error::format(
                &part.path,
                format!("is of another film than {other}: scene, path or options differ"),
            ));
        }
        if part.form != first.form {
            let other = first.path.display();
            return Err(Error::format(&part.path, format!("was encoded otherwise than {other}: by another version?")));
        }
        if frames.start > next {
            return Err(missing(next, frames.start));
        }
        if frames.start < next {
            let (start, end, other) = (frames.start, frames.end, parts[i - 1].path.display());
            return Err(Error::format(&part.path, format!("has frames {start}..{end}, some of which {other} has too")));
        }
        next = frames.end;
    }
    if next < of {
        return Err(missing(next, of));
    }
    let form = first.form.clone();
    Ok((form, parts.into_iter().flat_map(|p| p.chunks).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn form() -> Form {
        let avcc = Avcc::new(&[0x67, 66, 0xc0, 31, 0xda], &[0x68, 0xce, 0x38, 0x80]).unwrap();
        let mut config = Vec::new();
        avcc.encode_body(&mut config).unwrap();
        Form { codec: Codec::H264, config, size: [34, 20], rate: Rate::new(30.0), spherical: false }
    }

    fn chunk(sizes: &[u32], with: u8) -> Chunk {
        let data = Data::Bytes(vec![with; sizes.iter().sum::<u32>() as usize]);
        Chunk { sizes: sizes.to_vec(), data }
    }

    fn file(chunks: &[Chunk], note: Option<&Note>) -> Vec<u8> {
        let mut file = Vec::new();
        mux(&mut file, &form(), chunks, note).unwrap();
        file
    }

    fn index(file: &[u8]) -> Moov {
        let at = file.windows(4).position(|w| w == b"moov").unwrap() - 4;
        Moov::decode(&mut &file[at..]).unwrap()
    }

    #[test]
    fn films_of_the_sphere_say_so_and_others_do_not() {
        let mut film = Vec::new();
        mux(&mut film, &Form { spherical: true, ..form() }, &[chunk(&[9], 1)], None).unwrap();
        let has = |bytes: &[u8], name: &[u8]| bytes.windows(4).any(|w| w == name);
        for name in [b"st3d", b"sv3d", b"svhd", b"proj", b"prhd", b"equi"] {
            assert!(has(&film, name) && !has(&file(&[chunk(&[9], 1)], None), name));
        }
        let [Entry::Avc1(entry)] = &index(&film).trak[0].mdia.minf.stbl.stsd.codecs[..] else { panic!("one of H.264") };
        assert_eq!(entry.spatial, Form { spherical: true, ..form() }.spatial());
    }

    /// mpv-player/mpv#8858: players stop at once where a film says it lasts a tick.
    #[test]
    fn film_lasts_a_frames_time_for_each_frame() {
        for frames in [1, 2, 7] {
            let moov = index(&file(&[chunk(&vec![9; frames], 1)], None));
            let second = |ticks: u64, timescale: u32| ticks as f64 / f64::from(timescale);
            let right = frames as f64 / 30.0;
            let mdhd = &moov.trak[0].mdia.mdhd;
            assert_eq!(second(mdhd.duration, mdhd.timescale), right);
            assert_eq!(second(moov.mvhd.duration, moov.mvhd.timescale), right);
            assert_eq!(second(moov.trak[0].tkhd.duration, moov.mvhd.timescale), right);
            let [entry] = &moov.trak[0].mdia.minf.stbl.stts.entries[..] else { panic!("one length for all frames") };
            assert_eq!(second(u64::from(entry.sample_count * entry.sample_delta), mdhd.timescale), right);
        }
    }

    #[test]
    fn film_has_its_index_first_and_its_chunks_where_it_says() {
        let chunks = [chunk(&[5, 6], 1), chunk(&[7, 8], 2), chunk(&[9], 3)];
        let file = file(&chunks, None);
        assert_eq!(&file[4..8], b"ftyp");
        let find = |name: &[u8]| file.windows(4).position(|w| w == name).unwrap();
        assert!(find(b"moov") < find(b"mdat"), "the index comes first");
        let stbl = &index(&file).trak[0].mdia.minf.stbl;
        assert_eq!(stbl.stss.as_ref().unwrap().entries, [1, 3, 5]);
        let offsets = &stbl.stco.as_ref().unwrap().entries;
        let at = |i: usize| &file[offsets[i] as usize..];
        assert_eq!((offsets[0] as usize, &at(1)[..15], at(2)), (find(b"mdat") + 4, &[2; 15][..], &[3; 9][..]));
        let Entry::Avc1(entry) = &stbl.stsd.codecs[0] else { panic!("H.264") };
        assert_eq!(entry.colr, Some(Colr::new(1, 1, 1, false).unwrap()), "BT.709, limited range");
    }

    #[test]
    fn film_of_parts_is_the_film_made_at_once_and_what_is_missing_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let chunks = [chunk(&[5, 6], 1), chunk(&[7, 8], 2), chunk(&[9], 3)];
        let part = |name: &str, film: &str, frames: Range<usize>, chunks: &[Chunk]| {
            let path = dir.path().join(name);
            let note = Note { film: film.into(), frames, of: 5 };
            std::fs::write(&path, file(chunks, Some(&note))).unwrap();
            path
        };
        let a = part("a.mp4", "f", 0..2, &chunks[..1]);
        let b = part("b.mp4", "f", 2..5, &chunks[1..]);
        let other = part("other.mp4", "g", 2..5, &chunks[1..]);
        let join = |paths: &[&PathBuf]| {
            let (form, chunks) = whole(paths.iter().map(|p| open_part(p)).collect::<Result<_>>()?)?;
            let mut file = Vec::new();
            mux(&mut file, &form, &chunks, None).unwrap();
            Ok::<_, Error>(file)
        };
        assert_eq!(join(&[&b, &a]).unwrap(), file(&chunks, None));
        let error = |paths: &[&PathBuf]| join(paths).unwrap_err().to_string();
        assert!(error(&[&b]).starts_with("frames 0..2 of the film's 5 are in none of the parts"), "{}", error(&[&b]));
        assert!(error(&[&a]).starts_with("frames 2..5 of the film's 5"), "{}", error(&[&a]));
        assert!(error(&[&a, &b, &b]).contains("has frames 2..5, some of which"), "{}", error(&[&a, &b, &b]));
        assert!(error(&[&a, &other]).contains("is of another film than"), "{}", error(&[&a, &other]));

        let plain = dir.path().join("plain.mp4");
        std::fs::write(&plain, file(&chunks, None)).unwrap();
        assert!(error(&[&plain]).contains("it has no note of its film"), "{}", error(&[&plain]));
        let whole = std::fs::read(&a).unwrap();
        for n in 0..whole.len() {
            std::fs::write(&plain, &whole[..n]).unwrap();
            assert!(join(&[&plain, &b]).is_err(), "cut to {n} bytes");
        }
    }
}
