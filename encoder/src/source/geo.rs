//! Place and units: where on a body a raster or a cloud lies, and what its numbers measure. One reading for all formats that
//! have such a place: the keys of GeoTIFF and LAS, WKT of both versions and of ESRI's files `.prj`, codes of EPSG.
//!
//! Only what a picture needs is kept of a coordinate reference system: its name, the units of its axes, the body's ellipsoid,
//! and by what factor its projection stretches lengths, for the two families whose factor is far from 1 (Mercator's and the
//! equidistant cylindrical one). Projections for surveying stay within some 0.1 %, which no voxel shows.
//!
//! After OGC GeoTIFF 1.1 (19-008r4), whose order of axes (east, north) holds for all codes; WKT after ISO 19162.

mod wkt;

/// A unit of length, and how many metres it has.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Length {
    pub name: String,
    pub metres: f64,
}

const FOOT_US: f64 = 1200.0 / 3937.0;

/// Units of length that EPSG's codes of coordinate reference systems use: code, name, metres.
const LENGTHS: &[(u16, &str, f64)] = &[
    (1025, "mm", 0.001),
    (1033, "cm", 0.01),
    (9001, "m", 1.0),
    (9002, "ft", 0.3048),
    (9003, "ftUS", FOOT_US),
    (9005, "Clarke's foot", 0.304_797_265_4),
    (9014, "fathom", 1.8288),
    (9030, "nautical mile", 1852.0),
    (9031, "German legal metre", 1.000_013_596_5),
    (9033, "US survey chain", 66.0 * FOOT_US),
    (9034, "US survey link", 0.66 * FOOT_US),
    (9035, "US survey mile", 5280.0 * FOOT_US),
    (9036, "km", 1000.0),
    (9037, "Clarke's yard", 0.914_391_796_2),
    (9039, "Clarke's link", 0.201_166_195_164),
    (9040, "British yard (Sears 1922)", 0.914_398_414_616_028_7),
    (9041, "British foot (Sears 1922)", 0.304_799_471_538_676_2),
    (9042, "British chain (Sears 1922)", 20.116_765_121_552_632),
    (9043, "British link (Sears 1922)", 0.201_167_651_215_526_3),
    (9062, "British chain (Benoit 1895 B)", 20.116_782_494_375_872),
    (9080, "Indian foot", 0.304_799_510_248_146_94),
    (9084, "Indian yard", 0.914_398_530_744_440_8),
    (9093, "mile", 1609.344),
    (9094, "Gold Coast foot", 0.304_799_710_181_508_8),
    (9095, "British foot (1936)", 0.304_800_749_1),
    (9096, "yard", 0.9144),
    (9097, "chain", 20.1168),
    (9098, "link", 0.201_168),
    (9301, "British chain (Sears 1922 truncated)", 20.116_756),
];

impl Length {
    pub fn metre() -> Length {
        Length { name: "m".to_owned(), metres: 1.0 }
    }

    pub fn of_epsg(code: u16) -> Option<Length> {
        let &(_, name, metres) = LENGTHS.iter().find(|l| l.0 == code)?;
        Some(Length { name: name.to_owned(), metres })
    }

    /// A unit of so many metres, under the name of the one that it is.
    fn of_metres(metres: f64, name: &str) -> Option<Length> {
        if !(metres > 0.0 && metres.is_finite()) {
            return None;
        }
        // Writers round the US survey foot in many ways, but none so far that it could be the other foot.
        let near = LENGTHS.iter().filter(|l| (l.2 / metres - 1.0).abs() < 5e-7);
        let known = near.min_by(|a, b| (a.2 / metres - 1.0).abs().total_cmp(&(b.2 / metres - 1.0).abs()));
        Some(match known {
            Some(&(_, name, metres)) => Length { name: name.to_owned(), metres },
            None => Length { name: if name.is_empty() { format!("{metres} m") } else { name.to_owned() }, metres },
        })
    }

