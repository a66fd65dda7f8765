//! TIFF files made here, tag by tag, so that each says just what is to be seen.

use std::fs;
use std::path::Path;

use super::super::tests::{error, opts, read};
use super::super::{ReadOptions, open, open_pieces};
use crate::{Input, source};

const W: usize = 23;
const H: usize = 17;

/// A value of a volume whose slices all differ.
fn value(x: usize, y: usize, z: usize) -> u8 {
    let v = (x * 37 + y * 101 + z * 59 + x * y * z) % 251;
    if v < 120 { 0 } else { v as u8 }
}

fn slice(z: usize) -> Vec<u8> {
    (0..W * H).map(|i| value(i % W, i / W, z)).collect()
}

/// A directory: tags with their values, and the bytes of its one strip.
#[derive(Clone, Default)]
struct Dir {
    tags: Vec<(u16, Tag)>,
    strip: Vec<u8>,
}

#[derive(Clone)]
enum Tag {
    Short(Vec<u16>),
    Long(Vec<u32>),
    Text(String),
    Ratio(u32, u32),
    Bytes(Vec<u8>),
}

impl Dir {
    fn new(bits: u16, strip: Vec<u8>) -> Dir {
        let tags = vec![
            (256, Tag::Long(vec![W as u32])),
            (257, Tag::Long(vec![H as u32])),
            (258, Tag::Short(vec![bits])),
            (259, Tag::Short(vec![1])),
            (262, Tag::Short(vec![1])),
            (277, Tag::Short(vec![1])),
            (278, Tag::Long(vec![H as u32])),
        ];
        Dir { tags, strip }
    }

    fn with(mut self, tag: u16, value: Tag) -> Dir {
        self.tags.retain(|t| t.0 != tag);
        self.tags.push((tag, value));
        self
    }

    fn text(self, text: &str) -> Dir {
        self.with(270, Tag::Text(text.to_owned()))
    }
}

fn slices() -> Vec<Dir> {
    (0..6).map(|z| Dir::new(8, slice(z))).collect()
}

/// A file of these directories; what follows the last strip is `after`.
fn tiff(big: bool, dirs: &[Dir], after: &[u8]) -> Vec<u8> {
    let two = |v: u16| if big { v.to_be_bytes() } else { v.to_le_bytes() };
    let four = |v: u32| if big { v.to_be_bytes() } else { v.to_le_bytes() };
    let mut out = [if big { &b"MM"[..] } else { b"II" }, &two(42), &four(8)].concat();
    for (i, dir) in dirs.iter().enumerate() {
        let mut tags = dir.tags.clone();
        let has_strip = tags.iter().any(|t| t.0 == 273);
        let n = tags.len() + if has_strip { 0 } else { 2 };
        let mut at = out.len() + 2 + 12 * n + 4;
        let mut heap = Vec::new();
        // Values first, then the strip.
        let mut place = |kind: u16, count: usize, bytes: Vec<u8>| {
            let mut entry = [&two(kind)[..], &four(count as u32)].concat();
            if bytes.len() <= 4 {
                entry.extend(&bytes);
                entry.resize(10, 0);
            } else {
                entry.extend(four(at as u32));
                at += bytes.len() + bytes.len() % 2;
                heap.extend(&bytes);
                heap.resize(heap.len() + bytes.len() % 2, 0);
            }
            entry
        };
        let mut entries: Vec<(u16, Vec<u8>)> = tags
            .drain(..)
            .map(|(tag, value)| {
                (
                    tag,
                    match value {
                        Tag::Short(v) => place(3, v.len(), v.iter().flat_map(|&v| two(v)).collect()),
                        Tag::Long(v) => place(4, v.len(), v.iter().flat_map(|&v| four(v)).collect()),
                        Tag::Text(s) => place(2, s.len() + 1, [s.as_bytes(), b"\0"].concat()),
                        Tag::Ratio(a, b) => place(5, 1, [four(a), four(b)].concat()),
                        Tag::Bytes(b) => place(7, b.len(), b),
                    },
                )
            })
            .collect();
        let strip = at;
        if !has_strip {
            entries.push((273, [&two(4)[..], &four(1), &four(strip as u32)].concat()));
            entries.push((279, [&two(4)[..], &four(1), &four(dir.strip.len() as u32)].concat()));
        }
        entries.sort_by_key(|e| e.0);
        out.extend(two(n as u16));
        entries.iter().for_each(|(tag, entry)| out.extend([&two(*tag)[..], entry].concat()));
        let end = strip + dir.strip.len() + dir.strip.len() % 2;
        out.extend(four(if i + 1 < dirs.len() { end as u32 } else { 0 }));
        out.extend(heap);
        out.extend(&dir.strip);
        out.resize(end - if i + 1 < dirs.len() { 0 } else { dir.strip.len() % 2 }, 0);
    }
    out.extend(after);
    out
}

