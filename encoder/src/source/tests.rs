//! Each reader: a good file made here, and hostile ones.

use std::io::Write;

use clap::{Parser, ValueEnum};
use flate2::write::GzEncoder;

mod meshes;

use super::procedural::noise::hash;
use super::procedural::{Kind, from_name, procedural, procedural_pieces};
use super::*;
use crate::{About, Colors, Columns, Rgb, Run};

mod clouds;
mod models;

/// A file in a folder that goes away with it.
struct File(tempfile::TempDir, PathBuf);

fn file(name: &str, bytes: &[u8]) -> File {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join(name);
    fs::write(&path, bytes).unwrap();
    File(dir, path)
}

#[derive(Parser)]
struct Cli {
    #[command(flatten)]
    read: ReadOptions,
}

/// Options as typed.
pub(super) fn opts(flags: &str) -> ReadOptions {
    Cli::try_parse_from(["x"].into_iter().chain(flags.split_whitespace())).unwrap().read
}

/// Reads `bytes` as a file of that name and checks that what comes back keeps its promises.
fn try_read(name: &str, bytes: &[u8], flags: &str) -> Result<Input> {
    let input = super::read(Path::new(name), bytes, &opts(flags))?;
    assert_eq!(broken_promise(&input), None);
    Ok(input)
}

pub(super) fn read(name: &str, bytes: &[u8], flags: &str) -> Input {
    try_read(name, bytes, flags).unwrap()
}

pub(super) fn error(name: &str, bytes: &[u8], flags: &str) -> String {
    match try_read(name, bytes, flags) {
        Err(e) => e.to_string(),
        Ok(input) => panic!("{name} was read: {:?}", input.columns.dims()),
    }
}

/// What `Input` promises and this one does not keep.
fn broken_promise(input: &Input) -> Option<String> {
    let c = &input.columns;
    let n = c.nx() as usize * c.nz() as usize;
    for ix in 0..n {
        let runs = &c.runs()[c.range(ix)];
        if runs.windows(2).any(|w| w[0].end() >= u32::from(w[1].first())) {
            return Some(format!("column {ix}: runs touch, overlap or descend: {runs:?}"));
        }
        if runs.iter().any(|r| r.first() > r.last() || r.end() > c.ny()) {
            return Some(format!("column {ix}: a run is not inside the world"));
        }
    }
    match &input.colors {
        Colors::Column(colors) if colors.len() != n => Some("not one colour a column".to_owned()),
        Colors::Run(colors) if colors.len() != c.runs().len() => Some("not one colour a run".to_owned()),
        Colors::Voxel { offsets, entries } => {
            if offsets.len() != n + 1 || offsets[n] as usize != entries.len() {
                return Some("colour offsets do not fit".to_owned());
            }
            (0..n).find_map(|ix| {
                let own = &entries[offsets[ix] as usize..offsets[ix + 1] as usize];
                let (x, z) = (ix as u32 % c.nx(), ix as u32 / c.nx());
                (own.windows(2).any(|w| w[0].0 >= w[1].0) || own.iter().any(|&(y, _)| c.find(x, y.into(), z).is_none()))
                    .then(|| format!("column {ix}: colours do not ascend or are on air"))
            })
        }
        _ => None,
    }
}

#[test]
fn checker_sees_touching_runs_and_colours_on_air() {
    let columns = |runs: &[Run]| Columns::from_parts(1, 9, 1, vec![0, runs.len() as u32], runs.to_vec());
    let input = |runs: &[Run], colors| Input { columns: columns(runs), colors, notes: Vec::new() };
    let voxel = |y: u16| Colors::Voxel { offsets: vec![0, 1], entries: vec![(y, [0; 3])] };
    let runs = [Run::new(1, 2), Run::new(4, 8)];
    assert_eq!(broken_promise(&input(&runs, voxel(2))), None);
    assert!(broken_promise(&input(&runs, voxel(3))).is_some());
    assert!(broken_promise(&input(&runs, Colors::Run(vec![[0; 3]]))).is_some());
    assert!(broken_promise(&input(&runs, Colors::Column(Vec::new()))).is_some());
    assert!(broken_promise(&input(&[Run::new(1, 3), Run::new(4, 8)], Colors::None)).is_some());
    assert!(broken_promise(&input(&[Run::new(4, 9)], Colors::None)).is_some());
}

/// No prefix of a good file is a file, and none makes a panic.
fn refuses_every_prefix(name: &str, bytes: &[u8], flags: &str) {
    refuses_every_prefix_but(0, name, bytes, flags);
}

/// The same for a format whose last `n` bytes hold nothing that is needed: those may be missed or not.
pub(super) fn refuses_every_prefix_but(n: usize, name: &str, bytes: &[u8], flags: &str) {
    assert!(try_read(name, bytes, flags).is_ok());
    let (path, opts) = (Path::new(name), opts(flags));
    for len in 0..bytes.len() {
        let outcome = super::read(path, &bytes[..len], &opts);
        let all = bytes.len();
        assert!(outcome.is_err() || len + n >= all, "{name}: the first {len} of {all} bytes were read");
    }
}

/// Whatever a byte is changed to, the answer is an input that keeps its promises or an error.
pub(super) fn survives_changed_bytes(name: &str, bytes: &[u8], flags: &str) {
    let (path, opts) = (Path::new(name), opts(flags));
    for at in 0..bytes.len().min(1500) {
        for value in [0, 1, 0x7F, 0x80, 0xFF, bytes[at] ^ 0x10] {
            let mut bytes = bytes.to_vec();
            bytes[at] = value;
            if let Ok(input) = super::read(path, &bytes, &opts) {
                assert_eq!(broken_promise(&input), None, "{name}: byte {at} = {value}");
            }
        }
    }
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut out = GzEncoder::new(Vec::new(), flate2::Compression::default());
    out.write_all(bytes).unwrap();
    out.finish().unwrap()
}

// Volumes.

/// Longer along x than a word of bits, so that the last word is a part.
const DIMS: [usize; 3] = [70, 5, 9];

/// Values −100 … 155 with runs of several voxels on every axis.
fn value(x: usize, y: usize, z: usize) -> i32 {
    (hash(1, x as u32 / 3, y as u32 / 2, z as u32 / 2) >> 24) as i32 - 100
}

/// The volume's values in file order.
fn values<T>(f: impl Fn(i32) -> T) -> Vec<T> {
    let [nx, ny, nz] = DIMS;
    let at = |i: usize| f(value(i % nx, i / nx % ny, i / (nx * ny)));
    (0..nx * ny * nz).map(at).collect()
}

fn bytes_of<const N: usize>(values: Vec<[u8; N]>) -> Vec<u8> {
    values.concat()
}

fn u8_volume() -> Vec<u8> {
    values(|v| v.max(0) as u8)
}

/// Compares with one look at `solid` a voxel; `solid` takes file coordinates.
fn assert_volume(input: &Input, up: Up, solid: impl Fn(usize, usize, usize) -> bool) {
    let [nx, ny, nz] = DIMS;
    let dims = match up {
        Up::X => [nz, nx, ny],
        Up::Y => DIMS,
        Up::Z => [nx, nz, ny],
    };
    assert_eq!(input.columns.dims().map(|d| d as usize), dims);
    for (x, y, z) in (0..nx * ny * nz).map(|i| (i % nx, i / nx % ny, i / (nx * ny))) {
        let world = match up {
            Up::X => [z, x, y],
            Up::Y => [x, y, z],
            Up::Z => [x, z, ny - 1 - y],
        };
        let [wx, wy, wz] = world.map(|v| v as i64);
        assert_eq!(input.columns.solid(wx, wy, wz), solid(x, y, z), "file voxel ({x}, {y}, {z})");
    }
}

#[test]
fn raw_voxels_land_where_the_up_axis_says() {
    for (flags, up) in [("", Up::Y), ("--up y", Up::Y), ("--up z", Up::Z), ("--up x", Up::X)] {
        let input = read("v.raw", &u8_volume(), &format!("--dims 70,5,9 {flags}"));
        assert_volume(&input, up, |x, y, z| value(x, y, z) > 0);
    }
}

#[test]
#[should_panic(expected = "file voxel (69, 4, 8)")]
fn raw_comparison_sees_one_wrong_voxel() {
    let mut bytes = u8_volume();
    let last = bytes.last_mut().unwrap();
    *last = u8::from(*last == 0);
    assert_volume(&read("v.raw", &bytes, "--dims 70,5,9"), Up::Y, |x, y, z| value(x, y, z) > 0);
}

#[test]
fn raw_values_of_every_type_meet_the_iso_value() {
    let at_least = |iso: i32| move |x, y, z| value(x, y, z) >= iso;
    let volume = |bytes: Vec<u8>, dtype: &str, iso: &str| {
        read("v.raw", &bytes, &format!("--dims 70,5,9 --dtype {dtype} --iso {iso}"))
    };
    assert_volume(&volume(u8_volume(), "u8", "40"), Up::Y, at_least(40));
    assert_volume(&volume(bytes_of(values(|v| (v as i8).to_le_bytes())), "i8", "-5"), Up::Y, |x, y, z| {
        value(x, y, z) as i8 >= -5
    });
    assert_volume(&volume(bytes_of(values(|v| ((v + 300) as u16).to_le_bytes())), "u16", "340"), Up::Y, at_least(40));
    assert_volume(&volume(bytes_of(values(|v| (v as i16 * 9).to_le_bytes())), "i16", "-270"), Up::Y, at_least(-30));
    assert_volume(&volume(bytes_of(values(|v| (v as f32 / 10.0).to_le_bytes())), "f32", "0.7"), Up::Y, at_least(7));
    assert_volume(&volume(bytes_of(values(|v| f64::from(v).to_le_bytes())), "f64", "1e1"), Up::Y, at_least(10));
    assert_volume(&volume(bytes_of(values(|v| (i64::from(v) << 40).to_le_bytes())), "i64", "0"), Up::Y, at_least(0));
}

#[test]
fn raw_nan_is_air() {
    let bytes = bytes_of([f32::NAN, 1.0, f32::NEG_INFINITY, f32::INFINITY].map(f32::to_le_bytes).to_vec());
    let input = read("v.raw", &bytes, "--dims 1,4,1 --dtype f32 --iso -1e30");
    assert_eq!(input.columns.column(0, 0), [Run::new(1, 1), Run::new(3, 3)]);
}

#[test]
fn raw_errors_say_what_was_expected() {
    let e = error("v.raw", &[0; 59], "--dims 3,4,5");
    assert!(e.contains("59 bytes") && e.contains("exactly 60"), "{e}");
    let e = error("v.raw", &[0; 60], "--dims 3,4,5 --dtype f32");
    assert!(e.contains("exactly 240"), "{e}");
    let e = error("v.raw", &[0; 60], "");
    assert!(e.contains("--dims"), "{e}");
    let e = error("v.raw", &bytes_of([-7i16, 5, 900].map(i16::to_le_bytes).to_vec()), "--dims 3,1,1 --dtype i16");
    assert!(e.contains("from -7 to 900") && e.contains("--iso"), "{e}");
    let e = error("v.raw", &[0; 60], "--dims 1048576,1048576,1048576");
    assert!(e.contains("exactly 1152921504606846976"), "{e}");
    let e = error("v.raw", &[0; 60], "--dims 4194304,4194304,4194304");
    assert!(e.contains("beyond any memory"), "{e}");
    assert!(error("v.raw", &[0; 12], "--dims 3,4").contains("a volume has three sides"));
    for dims in ["3", "3,4,5,6", "3,0", "0,1,1", "a,b,c", "-1,2,3"] {
        assert!(Cli::try_parse_from(["x", "--dims", dims]).is_err(), "{dims}");
    }
}

#[test]
fn raw_columns_reach_65536_and_no_higher() {
    let input = read("v.raw", &[1; 65_536], "--dims 1,65536,1");
    assert_eq!(input.columns.column(0, 0), [Run::new(0, u16::MAX)]);
    let mut bytes = vec![0; 65_536];
    bytes.iter_mut().step_by(2).for_each(|b| *b = 1);
    assert_eq!(read("v.raw", &bytes, "--dims 1,1,65536 --up z").columns.runs().len(), 32_768);
    let e = error("v.raw", &[1; 65_537], "--dims 1,65537,1");
    assert!(e.contains("65537 voxels high") && e.contains("--up"), "{e}");
}