    /// The unit that a file's text names; None where that is no length.
    pub fn of_name(text: &str) -> Option<Length> {
        let plain = text.trim().trim_end_matches('.').to_lowercase().replace(['_', '-'], " ");
        let code = match plain.as_str() {
            "m" | "metre" | "meter" | "metres" | "meters" | "mtr" => 9001,
            "ft" | "foot" | "feet" | "international foot" | "international feet" | "foot intl" | "ift" | "'" => 9002,
            "us ft" | "ft us" | "ftus" | "us survey foot" | "us survey feet" | "foot us" | "feet us" | "usft"
            | "sft" | "survey foot" | "u.s. foot" | "us foot" | "us feet" => 9003,
            "km" | "kilometre" | "kilometer" | "kilometres" | "kilometers" => 9036,
            "cm" | "centimetre" | "centimeter" | "centimetres" | "centimeters" => 1033,
            "mm" | "millimetre" | "millimeter" | "millimetres" | "millimeters" => 1025,
            "yd" | "yard" | "yards" => 9096,
            "fathom" | "fathoms" | "fath" => 9014,
            "mile" | "miles" | "mi" | "statute mile" => 9093,
            "dm" | "decimetre" | "decimeter" | "decimetres" | "decimeters" => {
                return Some(Length { name: "dm".to_owned(), metres: 0.1 });
            }
            _ => return None,
        };
        Length::of_epsg(code)
    }
}

/// What the coordinates of a reference system are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Model {
    /// Lengths on a map.
    Projected,
    /// Longitude and latitude.
    Geographic,
    /// Lengths from the centre of the body.
    Geocentric,
    #[default]
    Unknown,
}

/// By what a projection stretches lengths, where that is far from 1.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Stretch {
    None,
    /// Mercator: `k0` along the equator, 1 / cos of the latitude times as much elsewhere, of a sphere or the ellipsoid.
    Mercator {
        k0: f64,
        north: f64,
        sphere: bool,
    },
    /// Equidistant cylindrical: true along meridians and along one parallel (degrees).
    Equidistant {
        parallel: f64,
        north: f64,
    },
}

/// A body's ellipsoid: half its equatorial axis in metres, and the square of its eccentricity.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Ellipsoid {
    a: f64,
    e2: f64,
}

const EARTH: Ellipsoid = Ellipsoid { a: 6_378_137.0, e2: 0.006_694_379_990_141_3 };

/// A coordinate reference system, as far as a picture needs it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Crs {
    /// "EPSG:32617", "EPSG:26917+5703" with heights of their own, or a name; empty where the file says nothing.
    pub name: String,
    pub model: Model,
    /// Metres (projected, geocentric) or degrees (geographic) of one unit of the coordinates.
    pub unit: f64,
    pub unit_name: String,
    /// Unit of heights, where something says it.
    pub up: Option<Length>,
    /// Heights are depths: they grow downwards.
    pub down: bool,
    /// What of it contradicts itself, and what was taken; mostly empty.
    pub clash: String,
    body: Ellipsoid,
    stretch: Stretch,
}

impl Default for Crs {
    fn default() -> Self {
        Crs {
            name: String::new(),
            model: Model::Unknown,
            unit: 1.0,
            unit_name: String::new(),
            up: None,
            down: false,
            clash: String::new(),
            body: EARTH,
            stretch: Stretch::None,
        }
    }
}

/// Value of a key that is spelled out in others.
const USER_DEFINED: u16 = 32_767;

