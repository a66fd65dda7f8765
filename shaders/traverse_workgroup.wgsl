// Stage traverse, kernel `workgroup`: one plane per workgroup, WIDTH slices of the plane's ray at once.
// Twin: src/cpu/traverse.rs (same picture, other order of work). Grid: a workgroup a plane.
//
// The plane's ray is cut into slices along its longer axis; a slice meets at most two columns. Slices are taken in
// batches of WIDTH, a lane a slice, so that the loads of a whole batch are in flight together. Spans become keys by
// atomicMin, nearest slice first, so a batch needs no order; between batches the window shrinks. What a sample shows is
// worked out once, from its key, when the walk is over.
//
//   key | slice and column 20 | run 12 |   0: shown already, ~0: open; run saturates, the rest is then searched for
//
// Spans are noted at blocks of 16 samples, at aligned fours and at single samples, the longest that fit (`fill`): a near
// column's span is hundreds of samples long, and the lane that draws it keeps all others waiting. Most spans reach the
// window's lower end (ground is solid down from its surface), some its upper end: such a span is noted once, at the last
// block that it fills (`rising`, `hanging`), and a block shows the least key noted from there on (`settle`). That holds
// over batches too: a later span has a greater key than whatever closed the window before it. Rows take
// workgroup memory and are all read at the end, so they are few: one for each power of two was measured to take longer.
//
// GROUND, for heights seen from above the ground (`Feature::Horizon`): a column shows from where what is nearer ends up to
// its own top, the places where there is none showing the sky above the ground's underside. So a column notes its key
// once, at the last sample that it reaches, and a sample shows the least key noted from there on. Nothing ever closes the
// window from above, and keys say the slice and column alone.
//
// Ahead of the batches, groups of GROUP slices are tested against the height bounds of the blocks they meet, a lane a
// group, once more before each batch with the window as it is then; only those that can show are walked.
//!include shared/frame.wgsl
//!include shared/plane.wgsl
//!include shared/scene.wgsl
//!include shared/sight.wgsl

// Lanes; a multiple of 32, at most 256.
override WIDTH: u32 = 128u;
// Keys in the rows. Workgroup memory is dear even where there is more of it: one compiler takes as many registers as leave
// room for so many workgroups as fit in 48 KiB, and more registers let fewer run.
override FINE: u32 = 1024u;
// Samples of a block.
const BLOCK: i32 = 16;
// Keys of all rows.
//!if GROUND
override KEYS: u32 = FINE;
//!else
override KEYS: u32 = FINE + FINE / 4u + 3u * (FINE / 16u);
//!endif

const OPEN: u32 = 0xffffffffu;
// Slices that keys can tell apart before what they say must be written out.
//!if GROUND
const EPOCH: i32 = 0x3fffffff;
//!else
const RUN_BITS: u32 = 12u;
const RUN_MANY: u32 = 4095u;
const EPOCH: i32 = 520000;
//!endif
const GROUP: i32 = BLOCK_SIZE;

// Counters of all planes, then keys that do not fit in workgroup memory.
@group(0) @binding(6) var<storage, read_write> scratch: array<atomic<u32>>;

// Rows: a key a sample; then a key a block of what fills it, of what fills all below it, of what fills all above it; then
// one for every four samples.
//!if STORAGE_KEYS
var<private> keys_at: u32;
//!else
var<workgroup> keys: array<atomic<u32>, KEYS>;
const keys_at: u32 = 0u;
//!endif

// For each level: where it begins, its first slice's cell, and slices and groups of the levels before.
var<workgroup> level_t: array<f32, MAX_LEVELS + 1>;
var<workgroup> level_cell: array<i32, MAX_LEVELS>;
var<workgroup> level_slice: array<i32, MAX_LEVELS + 1>;
var<workgroup> level_group: array<i32, MAX_LEVELS + 1>;

// The groups under test, level 5 | number within the level 27; in `settle` least keys of parts of two rows.
//!if GROUND
var<workgroup> listed: array<u32, WIDTH + WIDTH / 16u>;
//!else
var<workgroup> listed: array<u32, max(WIDTH, 64u)>;
//!endif
// What a batch leaves for all lanes; in turn, so that one barrier separates use from reset.
struct Turn {
    // Groups that can show, one bit each.
    survive: array<atomic<u32>, 8>,
    // How far spans from the window's ends reach.
    lo: atomic<i32>,
    hi: atomic<i32>,
    // First and one past the last unfilled sample.
    open_lo: atomic<i32>,
    open_hi: atomic<i32>,
}
var<workgroup> turns: array<Turn, 3>;
//!if !GROUND
// Whether any span floats.
var<workgroup> floats: atomic<u32>;
//!endif
var<workgroup> counts: array<atomic<u32>, 3>;

