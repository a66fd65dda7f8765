//! What is measured: each part as groups of configurations that are compared with each other.

use super::measure::{Config, Engine, Rounds};
use super::paper::{self, Version};
use super::scenes::{Key, Name, View};
use crate::{Culling, Options, Planes, Remap, Repeat, Shading};
use planecast_encoder::{ColorMode, Encoding};
use std::collections::HashSet;

/// A part of the bench.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Part {
    /// Table 1 of Forstmann & Ohya 2009
    Table1,
    /// A landscape seen to 180,000 voxels
    Landscape,
    /// The mixing layer: once, repeated, 400 copies
    Mixing,
    /// Straight down with and without readjusted planes
    Down,
    /// Screen-space normals and ambient occlusion
    Shading,
    /// Table 1 of Forstmann & Ohya 2010: elements met and drawn
    Ieice,
    /// GPU against CPU, kernels against each other
    Speedup,
    /// Time over planes, pixels, view distance, scene size, threads
    Scaling,
}

impl Part {
    pub const ALL: [Part; 8] = [
        Part::Table1,
        Part::Landscape,
        Part::Mixing,
        Part::Down,
        Part::Shading,
        Part::Ieice,
        Part::Speedup,
        Part::Scaling,
    ];

    pub fn text(self) -> &'static str {
        match self {
            Part::Table1 => "table1",
            Part::Landscape => "landscape",
            Part::Mixing => "mixing",
            Part::Down => "down",
            Part::Shading => "shading",
            Part::Ieice => "ieice",
            Part::Speedup => "speedup",
            Part::Scaling => "scaling",
        }
    }
}

/// How much is measured, and with what.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extent {
    /// Sides of scenes and view distances are divided by this, width and height of pictures by that.
    pub scene_shrink: u32,
    pub picture_shrink: u32,
    pub cpu: Rounds,
    pub gpu: Rounds,
}

impl Extent {
    /// The papers' sizes.
    pub const FULL: Extent = Extent {
        scene_shrink: 1,
        picture_shrink: 1,
        cpu: Rounds { least: 3, most: 7, budget_ms: 3000.0 },
        gpu: Rounds { least: 5, most: 31, budget_ms: 1000.0 },
    };
    /// A first look within two minutes on two cores: a quarter of a scene's side, half of a picture's.
    pub const QUICK: Extent = Extent {
        scene_shrink: 4,
        picture_shrink: 2,
        cpu: Rounds { least: 2, most: 3, budget_ms: 300.0 },
        gpu: Rounds { least: 3, most: 9, budget_ms: 300.0 },
    };

    /// As records name it.
    pub fn name(&self) -> String {
        if *self == Extent::FULL {
            "full".into()
        } else if *self == Extent::QUICK {
            "quick".into()
        } else {
            format!("{self:?}")
        }
    }
}

/// What there is to draw with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Machine {
    pub threads: usize,
    pub gpu: bool,
}

impl Machine {
    pub fn one(&self) -> Engine {
        Engine::Cpu { threads: 1 }
    }

    pub fn all(&self) -> Engine {
        Engine::Cpu { threads: self.threads }
    }

    /// The kernel that maps planes to the GPU as the paper does.
    pub fn gpu_paper(&self) -> Option<Engine> {
        #[cfg(feature = "gpu")]
        return self.gpu.then_some(Engine::Gpu(crate::Kernel::Invocation));
        #[cfg(not(feature = "gpu"))]
        None
    }

    pub fn gpu_workgroup(&self) -> Option<Engine> {
        #[cfg(feature = "gpu")]
        return self.gpu.then_some(Engine::Gpu(crate::Kernel::Workgroup));
        #[cfg(not(feature = "gpu"))]
        None
    }

    pub fn gpu_raycast(&self) -> Option<Engine> {
        #[cfg(feature = "gpu")]
        return self.gpu.then_some(Engine::Gpu(crate::Kernel::Raycast));
        #[cfg(not(feature = "gpu"))]
        None
    }

