//! The window: events in, frames out, and going on whatever happens to its surface and its device.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant, SystemTime};

use glam::DVec3;
use winit::application::ApplicationHandler;
use winit::dpi::PhysicalSize;
use winit::event::{DeviceEvent, DeviceId, ElementState, MouseButton, MouseScrollDelta, StartCause, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop};
use winit::keyboard::PhysicalKey;
use winit::window::{CursorGrabMode, Fullscreen, Window, WindowId};

use super::canvas::{Canvas, Painting, Picture, Plain, Shown};
use super::control::{Control, Ground, Mode};
use super::map::{LEGEND, error_map};
use super::pace::Pace;
use super::panel::{self, Cost, Panel, Subject, Wish};
use super::record::Recorder;
use super::script::{self, Action, Script};
use super::{Settings, last, pose_flags};
use crate::cpu::exact;
use crate::cpu::renderer::{CpuRenderer, Outputs};
use crate::film::path::{Path as Route, Pose};
use crate::film::tour::{self, View};
use crate::frame::aim::Typed;
use crate::frame::camera::Camera;
use crate::frame::options::Options;
use crate::frame::picture::{Frame, Stats};
use crate::frame::preset::Preset;
use crate::gpu::present::Way;
use crate::render::device::Device;
use crate::render::drawer::{Drawer, Drawn, Draws};
use crate::world::{Opening, World};
use crate::{Error, Kernel, Result, cli, output};

/// Frames that are drawn after the last change, so that figures arrive and egui comes to rest.
const LINGER: u32 = 6;

/// How long words stay on the screen.
const WORDS: Duration = Duration::from_secs(6);

/// A second click this soon and this near, pixels, is a double click.
const DOUBLE: (Duration, f64) = (Duration::from_millis(400), 6.0);

/// Devices lost within a minute before the CPU takes over.
const LOSSES: usize = 3;

/// Seconds that pass in a frame at most: while the machine slept, or the window was away, nothing went on.
const LONGEST: f64 = 0.25;

/// How long a script waits for the window to take a size or a scale.
const PATIENCE: Duration = Duration::from_secs(10);

/// Opens the window and stays until it is closed.
pub fn run(settings: Settings) -> Result<()> {
    let script = settings.script.as_ref().map(|path| Script::read(path)).transpose()?;
    let event_loop = EventLoop::new().map_err(|e| no_window(&e))?;
    let mut app = App::new(settings, script);
    event_loop.run_app(&mut app).map_err(|e| no_window(&e))?;
    app.outcome
}

fn no_window(error: &dyn std::fmt::Display) -> Error {
    let text = error.to_string();
    // winit begins with the place in its own source.
    let why = text.split_once(".rs:").and_then(|(_, rest)| rest.split_once(": ")).map_or(text.as_str(), |(_, why)| why);
    Error::Device(format!("no window can be opened: {}; planecast render and fly need none", why.trim_end_matches('.')))
}

/// The window and what shows in it.
struct Screen {
    window: Arc<Window>,
    surface: Surface,
    egui: egui_winit::State,
    ctx: egui::Context,
}

enum Surface {
    Gpu(Box<Canvas>),
    Plain(Box<Plain>),
}

/// What a script waits for.
#[derive(Clone, Copy)]
enum Awaited {
    Size([u32; 2]),
    Scale(f64),
}

/// The error map of a view: on its way, then there.
struct Map {
    camera: Camera,
    options: Options,
    frame: Frame,
    exact: Receiver<Result<Frame>>,
    done: Option<(Vec<[u8; 4]>, String)>,
}

struct App {
    settings: Settings,
    outcome: Result<()>,
    screen: Option<Screen>,
    opening: Option<Opening>,
    world: Option<Arc<World>>,
    drawer: Option<Drawer>,
    /// What draws, or would.
    draws: Draws,
    control: Control,
    options: Options,
    panel: Panel,
    recorder: Recorder,
    route: Option<Route>,
    pace: Option<Pace>,
    map: Option<Map>,
    /// What was drawn last, and its pixels if they came here.
    drawn: Option<(Camera, Options, Draws)>,
    pixels: Option<Frame>,
    /// What stays on the screen, and what goes after a while.
    notes: Vec<String>,
    words: Vec<(String, Instant)>,
    script: Option<Script>,
    /// What the script waits for, and since when.
    awaited: Option<(Awaited, Instant)>,
    /// Nothing of the window can be seen.
    occluded: bool,
    grab: Option<PathBuf>,
    /// Pixels of the window; 0 × 0 while it is minimised.
    size: [u32; 2],
    /// Pixels a point.
    scale: f64,
    cursor: [f64; 2],
    dragging: bool,
    captured: bool,
    clicked: Option<(Instant, [f64; 2])>,
    then: Instant,
    linger: u32,
    losses: Vec<Instant>,
    shown: Vec<Instant>,
    repaint_at: Option<Instant>,
}

impl App {
    fn new(settings: Settings, script: Option<Script>) -> App {
        let input = settings.input.clone();
        let pose = Pose { eye: DVec3::ZERO, yaw: 0.0, pitch: 0.0, roll: 0.0, fov: settings.fov };
        let (options, target) = (settings.options, settings.target_fps);
        App {
            panel: Panel {
                holds: target.is_some(),
                target_fps: target.unwrap_or(60.0),
                vsync: script.is_none(),
                screenshot_size: settings.screenshot_size,
                ..Panel::default()
            },
            opening: input.map(|path| Opening::begin(&path, &settings.how)),
            settings,
            outcome: Ok(()),
            screen: None,
            world: None,
            drawer: None,
            draws: Draws::Cpu,
            control: Control::new(pose, [1; 3]),
            options,
            recorder: Recorder::default(),
            route: None,
            pace: None,
            map: None,
            drawn: None,
            pixels: None,
            notes: Vec::new(),
            words: Vec::new(),
            script,
            awaited: None,
            scale: 1.0,
            occluded: false,
            grab: None,
            size: [0; 2],
            cursor: [0.0; 2],
            dragging: false,
            captured: false,
            clicked: None,
            then: Instant::now(),
            linger: LINGER,
            losses: Vec::new(),
            shown: Vec::new(),
            repaint_at: None,
        }
    }

