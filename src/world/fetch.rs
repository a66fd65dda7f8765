//! Threads that bring tiles while frames are drawn: what is wanted now before what may be wanted soon, and nothing that
//! nobody wants any more.
//!
//! Each tile is in one [`State`]. Only what is not [`State::Absent`] is kept, and all of it in one place, [`Requests`]: so no
//! tile is asked for twice, whatever the tier.
//!
//! ```text
//!            asked for           a worker takes it           it is made, or cannot be         taken
//!   Absent ────────────▶ Queued ──────────────────▶ Producing ───────────────────────▶ Ready ───────▶ Absent
//!      ◀──────────────────┘  ▲                                                           │ an error
//!      asked for no longer   └─────────────────────── Failed ◀───────────────────────────┘
//!                                    asked for again
//! ```

use std::collections::{HashMap, HashSet, VecDeque};
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::time::Duration;

use planecast_encoder::{TileKey, TileSource};

use crate::Result;
use crate::clock::Clock;
use crate::world::pager::Tile;
use crate::world::parcel::{Parcels, unpack};

/// Tiles that are unpacked and wait to be taken, at most.
const READY: usize = 64;

/// Milliseconds until a tile that could not be had is asked for again; each time twice as many, at most [`LAST_BREAK`].
const FIRST_BREAK: f64 = 500.0;
const LAST_BREAK: f64 = 30_000.0;

/// What a request for a tile came to; `None` where it is to be heights and is not.
pub type Answer = (TileKey, Result<Option<Tile>>);

/// Who waits for a tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tier {
    /// The frame that is drawn.
    Now,
    /// One that follows. Comes when nothing is asked for now.
    Later,
}

/// Where a tile stands on its way from the source to the tables.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum State {
    /// Nobody asks for it, or it was taken.
    #[default]
    Absent,
    Queued(Tier),
    /// A worker is at it. It will be ready whether anybody wants it then or not.
    Producing,
    /// Made, or known to fail, and not taken yet.
    Ready,
    /// Could not be had when it was asked for last.
    Failed,
}

#[derive(Default)]
struct Request {
    state: State,
    /// How often in a row it could not be had, and until when it is better not asked for again.
    tries: u32,
    again_ms: f64,
}

/// A tile that a worker has taken on.
pub struct Job {
    pub key: TileKey,
    /// Whether it is to be heights.
    pub heights: bool,
    era: u64,
}

/// All that was asked for.
#[derive(Default)]
struct Requests {
    of: HashMap<TileKey, Request>,
    /// Those that are queued, by tier. The later ones have also such as are asked for now since; those are passed over.
    now: VecDeque<TileKey>,
    later: VecDeque<TileKey>,
    producing: usize,
    ready: VecDeque<Answer>,
    /// Whether tiles are to be heights.
    heights: bool,
    /// Answers to what was asked before are nobody's.
    era: u64,
    ends: bool,
}

impl Requests {
    fn state(&self, key: TileKey) -> State {
        self.of.get(&key).map_or(State::Absent, |request| request.state)
    }

    fn queue(&mut self, tier: Tier) -> &mut VecDeque<TileKey> {
        match tier {
            Tier::Now => &mut self.now,
            Tier::Later => &mut self.later,
        }
    }

    /// Nobody is at it any more; what is known of its failures stays.
    fn rest(&mut self, key: TileKey) {
        let Some(request) = self.of.get_mut(&key) else { return };
        request.state = State::Failed;
        if request.tries == 0 {
            self.of.remove(&key);
        }
    }

    /// Queues these, the first ones first, instead of what is queued in that tier.
    fn ask(&mut self, tier: Tier, keys: &[TileKey]) {
        for key in std::mem::take(self.queue(tier)) {
            if self.state(key) == State::Queued(tier) {
                self.rest(key);
            }
        }
        keys.iter().for_each(|&key| self.add(tier, key));
    }

    /// Queues one more, unless it is on its way already.
    fn add(&mut self, tier: Tier, key: TileKey) {
        let request = self.of.entry(key).or_default();
        match (request.state, tier) {
            (State::Absent | State::Failed, _) | (State::Queued(Tier::Later), Tier::Now) => {
                request.state = State::Queued(tier);
                self.queue(tier).push_back(key);
            }
            (State::Queued(_) | State::Producing | State::Ready, _) => {}
        }
    }

