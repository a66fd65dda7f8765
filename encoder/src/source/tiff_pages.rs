//! TIFF pages as stored samples: what a file says of each page, and the values of a band of its rows, for stacks.
//!
//! The crate `tiff` (0.11.3) turns values of MinIsWhite pages round (or refuses them), takes the bytes at the start of the
//! file for tiles that were never written, and hands out packed bits of samples of fewer than 8 bits, so directories and
//! bands are read here, and codecs come from crates. Source: TIFF 6.0 (Adobe, 1992), its technical notes 1 to 3, BigTIFF as libtiff
//! has it.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashSet};
use std::fs::File;
use std::io::Read;
use std::path::Path;

use super::Dtype;
use crate::store::scratch::read_at;
use crate::{Error, Result};

/// Bytes of a band of rows that are unpacked at once.
const BAND_LIMIT: u64 = 1 << 31;

/// Tags by number, as TIFF names them.
pub(super) mod tag {
    pub const NEW_SUBFILE_TYPE: u16 = 254;
    pub const SUBFILE_TYPE: u16 = 255;
    pub const WIDTH: u16 = 256;
    pub const LENGTH: u16 = 257;
    pub const BITS: u16 = 258;
    pub const COMPRESSION: u16 = 259;
    pub const PHOTOMETRIC: u16 = 262;
    pub const FILL_ORDER: u16 = 266;
    pub const DESCRIPTION: u16 = 270;
    pub const STRIP_OFFSETS: u16 = 273;
    pub const ORIENTATION: u16 = 274;
    pub const SAMPLES: u16 = 277;
    pub const ROWS_PER_STRIP: u16 = 278;
    pub const STRIP_BYTES: u16 = 279;
    pub const X_RESOLUTION: u16 = 282;
    pub const Y_RESOLUTION: u16 = 283;
    pub const PLANAR: u16 = 284;
    pub const T4_OPTIONS: u16 = 292;
    pub const PREDICTOR: u16 = 317;
    pub const COLOR_MAP: u16 = 320;
    pub const TILE_WIDTH: u16 = 322;
    pub const TILE_LENGTH: u16 = 323;
    pub const TILE_OFFSETS: u16 = 324;
    pub const TILE_BYTES: u16 = 325;
    pub const SUB_IFDS: u16 = 330;
    pub const SAMPLE_FORMAT: u16 = 339;
    pub const JPEG_TABLES: u16 = 347;
    pub const IMAGE_DEPTH: u16 = 32_997;
    /// MetaMorph: numbers of each plane of a stack with one directory.
    pub const UIC2: u16 = 33_629;
    pub const MODEL_PIXEL_SCALE: u16 = 33_550;
    pub const MODEL_TIEPOINT: u16 = 33_922;
    pub const MODEL_TRANSFORMATION: u16 = 34_264;
    pub const CZ_LSM_INFO: u16 = 34_412;
    pub const GEO_KEYS: u16 = 34_735;
    pub const GDAL_METADATA: u16 = 42_112;
    pub const GDAL_NODATA: u16 = 42_113;
    pub const LERC_PARAMETERS: u16 = 50_674;
}

/// The bytes of a TIFF: looked at through `all`, read from `file` where there is one, so that they do not count as memory in use.
pub(super) struct Tiff<'a> {
    pub all: &'a [u8],
    file: Option<File>,
    pub big_endian: bool,
    /// Directories that follow each other, from the first on.
    pub pages: Vec<Ifd>,
}

/// A directory: type, number and place of values of each tag.
pub(super) struct Ifd {
    /// Where it stands in the file.
    pub at: u64,
    entries: BTreeMap<u16, Entry>,
}

#[derive(Clone, Copy)]
struct Entry {
    kind: u16,
    count: u64,
    at: u64,
}

/// Bytes of a value of each type; 0 for those that are not known.
fn size_of(kind: u16) -> u64 {
    match kind {
        1 | 2 | 6 | 7 => 1,
        3 | 8 => 2,
        4 | 9 | 11 | 13 => 4,
        5 | 10 | 12 | 16..=18 => 8,
        _ => 0,
    }
}

