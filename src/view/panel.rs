//! What egui draws over the picture: the panel, the help, and words on the screen.

use std::collections::VecDeque;
use std::path::PathBuf;

use egui::{Align2, Color32, RichText, Ui};
use planecast_encoder::format::features::Named;
use planecast_encoder::model::about::Kind;

use super::browse::Browser;
use super::control::{Control, Mode};
use super::overlay::{Overlay, Ruler};
use super::tune::{Keeps, RAMPS, Tune, number_after};
use crate::frame::options::{Options, Planes, Remap, Shading};
use crate::frame::picture::{StageTimes, Stats};
use crate::frame::preset::Preset;
use crate::render::drawer::Draws;
use crate::world::residency::Held;
use crate::{Feature, Kernel};

/// Frames that the graph shows.
const FRAMES: usize = 160;

/// Points that the panel is wide.
pub const WIDTH: f32 = 288.0;

/// Milliseconds of one frame, for the graph.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cost {
    pub stages: StageTimes,
    pub present: f64,
}

impl Cost {
    fn parts(&self) -> [f64; 5] {
        let s = self.stages;
        [s.setup, s.traverse, s.remap, s.shade, self.present]
    }
}

const PARTS: [(&str, Color32); 5] = [
    ("setup", Color32::from_rgb(150, 150, 150)),
    ("traverse", Color32::from_rgb(230, 120, 60)),
    ("remap", Color32::from_rgb(90, 170, 230)),
    ("shade", Color32::from_rgb(120, 200, 110)),
    ("present", Color32::from_rgb(210, 110, 210)),
];

/// What a person did in the panel, for the window to do.
#[derive(Clone, Debug, PartialEq)]
pub enum Wish {
    /// Lists files to open.
    Browse,
    Open(PathBuf),
    /// The input is read in another way; at another threshold.
    Tuned(Keeps),
    Threshold,
    /// Goes on to another error, or back.
    Fault(i32),
    Draw(Draws),
    CopyCommand,
    Screenshot,
    ErrorMap,
    Record,
    Play,
    GoodView,
    FullScreen,
}

/// State of the panel itself.
#[derive(Debug)]
pub struct Panel {
    pub open: bool,
    pub help: bool,
    pub costs: VecDeque<Cost>,
    pub stats: Stats,
    /// Frames shown a second.
    pub fps: f64,
    /// Frames a second to hold, and whether they are held.
    pub target_fps: f64,
    pub holds: bool,
    pub vsync: bool,
    pub screenshot_size: Option<[u32; 2]>,
    /// All pixels, and the best preset, while nothing moves.
    pub refines: bool,
    pub browser: Browser,
}

impl Default for Panel {
    fn default() -> Panel {
        Panel {
            open: true,
            help: false,
            costs: VecDeque::new(),
            stats: Stats::default(),
            fps: 0.0,
            target_fps: 60.0,
            holds: false,
            vsync: true,
            screenshot_size: None,
            refines: true,
            browser: Browser::default(),
        }
    }
}

/// What the panel shows and may change.
pub struct Subject<'s> {
    pub world: Option<&'s Held>,
    pub control: &'s mut Control,
    pub options: &'s mut Options,
    pub draws: Draws,
    /// Whether there is a GPU to choose.
    pub gpu: bool,
    pub device: &'s str,
    /// Lines on the screen: what is under way, what went wrong.
    pub words: &'s [String],
    /// Share of an encoding that is done.
    pub progress: Option<f32>,
    pub recording: bool,
    pub playable: bool,
    pub error_map: bool,
    /// Places of errors, and which of them is looked at.
    pub faults: [usize; 2],
    /// What is drawn is not what was asked for: each a line.
    pub notes: &'s [String],
    /// How the frame rate is held.
    pub pace: Option<String>,
    pub recent: &'s [PathBuf],
    pub tune: &'s mut Tune,
    /// Least and greatest value of a volume, and how many there are between.
    pub values: Option<([f32; 2], Vec<u32>)>,
    pub ruler: &'s mut Ruler,
    /// The panel lies beside the picture, not on it.
    pub beside: bool,
}

