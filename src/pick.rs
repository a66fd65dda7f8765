//! The first solid voxel along a ray: a digital differential analyser in f64 over level 0.

use glam::DVec3;
use planecast_encoder::{ColorMode, Columns, Error, Result, Rgb, Scene};
use serde::Serialize;

/// The side of a voxel that a ray came in through.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Face {
    #[serde(rename = "-x")]
    NegX,
    #[serde(rename = "+x")]
    PosX,
    #[serde(rename = "-y")]
    NegY,
    #[serde(rename = "+y")]
    PosY,
    #[serde(rename = "-z")]
    NegZ,
    #[serde(rename = "+z")]
    PosZ,
    /// The ray starts inside the voxel.
    #[serde(rename = "inside")]
    Inside,
}

impl Face {
    /// The face that a ray moving in direction `step` (±1) along `axis` comes in through.
    fn entered(axis: usize, step: i64) -> Face {
        match (axis, step > 0) {
            (0, true) => Face::NegX,
            (0, false) => Face::PosX,
            (1, true) => Face::NegY,
            (1, false) => Face::PosY,
            (_, true) => Face::NegZ,
            (_, false) => Face::PosZ,
        }
    }
}

/// Where a ray meets a solid voxel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    pub voxel: [u32; 3],
    /// Voxels along the ray, from its start.
    pub distance: f64,
    pub face: Face,
}

/// The answer as the command prints it; all but `hit` are null where nothing is hit.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    pub hit: bool,
    pub voxel: Option<[u32; 3]>,
    pub distance: Option<f64>,
    pub face: Option<Face>,
    /// `#rrggbb`; null where the scene has no colour there.
    pub color: Option<String>,
}

/// The first solid voxel of the scene along the ray; `dir` need not have length 1.
pub fn report(scene: &Scene, from: DVec3, dir: DVec3) -> Result<Report> {
    let hit = pick(&scene.levels[0].solid, from, dir)?;
    let color = hit.and_then(|h| color(scene, h.voxel)).map(|[r, g, b]| format!("#{r:02x}{g:02x}{b:02x}"));
    Ok(Report {
        hit: hit.is_some(),
        voxel: hit.map(|h| h.voxel),
        distance: hit.map(|h| h.distance),
        face: hit.map(|h| h.face),
        color,
    })
}

/// The first solid voxel along `from + t·dir`, t ≥ 0. A start inside a solid voxel hits it at distance 0.
///
/// Error: a crossing's parameter is computed from the integer cell face, never accumulated, so a distance is off
/// by a few rounding steps of f64 at any range.
pub fn pick(columns: &Columns, from: DVec3, dir: DVec3) -> Result<Option<Hit>> {
    if !from.is_finite() || !dir.is_finite() {
        return Err(Error::Argument("the ray of a pick has a coordinate that is not a finite number".into()));
    }
    let largest = dir.abs().max_element();
    if largest == 0.0 {
        return Err(Error::Argument("the direction of a pick is 0,0,0; at least one part must differ from 0".into()));
    }
    // First to about 1, so that neither tiny nor huge directions lose their length to under- or overflow.
    let d = (dir / largest).normalize().to_array();
    let o = from.to_array();
    let dims = columns.dims().map(i64::from);
    let cell = o.map(|v| v.floor() as i64);
    if columns.solid(cell[0], cell[1], cell[2]) {
        return Ok(Some(Hit { voxel: cell.map(|v| v as u32), distance: 0.0, face: Face::Inside }));
    }

    let step = d.map(|v| if v > 0.0 { 1 } else { -1 });
    // The stretch of the ray inside the world's box, and the axis whose face it comes in through.
    let (mut t, mut t_exit, mut axis) = (0.0, f64::INFINITY, None);
    for a in 0..3 {
        let top = dims[a] as f64;
        if d[a] == 0.0 {
            if o[a] < 0.0 || o[a] >= top {
                return Ok(None);
            }
            continue;
        }
        let (near, far) = if step[a] > 0 { (0.0, top) } else { (top, 0.0) };
        if (near - o[a]) / d[a] >= t {
            (t, axis) = ((near - o[a]) / d[a], Some(a));
        }
        t_exit = f64::min(t_exit, (far - o[a]) / d[a]);
    }
    if t > t_exit || t_exit < 0.0 {
        return Ok(None);
    }
    let mut cell: [i64; 3] = std::array::from_fn(|a| match axis {
        Some(entry) if entry == a => {
            if step[a] > 0 {
                0
            } else {
                dims[a] - 1
            }
        }
        _ => ((o[a] + t * d[a]).floor() as i64).clamp(0, dims[a] - 1),
    });
    loop {
        if columns.solid(cell[0], cell[1], cell[2]) {
            // The loop comes here only through a face: a solid cell around the start was returned above.
            let face = axis.map_or(Face::Inside, |a| Face::entered(a, step[a]));
            return Ok(Some(Hit { voxel: cell.map(|v| v as u32), distance: t, face }));
        }
        let crossing: [f64; 3] = std::array::from_fn(|a| match d[a] {
            0.0 => f64::INFINITY,
            _ => ((cell[a] + i64::from(step[a] > 0)) as f64 - o[a]) / d[a],
        });
        let next = (0..3).min_by(|&a, &b| crossing[a].total_cmp(&crossing[b])).expect("three axes");
        t = crossing[next].max(t);
        cell[next] += step[next];
        axis = Some(next);
        if !(0..dims[next]).contains(&cell[next]) {
            return Ok(None);
        }
    }
}

