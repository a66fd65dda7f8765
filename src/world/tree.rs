//! The scene as a sparse tree of 64-bit masks: what rays are cast through, as a baseline for planes.
//!
//! A node has 4 × 4 × 4 children and a bit for each that is not empty; those stand one after the other. Each level of the
//! scene is a grid of roots, 256 of its voxels a side, three levels of nodes, and below them leaves, whose bits are voxels:
//!
//! ```text
//! root, node   | mask u64 | children u32 |   children: position of the first in `words`, or SOLID where all is solid
//! leaf         | mask u64 |                  64 voxels
//! bit          x + 4 z + 16 y, each 0 to 3
//! ```
//!
//! (Masks of 64 children with children in order of bits: as in several published voxel ray casters; the code is our own.)

use crate::error::{Error, Result};
use crate::world::tables::{Resident, ResidentLevel};
use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;

/// Log2 of the voxels a side of a root.
pub const ROOT_SHIFT: u32 = 8;

/// Instead of a position: the node is solid throughout.
pub const SOLID: u32 = u32::MAX;

/// Words of a root or node, and of a leaf.
pub const NODE_WORDS: u32 = 3;
pub const LEAF_WORDS: u32 = 2;

/// Where a level's roots stand: in rows of x, then z, then y.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct Roots {
    /// Position of the first.
    pub first: u32,
    pub across: u32,
    pub along: u32,
    pub _pad0: u32,
}

/// The trees of all levels.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Tree {
    pub words: Vec<u32>,
    pub levels: Vec<Roots>,
}

/// What one root leads to, positions counted from its own start.
struct Part {
    root: [u32; 3],
    words: Vec<u32>,
    /// Which words are positions.
    positions: Vec<u32>,
}

/// Leaves a side of a root, and in it.
const SIDE: usize = 1 << (ROOT_SHIFT - 2);

impl Tree {
    /// Of the voxels that `resident` draws. An error where 32 bits cannot tell the nodes apart.
    pub fn new(resident: &Resident) -> Result<Tree> {
        let mut tree = Tree::default();
        for level in &resident.levels {
            let [across, height, along] = [level.nx, level.top, level.nz].map(|n| n.div_ceil(1 << ROOT_SHIFT).max(1));
            let numbers: Vec<[u32; 3]> =
                (0..height).flat_map(|y| (0..along).flat_map(move |z| (0..across).map(move |x| [x, y, z]))).collect();
            let first = tree.words.len();
            tree.words.resize(first + NODE_WORDS as usize * numbers.len(), 0);
            tree.levels.push(Roots { first: first as u32, across, along, _pad0: 0 });
            // A few at a time: each has two megabytes of leaves while it is made.
            let some = 2 * rayon::current_num_threads();
            for (i, some) in numbers.chunks(some).enumerate().map(|(i, n)| (i * some, n)) {
                let parts: Vec<Part> =
                    some.par_iter().map_init(Leaves::new, |leaves, &at| Part::new(level, at, leaves)).collect();
                for (part, i) in parts.into_iter().zip(i..) {
                    let start = tree.words.len();
                    if (start + part.words.len()) as u64 >= u64::from(SOLID) {
                        return Err(Error::Limit("scene of more than 2³² words a tree: no rays are cast in it".into()));
                    }
                    let at = |position: u32| if position == SOLID { SOLID } else { position + start as u32 };
                    tree.words.extend(part.words);
                    for p in part.positions {
                        tree.words[start + p as usize] = at(tree.words[start + p as usize]);
                    }
                    let [low, high, children] = part.root;
                    let root = first + NODE_WORDS as usize * i;
                    tree.words[root..root + 3].copy_from_slice(&[low, high, at(children)]);
                }
            }
        }
        Ok(tree)
    }

    /// Bytes that it takes.
    pub fn bytes(&self) -> u64 {
        (size_of_val(&self.words[..]) + size_of_val(&self.levels[..])) as u64
    }
}

/// The leaves of one root while it is made.
struct Leaves {
    /// Leaves in columns of y, those in rows of x, those in z.
    masks: Vec<u64>,
    /// Of each 4 × 4 × 4 leaves, in the same order, whether one of them is not empty.
    some: Vec<bool>,
}

impl Leaves {
    fn new() -> Leaves {
        Leaves { masks: vec![0; SIDE * SIDE * SIDE], some: vec![false; (SIDE / 4).pow(3)] }
    }

    fn block([x, y, z]: [usize; 3]) -> usize {
        (z / 4 * (SIDE / 4) + x / 4) * (SIDE / 4) + y / 4
    }

