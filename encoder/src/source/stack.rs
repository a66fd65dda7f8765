//! Slices as volumes: the pages of a TIFF file, or the TIFF, PNG or JPEG files of a folder, the first being z = 0.
//!
//! Of pages, what they are is taken from what the file says: OME-XML, ImageJ's text, the shape that tifffile writes, axes of
//! SCIFIO, LSM's and MetaMorph's numbers; else pages like the first are slices. Of channels and times the first is read.
//! Values are those stored: a PhotometricInterpretation or a colour table says how to show them (as ImageJ, tifffile and
//! scifio have it). Pages go to a file without a name, one after the other, so that the stack need not fit into memory; those
//! that lie in one piece are read where they are.

use std::collections::BTreeMap;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use super::heightmap::plausible;
use super::place::in_one_unit;
use super::tiff::{Image, Page, Tiff, luma, tags};
use super::volume::{Data, Stored, Volume};
use super::{Dtype, ReadOptions, guarded, map, world_dims};
use crate::model::about::Kind;
use crate::store::scratch::{self as file, File};
use crate::{About, Error, Result};

/// Where a slice is.
#[derive(Clone, Debug, PartialEq)]
struct Slice {
    /// Another file than the one that names it.
    file: Option<String>,
    page: usize,
    /// Slices after the page's own, in one piece with it.
    plane: u64,
}

/// Which parts of a TIFF are the slices.
#[derive(Debug, Default)]
struct Plan {
    slices: Vec<Slice>,
    /// Slices of all channels and times.
    planes: u64,
    format: &'static str,
    /// Sides of a voxel along x, y, z.
    voxel: Option<[f64; 3]>,
    unit: String,
    scale: Option<(f64, f64)>,
    rule: String,
    left_out: Vec<String>,
}

/// Axes beside x and y, the fastest first.
type Axes = Vec<(char, u64)>;

impl Plan {
    /// Slices along 'Z', at the first place of every other axis.
    fn along_z(format: &'static str, axes: &Axes, slice: impl Fn(u64) -> Slice) -> Plan {
        let mut plan = Plan { format, ..Plan::default() };
        let (mut stride, mut step, mut n) = (1u64, 1, 1);
        for &(name, size) in axes {
            if name == 'Z' {
                (step, n) = (stride, size);
            } else if size > 1 {
                let name = match name {
                    'C' => "channels",
                    'T' => "times",
                    'R' => "resolutions",
                    _ => "places of a further axis",
                };
                plan.left_out.push(format!("{} of {size} {name}: the first is read", size - 1));
            }
            stride = stride.saturating_mul(size);
        }
        plan.slices = (0..n).map(|z| slice(z * step)).collect();
        plan.planes = stride;
        plan
    }
}

fn page(page: u64) -> Slice {
    Slice { file: None, page: page as usize, plane: 0 }
}

/// The slices of one TIFF; `in_file` says that the file at `path` holds these bytes.
pub(super) fn read<'a>(path: &Path, bytes: &'a [u8], in_file: bool, opts: &ReadOptions) -> Result<Volume<'a>> {
    guarded(path, "TIFF", || {
        let tiff = Tiff::open(path, bytes, in_file)?;
        let plan = plan(path, &tiff)?;
        volume(path, &tiff, plan, opts)
    })
}

/// Whether a TIFF without a place on Earth has several slices, channels or times.
pub(super) fn is_stack(path: &Path, bytes: &[u8]) -> bool {
    let several = || {
        let tiff = Tiff::open(path, bytes, false)?;
        let placed = tiff.pages.iter().any(Page::is_placed);
        let plan = plan(path, &tiff)?;
        Ok(!placed && (plan.slices.len() > 1 || plan.planes > 1))
    };
    guarded(path, "TIFF", several).unwrap_or(false)
}

/// What is known of the slices before they are read.
fn plan(path: &Path, tiff: &Tiff) -> Result<Plan> {
    let Some(main) = tiff.pages.iter().position(|ifd| !tiff.is_extra(ifd)) else {
        return Err(Error::format(path, "every page is a smaller copy or a mask; a stack has one page at least"));
    };
    let first = &tiff.pages[main];
    let text = tiff.text(first, tags::DESCRIPTION)?.unwrap_or_default();
    let mut plan = if text.trim_end().ends_with("OME>") || text.contains("<OME ") || text.contains(":OME ") {
        ome(path, tiff, &text)?
    } else if text.starts_with("ImageJ=") {
        imagej(path, tiff, main, &text)?
    } else if let Some(plan) = shaped(path, tiff, main, &text)? {
        plan
    } else if let Some(axes) = scifio(&text).or_else(|| lsm_axes(tiff, first)) {
        counted(path, tiff, main, if text.starts_with("SCIFIO") { "SCIFIO TIFF" } else { "LSM" }, &axes)?
    } else if let Some(n) = metamorph(tiff, first) {
        let mut plan = in_one_piece(path, tiff, main, "MetaMorph stack", &vec![('Z', n)], n)?;
        plan.left_out.extend(further(tiff, main + 1));
        plan
    } else {
        generic(tiff, main)
    };
    if plan.voxel.is_none()
        && let Some(info) = tiff.bytes_of(first, tags::CZ_LSM_INFO)?
    {
        plan.voxel = lsm_voxel(tiff, info);
        "µm".clone_into(&mut plan.unit);
    }
    gdal_scale(tiff, first, &mut plan)?;
    if plan.slices.is_empty() {
        return Err(Error::format(path, "the file names no slices; a stack has one at least"));
    }
    Ok(plan)
}