/// The colour of a solid voxel of level 0, where the scene has one.
pub fn color(scene: &Scene, [x, y, z]: [u32; 3]) -> Option<Rgb> {
    let level = &scene.levels[0];
    match scene.color {
        ColorMode::None => None,
        ColorMode::Run => level.geometry(scene.encoding).find(x, y, z).map(|run| level.colors[run]),
        ColorMode::Voxel => {
            let exposed = level.exposed.as_ref()?;
            let run = exposed.find(x, y, z)?;
            let before: u64 = exposed.runs()[..run].iter().map(|r| u64::from(r.len())).sum();
            let within = y - u32::from(exposed.runs()[run].first());
            level.colors.get(usize::try_from(before + u64::from(within)).ok()?).copied()
        }
    }
}

#[cfg(test)]
mod tests {
    use planecast_encoder::{ColumnsBuilder, Encoding, Level, MipRule, Run};
    use proptest::prelude::*;

    use super::*;

    /// A world of `n³` from one bit a voxel.
    fn world(n: u32, solid: impl Fn(u32, u32, u32) -> bool) -> Columns {
        let mut b = ColumnsBuilder::new(n, n, n);
        for z in 0..n {
            for x in 0..n {
                for y in (0..n).filter(|&y| solid(x, y, z)) {
                    b.push_run(Run::new(y as u16, y as u16));
                }
                b.end_column();
            }
        }
        b.finish()
    }

    /// Distance at which the ray enters the nearest solid voxel: every voxel is tested on its own.
    fn brute(columns: &Columns, from: DVec3, dir: DVec3) -> Option<f64> {
        let d = dir.normalize();
        let mut best: Option<f64> = None;
        for z in 0..columns.nz() {
            for x in 0..columns.nx() {
                for y in 0..columns.ny() {
                    if columns.find(x, y, z).is_none() {
                        continue;
                    }
                    let low = DVec3::new(x.into(), y.into(), z.into());
                    let (a, b) = ((low - from) / d, (low + 1.0 - from) / d);
                    let (enter, exit) = (a.min(b).max_element().max(0.0), a.max(b).min_element());
                    if enter <= exit && best.is_none_or(|t| enter < t) {
                        best = Some(enter);
                    }
                }
            }
        }
        best
    }

