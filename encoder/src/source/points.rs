//! Clouds of points: LAS, LAZ and COPC (`las`), PCD, and PLY without faces. A voxel is solid where a point is.
//!
//! Points go to a file without a name as they are read, in lists by rows of tiles, so that the cloud need not fit into
//! memory. Where a header says between which places they lie, that is tried first; what counts is where they do lie, and
//! if that is elsewhere they are read a second time.
//!
//! # Colours
//!
//! Those of the points, where there are any; else by class, where there are at least two beside "unclassified"; else by
//! intensity, where it varies; else by height. `--color-by` chooses.
//!
//! # Size of points
//!
//! With voxels about as wide as points are apart, a third of all columns of a floor would stay empty. A point may fill a cube of
//! voxels instead (`--point-size`). `auto` measures: of columns that lie between others at most four apart, 97 % are to
//! be filled. That is the default where nobody says how large a voxel is; who does gets a voxel a point.

use std::io::Write;
use std::ops::Range;
use std::path::Path;

use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;

use super::mesh::Mesh;
use super::spots::{self, Spot};
use super::{ReadOptions, Up, world_dims};
use crate::format::TILE;
use crate::model::pieces::Pieces;
use crate::model::srgb::Mean;
use crate::store::scratch::{self as file, File, read_at};
use crate::{About, Colors, ColumnsBuilder, Error, Input, Result, Rgb, Run};

/// Points of a list that are written together.
const TOGETHER: usize = 4096;
/// Voxels along the longest side of clouds whose points are not evenly spread, where nobody says.
const DEFAULT_SIZE: u32 = 512;
/// Points that are remembered to see where most of them lie.
const SAMPLE: usize = 1 << 16;
/// One point of so many may lie far out on either side.
const STRAY: usize = 1000;
/// How many times as long as the box of all others the box of all points may be, where voxels are as wide as points are apart.
const MAX_STRETCH: f64 = 16.0;
/// Columns, and columns a point, beyond which a world is mostly air that somebody must have asked for by mistake.
const MANY_COLUMNS: u64 = 1 << 26;
const COLUMNS_A_POINT: u64 = 1024;
/// Half of how wide a gap between columns may be that is still ground.
const GAP: usize = 2;
/// Share of the ground that is to be closed.
const CLOSED: f64 = 0.97;
/// Fewer points are not ground.
const FEW: u64 = 64;

/// A point as its reader gives it, in axes and units of the file.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Point {
    pub at: [f64; 3],
    pub color: [u16; 3],
    pub intensity: u16,
    pub class: u8,
}

/// Which of a [`Point`]'s values the file has.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Has {
    pub rgb: bool,
    pub class: bool,
    pub intensity: bool,
}

/// How wide a voxel is where nobody says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Spacing {
    /// As the mean distance of points, seen from above.
    #[cfg_attr(not(feature = "las"), allow(dead_code, reason = "scans are spread so"))]
    Mean,
    /// So that there are [`DEFAULT_SIZE`] along the longest side.
    Longest,
}

/// A cloud before its points are read.
pub(super) struct Cloud {
    /// With format, unit and coordinate system; the rest is found out here.
    pub about: About,
    pub has: Has,
    /// Where points are said to lie, least and greatest in axes of the file, and how many there are said to be.
    pub claimed: Option<([[f64; 3]; 2], u64)>,
    /// How far from the truth what is claimed may be, on each axis.
    pub quantum: [f64; 3],
    /// Units of the world in one of the file, on each axis.
    pub metres: [f64; 3],
    pub spacing: Spacing,
}

/// What gives a cloud its colours.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum ColorBy {
    /// Colours, else class, else intensity, else height: the first that says something
    #[default]
    Auto,
    /// The points' own colours
    Rgb,
    /// Class: ground, vegetation, buildings, …
    Class,
    /// How bright the echo was
    Intensity,
    /// How high the point lies
    Height,
}

/// How many voxels a point fills along each axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PointSize {
    Auto,
    Voxels(u32),
}

impl std::str::FromStr for PointSize {
    type Err = String;

    fn from_str(s: &str) -> Result<PointSize, String> {
        if s == "auto" {
            return Ok(PointSize::Auto);
        }
        let size = s.parse().ok().filter(|n| (1..=64).contains(n));
        size.map(PointSize::Voxels).ok_or_else(|| "expected \"auto\" or a whole number of voxels, 1 to 64".to_owned())
    }
}

/// Classes that are wanted: numbers and ranges of them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Classes(Vec<(u8, u8)>);

