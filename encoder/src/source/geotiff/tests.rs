//! Files made here, with the values that GDAL reads of them.

use std::io::Write;

use super::super::open_pieces;
use super::super::tests::{error, heights, opts, survives_changed_bytes, told};
use super::*;
use crate::model::pieces::whole;

/// A page: its tags (number, type, values), and chunks, an empty one being one that was never written.
#[derive(Clone, Default)]
pub(crate) struct MadePage {
    pub tags: Vec<(u16, u16, Vec<f64>)>,
    pub text: Vec<(u16, String)>,
    pub chunks: Vec<Vec<u8>>,
    tiled: bool,
}

#[derive(Clone, Copy, Default)]
pub(crate) struct Form {
    big_endian: bool,
    wide: bool,
}

const SHORT: u16 = 3;
const DOUBLE: u16 = 12;

impl MadePage {
    /// One strip of samples of so many bits: format 1 unsigned, 2 signed, 3 float.
    pub fn new(size: [u16; 2], bits: u16, format: u16, strip: Vec<u8>) -> MadePage {
        let short = |tag, v: u16| (tag, SHORT, vec![f64::from(v)]);
        let tags = vec![
            short(tags::WIDTH, size[0]),
            short(tags::HEIGHT, size[1]),
            short(tags::BITS, bits),
            short(tags::SAMPLE_FORMAT, format),
        ];
        MadePage { tags, chunks: vec![strip], ..MadePage::default() }
    }

    pub fn with(mut self, tag: u16, values: &[u16]) -> MadePage {
        self.tags.retain(|t| t.0 != tag);
        self.tags.push((tag, SHORT, values.iter().map(|&v| v.into()).collect()));
        self
    }

    pub fn doubles(mut self, tag: u16, values: &[f64]) -> MadePage {
        self.tags.push((tag, DOUBLE, values.to_vec()));
        self
    }

    pub fn says(mut self, tag: u16, text: &str) -> MadePage {
        self.text.push((tag, text.to_owned()));
        self
    }

    /// Tiles in place of the strip.
    fn tiles(mut self, side: u16, chunks: Vec<Vec<u8>>) -> MadePage {
        (self.chunks, self.tiled) = (chunks, true);
        self.with(tags::TILE_WIDTH, &[side]).with(tags::TILE_HEIGHT, &[side])
    }

    /// Pixels of 10 m from (500000, 4600000) on, in UTM zone 17.
    pub fn placed(self) -> MadePage {
        self.with(tags::GEO_KEYS, &[1, 1, 0, 2, 1024, 0, 1, 1, 3072, 0, 1, 32_617])
            .doubles(tags::PIXEL_SCALE, &[10.0, 10.0, 0.0])
            .doubles(tags::TIE_POINTS, &[0.0, 0.0, 0.0, 500_000.0, 4_600_000.0, 0.0])
    }
}

pub(crate) fn tiff(form: Form, pages: &[MadePage]) -> Vec<u8> {
    let Form { big_endian, wide } = form;
    let number = |v: u64, n: usize| match big_endian {
        true => v.to_be_bytes()[8 - n..].to_vec(),
        false => v.to_le_bytes()[..n].to_vec(),
    };
    let word = if wide { 8 } else { 4 };
    let mut out = if big_endian { b"MM".to_vec() } else { b"II".to_vec() };
    out.extend(number(if wide { 43 } else { 42 }, 2));
    out.extend(if wide { [number(8, 2), number(0, 2)].concat() } else { Vec::new() });
    let mut link = out.len();
    out.extend(number(0, word));
    for page in pages {
        let mut places = Vec::new();
        for chunk in &page.chunks {
            places.push(if chunk.is_empty() { 0 } else { out.len() as u64 });
            out.extend(chunk);
        }
        let mut entries: Vec<(u16, u16, u64, Vec<u8>)> = Vec::new();
        for (tag, kind, values) in &page.tags {
            let bytes = values.iter().flat_map(|&v| match *kind {
                SHORT => number(v as u64, 2),
                _ => number(v.to_bits(), 8),
            });
            entries.push((*tag, *kind, values.len() as u64, bytes.collect()));
        }
        for (tag, text) in &page.text {
            entries.push((*tag, 2, text.len() as u64 + 1, [text.as_bytes(), b"\0"].concat()));
        }
        let (offsets, counts) = match page.tiled {
            true => (tags::TILE_OFFSETS, tags::TILE_COUNTS),
            false => (tags::STRIP_OFFSETS, tags::STRIP_COUNTS),
        };
        let longs = |v: Vec<u64>| v.into_iter().flat_map(|v| number(v, word)).collect::<Vec<u8>>();
        let kind = if wide { 16 } else { 4 };
        let n = page.chunks.len() as u64;
        entries.push((offsets, kind, n, longs(places)));
        entries.push((counts, kind, n, longs(page.chunks.iter().map(|c| c.len() as u64).collect())));
        entries.sort_by_key(|e| e.0);
        let mut directory = number(entries.len() as u64, if wide { 8 } else { 2 });
        for (tag, kind, count, bytes) in entries {
            directory.extend([number(tag.into(), 2), number(kind.into(), 2), number(count, word)].concat());
            match bytes.len() <= word {
                true => directory.extend([&bytes[..], &vec![0; word - bytes.len()]].concat()),
                false => {
                    directory.extend(number(out.len() as u64, word));
                    out.extend(bytes);
                }
            }
        }
        let at = number(out.len() as u64, word);
        out[link..link + word].copy_from_slice(&at);
        out.extend(directory);
        link = out.len();
        out.extend(number(0, word));
    }
    out
}

