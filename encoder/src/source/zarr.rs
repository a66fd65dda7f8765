//! Zarr arrays (versions 2 and 3) and OME-Zarr images as volumes.
//!
//! Which axes are x, y and z is said by the image's metadata (OME-NGFF 0.1 to 0.5), by `dimension_names` (Zarr 3) or
//! `_ARRAY_DIMENSIONS` (xarray); without names the last three are z, y, x. Of channels, times and other axes the first place is
//! read. What values mean is said by the attributes of CF, which xarray and GDAL write: `scale_factor`, `add_offset`, `_FillValue`,
//! `missing_value`, `_Unsigned`, `units`. Of an image's resolutions the finest is read, or the one whose folder is named. Chunks
//! are read as `blocks` asks for them, so that the array need not fit into memory; those that nobody wrote are not, where what
//! they stand for is air.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde_json::Value;
use zarrs::array::{Array, ArrayBytes, ArrayShardedExt, ArraySubset, data_type};
use zarrs::filesystem::FilesystemStore;

use super::blocks::{self, Blocks, Known};
use super::place::in_one_unit;
use super::tiff::half;
use super::{Dtype, ReadOptions, Up, guarded, world_dims};
use crate::model::about::Kind;
use crate::model::pieces::Pieces;
use crate::{About, Error, Result};

/// Bytes of one chunk: what is unpacked at once.
const CHUNK_LIMIT: u64 = 1 << 30;

/// A folder's metadata.
struct Node {
    is_group: bool,
    /// 2 or 3.
    version: u32,
    attributes: Value,
    /// All of an array's own.
    metadata: Value,
}

/// An axis by name, with what an image says of it.
#[derive(Clone, Debug, Default, PartialEq)]
struct Axis {
    name: String,
    /// Of OME-NGFF: "space", "channel", "time".
    kind: String,
    unit: String,
    /// Side of a voxel, 0 where it is not known.
    step: f64,
}

/// What an image says of its array.
#[derive(Default)]
struct Image {
    version: String,
    axes: Vec<Axis>,
    channel: Option<String>,
    left_out: Vec<String>,
}

pub(super) fn read(path: &Path, opts: &ReadOptions) -> Result<Box<dyn Pieces>> {
    let (folder, image) = find(path)?;
    guarded(path, "Zarr", || array(&folder, image, opts))
}

/// The folder of the array that `path` names: itself, the finest resolution of the image there, or the only volume; with
/// what an image above it says.
fn find(path: &Path) -> Result<(PathBuf, Option<Image>)> {
    let mut folder = path.to_owned();
    // A collection, the image in it, its array.
    for _ in 0..3 {
        let own = node(&folder)?;
        if !own.is_group {
            let image = above(&folder)?;
            return Ok((folder, image));
        }
        let image = own.attributes.get("ome").unwrap_or(&own.attributes);
        let array = &image["multiscales"][0]["datasets"][0]["path"];
        let next = match array.as_str() {
            Some(name) => name.to_owned(),
            None if image.get("bioformats2raw.layout").is_some() => "0".to_owned(),
            None if image.get("plate").is_some() || image.get("well").is_some() => {
                let what = "a plate of wells; name an image in it, as in PLATE/A/1/0";
                return Err(Error::format(&folder, what));
            }
            None => only_volume(&folder)?,
        };
        // A name from the file leads nowhere but down.
        if next.is_empty() || next.split(['/', '\\']).any(|part| part.is_empty() || part == "..") {
            return Err(Error::format(
                &folder,
                format!("Zarr: the image's array is {next:?}; expected a folder in it"),
            ));
        }
        folder.push(next);
    }
    let image = above(&folder)?;
    Ok((folder, image))
}

/// The image whose array a folder is, from the metadata of the groups above it.
fn above(folder: &Path) -> Result<Option<Image>> {
    let mut name = String::new();
    for up in folder.ancestors().skip(1).take(3).zip(folder.ancestors()) {
        let (group, inner) = up;
        let part = inner.file_name().unwrap_or_default().to_string_lossy();
        name = if name.is_empty() { part.into_owned() } else { format!("{part}/{name}") };
        let Ok(node) = node(group) else { continue };
        let version_above = node.attributes["ome"]["version"].as_str().map(str::to_owned);
        let image = node.attributes.get("ome").unwrap_or(&node.attributes);
        let scales = image["multiscales"].as_array().map_or(&[][..], Vec::as_slice);
        for scale in scales {
            let datasets = scale["datasets"].as_array().map_or(&[][..], Vec::as_slice);
            if let Some(at) = datasets.iter().position(|d| d["path"].as_str() == Some(&name)) {
                return Ok(Some(image_of(image, scale, datasets, at, version_above, scales.len())));
            }
        }
    }
    Ok(None)
}

