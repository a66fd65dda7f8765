//! TIFF and BigTIFF as pages of tags and chunks (strips or tiles) of samples, in either byte order: for rasters sample by sample
//! ([`Image::value`]), for stacks as bands of rows of one type ([`Tiff::bands`]).
//!
//! Pages and chunks are read here, codecs come from crates. The crate `tiff` (0.11.3) reads chunks of no bytes, which valid
//! files have (GDAL's sparse files), as the file's first bytes, complements values where 0 is white, and takes no samples of
//! 9 to 15 bits.
//!
//! After TIFF 6.0 (Adobe, 1992), its Technical Notes 1 to 3 (predictor 3, floats of 24 bits) and the BigTIFF text of libtiff.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashSet};
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use super::{Dtype, guarded};
use crate::store::scratch::read_at;
use crate::{Error, Result};

/// Tags by number.
pub(super) mod tags {
    pub const NEW_SUBFILE_TYPE: u16 = 254;
    pub const SUBFILE_TYPE: u16 = 255;
    pub const WIDTH: u16 = 256;
    pub const HEIGHT: u16 = 257;
    pub const BITS: u16 = 258;
    pub const COMPRESSION: u16 = 259;
    pub const PHOTOMETRIC: u16 = 262;
    pub const FILL_ORDER: u16 = 266;
    pub const DESCRIPTION: u16 = 270;
    pub const STRIP_OFFSETS: u16 = 273;
    pub const ORIENTATION: u16 = 274;
    pub const SAMPLES: u16 = 277;
    pub const ROWS_PER_STRIP: u16 = 278;
    pub const STRIP_COUNTS: u16 = 279;
    pub const X_RESOLUTION: u16 = 282;
    pub const Y_RESOLUTION: u16 = 283;
    pub const PLANAR: u16 = 284;
    pub const T4_OPTIONS: u16 = 292;
    pub const PREDICTOR: u16 = 317;
    pub const COLOR_MAP: u16 = 320;
    pub const TILE_WIDTH: u16 = 322;
    pub const TILE_HEIGHT: u16 = 323;
    pub const TILE_OFFSETS: u16 = 324;
    pub const TILE_COUNTS: u16 = 325;
    pub const SUB_IFDS: u16 = 330;
    pub const EXTRA_SAMPLES: u16 = 338;
    pub const SAMPLE_FORMAT: u16 = 339;
    pub const JPEG_TABLES: u16 = 347;
    pub const IMAGE_DEPTH: u16 = 32_997;
    pub const PIXEL_SCALE: u16 = 33_550;
    /// MetaMorph: numbers of each plane of a stack with one directory.
    pub const UIC2: u16 = 33_629;
    pub const TIE_POINTS: u16 = 33_922;
    pub const TRANSFORMATION: u16 = 34_264;
    pub const CZ_LSM_INFO: u16 = 34_412;
    pub const GEO_KEYS: u16 = 34_735;
    pub const GEO_DOUBLES: u16 = 34_736;
    pub const GEO_TEXT: u16 = 34_737;
    pub const GDAL_METADATA: u16 = 42_112;
    pub const GDAL_NODATA: u16 = 42_113;
    pub const LERC_PARAMETERS: u16 = 50_674;
}

/// Pixels that a chunk without bytes may stand for: its entry in the directory has eight bytes at least.
const SPARSE_CHUNK: u64 = 1 << 22;

/// Values of one LERC blob: its head can claim any number of equal ones.
const LERC_LIMIT: u64 = 1 << 27;

/// Bytes of a band of rows that are unpacked at once.
const BAND_LIMIT: u64 = 1 << 31;

/// A file: looked at through `all`, read from its file where it has one, so that what is read does not count as memory in use.
pub(super) struct Tiff<'a> {
    path: PathBuf,
    pub all: &'a [u8],
    file: Option<File>,
    pub big_endian: bool,
    /// Pages that follow each other, from the first on.
    pub pages: Vec<Page>,
}

/// A directory: the tags of one image.
#[derive(Clone, Debug)]
pub(super) struct Page {
    /// Where in the chain it stands, from 0.
    pub index: usize,
    /// Where in the file.
    pub at: u64,
    entries: BTreeMap<u16, Entry>,
}

#[derive(Clone, Copy, Debug)]
struct Entry {
    kind: u16,
    count: u64,
    /// Where the values lie.
    at: u64,
}

impl Page {
    pub fn has(&self, tag: u16) -> bool {
        self.entries.contains_key(&tag)
    }

    /// How many values a tag has.
    pub fn count(&self, tag: u16) -> u64 {
        self.entries.get(&tag).map_or(0, |e| e.count)
    }

