//! A model of the cache, and schedules without a pattern that the pager has to follow by its rules: views that move, jump and
//! grow, tiles that are late, out of order, cannot be had or never come, and a clock that stands still or leaps.

use std::sync::Mutex;

use planecast_encoder::{BuildOptions, Colors, Columns, Input, build};

use super::mock::{Fault, Mock};
use super::*;
use crate::testing::noise;
use crate::world::fetch::{Fetcher, Hand, Job, State};

/// Tiles of level 0, in a row: so many that some share their place in the window, of level 0 and of level 1.
const TILES: u32 = 200;

/// A world's kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Hills(ColorMode),
    Caves(ColorMode),
    /// Said to be heights, and for some tiles it is not so.
    Odd,
}

impl Kind {
    fn scene(self) -> planecast_encoder::Scene {
        let solid = move |x: u32, y: u32, z: u32| {
            let hill = 9 + noise(x / 3, z, 1) % 7 + x / 700;
            // Eight tiles of every 40 are air, and so are those above them. A window away from them there is ground.
            let ground = y < hill && x / TILE / 8 % 5 != 2;
            match self {
                Kind::Hills(_) => ground,
                Kind::Caves(_) => ground && !(y / 3 + x / 5).is_multiple_of(3),
                // So thin that no coarser tile has it.
                Kind::Odd => ground && !(x / TILE % 32 == 12 && y == 5),
            }
        };
        let columns = Columns::from_fn(TILES * TILE - 77, 64, 2, solid);
        let color = match self {
            Kind::Hills(color) | Kind::Caves(color) => color,
            Kind::Odd => ColorMode::Run,
        };
        let of = |x, y, z| noise(x, y, z).to_le_bytes()[..3].try_into().unwrap();
        let colors = if color == ColorMode::None { Colors::None } else { Colors::Function(Box::new(of)) };
        let input = Input { columns, colors, notes: Vec::new() };
        build(input, &BuildOptions { color: Some(color), ..BuildOptions::default() }).unwrap()
    }
}

struct Dice {
    seed: u32,
    thrown: u32,
}

impl Dice {
    fn of(&mut self, n: u32) -> u32 {
        self.thrown += 1;
        noise(self.seed, self.thrown, 77) % n
    }
}

/// How often a tile failed in a row, and until when it is put off: by the rules, not by what the pager says.
type Failures = HashMap<TileKey, (u32, f64)>;

/// What threads would do, in an order that nobody would choose.
struct Workers {
    dice: Dice,
    clock: Clock,
    source: Arc<Mock>,
    flying: Vec<Job>,
    /// Answers that were given: whether it is a tile, and when.
    answers: Vec<(TileKey, bool, f64)>,
    failures: Failures,
    /// What the latest frame may have made, and what may be made ahead.
    now: HashSet<TileKey>,
    later: HashSet<TileKey>,
    /// Whether the frame waits: it takes no time off after a failure.
    waits: bool,
    taken_later: usize,
}

impl Workers {
    fn take(&mut self, hand: &Hand) -> Option<TileKey> {
        let now = hand.queued(Tier::Now);
        let job = hand.take()?;
        let key = job.key;
        match now.first() {
            Some(&first) => assert_eq!(key, first, "what the frame wants comes first"),
            None => self.taken_later += 1,
        }
        let allowed = if now.is_empty() { &self.later } else { &self.now };
        assert!(allowed.contains(&key), "{key:?} is made, and nobody asks for it any more");
        let twice = self.flying.iter().any(|other| other.key == key && hand.is_of_now(other));
        assert!(!twice, "{key:?} is made twice at once");
        let again_ms = self.failures.get(&key).map_or(0.0, |&(_, again_ms)| again_ms);
        assert!(self.waits || again_ms <= self.clock.ms(), "{key:?} is asked for {again_ms} too early");
        assert_eq!(hand.state(key), State::Producing);
        self.flying.push(job);
        Some(key)
    }

    fn finish(&mut self, hand: &Hand, i: usize) {
        let job = self.flying.swap_remove(i);
        if hand.is_of_now(&job) {
            self.answers.push((job.key, self.source.fault(job.key).is_none(), self.clock.ms()));
        }
        hand.finish(&job);
    }

    fn finish_any(&mut self, hand: &Hand) -> bool {
        if self.flying.is_empty() {
            return false;
        }
        let i = self.dice.of(self.flying.len() as u32) as usize;
        self.finish(hand, i);
        true
    }

    /// While a frame waits.
    fn step(&mut self, hand: &Hand) {
        let worked = match self.dice.of(8) {
            0 => false,
            1..5 => self.finish_any(hand) || self.take(hand).is_some(),
            _ => self.take(hand).is_some() || self.finish_any(hand),
        };
        if !worked {
            self.clock.advance(1 + u64::from(self.dice.of(3)));
        }
    }
}