    proptest! {
        #[test]
        fn pick_agrees_with_brute_force(
            bits in proptest::collection::vec(0u8..5, 125),
            from in proptest::array::uniform3(-8.0..13.0f64),
            dir in proptest::array::uniform3(-1.0..1.0f64),
        ) {
            let columns = world(5, |x, y, z| bits[(z * 25 + y * 5 + x) as usize] == 0);
            let (from, dir) = (DVec3::from(from), DVec3::from(dir));
            prop_assume!(dir.abs().min_element() > 1e-6);
            let hit = pick(&columns, from, dir).unwrap();
            let expected = brute(&columns, from, dir);
            // A ray that only grazes an edge may be told either way by the two orders of rounding.
            let grazes = |t: f64| ((from + dir.normalize() * t) - (from + dir.normalize() * t).round()).abs().to_array()
                .iter().filter(|v| **v < 1e-9).count() > 1;
            match (hit, expected) {
                (Some(h), Some(t)) => prop_assert!((h.distance - t).abs() < 1e-9, "{h:?} {t}"),
                (None, None) => {}
                (h, e) => prop_assert!(e.is_some_and(grazes), "{h:?} {e:?}"),
            }
            if let Some(h) = hit {
                let at = from + dir.normalize() * h.distance - DVec3::from(h.voxel.map(f64::from));
                prop_assert!(at.min_element() > -1e-9 && at.max_element() < 1.0 + 1e-9);
                let wall = match h.face {
                    Face::NegX => at.x, Face::PosX => 1.0 - at.x, Face::NegY => at.y,
                    Face::PosY => 1.0 - at.y, Face::NegZ => at.z, Face::PosZ => 1.0 - at.z,
                    Face::Inside => h.distance,
                };
                prop_assert!(wall.abs() < 1e-9, "{h:?}");
            }
        }
    }

    #[test]
    fn pick_names_each_face() {
        let columns = world(3, |x, y, z| (x, y, z) == (1, 1, 1));
        for (dir, face) in [
            (DVec3::X, Face::NegX),
            (DVec3::NEG_X, Face::PosX),
            (DVec3::Y, Face::NegY),
            (DVec3::NEG_Y, Face::PosY),
            (DVec3::Z, Face::NegZ),
            (DVec3::NEG_Z, Face::PosZ),
        ] {
            let hit = pick(&columns, DVec3::splat(1.5) - dir * 1e6, dir * 1e-300).unwrap();
            assert_eq!(hit, Some(Hit { voxel: [1, 1, 1], distance: 1e6 - 0.5, face }));
            assert_eq!(pick(&columns, DVec3::splat(1.5) - dir * 5.0, -dir).unwrap(), None, "the ray points away");
        }
    }

    #[test]
    fn pick_from_inside_is_at_distance_zero() {
        let columns = world(3, |_, _, _| true);
        let hit = pick(&columns, DVec3::new(0.5, 2.5, 1.5), DVec3::ONE).unwrap().unwrap();
        assert_eq!((hit.voxel, hit.distance, hit.face), ([0, 2, 1], 0.0, Face::Inside));
        let skin = pick(&columns, DVec3::new(3.0, 1.5, 1.5), DVec3::NEG_X).unwrap().unwrap();
        assert_eq!((skin.voxel, skin.distance, skin.face), ([2, 1, 1], 0.0, Face::PosX));
    }

    #[test]
    fn pick_refuses_a_ray_without_direction() {
        let columns = Columns::empty(1, 1, 1);
        assert!(matches!(pick(&columns, DVec3::ZERO, DVec3::ZERO), Err(Error::Argument(_))));
        assert!(matches!(pick(&columns, DVec3::NAN, DVec3::X), Err(Error::Argument(_))));
        assert_eq!(pick(&columns, DVec3::ZERO, DVec3::X).unwrap(), None);
    }

    #[test]
    fn pick_report_has_the_voxels_colour() {
        let solid = world(2, |x, y, z| (x, z) == (1, 0) || (x, y, z) == (0, 1, 1));
        let colors = vec![[1, 2, 3], [16, 32, 255], [9, 9, 9]];
        let level = Level { exposed: Some(solid.clone()), solid, colors };
        let scene =
            Scene { encoding: Encoding::Solid, color: ColorMode::Voxel, mip_rule: MipRule::Any, levels: vec![level] };
        let json = |from, dir| serde_json::to_string(&report(&scene, from, dir).unwrap()).unwrap();
        assert_eq!(
            json(DVec3::new(1.5, 4.0, 0.5), DVec3::NEG_Y),
            r##"{"hit":true,"voxel":[1,1,0],"distance":2.0,"face":"+y","color":"#1020ff"}"##
        );
        assert_eq!(
            json(DVec3::new(1.5, 4.0, 0.5), DVec3::Y),
            r#"{"hit":false,"voxel":null,"distance":null,"face":null,"color":null}"#
        );
    }
}
