//! Files made here, element by element, with explicit types, little-endian.

use std::fs;
use std::path::Path;

use super::super::tests::opts;
use super::super::{open, open_pieces};
use crate::{About, Input};

const W: usize = 5;
const H: usize = 4;

fn element(tag: (u16, u16), kind: &str, value: &[u8]) -> Vec<u8> {
    let mut out = [tag.0.to_le_bytes(), tag.1.to_le_bytes()].concat();
    out.extend(kind.as_bytes());
    let len = value.len() + value.len() % 2;
    match kind {
        "OB" | "OW" | "OF" | "SQ" | "UN" => {
            out.extend([0, 0]);
            out.extend((len as u32).to_le_bytes());
        }
        _ => out.extend((len as u16).to_le_bytes()),
    }
    out.extend(value);
    // Text is filled up with blanks, the rest with 0.
    out.resize(out.len() + value.len() % 2, if matches!(kind, "DS" | "IS" | "CS") { b' ' } else { 0 });
    out
}

/// A sequence of items of these elements.
fn sequence(tag: (u16, u16), items: &[Vec<u8>]) -> Vec<u8> {
    let item =
        |content: &Vec<u8>| [&[0xfe, 0xff, 0, 0xe0][..], &(content.len() as u32).to_le_bytes(), content].concat();
    element(tag, "SQ", &items.iter().flat_map(item).collect::<Vec<u8>>())
}

/// A file, as far as the tests change it.
struct Slice<'a> {
    series: &'a str,
    number: i32,
    position: Option<[f64; 3]>,
    orientation: &'a str,
    rescale: (f64, f64),
    stored: u16,
    values: Vec<i16>,
    syntax: &'a str,
    more: Vec<u8>,
}

impl Slice<'_> {
    fn at(z: f64, values: Vec<i16>) -> Self {
        Slice {
            series: "1.2.3",
            number: 0,
            position: Some([0.0, 0.0, z]),
            orientation: "1\\0\\0\\0\\1\\0",
            rescale: (1.0, 0.0),
            stored: 16,
            values,
            syntax: "1.2.840.10008.1.2.1",
            more: Vec::new(),
        }
    }

    fn bytes(&self) -> Vec<u8> {
        let number = |v: f64| v.to_string().into_bytes();
        let short = |v: u16| v.to_le_bytes();
        let position = self.position.map(|p| p.map(|v| v.to_string()).join("\\"));
        let body = [
            element((0x0008, 0x0060), "CS", b"CT"),
            element((0x0018, 0x0050), "DS", b"2"),
            element((0x0020, 0x000e), "UI", self.series.as_bytes()),
            element((0x0020, 0x0013), "IS", self.number.to_string().as_bytes()),
            position.map(|p| element((0x0020, 0x0032), "DS", p.as_bytes())).unwrap_or_default(),
            element((0x0020, 0x0037), "DS", self.orientation.as_bytes()),
            element((0x0028, 0x0002), "US", &short(1)),
            element((0x0028, 0x0004), "CS", b"MONOCHROME1"),
            element((0x0028, 0x0010), "US", &short(H as u16)),
            element((0x0028, 0x0011), "US", &short(W as u16)),
            element((0x0028, 0x0030), "DS", b"0.5\\0.25"),
            element((0x0028, 0x0100), "US", &short(16)),
            element((0x0028, 0x0101), "US", &short(self.stored)),
            element((0x0028, 0x0102), "US", &short(self.stored - 1)),
            element((0x0028, 0x0103), "US", &short(1)),
            element((0x0028, 0x1052), "DS", &number(self.rescale.1)),
            element((0x0028, 0x1053), "DS", &number(self.rescale.0)),
            self.more.clone(),
            element((0x7fe0, 0x0010), "OW", &self.values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>()),
        ];
        file(self.syntax, &body.concat())
    }
}