/// A copy of the tables, kept by what the pager says has changed; as a device keeps one.
#[derive(Default)]
struct Copy {
    pages: Vec<Vec<u32>>,
    slots: HashMap<(u32, u32), Vec<u8>>,
}

/// What stands in a slot, and in the parts of the other tables that it has: all of it, or what its first columns have.
fn contents(level: &ResidentLevel, slot: u32, parts: [&Range<u32>; 3], all: bool) -> Vec<u8> {
    let [runs, exposed, colors] = parts.map(|part| part.start as usize..part.end as usize);
    let slot = slot as usize;
    let n = if all { COLUMNS } else { 2 * TILE as usize };
    let (columns, starts) = (slot * COLUMNS..slot * COLUMNS + n, slot * STARTS..slot * STARTS + n);
    let mut out = Vec::new();
    match &level.table {
        Table::Heights(heights) => out.extend(bytemuck::cast_slice(&heights[columns.clone()])),
        Table::Runs { columns: entries, runs: more } => {
            out.extend(bytemuck::cast_slice(&entries[columns.clone()]));
            out.extend(bytemuck::cast_slice(&more[runs]));
        }
    }
    out.extend(bytemuck::cast_slice(&level.blocks[slot * BLOCKS..(slot + 1) * BLOCKS]));
    match &level.paint {
        Paint::None | Paint::Height { .. } => {}
        Paint::Column { colors } => out.extend(bytemuck::cast_slice(&colors[columns])),
        Paint::Run { base, colors: all } => {
            out.extend(bytemuck::cast_slice(&base[columns]));
            out.extend(bytemuck::cast_slice(&all[colors]));
        }
        Paint::Top { starts: of, colors: all } => {
            out.extend(bytemuck::cast_slice(&of[starts]));
            out.extend(bytemuck::cast_slice(&all[colors]));
        }
        Paint::Voxel { base, exposed: all, colors: every } => {
            out.extend(bytemuck::cast_slice(&base[starts]));
            out.extend(bytemuck::cast_slice(&all[exposed]));
            out.extend(bytemuck::cast_slice(&every[colors]));
        }
    }
    out
}

impl Copy {
    fn replay(&mut self, resident: &Resident, changes: &[Change], all: bool) {
        let pages = |l: usize| resident.levels[l].pages.as_ref().unwrap().slots.clone();
        let mut dirty = HashMap::new();
        for change in changes {
            match change {
                Change::All => {
                    self.slots.clear();
                    dirty.clear();
                    self.pages = (0..resident.levels.len()).map(pages).collect();
                }
                Change::Slot { level, slot, runs, exposed, colors } => {
                    dirty.insert((*level, *slot), [runs, exposed, colors]);
                }
                Change::Pages { level } => self.pages[*level as usize] = pages(*level as usize),
            }
        }
        for ((l, slot), parts) in dirty {
            self.slots.insert((l, slot), contents(&resident.levels[l as usize], slot, parts, all));
        }
    }
}

/// A view: tiles about one, on some levels.
#[derive(Clone, Copy, Debug)]
struct View {
    at: u32,
    first: u32,
    radius: u32,
    gaps: u32,
}

/// How often what was to be reached was reached.
#[derive(Clone, Copy, Debug, Default)]
struct Seen {
    resized: u32,
    too_much: u32,
    errors: u32,
    evicted: u32,
    /// Evicted for a tile with the same place in the window.
    displaced: u32,
    stood_in: u32,
    failed: u32,
    put_off: u32,
    ahead: u32,
    between: u32,
    settled: u32,
    without_heights: u32,
}

struct Rig {
    pager: Pager,
    resident: Resident,
    whole: Arc<Resident>,
    source: Arc<Mock>,
    hand: Hand,
    clock: Clock,
    workers: Arc<Mutex<Workers>>,
    copy: Copy,
    /// Whether whole slots are compared.
    all: bool,
    budget: u64,
    /// Frames, and in which of them each tile that is there was wanted last, as far as that can be told from outside.
    frame: u64,
    used: HashMap<TileKey, u64>,
    told: HashSet<String>,
    seen: Seen,
}

/// All that is not empty, by tile.
fn held(pager: &Pager) -> HashMap<TileKey, Slot> {
    let slots = pager.levels.iter().flat_map(|level| level.slots.iter().flatten());
    slots.map(|slot| (slot.key, slot.clone())).collect()
}

