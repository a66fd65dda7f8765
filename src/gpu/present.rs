//! Frames that stay on the device: drawn, shown on a surface, and never read back but for their figures.

use std::collections::VecDeque;
use std::sync::mpsc::TryRecvError;

use planecast_encoder::Scene;

use super::engine::Engine;
pub use super::engine::{Device, Failure};
use super::{Begin, Drawn, GpuOptions, GpuRenderer, Mapped, Parts, Sent};
use crate::camera::Camera;
use crate::clock::Instant;
use crate::error::{Error, Result};
use crate::frame::Stats;
use crate::options::Options;
use crate::renderer::Outputs;
use crate::resident::Resident;

impl Device {
    /// A device that was asked for with [`Device::wishes`].
    pub fn new(info: wgpu::AdapterInfo, device: wgpu::Device, queue: wgpu::Queue) -> Device {
        let failure = Failure::watch(&device);
        Device { info, device, queue, failure }
    }

    /// What to ask an adapter for, so that scenes and pictures fit as with [`GpuRenderer::new`].
    pub fn wishes(adapter: &wgpu::Adapter) -> wgpu::DeviceDescriptor<'static> {
        Engine::wishes(adapter)
    }

    /// Opens the adapter that the environment names (`WGPU_ADAPTER_NAME`), else the most powerful that can draw on the
    /// surface.
    pub fn open(instance: &wgpu::Instance, surface: &wgpu::Surface<'_>) -> Result<(wgpu::Adapter, Device)> {
        let adapter = Engine::choose(instance, Some(surface))?;
        let info = adapter.get_info();
        if !adapter.is_surface_supported(surface) {
            return Err(Error::Device(format!("{}: cannot draw in this window", info.name)));
        }
        let (device, queue) = pollster::block_on(adapter.request_device(&Engine::wishes(&adapter)))
            .map_err(|e| Error::Device(format!("{}: cannot open the device ({e})", info.name)))?;
        Ok((adapter, Device::new(info, device, queue)))
    }

    /// An error if the device reported one since it was opened.
    pub fn check(&self) -> Result<()> {
        self.failure.text().map_or(Ok(()), |text| Err(Error::Device(format!("{}: {text}", self.info.name))))
    }

    /// Whether the adapter is a processor that plays GPU.
    pub fn is_software(&self) -> bool {
        self.info.device_type == wgpu::DeviceType::Cpu
    }
}

/// Frames shown whose figures are still on their way.
#[derive(Default)]
pub(super) struct Shown {
    waiting: VecDeque<Waiting>,
    free: Vec<wgpu::Buffer>,
}

struct Waiting {
    stats: Stats,
    readback: wgpu::Buffer,
    mapped: Mapped,
    parts: Parts,
    setup_ms: f64,
    start: Instant,
}

/// Frames whose figures are waited for at once. Those of frames beyond are not asked for.
const WAITING: usize = 3;

