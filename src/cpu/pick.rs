//! The first solid voxel along a ray, by the walk of the exact reference over level 0.

use glam::DVec3;
use planecast_encoder::{ColorMode, Columns, Error, Result, Rgb, Scene};
use serde::Serialize;

use crate::cpu::exact::{self, Face};

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
    let d = (dir / largest).normalize();
    let hit = exact::cast(columns, [false; 2], from, d, f64::INFINITY);
    Ok(hit.map(|h| Hit { voxel: h.voxel.map(|v| v as u32), distance: h.t, face: h.face }))
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
        let level = Level { exposed: Some(solid.clone()), solid, colors, matter: None };
        let scene = Scene {
            encoding: Encoding::Solid,
            color: ColorMode::Voxel,
            mip_rule: MipRule::Any,
            levels: vec![level],
            classes: None,
        };
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