impl Classes {
    pub fn has(&self, class: u8) -> bool {
        self.0.iter().any(|&(from, to)| (from..=to).contains(&class))
    }
}

impl std::str::FromStr for Classes {
    type Err = String;

    fn from_str(s: &str) -> Result<Classes, String> {
        let part = |part: &str| {
            let (from, to) = part.split_once('-').unwrap_or((part, part));
            let (from, to) = (from.trim().parse().ok()?, to.trim().parse().ok()?);
            (from <= to).then_some((from, to))
        };
        let parts: Option<Vec<(u8, u8)>> = s.split(',').map(part).collect();
        parts.map(Classes).ok_or_else(|| "expected classes from 0 to 255, as in 2,6 or 2-6,9".to_owned())
    }
}

impl std::fmt::Display for Classes {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        for (i, (from, to)) in self.0.iter().enumerate() {
            let comma = if i > 0 { "," } else { "" };
            if from == to { write!(f, "{comma}{from}")? } else { write!(f, "{comma}{from}-{to}")? }
        }
        Ok(())
    }
}

#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct Record {
    x: u32,
    z: u32,
    y: u16,
    /// A colour; or intensity and class.
    look: [u16; 3],
}

/// How [`Record::look`] becomes a colour.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Paint {
    /// What a value is divided by to have 8 bits.
    Rgb(u32),
    Class,
    /// From black to white between two values.
    Intensity(u16, u16),
    /// Along a ramp between two heights.
    Height(u16, u16),
}

impl Paint {
    fn color(self, record: &Record) -> Rgb {
        let between = |v: u16, low: u16, high: u16| {
            (f64::from(v.saturating_sub(low)) / f64::from(high.saturating_sub(low).max(1))).min(1.0)
        };
        match self {
            Paint::Rgb(unit) => record.look.map(|c| (u32::from(c) / unit).min(255) as u8),
            Paint::Class => class_color(record.look[1]),
            // Black is what nothing is drawn as.
            Paint::Intensity(low, high) => [(24.0 + 231.0 * between(record.look[0], low, high)).round() as u8; 3],
            Paint::Height(low, high) => ramp(between(record.y, low, high)),
        }
    }
}

/// Colours of classes, near those that programs for LAS share.
fn class_color(class: u16) -> Rgb {
    match class {
        0 | 1 => [170, 170, 170],
        2 => [160, 112, 66],
        3 => [138, 190, 90],
        4 => [74, 160, 64],
        5 => [28, 112, 44],
        6 => [214, 84, 60],
        7 | 18 => [240, 40, 240],
        8 => [230, 220, 90],
        9 => [60, 120, 214],
        10 => [120, 90, 130],
        11 => [96, 96, 104],
        12 => [200, 200, 150],
        13 | 14 => [240, 200, 40],
        15 => [240, 140, 30],
        16 => [250, 230, 140],
        17 => [150, 60, 90],
        // Golden angle: neighbours differ.
        n => {
            let hue = (f64::from(n) * 0.381_966).fract() * 6.0;
            [5.0, 3.0, 1.0].map(|k| {
                let t: f64 = (k + hue) % 6.0;
                (220.0 - 150.0 * t.min(4.0 - t).clamp(0.0, 1.0)) as u8
            })
        }
    }
}

/// Viridis at 0 to 1, between nine of its colours.
fn ramp(t: f64) -> Rgb {
    const STOPS: [Rgb; 9] = [
        [68, 1, 84],
        [71, 44, 122],
        [59, 81, 139],
        [44, 113, 142],
        [33, 144, 141],
        [39, 173, 129],
        [92, 200, 99],
        [170, 220, 50],
        [253, 231, 37],
    ];
    let at = t.clamp(0.0, 1.0) * (STOPS.len() - 1) as f64;
    let i = (at as usize).min(STOPS.len() - 2);
    let mix =
        |c: usize| f64::from(STOPS[i][c]) + (at - i as f64) * (f64::from(STOPS[i + 1][c]) - f64::from(STOPS[i][c]));
    [0, 1, 2].map(|c| mix(c).round() as u8)
}

/// What one look at all points found, in axes of the world.
struct Survey {
    n: u64,
    nowhere: u64,
    low: [f64; 3],
    high: [f64; 3],
    brightest: u16,
    classes: Vec<u64>,
    intensities: Vec<u64>,
    sample: Vec<[f64; 3]>,
    /// Every so many points one is in the sample.
    stride: u64,
}