impl<'a> GpuRenderer<'a> {
    /// On a device that is open already.
    pub fn on_device(
        scene: &'a Scene,
        resident: &'a Resident,
        options: GpuOptions,
        device: &Device,
    ) -> Result<GpuRenderer<'a>> {
        GpuRenderer::with_engine(scene, resident, options, || Ok(Engine::with_device(device.clone(), options.trusted)))
    }

    /// Draws one frame and leaves the picture on the device: see [`GpuRenderer::picture`].
    pub fn draw(&mut self, camera: &Camera, options: &Options) -> Result<()> {
        self.engine.check()?;
        match self.draw_from(Begin::Traverse, camera, options, Outputs::default())? {
            Drawn::Inside(frame) => {
                self.show_pixels(&frame.color)?;
            }
            Drawn::Sent(sent) if self.shown.waiting.len() < WAITING => {
                let Sent { plan, frame, start, setup_ms } = *sent;
                let parts = plan.parts(false);
                let fits = |b: &wgpu::Buffer| b.size() >= parts.end;
                let readback = match self.shown.free.iter().position(fits) {
                    Some(i) => self.shown.free.swap_remove(i),
                    None => {
                        self.shown.free.clear();
                        self.engine.device.create_buffer(&wgpu::BufferDescriptor {
                            label: Some("figures"),
                            size: parts.end,
                            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
                            mapped_at_creation: false,
                        })
                    }
                };
                let (_, mapped) = self.ask(&plan, parts, &readback);
                let stats = frame.stats;
                self.shown.waiting.push_back(Waiting { stats, readback, mapped, parts, setup_ms, start });
            }
            Drawn::Sent(_) => {}
        }
        Ok(())
    }

    /// Frames drawn whose figures have not come yet, up to three: more than one or two, and the device is behind.
    pub fn waiting(&self) -> usize {
        self.shown.waiting.len()
    }

    /// Puts a picture that was drawn elsewhere where [`GpuRenderer::picture`] has it.
    fn show_pixels(&mut self, color: &[[u8; 4]]) -> Result<()> {
        let size = 4 * color.len().max(16) as u64;
        if self.buffers.get("shaded").is_none_or(|b| b.size() < size) {
            let usage = wgpu::BufferUsages::STORAGE;
            let buffer = self.engine.checked("picture", || self.engine.buffer("shaded", size, usage))?;
            self.buffers.insert("shaded", buffer);
        }
        self.write("shaded", bytemuck::cast_slice(color));
        Ok(())
    }

    /// The picture of the frame drawn last, row by row, sRGB with r in the low byte; `None` before the first.
    pub fn picture(&self) -> Option<&wgpu::Buffer> {
        self.buffers.get("shaded")
    }

    /// What the latest frame cost of which that is known by now; never waits. `None` where nothing came since.
    pub fn figures(&mut self) -> Result<Option<Stats>> {
        let _ = self.engine.device.poll(wgpu::PollType::Poll);
        self.engine.check()?;
        let mut latest = None;
        while let Some(first) = self.shown.waiting.front() {
            match first.mapped.try_recv() {
                Err(TryRecvError::Empty) => break,
                Ok(Ok(())) => {}
                Ok(Err(e)) => return Err(Error::Device(format!("{}: figures of a frame: {e}", self.engine.name))),
                Err(e) => return Err(Error::Device(format!("{}: figures of a frame: {e}", self.engine.name))),
            }
            let Some(Waiting { mut stats, readback, parts, setup_ms, start, .. }) = self.shown.waiting.pop_front()
            else {
                break;
            };
            let lost = |e: wgpu::MapRangeError| Error::Device(format!("{}: figures of a frame: {e}", self.engine.name));
            let bytes = readback.get_mapped_range(..parts.end).map_err(lost)?;
            // A picture that a software device cut short has been shown by now; the next may be whole.
            let _ = self.figures_of(&bytes, parts, &mut stats, setup_ms, start);
            drop(bytes);
            readback.unmap();
            self.shown.free.push(readback);
            latest = Some(stats);
        }
        Ok(latest)
    }
}

/// What `present.wgsl` is told.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
struct Present {
    size: [u32; 2],
    surface: [u32; 2],
}

const SHADER: &str = include_str!("../../shaders/present.wgsl");

/// Puts pictures onto a surface, enlarged or reduced where their sizes differ.
pub struct Presenter {
    device: Device,
    pipeline: wgpu::RenderPipeline,
    params: wgpu::Buffer,
    clock: Option<Clock>,
}

/// Times one pass a frame.
struct Clock {
    queries: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    readback: wgpu::Buffer,
    mapped: Option<Mapped>,
    tick_ns: f32,
    /// Milliseconds, of the latest pass known.
    latest: Option<f64>,
}

