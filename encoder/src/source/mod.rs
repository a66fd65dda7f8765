//! Importers: every kind of file, and every procedural scene, that can become an [`Input`].
//!
//! | module | reads | world |
//! |---|---|---|
//! | `volume`, `npy` | raw, NPY | as stored, or z-up by `--up z` |
//! | `nifti`, `nrrd`, `meta_image` | NIfTI, ANALYZE, NRRD, MetaImage | y to the head where the file says where that is; else as stored |
//! | `mrc`, `vti` | MRC and CCP4 maps, VTK image data | by the axes that the file names |
//! | `place`, `measure`, `values` | nothing: spacing and axes, what is solid and its colours, values in other forms | |
//! | `heightmap`, `geotiff`, `grids`, `dem` | PNG, JPEG, TIFF, GeoTIFF, ESRI ASCII grids, SRTM, RAW16, USGS DEM | image column is x, row is z |
//! | `mosaic` | folders of tiles of a map | x is east, z is south |
//! | `stack` | pages of a TIFF; folders of TIFF, PNG or JPEG slices | as stored, or z-up by `--up z` |
//! | `dicom` | DICOM series, multi-frame files (feature `dicom`) | as stored, or z-up by `--up z` |
//! | `zarr` | Zarr, OME-Zarr (feature `zarr`) | as stored, or z-up by `--up z` |
//! | `blocks` | arrays that others read block by block | as NPY |
//! | `vxl` | Voxlap and Ace of Spades maps | (x, D−1−z, y) |
//! | `vox` | MagicaVoxel models and scenes | z-up |
//! | `kv6` | kv6, kvx, Slab6's `.vox` | (x, D−1−z, y) |
//! | `qb`, `gox` | Qubicle and Goxel models | y-up; z-up |
//! | `binvox` | volumes of binvox | as stored, or z-up by `--up z` |
//! | `mesh`: `ply`, `obj`, `stl`, `gltf`, `texture` | PLY, OBJ, STL, glTF, with textures | as stored, or z-up by `--up z` |
//! | `points`, `lidar`, `pcd` | LAS, LAZ, COPC, PCD, PLY without faces | z-up; PLY as stored, or z-up by `--up z` |
//! | `procedural` | nothing: seeded functions | y-up |
//! | `tiles` | what gives tiles when they are asked for: scene files, worlds without end | y-up |
//!
//! OpenVDB is not read. No crate is kept that could: of `vdb-rs` 0.6.0 (MIT) the last release is of January 2024, it knows
//! no background values, so that the inside of a level set is lost, takes memory for what a file claims, and panics on 52 of
//! 2,082 copies of a file with one byte damaged; `openvdb` 0.1.0 is a name without content.
//!
//! Every reader takes the whole file as bytes (memory-mapped), checks each size it claims against them before it
//! asks for memory, and answers bad bytes with an [`Error`], never a panic.
//!
//! # Memory
//!
//! Whatever the size of the input, these keep to a budget: volumes and stacks (read in stretches, or unpacked into a file
//! without a name), height maps and colour maps (in such files; read by strips, tiles or rows), clouds of points from LAS
//! and LAZ (in such files), seeded functions. These are held whole, and bounded by what they are:
//!
//! | input | held | at most |
//! |---|---|---|
//! | PNG or JPEG that cannot be read by rows | its pixels, while it is unpacked | 3 to 8 bytes a pixel |
//! | TIFF | a strip or tile of a height map, a row of strips or tiles of a stack | 8 bytes a pixel of it |
//! | PNG or JPEG slices | one of them, unpacked | 3 to 8 bytes a pixel |
//! | DICOM | one file, and a frame of it unpacked | the file's size, and 4 bytes a pixel |
//! | meshes | corners, triangles, textures | 36 to 60 bytes a corner, 16 a triangle, 4 a pixel; with `--fill` 100 a triangle more |
//! | PLY clouds | points | 16 bytes a point |
//! | `.vxl` | runs and colours | the file's size, thrice |
//! | `.vox` | voxels of all instances of models | 2³¹ voxels, 2²⁶ columns; 36 bytes a voxel, 8 a column |
//! | `.kv6`, `.kvx`, `.qb`, `.gox` | voxels | 2²⁶ voxels, 2²⁶ columns; 52 bytes a voxel, 8 a column |
//! | `.binvox` | a bit a voxel, and runs | 127 voxels a byte of the file |
//! | PCD packed by LZF | the points, unpacked | 88 times the file |

mod binvox;
mod blocks;
mod cells;
mod dem;
#[cfg(feature = "dicom")]
mod dicom;
mod fill;
mod geo;
mod geotiff;
#[cfg(feature = "mesh")]
mod gltf;
mod gox;
mod grids;
mod heightmap;
mod heights;
mod kv6;
#[cfg(feature = "las")]
mod lidar;
mod measure;
mod mesh;
mod meta_image;
mod mosaic;
mod mrc;
mod nifti;
mod npy;
mod nrrd;
#[cfg(feature = "mesh")]
mod obj;
mod pcd;
mod pixels;
mod place;
mod ply;
mod points;
pub mod procedural;
mod qb;
mod relief;
mod spots;
mod stack;
#[cfg(feature = "mesh")]
mod stl;
#[cfg(feature = "mesh")]
mod text;
#[cfg_attr(not(feature = "mesh"), allow(dead_code, reason = "PLY pictures always repeat"))]
mod texture;
mod tiff;
pub mod tiles;
mod values;
mod volume;
mod vox;
mod vti;
mod vxl;
#[cfg(feature = "zarr")]
mod zarr;

use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};

