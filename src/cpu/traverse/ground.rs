//! Stage `traverse` over ground: heights seen from above the ground's underside ([`Feature::Horizon`]), the same picture as
//! [`super`] draws, to the bit.
//!
//! Heights seen so show nothing below what is nearer: the foot of a column lies below what the one before it reaches. So the
//! window's lower end alone tells what a column shows, and there are no bits, no center and no bottom faces. What a
//! column shows is then known from the sample that its top reaches, which does not depend on other columns, and the highest
//! one before it. So columns are not taken one by one, and none waits for what another shows:
//!
//! 1. *Strip.* Of eight slices of the plane's longer axis, each one column or two, crossings, heights and samples are
//!    worked out side by side. A strip whose blocks lie below the window is jumped over.
//! 2. *Horizon.* A running maximum over the strip's samples leaves the columns that show: [`Item`]s.
//! 3. *Paint.* Where a level or the plane ends, items tell samples their depth and where their colour stands, in whole
//!    lanes: what is written beyond a span is written over by those that follow. Then all colours are read at once, so that
//!    those which are not in the cache are waited for together.
//!
//! Where a foot does show (the first column of a world seen from outside) what is open below it stays open: beneath the
//! ground nothing follows. That holds but for rounding; the walk looks for feet that rounding puts lower, and for a second
//! gap (behind empty columns), and goes on in the general way there. Counters are not those of the general walk: what is not
//! looked at is not counted, and of a strip all that the plane passes is.
//!
//! [`Feature::Horizon`]: crate::frame::specialize::Feature::Horizon

use super::{Counters, LANES as FILL, Real, SKY, Start, Task1, Walk, low_bits, scaled};
use crate::world::tables::{BLOCK_SHIFT, Paint, ResidentLevel, Table};
use planecast_encoder::Run;

/// Slices of a strip: as many columns as a block has a side.
const SLICES: usize = 1 << BLOCK_SHIFT;

/// Columns of a strip: the first of each slice, then the second of each.
const LANES: usize = 2 * SLICES;

/// Items that a plane keeps until they are painted: their numbers fit 16 bits.
const MANY: usize = u16::MAX as usize - LANES;

/// Memory that a task's planes share one after the other.
pub(super) struct Scratch<R> {
    items: Vec<Item<R>>,
    samples: Samples,
}

impl<R> Default for Scratch<R> {
    fn default() -> Self {
        Scratch { items: Vec::new(), samples: Samples::default() }
    }
}

/// What samples show, in arrays that reach [`FILL`] beyond them.
#[derive(Default)]
struct Samples {
    depth: Vec<f32>,
    /// Where their colour stands among the level's.
    color: Vec<u32>,
    /// Of samples with voxels: the item, and the height in its column.
    item: Vec<u16>,
    y: Vec<u32>,
}

/// A column that shows.
struct Item<R> {
    column: u32,
    height: u32,
    /// Where the plane enters it, and how far its top is from the eye's height.
    t0: R,
    up: R,
    /// The samples where its front begins, its top, and what follows.
    at: [u32; 3],
    /// Unless there are no voxels.
    x: i32,
    z: i32,
}

/// Some columns that a plane passes one after the other, in lanes: lane `s` is the first of slice `s`, lane
/// `SLICES + s` the second. Those that it does not pass have `t1 <= t0`, and number 0.
struct Strip<R> {
    t0: [R; LANES],
    t1: [R; LANES],
    /// How many cells from the first one, along the plane's longer axis and the other.
    at: [[i32; LANES]; 2],
    column: [u32; LANES],
    /// The first one's cell, and the longer axis.
    first: [i32; 2],
    major: usize,
}

/// What [`Strip`]s are worked out from, in lines and cells of a level.
struct Grid<'a, R> {
    dir: [R; 2],
    inverse: [R; 2],
    fract: [R; 2],
    eye: [i32; 2],
    step: [i32; 2],
    ahead: [i32; 2],
    size: [i32; 2],
    repeats: [bool; 2],
    level: u32,
    /// Where its columns stand.
    tables: &'a ResidentLevel,
    /// The axis that the plane follows most.
    major: usize,
    /// 0 to `SLICES − 1`, as numbers that a compiler does not know: it would unroll the first, and write vectors in parts.
    slices: [i32; SLICES],
}

