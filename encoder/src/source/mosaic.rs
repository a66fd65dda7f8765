//! Tiles of one grid, put together by the places that they state: GeoTIFFs, ESRI ASCII grids, SRTM tiles.
//!
//! Where tiles overlap, the first one by name that has data counts; no-data of one never hides another's data. Tiles must share
//! reference system, unit of heights and size of pixels. What no tile covers has no data.

use std::path::{Path, PathBuf};

use super::geo::{Length, Model, Place};
use super::heightmap::{self, Map, Up};
use super::heights::Heights;
use super::pixels::stream;
use super::{ReadOptions, geotiff, grids, guarded, map, world_dims};
use crate::model::pieces::Rows;
use crate::{Error, Result};

/// How far a tile may be off the grid of the first, in pixels, before it is said.
const OFF_GRID: f64 = 0.01;

struct Tile<'a> {
    file: &'a Path,
    /// North up, columns to the east.
    place: Place,
    flips: [bool; 2],
    size: [u32; 2],
    /// First column and row, counted from the first tile's.
    at: [i64; 2],
}

fn ending(path: &Path) -> String {
    path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default()
}

/// Whether a file of a folder is a tile of a map.
pub(super) fn is_tile(path: &Path) -> Result<bool> {
    Ok(matches!(ending(path).as_str(), "asc" | "hgt") || geotiff::is_geographic(path, &map(path)?))
}

fn survey(file: &Path) -> Result<Tile<'_>> {
    let bytes = map(file)?;
    let (place, size) = match ending(file).as_str() {
        "asc" => {
            let head = grids::asc_head(file, &bytes)?;
            (Some(grids::asc_place(file, &head)), head.size)
        }
        "hgt" => {
            let (size, place) = grids::hgt_place(file, bytes.len() as u64)?;
            (place, size)
        }
        _ => guarded(file, "TIFF", || geotiff::survey(file, &bytes, true))?,
    };
    let place = place.ok_or_else(|| Error::format(file, "no place on Earth; every tile of a mosaic needs one"))?;
    if place.turn() != 0.0 {
        let what = format!("turned by {:.2} degrees", place.turn());
        return Err(Error::format(file, format!("{what}; warp the tiles of a mosaic to north up first")));
    }
    let flips = place.flips();
    Ok(Tile { file, place: place.flipped(flips, size[0], size[1]), flips, size, at: [0; 2] })
}

fn read(file: &Path, opts: &ReadOptions) -> Result<Map> {
    let bytes = map(file)?;
    match ending(file).as_str() {
        "asc" => grids::asc(file, &bytes, opts),
        "hgt" => grids::hgt(file, &bytes, opts),
        _ => guarded(file, "TIFF", || geotiff::read(file, stream(file, &bytes, true)?, bytes.len(), opts)),
    }
}

/// Refuses a tile that does not lie on the first one's grid.
fn check(tile: &Tile, first: &Tile) -> Result<()> {
    let (a, b) = (&tile.place, &first.place);
    let differ = |what: &str, this: &str, other: &str| {
        let first = first.file.file_name().unwrap_or_default().to_string_lossy();
        let none = |s: &str| if s.is_empty() { "none".to_owned() } else { s.to_owned() };
        let what = format!("{what} is {}, that of {first} {}", none(this), none(other));
        Err(Error::format(tile.file, format!("{what}; the tiles of a mosaic share it: warp them to one first")))
    };
    // A vertical system that only one of two names is no difference.
    let map_part = |p: &Place| p.crs.name.split('+').next().unwrap_or_default().to_owned();
    let whole = a.crs.name.contains('+') && b.crs.name.contains('+');
    if whole && a.crs.name != b.crs.name || map_part(a) != map_part(b) || a.crs.model != b.crs.model {
        return differ("the reference system", &a.crs.name, &b.crs.name);
    }
    if a.crs.unit != b.crs.unit {
        return differ("the unit of coordinates", &a.crs.unit_name, &b.crs.unit_name);
    }
    let step = |p: &Place| [p.affine[0][0], -p.affine[1][1]];
    let (this, other) = (step(a), step(b));
    if (0..2).any(|i| (this[i] / other[i] - 1.0).abs() > 1e-5) {
        return differ("the size of pixels", &format!("{this:?}"), &format!("{other:?}"));
    }
    Ok(())
}