use crate::model::matter;
use crate::model::pieces::{self, Pieces};
use crate::store::guard::Map;
#[cfg(not(target_arch = "wasm32"))]
use crate::store::remote;
use crate::{About, Error, Input, Result};

pub use blocks::{BlockArray, Blocks, blocks};
pub use npy::{ArrayView, array};
pub use relief::{Exaggeration, Ramp, RampTable};

/// Highest column that a scene can hold, in voxels.
pub const MAX_HEIGHT: u64 = 65_536;

/// Most columns that an importer builds: column tables of 8 GiB.
pub const MAX_COLUMNS: u64 = 1 << 31;

pub use points::{Classes, ColorBy, PointSize};

/// How to read an input: the flags of `encode`.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct ReadOptions {
    /// Kind of input [default: found from the content, then the name; --dims means raw]
    #[arg(long, value_enum, value_name = "KIND")]
    pub format: Option<Format>,
    /// Axis of a volume that points up [default: y]
    #[arg(long, value_enum, value_name = "AXIS")]
    pub up: Option<Up>,
    /// Size of a raw volume in voxels, x fastest in the file; X,Y of a .r16 terrain
    // Held as X, Y, 0.
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_dims)]
    pub dims: Option<[u64; 3]>,
    /// Value type of a raw volume, little-endian [default: u8]
    #[arg(long, value_enum, value_name = "TYPE")]
    pub dtype: Option<Dtype>,
    /// Voxels of at least this value are solid [default: raw and NPY: above 0 for u8, needed for other types; others: found from the values, and said]
    #[arg(long, value_name = "V", allow_negative_numbers = true, value_parser = number)]
    pub iso: Option<f64>,
    /// Spacing of a volume's voxels: auto (as the file states it), as-is (voxels are cubes), or SX,SY,SZ [default: auto]
    #[arg(long, value_name = "auto|as-is|SX,SY,SZ", value_parser = parse_spacing)]
    pub spacing: Option<Spacing>,
    /// Colour map of a height map (PNG, JPEG or TIFF): laid on by coordinates where both have them, else the nearest pixel is taken
    #[arg(long, value_name = "IMAGE")]
    pub colors: Option<PathBuf>,
    /// Voxels along the longest side of a mesh or a cloud of points [default: 512; of LAS see --voxel], columns along that of a height
    /// map [default: its pixels]; up to 16384
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=16384))]
    pub size: Option<u32>,
    /// Side of a voxel in units of a mesh or a cloud of points [default of LAS: the mean distance of points]
    #[arg(long, value_name = "UNITS", value_parser = positive, conflicts_with = "size")]
    pub voxel: Option<f64>,
    /// Fill closed meshes: solid where the middle of a voxel is inside, too
    #[arg(long)]
    pub fill: bool,
    /// Voxels a unit of a height map's value [default: 1 for 8 bits; from the pixel size where that is known]
    #[arg(long, value_name = "S", allow_negative_numbers = true, value_parser = number)]
    pub height_scale: Option<f64>,
    /// Classes of LAS points that are wanted, as in 2,6 or 2-6,9 [default: all but noise, 7 and 18]
    #[arg(long, value_name = "LIST")]
    pub las_classes: Option<Classes>,
    /// Voxels that a point fills along each axis, or "auto": as few as close the ground [default: 1 with --voxel or --size, else auto]
    #[arg(long, value_name = "N")]
    pub point_size: Option<PointSize>,
    /// What colours a cloud of points
    #[arg(long, value_enum, value_name = "WHAT", default_value = "auto")]
    pub color_by: ColorBy,
    /// Heights of a PNG or TIFF that its colours code, as web maps have them
    #[arg(long, value_enum, value_name = "CODE")]
    pub rgb: Option<HeightCode>,
    /// Colours of a height map that has none, or of a scene, by height; of a volume, by value: terrain, grey, viridis, cividis, magma, inferno, plasma, turbo, none, or a
    /// file as gdaldem color-relief reads it
    #[arg(long, value_name = "NAME|FILE")]
    pub ramp: Option<String>,
    /// How much higher a height map's relief is drawn than it is wide; auto: as much as shows it [default: 1]
    #[arg(long, value_name = "N|auto")]
    pub exaggeration: Option<Exaggeration>,
    /// A person is to look at it: where no flag says otherwise, a height map takes colours, and relief that shows.
    #[arg(skip)]
    pub show: bool,
    /// Keep fractions of a height map's heights too, a byte per column: for the surface that --smooth draws
    #[arg(long)]
    pub fractions: bool,
    /// Value of a height map that stands for no data [default: what the file says]
    #[arg(long, value_name = "V", allow_negative_numbers = true, value_parser = any_number)]
    pub nodata: Option<f64>,
    /// Keep a volume's values as N steps of translucent matter, whose colours and opacities `render --transfer` sets; solid is then
    /// only what --iso says
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    pub classes: Option<u16>,
    /// Values that the steps of --classes divide; what is no more than LO is clear [default: least and greatest of a sample]
    #[arg(long, value_name = "LO,HI", allow_negative_numbers = true, value_parser = parse_window, requires = "classes")]
    pub window: Option<[f64; 2]>,
    /// Water over what is lower, in the unit of a height map's values; of a procedural landscape in voxels
    #[arg(long, value_name = "HEIGHT", allow_negative_numbers = true, value_parser = number)]
    pub water: Option<f64>,
}

impl ReadOptions {
    /// Whether any flag was typed.
    pub fn is_given(&self) -> bool {
        let typed = ReadOptions { show: false, ..self.clone() };
        format!("{typed:?}") != format!("{:?}", ReadOptions::default())
    }
}