    /// Whether a page says where on Earth it lies.
    pub fn is_placed(&self) -> bool {
        [tags::PIXEL_SCALE, tags::TIE_POINTS, tags::TRANSFORMATION, tags::GEO_KEYS].iter().any(|t| self.has(*t))
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
    pub width: u32,
    pub height: u32,
    /// Samples per pixel, and bits of each.
    pub samples: u32,
    pub bits: u32,
    pub sample: Sample,
    /// 0: white is 0; 1: black is 0; 2: RGB; 3: palette; 4: mask; 5: CMYK; 6: YCbCr; 8: CIELab.
    pub photometric: u64,
    compression: Compression,
    predictor: u64,
    /// Samples of a kind lie together, each in chunks of their own.
    planar: bool,
    reversed_bits: bool,
    jpeg_tables: Option<Vec<u8>>,
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
    /// `in_file` says that the file at `path` holds these bytes.
    pub fn open(path: &Path, all: &'a [u8], in_file: bool) -> Result<Tiff<'a>> {
        let big_endian = match all.get(..2) {
            Some(b"II") => false,
            Some(b"MM") => true,
            _ => return Err(Error::format(path, "byte 0: TIFF starts with \"II\" or \"MM\"")),
        };
        let file = in_file.then(|| File::open(path).map_err(|e| Error::io(path, "open", e))).transpose()?;
        let mut tiff = Tiff { path: path.to_owned(), all, file, big_endian, pages: Vec::new() };
        // BigTIFF has offsets of 64 bits.
        let (wide, first) = match (tiff.at(2, 2), tiff.at(4, 2)) {
            (Some(42), _) => (false, tiff.at(4, 4)),
            (Some(43), Some(8)) => (true, tiff.at(8, 8)),
            (Some(43), _) => return Err(tiff.fault("byte 4: the header is cut short or not of BigTIFF's form")),
            (version, _) => {
                let version = version.map_or("none".to_owned(), |v| v.to_string());
                return Err(tiff.fault(format!("byte 2: version {version}; TIFF is 42, BigTIFF 43")));
            }
        };
        let mut next = first.ok_or_else(|| tiff.fault("byte 4: the header is cut short"))?;
        let (mut seen, mut entries) = (HashSet::new(), 0);
        while next != 0 {
            if !seen.insert(next) {
                return Err(tiff.fault(format!("byte {next}: the chain of pages comes back to this one")));
            }
            let (page, after) = tiff.page(next, wide).ok_or_else(|| {
                tiff.fault(format!("byte {next}: the file ends inside the tags of page {}", tiff.pages.len()))
            })?;
            // Directories that do not overlap have no more entries than the file has room for.
            entries += page.entries.len() + 1;
            if entries > all.len() / 6 {
                return Err(tiff.fault(format!("byte {next}: directories overlap")));
            }
            tiff.pages.push(page);
            next = after;
        }
        if tiff.pages.is_empty() {
            return Err(tiff.fault("no page; a picture has one at least"));
        }
        Ok(tiff)
    }

    pub fn fault(&self, what: impl std::fmt::Display) -> Error {
        Error::format(&self.path, format!("TIFF: {what}"))
    }

    /// A whole number of 1 to 8 bytes in the file's order.
    fn number(&self, bytes: &[u8]) -> u64 {
        let step = |n: u64, &b: &u8| n << 8 | u64::from(b);
        if self.big_endian { bytes.iter().fold(0, step) } else { bytes.iter().rev().fold(0, step) }
    }

    fn at(&self, at: u64, size: u64) -> Option<u64> {
        let from = usize::try_from(at).ok()?;
        Some(self.number(self.all.get(from..from.checked_add(size as usize)?)?))
    }

    /// The page at a place, and where the next one is.
    fn page(&self, at: u64, wide: bool) -> Option<(Page, u64)> {
        let (head, step, word) = if wide { (8, 20, 8) } else { (2, 12, 4) };
        let n = self.at(at, head)?;
        let end = at.checked_add(head)?.checked_add(n.checked_mul(step)?)?;
        // A last directory may lack the place of the next.
        let next = match self.at(end, word) {
            Some(next) => next,
            None if end <= self.all.len() as u64 => 0,
            None => return None,
        };
        let mut entries = BTreeMap::new();
        for i in 0..n {
            let at = at + head + i * step;
            let (tag, kind) = (self.at(at, 2)? as u16, self.at(at + 2, 2)? as u16);
            let (count, inline) = (self.at(at + 4, word)?, at + 4 + word);
            let fits = kind_size(kind).checked_mul(count).is_some_and(|n| n <= word);
            let at = if fits { inline } else { self.at(inline, word)? };
            // Of a tag that stands there twice the first counts, as libtiff has it.
            entries.entry(tag).or_insert(Entry { kind, count, at });
        }
        Some((Page { index: self.pages.len(), at, entries }, next))
    }

    fn raw(&self, page: &Page, tag: u16) -> Result<Option<(u16, &'a [u8])>> {
        let Some(&Entry { kind, count, at }) = page.entries.get(&tag) else { return Ok(None) };
        let size = kind_size(kind).checked_mul(count).filter(|_| kind_size(kind) > 0);
        let size = size.ok_or_else(|| self.fault(format!("tag {tag}: {count} values of type {kind}")))?;
        let range = at.checked_add(size).filter(|&end| end <= self.all.len() as u64);
        let end = range.ok_or_else(|| {
            self.fault(format!("tag {tag}: {size} bytes at byte {at}, the file has {}", self.all.len()))
        })?;
        Ok(Some((kind, &self.all[at as usize..end as usize])))
    }

    /// Values of a tag as numbers; None where the page has no such tag.
    pub fn numbers(&self, page: &Page, tag: u16) -> Result<Option<Vec<f64>>> {
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
    pub fn integers(&self, page: &Page, tag: u16) -> Result<Option<Vec<u64>>> {
        let Some((kind, bytes)) = self.raw(page, tag)? else { return Ok(None) };
        if !is_integer(kind) {
            return Err(self.fault(format!("tag {tag}: values of type {kind}; whole numbers were expected")));
        }
        Ok(Some(bytes.chunks_exact(kind_size(kind) as usize).map(|b| self.number(b)).collect()))
    }

    /// The first value of a tag; of long lists no more is read.
    pub fn integer(&self, page: &Page, tag: u16) -> Result<Option<u64>> {
        let Some((kind, bytes)) = self.raw(page, tag)? else { return Ok(None) };
        if !is_integer(kind) {
            return Err(self.fault(format!("tag {tag}: a value of type {kind}; a whole number was expected")));
        }
        Ok(bytes.chunks_exact(kind_size(kind) as usize).next().map(|b| self.number(b)))
    }

    /// The first value of a tag that says more of an image than how to read it: one that is damaged says nothing.
    pub fn hint(&self, page: &Page, tag: u16) -> Option<u64> {
        self.integer(page, tag).ok().flatten()
    }

    /// Bytes of a tag's values, in the file's order.
    pub fn bytes_of(&self, page: &Page, tag: u16) -> Result<Option<&'a [u8]>> {
        Ok(self.raw(page, tag)?.map(|(_, bytes)| bytes))
    }

    /// Text of a tag, up to its first byte 0.
    pub fn text(&self, page: &Page, tag: u16) -> Result<Option<String>> {
        let raw = self.raw(page, tag)?;
        Ok(raw.map(|(_, b)| String::from_utf8_lossy(b.split(|&b| b == 0).next().unwrap_or_default()).into_owned()))
    }

    /// Whether a page is a smaller copy of another, or a mask.
    pub fn is_extra(&self, page: &Page) -> bool {
        self.hint(page, tags::NEW_SUBFILE_TYPE).unwrap_or(0) & 0b101 != 0
            || self.hint(page, tags::SUBFILE_TYPE) == Some(2)
    }

    /// How a page's image is laid out, its claims held against the file.
    pub fn image(&self, page: &Page) -> Result<Image> {
        let fault = |what: String| self.fault(format!("page {} at byte {}: {what}", page.index, page.at));
        let side = |tag: u16, what: &str| {
            let n = self.integer(page, tag)?.and_then(|n| u32::try_from(n).ok()).filter(|&n| n > 0);
            n.ok_or_else(|| fault(format!("tag {tag}: {what} is missing, 0, or more than 32 bits")))
        };
        let (width, height) = (side(tags::WIDTH, "the width")?, side(tags::HEIGHT, "the height")?);
        if let Some(n) = self.integer(page, tags::IMAGE_DEPTH)?.filter(|&n| n > 1) {
            return Err(fault(format!("tag 32997: {n} slices in one page; save the volume with a page per slice")));
        }
        let samples = self.integer(page, tags::SAMPLES)?.unwrap_or(1);
        let same = |tag: u16, default: u64| {
            let values = self.integers(page, tag)?.filter(|v| !v.is_empty()).unwrap_or_else(|| vec![default]);
            match values.iter().all(|v| *v == values[0]) {
                true => Ok(values[0]),
                false => Err(fault(format!("tag {tag}: samples of unlike kinds ({values:?}) are not read"))),
            }
        };
        let (bits, format) = (same(tags::BITS, 1)?, same(tags::SAMPLE_FORMAT, 1)?);
        let sample = match format {
            // 4: "undefined", which libtiff reads as whole numbers.
            1 | 4 => Sample::Unsigned,
            2 => Sample::Signed,
            3 => Sample::Float,
            5 | 6 => return Err(fault("tag 339: complex values; write their magnitude as one band of f32".to_owned())),
            n => return Err(fault(format!("tag 339: sample format {n}; 1 to 3 are read"))),
        };
        let sound = match sample {
            Sample::Float => matches!(bits, 16 | 24 | 32 | 64),
            // Of 24 bits GDAL turns the bytes of such files about, others do not.
            _ => (1..=32).contains(&bits) && !(bits == 24 && self.big_endian) || bits == 64,
        };
        if !sound || !(1..=65_535).contains(&samples) {
            let what = format!("{samples} samples per pixel, each of {bits} bits ({sample:?})");
            let read =
                "whole numbers of 1 to 32 (24 in little-endian files alone) or 64 bits and floats of 16, 24, 32, 64";
            return Err(fault(format!("{what}; {read} are read")));
        }
        let planar = self.integer(page, tags::PLANAR)?.unwrap_or(1) == 2 && samples > 1;
        let tiled = page.has(tags::TILE_OFFSETS);
        let (chunk, offsets, counts) = match tiled {
            true => {
                let chunk = [side(tags::TILE_WIDTH, "a tile's width")?, side(tags::TILE_HEIGHT, "its height")?];
                (chunk, tags::TILE_OFFSETS, tags::TILE_COUNTS)
            }
            false => {
                let rows = self.integer(page, tags::ROWS_PER_STRIP)?.unwrap_or(u64::MAX).clamp(1, height.into());
                ([width, rows as u32], tags::STRIP_OFFSETS, tags::STRIP_COUNTS)
            }
        };
        let number = self.integer(page, tags::COMPRESSION)?.unwrap_or(1);
        let compression = Compression::of(number).map_err(|name| {
            let what = format!("tag 259: compression {number} ({name}) is not read");
            fault(format!("{what}; rewrite the file with deflate, LZW or Zstandard"))
        })?;
        let mut image = Image {
            width,
            height,
            samples: samples as u32,
            bits: bits as u32,
            sample,
            photometric: self.integer(page, tags::PHOTOMETRIC)?.unwrap_or(1),
            compression,
            predictor: self.integer(page, tags::PREDICTOR)?.unwrap_or(1),
            planar,
            reversed_bits: self.integer(page, tags::FILL_ORDER)?.unwrap_or(1) == 2,
            jpeg_tables: self.bytes_of(page, tags::JPEG_TABLES)?.map(<[u8]>::to_vec),
            lerc: self.integers(page, tags::LERC_PARAMETERS)?.and_then(|v| v.get(1).copied()).unwrap_or(0),
            extra: self.integers(page, tags::EXTRA_SAMPLES)?.unwrap_or_default(),
            chunk,
            across: width.div_ceil(chunk[0]),
            down: height.div_ceil(chunk[1]),
            tiled,
            offsets: self.integers(page, offsets)?.unwrap_or_default(),
            counts: self.integers(page, counts)?.unwrap_or_default(),
        };
        self.check_form(page, &image).map_err(fault)?;
        let chunks = u64::from(image.across) * u64::from(image.down) * if planar { samples } else { 1 };
        if image.counts.is_empty() && compression == Compression::None && image.offsets.len() as u64 == chunks {
            // Needed by the standard, left away by some; without compression the size goes without saying.
            image.counts = (0..chunks).map(|i| image.chunk_size(i as u32)).collect();
        }
        let (n, m) = (image.offsets.len() as u64, image.counts.len() as u64);
        if n < chunks || m < chunks {
            return Err(fault(format!("{n} offsets and {m} byte counts of {chunks} strips or tiles (tag {offsets})")));
        }
        let sparse = image.counts.iter().filter(|&&n| n == 0).count() as u64;
        // A tile may be larger than the image.
        let pixels = (f64::from(width) * f64::from(height)).max(f64::from(chunk[0]) * f64::from(chunk[1]));
        let size = pixels * (samples * bits) as f64 / 8.0;
        let room = self.all.len() as f64 * compression.inflation()
            + (sparse * SPARSE_CHUNK) as f64 * (samples * bits) as f64 / 8.0;
        if size > room {
            let len = self.all.len();
            return Err(fault(format!("{len} bytes cannot hold the {width} × {height} pixels that the header claims")));
        }
        Ok(image)
    }

    /// Refuses what cannot be read, by its name.
    fn check_form(&self, page: &Page, image: &Image) -> Result<(), String> {
        let (bits, sample) = (image.bits, image.sample);
        match image.compression {
            Compression::Group3 if self.hint(page, tags::T4_OPTIONS).unwrap_or(0) & 1 != 0 => {
                return Err(
                    "CCITT Group 3 in two dimensions is not read; rewrite the file with Group 4 or deflate".to_owned()
                );
            }
            Compression::Group3 | Compression::Group4 | Compression::Huffman if (bits, image.samples) != (1, 1) => {
                return Err(format!("CCITT fax of {bits} bits × {}; expected 1 bit per pixel", image.samples));
            }
            Compression::Jpeg if bits != 8 || sample != Sample::Unsigned => {
                return Err(format!("JPEG of {bits} bits ({sample:?}); rewrite the file with deflate"));
            }
            _ => {}
        }
        let predicted = match image.predictor {
            _ if !image.compression.predicts() => true,
            1 => true,
            2 => matches!(bits, 8 | 16 | 32 | 64),
            3 => sample == Sample::Float,
            _ => false,
        };
        if !predicted {
            let what = format!("tag 317: predictor {} of {bits}-bit samples ({sample:?}) is not read", image.predictor);
            return Err(format!("{what}; rewrite the file without"));
        }
        Ok(())
    }

    /// `len` bytes from `at` on.
    fn read(&self, at: u64, len: u64, what: &str) -> Result<Cow<'a, [u8]>> {
        let end = at.checked_add(len).filter(|&end| end <= self.all.len() as u64);
        let end = end
            .ok_or_else(|| self.fault(format!("{what}: {len} bytes at byte {at}, the file has {}", self.all.len())))?;
        let Some(file) = &self.file else { return Ok(Cow::Borrowed(&self.all[at as usize..end as usize])) };
        let mut bytes = vec![0; len as usize];
        #[cfg(not(target_arch = "wasm32"))]
        read_at(file, &mut bytes, at).map_err(|e| Error::io(&self.path, "read", e))?;
        #[cfg(target_arch = "wasm32")]
        let _ = (file, &mut bytes, read_at);
        Ok(Cow::Owned(bytes))
    }

    /// Bytes of a chunk, unpacked: [`Image::row_bytes`] per row; samples of 8, 16, 32 and 64 bits in this machine's order, all
    /// others from the most significant bit on. None where the file has no bytes for it, which stands for "nothing was written
    /// here".
    pub fn chunk(&self, image: &Image, index: u32) -> Result<Option<Vec<u8>>> {
        let (at, count) = (image.offsets[index as usize], image.counts[index as usize]);
        if count == 0 {
            return Ok(None);
        }
        let need = image.chunk_size(index);
        let name = format!("{} {index}", if image.tiled { "tile" } else { "strip" });
        let compression = image.compression;
        // What follows the samples of a chunk is not looked at.
        let count = if compression == Compression::None { count.min(need) } else { count };
        let mut packed = self.read(at, count, &name)?;
        if image.reversed_bits && compression != Compression::Jpeg {
            packed.to_mut().iter_mut().for_each(|b| *b = b.reverse_bits());
        }
        let mut out = Vec::new();
        let done = match compression {
            Compression::None => {
                out = packed.into_owned();
                Ok(())
            }
            _ => self.unpack(image, &packed, need, &mut out),
        };
        // A stream cut short still gives what came before; too little of it is the fault that counts.
        if (out.len() as u64) < need {
            let why = done.err().map(|e| format!(" ({}: {e})", compression.name())).unwrap_or_default();
            return Err(self.fault(format!("{name} at byte {at}: {} bytes of {need}{why}", out.len())));
        }
        out.truncate(need as usize);
        self.predict(image, &mut out);
        Ok(Some(out))
    }

    fn unpack(&self, image: &Image, packed: &[u8], need: u64, out: &mut Vec<u8>) -> Result<(), String> {
        let text = |e: std::io::Error| e.to_string();
        let mut all = |from: &mut dyn Read| from.take(need).read_to_end(out).map(|_| ()).map_err(text);
        match image.compression {
            Compression::None => out.extend_from_slice(packed),
            Compression::Lzw if packed.starts_with(&[0, 1]) => {
                return Err("LZW of before TIFF 6.0; rewrite the file with any other compression".to_owned());
            }
            Compression::Lzw => return lzw(packed, need, out).map_err(text),
            Compression::Deflate => return all(&mut flate2::read::ZlibDecoder::new(packed)),
            Compression::Zstd => return all(&mut zstd(packed).map_err(text)?),
            Compression::PackBits => pack_bits(packed, need, out),
            Compression::Jpeg => {
                *out = guarded(&self.path, "JPEG", || Ok(jpeg(image, packed, need))).map_err(|e| e.to_string())??
            }
            Compression::Group4 | Compression::Group3 | Compression::Huffman => {
                return guarded(&self.path, "fax", || Ok(fax(image, packed, need, out))).map_err(|e| e.to_string())?;
            }
            Compression::Lerc => {
                let blob = match image.lerc {
                    0 => Ok(Cow::Borrowed(packed)),
                    // What LERC leaves as it is is as long as the chunk, beside a head.
                    1 => unpacked(&mut flate2::read::ZlibDecoder::new(packed), need).map(Cow::Owned),
                    2 => zstd(packed).and_then(|mut from| unpacked(&mut from, need)).map(Cow::Owned),
                    n => return Err(format!("packed by method {n}; 0 to 2 are read")),
                };
                let rows = (need / (image.row_bytes() as u64).max(1)) as u32;
                *out = lerc(image, rows, &blob.map_err(text)?)?;
            }
        }
        Ok(())
    }

    /// Undoes the predictor, and turns samples into this machine's byte order.
    fn predict(&self, image: &Image, bytes: &mut [u8]) {
        let size = (image.bits / 8) as usize;
        let stride = image.samples_per_chunk() as usize;
        let turned = match image.bits {
            // LERC's values are those of the file's order, as libtiff packs and unpacks them.
            16 | 32 | 64 => self.big_endian != cfg!(target_endian = "big"),
            // Floats of 24 bits follow the file's order; whole numbers are packed bits.
            24 => image.sample == Sample::Float && !self.big_endian,
            _ => false,
        };
        if image.compression.predicts() && image.predictor == 3 {
            for row in bytes.chunks_mut(image.row_bytes()) {
                for i in stride..row.len() {
                    row[i] = row[i].wrapping_add(row[i - stride]);
                }
                // The most significant bytes of all samples first, whatever the file's order.
                let (n, planes) = (row.len() / size, row.to_vec());
                for (i, sample) in row.chunks_exact_mut(size).enumerate() {
                    for (k, byte) in sample.iter_mut().enumerate() {
                        let k = if cfg!(target_endian = "big") || size == 3 { k } else { size - 1 - k };
                        *byte = planes[k * n + i];
                    }
                }
            }
            return;
        }
        if turned {
            // What LERC has no value for is NaN before and after: libtiff loses values that are NaN with their bytes turned about.
            let none = |v: &[u8]| match (image.compression, image.sample, size) {
                (Compression::Lerc, Sample::Float, 4) => f32::from_ne_bytes([v[0], v[1], v[2], v[3]]).is_nan(),
                (Compression::Lerc, Sample::Float, 8) => v.try_into().is_ok_and(|v| f64::from_ne_bytes(v).is_nan()),
                _ => false,
            };
            bytes.chunks_exact_mut(size).filter(|v| !none(v)).for_each(<[u8]>::reverse);
        }
        if image.compression.predicts() && image.predictor == 2 {
            for row in bytes.chunks_mut(image.row_bytes()) {
                sum(row, size, stride);
            }
        }
    }

    /// Calls `each` with sample `band` of band after band of rows, as values of [`Image::dtype`] in this machine's byte order;
    /// 0 where nothing was written.
    pub fn bands(&self, image: &Image, band: u32, mut each: impl FnMut(&[u8]) -> Result<()>) -> Result<()> {
        let size = image.dtype().size();
        let row = u64::from(image.width) * size;
        let high = u64::from(image.chunk[1].min(image.height));
        let fits = |n: u64| n.checked_mul(high).is_some_and(|n| n <= BAND_LIMIT);
        if !fits(row) || !fits(image.row_bytes() as u64) {
            let what = format!("{}: strips or tiles of {} × {high} pixels", self.path.display(), image.chunk[0]);
            return Err(Error::Limit(format!("{what}; at most {BAND_LIMIT} bytes are unpacked at once")));
        }
        let mut values = vec![0; (row * high) as usize];
        for down in 0..image.down {
            let rows = image.chunk[1].min(image.height - down * image.chunk[1]) as usize;
            for across in 0..image.across {
                let chunk = self.chunk(image, image.index(across, down, band))?;
                let x = across * image.chunk[0];
                let wide = image.chunk[0].min(image.width - x) as usize;
                for y in 0..rows {
                    let from = y * row as usize + x as usize * size as usize;
                    let to = &mut values[from..][..wide * size as usize];
                    match &chunk {
                        Some(chunk) => image.copy(&chunk[y * image.row_bytes()..], band, to),
                        None => to.fill(0),
                    }
                }
            }
            each(&values[..row as usize * rows])?;
        }
        Ok(())
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
            (Sample::Float, 16) => half(u16::from_ne_bytes(at(row, i))).into(),
            (Sample::Float, 32) => f32::from_ne_bytes(at(row, i)).into(),
            (Sample::Float, 64) => f64::from_ne_bytes(at(row, i)),
            (Sample::Float, _) => f24(packed(row, i, 24) as u32).into(),
            (Sample::Unsigned, bits) => packed(row, i, bits) as f64,
            (Sample::Signed, bits) => signed(packed(row, i, bits), bits) as f64,
        }
    }