impl<'a> Tiff<'a> {
    /// `in_file` says that the file at `path` holds these bytes.
    pub fn open(path: &Path, all: &'a [u8], in_file: bool) -> Result<Tiff<'a>> {
        let fail = |at: u64, what: &str| Err(Error::format(path, format!("byte {at}: {what}")));
        let big_endian = match all.get(..2) {
            Some(b"II") => false,
            Some(b"MM") => true,
            _ => return fail(0, "expected II or MM, so this is no TIFF"),
        };
        let file = in_file.then(|| File::open(path).map_err(|e| Error::io(path, "open", e))).transpose()?;
        let mut tiff = Tiff { all, file, big_endian, pages: Vec::new() };
        let (wide, first) = match (tiff.number(2, 2), tiff.number(4, 2)) {
            (Some(42), _) => (false, tiff.number(4, 4)),
            (Some(43), Some(8)) => (true, tiff.number(8, 8)),
            _ => return fail(2, "expected 42 (TIFF) or 43 (BigTIFF)"),
        };
        let mut next = first.unwrap_or(0);
        let (mut seen, mut entries) = (HashSet::new(), 0);
        while next != 0 {
            if !seen.insert(next) {
                return fail(next, &format!("directory {} is one that was there before", tiff.pages.len()));
            }
            let (ifd, after) = tiff.directory(next, wide).ok_or_else(|| {
                Error::format(path, format!("byte {next}: the file ends inside directory {}", tiff.pages.len()))
            })?;
            // Directories that do not overlap have no more entries than the file has room for.
            entries += ifd.entries.len() + 1;
            if entries > all.len() / 6 {
                return fail(next, "directories overlap");
            }
            tiff.pages.push(ifd);
            next = after;
        }
        if tiff.pages.is_empty() {
            return fail(4, "no directory: the TIFF holds no image");
        }
        Ok(tiff)
    }

    fn number(&self, at: u64, size: u64) -> Option<u64> {
        let from = usize::try_from(at).ok()?;
        let bytes = self.all.get(from..from.checked_add(size as usize)?)?;
        let fold = |n: u64, &b: &u8| n << 8 | u64::from(b);
        Some(if self.big_endian { bytes.iter().fold(0, fold) } else { bytes.iter().rev().fold(0, fold) })
    }

    fn directory(&self, at: u64, wide: bool) -> Option<(Ifd, u64)> {
        let (head, step, word) = if wide { (8, 20, 8) } else { (2, 12, 4) };
        let n = self.number(at, head)?;
        let end = at.checked_add(head)?.checked_add(n.checked_mul(step)?)?;
        // A last directory may lack the place of the next.
        let next = match self.number(end, word) {
            Some(next) => next,
            None if end <= self.all.len() as u64 => 0,
            None => return None,
        };
        let mut entries = BTreeMap::new();
        for i in 0..n {
            let at = at + head + i * step;
            let (tag, kind) = (self.number(at, 2)? as u16, self.number(at + 2, 2)? as u16);
            let count = self.number(at + 4, word)?;
            let inline = at + 4 + word;
            let fits = size_of(kind).checked_mul(count).is_some_and(|n| n <= word);
            let place = if fits { inline } else { self.number(inline, word)? };
            entries.insert(tag, Entry { kind, count, at: place });
        }
        Some((Ifd { at, entries }, next))
    }

    /// Bytes of a tag's values, if the file holds them.
    pub fn raw(&self, ifd: &Ifd, tag: u16) -> Option<&'a [u8]> {
        let Entry { kind, count, at } = *ifd.entries.get(&tag)?;
        let end = at.checked_add(size_of(kind).checked_mul(count)?)?;
        self.all.get(usize::try_from(at).ok()?..usize::try_from(end).ok()?)
    }

    /// Whole numbers; None where the tag is not there, or holds none.
    pub fn ints(&self, ifd: &Ifd, tag: u16) -> Option<Vec<u64>> {
        let bytes = self.raw(ifd, tag)?;
        let Entry { kind, at, .. } = ifd.entries[&tag];
        let size = size_of(kind);
        matches!(kind, 1 | 3 | 4 | 6 | 7 | 8 | 9 | 13 | 16..=18)
            .then(|| (0..bytes.len() as u64 / size).filter_map(|i| self.number(at + i * size, size)).collect())
    }

    pub fn int(&self, ifd: &Ifd, tag: u16) -> Option<u64> {
        // Of long lists the first alone.
        let Entry { kind, at, count } = *ifd.entries.get(&tag)?;
        let known = matches!(kind, 1 | 3 | 4 | 6 | 7 | 8 | 9 | 13 | 16..=18) && count > 0;
        known.then(|| self.number(at, size_of(kind))).flatten()
    }

    /// Number of a tag's values; None where it is not there.
    pub fn count(&self, ifd: &Ifd, tag: u16) -> Option<u64> {
        ifd.entries.get(&tag).map(|e| e.count)
    }

    /// A quotient, or a whole number.
    pub fn ratio(&self, ifd: &Ifd, tag: u16) -> Option<f64> {
        let Entry { kind, at, count } = *ifd.entries.get(&tag)?;
        match kind {
            5 if count > 0 => {
                let (up, down) = (self.number(at, 4)?, self.number(at + 4, 4)?);
                (down > 0).then(|| up as f64 / down as f64)
            }
            _ => self.int(ifd, tag).map(|n| n as f64),
        }
    }

