//! What all targets share: bytes go in, and what comes out is an error or keeps its promises.

use std::path::{Path, PathBuf};

use bytemuck::pod_read_unaligned;
use planecast_encoder::format::sheets::{Manifest, Sheets};
use planecast_encoder::format::write::write_scene_to;
use planecast_encoder::format::{Header, TileEntry};
use planecast_encoder::inspect::verify::{Depth, verify};
use planecast_encoder::source::{Dtype, Format, HeightCode, PointSize, ReadOptions, Up, open, read};
use planecast_encoder::{Colors, Input, PcastFile, Scene, TileKey, TileSource};
use xxhash_rust::xxh3::xxh3_64;

/// Voxels and runs beyond which a world is not looked at voxel by voxel: libFuzzer wants many small runs.
const SMALL: usize = 1 << 16;

/// Reads bytes as a file of a format. The first two choose flags.
pub fn import(format: Format, bytes: &[u8]) {
    let [flags, iso, bytes @ ..] = bytes else { return };
    let mut options = ReadOptions {
        format: Some(format),
        up: (flags & 1 != 0).then_some(Up::Z),
        iso: (flags & 2 != 0).then_some(f64::from(*iso) - 64.0),
        // Meshes and clouds of points: few voxels, many runs.
        size: Some(16),
        point_size: (flags & 16 != 0).then_some(PointSize::Auto),
        las_classes: (flags & 32 != 0).then(|| "2-6,18".parse().expect("classes")),
        fill: flags & 16 != 0,
        height_scale: (flags & 4 != 0).then_some(f64::from(*iso) / 16.0 - 2.0),
        rgb: (flags & 16 != 0).then_some(HeightCode::Mapbox),
        nodata: (flags & 32 != 0).then_some(f64::from(*iso)),
        ..ReadOptions::default()
    };
    let mut bytes = bytes;
    if format == Format::Raw {
        let [x, y, z, dtype, rest @ ..] = bytes else { return };
        use Dtype::{F32, F64, I8, I16, I32, I64, U8, U16, U32, U64};
        options.dims = Some([x, y, z].map(|&n| u64::from(n)));
        options.dtype = Some([U8, I8, U16, I16, U32, I32, U64, I64, F32, F64][usize::from(*dtype) % 10]);
        bytes = rest;
    }
    let_guards_work();
    let input = if format == Format::Obj && flags & 8 != 0 {
        open(&obj_in_parts(bytes), &options)
    } else if matches!(format, Format::Las | Format::Dicom) {
        // These are read from their files, part by part.
        let path = passing("file");
        std::fs::write(&path, bytes).expect("a folder for passing files");
        open(&path, &options)
    } else {
        read(Path::new("fuzzed"), bytes, &options)
    };
    if let Ok(input) = input {
        check(&input);
    }
}

/// A mesh with materials and a picture: the parts of `bytes` between bytes 0, the picture what is left after two.
fn obj_in_parts(bytes: &[u8]) -> PathBuf {
    let (folder, put) = (passing("obj"), "a folder for passing files");
    std::fs::create_dir_all(&folder).expect(put);
    let mut parts = bytes.splitn(3, |&b| b == 0);
    for name in ["a.obj", "a.mtl", "a.png"] {
        std::fs::write(folder.join(name), parts.next().unwrap_or_default()).expect(put);
    }
    folder.join("a.obj")
}

/// A place of this process's own in the folder of passing files.
fn passing(what: &str) -> PathBuf {
    std::env::temp_dir().join(format!("planecast-fuzz-{}-{what}", std::process::id()))
}

/// Reads bytes as a Zarr array: the first two choose flags and what the metadata are called, then come the metadata up to
/// a byte 0, and what is left is each of its chunks.
pub fn zarr(bytes: &[u8]) {
    let [flags, iso, bytes @ ..] = bytes else { return };
    let end = bytes.iter().position(|&b| b == 0).unwrap_or(bytes.len());
    let (metadata, chunk) = (&bytes[..end], bytes.get(end + 1..).unwrap_or_default());
    let (folder, put) = (passing("zarr"), "a folder for passing files");
    // No chunk of an earlier run stays.
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(folder.join("s0/c/0/0")).expect(put);
    let write = |name: &str, bytes: &[u8]| std::fs::write(folder.join(name), bytes).expect(put);
    let array = match (flags & 2 != 0, flags & 4 != 0) {
        (true, false) => "s0/zarr.json",
        (true, true) => "s0/.zarray",
        (false, _) => {
            // An image: its metadata are fuzzed, its array is not.
            let array = r#"{"zarr_format":2,"shape":[2,2,2],"chunks":[2,2,2],"dtype":"|u1","compressor":null,
                "fill_value":0,"order":"C","filters":null}"#;
            write("s0/.zarray", array.as_bytes());
            if flags & 4 != 0 { "zarr.json" } else { ".zattrs" }
        }
    };
    write(".zgroup", br#"{"zarr_format":2}"#);
    write(array, metadata);
    ["s0/c/0/0/0", "s0/c/0/0/1", "s0/0.0.0", "s0/0.0.1"].iter().for_each(|name| write(name, chunk));
    let options = ReadOptions {
        up: (flags & 1 != 0).then_some(Up::Z),
        iso: Some(f64::from(*iso) - 64.0),
        ..ReadOptions::default()
    };
    let_guards_work();
    let path = if flags & 2 != 0 { folder.join("s0") } else { folder };
    if let Ok(input) = open(&path, &options) {
        check(&input);
    }
}

