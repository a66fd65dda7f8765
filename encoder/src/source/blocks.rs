//! Arrays that lie elsewhere and are read block by block: chunks of a store, tasks of a cluster, slices that a program makes.
//!
//! Of a volume for which no look at all values is needed (a threshold is given, or it has bytes; no ramp, no labels, voxels are
//! cubes) nothing is kept but columns of runs: of one block of columns after the other, each made once, and forgotten when the
//! columns around it no longer ask for it. Blocks that nobody wrote cost nothing where their fill value is air. Other volumes,
//! and height maps, go to a file without a name first.

use std::collections::HashMap;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use rayon::prelude::*;

use super::heights::Heights;
use super::npy::{axes, plain_type};
use super::volume::{Data, Facts, Sample, Stored, Volume, byte_len, with_sample};
use super::{Dtype, ReadOptions, Spacing, Up, heightmap, world_dims};
use crate::model::about::Kind;
use crate::model::filled::filled;
use crate::model::pieces::Pieces;
use crate::store::scratch::{self, write_at};
use crate::{About, Colors, Columns, Error, Input, Result, Run};

/// Bytes that are read at once where chunks are smaller, and where they are larger.
const AT_ONCE: [u64; 2] = [16 << 20, 256 << 20];

/// Columns along a side of a block of columns, at least.
const SIDE: u64 = 64;

/// Bytes of columns that are kept for those around.
const KEPT: u64 = 256 << 20;

/// Who has the values of an array.
pub trait Blocks: Send + Sync {
    /// The values at these places along each axis, the last axis fastest, in this machine's byte order.
    ///
    /// # Errors
    /// Whatever keeps them from being read.
    fn read(&self, places: &[Range<u64>]) -> Result<Vec<u8>>;

    /// Whether anything was ever written there: else all is the fill value.
    fn holds(&self, places: &[Range<u64>]) -> bool {
        _ = places;
        true
    }
}

/// An array that is read block by block.
#[derive(Clone, Debug)]
pub struct BlockArray<'a> {
    /// Three axes (z, y, x), a volume; or two (row, column), a height map.
    pub shape: &'a [u64],
    /// Sides of what is best read at once.
    pub chunk: &'a [u64],
    /// As `numpy.dtype` names it, of this machine's byte order: "uint8", "f4".
    pub dtype: &'a str,
    /// What is where nothing was written.
    pub fill: f64,
    /// The only places that are asked for: one part of a scene is made of it. Empty: all.
    pub region: &'a [Range<u64>],
    /// Least and greatest height of all the map, where a region of it is read.
    pub heights: Option<[f64; 2]>,
    /// All but 0 is solid, each value has a colour of its own.
    pub labels: bool,
}