/// A phrase about directories from `from` on that are no slices.
fn further(tiff: &Tiff, from: usize) -> Option<String> {
    let n = tiff.pages.get(from..)?.len();
    let kind = match tiff.pages[from..].iter().all(|ifd| tiff.is_extra(ifd)) {
        true => "smaller copies or masks",
        false => "further pages",
    };
    (n > 0).then(|| format!("{n} {kind}"))
}

/// Pages in file order, of which so many belong to these axes; the others are said.
fn counted(path: &Path, tiff: &Tiff, main: usize, format: &'static str, axes: &Axes) -> Result<Plan> {
    let own: Vec<usize> = (0..tiff.pages.len()).filter(|&i| !tiff.is_extra(&tiff.pages[i])).collect();
    let n = axes.iter().try_fold(1u64, |n, a| n.checked_mul(a.1)).unwrap_or(u64::MAX);
    if n > own.len() as u64 {
        if own.len() == 1 {
            return in_one_piece(path, tiff, main, format, axes, n);
        }
        let what = format!(
            "{format}: {n} pages by its description, the file has {}; it is cut short, or was edited",
            own.len()
        );
        return Err(Error::format(path, what));
    }
    let mut plan = Plan::along_z(format, axes, |i| page(own[i as usize] as u64));
    let more = own.len() as u64 - n;
    let extra = tiff.pages.len() - own.len();
    plan.left_out.extend((more > 0).then(|| format!("{more} further pages")));
    plan.left_out.extend((extra > 0).then(|| format!("{extra} smaller copies or masks")));
    Ok(plan)
}

/// Slices of which the first alone has a directory: the others follow it.
fn in_one_piece(path: &Path, tiff: &Tiff, main: usize, format: &'static str, axes: &Axes, n: u64) -> Result<Plan> {
    let ifd = &tiff.pages[main];
    let of = layout(tiff, ifd)?;
    let Some(start) = of.contiguous() else {
        let what = format!("{format} of {n} slices with one directory, which are compressed or in pieces");
        return Err(Error::format(path, format!("directory at byte {}: {what}; save it as pages", ifd.at)));
    };
    let end = of.byte_len().checked_mul(n).and_then(|len| len.checked_add(start));
    if end.is_none_or(|end| end > tiff.all.len() as u64) {
        let whole = (tiff.all.len() as u64).saturating_sub(start) / of.byte_len();
        let what = format!("{format}: {n} slices from byte {start} on, the file ends after {whole}");
        return Err(Error::format(path, what));
    }
    Ok(Plan::along_z(format, axes, |plane| Slice { file: None, page: main, plane }))
}

/// Pages like the first.
fn generic(tiff: &Tiff, main: usize) -> Plan {
    let mut plan = Plan { format: "TIFF", ..Plan::default() };
    let (mut extra, mut unlike) = (0, Vec::new());
    let like = |ifd: &Page| {
        let int = |t| tiff.hint(ifd, t);
        (
            int(tags::WIDTH),
            int(tags::HEIGHT),
            int(tags::BITS),
            int(tags::SAMPLE_FORMAT).unwrap_or(1),
            int(tags::SAMPLES).unwrap_or(1),
        )
    };
    for (i, ifd) in tiff.pages.iter().enumerate() {
        let size = |t| tiff.hint(ifd, t).unwrap_or(0);
        if tiff.is_extra(ifd) {
            extra += 1;
        } else if like(ifd) != like(&tiff.pages[main]) {
            unlike.push(format!("{} × {} of {} bits", size(tags::WIDTH), size(tags::HEIGHT), size(tags::BITS)));
        } else {
            plan.slices.push(page(i as u64));
        }
    }
    if extra > 0 {
        plan.left_out.push(format!("{extra} smaller copies or masks"));
    }
    if let Some(size) = unlike.first() {
        plan.left_out.push(format!("{} pages unlike the first ({size})", unlike.len()));
    }
    let n = tiff.pages[main].count(tags::SUB_IFDS);
    if n > 0 {
        plan.left_out.push(format!("{n} smaller copies of each page"));
    }
    plan
}

