//! MagicaVoxel models and scenes (`.vox`), z up.
//!
//! The crate `dot_vox` parses chunks; the scene graph is ours to walk, and so are the checks: `dot_vox` drops damaged
//! chunks without a word and forgets node numbers, so the chunks are walked once before. Voxels are read from the file itself:
//! colour 0 is "no voxel" (the palette has 1 to 255), which `dot_vox` makes colour 1.
//!
//! Of nodes that move or change, the frame with the least number is shown, of place and of model alike.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use dot_vox::{DotVoxData, SceneNode};

use super::spots::Spot;
use super::{cells, guarded};
use crate::model::about::Kind;
use crate::model::matter::{Class, Classes, Matter, MatterBuilder, Mode, STEPS};
use crate::model::pieces::InMemory;
use crate::{About, Error, Result};

/// Largest side of a model that its one-byte coordinates can reach.
const MODEL_SIDE: u32 = 256;
/// Most nodes visited in a scene graph, whose groups may share children and so multiply.
const MAX_VISITS: usize = 1 << 20;
/// Most voxels of all instances together.
const MAX_VOXELS: u64 = 1 << 31;

/// `x' = sign · x[axis] + t` on each axis: what scene graphs are made of.
#[derive(Clone, Copy, Debug)]
struct Transform {
    axis: [usize; 3],
    sign: [i64; 3],
    t: [i64; 3],
}

impl Transform {
    const IDENTITY: Transform = Transform { axis: [0, 1, 2], sign: [1; 3], t: [0; 3] };

    /// `child` first, then `self`.
    fn then(&self, child: &Transform) -> Transform {
        Transform {
            axis: self.axis.map(|a| child.axis[a]),
            sign: [0, 1, 2].map(|i| self.sign[i] * child.sign[self.axis[i]]),
            t: [0, 1, 2].map(|i| self.sign[i] * child.t[self.axis[i]] + self.t[i]),
        }
    }

    /// The cell that cell `[p, p+1)` goes to.
    fn cell(&self, p: [i64; 3]) -> [i64; 3] {
        [0, 1, 2].map(|i| {
            let v = p[self.axis[i]];
            self.t[i] + if self.sign[i] > 0 { v } else { -v - 1 }
        })
    }

    /// From the attributes of a frame: `_r` a rotation byte, `_t` three integers.
    fn parse(r: Option<&str>, t: Option<&str>) -> Option<Transform> {
        let mut out = Transform::IDENTITY;
        if let Some(r) = r {
            let byte: u8 = r.trim().parse().ok()?;
            let (a, b) = (usize::from(byte & 3), usize::from(byte >> 2 & 3));
            if a > 2 || b > 2 || a == b {
                return None;
            }
            out.axis = [a, b, 3 - a - b];
            out.sign = [4, 5, 6].map(|bit| if byte >> bit & 1 == 1 { -1 } else { 1 });
        }
        if let Some(t) = t {
            let t: Result<Vec<i32>, _> = t.split_whitespace().map(str::parse).collect();
            let t: [i32; 3] = t.ok()?.try_into().ok()?;
            out.t = t.map(i64::from);
        }
        Some(out)
    }
}

/// A model placed in the scene.
struct Instance {
    model: usize,
    /// From model cells, whose centre is `floor(size / 2)`, to the scene.
    place: Transform,
}

pub(super) fn read(path: &Path, bytes: &[u8]) -> Result<InMemory> {
    let ids = Chunks::walk(path, bytes)?;
    let data = guarded(path, "MagicaVoxel", || {
        dot_vox::load_bytes(bytes).map_err(|e| Error::format(path, format!("MagicaVoxel: {e}")))
    })?;
    for (what, found, expected) in [
        ("models", data.models.len(), ids.models.len()),
        ("scene nodes", data.scenes.len(), ids.nodes.len()),
        ("layers", data.layers.len(), ids.layers.len()),
    ] {
        if found != expected {
            return Err(Error::format(path, format!("{expected} {what} are stored, {found} could be read")));
        }
    }
    let format = format!("MagicaVoxel vox {}", data.version);
    let mut about = About { axes: "z is up".to_owned(), ..About::new(Kind::Model, format) };
    let instances = if data.scenes.is_empty() {
        if ids.models.len() > 1 {
            let n = ids.models.len() - 1;
            about
                .left_out
                .push(format!("{n} models after the first (frames of an animation: there is no scene graph)"));
        }
        vec![Instance { model: 0, place: Transform::IDENTITY }]
    } else {
        Graph { path, data: &data, ids: &ids, left_out: &mut about.left_out }.instances()?
    };
    if instances.is_empty() || ids.models.is_empty() {
        return Err(Error::format(path, "no visible model"));
    }
    about.rule = match data.scenes.is_empty() {
        true => "the first model".to_owned(),
        false => format!("{} models, {} visible instances", ids.models.len(), instances.len()),
    };
    place(path, bytes, &data, &ids, &instances, about)
}

