//! Grids of heights that are no images: ESRI ASCII grids, SRTM tiles, square files of 16-bit heights.

use std::io::Read;
use std::path::Path;

use super::geo::{Crs, Length, Model, Place};
use super::geotiff::beside;
use super::heightmap::{Map, Up};
use super::heights::Heights;
use super::{Dtype, ReadOptions};
use crate::model::about::Kind;
use crate::{About, Error, Result};

/// Head of an ESRI ASCII grid.
pub(super) struct AscHead {
    pub size: [u32; 2],
    /// West and south edge, sides of a cell.
    corner: [f64; 2],
    cell: [f64; 2],
    nodata: Option<f64>,
    /// Where the values start.
    at: usize,
}

/// Whether a text begins as an ESRI ASCII grid does.
pub(super) fn is_asc(head: &[u8]) -> bool {
    let head = head.strip_prefix(b"\xef\xbb\xbf").unwrap_or(head);
    let mut words = Words { bytes: &head[..head.len().min(1024)], at: 0 };
    let key = words.next().map(|(_, word)| word.to_ascii_lowercase());
    let first =
        matches!(key.as_deref(), Some(b"ncols" | b"nrows" | b"xllcorner" | b"xllcenter" | b"yllcorner" | b"cellsize"));
    first && words.next().is_some_and(|(_, word)| number(word).is_some())
}

/// Words between white space, each with its place.
struct Words<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Iterator for Words<'a> {
    type Item = (usize, &'a [u8]);

    fn next(&mut self) -> Option<(usize, &'a [u8])> {
        let blank = |b: &u8| b.is_ascii_whitespace() || *b == 0;
        let rest = self.bytes.get(self.at..)?;
        let from = self.at + rest.iter().position(|b| !blank(b))?;
        let n = self.bytes[from..].iter().position(blank).unwrap_or(self.bytes.len() - from);
        self.at = from + n;
        Some((from, &self.bytes[from..from + n]))
    }
}

/// A number with a point or, as some countries' programs write it, a comma.
fn number(word: &[u8]) -> Option<f64> {
    let text = std::str::from_utf8(word).ok()?;
    text.parse().ok().or_else(|| text.replacen(',', ".", 1).parse().ok())
}

pub(super) fn asc_head(path: &Path, bytes: &[u8]) -> Result<AscHead> {
    let fault = |at: usize, what: String| Error::format(path, format!("byte {at}: ESRI ASCII grid: {what}"));
    let bom = if bytes.starts_with(b"\xef\xbb\xbf") { 3 } else { 0 };
    let mut words = Words { bytes, at: bom };
    let (mut size, mut corner, mut cell, mut nodata) = ([None; 2], [None; 2], [None; 2], None);
    let mut centre = [false; 2];
    loop {
        let before = words.at;
        let Some((at, word)) = words.next() else {
            return Err(fault(before, "it ends before the first value".to_owned()));
        };
        let key = String::from_utf8_lossy(&word[..word.len().min(16)]).to_lowercase();
        let known = ["ncols", "nrows", "cellsize", "dx", "dy", "xdim", "ydim", "nodata_value", "nodata"];
        if !known.contains(&key.as_str()) && !key.starts_with("xll") && !key.starts_with("yll") {
            if number(word).is_none() {
                return Err(fault(
                    at,
                    format!(
                        "{key:?}; ncols, nrows, xllcorner, yllcorner, cellsize, NODATA_value or a height was expected"
                    ),
                ));
            }
            words.at = at;
            break;
        }
        let value = words.next().and_then(|(_, word)| number(word));
        let value = value.ok_or_else(|| fault(at, format!("a number was expected after {key}")))?;
        match key.as_str() {
            "ncols" => size[0] = Some(value),
            "nrows" => size[1] = Some(value),
            "xllcorner" => corner[0] = Some(value),
            "yllcorner" => corner[1] = Some(value),
            "xllcenter" | "xllcentre" => (corner[0], centre[0]) = (Some(value), true),
            "yllcenter" | "yllcentre" => (corner[1], centre[1]) = (Some(value), true),
            "cellsize" => cell = [Some(value); 2],
            "dx" | "xdim" => cell[0] = Some(value),
            "dy" | "ydim" => cell[1] = Some(value),
            _ => nodata = Some(value),
        }
    }
    let need = |value: Option<f64>, what: &str| value.ok_or_else(|| fault(bom, format!("no {what} in the head")));
    let sides = [need(size[0], "ncols")?, need(size[1], "nrows")?];
    // A value and a blank are two bytes at least.
    if sides.iter().any(|n| n.fract() != 0.0 || *n < 1.0) || sides[0] * sides[1] > bytes.len() as f64 / 2.0 + 1.0 {
        return Err(fault(bom, format!("{} × {} cells in {} bytes", sides[0], sides[1], bytes.len())));
    }
    let cell = [need(cell[0], "cellsize")?, need(cell[1], "cellsize")?];
    if !cell.iter().all(|c| *c > 0.0 && c.is_finite()) {
        return Err(fault(bom, format!("cells of {} × {}", cell[0], cell[1])));
    }
    let mut corner = [need(corner[0], "xllcorner")?, need(corner[1], "yllcorner")?];
    for i in 0..2 {
        corner[i] -= if centre[i] { cell[i] / 2.0 } else { 0.0 };
    }
    if !corner.iter().all(|c| c.is_finite()) {
        return Err(fault(bom, format!("a corner at {}, {}", corner[0], corner[1])));
    }
    Ok(AscHead { size: sides.map(|n| n as u32), corner, cell, nodata, at: words.at })
}

