//! Frames that stay on the device: drawn, shown on a surface, and never read back but for their figures.

use std::collections::VecDeque;
use std::sync::mpsc::TryRecvError;

use planecast_encoder::Scene;

use super::engine::Engine;
pub use super::engine::{Device, Failure};
use super::{Begin, Drawn, GpuOptions, GpuRenderer, Mapped, Parts};
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
            Drawn::Sent { plan, frame, start, setup_ms } if self.shown.waiting.len() < WAITING => {
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
            Drawn::Sent { .. } => {}
        }
        Ok(())
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
            self.figures_of(&readback.get_mapped_range(..parts.end).map_err(lost)?, parts, &mut stats, setup_ms, start);
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