/// How colours code heights.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum HeightCode {
    /// Mapbox's Terrain-RGB: tenths of metres from -10000 on
    Mapbox,
    /// Terrarium (Mapzen, AWS): 256ths of metres from -32768 on
    Terrarium,
}

/// Kinds of input.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Format {
    /// Values without a header, x fastest (--dims, --dtype)
    Raw,
    /// NumPy array of three axes
    Npy,
    /// NRRD, attached or detached header
    Nrrd,
    /// NIfTI-1, NIfTI-2 or ANALYZE 7.5, one file or a pair, plain or gzip
    Nifti,
    /// MetaImage, values in the same file or in others
    #[value(name = "metaimage")]
    MetaImage,
    /// MRC or CCP4 map of density, plain or gzip
    Mrc,
    /// VTK image data in XML
    Vti,
    /// PNG, JPEG, TIFF or GeoTIFF image of heights
    Heightmap,
    /// USGS ASCII digital elevation model
    Dem,
    /// ESRI ASCII grid of heights
    Asc,
    /// SRTM tile of heights, plain or gzip
    Hgt,
    /// 16-bit heights without a header, square or --dims X,Y
    R16,
    /// Images as slices of a volume: the pages of a TIFF file, or the TIFF, PNG or JPEG files of a folder
    Stack,
    /// DICOM file of several frames, or a folder of a series
    Dicom,
    /// Voxlap or Ace of Spades map
    Vxl,
    /// MagicaVoxel model or scene
    Vox,
    /// Voxlap or Slab6 model
    Kv6,
    /// Build or Slab6 model
    Kvx,
    /// Slab6 model that shares the name .vox
    Slab6,
    /// Qubicle model
    Qb,
    /// Goxel model
    Gox,
    /// Volume of binvox
    Binvox,
    /// PLY mesh or cloud of points, plain or gzip
    Ply,
    /// STL mesh
    Stl,
    /// Wavefront OBJ mesh
    Obj,
    /// glTF or GLB scene of meshes
    Gltf,
    /// LAS, LAZ or COPC cloud of points
    Las,
    /// PCD cloud of points
    Pcd,
}

const SUPPORTED: &str = "raw volumes (--dims X,Y,Z --dtype T), .npy, .nrrd/.nhdr, .nii/.nii.gz/.hdr/.img, .mha/.mhd, .mrc/.map/.ccp4, .vti, \
    height maps (.png, .jpg, .tif, .dem, .asc, .hgt, .r16, .npy), stacks (.tif of several pages, folders of .tif, .png or .jpg), mosaics \
    (folders of .tif, .asc or .hgt), DICOM (.dcm, folders), Zarr (folders), meshes (.ply, .stl, .obj, .gltf, .glb), points (.las, .laz, \
    .pcd, .ply), .vxl (Voxlap, Ace of Spades), .vox (MagicaVoxel, Slab6), .kv6, .kvx, .qb (Qubicle), .gox (Goxel), .binvox, procedural:KIND";

/// Axis of an input that points up in the world.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Up {
    /// Input (x, y, z) is world (z, x, y)
    X,
    /// Input (x, y, z) is world (x, y, z)
    #[default]
    Y,
    /// Input (x, y, z) is world (x, z, Y−1−y)
    Z,
}

/// How far voxels of a volume are apart.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Spacing {
    /// As the file states it; where it states nothing, or is a raw volume, voxels are cubes
    #[default]
    Auto,
    /// Voxels are cubes
    AsIs,
    /// Along x, y, z of the input
    Of([f64; 3]),
}

/// Type of a volume's values.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Dtype {
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F32,
    F64,
}

impl Dtype {
    /// Bytes a value.
    pub fn size(self) -> u64 {
        match self {
            Dtype::U8 | Dtype::I8 => 1,
            Dtype::U16 | Dtype::I16 => 2,
            Dtype::U32 | Dtype::I32 | Dtype::F32 => 4,
            Dtype::U64 | Dtype::I64 | Dtype::F64 => 8,
        }
    }
}

fn number(s: &str) -> Result<f64, String> {
    s.trim().parse().ok().filter(|v: &f64| !v.is_nan()).ok_or_else(|| "expected a number".to_owned())
}

fn positive(s: &str) -> Result<f64, String> {
    number(s).ok().filter(|&v| v > 0.0 && v.is_finite()).ok_or_else(|| "expected a number above 0".to_owned())
}

/// A number, or "nan".
fn any_number(s: &str) -> Result<f64, String> {
    s.trim().parse().map_err(|_| "expected a number".to_owned())
}

fn parse_spacing(s: &str) -> Result<Spacing, String> {
    match s.trim() {
        "auto" => return Ok(Spacing::Auto),
        "as-is" => return Ok(Spacing::AsIs),
        _ => {}
    }
    let sides: Result<Vec<f64>, _> = s.split(',').map(positive).collect();
    let sides: Option<[f64; 3]> = sides.ok().and_then(|sides| sides.try_into().ok());
    let least = |s: &[f64; 3]| s.iter().copied().fold(f64::INFINITY, f64::min);
    let fits = |s: &[f64; 3]| s.iter().all(|&v| v <= 1000.0 * least(s));
    let expected = "expected auto, as-is, or three numbers above 0, none 1000 times another, as in 0.5,0.5,2";
    sides.filter(fits).map(Spacing::Of).ok_or_else(|| expected.to_owned())
}

fn parse_window(s: &str) -> Result<[f64; 2], String> {
    let parts: Option<Vec<f64>> = s.split(',').map(|p| p.trim().parse().ok().filter(|v: &f64| v.is_finite())).collect();
    let ends: Option<[f64; 2]> = parts.and_then(|p| p.try_into().ok());
    ends.filter(|[low, high]| low < high).ok_or_else(|| "expected two numbers that ascend, as in -200,1500".to_owned())
}

