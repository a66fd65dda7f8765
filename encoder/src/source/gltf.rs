//! glTF and GLB: all meshes of the default scene, in their rest pose, with vertex colours, and with the base colours and their
//! pictures of materials.

use std::path::Path;

use ::gltf::accessor::{Accessor, DataType};
use ::gltf::buffer::{Data, Source};
use ::gltf::material::AlphaMode;
use ::gltf::mesh::{Mode, Primitive, Semantic};
use ::gltf::{Document, Gltf, Node};
use serde_json::Value;

use super::mesh::{Mesh, PLAIN, Paint};
use super::texture::{Texture, Textures, Wrap};
use crate::model::srgb::from_linear;
use crate::{Error, Result};

/// Most corners that instances of a mesh make.
const MAX_CORNERS: usize = 1 << 27;

/// Extensions that change what is drawn here, and are read.
const READ: &[&str] = &[
    "EXT_mesh_gpu_instancing",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_unlit",
    "KHR_mesh_quantization",
    "KHR_node_visibility",
    "KHR_texture_transform",
];

/// What says where data are packed: where it is not required, they are there unpacked, too.
const PACKED: &[&str] = &["KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression"];

/// Whether an extension says how light falls or what things mean, and not where they are.
fn is_shading(extension: &str) -> bool {
    ["KHR_materials_", "KHR_lights_", "EXT_lights_", "KHR_xmp", "EXT_structural_metadata", "EXT_mesh_features"]
        .iter()
        .any(|start| extension.starts_with(start))
}

/// A 4 × 4 matrix, by columns.
type Matrix = [[f64; 4]; 4];

const IDENTITY: Matrix = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];

fn product(a: &Matrix, b: &Matrix) -> Matrix {
    b.map(|column| std::array::from_fn(|row| (0..4).map(|k| a[k][row] * column[k]).sum()))
}

fn placed(place: &Matrix, p: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|row| (0..3).map(|k| place[k][row] * p[k]).sum::<f64>() + place[3][row])
}

/// Scaled, then turned by a quaternion (x, y, z, w), then moved.
fn transform(translation: [f64; 3], rotation: [f64; 4], scale: [f64; 3]) -> Matrix {
    // Of length 1, says the format, but in as many digits as somebody wrote.
    let length = rotation.iter().map(|v| v * v).sum::<f64>().sqrt();
    let [x, y, z, w] = if length > 0.0 { rotation.map(|v| v / length) } else { [0.0, 0.0, 0.0, 1.0] };
    let columns = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + z * w), 2.0 * (x * z - y * w)],
        [2.0 * (x * y - z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + x * w)],
        [2.0 * (x * z + y * w), 2.0 * (y * z - x * w), 1.0 - 2.0 * (x * x + y * y)],
    ];
    let mut out = IDENTITY;
    for k in 0..3 {
        for row in 0..3 {
            out[k][row] = columns[k][row] * scale[k];
        }
        out[3][k] = translation[k];
    }
    out
}

/// How a node lies in the one above, with all the digits of the file: the crate keeps those of `f32`, which are too few for
/// coordinates of maps.
#[derive(Default, serde::Deserialize)]
#[serde(default)]
struct Place {
    matrix: Option<[f64; 16]>,
    translation: Option<[f64; 3]>,
    rotation: Option<[f64; 4]>,
    scale: Option<[f64; 3]>,
}

#[derive(Default, serde::Deserialize)]
#[serde(default)]
struct Places {
    nodes: Vec<Place>,
}

impl Place {
    fn matrix(&self) -> Matrix {
        match self.matrix {
            Some(m) => std::array::from_fn(|k| std::array::from_fn(|row| m[4 * k + row])),
            None => transform(
                self.translation.unwrap_or_default(),
                self.rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]),
                self.scale.unwrap_or([1.0; 3]),
            ),
        }
    }
}

