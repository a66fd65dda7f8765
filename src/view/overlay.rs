//! What is drawn over the picture: a scale bar, north, what is under the mouse, a ruler, marks of errors.

use egui::{Align2, Color32, FontId, Painter, Pos2, Rect, Stroke, pos2, vec2};
use glam::DVec3;
use planecast_encoder::About;

use crate::film::path::Pose;
use crate::frame::camera::Camera;

/// Points that a scale bar takes at most.
const BAR: f64 = 160.0;

/// Points from the lower edge to the scale bar.
const ABOVE_WORDS: f32 = 44.0;

/// Pixels of an error that are shown enlarged, to each side, and how large each is, points.
const AROUND: i64 = 6;
const LARGE: f32 = 7.0;

/// Two places and the line between them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Ruler {
    pub on: bool,
    /// None, one or two, voxels of level 0.
    pub places: Vec<DVec3>,
}

impl Ruler {
    /// Takes a place: a third one begins anew.
    pub fn take(&mut self, place: DVec3) {
        if self.places.len() > 1 {
            self.places.clear();
        }
        self.places.push(place);
    }
}

/// The frame and the exact one, for an error that is looked at.
pub struct Fault<'f> {
    pub at: [u32; 2],
    pub size: [u32; 2],
    pub frame: &'f [[u8; 4]],
    pub exact: &'f [[u8; 4]],
}

/// What there is to draw.
pub struct Overlay<'o> {
    pub pose: Pose,
    pub about: &'o About,
    /// Points of the window that the picture takes.
    pub area: Rect,
    /// Voxels from the eye to what the middle of the picture shows.
    pub distance: Option<f64>,
    /// Words on what is under the mouse.
    pub hover: Option<String>,
    pub ruler: &'o Ruler,
    pub fault: Option<Fault<'o>>,
}

/// Sides of a voxel and their unit: 1 and "voxels" where nobody said how large they are.
fn sides(about: &About) -> ([f64; 3], &str) {
    match about.voxel {
        Some(sides) => (sides, if about.unit.is_empty() { "units" } else { &about.unit }),
        None => ([1.0; 3], "voxels"),
    }
}

/// A length, as a person says it.
pub fn length(v: f64, unit: &str) -> String {
    let (v, unit) = match unit {
        "m" if v >= 1000.0 => (v / 1000.0, "km"),
        "mm" if v >= 10_000.0 => (v / 1000.0, "m"),
        "µm" if v >= 1000.0 => (v / 1000.0, "mm"),
        unit => (v, unit),
    };
    let decimals = (2.0 - v.abs().max(1e-9).log10().floor()).clamp(0.0, 6.0) as usize;
    let text = format!("{v:.decimals$}");
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    format!("{text} {unit}")
}

/// The length of the ruler, and what it is made of.
pub fn measured(about: &About, from: DVec3, to: DVec3) -> String {
    let (sides, unit) = sides(about);
    let d = (to - from) * DVec3::from(sides);
    format!(
        "{}: {} across, {} {}",
        length(d.length(), unit),
        length(d.x.hypot(d.z), unit),
        length(d.y.abs(), unit),
        if d.y < 0.0 { "down" } else { "up" }
    )
}

/// Where a place of the world is, in voxels, of which a coarse one is several wide, and in coordinates of the source.
pub fn place(about: &About, voxel: [u32; 3], level: u32, at: DVec3, value: Option<f32>) -> String {
    let [x, y, z] = voxel;
    let mut text = format!("voxel {x}, {y}, {z}");
    if level > 0 {
        text += &format!(" ({} wide)", 1u64 << level);
    }
    if let Some(rows) = about.affine {
        let [east, north, up] = rows.map(|[a, b, c, d]| a * at.x + b * at.y + c * at.z + d);
        let fine = |row: [f64; 4]| row[..3].iter().map(|v| v.abs()).fold(0.0, f64::max);
        let number =
            |v: f64, step: f64| format!("{v:.*}", (1.0 - step.max(1e-9).log10().floor()).clamp(0.0, 8.0) as usize);
        let names = if about.crs.is_empty() { ["", "", ""] } else { ["E ", "N ", "height "] };
        text += &format!(
            "   {}{}, {}{}, {}{}",
            names[0],
            number(east, fine(rows[0])),
            names[1],
            number(north, fine(rows[1])),
            names[2],
            number(up, fine(rows[2])),
        );
        if !about.unit.is_empty() {
            text += &format!(" {}", about.unit);
        }
    }
    if let Some(value) = value {
        text += &format!("   value {value}");
    }
    text
}