fn image_of(image: &Value, scale: &Value, datasets: &[Value], at: usize, version: Option<String>, n: usize) -> Image {
    let text = |v: &Value| v.as_str().unwrap_or_default().chars().take(64).collect::<String>();
    let version = version.unwrap_or_else(|| text(&scale["version"]));
    let mut axes: Vec<Axis> = match scale["axes"].as_array() {
        Some(axes) => axes
            .iter()
            .map(|axis| match axis.as_str() {
                Some(name) => Axis { name: name.to_owned(), ..Axis::default() },
                None => {
                    Axis { name: text(&axis["name"]), kind: text(&axis["type"]), unit: text(&axis["unit"]), step: 0.0 }
                }
            })
            .collect(),
        // Before 0.3 there was but one order.
        None if matches!(version.as_str(), "0.1" | "0.2") => {
            ["t", "c", "z", "y", "x"].map(|name| Axis { name: name.to_owned(), ..Axis::default() }).to_vec()
        }
        None => Vec::new(),
    };
    // That of the resolution, and of all of them.
    let scales = [&datasets[at], scale].map(|of| {
        let all = of["coordinateTransformations"].as_array().map_or(&[][..], Vec::as_slice);
        all.iter().find_map(|t| (t["type"] == "scale").then(|| t["scale"].as_array()).flatten())
    });
    if scales.iter().any(Option::is_some) {
        for (i, axis) in axes.iter_mut().enumerate() {
            let of = |s: &Option<&Vec<Value>>| s.and_then(|s| s.get(i)?.as_f64());
            axis.step = scales.iter().filter_map(of).product();
        }
    }
    let mut left_out = Vec::new();
    if datasets.len() > 1 {
        left_out.push(match at {
            0 => format!("{} coarser resolutions", datasets.len() - 1),
            _ => format!("{} other resolutions", datasets.len() - 1),
        });
    }
    if n > 1 {
        left_out.push(format!("{} of {n} images of the group", n - 1));
    }
    let channel = image["omero"]["channels"][0]["label"].as_str().map(|l| l.chars().take(64).collect());
    Image { version, axes, channel, left_out }
}

/// Metadata of a folder.
fn node(folder: &Path) -> Result<Node> {
    let json = |name: &str| -> Result<Option<Value>> {
        let path = folder.join(name);
        let bytes = match std::fs::read(&path) {
            Ok(bytes) => bytes,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(e) => return Err(Error::io(path, "read", e)),
        };
        match serde_json::from_slice(&bytes) {
            Ok(value) => Ok(Some(value)),
            // Python writes numbers that JSON has no words for.
            Err(e) => match serde_json::from_str(&quoted(&String::from_utf8_lossy(&bytes))) {
                Ok(value) => Ok(Some(value)),
                Err(_) => Err(Error::format(path, format!("JSON: {e}"))),
            },
        }
    };
    if let Some(mut metadata) = json("zarr.json")? {
        let (is_group, attributes) = (metadata["node_type"] == "group", metadata["attributes"].take());
        return Ok(Node { is_group, version: 3, attributes, metadata });
    }
    if let Some(metadata) = json(".zarray")? {
        let attributes = json(".zattrs")?.unwrap_or_default();
        return Ok(Node { is_group: false, version: 2, attributes, metadata });
    }
    if json(".zgroup")?.is_some() {
        let attributes = json(".zattrs")?.unwrap_or_default();
        return Ok(Node { is_group: true, version: 2, attributes, metadata: Value::Null });
    }
    Err(Error::format(folder, "neither zarr.json nor .zarray nor .zgroup; expected a Zarr array or group"))
}