impl<R: Real> Grid<'_, R> {
    /// As in the general walk.
    #[inline(always)]
    fn cross(&self, axis: usize, line: i32) -> R {
        if self.dir[axis] == R::ZERO {
            return R::STEEP;
        }
        (R::from_i32((line << self.level).wrapping_sub(self.eye[axis])) - self.fract[axis]) * self.inverse[axis]
    }

    /// Whether no column is there.
    #[inline(always)]
    fn outside(&self, axis: usize, cell: i32) -> bool {
        !self.repeats[axis] && !(0..self.size[axis]).contains(&cell)
    }

    /// A column's place in the world's first period.
    #[inline(always)]
    fn wrap(&self, axis: usize, cell: i32) -> i32 {
        if (0..self.size[axis]).contains(&cell) { cell } else { cell.rem_euclid(self.size[axis]) }
    }

    /// The cell along `axis` at `t`, `from` or at most `n` further: estimated, then put right.
    #[inline(always)]
    fn reached(&self, axis: usize, t: R, from: i32, n: i32) -> i32 {
        let (step, ahead) = (self.step[axis], self.ahead[axis]);
        let to = from + n * step;
        let at = (self.fract[axis] + t * self.dir[axis]).floor_i32().wrapping_add(self.eye[axis]) >> self.level;
        let mut at = at.clamp(from.min(to), from.max(to));
        while at != from && self.cross(axis, at + 1 - ahead) > t {
            at -= step;
        }
        while at != to && self.cross(axis, at + ahead) <= t {
            at += step;
        }
        at
    }

    /// The columns of `n` whole slices from `cell` at `t0` on, which end at `t_end`; `wrapped` is its place in the world's
    /// first period. False where the numbers do not tell what comes after what.
    #[inline(always)]
    fn strip(&self, strip: &mut Strip<R>, t0: R, t_end: R, n: i32, cell: [i32; 2], wrapped: [i32; 2]) -> bool {
        let (major, minor) = (self.major, 1 - self.major);
        let level = self.level;
        let [from_major, from_minor] = [cell[major], cell[minor]];
        let (step_major, step_minor) = (self.step[major], self.step[minor]);
        let first_line = ((from_major - step_major + self.ahead[major]) << level).wrapping_sub(self.eye[major]);
        let (fract_major, inverse_major) = (self.fract[major], self.inverse[major]);
        let (dir_minor, inverse_minor) = (self.dir[minor], self.inverse[minor]);
        let (fract_minor, eye_minor, ahead_minor) = (self.fract[minor], self.eye[minor], self.ahead[minor]);
        // Where the plane runs along an axis, nothing that could make the distance to its lines 0.
        let within = if dir_minor == R::ZERO { R::ZERO } else { fract_minor };
        let (size, forward) = (self.size[minor], step_minor > 0);
        let mut as_told = true;
        let stride = if major == 0 { [1, self.size[0]] } else { [self.size[0], 1] };
        (strip.first, strip.major) = (cell, major);
        let [at_major, at_minor] = &mut strip.at;
        for s in 0..SLICES {
            let k = self.slices[s];
            let line = first_line.wrapping_add((k * step_major) << level);
            let enter = (R::from_i32(line) - fract_major) * inverse_major;
            let leave = (R::from_i32(line.wrapping_add(step_major << level)) - fract_major) * inverse_major;
            let reached = |t: R| {
                let at = (fract_minor + t * dir_minor).floor_i32().wrapping_add(eye_minor) >> level;
                if forward { at.max(from_minor) } else { at.min(from_minor) }
            };
            let in_minor = if k == 0 { from_minor } else { reached(enter) };
            let out_minor = reached(leave);
            let line = (in_minor.wrapping_add(ahead_minor) << level).wrapping_sub(eye_minor);
            let turn = (R::from_i32(line) - within) * inverse_minor;
            let told = in_minor.wrapping_add(if turn <= leave { step_minor } else { 0 });
            as_told &= (k >= n) | (out_minor == told);
            let enter = if k == 0 { t0 } else { t0.max(enter) };
            let leave = leave.min(t_end);
            (strip.t0[s], strip.t1[s]) = (enter, turn.min(leave));
            (strip.t0[SLICES + s], strip.t1[SLICES + s]) = (enter.max(turn), leave);
            (at_major[s], at_major[SLICES + s]) = (k * step_major, k * step_major);
            let at = in_minor.wrapping_sub(from_minor);
            (at_minor[s], at_minor[SLICES + s]) = (at, at.wrapping_add(step_minor));
        }
        for i in 0..LANES {
            let at = wrapped[minor].wrapping_add(at_minor[i]);
            let at = if at >= size { at - size } else { at };
            let at = if at < 0 { at.wrapping_add(size) } else { at };
            let column = ((wrapped[major] + at_major[i]) as u32)
                .wrapping_mul(stride[0] as u32)
                .wrapping_add((at as u32).wrapping_mul(stride[1] as u32));
            strip.column[i] = if strip.t1[i] > strip.t0[i] { column } else { 0 };
        }
        if let Some(pages) = &self.tables.pages {
            for i in 0..LANES {
                let at = wrapped[minor].wrapping_add(at_minor[i]);
                let at = if at >= size { at - size } else { at };
                let at = (if at < 0 { at.wrapping_add(size) } else { at }) as u32;
                let along = (wrapped[major] + at_major[i]) as u32;
                let [x, z] = if major == 0 { [along, at] } else { [at, along] };
                strip.column[i] = if strip.t1[i] > strip.t0[i] { pages.index(x, z) as u32 } else { 0 };
            }
        }
        as_told
    }

    /// The same column by column, up to `limit`, `stop`, the world's end or as many columns as a strip has. Moves on `t0` and
    /// `cell`.
    #[cold]
    #[inline(never)]
    fn step_by_step(&self, strip: &mut Strip<R>, t0: &mut R, limit: R, stop: i32, cell: &mut [i32; 2]) {
        *strip = Strip { first: *cell, major: self.major, ..Strip::NONE };
        let mut n = 0;
        loop {
            let next = [0, 1].map(|axis| self.cross(axis, cell[axis] + self.ahead[axis]));
            let along = usize::from(next[1] < next[0]);
            let t1 = next[along].min(limit);
            if t1 > *t0 {
                let i = lane(n);
                (strip.t0[i], strip.t1[i]) = (*t0, t1);
                for (k, axis) in [(0, self.major), (1, 1 - self.major)] {
                    strip.at[k][i] = cell[axis] - strip.first[axis];
                }
                let [x, z] = [0, 1].map(|axis| self.wrap(axis, cell[axis]) as u32);
                strip.column[i] = self.tables.index(x, z) as u32;
                n += 1;
                *t0 = t1;
            }
            if *t0 >= limit {
                return;
            }
            cell[along] += self.step[along];
            if cell[self.major] == stop || self.outside(along, cell[along]) || n == LANES {
                return;
            }
        }
    }
}