pub(super) fn npy_file(descr: &str, fortran: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let text = format!("{{'descr': '{descr}', 'fortran_order': {fortran}, 'shape': ({shape}), }}\n");
    [b"\x93NUMPY\x01\0", &(text.len() as u16).to_le_bytes()[..], text.as_bytes(), data].concat()
}

#[test]
fn npy_reads_either_order_and_byte_order() {
    let solid = |x, y, z| value(x, y, z) >= 20;
    let shape = "9, 5, 70";
    let c_order = npy_file("<i2", "False", shape, &bytes_of(values(|v| (v as i16).to_le_bytes())));
    assert_volume(&read("a.npy", &c_order, "--iso 20"), Up::Y, solid);
    let big = npy_file(">i2", "False", shape, &bytes_of(values(|v| (v as i16).to_be_bytes())));
    assert_volume(&read("a.npy", &big, "--iso 20 --up z"), Up::Z, solid);
    let [nx, ny, nz] = DIMS;
    let data = (0..nx * ny * nz).map(|i| (value(i / (nz * ny), i / nz % ny, i % nz) as i16).to_le_bytes()).collect();
    let fortran = npy_file("<i2", "True", shape, &bytes_of(data));
    for (flags, up) in [("", Up::Y), ("--up z", Up::Z), ("--up x", Up::X)] {
        assert_volume(&read("no-name", &fortran, &format!("--iso 20 {flags}")), up, solid);
    }
}

#[test]
fn npy_heights_are_the_same_from_a_file_and_from_memory() {
    let number = |i: usize| (i * i * 37 % 4001) as i32 - 300;
    let i16s = |n: i32| n as i16;
    let little: Vec<u8> = (0..35).flat_map(|i| i16s(number(i)).to_le_bytes()).collect();
    let big: Vec<u8> = (0..35).flat_map(|i| i16s(number(i)).to_be_bytes()).collect();
    let unsigned: Vec<u8> = (0..35).flat_map(|i| (number(i) + 60_000).to_le_bytes().into_iter().take(2)).collect();
    let floats: Vec<u8> = (0..35).flat_map(|i| (number(i) as f32 / 7.0).to_le_bytes()).collect();
    for (descr, data) in [("<i2", little), (">i2", big), ("<u2", unsigned), ("<f4", floats)] {
        let bytes = npy_file(descr, "False", "5, 7", &data);
        let file = file("a.npy", &bytes);
        for flags in ["", "--height-scale 1", "--height-scale 0.25", "--nodata -300", "--size 3"] {
            let whole = read("a.npy", &bytes, flags).columns;
            let world = open_pieces(&file.1, &opts(flags)).unwrap();
            assert_eq!(world.dims(), whole.dims(), "{descr} {flags}");
            let piece = world.piece(1..whole.nx(), 1..whole.nz()).unwrap().columns;
            let mut heights = vec![0; whole.nx() as usize - 1];
            for z in 1..whole.nz() {
                world.heights().unwrap()(1, z, &mut heights).unwrap();
                for (x, &height) in (1..).zip(&heights) {
                    let column = whole.column(x, z);
                    assert_eq!(piece.column(x - 1, z - 1), column, "{descr} {flags} {x} {z}");
                    assert_eq!(column.first().map_or(0, |run| run.end()), u32::from(height), "{descr} {flags} {x} {z}");
                }
            }
        }
    }
    // Lifted by 3 and halved: 0, 1.5, 2, 5, rounded away from zero.
    let data: Vec<u8> = [-3i16, 0, 1, 7].iter().flat_map(|v| v.to_le_bytes()).collect();
    let file = file("a.npy", &npy_file("<i2", "False", "1, 4", &data));
    let world = open_pieces(&file.1, &opts("--height-scale 0.5")).unwrap();
    let mut heights = [9; 4];
    world.heights().unwrap()(0, 0, &mut heights).unwrap();
    assert_eq!(heights, [1, 3, 3, 6]);
}

#[test]
fn npy_refuses_what_is_no_volume() {
    let good = npy_file("|u1", "False", "2, 3, 4", &[1; 24]);
    refuses_every_prefix("a.npy", &good, "");
    survives_changed_bytes("a.npy", &good, "");
    assert!(error("a.npy", &npy_file("|u1", "False", "24,", &[1; 24]), "").contains("three axes"));
    assert!(error("a.npy", &npy_file("<c8", "False", "1, 1, 3", &[1; 24]), "").contains("\"<c8\""));
    let e = error("a.npy", &npy_file("|u1", "True", "1048576, 1048576, 1048576", &[1; 24]), "");
    assert!(e.contains("expects 1152921504606846976"), "{e}");
}

#[test]
fn npy_headers_are_those_that_python_reads() {
    let solid = |x, y, z| value(x, y, z) >= 20;
    let data = bytes_of(values(|v| (v as i16).to_le_bytes()));
    let file = |text: &str, data: &[u8]| {
        [b"\x93NUMPY\x01\0", &(text.len() as u16).to_le_bytes()[..], text.as_bytes(), data].concat()
    };
    for text in [
        "{\"descr\": \"<i2\", \"fortran_order\": False, \"shape\": (9, 5, 70)}",
        "{'shape' : (9L, 5L, 70L),'descr':'<i2' , 'fortran_order'\t:False }\n",
        "{'descr': 'int16', 'fortran_order': False, 'shape': (1, 9, 1, 5, 70), }     \n",
        " {'descr': [('v', '<i2')], 'fortran_order': False, 'shape': (9, 5, 70,), }",
        "{'descr': u'=h', 'fortran_order': False, 'shape': (9,\n 5, 70), }",
    ] {
        assert_volume(&read("a.npy", &file(text, &data), "--iso 20"), Up::Y, solid);
    }
    // Half floats, and records of which the first number is read.
    let halves = bytes_of(values(|v| (if v >= 20 { 0x4d00u16 } else { 0xbc00 }).to_be_bytes()));
    let text = "{'descr': '>f2', 'fortran_order': False, 'shape': (9, 5, 70), }";
    assert_volume(&read("a.npy", &file(text, &halves), "--iso 20"), Up::Y, solid);
    let records: Vec<u8> = values(|v| (v as i16).to_le_bytes()).iter().flat_map(|v| [9, 9, v[0], v[1], 7]).collect();
    let text = "{'descr': [('name', '|S2'), ('v', '<i2'), ('w', '|u1')], 'fortran_order': False, 'shape': (9, 5, 70)}";
    assert_volume(&read("a.npy", &file(text, &records), "--iso 20"), Up::Y, solid);
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.npy");
    fs::write(&path, [file(text, &records), vec![1; 5]].concat()).unwrap();
    let left_out = open_pieces(&path, &opts("--iso 20")).unwrap().about().left_out;
    assert_eq!(left_out, ["fields 'name', 'w' of the records: the first number is read", "5 bytes after the array"]);
    let booleans = npy_file("|b1", "False", "2, 3, 4", &[0, 1, 2, 255].repeat(6));
    assert_eq!(read("a.npy", &booleans, "").columns.voxels(), 18);
    for (descr, what) in
        [("'|O'", "pickled"), ("'<c16'", "complex"), ("'<M8[ns]'", "dates"), ("[('a', '<c8')]", "none of whose")]
    {
        let text = format!("{{'descr': {descr}, 'fortran_order': False, 'shape': (1, 1, 1)}}");
        assert!(error("a.npy", &file(&text, &[0; 16]), "").contains(what), "{descr}");
    }
    let e = error("a.npy", &npy_file("|u1", "False", "2, 2, 2, 3", &[1; 24]), "");
    assert!(e.contains("save one channel or time"), "{e}");
    survives_changed_bytes("a.npy", &file(text, &records), "--iso 20");
}

const NRRD: &str = "NRRD0004\n# note\ntype: short\ndimension: 3\nsizes: 70 5 9\nendian: little\n";

#[test]
fn nrrd_reads_raw_gzip_and_detached_values() {
    let solid = |x, y, z| value(x, y, z) >= 20;
    let data = bytes_of(values(|v| (v as i16).to_le_bytes()));
    let with = |header: &str, data: &[u8]| [header.as_bytes(), data].concat();
    let raw = with(&format!("{NRRD}encoding: raw\nkey:=value\n\n"), &data);
    assert_volume(&read("a.nrrd", &raw, "--iso 20"), Up::Y, solid);
    let skipped = with(&format!("{NRRD}encoding: raw\nbyte skip: -1\n\nsomething else"), &data);
    assert_volume(&read("a.nrrd", &skipped, "--iso 20"), Up::Y, solid);
    let gz = with(&format!("{NRRD}encoding: gzip\n\n"), &gzip(&data));
    assert_volume(&read("a.nrrd", &gz, "--iso 20 --up z"), Up::Z, solid);
    let big = with(
        &format!("{}encoding: raw\n\n", NRRD.replace("little", "big")),
        &bytes_of(values(|v| (v as i16).to_be_bytes())),
    );
    assert_volume(&read("a.nrrd", &big, "--iso 20"), Up::Y, solid);

    let header = file("a.nhdr", format!("{NRRD}encoding: raw\ndata file: a.raw\n").as_bytes());
    fs::write(header.0.path().join("a.raw"), &data).unwrap();
    assert_volume(&open(&header.1, &opts("--iso 20")).unwrap(), Up::Y, solid);
    fs::remove_file(header.0.path().join("a.raw")).unwrap();
    assert!(open(&header.1, &opts("--iso 20")).is_err_and(|e| e.to_string().contains("a.raw: cannot open")));
}

#[test]
fn nrrd_refuses_what_it_cannot_trust() {
    let small = NRRD.replace("70 5 9", "3 2 2").replace("short", "uint8");
    refuses_every_prefix("a.nrrd", format!("{small}encoding: raw\n\nabcdefghijkl").as_bytes(), "");
    let gz = [format!("{small}encoding: gzip\n\n").as_bytes(), &gzip(b"abcdefghijkl")].concat();
    refuses_every_prefix("a.nrrd", &gz, "");
    survives_changed_bytes("a.nrrd", &gz, "");
    let e = error("a.nrrd", format!("{small}encoding: bzip2\n\nabcdefghijkl").as_bytes(), "");
    assert!(e.contains("\"bzip2\"") && e.contains("gzip"), "{e}");
    for encoding in ["raw", "gzip"] {
        let huge = small.replace("3 2 2", "1048576 1048576 1048576");
        let e = error("a.nrrd", &[format!("{huge}encoding: {encoding}\n\n").as_bytes(), &gzip(b"abc")].concat(), "");
        assert!(e.contains("expect 1152921504606846976"), "{e}");
    }
    let e = error("a.nrrd", format!("{}encoding: raw\n\nabc", small.replace("3 2 2", "3 1")).as_bytes(), "");
    assert!(e.contains("2 sizes"), "{e}");
    let e = error("a.nrrd", format!("{small}nonsense\n\nabc").as_bytes(), "");
    assert!(e.contains(&format!("byte {}:", small.len())) && e.contains("nonsense"), "{e}");
}

fn nifti_file(dims: [u16; 3], datatype: i16, slope: [f32; 2], data: &[u8]) -> Vec<u8> {
    let mut h = vec![0u8; 352];
    let mut put = |at: usize, bytes: &[u8]| h[at..at + bytes.len()].copy_from_slice(bytes);
    put(0, &348i32.to_le_bytes());
    let dim = [3, dims[0], dims[1], dims[2], 1, 1, 1, 1];
    put(40, &bytes_of(dim.map(u16::to_le_bytes).to_vec()));
    put(70, &datatype.to_le_bytes());
    put(108, &352f32.to_le_bytes());
    put(112, &bytes_of(slope.map(f32::to_le_bytes).to_vec()));
    put(344, b"n+1\0");
    h.extend_from_slice(data);
    h
}