pub(super) fn read(path: &Path, bytes: &[u8]) -> Result<Mesh> {
    super::guarded(path, "glTF", || {
        let fail = |e: ::gltf::Error| wrong(path, e);
        let Gltf { document, blob } = Gltf::from_slice_without_validation(bytes).map_err(fail)?;
        let mut root = document.into_json();
        check_required(path, &mut root)?;
        let document = Document::from_json(root).map_err(fail)?;
        for buffer in document.buffers() {
            if let Source::Uri(uri) = buffer.source() {
                check_uri(path, uri)?;
            }
        }
        let buffers = ::gltf::import_buffers(&document, path.parent(), blob).map_err(fail)?;
        let json = ::gltf::binary::Glb::from_slice(bytes).map(|glb| glb.json);
        let places = serde_json::from_slice::<Places>(json.as_deref().unwrap_or(bytes)).unwrap_or_default();
        let version = &document.as_json().asset.version;
        let reader = Reader {
            path,
            quantized: document.extensions_used().any(|name| name == "KHR_mesh_quantization"),
            globals: globals(path, &document, &places.nodes)?,
            document: &document,
            buffers,
        };
        let mut scene =
            Scene { reader: &reader, mesh: Mesh::new(format!("glTF {version}")), textures: Textures::default() };
        scene.mesh.about.unit = "m".to_owned();
        scene.draw()
    })
}

fn wrong(path: &Path, what: impl std::fmt::Display) -> Error {
    Error::format(path, format!("glTF: {what}"))
}

/// Refuses what cannot be read without an extension that is not; takes those away that are read though the crate knows
/// nothing of them.
fn check_required(path: &Path, root: &mut ::gltf::json::Root) -> Result<()> {
    let required = std::mem::take(&mut root.extensions_required);
    let Some(unknown) = required.iter().find(|name| !READ.contains(&name.as_str()) && !is_shading(name)) else {
        return Ok(());
    };
    let advice = if PACKED.contains(&unknown.as_str()) {
        "write the file without compression (Blender: Compression off when it exports; gltf-pipeline: without -d)"
    } else if unknown.contains("texture") {
        "write the file with pictures in PNG or JPEG"
    } else {
        "write the file without it"
    };
    Err(wrong(
        path,
        format!("it needs the extension {}, which is not read; {advice}", super::text::shown(unknown.as_bytes())),
    ))
}

/// Where each node stands in the world.
fn globals(path: &Path, document: &Document, places: &[Place]) -> Result<Vec<Matrix>> {
    let n = document.nodes().len();
    let mut above = vec![None; n];
    for node in document.nodes() {
        for child in node.children() {
            if above[child.index()].replace(node.index()).is_some() {
                return Err(wrong(path, format!("node {} is a child of two nodes", child.index())));
            }
        }
    }
    let mut out = vec![IDENTITY; n];
    let mut nodes: Vec<_> = document.nodes().filter(|node| above[node.index()].is_none()).collect();
    let mut n_seen = 0;
    while let Some(node) = nodes.pop() {
        n_seen += 1;
        let i = node.index();
        let own = places.get(i).map_or(IDENTITY, Place::matrix);
        out[i] = above[i].map_or(own, |above| product(&out[above], &own));
        nodes.extend(node.children());
    }
    match n_seen == n {
        true => Ok(out),
        false => Err(wrong(path, "nodes that are children of each other")),
    }
}

/// A document and its data.
struct Reader<'a> {
    path: &'a Path,
    document: &'a Document,
    buffers: Vec<Data>,
    globals: Vec<Matrix>,
    /// Whether whole numbers of attributes may stand for themselves.
    quantized: bool,
}