/// Where the column that is passed as number `n` stands.
#[inline(always)]
const fn lane(n: usize) -> usize {
    n / 2 + SLICES * (n % 2)
}

impl<R: Real> Strip<R> {
    const NONE: Strip<R> = Strip {
        t0: [R::ZERO; LANES],
        t1: [R::ZERO; LANES],
        at: [[0; LANES]; 2],
        column: [0; LANES],
        first: [0; 2],
        major: 0,
    };

    /// x and z of the column in lane `i`.
    #[inline(always)]
    fn cell(&self, i: usize) -> [i32; 2] {
        let at = [self.at[0][i], self.at[1][i]];
        [0, 1].map(|axis| self.first[axis] + at[usize::from(axis != self.major)])
    }
}

/// A strip's columns as they show.
struct Shape<R> {
    height: [i32; LANES],
    top: [R; LANES],
    /// The samples that its top begins and ends at, as far as the window holds them.
    front: [i32; LANES],
    end: [i32; LANES],
}

/// A plane's walk over ground.
struct Ground<'a, R: Real, const VOXEL: bool> {
    walk: Walk<'a, R, VOXEL, true, true>,
    items: &'a mut Vec<Item<R>>,
    samples: &'a mut Samples,
    /// Samples from here to the window's lower end wait to be painted.
    painted: i32,
    /// Height of the ground's underside.
    foot: R,
    /// Below a foot that showed, the open samples, none where equal; the slope at their upper end.
    gap: [i32; 2],
    s_gap: R,
}