#[test]
fn nifti_applies_slope_and_intercept_to_the_iso_value() {
    let data = bytes_of(values(|v| (v as i16).to_le_bytes()));
    let plain = nifti_file([70, 5, 9], 4, [0.0, 0.0], &data);
    assert_volume(&read("a.nii", &plain, "--iso 20"), Up::Y, |x, y, z| value(x, y, z) >= 20);
    let scaled = nifti_file([70, 5, 9], 4, [-2.0, 10.0], &data);
    let solid = |x, y, z| 10 - 2 * value(x, y, z) >= 20;
    assert_volume(&read("a.nii.gz", &gzip(&scaled), "--iso 20 --up z"), Up::Z, solid);
    // An intercept that puts 0 among the values says what is solid.
    assert_volume(&read("a.nii", &scaled, ""), Up::Y, |x, y, z| 10 - 2 * value(x, y, z) > 0);
}

#[test]
fn nifti_refuses_what_it_cannot_trust() {
    let good = nifti_file([3, 2, 2], 2, [1.0, 0.0], b"abcdefghijkl");
    refuses_every_prefix("a.nii", &good, "");
    refuses_every_prefix("a.nii.gz", &gzip(&good), "");
    survives_changed_bytes("a.nii", &good, "");
    let e = error("a.nii", &nifti_file([32_767; 3], 64, [1.0, 0.0], b"abc"), "--iso 1");
    assert!(e.contains("355 bytes") && e.contains("32767 × 32767 × 32767"), "{e}");
    assert!(error("a.nii", &nifti_file([1, 1, 1], 128, [1.0, 0.0], b"abc"), "").contains("type 128"));
}

mod volumes;

// Height maps.

pub(super) fn png(image: impl Into<image::DynamicImage>) -> Vec<u8> {
    let mut out = std::io::Cursor::new(Vec::new());
    image.into().write_to(&mut out, image::ImageFormat::Png).unwrap();
    out.into_inner()
}

pub(super) fn heights(input: &Input) -> Vec<Option<u16>> {
    let c = &input.columns;
    let column = |ix| {
        let runs = &c.runs()[c.range(ix)];
        assert!(runs.len() <= 1 && runs.iter().all(|r| r.first() == 0));
        runs.first().map(|r| r.last())
    };
    (0..c.nx() as usize * c.nz() as usize).map(column).collect()
}

#[test]
fn heightmap_columns_are_solid_up_to_the_scaled_value() {
    let image = image::GrayImage::from_raw(3, 2, vec![0, 1, 2, 10, 20, 255]).unwrap();
    let input = read("h.png", &png(image.clone()), "");
    assert_eq!(input.columns.dims(), [3, 256, 2]);
    assert_eq!(heights(&input), [0, 1, 2, 10, 20, 255].map(Some));
    let input = read("h.png", &png(image), "--height-scale 0.25");
    assert_eq!(heights(&input), [0, 0, 1, 3, 5, 64].map(Some));
}

#[test]
fn heightmap_of_16_bits_fits_a_quarter_of_its_width_unless_scaled() {
    let image =
        image::ImageBuffer::<image::Luma<u16>, _>::from_raw(8, 1, vec![0, 1, 2, 3, 100, 1000, 40_000, 65_535]).unwrap();
    let input = read("h.png", &png(image.clone()), "");
    assert_eq!(input.columns.dims(), [8, 3, 1]);
    assert!(input.notes.iter().any(|n| n.contains("--height-scale")), "{:?}", input.notes);
    let input = read("h.png", &png(image.clone()), "--height-scale 1");
    assert_eq!(heights(&input)[5..], [1000, 40_000, 65_535].map(Some));
    let e = error("h.png", &png(image), "--height-scale 1.1");
    assert!(e.contains("at most 65535") && e.contains("--height-scale"), "{e}");
}

#[test]
fn heightmap_colours_are_those_of_the_nearest_pixel() {
    let map = image::RgbImage::from_fn(4, 1, |x, _| image::Rgb([x as u8 * 10, 1, 2]));
    let colors = file("c.png", &png(map));
    let read_with = |image: image::GrayImage| {
        let f = file("h.png", &png(image));
        let o = ReadOptions { colors: Some(colors.1.clone()), ..ReadOptions::default() };
        let map = open(&f.1, &o).unwrap();
        let Colors::Column(colors) = map.colors else { panic!("no colours") };
        colors.iter().map(|c| c[0]).collect::<Vec<_>>()
    };
    assert_eq!(read_with(image::GrayImage::new(4, 2)), [0, 10, 20, 30, 0, 10, 20, 30]);
    assert_eq!(read_with(image::GrayImage::new(2, 1)), [10, 30]);
    assert_eq!(read_with(image::GrayImage::new(8, 1)), [0, 0, 10, 10, 20, 20, 30, 30]);
}

/// Heights of a file in voxels, and what is said of it.
pub(super) fn told(name: &str, bytes: &[u8], flags: &str) -> (Vec<Option<u16>>, About) {
    let File(_folder, path) = file(name, bytes);
    let world = open_pieces(&path, &opts(flags)).unwrap();
    let input = pieces::whole(&*world).unwrap();
    assert_eq!(broken_promise(&input), None);
    (heights(&input), world.about())
}

/// A TIFF of `width × height` i16 values in tiles of 16 × 16, with further entries (tag, type, values).
fn tiled_tiff(width: u16, height: u16, values: &[i16], extra: &[(u16, u16, Vec<u8>)]) -> Vec<u8> {
    const SHORT: u16 = 3;
    const LONG: u16 = 4;
    let (across, down) = (width.div_ceil(16), height.div_ceil(16));
    let mut out = b"II*\0\0\0\0\0".to_vec();
    let mut offsets = Vec::new();
    for tile in 0..across * down {
        offsets.extend((out.len() as u32).to_le_bytes());
        for i in 0..256u16 {
            let (x, y) = (tile % across * 16 + i % 16, tile / across * 16 + i / 16);
            let inside = x < width && y < height;
            let v = if inside { values[usize::from(y) * usize::from(width) + usize::from(x)] } else { 12_345 };
            out.extend(v.to_le_bytes());
        }
    }
    let short = |tag: u16, v: u16| (tag, SHORT, v.to_le_bytes().to_vec());
    let mut entries = vec![short(256, width), short(257, height), short(258, 16), short(259, 1), short(262, 1)];
    entries.extend([short(277, 1), short(322, 16), short(323, 16)]);
    entries.push((324, LONG, offsets));
    entries.push((325, LONG, 512u32.to_le_bytes().repeat(usize::from(across * down))));
    entries.push(short(339, 2));
    entries.extend_from_slice(extra);
    // Values longer than four bytes stand elsewhere.
    let mut directory = (entries.len() as u16).to_le_bytes().to_vec();
    for (tag, kind, bytes) in entries {
        let size = [0, 1, 1, 2, 4, 8, 1, 1, 2, 4, 8, 4, 8][usize::from(kind)];
        directory.extend([tag.to_le_bytes(), kind.to_le_bytes()].concat());
        directory.extend((bytes.len() as u32 / size).to_le_bytes());
        if bytes.len() <= 4 {
            directory.extend([&bytes[..], &[0; 4][bytes.len()..]].concat());
        } else {
            directory.extend((out.len() as u32).to_le_bytes());
            out.extend(bytes);
        }
    }
    directory.extend([0; 4]);
    let at = out.len() as u32;
    out[4..8].copy_from_slice(&at.to_le_bytes());
    out.extend(directory);
    out
}

/// Geo tags: pixels of `side`, the upper left corner at (0, `top`), model type 1 (projected) or 2 (geographic).
fn geo_tags(side: f64, top: f64, model: u16, more_keys: &[[u16; 4]]) -> Vec<(u16, u16, Vec<u8>)> {
    let doubles = |v: &[f64]| v.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let keys = [&[[1, 1, 0, 1 + more_keys.len() as u16], [1024, 0, 1, model]], more_keys].concat();
    let keys = keys.iter().flatten().flat_map(|k| k.to_le_bytes()).collect();
    vec![
        (33_550, 12, doubles(&[side, side, 0.0])),
        (33_922, 12, doubles(&[0.0, 0.0, 0.0, 0.0, top, 0.0])),
        (34_735, 3, keys),
    ]
}

#[test]
fn geotiff_tiles_nodata_and_pixel_size_are_read() {
    let values: Vec<i16> = (0..20 * 18).map(|i| if i == 27 { -32_768 } else { i * 3 }).collect();
    let mut tags = geo_tags(30.0, 0.0, 1, &[]);
    tags.push((42_113, 2, b"-32768\0".to_vec()));
    let input = read("h.tif", &tiled_tiff(20, 18, &values, &tags), "");
    assert_eq!([input.columns.nx(), input.columns.nz()], [20, 18]);
    let expected = |(i, &v): (usize, &i16)| (i != 27).then(|| (f64::from(v) / 30.0).round() as u16);
    assert_eq!(heights(&input), values.iter().enumerate().map(expected).collect::<Vec<_>>());
    let (_, about) = told("h.tif", &tiled_tiff(20, 18, &values, &tags), "");
    assert!(about.rule.contains("the pixel without data is empty"), "{about}");
}

#[test]
fn geotiff_degrees_become_metres_at_the_centre() {
    // At 60 degrees north half as wide as at the equator, and 0.25 % more, since the ellipsoid is flattened.
    let side = 1.0 / 111_319.49;
    let values = vec![1000; 4];
    let input = read("h.tif", &tiled_tiff(2, 2, &values, &geo_tags(side, 60.0 + side, 2, &[])), "");
    assert_eq!(heights(&input), [Some(1995); 4]);
    // Feet up, metres across.
    let feet = geo_tags(1.0, 0.0, 1, &[[4099, 0, 1, 9002]]);
    assert_eq!(heights(&read("h.tif", &tiled_tiff(2, 2, &values, &feet), "")), [Some(305); 4]);
}

#[test]
fn heightmap_pixels_that_are_transparent_are_empty() {
    let grey = image::GrayAlphaImage::from_raw(4, 1, vec![9, 255, 8, 0, 7, 1, 6, 255]).unwrap();
    let (found, about) = told("h.png", &png(grey), "");
    assert_eq!(found, [Some(9), None, Some(7), Some(6)]);
    assert!(about.rule.contains("transparent pixels have no data"), "{about}");
    assert_eq!(about.left_out, ["the alpha of 1 pixels that are partly transparent"]);
    let wide = image::ImageBuffer::<image::LumaA<u16>, _>::from_raw(2, 1, vec![900, 65_535, 800, 0]).unwrap();
    assert_eq!(told("h.png", &png(wide), "--height-scale 1").0, [Some(900), None]);
    // Colours: their brightness, with a word.
    let colours = image::RgbaImage::from_raw(2, 1, vec![10, 10, 10, 255, 200, 10, 10, 0]).unwrap();
    let (found, about) = told("h.png", &png(colours), "");
    assert_eq!(found, [Some(10), None]);
    assert!(about.rule.contains("the brightness of colours is the height (--rgb"), "{about}");
    // A palette, one of whose colours is transparent.
    let mut palette = Vec::new();
    let mut encoder = png::Encoder::new(&mut palette, 4, 1);
    encoder.set_color(png::ColorType::Indexed);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_palette(vec![5, 5, 5, 9, 9, 9, 60, 60, 60]);
    encoder.set_trns(vec![255, 0]);
    encoder.write_header().unwrap().write_image_data(&[0, 1, 2, 0]).unwrap();
    assert_eq!(told("h.png", &palette, "").0, [Some(5), None, Some(60), Some(5)]);
}

