//! Height maps: PNG, JPEG, TIFF, GeoTIFF, with or without a colour map.
//!
//! Image column is x, row is z. A column is solid for 0 ≤ y ≤ round(S · value); a pixel without data (GDAL's no-data
//! value, NaN, infinity) is an empty column. S is `--height-scale`, or else
//!
//! - 1 for 8-bit values without a place on Earth;
//! - for a GeoTIFF with a pixel size: one voxel is as high as a pixel is wide. Values are metres unless the file says
//!   feet. Degrees become metres at the latitude of the image's centre;
//! - for other 16-bit or float values 1, or less, so that the highest is a quarter of the longer side at most.
//!
//! NPY arrays of two axes and USGS DEMs are height maps, too; a folder of GeoTIFF tiles is one.
//!
//! Values below 0 (sea floor) lift the whole map so that its lowest value is 0; otherwise nothing is subtracted.

use std::io::Cursor;
use std::ops::Range;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::Tag;

use super::heights::Heights;
use super::pixels::{Pixels, Png, Stream, stream};
use super::{ReadOptions, guarded, map, world_dims};
use crate::pieces::{ColumnColorsFn, RowColors, Rows};
use crate::{About, ColumnsBuilder, Error, Result, Run};

/// No compression of these formats makes more than about a thousand bytes of one: an image that claims more is not
/// worth asking memory for.
const MAX_INFLATION: u64 = 1100;

/// Metres a degree of latitude (WGS 84, mean).
const METRES_PER_DEGREE: f64 = 111_320.0;

/// A map as a file holds it.
struct Map {
    heights: Heights,
    /// Eight-bit values, whose unit is the voxel.
    eight_bit: bool,
    /// Width of a pixel in units of the values, and how that was found.
    pixel: Option<(f64, String)>,
    notes: Vec<String>,
}

pub(super) fn read(path: &Path, bytes: &[u8], in_file: bool, opts: &ReadOptions) -> Result<Rows> {
    let tiff = bytes.starts_with(b"II") || bytes.starts_with(b"MM");
    let map = match tiff {
        true => guarded(path, "TIFF", || read_tiff(path, stream(path, bytes, in_file)?, bytes.len())),
        false => read_image(path, bytes, in_file),
    }?;
    rows(path, map, bytes.len() as u64, opts)
}

/// A grid of heights that were read elsewhere; `pixel` is the width of a pixel in their unit, if known.
pub(super) fn of_heights(
    path: &Path,
    heights: Heights,
    pixel: Option<f64>,
    input_bytes: u64,
    opts: &ReadOptions,
) -> Result<Rows> {
    let pixel = pixel.map(|width| (width, format!("{width:.2} m")));
    rows(path, Map { heights, eight_bit: false, pixel, notes: Vec::new() }, input_bytes, opts)
}

/// GeoTIFF tiles of one grid, put together by the places that they state; what no tile covers has no data.
pub(super) fn mosaic(path: &Path, files: &[PathBuf], opts: &ReadOptions) -> Result<Rows> {
    let mut tiles = Vec::new();
    let mut input_bytes = 0;
    for file in files {
        let bytes = map(file)?;
        input_bytes += bytes.len() as u64;
        let (place, size) = guarded(file, "TIFF", || geo_place(file, stream(file, &bytes, true)?, bytes.len()))?;
        let place = place.ok_or_else(|| Error::format(file, "no place on Earth; every tile of a mosaic needs one"))?;
        tiles.push((file, place, size));
    }
    let Some(&(_, GeoPlace { step, .. }, _)) = tiles.first() else {
        return Err(Error::format(path, "no GeoTIFF tiles"));
    };
    if let Some((file, place, _)) = tiles.iter().find(|t| (0..2).any(|i| (t.1.step[i] / step[i] - 1.0).abs() > 1e-6)) {
        return Err(Error::format(*file, format!("pixels of {:?}, those of the first tile are {step:?}", place.step)));
    }
    let west = tiles.iter().map(|t| t.1.corner[0]).fold(f64::INFINITY, f64::min);
    let north = tiles.iter().map(|t| t.1.corner[1]).fold(f64::NEG_INFINITY, f64::max);
    let at =
        |place: &GeoPlace| [(place.corner[0] - west) / step[0], (north - place.corner[1]) / step[1]].map(f64::round);
    let ends = tiles.iter().map(|(_, place, size)| [0, 1].map(|i| at(place)[i] + f64::from(size[i])));
    let [width, height] = ends.fold([0.0, 0.0], |a: [f64; 2], b| [a[0].max(b[0]), a[1].max(b[1])]);
    let dims = world_dims(path, [width as u64, 1, height as u64], "")?;
    let mut all = Heights::new(dims[0], dims[2])?;
    all.clear()?;
    let (mut pixel, mut notes) = (None, vec![format!("{} tiles, {width} × {height} pixels", tiles.len())]);
    for (file, place, _) in &tiles {
        let bytes = map(file)?;
        let tile = guarded(file, "TIFF", || read_tiff(file, stream(file, &bytes, true)?, bytes.len()))?;
        let mut row = vec![0.0; tile.heights.width as usize];
        let [x, z] = at(place).map(|v| v as u32);
        for i in 0..tile.heights.height {
            tile.heights.row(0, i, &mut row)?;
            all.put(x, z + i, tile.heights.width, &row)?;
        }
        if pixel.is_none() {
            (pixel, notes) = (tile.pixel, [notes, tile.notes].concat());
        }
    }
    rows(path, Map { heights: all, eight_bit: false, pixel, notes }, input_bytes, opts)
}

