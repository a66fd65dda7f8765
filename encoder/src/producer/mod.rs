//! Worlds without end, made tile by tile when somebody looks: densities, what they are made of, and tiles from them. Not here:
//! scenes that are made whole, which are [`crate::source::procedural`].
//!
//! `procedural:NAME?size=inf&seed=N` is one of [`NAMES`]. A world begins at (0, 0) and has 2³⁰ × 2³⁰ columns, so that every cell
//! and every half voxel has 32 bits; [`Producer::start`] is where to stand first, in its middle. With `&window=X,Z,W,D` it is that part of
//! it, to be encoded like any input: level 0 of the scene has the columns and colours of the tiles.
//!
//! A tile of a level is made by itself, never from finer ones. Octaves of noise that a level cannot show are left out, and their mean
//! is 0, so that a level is about what [`MipRule::Majority`](crate::MipRule::Majority) makes of level 0; bounds keep them.
//!
//! `procedural:menger?size=3^N` is the sponge of that many voxels a side, N up to 19, at any level from digits: [`Menger`].
//!
//! # A function of one's own
//!
//! ```
//! use planecast_encoder::producer::{Density, Interval, Part, Producer};
//! use planecast_encoder::producer::octaves::Octaves;
//! use planecast_encoder::{TileKey, TileSource};
//!
//! /// Waves of 40 voxels up and down, around a height of 100.
//! struct Waves(Octaves);
//!
//! impl Density for Waves {
//!     fn height(&self) -> u32 {
//!         256
//!     }
//!
//!     // In 4,096ths of a voxel: how far a place is below the surface.
//!     fn value(&self, [x, y, z]: [u32; 3], level: u32) -> i32 {
//!         (100 << 12) + self.0.at2([x, z], level) - (y.min(1 << 17) << 11) as i32
//!     }
//!
//!     fn bounds(&self, part: &Part) -> Interval {
//!         let Interval { least, most } = self.0.bounds(part);
//!         let [low, high] = [part.from[1], part.to[1]].map(|y| (y.min(1 << 17) << 11) as i32);
//!         Interval { least: (100 << 12) + least - high, most: (100 << 12) + most - low }
//!     }
//! }
//!
//! // Two dimensions, cells of 2⁸ to 2³ voxels, the first of 40 voxels (640 sixteenths), each other half as high.
//! let world = Producer::new("waves", Waves(Octaves::new(1, 2, 8, 3, 40 << 4, 128)));
//! let tile = world.tile(TileKey { level: 0, x: 5_000, z: 7_000 })?;
//! assert!(tile.solid.offsets().len() == 65_537 && tile.solid.find(9, 20, 9).is_some());
//! assert!(tile.solid.find(9, 180, 9).is_none());
//! # Ok::<(), planecast_encoder::Error>(())
//! ```
//!
//! `value` and `bounds` are all that is needed. Faster: what columns have in common ([`Density::shared`]), a box of values at once
//! ([`Density::fill`]), or heights alone ([`Density::heights`]).
//!
//! All is integer arithmetic of 32 bits that wraps ([`noise`]), so that everybody makes the same bytes.

mod blend;
mod hills;
mod land;
mod make;
mod menger;
mod mixing;
pub mod noise;
pub mod octaves;
mod window;

use std::ops::Range;
use std::sync::Arc;

use crate::encode::build::UNCOLORED;
use crate::format::TILE;
use crate::model::pieces::Pieces;
use crate::model::tiles::{TileKey, TileSource, tile_size};
use crate::{ColorMode, Error, Level, Result, Rgb};

pub use blend::Blend;
pub use hills::Hills;
pub use land::Land;
pub use menger::Menger;
pub use mixing::Mixing;

/// Columns of a world along x and z.
pub const SIDE: u32 = 1 << 30;

/// Worlds without end that have a name.
///
/// | name | world | high |
/// |---|---|---|
/// | `hills` | mountains, plains and lakes: one height a column | 1,024 |
/// | `terrain` | overhangs, caves, a few floating rocks | 512 |
/// | `rocks` | smooth land under many floating rocks | 512 |
/// | `clouds` | hills under a shell of clouds | 768 |
/// | `mixing` | turbulent mixing layer (Richtmyer–Meshkov-like) | 512 |
/// | `regions` | `terrain` here, `rocks` there, by a mask | 512 |
pub const NAMES: [&str; 6] = ["hills", "terrain", "rocks", "clouds", "mixing", "regions"];