/// ImageJ: `name=value` lines; channels are fastest, then slices, then frames.
fn imagej(path: &Path, tiff: &Tiff, main: usize, text: &str) -> Result<Plan> {
    let fields: BTreeMap<&str, &str> = text.lines().filter_map(|line| line.split_once('=')).collect();
    let count = |name: &str| fields.get(name).and_then(|v| v.trim().parse::<u64>().ok()).filter(|&n| n > 0);
    let first = &tiff.pages[main];
    let number = |name: &str| fields.get(name).and_then(|v| v.trim().parse::<f64>().ok()).filter(|v| v.is_finite());
    let (mut c, mut z, t) =
        (count("channels").unwrap_or(1), count("slices").unwrap_or(1), count("frames").unwrap_or(1));
    let images = count("images").unwrap_or(1);
    let own = tiff.pages.iter().filter(|ifd| !tiff.is_extra(ifd)).count() as u64;
    // Channels that are samples of a pixel have no pages of their own.
    let samples = tiff.hint(first, tags::SAMPLES).unwrap_or(1);
    if c > 1 && c == samples && own.max(images) == z.saturating_mul(t) {
        c = 1;
    }
    if c.saturating_mul(z).saturating_mul(t) == 1 && (images > 1 || own > 1) {
        z = if own > 1 { own } else { images };
    }
    let of = |name: char| match name {
        'c' => ('C', c),
        'z' => ('Z', z),
        _ => ('T', t),
    };
    let order = fields.get("order").map(|o| o.trim().to_lowercase()).unwrap_or_default();
    let order = if ["ctz", "zct", "ztc", "tcz", "tzc"].contains(&&*order) { order } else { "czt".to_owned() };
    let axes: Axes = order.chars().map(of).collect();
    let mut plan = counted(path, tiff, main, "ImageJ TIFF", &axes)?;
    let unit = fields.get("unit").map_or("", |u| u.trim());
    plan.unit = match unit.replace("\\u00B5", "µ").replace('\u{3bc}', "µ").as_str() {
        "micron" | "microns" | "um" | "µm" => "µm".to_owned(),
        "pixel" | "pixels" => String::new(),
        other => other.chars().take(32).collect(),
    };
    let side = |t: u16| {
        let ratio = tiff.numbers(first, t).ok().flatten()?.first().copied();
        ratio.filter(|&r| r > 0.0 && r.is_finite()).map(|r| 1.0 / r)
    };
    let sides =
        (side(tags::X_RESOLUTION), side(tags::Y_RESOLUTION), number("spacing").map(f64::abs).filter(|&v| v > 0.0));
    if let (Some(x), Some(y), Some(z), false) = (sides.0, sides.1, sides.2, plan.unit.is_empty()) {
        plan.voxel = Some([x, y, z].map(rounded));
    }
    // Calibration of values: a straight line, or a function that is not applied.
    match fields.get("cf").map(|v| v.trim()) {
        Some("0") => {
            let (c0, c1) = (number("c0").unwrap_or(0.0), number("c1").unwrap_or(1.0));
            plan.scale = (c1 != 0.0).then_some((c1, c0)).filter(|&s| s != (1.0, 0.0));
            plan.rule = fields.get("vunit").map(|u| format!("values in {}", u.trim())).unwrap_or_default();
        }
        Some(n) if n.parse::<u32>().is_ok_and(|n| n < 20) => {
            plan.left_out.push(format!("the calibration of values (ImageJ function {n}): values are as stored"));
        }
        _ => {}
    }
    Ok(plan)
}

/// Without the last digits of a quotient: 0.1 of 10000001/1000000.
fn rounded(v: f64) -> f64 {
    format!("{v:.5e}").parse().unwrap_or(v)
}

/// The shape that tifffile writes as JSON.
fn shaped(path: &Path, tiff: &Tiff, main: usize, text: &str) -> Result<Option<Plan>> {
    if !text.starts_with("{\"shape\":") {
        return Ok(None);
    }
    let Ok(json) = serde_json::from_str::<serde_json::Value>(text.trim()) else { return Ok(None) };
    let shape: Option<Vec<u64>> =
        json["shape"].as_array().and_then(|v| v.iter().map(serde_json::Value::as_u64).collect());
    let Some(shape) = shape.filter(|s| !s.is_empty()) else { return Ok(None) };
    let of = layout(tiff, &tiff.pages[main])?;
    let (w, h, s) = (u64::from(of.width), u64::from(of.height), u64::from(of.samples));
    // What of the shape is in a page: rows, columns, samples before or after them.
    let inner = if s == 1 { vec![vec![h, w]] } else { vec![vec![s, h, w], vec![h, w, s]] };
    let Some(inner) = inner.iter().find(|inner| shape.ends_with(inner)) else { return Ok(None) };
    let outer = &shape[..shape.len() - inner.len()];
    let names: Vec<char> = match json["axes"].as_str().map(|a| a.chars().collect::<Vec<_>>()) {
        Some(axes) if axes.len() == shape.len() => axes[..outer.len()].to_vec(),
        _ => vec!['Q'; outer.len()],
    };
    let mut axes: Axes = names.into_iter().zip(outer.iter().copied()).rev().collect();
    // Without a name, the last is along z.
    if !axes.iter().any(|a| a.0 == 'Z')
        && let Some(z) = axes.iter_mut().find(|a| !"CTSRAL".contains(a.0))
    {
        z.0 = 'Z';
    }
    counted(path, tiff, main, "TIFF", &axes).map(Some)
}

