//! Meshes: what their readers give, and the voxels that their faces touch.
//!
//! A voxel is solid where a triangle touches it (conservative: no triangle, however thin, is lost between voxels).
//! Exact, by columns: a triangle clipped to a column is one polygon, and the voxels it touches there are just those
//! between its lowest and its highest point. The inside is filled by `--fill` alone, as scanned meshes often have none.
//!
//! Where faces and edges lie just between two voxels: those of a closed surface belong to the voxels inside of it, so that a box
//! of 4 × 6 × 8 is as large wherever it stands; those of an open one touch the voxels above.

use std::ops::Range;
use std::path::Path;

use rayon::prelude::*;

use super::fill::{self, Inside};
use super::spots::{self, Spot};
use super::texture::Texture;
use super::{ReadOptions, Up, world_dims};
use crate::model::about::Kind;
use crate::model::pieces::Pieces;
use crate::{About, Error, Input, Result, Rgb};

/// Voxels along the longest side where nobody says.
const DEFAULT_SIZE: u32 = 512;
/// Rows of columns whose triangles are listed together.
pub(super) const BAND: u32 = 32;

/// Triangles with a colour a corner or a face, and with pictures on them that these colours tint.
#[derive(Debug)]
pub(super) struct Mesh {
    /// Corners in units of the file, as exact as it has them: coordinates of maps have more digits than `f32`.
    pub positions: Vec<[f64; 3]>,
    /// One a position; empty without colours.
    pub colors: Vec<Rgb>,
    /// How opaque corners are, for the holes of [`Paint`]; empty where all are.
    pub alphas: Vec<f32>,
    pub triangles: Vec<[u32; 3]>,
    /// Colours of triangles that have their own, in place of those of their corners; empty, or one a triangle.
    pub face_colors: Vec<Option<Rgb>>,
    pub textures: Vec<Texture>,
    /// Place on its picture, v down, one a position; empty without pictures.
    pub uvs: Vec<[f32; 2]>,
    pub paints: Vec<Paint>,
    /// Number of its paint, [`PLAIN`] for none; empty, or one a triangle.
    pub paint_of: Vec<u32>,
    /// Faces that have no area at all, as they have fewer than three corners.
    pub thin_faces: u64,
    pub about: About,
    pub notes: Vec<String>,
}

/// In [`Mesh::paint_of`]: none.
pub(super) const PLAIN: u32 = u32::MAX;

/// What lies on triangles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Paint {
    /// Number of a picture.
    pub texture: Option<u32>,
    /// Where it is less opaque than this, there is a hole.
    pub cutoff: Option<f32>,
}

impl Mesh {
    pub fn new(format: impl Into<String>) -> Mesh {
        Mesh {
            positions: Vec::new(),
            colors: Vec::new(),
            alphas: Vec::new(),
            triangles: Vec::new(),
            face_colors: Vec::new(),
            textures: Vec::new(),
            uvs: Vec::new(),
            paints: Vec::new(),
            paint_of: Vec::new(),
            thin_faces: 0,
            about: About::new(Kind::Mesh, format),
            notes: Vec::new(),
        }
    }

    /// Number of a paint like this.
    pub fn paint(&mut self, paint: Paint) -> u32 {
        let known = self.paints.iter().position(|&p| p == paint);
        known.unwrap_or_else(|| {
            self.paints.push(paint);
            self.paints.len() - 1
        }) as u32
    }

    /// Gives all triangles from number `first` on a colour of their own and a paint.
    pub fn mark(&mut self, first: usize, color: Option<Rgb>, paint: u32) {
        if color.is_some() || !self.face_colors.is_empty() {
            self.face_colors.resize(first, None);
            self.face_colors.resize(self.triangles.len(), color);
        }
        if paint != PLAIN || !self.paint_of.is_empty() {
            self.paint_of.resize(first, PLAIN);
            self.paint_of.resize(self.triangles.len(), paint);
        }
    }

    /// Places on pictures of all corners from number `first` on.
    pub fn lay(&mut self, first: usize, uvs: impl Iterator<Item = [f32; 2]>) {
        self.uvs.resize(first, [0.0; 2]);
        self.uvs.extend(uvs);
        self.uvs.resize(self.positions.len(), [0.0; 2]);
    }