/// What a walk over all chunks tells that `dot_vox` does not.
#[derive(Default)]
struct Chunks {
    /// Size of each model, and the bytes of its voxels: x, y, z, colour.
    models: Vec<([u32; 3], std::ops::Range<usize>)>,
    /// Position of a scene node in file order, by its number.
    nodes: HashMap<u32, usize>,
    /// The same for layers.
    layers: HashMap<u32, usize>,
}

impl Chunks {
    /// Proves that the chunks fill the file exactly and that nothing nests deeper than `dot_vox` should recurse.
    fn walk(path: &Path, bytes: &[u8]) -> Result<Chunks> {
        let fail = |at: usize, what: String| Err(Error::format(path, format!("byte {at}: {what}")));
        let word = |at: usize| bytes.get(at..at + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        if !bytes.starts_with(b"VOX ") {
            return fail(0, "expected \"VOX \"".to_owned());
        }
        let (Some(b"MAIN"), Some(content), Some(children)) = (bytes.get(8..12), word(12), word(16)) else {
            return fail(8, "expected the chunk MAIN".to_owned());
        };
        let mut at = 20 + u64::from(content);
        if at + u64::from(children) != bytes.len() as u64 {
            let end = at + u64::from(children);
            return fail(16, format!("chunk MAIN ends at byte {end}, the file has {} bytes", bytes.len()));
        }
        let mut out = Chunks::default();
        let mut size = None;
        while at < bytes.len() as u64 {
            let here = at as usize;
            let (Some(id), Some(content), Some(children)) = (bytes.get(here..here + 4), word(here + 4), word(here + 8))
            else {
                return fail(here, "the file ends inside a chunk header".to_owned());
            };
            let name = String::from_utf8_lossy(id);
            if !id.is_ascii() {
                return fail(here, format!("{name:?} is no chunk name"));
            }
            if children != 0 {
                return fail(here + 8, format!("chunk {name} has chunks inside; only MAIN may"));
            }
            at += 12 + u64::from(content);
            if at > bytes.len() as u64 {
                return fail(here + 4, format!("chunk {name} of {content} bytes reaches past the end of the file"));
            }
            let first = || word(here + 12).filter(|_| content >= 4);
            let repeated = match (id, first()) {
                (b"SIZE", _) => {
                    let side = |i: usize| word(here + 12 + 4 * i).filter(|n| (1..=MODEL_SIDE).contains(n));
                    size = (|| Some([side(0)?, side(1)?, side(2)?]))().filter(|_| content == 12);
                    if size.is_none() {
                        return fail(here + 12, format!("chunk SIZE must be three sizes of 1 to {MODEL_SIDE}"));
                    }
                    false
                }
                (b"XYZI", n) => {
                    let Some(size) = size.filter(|_| n.is_some_and(|n| u64::from(content) == 4 + 4 * u64::from(n)))
                    else {
                        let what = "chunk XYZI must follow SIZE and hold as many voxels as it says";
                        return fail(here + 12, what.to_owned());
                    };
                    out.models.push((size, here + 16..here + 12 + content as usize));
                    false
                }
                (b"nTRN" | b"nGRP" | b"nSHP", Some(n)) => out.nodes.insert(n, out.nodes.len()).is_some(),
                (b"LAYR", Some(n)) => out.layers.insert(n, out.layers.len()).is_some(),
                (b"nTRN" | b"nGRP" | b"nSHP" | b"LAYR", None) => {
                    return fail(here, format!("chunk {name} has no number"));
                }
                _ => false,
            };
            if repeated {
                return fail(here + 12, format!("chunk {name} repeats the number of another"));
            }
        }
        Ok(out)
    }
}

/// A walk of the scene graph.
struct Graph<'a> {
    path: &'a Path,
    data: &'a DotVoxData,
    ids: &'a Chunks,
    left_out: &'a mut Vec<String>,
}