/// Projected systems of EPSG 11.022 whose unit is not the metre: first and last code, step, code of the unit. Codes between
/// that are none are not there.
#[rustfmt::skip]
const PROJECTED: &[(u16, u16, u16, u16)] = &[
    (2066, 2066, 1, 9039), (2136, 2136, 1, 9094), (2155, 2155, 1, 9003), (2159, 2160, 1, 9094), (2194, 2194, 1, 9003),
    (2204, 2204, 1, 9003), (2222, 2224, 1, 9002), (2225, 2250, 1, 9003), (2251, 2253, 1, 9002), (2254, 2255, 1, 9003),
    (2256, 2256, 1, 9002), (2257, 2264, 1, 9003), (2265, 2266, 1, 9002), (2267, 2268, 1, 9003), (2269, 2270, 1, 9002),
    (2271, 2272, 1, 9003), (2273, 2273, 1, 9002), (2274, 2279, 1, 9003), (2280, 2282, 1, 9002), (2283, 2289, 1, 9003),
    (2314, 2314, 1, 9005), (2867, 2869, 1, 9002), (2870, 2895, 1, 9003), (2896, 2898, 1, 9002), (2899, 2900, 1, 9003),
    (2901, 2901, 1, 9002), (2902, 2908, 1, 9003), (2909, 2910, 1, 9002), (2911, 2912, 1, 9003), (2913, 2914, 1, 9002),
    (2915, 2920, 1, 9003), (2921, 2923, 1, 9002), (2924, 2930, 1, 9003), (2964, 2968, 1, 9003), (2992, 2994, 2, 9002),
    (3080, 3080, 1, 9002), (3089, 3091, 2, 9003), (3102, 3102, 1, 9003), (3139, 3140, 1, 9098), (3167, 3167, 1, 9301),
    (3359, 3361, 2, 9002), (3363, 3365, 2, 9003), (3404, 3404, 1, 9003), (3407, 3407, 1, 9005), (3417, 3438, 1, 9003),
    (3441, 3446, 1, 9003), (3451, 3459, 1, 9003), (3479, 3483, 2, 9002), (3485, 3487, 2, 9003), (3490, 3512, 2, 9003),
    (3515, 3553, 2, 9003), (3560, 3570, 1, 9003), (3582, 3586, 2, 9003), (3588, 3590, 2, 9002), (3593, 3593, 1, 9002),
    (3598, 3600, 2, 9003), (3605, 3605, 1, 9002), (3608, 3632, 2, 9003), (3634, 3636, 2, 9002), (3640, 3642, 2, 9003),
    (3644, 3648, 2, 9002), (3650, 3654, 2, 9003), (3656, 3656, 1, 9002), (3658, 3664, 2, 9003), (3668, 3674, 2, 9003),
    (3676, 3676, 1, 9002), (3677, 3677, 1, 9003), (3679, 3679, 1, 9002), (3680, 3680, 1, 9003), (3682, 3682, 1, 9002),
    (3683, 3683, 1, 9003), (3686, 3692, 2, 9003), (3696, 3700, 2, 9003), (3728, 3739, 1, 9003), (3753, 3760, 1, 9003),
    (3991, 3992, 1, 9003), (4217, 4217, 1, 9003), (4399, 4413, 1, 9003), (4418, 4433, 1, 9003), (4438, 4439, 1, 9003),
    (4455, 4457, 1, 9003), (5472, 5472, 1, 9037), (5588, 5588, 1, 9002), (5589, 5589, 1, 9005), (5623, 5625, 1, 9003),
    (5646, 5646, 1, 9003), (5654, 5655, 1, 9003), (6128, 6141, 1, 9002), (6200, 6202, 1, 9003), (6391, 6391, 1, 9002),
    (6405, 6409, 2, 9002), (6411, 6413, 2, 9003), (6416, 6438, 2, 9003), (6441, 6479, 2, 9003), (6484, 6492, 2, 9003),
    (6494, 6496, 2, 9002), (6499, 6499, 1, 9002), (6501, 6507, 2, 9003), (6510, 6510, 1, 9003), (6515, 6515, 1, 9002),
    (6517, 6543, 2, 9003), (6545, 6547, 2, 9002), (6549, 6555, 2, 9003), (6557, 6561, 2, 9002), (6563, 6565, 2, 9003),
    (6568, 6568, 1, 9003), (6570, 6570, 1, 9002), (6572, 6578, 2, 9003), (6582, 6590, 2, 9003), (6593, 6609, 2, 9003),
    (6612, 6618, 2, 9003), (6625, 6627, 1, 9003), (6633, 6633, 1, 9003), (6785, 6863, 2, 9002), (6868, 6868, 1, 9002),
    (6880, 6880, 1, 9003), (6885, 6887, 2, 9002), (6923, 6925, 2, 9003), (6966, 6966, 1, 9003), (6997, 6997, 1, 9003),
    (7057, 7070, 1, 9003), (7119, 7127, 1, 9002), (7128, 7132, 2, 9003), (7258, 7370, 2, 9003), (7587, 7645, 1, 9003),
    (8035, 8036, 1, 9003), (8065, 8068, 1, 9002), (8091, 8093, 2, 9003), (8096, 8182, 2, 9003), (8177, 8177, 1, 9003),
    (8185, 8185, 1, 9003), (8189, 8189, 1, 9003), (8193, 8197, 2, 9003), (8200, 8210, 2, 9003), (8213, 8213, 1, 9003),
    (8216, 8216, 1, 9003), (8220, 8220, 1, 9003), (8224, 8226, 2, 9003), (8312, 8348, 2, 9002), (8380, 8384, 2, 9003),
    (8387, 8387, 1, 9003), (8518, 8540, 1, 9003), (9748, 9749, 1, 9003), (10481, 10481, 1, 9003),
    (10516, 10516, 1, 9003), (10622, 10622, 1, 9003), (20050, 20050, 1, 9002), (22300, 22300, 1, 9036),
    (23301, 23333, 1, 9003), (24100, 24100, 1, 9005), (24370, 24374, 1, 9084), (24382, 24382, 1, 9084),
    (24571, 24571, 1, 9062), (26729, 26813, 1, 9003), (26847, 26870, 1, 9003), (27291, 27292, 1, 9040),
    (29371, 29385, 1, 9031), (29871, 29871, 1, 9042), (29872, 29872, 1, 9041), (30200, 30200, 1, 9039),
    (32001, 32058, 1, 9003), (32064, 32077, 1, 9003), (32099, 32099, 1, 9003), (32164, 32167, 1, 9003),
    (32664, 32667, 1, 9003),
];

