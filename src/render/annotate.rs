//! What a picture in a report needs (`--annotate`): a bar of known length, an arrow to the north, colours with their heights.
//!
//! Lengths are those at the middle of the picture, where the bar is told to be measured; a picture that looks at nothing there has
//! no bar. North is −z, as seen from above in the direction of the view. Colours are the mean ones of the columns' tops at their
//! heights, whatever made them.

use crate::frame::camera::Camera;
use crate::frame::picture::Frame;
use planecast_encoder::About;

use crate::world::tables::{Paint, Resident};

/// Rows of a glyph, 5 pixels each, the leftmost in the highest bit, in the order of [`LETTERS`].
const GLYPHS: [[u8; 7]; 42] = [
    [14, 17, 19, 21, 25, 17, 14],
    [4, 12, 4, 4, 4, 4, 14],
    [14, 17, 1, 2, 4, 8, 31],
    [31, 2, 4, 2, 1, 17, 14],
    [2, 6, 10, 18, 31, 2, 2],
    [31, 16, 30, 1, 1, 17, 14],
    [6, 8, 16, 30, 17, 17, 14],
    [31, 1, 2, 4, 8, 8, 8],
    [14, 17, 17, 14, 17, 17, 14],
    [14, 17, 17, 15, 1, 2, 12],
    [0, 0, 0, 0, 0, 12, 12],
    [0, 0, 0, 31, 0, 0, 0],
    [24, 25, 2, 4, 8, 19, 3],
    [12, 18, 12, 0, 0, 0, 0],
    [17, 25, 21, 19, 17, 17, 17],
    [0, 0, 14, 1, 15, 17, 15],
    [16, 16, 22, 25, 17, 17, 30],
    [0, 0, 14, 16, 16, 17, 14],
    [1, 1, 13, 19, 17, 17, 15],
    [0, 0, 14, 17, 31, 16, 14],
    [6, 9, 8, 28, 8, 8, 8],
    [0, 15, 17, 17, 15, 1, 14],
    [16, 16, 22, 25, 17, 17, 17],
    [4, 0, 12, 4, 4, 4, 14],
    [2, 0, 6, 2, 2, 18, 12],
    [16, 16, 18, 20, 24, 20, 18],
    [12, 4, 4, 4, 4, 4, 14],
    [0, 0, 26, 21, 21, 17, 17],
    [0, 0, 22, 25, 17, 17, 17],
    [0, 0, 14, 17, 17, 17, 14],
    [0, 0, 30, 17, 30, 16, 16],
    [0, 0, 13, 19, 15, 1, 1],
    [0, 0, 22, 25, 16, 16, 16],
    [0, 0, 14, 16, 14, 1, 30],
    [8, 8, 28, 8, 8, 9, 6],
    [0, 0, 17, 17, 17, 19, 13],
    [0, 0, 17, 17, 17, 10, 4],
    [0, 0, 17, 17, 21, 21, 10],
    [0, 0, 17, 10, 4, 10, 17],
    [0, 0, 17, 17, 15, 1, 14],
    [0, 0, 31, 2, 4, 8, 31],
    [0, 0, 17, 17, 19, 29, 16],
];

const LETTERS: &str = "0123456789.-%°Nabcdefghijklmnopqrstuvwxyzµ";

const INK: [u8; 3] = [24, 28, 32];
const PAPER: [u8; 3] = [250, 250, 246];

/// Colours of the legend, from the lowest to the highest.
const STEPS: usize = 48;

/// A picture that is drawn on, `scale` pixels a dot.
struct Sheet<'a> {
    frame: &'a mut Frame,
    scale: i32,
}

impl Sheet<'_> {
    fn dot(&mut self, x: i32, y: i32, color: [u8; 3]) {
        let (w, h) = (self.frame.width as i32, self.frame.height as i32);
        if (0..w).contains(&x) && (0..h).contains(&y) {
            self.frame.color[(y * w + x) as usize] = [color[0], color[1], color[2], 255];
        }
    }

    fn fill(&mut self, [x, y]: [i32; 2], [w, h]: [i32; 2], color: [u8; 3]) {
        for y in y..y + h {
            (x..x + w).for_each(|x| self.dot(x, y, color));
        }
    }

    /// Dark on a light rim, legible on anything.
    fn write(&mut self, at: [i32; 2], text: &str) {
        let s = self.scale;
        for (rim, color) in [(s.max(1), PAPER), (0, INK)] {
            for (i, letter) in text.chars().enumerate() {
                let known = |letter: char| LETTERS.chars().position(|l| l == letter);
                let found = known(letter).or_else(|| known(letter.to_ascii_lowercase()));
                let Some(glyph) = found.map(|at| GLYPHS[at]) else { continue };
                for (row, bits) in glyph.into_iter().enumerate() {
                    for column in (0..5).filter(|column| bits >> (4 - column) & 1 == 1) {
                        let corner = [at[0] + (6 * i as i32 + column) * s - rim, at[1] + row as i32 * s - rim];
                        self.fill(corner, [s + 2 * rim; 2], color);
                    }
                }
            }
        }
    }
}