// The plane's ray along its longer axis (major) and the other: the eye's cell and place in it, direction and inverse.
var<private> major: u32;
var<private> cell_major: i32;
var<private> cell_minor: i32;
var<private> fract_major: f32;
var<private> fract_minor: f32;
var<private> dir_minor: f32;
var<private> inverse_major: f32;
var<private> inverse_minor: f32;
var<private> step_major: i32;
var<private> step_minor: i32;
var<private> ahead_major: i32;
var<private> ahead_minor: i32;
var<private> repeats_major: bool;
var<private> repeats_minor: bool;

// The open window and slopes just below the centres of its first sample and just above its last's.
var<private> lo: i32;
var<private> hi: i32;
var<private> s: vec2<f32>;
// How far this lane's spans reach from the window's ends.
var<private> reach_lo: i32;
var<private> reach_hi: i32;

var<private> n_columns: u32;
var<private> n_runs: u32;
var<private> n_spans: u32;

fn key_at(i: u32) -> u32 {
//!if STORAGE_KEYS
    return atomicLoad(&scratch[i]);
//!else
    return atomicLoad(&keys[i]);
//!endif
}

fn lower_key(i: u32, key: u32) {
//!if STORAGE_KEYS
    atomicMin(&scratch[i], key);
//!else
    atomicMin(&keys[i], key);
//!endif
}

fn set_key(i: u32, key: u32) {
//!if STORAGE_KEYS
    atomicStore(&scratch[i], key);
//!else
    atomicStore(&keys[i], key);
//!endif
}

// What all lanes say alike; browsers want it proved where a barrier depends on it.
//!if UNIFORM
var<workgroup> said: u32;

fn alike(lane: u32, what: bool) -> bool {
    if (lane == 0u) {
        said = u32(what);
    }
    return workgroupUniformLoad(&said) == 1u;
}
//!else
fn alike(lane: u32, what: bool) -> bool {
    return what;
}
//!endif

// All lanes have come here, and see each other's keys.
fn sync() {
    workgroupBarrier();
//!if STORAGE_KEYS
    storageBarrier();
//!endif
}

// A plane's first sample, or up to a block before it: the first that has a key.
var<private> origin: i32;

fn sample(j: i32) -> u32 {
    return keys_at + u32(j - origin);
}

//!if !GROUND
fn filled(j: i32) -> u32 {
    return keys_at + FINE + u32(j - origin) / u32(BLOCK);
}

fn hanging(j: i32) -> u32 {
    return keys_at + FINE + FINE / 16u + u32(j - origin) / u32(BLOCK);
}

fn rising(j: i32) -> u32 {
    return keys_at + FINE + 2u * (FINE / 16u) + u32(j - origin) / u32(BLOCK);
}

fn four(j: i32) -> u32 {
    return keys_at + FINE + 3u * (FINE / 16u) + u32(j - origin) / 4u;
}

fn key_of(j: i32) -> u32 {
    return min(key_at(sample(j)), min(key_at(four(j)), key_at(filled(j))));
}

fn is_open(j: i32) -> bool {
    return key_of(j) == OPEN;
}

//!endif

fn cross_major(line: i32) -> f32 {
    return (f32(line - cell_major) - fract_major) * inverse_major;
}

fn cross_minor(line: i32) -> f32 {
    return select((f32(line - cell_minor) - fract_minor) * inverse_minor, STEEP, dir_minor == 0.0);
}

// A stretch of the plane's ray between two lines of its longer axis, and its columns: the first to tm, the second, if
// there is one, from there on.
struct Slice {
    t0: f32,
    t1: f32,
    first: i32,
    second: i32,
    tm: f32,
    two: bool,
}

// The minor cell at t, and where the ray leaves it; within the world.
struct Minor {
    at: i32,
    leaves: f32,
}

fn minor_at(l: u32, t: f32) -> Minor {
    var at = (i32(floor(fract_minor + t * dir_minor)) + cell_minor) >> l;
    var leaves = cross_minor((at + ahead_minor) << l);
    // Estimated, then put right by the crossings.
    if (leaves <= t) {
        at += step_minor;
        leaves = cross_minor((at + ahead_minor) << l);
    } else if (dir_minor != 0.0 && cross_minor((at + 1 - ahead_minor) << l) > t) {
        at -= step_minor;
        leaves = cross_minor((at + ahead_minor) << l);
    }
    if (!repeats_minor) {
        let within = clamp(at, 0, levels[l].size[1u - major] - 1);
        if (within != at) {
            at = within;
            leaves = cross_minor((at + ahead_minor) << l);
        }
    }
    return Minor(at, leaves);
}

fn slice_of(l: u32, cell: i32) -> Slice {
    var c: Slice;
    c.t0 = max(cross_major((cell + 1 - ahead_major) << l), level_t[l]);
    c.t1 = min(cross_major((cell + ahead_major) << l), level_t[l + 1u]);
    if (c.t0 >= frame.equidistant) {
        c.first = (i32(floor(fract_minor + (c.t0 + c.t1) * 0.5 * dir_minor)) + cell_minor) >> l;
        c.tm = c.t1;
        return c;
    }
    let at = minor_at(l, c.t0);
    c.first = at.at;
    c.second = at.at + step_minor;
    c.tm = max(at.leaves, c.t0);
    c.two = c.tm < c.t1;
    c.tm = min(c.tm, c.t1);
    return c;
}