/// Walks one plane.
#[inline(always)]
pub(super) fn walk<R: Real, const VOXEL: bool>(task: Task1<'_>, scratch: &mut super::Scratch<R>) -> Counters {
    let n = task.depth.len();
    let super::Scratch { walk, ground: Scratch { items, samples } } = scratch;
    let walk = Walk::<R, VOXEL, true, true>::new(task, walk);
    items.clear();
    samples.depth.resize(n + FILL, 0.0);
    samples.color.resize(n + FILL, 0);
    if VOXEL {
        samples.item.resize(n + FILL, 0);
        samples.y.resize(n + FILL, 0);
    }
    let (painted, foot) = (walk.lo, walk.height(0));
    let mut ground = Ground { walk, items, samples, painted, foot, gap: [0; 2], s_gap: R::ZERO };
    match ground.run() {
        Some(start) => go_on(ground.walk, start),
        None => ground.finish(),
    }
}

/// The rest in the general way. Not inlined: it is rare, and the code long.
#[cold]
#[inline(never)]
fn go_on<R: Real, const VOXEL: bool>(mut walk: Walk<'_, R, VOXEL, true, true>, start: Start<R>) -> Counters {
    walk.run(start);
    walk.finish()
}

impl<'a, R: Real, const VOXEL: bool> Ground<'a, R, VOXEL> {
    /// Walks the plane until its window is closed or its world ends, or to where it has to go on in the general way.
    #[inline(always)]
    fn run(&mut self) -> Option<Start<R>> {
        let (plane, setup) = (self.walk.plane, self.walk.setup);
        let mut grid = Grid {
            dir: plane.dir.map(R::from_f64),
            inverse: plane.dir.map(|d| R::from_f64(if d == 0.0 { f64::from(f32::MAX) } else { 1.0 / d })),
            fract: [R::from_f64(setup.eye_fract[0]), R::from_f64(setup.eye_fract[2])],
            eye: [setup.eye_cell[0], setup.eye_cell[2]],
            step: plane.dir.map(|d| if d < 0.0 { -1 } else { 1 }),
            ahead: plane.dir.map(|d| i32::from(d >= 0.0)),
            size: [0; 2],
            repeats: setup.repeats,
            level: 0,
            tables: &self.walk.resident.levels[0],
            major: usize::from(plane.dir[1].abs() > plane.dir[0].abs()),
            slices: std::hint::black_box(std::array::from_fn(|s| s as i32)),
        };
        let (major, minor) = (grid.major, 1 - grid.major);
        let t_end = R::from_f64(plane.t_end.min(1e17));
        let Start { mut t0, level: mut l, mut cell } = Start::of(plane);
        let mut strip = Strip::NONE;

        while l < setup.levels {
            let level = &self.walk.resident.levels[l as usize];
            let Table::Heights(heights) = &level.table else { unreachable!("ground has heights") };
            (grid.level, grid.tables) = (l, level);
            grid.size = [level.nx as i32, level.nz as i32];
            let (bottom, top) = self.walk.heights_from(l);
            let limit = t_end.min(self.walk.next_level(l));
            loop {
                let (lo, hi) = (self.walk.lo, self.walk.hi);
                let (s_lo, s_hi) = (self.walk.s_lo, self.walk.s_hi);
                let ended = t0 >= t_end
                    || lo >= hi
                    || grid.outside(0, cell[0])
                    || grid.outside(1, cell[1])
                    || (s_hi < R::ZERO && s_hi * t0 <= bottom)
                    || (s_lo > R::ZERO && s_lo * t0 >= top && self.gap_is_shut(t0));
                if t0 >= limit || ended {
                    self.paint(level, l);
                    if ended {
                        return None;
                    }
                    break;
                }
                if self.items.len() > MANY {
                    self.paint_apart(level, l);
                }
                let wrapped = [grid.wrap(0, cell[0]), grid.wrap(1, cell[1])];
                let stop = cell[major]
                    + if grid.step[major] > 0 {
                        ((wrapped[major] | (SLICES as i32 - 1)) + 1).min(grid.size[major]) - wrapped[major]
                    } else {
                        -(wrapped[major] & (SLICES as i32 - 1)) - 1
                    };
                let n = (stop - cell[major]).abs();
                let t_stop = grid.cross(major, stop + 1 - grid.ahead[major]);
                let from = t0;
                let mut told = false;
                if t_stop < limit && t_stop > t0 {
                    let end = grid.reached(minor, t_stop, cell[minor], n + 1);
                    let end_wrapped = wrapped[minor] + (end - cell[minor]);
                    let whole = (0..grid.size[minor]).contains(&end_wrapped);
                    if whole && self.gap_is_shut(t0) {
                        let block = |at: i32| {
                            let (x, z) = if major == 0 { (wrapped[0], at) } else { (at, wrapped[1]) };
                            Run(level.blocks[level.block(x as u32, z as u32)]).end()
                        };
                        let height = block(wrapped[minor]).max(block(end_wrapped));
                        if self.walk.height(height << l) <= self.walk.lowest(t0, t_stop) {
                            cell[minor] = end;
                            cell[major] = stop;
                            t0 = t_stop;
                            continue;
                        }
                    }
                    if whole || (grid.repeats[minor] && grid.size[minor] > 2 * SLICES as i32) {
                        told = grid.strip(&mut strip, t0, t_stop, n, cell, wrapped);
                    }
                    if told {
                        // The next strip's heights, if the plane goes on so.
                        let stride = [1, level.row() as isize];
                        let on = [stop - cell[major], end - cell[minor]].map(|cells| cells as isize);
                        let next = on[0] * stride[major] + on[1] * stride[minor];
                        for &column in &strip.column[..SLICES] {
                            prefetch(heights, (column as isize + next) as usize);
                        }
                        cell[minor] = end;
                        cell[major] = stop;
                        t0 = t_stop;
                    }
                }
                if !told {
                    grid.step_by_step(&mut strip, &mut t0, limit, stop, &mut cell);
                }
                if let Some(i) = self.draw(level, l, heights, &strip, from, t0) {
                    self.paint_apart(level, l);
                    self.generalize();
                    return Some(Start { t0: strip.t0[i], level: l, cell: strip.cell(i) });
                }
            }
            l += 1;
            cell = cell.map(|c| c >> 1);
        }
        None
    }