/// Values from `least` to `most`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Interval {
    pub least: i32,
    pub most: i32,
}

/// A box of the world, in half voxels of level 0; both ends belong to it. Of a level and all finer ones.
#[derive(Clone, Copy, Debug)]
pub struct Part {
    pub level: u32,
    pub from: [u32; 3],
    pub to: [u32; 3],
}

/// Columns of a level. What is beside the world counts on, around 2³².
#[derive(Clone, Copy, Debug)]
pub struct Area {
    pub level: u32,
    /// Number of the first column along x and z.
    pub from: [u32; 2],
    pub size: [u32; 2],
}

impl Area {
    /// Where column number `i` of the area along x (`axis` 0) or z (1) has its middle, in half voxels.
    #[inline(always)]
    pub fn middle(&self, axis: usize, i: u32) -> u32 {
        middle(self.from[axis].wrapping_add(i), self.level)
    }
}

/// The middle of voxel `v` of a level, in half voxels of level 0.
#[inline(always)]
pub fn middle(v: u32, level: u32) -> u32 {
    v.wrapping_mul(2).wrapping_add(1) << level
}

/// Where voxel `y` of a column of a level is looked at, in half voxels of level 0: at its middle, and the lowest at its bottom, so that
/// ground has no holes however coarse the level.
#[inline(always)]
pub fn height(y: u32, level: u32) -> u32 {
    if y == 0 { 1 } else { middle(y, level) }
}

/// A box of voxels of a level, at most [`Cells::MOST`] along each side.
#[derive(Clone, Copy, Debug)]
pub struct Cells {
    pub level: u32,
    pub from: [u32; 3],
    pub size: [u32; 3],
}

impl Cells {
    pub const MOST: usize = 64;

    /// Where voxel number `i` of the box along an axis is looked at, in half voxels of level 0.
    #[inline(always)]
    pub fn middle(&self, axis: usize, i: u32) -> u32 {
        let at = self.from[axis].wrapping_add(i);
        if axis == 1 { height(at, self.level) } else { middle(at, self.level) }
    }
}

/// A voxel with an exposed face, to be coloured.
#[derive(Clone, Copy, Debug)]
pub struct Spot {
    pub level: u32,
    /// Where it is looked at, in half voxels of level 0.
    pub at: [u32; 3],
    /// Voxels of level 0 that its run goes on above it.
    pub depth: u32,
    /// Whether a column beside it is three voxels of the level higher.
    pub steep: bool,
}

/// A world as a function: solid where it is above 0.
pub trait Density: Send + Sync {
    /// Voxels of level 0 that columns are high, up to 65,536.
    fn height(&self) -> u32;

    /// At a voxel of a level, which is looked at at `p`, half voxels of level 0. May leave out what the level cannot show.
    fn value(&self, p: [u32; 3], level: u32) -> i32;

    /// All values in a part of the world, of its level and all finer ones, or more.
    fn bounds(&self, part: &Part) -> Interval;

    /// What the columns of an area have in common for all their voxels, [`Density::n_shared`] numbers each: made once, and
    /// given to the functions that follow.
    fn shared(&self, area: &Area) -> Vec<i32> {
        let _ = area;
        Vec::new()
    }

    /// How many numbers of each column [`Density::shared`] gives.
    fn n_shared(&self) -> usize {
        0
    }

    /// All values in a box of voxels of a level, or more. `shared` are the numbers of its columns, by rows of x.
    fn bounds_in(&self, shared: &[i32], cells: &Cells) -> Interval {
        let _ = shared;
        let end = |axis: usize| cells.middle(axis, cells.size[axis] - 1);
        let from = [0, 1, 2].map(|axis| cells.middle(axis, 0));
        self.bounds(&Part { level: cells.level, from, to: [end(0), end(1), end(2)] })
    }

