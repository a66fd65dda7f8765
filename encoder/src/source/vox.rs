//! MagicaVoxel models and scenes (`.vox`), z up.
//!
//! The crate `dot_vox` parses chunks; the scene graph is ours to walk, and so are the checks: `dot_vox` drops damaged
//! chunks without a word and forgets node numbers, so the chunks are walked once before.

use std::collections::HashMap;
use std::path::Path;

use dot_vox::{DotVoxData, SceneNode};
use rayon::prelude::*;

use super::{guarded, world_dims};
use crate::{Colors, ColumnsBuilder, Error, Input, Result, Run};

/// Largest side of a model that its one-byte coordinates can reach.
const MODEL_SIDE: u32 = 256;
/// Most nodes visited in a scene graph, whose groups may share children and so multiply.
const MAX_VISITS: usize = 1 << 20;
/// Most voxels of all instances together.
const MAX_VOXELS: u64 = 1 << 31;
/// Most columns: few bytes can place two voxels very far apart.
const MAX_COLUMNS: u64 = 1 << 26;

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

pub(super) fn read(path: &Path, bytes: &[u8]) -> Result<Input> {
    let ids = Chunks::walk(path, bytes)?;
    let data = guarded(path, "MagicaVoxel", || {
        dot_vox::load_bytes(bytes).map_err(|e| Error::format(path, format!("MagicaVoxel: {e}")))
    })?;
    for (what, found, expected) in [
        ("models", data.models.len(), ids.n_models),
        ("scene nodes", data.scenes.len(), ids.nodes.len()),
        ("layers", data.layers.len(), ids.layers.len()),
    ] {
        if found != expected {
            return Err(Error::format(path, format!("{expected} {what} are stored, {found} could be read")));
        }
    }
    let mut notes = Vec::new();
    let instances = if data.scenes.is_empty() {
        if data.models.len() > 1 {
            notes.push(format!(
                "{} models without a scene graph (frames of an animation): the first is read",
                data.models.len()
            ));
        }
        vec![Instance { model: 0, place: Transform::IDENTITY }]
    } else {
        Graph { path, data: &data, ids: &ids, notes: &mut notes }.instances()?
    };
    if instances.is_empty() || data.models.is_empty() {
        return Err(Error::format(path, "no visible model"));
    }
    if !data.scenes.is_empty() {
        notes.push(format!("{} models, {} visible instances", data.models.len(), instances.len()));
    }
    place(path, &data, &instances, notes)
}

/// What a walk over all chunks tells that `dot_vox` does not.
#[derive(Default)]
struct Chunks {
    n_models: usize,
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
        let mut size_seen = false;
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
                    size_seen = true;
                    let fits = content == 12
                        && (0..3).all(|i| word(here + 12 + 4 * i).is_some_and(|n| (1..=MODEL_SIDE).contains(&n)));
                    if !fits {
                        return fail(here + 12, format!("chunk SIZE must be three sizes of 1 to {MODEL_SIDE}"));
                    }
                    false
                }
                (b"XYZI", n) => {
                    if !size_seen || n.is_none_or(|n| u64::from(content) != 4 + 4 * u64::from(n)) {
                        return fail(
                            here + 12,
                            "chunk XYZI must follow SIZE and hold as many voxels as it says".to_owned(),
                        );
                    }
                    out.n_models += 1;
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
    notes: &'a mut Vec<String>,
}

impl Graph<'_> {
    fn instances(&mut self) -> Result<Vec<Instance>> {
        let fail = |what: String| Err(Error::format(self.path, what));
        let hidden = |a: &dot_vox::Dict| a.get("_hidden").is_some_and(|v| v == "1");
        let (mut n_hidden, mut n_moving) = (0usize, 0usize);
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
                    n_moving += usize::from(frames.len() > 1);
                    let frame = |key| frames.first().and_then(|f| f.attributes.get(key)).map(String::as_str);
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
                    n_moving += usize::from(models.len() > 1);
                    let Some(first) = models.iter().min_by_key(|m| m.frame_index().unwrap_or(0)) else { continue };
                    let model = first.model_id as usize;
                    if model >= self.data.models.len() {
                        return fail(format!(
                            "scene node {number} shows model {model}, the file has {}",
                            self.data.models.len()
                        ));
                    }
                    out.push(Instance { model, place: above });
                }
            }
        }
        if n_hidden > 0 {
            self.notes.push(format!("{n_hidden} hidden nodes are left out"));
        }
        if n_moving > 0 {
            self.notes.push(format!("{n_moving} animated nodes are shown at their first frame"));
        }
        Ok(out)
    }
}

/// All instances in one world, as large as their models' boxes together. Where two overlap, the later one shows.
fn place(path: &Path, data: &DotVoxData, instances: &[Instance], notes: Vec<String>) -> Result<Input> {
    let size = |i: &Instance| {
        let s = data.models[i.model].size;
        [i64::from(s.x), i64::from(s.y), i64::from(s.z)]
    };
    let (mut low, mut high) = ([i64::MAX; 3], [i64::MIN; 3]);
    let mut n_voxels = 0u64;
    for instance in instances {
        n_voxels += data.models[instance.model].voxels.len() as u64;
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
    let dims = world_dims(path, [x, z, y], "the models lie too far apart")?;
    if x * y > MAX_COLUMNS {
        return Err(Error::Limit(format!("{}: {x} × {y} columns, at most {MAX_COLUMNS} in a .vox", path.display())));
    }

    // Sorted keys: column, then y, then the colour, which the order of instances decides and the sort keeps.
    let mut keys = Vec::with_capacity(n_voxels as usize);
    for instance in instances {
        let [sx, sy, sz] = size(instance);
        for v in &data.models[instance.model].voxels {
            let p = [i64::from(v.x), i64::from(v.y), i64::from(v.z)];
            if p[0] >= sx || p[1] >= sy || p[2] >= sz {
                return Err(Error::format(
                    path,
                    format!("model {}: voxel {p:?} lies outside its size {sx} × {sy} × {sz}", instance.model),
                ));
            }
            let cell = instance.place.cell([p[0] - sx / 2, p[1] - sy / 2, p[2] - sz / 2]);
            let column = (high[1] - cell[1]) as u64 * x + (cell[0] - low[0]) as u64;
            keys.push(column << 24 | ((cell[2] - low[2]) as u64) << 8 | u64::from(v.i));
        }
    }
    keys.par_sort_by_key(|k| k >> 8);

    let mut columns = ColumnsBuilder::new(dims[0], dims[1], dims[2]);
    let mut offsets = Vec::with_capacity((x * y) as usize + 1);
    let mut entries = Vec::new();
    offsets.push(0u32);
    let mut rest = keys.as_slice();
    for column in 0..x * y {
        let (own, others) = rest.split_at(rest.partition_point(|k| k >> 24 <= column));
        rest = others;
        for (i, &key) in own.iter().enumerate() {
            if own.get(i + 1).is_some_and(|next| next >> 8 == key >> 8) {
                continue;
            }
            let y = (key >> 8) as u16;
            let Some(c) = data.palette.get(key as usize & 255) else {
                let (index, n) = (key & 255, data.palette.len());
                return Err(Error::format(path, format!("a voxel has colour {}, the palette has {n}", index + 1)));
            };
            columns.push_run(Run::new(y, y));
            entries.push((y, [c.r, c.g, c.b]));
        }
        columns.end_column();
        offsets.push(entries.len() as u32);
    }
    Ok(Input { columns: columns.finish(), colors: Colors::Voxel { offsets, entries }, notes })
}
