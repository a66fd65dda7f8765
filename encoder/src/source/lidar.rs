//! LAS, LAZ and COPC: laser scans, with classes, flags, and a coordinate reference system.
//!
//! COPC is LAZ 1.4 whose chunks are the nodes of an octree, all of which are read. Points marked as withheld, and those of the
//! classes noise (7) and high noise (18), are left out with a word; `--las-classes` takes classes by number, and noise too
//! where it is named. z is up unless `--up` says otherwise. Units are the file's; heights in another unit than the map's are
//! made one with it, and degrees become metres. Source: ASPRS LAS 1.4 R15, COPC 1.0.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fs::OpenOptions;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use super::geo::{Crs, Model};
use super::points::{Cloud, Has, Point, Points, Spacing};
use super::{ReadOptions, Up, guarded};
use crate::model::about::Kind;
use crate::{About, Error, Result};

/// Bytes of points that are read together: a record may claim 64 KiB.
const AT_ONCE: u64 = 4 << 20;
const NOISE: [u8; 2] = [7, 18];
const SYNTHETIC: u8 = 1;
const WITHHELD: u8 = 4;
const OVERLAP: u8 = 8;

/// What a pass over the points met beside those it kept.
#[derive(Default)]
struct Met {
    withheld: u64,
    synthetic: u64,
    overlap: u64,
    noise: u64,
    /// All classes of points that are not withheld.
    classes: BTreeMap<u8, u64>,
    unwanted: u64,
}

pub(super) fn read(path: &Path, opts: &ReadOptions) -> Result<Points> {
    guarded(path, "LAS", || {
        let fail = |e: las::Error| Error::format(path, format!("LAS: {e}"));
        check_extended(path)?;
        let open = || las::Reader::from_path(path).map_err(fail);
        let reader = open()?;
        let header = reader.header().clone();
        let (n, format) = (header.number_of_points(), *header.point_format());
        // What the header claims, against the file before memory is asked for.
        let record = u64::from(format.len());
        let file_len = std::fs::metadata(path).map_or(0, |m| m.len());
        if !format.is_compressed && n.checked_mul(record).is_none_or(|len| len > file_len) {
            let claim = format!("{n} points of {record} bytes in a file of {file_len}");
            return Err(Error::format(path, format!("byte 105: LAS: {claim}; it was cut short or is damaged")));
        }
        if n == 0 {
            return Err(Error::format(
                path,
                "LAS: its header counts 0 points; a program that stopped may not have written it",
            ));
        }
        let at_once = (AT_ONCE / record.max(1)).clamp(1, 1 << 16);
        let met = RefCell::new(Met::default());
        let waiting = RefCell::new(Some(reader));
        let each = |then: &mut dyn FnMut(Point) -> Result<()>| -> Result<()> {
            met.take();
            let met = &mut *met.borrow_mut();
            let mut reader = waiting.take().map_or_else(open, Ok)?;
            loop {
                let some = reader.read_points(at_once).map_err(fail)?;
                if some.is_empty() {
                    return Ok(());
                }
                let mut colors = some.rgb();
                let places = some.x().zip(some.y()).zip(some.z());
                let looks = some.raw_bytes().chunks_exact(some.record_len());
                for (((x, y), z), record) in places.zip(looks) {
                    let color = colors.as_mut().and_then(Iterator::next).map_or([0; 3], |(r, g, b)| [r, g, b]);
                    let (flags, class) = flags_and_class(format.is_extended, record);
                    if flags & WITHHELD != 0 {
                        met.withheld += 1;
                        continue;
                    }
                    *met.classes.entry(class).or_default() += 1;
                    match &opts.las_classes {
                        Some(wanted) if !wanted.has(class) => met.unwanted += 1,
                        None if NOISE.contains(&class) => met.noise += 1,
                        _ => {
                            met.synthetic += u64::from(flags & SYNTHETIC != 0);
                            met.overlap += u64::from(flags & OVERLAP != 0);
                            let intensity = u16::from_le_bytes([record[12], record[13]]);
                            then(Point { at: [x, y, z], color, intensity, class })?;
                        }
                    }
                }
            }
        };

        let crs = crs(&header);
        let bounds = header.bounds();
        let ends = [bounds.min, bounds.max].map(|v| [v.x, v.y, v.z]);
        let (metres, unit) = metres(&crs, ends, &each)?;
        let version = header.version();
        let is_copc = header.all_vlrs().any(|v| v.user_id == "copc" && v.record_id == 1);
        let name = match (is_copc, format.is_compressed) {
            (true, _) => "COPC",
            (_, true) => "LAZ",
            _ => "LAS",
        };
        let about = About {
            unit,
            crs: crs.name.clone(),
            ..About::new(Kind::Points, format!("{name} {}.{}", version.major, version.minor))
        };
        let t = header.transforms();
        let cloud = Cloud {
            about,
            has: Has { rgb: format.has_color, class: true, intensity: true },
            claimed: Some((ends, n)),
            quantum: [t.x.scale, t.y.scale, t.z.scale].map(f64::abs),
            metres,
            spacing: Spacing::Mean,
        };
        let made = Points::new(path, opts, opts.up.unwrap_or(Up::Z), cloud, &each);
        let met = met.take();
        let there = || {
            let list: Vec<String> = met.classes.iter().map(|(class, n)| format!("{class} ({n} points)")).collect();
            if list.is_empty() { "none".to_owned() } else { list.join(", ") }
        };
        let kept = met.classes.values().sum::<u64>() - met.unwanted - met.noise;
        if kept == 0 && (met.unwanted + met.noise + met.withheld) > 0 {
            let wanted =
                opts.las_classes.as_ref().map_or("without noise".to_owned(), |c| format!("of --las-classes {c}"));
            let what =
                format!("LAS: no points {wanted}; {} are withheld, classes of the others: {}", met.withheld, there());
            return Err(Error::format(path, what));
        }
        let mut points = made?;
        let left_out = [
            (met.withheld, "withheld points".to_owned()),
            (met.noise, "points of noise (classes 7 and 18)".to_owned()),
            (
                met.unwanted,
                format!(
                    "points of classes other than {}",
                    opts.las_classes.as_ref().map_or(String::new(), |c| c.to_string())
                ),
            ),
        ];
        points.about.left_out.extend(left_out.iter().filter(|(n, _)| *n > 0).map(|(n, what)| format!("{n} {what}")));
        for (n, what) in [(met.synthetic, "synthetic"), (met.overlap, "of overlapping swaths")] {
            if n > 0 {
                points.about.rule += &format!("; {n} points are {what}, and kept");
            }
        }
        points.input_bytes = file_len;
        Ok(points)
    })
}