/// `axes` and `lengths` of SCIFIO, the fastest first.
fn scifio(text: &str) -> Option<Axes> {
    if !text.starts_with("SCIFIO=") {
        return None;
    }
    let field = |name: &str| text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix('='));
    let lengths = field("lengths")?.split(',').map(|n| n.trim().parse::<u64>().ok().filter(|&n| n > 0));
    let axes = field("axes")?.split(',').zip(lengths).map(|(name, n)| {
        Some(match name.trim() {
            "X" | "Y" => return Some(None),
            "Z" => Some(('Z', n?)),
            "Channel" => Some(('C', n?)),
            "Time" => Some(('T', n?)),
            _ => Some(('Q', n?)),
        })
    });
    let axes: Axes = axes.collect::<Option<Vec<_>>>()?.into_iter().flatten().collect();
    axes.iter().any(|a| a.0 == 'Z').then_some(axes)
}

/// Zeiss: signed words 2 to 6 are x, y, z, channels (samples of a page), times.
fn lsm_axes(tiff: &Tiff, ifd: &Page) -> Option<Axes> {
    let info = tiff.bytes_of(ifd, tags::CZ_LSM_INFO).ok().flatten()?;
    let word = |i: usize| {
        let b: [u8; 4] = info.get(4 * i..4 * i + 4)?.try_into().ok()?;
        Some(u64::from(if tiff.big_endian { u32::from_be_bytes(b) } else { u32::from_le_bytes(b) }))
    };
    let (z, t) = (word(4)?, word(6)?);
    (z > 0 && t > 0).then(|| vec![('Z', z), ('T', t)])
}

/// Sides of a voxel in µm: doubles from byte 40 on, in metres.
fn lsm_voxel(tiff: &Tiff, info: &[u8]) -> Option<[f64; 3]> {
    let number = |i: usize| {
        let b: [u8; 8] = info.get(40 + 8 * i..48 + 8 * i)?.try_into().ok()?;
        let v = if tiff.big_endian { f64::from_be_bytes(b) } else { f64::from_le_bytes(b) };
        (v > 0.0 && v < 1.0).then(|| rounded(v * 1e6))
    };
    Some([number(0)?, number(1)?, number(2)?])
}

/// Planes of a MetaMorph stack.
fn metamorph(tiff: &Tiff, ifd: &Page) -> Option<u64> {
    // Six whole numbers a plane, as three quotients, at the place that the tag names; its count is that of planes.
    let n = ifd.count(tags::UIC2);
    (n > 1 && tiff.pages.len() == 1).then_some(n)
}

/// GDAL's scale and offset of the first band, where ImageJ said nothing.
fn gdal_scale(tiff: &Tiff, ifd: &Page, plan: &mut Plan) -> Result<()> {
    let Some(text) = tiff.text(ifd, tags::GDAL_METADATA)? else { return Ok(()) };
    let Ok(xml) = roxmltree::Document::parse(text.trim()) else { return Ok(()) };
    let item = |name: &str| -> Option<String> {
        let of = |i: &roxmltree::Node| {
            i.attribute("role") == Some(name) && matches!(i.attribute("sample"), None | Some("0"))
        };
        Some(xml.descendants().find(of)?.text()?.trim().to_owned())
    };
    let number = |name: &str| item(name).and_then(|t| t.parse::<f64>().ok()).filter(|v| v.is_finite());
    let (slope, inter) = (number("scale").unwrap_or(1.0), number("offset").unwrap_or(0.0));
    if plan.scale.is_none() && slope != 0.0 && (slope, inter) != (1.0, 0.0) {
        plan.scale = Some((slope, inter));
    }
    if let Some(unit) = item("unittype").filter(|_| plan.rule.is_empty()) {
        plan.rule = format!("values in {unit}");
    }
    Ok(())
}

/// OME-XML: sizes, their order, and which directory of which file holds which plane.
fn ome(path: &Path, tiff: &Tiff, text: &str) -> Result<Plan> {
    let fail = |what: String| Error::format(path, format!("OME-XML: {what}"));
    let xml = roxmltree::Document::parse(text.trim()).map_err(|e| fail(e.to_string()))?;
    let named = |name: &'static str| move |n: &roxmltree::Node| n.tag_name().name() == name;
    if let Some(only) = xml.descendants().find(named("BinaryOnly")) {
        let name = only.attribute("MetadataFile").unwrap_or_default();
        let beside = beside(path, name).ok_or_else(|| fail(format!("what the file is stands in {name:?}")))?;
        let text = std::fs::read_to_string(&beside).map_err(|e| Error::io(&beside, "read", e))?;
        return ome_image(path, tiff, &text, &fail);
    }
    ome_image(path, tiff, text, &fail)
}

/// A file that another names, in the same folder.
fn beside(path: &Path, name: &str) -> Option<PathBuf> {
    let plain = !name.is_empty() && !name.contains(['/', '\\']) && name != "..";
    plain.then(|| path.with_file_name(name))
}

