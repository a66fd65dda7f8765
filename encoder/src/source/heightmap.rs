//! Height maps: PNG, JPEG, TIFF, GeoTIFF, ESRI grids, SRTM tiles, 16-bit terrains, with or without a colour map.
//!
//! Image column is x, row is z. A column is solid for 0 ≤ y ≤ round(S · value); a pixel without data (the file's no-data
//! value or `--nodata`, what a mask or alpha leaves out, NaN, infinity) is an empty column. S is `--height-scale`, or else
//!
//! - for a map whose pixels have a size: one voxel is as high as a pixel is wide. Values are metres unless the file says
//!   otherwise, in its band or in its reference system. Degrees, and metres on a map that stretches them, become metres on
//!   the ground at the image's centre (`geo`);
//! - 1 for 8-bit values without a place on Earth;
//! - for other 16-bit or float values 1, or less, so that the highest is a quarter of the longer side at most.
//!
//! Rows that run to the north and columns that run to the west are turned about, so that x is east and z is south; a raster
//! that is turned by another angle stays as it is stored, and its affine map says how it lies.
//!
//! Heights in colours (`--rgb`): Mapbox's are −10000 + (65536 R + 256 G + B) / 10 metres, Terrarium's
//! 256 R + G + B / 256 − 32768. Black, which is deeper than any sea in both, stands for no data.
//!
//! Values below 0 (sea floor) lift the whole map so that its lowest value is 0; otherwise nothing is subtracted.

use std::io::Cursor;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use super::geo::{Crs, Length, Model, Place};
use super::geotiff;
use super::heights::Heights;
use super::pixels::{Pixels, Png, Stream, stream};
use super::relief::{self, Colors, Exaggeration, Means, Ramp};
use super::{HeightCode, ReadOptions, guarded, world_dims};
use crate::encode::build::UNCOLORED;
use crate::model::about::Kind;
use crate::model::matter::Classes;
use crate::model::pieces::{ColumnColorsFn, HeightsFn, RowColors, Rows};
use crate::{About, ColumnsBuilder, Error, Result, Rgb, Run};

/// No compression of these formats makes more than about a thousand bytes of one: an image that claims more is not
/// worth asking memory for.
const MAX_INFLATION: u64 = 1100;

/// Columns whose heights have fractions, at most.
const MAX_FRACTIONS: u64 = 1 << 28;

/// Unit of a map's values.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Up {
    /// The file does not say.
    Unsaid,
    Length(Length),
    /// Something that is no length: "K", "mm/day".
    Other(String),
}

/// A map as a file holds it.
pub(super) struct Map {
    pub heights: Heights,
    /// Eight-bit values, whose unit is the voxel.
    pub eight_bit: bool,
    pub place: Option<Place>,
    pub up: Up,
    /// Something said which pixels have no data.
    pub nodata_known: bool,
    /// How the file was read, beyond what goes without saying: each a phrase.
    pub rules: Vec<String>,
    pub about: About,
    pub notes: Vec<String>,
}

impl Map {
    /// Heights of which nothing else is known.
    pub fn of(heights: Heights) -> Map {
        Map {
            heights,
            eight_bit: false,
            place: None,
            up: Up::Unsaid,
            nodata_known: false,
            rules: Vec::new(),
            about: About::new(Kind::Terrain, ""),
            notes: Vec::new(),
        }
    }
}

pub(super) fn read(path: &Path, bytes: &[u8], in_file: bool, opts: &ReadOptions) -> Result<Rows> {
    let tiff = bytes.starts_with(b"II") || bytes.starts_with(b"MM");
    let map = match tiff {
        true => guarded(path, "TIFF", || geotiff::read(path, bytes, in_file, opts)),
        false => read_image(path, bytes, in_file, opts),
    }?;
    rows(path, map, bytes.len() as u64, opts)
}

