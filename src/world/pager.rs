//! A world of which only those tiles are in memory that a frame can show: which they are, where they stand in the tables,
//! which of them have to go when others come, and what is shown of those that are not there yet.
//!
//! Each level has slots for as many tiles as its share of the budget holds, and [`Pages`] that say in which slot a tile stands.
//! Before a frame is drawn, the tiles that its planes can touch are known from their setup alone ([`wanted`]); those that
//! do not come in time are *stood in* for: their columns are made from the nearest coarser tile that is there, in place. So
//! a walk finds all of its tiles, and knows nothing of this. (Crassin et al. 2009 §6 let rays say what they miss; planes say
//! it before they are cast.)
//!
//! The *debt* of a frame is how many of its samples show a stand-in, each times how many levels that is coarser.

use std::collections::{BTreeMap, HashMap, HashSet, VecDeque};
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use bytemuck::Zeroable;
use planecast_encoder::format::{Grid, TILE, grids};
use planecast_encoder::model::tiles::tile_size;
use planecast_encoder::{ColorMode, Run, TileKey, TileSource};
use rayon::prelude::*;

use crate::clock::Clock;
use crate::frame::plane_setup::{Plane, Setup};
use crate::world::fetch::{Fetcher, Orders, Tier};
use crate::world::parcel::Parcels;
use crate::world::tables::{
    BLOCK_SHIFT, EMPTY, Pages, Paint, Resident, ResidentLevel, TILE_SHIFT, Table, is_height_field, widen,
};
use crate::world::tint::{Tint, Uncolored};
use crate::{Error, Result};

/// Columns of a tile.
const COLUMNS: usize = (TILE * TILE) as usize;

/// Entries that say where a tile's columns begin in a table of their colours, and where the last ends.
const STARTS: usize = COLUMNS + 1;

/// Blocks of a tile.
const BLOCKS: usize = COLUMNS >> (2 * BLOCK_SHIFT);

/// Columns around what planes pass that refinement and normals may look at.
const MARGIN: f64 = 8.0;

/// Tiles a side of the largest window: a view of more is drawn coarser.
const WINDOW_SHIFT: u32 = 6;

/// Levels of at most so many tiles are all there from the start, and stay: what can always stand in.
pub(crate) const PINNED: u64 = 4;

/// A tile that a frame wants, and how many of its planes may pass it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wanted {
    pub key: TileKey,
    pub planes: u32,
}

/// Stand-ins that are made at once, and so in memory beside the tables.
const STAND_INS: usize = 64;

/// How often a frame that waits asks for a tile that cannot be had.
const TRIES: u32 = 3;

/// How long a frame waits for its tiles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Patience {
    /// Until all are there, or cannot be had.
    Wait,
    /// So many milliseconds.
    Deadline(f64),
}

impl std::fmt::Display for Patience {
    /// As `--stream` takes it.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Patience::Wait => f.write_str("wait"),
            Patience::Deadline(ms) => write!(f, "deadline:{ms}"),
        }
    }
}

/// What stands in a slot.
#[derive(Clone, Debug)]
struct Slot {
    key: TileKey,
    /// Levels that it is coarser than it should be; 0: the tile itself.
    missing: u32,
    /// Last frame that wanted it.
    used: u64,
    runs: Range<u32>,
    exposed: Range<u32>,
    colors: Range<u32>,
}

impl Slot {
    /// Bytes of its runs and colours beside the slot.
    fn beside(&self) -> u64 {
        let of = |part: &Range<u32>, bytes: u64| bytes * u64::from(part.end - part.start);
        of(&self.runs, 4) + of(&self.exposed, 8) + of(&self.colors, 4)
    }

    /// What is told of it where it is new in a slot.
    fn change(&self, level: u32, slot: u32) -> Change {
        let Slot { runs, exposed, colors, .. } = self.clone();
        Change::Slot { level, slot, runs, exposed, colors }
    }
}

/// Parts of a table that grows: which are free.
#[derive(Clone, Debug, Default)]
struct Parts {
    free: BTreeMap<u32, u32>,
    end: u32,
}

impl Parts {
    fn take(&mut self, n: u32) -> Option<Range<u32>> {
        if n == 0 {
            return Some(0..0);
        }
        let found = self.free.iter().find(|&(_, &len)| len >= n).map(|(&at, &len)| (at, len));
        if let Some((at, len)) = found {
            self.free.remove(&at);
            if len > n {
                self.free.insert(at + n, len - n);
            }
            return Some(at..at + n);
        }
        let at = self.end;
        self.end = at.checked_add(n)?;
        Some(at..self.end)
    }

    fn give(&mut self, part: Range<u32>) {
        if part.is_empty() {
            return;
        }
        let (mut at, mut len) = (part.start, part.end - part.start);
        if let Some((&before, &n)) = self.free.range(..at).next_back()
            && before + n == at
        {
            self.free.remove(&before);
            (at, len) = (before, len + n);
        }
        if let Some(n) = self.free.remove(&(at + len)) {
            len += n;
        }
        if at + len == self.end {
            self.end = at;
        } else {
            self.free.insert(at, len);
        }
    }
}

/// The slots of one level.
#[derive(Clone, Debug)]
struct Slots {
    slots: Vec<Option<Slot>>,
    /// Those that hold nothing, but for slot 0.
    free: Vec<u32>,
    runs: Parts,
    exposed: Parts,
    colors: Parts,
    pinned: bool,
}

impl Slots {
    /// Gives back what a tile took beside its slot.
    fn give(&mut self, held: Slot) {
        self.runs.give(held.runs);
        self.exposed.give(held.exposed);
        self.colors.give(held.colors);
    }
}

/// A change of a level's tables, for whoever keeps a copy.
#[derive(Clone, Debug, PartialEq)]
pub enum Change {
    /// All of the world's tables are others.
    All,
    /// A slot's columns, and parts of the other tables.
    Slot { level: u32, slot: u32, runs: Range<u32>, exposed: Range<u32>, colors: Range<u32> },
    /// The level's pages.
    Pages { level: u32 },
}

/// What a frame had to do for its tiles.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Paging {
    /// Tiles that the frame's planes can touch.
    pub wanted: u32,
    /// Those that came for it, and those that went.
    pub arrived: u32,
    pub evicted: u32,
    /// Those that are stood in for.
    pub missing: u32,
    /// Bytes read for those that came, as far as that is known.
    pub bytes_read: u64,
    pub bytes_resident: u64,
    /// Milliseconds for reading, checking and unpacking while the frame waited, and for putting into the tables.
    pub unpack_ms: f64,
    pub install_ms: f64,
}

/// Which tiles of a world are there.
pub struct Pager {
    source: Arc<dyn TileSource>,
    /// Colours instead of the source's.
    tint: Option<Tint>,
    fetcher: Fetcher,
    levels: Vec<Slots>,
    budget: u64,
    heights: bool,
    frame: u64,
    changes: Vec<Change>,
    /// Slots that each level has had use for.
    shares: Vec<u64>,
    /// Bytes of runs and colours beside the slots, of all tiles that came, and how many those were.
    beside: (u64, u64),
    /// Tiles of which it was said that they cannot be had.
    told: HashSet<TileKey>,
    notices: Vec<String>,
    clock: Clock,
}

/// Neighbouring planes whose tiles are looked for together: what lies between the outermost holds the others.
const TOGETHER: usize = 8;

/// The tiles that planes can touch, those that most of them pass first; `None` where more than a window holds.
pub fn wanted(setup: &Setup, dims: [u32; 3]) -> Option<Vec<Wanted>> {
    wanted_by(setup, dims, TOGETHER)
}

/// The same with so many planes at a time.
fn wanted_by(setup: &Setup, dims: [u32; 3], together: usize) -> Option<Vec<Wanted>> {
    let grids = grids(dims);
    let levels = (0..setup.levels).into_par_iter().map(|l| wanted_of_level(setup, &grids, l, together));
    let mut found: Vec<Wanted> = levels.collect::<Option<Vec<_>>>()?.concat();
    found.sort_by_key(|wanted| (std::cmp::Reverse(wanted.planes), wanted.key));
    Some(found)
}

/// Neighbouring planes, as the outermost two of them.
struct Pass {
    /// Where each enters a level and where it leaves it, tiles.
    lines: [[[f64; 2]; 2]; 2],
    planes: u32,
}

