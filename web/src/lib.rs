//! The page's half of planecast: what JavaScript calls. Scene, controls and kernels are those of the window.
//!
//! JavaScript has the events, the files and the words; this has the scene and the camera. Files are read in a worker, by an
//! instance of its own ([`Reader`], [`read`]): what other crates' readers do there ends neither the scene nor the page. Tiles of
//! worlds that are too large for that are read or made in workers too, as frames want them ([`distant::Tiles`]).
//!
//! Nothing here waits: frames are sent to the GPU and shown, figures arrive later. Without WebGPU the CPU draws, one thread, and
//! JavaScript shows the pixels.

mod distant;

use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};

use glam::DVec3;
use planecast::World;
use planecast::cpu::exact;
use planecast::film::path::Pose;
use planecast::film::tour::{self, View};
use planecast::frame::picture::Stats;
use planecast::gpu::present::{ByteOrder, Device, Presenter};
use planecast::render::drawer::{Drawer, Drawn, Draws};
use planecast::view::control::{Control, Ground, Mode};
use planecast::world::parcel::{Orders, Parcels};
use planecast::{CpuRenderer, Kernel, Options, Outputs};
use planecast_encoder::format::write;
use planecast_encoder::store::ranges::HEAD;
use planecast_encoder::{ArrivingFile, Error, Scene, TileSource};
use serde_json::json;
use wasm_bindgen::prelude::*;
use web_sys::HtmlCanvasElement;

/// Vertical field of view, degrees.
const FOV: f64 = 60.0;

const KERNEL: Kernel = Kernel::Workgroup;

/// Seconds that tiles are ordered ahead, as far as it can be told where the camera will be.
const AHEAD: f64 = 0.25;

/// Seconds after which a frame that lacks tiles is drawn once more, so that those that failed are asked for again.
const AGAIN: f64 = 0.3;

/// Pixels a side at most: what every WebGPU device can show.
const SIDE: u32 = 8192;

fn failed(error: impl std::fmt::Display) -> JsValue {
    JsValue::from_str(&error.to_string())
}

#[wasm_bindgen(start)]
fn start() {
    console_error_panic_hook::set_once();
}

/// A canvas that WebGPU shows pictures on.
struct Shows {
    surface: wgpu::Surface<'static>,
    config: wgpu::SurfaceConfiguration,
    device: Device,
    presenter: Presenter,
}

/// A page that a scene is flown through on.
#[wasm_bindgen]
pub struct Page {
    shows: Option<Shows>,
    held: Option<Held>,
    drawer: Option<Drawer>,
    control: Control,
    /// The level of the file that is level 0 of the scene: finer ones are on their way.
    level: u32,
    options: Options,
    size: [u32; 2],
    drawn: Option<(Pose, [u32; 2], Options)>,
    /// The CPU's picture, RGBA.
    pixels: Vec<u8>,
    stats: Stats,
    /// Seconds since a frame was drawn, and whether tiles came meanwhile.
    since: f64,
    arrived: bool,
    /// The picture that is read back for [`Page::picture`].
    reading: Option<Reading>,
}

/// The scene as it is kept.
enum Held {
    Whole(Arc<World>),
    Tiles(Arc<Parcels>, Orders),
}

impl Held {
    fn good_view(&self, view: View) -> Pose {
        match self {
            Held::Whole(world) => tour::still(&world.scene, view),
            Held::Tiles(parcels, _) => parcels.preview.pose(tour::still(&parcels.preview.scene, view)),
        }
    }

    /// The middle of what there is, and whether that is land.
    fn subject(&self) -> (DVec3, bool) {
        match self {
            Held::Whole(world) => {
                let subject = tour::Subject::new(&world.scene);
                (subject.center(), subject.terrain)
            }
            Held::Tiles(parcels, _) => {
                let preview = &parcels.preview;
                let subject = tour::Subject::new(&preview.scene);
                (preview.origin + subject.center() * preview.scale, subject.terrain)
            }
        }
    }
}