fn parse_dims(s: &str) -> Result<[u64; 3], String> {
    let wrong = || "expected three whole numbers, as in 256,128,64 (two for .r16)".to_owned();
    let mut parts: Vec<u64> = s.split(',').map(|p| p.trim().parse()).collect::<Result<_, _>>().map_err(|_| wrong())?;
    if parts.contains(&0) {
        return Err("every size must be at least 1".to_owned());
    }
    // Two sides, of a map: no depth.
    if parts.len() == 2 {
        parts.push(0);
    }
    parts.try_into().map_err(|_| wrong())
}

/// Reads the file at `path`, or makes the scene that a name like `procedural:terrain?size=512&seed=7` describes.
pub fn open(path: &Path, opts: &ReadOptions) -> Result<Input> {
    pieces::whole(&*open_pieces(path, opts)?)
}

/// The same, read piece by piece; volumes are never in memory as a whole.
pub fn open_pieces(path: &Path, opts: &ReadOptions) -> Result<Box<dyn Pieces>> {
    if let Some(name) = path.to_str().and_then(|p| p.strip_prefix("procedural:")) {
        return procedural::from_name(name).map(|world| flooded(world, opts));
    }
    #[cfg(not(target_arch = "wasm32"))]
    {
        let colors = remote::Here::bring(opts.colors.as_slice())?;
        let opts = ReadOptions { colors: colors.files.into_iter().next(), ..opts.clone() };
        if remote::is_url(path) { remote::open_pieces(path, &opts) } else { open_local(path, &opts) }
    }
    #[cfg(target_arch = "wasm32")]
    open_local(path, opts)
}

/// A world made of a function, with the water that was asked for.
fn flooded(world: Box<dyn Pieces>, opts: &ReadOptions) -> Box<dyn Pieces> {
    let mut about = world.about();
    if opts.classes.is_some() {
        about.left_out.push("--classes: it is for volumes".to_owned());
    }
    let Some(level) = opts.water.map(|height| height.clamp(0.0, MAX_HEIGHT as f64) as u32).filter(|&level| level > 0)
    else {
        return world;
    };
    about.kind = Some(crate::model::about::Kind::Procedural);
    about.classes = Some(matter::Classes::water());
    Box::new(pieces::Flooded { world, about, level })
}

fn open_local(path: &Path, opts: &ReadOptions) -> Result<Box<dyn Pieces>> {
    if path.is_dir() {
        return folder(path, opts);
    }
    let bytes = map(path)?;
    match find(path, &bytes, true, opts)? {
        World::Volume(volume) => Ok(Box::new(volume.in_file(path, &bytes)?)),
        World::Pieces(pieces) => Ok(pieces),
    }
}

/// A volume of which `head` has the right length and, as far as its header goes, the right bytes; its values are read from
/// `object`. None where it is none.
#[cfg(feature = "object-store")]
pub(crate) fn remote_volume(
    url: &Path,
    head: &[u8],
    format: Format,
    object: remote::Object,
    opts: &ReadOptions,
) -> Result<Option<Box<dyn Pieces>>> {
    let volume = volume::in_object(url, head, format, object, opts)?;
    Ok(volume.map(|volume| Box::new(volume) as Box<dyn Pieces>))
}

/// A Zarr array; a folder of TIFF files: tiles of a map where they say where they lie, else the slices of a volume, by
/// name; a DICOM series; or PNG or JPEG slices, by name.
fn folder(path: &Path, opts: &ReadOptions) -> Result<Box<dyn Pieces>> {
    if ["zarr.json", ".zarray", ".zgroup"].iter().any(|name| path.join(name).is_file()) {
        return zarr_folder(path, opts);
    }
    let failed = |e| Error::io(path, "read", e);
    let (mut tiffs, mut grids, mut pictures, mut dicoms) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let mut n_packed = 0;
    for entry in fs::read_dir(path).map_err(failed)? {
        let file = entry.map_err(failed)?.path();
        let hidden = file.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'));
        if hidden || !file.is_file() {
            continue;
        }
        let kind = file.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
        match kind.as_str() {
            "tif" | "tiff" => tiffs.push(file),
            "asc" | "hgt" => grids.push(file),
            "gz" => n_packed += usize::from(is_packed_tile(&file)),
            "png" | "jpg" | "jpeg" => pictures.push(file),
            _ if is_dicom(&file) => dicoms.push(file),
            _ => {}
        }
    }
    [&mut tiffs, &mut grids, &mut pictures, &mut dicoms].into_iter().for_each(|files| by_number(files));
    let unread = |kinds: &[(&str, usize)]| -> Vec<String> {
        kinds.iter().filter(|k| k.1 > 0).map(|(kind, n)| format!("{n} {kind} files in the folder")).collect()
    };
    let (n_pictures, n_dicoms) = (pictures.len(), dicoms.len());
    let tiles = if tiffs.is_empty() { &grids } else { &tiffs };
    if let Some(first) = tiles.first()
        && opts.format != Some(Format::Stack)
        && mosaic::is_tile(first)?
    {
        let mut rows = mosaic::mosaic(path, tiles, opts)?;
        let n_grids = if tiffs.is_empty() { 0 } else { grids.len() };
        rows.about.left_out.extend(unread(&[("packed (.gz)", n_packed), ("grid (.asc, .hgt)", n_grids)]));
        rows.about.left_out.extend(unread(&[("PNG or JPEG", n_pictures), ("DICOM", n_dicoms)]));
        return Ok(Box::new(rows));
    }
    let mut volume = if !tiffs.is_empty() {
        let mut volume = stack::folder(path, &tiffs, opts)?;
        let n_grids = grids.len();
        volume.about.left_out.extend(unread(&[("packed (.gz)", n_packed), ("grid (.asc, .hgt)", n_grids)]));
        volume.about.left_out.extend(unread(&[("PNG or JPEG", n_pictures), ("DICOM", n_dicoms)]));
        volume
    } else if !dicoms.is_empty() && opts.format != Some(Format::Stack) {
        dicom_series(path, &dicoms, opts)?
    } else if !pictures.is_empty() {
        stack::pictures(path, &pictures, opts)?
    } else {
        if n_packed > 0 {
            return Err(Error::format(
                path,
                format!("a folder of {n_packed} tiles packed by gzip; unpack them first (gunzip)"),
            ));
        }
        let what = "a folder without .tif, .asc, .hgt, .png, .jpg or DICOM files and no Zarr; expected the slices of a volume or \
            tiles of a map";
        return Err(Error::format(path, what));
    };
    if dicoms.len() == n_dicoms && tiffs.is_empty() && !dicoms.is_empty() {
        volume.about.left_out.extend(unread(&[("PNG or JPEG", n_pictures)]));
    }
    Ok(Box::new(volume))
}