/// The planes of one level by neighbours, at most so many in one.
fn passes(setup: &Setup, l: u32, together: usize) -> Vec<Pass> {
    let scale = f64::from(TILE) * f64::from(1u32 << l);
    let eye = [0, 1].map(|k| (f64::from(setup.eye_cell[2 * k]) + setup.eye_fract[2 * k]) / scale);
    let part = |plane: &Plane| {
        let inside = l >= plane.lod_first && plane.t_end > plane.t_start;
        let [from, to] = if inside { setup.part(plane, l) } else { [1.0, 0.0] };
        (from <= to).then_some([from, to])
    };
    let mut passes = Vec::new();
    for fan in &setup.fans {
        let planes = &setup.planes[fan.first_plane as usize..][..fan.n_planes as usize];
        let mut i = 0;
        while i < planes.len() {
            let first = &planes[i];
            i += 1;
            let Some([mut from, mut to]) = part(first) else { continue };
            let mut last = first;
            let mut n = 1;
            // Azimuths turn one way along a fan. Between two that are θ apart lies an arc, which rises above the line from one to the
            // other by T·θ²/8: by less than a column where it is T columns away.
            while n < together && i < planes.len() {
                let next = &planes[i];
                let Some([begin, end]) = part(next) else { break };
                let along = first.dir[0] * next.dir[0] + first.dir[1] * next.dir[1];
                let columns = to.max(end) / f64::from(1u32 << l);
                if (1.0 - along) * columns > 4.0 {
                    break;
                }
                (from, to, last) = (from.min(begin), to.max(end), next);
                (n, i) = (n + 1, i + 1);
            }
            let line = |plane: &Plane| [from, to].map(|t| [0, 1].map(|k| eye[k] + t * plane.dir[k] / scale));
            passes.push(Pass { lines: [line(first), line(last)], planes: n as u32 });
        }
    }
    passes
}

/// The tiles of one level.
fn wanted_of_level(setup: &Setup, grids: &[Grid], l: u32, together: usize) -> Option<Vec<Wanted>> {
    let side = 1usize << WINDOW_SHIFT;
    // A column more for the arc between two planes.
    let margin = (MARGIN + 1.0) / f64::from(TILE);
    let tiles = grids[l as usize].tiles.map(|n| f64::from(n) - 1.0);
    // Bounds of all that is passed, so that nothing is mistaken for what stands a whole window away.
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    let passes = passes(setup, l, together);
    for end in passes.iter().flat_map(|pass| pass.lines.as_flattened()) {
        for k in 0..2 {
            low[k] = low[k].min(end[k] - margin).max(0.0);
            high[k] = high[k].max(end[k] + margin).min(tiles[k] + 0.999);
        }
    }
    if passes.is_empty() || high[0] < low[0] || high[1] < low[1] {
        return Some(Vec::new());
    }
    let origin = low.map(f64::floor);
    if (0..2).any(|k| high[k].floor() - origin[k] >= side as f64) {
        return None;
    }
    let mut counts = vec![0u32; side * side];
    for Pass { lines, planes } in passes {
        let [[a, b], _] = lines;
        let major = usize::from((b[1] - a[1]).abs() > (b[0] - a[0]).abs());
        let minor = 1 - major;
        let lines = lines.map(|[a, b]| {
            let [a, b] = if a[major] <= b[major] { [a, b] } else { [b, a] };
            let slope = if b[major] > a[major] { (b[minor] - a[minor]) / (b[major] - a[major]) } else { 0.0 };
            (a, b, slope)
        });
        let [begin, end] = [lines[0].0[major].min(lines[1].0[major]), lines[0].1[major].max(lines[1].1[major])];
        let last = (end + margin).floor().min(tiles[major]);
        let mut at = (begin - margin).floor().max(0.0);
        while at <= last {
            let mut across = [f64::INFINITY, f64::NEG_INFINITY];
            for (a, b, slope) in lines {
                for v in [at - margin, at + 1.0 + margin] {
                    let here = a[minor] + (v.clamp(a[major], b[major]) - a[major]) * slope;
                    across = [across[0].min(here), across[1].max(here)];
                }
            }
            let to = (across[1] + margin).floor().min(tiles[minor]);
            let mut across = (across[0] - margin).floor().max(0.0);
            while across <= to {
                let mut cell = [0.0; 2];
                (cell[major], cell[minor]) = (at - origin[major], across - origin[minor]);
                counts[cell[1] as usize * side + cell[0] as usize] += planes;
                across += 1.0;
            }
            at += 1.0;
        }
    }
    let cells = counts.iter().enumerate().filter(|&(_, &planes)| planes > 0);
    let found = cells.map(|(i, &planes)| {
        let [x, z] = [origin[0] as u32 + (i % side) as u32, origin[1] as u32 + (i / side) as u32];
        Wanted { key: TileKey { level: l, x, z }, planes }
    });
    Some(found.collect())
}

/// One tile, made ready for the tables.
pub struct Tile {
    pub tables: ResidentLevel,
    pub bytes: u64,
}

impl Tile {
    /// What a source gives; `None` where it is to be heights and is not. What a source panics about is a fault of one tile.
    pub(crate) fn read(source: &dyn TileSource, key: TileKey, heights: bool) -> Result<Option<Tile>> {
        catch_unwind(AssertUnwindSafe(|| Tile::try_read(source, key, heights))).unwrap_or_else(|_| {
            let TileKey { level, x, z } = key;
            Err(Error::Limit(format!("{}: tile ({x}, {z}) of level {level} could not be made", source.name())))
        })
    }

    fn try_read(source: &dyn TileSource, key: TileKey, heights: bool) -> Result<Option<Tile>> {
        let level = source.tile(key)?;
        // A source that has changed since its extents were asked for would write beside its slot.
        let [[nx, nz], is] = [tile_size(source.dims(), key), [level.solid.nx(), level.solid.nz()]];
        if is != [nx, nz] {
            return Err(Error::Limit(format!(
                "{}: tile ({}, {}) of level {} has {} × {} columns, {nx} × {nz} were expected",
                source.name(),
                key.x,
                key.z,
                key.level,
                is[0],
                is[1]
            )));
        }
        if heights && !is_height_field(level.geometry(source.encoding())) {
            return Ok(None);
        }
        let tables = ResidentLevel::new(&level, source.encoding(), source.color(), heights)?;
        Ok(Some(Tile { tables, bytes: source.bytes(key) }))
    }
}

/// Bytes that a slot takes in the tables whose columns it has.
fn slot_bytes(heights: bool, color: ColorMode) -> u64 {
    let column = if heights { 2 } else { 8 };
    let paint = match color {
        ColorMode::None => 0,
        ColorMode::Run | ColorMode::Voxel => 4,
    };
    (COLUMNS * (column + paint) + 4 * BLOCKS) as u64
}

impl Pager {
    /// For the tiles of a source, in its colours or a tint's, in at most `budget` bytes; and the tables, with the coarsest levels
    /// there.
    ///
    /// # Errors
    /// Those of the coarsest tiles; [`Error::Limit`] where the budget does not hold as much as a tile a level.
    pub fn new(source: Arc<dyn TileSource>, budget: u64, tint: Option<Tint>) -> Result<(Pager, Resident)> {
        let source = if tint.is_some() { Arc::new(Uncolored(source)) } else { source };
        Pager::with(Fetcher::new(source, Clock::start()), budget, tint)
    }

    /// For a world whose tiles others bring, as they are ordered.
    ///
    /// # Errors
    /// As [`Pager::new`].
    pub fn of_parcels(parcels: Arc<Parcels>, budget: u64) -> Result<((Pager, Resident), Orders)> {
        let (fetcher, orders) = Fetcher::ordered(parcels, Clock::start());
        Ok((Pager::with(fetcher, budget, None)?, orders))
    }

    /// The same for what a fetcher brings, by its clock.
    fn with(fetcher: Fetcher, budget: u64, tint: Option<Tint>) -> Result<(Pager, Resident)> {
        let (source, clock) = (Arc::clone(fetcher.source()), fetcher.clock().clone());
        let heights = source.is_height_field();
        let mut pager = Pager {
            source,
            tint,
            fetcher,
            levels: Vec::new(),
            budget,
            heights,
            frame: 0,
            changes: Vec::new(),
            shares: Vec::new(),
            beside: (0, 0),
            told: HashSet::new(),
            notices: Vec::new(),
            clock,
        };
        let resident = pager.restart(heights)?;
        Ok((pager, resident))
    }