/// NaN, Infinity and -Infinity outside texts as texts.
fn quoted(json: &str) -> String {
    let mut out = String::with_capacity(json.len() + 16);
    let mut rest = json;
    let mut inside = false;
    while let Some(c) = rest.chars().next() {
        let word = ["NaN", "-Infinity", "Infinity"].into_iter().find(|w| !inside && rest.starts_with(w));
        if let Some(word) = word {
            out.push_str(&format!("\"{word}\""));
            rest = &rest[word.len()..];
            continue;
        }
        let taken = if inside && c == '\\' { rest.chars().take(2).map(char::len_utf8).sum() } else { c.len_utf8() };
        inside ^= c == '"';
        out.push_str(&rest[..taken]);
        rest = &rest[taken..];
    }
    out
}

/// The only array of three axes or more in a group that is no image.
fn only_volume(folder: &Path) -> Result<String> {
    let entries = std::fs::read_dir(folder).map_err(|e| Error::io(folder, "read", e))?;
    let mut names: Vec<String> = Vec::new();
    for entry in entries {
        let entry = entry.map_err(|e| Error::io(folder, "read", e))?;
        let of = node(&entry.path()).ok().filter(|n| !n.is_group);
        if of.is_some_and(|n| n.metadata["shape"].as_array().is_some_and(|s| s.len() >= 3)) {
            names.push(entry.file_name().to_string_lossy().into_owned());
        }
    }
    names.sort();
    match &names[..] {
        [one] => Ok(one.clone()),
        [] => Err(Error::format(folder, "a Zarr group that is no OME-Zarr image; name an array's folder")),
        many => {
            let some = many.iter().take(8).cloned().collect::<Vec<_>>().join(", ");
            let more = if many.len() > 8 { ", …" } else { "" };
            Err(Error::format(folder, format!("a Zarr group of several volumes; name one of them: {some}{more}")))
        }
    }
}

/// What an axis is, by its name.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Role {
    X,
    Y,
    Z,
    Channel,
    Time,
    Unknown,
}

fn role(axis: &Axis, all: &[Axis]) -> Role {
    let name = axis.name.to_lowercase();
    match (axis.kind.as_str(), name.as_str()) {
        (_, "x") => Role::X,
        (_, "y") => Role::Y,
        (_, "z") => Role::Z,
        ("channel", _) => Role::Channel,
        ("time", _) => Role::Time,
        (_, "lon" | "long" | "longitude" | "easting" | "col" | "cols" | "column" | "columns" | "width") => Role::X,
        (_, "lat" | "latitude" | "northing" | "row" | "rows") => Role::Y,
        // Of an image its side, above a map a place.
        (_, "height") if !all.iter().any(|a| a.name != axis.name && role(a, &[]) == Role::Y) => Role::Y,
        (
            _,
            "depth" | "slice" | "slices" | "plane" | "planes" | "lev" | "level" | "levels" | "layer" | "altitude"
            | "alt" | "height" | "elevation" | "pressure" | "plev" | "isobaric",
        ) => Role::Z,
        (_, "t" | "time" | "times" | "frame" | "frames" | "date") => Role::Time,
        (_, "c" | "channel" | "channels" | "ch" | "band" | "bands" | "wavelength" | "rgb" | "rgba" | "component") => {
            Role::Channel
        }
        _ => Role::Unknown,
    }
}

/// Which axes are x, y, and z: those named so, then of the ones that nothing is known of the last.
fn xyz(axes: &[Axis]) -> [Option<usize>; 3] {
    let roles: Vec<Role> = axes.iter().map(|axis| role(axis, axes)).collect();
    let mut found = [Role::X, Role::Y, Role::Z].map(|of| roles.iter().rposition(|r| *r == of));
    let mut unknown = (0..axes.len()).filter(|&i| roles[i] == Role::Unknown).rev();
    for place in &mut found {
        if place.is_none() {
            *place = unknown.next();
        }
    }
    found
}

/// What CF attributes say of values.
#[derive(Default)]
struct Meaning {
    scale: Option<(f64, f64)>,
    missing: Vec<f64>,
    unsigned: bool,
    unit: String,
}

