//! TIFF and BigTIFF as directories of tags and chunks (strips or tiles) of samples, in either byte order.
//!
//! The `tiff` crate unpacks JPEG and fax here and nothing else: in 0.11.3 it reads chunks of no bytes, which valid files have
//! (GDAL's sparse files), as the file's first bytes, complements values where 0 is white, and takes no samples of 9 to 15
//! bits. LZW, deflate and Zstandard are of the crates that it uses, too.
//!
//! After TIFF 6.0 (Adobe, 1992), Technical Note 3 (predictor 3) and the BigTIFF text of libtiff.

use std::io::{Read, SeekFrom};
use std::path::Path;

use super::pixels::Stream;
use crate::{Error, Result};

pub(super) mod tags {
    pub const NEW_SUBFILE_TYPE: u16 = 254;
    pub const WIDTH: u16 = 256;
    pub const HEIGHT: u16 = 257;
    pub const BITS: u16 = 258;
    pub const COMPRESSION: u16 = 259;
    pub const PHOTOMETRIC: u16 = 262;
    pub const FILL_ORDER: u16 = 266;
    pub const STRIP_OFFSETS: u16 = 273;
    pub const ORIENTATION: u16 = 274;
    pub const SAMPLES: u16 = 277;
    pub const ROWS_PER_STRIP: u16 = 278;
    pub const STRIP_COUNTS: u16 = 279;
    pub const PLANAR: u16 = 284;
    pub const COLOR_MAP: u16 = 320;
    pub const PREDICTOR: u16 = 317;
    pub const TILE_WIDTH: u16 = 322;
    pub const TILE_HEIGHT: u16 = 323;
    pub const TILE_OFFSETS: u16 = 324;
    pub const TILE_COUNTS: u16 = 325;
    pub const EXTRA_SAMPLES: u16 = 338;
    pub const SAMPLE_FORMAT: u16 = 339;
    pub const PIXEL_SCALE: u16 = 33550;
    pub const TIE_POINTS: u16 = 33922;
    pub const TRANSFORMATION: u16 = 34264;
    pub const GEO_KEYS: u16 = 34735;
    pub const GEO_DOUBLES: u16 = 34736;
    pub const GEO_TEXT: u16 = 34737;
    pub const GDAL_METADATA: u16 = 42112;
    pub const GDAL_NODATA: u16 = 42113;
    pub const LERC_PARAMETERS: u16 = 50674;
}

/// Pixels that a chunk without bytes may stand for: its entry in the directory has eight bytes at least.
const SPARSE_CHUNK: u64 = 1 << 22;

/// Values of one LERC blob: its head can claim any number of equal ones.
const LERC_LIMIT: u64 = 1 << 27;

/// A file and its byte order.
pub(super) struct Tiff<'a> {
    path: &'a Path,
    input: Box<dyn Stream + 'a>,
    len: u64,
    big_endian: bool,
    /// BigTIFF: offsets of 64 bits.
    wide: bool,
    first: u64,
}

/// A directory: the tags of one image.
#[derive(Clone, Debug)]
pub(super) struct Page {
    /// Where in the chain it stands, from 0.
    pub index: usize,
    entries: Vec<Entry>,
}

#[derive(Clone, Debug)]
struct Entry {
    tag: u16,
    kind: u16,
    count: u64,
    /// Where the values lie.
    at: u64,
}

impl Page {
    pub fn has(&self, tag: u16) -> bool {
        self.entries.iter().any(|e| e.tag == tag)
    }
}

/// What a sample is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Sample {
    Unsigned,
    Signed,
    Float,
}

/// How the image of a page is laid out.
#[derive(Clone, Debug)]
pub(super) struct Image {
    page: usize,
    pub width: u32,
    pub height: u32,
    /// Samples per pixel, and bits of each.
    pub samples: u32,
    pub bits: u32,
    pub sample: Sample,
    /// 0: white is 0; 1: black is 0; 2: RGB; 3: palette; 4: mask; 5: CMYK; 6: YCbCr; 8: CIELab.
    pub photometric: u64,
    pub compression: u64,
    predictor: u64,
    /// Samples of a kind lie together, each in chunks of their own.
    planar: bool,
    reversed_bits: bool,
    /// What packs a LERC blob once more: 0 nothing, 1 deflate, 2 Zstandard.
    lerc: u64,
    /// What each extra sample is: 1 and 2 are alpha.
    pub extra: Vec<u64>,
    /// Size of a chunk, and how many there are across and down.
    pub chunk: [u32; 2],
    pub across: u32,
    pub down: u32,
    tiled: bool,
    offsets: Vec<u64>,
    counts: Vec<u64>,
}