/// Values that files without a word for it use for "no data".
fn stands_for_none(value: f64) -> bool {
    const USUAL: [f64; 7] = [-9999.0, -99_999.0, -999_999.0, -32_768.0, -32_767.0, -2_147_483_648.0, -10_000.0];
    USUAL.contains(&value) || value < -1e6
}

/// What the coordinates of a place without a reference system most likely are, and a word on it.
fn likely(place: &mut Place, width: u32, height: u32) -> Option<String> {
    if place.crs.model != Model::Unknown {
        return None;
    }
    let corners = [place.at(0.0, 0.0), place.at(width.into(), height.into())];
    let degrees = corners.iter().all(|[x, y]| x.abs() <= 360.5 && y.abs() <= 90.5);
    let small = place.affine.iter().all(|[a, b, _]| a.abs().max(b.abs()) <= 2.0);
    let (crs, what) = match degrees && small {
        true => (Crs::degrees(), "degrees"),
        false => (Crs::lengths(Length::metre()), "metres"),
    };
    let (up, down, name) = (place.crs.up.take(), place.crs.down, std::mem::take(&mut place.crs.name));
    place.crs = crs;
    (place.crs.up, place.crs.down, place.crs.name) = (up, down, name);
    Some(format!("coordinates taken as {what}, the file names no reference system"))
}