    /// Whether no foot from `t0` on reaches into the gap.
    #[inline(always)]
    fn gap_is_shut(&self, t0: R) -> bool {
        self.gap[0] == self.gap[1] || self.foot >= self.s_gap * t0
    }

    /// Draws what shows of a strip that lies between `t0` and `t1`. Returns the lane of the column from which on the walk has
    /// to go on in the general way.
    #[inline(always)]
    fn draw(
        &mut self,
        level: &'a ResidentLevel,
        l: u32,
        heights: &[u16],
        strip: &Strip<R>,
        t0: R,
        t1: R,
    ) -> Option<usize> {
        let passed: i32 = (0..LANES).map(|i| i32::from(strip.t1[i] > strip.t0[i])).sum();
        self.walk.counters.columns_visited += passed as u64;
        let walk = &self.walk;
        let (lo, hi, s_lo, s_hi) = (walk.lo, walk.hi, walk.s_lo, walk.s_hi);
        let (eye_y, fract_y) = (walk.eye_y, walk.fract_y);
        let mut shape = Shape { height: [0; LANES], top: [R::ZERO; LANES], front: [0; LANES], end: [0; LANES] };
        for (height, &column) in shape.height.iter_mut().zip(&strip.column) {
            *height = i32::from(heights[column as usize]);
        }
        let (a, b, c, e, limit) = (walk.a, walk.b, walk.c, walk.e, walk.limit);
        // [`Walk::sample`] once more, of numbers that are read once: only so are lanes taken side by side.
        let sample = |t: R, h: R| {
            let u = (a * t + b * h) / (c * t + e * h) + R::HALF;
            let whole = u.truncate(limit);
            let inside = (whole - i32::from(R::from_i32(whole) == u)).max(lo).min(hi);
            let inside = if h >= s_hi * t { hi } else { inside };
            if h <= s_lo * t { lo } else { inside }
        };
        let (foot, s_highest) = (self.foot, if s_hi < R::ZERO { s_hi } else { R::ZERO });
        let mut highest = lo;
        for i in 0..LANES {
            let (t0, t1, height) = (strip.t0[i], strip.t1[i], shape.height[i]);
            let top = R::from_i32((height << l) - eye_y) - fract_y;
            let end = sample(if top <= R::ZERO { t1 } else { t0 }, top);
            // The plane passes it, and not all of it lies above the window.
            let passed = (t1 > t0) & (foot < s_highest * t0);
            let height = if passed { height } else { 0 };
            shape.height[i] = height;
            shape.top[i] = top;
            shape.end[i] = if height > 0 { end } else { lo };
            highest = highest.max(shape.end[i]);
        }
        let careful = !self.gap_is_shut(t0) || self.foot > self.walk.lowest(t0, t1);
        if careful && !self.feet_are_hidden(strip, &shape) {
            return self.one_by_one(level, l, strip, &shape);
        }
        if highest == lo {
            return None;
        }
        for i in 0..LANES {
            let (t0, top) = (strip.t0[i], shape.top[i]);
            shape.front[i] = if top < R::ZERO { sample(t0, top) } else { hi };
        }
        let mut shows = 0u32;
        let mut reached = lo;
        for n in 0..LANES {
            let end = shape.end[lane(n)];
            shows |= u32::from(end > reached) << n;
            reached = reached.max(end);
        }
        let mut from = lo;
        while shows != 0 {
            let i = lane(shows.trailing_zeros() as usize);
            if let Paint::Top { starts, .. } = &level.paint {
                prefetch(starts, level.start(strip.column[i] as usize));
            }
            self.item(strip, &shape, i, [from, shape.front[i], shape.end[i]]);
            from = shape.end[i];
            shows &= shows - 1;
        }
        self.walk.lo = from;
        self.walk.s_lo = self.walk.below(from);
        None
    }