fn meaning(node: &Node, left_out: &mut Vec<String>) -> Meaning {
    let of = |name: &str| {
        node.attributes.get(name).map(|v| if let Value::Array(a) = v { a.first().unwrap_or(v) } else { v })
    };
    let number = |v: &Value| match v {
        Value::Number(n) => n.as_f64(),
        Value::String(s) => s.parse().ok().or_else(|| base64_f64(s)),
        _ => None,
    };
    let mut out = Meaning::default();
    let (slope, inter) = (of("scale_factor").and_then(number), of("add_offset").and_then(number));
    let (slope, inter) = (slope.unwrap_or(1.0), inter.unwrap_or(0.0));
    if slope != 0.0 && slope.is_finite() && inter.is_finite() && (slope, inter) != (1.0, 0.0) {
        out.scale = Some((slope, inter));
    }
    for name in ["_FillValue", "missing_value"] {
        match of(name).map(|v| (v, number(v))) {
            Some((_, Some(v))) => out.missing.push(v),
            Some((v, None)) => left_out.push(format!("{name} {v}, which is no number")),
            None => {}
        }
    }
    // Where xarray wrote version 2 the array's own filling stands for none.
    if node.version == 2 && node.attributes.get("_ARRAY_DIMENSIONS").is_some() {
        out.missing.extend(number(&node.metadata["fill_value"]));
    }
    out.missing.retain(|v| !v.is_nan());
    out.missing.dedup();
    for name in ["valid_min", "valid_max", "valid_range"] {
        if let Some(v) = node.attributes.get(name) {
            left_out.push(format!("{name} {v}: values beyond it count as others do"));
        }
    }
    out.unsigned =
        of("_Unsigned").is_some_and(|v| matches!(v.as_str(), Some("true" | "True")) || v == &Value::Bool(true));
    out.unit = of("units").and_then(Value::as_str).unwrap_or_default().chars().take(64).collect();
    out
}

/// The eight bytes of a number as xarray writes it into version 3.
fn base64_f64(text: &str) -> Option<f64> {
    let digits = text.trim_end_matches('=').bytes().map(|b| {
        Some(u128::from(match b {
            b'A'..=b'Z' => b - b'A',
            b'a'..=b'z' => b - b'a' + 26,
            b'0'..=b'9' => b - b'0' + 52,
            b'+' => 62,
            b'/' => 63,
            _ => return None,
        }))
    });
    let digits: Vec<u128> = digits.collect::<Option<_>>()?;
    // Eleven digits are 66 bits, of which the last two fill up.
    (digits.len() == 11).then(|| {
        let bits = digits.iter().fold(0u128, |n, d| n << 6 | d) >> 2;
        f64::from_le_bytes((bits as u64).to_be_bytes())
    })
}

/// Distance of places along an axis, and its unit, from the array of coordinates that xarray keeps beside.
fn coordinates(folder: &Path, name: &str) -> Option<(f64, String)> {
    if name.is_empty() || name.contains(['/', '\\']) || name == ".." {
        return None;
    }
    let folder = folder.parent()?.join(name);
    let of = node(&folder).ok().filter(|n| !n.is_group)?;
    let array = Array::open(Arc::new(FilesystemStore::new(&folder).ok()?), "/").ok()?;
    let n = match array.shape() {
        &[n] if (2..=1 << 20).contains(&n) => n,
        _ => return None,
    };
    let subset = array.subset_all();
    let values: Vec<f64> = if *array.data_type() == data_type::float64() {
        array.retrieve_array_subset(&subset).ok()?
    } else if *array.data_type() == data_type::float32() {
        array.retrieve_array_subset::<Vec<f32>>(&subset).ok()?.into_iter().map(f64::from).collect()
    } else if *array.data_type() == data_type::int64() {
        array.retrieve_array_subset::<Vec<i64>>(&subset).ok()?.into_iter().map(|v| v as f64).collect()
    } else {
        return None;
    };
    let step = (values[n as usize - 1] - values[0]) / (n - 1) as f64;
    let even = values.windows(2).all(|w| ((w[1] - w[0]) - step).abs() <= 1e-3 * step.abs());
    let unit = of.attributes["units"].as_str().unwrap_or_default().to_owned();
    (even && step != 0.0 && step.is_finite()).then(|| (format!("{:.5e}", step.abs()).parse().unwrap_or(step), unit))
}

/// How values become those of a volume.
#[derive(Clone, Copy, PartialEq)]
enum Convert {
    As,
    Half,
    /// The upper half of an f32.
    Brain,
}

/// Who reads the chunks of an array when they are asked for.
struct Chunks {
    folder: PathBuf,
    array: Array<FilesystemStore>,
    /// The array's axis of z, y, x.
    axes: [Option<usize>; 3],
    /// Sides of what lies in one file.
    sides: Vec<u64>,
    convert: Convert,
    size: usize,
}