/// The rows of a world from a map.
pub(super) fn rows(path: &Path, map: Map, input_bytes: u64, opts: &ReadOptions) -> Result<Rows> {
    let Map { mut heights, eight_bit, place, up, mut nodata_known, mut rules, mut about, mut notes } = map;
    if let Some(none) = opts.nodata
        && !nodata_known
    {
        heights.drop(none)?;
        nodata_known = true;
    }
    let mut place = place;
    if let Some(size) = opts.size {
        (heights, place) = resized(heights, place, size, &mut rules)?;
    }
    let Heights { width, height, low, high, .. } = heights;
    if low > high {
        return Err(Error::format(path, "no pixel of the height map has data"));
    }
    let missing = u64::from(width) * u64::from(height) - heights.known;
    if missing > 0 {
        rules.push(match missing {
            1 => "the pixel without data is empty".into(),
            _ => format!("{missing} pixels without data are empty"),
        });
    }
    let base = low.min(0.0);
    if base < 0.0 {
        rules.push(format!("values start at {low}: all are lifted by {}", -base));
    }
    let hint = match stands_for_none(low) && !nodata_known {
        true => format!("; the least value {low} may stand for no data (--nodata {low})"),
        false => String::new(),
    };
    if !hint.is_empty() {
        rules.push(hint.trim_start_matches("; ").to_owned());
    }

    about.axes = "columns are x, rows are z".to_owned();
    rules.extend(place.as_mut().and_then(|p| likely(p, width, height)));
    let place = place.map(|place| {
        let flips = place.flips();
        heights.flips = flips;
        let turn = place.turn();
        about.axes = match (turn != 0.0, flips) {
            (true, _) => format!("columns are x, rows are z, as stored: turned by {turn:.2} degrees from east"),
            (false, [false, false]) => "columns are x (east), rows are z (south)".to_owned(),
            (false, [false, true]) => "columns are x (east), rows from the last on are z (south)".to_owned(),
            (false, [true, false]) => "columns from the last on are x (east), rows are z (south)".to_owned(),
            (false, [true, true]) => "columns and rows from the last on are x (east) and z (south)".to_owned(),
        };
        place.flipped(flips, width, height)
    });
    let ground = place.as_ref().map(|place| place.ground(width, height));
    let stated = match &up {
        Up::Length(unit) => Some(unit.clone()),
        Up::Unsaid => place.as_ref().and_then(|p| p.crs.up.clone()),
        Up::Other(_) => None,
    };
    let unit = stated.clone().unwrap_or_else(Length::metre);
    let mut wide = match ground {
        Some(Ok(ground)) => Some(ground),
        Some(Err(why)) => {
            about.left_out.push(format!("the size of a pixel: {why}"));
            None
        }
        None => None,
    };
    if let Up::Other(unit) = &up {
        rules.push(format!("values are in {unit}, no length"));
        wide = None;
    }
    let scale = match (opts.height_scale, &wide) {
        (Some(s), _) if s.is_finite() && s > 0.0 => s,
        (Some(s), _) => return Err(Error::Argument(format!("--height-scale {s}: expected a number above 0"))),
        (None, Some(ground)) => {
            let scale = unit.metres / ground.metres[0];
            let how = if ground.how.is_empty() { String::new() } else { format!(" ({})", ground.how) };
            notes.push(format!("height scale {scale:.6}: one voxel is as high as a pixel is wide{how}"));
            rules.insert(0, format!("as high as a pixel is wide{how}"));
            scale
        }
        (None, None) if eight_bit => 1.0,
        (None, None) => {
            let most = f64::from(width.max(height)) / 4.0;
            let scale = if high - base > most { most / (high - base) } else { 1.0 };
            let what = format!("height scale {scale:.6}: the pixel size is not known (--height-scale sets it)");
            rules.insert(0, what.clone());
            notes.push(what);
            scale
        }
    };
    // A voxel as wide as a pixel, in the unit of the values: before the relief is exaggerated.
    let side = 1.0 / scale;
    let auto = (opts.show && opts.height_scale.is_none()).then_some(Exaggeration::Auto);
    let shown = opts.exaggeration.or(auto);
    let scale = match shown.map(|e| e.factor((high - low) * scale, width.max(height))) {
        Some(factor) if factor != 1.0 => {
            rules.insert(0, format!("relief {factor} times as high (--exaggeration)"));
            scale * factor
        }
        _ => scale,
    };
    if let Some(ground) = &wide {
        match &stated {
            Some(unit) if unit.name != "m" => rules.push(format!("values in {}", unit.name)),
            Some(_) => {}
            None => rules.push("values taken as metres, the file names no unit".to_owned()),
        }
        let [x, z] = ground.metres;
        (about.voxel, about.unit) = (Some([x, unit.metres / scale, z]), "m".to_owned());
    }
    if let Some(place) = &place {
        let [[a, _, b, c], [d, _, e, f], [_, up, _, low]] = place.world(base, scale);
        notes.push(format!("east = {a} x + {b} z + {c}, north = {d} x + {e} z + {f}, height = {up} y + {low}"));
        about.affine = Some(place.world(base, scale));
        about.crs = place.crs.name.clone();
        rules.extend(Some(place.crs.clash.clone()).filter(|c| !c.is_empty()));
        if place.crs.down {
            rules.push("the reference system counts downwards; values are drawn upwards, as stored".to_owned());
        }
    }
    about.values = Some([low, high]);
    about.rule = rules.join(", ");
    let top = ((high - base) * scale).round();
    if top > 65_535.0 {
        return Err(Error::Limit(format!(
            "{}: the highest value {high} becomes height {top:.0}, at most 65535 can be held; give --height-scale {:e} or less{hint}",
            path.display(),
            65_535.0 / (high - base)
        )));
    }

    let mut water = None;
    if let Some(height) = opts.water {
        let level = ((height - base) * scale).round() + 1.0;
        match level > 1.0 {
            true => water = Some(level.min(65_536.0) as u32),
            false => about.left_out.push(format!("--water {height}: nothing is lower than {base}")),
        }
        about.classes = water.map(|_| Classes::water());
    }
    let top = top.max(f64::from(water.unwrap_or(0)) - 1.0);
    let dims = world_dims(path, [width.into(), top as u64 + 1, height.into()], "")?;
    let heights = Arc::new(heights);
    if opts.show || opts.fractions {
        about.fractions = fractions(&heights, base, scale)?;
    }
    let ramp = opts.ramp.as_deref().or(opts.show.then_some("terrain")).filter(|_| opts.colors.is_none());
    let ramp = ramp.map(Ramp::find).transpose()?.flatten();
    let color = match (&opts.colors, ramp) {
        (Some(path), _) => {
            let flips = heights.flips;
            RowColors::Column(color_map(path, [width, height], place.as_ref(), flips, &mut about, &mut notes)?)
        }
        (None, Some(ramp)) => {
            let pixel = wide.as_ref().map_or([side; 2], |ground| ground.metres.map(|m| m / unit.metres));
            let (table, means, heights) = (ramp.over(low, high), Means::new(&heights)?, Arc::clone(&heights));
            RowColors::Column(Box::new(move |xs: Range<u32>, z, out| {
                let colors = Colors { table: &table, heights: &heights, pixel, means: &means };
                colors.row(xs.start, xs.len() as u32, z, out)
            }))
        }
        (None, None) => RowColors::None,
    };
    let solid = Arc::new(Solid::new(heights, base, scale, dims[1]));
    let rows = Arc::clone(&solid);
    let row = move |xs: Range<u32>, z: u32, columns: &mut ColumnsBuilder| {
        let mut found = vec![0u32; xs.len()];
        rows.row(xs.start, z, &mut found)?;
        for n in found {
            if n > 0 {
                columns.push_run(Run::new(0, (n - 1) as u16));
            }
            columns.end_column();
        }
        Ok(())
    };
    let found: Option<Box<HeightsFn>> = match dims[1] {
        ..=0xFFFF => Some(Box::new(move |x: u32, z, out: &mut [u16]| solid.row(x, z, out))),
        _ => None,
    };
    Ok(Rows { dims, row: Box::new(row), heights: found, color, notes, about, input_bytes, water })
}