    fn slot_bytes(&self) -> u64 {
        slot_bytes(self.heights, self.source.color())
    }

    /// How many slots a level gets of so many that it would have.
    fn share(&self, l: u32, n: u64) -> u64 {
        let tiles = grids(self.source.dims())[l as usize].n_tiles();
        n.max(if tiles <= PINNED { tiles } else { 4 }).min(tiles)
    }

    /// Bytes that a tile takes, with what the tiles that came so far had beside their slots.
    fn tile_bytes(&self) -> u64 {
        self.slot_bytes() + self.beside.0 / self.beside.1.max(1)
    }

    /// The fewest slots that each level can do with.
    fn least_shares(&self) -> Vec<u64> {
        (0..self.source.levels()).map(|l| self.share(l, 1)).collect()
    }

    /// Tables with the fewest slots, empty but for the coarsest levels; of runs where one of those tiles shows that heights do not
    /// do. What was asked for before is forgotten. On an error all is as it was.
    fn restart(&mut self, heights: bool) -> Result<Resident> {
        let least = self.least_shares();
        let shares = std::mem::replace(&mut self.shares, least);
        let old = (self.heights, shares, std::mem::take(&mut self.levels), std::mem::take(&mut self.changes));
        self.heights = heights;
        let mut made = self.begin();
        if let Ok(None) = made {
            self.heights = false;
            made = self.begin();
        }
        match made {
            Ok(resident) => {
                self.fetcher.restart(self.heights);
                Ok(resident.expect("runs do for any tile"))
            }
            Err(e) => {
                (self.heights, self.shares, self.levels, self.changes) = old;
                Err(e)
            }
        }
    }

    /// Gives each level so many slots. What stands in them stays, as far as there is room: what was wanted last before the rest.
    ///
    /// # Errors
    /// [`Error::Limit`] where memory is out; some levels have their slots then.
    fn resize(&mut self, resident: &mut Resident, shares: &[u64], paging: &mut Paging) -> Result<()> {
        let resized = (0..).zip(shares).try_for_each(|(l, &n)| self.resize_level(resident, l, n, paging));
        // Slots that a level has more begin where another's ended.
        self.changes = vec![Change::All];
        for (level, slots) in (0..).zip(&self.levels) {
            let held = (0..).zip(&slots.slots).filter_map(|(i, slot)| Some((i, slot.as_ref()?)));
            self.changes.extend(held.map(|(slot, held)| held.change(level, slot)));
        }
        resized
    }

    fn resize_level(&mut self, resident: &mut Resident, level: u32, n: u64, paging: &mut Paging) -> Result<()> {
        let l = level as usize;
        let (old, new) = (self.levels[l].slots.len(), n as usize + 1);
        let mut held: Vec<(u64, u32)> =
            (0..).zip(&self.levels[l].slots).filter_map(|(i, slot)| Some((slot.as_ref()?.used, i))).collect();
        held.sort_unstable();
        held.truncate(held.len().saturating_sub(n as usize));
        for (_, slot) in held {
            self.evict(resident, level, slot);
            paging.evicted += 1;
        }
        let slots = &mut self.levels[l];
        let mut free = (1..old.min(new)).filter(|&i| slots.slots[i].is_none()).collect::<Vec<_>>().into_iter();
        let mut moves = Vec::new();
        for from in new..old {
            if let Some(held) = slots.slots[from].take() {
                let to = free.next().expect("no more are held than there are slots");
                let pages = resident.levels[l].pages.as_mut().expect("a paged level has pages");
                let place = pages.place(held.key.x, held.key.z);
                pages.slots[place] = to as u32;
                slots.slots[to] = Some(held);
                moves.push((from, to));
            }
        }
        resize_tables(&mut resident.levels[l], new, &moves)?;
        slots.slots.resize(new, None);
        slots.free = (1..new as u32).rev().filter(|&i| slots.slots[i as usize].is_none()).collect();
        self.shares[l] = n;
        Ok(())
    }

    /// The tables of [`Pager::restart`]; `None` where they are to be heights and a tile has others.
    fn begin(&mut self) -> Result<Option<Resident>> {
        let dims = self.source.dims();
        let n_levels = self.source.levels();
        let grids = grids(dims);
        let pinned = |l: u32| grids[l as usize].n_tiles() <= PINNED;
        let need = self.shares.iter().sum::<u64>() * self.slot_bytes();
        if need > self.budget {
            return Err(Error::Limit(format!(
                "{}: {n_levels} levels take at least {} KiB of memory, {} KiB are allowed",
                self.source.name(),
                need >> 10,
                self.budget >> 10
            )));
        }
        self.levels.clear();
        let mut levels = Vec::new();
        for l in 0..n_levels {
            let n = self.shares[l as usize] as usize + 1;
            let Grid { dims: [nx, _, nz], tiles: [tx, tz], .. } = grids[l as usize];
            let shift = tx.max(tz).next_power_of_two().ilog2().min(WINDOW_SHIFT);
            let table = if self.heights {
                Table::Heights(bytemuck::zeroed_vec(n * COLUMNS))
            } else {
                let mut columns: Vec<[u32; 2]> = bytemuck::zeroed_vec(n * COLUMNS);
                columns[..COLUMNS].fill([EMPTY, 0]);
                Table::Runs { columns, runs: vec![0] }
            };
            let mut blocks: Vec<u32> = bytemuck::zeroed_vec(n * BLOCKS);
            blocks[..BLOCKS].fill(EMPTY);
            let paint = match (self.source.color(), self.heights) {
                (ColorMode::None, _) => Paint::None,
                (ColorMode::Run, true) => Paint::Column { colors: bytemuck::zeroed_vec(n * COLUMNS) },
                (ColorMode::Run, false) => Paint::Run { base: bytemuck::zeroed_vec(n * COLUMNS), colors: Vec::new() },
                (ColorMode::Voxel, true) => Paint::Top { starts: bytemuck::zeroed_vec(n * STARTS), colors: Vec::new() },
                (ColorMode::Voxel, false) => {
                    let base = bytemuck::zeroed_vec(n * STARTS);
                    Paint::Voxel { base, exposed: Vec::new(), colors: Vec::new() }
                }
            };
            let [bottom, top] = self.source.heights(l);
            let pages = Some(Pages { shift, slots: vec![0; 1 << (2 * shift)] });
            levels.push(ResidentLevel { nx, nz, table, blocks, bottom, top, paint, pages });
            self.levels.push(Slots {
                slots: vec![None; n],
                free: (1..n as u32).rev().collect(),
                runs: Parts { end: 1, ..Parts::default() },
                exposed: Parts::default(),
                colors: Parts::default(),
                pinned: pinned(l),
            });
        }
        self.changes = vec![Change::All];
        let (encoding, color) = (self.source.encoding(), self.source.color());
        let (heights, fractions) = (self.heights, Vec::new());
        let mut resident = Resident { dims, encoding, color, levels, heights, fractions, matter: None };
        let pinned: Vec<TileKey> = (0..n_levels)
            .rev()
            .filter(|&l| self.levels[l as usize].pinned)
            .flat_map(|level| {
                let [tx, tz] = grids[level as usize].tiles;
                (0..tz).flat_map(move |z| (0..tx).map(move |x| TileKey { level, x, z }))
            })
            .collect();
        let (fetcher, heights) = (&self.fetcher, self.heights);
        let read: Vec<Result<Option<Tile>>> = pinned.par_iter().map(|&key| fetcher.read(key, heights)).collect();
        for (key, tile) in pinned.into_iter().zip(read) {
            match tile? {
                Some(tile) => _ = self.install(&mut resident, key, 0, &tile.tables, self.frame)?,
                None => return Ok(None),
            }
        }
        if let Some(tint) = &self.tint {
            tint.paint(&mut resident);
        }
        Ok(Some(resident))
    }

    /// What gives the tiles.
    pub fn source(&self) -> &Arc<dyn TileSource> {
        &self.source
    }

    /// What has changed in the tables since this was asked last.
    pub fn take_changes(&mut self) -> Vec<Change> {
        std::mem::take(&mut self.changes)
    }

    /// What is to be said of tiles that could not be had, each once.
    pub fn take_notices(&mut self) -> Vec<String> {
        std::mem::take(&mut self.notices)
    }