fn file(syntax: &str, body: &[u8]) -> Vec<u8> {
    let meta = [
        element((0x0002, 0x0001), "OB", &[0, 1]),
        element((0x0002, 0x0002), "UI", b"1.2.840.10008.5.1.4.1.1.2"),
        element((0x0002, 0x0003), "UI", b"1.2.3.4"),
        element((0x0002, 0x0010), "UI", syntax.as_bytes()),
        element((0x0002, 0x0012), "UI", b"1.2.3"),
    ]
    .concat();
    let len = element((0x0002, 0x0000), "UL", &(meta.len() as u32).to_le_bytes());
    [&[0; 128][..], b"DICM", &len, &meta, body].concat()
}

fn value(i: usize, z: usize) -> i16 {
    ((i * 37 + z * 59) % 201) as i16 - 100
}

fn slice(z: usize) -> Vec<i16> {
    (0..W * H).map(|i| value(i, z)).collect()
}

/// A folder of these files.
fn folder(slices: &[Slice]) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    for (i, slice) in slices.iter().enumerate() {
        fs::write(dir.path().join(format!("{i}.dcm")), slice.bytes()).unwrap();
    }
    dir
}

fn read(path: &Path, flags: &str) -> (Input, About) {
    // As they are stored: where a patient's head is, tests of other formats ask.
    let pieces = open_pieces(path, &opts(&format!("{flags} --up y --spacing as-is"))).unwrap();
    (crate::model::pieces::whole(&*pieces).unwrap(), pieces.about())
}

fn assert_slices(input: &Input, zs: &[usize], solid: impl Fn(i16) -> bool) {
    assert_eq!(input.columns.dims(), [W as u32, H as u32, zs.len() as u32]);
    for (z, &of) in zs.iter().enumerate() {
        for i in 0..W * H {
            let found = input.columns.solid((i % W) as i64, (i / W) as i64, z as i64);
            assert_eq!(found, solid(value(i, of)), "{i} of slice {z}");
        }
    }
}

#[test]
fn slices_are_in_order_of_their_places_and_rescaled() {
    let of = |z: usize| Slice { rescale: (2.0, -30.0), ..Slice::at(z as f64 * 1.5 - 4.0, slice(z)) };
    let dir = folder(&[of(3), of(0), of(2), of(1)]);
    let (input, about) = read(dir.path(), "--iso 11");
    assert_slices(&input, &[0, 1, 2, 3], |v| v * 2 - 30 >= 11);
    assert_eq!((about.format.as_str(), about.voxel, about.unit.as_str()), ("DICOM (CT)", Some([0.25, 0.5, 1.5]), "mm"));
    assert!(about.rule.contains("stored · 2 + -30"), "{}", about.rule);
    let shown = "that low values are shown bright (MONOCHROME1): values are as stored";
    assert_eq!(about.left_out[0], shown);
    // Against the normal.
    let of = |z: usize| Slice { orientation: "0\\1\\0\\1\\0\\0", ..Slice::at(z as f64, slice(z)) };
    assert_slices(&read(folder(&[of(0), of(1)]).path(), "--iso 11").0, &[1, 0], |v| v >= 11);
    // Each by its own line, as those of PET.
    let of = |z: usize| Slice { rescale: (1.0 + z as f64, 0.0), ..Slice::at(z as f64, slice(0)) };
    let (input, about) = read(folder(&[of(1), of(0)]).path(), "--iso 50");
    let solid = |z: i64| (0..W * H).filter(|&i| input.columns.solid((i % W) as i64, (i / W) as i64, z)).count();
    let right = |k: i16| slice(0).iter().filter(|&&v| v * k >= 50).count();
    assert_eq!([solid(0), solid(1)], [right(1), right(2)]);
    assert!(about.rule.contains("by its own line"), "{}", about.rule);
    // Without places, by number.
    let of = |z: usize| Slice { number: z as i32, position: None, ..Slice::at(0.0, slice(z)) };
    let (input, about) = read(folder(&[of(2), of(0), of(1)]).path(), "--iso 11");
    assert_slices(&input, &[0, 1, 2], |v| v >= 11);
    assert!(about.left_out[0].contains("in order of their numbers"), "{:?}", about.left_out);
}

