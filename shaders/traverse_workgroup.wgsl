// Stage traverse, kernel `workgroup`: one plane per workgroup, WIDTH slices of the plane's ray at once.
// Twin: src/cpu/traverse.rs (same picture, other order of work). Grid: a workgroup a plane.
//
// The plane's ray is cut into slices along its longer axis; a slice meets at most two columns. Slices are taken in
// batches of WIDTH, a lane a slice, so that the loads of a whole batch are in flight together. Spans go into a line of
// keys by atomicMin, nearest slice first, so a batch needs no order; between batches the window shrinks. Long spans
// cost little: the line has a second row of keys, one for each 16 samples. What a sample shows is worked out once, from
// its key, when the walk is over.
//
//   key | slice and column 20 | run 12 |   0: shown already, ~0: open; run saturates, the rest is then searched for
//
// Ahead of the batches, groups of GROUP slices are tested against the height bounds of the blocks they meet; only those
// that can show are walked.
//!include shared/frame.wgsl
//!include shared/plane.wgsl
//!include shared/scene.wgsl
//!include shared/sight.wgsl

// Lanes; a multiple of 32, at most 256.
override WIDTH: u32 = 128u;
// Keys in the line's two rows.
override FINE: u32 = 1024u;
override ROUGH: u32 = 64u;

const OPEN: u32 = 0xffffffffu;
const RUN_BITS: u32 = 12u;
const RUN_MANY: u32 = 4095u;
// Slices that keys can tell apart before what they say must be written out.
const EPOCH: i32 = 520000;
const GROUP: i32 = BLOCK_SIZE;

//!if STORAGE_KEYS
@group(0) @binding(7) var<storage, read_write> keys: array<atomic<u32>>;
var<private> keys_at: u32;
//!else
var<workgroup> keys: array<atomic<u32>, FINE + ROUGH>;
const keys_at: u32 = 0u;
//!endif

// For each level: where it begins and ends, its first and last slice's cell, and slices and groups of the levels before.
var<workgroup> level_t: array<f32, MAX_LEVELS + 1>;
var<workgroup> level_cells: array<vec2<i32>, MAX_LEVELS>;
var<workgroup> level_slice: array<i32, MAX_LEVELS + 1>;
var<workgroup> level_group: array<i32, MAX_LEVELS + 1>;

// Groups of the stretch that can show, one bit each, and as a list.
var<workgroup> survive: array<atomic<u32>, 8>;
var<workgroup> survivors: array<u32, WIDTH>;
// First and one past the last unfilled sample; three in turn, so that one barrier separates use from reset.
var<workgroup> open_lo: array<atomic<i32>, 3>;
var<workgroup> open_hi: array<atomic<i32>, 3>;
var<workgroup> counts: array<atomic<u32>, 3>;

var<private> major: u32;
var<private> minor: u32;
var<private> step: vec2<i32>;
var<private> ahead: vec2<i32>;

// The open window and the slopes at its ends.
var<private> lo: i32;
var<private> hi: i32;
var<private> s: vec2<f32>;

var<private> n_columns: u32;
var<private> n_runs: u32;
var<private> n_spans: u32;

// All lanes have come here, and see each other's keys.
fn sync() {
    workgroupBarrier();
//!if STORAGE_KEYS
    storageBarrier();
//!endif
}

fn is_open(j: i32) -> bool {
    return atomicLoad(&keys[keys_at + u32(j)]) == OPEN && atomicLoad(&keys[keys_at + FINE + (u32(j) >> 4u)]) == OPEN;
}

// A stretch of the plane's ray between two lines of its longer axis.
struct Slice {
    l: u32,
    cell: i32,
    t0: f32,
    t1: f32,
}

fn slice_of(l: u32, cell: i32) -> Slice {
    let t0 = max(cross_axis(major, (cell + 1 - ahead[major]) << l), level_t[l]);
    let t1 = min(cross_axis(major, (cell + ahead[major]) << l), level_t[l + 1u]);
    return Slice(l, cell, t0, t1);
}