impl Reader<'_> {
    /// All numbers of an accessor with `N` to an element; of whole numbers those that `normalized` says, or the accessor itself,
    /// lie between −1 or 0 and 1.
    fn values<const N: usize>(&self, accessor: &Accessor, normalized: bool) -> Result<Vec<[f64; N]>> {
        let i = accessor.index();
        let fail = |what: String| wrong(self.path, format!("accessor {i}: {what}"));
        if accessor.dimensions().multiplicity() != N {
            return Err(fail(format!("{:?}, expected {N} numbers an element", accessor.dimensions())));
        }
        let kind = accessor.data_type();
        let size = accessor.size();
        let count = accessor.count();
        let element = |bytes: &[u8]| {
            std::array::from_fn(|k| component(kind, &bytes[k * size / N..], normalized || accessor.normalized()))
        };
        let mut out: Vec<[f64; N]> = match accessor.view() {
            Some(view) => {
                let bytes = self.strided(&view, accessor.offset(), count, size, view.stride().unwrap_or(size));
                bytes.map_err(fail)?.map(element).collect()
            }
            // Of zeros, which `sparse` below changes.
            None => {
                let all = self.buffers.iter().map(|data| data.0.len()).sum::<usize>();
                if count > all.max(1 << 16) {
                    return Err(fail(format!("{count} elements without data; the file has {all} bytes of these")));
                }
                vec![[0.0; N]; count]
            }
        };
        if let Some(sparse) = accessor.sparse() {
            use ::gltf::accessor::sparse::IndexType;
            let n = sparse.count();
            let (indices, values) = (sparse.indices(), sparse.values());
            let kind = match indices.index_type() {
                IndexType::U8 => DataType::U8,
                IndexType::U16 => DataType::U16,
                IndexType::U32 => DataType::U32,
            };
            let width = kind.size();
            let indices = self.strided(&indices.view(), indices.offset(), n, width, width).map_err(fail)?;
            let values = self.strided(&values.view(), values.offset(), n, size, size).map_err(fail)?;
            for (index, value) in indices.zip(values) {
                let index = component(kind, index, false) as usize;
                let to =
                    out.get_mut(index).ok_or_else(|| fail(format!("a sparse value of element {index} of {count}")))?;
                *to = element(value);
            }
        }
        Ok(out)
    }

    /// Elements that lie in a view, each of `size` bytes.
    fn strided<'s>(
        &'s self,
        view: &::gltf::buffer::View,
        offset: usize,
        count: usize,
        size: usize,
        stride: usize,
    ) -> Result<impl Iterator<Item = &'s [u8]> + use<'s>, String> {
        let data = self.buffers.get(view.buffer().index()).map_or(&[][..], |data| &data.0);
        let range = view.offset().checked_add(view.length()).and_then(|end| data.get(view.offset()..end));
        let range = range.ok_or_else(|| format!("view {} lies outside its buffer", view.index()))?;
        let need = count.checked_sub(1).map_or(Some(0), |last| last.checked_mul(stride)?.checked_add(size));
        let part = need.and_then(|need| range.get(offset..offset.checked_add(need)?));
        let part =
            part.ok_or_else(|| format!("{count} elements do not fit view {} of {} bytes", view.index(), range.len()))?;
        Ok((0..count).map(move |i| &part[i * stride..][..size]))
    }

    fn attribute<const N: usize>(
        &self,
        primitive: &Primitive,
        of: Semantic,
        normalized: bool,
    ) -> Result<Option<Vec<[f64; N]>>> {
        primitive.get(&of).map(|accessor| self.values(&accessor, normalized)).transpose()
    }

    /// Three corners a triangle, of `n`; None where a primitive has none.
    fn triangles(&self, primitive: &Primitive, n: usize) -> Result<Option<Vec<[u32; 3]>>> {
        let indices: Vec<u32> = match primitive.indices() {
            Some(accessor) => self.values::<1>(&accessor, false)?.into_iter().map(|[i]| i as u32).collect(),
            None => (0..n as u32).collect(),
        };
        if let Some(i) = indices.iter().find(|&&i| i as usize >= n) {
            return Err(wrong(self.path, format!("an index {i} of {n} corners")));
        }
        Ok(match primitive.mode() {
            Mode::Triangles => Some(indices.as_chunks::<3>().0.to_vec()),
            Mode::TriangleStrip => Some(indices.windows(3).map(|t| [t[0], t[1], t[2]]).collect()),
            Mode::TriangleFan => Some(indices.windows(2).skip(1).map(|t| [indices[0], t[0], t[1]]).collect()),
            Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip => None,
        })
    }

    /// Matrices of the joints of a node's skin, each with what takes the mesh to the joint.
    fn joints(&self, node: &Node) -> Result<Option<Vec<Matrix>>> {
        let Some(skin) = node.skin() else { return Ok(None) };
        let inverse = skin.inverse_bind_matrices().map(|accessor| self.values::<16>(&accessor, false)).transpose()?;
        let joints = skin.joints().enumerate().map(|(i, joint)| {
            let global = &self.globals[joint.index()];
            match inverse.as_ref().map(|of| of.get(i)) {
                None => Ok(*global),
                Some(Some(m)) => {
                    Ok(product(global, &std::array::from_fn(|k| std::array::from_fn(|row| m[4 * k + row]))))
                }
                Some(None) => Err(wrong(self.path, format!("skin {}: fewer matrices than joints", skin.index()))),
            }
        });
        joints.collect::<Result<_>>().map(Some)
    }

    /// Where the instances of a node's mesh stand.
    fn instances(&self, node: &Node) -> Result<Vec<Matrix>> {
        let place = self.globals[node.index()];
        let Some(extension) = node.extension_value("EXT_mesh_gpu_instancing") else { return Ok(vec![place]) };
        let accessor = |name: &str| -> Result<Option<Accessor>> {
            let Some(i) = extension.get("attributes").and_then(|of| of.get(name)) else { return Ok(None) };
            let accessor = i.as_u64().and_then(|i| self.document.accessors().nth(usize::try_from(i).ok()?));
            let what =
                || wrong(self.path, format!("node {}: instances by accessor {i}, which is not there", node.index()));
            accessor.ok_or_else(what).map(Some)
        };
        let translation = accessor("TRANSLATION")?.map(|a| self.values::<3>(&a, false)).transpose()?;
        let rotation = accessor("ROTATION")?.map(|a| self.values::<4>(&a, true)).transpose()?;
        let scale = accessor("SCALE")?.map(|a| self.values::<3>(&a, false)).transpose()?;
        let counts =
            [translation.as_ref().map(Vec::len), rotation.as_ref().map(Vec::len), scale.as_ref().map(Vec::len)];
        let mut counts = counts.into_iter().flatten();
        let Some(n) = counts.next() else { return Ok(vec![place]) };
        if counts.any(|other| other != n) {
            return Err(wrong(
                self.path,
                format!("node {}: attributes of instances that differ in number", node.index()),
            ));
        }
        let own = |i: usize| {
            transform(
                translation.as_ref().map_or([0.0; 3], |of| of[i]),
                rotation.as_ref().map_or([0.0, 0.0, 0.0, 1.0], |of| of[i]),
                scale.as_ref().map_or([1.0; 3], |of| of[i]),
            )
        };
        Ok((0..n).map(|i| product(&place, &own(i))).collect())
    }
}