    /// The next for a worker, as long as there is room for what is made.
    fn take(&mut self) -> Option<Job> {
        if self.ready.len() >= READY {
            return None;
        }
        let key = match self.now.pop_front() {
            Some(key) => key,
            None => loop {
                let key = self.later.pop_front()?;
                if self.state(key) == State::Queued(Tier::Later) {
                    break key;
                }
            },
        };
        self.of.entry(key).or_default().state = State::Producing;
        self.producing += 1;
        Some(Job { key, heights: self.heights, era: self.era })
    }

    /// What came of a job.
    fn answer(&mut self, job: &Job, tile: Result<Option<Tile>>) {
        if job.era == self.era {
            self.producing -= 1;
            self.of.entry(job.key).or_default().state = State::Ready;
            self.ready.push_back((job.key, tile));
        }
    }

    /// An answer, for whoever asked.
    fn next(&mut self, now_ms: f64) -> Option<Answer> {
        let answer = self.ready.pop_front()?;
        let (key, tile) = &answer;
        if tile.is_ok() {
            self.of.remove(key);
        } else {
            let request = self.of.entry(*key).or_default();
            request.tries += 1;
            request.again_ms = now_ms + (FIRST_BREAK * f64::from(1u32 << (request.tries - 1).min(6))).min(LAST_BREAK);
            request.state = State::Failed;
        }
        Some(answer)
    }

    fn restart(&mut self, heights: bool) {
        self.era += 1;
        self.heights = heights;
        self.now.clear();
        self.later.clear();
        self.ready.clear();
        self.producing = 0;
        self.of.retain(|_, request| {
            request.state = State::Failed;
            request.tries > 0
        });
    }
}

struct Shared {
    source: Arc<dyn TileSource>,
    requests: Mutex<Requests>,
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

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Requests> {
        self.requests.lock().expect("no worker panics with it")
    }
}

/// Brings tiles of a source. Its threads begin with the first that is asked for.
pub struct Fetcher {
    shared: Arc<Shared>,
    clock: Clock,
    started: bool,
    /// Of a world whose tiles others bring: see [`Fetcher::ordered`].
    parcels: Option<Arc<Parcels>>,
    /// Works instead of threads: see [`Fetcher::by_hand`].
    #[cfg(test)]
    step: Option<Step>,
}

impl Fetcher {
    pub fn new(source: Arc<dyn TileSource>, clock: Clock) -> Fetcher {
        let requests = Mutex::default();
        let shared = Arc::new(Shared { source, requests, work: Condvar::new(), ready: Condvar::new() });
        Fetcher {
            shared,
            clock,
            started: false,
            parcels: None,
            #[cfg(test)]
            step: None,
        }
    }

    /// Without threads: whoever has the orders brings the tiles. Nobody may wait for them.
    pub fn ordered(parcels: Arc<Parcels>, clock: Clock) -> (Fetcher, Orders) {
        let mut fetcher = Fetcher::new(parcels.clone(), clock);
        (fetcher.started, fetcher.parcels) = (true, Some(parcels));
        let orders = Orders { shared: Arc::clone(&fetcher.shared), out: HashMap::new(), n: 0 };
        (fetcher, orders)
    }

    /// A tile that stays, at once.
    pub fn read(&self, key: TileKey, heights: bool) -> Result<Option<Tile>> {
        match &self.parcels {
            Some(parcels) => parcels.coarse(key, heights),
            None => Tile::read(&*self.shared.source, key, heights),
        }
    }

    pub fn source(&self) -> &Arc<dyn TileSource> {
        &self.shared.source
    }