impl Survey {
    fn new() -> Survey {
        Survey {
            n: 0,
            nowhere: 0,
            low: [f64::INFINITY; 3],
            high: [f64::NEG_INFINITY; 3],
            brightest: 0,
            classes: vec![0; 256],
            intensities: vec![0; 1 << 16],
            sample: Vec::new(),
            stride: 1,
        }
    }

    fn add(&mut self, at: [f64; 3], point: &Point) {
        for (axis, v) in at.into_iter().enumerate() {
            self.low[axis] = self.low[axis].min(v);
            self.high[axis] = self.high[axis].max(v);
        }
        self.brightest = self.brightest.max(point.color[0]).max(point.color[1]).max(point.color[2]);
        self.classes[usize::from(point.class)] += 1;
        self.intensities[usize::from(point.intensity)] += 1;
        if self.n.is_multiple_of(self.stride) {
            if self.sample.len() == SAMPLE {
                let mut i = 0;
                self.sample.retain(|_| {
                    i += 1;
                    i % 2 == 1
                });
                self.stride *= 2;
            }
            if self.n.is_multiple_of(self.stride) {
                self.sample.push(at);
            }
        }
        self.n += 1;
    }

    /// The box that holds all points but one in [`STRAY`] on either side of each axis.
    fn most(&self) -> [[f64; 3]; 2] {
        let (mut low, mut high) = (self.low, self.high);
        let n = self.sample.len();
        for axis in 0..3 {
            let mut along: Vec<f64> = self.sample.iter().map(|p| p[axis]).collect();
            along.sort_unstable_by(f64::total_cmp);
            if n >= STRAY {
                (low[axis], high[axis]) = (along[n / STRAY], along[n - 1 - n / STRAY]);
            }
        }
        [low, high]
    }

    /// Intensities that one in a hundred points is below, and above.
    fn intensity_range(&self) -> (u16, u16) {
        let value = |share: u64| {
            let mut n = 0;
            let past = |count: &u64| {
                n += count;
                n > share
            };
            self.intensities.iter().position(past).unwrap_or(usize::from(u16::MAX)) as u16
        };
        (value(self.n / 100), value(self.n.saturating_sub(1) - self.n / 100))
    }
}

/// Where the world begins and how fine it is.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Plan {
    low: [f64; 3],
    high: [f64; 3],
    /// Voxels a unit.
    scale: f64,
    dims: [u32; 3],
}

impl Plan {
    fn new(path: &Path, opts: &ReadOptions, spacing: Spacing, [low, high]: [[f64; 3]; 2], n: u64) -> Result<Plan> {
        let sides = [0, 1, 2].map(|a| high[a] - low[a]);
        let longest = sides.iter().copied().fold(0.0, f64::max);
        let along = |voxels: f64| if longest > 0.0 { voxels / longest } else { 1.0 };
        let area = sides[0] * sides[2];
        let scale = match (opts.voxel, opts.size) {
            (Some(voxel), _) => 1.0 / voxel,
            (None, Some(size)) => along(size.into()),
            (None, None) if spacing == Spacing::Longest => along(DEFAULT_SIZE.into()),
            (None, None) if area > 0.0 => (n as f64 / area).sqrt(),
            // All in one upright plane, or at one place.
            (None, None) => along((n as f64).min(DEFAULT_SIZE.into())),
        };
        let voxels = sides.map(|side| ((side * scale) as u64).saturating_add(1));
        Ok(Plan { low, high, scale, dims: world_dims(path, voxels, "give a larger --voxel")? })
    }

    /// Whether points that lie and are as `survey` says lie just there.
    fn fits(&self, survey: &Survey, quantum: [f64; 3]) -> bool {
        (0..3).all(|a| {
            (self.low[a] - survey.low[a]).abs() <= quantum[a] && (self.high[a] - survey.high[a]).abs() <= quantum[a]
        })
    }
}

/// Records in a file.
struct Stored {
    file: File,
    /// For each row of tiles, where its points stand and how many.
    lists: Vec<Vec<(u64, u32)>>,
}

/// A cloud of points in voxels of the world.
pub(super) struct Points {
    dims: [u32; 3],
    stored: Stored,
    paint: Paint,
    /// Voxels that a point fills along each axis.
    point_size: u32,
    pub about: About,
    notes: Vec<String>,
    pub input_bytes: u64,
}

fn scratch(action: &'static str) -> impl Fn(std::io::Error) -> Error {
    move |e| Error::io(std::env::temp_dir(), action, e)
}