/// How many voxels of each column are solid, from 0 up.
struct Solid {
    heights: Arc<Heights>,
    base: f64,
    scale: f64,
    /// Of the highest column.
    most: u32,
    /// Of each 16-bit number that a height is stored as.
    of_words: Vec<u32>,
}

impl Solid {
    fn new(heights: Arc<Heights>, base: f64, scale: f64, most: u32) -> Solid {
        let mut solid = Solid { heights, base, scale, most, of_words: Vec::new() };
        if let Some(words) = solid.heights.words() {
            solid.of_words = (0..=u16::MAX).map(|bits| solid.of(words.value(bits))).collect();
        }
        solid
    }

    /// Of a finite height; `(value - base) * scale` is not negative.
    #[inline]
    fn of(&self, value: f32) -> u32 {
        // None is higher than it was when all were looked at, unless the file changed since.
        let top = ((f64::from(value) - self.base) * self.scale).min(f64::from(self.most));
        // `round`, which is a call to a library: halves go up, and what is left after the whole part is exact.
        let whole = top as u32;
        (whole + u32::from(top - f64::from(whole) >= 0.5) + 1).min(self.most)
    }

    /// Of the columns from `x` on of row `z`.
    fn row<T: Copy + TryFrom<u32>>(&self, x: u32, z: u32, out: &mut [T]) -> Result<()> {
        let fit = |n: u32| T::try_from(n).unwrap_or_else(|_| unreachable!("of a type that holds the highest"));
        if self.of_words.is_empty() {
            let mut values = vec![0.0; out.len()];
            self.heights.row(x, z, &mut values)?;
            let of = |v: f32| fit(if v.is_finite() { self.of(v) } else { 0 });
            out.iter_mut().zip(values).for_each(|(n, v)| *n = of(v));
        } else {
            let mut bits = vec![0; out.len()];
            self.heights.words_of(x, z, &mut bits)?;
            out.iter_mut().zip(bits).for_each(|(n, bits)| *n = fit(self.of_words[usize::from(bits)]));
        }
        Ok(())
    }
}

