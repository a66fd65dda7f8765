//! TIFF and GeoTIFF as height maps, a strip or a tile at a time: no-data values, masks, alpha, GDAL's scale, offset and unit,
//! and where the picture lies. Of several bands the first is read.

use std::fs;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::geo::{Crs, Length, Place};
use super::heightmap::{Map, Up};
use super::heights::Heights;
use super::tiff::{Image, Page, Sample, Tiff, tags};
use super::{HeightCode, ReadOptions, map};
use crate::{About, Error, Result};

/// Bits of NewSubfileType.
const REDUCED: u64 = 1;
const MASK: u64 = 4;

/// The page that is the picture, all pages, and what kind each is.
fn pages<'t>(tiff: &'t Tiff) -> Result<(&'t Page, Vec<(&'t Page, u64)>)> {
    let kind = |page: &'t Page| Ok((page, tiff.integer(page, tags::NEW_SUBFILE_TYPE)?.unwrap_or(0)));
    let kinds = tiff.pages.iter().map(kind).collect::<Result<Vec<_>>>()?;
    let main = kinds.iter().find(|(_, kind)| kind & (REDUCED | MASK) == 0).unwrap_or(&kinds[0]).0;
    Ok((main, kinds))
}

/// Where the picture lies; a world file beside it (`.tfw`) counts where the TIFF says nothing.
fn place(tiff: &Tiff, page: &Page, path: &Path) -> Result<Option<Place>> {
    let doubles = |tag| Ok::<_, Error>(tiff.numbers(page, tag)?.unwrap_or_default());
    let (scale, ties, matrix) =
        (doubles(tags::PIXEL_SCALE)?, doubles(tags::TIE_POINTS)?, doubles(tags::TRANSFORMATION)?);
    let parameters = doubles(tags::GEO_DOUBLES)?;
    let keys = tiff.integers(page, tags::GEO_KEYS)?.unwrap_or_default();
    let keys: Vec<u16> = keys.into_iter().map(|k| u16::try_from(k).unwrap_or(u16::MAX)).collect();
    let text = tiff.bytes_of(page, tags::GEO_TEXT)?.unwrap_or_default();
    let crs = Crs::of_keys(&keys, &parameters, text);
    // GTRasterTypeGeoKey: 2 is "pixel is point".
    let point = keys.as_chunks::<4>().0.iter().skip(1).any(|k| k[0] == 1025 && k[3] == 2);
    let affine = Place::of_tags(&scale, &ties, &matrix, point).or_else(|| world_file(path, &["tfw", "tifw", "wld"]));
    Ok(affine.map(|affine| Place { crs, affine }))
}

/// The affine map of a world file beside an image: six lines, places are those of centres.
pub(super) fn world_file(path: &Path, endings: &[&str]) -> Option<[[f64; 3]; 2]> {
    let text = endings.iter().find_map(|ending| beside(path, &path.with_extension(ending)))?;
    let numbers: Vec<f64> = text.split_whitespace().map_while(|w| w.replace(',', ".").parse().ok()).collect();
    let &[a, d, b, e, c, f, ..] = numbers.as_slice() else { return None };
    let sound = numbers.iter().all(|v| v.is_finite()) && a * e - b * d != 0.0;
    sound.then_some([[a, b, c - (a + b) / 2.0], [d, e, f - (d + e) / 2.0]])
}

/// A small text beside an input that is a file.
pub(super) fn beside(path: &Path, name: &Path) -> Option<String> {
    const LIMIT: u64 = 1 << 20;
    let small = |p: &Path| fs::metadata(p).is_ok_and(|m| m.is_file() && m.len() <= LIMIT);
    if !path.is_file() || !small(name) {
        return None;
    }
    Some(String::from_utf8_lossy(&fs::read(name).ok()?).into_owned())
}

/// The size of a TIFF and where it lies, its flips undone.
pub(super) fn survey(path: &Path, bytes: &[u8], in_file: bool) -> Result<(Option<Place>, [u32; 2])> {
    let tiff = Tiff::open(path, bytes, in_file)?;
    let (page, _) = pages(&tiff)?;
    let image = tiff.image(page)?;
    Ok((place(&tiff, page, path)?, [image.width, image.height]))
}

