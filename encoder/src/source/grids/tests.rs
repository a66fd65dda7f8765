use super::super::tests::{error, refuses_every_prefix_but, survives_changed_bytes, told};

fn some(values: &[u16]) -> Vec<Option<u16>> {
    values.iter().map(|&v| Some(v)).collect()
}

#[test]
fn esri_grids_are_read_in_all_their_spellings() {
    let text =
        b"ncols 3\nnrows 2\nxllcorner 500000\nyllcorner 4000000\ncellsize 10\nNODATA_value -1\n10 20 -1\n40 50.4 6e1\n";
    let (found, about) = told("a.asc", text, "");
    assert_eq!(found, [Some(1), Some(2), None, Some(4), Some(5), Some(6)]);
    assert_eq!((about.format.as_str(), about.voxel), ("ESRI ASCII grid", Some([10.0; 3])));
    assert_eq!(about.affine.unwrap()[1], [0.0, 0.0, -10.0, 4_000_020.0]);
    assert!(about.rule.contains("coordinates taken as metres"), "{about}");
    let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    std::io::Write::write_all(&mut packed, text).unwrap();
    let packed = packed.finish().unwrap();
    assert_eq!(told("a.asc.gz", &packed, "").0, found);
    assert_eq!(told("a.gz", &packed, "").0, found);
    // Centres, capitals, commas, line ends anywhere, the default for no data.
    let text = b"NCOLS 3\r\nNROWS 2\r\nXLLCENTER 5,0\r\nYLLCENTER 5\r\nDX 10\r\nDY 10\r\n10 20\r\n-9999 40 50,4\r\n60";
    let (found, about) = told("b.txt", text, "");
    assert_eq!(found, [Some(1), Some(2), None, Some(4), Some(5), Some(6)]);
    assert_eq!(about.affine.unwrap()[0], [10.0, 0.0, 0.0, 0.0]);
    // Degrees: cells of a thousandth near the equator.
    let degrees = b"ncols 2\nnrows 1\nxllcorner 7\nyllcorner 0\ncellsize 0.001\n1113 0 7 8";
    let (found, about) = told("c.asc", degrees, "");
    assert_eq!(found, some(&[10, 0]));
    assert!(
        about.rule.contains("coordinates taken as degrees")
            && about.left_out == ["what follows the grid, from byte 62 on"],
        "{about}"
    );
    for (text, what) in [
        (
            "ncols 3\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 10\n1 2 3 4 5",
            "byte 61: ESRI ASCII grid: it ends in row 1, column 2",
        ),
        ("ncols 3\nnrows 1\nxllcorner 0\nyllcorner 0\ncellsize 10\n1 x 3", "\"x\" in row 0, column 1"),
        ("ncols 30000\nnrows 30000\nxllcorner 0\nyllcorner 0\ncellsize 10\n1 2 3", "30000 × 30000 cells in"),
        ("ncols 3\nnrows 1\nxllcorner 0\ncellsize 10\n1 2 3", "no yllcorner"),
        ("ncols 3\nnrows 1\nxllcorner 0\nyllcorner 0\ncellsize 0\n1 2 3", "cells of 0 × 0"),
    ] {
        let e = error("a.asc", text.as_bytes(), "");
        assert!(e.contains(what), "{e}");
    }
    survives_changed_bytes("a.asc", degrees, "");
}

#[test]
fn srtm_tiles_lie_where_their_names_say() {
    // Heights 30.92 m apart at the equator: three seconds are 92.77 m.
    let mut samples = vec![928i16; 1201 * 1201];
    samples[0] = -32_768;
    samples[1] = 0;
    let bytes: Vec<u8> = samples.iter().flat_map(|v| v.to_be_bytes()).collect();
    let (found, about) = told("s01w002.hgt", &bytes, "");
    assert_eq!((found.len(), &found[..3]), (1201 * 1201, &[None, Some(0), Some(10)][..]));
    let affine = about.affine.unwrap();
    let half = 0.5 / 1200.0;
    assert!((affine[0][3] - (-2.0 - half)).abs() < 1e-9 && (affine[1][3] - half).abs() < 1e-9, "{affine:?}");
    assert_eq!((about.crs.as_str(), about.format.as_str()), ("EPSG:4326", "SRTM HGT"));
    let (_, about) = told("tile.hgt", &bytes, "");
    assert!(about.rule.contains("the name says no place") && about.affine.is_none(), "{about}");
    assert!(error("N00E000.hgt", &bytes[..bytes.len() - 2], "").contains("a square of 16-bit heights"));
    assert!(error("N00E000.hgt", b"", "").contains("0 bytes"));
}

#[test]
fn raw_16_bit_terrains_are_square_or_have_dims() {
    let bytes: Vec<u8> = (0..16u16).flat_map(|v| (v * 100).to_le_bytes()).collect();
    let expected: Vec<u16> = (0..16).collect();
    assert_eq!(told("a.r16", &bytes, "--height-scale 0.01").0, some(&expected));
    let (found, about) = told("a.r16", &bytes, "--dims 8,2 --height-scale 0.01");
    assert_eq!((found, about.format.as_str()), (some(&expected), "RAW16"));
    assert!(error("a.r16", &bytes, "--dims 8,3").contains("expected --dims X,Y"));
    assert!(error("a.r16", &bytes[..30], "").contains("give --dims X,Y"));
    assert_eq!(told("a.r16", &bytes, "--nodata 0 --height-scale 0.01").0[..2], [None, Some(1)]);
    refuses_every_prefix_but(0, "a.r16", &bytes[..8], "--dims 2,2");
}