impl Rig {
    fn new(source: &Arc<Mock>, whole: &Arc<Resident>, budget: u64, seed: u32) -> Result<Rig> {
        let clock = Clock::told();
        let workers = Arc::new(Mutex::new(Workers {
            dice: Dice { seed, thrown: 0 },
            clock: clock.clone(),
            source: source.clone(),
            flying: Vec::new(),
            answers: Vec::new(),
            failures: HashMap::new(),
            now: HashSet::new(),
            later: HashSet::new(),
            waits: false,
            taken_later: 0,
        }));
        let of_step = workers.clone();
        let step = Box::new(move |hand: &Hand| of_step.lock().unwrap().step(hand));
        let (fetcher, hand) = Fetcher::by_hand(source.clone(), clock.clone(), step);
        let (pager, resident) = Pager::with(fetcher, budget, None)?;
        let mut rig = Rig {
            pager,
            resident,
            whole: whole.clone(),
            source: source.clone(),
            hand,
            clock,
            workers,
            copy: Copy::default(),
            all: seed.is_multiple_of(100),
            budget,
            frame: 0,
            used: HashMap::new(),
            told: HashSet::new(),
            seen: Seen::default(),
        };
        rig.used = held(&rig.pager).into_keys().map(|key| (key, 0)).collect();
        rig.check();
        Ok(rig)
    }

    fn die(&self, n: u32) -> u32 {
        self.workers.lock().unwrap().dice.of(n)
    }

    fn is_pinned(&self, key: TileKey) -> bool {
        self.pager.levels[key.level as usize].pinned
    }

    fn wants(&self, view: View) -> Vec<Wanted> {
        let grids = grids(self.resident.dims);
        let levels = view.first..(view.first + 6).min(grids.len() as u32);
        let of_level = |level: u32| {
            let (middle, last) = (view.at >> level, grids[level as usize].tiles[0] - 1);
            let tiles = middle.saturating_sub(view.radius)..=(middle + view.radius).min(last);
            tiles.map(move |x| Wanted { key: TileKey { level, x, z: 0 }, planes: 1 + noise(view.gaps, level, x) % 50 })
        };
        let mut wants: Vec<Wanted> = levels.flat_map(of_level).filter(|w| w.planes % 5 != 0).collect();
        wants.sort_by_key(|w| (std::cmp::Reverse(w.planes), w.key));
        wants
    }

    /// Wanted tiles, and all that they lie in.
    fn with_ancestors(&self, wants: &[Wanted]) -> HashSet<TileKey> {
        let mut all = HashSet::new();
        for w in wants {
            let mut key = w.key;
            while (key.level as usize) < self.pager.levels.len() {
                all.insert(key);
                key = key.parent();
            }
        }
        all
    }

    fn update(&mut self, wants: &[Wanted], patience: Patience) -> Option<Paging> {
        let before = held(&self.pager);
        let started = self.clock.ms();
        let (asked_before, now) = {
            let mut workers = self.workers.lock().unwrap();
            let now = std::mem::replace(&mut workers.now, self.with_ancestors(wants));
            workers.waits = patience == Patience::Wait;
            (workers.answers.len(), now)
        };
        let heights = self.pager.heights;
        let result = self.pager.update(&mut self.resident, wants, patience);
        if let Ok(Some(_)) = result {
            self.workers.lock().unwrap().waits = false;
        } else {
            // It may not have come to asking for anything.
            self.workers.lock().unwrap().now.extend(now);
        }
        let changes = self.pager.take_changes();
        let restarted = heights && !self.pager.heights;
        self.copy.replay(&self.resident, &changes, self.all);
        self.seen.resized += u32::from(changes.contains(&Change::All) && !restarted);
        self.seen.without_heights += u32::from(restarted);
        let came = self.answers(asked_before, started, restarted || result.is_err());
        self.check();
        let keys: HashSet<TileKey> = wants.iter().map(|w| w.key).filter(|&key| !self.source.is_empty(key)).collect();
        self.went(before, wants, &keys, &came, restarted);
        let paging = match result {
            Ok(paging) => paging,
            Err(e) => {
                let levels = 0..self.pager.levels.len() as u32;
                let grids = grids(self.resident.dims);
                let mut tiles = levels
                    .filter(|&l| self.pager.levels[l as usize].pinned)
                    .flat_map(|level| (0..grids[level as usize].tiles[0]).map(move |x| TileKey { level, x, z: 0 }));
                assert!(tiles.any(|key| self.source.fault(key).is_some()), "{e}");
                self.seen.errors += 1;
                return None;
            }
        };
        match &paging {
            Some(paging) => self.wanted(wants, &keys, paging, patience, started),
            None => self.too_much(&keys),
        }
        paging
    }

    /// Takes account of what the pager was told about tiles, and gives those that came.
    fn answers(&mut self, asked_before: usize, started: f64, unsure: bool) -> Vec<TileKey> {
        let mut workers = self.workers.lock().unwrap();
        let workers = &mut *workers;
        let (mut failed, mut all_came) = (Vec::new(), Vec::new());
        for (i, (key, came, ms)) in std::mem::take(&mut workers.answers).into_iter().enumerate() {
            if self.hand.state(key) == State::Ready {
                // Not taken yet.
                workers.answers.push((key, came, ms));
                continue;
            }
            if came {
                all_came.push(key);
            }
            if unsure {
                // Whether it was taken before all was begun anew.
                workers.failures.insert(key, self.hand.failed(key));
                continue;
            }
            if came {
                workers.failures.remove(&key);
                continue;
            }
            let taken = if i < asked_before { started } else { ms };
            let (tries, again_ms) = workers.failures.entry(key).or_default();
            *tries += 1;
            *again_ms = taken + (500.0 * 2.0f64.powi(*tries as i32 - 1)).min(30_000.0);
            failed.push(key);
            self.seen.failed += 1;
        }
        for notice in self.pager.take_notices() {
            assert!(self.told.insert(notice.clone()), "said twice: {notice}");
        }
        for key in failed {
            assert_eq!(workers.failures.get(&key).copied().unwrap_or_default(), self.hand.failed(key), "{key:?}");
            let what = format!("tile ({}, {}) of level {} is out", key.x, key.z, key.level);
            assert!(self.told.iter().any(|notice| notice.starts_with(&what)), "{what}, and nobody says so");
        }
        all_came
    }