impl Panel {
    pub fn cost(&mut self, cost: Cost) {
        if self.costs.len() == FRAMES {
            self.costs.pop_front();
        }
        self.costs.push_back(cost);
    }

    /// Lays everything out.
    pub fn show(&mut self, ui: &mut Ui, subject: &mut Subject<'_>, wishes: &mut Vec<Wish>) {
        let ctx = ui.ctx().clone();
        if self.open && subject.beside {
            let frame = egui::Frame::side_top_panel(ui.style()).fill(Color32::from_gray(24));
            egui::Panel::left("panel").resizable(false).exact_size(WIDTH).frame(frame).show(ui, |ui| {
                egui::ScrollArea::vertical().auto_shrink([false; 2]).show(ui, |ui| self.content(ui, subject, wishes));
            });
        } else if self.open {
            egui::Window::new("planecast")
                .id(egui::Id::unique("panel"))
                .default_pos([8.0, 8.0])
                .default_width(WIDTH)
                .default_height(ctx.content_rect().height() - 60.0)
                .vscroll(true)
                .show(&ctx, |ui| self.content(ui, subject, wishes));
        }
        words(&ctx, subject);
        if self.help {
            help(&ctx, &mut self.help);
        }
        if self.browser.open {
            wishes.extend(self.browser.show(ui).map(Wish::Open));
        }
    }

    fn content(&mut self, ui: &mut Ui, subject: &mut Subject<'_>, wishes: &mut Vec<Wish>) {
        ui.style_mut().spacing.item_spacing.y = 4.0;
        ui.horizontal(|ui| {
            if ui.button("Open (O)").clicked() {
                wishes.push(Wish::Browse);
            }
            ui.add_enabled_ui(!subject.recent.is_empty(), |ui| {
                ui.menu_button("Recent", |ui| {
                    for path in subject.recent {
                        let name = path.file_name().map_or(path.display().to_string(), |n| n.to_string_lossy().into());
                        if ui.button(name).on_hover_text(path.display().to_string()).clicked() {
                            wishes.push(Wish::Open(path.clone()));
                            ui.close();
                        }
                    }
                });
            });
            if ui.button("Keys (F1)").clicked() {
                self.help = true;
            }
        });
        if let Some(world) = subject.world {
            let [x, y, z] = world.dims();
            ui.label(RichText::new(world.name()).strong());
            let kind = world.about().kind.map_or(String::new(), |kind| format!("{}, ", kind.name()));
            ui.label(format!("{kind}{x} × {y} × {z} voxels"));
        }
        ui.separator();
        self.view(ui, subject, wishes);
        ui.separator();
        self.picture(ui, subject, wishes);
        tuning(ui, subject, wishes);
        ui.separator();
        if let Some(world) = subject.world {
            ui.collapsing("About this file", |ui| about(ui, world));
        }
        ui.collapsing("Errors of the picture", |ui| faults(ui, subject, wishes));
        ui.collapsing("Switches", |ui| self.drawing(ui, subject, wishes));
        ui.collapsing("Times and figures", |ui| {
            self.times(ui, subject);
            if let Some(world) = subject.world {
                ui.separator();
                scene(ui, world, &self.stats);
            }
        });
    }

    /// How one moves.
    fn view(&mut self, ui: &mut Ui, subject: &mut Subject<'_>, wishes: &mut Vec<Wish>) {
        let control = &mut *subject.control;
        let mut mode = control.mode();
        ui.horizontal_wrapped(|ui| {
            for of in Mode::ALL {
                ui.selectable_value(&mut mode, of, of.name());
            }
        });
        if mode != control.mode() {
            control.set_mode(mode);
        }
        if mode != Mode::Orbit {
            ui.add(egui::Slider::new(&mut control.speed, 0.25..=100_000.0).logarithmic(true).text("voxels/s"));
        }
        ui.add(egui::Slider::new(&mut control.pose.fov, 5.0..=150.0).text("field of view, °"));
        if mode == Mode::Walk {
            ui.add(egui::Slider::new(&mut control.eye_height, 0.5..=50.0).logarithmic(true).text("eye height"));
        }
        ui.horizontal_wrapped(|ui| {
            button(ui, "Good view (Home)", Wish::GoodView, wishes);
            ui.toggle_value(&mut subject.ruler.on, "Measure (L)").on_hover_text("click two places");
        });
    }

