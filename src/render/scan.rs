//! Scans of [`Projection::Lidar`] as point clouds: PLY, LAS or NPY, with a table of the beams beside.
//!
//! Points stand where the source's coordinates are known there (its affine map), else in voxels with z up: (x, −z, y), as
//! `encode` reads such files. NPY has them as the world does, y up.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use planecast_encoder::About;
use serde_json::json;

use crate::frame::projection::{Rays, azimuth, elevation};
use crate::{Camera, Error, Frame, Projection, Result};

/// What a scan is written as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Binary, little-endian: x, y, z (f8), range (f4), red, green, blue (u1), channel, step (u2).
    Ply,
    /// 1.2, point format 2: colours; user data and point source id are the channel, intensity is 0.
    Las,
    /// `<f8` of shape (CHANNELS, STEPS, 4): x, y, z, range; where nothing is met NaN and +inf.
    Npy,
}

impl Kind {
    /// By the name's ending; `None`: not one of a point cloud.
    pub fn of(path: &Path) -> Option<Kind> {
        let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase())?;
        Some(match ending.as_str() {
            "ply" => Kind::Ply,
            "las" => Kind::Las,
            "npy" => Kind::Npy,
            _ => return None,
        })
    }
}

/// Where the table of a scan's beams is written.
pub fn beams_file(path: &Path) -> PathBuf {
    path.with_extension("beams.json")
}

/// Angles of all beams, about the scanner's own axes, and how it stands.
pub fn beams(out: &mut impl Write, camera: &Camera, projection: Projection) -> io::Result<()> {
    let Projection::Lidar { channels, steps } = projection else { return Ok(()) };
    let table = json!({
        "projection": projection.to_string(),
        "eye": camera.eye.to_array(),
        "yaw": camera.yaw,
        "pitch": camera.pitch,
        "roll": camera.roll,
        "unit": "degrees; azimuths clockwise from the forward axis, as seen from above",
        "elevation": (0..channels).map(|c| elevation(c, channels, camera.fov)).collect::<Vec<_>>(),
        "azimuth": (0..steps).map(|s| azimuth(s, steps)).collect::<Vec<_>>(),
    });
    crate::output::json(out, &table)
}

/// A beam's end.
struct Point {
    at: [f64; 3],
    range: f32,
    color: [u8; 3],
    channel: u16,
    step: u16,
}

fn points<'a>(
    frame: &'a Frame,
    rays: &'a Rays,
    map: impl Fn([f64; 3]) -> [f64; 3] + 'a,
) -> impl Iterator<Item = Point> + 'a {
    let shown = frame.depth.iter().enumerate().filter(|(_, range)| range.is_finite());
    shown.map(move |(i, &range)| {
        let (x, y) = (i as u32 % frame.width, i as u32 / frame.width);
        let dir = rays.direction(x, y).expect("a beam has a direction");
        let at = map((rays.origin(x, y) + dir * f64::from(range)).to_array());
        let [r, g, b, _] = frame.color[i];
        Point { at, range, color: [r, g, b], channel: y as u16, step: x as u16 }
    })
}

/// From the world to a file whose z is up.
fn map(about: &About) -> impl Fn([f64; 3]) -> [f64; 3] + use<> {
    let rows = about.affine.unwrap_or([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0]]);
    move |[x, y, z]| rows.map(|[a, b, c, d]| a * x + b * y + c * z + d)
}

/// Writes a scan, `frame` as `rays` saw it.
///
/// # Errors
/// [`Error::Limit`] where the format cannot hold it.
pub fn write(kind: Kind, frame: &Frame, rays: &Rays, about: &About) -> Result<Vec<u8>> {
    let mut out = Vec::new();
    let fault = |e: String| Error::Limit(format!("scan: {e}"));
    match kind {
        Kind::Npy => {
            let shape = format!("({}, {}, 4)", frame.height, frame.width);
            crate::output::npy_header(&mut out, "<f8", &shape).map_err(|e| fault(e.to_string()))?;
            for (i, &range) in frame.depth.iter().enumerate() {
                let (x, y) = (i as u32 % frame.width, i as u32 / frame.width);
                let dir = rays.direction(x, y).expect("a beam has a direction");
                let [px, py, pz] = match range.is_finite() {
                    true => (rays.origin(x, y) + dir * f64::from(range)).to_array(),
                    false => [f64::NAN; 3],
                };
                out.extend([px, py, pz, f64::from(range)].iter().flat_map(|v| v.to_le_bytes()));
            }
        }
        Kind::Ply => {
            let n = frame.depth.iter().filter(|range| range.is_finite()).count();
            let head = format!(
                "ply\nformat binary_little_endian 1.0\nelement vertex {n}\nproperty double x\nproperty double y\nproperty double z\n\
                 property float range\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nproperty ushort channel\n\
                 property ushort step\nend_header\n"
            );
            out.extend_from_slice(head.as_bytes());
            for p in points(frame, rays, map(about)) {
                out.extend(p.at.iter().flat_map(|v| v.to_le_bytes()));
                out.extend(p.range.to_le_bytes());
                out.extend(p.color);
                out.extend(p.channel.to_le_bytes());
                out.extend(p.step.to_le_bytes());
            }
        }
        Kind::Las => {
            let map = map(about);
            let mut builder = las::Builder::from((1, 2));
            builder.point_format = las::point::Format::new(2).map_err(|e| fault(e.to_string()))?;
            builder.generating_software = "planecast".into();
            // A thousandth of a voxel, about the eye.
            let origin = map(rays.origin(0, 0).to_array());
            let unit = map([1.0, 1.0, 1.0]).iter().zip(map([0.0; 3])).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            let scale = 10f64.powf((unit * 1e-3).log10().floor());
            let transform = |at: usize| las::Transform { scale, offset: origin[at].floor() };
            builder.transforms = las::Vector { x: transform(0), y: transform(1), z: transform(2) };
            let header = builder.into_header().map_err(|e| fault(e.to_string()))?;
            let mut writer = las::Writer::new(io::Cursor::new(Vec::new()), header).map_err(|e| fault(e.to_string()))?;
            for p in points(frame, rays, map) {
                let [x, y, z] = p.at;
                let [red, green, blue] = p.color.map(|c| u16::from(c) * 257);
                let color = Some(las::Color { red, green, blue });
                let point = las::Point {
                    x,
                    y,
                    z,
                    color,
                    user_data: p.channel.min(255) as u8,
                    point_source_id: p.channel,
                    return_number: 1,
                    number_of_returns: 1,
                    ..Default::default()
                };
                writer.write_point(point).map_err(|e| fault(e.to_string()))?;
            }
            out = writer.into_inner().map_err(|e| fault(e.to_string()))?.into_inner();
        }
    }
    Ok(out)
}
