//! Meshes: PLY, and with the feature `mesh` OBJ, STL and glTF.
//!
//! A voxel is solid where a triangle touches it (conservative: no triangle, however thin, is lost between voxels).
//! Exact, by columns: a triangle clipped to a column is one polygon, and the voxels it touches there are just those
//! between its lowest and its highest point. The inside is not filled, as scanned meshes often have none.

use std::ops::Range;
use std::path::Path;

use rayon::prelude::*;

use super::spots::{self, Spot};
use super::texture::Texture;
#[cfg(feature = "mesh")]
use super::texture::Wrap;
use super::{ReadOptions, Up, world_dims};
use crate::pieces::Pieces;
use crate::{Error, Input, Result, Rgb};

/// Voxels along the longest side where nobody says.
const DEFAULT_SIZE: u32 = 512;
/// Rows of columns whose triangles are listed together.
const BAND: u32 = 32;

/// Triangles with a colour a corner, and with pictures on them that these colours tint.
#[derive(Debug, Default)]
pub(super) struct Mesh {
    pub positions: Vec<[f32; 3]>,
    /// One a position; empty without colours.
    pub colors: Vec<Rgb>,
    pub triangles: Vec<[u32; 3]>,
    pub textures: Vec<Texture>,
    /// Place on its picture, v down, one a position; empty without pictures.
    pub uvs: Vec<[f32; 2]>,
    /// Number of its picture, `u32::MAX` for none, one a triangle; empty without pictures.
    pub texture_of: Vec<u32>,
    pub notes: Vec<String>,
}

/// In [`Mesh::texture_of`]: no picture.
#[cfg(feature = "mesh")]
const PLAIN: u32 = u32::MAX;

impl Mesh {
    /// Gives all triangles from number `first` on a picture, and all corners from number `corner` on their places on it.
    #[cfg(feature = "mesh")]
    fn paint(&mut self, first: usize, corner: usize, texture: u32, uvs: impl Iterator<Item = [f32; 2]>) {
        self.texture_of.resize(first, PLAIN);
        self.texture_of.resize(self.triangles.len(), texture);
        self.uvs.resize(corner, [0.0; 2]);
        self.uvs.extend(uvs);
        self.uvs.resize(self.positions.len(), [0.0; 2]);
    }

    /// Makes what was painted as long as the mesh has become since.
    #[cfg(feature = "mesh")]
    fn finish_paint(&mut self) {
        if !self.textures.is_empty() {
            self.texture_of.resize(self.triangles.len(), PLAIN);
            self.uvs.resize(self.positions.len(), [0.0; 2]);
        }
    }

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
    textures: Vec<Texture>,
    uvs: Vec<[f32; 2]>,
    texture_of: Vec<u32>,
    /// Triangles that touch each [`BAND`] of rows.
    bands: Vec<Vec<u32>>,
    notes: Vec<String>,
}

/// Corner of a polygon under the knife: place, colour, place on a picture.
type Corner = [f64; 8];

impl Voxelized {
    pub fn new(path: &Path, mesh: Mesh, opts: &ReadOptions) -> Result<Voxelized> {
        let Mesh { mut positions, colors, triangles, textures, uvs, texture_of, mut notes } = mesh;
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
        Ok(Voxelized { dims, positions, colors, triangles, textures, uvs, texture_of, bands, notes })
    }

    /// The picture of triangle `i`, and which of its sizes has about a pixel a voxel there.
    fn texture(&self, i: u32, triangle: &[Corner; 3]) -> Option<(&Texture, usize)> {
        let texture = self.textures.get(*self.texture_of.get(i as usize)? as usize)?;
        let side = |k: usize, axis: usize| triangle[k][axis] - triangle[0][axis];
        // Twice the area of the shadow along the axis that is neither.
        let shadow = |a: usize, b: usize| side(1, a) * side(2, b) - side(2, a) * side(1, b);
        let voxels = [(0, 1), (1, 2), (2, 0)].map(|(a, b)| shadow(a, b).powi(2)).iter().sum::<f64>().sqrt();
        let pixels = shadow(6, 7).abs() * texture.pixels();
        Some((texture, texture.level(pixels / voxels.max(f64::MIN_POSITIVE))))
    }