    fn say(&mut self, what: impl Into<String>) {
        let what = what.into();
        self.words.retain(|(text, _)| *text != what);
        self.words.push((what, Instant::now() + WORDS));
        self.linger = LINGER;
    }

    fn fail(&mut self, event_loop: &ActiveEventLoop, error: Error) {
        self.outcome = Err(error);
        event_loop.exit();
    }

    /// A surface for the window, and what draws on it.
    fn surface(&mut self, window: &Arc<Window>) -> Result<Surface> {
        self.notes.clear();
        let kernel = self.settings.kernel.as_deref();
        let gpu_kernel = || kernel.map_or(Ok(Kernel::default()), str::parse::<Kernel>);
        let only = |name: &str| match kernel {
            Some(k) if k != name => Err(Error::Argument(format!("kernel {k}: this device has only {name}"))),
            _ => Ok(()),
        };
        let canvas = Canvas::new(window, self.script.is_some());
        self.draws = match (self.settings.device, &canvas) {
            (Device::Exact, _) => only("exact").map(|()| Draws::Exact)?,
            (Device::Cpu, _) => only("planes").map(|()| Draws::Cpu)?,
            (Device::Auto, _) if kernel == Some("planes") => Draws::Cpu,
            (Device::Gpu | Device::AllGpus, Ok(_)) => Draws::Gpu(gpu_kernel()?),
            (Device::Auto, Ok(canvas)) if !canvas.device.is_software() => Draws::Gpu(gpu_kernel()?),
            (Device::Auto, Ok(canvas)) if kernel.is_none() => {
                self.notes
                    .push(format!("drawing on the cpu: the only adapter is software ({})", canvas.device.info.name));
                Draws::Cpu
            }
            (Device::Auto, Ok(_)) => Draws::Gpu(gpu_kernel()?),
            (Device::Auto, Err(e)) if kernel.is_none() => {
                self.notes.push(format!("drawing on the cpu: {e}"));
                Draws::Cpu
            }
            (Device::Auto | Device::Gpu | Device::AllGpus, Err(e)) => return Err(Error::Device(e.to_string())),
        };
        Ok(match canvas {
            Ok(canvas) => Surface::Gpu(Box::new(canvas)),
            Err(_) => Surface::Plain(Box::new(Plain::new(window)?)),
        })
    }

    fn open(&mut self, event_loop: &ActiveEventLoop) -> Result<()> {
        // Opened once more, it is as large as it was.
        let [width, height] = if self.size.contains(&0) { self.settings.size } else { self.size };
        let full = self.settings.full_screen.then_some(Fullscreen::Borderless(None));
        let attributes = Window::default_attributes()
            .with_title("planecast")
            .with_inner_size(PhysicalSize::new(width, height))
            .with_fullscreen(full);
        let window = event_loop.create_window(attributes).map_err(|e| no_window(&e))?;
        let window = Arc::new(window);
        (self.size, self.scale) = (window.inner_size().into(), window.scale_factor());
        let surface = self.surface(&window)?;
        let (egui, ctx) = gui(&window, &surface);
        self.screen = Some(Screen { window, surface, egui, ctx });
        Ok(())
    }

    fn device(&self) -> Option<&crate::gpu::present::Device> {
        match &self.screen.as_ref()?.surface {
            Surface::Gpu(canvas) => Some(&canvas.device),
            Surface::Plain(_) => None,
        }
    }

    /// The name of what draws, for the panel and the title.
    fn device_name(&self) -> String {
        match (self.draws, self.device()) {
            (Draws::Gpu(_), Some(device)) => device.info.name.clone(),
            (Draws::Exact, _) => "cpu, one exact ray a pixel".into(),
            _ => format!("cpu, {} threads", rayon::current_num_threads()),
        }
    }

    /// A drawer for the world that is there; the CPU's where the GPU cannot hold it.
    fn make_drawer(&mut self) -> Result<()> {
        // First the old one's memory.
        self.drawer = None;
        (self.drawn, self.map) = (None, None);
        self.panel.costs.clear();
        let Some(world) = self.world.clone() else { return Ok(()) };
        let drawer = Drawer::new(world.clone(), self.draws, self.device());
        self.drawer = Some(match drawer {
            Err(e @ (Error::Limit(_) | Error::Device(_))) if matches!(self.draws, Draws::Gpu(_)) => {
                self.device().map_or(Ok(()), crate::gpu::present::Device::check)?;
                self.notes.push(format!("drawing on the cpu: {e}"));
                self.draws = Draws::Cpu;
                Drawer::new(world, self.draws, None)?
            }
            drawer => drawer?,
        });
        if let (Some(drawer), Some(Screen { surface: Surface::Gpu(canvas), .. })) = (&mut self.drawer, &self.screen) {
            drawer.set_order(canvas.order());
        }
        self.linger = LINGER;
        Ok(())
    }