/// Degrees clockwise from straight ahead to north, seen from above; None where nothing says where north is.
fn north(about: &About, yaw: f64) -> Option<f64> {
    let [[a, _, b, _], [d, _, e, _], _] = about.affine.filter(|_| !about.crs.is_empty())?;
    let turn = a * e - b * d;
    // The way on the ground along which east stays and north grows.
    let (x, z) = (-b / turn, a / turn);
    let way = x.atan2(-z).to_degrees();
    (turn != 0.0 && way.is_finite()).then_some(way - yaw)
}

impl Overlay<'_> {
    /// Points of the window where a place shows; None behind the eye.
    fn project(&self, at: DVec3) -> Option<Pos2> {
        let camera: Camera = self.pose.camera([self.area.width().max(1.0) as u32, self.area.height().max(1.0) as u32]);
        let (basis, half) = (camera.basis(), camera.half_extent());
        let d = at - self.pose.eye;
        let depth = d.dot(basis.forward);
        let (x, y) = (d.dot(basis.right) / depth / half.x, d.dot(basis.up) / depth / half.y);
        let middle = self.area.center();
        let shown = depth > 0.0 && x.abs() < 10.0 && y.abs() < 10.0;
        shown.then(|| middle + vec2(x as f32 * self.area.width() / 2.0, -y as f32 * self.area.height() / 2.0))
    }

    pub fn paint(&self, ctx: &egui::Context) {
        let paint = ctx.layer_painter(egui::LayerId::background()).with_clip_rect(self.area);
        self.scale_bar(&paint);
        self.compass(&paint);
        if let Some(text) = &self.hover {
            words(&paint, self.area.left_bottom() + vec2(10.0, -10.0), Align2::LEFT_BOTTOM, text);
        }
        let places: Vec<Option<Pos2>> = self.ruler.places.iter().map(|p| self.project(*p)).collect();
        for at in places.iter().flatten() {
            paint.circle(*at, 5.0, Color32::from_rgb(255, 220, 60), Stroke::new(1.5, Color32::BLACK));
        }
        if let [from, to] = self.ruler.places[..] {
            if let [Some(a), Some(b)] = places[..] {
                paint.line_segment([a, b], Stroke::new(4.0, Color32::BLACK));
                paint.line_segment([a, b], Stroke::new(2.0, Color32::from_rgb(255, 220, 60)));
            }
            let middle = [places[0], places[1]].into_iter().flatten().next_back().unwrap_or(self.area.center());
            words(&paint, middle + vec2(10.0, -10.0), Align2::LEFT_BOTTOM, &measured(self.about, from, to));
        }
        if let Some(fault) = &self.fault {
            self.fault(&paint, fault);
        }
    }

    fn scale_bar(&self, paint: &Painter) {
        let Some(distance) = self.distance.filter(|d| *d > 0.0 && d.is_finite()) else { return };
        let ([side, ..], unit) = sides(self.about);
        let half = self.pose.camera([1, 1]).half_extent();
        // Points that a voxel takes in the middle of the picture.
        let voxel = f64::from(self.area.height()) / (2.0 * half.y * distance);
        let most = BAR / voxel * side;
        let power = 10f64.powf(most.log10().floor());
        let nice = [5.0, 2.0, 1.0].into_iter().map(|n| n * power).find(|n| *n <= most).unwrap_or(power);
        let long = (nice / side * voxel) as f32;
        // Above the line that tells what is under the mouse; messages stand to the right.
        let start = self.area.left_bottom() + vec2(14.0, -ABOVE_WORDS);
        let end = start + vec2(long, 0.0);
        for (wide, color) in [(4.0, Color32::BLACK), (2.0, Color32::WHITE)] {
            let line = Stroke::new(wide, color);
            paint.line_segment([start, end], line);
            for at in [start, end] {
                paint.line_segment([at - vec2(0.0, 5.0), at + vec2(0.0, 5.0)], line);
            }
        }
        let text = length(nice, unit);
        shadowed(paint, start - vec2(0.0, 6.0), Align2::LEFT_BOTTOM, &text);
    }

    fn compass(&self, paint: &Painter) {
        let Some(degrees) = north(self.about, self.pose.yaw) else { return };
        let (s, c) = (degrees.to_radians().sin() as f32, degrees.to_radians().cos() as f32);
        let middle = self.area.right_top() + vec2(-34.0, 38.0);
        let (ahead, side) = (vec2(s, -c), vec2(c, s));
        let tip = middle + ahead * 12.0;
        let shape =
            [tip, middle + side * 7.0 - ahead * 18.0, middle - ahead * 12.0, middle - side * 7.0 - ahead * 18.0];
        paint.circle_filled(middle, 30.0, Color32::from_black_alpha(110));
        paint.add(egui::Shape::convex_polygon(shape[..3].to_vec(), Color32::WHITE, Stroke::NONE));
        paint.add(egui::Shape::convex_polygon(
            vec![shape[0], shape[2], shape[3]],
            Color32::from_gray(170),
            Stroke::NONE,
        ));
        shadowed(paint, middle + ahead * 20.0, Align2::CENTER_CENTER, "N");
    }

    /// A ring about an error, and its pixels as they are and as they should be.
    fn fault(&self, paint: &Painter, fault: &Fault<'_>) {
        let per = self.area.size() / vec2(fault.size[0] as f32, fault.size[1] as f32);
        let at = self.area.min + vec2(fault.at[0] as f32 + 0.5, fault.at[1] as f32 + 0.5) * per;
        paint.circle_stroke(at, 22.0, Stroke::new(4.0, Color32::BLACK));
        paint.circle_stroke(at, 22.0, Stroke::new(2.0, Color32::WHITE));
        let wide = LARGE * (2 * AROUND + 1) as f32;
        for (k, (pixels, name)) in [(fault.frame, "drawn"), (fault.exact, "exact")].into_iter().enumerate() {
            let corner = self.area.left_top() + vec2(12.0 + k as f32 * (wide + 8.0), 28.0);
            paint.rect_filled(Rect::from_min_size(corner, vec2(wide, wide)).expand(2.0), 0.0, Color32::BLACK);
            for dy in -AROUND..=AROUND {
                for dx in -AROUND..=AROUND {
                    let (x, y) = (i64::from(fault.at[0]) + dx, i64::from(fault.at[1]) + dy);
                    let inside = (0..fault.size[0].into()).contains(&x) && (0..fault.size[1].into()).contains(&y);
                    let Some([r, g, b, _]) = inside.then(|| pixels[(y * i64::from(fault.size[0]) + x) as usize]) else {
                        continue;
                    };
                    let place = corner + vec2((dx + AROUND) as f32, (dy + AROUND) as f32) * LARGE;
                    paint.rect_filled(Rect::from_min_size(place, vec2(LARGE, LARGE)), 0.0, Color32::from_rgb(r, g, b));
                }
            }
            shadowed(paint, corner - vec2(0.0, 4.0), Align2::LEFT_BOTTOM, name);
        }
    }
}

