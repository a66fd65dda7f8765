//! Frames that stay on the device: drawn, shown on a surface, and never read back but for their figures.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::mpsc::TryRecvError;

use planecast_encoder::Scene;

use super::engine::Engine;
pub use super::engine::{Device, Failure};
use super::{Begin, Drawn, GpuOptions, GpuRenderer, Mapped, Parts, Sent};
use crate::clock::Instant;
use crate::cpu::renderer::Outputs;
use crate::error::{Error, Result};
use crate::frame::camera::Camera;
use crate::frame::options::Options;
use crate::frame::picture::Stats;
use crate::frame::plan::FramePlan;
use crate::world::tables::Resident;

impl Device {
    /// A device that was asked for with [`Device::wishes`].
    pub fn new(info: wgpu::AdapterInfo, device: wgpu::Device, queue: wgpu::Queue) -> Device {
        Device::watched(info, device, queue)
    }

    /// Opens the adapter that the environment names (`WGPU_ADAPTER_NAME`), else the most powerful, for pictures that no
    /// surface shows. Renderers that share a device compile each shader once.
    #[cfg(not(target_arch = "wasm32"))]
    pub fn headless() -> Result<Device> {
        Device::on(&Engine::choose(&super::engine::instance(), None)?)
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
        let device = Device::on(&adapter)?;
        Ok((adapter, device))
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

/// How the four bytes of a pixel follow each other.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ByteOrder {
    #[default]
    Rgba,
    Bgra,
}

impl ByteOrder {
    /// That of a texture's texels; `None` where they are not four bytes of colour.
    pub fn of(format: wgpu::TextureFormat) -> Option<ByteOrder> {
        match format.remove_srgb_suffix() {
            wgpu::TextureFormat::Rgba8Unorm => Some(ByteOrder::Rgba),
            wgpu::TextureFormat::Bgra8Unorm => Some(ByteOrder::Bgra),
            _ => None,
        }
    }

    /// A pixel in this order, from RGBA; and back, as it is its own inverse.
    pub fn swap(self, [r, g, b, a]: [u8; 4]) -> [u8; 4] {
        match self {
            ByteOrder::Rgba => [r, g, b, a],
            ByteOrder::Bgra => [b, g, r, a],
        }
    }
}

/// A finished picture on the device, row by row without gaps, in sRGB.
#[derive(Clone, Copy, Debug)]
pub struct Shaded<'b> {
    pub buffer: &'b wgpu::Buffer,
    pub order: ByteOrder,
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

impl GpuRenderer {
    /// On a device that is open already.
    pub fn on_device(
        scene: &Arc<Scene>,
        resident: &Arc<Resident>,
        options: GpuOptions,
        device: &Device,
    ) -> Result<GpuRenderer> {
        GpuRenderer::with_engine(Some(scene), resident, options, || {
            Ok(Engine::with_device(device.clone(), options.trusted))
        })
    }

    /// The same of tables alone: see [`GpuRenderer::of_tables`].
    pub fn of_tables_on(resident: &Arc<Resident>, options: GpuOptions, device: &Device) -> Result<GpuRenderer> {
        GpuRenderer::with_engine(None, resident, options, || Ok(Engine::with_device(device.clone(), options.trusted)))
    }

    /// Draws one frame and leaves the picture on the device: see [`GpuRenderer::picture`].
    pub fn draw(&mut self, camera: &Camera, options: &Options) -> Result<()> {
        self.show(None, camera, options).map(drop)
    }

    /// The same for a frame that is decided already; whether its figures will come.
    pub(crate) fn draw_plan(&mut self, plan: FramePlan) -> Result<bool> {
        let (camera, options) = (plan.camera, plan.options);
        self.show(Some(plan), &camera, &options)
    }

    fn show(&mut self, plan: Option<FramePlan>, camera: &Camera, options: &Options) -> Result<bool> {
        self.engine.check()?;
        match self.draw_from(Begin::Traverse, plan, camera, options, Outputs::default(), self.live_order)? {
            Drawn::Inside(frame) => {
                self.show_pixels(&frame.color)?;
                Ok(false)
            }
            Drawn::Sent(sent) if self.shown.waiting.len() < WAITING => {
                let Sent { plan, frame, start, setup_ms } = *sent;
                let parts = plan.parts(false, false);
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
                Ok(true)
            }
            Drawn::Sent(_) => Ok(false),
        }
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
        self.shaded_order = ByteOrder::Rgba;
        Ok(())
    }

