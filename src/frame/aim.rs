//! Where the camera is and looks, as people say it: at a point, round it, all of it, from above.

use clap::Args;
use glam::DVec3;
use planecast_encoder::Scene;

use crate::cli::{finite, pitch, positive, vector};
use crate::film::path::{Path, Pose};
use crate::film::tour::{self, Subject, View};
use crate::{Error, Result};

/// From which side, how steep, how far: `--orbit`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orbit {
    yaw: f64,
    pitch: f64,
    /// Voxels; None: so that all of the scene is in the picture.
    distance: Option<f64>,
}

impl Orbit {
    /// The same in other units.
    #[must_use]
    pub fn scaled(self, by: f64) -> Orbit {
        Orbit { distance: self.distance.map(|distance| distance * by), ..self }
    }
}

fn orbit(s: &str) -> Result<Orbit, String> {
    let wrong = || "expected YAW,PITCH or YAW,PITCH,DISTANCE, as in 30,-20 or 30,-20,400".to_owned();
    let parts: Vec<&str> = s.split(',').collect();
    let (yaw, down, distance) = match parts[..] {
        [yaw, down] => (yaw, down, None),
        [yaw, down, distance] => (yaw, down, Some(positive(distance)?)),
        _ => return Err(wrong()),
    };
    Ok(Orbit { yaw: finite(yaw).map_err(|_| wrong())?, pitch: pitch(down)?, distance })
}

/// A camera without coordinates of the eye.
#[derive(Clone, Copy, Debug, Default, PartialEq, Args)]
pub struct AimArgs {
    /// Look at this point, voxels [default without --eye: the middle of what is solid]
    #[arg(long, value_name = "X,Y,Z", value_parser = vector)]
    pub(crate) look_at: Option<DVec3>,
    /// Go round what is looked at: the directions of view as --yaw and --pitch have them, and how far away, voxels [default: so
    /// far that all is in the picture]
    #[arg(long, value_name = "YAW,PITCH[,DISTANCE]", value_parser = orbit)]
    pub(crate) orbit: Option<Orbit>,
    /// Put all of the scene into the picture
    #[arg(long)]
    fit: bool,
    /// From straight above, north (-z) up
    #[arg(long)]
    top: bool,
}

/// What of a pose was typed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Typed {
    pub eye: Option<DVec3>,
    pub yaw: Option<f64>,
    pub pitch: Option<f64>,
    pub roll: f64,
}

impl AimArgs {
    pub fn is_given(&self) -> bool {
        *self != AimArgs::default()
    }

    /// The pose that was asked for; what was not said is taken from a good view of the scene, which without an eye goes round
    /// what is looked at.
    pub fn pose(&self, typed: Typed, scene: &Scene, view: View) -> Result<Pose> {
        let wrong = |what: &str| Err(Error::Argument(what.to_owned()));
        let Typed { eye, yaw, pitch, roll } = typed;
        let turned = yaw.is_some() || pitch.is_some();
        if self.orbit.is_some() && (turned || self.top) {
            return wrong("--orbit: has yaw and pitch of its own; leave out --yaw, --pitch and --top");
        }
        if self.top && pitch.is_some() {
            return wrong("--top: looks straight down; leave out --pitch");
        }
        let pose = if let Some(eye) = eye {
            if self.orbit.is_some() || self.fit || self.top {
                return wrong(
                    "--eye: says where the camera is, and --orbit, --fit and --top find that; leave out one of them",
                );
            }
            match self.look_at {
                Some(_) if turned => {
                    return wrong("--look-at: says where the camera at --eye looks; leave out --yaw and --pitch");
                }
                Some(at) if at == eye => {
                    return wrong("--look-at: is the place of --eye; there is no direction between them");
                }
                Some(at) => tour::look(eye, at, view.fov),
                None => Pose { eye, yaw: yaw.unwrap_or(0.0), pitch: pitch.unwrap_or(0.0), roll, fov: view.fov },
            }
        } else if !self.is_given() && !turned {
            tour::still(scene, view)
        } else {
            let subject = Subject::new(scene);
            let [side, down] = subject.side;
            let (yaw, pitch, distance) = match self.orbit {
                Some(orbit) => (orbit.yaw, orbit.pitch, orbit.distance),
                None if self.top => (yaw.unwrap_or(0.0), -90.0, None),
                None => (yaw.unwrap_or(side), pitch.unwrap_or(down), None),
            };
            let target = self.look_at.unwrap_or_else(|| subject.center());
            match (distance.filter(|_| !self.fit), self.look_at) {
                (Some(distance), _) => tour::from_side(target, yaw, pitch, distance, view.fov),
                (None, None) => subject.framed(yaw, pitch, view),
                (None, Some(at)) if self.orbit.is_none() && !self.top && !self.fit && !turned => {
                    // The eye of the good view turns to the point.
                    let eye = tour::still(scene, view).eye;
                    if eye == at { tour::still(scene, view) } else { tour::look(eye, at, view.fov) }
                }
                (None, Some(_)) => {
                    tour::from_side(target, yaw, pitch, subject.distance(target, yaw, pitch, view), view.fov)
                }
            }
        };
        Ok(Pose { roll, ..pose })
    }

