//! Meshes: PLY, and with the feature `mesh` OBJ, STL and glTF.
//!
//! A voxel is solid where a triangle touches it (conservative: no triangle, however thin, is lost between voxels).
//! Exact, by columns: a triangle clipped to a column is one polygon, and the voxels it touches there are just those
//! between its lowest and its highest point. The inside is not filled, as scanned meshes often have none.

use std::ops::Range;
use std::path::Path;

use rayon::prelude::*;

use super::spots::{self, Spot};
use super::{ReadOptions, Up, world_dims};
use crate::pieces::Pieces;
use crate::{Error, Input, Result, Rgb};

/// Voxels along the longest side where nobody says.
const DEFAULT_SIZE: u32 = 512;
/// Rows of columns whose triangles are listed together.
const BAND: u32 = 32;

/// Triangles with a colour a corner.
#[derive(Debug, Default)]
pub(super) struct Mesh {
    pub positions: Vec<[f32; 3]>,
    /// One a position; empty without colours.
    pub colors: Vec<Rgb>,
    pub triangles: Vec<[u32; 3]>,
    pub notes: Vec<String>,
}

impl Mesh {
    /// Triangles of a polygon's corners, all at its first.
    pub fn push_polygon(&mut self, corners: &[u32]) {
        for pair in corners.windows(2).skip(1) {
            self.triangles.push([corners[0], pair[0], pair[1]]);
        }
    }
}

/// The box around finite points, and an error where there is none.
pub(super) fn bounds(path: &Path, points: &[[f32; 3]]) -> Result<([f64; 3], [f64; 3])> {
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for (i, p) in points.iter().enumerate() {
        if !p.iter().all(|v| v.is_finite()) {
            return Err(Error::format(path, format!("point {i} is at {p:?}; finite numbers were expected")));
        }
        for axis in 0..3 {
            low[axis] = low[axis].min(p[axis].into());
            high[axis] = high[axis].max(p[axis].into());
        }
    }
    if points.is_empty() {
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

/// A mesh in voxels of the world.
pub(super) struct Voxelized {
    dims: [u32; 3],
    /// Corners in voxels of the world.
    positions: Vec<[f32; 3]>,
    colors: Vec<Rgb>,
    triangles: Vec<[u32; 3]>,
    /// Triangles that touch each [`BAND`] of rows.
    bands: Vec<Vec<u32>>,
    notes: Vec<String>,
}

/// Corner of a polygon under the knife: place and colour.
type Corner = [f64; 6];

impl Voxelized {
    pub fn new(path: &Path, mesh: Mesh, opts: &ReadOptions) -> Result<Voxelized> {
        let Mesh { mut positions, colors, triangles, mut notes } = mesh;
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
        let (low, high) = bounds(path, &positions)?;
        let scale = scale(path, low, high, opts, DEFAULT_SIZE)?;
        let sides = [0, 1, 2].map(|a| (((high[a] - low[a]) * scale).ceil() as u64).max(1));
        let dims = world_dims(path, sides, "give a smaller --size")?;
        notes.push(format!("{} triangles, {scale:.6} voxels a unit of the mesh", triangles.len()));
        for p in &mut positions {
            *p = [0, 1, 2].map(|a| ((f64::from(p[a]) - low[a]) * scale) as f32);
        }
        let mut bands = vec![Vec::new(); dims[2].div_ceil(BAND) as usize];
        for (i, t) in triangles.iter().enumerate() {
            let zs = t.map(|v| positions[v as usize][2]);
            let cell = |z: f32| (z as u32).min(dims[2] - 1) / BAND;
            let (first, last) =
                (zs.iter().copied().fold(f32::INFINITY, f32::min), zs.iter().copied().fold(0.0, f32::max));
            for band in &mut bands[cell(first) as usize..=cell(last) as usize] {
                band.push(i as u32);
            }
        }
        Ok(Voxelized { dims, positions, colors, triangles, bands, notes })
    }

    /// The voxels that triangle `i` touches in the columns `xs × zs`, numbered from `x0`, `z0` with `nx` a row.
    fn voxels(&self, i: u32, xs: &Range<u32>, zs: &Range<u32>, number: impl Fn(u32, u32) -> u32, out: &mut Vec<Spot>) {
        let corner = |v: u32| {
            let [x, y, z] = self.positions[v as usize].map(f64::from);
            let [r, g, b] = self.colors.get(v as usize).copied().unwrap_or_default().map(f64::from);
            [x, y, z, r, g, b]
        };
        let triangle = self.triangles[i as usize].map(corner);
        let cells = |polygon: &[Corner], axis: usize, within: &Range<u32>| {
            let low = polygon.iter().map(|c| c[axis]).fold(f64::INFINITY, f64::min);
            let high = polygon.iter().map(|c| c[axis]).fold(f64::NEG_INFINITY, f64::max);
            let last = self.dims[axis] - 1;
            let (low, high) = ((low as u32).min(last), (high as u32).min(last));
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
                let color = [3, 4, 5].map(|k| (column.iter().map(|c| c[k]).sum::<f64>() / n).round() as u8);
                let column_number = number(x, z);
                let ys = cells(&column, 1, &(0..self.dims[1]));
                out.extend(ys.map(|y| Spot { column: column_number, y: y as u16, color }));
            }
        }
    }
}

/// The part of a polygon in cell `cell` of `n` along an axis, its edges included; a corner or an edge may be all.
fn clip(polygon: &[Corner], axis: usize, cell: u32, n: u32, scratch: &mut Vec<Corner>, out: &mut Vec<Corner>) {
    // Rounding may have put a corner beyond the last cell; that one has no end.
    let high = if cell + 1 == n { f64::INFINITY } else { f64::from(cell + 1) };
    half(polygon, scratch, |c| c[axis] - f64::from(cell));
    half(scratch, out, |c| high - c[axis]);
}

/// The part of a polygon where `inside` is not negative; `inside` is linear.
fn half(polygon: &[Corner], out: &mut Vec<Corner>, inside: impl Fn(&Corner) -> f64) {
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
        !self.colors.is_empty()
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }

    fn piece(&self, xs: Range<u32>, zs: Range<u32>) -> Result<Input> {
        let dims = [xs.len() as u32, self.dims[1], zs.len() as u32];
        let spots: Vec<Vec<Spot>> = (zs.start / BAND..zs.end.div_ceil(BAND))
            .into_par_iter()
            .map(|band| {
                let rows = zs.start.max(band * BAND)..zs.end.min((band + 1) * BAND);
                let mut out = Vec::new();
                for &i in &self.bands[band as usize] {
                    self.voxels(i, &xs, &rows, |x, z| (z - zs.start) * dims[0] + x - xs.start, &mut out);
                }
                // A voxel is touched by several triangles, mostly of the same colour.
                out.sort_unstable();
                out.dedup();
                out
            })
            .collect();
        Ok(spots::piece(dims, spots.concat(), self.colored()))
    }
}

