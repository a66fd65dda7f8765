//! Holding a frame rate: fewer pixels and planes where frames take too long, all of them again where there is time.
//!
//! The rungs are those of the report in `benches/runs/2026-11-22-report`, where pixels are given up before planes: 75 and
//! 50 % of the resolution save 43 and 71 % of a frame's time on two cores, half the planes 9 to 15 %.

use crate::frame::options::Options;
use crate::frame::preset::Preset;

/// One way to draw: a share of the window's pixels a side, and a preset, or the options as they are asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rung {
    pub scale: f64,
    pub preset: Option<Preset>,
    /// Time against that of the first rung, as measured.
    cost: f64,
}

/// From what is asked for down to the least.
pub const RUNGS: [Rung; 6] = [
    Rung { scale: 1.0, preset: None, cost: 1.0 },
    Rung { scale: 0.85, preset: None, cost: 0.74 },
    Rung { scale: 0.75, preset: None, cost: 0.57 },
    Rung { scale: 0.5, preset: None, cost: 0.29 },
    Rung { scale: 0.5, preset: Some(Preset::Fast), cost: 0.25 },
    Rung { scale: 0.33, preset: Some(Preset::Fast), cost: 0.12 },
];

/// Frames over the budget, one after the other, before it steps down; frames with time to spare before it steps up.
const PATIENCE_DOWN: u32 = 4;
const PATIENCE_UP: u32 = 45;

/// Share of the budget that a rung above may be expected to take.
const SPARE: f64 = 0.85;

/// Chooses a rung from what frames take.
#[derive(Clone, Debug, PartialEq)]
pub struct Pace {
    budget_ms: f64,
    rung: usize,
    over: u32,
    under: u32,
    /// Milliseconds a frame, smoothed; of the present rung.
    smooth: Option<f64>,
}

impl Pace {
    /// `fps`: frames a second to hold, above 0.
    pub fn new(fps: f64) -> Pace {
        Pace { budget_ms: 1e3 / fps, rung: 0, over: 0, under: 0, smooth: None }
    }

    pub fn budget_ms(&self) -> f64 {
        self.budget_ms
    }

    /// How to draw now.
    pub fn rung(&self) -> Rung {
        RUNGS[self.rung]
    }

    /// A frame took so long, milliseconds. Whether the rung changed.
    pub fn frame(&mut self, ms: f64) -> bool {
        if !ms.is_finite() || ms < 0.0 {
            return false;
        }
        let smooth = self.smooth.map_or(ms, |s| s + 0.25 * (ms - s));
        self.smooth = Some(smooth);
        let cost = RUNGS[self.rung].cost;
        self.over = if smooth > 1.02 * self.budget_ms { self.over + 1 } else { 0 };
        let above = self.rung.checked_sub(1).map(|r| smooth * RUNGS[r].cost / cost);
        self.under = if above.is_some_and(|ms| ms < SPARE * self.budget_ms) { self.under + 1 } else { 0 };
        let rung = if self.over >= PATIENCE_DOWN {
            // At once to where it should fit.
            let fits = |r: &Rung| smooth * r.cost / cost <= self.budget_ms;
            (self.rung + 1..RUNGS.len()).find(|&r| fits(&RUNGS[r])).unwrap_or(RUNGS.len() - 1)
        } else if self.under >= PATIENCE_UP {
            self.rung - 1
        } else {
            self.rung
        };
        let changed = rung != self.rung;
        if changed {
            *self = Pace { rung, ..Pace::new(1e3 / self.budget_ms) };
        } else if self.over >= PATIENCE_DOWN {
            self.over = 0;
        }
        changed
    }

    /// Pixels to draw for a window of so many.
    pub fn size(&self, [width, height]: [u32; 2]) -> [u32; 2] {
        [width, height].map(|n| ((f64::from(n) * self.rung().scale).round() as u32).max(1))
    }

    /// Options to draw with where these are asked for.
    pub fn options(&self, asked: Options) -> Options {
        self.rung().preset.map_or(asked, |p| p.options(asked))
    }

    /// What is in force, for the screen.
    pub fn describe(&self) -> String {
        let Rung { scale, preset, .. } = self.rung();
        let preset = preset.map_or(String::new(), |p| format!(", preset {}", p.name()));
        format!("holding {:.0} fps: {:.0} % of the resolution{preset}", 1e3 / self.budget_ms, scale * 100.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames until nothing changes, on a machine that takes `full` milliseconds for all pixels.
    fn settle(pace: &mut Pace, full: f64) -> (usize, u32) {
        let mut changes = 0;
        for _ in 0..2000 {
            let ms = full * RUNGS[pace.rung].cost;
            changes += u32::from(pace.frame(ms));
        }
        (pace.rung, changes)
    }

    #[test]
    fn pace_leaves_a_fast_machine_alone() {
        assert_eq!(settle(&mut Pace::new(60.0), 10.0), (0, 0));
    }

    #[test]
    fn pace_steps_down_until_the_budget_holds_and_stays() {
        for (full, rung) in [(20.0, 1), (25.0, 2), (50.0, 3), (60.0, 4), (100.0, 5), (1000.0, 5)] {
            let mut pace = Pace::new(60.0);
            let (at, changes) = settle(&mut pace, full);
            assert_eq!((at, changes), (rung, 1), "{full}");
            assert!(full * RUNGS[at].cost <= pace.budget_ms() || at == RUNGS.len() - 1);
        }
    }

    #[test]
    fn pace_steps_up_again_where_there_is_time() {
        let mut pace = Pace::new(60.0);
        settle(&mut pace, 100.0);
        assert_eq!(settle(&mut pace, 10.0).0, 0);
    }

    #[test]
    fn pace_does_not_heed_one_slow_frame() {
        let mut pace = Pace::new(60.0);
        (0..50).for_each(|_| assert!(!pace.frame(8.0)));
        assert!(!pace.frame(40.0) && !pace.frame(8.0) && !pace.frame(f64::NAN) && pace.rung == 0);
    }

    #[test]
    fn pace_changes_what_it_says_it_changes() {
        let mut pace = Pace::new(30.0);
        settle(&mut pace, 1000.0);
        assert_eq!(pace.size([100, 3]), [33, 1]);
        assert_eq!(pace.options(Options::default()), Preset::Fast.options(Options::default()));
        assert_eq!(pace.describe(), "holding 30 fps: 33 % of the resolution, preset fast");
        assert_eq!(Pace::new(30.0).options(Options::default()), Options::default());
    }
}