/// Whether a file's name is that of a tile which gzip packed.
fn is_packed_tile(file: &Path) -> bool {
    let inner = file.file_stem().map(|name| name.to_string_lossy().to_lowercase()).unwrap_or_default();
    [".hgt", ".asc", ".tif"].iter().any(|ending| inner.ends_with(ending))
}

/// Sorts by name, numbers in names by their value: slice2 before slice10.
fn by_number(files: &mut [PathBuf]) {
    files.sort_by_cached_key(|file| {
        let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let parts = name.as_bytes().chunk_by(|a, b| a.is_ascii_digit() == b.is_ascii_digit());
        let number = |part: &[u8]| std::str::from_utf8(part).ok()?.parse::<u64>().ok();
        let key: Vec<(u64, Vec<u8>)> = parts.map(|part| (number(part).unwrap_or(u64::MAX), part.to_vec())).collect();
        key
    });
}

/// Whether a file says that it is DICOM, and no directory of others.
fn is_dicom(path: &Path) -> bool {
    let mut head = [0; 132];
    let named = path.file_name().is_some_and(|name| name == "DICOMDIR");
    let read = File::open(path).and_then(|mut file| file.read_exact(&mut head));
    !named && read.is_ok() && head.ends_with(b"DICM")
}

#[cfg(feature = "dicom")]
fn dicom_series(path: &Path, files: &[PathBuf], opts: &ReadOptions) -> Result<volume::Volume<'static>> {
    dicom::read(path, files, opts)
}

#[cfg(not(feature = "dicom"))]
fn dicom_series(path: &Path, _: &[PathBuf], _: &ReadOptions) -> Result<volume::Volume<'static>> {
    without(path, "DICOM", "dicom")
}

#[cfg(feature = "zarr")]
fn zarr_folder(path: &Path, opts: &ReadOptions) -> Result<Box<dyn Pieces>> {
    zarr::read(path, opts)
}

#[cfg(not(feature = "zarr"))]
fn zarr_folder(path: &Path, _: &ReadOptions) -> Result<Box<dyn Pieces>> {
    without(path, "Zarr", "zarr")
}

/// What a reader finds.
#[expect(clippy::large_enum_variant, reason = "there is one for each input")]
enum World<'a> {
    /// Values that stay where they are.
    Volume(volume::Volume<'a>),
    Pieces(Box<dyn Pieces>),
}

/// Reads an input whose file at `path` holds `bytes`, with its translucent matter, and what is known of it.
pub fn read_all(path: &Path, bytes: &[u8], opts: &ReadOptions) -> Result<(Input, Option<matter::Matter>, About)> {
    let all = |world: &dyn Pieces| {
        let [nx, _, nz] = world.dims();
        Ok((pieces::whole(world)?, world.matter(0..nx, 0..nz)?, world.about()))
    };
    match find(path, bytes, false, opts)? {
        World::Volume(volume) => all(&volume),
        World::Pieces(pieces) => all(&*pieces),
    }
}

/// Reads an input whose file at `path` holds `bytes`: what is solid of it.
pub fn read(path: &Path, bytes: &[u8], opts: &ReadOptions) -> Result<Input> {
    match find(path, bytes, false, opts)? {
        World::Volume(volume) => pieces::whole(&volume),
        World::Pieces(pieces) => pieces::whole(&*pieces),
    }
}