/// Vertical systems of EPSG 11.022 in feet: code, code of the unit.
const VERTICAL_FEET: &[(u16, u16)] = &[
    (5614, 9002),
    (5702, 9003),
    (5754, 9095),
    (6130, 9002),
    (6131, 9002),
    (6132, 9002),
    (6358, 9003),
    (6359, 9003),
    (6360, 9003),
    (8050, 9002),
    (8051, 9002),
    (8052, 9003),
    (8053, 9003),
    (8228, 9002),
    (8897, 9002),
];

/// Vertical systems of EPSG 11.022 that count downwards: first and last code.
#[rustfmt::skip]
const VERTICAL_DOWN: &[(u16, u16)] = &[
    (5336, 5336), (5612, 5612), (5614, 5614), (5706, 5706), (5715, 5715), (5734, 5734), (5739, 5739), (5789, 5789),
    (5831, 5831), (5861, 5867), (5873, 5873), (6357, 6359), (7976, 7976), (8051, 8051), (8053, 8053), (8358, 8378),
    (8897, 8897), (9287, 9288), (9672, 9672), (10150, 10151), (10349, 10349), (10364, 10379), (10547, 10552),
    (10649, 10678),
];

/// Compound systems of EPSG 11.022 in feet: first and last code, unit of the map, unit of heights. In those with 0 the map is in
/// degrees or metres.
const COMPOUND_FEET: &[(u16, u16, u16, u16)] = &[
    (7406, 7406, 0, 9003),
    (7407, 7407, 9003, 9003),
    (8700, 8711, 9002, 9002),
    (8712, 8800, 9003, 9003),
    (9502, 9504, 0, 9002),
];

/// The unit of a projected system's coordinates.
fn projected_unit(code: u16) -> Length {
    let found = PROJECTED.iter().find(|r| (r.0..=r.1).contains(&code) && (code - r.0).is_multiple_of(r.2));
    found.and_then(|r| Length::of_epsg(r.3)).unwrap_or_else(Length::metre)
}

/// Degrees of a unit of angle.
fn angle(code: u16) -> Option<(f64, &'static str)> {
    Some(match code {
        9101 => (1f64.to_degrees(), "radians"),
        9103 => (1.0 / 60.0, "arc minutes"),
        9104 => (1.0 / 3600.0, "arc seconds"),
        9105 | 9106 => (0.9, "grads"),
        9109 => (1e-6f64.to_degrees(), "microradians"),
        9102 | 9107 | 9108 | 9110..=9122 => (1.0, "degrees"),
        _ => return None,
    })
}