/// How far the heights are above the columns that stand for them: see [`About::fractions`]. Nothing where none is, or where a
/// table of them would be too large for what it gives.
fn fractions(heights: &Heights, base: f64, scale: f64) -> Result<Arc<[u8]>> {
    let Heights { width, height, .. } = *heights;
    // Whole numbers of voxels stand for themselves.
    let whole = heights.words().is_some() && base.fract() == 0.0 && scale.fract() == 0.0;
    if whole || u64::from(width) * u64::from(height) > MAX_FRACTIONS {
        return Ok(Arc::default());
    }
    let mut out = Vec::with_capacity(width as usize * height as usize);
    let mut row = vec![0.0; width as usize];
    for z in 0..height {
        heights.row(0, z, &mut row)?;
        out.extend(row.iter().map(|&v| {
            let height = (f64::from(v) - base) * scale;
            let above = ((height - height.round()) * 256.0).round() + 128.0;
            if above.is_finite() { above.clamp(0.0, 255.0) as u8 } else { 128 }
        }));
    }
    Ok(if out.iter().all(|f| *f == 128) { Arc::default() } else { out.into() })
}

/// A map with `size` columns along its longer side, as long and wide on the ground as it is.
fn resized(
    heights: Heights,
    place: Option<Place>,
    size: u32,
    rules: &mut Vec<String>,
) -> Result<(Heights, Option<Place>)> {
    let Heights { width, height, .. } = heights;
    let ground = place.as_ref().and_then(|place| place.ground(width, height).ok());
    let [dx, dz] = ground.map_or([1.0; 2], |ground| ground.metres);
    let sides = [f64::from(width) * dx, f64::from(height) * dz];
    let per = f64::from(size) / sides[0].max(sides[1]);
    let [w, h] = sides.map(|side| ((side * per).round() as u32).max(1));
    if [w, h] == [width, height] {
        return Ok((heights, place));
    }
    rules.push(format!("{width} × {height} pixels resampled to {w} × {h} columns"));
    let steps = [f64::from(width) / f64::from(w), f64::from(height) / f64::from(h)];
    let place = place.map(|place| {
        let affine = place.affine.map(|[a, b, c]| [a * steps[0], b * steps[1], c]);
        Place { affine, ..place }
    });
    Ok((relief::resample(&heights, w, h)?, place))
}

/// Decodes an image after checking what it claims against the bytes there are.
pub(super) fn decode(path: &Path, bytes: &[u8]) -> Result<image::DynamicImage> {
    let fail = |e: image::ImageError| Error::format(path, format!("image: {e}"));
    guarded(path, "image", || {
        let reader = || {
            let mut reader = image::ImageReader::new(Cursor::new(bytes)).with_guessed_format()?;
            // The check of plausibility stands in for a fixed limit.
            reader.no_limits();
            Ok(reader)
        };
        let io = |e| Error::io(path, "read", e);
        let (w, h) = reader().map_err(io)?.into_dimensions().map_err(fail)?;
        plausible(path, w, h, bytes.len())?;
        reader().map_err(io)?.decode().map_err(fail)
    })
}

pub(super) fn plausible(path: &Path, w: u32, h: u32, len: usize) -> Result<()> {
    if w == 0 || h == 0 {
        return Err(Error::format(path, format!("an image of {w} × {h} pixels has none")));
    }
    if u64::from(w) * u64::from(h) > (len as u64).saturating_mul(MAX_INFLATION) {
        return Err(Error::format(
            path,
            format!("{len} bytes cannot hold the {w} × {h} pixels that the header claims"),
        ));
    }
    Ok(())
}