impl Chunks {
    /// Values along x, y, z, the first fastest, in the type of the volume.
    fn values(&self, [zs, ys, xs]: [&Range<u64>; 3]) -> Result<Vec<u8>> {
        let fail = |what: String| Error::format(&self.folder, format!("Zarr: {what}"));
        let mut ranges = vec![0..1; self.array.shape().len()];
        for (axis, of) in self.axes.into_iter().zip([zs, ys, xs]) {
            if let Some(axis) = axis {
                ranges[axis] = of.clone();
            }
        }
        let values: ArrayBytes<'static> = self
            .array
            .retrieve_array_subset(&ArraySubset::new_with_ranges(&ranges))
            .map_err(|e| fail(e.to_string()))?;
        let values = values.into_fixed().map_err(|e| fail(e.to_string()))?;
        // Bytes from a value to the next along each axis of the part.
        let one = if self.convert == Convert::As { self.size } else { 2 };
        let mut strides = vec![one; ranges.len()];
        for i in (0..ranges.len() - 1).rev() {
            strides[i] = strides[i + 1] * (ranges[i + 1].end - ranges[i + 1].start) as usize;
        }
        let [sz, sy, sx] = self.axes.map(|axis| axis.map_or(0, |axis| strides[axis]));
        let [nz, ny, nx] = [zs, ys, xs].map(|of| (of.end - of.start) as usize);
        let mut out = Vec::with_capacity(nx * ny * nz * self.size);
        for from in (0..nz).flat_map(|z| (0..ny).map(move |y| z * sz + y * sy)) {
            match self.convert {
                Convert::As if sx == one => out.extend_from_slice(&values[from..from + nx * one]),
                Convert::As => (0..nx).for_each(|i| out.extend_from_slice(&values[from + i * sx..][..one])),
                _ => (0..nx).for_each(|i| {
                    let bits = u16::from_ne_bytes([values[from + i * sx], values[from + i * sx + 1]]);
                    let brain = || f32::from_bits(u32::from(bits) << 16);
                    let v = if self.convert == Convert::Half { half(bits) } else { brain() };
                    out.extend_from_slice(&v.to_ne_bytes());
                }),
            }
        }
        Ok(out)
    }
}

impl Blocks for Chunks {
    fn read(&self, places: &[Range<u64>]) -> Result<Vec<u8>> {
        let [zs, ys, xs] = places else { unreachable!("a volume has three axes") };
        guarded(&self.folder, "Zarr", || self.values([zs, ys, xs]))
    }

    /// Whether any file of these chunks is there.
    fn holds(&self, places: &[Range<u64>]) -> bool {
        let mut at = vec![0u64; self.sides.len()];
        let mut ends = vec![1u64; self.sides.len()];
        for (axis, of) in self.axes.into_iter().zip(places) {
            if let Some(axis) = axis {
                (at[axis], ends[axis]) = (of.start / self.sides[axis], of.end.div_ceil(self.sides[axis]));
            }
        }
        let starts = at.clone();
        loop {
            if self.folder.join(self.array.chunk_key(&at).as_str()).exists() {
                return true;
            }
            let Some(axis) = (0..at.len()).rev().find(|&i| at[i] + 1 < ends[i]) else { return false };
            at[axis] += 1;
            at[axis + 1..].copy_from_slice(&starts[axis + 1..]);
        }
    }
}