#[test]
fn heights_in_colours_are_metres() {
    // 8,848.9 m, 0 m, black (no data), and 0 m that is transparent.
    let mapbox = vec![2, 224, 73, 255, 1, 134, 160, 255, 0, 0, 0, 255, 1, 134, 160, 0];
    let image = image::RgbaImage::from_raw(4, 1, mapbox).unwrap();
    let (found, about) = told("h.png", &png(image), "--rgb mapbox --height-scale 1");
    assert_eq!(found, [Some(8849), Some(0), None, None]);
    assert!(about.rule.contains("heights in colours (Mapbox)"), "{about}");
    // −1 m, 8,848.5 m: all is lifted by 1.
    let image = image::RgbImage::from_raw(2, 1, vec![127, 255, 0, 162, 144, 128]).unwrap();
    let (found, _) = told("h.png", &png(image.clone()), "--rgb terrarium --height-scale 1");
    assert_eq!(found, [Some(0), Some(8850)]);
    assert!(error("h.png", &png(image::GrayImage::new(1, 1)), "--rgb terrarium").contains("shades of grey"));
    let mut jpeg = std::io::Cursor::new(Vec::new());
    image::DynamicImage::ImageRgb8(image).write_to(&mut jpeg, image::ImageFormat::Jpeg).unwrap();
    assert!(error("h.jpg", jpeg.get_ref(), "--rgb terrarium").contains("JPEG changes the low bits"));
}

#[test]
fn heightmap_below_zero_is_lifted() {
    let (found, about) = told("h.tif", &tiled_tiff(2, 1, &[-5, 7], &geo_tags(1.0, 0.0, 1, &[])), "");
    assert_eq!(found, [0, 12].map(Some));
    assert!(about.rule.contains("lifted by 5"), "{about}");
    // A value that often stands for none is said to, and is none where one says so.
    let tiff = tiled_tiff(2, 1, &[-9999, 7], &geo_tags(1.0, 0.0, 1, &[]));
    assert!(told("h.tif", &tiff, "").1.rule.contains("(--nodata -9999)"));
    assert_eq!(told("h.tif", &tiff, "--nodata -9999").0, [None, Some(7)]);
}

#[test]
fn heightmap_refuses_damaged_images() {
    let tiff = tiled_tiff(3, 2, &[1, 2, 3, 4, 5, 6], &geo_tags(1.0, 0.0, 1, &[]));
    // The last four bytes point to a further image: none.
    refuses_every_prefix_but(4, "h.tif", &tiff, "");
    let (path, opts) = (Path::new("h.tif"), opts("--height-scale 0.001"));
    for at in 520..tiff.len() {
        for value in [0, 1, 0x7F, 0xFF] {
            let mut bytes = tiff.clone();
            bytes[at] = value;
            if let Ok(input) = super::read(path, &bytes, &opts) {
                assert_eq!(broken_promise(&input), None, "byte {at} = {value}");
            }
        }
    }

    let image = png(image::GrayImage::from_fn(9, 9, |x, y| image::Luma([(x * y * 7) as u8])));
    // IEND and the checksum before it hold nothing that is needed.
    refuses_every_prefix_but(16, "h.png", &image, "");
    survives_changed_bytes("h.png", &image, "");
    let mut huge = image;
    huge[16..24].copy_from_slice(&[0x7F, 0xFF, 0xFF, 0xFF, 0x7F, 0xFF, 0xFF, 0xFF]);
    // The header's checksum is checked first or the size is: either way before memory is asked for.
    error("h.png", &huge, "");
}

#[test]
fn image_that_claims_more_pixels_than_its_bytes_can_hold_is_refused() {
    // A whole header with its checksum, and no pixels.
    let mut bytes = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\x7f\0\0\0\x7f\0\0\0\x08\0\0\0\0".to_vec();
    let mut crc = flate2::Crc::new();
    crc.update(&bytes[12..29]);
    bytes.extend(crc.sum().to_be_bytes());
    bytes.extend(b"\0\0\0\0IDAT\x35\xaf\x06\x1e");
    let e = error("h.png", &bytes, "");
    assert!(e.contains("cannot hold"), "{e}");
}

// Voxlap.

/// A map with Voxlap's header, 2 × 2 columns.
fn vxl_file(columns: [&[u8]; 4]) -> Vec<u8> {
    let mut out = [vxl::MAGIC, 2, 2].map(u32::to_le_bytes).concat();
    out.resize(108, 0);
    out.extend(columns.concat());
    out
}

/// Top colours 10 ..= 11, two bottom colours 18 ..= 19, air from 20, then ground from 30 with one colour.
const BRIDGE: &[u8] = &[
    5, 10, 11, 0, 1, 0, 0, 9, 2, 0, 0, 9, 3, 0, 0, 9, 4, 0, 0, 9, //
    0, 30, 30, 20, 5, 6, 7, 9,
];
/// No top colours: E = S − 1.
const BARE: &[u8] = &[0, 40, 39, 0];
/// Solid to the top; E = 0.
const FULL: &[u8] = &[0, 0, 0, 0, 1, 2, 3, 9];
/// A span without top colours (N = 1) over air 50 ..= 59, then ground.
const GAP: &[u8] = &[1, 45, 44, 0, 0, 60, 60, 50, 8, 8, 8, 9];

#[test]
fn vxl_spans_become_runs_with_y_up() {
    let input = read("m.vxl", &vxl_file([BRIDGE, BARE, FULL, GAP]), "");
    let c = &input.columns;
    assert_eq!(c.dims(), [2, 256, 2]);
    assert_eq!(c.column(0, 0), [Run::new(0, 225), Run::new(236, 245)]);
    assert_eq!(c.column(1, 0), [Run::new(0, 215)]);
    assert_eq!(c.column(0, 1), [Run::new(0, 255)]);
    assert_eq!(c.column(1, 1), [Run::new(0, 195), Run::new(206, 210)]);
    let Colors::Voxel { offsets, entries } = &input.colors else { panic!("no colours") };
    assert_eq!(offsets, &[0, 5, 5, 6, 7]);
    // Bytes are B, G, R; z 30 is y 225.
    let bridge = [(225, [7, 6, 5]), (236, [0, 0, 4]), (237, [0, 0, 3]), (244, [0, 0, 2]), (245, [0, 0, 1])];
    assert_eq!(entries[..5], bridge);
}

#[test]
fn vxl_without_header_is_512_wide_and_as_deep_as_it_needs() {
    let plain = [0, 62, 62, 0, 1, 2, 3, 4].repeat(512 * 512);
    assert_eq!(read("m.vxl", &plain, "").columns.dims(), [512, 64, 512]);
    let mut deep = plain.clone();
    deep[1..3].copy_from_slice(&[64, 64]);
    let input = read("m.vxl", &deep, "");
    assert_eq!(input.columns.dims(), [512, 256, 512]);
    assert_eq!(input.columns.column(0, 0), [Run::new(0, 191)]);
    let e = error("m.vxl", &[plain.clone(), vec![0]].concat(), "");
    assert!(e.contains("byte 2097152") && e.contains("2097153 bytes"), "{e}");
    let e = error("m.vxl", &plain[..plain.len() - 1], "");
    assert!(e.contains("byte 2097144, column (511, 511)"), "{e}");
}

#[test]
fn vxl_refuses_spans_that_do_not_ascend() {
    let good = vxl_file([BRIDGE, BARE, FULL, GAP]);
    refuses_every_prefix("m.vxl", &good, "");
    survives_changed_bytes("m.vxl", &good, "");
    let with = |at: usize, value: u8| {
        let mut column = BRIDGE.to_vec();
        column[at] = value;
        error("m.vxl", &vxl_file([&column, BARE, FULL, GAP]), "")
    };
    let e = with(23, 13);
    assert!(e.contains("byte 128, column (0, 0)") && e.contains("start at 14"), "{e}");
    assert!(with(23, 31).contains("end at S"));
    assert!(with(2, 5).contains("E is above"));
    assert!(with(0, 2).contains("N leaves no room"));
    let mut huge = good;
    huge[4..12].fill(0xFF);
    let e = error("m.vxl", &huge, "");
    assert!(e.contains("4294967295 × 4294967295 columns"), "{e}");
}

// MagicaVoxel.

fn chunk(id: &str, content: &[u8]) -> Vec<u8> {
    [id.as_bytes(), &(content.len() as u32).to_le_bytes(), &[0; 4], content].concat()
}

fn vox_file(chunks: &[Vec<u8>]) -> Vec<u8> {
    let children = chunks.concat();
    [&b"VOX \x96\0\0\0MAIN\0\0\0\0"[..], &(children.len() as u32).to_le_bytes(), &children].concat()
}

fn words(w: &[u32]) -> Vec<u8> {
    w.iter().flat_map(|w| w.to_le_bytes()).collect()
}

fn model(size: [u32; 3], voxels: &[[u8; 4]]) -> Vec<u8> {
    let xyzi = [words(&[voxels.len() as u32]), voxels.concat()].concat();
    [chunk("SIZE", &words(&size)), chunk("XYZI", &xyzi)].concat()
}

fn dict(pairs: &[(&str, &str)]) -> Vec<u8> {
    let text = |s: &str| [words(&[s.len() as u32]), s.as_bytes().to_vec()].concat();
    let pairs = pairs.iter().map(|(k, v)| [text(k), text(v)].concat()).collect::<Vec<_>>();
    [words(&[pairs.len() as u32]), pairs.concat()].concat()
}

fn transform(id: u32, child: u32, layer: u32, attributes: &[(&str, &str)], frame: &[(&str, &str)]) -> Vec<u8> {
    chunk("nTRN", &[words(&[id]), dict(attributes), words(&[child, u32::MAX, layer, 1]), dict(frame)].concat())
}

fn group(id: u32, children: &[u32]) -> Vec<u8> {
    chunk("nGRP", &[words(&[id]), dict(&[]), words(&[children.len() as u32]), words(children)].concat())
}

fn shape(id: u32, model: u32) -> Vec<u8> {
    chunk("nSHP", &[words(&[id]), dict(&[]), words(&[1, model]), dict(&[])].concat())
}

/// Voxels of an input in MagicaVoxel's axes, relative to the low corner, with colours.
fn cells(input: &Input) -> Vec<([u32; 3], Rgb)> {
    let c = &input.columns;
    let Colors::Voxel { offsets, entries } = &input.colors else { panic!("no colours") };
    let mut out = Vec::new();
    for (ix, w) in offsets.windows(2).enumerate() {
        let (x, z) = (ix as u32 % c.nx(), ix as u32 / c.nx());
        out.extend(entries[w[0] as usize..w[1] as usize].iter().map(|&(y, c1)| ([x, c.nz() - 1 - z, y.into()], c1)));
    }
    assert_eq!(out.len() as u64, c.voxels());
    out.sort();
    out
}

/// Red, green, blue at palette entries 1 to 3.
fn palette() -> Vec<u8> {
    let mut p = vec![0u8; 1024];
    p[..12].copy_from_slice(&[255, 0, 0, 255, 0, 255, 0, 255, 0, 0, 255, 255]);
    chunk("RGBA", &p)
}

const R: Rgb = [255, 0, 0];
const G: Rgb = [0, 255, 0];
const B: Rgb = [0, 0, 255];

#[test]
fn vox_model_stands_on_its_z_axis() {
    let bytes = vox_file(&[model([4, 3, 2], &[[0, 0, 0, 1], [3, 0, 0, 2], [0, 2, 1, 3]]), palette()]);
    let input = read("m.vox", &bytes, "");
    assert_eq!(input.columns.dims(), [4, 2, 3]);
    assert_eq!(cells(&input), [([0, 0, 0], R), ([0, 2, 1], B), ([3, 0, 0], G)]);
    // Input (0, 0, 0) is world (0, 0, Y−1).
    assert!(input.columns.solid(0, 0, 2) && input.columns.solid(0, 1, 0));
    let two = [model([1, 1, 1], &[[0, 0, 0, 1]]), model([2, 2, 2], &[]), palette()];
    assert_eq!(read("m.vox", &vox_file(&two), "").columns.dims(), [1, 1, 1]);
}