/// STL, text or binary.
#[cfg(feature = "mesh")]
pub(super) fn stl(path: &Path, bytes: &[u8]) -> Result<Mesh> {
    let fail = |e| Error::format(path, format!("STL: {e}"));
    let stl = super::guarded(path, "STL", || stl_io::read_stl(&mut std::io::Cursor::new(bytes)).map_err(fail))?;
    Ok(Mesh {
        positions: stl.vertices.iter().map(|v| [v[0], v[1], v[2]]).collect(),
        triangles: stl.faces.iter().map(|f| f.vertices.map(|v| v as u32)).collect(),
        ..Mesh::default()
    })
}

/// Wavefront OBJ, with vertex colours or the diffuse colours of its materials.
#[cfg(feature = "mesh")]
pub(super) fn obj(path: &Path, bytes: &[u8]) -> Result<Mesh> {
    let options = tobj::LoadOptions { triangulate: true, ..Default::default() };
    let folder = path.parent().unwrap_or(Path::new(""));
    let fail = |e| Error::format(path, format!("OBJ: {e}"));
    let (models, materials) = super::guarded(path, "OBJ", || {
        tobj::load_obj_buf(&mut &*bytes, &options, |name| tobj::load_mtl(folder.join(name))).map_err(fail)
    })?;
    let mut out = Mesh::default();
    let materials = materials.unwrap_or_else(|e| {
        out.notes.push(format!("materials are left out: {e}"));
        Vec::new()
    });
    let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
    let (mut colors, mut any) = (Vec::new(), false);
    for tobj::Model { mesh, .. } in models {
        let base = out.positions.len() as u32;
        let n = mesh.positions.len();
        out.positions.extend_from_slice(mesh.positions.as_chunks::<3>().0);
        let diffuse = mesh.material_id.and_then(|id| materials.get(id)?.diffuse);
        any |= mesh.vertex_color.len() == n || diffuse.is_some();
        match mesh.vertex_color.len() == n {
            true => colors.extend(mesh.vertex_color.as_chunks::<3>().0.iter().map(|c| c.map(byte))),
            false => colors.extend(std::iter::repeat_n(diffuse.map_or([200; 3], |c| c.map(byte)), n / 3)),
        }
        out.triangles.extend(mesh.indices.as_chunks::<3>().0.iter().map(|t| t.map(|i| base + i)));
    }
    if any {
        out.colors = colors;
    }
    Ok(out)
}