fn little(pages: &[MadePage]) -> Vec<u8> {
    tiff(Form::default(), pages)
}

fn read_heights(bytes: &[u8], flags: &str) -> Vec<Option<u16>> {
    told("a.tif", bytes, flags).0
}

fn refused(bytes: &[u8], flags: &str) -> String {
    error("a.tif", bytes, flags)
}

fn bytes_of<const N: usize>(values: impl IntoIterator<Item = [u8; N]>) -> Vec<u8> {
    values.into_iter().flatten().collect()
}

fn some(values: &[u16]) -> Vec<Option<u16>> {
    values.iter().map(|&v| Some(v)).collect()
}

fn deflated(bytes: &[u8]) -> Vec<u8> {
    let mut out = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::default());
    out.write_all(bytes).unwrap();
    out.finish().unwrap()
}

#[test]
fn chunks_without_bytes_are_no_data_or_zero() {
    let tile = bytes_of(vec![7i16.to_le_bytes(); 256]);
    for (compression, packed) in [(1, tile.clone()), (8, deflated(&tile))] {
        let page = MadePage::new([32, 16], 16, 2, Vec::new()).with(tags::COMPRESSION, &[compression]);
        let page = page.tiles(16, vec![Vec::new(), packed]);
        let zero = read_heights(&little(std::slice::from_ref(&page)), "");
        assert_eq!([zero[0], zero[15], zero[16], zero[511]], [Some(0), Some(0), Some(7), Some(7)]);
        let none = read_heights(&little(&[page.says(tags::GDAL_NODATA, "-9999")]), "");
        assert_eq!([none[0], none[15], none[16], none[511]], [None, None, Some(7), Some(7)]);
    }
    // Floats are none where they are as near to the value as GDAL asks for.
    let of = |v: f64| MadePage::new([2, 1], 64, 3, bytes_of([v.to_le_bytes(), 5f64.to_le_bytes()]));
    for (v, none) in [(f64::from(1e20f32), true), (1e20 * (1.0 + 1e-6), false)] {
        let page = of(v).says(tags::GDAL_NODATA, "1e+20");
        match none {
            true => assert_eq!(read_heights(&little(&[page]), "--height-scale 1"), [None, Some(5)]),
            false => assert!(refused(&little(&[page]), "--height-scale 1").contains("the highest value")),
        }
    }
    // Strips, too; and all that was never written may be all there is.
    let page = MadePage::new([4, 2], 8, 1, Vec::new()).with(tags::ROWS_PER_STRIP, &[1]);
    let strips = MadePage { chunks: vec![vec![1, 2, 3, 4], Vec::new()], ..page.clone() };
    assert_eq!(read_heights(&little(&[strips]), ""), some(&[1, 2, 3, 4, 0, 0, 0, 0]));
    let none = MadePage { chunks: vec![Vec::new(); 2], ..page }.says(tags::GDAL_NODATA, "0");
    assert!(refused(&little(&[none]), "").contains("no pixel"));
}

#[test]
fn a_mask_page_empties_pixels() {
    let values: Vec<[u8; 4]> = [-32_767.0f32, 70.0, 80.0, -32_767.0, 90.0, 140.0].map(f32::to_le_bytes).to_vec();
    let map = MadePage::new([3, 2], 32, 3, bytes_of(values)).placed();
    let mask = MadePage::new([3, 2], 1, 1, vec![0b0110_0000, 0b0110_0000])
        .with(tags::NEW_SUBFILE_TYPE, &[4])
        .with(tags::PHOTOMETRIC, &[4]);
    let expected = [None, Some(7), Some(8), None, Some(9), Some(14)];
    let (found, about) = told("a.tif", &little(&[map.clone(), mask.clone()]), "");
    assert_eq!((found.as_slice(), about.left_out.len()), (&expected[..], 0));
    assert_eq!(about.values, Some([70.0, 140.0]));
    // As GDAL has it, the mask counts and a no-data value does not.
    let (found, about) = told("a.tif", &little(&[map.clone().says(tags::GDAL_NODATA, "70"), mask]), "");
    assert_eq!(found, expected);
    assert!(about.rule.contains("a mask says which pixels have data, not the no-data value 70"), "{about}");
    // A mask of an overview is none of the picture; what is further there is named.
    let overview = MadePage::new([1, 1], 32, 3, vec![0; 4]).with(tags::NEW_SUBFILE_TYPE, &[1]);
    let its_mask = MadePage::new([1, 1], 1, 1, vec![0]).with(tags::NEW_SUBFILE_TYPE, &[5]);
    let (found, about) = told("a.tif", &little(&[map.clone(), overview, its_mask, map]), "--nodata -32767");
    assert_eq!((found.as_slice(), about.left_out.join(", ").as_str()), (&expected[..], "1 overview, 1 further page"));
}