impl Presenter {
    /// For surfaces of a format.
    pub fn new(device: &Device, format: wgpu::TextureFormat) -> Presenter {
        let gpu = &device.device;
        let module = gpu.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("present"),
            source: wgpu::ShaderSource::Wgsl(SHADER.into()),
        });
        let encodes = [("ENCODES", f64::from(u8::from(format.is_srgb())))];
        let pipeline = gpu.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("present"),
            layout: None,
            vertex: wgpu::VertexState {
                module: &module,
                entry_point: Some("corner"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                buffers: &[],
            },
            fragment: Some(wgpu::FragmentState {
                module: &module,
                entry_point: Some("pixel"),
                compilation_options: wgpu::PipelineCompilationOptions {
                    constants: &encodes,
                    ..wgpu::PipelineCompilationOptions::default()
                },
                targets: &[Some(format.into())],
            }),
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: None,
            multisample: wgpu::MultisampleState::default(),
            multiview_mask: None,
            cache: None,
        });
        let buffer = |label, size, usage| {
            gpu.create_buffer(&wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation: false })
        };
        use wgpu::BufferUsages as U;
        let params = buffer("present", size_of::<Present>() as u64, U::UNIFORM | U::COPY_DST);
        let clock = gpu.features().contains(wgpu::Features::TIMESTAMP_QUERY).then(|| Clock {
            queries: gpu.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("present"),
                ty: wgpu::QueryType::Timestamp,
                count: 2,
            }),
            resolved: buffer("present times", 16, U::QUERY_RESOLVE | U::COPY_SRC),
            readback: buffer("present times, read back", 16, U::COPY_DST | U::MAP_READ),
            mapped: None,
            tick_ns: device.queue.get_timestamp_period(),
            latest: None,
        });
        Presenter { device: device.clone(), pipeline, params, clock }
    }

    /// Records the pass that shows `picture`, `size` pixels, on the whole of a surface of `surface` pixels; sends nothing.
    pub fn show(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        view: &wgpu::TextureView,
        picture: &wgpu::Buffer,
        size: [u32; 2],
        surface: [u32; 2],
    ) {
        self.device.queue.write_buffer(&self.params, 0, bytemuck::bytes_of(&Present { size, surface }));
        let group = self.device.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("present"),
            layout: &self.pipeline.get_bind_group_layout(0),
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: self.params.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 1, resource: picture.as_entire_binding() },
            ],
        });
        let clock = self.clock.as_ref().filter(|c| c.mapped.is_none());
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("present"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations { load: wgpu::LoadOp::Clear(wgpu::Color::BLACK), store: wgpu::StoreOp::Store },
            })],
            timestamp_writes: clock.map(|c| wgpu::RenderPassTimestampWrites {
                query_set: &c.queries,
                beginning_of_pass_write_index: Some(0),
                end_of_pass_write_index: Some(1),
            }),
            ..wgpu::RenderPassDescriptor::default()
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.draw(0..3, 0..1);
        drop(pass);
        if let Some(c) = clock {
            encoder.resolve_query_set(&c.queries, 0..2, &c.resolved, 0);
        }
    }

    /// Milliseconds that a pass of [`Presenter::show`] took on the device, of the latest that is known; to be called once
    /// after each is submitted. `None` without timestamps, or before the first.
    pub fn ms(&mut self) -> Option<f64> {
        let clock = self.clock.as_mut()?;
        match &clock.mapped {
            None => {
                let mut encoder = self.device.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
                encoder.copy_buffer_to_buffer(&clock.resolved, 0, &clock.readback, 0, 16);
                self.device.queue.submit([encoder.finish()]);
                let (send, mapped) = std::sync::mpsc::channel();
                clock.readback.map_async(wgpu::MapMode::Read, .., move |result| {
                    // The presenter may be gone by now.
                    let _ = send.send(result);
                });
                clock.mapped = Some(mapped);
            }
            Some(mapped) => {
                if let Ok(Ok(())) = mapped.try_recv() {
                    if let Ok(bytes) = clock.readback.get_mapped_range(..) {
                        let times: Vec<u64> = bytemuck::pod_collect_to_vec(&bytes);
                        clock.latest = Some(times[1].saturating_sub(times[0]) as f64 * f64::from(clock.tick_ns) * 1e-6);
                    }
                    clock.readback.unmap();
                    clock.mapped = None;
                }
            }
        }
        clock.latest
    }
}

#[cfg(test)]
mod tests {
    use planecast_encoder::source::procedural::{Kind, procedural};
    use planecast_encoder::{BuildOptions, build};

    use super::*;
    use crate::gpu::engine::instance;
    use crate::tour::{self, View};

    #[test]
    fn present_shader_is_valid() {
        use wgpu::naga::valid::{Capabilities, ValidationFlags, Validator};
        let module = wgpu::naga::front::wgsl::parse_str(SHADER).unwrap();
        Validator::new(ValidationFlags::all(), Capabilities::empty()).validate(&module).unwrap();
    }

