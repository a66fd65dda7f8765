//! Planes of the whole sphere around one eye: azimuth × slope. Nothing of it depends on where a camera looks, so that what
//! planes show is kept while the eye rests, and any projection looks it up.
//!
//! Each azimuth is cast as four planes, one a *band* of 45°, from straight down to straight up. With `h / t` the slope, places
//! in the two bands beside the horizon are even in the slope, in the others in `t / h`: both are cases of
//! `u = (A·t + B·h) / (C·t + E·h)`, so that the walk is that of any plane. A plane's depth is `t` in the inner bands and `|h|` in
//! the outer ones. The bands of an azimuth stand one behind the other in the plane buffer: samples are numbered through.
//! (Forstmann & Ohya 2008 keep a rendered cube; deviates: samples name voxels, so that each pixel tests them by its own ray.)

use super::{AT_ONCE, Fan, Plane, Setup, UP, World};
use crate::frame::camera::Camera;
use crate::frame::options::Options;
use crate::frame::projection::Rays;
use crate::world::tables::Resident;
use rayon::prelude::*;

/// Planes of an azimuth, from straight down to straight up.
pub const BANDS: u32 = 4;

/// How finely a sphere is sampled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layout {
    /// Azimuths all round.
    pub azimuths: u32,
    /// Where the first one's stripe begins, radians from −z clockwise.
    pub start: f64,
    /// Samples of a band: those of the inner ones are so many a unit of slope.
    pub band: u32,
    /// Samples that are drawn, of `BANDS · band`.
    pub drawn: [u32; 2],
    /// Pixels a radian that levels of detail are chosen for.
    pub focal: f64,
}

/// Samples that pixels look at beside their own, and one for rounding.
const MARGIN: f64 = 3.0;

impl Layout {
    /// For a picture: as many azimuths and samples as pixels, times `factor`.
    pub fn new(rays: &Rays, yaw: f64, factor: f64) -> Layout {
        let [along, up] = rays.density().map(|d| d * factor);
        let azimuths = ((along * std::f64::consts::TAU).round() as u32).max(4);
        let band = (up.ceil() as u32).max(2);
        let samples = BANDS * band;
        let place = |slope: f64| {
            f64::from(band)
                * (if slope.abs() <= 1.0 {
                    2.0 + slope
                } else if slope > 1.0 {
                    4.0 - 1.0 / slope
                } else {
                    -1.0 / slope
                })
        };
        let drawn = rays.slopes().map_or([0, samples], |[low, high]| {
            [(place(low) - MARGIN).max(0.0) as u32, ((place(high) + MARGIN).ceil() as u32).min(samples)]
        });
        Layout { azimuths, start: yaw.to_radians() - std::f64::consts::PI, band, drawn, focal: along.max(up) }
    }

    /// Samples of an azimuth.
    pub fn samples(&self) -> u32 {
        BANDS * self.band
    }

    /// Samples of the whole sphere.
    pub fn total(&self) -> u64 {
        u64::from(self.azimuths) * u64::from(self.samples())
    }

    /// Whether it shows all that `other` does, as finely: so that what is kept of it serves.
    pub fn serves(&self, other: &Layout) -> bool {
        let whole = self.drawn == [0, self.samples()] || (self.band, self.drawn) == (other.band, other.drawn);
        // Twice as fine, and levels of detail are others than they would be.
        let near = |own: f64, wanted: f64| (0.999..2.0).contains(&(own / wanted));
        whole
            && near(self.azimuths.into(), other.azimuths.into())
            && near(self.band.into(), other.band.into())
            && near(self.focal, other.focal)
    }
}

/// All planes of the sphere around an eye, as one fan; `camera` says where the eye is.
pub fn sphere_setup(resident: &Resident, camera: &Camera, layout: &Layout, options: &Options) -> Setup {
    let world = World::new(resident, camera, options);
    let n = f64::from(layout.band);
    // Places in the four bands, from straight down: n·t/−h, n·(1 + h/t), n·h/t, n·(1 − t/h).
    let places = [[n, 0.0, 0.0, -1.0], [n, n, 1.0, 0.0], [0.0, n, 1.0, 0.0], [-n, n, 0.0, 1.0]];
    let plane = |p: u32| {
        let (azimuth, band) = (p / BANDS, p % BANDS);
        let angle = layout.start + (f64::from(azimuth) + 0.5) / f64::from(layout.azimuths) * std::f64::consts::TAU;
        let [a, b, c, e] = places[band as usize];
        let from = band * layout.band;
        let [first, end] = layout.drawn.map(|s| s.clamp(from, from + layout.band) - from);
        let (sin, cos) = crate::frame::camera::sin_cos_degrees(angle.to_degrees());
        let base = p as usize * layout.band as usize;
        let mut plane = Plane { dir: [sin, -cos], a, b, c, e, first, end, base, ..Plane::default() };
        world.clip(&mut plane);
        world.choose_levels(&mut plane, layout.focal, options.lod);
        plane
    };
    let n_planes = BANDS * layout.azimuths;
    let planes: Vec<Plane> = (0..n_planes).into_par_iter().with_min_len(AT_ONCE).map(plane).collect();
    let mut fans = [Fan::default(); 4];
    fans[UP] = Fan { n_planes, pixels: layout.band, n_samples: layout.band, spacing: 1.0, ..Fan::default() };
    Setup {
        planes,
        fans,
        // Somewhere on the screen: its planes are no pixel columns.
        vanishing: [0.0, 0.0, 1.0],
        planes_full: n_planes,
        samples: layout.total() as usize,
        done: Vec::new(),
        eye_cell: world.eye_cell,
        eye_fract: world.eye_fract,
        period_offset: world.period_offset,
        repeats: [options.repeat.x, options.repeat.z],
        levels: world.levels,
        equidistant: options.equidistant.unwrap_or(f64::INFINITY),
        view_distance: world.view_distance,
    }
}