/// PNG and JPEG.
fn read_image(path: &Path, bytes: &[u8], in_file: bool, opts: &ReadOptions) -> Result<Map> {
    let png = bytes.starts_with(b"\x89PNG");
    let mut map = None;
    if png {
        map = guarded(path, "image", || png_by_rows(path, stream(path, bytes, in_file)?, bytes.len(), opts))?;
    } else if opts.rgb.is_some() {
        return Err(Error::format(
            path,
            "--rgb wants a PNG: JPEG changes the low bits of colours, which are heights here",
        ));
    }
    let mut map = match map {
        Some(map) => map,
        None => whole(path, &decode(path, bytes)?, opts)?,
    };
    map.about.format = if png { "PNG" } else { "JPEG" }.to_owned();
    let endings: &[&str] = if png { &["pgw", "pngw", "wld"] } else { &["jgw", "jpgw", "jpegw", "wld"] };
    if let Some(affine) = geotiff::world_file(path, endings) {
        let text = geotiff::beside(path, &path.with_extension("prj"));
        map.place = Some(Place { crs: text.and_then(|t| Crs::of_wkt(&t)).unwrap_or_default(), affine });
    }
    map.about.left_out.extend(geotiff::aux_beside(path).map(|name| format!("{name} beside it")));
    Ok(map)
}

/// The height that the samples of a pixel stand for; `wide` ones have 16 bits.
fn height_of(samples: &[u16], wide: bool, opts: &ReadOptions) -> f32 {
    let (color, alpha) = match samples {
        [v] => ([*v; 3], None),
        [v, a] => ([*v; 3], Some(*a)),
        [r, g, b] => ([*r, *g, *b], None),
        [r, g, b, a, ..] => ([*r, *g, *b], Some(*a)),
        [] => ([0; 3], None),
    };
    let [r, g, b] = color;
    match opts.rgb {
        _ if alpha == Some(0) => f32::NAN,
        Some(rgb) => rgb.height([r as u8, g as u8, b as u8]),
        None if r == g && g == b => r.into(),
        // ITU-R BT.709, as the image crate weighs them.
        None => {
            let sum = 2126 * u64::from(r) + 7152 * u64::from(g) + 722 * u64::from(b);
            let value = (sum / 10_000) as f32;
            if wide { value } else { value.min(255.0) }
        }
    }
}

/// A map that is made from rows of an image, each pixel of so many samples.
struct Picture {
    heights: Heights,
    samples: usize,
    wide: bool,
    clear: u64,
    partly: u64,
}

impl Picture {
    fn new(path: &Path, size: [u32; 2], samples: usize, wide: bool, opts: &ReadOptions) -> Result<Picture> {
        if opts.rgb.is_some() && (samples < 3 || wide) {
            let what = if wide { "16-bit samples" } else { "shades of grey" };
            return Err(Error::format(
                path,
                format!("--rgb wants red, green and blue of 8 bits; this image has {what}"),
            ));
        }
        Ok(Picture { heights: Heights::new(size[0], size[1])?, samples, wide, clear: 0, partly: 0 })
    }

    fn row(&mut self, z: u32, row: &[u16], opts: &ReadOptions) -> Result<()> {
        if self.samples.is_multiple_of(2) {
            let most = if self.wide { 65_535 } else { 255 };
            let alpha = || row.iter().skip(self.samples - 1).step_by(self.samples);
            self.clear += alpha().filter(|a| **a == 0).count() as u64;
            self.partly += alpha().filter(|a| **a != 0 && **a != most).count() as u64;
        }
        let values: Vec<f32> = row.chunks_exact(self.samples).map(|p| height_of(p, self.wide, opts)).collect();
        self.heights.put(0, z, self.heights.width, &values)
    }

    fn map(self, opts: &ReadOptions) -> Map {
        let mut map = Map { eight_bit: !self.wide, ..Map::of(self.heights) };
        match opts.rgb {
            Some(rgb) => {
                map.rules.push(format!("heights in colours ({rgb:?}), black has no data"));
                (map.up, map.eight_bit, map.nodata_known) = (Up::Length(Length::metre()), false, true);
            }
            None if self.samples > 2 => {
                map.notes.push("the height map is a colour image: its brightness is the height".to_owned());
                map.rules.push("the brightness of colours is the height (--rgb where colours code heights)".to_owned());
            }
            None => {}
        }
        map.nodata_known |= self.clear > 0;
        if self.clear > 0 {
            map.rules.push("transparent pixels have no data".to_owned());
        }
        if self.partly > 0 {
            map.about.left_out.push(format!("the alpha of {} pixels that are partly transparent", self.partly));
        }
        map
    }
}

