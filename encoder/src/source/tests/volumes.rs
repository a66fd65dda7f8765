//! Volumes with headers: where their voxels stand, what of them is solid, how they are coloured.

use super::*;
use crate::model::about::{About, Kind};

const N: [usize; 3] = [7, 6, 5];

/// Bytes of which half are 0, none the same along all axes.
fn scattered(i: usize) -> u8 {
    let v = (hash(4, i as u32, 0, 0) >> 24) as usize * 200 / 256;
    if v < 100 { 0 } else { v as u8 }
}

fn bytes() -> Vec<u8> {
    (0..N[0] * N[1] * N[2]).map(scattered).collect()
}

fn at(x: usize, y: usize, z: usize) -> u8 {
    scattered((z * N[1] + y) * N[0] + x)
}

/// Looks at every voxel of a world of that size.
fn assert_solid(input: &Input, dims: [usize; 3], solid: impl Fn(usize, usize, usize) -> bool) {
    assert_eq!(input.columns.dims().map(|n| n as usize), dims);
    for (x, y, z) in (0..dims.iter().product()).map(|i| (i % dims[0], i / dims[0] % dims[1], i / dims[0] / dims[1])) {
        let found = input.columns.solid(x as i64, y as i64, z as i64);
        assert_eq!(found, solid(x, y, z), "world voxel ({x}, {y}, {z})");
    }
}

/// As [`assert_solid`] of values stored x, y, z in this order, y up.
fn assert_as_stored(input: &Input) {
    assert_solid(input, N, |x, y, z| at(x, y, z) > 0);
}

fn about(name: &str, bytes: &[u8], flags: &str) -> About {
    let file = file(name, bytes);
    open_pieces(&file.1, &opts(flags)).unwrap().about()
}

fn put(to: &mut [u8], at: usize, bytes: &[u8]) {
    to[at..at + bytes.len()].copy_from_slice(bytes);
}

fn nifti(slope: [f32; 2]) -> Vec<u8> {
    nifti_file(N.map(|n| n as u16), 2, slope, &bytes())
}

/// The same with an sform of these steps along its axes.
fn placed(steps: [[f32; 3]; 3]) -> Vec<u8> {
    let mut file = nifti([1.0, 0.0]);
    put(&mut file, 254, &2i16.to_le_bytes());
    for c in 0..3 {
        let [x, y, z] = steps.map(|step| step[c]);
        let row = [x, y, z, 10.0 * (c + 1) as f32];
        put(&mut file, 280 + 16 * c, &bytes_of(row.map(f32::to_le_bytes).to_vec()));
    }
    file[123] = 2;
    file
}

#[test]
fn nifti_bytes_with_a_scale_are_solid_where_they_mean_more_than_0() {
    assert_as_stored(&read("plain.nii", &nifti([1.0, 0.0]), ""));
    assert_solid(&read("ct.nii", &nifti([2.0, -250.0]), ""), N, |x, y, z| 2 * i32::from(at(x, y, z)) > 250);
    assert_solid(&read("inverted.nii", &nifti([-1.0, 255.0]), ""), N, |_, _, _| true);
    assert_solid(&read("ct.nii", &nifti([2.0, -250.0]), "--iso 120"), N, |x, y, z| {
        2 * i32::from(at(x, y, z)) - 250 >= 120
    });
    let about = about("ct.nii", &nifti([2.0, -250.0]), "");
    assert!(about.rule.starts_with("solid where more than 0, by the scale"), "{}", about.rule);
    assert_eq!((about.kind, about.format.as_str()), (Some(Kind::Volume), "NIfTI-1"));
}

#[test]
fn nifti_2_is_read_like_nifti_1() {
    let mut h = vec![0u8; 544];
    put(&mut h, 0, &540i32.to_le_bytes());
    put(&mut h, 4, b"n+2\0\r\n\x1a\n");
    put(&mut h, 12, &2i16.to_le_bytes());
    put(&mut h, 16, &bytes_of([3i64, 7, 6, 5, 1, 1, 1, 1].map(i64::to_le_bytes).to_vec()));
    put(&mut h, 168, &544i64.to_le_bytes());
    put(&mut h, 176, &bytes_of([2.0f64, -250.0].map(f64::to_le_bytes).to_vec()));
    h.extend(bytes());
    let solid = |x: usize, y: usize, z: usize| 2 * i32::from(at(x, y, z)) > 250;
    assert_solid(&read("a", &h, ""), N, solid);
    assert_solid(&read("a.gz", &gzip(&h), ""), N, solid);
    refuses_every_prefix("a.nii", &h, "");
    survives_changed_bytes("a.nii", &h, "");
    let bad = error("a.nii", &[&h[..100], &[0; 444]].concat(), "");
    assert!(bad.contains("values start at byte 0") || bad.contains("axis sizes"), "{bad}");
}

#[test]
fn nifti_pairs_are_found_by_either_name_plain_or_gzip() {
    let whole = nifti([1.0, 0.0]);
    let mut header = whole[..348].to_vec();
    put(&mut header, 344, b"ni1\0");
    put(&mut header, 108, &0f32.to_le_bytes());
    for (header_gz, image_gz) in [(false, false), (false, true), (true, false), (true, true)] {
        let dir = tempfile::tempdir().unwrap();
        let name = |ending: &str, gz: bool| dir.path().join(format!("a.{ending}{}", if gz { ".gz" } else { "" }));
        let packed = |bytes: &[u8], gz: bool| if gz { gzip(bytes) } else { bytes.to_vec() };
        fs::write(name("hdr", header_gz), packed(&header, header_gz)).unwrap();
        fs::write(name("img", image_gz), packed(&whole[352..], image_gz)).unwrap();
        for path in [name("hdr", header_gz), name("img", image_gz)] {
            assert_as_stored(&open(&path, &opts("")).unwrap());
        }
        fs::remove_file(name("hdr", header_gz)).unwrap();
        let e = open(&name("img", image_gz), &opts("")).err().unwrap().to_string();
        assert!(e.contains("a.hdr: cannot open"), "{e}");
    }
    // ANALYZE has no mark but its name.
    put(&mut header, 344, &[0; 4]);
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("b.hdr"), &header).unwrap();
    fs::write(dir.path().join("b.img"), &whole[352..]).unwrap();
    assert_as_stored(&open(&dir.path().join("b.hdr"), &opts("")).unwrap());
    assert_as_stored(&open(&dir.path().join("b.img"), &opts("")).unwrap());
}