    /// Type of the values of a band.
    pub fn dtype(&self) -> Dtype {
        match (self.sample, self.bits) {
            _ if self.is_color() => Dtype::U8,
            (Sample::Float, 64) => Dtype::F64,
            (Sample::Float, _) => Dtype::F32,
            (Sample::Unsigned, ..=8) => Dtype::U8,
            (Sample::Unsigned, ..=16) => Dtype::U16,
            (Sample::Unsigned, ..=32) => Dtype::U32,
            (Sample::Unsigned, _) => Dtype::U64,
            (Sample::Signed, ..=8) => Dtype::I8,
            (Sample::Signed, ..=16) => Dtype::I16,
            (Sample::Signed, ..=32) => Dtype::I32,
            (Sample::Signed, _) => Dtype::I64,
        }
    }

    pub fn is_jpeg(&self) -> bool {
        self.compression == Compression::Jpeg
    }

    /// Whether a band is the brightness of colours, of 8 bits each.
    pub fn is_color(&self) -> bool {
        let rgb = self.photometric == 2 && self.samples >= 3 && self.bits == 8 && self.sample == Sample::Unsigned;
        !self.planar && (rgb || self.photometric == 6)
    }

    /// Sample `band` of the pixels of a chunk's row, as many as there is room for.
    fn copy(&self, row: &[u8], band: u32, to: &mut [u8]) {
        let samples = self.samples_per_chunk() as usize;
        if self.is_color() {
            let pixels = row.chunks_exact(samples).map(|p| luma([p[0], p[1], p[2]]));
            to.iter_mut().zip(pixels).for_each(|(to, v)| *to = v);
            return;
        }
        let size = self.dtype().size() as usize;
        if self.bits as usize == 8 * size {
            let pick = if self.planar { 0 } else { band as usize };
            if samples == 1 {
                return to.copy_from_slice(&row[..to.len()]);
            }
            let from = row.chunks_exact(size).skip(pick).step_by(samples);
            return to.chunks_exact_mut(size).zip(from).for_each(|(to, v)| to.copy_from_slice(v));
        }
        for (i, to) in to.chunks_exact_mut(size).enumerate() {
            // Fewer bits than 53: nothing is lost.
            let v = self.value(row, i, band);
            match self.dtype() {
                Dtype::F32 => to.copy_from_slice(&(v as f32).to_ne_bytes()),
                Dtype::U8 => to.copy_from_slice(&(v as u8).to_ne_bytes()),
                Dtype::I8 => to.copy_from_slice(&(v as i8).to_ne_bytes()),
                Dtype::U16 => to.copy_from_slice(&(v as u16).to_ne_bytes()),
                Dtype::I16 => to.copy_from_slice(&(v as i16).to_ne_bytes()),
                Dtype::U32 => to.copy_from_slice(&(v as u32).to_ne_bytes()),
                _ => to.copy_from_slice(&(v as i32).to_ne_bytes()),
            }
        }
    }