fn cell_of(along: i32, across: i32) -> vec2<i32> {
    return select(vec2(across, along), vec2(along, across), major == 0u);
}

fn column_at(l: u32, cell: vec2<i32>) -> u32 {
    return column_index(l, wrap(cell.x, levels[l].size.x), wrap(cell.y, levels[l].size.y));
}

// Slopes just within the window: what meets no sample's centre need not be drawn.
fn window_slopes() -> vec2<f32> {
    return vec2(slope_at(f32(lo) + 0.45), slope_at(f32(hi) - 0.45));
}

fn reset_turn(turn: u32) {
    for (var w = 0u; w < 8u; w++) {
        atomicStore(&turns[turn].survive[w], 0u);
    }
    atomicStore(&turns[turn].lo, -1);
    atomicStore(&turns[turn].hi, I32_MAX);
    atomicStore(&turns[turn].open_lo, I32_MAX);
    atomicStore(&turns[turn].open_hi, -1);
}

// Lays out the levels along the plane.
fn begin(lane: u32) {
    origin = plane.first & ~(BLOCK - 1);
    major = select(0u, 1u, abs(plane.dir.y) > abs(plane.dir.x));
    let along_x = major == 0u;
    cell_major = select(frame.eye_cell.z, frame.eye_cell.x, along_x);
    cell_minor = select(frame.eye_cell.x, frame.eye_cell.z, along_x);
    fract_major = select(frame.eye_fract.z, frame.eye_fract.x, along_x);
    fract_minor = select(frame.eye_fract.x, frame.eye_fract.z, along_x);
    dir_minor = select(plane.dir.x, plane.dir.y, along_x);
    inverse_major = select(plane.inverse.y, plane.inverse.x, along_x);
    inverse_minor = select(plane.inverse.x, plane.inverse.y, along_x);
    step_major = select(1, -1, inverse_major < 0.0);
    step_minor = select(1, -1, dir_minor < 0.0);
    ahead_major = select(0, 1, step_major > 0);
    ahead_minor = select(0, 1, step_minor > 0);
    repeats_major = REPEATS && select(frame.repeat_z, frame.repeat_x, along_x) == 1u;
    repeats_minor = REPEATS && select(frame.repeat_x, frame.repeat_z, along_x) == 1u;
    for (var i = lane; i < KEYS; i += WIDTH) {
        set_key(keys_at + i, OPEN);
    }
    if (lane < 3u) {
        reset_turn(lane);
        atomicStore(&counts[lane], 0u);
    }
//!if !GROUND
    if (lane == 0u) {
        atomicStore(&floats, 0u);
    }
//!endif
    for (var l = lane; l < level_count(); l += WIDTH) {
        var start = plane.t_start;
        if (l > plane.lod_first) {
            start = max(start, plane.lod_t * f32(1u << l));
        }
        var to = plane.t_end;
        if (l + 1u < level_count()) {
            to = min(to, plane.lod_t * f32(1u << (l + 1u)));
        }
        start = min(start, plane.t_end);
        to = max(start, to);
        var cells = vec2(0);
        var n = vec2(0);
        if (l >= plane.lod_first && to > start) {
            cells.x = select(plane.cell.y, plane.cell.x, along_x) >> l;
            if (start > plane.t_start) {
                cells.x = locate(major, start, l);
            }
            cells.y = locate(major, to, l);
            n.x = max((cells.y - cells.x) * step_major, 0) + 1;
            n.y = max(((cells.y >> BLOCK_SHIFT) - (cells.x >> BLOCK_SHIFT)) * step_major, 0) + 1;
        } else {
            to = start;
        }
        level_cell[l] = cells.x;
        level_t[l] = start;
        level_slice[l] = n.x;
        level_group[l] = n.y;
    }
    sync();
    if (lane == 0u) {
        var slices = 0;
        var groups = 0;
        for (var l = 0u; l < level_count(); l++) {
            let n = vec2(level_slice[l], level_group[l]);
            level_slice[l] = slices;
            level_group[l] = groups;
            slices += n.x;
            groups += n.y;
        }
        level_slice[level_count()] = slices;
        level_group[level_count()] = groups;
        level_t[level_count()] = plane.t_end;
    }
    sync();
    lo = plane.first;
    hi = plane.end;
//!if GROUND
    // Below, sight lines pass under the world.
    lo = sample_at(plane.t_start, height(0));
//!endif
    s = window_slopes();
}

fn level_of_group(g: i32) -> u32 {
    if (ONE_LEVEL) {
        return 0u;
    }
    var l = plane.lod_first;
    while (g >= level_group[l + 1u]) {
        l += 1u;
    }
    return l;
}

// A group of slices: where it lies, and the heights of what stands there.
struct Group {
    t0: f32,
    t1: f32,
    bottom: f32,
    top: f32,
}

