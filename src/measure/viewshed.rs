//! Which columns are seen from a place: `planecast viewshed`.
//!
//! From the eye two rays go through each column of the world's border, so that every column is crossed by some (Franklin & Ray
//! 1994, "R2"; deviates: columns are boxes, not points). Along a ray a column is seen where any part of its voxels' faces shows
//! between what nearer columns cover. Of heights that is one number, the horizon's slope; of other worlds a list of slopes that
//! are still open.
//!
//! A ray is f64, and crossings are computed anew from whole cells at each step. Columns are of level 0.

use std::io::{self, Write};
use std::path::Path;
use std::sync::atomic::{AtomicU8, Ordering};

use glam::DVec3;
use planecast_encoder::format::TILE;
use planecast_encoder::{About, PcastFile};
use rayon::prelude::*;

use crate::frame::plane_setup::EYE_LIMIT;
use crate::world::tables::{Paint, ResidentLevel, Table};
use crate::{Error, Result};

/// How many places see each column, row by row: `z · nx + x`.
pub struct Viewshed {
    pub width: u32,
    pub height: u32,
    pub eyes: usize,
    pub counts: Counts,
    /// Of the eyes, those inside something solid: they see the column that they are in.
    pub inside: Vec<usize>,
}

/// As wide as the number of places asks for.
pub enum Counts {
    Few(Vec<u8>),
    Many(Vec<u16>),
}

impl Counts {
    pub fn len(&self) -> usize {
        match self {
            Counts::Few(counts) => counts.len(),
            Counts::Many(counts) => counts.len(),
        }
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    pub fn get(&self, column: usize) -> u16 {
        match self {
            Counts::Few(counts) => counts[column].into(),
            Counts::Many(counts) => counts[column],
        }
    }

    fn iter(&self) -> impl Iterator<Item = u16> + '_ {
        (0..self.len()).map(|column| self.get(column))
    }

    /// Adds what one place sees, and takes it away there.
    fn add(&mut self, seen: &mut [u8]) {
        let pairs = seen.par_iter_mut().map(std::mem::take);
        match self {
            Counts::Few(counts) => counts.par_iter_mut().zip(pairs).for_each(|(count, seen)| *count += seen),
            Counts::Many(counts) => {
                counts.par_iter_mut().zip(pairs).for_each(|(count, seen)| *count += u16::from(seen))
            }
        }
    }
}

/// Rays through each column of the border: one would miss slivers of two columns in a thousand.
const RAYS_A_COLUMN: usize = 2;

/// Rays that a thread walks side by side: they cross about the same columns.
const RAYS_A_TASK: usize = 256;

/// Columns that a ray is walked over before the next one has its turn: so few rows of the table that neighbours find them near.
const AT_ONCE: usize = 64;

/// Level 0 of a scene of heights, read without all else; `None` where a column is more than one run from the ground up.
pub fn heights(file: &PcastFile) -> Result<Option<ResidentLevel>> {
    let grid = &file.grids()[0];
    let [nx, ny, nz] = grid.dims;
    if ny > u32::from(u16::MAX) {
        return Ok(None);
    }
    let n = nx as usize * nz as usize;
    // Whole words, as such tables are.
    let mut heights = vec![0u16; n.next_multiple_of(2)];
    let row = |tz: usize, heights: &mut [u16]| -> Result<bool> {
        for tx in 0..grid.tiles[0] {
            let tile = file.tile(0, tx, tz as u32)?;
            let [xs, _] = grid.columns(tx, tz as u32);
            let solid = &tile.solid;
            let width = xs.len();
            for column in 0..solid.offsets().len() - 1 {
                let height = match &solid.runs()[solid.range(column)] {
                    [] => 0,
                    [run] if run.first() == 0 => run.end() as u16,
                    _ => return Ok(false),
                };
                heights[column / width * nx as usize + xs.start as usize + column % width] = height;
            }
        }
        Ok(true)
    };
    let rows = heights[..n].par_chunks_mut(TILE as usize * nx as usize).enumerate();
    let all: Result<Vec<bool>> = rows.map(|(tz, heights)| row(tz, heights)).collect();
    if all?.contains(&false) {
        return Ok(None);
    }
    let top = heights.par_iter().copied().max().unwrap_or(0).into();
    let level = ResidentLevel {
        nx,
        nz,
        table: Table::Heights(heights),
        blocks: Vec::new(),
        bottom: 0,
        top,
        paint: Paint::None,
        pages: None,
    };
    Ok(Some(level))
}