/// An array as a world. `path` is what errors call it.
///
/// # Errors
/// [`Error::Format`] where shape or type is none that can be read; those of `blocks`; and what the options do not fit.
pub fn blocks<'a>(
    path: &Path,
    array: &BlockArray<'_>,
    blocks: Box<dyn Blocks + 'a>,
    opts: &ReadOptions,
) -> Result<Box<dyn Pieces + 'a>> {
    let fail = |what: String| Error::format(path, what);
    let BlockArray { shape, chunk, .. } = *array;
    let dtype = plain_type(array.dtype).map_err(fail)?;
    let (rank, dims) = axes(shape).map_err(fail)?;
    if rank != shape.len() {
        return Err(fail(format!("an array of shape {shape:?}; leave axes of one place out")));
    }
    if chunk.len() != rank || chunk.contains(&0) || shape.contains(&0) {
        return Err(fail(format!("shape {shape:?} in chunks of {chunk:?}: every side must be at least 1")));
    }
    byte_len(path, dims, dtype)?;
    let region = match array.region {
        [] => shape.iter().map(|&n| 0..n).collect(),
        of => of.to_vec(),
    };
    if region.len() != rank || region.iter().zip(shape).any(|(r, &n)| r.is_empty() || r.end > n) {
        return Err(fail(format!("places {region:?} are not in an array of shape {shape:?}")));
    }
    let chunk: Vec<u64> = chunk.iter().zip(shape).map(|(&c, &n)| c.min(n)).collect();
    let source = Source { path: path.to_owned(), blocks, dtype };
    if rank == 2 {
        let heights = source.heights([shape[0], shape[1]], [chunk[0], chunk[1]], &region, array.heights)?;
        let mut map = heightmap::Map::of(heights);
        map.about.format = "array".to_owned();
        return Ok(Box::new(heightmap::rows(path, map, shape[0] * shape[1] * dtype.size(), opts)?));
    }
    let three = |of: &[u64]| [of[0], of[1], of[2]];
    if needs_no_look(dtype, opts) && !array.labels {
        let known = Known { about: about(), ..Known::default() };
        return Ok(Box::new(Lazy::new(source, three(shape), three(&chunk), region, array.fill, known, opts)?));
    }
    if !array.region.is_empty() {
        let what = "a part of a volume is made of a threshold alone; give --iso V, and neither --ramp nor --spacing";
        return Err(Error::Argument(format!("{}: {what}", path.display())));
    }
    let data = source.copied(three(shape), three(&chunk))?;
    let mut stored = Stored::new(dims, dtype, data);
    stored.big_endian = cfg!(target_endian = "big");
    stored.about = about();
    let facts = Facts { labels: array.labels, measured: array.labels, ..Facts::default() };
    Ok(Box::new(Volume::with(path, stored, facts, opts)?))
}

/// `$body` with `$bytes` those of a number in a volume's type.
macro_rules! with_value {
    ($dtype:expr, $value:expr, |$bytes:ident| $body:expr) => {
        with_value!(@ $dtype, $value, |$bytes| $body; U8 u8, I8 i8, U16 u16, I16 i16, U32 u32, I32 i32, U64 u64, I64 i64, F32 f32,
            F64 f64)
    };
    (@ $dtype:expr, $value:expr, |$bytes:ident| $body:expr; $($variant:ident $t:ident),*) => {
        match $dtype {
            $(Dtype::$variant => {
                let $bytes = ($value as $t).to_ne_bytes();
                $body
            })*
        }
    };
}

fn about() -> About {
    let mut about = About::new(Kind::Volume, "array");
    about.axes = "shape is (z, y, x)".to_owned();
    about
}

/// What is known of the values of a volume beside their type.
#[derive(Default)]
pub(super) struct Known {
    pub scale: Option<(f64, f64)>,
    pub missing: Option<f64>,
    pub about: About,
}

/// A volume of shape (z, y, x), in chunks, with what stands where nobody wrote as far as that is known.
#[cfg(feature = "zarr")]
pub(super) fn volume(
    path: &Path,
    [shape, chunk]: [[u64; 3]; 2],
    (dtype, fill): (Dtype, Option<f64>),
    known: Known,
    blocks: Box<dyn Blocks>,
    opts: &ReadOptions,
) -> Result<Box<dyn Pieces>> {
    let source = Source { path: path.to_owned(), blocks, dtype };
    if let Some(fill) = fill.filter(|_| needs_no_look(dtype, opts) && known.about.voxel.is_none()) {
        let region = shape.iter().map(|&n| 0..n).collect();
        return Ok(Box::new(Lazy::new(source, shape, chunk, region, fill, known, opts)?));
    }
    let data = source.copied(shape, chunk)?;
    let Known { scale, missing, about } = known;
    let big_endian = cfg!(target_endian = "big");
    let [z, y, x] = shape;
    let stored = Stored { big_endian, scale, missing, about, ..Stored::new([x, y, z], dtype, data) };
    Ok(Box::new(Volume::new(path, stored, opts)?))
}