#[test]
fn what_a_series_lacks_or_has_beside_is_said() {
    let at = |places: &[f64]| -> Vec<String> {
        let slices: Vec<Slice> = places.iter().enumerate().map(|(z, &p)| Slice::at(p, slice(z))).collect();
        read(folder(&slices).path(), "--iso 1").1.left_out
    };
    assert!(!at(&[0.0, 1.0, 2.0]).iter().any(|l| l.contains("gap") || l.contains("unequal")));
    assert_eq!(at(&[0.0, 1.0, 2.0, 5.0])[0], "gaps: 2 slices are missing, those on both sides are drawn as neighbours");
    assert_eq!(at(&[0.0, 1.0, 2.4, 3.4])[0], "unequal distances of slices, 1 to 1.4 mm, are drawn as equal");
    let with = |more: Slice| {
        let dir = folder(&[Slice::at(1.0, slice(1)), Slice::at(0.0, slice(0)), more]);
        let (input, about) = read(dir.path(), "--iso 1");
        assert_slices(&input, &[0, 1], |v| v >= 1);
        about.left_out[0].clone()
    };
    assert!(with(Slice { series: "1.2.4", ..Slice::at(2.0, slice(2)) }).starts_with("1 of 2 series, 1 frames"));
    assert!(
        with(Slice { orientation: "0\\1\\0\\0\\0\\-1", ..Slice::at(2.0, slice(2)) })
            .contains("another size, type or direction")
    );
    let again = with(Slice { number: 9, ..Slice::at(1.0, slice(5)) });
    assert!(again.contains("1 frames at the places of others"), "{again}");
    let tilted: Vec<Slice> =
        (0..3).map(|z| Slice { position: Some([0.0, z as f64, z as f64]), ..Slice::at(0.0, slice(z)) }).collect();
    let said = read(folder(&tilted).path(), "--iso 1").1.left_out;
    assert!(said[0].contains("tilt of the slices (45.0°)"), "{said:?}");
    let dir = folder(&[Slice::at(0.0, slice(0))]);
    fs::write(dir.path().join("DICOMDIR"), Slice::at(0.0, slice(0)).bytes()).unwrap();
    fs::write(dir.path().join("report"), file("1.2.840.10008.1.2.1", &element((0x0008, 0x0060), "CS", b"SR"))).unwrap();
    let (input, about) = read(dir.path(), "--iso 1");
    assert_slices(&input, &[0], |v| v >= 1);
    assert!(about.left_out.contains(&"1 files without pixels".to_owned()), "{:?}", about.left_out);
}

#[test]
fn bits_beside_the_values_and_padding_are_none() {
    // Twelve bits with a sign, and others above them.
    let values = slice(1).iter().enumerate().map(|(i, &v)| (v & 0xfff) | ((i as i16 & 7) << 12)).collect();
    let dir = folder(&[Slice { stored: 12, ..Slice::at(0.0, values) }]);
    assert_slices(&read(dir.path(), "--iso -3").0, &[1], |v| v >= -3);
    let padding = element((0x0028, 0x0120), "SS", &value(3, 1).to_le_bytes());
    // Before the rescaling, in order of tags.
    let mut bytes = Slice::at(0.0, slice(1)).bytes();
    let at = bytes.windows(4).position(|w| w == [0x28, 0, 0x52, 0x10]).unwrap();
    bytes.splice(at..at, padding);
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a");
    fs::write(&path, bytes).unwrap();
    let (input, about) = read(&path, "--iso -100");
    assert_slices(&input, &[1], |v| v != value(3, 1));
    assert!(about.rule.contains("is air (padding)"), "{}", about.rule);
}