    /// How it is drawn and kept.
    fn picture(&mut self, ui: &mut Ui, subject: &mut Subject<'_>, wishes: &mut Vec<Wish>) {
        let o = &mut *subject.options;
        ui.horizontal(|ui| {
            for preset in Preset::ALL {
                if ui.selectable_label(preset.options(*o) == *o, preset.name()).clicked() {
                    *o = preset.options(*o);
                }
            }
            ui.checkbox(&mut self.refines, "best at rest");
        });
        ui.horizontal(|ui| {
            ui.checkbox(&mut self.holds, "hold");
            ui.add(egui::DragValue::new(&mut self.target_fps).range(1.0..=480.0).suffix(" frames/s"));
        });
        ui.horizontal_wrapped(|ui| {
            button(ui, "Screenshot (F12)", Wish::Screenshot, wishes);
            button(ui, if subject.recording { "Stop (R)" } else { "Record (R)" }, Wish::Record, wishes);
            if subject.playable {
                button(ui, "Play (P)", Wish::Play, wishes);
            }
            button(ui, "Copy command (C)", Wish::CopyCommand, wishes);
            button(ui, "Full screen (F)", Wish::FullScreen, wishes);
        });
        ui.horizontal(|ui| {
            let mut own = self.screenshot_size.is_some();
            if ui.checkbox(&mut own, "screenshots of").changed() {
                self.screenshot_size = own.then_some([3840, 2160]);
            }
            if let Some([w, h]) = &mut self.screenshot_size {
                ui.add(egui::DragValue::new(w).range(1..=16_384));
                ui.label("×");
                ui.add(egui::DragValue::new(h).range(1..=16_384));
            } else {
                ui.label("the window's size");
            }
        });
    }

    fn times(&self, ui: &mut Ui, subject: &Subject<'_>) {
        ui.label(RichText::new(subject.device).small());
        for line in subject.notes.iter().chain(&subject.pace) {
            ui.label(RichText::new(line).small());
        }
        let size = egui::vec2(ui.available_width().max(200.0), 60.0);
        let (rect, _) = ui.allocate_exact_size(size, egui::Sense::hover());
        let paint = ui.painter_at(rect);
        paint.rect_filled(rect, 2.0, Color32::from_black_alpha(120));
        let total = |c: &Cost| c.parts().iter().sum::<f64>();
        // The few slowest, as those that compile shaders, go beyond the top.
        let mut sorted: Vec<f64> = self.costs.iter().map(total).collect();
        sorted.sort_by(f64::total_cmp);
        let most = sorted.get(sorted.len() * 19 / 20).map_or(0.01, |ms| (1.2 * ms).max(0.01));
        let width = rect.width() / FRAMES as f32;
        for (i, cost) in self.costs.iter().enumerate() {
            let x = rect.left() + width * i as f32;
            let mut y = rect.bottom();
            for (ms, (_, color)) in cost.parts().into_iter().zip(PARTS) {
                let h = (ms / most).min(2.0) as f32 * (rect.height() - 2.0);
                let bar = egui::Rect::from_min_max(egui::pos2(x, y - h), egui::pos2(x + width, y));
                paint.rect_filled(bar, 0.0, color);
                y -= h;
            }
        }
        let font = egui::FontId::monospace(10.0);
        paint.text(rect.left_top(), Align2::LEFT_TOP, format!("{most:.2} ms"), font, Color32::WHITE);
        let latest = self.costs.back().copied().unwrap_or_default();
        ui.horizontal_wrapped(|ui| {
            for (ms, (name, color)) in latest.parts().into_iter().zip(PARTS) {
                ui.label(RichText::new(format!("{name} {ms:.3}")).small().color(color));
            }
        });
        let s = &self.stats;
        ui.label(format!(
            "{:.3} ms a frame, {:.0} shown a second, {} × {}",
            total(&latest),
            self.fps,
            s.width,
            s.height
        ));
        ui.label(format!("{} planes, {} of {} levels", s.planes, s.levels_drawn, s.levels));
        let count = |n: u64| if n >= 100_000 { format!("{:.2} M", n as f64 / 1e6) } else { n.to_string() };
        ui.label(format!(
            "visited {} columns, {} runs; drew {} spans",
            count(s.columns_visited),
            count(s.runs_visited),
            count(s.spans_drawn)
        ));
        if !s.specialization.is_empty() {
            ui.label(format!("paid for: {}", s.specialization.join(", ")));
        }
        if !s.left_out.is_empty() {
            let names = s.left_out.iter().map(|l| l.split(':').next().unwrap_or_default());
            ui.label(format!("left out: {}", names.collect::<Vec<_>>().join(", ")))
                .on_hover_text(s.left_out.join("\n"));
        }
    }