/// Which columns each of `eyes` sees of a level 0.
///
/// # Errors
/// [`Error::Argument`] where an eye is not a place; [`Error::Limit`] where there is none, or more than 65,535.
pub fn viewshed(level: &ResidentLevel, eyes: &[DVec3]) -> Result<Viewshed> {
    if eyes.is_empty() || eyes.len() > usize::from(u16::MAX) {
        return Err(Error::Limit(format!("{} places to see from: must be 1 to {}", eyes.len(), u16::MAX)));
    }
    if let Some(eye) = eyes.iter().find(|e| e.is_nan() || e.abs().max_element() > EYE_LIMIT) {
        return Err(Error::Argument(format!("--eye {:?}: must be within ±{EYE_LIMIT:e} voxels", eye.to_array())));
    }
    let [width, height] = [level.nx, level.nz];
    let n = width as usize * height as usize;
    let mut seen = vec![0u8; n];
    let mut inside = Vec::new();
    let mut look = |i: usize, seen: &mut [u8]| match inside_column(level, eyes[i]) {
        // An eye in something solid sees that.
        Some(column) => {
            inside.push(i);
            seen[column] = 1;
        }
        None => look_round(level, eyes[i], as_atomic(seen)),
    };
    let counts = if eyes.len() == 1 {
        look(0, &mut seen);
        Counts::Few(seen)
    } else {
        let mut counts = match u8::try_from(eyes.len()) {
            Ok(_) => Counts::Few(vec![0; n]),
            Err(_) => Counts::Many(vec![0; n]),
        };
        for i in 0..eyes.len() {
            look(i, &mut seen);
            counts.add(&mut seen);
        }
        counts
    };
    Ok(Viewshed { width, height, eyes: eyes.len(), counts, inside })
}

/// Bytes that several threads may mark.
fn as_atomic(bytes: &mut [u8]) -> &[AtomicU8] {
    // SAFETY: both have one layout, and nobody else has these bytes meanwhile.
    unsafe { std::slice::from_raw_parts(bytes.as_mut_ptr().cast(), bytes.len()) }
}

/// The column whose voxels hold an eye.
fn inside_column(level: &ResidentLevel, eye: DVec3) -> Option<usize> {
    let [x, y, z] = eye.floor().to_array();
    let within = |v: f64, n: u32| v >= 0.0 && v < f64::from(n);
    if !within(x, level.nx) || !within(z, level.nz) {
        return None;
    }
    let column = z as usize * level.nx as usize + x as usize;
    level.column(column).any(|run| y >= f64::from(run.first()) && y < f64::from(run.end())).then_some(column)
}