fn ome_image(path: &Path, tiff: &Tiff, text: &str, fail: &dyn Fn(String) -> Error) -> Result<Plan> {
    let xml = roxmltree::Document::parse(text.trim()).map_err(|e| fail(e.to_string()))?;
    let named = |name: &'static str| move |n: &roxmltree::Node| n.tag_name().name() == name;
    let images: Vec<_> = xml.descendants().filter(named("Image")).collect();
    let pixels = images.first().and_then(|image| image.descendants().find(named("Pixels")));
    let Some(pixels) = pixels else { return Err(fail("no Pixels in an Image".to_owned())) };
    let size = |name: &str| -> Result<u64> {
        let text = pixels.attribute(name).ok_or_else(|| fail(format!("Pixels have no {name}")))?;
        let n = text.trim().parse::<u64>().ok().filter(|&n| (1..=1 << 31).contains(&n));
        n.ok_or_else(|| fail(format!("{name} is {text:?}")))
    };
    // Samples of a pixel are channels without planes of their own.
    let per_page: u64 = pixels
        .children()
        .filter(named("Channel"))
        .filter_map(|c| c.attribute("SamplesPerPixel")?.trim().parse().ok())
        .next()
        .unwrap_or(1)
        .max(1);
    let (sx, sy, sz, st) = (size("SizeX")?, size("SizeY")?, size("SizeZ")?, size("SizeT")?);
    let channels = size("SizeC")?;
    let sc = channels.div_ceil(per_page);
    let order = pixels.attribute("DimensionOrder").unwrap_or("XYCZT");
    let axes: Option<Axes> = order.strip_prefix("XY").filter(|o| o.len() == 3).and_then(|o| {
        let of = |c| {
            Some(match c {
                'C' => ('C', sc),
                'Z' => ('Z', sz),
                'T' => ('T', st),
                _ => return None,
            })
        };
        o.chars().map(of).collect()
    });
    let axes = axes.filter(|a| ['C', 'Z', 'T'].iter().all(|n| a.iter().any(|x| x.0 == *n)));
    let axes = axes.ok_or_else(|| fail(format!("DimensionOrder is {order:?}")))?;
    let total = sz.checked_mul(sc).and_then(|n| n.checked_mul(st)).filter(|&n| n < 1 << 32);
    let total = total.ok_or_else(|| fail(format!("{sz} × {sc} × {st} planes")))?;
    // Which plane is at `index` in the order; of the first channel and time, which z.
    let z_of = |mut index: u64| {
        let mut z = Some(0);
        for &(name, n) in &axes {
            let at = index % n;
            index /= n;
            match name {
                'Z' => z = z.map(|_| at),
                _ if at > 0 => z = None,
                _ => {}
            }
        }
        z.filter(|_| index == 0)
    };
    let mut slices: BTreeMap<u64, Slice> = BTreeMap::new();
    let data: Vec<_> = pixels.children().filter(named("TiffData")).collect();
    let own = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let mut looked = 0;
    let my_uuid = xml.root_element().attribute("UUID").unwrap_or_default();
    for block in &data {
        let number = |name: &str| block.attribute(name).and_then(|v| v.trim().parse::<u64>().ok());
        let uuid = block.children().find(named("UUID"));
        let name = uuid.and_then(|u| u.attribute("FileName"));
        let mine = uuid.is_none_or(|u| u.text().map(str::trim) == Some(my_uuid)) || name.is_none_or(|n| n == own);
        let other = if mine { None } else { name.map(str::to_owned) };
        let first = |name: &str| number(name).unwrap_or(0);
        let mut stride = 1;
        let mut at = 0;
        for &(name, n) in &axes {
            at += stride
                * first(match name {
                    'C' => "FirstC",
                    'Z' => "FirstZ",
                    _ => "FirstT",
                })
                .min(n);
            stride *= n;
        }
        let ifd = number("IFD");
        // Without a count, one plane where a directory is named, else all that there are.
        let planes = number("PlaneCount").unwrap_or(if ifd.is_some() { 1 } else { total }).min(total);
        looked += planes;
        if looked > 1 << 24 {
            return Err(fail("TiffData name more than 16777216 planes".to_owned()));
        }
        for i in 0..planes {
            if let Some(z) = z_of(at + i) {
                slices.entry(z).or_insert(Slice {
                    file: other.clone(),
                    page: (ifd.unwrap_or(0) + i) as usize,
                    plane: 0,
                });
            }
        }
    }
    let own_pages = tiff.pages.len() as u64;
    let mut plan = if data.is_empty() || own_pages == 1 && total > 1 && slices.values().all(|s| s.file.is_none()) {
        counted(path, tiff, 0, "OME-TIFF", &axes)?
    } else {
        let mut plan = Plan::along_z("OME-TIFF", &axes, page);
        if slices.len() as u64 != sz {
            return Err(fail(format!("{} of {sz} slices have a place (TiffData)", slices.len())));
        }
        plan.slices = slices.into_values().collect();
        if let Some(far) = plan.slices.iter().find(|s| s.file.is_none() && s.page as u64 >= own_pages) {
            return Err(fail(format!("a slice is in page {}, the file has {own_pages}; it is cut short", far.page)));
        }
        plan
    };
    let of = layout(tiff, &tiff.pages[0])?;
    if (u64::from(of.width), u64::from(of.height)) != (sx, sy) {
        return Err(fail(format!("{sx} × {sy} pixels, the page has {} × {}", of.width, of.height)));
    }
    // The page's own samples are said where it is read.
    if channels > sc && sc > 1 {
        plan.left_out.push(format!("{channels} channels are {sc} of {per_page} samples: the first is read"));
    }
    let side = |name: &str| {
        pixels.attribute(name).and_then(|v| v.trim().parse::<f64>().ok()).filter(|&v| v > 0.0 && v.is_finite())
    };
    if let (Some(x), Some(y)) = (side("PhysicalSizeX"), side("PhysicalSizeY")) {
        let units = ["PhysicalSizeXUnit", "PhysicalSizeYUnit", "PhysicalSizeZUnit"]
            .map(|u| pixels.attribute(u).unwrap_or("µm"));
        if let Some(z) = side("PhysicalSizeZ") {
            match in_one_unit([(x, units[0]), (y, units[1]), (z, units[2])]) {
                Some((voxel, unit)) => (plan.voxel, plan.unit) = (Some(voxel), unit.chars().take(32).collect()),
                None => plan.left_out.push(format!(
                    "voxels of {x} {} × {y} {} × {z} {} are drawn as cubes",
                    units[0], units[1], units[2]
                )),
            }
        }
    }
    if images.len() > 1 {
        plan.left_out.push(format!("{} of {} images: the first is read", images.len() - 1, images.len()));
    }
    let n = tiff.pages[0].count(tags::SUB_IFDS);
    if n > 0 {
        plan.left_out.push(format!("{n} coarser resolutions"));
    }
    Ok(plan)
}