/// A scene of one 4 × 3 × 2 model with voxels at (0,0,0), (3,0,0), (0,2,1), and a marker at the origin.
fn scene(frame: &[(&str, &str)]) -> Vec<(i64, i64, i64)> {
    let bytes = vox_file(&[
        model([4, 3, 2], &[[0, 0, 0, 1], [3, 0, 0, 1], [0, 2, 1, 1]]),
        model([17, 17, 17], &[[8, 8, 8, 3]]),
        transform(0, 1, u32::MAX, &[], &[]),
        group(1, &[2, 4]),
        transform(2, 3, 0, &[], frame),
        shape(3, 0),
        transform(4, 5, 0, &[], &[]),
        shape(5, 1),
        palette(),
    ]);
    let input = read("m.vox", &bytes, "");
    let cells = cells(&input);
    let origin = cells.iter().find(|c| c.1 == B).unwrap().0;
    let relative = |p: [u32; 3]| [0, 1, 2].map(|i| i64::from(p[i]) - i64::from(origin[i]));
    cells.iter().filter(|c| c.1 == R).map(|c| relative(c.0).into()).collect()
}

#[test]
fn vox_models_turn_about_half_their_size_rounded_down() {
    assert_eq!(scene(&[]), [(-2, -1, -1), (-2, 1, 0), (1, -1, -1)]);
    assert_eq!(scene(&[("_t", "1 -2 3")]), [(-1, -3, 2), (-1, -1, 3), (2, -3, 2)]);
    // 17: rows (0 1 0), (−1 0 0), (0 0 1) have bits 1, 0 << 2 and sign of row 1.
    assert_eq!(scene(&[("_r", "33")]), [(-1, -2, -1), (-1, 1, -1), (1, 1, 0)]);
    // x mirrored: cell −2 goes to 1.
    assert_eq!(scene(&[("_r", "20")]), [(-2, -1, -1), (1, -1, -1), (1, 1, 0)]);
}

#[test]
fn vox_rotations_compose_through_groups() {
    // A quarter turn twice is a half turn: x and y both mirrored.
    let file = |inner: &str, outer: &str| {
        vox_file(&[
            model([4, 3, 2], &[[0, 0, 0, 1], [3, 0, 0, 2], [0, 2, 1, 3]]),
            transform(0, 1, u32::MAX, &[], &[("_r", outer), ("_t", "5 6 7")]),
            group(1, &[2]),
            transform(2, 3, 0, &[], &[("_r", inner), ("_t", "1 0 0")]),
            shape(3, 0),
            palette(),
        ])
    };
    assert_eq!(cells(&read("m.vox", &file("33", "33"), "")), cells(&read("m.vox", &file("52", "4"), "")));
    assert_ne!(cells(&read("m.vox", &file("33", "33"), "")), cells(&read("m.vox", &file("4", "4"), "")));
}

#[test]
fn vox_hidden_nodes_and_layers_are_left_out_and_later_instances_show() {
    let layer =
        |id: u32, pairs: &[(&str, &str)]| chunk("LAYR", &[words(&[id]), dict(pairs), words(&[u32::MAX])].concat());
    let bytes = vox_file(&[
        model([1, 1, 1], &[[0, 0, 0, 1]]),
        model([1, 1, 1], &[[0, 0, 0, 2]]),
        model([1, 1, 1], &[[0, 0, 0, 3]]),
        // Numbers need not follow the order in the file.
        layer(7, &[("_hidden", "1")]),
        layer(0, &[]),
        shape(9, 0),
        transform(0, 1, u32::MAX, &[], &[]),
        group(1, &[2, 4, 6, 8]),
        transform(2, 9, 0, &[], &[]),
        transform(4, 5, 0, &[("_hidden", "1")], &[("_t", "5 0 0")]),
        shape(5, 2),
        transform(6, 5, 7, &[], &[("_t", "0 5 0")]),
        transform(8, 10, 0, &[], &[]),
        shape(10, 1),
        palette(),
    ]);
    assert_eq!(cells(&read("m.vox", &bytes, "")), [([0, 0, 0], G)]);
}

#[test]
fn vox_refuses_damaged_files_and_scenes_without_end() {
    let cube = model([2, 2, 2], &[[0, 0, 0, 1], [1, 1, 1, 2]]);
    let good = vox_file(&[
        cube.clone(),
        transform(0, 1, u32::MAX, &[], &[]),
        group(1, &[2]),
        transform(2, 3, 0, &[], &[("_r", "40"), ("_t", "-3 4 5")]),
        shape(3, 0),
        palette(),
    ]);
    refuses_every_prefix("m.vox", &good, "");
    survives_changed_bytes("m.vox", &good, "");
    let e = |chunks: &[Vec<u8>]| error("m.vox", &vox_file(chunks), "");
    assert!(e(&[]).contains("no visible model"));
    assert!(e(&[model([2, 2, 2], &[[0, 2, 0, 1]])]).contains("outside its size"));
    assert!(e(&[model([u32::MAX, 1, 1], &[])]).contains("1 to 256"));
    assert!(e(&[cube.clone(), transform(0, 0, 0, &[], &[])]).contains("inside itself"));
    assert!(e(&[cube.clone(), transform(0, 8, 0, &[], &[])]).contains("node 8 is named"));
    assert!(e(&[cube.clone(), transform(0, 1, 0, &[], &[]), shape(1, 3)]).contains("shows model 3"));
    assert!(e(&[cube.clone(), transform(0, 1, 0, &[], &[("_r", "5")]), shape(1, 0)]).contains("malformed"));
    assert!(e(&[cube.clone(), shape(0, 0), shape(0, 0)]).contains("repeats the number"));
    assert!(e(&[chunk("SIZE", &words(&[1, 1, 1])), chunk("XYZI", &words(&[u32::MAX]))]).contains("XYZI"));
    let far = [("_t", "2000000000 2000000000 0")];
    let scene = [transform(0, 1, 0, &[], &[]), group(1, &[2, 3]), transform(2, 3, 0, &[], &far), shape(3, 0)];
    assert!(e(&[&[cube.clone()][..], &scene].concat()).contains("columns"));
    // Thirty groups, each showing the next twice: a billion instances.
    let mut bomb = vec![cube, shape(30, 0)];
    bomb.extend((0..30).map(|i| group(i, &[i + 1, i + 1])));
    assert!(e(&bomb).contains("more than 1048576 nodes"));
    let mut nested = chunk("JUNK", &[]);
    for _ in 0..50_000 {
        nested = [&b"JUNK\0\0\0\0"[..], &(nested.len() as u32).to_le_bytes(), &nested].concat();
        if nested.len() > 4000 {
            break;
        }
    }
    assert!(e(&[nested]).contains("only MAIN may"));
}

// Kinds.

#[test]
fn kind_is_found_from_the_content_then_the_name() {
    let png = png(image::GrayImage::new(2, 2));
    assert_eq!(detect(Path::new("volume.raw"), &png).unwrap(), Format::Heightmap);
    assert_eq!(detect(Path::new("x"), b"NRRD0005\n").unwrap(), Format::Nrrd);
    assert_eq!(detect(Path::new("x"), b"VOX \x96\0\0\0").unwrap(), Format::Vox);
    assert_eq!(detect(Path::new("x"), &vxl::MAGIC.to_le_bytes()).unwrap(), Format::Vxl);
    assert_eq!(detect(Path::new("Map.VXL"), &[0; 64]).unwrap(), Format::Vxl);
    let nii = nifti_file([1, 1, 1], 2, [0.0; 2], &[1]);
    assert_eq!(detect(Path::new("x"), &nii).unwrap(), Format::Nifti);
    assert_eq!(detect(Path::new("x"), &gzip(&nii)).unwrap(), Format::Nifti);
    for (name, says) in [("a.raw", "--dims"), ("a.vox", "Slab6"), ("a.pcast", "already"), ("a.xyz", "supported: raw")] {
        let e = detect(Path::new(name), &[7; 64]).unwrap_err().to_string();
        assert!(e.contains(says), "{e}");
    }
    assert!(detect(Path::new("a.xyz"), &gzip(b"something else")).is_err());
    let unread: [(&str, &[u8], &str); 5] = [
        ("a.img", b"EHFA_HEADER_TAG\0", "gdal_translate"),
        ("a.nc", b"\x89HDF\r\n\x1a\n", "to_zarr"),
        ("a.webp", b"RIFF\0\0\0\0WEBPVP8 ", "save it as PNG"),
        ("a.hgt.zip", b"PK\x03\x04", "unpack it"),
        ("a.bil", &[0; 64], "gdal_translate"),
    ];
    for (name, head, says) in unread {
        let e = detect(Path::new(name), head).unwrap_err().to_string();
        assert!(e.contains("not read") && e.contains(says) || e.contains("zip archive; unpack it first"), "{e}");
    }
    assert!(detect(Path::new("a.npz"), b"PK\x03\x04").unwrap_err().to_string().contains("numpy.load"));
    assert!(detect(Path::new("a.xyz"), b"").unwrap_err().to_string().contains("empty"));
}

#[test]
fn kind_given_overrides_and_flags_without_use_are_noted() {
    let png = png(image::GrayImage::new(2, 2));
    let dims = format!("--format raw --dims {},1,1", png.len());
    assert_eq!(read("h.png", &png, &dims).columns.nx() as usize, png.len());
    let input = read("h.png", &png, "--up z --iso 3");
    assert!(input.notes.iter().any(|n| n.starts_with("--up is not used")), "{:?}", input.notes);
    assert!(error("h.png", &png, "--format vox").contains("expected \"VOX \""));
    for format in Format::value_variants() {
        let name = format.to_possible_value().unwrap().get_name().to_owned();
        if *format != Format::Raw {
            error("x", &[7; 300], &format!("--format {name}"));
        }
    }
}

#[test]
fn a_folder_and_a_missing_file_are_errors() {
    let dir = tempfile::tempdir().unwrap();
    let fails = |p: &Path| open(p, &ReadOptions::default()).err().unwrap().to_string();
    assert!(fails(dir.path()).contains("folder"));
    assert!(fails(&dir.path().join("none.png")).contains("cannot open"));
}

// Procedural scenes.

fn fingerprint(c: &Columns) -> u64 {
    let mut h = xxhash_rust::xxh3::Xxh3::new();
    h.update(bytemuck::cast_slice(&c.dims()));
    h.update(bytemuck::cast_slice(c.offsets()));
    h.update(bytemuck::cast_slice(c.runs()));
    h.digest()
}

/// The columns of a scene, all of them.
fn made(scene: Result<Box<dyn Pieces>>) -> Columns {
    pieces::whole(&*scene.unwrap()).unwrap().columns
}

#[test]
fn procedural_scenes_keep_their_promises_at_any_size() {
    for kind in Kind::value_variants() {
        for size in [1, 2, 7, 27, 81] {
            match procedural(*kind, size, 3) {
                Ok(input) => {
                    assert_eq!(broken_promise(&input), None, "{kind:?} {size}");
                    assert_eq!([input.columns.nx(), input.columns.nz()], [size; 2]);
                    let Colors::Function(color) = &input.colors else {
                        // All of a cloud is matter, whose classes have colours.
                        assert_eq!(*kind, Kind::Cloud);
                        continue;
                    };
                    let top = input.columns.column(0, 0).last().map_or(0, |r| r.last().into());
                    color(0, top, 0);
                }
                Err(e) => assert!(*kind == Kind::Menger && [2, 7].contains(&size), "{kind:?} {size}: {e}"),
            }
        }
    }
}

#[test]
fn procedural_scenes_depend_on_the_seed_and_nothing_else() {
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    for kind in
        [Kind::Terrain, Kind::Rocks, Kind::Hills, Kind::Mixing, Kind::Shapes, Kind::Scan, Kind::Serpent, Kind::City]
    {
        let a = made(procedural_pieces(kind, 64, 5));
        assert_eq!(a, one_thread.install(|| made(procedural_pieces(kind, 64, 5))), "{kind:?}");
        assert_ne!(a, made(procedural_pieces(kind, 64, 6)), "{kind:?}");
        assert_ne!(a, made(procedural_pieces(kind, 64, 5 + (1 << 32))), "{kind:?}: high half of the seed");
    }
}