#[test]
fn scale_offset_and_unit_of_gdal_are_honoured() {
    let values = bytes_of([-3498i16, 0, 3500, -32_768].map(i16::to_le_bytes));
    let xml = r#"<GDALMetadata>
        <Item name="OFFSET" sample="0" role="offset">100</Item>
        <Item name="SCALE" sample="0" role="scale">0.01</Item>
        <Item name="SCALE" sample="1" role="scale">7</Item></GDALMetadata>"#;
    let page = MadePage::new([4, 1], 16, 2, values).placed().says(tags::GDAL_METADATA, xml);
    let (found, about) = told("a.tif", &little(&[page.says(tags::GDAL_NODATA, "-32768")]), "");
    assert_eq!(found, [Some(7), Some(10), Some(14), None]);
    assert!(about.rule.contains("stored values × 0.01 + 100"), "{about}");
    let feet = r#"<GDALMetadata><Item name="UNITTYPE" sample="0" role="unittype">ft</Item></GDALMetadata>"#;
    let page = MadePage::new([2, 1], 16, 2, bytes_of([10i16, 1000].map(i16::to_le_bytes))).placed();
    let (found, about) = told("a.tif", &little(&[page.clone().says(tags::GDAL_METADATA, feet)]), "");
    assert_eq!((found, about.unit.as_str()), (some(&[0, 30]), "m"));
    assert!(about.rule.contains("values in ft"), "{about}");
    let kelvin = feet.replace("ft<", "K &amp; more<");
    let (_, about) = told("a.tif", &little(&[page.says(tags::GDAL_METADATA, &kelvin)]), "");
    assert!(about.rule.contains("values are in K & more, no length") && about.voxel.is_none(), "{about}");
}

#[test]
fn values_are_those_stored_whatever_their_form() {
    let expected = some(&[0, 1, 7, 12]);
    let white = |page: MadePage| page.with(tags::PHOTOMETRIC, &[0]);
    let u8s = MadePage::new([4, 1], 8, 1, vec![0, 1, 7, 12]);
    let f32s = MadePage::new([4, 1], 32, 3, bytes_of([0f32, 1.0, 7.0, 12.0].map(f32::to_le_bytes)));
    let i16s = MadePage::new([4, 1], 16, 2, bytes_of([0i16, 1, 7, 12].map(i16::to_le_bytes)));
    for page in [white(u8s.clone()), white(f32s.clone()), white(i16s.clone()), u8s.clone(), f32s.clone()] {
        assert_eq!(read_heights(&little(&[page]), "--height-scale 1"), expected);
    }
    for page in [
        MadePage::new([4, 1], 4, 1, vec![0x01, 0x7c]),
        MadePage::new([4, 1], 12, 1, vec![0x00, 0x00, 0x01, 0x00, 0x70, 0x0c]),
        MadePage::new([4, 1], 16, 3, bytes_of([0u16, 0x3c00, 0x4700, 0x4a00].map(u16::to_le_bytes))),
        MadePage::new([4, 1], 64, 3, bytes_of([0f64, 1.0, 7.0, 12.0].map(f64::to_le_bytes))),
        MadePage::new([4, 1], 64, 2, bytes_of([0i64, 1, 7, 12].map(i64::to_le_bytes))),
        MadePage::new([4, 1], 8, 1, [0, 1, 7, 12].map(u8::reverse_bits).to_vec()).with(tags::FILL_ORDER, &[2]),
    ] {
        assert_eq!(read_heights(&little(&[page]), "--height-scale 1"), expected);
    }
    for wide in [false, true] {
        let big = MadePage::new([4, 1], 16, 2, bytes_of([0i16, 1, 7, 12].map(i16::to_be_bytes)));
        assert_eq!(read_heights(&tiff(Form { big_endian: true, wide }, &[big]), "--height-scale 1"), expected);
        assert_eq!(
            read_heights(&tiff(Form { big_endian: false, wide }, std::slice::from_ref(&i16s)), "--height-scale 1"),
            expected
        );
    }
    // Of 24 bits: packed whole numbers, and floats in the file's order.
    let numbers = MadePage::new([4, 1], 24, 1, vec![0, 0, 0, 0, 0, 1, 0, 0, 7, 0, 0, 12]);
    assert_eq!(read_heights(&little(std::slice::from_ref(&numbers)), "--height-scale 1"), expected);
    let big = Form { big_endian: true, wide: false };
    assert!(refused(&tiff(big, &[numbers]), "").contains("24 in little-endian files alone"));
    let floats = [0u32, 0x3f_0000, 0x41_c000, 0x42_8000];
    let page = MadePage::new([4, 1], 24, 3, floats.iter().flat_map(|v| v.to_le_bytes()[..3].to_vec()).collect());
    assert_eq!(read_heights(&little(&[page]), "--height-scale 1"), expected);
    let page = MadePage::new([4, 1], 24, 3, floats.iter().flat_map(|v| v.to_be_bytes()[1..].to_vec()).collect());
    assert_eq!(read_heights(&tiff(big, &[page]), "--height-scale 1"), expected);
    let complex = MadePage::new([1, 1], 64, 6, vec![0; 8]);
    assert!(refused(&little(&[complex]), "").contains("complex values"));
}