    /// The values of a box of voxels of a level, `(z·nx + x)·ny + y`: those of [`Density::value`].
    fn fill(&self, shared: &[i32], cells: &Cells, values: &mut [i32]) {
        let _ = shared;
        let [nx, ny, _] = cells.size;
        for (i, value) in (0..).zip(values) {
            let at = [i / ny % nx, i % ny, i / ny / nx];
            *value = self.value([0, 1, 2].map(|axis| cells.middle(axis, at[axis])), cells.level);
        }
    }

    /// Of columns that are solid from the ground up: how high each of an area is, in voxels of its level. None where there are
    /// others.
    fn heights(&self, area: &Area) -> Option<Vec<u16>> {
        let _ = area;
        None
    }

    /// Whether [`Density::heights`] gives some.
    fn is_height_field(&self) -> bool {
        false
    }

    /// How finely it is coloured.
    fn color_mode(&self) -> ColorMode {
        ColorMode::None
    }

    /// Colours of an area: of [`ColorMode::Run`] of the top of each of its columns, whose heights these are with one column more on
    /// each side.
    fn top_colors(&self, area: &Area, heights: &[u16]) -> Vec<Rgb> {
        let _ = heights;
        vec![UNCOLORED; area.size[0] as usize * area.size[1] as usize]
    }

    /// Colour of a voxel with an exposed face.
    fn color(&self, spot: &Spot) -> Rgb {
        let _ = spot;
        UNCOLORED
    }

    /// Where to stand first: a place in the air with something to see, voxels of level 0.
    fn start(&self) -> [u32; 3] {
        [SIDE / 2, self.height(), SIDE / 2]
    }
}

/// A density as a world that is asked for tile by tile.
pub struct Producer<D> {
    name: String,
    density: D,
}

impl<D: Density> Producer<D> {
    /// `name` is what errors call it.
    pub fn new(name: impl Into<String>, density: D) -> Producer<D> {
        Producer { name: name.into(), density }
    }

    pub fn density(&self) -> &D {
        &self.density
    }

    /// The tile's columns, in voxels of its level.
    fn columns(&self, key: TileKey) -> [Range<u32>; 2] {
        let size = tile_size(self.dims(), key);
        [(key.x, size[0]), (key.z, size[1])].map(|(at, n)| at * TILE..at * TILE + n)
    }
}

impl<D: Density> TileSource for Producer<D> {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn dims(&self) -> [u32; 3] {
        [SIDE, self.density.height(), SIDE]
    }

    fn color(&self) -> ColorMode {
        self.density.color_mode()
    }

    fn heights(&self, level: u32) -> [u32; 2] {
        [0, self.density.height().div_ceil(1 << level.min(31))]
    }

    fn is_height_field(&self) -> bool {
        self.density.is_height_field()
    }

    fn start(&self) -> Option<[u32; 3]> {
        Some(self.density.start())
    }

    fn is_empty(&self, key: TileKey) -> bool {
        let [xs, zs] = self.columns(key);
        let end = |v: u32| ((u64::from(v) << (key.level + 1)) - 1) as u32;
        let from = [xs.start << (key.level + 1), 0, zs.start << (key.level + 1)];
        let to = [end(xs.end), 2 * self.density.height() - 1, end(zs.end)];
        self.density.bounds(&Part { level: key.level, from, to }).most <= 0
    }

    fn tile(&self, key: TileKey) -> Result<Level> {
        let [tiles_x, tiles_z] = [0, 2].map(|i| self.dims()[i].div_ceil(1 << key.level.min(31)).div_ceil(TILE));
        if key.level >= self.levels() || key.x >= tiles_x || key.z >= tiles_z {
            let TileKey { level, x, z } = key;
            return Err(Error::Argument(format!("{}: there is no tile ({x}, {z}) of level {level}", self.name)));
        }
        let [xs, zs] = self.columns(key);
        Ok(make::level(&self.density, key.level, xs, zs))
    }
}

/// What a name without `procedural:` asks for.
struct Asked {
    name: String,
    seed: u32,
    window: Option<[u32; 4]>,
}