    /// A film that goes once round what is looked at; None where nothing of it was asked for.
    pub fn path(&self, scene: &Scene, view: View) -> Option<Path> {
        if !self.is_given() {
            return None;
        }
        let subject = Subject::new(scene);
        let [side, down] = subject.side;
        let (yaw, pitch) = match self.orbit {
            Some(orbit) => (orbit.yaw, orbit.pitch),
            None => (side, if self.top { -90.0 } else { down }),
        };
        let target = self.look_at.unwrap_or_else(|| subject.center());
        let all_round = || {
            let turns = (0..24).map(|i| subject.distance(target, yaw + 15.0 * f64::from(i), pitch, view));
            turns.fold(0.0, f64::max)
        };
        let distance = self.orbit.and_then(|orbit| orbit.distance).filter(|_| !self.fit).unwrap_or_else(all_round);
        Some(tour::round(target, yaw, pitch, distance, view.fov))
    }
}

#[cfg(test)]
mod tests {
    use planecast_encoder::{BuildOptions, Colors, Columns, Input, build};

    use super::*;
    use crate::Repeat;

    const VIEW: View = View { fov: 60.0, size: [400, 300], repeat: Repeat { x: false, z: false } };

    /// A block of 20 × 30 × 10 in a world of 64³.
    fn block() -> Scene {
        let columns = Columns::from_fn(64, 64, 64, |x, y, z| {
            (8..28).contains(&x) && (4..34).contains(&y) && (40..50).contains(&z)
        });
        build(Input { columns, colors: Colors::None, notes: Vec::new() }, &BuildOptions::default()).unwrap()
    }

    /// Where the block lies in the picture: left, right, bottom, top, each from −1 to 1.
    fn box_of(pose: Pose) -> [f64; 4] {
        let camera = pose.camera(VIEW.size);
        let (basis, half) = (camera.basis(), camera.half_extent());
        let corners = (0..8).map(|i| {
            let side = |bit: i32, low: f64, high: f64| if i >> bit & 1 == 0 { low } else { high };
            let d = DVec3::new(side(0, 8.0, 28.0), side(1, 4.0, 34.0), side(2, 40.0, 50.0)) - pose.eye;
            let depth = d.dot(basis.forward);
            assert!(depth > 0.0, "{pose:?}");
            [d.dot(basis.right) / depth / half.x, d.dot(basis.up) / depth / half.y]
        });
        corners.fold([9.0, -9.0, 9.0, -9.0], |b, [x, y]| [b[0].min(x), b[1].max(x), b[2].min(y), b[3].max(y)])
    }

    fn is_framed(pose: Pose) -> bool {
        let [left, right, bottom, top] = box_of(pose);
        let filled = ((right - left) / 2.0).max((top - bottom) / 2.0);
        (left + right).abs() < 1e-4 && (bottom + top).abs() < 1e-4 && (filled - 0.75).abs() < 1e-4
    }