    fn now(&self) -> f64 {
        self.clock.ms()
    }

    /// The slot that a tile's place in the window has.
    fn slot_at(resident: &Resident, key: TileKey) -> u32 {
        let pages = resident.levels[key.level as usize].pages.as_ref().expect("a paged level has pages");
        pages.slots[pages.place(key.x, key.z)]
    }

    /// What stands for a tile.
    fn held(&self, resident: &Resident, key: TileKey) -> Option<&Slot> {
        let slot = Pager::slot_at(resident, key) as usize;
        self.levels[key.level as usize].slots[slot].as_ref().filter(|held| held.key == key)
    }

    /// By how many levels what stands for a tile is coarser; `None` where nothing does, and it is shown empty.
    pub fn missing(&self, resident: &Resident, key: TileKey) -> Option<u32> {
        if self.source.is_empty(key) {
            return Some(0);
        }
        self.held(resident, key).map(|slot| slot.missing)
    }

    /// By how many levels what stands in each slot is coarser than it should be, slots of all levels one after the other.
    pub fn missing_by_slot(&self) -> Vec<u32> {
        let slots = self.levels.iter().flat_map(|level| &level.slots);
        slots.map(|slot| slot.as_ref().map_or(0, |held| held.missing)).collect()
    }

    /// Bytes that tiles take.
    pub fn bytes(&self) -> u64 {
        let level =
            |slots: &Slots| slots.slots.iter().flatten().map(|slot| self.slot_bytes() + slot.beside()).sum::<u64>();
        self.levels.iter().map(level).sum()
    }

    /// Brings the tiles that a frame wants, as [`wanted`] has them, as far as its patience goes; what is not there then is stood
    /// in for. `None` where the budget does not hold them all: the frame has to be drawn coarser.
    ///
    /// # Errors
    /// [`Error::Limit`] where memory is out.
    pub fn update(&mut self, resident: &mut Resident, wants: &[Wanted], patience: Patience) -> Result<Option<Paging>> {
        self.frame += 1;
        let mut paging = Paging { wanted: wants.len() as u32, ..Paging::default() };
        let (empty, wanted): (Vec<Wanted>, Vec<_>) = wants.iter().partition(|w| self.source.is_empty(w.key));
        let keys: HashSet<TileKey> = wanted.iter().map(|w| w.key).collect();
        let mut per_level = vec![0usize; self.levels.len()];
        for w in &wanted {
            per_level[w.key.level as usize] += 1;
            let slot = Pager::slot_at(resident, w.key) as usize;
            let held = self.levels[w.key.level as usize].slots[slot].as_mut();
            if let Some(held) = held.filter(|held| held.key == w.key) {
                held.used = self.frame;
            }
        }
        if per_level.iter().zip(&self.levels).any(|(&n, level)| n >= level.slots.len()) {
            // More, since the next frames want more or less: a half where the budget holds that, else an eighth. With none to spare
            // every other frame would copy all tables.
            let most = self.budget / self.tile_bytes();
            let shares = |more: fn(u64) -> u64| -> Vec<u64> {
                let wanted = (0..).zip(&per_level).zip(&self.shares);
                wanted.map(|((l, &n), &share)| self.share(l, more(n as u64).max(share.min(4)))).collect()
            };
            let roomy = [shares(|n| n * 3 / 2), shares(|n| n * 9 / 8 + 2)];
            let Some(shares) = roomy.into_iter().find(|shares| shares.iter().sum::<u64>() <= most) else {
                return Ok(None);
            };
            self.resize(resident, &shares, &mut paging)?;
        }
        let before = self.now();
        // What was asked for ahead of its frame. The rest is asked for when that is in its place, and not once more.
        let mut come: VecDeque<_> = std::iter::from_fn(|| self.fetcher.next(0.0)).collect();
        let mut tries = HashMap::<TileKey, u32>::new();
        // Those of the wanted tiles that are on their way, once they were asked for.
        let mut coming: Option<HashSet<TileKey>> = None;
        let end = match patience {
            Patience::Wait => f64::INFINITY,
            Patience::Deadline(ms) => before + ms,
        };
        loop {
            if come.is_empty() {
                let coming = coming.get_or_insert_with(|| {
                    let absent = wanted.iter().copied().filter(|w| self.lacks(resident, w.key)).collect();
                    self.request(resident, absent, &tries, patience)
                });
                let left = if coming.is_empty() { 0.0 } else { (end - self.now()).max(0.0) };
                come.extend(self.fetcher.next(left));
            }
            let Some((key, tile)) = come.pop_front() else { break };
            if let Some(coming) = &mut coming {
                coming.remove(&key);
            }
            match tile {
                Ok(Some(tile)) => {
                    // What nobody wants yet goes first when room is short.
                    let used = if keys.contains(&key) { self.frame } else { self.frame - 1 };
                    self.arrive(resident, key, &tile, used, &mut paging)?;
                }
                Ok(None) => {
                    *resident = self.restart(false)?;
                    return self.update(resident, wants, patience);
                }
                Err(e) => {
                    if self.told.insert(key) {
                        let what = format!("{e}; it is shown from a coarser tile, and asked for again");
                        self.notices.push(what);
                    }
                    let tries = tries.entry(key).or_default();
                    *tries += 1;
                    if let Some(coming) = &mut coming
                        && patience == Patience::Wait
                        && *tries < TRIES
                        && keys.contains(&key)
                    {
                        self.fetcher.retry(key);
                        coming.insert(key);
                    }
                }
            }
            if coming.is_some() && come.is_empty() && self.now() >= end {
                break;
            }
        }
        paging.unpack_ms = self.now() - before - paging.install_ms;
        // After all that came: a tile that came too late may stand where there is to be nothing.
        for w in empty {
            self.clear(resident, w.key);
        }
        let start = self.now();
        let lacking: Vec<TileKey> = wanted.iter().map(|w| w.key).filter(|&key| self.lacks(resident, key)).collect();
        paging.missing = lacking.len() as u32;
        for keys in lacking.chunks(STAND_INS) {
            self.stand_in(resident, keys, &mut paging)?;
        }
        paging.install_ms += self.now() - start;
        paging.bytes_resident = self.bytes();
        if paging.bytes_resident > self.budget {
            self.shrink(resident, &mut paging);
            paging.bytes_resident = self.bytes();
            if paging.bytes_resident > self.budget {
                return Ok(None);
            }
        }
        Ok(Some(paging))
    }

    /// Asks for tiles that a later frame will want, after those that one wants now.
    pub fn prefetch(&mut self, resident: &Resident, wants: &[Wanted]) {
        let put_off = self.fetcher.put_off();
        let absent = wants.iter().filter(|w| self.lacks(resident, w.key) && !put_off.contains(&w.key));
        let absent: Vec<TileKey> = absent.map(|w| w.key).collect();
        self.fetcher.ask(Tier::Later, &absent);
    }

    /// Shows nothing where an empty tile is: what stands at its place is a whole window away.
    fn clear(&mut self, resident: &mut Resident, key: TileKey) {
        let slot = Pager::slot_at(resident, key);
        if slot != 0 && self.held(resident, key).is_none() {
            self.evict(resident, key.level, slot);
            self.levels[key.level as usize].free.push(slot);
        }
    }

    fn lacks(&self, resident: &Resident, key: TileKey) -> bool {
        self.missing(resident, key) != Some(0)
    }

    /// Asks for wanted tiles that are not there, and says which of them are on their way then.
    fn request(
        &mut self,
        resident: &Resident,
        absent: Vec<Wanted>,
        tries: &HashMap<TileKey, u32>,
        patience: Patience,
    ) -> HashSet<TileKey> {
        let (coming, asked): (HashSet<TileKey>, Vec<TileKey>) = match patience {
            // A frame that waits takes no time off.
            Patience::Wait => {
                let due = absent.iter().filter(|w| tries.get(&w.key).is_none_or(|&n| n < TRIES));
                due.map(|w| (w.key, w.key)).unzip()
            }
            Patience::Deadline(_) => {
                let put_off = self.fetcher.put_off();
                let due = absent.iter().map(|w| w.key).filter(|key| !put_off.contains(key));
                (due.collect(), self.by_debt(resident, &absent, &put_off))
            }
        };
        self.fetcher.ask(Tier::Now, &asked);
        coming
    }

