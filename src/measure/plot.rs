//! Plots as SVG: scatter with its Pareto front, bars, lines. Axes are linear or logarithmic.
//!
//! Values that are not finite are left out. On a logarithmic axis what is 0 or less stands on the axis' end, at a tick
//! that reads 0.

use plotters::backend::SVGBackend;
use plotters::chart::{ChartBuilder, ChartContext};
use plotters::coord::Shift;
use plotters::coord::cartesian::Cartesian2d;
use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};
use plotters::drawing::{DrawingArea, IntoDrawingArea};
use plotters::element::{Circle, PathElement, Rectangle, Text};
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{Color, IntoFont, RGBColor, ShapeStyle, TextStyle};
use std::ops::Range;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scale {
    #[default]
    Linear,
    Log,
}

/// What one axis shows. Linear axes of bars start at 0.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Axis {
    /// With its unit.
    pub label: String,
    pub scale: Scale,
}

impl Axis {
    pub fn linear(label: &str) -> Axis {
        Axis { label: label.into(), scale: Scale::Linear }
    }

    pub fn log(label: &str) -> Axis {
        Axis { label: label.into(), scale: Scale::Log }
    }
}

/// Named points; where smaller is better on both axes, with their Pareto front.
#[derive(Clone, Debug, Default)]
pub struct Scatter {
    pub title: String,
    pub x: Axis,
    pub y: Axis,
    pub groups: Vec<Group>,
    pub front: Front,
}

/// Of which points those are marked than which none is better on both axes. Points that are quoted are never among them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Front {
    #[default]
    None,
    /// Of all together.
    OfAll,
    /// Of each group by itself: groups are conditions, and one is no choice over another.
    OfEach,
}

/// Points of one colour.
#[derive(Clone, Debug, Default)]
pub struct Group {
    /// Empty: not in the legend.
    pub name: String,
    /// Figures from elsewhere, drawn hollow.
    pub quoted: bool,
    pub points: Vec<Point>,
}

#[derive(Clone, Debug, Default)]
pub struct Point {
    pub x: f64,
    pub y: f64,
    /// Extent of x, drawn as a thin line.
    pub spread: Option<[f64; 2]>,
    /// Written beside the point where there is room; points of the front come first.
    pub label: String,
}

/// Horizontal bars, a row each, of one or several parts.
#[derive(Clone, Debug, Default)]
pub struct Bars {
    pub title: String,
    pub value: Axis,
    /// Names of the parts; one without a legend.
    pub parts: Vec<String>,
    pub rows: Vec<BarRow>,
    /// Parts end to end, on a linear axis; otherwise one below the other.
    pub stacked: bool,
}

#[derive(Clone, Debug, Default)]
pub struct BarRow {
    pub name: String,
    /// Figures from elsewhere, drawn pale.
    pub quoted: bool,
    /// One a part.
    pub values: Vec<f64>,
}

#[derive(Clone, Debug, Default)]
pub struct Lines {
    pub title: String,
    pub x: Axis,
    pub y: Axis,
    pub series: Vec<Series>,
}

/// Points joined in their order.
#[derive(Clone, Debug, Default)]
pub struct Series {
    pub name: String,
    /// Figures from elsewhere, drawn hollow and pale.
    pub quoted: bool,
    pub points: Vec<[f64; 2]>,
}

/// Indices of the points than which none is as good or better on both axes and better on one, by rising x. Of equal
/// points the first. Points that are not finite are never among them.
pub fn pareto(points: &[[f64; 2]]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..points.len()).filter(|&i| points[i].iter().all(|v| v.is_finite())).collect();
    order.sort_by(|&a, &b| points[a][0].total_cmp(&points[b][0]).then(points[a][1].total_cmp(&points[b][1])));
    let mut best = f64::INFINITY;
    order.retain(|&i| {
        points[i][1] < best && {
            best = points[i][1];
            true
        }
    });
    order
}

const COLORS: [RGBColor; 8] = [
    RGBColor(31, 102, 173),
    RGBColor(217, 95, 2),
    RGBColor(27, 138, 90),
    RGBColor(166, 54, 118),
    RGBColor(117, 107, 177),
    RGBColor(166, 118, 29),
    RGBColor(90, 90, 90),
    RGBColor(60, 160, 200),
];
const INK: RGBColor = RGBColor(28, 36, 48);
const FAINT: RGBColor = RGBColor(226, 230, 236);
const FRONT: RGBColor = RGBColor(196, 30, 58);
const WIDTH: u32 = 960;
/// Height of text and width of a letter, pixels; the widths that a reader's font gives are near.
const TEXT: i32 = 12;
const LETTER: f64 = 6.3;