/// The volume of a plan.
fn volume<'a>(path: &Path, tiff: &Tiff<'a>, plan: Plan, opts: &ReadOptions) -> Result<Volume<'a>> {
    let Plan { slices, format, voxel, unit, scale, rule, left_out, .. } = plan;
    let home = slices.iter().find(|s| s.file.is_none()).map_or(0, |s| s.page);
    let ifd = &tiff.pages[home];
    let of = layout(tiff, ifd)?;
    let dims = [of.width.into(), of.height.into(), slices.len() as u64];
    let mut about = About::new(Kind::Volume, format);
    about.axes = "columns are x, rows y, slices z".to_owned();
    (about.voxel, about.unit, about.rule, about.left_out) = (voxel, unit, rule, left_out);
    say_samples(tiff, ifd, &of, &mut about);
    if let Some((slope, inter)) = scale {
        about.rule = format!(
            "values are stored · {slope} + {inter}{}",
            if about.rule.is_empty() { String::new() } else { format!(", {}", about.rule) }
        );
    }
    let missing = nodata(tiff, ifd)?;
    if let Some(v) = missing {
        about.rule = format!(
            "{}{v} is air (GDAL no-data)",
            if about.rule.is_empty() { String::new() } else { format!("{}; ", about.rule) }
        );
    }
    let in_order = slices.iter().enumerate().all(|(i, s)| s.file.is_none() && s.page == home && s.plane == i as u64);
    if let Some(start) = of.contiguous().filter(|_| in_order) {
        let len = of.byte_len().saturating_mul(slices.len() as u64);
        let end = start.checked_add(len).filter(|&end| end <= tiff.all.len() as u64);
        let end = end.ok_or_else(|| {
            Error::format(
                path,
                format!("byte {start}: {len} bytes of values, the file ends at byte {}", tiff.all.len()),
            )
        })?;
        let data = Data::Slice(&tiff.all[start as usize..end as usize]);
        let stored =
            Stored { big_endian: tiff.big_endian, scale, missing, about, ..Stored::new(dims, of.dtype(), data) };
        return Volume::new(path, stored, opts);
    }
    let mut out = Scratch::new(path, opts)?;
    let mut other: Option<(String, crate::store::guard::Map)> = None;
    for (n, slice) in slices.iter().enumerate() {
        let Some(name) = &slice.file else {
            if slice.plane > 0 {
                let at = of.contiguous().unwrap_or(0) + slice.plane * of.byte_len();
                out.raw(tiff, &of, at, n)?;
            } else {
                out.page(path, tiff, slice.page, n)?;
            }
            continue;
        };
        let there = beside(path, name).ok_or_else(|| {
            Error::format(path, format!("OME-XML: slice {n} is in {name:?}; expected a file in the same folder"))
        })?;
        if other.as_ref().is_none_or(|(open, _)| open != name) {
            other = Some((name.clone(), map(&there)?));
        }
        let (_, bytes) = other.as_ref().expect("just opened");
        let tiff = Tiff::open(&there, bytes, true)?;
        if slice.page >= tiff.pages.len() {
            let what = format!("slice {n} is in page {}, the file has {}", slice.page, tiff.pages.len());
            return Err(Error::format(&there, what));
        }
        out.page(&there, &tiff, slice.page, n)?;
    }
    out.finish(path, about, scale, missing, opts)
}

/// GDAL's no-data value; NaN is none in any case.
fn nodata(tiff: &Tiff, page: &Page) -> Result<Option<f64>> {
    let text = tiff.text(page, tags::GDAL_NODATA)?;
    Ok(text.and_then(|t| t.trim().parse::<f64>().ok()).filter(|v| !v.is_nan()))
}

