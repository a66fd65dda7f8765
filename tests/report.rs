//! Reports: planted faults show in the figures, stopped runs go on, folders are left whole.
#![cfg(feature = "report")]

mod common;

use common::{World, hills, rocks};
use planecast::measure::report::journal::{self, Journal};
use planecast::measure::report::poses::{self, Named};
use planecast::measure::report::run::{self, Draw, Drawer, Plan, Row};
use planecast::measure::report::sweep::{Config, configs};
use planecast::measure::report::{Job, choose, present};
use planecast::{Camera, Error, Frame, Options, Outputs, Result};
use planecast_encoder::MipRule;
use std::cell::Cell;
use std::path::Path;

const SIZE: [u32; 2] = [96, 72];

/// The project's renderers with a fault in what one configuration draws, and a count of frames.
struct Faulty<'a, F> {
    sound: Drawer<'a>,
    config: &'static str,
    fault: F,
    frames: &'a Cell<usize>,
    /// Frames after which drawing fails, as if the program had been stopped.
    most: usize,
}

impl<F: Fn(&Config, &Camera, &mut Drawer<'_>, Frame) -> Frame> Draw for Faulty<'_, F> {
    fn draw(&mut self, config: &Config, camera: &Camera, outputs: Outputs) -> Result<Frame> {
        if self.frames.get() == self.most {
            return Err(Error::Limit("stopped".into()));
        }
        self.frames.set(self.frames.get() + 1);
        let frame = self.sound.draw(config, camera, outputs)?;
        if config.name == self.config { Ok((self.fault)(config, camera, &mut self.sound, frame)) } else { Ok(frame) }
    }

    fn holes(&mut self, config: &Config, camera: &Camera) -> [u64; 2] {
        self.sound.holes(config, camera)
    }
}

struct Study {
    file: run::World,
    other: run::World,
    configs: Vec<Config>,
    poses: Vec<Named>,
}

impl Study {
    fn new(world: World, keep: &[&str]) -> Study {
        let file = run::World { scene: world.scene, resident: world.resident };
        let other = run::World::with_rule(&file.scene, MipRule::Majority).unwrap();
        let mut configs = configs(128, &Options::default(), &[], false);
        configs.retain(|c| keep.contains(&&*c.name));
        assert_eq!(configs.len(), keep.len());
        let poses = poses::standing(&file.scene, 60.0, SIZE[1], true);
        Study { file, other, configs, poses }
    }

    fn plan(&self) -> Plan<'_> {
        Plan { configs: &self.configs, poses: &self.poses, size: SIZE, rounds: 2, identity: "test".into() }
    }

    fn drawer<'a, F: Fn(&Config, &Camera, &mut Drawer<'_>, Frame) -> Frame>(
        &'a self,
        frames: &'a Cell<usize>,
        config: &'static str,
        fault: F,
    ) -> Faulty<'a, F> {
        Faulty { sound: Drawer::new(&self.file, &self.other), config, fault, frames, most: usize::MAX }
    }

    fn rows(&self, draw: &mut dyn Draw, folder: &Path) -> Vec<Row> {
        let mut journal = Journal::open(folder).unwrap();
        self.plan().run(draw, &mut journal, &mut |_| {}).unwrap();
        self.plan().rows(&journal).unwrap()
    }

    /// Rows without a fault and with one.
    fn compared(
        &self,
        config: &'static str,
        fault: impl Fn(&Config, &Camera, &mut Drawer<'_>, Frame) -> Frame,
    ) -> [Row; 2] {
        let frames = Cell::new(0);
        let row = |draw: &mut dyn Draw| {
            let folder = tempfile::tempdir().unwrap();
            self.rows(draw, folder.path()).into_iter().find(|r| r.config.name == config).unwrap()
        };
        let sound = row(&mut self.drawer(&frames, "", |_, _, _, frame| frame));
        let faulty = row(&mut self.drawer(&frames, config, fault));
        [sound, faulty]
    }
}

