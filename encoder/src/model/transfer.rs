//! Transfer functions: what colour and opacity the values of a volume have. They make [`Classes`] of a window, and change those of
//! a scene without encoding it again.

use serde_json::Value;

use crate::model::matter::{Class, Classes, Mode};
use crate::{Result, Rgb};

/// Names of the functions that come with the program.
pub const PRESETS: [&str; 4] = ["bone", "soft-tissue", "smoke", "cloud"];

/// Points of a function at most.
const MAX_POINTS: usize = 4096;

/// Colour and opacity of a value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    pub value: f64,
    pub color: Rgb,
    /// Share of the light that one voxel of it takes, 0 to 1.
    pub opacity: f64,
}

/// Straight lines between points; before the first and behind the last it goes on level.
#[derive(Clone, Debug, PartialEq)]
pub struct Transfer {
    /// Ascending; of two of the same value the first ends what is below.
    points: Vec<Point>,
    /// Values are shares of the window, 0 to 1.
    shares: bool,
    /// What of a file has no part in it, each a phrase.
    pub left_out: Vec<String>,
}

impl Transfer {
    /// Of points that ascend.
    ///
    /// # Errors
    /// A sentence, where they do not, or are none, or an opacity is no share.
    pub fn new(points: Vec<Point>, shares: bool) -> Result<Transfer, String> {
        if !(1..=MAX_POINTS).contains(&points.len()) {
            return Err(format!("{} points, 1 to {MAX_POINTS} were expected", points.len()));
        }
        if let Some(p) = points.iter().find(|p| !p.value.is_finite() || !(0.0..=1.0).contains(&p.opacity)) {
            return Err(format!(
                "value {}, opacity {}: a number and a share from 0 to 1 were expected",
                p.value, p.opacity
            ));
        }
        if let Some(pair) = points.windows(2).find(|pair| pair[0].value > pair[1].value) {
            return Err(format!("value {} after {}: values that ascend were expected", pair[1].value, pair[0].value));
        }
        Ok(Transfer { points, shares, left_out: Vec::new() })
    }

    /// What scenes have where nobody says anything: from clear and dark to bright, more steeply towards the top.
    pub fn usual() -> Transfer {
        let point = |i: usize| {
            let value = i as f64 / 8.0;
            let grey = |low: f64, high: f64| (low + (high - low) * value).round() as u8;
            Point {
                value,
                color: [grey(150.0, 255.0), grey(80.0, 247.0), grey(60.0, 232.0)],
                opacity: 0.2 * value * value,
            }
        };
        Transfer { points: (0..=8).map(point).collect(), shares: true, left_out: Vec::new() }
    }

    /// One of [`PRESETS`]. Those of tissue are of Hounsfield units where the window reaches below 0, as that of a CT does; of other
    /// windows they are spread over it.
    pub fn preset(name: &str, window: [f64; 2]) -> Option<Transfer> {
        let hounsfield = window[0] < 0.0;
        let of = |shares: bool, points: &[(f64, Rgb, f64)]| {
            let points = points.iter().map(|&(value, color, opacity)| Point { value, color, opacity }).collect();
            Some(Transfer { points, shares, left_out: Vec::new() })
        };
        match (name, hounsfield) {
            ("bone", true) => of(
                false,
                &[
                    (150.0, [190, 120, 90], 0.0),
                    (300.0, [224, 190, 150], 0.08),
                    (700.0, [250, 238, 216], 0.4),
                    (2000.0, [255, 252, 246], 0.8),
                ],
            ),
            ("bone", false) => of(
                true,
                &[
                    (0.45, [190, 120, 90], 0.0),
                    (0.6, [224, 190, 150], 0.08),
                    (0.8, [250, 238, 216], 0.4),
                    (1.0, [255, 252, 246], 0.8),
                ],
            ),
            ("soft-tissue", true) => of(
                false,
                &[
                    (-200.0, [235, 200, 130], 0.0),
                    (-80.0, [235, 200, 130], 0.004),
                    (20.0, [206, 96, 76], 0.02),
                    (90.0, [186, 60, 52], 0.04),
                    (200.0, [224, 170, 140], 0.05),
                    (500.0, [255, 244, 226], 0.4),
                ],
            ),
            ("soft-tissue", false) => of(
                true,
                &[
                    (0.08, [235, 200, 130], 0.0),
                    (0.2, [235, 200, 130], 0.006),
                    (0.35, [206, 96, 76], 0.02),
                    (0.55, [186, 60, 52], 0.04),
                    (0.75, [224, 170, 140], 0.05),
                    (1.0, [255, 244, 226], 0.4),
                ],
            ),
            ("smoke", _) => {
                of(true, &[(0.0, [96, 92, 90], 0.0), (0.3, [128, 126, 124], 0.02), (1.0, [196, 194, 192], 0.2)])
            }
            ("cloud", _) => {
                of(true, &[(0.0, [214, 224, 240], 0.0), (0.4, [236, 240, 248], 0.05), (1.0, [255, 255, 255], 0.3)])
            }
            _ => None,
        }
    }

