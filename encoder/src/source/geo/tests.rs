use super::*;

fn near(found: f64, expected: f64) {
    assert!((found / expected - 1.0).abs() < 2e-4, "{found}, not {expected}");
}

/// Metres of a pixel of `side` whose corner is at `(x, y)`.
fn metres(crs: Crs, x: f64, y: f64, side: f64) -> [f64; 2] {
    Place::north_up(crs, [x, y], [side; 2]).ground(1, 1).unwrap().metres
}

#[test]
fn degrees_are_as_long_as_on_the_ellipsoid() {
    // Lengths of a thousandth of a degree by Karney's geodesics on WGS 84 (GeographicLib).
    for (latitude, east, north) in [(0.0, 111.3195, 110.5743), (46.5, 76.7745, 111.1620), (60.0, 55.8000, 111.4123)] {
        let [x, y] = metres(Crs::epsg(4326, Model::Geographic), 7.0, latitude + 0.0005, 0.001);
        near(x, east);
        near(y, north);
    }
    // Paris counts in grads.
    let paris = metres(Crs::epsg(4807, Model::Geographic), 2.0, 50.0 + 0.0005, 0.001);
    let degrees = metres(Crs::epsg(4326, Model::Geographic), 2.0, 45.0 + 0.00045, 0.0009);
    near(paris[0], degrees[0]);
    let place = Place::north_up(Crs::epsg(4326, Model::Geographic), [0.0, 120.0], [1.0; 2]);
    assert!(place.ground(2, 2).unwrap_err().contains("latitude 119"), "no such latitude");
}

#[test]
fn mercator_shrinks_with_the_latitude() {
    // Northing of 60 degrees on the sphere: half of what the map shows.
    near(metres(Crs::epsg(3857, Model::Projected), 0.0, 8_399_737.9, 20.0)[0], 10.0);
    near(metres(Crs::epsg(3857, Model::Projected), 0.0, -8_399_737.9, 20.0)[1], 10.0);
    near(metres(Crs::epsg(3857, Model::Projected), 0.0, 0.0, 20.0)[0], 20.0);
    // On the ellipsoid 60 degrees are at northing 8,362,698.55 (PROJ), stretched by 1.994973.
    near(metres(Crs::epsg(3395, Model::Projected), 0.0, 8_362_698.55, 20.0)[0], 20.0 / 1.994_973);
    // True at 41 degrees south.
    near(metres(Crs::epsg(3994, Model::Projected), 0.0, -3_767_132.0, 20.0)[0], 20.0);
    // Equidistant: true along meridians only.
    let [x, y] = metres(Crs::epsg(4087, Model::Projected), 0.0, 6_679_169.4, 20.0);
    near(x, 10.0);
    near(y, 20.0);
}

#[test]
fn codes_know_their_units() {
    for (code, unit) in [(32_617, 1.0), (2264, FOOT_US), (2222, 0.3048), (6543, FOOT_US), (6542, 1.0), (27_700, 1.0)] {
        assert_eq!(Crs::epsg(code, Model::Projected).unit, unit, "EPSG:{code}");
    }
    let up = |code: u16| Crs::epsg(26_917, Model::Projected).with_vertical(code).up.unwrap().metres;
    assert_eq!([up(5703), up(6360), up(8228), up(5702)], [1.0, FOOT_US, 0.3048, FOOT_US]);
    let depths = Crs::epsg(26_917, Model::Projected).with_vertical(5831);
    assert!(depths.down && depths.name == "EPSG:26917+5831");
}