    /// Triangles of a polygon, whose corners are there already.
    pub fn push_polygon(&mut self, corners: &[u32]) {
        if corners.len() < 3 {
            self.thin_faces += 1;
            return;
        }
        // Most often all of the polygon is seen from its first corner.
        let fan = corners.windows(2).skip(1).map(|pair| [corners[0], pair[0], pair[1]]);
        match if corners.len() == 3 { None } else { concave(&self.positions, corners) } {
            None => self.triangles.extend(fan),
            Some(outline) => {
                let mut ears: Vec<u32> = Vec::new();
                earcut::Earcut::new().earcut(outline, &[], &mut ears);
                match ears.as_chunks::<3>().0 {
                    [] => self.triangles.extend(fan),
                    ears => self.triangles.extend(ears.iter().map(|ear| ear.map(|i| corners[i as usize]))),
                }
            }
        }
    }

    /// Says of faces that were left out, and more that all readers have in common.
    pub fn finish(mut self) -> Mesh {
        if self.thin_faces > 0 {
            self.about.left_out.push(format!("{} faces of fewer than three corners", self.thin_faces));
        }
        if !self.face_colors.is_empty() {
            self.face_colors.resize(self.triangles.len(), None);
        }
        if !self.paint_of.is_empty() {
            self.paint_of.resize(self.triangles.len(), PLAIN);
        }
        if !self.uvs.is_empty() {
            self.uvs.resize(self.positions.len(), [0.0; 2]);
        }
        if !self.alphas.is_empty() {
            self.alphas.resize(self.positions.len(), 1.0);
        }
        self
    }
}

/// The outline of a polygon, laid flat on its plane, where not all of it is seen from its first corner.
fn concave(positions: &[[f64; 3]], corners: &[u32]) -> Option<Vec<[f64; 2]>> {
    let at = |i: u32| positions.get(i as usize).copied();
    let first = at(corners[0])?;
    let mut points = Vec::with_capacity(corners.len());
    for &corner in corners {
        let p = at(corner)?;
        points.push([0, 1, 2].map(|k| p[k] - first[k]));
    }
    let extent = points.as_flattened().iter().fold(0.0, |a: f64, v| a.max(v.abs()));
    if !extent.is_finite() || extent == 0.0 {
        return None;
    }
    points.as_flattened_mut().iter_mut().for_each(|v| *v /= extent);
    let cross =
        |a: [f64; 3], b: [f64; 3]| [0, 1, 2].map(|k| a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3]);
    let dot = |a: [f64; 3], b: [f64; 3]| (0..3).map(|k| a[k] * b[k]).sum::<f64>();
    let sides: Vec<[f64; 3]> = points.windows(2).skip(1).map(|pair| cross(pair[0], pair[1])).collect();
    // Twice the area, along the normal of the plane that fits best (Newell's).
    let normal = [0, 1, 2].map(|k| sides.iter().map(|side| side[k]).sum::<f64>());
    let most = dot(normal, normal);
    if sides.iter().all(|&side| dot(side, normal) >= -1e-9 * most) {
        return None;
    }
    // Seen along the axis that is nearest to the normal, no two parts of a plane come to lie upon each other.
    let along = (0..3).max_by(|&a, &b| normal[a].abs().total_cmp(&normal[b].abs())).expect("three axes");
    let (a, b) = ((along + 1) % 3, (along + 2) % 3);
    Some(points.iter().map(|p| [p[a], p[b]]).collect())
}

/// The box around finite points, and an error where there is none.
fn bounds_of<'a>(path: &Path, points: impl Iterator<Item = (usize, &'a [f64; 3])>) -> Result<([f64; 3], [f64; 3])> {
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    let mut any = false;
    for (i, p) in points {
        any = true;
        if !p.iter().all(|v| v.is_finite()) {
            return Err(Error::format(path, format!("point {i} is at {p:?}; finite numbers were expected")));
        }
        for axis in 0..3 {
            low[axis] = low[axis].min(p[axis]);
            high[axis] = high[axis].max(p[axis]);
        }
    }
    if !any {
        return Err(Error::format(path, "no points"));
    }
    Ok((low, high))
}

/// Voxels a unit of the input: from `--voxel`, else from `--size` along the longest side.
pub(super) fn scale(path: &Path, low: [f64; 3], high: [f64; 3], opts: &ReadOptions, default: u32) -> Result<f64> {
    if let Some(voxel) = opts.voxel {
        return Ok(1.0 / voxel);
    }
    let longest = (0..3).map(|a| high[a] - low[a]).fold(0.0, f64::max);
    if longest == 0.0 {
        return Err(Error::format(path, "all points are at one place; give --voxel"));
    }
    Ok(f64::from(opts.size.unwrap_or(default)) / longest)
}