    pub fn gpu_raycast_runs(&self) -> Option<Engine> {
        #[cfg(feature = "gpu")]
        return self.gpu.then_some(Engine::Gpu(crate::Kernel::RaycastRuns));
        #[cfg(not(feature = "gpu"))]
        None
    }

    fn every(&self) -> Vec<Engine> {
        let gpu = [self.gpu_paper(), self.gpu_workgroup(), self.gpu_raycast()];
        [self.one(), self.all()].into_iter().chain(gpu.into_iter().flatten()).collect()
    }

    fn fastest(&self) -> Vec<Engine> {
        [self.all()].into_iter().chain(self.gpu_paper()).chain(self.gpu_workgroup()).collect()
    }
}

/// Configurations that are drawn in turns.
pub struct Group {
    pub title: String,
    pub configs: Vec<Config>,
}

const TILED: Repeat = Repeat { x: true, z: true };
const LARGE: [u32; 2] = [1024, 768];
/// Voxels: the papers' repeated scenes are 40,000 wide, their landscape is seen to 180,000.
const WORLD: f64 = 40_000.0;
const LANDSCAPE: f64 = 180_000.0;

/// The groups of a part.
pub fn groups(part: Part, extent: &Extent, machine: &Machine) -> Vec<Group> {
    let plan = Plan { extent, machine };
    let mut groups = match part {
        Part::Table1 => plan.table1(),
        Part::Landscape => plan.landscape(),
        Part::Mixing => plan.mixing(),
        Part::Down => plan.down(),
        Part::Shading => plan.shading(),
        Part::Ieice => plan.ieice(),
        Part::Speedup => plan.speedup(),
        Part::Scaling => plan.scaling(),
    };
    // Rows of a table may share a configuration, and one core is all cores where there is one.
    for group in &mut groups {
        let mut seen = HashSet::new();
        group.configs.retain(|c| seen.insert(c.key()));
    }
    groups
}

/// The configurations of a row of Table 1: what the row was measured with, and all threads of the CPU.
pub fn table1_configs(row: &paper::Table1, extent: &Extent, machine: &Machine) -> Vec<Config> {
    let engines = match row.version {
        Version::Gpu => [machine.gpu_paper(), Some(machine.all())],
        Version::Cpu => [Some(machine.one()), Some(machine.all())],
    };
    let plan = Plan { extent, machine };
    plan.table1_lines(row.dataset, paper::culling(row.letters), row.screen, engines.into_iter().flatten())
}

/// The same views with all switches, coarse cells included.
pub fn table1_ours(screen: [u32; 2], extent: &Extent, machine: &Machine) -> Vec<Config> {
    let engines = [Some(machine.one()), Some(machine.all()), machine.gpu_paper(), machine.gpu_workgroup()];
    let plan = Plan { extent, machine };
    plan.table1_lines(Encoding::Solid, Culling::ALL, screen, engines.into_iter().flatten())
}

struct Plan<'a> {
    extent: &'a Extent,
    machine: &'a Machine,
}