    /// Goes into a world that was opened.
    fn enter(&mut self, world: World) -> Result<()> {
        self.leave();
        let first = self.world.is_none();
        let view = self.good_view_of(&world);
        let left = last::file().and_then(|file| last::recall(&file, &world.content_hash));
        let s = &self.settings;
        let typed = Typed { eye: s.eye, yaw: s.yaw, pitch: s.pitch, roll: s.roll.unwrap_or(0.0) };
        let is_typed = s.aim.is_given() || [s.yaw, s.pitch].iter().any(Option::is_some) || s.eye.is_some();
        let pose = match first && is_typed {
            true => {
                let size = self.size.map(|n| n.max(1));
                s.aim.pose(typed, &world.scene, View { fov: s.fov, size, repeat: self.options.repeat })?
            }
            false => {
                let pose = left.unwrap_or(view);
                Pose { roll: s.roll.filter(|_| first).unwrap_or(pose.roll), ..pose }
            }
        };
        self.control = Control::new(pose, world.resident.dims);
        (self.recorder, self.route, self.map) = (Recorder::default(), None, None);
        if let Some(screen) = &self.screen {
            screen.window.set_title(&format!("{} - planecast", world.name()));
        }
        self.world = Some(Arc::new(world));
        self.make_drawer()
    }