    pub fn clock(&self) -> &Clock {
        &self.clock
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

    /// Asks for these tiles, the first ones first, and for none that was asked for in that tier before and is not among them.
    pub fn ask(&mut self, tier: Tier, keys: &[TileKey]) {
        if keys.is_empty() && !self.started {
            return;
        }
        self.start();
        self.shared.lock().ask(tier, keys);
        self.shared.work.notify_all();
    }

    /// Asks once more for a tile that could not be had, after all others that are asked for now.
    pub fn retry(&mut self, key: TileKey) {
        self.shared.lock().add(Tier::Now, key);
        self.shared.work.notify_one();
    }

    /// Tiles that could not be had lately: to ask for them again is too early.
    pub fn put_off(&self) -> HashSet<TileKey> {
        let now_ms = self.clock.ms();
        let requests = self.shared.lock();
        let put_off = requests.of.iter().filter(|(_, request)| request.again_ms > now_ms);
        put_off.map(|(&key, _)| key).collect()
    }

    /// A tile that has come, or why it has not; waits for one for so many milliseconds at most, and not where none is asked for.
    pub fn next(&mut self, patience_ms: f64) -> Option<Answer> {
        let end = self.clock.ms() + patience_ms;
        let mut requests = self.shared.lock();
        loop {
            let now_ms = self.clock.ms();
            if let Some(answer) = requests.next(now_ms) {
                self.shared.work.notify_one();
                return Some(answer);
            }
            if now_ms >= end || (requests.producing == 0 && requests.now.is_empty()) {
                return None;
            }
            #[cfg(test)]
            if let Some(step) = &mut self.step {
                drop(requests);
                step(&Hand(Arc::clone(&self.shared)));
                requests = self.shared.lock();
                continue;
            }
            // As long as a clock can say.
            let left = Duration::from_secs_f64(((end - now_ms) / 1e3).min(1e6));
            (requests, _) = self.shared.ready.wait_timeout(requests, left).expect("no worker panics with it");
        }
    }

    /// Forgets all that was asked for, but not what failed. What is asked for from now on is to be heights, or runs.
    pub fn restart(&mut self, heights: bool) {
        self.shared.lock().restart(heights);
    }
}

impl Drop for Fetcher {
    fn drop(&mut self) {
        if let Ok(mut requests) = self.shared.requests.lock() {
            requests.ends = true;
        }
        self.shared.work.notify_all();
    }
}

fn work(shared: &Shared) {
    let mut requests = shared.lock();
    while !requests.ends {
        let Some(job) = requests.take() else {
            requests = shared.work.wait(requests).expect("no worker panics with it");
            continue;
        };
        drop(requests);
        let tile = Tile::read(&*shared.source, job.key, job.heights);
        requests = shared.lock();
        requests.answer(&job, tile);
        shared.ready.notify_one();
    }
}

/// Tiles that somebody else makes: a page's workers.
pub struct Orders {
    shared: Arc<Shared>,
    /// Those that are on their way, by number.
    out: HashMap<u32, Job>,
    n: u32,
}

/// A tile to be made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Order {
    pub number: u32,
    pub key: TileKey,
    /// Whether it is to be heights.
    pub heights: bool,
}

impl Orders {
    /// The tile that is wanted most of those that are not on their way; `None` where none is, or too many wait to be taken.
    pub fn take(&mut self) -> Option<Order> {
        let job = self.shared.lock().take()?;
        self.n += 1;
        let order = Order { number: self.n, key: job.key, heights: job.heights };
        self.out.insert(self.n, job);
        Some(order)
    }

    /// What came of an order: a parcel, or why there is none. Numbers that are not out are passed over.
    pub fn deliver(&mut self, number: u32, parcel: Result<&[u8]>) {
        if let Some(job) = self.out.remove(&number) {
            let tile = parcel.and_then(|bytes| unpack(&self.shared.source.name(), bytes));
            self.shared.lock().answer(&job, tile);
        }
    }

    /// How many are on their way.
    pub fn out(&self) -> usize {
        self.out.len()
    }
}

/// What a test does while a frame waits for its tiles: it answers some, or lets the clock go on.
#[cfg(test)]
pub type Step = Box<dyn FnMut(&Hand) + Send + Sync>;

/// Does by hand what threads do: a test decides which jobs are taken, when they are answered and in which order.
#[cfg(test)]
#[derive(Clone)]
pub struct Hand(Arc<Shared>);