    fn drawing(&mut self, ui: &mut Ui, subject: &mut Subject<'_>, wishes: &mut Vec<Wish>) {
        let name = |draws: Draws| match draws {
            Draws::Gpu(kernel) => format!("gpu, {}", kernel.name()),
            Draws::Cpu => "cpu".into(),
            Draws::Exact => "exact".into(),
        };
        egui::ComboBox::from_label("draws").selected_text(name(subject.draws)).show_ui(ui, |ui| {
            let gpu = Kernel::ALL.into_iter().filter(|_| subject.gpu).map(Draws::Gpu);
            for draws in gpu.chain([Draws::Cpu, Draws::Exact]) {
                if ui.selectable_label(draws == subject.draws, name(draws)).clicked() {
                    wishes.push(Wish::Draw(draws));
                }
            }
        });
        let o = &mut *subject.options;
        ui.horizontal(|ui| {
            let mut percent = match o.planes {
                Planes::Factor(f) => f * 100.0,
                _ => 100.0,
            };
            let slider = egui::Slider::new(&mut percent, 5.0..=400.0).logarithmic(true).suffix(" %");
            if ui.add(slider.text("planes")).changed() {
                o.planes = if (percent - 100.0).abs() < 0.5 { Planes::Auto } else { Planes::Factor(percent / 100.0) };
            }
        });
        let mut lod = o.lod.is_some();
        ui.horizontal(|ui| {
            if ui.checkbox(&mut lod, "levels").changed() {
                o.lod = lod.then_some(1.0);
            }
            if let Some(px) = &mut o.lod {
                ui.add(egui::Slider::new(px, 0.25..=16.0).logarithmic(true).suffix(" px"));
            }
        });
        ui.checkbox(&mut o.shadows, "shadows of the sun");
        ui.checkbox(&mut o.smooth, "heights as a surface");
        egui::ComboBox::from_label("shading").selected_text(shading_name(o.shading)).show_ui(ui, |ui| {
            for shading in [Shading::None, Shading::Ssn, Shading::Ssao, Shading::Full] {
                ui.selectable_value(&mut o.shading, shading, shading_name(shading));
            }
        });
        optional(ui, "fog", &mut o.fog, 1000.0);
        let mut distance = o.view_distance.is_finite().then_some(o.view_distance);
        optional(ui, "view distance", &mut distance, 4000.0);
        o.view_distance = distance.unwrap_or(f64::INFINITY);
        ui.horizontal(|ui| {
            ui.checkbox(&mut o.repeat.x, "repeat x");
            ui.checkbox(&mut o.repeat.z, "repeat z");
        });
        ui.checkbox(&mut self.vsync, "vsync");
        ui.collapsing("more switches", |ui| {
            ui.checkbox(&mut o.readjust, "readjusted spacing of planes");
            ui.add(egui::Slider::new(&mut o.samples, 0.25..=4.0).text("samples a pixel"));
            ui.horizontal(|ui| {
                ui.label("remap:");
                for remap in Remap::ALL {
                    ui.selectable_value(&mut o.remap, remap, remap.name());
                }
            });
            ui.checkbox(&mut o.gap_fill, "gap fill");
            optional(ui, "equidistant beyond", &mut o.equidistant, 500.0);
            ui.horizontal_wrapped(|ui| {
                ui.label("cull:");
                let c = &mut o.culling;
                let parts = [
                    (&mut c.horizon, "horizon"),
                    (&mut c.center, "center"),
                    (&mut c.forward, "forward"),
                    (&mut c.bits, "bits"),
                    (&mut c.coarse, "coarse"),
                ];
                for (on, name) in parts {
                    ui.checkbox(on, name);
                }
            });
            ui.horizontal_wrapped(|ui| {
                ui.label("may leave out:");
                for feature in Feature::ALL {
                    let mut on = o.specialize.has(feature);
                    // Whether tables are those of heights is settled when a scene is opened.
                    ui.add_enabled(feature != Feature::Heights, egui::Checkbox::new(&mut on, feature.name()));
                    let others = o.specialize.iter().filter(|f| *f != feature);
                    o.specialize = others.chain(on.then_some(feature)).collect();
                }
            });
            let on_cpu = !matches!(subject.draws, Draws::Gpu(_));
            ui.add_enabled_ui(on_cpu, |ui| {
                ui.checkbox(&mut o.f64_traversal, "walk in f64 (cpu)");
                ui.add(egui::Slider::new(&mut o.ssao_samples, 1..=64).text("occlusion samples"));
            });
        });
    }
}