    /// What to ask for where a frame does not wait for all: what is farthest from what it should be first, and of what stands far
    /// below that first a tile in between.
    fn by_debt(&self, resident: &Resident, absent: &[Wanted], put_off: &HashSet<TileKey>) -> Vec<TileKey> {
        let mut asked: Vec<(u64, TileKey)> = Vec::new();
        let mut seen = HashSet::new();
        // Slots of each level for what the frame does not want itself. A tile without one would be made in vain each frame, before
        // those that are wanted.
        let idle = |held: &Slot| held.used < self.frame;
        let spare =
            |level: &Slots| if level.pinned { 0 } else { level.slots.iter().flatten().filter(|s| idle(s)).count() };
        let mut room: Vec<usize> = self.levels.iter().map(|level| level.free.len() + spare(level)).collect();
        for w in absent {
            let (mut key, mut up) = (w.key, 0);
            let mut nearest = key;
            while nearest.level + 1 < self.levels.len() as u32 && self.lacks(resident, nearest) {
                nearest = nearest.parent();
            }
            // What stands there may be of a finer tile that has gone since.
            let stands = self.missing(resident, key).unwrap_or(u32::MAX);
            let levels = (nearest.level - key.level).min(stands);
            if !put_off.contains(&key) && seen.insert(key) {
                asked.push((u64::from(w.planes) * u64::from(levels), key));
            }
            while up + 3 < levels {
                (key, up) = (key.parent().parent(), up + 2);
                let there = Pager::slot_at(resident, key) as usize;
                let there = self.levels[key.level as usize].slots[there].as_ref();
                let fits = there.is_none_or(|held| held.key == key || idle(held));
                let room = &mut room[key.level as usize];
                if fits && *room > 0 && !put_off.contains(&key) && self.lacks(resident, key) && seen.insert(key) {
                    *room -= 1;
                    asked.push(((u64::from(w.planes) * u64::from(levels)) << (2 * up).min(32), key));
                }
            }
        }
        asked.sort_unstable_by_key(|&(debt, key)| (std::cmp::Reverse(debt), key));
        asked.into_iter().map(|(_, key)| key).collect()
    }

    fn arrive(
        &mut self,
        resident: &mut Resident,
        key: TileKey,
        tile: &Tile,
        used: u64,
        paging: &mut Paging,
    ) -> Result<()> {
        let start = self.now();
        if self.install(resident, key, 0, &tile.tables, used)?.is_some_and(|evicted| {
            paging.evicted += u32::from(evicted);
            true
        }) {
            paging.arrived += 1;
            paging.bytes_read += tile.bytes;
        }
        paging.install_ms += self.now() - start;
        Ok(())
    }

    /// Takes away what the last frames have not wanted, until the budget holds.
    fn shrink(&mut self, resident: &mut Resident, paging: &mut Paging) {
        let mut old: Vec<(u64, u32, u32)> = Vec::new();
        for (l, level) in self.levels.iter().enumerate().filter(|(_, level)| !level.pinned) {
            let idle = level.slots.iter().enumerate().filter_map(|(i, slot)| Some((i, slot.as_ref()?.used)));
            old.extend(idle.filter(|&(_, used)| used < self.frame).map(|(i, used)| (used, l as u32, i as u32)));
        }
        old.sort_unstable();
        for (_, level, slot) in old {
            if self.bytes() <= self.budget {
                break;
            }
            self.evict(resident, level, slot);
            self.levels[level as usize].free.push(slot);
            paging.evicted += 1;
        }
    }

    fn evict(&mut self, resident: &mut Resident, level: u32, slot: u32) {
        let slots = &mut self.levels[level as usize];
        let Some(held) = slots.slots[slot as usize].take() else { return };
        let key = held.key;
        slots.give(held);
        let pages = resident.levels[level as usize].pages.as_mut().expect("a paged level has pages");
        let place = pages.place(key.x, key.z);
        if pages.slots[place] == slot {
            pages.slots[place] = 0;
        }
        self.changes.push(Change::Pages { level });
    }

    /// Puts a tile into the tables; whether one had to go for it, or `None` where there is no room among those that are wanted.
    fn install(
        &mut self,
        resident: &mut Resident,
        key: TileKey,
        missing: u32,
        tile: &ResidentLevel,
        used: u64,
    ) -> Result<Option<bool>> {
        let l = key.level as usize;
        let own = self.held(resident, key);
        let (known, used) = (own.is_some(), own.map_or(used, |slot| slot.used));
        let mut evicted = false;
        // Whatever stands at its place in the window is a whole window away.
        let there = Pager::slot_at(resident, key);
        let slot = match (there, self.levels[l].free.pop()) {
            (0, Some(slot)) => slot,
            (0, None) => {
                let oldest = self.levels[l].slots.iter().enumerate().skip(1);
                let oldest = oldest.filter_map(|(i, slot)| Some((slot.as_ref()?.used, i as u32))).min();
                let Some((used, slot)) = oldest.filter(|_| !self.levels[l].pinned) else { return Ok(None) };
                if used >= self.frame {
                    return Ok(None);
                }
                evicted = true;
                slot
            }
            (there, free) => {
                self.levels[l].free.extend(free);
                // A tile that came too late does not take the place of one that is wanted.
                if !known && self.levels[l].slots[there as usize].as_ref().is_some_and(|held| held.used >= self.frame) {
                    return Ok(None);
                }
                evicted = !known;
                there
            }
        };
        self.evict(resident, key.level, slot);
        let slots = &mut self.levels[l];
        let held = Slot { key, missing, used, runs: 0..0, exposed: 0..0, colors: 0..0 };
        let held = match put(slots, &mut resident.levels[l], slot, held, tile) {
            Ok(held) => held,
            Err(e) => {
                slots.free.push(slot);
                return Err(e);
            }
        };
        self.changes.push(held.change(key.level, slot));
        if missing == 0 {
            self.beside.0 += held.beside();
            self.beside.1 += 1;
        }
        slots.slots[slot as usize] = Some(held);
        let pages = resident.levels[l].pages.as_mut().expect("a paged level has pages");
        let place = pages.place(key.x, key.z);
        pages.slots[place] = slot;
        self.changes.push(Change::Pages { level: key.level });
        Ok(Some(evicted))
    }

    /// Makes what is shown instead of tiles from the nearest coarser ones that are there.
    fn stand_in(&mut self, resident: &mut Resident, keys: &[TileKey], paging: &mut Paging) -> Result<()> {
        let (pager, tables) = (&*self, &*resident);
        let make = |&key: &TileKey| {
            let (k, from) = pager.nearest(tables, key)?;
            Some((key, k, stand_in(tables, key, k, from)))
        };
        let made: Vec<_> = keys.par_iter().filter_map(make).collect();
        for (key, k, tile) in made {
            if let Some(evicted) = self.install(resident, key, k, &tile, self.frame)? {
                paging.evicted += u32::from(evicted);
            }
        }
        Ok(())
    }

    /// How many levels above a tile the nearest is that can stand in for it, and in which slot; `None` where what stands for the
    /// tile is as good, or nothing is there.
    fn nearest(&self, resident: &Resident, key: TileKey) -> Option<(u32, u32)> {
        let (mut above, mut k) = (key.parent(), 1);
        while above.level < self.levels.len() as u32 && self.lacks(resident, above) {
            (above, k) = (above.parent(), k + 1);
        }
        // What stands there already may be of a tile that has gone since.
        let stands = self.missing(resident, key).is_some_and(|stands| stands <= k);
        if stands || above.level >= self.levels.len() as u32 {
            return None;
        }
        // Of an empty tile only slot 0 is: at its place there may be one that is a whole window away.
        let slot = if self.held(resident, above).is_some() { Pager::slot_at(resident, above) } else { 0 };
        Some((k, slot))
    }
}

/// Writes a tile into a slot that is free. Parts of the other tables that it took are given back on an error.
fn put(slots: &mut Slots, level: &mut ResidentLevel, slot: u32, held: Slot, tile: &ResidentLevel) -> Result<Slot> {
    let mut held = held;
    match write(slots, level, slot, &mut held, tile) {
        Ok(()) => Ok(held),
        Err(e) => {
            slots.give(held);
            Err(e)
        }
    }
}

