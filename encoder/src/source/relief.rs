//! What makes a plain height map look like land: colours by height (`--ramp`), relief that shows (`--exaggeration`), another
//! number of columns (`--size`).
//!
//! **Ramps.** `terrain` is a hypsometric tint from valley green to pale rock; slopes turn to rock, hollows are darker than the ridges
//! beside them. The perceptual ones are those of matplotlib and of Nuñez et al. 2018 (`cividis`), from the crate colorous; `grey`
//! is what its name says. A file is in the form that GDAL's `gdaldem color-relief` reads: a height or a percentage and three or four
//! numbers a line, `nv` for what has no data; heights between two lines take a mix of their colours.
//!
//! **Exaggeration** `auto` lets the relief be a tenth of the longer side, in steps of a half, 1 to 10 times; it never lowers any.
//!
//! **Size** counts the columns along the longer side, on the ground where pixels are not square. More columns than pixels come from
//! cubic convolution (Keys 1981, a = −½), fewer from the mean of the pixels that a column covers. Pixels without data have no part
//! in either; a column whose nearest pixel has none has none.

use std::path::Path;

use super::heights::Heights;
use crate::{Error, Result, Rgb};

/// Ramps by name.
#[derive(Clone, Copy)]
enum Named {
    Terrain,
    Grey,
    Perceptual(fn(f64) -> Rgb),
}

fn perceptual(name: &str) -> Option<fn(f64) -> Rgb> {
    Some(match name {
        "viridis" => |t| colorous::VIRIDIS.eval_continuous(t).as_array(),
        "cividis" => |t| colorous::CIVIDIS.eval_continuous(t).as_array(),
        "magma" => |t| colorous::MAGMA.eval_continuous(t).as_array(),
        "inferno" => |t| colorous::INFERNO.eval_continuous(t).as_array(),
        "plasma" => |t| colorous::PLASMA.eval_continuous(t).as_array(),
        "turbo" => |t| colorous::TURBO.eval_continuous(t).as_array(),
        _ => return None,
    })
}

const NAMES: &str = "terrain, grey, viridis, cividis, magma, inferno, plasma, turbo, none";

/// Stops of the ramp `terrain`, as shares of the relief.
const TERRAIN: [(f64, Rgb); 7] = [
    (0.0, [96, 128, 132]),
    (0.10, [150, 168, 96]),
    (0.22, [112, 146, 70]),
    (0.40, [74, 112, 54]),
    (0.62, [92, 104, 60]),
    (0.82, [148, 128, 96]),
    (1.0, [208, 200, 184]),
];

/// Colour of bare rock, and the slopes, rise over run on the ground, between which it takes over.
const ROCK: [f64; 3] = [124.0, 108.0, 92.0];
const ROCKY: [f64; 2] = [0.25, 0.58];

/// Share of a colour that a hollow loses or a ridge gains, at most.
const HOLLOW: f64 = 0.22;

/// Pixels a cell of [`Means`] is wide, at least, and cells there are at most.
const CELL: u32 = 8;
const CELLS: u64 = 1 << 22;

/// Place of a stop.
#[derive(Clone, Copy, Debug, PartialEq)]
enum At {
    /// As the data mean it.
    Value(f64),
    /// Of the way from the least to the greatest height, 0 to 1.
    Share(f64),
}

/// Colours by height, not yet of a map: `--ramp`.
#[derive(Clone, Debug, PartialEq)]
pub struct Ramp {
    stops: Vec<(At, Rgb)>,
    /// Whether slopes and hollows show.
    land: bool,
}