struct Reading {
    buffer: wgpu::Buffer,
    order: ByteOrder,
    mapped: Receiver<Result<(), wgpu::BufferAsyncError>>,
}

async fn shows(canvas: HtmlCanvasElement, [width, height]: [u32; 2]) -> Result<Shows, String> {
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
    let surface = instance.create_surface(wgpu::SurfaceTarget::Canvas(canvas)).map_err(|e| e.to_string())?;
    let wanted = wgpu::RequestAdapterOptions {
        power_preference: wgpu::PowerPreference::HighPerformance,
        compatible_surface: Some(&surface),
        ..wgpu::RequestAdapterOptions::default()
    };
    let adapter = instance.request_adapter(&wanted).await.map_err(|e| e.to_string())?;
    let (device, queue) = adapter.request_device(&Device::wishes(&adapter)).await.map_err(|e| e.to_string())?;
    let mut config = surface.get_default_config(&adapter, width, height).ok_or("the canvas cannot be drawn on")?;
    let formats = surface.get_capabilities(&adapter).formats;
    config.format = formats.into_iter().find(|f| !f.is_srgb()).unwrap_or(config.format);
    let device = Device::new(adapter.get_info(), device, queue);
    config.usage |= Presenter::usage(&device, config.format, surface.get_capabilities(&adapter).usages);
    surface.configure(&device.device, &config);
    let presenter = Presenter::new(&device, config.format, config.usage);
    Ok(Shows { surface, config, device, presenter })
}

#[wasm_bindgen]
impl Page {
    /// On a canvas, with WebGPU if `gpu` says so; an error says why there is none.
    pub async fn open(canvas: HtmlCanvasElement, gpu: bool) -> Result<Page, JsValue> {
        let size = [canvas.width(), canvas.height()].map(|n| n.clamp(1, SIDE));
        let shows = if gpu { Some(shows(canvas, size).await.map_err(failed)?) } else { None };
        let pose = Pose { eye: DVec3::ZERO, yaw: 0.0, pitch: 0.0, roll: 0.0, fov: FOV };
        Ok(Page {
            shows,
            held: None,
            drawer: None,
            control: Control::new(pose, [1; 3]),
            level: 0,
            options: Options::default(),
            size,
            drawn: None,
            pixels: Vec::new(),
            stats: Stats::default(),
            since: 0.0,
            arrived: false,
            reading: None,
        })
    }

    /// Goes into a scene, from the bytes of a scene file as [`Reader::scene`] or [`read`] give it. `level`: of the file that
    /// it comes from, the one that is its finest. `goes_on`: it is the scene that is there, with finer levels; the camera stays
    /// where it is. What it is, as JSON.
    pub fn load(&mut self, name: &str, bytes: Vec<u8>, level: u32, goes_on: bool) -> Result<String, JsValue> {
        let world = Arc::new(World::from_bytes(Path::new(name), bytes).map_err(failed)?);
        // First the old one's memory.
        (self.drawer, self.held) = (None, None);
        let (draws, device) = self.draws();
        let drawer = Drawer::new(&world, draws, device).map_err(failed)?;
        let facts = json!({
            "dims": world.resident.dims,
            "levels": world.resident.levels.len(),
            "bytes": world.resident.bytes(),
            "level": level,
        });
        if goes_on {
            self.control.scale(f64::from(self.level).exp2() / f64::from(level).exp2());
        }
        let dims = world.resident.dims;
        self.hold(Held::Whole(world), drawer, dims, level, !goes_on);
        Ok(facts.to_string())
    }

