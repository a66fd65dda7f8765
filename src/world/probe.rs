//! What is solid at a place, and along a ray, of a world that comes in tiles: by the finest of its tiles that are there.

use glam::DVec3;
use planecast_encoder::TileKey;

use crate::world::pager::Pager;
use crate::world::tables::{Resident, TILE_SHIFT};

/// What a ray meets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Met {
    /// Voxels along the ray, whose direction has length 1.
    pub t: f64,
    /// Lowest corner of the voxel, in voxels of level 0.
    pub voxel: [i64; 3],
    /// Its level: it is `2^level` voxels of level 0 wide.
    pub level: u32,
}

/// The tile of a level that a column of level 0 is in.
fn key(level: u32, x: u32, z: u32) -> TileKey {
    let shift = level + TILE_SHIFT;
    TileKey { level, x: x.unbounded_shr(shift), z: z.unbounded_shr(shift) }
}

/// Columns that a ray passes at most.
const COLUMNS: usize = 100_000;

/// Looks into the tiles that are there.
pub struct Probe<'a> {
    pager: &'a Pager,
    tables: &'a Resident,
}

impl<'a> Probe<'a> {
    pub fn new(pager: &'a Pager, tables: &'a Resident) -> Probe<'a> {
        Probe { pager, tables }
    }

    /// The finest level that is there of a column of level 0, itself and not stood in for, from `from` on.
    fn finest(&self, from: u32, x: u32, z: u32) -> Option<u32> {
        let is_there = |&level: &u32| self.pager.missing(self.tables, key(level, x, z)) == Some(0);
        (from..self.tables.levels.len() as u32).find(is_there)
    }

    /// The first run of a column of a level that reaches into heights `low ..= high`, both in voxels of level 0; from below,
    /// or from above: the order in which a ray comes by.
    fn run(&self, level: u32, x: u32, z: u32, low: f64, high: f64, from_below: bool) -> Option<[f64; 2]> {
        if self.pager.source().is_empty(key(level, x, z)) {
            // Another tile may stand in its place.
            return None;
        }
        let of_level = &self.tables.levels[level as usize];
        let ix = of_level.index(x >> level, z >> level);
        let voxel = f64::from(1u32 << level);
        let ends = |run: planecast_encoder::Run| [f64::from(run.first()) * voxel, f64::from(run.end()) * voxel];
        let reaches = |[first, end]: &[f64; 2]| *first <= high && *end > low;
        // From the top down.
        let mut runs = of_level.column(ix).map(ends).filter(reaches);
        if from_below { runs.last() } else { runs.next() }
    }

    /// Whether a voxel is solid.
    pub fn solid(&self, x: u32, y: u32, z: u32) -> bool {
        let (y, level) = (f64::from(y), self.finest(0, x, z));
        level.is_some_and(|level| self.run(level, x, z, y, y, true).is_some())
    }

    /// The first that is solid along a ray, nearer than `far`; `dir` has length 1.
    pub fn cast(&self, eye: DVec3, dir: DVec3, far: f64) -> Option<Met> {
        let sides = self.tables.dims.map(f64::from);
        let (mut t, mut end) = (0.0f64, far);
        for k in 0..3 {
            let (from, way) = (eye[k], dir[k]);
            if way == 0.0 {
                if from < 0.0 || from >= sides[k] {
                    return None;
                }
                continue;
            }
            let [a, b] = [0.0, sides[k]].map(|side| (side - from) / way);
            (t, end) = (t.max(a.min(b)), end.min(a.max(b)));
        }
        let mut level = 0;
        for _ in 0..COLUMNS {
            if t >= end {
                return None;
            }
            // A little beyond the border, so that it is this side's column.
            let inside = t + 1e-9 * t.max(1.0);
            let [x, z] = [0, 2].map(|k| (eye[k] + dir[k] * inside).clamp(0.0, sides[k] - 1.0) as u32);
            // Near the eye tiles are fine: what lies beyond is looked for from one level finer on.
            level = self.finest(level.max(1) - 1, x, z)?;
            let voxel = f64::from(1u32 << level);
            let exit = [(0, x), (2, z)].map(|(k, at)| {
                let cell = f64::from(at >> level);
                match dir[k] {
                    way if way > 0.0 => ((cell + 1.0) * voxel - eye[k]) / way,
                    way if way < 0.0 => (cell * voxel - eye[k]) / way,
                    _ => f64::INFINITY,
                }
            });
            let exit = exit[0].min(exit[1]).max(inside).min(end);
            let [a, b] = [t, exit].map(|t| eye.y + dir.y * t);
            if let Some([first, top]) = self.run(level, x, z, a.min(b), a.max(b), dir.y > 0.0) {
                let at = match a {
                    a if a < first && dir.y > 0.0 => (first - eye.y) / dir.y,
                    a if a > top && dir.y < 0.0 => (top - eye.y) / dir.y,
                    _ => t,
                };
                let y = (eye.y + dir.y * at).clamp(first, top - voxel);
                let corner = |v: f64| (v / voxel).floor() as i64 * (1i64 << level);
                let [x, z] = [x, z].map(|v| i64::from(v >> level << level));
                return Some(Met { t: at.max(t), voxel: [x, corner(y), z], level });
            }
            t = exit;
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use planecast_encoder::{BuildOptions, Colors, Columns, Input, PcastFile, TileSource, build};

    use super::*;
    use crate::cpu::exact;
    use crate::testing::noise;
    use crate::world::pager::{Patience, Wanted};

    /// Hills with caves in them, of 3 × 2 tiles; what they are and their tiles, of which those of level 0 `wanted` are there.
    fn world(wanted: impl Fn(u32, u32) -> bool) -> (Columns, Pager, Resident) {
        let hill = |x: u32, z: u32| (30.0 + 20.0 * ((x as f32 / 40.0).sin() + (z as f32 / 31.0).cos())) as u32;
        let solid = |x: u32, y: u32, z: u32| y < hill(x, z) && !(y / 5 + x / 9 + z / 7).is_multiple_of(4);
        let columns = Columns::from_fn(700, 80, 500, solid);
        let input = Input { columns: columns.clone(), colors: Colors::None, notes: Vec::new() };
        let scene = build(input, &BuildOptions::default()).unwrap();
        let (mut bytes, name) = (std::io::Cursor::new(Vec::new()), std::path::Path::new("hills.pcast"));
        planecast_encoder::format::write::write_scene_to(&scene, &mut bytes, name).unwrap();
        let source: Arc<dyn TileSource> = Arc::new(PcastFile::from_bytes(name, bytes.into_inner()).unwrap());
        let (mut pager, mut tables) = Pager::new(source, 64 << 20, None).unwrap();
        let keys = (0..2).flat_map(|z| (0..3).map(move |x| TileKey { level: 0, x, z }));
        let wants: Vec<Wanted> = keys.filter(|k| wanted(k.x, k.z)).map(|key| Wanted { key, planes: 1 }).collect();
        pager.update(&mut tables, &wants, Patience::Wait).unwrap().unwrap();
        (columns, pager, tables)
    }

    fn rays(n: u32) -> impl Iterator<Item = (DVec3, DVec3)> {
        let random = |i: u32, k: u32| f64::from(noise(i, k, 5) % 10_000) / 10_000.0;
        (0..n).map(move |i| {
            let eye =
                DVec3::new(random(i, 0) * 900.0 - 100.0, random(i, 1) * 160.0 - 20.0, random(i, 2) * 700.0 - 100.0);
            let dir = DVec3::new(random(i, 3) - 0.5, random(i, 4) - 0.7, random(i, 5) - 0.5);
            (eye, dir.normalize())
        })
    }

    #[test]
    fn rays_and_places_in_tiles_meet_what_they_meet_in_the_whole_world() {
        let (columns, pager, tables) = world(|_, _| true);
        let probe = Probe::new(&pager, &tables);
        let (mut hits, mut other) = (0, 0);
        for (eye, dir) in rays(3000) {
            let expected = exact::cast(&columns, [false; 2], eye, dir, 1e6);
            let met = probe.cast(eye, dir, 1e6);
            hits += usize::from(expected.is_some());
            match (expected, met) {
                (None, None) => {}
                (Some(hit), Some(met)) if (hit.t - met.t).abs() < 1e-5 => {
                    assert_eq!(met.level, 0);
                    // A ray along an edge may be told either way.
                    other += usize::from(hit.voxel != met.voxel);
                }
                (expected, met) => panic!("from {eye} along {dir}: {met:?}, expected {expected:?}"),
            }
        }
        assert!(hits > 1000 && other < 10, "{hits} hits, {other} of other voxels");
        for i in 0..5000 {
            let [x, y, z] = [(0, 700), (1, 80), (2, 500)].map(|(k, n)| noise(i, k, 9) % n);
            assert_eq!(probe.solid(x, y, z), columns.find(x, y, z).is_some(), "{x}, {y}, {z}");
        }
    }

    #[test]
    fn coarser_tiles_answer_where_finer_ones_are_not_there() {
        let (columns, pager, tables) = world(|x, _| x == 0);
        let probe = Probe::new(&pager, &tables);
        let down = |x: f64, z: f64| probe.cast(DVec3::new(x, 200.0, z), DVec3::NEG_Y, 1e6).unwrap();
        let top = |x: u32, z: u32| f64::from(columns.column(x, z).last().unwrap().end());
        let near = down(100.5, 100.5);
        assert_eq!((near.level, near.t), (0, 200.0 - top(100, 100)));
        let far = down(600.5, 100.5);
        let wide = f64::from(1u32 << far.level);
        assert!(far.level > 0 && (200.0 - far.t - top(600, 100)).abs() <= 2.0 * wide, "{far:?}");
        assert!(far.voxel.iter().all(|v| v % (1 << far.level) == 0), "{far:?}");
        assert!(probe.cast(DVec3::new(100.5, 200.0, 100.5), DVec3::Y, 1e6).is_none());
    }
}