/// A file of several frames, each with its place; `bits` is 16, or 1 with the least bit first.
fn frames(places: &[f64], bits: u16, pixels: &[u8], segments: &[u16]) -> Vec<u8> {
    let short = |v: u16| v.to_le_bytes();
    let group = |i: usize| {
        let position = element((0x0020, 0x0032), "DS", format!("0\\0\\{}", places[i]).as_bytes());
        let segment = sequence((0x0062, 0x000a), &[element((0x0062, 0x000b), "US", &short(segments[i]))]);
        [sequence((0x0020, 0x9113), &[position]), segment].concat()
    };
    let shared = [
        sequence((0x0020, 0x9116), &[element((0x0020, 0x0037), "DS", b"1\\0\\0\\0\\1\\0")]),
        sequence((0x0028, 0x9110), &[element((0x0028, 0x0030), "DS", b"0.5\\0.25")]),
        sequence(
            (0x0028, 0x9145),
            &[[
                element((0x0028, 0x1052), "DS", b"0"),
                element((0x0028, 0x1053), "DS", if bits == 1 { b"1" } else { b"3" }),
            ]
            .concat()],
        ),
    ]
    .concat();
    let body = [
        element((0x0008, 0x0060), "CS", b"MR"),
        element((0x0028, 0x0002), "US", &short(1)),
        element((0x0028, 0x0004), "CS", b"MONOCHROME2"),
        element((0x0028, 0x0008), "IS", places.len().to_string().as_bytes()),
        element((0x0028, 0x0010), "US", &short(H as u16)),
        element((0x0028, 0x0011), "US", &short(W as u16)),
        element((0x0028, 0x0100), "US", &short(bits)),
        element((0x0028, 0x0101), "US", &short(bits)),
        element((0x0028, 0x0102), "US", &short(bits - 1)),
        element((0x0028, 0x0103), "US", &short(u16::from(bits == 16))),
        sequence((0x5200, 0x9229), &[shared]),
        sequence((0x5200, 0x9230), &(0..places.len()).map(group).collect::<Vec<_>>()),
        element((0x7fe0, 0x0010), "OW", pixels),
    ];
    file("1.2.840.10008.1.2.1", &body.concat())
}

#[test]
fn frames_of_a_file_are_in_order_of_their_places() {
    let pixels: Vec<u8> = [2, 0, 1].iter().flat_map(|&z| slice(z)).flat_map(|v| v.to_le_bytes()).collect();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.dcm");
    fs::write(&path, frames(&[6.0, 0.0, 3.0], 16, &pixels, &[0; 3])).unwrap();
    let (input, about) = read(&path, "--iso 11");
    assert_slices(&input, &[0, 1, 2], |v| v * 3 >= 11);
    assert_eq!(about.voxel, Some([0.25, 0.5, 3.0]));
    // Bits of segments, frames without a gap between them: twenty bits each.
    let solid = |i: usize, z: usize| value(i, z) >= 0;
    let mut bits = vec![0u8; (4 * W * H).div_ceil(8)];
    for (frame, z) in [1, 0, 7, 8].into_iter().enumerate() {
        for i in (0..W * H).filter(|&i| solid(i, z)) {
            let at = frame * W * H + i;
            bits[at / 8] |= 1 << (at % 8);
        }
    }
    fs::write(&path, frames(&[2.0, 0.0, 0.0, 2.0], 1, &bits, &[1, 1, 2, 2])).unwrap();
    let (input, about) = read(&path, "");
    assert_slices(&input, &[0, 1], |v| v >= 0);
    assert!(about.left_out.contains(&"1 of 2 segments: the first is read".to_owned()), "{:?}", about.left_out);
}