fn look_round(level: &ResidentLevel, eye: DVec3, seen: &[AtomicU8]) {
    let [nx, nz] = [level.nx as usize, level.nz as usize];
    // Border columns once round, each beside the next: neighbouring rays meet the same columns.
    let around = match (nx, nz) {
        (1, _) | (_, 1) => nx * nz,
        _ => 2 * (nx + nz) - 4,
    };
    // A column of the border, and along which axis its neighbours lie.
    let cell = |i: usize| -> ([usize; 2], usize) {
        match i {
            _ if nz == 1 => ([i, 0], 0),
            _ if nx == 1 => ([0, i], 1),
            i if i < nx => ([i, 0], 0),
            i if i < nx + nz - 2 => ([nx - 1, i - nx + 1], 1),
            i if i < 2 * nx + nz - 2 => ([2 * nx + nz - 3 - i, nz - 1], 0),
            i => ([0, around - i], 1),
        }
    };
    let target = |i: usize| {
        let (cell, axis) = cell(i / RAYS_A_COLUMN);
        let mut to = cell.map(|v| v as f64 + 0.5);
        to[axis] += (i % RAYS_A_COLUMN) as f64 / RAYS_A_COLUMN as f64 + 0.5 / RAYS_A_COLUMN as f64 - 0.5;
        to
    };
    let around = around * RAYS_A_COLUMN;
    (0..around.div_ceil(RAYS_A_TASK)).into_par_iter().for_each(|task| {
        let directions = (task * RAYS_A_TASK..((task + 1) * RAYS_A_TASK).min(around)).map(|i| {
            let to = target(i);
            let dir = [to[0] - eye.x, to[1] - eye.z];
            if dir == [0.0; 2] { [1.0, 0.0] } else { dir }
        });
        let size = [level.nx, level.nz];
        match &level.table {
            Table::Heights(heights) if eye.y >= 0.0 => {
                let horizon = f64::NEG_INFINITY;
                let mut rays: Vec<_> =
                    directions.filter_map(|dir| Some((Ray::new(size, eye, dir)?, horizon))).collect();
                while !rays.is_empty() {
                    rays.retain_mut(|(ray, horizon)| over_heights(heights, level, eye, ray, horizon, seen));
                }
            }
            _ => {
                let mut open = Vec::new();
                for mut ray in directions.filter_map(|dir| Ray::new(size, eye, dir)) {
                    over_runs(level, eye, &mut ray, seen, &mut open);
                }
            }
        }
    });
}

/// A ray on its way over the columns.
struct Ray {
    origin: [f64; 2],
    inverse: [f64; 2],
    size: [i64; 2],
    step: [i64; 2],
    cell: [i64; 2],
    next: [f64; 2],
    t: f64,
}

impl Ray {
    /// From where it enters the columns; `None` where it never does.
    fn new([nx, nz]: [u32; 2], eye: DVec3, dir: [f64; 2]) -> Option<Ray> {
        let origin = [eye.x, eye.z];
        let size = [i64::from(nx), i64::from(nz)];
        let (mut t, mut t_end) = (0.0, f64::INFINITY);
        for axis in 0..2 {
            let (o, d, n) = (origin[axis], dir[axis], size[axis] as f64);
            if d == 0.0 {
                if o < 0.0 || o >= n {
                    return None;
                }
                continue;
            }
            let ends = [-o / d, (n - o) / d];
            t = f64::max(t, ends[0].min(ends[1]));
            t_end = f64::min(t_end, ends[0].max(ends[1]));
        }
        if t >= t_end {
            return None;
        }
        let step = dir.map(|d| if d < 0.0 { -1 } else { 1 });
        let inverse = dir.map(|d| if d == 0.0 { f64::INFINITY } else { 1.0 / d });
        let cell = [0, 1].map(|axis| ((origin[axis] + t * dir[axis]).floor() as i64).clamp(0, size[axis] - 1));
        let mut ray = Ray { origin, inverse, size, step, cell, next: [0.0; 2], t };
        ray.next = [0, 1].map(|axis| ray.cross(axis));
        Some(ray)
    }

    /// Where it leaves its column along an axis.
    #[inline(always)]
    fn cross(&self, axis: usize) -> f64 {
        if self.inverse[axis] == f64::INFINITY {
            return f64::INFINITY;
        }
        ((self.cell[axis] + i64::from(self.step[axis] > 0)) as f64 - self.origin[axis]) * self.inverse[axis]
    }