// The first cell, in order of numbers, of a group of level l.
fn group_cell(l: u32, n: i32) -> i32 {
    return ((level_cell[l] >> BLOCK_SHIFT) + n * step_major) * GROUP;
}

fn group_of(l: u32, n: i32) -> Group {
    var out: Group;
    let cell = group_cell(l, n);
    out.t0 = max(cross_major((cell + select(GROUP, 0, step_major > 0)) << l), level_t[l]);
    out.t1 = min(cross_major((cell + select(0, GROUP, step_major > 0)) << l), level_t[l + 1u]);
    out.bottom = frame.bottom;
    out.top = frame.top;
    if (!COARSE || out.t1 <= out.t0 || !can_show(out)) {
        return out;
    }
    out.bottom = F32_MAX;
    out.top = -F32_MAX;
    let ends = vec2(minor_at(l, out.t0).at, minor_at(l, out.t1).at);
    let last = max(ends.x, ends.y);
    let size_major = levels[l].size[major];
    let size_minor = levels[l].size[1u - major];
    // Along each axis blocks end at multiples of their size and at the seam of a repeated world.
    var a = cell;
    var a_end = a + GROUP;
    if (!repeats_major) {
        a = max(a, 0);
        a_end = min(a_end, size_major);
    }
    while (a < a_end) {
        let wa = wrap(a, size_major);
        var b = min(ends.x, ends.y);
        while (b <= last) {
            let wb = wrap(b, size_minor);
            let w = cell_of(wa, wb);
            let block = block_of(l, w);
//!if GROUND
            // Where there is none, the ground's underside hides what lies behind it.
            out.top = max(out.top, height(select(run_end(block), 0, block == EMPTY) << l));
//!else
            if (block != EMPTY) {
                out.bottom = min(out.bottom, height(run_first(block) << l));
                out.top = max(out.top, height(run_end(block) << l));
            }
//!endif
            b += min((wb | (BLOCK_SIZE - 1)) + 1, size_minor) - wb;
        }
        a += min((wa | (BLOCK_SIZE - 1)) + 1, size_major) - wa;
    }
    return out;
}

fn can_show(group: Group) -> bool {
    if (!COARSE) {
        return true;
    }
    let v = visible(s, group.t0, group.t1);
//!if GROUND
    return group.top > v.x;
//!else
    return group.top > v.x && group.bottom < v.y;
//!endif
}

// Place of set bit number n.
fn nth_bit(bits: u32, n: u32) -> u32 {
    var left = n;
    var rest = bits;
    var at = 0u;
    for (var half = 16u; half > 0u; half >>= 1u) {
        let below = countOneBits(rest & ((1u << half) - 1u));
        if (left >= below) {
            left -= below;
            rest >>= half;
            at += half;
        }
    }
    return at;
}

// A column that the plane meets, and where.
struct Met {
    l: u32,
    cell: vec2<i32>,
    t0: f32,
    t1: f32,
}

// Column number `order & 1` of slice number `order / 2`, counted from the epoch's first.
fn met_of(order: u32, epoch: i32) -> Met {
    let n = i32(order >> 1u) + epoch;
    var l = plane.lod_first;
    if (ONE_LEVEL) {
        l = 0u;
    }
    while (!ONE_LEVEL && n >= level_slice[l + 1u]) {
        l += 1u;
    }
    let along = level_cell[l] + (n - level_slice[l]) * step_major;
    let c = slice_of(l, along);
    let second = (order & 1u) == 1u;
    return Met(
        l, cell_of(along, select(c.first, c.second, second)), select(c.t0, c.tm, second), select(c.tm, c.t1, second));
}

fn heights(y: vec2<u32>, l: u32) -> vec2<f32> {
    return vec2<f32>(vec2<i32>(y << vec2(l)) - frame.eye_cell.y) - frame.eye_fract.y;
}

// The first samples whose centres are at or above points (t, h) within the window.
fn samples_at(t: vec2<f32>, h: vec2<f32>) -> vec2<i32> {
    let u = (plane.a * t + plane.b * h) / vec2(sight_scale(t.x, h.x), sight_scale(t.y, h.y));
    return clamp(vec2<i32>(ceil(u - 0.5)), vec2(lo), vec2(hi));
}