/// A decoder of somebody else's may panic where the importer catches it: only what gets past that is a finding, which
/// libFuzzer sees without its own hook too.
fn let_guards_work() {
    static ONCE: std::sync::Once = std::sync::Once::new();
    ONCE.call_once(|| std::panic::set_hook(Box::new(|panic| eprintln!("{panic}"))));
}

/// What [`Input`] promises.
fn check(input: &Input) {
    let columns = &input.columns;
    let [nx, ny, nz] = columns.dims();
    assert!(nx > 0 && ny > 0 && nz > 0 && ny <= 65_536);
    let n = nx as usize * nz as usize;
    for ix in (0..n).take(SMALL) {
        let runs = &columns.runs()[columns.range(ix)];
        assert!(runs.windows(2).all(|w| w[0].end() < u32::from(w[1].first())), "column {ix}: {runs:?}");
        assert!(runs.iter().all(|r| r.first() <= r.last() && r.end() <= ny), "column {ix}: {runs:?}");
    }
    match &input.colors {
        Colors::Column(colors) => assert_eq!(colors.len(), n),
        Colors::Run(colors) => assert_eq!(colors.len(), columns.runs().len()),
        Colors::Voxel { offsets, entries } => {
            assert_eq!(offsets.len(), n + 1);
            assert_eq!(*offsets.last().unwrap() as usize, entries.len());
        }
        Colors::None | Colors::Function(_) => {}
    }
}

/// Reads bytes as the manifest of a world none of whose sheets can be opened.
pub fn world(bytes: &[u8]) {
    let name = Path::new("fuzzed.pworld");
    let Ok(manifest) = Manifest::parse(name, bytes) else { return };
    let open = |_: &Path| Err(planecast_encoder::Error::Limit("no sheet".to_owned()));
    let Ok(world) = Sheets::new(name, manifest, Box::new(open)) else { return };
    for level in 0..world.levels().min(4) {
        let _ = world.tile(TileKey { level, x: 0, z: 0 });
        let _ = world.is_empty(TileKey { level, x: 0, z: 0 });
    }
}

/// Reads bytes as a scene, with every checksum made right first: what is behind them must stand alone.
pub fn scene(bytes: &[u8]) {
    let mut bytes = bytes.to_vec();
    reseal(&mut bytes);
    let Ok(file) = PcastFile::from_bytes("fuzzed.pcast", bytes) else { return };
    for (x, y, z) in [(0, 0, 0), (1, 8, 1), (1, 259, 1), (255, 65_535, 256), (-1, 0, 0)] {
        let _ = file.query(x, y, z);
    }
    // What is found sound several columns at once must be what is read one by one.
    if verify(&file, Depth::Tiles).faults.is_empty() {
        for (k, grid) in file.grids().iter().enumerate() {
            let [across, along] = grid.tiles;
            for (tx, tz) in (0..along).flat_map(|tz| (0..across).map(move |tx| (tx, tz))) {
                file.tile(k, tx, tz).expect("a tile that was found right");
            }
        }
    }
    if let Ok(scene) = file.read_scene() {
        let again = PcastFile::from_bytes("again.pcast", written(&scene)).and_then(|f| f.read_scene());
        assert!(again.expect("what was read can be written and read") == scene);
    }
}

fn written(scene: &Scene) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    write_scene_to(scene, &mut bytes, Path::new("again.pcast")).expect("memory takes it");
    bytes.into_inner()
}

fn reseal(bytes: &mut [u8]) {
    let Some(header) = bytes.get(..size_of::<Header>()) else { return };
    let header: Header = pod_read_unaligned(header);
    let len = bytes.len() as u64;
    bytes[40..48].copy_from_slice(&len.to_le_bytes());
    let start = header.directory as usize;
    if let Some(end) = start.checked_add(48 * header.n_tiles as usize).filter(|&end| end <= bytes.len()) {
        for at in (start..end).step_by(48) {
            let entry: TileEntry = pod_read_unaligned(&bytes[at..at + 48]);
            let from = entry.offset as usize;
            let blob = from.checked_add(entry.len as usize).and_then(|end| bytes.get(from..end));
            if let Some(checksum) = blob.map(xxh3_64) {
                bytes[at + 8..at + 16].copy_from_slice(&checksum.to_le_bytes());
            }
        }
        let checksum = xxh3_64(&bytes[start..end]);
        bytes[48..56].copy_from_slice(&checksum.to_le_bytes());
    }
    let checksum = xxh3_64(&bytes[..56]);
    bytes[56..64].copy_from_slice(&checksum.to_le_bytes());
}