fn letters(text: &str) -> i32 {
    (text.chars().count() as f64 * LETTER).ceil() as i32
}

/// One axis as the plotting library sees it.
#[derive(Clone)]
struct Coordinate {
    scale: Scale,
    range: [f64; 2],
    /// The end of a logarithmic axis stands for 0 and less.
    zero: bool,
    /// Rows of bars instead of numbers.
    names: Vec<String>,
}

impl Coordinate {
    /// Room for `values`; with `from_zero`, linear axes begin at 0.
    fn over(scale: Scale, from_zero: bool, values: impl Iterator<Item = f64>) -> Coordinate {
        let values: Vec<f64> = values.filter(|v| v.is_finite()).collect();
        let extent = |keep: &dyn Fn(f64) -> bool| {
            let kept = values.iter().copied().filter(|&v| keep(v));
            kept.fold([f64::INFINITY, f64::NEG_INFINITY], |[lo, hi], v| [lo.min(v), hi.max(v)])
        };
        let (range, zero) = match scale {
            Scale::Linear => {
                let [mut lo, mut hi] = extent(&|_| true);
                if lo > hi {
                    (lo, hi) = (0.0, 1.0);
                }
                if from_zero || lo > 0.0 && lo < 0.4 * hi {
                    lo = lo.min(0.0);
                }
                let pad = if hi > lo { (hi - lo) * 0.04 } else { hi.abs().max(1.0) * 0.1 };
                ([if lo == 0.0 { 0.0 } else { lo - pad }, hi + pad], false)
            }
            Scale::Log => {
                let [mut lo, mut hi] = extent(&|v| v > 0.0);
                if lo > hi {
                    (lo, hi) = (1.0, 10.0);
                }
                let zero = values.iter().any(|&v| v <= 0.0);
                // A whole decade under the least value for what is 0.
                let lo = if zero { 10f64.powf(lo.log10().floor() - 1.0) } else { lo / 1.25 };
                ([lo, hi * 1.25], zero)
            }
        };
        Coordinate { scale, range, zero, names: Vec::new() }
    }

    fn rows(names: Vec<String>) -> Coordinate {
        Coordinate { scale: Scale::Linear, range: [names.len() as f64, 0.0], zero: false, names }
    }

    /// 0 ..= 1 along the axis.
    fn share(&self, v: f64) -> f64 {
        let [lo, hi] = self.range;
        match self.scale {
            Scale::Linear => (v - lo) / (hi - lo),
            Scale::Log => (v.max(lo).ln() - lo.ln()) / (hi.ln() - lo.ln()),
        }
    }

    fn ticks(&self, most: usize) -> Vec<f64> {
        let [lo, hi] = self.range;
        if !self.names.is_empty() {
            return (0..self.names.len()).map(|i| i as f64 + 0.5).collect();
        }
        match self.scale {
            Scale::Linear => {
                let rough = (hi - lo) / most.clamp(2, 10) as f64;
                let decade = 10f64.powf(rough.log10().floor());
                let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * decade).into_iter().find(|&s| s >= rough * 0.999);
                let step = step.unwrap_or(10.0 * decade);
                let first = (lo / step).ceil() as i64;
                (first..).map(|k| k as f64 * step).take_while(|&v| v <= hi * (1.0 + 1e-12)).collect()
            }
            Scale::Log => {
                let parts: &[f64] = if hi / lo < 200.0 { &[1.0, 2.0, 5.0] } else { &[1.0] };
                let decades = lo.log10().floor() as i32..=hi.log10().ceil() as i32;
                let all = decades.flat_map(|d| parts.iter().map(move |p| p * 10f64.powi(d)));
                all.filter(|&v| v >= lo * 0.999 && v <= hi * 1.001).collect()
            }
        }
    }
}

