//! A flight as numbered pictures, with the depth of each pixel at hand: `cargo run --example flight -- INPUT [FOLDER]`.

use planecast::film::tour::{self, View};
use planecast::{Device, Options, Renderer, Repeat, World};

fn main() -> planecast::Result<()> {
    let input = std::env::args().nth(1).unwrap_or("procedural:terrain?size=256".into());
    let folder = std::env::args().nth(2).unwrap_or(".".into());
    let world = World::open(&input)?;
    let view = View { fov: 60.0, size: [320, 200], repeat: Repeat::default() };
    let path = tour::tour(&world.scene, view);
    let mut renderer = Renderer::new(world, Device::Cpu)?;
    for (i, pose) in path.poses(24).iter().enumerate() {
        let frame = renderer.draw(&pose.camera(view.size), &Options::default())?;
        let nearest = frame.depth.iter().copied().fold(f32::INFINITY, f32::min);
        println!("frame {i}: the nearest voxel is {nearest:.1} voxels away");
        frame.save_png(format!("{folder}/{i:06}.png"))?;
    }
    Ok(())
}
