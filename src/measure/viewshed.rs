//! Which columns are seen from a place: `planecast viewshed`.
//!
//! From the eye one ray goes through the middle of each column of the world's border, so that every column is crossed by one at
//! least (Franklin & Ray 1994, "R2"; deviates: columns are boxes, not points). Along a ray a column is seen where any part of its
//! voxels' faces shows between what nearer columns cover. Of heights that is one number, the horizon's slope; of other
//! worlds a list of slopes that are still open.
//!
//! A ray is f64, and crossings are computed anew from whole cells at each step. Columns are of level 0.

use std::io::{self, Write};
use std::path::Path;
use std::sync::atomic::{AtomicU8, Ordering};

use glam::DVec3;
use planecast_encoder::About;
use rayon::prelude::*;

use crate::frame::plane_setup::EYE_LIMIT;
use crate::world::tables::{Resident, ResidentLevel, Table};
use crate::{Error, Result};

/// How many places see each column, row by row: `z · nx + x`.
pub struct Viewshed {
    pub width: u32,
    pub height: u32,
    pub eyes: usize,
    pub counts: Vec<u16>,
    /// Of the eyes, those inside something solid: they see the column that they are in.
    pub inside: Vec<usize>,
}

/// Rays that a thread walks at a time: they cross about the same columns.
const RAYS_A_TASK: usize = 256;

/// Which columns each of `eyes` sees.
///
/// # Errors
/// [`Error::Argument`] where there is no eye, or one is not a place; [`Error::Limit`] where there are more than 65,535.
pub fn viewshed(resident: &Resident, eyes: &[DVec3]) -> Result<Viewshed> {
    if eyes.is_empty() || eyes.len() > usize::from(u16::MAX) {
        return Err(Error::Limit(format!("{} places to see from: must be 1 to {}", eyes.len(), u16::MAX)));
    }
    if let Some(eye) = eyes.iter().find(|e| !(e.abs().max_element() <= EYE_LIMIT)) {
        return Err(Error::Argument(format!("--eye {:?}: must be within ±{EYE_LIMIT:e} voxels", eye.to_array())));
    }
    let level = &resident.levels[0];
    let [width, height] = [level.nx, level.nz];
    let n = width as usize * height as usize;
    let seen: Vec<AtomicU8> = (0..n).into_par_iter().map(|_| AtomicU8::new(0)).collect();
    let mut counts = vec![0u16; n];
    let mut inside = Vec::new();
    for (i, &eye) in eyes.iter().enumerate() {
        match inside_column(level, eye) {
            // An eye in something solid sees that.
            Some(column) => {
                inside.push(i);
                counts[column] += 1;
            }
            None => {
                look_round(level, eye, &seen);
                counts
                    .par_iter_mut()
                    .zip(&seen)
                    .for_each(|(count, seen)| *count += u16::from(seen.swap(0, Ordering::Relaxed)));
            }
        }
    }
    Ok(Viewshed { width, height, eyes: eyes.len(), counts, inside })
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
    let cell = |i: usize| -> [usize; 2] {
        if nx == 1 || nz == 1 {
            return if nz == 1 { [i, 0] } else { [0, i] };
        }
        match i {
            i if i < nx => [i, 0],
            i if i < nx + nz - 2 => [nx - 1, i - nx + 1],
            i if i < 2 * nx + nz - 2 => [2 * nx + nz - 3 - i, nz - 1],
            i => [0, around - i],
        }
    };
    (0..around.div_ceil(RAYS_A_TASK)).into_par_iter().for_each(|task| {
        let mut open = Vec::new();
        for i in task * RAYS_A_TASK..((task + 1) * RAYS_A_TASK).min(around) {
            let to = cell(i).map(|v| v as f64 + 0.5);
            let dir = [to[0] - eye.x, to[1] - eye.z];
            let dir = if dir == [0.0; 2] { [1.0, 0.0] } else { dir };
            match &level.table {
                Table::Heights(heights) if eye.y >= 0.0 => over_heights(heights, level, eye, dir, seen),
                _ => over_runs(level, eye, dir, seen, &mut open),
            }
        }
    });
}