    /// Takes down the column in lane `i`, which shows its front from sample `at[0]` on, its top from `at[1]` on, if not all is
    /// front or all is top, and nothing from `at[2]` on.
    #[inline(always)]
    fn item(&mut self, strip: &Strip<R>, shape: &Shape<R>, i: usize, at: [i32; 3]) {
        let (column, height) = (strip.column[i], shape.height[i] as u32);
        let (t0, up) = (strip.t0[i], shape.top[i].abs());
        let [from, turn, to] = at;
        let at = [from, turn.max(from).min(to), to].map(|j| j as u32);
        let [x, z] = if VOXEL { strip.cell(i) } else { [0; 2] };
        self.items.push(Item { column, height, t0, up, at, x, z });
    }

    /// Whether all feet of a strip lie below what the columns before them reach, and above the gap.
    #[cold]
    #[inline(never)]
    fn feet_are_hidden(&self, strip: &Strip<R>, shape: &Shape<R>) -> bool {
        let mut reached = self.walk.lo;
        for n in 0..LANES {
            let i = lane(n);
            if shape.height[i] == 0 {
                continue;
            }
            if self.foot_in_gap(strip.t0[i]) {
                return false;
            }
            let end = shape.end[i];
            if end > reached {
                let no_gap = self.gap[0] == self.gap[1];
                if self.walk.sample(strip.t0[i], self.foot) > reached || (!no_gap && end == self.walk.hi) {
                    return false;
                }
                reached = end;
            }
        }
        true
    }