    /// What holds whatever happens.
    fn check(&mut self) {
        if self.copy.pages.is_empty() {
            let changes = self.pager.take_changes();
            self.copy.replay(&self.resident, &changes, self.all);
        }
        let mut bytes = 0;
        let mut there = HashSet::new();
        let grids = grids(self.resident.dims);
        for ((l, slots), level) in (0..).zip(&self.pager.levels).zip(&self.resident.levels) {
            let pages = level.pages.as_ref().unwrap();
            assert!(slots.slots[0].is_none(), "slot 0 is an empty tile");
            assert_eq!(level.n_columns(), slots.slots.len() * COLUMNS);
            assert!(contents(level, 0, [&(0..0); 3], false) == contents(&empty(level), 0, [&(0..0); 3], false));
            for (place, &slot) in pages.slots.iter().enumerate().filter(|&(_, &slot)| slot != 0) {
                let held = slots.slots[slot as usize].as_ref().expect("a page of a slot that holds nothing");
                assert_eq!((held.key.level, pages.place(held.key.x, held.key.z)), (l, place));
            }
            let mut free = slots.free.clone();
            free.sort_unstable();
            let empty = (1..).zip(&slots.slots[1..]).filter(|(_, slot)| slot.is_none()).map(|(i, _)| i);
            assert_eq!(free, empty.collect::<Vec<u32>>(), "level {l}: free slots");
            let mut parts: [Vec<Range<u32>>; 3] = Default::default();
            for (i, held) in slots.slots.iter().enumerate().filter_map(|(i, slot)| Some((i, slot.as_ref()?))) {
                assert_eq!(pages.slots[pages.place(held.key.x, held.key.z)], i as u32, "{held:?} has no page");
                assert!(there.insert(held.key), "{:?} stands twice", held.key);
                let of = [&held.runs, &held.exposed, &held.colors];
                let beside = of.map(|part| u64::from(part.end - part.start));
                bytes += self.pager.slot_bytes() + 4 * beside[0] + 8 * beside[1] + 4 * beside[2];
                parts.iter_mut().zip(of).for_each(|(parts, part)| parts.push(part.clone()));
                let is = contents(level, i as u32, of, self.all);
                let copy = self.copy.slots.get(&(l, i as u32)).expect("a slot that nobody was told of");
                assert!(is == *copy, "{:?} has changed and nobody was told", held.key);
            }
            assert_eq!(self.copy.pages[l as usize], pages.slots, "level {l}: pages have changed and nobody was told");
            let ends = table_ends(level);
            for ((parts, end), free) in parts.iter_mut().zip(ends).zip([&slots.runs, &slots.exposed, &slots.colors]) {
                parts.retain(|part| !part.is_empty());
                parts.sort_unstable_by_key(|part| part.start);
                assert!(parts.windows(2).all(|two| two[0].end <= two[1].start), "level {l}: parts overlap: {parts:?}");
                assert!(parts.last().is_none_or(|part| part.end <= end), "level {l}: {parts:?} beyond {end}");
                let taken: u32 = parts.iter().map(|part| part.end - part.start).sum();
                let first = free.end - free.free.values().sum::<u32>() - taken;
                assert!(first <= 1, "level {l}: {first} words are nobody's");
            }
            if slots.pinned {
                for x in 0..grids[l as usize].tiles[0] {
                    let held = self.pager.held(&self.resident, TileKey { level: l, x, z: 0 });
                    assert_eq!(held.map(|held| held.missing), Some(0), "tile {x} of level {l} is to stay");
                }
            }
        }
        assert_eq!(self.pager.bytes(), bytes);
    }

