//! MRC and CCP4 maps of density (`.mrc`, `.map`, `.ccp4`), plain or gzip.
//!
//! The format's text is <https://www.ccpem.ac.uk/mrc_format/mrc2014.php> (A. Cheng and others, "MRC2014", 2015). The axes
//! x, y, z are those of the crystal, whatever their order in the file.

use std::path::Path;

use super::place::Place;
use super::values::Unpacked;
use super::volume::{Data, Facts, Stored, Volume, byte_len, gunzip, gunzip_prefix};
use super::{Dtype, ReadOptions};
use crate::model::about::{About, Kind};
use crate::{Error, Result};

const HEADER: usize = 1024;

/// Whether a file that begins so is one of these.
pub(super) fn is_mrc(head: &[u8]) -> bool {
    head.get(208..212) == Some(b"MAP ")
}

pub(super) fn read<'a>(path: &Path, bytes: &'a [u8], opts: &ReadOptions) -> Result<Volume<'a>> {
    let fail = |at: usize, what: String| Err(Error::format(path, format!("byte {at}: {what}")));
    let gz = bytes.starts_with(b"\x1f\x8b");
    let head = if gz { gunzip_prefix(path, bytes, HEADER as u64)? } else { bytes[..bytes.len().min(HEADER)].to_vec() };
    if head.len() < HEADER {
        return fail(head.len(), format!("the file ends inside the MRC header of {HEADER} bytes"));
    }
    let word = |at: usize| -> [u8; 4] { head[at..at + 4].try_into().expect("inside the header") };
    // A stamp of the machine; files that are older than stamps have a mode that is small in their own order.
    let big_endian = match (head[212], head[213]) {
        (0x44, 0x41 | 0x44) => false,
        (0x11, 0x11) => true,
        _ => !(0..=255).contains(&i32::from_le_bytes(word(12))),
    };
    let int = |at: usize| if big_endian { i32::from_be_bytes(word(at)) } else { i32::from_le_bytes(word(at)) };
    let real = |at: usize| f64::from(f32::from_bits(int(at) as u32));
    let sizes = [int(0), int(4), int(8)];
    if sizes.iter().any(|&n| n < 1) {
        return fail(0, format!("MRC sizes {sizes:?}; expected at least 1 each"));
    }
    let mut about = About::new(Kind::Volume, "MRC map".to_owned());
    let mut facts = Facts { measured: true, density: true, ..Facts::default() };
    let mut dims = sizes.map(|n| n as u64);
    let mode = int(12);
    // IMOD's own mark says whether its bytes have a sign; others' have.
    let unsigned = int(152) == 1_146_047_817 && int(156) & 1 == 0;
    let (dtype, half) = match mode {
        0 if unsigned => (Dtype::U8, false),
        0 => (Dtype::I8, false),
        1 => (Dtype::I16, false),
        2 => (Dtype::F32, false),
        6 => (Dtype::U16, false),
        12 => (Dtype::F32, true),
        3 | 4 => return fail(12, format!("MRC mode {mode}: complex numbers (a transform); save the map itself")),
        101 => {
            return fail(12, "MRC mode 101: values of 4 bits; save it as mode 0 (IMOD: newstack -mode 0)".to_owned());
        }
        _ => return fail(12, format!("MRC mode {mode}; expected 0, 1, 2, 6 or 12")),
    };
    let mut series = 1;
    let (space_group, mz) = (int(88), int(36));
    if space_group >= 401 && mz > 0 && sizes[2] % mz == 0 && sizes[2] > mz {
        series = sizes[2] / mz;
        dims[2] = mz as u64;
    }
    let extended = int(92);
    if extended < 0 {
        return fail(92, format!("an extended header of {extended} bytes"));
    }
    let start = (HEADER + extended as usize) as u64;
    let width = if half { 2 } else { dtype.size() };
    let expected = byte_len(path, dims, dtype)? / dtype.size() * width;
    let [x, y, z] = dims;
    let end = start + expected;
    let short = |got: u64| {
        Error::format(
            path,
            format!("{got} bytes; {x} × {y} × {z} values of MRC mode {mode} from byte {start} on expect {end}"),
        )
    };
    let data = if gz {
        gunzip(path, bytes, start, end)?.map_err(short)?
    } else {
        let values = bytes.get(start as usize..).and_then(|v| v.get(..expected as usize));
        Data::Slice(values.ok_or_else(|| short(bytes.len() as u64))?)
    };
    let (data, big_endian) = if half { (of_halves(path, &data, big_endian)?, false) } else { (data, big_endian) };

    // Axis of the crystal that the file's columns, rows and sections are; zeros mean 1, 2, 3.
    let map = [int(64), int(68), int(72)];
    let mut sorted = map;
    sorted.sort_unstable();
    let axis = match sorted {
        [1, 2, 3] => map.map(|m| m as usize - 1),
        [0, 0, 0] => [0, 1, 2],
        _ => return fail(64, format!("axes {map:?} (MAPC, MAPR, MAPS); expected 1, 2 and 3 in any order")),
    };
    facts.order = Some([0, 1, 2].map(|c| (0..3).find(|&f| axis[f] == c).expect("each is there")));
    let intervals = [int(28), int(32), int(36)];
    let cell = [real(40), real(44), real(48)];
    let side = [0, 1, 2].map(|c| cell[c] / f64::from(intervals[c]));
    if intervals.iter().all(|&n| n > 0) && cell.iter().any(|&c| c != 0.0) {
        let first = [int(16), int(20), int(24)];
        let mut steps = [[0.0; 3]; 3];
        let mut origin = [real(196), real(200), real(204)].map(|v| if v.is_finite() { v } else { 0.0 });
        for f in 0..3 {
            let c = axis[f];
            steps[f][c] = side[c];
            origin[c] += f64::from(first[f]) * side[c];
        }
        match (Place { steps, origin, anatomy: false, stated: "MAPC, MAPR, MAPS" }).checked() {
            Ok(place) => {
                about.unit = "Å".to_owned();
                facts.place = Some(place);
            }
            Err(what) => about.left_out.push(what),
        }
    }
    if facts.place.is_none() {
        // The order of axes counts all the same.
        let mut steps = [[0.0; 3]; 3];
        (0..3).for_each(|f| steps[f][axis[f]] = 1.0);
        facts.place = Some(Place { steps, origin: [0.0; 3], anatomy: false, stated: "MAPC, MAPR, MAPS" });
    }
    let angles = [real(52), real(56), real(60)];
    if angles.iter().any(|&a| a != 0.0 && (a - 90.0).abs() > 0.01) {
        about.left_out.push(format!(
            "angles of the cell, {}°, {}°, {}°: it is drawn with right ones",
            angles[0], angles[1], angles[2]
        ));
    }
    if series > 1 {
        about.left_out.push(format!("{} of {series} volumes: the first is read", series - 1));
    }
    if space_group == 0 && z > 1 {
        about.left_out.push("that the header calls it a stack of images, not a volume".to_owned());
    }
    let stored = Stored { big_endian, about, ..Stored::new(dims, dtype, data) };
    Volume::with(path, stored, facts, opts)
}

/// Floats of 16 bits as floats of 32, little-endian.
fn of_halves(path: &Path, data: &Data, big_endian: bool) -> Result<Data<'static>> {
    let mut out = Unpacked::new()?;
    let (mut buffer, mut wide) = (Vec::new(), Vec::new());
    let mut at = 0;
    while at < data.len() {
        let len = (data.len() - at).min(1 << 20);
        wide.clear();
        for &pair in data.read(at, len as usize, &mut buffer)?.as_chunks::<2>().0 {
            let half = if big_endian { half::f16::from_be_bytes(pair) } else { half::f16::from_le_bytes(pair) };
            wide.extend_from_slice(&half.to_f32().to_le_bytes());
        }
        out.put(&wide)?;
        at += len;
    }
    out.finish(path)
}