    /// A file's text: a list of `{"value", "color", "opacity"}`, or a colour map of ParaView's as it exports them.
    ///
    /// # Errors
    /// A sentence that says what was expected.
    pub fn parse(text: &str) -> Result<Transfer, String> {
        let json: Value =
            serde_json::from_str(text.trim_start_matches('\u{feff}')).map_err(|e| format!("no JSON: {e}"))?;
        let Some(list) = json.as_array() else {
            return Err("expected a JSON list of {\"value\", \"color\", \"opacity\"}".to_owned());
        };
        match list.first() {
            Some(map) if map.get("RGBPoints").is_some() || map.get("Points").is_some() => paraview(map, list.len()),
            _ => {
                let mut points = list.iter().enumerate().map(|(i, p)| point(i, p)).collect::<Result<Vec<_>, _>>()?;
                points.sort_by(|a, b| a.value.total_cmp(&b.value));
                Transfer::new(points, false)
            }
        }
    }

    /// The points, in the unit of values.
    pub fn points(&self, window: [f64; 2]) -> Vec<Point> {
        let place = |v: f64| if self.shares { window[0] + v * (window[1] - window[0]) } else { v };
        self.points.iter().map(|p| Point { value: place(p.value), ..*p }).collect()
    }

    /// Colour (0 to 255) and opacity of a value.
    fn at(points: &[Point], value: f64) -> ([f64; 3], f64) {
        let of = |p: &Point| (p.color.map(f64::from), p.opacity);
        let above = points.partition_point(|p| p.value <= value);
        match (above.checked_sub(1).map(|i| &points[i]), points.get(above)) {
            (Some(a), Some(b)) => {
                let t = (value - a.value) / (b.value - a.value);
                let mix = |a: f64, b: f64| a + (b - a) * t;
                let ((ca, oa), (cb, ob)) = (of(a), of(b));
                ([0, 1, 2].map(|i| mix(ca[i], cb[i])), mix(oa, ob))
            }
            (Some(p), None) | (None, Some(p)) => of(p),
            (None, None) => ([0.0; 3], 0.0),
        }
    }

    /// `n` classes of equal widths over a window.
    pub fn classes(&self, window: [f64; 2], n: usize) -> Classes {
        let points = self.points(window);
        let class = |k: usize| {
            let value = window[0] + (k as f64 + 0.5) / n as f64 * (window[1] - window[0]);
            let (color, opacity) = Transfer::at(&points, value);
            Class { color: color.map(|v| v.round() as u8), opacity, mode: Mode::Volumetric }
        };
        Classes { window: Some(window), classes: (0..n).map(class).collect() }
    }

