//! A picture that stays on the GPU, in the device of another program that uses wgpu: `cargo run --example share`.

use planecast::gpu::present::Device;
use planecast::{Camera, GpuOptions, GpuRenderer, Options, World};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // The other program's device; planecast says what it wishes of one.
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle_from_env());
    let adapter = pollster::block_on(instance.request_adapter(&wgpu::RequestAdapterOptions::default()))?;
    let (device, queue) = pollster::block_on(adapter.request_device(&Device::wishes(&adapter)))?;
    let shared = Device::new(adapter.get_info(), device.clone(), queue.clone());

    let world = World::open("procedural:rocks?size=64")?;
    let mut planecast = GpuRenderer::on_device(&world.scene, &world.resident, GpuOptions::default(), &shared)?;
    let camera = Camera { eye: [32.0, 60.0, 90.0].into(), pitch: -20.0, width: 320, height: 200, ..Camera::default() };
    planecast.draw(&camera, &Options::default())?;
    // A buffer of one RGBA word a pixel: to be bound, or copied into a texture as here.
    let picture = planecast.picture().ok_or("nothing was drawn")?;
    let size = wgpu::Extent3d { width: 320, height: 200, depth_or_array_layers: 1 };
    let texture = device.create_texture(&wgpu::TextureDescriptor {
        label: Some("planecast's picture"),
        size,
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: wgpu::TextureFormat::Rgba8Unorm,
        usage: wgpu::TextureUsages::COPY_DST | wgpu::TextureUsages::TEXTURE_BINDING,
        view_formats: &[],
    });
    let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(4 * 320), rows_per_image: None };
    let from = wgpu::TexelCopyBufferInfo { buffer: picture.buffer, layout };
    let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    encoder.copy_buffer_to_texture(from, texture.as_image_copy(), size);
    queue.submit([encoder.finish()]);
    println!("320 × 200 pixels in a texture of {}", adapter.get_info().name);
    Ok(())
}

#[test]
fn the_picture_reaches_the_others_texture() {
    main().expect("a device, software or not, that both use");
}