#[cfg(test)]
impl Fetcher {
    /// Without threads. Whoever waits has `step` work instead.
    pub fn by_hand(source: Arc<dyn TileSource>, clock: Clock, step: Step) -> (Fetcher, Hand) {
        let mut fetcher = Fetcher::new(source, clock);
        (fetcher.started, fetcher.step) = (true, Some(step));
        let hand = Hand(Arc::clone(&fetcher.shared));
        (fetcher, hand)
    }
}

#[cfg(test)]
impl Hand {
    /// The job that a worker would take next.
    pub fn take(&self) -> Option<Job> {
        self.0.lock().take()
    }

    /// Makes its tile and answers.
    pub fn finish(&self, job: &Job) {
        let tile = Tile::read(&*self.0.source, job.key, job.heights);
        self.0.lock().answer(job, tile);
    }

    pub fn state(&self, key: TileKey) -> State {
        self.0.lock().state(key)
    }

    /// All that is queued in a tier, in the order in which it will be taken.
    pub fn queued(&self, tier: Tier) -> Vec<TileKey> {
        let mut requests = self.0.lock();
        let keys: Vec<TileKey> = requests.queue(tier).iter().copied().collect();
        keys.into_iter().filter(|&key| requests.state(key) == State::Queued(tier)).collect()
    }

    /// Whether answers to a job are still anybody's.
    pub fn is_of_now(&self, job: &Job) -> bool {
        job.era == self.0.lock().era
    }
}

#[cfg(test)]
impl Hand {
    /// How often in a row a tile could not be had, and until when it is put off.
    pub fn failed(&self, key: TileKey) -> (u32, f64) {
        self.0.lock().of.get(&key).map_or((0, 0.0), |request| (request.tries, request.again_ms))
    }
}

#[cfg(test)]
mod tests {
    use planecast_encoder::{ColorMode, Columns, Error, Level};

    use super::*;

    /// Empty tiles in a row, of which the thirteenth cannot be had and the fourteenth panics.
    struct Row;

    impl TileSource for Row {
        fn name(&self) -> String {
            "row".into()
        }

        fn dims(&self) -> [u32; 3] {
            [256 * 200, 4, 1]
        }

        fn color(&self) -> ColorMode {
            ColorMode::None
        }

        fn heights(&self, _: u32) -> [u32; 2] {
            [0, 4]
        }

        fn is_empty(&self, _: TileKey) -> bool {
            false
        }

        fn tile(&self, key: TileKey) -> planecast_encoder::Result<Level> {
            match key.x {
                13 => Err(Error::Limit("tile 13 is out".into())),
                // Without the message that a panic prints.
                14 => std::panic::resume_unwind(Box::new("a fault of the source")),
                _ => {
                    let solid = Columns::empty(256, 4, 1);
                    Ok(Level { solid, exposed: None, colors: Vec::new(), matter: None })
                }
            }
        }
    }

    fn tile(x: u32) -> TileKey {
        TileKey { level: 0, x, z: 0 }
    }

    fn tiles(xs: impl IntoIterator<Item = u32>) -> Vec<TileKey> {
        xs.into_iter().map(tile).collect()
    }

    fn by_hand() -> (Fetcher, Hand, Clock) {
        let clock = Clock::told();
        let (fetcher, hand) = Fetcher::by_hand(Arc::new(Row), clock.clone(), Box::new(|_| ()));
        (fetcher, hand, clock)
    }