    /// Calls `column(index, t0, t1)` for at most so many columns; false once that says to stop, or the columns end.
    #[inline(always)]
    fn walk(&mut self, most: usize, mut column: impl FnMut(usize, f64, f64) -> bool) -> bool {
        for _ in 0..most {
            let axis = usize::from(self.next[1] < self.next[0]);
            let t1 = self.next[axis];
            if t1 > self.t {
                if !column((self.cell[1] * self.size[0] + self.cell[0]) as usize, self.t, t1) {
                    return false;
                }
                self.t = t1;
            }
            self.cell[axis] += self.step[axis];
            if self.cell[axis] < 0 || self.cell[axis] >= self.size[axis] {
                return false;
            }
            self.next[axis] = self.cross(axis);
        }
        true
    }
}

/// Some columns of a ray; false at its end. What is under the slope `horizon` is covered.
fn over_heights(
    heights: &[u16],
    level: &ResidentLevel,
    eye: DVec3,
    ray: &mut Ray,
    horizon: &mut f64,
    seen: &[AtomicU8],
) -> bool {
    let top = f64::from(level.top) - eye.y;
    ray.walk(AT_ONCE, |column, t0, t1| {
        let height = heights[column];
        if height == 0 {
            return true;
        }
        let h = f64::from(height) - eye.y;
        // Of a top below the eye the far edge is highest, of another the near one; nothing is at no distance but what the eye
        // stands over.
        let t = if h <= 0.0 { t1 } else { t0 };
        if h > *horizon * t || *horizon == f64::NEG_INFINITY {
            // Most are marked already by the ray beside.
            if seen[column].load(Ordering::Relaxed) == 0 {
                seen[column].store(1, Ordering::Relaxed);
            }
            *horizon = h / t;
        }
        !(*horizon > 0.0 && *horizon * t1 >= top)
    })
}

fn over_runs(level: &ResidentLevel, eye: DVec3, ray: &mut Ray, seen: &[AtomicU8], open: &mut Vec<[f64; 2]>) {
    open.clear();
    open.push([f64::NEG_INFINITY, f64::INFINITY]);
    let quotient = |h: f64, t: f64| match t {
        _ if h == 0.0 => 0.0,
        0.0 => h * f64::INFINITY,
        t => h / t,
    };
    let [bottom, top] = [level.bottom, level.top].map(|y| f64::from(y) - eye.y);
    ray.walk(usize::MAX, |column, t0, t1| {
        for run in level.column(column) {
            let (low, high) = (f64::from(run.first()) - eye.y, f64::from(run.end()) - eye.y);
            let low = quotient(low, if low < 0.0 { t0 } else { t1 });
            let high = quotient(high, if high < 0.0 { t1 } else { t0 });
            let from = open.partition_point(|gap| gap[1] <= low);
            let to = open.partition_point(|gap| gap[0] < high);
            if from >= to {
                continue;
            }
            seen[column].store(1, Ordering::Relaxed);
            let (first, last) = (open[from], open[to - 1]);
            let left = [[first[0], low], [high, last[1]]].into_iter().filter(|gap| gap[0] < gap[1]);
            open.splice(from..to, left);
        }
        let (Some(first), Some(last)) = (open.first(), open.last()) else { return false };
        // All that is open looks over the world, or under it.
        !((first[0] > 0.0 && first[0] * t1 >= top) || (last[1] < 0.0 && last[1] * t1 <= bottom))
    });
}

/// What a viewshed is written as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Counts, with the world's georeference.
    Tiff,
    /// Grey: white where all places see.
    Png,
    /// Counts, `<u2`, shape (Z, X).
    Npy,
}

impl Kind {
    /// By the name's ending.
    pub fn of(path: &Path) -> Result<Kind> {
        let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase());
        match ending.as_deref() {
            Some("tif" | "tiff") => Ok(Kind::Tiff),
            Some("png") => Ok(Kind::Png),
            Some("npy") => Ok(Kind::Npy),
            _ => Err(Error::Argument(format!(
                "-o {}: a viewshed is written as .tif (GeoTIFF), .png or .npy; name one of these",
                path.display()
            ))),
        }
    }
}

impl Viewshed {
    /// Columns that at least one place sees.
    pub fn seen(&self) -> u64 {
        (0..self.counts.len()).into_par_iter().filter(|&column| self.counts.get(column) > 0).count() as u64
    }