fn button(ui: &mut Ui, text: &str, wish: Wish, wishes: &mut Vec<Wish>) {
    if ui.button(text).clicked() {
        wishes.push(wish);
    }
}

/// How the input is read: what can be changed while it is looked at.
fn tuning(ui: &mut Ui, subject: &mut Subject<'_>, wishes: &mut Vec<Wish>) {
    let Some(world) = subject.world.filter(|w| w.encoded()) else { return };
    let (rule, tune) = (&world.about().rule, &mut *subject.tune);
    let is_terrain = world.about().kind == Some(Kind::Terrain);
    let is_volume = matches!(world.about().kind, Some(Kind::Volume | Kind::Labels));
    if !is_terrain && !is_volume {
        return;
    }
    ui.separator();
    if is_volume {
        if let Some(([low, high], histogram)) = &subject.values {
            let mut threshold = tune.threshold.or(number_after(rule, "at least ")).unwrap_or(f64::from(*low));
            bars(ui, histogram, (threshold as f32 - low) / (high - low).max(f32::MIN_POSITIVE));
            ui.spacing_mut().slider_width = WIDTH - 150.0;
            let slider = egui::Slider::new(&mut threshold, f64::from(*low)..=f64::from(*high));
            if ui.add(slider.text("threshold")).changed() {
                tune.threshold = Some(threshold);
                wishes.push(Wish::Threshold);
            }
        } else {
            ui.label("the threshold can be moved once the values are read");
        }
        ui.horizontal(|ui| {
            ui.label("up:");
            for up in ["x", "y", "z"] {
                if ui.selectable_label(tune.up.as_deref() == Some(up), up).clicked() {
                    tune.up = Some(up.into());
                    wishes.push(Wish::Tuned(Keeps::Nothing));
                }
            }
            let mut as_is = tune.as_is.unwrap_or(world.about().left_out.iter().any(|l| l.contains("--spacing as-is")));
            if ui.checkbox(&mut as_is, "voxels as cubes").changed() {
                tune.as_is = Some(as_is);
                wishes.push(Wish::Tuned(Keeps::Nothing));
            }
        });
    }
    if is_terrain {
        let mut times = tune.exaggeration.or(number_after(rule, "relief ")).unwrap_or(1.0);
        if ui.add(egui::Slider::new(&mut times, 0.25..=20.0).logarithmic(true).text("times as high")).changed() {
            tune.exaggeration = Some(times);
            wishes.push(Wish::Tuned(Keeps::Height));
        }
    }
    let chosen = tune.ramp.clone().unwrap_or_else(|| "as opened".into());
    egui::ComboBox::from_label("colours").selected_text(chosen).show_ui(ui, |ui| {
        for ramp in RAMPS {
            if ui.selectable_label(tune.ramp.as_deref() == Some(ramp), ramp).clicked() {
                tune.ramp = Some(ramp.into());
                wishes.push(Wish::Tuned(Keeps::All));
            }
        }
    });
}

