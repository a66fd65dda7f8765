//! Threads that bring tiles while frames are drawn: what is wanted now before what may be wanted soon, and nothing that
//! nobody wants any more.

use std::collections::{HashSet, VecDeque};
use std::sync::{Arc, Condvar, Mutex};
use std::time::Duration;

use planecast_encoder::{TileKey, TileSource};

use crate::Result;
use crate::clock::Instant;
use crate::world::pager::Tile;

/// Tiles that are unpacked and wait to be taken, at most.
const READY: usize = 64;

type Answer = (TileKey, Result<Option<Tile>>);

#[derive(Default)]
struct State {
    now: VecDeque<TileKey>,
    later: VecDeque<TileKey>,
    flying: HashSet<TileKey>,
    ready: VecDeque<Answer>,
    /// Whether tiles are to be heights.
    heights: bool,
    /// Answers to what was asked before are nobody's.
    era: u64,
    ends: bool,
}

struct Shared {
    source: Arc<dyn TileSource>,
    state: Mutex<State>,
    /// Something to do, or room for what is done.
    work: Condvar,
    /// Something is ready.
    ready: Condvar,
}

/// Threads that bring tiles, and so how many tiles are on their way at once.
pub fn threads() -> usize {
    // One is left for the frame, and files that answer late keep a few waiting.
    std::thread::available_parallelism().map_or(2, |n| n.get().saturating_sub(1)).clamp(2, 16)
}

/// Brings tiles of a source. Its threads begin with the first that is asked for.
pub struct Fetcher {
    shared: Arc<Shared>,
    started: bool,
}

impl Fetcher {
    pub fn new(source: Arc<dyn TileSource>) -> Fetcher {
        let state = Mutex::new(State::default());
        let shared = Shared { source, state, work: Condvar::new(), ready: Condvar::new() };
        Fetcher { shared: Arc::new(shared), started: false }
    }

    fn start(&mut self) {
        if std::mem::replace(&mut self.started, true) {
            return;
        }
        for _ in 0..threads() {
            let shared = Arc::clone(&self.shared);
            std::thread::spawn(move || work(&shared));
        }
    }

    /// Asks for these tiles, the first ones first, and for none that was asked for before and is not among them.
    pub fn now(&mut self, keys: &[TileKey], heights: bool) {
        self.ask(keys, heights, |state| &mut state.now);
    }

    /// The same for tiles that come when no others are asked for.
    pub fn later(&mut self, keys: &[TileKey], heights: bool) {
        self.ask(keys, heights, |state| &mut state.later);
    }

    fn ask(&mut self, keys: &[TileKey], heights: bool, queue: fn(&mut State) -> &mut VecDeque<TileKey>) {
        if keys.is_empty() && !self.started {
            return;
        }
        self.start();
        let mut state = self.shared.state.lock().expect("no worker panics with it");
        state.heights = heights;
        let there: HashSet<TileKey> = state.ready.iter().map(|(key, _)| *key).collect();
        let absent = keys.iter().filter(|key| !state.flying.contains(key) && !there.contains(key)).copied().collect();
        *queue(&mut state) = absent;
        drop(state);
        self.shared.work.notify_all();
    }

    /// A tile that has come, or why it has not; waits for one for so many milliseconds at most, and not where none is asked for.
    pub fn next(&mut self, patience_ms: f64) -> Option<Answer> {
        let start = Instant::now();
        let mut state = self.shared.state.lock().expect("no worker panics with it");
        loop {
            if let Some(answer) = state.ready.pop_front() {
                self.shared.work.notify_one();
                return Some(answer);
            }
            let left = patience_ms - start.elapsed().as_secs_f64() * 1e3;
            if left <= 0.0 || (state.flying.is_empty() && state.now.is_empty()) {
                return None;
            }
            // As long as a clock can say.
            let left = Duration::from_secs_f64((left / 1e3).min(1e6));
            (state, _) = self.shared.ready.wait_timeout(state, left).expect("no worker panics with it");
        }
    }

    /// Forgets all that was asked for.
    pub fn restart(&mut self) {
        let mut state = self.shared.state.lock().expect("no worker panics with it");
        state.era += 1;
        state.now.clear();
        state.later.clear();
        state.ready.clear();
        state.flying.clear();
    }
}

impl Drop for Fetcher {
    fn drop(&mut self) {
        if let Ok(mut state) = self.shared.state.lock() {
            state.ends = true;
        }
        self.shared.work.notify_all();
    }
}

fn work(shared: &Shared) {
    let mut state = shared.state.lock().expect("no worker panics with it");
    loop {
        if state.ends {
            return;
        }
        let room = state.ready.len() < READY;
        let next = if room { state.now.pop_front().or_else(|| state.later.pop_front()) } else { None };
        let Some(key) = next else {
            state = shared.work.wait(state).expect("no worker panics with it");
            continue;
        };
        state.flying.insert(key);
        let (era, heights) = (state.era, state.heights);
        drop(state);
        // What a source panics about is a fault of one tile.
        let read = std::panic::AssertUnwindSafe(|| Tile::read(&*shared.source, key, heights));
        let tile = std::panic::catch_unwind(read).unwrap_or_else(|_| {
            let TileKey { level, x, z } = key;
            let name = shared.source.name();
            Err(crate::Error::Limit(format!("{name}: tile ({x}, {z}) of level {level} could not be made")))
        });
        state = shared.state.lock().expect("no worker panics with it");
        if era == state.era {
            state.flying.remove(&key);
            state.ready.push_back((key, tile));
            shared.ready.notify_one();
        }
    }
}