/// Whether a TIFF says where on Earth it lies.
pub(super) fn is_geographic(path: &Path, bytes: &[u8]) -> bool {
    let place = || {
        let tiff = Tiff::open(path, bytes, false)?;
        let (page, _) = pages(&tiff)?;
        place(&tiff, page, path)
    };
    place().is_ok_and(|place| place.is_some())
}

/// What GDAL says of the first band, in its XML of tag 42112.
#[derive(Debug, Default, PartialEq)]
struct Gdal {
    scale: Option<f64>,
    offset: Option<f64>,
    unit: String,
}

fn gdal(xml: &str) -> Gdal {
    let mut out = Gdal::default();
    for item in xml.split("<Item").skip(1) {
        let Some((head, rest)) = item.split_once('>') else { continue };
        let value = rest.split("</Item").next().unwrap_or_default().trim();
        let attribute = |name: &str| {
            let from = head.find(&format!(" {name}=\""))? + name.len() + 3;
            head[from..].split('"').next()
        };
        if attribute("sample").is_some_and(|s| s != "0") {
            continue;
        }
        let name = attribute("name").unwrap_or_default();
        match attribute("role").unwrap_or_default() {
            "scale" => out.scale = value.parse().ok(),
            "offset" => out.offset = value.parse().ok(),
            "unittype" => out.unit = unescaped(value),
            "" if name == "UNITTYPE" && out.unit.is_empty() => out.unit = unescaped(value),
            _ => {}
        }
    }
    out
}

fn unescaped(text: &str) -> String {
    [("&lt;", "<"), ("&gt;", ">"), ("&quot;", "\""), ("&apos;", "'"), ("&amp;", "&")]
        .iter()
        .fold(text.to_owned(), |t, (from, to)| t.replace(from, to))
}

/// What becomes of a stored sample.
struct Meaning {
    nodata: Option<f64>,
    scale: f64,
    offset: f64,
    /// Samples are floats: a no-data value's text may have more digits, or fewer, and values may have been f32.
    float: bool,
}

impl Meaning {
    fn height(&self, stored: f64) -> f32 {
        // As near as GDAL takes them for equal, f64 too.
        let near = |n: f64| (n - stored).abs() < 2.0 * f64::from(f32::EPSILON) * (n + stored).abs();
        let none = self.nodata.is_some_and(|n| n == stored || self.float && near(n));
        if none { f32::NAN } else { (stored * self.scale + self.offset) as f32 }
    }
}

/// Which bands are read.
struct Bands {
    rgb: Option<HeightCode>,
    alpha: Option<u32>,
    left_out: Option<String>,
}

fn bands(tiff: &Tiff, image: &Image, opts: &ReadOptions) -> Result<Bands> {
    let fault = |what: &str| Err(tiff.fault(format!("photometric {}: {what}", image.photometric)));
    let n = image.samples;
    let extra = image.extra.len().min(n as usize) as u32;
    let alpha =
        image.extra.iter().position(|e| matches!(e, 1 | 2)).map(|i| n - extra + i as u32).filter(|&b| b > 0 && b < n);
    match (image.photometric, opts.rgb) {
        (2, Some(rgb)) if n >= 3 && image.bits == 8 && image.sample == Sample::Unsigned => {
            return Ok(Bands { rgb: Some(rgb), alpha, left_out: None });
        }
        (_, Some(_)) => return fault("--rgb wants red, green and blue of 8 bits"),
        (0 | 1, None) => {}
        (2, None) => {
            return fault(
                "a picture in colours has no heights; give a TIFF of one band, or --rgb mapbox|terrarium where colours code heights",
            );
        }
        (3, None) => {
            return fault("its values are numbers of colours in a palette, not heights; give a TIFF of heights");
        }
        (4, None) => return fault("a mask, not heights"),
        _ => return fault("a picture in colours has no heights; give a TIFF of one band"),
    }
    let others: Vec<String> = (1..n).filter(|b| Some(*b) != alpha).map(|b| (b + 1).to_string()).collect();
    let left_out = match others.as_slice() {
        [] => None,
        [one] => Some(format!("band {one} of {n}")),
        [first, .., last] => Some(format!("bands {first} to {last} of {n}")),
    };
    Ok(Bands { rgb: None, alpha, left_out })
}