    /// The picture of the frame drawn last; `None` before the first.
    pub fn picture(&self) -> Option<Shaded<'_>> {
        self.buffers.get("shaded").map(|buffer| Shaded { buffer, order: self.shaded_order })
    }

    /// How the pixels of frames from the next [`GpuRenderer::draw`] on lie in their bytes: as the surface has them that
    /// shows them.
    pub fn set_order(&mut self, order: ByteOrder) {
        self.live_order = order;
    }

    /// What the latest frame cost of which that is known by now; never waits. `None` where nothing came since.
    pub fn figures(&mut self) -> Result<Option<Stats>> {
        let mut latest = None;
        while let Some(stats) = self.next_figures()? {
            latest = Some(stats);
        }
        Ok(latest)
    }

    /// The same of the earliest frame of which nothing was told yet; [`GpuRenderer::usage`] is that frame's then.
    pub(crate) fn next_figures(&mut self) -> Result<Option<Stats>> {
        let _ = self.engine.device.poll(wgpu::PollType::Poll);
        self.engine.check()?;
        let Some(first) = self.shown.waiting.front() else { return Ok(None) };
        let lost = |e: &dyn std::fmt::Display| Error::Device(format!("{}: figures of a frame: {e}", self.engine.name));
        match first.mapped.try_recv() {
            Err(TryRecvError::Empty) => return Ok(None),
            Ok(Ok(())) => {}
            Ok(Err(e)) => return Err(lost(&e)),
            Err(e) => return Err(lost(&e)),
        }
        let first = self.shown.waiting.pop_front().expect("it was looked at");
        let Waiting { mut stats, readback, parts, setup_ms, start, .. } = first;
        let bytes = readback.get_mapped_range(..parts.end).map_err(|e| lost(&e))?;
        // A picture that a software device cut short has been shown by now; the next may be whole.
        let _ = self.figures_of(&bytes, parts, &mut stats, setup_ms, start);
        self.usage = parts.usage_in(&bytes, std::mem::take(&mut self.usage));
        drop(bytes);
        readback.unmap();
        self.shown.free.push(readback);
        Ok(Some(stats))
    }
}

/// What the shaders below are told.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
struct Present {
    size: [u32; 2],
    surface: [u32; 2],
    at: [u32; 2],
    bgra: u32,
    _pad0: u32,
}

const DRAW_SHADER: &str =
    concat!(include_str!("../../shaders/shared/picture.wgsl"), include_str!("../../shaders/present.wgsl"));
const WRITE_SHADER: &str =
    concat!(include_str!("../../shaders/shared/picture.wgsl"), include_str!("../../shaders/present_write.wgsl"));

/// Puts pictures onto a surface: copies or writes those that have its size, as it lets them be, and draws the others, enlarged
/// or reduced where sizes differ.
pub struct Presenter {
    device: Device,
    pipeline: wgpu::RenderPipeline,
    /// `None` where the surface cannot be written to.
    write: Option<wgpu::ComputePipeline>,
    params: wgpu::Buffer,
    /// Of pictures that can be copied; `None` where the surface takes none.
    copied: Option<ByteOrder>,
    clock: Option<Clock>,
}

/// How a picture came onto a surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    Copied,
    Written,
    Drawn,
}

impl Way {
    pub fn name(self) -> &'static str {
        match self {
            Way::Copied => "copied",
            Way::Written => "written",
            Way::Drawn => "drawn",
        }
    }
}

/// Times one copy or pass a frame.
struct Clock {
    /// Copies can be timed too.
    copies: bool,
    /// The latest frame's times are, or will be, in `resolved`.
    written: bool,
    queries: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    readback: wgpu::Buffer,
    mapped: Option<Mapped>,
    tick_ns: f32,
    /// Milliseconds, of the latest known.
    latest: Option<f64>,
}