fn array(folder: &Path, image: Option<Image>, opts: &ReadOptions) -> Result<Box<dyn Pieces>> {
    let fail = |what: String| Error::format(folder, format!("Zarr: {what}"));
    let own = node(folder)?;
    if own.is_group {
        return Err(fail("a group where an array was expected; name an array's folder".to_owned()));
    }
    let store = FilesystemStore::new(folder).map_err(|e| fail(e.to_string()))?;
    let named = own.metadata.get("data_type").or(own.metadata.get("dtype")).cloned().unwrap_or_default();
    let records = named.as_str().map_or(!named.is_null(), |s| s.contains('V'));
    let array = Array::open(Arc::new(store), "/").map_err(|e| {
        let text = e.to_string();
        let hint = match (records, text.contains("codec")) {
            (true, _) => "; records are not read: write one field as an array of its own",
            (_, true) => "; write it without this codec or filter",
            _ => "",
        };
        fail(text + hint)
    })?;
    let types = [
        (data_type::bool(), Dtype::U8),
        (data_type::uint8(), Dtype::U8),
        (data_type::int8(), Dtype::I8),
        (data_type::uint16(), Dtype::U16),
        (data_type::int16(), Dtype::I16),
        (data_type::uint32(), Dtype::U32),
        (data_type::int32(), Dtype::I32),
        (data_type::uint64(), Dtype::U64),
        (data_type::int64(), Dtype::I64),
        (data_type::float32(), Dtype::F32),
        (data_type::float64(), Dtype::F64),
        (data_type::float16(), Dtype::F32),
        (data_type::bfloat16(), Dtype::F32),
    ];
    let dtype = types.iter().find(|(of, _)| of == array.data_type()).map(|&(_, dtype)| dtype);
    let mut dtype = dtype.ok_or_else(|| {
        fail(format!("values are of type {named}; expected booleans, whole numbers of 8 to 64 bits, f16, f32 or f64"))
    })?;
    let convert = match array.data_type() {
        of if *of == data_type::float16() => Convert::Half,
        of if *of == data_type::bfloat16() => Convert::Brain,
        _ => Convert::As,
    };
    let stored_size = if convert == Convert::As { dtype.size() } else { 2 };
    let shape = array.shape().to_vec();
    if shape.len() < 3 {
        return Err(fail(format!("array of shape {shape:?}; a volume has three axes at least")));
    }
    let (axes, named_by) = names(&own, image.as_ref(), shape.len());
    let place = xyz(&axes);
    let [Some(ix), Some(iy), iz] = place else {
        let names: Vec<&str> = axes.iter().map(|a| a.name.as_str()).collect();
        return Err(fail(format!("axes {names:?}; expected x and y among them")));
    };
    let size = |i: Option<usize>| i.map_or(1, |i| shape[i]);
    let (nx, ny, nz) = (shape[ix], shape[iy], size(iz));
    // A few bytes of metadata can claim any size: held against what a world can be before anything is written.
    let world = match opts.up.unwrap_or_default() {
        Up::X => [nz, nx, ny],
        Up::Y => [nx, ny, nz],
        Up::Z => [nx, nz, ny],
    };
    world_dims(folder, world, "choose another axis with --up")?;
    let chunk = match array.subchunk_shape() {
        Some(inner) => inner,
        None => array.chunk_shape(&vec![0; shape.len()]).map_err(|e| fail(e.to_string()))?,
    };
    let chunk: Vec<u64> = chunk.iter().map(|n| n.get()).collect();
    let bytes = chunk.iter().try_fold(stored_size, |n, &c| n.checked_mul(c));
    if bytes.is_none_or(|n| n > CHUNK_LIMIT) {
        let what = format!(
            "{}: Zarr chunks of {chunk:?} values; at most {CHUNK_LIMIT} bytes are unpacked at once",
            folder.display()
        );
        return Err(Error::Limit(what));
    }
    let sides = array.chunk_shape(&vec![0; shape.len()]).map_err(|e| fail(e.to_string()))?;

    let format = match &image {
        Some(Image { version, .. }) => format!("OME-Zarr {version}").trim_end().to_owned(),
        None => format!("Zarr {}", own.version),
    };
    let mut about = About::new(Kind::Volume, format);
    let words: Vec<String> = axes
        .iter()
        .enumerate()
        .map(|(i, axis)| {
            let name = if axis.name.is_empty() { "?".to_owned() } else { axis.name.clone() };
            match place.iter().position(|p| *p == Some(i)) {
                Some(k) if name != ["x", "y", "z"][k] => format!("{name} as {}", ["x", "y", "z"][k]),
                _ => name,
            }
        })
        .collect();
    about.axes = match named_by {
        "" => "the last three axes are z, y, x".to_owned(),
        by => format!("axes ({}) by {by}", words.join(", ")),
    };
    let mut left_out = Vec::new();
    for (i, axis) in axes.iter().enumerate().filter(|(i, _)| !place.contains(&Some(*i)) && shape[*i] > 1) {
        let n = shape[i];
        let first = match (&image, role(axis, &axes)) {
            (Some(Image { channel: Some(label), .. }), Role::Channel) => format!("the first ({label})"),
            _ => "the first".to_owned(),
        };
        left_out.push(match role(axis, &axes) {
            Role::Channel => format!("{} of {n} channels: {first} is read", n - 1),
            Role::Time => format!("{} of {n} times: {first} is read", n - 1),
            _ if axis.name.is_empty() => format!("{} of {n} places of axis {i}: {first} is read", n - 1),
            _ => format!("{} of {n} places of {}: {first} is read", n - 1, axis.name),
        });
    }
    left_out.extend(image.as_ref().map(|i| i.left_out.clone()).unwrap_or_default());
    let steps = [Some(ix), Some(iy), iz].map(|i| {
        let axis = &axes[i?];
        match axis.step > 0.0 {
            true => Some((axis.step, axis.unit.clone())),
            false => coordinates(folder, &axis.name),
        }
    });
    if let [Some((x, unit)), Some((y, uy)), z] = &steps
        && let (z, uz) = z.as_ref().map_or((*x, unit), |(z, u)| (*z, u))
    {
        let of = (iz.is_none() || steps[2].is_some()).then(|| in_one_unit([(*x, unit), (*y, uy), (z, uz)])).flatten();
        if let Some((voxel, unit)) = of {
            (about.voxel, about.unit) = (Some(voxel), unit);
        } else if iz.is_some() && steps[2].is_some() {
            left_out.push(format!("voxels of {x} {unit} × {y} {uy} × {z} {uz} are drawn as cubes"));
        }
    }
    let Meaning { scale, missing, unsigned, unit } = meaning(&own, &mut left_out);
    if unsigned {
        dtype = match dtype {
            Dtype::I8 => Dtype::U8,
            Dtype::I16 => Dtype::U16,
            Dtype::I32 => Dtype::U32,
            Dtype::I64 => Dtype::U64,
            other => other,
        };
    }
    let mut rule = Vec::new();
    if let Some((slope, inter)) = scale {
        rule.push(format!("values are stored · {slope} + {inter}"));
    }
    if !unit.is_empty() && unit != "1" {
        rule.push(format!("in {unit}"));
    }
    if let Some(v) = missing.first() {
        rule.push(format!("stored {v} is air (fill value)"));
    }
    if let Some(v) = missing.get(1) {
        left_out.push(format!("that {v} stands for no value, too"));
    }
    about.rule = rule.join(", ");
    about.left_out = left_out;
    let missing = missing.first().copied();
    let chunks = Chunks {
        folder: folder.to_owned(),
        array,
        axes: [iz, Some(iy), Some(ix)],
        sides: sides.iter().map(|n| n.get()).collect(),
        convert,
        size: dtype.size() as usize,
    };
    let chunk = [iz.map_or(1, |i| chunk[i]), chunk[iy], chunk[ix]];
    let sizes = [[nz, ny, nx], chunk];
    let fill = fill_value(&own).filter(|_| !unsigned);
    blocks::volume(folder, sizes, (dtype, fill), Known { scale, missing, about }, Box::new(chunks), opts)
}