impl Graph<'_> {
    fn instances(&mut self) -> Result<Vec<Instance>> {
        let fail = |what: String| Err(Error::format(self.path, what));
        let hidden = |a: &dot_vox::Dict| a.get("_hidden").is_some_and(|v| v == "1");
        let (mut n_hidden, mut n_moving, mut n_frames) = (0usize, 0usize, 0usize);
        let mut later = |n: usize| {
            n_moving += usize::from(n > 1);
            n_frames += n.saturating_sub(1);
        };
        let mut out = Vec::new();
        let mut visits = 0;
        // Number of the node, transform above it, depth. Node 0 is the root.
        let mut stack = vec![(0u32, Transform::IDENTITY, 0usize)];
        while let Some((number, above, depth)) = stack.pop() {
            visits += 1;
            if visits > MAX_VISITS {
                return Err(Error::Limit(format!(
                    "{}: the scene has more than {MAX_VISITS} nodes",
                    self.path.display()
                )));
            }
            if depth > self.data.scenes.len() {
                return fail(format!("scene node {number} is inside itself"));
            }
            let Some(&ix) = self.ids.nodes.get(&number) else {
                return fail(format!("scene node {number} is named but not stored"));
            };
            match &self.data.scenes[ix] {
                SceneNode::Transform { attributes, frames, child, layer_id } => {
                    let layer = self.ids.layers.get(layer_id).map(|&i| &self.data.layers[i]);
                    if hidden(attributes) || layer.is_some_and(|l| hidden(&l.attributes)) {
                        n_hidden += 1;
                        continue;
                    }
                    later(frames.len());
                    let first = frames.iter().min_by_key(|f| frame_number(&f.attributes));
                    let frame = |key| first.and_then(|f| f.attributes.get(key)).map(String::as_str);
                    let Some(own) = Transform::parse(frame("_r"), frame("_t")) else {
                        return fail(format!(
                            "scene node {number}: rotation {:?} or translation {:?} is malformed",
                            frame("_r"),
                            frame("_t")
                        ));
                    };
                    stack.push((*child, above.then(&own), depth + 1));
                }
                SceneNode::Group { attributes, children } => {
                    if hidden(attributes) {
                        n_hidden += 1;
                        continue;
                    }
                    stack.extend(children.iter().rev().map(|&c| (c, above, depth + 1)));
                }
                SceneNode::Shape { attributes, models } => {
                    if hidden(attributes) {
                        n_hidden += 1;
                        continue;
                    }
                    later(models.len());
                    let Some(first) = models.iter().min_by_key(|m| frame_number(&m.attributes)) else { continue };
                    let (model, n) = (first.model_id as usize, self.ids.models.len());
                    if model >= n {
                        return fail(format!("scene node {number} shows model {model}, the file has {n}"));
                    }
                    out.push(Instance { model, place: above });
                }
            }
        }
        if n_hidden > 0 {
            self.left_out.push(format!("{n_hidden} hidden nodes"));
        }
        if n_moving > 0 {
            self.left_out.push(format!("{n_frames} later frames of {n_moving} animated nodes"));
        }
        Ok(out)
    }
}

/// Number of a frame; one that does not say is the first.
fn frame_number(attributes: &dot_vox::Dict) -> i64 {
    attributes.get("_f").and_then(|f| f.trim().parse().ok()).unwrap_or(0)
}