/// What shaders call a format that a surface used so can be written in; `None` where it cannot be.
fn writable(device: &Device, format: wgpu::TextureFormat, usage: wgpu::TextureUsages) -> Option<&'static str> {
    let swapped = device.device.features().contains(wgpu::Features::BGRA8UNORM_STORAGE);
    match format {
        _ if !usage.contains(wgpu::TextureUsages::STORAGE_BINDING) => None,
        wgpu::TextureFormat::Rgba8Unorm => Some("rgba8unorm"),
        wgpu::TextureFormat::Bgra8Unorm if swapped => Some("bgra8unorm"),
        _ => None,
    }
}

/// Whether writing is faster than copying: 1,920 × 1,080 pixels take an H100 0.010 and 0.108 ms, a software device 5 and 0.15.
/// Of what browsers do not tell, copies are the safer choice.
fn writes_first(device: &Device) -> bool {
    use wgpu::DeviceType::{DiscreteGpu, IntegratedGpu, VirtualGpu};
    matches!(device.info.device_type, DiscreteGpu | IntegratedGpu | VirtualGpu)
}

impl Presenter {
    /// How surfaces of a format are to be used, of what they offer.
    pub fn usage(device: &Device, format: wgpu::TextureFormat, offered: wgpu::TextureUsages) -> wgpu::TextureUsages {
        let copy = offered & wgpu::TextureUsages::COPY_DST;
        match writable(device, format, offered) {
            Some(_) => copy | wgpu::TextureUsages::STORAGE_BINDING,
            None => copy,
        }
    }

