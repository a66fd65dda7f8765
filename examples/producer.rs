//! A function becomes a world without end: `cargo run --example producer [OUT.png]`. Only the tiles in sight are made.

use std::sync::Arc;

use planecast::encoder::producer::octaves::Octaves;
use planecast::encoder::producer::{Density, Interval, Part, Producer, SIDE};
use planecast::encoder::{ColorMode, Rgb};
use planecast::world::pager::Patience;
use planecast::{Camera, Device, Frame, Options, Renderer};

/// Noisy dunes, in bands of colour by height.
struct Dunes(Octaves);

/// A height in half voxels, in 4,096ths of a voxel.
fn fixed(y: u32) -> i32 {
    (y.min(1 << 17) << 11) as i32
}

impl Density for Dunes {
    fn height(&self) -> u32 {
        256
    }

    fn value(&self, [x, y, z]: [u32; 3], level: u32) -> i32 {
        (90 << 12) + self.0.at2([x, z], level) - fixed(y)
    }

    // What lets tiles of nothing but air or ground be known without making them.
    fn bounds(&self, part: &Part) -> Interval {
        let Interval { least, most } = self.0.bounds(part);
        Interval { least: (90 << 12) + least - fixed(part.to[1]), most: (90 << 12) + most - fixed(part.from[1]) }
    }

    fn color_mode(&self) -> ColorMode {
        ColorMode::Run
    }

    fn color(&self, spot: &planecast::encoder::producer::Spot) -> Rgb {
        if (spot.at[1] / 24).is_multiple_of(2) { [214, 178, 120] } else { [190, 142, 92] }
    }
}

fn draw() -> planecast::Result<Frame> {
    let world = Producer::new("dunes", Dunes(Octaves::new(1, 2, 9, 3, 40 << 4, 128)));
    let mut tell = |what: &str| println!("{what}");
    let mut renderer = Renderer::of_tiles(Arc::new(world), Device::Cpu, 256 << 20, Patience::Wait, None, &mut tell)?;
    let middle = f64::from(SIDE / 2);
    let camera = Camera {
        eye: [middle, 190.0, middle].into(),
        yaw: 30.0,
        pitch: -12.0,
        width: 640,
        height: 400,
        ..Camera::default()
    };
    renderer.draw(&camera, &Options { view_distance: 4000.0, ..Options::default() })
}

fn main() -> planecast::Result<()> {
    draw()?.save_png(std::env::args().nth(1).unwrap_or("producer.png".into()))
}

#[test]
fn the_dunes_fill_the_lower_part_of_the_picture_and_no_tile_is_missing() {
    let frame = draw().unwrap();
    let (sky, ground) = frame.depth.split_at(640 * 20);
    assert!(sky.iter().all(|z| z.is_infinite()));
    assert!(ground[640 * 180..].iter().all(|z| z.is_finite()), "holes in the ground");
    assert_eq!((frame.stats.paging.tiles_missing, frame.stats.paging.debt), (0, 0));
}