// The minor cell at t, within the world.
fn minor_cell(l: u32, t: f32) -> i32 {
    let at = locate(minor, t, l);
    let repeats = select(frame.repeat_x, frame.repeat_z, minor == 1u);
    return select(clamp(at, 0, levels[l].size[minor] - 1), at, repeats == 1u);
}

fn cell_of(major_cell: i32, minor_cell: i32) -> vec2<i32> {
    return select(vec2(minor_cell, major_cell), vec2(major_cell, minor_cell), major == 0u);
}

fn column_at(l: u32, cell: vec2<i32>) -> u32 {
    return column_index(l, wrap(cell.x, levels[l].size.x), wrap(cell.y, levels[l].size.y));
}

fn inside(l: u32, cell: vec2<i32>) -> bool {
    let within = (cell >= vec2(0)) & (cell < levels[l].size);
    return (within.x || frame.repeat_x == 1u) && (within.y || frame.repeat_z == 1u);
}

// A slice's columns: the first to tm, the second, if there is one, from there on.
struct Pair {
    first: i32,
    second: i32,
    tm: f32,
    two: bool,
}

fn pair_of(c: Slice) -> Pair {
    if (c.t0 >= frame.equidistant) {
        let axis = minor;
        let eye = select(frame.eye_cell.x, frame.eye_cell.z, axis == 1u);
        let fract = select(frame.eye_fract.x, frame.eye_fract.z, axis == 1u);
        let at = (i32(floor(fract + (c.t0 + c.t1) * 0.5 * plane.dir[axis])) + eye) >> c.l;
        return Pair(at, at, c.t1, false);
    }
    let at = minor_cell(c.l, c.t0);
    let tm = cross_axis(minor, (at + ahead[minor]) << c.l);
    return Pair(at, at + step[minor], max(tm, c.t0), tm < c.t1);
}

// Lays out the levels along the plane.
fn begin(lane: u32) {
    major = select(0u, 1u, abs(plane.dir.y) > abs(plane.dir.x));
    minor = 1u - major;
    step = select(vec2(1), vec2(-1), plane.dir < vec2(0.0));
    ahead = select(vec2(0), vec2(1), step > vec2(0));
    for (var i = lane; i < FINE + ROUGH; i += WIDTH) {
        atomicStore(&keys[keys_at + i], OPEN);
    }
    if (lane < 3u) {
        atomicStore(&open_lo[lane], I32_MAX);
        atomicStore(&open_hi[lane], -1);
        atomicStore(&counts[lane], 0u);
    }
    for (var l = lane; l < frame.levels; l += WIDTH) {
        var start = plane.t_start;
        if (l > plane.lod_first) {
            start = max(start, plane.lod_t * f32(1u << l));
        }
        var to = plane.t_end;
        if (l + 1u < frame.levels) {
            to = min(to, plane.lod_t * f32(1u << (l + 1u)));
        }
        start = min(start, plane.t_end);
        to = max(start, to);
        var cells = vec2(0);
        var n = vec2(0);
        if (l >= plane.lod_first && to > start) {
            cells.x = plane.cell[major] >> l;
            if (start > plane.t_start) {
                cells.x = locate(major, start, l);
            }
            cells.y = locate(major, to, l);
            n.x = max((cells.y - cells.x) * step[major], 0) + 1;
            n.y = max(((cells.y >> BLOCK_SHIFT) - (cells.x >> BLOCK_SHIFT)) * step[major], 0) + 1;
        } else {
            to = start;
        }
        level_cells[l] = cells;
        level_t[l] = start;
        level_slice[l] = n.x;
        level_group[l] = n.y;
    }
    sync();
    if (lane == 0u) {
        var slices = 0;
        var groups = 0;
        for (var l = 0u; l < frame.levels; l++) {
            let n = vec2(level_slice[l], level_group[l]);
            level_slice[l] = slices;
            level_group[l] = groups;
            slices += n.x;
            groups += n.y;
        }
        level_slice[frame.levels] = slices;
        level_group[frame.levels] = groups;
        level_t[frame.levels] = plane.t_end;
    }
    sync();
    lo = plane.first;
    hi = plane.end;
    s = vec2(s_first, s_end);
}