    #[test]
    fn a_tile_goes_from_state_to_state() {
        let (mut fetcher, hand, clock) = by_hand();
        assert_eq!(hand.state(tile(1)), State::Absent);
        fetcher.ask(Tier::Later, &tiles([1, 2]));
        assert_eq!(hand.state(tile(1)), State::Queued(Tier::Later));
        // Who asks for it now has it before, and once.
        fetcher.ask(Tier::Now, &tiles([3, 1]));
        assert_eq!((hand.state(tile(1)), hand.queued(Tier::Later)), (State::Queued(Tier::Now), tiles([2])));
        // And who asks for it later does not have it come later.
        fetcher.ask(Tier::Later, &tiles([1, 2]));
        assert_eq!(hand.queued(Tier::Now), tiles([3, 1]));
        // What is not asked for any more is not made, unless it is being made.
        let job = hand.take().unwrap();
        assert_eq!((job.key, hand.state(tile(3))), (tile(3), State::Producing));
        fetcher.ask(Tier::Now, &tiles([4]));
        assert_eq!([1, 3, 4].map(|x| hand.state(tile(x))), [State::Absent, State::Producing, State::Queued(Tier::Now)]);
        // Nor twice.
        fetcher.ask(Tier::Now, &tiles([3, 4]));
        assert_eq!(hand.queued(Tier::Now), tiles([4]));
        hand.finish(&job);
        assert_eq!(hand.state(tile(3)), State::Ready);
        fetcher.ask(Tier::Now, &tiles([3, 4]));
        assert_eq!(hand.queued(Tier::Now), tiles([4]));
        let (key, made) = fetcher.next(0.0).unwrap();
        assert_eq!((key, made.is_ok(), hand.state(key)), (tile(3), true, State::Absent));
        let order: Vec<TileKey> = std::iter::from_fn(|| hand.take()).map(|job| job.key).collect();
        assert_eq!(order, tiles([4, 2]));
        // Those that are being made when all begins anew are nobody's.
        fetcher.restart(true);
        assert_eq!([2, 4].map(|x| hand.state(tile(x))), [State::Absent; 2]);
        assert!(fetcher.next(f64::INFINITY).is_none(), "there is nothing to wait for");
        assert_eq!(clock.ms(), 0.0);
    }

    #[test]
    fn a_tile_that_fails_is_put_off_twice_as_long_each_time() {
        let (mut fetcher, hand, clock) = by_hand();
        let fail = |fetcher: &mut Fetcher| {
            fetcher.ask(Tier::Now, &tiles([13]));
            hand.finish(&hand.take().unwrap());
            assert!(fetcher.next(0.0).unwrap().1.is_err());
            assert_eq!(hand.state(tile(13)), State::Failed);
            let mut waited = 0;
            while fetcher.put_off().contains(&tile(13)) {
                clock.advance(1);
                waited += 1;
            }
            waited
        };
        let waited: Vec<i32> = (0..9).map(|_| fail(&mut fetcher)).collect();
        assert_eq!(waited, [500, 1000, 2000, 4000, 8000, 16_000, 30_000, 30_000, 30_000]);
        // What is known of it outlasts a queue, and tables.
        fetcher.ask(Tier::Later, &tiles([13]));
        fetcher.ask(Tier::Later, &[]);
        assert_eq!(hand.state(tile(13)), State::Failed);
        fetcher.restart(false);
        assert_eq!((hand.state(tile(13)), fail(&mut fetcher)), (State::Failed, 30_000));
    }

    #[test]
    fn no_more_is_made_than_there_is_room_for() {
        let (mut fetcher, hand, _) = by_hand();
        fetcher.ask(Tier::Now, &tiles(20..100));
        let mut made = 0;
        while let Some(job) = hand.take() {
            hand.finish(&job);
            made += 1;
        }
        assert_eq!(made, READY);
        assert!(fetcher.next(0.0).is_some() && hand.take().is_some() && fetcher.next(0.0).is_some());
    }

    #[test]
    fn threads_bring_all_that_is_asked_for_and_say_what_cannot_be_had() {
        let mut fetcher = Fetcher::new(Arc::new(Row), Clock::start());
        fetcher.ask(Tier::Now, &tiles(0..150));
        let mut came = HashMap::new();
        while let Some((key, tile)) = fetcher.next(f64::INFINITY) {
            assert!(came.insert(key.x, tile.map(|_| ()).map_err(|e| e.to_string())).is_none());
        }
        assert_eq!(came.len(), 150);
        let failed: Vec<(u32, String)> = (0..150).filter_map(|x| Some((x, came[&x].as_ref().err()?.clone()))).collect();
        let what = "row: tile (14, 0) of level 0 could not be made";
        assert_eq!(failed, [(13, "tile 13 is out".into()), (14, what.into())]);
    }
}
