//! NIfTI-1 and NIfTI-2 volumes, and ANALYZE 7.5, whose headers have the same shape: in one file, or a pair of header and
//! image, each of them plain or gzip. Of a series the first volume is read.
//!
//! Layouts: nifti1.h and nifti2.h (R. W. Cox and others, <https://nifti.nimh.nih.gov>). The place is the sform's, else the
//! qform's, as those headers have it.

use std::path::{Path, PathBuf};

use super::place::Place;
use super::volume::{Data, Facts, Stored, Volume, byte_len, gunzip, gunzip_prefix};
use super::{Dtype, ReadOptions, map};
use crate::model::about::{About, Kind};
use crate::{Error, Result};

/// Bytes of a NIfTI-2 header, the longer one.
pub(super) const HEADER: u64 = 540;

const HEADER_1: usize = 348;

/// Whether a file that begins so is one of these. An ANALYZE header has no mark: it is known by name.
pub(super) fn is_nifti(head: &[u8]) -> bool {
    matches!(head.get(344..348), Some(b"n+1\0" | b"ni1\0")) || matches!(head.get(4..8), Some(b"n+2\0" | b"ni2\0"))
}

/// Fields of a header, at the places of its version, in its byte order.
struct Header<'a> {
    bytes: &'a [u8],
    big_endian: bool,
    two: bool,
}

impl Header<'_> {
    fn take<const N: usize>(&self, at: usize) -> [u8; N] {
        let mut bytes: [u8; N] = self.bytes[at..at + N].try_into().expect("inside the header");
        if self.big_endian {
            bytes.reverse();
        }
        bytes
    }

    fn short(&self, at: usize) -> i64 {
        i16::from_le_bytes(self.take(at)).into()
    }

    /// A number that is short in version 1 and long in version 2.
    fn int(&self, [one, two]: [usize; 2]) -> i64 {
        if self.two { i32::from_le_bytes(self.take(two)).into() } else { self.short(one) }
    }

    fn real(&self, [one, two]: [usize; 2], i: usize) -> f64 {
        match self.two {
            true => f64::from_le_bytes(self.take(two + 8 * i)),
            false => f32::from_le_bytes(self.take(one + 4 * i)).into(),
        }
    }

    /// Number of axes, then their sizes.
    fn dim(&self, i: usize) -> i64 {
        if self.two { i64::from_le_bytes(self.take(16 + 8 * i)) } else { self.short(40 + 2 * i) }
    }

    fn sform(&self) -> Place {
        let row = |r: usize| [0, 1, 2, 3].map(|i| self.real([280 + 16 * r, 400 + 32 * r], i));
        let rows = [row(0), row(1), row(2)];
        Place {
            steps: [0, 1, 2].map(|f| rows.map(|row| row[f])),
            origin: rows.map(|row| row[3]),
            anatomy: true,
            stated: "sform",
        }
    }

    /// Turned by a quaternion of which the real part is left out.
    fn qform(&self) -> Place {
        let [b, c, d] = [0, 1, 2].map(|i| self.real([256, 352], i));
        let a = (1.0 - (b * b + c * c + d * d)).max(0.0).sqrt();
        let n = (a * a + b * b + c * c + d * d).sqrt();
        let [a, b, c, d] = [a, b, c, d].map(|v| v / n);
        let columns = [
            [a * a + b * b - c * c - d * d, 2.0 * (b * c + a * d), 2.0 * (b * d - a * c)],
            [2.0 * (b * c - a * d), a * a + c * c - b * b - d * d, 2.0 * (c * d + a * b)],
            [2.0 * (b * d + a * c), 2.0 * (c * d - a * b), a * a + d * d - b * b - c * c],
        ];
        let pixdim = |i| self.real([76, 104], i);
        let side = [pixdim(1), pixdim(2), pixdim(3) * if pixdim(0) < 0.0 { -1.0 } else { 1.0 }];
        Place {
            steps: [0, 1, 2].map(|f| columns[f].map(|v| v * side[f])),
            origin: [0, 1, 2].map(|i| self.real([268, 376], i)),
            anatomy: true,
            stated: "qform",
        }
    }
}

/// A volume of the file at `path`: one that holds all, or either of a pair.
pub(super) fn read<'a>(path: &Path, bytes: &'a [u8], opts: &ReadOptions) -> Result<Volume<'a>> {
    let ending = kind_of(path);
    if ending == "img" && !head_is_nifti(bytes) {
        let header = beside(path, "hdr")?;
        let head = head(&header, &map(&header)?)?;
        return volume(&header, &head, None, Some((path, bytes)), opts);
    }
    volume(path, &head(path, bytes)?, Some(bytes), None, opts)
}