impl Ramp {
    /// By name, or from a file; None for "none".
    ///
    /// # Errors
    /// [`Error::Argument`] where nothing has that name; what is wrong with the file, and where.
    pub fn find(name: &str) -> Result<Option<Ramp>> {
        let named = match name {
            "none" => return Ok(None),
            "terrain" => Some(Named::Terrain),
            "grey" | "gray" => Some(Named::Grey),
            _ => perceptual(name).map(Named::Perceptual),
        };
        let shares = |of: &dyn Fn(f64) -> Rgb| {
            (0..=64).map(|i| f64::from(i) / 64.0).map(|t| (At::Share(t), of(t))).collect::<Vec<_>>()
        };
        Ok(Some(match named {
            Some(Named::Terrain) => Ramp { stops: TERRAIN.map(|(t, c)| (At::Share(t), c)).to_vec(), land: true },
            Some(Named::Grey) => {
                Ramp { stops: vec![(At::Share(0.0), [40; 3]), (At::Share(1.0), [230; 3])], land: false }
            }
            Some(Named::Perceptual(of)) => Ramp { stops: shares(&of), land: false },
            None => {
                let path = Path::new(name);
                if !path.exists() {
                    return Err(Error::Argument(format!("--ramp {name}: no such file, and no ramp of {NAMES}")));
                }
                let text = std::fs::read(path).map_err(|e| Error::io(path, "read", e))?;
                Ramp { stops: stops(path, &text)?, land: false }
            }
        }))
    }

    /// Whether a stop has a height, not a share of the relief.
    pub fn names_heights(&self) -> bool {
        self.stops.iter().any(|(at, _)| matches!(at, At::Value(_)))
    }

    /// Colours of heights from `low` to `high`.
    pub fn over(&self, low: f64, high: f64) -> RampTable {
        let value = |at: At| match at {
            At::Value(v) => v,
            At::Share(t) => low + t * (high - low),
        };
        let mut stops: Vec<(f64, [f64; 3])> = self.stops.iter().map(|&(at, c)| (value(at), c.map(f64::from))).collect();
        stops.sort_by(|a, b| a.0.total_cmp(&b.0));
        RampTable { stops, land: self.land }
    }
}

/// Lines of `height red green blue [alpha]`.
fn stops(path: &Path, text: &[u8]) -> Result<Vec<(At, Rgb)>> {
    let mut stops = Vec::new();
    let text = String::from_utf8_lossy(text);
    for (line, number) in text.trim_start_matches('\u{feff}').lines().zip(1..) {
        let line = line.split('#').next().unwrap_or_default();
        let words: Vec<&str> = line.split([' ', '\t', ',', ':']).filter(|w| !w.is_empty()).collect();
        let fail = |what: &str| Err(Error::format(path, format!("line {number}: {what}")));
        let Some((place, color)) = words.split_first() else { continue };
        if place.eq_ignore_ascii_case("nv") {
            continue;
        }
        let at = match place.strip_suffix('%') {
            Some(share) => share.parse().ok().filter(|s: &f64| s.is_finite()).map(|s| At::Share(s / 100.0)),
            None => place.parse().ok().filter(|v: &f64| v.is_finite()).map(At::Value),
        };
        let Some(at) = at else { return fail("expected a height or a percentage") };
        let channels: Option<Vec<u8>> = color.iter().map(|c| c.parse().ok()).collect();
        match channels.as_deref() {
            Some(&[r, g, b] | &[r, g, b, _]) => stops.push((at, [r, g, b])),
            _ => return fail("expected red, green and blue from 0 to 255 after the height"),
        }
    }
    if stops.is_empty() {
        return Err(Error::format(path, "no line of height, red, green and blue"));
    }
    Ok(stops)
}

/// Colours of the heights of one map.
#[derive(Clone, Debug)]
pub struct RampTable {
    stops: Vec<(f64, [f64; 3])>,
    land: bool,
}

impl RampTable {
    /// Red, green and blue, 0 to 255, of a height.
    pub fn tint(&self, height: f64) -> [f64; 3] {
        let next = self.stops.partition_point(|s| s.0 <= height);
        match (next.checked_sub(1).map(|i| self.stops[i]), self.stops.get(next)) {
            (Some((a, from)), Some(&(b, to))) => {
                let t = (height - a) / (b - a);
                std::array::from_fn(|k| from[k] + t * (to[k] - from[k]))
            }
            (Some((_, color)), None) | (None, Some(&(_, color))) => color,
            (None, None) => [0.0; 3],
        }
    }
}