fn shadowed(paint: &Painter, at: Pos2, align: Align2, text: &str) {
    let font = FontId::proportional(14.0);
    for (x, y) in [(-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0)] {
        paint.text(pos2(at.x + x, at.y + y), align, text, font.clone(), Color32::BLACK);
    }
    paint.text(at, align, text, font, Color32::WHITE);
}

/// Words on a dark ground.
fn words(paint: &Painter, at: Pos2, align: Align2, text: &str) {
    let galley = paint.layout_no_wrap(text.to_owned(), FontId::proportional(13.0), Color32::WHITE);
    let ground = align.anchor_size(at, galley.size()).expand(5.0);
    // Whole at the picture's edges too.
    let picture = paint.clip_rect();
    let right = (picture.right() - ground.right()).min(0.0).max(picture.left() - ground.left());
    let ground = ground.translate(vec2(right, (picture.top() - ground.top()).max(0.0)));
    paint.rect_filled(ground, 4.0, Color32::from_black_alpha(190));
    paint.galley(ground.shrink(5.0).min, galley, Color32::WHITE);
}

#[cfg(test)]
mod tests {
    use planecast_encoder::model::about::Kind;

    use super::*;

    /// A map of 30 m pixels whose columns run east and rows south, from 500,000 E 4,000,000 N, 10 m high voxels.
    fn map() -> About {
        About {
            voxel: Some([30.0, 10.0, 30.0]),
            unit: "m".into(),
            crs: "EPSG:32617".into(),
            affine: Some([[30.0, 0.0, 0.0, 5e5], [0.0, 0.0, -30.0, 4e6], [0.0, 10.0, 0.0, 200.0]]),
            ..About::new(Kind::Terrain, "GeoTIFF")
        }
    }