/// What the file at `path`, which holds `bytes`, is a picture of. `in_file` says that there is such a file: large inputs are
/// read from it, not from `bytes`, a mapping that would grow with what is looked at.
fn find<'a>(path: &Path, bytes: &'a [u8], in_file: bool, opts: &ReadOptions) -> Result<World<'a>> {
    let format = match opts.format {
        Some(format) => format,
        None if opts.dims.is_some() && !is_r16(path) => Format::Raw,
        None if kv6::is_slab6(bytes, bytes.len() as u64)
            && path.extension().is_some_and(|e| e.eq_ignore_ascii_case("vox")) =>
        {
            Format::Slab6
        }
        None => match detect(path, &bytes[..bytes.len().min(1 << 16)])? {
            // Pages without a place on Earth are slices, unless a flag says that they are heights.
            Format::Heightmap
                if matches!(bytes.get(..2), Some(b"II" | b"MM"))
                    && opts.colors.is_none()
                    && opts.height_scale.is_none()
                    && opts.rgb.is_none()
                    && stack::is_stack(path, bytes) =>
            {
                Format::Stack
            }
            format => format,
        },
    };
    let mut notes = Vec::new();
    let mut unused = |flag: &str, given: bool, why: &str| {
        if given {
            notes.push(format!("{flag} is not used: {why}"));
        }
    };
    let is_volume = matches!(format, Format::Raw | Format::Npy | Format::Nrrd | Format::Nifti | Format::Stack)
        || matches!(format, Format::MetaImage | Format::Mrc | Format::Vti | Format::Dicom);
    let is_image = format == Format::Heightmap;
    let is_map = is_image || matches!(format, Format::Dem | Format::Npy | Format::Asc | Format::Hgt | Format::R16);
    let is_headless = matches!(format, Format::Raw | Format::R16);
    let is_cloud = matches!(format, Format::Ply | Format::Las | Format::Pcd);
    let is_mesh = is_cloud || matches!(format, Format::Stl | Format::Obj | Format::Gltf);
    unused("--las-classes", opts.las_classes.is_some() && format != Format::Las, "it is for LAS");
    unused("--point-size", opts.point_size.is_some() && !is_cloud, "it is for clouds of points");
    unused("--color-by", opts.color_by != ColorBy::Auto && !is_cloud, "it is for clouds of points");
    unused(
        "--up",
        opts.up.is_some() && !is_volume && !is_mesh && format != Format::Binvox,
        "the format has an up axis of its own",
    );
    unused("--size", opts.size.is_some() && !is_mesh && !is_map, "it is for meshes, clouds of points and height maps");
    unused("--voxel", opts.voxel.is_some() && !is_mesh, "it is for meshes and clouds of points");
    unused("--fill", opts.fill && (!is_mesh || format == Format::Las), "it is for meshes");
    unused("--iso", opts.iso.is_some() && !is_volume, "the input has no values to compare it with");
    unused("--spacing", opts.spacing.is_some() && !is_volume, "it is for volumes");
    unused("--dtype", opts.dtype.is_some() && !is_headless, "the file states its type");
    unused("--dims", opts.dims.is_some() && !is_headless, "the file states its size");
    unused("--colors", opts.colors.is_some() && !is_map, "colour maps are for height maps");
    unused("--rgb", opts.rgb.is_some() && !is_image, "it is for images of heights in colours");
    unused("--ramp", opts.ramp.is_some() && !is_map && !is_volume, "it is for height maps and volumes");
    unused("--exaggeration", opts.exaggeration.is_some() && !is_map, "it is for height maps");
    unused("--classes", opts.classes.is_some() && !is_volume, "it is for volumes");
    unused("--water", opts.water.is_some() && !is_map, "it is for height maps");
    unused("--nodata", opts.nodata.is_some() && !is_map, "it is for height maps");
    unused("--height-scale", opts.height_scale.is_some() && !is_map, "it is for height maps");
    if format == Format::Npy
        && let Some(heights) = npy::npy_heights(path, bytes, in_file)?
    {
        let mut map = heightmap::Map::of(heights);
        map.about.format = "NPY".to_owned();
        map.notes.append(&mut notes);
        return boxed(heightmap::rows(path, map, bytes.len() as u64, opts));
    }
    let mut volume = |volume: Result<volume::Volume<'a>>| {
        let mut volume = volume?;
        if !volume.about.format.is_empty() {
            volume.about.left_out.extend(notes.iter().cloned());
        }
        volume.notes.append(&mut notes);
        Ok(World::Volume(volume))
    };
    let cloud = |points: Result<points::Points>, mut notes: Vec<String>| {
        let mut points = points?;
        points.about.left_out.append(&mut notes);
        boxed(Ok(points))
    };
    let model = match format {
        Format::Raw => return volume(volume::raw(path, bytes, opts)),
        Format::Npy => return volume(npy::npy(path, bytes, opts)),
        Format::Nrrd => return volume(nrrd::read(path, bytes, opts)),
        Format::Nifti => return volume(nifti::read(path, bytes, opts)),
        Format::MetaImage => return volume(meta_image::read(path, bytes, opts)),
        Format::Mrc => return volume(mrc::read(path, bytes, opts)),
        Format::Vti => return volume(vti::read(path, bytes, opts)),
        Format::Heightmap => {
            let mut map = heightmap::read(path, bytes, in_file, opts)?;
            map.notes.append(&mut notes);
            return boxed(Ok(map));
        }
        Format::Dem | Format::Asc | Format::Hgt | Format::R16 => {
            let mut map = match format {
                Format::Dem => dem::read(path, bytes),
                Format::Asc => grids::asc(path, bytes, opts),
                Format::Hgt => grids::hgt(path, bytes, opts),
                _ => grids::r16(path, bytes, opts),
            }?;
            map.notes.append(&mut notes);
            return boxed(heightmap::rows(path, map, bytes.len() as u64, opts));
        }
        Format::Stack => return volume(stack::read(path, bytes, in_file, opts)),
        #[cfg(feature = "dicom")]
        Format::Dicom => return volume(dicom::read(path, &[path.to_owned()], opts)),
        #[cfg(not(feature = "dicom"))]
        Format::Dicom => return without(path, "DICOM", "dicom"),
        Format::Vxl => vxl::read(path, bytes),
        Format::Vox => vox::read(path, bytes),
        Format::Kv6 => kv6::kv6(path, bytes),
        Format::Kvx => kv6::kvx(path, bytes),
        Format::Slab6 => kv6::slab6(path, bytes),
        Format::Qb => qb::read(path, bytes),
        Format::Gox => gox::read(path, bytes),
        Format::Binvox => binvox::read(path, bytes, opts),
        Format::Pcd => return cloud(pcd::read(path, bytes, opts), notes),
        Format::Ply => {
            let mesh = ply::read(path, bytes)?;
            return match mesh.triangles.is_empty() {
                true => cloud(points::Points::of_mesh(path, mesh, opts), notes),
                false => boxed(mesh::Voxelized::new(path, mesh, opts)),
            };
        }
        #[cfg(feature = "mesh")]
        Format::Stl | Format::Obj | Format::Gltf => {
            let mesh = match format {
                Format::Stl => stl::read(path, bytes),
                Format::Obj => obj::read(path, bytes),
                _ => gltf::read(path, bytes),
            }?;
            return boxed(mesh::Voxelized::new(path, mesh, opts));
        }
        #[cfg(not(feature = "mesh"))]
        Format::Stl | Format::Obj | Format::Gltf => return without(path, "meshes other than PLY", "mesh"),
        #[cfg(feature = "las")]
        Format::Las => return cloud(lidar::read(path, opts), notes),
        #[cfg(not(feature = "las"))]
        Format::Las => return without(path, "LAS and LAZ", "las"),
    }?;
    let mut about = Pieces::about(&model);
    about.left_out.append(&mut notes);
    Ok(World::Pieces(Box::new(model.about(about))))
}