    /// What has gone was not wanted, and nothing that was wanted later stays instead of it.
    fn went(
        &mut self,
        before: HashMap<TileKey, Slot>,
        wants: &[Wanted],
        wanted: &HashSet<TileKey>,
        came: &[TileKey],
        restarted: bool,
    ) {
        self.frame += 1;
        let after = held(&self.pager);
        let used = |key: &TileKey| if wanted.contains(key) { self.frame } else { self.frame - 1 };
        if restarted {
            self.used = after.keys().map(|key| (*key, used(key))).collect();
            return;
        }
        let mut oldest_that_stays = HashMap::new();
        // One that came may have gone before: a stand-in, when levels got other slots.
        let stays = |key: &&TileKey| before.contains_key(key) && !wanted.contains(key) && !came.contains(key);
        for key in after.keys().filter(stays) {
            let oldest = oldest_that_stays.entry(key.level).or_insert(u64::MAX);
            *oldest = self.used.get(key).copied().unwrap_or(u64::MAX).min(*oldest);
        }
        for (key, slot) in &before {
            match after.get(key) {
                Some(now) => {
                    let keeps = !wanted.contains(key) || now.missing <= slot.missing;
                    assert!(keeps, "{key:?} is worse than it was: {} became {}", slot.missing, now.missing);
                }
                None => {
                    assert!(!wanted.contains(key), "{key:?} was taken from the frame that wants it");
                    self.seen.evicted += 1;
                    let pages = self.resident.levels[key.level as usize].pages.as_ref().unwrap();
                    let place = pages.place(key.x, key.z);
                    // For one that has its place, or had it for moments, or shows that there is nothing there.
                    let others = after.keys().chain(came).filter(|other| other.level == key.level);
                    let aliased = others.copied().any(|other| pages.place(other.x, other.z) == place);
                    self.seen.displaced += u32::from(aliased);
                    let empty = wants.iter().map(|w| w.key).filter(|w| w.level == key.level && !wanted.contains(w));
                    let cleared = empty.into_iter().any(|other| pages.place(other.x, other.z) == place);
                    let oldest = oldest_that_stays.get(&key.level).copied().unwrap_or(u64::MAX);
                    let used = self.used.get(key).copied().unwrap_or(0);
                    assert!(
                        aliased || cleared || used <= oldest,
                        "{key:?}, wanted in frame {used} of {}, went before one of {oldest}",
                        self.frame
                    );
                }
            }
        }
        let mut last: HashMap<TileKey, u64> = HashMap::new();
        for key in after.keys() {
            let known = before.contains_key(key) && !wanted.contains(key);
            match self.used.get(key) {
                // It may have gone and come back, or stayed: what is not known is not judged.
                _ if known && came.contains(key) => None,
                Some(&old) if known => last.insert(*key, old),
                None if known => None,
                _ => last.insert(*key, used(key)),
            };
            let new = !before.contains_key(key) && !wanted.contains(key);
            self.seen.ahead += u32::from(new);
        }
        self.used = last;
    }

    /// What holds for a frame that is drawn.
    fn wanted(&mut self, wants: &[Wanted], keys: &HashSet<TileKey>, paging: &Paging, patience: Patience, started: f64) {
        assert!(self.pager.bytes() <= self.budget);
        assert_eq!((paging.wanted, paging.bytes_resident), (wants.len() as u32, self.pager.bytes()));
        let mut missing = 0;
        let failures = self.workers.lock().unwrap().failures.clone();
        for w in wants {
            if !keys.contains(&w.key) {
                let slot = Pager::slot_at(&self.resident, w.key);
                assert!(slot == 0 || self.pager.held(&self.resident, w.key).is_some(), "{:?} is not empty", w.key);
                continue;
            }
            let held = self.pager.held(&self.resident, w.key).expect("nothing stands for a tile that is wanted");
            self.shows(w.key, held.missing);
            if held.missing == 0 {
                continue;
            }
            missing += 1;
            let again_ms = failures.get(&w.key).map_or(0.0, |&(_, again_ms)| again_ms);
            match self.hand.state(w.key) {
                State::Failed => {
                    assert!(again_ms > started, "{:?} is due and not asked for", w.key);
                    self.seen.put_off += 1;
                }
                State::Queued(Tier::Now) | State::Producing => {
                    assert_ne!(patience, Patience::Wait, "{:?} is on its way and not waited for", w.key);
                    assert!(again_ms <= started, "{:?} is asked for too early", w.key);
                }
                state => panic!("{:?} is wanted, not there, and {state:?}", w.key),
            }
        }
        assert_eq!(paging.missing, missing);
        self.seen.stood_in += missing;
        // Nothing but what is wanted, and what would stand in better.
        for key in self.hand.queued(Tier::Now) {
            assert!(self.pager.lacks(&self.resident, key), "{key:?} is there and asked for");
            self.seen.between += u32::from(!keys.contains(&key));
        }
    }