#[test]
fn what_cannot_be_read_is_named_and_damage_is_a_plain_error() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.dcm");
    let refused = |bytes: &[u8]| {
        fs::write(&path, bytes).unwrap();
        open(&path, &opts("--iso 1")).err().unwrap().to_string()
    };
    let packed = Slice { syntax: "1.2.840.10008.1.2.4.90", ..Slice::at(0.0, slice(0)) };
    assert!(refused(&packed.bytes()).contains("JPEG 2000 (1.2.840.10008.1.2.4.90)"));
    let mut color = Slice::at(0.0, slice(0)).bytes();
    let at = color.windows(11).position(|w| w == b"MONOCHROME1").unwrap();
    color[at..at + 12].copy_from_slice(b"YBR_FULL_422");
    assert!(refused(&color).contains("colours (YBR_FULL_422)"));
    let good = Slice::at(0.0, slice(0)).bytes();
    let go = |bytes: &[u8]| {
        fs::write(&path, bytes).unwrap();
        drop(open(&path, &opts("--iso 1")));
    };
    (0..good.len()).step_by(7).for_each(|n| go(&good[..n]));
    for at in (132..good.len() - 2 * W * H).step_by(3) {
        for new in [0, 0x7f, 0xff] {
            let mut bytes = good.clone();
            bytes[at] = new;
            go(&bytes);
        }
    }
}

#[test]
fn a_series_stands_on_its_feet_in_cubes() {
    let slices: Vec<Slice> = (0..3).map(|z| Slice::at(1.5 * z as f64, slice(z))).collect();
    let dir = folder(&slices);
    let pieces = open_pieces(dir.path(), &opts("--iso 11")).unwrap();
    // Columns run to the left, rows to the back, slices to the head; sides of 0.25, 0.5, 1.5 become cubes.
    assert_eq!(pieces.dims(), [W as u32, 3 * 6, H as u32 * 2]);
    let about = pieces.about();
    assert!(about.axes.contains("ImageOrientationPatient (stored as LPS)"), "{about}");
    assert_eq!(about.voxel, Some([0.25; 3]));
    let flat = open_pieces(dir.path(), &opts("--iso 11 --spacing as-is")).unwrap();
    let input = crate::model::pieces::whole(&*flat).unwrap();
    for (i, (x, z)) in (0..W * H).map(|i| (i, (i % W, i / W))) {
        for y in 0..3 {
            let found = input.columns.solid((W - 1 - x) as i64, y as i64, z as i64);
            assert_eq!(found, slice(y)[i] >= 11, "{x} {y} {z}");
        }
    }
}

#[test]
fn rle_of_other_than_a_segment_per_byte_is_refused() {
    let seed = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/seeds/dicom/rle");
    // Without the two bytes of flags.
    let good = fs::read(seed).unwrap().split_off(2);
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.dcm");
    let opened = |bytes: &[u8]| {
        fs::write(&path, bytes).unwrap();
        open(&path, &opts("--iso 1")).map_err(|e| e.to_string())
    };
    opened(&good).unwrap();
    // Segments, and that the first follows the head.
    let at = good.windows(8).position(|w| w[0] < 3 && w[1..] == [0, 0, 0, 64, 0, 0, 0]).unwrap();
    let mut wrong = good.clone();
    wrong[at] += 1;
    let e = opened(&wrong).err().unwrap();
    assert!(e.contains(&format!("RLE of {} segments; {} were expected", wrong[at], good[at])), "{e}");
}

/// Found by fuzzing: dicom-parser 0.10.1 takes what is left of a value for the next element.
#[test]
fn elements_of_parts_of_values_are_refused() {
    let read = |kind: &str, syntax: &'static str| {
        let mut slice = Slice::at(0.0, slice(0));
        slice.more = element((0x0028, 0x0106), kind, &[1, 0]);
        slice.syntax = syntax;
        let dir = folder(&[slice]);
        open(dir.path(), &opts("--iso 1")).map(drop).map_err(|e| e.to_string())
    };
    read("SS", "1.2.840.10008.1.2.1").unwrap();
    let e = read("SL", "1.2.840.10008.1.2.1").unwrap_err();
    assert!(e.contains("an element of 2 bytes") && e.contains("no whole number of values"), "{e}");
}