/// Coordinates of the source of a place in the world, in voxels, where `low` of the turned source is the world's corner.
fn affine(up: Up, low: [f64; 3], voxel: f64) -> [[f64; 4]; 3] {
    let row = |axis: usize, sign: f64| {
        let mut row = [0.0, 0.0, 0.0, sign * low[axis]];
        row[axis] = sign * voxel;
        row
    };
    match up {
        Up::X => [row(1, 1.0), row(2, 1.0), row(0, 1.0)],
        Up::Y => [row(0, 1.0), row(1, 1.0), row(2, 1.0)],
        Up::Z => [row(0, 1.0), row(2, -1.0), row(1, 1.0)],
    }
}

/// A mesh in voxels of the world.
pub(super) struct Voxelized {
    dims: [u32; 3],
    /// Corners in voxels of the world.
    positions: Vec<[f32; 3]>,
    colors: Vec<Rgb>,
    alphas: Vec<f32>,
    triangles: Vec<[u32; 3]>,
    face_colors: Vec<Option<Rgb>>,
    textures: Vec<Texture>,
    uvs: Vec<[f32; 2]>,
    paints: Vec<Paint>,
    paint_of: Vec<u32>,
    /// Triangles that touch each [`BAND`] of rows.
    bands: Vec<Vec<u32>>,
    inside: Option<Inside>,
    /// Whether a triangle is of a closed surface; empty where that makes no difference.
    closed: Vec<bool>,
    about: About,
    notes: Vec<String>,
}

/// Corner of a polygon under the knife: place, colour, place on a picture, and where there are holes how opaque it is.
type Corner<const N: usize> = [f64; N];

/// The numbers of `triangles` by the bands of rows, of which there are `nz`, that they touch.
pub(super) fn in_bands(positions: &[[f32; 3]], triangles: &[[u32; 3]], nz: u32) -> Vec<Vec<u32>> {
    let mut bands = vec![Vec::new(); nz.div_ceil(BAND) as usize];
    for (i, t) in triangles.iter().enumerate() {
        let zs = t.map(|v| positions[v as usize][2]);
        let cell = |z: f32| (z as u32).min(nz - 1) / BAND;
        let (first, last) = (zs.iter().copied().fold(f32::INFINITY, f32::min), zs.iter().copied().fold(0.0, f32::max));
        for band in &mut bands[cell(first) as usize..=cell(last) as usize] {
            band.push(i as u32);
        }
    }
    bands
}

impl Voxelized {
    pub fn new(path: &Path, mesh: Mesh, opts: &ReadOptions) -> Result<Voxelized> {
        let Mesh { mut positions, colors, alphas, triangles, face_colors, textures, uvs, paints, paint_of, .. } = mesh;
        let (mut about, mut notes) = (mesh.about, mesh.notes);
        let n = positions.len();
        if let Some(t) = triangles.iter().find(|t| t.iter().any(|&i| i as usize >= n)) {
            return Err(Error::format(path, format!("a face has corners {t:?}, there are {n}")));
        }
        if triangles.is_empty() {
            return Err(Error::format(path, "no faces"));
        }
        let up = opts.up.unwrap_or_default();
        for p in &mut positions {
            let [x, y, z] = *p;
            *p = match up {
                Up::X => [z, x, y],
                Up::Y => [x, y, z],
                Up::Z => [x, z, -y],
            };
        }
        // Points that no face uses take no room: they would be drawn as nothing, and many a file has one at 0.
        let mut used = vec![false; n];
        triangles.as_flattened().iter().for_each(|&i| used[i as usize] = true);
        let (low, high) = bounds_of(path, positions.iter().enumerate().filter(|(i, _)| used[*i]))?;
        let loose = used.iter().filter(|&&used| !used).count();
        if loose > 0 {
            let points = if loose == 1 { "point" } else { "points" };
            about.left_out.push(format!("{loose} {points} that no face uses"));
        }
        let scale = scale(path, low, high, opts, DEFAULT_SIZE)?;
        // In f32, as the corners are: what f64 knows better is noise of turns and decimal fractions, not another voxel.
        let sides = [0, 1, 2].map(|a| ((((high[a] - low[a]) * scale) as f32).ceil() as u64).max(1));
        let dims = world_dims(path, sides, "give a smaller --size")?;
        notes.push(format!("{} triangles, {scale:.6} voxels a unit of the mesh", triangles.len()));
        let positions: Vec<[f32; 3]> =
            positions.iter().map(|p| [0, 1, 2].map(|a| ((p[a] - low[a]) * scale) as f32)).collect();
        // An edge between two layers of voxels of the world.
        let between = |p: [f32; 3], q: [f32; 3]| {
            (0..3).any(|a| p[a] == q[a] && p[a].fract() == 0.0 && p[a] > 0.0 && p[a] < dims[a] as f32)
        };
        let any = triangles.iter().any(|t| {
            let [p, q, r] = t.map(|i| positions[i as usize]);
            between(p, q) || between(q, r) || between(r, p)
        });
        let closed = if any { fill::closed(&positions, &triangles) } else { Vec::new() };
        let inside = opts.fill.then(|| Inside::new(&positions, &triangles, dims[2]));
        about.axes = match up {
            Up::X => "x of the file is up",
            Up::Y => "y of the file is up",
            Up::Z => "z of the file is up",
        }
        .to_owned();
        about.voxel = Some([1.0 / scale; 3]);
        about.affine = Some(affine(up, low, 1.0 / scale));
        about.rule = "solid where a face touches".to_owned();
        if let Some(inside) = &inside {
            about.rule += match inside.is_empty() {
                true => ", nothing is closed",
                false => ", and inside closed parts",
            };
            about.left_out.extend(inside.left_out());
            notes.extend(inside.notes());
        }
        let bands = in_bands(&positions, &triangles, dims[2]);
        Ok(Voxelized {
            dims,
            positions,
            colors,
            alphas,
            triangles,
            face_colors,
            textures,
            uvs,
            paints,
            paint_of,
            bands,
            inside,
            closed,
            about,
            notes,
        })
    }