/// Where a GeoTIFF lies: its north-western corner and the sides of a pixel.
#[derive(Clone, Copy, Debug)]
struct GeoPlace {
    corner: [f64; 2],
    step: [f64; 2],
}

fn geo_place(path: &Path, bytes: Box<dyn Stream + '_>, len: usize) -> Result<(Option<GeoPlace>, [u32; 2])> {
    let fail = |e: tiff::TiffError| Error::format(path, format!("TIFF: {e}"));
    let mut decoder = Decoder::new(bytes).map_err(fail)?;
    let (width, height) = decoder.dimensions().map_err(fail)?;
    plausible(path, width, height, len)?;
    let mut doubles = |t: Tag| tag(&mut decoder, t).and_then(|v| v.into_f64_vec().ok()).unwrap_or_default();
    let (scale, tie) = (doubles(Tag::ModelPixelScaleTag), doubles(Tag::ModelTiepointTag));
    let place = match (scale.as_slice(), tie.as_slice()) {
        (&[sx, sy, ..], &[column, row, _, x, y, ..]) if sx > 0.0 && sy > 0.0 => {
            Some(GeoPlace { corner: [x - column * sx, y + row * sy], step: [sx, sy] })
        }
        _ => None,
    };
    Ok((place, [width, height]))
}

/// Whether a TIFF says where on Earth it lies.
pub(super) fn is_geographic(path: &Path, bytes: &[u8]) -> bool {
    guarded(path, "TIFF", || geo_place(path, stream(path, bytes, false)?, bytes.len()))
        .is_ok_and(|(place, _)| place.is_some())
}

