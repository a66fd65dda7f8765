//! The surface that a window shows: wgpu with egui over it, or plain pixels where there is no wgpu.

use std::num::NonZeroU32;
use std::sync::{Arc, mpsc};

use winit::window::Window;

use super::script::Trouble;
use crate::gpu::present::{ByteOrder, Device, Presenter, Shaded, Way};
use crate::render::drawer::Drawer;
use crate::{Error, Result};

/// What is shown.
pub enum Picture<'p> {
    /// Nothing but the panel.
    None,
    /// What a drawer left on the device.
    OnDevice(&'p Drawer),
    /// Pixels, from the CPU; `None` where they are the same as the last time.
    Here(Option<&'p [[u8; 4]]>),
}

/// What egui wants painted.
pub struct Painting {
    pub textures: egui::TexturesDelta,
    pub primitives: Vec<egui::ClippedPrimitive>,
    pub pixels_per_point: f32,
}

/// How showing a frame went.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shown {
    Yes,
    /// The window cannot be seen, or is busy: later.
    Later,
    /// The surface was made anew: at once again.
    Again,
}

/// A surface of wgpu.
pub struct Canvas {
    instance: wgpu::Instance,
    /// `None` where it was lost and no other could be made.
    surface: Option<wgpu::Surface<'static>>,
    adapter: wgpu::Adapter,
    pub device: Device,
    config: wgpu::SurfaceConfiguration,
    presenter: Presenter,
    painter: egui_wgpu::Renderer,
    upload: Option<wgpu::Buffer>,
    /// Milliseconds that showing the picture took on the device, and how it was shown.
    pub present_ms: Option<f64>,
    pub way: Option<Way>,
    /// Surfaces that were configured anew as they were out of date, and made anew as they were lost.
    pub renewed: [u32; 2],
    /// What the next frame meets in place of a surface: for tests.
    pub trouble: Option<Trouble>,
}

fn instance() -> wgpu::Instance {
    wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle_from_env())
}

fn surface(instance: &wgpu::Instance, window: &Arc<Window>) -> Result<wgpu::Surface<'static>> {
    instance.create_surface(window.clone()).map_err(|_| {
        Error::Device("no GPU adapter can draw in this window: install a Vulkan, Metal or DX12 driver".into())
    })
}

impl Canvas {
    /// `grabs`: [`Canvas::show`] will be asked for what it shows.
    pub fn new(window: &Arc<Window>, grabs: bool) -> Result<Canvas> {
        let instance = instance();
        let surface = surface(&instance, window)?;
        let (adapter, device) = Device::open(&instance, &surface)?;
        let size = window.inner_size();
        let caps = surface.get_capabilities(&adapter);
        let wrong = || Error::Device(format!("{}: cannot draw in this window", device.info.name));
        let mut config =
            surface.get_default_config(&adapter, size.width.max(1), size.height.max(1)).ok_or_else(wrong)?;
        // egui and the pictures are in sRGB bytes already.
        config.format = caps.formats.iter().copied().find(|f| !f.is_srgb()).unwrap_or(config.format);
        // Pictures are written or copied onto the surface where it lets them be.
        config.usage |= Presenter::usage(&device, config.format, caps.usages);
        if grabs && caps.usages.contains(wgpu::TextureUsages::COPY_SRC) {
            config.usage |= wgpu::TextureUsages::COPY_SRC;
        }
        config.present_mode = wgpu::PresentMode::AutoVsync;
        surface.configure(&device.device, &config);
        let presenter = Presenter::new(&device, config.format, config.usage);
        let painter = egui_wgpu::Renderer::new(&device.device, config.format, egui_wgpu::RendererOptions::default());
        Ok(Canvas {
            instance,
            surface: Some(surface),
            adapter,
            device,
            config,
            presenter,
            painter,
            upload: None,
            present_ms: None,
            way: None,
            renewed: [0; 2],
            trouble: None,
        })
    }

    fn configure(&self) {
        if let Some(surface) = &self.surface {
            surface.configure(&self.device.device, &self.config);
        }
    }

    /// The order that the pixels of a drawer's pictures should have.
    pub fn order(&self) -> ByteOrder {
        self.presenter.order()
    }

    pub fn size(&self) -> [u32; 2] {
        [self.config.width, self.config.height]
    }

    /// Pixels a side at most.
    pub fn limit(&self) -> usize {
        self.device.device.limits().max_texture_dimension_2d as usize
    }

    /// The window has another size; 0 × 0 keeps the old one, as nothing is shown then.
    pub fn resize(&mut self, [width, height]: [u32; 2]) {
        let limit = self.limit() as u32;
        if width == 0 || height == 0 || [width, height] == self.size() {
            return;
        }
        (self.config.width, self.config.height) = (width.min(limit), height.min(limit));
        self.configure();
    }