impl Crs {
    /// A system by its code: projected, geographic or compound, as `model` says.
    pub fn epsg(code: u16, model: Model) -> Crs {
        let mut crs = Crs { name: format!("EPSG:{code}"), model, ..Crs::default() };
        match model {
            Model::Geographic => {
                // Those of Paris and Bern, which count in grads.
                let grads = matches!(code, 4807 | 4810 | 4811 | 4816 | 4819 | 4821 | 4901 | 4902);
                let (unit, name) = if grads { (0.9, "grads") } else { (1.0, "degrees") };
                (crs.unit, crs.unit_name) = (unit, name.to_owned());
            }
            _ => {
                let unit = projected_unit(code);
                (crs.unit, crs.unit_name) = (unit.metres, unit.name);
            }
        }
        crs.stretch = match code {
            3857 | 3785 => Stretch::Mercator { k0: 1.0, north: 0.0, sphere: true },
            3395 | 3832 | 3349 => Stretch::Mercator { k0: 1.0, north: 0.0, sphere: false },
            2934 | 3000..=3002 | 5329..=5331 | 21_100 | 25_700 => {
                Stretch::Mercator { k0: 0.997, north: 900_000.0, sphere: false }
            }
            3388 => mercator_of(42.0, 0.0),
            3994 | 3752 => mercator_of(-41.0, 0.0),
            5641 => mercator_of(-2.0, 10_000_000.0),
            4087 | 4088 | 3786 | 32_662 | 32_663 => Stretch::Equidistant { parallel: 0.0, north: 0.0 },
            _ => Stretch::None,
        };
        crs
    }

    /// Coordinates in degrees of no system that is known.
    pub fn degrees() -> Crs {
        Crs { model: Model::Geographic, unit_name: "degrees".to_owned(), ..Crs::default() }
    }

    /// Coordinates in a unit of length, of no system that is known.
    pub fn lengths(unit: Length) -> Crs {
        Crs { model: Model::Projected, unit: unit.metres, unit_name: unit.name, ..Crs::default() }
    }

    /// The same with heights in a vertical system of EPSG.
    pub fn with_vertical(mut self, code: u16) -> Crs {
        self.name = match self.name.is_empty() {
            true => format!("EPSG:{code}"),
            false => format!("{}+{code}", self.name),
        };
        let feet = VERTICAL_FEET.iter().find(|v| v.0 == code).map_or(9001, |v| v.1);
        self.up = Length::of_epsg(feet);
        self.down = VERTICAL_DOWN.iter().any(|r| (r.0..=r.1).contains(&code));
        self
    }

    /// A compound system whose parts in feet are known.
    fn compound(code: u16, model: Model) -> Option<Crs> {
        let &(_, _, map, up) = COMPOUND_FEET.iter().find(|r| (r.0..=r.1).contains(&code))?;
        let mut crs = Crs::epsg(code, model);
        if let Some(unit) = Length::of_epsg(map) {
            (crs.unit, crs.unit_name) = (unit.metres, unit.name);
        }
        crs.up = Length::of_epsg(up);
        Some(crs)
    }