/// Reads the picture of a TIFF as heights; `in_file` says that the file at `path` holds these bytes.
pub(super) fn read(path: &Path, bytes: &[u8], in_file: bool, opts: &ReadOptions) -> Result<Map> {
    let tiff = Tiff::open(path, bytes, in_file)?;
    let (page, pages) = pages(&tiff)?;
    let image = tiff.image(page)?;
    let bands = bands(&tiff, &image, opts)?;
    let place = place(&tiff, page, path)?;
    let mut left_out: Vec<String> = bands.left_out.iter().cloned().collect();
    let mut rules = Vec::new();
    let gdal = gdal(&tiff.text(page, tags::GDAL_METADATA)?.unwrap_or_default());
    let text = tiff.text(page, tags::GDAL_NODATA)?.map(|t| t.trim().to_owned()).filter(|t| !t.is_empty());
    let stated = text.as_ref().and_then(|t| t.parse::<f64>().ok());
    if let (Some(text), None) = (&text, stated) {
        left_out.push(format!("the no-data value {text:?}, which is no number"));
    }
    let masks: Vec<&Page> = pages.iter().filter(|(_, kind)| kind & (MASK | REDUCED) == MASK).map(|p| p.0).collect();
    let sidecar = mask_beside(path);
    let masked = !masks.is_empty() || sidecar.is_some();
    let mut nodata = opts.nodata.or(stated);
    if masked && opts.nodata.is_none() && stated.is_some_and(f64::is_finite) {
        rules.push(format!("a mask says which pixels have data, not the no-data value {}", stated.unwrap_or_default()));
        nodata = None;
    }
    let scale = gdal.scale.filter(|s| s.is_finite() && *s != 0.0).unwrap_or(1.0);
    let offset = gdal.offset.filter(|o| o.is_finite()).unwrap_or(0.0);
    if (scale, offset) != (1.0, 0.0) {
        rules.push(format!("heights are stored values × {scale} + {offset}"));
    }
    let meaning = Meaning { nodata, scale, offset, float: image.sample == Sample::Float };

    let mut heights = Heights::new(image.width, image.height)?;
    // What was never written is no data, or else 0.
    let unwritten = match bands.rgb {
        Some(_) => f32::NAN,
        None if nodata.is_some() || masked && stated.is_some() => f32::NAN,
        None => meaning.height(0.0),
    };
    for row in 0..image.down {
        for column in 0..image.across {
            let wanted: &[u32] = if bands.rgb.is_some() { &[0, 1, 2] } else { &[0] };
            let mut planes = Vec::new();
            for &band in wanted.iter().chain(&bands.alpha) {
                planes.push((band, tiff.chunk(&image, image.index(column, row, band))?));
            }
            let [wide, high] = image.chunk;
            let (x, z) = (column * wide, row * high);
            let (w, h) = (wide.min(image.width - x) as usize, high.min(image.height - z) as usize);
            let value = |z: usize, x: usize| -> f32 {
                let at = |i: usize| {
                    let (band, bytes) = &planes[i];
                    let size = image.row_bytes();
                    bytes.as_ref().map(|b| image.value(&b[z * size..(z + 1) * size], x, *band))
                };
                let opaque = bands.alpha.is_none_or(|_| at(planes.len() - 1).is_some_and(|a| a > 0.0));
                match (opaque, bands.rgb) {
                    (false, _) => f32::NAN,
                    (true, Some(rgb)) => match (at(0), at(1), at(2)) {
                        (Some(r), Some(g), Some(b)) => rgb.height([r as u8, g as u8, b as u8]),
                        _ => f32::NAN,
                    },
                    (true, None) => at(0).map_or(unwritten, |v| meaning.height(v)),
                }
            };
            let rows = (0..h).into_par_iter().flat_map_iter(|z| (0..w).map(move |x| (z, x)));
            let values: Vec<f32> = rows.map(|(z, x)| value(z, x)).collect();
            heights.put(x, z, w as u32, &values)?;
        }
    }
    if let Some(mask) = masks.first() {
        apply(&tiff, mask, &image, &mut heights)?;
        heights.recount()?;
    } else if let Some(name) = &sidecar {
        let bytes = map(name)?;
        let tiff = Tiff::open(name, &bytes, true)?;
        apply(&tiff, &tiff.pages[0], &image, &mut heights)?;
        heights.recount()?;
    }

    let further =
        |of: &dyn Fn(u64) -> bool| pages.iter().filter(|(p, kind)| p.index != page.index && of(*kind)).count();
    let (overviews, others) = (further(&|k| k & (MASK | REDUCED) == REDUCED), further(&|k| k & (MASK | REDUCED) == 0));
    let many = |n: usize, one: &str| if n == 1 { format!("1 {one}") } else { format!("{n} {one}s") };
    left_out.extend((overviews > 0).then(|| many(overviews, "overview")));
    left_out.extend((others > 0).then(|| many(others, "further page")));
    left_out.extend((masks.len() > 1).then(|| many(masks.len() - 1, "further mask")));
    let ties = tiff.numbers(page, tags::TIE_POINTS)?.unwrap_or_default().len() / 6;
    if place.is_none() && ties > 0 {
        left_out.push(format!("a place given by {}, which is no grid", many(ties, "control point")));
    }
    // As GDAL has it: rows and columns are what is placed, whichever way a viewer would turn the picture.
    if let Some(orientation) = tiff.integer(page, tags::ORIENTATION)?.filter(|&o| o > 1) {
        left_out.push(format!("the turn that a viewer would give the picture (orientation {orientation})"));
    }
    if page.has(50_844) {
        left_out.push("the geometry of a sensor (RPC)".to_owned());
    }
    if let Some(name) = aux_beside(path) {
        left_out.push(format!("{name} beside it"));
    }
    let up = match Length::of_name(&gdal.unit) {
        _ if gdal.unit.is_empty() => Up::Unsaid,
        Some(unit) => Up::Length(unit),
        None => Up::Other(gdal.unit),
    };
    let geo = place.is_some() || page.has(tags::GEO_KEYS);
    Ok(Map {
        up,
        place,
        eight_bit: image.bits <= 8 && bands.rgb.is_none() && meaning.scale == 1.0,
        nodata_known: nodata.is_some() || masked,
        rules,
        about: About {
            left_out,
            ..About::new(crate::model::about::Kind::Terrain, if geo { "GeoTIFF" } else { "TIFF" })
        },
        ..Map::of(heights)
    })
}