impl<'a> Tiff<'a> {
    pub fn open(path: &'a Path, mut input: Box<dyn Stream + 'a>, len: usize) -> Result<Tiff<'a>> {
        let mut head = [0; 16];
        let n = len.min(16);
        input.read_exact(&mut head[..n]).map_err(|e| Error::io(path, "read", e))?;
        let (big_endian, version) = match (&head[..2], [head[2], head[3]]) {
            (b"II", v) => (false, u16::from_le_bytes(v)),
            (b"MM", v) => (true, u16::from_be_bytes(v)),
            _ => return Err(Error::format(path, "byte 0: TIFF starts with \"II\" or \"MM\"")),
        };
        let mut tiff = Tiff { path, input, len: len as u64, big_endian, wide: version == 43, first: 0 };
        tiff.first = match version {
            42 if n >= 8 => tiff.number(&head[4..8]),
            43 if n == 16 && tiff.number(&head[4..6]) == 8 => tiff.number(&head[8..16]),
            42 | 43 => return Err(tiff.fault("byte 4: the header is cut short or not of BigTIFF's form")),
            _ => return Err(tiff.fault(format!("byte 2: version {version}; TIFF is 42, BigTIFF 43"))),
        };
        Ok(tiff)
    }

    pub fn fault(&self, what: impl std::fmt::Display) -> Error {
        Error::format(self.path, format!("TIFF: {what}"))
    }

    /// A whole number of 1 to 8 bytes in the file's order.
    fn number(&self, bytes: &[u8]) -> u64 {
        let step = |n: u64, &b: &u8| n << 8 | u64::from(b);
        if self.big_endian { bytes.iter().fold(0, step) } else { bytes.iter().rev().fold(0, step) }
    }

    /// Bytes that the file must have.
    fn bytes(&mut self, at: u64, n: u64, what: &str) -> Result<Vec<u8>> {
        if at.checked_add(n).is_none_or(|end| end > self.len) {
            let len = self.len;
            return Err(self.fault(format!("{what}: {n} bytes at byte {at}, the file has {len}")));
        }
        let read = |input: &mut Box<dyn Stream + 'a>| {
            let mut out = vec![0; n as usize];
            input.seek(SeekFrom::Start(at))?;
            input.read_exact(&mut out)?;
            Ok(out)
        };
        read(&mut self.input).map_err(|e| Error::io(self.path, "read", e))
    }

    /// All pages of the chain.
    pub fn pages(&mut self) -> Result<Vec<Page>> {
        let (mut out, mut seen) = (Vec::new(), std::collections::HashSet::new());
        let mut at = self.first;
        while at != 0 {
            if !seen.insert(at) {
                return Err(self.fault(format!("byte {at}: the chain of pages comes back to this one")));
            }
            let (count_size, entry_size, value_at, value_size) = if self.wide { (8, 20, 12, 8) } else { (2, 12, 8, 4) };
            let head = self.bytes(at, count_size, "the tags of a page")?;
            let n = self.number(&head);
            if n.checked_mul(entry_size).is_none_or(|size| size > self.len) {
                return Err(self.fault(format!("byte {at}: a page of {n} tags, more than the file has bytes for")));
            }
            let table = self.bytes(at + count_size, n * entry_size + value_size, "the tags of a page")?;
            let mut entries = Vec::with_capacity(n as usize);
            for (i, entry) in table.chunks_exact(entry_size as usize).take(n as usize).enumerate() {
                let (kind, count) = (self.number(&entry[2..4]) as u16, self.number(&entry[4..value_at]));
                let size = kind_size(kind).saturating_mul(count);
                let inline = at + count_size + i as u64 * entry_size + value_at as u64;
                let at = if size <= value_size { inline } else { self.number(&entry[value_at..]) };
                entries.push(Entry { tag: self.number(&entry[..2]) as u16, kind, count, at });
            }
            at = self.number(&table[(n * entry_size) as usize..]);
            out.push(Page { index: out.len(), entries });
        }
        if out.is_empty() {
            return Err(self.fault("no page; a picture has one at least"));
        }
        Ok(out)
    }

    fn raw(&mut self, page: &Page, tag: u16) -> Result<Option<(u16, Vec<u8>)>> {
        let Some(entry) = page.entries.iter().find(|e| e.tag == tag) else { return Ok(None) };
        let size = kind_size(entry.kind).checked_mul(entry.count).filter(|_| kind_size(entry.kind) > 0);
        let Some(size) = size else {
            return Err(self.fault(format!("tag {tag}: {} values of type {}", entry.count, entry.kind)));
        };
        Ok(Some((entry.kind, self.bytes(entry.at, size, &format!("tag {tag}"))?)))
    }

    /// Values of a tag as numbers; None where the page has no such tag.
    pub fn numbers(&mut self, page: &Page, tag: u16) -> Result<Option<Vec<f64>>> {
        let Some((kind, bytes)) = self.raw(page, tag)? else { return Ok(None) };
        let value = |b: &[u8]| {
            let n = self.number(b);
            match kind {
                5 => self.number(&b[..4]) as f64 / self.number(&b[4..]) as f64,
                6 => f64::from(n as i8),
                8 => f64::from(n as i16),
                9 => f64::from(n as i32),
                10 => f64::from(self.number(&b[..4]) as i32) / f64::from(self.number(&b[4..]) as i32),
                11 => f64::from(f32::from_bits(n as u32)),
                12 => f64::from_bits(n),
                17 => n as i64 as f64,
                _ => n as f64,
            }
        };
        Ok(Some(bytes.chunks_exact(kind_size(kind) as usize).map(value).collect()))
    }

    /// Values of a tag as whole numbers.
    pub fn integers(&mut self, page: &Page, tag: u16) -> Result<Option<Vec<u64>>> {
        let Some((kind, bytes)) = self.raw(page, tag)? else { return Ok(None) };
        if !matches!(kind, 1 | 3 | 4 | 13 | 16 | 18) {
            return Err(self.fault(format!("tag {tag}: values of type {kind}; whole numbers were expected")));
        }
        Ok(Some(bytes.chunks_exact(kind_size(kind) as usize).map(|b| self.number(b)).collect()))
    }

    /// The first value of a tag.
    pub fn integer(&mut self, page: &Page, tag: u16) -> Result<Option<u64>> {
        Ok(self.integers(page, tag)?.and_then(|v| v.first().copied()))
    }

    /// Bytes of a tag's values, in the file's order.
    pub fn bytes_of(&mut self, page: &Page, tag: u16) -> Result<Option<Vec<u8>>> {
        Ok(self.raw(page, tag)?.map(|(_, bytes)| bytes))
    }

    /// Text of a tag, up to its first byte 0.
    pub fn text(&mut self, page: &Page, tag: u16) -> Result<Option<String>> {
        let raw = self.raw(page, tag)?;
        Ok(raw.map(|(_, b)| String::from_utf8_lossy(b.split(|&b| b == 0).next().unwrap_or_default()).into_owned()))
    }

    /// How a page's image is laid out, its claims held against the file.
    pub fn image(&mut self, page: &Page) -> Result<Image> {
        let side = |tiff: &mut Self, tag: u16, what: &str| {
            let n = tiff.integer(page, tag)?.and_then(|n| u32::try_from(n).ok()).filter(|&n| n > 0);
            n.ok_or_else(|| tiff.fault(format!("tag {tag}: {what} is missing, 0, or more than 32 bits")))
        };
        let (width, height) = (side(self, tags::WIDTH, "the width")?, side(self, tags::HEIGHT, "the height")?);
        let samples = self.integer(page, tags::SAMPLES)?.unwrap_or(1);
        let same = |tiff: &mut Self, tag: u16, default: u64| {
            let values = tiff.integers(page, tag)?.filter(|v| !v.is_empty()).unwrap_or_else(|| vec![default]);
            match values.iter().all(|v| *v == values[0]) {
                true => Ok(values[0]),
                false => Err(tiff.fault(format!("tag {tag}: samples of unlike kinds ({values:?}) are not read"))),
            }
        };
        let (bits, format) = (same(self, tags::BITS, 1)?, same(self, tags::SAMPLE_FORMAT, 1)?);
        let sample = match format {
            // 4: "undefined", which libtiff reads as whole numbers.
            1 | 4 => Sample::Unsigned,
            2 => Sample::Signed,
            3 => Sample::Float,
            5 | 6 => return Err(self.fault("tag 339: complex values; write their magnitude as one band of f32")),
            n => return Err(self.fault(format!("tag 339: sample format {n}; 1 to 3 are read"))),
        };
        let sound = match sample {
            Sample::Float => matches!(bits, 16 | 32 | 64),
            _ => (1..=32).contains(&bits) || bits == 64,
        };
        if !sound || !(1..=65_535).contains(&samples) {
            let what = format!("{samples} samples per pixel, each of {bits} bits ({sample:?})");
            return Err(
                self.fault(format!("{what}; whole numbers of 1 to 32 or 64 bits and floats of 16, 32, 64 are read"))
            );
        }
        let planar = self.integer(page, tags::PLANAR)?.unwrap_or(1) == 2 && samples > 1;
        let tiled = page.has(tags::TILE_OFFSETS);
        let (chunk, offsets, counts) = match tiled {
            true => {
                let chunk =
                    [side(self, tags::TILE_WIDTH, "a tile's width")?, side(self, tags::TILE_HEIGHT, "its height")?];
                (chunk, tags::TILE_OFFSETS, tags::TILE_COUNTS)
            }
            false => {
                let rows = self.integer(page, tags::ROWS_PER_STRIP)?.unwrap_or(u64::MAX).clamp(1, height.into());
                ([width, rows as u32], tags::STRIP_OFFSETS, tags::STRIP_COUNTS)
            }
        };
        let mut image = Image {
            page: page.index,
            width,
            height,
            samples: samples as u32,
            bits: bits as u32,
            sample,
            photometric: self.integer(page, tags::PHOTOMETRIC)?.unwrap_or(1),
            compression: self.integer(page, tags::COMPRESSION)?.unwrap_or(1),
            predictor: self.integer(page, tags::PREDICTOR)?.unwrap_or(1),
            planar,
            reversed_bits: self.integer(page, tags::FILL_ORDER)?.unwrap_or(1) == 2,
            lerc: self.integers(page, tags::LERC_PARAMETERS)?.and_then(|v| v.get(1).copied()).unwrap_or(0),
            extra: self.integers(page, tags::EXTRA_SAMPLES)?.unwrap_or_default(),
            chunk,
            across: width.div_ceil(chunk[0]),
            down: height.div_ceil(chunk[1]),
            tiled,
            offsets: self.integers(page, offsets)?.unwrap_or_default(),
            counts: self.integers(page, counts)?.unwrap_or_default(),
        };
        let chunks = u64::from(image.across) * u64::from(image.down) * if planar { samples } else { 1 };
        if image.counts.is_empty() && image.compression == 1 && image.offsets.len() as u64 == chunks {
            // Needed by the standard, left away by some; without compression the size goes without saying.
            image.counts = (0..chunks).map(|i| image.chunk_size(i as u32)).collect();
        }
        let (n, m) = (image.offsets.len() as u64, image.counts.len() as u64);
        if n < chunks || m < chunks {
            return Err(
                self.fault(format!("{n} offsets and {m} byte counts of {chunks} strips or tiles (tag {offsets})"))
            );
        }
        if let Compression::Unknown(name) = Compression::of(image.compression) {
            let what = format!("tag 259: compression {} ({name}) is not read", image.compression);
            return Err(self.fault(format!("{what}; rewrite the file with deflate, LZW or Zstandard")));
        }
        let sparse = image.counts.iter().filter(|&&n| n == 0).count() as u64;
        let size = u64::from(width) as f64 * f64::from(height) * (samples * bits) as f64 / 8.0;
        let room = self.len as f64 * Compression::of(image.compression).inflation()
            + (sparse * SPARSE_CHUNK) as f64 * (samples * bits) as f64 / 8.0;
        if size > room {
            let len = self.len;
            return Err(
                self.fault(format!("{len} bytes cannot hold the {width} × {height} pixels that the header claims"))
            );
        }
        Ok(image)
    }

    /// Bytes of a chunk, unpacked: [`Image::row_bytes`] a row, samples in this machine's order. None where the file has no bytes
    /// for it, which stands for "nothing was written here".
    pub fn chunk(&mut self, image: &Image, index: u32) -> Result<Option<Vec<u8>>> {
        let (at, count) = (image.offsets[index as usize], image.counts[index as usize]);
        if count == 0 {
            return Ok(None);
        }
        let need = image.chunk_size(index);
        let name = format!("{} {index}", if image.tiled { "tile" } else { "strip" });
        let compression = Compression::of(image.compression);
        let mut packed = self.bytes(at, count, &name)?;
        if image.reversed_bits && compression != Compression::Fax {
            packed.iter_mut().for_each(|b| *b = b.reverse_bits());
        }
        let mut out = Vec::new();
        let mut unpack = |from: &mut dyn Read| from.take(need).read_to_end(&mut out).map(|_| ());
        let done = match compression {
            Compression::None => {
                packed.truncate(need as usize);
                out = packed;
                Ok(())
            }
            Compression::Lzw if packed.starts_with(&[0, 1]) => {
                return Err(
                    self.fault(format!("{name}: LZW of before TIFF 6.0; rewrite the file with any other compression"))
                );
            }
            Compression::Lzw => {
                let mut decoder = weezl::decode::Decoder::with_tiff_size_switch(weezl::BitOrder::Msb, 8);
                lzw(&mut decoder, &packed, need, &mut out)
            }
            Compression::Deflate => unpack(&mut flate2::read::ZlibDecoder::new(&packed[..])),
            Compression::PackBits => {
                pack_bits(&packed, need, &mut out);
                Ok(())
            }
            Compression::Zstd => zstd(&packed).and_then(|mut from| unpack(&mut from)),
            Compression::Jpeg | Compression::Fax => {
                out = self.by_crate(image, index)?;
                Ok(())
            }
            Compression::Lerc => {
                let blob = match image.lerc {
                    0 => Ok(packed),
                    // What LERC leaves as it is is as long as the chunk, beside a head.
                    1 => unpacked(&mut flate2::read::ZlibDecoder::new(&packed[..]), need),
                    2 => zstd(&packed).and_then(|mut from| unpacked(&mut from, need)),
                    n => return Err(self.fault(format!("{name}: LERC packed by method {n}; 0 to 2 are read"))),
                };
                out = blob
                    .map_err(|e| e.to_string())
                    .and_then(|blob| lerc(image, &blob))
                    .map_err(|e| self.fault(format!("{name} at byte {at}: LERC: {e}")))?;
                Ok(())
            }
            Compression::Unknown(_) => unreachable!("refused with the image"),
        };
        // A stream cut short still gives what came before; too little of it is the fault that counts.
        if (out.len() as u64) < need {
            let why = done.err().map(|e| format!(" ({e})")).unwrap_or_default();
            return Err(self.fault(format!("{name} at byte {at}: {} bytes of {need}{why}", out.len())));
        }
        self.predict(image, &mut out)?;
        Ok(Some(out))
    }

    /// Undoes the predictor, and turns samples into this machine's byte order.
    fn predict(&self, image: &Image, bytes: &mut [u8]) -> Result<()> {
        let size = (image.bits / 8) as usize;
        let stride = image.samples_per_chunk() as usize;
        let whole = matches!(image.bits, 8 | 16 | 32 | 64);
        let swap = self.big_endian != cfg!(target_endian = "big");
        let by_crate =
            matches!(Compression::of(image.compression), Compression::Jpeg | Compression::Fax | Compression::Lerc);
        match image.predictor {
            _ if by_crate => {}
            1 if swap && whole && size > 1 => bytes.chunks_exact_mut(size).for_each(<[u8]>::reverse),
            1 => {}
            2 if whole => {
                if swap && size > 1 {
                    bytes.chunks_exact_mut(size).for_each(<[u8]>::reverse);
                }
                for row in bytes.chunks_mut(image.row_bytes()) {
                    sum(row, size, stride);
                }
            }
            3 if image.sample == Sample::Float => {
                for row in bytes.chunks_mut(image.row_bytes()) {
                    for i in stride..row.len() {
                        row[i] = row[i].wrapping_add(row[i - stride]);
                    }
                    // The most significant bytes of all samples first, whatever the file's order.
                    let (n, planes) = (row.len() / size, row.to_vec());
                    for (i, sample) in row.chunks_exact_mut(size).enumerate() {
                        for (k, byte) in sample.iter_mut().enumerate() {
                            let k = if cfg!(target_endian = "big") { k } else { size - 1 - k };
                            *byte = planes[k * n + i];
                        }
                    }
                }
            }
            n => {
                let (bits, sample) = (image.bits, image.sample);
                return Err(
                    self.fault(format!("tag 317: predictor {n} of {bits}-bit samples ({sample:?}) is not read"))
                );
            }
        }
        Ok(())
    }

    /// A chunk of JPEG or fax, which the `tiff` crate unpacks.
    fn by_crate(&mut self, image: &Image, index: u32) -> Result<Vec<u8>> {
        use tiff::decoder::{Decoder, DecodingResult, Limits};
        if image.samples != 1 || !matches!(image.bits, 1 | 8) {
            let (samples, bits) = (image.samples, image.bits);
            return Err(
                self.fault(format!("JPEG or fax of {samples} samples of {bits} bits; rewrite the file with deflate"))
            );
        }
        self.input.rewind().map_err(|e| Error::io(self.path, "read", e))?;
        let fail = |e: tiff::TiffError| Error::format(self.path, format!("TIFF: {e}"));
        let mut limits = Limits::default();
        limits.ifd_value_size = self.len as usize;
        let mut decoder = Decoder::new(&mut self.input).map_err(fail)?.with_limits(limits);
        decoder.seek_to_image(image.page).map_err(fail)?;
        let DecodingResult::U8(mut values) = decoder.read_chunk(index).map_err(fail)? else {
            return Err(Error::format(self.path, "TIFF: JPEG or fax of other than bytes"));
        };
        if image.photometric == 0 {
            values.iter_mut().for_each(|v| *v = !*v);
        }
        // The crate leaves the padding of tiles away.
        let (wide, _) = decoder.chunk_data_dimensions(index);
        let (from, to) = ((wide as usize * image.bits as usize).div_ceil(8), image.row_bytes());
        let mut out = vec![0; image.chunk_size(index) as usize];
        for (row, values) in out.chunks_mut(to).zip(values.chunks(from)) {
            row[..values.len()].copy_from_slice(values);
        }
        Ok(out)
    }
}