fn boxed<'a>(pieces: Result<impl Pieces + 'static>) -> Result<World<'a>> {
    Ok(World::Pieces(Box::new(pieces?)))
}

#[allow(dead_code, reason = "all features may be there")]
fn without<T>(path: &Path, what: &str, feature: &str) -> Result<T> {
    let path = path.display();
    Err(Error::Argument(format!("{path}: this planecast reads no {what}; build it with --features {feature}")))
}

pub(crate) fn is_r16(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("r16"))
}

/// The kind of a file from its first bytes (at least 64 KiB of them, or all), and where those tell nothing, from
/// its name.
pub fn detect(path: &Path, head: &[u8]) -> Result<Format> {
    if let Some(format) = detect_content(head) {
        return Ok(format);
    }
    let name = path.file_name().map(|n| n.to_string_lossy().to_lowercase()).unwrap_or_default();
    if head.starts_with(b" BDV\0\0\0\0") {
        return Err(Error::format(path, "OpenVDB is not read; write the grid as a dense NPY, NRRD or Zarr volume"));
    }
    let fail = |what: &str| Err(Error::format(path, what));
    if head.starts_with(b"# vtk DataFile") {
        return fail("this is a file of VTK's older text format, which is not read; save it as .vti");
    }
    // Kinds that are known by how they begin, and not read.
    const RASTER: &str = "convert it to GeoTIFF: gdal_translate IN out.tif";
    const UNREAD: &[(&[u8], &str, &str)] = &[
        (b"EHFA_HEADER_TAG", "an ERDAS Imagine raster", RASTER),
        (b"\0\0\0\x0cjP  \r\n", "a picture in JPEG 2000", RASTER),
        (b"DSAA", "a Surfer grid", RASTER),
        (b"DSBB", "a Surfer grid", RASTER),
        (b"DSRB", "a Surfer grid", RASTER),
        (b"NITF", "a NITF raster", RASTER),
        (b"<VRTDataset", "a list of rasters (VRT)", RASTER),
        (b"SQLite format 3\0", "a database (GeoPackage, MBTiles)", RASTER),
        (b"SIMPLE  =", "a FITS file", "write its array as NPY"),
        (b"\x89HDF\r\n\x1a\n", "HDF5, or netCDF-4", "write one variable as Zarr (xarray: to_zarr) or NPY"),
        (b"CDF\x01", "netCDF", "write one variable as Zarr (xarray: to_zarr) or NPY"),
        (b"CDF\x02", "netCDF", "write one variable as Zarr (xarray: to_zarr) or NPY"),
        (b"CDF\x05", "netCDF", "write one variable as Zarr (xarray: to_zarr) or NPY"),
    ];
    if let Some((_, what, advice)) = UNREAD.iter().find(|(magic, _, _)| head.starts_with(magic)) {
        return fail(&format!("this is {what}, which is not read; {advice}"));
    }
    if head.starts_with(b"RIFF") && head.get(8..12) == Some(b"WEBP") {
        return fail("this is a picture in WebP, which is not read; save it as PNG");
    }
    if head.starts_with(b"PK\x03\x04") && !name.ends_with(".npz") {
        return fail("this is a zip archive; unpack it first");
    }
    match name.strip_suffix(".gz").unwrap_or(&name).rsplit('.').next().unwrap_or_default() {
        "vxl" => Ok(Format::Vxl),
        "dem" => Ok(Format::Dem),
        "asc" => Ok(Format::Asc),
        "hgt" => Ok(Format::Hgt),
        "r16" => Ok(Format::R16),
        "hdr" | "img" => Ok(Format::Nifti),
        "mha" | "mhd" => Ok(Format::MetaImage),
        "mrc" | "ccp4" | "mrcs" | "rec" => Ok(Format::Mrc),
        "npz" => fail("an archive of arrays; save one of them: numpy.save(\"a.npy\", numpy.load(\"a.npz\")[\"name\"])"),
        "stl" => Ok(Format::Stl),
        "obj" => Ok(Format::Obj),
        "gltf" => Ok(Format::Gltf),
        "raw" | "bin" => fail("a raw volume does not state its size: give --dims X,Y,Z and --dtype u8|u16|i16|f32"),
        "vox" => fail("byte 0: expected \"VOX \", or as Slab6 has it three sizes, as many bytes, and 768 more"),
        "kvx" => Ok(Format::Kvx),
        "qb" => Ok(Format::Qb),
        "pcd" => Ok(Format::Pcd),
        "qbt" | "qbcl" | "qef" => fail("of Qubicle's formats .qb is read; export it as Qubicle Binary"),
        "e57" | "pts" | "ptx" => {
            fail("of clouds of points LAS, LAZ, PCD and PLY are read; convert it, with PDAL for one")
        }
        "bil" | "bip" | "bsq" | "flt" | "adf" | "sdat" | "gtx" => {
            fail("a raster whose header is a file of its own, which is not read; convert it: gdal_translate IN out.tif")
        }
        "pcast" => fail("this is a scene already; encode takes what a scene is made from"),
        _ if head.is_empty() => fail("the file is empty"),
        _ => Err(Error::format(path, format!("neither content nor name tells the kind; supported: {SUPPORTED}"))),
    }
}