// Draws what a slice's columns show into the keys.
fn draw_slice(l: u32, cell: i32, epoch: i32) {
    let along = (cell - level_cell[l]) * step_major;
    let c = slice_of(l, cell);
    // The first and the last group of a level may begin before it and end after it.
    if (along < 0 || along >= level_slice[l + 1u] - level_slice[l] || c.t1 <= c.t0) {
        return;
    }
//!if GROUND
    let order = u32(level_slice[l] + along - epoch) * 2u;
    let cell0 = cell_of(cell, c.first);
    let cell1 = cell_of(cell, c.second);
    // Both loads in flight together.
    let n = vec2(voxels_at(l, cell0, true), voxels_at(l, cell1, c.two));
    n_columns += 1u + u32(c.two);
    n_runs += u32(n.x > 0u) + u32(n.y > 0u);
    let h = heights(n, l);
    let t = select(vec2(c.t0, c.tm), vec2(c.tm, c.t1), h <= vec2(0.0));
    // Beyond the window the division may be by nothing.
    let j = select(samples_at(t, h), vec2(hi), h >= s.y * t);
    let shown = vec2(true, c.two) & (h > s.x * t) & (j > vec2(lo, max(lo, reach_lo)));
    if (shown.x) {
        lower_key(sample(j.x - 1), order);
        reach_lo = max(reach_lo, j.x);
        n_spans += 1u;
    }
    if (shown.y && j.y > reach_lo) {
        lower_key(sample(j.y - 1), order + 1u);
        reach_lo = j.y;
        n_spans += 1u;
    }
}

// Voxels of a column; none beside the world.
fn voxels_at(l: u32, cell: vec2<i32>, wanted: bool) -> u32 {
    if (!wanted || !in_world(l, cell)) {
        return 0u;
    }
    return voxels(l, column_at(l, cell));
}

// Shrinks the window to what is above all that was drawn; call with all lanes, after a barrier.
fn shrink(lane: u32, turn: u32) {
    lo = max(lo, atomicLoad(&turns[turn].lo));
    s = window_slopes();
}

// Hands keys down to all samples below them that have no lesser one. Call with all lanes.
fn settle(lane: u32) {
    sync();
    // A lane has a stretch of samples; 16 lanes have a stretch of stretches.
    // Stretches of odd length lie in different banks of memory.
    let each = ((i32(FINE) + i32(WIDTH) - 1) / i32(WIDTH)) | 1;
    let first = min(i32(lane) * each, i32(FINE));
    let end = min(first + each, i32(FINE));
    var least = OPEN;
    for (var j = first; j < end; j++) {
        least = min(least, key_at(sample(origin + j)));
    }
    listed[lane] = least;
    sync();
    if (lane < WIDTH / 16u) {
        least = OPEN;
        for (var k = 0u; k < 16u; k++) {
            least = min(least, listed[16u * lane + k]);
        }
        listed[WIDTH + lane] = least;
    }
    sync();
    least = OPEN;
    for (var k = lane + 1u; (k & 15u) != 0u; k++) {
        least = min(least, listed[k]);
    }
    for (var k = lane / 16u + 1u; k < WIDTH / 16u; k++) {
        least = min(least, listed[WIDTH + k]);
    }
    for (var j = end - 1; j >= first; j--) {
        least = min(least, key_at(sample(origin + j)));
        set_key(sample(origin + j), least);
    }
    sync();
}

// Works out what the keys say; keys last for the whole walk.
fn resolve(lane: u32, epoch: i32, over: bool) {
    settle(lane);
    let ground = sample_at(plane.t_start, height(0));
    for (var j = plane.first + i32(lane); j < plane.end; j += i32(WIDTH)) {
        let key = key_at(sample(j));
        if (key == OPEN || j < ground) {
            write_sky(j);
            continue;
        }
        let met = met_of(key, epoch);
        let n = voxels_at(met.l, met.cell, true);
        if (n == 0u) {
            write_sky(j);
        } else {
            let ix = column_at(met.l, met.cell);
            let top = height(i32(n) << met.l);
            write_sample(j, met.l, met.cell, ix, 0u, run_of_height(n), height(0), top, met.t0);
        }
    }
}

