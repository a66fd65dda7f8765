//! Zarr arrays (versions 2 and 3) and OME-Zarr images (0.4, 0.5) as volumes: the last three axes are z, y, x, the first
//! place of any before them is read. Of an image's resolutions the finest, or the one whose folder is named. Chunks go to
//! a file without a name, one row of them after the other, so that the array need not fit into memory.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde_json::Value;
use zarrs::array::{Array, ArrayBytes, ArraySubset, data_type};
use zarrs::filesystem::FilesystemStore;

use super::volume::Volume;
use super::{Dtype, ReadOptions, Up, guarded, world_dims};
use crate::scratch::{self, write_at};
use crate::{Error, Result};

/// Bytes of one chunk: what is unpacked at once.
const CHUNK_LIMIT: u64 = 1 << 30;

/// Bytes of a row of chunks above which it is read chunk by chunk.
const ROW_LIMIT: u64 = 1 << 28;

pub(super) fn read(path: &Path, opts: &ReadOptions) -> Result<Volume<'static>> {
    let folder = find(path)?;
    guarded(path, "Zarr", || array(&folder, opts))
}

/// The folder of the array that `path` names: itself, or the finest resolution of the image there.
fn find(path: &Path) -> Result<PathBuf> {
    let mut folder = path.to_owned();
    // A collection, the image in it, its array.
    for _ in 0..3 {
        let Some(attributes) = group(&folder)? else { return Ok(folder) };
        let image = attributes.get("ome").unwrap_or(&attributes);
        let array = &image["multiscales"][0]["datasets"][0]["path"];
        let next = match array.as_str() {
            Some(name) => name,
            None if image.get("bioformats2raw.layout").is_some() => "0",
            None => {
                return Err(Error::format(&folder, "a Zarr group that is no OME-Zarr image; name an array's folder"));
            }
        };
        // A name from the file leads nowhere but down.
        if next.is_empty() || next.split('/').any(|part| part.is_empty() || part == "..") {
            return Err(Error::format(
                &folder,
                format!("Zarr: the image's array is {next:?}; expected a folder in it"),
            ));
        }
        folder.push(next);
    }
    Ok(folder)
}

/// Attributes of a group; `None` where the folder holds an array.
fn group(folder: &Path) -> Result<Option<Value>> {
    let json = |name: &str| -> Result<Option<Value>> {
        let path = folder.join(name);
        let bytes = match std::fs::read(&path) {
            Ok(bytes) => bytes,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(e) => return Err(Error::io(path, "read", e)),
        };
        serde_json::from_slice(&bytes).map(Some).map_err(|e| Error::format(path, format!("JSON: {e}")))
    };
    if let Some(mut node) = json("zarr.json")? {
        let is_group = node["node_type"] == "group";
        return Ok(is_group.then(|| node["attributes"].take()));
    }
    if json(".zarray")?.is_some() {
        return Ok(None);
    }
    if json(".zgroup")?.is_some() {
        return Ok(Some(json(".zattrs")?.unwrap_or_default()));
    }
    Err(Error::format(folder, "neither zarr.json nor .zarray nor .zgroup; expected a Zarr array or group"))
}

fn array(folder: &Path, opts: &ReadOptions) -> Result<Volume<'static>> {
    let fail = |what: String| Error::format(folder, format!("Zarr: {what}"));
    let store = FilesystemStore::new(folder).map_err(|e| fail(e.to_string()))?;
    let array = Array::open(Arc::new(store), "/").map_err(|e| fail(e.to_string()))?;
    let types = [
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
    ];
    let dtype = types.iter().find(|(of, _)| of == array.data_type()).map(|&(_, dtype)| dtype);
    let dtype = dtype.ok_or_else(|| fail("values are neither whole numbers of 8 to 64 bits nor f32 or f64".into()))?;
    let shape = array.shape();
    let Some((before, &[nz, ny, nx])) = shape.split_last_chunk::<3>() else {
        return Err(fail(format!("array of shape {shape:?}; a volume has three axes at least")));
    };
    // A few bytes of metadata can claim any size: held against what a world can be before anything is written.
    let world = match opts.up.unwrap_or_default() {
        Up::X => [nz, nx, ny],
        Up::Y => [nx, ny, nz],
        Up::Z => [nx, nz, ny],
    };
    world_dims(folder, world, "choose another axis with --up")?;
    let chunk = array.chunk_shape(&vec![0; shape.len()]).map_err(|e| fail(e.to_string()))?;
    let chunk: Vec<u64> = chunk.iter().map(|n| n.get()).collect();
    let bytes = chunk.iter().try_fold(dtype.size(), |n, &c| n.checked_mul(c));
    if bytes.is_none_or(|n| n > CHUNK_LIMIT) {
        let what = format!(
            "{}: Zarr chunks of {chunk:?} values; at most {CHUNK_LIMIT} bytes are unpacked at once",
            folder.display()
        );
        return Err(Error::Limit(what));
    }
    let [cz, cy, cx] = *chunk.last_chunk().expect("as many axes as the array");
    let cx = if cz * cy * nx * dtype.size() <= ROW_LIMIT { nx } else { cx };

    let scratch = |action| move |e| Error::io(std::env::temp_dir(), action, e);
    let file = scratch::file().map_err(scratch("create a file in"))?;
    let starts = |n: u64, step: u64| (0..n).step_by(step as usize).map(move |from| from..(from + step).min(n));
    for (zs, ys) in starts(nz, cz).flat_map(|zs| starts(ny, cy).map(move |ys| (zs.clone(), ys))) {
        for xs in starts(nx, cx) {
            let mut ranges = vec![0..1; before.len()];
            ranges.extend([zs.clone(), ys.clone(), xs.clone()]);
            let values: ArrayBytes<'static> =
                array.retrieve_array_subset(&ArraySubset::new_with_ranges(&ranges)).map_err(|e| fail(e.to_string()))?;
            let values = values.into_fixed().map_err(|e| fail(e.to_string()))?;
            let row = ((xs.end - xs.start) * dtype.size()) as usize;
            let places = zs.clone().flat_map(|z| ys.clone().map(move |y| (z, y)));
            for ((z, y), row) in places.zip(values.chunks_exact(row)) {
                let at = ((z * ny + y) * nx + xs.start) * dtype.size();
                write_at(&file, row, at).map_err(scratch("write a file in"))?;
            }
        }
    }
    let mut volume = Volume::unpacked(folder, file, [nx, ny, nz], dtype, opts)?;
    if before.iter().any(|&n| n > 1) {
        volume.notes.push(format!("of the axes before z, y, x (sizes {before:?}) the first place is read"));
    }
    Ok(volume)
}