fn rows(path: &Path, map: Map, input_bytes: u64, opts: &ReadOptions) -> Result<Rows> {
    let Map { heights, eight_bit, pixel, mut notes } = map;
    let Heights { width, height, low, high, .. } = heights;
    if low > high {
        return Err(Error::format(path, "no pixel of the height map has data"));
    }
    let missing = u64::from(width) * u64::from(height) - heights.known;
    if missing > 0 {
        notes.push(format!("{missing} pixels without data are empty columns"));
    }
    let base = low.min(0.0);
    if base < 0.0 {
        notes.push(format!("values start at {low}; all are lifted by {}", -base));
    }
    let scale = match (opts.height_scale, &pixel) {
        (Some(s), _) if s.is_finite() && s > 0.0 => s,
        (Some(s), _) => return Err(Error::Argument(format!("--height-scale {s}: expected a number above 0"))),
        (None, Some((pixel, how))) => {
            notes.push(format!("height scale {:.6}: one voxel is as high as a pixel is wide ({how})", 1.0 / pixel));
            1.0 / pixel
        }
        (None, None) if eight_bit => 1.0,
        (None, None) => {
            let most = f64::from(width.max(height)) / 4.0;
            let scale = if high - base > most { most / (high - base) } else { 1.0 };
            notes.push(format!("height scale {scale:.6}: the pixel size is not known (--height-scale sets it)"));
            scale
        }
    };
    let top = ((high - base) * scale).round();
    if top > 65_535.0 {
        return Err(Error::Limit(format!(
            "{}: the highest value {high} becomes height {top:.0}, at most 65535 can be held; give --height-scale {:e} or less",
            path.display(),
            65_535.0 / (high - base)
        )));
    }

    let dims = world_dims(path, [width.into(), top as u64 + 1, height.into()], "")?;
    let color = match &opts.colors {
        Some(path) => RowColors::Column(color_map(path, width, height, &mut notes)?),
        None => RowColors::None,
    };
    let row = move |xs: Range<u32>, z: u32, columns: &mut ColumnsBuilder| {
        let mut values = vec![0.0; xs.len()];
        heights.row(xs.start, z, &mut values)?;
        for value in values {
            if value.is_finite() {
                columns.push_run(Run::new(0, ((f64::from(value) - base) * scale).round() as u16));
            }
            columns.end_column();
        }
        Ok(())
    };
    Ok(Rows { dims, row: Box::new(row), color, notes, about: About::default(), input_bytes })
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
fn read_image(path: &Path, bytes: &[u8], in_file: bool) -> Result<Map> {
    use image::DynamicImage::{ImageLuma8, ImageLuma16, ImageLumaA8, ImageLumaA16, ImageRgb16, ImageRgba16};
    if bytes.starts_with(b"\x89PNG")
        && let Some(map) = guarded(path, "image", || read_grey_png(path, stream(path, bytes, in_file)?, bytes.len()))?
    {
        return Ok(map);
    }
    let image = decode(path, bytes)?;
    let (width, height) = (image.width(), image.height());
    let mut notes = Vec::new();
    if image.color().has_color() {
        notes.push("the height map is a colour image: its brightness is the height".to_owned());
    }
    let eight_bit = !matches!(image, ImageLuma16(_) | ImageLumaA16(_) | ImageRgb16(_) | ImageRgba16(_));
    let values: Vec<f32> = match image {
        ImageLuma8(i) => i.iter().map(|&v| f32::from(v)).collect(),
        ImageLumaA8(i) => i.pixels().map(|p| f32::from(p.0[0])).collect(),
        i if eight_bit => i.to_luma8().iter().map(|&v| f32::from(v)).collect(),
        i => i.to_luma16().iter().map(|&v| f32::from(v)).collect(),
    };
    Ok(Map { heights: Heights::of(width, height, &values)?, eight_bit, pixel: None, notes })
}

/// A PNG of brightness alone, row by row; None for others.
fn read_grey_png(path: &Path, bytes: Box<dyn Stream + '_>, len: usize) -> Result<Option<Map>> {
    let Some(png) = Png::open(path, bytes, len)? else { return Ok(None) };
    let samples = match png.color {
        png::ColorType::Grayscale => 1,
        png::ColorType::GrayscaleAlpha => 2,
        _ => return Ok(None),
    };
    let [width, height] = png.size;
    let eight_bit = png.depth != png::BitDepth::Sixteen;
    let mut heights = Heights::new(width, height)?;
    png.rows(path, |z, row| {
        let values: Vec<f32> = match eight_bit {
            true => row.chunks_exact(samples).map(|p| f32::from(p[0])).collect(),
            false => row.chunks_exact(2 * samples).map(|p| f32::from(u16::from_be_bytes([p[0], p[1]]))).collect(),
        };
        heights.put(0, z, width, &values)
    })?;
    Ok(Some(Map { heights, eight_bit, pixel: None, notes: Vec::new() }))
}

/// TIFF and GeoTIFF, a strip or a tile of it at a time.
fn read_tiff(path: &Path, bytes: Box<dyn Stream + '_>, len: usize) -> Result<Map> {
    let fail = |e: tiff::TiffError| Error::format(path, format!("TIFF: {e}"));
    let mut decoder = Decoder::new(bytes).map_err(fail)?;
    let (width, height) = decoder.dimensions().map_err(fail)?;
    plausible(path, width, height, len)?;
    let color = decoder.colortype().map_err(fail)?;
    let tiff::ColorType::Gray(bits) = color else {
        return Err(Error::format(path, format!("TIFF of {color:?}; a height map has one value a pixel")));
    };
    // The size is plausible by now, so the decoder's own limit (256 MiB) may follow it.
    let mut limits = Limits::default();
    limits.decoding_buffer_size = (u64::from(width) * u64::from(height) * 8).max(1 << 20) as usize;
    limits.intermediate_buffer_size = limits.decoding_buffer_size;
    limits.ifd_value_size = len;
    decoder = decoder.with_limits(limits);
    let mut notes = Vec::new();
    let nodata: Option<f64> = tag(&mut decoder, Tag::GdalNodata)
        .and_then(|v| v.into_string().ok())
        .and_then(|s| s.trim_matches(['\0', ' ']).parse().ok());
    let pixel = pixel_width(&mut decoder, height, &mut notes);
    let (wide, high) = decoder.chunk_dimensions();
    let across = width.div_ceil(wide.max(1));
    let mut heights = Heights::new(width, height)?;
    for chunk in 0..across * height.div_ceil(high.max(1)) {
        let values: Vec<f32> = match decoder.read_chunk(chunk).map_err(fail)? {
            DecodingResult::U8(v) => floats(&v, nodata, |v| v.into()),
            DecodingResult::I8(v) => floats(&v, nodata, |v| v.into()),
            DecodingResult::U16(v) => floats(&v, nodata, |v| v.into()),
            DecodingResult::I16(v) => floats(&v, nodata, |v| v.into()),
            DecodingResult::U32(v) => floats(&v, nodata, |v| v.into()),
            DecodingResult::I32(v) => floats(&v, nodata, |v| v.into()),
            // The tag's text may be the f32 value with more digits or fewer.
            DecodingResult::F32(v) => floats(&v, nodata.map(|n| f64::from(n as f32)), |v| v.into()),
            DecodingResult::F64(v) => floats(&v, nodata, |v| v),
            _ => return Err(Error::format(path, "TIFF of 64-bit integers or half floats; convert it to f32")),
        };
        let (w, h) = decoder.chunk_data_dimensions(chunk);
        if values.len() as u64 != u64::from(w) * u64::from(h) {
            return Err(Error::format(path, format!("TIFF: {} values for {w} × {h} pixels", values.len())));
        }
        heights.put(chunk % across * wide, chunk / across * high, w, &values)?;
    }
    if decoder.more_images() {
        notes.push("the TIFF has further pages (overviews, a stack); the first is read".to_owned());
    }
    Ok(Map { heights, eight_bit: bits <= 8, pixel, notes })
}

fn floats<T: Copy + Sync>(values: &[T], nodata: Option<f64>, to_f64: impl Fn(T) -> f64 + Sync) -> Vec<f32> {
    let value = |&v: &T| match to_f64(v) {
        v if Some(v) == nodata => f32::NAN,
        v => v as f32,
    };
    values.par_iter().map(value).collect()
}

/// A tag's value, if the file has it and it is sound.
fn tag(decoder: &mut Decoder<Box<dyn Stream + '_>>, tag: Tag) -> Option<tiff::decoder::ifd::Value> {
    decoder.find_tag(tag).ok().flatten()
}

/// Width of a pixel in units of the values, from the geo tags.
fn pixel_width(
    decoder: &mut Decoder<Box<dyn Stream + '_>>,
    height: u32,
    notes: &mut Vec<String>,
) -> Option<(f64, String)> {
    let doubles = |v: tiff::decoder::ifd::Value| v.into_f64_vec().ok();
    let scale = tag(decoder, Tag::ModelPixelScaleTag).and_then(doubles)?;
    let &[sx, sy, ..] = scale.as_slice() else { return None };
    let tie = tag(decoder, Tag::ModelTiepointTag).and_then(doubles).unwrap_or_default();
    let keys = tag(decoder, Tag::GeoKeyDirectoryTag).and_then(|v| v.into_u16_vec().ok()).unwrap_or_default();
    // Entries of four: key, where its value is (0: here), count, value; the first entry is the directory's head.
    let key = |id: u16| keys.as_chunks::<4>().0.iter().skip(1).find(|k| k[0] == id && k[1] == 0).map(|k| k[3]);
    let metres = |unit: Option<u16>| match unit {
        Some(9002) => 0.3048,
        Some(9003) => 1200.0 / 3937.0,
        _ => 1.0,
    };
    const MODEL_TYPE: u16 = 1024;
    const LINEAR_UNITS: u16 = 3076;
    const VERTICAL_UNITS: u16 = 4099;
    let unit_up = metres(key(VERTICAL_UNITS));
    let (wide, how) = match key(MODEL_TYPE) {
        Some(2) => {
            let latitude = match tie.as_slice() {
                &[_, row, _, _, y, ..] => y - sy * (f64::from(height) / 2.0 - row),
                _ => 0.0,
            };
            if !(-90.0..90.0).contains(&latitude) {
                return None;
            }
            let wide = sx * METRES_PER_DEGREE * latitude.to_radians().cos();
            notes.push(format!(
                "pixels of {sx} × {sy} degrees are {wide:.2} m west-east and {:.2} m north-south; drawn square",
                sy * METRES_PER_DEGREE
            ));
            (wide, format!("{sx} degrees at latitude {latitude:.3}, {wide:.2} m"))
        }
        Some(1) => {
            let wide = sx * metres(key(LINEAR_UNITS));
            (wide, format!("{wide:.2} m"))
        }
        _ => return None,
    };
    let wide = wide / unit_up;
    (wide.is_finite() && wide > 0.0).then_some((wide, how))
}

/// The colour of a column: the nearest pixel of the colour map.
/// Colours by nearest pixel: that which holds the centre of the column.
fn color_map(path: &Path, width: u32, height: u32, notes: &mut Vec<String>) -> Result<Box<ColumnColorsFn>> {
    let pixels = Pixels::read(path)?;
    let (w, h) = (pixels.width, pixels.height);
    if (w, h) != (width, height) {
        notes.push(format!("the colour map has {w} × {h} pixels, the height map {width} × {height}: nearest pixels"));
    }
    let nearest = |i: u32, n: u32, m: u32| ((2 * u64::from(i) + 1) * u64::from(m) / (2 * u64::from(n))) as u32;
    Ok(Box::new(move |xs, z, out| {
        let row = pixels.row(nearest(z, height, h))?;
        out.extend(xs.map(|x| row[nearest(x, width, w) as usize]));
        Ok(())
    }))
}