/// The map that the tiles of a folder make.
pub(super) fn mosaic(path: &Path, files: &[PathBuf], opts: &ReadOptions) -> Result<Rows> {
    let mut tiles = files.iter().map(|file| survey(file)).collect::<Result<Vec<Tile>>>()?;
    let Some(first) = tiles.first() else {
        return Err(Error::format(path, "no tiles"));
    };
    tiles.iter().try_for_each(|tile| check(tile, first))?;
    let (origin, crs) = (first.place.affine, first.place.crs.clone());
    let mut off = 0.0f64;
    for tile in &mut tiles {
        let [[dx, _, x], [_, dy, y]] = tile.place.affine;
        let [[dx0, _, x0], [_, dy0, y0]] = origin;
        let turn = if crs.model == Model::Geographic { 360.0 / crs.unit } else { 0.0 };
        // Tiles on both sides of the 180th meridian are neighbours.
        let east = if turn > 0.0 && (x - x0).abs() > turn / 2.0 { x - turn * (x - x0).signum() } else { x } - x0;
        let exact = [east / dx0, (y - y0) / dy0];
        if exact.iter().any(|v| v.abs() > f64::from(1u32 << 31)) || dx == 0.0 || dy == 0.0 {
            return Err(Error::format(
                tile.file,
                format!("it lies {exact:?} pixels from the first tile; too far for one map"),
            ));
        }
        tile.at = exact.map(|v| v.round() as i64);
        off = exact.iter().map(|v| (v - v.round()).abs()).fold(off, f64::max);
    }
    let low = [0, 1].map(|i| tiles.iter().map(|t| t.at[i]).min().unwrap_or(0));
    let end = [0, 1].map(|i| tiles.iter().map(|t| t.at[i] + i64::from(t.size[i])).max().unwrap_or(0));
    let size = [0, 1].map(|i| (end[i] - low[i]) as u64);
    let dims = world_dims(path, [size[0], 1, size[1]], "")?;

    let mut heights = Heights::new(dims[0], dims[2])?;
    heights.clear()?;
    let mut all: Option<Map> = None;
    let (mut input_bytes, mut unlike) = (0, 0u64);
    for tile in &tiles {
        input_bytes += std::fs::metadata(tile.file).map_or(0, |m| m.len());
        let mut map = read(tile.file, opts)?;
        map.heights.flips = tile.flips;
        let [x, z] = [0, 1].map(|i| (tile.at[i] - low[i]) as u32);
        let (mut row, mut there) = (vec![0.0; tile.size[0] as usize], vec![0.0; tile.size[0] as usize]);
        for i in 0..tile.size[1] {
            map.heights.row(0, i, &mut row)?;
            heights.row(x, z + i, &mut there)?;
            for (there, new) in there.iter_mut().zip(&row).filter(|(_, new)| new.is_finite()) {
                if !there.is_finite() {
                    *there = *new;
                } else if there != new {
                    unlike += 1;
                }
            }
            heights.write(x, z + i, &there)?;
        }
        match &mut all {
            None => all = Some(map),
            Some(all) => join(tile, all, map)?,
        }
    }
    heights.recount()?;
    let mut map = all.ok_or_else(|| Error::format(path, "no tiles"))?;
    map.heights = heights;
    let mut place = tiles[0].place.clone();
    let [x, y] = place.at(low[0] as f64, low[1] as f64);
    (place.affine[0][2], place.affine[1][2]) = (x, y);
    map.place = Some(place);
    let tiles = tiles.len();
    map.about.format = match tiles {
        1 => format!("1 tile, {}", map.about.format),
        n => format!("{n} tiles, {}", map.about.format),
    };
    map.notes.push(format!("{tiles} tiles, {} × {} pixels", size[0], size[1]));
    if unlike > 0 {
        map.about.left_out.push(format!("{unlike} heights that differ from those of an earlier tile at their place"));
    }
    if off > OFF_GRID {
        map.about.left_out.push(format!("{off:.2} pixels by which tiles lie off the grid of the first"));
    }
    heightmap::rows(path, map, input_bytes, opts)
}

/// Adds what was said of another tile.
fn join(tile: &Tile, all: &mut Map, map: Map) -> Result<()> {
    let unit = |map: &Map| match &map.up {
        Up::Other(unit) => Err(unit.clone()),
        Up::Length(unit) => Ok(unit.clone()),
        Up::Unsaid => Ok(map.place.as_ref().and_then(|p| p.crs.up.clone()).unwrap_or_else(Length::metre)),
    };
    let name = |unit: &std::result::Result<Length, String>| match unit {
        Ok(unit) => unit.name.clone(),
        Err(name) => name.clone(),
    };
    let (this, first) = (unit(&map), unit(all));
    if this != first {
        let what = format!("heights in {}, those of the first tile in {}", name(&this), name(&first));
        return Err(Error::format(
            tile.file,
            format!("{what}; the tiles of a mosaic share their unit: convert them first"),
        ));
    }
    for (all, new) in [(&mut all.rules, map.rules), (&mut all.about.left_out, map.about.left_out)] {
        for phrase in new {
            if !all.contains(&phrase) && all.len() < 16 {
                all.push(phrase);
            }
        }
    }
    all.nodata_known |= map.nodata_known;
    all.eight_bit &= map.eight_bit;
    Ok(())
}