#[test]
fn fax_is_read_with_and_without_marks() {
    let bits = |text: &str| -> Vec<u8> {
        let digits: Vec<u8> = text.bytes().filter(u8::is_ascii_digit).map(|b| b - b'0').collect();
        digits.chunks(8).map(|byte| byte.iter().enumerate().fold(0, |v, (i, b)| v | b << (7 - i))).collect()
    };
    // Rows of 3 white and 5 black pixels, of white ones, and of 1 black and 7 white ones.
    let (first, second, third) = ("1000 0011", "10011", "00110101 010 1111");
    let expected = some(&[0, 0, 0, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0]);
    let by = |compression: u16, strip: Vec<u8>| {
        let page = MadePage::new([8, 3], 1, 1, strip).with(tags::COMPRESSION, &[compression]);
        read_heights(&little(&[page]), "--height-scale 1")
    };
    let huffman = [bits(first), bits(second), bits(third)].concat();
    assert_eq!(by(2, huffman.clone()), expected);
    let mark = "000000000001";
    assert_eq!(by(3, bits(&format!("{mark}{first}{mark}{second}{mark}{third}"))), expected);
    assert_eq!(by(3, bits(&format!("{mark}{first}{mark}{second}{mark}{third}{}", mark.repeat(6)))), expected);
    // Group 4, each row by its runs, the last but for what is like the row above.
    assert_eq!(by(4, bits(&format!("001 {first} 001 {second} 0000110111 001 00110101 010 1"))), expected);
    let short = MadePage::new([8, 3], 1, 1, huffman[..2].to_vec()).with(tags::COMPRESSION, &[2]);
    assert!(refused(&little(&[short]), "").contains("2 bytes of 3"));
    let flat = MadePage::new([8, 3], 8, 1, huffman).with(tags::COMPRESSION, &[2]);
    assert!(refused(&little(&[flat]), "").contains("CCITT fax of 8 bits"));
    let two = MadePage::new([8, 3], 1, 1, vec![0; 9]).with(tags::COMPRESSION, &[3]).with(tags::T4_OPTIONS, &[1]);
    assert!(refused(&little(&[two]), "").contains("two dimensions"));
}

#[test]
fn every_compression_and_predictor_gives_the_same_values() {
    let values: Vec<u16> = (0..24).map(|i| i * i / 2).collect();
    let plain: Vec<u8> = bytes_of(values.iter().map(|v| v.to_le_bytes()));
    let expected = some(&values);
    let by = |compression: u16, predictor: u16, bits: u16, format: u16, strip: Vec<u8>| {
        let page = MadePage::new([6, 4], bits, format, strip).with(tags::COMPRESSION, &[compression]);
        read_heights(&little(&[page.with(tags::PREDICTOR, &[predictor])]), "--height-scale 1")
    };
    let lzw = |b: &[u8]| weezl::encode::Encoder::with_tiff_size_switch(weezl::BitOrder::Msb, 8).encode(b).unwrap();
    // A literal run, then a repeat of one byte: 24 · 2 bytes.
    let pack_bits = |b: &[u8]| [&[b.len() as u8 - 1], b].concat();
    assert_eq!(by(32_773, 1, 16, 1, pack_bits(&plain)), expected);
    assert_eq!(by(32_773, 1, 8, 1, vec![0, 9, 235, 7, 0x80, 0, 5]), some(&[&[9][..], &[7; 22], &[5]].concat()));
    assert_eq!(by(5, 1, 16, 1, lzw(&plain)), expected);
    assert_eq!(by(8, 1, 16, 1, deflated(&plain)), expected);
    assert_eq!(by(32_946, 1, 16, 1, deflated(&plain)), expected);
    assert_eq!(by(50_000, 1, 16, 1, zstd::encode_all(&plain[..], 3).unwrap()), expected);
    let differences = bytes_of(values.chunks(6).flat_map(|row| {
        (0..6).map(|i| if i == 0 { row[0] } else { row[i].wrapping_sub(row[i - 1]) }.to_le_bytes()).collect::<Vec<_>>()
    }));
    assert_eq!(by(8, 2, 16, 1, deflated(&differences)), expected);
    // Beside other compressions the predictor's tag does not count.
    assert_eq!(by(1, 2, 16, 1, plain.clone()), expected);
    assert_eq!(by(32_773, 3, 16, 1, pack_bits(&plain)), expected);
    // Floats: the most significant bytes of a row first, then differences of bytes.
    let mut shuffled = Vec::new();
    for row in values.chunks(6) {
        let mut planes: Vec<u8> =
            (0..4).flat_map(|k| row.iter().map(move |&v| f32::from(v).to_be_bytes()[k])).collect();
        (1..planes.len()).rev().for_each(|i| planes[i] = planes[i].wrapping_sub(planes[i - 1]));
        shuffled.extend(planes);
    }
    assert_eq!(by(8, 3, 32, 3, deflated(&shuffled)), expected);
    let page = |compression: u16| MadePage::new([6, 4], 16, 1, plain.clone()).with(tags::COMPRESSION, &[compression]);
    let blob = |valid: lerc::bitmask::BitMask| {
        let data = lerc::SampleData::F32(values.iter().map(|&v| v.into()).collect());
        let image = lerc::Image {
            width: 6,
            height: 4,
            data_type: lerc::DataType::Float,
            valid_masks: vec![valid],
            data,
            ..lerc::Image::default()
        };
        lerc::encode(&image, lerc::Precision::Lossless).unwrap()
    };
    let whole = blob(lerc::bitmask::BitMask::all_valid(24));
    assert_eq!(by(34_887, 1, 32, 3, whole.clone()), expected);
    // In a file of the other byte order, libtiff packs values with their bytes turned about.
    let turned = lerc::Image {
        width: 6,
        height: 4,
        data_type: lerc::DataType::UShort,
        valid_masks: vec![lerc::bitmask::BitMask::all_valid(24)],
        data: lerc::SampleData::U16(values.iter().map(|v| v.swap_bytes()).collect()),
        ..lerc::Image::default()
    };
    let turned = lerc::encode(&turned, lerc::Precision::Lossless).unwrap();
    let page_of = MadePage::new([6, 4], 16, 1, turned).with(tags::COMPRESSION, &[34_887]);
    let big = Form { big_endian: true, wide: false };
    assert_eq!(read_heights(&tiff(big, &[page_of]), "--height-scale 1"), expected);
    // A float that is no number that way is lost: no height, rather than one of 0.
    let heights = values.iter().map(|&v| f32::from_bits(f32::from(v).to_bits().swap_bytes()));
    let mut mask = lerc::bitmask::BitMask::all_valid(24);
    mask.set_invalid(5);
    let turned = lerc::Image {
        width: 6,
        height: 4,
        data_type: lerc::DataType::Float,
        valid_masks: vec![mask],
        data: lerc::SampleData::F32(heights.collect()),
        ..lerc::Image::default()
    };
    let turned = lerc::encode(&turned, lerc::Precision::Lossless).unwrap();
    let page_of = MadePage::new([6, 4], 32, 3, turned).with(tags::COMPRESSION, &[34_887]);
    let found = read_heights(&tiff(big, &[page_of]), "--height-scale 1");
    assert_eq!(found[..5], expected[..5]);
    assert_eq!((found[5], &found[6..]), (None, &expected[6..]));
    let twice = |method: u16, strip: Vec<u8>| {
        let page = MadePage::new([6, 4], 32, 3, strip).with(tags::COMPRESSION, &[34_887]);
        read_heights(&little(&[page.with(tags::LERC_PARAMETERS, &[4, method])]), "--height-scale 1")
    };
    assert_eq!(twice(1, deflated(&whole)), expected);
    assert_eq!(twice(2, zstd::encode_all(&whole[..], 3).unwrap()), expected);
    let mut holes = lerc::bitmask::BitMask::all_valid(24);
    holes.set_invalid(5);
    assert_eq!(by(34_887, 1, 32, 3, blob(holes))[4..7], [expected[4], None, expected[6]]);
    for (compression, name) in [(50_001, "WebP"), (34_925, "LZMA"), (4711, "not known")] {
        let e = refused(&little(&[page(compression)]), "");
        assert!(e.contains(name) && e.contains("deflate"), "{e}");
    }
}

