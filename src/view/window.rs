//! The window: events in, frames out, and going on whatever happens to its surface and its device.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant, SystemTime};

use glam::DVec3;
use planecast_encoder::model::about::Kind;
use winit::application::ApplicationHandler;
use winit::dpi::PhysicalSize;
use winit::event::{DeviceEvent, DeviceId, ElementState, MouseButton, MouseScrollDelta, StartCause, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop};
use winit::keyboard::PhysicalKey;
use winit::window::{CursorGrabMode, Fullscreen, Window, WindowId};

use super::canvas::{Canvas, Painting, Picture, Plain, Shown};
use super::control::{Control, Ground, Mode};
use super::live::Live;
use super::map::{LEGEND, enlarged, error_map};
use super::overlay::{self, Fault, Overlay, Ruler};
use super::pace::Pace;
use super::panel::{self, Cost, Panel, Subject, Wish};
use super::record::Recorder;
use super::script::{self, Action, Script};
use super::tune::{Keeps, Tune};
use super::{Settings, last, pose_flags};
use crate::cpu::exact;
use crate::cpu::renderer::{CpuRenderer, Outputs};
use crate::film::path::{Path as Route, Pose};
use crate::film::tour::View;
use crate::frame::aim::Typed;
use crate::frame::camera::Camera;
use crate::frame::options::Options;
use crate::frame::picture::{Frame, Stats};
use crate::frame::preset::Preset;
use crate::gpu::present::Way;
use crate::render::device::Device;
use crate::render::drawer::{Drawer, Drawn, Draws};
use crate::world::probe::Met;
use crate::world::residency::Held;
use crate::world::{OpenOptions, Opening, World};
use crate::{Error, Kernel, Result, cli, output};

/// Frames that are drawn after the last change, so that figures arrive and egui comes to rest.
const LINGER: u32 = 6;

/// How long words stay on the screen.
const WORDS: Duration = Duration::from_secs(6);

/// How long what draws, and why, is said on the screen: the panel has it on.
const NOTES: Duration = Duration::from_secs(10);

/// Standing still so long, all pixels are drawn, and the best preset.
const REST: Duration = Duration::from_millis(250);

/// A threshold that has not moved for so long is encoded as `encode` does it.
const SETTLED: Duration = Duration::from_millis(400);

/// A button that comes up this near to where it went down, pixels, is a click.
const CLICK: f64 = 4.0;

/// Seconds that tiles are asked for ahead.
const AHEAD: f64 = 0.25;

/// A frame whose tiles do not come is drawn anew so often, and else as soon as some have come.
const AGAIN: Duration = Duration::from_millis(50);

/// Bars of the histogram.
const BARS: usize = 96;

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
    /// The input is read as it was wanted.
    Reading,
}

/// The error map of a view: on its way, then there.
struct Map {
    camera: Camera,
    options: Options,
    frame: Frame,
    exact: Receiver<Result<Frame>>,
    done: Option<Compared>,
}

/// What an error map shows.
struct Compared {
    picture: Vec<[u8; 4]>,
    text: String,
    exact: Frame,
    /// Places of errors, and which of them is looked at.
    faults: Vec<[u32; 2]>,
    at: usize,
}