#[test]
fn procedural_scenes_tile() {
    // Across the seam neighbouring columns differ about as much as anywhere else; a scene shifted against itself
    // (the planted fault) differs far more.
    for kind in [Kind::Terrain, Kind::Rocks, Kind::Mixing] {
        let c = made(procedural_pieces(kind, 128, 1));
        let differ = |a: &[Run], b: &[Run]| {
            let column = |runs: &[Run]| {
                (0..c.ny()).map(|y| runs.iter().any(|r| (r.first().into()..r.end()).contains(&y))).collect::<Vec<_>>()
            };
            column(a).iter().zip(column(b)).filter(|(a, b)| **a != *b).count()
        };
        let step = |x0: u32, x1: u32| (0..128).map(|z| differ(c.column(x0, z), c.column(x1, z))).sum::<usize>();
        let step_z = |z0: u32, z1: u32| (0..128).map(|x| differ(c.column(x, z0), c.column(x, z1))).sum::<usize>();
        let largest = (0..127).map(|i| step(i, i + 1).max(step_z(i, i + 1))).max().unwrap();
        assert!(step(127, 0) <= largest && step_z(127, 0) <= largest, "{kind:?}: {} over {largest}", step(127, 0));
        assert!(step(127, 64) > largest, "{kind:?}: the check sees nothing");
    }
}

#[test]
fn procedural_landscapes_have_what_height_maps_cannot_hold() {
    let c = made(procedural_pieces(Kind::Terrain, 256, 1));
    let several = c.offsets().windows(2).filter(|w| w[1] - w[0] > 1).count();
    assert!(several * 10 > 256 * 256, "{several} columns of several runs");
    // Nothing falls out of the world.
    assert!((0..256 * 256).all(|ix| c.runs()[c.range(ix)][0].first() == 0));
}

#[test]
fn menger_sponge_has_20_to_the_level_voxels_and_is_the_same_along_every_axis() {
    for level in 0..=4 {
        let c = made(from_name(&format!("menger?level={level}")));
        assert_eq!(c.voxels(), 20u64.pow(level));
    }
    let c = made(from_name("menger?level=3"));
    for (x, y, z) in (0..27 * 27 * 27).map(|i| (i % 27, i / 27 % 27, i / 729)) {
        let by_rule = (0..3).all(|p| [x, y, z].iter().filter(|&&v| v / 3i64.pow(p) % 3 == 1).count() < 2);
        assert_eq!(c.solid(x, y, z), by_rule, "({x}, {y}, {z})");
    }
}

#[test]
fn procedural_scenes_are_the_same_on_every_machine() {
    let prints =
        [("terrain?size=64&seed=1", TERRAIN), ("mixing?size=64&seed=1", MIXING), ("shapes?size=64&seed=1", SHAPES)];
    for (name, expected) in prints {
        assert_eq!(fingerprint(&made(from_name(name))), expected, "{name}");
    }
}

/// Fingerprints made on x86-64; a change of a scene's look changes them.
const TERRAIN: u64 = 0xAB51_51B5_C122_D8E7;
const MIXING: u64 = 0x8DA8_4B09_2074_3400;
const SHAPES: u64 = 0x5795_6F1B_8E09_CC93;

#[test]
fn procedural_names_are_checked() {
    let e = |name: &str| from_name(name).err().unwrap().to_string();
    assert!(e("dunes").contains("there is no scene \"dunes\""));
    assert!(e("terrain?size=x").contains("size=x is not a whole number"));
    assert!(e("terrain?level=3").contains("no parameter \"level\""));
    assert!(e("terrain?size").contains("has no value"));
    assert!(e("terrain?size=0").contains("from 1 to"));
    assert!(e("menger?level=99").contains("from 1 to 2187"));
    assert!(e("menger?size=28").contains("power of 3"));
    let through_open = open(Path::new("procedural:menger?level=1"), &ReadOptions::default()).unwrap();
    assert_eq!(through_open.columns.voxels(), 20);
}

// Pieces.

/// A volume whose values stay in its file gives the same columns as one in memory, whatever is asked of it at a time.
#[test]
fn pieces_of_a_volume_in_a_file_are_those_of_the_volume_in_memory() {
    let [nx, ny, nz] = [130, 70, 65];
    let voxel = |i: usize| {
        u8::from(hash(3, (i % nx / 3) as u32, (i / nx % ny / 5) as u32, (i / nx / ny / 4) as u32) >> 31 == 0)
    };
    let bytes: Vec<u8> = (0..nx * ny * nz).map(voxel).collect();
    let mut npy = npy_file("|u1", "True", "65, 70, 130", &[]);
    npy.extend(&bytes);
    let mut raw = b"NRRD0004\ntype: uchar\ndimension: 3\nsizes: 130 70 65\nencoding: gzip\n\n".to_vec();
    raw.extend(gzip(&bytes));
    for (name, bytes, flags) in [("v.raw", &bytes, "--dims 130,70,65"), ("v.npy", &npy, ""), ("v.nrrd", &raw, "")] {
        for up in ["x", "y", "z"] {
            let flags = format!("{flags} --up {up}");
            let in_memory = read(name, bytes, &flags).columns;
            let file = file(name, bytes);
            let pieces = open_pieces(&file.1, &opts(&flags)).unwrap();
            let [nx, _, nz] = pieces.dims();
            assert_eq!(pieces.dims(), in_memory.dims());
            for (xs, zs) in [(0..nx, 0..nz), (0..1, 0..nz), (7..nx - 3, 5..6), (nx - 1..nx, nz - 9..nz), (3..64, 9..33)]
            {
                let piece = pieces.piece(xs.clone(), zs.clone()).unwrap().columns;
                assert_eq!(piece, in_memory.crop(xs.clone(), zs.clone()), "{name} --up {up} {xs:?} {zs:?}");
            }
        }
    }
}

/// The values that are solid, found by looking at the ends and between, are just those that compare so.
#[test]
fn iso_values_are_met_by_every_value_of_small_types() {
    let all: Vec<u8> = (0..=255).collect();
    let wide: Vec<u8> = (i16::MIN..=i16::MAX).flat_map(i16::to_le_bytes).collect();
    for iso in [-40_000.0, -32_768.0, -200.5, -1.0, 0.0, 0.5, 1.0, 7.0, 127.5, 255.0, 255.5, 32_767.0, 1e9] {
        let solid = |bytes: &[u8], flags: &str| read("v.raw", bytes, &format!("{flags} --iso {iso}")).columns.voxels();
        let expected = (0..=255).filter(|&v| f64::from(v) >= iso).count() as u64;
        assert_eq!(solid(&all, "--dims 4,1,64"), expected, "u8 {iso}");
        let expected = (i16::MIN..=i16::MAX).filter(|&v| f64::from(v) >= iso).count() as u64;
        assert_eq!(solid(&wide, "--dims 256,1,256 --dtype i16"), expected, "i16 {iso}");
    }
}

// Meshes and points.

/// A square from (0, 0, 0) to (8, 8, 0) with a triangle that stands on it, in three forms of PLY.
fn ply(form: &str) -> Vec<u8> {
    let vertices = [[0.0, 0.0, 0.0], [8.0, 0.0, 0.0], [8.0, 8.0, 0.0], [0.0, 8.0, 0.0], [1.0, 1.0, 4.0]];
    let faces: [&[i32]; 2] = [&[0, 1, 2, 3], &[0, 2, 4]];
    let mut out = format!(
        "ply\nformat {form} 1.0\ncomment made for a test\nelement vertex 5\nproperty float x\nproperty double y\n\
         property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nelement face 2\n\
         property list uchar int vertex_indices\nend_header\n"
    )
    .into_bytes();
    let big = form == "binary_big_endian";
    let mut number = |text: String, little: &[u8]| match form {
        "ascii" => out.extend(format!("{text} ").bytes()),
        _ if big => out.extend(little.iter().rev()),
        _ => out.extend(little),
    };
    for (i, [x, y, z]) in vertices.into_iter().enumerate() {
        number(x.to_string(), &(x as f32).to_le_bytes());
        number(y.to_string(), &f64::to_le_bytes(y));
        number(z.to_string(), &(z as f32).to_le_bytes());
        [10 * i as u8, 20, 255].iter().for_each(|c| number(c.to_string(), &[*c]));
    }
    for face in faces {
        number(face.len().to_string(), &[face.len() as u8]);
        face.iter().for_each(|i| number(i.to_string(), &i.to_le_bytes()));
    }
    out
}

#[test]
fn ply_forms_give_the_same_mesh_and_damage_is_no_panic() {
    let text = read("m", &ply("ascii"), "--size 16");
    for form in ["binary_little_endian", "binary_big_endian"] {
        let bytes = ply(form);
        assert_eq!(read("m", &bytes, "--size 16").columns, text.columns, "{form}");
        assert_eq!(read("m.ply.gz", &gzip(&bytes), "--size 16").columns, text.columns, "{form}");
        refuses_every_prefix("m", &bytes, "--size 16");
        survives_changed_bytes("m", &bytes, "--size 16");
    }
    let crlf = String::from_utf8(ply("ascii")).unwrap().replace('\n', "\r\n");
    assert_eq!(read("m", crlf.as_bytes(), "--size 16").columns, text.columns);
    let Colors::Voxel { entries, .. } = &text.colors else { panic!("no colours") };
    assert!(entries.iter().all(|(_, [_, g, b])| (*g, *b) == (20, 255)), "colours of corners that agree are kept");
}

#[cfg(feature = "mesh")]
#[test]
fn mesh_voxels_are_those_that_a_triangle_touches() {
    // Against a triangle sampled far more finely than voxels: each sample's voxel is solid, and each solid voxel is near
    // a sample.
    let corners = [[0.0, 0.0, 0.0], [30.0, 11.0, 7.0], [4.0, 25.0, 19.0f64]];
    let mut obj = corners.map(|[x, y, z]| format!("v {x} {y} {z}\n")).concat();
    obj += "f 1 2 3\n";
    let c = read("t.obj", obj.as_bytes(), "--size 30").columns;
    assert_eq!(c.dims(), [30, 25, 19]);
    let n = 600;
    let mut touched = std::collections::HashSet::new();
    for (i, j) in (0..=n).flat_map(|i| (0..=n - i).map(move |j| (i, j))) {
        let (u, v) = (f64::from(i) / f64::from(n), f64::from(j) / f64::from(n));
        let p = [0, 1, 2].map(|a| u * corners[1][a] + v * corners[2][a]);
        let at = [0, 1, 2].map(|a| (p[a] as u32).min(c.dims()[a] - 1));
        let inside = (0..3).all(|a| (p[a] - p[a].round()).abs() > 1e-4);
        assert!(!inside || c.find(at[0], at[1], at[2]).is_some(), "{p:?}");
        touched.insert(at);
    }
    let solid = c.voxels();
    assert!(solid >= touched.len() as u64 && solid < touched.len() as u64 * 11 / 10, "{solid} {}", touched.len());
}