#[test]
fn of_several_bands_the_first_is_read_and_alpha_empties_pixels() {
    let bands = |page: MadePage, n: u16| page.with(tags::SAMPLES, &[n]).with(tags::BITS, &[8; 3][..usize::from(n)]);
    let chunky =
        bands(MadePage::new([2, 2], 8, 1, vec![1, 9, 9, 2, 9, 9, 3, 9, 9, 4, 9, 9]), 3).with(tags::PHOTOMETRIC, &[1]);
    let (found, about) = told("a.tif", &little(std::slice::from_ref(&chunky)), "");
    assert_eq!((found, about.left_out), (some(&[1, 2, 3, 4]), vec!["bands 2 to 3 of 3".to_owned()]));
    let planar =
        MadePage { chunks: vec![vec![1, 2, 3, 4], vec![9; 4], vec![9; 4]], ..chunky.clone() }.with(tags::PLANAR, &[2]);
    assert_eq!(read_heights(&little(&[planar]), ""), some(&[1, 2, 3, 4]));
    let alpha = bands(MadePage::new([2, 2], 8, 1, vec![1, 255, 2, 0, 3, 1, 4, 255]), 2).with(tags::EXTRA_SAMPLES, &[2]);
    let (found, about) = told("a.tif", &little(&[alpha]), "");
    assert_eq!((found, about.left_out.len()), (vec![Some(1), None, Some(3), Some(4)], 0));
    let e = refused(&little(&[chunky.clone().with(tags::PHOTOMETRIC, &[2])]), "");
    assert!(e.contains("no heights") && e.contains("--rgb"), "{e}");
    let (found, about) =
        told("a.tif", &little(&[MadePage::new([2, 1], 8, 1, vec![1, 2]).with(tags::ORIENTATION, &[3])]), "");
    assert!(found == some(&[1, 2]) && about.left_out[0].contains("orientation 3"), "{about}");
    let palette = MadePage::new([2, 1], 8, 1, vec![1, 2]).with(tags::PHOTOMETRIC, &[3]);
    assert!(refused(&little(&[palette]), "").contains("palette"));
    // Colours that code heights: 8000.1 m by Mapbox's formula.
    let rgb = bands(MadePage::new([2, 1], 8, 1, vec![2, 191, 33, 0, 0, 0]), 3).with(tags::PHOTOMETRIC, &[2]);
    assert_eq!(read_heights(&little(&[rgb]), "--rgb mapbox --height-scale 1"), [Some(8000), None]);
}

#[test]
fn a_raster_that_is_not_north_up_is_turned() {
    let values = bytes_of([10i16, 20, 30, 40, 50, 60].map(i16::to_le_bytes));
    let keys = [1u16, 1, 0, 2, 1024, 0, 1, 1, 3072, 0, 1, 32_617];
    let by = |a: f64, b: f64, d: f64, e: f64| {
        let mut matrix = [0.0; 16];
        (matrix[0], matrix[1], matrix[3]) = (a, b, 5e5);
        (matrix[4], matrix[5], matrix[7]) = (d, e, 4e6);
        let page = MadePage::new([3, 2], 16, 2, values.clone()).with(tags::GEO_KEYS, &keys);
        told("a.tif", &little(&[page.doubles(tags::TRANSFORMATION, &matrix)]), "")
    };
    let (found, about) = by(2.0, 0.0, 0.0, -2.0);
    assert_eq!(
        (found, about.axes.as_str()),
        (some(&[5, 10, 15, 20, 25, 30]), "columns are x (east), rows are z (south)")
    );
    assert_eq!((about.crs.as_str(), about.voxel), ("EPSG:32617", Some([2.0; 3])));
    let (found, about) = by(2.0, 0.0, 0.0, 2.0);
    assert_eq!(found, some(&[20, 25, 30, 5, 10, 15]));
    assert_eq!(about.affine.unwrap()[1], [0.0, 0.0, -2.0, 4_000_004.0]);
    let (found, about) = by(-2.0, 0.0, 0.0, -2.0);
    assert_eq!(found, some(&[15, 10, 5, 30, 25, 20]));
    assert_eq!(about.affine.unwrap()[0], [2.0, 0.0, 0.0, 5e5 - 6.0]);
    let (found, about) = by(1.2, 1.6, 1.6, -1.2);
    assert_eq!(found, some(&[5, 10, 15, 20, 25, 30]));
    assert!(about.axes.contains("turned by 53.13 degrees"), "{about}");
}

