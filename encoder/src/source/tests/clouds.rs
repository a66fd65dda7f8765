//! Clouds of points.

use super::models::about;
use super::*;

/// Solid voxels, in order.
fn solid(columns: &Columns) -> Vec<[u32; 3]> {
    let mut out = Vec::new();
    for (x, z) in (0..columns.nz()).flat_map(|z| (0..columns.nx()).map(move |x| (x, z))) {
        let ys = columns.column(x, z).iter().flat_map(|r| u32::from(r.first())..r.end());
        out.extend(ys.map(|y| [x, y, z]));
    }
    out.sort_unstable();
    out
}

fn colors(input: &Input) -> Vec<Rgb> {
    let Colors::Voxel { entries, .. } = &input.colors else { panic!("no colours") };
    entries.iter().map(|e| e.1).collect()
}

// PCD. Points (0, 0, 0) red, (2, 1, 5) green, none, (4, 0, 1) blue: fields in an odd order, one of two values.

const HEADER: &str = "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS extra y x rgb z\nSIZE 2 4 8 4 4\n\
                      TYPE I F F F F\nCOUNT 2 1 1 1 1\nWIDTH 4\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 4\nDATA ";

const POINTS: [([f64; 3], u32); 4] =
    [([0.0, 0.0, 0.0], 0xFF_00_00), ([2.0, 1.0, 5.0], 0x00_FF_00), ([f64::NAN; 3], 0), ([4.0, 0.0, 1.0], 0x00_00_FF)];

fn fields(([x, y, z], rgb): ([f64; 3], u32)) -> [Vec<u8>; 5] {
    let f = |v: f64| (v as f32).to_le_bytes().to_vec();
    [vec![1, 0, 255, 255], f(y), x.to_le_bytes().to_vec(), rgb.to_le_bytes().to_vec(), f(z)]
}

fn pcd(form: &str) -> Vec<u8> {
    let mut out = format!("{HEADER}{form}\n").into_bytes();
    match form {
        "ascii" => {
            for ([x, y, z], rgb) in POINTS {
                out.extend(format!("1 -1 {y} {x} {:e} {z}\n", f32::from_bits(rgb)).bytes());
            }
        }
        "binary" => POINTS.iter().for_each(|&p| out.extend(fields(p).concat())),
        _ => {
            let all: Vec<u8> = (0..5).flat_map(|i| POINTS.iter().flat_map(move |&p| fields(p)[i].clone())).collect();
            // The first field, 01 00 FF FF four times over, repeats itself; the rest is as it is.
            let mut packed = vec![3, 1, 0, 255, 255, 7 << 5, 12 - 2 - 7, 3];
            all[16..].chunks(32).for_each(|c| packed.extend([&[c.len() as u8 - 1], c].concat()));
            out.extend((packed.len() as u32).to_le_bytes());
            out.extend((all.len() as u32).to_le_bytes());
            out.extend(packed);
        }
    }
    out
}

#[test]
fn pcd_forms_give_the_same_points() {
    for form in ["ascii", "binary", "binary_compressed"] {
        let bytes = pcd(form);
        let input = read("p", &bytes, "--voxel 1");
        assert_eq!(input.columns.dims(), [5, 6, 2], "{form}");
        // z up: (x, z, −y), so y 1 is in front.
        assert_eq!(solid(&input.columns), [[0, 0, 1], [2, 5, 0], [4, 1, 1]], "{form}");
        assert_eq!(colors(&input), [[0, 255, 0], [255, 0, 0], [0, 0, 255]], "{form}");
        let told = about("p", &bytes, "--voxel 1");
        assert_eq!(told.left_out, ["1 points without a place (no finite numbers)"], "{form}");
        assert_eq!(told.affine.unwrap(), [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 1.0], [0.0, 1.0, 0.0, 0.0]]);
        survives_changed_bytes("p.pcd", &bytes, "--size 8");
        refuses_every_prefix_but(if form == "ascii" { 3 } else { 0 }, "p.pcd", &bytes, "--size 8");
    }
    assert_eq!(solid(&read("p", &pcd("binary"), "--voxel 1 --up y").columns)[1], [2, 1, 5]);
}