/// The voxel of a place along an axis, in voxels. A place within a millionth of a boundary is on it: in f64, points on a grid whose
/// steps are no binary fractions come out a little below.
fn cell(at: f64) -> u32 {
    let near = at.round();
    (if (at - near).abs() < 1e-6 { near } else { at }) as u32
}

type Then<'a> = &'a mut dyn FnMut(Point) -> Result<()>;

impl Points {
    /// The points that `each` gives, one after the other and the same each time.
    pub fn new(
        path: &Path,
        opts: &ReadOptions,
        up: Up,
        cloud: Cloud,
        mut each: impl FnMut(Then) -> Result<()>,
    ) -> Result<Points> {
        let Cloud { mut about, has, claimed, quantum, metres, spacing } = cloud;
        let into_world = |p: [f64; 3]| turn(up, [0, 1, 2].map(|a| p[a] * metres[a]));
        let plan_of = |bounds: [[f64; 3]; 2], n| Plan::new(path, opts, spacing, bounds, n);
        let quantum = turn(up, [0, 1, 2].map(|a| quantum[a] * metres[a])).map(f64::abs);
        let mut wants_rgb = has.rgb && matches!(opts.color_by, ColorBy::Auto | ColorBy::Rgb);
        // What nobody can hold is not planned with, but looked at first.
        let claimed = claimed.filter(|(ends, n)| *n > 0 && ends.as_flattened().iter().all(|v| v.is_finite()));
        let mut n_expected = claimed.map_or(0, |(_, n)| n);
        let mut plan = claimed.and_then(|(ends, n)| plan_of(box_of(into_world(ends[0]), into_world(ends[1])), n).ok());
        let by_number = spacing == Spacing::Mean && opts.voxel.is_none() && opts.size.is_none();
        let mut passes = 0;
        let (survey, plan, stored, paint) = loop {
            let (survey, stored) = pass(plan.as_ref(), wants_rgb, &into_world, &mut each)?;
            if survey.n == 0 {
                return Err(Error::format(path, "no points"));
            }
            let paint = paint(path, opts.color_by, has, &survey)?;
            let is_rgb = matches!(paint, Paint::Rgb(_));
            if let (Some(plan), Some(stored)) = (plan, stored)
                && plan.fits(&survey, quantum)
                && (!by_number || n_expected == survey.n)
                && wants_rgb == is_rgb
            {
                break (survey, plan, stored, paint);
            }
            passes += 1;
            if passes > 2 {
                return Err(Error::format(path, "the file changes while it is read"));
            }
            let wanted = plan_of([survey.low, survey.high], survey.n).map_err(|e| advise(e, &survey, up, metres))?;
            check_spread(path, opts, spacing, &wanted, &survey, up, metres)?;
            (plan, n_expected, wants_rgb) = (Some(wanted), survey.n, is_rgb);
        };
        check_spread(path, opts, spacing, &plan, &survey, up, metres)?;
        let dims = plan.dims;
        let paint = match paint {
            Paint::Height(..) => {
                let [low, high] = survey.most().map(|p| ((p[1] - plan.low[1]) * plan.scale) as u16);
                Paint::Height(low, high)
            }
            paint => paint,
        };
        let mut points =
            Points { dims, stored, paint, point_size: 1, about: About::default(), notes: Vec::new(), input_bytes: 0 };
        let size = opts.point_size.unwrap_or(match (opts.voxel, opts.size) {
            (None, None) => PointSize::Auto,
            _ => PointSize::Voxels(1),
        });
        let mut closed = String::new();
        points.point_size = match size {
            PointSize::Voxels(size) => size,
            PointSize::Auto if survey.n < FEW => 1,
            PointSize::Auto => {
                let (size, share) = points.closing_size()?;
                closed = format!(" (auto: closes {:.1} % of the ground)", 100.0 * share);
                size
            }
        };

        let voxel = 1.0 / plan.scale;
        about.axes = match up {
            Up::X => "x is up",
            Up::Y => "y is up",
            Up::Z => "z is up",
        }
        .to_owned();
        about.voxel = Some([voxel; 3]);
        let mut affine = [[0.0; 4]; 3];
        for (world, (source, sign)) in sources(up).into_iter().enumerate() {
            affine[source][world] = sign * voxel / metres[source];
            affine[source][3] = sign * plan.low[world] / metres[source];
        }
        about.affine = Some(affine);
        about.values = Some([plan.low[1], plan.high[1]]);
        let filled = match points.point_size {
            1 => "a point fills a voxel".to_owned(),
            n => format!("a point fills {n} × {n} × {n} voxels"),
        };
        let colors = match paint {
            Paint::Rgb(1) => "colours of 8 bits".to_owned(),
            Paint::Rgb(_) => "colours of 16 bits".to_owned(),
            Paint::Class => "coloured by class".to_owned(),
            Paint::Intensity(low, high) => format!("coloured by intensity from {low} to {high}"),
            Paint::Height(..) => "coloured by height".to_owned(),
        };
        about.rule = format!("{filled}{closed}; {colors}");
        let [below, above] = survey.most();
        let reach = MAX_STRETCH * (above[1] - below[1]).max(voxel);
        if survey.high[1] - survey.low[1] > reach {
            let between = format!("{:.6} and {:.6}", below[1], above[1]);
            about.rule += &format!(
                "; all but one in {STRAY} points on either side lie between heights {between}, so few lie far out"
            );
        }
        if survey.nowhere > 0 {
            about.left_out.push(format!("{} points without a place (no finite numbers)", survey.nowhere));
        }
        points.about = about;
        points.notes = vec![format!("{} points, voxels of {voxel} units", survey.n)];
        Ok(points)
    }

