//! USGS ASCII DEM: records of 1,024 bytes, profiles from south to north, west to east.
//!
//! After the USGS standard for digital elevation models, part 2. Elevations become metres; the ground is in metres or feet of a
//! map, or in arc seconds. Of reference systems UTM and degrees have a code here, state planes have none.

use std::path::Path;

use super::geo::{Crs, Length, Model, Place};
use super::heightmap::{Map, Up};
use super::heights::Heights;
use crate::About;
use crate::model::about::Kind;
use crate::{Error, Result};

const RECORD: usize = 1024;
/// A value that stands for none.
const NO_DATA: f64 = -32_767.0;

/// Where a profile starts, east and north, and its heights from south to north.
type Profile = (f64, f64, Vec<f32>);

/// Heights in metres, north up.
pub(super) fn read(path: &Path, bytes: &[u8]) -> Result<Map> {
    let fault = |at: usize, what: String| Error::format(path, format!("byte {at}: USGS DEM: {what}"));
    // Some tools strip the padding of records, or put line ends into it.
    let field = |at: usize, len: usize| -> Option<f64> {
        let text = std::str::from_utf8(bytes.get(at..at + len)?).ok()?;
        text.trim().replace(['D', 'd'], "E").parse().ok()
    };
    let need = |at: usize, len: usize, what: &str| {
        field(at, len).ok_or_else(|| Error::format(path, format!("byte {at}: USGS DEM: expected {what}")))
    };
    let metres = |unit: f64, at: usize| match unit as i64 {
        1 => Ok(0.3048),
        2 => Ok(1.0),
        _ => Err(fault(at, format!("unit {unit}; 1 (feet) or 2 (metres) was expected"))),
    };
    let crs = reference(&field, need(528, 6, "the unit of the ground")?).ok_or_else(|| {
        fault(528, "the unit of the ground; 1 (feet), 2 (metres) or 3 (arc seconds) was expected".to_owned())
    })?;
    let up = metres(need(534, 6, "the unit of elevations")?, 534)?;
    let (dx, dy) = (need(816, 12, "the distance of profiles")?, need(828, 12, "the distance of points")?);
    let dz = need(840, 12, "the resolution of elevations")?;
    let profiles = need(858, 6, "the number of profiles")?;
    if !(dx > 0.0
        && dx.is_finite()
        && dy > 0.0
        && dy.is_finite()
        && dz.is_finite()
        && (1.0..=100_000.0).contains(&profiles))
    {
        return Err(fault(816, format!("{profiles} profiles {dx} apart, points {dy} apart, elevations by {dz}")));
    }
    // Each profile has a place, and its own number of points.
    let mut found: Vec<Profile> = Vec::new();
    let mut at = RECORD;
    for _ in 0..profiles as usize {
        let n = need(at + 12, 6, "the number of points of a profile")?;
        let (x, y) = (need(at + 24, 24, "the place of a profile")?, need(at + 48, 24, "the place of a profile")?);
        let base = need(at + 72, 24, "the datum of a profile")?;
        if !(0.0..=bytes.len() as f64 / 6.0).contains(&n) || !x.is_finite() || !y.is_finite() {
            return Err(fault(at, format!("a profile of {n} points at {x}, {y}")));
        }
        let mut values = Vec::with_capacity(n as usize);
        let (mut place, mut room) = (at + 144, 146);
        let mut record = at;
        for _ in 0..n as usize {
            if room == 0 {
                record += RECORD;
                (place, room) = (record, 170);
            }
            let value = need(place, 6, "an elevation")?;
            let height = if value == NO_DATA { f64::NAN } else { (base + value * dz) * up };
            values.push(height as f32);
            (place, room) = (place + 6, room - 1);
        }
        found.push((x, y, values));
        at = record + RECORD;
    }
    let bound = |of: &dyn Fn(&Profile) -> f64| {
        let values = || found.iter().map(of);
        (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max))
    };
    let (west, east) = bound(&|p| p.0);
    let south = bound(&|p| p.1).0;
    let north = bound(&|p| p.1 + (p.2.len().max(1) - 1) as f64 * dy).1;
    let (width, height) = (((east - west) / dx).round() + 1.0, ((north - south) / dy).round() + 1.0);
    if width * height > bytes.len() as f64 * 4.0 {
        return Err(fault(864, format!("profiles spread over {width} × {height} points, far more than there are")));
    }
    let (width, height) = (width as usize, height as usize);
    let mut grid = vec![f32::NAN; width * height];
    for (x, y, values) in &found {
        let (column, bottom) = (((x - west) / dx).round() as usize, ((y - south) / dy).round() as usize);
        for (i, &value) in values.iter().enumerate().take(height - bottom) {
            grid[(height - 1 - bottom - i) * width + column] = value;
        }
    }
    // Profiles are places of samples, pixels lie around them.
    let degrees = if crs.model == Model::Geographic { 3600.0 } else { 1.0 };
    let corner = [(west - dx / 2.0) / degrees, (south + (height as f64 - 0.5) * dy) / degrees];
    let place = Place::north_up(crs, corner, [dx / degrees, dy / degrees]);
    Ok(Map {
        place: Some(place),
        up: Up::Length(Length::metre()),
        nodata_known: true,
        about: About::new(Kind::Terrain, "USGS DEM"),
        ..Map::of(Heights::of(width as u32, height as u32, &grid)?)
    })
}

/// The reference system that a head names: code 0 is degrees, 1 UTM; datums are NAD27, WGS 72, WGS 84, NAD83.
fn reference(field: &impl Fn(usize, usize) -> Option<f64>, unit: f64) -> Option<Crs> {
    let system = field(156, 6).unwrap_or(-1.0) as i64;
    let zone = field(162, 6).filter(|z| (1.0..=60.0).contains(z)).map(|z| z as u16);
    // Old files have no datum: all of them are of NAD27.
    let datum = field(890, 2).unwrap_or(1.0) as i64;
    Some(match (unit as i64, system, zone) {
        (3, _, _) => Crs::epsg(
            match datum {
                2 => 4322,
                3 => 4326,
                4 => 4269,
                _ => 4267,
            },
            Model::Geographic,
        ),
        (2, 1, Some(zone)) => {
            let base = match datum {
                2 => 32_200,
                3 => 32_600,
                4 => 26_900,
                _ => 26_700,
            };
            Crs::epsg(base + zone, Model::Projected)
        }
        (2, ..) => Crs::lengths(Length::metre()),
        (1, ..) => Crs::lengths(Length::of_epsg(9002)?),
        _ => return None,
    })
}