impl Ranged for Coordinate {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, v: &f64, (from, to): (i32, i32)) -> i32 {
        (f64::from(from) + self.share(*v) * f64::from(to - from)).round() as i32
    }

    fn key_points<H: KeyPointHint>(&self, hint: H) -> Vec<f64> {
        self.ticks(hint.max_num_points())
    }

    fn range(&self) -> Range<f64> {
        self.range[0]..self.range[1]
    }
}

impl ValueFormatter<f64> for Coordinate {
    fn format_ext(&self, v: &f64) -> String {
        match self.names.get(v.max(0.0) as usize) {
            Some(name) => name.clone(),
            None if self.zero && *v <= self.range[0] * 1.001 => "0".into(),
            None => number(*v),
        }
    }
}

/// A tick's number: at most four significant digits.
fn number(v: f64) -> String {
    if v == 0.0 {
        return "0".into();
    }
    let size = v.abs().log10().floor();
    if !(-5.0..7.0).contains(&size) {
        return format!("{v:e}");
    }
    let text = format!("{v:.*}", (3.0 - size).max(0.0) as usize);
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').into() } else { text }
}

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Chart<'a, 'b> = ChartContext<'b, SVGBackend<'a>, Cartesian2d<Coordinate, Coordinate>>;

const INFALLIBLE: &str = "drawing into a string does not fail";

/// Draws a titled plot with its legend on top; `draw` fills the area below.
fn svg(height: u32, title: &str, legend: &[(&str, RGBColor, bool)], draw: impl FnOnce(&Area<'_>)) -> String {
    let mut out = String::new();
    {
        let area = SVGBackend::with_string(&mut out, (WIDTH, height)).into_drawing_area();
        area.fill(&RGBColor(255, 255, 255)).expect(INFALLIBLE);
        area.draw(&Text::new(title.to_owned(), (10, 8), text(16, INK))).expect(INFALLIBLE);
        let (mut x, mut y) = (10, 34);
        for (name, color, quoted) in legend.iter().filter(|(name, ..)| !name.is_empty()) {
            let name = if *quoted { format!("{name} (quoted)") } else { (*name).to_owned() };
            let width = 34 + letters(&name);
            if x + width > WIDTH as i32 && x > 10 {
                (x, y) = (10, y + 18);
            }
            let style = if *quoted { color.stroke_width(1) } else { color.filled() };
            area.draw(&Rectangle::new([(x, y), (x + 12, y + 11)], style)).expect(INFALLIBLE);
            area.draw(&Text::new(name, (x + 17, y), text(TEXT, INK))).expect(INFALLIBLE);
            x += width;
        }
        let (_, below) = area.split_vertically(if legend.iter().all(|l| l.0.is_empty()) { 30 } else { y + 20 });
        draw(&below);
        area.present().expect(INFALLIBLE);
    }
    out
}

fn text(size: i32, color: RGBColor) -> TextStyle<'static> {
    TextStyle { color: color.to_backend_color(), ..TextStyle::from(("sans-serif", size).into_font()) }
}

/// Axes and grid.
fn chart<'a, 'b>(area: &'b Area<'a>, x: (Coordinate, &str), y: (Coordinate, &str)) -> Chart<'a, 'b> {
    let left = y.0.ticks(10).iter().map(|v| letters(&y.0.format_ext(v))).max().unwrap_or(0) + 14;
    let left = left + if y.1.is_empty() { 0 } else { 24 };
    let rows = y.0.names.len();
    let mut chart = ChartBuilder::on(area)
        .margin_left(10)
        .margin_right(24)
        .margin_top(6)
        .x_label_area_size(44)
        .y_label_area_size(left)
        .build_cartesian_2d(x.0, y.0)
        .expect(INFALLIBLE);
    let mut mesh = chart.configure_mesh();
    mesh.x_desc(x.1)
        .y_desc(y.1)
        .bold_line_style(FAINT)
        .light_line_style(plotters::style::TRANSPARENT)
        .axis_style(INK.mix(0.5))
        .label_style(text(TEXT, INK))
        .axis_desc_style(text(13, INK));
    if rows > 0 {
        mesh.disable_y_mesh().y_labels(rows);
    }
    mesh.draw().expect(INFALLIBLE);
    chart
}