fn write(slots: &mut Slots, level: &mut ResidentLevel, slot: u32, held: &mut Slot, tile: &ResidentLevel) -> Result<()> {
    let out_of = |what: &str| Error::Limit(format!("a level with more than 2³² words of {what} at once"));
    let at = slot as usize * COLUMNS;
    let (nx, nz) = (tile.nx as usize, tile.nz as usize);
    let row = |z: usize| at + z * TILE as usize;
    let part = |at: &Range<u32>| at.start as usize..at.end as usize;
    match (&mut level.table, &tile.table) {
        (Table::Heights(out), Table::Heights(heights)) => {
            if (nx, nz) != (TILE as usize, TILE as usize) {
                out[at..at + COLUMNS].fill(0);
            }
            for z in 0..nz {
                out[row(z)..row(z) + nx].copy_from_slice(&heights[z * nx..(z + 1) * nx]);
            }
        }
        (Table::Runs { columns: out, runs: all }, Table::Runs { columns, runs }) => {
            // Word 0 of a tile is unused.
            held.runs = slots.runs.take(runs.len() as u32 - 1).ok_or_else(|| out_of("runs"))?;
            grow(all, slots.runs.end)?;
            all[part(&held.runs)].copy_from_slice(&runs[1..]);
            let shift = held.runs.start.wrapping_sub(1);
            out[at..at + COLUMNS].fill([EMPTY, 0]);
            for z in 0..nz {
                for (out, &[top, more]) in out[row(z)..].iter_mut().zip(&columns[z * nx..(z + 1) * nx]) {
                    *out = [top, if more == 0 { 0 } else { more.wrapping_add(shift) }];
                }
            }
        }
        _ => unreachable!("tiles are read as the world's tables are"),
    }
    let blocks = &mut level.blocks[slot as usize * BLOCKS..][..BLOCKS];
    blocks.fill(EMPTY);
    let (across, side) = (nx.div_ceil(1 << BLOCK_SHIFT), (TILE >> BLOCK_SHIFT) as usize);
    for (out, row) in blocks.chunks_mut(side).zip(tile.blocks.chunks(across.max(1))) {
        out[..row.len()].copy_from_slice(row);
    }
    match (&mut level.paint, &tile.paint) {
        (Paint::None | Paint::Height { .. }, _) => {}
        (Paint::Column { colors: out }, Paint::Column { colors }) => {
            for z in 0..nz {
                out[row(z)..row(z) + nx].copy_from_slice(&colors[z * nx..(z + 1) * nx]);
            }
        }
        (Paint::Run { base: out, colors: all }, Paint::Run { base, colors }) => {
            held.colors = slots.colors.take(colors.len() as u32).ok_or_else(|| out_of("colours"))?;
            grow(all, slots.colors.end)?;
            all[part(&held.colors)].copy_from_slice(colors);
            for z in 0..nz {
                for (out, &base) in out[row(z)..].iter_mut().zip(&base[z * nx..(z + 1) * nx]) {
                    *out = base + held.colors.start;
                }
            }
        }
        (Paint::Top { starts: out, colors: all }, Paint::Top { colors, .. } | Paint::Column { colors }) => {
            held.colors = slots.colors.take(colors.len() as u32).ok_or_else(|| out_of("colours"))?;
            grow(all, slots.colors.end)?;
            all[part(&held.colors)].copy_from_slice(colors);
            let out = &mut out[slot as usize * STARTS..][..STARTS];
            put_starts(out, [nx, nz], |ix| {
                held.colors.start
                    + match &tile.paint {
                        Paint::Top { starts, .. } => starts[ix],
                        _ => ix as u32,
                    }
            });
        }
        (Paint::Voxel { base: out, exposed: all, colors: every }, Paint::Voxel { base, exposed, colors }) => {
            held.exposed = slots.exposed.take(exposed.len() as u32).ok_or_else(|| out_of("exposed runs"))?;
            held.colors = slots.colors.take(colors.len() as u32).ok_or_else(|| out_of("colours"))?;
            grow(all, slots.exposed.end)?;
            grow(every, slots.colors.end)?;
            for (out, &[run, at]) in all[part(&held.exposed)].iter_mut().zip(exposed.iter()) {
                *out = [run, at + held.colors.start];
            }
            every[part(&held.colors)].copy_from_slice(colors);
            let out = &mut out[slot as usize * STARTS..][..STARTS];
            put_starts(out, [nx, nz], |ix| base[ix] + held.exposed.start);
        }
        _ => unreachable!("tiles are read as the world's tables are"),
    }
    Ok(())
}

/// Writes where the columns of a slot begin, of a tile that may be smaller: what it lacks begins and ends where the next does.
fn put_starts(out: &mut [u32], [nx, nz]: [usize; 2], start: impl Fn(usize) -> u32) {
    let (rows, rest) = out.split_at_mut(nz * TILE as usize);
    for (z, row) in rows.chunks_mut(TILE as usize).enumerate() {
        let (own, beyond) = row.split_at_mut(nx);
        own.iter_mut().zip(z * nx..).for_each(|(out, ix)| *out = start(ix));
        beyond.fill(start((z + 1) * nx));
    }
    rest.fill(start(nz * nx));
}

/// The tables of a tile, from one that is `k` levels coarser and stands in a slot.
fn stand_in(resident: &Resident, key: TileKey, k: u32, slot: u32) -> ResidentLevel {
    let level = &resident.levels[(key.level + k) as usize];
    let [nx, nz] = tile_size(resident.dims, key);
    let height = u32::from(u16::MAX) + 1;
    // A run as fine as this tile's: a coarse level's world may be higher than a fine one's.
    let finer = |run: Run| -> Option<Run> {
        let first = u64::from(run.first()) << k;
        let end = (u64::from(run.end()) << k).min(height.into());
        (first < end).then(|| Run::new(first as u16, (end - 1) as u16))
    };
    // Columns that show the same one of the coarser tile are a cell: 2^`shift` along each axis.
    let shift = k.min(TILE_SHIFT);
    let [cells_x, cells_z] = [nx, nz].map(|n| n.div_ceil(1 << shift));
    let above: Vec<usize> = (0..cells_z)
        .flat_map(|z| (0..cells_x).map(move |x| [x, z]))
        .map(|[x, z]| {
            let [x, z] = [key.x * TILE + (x << shift), key.z * TILE + (z << shift)].map(|at| (at >> k) % TILE);
            (slot << (2 * TILE_SHIFT) | z << TILE_SHIFT | x) as usize
        })
        .collect();
    let size = [nx as usize, nz as usize];
    let table = match &level.table {
        Table::Heights(heights) => {
            let finer = |&ix: &usize| (u32::from(heights[ix]) << k).min(u16::MAX.into()) as u16;
            Table::Heights(spread(&above.iter().map(finer).collect::<Vec<u16>>(), size, shift))
        }
        Table::Runs { .. } => {
            let (mut columns, mut runs) = (Vec::with_capacity(above.len()), vec![0u32]);
            for &ix in &above {
                let mut of_column = level.column(ix).filter_map(&finer);
                let Some(top) = of_column.next() else {
                    columns.push([EMPTY, 0]);
                    continue;
                };
                let at = runs.len();
                runs.push(0);
                runs.extend(of_column.map(|run| run.0));
                let rest = (runs.len() - at - 1) as u32;
                if rest == 0 {
                    runs.pop();
                    columns.push([top.0, 0]);
                } else {
                    runs[at] = rest;
                    columns.push([top.0, at as u32]);
                }
            }
            Table::Runs { columns: spread(&columns, size, shift), runs }
        }
    };
    let paint = match &level.paint {
        // What tints a world by height does so by level.
        Paint::None | Paint::Height { .. } => Paint::None,
        Paint::Column { colors } => {
            let colors: Vec<u32> = above.iter().map(|&ix| colors[ix]).collect();
            Paint::Column { colors: spread(&colors, size, shift) }
        }
        Paint::Run { base, colors } => {
            let (mut bases, mut all) = (Vec::with_capacity(above.len()), Vec::new());
            for &ix in &above {
                bases.push(all.len() as u32);
                // Runs that are cut off are the topmost.
                let kept = level.column(ix).zip(0usize..).filter(|&(run, _)| finer(run).is_some());
                all.extend(kept.map(|(_, i)| colors[base[ix] as usize + i]));
            }
            Paint::Run { base: spread(&bases, size, shift), colors: all }
        }
        // One colour a column, of its top.
        Paint::Top { starts, colors } => {
            let color = |&ix: &usize| level.own_colors(starts, colors, ix).0.last().copied().unwrap_or(0);
            Paint::Column { colors: spread(&above.iter().map(color).collect::<Vec<u32>>(), size, shift) }
        }
        Paint::Voxel { base, exposed, colors } => {
            // One colour for each exposed run: that of its highest voxel. A stand-in is seen for moments.
            let (mut starts, mut of_cells, mut all) = (vec![0], Vec::new(), Vec::new());
            for &ix in &above {
                for &[run, at] in level.exposed(base, exposed, ix) {
                    let voxels = u32::from(Run(run).last() - Run(run).first());
                    let (first, last) = (u64::from(Run(run).first()) << k, u64::from(Run(run).last()) << k);
                    if first >= height.into() {
                        continue;
                    }
                    let last = last.min(u64::from(height) - 1);
                    for y in [first, last].into_iter().take(1 + usize::from(voxels > 0)) {
                        of_cells.push([Run::new(y as u16, y as u16).0, all.len() as u32]);
                        all.push(colors[(at + if y == first { 0 } else { voxels }) as usize]);
                    }
                }
                starts.push(of_cells.len());
            }
            // Columns have exposed runs of their own; colours they share.
            let (mut bases, mut runs) = (vec![0u32], Vec::new());
            for z in 0..size[1] {
                for x in 0..size[0] {
                    let cell = (z >> shift) * cells_x as usize + (x >> shift);
                    runs.extend_from_slice(&of_cells[starts[cell]..starts[cell + 1]]);
                    bases.push(runs.len() as u32);
                }
            }
            Paint::Voxel { base: bases, exposed: runs, colors: all }
        }
    };
    let mut tile = ResidentLevel { nx, nz, table, blocks: Vec::new(), bottom: 0, top: 0, paint, pages: None };
    tile.blocks = blocks_of(&tile, shift);
    tile
}

