//! Heights in memory become a picture: `cargo run --example heights [OUT.png]`.

use planecast::film::tour::{self, View};
use planecast::{Device, Frame, Options, Renderer, Repeat, World};

fn draw() -> planecast::Result<Frame> {
    const N: u32 = 256;
    // Two round hills on a plain, voxels high.
    let hill = |x: f64, z: f64, wide: f64| (-(x * x + z * z) / (wide * wide)).exp();
    let height = |i: u32| {
        let (x, z) = (f64::from(i % N), f64::from(i / N));
        (4.0 + 50.0 * hill(x - 90.0, z - 120.0, 40.0) + 30.0 * hill(x - 180.0, z - 150.0, 30.0)) as u16
    };
    let heights: Vec<u16> = (0..N * N).map(height).collect();
    let world = World::from_heights([N, N], &heights)?;
    let view = View { fov: 60.0, size: [640, 400], repeat: Repeat::default() };
    let camera = tour::still(&world.scene, view).camera(view.size);
    Renderer::new(world, Device::Cpu)?.draw(&camera, &Options::default())
}

fn main() -> planecast::Result<()> {
    draw()?.save_png(std::env::args().nth(1).unwrap_or("heights.png".into()))
}

#[test]
fn the_hills_are_in_the_picture_and_higher_than_the_plain() {
    let frame = draw().unwrap();
    let seen: Vec<usize> = (0..640 * 400).filter(|&i| frame.depth[i].is_finite()).collect();
    // A terrain fills half of the picture and more; both hills stand above the farthest row of the plain.
    assert!(seen.len() > 640 * 400 / 4, "{}", seen.len());
    let first = |x: usize| (0..400).find(|y| frame.depth[y * 640 + x].is_finite());
    let tops: Vec<usize> = (0..640).filter_map(first).collect();
    assert!(tops.iter().max().unwrap() - tops.iter().min().unwrap() > 40, "{tops:?}");
}