    /// Goes into a world whose tiles come as they are ordered, from what [`distant::Tiles::facts`] says; at most so many bytes of
    /// tiles are kept. What it is, as JSON.
    pub fn load_tiles(&mut self, facts: &[u8], bytes: f64) -> Result<String, JsValue> {
        let parcels = Arc::new(Parcels::open(facts).map_err(failed)?);
        (self.drawer, self.held) = (None, None);
        (self.options.repeat.x, self.options.repeat.z) = (false, false);
        let (draws, device) = self.draws();
        let (drawer, orders) = Drawer::of_parcels(Arc::clone(&parcels), bytes as u64, draws, device).map_err(failed)?;
        let dims = parcels.dims();
        let facts = json!({"dims": dims, "levels": parcels.levels(), "bytes": bytes, "level": 0, "tiles": true});
        self.hold(Held::Tiles(parcels, orders), drawer, dims, 0, true);
        Ok(facts.to_string())
    }

    fn draws(&self) -> (Draws, Option<&Device>) {
        match &self.shows {
            Some(shows) => (Draws::Gpu(KERNEL), Some(&shows.device)),
            None => (Draws::Cpu, None),
        }
    }

    /// Takes a scene and what draws it; the camera goes to its good view where it is `new`.
    fn hold(&mut self, held: Held, mut drawer: Drawer, dims: [u32; 3], level: u32, new: bool) {
        if let Some(shows) = &self.shows {
            drawer.set_order(shows.presenter.order());
        }
        if new {
            let view = View { fov: FOV, size: self.size, repeat: self.options.repeat };
            self.control = Control::new(held.good_view(view), dims);
            // What the file says of its kind does not come this far: its shape tells.
            let (center, terrain) = held.subject();
            self.control.target = center;
            self.control.set_mode(if terrain { Mode::Solid } else { Mode::Orbit });
        }
        self.level = level;
        (self.drawer, self.held) = (Some(drawer), Some(held));
        self.drawn = None;
        self.stats = Stats::default();
    }

    /// The tile to be fetched or made next: number of the order, level, x, z, and whether as heights (1); nothing where none is.
    pub fn order(&mut self) -> Vec<u32> {
        let Some(Held::Tiles(_, orders)) = &mut self.held else { return Vec::new() };
        let order = orders.take();
        order.map_or(Vec::new(), |o| vec![o.number, o.key.level, o.key.x, o.key.z, u32::from(o.heights)])
    }

    /// Takes the parcel of an order.
    pub fn deliver(&mut self, number: u32, parcel: &[u8]) {
        if let Some(Held::Tiles(_, orders)) = &mut self.held {
            orders.deliver(number, Ok(parcel));
            self.arrived = true;
        }
    }

    /// Takes the news that an order came to nothing.
    pub fn refuse(&mut self, number: u32, why: &str) {
        if let Some(Held::Tiles(_, orders)) = &mut self.held {
            orders.deliver(number, Err(planecast::Error::Scene(Error::Limit(why.into()))));
            self.arrived = true;
        }
    }

    /// Tiles that are on their way, and how wrong the picture is without them; nothing where it is right.
    pub fn owed(&self) -> String {
        self.stats.owed().unwrap_or_default()
    }

    /// What is to be said since this was asked last, in lines.
    pub fn notices(&mut self) -> String {
        self.drawer.as_mut().map(Drawer::take_notices).unwrap_or_default().join("\n")
    }

    /// A key went down or up, by its `code`; whether it means anything here.
    pub fn key(&mut self, code: &str, down: bool) -> bool {
        if self.control.key(code, down) {
            return true;
        }
        match code {
            "KeyG" if down => {
                let next = Mode::ALL.iter().position(|m| *m == self.control.mode()).unwrap_or(0) + 1;
                self.control.set_mode(Mode::ALL[next % Mode::ALL.len()]);
            }
            "KeyZ" if down => self.control.pose.roll = 0.0,
            "Home" if down => {
                if let Some(held) = &self.held {
                    let view = View { fov: FOV, size: self.size, repeat: self.options.repeat };
                    self.control.target = held.subject().0;
                    self.control.place(held.good_view(view));
                }
            }
            _ => return false,
        }
        true
    }

    /// Lets go of all keys.
    pub fn release(&mut self) {
        self.control.release();
    }

    pub fn look(&mut self, dx: f64, dy: f64) {
        self.control.look(dx, dy);
    }

