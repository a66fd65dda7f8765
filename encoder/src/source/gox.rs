//! Goxel's models (`.gox`), z up.
//!
//! ```text
//! "GOX " | i32 version | chunks: 4 bytes name, i32 length, content, 4 bytes that Goxel leaves 0
//! BL16: a PNG of 64 × 64 pixels, the 16³ voxels of a block, x fastest, then y, then z
//! LAYR: i32 n, n × [i32 block, i32 x, y, z, i32 0], then entries [i32 length, key, i32 length, value]
//! ```
//! A layer may hold no blocks but be another one, moved (`base_id`, `mat`), or a cube, a sphere or a cylinder (`shape`, `mat`,
//! `color`). Layers that are not visible are left out. Goxel shows voxels from opacity 127 of 255 on, and so does this. Source:
//! the comments of Goxel's writer.

use std::collections::HashMap;
use std::io::Cursor;
use std::path::Path;

use super::cells::Placed;
use crate::model::about::Kind;
use crate::model::pieces::InMemory;
use crate::{About, Error, Result, Rgb};

const SIDE: i64 = 16;
/// Least opacity that is shown.
const OPAQUE: u8 = 127;
/// Most voxels looked at for one shape.
const MAX_SHAPE: f64 = (1u64 << 28) as f64;

#[derive(Default)]
struct Layer<'a> {
    at: usize,
    blocks: Vec<[i32; 4]>,
    entries: HashMap<&'a [u8], &'a [u8]>,
}

impl Layer<'_> {
    fn number(&self, key: &str) -> i32 {
        let value = self.entries.get(key.as_bytes());
        value.and_then(|v| v.get(..4)).map_or(0, |b| i32::from_le_bytes([b[0], b[1], b[2], b[3]]))
    }

    fn text(&self, key: &str) -> String {
        let value = self.entries.get(key.as_bytes()).copied().unwrap_or_default();
        String::from_utf8_lossy(value.split(|&b| b == 0).next().unwrap_or_default()).into_owned()
    }

    /// Columns of the layer's matrix.
    fn matrix(&self) -> Option<[[f64; 4]; 4]> {
        let value = self.entries.get("mat".as_bytes()).filter(|v| v.len() == 64)?;
        let number = |i: usize| f32::from_le_bytes([value[i], value[i + 1], value[i + 2], value[i + 3]]);
        let matrix = [0, 1, 2, 3].map(|c| [0, 1, 2, 3].map(|r| f64::from(number(16 * c + 4 * r))));
        matrix.as_flattened().iter().all(|v| v.is_finite()).then_some(matrix)
    }
}

fn fail<T>(path: &Path, at: usize, what: impl std::fmt::Display) -> Result<T> {
    Err(Error::format(path, format!("byte {at}: {what}")))
}

fn int(bytes: &[u8], at: usize) -> Option<i32> {
    bytes.get(at..at + 4).map(|b| i32::from_le_bytes([b[0], b[1], b[2], b[3]]))
}

/// Entries of a chunk from byte `at` of `content` on, which is at byte `base` of the file.
fn entries<'a>(path: &Path, content: &'a [u8], mut at: usize, base: usize) -> Result<HashMap<&'a [u8], &'a [u8]>> {
    let mut out = HashMap::new();
    while at < content.len() {
        let mut part = || {
            let len = int(content, at).and_then(|n| usize::try_from(n).ok())?;
            let part = content.get(at + 4..(at + 4).checked_add(len)?)?;
            at += 4 + len;
            Some(part)
        };
        match part() {
            Some([]) => break,
            Some(key) => match part() {
                Some(value) => out.insert(key, value),
                None => return fail(path, base + at, "an entry reaches past the end of its chunk"),
            },
            None => return fail(path, base + at, "an entry reaches past the end of its chunk"),
        };
    }
    Ok(out)
}