    /// Text up to its first 0.
    pub fn text(&self, ifd: &Ifd, tag: u16) -> Option<Cow<'a, str>> {
        let bytes = self.raw(ifd, tag)?;
        let end = bytes.iter().position(|&b| b == 0).unwrap_or(bytes.len());
        Some(String::from_utf8_lossy(&bytes[..end]))
    }

    /// `len` bytes from `at` on.
    fn read(&self, path: &Path, at: u64, len: u64) -> Result<Cow<'a, [u8]>> {
        let end = at.checked_add(len).filter(|&end| end <= self.all.len() as u64);
        let end = end.ok_or_else(|| {
            Error::format(path, format!("byte {at}: {len} bytes of values, the file ends at byte {}", self.all.len()))
        })?;
        let Some(file) = &self.file else {
            return Ok(Cow::Borrowed(&self.all[at as usize..end as usize]));
        };
        let mut bytes = vec![0; len as usize];
        #[cfg(not(target_arch = "wasm32"))]
        read_at(file, &mut bytes, at).map_err(|e| Error::io(path, "read", e))?;
        #[cfg(target_arch = "wasm32")]
        let _ = (file, &mut bytes, read_at);
        Ok(Cow::Owned(bytes))
    }

    /// Whether a page says where on Earth it lies.
    pub fn is_placed(&self, ifd: &Ifd) -> bool {
        use tag::{GEO_KEYS, MODEL_PIXEL_SCALE, MODEL_TIEPOINT, MODEL_TRANSFORMATION};
        [MODEL_PIXEL_SCALE, MODEL_TIEPOINT, MODEL_TRANSFORMATION, GEO_KEYS].iter().any(|t| ifd.entries.contains_key(t))
    }

    /// Whether a page is a smaller copy of another, or a mask.
    pub fn is_extra(&self, ifd: &Ifd) -> bool {
        self.int(ifd, tag::NEW_SUBFILE_TYPE).unwrap_or(0) & 0b101 != 0 || self.int(ifd, tag::SUBFILE_TYPE) == Some(2)
    }
}

/// What samples are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Uint,
    Int,
    Float,
}

/// How the values of a page are stored.
#[derive(Clone, Debug)]
pub(super) struct Page {
    pub width: u32,
    pub height: u32,
    pub bits: u32,
    pub kind: Kind,
    /// Samples of a pixel.
    pub samples: u32,
    /// Whether samples lie in planes of their own.
    planar: bool,
    pub photometric: u64,
    compression: u64,
    predictor: u64,
    reversed: bool,
    /// Width and height of strips or tiles.
    chunk: [u32; 2],
    offsets: Vec<u64>,
    counts: Vec<u64>,
    jpeg_tables: Option<Vec<u8>>,
    lerc: Option<u64>,
    t4_options: u64,
}