impl Image {
    /// Samples of a pixel that one chunk holds.
    fn samples_per_chunk(&self) -> u32 {
        if self.planar { 1 } else { self.samples }
    }

    /// Bytes of a row of a chunk.
    pub fn row_bytes(&self) -> usize {
        let bits = u64::from(self.chunk[0]) * u64::from(self.samples_per_chunk()) * u64::from(self.bits);
        usize::try_from(bits.div_ceil(8)).unwrap_or(usize::MAX)
    }

    /// Bytes of a chunk; the last strip is shorter where the height asks for it.
    fn chunk_size(&self, index: u32) -> u64 {
        let row = index / self.across % self.down;
        let rows = if self.tiled { self.chunk[1] } else { self.chunk[1].min(self.height - row * self.chunk[1]) };
        (self.row_bytes() as u64).saturating_mul(rows.into())
    }

    /// The chunk that holds sample `band` of the pixels of chunk `(column, row)`.
    pub fn index(&self, column: u32, row: u32, band: u32) -> u32 {
        let plane = if self.planar { band * self.across * self.down } else { 0 };
        plane + row * self.across + column
    }

    /// Sample `band` of pixel `i` of a chunk's row.
    pub fn value(&self, row: &[u8], i: usize, band: u32) -> f64 {
        let i = if self.planar { i } else { i * self.samples as usize + band as usize };
        fn at<const N: usize>(row: &[u8], i: usize) -> [u8; N] {
            row[i * N..(i + 1) * N].try_into().expect("N bytes")
        }
        match (self.sample, self.bits) {
            (Sample::Unsigned, 8) => row[i].into(),
            (Sample::Unsigned, 16) => u16::from_ne_bytes(at(row, i)).into(),
            (Sample::Unsigned, 32) => u32::from_ne_bytes(at(row, i)).into(),
            (Sample::Unsigned, 64) => u64::from_ne_bytes(at(row, i)) as f64,
            (Sample::Signed, 8) => (row[i] as i8).into(),
            (Sample::Signed, 16) => i16::from_ne_bytes(at(row, i)).into(),
            (Sample::Signed, 32) => i32::from_ne_bytes(at(row, i)).into(),
            (Sample::Signed, 64) => i64::from_ne_bytes(at(row, i)) as f64,
            (Sample::Float, 16) => half(u16::from_ne_bytes(at(row, i))),
            (Sample::Float, 32) => f32::from_ne_bytes(at(row, i)).into(),
            (Sample::Float, _) => f64::from_ne_bytes(at(row, i)),
            (_, bits) => {
                let first = i * bits as usize;
                let bit = |n: usize| u64::from(row[n / 8] >> (7 - n % 8) & 1);
                let value = (first..first + bits as usize).fold(0, |v, n| v << 1 | bit(n));
                match self.sample {
                    Sample::Signed => ((value << (64 - bits)) as i64 >> (64 - bits)) as f64,
                    _ => value as f64,
                }
            }
        }
    }
}