//!else
    let order = u32(level_slice[l] + along - epoch) * 2u + 1u;
    let key = vec2(order, order + 1u) << vec2(RUN_BITS);
    let cell0 = cell_of(cell, c.first);
    let cell1 = cell_of(cell, c.second);
    var entry0 = vec2(EMPTY, 0u);
    var entry1 = entry0;
    // Both loads in flight together.
    if (in_world(l, cell0)) {
        entry0 = column_entry(l, column_at(l, cell0));
        n_columns += 1u;
    }
    if (c.two && in_world(l, cell1)) {
        entry1 = column_entry(l, column_at(l, cell1));
        n_columns += 1u;
    }
    // How many runs lie below the top ones, and the first of them, all in flight together as well.
    let below0 = runs_below(l, entry0.y);
    let below1 = runs_below(l, entry1.y);
    let n_more = vec2(below0.x, below1.x);
    let more = levels[l].runs + vec2(entry0.y, entry1.y);
    let t0 = vec2(c.t0, c.tm);
    let t1 = vec2(c.tm, c.t1);
    let low = visible(s, t0.x, t1.x);
    let high = visible(s, t0.y, t1.y);
    let v0 = vec2(low.x, high.x);
    let v1 = vec2(low.y, high.y);
    // Both columns' runs side by side, from the top down.
    var run = vec2(entry0.x, entry1.x);
    var next = vec2(below0.y, below1.y);
    var live = run != vec2(EMPTY);
    var k = vec2(0u);
    // Runs above the window.
    loop {
        let above = live & (heights(run & vec2(0xffffu), l) >= v1);
        if (!any(above)) {
            break;
        }
        n_runs += select(0u, 1u, above.x) + select(0u, 1u, above.y);
        for (var i = 0u; i < 2u; i++) {
            if (above[i]) {
                live[i] = k[i] < n_more[i];
                if (live[i] && k[i] == 0u && n_more[i] > 8u) {
                    // Binary search for the first run that reaches down into it.
                    k[i] = search(l, more[i], n_more[i], v1[i]);
                    live[i] = k[i] < n_more[i];
                    next[i] = runs(more[i] + min(k[i] + 1u, n_more[i]));
                }
                k[i] += 1u;
                run[i] = next[i];
                if (live[i]) {
                    next[i] = runs(more[i] + min(k[i] + 1u, n_more[i]));
                }
            }
        }
    }
    // And those below it.
    var h1 = heights((run >> vec2(16u)) + 1u, l);
    live &= h1 > v0;
    while (any(live)) {
        n_runs += select(0u, 1u, live.x) + select(0u, 1u, live.y);
        let h0 = heights(run & vec2(0xffffu), l);
        draw(live, h0, h1, t0, t1, key + min(k, vec2(RUN_MANY)));
        h1 = heights((next >> vec2(16u)) + 1u, l);
        live = live & (k < n_more) & (h1 > v0);
        k += vec2(1u);
        run = next;
        // On their way while these are drawn.
        if (live.x) {
            next.x = runs(more.x + min(k.x + 1u, n_more.x));
        }
        if (live.y) {
            next.y = runs(more.y + min(k.y + 1u, n_more.y));
        }
    }
}

// Number of a column's runs below the top one, and the first of those; `at`: where they stand, 0 for none.
fn runs_below(l: u32, at: u32) -> vec2<u32> {
//!if HEIGHTS
    return vec2(0u);
//!else
    let n = runs(levels[l].runs + at);
    let first = runs(levels[l].runs + at + select(0u, 1u, at != 0u));
    return select(vec2(0u), vec2(n, first), at != 0u);
//!endif
}

// How many of n runs begin at or above a height.
fn search(l: u32, more: u32, n: u32, h: f32) -> u32 {
    var k = 0u;
    var to = n;
    while (k < to) {
        let mid = (k + to) / 2u;
        if (height(run_first(runs(more + 1u + mid)) << l) >= h) {
            k = mid + 1u;
        } else {
            to = mid;
        }
    }
    return k;
}

fn draw(shows: vec2<bool>, h0: vec2<f32>, h1: vec2<f32>, t0: vec2<f32>, t1: vec2<f32>, key: vec2<u32>) {
    // At the eye's own height any distance has slope 0, but for 0.
    let t_low = select(t0, t1, h0 >= vec2(0.0));
    let t_high = select(t0, t1, h1 <= vec2(0.0));
    // Beyond the window the division may be by nothing.
    let j = select(samples_at(t_low, h0), vec2(lo), h0 <= s.x * t_low);
    let j1 = select(samples_at(t_high, h1), vec2(hi), h1 >= s.y * t_high);
    // Nothing below `closed` can show: the first column is nearer than the second.
    let shown = shows & (j < j1);
    reach_lo = select(reach_lo, max(reach_lo, j1.x), shown.x && j.x == lo);
    let closed = vec2(lo, max(lo, reach_lo));
    let drawn = shown & (j1 > closed);
    let rises = drawn & (j <= closed);
    reach_lo = select(reach_lo, max(reach_lo, j1.y), rises.y);
    let hangs = drawn & !rises & (j1 == vec2(hi));
    reach_hi = select(reach_hi, min(reach_hi, j.x), hangs.x);
    reach_hi = select(reach_hi, min(reach_hi, j.y), hangs.y);
    n_spans += select(0u, 1u, drawn.x) + select(0u, 1u, drawn.y);
    if (!any(drawn)) {
        return;
    }
    // The samples that blocks leave.
    let start = select(j, max(j1 & vec2(~(BLOCK - 1)), closed), rises);
    let end = select(select(j, j1, drawn), min((j + (BLOCK - 1)) & vec2(~(BLOCK - 1)), vec2(hi)), hangs);
    let floating = drawn & !rises & !hangs;
    if (any(floating)) {
        atomicStore(&floats, 1u);
    }
    note(start.x, end.x, key.x, rises.x && start.x > closed.x, hangs.x && end.x < hi);
    note(start.y, end.y, key.y, rises.y && start.y > closed.y, hangs.y && end.y < hi);
    fill(start, end, key);
}

fn note(start: i32, end: i32, key: u32, rises: bool, hangs: bool) {
    if (rises || hangs) {
        lower_key(select(hanging(end), rising(start - 1), rises), key);
    }
}