    /// A file, or one of [`PRESETS`] by name, for a scene of this window.
    #[cfg(not(target_arch = "wasm32"))]
    pub fn open(name: &str, window: [f64; 2]) -> Result<Transfer> {
        if let Some(preset) = Transfer::preset(name, window) {
            return Ok(preset);
        }
        let path = std::path::Path::new(name);
        if !name.contains(['.', '/', '\\']) && !path.exists() {
            return Err(crate::Error::Argument(format!(
                "--transfer {name}: expected a JSON file, or one of {}",
                PRESETS.join(", ")
            )));
        }
        let size = std::fs::metadata(path).map_err(|e| crate::Error::io(path, "open", e))?.len();
        if size > 16 << 20 {
            return Err(crate::Error::format(path, format!("{size} bytes; a transfer function has at most 16 MiB")));
        }
        let text = std::fs::read_to_string(path).map_err(|e| crate::Error::io(path, "read", e))?;
        Transfer::parse(&text).map_err(|what| crate::Error::format(path, format!("transfer function: {what}")))
    }
}

fn point(i: usize, of: &Value) -> Result<Point, String> {
    let number = |name: &str| {
        of.get(name).and_then(Value::as_f64).ok_or_else(|| format!("point {i}: expected a number as {name:?}"))
    };
    let color = of.get("color").and_then(color);
    let color =
        color.ok_or_else(|| format!("point {i}: expected \"color\" as \"#rrggbb\" or [r, g, b] from 0 to 255"))?;
    Ok(Point { value: number("value")?, color, opacity: number("opacity")? })
}

fn color(of: &Value) -> Option<Rgb> {
    if let Some(text) = of.as_str() {
        let hex = text.strip_prefix('#').filter(|h| h.len() == 6 && h.bytes().all(|b| b.is_ascii_hexdigit()))?;
        let n = u32::from_str_radix(hex, 16).ok()?;
        return Some([(n >> 16) as u8, (n >> 8) as u8, n as u8]);
    }
    let channels: Vec<u8> = of.as_array()?.iter().map_while(|v| u8::try_from(v.as_u64()?).ok()).collect();
    channels.try_into().ok()
}

