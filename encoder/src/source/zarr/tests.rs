//! Arrays written here as JSON and one plain chunk, as the format's text has them.

use std::fs;
use std::path::Path;

use serde_json::{Value, json};

use super::super::tests::opts;
use super::super::{open, open_pieces};
use super::{Axis, base64_f64, quoted, xyz};
use crate::{About, Input};

const N: [usize; 3] = [5, 4, 3];

fn value(x: usize, y: usize, z: usize) -> u8 {
    if (x * 3 + y * 5 + z * 7 + x * y * z).is_multiple_of(3) { 0 } else { (1 + x + 10 * y + 50 * z) as u8 }
}

fn write(folder: &Path, name: &str, value: &Value) {
    fs::create_dir_all(folder).unwrap();
    fs::write(folder.join(name), value.to_string()).unwrap();
}

/// A version 2 array of bytes in one chunk: `order` names its axes, "c" and "t" have two places, the second all solid.
fn v2(folder: &Path, order: &str, dtype: &str, more: Value) {
    let shape: Vec<usize> = order.chars().map(size).collect();
    let metadata = json!({"zarr_format": 2, "shape": shape, "chunks": shape, "dtype": dtype, "compressor": null,
        "fill_value": more.get("fill_value").cloned().unwrap_or(Value::Null), "order": "C", "filters": null});
    write(folder, ".zarray", &metadata);
    if let Some(attributes) = more.get("attributes") {
        write(folder, ".zattrs", attributes);
    }
    fs::write(folder.join(vec!["0"; shape.len()].join(".")), chunk(order)).unwrap();
}

fn size(axis: char) -> usize {
    match axis {
        'x' => N[0],
        'y' => N[1],
        'z' => N[2],
        _ => 2,
    }
}

fn chunk(order: &str) -> Vec<u8> {
    let shape: Vec<usize> = order.chars().map(size).collect();
    let n: usize = shape.iter().product();
    let of = |mut i: usize| {
        let (mut at, mut other) = ([0; 3], 0);
        for (axis, n) in order.chars().rev().zip(shape.iter().rev()) {
            match "xyz".find(axis) {
                Some(k) => at[k] = i % n,
                None => other += i % n,
            }
            i /= n;
        }
        if other > 0 { 255 } else { value(at[0], at[1], at[2]) }
    };
    (0..n).map(of).collect()
}

fn image(folder: &Path, version: &str, axes: Value, scale: Option<Value>) {
    let mut dataset = json!({"path": "0"});
    if let Some(scale) = scale {
        dataset["coordinateTransformations"] = json!([{"type": "scale", "scale": scale}]);
    }
    write(folder, ".zgroup", &json!({"zarr_format": 2}));
    let mut scales = json!({"version": version, "datasets": [dataset]});
    if !axes.is_null() {
        scales["axes"] = axes;
    }
    write(folder, ".zattrs", &json!({"multiscales": [scales]}));
}

fn ome_axes(order: &str) -> Value {
    let kind = |c| match c {
        'c' => "channel",
        't' => "time",
        _ => "space",
    };
    order.chars().map(|c| json!({"name": c.to_string(), "type": kind(c), "unit": "micrometer"})).collect()
}

fn read(folder: &Path, flags: &str) -> (Input, About) {
    let pieces = open_pieces(folder, &opts(flags)).unwrap();
    (crate::model::pieces::whole(&*pieces).unwrap(), pieces.about())
}

fn assert_volume(input: &Input, nz: usize, solid: impl Fn(u8) -> bool) {
    assert_eq!(input.columns.dims(), [N[0] as u32, N[1] as u32, nz as u32]);
    for (x, y, z) in (0..N[0]).flat_map(|x| (0..N[1]).flat_map(move |y| (0..nz).map(move |z| (x, y, z)))) {
        assert_eq!(input.columns.solid(x as i64, y as i64, z as i64), solid(value(x, y, z)), "{x} {y} {z}");
    }
}

