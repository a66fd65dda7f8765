//! The scenes that are measured, made on the spot and kept in the run's folder, and the views of them.

use crate::{Camera, Resident, Result};
use glam::DVec3;
use planecast_encoder::build;
use planecast_encoder::format::write;
use planecast_encoder::inspect::info;
use planecast_encoder::source::{self, ReadOptions};
use planecast_encoder::{BuildOptions, ColorMode, Colors, Encoding, Error as FileError, PcastFile, Scene};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A scene of the bench.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, clap::ValueEnum, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Name {
    Shapes,
    Landscape,
    Mixing,
    Scan,
    Serpent,
    City,
}

impl Name {
    pub const ALL: [Name; 6] = [Name::Shapes, Name::Landscape, Name::Mixing, Name::Scan, Name::Serpent, Name::City];

    pub fn text(self) -> &'static str {
        match self {
            Name::Shapes => "shapes",
            Name::Landscape => "landscape",
            Name::Mixing => "mixing",
            Name::Scan => "scan",
            Name::Serpent => "serpent",
            Name::City => "city",
        }
    }

    /// What the procedural scene is, and what it stands for.
    pub fn about(self) -> &'static str {
        match self {
            Name::Shapes => "artificial coloured scene of many complex shapes, for that of the papers",
            Name::Landscape => "fractal landscape with caves and floating rocks, for the paper's landscape",
            Name::Mixing => "turbulent mixing layer, for the Richtmyer-Meshkov data set",
            Name::Scan => "a tree in a pot, leaves as thin noisy sheets, for the CT scan Bonsai",
            Name::Serpent => "a coiled, scaly, hollow closed surface, for the voxelised mesh Dragon",
            Name::City => "houses with rooms, floors and windows, for the map Mansion",
        }
    }

    /// The kind of procedural scene, and its side in columns at full size.
    fn procedural(self) -> (&'static str, u32) {
        match self {
            Name::Landscape => ("terrain", 1024),
            Name::Scan => ("scan", 512),
            other => (other.text(), 1024),
        }
    }

    /// Side in columns with everything `shrink` times smaller.
    pub fn side(self, shrink: u32) -> u32 {
        (self.procedural().1 / shrink).max(8)
    }
}

/// One encoding of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Key {
    pub name: Name,
    /// In columns; of no effect where the scene comes from a file.
    pub side: u32,
    pub encoding: Encoding,
    pub color: ColorMode,
}

/// A scene in memory, with the figures of its file.
pub struct Loaded {
    pub scene: Arc<Scene>,
    pub resident: Arc<Resident>,
    pub info: info::Info,
}

/// Where scenes come from.
pub struct Scenes {
    /// Folder for encoded scenes.
    pub folder: PathBuf,
    /// Files to take in place of procedural scenes.
    pub files: BTreeMap<Name, PathBuf>,
}

impl Scenes {
    /// What the scene is made from: a file's name, or that of a procedural scene.
    pub fn source(&self, key: &Key) -> String {
        match self.files.get(&key.name) {
            Some(file) => file.file_name().unwrap_or(file.as_os_str()).to_string_lossy().into_owned(),
            None => format!("procedural:{}?size={}", key.name.procedural().0, key.side),
        }
    }

    /// Loads a scene; makes it first where the run's folder does not have it.
    pub fn load(&self, key: &Key) -> Result<Loaded> {
        let given = self.files.get(&key.name).filter(|f| f.extension().is_some_and(|e| e == "pcast"));
        let path = match given {
            Some(file) => file.clone(),
            None => self.encoded(key)?,
        };
        let file = PcastFile::open(&path)?;
        let (info, scene) = (info::info(&file)?, file.read_scene()?);
        let resident = Arc::new(Resident::new(&scene));
        Ok(Loaded { scene: Arc::new(scene), resident, info })
    }

    fn encoded(&self, key: &Key) -> Result<PathBuf> {
        let Key { name, side, encoding, color } = *key;
        let origin = if self.files.contains_key(&name) { "file".into() } else { side.to_string() };
        let lower = |v: &dyn std::fmt::Debug| format!("{v:?}").to_lowercase();
        let version = env!("CARGO_PKG_VERSION");
        let file = format!("{}-{origin}-{}-{}-{version}.pcast", name.text(), lower(&encoding), lower(&color));
        let path = self.folder.join(file);
        if path.exists() {
            return Ok(path);
        }
        std::fs::create_dir_all(&self.folder).map_err(|e| FileError::io(&self.folder, "create the folder", e))?;
        let from = self.files.get(&name).cloned().unwrap_or_else(|| self.source(key).into());
        let mut input = source::open(Path::new(&from), &ReadOptions::default())?;
        if matches!(input.colors, Colors::None) && color != ColorMode::None {
            input.colors = Colors::Function(Box::new(|_, _, _| planecast_encoder::encode::build::UNCOLORED));
        }
        let options = BuildOptions { encoding, color: Some(color), ..BuildOptions::default() };
        write::write_scene(&build(input, &options)?, &path)?;
        Ok(path)
    }
}