/// What is said of a file beside its voxels.
fn about(bytes: &[u8], flags: &str) -> crate::About {
    // Voxels as they are stored.
    let flags = &format!("{flags} --spacing as-is");
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.tif");
    fs::write(&path, bytes).unwrap();
    let pieces = open_pieces(&path, &opts(flags)).unwrap();
    // The same as from memory.
    let input = super::super::pieces::whole(&*pieces).unwrap();
    assert_eq!(input.columns, read("a.tif", bytes, flags).columns);
    pieces.about()
}

fn assert_slices(input: &Input, zs: &[usize]) {
    assert_eq!(input.columns.dims(), [W as u32, H as u32, zs.len() as u32]);
    for (i, &z) in zs.iter().enumerate() {
        for (x, y) in (0..W).flat_map(|x| (0..H).map(move |y| (x, y))) {
            assert_eq!(input.columns.solid(x as i64, y as i64, i as i64), value(x, y, z) > 0, "{x} {y} {i}");
        }
    }
}

#[test]
fn pages_without_a_place_are_a_stack() {
    for big in [false, true] {
        assert_slices(&read("a.tif", &tiff(big, &slices(), &[]), ""), &[0, 1, 2, 3, 4, 5]);
    }
    // A flag of height maps makes it one.
    assert_eq!(read("a.tif", &tiff(false, &slices(), &[]), "--height-scale 1").columns.nz(), H as u32);
    let mut placed = slices();
    placed[0] = placed[0].clone().with(34_735, Tag::Short(vec![1, 1, 0, 0]));
    assert_eq!(read("a.tif", &tiff(false, &placed, &[]), "").columns.nz(), H as u32);
    assert_slices(&read("a.tif", &tiff(false, &placed, &[]), "--format stack"), &[0, 1, 2, 3, 4, 5]);
    let one = tiff(false, &slices()[..1], &[]);
    assert_eq!(read("a.tif", &one, "").columns.nz(), H as u32);
    assert_slices(&read("a.tif", &one, "--format stack"), &[0]);
}

#[test]
fn smaller_copies_and_masks_are_no_slices() {
    let mut dirs = slices();
    let small = Dir::new(8, vec![9; 60]).with(256, Tag::Long(vec![10])).with(257, Tag::Long(vec![6]));
    dirs.push(small.clone().with(254, Tag::Long(vec![1])));
    dirs.insert(3, Dir::new(8, slice(0)).with(254, Tag::Long(vec![4])));
    let bytes = tiff(false, &dirs, &[]);
    assert_slices(&read("a.tif", &bytes, "--format stack"), &[0, 1, 2, 3, 4, 5]);
    assert_eq!(about(&bytes, "").left_out, ["2 smaller copies or masks"]);
    // Without a word of its own, a page of another size is none.
    let bytes = tiff(false, &[slices(), vec![small]].concat(), &[]);
    assert_slices(&read("a.tif", &bytes, ""), &[0, 1, 2, 3, 4, 5]);
    assert_eq!(about(&bytes, "").left_out, ["1 pages unlike the first (10 × 6 of 8 bits)"]);
}