#[test]
fn keys_of_geotiff_are_read() {
    let keys = |keys: &[[u16; 4]]| -> Vec<u16> { [&[[1, 1, 0, keys.len() as u16]], keys].concat().concat() };
    let crs = Crs::of_keys(&keys(&[[1024, 0, 1, 1], [3072, 0, 1, 2264], [4096, 0, 1, 6360]]), &[], b"");
    assert_eq!((crs.name.as_str(), crs.unit, crs.up.unwrap().metres), ("EPSG:2264+6360", FOOT_US, FOOT_US));
    // The unit that a key names counts more than that of the code of heights.
    let crs =
        Crs::of_keys(&keys(&[[1024, 0, 1, 1], [3072, 0, 1, 32_617], [4096, 0, 1, 5703], [4099, 0, 1, 9002]]), &[], b"");
    assert_eq!((crs.unit, crs.up.unwrap().metres), (1.0, 0.3048));
    assert_eq!(crs.clash, "heights in ft by their unit, in m by their system");
    // The unit of a map counts more than that of its code, as GDAL has it.
    assert_eq!(
        Crs::of_keys(&keys(&[[1024, 0, 1, 1], [3072, 0, 1, 32_617], [3076, 0, 1, 9002]]), &[], b"").unit,
        0.3048
    );
    // Of one's own: a unit by its size, a name, Mercator with a parallel.
    let own = [[1024, 0, 1, 1], [3072, 0, 1, 32_767], [3073, 34_737, 5, 0], [3076, 0, 1, 32_767], [3077, 34_736, 1, 0]];
    let crs = Crs::of_keys(&keys(&own), &[0.5], b"Mine|");
    assert_eq!((crs.name.as_str(), crs.model, crs.unit), ("Mine", Model::Projected, 0.5));
    let mercator = [
        [1024, 0, 1, 1],
        [3072, 0, 1, 32_767],
        [3075, 0, 1, 7],
        [3078, 34_736, 1, 0],
        [2057, 34_736, 1, 1],
        [2058, 34_736, 1, 1],
    ];
    let crs = Crs::of_keys(&keys(&mercator), &[0.0, 1_737_400.0], b"");
    // The Moon at 60 degrees, by the sphere's equation.
    near(metres(crs, 0.0, 1_737_400.0 * (60f64.to_radians().tan() + 2.0).ln(), 20.0)[0], 10.0);
    // ESRI's text, and none at all.
    let esri = br#"ESRI PE String = PROJCS["NAD_1983_X",GEOGCS["GCS",DATUM["D",SPHEROID["GRS",6378137.0,298.257]],PRIMEM["G",0.0],UNIT["Degree",0.0174532925199433]],PROJECTION["Lambert_Conformal_Conic"],UNIT["Foot_US",0.3048006096012192]]|"#;
    let crs =
        Crs::of_keys(&keys(&[[1024, 0, 1, 1], [3072, 0, 1, 32_767], [3073, 34_737, esri.len() as u16, 0]]), &[], esri);
    assert_eq!((crs.name.as_str(), crs.unit), ("NAD_1983_X", FOOT_US));
    assert_eq!(Crs::of_keys(&[], &[], b""), Crs::default());
    // Keys that point nowhere say nothing.
    let crs = Crs::of_keys(&keys(&[[1024, 0, 1, 1], [3073, 34_737, 500, 60_000], [3077, 34_736, 1, 9]]), &[], b"x");
    assert_eq!((crs.model, crs.unit), (Model::Projected, 1.0));
}

#[test]
fn texts_of_both_versions_are_read() {
    let one = r#"COMPD_CS["two",PROJCS["NAD83 / North Carolina (ftUS)",GEOGCS["NAD83",DATUM["N",SPHEROID["GRS 1980",6378137,298.257222101]],
        PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]],PROJECTION["Lambert_Conformal_Conic_2SP"],PARAMETER["false_easting",2000000],
        UNIT["US survey foot",0.304800609601219,AUTHORITY["EPSG","9003"]],AUTHORITY["EPSG","2264"]],
        VERT_CS["NAVD88 height (ftUS)",VERT_DATUM["N",2005],UNIT["US survey foot",0.304800609601219],AXIS["Up",UP],AUTHORITY["EPSG","6360"]]]"#;
    let crs = Crs::of_wkt(one).unwrap();
    assert_eq!((crs.name.as_str(), crs.model, crs.unit), ("EPSG:2264+6360", Model::Projected, FOOT_US));
    assert_eq!(crs.up.unwrap().metres, FOOT_US);
    let two = r#"PROJCRS["Web ""M""",BASEGEOGCRS["WGS 84",DATUM["W",ELLIPSOID["WGS 84",6378137,298.257223563,LENGTHUNIT["metre",1]]]],
        CONVERSION["c",METHOD["Popular Visualisation Pseudo Mercator",ID["EPSG",1024]],PARAMETER["False northing",0,LENGTHUNIT["metre",1]]],
        CS[Cartesian,2],AXIS["easting (X)",east,ORDER[1],LENGTHUNIT["metre",1]],AXIS["northing (Y)",north,ORDER[2],LENGTHUNIT["metre",1]]]"#;
    let crs = Crs::of_wkt(two).unwrap();
    assert_eq!((crs.name.as_str(), crs.unit_name.as_str()), ("Web \"M\"", "m"));
    near(metres(crs, 0.0, 8_399_737.9, 20.0)[0], 10.0);
    let esri = r#"GEOGCS["GCS_WGS_1984",DATUM["D_WGS_1984",SPHEROID["WGS_1984",6378137.0,298.257223563]],PRIMEM["Greenwich",0.0],UNIT["Degree",0.0174532925199433]],VERTCS["NAVD88_depth",VDATUM["N"],PARAMETER["Vertical_Shift",0.0],PARAMETER["Direction",-1.0],UNIT["Foot_US",0.3048006096012192]]"#;
    let crs = Crs::of_wkt(esri).unwrap();
    assert_eq!((crs.model, crs.unit, crs.down), (Model::Geographic, 1.0, true));
    assert_eq!(crs.up.unwrap().metres, FOOT_US);
    for damaged in
        ["", "PROJCS", "PROJCS[", "PROJCS[\"a\"", "+proj=utm +zone=17", &"A[".repeat(100_000), "[[[", "UNIT[\"é\",]é"]
    {
        assert_eq!(Crs::of_wkt(damaged), None, "{damaged:.20}");
    }
    for n in 0..one.len() {
        let _ = Crs::of_wkt(&one[..n]);
    }
}