/// None where it asks for a scene that is made whole.
fn asked(name: &str) -> Result<Option<Asked>> {
    let fail = |what: String| {
        let names = NAMES.join(", ");
        let expected = format!("NAME?size=inf[&seed=N][&window=X,Z,W,D], NAME one of {names}");
        Error::Argument(format!("procedural:{name}: {what}; expected procedural:{expected}"))
    };
    let (kind, query) = name.split_once('?').unwrap_or((name, ""));
    let pairs: Vec<&str> = query.split('&').filter(|pair| !pair.is_empty()).collect();
    if !pairs.contains(&"size=inf") {
        return match pairs.iter().find(|pair| pair.starts_with("window=")) {
            Some(window) => Err(fail(format!("{window} is for worlds without end"))),
            None => Ok(None),
        };
    }
    let mut asked = Asked { name: kind.to_ascii_lowercase(), seed: 0, window: None };
    for pair in pairs {
        match pair.split_once('=') {
            Some(("size", "inf")) => {}
            Some(("seed", n)) => {
                let seed: u64 = n.parse().map_err(|_| fail(format!("seed={n} is not a whole number")))?;
                asked.seed = noise::hash(seed as u32, (seed >> 32) as u32, 0, 0x5EED);
            }
            Some(("window", n)) => {
                let numbers: Option<Vec<u32>> = n.split(',').map(|n| n.parse().ok()).collect();
                let window: Option<[u32; 4]> = numbers.and_then(|n| n.try_into().ok());
                let inside = |at: u32, n: u32| n > 0 && at.checked_add(n).is_some_and(|end| end <= SIDE);
                let window = window.filter(|&[x, z, w, d]| inside(x, w) && inside(z, d));
                let what = || fail(format!("window={n} is not four whole numbers of which columns of 0..{SIDE} come"));
                asked.window = Some(window.ok_or_else(what)?);
            }
            _ => return Err(fail(format!("there is no parameter {pair:?}"))),
        }
    }
    if !NAMES.contains(&asked.name.as_str()) {
        return Err(fail(format!("there is no world without end {kind:?}")));
    }
    Ok(Some(asked))
}

/// The world without end of a name, as `hills?size=inf&seed=1`; None where the name is that of a scene which is made whole, or asks for
/// a window, which is to be encoded.
pub fn from_name(name: &str) -> Result<Option<Arc<dyn TileSource>>> {
    if let Some(places) = name.strip_prefix("menger?size=3^") {
        let wrong = || {
            let what = format!("expected procedural:menger?size=3^N, N from 1 to {}", menger::MOST);
            Error::Argument(format!("procedural:{name}: {what}"))
        };
        let places = places.parse().ok().filter(|n| (1..=menger::MOST).contains(n)).ok_or_else(wrong)?;
        return Ok(Some(Arc::new(Menger::new(format!("procedural:{name}"), places))));
    }
    let Some(asked) = asked(name)?.filter(|asked| asked.window.is_none()) else { return Ok(None) };
    struct AsTiles(String);
    impl Make for AsTiles {
        type Made = Arc<dyn TileSource>;
        fn make(self, density: impl Density + 'static) -> Arc<dyn TileSource> {
            Arc::new(Producer::new(self.0, density))
        }
    }
    Ok(Some(named(&asked, AsTiles(format!("procedural:{name}")))))
}