    /// The picture of a paint on a triangle, and which of its sizes has about a pixel a voxel there.
    fn texture<const N: usize>(&self, paint: &Paint, triangle: &[Corner<N>; 3]) -> Option<(&Texture, usize)> {
        let texture = self.textures.get(paint.texture? as usize)?;
        let side = |k: usize, axis: usize| triangle[k][axis] - triangle[0][axis];
        // Twice the area of the shadow along the axis that is neither.
        let shadow = |a: usize, b: usize| side(1, a) * side(2, b) - side(2, a) * side(1, b);
        let voxels = [(0, 1), (1, 2), (2, 0)].map(|(a, b)| shadow(a, b).powi(2)).iter().sum::<f64>().sqrt();
        let pixels = shadow(6, 7).abs() * texture.pixels();
        Some((texture, texture.level(pixels / voxels.max(f64::MIN_POSITIVE))))
    }

    /// The voxels that triangle `i` touches in the columns `xs × zs`, numbered from `x0`, `z0` with `nx` a row. `N` is 9 where
    /// corners are opaque to degrees, else 8.
    fn voxels<const N: usize>(
        &self,
        i: u32,
        xs: &Range<u32>,
        zs: &Range<u32>,
        number: impl Fn(u32, u32) -> u32,
        out: &mut Vec<Spot>,
    ) {
        let own = self.face_colors.get(i as usize).copied().flatten();
        let paint = self.paint_of.get(i as usize).and_then(|&paint| self.paints.get(paint as usize));
        let plain = if paint.is_some_and(|paint| paint.texture.is_some()) { [255; 3] } else { [200; 3] };
        let corner = |v: u32| {
            let [x, y, z] = self.positions[v as usize].map(f64::from);
            let color = own.unwrap_or_else(|| self.colors.get(v as usize).copied().unwrap_or(plain));
            let [r, g, b] = color.map(f64::from);
            let [s, t] = self.uvs.get(v as usize).copied().unwrap_or_default().map(f64::from);
            let all = [x, y, z, r, g, b, s, t, self.alphas.get(v as usize).copied().unwrap_or(1.0).into()];
            std::array::from_fn(|k| all[k])
        };
        let triangle: [Corner<N>; 3] = self.triangles[i as usize].map(corner);
        let texture = paint.and_then(|paint| self.texture(paint, &triangle));
        let cutoff = paint.and_then(|paint| paint.cutoff);
        // Which way is out, for triangles that have an inside.
        let out_of = self.closed.get(i as usize).filter(|closed| **closed).map(|_| {
            let side = |k: usize, axis: usize| triangle[k][axis % 3] - triangle[0][axis % 3];
            [0, 1, 2].map(|a| side(1, a + 1) * side(2, a + 2) - side(1, a + 2) * side(2, a + 1))
        });
        let cells = |polygon: &[Corner<N>], axis: usize, within: &Range<u32>| {
            let low = polygon.iter().map(|c| c[axis]).fold(f64::INFINITY, f64::min);
            let high = polygon.iter().map(|c| c[axis]).fold(f64::NEG_INFINITY, f64::max);
            let last = self.dims[axis] - 1;
            let high = match out_of {
                // Just between two cells: in the lower one where it ends there, or what is inside does.
                Some(out_of) if high.fract() == 0.0 && (low < high || out_of[axis] > 0.0) => high - 1.0,
                _ => high,
            };
            let (low, high) = ((low.min(high) as u32).min(last), (high as u32).min(last));
            low.max(within.start)..(high + 1).min(within.end)
        };
        let (mut row, mut column, mut scratch) = (Vec::new(), Vec::new(), Vec::new());
        for z in cells(&triangle, 2, zs) {
            clip(&triangle, 2, z, self.dims[2], &mut scratch, &mut row);
            if row.is_empty() {
                continue;
            }
            for x in cells(&row, 0, xs) {
                clip(&row, 0, x, self.dims[0], &mut scratch, &mut column);
                if column.is_empty() {
                    continue;
                }
                let n = column.len() as f64;
                let mean = |k: usize| column.iter().map(|c| c[k]).sum::<f64>() / n;
                let tint = [3, 4, 5].map(|k| mean(k).round() as u8);
                let (color, alpha) = texture.map_or((tint, 1.0), |(texture, level)| {
                    let place = [mean(6), mean(7)];
                    (texture.color(level, place, tint), texture.alpha(level, place))
                });
                let alpha = if N > 8 { alpha * mean(8) } else { alpha };
                if cutoff.is_some_and(|cutoff| alpha < f64::from(cutoff)) {
                    continue;
                }
                let column_number = number(x, z);
                let ys = cells(&column, 1, &(0..self.dims[1]));
                out.extend(ys.map(|y| Spot { column: column_number, y: y as u16, color }));
            }
        }
    }
}