    /// Of a mesh without faces.
    pub fn of_mesh(path: &Path, cloud: Mesh, opts: &ReadOptions) -> Result<Points> {
        let (has, about) = (Has { rgb: !cloud.colors.is_empty(), ..Has::default() }, cloud.about);
        let spacing = Spacing::Longest;
        let setup = Cloud { about, has, claimed: None, quantum: [0.0; 3], metres: [1.0; 3], spacing };
        Points::new(path, opts, opts.up.unwrap_or_default(), setup, |then| {
            cloud.positions.iter().enumerate().try_for_each(|(i, &at)| {
                let color = cloud.colors.get(i).copied().unwrap_or_default().map(u16::from);
                then(Point { at, color, ..Point::default() })
            })
        })
    }

    fn records(&self, lists: Range<usize>, mut then: impl FnMut(&Record)) -> Result<()> {
        let mut records: Vec<Record> = Vec::new();
        for &(at, n) in self.stored.lists[lists].iter().flatten() {
            records.resize(n as usize, Record::zeroed());
            read_at(&self.stored.file, bytemuck::cast_slice_mut(&mut records), at)
                .map_err(scratch("read a file in"))?;
            records.iter().for_each(&mut then);
        }
        Ok(())
    }

    /// The least size of points that closes the ground, and the share of it that it closes, by a look at up to four
    /// stretches of the world.
    fn closing_size(&self) -> Result<(u32, f64)> {
        const WINDOW: u32 = 1024;
        let with: Vec<usize> = (0..self.stored.lists.len()).filter(|&i| !self.stored.lists[i].is_empty()).collect();
        let (mut ground, mut closed) = (0usize, [0usize; 2 * GAP + 1]);
        for k in 0..with.len().min(4) {
            let list = with[with.len() * (2 * k + 1) / (2 * with.len().min(4))];
            let mut xs = Vec::new();
            self.records(list..list + 1, |r| xs.push(r.x))?;
            xs.sort_unstable();
            let start = xs[xs.len() / 2].saturating_sub(WINDOW / 2).min(self.dims[0].saturating_sub(WINDOW));
            let z0 = list as u32 * TILE;
            let (w, h) = (WINDOW.min(self.dims[0]) as usize, TILE.min(self.dims[2] - z0) as usize);
            // A margin, so that what is closed does not depend on the edge.
            let (pw, ph) = (w + 2 * GAP, h + 2 * GAP);
            let mut map = vec![false; pw * ph];
            self.records(list..list + 1, |r| {
                if (start..start + w as u32).contains(&r.x) {
                    map[((r.z - z0) as usize + GAP) * pw + (r.x - start) as usize + GAP] = true;
                }
            })?;
            let air: Vec<bool> = grown(&map, pw, GAP, GAP).into_iter().map(|v| !v).collect();
            let ground_here: Vec<bool> = grown(&air, pw, GAP, GAP).into_iter().map(|v| !v).collect();
            let inner = |i: &usize| (GAP..GAP + h).contains(&(i / pw)) && (GAP..GAP + w).contains(&(i % pw));
            ground += (0..pw * ph).filter(inner).filter(|&i| ground_here[i]).count();
            for (s, closed) in closed.iter_mut().enumerate() {
                let by = grown(&map, pw, s / 2, s.div_ceil(2));
                *closed += (0..pw * ph).filter(inner).filter(|&i| ground_here[i] && by[i]).count();
            }
        }
        let share = |s: usize| closed[s] as f64 / ground.max(1) as f64;
        let size = (0..closed.len()).find(|&s| share(s) >= CLOSED).unwrap_or(closed.len() - 1);
        Ok((size as u32 + 1, share(size)))
    }
}