impl Scatter {
    pub fn svg(&self) -> String {
        let points = || self.groups.iter().flat_map(|g| &g.points);
        let ends = points().flat_map(|p| [p.x].into_iter().chain(p.spread.into_iter().flatten()));
        let x = Coordinate::over(self.x.scale, false, ends);
        let y = Coordinate::over(self.y.scale, false, points().map(|p| p.y));
        let color = |g: usize| COLORS[g % COLORS.len()];
        let mut legend: Vec<_> =
            self.groups.iter().enumerate().map(|(g, group)| (&*group.name, color(g), group.quoted)).collect();
        if self.front != Front::None {
            legend.push(("Pareto front", FRONT, false));
        }
        // (group, point) of all that are drawn.
        let all: Vec<(usize, &Point)> = (self.groups.iter().enumerate())
            .flat_map(|(g, group)| group.points.iter().map(move |p| (g, p)))
            .filter(|(_, p)| p.x.is_finite() && p.y.is_finite())
            .collect();
        let own: Vec<usize> = (0..all.len()).filter(|&i| !self.groups[all[i].0].quoted).collect();
        let front_of = |own: Vec<usize>| -> Vec<usize> {
            let at: Vec<[f64; 2]> = own.iter().map(|&i| [all[i].1.x, all[i].1.y]).collect();
            pareto(&at).into_iter().map(|i| own[i]).collect()
        };
        let of_group = |g: usize| own.iter().copied().filter(|&i| all[i].0 == g).collect();
        let fronts: Vec<Vec<usize>> = match self.front {
            Front::None => Vec::new(),
            Front::OfAll => vec![front_of(own)],
            Front::OfEach => (0..self.groups.len()).map(|g| front_of(of_group(g))).collect(),
        };
        let front = fronts.concat();
        svg(620, &self.title, &legend, |area| {
            let mut chart = chart(area, (x, &self.x.label), (y, &self.y.label));
            for front in &fronts {
                let steps = front.windows(2).flat_map(|w| {
                    let (a, b) = (all[w[0]].1, all[w[1]].1);
                    [(a.x, a.y), (b.x, a.y), (b.x, b.y)]
                });
                let ink = match (self.front, front.first()) {
                    (Front::OfEach, Some(&i)) => color(all[i].0),
                    _ => FRONT,
                };
                chart
                    .draw_series([PathElement::new(steps.collect::<Vec<_>>(), ink.mix(0.6).stroke_width(2))])
                    .expect(INFALLIBLE);
            }
            for &(g, p) in &all {
                if let Some([lo, hi]) = p.spread.filter(|s| s.iter().all(|v| v.is_finite())) {
                    let line = PathElement::new(vec![(lo, p.y), (hi, p.y)], color(g).mix(0.35));
                    chart.draw_series([line]).expect(INFALLIBLE);
                }
            }
            let style = |g: usize| -> ShapeStyle {
                if self.groups[g].quoted { color(g).stroke_width(1) } else { color(g).filled() }
            };
            for (i, &(g, p)) in all.iter().enumerate() {
                chart.draw_series([Circle::new((p.x, p.y), 4, style(g))]).expect(INFALLIBLE);
                if front.contains(&i) {
                    chart.draw_series([Circle::new((p.x, p.y), 7, FRONT.stroke_width(2))]).expect(INFALLIBLE);
                }
            }
            let pixel = |p: &Point| chart.backend_coord(&(p.x, p.y));
            let places: Vec<(i32, i32)> = all.iter().map(|(_, p)| pixel(p)).collect();
            let rest = (0..all.len()).filter(|i| !front.contains(i));
            let order: Vec<usize> = front.iter().copied().chain(rest).collect();
            let labels: Vec<&str> = order.iter().map(|&i| &*all[i].1.label).collect();
            let at: Vec<(i32, i32)> = order.iter().map(|&i| places[i]).collect();
            let (right, down) = chart.plotting_area().get_pixel_range();
            let bounds = [right.start, down.start, right.end, down.end];
            let placed = place_labels(&at, &labels, front.len(), bounds);
            let origin = area.get_pixel_range();
            let root = |(x, y): (i32, i32)| (x - origin.0.start, y - origin.1.start);
            for ((&i, label), place) in order.iter().zip(&labels).zip(placed) {
                let Some((corner, far)) = place else { continue };
                if far {
                    let near = (places[i].0.clamp(corner.0, corner.0 + letters(label)), corner.1 + TEXT / 2);
                    let line = PathElement::new(vec![root(places[i]), root(near)], INK.mix(0.25));
                    area.draw(&line).expect(INFALLIBLE);
                }
                let ink = if front.contains(&i) { FRONT } else { INK };
                area.draw(&Text::new((*label).to_owned(), root(corner), text(TEXT, ink))).expect(INFALLIBLE);
            }
        })
    }
}