/// The ending of a name, without that of gzip.
fn kind_of(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
    name.strip_suffix(".gz").unwrap_or(&name).rsplit('.').next().unwrap_or_default().to_owned()
}

fn head_is_nifti(bytes: &[u8]) -> bool {
    match bytes.starts_with(b"\x1f\x8b") {
        true => gunzip_prefix(Path::new(""), bytes, HEADER).is_ok_and(|head| is_nifti(&head)),
        false => is_nifti(bytes),
    }
}

/// The other file of a pair.
fn beside(path: &Path, ending: &str) -> Result<PathBuf> {
    let plain = if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("gz")) {
        path.with_extension("")
    } else {
        path.to_owned()
    };
    let upper = ending.to_uppercase();
    let names = [ending.to_owned(), format!("{ending}.gz"), upper.clone(), format!("{upper}.GZ")]
        .map(|e| plain.with_extension(e));
    match names.iter().find(|name| name.is_file()) {
        Some(name) => Ok(name.clone()),
        None => {
            // As it would be named.
            let e = std::io::Error::from(std::io::ErrorKind::NotFound);
            Err(Error::io(names[0].clone(), "open", e))
        }
    }
}

/// The bytes of a header, unpacked.
fn head(path: &Path, bytes: &[u8]) -> Result<Vec<u8>> {
    match bytes.starts_with(b"\x1f\x8b") {
        true => gunzip_prefix(path, bytes, HEADER),
        false => Ok(bytes[..bytes.len().min(HEADER as usize)].to_vec()),
    }
}