    /// Whether frames wait for the monitor.
    pub fn set_vsync(&mut self, on: bool) {
        let mode = if on { wgpu::PresentMode::AutoVsync } else { wgpu::PresentMode::AutoNoVsync };
        if self.config.present_mode != mode {
            self.config.present_mode = mode;
            self.configure();
        }
    }

    fn upload(&mut self, pixels: &[[u8; 4]]) -> Result<()> {
        let size = 4 * pixels.len().max(16) as u64;
        let limits = self.device.device.limits();
        if size > limits.max_storage_buffer_binding_size.min(limits.max_buffer_size) {
            return Err(Error::Limit(format!(
                "picture of {} MiB: {} cannot show it",
                size >> 20,
                self.device.info.name
            )));
        }
        if self.upload.as_ref().is_none_or(|b| b.size() < size) {
            self.upload = Some(self.device.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("uploaded picture"),
                size,
                usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::COPY_SRC,
                mapped_at_creation: false,
            }));
        }
        if let Some(buffer) = &self.upload {
            self.device.queue.write_buffer(buffer, 0, bytemuck::cast_slice(pixels));
        }
        Ok(())
    }

    /// Shows a picture of `size` pixels and egui's painting over it. `grab` gets what was shown, RGBA row by row.
    pub fn show(
        &mut self,
        window: &Arc<Window>,
        picture: Picture<'_>,
        size: [u32; 2],
        painting: &mut Painting,
        grab: Option<&mut Vec<[u8; 4]>>,
    ) -> Result<Shown> {
        let gpu = self.device.device.clone();
        let surface_size = self.size();
        if let Picture::Here(Some(pixels)) = picture {
            self.upload(pixels)?;
        }
        let mut encoder = gpu.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("window") });
        let screen =
            egui_wgpu::ScreenDescriptor { size_in_pixels: surface_size, pixels_per_point: painting.pixels_per_point };
        for (id, deltas) in painting.textures.set.drain() {
            for delta in deltas {
                self.painter.update_texture(&gpu, &self.device.queue, id, &delta);
            }
        }
        let extra = self.painter.update_buffers(&gpu, &self.device.queue, &mut encoder, &painting.primitives, &screen);
        use wgpu::CurrentSurfaceTexture as Current;
        let current = match (self.trouble.take(), &self.surface) {
            (Some(Trouble::Outdated), _) => Current::Outdated,
            (None, Some(surface)) => surface.get_current_texture(),
            (Some(Trouble::Lost), _) | (None, None) => Current::Lost,
        };
        let (texture, suboptimal) = match current {
            Current::Success(texture) => (texture, false),
            Current::Suboptimal(texture) => (texture, true),
            other => {
                // What was written is sent, or it would pile up.
                self.device.queue.submit(extra.into_iter().chain([encoder.finish()]));
                return match other {
                    Current::Timeout | Current::Occluded => Ok(Shown::Later),
                    Current::Lost => {
                        self.renewed[1] += 1;
                        // A window has one surface at a time.
                        self.surface = None;
                        self.surface = Some(surface(&self.instance, window)?);
                        self.configure();
                        Ok(Shown::Again)
                    }
                    Current::Outdated => {
                        self.renewed[0] += 1;
                        self.configure();
                        Ok(Shown::Again)
                    }
                    _ => Err(Error::Device(format!("{}: the window's surface is not valid", self.device.info.name))),
                };
            }
        };
        let view = texture.texture.create_view(&wgpu::TextureViewDescriptor::default());
        let mut show = |picture: Shaded<'_>| self.presenter.show(&mut encoder, &texture.texture, picture, size);
        self.way = match picture {
            Picture::None => None,
            Picture::OnDevice(drawer) => drawer.with_picture(&mut show),
            Picture::Here(_) => self.upload.as_ref().map(|buffer| show(Shaded { buffer, order: ByteOrder::Rgba })),
        };
        let load = if self.way.is_some() { wgpu::LoadOp::Load } else { wgpu::LoadOp::Clear(wgpu::Color::BLACK) };
        {
            let mut pass = encoder
                .begin_render_pass(&wgpu::RenderPassDescriptor {
                    label: Some("panel"),
                    color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                        view: &view,
                        depth_slice: None,
                        resolve_target: None,
                        ops: wgpu::Operations { load, store: wgpu::StoreOp::Store },
                    })],
                    ..wgpu::RenderPassDescriptor::default()
                })
                .forget_lifetime();
            self.painter.render(&mut pass, &painting.primitives, &screen);
        }
        let grabbed = match &grab {
            Some(_) => Some(self.copy(&mut encoder, &texture.texture)?),
            None => None,
        };
        self.device.queue.submit(extra.into_iter().chain([encoder.finish()]));
        if self.way.is_some() {
            self.present_ms = self.presenter.ms();
        }
        if let (Some(out), Some(buffer)) = (grab, grabbed) {
            *out = self.fetch(&buffer)?;
        }
        window.pre_present_notify();
        self.device.queue.present(texture);
        for id in painting.textures.free.drain() {
            self.painter.free_texture(&id);
        }
        if suboptimal {
            self.configure();
        }
        Ok(Shown::Yes)
    }

    /// Bytes of a row of a copied texture.
    fn row(&self) -> u32 {
        (4 * self.config.width).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT)
    }

    fn copy(&self, encoder: &mut wgpu::CommandEncoder, texture: &wgpu::Texture) -> Result<wgpu::Buffer> {
        if ByteOrder::of(self.config.format).is_none() || !self.config.usage.contains(wgpu::TextureUsages::COPY_SRC) {
            return Err(Error::Device(format!("{}: what the window shows cannot be read back", self.device.info.name)));
        }
        let buffer = self.device.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("grab"),
            size: u64::from(self.row()) * u64::from(self.config.height),
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(self.row()), rows_per_image: None };
        let to = wgpu::TexelCopyBufferInfo { buffer: &buffer, layout };
        encoder.copy_texture_to_buffer(texture.as_image_copy(), to, texture.size());
        Ok(buffer)
    }

    fn fetch(&self, buffer: &wgpu::Buffer) -> Result<Vec<[u8; 4]>> {
        let failed = |e: String| Error::Device(format!("{}: what the window shows: {e}", self.device.info.name));
        let (send, mapped) = mpsc::channel();
        buffer.map_async(wgpu::MapMode::Read, .., move |result| {
            let _ = send.send(result);
        });
        self.device.device.poll(wgpu::PollType::wait_indefinitely()).map_err(|e| failed(e.to_string()))?;
        mapped.recv().map_err(|e| failed(e.to_string()))?.map_err(|e| failed(e.to_string()))?;
        let bytes = buffer.get_mapped_range(..).map_err(|e| failed(e.to_string()))?;
        let order = ByteOrder::of(self.config.format).unwrap_or_default();
        let rows = bytes.chunks(self.row() as usize).flat_map(|row| row[..4 * self.config.width as usize].chunks(4));
        Ok(rows.map(|p| order.swap([p[0], p[1], p[2], 255])).collect())
    }
}