    /// Writes it; `about` has the georeference.
    pub fn write(&self, kind: Kind, out: &mut (impl Write + io::Seek), about: &About) -> io::Result<()> {
        match kind {
            Kind::Npy => {
                crate::output::npy_header(out, "<u2", &format!("({}, {})", self.height, self.width))?;
                self.counts.iter().try_for_each(|count| out.write_all(&count.to_le_bytes()))
            }
            Kind::Png => {
                let grey = |count: u16| (f64::from(count) / self.eyes as f64 * 255.0).round() as u8;
                let grey: Vec<u8> = self.counts.iter().map(grey).collect();
                let mut encoder = png::Encoder::new(out, self.width, self.height);
                encoder.set_color(png::ColorType::Grayscale);
                let mut writer = encoder.write_header().map_err(io::Error::other)?;
                writer.write_image_data(&grey).and_then(|()| writer.finish()).map_err(io::Error::other)
            }
            Kind::Tiff => self.geotiff(out, about),
        }
    }

    fn geotiff(&self, out: &mut (impl Write + io::Seek), about: &About) -> io::Result<()> {
        use tiff::encoder::{Compression, TiffEncoder, colortype};
        let mut encoder = TiffEncoder::new(out).map_err(io::Error::other)?.with_compression(Compression::Packbits);
        macro_rules! write {
            ($color:ty, $data:expr) => {{
                let mut image = encoder.new_image::<$color>(self.width, self.height).map_err(io::Error::other)?;
                image.rows_per_strip((1 << 20) / self.width.max(1)).map_err(io::Error::other)?;
                tags(image.encoder(), about).map_err(io::Error::other)?;
                image.write_data($data).map_err(io::Error::other)
            }};
        }
        match &self.counts {
            Counts::Few(counts) => write!(colortype::Gray8, counts),
            Counts::Many(counts) => write!(colortype::Gray16, counts),
        }
    }
}