/// `map` of rows of `w`, with every cell set that has a set one at most `before` cells after it or `after` before it, on either
/// axis.
fn grown(map: &[bool], w: usize, before: usize, after: usize) -> Vec<bool> {
    let h = map.len() / w;
    let along = |map: &[bool], n: usize, at: &dyn Fn(usize) -> usize, out: &mut [bool]| {
        let mut last = None;
        for i in 0..n + before {
            last = if i < n && map[at(i)] { Some(i) } else { last };
            if i >= before && last.is_some_and(|l| l + after + before >= i) {
                out[at(i - before)] = true;
            }
        }
    };
    let (mut rows, mut out) = (vec![false; map.len()], vec![false; map.len()]);
    (0..h).for_each(|y| along(map, w, &|x| y * w + x, &mut rows));
    (0..w).for_each(|x| along(&rows, h, &|y| y * w + x, &mut out));
    out
}

/// Looks at all points; where there is a plan, keeps them by it, with their colours or with intensity and class.
fn pass(
    plan: Option<&Plan>,
    rgb: bool,
    into_world: &impl Fn([f64; 3]) -> [f64; 3],
    each: &mut impl FnMut(Then) -> Result<()>,
) -> Result<(Survey, Option<Stored>)> {
    let mut survey = Survey::new();
    let Some(&Plan { low, scale, dims, .. }) = plan else {
        each(&mut |point| {
            let at = into_world(point.at);
            if at.iter().all(|v| v.is_finite()) {
                survey.add(at, &point)
            } else {
                survey.nowhere += 1
            }
            Ok(())
        })?;
        return Ok((survey, None));
    };
    let mut file = file::file().map_err(scratch("create a file in"))?;
    let n_lists = dims[2].div_ceil(TILE) as usize;
    let mut lists = vec![Vec::new(); n_lists];
    let mut waiting: Vec<Vec<Record>> = vec![Vec::new(); n_lists];
    let mut at_byte = 0;
    let mut flush = |list: usize, records: &mut Vec<Record>| {
        lists[list].push((at_byte, records.len() as u32));
        file.write_all(bytemuck::cast_slice(records)).map_err(scratch("write a file in"))?;
        at_byte += size_of_val(&records[..]) as u64;
        records.clear();
        Ok::<(), Error>(())
    };
    each(&mut |point| {
        let p = into_world(point.at);
        if !p.iter().all(|v| v.is_finite()) {
            survey.nowhere += 1;
            return Ok(());
        }
        survey.add(p, &point);
        let [x, y, z] = [0, 1, 2].map(|a| cell((p[a] - low[a]) * scale).min(dims[a] - 1));
        let look = if rgb { point.color } else { [point.intensity, point.class.into(), 0] };
        let list = (z / TILE) as usize;
        waiting[list].push(Record { x, z, y: y as u16, look });
        if waiting[list].len() == TOGETHER { flush(list, &mut waiting[list]) } else { Ok(()) }
    })?;
    for (list, records) in waiting.iter_mut().enumerate().filter(|(_, r)| !r.is_empty()) {
        flush(list, records)?;
    }
    Ok((survey, Some(Stored { file, lists })))
}

/// What colours are taken from; heights are filled in later.
fn paint(path: &Path, by: ColorBy, has: Has, survey: &Survey) -> Result<Paint> {
    // Many writers put 8 bits where 16 belong.
    let rgb = Paint::Rgb(if survey.brightest > 255 { 257 } else { 1 });
    let (low, high) = survey.intensity_range();
    let classified = survey.classes[2..].iter().filter(|n| **n > 0).count()
        + usize::from(survey.classes[..2].iter().any(|n| *n > 0))
        > 1;
    let missing = |what: &str| {
        let mut there = vec!["height"];
        there.extend(
            [(has.rgb, "rgb"), (has.class, "class"), (has.intensity, "intensity")].iter().filter(|p| p.0).map(|p| p.1),
        );
        let there = there.join(", ");
        Err(Error::Argument(format!("{}: the points have no {what}; --color-by may be {there}", path.display())))
    };
    Ok(match by {
        ColorBy::Auto if has.rgb && survey.brightest > 0 => rgb,
        ColorBy::Auto if has.class && classified => Paint::Class,
        ColorBy::Auto if has.intensity && high > low => Paint::Intensity(low, high),
        ColorBy::Auto | ColorBy::Height => Paint::Height(0, 0),
        ColorBy::Rgb if !has.rgb => return missing("colours"),
        ColorBy::Rgb => rgb,
        ColorBy::Class if !has.class => return missing("classes"),
        ColorBy::Class => Paint::Class,
        ColorBy::Intensity if !has.intensity => return missing("intensity"),
        ColorBy::Intensity => Paint::Intensity(low, high),
    })
}