    /// Only what was set costs time.
    fn clear(&mut self) {
        let n = SIDE / 4;
        for (block, some) in self.some.iter_mut().enumerate().filter(|(_, some)| **some) {
            *some = false;
            let [x, y, z] = [block / n % n, block % n, block / n / n].map(|v| 4 * v);
            for (z, x) in (z..z + 4).flat_map(|z| (x..x + 4).map(move |x| (z, x))) {
                self.masks[(z * SIDE + x) * SIDE + y..][..4].fill(0);
            }
        }
    }
}

impl Part {
    fn new(level: &ResidentLevel, [x, y, z]: [u32; 3], leaves: &mut Leaves) -> Part {
        let corner = [x, y, z].map(|n| n << ROOT_SHIFT);
        let end = |from: u32, n: u32| n.min(from + (1 << ROOT_SHIFT));
        let mut empty = true;
        for z in corner[2]..end(corner[2], level.nz) {
            for x in corner[0]..end(corner[0], level.nx) {
                let (dx, dz) = (x - corner[0], z - corner[2]);
                let column = (dz as usize / 4 * SIDE + dx as usize / 4) * SIDE;
                let bit = (dx & 3) + 4 * (dz & 3);
                for run in level.column((z * level.nx + x) as usize) {
                    let from = u32::from(run.first()).max(corner[1]);
                    let to = run.end().min(corner[1] + (1 << ROOT_SHIFT));
                    if from >= to {
                        continue;
                    }
                    empty = false;
                    let (from, to) = (from - corner[1], to - corner[1]);
                    for leaf in from / 4..to.div_ceil(4) {
                        let (low, high) = (from.max(4 * leaf) - 4 * leaf, to.min(4 * leaf + 4) - 4 * leaf);
                        let bits = (0x1_0001_0001_0001u64 << (16 * low)) & (u64::MAX >> (16 * (4 - high)));
                        leaves.masks[column + leaf as usize] |= bits << bit;
                        leaves.some[Leaves::block([dx as usize / 4, leaf as usize, dz as usize / 4])] = true;
                    }
                }
            }
        }
        let mut part = Part { root: [0; 3], words: Vec::new(), positions: Vec::new() };
        if !empty {
            part.root = part.node(leaves, [0; 3], SIDE);
            leaves.clear();
        }
        part
    }

    /// The node of the leaves from `[x, y, z]` on, `side` of them a side, after all that is below it.
    fn node(&mut self, leaves: &Leaves, [x, y, z]: [usize; 3], side: usize) -> [u32; 3] {
        let step = side / 4;
        let child = |bit: usize| [x + bit % 4 * step, y + bit / 16 * step, z + bit / 4 % 4 * step];
        if step == 1 {
            if !leaves.some[Leaves::block([x, y, z])] {
                return [0; 3];
            }
            let leaf = |[x, y, z]: [usize; 3]| leaves.masks[(z * SIDE + x) * SIDE + y];
            let masks: [u64; 64] = std::array::from_fn(|bit| leaf(child(bit)));
            let own = (0..64).filter(|&bit| masks[bit] != 0).fold(0u64, |own, bit| own | 1 << bit);
            if masks.iter().all(|&mask| mask == u64::MAX) {
                return [u32::MAX, u32::MAX, SOLID];
            }
            let at = self.words.len() as u32;
            self.words.extend(masks.iter().filter(|&&mask| mask != 0).flat_map(|&mask| halves(mask)));
            let [low, high] = halves(own);
            return [low, high, at];
        }
        let nodes: [[u32; 3]; 64] = std::array::from_fn(|bit| self.node(leaves, child(bit), step));
        if nodes.iter().all(|node| node[2] == SOLID) {
            return [u32::MAX, u32::MAX, SOLID];
        }
        let is_there = |node: &[u32; 3]| node[0] | node[1] != 0;
        let own = (0..64).filter(|&bit| is_there(&nodes[bit])).fold(0u64, |own, bit| own | 1 << bit);
        let at = self.words.len() as u32;
        for node in nodes.iter().filter(|node| is_there(node)) {
            self.positions.push(self.words.len() as u32 + 2);
            self.words.extend(node);
        }
        let [low, high] = halves(own);
        [low, high, at]
    }
}

fn halves(mask: u64) -> [u32; 2] {
    [mask as u32, (mask >> 32) as u32]
}

/// A mask of 64 children as a tree has it.
#[inline(always)]
fn mask_at(words: &[u32], at: u32) -> u64 {
    u64::from(words[at as usize]) | u64::from(words[at as usize + 1]) << 32
}