    /// The voxels that triangle `i` touches in the columns `xs × zs`, numbered from `x0`, `z0` with `nx` a row.
    fn voxels(&self, i: u32, xs: &Range<u32>, zs: &Range<u32>, number: impl Fn(u32, u32) -> u32, out: &mut Vec<Spot>) {
        let corner = |v: u32| {
            let [x, y, z] = self.positions[v as usize].map(f64::from);
            let [r, g, b] = self.colors.get(v as usize).copied().unwrap_or_default().map(f64::from);
            let [u, v] = self.uvs.get(v as usize).copied().unwrap_or_default().map(f64::from);
            [x, y, z, r, g, b, u, v]
        };
        let triangle = self.triangles[i as usize].map(corner);
        let texture = self.texture(i, &triangle);
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
                let mean = |k: usize| column.iter().map(|c| c[k]).sum::<f64>() / n;
                let tint = [3, 4, 5].map(|k| mean(k).round() as u8);
                let color = texture.map_or(tint, |(texture, level)| texture.color(level, [mean(6), mean(7)], tint));
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

/// Wavefront OBJ, with vertex colours or the diffuse colours of its materials, and with their pictures.
#[cfg(feature = "mesh")]
pub(super) fn obj(path: &Path, bytes: &[u8]) -> Result<Mesh> {
    let options = tobj::LoadOptions { triangulate: true, single_index: true, ..Default::default() };
    let folder = path.parent().unwrap_or(Path::new(""));
    let fail = |e| Error::format(path, format!("OBJ: {e}"));
    let (models, materials) = super::guarded(path, "OBJ", || {
        let materials = |name: &Path| {
            let file = super::map(&folder.join(name)).map_err(|_| tobj::LoadError::OpenFileFailed)?;
            tobj::load_mtl_buf(&mut &file[..])
        };
        tobj::load_obj_buf(&mut &*bytes, &options, materials).map_err(fail)
    })?;
    let mut out = Mesh::default();
    let materials = materials.unwrap_or_else(|e| {
        out.notes.push(format!("materials are left out: {e}"));
        Vec::new()
    });
    let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
    let (mut colors, mut any) = (Vec::new(), false);
    let mut textures = Textures::default();
    for tobj::Model { mesh, .. } in models {
        let base = out.positions.len() as u32;
        let n = mesh.positions.len();
        out.positions.extend_from_slice(mesh.positions.as_chunks::<3>().0);
        let material = mesh.material_id.and_then(|id| materials.get(id));
        let texture = material.and_then(|m| m.diffuse_texture.as_deref()).and_then(|named| {
            // Options stand before the name.
            let name = if named.starts_with('-') { named.rsplit(' ').next()? } else { named }.replace('\\', "/");
            let file = folder.join(&name);
            textures.number(&mut out, name.clone(), [Wrap::Repeat; 2], || {
                Texture::read(&file, &super::map(&file)?, [Wrap::Repeat; 2])
            })
        });
        // Many writers leave the diffuse colour of what has a picture black.
        let plain = |c: [f32; 3]| if texture.is_some() && c == [0.0; 3] { [1.0; 3] } else { c };
        let diffuse = material.and_then(|m| m.diffuse).map(plain).or(texture.map(|_| [1.0; 3]));
        any |= mesh.vertex_color.len() == n || diffuse.is_some();
        match mesh.vertex_color.len() == n {
            true => colors.extend(mesh.vertex_color.as_chunks::<3>().0.iter().map(|c| c.map(byte))),
            false => colors.extend(std::iter::repeat_n(diffuse.map_or([200; 3], |c| c.map(byte)), n / 3)),
        }
        let first = out.triangles.len();
        out.triangles.extend(mesh.indices.as_chunks::<3>().0.iter().map(|t| t.map(|i| base + i)));
        if let Some(texture) = texture {
            let uvs = mesh.texcoords.as_chunks::<2>().0.iter().take(n / 3);
            out.paint(first, base as usize, texture, uvs.map(|&[u, v]| [u, 1.0 - v]));
        }
    }
    out.finish_paint();
    if any {
        out.colors = colors;
    }
    Ok(out)
}

/// The pictures of a mesh under construction, by name, each read once.
#[cfg(feature = "mesh")]
#[derive(Default)]
struct Textures(std::collections::HashMap<(String, [Wrap; 2]), Option<u32>>);

#[cfg(feature = "mesh")]
impl Textures {
    /// Number of a picture in `mesh`, read where it is new; None, with a note, where it cannot be read.
    fn number(
        &mut self,
        mesh: &mut Mesh,
        name: String,
        wrap: [Wrap; 2],
        read: impl FnOnce() -> Result<Texture>,
    ) -> Option<u32> {
        *self.0.entry((name, wrap)).or_insert_with(|| match read() {
            Ok(texture) => {
                mesh.textures.push(texture);
                Some(mesh.textures.len() as u32 - 1)
            }
            Err(e) => {
                mesh.notes.push(format!("a texture is left out: {e}"));
                None
            }
        })
    }
}

/// glTF and GLB: all meshes of the default scene, with vertex colours, and with the base colours and their pictures of
/// materials.
#[cfg(feature = "mesh")]
pub(super) fn gltf(path: &Path, bytes: &[u8]) -> Result<Mesh> {
    use crate::srgb::from_linear;
    let fail = |e: gltf::Error| Error::format(path, format!("glTF: {e}"));
    super::guarded(path, "glTF", || {
        let gltf::Gltf { document, blob } = gltf::Gltf::from_slice(bytes).map_err(fail)?;
        for buffer in document.buffers() {
            if let gltf::buffer::Source::Uri(uri) = buffer.source() {
                check_uri(path, uri)?;
            }
        }
        let buffers = gltf::import_buffers(&document, path.parent(), blob).map_err(fail)?;
        let scene = document.default_scene().or_else(|| document.scenes().next());
        let scene = scene.ok_or_else(|| Error::format(path, "glTF: no scene"))?;
        const IDENTITY: [[f32; 4]; 4] =
            [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
        let product = |a: &[[f32; 4]; 4], b: [[f32; 4]; 4]| -> [[f32; 4]; 4] {
            b.map(|column| std::array::from_fn(|row| (0..4).map(|k| a[k][row] * column[k]).sum()))
        };
        let mut out = Mesh::default();
        let mut textures = Textures::default();
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
                let first = out.triangles.len();
                out.triangles.extend_from_slice(indices.as_chunks::<3>().0);
                let info = primitive.material().pbr_metallic_roughness().base_color_texture();
                if let Some(info) = info
                    && let Some(uvs) = reader.read_tex_coords(info.tex_coord())
                    && let Some(texture) = gltf_texture(path, &info.texture(), &buffers, &mut textures, &mut out)
                {
                    out.paint(first, base as usize, texture, uvs.into_f32().take(n));
                }
            }
            if out.triangles.len() > u32::MAX as usize / 4 || nodes.len() > 1 << 20 {
                return Err(Error::Limit(format!("{}: more triangles than can be held", path.display())));
            }
        }
        if skipped > 0 {
            out.notes.push(format!("{skipped} primitives that are no triangles are left out"));
        }
        out.finish_paint();
        Ok(out)
    })
}

/// Refuses a file that a glTF at `path` names where that may have no end; what is no file is not looked at.
#[cfg(feature = "mesh")]
fn check_uri(path: &Path, uri: &str) -> Result<()> {
    let name = match uri.split_once(':') {
        Some(("file", name)) => name.strip_prefix("//").unwrap_or(name).to_owned(),
        Some(_) => return Ok(()),
        None => percent_decoded(uri),
    };
    super::check_regular(&path.parent().unwrap_or(Path::new("")).join(name))
}

/// A relative reference without its `%20` and the like.
#[cfg(feature = "mesh")]
fn percent_decoded(text: &str) -> String {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.as_bytes();
    while let [first, after @ ..] = rest {
        let code = after.get(..2).and_then(|hex| u8::from_str_radix(std::str::from_utf8(hex).ok()?, 16).ok());
        match code {
            Some(code) if *first == b'%' => {
                bytes.push(code);
                rest = &after[2..];
            }
            _ => {
                bytes.push(*first);
                rest = after;
            }
        }
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

/// Number of a texture's picture: in a buffer, in the text itself, or in a file beside `path`.
#[cfg(feature = "mesh")]
fn gltf_texture(
    path: &Path,
    texture: &gltf::Texture,
    buffers: &[gltf::buffer::Data],
    textures: &mut Textures,
    mesh: &mut Mesh,
) -> Option<u32> {
    use gltf::texture::WrappingMode;
    let wrap = [texture.sampler().wrap_s(), texture.sampler().wrap_t()].map(|mode| match mode {
        WrappingMode::ClampToEdge => Wrap::Clamp,
        WrappingMode::MirroredRepeat => Wrap::Mirror,
        WrappingMode::Repeat => Wrap::Repeat,
    });
    let image = texture.source();
    let name = format!("image {}", image.index());
    let wrong = |what: String| Error::format(path, format!("glTF: image {}: {what}", image.index()));
    let read = || match image.source() {
        gltf::image::Source::View { view, .. } => {
            let bytes = buffers.get(view.buffer().index()).and_then(|buffer| {
                let end = view.offset().checked_add(view.length())?;
                buffer.0.get(view.offset()..end)
            });
            let bytes = bytes.ok_or_else(|| wrong("lies outside its buffer".to_owned()))?;
            Texture::read(path, bytes, wrap)
        }
        gltf::image::Source::Uri { uri, .. } => {
            check_uri(path, uri)?;
            let source = gltf::buffer::Source::Uri(uri);
            let bytes = gltf::buffer::Data::from_source(source, path.parent()).map_err(|e| wrong(e.to_string()))?;
            Texture::read(path, &bytes.0, wrap)
        }
    };
    textures.number(mesh, name, wrap, read)
}
