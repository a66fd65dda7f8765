//! Walks in f32 against walks in f64, over distance: where wrong voxels begin, and what follows from rounding.

use crate::cpu::traverse::{PlaneBuffer, SKY, traverse};
use crate::frame::camera::Camera;
use crate::frame::options::{Culling, Options, Repeat, Shading};
use crate::frame::plane_setup::{Plane, plane_setup};
use crate::measure::stability::worlds::WorldName;
use glam::DVec3;

/// Samples whose voxel is this far away.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Bin {
    /// From here, in voxels, to twice as far.
    pub from: f64,
    pub samples: u64,
    /// Those so near a voxel's edge that rounding may put them on its other side.
    pub may_differ: u64,
    /// Those that show another voxel in f32.
    pub differ: u64,
}

/// What came of all walks.
#[derive(Clone, Debug, Default)]
pub struct Walks {
    /// By distance, each twice as far as the one before.
    pub bins: Vec<Bin>,
    /// Where the nearest sample stands that may differ, and the nearest that does, in voxels.
    pub first_may: f64,
    pub first_does: f64,
    /// How far beside its sample the worst wrong voxel's edge stands, as a share of the bound.
    pub worst: f64,
    /// Samples whose wrong voxel stands further beside them than the bound, in words.
    pub faults: Vec<String>,
}

/// How far beside its sample, in samples, the edge of a span may stand by rounding to f32, where it is seen along sample
/// `s`. With unit roundoff `u` = 2⁻²⁴ a crossing takes `(line − fract) · inverse`, four roundings, `h` one, the coefficients
/// of `(A·t + B·h) / (C·t + E·h)` one each, products and sums two: at most 8u of each product, above and below.
pub fn span_bound(plane: &Plane, s: f64) -> f64 {
    let (t, h) = (plane.b - s * plane.e, s * plane.c - plane.a);
    let above = (plane.a * t).abs() + (plane.b * h).abs();
    let below = (plane.c * t).abs() + (plane.e * h).abs();
    8.0 * 2f64.powi(-24) * (above + s * below) / (plane.b * plane.c - plane.a * plane.e)
}

/// Where a plane sees a voxel of level 0, in samples from and to. A voxel that the plane only touches, by
/// rounding, has an extent too.
fn sight_of(plane: &Plane, eye: DVec3, voxel: [i32; 4]) -> (f64, f64) {
    let (mut t0, mut t1) = (0.0f64, f64::INFINITY);
    for (axis, d) in [(0, plane.dir[0]), (2, plane.dir[1])] {
        let from = f64::from(voxel[axis]) - eye[axis];
        let (a, b) = (from / d, (from + 1.0) / d);
        (t0, t1) = (t0.max(a.min(b)), t1.min(a.max(b)));
    }
    let at = |t: f64, h: f64| (plane.a * t + plane.b * h) / (plane.c * t + plane.e * h);
    let from = f64::from(voxel[1]) - eye.y;
    let corners = [t0, t1].into_iter().flat_map(|t| [from, from + 1.0].map(|h| at(t, h)));
    corners.fold((f64::INFINITY, f64::NEG_INFINITY), |(from, to), u| (from.min(u), to.max(u)))
}

/// Level 0 of repeated worlds to 50,000 voxels, from level to almost straight down: 1.3 million samples.
pub fn walks() -> Walks {
    let options = Options {
        lod: None,
        repeat: Repeat { x: true, z: true },
        view_distance: 50_000.0,
        shading: Shading::None,
        ..Options::default()
    };
    let mut out = Walks { first_may: f64::INFINITY, first_does: f64::INFINITY, ..Walks::default() };
    for name in [WorldName::Rocks, WorldName::Floor, WorldName::Poles] {
        let world = name.make();
        let top = f64::from(name.dims()[1]);
        for (k, pitch) in [0.0, -1e-3, -2.0, -20.0, -89.0].into_iter().enumerate() {
            let eye = DVec3::new(12.3 + k as f64, top + 17.2, 20.7);
            let yaw = 33.0 + 45.0 * k as f64;
            let camera = Camera { eye, yaw, pitch, roll: 0.0, fov: 60.0, width: 200, height: 400 };
            let setup = plane_setup(&world.resident, &camera, &options);
            let (mut a, mut b) = (PlaneBuffer::default(), PlaneBuffer::default());
            traverse::<f32>(&world.resident, &setup, Culling::ALL, &mut a, true);
            traverse::<f64>(&world.resident, &setup, Culling::ALL, &mut b, true);
            for plane in &setup.planes {
                for j in plane.first..plane.end {
                    out.sample(plane, eye, [&a.voxel, &b.voxel], j);
                }
            }
        }
    }
    out
}

impl Walks {
    /// Takes in sample `j` of a plane, walked in f32 and in f64.
    pub fn sample(&mut self, plane: &Plane, eye: DVec3, [f32s, f64s]: [&[[i32; 4]]; 2], j: u32) {
        let (i, s) = (plane.base + j as usize, f64::from(j) + 0.5);
        let bound = span_bound(plane, s);
        let edges = |voxel: [i32; 4]| sight_of(plane, eye, voxel);
        let (shown, right) = (f32s[i], f64s[i]);
        // At a silhouette the edge is that of what the sample beside shows.
        let beside = plane.base + j.max(plane.first + 1) as usize - 1..plane.base + (j + 2).min(plane.end) as usize;
        let nearest = (f32s[beside.clone()].iter().chain(&f64s[beside]))
            .filter(|&&v| v != SKY)
            .map(|&v| edges(v))
            .map(|(from, to)| (s - from).abs().min((s - to).abs()));
        let may = nearest.fold(f64::INFINITY, f64::min) <= bound;
        let differs = shown != right;
        let seen = if right == SKY { shown } else { right };
        if seen == SKY {
            return;
        }
        let middle = DVec3::new(f64::from(seen[0]), f64::from(seen[1]), f64::from(seen[2])) + 0.5;
        let distance = middle.distance(eye);
        let k = distance.max(1.0).log2() as usize;
        while self.bins.len() <= k {
            self.bins.push(Bin { from: f64::from(1u32 << self.bins.len()), ..Bin::default() });
        }
        let bin = &mut self.bins[k];
        bin.samples += 1;
        bin.may_differ += u64::from(may);
        bin.differ += u64::from(differs);
        if may {
            self.first_may = self.first_may.min(distance);
        }
        if differs {
            self.first_does = self.first_does.min(distance);
            // Whichever shows a voxel: the sample lies at one of its edges.
            let near = match (shown, right) {
                (SKY, voxel) => {
                    let (from, to) = edges(voxel);
                    (s - from).abs().min((s - to).abs())
                }
                (voxel, _) => {
                    let (from, to) = edges(voxel);
                    (from - s).max(s - to).max(0.0)
                }
            };
            self.worst = self.worst.max(near / bound);
            if near > bound {
                self.faults.push(format!("f32 {shown:?}, f64 {right:?}: {near:.1e} samples beside, bound {bound:.1e}"));
            }
        }
    }

    /// All bins together.
    pub fn all(&self) -> Bin {
        self.bins.iter().fold(Bin::default(), |sum, bin| Bin {
            from: sum.from,
            samples: sum.samples + bin.samples,
            may_differ: sum.may_differ + bin.may_differ,
            differ: sum.differ + bin.differ,
        })
    }
}