/// How a page is laid out; colours of which no brightness is known are refused.
fn layout(tiff: &Tiff, page: &Page) -> Result<Image> {
    let image = tiff.image(page)?;
    let name = match image.photometric {
        0 | 1 | 3 | 4 | 32_803 => return Ok(image),
        // Many writers mark two channels so.
        2 if image.samples < 3 || !image.is_jpeg() => return Ok(image),
        6 if image.is_jpeg() && image.is_color() && image.samples == 3 => return Ok(image),
        2 => "RGB as JPEG",
        5 => "CMYK",
        6 => "YCbCr",
        8..=10 => "L*a*b*",
        32_844 | 32_845 => "LogL and LogLuv",
        _ => "of a kind that is not known",
    };
    let what =
        format!("colours {name} (PhotometricInterpretation {}) are not read; save it as grey", image.photometric);
    Err(tiff.fault(format!("page {} at byte {}: {what}", page.index, page.at)))
}

/// What of a page's samples is not in the volume.
fn say_samples(tiff: &Tiff, ifd: &Page, of: &Image, about: &mut About) {
    if of.is_color() {
        about.left_out.push("colours: their brightness is the value".to_owned());
    } else if of.samples > 1 {
        about.left_out.push(format!("{} of {} samples of each pixel: the first is read", of.samples - 1, of.samples));
    }
    if of.photometric == 3 && ifd.has(tags::COLOR_MAP) {
        about.left_out.push("the colour table: values are its places".to_owned());
    }
    if let Some(n) = tiff.hint(ifd, tags::ORIENTATION).filter(|&n| n > 1) {
        about.left_out.push(format!("orientation {n}: rows and columns are as stored"));
    }
}

/// Slices one after the other, in a file without a name.
struct Scratch {
    out: BufWriter<File>,
    first: Option<([u32; 2], Dtype)>,
    n: u64,
    world: Option<super::Up>,
}

fn failing(action: &'static str) -> impl Fn(std::io::Error) -> Error {
    move |e| Error::io(std::env::temp_dir(), action, e)
}

impl Scratch {
    fn new(_: &Path, opts: &ReadOptions) -> Result<Scratch> {
        let file = file::file().map_err(failing("create a file in"))?;
        Ok(Scratch { out: BufWriter::with_capacity(1 << 20, file), first: None, n: 0, world: opts.up })
    }

    /// Checks a slice's size and type against those of the first.
    fn begin(&mut self, path: &Path, size: [u32; 2], dtype: Dtype, n: usize) -> Result<()> {
        let &mut (expected, of) = self.first.get_or_insert((size, dtype));
        if (expected, of) != (size, dtype) {
            let what = format!("page {n} of the stack is {size:?} of {dtype:?}, the first {expected:?} of {of:?}");
            return Err(Error::format(path, what));
        }
        if self.n == 0 {
            let [x, y] = size.map(u64::from);
            let dims = if self.world == Some(super::Up::Z) { [x, 1, y] } else { [x, y, 1] };
            world_dims(
                path,
                if self.world == Some(super::Up::X) { [1, x, y] } else { dims },
                "choose another axis with --up",
            )?;
        }
        self.n += 1;
        Ok(())
    }

    fn page(&mut self, path: &Path, tiff: &Tiff, page: usize, n: usize) -> Result<()> {
        let of = layout(tiff, &tiff.pages[page])?;
        self.begin(path, [of.width, of.height], of.dtype(), n)?;
        // Tiles that were never written, and codecs without an end, make much of little.
        let most = (tiff.all.len() as u64).saturating_mul(40_000).saturating_add(1 << 32);
        if of.byte_len().saturating_mul(self.n) > most {
            let what = format!("{} bytes cannot hold {} slices of {} bytes", tiff.all.len(), self.n, of.byte_len());
            return Err(Error::format(path, what));
        }
        tiff.bands(&of, 0, |band| self.out.write_all(band).map_err(failing("write a file in")))
    }

    /// Values that lie in the file as they are, but for the order of their bytes.
    fn raw(&mut self, tiff: &Tiff, of: &Image, at: u64, n: usize) -> Result<()> {
        self.begin(Path::new(""), [of.width, of.height], of.dtype(), n)?;
        let bytes = &tiff.all[at as usize..(at + of.byte_len()) as usize];
        let swap = tiff.big_endian != cfg!(target_endian = "big");
        for piece in bytes.chunks(1 << 20) {
            let mut piece = piece.to_vec();
            if swap {
                piece.chunks_exact_mut(of.dtype().size() as usize).for_each(<[u8]>::reverse);
            }
            self.out.write_all(&piece).map_err(failing("write a file in"))?;
        }
        Ok(())
    }