#[test]
fn what_a_tiff_claims_is_held_against_its_bytes() {
    let page = MadePage::new([60_000, 60_000], 32, 3, vec![1, 2, 3]);
    assert!(refused(&little(std::slice::from_ref(&page)), "").contains("cannot hold"));
    let never = page.with(tags::ROWS_PER_STRIP, &[60_000]);
    assert!(refused(&little(&[MadePage { chunks: vec![Vec::new()], ..never }]), "").contains("cannot hold"));
    for compression in [1, 2, 3, 4, 8, 50_000] {
        let tile = MadePage::new([1, 1], 1, 1, Vec::new()).with(tags::COMPRESSION, &[compression]);
        let tile = tile.tiles(65_535, vec![vec![0xff; 9]]);
        assert!(refused(&little(&[tile]), "").contains("cannot hold"), "compression {compression}");
    }
    let mut endless = little(&[MadePage::new([2, 1], 8, 1, vec![1, 2])]);
    let (n, first) = (endless.len(), endless[4..8].to_vec());
    endless[n - 4..].copy_from_slice(&first);
    assert!(refused(&endless, "").contains("comes back"));
    let short = MadePage::new([4, 4], 16, 1, vec![0; 20]);
    assert!(refused(&little(&[short]), "").contains("strip 0 at byte 8: 20 bytes of 32"));
    let values = bytes_of([10i16, 20, 30, 40, 50, 60].map(i16::to_le_bytes));
    let xml = r#"<Item name="SCALE" sample="0" role="scale">0.5</Item>"#;
    let mask = MadePage::new([3, 2], 1, 1, vec![0x60, 0x60]).with(tags::NEW_SUBFILE_TYPE, &[4]);
    let page = MadePage::new([3, 2], 16, 2, deflated(&values)).with(tags::COMPRESSION, &[8]).placed();
    survives_changed_bytes("a.tif", &little(&[page.says(tags::GDAL_METADATA, xml), mask]), "");
}

/// The map of a folder of such files.
fn folder(files: &[(&str, Vec<u8>)], flags: &str) -> Result<(Vec<Option<u16>>, About)> {
    let dir = tempfile::tempdir().unwrap();
    for (name, bytes) in files {
        fs::write(dir.path().join(name), bytes).unwrap();
    }
    let world = open_pieces(dir.path(), &opts(flags))?;
    Ok((heights(&whole(&*world)?), world.about()))
}

/// A tile of 10 m pixels in a zone of UTM whose corner is `x` pixels east and `y` south of a place.
fn tile(zone: u16, [x, y]: [f64; 2], size: [u16; 2], values: &[i16], xml: &str) -> Vec<u8> {
    let page = MadePage::new(size, 16, 2, bytes_of(values.iter().map(|v| v.to_le_bytes())))
        .with(tags::GEO_KEYS, &[1, 1, 0, 2, 1024, 0, 1, 1, 3072, 0, 1, 32_600 + zone])
        .doubles(tags::PIXEL_SCALE, &[10.0, 10.0, 0.0])
        .doubles(tags::TIE_POINTS, &[0.0, 0.0, 0.0, 5e5 + 10.0 * x, 4e6 - 10.0 * y, 0.0])
        .says(tags::GDAL_NODATA, "-9999");
    little(&[if xml.is_empty() { page } else { page.says(tags::GDAL_METADATA, xml) }])
}

#[test]
fn no_data_of_a_tile_hides_no_other() {
    let west = tile(17, [0.0, 0.0], [3, 2], &[10, 20, 30, 40, 50, 60], "");
    // A collar without data over what the first tile covers, and one height that differs from the first's.
    let east = tile(17, [1.0, 0.0], [3, 2], &[-9999, -9999, 70, 990, -9999, 80], "");
    let (found, about) = folder(&[("a.tif", west.clone()), ("b.tif", east.clone())], "").unwrap();
    assert_eq!(found, some(&[1, 2, 3, 7, 4, 5, 6, 8]));
    assert_eq!(about.values, Some([10.0, 80.0]));
    assert_eq!(about.left_out, ["1 heights that differ from those of an earlier tile at their place"]);
    assert_eq!((about.format.as_str(), about.crs.as_str()), ("2 tiles, GeoTIFF", "EPSG:32617"));
    assert!(!about.rule.contains("without data"), "{about}");
    // The other order: the first by name that has data.
    let (found, about) = folder(&[("2.tif", west), ("1.tif", east)], "").unwrap();
    assert_eq!(found, some(&[1, 2, 3, 7, 4, 99, 6, 8]));
    assert_eq!(about.affine.unwrap()[0], [10.0, 0.0, 0.0, 5e5]);
}