#[test]
fn imagej_stacks_with_one_directory_are_whole() {
    let rest: Vec<u8> = (1..6).flat_map(slice).collect();
    let text = "ImageJ=1.53t\nimages=6\nslices=6\nloop=false\n";
    let first = Dir::new(8, slice(0)).text(text);
    let bytes = tiff(true, std::slice::from_ref(&first), &rest);
    assert_slices(&read("a.tif", &bytes, "--format stack"), &[0, 1, 2, 3, 4, 5]);
    assert_slices(&read("a.tif", &bytes, ""), &[0, 1, 2, 3, 4, 5]);
    let e = error("a.tif", &bytes[..bytes.len() - 1], "--format stack");
    assert!(e.contains("6 slices from byte") && e.contains("ends after 5"), "{e}");
    // Found by fuzzing: slices said to stand beyond the end.
    let beyond = first.with(273, Tag::Long(vec![1 << 20])).with(279, Tag::Long(vec![(W * H) as u32]));
    let e = error("a.tif", &tiff(true, &[beyond], &[]), "--format stack");
    assert!(e.contains("ends after 0"), "{e}");
    // Of channels, the first of each slice.
    let first = Dir::new(8, slice(0)).text("ImageJ=1.53t\nimages=6\nchannels=2\nslices=3\nhyperstack=true\n");
    let bytes = tiff(true, &[first], &rest);
    assert_slices(&read("a.tif", &bytes, ""), &[0, 2, 4]);
    assert_eq!(about(&bytes, "").left_out, ["1 of 2 channels: the first is read"]);
}

#[test]
fn imagej_hyperstacks_are_their_first_channel_and_time_in_the_order_stated() {
    let text = "ImageJ=1.53t\nimages=6\nchannels=2\nslices=3\n";
    let file = |text: &str| {
        let mut dirs = slices();
        dirs[0] = dirs[0].clone().text(text).with(282, Tag::Ratio(5, 1)).with(283, Tag::Ratio(5, 1));
        tiff(true, &dirs, &[])
    };
    let bytes = file(&format!("{text}unit=\\u00B5m\nspacing=0.5\n"));
    assert_slices(&read("a.tif", &bytes, "--format stack --iso 1 --spacing as-is"), &[0, 2, 4]);
    let said = about(&bytes, "");
    assert_eq!(said.left_out[0], "1 of 2 channels: the first is read");
    assert_eq!((said.voxel, said.unit.as_str(), said.format.as_str()), (Some([0.2, 0.2, 0.5]), "µm", "ImageJ TIFF"));
    assert_slices(
        &read("a.tif", &file(&format!("{text}order=zct\n")), "--format stack --iso 1 --spacing as-is"),
        &[0, 1, 2],
    );
    let times = file("ImageJ=1.53t\nimages=6\nslices=2\nframes=3\n");
    assert_slices(&read("a.tif", &times, "--iso 1 --spacing as-is"), &[0, 1]);
    assert_eq!(about(&times, "").left_out, ["2 of 3 times: the first is read"]);
    let channels = file("ImageJ=1.53t\nimages=6\nchannels=6\n");
    assert_slices(&read("a.tif", &channels, "--iso 1 --spacing as-is"), &[0]);
    assert_eq!(about(&channels, "").left_out, ["5 of 6 channels: the first is read"]);
    let short = file("ImageJ=1.53t\nimages=12\nchannels=4\nslices=3\n");
    let e = error("a.tif", &short, "--format stack");
    assert!(e.contains("12 pages by its description, the file has 6"), "{e}");
}

#[test]
fn imagej_calibration_of_values_is_applied() {
    let bytes: Vec<u8> = [0u16, 32_768, 32_769, 40_000].iter().flat_map(|v| v.to_be_bytes()).collect();
    let dir = Dir::new(16, bytes).with(256, Tag::Long(vec![4])).with(257, Tag::Long(vec![1]));
    let dir = dir.text("ImageJ=1.53t\nimages=1\ncf=0\nc0=-32768.0\nc1=1.0\nvunit=Gray Value\n");
    let input = read("a.tif", &tiff(true, &[dir], &[]), "--format stack --iso 1");
    assert_eq!((0..4).map(|x| input.columns.solid(x, 0, 0)).collect::<Vec<_>>(), [false, false, true, true]);
}