/// Whether what is solid can be told of each value alone, and nothing else is asked for.
fn needs_no_look(dtype: Dtype, opts: &ReadOptions) -> bool {
    let cubes = matches!(opts.spacing, None | Some(Spacing::AsIs | Spacing::Auto));
    (opts.iso.is_some() || dtype == Dtype::U8) && cubes && opts.ramp.is_none()
}

struct Source<'a> {
    path: PathBuf,
    blocks: Box<dyn Blocks + 'a>,
    dtype: Dtype,
}

impl Source<'_> {
    fn read(&self, places: &[Range<u64>]) -> Result<Vec<u8>> {
        let bytes = self.blocks.read(places)?;
        let expected = places.iter().map(|p| p.end - p.start).product::<u64>() * self.dtype.size();
        if bytes.len() as u64 != expected {
            let what = format!("{} bytes of values at {places:?}; expected {expected}", bytes.len());
            return Err(Error::format(&self.path, what));
        }
        Ok(bytes)
    }

    fn bytes(&self, sides: &[u64]) -> u64 {
        sides.iter().fold(self.dtype.size(), |n, &side| n.saturating_mul(side))
    }

    fn heights(
        &self,
        [nz, nx]: [u64; 2],
        [cz, cx]: [u64; 2],
        region: &[Range<u64>],
        ends: Option<[f64; 2]>,
    ) -> Result<Heights> {
        world_dims(&self.path, [nx, 1, nz], "")?;
        let mut out = Heights::new(nx as u32, nz as u32)?;
        if region != [0..nz, 0..nx] {
            out.clear()?;
        }
        // Whole chunks while they are small, strips of those that are not.
        let mut step = [cz, cx];
        while step[0] < nz && self.bytes(&[step[0] * 2, step[1]]) <= AT_ONCE[0] {
            step[0] *= 2;
        }
        while step[0] > 1 && self.bytes(&step) > AT_ONCE[1] {
            step[0] = step[0].div_ceil(2);
        }
        let size = self.dtype.size() as usize;
        for zs in cuts(&region[0], step[0]) {
            let row: Vec<Range<u64>> = cuts(&region[1], step[1]).collect();
            let parts: Vec<Vec<u8>> =
                row.par_iter().map(|xs| self.read(&[zs.clone(), xs.clone()])).collect::<Result<_>>()?;
            for (xs, bytes) in row.iter().zip(&parts) {
                let width = (xs.end - xs.start) as usize;
                let values: Vec<f32> = with_sample!(self.dtype, cfg!(target_endian = "big"), |read| {
                    let value = |b: &[u8]| read(b.try_into().expect("as long as a value")).to_f64() as f32;
                    filled(&vec![width; bytes.len() / (width * size)], "heights", |row, out: &mut [f32]| {
                        let row = bytes[row * width * size..].chunks_exact(size);
                        out.iter_mut().zip(row).for_each(|(out, bytes)| *out = value(bytes));
                    })?
                });
                out.put(xs.start as u32, zs.start as u32, (xs.end - xs.start) as u32, &values)?;
            }
        }
        if let Some([low, high]) = ends {
            (out.low, out.high) = (low, high);
        }
        Ok(out)
    }

    /// All values in a file without a name.
    fn copied(&self, shape: [u64; 3], chunk: [u64; 3]) -> Result<Data<'static>> {
        let [nz, ny, nx] = shape;
        let failed = |action| move |e| Error::io(std::env::temp_dir(), action, e);
        let file = scratch::file().map_err(failed("create a file in"))?;
        let mut step = chunk;
        // Long rows are written at once.
        while step[2] < nx && self.bytes(&step) * 2 <= AT_ONCE[0] {
            step[2] = (step[2] * 2).min(nx);
        }
        while step.iter().any(|&side| side > 1) && self.bytes(&step) > AT_ONCE[1] {
            let most = (0..3).max_by_key(|&i| step[i]).expect("three axes");
            step[most] = step[most].div_ceil(2);
        }
        let size = self.dtype.size();
        let places: Vec<[Range<u64>; 3]> = cuts(&(0..nz), step[0])
            .flat_map(|zs| cuts(&(0..ny), step[1]).map(move |ys| (zs.clone(), ys)))
            .flat_map(|(zs, ys)| cuts(&(0..nx), step[2]).map(move |xs| [zs.clone(), ys.clone(), xs]))
            .collect();
        places.par_iter().try_for_each(|place| {
            let bytes = self.read(place)?;
            let [zs, ys, xs] = place;
            let width = ((xs.end - xs.start) * size) as usize;
            let rows = zs.clone().flat_map(|z| ys.clone().map(move |y| (z, y)));
            for ((z, y), row) in rows.zip(bytes.chunks_exact(width)) {
                write_at(&file, row, ((z * ny + y) * nx + xs.start) * size).map_err(failed("write a file in"))?;
            }
            Ok(())
        })?;
        Ok(Data::File { path: self.path.clone(), file, at: 0, len: nz * ny * nx * size })
    }
}

