//! Clouds of points: LAS and LAZ (feature `las`), and PLY without faces. A voxel is solid where a point is.
//!
//! Points go to a file without a name as they are read, in lists by rows of tiles, so that the cloud need not fit into
//! memory.

use std::io::Write;
use std::ops::Range;
use std::path::Path;

use bytemuck::{Pod, Zeroable};

use super::mesh::{self, Mesh};
use super::spots::{self, Spot};
use super::{ReadOptions, Up, world_dims};
use crate::about::Kind;
use crate::format::TILE;
use crate::pieces::Pieces;
use crate::scratch::{self as file, File, read_at};
use crate::{About, Error, Input, Result};

/// Points of a list that are written together.
const TOGETHER: usize = 4096;

/// Bytes of LAS points that are read together: a record may claim 64 KiB.
#[cfg(feature = "las")]
const AT_ONCE: u64 = 4 << 20;

#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct Record {
    x: u32,
    z: u32,
    y: u16,
    color: [u16; 3],
}

/// A cloud of points in voxels of the world.
pub(super) struct Points {
    dims: [u32; 3],
    file: File,
    /// For each row of tiles, where its points stand and how many.
    lists: Vec<Vec<(u64, u32)>>,
    colored: bool,
    /// What a colour is divided by to have 8 bits.
    color_unit: u32,
    notes: Vec<String>,
    about: About,
    input_bytes: u64,
}

fn scratch(action: &'static str) -> impl Fn(std::io::Error) -> Error {
    move |e| Error::io(std::env::temp_dir(), action, e)
}

impl Points {
    /// The points that `each` gives, one after the other, as place and colour. All lie between `low` and `high`, in world
    /// axes; `scale` is voxels a unit.
    fn new(
        path: &Path,
        [low, high]: [[f64; 3]; 2],
        scale: f64,
        colored: bool,
        each: impl FnOnce(&mut dyn FnMut([f64; 3], [u16; 3]) -> Result<()>) -> Result<()>,
    ) -> Result<Points> {
        let sides = [0, 1, 2].map(|a| (((high[a] - low[a]) * scale) as u64).saturating_add(1));
        let dims = world_dims(path, sides, "give a larger --voxel")?;
        let mut file = file::file().map_err(scratch("create a file in"))?;
        let n_lists = dims[2].div_ceil(TILE) as usize;
        let mut lists = vec![Vec::new(); n_lists];
        let mut waiting: Vec<Vec<Record>> = vec![Vec::new(); n_lists];
        let (mut at, mut n, mut brightest) = (0, 0u64, 0);
        let mut flush = |list: usize, records: &mut Vec<Record>| {
            lists[list].push((at, records.len() as u32));
            file.write_all(bytemuck::cast_slice(records)).map_err(scratch("write a file in"))?;
            at += size_of_val(&records[..]) as u64;
            records.clear();
            Ok::<(), Error>(())
        };
        each(&mut |p, color| {
            if !p.iter().all(|v| v.is_finite()) {
                return Err(Error::format(path, format!("point {n} is at {p:?}; finite numbers were expected")));
            }
            let [x, y, z] = [0, 1, 2].map(|a| (((p[a] - low[a]) * scale) as u32).min(dims[a] - 1));
            brightest = brightest.max(color[0]).max(color[1]).max(color[2]);
            n += 1;
            let list = (z / TILE) as usize;
            waiting[list].push(Record { x, z, y: y as u16, color });
            if waiting[list].len() == TOGETHER { flush(list, &mut waiting[list]) } else { Ok(()) }
        })?;
        for (list, records) in waiting.iter_mut().enumerate().filter(|(_, r)| !r.is_empty()) {
            flush(list, records)?;
        }
        if n == 0 {
            return Err(Error::format(path, "no points"));
        }
        let notes = vec![format!("{n} points, voxels of {} units", 1.0 / scale)];
        // Many writers put 8 bits where 16 belong.
        let color_unit = if brightest > 255 { 257 } else { 1 };
        Ok(Points { dims, file, lists, colored, color_unit, notes, about: About::default(), input_bytes: 0 })
    }

    /// Of a mesh without faces.
    pub fn of_mesh(path: &Path, cloud: Mesh, opts: &ReadOptions) -> Result<Points> {
        let up = opts.up.unwrap_or_default();
        let (low, high) = mesh::bounds(path, &cloud.positions)?;
        let (low, high) = box_of(turn(up, low), turn(up, high));
        let scale = mesh::scale(path, low, high, opts, 512)?;
        // In f32 from here on, so that points on a grid whose steps are no binary fractions come to lie in its cells.
        let cell = |p: [f64; 3]| [0, 1, 2].map(|a| f64::from(((p[a] - low[a]) * scale) as f32));
        let box_of_cells = [cell(low), cell(high)];
        let mut points = Points::new(path, box_of_cells, 1.0, !cloud.colors.is_empty(), |point| {
            cloud.positions.iter().enumerate().try_for_each(|(i, &p)| {
                point(cell(turn(up, p)), cloud.colors.get(i).copied().unwrap_or_default().map(u16::from))
            })
        })?;
        points.notes = vec![format!("{} points, voxels of {} units", cloud.positions.len(), 1.0 / scale)];
        points.about = About { kind: Some(Kind::Points), voxel: Some([1.0 / scale; 3]), ..cloud.about };
        Ok(points)
    }

