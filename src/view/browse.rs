//! The list of files that Open shows.

use std::path::{Path, PathBuf};

use egui::{RichText, Ui};

/// A folder that is looked through.
#[derive(Debug, Default)]
pub struct Browser {
    pub open: bool,
    folder: PathBuf,
    /// Folders first; each with whether it is one.
    entries: Vec<(String, bool)>,
    wrong: String,
    typed: String,
}

impl Browser {
    /// Shows a folder.
    pub fn show_folder(&mut self, folder: &Path) {
        (self.open, self.wrong) = (true, String::new());
        self.folder = std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned());
        self.typed = self.folder.display().to_string();
        self.entries.clear();
        match std::fs::read_dir(&self.folder) {
            Ok(entries) => {
                let named =
                    entries.flatten().map(|e| (e.file_name().to_string_lossy().into_owned(), e.path().is_dir()));
                self.entries.extend(named.filter(|(name, _)| !name.starts_with('.')));
                self.entries.sort_by_key(|(name, folder)| (!folder, name.to_lowercase()));
            }
            Err(e) => self.wrong = format!("{}: {e}", self.folder.display()),
        }
    }

    /// The list in a window; the file, folder or address that was chosen.
    pub fn show(&mut self, ui: &Ui) -> Option<PathBuf> {
        let (mut chosen, mut goes, mut open) = (None, None, self.open);
        egui::Window::new("open")
            .id(egui::Id::unique("browser"))
            .open(&mut open)
            .default_pos([320.0, 40.0])
            .default_size([420.0, 420.0])
            .show(ui.ctx(), |ui| {
                let field = egui::TextEdit::singleline(&mut self.typed).desired_width(f32::INFINITY);
                let typed = ui.add(field).on_hover_text("a file, a folder, an address, or procedural:NAME");
                if typed.lost_focus() && ui.input(|i| i.key_pressed(egui::Key::Enter)) {
                    let path = PathBuf::from(self.typed.trim());
                    if path.is_dir() { goes = Some(path) } else { chosen = Some(path) }
                }
                ui.horizontal(|ui| {
                    if ui.button("up").clicked() {
                        goes = self.folder.parent().map(Path::to_owned);
                    }
                    if ui.button("open this folder").on_hover_text("slices, tiles, a DICOM series, Zarr").clicked() {
                        chosen = Some(self.folder.clone());
                    }
                });
                if !self.wrong.is_empty() {
                    ui.label(RichText::new(&self.wrong).color(ui.visuals().error_fg_color));
                }
                egui::ScrollArea::vertical().auto_shrink([false; 2]).show(ui, |ui| {
                    for (name, folder) in &self.entries {
                        let text = if *folder { format!("{name}/") } else { name.clone() };
                        if ui.selectable_label(false, text).clicked() {
                            let path = self.folder.join(name);
                            if *folder { goes = Some(path) } else { chosen = Some(path) }
                        }
                    }
                });
            });
        self.open = open && chosen.is_none();
        if let Some(folder) = goes {
            self.show_folder(&folder);
        }
        chosen
    }
}