#[test]
fn axes_of_an_image_are_where_it_says() {
    let dir = tempfile::tempdir().unwrap();
    let cases = [
        ("zyx", 3, None),
        ("xyz", 3, None),
        ("yxz", 3, None),
        ("czyx", 3, Some("1 of 2 channels: the first is read")),
        ("xyzc", 3, Some("1 of 2 channels: the first is read")),
        ("tzyx", 3, Some("1 of 2 times: the first is read")),
        ("cyx", 1, Some("1 of 2 channels: the first is read")),
        ("tyx", 1, Some("1 of 2 times: the first is read")),
    ];
    for (order, nz, said) in cases {
        let folder = dir.path().join(order);
        image(&folder, "0.4", ome_axes(order), None);
        v2(&folder.join("0"), order, "|u1", json!({}));
        let (input, about) = read(&folder, "");
        assert_volume(&input, nz, |v| v > 0);
        assert_eq!(about.left_out.first().map(String::as_str), said, "{order}");
        assert_eq!(about.format, "OME-Zarr 0.4");
        // The array alone is still the image's.
        assert_eq!(read(&folder.join("0"), "").0.columns, input.columns);
    }
    // Version 0.3 has names alone, before it there are none.
    let folder = dir.path().join("names");
    image(&folder, "0.3", json!(["x", "y", "z"]), None);
    v2(&folder.join("0"), "xyz", "|u1", json!({}));
    assert_volume(&read(&folder, "").0, 3, |v| v > 0);
    let folder = dir.path().join("none");
    image(&folder, "0.2", Value::Null, None);
    v2(&folder.join("0"), "tczyx", "|u1", json!({}));
    let (input, about) = read(&folder, "");
    assert_volume(&input, 3, |v| v > 0);
    assert_eq!(about.left_out.len(), 2, "{:?}", about.left_out);
}

#[test]
fn names_of_dimensions_say_which_axis_is_which() {
    let dir = tempfile::tempdir().unwrap();
    let v3 = |name: &str, order: &str, names: Value| {
        let shape: Vec<usize> = order.chars().map(size).collect();
        let metadata = json!({"zarr_format": 3, "node_type": "array", "shape": shape, "data_type": "uint8",
            "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": shape}},
            "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
            "fill_value": 0, "codecs": [{"name": "bytes"}], "dimension_names": names});
        let folder = dir.path().join(name);
        write(&folder, "zarr.json", &metadata);
        let chunk_at = folder.join("c").join(vec!["0"; shape.len()].join("/"));
        fs::create_dir_all(chunk_at.parent().unwrap()).unwrap();
        fs::write(chunk_at, chunk(order)).unwrap();
        folder
    };
    assert_volume(&read(&v3("a", "xyz", json!(["x", "y", "z"])), "").0, 3, |v| v > 0);
    assert_volume(&read(&v3("b", "zyx", json!(["level", "lat", "lon"])), "").0, 3, |v| v > 0);
    assert_volume(&read(&v3("c", "yxz", json!(["height", "width", "depth"])), "").0, 3, |v| v > 0);
    assert_volume(&read(&v3("d", "zyx", json!(["height", "y", "x"])), "").0, 3, |v| v > 0);
    let (input, about) = read(&v3("e", "tyx", json!(["time", "y", "x"])), "");
    assert_volume(&input, 1, |v| v > 0);
    assert_eq!(about.left_out, ["1 of 2 times: the first is read"]);
    // Without names, the last three.
    let (input, about) = read(&v3("f", "czyx", Value::Null), "");
    assert_volume(&input, 3, |v| v > 0);
    assert_eq!(about.left_out, ["1 of 2 places of axis 0: the first is read"]);
    let folder = dir.path().join("xarray");
    v2(&folder, "xyz", "|u1", json!({"attributes": {"_ARRAY_DIMENSIONS": ["x", "y", "z"]}}));
    assert_volume(&read(&folder, "").0, 3, |v| v > 0);
    let e = open(&v3("g", "tcy", json!(["time", "channel", "y"])), &opts("")).err().unwrap().to_string();
    assert!(e.contains("expected x and y among them"), "{e}");
    let named = |names: &[&str]| {
        xyz(&names.iter().map(|n| Axis { name: (*n).to_owned(), ..Axis::default() }).collect::<Vec<_>>())
    };
    assert_eq!(named(&["p", "q", "r"]), [Some(2), Some(1), Some(0)]);
    assert_eq!(named(&["x", "q", "r"]), [Some(0), Some(2), Some(1)]);
    assert_eq!(named(&["plane", "y", "x", "band"]), [Some(2), Some(1), Some(0)]);
}