/// The volume of a header of the file at `path`: its values follow in the same file's bytes, `whole`, or are an image's.
fn volume<'a>(
    path: &Path,
    head: &[u8],
    whole: Option<&'a [u8]>,
    image: Option<(&Path, &'a [u8])>,
    opts: &ReadOptions,
) -> Result<Volume<'a>> {
    let fail = |what: String| Err(Error::format(path, what));
    let size = |big: bool| head.first_chunk().map(|&b| if big { i32::from_be_bytes(b) } else { i32::from_le_bytes(b) });
    let (two, big_endian) = match (size(false), size(true)) {
        (Some(348), _) => (false, false),
        (Some(540), _) => (true, false),
        (_, Some(348)) => (false, true),
        (_, Some(540)) => (true, true),
        _ => return fail("byte 0: NIfTI header: expected its size, 348 or 540".to_owned()),
    };
    let len = if two { HEADER as usize } else { HEADER_1 };
    if head.len() < len {
        return fail(format!("{} bytes; a NIfTI header has {len}", head.len()));
    }
    let h = Header { bytes: head, big_endian, two };
    let (single, format) = match (two, if two { &head[4..8] } else { &head[344..348] }) {
        (false, b"n+1\0") => (true, "NIfTI-1"),
        (false, b"ni1\0") => (false, "NIfTI-1"),
        (true, b"n+2\0") => (true, "NIfTI-2"),
        (true, b"ni2\0") => (false, "NIfTI-2"),
        (false, _) if kind_of(path) == "hdr" => (false, "ANALYZE 7.5"),
        (_, magic) => {
            let at = if two { 4 } else { 344 };
            return fail(format!(
                "byte {at}: NIfTI header: the magic is {:?}; expected \"n+1\" or \"ni1\" (2 in version 2)",
                String::from_utf8_lossy(magic)
            ));
        }
    };
    let analyze = format == "ANALYZE 7.5";

    let dim_at = if two { 16 } else { 40 };
    let rank = h.dim(0);
    if !(1..=7).contains(&rank) {
        return fail(format!("byte {dim_at}: {rank} axes; expected 1 to 7"));
    }
    let rank = rank as usize;
    let sizes: Vec<i64> = (1..=rank).map(|i| h.dim(i)).collect();
    // ANALYZE files leave sizes of axes that they do not use at 0.
    if sizes.iter().enumerate().any(|(i, &n)| n < 1 && !(analyze && i > 2 && n == 0)) {
        return fail(format!(
            "byte {}: axis sizes {sizes:?}; expected at least 1 each",
            dim_at + if two { 8 } else { 2 }
        ));
    }
    let axis = |i: usize| sizes.get(i - 1).map_or(1, |&n| n.max(1) as u64);
    let dims = [axis(1), axis(2), axis(3)];
    let datatype = if two { h.short(12) } else { h.short(70) };
    let dtype = match datatype {
        2 => Dtype::U8,
        256 => Dtype::I8,
        512 => Dtype::U16,
        4 => Dtype::I16,
        768 => Dtype::U32,
        8 => Dtype::I32,
        1280 => Dtype::U64,
        1024 => Dtype::I64,
        16 => Dtype::F32,
        64 => Dtype::F64,
        other => {
            let name = match other {
                1 => "single bits",
                32 | 1792 | 2048 => "complex numbers",
                128 => "RGB colours",
                2304 => "RGBA colours",
                1536 => "floats of 128 bits",
                _ => "unknown",
            };
            return fail(format!(
                "byte {}: values of NIfTI type {other} ({name}); expected integers, f32 or f64: save one value a voxel",
                if two { 12 } else { 70 }
            ));
        }
    };

    let at = if two { i64::from_le_bytes(h.take(168)) as f64 } else { f64::from(f32::from_le_bytes(h.take(108))) };
    let offset_at = if two { 168 } else { 108 };
    if single && !(len as f64..1e15).contains(&at) || !single && !(0.0..1e15).contains(&at) {
        return fail(format!("byte {offset_at}: values start at byte {at}; expected {} or later", len + 4));
    }
    let start = at as u64;
    let expected = byte_len(path, dims, dtype)?;
    let end = start
        .checked_add(expected)
        .ok_or_else(|| Error::format(path, format!("byte {offset_at}: values start at byte {at}")))?;
    let short = |got: u64| {
        let [x, y, z] = dims;
        Error::format(path, format!("{got} bytes; {x} × {y} × {z} values from byte {start} on expect {end}"))
    };
    let part = |bytes: &'a [u8]| {
        bytes.get(start as usize..).and_then(|v| v.get(..expected as usize)).ok_or_else(|| short(bytes.len() as u64))
    };
    let of = |path: &Path, bytes: &'a [u8]| -> Result<Data<'a>> {
        if bytes.starts_with(b"\x1f\x8b") {
            gunzip(path, bytes, start, end)?.map_err(short)
        } else {
            part(bytes).map(Data::Slice)
        }
    };
    let data = match (single, whole, image) {
        (true, Some(whole), _) => of(path, whole)?,
        (true, None, _) => {
            return fail(
                "byte 344: NIfTI header: its values follow it, but an image beside it was named; name the header"
                    .to_owned(),
            );
        }
        (false, _, Some((path, bytes))) => of(path, bytes)?,
        (false, _, None) => {
            let pair = beside(path, "img")?;
            let whole = map(&pair)?;
            if whole.starts_with(b"\x1f\x8b") {
                gunzip(&pair, &whole, start, end)?.map_err(short)?
            } else {
                let values = whole.get(start as usize..).and_then(|v| v.get(..expected as usize));
                Data::Slice(values.ok_or_else(|| short(whole.len() as u64))?).in_file(&pair, &whole)?
            }
        }
    };

    let mut about = About::new(Kind::Volume, format.to_owned());
    let mut facts = Facts { measured: true, ..Facts::default() };
    let volumes = (4..=rank).map(axis).fold(1u64, u64::saturating_mul);
    if volumes > 1 {
        let what = if axis(4) == 1 { "values a voxel" } else { "volumes" };
        about.left_out.push(format!("{} of {volumes} {what}: the first is read", volumes - 1));
    }
    let mut scale = None;
    if !analyze {
        let (slope, inter) = (h.real([112, 176], 0), h.real([116, 184], 0));
        scale = (slope != 0.0 && slope.is_finite() && inter.is_finite())
            .then_some((slope, inter))
            .filter(|&s| s != (1.0, 0.0));
        facts.labels = h.int([68, 504]) == 1002;
        let units = if two { i32::from_le_bytes(h.take(500)) } else { i32::from(head[123]) };
        about.unit = ["", "m", "mm", "µm"].get((units & 7) as usize).copied().unwrap_or_default().to_owned();
    }
    let spacing = || Place::spaced([1, 2, 3].map(|i| h.real([76, 104], i).abs()), [0.0; 3]);
    let (sform, qform) = if analyze { (0, 0) } else { (h.int([254, 348]), h.int([252, 344])) };
    let place = if sform > 0 {
        h.sform()
    } else if qform > 0 {
        h.qform()
    } else {
        spacing()
    };
    // Sides that nobody filled in are no spacing.
    let unknown = sform <= 0 && (1..=3).all(|i| h.real([76, 104], i) == 0.0);
    match place.checked() {
        Ok(place) => facts.place = Some(place),
        Err(_) if unknown => {}
        Err(what) => about.left_out.push(what),
    }
    let mut notes = Vec::new();
    if let Some((slope, inter)) = scale {
        notes.push(format!("values are stored · {slope} + {inter}"));
    }
    if sform <= 0 && qform <= 0 {
        notes.push(
            "the file says nothing of a patient's right, front and head (--up z stands on the third axis)".to_owned(),
        );
    }
    let stored = Stored { big_endian, scale, notes, about, ..Stored::new(dims, dtype, data) };
    Volume::with(path, stored, facts, opts)
}
