//! Times the march of roxlap's wgpu renderer over a .vxl map at poses that planecast's bench wrote, with and without levels.
//!
//! Its headless renderer takes no timestamps and returns a picture on the host: a call makes small buffers, dispatches the
//! march, copies and maps. So a pose's time is that of a whole call, the median of several, less that of a view that misses
//! the map; both are printed.

use anyhow::{Context, Result, ensure};
use roxlap_formats::vxl::{Vxl, slng};
use roxlap_gpu::{
    Camera, GpuRendererSettings, GpuSceneResident, GridUpload, HeadlessGpu, HeadlessSceneRenderer, SceneUpload,
    decompress_chunk,
};
use serde::Deserialize;
use std::path::Path;
use std::time::Instant;

/// Columns a side of a chunk.
const CHUNK: usize = 128;
/// Chunks that a ray may cross.
const OUTER_STEPS: u32 = 64;
const ROUNDS: usize = 9;

/// As `gpu --poses` writes them: planecast's axes (y up), angles in degrees.
#[derive(Deserialize)]
struct Poses {
    width: u32,
    height: u32,
    /// Voxels from the map's bottom to its top.
    depth: f64,
    poses: Vec<Pose>,
}

#[derive(Deserialize)]
struct Pose {
    eye: [f64; 3],
    forward: [f64; 3],
    right: [f64; 3],
    up: [f64; 3],
    /// Vertical.
    fov: f64,
}

impl Pose {
    /// In Voxlap's axes: x, y across, z down.
    fn camera(&self, depth: f64) -> Camera {
        let turn = |v: [f64; 3]| [v[0] as f32, v[2] as f32, -v[1] as f32];
        let [x, y, z] = self.eye;
        Camera {
            position: [x as f32, z as f32, (depth - y) as f32],
            right: turn(self.right),
            down: turn(self.up.map(|v| -v)),
            forward: turn(self.forward),
            fov_y_rad: self.fov.to_radians() as f32,
        }
    }
}

/// Cuts a map, with Voxlap's header or without (Ace of Spades: 512 columns a side), into chunks.
fn chunks(bytes: &[u8]) -> Result<GridUpload> {
    let word = |at: usize| bytes.get(at..at + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize);
    let (side, mut at) = match word(0) {
        Some(0x0907_2000) => (word(4).context("the map ends in its header")?, 0x6c),
        _ => (512, 0),
    };
    ensure!(side % CHUNK == 0, "{side} columns a side are no multiple of {CHUNK}");
    let n = side / CHUNK;
    let mut data = vec![Vec::new(); n * n];
    let mut offsets = vec![vec![0u32]; n * n];
    for y in 0..side {
        for x in 0..side {
            let column = bytes.get(at..).filter(|rest| rest.len() >= 4).context("the map ends within its columns")?;
            let len = slng(column);
            let chunk = y / CHUNK * n + x / CHUNK;
            data[chunk].extend_from_slice(column.get(..len).context("the map ends within a column")?);
            offsets[chunk].push(data[chunk].len() as u32);
            at += len;
        }
    }
    let chunk = |(i, (data, offsets)): (usize, (Vec<u8>, Vec<u32>))| {
        let end = offsets.len();
        let map = Vxl {
            vsid: CHUNK as u32,
            ipo: [0.0; 3],
            ist: [1.0, 0.0, 0.0],
            ihe: [0.0, 0.0, 1.0],
            ifo: [0.0, 1.0, 0.0],
            data: data.into(),
            column_offset: offsets.into(),
            mip_base_offsets: Box::new([0, end]),
            vbit: Box::new([]),
            vbiti: 0,
        };
        ([(i % n) as i32, (i / n) as i32, 0], decompress_chunk(&map))
    };
    let dims = [n as u32, n as u32, 1];
    Ok(GridUpload {
        vsid: CHUNK as u32,
        origin_chunk: [0; 3],
        chunks_dims: dims,
        pool_dims: GridUpload::default_pool_dims(dims),
        chunks: data.into_iter().zip(offsets).enumerate().map(chunk).collect(),
    })
}

fn median(mut v: Vec<f64>) -> f64 {
    v.sort_by(f64::total_cmp);
    v[v.len() / 2]
}

fn write_png(path: &Path, width: u32, height: u32, pixels: &[u32]) -> Result<()> {
    let mut encoder = png::Encoder::new(std::fs::File::create(path)?, width, height);
    encoder.set_color(png::ColorType::Rgb);
    let rgb: Vec<u8> = pixels.iter().flat_map(|p| p.to_le_bytes().into_iter().take(3)).collect();
    encoder.write_header()?.write_image_data(&rgb)?;
    Ok(())
}

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [map, poses, rest @ ..] = &arguments[..] else { anyhow::bail!("usage: peer-roxlap MAP.vxl POSES.json [PICTURES]") };
    let poses: Poses = serde_json::from_slice(&std::fs::read(poses)?)?;
    let (width, height) = (poses.width, poses.height);
    let gpu = HeadlessGpu::new_blocking(GpuRendererSettings::default())?;
    let upload = SceneUpload { grids: vec![chunks(&std::fs::read(map)?)?] };
    let scene = GpuSceneResident::upload(&gpu.device, &upload);
    println!("{map}: {}, {width} × {height}, scene {} MiB", gpu.adapter_info, scene.resident_bytes() >> 20);
    let renderer = HeadlessSceneRenderer::new(&gpu.device, &gpu.queue, width, height);
    for levels_from in [64.0, 0.0] {
        let render = |c: Camera| {
            renderer.render(&gpu.device, &gpu.queue, &scene, &[c], c.fov_y_rad, OUTER_STEPS, levels_from)
        };
        let time = |c: Camera| {
            let round = |_| {
                let start = Instant::now();
                let _ = render(c);
                start.elapsed().as_secs_f64() * 1e3
            };
            median((0..ROUNDS).map(round).collect())
        };
        let cameras: Vec<Camera> = poses.poses.iter().map(|p| p.camera(poses.depth)).collect();
        // Behind the map's edge, looking away from it.
        let away = Camera {
            position: [-1000.0, -1000.0, 0.0],
            forward: [0.0, -1.0, 0.0],
            right: [-1.0, 0.0, 0.0],
            down: [0.0, 0.0, 1.0],
            fov_y_rad: cameras[0].fov_y_rad,
        };
        for &camera in cameras.iter().cycle().take(100) {
            let _ = render(camera);
        }
        let floor = time(away);
        let times: Vec<f64> = cameras.iter().map(|&c| time(c)).collect();
        let least = times.iter().copied().fold(f64::MAX, f64::min) - floor;
        let most = times.iter().copied().fold(0.0, f64::max) - floor;
        let march = median(times) - floor;
        let levels = if levels_from > 0.0 { format!("levels from {levels_from}") } else { "no levels".into() };
        println!("  {levels}: march {march:.3} ({least:.3}–{most:.3}) ms, a call that misses the map {floor:.3} ms");
        if let [folder] = rest {
            for i in [0, 11, 37] {
                let file = format!("roxlap_{}_{i}.png", Path::new(map).file_stem().unwrap_or_default().display());
                write_png(&Path::new(folder).join(file), width, height, &render(cameras[i]))?;
            }
        }
    }
    Ok(())
}
