//! Rows: flights over one world, each with its speed, memory, link and patience, compared with what they should have shown.

use std::collections::HashSet;
use std::sync::Arc;
use std::time::Instant;

use planecast_encoder::TileSource;
use planecast_encoder::encode::memory;
use serde::Serialize;

use super::flight::Flight;
use super::link::{Link, Linked};
use crate::cpu::renderer;
use crate::error::{Error, Result};
use crate::frame::picture::PagingStats;
use crate::measure::compare::compare;
use crate::measure::plot::pareto;
use crate::measure::report::metrics::{FlipImage, spread};
use crate::render::device::{Device, Renderer};
use crate::world::pager::Patience;
use crate::world::tint::Tint;
use crate::{Camera, Frame, Options, Outputs};

/// What is flown over.
#[derive(Clone)]
pub struct World {
    /// As it was typed.
    pub name: String,
    pub source: Arc<dyn TileSource>,
    /// Colours instead of its own.
    pub tint: Option<Tint>,
}

/// What one row is flown with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setting {
    /// Voxels of level 0 between two frames.
    pub velocity: f64,
    /// Bytes for tiles.
    pub memory: u64,
    pub link: Link,
    pub patience: Patience,
}

/// All that is flown. Each velocity is combined with each link, memory and patience.
pub struct Plan<'p> {
    pub world: &'p World,
    pub flight: &'p Flight,
    pub velocities: &'p [f64],
    pub links: &'p [Link],
    pub memories: &'p [u64],
    pub patiences: &'p [Patience],
    /// Frames of each row.
    pub frames: usize,
    /// Pixels.
    pub size: [u32; 2],
    pub device: Device,
    pub options: Options,
    /// Memory that the first view needs: see [`working_set`].
    pub working_set: u64,
}

/// What one flight took and showed. Of one that was refused the figures are not numbers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    pub voxels_per_frame: f64,
    pub memory_bytes: u64,
    /// Of what the first view needs: see [`working_set`].
    pub memory_percent: f64,
    /// The link in words; none per second for no limit.
    pub link: String,
    pub bytes_per_second: Option<f64>,
    pub latency_ms: f64,
    /// As `--stream` takes it.
    pub stream: String,
    pub frames: usize,
    /// Milliseconds from asking for a frame to having it.
    pub ms_mean: f64,
    pub ms_median: f64,
    pub ms_p99: f64,
    /// Of all frames, one after the other.
    pub wall_ms: f64,
    /// Bytes over the link, those of tiles that came for later frames among them.
    pub bytes_per_frame: f64,
    /// Pixels that show another voxel than the reference, its level included; those that neither show it nor a coarser one that
    /// holds it. Percent, mean over the frames.
    pub wrong_voxel_percent: f64,
    pub other_voxel_percent: f64,
    /// FLIP, 0 to 1: mean over the frames, and of the worst frame.
    pub flip: f64,
    pub flip_max: f64,
    /// Levels that a pixel shows too coarse, mean over pixels and frames.
    pub debt_per_pixel: f64,
    /// Tiles that stand-ins are shown for, mean over the frames.
    pub tiles_missing: f64,
    /// The level of detail that was drawn, in pixels, mean over the frames.
    pub lod: f64,
    /// Whether no other memory and patience is faster with less FLIP, at the same velocity over the same link.
    pub front: bool,
    /// Why nothing was flown.
    pub refused: Option<String>,
}