/// How many values there are of each, and where the threshold is, as a share of the range.
fn bars(ui: &mut Ui, histogram: &[u32], threshold: f32) {
    let (rect, _) = ui.allocate_exact_size(egui::vec2(ui.available_width(), 40.0), egui::Sense::hover());
    let paint = ui.painter_at(rect);
    paint.rect_filled(rect, 2.0, Color32::from_black_alpha(120));
    // Air is most of many volumes: by the logarithm it leaves the others to be seen.
    let most = histogram.iter().copied().max().unwrap_or(1).max(1) as f32;
    let wide = rect.width() / histogram.len().max(1) as f32;
    for (i, &n) in histogram.iter().enumerate() {
        let high = (1.0 + n as f32).ln() / (1.0 + most).ln() * (rect.height() - 2.0);
        let x = rect.left() + wide * i as f32;
        let bar = egui::Rect::from_min_max(egui::pos2(x, rect.bottom() - high), egui::pos2(x + wide, rect.bottom()));
        let solid = (i as f32 + 0.5) / histogram.len() as f32 >= threshold;
        paint.rect_filled(bar, 0.0, if solid { Color32::from_rgb(238, 200, 166) } else { Color32::from_gray(90) });
    }
}

/// What the input is, and how it was read.
fn about(ui: &mut Ui, world: &Held) {
    let text = world.about().to_string();
    let notes = world.whole().into_iter().flat_map(|world| &world.notes);
    for line in text.lines().flat_map(|line| line.split("; ")).chain(notes.map(String::as_str)) {
        ui.label(RichText::new(line).small());
    }
}

fn faults(ui: &mut Ui, subject: &Subject<'_>, wishes: &mut Vec<Wish>) {
    let [n, at] = subject.faults;
    ui.horizontal_wrapped(|ui| {
        button(
            ui,
            if subject.error_map { "Picture (X)" } else { "Compare with exact rays (X)" },
            Wish::ErrorMap,
            wishes,
        );
        if subject.error_map && n > 0 {
            button(ui, "previous (B)", Wish::Fault(-1), wishes);
            button(ui, "next (N)", Wish::Fault(1), wishes);
            ui.label(format!("{} of {n}", at + 1));
        } else if subject.error_map {
            ui.label("no other voxel is shown anywhere");
        }
    });
}

fn shading_name(shading: Shading) -> &'static str {
    match shading {
        Shading::None => "none",
        Shading::Ssn => "ssn",
        Shading::Ssao => "ssao",
        Shading::Full => "full",
    }
}

/// A length in voxels that may be left out.
fn optional(ui: &mut Ui, name: &str, value: &mut Option<f64>, usual: f64) {
    ui.horizontal(|ui| {
        let mut on = value.is_some();
        if ui.checkbox(&mut on, name).changed() {
            *value = on.then_some(usual);
        }
        if let Some(v) = value {
            let speed = 0.01 * *v;
            ui.add(egui::DragValue::new(v).range(1.0..=1e9).speed(speed).suffix(" voxels"));
        }
    });
}