    /// From GeoTIFF's keys, which LAS has, too: the directory, and the numbers and texts that it points into.
    pub fn of_keys(directory: &[u16], doubles: &[f64], text: &[u8]) -> Crs {
        let entries = || directory.as_chunks::<4>().0.iter().skip(1);
        let short = |id: u16| entries().find(|k| k[0] == id && k[1] == 0).map(|k| k[3]);
        let double = |id: u16| {
            let key = entries().find(|k| k[0] == id && k[1] == 34_736)?;
            doubles.get(usize::from(key[3])).copied().filter(|v| v.is_finite())
        };
        let words = |id: u16| {
            let key = entries().find(|k| k[0] == id && k[1] == 34_737)?;
            let from = usize::from(key[3]);
            let text = text.get(from..from + usize::from(key[2]))?;
            Some(String::from_utf8_lossy(text).trim_matches(['|', '\0', ' ']).to_owned()).filter(|s| !s.is_empty())
        };
        const GEOGRAPHIC: u16 = 2048;
        const PROJECTED: u16 = 3072;
        let known = |id: u16| short(id).filter(|&code| code != 0);
        let model = match short(1024) {
            Some(1) => Model::Projected,
            Some(2) => Model::Geographic,
            Some(3) => Model::Geocentric,
            _ if known(PROJECTED).is_some() => Model::Projected,
            _ if known(GEOGRAPHIC).is_some() => Model::Geographic,
            _ => Model::Unknown,
        };
        let id = if model == Model::Projected { PROJECTED } else { GEOGRAPHIC };
        // ESRI's programs spell systems without a code out in a text.
        let esri = [1026, 3073, 2049].iter().find_map(|&id| {
            let text = words(id)?;
            Crs::of_wkt(text.strip_prefix("ESRI PE String = ")?)
        });
        let mut crs = match known(id).filter(|&code| code != USER_DEFINED) {
            Some(code) => Crs::compound(code, model).unwrap_or_else(|| Crs::epsg(code, model)),
            None if esri.is_some() => esri.expect("just looked at"),
            None => {
                let mut crs = Crs { model, ..Crs::default() };
                let citation = [3073, 2049, 1026].iter().find_map(|&id| words(id));
                // ESRI's lists several names, "GCS Name = X|Primem = Y": the first says what it is.
                let citation = citation.unwrap_or_default();
                let name = citation.split('|').next().unwrap_or_default();
                let name = name.split_once(" Name = ").map_or(name, |(_, name)| name);
                crs.name = name.chars().filter(|c| !c.is_control()).take(80).collect();
                (crs.unit, crs.unit_name) = match model {
                    Model::Geographic => (1.0, "degrees".to_owned()),
                    Model::Unknown => (1.0, String::new()),
                    Model::Projected | Model::Geocentric => (1.0, "m".to_owned()),
                };
                crs
            }
        };
        match model {
            Model::Geographic => {
                let size = double(2055).map(|radians| (radians.to_degrees(), "own units"));
                let unit = short(2054).and_then(|code| if code == USER_DEFINED { size } else { angle(code) });
                // A code has its unit already; writers name degrees beside those in grads.
                if let Some((unit, name)) = unit.filter(|u| u.0 > 0.0 && known(id).is_none_or(|c| c == USER_DEFINED)) {
                    (crs.unit, crs.unit_name) = (unit, name.to_owned());
                }
            }
            Model::Projected | Model::Geocentric => {
                let size = double(3077).and_then(|metres| Length::of_metres(metres, ""));
                let unit = |key: u16| {
                    short(key).and_then(|c| if c == USER_DEFINED { size.clone() } else { Length::of_epsg(c) })
                };
                let unit = unit(if model == Model::Projected { 3076 } else { 2052 });
                if let Some(unit) = unit {
                    (crs.unit, crs.unit_name) = (unit.metres, unit.name);
                }
            }
            Model::Unknown => {}
        }
        if let Some(a) = double(2057).filter(|a| *a > 0.0) {
            let minor = double(2058).filter(|b| (0.0..=a).contains(b) && *b > 0.0).map(|b| 1.0 - (b / a).powi(2));
            let flat = double(2059).filter(|f| *f > 1.0).map(|f| (2.0 - 1.0 / f) / f);
            crs.body = Ellipsoid { a, e2: minor.or(flat).unwrap_or(0.0) };
        }
        let north = double(3083).or(double(3085)).unwrap_or(0.0) * crs.unit;
        let parallel = double(3078).or(double(3081)).unwrap_or(0.0);
        match short(3075) {
            Some(7) if crs.stretch == Stretch::None => {
                crs.stretch = match double(3092) {
                    Some(k0) if k0 > 0.0 => Stretch::Mercator { k0, north, sphere: crs.body.e2 == 0.0 },
                    _ => mercator_of(parallel, north),
                };
            }
            Some(17) if crs.stretch == Stretch::None => crs.stretch = Stretch::Equidistant { parallel, north },
            _ => {}
        }
        if let Some(code) = known(4096).filter(|&code| code != USER_DEFINED) {
            crs = crs.with_vertical(code);
        }
        if let Some(unit) = short(4099).and_then(Length::of_epsg) {
            // Clouds of the USA have NAVD 88 in metres beside feet, and mean feet.
            if let Some(of_code) = crs.up.as_ref().filter(|up| up.metres != unit.metres) {
                crs.clash = format!("heights in {} by their unit, in {} by their system", unit.name, of_code.name);
            }
            crs.up = Some(unit);
        }
        crs
    }