// Both columns' samples in one loop: a block at once where it is filled, else four, else one.
fn fill(start: vec2<i32>, end: vec2<i32>, key: vec2<u32>) {
    var j = start;
    loop {
        let open = j < end;
        if (!any(open)) {
            break;
        }
        let whole = ((j & vec2(BLOCK - 1)) == vec2(0)) & (j + BLOCK <= end);
        let part = ((j & vec2(3)) == vec2(0)) & (j + 4 <= end);
        if (open.x) {
            lower_key(select(select(sample(j.x), four(j.x), part.x), filled(j.x), whole.x), key.x);
        }
        if (open.y) {
            lower_key(select(select(sample(j.y), four(j.y), part.y), filled(j.y), whole.y), key.y);
        }
        j += select(select(vec2(1), vec2(4), part), vec2(BLOCK), whole);
    }
}

// Shrinks the window to its unfilled samples; call with all lanes, after a barrier.
fn shrink(lane: u32, turn: u32) {
    if (!HORIZON) {
        return;
    }
    lo = max(lo, atomicLoad(&turns[turn].lo));
    hi = min(hi, atomicLoad(&turns[turn].hi));
    if (alike(lane, lo < hi && atomicLoad(&floats) == 1u && !(is_open(lo) && is_open(hi - 1)))) {
        for (var j = lo + i32(lane); j < hi; j += i32(WIDTH)) {
            if (is_open(j)) {
                if (j == lo || !is_open(j - 1)) {
                    atomicMin(&turns[turn].open_lo, j);
                }
                break;
            }
        }
        for (var j = hi - 1 - i32(lane); j >= lo; j -= i32(WIDTH)) {
            if (is_open(j)) {
                if (j == hi - 1 || !is_open(j + 1)) {
                    atomicMax(&turns[turn].open_hi, j + 1);
                }
                break;
            }
        }
        sync();
        lo = atomicLoad(&turns[turn].open_lo);
        hi = atomicLoad(&turns[turn].open_hi);
    }
    s = window_slopes();
}

// Brings the blocks' keys together: the nearest span that fills each. Call with all lanes.
fn settle(lane: u32) {
    sync();
    // 32 lanes have a stretch of blocks each; rising spans are handed down, hanging spans up.
    let n = i32(FINE) / BLOCK;
    let each = (n + 31) / 32 * BLOCK;
    let first = min(i32(lane) * each, i32(FINE));
    let end = select(first, min(first + each, i32(FINE)), lane < 32u);
    var rise = OPEN;
    var hang = OPEN;
    for (var j = first; j < end; j += BLOCK) {
        rise = min(rise, key_at(rising(origin + j)));
        hang = min(hang, key_at(hanging(origin + j)));
    }
    if (lane < 32u) {
        listed[lane] = rise;
        listed[lane + 32u] = hang;
    }
    sync();
    rise = OPEN;
    hang = OPEN;
    for (var k = 0u; k < 32u; k++) {
        rise = min(rise, select(OPEN, listed[k], k > lane));
        hang = min(hang, select(OPEN, listed[k + 32u], k < lane));
    }
    for (var j = end - BLOCK; j >= first; j -= BLOCK) {
        rise = min(rise, key_at(rising(origin + j)));
        set_key(rising(origin + j), rise);
    }
    for (var j = first; j < end; j += BLOCK) {
        hang = min(hang, key_at(hanging(origin + j)));
        set_key(hanging(origin + j), hang);
    }
    sync();
}

// Works out what the keys say, and what is still open where the walk is over.
fn resolve(lane: u32, epoch: i32, over: bool) {
    settle(lane);
    for (var j = plane.first + i32(lane); j < plane.end; j += i32(WIDTH)) {
        let block = min(key_at(rising(j)), key_at(hanging(j)));
        let key = min(key_of(j), block);
        if (key == OPEN) {
            if (over) {
                write_sky(j);
            }
        } else if (key != 0u) {
            show_key(j, key, epoch);
            if (!over) {
                set_key(sample(j), 0u);
            }
        }
    }
    if (!over) {
        sync();
        for (var i = FINE / 16u + lane; i < 3u * (FINE / 16u); i += WIDTH) {
            set_key(keys_at + FINE + i, OPEN);
        }
        sync();
    }
}

fn show_key(j: i32, key: u32, epoch: i32) {
    let met = met_of((key >> RUN_BITS) - 1u, epoch);
    let l = met.l;
    let t0 = met.t0;
    let t1 = met.t1;
    let ix = column_at(l, met.cell);
    let entry = column_entry(l, ix);
    var k = key & RUN_MANY;
    var run = entry.x;
    if (k > 0u) {
        run = runs(levels[l].runs + entry.y + k);
    }
    if (k == RUN_MANY) {
        // One of the runs from here down: the one whose span holds the sample.
        let n_more = runs(levels[l].runs + entry.y);
        loop {
            let h0 = height(run_first(run) << l);
            let h1 = height(run_end(run) << l);
            let start = sample_at(select(t0, t1, h0 >= 0.0), h0);
            let to = sample_at(select(t0, t1, h1 <= 0.0), h1);
            if ((j >= start && j < to) || k >= n_more) {
                break;
            }
            k += 1u;
            run = runs(levels[l].runs + entry.y + k);
        }
    }
    // Keys rank a column's runs from the top down. Above the eye it is the lowest that a sample meets which is nearest.
    if (entry.y != 0u && height(run_first(run) << l) > 0.0) {
        let n_more = runs(levels[l].runs + entry.y);
        while (k < n_more) {
            let below = runs(levels[l].runs + entry.y + k + 1u);
            let h0 = height(run_first(below) << l);
            if (h0 <= 0.0 || j >= sample_at(t0, height(run_end(below) << l)) || j < sample_at(t1, h0)) {
                break;
            }
            k += 1u;
            run = below;
        }
    }
    write_sample(j, l, met.cell, ix, k, run, height(run_first(run) << l), height(run_end(run) << l), t0);
}