#[cfg(feature = "mesh")]
#[test]
fn mesh_formats_agree_and_pieces_are_cut_out_of_the_whole() {
    let obj = "v 0 0 0\nv 40 0 3\nv 5 33 300\nv 39 30 299\nf 1 2 3\nf 2 3 4\n";
    let whole = read("m.obj", obj.as_bytes(), "--size 300").columns;
    let stl = "solid m\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 40 0 3\nvertex 5 33 300\nendloop\nendfacet\n\
               facet normal 0 0 1\nouter loop\nvertex 40 0 3\nvertex 5 33 300\nvertex 39 30 299\nendloop\nendfacet\nendsolid m\n";
    assert_eq!(read("m.stl", stl.as_bytes(), "--size 300").columns, whole);
    let file = file("m.obj", obj.as_bytes());
    let pieces = open_pieces(&file.1, &opts("--size 300")).unwrap();
    for (xs, zs) in [(0..40, 0..300), (3..17, 31..65), (39..40, 299..300)] {
        assert_eq!(pieces.piece(xs.clone(), zs.clone()).unwrap().columns, whole.crop(xs, zs));
    }
    assert!(error("m.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "").contains("no faces"));
    assert!(error("m.obj", b"v 0 0 0\nv 1 0 nan\nv 0 1 0\nf 1 2 3\n", "").contains("finite"));
}

#[test]
fn points_without_faces_are_a_voxel_each() {
    let cloud = b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
                  end_header\n0 0 0\n2.5 1 0\n4 0 7.9\n";
    let c = read("p.ply", cloud, "--voxel 1").columns;
    assert_eq!((c.dims(), c.voxels()), ([5, 2, 8], 3));
    assert!([(0, 0, 0), (2, 1, 0), (4, 0, 7)].iter().all(|&(x, y, z)| c.solid(x, y, z)));
}

#[cfg(feature = "las")]
#[test]
fn las_points_stand_on_z_with_their_colours() {
    let mut builder = las::Builder::from((1, 2));
    builder.point_format = las::point::Format::new(2).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("p.las");
    let mut writer = las::Writer::from_path(&path, builder.into_header().unwrap()).unwrap();
    for (x, y, z, red) in [(0.0, 0.0, 0.0, 65_535), (3.0, 1.0, 9.0, 257)] {
        let color = Some(las::Color::new(red, 0, 0));
        writer.write_point(las::Point { x, y, z, color, ..Default::default() }).unwrap();
    }
    writer.close().unwrap();
    let input = open(&path, &opts("--voxel 1")).unwrap();
    assert_eq!((input.columns.dims(), input.columns.voxels()), ([4, 10, 2], 2));
    // North (y up in the file) is away: world z is 1 − y.
    assert!(input.columns.solid(0, 0, 1) && input.columns.solid(3, 9, 0));
    let Colors::Voxel { entries, .. } = input.colors else { panic!("no colours") };
    assert_eq!(entries, [(9, [1, 0, 0]), (0, [255, 0, 0])]);
    // Found by fuzzing: points of 64 KiB that are not there, asked for 65,536 at a time.
    let good = fs::read(&path).unwrap();
    let mut forged = good.clone();
    forged[105..107].copy_from_slice(&u16::MAX.to_le_bytes());
    fs::write(&path, &forged).unwrap();
    let text = open(&path, &opts("--voxel 1")).err().unwrap().to_string();
    assert!(
        text.contains("byte 105: LAS: 2 points of 65535 bytes in a file of") && text.contains("cut short"),
        "{text}"
    );
    // And a cloud of more voxels than u64 counts.
    forged = good.clone();
    forged[179..187].copy_from_slice(&1e300f64.to_le_bytes());
    fs::write(&path, &forged).unwrap();
    let text = open(&path, &opts("--voxel 1e-9")).err().unwrap().to_string();
    assert!(text.contains("columns, at most") || text.contains("voxels high"), "{text}");
    // And an extended record of 32 TiB, as version 1.4 has them.
    forged = good.clone();
    forged[25] = 4;
    forged.resize(500, 0);
    forged[235..243].copy_from_slice(&400u64.to_le_bytes());
    forged[243..247].copy_from_slice(&1u32.to_le_bytes());
    forged[420..428].copy_from_slice(&(1u64 << 45).to_le_bytes());
    fs::write(&path, &forged).unwrap();
    let text = open(&path, &opts("--voxel 1")).err().unwrap().to_string();
    assert!(text.contains("byte 400: LAS: extended record 0 of 1 claims 35184372088832 bytes of the 40"), "{text}");
    fs::write(&path, &good[..good.len() - 1]).unwrap();
    assert!(open(&path, &opts("--voxel 1")).err().unwrap().to_string().contains("LAS: "));
    fs::write(&path, b"LASF but no more").unwrap();
    assert!(open(&path, &opts("")).err().unwrap().to_string().contains("LAS: "));
}

#[test]
fn npy_of_two_axes_is_a_height_map() {
    let data = bytes_of((0..6i16).map(|v| (v * 2).to_le_bytes()).collect());
    let map = read("h.npy", &npy_file("<i2", "False", "2, 3", &data), "--height-scale 1");
    assert_eq!(heights(&map), [0, 2, 4, 6, 8, 10].map(Some));
    let turned = bytes_of([0, 3, 1, 4, 2, 5i16].map(|v| (v * 2).to_le_bytes()).to_vec());
    let map = read("h.npy", &npy_file("<i2", "True", "2, 3", &turned), "--height-scale 1");
    assert_eq!(heights(&map), [0, 2, 4, 6, 8, 10].map(Some));
}

#[test]
fn tiff_folders_are_stacks_by_number_or_mosaics_by_place() {
    let dir = tempfile::tempdir().unwrap();
    for (name, value) in [("s2.tif", 5), ("s10.tif", 0), ("s1.tif", 7)] {
        fs::write(dir.path().join(name), tiled_tiff(4, 3, &[value; 12], &[])).unwrap();
    }
    let stack = open(dir.path(), &opts("--iso 1")).unwrap().columns;
    assert_eq!((stack.dims(), stack.voxels()), ([4, 3, 3], 24));
    assert!(stack.solid(0, 0, 0) && stack.solid(3, 2, 1) && !stack.solid(0, 0, 2));
    fs::write(dir.path().join("s3.tif"), tiled_tiff(5, 3, &[1; 15], &[])).unwrap();
    assert!(open(dir.path(), &opts("--iso 1")).err().unwrap().to_string().contains("page 2 of the stack is"));

    const DOUBLE: u16 = 12;
    let doubles = |values: &[f64]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let dir = tempfile::tempdir().unwrap();
    for (name, x, y, value) in [("a.tif", 100.0, 50.0, 3), ("b.tif", 110.0, 45.0, 8)] {
        let geo = [(33_550, DOUBLE, doubles(&[2.5, 2.5, 0.0])), (33_922, DOUBLE, doubles(&[0.0, 0.0, 0.0, x, y, 0.0]))];
        fs::write(dir.path().join(name), tiled_tiff(4, 2, &[value; 8], &geo)).unwrap();
    }
    let map = open(dir.path(), &opts("--height-scale 1")).unwrap();
    assert_eq!([map.columns.nx(), map.columns.nz()], [8, 4]);
    let expected: Vec<Option<u16>> = (0..32)
        .map(|i| match (i % 8 / 4, i / 8 / 2) {
            (0, 0) => Some(3),
            (1, 1) => Some(8),
            _ => None,
        })
        .collect();
    assert_eq!(heights(&map), expected);
}

#[test]
fn nifti_pairs_are_read_from_both_files() {
    let dir = tempfile::tempdir().unwrap();
    let whole = nifti_file([70, 5, 9], 4, [0.0, 0.0], &bytes_of(values(|v| (v as i16).to_le_bytes())));
    let mut header = whole[..348].to_vec();
    header[344..348].copy_from_slice(b"ni1\0");
    header[108..112].copy_from_slice(&0f32.to_le_bytes());
    fs::write(dir.path().join("a.hdr"), header).unwrap();
    assert!(
        open(&dir.path().join("a.hdr"), &opts("--iso 20")).err().unwrap().to_string().contains("a.img: cannot open")
    );
    fs::write(dir.path().join("a.img"), &whole[352..]).unwrap();
    assert_volume(&open(&dir.path().join("a.hdr"), &opts("--iso 20")).unwrap(), Up::Y, |x, y, z| value(x, y, z) >= 20);
}

#[cfg(feature = "zarr")]
mod zarr_arrays {
    use super::*;
    use std::fs;
    use std::sync::Arc;
    use zarrs::array::{ArrayBuilder, data_type};
    use zarrs::filesystem::FilesystemStore;

    const N: u64 = 10;

    fn value(x: u64, y: u64, z: u64) -> u16 {
        (x * 100 + y * 10 + z) as u16
    }

    /// An array of shape (2, z, y, x) in chunks that do not divide it.
    fn write(folder: &Path) {
        let store = Arc::new(FilesystemStore::new(folder).unwrap());
        let array = ArrayBuilder::new(vec![2, N, N, N], vec![1, 4, 3, 6], data_type::uint16(), 0u16)
            .bytes_to_bytes_codecs(vec![Arc::new(zarrs::array::codec::GzipCodec::new(5).unwrap())])
            .build(store, "/")
            .unwrap();
        array.store_metadata().unwrap();
        let of = |i: u64| value(i % N, i / N % N, i / N / N);
        let values: Vec<u16> = (0..N * N * N).map(of).collect();
        array.store_array_subset(&[0..1, 0..N, 0..N, 0..N], &values).unwrap();
    }

    #[test]
    fn zarr_arrays_are_volumes_of_their_last_axes() {
        let dir = tempfile::tempdir().unwrap();
        write(dir.path());
        let input = open(dir.path(), &opts("--iso 555")).unwrap();
        assert_eq!(input.columns.dims(), [10, 10, 10]);
        for (x, y, z) in (0..N).flat_map(|x| (0..N).flat_map(move |y| (0..N).map(move |z| (x, y, z)))) {
            assert_eq!(input.columns.solid(x as i64, y as i64, z as i64), value(x, y, z) >= 555, "{x} {y} {z}");
        }
        let left_out = open_pieces(dir.path(), &opts("--iso 555")).unwrap().about().left_out;
        assert_eq!(left_out, ["1 of 2 places of axis 0: the first is read"]);
    }

    #[test]
    fn ome_zarr_images_are_their_finest_resolution() {
        let dir = tempfile::tempdir().unwrap();
        write(&dir.path().join("s0"));
        let image = |path: &str| {
            let text = format!(
                r#"{{"zarr_format": 3, "node_type": "group", "attributes": {{"ome": {{"version": "0.5",
                   "multiscales": [{{"datasets": [{{"path": {path:?}}}, {{"path": "s1"}}]}}]}}}}}}"#
            );
            fs::write(dir.path().join("zarr.json"), text).unwrap();
            open(dir.path(), &opts("--iso 555"))
        };
        assert_eq!(image("s0").unwrap().columns, open(&dir.path().join("s0"), &opts("--iso 555")).unwrap().columns);
        let refused = |path: &str| image(path).err().unwrap().to_string();
        assert!(refused("../s0").contains("expected a folder in it"));
        assert!(refused("s9").contains("neither zarr.json"));
    }

    #[test]
    fn zarr_metadata_that_claims_too_much_is_refused_before_anything_is_read() {
        let dir = tempfile::tempdir().unwrap();
        write(dir.path());
        let path = dir.path().join("zarr.json");
        let text = fs::read_to_string(&path).unwrap();
        let refused = |from: &str, to: &str| {
            let mut json: serde_json::Value = serde_json::from_str(&text).unwrap();
            *json.pointer_mut(from).unwrap() = serde_json::from_str(to).unwrap();
            fs::write(&path, json.to_string()).unwrap();
            open(dir.path(), &opts("--iso 1")).err().expect("refused").to_string()
        };
        assert!(refused("/shape", "[2, 1000000, 1000000, 1000000]").contains("voxels high"));
        assert!(
            refused("/chunk_grid/configuration/chunk_shape", "[1, 4000000, 4000000, 4000000]").contains("unpacked")
        );
        assert!(refused("/shape", "[1000, 1000]").contains("Zarr"));
        assert!(refused("/data_type", "\"complex64\"").contains("Zarr"));
        assert!(refused("/shape", "\"wide\"").contains("Zarr"));
    }
}

/// A binary glTF of one square, 2 × 2 in x and z at y = 0, whose node scales it by 4, lifts it by 3 and paints it.
#[cfg(feature = "mesh")]
fn glb(json_more: &str) -> Vec<u8> {
    let positions: [[f32; 3]; 4] = [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 0.0, 2.0], [0.0, 0.0, 2.0]];
    let indices: [u16; 6] = [0, 1, 2, 0, 2, 3];
    let mut bin = bytemuck::cast_slice(&positions).to_vec();
    bin.extend_from_slice(bytemuck::cast_slice(&indices));
    let mut json = format!(
        r#"{{"asset": {{"version": "2.0"}}, "scene": 0, "scenes": [{{"nodes": [0]}}],
        "nodes": [{{"children": [1], "translation": [0, 3, 0]}}, {{"mesh": 0, "scale": [4, 4, 4]}}],
        "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0}}, "indices": 1, "material": 0}}]}}],
        "materials": [{{"pbrMetallicRoughness": {{"baseColorFactor": [1, 0, 0.2159, 1]}}}}],
        "buffers": [{{"byteLength": {}}}],
        "bufferViews": [{{"buffer": 0, "byteLength": 48}}, {{"buffer": 0, "byteOffset": 48, "byteLength": 12}}],
        "accessors": [{{"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [0, 0, 0], "max": [2, 0, 2]}},
                      {{"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"}}]{json_more}}}"#,
        bin.len()
    )
    .into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut out = b"glTF".to_vec();
    let chunk = |kind: &[u8; 4], bytes: &[u8]| [&(bytes.len() as u32).to_le_bytes()[..], kind, bytes].concat();
    let chunks = [chunk(b"JSON", &json), chunk(b"BIN\0", &bin)].concat();
    out.extend_from_slice(&2u32.to_le_bytes());
    out.extend_from_slice(&(12 + chunks.len() as u32).to_le_bytes());
    out.extend_from_slice(&chunks);
    out
}