/// A ray over the columns, in steps: calls `column(index, t0, t1)` until that says to stop.
#[inline(always)]
fn walk([nx, nz]: [u32; 2], eye: DVec3, dir: [f64; 2], mut column: impl FnMut(usize, f64, f64) -> bool) {
    let origin = [eye.x, eye.z];
    let size = [i64::from(nx), i64::from(nz)];
    let (mut t0, mut t_end) = (0.0, f64::INFINITY);
    for axis in 0..2 {
        let (o, d, n) = (origin[axis], dir[axis], size[axis] as f64);
        if d == 0.0 {
            if o < 0.0 || o >= n {
                return;
            }
            continue;
        }
        let ends = [-o / d, (n - o) / d];
        t0 = f64::max(t0, ends[0].min(ends[1]));
        t_end = f64::min(t_end, ends[0].max(ends[1]));
    }
    if t0 >= t_end {
        return;
    }
    let inverse = dir.map(|d| if d == 0.0 { f64::INFINITY } else { 1.0 / d });
    let step = dir.map(|d| if d < 0.0 { -1i64 } else { 1 });
    let start = |axis: usize| ((origin[axis] + t0 * dir[axis]).floor() as i64).clamp(0, size[axis] - 1);
    let (mut x, mut z) = (start(0), start(1));
    let cross = |axis: usize, cell: i64| {
        let line = (cell + i64::from(step[axis] > 0)) as f64;
        if dir[axis] == 0.0 { f64::INFINITY } else { (line - origin[axis]) * inverse[axis] }
    };
    let (mut next_x, mut next_z) = (cross(0, x), cross(1, z));
    loop {
        let t1 = next_x.min(next_z);
        if t1 > t0 {
            if !column((z * size[0] + x) as usize, t0, t1) {
                return;
            }
            t0 = t1;
        }
        if next_x <= next_z {
            x += step[0];
            if x < 0 || x >= size[0] {
                return;
            }
            next_x = cross(0, x);
        } else {
            z += step[1];
            if z < 0 || z >= size[1] {
                return;
            }
            next_z = cross(1, z);
        }
    }
}

fn over_heights(heights: &[u16], level: &ResidentLevel, eye: DVec3, dir: [f64; 2], seen: &[AtomicU8]) {
    let top = f64::from(level.top) - eye.y;
    // What is under this slope is covered.
    let mut horizon = f64::NEG_INFINITY;
    walk([level.nx, level.nz], eye, dir, |column, t0, t1| {
        let height = heights[column];
        if height == 0 {
            return true;
        }
        let h = f64::from(height) - eye.y;
        // Of a top below the eye the far edge is highest, of another the near one; nothing is at no distance but what the eye
        // stands over.
        let t = if h <= 0.0 { t1 } else { t0 };
        if h > horizon * t || horizon == f64::NEG_INFINITY {
            // Most are marked already by the ray beside.
            if seen[column].load(Ordering::Relaxed) == 0 {
                seen[column].store(1, Ordering::Relaxed);
            }
            horizon = h / t;
        }
        !(horizon > 0.0 && horizon * t1 >= top)
    });
}