#[test]
fn pcd_without_colours_is_coloured_by_what_it_has() {
    let file = |fields: &str, rows: &str| {
        let n = rows.lines().count();
        let each = |v: &str| fields.split(' ').map(|_| v).collect::<Vec<_>>().join(" ");
        let head = format!(
            "VERSION .7\nFIELDS {fields}\nSIZE {}\nTYPE {}\nWIDTH {n}\nHEIGHT 1\nDATA ascii\n",
            each("4"),
            each("F")
        );
        (head + rows).into_bytes()
    };
    let bright = file("x y z intensity", "0 0 0 -5\n1 0 0 5\n2 0 0 15\n");
    assert_eq!(colors(&read("p", &bright, "--voxel 1")), [[24; 3], [140; 3], [255; 3]]);
    assert_eq!(colors(&read("p", &bright, "--voxel 1 --color-by height")).len(), 3);
    let high = file("x y z", "0 0 0\n1 0 4\n2 0 8\n");
    assert_eq!(colors(&read("p", &high, "--voxel 1")), [[68, 1, 84], [33, 144, 141], [253, 231, 37]]);
    assert!(about("p", &high, "--voxel 1").rule.contains("coloured by height"));
    let e = error("p", &high, "--voxel 1 --color-by class");
    assert!(e.contains("no classes; --color-by may be height"), "{e}");
    let e = error("p", &file("x y intensity", "0 0 0\n"), "");
    assert!(e.contains("x, y and z are needed"), "{e}");
    let e = error("p", &file("x y z", "0 0\n"), "");
    assert!(e.contains("point 0 has 2 values, expected 3"), "{e}");
    let far = file("x y z", "0 0 0\n0 1 x\n");
    assert!(error("p", &far, "").contains("\"x\" is no number"));
}

#[test]
fn pcd_claims_are_checked_before_memory_is_asked_for() {
    let forged = |from: &str, to: &str, form: &str| {
        let text = String::from_utf8_lossy(&pcd(form)[..HEADER.len()]).replace(from, to);
        error("p", &[text.as_bytes(), &pcd(form)[HEADER.len()..]].concat(), "")
    };
    for form in ["ascii", "binary", "binary_compressed"] {
        let e = forged("POINTS 4", "POINTS 18446744073709551615", form);
        assert!(e.contains("18446744073709551615"), "{e}");
        let e = forged("COUNT 2", "COUNT 99999999999", form);
        assert!(e.contains("99999999999 values a point"), "{e}");
    }
    assert!(forged("SIZE 2", "SIZE 3", "binary").contains("of type I and 3 bytes"));
    assert!(forged("COUNT 2", "COUNT 2 1", "binary").contains("expected the same number"));
}

#[test]
fn points_of_one_place_and_of_a_line_are_worlds() {
    let cloud = |rows: &str| {
        let n = rows.lines().count();
        let head = format!(
            "ply\nformat ascii 1.0\nelement vertex {n}\nproperty double x\nproperty double y\nproperty double z\nend_header\n"
        );
        (head + rows).into_bytes()
    };
    assert_eq!(read("p.ply", &cloud("5 5 5\n5 5 5\n"), "").columns.dims(), [1, 1, 1]);
    let line: String = (0..30).map(|i| format!("{i} 0 0\n")).collect();
    assert_eq!(read("p.ply", &cloud(&line), "--voxel 1").columns.voxels(), 30);
    let holes = cloud("0 0 0\nnan 0 0\n3 0 0\n");
    assert_eq!(read("p.ply", &holes, "--voxel 1").columns.voxels(), 2);
    assert!(about("p.ply", &holes, "--voxel 1").left_out[0].starts_with("1 points without a place"));
}