impl Row {
    /// Without what is measured.
    pub(super) fn of(setting: &Setting, working_set: u64) -> Row {
        let Setting { velocity, memory, link, patience } = *setting;
        Row {
            voxels_per_frame: velocity,
            memory_bytes: memory,
            memory_percent: 100.0 * memory as f64 / working_set as f64,
            link: link.to_string(),
            bytes_per_second: Some(link.bytes_per_second).filter(|rate| rate.is_finite()),
            latency_ms: link.latency.as_secs_f64() * 1e3,
            stream: patience.to_string(),
            frames: 0,
            ms_mean: f64::NAN,
            ms_median: f64::NAN,
            ms_p99: f64::NAN,
            wall_ms: f64::NAN,
            bytes_per_frame: f64::NAN,
            wrong_voxel_percent: f64::NAN,
            other_voxel_percent: f64::NAN,
            flip: f64::NAN,
            flip_max: f64::NAN,
            debt_per_pixel: f64::NAN,
            tiles_missing: f64::NAN,
            lod: f64::NAN,
            front: false,
            refused: None,
        }
    }
}

/// The frame of all rows that is farthest off.
pub struct Worst {
    /// Its row's place among all.
    pub row: usize,
    pub frame: usize,
    pub flip: f64,
    pub drawn: Frame,
    pub reference: Frame,
}

/// All that was measured.
pub struct Measured {
    pub rows: Vec<Row>,
    /// What drew, as frames name it.
    pub device: String,
    /// The coarsest level of detail that the references were drawn with, in pixels.
    pub reference_lod: f64,
    /// The first view, as it should be.
    pub first: Frame,
    /// None where no frame is off.
    pub worst: Option<Worst>,
}

/// A flight as it was drawn.
struct Flown {
    frames: Vec<Frame>,
    ms: Vec<f64>,
    bytes: u64,
}

/// What the frames of a flight should show: drawn with all tiles there.
struct References(Vec<(Frame, FlipImage)>);

/// Bytes that are kept of each pixel of each frame of a row: a reference, its picture as FLIP has it, and what was drawn.
const BYTES_PER_PIXEL: u64 = 24 + 20 + 24;