/// The largest of 1, 2, 5, 10, … that is at most `most`.
fn round_length(most: f64) -> f64 {
    let power = 10f64.powf(most.log10().floor());
    [5.0, 2.0, 1.0].map(|n| n * power).into_iter().find(|&n| n <= most * (1.0 + 1e-9)).unwrap_or(power)
}

/// A number and its unit; metres of a thousand and more are kilometres.
fn measure(value: f64, unit: &str) -> String {
    let (value, unit) = if unit == "m" && value.abs() >= 1000.0 { (value / 1000.0, "km") } else { (value, unit) };
    let digits = if value == 0.0 { 0 } else { (2 - value.abs().log10().floor() as i32).clamp(0, 6) as usize };
    let text = format!("{value:.digits$}");
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    if unit.is_empty() { text.to_owned() } else { format!("{text} {unit}") }
}

/// Draws bar, arrow and legend on a picture.
pub fn annotate(frame: &mut Frame, camera: &Camera, resident: &Resident, about: &About) {
    let scale = ((frame.height.min(frame.width) / 300) as i32).max(1);
    let (w, h) = (frame.width as i32, frame.height as i32);
    let margin = 8 * scale;
    let depth = frame.depth[(h / 2 * w + w / 2) as usize];
    let mut sheet = Sheet { frame, scale };
    if let Some(voxel) = about.voxel.or(Some([1.0; 3])).filter(|_| depth.is_finite() && depth > 0.0) {
        let unit = if about.voxel.is_some() { about.unit.as_str() } else { "voxels" };
        let per_pixel = f64::from(depth) / camera.focal() * voxel[0];
        let length = round_length(per_pixel * f64::from(w) / 5.0);
        let wide = (length / per_pixel).round() as i32;
        let [x, y] = [margin, h - margin - 3 * scale];
        sheet.fill([x - scale, y - scale], [wide + 2 * scale, 5 * scale], PAPER);
        sheet.fill([x, y], [wide, 3 * scale], INK);
        sheet.fill([x + wide / 2, y + scale], [wide / 2 - scale, scale], PAPER);
        sheet.write([x, y - 11 * scale], &measure(length, unit));
    }
    north(&mut sheet, camera, [w - margin - 14 * scale, margin + 20 * scale]);
    legend(&mut sheet, resident, about, [margin, margin]);
}

/// An arrow from `centre` to where −z lies as seen from above, the view's own direction up.
fn north(sheet: &mut Sheet<'_>, camera: &Camera, centre: [i32; 2]) {
    let (sin, cos) = (-camera.yaw.to_radians()).sin_cos();
    let s = f64::from(sheet.scale);
    let r = 14.0 * s;
    for y in -(r as i32)..=r as i32 {
        for x in -(r as i32)..=r as i32 {
            // Along the arrow and across it.
            let (fx, fy) = (f64::from(x), f64::from(-y));
            let (along, across) = (fx * sin + fy * cos, (fx * cos - fy * sin).abs());
            let half = (r - along) * 0.36;
            let inside = |rim: f64| {
                across <= half + rim && along <= r + rim && along >= -0.6 * r - rim + (0.4 * r - across).max(0.0) * 0.9
            };
            if inside(0.0) {
                sheet.dot(centre[0] + x, centre[1] + y, INK);
            } else if inside(1.2 * s) {
                sheet.dot(centre[0] + x, centre[1] + y, PAPER);
            }
        }
    }
    let at = [sin, -cos].map(|v| (v * (r + 7.0 * s)) as i32);
    sheet.write([centre[0] + at[0] - 2 * sheet.scale, centre[1] + at[1] - 3 * sheet.scale], "N");
}