/// Colours of a map's columns.
pub(super) struct Colors<'a> {
    pub table: &'a RampTable,
    pub heights: &'a Heights,
    /// Widths of a pixel, x and z, in the unit of the heights.
    pub pixel: [f64; 2],
    pub means: &'a Means,
}

impl Colors<'_> {
    /// Those of columns `x .. x + n` of row `z`.
    pub fn row(&self, x: u32, n: u32, z: u32, out: &mut Vec<Rgb>) -> Result<()> {
        let Heights { width, height, .. } = *self.heights;
        let from = x.saturating_sub(1);
        let to = (x + n + 1).min(width);
        let mut rows = [0, 1, 2].map(|_| vec![f32::NAN; (to - from) as usize]);
        for (row, z) in rows.iter_mut().zip([z.saturating_sub(1), z, (z + 1).min(height - 1)]) {
            self.heights.row(from, z, row)?;
        }
        for x in x..x + n {
            let at = |dx: i64, row: usize| {
                let i = (i64::from(x) + dx).clamp(0, i64::from(width) - 1) - i64::from(from);
                f64::from(rows[row][i as usize])
            };
            let here = at(0, 1);
            if !here.is_finite() {
                out.push([0; 3]);
                continue;
            }
            let mut color = self.table.tint(here);
            if self.table.land {
                // A neighbour without data is as high as this one.
                let near = |v: f64| if v.is_finite() { v } else { here };
                let rise = |a: f64, b: f64, wide: f64| (near(b) - near(a)) / (2.0 * wide);
                let slope = rise(at(-1, 1), at(1, 1), self.pixel[0]).hypot(rise(at(0, 0), at(0, 2), self.pixel[1]));
                let rock = ((slope - ROCKY[0]) / (ROCKY[1] - ROCKY[0])).clamp(0.0, 1.0) * 0.7;
                let above = (here - self.means.at(x, z)) / self.means.relief;
                let light = 1.0 + HOLLOW * above.clamp(-1.0, 1.0);
                color = std::array::from_fn(|k| (color[k] + rock * (ROCK[k] - color[k])) * light);
            }
            out.push(color.map(|c| c.round().clamp(0.0, 255.0) as u8));
        }
        Ok(())
    }
}

/// Mean heights of square cells, and of the eight around each: what is a hollow and what a ridge.
pub(super) struct Means {
    cell: u32,
    across: usize,
    /// NaN where no pixel of a cell or around it has data.
    means: Vec<f32>,
    /// Height above the mean that counts as all of a ridge.
    relief: f64,
}

impl Means {
    pub fn new(heights: &Heights) -> Result<Means> {
        let Heights { width, height, low, high, .. } = *heights;
        let mut cell = CELL;
        while u64::from(width.div_ceil(cell)) * u64::from(height.div_ceil(cell)) > CELLS {
            cell *= 2;
        }
        let (across, along) = (width.div_ceil(cell) as usize, height.div_ceil(cell) as usize);
        let mut sums = vec![(0.0f64, 0u32); across * along];
        let mut row = vec![0.0; width as usize];
        for z in 0..height {
            heights.row(0, z, &mut row)?;
            for (x, &v) in row.iter().enumerate().filter(|(_, v)| v.is_finite()) {
                let sum = &mut sums[(z / cell) as usize * across + x / cell as usize];
                *sum = (sum.0 + f64::from(v), sum.1 + 1);
            }
        }
        let around = |i: usize| {
            let (x, z) = (i % across, i / across);
            let cells = (z.saturating_sub(1)..(z + 2).min(along))
                .flat_map(|z| (x.saturating_sub(1)..(x + 2).min(across)).map(move |x| z * across + x));
            let (sum, n) = cells.map(|i| sums[i]).fold((0.0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
            (sum / f64::from(n)) as f32
        };
        let means = (0..sums.len()).map(around).collect();
        Ok(Means { cell, across, means, relief: ((high - low) / 14.0).max(f64::MIN_POSITIVE) })
    }

    /// The mean around a pixel, between those of the cells' middles.
    fn at(&self, x: u32, z: u32) -> f64 {
        let along = self.means.len() / self.across;
        let place = |v: u32, n: usize| {
            let at = ((f64::from(v) + 0.5) / f64::from(self.cell) - 0.5).clamp(0.0, n as f64 - 1.0);
            let low = at.floor() as usize;
            (low, (low + 1).min(n - 1), at - low as f64)
        };
        let ((x0, x1, u), (z0, z1, v)) = (place(x, self.across), place(z, along));
        let (mut sum, mut weights) = (0.0, 0.0);
        for (x, z, weight) in
            [(x0, z0, (1.0 - u) * (1.0 - v)), (x1, z0, u * (1.0 - v)), (x0, z1, (1.0 - u) * v), (x1, z1, u * v)]
        {
            let mean = f64::from(self.means[z * self.across + x]);
            if mean.is_finite() {
                (sum, weights) = (sum + weight * mean, weights + weight);
            }
        }
        sum / weights
    }
}

/// How much higher a relief is drawn than it is wide.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Exaggeration {
    /// As much as shows it.
    Auto,
    Times(f64),
}

impl std::str::FromStr for Exaggeration {
    type Err = String;