pub(super) fn read(path: &Path, bytes: &[u8]) -> Result<InMemory> {
    if !bytes.starts_with(b"GOX ") {
        return fail(path, 0, "expected \"GOX \"");
    }
    let Some(version) = int(bytes, 4).filter(|&v| v >= 1) else {
        return fail(path, 4, "expected a version of at least 1");
    };
    let (mut blocks, mut layers, mut tinted) = (Vec::new(), Vec::new(), Vec::new());
    let mut at = 8;
    while at < bytes.len() {
        let len = int(bytes, at + 4).and_then(|n| usize::try_from(n).ok());
        // The four bytes after the last chunk are missed by nobody.
        let content = len.and_then(|len| bytes.get(at + 8..(at + 8).checked_add(len)?));
        let Some(content) = content else {
            return fail(path, at, "a chunk reaches past the end of the file; it was cut short or is damaged");
        };
        match &bytes[at..at + 4] {
            b"BL16" => blocks.push((at, content)),
            b"LAYR" => {
                let n = int(content, 0).and_then(|n| usize::try_from(n).ok());
                let Some(n) = n.filter(|n| n.checked_mul(20).is_some_and(|len| 4 + len <= content.len())) else {
                    return fail(path, at + 8, "a layer claims more blocks than its chunk holds");
                };
                let number = |i: usize, k: usize| int(content, 4 + 20 * i + 4 * k).unwrap_or_default();
                let blocks = (0..n).map(|i| [0, 1, 2, 3].map(|k| number(i, k))).collect();
                layers.push(Layer { at, blocks, entries: entries(path, content, 4 + 20 * n, at + 8)? });
            }
            b"MATE" => {
                let color = entries(path, content, 0, at + 8)?.get("color".as_bytes()).copied().unwrap_or_default();
                tinted.push(color.len() == 16 && color.chunks(4).any(|c| c != 1f32.to_le_bytes()));
            }
            _ => {}
        }
        at += 12 + content.len();
    }
    let mut about = About { axes: "z is up".to_owned(), ..About::new(Kind::Model, "Goxel gox") };
    let shift = if version == 1 { SIDE / 2 } else { 0 };
    let (mut placed, mut faint, mut n_shown, mut tints) = (Placed::default(), 0u64, 0, 0);
    let mut show = |layer: &Layer, [dx, dy, dz]: [i64; 3]| {
        for &[block, x, y, z] in &layer.blocks {
            let Some(&(png_at, png)) = usize::try_from(block).ok().and_then(|i| blocks.get(i)) else {
                return fail(path, layer.at, format!("a layer shows block {block}, the file has {}", blocks.len()));
            };
            let pixels = pixels(path, png_at, png)?;
            for (i, p) in pixels.chunks_exact(4).enumerate().filter(|(_, p)| p[3] > 0) {
                if p[3] < OPAQUE {
                    faint += 1;
                    continue;
                }
                let i = i as i64;
                let [x, y, z] = [(x, dx, i % SIDE), (y, dy, i / SIDE % SIDE), (z, dz, i / SIDE / SIDE)]
                    .map(|(v, moved, cell)| i64::from(v) - shift + moved + cell);
                let at = [x, z, -1 - y];
                placed.part(at, at);
                placed.push(path, at, [p[0], p[1], p[2]])?;
            }
        }
        Ok(())
    };
    let mut shapes = Vec::new();
    for layer in &layers {
        let name = layer.text("name");
        if layer.entries.get("visible".as_bytes()).is_some_and(|v| v.first() == Some(&0)) {
            about.left_out.push(format!("the hidden layer {name:?}"));
            continue;
        }
        n_shown += 1;
        let material = usize::try_from(layer.number("material"))
            .ok()
            .filter(|_| layer.entries.contains_key("material".as_bytes()));
        tints += usize::from(material.and_then(|i| tinted.get(i)) == Some(&true));
        let base = layer.number("base_id");
        if !layer.entries.contains_key("shape".as_bytes()) && (base == 0 || !layer.blocks.is_empty()) {
            show(layer, [0; 3])?;
        } else if base != 0 {
            let of = layers.iter().find(|l| l.number("id") == base && !l.entries.contains_key("shape".as_bytes()));
            match (of, layer.matrix().and_then(|m| moved(&m))) {
                (Some(of), Some(by)) => show(of, by)?,
                _ => about.left_out.push(format!("the layer {name:?}, which is another one turned or scaled")),
            }
        } else {
            shapes.push(layer);
        }
    }
    for layer in shapes {
        let shape = layer.text("shape");
        let color = layer.number("color").to_le_bytes();
        let done = layer.matrix().map(|m| shape_voxels(path, &shape, &m, [color[0], color[1], color[2]], &mut placed));
        if !done.transpose()?.unwrap_or(false) {
            about.left_out.push(format!("the layer {:?}, a {shape} that cannot be made", layer.text("name")));
        }
    }
    if faint > 0 {
        about.left_out.push(format!("{faint} voxels of opacity below {OPAQUE}, which Goxel does not show"));
    }
    if tints > 0 {
        about.left_out.push(format!("the tints of materials of {tints} layers"));
    }
    about.rule = format!("{} voxels of {n_shown} layers", placed.len());
    match placed.model(path, about)? {
        Some(model) => Ok(model),
        None => Err(Error::format(path, "Goxel: no visible voxel")),
    }
}