/// An image that is unpacked whole.
fn whole(path: &Path, image: &image::DynamicImage, opts: &ReadOptions) -> Result<Map> {
    use image::DynamicImage::{ImageLuma8, ImageLuma16, ImageLumaA8, ImageLumaA16, ImageRgb8, ImageRgb16, ImageRgba8};
    let size = [image.width(), image.height()];
    let picture = |samples: usize, wide: bool, row: &mut dyn FnMut(usize) -> Vec<u16>| {
        let mut picture = Picture::new(path, size, samples, wide, opts)?;
        (0..size[1]).try_for_each(|z| picture.row(z, &row(z as usize), opts))?;
        Ok(picture.map(opts))
    };
    let bytes = |raw: &[u8], n: usize, z: usize| {
        let stride = n * size[0] as usize;
        raw[z * stride..(z + 1) * stride].iter().map(|&v| u16::from(v)).collect()
    };
    let words = |raw: &[u16], n: usize, z: usize| {
        let stride = n * size[0] as usize;
        raw[z * stride..(z + 1) * stride].to_vec()
    };
    match image {
        ImageLuma8(i) => picture(1, false, &mut |z| bytes(i, 1, z)),
        ImageLumaA8(i) => picture(2, false, &mut |z| bytes(i, 2, z)),
        ImageRgb8(i) => picture(3, false, &mut |z| bytes(i, 3, z)),
        ImageRgba8(i) => picture(4, false, &mut |z| bytes(i, 4, z)),
        ImageLuma16(i) => picture(1, true, &mut |z| words(i, 1, z)),
        ImageLumaA16(i) => picture(2, true, &mut |z| words(i, 2, z)),
        ImageRgb16(i) => picture(3, true, &mut |z| words(i, 3, z)),
        other => {
            let i = other.to_rgba16();
            picture(4, true, &mut |z| words(&i, 4, z))
        }
    }
}

/// A PNG row by row; None where it is interlaced.
fn png_by_rows(path: &Path, bytes: Box<dyn Stream + '_>, len: usize, opts: &ReadOptions) -> Result<Option<Map>> {
    let Some(png) = Png::open(path, bytes, len)? else { return Ok(None) };
    let samples = match png.color {
        png::ColorType::Grayscale => 1,
        png::ColorType::GrayscaleAlpha => 2,
        png::ColorType::Rgb => 3,
        png::ColorType::Rgba => 4,
        png::ColorType::Indexed => return Ok(None),
    };
    let wide = png.depth == png::BitDepth::Sixteen;
    let mut picture = Picture::new(path, png.size, samples, wide, opts)?;
    png.rows(path, |z, row| {
        let row: Vec<u16> = match wide {
            true => row.as_chunks().0.iter().map(|&b| u16::from_be_bytes(b)).collect(),
            false => row.iter().map(|&v| v.into()).collect(),
        };
        picture.row(z, &row, opts)
    })?;
    Ok(Some(picture.map(opts)))
}

impl HeightCode {
    /// Metres that a colour stands for; NaN for black.
    pub(super) fn height(self, [r, g, b]: [u8; 3]) -> f32 {
        let [red, green, blue] = [r, g, b].map(f64::from);
        let metres = match self {
            _ if [r, g, b] == [0; 3] => f64::NAN,
            HeightCode::Mapbox => (red * 65_536.0 + green * 256.0 + blue) / 10.0 - 10_000.0,
            HeightCode::Terrarium => red * 256.0 + green + blue / 256.0 - 32_768.0,
        };
        metres as f32
    }
}