fn level_of_group(g: i32) -> u32 {
    var l = plane.lod_first;
    while (g >= level_group[l + 1u]) {
        l += 1u;
    }
    return l;
}

// Whether any block that a group of slices meets may show something.
fn group_shows(g: i32) -> bool {
    let l = level_of_group(g);
    let size = levels[l].size;
    let group = (level_cells[l].x >> BLOCK_SHIFT) + (g - level_group[l]) * step[major];
    // The group's slices on their way, nearest first.
    let near = select(group * GROUP + GROUP - 1, group * GROUP, step[major] > 0);
    let t0 = max(cross_axis(major, (near + 1 - ahead[major]) << l), level_t[l]);
    let far = near + (GROUP - 1) * step[major];
    let t1 = min(cross_axis(major, (far + ahead[major]) << l), level_t[l + 1u]);
    if (t1 <= t0) {
        return false;
    }
    if (!COARSE) {
        return true;
    }
    if ((s.x > 0.0 && s.x * t0 >= frame.top) || (s.y < 0.0 && s.y * t0 <= frame.bottom)) {
        return false;
    }
    let v = visible(s, t0, t1);
    let ends = vec2(minor_cell(l, t0), minor_cell(l, t1));
    let last = max(ends.x, ends.y);
    let size_minor = size[minor];
    let size_major = size[major];
    let repeats_major = select(frame.repeat_x, frame.repeat_z, major == 1u) == 1u;
    // Along each axis blocks end at multiples of their size and at the seam of a repeated world.
    var a = group * GROUP;
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
            let block = blocks(levels[l].blocks + u32(w.y >> BLOCK_SHIFT) * levels[l].blocks_row + u32(w.x >> BLOCK_SHIFT));
            if (block != EMPTY && height(run_end(block) << l) > v.x && height(run_first(block) << l) < v.y) {
                return true;
            }
            b += min((wb | (BLOCK_SIZE - 1)) + 1, size_minor) - wb;
        }
        a += min((wa | (BLOCK_SIZE - 1)) + 1, size_major) - wa;
    }
    return false;
}

// Slice number i of a group, nearest first; without length where the level does not have it.
fn group_slice(g: i32, i: i32) -> Slice {
    let l = level_of_group(g);
    let group = (level_cells[l].x >> BLOCK_SHIFT) + (g - level_group[l]) * step[major];
    let cell = group * GROUP + select(GROUP - 1 - i, i, step[major] > 0);
    let along = (cell - level_cells[l].x) * step[major];
    if (along < 0 || along > (level_cells[l].y - level_cells[l].x) * step[major]) {
        return Slice(l, cell, 0.0, 0.0);
    }
    return slice_of(l, cell);
}

fn slice_number(c: Slice) -> i32 {
    return level_slice[c.l] + (c.cell - level_cells[c.l].x) * step[major];
}