#[test]
#[cfg(feature = "mesh")]
fn gltf_meshes_stand_where_their_nodes_put_them_in_their_material() {
    let bytes = glb("");
    let input = read("square.glb", &bytes, "--voxel 1");
    let columns = &input.columns;
    // 8 × 8 units, in y one plane: as thin as a voxel can be.
    assert_eq!((columns.nx(), columns.nz()), (8, 8));
    assert!((0..8).all(|z| (0..8).all(|x| columns.column(x, z).len() == 1)), "{columns:?}");
    let scene = crate::build(input, &crate::BuildOptions::default()).unwrap();
    let color = |of: &[Rgb]| of.iter().all(|c| *c == [255, 0, 128]);
    assert!(color(&scene.levels[0].colors), "{:?}", &scene.levels[0].colors[..4]);
}

#[test]
#[cfg(feature = "mesh")]
fn gltf_that_is_broken_is_a_plain_error() {
    let whole = glb("");
    for n in 0..whole.len() {
        assert!(super::read(Path::new("cut.glb"), &whole[..n], &opts("--voxel 1")).is_err(), "cut at {n}");
    }
    let index = |to: &str| {
        let from = b"\"count\": 6";
        let at = whole.windows(from.len()).position(|text| text == from).unwrap();
        let mut bytes = whole.clone();
        bytes[at..at + from.len()].copy_from_slice(to.as_bytes());
        super::read(Path::new("wrong.glb"), &bytes, &opts("--voxel 1"))
    };
    assert!(index("\"count\": 6").is_ok());
    assert!(index("\"count\": 9").is_err());
    // Indices beyond the points.
    let mut bytes = whole.clone();
    let last = bytes.len() - 2;
    bytes[last..].copy_from_slice(&9u16.to_le_bytes());
    assert!(super::read(Path::new("wrong.glb"), &bytes, &opts("--voxel 1")).is_err());
}

/// A picture of 8 × 8 pixels that all differ, and its bytes as PNG.
#[cfg(feature = "mesh")]
fn picture() -> (image::RgbImage, Vec<u8>) {
    let picture =
        image::RgbImage::from_fn(8, 8, |x, z| image::Rgb([30 * x as u8, 255 - 20 * z as u8, 9 * (x + z) as u8]));
    let mut png = std::io::Cursor::new(Vec::new());
    picture.write_to(&mut png, image::ImageFormat::Png).unwrap();
    (picture, png.into_inner())
}

/// Colours of a flat world of 8 × 8 columns, as a picture.
#[cfg(feature = "mesh")]
fn seen_from_above(path: &Path) -> image::RgbImage {
    let input = open(path, &opts("--voxel 1")).unwrap();
    assert_eq!((input.columns.nx(), input.columns.nz()), (8, 8), "{:?}", input.notes);
    let scene = crate::build(input, &crate::BuildOptions::default()).unwrap();
    image::RgbImage::from_fn(8, 8, |x, z| image::Rgb(scene.levels[0].colors[(8 * z + x) as usize]))
}

#[test]
#[cfg(feature = "mesh")]
fn obj_textures_are_seen_from_above_as_they_are() {
    let dir = tempfile::tempdir().unwrap();
    let (picture, png) = picture();
    fs::write(dir.path().join("a picture.png"), png).unwrap();
    // Four triangles about a point whose edges pass no corner of a voxel.
    let obj = "mtllib m.mtl\nv 0 0 0\nv 8 0 0\nv 8 0 8\nv 0 0 8\nv 3.1 0 4.7\nvt 0 1\nvt 1 1\nvt 1 0\nvt 0 0\nvt 0.3875 0.4125\n\
               usemtl m\nf 1/1 2/2 5/5\nf 2/2 3/3 5/5\nf 3/3 4/4 5/5\nf 4/4 1/1 5/5\n";
    fs::write(dir.path().join("m.obj"), obj).unwrap();
    let with = |mtl: &str| {
        fs::write(dir.path().join("m.mtl"), format!("newmtl m\n{mtl}\n")).unwrap();
        seen_from_above(&dir.path().join("m.obj"))
    };
    assert_eq!(with("map_Kd a picture.png"), picture);
    assert_eq!(with("Kd 0 0 0\nmap_Kd a picture.png"), picture);
    let red = with("Kd 1 0 0\nmap_Kd a picture.png");
    assert!(red.enumerate_pixels().all(|(x, z, p)| p.0 == [picture.get_pixel(x, z).0[0], 0, 0]));
    // A picture that is not there leaves the rest.
    assert!(with("Kd 1 0 0\nmap_Kd none.png").pixels().all(|p| p.0 == [255, 0, 0]));
    let said = open_pieces(&dir.path().join("m.obj"), &opts("--voxel 1")).unwrap().about().left_out;
    assert!(said.iter().any(|n| n.contains("a texture is left out") && n.contains("none.png")), "{said:?}");
}

#[test]
#[cfg(feature = "mesh")]
fn gltf_textures_are_read_from_buffers_and_files_and_tinted() {
    let dir = tempfile::tempdir().unwrap();
    let (picture, png) = picture();
    let corners: [[f32; 3]; 5] = [[0.0, 0.0, 0.0], [8.0, 0.0, 0.0], [8.0, 0.0, 8.0], [0.0, 0.0, 8.0], [3.1, 0.0, 4.7]];
    // A picture further on, which comes to the same where it repeats.
    let uvs: [[f32; 2]; 5] = [[2.0, -1.0], [3.0, -1.0], [3.0, 0.0], [2.0, 0.0], [2.3875, -0.4125]];
    let mut bin = [bytemuck::cast_slice(&corners), bytemuck::cast_slice(&uvs)].concat();
    bin.extend_from_slice(bytemuck::cast_slice(&[0u16, 1, 4, 1, 2, 4, 2, 3, 4, 3, 0, 4]));
    bin.extend_from_slice(&png);
    fs::write(dir.path().join("m.bin"), &bin).unwrap();
    fs::write(dir.path().join("p.png"), &png).unwrap();
    let with = |image: &str, factor: &str| {
        let json = format!(
            r#"{{"asset": {{"version": "2.0"}}, "scene": 0, "scenes": [{{"nodes": [0]}}], "nodes": [{{"mesh": 0}}],
            "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0, "TEXCOORD_0": 1}}, "indices": 2, "material": 0}}]}}],
            "materials": [{{"pbrMetallicRoughness": {{"baseColorTexture": {{"index": 0}}, "baseColorFactor": {factor}}}}}],
            "textures": [{{"source": 0}}], "images": [{image}],
            "buffers": [{{"byteLength": {}, "uri": "m.bin"}}],
            "bufferViews": [{{"buffer": 0, "byteLength": 60}}, {{"buffer": 0, "byteOffset": 60, "byteLength": 40}},
                            {{"buffer": 0, "byteOffset": 100, "byteLength": 24}}, {{"buffer": 0, "byteOffset": 124, "byteLength": {}}}],
            "accessors": [{{"bufferView": 0, "componentType": 5126, "count": 5, "type": "VEC3", "min": [0, 0, 0], "max": [8, 0, 8]}},
                          {{"bufferView": 1, "componentType": 5126, "count": 5, "type": "VEC2"}},
                          {{"bufferView": 2, "componentType": 5123, "count": 12, "type": "SCALAR"}}]}}"#,
            bin.len(),
            png.len()
        );
        fs::write(dir.path().join("m.gltf"), json).unwrap();
        seen_from_above(&dir.path().join("m.gltf"))
    };
    let in_buffer = r#"{"bufferView": 3, "mimeType": "image/png"}"#;
    assert_eq!(with(in_buffer, "[1, 1, 1, 1]"), picture);
    assert_eq!(with(r#"{"uri": "p.png"}"#, "[1, 1, 1, 1]"), picture);
    let red = with(in_buffer, "[1, 0, 0, 1]");
    assert!(red.enumerate_pixels().all(|(x, z, p)| p.0 == [picture.get_pixel(x, z).0[0], 0, 0]));
    assert!(with(r#"{"uri": "none.png"}"#, "[1, 0, 0, 1]").pixels().all(|p| p.0 == [255, 0, 0]));
}

/// Otherwise these would be read until memory ends.
#[test]
#[cfg(all(feature = "mesh", unix))]
fn meshes_that_name_devices_do_not_have_them_read() {
    let dir = tempfile::tempdir().unwrap();
    let notes = |name: &str, text: &[u8]| {
        fs::write(dir.path().join(name), text).unwrap();
        open_pieces(&dir.path().join(name), &opts("--voxel 1")).map(|pieces| pieces.about().left_out.join("\n"))
    };
    let square = "v 0 0 0\nv 8 0 0\nv 8 0 8\nvt 0 1\nusemtl m\nf 1/1 2/1 3/1\n";
    let of_obj = |library: &str| notes("m.obj", format!("mtllib {library}\n{square}").as_bytes()).unwrap();
    assert!(of_obj("/dev/zero").contains("materials are left out"));
    fs::write(dir.path().join("m.mtl"), "newmtl m\nmap_Kd /dev/zero\n").unwrap();
    let said = "/dev/zero: this is a device or a pipe; expected a file";
    assert!(of_obj("m.mtl").contains(said));

    let of_gltf = |buffer: &str, image: &str| {
        let json = format!(
            r#"{{"asset": {{"version": "2.0"}}, "scene": 0, "scenes": [{{"nodes": [0]}}], "nodes": [{{"mesh": 0}}],
            "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0, "TEXCOORD_0": 1}}, "material": 0}}]}}],
            "materials": [{{"pbrMetallicRoughness": {{"baseColorTexture": {{"index": 0}}}}}}],
            "textures": [{{"source": 0}}], "images": [{{"uri": "{image}"}}],
            "buffers": [{{"byteLength": 60, "uri": "{buffer}"}}],
            "bufferViews": [{{"buffer": 0, "byteLength": 36}}, {{"buffer": 0, "byteOffset": 36, "byteLength": 24}}],
            "accessors": [{{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [8, 0, 8]}},
                          {{"bufferView": 1, "componentType": 5126, "count": 3, "type": "VEC2"}}]}}"#
        );
        notes("m.gltf", json.as_bytes())
    };
    let corners: [[f32; 3]; 5] = [[0.0; 3], [8.0, 0.0, 0.0], [8.0, 0.0, 8.0], [0.0; 3], [0.0; 3]];
    fs::write(dir.path().join("a b.bin"), bytemuck::cast_slice(&corners)).unwrap();
    for zero in ["/dev/zero", "file:///dev/zero", "file:/dev/zero", "%2Fdev/%7aero"] {
        assert!(of_gltf("a%20b.bin", zero).unwrap().contains(said), "{zero}");
        assert!(of_gltf(zero, "none.png").unwrap_err().to_string().contains(said), "{zero}");
    }
    assert!(of_gltf("a%20b.bin", "none.png").unwrap().contains("none.png"));
}

#[test]
fn openvdb_is_refused_with_what_to_do() {
    let text = error("cloud.vdb", b" BDV\0\0\0\0\xde\0\0\0", "");
    assert!(text.ends_with("OpenVDB is not read; write the grid as a dense NPY, NRRD or Zarr volume"), "{text}");
}