    /// Remembers where the world was looked at.
    fn leave(&mut self) {
        let Some(world) = self.world.as_ref().filter(|w| !w.content_hash.is_empty()) else { return };
        let Some(file) = last::file() else { return };
        let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).map_or(0, |d| d.as_secs());
        // A view that is not remembered is no reason to stay.
        if let Err(e) = last::remember(&file, &world.content_hash, &self.control.pose, now) {
            planecast_encoder::note!("note: the view is not remembered: {e}");
        }
    }

    fn good_view_of(&self, world: &World) -> Pose {
        let size = self.size.map(|n| n.max(1));
        tour::still(&world.scene, View { fov: self.settings.fov, size, repeat: self.options.repeat })
    }

    /// The device was lost, or the surface is of no use: everything on it is made anew.
    fn recover(&mut self, why: &Error) -> Result<()> {
        let now = Instant::now();
        self.losses.retain(|t| now - *t < Duration::from_secs(60));
        self.losses.push(now);
        (self.drawer, self.drawn, self.map) = (None, None, None);
        let Some(Screen { window, surface, .. }) = self.screen.take() else { return Ok(()) };
        // A window has one surface at a time.
        drop(surface);
        let surface = if self.losses.len() > LOSSES {
            self.draws = Draws::Cpu;
            self.notes.push(format!("drawing on the cpu: {why}"));
            Surface::Plain(Box::new(Plain::new(&window)?))
        } else {
            self.surface(&window)?
        };
        let (egui, ctx) = gui(&window, &surface);
        self.screen = Some(Screen { window, surface, egui, ctx });
        self.say(format!("the device was opened anew: {why}"));
        self.make_drawer()
    }

    /// What a key does once; keys that move are the control's.
    fn key(&mut self, event_loop: &ActiveEventLoop, code: &str, down: bool) {
        self.linger = LINGER;
        if self.control.key(code, down) {
            if down && matches!(self.recorder, Recorder::Playing { .. }) && code != "ShiftLeft" {
                self.recorder = Recorder::Idle;
            }
            return;
        }
        if !down {
            return;
        }
        let done = match code {
            "KeyF" | "F11" => self.wish(Wish::FullScreen),
            "F12" => self.wish(Wish::Screenshot),
            "KeyR" => self.wish(Wish::Record),
            "KeyP" => self.wish(Wish::Play),
            "KeyX" => self.wish(Wish::ErrorMap),
            "KeyC" => self.wish(Wish::CopyCommand),
            "Home" => self.wish(Wish::GoodView),
            "KeyG" => {
                let next = Mode::ALL.iter().position(|m| *m == self.control.mode()).unwrap_or(0) + 1;
                self.control.set_mode(Mode::ALL[next % Mode::ALL.len()]);
                self.say(self.control.mode().name());
                Ok(())
            }
            "KeyZ" => {
                self.control.pose.roll = 0.0;
                Ok(())
            }
            "KeyT" => {
                self.panel.holds = !self.panel.holds;
                Ok(())
            }
            "KeyM" => {
                self.capture(!self.captured);
                Ok(())
            }
            "Digit1" | "Digit2" | "Digit3" => {
                let preset = Preset::ALL[(code.as_bytes()[5] - b'1') as usize];
                self.options = preset.options(self.options);
                self.say(format!("preset {}", preset.name()));
                Ok(())
            }
            "Tab" => {
                self.panel.open = !self.panel.open;
                Ok(())
            }
            "F1" | "KeyH" => {
                self.panel.help = !self.panel.help;
                Ok(())
            }
            "Escape" => {
                let full = self.screen.as_ref().is_some_and(|s| s.window.fullscreen().is_some());
                if self.captured {
                    self.capture(false);
                } else if self.panel.help {
                    self.panel.help = false;
                } else if full {
                    return self.settle(event_loop, Ok(()), Some(Wish::FullScreen));
                } else {
                    event_loop.exit();
                }
                Ok(())
            }
            _ => Ok(()),
        };
        self.settle(event_loop, done, None);
    }

    /// What went wrong is said; a device that is lost is opened anew.
    fn settle(&mut self, event_loop: &ActiveEventLoop, done: Result<()>, wish: Option<Wish>) {
        let done = done.and_then(|()| wish.map_or(Ok(()), |w| self.wish(w)));
        let Err(error) = done else { return };
        let lost = matches!(error, Error::Device(_));
        if self.script.is_some() && !lost {
            return self.fail(event_loop, error);
        }
        if !lost {
            return self.say(error.to_string());
        }
        if let Err(e) = self.recover(&error) {
            self.fail(event_loop, e);
        }
    }

    fn capture(&mut self, on: bool) {
        let Some(screen) = &self.screen else { return };
        let mode = if on { CursorGrabMode::Locked } else { CursorGrabMode::None };
        let grabbed = screen.window.set_cursor_grab(mode);
        let grabbed = grabbed.or_else(|_| screen.window.set_cursor_grab(CursorGrabMode::Confined));
        self.captured = on && grabbed.is_ok();
        screen.window.set_cursor_visible(!self.captured);
    }

    fn wish(&mut self, wish: Wish) -> Result<()> {
        self.linger = LINGER;
        match wish {
            Wish::Draw(draws) => {
                self.draws = draws;
                self.notes.clear();
                match (draws, &mut self.drawer) {
                    (Draws::Gpu(kernel), Some(drawer)) if matches!(drawer.draws(), Draws::Gpu(_)) => {
                        drawer.set_kernel(kernel);
                        Ok(())
                    }
                    _ => self.make_drawer(),
                }
            }
            Wish::CopyCommand => {
                let command = self.command(self.shot_size());
                if let Some(screen) = &mut self.screen {
                    screen.egui.set_clipboard_text(command.clone());
                }
                if self.script.is_some() {
                    cli::print(&format!("{command}\n"))?;
                }
                self.say(format!("copied: {command}"));
                Ok(())
            }
            Wish::Screenshot => {
                let Some(world) = &self.world else { return Ok(()) };
                let stem = world.scene_file().with_extension("");
                let stem = stem.file_name().map_or("view".into(), |n| n.to_string_lossy().into_owned());
                let path = unused(&format!("{stem}-view"), "png");
                self.screenshot(&path)
            }
            Wish::ErrorMap => self.toggle_map(),
            Wish::Record => self.record(),
            Wish::Play => {
                if self.route.is_some() {
                    self.recorder.play();
                } else {
                    self.say("nothing was recorded yet (R)");
                }
                Ok(())
            }
            Wish::GoodView => {
                if let Some(world) = self.world.clone() {
                    let pose = self.good_view_of(&world);
                    self.control.place(pose);
                }
                Ok(())
            }
            Wish::FullScreen => {
                if let Some(screen) = &self.screen {
                    let full = screen.window.fullscreen().is_none().then_some(Fullscreen::Borderless(None));
                    screen.window.set_fullscreen(full);
                }
                Ok(())
            }
        }
    }

    fn record(&mut self) -> Result<()> {
        if !matches!(self.recorder, Recorder::Recording { .. }) {
            self.recorder.record();
            return Ok(());
        }
        let Some(route) = self.recorder.stop(self.control.pose) else { return Ok(()) };
        let path = unused("path", "json");
        output::write(&path, |out| out.write_all(route.to_json().as_bytes()))?.finish()?;
        let scene = self.world.as_ref().map_or(PathBuf::from("SCENE"), |w| w.scene_file());
        let file = path.display();
        let text = format!(
            "{} keyframes in {file}: planecast fly {} -o flight.mp4 --path {file}",
            route.keyframes().len(),
            quoted(&scene)
        );
        if self.script.is_some() {
            cli::print(&format!("{text}\n"))?;
        }
        self.say(text);
        self.route = Some(route);
        Ok(())
    }

    fn shot_size(&self) -> [u32; 2] {
        self.panel.screenshot_size.unwrap_or(self.size.map(|n| n.max(1)))
    }

    /// The command that draws this view.
    fn command(&self, size: [u32; 2]) -> String {
        let scene = self.world.as_ref().map_or(PathBuf::from("SCENE"), |w| w.scene_file());
        let flags = self.draws.options(&self.options).flags();
        let text = format!(
            "planecast render {} -o view.png {} --size {}x{} {} {flags}",
            quoted(&scene),
            pose_flags(&self.control.pose),
            size[0],
            size[1],
            self.draws.flags()
        );
        text.trim_end().to_owned()
    }

    /// Writes the view as `render` draws it.
    fn screenshot(&mut self, path: &Path) -> Result<()> {
        let size = self.shot_size();
        let camera = self.control.pose.camera(size);
        let Some(drawer) = &mut self.drawer else { return Ok(()) };
        let frame = drawer.render(&camera, &self.options, Outputs::default())?;
        output::write(path, |out| output::png(out, &frame))?.finish()?;
        // The device's picture is now that of the screenshot.
        self.drawn = None;
        if self.script.is_some() {
            cli::print(&format!("{}\n", self.command(size)))?;
        }
        self.say(format!("{}: {} × {}", path.display(), size[0], size[1]));
        Ok(())
    }

    /// Begins the error map of this view, or takes it away.
    fn toggle_map(&mut self) -> Result<()> {
        if self.map.take().is_some() {
            self.drawn = None;
            return Ok(());
        }
        let (camera, options) = self.view();
        let (Some(drawer), Some(world)) = (&mut self.drawer, self.world.clone()) else { return Ok(()) };
        let outputs = Outputs { voxel: true };
        let frame = drawer.render(&camera, &options, outputs)?;
        self.drawn = None;
        let (send, exact) = std::sync::mpsc::channel();
        std::thread::spawn(move || {
            let frame = CpuRenderer::new(&world.scene, &world.resident).exact(&camera, &options, outputs);
            // The map may have been taken away.
            let _ = send.send(frame);
        });
        self.map = Some(Map { camera, options, frame, exact, done: None });
        self.say("drawing the exact reference for the error map");
        Ok(())
    }

    /// Camera and options of a frame of the window, as the frame rate allows.
    fn view(&self) -> (Camera, Options) {
        let size = self.size.map(|n| n.max(1));
        let (size, options) = match &self.pace {
            Some(pace) => (pace.size(size), pace.options(self.options)),
            None => (size, self.options),
        };
        (self.control.pose.camera(size), options)
    }

    fn double_click(&mut self, [x, y]: [f64; 2]) {
        let Some(world) = &self.world else { return };
        let camera = self.control.pose.camera(self.size.map(|n| n.max(1)));
        let ray = camera.ray(&camera.basis(), x, y).normalize_or_zero();
        let repeats = [self.options.repeat.x, self.options.repeat.z];
        let far = self.options.view_distance.min(1e7);
        let eye = self.control.pose.eye;
        if !eye.is_finite() || ray == DVec3::ZERO {
            return;
        }
        match exact::cast(&world.scene.levels[0].solid, repeats, eye, ray, far) {
            Some(hit) => self.control.fly_to(ray, hit.t),
            None => self.say("nothing but sky there"),
        }
    }

    fn act(&mut self, event_loop: &ActiveEventLoop, action: Action) -> Result<()> {
        match action {
            Action::Press(code) => self.key(event_loop, &code, true),
            Action::Release(code) => self.key(event_loop, &code, false),
            Action::Key(code) => {
                self.key(event_loop, &code, true);
                self.key(event_loop, &code, false);
            }
            Action::Look([dx, dy]) => self.control.look(dx, dy),
            Action::Wheel(notches) => self.control.wheel(notches),
            Action::DoubleClick(at) => self.double_click(at),
            Action::Resize([0, 0]) => self.resized([0, 0]),
            Action::Resize(size) => {
                let Some(screen) = &self.screen else { return Ok(()) };
                let took = screen.window.request_inner_size(PhysicalSize::new(size[0], size[1]));
                if let Some(took) = took {
                    self.resized(took.into());
                }
                let real: [u32; 2] = self.screen.as_ref().map_or([0; 2], |s| s.window.inner_size().into());
                if real == size {
                    self.resized(size);
                }
                self.awaited = Some((Awaited::Size(size), Instant::now()));
            }
            Action::Screenshot(path) => self.screenshot(&path)?,
            Action::Grab(path) => self.grab = Some(path),
            Action::Figures(path) => {
                let (present, way, renewed) = match self.screen.as_ref().map(|s| &s.surface) {
                    Some(Surface::Gpu(canvas)) => (canvas.present_ms, canvas.way.map(Way::name), canvas.renewed),
                    _ => (None, None, [0; 2]),
                };
                let figures = serde_json::json!({
                    "stats": self.panel.stats, "present_ms": present, "present": way, "shown_fps": self.panel.fps,
                    "words": self.lines(), "window": self.size, "scale": self.scale, "surfaces_renewed": renewed,
                });
                output::write(&path, |out| output::json(out, &figures))?.finish()?;
            }
            Action::Drop(path) => self.dropped(&path),
            Action::LoseDevice {} => {
                if let Some(device) = self.device() {
                    device.device.destroy();
                }
            }
            Action::Surface(trouble) => {
                if let Some(Screen { surface: Surface::Gpu(canvas), .. }) = &mut self.screen {
                    canvas.trouble = Some(trouble);
                }
            }
            Action::Occluded(occluded) => self.set_occluded(occluded),
            Action::Sleep(seconds) => {
                self.suspend();
                // That much of the time is gone, as far as this process has been there for it.
                let asleep = Duration::try_from_secs_f64(seconds).unwrap_or_default();
                self.then = self.then.checked_sub(asleep).unwrap_or(self.then);
                self.resume(event_loop)?;
            }
            Action::Scale(scale) => self.awaited = Some((Awaited::Scale(scale), Instant::now())),
            Action::Quit {} => event_loop.exit(),
        }
        Ok(())
    }

    fn set_occluded(&mut self, occluded: bool) {
        self.occluded = occluded;
        self.linger = LINGER;
    }

    /// The window goes, and all that is on the device with it.
    fn suspend(&mut self) {
        self.control.release();
        (self.dragging, self.captured) = (false, false);
        (self.drawer, self.drawn, self.map, self.screen) = (None, None, None, None);
    }

    /// The window comes, for the first time or again.
    fn resume(&mut self, event_loop: &ActiveEventLoop) -> Result<()> {
        if self.screen.is_none() {
            self.open(event_loop)?;
            self.make_drawer()?;
        }
        Ok(())
    }

    fn dropped(&mut self, path: &Path) {
        self.opening = Some(Opening::begin(path, &self.settings.how));
        self.linger = LINGER;
    }

    fn resized(&mut self, size: [u32; 2]) {
        self.size = size;
        self.linger = LINGER;
        if let Some(Screen { surface: Surface::Gpu(canvas), .. }) = &mut self.screen {
            canvas.resize(size);
        }
    }

    /// Lines on the screen.
    fn lines(&self) -> Vec<String> {
        let mut lines = self.notes.clone();
        lines.extend(self.pace.as_ref().map(Pace::describe));
        match &self.recorder {
            Recorder::Recording { t, .. } => lines.push(format!("recording, {t:.1} s (R stops)")),
            Recorder::Playing { t } => lines.push(format!("playing, {t:.1} s")),
            Recorder::Idle => {}
        }
        if let Some((_, text)) = self.map.as_ref().and_then(|m| m.done.as_ref()) {
            lines.push(text.clone());
        }
        if let Some(opening) = &self.opening {
            lines.push(format!("opening {}", opening.path.display()));
        } else if self.world.is_none() {
            lines.push("drop a scene file here, or anything that planecast encode reads".into());
        }
        lines.extend(self.words.iter().map(|(text, _)| text.clone()));
        lines
    }

    /// Whether the next frame should be drawn at once.
    fn is_active(&self) -> bool {
        self.script.is_some() || self.opening.is_some() || !self.occluded && self.has_news()
    }

    /// Whether there is anything new to be seen.
    fn has_news(&self) -> bool {
        self.linger > 0
            || self.control.is_moving()
            || !matches!(self.recorder, Recorder::Idle)
            || self.map.as_ref().is_some_and(|m| m.done.is_none())
    }

    /// What came of worlds and references that others work on.
    fn arrivals(&mut self) -> Result<()> {
        if let Some(world) = self.opening.as_ref().and_then(Opening::poll) {
            self.opening = None;
            match world {
                Ok(world) => self.enter(world)?,
                // Nothing to look at, and nobody to drop another file.
                Err(e) if self.world.is_none() && self.settings.input.is_some() => return Err(e),
                Err(e) => self.say(e.to_string()),
            }
        }
        let Some(map) = &mut self.map else { return Ok(()) };
        if map.done.is_none()
            && let Ok(exact) = map.exact.try_recv()
        {
            let (picture, agreement) = error_map(&map.frame, &exact?);
            let text = format!(
                "{:.3} % of the pixels show exactly the same voxel, {:.3} % one within a pixel; {LEGEND}",
                agreement.same_percent(),
                agreement.near_percent()
            );
            map.done = Some((picture, text));
            self.linger = LINGER;
        }
        Ok(())
    }

    /// One frame: time passes, the scene is drawn where it must be, and shown.
    fn frame(&mut self, event_loop: &ActiveEventLoop) -> Result<()> {
        let now = Instant::now();
        let mut dt = (now - self.then).as_secs_f64().min(LONGEST);
        self.then = now;
        self.words.retain(|(_, until)| *until > now);
        self.linger = self.linger.saturating_sub(1);
        self.arrivals()?;
        self.run_script(event_loop, &mut dt)?;
        let before = self.control.pose;
        if let Some(world) = self.world.clone() {
            let ground = Ground::new(&world.scene.levels[0].solid, self.options.repeat);
            self.control.step(dt, &ground);
        }
        let played = self.recorder.step(dt, self.control.pose, self.route.as_ref());
        if let Some(pose) = played {
            self.control.place(pose);
        }
        if self.control.pose != before {
            self.linger = LINGER;
        }
        match (self.panel.holds, &self.pace) {
            (true, Some(pace)) if (pace.budget_ms() - 1e3 / self.panel.target_fps).abs() < 1e-6 => {}
            (true, _) => self.pace = Some(Pace::new(self.panel.target_fps)),
            (false, _) => self.pace = None,
        }
        if self.size.contains(&0) || self.occluded {
            self.repaint_at = None;
            std::thread::sleep(Duration::from_millis(10));
            return Ok(());
        }
        self.draw()?;
        self.show(event_loop)
    }

    /// Whether what the script waits for has come; an error if it took too long.
    fn check_awaited(&mut self) -> Result<()> {
        let Some((awaited, since)) = self.awaited else { return Ok(()) };
        let here = match awaited {
            Awaited::Size(size) => self.size == size,
            Awaited::Scale(scale) => self.scale == scale,
        };
        if here {
            self.awaited = None;
        } else if since.elapsed() > PATIENCE {
            let ([w, h], scale) = (self.size, self.scale);
            return Err(Error::Limit(match awaited {
                Awaited::Size([x, y]) => format!("the window is {w} × {h} and did not become {x} × {y}"),
                Awaited::Scale(other) => format!("a point is {scale} pixels wide and did not become {other}"),
            }));
        }
        Ok(())
    }

    /// Does what is due, unless something is waited for.
    fn run_script(&mut self, event_loop: &ActiveEventLoop, dt: &mut f64) -> Result<()> {
        if self.script.is_none() {
            return Ok(());
        }
        self.check_awaited()?;
        let Some(mut script) = self.script.take() else { return Ok(()) };
        // A grab is of the frame that is drawn next.
        let waits =
            self.opening.is_some() || self.awaited.is_some() || self.map.as_ref().is_some_and(|m| m.done.is_none());
        *dt = if waits { 0.0 } else { script::STEP };
        let mut done = Ok(());
        while !waits && done.is_ok() && self.awaited.is_none() && self.grab.is_none() && self.opening.is_none() {
            let Some(action) = script.due() else {
                script.frame();
                break;
            };
            // Actions look whether a script runs.
            self.script = Some(script.clone());
            done = self.act(event_loop, action);
        }
        self.script = Some(script);
        if waits {
            std::thread::sleep(Duration::from_millis(2));
        }
        done
    }

    /// Draws the scene if what is shown is out of date.
    fn draw(&mut self) -> Result<()> {
        let (camera, options) = self.view();
        if self.map.as_ref().is_some_and(|m| m.camera != camera || m.options != options) {
            // The map is of one view.
            self.map = None;
        }
        let Some(drawer) = &mut self.drawer else { return Ok(()) };
        // While someone looks at the times, each frame is drawn, so that they are of now.
        let job = (camera, options, drawer.draws());
        if self.drawn != Some(job) {
            match drawer.draw(&camera, &options) {
                Ok(Drawn::OnDevice) => self.pixels = None,
                Ok(Drawn::Here(frame)) => {
                    let stats = frame.stats.clone();
                    self.pixels = Some(*frame);
                    self.figures(stats);
                }
                Err(Error::Limit(what)) if matches!(self.draws, Draws::Gpu(_)) => {
                    self.draws = Draws::Cpu;
                    self.make_drawer()?;
                    self.notes.push(format!("drawing on the cpu: {what}"));
                    return self.draw();
                }
                Err(Error::Argument(what) | Error::Limit(what)) => self.say(what),
                Err(e) => return Err(e),
            }
            self.drawn = Some(job);
        }
        if let Some(stats) = self.drawer.as_mut().map(Drawer::figures).transpose()?.flatten() {
            self.figures(stats);
        }
        Ok(())
    }

    /// What a frame cost is known.
    fn figures(&mut self, stats: Stats) {
        let stages = stats.gpu_ms.or(stats.cpu_ms).unwrap_or_default();
        let present = match self.screen.as_ref().map(|s| &s.surface) {
            Some(Surface::Gpu(canvas)) => canvas.present_ms.unwrap_or(0.0),
            _ => 0.0,
        };
        self.panel.cost(Cost { stages, present });
        self.panel.stats = stats;
        if let Some(pace) = &mut self.pace
            && pace.frame(stages.total + present)
        {
            self.linger = LINGER;
        }
    }

    fn show(&mut self, event_loop: &ActiveEventLoop) -> Result<()> {
        let lines = self.lines();
        let device = self.device_name();
        let gpu = self.device().is_some();
        let progress = self.opening.as_ref().map(Opening::progress).filter(|p| *p > 0.0);
        let Some(screen) = &mut self.screen else { return Ok(()) };
        let size = self.size;
        let map = self.map.as_ref().and_then(|m| m.done.as_ref());
        let here = map.map(|(picture, _)| picture.as_slice()).or(self.pixels.as_ref().map(|f| f.color.as_slice()));
        let picture_size = match (&map, &self.pixels, &self.drawn) {
            (Some(_), _, Some((camera, ..))) => [camera.width, camera.height],
            (None, Some(frame), _) => [frame.width, frame.height],
            (_, _, Some((camera, ..))) => [camera.width, camera.height],
            _ => [1, 1],
        };
        let canvas = match &mut screen.surface {
            Surface::Gpu(canvas) => canvas,
            Surface::Plain(plain) => {
                // There is no panel here: what there is to say goes to the title.
                screen.window.set_title(&format!("planecast - {}", lines.join(" - ")));
                if let Some(pixels) = here {
                    let mut grabbed = Vec::new();
                    plain.show(pixels, picture_size, size, self.grab.as_ref().map(|_| &mut grabbed))?;
                    if let Some(path) = self.grab.take() {
                        save(&path, size, grabbed)?;
                    }
                }
                return Ok(());
            }
        };
        canvas.resize(size);
        canvas.set_vsync(self.panel.vsync);
        let input = screen.egui.take_egui_input(&screen.window);
        let mut subject = Subject {
            world: self.world.as_deref(),
            control: &mut self.control,
            options: &mut self.options,
            draws: self.draws,
            gpu,
            device: &device,
            words: &lines,
            progress,
            recording: matches!(self.recorder, Recorder::Recording { .. }),
            playable: self.route.is_some(),
            error_map: self.map.is_some(),
        };
        let (egui, wishes) = panel::run(&screen.ctx, input, &mut self.panel, &mut subject);
        screen.egui.handle_platform_output_with_event_loop(&screen.window, event_loop, egui.platform_output);
        let mut painting = Painting {
            textures: egui.textures_delta,
            primitives: screen.ctx.tessellate(egui.shapes, egui.pixels_per_point),
            pixels_per_point: egui.pixels_per_point,
        };
        let again = egui.viewport_output.values().map(|v| v.repaint_delay).min().unwrap_or(Duration::MAX);
        self.repaint_at = Instant::now().checked_add(again);
        let picture = match (here, &self.drawer) {
            (Some(pixels), _) => Picture::Here(Some(pixels)),
            (None, Some(drawer)) if self.drawn.is_some() => Picture::OnDevice(drawer),
            _ => Picture::None,
        };
        let mut grabbed = Vec::new();
        let grab = self.grab.as_ref().map(|_| &mut grabbed);
        let surface = canvas.size();
        let shown = canvas.show(&screen.window, picture, picture_size, &mut painting, grab);
        // What could not be shown must be uploaded nowhere.
        painting.textures.clear();
        canvas.device.check()?;
        match shown? {
            Shown::Yes => {
                let now = Instant::now();
                self.shown.push(now);
                self.shown.retain(|t| now - *t < Duration::from_secs(1));
                self.panel.fps = self.shown.len() as f64;
                if let Some(path) = self.grab.take() {
                    save(&path, surface, grabbed)?;
                }
            }
            Shown::Later => std::thread::sleep(Duration::from_millis(20)),
            Shown::Again => self.linger = self.linger.max(2),
        }
        for wish in wishes {
            self.wish(wish)?;
        }
        Ok(())
    }
}