impl Plan<'_> {
    fn key(&self, name: Name, encoding: Encoding, color: ColorMode) -> Key {
        Key { name, side: name.side(self.extent.scene_shrink), encoding, color }
    }

    fn size(&self, size: [u32; 2]) -> [u32; 2] {
        size.map(|n| (n / self.extent.picture_shrink).max(8))
    }

    fn distance(&self, voxels: f64) -> f64 {
        voxels / f64::from(self.extent.scene_shrink)
    }

    /// Repeated in x and z, levels at one pixel, the nearest plane's sample, colour as stored.
    fn tiled(&self, voxels: f64) -> Options {
        Options {
            view_distance: self.distance(voxels),
            repeat: TILED,
            remap: Remap::Nearest,
            shading: Shading::None,
            ..Options::default()
        }
    }

    fn table1_lines(
        &self,
        dataset: Encoding,
        culling: Culling,
        screen: [u32; 2],
        engines: impl Iterator<Item = Engine>,
    ) -> Vec<Config> {
        let scene = self.key(Name::Shapes, dataset, ColorMode::Run);
        let size = self.size(screen);
        let options = Options { culling, planes: Planes::Count(size[0]), ..self.tiled(WORLD) };
        let line = |engine, view| Config {
            part: Part::Table1.text(),
            scene,
            view,
            size,
            engine,
            options,
            variant: String::new(),
            x: None,
        };
        engines.flat_map(|engine| [View::Far, View::Near].map(|view| line(engine, view))).collect()
    }

    fn table1(&self) -> Vec<Group> {
        let of = |screen: [u32; 2]| Group {
            title: format!("Table 1 of 2009, {} x {}", screen[0], screen[1]),
            configs: (paper::TABLE1.iter().filter(|row| row.screen == screen))
                .flat_map(|row| table1_configs(row, self.extent, self.machine))
                .chain(table1_ours(screen, self.extent, self.machine))
                .collect(),
        };
        let mut screens: Vec<[u32; 2]> = paper::TABLE1.iter().map(|row| row.screen).collect();
        screens.dedup();
        screens.into_iter().map(of).collect()
    }

    fn config(&self, part: Part, scene: Key, view: View, engine: Engine, options: Options, variant: &str) -> Config {
        let size = self.size(LARGE);
        Config { part: part.text(), scene, view, size, engine, options, variant: variant.into(), x: None }
    }

    fn landscape(&self) -> Vec<Group> {
        let scene = self.key(Name::Landscape, Encoding::Solid, ColorMode::Voxel);
        let line = |engine| {
            let options = self.tiled(LANDSCAPE);
            self.config(Part::Landscape, scene, View::Around, engine, options, "landscape, view 180,000")
        };
        let configs = self.machine.every().into_iter().map(line).collect();
        vec![Group { title: "landscape seen to 180,000 voxels".into(), configs }]
    }

    fn mixing(&self) -> Vec<Group> {
        let scene = self.key(Name::Mixing, Encoding::Solid, ColorMode::None);
        let shaded = Options { shading: Shading::Full, ..self.tiled(WORLD) };
        let single = Options { repeat: Repeat::default(), ..shaded };
        let configs = self.machine.every().into_iter().flat_map(|engine| {
            [
                (View::Outside, single, "single"),
                (View::Over, shaded, "repeated to 40k × 2k × 40k"),
                (View::Copies, shaded, "about 400 copies"),
            ]
            .map(|(view, options, what)| self.config(Part::Mixing, scene, view, engine, options, what))
        });
        vec![Group { title: "mixing layer".into(), configs: configs.collect() }]
    }

    fn down(&self) -> Vec<Group> {
        let mut groups = Vec::new();
        for (name, color) in
            [(Name::Shapes, ColorMode::Run), (Name::Mixing, ColorMode::None), (Name::Landscape, ColorMode::Voxel)]
        {
            let scene = self.key(name, Encoding::Solid, color);
            let configs = self.machine.fastest().into_iter().flat_map(|engine| {
                [(false, "planes as they fall"), (true, "readjusted planes")].map(|(readjust, what)| {
                    let options = Options { readjust, ..self.tiled(WORLD) };
                    self.config(Part::Down, scene, View::Down, engine, options, what)
                })
            });
            groups.push(Group { title: format!("straight down, {}", name.text()), configs: configs.collect() });
        }
        groups
    }

    fn shading(&self) -> Vec<Group> {
        let scene = self.key(Name::Mixing, Encoding::Solid, ColorMode::None);
        let configs = [self.machine.one(), self.machine.all()].into_iter().chain(self.machine.gpu_workgroup());
        let configs = configs.flat_map(|engine| {
            [(Shading::None, "none"), (Shading::Ssn, "SSN"), (Shading::Ssao, "SSAO"), (Shading::Full, "SSN + SSAO")]
                .map(|(shading, what)| {
                    let options = Options { shading, repeat: Repeat::default(), ..self.tiled(WORLD) };
                    self.config(Part::Shading, scene, View::Outside, engine, options, what)
                })
        });
        vec![Group { title: "screen-space normals and ambient occlusion".into(), configs: configs.collect() }]
    }

    fn ieice(&self) -> Vec<Group> {
        let of = |name: Name| {
            let scene = self.key(name, Encoding::Solid, ColorMode::Voxel);
            let configs = self.machine.fastest().into_iter().flat_map(|engine| {
                [("the papers' culling", paper::culling("F,C,S")), ("all culling", Culling::ALL)].map(
                    |(what, culling)| {
                        let options = Options { culling, repeat: Repeat::default(), ..self.tiled(WORLD) };
                        self.config(Part::Ieice, scene, View::Close, engine, options, what)
                    },
                )
            });
            Group { title: format!("elements met and drawn, {}", name.text()), configs: configs.collect() }
        };
        [Name::Shapes, Name::Scan, Name::Serpent, Name::City].map(of).into()
    }

    fn speedup(&self) -> Vec<Group> {
        let shapes = self.key(Name::Shapes, Encoding::Solid, ColorMode::Run);
        let landscape = self.key(Name::Landscape, Encoding::Solid, ColorMode::Voxel);
        let (one, all) = (self.machine.one(), self.machine.all());
        let (basic, papers) = (paper::culling(""), paper::culling("F,C,S"));
        let gpu = [
            (self.machine.gpu_paper(), basic, "basic"),
            (self.machine.gpu_paper(), papers, "the papers' culling"),
            (self.machine.gpu_paper(), Culling::ALL, "all culling"),
            (self.machine.gpu_workgroup(), Culling::ALL, "all culling"),
            (self.machine.gpu_raycast(), Culling::ALL, "a ray a pixel, tree of masks"),
            (self.machine.gpu_raycast_runs(), Culling::ALL, "a ray a pixel, run lists"),
        ];
        let cpu = [
            (Some(one), basic, "basic"),
            (Some(one), papers, "the papers' culling"),
            (Some(one), Culling::ALL, "all culling"),
            (Some(all), basic, "basic"),
            (Some(all), Culling::ALL, "all culling"),
            (Some(Engine::Rays { threads: 1 }), Culling::ALL, "a ray a pixel, tree of masks"),
            (Some(Engine::Rays { threads: self.machine.threads }), Culling::ALL, "a ray a pixel, tree of masks"),
        ];
        let mut groups = Vec::new();
        for (scene, view) in [(shapes, View::Near), (shapes, View::Far), (landscape, View::Pitches)] {
            let configs = cpu.into_iter().chain(gpu).filter_map(|(engine, culling, what)| {
                let options = Options { culling, ..self.tiled(WORLD) };
                Some(self.config(Part::Speedup, scene, view, engine?, options, what))
            });
            let title = format!("speed-up, {}, {}", scene.name.text(), view.name());
            groups.push(Group { title, configs: configs.collect() });
        }
        // The reference casts its rays at level 0 only, so planes do here, too.
        let threads = self.machine.threads;
        let rays = [Engine::Exact { threads: 1 }, Engine::Exact { threads }];
        let configs = [one, all].into_iter().chain(rays).map(|engine| {
            let options = Options { repeat: Repeat::default(), lod: None, ..self.tiled(WORLD) };
            self.config(Part::Speedup, shapes, View::Near, engine, options, "level 0, not repeated")
        });
        groups.push(Group { title: "speed-up over rays at level 0".into(), configs: configs.collect() });
        groups
    }

    fn scaling(&self) -> Vec<Group> {
        let scene = self.key(Name::Landscape, Encoding::Solid, ColorMode::Voxel);
        let engines: Vec<Engine> = self.machine.fastest().into_iter().chain(self.machine.gpu_raycast()).collect();
        let line = |scene: Key, engine, options, axis: &str, x: f64| Config {
            x: Some(x),
            ..self.config(Part::Scaling, scene, View::Pitches, engine, options, &format!("{axis} {x}"))
        };
        let group = |axis: &str, configs: Vec<Config>| Group { title: format!("scaling over {axis}"), configs };
        let over = |axis: &str, xs: &[f64], make: &dyn Fn(Engine, f64) -> Config| {
            let configs = xs.iter().flat_map(|&x| engines.iter().map(move |&engine| make(engine, x)));
            group(axis, configs.collect())
        };
        let planes = |engine, percent: f64| {
            let options = Options { planes: Planes::Factor(percent / 100.0), ..self.tiled(WORLD) };
            line(scene, engine, options, "planes", percent)
        };
        let pixels = |engine, factor: f64| {
            let size = self.size(LARGE).map(|n| (f64::from(n) * factor) as u32);
            let x = f64::from(size[0]) * f64::from(size[1]) / 1e6;
            Config { size, ..line(scene, engine, self.tiled(WORLD), "pixels", x) }
        };
        let distance = |engine, voxels: f64| {
            let options = self.tiled(voxels);
            line(scene, engine, options, "distance", options.view_distance)
        };
        let size = |engine, factor: f64| {
            let side = (f64::from(scene.side) * factor) as u32;
            line(Key { side, ..scene }, engine, self.tiled(WORLD), "size", f64::from(side))
        };
        let mut counts: Vec<usize> = std::iter::successors(Some(1), |n| Some(2 * n))
            .take_while(|&n| n < self.machine.threads)
            .chain([self.machine.threads])
            .collect();
        counts.dedup();
        let threads = counts
            .into_iter()
            .map(|threads| line(scene, Engine::Cpu { threads }, self.tiled(WORLD), "threads", threads as f64));
        vec![
            over("planes", &[25.0, 50.0, 100.0, 200.0, 400.0], &planes),
            over("pixels", &[0.25, 0.5, 1.0, 2.0], &pixels),
            over("distance", &[1250.0, 2500.0, 5000.0, 10e3, 20e3, 40e3, 80e3, 160e3], &distance),
            over("size", &[0.25, 0.5, 1.0, 2.0], &size),
            group("threads", threads.collect()),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MACHINE: Machine = Machine { threads: 4, gpu: cfg!(feature = "gpu") };

    #[test]
    fn parts_have_each_configuration_once() {
        let mut seen = HashSet::new();
        for part in Part::ALL {
            for group in groups(part, &Extent::FULL, &MACHINE) {
                assert!(!group.configs.is_empty(), "{}", group.title);
                for config in group.configs {
                    assert!(config.key().starts_with(part.text()));
                    assert!(seen.insert(config.key()), "{} is there twice", config.key());
                }
            }
        }
    }

    #[test]
    fn parts_differ_in_their_key_wherever_they_differ() {
        // Deduplication by key must drop only what is equal.
        for group in [groups(Part::Speedup, &Extent::FULL, &MACHINE), groups(Part::Scaling, &Extent::FULL, &MACHINE)] {
            let configs: Vec<Config> = group.into_iter().flat_map(|g| g.configs).collect();
            for (i, a) in configs.iter().enumerate() {
                for b in &configs[..i] {
                    let same = (a.options, a.engine, a.size, a.view, a.scene)
                        == (b.options, b.engine, b.size, b.view, b.scene);
                    assert!(!same || a.variant != b.variant, "{}", a.key());
                    assert!(a.key() != b.key());
                }
            }
        }
    }

    #[test]
    fn parts_measure_every_row_of_table_1_from_far_and_near() {
        let configs: Vec<Config> =
            groups(Part::Table1, &Extent::FULL, &MACHINE).into_iter().flat_map(|g| g.configs).collect();
        for row in paper::TABLE1 {
            for view in [View::Far, View::Near] {
                let found = configs.iter().filter(|c| {
                    c.view == view
                        && c.size == row.screen
                        && c.scene.encoding == row.dataset
                        && c.options.culling == paper::culling(row.letters)
                });
                let engines: Vec<Engine> = found.map(|c| c.engine).collect();
                let wanted = match row.version {
                    Version::Gpu => MACHINE.gpu_paper().unwrap_or(MACHINE.all()),
                    Version::Cpu => MACHINE.one(),
                };
                assert!(engines.contains(&wanted), "{row:?}: {engines:?}");
            }
        }
    }
}