/// Where an ESRI ASCII grid lies; its reference system is in a file `.prj` beside it, if anywhere.
pub(super) fn asc_place(path: &Path, head: &AscHead) -> Place {
    let text = beside(path, &path.with_extension("prj"));
    let crs = text.and_then(|t| Crs::of_wkt(&t)).unwrap_or_default();
    let north = head.corner[1] + head.cell[1] * f64::from(head.size[1]);
    Place::north_up(crs, [head.corner[0], north], head.cell)
}

/// An ESRI ASCII grid: rows from north to south.
pub(super) fn asc(path: &Path, bytes: &[u8], opts: &ReadOptions) -> Result<Map> {
    let head = asc_head(path, bytes)?;
    let fault = |at: usize, what: String| Error::format(path, format!("byte {at}: ESRI ASCII grid: {what}"));
    let [width, height] = head.size;
    let nodata = opts.nodata.or(head.nodata);
    // The value that stands for "none" where a head names none (ESRI's own default).
    let none = nodata.unwrap_or(-9999.0);
    let mut heights = Heights::new(width, height)?;
    let mut words = Words { bytes, at: head.at };
    let mut row = vec![0.0f32; width as usize];
    let mut by_default = false;
    for z in 0..height {
        for (x, out) in row.iter_mut().enumerate() {
            let Some((at, word)) = words.next() else {
                return Err(fault(bytes.len(), format!("it ends in row {z}, column {x} of {height} × {width}")));
            };
            // As some C libraries write what is no number.
            let value = number(word).or_else(|| word.windows(2).any(|w| w.starts_with(b"#")).then_some(f64::NAN));
            let Some(value) = value else {
                let text = String::from_utf8_lossy(&word[..word.len().min(32)]).into_owned();
                return Err(fault(at, format!("{text:?} in row {z}, column {x}; a height was expected")));
            };
            by_default |= value == none && nodata.is_none();
            *out = if value == none { f32::NAN } else { value as f32 };
        }
        heights.put(0, z, width, &row)?;
    }
    let mut about = About::new(Kind::Terrain, "ESRI ASCII grid");
    if let Some((at, _)) = words.next() {
        about.left_out.push(format!("what follows the grid, from byte {at} on"));
    }
    let rules = by_default.then(|| "-9999 stands for no data, the format's default".to_owned()).into_iter().collect();
    Ok(Map { place: Some(asc_place(path, &head)), nodata_known: true, rules, about, ..Map::of(heights) })
}

/// Sides of an SRTM tile, in samples, and its place where the name has it.
pub(super) fn hgt_place(path: &Path, bytes: u64) -> Result<([u32; 2], Option<Place>)> {
    let samples = bytes / 2;
    let side = samples.isqrt();
    let [wide, high] = match bytes % 2 {
        0 if side * side == samples && (2..=21_601).contains(&side) => [side, side],
        // North of 50 degrees one second tiles may have every second column.
        0 if samples == 1801 * 3601 => [1801, 3601],
        _ => {
            let what = "an SRTM tile is a square of 16-bit heights (1201 or 3601 a side)";
            return Err(Error::format(path, format!("{bytes} bytes; {what}")));
        }
    };
    let step = [wide, high].map(|n| 1.0 / (n - 1) as f64);
    // N46E007: its south-western sample.
    let name = path.file_name().map(|n| n.to_string_lossy().to_uppercase()).unwrap_or_default();
    let name = name.as_bytes();
    let digits = |from: usize, to: usize| -> Option<f64> {
        let part = name.get(from..to)?;
        part.iter().all(u8::is_ascii_digit).then(|| std::str::from_utf8(part).ok()?.parse().ok())?
    };
    let sign = |at: usize, plus: u8, minus: u8| match name.get(at) {
        Some(c) if *c == plus => Some(1.0),
        Some(c) if *c == minus => Some(-1.0),
        _ => None,
    };
    let corner = || {
        let south = sign(0, b'N', b'S')? * digits(1, 3)?;
        let west = sign(3, b'E', b'W')? * digits(4, 7)?;
        Some([west - step[0] / 2.0, south + 1.0 + step[1] / 2.0])
    };
    let place = corner().map(|at| Place::north_up(Crs::epsg(4326, Model::Geographic), at, step));
    Ok(([wide as u32, high as u32], place))
}