    fn aim(look_at: Option<DVec3>, orbit: Option<Orbit>, fit: bool, top: bool) -> AimArgs {
        AimArgs { look_at, orbit, fit, top }
    }

    #[test]
    fn views_fill_three_quarters_and_have_the_block_in_their_middle() {
        let scene = block();
        let all = [
            (aim(None, None, false, false), Typed::default()),
            (aim(None, None, true, false), Typed::default()),
            (aim(None, None, false, true), Typed::default()),
            (aim(None, orbit("100,35").ok(), false, false), Typed::default()),
            (aim(None, None, false, false), Typed { yaw: Some(-120.0), ..Typed::default() }),
            (aim(None, None, false, false), Typed { pitch: Some(60.0), ..Typed::default() }),
        ];
        for (aim, typed) in all {
            let pose = aim.pose(typed, &scene, VIEW).unwrap();
            assert!(is_framed(pose), "{aim:?} {typed:?}: {:?}", box_of(pose));
            assert_eq!(typed.yaw.unwrap_or(pose.yaw), pose.yaw);
        }
        assert_eq!(aim(None, None, false, true).pose(Typed::default(), &scene, VIEW).unwrap().pitch, -90.0);
    }

    #[test]
    fn views_at_a_point_have_it_in_their_middle() {
        let (scene, at) = (block(), DVec3::new(8.0, 34.0, 40.0));
        let eye = Typed { eye: Some(DVec3::new(-30.0, 50.0, 90.0)), ..Typed::default() };
        let yaw = Typed { yaw: Some(45.0), ..Typed::default() };
        for (orbit, typed) in
            [(None, Typed::default()), (None, eye), (None, yaw), (orbit("30,-20,77").ok(), Typed::default())]
        {
            let pose = aim(Some(at), orbit, false, false).pose(typed, &scene, VIEW).unwrap();
            let d = (at - pose.eye).normalize() - pose.camera([4, 3]).basis().forward;
            assert!(d.length() < 1e-9, "{pose:?}");
            assert!(orbit.is_none() || ((at - pose.eye).length() - 77.0).abs() < 1e-9);
            assert_eq!(typed.eye.unwrap_or(pose.eye), pose.eye);
        }
    }

    #[test]
    fn views_that_contradict_themselves_are_refused() {
        let scene = block();
        let eye = Typed { eye: Some(DVec3::ONE), ..Typed::default() };
        let yaw = Typed { yaw: Some(1.0), ..Typed::default() };
        for (aim, typed, what) in [
            (aim(None, orbit("1,2").ok(), false, false), yaw, "--orbit: has yaw"),
            (aim(None, None, true, false), eye, "--eye: says where"),
            (aim(Some(DVec3::ONE), None, false, false), eye, "--look-at: is the place of --eye"),
            (aim(Some(DVec3::ZERO), None, false, false), Typed { yaw: Some(1.0), ..eye }, "leave out --yaw"),
        ] {
            let error = aim.pose(typed, &scene, VIEW).unwrap_err().to_string();
            assert!(error.contains(what), "{error}");
        }
        for wrong in ["1", "1,2,3,4", "1,95", "1,2,0", "x,2"] {
            assert!(orbit(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_film_round_a_point_keeps_its_distance_and_all_in_the_picture() {
        let scene = block();
        let path = aim(None, None, true, false).path(&scene, VIEW).unwrap();
        let center = DVec3::new(18.0, 19.0, 45.0);
        let far = (path.at(0.0).eye - center).length();
        for pose in path.poses(97) {
            assert!(((pose.eye - center).length() / far - 1.0).abs() < 2e-3, "{pose:?}");
            assert!(box_of(pose).iter().all(|v| v.abs() < 0.8), "{:?}", box_of(pose));
        }
        assert!(AimArgs::default().path(&scene, VIEW).is_none());
    }
}