impl Plan<'_> {
    /// Flies all rows. `tell` hears of the progress.
    ///
    /// # Errors
    /// Those of drawing; [`Error::Limit`] where memory does not hold the pictures of a row. Memory for tiles that holds no view is
    /// none: its rows say so.
    pub fn run(&self, tell: &mut dyn FnMut(&str)) -> Result<Measured> {
        self.check()?;
        let mut told = HashSet::new();
        // Rows open a device each, and all would say the same of it.
        let tell_once = &mut |what: &str| {
            if told.insert(what.to_owned()) {
                tell(what);
            }
        };
        let settings = self.settings();
        let (mut rows, mut reference_lod, mut first, mut worst) = (Vec::new(), 0.0, None, None::<Worst>);
        let mut reference = self.open(Arc::clone(&self.world.source), u64::MAX, tell_once)?;
        for &velocity in self.velocities {
            let cameras = self.cameras(velocity);
            tell_once(&format!("{velocity} voxels per frame: {} frames as they should be", cameras.len()));
            let references = References::new(&mut reference, &cameras, &self.options, tell_once)?;
            let lods = references.0.iter().map(|(frame, _)| frame.stats.paging.lod);
            reference_lod = lods.fold(reference_lod, f64::max);
            first.get_or_insert_with(|| references.0[0].0.clone());
            for setting in settings.iter().filter(|setting| setting.velocity == velocity) {
                let Setting { memory, link, patience, .. } = setting;
                let at = rows.len();
                let memory = memory::display(*memory);
                tell_once(&format!("row {} of {}: {memory}, {link}, {patience}", at + 1, settings.len()));
                let mut row = Row::of(setting, self.working_set);
                match self.fly(setting, &cameras, tell_once) {
                    Ok(flown) => {
                        let (frame, flip) = references.compare(&flown, &mut row);
                        if flip > worst.as_ref().map_or(0.0, |worst| worst.flip) {
                            let (reference, drawn) = (references.0[frame].0.clone(), flown.frames[frame].clone());
                            worst = Some(Worst { row: at, frame, flip, drawn, reference });
                        }
                    }
                    Err(Error::Limit(what)) => row.refused = Some(what),
                    Err(e) => return Err(e),
                }
                rows.push(row);
            }
        }
        mark_fronts(&mut rows);
        let first = first.expect("a plan has a velocity");
        Ok(Measured { rows, device: first.stats.device.clone(), reference_lod, first, worst })
    }

    fn settings(&self) -> Vec<Setting> {
        let mut settings = Vec::new();
        for &velocity in self.velocities {
            for &link in self.links {
                for &memory in self.memories {
                    let patient = |&patience| Setting { velocity, memory, link, patience };
                    settings.extend(self.patiences.iter().map(patient));
                }
            }
        }
        settings
    }

    fn cameras(&self, velocity: f64) -> Vec<Camera> {
        self.flight.poses(velocity, self.frames).iter().map(|pose| pose.camera(self.size)).collect()
    }

    /// Whether all can be drawn and kept.
    fn check(&self) -> Result<()> {
        for &velocity in self.velocities {
            self.cameras(velocity).iter().try_for_each(|camera| renderer::check(camera, &self.options))?;
        }
        let [w, h] = self.size.map(u64::from);
        let need = (w * h).saturating_mul(self.frames as u64 * BYTES_PER_PIXEL);
        match memory::available() {
            Some(free) if need > free => Err(Error::Limit(format!(
                "--size {w}x{h}: {} frames of a row are kept until they are compared, which takes {} of memory; {} are free: use a smaller \
                 --size",
                self.frames,
                memory::display(need),
                memory::display(free)
            ))),
            _ => Ok(()),
        }
    }

    fn open(&self, source: Arc<dyn TileSource>, memory: u64, tell: &mut dyn FnMut(&str)) -> Result<Renderer> {
        Renderer::of_tiles(source, self.device, memory, Patience::Wait, self.world.tint.clone(), tell)
    }

    /// Draws one row, its frames one right after the other. It begins with the tiles of the first view there: what is measured is
    /// a flight under way.
    fn fly(&self, setting: &Setting, cameras: &[Camera], tell: &mut dyn FnMut(&str)) -> Result<Flown> {
        let linked = Arc::new(Linked::new(Arc::clone(&self.world.source)));
        self.fly_over(&linked, setting, cameras, tell)
    }

    fn fly_over(
        &self,
        linked: &Arc<Linked>,
        setting: &Setting,
        cameras: &[Camera],
        tell: &mut dyn FnMut(&str),
    ) -> Result<Flown> {
        // The comparison needs voxels, and of the very frames that are timed: what arrives in time is never the same twice.
        let outputs = Outputs { voxel: true };
        let mut renderer = self.open(Arc::clone(linked) as Arc<dyn TileSource>, setting.memory, tell)?;
        let first = renderer.draw_first(&cameras[..1], &self.options, outputs, tell)?;
        renderer.reuse(Some(first));
        renderer.set_patience(setting.patience);
        linked.set_link(setting.link);
        let before = linked.sent();
        let (mut frames, mut ms) = (Vec::new(), Vec::new());
        for i in 0..cameras.len() {
            let at = Instant::now();
            frames.push(renderer.draw_first(&cameras[i..], &self.options, outputs, tell)?);
            ms.push(at.elapsed().as_secs_f64() * 1e3);
        }
        Ok(Flown { frames, ms, bytes: linked.sent() - before })
    }
}

/// Least memory in which a view is drawn as finely as with all memory there is, to a sixteenth. It is more than its tiles take: each
/// level has room for some of its own.
///
/// # Errors
/// Those of drawing.
pub fn working_set(
    world: &World,
    camera: &Camera,
    device: Device,
    options: &Options,
    tell: &mut dyn FnMut(&str),
) -> Result<u64> {
    let mut draw = |memory: u64| -> Result<PagingStats> {
        let source = Arc::clone(&world.source);
        let mut renderer = Renderer::of_tiles(source, device, memory, Patience::Wait, world.tint.clone(), tell)?;
        Ok(renderer.draw_with(camera, options, Outputs::default(), tell)?.stats.paging)
    };
    let all = draw(u64::MAX)?;
    let mut holds = |memory: u64| match draw(memory) {
        Ok(paging) => Ok(paging.lod <= all.lod),
        Err(Error::Limit(_)) => Ok(false),
        Err(e) => Err(e),
    };
    let mut low = all.bytes_resident.max(1);
    let mut high = low;
    while high < u64::MAX && !holds(high)? {
        (low, high) = (high, high.saturating_mul(2));
    }
    while high - low > high / 16 {
        let middle = low + (high - low) / 2;
        *if holds(middle)? { &mut high } else { &mut low } = middle;
    }
    Ok(high)
}