//!endif
@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) grid: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let index = group.y * grid.x + group.x;
    if (index >= frame.n_planes) {
        return;
    }
    sight_begin(planes[index].turn);
//!if STORAGE_KEYS
    keys_at = 3u * frame.n_planes + index * KEYS;
//!endif
    begin(lane);
    let groups = level_group[level_count()];
    // Groups of a batch.
    let batch = WIDTH / u32(GROUP);
    var epoch = 0;
    var turn = 0u;
    var start = 0;
    loop {
        var over = start >= groups || lo >= hi;
        var slices = 0;
        if (!over) {
            let l = level_of_group(start);
            let n = start - level_group[l];
            slices = level_slice[l] + max(n * GROUP - GROUP, 0);
            if (COARSE) {
                // Nothing left can come into the window.
                let t = max(cross_major((group_cell(l, n) + select(GROUP, 0, step_major > 0)) << l), level_t[l]);
                over = (s.x > 0.0 && s.x * t >= frame.top) || (s.y < 0.0 && s.y * t <= frame.bottom);
            }
        }
        let ends = alike(lane, over);
        // Slices of this stretch must fit the keys.
        if (alike(lane, over || slices - epoch > EPOCH - i32(WIDTH) * GROUP)) {
            resolve(lane, epoch, ends);
            if (ends) {
                break;
            }
            epoch = slices;
        }
        // A lane's own group, which it tests until it is walked or can no longer show.
        var own: Group;
        var alive = start + i32(lane) < groups;
        if (alive) {
            let g = start + i32(lane);
            let l = level_of_group(g);
            let n = g - level_group[l];
            own = group_of(l, n);
            alive = own.t1 > own.t0;
            listed[lane] = (l << 27u) | u32(n);
        }
        var left = 1u;
        while (alike(lane, left > 0u && lo < hi)) {
            alive = alive && can_show(own);
            if (alive) {
                atomicOr(&turns[turn].survive[lane >> 5u], 1u << (lane & 31u));
            }
            sync();
            // The first groups that can show make up the batch: GROUP lanes each.
            var rank = lane / u32(GROUP);
            var mine = WIDTH;
            var n = 0u;
            for (var w = 0u; w < WIDTH / 32u; w++) {
                let bits = atomicLoad(&turns[turn].survive[w]);
                let here = countOneBits(bits);
                if (w == lane >> 5u) {
                    // Those ahead of this lane's own are taken first.
                    let ahead = n + countOneBits(bits & ((1u << (lane & 31u)) - 1u));
                    alive = alive && ahead >= batch;
                }
                if (rank >= n && rank < n + here) {
                    mine = w * 32u + nth_bit(bits, rank - n);
                }
                n += here;
            }
            left = select(0u, n - batch, n > batch);
            if (n > 0u) {
                reach_lo = -1;
                reach_hi = I32_MAX;
                if (mine < WIDTH) {
                    let i = i32(lane) % GROUP;
                    let l = listed[mine] >> 27u;
                    let cell = group_cell(l, i32(listed[mine] & 0x7ffffffu));
                    draw_slice(l, cell + select(GROUP - 1 - i, i, step_major > 0), epoch);
                }
                if (reach_lo > lo) {
                    atomicMax(&turns[turn].lo, reach_lo);
                }
                if (reach_hi < hi) {
                    atomicMin(&turns[turn].hi, reach_hi);
                }
            }
            if (lane == 0u) {
                reset_turn((turn + 2u) % 3u);
            }
            sync();
            if (alike(lane, n > 0u)) {
                shrink(lane, turn);
            }
            turn = (turn + 1u) % 3u;
        }
        start += i32(WIDTH);
    }
    if (COUNT) {
        atomicAdd(&counts[0], n_columns);
        atomicAdd(&counts[1], n_runs);
        atomicAdd(&counts[2], n_spans);
        sync();
        if (is_cut_short()) {
            atomicMax(&counts[0], CUT_SHORT);
        }
        if (ENDS_LOOPS) {
            sync();
        }
        if (lane < 3u) {
            atomicStore(&scratch[3u * index + lane], atomicLoad(&counts[lane]));
        }
    }
}