    /// Metres on the ground of one unit along x and along y, at a place; None where the system does not say.
    pub fn metres_at(&self, [_, y]: [f64; 2]) -> Option<[f64; 2]> {
        let Ellipsoid { a, e2 } = self.body;
        match self.model {
            Model::Geographic => {
                let latitude = y * self.unit;
                if !(-90.0..=90.0).contains(&latitude) {
                    return None;
                }
                let (sin, cos) = latitude.to_radians().sin_cos();
                let w = (1.0 - e2 * sin * sin).sqrt();
                let degree = 1f64.to_radians() * self.unit;
                Some([a / w * cos * degree, a * (1.0 - e2) / w.powi(3) * degree])
            }
            Model::Projected => match self.stretch {
                Stretch::None => Some([self.unit; 2]),
                Stretch::Mercator { k0, north, sphere } => {
                    let e2 = if sphere { 0.0 } else { e2 };
                    let latitude = mercator_latitude((y * self.unit - north) / (a * k0), e2);
                    let (sin, cos) = latitude.sin_cos();
                    Some([self.unit / (k0 * (1.0 - e2 * sin * sin).sqrt()) * cos; 2])
                }
                Stretch::Equidistant { parallel, north } => {
                    let latitude = (y * self.unit - north) / a;
                    Some([self.unit * latitude.cos() / parallel.to_radians().cos(), self.unit])
                }
            }
            .filter(|m| m.iter().all(|v| *v > 0.0 && v.is_finite())),
            Model::Geocentric | Model::Unknown => None,
        }
    }

    /// Latitude in degrees at northing or latitude `y`, where it has been worked with.
    fn latitude(&self, y: f64) -> Option<f64> {
        match (self.model, self.stretch) {
            (Model::Geographic, _) => Some(y * self.unit),
            (_, Stretch::Mercator { k0, north, sphere }) => {
                let e2 = if sphere { 0.0 } else { self.body.e2 };
                Some(mercator_latitude((y * self.unit - north) / (self.body.a * k0), e2).to_degrees())
            }
            (_, Stretch::Equidistant { north, .. }) => Some(((y * self.unit - north) / self.body.a).to_degrees()),
            _ => None,
        }
    }
}

/// Mercator's projection that is true along a parallel (degrees).
fn mercator_of(parallel: f64, north: f64) -> Stretch {
    let (sin, cos) = parallel.to_radians().sin_cos();
    Stretch::Mercator { k0: cos / (1.0 - EARTH.e2 * sin * sin).sqrt(), north, sphere: false }
}

/// The latitude (radians) of an isometric latitude: Snyder, Map Projections (1987), equations 7-9 and 7-10.
fn mercator_latitude(isometric: f64, e2: f64) -> f64 {
    let (t, e) = ((-isometric).exp(), e2.sqrt());
    let half = std::f64::consts::FRAC_PI_2;
    let mut latitude = half - 2.0 * t.atan();
    for _ in 0..8 {
        let s = e * latitude.sin();
        latitude = half - 2.0 * (t * ((1.0 - s) / (1.0 + s)).powf(e / 2.0)).atan();
    }
    latitude
}

/// Where a raster lies: its reference system, and the map from (column, row, 1), counted from the outer corner of the first
/// pixel, to (x, y).
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Place {
    pub crs: Crs,
    pub affine: [[f64; 3]; 2],
}

/// How large a pixel is on the ground.
#[derive(Clone, Debug)]
pub(super) struct Ground {
    /// Metres along a row and along a column, at the raster's centre.
    pub metres: [f64; 2],
    /// How that was found; empty where it goes without saying.
    pub how: String,
}

impl Place {
    /// Rows from north to south: the outer corner of the first pixel, and the sides of a pixel.
    pub fn north_up(crs: Crs, [x, y]: [f64; 2], [dx, dy]: [f64; 2]) -> Place {
        Place { crs, affine: [[dx, 0.0, x], [0.0, -dy, y]] }
    }