/// Colours of the columns from a picture: by coordinates where both have them, else pixel by pixel. `flips` are those of the heights.
fn color_map(
    path: &Path,
    [width, height]: [u32; 2],
    place: Option<&Place>,
    flips: [bool; 2],
    about: &mut About,
    notes: &mut Vec<String>,
) -> Result<Box<ColumnColorsFn>> {
    let pixels = Pixels::read(path)?;
    let (w, h) = (pixels.width, pixels.height);
    if let (Some(heights), Some(colors)) = (place, &pixels.place) {
        let (of_heights, of_colors) = (&heights.crs.name, &colors.crs.name);
        if !of_heights.is_empty() && !of_colors.is_empty() && of_heights != of_colors {
            return Err(Error::Argument(format!(
                "{}: colours lie in {of_colors}, heights in {of_heights}; bring one to the other's with gdalwarp -t_srs",
                path.display()
            )));
        }
        let [[a, b, c], [d, e, f]] = colors.affine;
        let turn = a * e - b * d;
        let heights = heights.clone();
        // The pixel of the colours that has the middle of a column.
        let pixel = move |x: u32, z: u32| {
            let [east, north] = heights.at(f64::from(x) + 0.5, f64::from(z) + 0.5);
            let (east, north) = (east - c, north - f);
            let (column, row) = ((e * east - b * north) / turn, (a * north - d * east) / turn);
            // What lies on an edge is within it, whatever rounding says.
            let within =
                |v: f64, n: u32| (v >= -1e-6 && v < f64::from(n) + 1e-6).then(|| (v.max(0.0) as u32).min(n - 1));
            Some((within(column, w)?, within(row, h)?))
        };
        let steps = |n: u32| (0..n).step_by((n as usize / 64).max(1));
        let looked_at: Vec<bool> =
            steps(height).flat_map(|z| steps(width).map(move |x| (x, z))).map(|(x, z)| pixel(x, z).is_some()).collect();
        let covered = looked_at.iter().filter(|c| **c).count();
        if covered == 0 {
            return Err(Error::Argument(format!(
                "{}: the colour map lies elsewhere: no column has a colour",
                path.display()
            )));
        }
        notes.push(format!("colours of {w} × {h} pixels are laid on by coordinates"));
        if covered < looked_at.len() {
            let without = 100.0 * (1.0 - covered as f64 / looked_at.len() as f64);
            about.left_out.push(format!(
                "colours of {without:.1} % of the columns, to which the colour map does not reach: they are grey"
            ));
        }
        let straight = b == 0.0 && d == 0.0;
        return Ok(Box::new(move |xs, z, out| {
            let mut line: Option<(u32, Vec<Rgb>)> = None;
            for x in xs {
                out.push(match pixel(x, z) {
                    None => UNCOLORED,
                    Some((column, row)) if straight => {
                        if line.as_ref().is_none_or(|(of, _)| *of != row) {
                            line = Some((row, pixels.row(row)?));
                        }
                        line.as_ref().map_or(UNCOLORED, |(_, colors)| colors[column as usize])
                    }
                    Some((column, row)) => pixels.pixel(column, row)?,
                });
            }
            Ok(())
        }));
    }
    if (w, h) != (width, height) {
        notes.push(format!("the colour map has {w} × {h} pixels, the height map {width} × {height}: nearest pixels"));
    }
    let nearest = |i: u32, n: u32, m: u32| ((2 * u64::from(i) + 1) * u64::from(m) / (2 * u64::from(n))) as u32;
    // Pixels lie as the heights do in their file.
    let flipped = |i: u32, n: u32, flip: bool| if flip { n - 1 - i } else { i };
    Ok(Box::new(move |xs, z, out| {
        let row = pixels.row(nearest(flipped(z, height, flips[1]), height, h))?;
        out.extend(xs.map(|x| row[nearest(flipped(x, width, flips[0]), width, w) as usize]));
        Ok(())
    }))
}