/// Where each label goes (upper left corner, and whether it is far from its point), the first ones first: within
/// `bounds` (left, top, right, bottom), over no point and no other label. `None` where there is no room. The first `front`
/// stand above their points if they can, clear of the line that joins those.
fn place_labels(
    points: &[(i32, i32)],
    labels: &[&str],
    front: usize,
    bounds: [i32; 4],
) -> Vec<Option<((i32, i32), bool)>> {
    let mut taken: Vec<[i32; 4]> = points.iter().map(|&(x, y)| [x - 5, y - 5, x + 5, y + 5]).collect();
    let overlaps = |a: &[i32; 4], b: &[i32; 4]| a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3];
    let mut placed = Vec::new();
    for (i, (&(x, y), label)) in points.iter().zip(labels).enumerate() {
        let width = letters(label);
        let corners = (0..5).flat_map(|ring| {
            let far = 10 + 14 * ring;
            let (up, down) = (y - far - TEXT + 4, y + far - 4);
            let side = if i < front { [up, down, y - TEXT / 2] } else { [y - TEXT / 2, up, down] };
            let beside = side.map(|v| (x + 9 + if ring > 0 { 6 * ring } else { 0 }, v));
            let before = side.map(|v| (x - 9 - width - if ring > 0 { 6 * ring } else { 0 }, v));
            let over = [(x - width / 2, up), (x - width / 2, down)];
            beside.into_iter().chain(before).chain(over).map(move |corner| (corner, ring > 0))
        });
        let free = corners.into_iter().find(|&((left, top), _)| {
            let area = [left - 1, top - 1, left + width + 1, top + TEXT + 1];
            let inside = area[0] >= bounds[0] && area[1] >= bounds[1] && area[2] <= bounds[2] && area[3] <= bounds[3];
            inside && !taken.iter().any(|t| overlaps(t, &area))
        });
        if let Some(((left, top), _)) = free.filter(|_| width > 0) {
            taken.push([left - 1, top - 1, left + width + 1, top + TEXT + 1]);
        }
        placed.push(free.filter(|_| width > 0));
    }
    placed
}

impl Bars {
    pub fn svg(&self) -> String {
        let scale = if self.stacked { Scale::Linear } else { self.value.scale };
        let sum = |row: &BarRow| row.values.iter().filter(|v| v.is_finite()).sum::<f64>();
        let ends: Vec<f64> = match self.stacked {
            true => self.rows.iter().map(sum).collect(),
            false => self.rows.iter().flat_map(|r| &r.values).copied().collect(),
        };
        let x = Coordinate::over(scale, true, ends.into_iter());
        let zero = if scale == Scale::Linear { 0.0 } else { x.range[0] };
        let lanes = if self.stacked { 1 } else { self.parts.len().max(1) };
        let mark = |row: &BarRow| row.name.clone() + if row.quoted { " (quoted)" } else { "" };
        let y = Coordinate::rows(self.rows.iter().map(mark).collect());
        let color = |part: usize| COLORS[part % COLORS.len()];
        let mut legend: Vec<_> = self.parts.iter().enumerate().map(|(p, name)| (&**name, color(p), false)).collect();
        if legend.len() == 1 {
            legend.clear();
        }
        let height = 110 + self.rows.len() * (8 + 13 * lanes.max(1));
        svg(height as u32, &self.title, &legend, |area| {
            let mut chart = chart(area, (x, &self.value.label), (y, ""));
            for (r, row) in self.rows.iter().enumerate() {
                let mut end = zero;
                for (part, &value) in row.values.iter().enumerate().filter(|(_, v)| v.is_finite()) {
                    let lane = if self.stacked { 0 } else { part };
                    let top = r as f64 + 0.15 + 0.7 * lane as f64 / lanes as f64;
                    let start = if self.stacked { end } else { zero };
                    end = if self.stacked { start + value } else { value };
                    let paint = color(part).mix(if row.quoted { 0.35 } else { 1.0 }).filled();
                    let bar = Rectangle::new([(start, top), (end, top + 0.7 / lanes as f64)], paint);
                    chart.draw_series([bar]).expect(INFALLIBLE);
                    if !self.stacked || part + 1 == row.values.len() {
                        let middle = (end.max(zero), top + 0.35 / lanes as f64);
                        let style = text(11, INK).pos(Pos::new(HPos::Left, VPos::Center));
                        chart.draw_series([Text::new(format!(" {}", short(end)), middle, style)]).expect(INFALLIBLE);
                    }
                }
            }
        })
    }
}