/// The part of a polygon in cell `cell` of `n` along an axis, its edges included; a corner or an edge may be all.
fn clip<const N: usize>(
    polygon: &[Corner<N>],
    axis: usize,
    cell: u32,
    n: u32,
    scratch: &mut Vec<Corner<N>>,
    out: &mut Vec<Corner<N>>,
) {
    // Rounding may have put a corner beyond the last cell; that one has no end.
    let high = if cell + 1 == n { f64::INFINITY } else { f64::from(cell + 1) };
    half(polygon, scratch, |c| c[axis] - f64::from(cell));
    half(scratch, out, |c| high - c[axis]);
}

/// The part of a polygon where `inside` is not negative; `inside` is linear.
fn half<const N: usize>(polygon: &[Corner<N>], out: &mut Vec<Corner<N>>, inside: impl Fn(&Corner<N>) -> f64) {
    out.clear();
    let Some(mut before) = polygon.last() else { return };
    let mut d_before = inside(before);
    for corner in polygon {
        let d = inside(corner);
        if (d < 0.0) != (d_before < 0.0) {
            let t = d_before / (d_before - d);
            out.push(std::array::from_fn(|k| before[k] + (corner[k] - before[k]) * t));
        }
        if d >= 0.0 {
            out.push(*corner);
        }
        (before, d_before) = (corner, d);
    }
}

impl Pieces for Voxelized {
    fn dims(&self) -> [u32; 3] {
        self.dims
    }

    fn colored(&self) -> bool {
        !self.colors.is_empty() || !self.face_colors.is_empty() || !self.textures.is_empty()
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }

    fn about(&self) -> About {
        self.about.clone()
    }

    fn piece(&self, xs: Range<u32>, zs: Range<u32>) -> Result<Input> {
        let dims = [xs.len() as u32, self.dims[1], zs.len() as u32];
        let number = |x: u32, z: u32| (z - zs.start) * dims[0] + x - xs.start;
        let (spots, filled): (Vec<Vec<Spot>>, Vec<_>) = (zs.start / BAND..zs.end.div_ceil(BAND))
            .into_par_iter()
            .map(|band| {
                let rows = zs.start.max(band * BAND)..zs.end.min((band + 1) * BAND);
                let mut out = Vec::new();
                for &i in &self.bands[band as usize] {
                    match self.alphas.is_empty() {
                        true => self.voxels::<8>(i, &xs, &rows, number, &mut out),
                        false => self.voxels::<9>(i, &xs, &rows, number, &mut out),
                    }
                }
                // A voxel is touched by several triangles, mostly of the same colour.
                out.sort_unstable();
                out.dedup();
                let inside = self.inside.as_ref();
                (out, inside.map_or_else(Vec::new, |inside| inside.runs(band, &xs, &rows, dims[1], number)))
            })
            .unzip();
        Ok(spots::piece_filled(dims, spots.concat(), &filled.concat(), self.colored()))
    }
}
