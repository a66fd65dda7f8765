//! Many cameras, whole spheres, scans and views that turn at rest.
//!
//! `cargo bench --bench cameras -- [SCENE] [--gpu] [--many N] [--only many,turn,lidar,sphere]`. `SCENE` is a `.pcast`, an input or
//! `procedural:…` (the default: a terrain of 1,024 columns a side). What is compared is measured in turn, five rounds, and the
//! median counts; beside it stand the least and the greatest. Nothing is written.

use std::time::Instant;

use glam::DVec3;
use planecast::{Camera, CpuRenderer, Device, Options, Outputs, Projection, Renderer, Shading, World};

const ROUNDS: usize = 5;

fn spread(mut v: Vec<f64>) -> [f64; 3] {
    v.sort_by(f64::total_cmp);
    [v[v.len() / 2], v[0], v[v.len() - 1]]
}

fn ms(work: impl FnOnce()) -> f64 {
    let at = Instant::now();
    work();
    at.elapsed().as_secs_f64() * 1e3
}

/// Places over the scene, each by itself.
fn places(world: &World, n: usize, above: f64) -> Vec<DVec3> {
    let [nx, _, nz] = world.dims().map(f64::from);
    let place = |i: usize| {
        let (x, z) = ((i as f64 * 0.618_034).fract() * nx, (i as f64 * 0.754_877_7).fract() * nz);
        let top = world.scene.levels[0].solid.column(x as u32, z as u32).last().map_or(0, |r| r.end());
        DVec3::new(x, f64::from(top) + above, z)
    };
    (0..n).map(place).collect()
}

fn main() {
    let (mut scene, mut device, mut n) = ("procedural:terrain?size=1024&seed=1".to_owned(), Device::Cpu, 256);
    let mut only = "many,turn,lidar,sphere".to_owned();
    let mut rest = std::env::args().skip(1).filter(|a| a != "--bench");
    while let Some(arg) = rest.next() {
        match arg.as_str() {
            "--gpu" => device = Device::Gpu,
            "--many" => n = rest.next().and_then(|v| v.parse().ok()).expect("--many: expected a number"),
            "--only" => only = rest.next().expect("--only: expected parts"),
            _ => scene = arg,
        }
    }
    let world = World::open(&scene).expect("the scene opens");
    let plain = Options { shading: Shading::None, ..Options::default() };
    println!("{scene}, {:?}, {} threads", device, rayon::current_num_threads());

    if only.contains("many") {
        let mut renderer = Renderer::new(world.clone(), device).expect("the device opens");
        renderer.set_count(false);
        let camera = |(i, eye): (usize, DVec3)| Camera {
            eye,
            yaw: 37.0 * i as f64,
            pitch: -15.0,
            width: 256,
            height: 256,
            ..Camera::default()
        };
        let cameras: Vec<Camera> = places(&world, n, 12.0).into_iter().enumerate().map(camera).collect();
        let (mut alone, mut together) = (Vec::new(), Vec::new());
        for _ in 0..=ROUNDS {
            alone.push(ms(|| cameras.iter().for_each(|c| drop(renderer.draw(c, &plain).unwrap()))) / n as f64);
            together.push(
                ms(|| renderer.draw_each(&cameras, &plain, Outputs::default(), &|_, frame| Ok(Some(frame))).unwrap())
                    / n as f64,
            );
        }
        // The first round touches memory.
        let (alone, together) = (spread(alone.split_off(1)), spread(together.split_off(1)));
        println!(
            "{n} depth maps of 256 x 256, ms each: one by one {alone:.3?}, together {together:.3?}, {:.2} x",
            alone[0] / together[0]
        );
    }
    if only.contains("turn") {
        for (size, options) in [([1024, 768], plain), ([1920, 1080], Options::default())] {
            let eye = places(&world, 7, 15.0)[6];
            let at = |turn: usize| Camera {
                eye,
                yaw: 30.0 + turn as f64,
                pitch: -10.0,
                width: size[0],
                height: size[1],
                ..Camera::default()
            };
            let (mut direct, mut turned) = ([const { Vec::new() }; 4], [const { Vec::new() }; 4]);
            let mut usual = CpuRenderer::new(&world.scene, &world.resident);
            let mut resting = CpuRenderer::new(&world.scene, &world.resident);
            resting.keep_sphere(true);
            for turn in 0..3 + 10 {
                for (cpu, times) in [(&mut usual, &mut direct), (&mut resting, &mut turned)] {
                    let frame = cpu.render(&at(turn), &options, Outputs::default()).unwrap();
                    let t = frame.stats.cpu_ms.unwrap();
                    if turn >= 3 {
                        times.iter_mut().zip([t.traverse, t.remap, t.shade, t.total]).for_each(|(v, t)| v.push(t));
                    }
                    cpu.reuse(Some(frame));
                }
            }
            for (name, times) in [("drawn anew", direct), ("turned by 1 degree at rest", turned)] {
                let [traverse, remap, shade, total] = times.map(spread);
                println!(
                    "{size:?} {name}: traverse {traverse:.2?}, remap {remap:.2?}, shade {shade:.2?}, total {total:.2?} ms"
                );
            }
        }
    }
    if only.contains("lidar") {
        let mut cpu = CpuRenderer::new(&world.scene, &world.resident);
        let options = Options { projection: Projection::Lidar { channels: 128, steps: 2048 }, ..plain };
        let mut times = Vec::new();
        for eye in places(&world, 60, 3.0) {
            let camera = Camera { eye, fov: 45.0, width: 2048, height: 128, ..Camera::default() };
            times.push(ms(|| {
                let frame = cpu.render(&camera, &options, Outputs::default()).unwrap();
                cpu.reuse(Some(frame));
            }));
        }
        let times = spread(times.split_off(5));
        println!("lidar 128 x 2048, a new place each: {times:.2?} ms, {:.1} scans/s", 1e3 / times[0]);
    }
    if only.contains("sphere") {
        let mut times = [const { Vec::new() }; 4];
        let mut cpu = CpuRenderer::new(&world.scene, &world.resident);
        for eye in places(&world, 1 + ROUNDS, 15.0) {
            let camera = Camera { eye, width: 8192, height: 4096, ..Camera::default() };
            let options = Options { projection: Projection::Equirect, ..Options::default() };
            let frame = cpu.render(&camera, &options, Outputs::default()).unwrap();
            let t = frame.stats.cpu_ms.unwrap();
            times.iter_mut().zip([t.traverse, t.remap, t.shade, t.total]).for_each(|(v, t)| v.push(t));
            cpu.reuse(Some(frame));
        }
        let [traverse, remap, shade, total] = times.map(|mut v| spread(v.split_off(1)));
        println!(
            "equirect 8192 x 4096, shaded: traverse {traverse:.0?}, remap {remap:.0?}, shade {shade:.0?}, total {total:.0?} ms"
        );
    }
}