/// egui for a window.
fn gui(window: &Arc<Window>, surface: &Surface) -> (egui_winit::State, egui::Context) {
    let ctx = egui::Context::default();
    ctx.set_visuals(egui::Visuals {
        window_fill: egui::Color32::from_black_alpha(200),
        panel_fill: egui::Color32::from_black_alpha(200),
        ..egui::Visuals::dark()
    });
    let limit = match surface {
        Surface::Gpu(canvas) => Some(canvas.limit()),
        Surface::Plain(_) => None,
    };
    let scale = Some(window.scale_factor() as f32);
    let state = egui_winit::State::new(ctx.clone(), egui::ViewportId::ROOT, window, scale, None, limit);
    (state, ctx)
}

/// Writes pixels as a picture.
fn save(path: &Path, [width, height]: [u32; 2], color: Vec<[u8; 4]>) -> Result<()> {
    let (depth, voxel, stats) = (Vec::new(), Vec::new(), Stats::default());
    let frame = Frame { width, height, color, depth, voxel, stats };
    output::write(path, |out| output::png(out, &frame))?.finish()?;
    Ok(())
}

/// A file name in the folder of the command that no file has yet.
fn unused(stem: &str, ending: &str) -> PathBuf {
    let names = (1..).map(|n| PathBuf::from(format!("{stem}-{n}.{ending}")));
    names.into_iter().find(|p| !p.exists()).unwrap_or_else(|| PathBuf::from(format!("{stem}.{ending}")))
}