// Draws what a slice's columns show into the keys.
fn draw_slice(c: Slice, epoch: i32) {
    let pair = pair_of(c);
    let order = u32(slice_number(c) - epoch) * 2u + 1u;
    let cell0 = cell_of(c.cell, pair.first);
    let cell1 = cell_of(c.cell, pair.second);
    var pending = pair.two && inside(c.l, cell1);
    var entry = vec2(EMPTY, 0u);
    var later = entry;
    // Both loads in flight together.
    if (inside(c.l, cell0)) {
        entry = columns(levels[c.l].columns + column_at(c.l, cell0));
        n_columns += 1u;
    }
    if (pending) {
        later = columns(levels[c.l].columns + column_at(c.l, cell1));
        n_columns += 1u;
    }
    var t0 = c.t0;
    var t1 = select(c.t1, pair.tm, pair.two);
    var key = order << RUN_BITS;
    var v = visible(s, t0, t1);
    var k = 0u;
    var run = entry.x;
    var n_more = 0u;
    var more = 0u;
    loop {
        var done = run == EMPTY;
        if (!done) {
            n_runs += 1u;
            let h0 = height(run_first(run) << c.l);
            let h1 = height(run_end(run) << c.l);
            done = h1 <= v.x;
            if (!done && h0 < v.y) {
                draw(h0, h1, t0, t1, key | min(k, RUN_MANY));
            }
            if (!done && entry.y != 0u) {
                if (k == 0u) {
                    more = levels[c.l].runs + entry.y;
                    n_more = runs(more);
                    if (h0 >= v.y && n_more > 8u) {
                        // All above the window: binary search for the first run that reaches down into it.
                        var start = 0u;
                        var to = n_more;
                        while (start < to) {
                            let mid = (start + to) / 2u;
                            if (height(run_first(runs(more + 1u + mid)) << c.l) >= v.y) {
                                start = mid + 1u;
                            } else {
                                to = mid;
                            }
                        }
                        k = start;
                    }
                }
                done = k >= n_more;
                if (!done) {
                    k += 1u;
                    run = runs(more + k);
                }
            } else {
                done = true;
            }
        }
        if (done) {
            if (!pending) {
                break;
            }
            pending = false;
            t0 = pair.tm;
            t1 = c.t1;
            key = (order + 1u) << RUN_BITS;
            v = visible(s, t0, t1);
            k = 0u;
            entry = later;
            run = entry.x;
        }
    }
}

fn draw(h0: f32, h1: f32, t0: f32, t1: f32, key: u32) {
    // At the eye's own height any distance has slope 0, but for 0.
    var j = max(sample_at(select(t0, t1, h0 >= 0.0), h0), lo);
    let j1 = min(sample_at(select(t0, t1, h1 <= 0.0), h1), hi);
    if (j >= j1) {
        return;
    }
    n_spans += 1u;
    while (j < j1) {
        if ((j & 15) == 0 && j + 16 <= j1) {
            atomicMin(&keys[keys_at + FINE + (u32(j) >> 4u)], key);
            j += 16;
        } else {
            atomicMin(&keys[keys_at + u32(j)], key);
            j += 1;
        }
    }
}

// Shrinks the window to its unfilled samples; call with all lanes, after a barrier.
fn shrink(lane: u32, turn: u32) {
    if (HORIZON) {
        for (var j = lo + i32(lane); j < hi; j += i32(WIDTH)) {
            if (is_open(j)) {
                if (j == lo || !is_open(j - 1)) {
                    atomicMin(&open_lo[turn], j);
                }
                break;
            }
        }
        for (var j = hi - 1 - i32(lane); j >= lo; j -= i32(WIDTH)) {
            if (is_open(j)) {
                if (j == hi - 1 || !is_open(j + 1)) {
                    atomicMax(&open_hi[turn], j + 1);
                }
                break;
            }
        }
        sync();
        lo = atomicLoad(&open_lo[turn]);
        hi = atomicLoad(&open_hi[turn]);
        if (lane == 0u) {
            let next = (turn + 2u) % 3u;
            atomicStore(&open_lo[next], I32_MAX);
            atomicStore(&open_hi[next], -1);
        }
        s = vec2(edge_slope(lo), edge_slope(hi));
    }
}

// Works out what the keys say, and what is still open where the walk is over.
fn resolve(lane: u32, epoch: i32, over: bool) {
    for (var j = plane.first + i32(lane); j < plane.end; j += i32(WIDTH)) {
        let key = min(atomicLoad(&keys[keys_at + u32(j)]), atomicLoad(&keys[keys_at + FINE + (u32(j) >> 4u)]));
        if (key == 0u) {
            continue;
        }
        if (key == OPEN) {
            if (over) {
                write_sky(j);
            }
            continue;
        }
        let order = (key >> RUN_BITS) - 1u;
        let n = i32(order >> 1u) + epoch;
        var l = plane.lod_first;
        while (n >= level_slice[l + 1u]) {
            l += 1u;
        }
        let c = slice_of(l, level_cells[l].x + (n - level_slice[l]) * step[major]);
        let pair = pair_of(c);
        let second = (order & 1u) == 1u;
        let cell = cell_of(c.cell, select(pair.first, pair.second, second));
        let t0 = select(c.t0, pair.tm, second);
        let t1 = select(select(c.t1, pair.tm, pair.two), c.t1, second);
        let ix = column_at(l, cell);
        let entry = columns(levels[l].columns + ix);
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
        write_sample(j, l, cell, ix, k, run, height(run_first(run) << l), height(run_end(run) << l), t0);
        if (!over) {
            atomicStore(&keys[keys_at + u32(j)], 0u);
        }
    }
}