/// Flags, as formats from 6 on have them, and class of a record.
fn flags_and_class(extended: bool, record: &[u8]) -> (u8, u8) {
    if extended {
        return (record[15], record[16]);
    }
    let class = record[15] & 31;
    // Class 12 was that of overlapping swaths, before it became a flag.
    (record[15] >> 5 | if class == 12 { OVERLAP } else { 0 }, class)
}

/// The reference system, as text or as keys of GeoTIFF; the text where both are there and the header points to it.
fn crs(header: &las::Header) -> Crs {
    let record =
        |id: u16| header.all_vlrs().find(|v| v.user_id == "LASF_Projection" && v.record_id == id).map(|v| &v.data[..]);
    let text = record(2112).map(|data| String::from_utf8_lossy(data.split(|&b| b == 0).next().unwrap_or_default()));
    let of_text = || text.as_ref().and_then(|text| Crs::of_wkt(text));
    let of_keys = || {
        let directory: Vec<u16> = record(34_735)?.as_chunks().0.iter().map(|b| u16::from_le_bytes(*b)).collect();
        let doubles: Vec<f64> =
            record(34_736).unwrap_or_default().as_chunks().0.iter().map(|b| f64::from_le_bytes(*b)).collect();
        (directory.len() > 4).then(|| Crs::of_keys(&directory, &doubles, record(34_737).unwrap_or_default()))
    };
    let found = if header.has_wkt_crs() { of_text().or_else(of_keys) } else { of_keys().or_else(of_text) };
    found.unwrap_or_default()
}

/// Units of the world in one of the file, on each axis, and the world's unit.
fn metres(
    crs: &Crs,
    ends: [[f64; 3]; 2],
    each: &impl Fn(&mut dyn FnMut(Point) -> Result<()>) -> Result<()>,
) -> Result<([f64; 3], String)> {
    let sign = if crs.down { -1.0 } else { 1.0 };
    let up = crs.up.as_ref().map(|unit| unit.metres);
    let middle = |[low, high]: [[f64; 3]; 2]| [0, 1].map(|a| low[a] + (high[a] - low[a]) / 2.0);
    let plain = crs.model == Model::Projected && crs.metres_at(middle(ends)) == Some([crs.unit; 2]);
    if plain {
        return Ok(([1.0, 1.0, sign * up.map_or(1.0, |up| up / crs.unit)], crs.unit_name.clone()));
    }
    if matches!(crs.model, Model::Unknown | Model::Geocentric) {
        return Ok(([1.0; 3], crs.unit_name.clone()));
    }
    // It depends on where the points lie, which is not taken from the header.
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    each(&mut |p| {
        low = [0, 1, 2].map(|a| low[a].min(p.at[a]));
        high = [0, 1, 2].map(|a| high[a].max(p.at[a]));
        Ok(())
    })?;
    Ok(match crs.metres_at(middle([low, high])) {
        Some([x, y]) => ([x, y, sign * up.unwrap_or(1.0)], "m".to_owned()),
        None => ([1.0; 3], crs.unit_name.clone()),
    })
}

/// Checks that the extended records of a LAS 1.4 file lie within it: their lengths are 64 bits, and the reader takes
/// memory for what they claim.
fn check_extended(path: &Path) -> Result<()> {
    let failed = |e| Error::io(path, "read", e);
    let mut file = OpenOptions::new().read(true).open(path).map_err(|e| Error::io(path, "open", e))?;
    let file_len = file.metadata().map_err(failed)?.len();
    let mut head = Vec::new();
    Read::by_ref(&mut file).take(247).read_to_end(&mut head).map_err(failed)?;
    // Shorter headers and older versions have none.
    if head.len() < 247 || head[25] < 4 {
        return Ok(());
    }
    let mut at = u64::from_le_bytes(head[235..243].try_into().expect("eight bytes"));
    let n = u32::from_le_bytes(head[243..247].try_into().expect("four bytes"));
    for i in 0..if at == 0 { 0 } else { n } {
        let wrong = |what: String| Error::format(path, format!("byte {at}: LAS: extended record {i} of {n} {what}"));
        let content = at.checked_add(60).filter(|&end| end <= file_len);
        let content = content.ok_or_else(|| wrong("is not in the file; it was cut short or is damaged".into()))?;
        let mut record = [0; 60];
        file.seek(SeekFrom::Start(at)).and_then(|_| file.read_exact(&mut record)).map_err(failed)?;
        let len = u64::from_le_bytes(record[20..28].try_into().expect("eight bytes"));
        let end = content.checked_add(len).filter(|&end| end <= file_len);
        let left = file_len - content;
        at = end.ok_or_else(|| wrong(format!("claims {len} bytes of the {left} that are left; it is damaged")))?;
    }
    Ok(())
}