/// A range in steps, which begin where those of the whole axis do.
fn cuts(of: &Range<u64>, step: u64) -> impl Iterator<Item = Range<u64>> + use<> {
    let (start, end) = (of.start, of.end);
    (start / step..end.div_ceil(step)).map(move |i| (i * step).max(start)..((i + 1) * step).min(end))
}

/// A volume of which columns alone are kept.
struct Lazy<'a> {
    source: Source<'a>,
    shape: [u64; 3],
    region: Vec<Range<u64>>,
    opts: ReadOptions,
    /// The array's axis of world x, y, z; world z may run against it.
    axes: [usize; 3],
    flip_z: bool,
    dims: [u32; 3],
    /// What is read at once, along the array's axes.
    step: [u64; 3],
    /// Whether what nobody wrote is air.
    air: bool,
    kept: Mutex<Kept>,
    known: Known,
    about: About,
}

/// Blocks of columns, by their number along world x and z.
#[derive(Default)]
struct Kept {
    columns: HashMap<[u64; 2], (Arc<Columns>, u64)>,
    bytes: u64,
    /// Pieces so far.
    n: u64,
}

impl<'a> Lazy<'a> {
    fn new(
        source: Source<'a>,
        shape: [u64; 3],
        chunk: [u64; 3],
        region: Vec<Range<u64>>,
        fill: f64,
        known: Known,
        opts: &ReadOptions,
    ) -> Result<Lazy<'a>> {
        let path = &source.path;
        if opts.iso.is_some_and(f64::is_nan) {
            return Err(Error::Argument("--iso is not a number".to_owned()));
        }
        let (axes, flip_z) = match opts.up.unwrap_or_default() {
            Up::X => ([0, 2, 1], false),
            Up::Y => ([2, 1, 0], false),
            Up::Z => ([2, 0, 1], true),
        };
        let dims = world_dims(path, axes.map(|a| shape[a]), "--up chooses another axis")?;
        let mut step = chunk;
        for axis in [axes[0], axes[2], axes[1]] {
            let most = if axis == axes[1] { shape[axis] } else { SIDE.min(shape[axis]) };
            while step[axis] < most && source.bytes(&step) * 2 <= AT_ONCE[0] {
                step[axis] = (step[axis] * 2).min(shape[axis]);
            }
        }
        while step.iter().any(|&side| side > 1) && source.bytes(&step) > AT_ONCE[1] {
            let most = [axes[1], axes[0], axes[2]].into_iter().max_by_key(|&a| step[a]).expect("three axes");
            step[most] = step[most].div_ceil(2);
        }
        // One value tells what is done with those that nobody wrote, and how the whole is spoken of.
        let mut one = Vec::new();
        with_value!(source.dtype, fill, |bytes| one.extend_from_slice(&bytes));
        let stored = Lazy::stored([1; 3], source.dtype, &one, &known);
        let of_fill = Volume::new(path, Stored { about: known.about.clone(), ..stored }, opts)?;
        let air = of_fill.piece(0..1, 0..1)?.columns.runs().is_empty();
        let about = About { values: None, ..of_fill.about.clone() };
        drop(of_fill);
        let (opts, kept) = (opts.clone(), Mutex::default());
        Ok(Lazy { source, shape, region, opts, axes, flip_z, dims, step, air, kept, known, about })
    }

    fn stored<'b>(dims: [u64; 3], dtype: Dtype, bytes: &'b [u8], known: &Known) -> Stored<'b> {
        let Known { scale, missing, .. } = *known;
        let big_endian = cfg!(target_endian = "big");
        Stored { scale, missing, big_endian, ..Stored::new(dims, dtype, Data::Slice(bytes)) }
    }

    /// Places of the array from those of the world, along world axis `k`; or the other way round.
    fn turned(&self, k: usize, of: &Range<u64>) -> Range<u64> {
        let n = u64::from(self.dims[k]);
        if k == 2 && self.flip_z { n - of.end..n - of.start } else { of.clone() }
    }

    /// The blocks of columns that hold places `of` along world axis `k`.
    fn numbers(&self, k: usize, of: &Range<u32>) -> Range<u64> {
        let step = self.step[self.axes[k]];
        let of = self.turned(k, &(of.start.into()..of.end.into()));
        of.start / step..of.end.div_ceil(step)
    }

    /// What a block of columns fills of the world, along world axis `k`.
    fn places(&self, k: usize, number: u64) -> Range<u64> {
        let (axis, step) = (self.axes[k], self.step[self.axes[k]]);
        let end = ((number + 1) * step).min(self.shape[axis]);
        let within = &self.region[axis];
        self.turned(k, &((number * step).max(within.start)..end.min(within.end)))
    }

    fn columns(&self, number: [u64; 2]) -> Result<Arc<Columns>> {
        let n = self.kept.lock().expect("nothing panics with it").n;
        if let Some((columns, used)) = self.kept.lock().expect("nothing panics with it").columns.get_mut(&number) {
            *used = n;
            return Ok(Arc::clone(columns));
        }
        let columns = Arc::new(self.made(number)?);
        let mut kept = self.kept.lock().expect("nothing panics with it");
        kept.bytes += columns.bytes();
        kept.columns.insert(number, (Arc::clone(&columns), n));
        Ok(columns)
    }

    fn made(&self, [i, k]: [u64; 2]) -> Result<Columns> {
        let (xs, zs) = (self.places(0, i), self.places(2, k));
        let [width, depth] = [&xs, &zs].map(|r| (r.end - r.start) as u32);
        let [_, ny, _] = self.dims;
        let mut parts: Vec<(u64, Columns)> = Vec::new();
        for ys in cuts(&(0..u64::from(ny)), self.step[self.axes[1]]) {
            let mut places = [0..0, 0..0, 0..0];
            places[self.axes[0]] = self.turned(0, &xs);
            places[self.axes[1]] = ys.clone();
            places[self.axes[2]] = self.turned(2, &zs);
            if self.air && !self.source.blocks.holds(&places) {
                continue;
            }
            let bytes = self.source.read(&places)?;
            let [z, y, x] = places.map(|p| p.end - p.start);
            let stored = Lazy::stored([x, y, z], self.source.dtype, &bytes, &self.known);
            let part = Volume::new(&self.source.path, stored, &self.opts)?.piece(0..width, 0..depth)?;
            parts.push((ys.start, part.columns));
        }
        Columns::try_from_rows([width, ny, depth], |z, out| {
            for x in 0..width {
                for (up, part) in &parts {
                    let up = *up as u16;
                    part.column(x, z).iter().for_each(|r| out.push_run(Run::new(r.first() + up, r.last() + up)));
                }
                out.end_column();
            }
            Ok(())
        })
    }
}