/// What is where nothing was written, as far as it is a number.
fn fill_value(own: &Node) -> Option<f64> {
    match &own.metadata["fill_value"] {
        Value::Null => Some(0.0),
        Value::Bool(of) => Some(f64::from(u8::from(*of))),
        Value::Number(of) => of.as_f64(),
        Value::String(of) => of.parse().ok(),
        _ => None,
    }
}

/// Names of an array's axes, empty where there are none, and who gave them.
fn names(own: &Node, image: Option<&Image>, rank: usize) -> (Vec<Axis>, &'static str) {
    if let Some(image) = image.filter(|i| i.axes.len() == rank) {
        return (image.axes.clone(), "the image");
    }
    let of = |list: &Value| -> Option<Vec<Axis>> {
        let list = list.as_array().filter(|l| l.len() == rank)?;
        let name = |v: &Value| v.as_str().unwrap_or_default().chars().take(64).collect();
        let axes: Vec<Axis> = list.iter().map(|v| Axis { name: name(v), ..Axis::default() }).collect();
        axes.iter().any(|a| !a.name.is_empty()).then_some(axes)
    };
    if let Some(axes) = of(&own.metadata["dimension_names"]) {
        return (axes, "dimension_names");
    }
    match of(&own.attributes["_ARRAY_DIMENSIONS"]) {
        Some(axes) => (axes, "_ARRAY_DIMENSIONS"),
        None => (vec![Axis::default(); rank], ""),
    }
}

pub(super) mod lazy;

#[cfg(test)]
mod tests;