#[test]
fn report_shows_a_renderer_shifted_by_one_pixel() {
    let study = Study::new(hills(common::MEDIUM), &["exact", "lod off"]);
    let [sound, shifted] = study.compared("lod off", |_, _, _, mut frame| {
        for (y, row) in frame.voxel.chunks_mut(frame.width as usize).enumerate() {
            row.rotate_right(1);
            let w = frame.width as usize;
            frame.depth[y * w..][..w].rotate_right(1);
            frame.color[y * w..][..w].rotate_right(1);
        }
        frame
    });
    assert!(sound.other() < 5.0 && shifted.other() > 30.0, "{} {}", sound.other(), shifted.other());
    // Within one pixel it is right, but for the column that came round.
    let near = |row: &Row| row.mean(|e| e.errors.other_near);
    assert!(near(&shifted) < near(&sound) + 4.0, "{} {}", near(&sound), near(&shifted));
    assert!(shifted.flip() > 1.1 * sound.flip(), "{} {}", sound.flip(), shifted.flip());
    assert!(
        shifted.psnr() < sound.psnr() - 0.5 && shifted.mean(|e| e.errors.ssim) < sound.mean(|e| e.errors.ssim) - 0.02
    );
    let p99 = |row: &Row| row.mean(|e| e.errors.depth[1]);
    assert!(p99(&shifted) > p99(&sound) + 0.5, "{} {}", p99(&sound), p99(&shifted));
}

#[test]
fn report_shows_a_wrong_level() {
    let study = Study::new(hills(common::MEDIUM), &["exact", "lod off"]);
    let [sound, coarse] = study.compared("lod off", |config, camera, draw, frame| {
        let options = Options { lod: Some(16.0), ..config.options };
        let outputs = Outputs { voxel: !frame.voxel.is_empty() };
        draw.draw(&Config { options, ..config.clone() }, camera, outputs).unwrap()
    });
    let coarser = |row: &Row| row.mean(|e| e.errors.coarser);
    assert!(coarser(&sound) == 0.0 && coarser(&coarse) > 20.0, "{}", coarser(&coarse));
    assert!(coarse.other() > sound.other() + 3.0, "{} {}", sound.other(), coarse.other());
    assert!(coarse.flip() > 1.2 * sound.flip(), "{} {}", sound.flip(), coarse.flip());
    assert!(coarse.mean(|e| e.errors.other_level0) > 20.0);
}

#[test]
fn report_shows_a_hole_and_a_wrong_sky() {
    let study = Study::new(rocks(), &["exact", "default"]);
    let [sound, holed] = study.compared("default", |_, _, _, mut frame| {
        let n = frame.depth.len() / 2;
        frame.depth[n..n + 60].fill(f32::INFINITY);
        frame.voxel.iter_mut().skip(n).take(60).for_each(|v| *v = [-1; 4]);
        frame
    });
    let sky = |row: &Row| row.mean(|e| e.errors.sky);
    assert!(sky(&holed) > sky(&sound) + 0.3, "{} {}", sky(&sound), sky(&holed));
}

#[test]
fn report_counts_holes_before_and_after_gap_fill() {
    let study = Study::new(hills(common::MEDIUM), &["exact", "planes 25 %", "planes 25 %, gaps open", "default"]);
    let (frames, folder) = (Cell::new(0), tempfile::tempdir().unwrap());
    let rows = study.rows(&mut study.drawer(&frames, "", |_, _, _, frame| frame), folder.path());
    let holes = |name: &str| {
        rows.iter()
            .find(|r| r.config.name == name)
            .unwrap()
            .errors
            .iter()
            .map(|e| e.holes)
            .fold([0; 2], |a, b| [a[0] + b[0], a[1] + b[1]])
    };
    let [before, after] = holes("planes 25 %");
    assert!(before > 1000 && after == 0, "{before} {after}");
    assert_eq!(holes("planes 25 %, gaps open"), [before; 2]);
    assert_eq!((holes("default"), holes("exact")), ([0; 2], [0; 2]));
}