#[test]
fn sides_of_voxels_are_said() {
    let dir = tempfile::tempdir().unwrap();
    image(dir.path(), "0.4", ome_axes("xyz"), Some(json!([0.25, 0.5, 2.0])));
    v2(&dir.path().join("0"), "xyz", "|u1", json!({}));
    let about = read(dir.path(), "--spacing as-is").1;
    assert_eq!((about.voxel, about.unit.as_str()), (Some([0.25, 0.5, 2.0]), "µm"));
    assert_eq!(read(dir.path(), "--up z --spacing as-is").1.voxel, Some([0.25, 2.0, 0.5]));
    let mut mixed = ome_axes("xyz");
    mixed[2]["unit"] = json!("nanometer");
    image(dir.path(), "0.4", mixed, Some(json!([0.25, 0.5, 2000.0])));
    let about = read(dir.path(), "--spacing as-is").1;
    assert_eq!((about.voxel, about.unit.as_str()), (Some([0.25, 0.5, 2.0]), "µm"));
}

#[test]
fn attributes_say_what_values_mean() {
    let dir = tempfile::tempdir().unwrap();
    let mut n = 0;
    let mut with = |dtype: &str, attributes: Value, fill: Value| {
        n += 1;
        let folder = dir.path().join(n.to_string());
        v2(&folder, "zyx", dtype, json!({"attributes": attributes, "fill_value": fill}));
        folder
    };
    let scaled = with("|u1", json!({"scale_factor": 0.5, "add_offset": -10.0, "units": "K"}), Value::Null);
    let (input, about) = read(&scaled, "--iso 3");
    assert_volume(&input, 3, |v| f64::from(v) * 0.5 - 10.0 >= 3.0);
    assert!(about.rule.contains("stored · 0.5 + -10, in K"), "{}", about.rule);
    // Without --iso, what is above 0 as it is meant.
    assert_volume(&read(&scaled, "").0, 3, |v| f64::from(v) * 0.5 - 10.0 > 0.0);
    let (input, about) = read(&with("|u1", json!({"_FillValue": 13}), Value::Null), "--iso 1");
    assert_volume(&input, 3, |v| v >= 1 && v != 13);
    assert!(about.rule.contains("stored 13 is air"), "{}", about.rule);
    assert_volume(&read(&with("|i1", json!({"_Unsigned": "true"}), Value::Null), "--iso 100").0, 3, |v| v >= 100);
    // Version 2 of xarray: the array's own filling, which means nothing elsewhere.
    let dims = json!({"_ARRAY_DIMENSIONS": ["z", "y", "x"]});
    assert_volume(&read(&with("|u1", dims, json!(0)), "--iso 0").0, 3, |v| v > 0);
    assert_volume(&read(&with("|u1", json!({}), json!(0)), "--iso 0").0, 3, |_| true);
    assert_volume(&read(&with("|b1", json!({}), json!(false)), "").0, 3, |v| v > 0);
    let about = read(&with("|u1", json!({"valid_max": 50}), Value::Null), "").1;
    assert!(about.left_out.iter().any(|l| l.contains("valid_max 50")), "{:?}", about.left_out);
    // As Python's struct and base64 have it.
    assert_eq!(base64_f64("AAAAAACAWMA="), Some(-98.0));
    assert!(base64_f64("AAAAAAAA+H8=").unwrap().is_nan());
    assert_eq!(
        quoted(r#"{"a": NaN, "b": "NaN\"NaN", "c": [-Infinity]}"#),
        r#"{"a": "NaN", "b": "NaN\"NaN", "c": ["-Infinity"]}"#
    );
}

#[test]
fn groups_that_are_no_images_give_their_only_volume() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), ".zgroup", &json!({"zarr_format": 2}));
    let refused = |path: &Path| open(path, &opts("")).err().unwrap().to_string();
    assert!(refused(dir.path()).contains("name an array's folder"));
    v2(&dir.path().join("v"), "zyx", "|u1", json!({"attributes": {"_ARRAY_DIMENSIONS": ["z", "y", "x"]}}));
    assert_volume(&read(dir.path(), "").0, 3, |v| v > 0);
    v2(&dir.path().join("w"), "zyx", "|u1", json!({}));
    assert!(refused(dir.path()).contains("name one of them: v, w"));
    // Coordinates beside the array tell the sides of its voxels.
    for (name, n, step) in [("x", N[0], 0.5f64), ("y", N[1], 0.25), ("z", N[2], -2.0)] {
        let folder = dir.path().join(name);
        let metadata = json!({"zarr_format": 2, "shape": [n], "chunks": [n], "dtype": "<f8", "compressor": null,
            "fill_value": null, "order": "C", "filters": null});
        write(&folder, ".zarray", &metadata);
        write(&folder, ".zattrs", &json!({"units": "m"}));
        let values: Vec<u8> = (0..n).flat_map(|i| (i as f64 * step + 7.0).to_le_bytes()).collect();
        fs::write(folder.join("0"), values).unwrap();
    }
    let about = read(&dir.path().join("v"), "--spacing as-is").1;
    assert_eq!((about.voxel, about.unit.as_str()), (Some([0.5, 0.25, 2.0]), "m"));
    write(dir.path(), ".zattrs", &json!({"plate": {}}));
    assert!(refused(dir.path()).contains("a plate of wells"));
}