impl References {
    fn new(
        renderer: &mut Renderer,
        cameras: &[Camera],
        options: &Options,
        tell: &mut dyn FnMut(&str),
    ) -> Result<References> {
        let frames = (0..cameras.len()).map(|i| {
            let frame = renderer.draw_first(&cameras[i..], options, Outputs { voxel: true }, tell)?;
            let image = FlipImage::new(&frame.color, frame.width as usize);
            Ok((frame, image))
        });
        Ok(References(frames.collect::<Result<_>>()?))
    }

    /// Puts a flight's figures into its row; which frame has the greatest FLIP, and that.
    fn compare(&self, flown: &Flown, row: &mut Row) -> (usize, f64) {
        let n = flown.frames.len() as f64;
        let mean = |sum: f64| sum / n;
        let (mut wrong, mut other, mut debt, mut missing, mut lod) = (0.0, 0.0, 0.0, 0.0, 0.0);
        let mut flips = Vec::new();
        for (frame, (reference, image)) in flown.frames.iter().zip(&self.0) {
            let agreement = compare(frame, reference);
            let pixels = agreement.pixels as f64;
            wrong += 100.0 * (pixels - agreement.same as f64) / pixels;
            other += 100.0 * (pixels - agreement.held as f64) / pixels;
            flips.push(FlipImage::new(&frame.color, frame.width as usize).mean(image));
            let paging = &frame.stats.paging;
            debt += paging.debt as f64 / pixels;
            missing += f64::from(paging.tiles_missing);
            lod += paging.lod;
        }
        row.frames = flown.frames.len();
        row.wall_ms = flown.ms.iter().sum();
        row.ms_mean = mean(row.wall_ms);
        [row.ms_median, row.ms_p99, _] = spread(&mut flown.ms.clone());
        row.bytes_per_frame = mean(flown.bytes as f64);
        (row.wrong_voxel_percent, row.other_voxel_percent) = (mean(wrong), mean(other));
        (row.debt_per_pixel, row.tiles_missing, row.lod) = (mean(debt), mean(missing), mean(lod));
        row.flip = mean(flips.iter().sum());
        let worst =
            flips.iter().copied().enumerate().fold((0, 0.0), |worst, now| if now.1 > worst.1 { now } else { worst });
        row.flip_max = worst.1;
        worst
    }
}