/// `RGBPoints` is a list of x, r, g, b, colours from 0 to 1; `Points`, where it is there, of x, opacity, midpoint, sharpness.
fn paraview(map: &Value, n_maps: usize) -> Result<Transfer, String> {
    let numbers = |name: &str| -> Result<Vec<f64>, String> {
        let Some(list) = map.get(name) else { return Ok(Vec::new()) };
        let list = list.as_array().ok_or_else(|| format!("{name}: expected a list of numbers"))?;
        list.iter().map(|v| v.as_f64().ok_or_else(|| format!("{name}: expected numbers, found {v}"))).collect()
    };
    let (colors, opacities) = (numbers("RGBPoints")?, numbers("Points")?);
    if colors.is_empty() || !colors.len().is_multiple_of(4) || !opacities.len().is_multiple_of(4) {
        return Err("RGBPoints: expected x, r, g, b for each point, and as many as four for each of Points".to_owned());
    }
    let (rgb, alpha) = (colors.as_chunks::<4>().0, opacities.as_chunks::<4>().0);
    let mut left_out = Vec::new();
    if n_maps > 1 {
        left_out.push(format!("{} colour maps after the first", n_maps - 1));
    }
    if alpha.iter().any(|p| p[2] != 0.5 || p[3] != 0.0) {
        left_out.push("midpoints and sharpness of opacities, which are taken as straight lines".to_owned());
    }
    let space = map.get("ColorSpace").and_then(Value::as_str).unwrap_or("RGB");
    if space != "RGB" {
        left_out.push(format!("the colour space {space}: colours between points are mixed in RGB"));
    }
    let (first, last) = (rgb[0][0], rgb[rgb.len() - 1][0]);
    let ascends = |list: &[[f64; 4]]| list.windows(2).all(|pair| pair[0][0] <= pair[1][0]);
    if !ascends(rgb) || !ascends(alpha) {
        return Err("points whose x ascend were expected".to_owned());
    }
    let ramp = |x: f64| if last > first { (x - first) / (last - first) * 0.2 } else { 0.2 };
    if alpha.is_empty() {
        left_out.push("opacities, which the file has none of: a ramp from 0 to 0.2".to_owned());
    }
    let rgb_points: Vec<Point> = rgb
        .iter()
        .map(|&[x, r, g, b]| {
            let color = [r, g, b].map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8);
            Point { value: x, color, opacity: ramp(x).clamp(0.0, 1.0) }
        })
        .collect();
    let opacity_points: Vec<Point> =
        alpha.iter().map(|&[x, a, ..]| Point { value: x, color: [0; 3], opacity: a }).collect();
    // A point wherever either of the two has one.
    let mut places: Vec<f64> = rgb.iter().chain(alpha).map(|p| p[0]).collect();
    places.sort_by(f64::total_cmp);
    places.dedup();
    let points = places.into_iter().map(|value| {
        let (color, own) = Transfer::at(&rgb_points, value);
        let opacity = if alpha.is_empty() { own } else { Transfer::at(&opacity_points, value).1 };
        Point { value, color: color.map(|v| v.round() as u8), opacity }
    });
    let points: Vec<Point> = points.collect();
    // A map of no data in particular goes from 0 to 1.
    let shares = (first, last) == (0.0, 1.0);
    Ok(Transfer { left_out, ..Transfer::new(points, shares)? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_joined_by_straight_lines_in_the_data_s_unit() {
        let text =
            r##"[{"value": 100, "color": "#204060", "opacity": 0.5}, {"value": 0, "color": [0, 0, 0], "opacity": 0}]"##;
        let transfer = Transfer::parse(text).unwrap();
        let classes = transfer.classes([0.0, 200.0], 4);
        let found: Vec<_> = classes.classes.iter().map(|c| (c.color, c.opacity)).collect();
        assert_eq!(found, [([8, 16, 24], 0.125), ([24, 48, 72], 0.375), ([32, 64, 96], 0.5), ([32, 64, 96], 0.5)]);
        assert_eq!(classes.value(1), Some(25.0));
    }

    #[test]
    fn colour_maps_of_paraview_are_read_with_their_opacities() {
        let text = r#"[{"ColorSpace": "RGB", "Name": "x", "RGBPoints": [-10, 0, 0, 0, 30, 1, 0.5, 0], "Points": [-10, 0, 0.5, 0, 10, 0.4, 0.5, 0]}]"#;
        let transfer = Transfer::parse(text).unwrap();
        let points: Vec<_> = transfer.points([0.0, 1.0]).iter().map(|p| (p.value, p.color, p.opacity)).collect();
        assert_eq!(points, [(-10.0, [0; 3], 0.0), (10.0, [128, 64, 0], 0.4), (30.0, [255, 128, 0], 0.4)]);
        assert!(transfer.left_out.is_empty());
        let clear = Transfer::parse(r#"[{"ColorSpace": "Lab", "RGBPoints": [0, 0, 0, 0, 1, 1, 1, 1]}]"#).unwrap();
        assert_eq!(clear.left_out.len(), 2);
        assert_eq!(clear.points([4.0, 6.0])[1], Point { value: 6.0, color: [255; 3], opacity: 0.2 });
    }

    #[test]
    fn what_is_no_transfer_function_is_refused_by_what_is_wrong() {
        for (text, what) in [
            ("", "no JSON"),
            ("{}", "expected a JSON list"),
            ("[]", "0 points"),
            (r#"[{"value": 1}]"#, "point 0: expected \"color\""),
            (r##"[{"value": 1, "color": "#12345g", "opacity": 1}]"##, "point 0: expected \"color\""),
            (r##"[{"value": 1, "color": "#123456", "opacity": 1.5}]"##, "opacity 1.5"),
            (r##"[{"color": "#123456", "opacity": 1}]"##, "a number as \"value\""),
            (r#"[{"RGBPoints": [0, 1, 1]}]"#, "x, r, g, b"),
            (r#"[{"RGBPoints": [1, 0, 0, 0, 0, 1, 1, 1]}]"#, "ascend"),
        ] {
            let error = Transfer::parse(text).unwrap_err();
            assert!(error.contains(what), "{text}: {error}");
        }
        assert!(PRESETS.iter().all(|name| Transfer::preset(name, [-1000.0, 2000.0]).is_some()));
        assert!(Transfer::preset("bones", [0.0, 1.0]).is_none());
    }
}