/// Where most points lie, in axes and units of the file.
fn most_lie(survey: &Survey, up: Up, metres: [f64; 3]) -> String {
    let back = |p: [f64; 3]| {
        let mut out = [0.0; 3];
        for (world, (source, sign)) in sources(up).into_iter().enumerate() {
            out[source] = sign * p[world] / metres[source];
        }
        out
    };
    let text = |[low, high]: [[f64; 3]; 2]| {
        let (low, high) = box_of(back(low), back(high)).into();
        [0, 1, 2].map(|a| format!("{} {:.3} to {:.3}", ["x", "y", "z"][a], low[a], high[a])).join(", ")
    };
    let (all, most) = (text([survey.low, survey.high]), text(survey.most()));
    if all == most {
        format!("the {} points lie at {all}", survey.n)
    } else {
        format!("the {} points lie at {all}, all but a few at {most}", survey.n)
    }
}

/// Says of a world that cannot be held where its points lie.
fn advise(error: Error, survey: &Survey, up: Up, metres: [f64; 3]) -> Error {
    match error {
        Error::Limit(text) => {
            let text = text.trim_end_matches("; give a larger --voxel");
            let lie = most_lie(survey, up, metres);
            Error::Limit(format!(
                "{text}; {lie}; give a larger --voxel, or leave out what lies far out (of LAS: --las-classes, or mark it as withheld)"
            ))
        }
        other => other,
    }
}

/// Refuses worlds that a few points far out make nearly empty, or their voxels huge.
fn check_spread(
    path: &Path,
    opts: &ReadOptions,
    spacing: Spacing,
    plan: &Plan,
    survey: &Survey,
    up: Up,
    metres: [f64; 3],
) -> Result<()> {
    let [nx, _, nz] = plan.dims.map(u64::from);
    let fail = |what: String| {
        let text = format!("{}: {what}", path.display());
        Err(advise(Error::Limit(text), survey, up, metres))
    };
    if nx * nz > MANY_COLUMNS && nx * nz / COLUMNS_A_POINT > survey.n {
        return fail(format!("the world would have {nx} × {nz} columns for {} points", survey.n));
    }
    let [low, high] = survey.most();
    let stretch = |a: usize| (survey.high[a] - survey.low[a]) / (high[a] - low[a]);
    let far = [0, 2].iter().any(|&a| stretch(a) > MAX_STRETCH && high[a] > low[a]);
    if opts.voxel.is_none() && opts.size.is_none() && far {
        let why = match spacing {
            Spacing::Mean => "so no width of voxels can be told from them",
            Spacing::Longest => "so all others would be in a few voxels",
        };
        return fail(format!("a few points lie far out, {why}"));
    }
    Ok(())
}

/// A place of the input in world axes.
fn turn(up: Up, [x, y, z]: [f64; 3]) -> [f64; 3] {
    match up {
        Up::X => [z, x, y],
        Up::Y => [x, y, z],
        Up::Z => [x, z, -y],
    }
}

/// For each axis of the world, the one of the input that it is, and which way.
fn sources(up: Up) -> [(usize, f64); 3] {
    match up {
        Up::X => [(2, 1.0), (0, 1.0), (1, 1.0)],
        Up::Y => [(0, 1.0), (1, 1.0), (2, 1.0)],
        Up::Z => [(0, 1.0), (2, 1.0), (1, -1.0)],
    }
}

fn box_of(a: [f64; 3], b: [f64; 3]) -> [[f64; 3]; 2] {
    [[0, 1, 2].map(|i| a[i].min(b[i])), [0, 1, 2].map(|i| a[i].max(b[i]))]
}

impl Pieces for Points {
    fn dims(&self) -> [u32; 3] {
        self.dims
    }

    fn colored(&self) -> bool {
        true
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }

    fn about(&self) -> About {
        self.about.clone()
    }