/// The voxels of a block, RGBA.
fn pixels(path: &Path, at: usize, png: &[u8]) -> Result<Vec<u8>> {
    let wrong = |what: String| Error::format(path, format!("byte {at}: the block's PNG: {what}"));
    let mut decoder = png::Decoder::new(Cursor::new(png));
    decoder.set_transformations(png::Transformations::ALPHA | png::Transformations::STRIP_16);
    let mut reader = decoder.read_info().map_err(|e| wrong(e.to_string()))?;
    let info = reader.info();
    if (info.width, info.height) != (64, 64) {
        return Err(wrong(format!("{} × {} pixels, expected 64 × 64", info.width, info.height)));
    }
    let mut out = vec![0; reader.output_buffer_size().unwrap_or(0)];
    let frame = reader.next_frame(&mut out).map_err(|e| wrong(e.to_string()))?;
    out.truncate(frame.buffer_size());
    Ok(match frame.color_type {
        png::ColorType::Rgba => out,
        png::ColorType::GrayscaleAlpha => out.chunks_exact(2).flat_map(|p| [p[0], p[0], p[0], p[1]]).collect(),
        other => return Err(wrong(format!("{other:?} pixels, expected colours with opacity"))),
    })
}

/// How far a matrix moves, in whole voxels; none where it does anything else.
fn moved(m: &[[f64; 4]; 4]) -> Option<[i64; 3]> {
    let same = (0..3).all(|c| (0..3).all(|r| (m[c][r] - f64::from(u8::from(c == r))).abs() < 1e-4));
    let whole = (0..3).all(|r| (m[3][r] - m[3][r].round()).abs() < 1e-3 && m[3][r].abs() < 1e9);
    (same && whole).then(|| [0, 1, 2].map(|r| m[3][r].round() as i64))
}

/// Places the voxels whose centres lie in a shape of half side or radius 1 that `m` has placed; false where there is none.
fn shape_voxels(path: &Path, shape: &str, m: &[[f64; 4]; 4], color: Rgb, placed: &mut Placed) -> Result<bool> {
    let inside: fn([f64; 3]) -> bool = match shape {
        "cube" => |p| p.iter().all(|v| v.abs() <= 1.0),
        "sphere" => |p| p.iter().map(|v| v * v).sum::<f64>() <= 1.0,
        "cylinder" => |p| p[0] * p[0] + p[1] * p[1] <= 1.0 && p[2].abs() <= 1.0,
        _ => return Ok(false),
    };
    let [a, b, c] = [0, 1, 2].map(|c| [m[c][0], m[c][1], m[c][2]]);
    let cross =
        |a: [f64; 3], b: [f64; 3]| [0, 1, 2].map(|i| a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3]);
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let det = dot(a, cross(b, c));
    // Half the side of the box around it.
    let reach = [0, 1, 2].map(|r| a[r].abs() + b[r].abs() + c[r].abs());
    let cells: f64 = reach.iter().map(|v| 2.0 * v + 2.0).product();
    if det.abs() < 1e-9 || cells > MAX_SHAPE || (0..3).any(|r| m[3][r].abs() > 1e9) {
        return Ok(false);
    }
    let rows = [cross(b, c), cross(c, a), cross(a, b)].map(|row| row.map(|v| v / det));
    let range = |r: usize| (m[3][r] - reach[r]).floor() as i64..=(m[3][r] + reach[r]).ceil() as i64;
    for (z, y) in range(2).flat_map(|z| range(1).map(move |y| (z, y))) {
        for x in range(0) {
            let centre = [x as f64 + 0.5 - m[3][0], y as f64 + 0.5 - m[3][1], z as f64 + 0.5 - m[3][2]];
            if inside(rows.map(|row| dot(row, centre))) {
                let at = [x, z, -1 - y];
                placed.part(at, at);
                placed.push(path, at, color)?;
            }
        }
    }
    Ok(true)
}