impl std::fmt::Debug for Canvas {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Canvas").field("adapter", &self.adapter.get_info().name).finish_non_exhaustive()
    }
}

/// Plain pixels, where wgpu has no adapter for the window: no panel, and the CPU draws.
pub struct Plain {
    surface: softbuffer::Surface<Arc<Window>, Arc<Window>>,
}

impl Plain {
    pub fn new(window: &Arc<Window>) -> Result<Plain> {
        let failed = |e: softbuffer::SoftBufferError| Error::Device(format!("no pixels for the window: {e}"));
        let context = softbuffer::Context::new(window.clone()).map_err(failed)?;
        Ok(Plain { surface: softbuffer::Surface::new(&context, window.clone()).map_err(failed)? })
    }

    /// Shows a picture of `size` pixels on a window of `surface` pixels, the nearest pixel where they differ.
    /// `grab` gets what is shown.
    pub fn show(
        &mut self,
        pixels: &[[u8; 4]],
        size: [u32; 2],
        surface: [u32; 2],
        grab: Option<&mut Vec<[u8; 4]>>,
    ) -> Result<()> {
        let failed = |e: softbuffer::SoftBufferError| Error::Device(format!("cannot draw in the window: {e}"));
        let [Some(w), Some(h)] = surface.map(NonZeroU32::new) else { return Ok(()) };
        self.surface.resize(w, h).map_err(failed)?;
        let mut buffer = self.surface.buffer_mut().map_err(failed)?;
        let at = |v: usize, n: u32, of: u32| v * n as usize / of as usize;
        for (y, row) in buffer.chunks_mut(w.get() as usize).enumerate() {
            let from = at(y, size[1], surface[1]) * size[0] as usize;
            for (x, out) in row.iter_mut().enumerate() {
                let [r, g, b, _] = pixels[from + at(x, size[0], surface[0])];
                *out = u32::from_be_bytes([0, r, g, b]);
            }
        }
        if let Some(out) = grab {
            *out = buffer.iter().map(|p| p.to_be_bytes()).map(|[_, r, g, b]| [r, g, b, 255]).collect();
        }
        buffer.present().map_err(failed)
    }
}