    /// Where the values start, if they lie in the file one after the other, as they are handed out but for the order of bytes.
    pub fn contiguous(&self) -> Option<u64> {
        let plain = self.compression == Compression::None && self.samples == 1 && !self.is_color();
        let whole = matches!(self.bits, 8 | 16 | 32 | 64)
            && !self.reversed_bits
            && u64::from(self.bits) == 8 * self.dtype().size();
        let strips = self.chunk[0] == self.width && self.offsets.first() != Some(&0);
        let full = u64::from(self.width) * u64::from(self.chunk[1]) * u64::from(self.bits / 8);
        let start = *self.offsets.first()?;
        let (mut at, mut y) = (start, 0);
        for &offset in &self.offsets[..self.down as usize] {
            if offset != at {
                return None;
            }
            at = at.checked_add(full)?;
            y = self.chunk[1].saturating_add(y);
        }
        (plain && whole && strips && y >= self.height && !self.counts.contains(&0)).then_some(start)
    }

    /// Bytes of the page as `contiguous` has it.
    pub fn byte_len(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height) * self.dtype().size()
    }
}

/// Number `i` of a row of such of so many bits, the most significant first.
fn packed(row: &[u8], i: usize, bits: u32) -> u64 {
    let bit = |n: usize| u64::from(row[n / 8] >> (7 - n % 8) & 1);
    (i * bits as usize..(i + 1) * bits as usize).fold(0, |v, n| v << 1 | bit(n))
}