/// A bar's value: three significant digits.
fn short(v: f64) -> String {
    let digits = if v == 0.0 { 0.0 } else { (2.0 - v.abs().log10().floor()).clamp(0.0, 6.0) };
    format!("{v:.*}", digits as usize)
}

/// Height of a picture of [`Lines`], in pixels.
const LINES_HEIGHT: u32 = 440;

impl Lines {
    pub fn svg(&self) -> String {
        let points = || self.series.iter().flat_map(|s| &s.points);
        let x = Coordinate::over(self.x.scale, false, points().map(|p| p[0]));
        let y = Coordinate::over(self.y.scale, false, points().map(|p| p[1]));
        let color = |s: usize| COLORS[s % COLORS.len()];
        let legend: Vec<_> = self.series.iter().enumerate().map(|(s, l)| (&*l.name, color(s), l.quoted)).collect();
        svg(LINES_HEIGHT, &self.title, &legend, |area| {
            let mut chart = chart(area, (x, &self.x.label), (y, &self.y.label));
            for (s, series) in self.series.iter().enumerate() {
                let finite = series.points.iter().filter(|p| p.iter().all(|v| v.is_finite()));
                let path: Vec<(f64, f64)> = finite.map(|p| (p[0], p[1])).collect();
                let line = color(s).mix(if series.quoted { 0.4 } else { 1.0 }).stroke_width(2);
                let dot: ShapeStyle = if series.quoted { color(s).stroke_width(1) } else { color(s).filled() };
                chart.draw_series(path.iter().map(|&at| Circle::new(at, 3, dot))).expect(INFALLIBLE);
                chart.draw_series([PathElement::new(path, line)]).expect(INFALLIBLE);
            }
        })
    }
}