    /// Whether a foot at `t0` shows in the gap.
    #[inline(always)]
    fn foot_in_gap(&self, t0: R) -> bool {
        let [from, to] = self.gap;
        if from == to || self.gap_is_shut(t0) {
            return false;
        }
        self.foot <= self.walk.below(from) * t0 || self.walk.place(t0, self.foot) < to
    }

    /// [`Ground::draw`] where a foot may show.
    #[cold]
    #[inline(never)]
    fn one_by_one(&mut self, level: &'a ResidentLevel, l: u32, strip: &Strip<R>, shape: &Shape<R>) -> Option<usize> {
        for n in 0..LANES {
            let i = lane(n);
            let (t0, t1, h1) = (strip.t0[i], strip.t1[i], shape.top[i]);
            if shape.height[i] == 0 {
                continue;
            }
            if self.foot_in_gap(t0) {
                return Some(i);
            }
            let (lo, hi) = (self.walk.lo, self.walk.hi);
            let j0 = self.walk.sample(t0, self.foot);
            let j1 = self.walk.sample(if h1 <= R::ZERO { t1 } else { t0 }, h1);
            if j0 >= j1 {
                continue;
            }
            let no_gap = self.gap[0] == self.gap[1];
            if (j0 > lo && !no_gap) || (j1 == hi && (j0 > lo || !no_gap)) {
                return Some(i);
            }
            if j0 > lo {
                self.paint_apart(level, l);
                self.painted = j0;
                self.gap = [lo, j0];
                self.s_gap = self.walk.edge_slope(j0);
            }
            let turn = if h1 < R::ZERO { self.walk.sample(t0, h1) } else { hi };
            self.item(strip, shape, i, [j0, turn, j1]);
            self.walk.lo = j1;
            self.walk.s_lo = self.walk.below(j1);
            if j1 >= hi {
                return None;
            }
        }
        None
    }

