//! Worlds at another threshold of a volume in memory, as a slider in the window makes them: columns, levels, colours and the tables
//! that are drawn from.
//!
//! `cargo bench --bench live`. Groups are `threshold/SIDE`: the whole volume, its halves and quarters. Not measured: drawing.

use std::path::Path;
use std::sync::Arc;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use planecast::view::live;
use planecast_encoder::model::grid::{Grid, Tints};

/// Shells of noise about the middle, as a head has them.
fn head(n: u32) -> Arc<Grid> {
    let value = |i: u32| {
        let [y, x, z] = [i % n, i / n % n, i / n / n].map(|v| f64::from(v) / f64::from(n) - 0.5);
        let r = (x * x + y * y + z * z).sqrt();
        let folds = (40.0 * x).sin() * (38.0 * y).sin() * (42.0 * z).sin();
        (200.0 * (0.5 - r).max(0.0) + 25.0 * folds * (0.5 - r).max(0.0).sqrt()) as f32
    };
    Arc::new(Grid::new([n; 3], (0..n * n * n).map(value).collect(), Tints::Share(Arc::new(|t| [(t * 255.0) as u8; 3]))))
}

fn threshold(c: &mut Criterion) {
    let levels = live::levels(head(256));
    let mut group = c.benchmark_group("threshold");
    group.sample_size(20);
    for grid in &levels {
        group.throughput(Throughput::Elements(grid.dims().iter().map(|&n| u64::from(n)).product()));
        group.bench_with_input(BenchmarkId::from_parameter(grid.dims()[0]), grid, |b, grid| {
            let mut at = 20.0;
            b.iter(|| {
                at = 20.0 + (at - 20.0 + 1.7) % 40.0;
                live::world(Path::new("head"), grid, at).expect("a world")
            });
        });
    }
    group.finish();
}

criterion_group!(benches, threshold);
criterion_main!(benches);