/// All instances in one world, as large as their models' boxes together. Where two overlap, the later one shows.
fn place(
    path: &Path,
    bytes: &[u8],
    data: &DotVoxData,
    ids: &Chunks,
    instances: &[Instance],
    mut about: About,
) -> Result<InMemory> {
    let size = |i: &Instance| ids.models[i.model].0.map(i64::from);
    let (mut low, mut high) = ([i64::MAX; 3], [i64::MIN; 3]);
    let mut n_voxels = 0u64;
    for instance in instances {
        n_voxels += ids.models[instance.model].1.len() as u64 / 4;
        let size = size(instance);
        let corners = [size.map(|s| -(s / 2)), size.map(|s| s - 1 - s / 2)].map(|c| instance.place.cell(c));
        for i in 0..3 {
            low[i] = low[i].min(corners[0][i].min(corners[1][i]));
            high[i] = high[i].max(corners[0][i].max(corners[1][i]));
        }
    }
    if n_voxels > MAX_VOXELS {
        return Err(Error::Limit(format!(
            "{}: {n_voxels} voxels in all instances, at most {MAX_VOXELS}",
            path.display()
        )));
    }
    let [x, y, z] = [0, 1, 2].map(|i| (high[i] - low[i] + 1) as u64);
    let dims = cells::dims(path, [x, z, y])?;
    let mut spots = Vec::with_capacity(n_voxels as usize);
    let mut empty = 0u64;
    let mut clear = Clear::new(data);
    for instance in instances {
        let [sx, sy, sz] = size(instance);
        for v in bytes[ids.models[instance.model].1.clone()].as_chunks::<4>().0 {
            let p = [v[0], v[1], v[2]].map(i64::from);
            if p[0] >= sx || p[1] >= sy || p[2] >= sz {
                return Err(Error::format(
                    path,
                    format!("model {}: voxel {p:?} lies outside its size {sx} × {sy} × {sz}", instance.model),
                ));
            }
            let Some(index) = usize::from(v[3]).checked_sub(1) else {
                empty += 1;
                continue;
            };
            let Some(c) = data.palette.get(index) else {
                let n = data.palette.len();
                return Err(Error::format(path, format!("a voxel has colour {}, the palette has {n}", v[3])));
            };
            let cell = instance.place.cell([p[0] - sx / 2, p[1] - sy / 2, p[2] - sz / 2]);
            let column = (high[1] - cell[1]) as u32 * dims[0] + (cell[0] - low[0]) as u32;
            let (y, color) = ((cell[2] - low[2]) as u16, [c.r, c.g, c.b]);
            match clear.code(v[3], color) {
                Some(code) => clear.spots.push((column, y, code)),
                None => spots.push(Spot { column, y, color }),
            }
        }
    }
    if empty > 0 {
        about.left_out.push(format!("{empty} voxels of colour 0, which is none"));
    }
    let input = cells::input(dims, spots, Vec::new());
    if clear.spots.is_empty() {
        return Ok(InMemory::new(input).about(about));
    }
    let matter = clear.matter(dims);
    about.classes = Some(Arc::new(Classes { window: None, classes: clear.classes }));
    Ok(InMemory::new(input).about(about).matter(matter))
}

/// Voxels of glass and other clear materials.
struct Clear<'a> {
    data: &'a DotVoxData,
    /// By colour: the code of its material, once a voxel has it; 0 for what is solid.
    codes: [Option<u16>; 256],
    classes: Vec<Class>,
    /// Column, height and code.
    spots: Vec<(u32, u16, u16)>,
}

impl Clear<'_> {
    fn new(data: &DotVoxData) -> Clear<'_> {
        Clear { data, codes: [None; 256], classes: Vec::new(), spots: Vec::new() }
    }

    fn code(&mut self, index: u8, color: [u8; 3]) -> Option<u16> {
        let code = self.codes[usize::from(index)].unwrap_or_else(|| {
            let material = self.data.materials.iter().find(|m| m.id == u32::from(index));
            let class = material.and_then(|m| class(&m.properties, color));
            let code = class.map_or(0, |class| {
                self.classes.push(class);
                self.classes.len() as u16 * STEPS
            });
            self.codes[usize::from(index)] = Some(code);
            code
        });
        (code > 0).then_some(code)
    }

    /// Of several at a place the last shows.
    fn matter(&mut self, [nx, ny, nz]: [u32; 3]) -> Matter {
        self.spots.sort_by_key(|&(column, y, _)| (column, y));
        let mut out = MatterBuilder::new(nx, ny, nz);
        let mut spots = self.spots.iter().peekable();
        for column in 0..nx * nz {
            let mut at = 0;
            while let Some(&(_, y, code)) = spots.next_if(|s| s.0 == column) {
                if spots.peek().is_some_and(|next| (next.0, next.1) == (column, y)) {
                    continue;
                }
                out.push(u32::from(y) - at, 0);
                out.push(1, code);
                at = u32::from(y) + 1;
            }
            out.end_column();
        }
        out.finish()
    }
}

/// What a material is, where light passes through it. Properties are as the editor writes them: `_trans` is how clear glass is,
/// `_d` how dense a medium.
fn class(properties: &dot_vox::Dict, color: [u8; 3]) -> Option<Class> {
    let number = |key: &str| properties.get(key).and_then(|v| v.trim().parse::<f64>().ok()).filter(|v| v.is_finite());
    let share = |v: f64| v.clamp(0.0, 1.0);
    match properties.get("_type").map(String::as_str)? {
        "_glass" | "_blend" => {
            let clear = share(number("_trans").or(number("_alpha")).unwrap_or(0.5));
            (clear > 0.0).then_some(Class { color, opacity: 1.0 - clear, mode: Mode::Surface })
        }
        "_media" | "_cloud" => {
            let shines = properties.get("_media_type").is_some_and(|kind| kind == "_emit");
            let mode = if shines { Mode::Emissive } else { Mode::Volumetric };
            Some(Class { color, opacity: share(number("_d").unwrap_or(0.05)), mode })
        }
        _ => None,
    }
}