#[test]
fn tags_place_a_raster_and_flips_turn_it_north_up() {
    let scale = [10.0, 20.0, 0.0];
    let ties = [2.0, 3.0, 0.0, 500.0, 900.0, 0.0];
    let affine = Place::of_tags(&scale, &ties, &[], false).unwrap();
    assert_eq!(affine, [[10.0, 0.0, 480.0], [0.0, -20.0, 960.0]]);
    assert_eq!(Place::of_tags(&scale, &ties, &[], true).unwrap(), [[10.0, 0.0, 475.0], [0.0, -20.0, 970.0]]);
    assert_eq!(Place::of_tags(&[10.0, -20.0, 0.0], &ties, &[], false).unwrap(), affine);
    // Control points are no grid.
    assert_eq!(Place::of_tags(&[], &ties.repeat(4), &[], false), None);
    let mut matrix = [0.0; 16];
    (matrix[0], matrix[3], matrix[5], matrix[7]) = (2.0, 5e5, 2.0, 4e6);
    let place =
        Place { crs: Crs::epsg(32_617, Model::Projected), affine: Place::of_tags(&[], &[], &matrix, false).unwrap() };
    assert_eq!((place.flips(), place.turn()), ([false, true], 0.0));
    let flipped = place.flipped([false, true], 30, 20);
    assert_eq!(flipped.affine, [[2.0, 0.0, 5e5], [0.0, -2.0, 4_000_040.0]]);
    assert_eq!(flipped.world(-7.0, 0.5), [[2.0, 0.0, 0.0, 5e5], [0.0, 0.0, -2.0, 4_000_040.0], [0.0, 2.0, 0.0, -8.0]]);
    // Turned by 30 degrees: sides are lengths, not components.
    let (sin, cos) = 30f64.to_radians().sin_cos();
    let affine = [[10.0 * cos, 20.0 * sin, 0.0], [10.0 * sin, -20.0 * cos, 0.0]];
    let turned = Place { crs: Crs::epsg(32_617, Model::Projected), affine };
    let [x, y] = turned.ground(3, 3).unwrap().metres;
    near(x, 10.0);
    near(y, 20.0);
    near(turned.turn(), 30.0);
    assert_eq!(turned.flips(), [false, false]);
}

#[test]
fn names_of_units_are_known() {
    for (name, metres) in [
        ("ft", 0.3048),
        ("US survey foot", FOOT_US),
        ("metre", 1.0),
        ("Foot_US", FOOT_US),
        ("km", 1000.0),
        ("cm", 0.01),
    ] {
        assert_eq!(Length::of_name(name).unwrap().metres, metres, "{name}");
    }
    assert_eq!(Length::of_name("K"), None);
    assert_eq!(Length::of_metres(0.304_800_61, "").unwrap().name, "ftUS");
    assert_eq!(Length::of_metres(0.3048, "").unwrap().name, "ft");
    assert_eq!(Length::of_metres(-1.0, ""), None);
}