    /// What a presenter puts on a surface of that size, and the milliseconds of the pass.
    fn shown(gpu: &mut GpuRenderer<'_>, device: &Device, size: [u32; 2], surface: [u32; 2]) -> (Vec<[u8; 4]>, f64) {
        let format = wgpu::TextureFormat::Rgba8Unorm;
        let mut presenter = Presenter::new(device, format);
        let [width, height] = surface;
        let texture = device.device.create_texture(&wgpu::TextureDescriptor {
            label: None,
            size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
            view_formats: &[],
        });
        let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
        let row = (4 * width).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
        let buffer = device.device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size: u64::from(row * height),
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        let mut ms = f64::INFINITY;
        // The first passes wait for the GPU to wake.
        for _ in 0..20 {
            let mut encoder = device.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            presenter.show(&mut encoder, &view, gpu.picture().unwrap(), size, surface);
            let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(row), rows_per_image: None };
            let to = wgpu::TexelCopyBufferInfo { buffer: &buffer, layout };
            encoder.copy_texture_to_buffer(texture.as_image_copy(), to, texture.size());
            device.queue.submit([encoder.finish()]);
            for _ in 0..2 {
                ms = ms.min(presenter.ms().unwrap_or(f64::INFINITY));
                device.device.poll(wgpu::PollType::wait_indefinitely()).unwrap();
            }
        }
        buffer.map_async(wgpu::MapMode::Read, .., |_| {});
        device.device.poll(wgpu::PollType::wait_indefinitely()).unwrap();
        device.check().unwrap();
        let bytes = buffer.get_mapped_range(..).unwrap();
        let rows =
            bytes.chunks(row as usize).flat_map(|r| bytemuck::cast_slice::<u8, [u8; 4]>(&r[..4 * width as usize]));
        (rows.copied().collect(), ms)
    }

    #[test]
    fn present_shows_the_picture_that_is_rendered() {
        // As in tests/gpu.
        if std::env::var_os("PLANECAST_NO_GPU").is_some_and(|v| v == "1") {
            eprintln!("skipped: PLANECAST_NO_GPU=1");
            return;
        }
        let adapter =
            Engine::choose(&instance(), None).expect("a Vulkan device, software will do (./test installs one)");
        let (device, queue) = pollster::block_on(adapter.request_device(&Device::wishes(&adapter))).unwrap();
        let device = Device::new(adapter.get_info(), device, queue);
        let scene = build(procedural(Kind::Terrain, 64, 1).unwrap(), &BuildOptions::default()).unwrap();
        let resident = Resident::new(&scene);
        let mut gpu = GpuRenderer::on_device(&scene, &resident, GpuOptions::default(), &device).unwrap();
        assert!(gpu.picture().is_none());
        let options = Options::default();
        for size in [[217, 131], [1920, 1080]] {
            let camera = tour::still(&scene, View { fov: 60.0, size, repeat: options.repeat }).camera(size);
            let rendered = gpu.render(&camera, &options, Outputs::default()).unwrap();
            gpu.draw(&camera, &options).unwrap();
            let (pixels, ms) = shown(&mut gpu, &device, size, size);
            assert!(pixels == rendered.color, "{size:?}");
            println!("{} × {}: the pass takes {ms:.4} ms on {}", size[0], size[1], device.info.name);
            let figures = gpu.figures().unwrap().expect("the device was waited for");
            let work = |s: &Stats| (s.columns_visited, s.runs_visited, s.spans_drawn, s.planes);
            assert_eq!(work(&figures), work(&rendered.stats));
            assert!(gpu.figures().unwrap().is_none(), "once each");
            // Enlarged twice, each pixel lies within what is around it.
            let (large, _) = shown(&mut gpu, &device, size, size.map(|n| 2 * n));
            let mean = |p: &[[u8; 4]]| p.iter().map(|c| f64::from(c[1])).sum::<f64>() / p.len() as f64;
            assert!((mean(&large) - mean(&pixels)).abs() < 1.0);
        }
        // An eye inside the ground sees one colour, which the host knows.
        let inside = Camera {
            eye: glam::DVec3::new(30.5, 0.5, 30.5),
            yaw: 0.0,
            pitch: 0.0,
            roll: 0.0,
            fov: 60.0,
            width: 40,
            height: 30,
        };
        let rendered = gpu.render(&inside, &options, Outputs::default()).unwrap();
        gpu.draw(&inside, &options).unwrap();
        assert!(shown(&mut gpu, &device, [40, 30], [40, 30]).0 == rendered.color);
    }
}