    /// Whether a tile's columns are those of the whole world, or of one that many levels coarser.
    fn shows(&self, key: TileKey, missing: u32) {
        let level = &self.resident.levels[key.level as usize];
        let from = &self.whole.levels[(key.level + missing) as usize];
        let [nx, nz] = tile_size(self.resident.dims, key);
        for (x, z) in (0..nz).flat_map(|z| (0..nx).step_by(3).map(move |x| (key.x * TILE + x, z))) {
            let (ix, of) = (level.index(x, z), from.index(x >> missing, z >> missing));
            let most = if self.resident.heights { 65_535 } else { 65_536 };
            let grown = |run: Run| {
                let (first, end) = (u64::from(run.first()) << missing, (u64::from(run.end()) << missing).min(most));
                (first < end).then(|| Run::new(first as u16, (end - 1) as u16))
            };
            let mut expected = from.column(of).filter_map(grown);
            let mut is = level.column(ix);
            loop {
                let (is, expected) = (is.next(), expected.next());
                assert_eq!(is, expected, "{key:?}, {missing} levels coarser, column ({x}, {z})");
                if is.is_none() {
                    break;
                }
            }
            if let Some(top) = level.column(ix).next().map(|run| u32::from(run.last())) {
                let colors = [level.color(ix, 0, top), from.color(of, 0, top >> missing)];
                assert_eq!(colors[0], colors[1], "{key:?}, {missing} levels coarser, column ({x}, {z})");
            }
        }
    }

    /// That a view is refused only where the budget does not hold it.
    fn too_much(&mut self, keys: &HashSet<TileKey>) {
        self.seen.too_much += 1;
        let of_level = |l: u32| keys.iter().filter(|key| key.level == l).count() as u64;
        let shares = (0..self.pager.levels.len() as u32).map(|l| self.pager.share(l, of_level(l) * 9 / 8 + 2));
        let slots_are_too_many = shares.sum::<u64>() * self.pager.tile_bytes() > self.budget;
        let only_wanted = held(&self.pager).keys().all(|&key| keys.contains(&key) || self.is_pinned(key));
        assert!(slots_are_too_many || only_wanted && self.pager.bytes() > self.budget, "refused for nothing");
    }

    /// That a view which stays becomes sharp, one tile a frame, and then nothing happens any more.
    fn settle(&mut self, wants: &[Wanted]) {
        self.source.set(|_| None);
        // What has failed already is heard of first, and then its time is over.
        self.update(wants, Patience::Deadline(0.0));
        self.clock.advance(31_000);
        for turn in 0.. {
            let Some(paging) = self.update(wants, Patience::Deadline(0.0)) else { return };
            if paging.missing == 0 {
                break;
            }
            assert!(turn < 3 * wants.len() + 20, "{}", {
                let absent = wants.iter().filter(|w| self.pager.lacks(&self.resident, w.key));
                let absent: Vec<_> = absent.map(|w| (w.key, self.hand.state(w.key))).collect();
                format!("{absent:?} never come, but {:?}", self.hand.queued(Tier::Now))
            });
            let mut workers = self.workers.lock().unwrap();
            while workers.finish_any(&self.hand) {}
            if workers.take(&self.hand).is_some() {
                workers.finish_any(&self.hand);
            }
        }
        let there = held(&self.pager);
        assert_eq!(self.pager.update(&mut self.resident, wants, Patience::Deadline(0.0)).unwrap().unwrap().arrived, 0);
        assert_eq!(self.pager.take_changes(), [], "a view that rests changes");
        assert!(self.hand.queued(Tier::Now).is_empty());
        self.frame += 1;
        for key in there.keys().filter(|key| wants.iter().any(|w| w.key == **key)) {
            self.used.insert(*key, self.frame);
        }
        self.seen.settled += 1;
    }

    fn follow(&mut self, steps: u32) {
        let mut view = View { at: TILES / 2, first: 0, radius: 2, gaps: 0 };
        let mut swings = 0;
        for _ in 0..steps {
            if swings > 0 {
                // A window away, which is the same place in it, and back before all has come.
                swings -= 1;
                view.at = if view.at >= 64 { view.at - 64 } else { (view.at + 64).min(TILES - 1) };
            }
            match self.die(20) {
                0 => view.at = self.die(TILES),
                1 => swings = 4,
                2 => view.radius = [0, 1, 2, 3, 5, 9, 20][self.die(7) as usize],
                3 => view.first = self.die(4),
                4 => view.gaps = self.die(1000),
                5..9 => view.at = (view.at + 1).min(TILES - 1),
                9 => self.clock.advance([1, 499, 501, 4000, 40_000][self.die(5) as usize]),
                10 => {
                    let (seed, share) = (self.die(1000), [0, 20, 60][self.die(3) as usize]);
                    // Now and then what is pinned too, which shows when all begins anew.
                    let levels = if seed % 5 == 0 { 17 } else { 6 };
                    self.source.set(move |key| {
                        (key.level < levels && noise(seed, key.level, key.x) % 100 < share).then_some(Fault::Out)
                    });
                }
                11 => {
                    if self.die(2) == 0 {
                        view.at = self.die(TILES);
                    }
                    let wants = self.wants(view);
                    self.settle(&wants);
                }
                _ => {}
            }
            let patience = match self.die(10) {
                0 => Patience::Wait,
                1..3 => Patience::Deadline(6.0),
                _ => Patience::Deadline(0.0),
            };
            let wants = self.wants(view);
            self.update(&wants, patience);
            if self.die(3) == 0 {
                let next = self.wants(View { at: (view.at + self.die(3)).min(TILES - 1), ..view });
                self.pager.prefetch(&self.resident, &next);
                self.workers.lock().unwrap().later = next.iter().map(|w| w.key).collect();
                let later = self.hand.queued(Tier::Later);
                assert!(later.iter().all(|&key| self.pager.lacks(&self.resident, key)));
            }
            let mut workers = self.workers.lock().unwrap();
            for _ in 0..workers.dice.of(6) {
                if let Some(key) = workers.take(&self.hand) {
                    assert!(self.pager.lacks(&self.resident, key), "{key:?} is there and made once more");
                }
            }
            // Some stay away for long, and come in another era.
            for _ in 0..workers.dice.of(6) {
                workers.finish_any(&self.hand);
            }
        }
    }
}