/// A number of a type, from its first bytes.
fn component(kind: DataType, bytes: &[u8], normalized: bool) -> f64 {
    let (value, most) = match kind {
        DataType::I8 => (f64::from(bytes[0] as i8), 127.0),
        DataType::U8 => (f64::from(bytes[0]), 255.0),
        DataType::I16 => (f64::from(i16::from_le_bytes([bytes[0], bytes[1]])), 32_767.0),
        DataType::U16 => (f64::from(u16::from_le_bytes([bytes[0], bytes[1]])), 65_535.0),
        DataType::U32 => return f64::from(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])),
        DataType::F32 => return f64::from(f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])),
    };
    if normalized { (value / most).max(-1.0) } else { value }
}

/// A scene on its way to a mesh.
struct Scene<'a> {
    reader: &'a Reader<'a>,
    mesh: Mesh,
    textures: Textures,
}

/// What of a scene is not drawn, counted.
#[derive(Default)]
struct Skipped {
    primitives: usize,
    hidden: usize,
    skinned_instances: usize,
    bare: usize,
}

impl Scene<'_> {
    fn draw(mut self) -> Result<Mesh> {
        let Reader { document, .. } = *self.reader;
        let scene = document.default_scene().or_else(|| document.scenes().next());
        let mut nodes: Vec<Node> = match &scene {
            Some(scene) => scene.nodes().collect(),
            // A library: everything.
            None => {
                let children = document.nodes().flat_map(|n| n.children().map(|c| c.index()));
                let children: std::collections::HashSet<usize> = children.collect();
                document.nodes().filter(|node| !children.contains(&node.index())).collect()
            }
        };
        let mut seen = vec![false; document.nodes().len()];
        let mut skipped = Skipped::default();
        while let Some(node) = nodes.pop() {
            if std::mem::replace(&mut seen[node.index()], true) {
                return Err(wrong(self.reader.path, format!("node {} stands in the scene twice", node.index())));
            }
            let visible = node.extension_value("KHR_node_visibility").and_then(|of| of.get("visible"));
            if visible.and_then(Value::as_bool) == Some(false) {
                skipped.hidden += 1;
                continue;
            }
            nodes.extend(node.children());
            self.draw_node(&node, &mut skipped)?;
        }
        self.say(&skipped, document);
        Ok(self.mesh.finish())
    }

    fn draw_node(&mut self, node: &Node, skipped: &mut Skipped) -> Result<()> {
        let Some(mesh) = node.mesh() else { return Ok(()) };
        let reader = self.reader;
        let joints = reader.joints(node)?;
        let instances = reader.instances(node)?;
        let weights = node.weights().or(mesh.weights()).unwrap_or_default();
        for primitive in mesh.primitives() {
            let Some(mut positions) = reader.attribute::<3>(&primitive, Semantic::Positions, false)? else {
                skipped.primitives += 1;
                continue;
            };
            let Some(triangles) = reader.triangles(&primitive, positions.len())? else {
                skipped.primitives += 1;
                continue;
            };
            for (target, &weight) in primitive.morph_targets().zip(weights).filter(|(_, weight)| **weight != 0.0) {
                let Some(accessor) = target.positions() else { continue };
                for (p, by) in positions.iter_mut().zip(reader.values::<3>(&accessor, false)?) {
                    *p = [0, 1, 2].map(|k| p[k] + f64::from(weight) * by[k]);
                }
            }
            let skinned = match &joints {
                Some(joints) => self.skin(&primitive, joints, &mut positions)?,
                None => false,
            };
            skipped.skinned_instances += usize::from(skinned && instances.len() > 1);
            // Where a skinned mesh stands is for its joints to say.
            let instances = if skinned { &[IDENTITY][..] } else { &instances[..] };
            let made = instances.len().checked_mul(positions.len().max(triangles.len()));
            let all = self.mesh.positions.len().max(self.mesh.triangles.len());
            if made.is_none_or(|made| all + made > MAX_CORNERS) {
                let what = format!(
                    "node {}: more than {MAX_CORNERS} corners or triangles; write fewer instances",
                    node.index()
                );
                return Err(Error::Limit(wrong(reader.path, what).to_string()));
            }
            self.push(&primitive, &positions, &triangles, instances, skipped)?;
        }
        Ok(())
    }

    /// Moves corners with their joints; false where they have none.
    fn skin(&self, primitive: &Primitive, joints: &[Matrix], positions: &mut [[f64; 3]]) -> Result<bool> {
        let mut pulls: Vec<(Matrix, f64)> = vec![([[0.0; 4]; 4], 0.0); positions.len()];
        let mut set = 0;
        while let Some(of) = self.reader.attribute::<4>(primitive, Semantic::Joints(set), false)? {
            let Some(weights) = self.reader.attribute::<4>(primitive, Semantic::Weights(set), true)? else { break };
            for ((pull, of), weights) in pulls.iter_mut().zip(of).zip(weights) {
                for (joint, weight) in of.into_iter().zip(weights).filter(|(_, weight)| *weight != 0.0) {
                    let Some(joint) = joints.get(joint as usize) else {
                        let what = format!("a corner moves with joint {joint} of {}", joints.len());
                        return Err(wrong(self.reader.path, what));
                    };
                    for (to, by) in pull.0.as_flattened_mut().iter_mut().zip(joint.as_flattened()) {
                        *to += weight * by;
                    }
                    pull.1 += weight;
                }
            }
            set += 1;
        }
        for (p, (matrix, sum)) in positions.iter_mut().zip(&pulls) {
            // Rounded weights need not have the sum 1.
            if *sum != 0.0 {
                *p = placed(matrix, *p).map(|v| v / sum);
            }
        }
        Ok(set > 0)
    }

    fn push(
        &mut self,
        primitive: &Primitive,
        positions: &[[f64; 3]],
        triangles: &[[u32; 3]],
        instances: &[Matrix],
        skipped: &mut Skipped,
    ) -> Result<()> {
        let n = positions.len();
        let material = primitive.material();
        let (factor, info) = match material.pbr_specular_glossiness() {
            Some(of) => (of.diffuse_factor(), of.diffuse_texture()),
            None => {
                let of = material.pbr_metallic_roughness();
                (of.base_color_factor(), of.base_color_texture())
            }
        };
        let factor = factor.map(f64::from);
        let colors = match primitive.get(&Semantic::Colors(0)) {
            Some(of) if of.dimensions().multiplicity() == 3 => {
                self.reader.values::<3>(&of, true)?.into_iter().map(|[r, g, b]| [r, g, b, 1.0]).collect()
            }
            Some(of) => self.reader.values::<4>(&of, true)?,
            None => Vec::new(),
        };
        let color = |i: usize| {
            let of = colors.get(i).copied().unwrap_or([1.0; 4]);
            [0, 1, 2, 3].map(|k| of[k] * factor[k])
        };
        let cutoff = (material.alpha_mode() == AlphaMode::Mask).then(|| material.alpha_cutoff().unwrap_or(0.5));
        let mut uvs: Vec<[f32; 2]> = Vec::new();
        let mut texture = None;
        if let Some(info) = info {
            let own = info.texture_transform();
            let set = own.as_ref().and_then(|own| own.tex_coord()).unwrap_or(info.tex_coord());
            match self.reader.attribute::<2>(primitive, Semantic::TexCoords(set), !self.reader.quantized)? {
                Some(of) => {
                    let (scale, turn, offset) =
                        own.map_or(([1.0; 2], 0.0, [0.0; 2]), |t| (t.scale(), t.rotation(), t.offset()));
                    let ([su, sv], [ou, ov]) = (scale.map(f64::from), offset.map(f64::from));
                    let (sin, cos) = f64::from(turn).sin_cos();
                    // Against the clock as one sees it, v being down: so the extension's examples and all that draw it have it, and
                    // not as its formula does.
                    uvs.extend(of.into_iter().take(n).map(|[u, v]| {
                        let (u, v) = (u * su, v * sv);
                        [(cos * u + sin * v + ou) as f32, (cos * v - sin * u + ov) as f32]
                    }));
                    uvs.resize(n, [0.0; 2]);
                    texture = self.texture(&info.texture(), cutoff.is_some());
                }
                None => skipped.bare += 1,
            }
        }
        let paint = match (texture, cutoff) {
            (None, None) => PLAIN,
            _ => self.mesh.paint(Paint { texture, cutoff }),
        };
        let mesh = &mut self.mesh;
        for place in instances {
            let base = mesh.positions.len();
            mesh.positions.extend(positions.iter().map(|&p| placed(place, p)));
            mesh.colors.extend((0..n).map(color).map(|[r, g, b, _]| [r, g, b].map(from_linear)));
            if cutoff.is_some() && (0..n).any(|i| color(i)[3] != 1.0) {
                mesh.alphas.resize(base, 1.0);
                mesh.alphas.extend((0..n).map(|i| color(i)[3] as f32));
            }
            let first = mesh.triangles.len();
            mesh.triangles.extend(triangles.iter().map(|t| t.map(|i| i + base as u32)));
            mesh.mark(first, None, paint);
            if !uvs.is_empty() {
                mesh.lay(base, uvs.iter().copied());
            }
        }
        Ok(())
    }

    /// Number of a texture's picture: in a buffer, in the text itself, or in a file beside the glTF.
    fn texture(&mut self, texture: &::gltf::Texture, holes: bool) -> Option<u32> {
        use ::gltf::texture::WrappingMode;
        let Reader { path, buffers, .. } = self.reader;
        let wrap = [texture.sampler().wrap_s(), texture.sampler().wrap_t()].map(|mode| match mode {
            WrappingMode::ClampToEdge => Wrap::Clamp,
            WrappingMode::MirroredRepeat => Wrap::Mirror,
            WrappingMode::Repeat => Wrap::Repeat,
        });
        let image = texture.source();
        let name =
            image.as_ref().map_or_else(|| format!("texture {}", texture.index()), |of| format!("image {}", of.index()));
        let fail = |what: String| wrong(path, format!("{name}: {what}"));
        let read = || match image.as_ref().map(::gltf::Image::source) {
            None => Err(fail("its picture is in a form of an extension; PNG and JPEG are read".to_owned())),
            Some(::gltf::image::Source::View { view, .. }) => {
                let bytes = buffers.get(view.buffer().index()).and_then(|buffer| {
                    let end = view.offset().checked_add(view.length())?;
                    buffer.0.get(view.offset()..end)
                });
                let bytes = bytes.ok_or_else(|| fail("lies outside its buffer".to_owned()))?;
                Texture::read(path, bytes, wrap, holes)
            }
            Some(::gltf::image::Source::Uri { uri, .. }) => {
                check_uri(path, uri)?;
                let bytes = Data::from_source(Source::Uri(uri), path.parent()).map_err(|e| fail(e.to_string()))?;
                Texture::read(path, &bytes.0, wrap, holes)
            }
        };
        self.textures.number(&mut self.mesh, name.clone(), wrap, holes, read)
    }

    fn say(&mut self, skipped: &Skipped, document: &Document) {
        let used = |of: &dyn Fn(&::gltf::Material) -> bool| document.materials().filter(of).count();
        let clear = used(&|m| m.alpha_mode() == AlphaMode::Blend);
        let glowing = used(&|m| m.emissive_factor().iter().any(|&v| v > 0.0));
        let mut say = |n: usize, what: &str| {
            if n > 0 {
                self.mesh.about.left_out.push(format!("{n} {what}"));
            }
        };
        say(skipped.primitives, "primitives that are no triangles");
        say(skipped.hidden, "nodes that are not visible, and what is below them");
        say(skipped.skinned_instances, "primitives with joints whose instances are drawn as one");
        say(skipped.bare, "pictures on primitives without texture coordinates");
        say(clear, "materials that light goes through (alphaMode BLEND) are solid");
        say(glowing, "materials give off light of their own");
        say(document.scenes().len().saturating_sub(1), "other scenes");
        say(document.animations().len(), "animations; the pose is that of rest");
        let silent = |name: &&str| READ.contains(name) || PACKED.contains(name);
        let names: Vec<&str> = document.extensions_used().filter(|name| !silent(name)).collect();
        if !names.is_empty() {
            let names = super::text::shown(names.join(", ").as_bytes());
            self.mesh.about.left_out.push(format!("what these extensions say: {names}"));
        }
    }
}

/// Refuses a file that a glTF at `path` names where that may have no end; what is no file is not looked at.
fn check_uri(path: &Path, uri: &str) -> Result<()> {
    let name = match uri.split_once(':') {
        Some(("file", name)) => name.strip_prefix("//").unwrap_or(name).to_owned(),
        Some(_) => return Ok(()),
        None => percent_decoded(uri),
    };
    super::check_regular(&path.parent().unwrap_or(Path::new("")).join(name))
}

/// A relative reference without its `%20` and the like.
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