/// An image of two resolutions, in chunks smaller than it.
fn pyramid(folder: &Path, sides: [usize; 2]) {
    let datasets: Vec<Value> = (0..2).map(|i| json!({"path": i.to_string()})).collect();
    let axes = ome_axes("zyx");
    write(folder, ".zgroup", &json!({"zarr_format": 2}));
    write(folder, ".zattrs", &json!({"multiscales": [{"version": "0.4", "datasets": datasets, "axes": axes}]}));
    for (i, n) in sides.into_iter().enumerate() {
        let folder = folder.join(i.to_string());
        let (chunk, ny) = (100, [3, 2][i]);
        let metadata = json!({"zarr_format": 2, "shape": [n, ny, n], "chunks": [chunk, 2, chunk], "dtype": "|u1", "compressor": null,
            "fill_value": 0, "order": "C", "filters": null});
        write(&folder, ".zarray", &metadata);
        for (cz, cy, cx) in (0..n.div_ceil(chunk))
            .flat_map(|z| (0..2).flat_map(move |y| (0..n.div_ceil(chunk)).map(move |x| (z, y, x))))
        {
            let at = |c: usize, k: usize, size: usize| c * size + k;
            let values = (0..chunk * 2 * chunk).map(|k| {
                let (z, y, x) = (at(cz, k / (2 * chunk), chunk), at(cy, k / chunk % 2, 2), at(cx, k % chunk, chunk));
                ((x * 7 + y * 31 + z * 13) % 101) as u8
            });
            fs::write(folder.join(format!("{cz}.{cy}.{cx}")), values.collect::<Vec<u8>>()).unwrap();
        }
    }
}

#[test]
fn tiles_of_an_image_are_those_of_the_array_read_whole() {
    use crate::model::tiles::TileKey;
    use crate::source::tiles;
    let dir = tempfile::tempdir().unwrap();
    pyramid(dir.path(), [301, 150]);
    for flags in ["--iso 60 --spacing as-is", "--iso 60 --spacing as-is --up z"] {
        let world = tiles::open(dir.path(), &opts(flags)).unwrap().unwrap();
        let up_z = flags.contains("up z");
        assert_eq!(world.dims(), if up_z { [301, 301, 3] } else { [301, 3, 301] });
        for (level, side) in [(0u32, 301u32), (1, 150)] {
            let whole = open_pieces(&dir.path().join(level.to_string()), &opts(flags)).unwrap();
            let whole = crate::model::pieces::whole(&*whole).unwrap().columns;
            let [nx, nz] = [0, 2].map(|i| world.dims()[i].div_ceil(1 << level));
            for (x, z) in (0..nz.div_ceil(256)).flat_map(|z| (0..nx.div_ceil(256)).map(move |x| (x, z))) {
                let tile = world.tile(TileKey { level, x, z }).unwrap().solid;
                for (i, j) in (0..tile.nz()).flat_map(|j| (0..tile.nx()).map(move |i| (i, j))) {
                    let (x, z) = (x * 256 + i, z * 256 + j);
                    let expected = if x < side && z < whole.nz() { whole.column(x, z) } else { &[] };
                    assert_eq!(tile.column(i, j), expected, "level {level}, ({x}, {z})");
                }
            }
        }
        let last = world.tile(TileKey { level: world.levels() - 1, x: 0, z: 0 }).unwrap();
        assert_eq!((last.solid.nx(), last.solid.nz()), (1, 1));
    }
    assert!(tiles::open(dir.path(), &opts("--spacing as-is")).unwrap().is_none(), "what is solid is not said");
}