@compute @workgroup_size(WIDTH)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) grid: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = group.y * grid.x + group.x;
    if (index >= frame.n_planes) {
        return;
    }
    sight_begin(index);
//!if STORAGE_KEYS
    keys_at = index * (FINE + ROUGH);
//!endif
    begin(lane);
    let groups = level_group[frame.levels];
    var epoch = 0;
    var turn = 0u;
    var start = 0;
    while (start < groups && lo < hi) {
        if (lane < 8u) {
            atomicStore(&survive[lane], 0u);
        }
        // Slices of this stretch must fit the keys.
        let slices = slice_bound(start);
        if (slices - epoch > EPOCH - i32(WIDTH) * GROUP) {
            sync();
            resolve(lane, epoch, false);
            epoch = slices;
        }
        sync();
        let g = start + i32(lane);
        if (g < groups && group_shows(g)) {
            atomicOr(&survive[lane >> 5u], 1u << (lane & 31u));
        }
        sync();
        var before = 0u;
        var n = 0u;
        for (var w = 0u; w < WIDTH / 32u; w++) {
            let bits = atomicLoad(&survive[w]);
            before += select(0u, countOneBits(bits), w < (lane >> 5u));
            n += countOneBits(bits);
        }
        let own = atomicLoad(&survive[lane >> 5u]);
        if (((own >> (lane & 31u)) & 1u) == 1u) {
            survivors[before + countOneBits(own & ((1u << (lane & 31u)) - 1u))] = lane;
        }
        sync();
        for (var i0 = 0u; i0 < n * u32(GROUP) && lo < hi; i0 += WIDTH) {
            let i = i0 + lane;
            if (i < n * u32(GROUP)) {
                let c = group_slice(start + i32(survivors[i / u32(GROUP)]), i32(i % u32(GROUP)));
                if (c.t1 > c.t0) {
                    draw_slice(c, epoch);
                }
            }
            sync();
            shrink(lane, turn);
            turn = (turn + 1u) % 3u;
        }
        start += i32(WIDTH);
        // Nothing left can come into the window.
        if (COARSE && start < groups && lo < hi) {
            let t = group_t(start);
            if ((s.x > 0.0 && s.x * t >= frame.top) || (s.y < 0.0 && s.y * t <= frame.bottom)) {
                break;
            }
        }
    }
    sync();
    resolve(lane, epoch, true);
    if (COUNT) {
        atomicAdd(&counts[0], n_columns);
        atomicAdd(&counts[1], n_runs);
        atomicAdd(&counts[2], n_spans);
        sync();
        if (lane < 3u) {
            counters[3u * index + lane] = atomicLoad(&counts[lane]);
        }
    }
}

// Number of the first slice of a group, or less.
fn slice_bound(g: i32) -> i32 {
    let l = level_of_group(g);
    return level_slice[l] + max((g - level_group[l]) * GROUP - GROUP, 0);
}

// Where a group begins.
fn group_t(g: i32) -> f32 {
    let l = level_of_group(g);
    let group = (level_cells[l].x >> BLOCK_SHIFT) + (g - level_group[l]) * step[major];
    let near = select(group * GROUP + GROUP - 1, group * GROUP, step[major] > 0);
    return max(cross_axis(major, (near + 1 - ahead[major]) << l), level_t[l]);
}