#[test]
fn tiles_that_are_no_one_grid_are_refused_by_name() {
    let values = [10, 20, 30, 40, 50, 60];
    let first = tile(17, [0.0, 0.0], [3, 2], &values, "");
    let with = |second: Vec<u8>| folder(&[("a.tif", first.clone()), ("b.tif", second)], "");
    let refused = |second: Vec<u8>, words: &[&str]| {
        let e = with(second).err().unwrap().to_string();
        assert!(words.iter().all(|w| e.contains(w)), "{e}");
    };
    refused(tile(18, [3.0, 0.0], [3, 2], &values, ""), &["b.tif", "EPSG:32618", "a.tif EPSG:32617", "warp"]);
    let feet = r#"<Item name="UNITTYPE" sample="0" role="unittype">ft</Item>"#;
    refused(tile(17, [3.0, 0.0], [3, 2], &values, feet), &["b.tif", "heights in ft", "in m"]);
    let place = |scale: f64, matrix: &[f64]| {
        let page = MadePage::new([3, 2], 16, 2, bytes_of(values.map(i16::to_le_bytes)))
            .with(tags::GEO_KEYS, &[1, 1, 0, 2, 1024, 0, 1, 1, 3072, 0, 1, 32_617]);
        let page = match matrix.is_empty() {
            true => page
                .doubles(tags::PIXEL_SCALE, &[scale, scale, 0.0])
                .doubles(tags::TIE_POINTS, &[0.0, 0.0, 0.0, 500_030.0, 4e6, 0.0]),
            false => page.doubles(tags::TRANSFORMATION, matrix),
        };
        little(&[page])
    };
    refused(place(5.0, &[]), &["b.tif", "the size of pixels", "5.0", "10.0"]);
    let turned = [8.0, 6.0, 0.0, 5e5, 6.0, -8.0, 0.0, 4e6, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    refused(place(0.0, &turned), &["b.tif", "turned by 36.87 degrees"]);
    // South-up tiles are turned, and tiles between the pixels of the first are said.
    let south_up = [10.0, 0.0, 0.0, 500_030.0, 0.0, 10.0, 0.0, 3_999_980.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    assert_eq!(with(place(0.0, &south_up)).unwrap().0, some(&[1, 2, 3, 4, 5, 6, 4, 5, 6, 1, 2, 3]));
    let (found, about) = with(tile(17, [3.4, 0.0], [3, 2], &values, "")).unwrap();
    assert_eq!(found, some(&[1, 2, 3, 1, 2, 3, 4, 5, 6, 4, 5, 6]));
    assert_eq!(about.left_out, ["0.40 pixels by which tiles lie off the grid of the first"]);
    // Far apart: no world of mostly nothing.
    refused(tile(17, [1e9, 1e9], [3, 2], &values, ""), &["columns"]);
}

#[test]
fn srtm_and_esri_tiles_make_a_map_too() {
    let text = |x: u32, v: u32| {
        format!("ncols 2\nnrows 1\nxllcorner {x}\nyllcorner 4000000\ncellsize 10\nNODATA_value -1\n{v} -1\n")
            .into_bytes()
    };
    let (found, about) = folder(&[("a.asc", text(500_000, 30)), ("b.asc", text(500_020, 50))], "").unwrap();
    assert_eq!((found, about.format.as_str()), (vec![Some(3), None, Some(5), None], "2 tiles, ESRI ASCII grid"));
    // What lies beside and is not read is said.
    let (_, about) = folder(&[("a.asc", text(500_000, 30)), ("b.asc.gz", vec![0]), ("c.png", vec![0])], "").unwrap();
    assert_eq!(about.left_out, ["1 packed (.gz) files in the folder", "1 PNG or JPEG files in the folder"]);
    let e = folder(&[("a.hgt.gz", vec![0]), ("b.hgt.gz", vec![0])], "").err().unwrap().to_string();
    assert!(e.contains("2 tiles packed by gzip; unpack them first"), "{e}");
    // Both sides of the 180th meridian.
    let samples = |v: i16| bytes_of(vec![v.to_be_bytes(); 9]);
    let (found, about) =
        folder(&[("N00E179.hgt", samples(7)), ("N00W180.hgt", samples(9))], "--height-scale 1").unwrap();
    assert_eq!(found[..5], some(&[7, 7, 7, 9, 9]));
    assert_eq!(about.affine.unwrap()[0], [0.5, 0.0, 0.0, 178.75]);
}

#[test]
fn a_world_file_places_a_picture() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.tif");
    fs::write(&path, little(&[MadePage::new([2, 1], 16, 2, bytes_of([100i16, 200].map(i16::to_le_bytes)))])).unwrap();
    fs::write(dir.path().join("a.tfw"), "20\n0\n0\n-20\n500010\n3999990\n").unwrap();
    fs::write(dir.path().join("a.tif.aux.xml"), "<PAMDataset/>").unwrap();
    let world = open_pieces(&path, &opts("")).unwrap();
    let about = world.about();
    assert_eq!(heights(&whole(&*world).unwrap()), some(&[5, 10]));
    assert_eq!(about.affine.unwrap()[0], [20.0, 0.0, 0.0, 5e5]);
    assert_eq!(about.left_out, ["a.tif.aux.xml beside it"]);
}

/// Colours of a map's columns, row by row.
fn draped(dir: &Path, heights: &[u8], colors: &[u8]) -> Result<(Vec<[u8; 3]>, About)> {
    let (map, picture) = (dir.join("heights.tif"), dir.join("ortho.tif"));
    fs::write(&map, heights).unwrap();
    fs::write(&picture, colors).unwrap();
    let world = open_pieces(&map, &ReadOptions { colors: Some(picture), ..ReadOptions::default() })?;
    let crate::Colors::Column(colors) = whole(&*world)?.colors else { panic!("a colour a column") };
    Ok((colors, world.about()))
}

#[test]
fn colours_are_laid_on_by_coordinates() {
    let dir = tempfile::tempdir().unwrap();
    let form = Form::default();
    // Heights: 4 × 3 pixels of 10 m; colours: 6 × 8 of 5 m, that begin 10 m west and 5 m south of them. A colour says its place.
    let map = tiff(form, &[MadePage::new([4, 3], 8, 1, vec![5; 12]).placed()]);
    let strip: Vec<u8> = (0..8u8).flat_map(|z| (0..6u8).flat_map(move |x| [x * 10, z * 10, 200])).collect();
    let rgb = |crs: u16| {
        MadePage::new([6, 8], 8, 1, strip.clone())
            .with(tags::SAMPLES, &[3])
            .with(tags::PHOTOMETRIC, &[2])
            .with(tags::GEO_KEYS, &[1, 1, 0, 2, 1024, 0, 1, 1, 3072, 0, 1, crs])
            .doubles(tags::PIXEL_SCALE, &[5.0, 5.0, 0.0])
            .doubles(tags::TIE_POINTS, &[0.0, 0.0, 0.0, 499_990.0, 4_599_995.0, 0.0])
    };
    let (colors, about) = draped(dir.path(), &map, &tiff(form, &[rgb(32_617)])).unwrap();
    // The middle of column 0 is 15 m from the west of the colours, that of row 0 on their north edge.
    let at = |x: usize, z: usize| colors[z * 4 + x];
    assert_eq!([at(0, 0), at(1, 0), at(0, 1), at(1, 2)], [[30, 0, 200], [50, 0, 200], [30, 20, 200], [50, 40, 200]]);
    assert_eq!([at(2, 0), at(3, 2)], [[128; 3]; 2], "beyond the colours");
    assert!(about.left_out.iter().any(|l| l.contains("colours of 50.0 % of the columns")), "{:?}", about.left_out);
    // Another reference system, and another place.
    let refused = |of: Vec<u8>| draped(dir.path(), &map, &of).unwrap_err().to_string();
    assert!(refused(tiff(form, &[rgb(32_618)])).contains("colours lie in EPSG:32618, heights in EPSG:32617"));
    let mut far = rgb(32_617);
    far.tags.retain(|t| t.0 != tags::TIE_POINTS);
    let far = far.doubles(tags::TIE_POINTS, &[0.0, 0.0, 0.0, 400_000.0, 4_599_995.0, 0.0]);
    assert!(refused(tiff(form, &[far])).contains("lies elsewhere"));
    // Without a place, pixel by pixel: 4 of 6 across, 3 of 8 down.
    let mut nowhere = rgb(32_617);
    nowhere.tags.retain(|t| ![tags::TIE_POINTS, tags::PIXEL_SCALE, tags::GEO_KEYS].contains(&t.0));
    let (colors, _) = draped(dir.path(), &map, &tiff(form, &[nowhere])).unwrap();
    assert_eq!([colors[0], colors[3], colors[11]], [[0, 10, 200], [50, 10, 200], [50, 60, 200]]);
}

#[test]
fn colour_maps_are_grey_of_a_palette_planar_and_of_16_bits_too() {
    let dir = tempfile::tempdir().unwrap();
    let map = tiff(Form::default(), &[MadePage::new([2, 1], 8, 1, vec![5; 2])]);
    let page = |bits, strip: Vec<u8>, photometric| {
        MadePage::new([2, 1], bits, 1, strip).with(tags::PHOTOMETRIC, &[photometric])
    };
    let colors = |page: MadePage| draped(dir.path(), &map, &tiff(Form::default(), &[page])).map(|(colors, _)| colors);
    assert_eq!(colors(page(8, vec![7, 9], 1)).unwrap(), [[7; 3], [9; 3]]);
    assert_eq!(colors(page(8, vec![7, 9], 0)).unwrap(), [[248; 3], [246; 3]]);
    let wide = [257u16, 514, 771, 1028, 1285, 65_535].iter().flat_map(|v| v.to_le_bytes()).collect();
    assert_eq!(colors(page(16, wide, 2).with(tags::SAMPLES, &[3])).unwrap(), [[1, 2, 3], [4, 5, 255]]);
    let mut planar = page(8, vec![1, 2], 2).with(tags::SAMPLES, &[3]).with(tags::PLANAR, &[2]);
    planar.chunks = vec![vec![1, 2], vec![3, 4], vec![5, 6]];
    assert_eq!(colors(planar).unwrap(), [[1, 3, 5], [2, 4, 6]]);
    let mut palette = vec![0u16; 768];
    (palette[7], palette[256 + 7], palette[512 + 7], palette[9]) = (0x1122, 0x3344, 0x5566, 0xff00);
    assert_eq!(
        colors(page(8, vec![7, 9], 3).with(tags::COLOR_MAP, &palette)).unwrap(),
        [[0x11, 0x33, 0x55], [255, 0, 0]]
    );
    assert!(
        colors(page(8, vec![7, 9], 3))
            .unwrap_err()
            .to_string()
            .contains("tag 320: 0 numbers of a palette, 768 expected")
    );
    let floats = [1f32, 2.0].iter().flat_map(|v| v.to_le_bytes()).collect();
    let mut float = MadePage::new([2, 1], 32, 3, floats);
    float = float.with(tags::PHOTOMETRIC, &[1]);
    assert!(colors(float).unwrap_err().to_string().contains("samples of 32 bits (Float) are no colours"));
}