/// Takes the colours of row `z` of a picture from column `x` on, and how wide it is: `put(x, z, width, pixels)`.
pub(super) type Put<'a> = dyn Fn(u32, u32, u32, &[u8]) -> Result<()> + 'a;

/// A picture in colours, strip by strip or tile by tile; where it lies, and its size.
pub(super) fn colors(path: &Path, bytes: &[u8], put: &Put) -> Result<(Option<Place>, [u32; 2])> {
    let tiff = Tiff::open(path, bytes, true)?;
    let (page, _) = pages(&tiff)?;
    let image = tiff.image(page)?;
    let bands: &[u32] = match (image.photometric, image.samples) {
        (2, 3..) => &[0, 1, 2],
        (0 | 1 | 3, _) => &[0, 0, 0],
        _ => {
            return Err(tiff.fault(format!(
                "photometric {}: a colour map is grey, RGB or of a palette; gdal_translate makes RGB of others",
                image.photometric
            )));
        }
    };
    if image.sample != Sample::Unsigned || !matches!(image.bits, 8 | 16) {
        let (bits, sample) = (image.bits, image.sample);
        return Err(
            tiff.fault(format!("samples of {bits} bits ({sample:?}) are no colours; write it with 8 bits a sample"))
        );
    }
    // A palette has all reds first, then greens, then blues, of 16 bits each.
    let palette =
        if image.photometric == 3 { tiff.integers(page, tags::COLOR_MAP)?.unwrap_or_default() } else { Vec::new() };
    let colors = palette.len() / 3;
    if image.photometric == 3 && colors < 1 << image.bits.min(16) {
        return Err(tiff.fault(format!(
            "tag 320: {} numbers of a palette, {} expected",
            palette.len(),
            3usize << image.bits
        )));
    }
    let byte = |v: f64| if image.bits == 16 { (v / 257.0).round() as u8 } else { v as u8 };
    for row in 0..image.down {
        for column in 0..image.across {
            let mut planes = Vec::new();
            for (k, &band) in bands.iter().enumerate() {
                let same = k > 0 && image.index(column, row, band) == image.index(column, row, bands[k - 1]);
                planes.push(if same { None } else { Some(tiff.chunk(&image, image.index(column, row, band))?) });
            }
            let [wide, high] = image.chunk;
            let (x, z) = (column * wide, row * high);
            let (w, h) = (wide.min(image.width - x) as usize, high.min(image.height - z) as usize);
            let size = image.row_bytes();
            let mut line = Vec::with_capacity(3 * w);
            for i in 0..h {
                line.clear();
                for j in 0..w {
                    let value = |k: usize| {
                        let plane = planes[..=k].iter().rev().flatten().next().and_then(Option::as_ref);
                        plane.map_or(0.0, |bytes| image.value(&bytes[i * size..(i + 1) * size], j, bands[k]))
                    };
                    line.extend(match image.photometric {
                        3 => [0, 1, 2].map(|k| (palette[k * colors + value(0) as usize] >> 8) as u8),
                        // White is 0.
                        0 => [255 - byte(value(0)); 3],
                        _ => [0, 1, 2].map(|k| byte(value(k))),
                    });
                }
                put(x, z + i as u32, image.width, &line)?;
            }
        }
    }
    Ok((place(&tiff, page, path)?, [image.width, image.height]))
}