fn scene(ui: &mut Ui, world: &Held, stats: &Stats) {
    let [x, y, z] = world.dims();
    ui.label(RichText::new(world.name()).strong());
    let bytes = planecast_encoder::encode::memory::display;
    let (world, on_gpu) = match world {
        Held::Whole(world) => (world, stats.bytes_scene_gpu),
        Held::Tiles(tiles) => {
            let paging = &stats.paging;
            ui.label(format!("{x} × {y} × {z} voxels, {} levels, in tiles", tiles.source.levels()));
            ui.label(format!(
                "{} tiles wanted, {} missing; {} came, {} went",
                paging.tiles_wanted, paging.tiles_missing, paging.tiles_arrived, paging.tiles_evicted
            ));
            ui.label(format!("debt {} levels × pixels; drawn with lod {:.2}", paging.debt, paging.lod));
            ui.label(format!("{} of tiles in memory", bytes(paging.bytes_resident)));
            ui.label(format!("{:.2} ms for reading, {:.2} for the tables", paging.unpack_ms, paging.upload_ms));
            return;
        }
    };
    ui.label(format!("{x} × {y} × {z} voxels, {} levels", world.resident.levels.len()));
    let b = &world.bytes;
    if b.total > 0 {
        ui.label(format!(
            "geometry {}, columns {}, exposure {}, colour {}, other {}",
            bytes(b.geometry),
            bytes(b.columns),
            bytes(b.exposure),
            bytes(b.color),
            bytes(b.other)
        ));
        ui.label(format!("{} as a file, {} to draw from", bytes(b.total), bytes(world.resident.bytes())));
    } else {
        ui.label(format!("{} to draw from", bytes(world.resident.bytes())));
    }
    if on_gpu > 0 {
        ui.label(format!("{} on the gpu", bytes(on_gpu)));
    }
}

fn words(ctx: &egui::Context, subject: &Subject<'_>) {
    if subject.words.is_empty() && subject.progress.is_none() {
        return;
    }
    egui::Area::new(egui::Id::unique("words")).anchor(Align2::RIGHT_BOTTOM, [-12.0, -46.0]).interactable(false).show(
        ctx,
        |ui| {
            egui::Frame::popup(ui.style()).show(ui, |ui| {
                ui.set_max_width((ctx.content_rect().width() * 0.6).min(640.0));
                for line in subject.words {
                    ui.label(line);
                }
                if let Some(part) = subject.progress {
                    ui.add(egui::ProgressBar::new(part).show_percentage().desired_width(240.0));
                }
            });
        },
    );
}

/// Keys and what they do.
pub const KEYS: [(&str, &str); 24] = [
    ("drag", "look around, or turn what is orbited; M: without a button"),
    ("right drag", "move across the picture"),
    ("W A S D", "forward, left, back, right; an orbit: nearer, round"),
    ("Space, Ctrl", "up, down"),
    ("Shift", "four times as fast"),
    ("wheel", "speed; an orbit: nearer"),
    ("Q E", "roll; Z levels the horizon"),
    ("double click", "fly to that place"),
    ("G", "orbit, fly, fly without going through ground, walk"),
    ("O", "open a file"),
    ("L", "measure: click two places"),
    ("1 2 3", "presets fast, balanced, best"),
    ("T", "hold the frame rate"),
    ("X", "error map of this view"),
    ("N B", "next and previous error"),
    ("C", "copy the command that draws this view"),
    ("R", "record a path, or stop"),
    ("P", "play it"),
    ("F", "full screen"),
    ("F12", "screenshot"),
    ("Home", "a good view, out of the ground"),
    ("Tab", "the panel"),
    ("F1", "this list"),
    ("Esc", "give the mouse back; leave full screen; quit"),
];

fn help(ctx: &egui::Context, open: &mut bool) {
    egui::Window::new("keys").id(egui::Id::unique("help")).open(open).anchor(Align2::CENTER_CENTER, [0.0, 0.0]).show(
        ctx,
        |ui| {
            egui::Grid::new("keys").striped(true).show(ui, |ui| {
                for (key, does) in KEYS {
                    ui.label(RichText::new(key).strong());
                    ui.label(does);
                    ui.end_row();
                }
            });
            ui.label("A scene file or anything that encode reads can be dropped on the window.");
        },
    );
}

/// Runs egui once, laying out `panel`.
pub fn run(
    ctx: &egui::Context,
    input: egui::RawInput,
    panel: &mut Panel,
    subject: &mut Subject<'_>,
    overlay: Option<&Overlay<'_>>,
) -> (egui::FullOutput, Vec<Wish>) {
    let mut wishes = Vec::new();
    let output = ctx.run_ui(input, |ui| {
        panel.show(ui, subject, &mut wishes);
        if let Some(overlay) = overlay {
            overlay.paint(ui.ctx());
        }
    });
    (output, wishes)
}