fn signed(value: u64, bits: u32) -> i64 {
    (value << (64 - bits)) as i64 >> (64 - bits)
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

fn is_integer(kind: u16) -> bool {
    matches!(kind, 1 | 3 | 4 | 6 | 7 | 8 | 9 | 13 | 16 | 17 | 18)
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Compression {
    None,
    Huffman,
    Group3,
    Group4,
    Lzw,
    Jpeg,
    Deflate,
    PackBits,
    Zstd,
    Lerc,
}

impl Compression {
    /// By its number, or the name of one that is not read.
    fn of(number: u64) -> Result<Compression, &'static str> {
        Ok(match number {
            1 => Compression::None,
            2 => Compression::Huffman,
            3 => Compression::Group3,
            4 => Compression::Group4,
            5 => Compression::Lzw,
            7 => Compression::Jpeg,
            8 | 32_946 => Compression::Deflate,
            32_773 => Compression::PackBits,
            34_887 => Compression::Lerc,
            34_926 | 50_000 => Compression::Zstd,
            6 => return Err("JPEG as TIFF 6.0 had it, of before 1995"),
            32_809 => return Err("ThunderScan"),
            33_003 | 33_004 | 33_005 | 34_712 => return Err("JPEG 2000"),
            34_661 => return Err("JBIG"),
            34_925 => return Err("LZMA"),
            34_927 | 50_001 => return Err("WebP"),
            34_933 => return Err("PNG"),
            34_934 | 50_002 | 52_546 => return Err("JPEG XL"),
            34_676 | 34_677 => return Err("SGI LogL and LogLuv"),
            _ => return Err("of a kind that is not known"),
        })
    }

    fn name(self) -> &'static str {
        match self {
            Compression::None => "no compression",
            Compression::Huffman => "CCITT modified Huffman",
            Compression::Group3 | Compression::Group4 => "CCITT fax",
            Compression::Lzw => "LZW",
            Compression::Jpeg => "JPEG",
            Compression::Deflate => "deflate",
            Compression::PackBits => "PackBits",
            Compression::Zstd => "Zstandard",
            Compression::Lerc => "LERC",
        }
    }

    /// Whether the predictor's tag counts; beside others, libtiff does not look at it.
    fn predicts(self) -> bool {
        matches!(self, Compression::Lzw | Compression::Deflate | Compression::Zstd)
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
            _ => 65_536.0,
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

fn lzw(mut from: &[u8], need: u64, out: &mut Vec<u8>) -> std::io::Result<()> {
    let mut decoder = weezl::decode::Decoder::with_tiff_size_switch(weezl::BitOrder::Msb, 8);
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
fn lerc(image: &Image, rows: u32, blob: &[u8]) -> Result<Vec<u8>, String> {
    use lerc::SampleData;
    let info = lerc::decode_info(blob).map_err(|e| e.to_string())?;
    let n = image.samples_per_chunk();
    let deep = u64::from(info.depth) * u64::from(info.bands.max(1));
    if u64::from(info.width) * u64::from(info.height) * deep > LERC_LIMIT {
        return Err(format!(
            "{} × {} pixels of {deep} values at once; {LERC_LIMIT} values can be held",
            info.width, info.height
        ));
    }
    if info.width != image.chunk[0] || info.height < rows || deep != u64::from(n) {
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

/// Brightness, or the three colours, of a JPEG whose tables may stand in the directory.
fn jpeg(image: &Image, stored: &[u8], need: u64) -> Result<Vec<u8>, String> {
    let mut whole = Vec::new();
    if let Some(tables) = &image.jpeg_tables {
        // Without its end, and what follows without its start.
        whole.extend_from_slice(tables.strip_suffix(b"\xff\xd9").unwrap_or(tables));
        whole.extend_from_slice(stored.strip_prefix(b"\xff\xd8").unwrap_or(stored));
    } else {
        whole.extend_from_slice(stored);
    }
    let mut reader = image::ImageReader::with_format(std::io::Cursor::new(whole), image::ImageFormat::Jpeg);
    let mut limits = image::Limits::default();
    limits.max_alloc = Some(need.saturating_mul(16).saturating_add(1 << 20));
    reader.limits(limits);
    let picture = reader.decode().map_err(|e| e.to_string())?;
    if picture.width() != image.chunk[0] {
        return Err(format!("{} pixels wide, the strip or tile is {}", picture.width(), image.chunk[0]));
    }
    Ok(match image.photometric {
        6 if image.samples == 3 && !image.planar => picture.into_rgb8().into_raw(),
        _ => match picture {
            image::DynamicImage::ImageLuma8(v) if image.samples_per_chunk() == 1 => v.into_raw(),
            _ => return Err("colours where brightness was expected; rewrite the file with deflate".to_owned()),
        },
    })
}

/// Rows of one bit per pixel, black being 1 as libtiff has it.
fn fax(image: &Image, packed: &[u8], need: u64, out: &mut Vec<u8>) -> Result<(), String> {
    let wide = image.chunk[0];
    let width = u16::try_from(wide).map_err(|_| format!("{wide} pixels wide, at most 65535"))?;
    let bytes = usize::from(width).div_ceil(8);
    let rows = need / bytes as u64;
    let mut n = 0;
    // Runs of white and black in turn.
    let mut line = |ends: &[u16]| {
        if n == rows {
            return;
        }
        n += 1;
        let at = out.len();
        out.resize(at + bytes, 0);
        for run in ends.chunks(2) {
            let (from, to) = (run[0].min(width), run.get(1).copied().unwrap_or(width).min(width));
            (from..to).for_each(|x| out[at + usize::from(x) / 8] |= 0x80 >> (x % 8));
        }
    };
    // Codes are looked up by more bits than the last one may have; and a line of Group 3 is handed out at the mark that follows
    // it, which the last of a strip need not have.
    let bits = packed.iter().copied().chain([0, 0, 1]);
    let done = match image.compression {
        Compression::Group4 => fax::decoder::decode_g4(bits, width, u16::try_from(rows).ok(), &mut line),
        Compression::Group3 => fax::decoder::decode_g3(bits, &mut line),
        _ => fax::ByteReader::new(bits.map(Ok::<u8, std::convert::Infallible>))
            .ok()
            .and_then(|reader| (0..rows).try_fold(reader, |reader, _| huffman(reader, width, &mut line)))
            .map(|_| ()),
    };
    done.ok_or_else(|| "the data are damaged".to_owned())
}

/// A row of modified Huffman codes (TIFF 6.0, section 10), which ends with a byte.
fn huffman<R: fax::BitReader>(mut reader: R, width: u16, line: &mut impl FnMut(&[u16])) -> Option<R> {
    let (mut ends, mut at, mut black) = (Vec::new(), 0u16, false);
    while at < width || ends.is_empty() {
        loop {
            let run = match black {
                true => fax::maps::black::decode(&mut reader)?,
                false => fax::maps::white::decode(&mut reader)?,
            };
            at = at.checked_add(run).filter(|&at| at <= width)?;
            // Longer ones are followed by what is left.
            if run < 64 {
                break;
            }
        }
        ends.push(at);
        black = !black;
    }
    line(&ends);
    let rest = reader.bits_to_byte_boundary();
    reader.consume(rest).ok()?;
    Some(reader)
}

/// Brightness of a colour, as the height maps have it; of a grey one, its value.
pub(super) fn luma([r, g, b]: [u8; 3]) -> u8 {
    ((2126 * u32::from(r) + 7152 * u32::from(g) + 722 * u32::from(b)) / 10_000) as u8
}

/// A half float (IEEE 754 binary16).
pub(super) fn half(v: u16) -> f32 {
    let sign = u32::from(v >> 15) << 31;
    let (exponent, fraction) = (u32::from(v >> 10 & 31), u32::from(v & 0x3ff));
    match exponent {
        0 => f32::from_bits(sign | 0x3f80_0000) * (fraction as f32 / 16_777_216.0),
        31 => f32::from_bits(sign | 0x7f80_0000 | fraction << 13),
        e => f32::from_bits(sign | (e + 112) << 23 | fraction << 13),
    }
}

/// A float of 24 bits: 1 of sign, 7 of exponent, 16 of fraction (TIFF technical note 3).
fn f24(v: u32) -> f32 {
    let sign = v >> 23 << 31;
    let (exponent, fraction) = (v >> 16 & 127, v & 0xffff);
    match exponent {
        0 => f32::from_bits(sign | 0x3f80_0000) * (fraction as f32 * 2f32.powi(-78)),
        127 => f32::from_bits(sign | 0x7f80_0000 | fraction << 7),
        e => f32::from_bits(sign | (e + 64) << 23 | fraction << 7),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_floats_are_those_of_ieee_754() {
        let cases =
            [(0x3c00, 1.0), (0xc000, -2.0), (0x7bff, 65_504.0), (0x0001, 5.960_464_5e-8), (0x0400, 6.103_515_6e-5)];
        for (bits, value) in cases {
            assert_eq!(half(bits), value, "{bits:#x}");
        }
        assert!(half(0x7e00).is_nan() && half(0xfc00) == f32::NEG_INFINITY);
        for (bits, value) in [(0x3f_0000, 1.0), (0xc0_8000, -3.0), (0x00_0001, 3.308_722_5e-24)] {
            assert_eq!(f24(bits), value, "{bits:#x}");
        }
        assert!(f24(0x7f_8000).is_nan() && f24(0xff_0000) == f32::NEG_INFINITY);
    }
}