    fn finish(
        self,
        path: &Path,
        about: About,
        scale: Option<(f64, f64)>,
        missing: Option<f64>,
        opts: &ReadOptions,
    ) -> Result<Volume<'static>> {
        let Some(([nx, ny], dtype)) = self.first else {
            return Err(Error::format(path, "no images; a stack has one at least"));
        };
        let file: File = self.out.into_inner().map_err(|e| failing("write a file in")(e.into_error()))?;
        let dims = [nx.into(), ny.into(), self.n];
        let len = u64::from(nx) * u64::from(ny) * self.n * dtype.size();
        let data = Data::File { path: path.to_owned(), file, at: 0, len };
        let big_endian = cfg!(target_endian = "big");
        Volume::new(path, Stored { big_endian, scale, missing, about, ..Stored::new(dims, dtype, data) }, opts)
    }
}

/// The slices of a folder of TIFF files, in this order: each file's own, or all of the first file's where its OME-XML names
/// the others.
pub(super) fn folder(path: &Path, files: &[PathBuf], opts: &ReadOptions) -> Result<Volume<'static>> {
    let mut out = Scratch::new(path, opts)?;
    let mut about: Option<About> = None;
    let (mut scale, mut missing) = (None, None);
    let mut left_out: Vec<String> = Vec::new();
    for file in files {
        let bytes = map(file)?;
        let whole = guarded(file, "TIFF", || {
            let tiff = Tiff::open(file, &bytes, true)?;
            let plan = plan(file, &tiff)?;
            if about.is_none() && plan.slices.iter().any(|s| s.file.is_some()) {
                // The others are a part of this one's image.
                return volume(file, &tiff, plan, opts).and_then(|v| v.in_file(file, &bytes)).map(Some);
            }
            for s in &plan.slices {
                let n = out.n as usize;
                if s.plane > 0 {
                    let of = layout(&tiff, &tiff.pages[s.page])?;
                    let at = of.contiguous().unwrap_or(0) + s.plane * of.byte_len();
                    out.raw(&tiff, &of, at, n)?;
                } else {
                    out.page(file, &tiff, s.page, n)?;
                }
            }
            let ifd = &tiff.pages[plan.slices[0].page];
            let mut own = About::new(Kind::Volume, format!("a folder of {} {} files", files.len(), plan.format));
            own.left_out = plan.left_out;
            say_samples(&tiff, ifd, &layout(&tiff, ifd)?, &mut own);
            for phrase in own.left_out.drain(..) {
                if !left_out.contains(&phrase) {
                    left_out.push(phrase);
                }
            }
            if about.is_none() {
                (scale, own.rule) = (plan.scale, plan.rule);
                if let Some((slope, inter)) = scale {
                    own.rule = format!("values are stored · {slope} + {inter}");
                }
                missing = nodata(&tiff, ifd)?;
                about = Some(own);
            } else if plan.scale != scale {
                let what = format!("values mean stored · {:?}, in the first file · {scale:?}", plan.scale);
                return Err(Error::format(file, what));
            }
            Ok(None)
        })?;
        if let Some(volume) = whole {
            return Ok(volume);
        }
    }
    let mut about = about.unwrap_or_default();
    about.axes = "columns are x, rows y, files z by name".to_owned();
    about.left_out = left_out;
    out.finish(path, about, scale, missing, opts)
}

/// The PNG or JPEG files of a folder, in this order; of colours the brightness.
pub(super) fn pictures(path: &Path, files: &[PathBuf], opts: &ReadOptions) -> Result<Volume<'static>> {
    let mut out = Scratch::new(path, opts)?;
    let mut about = About::new(Kind::Volume, format!("a folder of {} images", files.len()));
    about.axes = "columns are x, rows y, files z by name".to_owned();
    let (mut colored, mut clear) = (0, 0);
    for (n, file) in files.iter().enumerate() {
        use image::DynamicImage::{ImageLuma8, ImageLuma16, ImageLumaA8, ImageLumaA16, ImageRgb16, ImageRgba16};
        let bytes = map(file)?;
        let picture = super::heightmap::decode(file, &bytes)?;
        let size = [picture.width(), picture.height()];
        plausible(file, size[0], size[1], bytes.len())?;
        colored += usize::from(picture.color().has_color());
        clear += usize::from(picture.color().has_alpha());
        let (dtype, values) = match picture {
            ImageLuma8(v) => (Dtype::U8, v.into_raw()),
            ImageLumaA8(v) => (Dtype::U8, v.pixels().map(|p| p.0[0]).collect()),
            ImageLuma16(v) => (Dtype::U16, bytemuck::cast_slice(v.as_raw()).to_vec()),
            wide @ (ImageLumaA16(_) | ImageRgb16(_) | ImageRgba16(_)) => {
                (Dtype::U16, bytemuck::cast_slice(wide.into_luma16().as_raw()).to_vec())
            }
            other => (Dtype::U8, other.into_rgb8().pixels().map(|p| luma(p.0)).collect()),
        };
        out.begin(file, size, dtype, n)?;
        out.out.write_all(&values).map_err(failing("write a file in"))?;
    }
    if colored > 0 {
        about.left_out.push(format!("colours of {colored} images: their brightness is the value"));
    }
    if clear > 0 {
        about.left_out.push(format!("transparency of {clear} images"));
    }
    out.finish(path, about, None, None, opts)
}

#[cfg(test)]
mod tests;