    /// LAS and LAZ, z up unless `--up` says otherwise. Voxels are as wide as the mean distance of points where nobody
    /// says.
    #[cfg(feature = "las")]
    pub fn las(path: &Path, opts: &ReadOptions) -> Result<Points> {
        super::guarded(path, "LAS", || {
            let fail = |e: las::Error| Error::format(path, format!("LAS: {e}"));
            check_extended(path)?;
            let mut reader = las::Reader::from_path(path).map_err(fail)?;
            let header = reader.header();
            let n = header.number_of_points();
            let (bounds, colored) = (header.bounds(), header.point_format().has_color);
            let ends = [bounds.min, bounds.max].map(|v| [v.x, v.y, v.z]);
            if n == 0 || ends.as_flattened().iter().any(|v| !v.is_finite()) {
                return Err(Error::format(path, format!("LAS: {n} points between {:?} and {:?}", ends[0], ends[1])));
            }
            // What the header claims, against the file before memory is asked for.
            let record = u64::from(header.point_format().len());
            let file_len = std::fs::metadata(path).map_or(0, |m| m.len());
            if !header.point_format().is_compressed && n.checked_mul(record).is_none_or(|len| len > file_len) {
                let claim = format!("{n} points of {record} bytes in a file of {file_len}");
                return Err(Error::format(path, format!("byte 105: LAS: {claim}; it was cut short or is damaged")));
            }
            let at_once = (AT_ONCE / record.max(1)).clamp(1, 1 << 16);
            let up = opts.up.unwrap_or(Up::Z);
            let (low, high) = box_of(turn(up, ends[0]), turn(up, ends[1]));
            let scale = match (opts.voxel, opts.size) {
                (None, None) => (n as f64 / ((high[0] - low[0]) * (high[2] - low[2])).max(f64::MIN_POSITIVE)).sqrt(),
                _ => mesh::scale(path, low, high, opts, 512)?,
            };
            let mut points = Points::new(path, [low, high], scale, colored, |point| {
                loop {
                    let some = reader.read_points(at_once).map_err(fail)?;
                    if some.is_empty() {
                        return Ok(());
                    }
                    let mut places = some.x().zip(some.y()).zip(some.z()).map(|((x, y), z)| turn(up, [x, y, z]));
                    match some.rgb() {
                        Some(colors) => places.zip(colors).try_for_each(|(p, (r, g, b))| point(p, [r, g, b]))?,
                        None => places.try_for_each(|p| point(p, [0; 3]))?,
                    }
                }
            })?;
            points.input_bytes = file_len;
            Ok(points)
        })
    }
}

/// Checks that the extended records of a LAS 1.4 file lie within it: their lengths are 64 bits, and the reader takes
/// memory for what they claim.
#[cfg(feature = "las")]
fn check_extended(path: &Path) -> Result<()> {
    use std::io::{Read, Seek, SeekFrom};
    let failed = |e| Error::io(path, "read", e);
    let mut file = std::fs::OpenOptions::new().read(true).open(path).map_err(|e| Error::io(path, "open", e))?;
    let file_len = file.metadata().map_err(failed)?.len();
    let mut head = Vec::new();
    Read::by_ref(&mut file).take(247).read_to_end(&mut head).map_err(failed)?;
    // Shorter headers and older versions have none.
    if head.len() < 247 || head[25] < 4 {
        return Ok(());
    }
    let mut at = u64::from_le_bytes(head[235..243].try_into().expect("eight bytes"));
    let n = u32::from_le_bytes(head[243..247].try_into().expect("four bytes"));
    for i in 0..if at == 0 { 0 } else { n } {
        let wrong = |what: String| Error::format(path, format!("byte {at}: LAS: extended record {i} of {n} {what}"));
        let content = at.checked_add(60).filter(|&end| end <= file_len);
        let content = content.ok_or_else(|| wrong("is not in the file; it was cut short or is damaged".into()))?;
        let mut record = [0; 60];
        file.seek(SeekFrom::Start(at)).and_then(|_| file.read_exact(&mut record)).map_err(failed)?;
        let len = u64::from_le_bytes(record[20..28].try_into().expect("eight bytes"));
        let end = content.checked_add(len).filter(|&end| end <= file_len);
        let left = file_len - content;
        at = end.ok_or_else(|| wrong(format!("claims {len} bytes of the {left} that are left; it is damaged")))?;
    }
    Ok(())
}

/// A place of the input in world axes.
fn turn(up: Up, [x, y, z]: [f64; 3]) -> [f64; 3] {
    match up {
        Up::X => [z, x, y],
        Up::Y => [x, y, z],
        Up::Z => [x, z, -y],
    }
}

fn box_of(a: [f64; 3], b: [f64; 3]) -> ([f64; 3], [f64; 3]) {
    ([0, 1, 2].map(|i| a[i].min(b[i])), [0, 1, 2].map(|i| a[i].max(b[i])))
}

impl Pieces for Points {
    fn dims(&self) -> [u32; 3] {
        self.dims
    }

    fn colored(&self) -> bool {
        self.colored
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }

    fn about(&self) -> About {
        self.about.clone()
    }

    fn piece(&self, xs: Range<u32>, zs: Range<u32>) -> Result<Input> {
        let dims = [xs.len() as u32, self.dims[1], zs.len() as u32];
        let mut spots = Vec::new();
        let mut records: Vec<Record> = Vec::new();
        for &(at, n) in self.lists[(zs.start / TILE) as usize..zs.end.div_ceil(TILE) as usize].iter().flatten() {
            records.resize(n as usize, Record::zeroed());
            read_at(&self.file, bytemuck::cast_slice_mut(&mut records), at).map_err(scratch("read a file in"))?;
            for r in records.iter().filter(|r| xs.contains(&r.x) && zs.contains(&r.z)) {
                let color = r.color.map(|c| (u32::from(c) / self.color_unit) as u8);
                spots.push(Spot { column: (r.z - zs.start) * dims[0] + r.x - xs.start, y: r.y, color });
            }
        }
        Ok(spots::piece(dims, spots, self.colored))
    }

    fn input_bytes(&self) -> u64 {
        self.input_bytes
    }
}