#[test]
fn report_goes_on_where_it_was_stopped() {
    let study = Study::new(rocks(), &["exact", "default", "samples 50 %"]);
    let (frames, folder) = (Cell::new(0), tempfile::tempdir().unwrap());
    let whole = tempfile::tempdir().unwrap();
    study.rows(&mut study.drawer(&frames, "", |_, _, _, frame| frame), whole.path());
    let all = frames.replace(0);
    // Stopped among the errors, then among the times.
    for most in [7, 25] {
        let mut draw =
            Faulty { most, ..study.drawer(&frames, "", |_: &Config, _: &Camera, _: &mut Drawer<'_>, frame| frame) };
        let mut journal = Journal::open(folder.path()).unwrap();
        let stopped = study.plan().run(&mut draw, &mut journal, &mut |_| {});
        assert_eq!(stopped.unwrap_err().to_string(), "stopped");
        assert!(study.plan().rows(&journal).unwrap_err().to_string().contains("not complete"));
    }
    let rows = study.rows(&mut study.drawer(&frames, "", |_, _, _, frame| frame), folder.path());
    // Each stop costs at most the truth of one pose (2 frames), a frame with its warm-up, and nothing else twice.
    assert!((all..=all + 6).contains(&frames.get()), "{} frames, {all} without a stop", frames.get());
    let lines = |folder: &Path| std::fs::read_to_string(folder.join(journal::NAME)).unwrap().lines().count();
    assert_eq!(lines(folder.path()), lines(whole.path()));
    // Errors are the same as those of a run that was not stopped.
    let other = study.rows(&mut study.drawer(&Cell::new(0), "", |_, _, _, frame| frame), whole.path());
    assert!(rows.iter().zip(&other).all(|(a, b)| a.errors == b.errors));
    frames.set(0);
    study.rows(&mut study.drawer(&frames, "", |_, _, _, frame| frame), folder.path());
    assert_eq!(frames.get(), 0, "a finished report is not measured again");
}

#[test]
fn report_of_another_scene_is_measured_anew() {
    let study = Study::new(rocks(), &["exact"]);
    let mut plan = study.plan();
    let here = plan.key(&study.configs[0], &study.poses[0]);
    plan.identity = "another".into();
    assert_ne!(plan.key(&study.configs[0], &study.poses[0]), here);
    plan.identity = "test".into();
    plan.size = [97, 72];
    assert_ne!(plan.key(&study.configs[0], &study.poses[0]), here);
    assert_ne!(study.plan().key(&study.configs[0], &study.poses[1]), here);
}

#[test]
fn report_levels_by_the_files_own_rule_are_the_files_own() {
    for world in [hills(common::MEDIUM), common::odd(), common::bare()] {
        let again = run::World::with_rule(&world.scene, world.scene.mip_rule).unwrap();
        let geometry =
            |scene: &planecast_encoder::Scene| -> Vec<_> { scene.levels.iter().map(|l| l.solid.clone()).collect() };
        assert_eq!(geometry(&again.scene), geometry(&world.scene), "{}", world.name);
        assert_eq!(again.scene.levels[0].colors, world.scene.levels[0].colors, "{}", world.name);
        let other = run::World::with_rule(&world.scene, MipRule::Majority).unwrap();
        assert_ne!(geometry(&other.scene), geometry(&world.scene), "{}", world.name);
    }
}

#[test]
fn report_chooses_by_budget_and_by_error() {
    let study = Study::new(hills(common::MEDIUM), &["exact", "default", "planes 25 %", "lod 8"]);
    let (frames, folder) = (Cell::new(0), tempfile::tempdir().unwrap());
    let mut rows = study.rows(&mut study.drawer(&frames, "", |_, _, _, frame| frame), folder.path());
    // Times as given, so that the choice does not hang on the machine.
    for (row, total) in rows.iter_mut().zip([5.0, 2.0, 1.0, 90.0]) {
        row.times.iter_mut().flatten().for_each(|t| t.total = total);
    }
    let names: Vec<&str> = rows.iter().map(|r| &*r.config.name).collect();
    assert_eq!(names, ["default", "planes 25 %", "lod 8", "exact"]);
    let [default, few, coarse] = [&rows[0], &rows[1], &rows[2]];
    assert!(default.flip() < few.flip() && default.flip() < coarse.flip());
    let choice = |budget, error| choose(&rows, budget, error).map(|c| c.unwrap());
    assert!(choice(Some(10.0), None).unwrap().starts_with("default: 5.00 ms"), "exact is no candidate");
    assert!(choice(Some(1.5), None).unwrap().starts_with("lod 8: 1.00 ms"));
    assert!(choice(Some(1.5), None).unwrap().ends_with("--device cpu --lod 8"));
    assert!(choice(None, Some(1.0)).unwrap().starts_with("lod 8: "));
    assert!(choice(None, Some(default.flip())).unwrap().starts_with("default: "));
    let error = choice(Some(0.5), None).unwrap_err().to_string();
    assert!(error.contains("the fastest takes 1.00 ms"), "{error}");
    assert_eq!(choose(&rows, None, None).unwrap(), None);
}

#[test]
fn report_leaves_every_file_and_refuses_another_folder() {
    let world = hills([64, 32, 64]);
    let dir = tempfile::tempdir().unwrap();
    let scene = dir.path().join("hills.pcast");
    planecast_encoder::format::write::write_scene(&world.scene, &scene).unwrap();
    let folder = dir.path().join("report");
    let job = Job {
        folder: &folder,
        quick: true,
        path: None,
        size: Some([48, 36]),
        rounds: Some(1),
        fov: 60.0,
        device: planecast::render::device::Device::Cpu,
        base: Options::default(),
        budget_ms: Some(1e6),
        max_error: None,
    };
    let mut told = Vec::new();
    let choice =
        planecast::measure::report::report(&scene, &Default::default(), &job, &mut |what| told.push(what.to_owned()))
            .unwrap()
            .unwrap();
    assert!(choice.contains("--device cpu"), "{choice}");
    assert!(
        told.iter().any(|t| t.contains("pose 4 of 4")) && told.iter().any(|t| t.contains("round 1 of 1")),
        "{told:?}"
    );
    let read = |name: &str| std::fs::read(folder.join(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
    let page = String::from_utf8(read("report.html")).unwrap();
    let json: serde_json::Value = serde_json::from_slice(&read("report.json")).unwrap();
    let rows = json["configurations"].as_array().unwrap();
    for row in rows {
        assert!(page.contains(&planecast::measure::page::escape(row["name"].as_str().unwrap())), "{row}");
        assert!(row["mean"]["flip"].is_number() && row["ms"]["total"]["median"].is_number(), "{row}");
    }
    let mut table = csv::Reader::from_reader(&*read("report.csv")).into_records().filter(|r| r.is_ok()).count();
    table /= 4;
    assert_eq!(table, rows.len(), "a line a configuration and pose");
    for name in ["error-time.svg", "voxels-time.svg", "stages.svg", "planes.svg"] {
        assert!(String::from_utf8(read(name)).unwrap().contains("</svg>"), "{name}");
    }
    for part in ["rendered", "truth", "difference"] {
        let picture = image::load_from_memory(&read(&format!("worst-1-{part}.png"))).unwrap();
        assert_eq!((picture.width(), picture.height()), (48, 36));
    }
    assert!(page.contains("data:image/png;base64,") && page.contains("<svg") && !page.contains("<script"));
    assert!(page.contains(json["machine"]["program"].as_str().unwrap()));

    let before = std::fs::read(folder.join(journal::NAME)).unwrap();
    told.clear();
    planecast::measure::report::report(&scene, &Default::default(), &job, &mut |what| told.push(what.to_owned()))
        .unwrap();
    assert_eq!(std::fs::read(folder.join(journal::NAME)).unwrap(), before, "nothing was measured twice");
    assert!(told.iter().all(|t| !t.contains("pose")), "{told:?}");

    let error = planecast::measure::report::report(
        &scene,
        &Default::default(),
        &Job { folder: dir.path(), ..job },
        &mut |_| {},
    )
    .unwrap_err();
    assert!(error.to_string().ends_with("is a folder with other files and no report's; name a new folder"), "{error}");
    let error =
        planecast::measure::report::report(&scene, &Default::default(), &Job { folder: &scene, ..job }, &mut |_| {})
            .unwrap_err();
    assert!(error.to_string().ends_with("is a file; name a folder for the report"), "{error}");
}

#[test]
fn report_writes_all_files_or_none() {
    let dir = tempfile::tempdir().unwrap();
    let content = |name: &str| present::Content { name: name.into(), bytes: b"x".to_vec() };
    let files = [content("a.csv"), content("missing/b.csv")];
    assert!(present::write(dir.path(), &files).is_err());
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    present::write(dir.path(), &files[..1]).unwrap();
    assert_eq!(std::fs::read(dir.path().join("a.csv")).unwrap(), b"x");
}