struct App {
    settings: Settings,
    outcome: Result<()>,
    screen: Option<Screen>,
    opening: Option<Opening>,
    world: Option<Arc<Held>>,
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
    noted: Instant,
    words: Vec<(String, Instant)>,
    /// How inputs are read, and what was changed of it for this one.
    tune: Tune,
    live: Option<Live>,
    /// A world at another threshold, and how often it was halved: drawn in place of the one that is there.
    preview: Option<(Arc<World>, u32)>,
    /// When the threshold is encoded as it is now.
    settles: Option<Instant>,
    /// What the world that is on its way keeps of the view; None where it is another one.
    keeps: Option<Keeps>,
    /// The input was changed again while it was on its way.
    again: Option<Keeps>,
    ruler: Ruler,
    recent: Vec<PathBuf>,
    /// Voxel, place and value under the mouse, in words, and from the eye to the middle of the picture.
    hover: Option<String>,
    ahead: Option<f64>,
    /// Where the camera will be soon, if it goes on as it does.
    soon: Option<Pose>,
    /// Nothing of the world is in sight.
    lost: bool,
    /// What was drawn last was as all is drawn at rest; the view that rests, and since when.
    seen: (Pose, Options, [u32; 2]),
    rests: Instant,
    refined: bool,
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
    dragging: Option<MouseButton>,
    pressed: [f64; 2],
    shift: bool,
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
                refines: script.is_none(),
                screenshot_size: settings.screenshot_size,
                ..Panel::default()
            },
            opening: input.map(|path| Opening::begin(&path, &settings.how, &settings.residency)),
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
            noted: Instant::now(),
            words: Vec::new(),
            tune: Tune::default(),
            live: None,
            preview: None,
            settles: None,
            keeps: None,
            again: None,
            ruler: Ruler::default(),
            recent: last::recent_file().map(|file| last::recent(&file)).unwrap_or_default(),
            hover: None,
            ahead: None,
            soon: None,
            lost: false,
            seen: (pose, options, [0; 2]),
            rests: Instant::now(),
            refined: false,
            script,
            awaited: None,
            scale: 1.0,
            occluded: false,
            grab: None,
            size: [0; 2],
            cursor: [0.0; 2],
            dragging: None,
            pressed: [0.0; 2],
            shift: false,
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

    /// Says what draws, and why.
    fn note(&mut self, what: String) {
        self.noted = Instant::now();
        if !self.notes.contains(&what) {
            self.notes.push(what);
        }
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
                self.note(format!("drawing on the cpu: the only adapter is software ({})", canvas.device.info.name));
                Draws::Cpu
            }
            (Device::Auto, Ok(_)) => Draws::Gpu(gpu_kernel()?),
            (Device::Auto, Err(e)) if kernel.is_none() => {
                self.note(format!("drawing on the cpu: {e}"));
                Draws::Cpu
            }
            (Device::Auto | Device::Gpu | Device::AllGpus, Err(e)) => return Err(Error::Device(e.to_string())),
        };
        // Frames come late from a CPU, so fewer pixels while something moves.
        if self.script.is_none() && self.settings.target_fps.is_none() && !matches!(self.draws, Draws::Gpu(_)) {
            (self.panel.holds, self.panel.target_fps) = (true, 30.0);
        }
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
        let preview = self.preview.as_ref().map(|(world, _)| world.clone());
        let Some(held) = self.world.clone() else { return Ok(()) };
        let residency = self.settings.residency;
        let make = |draws, device: Option<&_>| match (&preview, &*held) {
            (Some(world), _) => Drawer::new(world, draws, device),
            (None, Held::Whole(world)) => Drawer::new(world, draws, device),
            (None, Held::Tiles(tiles)) => Drawer::of_tiles(tiles, &residency, draws, device),
        };
        let drawer = match make(self.draws, self.device()) {
            // What draws tiles is planes.
            Err(Error::Argument(what)) => {
                self.draws =
                    if matches!(self.draws, Draws::Gpu(_)) { Draws::Gpu(Kernel::default()) } else { Draws::Cpu };
                self.say(what);
                make(self.draws, self.device())
            }
            drawer => drawer,
        };
        self.drawer = Some(match drawer {
            Err(e @ (Error::Limit(_) | Error::Device(_))) if matches!(self.draws, Draws::Gpu(_)) => {
                self.device().map_or(Ok(()), crate::gpu::present::Device::check)?;
                self.note(format!("drawing on the cpu: {e}"));
                self.draws = Draws::Cpu;
                make(self.draws, None)?
            }
            drawer => drawer?,
        });
        if let (Some(drawer), Some(Screen { surface: Surface::Gpu(canvas), .. })) = (&mut self.drawer, &self.screen) {
            drawer.set_order(canvas.order());
        }
        self.linger = LINGER;
        Ok(())
    }

    /// Takes another reading of the input that is there.
    fn renew(&mut self, world: Held, keeps: Keeps) -> Result<()> {
        self.preview = None;
        if let Some(old) = &self.world {
            let [was, is] = [old.dims()[1], world.dims()[1]].map(f64::from);
            if keeps == Keeps::Height && was > 0.0 {
                // What is looked at stays where it is in the picture.
                let forward = self.control.pose.camera([1, 1]).basis().forward;
                let at = self.control.pose.eye + forward * self.ahead.unwrap_or(0.0);
                let lifted = at.y.clamp(0.0, was) * (is / was - 1.0);
                self.control.pose.eye.y += lifted;
                self.control.target.y += lifted;
            }
        }
        if keeps == Keeps::Nothing {
            let pose = self.good_view_of(&world);
            self.control.target = world.center();
            self.control.place(pose);
            self.ruler.places.clear();
        }
        (self.route, self.map) = (None, None);
        self.world = Some(Arc::new(world));
        self.make_drawer()?;
        match self.again.take() {
            Some(keeps) => self.reread(keeps),
            None => Ok(()),
        }
    }

    /// Reads the input that is there once more, as it is tuned.
    fn reread(&mut self, keeps: Keeps) -> Result<()> {
        let Some(world) = self.world.as_ref().filter(|w| w.encoded()) else { return Ok(()) };
        if self.opening.is_some() {
            self.again = Some(keeps);
            return Ok(());
        }
        let how = OpenOptions { read: self.tune.of(&self.settings.how.read), ..self.settings.how.clone() };
        self.opening = Some(Opening::begin(world.path(), &how, &self.settings.residency));
        self.keeps = Some(keeps);
        Ok(())
    }

    /// The input is wanted in another way.
    fn tuned(&mut self, keeps: Keeps, of_threshold: bool) -> Result<()> {
        self.linger = LINGER;
        if let Some(threshold) = self.tune.threshold.filter(|_| of_threshold) {
            let live = self.live.as_mut().is_some_and(|live| live.want(threshold));
            if live {
                // One that is on its way is of a threshold from before.
                if self.keeps == Some(Keeps::All) {
                    (self.opening, self.keeps, self.again) = (None, None, None);
                }
                self.settles = Some(Instant::now() + SETTLED);
                return Ok(());
            }
        }
        if keeps != Keeps::All || !of_threshold {
            self.live = None;
        }
        self.reread(keeps)
    }

    /// The values of a volume are read for thresholds to come.
    fn watch(&mut self) {
        let Some(world) = self.world.as_ref().filter(|w| w.encoded()) else { return };
        if self.live.is_none() && matches!(world.about().kind, Some(Kind::Volume | Kind::Labels)) {
            let how = OpenOptions { read: self.tune.of(&self.settings.how.read), ..self.settings.how.clone() };
            self.live = Some(Live::begin(world.path(), &how));
        }
    }

    /// Goes into a world that was opened.
    fn enter(&mut self, world: Held) -> Result<()> {
        if let Some(keeps) = self.keeps.take() {
            self.renew(world, keeps)?;
            self.watch();
            return Ok(());
        }
        self.leave();
        (self.tune, self.live, self.preview, self.settles, self.again) = Default::default();
        self.ruler.places.clear();
        let first = self.world.is_none();
        let view = self.good_view_of(&world);
        let left = content(&world).and_then(|content| last::recall(&last::file()?, content));
        let s = &self.settings;
        let typed = Typed { eye: s.eye, yaw: s.yaw, pitch: s.pitch, roll: s.roll.unwrap_or(0.0) };
        let is_typed = s.aim.is_given() || [s.yaw, s.pitch].iter().any(Option::is_some) || s.eye.is_some();
        let pose = match first && is_typed {
            true => {
                let size = self.area()[1];
                world.pose(&s.aim, typed, View { fov: s.fov, size, repeat: self.options.repeat })?
            }
            false => {
                let pose = left.unwrap_or(view);
                Pose { roll: s.roll.filter(|_| first).unwrap_or(pose.roll), ..pose }
            }
        };
        self.control = Control::new(pose, world.dims());
        self.control.target = world.center();
        self.control.set_mode(Mode::of(world.about().kind));
        (self.recorder, self.route, self.map) = (Recorder::default(), None, None);
        if let Some(screen) = &self.screen {
            screen.window.set_title(&format!("{} - planecast", world.name()));
        }
        if !world.about().left_out.is_empty() {
            self.say(format!("left out: {}", world.about().left_out.join("; ")));
        }
        // A list that is not kept is no reason to stay.
        if let Some(Ok(list)) = last::recent_file().map(|file| last::opened(&file, world.path())) {
            self.recent = list;
        }
        self.options.smooth = self.settings.smooth.unwrap_or(world.whole().is_some_and(|world| world.smooth));
        self.world = Some(Arc::new(world));
        self.make_drawer()?;
        self.watch();
        Ok(())
    }

    /// Remembers where the world was looked at.
    fn leave(&mut self) {
        let Some(content) = self.world.as_deref().and_then(content) else { return };
        let Some(file) = last::file() else { return };
        let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).map_or(0, |d| d.as_secs());
        // A view that is not remembered is no reason to stay.
        if let Err(e) = last::remember(&file, content, &self.control.pose, now) {
            planecast_encoder::note!("note: the view is not remembered: {e}");
        }
    }

    fn good_view_of(&self, world: &Held) -> Pose {
        let size = self.area()[1];
        world.good_view(View { fov: self.settings.fov, size, repeat: self.options.repeat })
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
            self.note(format!("drawing on the cpu: {why}"));
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
        if code.starts_with("Shift") {
            self.shift = down;
        }
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
            "KeyO" => self.wish(Wish::Browse),
            "KeyN" => self.wish(Wish::Fault(1)),
            "KeyB" => self.wish(Wish::Fault(-1)),
            "KeyL" => {
                self.ruler.on = !self.ruler.on;
                self.say(if self.ruler.on {
                    "click two places to measure between them (L ends it)"
                } else {
                    "measuring ends"
                });
                if !self.ruler.on {
                    self.ruler.places.clear();
                }
                Ok(())
            }
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
            Wish::Browse => {
                let latest = self.recent.first().and_then(|p| p.parent()).map(Path::to_owned);
                self.panel.browser.show_folder(&latest.unwrap_or_else(|| PathBuf::from(".")));
                Ok(())
            }
            Wish::Open(path) => {
                self.dropped(&path);
                Ok(())
            }
            Wish::Tuned(keeps) => self.tuned(keeps, false),
            Wish::Threshold => self.tuned(Keeps::All, true),
            Wish::Fault(step) => {
                if let Some(done) = self.map.as_mut().and_then(|m| m.done.as_mut()).filter(|d| !d.faults.is_empty()) {
                    let n = done.faults.len() as i64;
                    done.at = (done.at as i64 + i64::from(step)).rem_euclid(n) as usize;
                }
                Ok(())
            }
            Wish::Draw(draws) => {
                self.draws = draws;
                self.notes.clear();
                let whole = self.world.as_ref().is_some_and(|world| world.whole().is_some());
                match (draws, &mut self.drawer) {
                    (Draws::Gpu(kernel), Some(drawer)) if whole && matches!(drawer.draws(), Draws::Gpu(_)) => {
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
                let stem = PathBuf::from(world.name()).with_extension("");
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
                    self.control.target = world.center();
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
        let file = path.display();
        let text = format!(
            "{} keyframes in {file}: planecast fly {} -o flight.mp4 --path {file}",
            route.keyframes().len(),
            self.scene(&self.settings.reading.fly)
        );
        if self.script.is_some() {
            cli::print(&format!("{text}\n"))?;
        }
        self.say(text);
        self.route = Some(route);
        Ok(())
    }

    fn shot_size(&self) -> [u32; 2] {
        self.panel.screenshot_size.unwrap_or(self.area()[1])
    }

    /// What a command is given for the world: a scene file, or the input and how it is tuned, `reading` by that command's words.
    fn scene(&self, reading: &[Vec<String>]) -> String {
        match &self.world {
            Some(world) if world.encoded() => {
                let words = self.tune.words(reading);
                let words = words.iter().map(|word| quoted(Path::new(word)));
                std::iter::once(quoted(world.path())).chain(words).collect::<Vec<_>>().join(" ")
            }
            Some(world) => {
                let (ramp, tiles) = match &**world {
                    Held::Whole(world) => (world.ramp.as_deref(), ""),
                    Held::Tiles(_) => (self.settings.how.read.ramp.as_deref(), " --residency paged"),
                };
                let ramp = ramp.map(|ramp| format!(" --ramp {}", quoted(Path::new(ramp))));
                quoted(world.path()) + tiles + &ramp.unwrap_or_default()
            }
            None => "SCENE".to_owned(),
        }
    }

    /// The command that draws this view.
    fn command(&self, size: [u32; 2]) -> String {
        let scene = self.scene(&self.settings.reading.render);
        let flags = self.draws.options(&self.options).flags();
        let draws = match (self.draws, self.world.as_deref()) {
            // Tiles are drawn by one kernel, which is not asked for.
            (Draws::Gpu(_), Some(Held::Tiles(_))) => "--device gpu".to_owned(),
            (draws, _) => draws.flags(),
        };
        let text = format!(
            "planecast render {scene} -o view.png {} --size {}x{} {} {flags}",
            pose_flags(&self.control.pose),
            size[0],
            size[1],
            draws
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
        let (Some(drawer), Some(held)) = (&mut self.drawer, &self.world) else { return Ok(()) };
        let Some(world) = held.whole() else {
            self.say("no error map: the exact reference needs the whole world, and this one comes in tiles");
            return Ok(());
        };
        let (scene, resident) = (Arc::clone(&world.scene), Arc::clone(&world.resident));
        let outputs = Outputs { voxel: true };
        let frame = drawer.render(&camera, &options, outputs)?;
        self.drawn = None;
        let (send, exact) = std::sync::mpsc::channel();
        std::thread::spawn(move || {
            let frame = CpuRenderer::new(&scene, &resident).exact(&camera, &options, outputs);
            // The map may have been taken away.
            let _ = send.send(frame);
        });
        self.map = Some(Map { camera, options, frame, exact, done: None });
        self.say("drawing the exact reference for the error map");
        Ok(())
    }

    /// The first pixel of the window that the picture takes, and how many a side.
    fn area(&self) -> [[u32; 2]; 2] {
        let [width, height] = self.size.map(|n| n.max(1));
        let panel = (f64::from(panel::WIDTH) * self.scale).round() as u32;
        let drawn = matches!(self.screen.as_ref().map(|s| &s.surface), Some(Surface::Gpu(_)));
        match self.panel.open && drawn && width >= 2 * panel {
            true => [[panel, 0], [width - panel, height]],
            false => [[0; 2], [width, height]],
        }
    }

    /// Camera and options of a frame of the window, as the frame rate allows.
    fn view(&self) -> (Camera, Options) {
        let size = self.area()[1];
        let whole = self.world.as_ref().is_none_or(|world| world.whole().is_some());
        let (size, mut options) = match &self.pace {
            // Without a level of detail a frame wants more tiles than any memory holds.
            _ if self.refined && !whole => {
                (size, Options { lod: self.options.lod, ..Preset::Best.options(self.options) })
            }
            _ if self.refined => (size, Preset::Best.options(self.options)),
            Some(pace) => (pace.size(size), pace.options(self.options)),
            None => (size, self.options),
        };
        let mut camera = self.control.pose.camera(size);
        if let Some((_, level)) = self.preview {
            // In the voxels of the world that is drawn.
            let voxel = f64::from(1u32 << level);
            camera.eye /= voxel;
            options.view_distance /= voxel;
            options.fog = options.fog.map(|fog| fog / voxel);
            options.equidistant = options.equidistant.map(|from| from / voxel);
        }
        (camera, options)
    }

    /// What the ray through a pixel of the window meets; of a world in tiles, among those that are there.
    fn pick(&self, [x, y]: [f64; 2]) -> Option<(DVec3, Met)> {
        let world = self.world.as_ref()?;
        let [at, size] = self.area();
        let camera = self.control.pose.camera(size);
        let ray = camera.ray(&camera.basis(), x - f64::from(at[0]), y - f64::from(at[1])).normalize_or_zero();
        let eye = self.control.pose.eye;
        if !eye.is_finite() || ray == DVec3::ZERO {
            return None;
        }
        let repeats = [self.options.repeat.x, self.options.repeat.z];
        let far = self.options.view_distance.min(1e7);
        let met = match &**world {
            Held::Whole(world) => {
                let hit = exact::cast(&world.scene.levels[0].solid, repeats, eye, ray, far)?;
                Met { t: hit.t, voxel: hit.voxel, level: 0 }
            }
            Held::Tiles(_) => self.drawer.as_ref()?.probe()?.cast(eye, ray, far)?,
        };
        Some((ray, met))
    }

    fn in_area(&self, [x, y]: [f64; 2]) -> bool {
        let [at, size] = self.area();
        let within = |v: f64, at: u32, n: u32| v >= f64::from(at) && v < f64::from(at + n);
        within(x, at[0], size[0]) && within(y, at[1], size[1])
    }

    fn double_click(&mut self, at: [f64; 2]) {
        match self.pick(at) {
            Some((ray, hit)) => self.control.fly_to(ray, hit.t),
            None => self.say("nothing but sky there"),
        }
    }

    /// A click, where the mouse did not move in between.
    fn click(&mut self, at: [f64; 2]) {
        if !self.ruler.on {
            return;
        }
        match self.pick(at) {
            Some((ray, hit)) => self.ruler.take(self.control.pose.eye + ray * hit.t),
            None => self.say("nothing but sky there"),
        }
        let (Some(world), [from, to]) = (&self.world, &self.ruler.places[..]) else { return };
        self.say(overlay::measured(world.about(), *from, *to));
    }

    /// The mouse moved so many pixels with a button down.
    fn drag(&mut self, button: MouseButton, dx: f64, dy: f64) {
        self.linger = LINGER;
        if button == MouseButton::Left && !self.shift {
            self.control.look(dx, dy);
        } else {
            self.control.pan(dx, dy, f64::from(self.area()[1][1]));
        }
    }

    /// Looks what is under the mouse and straight ahead.
    fn look_about(&mut self) {
        let [at, size] = self.area();
        let middle = [0, 1].map(|k| f64::from(at[k]) + f64::from(size[k]) / 2.0);
        self.ahead = match self.pick(middle) {
            Some((_, hit)) => Some(hit.t),
            None => {
                self.control.mode().eq(&Mode::Orbit).then(|| (self.control.target - self.control.pose.eye).length())
            }
        };
        let part = |k: usize, n: u32| f64::from(at[k]) + f64::from(size[k]) * (f64::from(n) + 0.5) / 8.0;
        self.lost = self.ahead.is_none() && !(0..64).any(|i| self.pick([part(0, i % 8), part(1, i / 8)]).is_some());
        let pick = self.in_area(self.cursor).then(|| self.pick(self.cursor)).flatten();
        self.hover = pick.zip(self.world.as_ref()).map(|((ray, hit), world)| {
            let voxel = hit.voxel.map(|v| v.max(0) as u32);
            let value = self.live.as_ref().and_then(|live| live.grid.as_ref()?.at(voxel));
            overlay::place(world.about(), voxel, hit.level, self.control.pose.eye + ray * hit.t, value)
        });
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
            Action::Click(at) => {
                self.cursor = at;
                self.click(at);
            }
            Action::Hover(at) => self.cursor = at,
            Action::Drag { from, to } => {
                self.cursor = to;
                self.drag(MouseButton::Left, to[0] - from[0], to[1] - from[1]);
            }
            Action::Tune(tune) => {
                let keeps = match (&tune.up, tune.as_is, tune.exaggeration) {
                    (None, None, None) => Keeps::All,
                    (None, None, Some(_)) => Keeps::Height,
                    _ => Keeps::Nothing,
                };
                let of_threshold = tune.threshold.is_some() && keeps == Keeps::All && tune.ramp.is_none();
                self.tune.take(tune);
                self.tuned(keeps, of_threshold)?;
            }
            Action::Refine(on) => self.panel.refines = on,
            Action::Wait {} => self.awaited = Some((Awaited::Reading, Instant::now())),
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
                    "words": self.all_words(), "window": self.size, "scale": self.scale, "surfaces_renewed": renewed,
                    "mode": self.control.mode().name(), "updates_per_second": self.live.as_mut().map(Live::rate),
                    "threshold": self.tune.threshold, "hover": self.hover, "refined": self.refined,
                    "preview": self.preview.as_ref().map(|p| p.1),
                    "faults": self.map.as_ref().and_then(|m| Some(m.done.as_ref()?.faults.len())),
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
        (self.dragging, self.captured, self.shift) = (None, false, false);
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
        self.opening = Some(Opening::begin(path, &self.settings.how, &self.settings.residency));
        (self.keeps, self.again, self.settles) = (None, None, None);
        self.linger = LINGER;
    }

    fn resized(&mut self, size: [u32; 2]) {
        self.size = size;
        self.linger = LINGER;
        if let Some(Screen { surface: Surface::Gpu(canvas), .. }) = &mut self.screen {
            canvas.resize(size);
        }
    }

    /// All that there is to say, whether the screen has it still or not.
    fn all_words(&self) -> Vec<String> {
        let mut words = self.notes.clone();
        words.extend(self.pace.as_ref().map(Pace::describe));
        words.extend(self.lines().into_iter().filter(|line| !self.notes.contains(line)));
        words
    }

    /// Lines on the screen.
    fn lines(&self) -> Vec<String> {
        let mut lines = if self.noted.elapsed() < NOTES { self.notes.clone() } else { Vec::new() };
        if self.is_inside() {
            lines.push("inside the ground: all that is seen is one voxel (Home leads out)".into());
        }
        if self.lost && self.world.is_some() && self.keeps.is_none() {
            lines.push("nothing but sky is in sight (Home leads back)".into());
        }
        lines.extend(self.panel.stats.owed());
        match &self.recorder {
            Recorder::Recording { t, .. } => lines.push(format!("recording, {t:.1} s (R stops)")),
            Recorder::Playing { t } => lines.push(format!("playing, {t:.1} s")),
            Recorder::Idle => {}
        }
        if let Some(done) = self.map.as_ref().and_then(|m| m.done.as_ref()) {
            lines.push(done.text.clone());
        }
        if let Some(opening) = &self.opening {
            if self.keeps.is_none() {
                lines.push(format!("opening {}", opening.path.display()));
            }
        } else if self.world.is_none() {
            lines.push("drop a scene file here, or anything that planecast encode reads".into());
        }
        lines.extend(self.words.iter().map(|(text, _)| text.clone()));
        lines
    }

    /// Whether the eye is in a solid voxel.
    fn is_inside(&self) -> bool {
        let [x, y, z] = self.control.pose.eye.floor().to_array().map(|v| v as i64);
        self.on_ground(|ground| ground.solid(x, y, z)).unwrap_or(false)
    }

    /// What is solid about the camera; `None` while nothing is there.
    fn on_ground<T>(&self, look: impl FnOnce(&Ground<'_>) -> T) -> Option<T> {
        Some(match &**self.world.as_ref()? {
            Held::Whole(world) => look(&Ground::new(&world.scene.levels[0].solid, self.options.repeat)),
            Held::Tiles(tiles) => {
                let probe = self.drawer.as_ref()?.probe()?;
                look(&Ground::of_voxels(tiles.source.dims(), &|x, y, z| probe.solid(x, y, z)))
            }
        })
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
            || self.live.as_ref().is_some_and(|live| live.waits)
            || self.settles.is_some()
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
        if let Some(made) = self.live.as_mut().and_then(Live::poll) {
            let made = made?;
            let rate = self.live.as_mut().map_or(0, Live::rate);
            let part = if made.level == 0 { String::new() } else { format!(" at 1 : {}", 1 << made.level) };
            self.words.retain(|(text, _)| !text.starts_with("threshold "));
            self.say(format!(
                "threshold {:.6}: {rate} updates in the last second{part}, {:.0} ms each",
                made.threshold, made.ms
            ));
            self.preview = Some((made.world, made.level));
            self.make_drawer()?;
        }
        if self.settles.is_some_and(|t| t <= Instant::now()) && self.live.as_ref().is_none_or(|live| !live.waits) {
            self.settles = None;
            self.reread(Keeps::All)?;
        }
        let Some(map) = &mut self.map else { return Ok(()) };
        if map.done.is_none()
            && let Ok(exact) = map.exact.try_recv()
        {
            let exact = exact?;
            let (picture, agreement) = error_map(&map.frame, &exact);
            let text = format!(
                "{:.3} % of the pixels show exactly the same voxel, {:.3} % one within a pixel; {LEGEND}",
                agreement.same_percent(),
                agreement.near_percent()
            );
            let (picture, faults) = enlarged(&picture, exact.width as usize);
            map.done = Some(Compared { picture, text, exact, faults, at: 0 });
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
        let mut control = self.control.clone();
        if self.on_ground(|ground| control.step(dt, ground)).is_some() {
            self.control = control;
        }
        let played = self.recorder.step(dt, self.control.pose, self.route.as_ref());
        if let Some(pose) = played {
            self.control.place(pose);
        }
        if self.control.pose != before {
            self.linger = LINGER;
        }
        self.soon = (self.control.pose != before && dt > 0.0).then(|| self.control.pose.ahead(before, AHEAD / dt));
        let seen = (self.control.pose, self.options, self.size);
        if self.seen != seen || self.preview.is_some() || self.dragging.is_some() {
            (self.seen, self.rests, self.refined) = (seen, now, false);
        } else if self.panel.refines && !self.refined && now - self.rests >= REST {
            (self.refined, self.linger) = (true, LINGER);
        }
        self.refined &= self.panel.refines && matches!(self.recorder, Recorder::Idle);
        if self.linger > 0 {
            self.look_about();
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
            Awaited::Reading => {
                let live = self.live.as_ref().is_none_or(|live| live.read && !live.waits);
                let arrives = self.panel.stats.paging.tiles_missing > 0;
                live && self.settles.is_none() && self.opening.is_none() && !arrives
            }
        };
        if here {
            self.awaited = None;
        } else if since.elapsed() > PATIENCE && !matches!(awaited, Awaited::Reading) || since.elapsed() > 6 * PATIENCE {
            let ([w, h], scale) = (self.size, self.scale);
            return Err(Error::Limit(match awaited {
                Awaited::Size([x, y]) => format!("the window is {w} × {h} and did not become {x} × {y}"),
                Awaited::Scale(other) => format!("a point is {scale} pixels wide and did not become {other}"),
                Awaited::Reading => "the input was not read as it was wanted".to_owned(),
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
        let soon = self.soon.map(|pose| pose.camera([camera.width, camera.height]));
        let Some(drawer) = &mut self.drawer else { return Ok(()) };
        // While someone looks at the times, each frame is drawn, so that they are of now.
        let job = (camera, options, drawer.draws());
        let owes = self.panel.stats.paging.tiles_missing > 0;
        if self.drawn != Some(job) || owes {
            match drawer.draw(&camera, soon.as_ref(), &options) {
                Ok(Drawn::OnDevice) => self.pixels = None,
                Ok(Drawn::Here(frame)) => {
                    let stats = frame.stats.clone();
                    self.pixels = Some(*frame);
                    self.figures(stats);
                }
                Err(Error::Limit(what)) if matches!(self.draws, Draws::Gpu(_)) => {
                    self.draws = Draws::Cpu;
                    self.make_drawer()?;
                    self.note(format!("drawing on the cpu: {what}"));
                    return self.draw();
                }
                Err(Error::Argument(what) | Error::Limit(what)) => self.say(what),
                Err(e) => return Err(e),
            }
            self.drawn = Some(job);
        }
        for what in self.drawer.as_mut().map(Drawer::take_notices).unwrap_or_default() {
            self.say(what);
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
            && !self.refined
            && pace.frame(stages.total + present)
        {
            self.linger = LINGER;
        }
    }

    fn show(&mut self, event_loop: &ActiveEventLoop) -> Result<()> {
        let lines = self.lines();
        let device = self.device_name();
        let [at, area] = self.area();
        let values =
            self.live.as_ref().and_then(|live| live.grid.as_ref()).and_then(|g| Some((g.range()?, g.histogram(BARS))));
        let faults = self.map.as_ref().and_then(|m| m.done.as_ref()).map_or([0; 2], |d| [d.faults.len(), d.at]);
        let gpu = self.device().is_some();
        let progress = self.opening.as_ref().map(Opening::progress).filter(|p| *p > 0.0 && self.keeps.is_none());
        let Some(screen) = &mut self.screen else { return Ok(()) };
        let size = self.size;
        let map = self.map.as_ref().and_then(|m| m.done.as_ref());
        let here = map.map(|done| done.picture.as_slice()).or(self.pixels.as_ref().map(|f| f.color.as_slice()));
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
                let said = self.notes.iter().chain(lines.iter().filter(|line| !self.notes.contains(line)));
                screen.window.set_title(&format!("planecast - {}", said.cloned().collect::<Vec<_>>().join(" - ")));
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
        let (mut ruler, pose) = (self.ruler.clone(), self.control.pose);
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
            faults,
            notes: &self.notes,
            pace: self.pace.as_ref().map(Pace::describe),
            recent: &self.recent,
            tune: &mut self.tune,
            values,
            ruler: &mut ruler,
            beside: at[0] > 0,
        };
        let points = |n: u32| n as f32 / screen.window.scale_factor() as f32;
        let min = egui::pos2(points(at[0]), points(at[1]));
        let fault = self.map.as_ref().and_then(|m| {
            let done = m.done.as_ref()?;
            let size = [m.frame.width, m.frame.height];
            Some(Fault { at: *done.faults.get(done.at)?, size, frame: &m.frame.color, exact: &done.exact.color })
        });
        let overlay =
            self.world.as_ref().filter(|_| self.panel.open || self.ruler.on || fault.is_some()).map(|world| Overlay {
                pose,
                about: world.about(),
                area: egui::Rect::from_min_size(min, egui::vec2(points(area[0]), points(area[1]))),
                distance: self.ahead,
                hover: self.hover.clone(),
                ruler: &self.ruler,
                fault,
            });
        let (egui, wishes) = panel::run(&screen.ctx, input, &mut self.panel, &mut subject, overlay.as_ref());
        self.ruler.on = ruler.on;
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
        let shown = canvas.show(&screen.window, picture, [at, area, picture_size], &mut painting, grab);
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

/// By what a world is known again.
fn content(world: &Held) -> Option<&str> {
    world.whole().map(|world| world.content_hash.as_str()).filter(|content| !content.is_empty())
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
                (self.dragging, self.shift) = (None, false);
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
            WindowEvent::MouseInput { state: ElementState::Pressed, button, .. } if !taken => {
                self.dragging = Some(button);
                self.pressed = self.cursor;
                let now = Instant::now();
                let near = |at: [f64; 2]| (0..2).all(|i| (at[i] - self.cursor[i]).abs() < DOUBLE.1);
                match self.clicked.take() {
                    Some((then, at)) if now - then < DOUBLE.0 && near(at) && !self.ruler.on => {
                        self.double_click(self.cursor);
                    }
                    _ => self.clicked = Some((now, self.cursor)),
                }
            }
            WindowEvent::MouseInput { state: ElementState::Released, button, .. } => {
                let still = (0..2).all(|i| (self.pressed[i] - self.cursor[i]).abs() < CLICK);
                if self.dragging.take() == Some(button) && button == MouseButton::Left && still {
                    self.click(self.cursor);
                }
                self.linger = LINGER;
            }
            WindowEvent::CursorMoved { position, .. } => {
                let at = [position.x, position.y];
                if let Some(button) = self.dragging.filter(|_| !self.captured) {
                    self.drag(button, at[0] - self.cursor[0], at[1] - self.cursor[1]);
                }
                self.cursor = at;
                // What is under it is said.
                self.linger = self.linger.max(2);
            }
            WindowEvent::CursorLeft { .. } => self.cursor = [-1.0; 2],
            WindowEvent::MouseWheel { delta, .. } if !taken => {
                let notches = match delta {
                    MouseScrollDelta::LineDelta(_, y) => f64::from(y),
                    MouseScrollDelta::PixelDelta(p) => p.y / 50.0,
                };
                self.control.wheel(notches);
                self.linger = LINGER;
                if self.control.mode() != Mode::Orbit {
                    self.say(format!("{:.1} voxels a second", self.control.speed));
                }
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
        let paging = self.panel.stats.paging;
        let due = self.repaint_at.is_some_and(|t| t <= now);
        // Those that have come are shown at once.
        let arrives = paging.tiles_missing > 0 && paging.tiles_arrived > 0;
        if self.is_active() || due || arrives {
            screen.window.request_redraw();
            event_loop.set_control_flow(ControlFlow::Poll);
            return;
        }
        self.then = now;
        let words = self.words.iter().map(|w| w.1).min();
        let noted = (!self.notes.is_empty()).then_some(self.noted + NOTES).filter(|t| *t > now);
        let rests = (self.panel.refines && !self.refined && self.world.is_some()).then_some(self.rests + REST);
        let again = (paging.tiles_missing > 0).then(|| now + AGAIN);
        match [self.repaint_at, words, noted, rests, again].into_iter().flatten().min() {
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