/// Something that any density can be made into.
trait Make {
    type Made;
    fn make(self, density: impl Density + 'static) -> Self::Made;
}

fn named<M: Make>(asked: &Asked, make: M) -> M::Made {
    let seed = asked.seed;
    match asked.name.as_str() {
        "hills" => make.make(Hills::new(seed)),
        "terrain" => make.make(Land::terrain(seed)),
        "rocks" => make.make(Land::rocks(seed)),
        "clouds" => make.make(Land::clouds(seed)),
        "mixing" => make.make(Mixing::new(seed)),
        "regions" => make.make(Blend::new(Land::terrain(seed), Land::rocks(seed), seed, 12)),
        name => unreachable!("{name} is none of the names"),
    }
}

/// The window of a world without end that a name asks for, as `hills?size=inf&window=0,0,512,512`; None where it asks for a scene that is
/// made whole.
pub fn window(name: &str) -> Result<Option<Box<dyn Pieces>>> {
    let Some(asked) = asked(name)? else { return Ok(None) };
    let Some(window) = asked.window else {
        return Err(Error::Argument(format!(
            "procedural:{name}: a world without end is flown through as it is, not encoded; a part of it is encoded with \
             &window=X,Z,W,D"
        )));
    };
    struct AsPieces([u32; 4]);
    impl Make for AsPieces {
        type Made = Box<dyn Pieces>;
        fn make(self, density: impl Density + 'static) -> Box<dyn Pieces> {
            Box::new(window::Window::new(density, self.0))
        }
    }
    Ok(Some(named(&asked, AsPieces(window))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::encode::mips;
    use crate::{BuildOptions, MipRule, build};

    fn world(name: &str) -> Arc<dyn TileSource> {
        from_name(name).unwrap().unwrap()
    }

    #[test]
    fn producers_tiles_are_those_of_an_encoded_window() {
        for name in ["hills", "terrain"] {
            let world = world(&format!("{name}?size=inf&seed=3"));
            // The window's first row is the tile's, at the world's begin: both have a side there.
            let [x, z] = [SIDE / 2, 0];
            let pieces = window(&format!("{name}?size=inf&seed=3&window={},{},258,257", x - 1, z)).unwrap().unwrap();
            let opts = BuildOptions { color: Some(world.color()), mip_rule: MipRule::Majority, ..Default::default() };
            let scene = build(crate::model::pieces::whole(&*pieces).unwrap(), &opts).unwrap();
            let tile = world.tile(TileKey { level: 0, x: x / TILE, z: z / TILE }).unwrap();
            assert_eq!(scene.dims()[1], world.dims()[1]);
            assert_eq!(scene.levels[0].solid.crop(1..257, 0..256), tile.solid, "{name}");
            let offsets = |c: &crate::Columns, z: u32| c.voxel_offsets()[(z * 258 + 1) as usize] as usize;
            if world.color() == ColorMode::Voxel {
                let exposed = scene.levels[0].exposed.as_ref().unwrap();
                let tiles = tile.exposed.as_ref().unwrap();
                assert_eq!(&exposed.crop(1..257, 0..256), tiles, "{name}");
                let n = tiles.voxel_offsets();
                for z in 0..256 {
                    let own = n[z as usize * 256] as usize..n[(z as usize + 1) * 256] as usize;
                    let colors = &scene.levels[0].colors[offsets(exposed, z)..][..own.len()];
                    assert!(colors == &tile.colors[own], "{name}, row {z}");
                }
            }
            if world.color() == ColorMode::Run {
                let row = |z: u32| scene.levels[0].solid.offsets()[(z * 258 + 1) as usize] as usize;
                let colors = (0..256).flat_map(|z| &scene.levels[0].colors[row(z)..][..256]);
                assert!(colors.eq(&tile.colors), "{name}");
            }
        }
    }

    /// How many of 1,000 columns of a level made directly have another top than those made from level 0, by more than a voxel. A top under
    /// which there is air is all or nothing, so that worlds of such tops have more.
    #[test]
    fn producers_levels_are_about_those_made_of_level_0() {
        for (name, most) in [("hills", [10, 10, 10]), ("terrain", [10, 10, 30]), ("clouds", [10, 10, 20])] {
            let world = world(&format!("{name}?size=inf&seed=5"));
            let at = SIDE / 2 + 4096;
            let pieces = window(&format!("{name}?size=inf&seed=5&window={at},{at},256,256")).unwrap().unwrap();
            let mut fine = crate::model::pieces::whole(&*pieces).unwrap().columns;
            for (level, most) in (1..).zip(most) {
                fine = mips::next(&fine, MipRule::Majority);
                let n = 256 >> level;
                let [x, z] = [at >> level; 2];
                let tile = world.tile(TileKey { level, x: x / TILE, z: z / TILE }).unwrap();
                let top = |columns: &crate::Columns, x, z| columns.column(x, z).last().map_or(0, |run| run.end());
                let mut wrong = 0;
                for (i, j) in (0..n).flat_map(|j| (0..n).map(move |i| (i, j))) {
                    let made = top(&tile.solid, x % TILE + i, z % TILE + j);
                    wrong += u32::from(made.abs_diff(top(&fine, i, j)) > 1);
                }
                assert!(wrong * 1000 <= most * n * n, "{name}, level {level}: {wrong} of {} tops are wrong", n * n);
            }
        }
    }

    #[test]
    fn producers_evaluate_what_bounds_do_not_tell() {
        let land = Blend::new(Land::terrain(5), Land::clouds(6), 7, 9);
        let densities: [&dyn Density; 5] = [&land, &Land::terrain(1), &Land::rocks(2), &Mixing::new(3), &Hills::new(4)];
        for (i, density) in densities.into_iter().enumerate() {
            for (level, at, n) in [(0, SIDE / 2 - 1, 3), (2, (SIDE >> 3) + 77, 4), (5, 1000, 18)] {
                let made = make::columns(density, level, at..at + n, at..at + n);
                let voxel = |x, y, z| {
                    density.value([middle(at + x, level), height(y, level), middle(at + z, level)], level) > 0
                };
                let all = crate::Columns::from_fn(n, density.height().div_ceil(1 << level), n, voxel);
                assert_eq!(made, all, "density {i}, level {level}");
                if let Some(heights) = density.heights(&Area { level, from: [at; 2], size: [n; 2] }) {
                    assert!(
                        heights
                            .iter()
                            .enumerate()
                            .all(|(i, &h)| { made.column(i as u32 % n, i as u32 / n) == [crate::Run::new(0, h - 1)] })
                    );
                }
            }
        }
    }

    #[test]
    fn producers_names_that_are_wrong_say_what_was_expected() {
        let wrong = |name: &str| from_name(name).err().or(window(name).err()).unwrap().to_string();
        assert!(
            wrong("hill?size=inf").contains("there is no world without end \"hill\""),
            "{}",
            wrong("hill?size=inf")
        );
        assert!(wrong("menger?size=3^20").contains("N from 1 to 19"));
        assert!(wrong("hills?size=inf&window=0,0,1").contains("four whole numbers"));
        assert!(wrong("hills?size=inf&window=1073741823,0,2,1").contains("four whole numbers"));
        assert!(wrong("hills?size=inf&bumps=3").contains("there is no parameter"));
        assert!(wrong("hills?size=64&window=0,0,1,1").contains("is for worlds without end"));
        assert!(wrong("hills?size=inf").contains("is flown through as it is"));
        assert!(from_name("hills?size=64").unwrap().is_none() && window("hills").unwrap().is_none());
        let world = world("hills?size=inf");
        let error = world.tile(TileKey { level: 0, x: SIDE / TILE, z: 0 }).unwrap_err().to_string();
        assert!(error.contains("there is no tile (4194304, 0) of level 0"), "{error}");
    }

    #[test]
    fn producers_have_every_level_and_both_ends() {
        for name in NAMES {
            let world = world(&format!("{name}?size=inf&seed=1"));
            assert_eq!(world.levels(), 31);
            for level in [3, 6, 22, 30] {
                let n = (SIDE >> level).div_ceil(TILE);
                let ends = [(0, 0), (n - 1, n / 2)];
                for (x, z) in ends.into_iter().take(if level == 3 { 1 } else { 2 }) {
                    let key = TileKey { level, x, z };
                    let tile = world.tile(key).unwrap();
                    let side = (SIDE >> level).min(TILE);
                    assert_eq!(tile.solid.dims(), [side, world.dims()[1].div_ceil(1 << level), side]);
                    let [low, high] = world.heights(level);
                    assert!(tile.solid.runs().iter().all(|run| u32::from(run.first()) >= low && run.end() <= high));
                    assert!(!world.is_empty(key) || tile.solid.runs().is_empty());
                    match world.color() {
                        ColorMode::None => assert!(tile.colors.is_empty()),
                        ColorMode::Run => assert_eq!(tile.colors.len(), tile.solid.runs().len()),
                        ColorMode::Voxel => assert_eq!(tile.colors.len() as u64, tile.exposed.unwrap().voxels()),
                    }
                }
            }
            let [x, y, z] = world.start().unwrap();
            let tile = world.tile(TileKey { level: 3, x: x / TILE / 8, z: z / TILE / 8 }).unwrap();
            let [x, y, z] = [x / 8 % TILE, y / 8, z / 8 % TILE];
            assert!(tile.solid.find(x, y, z).is_none(), "{name}: in the air");
        }
    }
}