#[test]
fn points_fill_as_many_voxels_as_close_the_ground() {
    // A floor of points at random, a voxel apart in the mean, and one much finer than its voxels.
    let floor = |n: u32, side: u32| {
        let place = |i: u32, axis: u32| f64::from(hash(1, i, axis, 0) % (1000 * side)) / 1000.0;
        let rows: String = (0..n).map(|i| format!("{} {} 0\n", place(i, 0), place(i, 1))).collect();
        let head = format!("VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH {n}\nHEIGHT 1\nDATA ascii\n");
        (head + &rows).into_bytes()
    };
    let sparse = floor(10_000, 100);
    let covered = |flags: &str| {
        let c = read("p", &sparse, flags).columns;
        (0..c.nx() * c.nz()).filter(|i| !c.column(i % c.nx(), i / c.nx()).is_empty()).count() as f64
            / f64::from(c.nx() * c.nz())
    };
    let one = covered("--voxel 1");
    assert!((0.55..0.7).contains(&one), "1 − 1/e of the columns: {one}");
    let auto = covered("--voxel 1 --point-size auto");
    assert!(auto > 0.97, "{auto}");
    let told = about("p", &sparse, "--voxel 1 --point-size auto");
    assert!(told.rule.contains("a point fills 2 × 2 × 2 voxels (auto: closes"), "{told}");
    assert!(about("p", &floor(40_000, 20), "--voxel 1 --point-size auto").rule.contains("a point fills a voxel"));
    // Sizes by number, cut at the edge of the world; a point keeps its colour.
    let two = "VERSION .7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F U\nWIDTH 2\nHEIGHT 1\nDATA ascii\n0 0 0 255\n4 0 0 65280\n";
    let input = read("p", two.as_bytes(), "--voxel 1 --point-size 4");
    assert_eq!(solid(&input.columns), [[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0], [4, 0, 0]]);
    let [blue, mid, green] = [[0, 0, 255], [0, 0, 255], [0, 255, 0]];
    assert_eq!(colors(&input), [blue, mid, mid, green, green]);
}

#[test]
fn points_far_out_are_refused_with_advice_and_not_drawn() {
    let rows: String = (0..2000).map(|i| format!("{} {} 0\n", i % 50, i / 50)).collect();
    let cloud = |stray: &str| {
        let head = "VERSION .7\nFIELDS x y z\nSIZE 8 8 8\nTYPE F F F\nWIDTH 2001\nHEIGHT 1\nDATA ascii\n";
        format!("{head}{rows}{stray}\n").into_bytes()
    };
    let e = error("p", &cloud("1e7 0 0"), "");
    assert!(e.contains("a few points lie far out") && e.contains("all but a few at x 0.000 to 49.000"), "{e}");
    let e = error("p", &cloud("1e7 1e7 0"), "--voxel 1");
    assert!(e.contains("columns") && e.contains("give a larger --voxel"), "{e}");
    let e = error("p", &cloud("0 0 1e9"), "--voxel 1");
    assert!(e.contains("voxels high") && e.contains("all but a few at"), "{e}");
    assert!(about("p", &cloud("0 0 900"), "--voxel 1").rule.contains("few lie far out"));
    assert!(about("p", &cloud("0 0 1"), "--voxel 1").left_out.is_empty());
}

#[cfg(feature = "las")]
mod lidar {
    use las::point::{Classification, Format as LasFormat};

    use super::*;

    type Scan = File;

    /// A file of those points.
    fn scan(version: (u8, u8), format: u8, points: Vec<las::Point>) -> Scan {
        let mut builder = las::Builder::from(version);
        builder.point_format = LasFormat::new(format).unwrap();
        builder.transforms = las::Vector {
            x: las::Transform { scale: 0.01, offset: 0.0 },
            y: las::Transform { scale: 0.01, offset: 0.0 },
            z: las::Transform { scale: 0.01, offset: 0.0 },
        };
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("p.las");
        let mut writer = las::Writer::from_path(&path, builder.into_header().unwrap()).unwrap();
        points.into_iter().for_each(|p| writer.write_point(p).unwrap());
        writer.close().unwrap();
        File(dir, path)
    }

    fn at(x: f64, y: f64, z: f64, class: u8) -> las::Point {
        las::Point {
            x,
            y,
            z,
            classification: Classification::new(class).unwrap(),
            gps_time: Some(0.0),
            ..Default::default()
        }
    }

    /// 40 × 30 points of ground, and a roof.
    fn town() -> Vec<las::Point> {
        let ground = (0..1200).map(|i| at(f64::from(i % 40), f64::from(i / 40), 0.0, 2));
        let roof = (0..100).map(|i| at(10.0 + f64::from(i % 10), 10.0 + f64::from(i / 10), 8.0, 6));
        ground.chain(roof).collect()
    }

    impl Scan {
        fn read(&self, flags: &str) -> (Input, About) {
            let pieces = open_pieces(&self.1, &opts(flags)).map_err(|e| e.to_string()).unwrap();
            (pieces::whole(&*pieces).unwrap(), pieces.about())
        }