fn kind_size(kind: u16) -> u64 {
    match kind {
        1 | 2 | 6 | 7 => 1,
        3 | 8 => 2,
        4 | 9 | 11 | 13 => 4,
        5 | 10 | 12 | 16 | 17 | 18 => 8,
        _ => 0,
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Compression {
    None,
    Fax,
    Lzw,
    Jpeg,
    Deflate,
    PackBits,
    Zstd,
    Lerc,
    Unknown(&'static str),
}

impl Compression {
    fn of(tag: u64) -> Compression {
        match tag {
            1 => Compression::None,
            2..=4 => Compression::Fax,
            5 => Compression::Lzw,
            7 => Compression::Jpeg,
            8 | 32_946 => Compression::Deflate,
            32_773 => Compression::PackBits,
            50_000 => Compression::Zstd,
            6 => Compression::Unknown("JPEG of before 1995"),
            34_712 | 33_003 | 33_005 => Compression::Unknown("JPEG 2000"),
            34_887 => Compression::Lerc,
            34_925 => Compression::Unknown("LZMA"),
            50_001 => Compression::Unknown("WebP"),
            50_002 | 52_546 => Compression::Unknown("JPEG XL"),
            _ => Compression::Unknown("unknown"),
        }
    }

    /// Bytes that one byte becomes at most.
    fn inflation(self) -> f64 {
        match self {
            // Chunks that are alike may share their bytes.
            Compression::None => 16.0,
            Compression::PackBits => 64.0,
            Compression::Deflate | Compression::Jpeg => 1100.0,
            // A string of 4,096 from 12 bits.
            Compression::Lzw => 2731.0,
            // A line without change is a bit; a block of one byte is 128 KiB from four.
            Compression::Fax | Compression::Zstd | Compression::Lerc | Compression::Unknown(_) => 65_536.0,
        }
    }
}

/// Adds to each sample the one before it of its kind.
fn sum(row: &mut [u8], size: usize, stride: usize) {
    macro_rules! sum {
        ($t:ty) => {{
            const N: usize = size_of::<$t>();
            let get = |row: &[u8], i: usize| <$t>::from_ne_bytes(row[i * N..(i + 1) * N].try_into().expect("N bytes"));
            for i in stride..row.len() / N {
                let v = get(row, i).wrapping_add(get(row, i - stride));
                row[i * N..(i + 1) * N].copy_from_slice(&v.to_ne_bytes());
            }
        }};
    }
    match size {
        1 => sum!(u8),
        2 => sum!(u16),
        4 => sum!(u32),
        _ => sum!(u64),
    }
}

fn lzw(decoder: &mut weezl::decode::Decoder, mut from: &[u8], need: u64, out: &mut Vec<u8>) -> std::io::Result<()> {
    let mut buffer = vec![0; 1 << 16];
    while (out.len() as u64) < need {
        let step = decoder.decode_bytes(from, &mut buffer);
        from = &from[step.consumed_in..];
        let n = step.consumed_out.min(need as usize - out.len());
        out.extend_from_slice(&buffer[..n]);
        match step.status {
            Ok(weezl::LzwStatus::Ok) => {}
            Ok(weezl::LzwStatus::NoProgress | weezl::LzwStatus::Done) => break,
            Err(e) => return Err(std::io::Error::other(e)),
        }
    }
    Ok(())
}

fn unpacked(from: &mut dyn Read, need: u64) -> std::io::Result<Vec<u8>> {
    let mut out = Vec::new();
    from.take(need.saturating_mul(2).saturating_add(1 << 16)).read_to_end(&mut out)?;
    Ok(out)
}

fn bits_of<T>(_: &[T]) -> u32 {
    8 * size_of::<T>() as u32
}

/// The samples of a LERC blob in this machine's order; NaN where its mask says that there are none.
fn lerc(image: &Image, blob: &[u8]) -> Result<Vec<u8>, String> {
    use lerc::SampleData;
    let info = lerc::decode_info(blob).map_err(|e| e.to_string())?;
    let n = image.samples_per_chunk();
    let (deep, rows) = (u64::from(info.depth) * u64::from(info.bands.max(1)), image.chunk[1]);
    if u64::from(info.width) * u64::from(info.height) * deep > LERC_LIMIT {
        return Err(format!(
            "{} × {} pixels of {deep} values at once; {LERC_LIMIT} values can be held",
            info.width, info.height
        ));
    }
    if info.width != image.chunk[0] || info.height > rows || deep != u64::from(n) {
        let what = format!("{} × {} pixels of {deep} values", info.width, info.height);
        return Err(format!("{what}, where the directory has {} × {rows} of {n}", image.chunk[0]));
    }
    let decoded = std::panic::catch_unwind(|| lerc::decode(blob));
    let decoded =
        decoded.map_err(|_| "its decoder gave up; the file is damaged".to_owned())?.map_err(|e| e.to_string())?;
    let mask = decoded.valid_masks.first().filter(|mask| mask.num_pixels() > 0 && !mask.is_all_valid());
    let holes = |i: usize| mask.is_some_and(|mask| !mask.is_valid(i / n as usize));
    macro_rules! bytes {
        ($values:expr, $kind:expr, $none:expr) => {{
            let mut values = $values;
            values.iter_mut().enumerate().filter(|(i, _)| holes(*i)).for_each(|(_, v)| *v = $none);
            (bytemuck::cast_slice(&values).to_vec(), $kind, bits_of(&values))
        }};
    }
    let whole = !matches!(decoded.data, SampleData::F32(_) | SampleData::F64(_));
    if whole && mask.is_some() {
        return Err("whole numbers with a mask; rewrite the file with deflate and a no-data value".to_owned());
    }
    let (bytes, sample, bits): (Vec<u8>, Sample, u32) = match decoded.data {
        SampleData::I8(v) => bytes!(v, Sample::Signed, 0),
        SampleData::U8(v) => bytes!(v, Sample::Unsigned, 0),
        SampleData::I16(v) => bytes!(v, Sample::Signed, 0),
        SampleData::U16(v) => bytes!(v, Sample::Unsigned, 0),
        SampleData::I32(v) => bytes!(v, Sample::Signed, 0),
        SampleData::U32(v) => bytes!(v, Sample::Unsigned, 0),
        SampleData::F32(v) => bytes!(v, Sample::Float, f32::NAN),
        SampleData::F64(v) => bytes!(v, Sample::Float, f64::NAN),
    };
    if (sample, bits) != (image.sample, image.bits) {
        return Err(format!("{bits} bits ({sample:?}), where the directory has {} ({:?})", image.bits, image.sample));
    }
    Ok(bytes)
}

fn pack_bits(mut from: &[u8], need: u64, out: &mut Vec<u8>) {
    while let [head, rest @ ..] = from {
        if out.len() as u64 >= need {
            break;
        }
        from = match *head as i8 {
            n @ 0.. => {
                let (run, rest) = rest.split_at(rest.len().min(n as usize + 1));
                out.extend_from_slice(run);
                rest
            }
            -128 => rest,
            n => match rest {
                [byte, rest @ ..] => {
                    out.resize(out.len() + 1 + usize::from(n.unsigned_abs()), *byte);
                    rest
                }
                [] => rest,
            },
        };
    }
}

#[cfg(not(target_arch = "wasm32"))]
fn zstd(packed: &[u8]) -> std::io::Result<impl Read + '_> {
    zstd::stream::read::Decoder::with_buffer(packed)
}

#[cfg(target_arch = "wasm32")]
fn zstd(packed: &[u8]) -> std::io::Result<impl Read + '_> {
    ruzstd::decoding::StreamingDecoder::new(packed).map_err(|e| std::io::Error::other(e.to_string()))
}

/// A number of 16 bits: sign, five bits of exponent, ten of fraction (IEEE 754).
fn half(bits: u16) -> f64 {
    let (exponent, fraction) = (i32::from(bits >> 10 & 31), f64::from(bits & 1023));
    let value = match exponent {
        0 => fraction * 2f64.powi(-24),
        31 if fraction == 0.0 => f64::INFINITY,
        31 => f64::NAN,
        e => (1024.0 + fraction) * 2f64.powi(e - 25),
    };
    if bits >> 15 == 1 { -value } else { value }
}
