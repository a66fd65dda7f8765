//! What the level-0 geometry of a scene takes as a sparse voxel octree, as a directed acyclic graph of equal subtrees, and
//! as compressed occupancy: what column lists are compared with.
//!
//! `cargo bench --bench octree -- SCENE.pcast …`
//!
//! The world is padded with air to a cube of a power of two. A node is kept where its cube is neither all air nor all
//! solid; leaves are 2 × 2 × 2 voxels. Bytes: an octree's node is a child mask and a pointer, 8 B, a leaf its mask, 1 B; the
//! graph's (Kämpe, Sintorn & Assarsson 2013) a mask and a pointer a child that is a node, 4 B each, a leaf 1 B. An octree
//! without pointers takes one byte a node. Raw occupancy is one bit a voxel, x fastest.

use planecast_encoder::{Columns, PcastFile};
use std::collections::HashMap;
use std::io::Write;

/// Voxels a side of what is looked at at once: a word a column.
const CHUNK: u32 = 64;

const AIR: u32 = 0;
const SOLID: u32 = 1;

/// Nodes by content; ids from 2 on.
#[derive(Default)]
struct Graph {
    leaves: HashMap<u8, u32>,
    inner: HashMap<[u32; 8], u32>,
    ids: u32,
    /// Nodes of the tree: leaves, inner.
    tree: [u64; 2],
}

impl Graph {
    fn leaf(&mut self, mask: u8) -> u32 {
        match mask {
            0 => AIR,
            0xFF => SOLID,
            _ => {
                self.tree[0] += 1;
                let ids = &mut self.ids;
                *self.leaves.entry(mask).or_insert_with(|| {
                    *ids += 1;
                    *ids + 1
                })
            }
        }
    }

    fn node(&mut self, children: [u32; 8]) -> u32 {
        if children == [AIR; 8] || children == [SOLID; 8] {
            return children[0];
        }
        self.tree[1] += 1;
        let ids = &mut self.ids;
        *self.inner.entry(children).or_insert_with(|| {
            *ids += 1;
            *ids + 1
        })
    }

    /// The root of a cube of `n` nodes a side, given at `(z · n + y) · n + x`.
    fn reduce(&mut self, mut nodes: Vec<u32>, mut n: usize) -> u32 {
        while n > 1 {
            let half = n / 2;
            let mut next = Vec::with_capacity(half * half * half);
            for (z, y, x) in (0..half).flat_map(|z| (0..half).flat_map(move |y| (0..half).map(move |x| (z, y, x)))) {
                let child = |i: usize| nodes[((2 * z + (i >> 2)) * n + 2 * y + (i >> 1 & 1)) * n + 2 * x + (i & 1)];
                next.push(self.node(std::array::from_fn(child)));
            }
            (nodes, n) = (next, half);
        }
        nodes[0]
    }

    /// The root of the chunk whose lowest corner is given.
    fn chunk(&mut self, columns: &Columns, [x0, y0, z0]: [u32; 3]) -> u32 {
        let mut words = vec![0u64; (CHUNK * CHUNK) as usize];
        for z in 0..CHUNK.min(columns.nz().saturating_sub(z0)) {
            for x in 0..CHUNK.min(columns.nx().saturating_sub(x0)) {
                words[(z * CHUNK + x) as usize] = column_word(columns.column(x0 + x, z0 + z), y0);
            }
        }
        if words.iter().all(|&w| w == words[0]) && (words[0] == 0 || words[0] == !0) {
            return u32::from(words[0] != 0);
        }
        let n = (CHUNK / 2) as usize;
        let mut nodes = Vec::with_capacity(n * n * n);
        for (z, y, x) in (0..n).flat_map(|z| (0..n).flat_map(move |y| (0..n).map(move |x| (z, y, x)))) {
            let mut mask = 0;
            for i in 0..4 {
                let word = words[(2 * z + (i >> 1)) * CHUNK as usize + 2 * x + (i & 1)];
                mask |= ((word >> (2 * y) & 3) as u8) << (2 * i);
            }
            nodes.push(self.leaf(mask));
        }
        self.reduce(nodes, n)
    }
}

/// Which of the 64 voxels of a column from `y0` up are solid.
fn column_word(runs: &[planecast_encoder::Run], y0: u32) -> u64 {
    let mut word = 0;
    for run in runs {
        let (from, to) = (u32::from(run.first()).max(y0), run.end().min(y0 + CHUNK));
        if from < to {
            word |= (!0 >> (64 - (to - from))) << (from - y0);
        }
    }
    word
}