    /// For surfaces of a format that can be used so.
    pub fn new(device: &Device, format: wgpu::TextureFormat, usage: wgpu::TextureUsages) -> Presenter {
        let gpu = &device.device;
        let module = gpu.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("present"),
            source: wgpu::ShaderSource::Wgsl(DRAW_SHADER.into()),
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
            // llvmpipe's clock stands still while it copies.
            copies: gpu.features().contains(wgpu::Features::TIMESTAMP_QUERY_INSIDE_ENCODERS) && !device.is_software(),
            written: false,
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
        let copied = ByteOrder::of(format).filter(|_| usage.contains(wgpu::TextureUsages::COPY_DST));
        let write = writable(device, format, usage).map(|name| {
            let source = WRITE_SHADER.replace("<FORMAT,", &format!("<{name},"));
            let module = gpu.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some("present_write"),
                source: wgpu::ShaderSource::Wgsl(source.into()),
            });
            gpu.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some("present_write"),
                layout: None,
                module: &module,
                entry_point: Some("main"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                cache: None,
            })
        });
        Presenter { device: device.clone(), pipeline, write, params, copied, clock }
    }

    /// The order that pictures of the surface's size should have.
    pub fn order(&self) -> ByteOrder {
        self.copied.unwrap_or_default()
    }

    /// Records what shows `picture`, `size` pixels, on the whole of a surface's texture; sends nothing.
    ///
    /// Where the size is the texture's, the picture is written into it by a compute pass, or copied, where order and rows let it
    /// be: a fraction of what a pass over all pixels takes. Which of the two comes first is the device's matter.
    pub fn show(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        texture: &wgpu::Texture,
        picture: Shaded<'_>,
        size: [u32; 2],
    ) -> Way {
        self.show_in(encoder, texture, picture, size, [0; 2], [texture.width(), texture.height()])
    }

    /// The same on the pixels of the texture from `at` on, `area` of them a side; the others become black.
    pub fn show_in(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        texture: &wgpu::Texture,
        picture: Shaded<'_>,
        size: [u32; 2],
        at: [u32; 2],
        area: [u32; 2],
    ) -> Way {
        let row = 4 * size[0];
        let whole = area == [texture.width(), texture.height()];
        let same = whole && size == area;
        let copies = self.copied == Some(picture.order) && row.is_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
        let way = match &self.write {
            Some(_) if same && (writes_first(&self.device) || !copies) => Way::Written,
            _ if same && copies => Way::Copied,
            _ => Way::Drawn,
        };
        let mut clock = self.clock.as_mut().filter(|c| c.mapped.is_none());
        if let Some(c) = &mut clock {
            c.written = way != Way::Copied || c.copies;
        }
        let clock = self.clock.as_ref().filter(|c| c.mapped.is_none() && c.written);
        match way {
            Way::Copied => {
                if let Some(c) = clock {
                    encoder.write_timestamp(&c.queries, 0);
                }
                let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(row), rows_per_image: None };
                let from = wgpu::TexelCopyBufferInfo { buffer: picture.buffer, layout };
                encoder.copy_buffer_to_texture(from, texture.as_image_copy(), texture.size());
                if let Some(c) = clock {
                    encoder.write_timestamp(&c.queries, 1);
                }
            }
            Way::Drawn => self.draw(encoder, texture, picture, size, [at, area], clock),
            Way::Written => self.write(encoder, texture, picture, size, clock),
        }
        if let Some(c) = clock {
            encoder.resolve_query_set(&c.queries, 0..2, &c.resolved, 0);
        }
        way
    }

    /// What both shaders bind, told what they are to show.
    fn group(
        &self,
        layout: wgpu::BindGroupLayout,
        picture: Shaded<'_>,
        size: [u32; 2],
        [at, surface]: [[u32; 2]; 2],
        into: Option<&wgpu::TextureView>,
    ) -> wgpu::BindGroup {
        let bgra = u32::from(picture.order == ByteOrder::Bgra);
        let present = Present { size, surface, at, bgra, _pad0: 0 };
        self.device.queue.write_buffer(&self.params, 0, bytemuck::bytes_of(&present));
        let mut entries = vec![
            wgpu::BindGroupEntry { binding: 0, resource: self.params.as_entire_binding() },
            wgpu::BindGroupEntry { binding: 1, resource: picture.buffer.as_entire_binding() },
        ];
        entries.extend(
            into.map(|view| wgpu::BindGroupEntry { binding: 2, resource: wgpu::BindingResource::TextureView(view) }),
        );
        self.device.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("present"),
            layout: &layout,
            entries: &entries,
        })
    }

    fn write(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        texture: &wgpu::Texture,
        picture: Shaded<'_>,
        size: [u32; 2],
        clock: Option<&Clock>,
    ) {
        let Some(pipeline) = &self.write else { return };
        let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
        let whole = [[0; 2], [texture.width(), texture.height()]];
        let group = self.group(pipeline.get_bind_group_layout(0), picture, size, whole, Some(&view));
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("present_write"),
            timestamp_writes: clock.map(|c| wgpu::ComputePassTimestampWrites {
                query_set: &c.queries,
                beginning_of_pass_write_index: Some(0),
                end_of_pass_write_index: Some(1),
            }),
        });
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.dispatch_workgroups(size[0].div_ceil(16), size[1].div_ceil(16), 1);
    }

    fn draw(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        texture: &wgpu::Texture,
        picture: Shaded<'_>,
        size: [u32; 2],
        place: [[u32; 2]; 2],
        clock: Option<&Clock>,
    ) {
        let group = self.group(self.pipeline.get_bind_group_layout(0), picture, size, place, None);
        let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("present"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &view,
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
        let [[x, y], [width, height]] = place;
        pass.set_scissor_rect(x, y, width, height);
        pass.draw(0..3, 0..1);
    }

    /// Milliseconds that [`Presenter::show`] took on the device, of the latest that is known; to be called once after each
    /// is submitted. `None` where the device cannot time it, or before the first.
    pub fn ms(&mut self) -> Option<f64> {
        let clock = self.clock.as_mut()?;
        match &clock.mapped {
            None if !clock.written => clock.latest = None,
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
    use crate::film::tour::{self, View};

    #[test]
    fn present_shader_is_valid() {
        use wgpu::naga::valid::{Capabilities, ValidationFlags, Validator};
        let module = wgpu::naga::front::wgsl::parse_str(DRAW_SHADER).unwrap();
        Validator::new(ValidationFlags::all(), Capabilities::empty()).validate(&module).unwrap();
    }

    use wgpu::TextureUsages as U;

    const PASS: U = U::RENDER_ATTACHMENT.union(U::COPY_SRC);
    const COPY: U = PASS.union(U::COPY_DST);
    const WRITE: U = PASS.union(U::STORAGE_BINDING);

    fn texture(device: &Device, format: wgpu::TextureFormat, usage: U, [width, height]: [u32; 2]) -> wgpu::Texture {
        device.device.create_texture(&wgpu::TextureDescriptor {
            label: None,
            size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage,
            view_formats: &[],
        })
    }

    fn wait(device: &Device) {
        device.device.poll(wgpu::PollType::wait_indefinitely()).unwrap();
    }

    /// What a presenter puts on a surface, in RGBA, how, and the milliseconds that the device tells.
    fn shown(
        device: &Device,
        picture: Shaded<'_>,
        size: [u32; 2],
        surface: &wgpu::Texture,
    ) -> (Vec<[u8; 4]>, Way, Option<f64>) {
        let order = ByteOrder::of(surface.format()).unwrap();
        let mut presenter = Presenter::new(device, surface.format(), surface.usage());
        let width = surface.width();
        let row = (4 * width).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
        let buffer = device.device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size: u64::from(row * surface.height()),
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        let (mut ms, mut way) = (None::<f64>, Way::Drawn);
        // The first ones wait for the GPU to wake.
        for _ in 0..20 {
            let mut encoder = device.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            way = presenter.show(&mut encoder, surface, picture, size);
            let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(row), rows_per_image: None };
            let to = wgpu::TexelCopyBufferInfo { buffer: &buffer, layout };
            encoder.copy_texture_to_buffer(surface.as_image_copy(), to, surface.size());
            device.queue.submit([encoder.finish()]);
            for _ in 0..2 {
                let latest = presenter.ms();
                ms = ms.into_iter().chain(latest).min_by(f64::total_cmp);
                wait(device);
            }
        }
        buffer.map_async(wgpu::MapMode::Read, .., |_| {});
        wait(device);
        device.check().unwrap();
        let bytes = buffer.get_mapped_range(..).unwrap();
        let rows =
            bytes.chunks(row as usize).flat_map(|r| bytemuck::cast_slice::<u8, [u8; 4]>(&r[..4 * width as usize]));
        (rows.map(|p| order.swap(*p)).collect(), way, ms)
    }

    /// Milliseconds of one of many in one submission, as the host sees it: beside what the device's clock tells.
    fn on_the_host(device: &Device, picture: Shaded<'_>, size: [u32; 2], surface: &wgpu::Texture) -> f64 {
        let mut presenter = Presenter::new(device, surface.format(), surface.usage());
        presenter.clock = None;
        let mut run = |n: u32| {
            let mut encoder = device.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            for _ in 0..n {
                presenter.show(&mut encoder, surface, picture, size);
            }
            let commands = encoder.finish();
            let start = Instant::now();
            device.queue.submit([commands]);
            wait(device);
            start.elapsed().as_secs_f64() * 1e3
        };
        run(2);
        let least = |n: u32, run: &mut dyn FnMut(u32) -> f64| (0..3).map(|_| run(n)).fold(f64::INFINITY, f64::min);
        // What a submission takes by itself falls out.
        (least(34, &mut run) - least(2, &mut run)) / 32.0
    }

    /// None where the tests are to do without a GPU.
    fn device() -> Option<Device> {
        // As in tests/gpu.
        if std::env::var_os("PLANECAST_NO_GPU").is_some_and(|v| v == "1") {
            eprintln!("skipped: PLANECAST_NO_GPU=1");
            return None;
        }
        Some(Device::headless().expect("a Vulkan device, software will do (./test installs one)"))
    }

    #[test]
    fn present_shows_the_picture_that_is_rendered() {
        let Some(device) = device() else { return };
        let scene = Arc::new(build(procedural(Kind::Terrain, 64, 1).unwrap(), &BuildOptions::default()).unwrap());
        let resident = Arc::new(Resident::new(&scene));
        let mut gpu = GpuRenderer::on_device(&scene, &resident, GpuOptions::default(), &device).unwrap();
        assert!(gpu.picture().is_none());
        let options = Options::default();
        let format = wgpu::TextureFormat::Rgba8Unorm;
        for size in [[217, 131], [1920, 1080]] {
            let camera = tour::still(&scene, View { fov: 60.0, size, repeat: options.repeat }).camera(size);
            let rendered = gpu.render(&camera, &options, Outputs::default()).unwrap();
            gpu.draw(&camera, &options).unwrap();
            let (pixels, way, _) = shown(&device, gpu.picture().unwrap(), size, &texture(&device, format, COPY, size));
            assert!(pixels == rendered.color, "{size:?}");
            // Rows of 217 pixels cannot be copied.
            assert_eq!(way, if size[0] == 1920 { Way::Copied } else { Way::Drawn });
            let figures = gpu.figures().unwrap().expect("the device was waited for");
            let work = |s: &Stats| (s.columns_visited, s.runs_visited, s.spans_drawn, s.planes);
            assert_eq!(work(&figures), work(&rendered.stats));
            assert!(gpu.figures().unwrap().is_none(), "once each");
            // Enlarged twice, each pixel lies within what is around it.
            let twice = texture(&device, format, COPY, size.map(|n| 2 * n));
            let (large, way, _) = shown(&device, gpu.picture().unwrap(), size, &twice);
            assert_eq!(way, Way::Drawn);
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
        for format in [wgpu::TextureFormat::Rgba8Unorm, wgpu::TextureFormat::Bgra8Unorm] {
            gpu.set_order(ByteOrder::of(format).unwrap());
            gpu.draw(&inside, &options).unwrap();
            let surface = texture(&device, format, COPY, [40, 30]);
            assert!(shown(&device, gpu.picture().unwrap(), [40, 30], &surface).0 == rendered.color);
        }
    }

    #[test]
    fn present_copies_and_writes_what_the_pass_draws_bit_for_bit() {
        let Some(device) = device() else { return };
        let scene = Arc::new(build(procedural(Kind::Terrain, 64, 1).unwrap(), &BuildOptions::default()).unwrap());
        let resident = Arc::new(Resident::new(&scene));
        let mut gpu = GpuRenderer::on_device(&scene, &resident, GpuOptions::default(), &device).unwrap();
        let options = Options::default();
        for size in [[192, 107], [1920, 1080]] {
            let camera = tour::still(&scene, View { fov: 60.0, size, repeat: options.repeat }).camera(size);
            let rendered = gpu.render(&camera, &options, Outputs::default()).unwrap();
            for format in [wgpu::TextureFormat::Rgba8Unorm, wgpu::TextureFormat::Bgra8Unorm] {
                let order = ByteOrder::of(format).unwrap();
                gpu.set_order(order);
                gpu.draw(&camera, &options).unwrap();
                let picture = gpu.picture().unwrap();
                assert_eq!(picture.order, order);
                let either = if writes_first(&device) { Way::Written } else { Way::Copied };
                let writes = [(WRITE, Way::Written), (COPY | WRITE, either)]
                    .into_iter()
                    .filter(|_| writable(&device, format, WRITE).is_some());
                for (usage, expected) in [(COPY, Way::Copied), (PASS, Way::Drawn)].into_iter().chain(writes) {
                    let surface = texture(&device, format, usage, size);
                    let (pixels, way, ms) = shown(&device, picture, size, &surface);
                    assert_eq!(way, expected);
                    assert!(pixels == rendered.color, "{size:?} {format:?} {way:?}");
                    let ms = ms.map_or("not timed".into(), |ms| format!("{ms:.4} ms"));
                    let host = on_the_host(&device, picture, size, &surface);
                    let ([w, h], name) = (size, &device.info.name);
                    println!("{w} × {h}, {format:?}, {}: {ms}, by the host's clock {host:.4} ms on {name}", way.name());
                    // What is said to be in the other order comes out in other colours, whichever way it goes.
                    let (other, its) = match order {
                        ByteOrder::Rgba => (ByteOrder::Bgra, wgpu::TextureFormat::Bgra8Unorm),
                        ByteOrder::Bgra => (ByteOrder::Rgba, wgpu::TextureFormat::Rgba8Unorm),
                    };
                    let wrong = Shaded { order: other, ..picture };
                    if way == Way::Written && writable(&device, its, usage).is_none() {
                        continue;
                    }
                    let (planted, way, _) = shown(&device, wrong, size, &texture(&device, its, usage, size));
                    assert!(way == expected && planted != rendered.color, "{way:?}: a planted fault");
                }
                let drawn = gpu.render(&camera, &options, Outputs::default()).unwrap();
                assert!(drawn.color == rendered.color, "render is RGBA whatever the window has");
                assert_eq!(gpu.picture().unwrap().order, ByteOrder::Rgba);
            }
        }
    }
}
