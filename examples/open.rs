//! Opens anything that `encode` reads and draws it from its south: `cargo run --example open -- INPUT [OUT.png]`.

use planecast::{Camera, Device, Options, Renderer, World};

fn main() -> planecast::Result<()> {
    let input = std::env::args().nth(1).unwrap_or("procedural:rocks?size=128".into());
    let world = World::open(&input)?;
    println!("{input}: {:?} voxels; {}", world.dims(), world.about);
    let [x, y, z] = world.dims().map(f64::from);
    // Half as high again as the world, and its length away, looking down on it.
    let camera = Camera {
        eye: [x / 2.0, 1.5 * y, 2.0 * z].into(),
        pitch: -(y / z).atan().to_degrees(),
        width: 640,
        height: 400,
        ..Camera::default()
    };
    let mut renderer = Renderer::new(world, Device::Auto)?;
    let frame = renderer.draw(&camera, &Options::default())?;
    renderer.notices().iter().for_each(|notice| println!("{notice}"));
    frame.save_png(std::env::args().nth(2).unwrap_or("open.png".into()))
}