    /// The affine map of GeoTIFF's tags: the sides of a pixel and tie points, or a transformation. `point`: places are those of
    /// pixels' centres. None where they give none, as control points without sides do.
    pub fn of_tags(scale: &[f64], ties: &[f64], matrix: &[f64], point: bool) -> Option<[[f64; 3]; 2]> {
        let mut affine = match (scale, ties, matrix) {
            (&[sx, sy, ..], &[column, row, _, x, y, ..], _) if sx != 0.0 && sy != 0.0 => {
                // As GDAL has it, a side below 0 turns nothing about.
                let sy = sy.abs();
                [[sx, 0.0, x - column * sx], [0.0, -sy, y + row * sy]]
            }
            (_, _, &[a, b, _, c, d, e, _, f, ..]) if a * e - b * d != 0.0 => [[a, b, c], [d, e, f]],
            _ => return None,
        };
        if point {
            for [a, b, c] in &mut affine {
                *c -= (*a + *b) / 2.0;
            }
        }
        affine.iter().flatten().all(|v| v.is_finite()).then_some(affine)
    }

    /// Where a point of the raster lies.
    pub fn at(&self, column: f64, row: f64) -> [f64; 2] {
        self.affine.map(|[a, b, c]| a * column + b * row + c)
    }

    /// Which flips, of columns and of rows, let columns run to the east and rows to the south.
    pub fn flips(&self) -> [bool; 2] {
        let [[a, b, _], [d, e, _]] = self.affine;
        let straight = a.abs() * e.abs() >= b.abs() * d.abs();
        match straight {
            true => [a < 0.0, e > 0.0],
            // Turned by a right angle or so: unmirrored is all that can be had without a turn.
            false => [false, a * e - b * d > 0.0],
        }
    }

    /// The place of the raster after such flips.
    pub fn flipped(mut self, [columns, rows]: [bool; 2], width: u32, height: u32) -> Place {
        for [a, b, c] in &mut self.affine {
            if columns {
                *c += *a * f64::from(width);
                // No 0 below 0.
                *a = 0.0 - *a;
            }
            if rows {
                *c += *b * f64::from(height);
                *b = 0.0 - *b;
            }
        }
        self
    }

    /// How far rows are turned from running to the east, in degrees, counter-clockwise; 0 for all that is no more than noise.
    pub fn turn(&self) -> f64 {
        let [[a, b, _], [d, e, _]] = self.affine;
        if b.abs() <= 1e-9 * e.abs() && d.abs() <= 1e-9 * a.abs() { 0.0 } else { d.atan2(a).to_degrees() }
    }

    /// How large a pixel is on the ground; None where the reference system does not say, and why.
    pub fn ground(&self, width: u32, height: u32) -> Result<Ground, String> {
        let centre = self.at(f64::from(width) / 2.0, f64::from(height) / 2.0);
        let [[a, b, _], [d, e, _]] = self.affine;
        let metres = self.crs.metres_at(centre).ok_or_else(|| match self.crs.model {
            Model::Geographic => format!("latitude {} is none", centre[1] * self.crs.unit),
            Model::Geocentric => "geocentric coordinates are no map".to_owned(),
            _ => "the file names no unit of its coordinates".to_owned(),
        })?;
        let [mx, my] = metres;
        let sides = [(a * mx).hypot(d * my), (b * mx).hypot(e * my)];
        if !sides.iter().all(|v| *v > 0.0 && v.is_finite()) {
            return Err(format!("a pixel of {sides:?} m"));
        }
        let how = match self.crs.latitude(centre[1]) {
            Some(latitude) if self.crs.model == Model::Geographic => {
                format!("{} {} at latitude {latitude:.3}", a.hypot(d), self.crs.unit_name)
            }
            Some(latitude) => format!("{} {} of the map at latitude {latitude:.3}", a.hypot(d), self.crs.unit_name),
            None if self.crs.unit != 1.0 => format!("{} {}", a.hypot(d), self.crs.unit_name),
            None => String::new(),
        };
        Ok(Ground { metres: sides, how })
    }

    /// The map from the world's places, in voxels, to (x, y, height): columns are x, rows are z, and the centre of voxel `y` of a
    /// column stands for the height `base + y / scale`.
    pub fn world(&self, base: f64, scale: f64) -> [[f64; 4]; 3] {
        let [[a, b, c], [d, e, f]] = self.affine;
        [[a, 0.0, b, c], [d, 0.0, e, f], [0.0, 1.0 / scale, 0.0, base - 0.5 / scale]]
    }
}

#[cfg(test)]
mod tests;