/// glTF and GLB: all meshes of the default scene, with vertex colours or the base colours of their materials. Textures
/// are not read.
#[cfg(feature = "mesh")]
pub(super) fn gltf(path: &Path, bytes: &[u8]) -> Result<Mesh> {
    use crate::srgb::from_linear;
    let fail = |e: gltf::Error| Error::format(path, format!("glTF: {e}"));
    super::guarded(path, "glTF", || {
        let gltf::Gltf { document, blob } = gltf::Gltf::from_slice(bytes).map_err(fail)?;
        let buffers = gltf::import_buffers(&document, path.parent(), blob).map_err(fail)?;
        let scene = document.default_scene().or_else(|| document.scenes().next());
        let scene = scene.ok_or_else(|| Error::format(path, "glTF: no scene"))?;
        const IDENTITY: [[f32; 4]; 4] =
            [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
        let product = |a: &[[f32; 4]; 4], b: [[f32; 4]; 4]| -> [[f32; 4]; 4] {
            b.map(|column| std::array::from_fn(|row| (0..4).map(|k| a[k][row] * column[k]).sum()))
        };
        let mut out = Mesh::default();
        let mut skipped = 0;
        let mut nodes: Vec<_> = scene.nodes().map(|node| (node, IDENTITY)).collect();
        while let Some((node, above)) = nodes.pop() {
            let place = product(&above, node.transform().matrix());
            nodes.extend(node.children().map(|child| (child, place)));
            for primitive in node.mesh().into_iter().flat_map(|mesh| mesh.primitives().collect::<Vec<_>>()) {
                let reader = primitive.reader(|buffer| buffers.get(buffer.index()).map(|data| &data.0[..]));
                let (gltf::mesh::Mode::Triangles, Some(positions)) = (primitive.mode(), reader.read_positions()) else {
                    skipped += 1;
                    continue;
                };
                let base = out.positions.len() as u32;
                out.positions.extend(
                    positions.map(|p| {
                        [0, 1, 2].map(|row| (0..3).map(|k| place[k][row] * p[k]).sum::<f32>() + place[3][row])
                    }),
                );
                let n = out.positions.len() - base as usize;
                let [r, g, b, _] = primitive.material().pbr_metallic_roughness().base_color_factor();
                let srgb = |c: [f32; 3]| c.map(|v| from_linear(v.into()));
                match reader.read_colors(0) {
                    Some(of) => {
                        out.colors.extend(of.into_rgb_f32().map(|c| srgb([c[0] * r, c[1] * g, c[2] * b])).take(n))
                    }
                    None => out.colors.extend(std::iter::repeat_n(srgb([r, g, b]), n)),
                }
                out.colors.resize(out.positions.len(), [200; 3]);
                let indices: Vec<u32> = match (reader.read_indices(), primitive.indices()) {
                    (Some(indices), _) => indices.into_u32().map(|i| base.saturating_add(i)).collect(),
                    (None, None) => (base..base + n as u32).collect(),
                    (None, Some(_)) => return Err(Error::format(path, "glTF: indices that lie outside their buffer")),
                };
                if primitive.indices().is_some_and(|of| of.count() != indices.len()) {
                    return Err(Error::format(path, "glTF: fewer indices than are claimed"));
                }
                out.triangles.extend_from_slice(indices.as_chunks::<3>().0);
            }
            if out.triangles.len() > u32::MAX as usize / 4 || nodes.len() > 1 << 20 {
                return Err(Error::Limit(format!("{}: more triangles than can be held", path.display())));
            }
        }
        if skipped > 0 {
            out.notes.push(format!("{skipped} primitives that are no triangles are left out"));
        }
        Ok(out)
    })
}