    #[test]
    fn a_ruler_measures_on_the_ground_and_begins_anew_with_a_third_place() {
        let (a, b) = (DVec3::new(10.0, 5.0, 10.0), DVec3::new(13.0, 7.0, 14.0));
        assert_eq!(measured(&map(), a, b), "151 m: 150 m across, 20 m up");
        assert_eq!(measured(&map(), b, a), "151 m: 150 m across, 20 m down");
        assert_eq!(measured(&About::default(), a, b), "5.39 voxels: 5 voxels across, 2 voxels up");
        let mut ruler = Ruler::default();
        [a, b, a].into_iter().for_each(|p| ruler.take(p));
        assert_eq!(ruler.places, [a]);
    }

    #[test]
    fn lengths_are_said_in_three_digits() {
        for (v, unit, text) in [
            (12_345.0, "m", "12.3 km"),
            (0.123_456, "mm", "0.123 mm"),
            (999.0, "m", "999 m"),
            (2500.0, "µm", "2.5 mm"),
            (50.0, "voxels", "50 voxels"),
        ] {
            assert_eq!(length(v, unit), text);
        }
    }

    #[test]
    fn a_place_is_told_in_voxels_and_in_coordinates() {
        let at = DVec3::new(10.5, 6.0, 20.5);
        assert_eq!(place(&map(), [10, 5, 20], 0, at, None), "voxel 10, 5, 20   E 500315, N 3999385, height 260 m");
        assert_eq!(place(&About::default(), [1, 2, 3], 0, at, Some(87.0)), "voxel 1, 2, 3   value 87");
        assert_eq!(place(&About::default(), [8, 0, 16], 3, at, None), "voxel 8, 0, 16 (8 wide)");
    }

    #[test]
    fn north_is_where_the_map_has_it() {
        // Yaw 0 looks along −z: north, where rows run south.
        assert!(north(&map(), 0.0).unwrap().abs() < 1e-9);
        assert!((north(&map(), 90.0).unwrap() + 90.0).abs() < 1e-9, "looking east, north is to the left");
        let mut turned = map();
        turned.affine = Some([[0.0, 0.0, 30.0, 0.0], [30.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]]);
        assert!((north(&turned, 0.0).unwrap() - 90.0).abs() < 1e-9, "columns run north: along +x");
        assert_eq!(north(&About::default(), 0.0), None);
    }
}