        fn error(&self, flags: &str) -> String {
            open(&self.1, &opts(flags)).err().expect("it is refused").to_string()
        }

        /// Puts numbers of 64 bits at a place of the header.
        fn forge(&self, at: usize, values: &[f64]) {
            let mut bytes = fs::read(&self.1).unwrap();
            for (i, v) in values.iter().enumerate() {
                bytes[at + 8 * i..at + 8 * i + 8].copy_from_slice(&v.to_le_bytes());
            }
            fs::write(&self.1, bytes).unwrap();
        }
    }

    #[test]
    fn laz_that_claims_more_chunks_than_it_can_hold_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("p.laz");
        let mut builder = las::Builder::from((1, 4));
        builder.point_format = LasFormat::new(6).unwrap();
        builder.point_format.is_compressed = true;
        let mut writer = las::Writer::from_path(&path, builder.into_header().unwrap()).unwrap();
        town().into_iter().for_each(|p| writer.write_point(p).unwrap());
        writer.close().unwrap();
        let file = File(dir, path);
        let columns = file.read("--voxel 1").0.columns.dims();
        assert_eq!(columns, [40, 9, 30]);
        let mut bytes = fs::read(&file.1).unwrap();
        let word = |bytes: &[u8], at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        let table = word(&bytes, word(&bytes, 96));
        assert_eq!(word(&bytes, table + 4), 1);
        bytes[table + 4..table + 8].copy_from_slice(&[0xff; 4]);
        fs::write(&file.1, bytes).unwrap();
        assert!(file.error("--voxel 1").contains(&format!("byte {}: LAS: 4294967295 chunks of points", table + 4)));
    }

    #[test]
    fn las_points_are_trusted_where_the_header_is_wrong() {
        let right = scan((1, 2), 1, town());
        let (world, told) = right.read("--voxel 1");
        assert_eq!(world.columns.dims(), [40, 9, 30]);
        let (auto, _) = right.read("");
        // Max x, min x, max y, min y, max z, min z.
        let boxes = [
            [1e7, -1e7, 1e7, -1e7, 1e7, -1e7],
            [20.0, 5.0, 20.0, 5.0, 3.0, 1.0],
            [0.0; 6],
            [f64::NAN; 6],
            [-1.0, 90.0, -1.0, 90.0, -1.0, 90.0],
        ];
        for ends in boxes {
            right.forge(179, &ends);
            let (got, about) = right.read("--voxel 1");
            assert_eq!((got.columns, about), (world.columns.clone(), told.clone()), "{ends:?}");
            assert_eq!(right.read("").0.columns, auto.columns, "{ends:?}");
        }
    }

    #[test]
    fn las_withheld_points_and_noise_are_left_out_with_a_word() {
        let mut points = town();
        points.push(las::Point { is_withheld: true, ..at(5.0, 5.0, 9000.0, 2) });
        points.push(at(5.0, 5.0, -400.0, 7));
        points.push(at(5.0, 6.0, 700.0, 18));
        points.push(las::Point { is_synthetic: true, ..at(5.0, 7.0, 0.0, 2) });
        points.push(las::Point { is_overlap: true, ..at(5.0, 8.0, 0.0, 2) });
        let file = scan((1, 4), 6, points);
        for flags in ["--voxel 1", ""] {
            let (world, told) = file.read(flags);
            let [nx, ny, nz] = world.columns.dims();
            assert!(
                (38..=43).contains(&nx) && (8..=10).contains(&ny) && (28..=33).contains(&nz),
                "{:?}",
                world.columns.dims()
            );
            assert_eq!(told.left_out, ["1 withheld points", "2 points of noise (classes 7 and 18)"]);
            let [synthetic, overlap] =
                ["1 points are synthetic, and kept", "1 points are of overlapping swaths, and kept"];
            assert!(told.rule.contains(synthetic) && told.rule.contains(overlap), "{told}");
        }
    }

    #[test]
    fn las_classes_are_chosen_by_number() {
        let mut points = town();
        points.push(at(5.0, 5.0, 700.0, 18));
        let file = scan((1, 4), 6, points);
        let (roof, told) = file.read("--voxel 1 --las-classes 3-6,9");
        assert_eq!((roof.columns.dims(), roof.columns.voxels()), ([10, 1, 10], 100));
        assert_eq!(told.left_out, ["1201 points of classes other than 3-6,9"]);
        assert_eq!(file.read("--voxel 1 --las-classes 2,18").0.columns.dims(), [40, 701, 30]);
        let e = file.error("--las-classes 9");
        assert!(
            e.contains("of --las-classes 9") && e.contains("2 (1200 points), 6 (100 points), 18 (1 points)"),
            "{e}"
        );
        // Formats before 6 have class and flags in a byte.
        let old = scan((1, 2), 1, vec![at(0.0, 0.0, 0.0, 2), las::Point { is_withheld: true, ..at(9.0, 0.0, 0.0, 6) }]);
        assert!(old.error("--las-classes 6").contains("1 are withheld"));
    }

    #[test]
    fn las_is_coloured_by_class_intensity_or_height_where_it_has_no_colours() {
        let (world, told) = scan((1, 2), 1, town()).read("--voxel 1");
        assert!(told.rule.contains("coloured by class"), "{told}");
        let found: std::collections::BTreeSet<Rgb> = colors(&world).into_iter().collect();
        assert_eq!(found.len(), 2, "ground and roof");
        let bright = |i: u16| las::Point { intensity: 100 * i, ..at(i.into(), 0.0, 0.0, 1) };
        let (world, told) = scan((1, 2), 1, (0..4).map(bright).collect()).read("--voxel 1");
        assert!(told.rule.contains("coloured by intensity from 0 to 300"), "{told}");
        assert_eq!(colors(&world), [[24; 3], [101; 3], [178; 3], [255; 3]]);
        let flat: Vec<_> = (0..3).map(|i| at(i.into(), 0.0, i.into(), 1)).collect();
        assert!(scan((1, 2), 1, flat).read("--voxel 1").1.rule.contains("coloured by height"));
        // A format with colours, all of them black, has none.
        let black = town().into_iter().map(|p| las::Point { color: Some(las::Color::new(0, 0, 0)), ..p }).collect();
        let black = scan((1, 2), 3, black);
        assert!(black.read("--voxel 1").1.rule.contains("coloured by class"));
        assert!(black.read("--voxel 1 --color-by rgb").1.rule.contains("colours of 8 bits"));
        // 8 bits where 16 belong, and 16.
        for (most, expected) in [(200, "8"), (51_400, "16")] {
            let red = |p| las::Point { color: Some(las::Color::new(most, 0, most / 2)), ..p };
            let (world, told) = scan((1, 2), 3, town().into_iter().map(red).collect()).read("--voxel 1");
            assert!(told.rule.contains(&format!("colours of {expected} bits")), "{told}");
            assert_eq!(colors(&world)[0], [200, 0, 100]);
        }
    }

    #[test]
    fn las_systems_of_coordinates_give_units() {
        let wkt = "COMPD_CS[\"x\",PROJCS[\"NAD83 / Oregon\",GEOGCS[\"NAD83\",DATUM[\"d\",SPHEROID[\"GRS 1980\",6378137,298.257]],\
                   PRIMEM[\"Greenwich\",0],UNIT[\"degree\",0.0174532925199433]],PROJECTION[\"Lambert_Conformal_Conic_2SP\"],\
                   UNIT[\"foot\",0.3048],AUTHORITY[\"EPSG\",\"2992\"]],VERT_CS[\"NAVD88\",VERT_DATUM[\"v\",2005],UNIT[\"metre\",1]]]";
        let file = scan((1, 4), 6, town());
        let reader = las::Reader::from_path(&file.1).unwrap();
        let mut header = reader.header().clone();
        header.set_wkt_crs(wkt.as_bytes().to_vec()).unwrap();
        let mut writer = las::Writer::from_path(&file.1, header).unwrap();
        town().into_iter().for_each(|p| writer.write_point(p).unwrap());
        writer.close().unwrap();
        let (world, told) = file.read("--voxel 1");
        // Feet on the map, metres up: 8 m are 26.2 ft.
        assert_eq!((world.columns.dims(), told.unit.as_str()), ([40, 27, 30], "ft"));
        assert!(told.crs.contains("2992"), "{told}");
        let up = told.affine.unwrap()[2];
        assert!((up[1] - 0.3048).abs() < 1e-12 && up[3].abs() < 1e-12, "{up:?}");
    }
}