/// Where the other tables of a level end.
fn table_ends(level: &ResidentLevel) -> [u32; 3] {
    let runs = match &level.table {
        Table::Heights(_) => 0,
        Table::Runs { runs, .. } => runs.len(),
    };
    let (exposed, colors) = match &level.paint {
        Paint::None | Paint::Height { .. } | Paint::Column { .. } => (0, 0),
        Paint::Run { colors, .. } | Paint::Top { colors, .. } => (0, colors.len()),
        Paint::Voxel { exposed, colors, .. } => (exposed.len(), colors.len()),
    };
    [runs, exposed, colors].map(|n| n as u32)
}

/// A level of one slot that holds nothing.
fn empty(level: &ResidentLevel) -> ResidentLevel {
    let table = match &level.table {
        Table::Heights(_) => Table::Heights(vec![0; COLUMNS]),
        Table::Runs { .. } => Table::Runs { columns: vec![[EMPTY, 0]; COLUMNS], runs: vec![0] },
    };
    let paint = match &level.paint {
        Paint::None | Paint::Height { .. } => Paint::None,
        Paint::Column { .. } => Paint::Column { colors: vec![0; COLUMNS] },
        Paint::Run { .. } => Paint::Run { base: vec![0; COLUMNS], colors: Vec::new() },
        Paint::Top { .. } => Paint::Top { starts: vec![0; STARTS], colors: Vec::new() },
        Paint::Voxel { .. } => Paint::Voxel { base: vec![0; STARTS], exposed: Vec::new(), colors: Vec::new() },
    };
    let (blocks, pages) = (vec![EMPTY; BLOCKS], None);
    ResidentLevel { nx: TILE, nz: TILE, table, blocks, bottom: 0, top: 0, paint, pages }
}

#[test]
fn schedules_without_a_pattern_break_no_rule() {
    let kinds = [
        Kind::Hills(ColorMode::None),
        Kind::Hills(ColorMode::Voxel),
        Kind::Caves(ColorMode::Voxel),
        Kind::Caves(ColorMode::Run),
        Kind::Odd,
    ];
    let run = |(i, kind): (usize, Kind)| -> Seen {
        let scene = kind.scene();
        let whole = Arc::new(Resident::new(&scene));
        let mut seen = Seen::default();
        for seed in 0..8u32 {
            // Every other world knows of no tile of its odd levels that it is empty.
            let hides = |key: TileKey| key.level.is_multiple_of(2);
            let hides = if seed % 2 == 0 { hides } else { |_| false };
            let source = Mock::that_hides(&scene, !matches!(kind, Kind::Caves(_)), hides);
            let least = Rig::new(&source, &whole, u64::MAX, 0).unwrap().pager;
            // As runs, where heights will not do.
            let slot = slot_bytes(least.heights && kind != Kind::Odd, least.source.color());
            let least = least.least_shares().iter().sum::<u64>() * slot;
            let budget = [least + least / 3, least * 2, least * 7][seed as usize % 3];
            let mut rig = Rig::new(&source, &whole, budget, seed + 100 * i as u32).unwrap();
            rig.follow(if rig.all { STEPS / 4 } else { STEPS });
            let Seen { resized, too_much, errors, evicted, displaced, stood_in, .. } = rig.seen;
            let Seen { failed, put_off, ahead, between, settled, without_heights, .. } = rig.seen;
            seen.resized += resized;
            seen.too_much += too_much;
            seen.errors += errors;
            seen.evicted += evicted;
            seen.displaced += displaced;
            seen.stood_in += stood_in;
            seen.failed += failed;
            seen.put_off += put_off;
            seen.ahead += ahead;
            seen.between += between;
            seen.settled += settled;
            seen.without_heights += without_heights;
        }
        seen
    };
    let seen: Vec<Seen> = kinds.into_par_iter().enumerate().map(run).collect();
    let reached = |of: fn(&Seen) -> u32, least: u32, what: &str| {
        let n: u32 = seen.iter().map(of).sum();
        assert!(n >= least, "{what}: {n} times, at least {least} were meant: {seen:?}");
    };
    reached(|seen| seen.resized, 20, "gave levels other slots");
    reached(|seen| seen.too_much, 20, "refused");
    reached(|seen| seen.evicted, 200, "evicted");
    reached(|seen| seen.displaced, 10, "evicted for a tile a window away");
    reached(|seen| seen.stood_in, 200, "stood in for");
    reached(|seen| seen.failed, 200, "failed");
    reached(|seen| seen.put_off, 100, "put off");
    reached(|seen| seen.ahead, 50, "came ahead");
    reached(|seen| seen.between, 20, "asked for in between");
    reached(|seen| seen.settled, 50, "settled");
    reached(|seen| seen.without_heights, 2, "showed that heights do not do");
}

