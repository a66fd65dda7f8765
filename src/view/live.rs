//! A volume at other thresholds while a slider moves: worlds made in memory from its values, coarse first.
//!
//! A thread of its own holds the values and halves of them ([`planecast_encoder::model::grid`]). Of what is wanted it makes the finest world that
//! takes no longer than `BUDGET`, as far as the ones before tell; once nothing new has been wanted for `REST`, finer ones, up to all
//! voxels.

use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::{Duration, Instant};

use planecast_encoder::model::grid::Grid;
use planecast_encoder::source;

use crate::Result;
use crate::world::{OpenOptions, World};

/// Milliseconds that a world may take while more are wanted: 25 a second leave time to draw them.
const BUDGET: f64 = 40.0;

const REST: Duration = Duration::from_millis(120);

/// Voxels that are held: 1 GiB of values.
const MOST: u64 = 1 << 28;

/// Coarser than so many voxels a side is of no use.
const LEAST_SIDE: u32 = 48;

/// Milliseconds a voxel, before anything was measured.
const GUESS: f64 = 6e-6;

/// A world at a threshold.
pub struct Made {
    pub world: Arc<World>,
    /// How often it was halved.
    pub level: u32,
    pub threshold: f64,
    /// Milliseconds that it took.
    pub ms: f64,
}

enum Said {
    Values(Arc<Grid>),
    /// Too many of them, or none.
    NoValues,
    Made(Result<Made>),
}

/// The thread, as it is spoken to.
pub struct Live {
    wanted: Sender<f64>,
    said: Receiver<Said>,
    pub grid: Option<Arc<Grid>>,
    /// When worlds came, within the last second.
    came: Vec<Instant>,
    /// A world that was wanted is on its way.
    pub waits: bool,
    /// The values are read, or cannot be held.
    pub read: bool,
}

impl Live {
    /// Reads the values of `path` as `how` says.
    pub fn begin(path: &Path, how: &OpenOptions) -> Live {
        let (wanted, wants) = channel();
        let (says, said) = channel();
        let (path, how) = (path.to_owned(), how.clone());
        std::thread::spawn(move || {
            let values = source::open_pieces(&path, &how.read).and_then(|pieces| pieces.grid(MOST));
            match values {
                Ok(Some(grid)) => work(&path, Arc::new(grid), &wants, &says),
                // What is wrong with the file is said where it is opened. Nobody may listen any more.
                _ => drop(says.send(Said::NoValues)),
            }
        });
        Live { wanted, said, grid: None, came: Vec::new(), waits: false, read: false }
    }

    /// Wants a world at a threshold; whether there are values to make it of.
    pub fn want(&mut self, threshold: f64) -> bool {
        self.waits = self.grid.is_some() && self.wanted.send(threshold).is_ok();
        self.waits
    }

    /// The latest world that was made; None where none came.
    pub fn poll(&mut self) -> Option<Result<Made>> {
        let mut latest = None;
        while let Ok(said) = self.said.try_recv() {
            match said {
                Said::Values(grid) => (self.grid, self.read) = (Some(grid), true),
                Said::NoValues => (self.waits, self.read) = (false, true),
                Said::Made(made) => {
                    self.came.push(Instant::now());
                    self.waits = made.as_ref().is_ok_and(|made| made.level > 0);
                    latest = Some(made);
                }
            }
        }
        latest
    }

    /// Worlds that came within the last second.
    pub fn rate(&mut self) -> usize {
        let now = Instant::now();
        self.came.retain(|t| now - *t < Duration::from_secs(1));
        self.came.len()
    }
}

/// Levels of a grid, each half of the one before.
pub fn levels(grid: Arc<Grid>) -> Vec<Arc<Grid>> {
    let mut levels = vec![grid];
    while let Some(last) = levels.last().filter(|g| g.dims().iter().all(|&n| n >= 2 * LEAST_SIDE)) {
        let half = Arc::new(last.halved());
        levels.push(half);
    }
    levels
}