/// Marks what is best at each velocity over each link: these are given, and no choice.
fn mark_fronts(rows: &mut [Row]) {
    let condition = |row: &Row| (row.voxels_per_frame.to_bits(), row.link.clone());
    let conditions: HashSet<_> = rows.iter().map(condition).collect();
    for found in conditions {
        let of: Vec<usize> = (0..rows.len()).filter(|&i| condition(&rows[i]) == found).collect();
        let points: Vec<[f64; 2]> = of.iter().map(|&i| [rows[i].ms_mean, rows[i].flip]).collect();
        pareto(&points).into_iter().for_each(|i| rows[of[i]].front = true);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::{Condvar, Mutex};
    use std::time::Duration;

    use planecast_encoder::{BuildOptions, Colors, Columns, Input, PcastFile, Run, build};

    use super::*;
    use crate::film::path::{Keyframe, Path, Pose};
    use crate::measure::stream::link::Clock;

    /// Rough ground of eight tiles in a row; all of level 1 stays in memory.
    fn world() -> World {
        let columns = Columns::from_rows(2048, 200, 64, |z, out| {
            for x in 0..2048 {
                out.push_run(Run::new(0, (20 + crate::testing::noise(x / 3, 7, z / 3) % 9) as u16));
                out.end_column();
            }
        });
        let of = |x, y, z| crate::testing::noise(x, y, z).to_le_bytes()[..3].try_into().unwrap();
        let input = Input { columns, colors: Colors::Function(Box::new(of)), notes: Vec::new() };
        let scene = build(input, &BuildOptions::default()).unwrap();
        let (name, mut bytes) = ("rough.pcast", std::io::Cursor::new(Vec::new()));
        planecast_encoder::format::write::write_scene_to(&scene, &mut bytes, name.as_ref()).unwrap();
        let source = Arc::new(PcastFile::from_bytes(name, bytes.into_inner()).unwrap());
        World { name: name.into(), source, tint: None }
    }

    fn flight() -> Flight {
        let key = |t: f64| Keyframe {
            t,
            pose: Pose { eye: [2048.0 * t, 40.0, 32.0].into(), yaw: 90.0, pitch: -20.0, roll: 0.0, fov: 60.0 },
        };
        Flight::new(Path::new(vec![key(0.0), key(1.0)]).unwrap()).unwrap()
    }

    const FAST: Link = Link { bytes_per_second: 1e9, latency: Duration::from_micros(100) };

    /// Small flights, at 100 voxels per frame.
    fn plan<'p>(world: &'p World, flight: &'p Flight, links: &'p [Link], memories: &'p [u64]) -> Plan<'p> {
        Plan {
            world,
            flight,
            velocities: &[100.0],
            links,
            memories,
            patiences: &[Patience::Wait],
            frames: 7,
            size: [64, 48],
            device: Device::Cpu,
            options: Options::default(),
            working_set: 1 << 20,
        }
    }

    #[test]
    fn frames_that_wait_for_their_tiles_are_as_they_should_be() {
        let (world, flight) = (world(), flight());
        let measured = plan(&world, &flight, &[Link::UNLIMITED, FAST], &[64 << 20]).run(&mut |_| ()).unwrap();
        assert_eq!((measured.rows.len(), measured.device.as_str(), measured.reference_lod), (2, "cpu", 1.0));
        assert!(measured.worst.is_none() && measured.first.width == 64);
        for row in &measured.rows {
            assert_eq!((row.wrong_voxel_percent, row.other_voxel_percent, row.debt_per_pixel), (0.0, 0.0, 0.0));
            assert_eq!((row.flip, row.flip_max, row.tiles_missing, row.lod), (0.0, 0.0, 0.0, 1.0));
            assert!(row.front && row.refused.is_none() && row.frames == 7, "{row:?}");
            assert!(row.ms_mean > 0.0 && row.ms_median <= row.ms_p99 && row.wall_ms >= row.ms_p99, "{row:?}");
            // 600 voxels are more than two tiles.
            assert!(row.bytes_per_frame > 1000.0, "{row:?}");
        }
    }

    /// Time that has come to its end, until it is let go on.
    struct Never(Arc<(Mutex<bool>, Condvar)>);

    impl Clock for Never {
        fn now(&self) -> Duration {
            Duration::ZERO
        }

        fn wait_until(&self, at: Duration) {
            let (ended, ends) = &*self.0;
            let mut ended = ended.lock().unwrap();
            while at > Duration::ZERO && !*ended {
                ended = ends.wait(ended).unwrap();
            }
        }
    }

    #[test]
    fn frames_that_wait_for_nothing_show_what_they_lack() {
        let (world, flight) = (world(), flight());
        let never = [Link { latency: Duration::MAX, ..Link::UNLIMITED }];
        let plan = Plan { patiences: &[Patience::Deadline(0.0)], ..plan(&world, &flight, &never, &[64 << 20]) };
        let (setting, cameras) = (plan.settings()[0], plan.cameras(100.0));
        let end = Arc::new((Mutex::new(false), Condvar::new()));
        let linked = Linked::with_clock(Arc::clone(&world.source), Box::new(Never(Arc::clone(&end))));
        let flown = plan.fly_over(&Arc::new(linked), &setting, &cameras, &mut |_| ()).unwrap();
        *end.0.lock().unwrap() = true;
        end.1.notify_all();
        let mut renderer = plan.open(Arc::clone(&world.source), u64::MAX, &mut |_| ()).unwrap();
        let references = References::new(&mut renderer, &cameras, &plan.options, &mut |_| ()).unwrap();
        let mut row = Row::of(&setting, plan.working_set);
        let (worst, flip) = references.compare(&flown, &mut row);
        assert!(row.debt_per_pixel > 0.01 && row.tiles_missing > 0.1 && row.wrong_voxel_percent > 1.0, "{row:?}");
        assert!(row.other_voxel_percent <= row.wrong_voxel_percent && row.flip > 0.0, "{row:?}");
        // The first view's tiles were there.
        assert!(worst > 0 && flip == row.flip_max && flown.frames[0].stats.paging.debt == 0);
        assert_eq!((row.stream.as_str(), row.latency_ms > 1e9, row.bytes_per_second), ("deadline:0", true, None));
    }

    #[test]
    fn a_view_needs_as_much_memory_as_draws_it_as_finely() {
        let (world, flight) = (world(), flight());
        let plan = plan(&world, &flight, &[Link::UNLIMITED], &[]);
        let camera = plan.cameras(1.0)[0];
        let need = working_set(&world, &camera, plan.device, &plan.options, &mut |_| ()).unwrap();
        let lod = |memory: u64| {
            let mut renderer = plan.open(Arc::clone(&world.source), memory, &mut |_| ())?;
            let frame = renderer.draw_with(&camera, &plan.options, Outputs::default(), &mut |_| ())?;
            Ok::<f64, Error>(frame.stats.paging.lod)
        };
        assert_eq!(lod(need).unwrap(), 1.0);
        assert!(lod(need - need / 8).map_or(true, |lod| lod > 1.0));
    }

    #[test]
    fn memory_that_holds_no_view_is_told_and_the_rest_is_flown() {
        let (world, flight) = (world(), flight());
        let measured = plan(&world, &flight, &[Link::UNLIMITED], &[1000, 64 << 20]).run(&mut |_| ()).unwrap();
        let [refused, flown] = &measured.rows[..] else { panic!("{:?}", measured.rows) };
        assert!(refused.refused.as_ref().is_some_and(|why| why.contains("KiB are allowed")) && refused.flip.is_nan());
        assert!(!refused.front && flown.front && flown.flip == 0.0);
        let large = Plan { size: [16_000, 16_000], frames: 100_000, ..plan(&world, &flight, &[], &[]) };
        if memory::available().is_some() {
            let error = large.run(&mut |_| ()).err().unwrap().to_string();
            assert!(error.contains("--size 16000x16000"), "{error}");
        }
    }

    #[test]
    fn fronts_are_of_one_velocity_and_link() {
        let row = |velocity: f64, link: Link, ms: f64, flip: f64| {
            let setting = Setting { velocity, memory: 1, link, patience: Patience::Wait };
            Row { ms_mean: ms, flip, ..Row::of(&setting, 1) }
        };
        let mut rows = [
            row(1.0, FAST, 2.0, 0.0),
            row(1.0, FAST, 3.0, 0.0),
            row(1.0, FAST, 1.0, 0.5),
            row(100.0, FAST, 9.0, 0.9),
            row(1.0, Link::UNLIMITED, 9.0, 0.9),
            row(1.0, Link::UNLIMITED, f64::NAN, f64::NAN),
        ];
        mark_fronts(&mut rows);
        assert_eq!(rows.map(|row| row.front), [true, false, true, true, true, false]);
    }
}