    /// Moves across the picture: what is in its middle follows a finger over so many pixels.
    pub fn pan(&mut self, dx: f64, dy: f64) {
        self.control.pan(dx, dy, f64::from(self.size[1]));
    }

    /// Comes nearer by so many notches of a wheel.
    pub fn nearer(&mut self, notches: f64) {
        self.control.nearer(notches);
    }

    /// Goes to a place, as [`Page::pose`] tells it, in voxels of the file's level 0; false where that is none.
    pub fn place(&mut self, eye: &[f64], yaw: f64, pitch: f64, roll: f64, mode: &str) -> bool {
        let sound = eye.len() == 3 && eye.iter().chain([&yaw, &roll]).all(|v| v.is_finite());
        if !sound || !(-90.0..=90.0).contains(&pitch) {
            return false;
        }
        if let Some(mode) = Mode::ALL.into_iter().find(|m| m.name() == mode) {
            self.control.set_mode(mode);
        }
        let eye = DVec3::from_slice(eye) / f64::from(self.level).exp2();
        self.control.place(Pose { eye, yaw, pitch, roll, ..self.control.pose });
        true
    }

    pub fn wheel(&mut self, notches: f64) {
        self.control.wheel(notches);
    }

    /// Flies to what shows at a pixel of the canvas; false where that is the sky.
    pub fn fly_to(&mut self, x: f64, y: f64) -> bool {
        let camera = self.control.pose.camera(self.size);
        let ray = camera.ray(&camera.basis(), x, y).normalize_or_zero();
        let eye = self.control.pose.eye;
        if !ray.is_finite() || ray == DVec3::ZERO || !eye.is_finite() {
            return false;
        }
        let repeats = [self.options.repeat.x, self.options.repeat.z];
        let met = match &self.held {
            Some(Held::Whole(world)) => {
                exact::cast(&world.scene.levels[0].solid, repeats, eye, ray, 1e7).map(|hit| hit.t)
            }
            Some(Held::Tiles(..)) => {
                let probe = self.drawer.as_ref().and_then(Drawer::probe);
                probe.and_then(|probe| probe.cast(eye, ray, 1e7)).map(|met| met.t)
            }
            None => None,
        };
        if let Some(t) = met {
            self.control.fly_to(ray, t);
        }
        met.is_some()
    }

    /// Tiles the world without end, or not; a world that comes in tiles does not repeat.
    pub fn repeat(&mut self, on: bool) {
        let on = on && !matches!(self.held, Some(Held::Tiles(..)));
        (self.options.repeat.x, self.options.repeat.z) = (on, on);
    }

    /// One of the presets, by name; false where there is none of it.
    pub fn preset(&mut self, name: &str) -> bool {
        let preset = planecast::frame::preset::Preset::ALL.into_iter().find(|p| p.name() == name);
        self.options = preset.map_or(self.options, |p| p.options(self.options));
        preset.is_some()
    }

    /// The picture has another size, pixels.
    pub fn resize(&mut self, width: u32, height: u32) {
        self.size = [width, height].map(|n| n.clamp(1, SIDE));
        self.drawn = None;
        if let Some(Shows { surface, config, device, .. }) = &mut self.shows {
            [config.width, config.height] = self.size;
            surface.configure(&device.device, config);
        }
    }