/// The world at a threshold.
pub fn world(path: &Path, grid: &Arc<Grid>, threshold: f64) -> Result<World> {
    World::of_input(path, grid.input(threshold as f32))
}

/// The finest level that takes no longer than the budget, at so many milliseconds a voxel.
fn affordable(levels: &[Arc<Grid>], ms_a_voxel: f64) -> usize {
    let ms = |g: &Arc<Grid>| g.dims().iter().map(|&n| f64::from(n)).product::<f64>() * ms_a_voxel;
    levels.iter().position(|g| ms(g) <= BUDGET).unwrap_or(levels.len() - 1)
}

fn work(path: &Path, grid: Arc<Grid>, wants: &Receiver<f64>, says: &Sender<Said>) {
    let levels = levels(grid.clone());
    let mut ms_a_voxel = GUESS;
    let mut next = says.send(Said::Values(grid)).ok().and_then(|()| wants.recv().ok());
    while let Some(mut threshold) = next {
        let mut level = affordable(&levels, ms_a_voxel);
        next = loop {
            while let Ok(newer) = wants.try_recv() {
                (threshold, level) = (newer, affordable(&levels, ms_a_voxel));
            }
            let began = Instant::now();
            let made = world(path, &levels[level], threshold);
            let ms = began.elapsed().as_secs_f64() * 1e3;
            let voxels: f64 = levels[level].dims().iter().map(|&n| f64::from(n)).product();
            ms_a_voxel += 0.5 * (ms / voxels - ms_a_voxel);
            let made = made.map(|world| Made { world: Arc::new(world), level: level as u32, threshold, ms });
            if says.send(Said::Made(made)).is_err() {
                return;
            }
            if level == 0 {
                break wants.recv().ok();
            }
            match wants.recv_timeout(REST) {
                Ok(newer) => break Some(newer),
                Err(RecvTimeoutError::Timeout) => level -= 1,
                Err(RecvTimeoutError::Disconnected) => return,
            }
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use planecast_encoder::source::{Dtype, ReadOptions};

    #[test]
    fn other_thresholds_are_made_coarse_first_and_end_as_encode_makes_them() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("ball.raw");
        const N: u32 = 100;
        let value = |i: u32| {
            let at = [i % N, i / N % N, i / N / N].map(|v| f64::from(v) - 49.5);
            (200.0 - 3.0 * at.iter().map(|v| v * v).sum::<f64>().sqrt()).max(0.0) as u8
        };
        std::fs::write(&path, (0..N * N * N).map(value).collect::<Vec<u8>>()).unwrap();
        let read =
            ReadOptions { dims: Some([100; 3]), dtype: Some(Dtype::U8), iso: Some(10.0), ..ReadOptions::default() };
        let how = OpenOptions { read, ..OpenOptions::default() };
        let mut live = Live::begin(&path, &how);
        let wait = |live: &mut Live, until: &dyn Fn(&Live, &Option<Result<Made>>) -> bool| loop {
            let made = live.poll();
            if until(live, &made) {
                return made;
            }
            std::thread::sleep(Duration::from_millis(2));
        };
        assert!(!live.want(120.0), "no values yet");
        wait(&mut live, &|live, _| live.grid.is_some());
        assert!(live.want(120.0));
        let last = wait(&mut live, &|_, made| matches!(made, Some(Ok(made)) if made.level == 0)).unwrap().unwrap();
        let read = ReadOptions { iso: Some(120.0), ..how.read };
        let encoded = World::open_with(&path, &OpenOptions { read, ..how }, &Default::default()).unwrap();
        assert!(
            last.threshold == 120.0
                && last.world.scene.levels[0].solid == encoded.scene.levels[0].solid
                && !live.waits
                && live.rate() > 0
        );
        let levels = levels(live.grid.clone().unwrap());
        assert_eq!(levels.iter().map(|g| g.dims()[0]).collect::<Vec<_>>(), [100, 50]);
        assert_eq!([1e-9, 1e-4, 1.0].map(|ms| affordable(&levels, ms)), [0, 1, 1]);
    }
}