/// Where in a tree a cell is looked up: the nodes on the way that the last look-up came by.
pub struct Cursor<'a> {
    tree: &'a Tree,
    /// Position, mask and children of the root, and of the two nodes below it; of the leaf none.
    at: [u32; 4],
    mask: [u64; 4],
    children: [u32; 3],
}

/// What holds a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cell {
    Solid,
    /// An empty cube, its side a power of two: log2 of it. It begins at a multiple of its side.
    Empty(u32),
}

impl<'a> Cursor<'a> {
    pub fn new(tree: &'a Tree) -> Cursor<'a> {
        Cursor { tree, at: [u32::MAX; 4], mask: [0; 4], children: [0; 3] }
    }

    /// What holds a cell of the world of level `l`; `y` is below the level's top.
    #[inline(always)]
    pub fn find(&mut self, l: usize, [x, y, z]: [u32; 3]) -> Cell {
        let roots = &self.tree.levels[l];
        let number = ((y >> ROOT_SHIFT) * roots.along + (z >> ROOT_SHIFT)) * roots.across + (x >> ROOT_SHIFT);
        let mut at = roots.first + NODE_WORDS * number;
        for k in 0..4 {
            if at != self.at[k] {
                self.at[k] = at;
                self.mask[k] = mask_at(&self.tree.words, at);
                if k < 3 {
                    self.children[k] = self.tree.words[at as usize + 2];
                }
            }
            let shift = 6 - 2 * k as u32;
            let part = |v: u32| v >> shift & 3;
            let bit = part(x) + 4 * part(z) + 16 * part(y);
            let mask = self.mask[k];
            if mask >> bit & 1 == 0 {
                // Two cells a side of the node are often empty together, and all of a root.
                let octant = mask >> (bit & 0b10_1010) & 0x0033_0033;
                return Cell::Empty(shift + u32::from(octant == 0) + u32::from(mask == 0));
            }
            if k == 3 || self.children[k] == SOLID {
                return Cell::Solid;
            }
            let words = if k == 2 { LEAF_WORDS } else { NODE_WORDS };
            at = self.children[k] + words * (mask & ((1 << bit) - 1)).count_ones();
        }
        Cell::Solid
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::specialize::Features;
    use crate::testing::noise;
    use planecast_encoder::{BuildOptions, Colors, Columns, Input, build};

    /// Every cell is as the columns have it, and every empty cube is empty as far as the world reaches.
    #[test]
    fn trees_hold_the_voxels_of_the_columns() {
        type Solid = fn(u32, u32, u32) -> bool;
        let worlds: [(_, Solid); 3] = [
            ([300, 40, 9], |x, y, z| y < 7 + x / 64 || noise(x / 3, y / 2, z).is_multiple_of(9)),
            ([7, 700, 5], |x, y, z| (y / 80) % 2 == 0 || noise(x, y, z).is_multiple_of(50)),
            ([64, 64, 64], |_, y, _| y < 48),
        ];
        for (dims, solid) in worlds {
            let columns = Columns::from_fn(dims[0], dims[1], dims[2], solid);
            let input = Input { columns, colors: Colors::None, notes: Vec::new() };
            let scene = build(input, &BuildOptions::default()).unwrap();
            let resident = Resident::with(&scene, Features::ALL);
            let tree = Tree::new(&resident).unwrap();
            for (l, level) in resident.levels.iter().enumerate() {
                let of = |x: u32, y: u32, z: u32| {
                    level.column((z * level.nx + x) as usize).any(|r| (u32::from(r.first())..r.end()).contains(&y))
                };
                let mut cursor = Cursor::new(&tree);
                for k in 0..level.nx * level.top * level.nz {
                    let [x, y, z] = [k % level.nx, k / level.nx % level.top, k / level.nx / level.top];
                    match cursor.find(l, [x, y, z]) {
                        Cell::Solid => assert!(of(x, y, z), "{dims:?} level {l} {x} {y} {z}"),
                        Cell::Empty(shift) => {
                            let far = |v: u32, n: u32| {
                                [v >> shift << shift, ((v >> shift << shift) + (1 << shift) - 1).min(n - 1)]
                            };
                            for x in far(x, level.nx) {
                                for y in far(y, level.top) {
                                    for z in far(z, level.nz) {
                                        assert!(!of(x, y, z), "{dims:?} level {l} {x} {y} {z}, empty by {shift}");
                                    }
                                }
                            }
                            assert!(!of(x, y, z), "{dims:?} level {l} {x} {y} {z}");
                        }
                    }
                }
            }
            assert!(tree.words.len() < 64 * 64 * 64, "{} words", tree.words.len());
        }
    }
}