/// Colours by height, where a height field has any.
fn legend(sheet: &mut Sheet<'_>, resident: &Resident, about: &About, at: [i32; 2]) {
    if !resident.heights || matches!(resident.levels[0].paint, Paint::None) {
        return;
    }
    let level = &resident.levels[0];
    let columns = level.nx as usize * level.nz as usize;
    let tops = (0..columns).step_by(columns.div_ceil(200_000).max(1)).filter_map(|ix| {
        let top = level.column(ix).next()?.last();
        Some((usize::from(top), level.color(ix, 0, u32::from(top))))
    });
    let tops: Vec<(usize, u32)> = tops.collect();
    let (Some(low), Some(high)) = (tops.iter().map(|t| t.0).min(), tops.iter().map(|t| t.0).max()) else { return };
    let mut sums = [[0u64; 4]; STEPS];
    for &(top, color) in &tops {
        let sum = &mut sums[(top - low) * (STEPS - 1) / (high - low).max(1)];
        let [r, g, b, _] = color.to_le_bytes();
        for (sum, value) in sum.iter_mut().zip([r, g, b, 1]) {
            *sum += u64::from(value);
        }
    }
    // A height that no column has takes the colour below it.
    let mut last = [0; 3];
    let colors = sums.map(|[r, g, b, n]| {
        last = if n == 0 { last } else { [r, g, b].map(|sum| (sum / n) as u8) };
        last
    });
    let s = sheet.scale;
    let step = 2 * s;
    sheet.fill([at[0] - s, at[1] - s], [10 * s, STEPS as i32 * step + 2 * s], PAPER);
    for (i, color) in colors.into_iter().rev().enumerate() {
        sheet.fill([at[0], at[1] + i as i32 * step], [8 * s, step], color);
    }
    let (per, least) = match (about.affine, about.values, about.voxel) {
        (Some([_, _, up]), ..) => (up[1], up[3]),
        (None, Some([from, to]), _) if high > low => {
            let per = (to - from) / (high - low) as f64;
            (per, from - per * low as f64)
        }
        (None, _, Some([_, y, _])) => (y, 0.0),
        _ => (1.0, 0.0),
    };
    let unit = if about.voxel.is_none() && about.values.is_none() { "voxels" } else { about.unit.as_str() };
    let bottom = STEPS as i32 * step;
    for (share, top) in [(1.0, 0), (0.5, bottom / 2 - 3 * s), (0.0, bottom - 6 * s)] {
        let height = low as f64 + share * (high - low) as f64;
        sheet.write([at[0] + 12 * s, at[1] + top], &measure(per * height + least, unit));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{CpuRenderer, Options, Outputs};
    use planecast_encoder::{BuildOptions, Colors, ColumnsBuilder, Input, Run, build};
    use std::sync::Arc;

    #[test]
    fn lengths_are_round_and_say_their_unit() {
        assert_eq!([0.7, 1.0, 2.3, 49.0, 51.0, 999.0].map(round_length), [0.5, 1.0, 2.0, 20.0, 50.0, 500.0]);
        let said = [(2000.0, "m"), (0.5, "mm"), (-12.25, "m"), (1234.5, "ft"), (0.0, "")].map(|(v, u)| measure(v, u));
        assert_eq!(said, ["2 km", "0.5 mm", "-12.2 m", "1234 ft", "0"]);
    }

    /// Straight down from 100 voxels over a floor: a voxel of 3 m is as wide as focal / 100 pixels.
    #[test]
    fn bars_are_as_long_as_they_say_and_the_arrow_points_north() {
        let mut columns = ColumnsBuilder::new(400, 10, 400);
        for i in 0..400 * 400u32 {
            columns.push_run(Run::new(0, (i % 400 / 40) as u16));
            columns.end_column();
        }
        let input = Input {
            columns: columns.finish(),
            colors: Colors::Function(Box::new(|_, y, _| [y as u8 * 20, 90, 200 - y as u8 * 20])),
            notes: Vec::new(),
        };
        let scene = Arc::new(build(input, &BuildOptions::default()).unwrap());
        let resident = Arc::new(Resident::new(&scene));
        let eye = glam::DVec3::new(200.0, 106.0, 200.0);
        let camera = Camera { eye, yaw: 0.0, pitch: -90.0, roll: 0.0, fov: 60.0, width: 600, height: 300 };
        let mut renderer = CpuRenderer::new(&scene, &resident);
        let options = Options { shading: crate::Shading::None, ..Options::default() };
        let mut frame = renderer.render(&camera, &options, Outputs::default()).unwrap();
        let about = About { voxel: Some([3.0; 3]), unit: "m".into(), ..About::default() };
        annotate(&mut frame, &camera, &resident, &about);
        let at = |x: i32, y: i32| {
            let c = frame.color[(y * 600 + x) as usize];
            [c[0], c[1], c[2]]
        };
        // 100 m of 600 pixels / 5 or less: 100 / 3 voxels, 2.598 pixels each at that depth.
        let dark = (0..600).filter(|&x| at(x, 300 - 8 - 3) == INK).count();
        assert_eq!(dark, (100.0 / 3.0 * camera.focal() / 100.0).round() as usize);
        // The arrow's tip is above its middle, its foot is open.
        let x = 600 - 8 - 14;
        assert_eq!((at(x, 28 - 12), at(x, 28)), (INK, INK));
        assert_ne!(at(x, 28 + 13), INK);
        // Heights from below: blue, then red.
        assert_eq!((at(12, 8 + 95), at(12, 9)), ([0, 90, 200], [180, 90, 20]));
    }
}