    fn from_str(s: &str) -> Result<Exaggeration, String> {
        let times = |s: &str| s.trim().parse().ok().filter(|v: &f64| *v > 0.0 && v.is_finite());
        match s {
            "auto" => Ok(Exaggeration::Auto),
            _ => times(s).map(Exaggeration::Times).ok_or_else(|| "expected a number above 0, or auto".to_owned()),
        }
    }
}

impl Exaggeration {
    /// The factor for a relief of so many voxels on a map whose longer side has `side` columns.
    pub(super) fn factor(self, relief: f64, side: u32) -> f64 {
        match self {
            Exaggeration::Times(factor) => factor,
            Exaggeration::Auto if relief > 0.0 => {
                let factor = f64::from(side) / 10.0 / relief;
                (2.0 * factor).floor().clamp(2.0, 20.0) / 2.0
            }
            Exaggeration::Auto => 1.0,
        }
    }
}

/// The map with another number of columns and rows.
pub(super) fn resample(heights: &Heights, width: u32, height: u32) -> Result<Heights> {
    let mut out = Heights::new(width, height)?;
    let (across, along) = (axis(heights.width, width), axis(heights.height, height));
    let mut row = vec![0.0; heights.width as usize];
    // Rows of the source, squeezed or stretched to the new width, that the next row of the result may need.
    let mut ready: std::collections::VecDeque<(u32, Vec<(f64, f64)>)> = std::collections::VecDeque::new();
    for (z, taps) in along.iter().enumerate() {
        while ready.front().is_some_and(|(at, _)| *at < taps.first) {
            ready.pop_front();
        }
        let last = taps.first + taps.weights.len() as u32 - 1;
        for at in ready.back().map_or(taps.first, |(at, _)| at + 1)..=last {
            heights.row(0, at, &mut row)?;
            let squeezed = across.iter().map(|taps| {
                let values = &row[taps.first as usize..][..taps.weights.len()];
                values
                    .iter()
                    .zip(&taps.weights)
                    .filter(|(v, _)| v.is_finite())
                    .fold((0.0, 0.0), |(sum, all), (&v, w)| (sum + w * f64::from(v), all + w))
            });
            ready.push_back((at, squeezed.collect()));
        }
        let line: Vec<f32> = (0..width as usize)
            .map(|x| {
                let (mut sum, mut all) = (0.0, 0.0);
                for ((_, row), weight) in ready.iter().zip(&taps.weights) {
                    (sum, all) = (sum + weight * row[x].0, all + weight * row[x].1);
                }
                // Weights sum to 1 where all pixels have data; a column with less than half of them has none.
                if all >= 0.5 { (sum / all) as f32 } else { f32::NAN }
            })
            .collect();
        out.put(0, z as u32, width, &line)?;
    }
    Ok(out)
}

/// Pixels that one column is made of, and how much of each.
struct Taps {
    first: u32,
    weights: Vec<f64>,
}

/// Those of each of `to` columns over `from` pixels.
fn axis(from: u32, to: u32) -> Vec<Taps> {
    let step = f64::from(from) / f64::from(to);
    let last = f64::from(from) - 1.0;
    let taps = |i: u32| {
        let weight_at: Box<dyn Fn(f64) -> f64>;
        let (low, high) = if step > 1.0 {
            let (a, b) = (f64::from(i) * step, f64::from(i + 1) * step);
            // Of pixel j, which reaches from j to j + 1.
            weight_at = Box::new(move |j| (b.min(j + 1.0) - a.max(j)).max(0.0));
            (a.floor(), (b.ceil() - 1.0).min(last))
        } else {
            let center = (f64::from(i) + 0.5) * step - 0.5;
            weight_at = Box::new(move |j| keys(center - j));
            (center.floor() - 1.0, center.floor() + 2.0)
        };
        // What lies outside the map is its edge's.
        let (first, end) = (low.clamp(0.0, last), high.clamp(0.0, last));
        let mut weights = vec![0.0; (end - first) as usize + 1];
        let mut j = low;
        while j <= high {
            weights[(j.clamp(0.0, last) - first) as usize] += weight_at(j);
            j += 1.0;
        }
        let sum: f64 = weights.iter().sum();
        weights.iter_mut().for_each(|w| *w /= sum);
        Taps { first: first as u32, weights }
    };
    (0..to).map(taps).collect()
}

/// Keys' kernel of cubic convolution, a = −½.
fn keys(t: f64) -> f64 {
    match t.abs() {
        t if t < 1.0 => (1.5 * t - 2.5) * t * t + 1.0,
        t if t < 2.0 => ((-0.5 * t + 2.5) * t - 4.0) * t + 2.0,
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(width: u32, height: u32, of: impl Fn(f64, f64) -> f64) -> Heights {
        let at = |i: u32| of(f64::from(i % width) + 0.5, f64::from(i / width) + 0.5) as f32;
        Heights::of(width, height, &(0..width * height).map(at).collect::<Vec<_>>()).unwrap()
    }

    fn rows(heights: &Heights) -> Vec<Vec<f32>> {
        let row = |z| {
            let mut row = vec![0.0; heights.width as usize];
            heights.row(0, z, &mut row).unwrap();
            row
        };
        (0..heights.height).map(row).collect()
    }

    /// Cubic convolution keeps polynomials up to the second degree, means keep planes.
    #[test]
    fn resampling_keeps_what_it_must() {
        let plane = |x: f64, z: f64| 3.0 * x - 0.5 * z + 7.0;
        let curve = |x: f64, z: f64| 0.25 * x * x - 0.125 * x * z + z;
        for (size, of) in [([80, 60], &plane as &dyn Fn(f64, f64) -> f64), ([33, 41], &curve), ([10, 6], &plane)] {
            let source = map(20, 18, of);
            let out = resample(&source, size[0], size[1]).unwrap();
            let step = [20.0 / f64::from(size[0]), 18.0 / f64::from(size[1])];
            let margin = [0, 1].map(|k| (2.5 / step[k]).ceil() as usize);
            let found = rows(&out);
            let mut n = 0;
            for (z, row) in found.iter().enumerate().take(size[1] as usize - margin[1]).skip(margin[1]) {
                for (x, &height) in row.iter().enumerate().take(size[0] as usize - margin[0]).skip(margin[0]) {
                    let expected = of((x as f64 + 0.5) * step[0], (z as f64 + 0.5) * step[1]);
                    assert!((f64::from(height) - expected).abs() < 1e-4, "{x}, {z}: {height} {expected}");
                    n += 1;
                }
            }
            assert!(n > 0, "{size:?}");
        }
        let flat = resample(&map(7, 5, |_, _| 42.0), 19, 3).unwrap();
        assert!(rows(&flat).iter().flatten().all(|&v| v == 42.0), "edges keep what is flat");
    }

    #[test]
    fn resampling_leaves_what_has_no_data() {
        let holed = map(16, 16, |x, _| if x < 8.0 { 5.0 } else { f64::NAN });
        for n in [5, 16, 48] {
            let out = resample(&holed, n, n).unwrap();
            for row in rows(&out) {
                for (x, v) in row.iter().enumerate() {
                    let at = (x as f64 + 0.5) * 16.0 / f64::from(n);
                    if (at - 8.0).abs() > 16.0 / f64::from(n) {
                        assert_eq!(v.is_finite(), at < 8.0, "{n}: {x}");
                    }
                    assert!(!v.is_finite() || (v - 5.0).abs() < 1e-5, "no data takes no part: {v}");
                }
            }
        }
    }

    #[test]
    fn exaggeration_shows_relief_and_lowers_none() {
        assert_eq!(Exaggeration::Auto.factor(28.0, 1058), 3.5);
        assert_eq!(Exaggeration::Auto.factor(62.0, 467), 1.0);
        assert_eq!(Exaggeration::Auto.factor(0.0, 467), 1.0, "a plain stays one");
        assert_eq!(Exaggeration::Auto.factor(1.0, 4000), 10.0);
        assert_eq!("2.5".parse(), Ok(Exaggeration::Times(2.5)));
        assert!("0".parse::<Exaggeration>().is_err() && "much".parse::<Exaggeration>().is_err());
    }

    #[test]
    fn ramps_mix_between_their_stops() {
        let path = Path::new("r.txt");
        let text = b"\xef\xbb\xbf# GDAL\n100 0 0 0\n200,100,200:250 255\n50% 9 9 9 # half\nnv 1 2 3\n";
        let ramp = Ramp { stops: stops(path, text).unwrap(), land: false };
        let table = ramp.over(0.0, 1000.0);
        assert_eq!(table.tint(50.0), [0.0; 3]);
        assert_eq!(table.tint(150.0), [50.0, 100.0, 125.0]);
        assert_eq!(table.tint(5000.0), [9.0; 3]);
        for (text, what) in [
            (&b"high 1 2 3"[..], "line 1: expected a height or a percentage"),
            (b"\n1 2 3", "line 2: expected red, green and blue"),
            (b"1 2 3 256", "line 1: expected red"),
            (b"nv 0 0 0", "no line of height"),
        ] {
            assert!(stops(path, text).unwrap_err().to_string().contains(what), "{what}");
        }
        assert!(Ramp::find("none").unwrap().is_none());
        assert!(Ramp::find("no/such.txt").unwrap_err().to_string().contains("no ramp of terrain, grey, viridis"));
        // Of matplotlib: viridis from #440154 to #fde725.
        let viridis = Ramp::find("viridis").unwrap().unwrap().over(10.0, 20.0);
        assert_eq!(viridis.tint(10.0), [68.0, 1.0, 84.0]);
        assert_eq!(viridis.tint(20.0), [253.0, 231.0, 37.0]);
    }

    #[test]
    fn land_shows_rock_on_slopes_and_shade_in_hollows() {
        let table = Ramp::find("terrain").unwrap().unwrap().over(0.0, 100.0);
        let color = |heights: &Heights, x: u32, z: u32| {
            let means = Means::new(heights).unwrap();
            let mut out = Vec::new();
            Colors { table: &table, heights, pixel: [1.0, 1.0], means: &means }.row(x, 1, z, &mut out).unwrap();
            out[0]
        };
        let flat = map(64, 64, |_, _| 40.0);
        assert_eq!(color(&flat, 30, 30), [74, 112, 54], "the tint of 40 % of the relief");
        let steep = map(64, 64, |x, _| 40.0 + (x - 30.5) * 2.0);
        let [r, g, b] = color(&steep, 30, 30);
        assert!(r > 100 && g < 112 && b > 60, "rock: {:?}", [r, g, b]);
        let hollow = map(64, 64, |x, z| if (x - 32.0).hypot(z - 32.0) < 3.0 { 40.0 } else { 60.0 });
        let plain = color(&flat, 32, 32);
        let dark = color(&hollow, 32, 32);
        assert!((0..3).all(|k| dark[k] < plain[k]), "{dark:?} {plain:?}");
    }
}