/// A path as a shell takes it.
fn quoted(path: &Path) -> String {
    let text = path.display().to_string();
    let plain = |c: char| c.is_alphanumeric() || "/._-+,:@%=".contains(c);
    if !text.is_empty() && text.chars().all(plain) { text } else { format!("'{}'", text.replace('\'', r"'\''")) }
}

impl ApplicationHandler for App {
    fn resumed(&mut self, event_loop: &ActiveEventLoop) {
        if let Err(e) = self.resume(event_loop) {
            self.fail(event_loop, e);
        }
    }

    fn suspended(&mut self, _: &ActiveEventLoop) {
        self.suspend();
    }

    fn new_events(&mut self, _: &ActiveEventLoop, cause: StartCause) {
        if matches!(cause, StartCause::ResumeTimeReached { .. }) {
            self.linger = self.linger.max(1);
        }
    }

    fn window_event(&mut self, event_loop: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        let Some(screen) = &mut self.screen else { return };
        let is_key = matches!(event, WindowEvent::KeyboardInput { .. });
        let mut taken = false;
        if !is_key || screen.ctx.egui_wants_keyboard_input() {
            let response = screen.egui.on_window_event(&screen.window, &event);
            taken = response.consumed;
            if response.repaint && !matches!(event, WindowEvent::RedrawRequested) {
                self.linger = LINGER;
            }
        }
        match event {
            WindowEvent::CloseRequested => event_loop.exit(),
            WindowEvent::Resized(size) => self.resized(size.into()),
            WindowEvent::ScaleFactorChanged { scale_factor, .. } => {
                self.scale = scale_factor;
                let size = self.screen.as_ref().map_or(self.size, |s| s.window.inner_size().into());
                self.resized(size);
            }
            WindowEvent::Focused(false) => {
                self.control.release();
                self.dragging = false;
                self.capture(false);
            }
            WindowEvent::KeyboardInput { event, is_synthetic: false, .. } if !taken => {
                let PhysicalKey::Code(code) = event.physical_key else { return };
                let down = event.state == ElementState::Pressed;
                if !(down && event.repeat) {
                    // winit names keys as browsers do.
                    self.key(event_loop, &format!("{code:?}"), down);
                }
            }
            WindowEvent::MouseInput { state, button: MouseButton::Left | MouseButton::Right, .. } => {
                let down = state == ElementState::Pressed && !taken;
                self.dragging = down;
                if down {
                    let now = Instant::now();
                    let near = |at: [f64; 2]| (0..2).all(|i| (at[i] - self.cursor[i]).abs() < DOUBLE.1);
                    match self.clicked.take() {
                        Some((then, at)) if now - then < DOUBLE.0 && near(at) => self.double_click(self.cursor),
                        _ => self.clicked = Some((now, self.cursor)),
                    }
                }
            }
            WindowEvent::CursorMoved { position, .. } => {
                let at = [position.x, position.y];
                if self.dragging && !self.captured {
                    self.control.look(at[0] - self.cursor[0], at[1] - self.cursor[1]);
                    self.linger = LINGER;
                }
                self.cursor = at;
            }
            WindowEvent::MouseWheel { delta, .. } if !taken => {
                let notches = match delta {
                    MouseScrollDelta::LineDelta(_, y) => f64::from(y),
                    MouseScrollDelta::PixelDelta(p) => p.y / 50.0,
                };
                self.control.wheel(notches);
                self.say(format!("{:.1} voxels a second", self.control.speed));
            }
            WindowEvent::DroppedFile(path) => self.dropped(&path),
            WindowEvent::Occluded(occluded) => self.set_occluded(occluded),
            // Who is typed into can be seen, whatever was said before.
            WindowEvent::Focused(true) => self.set_occluded(false),
            WindowEvent::RedrawRequested => {
                let done = self.frame(event_loop);
                self.settle_frame(event_loop, done);
            }
            _ => {}
        }
    }