    /// Lets `seconds` pass, draws and shows. Whether anything was drawn, as the view had changed.
    pub fn frame(&mut self, seconds: f64) -> Result<bool, JsValue> {
        let (Some(drawer), Some(held)) = (&mut self.drawer, &self.held) else { return Ok(false) };
        let before = self.control.pose;
        match held {
            Held::Whole(world) => {
                self.control.step(seconds, &Ground::new(&world.scene.levels[0].solid, self.options.repeat));
            }
            Held::Tiles(parcels, _) => {
                let probe = drawer.probe().expect("it draws tiles");
                self.control.step(seconds, &Ground::of_voxels(parcels.dims(), &|x, y, z| probe.solid(x, y, z)));
            }
        }
        let pose = self.control.pose;
        let soon = (pose != before && seconds > 0.0).then(|| pose.ahead(before, AHEAD / seconds));
        let job = (pose, self.size, self.options);
        if let Some(stats) = drawer.figures().map_err(failed)? {
            self.stats = stats;
        }
        self.since += seconds;
        // A frame that shows nothing but tiles that came leaves a device that is slow as much time for them.
        let pause = 2e-3 * self.stats.gpu_ms.or(self.stats.cpu_ms).map_or(0.0, |ms| ms.total);
        let news = self.arrived && self.since > pause;
        let lacks = self.stats.paging.tiles_missing > 0 && self.since > AGAIN.max(pause);
        // Nothing in a page waits for the GPU: one that is slow must not be sent more than it draws.
        if (self.drawn == Some(job) && !news && !lacks) || drawer.waiting() > 1 {
            return Ok(false);
        }
        (self.since, self.arrived) = (0.0, false);
        let (camera, soon) = (pose.camera(self.size), soon.map(|pose| pose.camera(self.size)));
        match drawer.draw(&camera, soon.as_ref(), &self.options).map_err(failed)? {
            Drawn::Here(frame) => {
                self.stats = frame.stats.clone();
                self.pixels = frame.color.concat();
            }
            Drawn::OnDevice => self.show()?,
        }
        self.drawn = Some(job);
        Ok(true)
    }

    fn show(&mut self) -> Result<(), JsValue> {
        let (Some(shows), Some(drawer)) = (&mut self.shows, &self.drawer) else { return Ok(()) };
        use wgpu::CurrentSurfaceTexture as Current;
        let texture = match shows.surface.get_current_texture() {
            Current::Success(texture) | Current::Suboptimal(texture) => texture,
            // The canvas is hidden: the picture is there when it is not.
            _ => return Ok(()),
        };
        let gpu = &shows.device.device;
        let mut encoder = gpu.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        drawer.with_picture(|p| shows.presenter.show(&mut encoder, &texture.texture, p, self.size));
        shows.device.queue.submit([encoder.finish()]);
        shows.device.queue.present(texture);
        shows.device.check().map_err(failed)
    }

    /// The CPU's picture, RGBA; empty where the GPU draws.
    pub fn pixels(&self) -> Vec<u8> {
        self.pixels.clone()
    }

    /// Width and height of the picture.
    pub fn size(&self) -> Vec<u32> {
        self.size.into()
    }

    /// What the latest frame cost, as JSON.
    pub fn figures(&self) -> String {
        json!(self.stats).to_string()
    }

    /// Where the camera is, as JSON.
    pub fn pose(&self) -> String {
        let Pose { eye, yaw, pitch, roll, fov } = self.control.pose;
        // In voxels of the file's level 0, whatever is there of it.
        let voxel = f64::from(self.level).exp2();
        json!({"eye": (eye * voxel).to_array(), "yaw": yaw, "pitch": pitch, "roll": roll, "fov": fov,
               "speed": self.control.speed * voxel, "mode": self.control.mode().name()})
        .to_string()
    }