#[test]
fn a_patient_stands_on_their_feet_whatever_the_order_of_slices() {
    let one = |a: [f32; 3]| a;
    // Stored to the right, to the front, to the head.
    let ras = placed([one([1.0, 0.0, 0.0]), [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
    assert_solid(&read("a.nii", &ras, ""), [7, 5, 6], |x, y, z| at(x, 5 - z, y) > 0);
    // To the left: x runs against it.
    let las = placed([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
    assert_solid(&read("a.nii", &las, ""), [7, 5, 6], |x, y, z| at(6 - x, 5 - z, y) > 0);
    // Sagittal: down, to the back, to the left.
    let sagittal = placed([[0.0, 0.0, -1.0], [0.0, -1.0, 0.0], [-1.0, 0.0, 0.0]]);
    assert_solid(&read("a.nii", &sagittal, ""), [5, 7, 6], |x, y, z| at(6 - y, z, 4 - x) > 0);
    // --up keeps the axes as they are stored, and says what that is.
    assert_as_stored(&read("a.nii", &las, "--up y"));
    let up = about("a.nii", &las, "--up y");
    assert!(up.left_out.iter().any(|l| l.contains("LAS") && l.contains("mirror")), "{up}");

    let seen = about("a.nii", &sagittal, "");
    assert!(
        seen.axes.starts_with("x to the right, y to the head, z to the back, by the sform (stored as IPL)"),
        "{seen}"
    );
    // The first voxel's centre, (10, 20, 30), is the farthest right, highest and nearest voxel of the world.
    let affine = seen.affine.unwrap();
    let place = |p: [f64; 3]| affine.map(|r| r[0] * p[0] + r[1] * p[1] + r[2] * p[2] + r[3]);
    assert_eq!(place([4.5, 6.5, 0.5]), [10.0, 20.0, 30.0]);
    assert_eq!(place([3.5, 5.5, 1.5]), [9.0, 19.0, 29.0]);
}

#[test]
fn nifti_quaternions_are_turned_as_the_header_says() {
    // Half a turn about the patient's long axis, third axis reversed by qfac.
    let mut file = nifti([1.0, 0.0]);
    put(&mut file, 252, &1i16.to_le_bytes());
    put(&mut file, 76, &bytes_of([-1.0f32, 1.0, 1.0, 1.0].map(f32::to_le_bytes).to_vec()));
    put(&mut file, 264, &1f32.to_le_bytes());
    assert!(about("a.nii", &file, "").axes.contains("qform (stored as LPI)"));
    assert_solid(&read("a.nii", &file, ""), [7, 5, 6], |x, y, z| at(6 - x, z, 4 - y) > 0);
}

/// Trilinear between stored values at a place in voxels, ends held.
fn between(of: impl Fn([usize; 3]) -> f64, dims: [usize; 3], place: [f64; 3]) -> f64 {
    let mut sum = 0.0;
    for corner in 0..8usize {
        let (mut weight, mut voxel) = (1.0, [0; 3]);
        for k in 0..3 {
            let p = place[k].clamp(0.0, (dims[k] - 1) as f64);
            let upper = corner >> k & 1;
            voxel[k] = (p as usize + upper).min(dims[k] - 1);
            weight *= if upper == 1 { p.fract() } else { 1.0 - p.fract() };
        }
        sum += weight * of(voxel);
    }
    sum
}

#[test]
fn unequal_spacing_becomes_cubes_of_the_closest() {
    let stored = |[x, y, z]: [usize; 3]| value(x, y, z) as f64;
    let data = bytes_of(values(|v| (v as i16).to_le_bytes()));
    let spaced = |sides: &str| [format!("{NRRD}encoding: raw\nspacings: {sides}\n\n").as_bytes(), &data].concat();
    let input = read("a.nrrd", &spaced("2 2 5"), "--iso 20.25");
    let iso = |place: [f64; 3]| between(stored, DIMS, place) >= 20.25;
    // 9 · 5 / 2 cubes along z.
    assert_solid(&input, [70, 5, 23], |x, y, z| iso([x as f64, y as f64, (z as f64 + 0.5) * 0.4 - 0.5]));
    let input = read("a.nrrd", &spaced("3 1.5 3"), "--iso 20.25");
    let half = |i: usize| (i as f64 + 0.5) * 0.5 - 0.5;
    assert_solid(&input, [140, 5, 18], |x, y, z| iso([half(x), y as f64, half(z)]));
    let input = read("a.nrrd", &spaced("3 1.5 1.5"), "--iso 20.25 --up z");
    assert_solid(&input, [140, 9, 5], |x, y, z| iso([half(x), (4 - z) as f64, y as f64]));

    assert_eq!(read("a.nrrd", &spaced("2 2 5"), "--iso 20 --spacing as-is").columns.dims(), [70, 5, 9]);
    assert_eq!(read("a.nrrd", &spaced("2 2 5"), "--iso 20 --spacing 1,2,1").columns.dims(), [70, 10, 9]);
    assert_eq!(read("a.nrrd", &spaced("nan nan nan"), "--iso 20").columns.dims(), [70, 5, 9]);
    // A raw volume states none, but may be given one.
    let raw = read("v.raw", &u8_volume(), "--dims 70,5,9 --spacing 1,1,2");
    assert_solid(&raw, [70, 5, 18], |x, y, z| value(x, y, z / 2) > 0);

    let said = about("a.nrrd", &spaced("2 2 5"), "--iso 20");
    assert_eq!(said.voxel, Some([2.0; 3]));
    assert!(said.axes.contains("70 × 5 × 9 voxels of 2 × 2 × 5 units become cubes"), "{said}");
    let said = about("a.nrrd", &spaced("2 2 5"), "--iso 20 --spacing as-is");
    assert_eq!(said.voxel, Some([2.0, 2.0, 5.0]));
    assert!(said.left_out[0].contains("drawn as cubes"), "{said}");
    let said = about("a.nrrd", &spaced("2 0 5"), "--iso 20");
    assert!(said.voxel.is_none() && said.left_out[0].contains("2 × 0 × 5"), "{said}");
}

#[test]
fn labels_have_a_colour_each_and_are_never_mixed() {
    let label = |x: usize, _: usize, z: usize| (x / 3 + 2 * (z / 2)) as u8 % 5;
    let data: Vec<u8> = (0..210).map(|i| label(i % 7, i / 7 % 6, i / 42)).collect();
    let nrrd =
        [b"NRRD0004\ntype: uchar\ndimension: 3\nsizes: 7 6 5\nspacings: 1 1 2\nencoding: raw\n\n".as_slice(), &data]
            .concat();
    let input = read("a.nrrd", &nrrd, "");
    assert_solid(&input, [7, 6, 10], |x, y, z| label(x, y, z / 2) > 0);
    let Colors::Voxel { offsets, entries } = &input.colors else { panic!("labels are coloured") };
    let mut colors = std::collections::BTreeMap::new();
    for ix in 0..70 {
        for &(_, color) in &entries[offsets[ix] as usize..offsets[ix + 1] as usize] {
            let of = label(ix % 7, 0, ix / 7 / 2);
            assert_eq!(*colors.entry(of).or_insert(color), color);
        }
    }
    let different: std::collections::BTreeSet<Rgb> = colors.values().copied().collect();
    assert_eq!((colors.len(), different.len()), (4, 4));
    assert_eq!(about("a.nrrd", &nrrd, "").kind, Some(Kind::Labels));
}

/// What is seen of a piece is what is seen of the whole there, however the axes turn and whatever lies between voxels.
#[test]
fn pieces_of_a_turned_and_coloured_volume_are_those_of_the_whole() {
    let data = bytes_of(values(|v| (v as i16).to_le_bytes()));
    let header = "NRRD0004\ntype: short\ndimension: 3\nsizes: 70 5 9\nendian: little\nencoding: raw\nspace: LPS\n";
    let ways = [
        "(1,0,0) (0,1,0) (0,0,1)",
        "(0,0,1) (-1.5,0,0) (0,1.5,0)",
        "(0,2,0) (0,0,-1) (2,0,0)",
        "(-1,0,0) (0,0,-3) (0,-2,0)",
    ];
    for way in ways {
        let bytes = [format!("{header}space directions: {way}\n\n").as_bytes(), &data].concat();
        let whole = read("a.nrrd", &bytes, "--iso 20");
        let all = colors_of(&whole);
        assert!(!all.is_empty());
        let file = file("a.nrrd", &bytes);
        let pieces = open_pieces(&file.1, &opts("--iso 20")).unwrap();
        let [nx, _, nz] = pieces.dims();
        for (xs, zs) in [(0..nx, 0..nz), (1..nx, 0..2), (nx - 2..nx, nz / 2..nz), (2..3, 1..nz - 1)] {
            let piece = pieces.piece(xs.clone(), zs.clone()).unwrap();
            assert_eq!(broken_promise(&piece), None);
            assert_eq!(piece.columns, whole.columns.crop(xs.clone(), zs.clone()), "{way} {xs:?} {zs:?}");
            for ([x, y, z], color) in colors_of(&piece) {
                let place = [x + xs.start, y, z + zs.start];
                // At the edge of a piece more is seen.
                if let Some(of_whole) = all.get(&place) {
                    assert_eq!(&color, of_whole, "{way} {place:?}");
                }
            }
        }
    }
}

fn colors_of(input: &Input) -> std::collections::BTreeMap<[u32; 3], Rgb> {
    let Colors::Voxel { offsets, entries } = &input.colors else { panic!("values are coloured") };
    let nx = input.columns.nx();
    let of = |ix: usize| entries[offsets[ix] as usize..offsets[ix + 1] as usize].iter();
    let column = |ix: usize| of(ix).map(move |&(y, c)| ([ix as u32 % nx, y.into(), ix as u32 / nx], c));
    (0..offsets.len() - 1).flat_map(column).collect()
}

#[test]
fn colours_are_those_of_the_values_that_are_seen() {
    let data = bytes_of(values(|v| (v as i16).to_le_bytes()));
    let nrrd = [format!("{NRRD}encoding: raw\n\n").as_bytes(), &data].concat();
    for up in [Up::X, Up::Y, Up::Z] {
        let name = format!("{up:?}").to_lowercase();
        let input = read("a.nrrd", &nrrd, &format!("--iso 20 --up {name}"));
        let colors = colors_of(&input);
        let exposed = crate::model::exposure::exposed(&input.columns).voxels();
        assert_eq!(colors.len() as u64, exposed, "inside nothing is coloured");
        // One value, one colour; lighter the greater.
        let mut by_value = std::collections::BTreeMap::new();
        for ([x, y, z], color) in colors {
            let [x, y, z] = [x, y, z].map(|v| v as usize);
            let of = match up {
                Up::X => value(y, z, x),
                Up::Y => value(x, y, z),
                Up::Z => value(x, 4 - z, y),
            };
            assert_eq!(*by_value.entry(of).or_insert(color), color, "--up {name}");
        }
        let light: Vec<u32> = by_value.values().map(|c| c.iter().map(|&v| u32::from(v)).sum()).collect();
        assert!(by_value.len() > 20 && light.is_sorted(), "{by_value:?}");
    }
}

#[test]
fn a_volume_without_iso_has_one_found_and_said() {
    // Air about 10, a body about 100.
    let noise = |i: usize| (hash(9, i as u32, 1, 2) >> 28) as u8;
    let body = |i: usize| (2..5).contains(&(i % 7)) && (1..5).contains(&(i / 7 % 6)) && (1..4).contains(&(i / 42));
    let data: Vec<u8> = (0..210).map(|i| noise(i) + if body(i) { 100 } else { 1 }).collect();
    let input = read("a.nii", &nifti_file([7, 6, 5], 2, [0.0; 2], &data), "");
    assert_solid(&input, N, |x, y, z| body((z * 6 + y) * 7 + x));
    let floats = bytes_of(data.iter().map(|&v| (f32::from(v) / 7.0).to_le_bytes()).collect());
    let input = read("a.nii", &nifti_file([7, 6, 5], 16, [0.0; 2], &floats), "");
    assert_solid(&input, N, |x, y, z| body((z * 6 + y) * 7 + x));
    let said = about("a.nii", &nifti_file([7, 6, 5], 16, [0.0; 2], &floats), "");
    assert!(said.rule.contains("Otsu's threshold") && said.rule.contains("coloured by value"), "{said}");
    assert_eq!(said.values.map(|[low, _]| low >= 1.0 / 7.0), Some(true));
    // NaN is air, and a volume of nothing else is empty.
    let nothing = bytes_of(vec![f32::NAN.to_le_bytes(); 210]);
    assert_solid(&read("a.nii", &nifti_file([7, 6, 5], 16, [0.0; 2], &nothing), ""), N, |_, _, _| false);
}

fn nrrd_with(fields: &str, data: &[u8]) -> Vec<u8> {
    [format!("NRRD0005\ntype: uchar\nencoding: raw\n{fields}\n\n").as_bytes(), data].concat()
}

#[test]
fn nrrd_axes_that_are_none_of_space_are_left_out_and_named() {
    let all = bytes();
    let three: Vec<u8> = all.iter().flat_map(|&v| [v, 1, 2]).collect();
    for fields in [
        "dimension: 4\nsizes: 3 7 6 5\nkinds: vector domain domain domain",
        "dimension: 4\nsizes: 3 7 6 5\nkinds: RGB-color domain domain domain",
        "dimension: 4\nsizes: 3 7 6 5\nspace dimension: 3\nspace directions: none (1,0,0) (0,1,0) (0,0,1)",
    ] {
        let file = nrrd_with(fields, &three);
        assert_as_stored(&read("a.nrrd", &file, ""));
        assert_eq!(about("a.nrrd", &file, "").left_out, ["2 of 3 values a voxel: the first is read"]);
    }
    let series = [all.clone(), vec![9; 210]].concat();
    let file = nrrd_with("dimension: 4\nsizes: 7 6 5 2\nkinds: domain domain domain list", &series);
    assert_as_stored(&read("a.nrrd", &file, ""));
    assert_eq!(about("a.nrrd", &file, "").left_out, ["1 of 2 volumes: the first is read"]);
    let e = error("a.nrrd", &nrrd_with("dimension: 4\nsizes: 7 2 6 5\nkinds: domain list domain domain", &series), "");
    assert!(e.contains("axis 1 (of 4, sizes [7, 2, 6, 5], kind list) stands between"), "{e}");
    let e = error("a.nrrd", &nrrd_with("dimension: 4\nsizes: 7 6 5 2", &series), "");
    assert!(e.contains("expected three axes of space") && e.contains("kinds"), "{e}");
    let e = error("a.nrrd", &nrrd_with("dimension: 3\nsizes: 3 14 5\nkinds: RGB-color domain domain", &all), "");
    assert!(e.contains("a picture of several values"), "{e}");
}

#[test]
fn nrrd_directions_of_a_patient_are_turned_upright() {
    let fields = "dimension: 3\nsizes: 7 6 5\nspace: left-posterior-superior\nspace origin: (1,2,3)\nspace units: \"mm\" \"mm\" \"mm\"\n";
    let file = nrrd_with(&format!("{fields}space directions: (1,0,0) (0,1,0) (0,0,1)"), &bytes());
    assert_solid(&read("a.nrrd", &file, ""), [7, 5, 6], |x, y, z| at(6 - x, z, y) > 0);
    let said = about("a.nrrd", &file, "");
    assert!(said.axes.contains("(stored as LPS)") && said.unit == "mm", "{said}");
    // The same in a space that is nobody's.
    let file = nrrd_with(
        &format!(
            "{}space directions: (1,0,0) (0,0,1) (0,1,0)",
            fields.replace("left-posterior-superior", "3D-right-handed")
        ),
        &bytes(),
    );
    assert_solid(&read("a.nrrd", &file, ""), [7, 5, 6], |x, y, z| at(x, z, y) > 0);
}

#[test]
fn nrrd_values_are_read_from_lists_of_files_and_from_text() {
    let dir = tempfile::tempdir().unwrap();
    let all = bytes();
    for z in 0..5 {
        fs::write(dir.path().join(format!("s{:02}.raw", z + 1)), &all[42 * z..42 * (z + 1)]).unwrap();
    }
    let write = |name: &str, fields: &str| {
        let path = dir.path().join(name);
        fs::write(&path, format!("NRRD0005\ntype: uchar\nencoding: raw\ndimension: 3\nsizes: 7 6 5\n{fields}\n"))
            .unwrap();
        path
    };
    let list = write("list.nhdr", "data file: LIST\ns01.raw\ns02.raw\ns03.raw\ns04.raw\ns05.raw");
    assert_as_stored(&open(&list, &opts("")).unwrap());
    assert_as_stored(&open(&write("numbers.nhdr", "data file: s%02d.raw 1 5 1"), &opts("")).unwrap());
    // How many axes each file has may follow.
    let list = write("axes.nhdr", "data file: LIST 2\ns01.raw\ns02.raw\ns03.raw\ns04.raw\ns05.raw");
    assert_as_stored(&open(&list, &opts("")).unwrap());
    assert_as_stored(&open(&write("five.nhdr", "data file: s%02d.raw 1 5 1 2"), &opts("")).unwrap());
    let e = open(&write("few.nhdr", "data file: s%02d.raw 1 4 1"), &opts("")).err().unwrap().to_string();
    assert!(e.contains("4 data files"), "{e}");
    let text: Vec<String> = all.iter().map(u8::to_string).collect();
    let file = nrrd_with("dimension: 3\nsizes: 7 6 5", text.join(" ").as_bytes());
    let file = String::from_utf8(file).unwrap().replace("encoding: raw", "encoding: ascii").into_bytes();
    assert_as_stored(&read("a.nrrd", &file, ""));
    let e = error("a.nrrd", &file[..file.len() - 40], "");
    assert!(e.contains("numbers written as text; 210 were expected"), "{e}");
}

fn mha(fields: &str, data: &[u8]) -> Vec<u8> {
    let head = format!("ObjectType = Image\nNDims = 3\nDimSize = 7 6 5\n{fields}\nElementDataFile = LOCAL\n");
    [head.as_bytes(), data].concat()
}

fn zlib(bytes: &[u8]) -> Vec<u8> {
    let mut out = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::default());
    out.write_all(bytes).unwrap();
    out.finish().unwrap()
}

#[test]
fn meta_images_are_read_raw_packed_and_as_text() {
    let all = bytes();
    let bare = mha("ElementType = MET_UCHAR", &all);
    assert_as_stored(&read("a", &bare, ""));
    assert_eq!(about("a.mha", &bare, "").format, "MetaImage");
    assert_as_stored(&read("a.mha", &mha("ElementType = MET_UCHAR\nCompressedData = True", &zlib(&all)), ""));
    let text: Vec<String> = all.iter().map(u8::to_string).collect();
    assert_as_stored(&read(
        "a.mha",
        &mha("ElementType = MET_UCHAR\nBinaryData = False", text.join("\n").as_bytes()),
        "",
    ));
    let big = bytes_of(all.iter().map(|&v| (f32::from(v) * 0.25 - 20.0).to_be_bytes()).collect());
    let input = read("a.mha", &mha("ElementType = MET_FLOAT\nBinaryDataByteOrderMSB = True", &big), "--iso 20");
    assert_solid(&input, N, |x, y, z| f64::from(at(x, y, z)) * 0.25 - 20.0 >= 20.0);
    let scaled = mha(
        "ElementType = MET_UCHAR\nElementToIntensityFunctionSlope = 2\nElementToIntensityFunctionOffset = -250",
        &all,
    );
    assert_solid(&read("a.mha", &scaled, ""), N, |x, y, z| 2 * i32::from(at(x, y, z)) > 250);
    let channels: Vec<u8> = all.iter().flat_map(|&v| [v, 7]).collect();
    let file = mha("ElementType = MET_UCHAR\nElementNumberOfChannels = 2", &channels);
    assert_as_stored(&read("a.mha", &file, ""));
    assert_eq!(about("a.mha", &file, "").left_out, ["1 of 2 values a voxel: the first is read"]);
    let array = mha("ElementType = MET_UCHAR_ARRAY\nElementNumberOfChannels = 2", &channels);
    assert_as_stored(&read("a.mha", &array, ""));

    let placed = mha(
        "ElementType = MET_UCHAR\nTransformMatrix = 1 0 0 0 1 0 0 0 1\nAnatomicalOrientation = RAI\nElementSpacing = 1 1 2",
        &all,
    );
    assert_solid(&read("a.mha", &placed, "--spacing as-is"), [7, 5, 6], |x, y, z| at(6 - x, z, y) > 0);
    assert_eq!(read("a.mha", &placed, "").columns.dims(), [7, 10, 6]);
    assert!(about("a.mha", &placed, "").axes.contains("stored as LPS"));

    refuses_every_prefix("a.mha", &bare, "");
    survives_changed_bytes("a.mha", &bare, "");
    let e = error("a.mha", &mha("ElementType = MET_STRING", &all), "");
    assert!(e.contains("MET_STRING"), "{e}");
    let e = error("a.mha", &mha("ElementType = MET_UCHAR\nDimSize = 1048576 1048576 1048576", &all), "");
    assert!(e.contains("expect 1152921504606846976"), "{e}");
}

#[test]
fn meta_images_are_read_from_other_files() {
    let dir = tempfile::tempdir().unwrap();
    let all = bytes();
    fs::write(dir.path().join("all.raw"), [b"head".as_slice(), &all].concat()).unwrap();
    for z in 0..5 {
        fs::write(dir.path().join(format!("s{z}.raw")), &all[42 * z..42 * (z + 1)]).unwrap();
    }
    let write = |name: &str, fields: &str| {
        let path = dir.path().join(name);
        fs::write(&path, format!("NDims = 3\nDimSize = 7 6 5\nElementType = MET_UCHAR\n{fields}\n")).unwrap();
        open(&path, &opts(""))
    };
    assert_as_stored(&write("a.mhd", "HeaderSize = 4\nElementDataFile = all.raw").unwrap());
    assert_as_stored(&write("b.mhd", "HeaderSize = -1\nElementDataFile = all.raw").unwrap());
    assert_as_stored(&write("c.mhd", "ElementDataFile = LIST\ns0.raw\ns1.raw\ns2.raw\ns3.raw\ns4.raw").unwrap());
    assert_as_stored(&write("d.mhd", "ElementDataFile = s%d.raw 0 4 1").unwrap());
    assert!(
        write("e.mhd", "ElementDataFile = LIST\ns0.raw").is_err_and(|e| e.to_string().contains("1 data files for 5"))
    );
    assert!(
        write("f.mhd", "ElementDataFile = none.raw").is_err_and(|e| e.to_string().contains("none.raw: cannot open"))
    );
}

/// A map of the scattered bytes, each written by `put`, whose header's axes are `map`.
fn mrc(mode: i32, big: bool, map: [i32; 3], put_value: impl Fn(u8) -> Vec<u8>) -> Vec<u8> {
    let mut h = vec![0u8; 1024 + 80];
    let mut word = |at: usize, v: i32| put(&mut h, at, &if big { v.to_be_bytes() } else { v.to_le_bytes() });
    for (i, v) in [7, 6, 5, mode].into_iter().enumerate() {
        word(4 * i, v);
    }
    // As many intervals along x, y, z as there are voxels, two units wide each.
    for (f, &axis) in map.iter().enumerate() {
        let (n, c) = (N[f] as i32, axis as usize - 1);
        word(28 + 4 * c, n);
        word(40 + 4 * c, (2.0 * n as f32).to_bits() as i32);
        word(64 + 4 * f, axis);
        word(52 + 4 * f, 90f32.to_bits() as i32);
    }
    word(88, 1);
    word(92, 80);
    put(&mut h, 208, b"MAP ");
    put(&mut h, 212, if big { &[0x11, 0x11, 0, 0] } else { &[0x44, 0x44, 0, 0] });
    bytes().into_iter().for_each(|v| h.extend(put_value(v)));
    h
}

#[test]
fn mrc_maps_of_every_mode_and_byte_order_are_read() {
    let solid = |x: usize, y: usize, z: usize| at(x, y, z) >= 120;
    let half = |v: u8| half::f16::from_f32(f32::from(v));
    let plain = [1, 2, 3];
    let files = [
        (mrc(1, false, plain, |v| i16::from(v).to_le_bytes().to_vec()), "--iso 120"),
        (mrc(1, true, plain, |v| i16::from(v).to_be_bytes().to_vec()), "--iso 120"),
        (mrc(2, false, plain, |v| f32::from(v).to_le_bytes().to_vec()), "--iso 120"),
        (mrc(2, true, plain, |v| f32::from(v).to_be_bytes().to_vec()), "--iso 120"),
        (mrc(6, false, plain, |v| (u16::from(v) + 60_000).to_le_bytes().to_vec()), "--iso 60120"),
        (mrc(12, false, plain, |v| half(v).to_le_bytes().to_vec()), "--iso 120"),
        (mrc(12, true, plain, |v| half(v).to_be_bytes().to_vec()), "--iso 120"),
        (mrc(0, false, plain, |v| vec![(v / 2).wrapping_sub(100)]), "--iso -40"),
    ];
    for (i, (file, flags)) in files.iter().enumerate() {
        assert_solid(&read("a.mrc", file, flags), N, solid);
        assert_solid(&read("a.map.gz", &gzip(file), flags), N, solid);
        assert_eq!(about("a.mrc", file, flags).voxel, Some([2.0; 3]), "{i}");
    }
    // Bytes of IMOD have no sign unless it says so.
    let mut imod = mrc(0, false, plain, |v| vec![v]);
    put(&mut imod, 152, &1_146_047_817i32.to_le_bytes());
    assert_solid(&read("a.mrc", &imod, "--iso 120"), N, solid);

    let small = &files[0].0;
    refuses_every_prefix("a.mrc", small, "--iso 120");
    survives_changed_bytes("a.mrc", small, "");
    assert!(error("a.mrc", &mrc(4, false, plain, |_| vec![0; 8]), "").contains("complex"));
    assert!(error("a.mrc", &mrc(101, false, plain, |_| vec![0]), "").contains("4 bits"));
}

#[test]
fn mrc_axes_are_those_of_the_crystal() {
    // Columns are z, rows x, sections y.
    let file = mrc(1, false, [3, 1, 2], |v| i16::from(v).to_le_bytes().to_vec());
    assert_solid(&read("a.mrc", &file, "--iso 120"), [6, 5, 7], |x, y, z| at(z, x, y) >= 120);
    assert_solid(&read("a.mrc", &file, "--iso 120 --up z"), [6, 7, 5], |x, y, z| at(y, x, 4 - z) >= 120);
    let said = about("a.mrc", &file, "--iso 120");
    assert!(said.unit == "Å" && said.axes.contains("MAPC"), "{said}");
    let density = about("a.mrc", &file, "");
    assert!(density.rule.contains("3 standard deviations"), "{density}");
}

fn base64_of(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::new();
    for group in bytes.chunks(3) {
        let bits = group.iter().enumerate().fold(0u32, |n, (i, &b)| n | u32::from(b) << (16 - 8 * i));
        for i in 0..4 {
            out.push(if i <= group.len() { DIGITS[(bits >> (18 - 6 * i) & 63) as usize].into() } else { '=' });
        }
    }
    out
}

/// Heads and blocks of packed values, of 100 bytes each.
fn blocks(all: &[u8], pack: impl Fn(&[u8]) -> Vec<u8>, wide: bool) -> (Vec<u8>, Vec<u8>) {
    let packed: Vec<Vec<u8>> = all.chunks(100).map(pack).collect();
    let mut words = vec![packed.len() as u64, 100, (all.len() % 100) as u64];
    words.extend(packed.iter().map(|p| p.len() as u64));
    let head = words.iter().flat_map(|w| w.to_le_bytes()[..if wide { 8 } else { 4 }].to_vec()).collect();
    (head, packed.concat())
}

fn vti(file: &str, array: &str, rest: &[u8]) -> Vec<u8> {
    let head = format!(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"ImageData\" version=\"1.0\" byte_order=\"LittleEndian\" {file}>\n\
         <ImageData WholeExtent=\"0 6 0 5 0 4\" Origin=\"0 0 0\" Spacing=\"1 1 1\">\n<Piece Extent=\"0 6 0 5 0 4\">\n\
         <PointData Scalars=\"b\">\n<DataArray type=\"Int8\" Name=\"a\" format=\"ascii\">1 2</DataArray>\n{array}\n</PointData>\n\
         </Piece>\n</ImageData>\n"
    );
    [head.as_bytes(), rest, b"\n</VTKFile>\n"].concat()
}

#[test]
fn vtk_image_data_are_read_in_every_form() {
    let all = bytes();
    let array =
        |format: &str, content: &str| format!("<DataArray type=\"UInt8\" Name=\"b\" {format}>{content}</DataArray>");
    let text: Vec<String> = all.iter().map(u8::to_string).collect();
    let len = |wide: bool| (all.len() as u64).to_le_bytes()[..if wide { 8 } else { 4 }].to_vec();
    let (zlib_compressor, lz4_compressor) =
        ("compressor=\"vtkZLibDataCompressor\"", "compressor=\"vtkLZ4DataCompressor\"");
    let ascii = vti("", &array("format=\"ascii\"", &text.join(" ")), b"");
    let mut files = vec![ascii.clone()];
    for wide in [false, true] {
        let header = if wide { "header_type=\"UInt64\"" } else { "header_type=\"UInt32\"" };
        let plain = [len(wide), all.clone()].concat();
        files.push(vti(header, &array("format=\"binary\"", &format!("\n  {}\n", base64_of(&plain))), b""));
        let (head, packed) = blocks(&all, zlib, wide);
        let coded = base64_of(&head) + &base64_of(&packed);
        files.push(vti(&format!("{header} {zlib_compressor}"), &array("format=\"binary\"", &coded), b""));
        let (head, packed) = blocks(&all, lz4_block, wide);
        let coded = base64_of(&head) + &base64_of(&packed);
        files.push(vti(&format!("{header} {lz4_compressor}"), &array("format=\"binary\"", &coded), b""));
        // Appended, after five bytes of another array.
        let raw = [b"<AppendedData encoding=\"raw\">\n_<<&<<".as_slice(), &plain, b"</AppendedData>"].concat();
        files.push(vti(header, &array("format=\"appended\" offset=\"5\"", ""), &raw));
        let (head, packed) = blocks(&all, zlib, wide);
        let raw = [b"<AppendedData encoding=\"raw\">\n_<<&<<".as_slice(), &head, &packed, b"</AppendedData>"].concat();
        files.push(vti(&format!("{header} {zlib_compressor}"), &array("format=\"appended\" offset=\"5\"", ""), &raw));
        let coded = format!("<AppendedData encoding=\"base64\">\n_{}</AppendedData>", base64_of(&plain));
        files.push(vti(header, &array("format=\"appended\" offset=\"0\"", ""), coded.as_bytes()));
    }
    for file in &files {
        assert_as_stored(&read("a.vti", file, ""));
    }
    let said = about("a.vti", &ascii, "");
    assert_eq!(said.format, "VTK image data, array \"b\" of its points");
    assert_eq!(said.left_out, ["1 other arrays: \"a\""]);
    for file in [&files[1], &files[2], &files[5]] {
        survives_changed_bytes("a.vti", file, "");
    }
    // Without its last element a file holds all that is looked for.
    refuses_every_prefix_but(100, "a.vti", &files[2], "");
    refuses_every_prefix_but(40, "a.vti", &files[5], "");
}

/// LZ4 of literals alone.
fn lz4_block(bytes: &[u8]) -> Vec<u8> {
    let head = match bytes.len() {
        n if n < 15 => vec![(n as u8) << 4],
        n => vec![0xF0, (n - 15) as u8],
    };
    [&head, bytes].concat()
}

#[test]
fn vtk_image_data_of_cells_vectors_and_other_directions_are_read() {
    let all = bytes();
    let vectors: Vec<String> = all.iter().map(|v| format!("{v}.5 1 2")).collect();
    let array = "<DataArray type=\"Float32\" Name=\"b\" NumberOfComponents=\"3\" format=\"ascii\">";
    let file = vti("", &format!("{array}{}</DataArray>", vectors.join("\n")), b"");
    assert_solid(&read("a.vti", &file, "--iso 120"), N, |x, y, z| at(x, y, z) >= 120);
    assert!(about("a.vti", &file, "").left_out[0].contains("2 of 3 values a voxel"));

    let text: Vec<String> = all.iter().map(u8::to_string).collect();
    let cells = format!(
        "<VTKFile type=\"ImageData\" byte_order=\"BigEndian\"><ImageData WholeExtent=\"2 9 0 6 0 5\" Origin=\"0 0 0\" Spacing=\"2 2 2\" \
         Direction=\"0 1 0 1 0 0 0 0 1\"><Piece Extent=\"2 9 0 6 0 5\"><CellData><DataArray type=\"UInt8\" Name=\"c\" \
         format=\"ascii\">{}</DataArray></CellData></Piece></ImageData></VTKFile>",
        text.join(" ")
    );
    // The file's first axis runs along y.
    assert_solid(&read("a.vti", cells.as_bytes(), ""), [6, 7, 5], |x, y, z| at(y, x, z) > 0);
    let said = about("a.vti", cells.as_bytes(), "");
    assert_eq!(said.voxel, Some([2.0; 3]));
    // The corner of the first cell, which is the second along y.
    assert_eq!(said.affine.unwrap().map(|row| row[3]), [0.0, 4.0, 0.0]);

    let other = String::from_utf8(vti("", "", b"")).unwrap();
    let e = error("a.vtu", other.replace("type=\"ImageData\"", "type=\"UnstructuredGrid\"").as_bytes(), "");
    assert!(e.contains("UnstructuredGrid") && e.contains("only ImageData"), "{e}");
    let e = error("a.vti", other.replace("</Piece>", "</Piece><Piece Extent=\"0 6 0 5 4 5\"></Piece>").as_bytes(), "");
    assert!(e.contains("2 pieces"), "{e}");
    let e = error(
        "a.vti",
        &vti(
            "compressor=\"vtkLZMADataCompressor\"",
            "<DataArray type=\"UInt8\" Name=\"b\" format=\"binary\">AAAA</DataArray>",
            b"",
        ),
        "",
    );
    assert!(e.contains("LZMA"), "{e}");
    assert!(error("a.vtk", b"# vtk DataFile Version 3.0\n", "").contains("older text format"));
}

#[test]
fn the_values_of_a_volume_are_solid_where_the_volume_is_whatever_is_up() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.raw");
    let values: Vec<u8> = (0..5 * 7 * 3u32).map(|i| (i * 37 % 251) as u8).collect();
    fs::write(&path, &values).unwrap();
    for up in [Up::X, Up::Y, Up::Z] {
        let opts = ReadOptions { dims: Some([5, 7, 3]), iso: Some(120.0), up: Some(up), ..ReadOptions::default() };
        let world = open_pieces(&path, &opts).unwrap();
        let grid = std::sync::Arc::new(world.grid(1 << 20).unwrap().expect("a volume"));
        let whole = pieces::whole(&*world).unwrap();
        assert!(grid.dims() == world.dims() && grid.input(120.0).columns == whole.columns, "{up:?}");
        assert!(world.grid(10).unwrap().is_none(), "too many voxels");
    }
    assert!(
        open_pieces(Path::new("procedural:rocks?size=16"), &ReadOptions::default())
            .unwrap()
            .grid(1 << 20)
            .unwrap()
            .is_none()
    );
}

#[test]
fn a_volume_takes_the_colours_of_a_ramp() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.raw");
    fs::write(&path, (0..64u8).map(|v| v * 4).collect::<Vec<_>>()).unwrap();
    let opts = |ramp: &str| ReadOptions {
        dims: Some([1, 64, 1]),
        iso: Some(4.0),
        ramp: Some(ramp.into()),
        ..ReadOptions::default()
    };
    let color = |ramp: &str, y| {
        let scene = crate::build(open(&path, &opts(ramp)).unwrap(), &Default::default()).unwrap();
        scene.levels[0].colors[y]
    };
    // The threshold has the colour at 0.35 of 1.35.
    assert_eq!(color("grey", 0), [89; 3]);
    assert!(color("viridis", 0)[2] > 100 && color("viridis", 0) != color("magma", 0));
    assert_eq!(color("grey", 62), [230; 3]);
    assert!(!open_pieces(&path, &opts("none")).unwrap().colored());
    assert!(open_pieces(&path, &opts("nothing")).err().unwrap().to_string().contains("--ramp nothing"));
}

#[test]
fn classes_are_steps_of_the_window_wherever_the_axes_point() {
    for (flags, world) in [("", [0, 1, 2]), ("--up x", [2, 0, 1]), ("--up z", [0, 2, 1])] {
        let bytes = bytes();
        let file = file("v.raw", &bytes);
        let more = format!("--dims 7,6,5 --classes 4 --window 100,200 {flags}");
        let pieces = open_pieces(&file.1, &opts(&more)).unwrap();
        let dims = pieces.dims();
        let matter = pieces.matter(1..dims[0], 0..dims[2]).unwrap().unwrap();
        let input = pieces.piece(0..dims[0], 0..dims[2]).unwrap();
        assert!(input.columns.runs().is_empty(), "nothing is solid without --iso");
        for i in 0..N[0] * N[1] * N[2] {
            let p = [i % N[0], i / N[0] % N[1], i / N[0] / N[1]];
            let mut at = world.map(|axis| p[axis] as u32);
            if flags == "--up z" {
                at[2] = dims[2] - 1 - at[2];
            }
            let class = match scattered(i) {
                0..=100 => 0,
                v => (u16::from(v) - 100) / 25 + 1,
            };
            if at[0] > 0 {
                assert_eq!(matter.at(at[0] - 1, at[1], at[2]), 8 * class.min(4), "{flags} {p:?}");
            }
        }
    }
    let solid = open_pieces(&file("v.raw", &bytes()).1, &opts("--dims 7,6,5 --classes 4 --iso 150")).unwrap();
    assert!(!solid.piece(0..7, 0..5).unwrap().columns.runs().is_empty());
    assert_eq!(solid.about().classes.unwrap().window, Some([0.0, 199.0]));
}