/// An SRTM tile: 16-bit heights in metres, most significant byte first, rows from north to south; also packed by gzip.
pub(super) fn hgt(path: &Path, bytes: &[u8], opts: &ReadOptions) -> Result<Map> {
    const LIMIT: u64 = 2 * 21_601 * 21_601 + 2;
    let mut unpacked = Vec::new();
    let bytes = match bytes.starts_with(b"\x1f\x8b") {
        true => {
            let unpack = flate2::read::MultiGzDecoder::new(bytes).take(LIMIT).read_to_end(&mut unpacked);
            unpack.map_err(|e| Error::format(path, format!("gzip: {e}")))?;
            &unpacked[..]
        }
        false => bytes,
    };
    let ([width, height], place) = hgt_place(path, bytes.len() as u64)?;
    let mut heights = Heights::new(width, height)?;
    for (z, row) in bytes.chunks_exact(2 * width as usize).enumerate() {
        let value = |&b: &[u8; 2]| match f32::from(i16::from_be_bytes(b)) {
            v if f64::from(v) == opts.nodata.unwrap_or(-32_768.0) => f32::NAN,
            v => v,
        };
        let row: Vec<f32> = row.as_chunks::<2>().0.iter().map(value).collect();
        heights.put(0, z as u32, width, &row)?;
    }
    let mut map = Map {
        up: Up::Length(Length::metre()),
        nodata_known: true,
        about: About::new(Kind::Terrain, "SRTM HGT"),
        ..Map::of(heights)
    };
    map.place = place;
    if map.place.is_none() {
        map.rules.push("the name says no place (N46E007.hgt does)".to_owned());
    }
    Ok(map)
}

/// A square of 16-bit heights without a head, least significant byte first; `--dims X,Y` where it is no square.
pub(super) fn r16(path: &Path, bytes: &[u8], opts: &ReadOptions) -> Result<Map> {
    let samples = bytes.len() as u64 / 2;
    let side = samples.isqrt();
    let [width, height] = match opts.dims {
        Some([x, y, 0 | 1]) if x.checked_mul(y) == Some(samples) && bytes.len().is_multiple_of(2) => [x, y],
        Some([x, y, z]) => {
            let z = if z > 1 { format!(" × {z}") } else { String::new() };
            let what = format!("{x} × {y}{z} heights of 16 bits, the file has {} bytes", bytes.len());
            return Err(Error::format(path, format!("--dims: {what}; expected --dims X,Y with 2 · X · Y bytes")));
        }
        None if side * side == samples && samples > 0 && bytes.len().is_multiple_of(2) => [side, side],
        None => {
            let what = format!("{} bytes are no square of 16-bit heights", bytes.len());
            return Err(Error::format(path, format!("{what}; give --dims X,Y")));
        }
    };
    let signed = match opts.dtype {
        None | Some(Dtype::U16) => false,
        Some(Dtype::I16) => true,
        Some(other) => {
            return Err(Error::Argument(format!(
                "--dtype {other:?}: {} has heights of 16 bits: u16 or i16",
                path.display()
            )));
        }
    };
    let [width, height] = [u32::try_from(width), u32::try_from(height)];
    let (Ok(width), Ok(height)) = (width, height) else {
        return Err(Error::format(path, "a side of more than 32 bits"));
    };
    let mut heights = Heights::new(width, height)?;
    for (z, row) in bytes.chunks_exact(2 * width as usize).enumerate() {
        let value =
            |&b: &[u8; 2]| if signed { f32::from(i16::from_le_bytes(b)) } else { f32::from(u16::from_le_bytes(b)) };
        let row: Vec<f32> = row.as_chunks::<2>().0.iter().map(value).collect();
        heights.put(0, z as u32, width, &row)?;
    }
    Ok(Map { about: About::new(Kind::Terrain, "RAW16"), ..Map::of(heights) })
}

#[cfg(test)]
mod tests;