/// Bytes of the raw occupancy, gzipped (level 6) and zstd-compressed (level 3).
fn compressed(columns: &Columns) -> std::io::Result<[u64; 3]> {
    #[derive(Default)]
    struct Count(u64);
    impl Write for Count {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0 += bytes.len() as u64;
            Ok(bytes.len())
        }
        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }
    let [nx, ny, nz] = columns.dims();
    let mut gzip = flate2::write::GzEncoder::new(Count::default(), flate2::Compression::new(6));
    let mut zstd = zstd::Encoder::new(Count::default(), 3)?;
    let mut raw = 0;
    // A slice of constant z at a time.
    for z in 0..nz {
        let row = (nx as usize).div_ceil(8);
        let mut slice = vec![0u8; row * ny as usize];
        for x in 0..nx {
            for run in columns.column(x, z) {
                for y in u32::from(run.first())..run.end() {
                    slice[y as usize * row + x as usize / 8] |= 1 << (x % 8);
                }
            }
        }
        raw += slice.len() as u64;
        gzip.write_all(&slice)?;
        zstd.write_all(&slice)?;
    }
    Ok([raw, gzip.finish()?.0, zstd.finish()?.0])
}

fn measure(path: &str) -> Result<(), Box<dyn std::error::Error>> {
    let file = PcastFile::open(path)?;
    let info = planecast_encoder::inspect::info::info(&file)?;
    let scene = file.read_scene()?;
    let columns = &scene.levels[0].solid;
    let side = columns.dims().into_iter().max().unwrap_or(1).next_power_of_two().max(CHUNK);
    let n = side / CHUNK;
    let mut graph = Graph::default();
    let mut chunks = Vec::with_capacity((n * n * n) as usize);
    for (z, y, x) in (0..n).flat_map(|z| (0..n).flat_map(move |y| (0..n).map(move |x| (z, y, x)))) {
        chunks.push(graph.chunk(columns, [x * CHUNK, y * CHUNK, z * CHUNK]));
    }
    graph.reduce(chunks, n as usize);
    let surface = info.surface_voxels as f64;
    let line = |what: &str, nodes: u64, bytes: u64| {
        println!("  {what:28} {nodes:>12} {bytes:>14} {:>8.3}", bytes as f64 / surface);
    };
    println!("{path}: {:?}, {} voxels with an exposed face", columns.dims(), info.surface_voxels);
    println!("  {:28} {:>12} {:>14} {:>8}", "level-0 geometry as", "nodes, runs", "bytes", "B/voxel");
    let level = &info.per_level[0];
    line("column lists, with tables", info.runs, level.bytes.geometry + level.bytes.columns);
    let [leaves, inner] = graph.tree;
    line("octree, pointers", leaves + inner, leaves + 8 * inner);
    line("octree, no pointers", leaves + inner, leaves + inner);
    let pointers: u64 = graph.inner.keys().map(|c| c.iter().filter(|&&id| id > SOLID).count() as u64).sum();
    let (leaves, inner) = (graph.leaves.len() as u64, graph.inner.len() as u64);
    line("acyclic graph", leaves + inner, leaves + 4 * (inner + pointers));
    let [raw, gzip, zstd] = compressed(columns)?;
    line("occupancy, a bit a voxel", 0, raw);
    line("the same, gzip -6", 0, gzip);
    line("the same, zstd -3", 0, zstd);
    Ok(())
}

/// A checkerboard has every leaf, one of each, and a solid half none: what the counts must be.
fn check() {
    let count = |solid: fn(u32, u32, u32) -> bool| {
        let mut graph = Graph::default();
        graph.chunk(&Columns::from_fn(64, 64, 64, solid), [0; 3]);
        (graph.tree, graph.leaves.len(), graph.inner.len())
    };
    assert_eq!(count(|x, y, z| (x + y + z) % 2 == 0), ([32_768, 4681], 1, 5));
    assert_eq!(count(|x, _, _| x < 32), ([0, 1], 0, 1));
    assert_eq!(count(|x, y, z| (x, y, z) == (9, 5, 40)), ([1, 5], 1, 5));
}

fn main() {
    check();
    let names: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    if names.is_empty() {
        println!("nothing to measure: give scenes (.pcast)");
    }
    for name in names {
        if let Err(e) = measure(&name) {
            println!("{name}: {e}");
        }
    }
}