fn over_runs(level: &ResidentLevel, eye: DVec3, dir: [f64; 2], seen: &[AtomicU8], open: &mut Vec<[f64; 2]>) {
    open.clear();
    open.push([f64::NEG_INFINITY, f64::INFINITY]);
    let quotient = |h: f64, t: f64| match t {
        _ if h == 0.0 => 0.0,
        0.0 => h * f64::INFINITY,
        t => h / t,
    };
    let [bottom, top] = [level.bottom, level.top].map(|y| f64::from(y) - eye.y);
    walk([level.nx, level.nz], eye, dir, |column, t0, t1| {
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
        self.counts.par_iter().filter(|&&count| count > 0).count() as u64
    }

    fn bytes(&self, value: impl Fn(u16) -> u8 + Sync) -> Vec<u8> {
        self.counts.par_iter().map(|&count| value(count)).collect()
    }

    /// Writes it; `about` has the georeference.
    pub fn write(&self, kind: Kind, out: &mut (impl Write + io::Seek), about: &About) -> io::Result<()> {
        match kind {
            Kind::Npy => {
                crate::output::npy_header(out, "<u2", &format!("({}, {})", self.height, self.width))?;
                self.counts.iter().try_for_each(|count| out.write_all(&count.to_le_bytes()))
            }
            Kind::Png => {
                let grey = self.bytes(|count| (f64::from(count) / self.eyes as f64 * 255.0).round() as u8);
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
        match u8::try_from(self.eyes) {
            Ok(_) => write!(colortype::Gray8, &self.bytes(|count| count as u8)),
            Err(_) => write!(colortype::Gray16, &self.counts),
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
            let shed = viewshed(&resident(&scene, features), &[DVec3::new(0.5, 3.0, 0.5)]).unwrap();
            let seen: Vec<u32> = (0..24).filter(|&x| shed.counts[x as usize] > 0).collect();
            // The line over the wall: 2 above the eye at 9.5 away, so 3.9 at 18.5: the tower's 9 stand over it.
            assert_eq!(seen, [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 19]);
        }
        // From high above all of the plain is seen but the wall's and the tower's shadows.
        let shed = viewshed(&resident(&scene, Features::ALL), &[DVec3::new(0.5, 15.0, 0.5)]).unwrap();
        // Over the wall: −10 at 10.5, so the plain of −14 comes to sight at 14.7 from the eye: the column at 15 ends at 15.5.
        let seen: Vec<u32> = (0..24).filter(|&x| shed.counts[x as usize] > 0).collect();
        assert_eq!(seen, [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 15, 16, 17, 18, 19]);
    }

    #[test]
    fn viewshed_is_what_exact_rays_see_and_both_ways_of_walking_agree() {
        let hills = scene([40, 30, 40], |x, y, z| y < 3 + noise(x / 3, z / 3) % 9 + noise(x, z) % 2);
        let caves = scene([40, 30, 40], |x, y, z| noise(x / 4 + 99 * (y / 5), z / 4) % 3 == 0 || y < 2);
        for (world, hidden_at_most) in [(&hills, 0.02), (&caves, 0.05)] {
            for eye in [DVec3::new(20.3, 29.0, 18.7), DVec3::new(3.4, 13.5, 30.2), DVec3::new(-9.0, 20.0, 55.0)] {
                let [general, fast] =
                    [Features::NONE, Features::ALL].map(|f| viewshed(&resident(world, f), &[eye]).unwrap());
                let differ = general.counts.iter().zip(&fast.counts).filter(|(a, b)| a != b).count();
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
                let missed = (0..1600).filter(|&i| shown[i] && fast.counts[i] == 0).count();
                let more = (0..1600).filter(|&i| !shown[i] && fast.counts[i] > 0).count();
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
        let shed = viewshed(&world.resident, &[over, DVec3::new(0.5, 1.0, 3.5), over]).unwrap();
        assert_eq!(shed.inside, [1]);
        let mut expected = [2u16; 20];
        expected[15] = 3;
        assert_eq!(shed.counts, expected);
        assert_eq!(shed.seen(), 20);
        assert!(viewshed(&world.resident, &[]).is_err());
        assert!(viewshed(&world.resident, &[DVec3::new(f64::NAN, 0.0, 0.0)]).is_err());
    }

    #[test]
    fn geotiff_has_counts_and_georeference() {
        let world = World::from_heights([3, 2], &[1, 1, 1, 1, 1, 1]).unwrap();
        let shed = viewshed(&world.resident, &[DVec3::new(1.5, 9.0, 0.5)]).unwrap();
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