/// Empties the pixels that a mask says have no data: those whose bit is 0.
fn apply(tiff: &Tiff, page: &Page, of: &Image, heights: &mut Heights) -> Result<()> {
    let image = tiff.image(page)?;
    if (image.width, image.height) != (of.width, of.height) {
        let sizes = format!("{} × {}, its picture {} × {}", image.width, image.height, of.width, of.height);
        return Err(tiff.fault(format!("a mask of {sizes} pixels; masks are as large as pictures")));
    }
    for row in 0..image.down {
        for column in 0..image.across {
            let bytes = tiff.chunk(&image, image.index(column, row, 0))?;
            let [wide, high] = image.chunk;
            let (x, z) = (column * wide, row * high);
            let mut values = vec![0.0; wide.min(image.width - x) as usize];
            for i in 0..high.min(image.height - z) {
                let mask = bytes.as_ref().map(|b| &b[i as usize * image.row_bytes()..]);
                heights.row(x, z + i, &mut values)?;
                for (k, value) in values.iter_mut().enumerate() {
                    if mask.is_none_or(|row| image.value(row, k, 0) == 0.0) {
                        *value = f32::NAN;
                    }
                }
                heights.write(x, z + i, &values)?;
            }
        }
    }
    Ok(())
}

fn with_more(path: &Path, more: &str) -> Option<PathBuf> {
    let mut name = path.file_name()?.to_owned();
    name.push(more);
    Some(path.with_file_name(name))
}

/// GDAL's mask in a file of its own.
fn mask_beside(path: &Path) -> Option<PathBuf> {
    with_more(path, ".msk").filter(|name| path.is_file() && name.is_file())
}

/// GDAL's notes on an image, which are not read.
pub(super) fn aux_beside(path: &Path) -> Option<String> {
    let name = with_more(path, ".aux.xml").filter(|name| path.is_file() && name.is_file())?;
    Some(name.file_name()?.to_string_lossy().into_owned())
}

#[cfg(test)]
mod tests;