    fn device_event(&mut self, _: &ActiveEventLoop, _: DeviceId, event: DeviceEvent) {
        if let DeviceEvent::MouseMotion { delta: (dx, dy) } = event
            && self.captured
        {
            self.control.look(dx, dy);
            self.linger = LINGER;
        }
    }

    fn about_to_wait(&mut self, event_loop: &ActiveEventLoop) {
        let Some(screen) = &self.screen else { return };
        let now = Instant::now();
        let due = self.repaint_at.is_some_and(|t| t <= now);
        if self.is_active() || due {
            screen.window.request_redraw();
            event_loop.set_control_flow(ControlFlow::Poll);
            return;
        }
        self.then = now;
        let words = self.words.iter().map(|w| w.1).min();
        match [self.repaint_at, words].into_iter().flatten().min() {
            Some(t) => event_loop.set_control_flow(ControlFlow::WaitUntil(t)),
            None => event_loop.set_control_flow(ControlFlow::Wait),
        }
    }

    fn exiting(&mut self, _: &ActiveEventLoop) {
        self.leave();
    }
}

impl App {
    /// After a frame: errors of the device are recovered from, those of files and flags are said, or end a script.
    fn settle_frame(&mut self, event_loop: &ActiveEventLoop, done: Result<()>) {
        match done {
            Err(Error::Scene(e)) if self.world.is_none() || self.script.is_some() => self.fail(event_loop, e.into()),
            done => self.settle(event_loop, done, None),
        }
    }
}