    /// Paints the samples that wait for it, of columns of level `l`.
    #[inline(always)]
    fn paint(&mut self, level: &ResidentLevel, l: u32) {
        let range = self.painted as usize..self.walk.lo as usize;
        self.painted = self.walk.lo;
        self.walk.look(range.clone());
        self.walk.counters.runs_visited += self.items.len() as u64;
        self.walk.counters.spans_drawn += self.items.len() as u64;
        let Walk { sight, depth, color, voxel, .. } = &mut self.walk;
        let (colors, foot) = (level.paint.colors(), self.foot);
        for (item, number) in self.items.iter().zip(0..) {
            let (start, hidden) = match &level.paint {
                Paint::Top { starts, .. } => {
                    let at = level.start(item.column as usize);
                    (starts[at], item.height.saturating_sub(starts[at + 1] - starts[at]))
                }
                // Tables of heights have no exposed runs.
                Paint::None | Paint::Voxel { .. } => (0, u32::MAX),
                Paint::Column { .. } => (item.column, u32::MAX),
                Paint::Height { .. } => (0, 0),
                Paint::Run { base, .. } => (base[item.column as usize], u32::MAX),
            };
            let of_top = start + (item.height - 1).saturating_sub(hidden);
            prefetch(colors, start as usize);
            prefetch(colors, of_top as usize);
            let highest = R::from_i32((item.height << l) as i32 - 1);
            let [from, turn, to] = item.at.map(|j| j as usize);
            // Each loop writes once even where there is no sample, so that no branch hangs on whether there is. They are written
            // out: as one function that takes closures, views took up to half longer.
            let mut at = from;
            loop {
                let lanes = at..at + FILL;
                let depths = scaled(item.t0, &sight.depth_t[lanes.clone()]);
                self.samples.depth[lanes.clone()].copy_from_slice(&depths);
                let slopes = &sight.slope[lanes.clone()];
                let mut ys = [0; FILL];
                for (y, &slope) in ys.iter_mut().zip(slopes) {
                    *y = ((slope * item.t0 - foot).truncate(highest) as u32) >> l;
                }
                for (place, y) in self.samples.color[lanes.clone()].iter_mut().zip(ys) {
                    *place = start + y.saturating_sub(hidden);
                }
                if VOXEL {
                    self.samples.y[lanes].copy_from_slice(&ys);
                }
                at += FILL;
                if at >= turn {
                    break;
                }
            }
            let mut at = turn;
            loop {
                let lanes = at..at + FILL;
                let depths = scaled(item.up, &sight.depth_h[lanes.clone()]);
                self.samples.depth[lanes.clone()].copy_from_slice(&depths);
                self.samples.color[lanes.clone()].fill(of_top);
                if VOXEL {
                    self.samples.y[lanes].fill(item.height - 1);
                }
                at += FILL;
                if at >= to {
                    break;
                }
            }
            if VOXEL {
                let mut at = from;
                loop {
                    self.samples.item[at..at + FILL].fill(number);
                    at += FILL;
                    if at >= to {
                        break;
                    }
                }
            }
        }
        depth[range.clone()].copy_from_slice(&self.samples.depth[range.clone()]);
        for (color, &place) in color[range.clone()].iter_mut().zip(&self.samples.color[range.clone()]) {
            *color = colors[place as usize];
        }
        if VOXEL {
            let shown = self.samples.item[range.clone()].iter().zip(&self.samples.y[range.clone()]);
            for (voxel, (&number, &y)) in voxel[range].iter_mut().zip(shown) {
                let item = &self.items[usize::from(number)];
                *voxel = [item.x, y as i32, item.z, l as i32];
            }
        }
        self.items.clear();
    }

    /// Once more [`Ground::paint`], not inlined.
    #[cold]
    #[inline(never)]
    fn paint_apart(&mut self, level: &ResidentLevel, l: u32) {
        self.paint(level, l);
    }

    /// Goes over to the general way: what a walk over ground knows by its window's lower end, as bits, hull and center.
    #[cold]
    #[inline(never)]
    fn generalize(&mut self) {
        let walk = &mut self.walk;
        walk.look(walk.lo as usize..walk.hi as usize);
        let [from, to] = self.gap;
        if from == to {
            return;
        }
        walk.look(from as usize..to as usize);
        for w in to as usize / 64..(walk.lo as usize).div_ceil(64) {
            let filled =
                low_bits((walk.lo as usize - 64 * w).min(64)) & !low_bits((to as usize).saturating_sub(64 * w).min(64));
            walk.open[w] &= !filled;
        }
        (walk.hull, walk.center) = ([to, walk.lo], [to, walk.lo]);
        walk.s_center = [walk.above(to), walk.s_lo];
        (walk.lo, walk.s_lo) = (from, walk.below(from));
    }

    /// What is still unfilled shows the sky: the gap, and the open window.
    #[inline(always)]
    fn finish(self) -> Counters {
        let Walk { lo, hi, color, depth, voxel, counters, .. } = self.walk;
        for range in [self.gap, [lo.min(hi), hi]].map(|[from, to]| from as usize..to as usize) {
            color[range.clone()].fill(0);
            depth[range.clone()].fill(f32::INFINITY);
            if VOXEL {
                voxel[range].fill(SKY);
            }
        }
        counters
    }
}

/// Asks for `of[at]` to be in the cache soon.
#[inline(always)]
fn prefetch<T>(of: &[T], at: usize) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: every processor of this architecture has the instruction, which reads nothing, whatever the address.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(of.as_ptr().wrapping_add(at).cast()) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (of, at);
}