    /// Begins to read the GPU's picture back: [`Page::picture`] has it later.
    pub fn read_picture(&mut self) -> bool {
        let (Some(shows), Some(drawer)) = (&self.shows, &self.drawer) else { return false };
        let size = 4 * u64::from(self.size[0]) * u64::from(self.size[1]);
        let gpu = &shows.device.device;
        let buffer = gpu.create_buffer(&wgpu::BufferDescriptor {
            label: Some("picture"),
            size,
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        let mut encoder = gpu.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let order = drawer.with_picture(|p| {
            encoder.copy_buffer_to_buffer(p.buffer, 0, &buffer, 0, size);
            p.order
        });
        shows.device.queue.submit([encoder.finish()]);
        let (send, mapped) = channel();
        buffer.map_async(wgpu::MapMode::Read, .., move |result| {
            // The page may have gone on.
            let _ = send.send(result);
        });
        self.reading = order.map(|order| Reading { buffer, order, mapped });
        order.is_some()
    }

    /// The GPU's picture as read back, RGBA; nothing while it is on its way.
    pub fn picture(&mut self) -> Result<Option<Vec<u8>>, JsValue> {
        let (Some(shows), Some(reading)) = (&self.shows, &self.reading) else { return Ok(None) };
        shows.device.check().map_err(failed)?;
        let Ok(mapped) = reading.mapped.try_recv() else { return Ok(None) };
        mapped.map_err(failed)?;
        let mut bytes = reading.buffer.get_mapped_range(..).map_err(failed)?.to_vec();
        for pixel in bytes.as_chunks_mut().0 {
            *pixel = reading.order.swap(*pixel);
        }
        self.reading = None;
        Ok(Some(bytes))
    }

    /// The same view by the CPU's kernels, RGBA.
    pub fn cpu_picture(&self) -> Result<Vec<u8>, JsValue> {
        let Some(Held::Whole(world)) = &self.held else { return Ok(Vec::new()) };
        let mut cpu = CpuRenderer::new(&world.scene, &world.resident);
        let camera = self.control.pose.camera(self.size);
        let frame = cpu.render(&camera, &self.options, Outputs::default()).map_err(failed)?;
        Ok(frame.color.concat())
    }
}

/// A scene as a file without compression: what a page reads by this project's own reader alone.
fn plain(name: &str, scene: &Scene) -> Result<Vec<u8>, JsValue> {
    let mut out = std::io::Cursor::new(Vec::new());
    write::write_scene_to(scene, &mut out, Path::new(name)).map_err(failed)?;
    Ok(out.into_inner())
}

/// The scene that a scene file or an input has, for [`Page::load`].
#[wasm_bindgen]
pub fn read(name: &str, bytes: Vec<u8>) -> Result<Vec<u8>, JsValue> {
    plain(name, &World::from_bytes(Path::new(name), bytes).map_err(failed)?.scene)
}

/// For tests: what happens when a reader gives up.
#[wasm_bindgen]
pub fn give_up() {
    panic!("asked to");
}

/// A scene file that is fetched in parts, coarse to fine.
#[wasm_bindgen]
pub struct Reader {
    name: String,
    file: ArrivingFile,
}

#[wasm_bindgen]
impl Reader {
    /// Bytes to fetch before anything of a file is known.
    pub fn head() -> f64 {
        HEAD as f64
    }

    /// From the first bytes of a file; `len` is how many it has, where the server says so.
    #[wasm_bindgen(constructor)]
    pub fn new(name: &str, head: Vec<u8>, len: Option<f64>) -> Result<Reader, JsValue> {
        let file = ArrivingFile::new(Path::new(name), head, len.map(|len| len as u64)).map_err(failed)?;
        Ok(Reader { name: name.into(), file })
    }

    /// Ranges of bytes to fetch next, begin and end in turn; none when all is there.
    pub fn wanted(&self) -> Vec<f64> {
        self.file.wanted().iter().flat_map(|r| [r.start as f64, r.end as f64]).collect()
    }

    /// Takes one of those ranges.
    pub fn put(&mut self, at: f64, bytes: &[u8]) -> Result<(), JsValue> {
        self.file.put(at as u64, bytes).map_err(failed)
    }

    /// Bytes that are there, and of the file.
    pub fn progress(&self) -> Vec<f64> {
        self.file.progress().map(|n| n as f64).into()
    }

    /// The finest level that is there.
    pub fn level(&self) -> Option<u32> {
        self.file.level().map(|level| level as u32)
    }

    /// The scene from that level on, for [`Page::load`].
    pub fn scene(&self) -> Result<Option<Vec<u8>>, JsValue> {
        let scene = self.file.read_scene().map_err(failed)?;
        scene.map(|scene| plain(&self.name, &scene)).transpose()
    }
}