#[test]
fn ome_xml_says_which_page_is_which() {
    let ome = |order: &str, sizes: [usize; 3], data: &str| {
        let [z, c, t] = sizes;
        format!(
            r#"<?xml version="1.0" encoding="UTF-8"?><OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06" UUID="urn:uuid:1"><Image ID="Image:0"><Pixels ID="Pixels:0" DimensionOrder="{order}" Type="uint8" SizeX="23" SizeY="17" SizeZ="{z}" SizeC="{c}" SizeT="{t}" PhysicalSizeX="0.5" PhysicalSizeY="0.5" PhysicalSizeZ="2" PhysicalSizeZUnit="µm">{data}</Pixels></Image></OME>"#
        )
    };
    let file = |text: &str| {
        let mut dirs = slices();
        dirs[0] = dirs[0].clone().text(text);
        tiff(false, &dirs, &[])
    };
    let all = r#"<TiffData IFD="0" PlaneCount="6"/>"#;
    assert_slices(&read("a.tif", &file(&ome("XYZCT", [3, 2, 1], all)), "--iso 1 --spacing as-is"), &[0, 1, 2]);
    assert_slices(&read("a.tif", &file(&ome("XYCZT", [3, 2, 1], all)), "--iso 1 --spacing as-is"), &[0, 2, 4]);
    assert_slices(
        &read("a.tif", &file(&ome("XYTZC", [3, 1, 2], "<TiffData/>")), "--iso 1 --spacing as-is"),
        &[0, 2, 4],
    );
    assert_slices(&read("a.tif", &file(&ome("XYCZT", [3, 2, 1], "")), "--iso 1 --spacing as-is"), &[0, 2, 4]);
    // Planes by name, in any order.
    let data: String =
        [5, 3, 1].iter().enumerate().map(|(z, ifd)| format!(r#"<TiffData FirstZ="{z}" IFD="{ifd}"/>"#)).collect();
    let named = file(&ome("XYZCT", [3, 1, 1], &data));
    assert_slices(&read("a.tif", &named, "--iso 1 --spacing as-is"), &[5, 3, 1]);
    let said = about(&file(&ome("XYZCT", [3, 2, 1], all)), "");
    assert_eq!((said.voxel, said.unit.as_str(), said.format.as_str()), (Some([0.5, 0.5, 2.0]), "µm", "OME-TIFF"));
    assert_eq!(said.left_out[0], "1 of 2 channels: the first is read");
    let nanometres =
        ome("XYZCT", [3, 2, 1], all).replace(r#"Z="2" PhysicalSizeZUnit="µm""#, r#"Z="2000" PhysicalSizeZUnit="nm""#);
    let said = about(&file(&nanometres), "");
    assert_eq!((said.voxel, said.unit.as_str()), (Some([0.5, 0.5, 2.0]), "µm"));
    let pixels = about(&file(&nanometres.replace("\"nm\"", "\"pixel\"")), "");
    assert!(pixels.voxel.is_none() && pixels.left_out.iter().any(|l| l.contains("2000 pixel are drawn as cubes")));
    let e = error("a.tif", &file(&ome("XYZCT", [9, 1, 1], r#"<TiffData IFD="0" PlaneCount="9"/>"#)), "--format stack");
    assert!(e.contains("a slice is in page 6, the file has 6"), "{e}");
    let e = error("a.tif", &file(&ome("XYZCT", [3, 1, 1], r#"<TiffData FirstZ="2" IFD="0"/>"#)), "--format stack");
    assert!(e.contains("1 of 3 slices have a place"), "{e}");

    // Over two files.
    let dir = tempfile::tempdir().unwrap();
    let data: String = (0..3)
        .map(|z| {
            let (name, ifd, uuid) = if z == 1 { ("b.tif", 0, 2) } else { ("a.tif", z, 1) };
            format!(r#"<TiffData FirstZ="{z}" IFD="{ifd}"><UUID FileName="{name}">urn:uuid:{uuid}</UUID></TiffData>"#)
        })
        .collect();
    let path = dir.path().join("a.tif");
    fs::write(&path, file(&ome("XYZCT", [3, 1, 1], &data))).unwrap();
    let e = open(&path, &opts("--format stack")).err().unwrap().to_string();
    assert!(e.contains("b.tif: cannot open"), "{e}");
    fs::write(dir.path().join("b.tif"), tiff(false, &slices()[4..], &[])).unwrap();
    assert_slices(&open(&path, &opts("--iso 1 --spacing as-is")).unwrap(), &[0, 4, 2]);
    assert_slices(&open(dir.path(), &opts("--iso 1 --spacing as-is")).unwrap(), &[0, 4, 2]);
}

#[test]
fn tifffile_shapes_and_scifio_axes_are_those_of_the_pages() {
    let file = |text: &str| {
        let mut dirs = slices();
        dirs[0] = dirs[0].clone().text(text);
        tiff(false, &dirs, &[])
    };
    assert_slices(&read("a.tif", &file(r#"{"shape": [6, 17, 23]}"#), ""), &[0, 1, 2, 3, 4, 5]);
    assert_slices(&read("a.tif", &file(r#"{"shape": [2, 3, 17, 23]}"#), ""), &[0, 1, 2]);
    assert_slices(&read("a.tif", &file(r#"{"shape": [3, 2, 17, 23], "axes": "ZCYX"}"#), ""), &[0, 2, 4]);
    assert_slices(&read("a.tif", &file(r#"{"shape": [2, 3, 17, 23], "axes": "TZYX"}"#), ""), &[0, 1, 2]);
    let more = file(r#"{"shape": [4, 17, 23]}"#);
    assert_slices(&read("a.tif", &more, ""), &[0, 1, 2, 3]);
    assert_eq!(about(&more, "").left_out, ["2 further pages"]);
    let scifio = file("SCIFIO=0.9\nimages=6\naxes=X,Y,Channel,Z\nlengths=23,17,3,2\n");
    assert_slices(&read("a.tif", &scifio, ""), &[0, 3]);
}

#[test]
fn lsm_and_metamorph_count_their_slices() {
    let words = [0x0040_0494u32, 200, W as u32, H as u32, 3, 1, 2, 1, 0, 0];
    let mut info: Vec<u8> = words.iter().flat_map(|w| w.to_le_bytes()).collect();
    info.extend([1e-7f64, 1e-7, 5e-7].iter().flat_map(|v| v.to_le_bytes()));
    let mut dirs = slices();
    dirs[0] = dirs[0].clone().with(34_412, Tag::Bytes(info));
    let bytes = tiff(false, &dirs, &[]);
    assert_slices(&read("a.lsm", &bytes, "--iso 1 --spacing as-is"), &[0, 1, 2]);
    assert_eq!(about(&bytes, "").voxel, Some([0.1, 0.1, 0.5]));
    let rest: Vec<u8> = (1..6).flat_map(slice).collect();
    // As many quotients as there are planes, thrice as long as TIFF has them.
    let first = Dir::new(8, slice(0)).with(33_629, Tag::Long(vec![0; 6]));
    assert_slices(&read("a.stk", &tiff(false, &[first], &rest), ""), &[0, 1, 2, 3, 4, 5]);
}

#[test]
fn values_of_white_is_zero_are_those_stored() {
    let white: Vec<Dir> = slices().into_iter().map(|d| d.with(262, Tag::Short(vec![0]))).collect();
    assert_slices(&read("a.tif", &tiff(false, &white, &[]), ""), &[0, 1, 2, 3, 4, 5]);
    for (bits, format) in [(16, 1), (16, 2), (32, 1), (32, 2), (32, 3), (64, 3), (16, 3)] {
        let of = |v: u8| -> Vec<u8> {
            match (bits, format) {
                (16, 3) => (if v > 0 { 0x4900u16 } else { 0 }).to_le_bytes().to_vec(),
                (16, _) => u16::from(v).to_le_bytes().to_vec(),
                (32, 3) => f32::from(v).to_le_bytes().to_vec(),
                (32, _) => u32::from(v).to_le_bytes().to_vec(),
                _ => f64::from(v).to_le_bytes().to_vec(),
            }
        };
        let dirs: Vec<Dir> = (0..2)
            .map(|z| {
                let strip = slice(z).into_iter().flat_map(of).collect();
                Dir::new(bits, strip).with(339, Tag::Short(vec![format])).with(262, Tag::Short(vec![0]))
            })
            .collect();
        assert_slices(&read("a.tif", &tiff(false, &dirs, &[]), "--iso 1"), &[0, 1]);
    }
}

/// Values of so many bits, most significant first, each row from a byte on.
fn packed(bits: usize, values: &[u64]) -> Vec<u8> {
    let rows = values.chunks(W).map(|row| {
        let mut out = vec![0u8; (W * bits).div_ceil(8)];
        for (i, v) in row.iter().enumerate() {
            for b in 0..bits {
                let at = i * bits + b;
                out[at / 8] |= ((v >> (bits - 1 - b) & 1) as u8) << (7 - at % 8);
            }
        }
        out
    });
    rows.flatten().collect()
}

#[test]
fn samples_of_any_number_of_bits_are_read() {
    for bits in 1..=31 {
        let top = (1u64 << bits) - 1;
        for big in [false, true] {
            let whole = |v: u8| if v > 0 { top } else { top / 2 };
            let values: Vec<u64> = slice(2).into_iter().map(whole).collect();
            let strip = match (bits, big) {
                (8 | 16, false) => {
                    let size = bits as usize / 8;
                    values.iter().flat_map(|v| v.to_le_bytes()[..size].to_vec()).collect()
                }
                _ => packed(bits as usize, &values),
            };
            let dir = Dir::new(bits, strip.clone());
            if (bits, big) == (24, true) {
                let e = error("a.tif", &tiff(big, &[dir], &[]), "--format stack --iso 1");
                assert!(e.contains("24 in little-endian files alone"), "{e}");
                continue;
            }
            let input =
                read("a.tif", &tiff(big, std::slice::from_ref(&dir), &[]), &format!("--format stack --iso {top}"));
            assert_slices(&input, &[2]);
            // The least bit first in each byte.
            let turned = Dir { strip: strip.iter().map(|b| b.reverse_bits()).collect(), ..dir.clone() };
            let turned = turned.with(266, Tag::Short(vec![2]));
            let input = read("a.tif", &tiff(big, &[turned], &[]), &format!("--format stack --iso {top}"));
            assert_slices(&input, &[2]);
            // With a sign, all ones are −1.
            let signed = dir.with(339, Tag::Short(vec![2]));
            let input = read("a.tif", &tiff(big, &[signed], &[]), "--format stack --iso -1");
            let below = |x, y| value(x, y, 2) > 0 || top / 2 > 0 || bits == 1;
            for (x, y) in (0..W).flat_map(|x| (0..H).map(move |y| (x, y))) {
                assert_eq!(input.columns.solid(x as i64, y as i64, 0), below(x, y), "{bits} bits, {x} {y}");
            }
        }
    }
    let mask = Dir::new(1, packed(1, &slice(1).iter().map(|&v| u64::from(v > 0)).collect::<Vec<_>>()));
    assert_slices(&read("a.tif", &tiff(false, &[mask.clone(), mask], &[]), ""), &[1, 1]);
}

#[test]
fn codecs_give_what_was_packed() {
    let zlib = |bytes: &[u8]| {
        let mut out = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::default());
        std::io::Write::write_all(&mut out, bytes).unwrap();
        out.finish().unwrap()
    };
    let lzw =
        |bytes: &[u8]| weezl::encode::Encoder::with_tiff_size_switch(weezl::BitOrder::Msb, 8).encode(bytes).unwrap();
    // Runs of one value, and of many.
    let pack_bits = |bytes: &[u8]| -> Vec<u8> {
        bytes
            .chunk_by(|a, b| a == b)
            .flat_map(|run| run.chunks(128))
            .flat_map(|run| if run.len() > 1 { vec![(257 - run.len()) as u8, run[0]] } else { vec![0, run[0]] })
            .collect()
    };
    let zstd = |bytes: &[u8]| zstd::bulk::compress(bytes, 3).unwrap();
    type Pack<'a> = &'a dyn Fn(&[u8]) -> Vec<u8>;
    let codecs: [(u16, Pack<'_>); 6] =
        [(5, &lzw), (8, &zlib), (32_946, &zlib), (32_773, &pack_bits), (50_000, &zstd), (34_926, &zstd)];
    let slice = slice(3);
    for (code, pack) in codecs {
        let dir = Dir::new(8, pack(&slice)).with(259, Tag::Short(vec![code]));
        assert_slices(&read("a.tif", &tiff(false, std::slice::from_ref(&dir), &[]), "--format stack"), &[3]);
        if code == 32_773 {
            continue;
        }
        // Each what it is more than the one before.
        let wide: Vec<u16> = slice.iter().map(|&v| u16::from(v) * 200).collect();
        let differences = |big: bool| -> Vec<u8> {
            let rows = wide.chunks(W).flat_map(|row| {
                (0..W).map(|i| row[i].wrapping_sub(if i > 0 { row[i - 1] } else { 0 })).collect::<Vec<_>>()
            });
            rows.flat_map(|v| if big { v.to_be_bytes() } else { v.to_le_bytes() }).collect()
        };
        for big in [false, true] {
            let dir = Dir::new(16, pack(&differences(big))).with(259, Tag::Short(vec![code]));
            let dir = dir.with(317, Tag::Short(vec![2]));
            assert_slices(&read("a.tif", &tiff(big, &[dir], &[]), "--format stack --iso 1"), &[3]);
        }
        // Bytes of floats apart.
        let shuffled: Vec<u8> = slice
            .chunks(W)
            .flat_map(|row| {
                let bytes: Vec<[u8; 4]> = row.iter().map(|&v| f32::from(v).to_be_bytes()).collect();
                let flat: Vec<u8> = (0..4).flat_map(|k| bytes.iter().map(move |b| b[k])).collect();
                (0..flat.len()).map(|i| flat[i].wrapping_sub(if i > 0 { flat[i - 1] } else { 0 })).collect::<Vec<_>>()
            })
            .collect();
        let dir = Dir::new(32, pack(&shuffled)).with(259, Tag::Short(vec![code])).with(317, Tag::Short(vec![3]));
        let dir = dir.with(339, Tag::Short(vec![3]));
        assert_slices(&read("a.tif", &tiff(false, &[dir], &[]), "--format stack --iso 1"), &[3]);
    }
    for (code, name) in
        [(6, "JPEG as TIFF 6.0"), (34_712, "JPEG 2000"), (34_925, "LZMA"), (50_001, "WebP"), (99, "not known")]
    {
        let dir = Dir::new(8, slice.clone()).with(259, Tag::Short(vec![code]));
        let e = error("a.tif", &tiff(false, &[dir], &[]), "--format stack");
        assert!(e.contains(name) && e.contains("rewrite the file with deflate"), "{e}");
    }
}

#[test]
fn lerc_is_read_and_what_it_masks_is_air() {
    let values: Vec<f32> = slice(3).iter().map(|&v| f32::from(v)).collect();
    let mut mask = lerc::bitmask::BitMask::all_valid(W * H);
    mask.set_invalid(5);
    let blob = |mask: lerc::bitmask::BitMask| {
        let image = lerc::Image {
            width: W as u32,
            height: H as u32,
            data_type: lerc::DataType::Float,
            valid_masks: vec![mask],
            data: lerc::SampleData::F32(values.clone()),
            ..lerc::Image::default()
        };
        lerc::encode(&image, lerc::Precision::Lossless).unwrap()
    };
    let file = |blob: Vec<u8>, more: u32| {
        let dir = Dir::new(32, blob).with(259, Tag::Short(vec![34_887])).with(339, Tag::Short(vec![3]));
        tiff(false, &[dir.with(50_674, Tag::Long(vec![4, more]))], &[])
    };
    let whole = blob(lerc::bitmask::BitMask::all_valid(W * H));
    assert_slices(&read("a.tif", &file(whole.clone(), 0), "--format stack --iso 1"), &[3]);
    assert_slices(&read("a.tif", &file(zstd::bulk::compress(&whole, 3).unwrap(), 2), "--format stack --iso 1"), &[3]);
    let input = read("a.tif", &file(blob(mask), 0), "--format stack --iso -1");
    assert!(!input.columns.solid(5, 0, 0) && input.columns.solid(4, 0, 0));
    for n in 0..whole.len() {
        let _ = source::read(Path::new("a.tif"), &file(whole[..n].to_vec(), 0), &opts("--format stack --iso 1"));
    }
}

#[test]
fn strips_and_tiles_that_were_never_written_are_zero() {
    // Two strips of rows 0..9 and 9..17, the second of no bytes.
    let dir = Dir::new(8, slice(0)).with(278, Tag::Long(vec![9]));
    let file = |at: u32| {
        let dir = dir.clone().with(273, Tag::Long(vec![at, 0])).with(279, Tag::Long(vec![(9 * W) as u32, 0]));
        tiff(false, &[Dir { strip: Vec::new(), ..dir }], &slice(0))
    };
    let bytes = file((file(0).len() - W * H) as u32);
    let input = read("a.tif", &bytes, "--format stack");
    for (x, y) in (0..W).flat_map(|x| (0..H).map(move |y| (x, y))) {
        assert_eq!(input.columns.solid(x as i64, y as i64, 0), y < 9 && value(x, y, 0) > 0, "{x} {y}");
    }
}

#[test]
fn of_colours_the_brightness_and_of_samples_the_first_is_read() {
    let grey: Vec<u8> = slice(1).iter().flat_map(|&v| [v; 3]).collect();
    let rgb = |strip: Vec<u8>| {
        Dir::new(8, strip)
            .with(258, Tag::Short(vec![8; 3]))
            .with(262, Tag::Short(vec![2]))
            .with(277, Tag::Short(vec![3]))
    };
    let bytes = tiff(false, &[rgb(grey.clone()), rgb(grey)], &[]);
    assert_slices(&read("a.tif", &bytes, ""), &[1, 1]);
    assert_eq!(about(&bytes, "").left_out, ["colours: their brightness is the value"]);
    let two: Vec<u8> = slice(1).iter().flat_map(|&v| [v, 255]).collect();
    let dir = Dir::new(8, two).with(258, Tag::Short(vec![8; 2])).with(277, Tag::Short(vec![2]));
    let bytes = tiff(false, &[dir.clone(), dir], &[]);
    assert_slices(&read("a.tif", &bytes, ""), &[1, 1]);
    assert_eq!(about(&bytes, "").left_out, ["1 of 2 samples of each pixel: the first is read"]);
    // Channels of an ImageJ file that are samples have no pages of their own.
    let two: Vec<u8> = slice(1).iter().flat_map(|&v| [v, 255]).collect();
    let dir = Dir::new(8, two).with(258, Tag::Short(vec![8; 2])).with(277, Tag::Short(vec![2]));
    let first = dir.clone().text("ImageJ=1.53t\nimages=2\nchannels=2\nslices=2\n");
    assert_slices(&read("a.tif", &tiff(false, &[first, dir], &[]), ""), &[1, 1]);
}

#[test]
fn damaged_stacks_are_plain_errors() {
    let mut dirs = slices();
    dirs[0] =
        dirs[0].clone().text("ImageJ=1.53t\nimages=6\nslices=6\nspacing=1\nunit=um\n").with(282, Tag::Ratio(1, 1));
    let good = tiff(true, &dirs[..2], &[]);
    let flags = opts("--format stack --iso 1");
    let go = |bytes: &[u8], flags: &ReadOptions| drop(source::read(Path::new("a.tif"), bytes, flags));
    for n in 0..good.len() {
        go(&good[..n], &flags);
    }
    for at in 0..good.len() - 2 * W * H {
        for new in [0, 1, 0x7f, 0x80, 0xff] {
            let mut bytes = good.clone();
            bytes[at] = new;
            go(&bytes, &flags);
            go(&bytes, &opts("--iso 1"));
        }
    }
    // A chain without an end.
    let mut bytes = tiff(false, &slices()[..1], &[]);
    let next = 8 + 2 + 12 * 9;
    bytes[next..next + 4].copy_from_slice(&8u32.to_le_bytes());
    assert!(error("a.tif", &bytes, "--format stack").contains("comes back to this one"));
    let e =
        error("a.tif", &tiff(false, &[Dir::new(8, slice(0)).with(339, Tag::Short(vec![5]))], &[]), "--format stack");
    assert!(e.contains("complex values"), "{e}");
}

#[test]
fn folders_of_pictures_are_stacks_by_number() {
    let dir = tempfile::tempdir().unwrap();
    let grey = |z: usize| image::GrayImage::from_raw(W as u32, H as u32, slice(z)).unwrap();
    grey(2).save(dir.path().join("s10.png")).unwrap();
    grey(0).save(dir.path().join("s2.png")).unwrap();
    image::DynamicImage::ImageLuma8(grey(1)).into_rgba8().save(dir.path().join("s3.png")).unwrap();
    fs::write(dir.path().join("._s1.png"), b"what a Mac leaves").unwrap();
    let pieces = open_pieces(dir.path(), &opts("")).unwrap();
    let said = pieces.about();
    assert_slices(&super::super::pieces::whole(&*pieces).unwrap(), &[0, 1, 2]);
    assert_eq!(said.left_out, ["colours of 1 images: their brightness is the value", "transparency of 1 images"]);
    // Sixteen bits are sixteen bits.
    let dir = tempfile::tempdir().unwrap();
    for z in 0..3 {
        let wide = image::ImageBuffer::from_fn(W as u32, H as u32, |x, y| {
            image::Luma([u16::from(value(x as usize, y as usize, z)) * 257])
        });
        image::DynamicImage::ImageLuma16(wide).save(dir.path().join(format!("{z}.png"))).unwrap();
    }
    assert_slices(&open(dir.path(), &opts("--iso 256")).unwrap(), &[0, 1, 2]);
    image::GrayImage::new(3, 3).save(dir.path().join("3.png")).unwrap();
    let e = open(dir.path(), &opts("--iso 256")).err().unwrap().to_string();
    assert!(e.contains("page 3 of the stack is [3, 3]"), "{e}");
}