/// Where the cameras of a configuration stand; all see 60 degrees vertically.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum View {
    /// Between the shapes.
    Near,
    /// Above the shapes, towards the horizon.
    Far,
    /// A turn in eight steps above the ground, a little downwards.
    Around,
    /// From eight sides, the whole scene in sight.
    Outside,
    /// A turn in eight steps over a layer.
    Over,
    /// From high above, so far that 400 copies lie in sight.
    Copies,
    /// From above the middle, straight down, turned in four steps.
    Down,
    /// From eight sides, so close that a scene as high as wide fills the picture.
    Close,
    /// Level, 20° and 60° down from above the ground.
    Pitches,
}

const FOV: f64 = 60.0;
/// Copies that [`View::Copies`] has in sight.
const COPIES: f64 = 400.0;

impl View {
    pub fn name(self) -> &'static str {
        match self {
            View::Near => "near",
            View::Far => "far",
            View::Around => "8 yaws over the ground",
            View::Outside => "8 sides",
            View::Over => "8 yaws over the layer",
            View::Copies => "400 copies from above",
            View::Down => "straight down",
            View::Close => "8 sides, close",
            View::Pitches => "level, 20° and 60° down",
        }
    }

    pub fn cameras(self, loaded: &Loaded, [width, height]: [u32; 2]) -> Vec<Camera> {
        let [nx, ny, nz] = loaded.scene.dims().map(f64::from);
        // Heights are in sides, but those of flat worlds over what is there.
        let (side, top) = (nx.max(nz), f64::from(loaded.resident.levels[0].top));
        let at = |x: f64, y: f64, z: f64, yaw: f64, pitch: f64| {
            let eye = loaded.above(DVec3::new(x * nx, y, z * nz));
            Camera { eye, yaw, pitch, roll: 0.0, fov: FOV, width, height }
        };
        let turn = |y: f64, pitch: f64| (0..8).map(|i| at(0.5, y, 0.5, 45.0 * f64::from(i) + 10.0, pitch)).collect();
        match self {
            View::Near => vec![at(0.488, 0.117 * side, 0.879, 10.0, -5.0)],
            View::Far => vec![at(0.488, 1.367 * side, 0.879, 10.0, -20.0)],
            View::Around => turn(top, -8.0),
            View::Over => turn(0.85 * ny, -15.0),
            View::Outside => (0..8)
                .map(|i| {
                    let yaw = 45.0 * f64::from(i) + 10.0;
                    let (sin, cos) = yaw.to_radians().sin_cos();
                    at(0.5 - 1.15 * sin, 0.5 * ny + 0.55 * side, 0.5 + 1.15 * cos, yaw, -25.0)
                })
                .collect(),
            View::Copies => {
                vec![at(0.5, top + 2.5 * side, 0.5, 10.0, -25.0), at(0.5, top + 2.5 * side, 0.5, 55.0, -25.0)]
            }
            View::Down => (0..4).map(|i| at(0.5, top + 0.5 * side, 0.5, 22.5 * f64::from(i), -90.0)).collect(),
            View::Close => {
                let (away, over) = (0.8 * side, 0.05 * top + 0.35 * side);
                (0..8)
                    .map(|i| {
                        let yaw = 45.0 * f64::from(i) + 10.0;
                        let (sin, cos) = yaw.to_radians().sin_cos();
                        let (x, z) = (0.5 - away / nx * sin, 0.5 + away / nz * cos);
                        at(x, 0.45 * top + over, z, yaw, -over.atan2(away).to_degrees())
                    })
                    .collect()
            }
            View::Pitches => {
                let y = top + 0.05 * side;
                vec![at(0.5, y, 0.5, 10.0, 0.0), at(0.5, y, 0.5, 100.0, -20.0), at(0.5, y, 0.5, 190.0, -60.0)]
            }
        }
    }

    /// Voxels that the view reaches where that follows from the view itself.
    pub fn distance(self, loaded: &Loaded, [width, height]: [u32; 2]) -> Option<f64> {
        let [nx, _, nz] = loaded.scene.dims().map(f64::from);
        let camera = Camera { eye: DVec3::ZERO, yaw: 0.0, pitch: 0.0, roll: 0.0, fov: FOV, width, height };
        // The sector of a circle that is in sight has an area of ½ · angle · distance².
        let angle = 2.0 * camera.half_extent().x.atan();
        (self == View::Copies).then(|| (2.0 * COPIES * nx * nz / angle).sqrt())
    }
}

impl Loaded {
    /// The eye, or where it would be within or close to something solid, the first free place above. Worlds repeat.
    fn above(&self, eye: DVec3) -> DVec3 {
        let [nx, ny, nz] = self.scene.dims();
        let place = |v: f64, n: u32| (v.floor() as i64).rem_euclid(i64::from(n)) as u32;
        let (x, z) = (place(eye.x, nx), place(eye.z, nz));
        let solid = |y: f64| y >= 0.0 && y < f64::from(ny) && self.scene.levels[0].solid.find(x, y as u32, z).is_some();
        let mut eye = eye;
        while (-2..=2).any(|dy| solid(eye.y + f64::from(dy))) {
            eye.y += 1.0;
        }
        eye
    }
}