impl Pieces for Lazy<'_> {
    fn dims(&self) -> [u32; 3] {
        self.dims
    }

    fn colored(&self) -> bool {
        false
    }

    fn notes(&self) -> &[String] {
        &[]
    }

    fn about(&self) -> About {
        self.about.clone()
    }

    fn piece(&self, xs: Range<u32>, zs: Range<u32>) -> Result<Input> {
        self.kept.lock().expect("nothing panics with it").n += 1;
        let (is, ks) = (self.numbers(0, &xs), self.numbers(2, &zs));
        let wanted: Vec<[u64; 2]> = ks.clone().flat_map(|k| is.clone().map(move |i| [i, k])).collect();
        let found: Vec<Arc<Columns>> = wanted.into_par_iter().map(|n| self.columns(n)).collect::<Result<_>>()?;
        let across = (is.end - is.start) as usize;
        let columns = Columns::try_from_rows([xs.len() as u32, self.dims[1], zs.len() as u32], |row, out| {
            let z = u64::from(zs.start + row);
            let k = self.turned(2, &(z..z + 1)).start / self.step[self.axes[2]];
            let local_z = (z - self.places(2, k).start) as u32;
            let mut x = u64::from(xs.start);
            while x < u64::from(xs.end) {
                let i = x / self.step[self.axes[0]];
                let places = self.places(0, i);
                let block = &found[(k - ks.start) as usize * across + (i - is.start) as usize];
                let end = places.end.min(xs.end.into());
                for x in x..end {
                    block.column((x - places.start) as u32, local_z).iter().for_each(|&run| out.push_run(run));
                    out.end_column();
                }
                x = end;
            }
            Ok(())
        })?;
        drop(found);
        let mut kept = self.kept.lock().expect("nothing panics with it");
        if kept.bytes > KEPT {
            let mut ages: Vec<(u64, [u64; 2])> =
                kept.columns.iter().map(|(number, (_, used))| (*used, *number)).collect();
            ages.sort_unstable();
            for (_, number) in ages {
                if kept.bytes <= KEPT / 2 {
                    break;
                }
                if let Some((columns, _)) = kept.columns.remove(&number) {
                    kept.bytes -= columns.bytes();
                }
            }
        }
        Ok(Input { columns, colors: Colors::None, notes: Vec::new() })
    }

    fn input_bytes(&self) -> u64 {
        self.source.bytes(&self.shape)
    }

    /// As a row of blocks is.
    fn rows_together(&self) -> u32 {
        self.step[self.axes[2]].min(1 << 16) as u32
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU64, Ordering};

    use super::*;
    use crate::model::pieces::whole;
    use crate::source::{ArrayView, array};

    /// Values in memory that count how many were read.
    struct Values<'a> {
        shape: [u64; 3],
        values: &'a [u8],
        read: &'a AtomicU64,
    }

    impl Blocks for Values<'_> {
        fn read(&self, places: &[Range<u64>]) -> Result<Vec<u8>> {
            let [_, ny, nx] = self.shape;
            let [zs, ys, xs] = [0, 1, 2].map(|i| places[i].clone());
            let rows = zs.flat_map(|z| ys.clone().map(move |y| ((z * ny + y) * nx) as usize));
            let bytes: Vec<u8> = rows
                .flat_map(|row| self.values[row + xs.start as usize..row + xs.end as usize].iter().copied())
                .collect();
            self.read.fetch_add(bytes.len() as u64, Ordering::Relaxed);
            Ok(bytes)
        }

        fn holds(&self, places: &[Range<u64>]) -> bool {
            let left = self.read.load(Ordering::Relaxed);
            let any = self.read(places).is_ok_and(|bytes| bytes.iter().any(|&b| b != 0));
            self.read.store(left, Ordering::Relaxed);
            any
        }
    }

    #[test]
    fn an_array_by_blocks_is_the_array_at_once() {
        let shape = [35u64, 45, 70];
        let n = shape.iter().product::<u64>() as usize;
        // Mostly nothing, so that there are blocks without a value.
        let values: Vec<u8> = (0..n).map(|i| if i / 70 % 45 > 25 && i % 7 < 3 { (i % 250) as u8 } else { 0 }).collect();
        let path = Path::new("array");
        for up in [Up::X, Up::Y, Up::Z] {
            for chunk in [[16, 16, 16], [1, 45, 70], [35, 7, 33]] {
                for ramp in [None, Some("grey".to_owned())] {
                    let opts = ReadOptions { up: Some(up), iso: Some(100.0), ramp, ..ReadOptions::default() };
                    let view = ArrayView { shape: &shape, dtype: "|u1", fortran: false, bytes: &values };
                    let wanted = array(path, view, &opts).unwrap();
                    let read = AtomicU64::new(0);
                    let source = Values { shape, values: &values, read: &read };
                    let of = BlockArray {
                        shape: &shape,
                        chunk: &chunk,
                        dtype: "uint8",
                        fill: 0.0,
                        region: &[],
                        heights: None,
                        labels: false,
                    };
                    let found = blocks(path, &of, Box::new(source), &opts).unwrap();
                    let (nx, nz) = (wanted.dims()[0], wanted.dims()[2]);
                    assert_eq!(whole(&*found).unwrap().columns, whole(&*wanted).unwrap().columns, "{up:?} {chunk:?}");
                    let piece = |of: &dyn Pieces| of.piece(nx / 3..nx - 5, nz / 2..nz - 1).unwrap().columns;
                    assert_eq!(piece(&*found), piece(&*wanted));
                    // Each value once at most, for the whole and the piece together.
                    assert!(read.load(Ordering::Relaxed) <= n as u64);
                }
            }
        }
    }

    #[test]
    fn a_region_of_an_array_is_that_part_of_the_world() {
        let shape = [40u64, 20, 50];
        let values: Vec<u8> = (0..40_000usize).map(|i| (i * 7 % 251) as u8).collect();
        let read = AtomicU64::new(0);
        let opts = ReadOptions { iso: Some(120.0), up: Some(Up::Z), ..ReadOptions::default() };
        let view = ArrayView { shape: &shape, dtype: "|u1", fortran: false, bytes: &values };
        let wanted = array(Path::new("array"), view, &opts).unwrap();
        let of = BlockArray {
            shape: &shape,
            chunk: &[16, 16, 16],
            dtype: "uint8",
            fill: 0.0,
            region: &[0..40, 3..15, 10..45],
            heights: None,
            labels: false,
        };
        let source = Values { shape, values: &values, read: &read };
        let found = blocks(Path::new("array"), &of, Box::new(source), &opts).unwrap();
        // World z is 19 - y.
        let piece = |of: &dyn Pieces| of.piece(10..45, 5..17).unwrap().columns;
        assert_eq!(piece(&*found), piece(&*wanted));
    }

    #[test]
    fn who_gives_too_little_is_told() {
        struct None;
        impl Blocks for None {
            fn read(&self, _: &[Range<u64>]) -> Result<Vec<u8>> {
                Ok(vec![1; 3])
            }
        }
        let of = BlockArray {
            shape: &[4, 4, 4],
            chunk: &[4, 4, 4],
            dtype: "uint8",
            fill: 0.0,
            region: &[],
            heights: Option::None,
            labels: false,
        };
        let world = blocks(Path::new("array"), &of, Box::new(None), &ReadOptions::default()).unwrap();
        let error = whole(&*world).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains("3 bytes") && error.contains("expected 64"), "{error}");
        let wrong = BlockArray { dtype: "float16", ..of };
        assert!(blocks(Path::new("array"), &wrong, Box::new(None), &ReadOptions::default()).is_err());
    }
}