impl Page {
    pub fn new(path: &Path, tiff: &Tiff, ifd: &Ifd) -> Result<Page> {
        let at = ifd.at;
        let fail = |what: String| Error::format(path, format!("directory at byte {at}: {what}"));
        let need = |t: u16, name: &str| tiff.int(ifd, t).ok_or_else(|| fail(format!("no {name} (tag {t})")));
        let side = |t: u16, name: &str| -> Result<u32> {
            let n = need(t, name)?;
            u32::try_from(n).ok().filter(|&n| n > 0).ok_or_else(|| fail(format!("{name} (tag {t}) is {n}")))
        };
        let (width, height) = (side(tag::WIDTH, "ImageWidth")?, side(tag::LENGTH, "ImageLength")?);
        let same = |t: u16, name: &str, default: u64| -> Result<u64> {
            match tiff.ints(ifd, t).as_deref() {
                None | Some([]) => Ok(default),
                Some(&[n, ref more @ ..]) if more.iter().all(|&m| m == n) => Ok(n),
                Some(all) => Err(fail(format!("{name} (tag {t}) is {all:?}; samples of one type alone are read"))),
            }
        };
        let bits = same(tag::BITS, "BitsPerSample", 1)?;
        let kind = match same(tag::SAMPLE_FORMAT, "SampleFormat", 1)? {
            1 | 4 => Kind::Uint,
            2 => Kind::Int,
            3 => Kind::Float,
            n => return Err(fail(format!("SampleFormat {n} (complex numbers); save their magnitude as floats"))),
        };
        let known = match kind {
            Kind::Float => matches!(bits, 16 | 24 | 32 | 64),
            _ => (1..=32).contains(&bits) || bits == 64,
        };
        if !known {
            return Err(fail(format!("samples of {bits} bits ({kind:?}); save them with 8, 16 or 32 bits")));
        }
        if let Some(n) = tiff.int(ifd, tag::IMAGE_DEPTH).filter(|&n| n > 1) {
            return Err(fail(format!("ImageDepth (tag 32997) is {n}; save the volume as pages, one a slice")));
        }
        let samples = tiff.int(ifd, tag::SAMPLES).unwrap_or(1).clamp(1, 65_535) as u32;
        let photometric = tiff.int(ifd, tag::PHOTOMETRIC).unwrap_or(1);
        let tiled = ifd.entries.contains_key(&tag::TILE_OFFSETS);
        let chunk = match tiled {
            true => [side(tag::TILE_WIDTH, "TileWidth")?, side(tag::TILE_LENGTH, "TileLength")?],
            false => {
                let rows = tiff.int(ifd, tag::ROWS_PER_STRIP).unwrap_or(height.into()).clamp(1, height.into());
                [width, rows as u32]
            }
        };
        let (offsets, counts) = match tiled {
            true => (tag::TILE_OFFSETS, tag::TILE_BYTES),
            false => (tag::STRIP_OFFSETS, tag::STRIP_BYTES),
        };
        let offsets = tiff.ints(ifd, offsets).ok_or_else(|| fail(format!("no place of values (tag {offsets})")))?;
        let planar = tiff.int(ifd, tag::PLANAR) == Some(2) && samples > 1;
        let mut page = Page {
            width,
            height,
            bits: bits as u32,
            kind,
            samples,
            planar,
            photometric,
            compression: tiff.int(ifd, tag::COMPRESSION).unwrap_or(1),
            predictor: tiff.int(ifd, tag::PREDICTOR).unwrap_or(1),
            reversed: tiff.int(ifd, tag::FILL_ORDER) == Some(2),
            chunk,
            offsets,
            counts: tiff.ints(ifd, counts).unwrap_or_default(),
            jpeg_tables: tiff.raw(ifd, tag::JPEG_TABLES).map(<[u8]>::to_vec),
            lerc: tiff.ints(ifd, tag::LERC_PARAMETERS).and_then(|v| v.get(1).copied()),
            t4_options: tiff.int(ifd, tag::T4_OPTIONS).unwrap_or(0),
        };
        let [across, down] = page.chunks();
        let n = u64::from(across) * u64::from(down) * if planar { u64::from(samples) } else { 1 };
        if (page.offsets.len() as u64) < n {
            return Err(fail(format!("{} strips or tiles; {width} × {height} pixels take {n}", page.offsets.len())));
        }
        if page.counts.len() < page.offsets.len() {
            if page.compression != 1 {
                let what = format!("{} byte counts of {} strips or tiles", page.counts.len(), page.offsets.len());
                return Err(fail(what));
            }
            // Some writers leave them out; without compression they say nothing new.
            page.counts = vec![u64::MAX; page.offsets.len()];
        }
        page.check_form(path, at)?;
        Ok(page)
    }

    /// Refuses what cannot be read, by its name.
    fn check_form(&self, path: &Path, at: u64) -> Result<()> {
        let fail = |what: String| Err(Error::format(path, format!("directory at byte {at}: {what}")));
        let codec = match self.compression {
            1 | 3 | 4 | 5 | 7 | 8 | 32_773 | 32_946 | 34_887 | 34_926 | 50_000 => "",
            2 => "CCITT modified Huffman",
            6 => "JPEG as TIFF 6.0 had it",
            32_809 => "ThunderScan",
            33_003 | 33_004 | 33_005 | 34_712 => "JPEG 2000",
            34_661 => "JBIG",
            34_925 => "LZMA",
            34_927 | 50_001 => "WebP",
            34_934 | 50_002 | 52_546 => "JPEG XL",
            _ => "of a kind that is not known",
        };
        if !codec.is_empty() {
            let n = self.compression;
            return fail(format!("compression {codec} ({n}) is not read; save it with Deflate, ZSTD or LZW, or none"));
        }
        if self.compression == 3 && self.t4_options & 1 != 0 {
            return fail("CCITT Group 3 in two dimensions is not read; save it with Group 4 or Deflate".to_owned());
        }
        if matches!(self.compression, 3 | 4) && (self.bits != 1 || self.samples != 1) {
            return fail(format!("CCITT fax of {} bits × {}; expected 1 bit a pixel", self.bits, self.samples));
        }
        let floats = self.kind == Kind::Float && self.bits != 24;
        let predicted = match self.predictor {
            1 => true,
            2 => matches!(self.bits, 8 | 16 | 32 | 64),
            3 => floats || (self.kind == Kind::Float && self.bits == 24),
            _ => false,
        };
        if !predicted {
            let (predictor, bits) = (self.predictor, self.bits);
            return fail(format!("predictor {predictor} of {bits}-bit samples is not read; save it without"));
        }
        match self.photometric {
            0 | 1 | 3 | 4 | 32_803 => Ok(()),
            2 if self.samples >= 3 && self.compression != 7 => Ok(()),
            6 if self.compression == 7 && self.bits == 8 && self.samples == 3 && !self.planar => Ok(()),
            // Many writers mark two channels so.
            2 if self.samples < 3 => Ok(()),
            n => {
                let name = match n {
                    2 => "RGB as JPEG",
                    5 => "CMYK",
                    6 => "YCbCr",
                    8..=10 => "L*a*b*",
                    32_844 | 32_845 => "LogL and LogLuv",
                    _ => "of a kind that is not known",
                };
                fail(format!("colours {name} (PhotometricInterpretation {n}) are not read; save it as grey"))
            }
        }
    }

