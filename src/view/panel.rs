//! What egui draws over the picture: the panel, the help, and words on the screen.

use std::collections::VecDeque;

use egui::{Align2, Color32, RichText, Ui};
use planecast_encoder::format::features::Named;

use super::control::{Control, Mode};
use crate::frame::options::{Options, Planes, Remap, Shading};
use crate::frame::picture::{StageTimes, Stats};
use crate::frame::preset::Preset;
use crate::render::drawer::Draws;
use crate::world::World;
use crate::{Feature, Kernel};

/// Frames that the graph shows.
const FRAMES: usize = 160;

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
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Wish {
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
        }
    }
}

/// What the panel shows and may change.
pub struct Subject<'s> {
    pub world: Option<&'s World>,
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
        words(&ctx, subject);
        if self.help {
            help(&ctx, &mut self.help);
        }
        if !self.open {
            return;
        }
        egui::Window::new("planecast")
            .id(egui::Id::unique("panel"))
            .default_pos([8.0, 8.0])
            .default_width(300.0)
            .default_height(ctx.content_rect().height() - 60.0)
            .vscroll(true)
            .show(&ctx, |ui| {
                ui.style_mut().spacing.item_spacing.y = 3.0;
                self.times(ui, subject);
                ui.separator();
                self.drawing(ui, subject, wishes);
                ui.separator();
                self.camera(ui, subject, wishes);
                if let Some(world) = subject.world {
                    ui.separator();
                    scene(ui, world, self.stats.bytes_scene_gpu);
                }
            });
    }

    fn times(&self, ui: &mut Ui, subject: &Subject<'_>) {
        ui.label(RichText::new(subject.device).small());
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
            for preset in Preset::ALL {
                if ui.selectable_label(preset.options(*o) == *o, preset.name()).clicked() {
                    *o = preset.options(*o);
                }
            }
        });
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
        ui.horizontal(|ui| {
            let mut holds = self.holds;
            ui.checkbox(&mut holds, "hold");
            ui.add(egui::DragValue::new(&mut self.target_fps).range(1.0..=480.0).suffix(" fps"));
            self.holds = holds;
            ui.checkbox(&mut self.vsync, "vsync");
        });
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

    fn camera(&mut self, ui: &mut Ui, subject: &mut Subject<'_>, wishes: &mut Vec<Wish>) {
        let control = &mut *subject.control;
        let p = control.pose;
        let eye = p.eye;
        ui.label(format!("eye {:.1}, {:.1}, {:.1}", eye.x, eye.y, eye.z));
        ui.label(format!("yaw {:.1}°, pitch {:.1}°, roll {:.1}°", p.yaw, p.pitch, p.roll));
        ui.horizontal(|ui| {
            let mut mode = control.mode();
            for of in Mode::ALL {
                ui.selectable_value(&mut mode, of, of.name());
            }
            if mode != control.mode() {
                control.set_mode(mode);
            }
        });
        ui.add(egui::Slider::new(&mut control.speed, 0.25..=100_000.0).logarithmic(true).text("voxels/s"));
        ui.add(egui::Slider::new(&mut control.pose.fov, 5.0..=150.0).text("field of view, °"));
        if control.mode() == Mode::Walk {
            ui.add(egui::Slider::new(&mut control.eye_height, 0.5..=50.0).logarithmic(true).text("eye height"));
        }
        let button = |ui: &mut Ui, text: &str, wish: Wish, wishes: &mut Vec<Wish>| {
            if ui.button(text).clicked() {
                wishes.push(wish);
            }
        };
        ui.horizontal_wrapped(|ui| {
            button(ui, "copy command (C)", Wish::CopyCommand, wishes);
            button(ui, if subject.error_map { "picture (X)" } else { "error map (X)" }, Wish::ErrorMap, wishes);
            button(ui, "good view (Home)", Wish::GoodView, wishes);
            button(ui, if subject.recording { "stop (R)" } else { "record (R)" }, Wish::Record, wishes);
            if subject.playable {
                button(ui, "play (P)", Wish::Play, wishes);
            }
            button(ui, "full screen (F)", Wish::FullScreen, wishes);
            if ui.button("help (F1)").clicked() {
                self.help = true;
            }
        });
        ui.horizontal(|ui| {
            button(ui, "screenshot (F12)", Wish::Screenshot, wishes);
            let mut own = self.screenshot_size.is_some();
            if ui.checkbox(&mut own, "at").changed() {
                self.screenshot_size = own.then_some([3840, 2160]);
            }
            if let Some([w, h]) = &mut self.screenshot_size {
                ui.add(egui::DragValue::new(w).range(1..=16_384));
                ui.label("×");
                ui.add(egui::DragValue::new(h).range(1..=16_384));
            }
        });
    }
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

fn scene(ui: &mut Ui, world: &World, on_gpu: u64) {
    let [x, y, z] = world.resident.dims;
    ui.label(RichText::new(world.name()).strong());
    ui.label(format!("{x} × {y} × {z} voxels, {} levels", world.resident.levels.len()));
    let bytes = planecast_encoder::encode::memory::display;
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
    egui::Area::new(egui::Id::unique("words")).anchor(Align2::RIGHT_BOTTOM, [-12.0, -12.0]).interactable(false).show(
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
pub const KEYS: [(&str, &str); 20] = [
    ("drag", "look around; M: without a button"),
    ("W A S D", "forward, left, back, right"),
    ("Space, Ctrl", "up, down"),
    ("Shift", "four times as fast"),
    ("wheel", "speed"),
    ("Q E", "roll; Z levels the horizon"),
    ("double click", "fly to that place"),
    ("G", "fly, fly without going through ground, walk"),
    ("1 2 3", "presets fast, balanced, best"),
    ("T", "hold the frame rate"),
    ("X", "error map of this view"),
    ("C", "copy the command that draws this view"),
    ("R", "record a path, or stop"),
    ("P", "play it"),
    ("F", "full screen"),
    ("F12", "screenshot"),
    ("Home", "a good view"),
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
) -> (egui::FullOutput, Vec<Wish>) {
    let mut wishes = Vec::new();
    let output = ctx.run_ui(input, |ui| panel.show(ui, subject, &mut wishes));
    (output, wishes)
}