/// Values of cells as values of the columns that they consist of, 2^`shift` along each axis.
fn spread<T: Copy>(cells: &[T], [nx, nz]: [usize; 2], shift: u32) -> Vec<T> {
    let mut out = Vec::with_capacity(nx * nz);
    for row in cells.chunks(nx.div_ceil(1 << shift)) {
        let start = out.len();
        out.extend((0..nx).map(|x| row[x >> shift]));
        for _ in 1..(nz - start / nx).min(1 << shift) {
            out.extend_from_within(start..start + nx);
        }
    }
    out
}

/// Height bounds of the blocks of a tile of which 2^`shift` columns along each axis are the same.
fn blocks_of(tile: &ResidentLevel, shift: u32) -> Vec<u32> {
    let [across, along] = [tile.nx, tile.nz].map(|n| n.div_ceil(1 << BLOCK_SHIFT) as usize);
    let mut blocks = vec![EMPTY; across * along];
    let step = 1usize << shift.min(BLOCK_SHIFT);
    for z in (0..tile.nz).step_by(step) {
        for x in (0..tile.nx).step_by(step) {
            let ix = tile.index(x, z);
            let [top, _] = tile.entry(ix);
            if top == EMPTY {
                continue;
            }
            let top = Run(top);
            widen(&mut blocks[tile.block(x, z)], tile.column(ix).last().unwrap_or(top), top);
        }
    }
    blocks
}

/// Makes a level's tables of so many slots, after some have moved to another.
fn resize_tables(level: &mut ResidentLevel, n: usize, moves: &[(usize, usize)]) -> Result<()> {
    match &mut level.table {
        Table::Heights(heights) => resize(heights, COLUMNS, n, moves)?,
        Table::Runs { columns, .. } => resize(columns, COLUMNS, n, moves)?,
    }
    resize(&mut level.blocks, BLOCKS, n, moves)?;
    match &mut level.paint {
        Paint::None | Paint::Height { .. } => Ok(()),
        Paint::Column { colors: table } | Paint::Run { base: table, .. } => resize(table, COLUMNS, n, moves),
        Paint::Top { starts: table, .. } | Paint::Voxel { base: table, .. } => resize(table, STARTS, n, moves),
    }
}

/// The same of one table, whose slots have so many elements.
fn resize<T: Zeroable + Copy>(table: &mut Vec<T>, of_slot: usize, n: usize, moves: &[(usize, usize)]) -> Result<()> {
    for &(from, to) in moves {
        table.copy_within(from * of_slot..(from + 1) * of_slot, to * of_slot);
    }
    let more = (n * of_slot).saturating_sub(table.len());
    table.try_reserve_exact(more).map_err(|_| no_memory::<T>(more))?;
    table.resize(n * of_slot, T::zeroed());
    table.shrink_to_fit();
    Ok(())
}

/// Makes a table as long as its parts are.
fn grow<T: Zeroable + Clone>(table: &mut Vec<T>, n: u32) -> Result<()> {
    let n = table.len().max(n as usize);
    table.try_reserve(n - table.len()).map_err(|_| no_memory::<T>(n - table.len()))?;
    table.resize(n, T::zeroed());
    Ok(())
}

fn no_memory<T>(n: usize) -> Error {
    Error::Limit(format!("no memory for {} MiB of tiles more", (n * size_of::<T>()) >> 20))
}