/// Pictures of [`Lines`] one below the other.
pub fn stacked(pictures: &[Lines]) -> String {
    let height = LINES_HEIGHT * pictures.len() as u32;
    let mut out = format!(
        "<svg width=\"{WIDTH}\" height=\"{height}\" viewBox=\"0 0 {WIDTH} {height}\" xmlns=\"http://www.w3.org/2000/svg\">\n"
    );
    for (k, lines) in pictures.iter().enumerate() {
        out += &lines.svg().replacen("<svg ", &format!("<svg y=\"{}\" ", LINES_HEIGHT * k as u32), 1);
    }
    out + "</svg>\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stacked_pictures_stand_one_below_the_other() {
        let lines = |title: &str| Lines { title: title.into(), ..Lines::default() };
        let svg = stacked(&[lines("first"), lines("second")]);
        assert!(svg.contains("height=\"880\"") && svg.contains("first") && svg.contains("second"), "{svg}");
        assert_eq!((svg.matches("<svg y=\"0\" ").count(), svg.matches("<svg y=\"440\" ").count()), (1, 1));
        assert_eq!((svg.matches("<svg ").count(), svg.matches("</svg>").count()), (3, 3));
    }

    #[test]
    fn pareto_keeps_what_nothing_beats() {
        let points =
            [[1.0, 5.0], [2.0, 5.0], [2.0, 3.0], [3.0, 4.0], [4.0, 1.0], [4.0, 1.0], [0.5, f64::NAN], [1.0, 6.0]];
        assert_eq!(pareto(&points), [0, 2, 4]);
        assert!(pareto(&[]).is_empty());
    }

    #[test]
    fn log_axis_maps_decades_evenly_and_zero_to_its_end() {
        let axis = Coordinate::over(Scale::Log, false, [0.0, 1.0, 100.0].into_iter());
        assert!(axis.zero && axis.range[0] == 0.1, "{:?}", axis.range);
        let step = axis.share(10.0) - axis.share(1.0);
        assert!((axis.share(100.0) - axis.share(10.0) - step).abs() < 1e-12);
        assert_eq!((axis.share(0.0), axis.share(-3.0)), (0.0, 0.0));
        assert_eq!(axis.ticks(10).iter().map(|v| axis.format_ext(v)).collect::<Vec<_>>(), ["0", "1", "10", "100"]);
    }

    #[test]
    fn linear_axis_has_round_ticks_within_its_range() {
        let axis = Coordinate::over(Scale::Linear, true, [3.0, 17.0].into_iter());
        assert_eq!(axis.ticks(8).iter().map(|&v| number(v)).collect::<Vec<_>>(), ["0", "5", "10", "15"]);
        for values in [vec![], vec![2.0], vec![0.0], vec![f64::NAN]] {
            let axis = Coordinate::over(Scale::Linear, false, values.into_iter());
            assert!(axis.range[0] < axis.range[1] && !axis.ticks(5).is_empty(), "{:?}", axis.range);
        }
    }

    #[test]
    fn labels_overlap_neither_each_other_nor_points() {
        let points: Vec<(i32, i32)> = (0..30).map(|i| (100 + i * 7 % 90, 100 + i * 13 % 60)).collect();
        let labels: Vec<String> = (0..30).map(|i| format!("configuration {i}")).collect();
        let labels: Vec<&str> = labels.iter().map(String::as_str).collect();
        let placed = place_labels(&points, &labels, 3, [0, 0, 400, 300]);
        let boxes: Vec<[i32; 4]> = (placed.iter().zip(&labels))
            .filter_map(|(p, label)| p.map(|((x, y), _)| [x, y, x + letters(label), y + TEXT]))
            .collect();
        assert!(boxes.len() >= 8, "{} labels found room", boxes.len());
        for (i, a) in boxes.iter().enumerate() {
            let apart = |b: &[i32; 4]| a[2] <= b[0] || b[2] <= a[0] || a[3] <= b[1] || b[3] <= a[1];
            assert!(boxes[..i].iter().all(apart), "label {i}");
            assert!(points.iter().all(|&(x, y)| apart(&[x, y, x, y])), "label {i} covers a point");
        }
    }

    #[test]
    fn plots_draw_every_mark_and_escape_names() {
        let point = |x, y, label: &str| Point { x, y, label: label.into(), spread: Some([x * 0.9, x * 1.2]) };
        let group = |name: &str, quoted, points| Group { name: name.into(), quoted, points };
        let scatter = Scatter {
            title: "a < b".into(),
            x: Axis::log("ms"),
            y: Axis::log("error"),
            groups: vec![
                group("cpu", false, vec![point(1.0, 9.0, "fast"), point(5.0, 0.0, "best"), point(6.0, 9.0, "poor")]),
                group("paper", true, vec![point(2.0, 1.0, "theirs")]),
            ],
            front: Front::OfAll,
        };
        let drawn = scatter.svg();
        // Four points, two rings.
        assert_eq!(drawn.matches("<circle").count(), 6, "{drawn}");
        let mut apart = scatter.clone();
        apart.groups.insert(1, group("gpu", false, vec![point(7.0, 9.0, "slow")]));
        for (front, circles) in [(Front::None, 5), (Front::OfAll, 7), (Front::OfEach, 8)] {
            apart.front = front;
            assert_eq!(apart.svg().matches("<circle").count(), circles, "{front:?}");
        }
        for part in ["a &lt; b", "fast", "best", "poor", "theirs", "paper (quoted)", "Pareto front"] {
            assert!(drawn.contains(part), "{part}");
        }
        let bars = Bars {
            title: "stages".into(),
            value: Axis::linear("ms"),
            parts: vec!["traverse".into(), "remap".into()],
            rows: (0..3).map(|i| BarRow { name: format!("row {i}"), quoted: i == 2, values: vec![1.0, 2.0] }).collect(),
            stacked: true,
        };
        let plain = Lines { title: "l".into(), ..Lines::default() }.svg();
        let drawn = bars.svg();
        // Two legend squares and two parts in each of three rows, above the background's own rectangle.
        assert_eq!(drawn.matches("<rect").count() - plain.matches("<rect").count(), 8, "{drawn}");
        assert!(drawn.contains("row 2 (quoted)"));
    }
}