fn detect_content(head: &[u8]) -> Option<Format> {
    const MAGICS: &[(&[u8], Format)] = &[
        (b"\x89PNG\r\n\x1a\n", Format::Heightmap),
        (b"\xff\xd8\xff", Format::Heightmap),
        (b"II*\0", Format::Heightmap),
        (b"MM\0*", Format::Heightmap),
        (b"II+\0", Format::Heightmap),
        (b"MM\0+", Format::Heightmap),
        (b"\x93NUMPY", Format::Npy),
        (b"NRRD000", Format::Nrrd),
        (b"VOX ", Format::Vox),
        (b"Kvxl", Format::Kv6),
        (b"GOX ", Format::Gox),
        (b"#binvox", Format::Binvox),
        (b"# .PCD", Format::Pcd),
        (b"# .pcd", Format::Pcd),
        (b"VERSION .7\n", Format::Pcd),
        (b"VERSION 0.7\n", Format::Pcd),
        (b"ply\n", Format::Ply),
        (b"ply\r", Format::Ply),
        (b"glTF", Format::Gltf),
        (b"LASF", Format::Las),
        (&vxl::MAGIC.to_le_bytes(), Format::Vxl),
    ];
    if grids::is_asc(head) {
        return Some(Format::Asc);
    }
    if let Some((_, format)) = MAGICS.iter().find(|(magic, _)| head.starts_with(magic)) {
        return Some(*format);
    }
    if qb::is_one(head) {
        return Some(Format::Qb);
    }
    let mut inflated = Vec::new();
    let head = if head.starts_with(b"\x1f\x8b") {
        // Too short or broken a stream simply does not look like NIfTI.
        let _ = flate2::read::MultiGzDecoder::new(head).take(nifti::HEADER).read_to_end(&mut inflated);
        &inflated
    } else {
        head
    };
    if grids::is_asc(head) {
        return Some(Format::Asc);
    }
    if head.starts_with(b"ply\n") || head.starts_with(b"ply\r") {
        return Some(Format::Ply);
    }
    if head.get(128..132) == Some(b"DICM") {
        return Some(Format::Dicom);
    }
    if meta_image::is_meta_image(head) {
        return Some(Format::MetaImage);
    }
    if mrc::is_mrc(head) {
        return Some(Format::Mrc);
    }
    if vti::is_vtk_xml(head) {
        return Some(Format::Vti);
    }
    nifti::is_nifti(head).then_some(Format::Nifti)
}

/// A whole file in memory, mapped.
fn map(path: &Path) -> Result<Map> {
    check_regular(path)?;
    let file = File::open(path).map_err(|e| Error::io(path, "open", e))?;
    Map::new(path, &file).map_err(|e| Error::io(path, "map", e))
}

/// Refuses what may have no end. Looked at before it is opened: to open a pipe would wait for its other end.
fn check_regular(path: &Path) -> Result<()> {
    let kind = fs::metadata(path).map_err(|e| Error::io(path, "open", e))?;
    if kind.is_dir() {
        return Err(Error::format(path, "this is a folder; expected a file"));
    }
    if !kind.is_file() {
        return Err(Error::format(path, "this is a device or a pipe; expected a file"));
    }
    Ok(())
}

/// Checks that a world of `dims` (x, y up, z) can be held; `hint` says what to do about one too high.
fn world_dims(path: &Path, dims: [u64; 3], hint: &str) -> Result<[u32; 3]> {
    let [nx, ny, nz] = dims;
    let fail = |what: String| Err(Error::Limit(format!("{}: {what}", path.display())));
    if dims.contains(&0) {
        return Err(Error::format(path, format!("size {nx} × {ny} × {nz}: every side must be at least 1")));
    }
    if ny > MAX_HEIGHT {
        return fail(format!("the world would be {ny} voxels high, at most {MAX_HEIGHT} can be held; {hint}"));
    }
    if nx.checked_mul(nz).is_none_or(|n| n > MAX_COLUMNS) {
        return fail(format!("the world would have {nx} × {nz} columns, at most {MAX_COLUMNS} can be held"));
    }
    Ok([nx as u32, ny as u32, nz as u32])
}

/// Runs a decoder of somebody else's, so that a panic of its own on hostile bytes is an error like any other. A
/// last resort: what can be checked before is checked before.
fn guarded<T>(path: &Path, decoder: &str, decode: impl FnOnce() -> Result<T>) -> Result<T> {
    std::panic::catch_unwind(std::panic::AssertUnwindSafe(decode))
        .unwrap_or_else(|_| Err(Error::format(path, format!("the {decoder} decoder gave up; the file is damaged"))))
}

#[cfg(test)]
mod tests;