#[cfg(test)]
mod extremes;
#[cfg(test)]
mod mock;
#[cfg(test)]
mod model;

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use planecast_encoder::{About, BuildOptions, Colors, Columns, Encoding, Input, Scene, build};

    use super::mock::{Fault, Mock};
    use super::*;
    use crate::cpu::renderer::{CpuRenderer, Outputs};
    use crate::render::device::{Device, Renderer};
    use crate::testing::noise;
    use crate::{Camera, Options};

    /// Hills, or caves, of several tiles whose last ones are cut off.
    pub(super) fn scene(caves: bool, color: ColorMode, encoding: Encoding) -> Scene {
        let hill = |x: u32, z: u32| {
            let bump = |s: f32| ((x as f32 / s).sin() + (z as f32 / s).cos()) * s / 6.0;
            (40.0 + bump(90.0) + bump(17.0)) as u32
        };
        let solid = move |x: u32, y: u32, z: u32| match caves {
            false => y < hill(x, z),
            true => (y < hill(x, z) && !(y / 5 + x / 9 + z / 7).is_multiple_of(4)) || y == 0,
        };
        let columns = Columns::from_fn(1300, 90, 1100, solid);
        let of = |x, y: u32, z| noise(x / 40, y / 8, z / 40).to_le_bytes()[..3].try_into().unwrap();
        let input = Input { columns, colors: Colors::Function(Box::new(of)), notes: Vec::new() };
        build(input, &BuildOptions { encoding, color: Some(color), ..BuildOptions::default() }).unwrap()
    }

    pub(super) fn cameras() -> Vec<Camera> {
        let pose = |eye: [f64; 3], yaw: f64, pitch: f64, roll: f64| Camera {
            eye: DVec3::from_array(eye),
            yaw,
            pitch,
            roll,
            fov: 60.0,
            width: 96,
            height: 64,
        };
        vec![
            pose([640.5, 70.0, 500.2], 30.0, -10.0, 0.0),
            pose([100.0, 60.0, 90.0], 130.0, 0.0, 0.0),
            pose([1200.0, 200.0, 1000.0], 300.0, -50.0, 20.0),
            pose([650.0, 400.0, 550.0], 0.0, -90.0, 0.0),
            pose([-300.0, 150.0, 1500.0], 50.0, -12.0, -35.0),
            pose([640.5, 70.0, 500.2], 210.0, -10.0, 0.0),
        ]
    }

    #[test]
    fn paged_pictures_are_those_of_the_whole_world() {
        let tint = Tint::new("turbo", &About::default()).unwrap();
        let worlds = [
            (false, ColorMode::Run, Encoding::Solid, None),
            (false, ColorMode::Voxel, Encoding::Solid, None),
            (true, ColorMode::Run, Encoding::Solid, None),
            (true, ColorMode::Voxel, Encoding::Surface, None),
            (false, ColorMode::Run, Encoding::Solid, tint.clone()),
            (true, ColorMode::Voxel, Encoding::Solid, tint),
        ];
        for (caves, color, encoding, tint) in worlds {
            let scene = Arc::new(scene(caves, color, encoding));
            let mut resident = Resident::new(&scene);
            if let Some(tint) = &tint {
                tint.paint(&mut resident);
            }
            let (resident, color) = (Arc::new(resident), if tint.is_some() { ColorMode::None } else { color });
            let mut whole = CpuRenderer::new(&scene, &resident);
            // Told to be heights whether it is or not: caves show otherwise.
            let source = Mock::new(&scene, true);
            let slot = slot_bytes(!caves, color);
            let mut evicted = 0;
            // Not for all of level 0, then for all.
            for (slots, lods) in
                [(if caves { 90 } else { 60 }, &[Some(1.0), Some(3.0)][..]), (if caves { 600 } else { 160 }, &[None])]
            {
                let budget = slots * slot;
                let mut paged =
                    Renderer::of_tiles(source.clone(), Device::Cpu, budget, Patience::Wait, tint.clone(), &mut |_| ())
                        .unwrap();
                paged.set_count(true);
                for (i, camera) in cameras().iter().enumerate() {
                    for &lod in lods {
                        let options = Options { lod, ..Options::default() };
                        let expected = whole.render(camera, &options, Outputs { voxel: true }).unwrap();
                        let frame = paged.draw_with(camera, &options, Outputs { voxel: true }, &mut |_| ()).unwrap();
                        let what = format!("caves {caves}, {color:?}, {encoding:?}, {tint:?}, camera {i}, lod {lod:?}");
                        assert!(frame.stats.paging.bytes_resident <= budget, "{what}");
                        assert_eq!(frame.stats.paging.lod, lod.unwrap_or(0.0), "{what}");
                        assert!(frame.voxel == expected.voxel, "{what}");
                        assert!(frame.color == expected.color && frame.depth == expected.depth, "{what}");
                        let paging = frame.stats.paging;
                        assert_eq!((paging.debt, paging.tiles_missing), (0, 0), "{what}");
                        assert!(paging.tiles_used <= paging.tiles_wanted, "{what}: {paging:?}");
                        evicted += paging.tiles_evicted;
                    }
                }
            }
            assert!(evicted > 0 || caves);
            assert!(source.asked() > 20);
        }
    }

    #[test]
    fn tiles_that_cannot_be_had_are_stood_in_for_until_they_can() {
        for (caves, color) in [(false, ColorMode::Voxel), (true, ColorMode::Voxel), (true, ColorMode::Run)] {
            let scene = Arc::new(scene(caves, color, Encoding::Solid));
            let resident = Arc::new(Resident::new(&scene));
            let mut whole = CpuRenderer::new(&scene, &resident);
            let source = Mock::new(&scene, !caves);
            source.set(|key| (key.level < 2).then_some(Fault::Out));
            let mut paged =
                Renderer::of_tiles(source.clone(), Device::Cpu, 64 << 20, Patience::Wait, None, &mut |_| ()).unwrap();
            let camera = cameras()[0];
            let options = Options::default();
            let mut said = Vec::new();
            let coarse =
                paged.draw_with(&camera, &options, Outputs::default(), &mut |w| said.push(w.to_owned())).unwrap();
            let sharp = whole.render(&camera, &options, Outputs::default()).unwrap();
            assert!(coarse.stats.paging.debt > 1000 && coarse.color != sharp.color);
            assert!(said.iter().any(|what| what.contains("is out") && what.contains("coarser")), "{said:?}");
            // As whole as the picture that it should be: no sky where there is ground, nor the other way round, but at edges.
            let pixels = coarse.depth.iter().zip(&sharp.depth);
            let off = pixels.filter(|(a, b)| a.is_finite() != b.is_finite()).count();
            assert!(off < 96, "{off} pixels are sky in one and not in the other");
            source.set(|_| None);
            let frame = paged.draw_with(&camera, &options, Outputs::default(), &mut |_| ()).unwrap();
            assert!(frame.color == sharp.color && frame.stats.paging.debt == 0);
        }
    }

    #[test]
    fn frames_with_a_deadline_are_whole_and_become_sharp() {
        let scene = Arc::new(scene(true, ColorMode::Voxel, Encoding::Solid));
        let resident = Arc::new(Resident::new(&scene));
        let mut whole = CpuRenderer::new(&scene, &resident);
        let source = Mock::new(&scene, false);
        let mut paged =
            Renderer::of_tiles(source, Device::Cpu, 64 << 20, Patience::Deadline(0.0), None, &mut |_| ()).unwrap();
        let options = Options::default();
        let mut owed = 0;
        for camera in cameras() {
            let sharp = whole.render(&camera, &options, Outputs::default()).unwrap();
            let mut frames = 0;
            loop {
                let frame = paged.draw_with(&camera, &options, Outputs::default(), &mut |_| ()).unwrap();
                owed += frame.stats.paging.debt;
                if frame.stats.paging.tiles_missing == 0 {
                    assert!(frame.color == sharp.color);
                    break;
                }
                frames += 1;
                assert!(frames < 100_000, "the tiles never came");
                std::thread::yield_now();
            }
        }
        assert!(owed > 0);
    }

    #[test]
    fn planes_that_are_looked_at_together_want_what_each_wants_and_little_more() {
        let scene = scene(true, ColorMode::None, Encoding::Solid);
        let resident = Resident::new(&scene);
        let mut totals = [0, 0];
        for (i, camera) in cameras().into_iter().enumerate() {
            for (lod, size) in [(Some(1.0), [96, 64]), (None, [96, 64]), (Some(0.3), [1500, 900]), (None, [7, 5])] {
                let camera = Camera { width: size[0], height: size[1], ..camera };
                let plan =
                    crate::frame::plan::FramePlan::new(&resident, &camera, &Options { lod, ..Options::default() });
                let [each, together] = [1, TOGETHER].map(|n| wanted_by(&plan.setup, resident.dims, n).unwrap());
                let planes: HashMap<TileKey, u32> = together.iter().map(|w| (w.key, w.planes)).collect();
                for w in &each {
                    let found = planes.get(&w.key).copied().unwrap_or(0);
                    assert!(found >= w.planes, "camera {i}, lod {lod:?}, {size:?}: {w:?}, together {found}");
                }
                totals = [totals[0] + each.len(), totals[1] + together.len()];
            }
        }
        assert!(totals[0] > 300 && totals[1] * 100 <= totals[0] * 104, "{totals:?}");
    }

    #[test]
    fn parts_are_given_and_taken_without_overlap() {
        let mut parts = Parts::default();
        let mut held: Vec<Range<u32>> = Vec::new();
        for k in 0..5000 {
            let random = noise(k, 3, 9);
            if random % 5 < 3 {
                let part = parts.take(random / 7 % 90).unwrap();
                assert!(held.iter().all(|h| part.is_empty() || part.end <= h.start || part.start >= h.end), "{part:?}");
                held.push(part);
            } else if !held.is_empty() {
                let i = random as usize / 5 % held.len();
                parts.give(held.swap_remove(i));
            }
            let used: u32 = held.iter().map(|h| h.end - h.start).sum();
            let free: u32 = parts.free.values().sum();
            assert_eq!(used + free, parts.end);
        }
        held.drain(..).for_each(|h| parts.give(h));
        assert_eq!((parts.end, parts.free.len()), (0, 0));
    }

    #[test]
    fn budgets_that_hold_no_view_raise_the_level_of_detail() {
        let scene = Arc::new(scene(true, ColorMode::None, Encoding::Solid));
        let source = Mock::new(&scene, false);
        // From so far above that all of it is drawn at level 0.
        let eye = DVec3::new(650.0, 800.0, 550.0);
        let camera = Camera { eye, pitch: -90.0, width: 1280, height: 960, ..cameras()[0] };
        let slot = slot_bytes(false, ColorMode::None);
        let draw = |slots: u64| {
            let mut paged =
                Renderer::of_tiles(source.clone(), Device::Cpu, slots * slot, Patience::Wait, None, &mut |_| ())?;
            paged.draw_with(&camera, &Options::default(), Outputs::default(), &mut |_| ())
        };
        let [fine, coarse] = [200, 25].map(|slots| draw(slots).unwrap().stats.paging);
        assert_eq!((fine.lod, fine.debt), (1.0, 0));
        assert!(coarse.lod > 1.0 && coarse.lod < 20.0 && coarse.debt == 0, "{coarse:?}");
        for slots in [0, 3] {
            let error = draw(slots).unwrap_err().to_string();
            assert!(error.contains("mock") && error.contains("KiB"), "{error}");
        }
    }
}
