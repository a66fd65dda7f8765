//! Scenes made by functions: seeded, repeatable bit for bit on every machine, and tileable where it says so.
//!
//! | name | scene | tiles | size means |
//! |---|---|---|---|
//! | `terrain` | fractal landscape, overhangs, caves, floating rocks | yes | columns a side; up to 256 high |
//! | `rocks` | smooth landscape under floating rocks | yes | the same |
//! | `mixing` | turbulent mixing layer (Richtmyer–Meshkov-like) | yes | side of the cube |
//! | `menger` | Menger sponge | yes | 3 to the `level` |
//! | `shapes` | coloured solids, arches and lattices on a floor | no | side of the cube |
//! | `scan` | tree in a pot as a scanner sees it: thin noisy sheets | no | side of the cube |
//! | `serpent` | coiled, scaly, hollow closed surface | no | side of the cube |
//! | `cloud` | a cumulus of five octaves: translucent matter alone | no | side of the cube |
//! | `city` | houses with rooms, floors and windows | sides of whole blocks | columns a side; a quarter as high |

mod city;
mod cloud;
mod landscape;
mod menger;
mod mixing;
pub mod noise;
mod scan;
mod serpent;
mod shapes;

use clap::ValueEnum;

use crate::model::pieces::{self, InMemory, Pieces};
use crate::{ColumnsBuilder, Error, Input, Result, Rgb, Run, producer};

/// Kinds of procedural scenes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Kind {
    Terrain,
    Rocks,
    Hills,
    Mixing,
    Menger,
    Shapes,
    Scan,
    Serpent,
    City,
    Cloud,
}

impl Kind {
    /// Side in columns where none is asked for.
    pub fn default_size(self) -> u32 {
        match self {
            Kind::Terrain | Kind::Rocks | Kind::Hills | Kind::City => 1024,
            Kind::Mixing | Kind::Shapes | Kind::Scan | Kind::Serpent => 512,
            Kind::Menger => 243,
            Kind::Cloud => 256,
        }
    }
}

/// Largest side of a landscape, in columns: its noise takes about 3 GiB.
pub const MAX_SIZE: u32 = 8192;

const USAGE: &str = "procedural:KIND[?size=N&seed=S], KIND one of terrain, rocks, hills, mixing, menger (level=L), shapes, scan, \
     serpent, city, cloud; without end procedural:KIND?size=inf[&seed=S][&window=X,Z,W,D]";

/// The scene that a name describes: `terrain?size=1024&seed=1`, `menger?level=5`, `hills?size=inf&window=0,0,512,512`.
pub fn from_name(name: &str) -> Result<Box<dyn Pieces>> {
    if let Some(window) = producer::window(name)? {
        return Ok(window);
    }
    let fail = |what: String| Error::Argument(format!("procedural:{name}: {what}; expected {USAGE}"));
    let (kind, query) = name.split_once('?').unwrap_or((name, ""));
    let kind = Kind::from_str(kind, true).map_err(|_| fail(format!("there is no scene {kind:?}")))?;
    let (mut size, mut seed) = (None, 0u64);
    for pair in query.split('&').filter(|p| !p.is_empty()) {
        let (key, value) = pair.split_once('=').ok_or_else(|| fail(format!("{pair:?} has no value")))?;
        let number: u64 = value.parse().map_err(|_| fail(format!("{key}={value} is not a whole number")))?;
        match key {
            "size" => size = Some(u32::try_from(number).unwrap_or(u32::MAX)),
            "seed" => seed = number,
            "level" if kind == Kind::Menger => {
                size = Some(u32::try_from(number).ok().and_then(|l| 3u32.checked_pow(l)).unwrap_or(u32::MAX));
            }
            _ => return Err(fail(format!("there is no parameter {key:?}"))),
        }
    }
    procedural_pieces(kind, size.unwrap_or(kind.default_size()), seed)
}

/// Makes a scene of `size` columns a side; equal arguments give equal scenes.
pub fn procedural(kind: Kind, size: u32, seed: u64) -> Result<Input> {
    pieces::whole(&*procedural_pieces(kind, size, seed)?)
}

/// The same, made piece by piece where the kind allows it.
pub fn procedural_pieces(kind: Kind, size: u32, seed: u64) -> Result<Box<dyn Pieces>> {
    let max = match kind {
        Kind::Terrain | Kind::Rocks | Kind::Hills | Kind::City => MAX_SIZE,
        // These fill cubes: time and memory grow with the volume.
        Kind::Mixing | Kind::Shapes | Kind::Scan | Kind::Serpent | Kind::Cloud => 4096,
        Kind::Menger => 3u32.pow(menger::MAX_LEVEL),
    };
    if !(1..=max).contains(&size) {
        return Err(Error::Argument(format!("a procedural scene of size {size}: this kind is made from 1 to {max}")));
    }
    let in_memory = |input: Result<Input>| Ok(Box::new(InMemory::new(input?)) as Box<dyn Pieces>);
    match kind {
        Kind::Terrain => in_memory(landscape::make(size, seed, landscape::Style::Terrain)),
        Kind::Rocks => in_memory(landscape::make(size, seed, landscape::Style::Rocks)),
        Kind::Hills => in_memory(landscape::make(size, seed, landscape::Style::Hills)),
        Kind::Mixing => Ok(Box::new(mixing::make(size, seed))),
        Kind::Menger => Ok(Box::new(menger::make(size)?)),
        Kind::Shapes => in_memory(shapes::make(size, seed)),
        Kind::Scan => in_memory(scan::make(size, seed)),
        Kind::Serpent => in_memory(serpent::make(size, seed)),
        Kind::City => in_memory(city::make(size, seed)),
        Kind::Cloud => Ok(Box::new(cloud::make(size, seed))),
    }
}

/// Adds the runs of `y_range` in which `solid` holds to the column under construction.
fn push_solid(columns: &mut ColumnsBuilder, y_range: std::ops::Range<u32>, mut solid: impl FnMut(u32) -> bool) {
    let mut start = None;
    for y in y_range.clone() {
        match (solid(y), start) {
            (true, None) => start = Some(y),
            (false, Some(first)) => {
                columns.push_run(Run::new(first as u16, (y - 1) as u16));
                start = None;
            }
            _ => {}
        }
    }
    if let Some(first) = start {
        columns.push_run(Run::new(first as u16, (y_range.end - 1) as u16));
    }
}

/// A colour made lighter or darker by `by` of 256.
fn shade(c: Rgb, by: i32) -> Rgb {
    c.map(|v| (i32::from(v) + i32::from(v) * by / 256).clamp(0, 255) as u8)
}

/// Between `a` (t = 0) and `b` (t = 1).
fn blend(a: Rgb, b: Rgb, t: f32) -> Rgb {
    let t = t.clamp(0.0, 1.0);
    [0, 1, 2].map(|i| (f32::from(a[i]) + (f32::from(b[i]) - f32::from(a[i])) * t + 0.5) as u8)
}