    /// Type of values that are handed out.
    pub fn dtype(&self) -> Dtype {
        match (self.kind, self.bits) {
            _ if self.is_color() => Dtype::U8,
            (Kind::Float, 64) => Dtype::F64,
            (Kind::Float, _) => Dtype::F32,
            (Kind::Uint, ..=8) => Dtype::U8,
            (Kind::Uint, ..=16) => Dtype::U16,
            (Kind::Uint, ..=32) => Dtype::U32,
            (Kind::Uint, _) => Dtype::U64,
            (Kind::Int, ..=8) => Dtype::I8,
            (Kind::Int, ..=16) => Dtype::I16,
            (Kind::Int, ..=32) => Dtype::I32,
            (Kind::Int, _) => Dtype::I64,
        }
    }

    /// Whether brightness of colours is handed out: of 8 bits each.
    pub fn is_color(&self) -> bool {
        let rgb = self.photometric == 2 && self.samples >= 3 && self.bits == 8 && self.kind == Kind::Uint;
        rgb && !self.planar || self.photometric == 6
    }

    /// Strips or tiles across and down.
    fn chunks(&self) -> [u32; 2] {
        [self.width.div_ceil(self.chunk[0]), self.height.div_ceil(self.chunk[1])]
    }

    /// Where the values start, if they lie in the file one after the other, as they are handed out but for the order of bytes.
    pub fn contiguous(&self) -> Option<u64> {
        let plain = self.compression == 1 && self.samples == 1 && !self.is_color() && self.predictor == 1;
        let whole =
            matches!(self.bits, 8 | 16 | 32 | 64) && !self.reversed && self.bits as u64 == 8 * self.dtype().size();
        let strips = self.chunk[0] == self.width && self.offsets.first() != Some(&0);
        let bytes = |rows: u32| u64::from(self.width) * u64::from(rows) * u64::from(self.bits / 8);
        let full = bytes(self.chunk[1]);
        let [_, down] = self.chunks();
        let mut at = *self.offsets.first()?;
        let (start, mut y) = (at, 0);
        for &offset in &self.offsets[..down as usize] {
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

    /// Calls `each` with the values of sample `sample` of band after band of rows, in this machine's byte order.
    pub fn bands(
        &self,
        path: &Path,
        tiff: &Tiff,
        sample: u32,
        mut each: impl FnMut(&[u8]) -> Result<()>,
    ) -> Result<()> {
        let [across, down] = self.chunks();
        let size = self.dtype().size();
        let row = u64::from(self.width) * size;
        let high = u64::from(self.chunk[1].min(self.height));
        if row.checked_mul(high).is_none_or(|n| n > BAND_LIMIT) {
            let what = format!("{}: strips or tiles of {} × {high} values", path.display(), self.width);
            return Err(Error::Limit(format!("{what}; at most {BAND_LIMIT} bytes are unpacked at once")));
        }
        let mut band = vec![0; (row * high) as usize];
        for down in 0..down {
            let rows = self.chunk[1].min(self.height - down * self.chunk[1]);
            for x in 0..across {
                let plane = if self.planar { sample * self.chunks()[1] * across } else { 0 };
                let values = self.chunk_values(path, tiff, (plane + down * across + x) as usize, rows, sample)?;
                let wide = self.chunk[0].min(self.width - x * self.chunk[0]) as usize * size as usize;
                let from = (x * self.chunk[0]) as usize * size as usize;
                let chunk_row = self.chunk[0] as usize * size as usize;
                for (y, values) in values.chunks_exact(chunk_row).take(rows as usize).enumerate() {
                    band[y * row as usize + from..][..wide].copy_from_slice(&values[..wide]);
                }
            }
            each(&band[..(row * u64::from(rows)) as usize])?;
        }
        Ok(())
    }

    /// The first `rows` rows of a strip or tile, one sample a pixel, in this machine's byte order.
    fn chunk_values(&self, path: &Path, tiff: &Tiff, i: usize, rows: u32, sample: u32) -> Result<Vec<u8>> {
        let (offset, count) = (self.offsets[i], self.counts[i]);
        let fail = |what: String| Error::format(path, format!("byte {offset}: strip or tile {i}: {what}"));
        let (wide, size) = (self.chunk[0] as usize, self.dtype().size() as usize);
        if u64::from(self.chunk[0]) * u64::from(rows) > BAND_LIMIT / 8 {
            return Err(fail(format!("{wide} × {rows} values; at most {} are unpacked at once", BAND_LIMIT / 8)));
        }
        // One that was never written.
        if count == 0 {
            return Ok(vec![0; wide * rows as usize * size]);
        }
        let samples = if self.planar { 1 } else { self.samples as usize };
        let row = (wide as u64 * samples as u64 * u64::from(self.bits)).div_ceil(8) as usize;
        let expected = row * rows as usize;
        // No codec makes more of a byte than this, but LERC, whose own header is asked.
        let inflation: u64 = match self.compression {
            1 => 1,
            34_926 | 50_000 => 40_000,
            3 | 4 | 34_887 => u64::MAX,
            _ => 1100,
        };
        if expected as u64 > BAND_LIMIT || count.saturating_mul(inflation) < expected as u64 {
            return Err(fail(format!("{count} bytes cannot hold the {expected} that {wide} × {rows} pixels take")));
        }
        let count = if self.compression == 1 { expected as u64 } else { count };
        let stored = tiff.read(path, offset, count)?;
        let stored = match self.reversed && self.compression != 7 {
            true => Cow::Owned(stored.iter().map(|b| b.reverse_bits()).collect()),
            false => stored,
        };
        let decoded = self.decode(&stored, expected, rows, path);
        let (mut bytes, native) = decoded.map_err(|what| fail(format!("{}: {what}", self.codec())))?;
        drop(stored);
        if bytes.len() < expected {
            return Err(fail(format!(
                "{}: {} bytes, {wide} × {rows} pixels take {expected}",
                self.codec(),
                bytes.len()
            )));
        }
        bytes.truncate(expected);
        if self.is_color() {
            return Ok(bytes.chunks_exact(samples).map(|p| luma([p[0], p[1], p[2]])).collect());
        }
        let big_endian = if native { cfg!(target_endian = "big") } else { tiff.big_endian };
        let mut out = Vec::with_capacity(wide * rows as usize * size);
        let pick = if self.planar { 0 } else { sample as usize };
        for row in bytes.chunks_exact_mut(row) {
            match self.predictor {
                2 if !matches!(self.compression, 1 | 7 | 34_887) => accumulate(row, self.bits, samples, big_endian),
                3 => {
                    let row = unshuffle(row, self.bits as usize / 8, samples);
                    self.samples_of(&row, wide, samples, pick, true, &mut out);
                    continue;
                }
                _ => {}
            }
            self.samples_of(row, wide, samples, pick, big_endian, &mut out);
        }
        Ok(out)
    }

    fn codec(&self) -> &'static str {
        match self.compression {
            1 => "no compression",
            3 | 4 => "CCITT fax",
            5 => "LZW",
            7 => "JPEG",
            32_773 => "PackBits",
            34_887 => "LERC",
            34_926 | 50_000 => "ZSTD",
            _ => "Deflate",
        }
    }

    /// At least `expected` bytes where the data hold them, and whether they are in this machine's byte order.
    fn decode(&self, stored: &[u8], expected: usize, rows: u32, path: &Path) -> Result<(Vec<u8>, bool), String> {
        let mut out = Vec::new();
        let text = |e: std::io::Error| e.to_string();
        match self.compression {
            1 => out = stored.to_vec(),
            5 => {
                let mut decoder = weezl::decode::Decoder::with_tiff_size_switch(weezl::BitOrder::Msb, 8);
                out = vec![0; expected];
                let mut n = 0;
                let mut from = stored;
                while n < expected {
                    let step = decoder.decode_bytes(from, &mut out[n..]);
                    from = &from[step.consumed_in..];
                    n += step.consumed_out;
                    match step.status {
                        Ok(weezl::LzwStatus::Ok) if step.consumed_in + step.consumed_out > 0 => {}
                        Ok(_) => break,
                        Err(e) => return Err(e.to_string()),
                    }
                }
                out.truncate(n);
            }
            7 => return self.jpeg(stored, expected).map(|v| (v, true)),
            8 | 32_946 => {
                flate2::read::ZlibDecoder::new(stored).take(expected as u64).read_to_end(&mut out).map_err(text)?;
            }
            32_773 => pack_bits(stored, expected, &mut out),
            3 | 4 => self.fax(stored, rows, &mut out)?,
            34_926 | 50_000 => out = unzstd(stored, expected).map_err(text)?,
            _ => {
                let inner = match self.lerc.unwrap_or(0) {
                    0 => Cow::Borrowed(stored),
                    1 => {
                        let limit = stored.len() as u64 * 1100;
                        flate2::read::ZlibDecoder::new(stored).take(limit).read_to_end(&mut out).map_err(text)?;
                        Cow::Owned(std::mem::take(&mut out))
                    }
                    2 => Cow::Owned(unzstd(stored, expected.saturating_mul(2).max(1 << 16)).map_err(text)?),
                    n => return Err(format!("additional compression {n} is not known")),
                };
                return self.lerc(&inner, rows, path).map(|v| (v, true));
            }
        }
        Ok((out, false))
    }

    fn lerc(&self, blob: &[u8], rows: u32, path: &Path) -> Result<Vec<u8>, String> {
        use lerc::SampleData;
        let info = lerc::decode_info(blob).map_err(|e| e.to_string())?;
        let samples = if self.planar { 1 } else { self.samples };
        let values =
            u64::from(info.width) * u64::from(info.height) * u64::from(info.depth) * u64::from(info.bands.max(1));
        let shape = (info.width, u64::from(info.depth) * u64::from(info.bands.max(1)));
        if shape != (self.chunk[0], samples.into()) || info.height < rows || values * 8 > BAND_LIMIT {
            return Err(format!("{} × {} × {} values", info.width, info.height, shape.1));
        }
        let image =
            super::guarded(path, "LERC", || lerc::decode(blob).map_err(|e| Error::format(path, format!("LERC: {e}"))));
        let image = image.map_err(|e| e.to_string())?;
        let missing = image.valid_masks.first().is_some_and(|mask| mask.num_pixels() > 0 && !mask.is_all_valid());
        let mut data = image.data;
        if missing {
            let mask = &image.valid_masks[0];
            let n = samples as usize;
            match &mut data {
                SampleData::F32(v) => {
                    v.iter_mut().enumerate().filter(|(i, _)| !mask.is_valid(i / n)).for_each(|(_, v)| *v = f32::NAN)
                }
                SampleData::F64(v) => {
                    v.iter_mut().enumerate().filter(|(i, _)| !mask.is_valid(i / n)).for_each(|(_, v)| *v = f64::NAN)
                }
                _ => {}
            }
        }
        let (bytes, kind, bits): (Vec<u8>, _, _) = match data {
            SampleData::I8(v) => (bytemuck::cast_slice(&v).to_vec(), Kind::Int, 8),
            SampleData::U8(v) => (v, Kind::Uint, 8),
            SampleData::I16(v) => (bytemuck::cast_slice(&v).to_vec(), Kind::Int, 16),
            SampleData::U16(v) => (bytemuck::cast_slice(&v).to_vec(), Kind::Uint, 16),
            SampleData::I32(v) => (bytemuck::cast_slice(&v).to_vec(), Kind::Int, 32),
            SampleData::U32(v) => (bytemuck::cast_slice(&v).to_vec(), Kind::Uint, 32),
            SampleData::F32(v) => (bytemuck::cast_slice(&v).to_vec(), Kind::Float, 32),
            SampleData::F64(v) => (bytemuck::cast_slice(&v).to_vec(), Kind::Float, 64),
        };
        if (kind, bits) != (self.kind, self.bits) {
            return Err(format!("values of {bits} bits ({kind:?}), the page has {} ({:?})", self.bits, self.kind));
        }
        Ok(bytes)
    }

    /// Brightness, or the three colours, of a JPEG whose tables may stand in the directory.
    fn jpeg(&self, stored: &[u8], expected: usize) -> Result<Vec<u8>, String> {
        let mut whole = Vec::new();
        if let Some(tables) = &self.jpeg_tables {
            // Without its end, and what follows without its start.
            whole.extend_from_slice(tables.strip_suffix(b"\xff\xd9").unwrap_or(tables));
            whole.extend_from_slice(stored.strip_prefix(b"\xff\xd8").unwrap_or(stored));
        } else {
            whole.extend_from_slice(stored);
        }
        let mut reader = image::ImageReader::with_format(std::io::Cursor::new(whole), image::ImageFormat::Jpeg);
        let mut limits = image::Limits::default();
        limits.max_alloc = Some(16 * expected as u64 + (1 << 20));
        reader.limits(limits);
        let picture = reader.decode().map_err(|e| e.to_string())?;
        if picture.width() != self.chunk[0] {
            return Err(format!("{} pixels wide, the strip or tile is {}", picture.width(), self.chunk[0]));
        }
        Ok(match self.photometric {
            6 => picture.into_rgb8().into_raw(),
            _ => match picture {
                image::DynamicImage::ImageLuma8(v) if self.samples == 1 => v.into_raw(),
                _ => return Err("colours where brightness was expected".to_owned()),
            },
        })
    }

    fn fax(&self, stored: &[u8], rows: u32, out: &mut Vec<u8>) -> Result<(), String> {
        let width =
            u16::try_from(self.chunk[0]).map_err(|_| format!("{} pixels wide, at most 65535", self.chunk[0]))?;
        let bytes = usize::from(width).div_ceil(8);
        let mut line = |transitions: &[u16]| {
            let at = out.len();
            out.resize(at + bytes, 0);
            // Runs of white and black in turn; black is 1, as libtiff has it.
            for run in transitions.chunks(2).filter(|run| !run.is_empty()) {
                let (from, to) = (run[0].min(width), run.get(1).copied().unwrap_or(width).min(width));
                (from..to).for_each(|x| out[at + usize::from(x) / 8] |= 0x80 >> (x % 8));
            }
        };
        let bits = stored.iter().copied();
        let done = match self.compression {
            4 => fax::decoder::decode_g4(bits, width, u16::try_from(rows).ok(), &mut line),
            _ => fax::decoder::decode_g3(bits, &mut line),
        };
        done.ok_or_else(|| "the data are damaged".to_owned())
    }

    /// Sample `pick` of each pixel of a row.
    fn samples_of(&self, row: &[u8], wide: usize, samples: usize, pick: usize, big_endian: bool, out: &mut Vec<u8>) {
        let bits = self.bits as usize;
        let native = big_endian == cfg!(target_endian = "big");
        let size = self.dtype().size() as usize;
        if samples == 1 && bits == 8 * size && native {
            return out.extend_from_slice(&row[..wide * size]);
        }
        for x in 0..wide {
            let i = x * samples + pick;
            let v: u64 = if bits.is_multiple_of(8) {
                let bytes = &row[i * bits / 8..(i + 1) * bits / 8];
                let fold = |n: u64, &b: &u8| n << 8 | u64::from(b);
                if big_endian { bytes.iter().fold(0, fold) } else { bytes.iter().rev().fold(0, fold) }
            } else {
                // Most significant bit first, whatever the byte order.
                (i * bits..(i + 1) * bits).fold(0, |n, b| n << 1 | u64::from(row[b / 8] >> (7 - b % 8) & 1))
            };
            let v = match self.kind {
                Kind::Uint => v,
                Kind::Int => ((v << (64 - bits)) as i64 >> (64 - bits)) as u64,
                Kind::Float if bits == 16 => half(v as u16).to_bits().into(),
                Kind::Float if bits == 24 => f24(v as u32).to_bits().into(),
                Kind::Float => v,
            };
            match size {
                1 => out.push(v as u8),
                2 => out.extend_from_slice(&(v as u16).to_ne_bytes()),
                4 => out.extend_from_slice(&(v as u32).to_ne_bytes()),
                _ => out.extend_from_slice(&v.to_ne_bytes()),
            }
        }
    }
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

fn unzstd(stored: &[u8], expected: usize) -> std::io::Result<Vec<u8>> {
    let mut out = Vec::new();
    #[cfg(not(target_arch = "wasm32"))]
    zstd::Decoder::with_buffer(stored)?.take(expected as u64).read_to_end(&mut out)?;
    #[cfg(target_arch = "wasm32")]
    ruzstd::decoding::StreamingDecoder::new(stored)
        .map_err(|e| std::io::Error::other(e.to_string()))?
        .take(expected as u64)
        .read_to_end(&mut out)?;
    Ok(out)
}

fn pack_bits(mut stored: &[u8], expected: usize, out: &mut Vec<u8>) {
    while let (true, [n, rest @ ..]) = (out.len() < expected, stored) {
        stored = rest;
        match *n as i8 {
            n @ 0.. => {
                let (some, rest) = stored.split_at(stored.len().min(n as usize + 1));
                out.extend_from_slice(some);
                stored = rest;
            }
            -128 => {}
            n => {
                let Some((&value, rest)) = stored.split_first() else { return };
                out.extend(std::iter::repeat_n(value, (1 - isize::from(n)) as usize));
                stored = rest;
            }
        }
    }
}

/// Predictor 2: each sample is stored as what it is more than the one before.
fn accumulate(row: &mut [u8], bits: u32, samples: usize, big_endian: bool) {
    macro_rules! sums {
        ($t:ident) => {{
            const N: usize = size_of::<$t>();
            let (values, _) = row.as_chunks_mut::<N>();
            let read = |b: [u8; N]| if big_endian { $t::from_be_bytes(b) } else { $t::from_le_bytes(b) };
            for i in samples..values.len() {
                let v = read(values[i]).wrapping_add(read(values[i - samples]));
                values[i] = if big_endian { v.to_be_bytes() } else { v.to_le_bytes() };
            }
        }};
    }
    use std::mem::size_of;
    match bits {
        8 => sums!(u8),
        16 => sums!(u16),
        32 => sums!(u32),
        _ => sums!(u64),
    }
}

/// Predictor 3: differences of bytes, all first bytes of a row's floats before all second ones; back to big-endian floats.
fn unshuffle(row: &mut [u8], size: usize, samples: usize) -> Vec<u8> {
    for i in samples..row.len() {
        row[i] = row[i].wrapping_add(row[i - samples]);
    }
    let n = row.len() / size;
    (0..n * size).map(|i| row[i % size * n + i / size]).collect()
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