/// Georeference as GeoTIFF 1.1 has it: the corner of the first column, and its sides.
fn tags<W: Write + io::Seek, K: tiff::encoder::TiffKind>(
    directory: &mut tiff::encoder::DirectoryEncoder<'_, W, K>,
    about: &About,
) -> tiff::TiffResult<()> {
    use tiff::tags::Tag;
    let Some([east, north, _]) = about.affine else { return Ok(()) };
    let [a, b, c] = [east[0], east[2], east[3]];
    let [d, e, f] = [north[0], north[2], north[3]];
    if b == 0.0 && d == 0.0 && a > 0.0 && e < 0.0 {
        directory.write_tag(Tag::ModelPixelScaleTag, &[a, -e, 0.0][..])?;
        directory.write_tag(Tag::ModelTiepointTag, &[0.0, 0.0, 0.0, c, f, 0.0][..])?;
    } else {
        let matrix = [a, b, 0.0, c, d, e, 0.0, f, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        directory.write_tag(Tag::ModelTransformationTag, &matrix[..])?;
    }
    // Keys: id, where (0: here), how many, value. Pixels are areas.
    let mut keys: Vec<[u16; 4]> = vec![[1025, 0, 1, 1]];
    let code = about.crs.strip_prefix("EPSG:").and_then(|code| code.parse::<u16>().ok());
    let mut text = String::new();
    match code {
        // The registry's codes of geographic systems.
        Some(code) if (4000..5000).contains(&code) => keys.extend([[1024, 0, 1, 2], [2048, 0, 1, code]]),
        Some(code) => keys.extend([[1024, 0, 1, 1], [3072, 0, 1, code]]),
        None if !about.crs.is_empty() => {
            // As GDAL and Esri have systems that no code names.
            text = format!("ESRI PE String = {}|", about.crs.replace('|', "/"));
            let geographic = about.crs.starts_with("GEOG");
            let citation = if geographic { 2049 } else { 3073 };
            keys.extend([
                [1024, 0, 1, if geographic { 2 } else { 1 }],
                [citation - 1, 0, 1, 32_767],
                [citation, 34_737, text.len() as u16, 0],
            ]);
        }
        None => {}
    }
    keys.sort();
    let mut all: Vec<u16> = vec![1, 1, 1, keys.len() as u16];
    all.extend(keys.iter().flatten());
    directory.write_tag(Tag::GeoKeyDirectoryTag, &all[..])?;
    if !text.is_empty() {
        directory.write_tag(Tag::GeoAsciiParamsTag, text.as_str())?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Resident;
    use crate::{CpuRenderer, Features, Options, Outputs, Projection, World};
    use planecast_encoder::{BuildOptions, Colors, Columns, Input, Scene, build};
    use std::sync::Arc;

    fn resident(scene: &Scene, features: Features) -> Resident {
        Resident::with(scene, features)
    }

    fn scene(dims: [u32; 3], solid: impl Fn(u32, u32, u32) -> bool + Sync) -> Scene {
        let columns = Columns::from_fn(dims[0], dims[1], dims[2], solid);
        build(Input { columns, colors: Colors::None, notes: Vec::new() }, &BuildOptions::default()).unwrap()
    }

    fn noise(x: u32, z: u32) -> u32 {
        let v = x.wrapping_mul(0x9E37_79B1) ^ z.wrapping_mul(0xC2B2_AE3D);
        let v = (v ^ (v >> 15)).wrapping_mul(0x2C1B_3C6D);
        v ^ (v >> 13)
    }

    /// A plain with a wall across it: behind the wall nothing is seen but what stands higher than the line over its top.
    #[test]
    fn viewshed_of_a_wall_ends_behind_it() {
        // Eye at (0.5, 3, 0.5) over a plain of 1; a wall of height 5 at x = 10; a tower of 12 at x = 19.
        let height = |x: u32| match x {
            10 => 5,
            19 => 12,
            _ => 1,
        };
        let scene = scene([24, 16, 1], |x, y, _| y < height(x));
        for features in [Features::ALL, Features::NONE] {
            let shed = viewshed(&resident(&scene, features).levels[0], &[DVec3::new(0.5, 3.0, 0.5)]).unwrap();
            let seen: Vec<u32> = (0..24).filter(|&x| shed.counts.get(x as usize) > 0).collect();
            // The line over the wall: 2 above the eye at 9.5 away, so 3.9 at 18.5: the tower's 9 stand over it.
            assert_eq!(seen, [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 19]);
        }
        // From high above all of the plain is seen but the wall's and the tower's shadows.
        let shed = viewshed(&resident(&scene, Features::ALL).levels[0], &[DVec3::new(0.5, 15.0, 0.5)]).unwrap();
        // Over the wall: −10 at 10.5, so the plain of −14 comes to sight at 14.7 from the eye: the column at 15 ends at 15.5.
        let seen: Vec<u32> = (0..24).filter(|&x| shed.counts.get(x as usize) > 0).collect();
        assert_eq!(seen, [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 15, 16, 17, 18, 19]);
    }

    #[test]
    fn viewshed_is_what_exact_rays_see_and_both_ways_of_walking_agree() {
        let hills = scene([40, 30, 40], |x, y, z| y < 3 + noise(x / 3, z / 3) % 9 + noise(x, z) % 2);
        let caves = scene([40, 30, 40], |x, y, z| noise(x / 4 + 99 * (y / 5), z / 4).is_multiple_of(3) || y < 2);
        // Worlds this small are all edges: 4.3 % was seen, where a real elevation model of 2,048² has less than 0.4 %.
        for (world, hidden_at_most) in [(&hills, 0.05), (&caves, 0.05)] {
            for eye in [DVec3::new(20.3, 29.0, 18.7), DVec3::new(3.4, 13.5, 30.2), DVec3::new(-9.0, 20.0, 55.0)] {
                let [general, fast] =
                    [Features::NONE, Features::ALL].map(|f| viewshed(&resident(world, f).levels[0], &[eye]).unwrap());
                let differ = general.counts.iter().zip(fast.counts.iter()).filter(|(a, b)| a != b).count();
                assert_eq!(differ, 0);
                if !fast.inside.is_empty() {
                    continue;
                }
                let made = Arc::new(world.clone());
                let tables = Arc::new(Resident::new(world));
                let camera = crate::Camera { eye, width: 3000, height: 1500, ..crate::Camera::default() };
                let options =
                    Options { projection: Projection::Equirect, shading: crate::Shading::None, ..Options::default() };
                let frame = CpuRenderer::new(&made, &tables).exact(&camera, &options, Outputs { voxel: true }).unwrap();
                let mut shown = vec![false; 1600];
                for v in frame.voxel.iter().filter(|v| v[3] >= 0) {
                    shown[(v[2] * 40 + v[0]) as usize] = true;
                }
                let missed = (0..1600).filter(|&i| shown[i] && fast.counts.get(i) == 0).count();
                let more = (0..1600).filter(|&i| !shown[i] && fast.counts.get(i) > 0).count();
                let seen = shown.iter().filter(|&&s| s).count();
                println!("{eye}: {seen} shown, {missed} of them not in the viewshed, {more} more there");
                // A corner that shows between two rays; a sliver between two pixels.
                assert!(seen > 300 && (missed + more) as f64 <= hidden_at_most * seen as f64, "{seen} {missed} {more}");
            }
        }
    }

    #[test]
    fn viewsheds_of_many_places_are_counted_and_an_eye_in_solid_sees_its_column() {
        let world = World::from_heights([5, 4], &[2; 20]).unwrap();
        let over = DVec3::new(2.5, 4.0, 1.5);
        let shed = viewshed(&world.resident.levels[0], &[over, DVec3::new(0.5, 1.0, 3.5), over]).unwrap();
        assert_eq!(shed.inside, [1]);
        let mut expected = [2u16; 20];
        expected[15] = 3;
        assert!(shed.counts.iter().eq(expected));
        assert_eq!(shed.seen(), 20);
        assert!(viewshed(&world.resident.levels[0], &[]).is_err());
        assert!(viewshed(&world.resident.levels[0], &[DVec3::new(f64::NAN, 0.0, 0.0)]).is_err());
    }

    #[test]
    fn geotiff_has_counts_and_georeference() {
        let world = World::from_heights([3, 2], &[1, 1, 1, 1, 1, 1]).unwrap();
        let shed = viewshed(&world.resident.levels[0], &[DVec3::new(1.5, 9.0, 0.5)]).unwrap();
        let affine = Some([[30.0, 0.0, 0.0, 500.0], [0.0, 0.0, -30.0, 9000.0], [0.0, 1.0, 0.0, 0.0]]);
        let about = About { affine, crs: "EPSG:32617".into(), ..About::default() };
        let mut bytes = io::Cursor::new(Vec::new());
        shed.write(Kind::Tiff, &mut bytes, &about).unwrap();
        bytes.set_position(0);
        let mut read = tiff::decoder::Decoder::new(bytes).unwrap();
        use tiff::tags::Tag;
        assert_eq!(read.get_tag_f64_vec(Tag::ModelPixelScaleTag).unwrap(), [30.0, 30.0, 0.0]);
        assert_eq!(read.get_tag_f64_vec(Tag::ModelTiepointTag).unwrap(), [0.0, 0.0, 0.0, 500.0, 9000.0, 0.0]);
        let keys = read.get_tag_u16_vec(Tag::GeoKeyDirectoryTag).unwrap();
        assert_eq!(keys, [1, 1, 1, 3, 1024, 0, 1, 1, 1025, 0, 1, 1, 3072, 0, 1, 32617]);
        match read.read_image().unwrap() {
            tiff::decoder::DecodingResult::U8(v) => assert_eq!(v, [1; 6]),
            other => panic!("{other:?}"),
        }
    }
}
