//! Scripts: what a person would do in the window, for tests and demonstrations.
//!
//! A script is JSON: a list of actions in the order of their times.
//!
//! ```json
//! [
//!   {"t": 0,   "press": "KeyW"},
//!   {"t": 1.5, "release": "KeyW"},
//!   {"t": 1.6, "resize": [640, 400]},
//!   {"t": 2,   "screenshot": "view.png"},
//!   {"t": 2,   "quit": {}}
//! ]
//! ```
//!
//! | action | |
//! | --- | --- |
//! | `press`, `release`, `key` | a key goes down, up, or both, by its name in browsers (`KeyW`, `ShiftLeft`, `F12`) |
//! | `look` | the mouse moves by these pixels while it looks around |
//! | `wheel` | notches |
//! | `double_click` | at these pixels of the window |
//! | `resize` | the window, pixels; 0 × 0 as when it is minimised |
//! | `screenshot` | writes the view as `render` draws it (PNG), and prints that command |
//! | `grab` | writes what the window shows, panel included (PNG) |
//! | `figures` | writes what the latest frame cost (JSON) |
//! | `click` | at these pixels of the window, as a mouse that does not move in between |
//! | `hover` | the mouse is at these pixels |
//! | `drag` | `{"from": [x, y], "to": [x, y]}`: the mouse moves with its button down |
//! | `tune` | the input is read in another way: any of `threshold`, `up`, `as_is`, `ramp`, `exaggeration` |
//! | `refine` | whether all pixels and the best preset are drawn at rest; scripts begin without |
//! | `wait` | until the input is read as it was wanted, and all tiles of a world that comes in tiles are there |
//! | `drop` | a file is dropped on the window |
//! | `lose_device` | the GPU's device is given up, as when a driver is reset |
//! | `surface` | the surface is `outdated`, as when the window changes under it, or `lost` |
//! | `occluded` | `true`: nothing of the window can be seen from now on; `false`: it can again |
//! | `sleep` | the machine sleeps for so many seconds: the window goes, and comes again |
//! | `scale` | waits until a point is so many pixels wide, as after a change of the display's resolution |
//! | `quit` | |
//!
//! `t` is in seconds that pass by a thirtieth a frame, however long a frame takes: a script flies the same way on every
//! machine.

use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::tune::Tune;

use planecast_encoder::{Error, Result};

/// Seconds that a frame counts.
pub const STEP: f64 = 1.0 / 30.0;

/// What is done.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Action {
    Press(String),
    Release(String),
    Key(String),
    Look([f64; 2]),
    Wheel(f64),
    DoubleClick([f64; 2]),
    Resize([u32; 2]),
    Screenshot(PathBuf),
    Grab(PathBuf),
    Figures(PathBuf),
    Click([f64; 2]),
    Hover([f64; 2]),
    Drag { from: [f64; 2], to: [f64; 2] },
    Tune(Tune),
    Refine(bool),
    Wait {},
    Drop(PathBuf),
    LoseDevice {},
    Surface(Trouble),
    Occluded(bool),
    Sleep(f64),
    Scale(f64),
    Quit {},
}

/// What happens to the surfaces of windows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Trouble {
    Outdated,
    Lost,
}

#[derive(Clone, Debug, PartialEq)]
struct Timed {
    t: f64,
    action: Action,
}

/// A script and how far it is.
#[derive(Clone, Debug, PartialEq)]
pub struct Script {
    actions: Vec<Timed>,
    next: usize,
    frames: u64,
}

impl Script {
    pub fn read(path: &Path) -> Result<Script> {
        let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "read", e))?;
        Script::parse(&text).map_err(|what| Error::format(path, what))
    }

    pub fn parse(text: &str) -> Result<Script, String> {
        let list: Vec<serde_json::Value> =
            serde_json::from_str(text).map_err(|e| format!("is not a list of actions: {e}"))?;
        let mut actions: Vec<Timed> = Vec::new();
        for (i, value) in list.into_iter().enumerate() {
            let n = i + 1;
            let parts = value.as_object().filter(|o| o.len() == 2).and_then(|o| Some((o.get("t")?.as_f64()?, o)));
            let Some((t, object)) = parts else {
                return Err(format!("action {n}: expected t, in seconds, and one thing to do"));
            };
            let what = object.iter().filter(|(key, _)| *key != "t").map(|(key, v)| (key.clone(), v.clone())).collect();
            let action = serde_json::from_value(serde_json::Value::Object(what));
            let action = Timed { t, action: action.map_err(|e| format!("action {n}: {e}"))? };
            if !(action.t >= actions.last().map_or(0.0, |a| a.t) && action.t <= 1e5) {
                return Err(format!("action {n}, t: {} is not in order, or not within 0 to 100000 s", action.t));
            }
            actions.push(action);
        }
        Ok(Script { actions, next: 0, frames: 0 })
    }

    /// The next action that is due; `None` until the next frame.
    pub fn due(&mut self) -> Option<Action> {
        let action = self.actions.get(self.next)?;
        // A frame's time, not a running sum: that a time is met does not hang on rounding.
        if action.t > self.frames as f64 * STEP + 1e-9 {
            return None;
        }
        self.next += 1;
        Some(action.action.clone())
    }

    /// A frame was drawn.
    pub fn frame(&mut self) {
        self.frames += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn script_actions_fall_due_in_frames() {
        let text =
            r#"[{"t":0,"press":"KeyW"},{"t":0.1,"release":"KeyW"},{"t":0.1,"resize":[64,48]},{"t":1,"quit":{}}]"#;
        let mut script = Script::parse(text).unwrap();
        let mut done = Vec::new();
        for frame in 0..40 {
            while let Some(action) = script.due() {
                done.push((frame, action));
            }
            script.frame();
        }
        let key = || "KeyW".to_owned();
        let expected = [
            (0, Action::Press(key())),
            (3, Action::Release(key())),
            (3, Action::Resize([64, 48])),
            (30, Action::Quit {}),
        ];
        assert_eq!(done, expected);
    }

    #[test]
    fn script_errors_name_the_action() {
        for (text, error) in [
            ("{}", "is not a list of actions"),
            ("[3]", "action 1: expected t, in seconds, and one thing to do"),
            (r#"[{"t":0}]"#, "action 1: expected t, in seconds, and one thing to do"),
            (r#"[{"t":0,"fly":1}]"#, "action 1: unknown variant `fly`, expected one of `press`, `release`"),
            (r#"[{"t":0,"wheel":"x"}]"#, "action 1: "),
            (r#"[{"t":0,"wheel":1},{"t":-1,"wheel":1}]"#, "action 2, t: -1 is not in order"),
        ] {
            let e = Script::parse(text).unwrap_err();
            assert!(e.starts_with(error), "{text}: {e}");
        }
    }
}
