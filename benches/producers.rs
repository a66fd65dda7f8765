//! Tiles of worlds without end, by one thread: `cargo bench --bench producers`.
//!
//! `noise/35` evaluates 35 octaves of gradient noise at every voxel of a box, without bounds; elements are voxels. The others make
//! tiles of level 0, each at another place; elements are tiles.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use planecast_encoder::TileKey;
use planecast_encoder::producer::octaves::Octaves;
use planecast_encoder::producer::{Cells, NAMES, SIDE, from_name};

fn noise(c: &mut Criterion) {
    let functions: Vec<Octaves> = (0..5).map(|seed| Octaves::new(seed, 3, 8, 2, 16, 128)).collect();
    let mut values = vec![0; 16 * 64 * 16];
    let mut group = c.benchmark_group("noise");
    group.throughput(Throughput::Elements(values.len() as u64));
    let mut at = 0;
    group.bench_function("35", |b| {
        b.iter(|| {
            at += 16;
            let cells = Cells { level: 0, from: [SIDE / 2 + at, 64, SIDE / 2], size: [16, 64, 16] };
            functions.iter().for_each(|octaves| octaves.fill(&cells, &mut values));
            values[0]
        });
    });
}

fn tiles(c: &mut Criterion) {
    let mut group = c.benchmark_group("tile");
    group.throughput(Throughput::Elements(1)).sample_size(10);
    let sponge = "menger?size=3^19";
    for name in NAMES.map(|name| format!("{name}?size=inf&seed=5")).iter().map(String::as_str).chain([sponge]) {
        let world = from_name(name).expect("the name is known").expect("it gives tiles");
        let middle = world.start().expect("it has a place to stand").map(|v| v / 256);
        let mut n = 0;
        group.bench_function(name.split('?').next().expect("a name"), |b| {
            b.iter(|| {
                n += 1;
                world.tile(TileKey { level: 0, x: middle[0] + n % 16, z: middle[2] + n / 16 % 16 })
            });
        });
    }
}

criterion_group!(producers, noise, tiles);
criterion_main!(producers);