/// Steps of a schedule.
const STEPS: u32 = 120;

#[test]
fn a_tile_that_finds_no_room_in_a_table_leaves_all_as_it_was() {
    let scene = Kind::Caves(ColorMode::Run).scene();
    let whole = Arc::new(Resident::new(&scene));
    let source = Mock::new(&scene, false);
    let mut rig = Rig::new(&source, &whole, 1 << 30, 1).unwrap();
    let wants = rig.wants(View { at: 65, first: 0, radius: 1, gaps: 3 });
    {
        let mut workers = rig.workers.lock().unwrap();
        workers.now = rig.with_ancestors(&wants);
        workers.waits = true;
    }
    // As if the table of runs had all but two of its 2³² words.
    let end = std::mem::replace(&mut rig.pager.levels[0].runs.end, u32::MAX - 2);
    let error = rig.pager.update(&mut rig.resident, &wants, Patience::Wait).unwrap_err().to_string();
    assert_eq!(error, "a level with more than 2³² words of runs at once");
    rig.pager.levels[0].runs.end = end;
    let changes = rig.pager.take_changes();
    rig.copy.replay(&rig.resident, &changes, rig.all);
    rig.check();
    assert_eq!(rig.pager.update(&mut rig.resident, &wants, Patience::Wait).unwrap().unwrap().missing, 0);
}

fn wanted(level: u32, xs: &[u32]) -> Vec<Wanted> {
    xs.iter().map(|&x| Wanted { key: TileKey { level, x, z: 0 }, planes: 9 }).collect()
}

#[test]
fn a_world_that_is_no_height_field_stays_one_until_its_coarsest_tiles_can_be_had_as_runs() {
    let scene = Kind::Odd.scene();
    let whole = Arc::new(Resident::new(&scene));
    let source = Mock::new(&scene, true);
    let mut rig = Rig::new(&source, &whole, 1 << 30, 3).unwrap();
    rig.settle(&wanted(0, &[3, 4]));
    let odd = wanted(0, &[4, 12]);
    source.set(|key| (key.level > 5).then_some(Fault::Out));
    assert!(rig.update(&odd, Patience::Wait).is_none());
    assert!(rig.seen.errors == 1 && rig.pager.heights);
    assert_eq!(rig.pager.missing(&rig.resident, odd[0].key), Some(0));
    source.set(|_| None);
    assert_eq!(rig.update(&odd, Patience::Wait).unwrap().missing, 0);
    assert!(rig.seen.without_heights == 1 && !rig.pager.heights);
}

#[test]
fn what_stands_in_for_an_empty_tile_is_empty() {
    let scene = Kind::Hills(ColorMode::Voxel).scene();
    let whole = Arc::new(Resident::new(&scene));
    // Nothing is known of tiles of level 0, and of those above them that they are empty.
    let source = Mock::that_hides(&scene, true, |key| key.level == 0);
    let mut rig = Rig::new(&source, &whole, 1 << 30, 1).unwrap();
    let empty = wanted(0, &[16, 17]);
    assert!(source.is_empty(TileKey { level: 1, x: 8, z: 0 }) && !source.is_empty(empty[0].key));
    // What stands at the place of the one above is a window away.
    rig.settle(&wanted(1, &[72]));
    assert_eq!(rig.update(&empty, Patience::Deadline(0.0)).unwrap().missing, 2);
    assert_eq!(rig.pager.missing(&rig.resident, empty[0].key), Some(1));
}

#[test]
fn tiles_in_between_keep_none_from_coming_that_is_wanted() {
    let scene = Kind::Hills(ColorMode::None).scene();
    let whole = Arc::new(Resident::new(&scene));
    let source = Mock::new(&scene, true);
    // A level has four slots. Of level 2 all are taken, or all but one: there is no room for what lies between level 0 and what
    // stays, or for one at a time of four.
    for far in [&[26, 27, 28, 29][..], &[26, 27, 28]] {
        let mut rig = Rig::new(&source, &whole, 1 << 30, 2).unwrap();
        let far = wanted(2, far);
        rig.settle(&far);
        rig.settle(&[far, wanted(0, &[66, 70, 74, 78])].concat());
        assert_eq!((rig.seen.settled, rig.seen.resized), (2, 0));
    }
}