    fn piece(&self, xs: Range<u32>, zs: Range<u32>) -> Result<Input> {
        let dims = [xs.len() as u32, self.dims[1], zs.len() as u32];
        // How far a point fills voxels below it on an axis, and above.
        let (down, up) = ((self.point_size - 1) / 2, self.point_size / 2);
        let column = |x: u32, z: u32| (z - zs.start) * dims[0] + x - xs.start;
        if self.point_size == 1 {
            let mut spots = Vec::new();
            self.records((zs.start / TILE) as usize..zs.end.div_ceil(TILE) as usize, |r| {
                if xs.contains(&r.x) && zs.contains(&r.z) {
                    spots.push(Spot { column: column(r.x, r.z), y: r.y, color: self.paint.color(r) });
                }
            })?;
            return Ok(spots::piece(dims, spots, true));
        }
        // Points in and around the piece, by the columns that they fill; those in a column of their own come first.
        let near =
            |within: &Range<u32>, n: u32| within.start.saturating_sub(up)..within.end.saturating_add(down).min(n);
        let (near_xs, near_zs) = (near(&xs, self.dims[0]), near(&zs, self.dims[2]));
        let cells = |v: u32, within: &Range<u32>| within.start.max(v.saturating_sub(down))..within.end.min(v + up + 1);
        let mut filled: Vec<(u32, u16, bool, Rgb)> = Vec::new();
        self.records((near_zs.start / TILE) as usize..near_zs.end.div_ceil(TILE) as usize, |r| {
            if near_xs.contains(&r.x) && near_zs.contains(&r.z) {
                let color = self.paint.color(r);
                for z in cells(r.z, &zs) {
                    let xs = cells(r.x, &xs);
                    filled.extend(xs.map(|x| (column(x, z), r.y, (x, z) != (r.x, r.z), color)));
                }
            }
        })?;
        filled.par_sort_unstable();
        let mut columns = ColumnsBuilder::new(dims[0], dims[1], dims[2]);
        let (mut offsets, mut entries) = (vec![0u32], Vec::new());
        let mut voxels = filled.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)).peekable();
        for number in 0..dims[0] * dims[2] {
            while let Some(same) = voxels.next_if(|v| v[0].0 == number) {
                let y = same[0].1;
                let ys = cells(y.into(), &(0..dims[1]));
                columns.push_run(Run::new(ys.start as u16, (ys.end - 1) as u16));
                // Voxels that points lie in keep the colours of these alone; what is above and below takes the nearest.
                let mut mean = Mean::default();
                same.iter().filter(|s| s.2 == same[0].2).for_each(|s| mean.add(s.3));
                entries.push((y, mean.get().expect("one point at least")));
            }
            columns.end_column();
            offsets.push(entries.len() as u32);
        }
        let colors = Colors::Voxel { offsets, entries };
        Ok(Input { columns: columns.finish(), colors, notes: Vec::new() })
    }

    fn input_bytes(&self) -> u64 {
        self.input_bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_grown_map_reaches_as_far_as_said_and_no_further() {
        let mut map = vec![false; 7 * 5];
        map[2 * 7 + 3] = true;
        let out = grown(&map, 7, 2, 1);
        let set: Vec<(usize, usize)> = (0..35).filter(|&i| out[i]).map(|i| (i % 7, i / 7)).collect();
        let expected: Vec<(usize, usize)> = (0..=3).flat_map(|y| (1..=4).map(move |x| (x, y))).collect();
        assert_eq!(set, expected);
    }

    #[test]
    fn classes_are_numbers_and_ranges() {
        let classes: Classes = "2-4, 9".parse().unwrap();
        assert_eq!((0..=255).filter(|&c| classes.has(c)).collect::<Vec<u8>>(), [2, 3, 4, 9]);
        assert_eq!(classes.to_string(), "2-4,9");
        for wrong in ["", "a", "2-", "4-2", "256", "-1"] {
            assert!(wrong.parse::<Classes>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn ramps_begin_and_end_at_their_colours() {
        assert_eq!((ramp(0.0), ramp(1.0), ramp(0.5)), ([68, 1, 84], [253, 231, 37], [33, 144, 141]));
        let colors: std::collections::HashSet<Rgb> = (2..=17).map(class_color).collect();
        assert!(colors.len() >= 14, "classes can be told apart");
        assert_eq!(Paint::Intensity(10, 20).color(&Record { x: 0, z: 0, y: 0, look: [20, 0, 0] }), [255; 3]);
    }
}
