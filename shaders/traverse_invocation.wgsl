// Stage traverse, kernel `invocation`: one plane per invocation (the paper's mapping), visibility bits in workgroup memory.
// Twin: src/cpu/traverse.rs, which explains the walk. Grid: planes in x.
//!include shared/frame.wgsl
//!include shared/plane.wgsl
//!include shared/scene.wgsl
//!include shared/sight.wgsl

override WIDTH: u32 = 32u;
// 32-bit words of visibility a plane.
override WORDS: u32 = 32u;

// Counters of all planes, then visibility bits that do not fit in workgroup memory.
@group(0) @binding(6) var<storage, read_write> scratch: array<u32>;
//!if !STORAGE_BITS
// Word w of lane k at w·WIDTH + k, so that lanes meet no bank twice.
var<workgroup> bits: array<u32, WORDS * WIDTH>;
//!endif
var<private> bits_at: u32;
var<private> bits_stride: u32;

// The open window, slopes at its ends, the center segment, unfilled samples left.
var<private> lo: i32;
var<private> hi: i32;
var<private> s: vec2<f32>;
var<private> center: vec2<i32>;
var<private> s_center: vec2<f32>;
var<private> left: i32;

var<private> n_columns: u32;
var<private> n_runs: u32;
var<private> n_spans: u32;

fn open_word(w: u32) -> u32 {
//!if STORAGE_BITS
    return scratch[bits_at + w * bits_stride];
//!else
    return bits[bits_at + w * bits_stride];
//!endif
}

fn set_open_word(w: u32, open: u32) {
//!if STORAGE_BITS
    scratch[bits_at + w * bits_stride] = open;
//!else
    bits[bits_at + w * bits_stride] = open;
//!endif
}

fn is_open(j: i32) -> bool {
    if (BITS) {
        return ((open_word(u32(j) >> 5u) >> (u32(j) & 31u)) & 1u) == 1u;
    }
    return plane_depth[plane.base + u32(j)] == INFINITY;
}

fn closed() -> bool {
    return lo >= hi || left == 0;
}

// The lowest n bits, 0 to 32.
fn low_bits(n: i32) -> u32 {
    if (n >= 32) {
        return 0xffffffffu;
    }
    return (1u << u32(max(n, 0))) - 1u;
}

fn begin() {
    for (var w = 0; w < i32(WORDS); w++) {
        set_open_word(u32(w), low_bits(plane.end - 32 * w) & ~low_bits(plane.first - 32 * w));
    }
    for (var j = plane.first; j < plane.end; j++) {
        write_sky(j);
    }
    lo = plane.first;
    hi = plane.end;
    s = vec2(s_first, s_end);
    left = hi - lo;
}

fn walk() {
    let step = select(vec2(1), vec2(-1), plane.dir < vec2(0.0));
    let ahead = select(vec2(0), vec2(1), step > vec2(0));
    var t0 = plane.t_start;
    var l = plane.lod_first;
    var cell = plane.cell >> vec2(l);
    loop {
        if (l >= level_count()) {
            return;
        }
        let size = levels[l].size;
        var next_level = STEEP;
        if (l + 1u < level_count()) {
            next_level = plane.lod_t * f32(1u << (l + 1u));
        }
        loop {
            if (t0 >= plane.t_end || closed()) {
                return;
            }
            if (t0 >= next_level) {
                break;
            }
            // Nothing left can come into the window.
            if (COARSE && ((s.x > 0.0 && s.x * t0 >= frame.top) || (s.y < 0.0 && s.y * t0 <= frame.bottom))) {
                return;
            }
            let spaced = t0 >= frame.equidistant;
            let limit = min(min(plane.t_end, next_level), select(frame.equidistant, STEEP, spaced));
            if (spaced) {
                // One column a slice of the plane's longer axis, the one at the slice's middle.
                let major = select(0u, 1u, abs(plane.dir.y) > abs(plane.dir.x));
                let t1 = max(min(cross_axis(major, (cell[major] + ahead[major]) << l), limit), t0);
                cell[1u - major] = middle_cell(1u - major, (t0 + t1) * 0.5, l);
                if (t1 > t0) {
                    column(l, cell, t0, t1);
                }
                if (t1 < limit) {
                    cell[major] += step[major];
                }
                t0 = t1;
                continue;
            }
            // Rounding can put the world's far edge a little before `t_end`.
            if (!in_world(l, cell)) {
                return;
            }
            // The block of columns that `cell` lies in, cut off where the world repeats.
            let wrapped = vec2(wrap(cell.x, size.x), wrap(cell.y, size.y));
            let up = min((wrapped | vec2(BLOCK_SIZE - 1)) + 1, size) - wrapped;
            let down = -(wrapped & vec2(BLOCK_SIZE - 1)) - 1;
            let stop = cell + select(down, up, step > vec2(0));
            let exit = vec2(cross_x((stop.x + 1 - ahead.x) << l), cross_z((stop.y + 1 - ahead.y) << l));
            let t_exit = min(exit.x, exit.y);
            if (COARSE) {
                let block = block_of(l, wrapped);
                let v = visible(s, t0, min(t_exit, limit));
                if (block == EMPTY || height(run_end(block) << l) <= v.x || height(run_first(block) << l) >= v.y) {
                    let t1 = min(t_exit, limit);
                    let inner = stop - step;
                    let start = cell;
                    cell = clamp(vec2(locate(0u, t1, l), locate(1u, t1, l)), min(start, inner), max(start, inner));
                    if (t_exit <= limit) {
                        let axis = select(0u, 1u, exit.y < exit.x);
                        cell[axis] = stop[axis];
                    }
                    // Not max: of a block that ends where the eye stands t1 is -0, and depths are compared as bits.
                    t0 = select(t0, t1, t1 > t0);
                    continue;
                }
            }
            // Column by column through the block.
            var next = vec2(cross_x((cell.x + ahead.x) << l), cross_z((cell.y + ahead.y) << l));
            loop {
                let along_x = next.x <= next.y;
                let nearest = min(next.x, next.y);
                let t1 = min(nearest, limit);
                if (t1 > t0) {
                    column(l, cell, t0, t1);
                    t0 = t1;
                    if (closed()) {
                        return;
                    }
                }
                if (nearest >= limit) {
                    break;
                }
                if (along_x) {
                    cell.x += step.x;
                    if (cell.x == stop.x) {
                        break;
                    }
                    next.x = cross_x((cell.x + ahead.x) << l);
                } else {
                    cell.y += step.y;
                    if (cell.y == stop.y) {
                        break;
                    }
                    next.y = cross_z((cell.y + ahead.y) << l);
                }
            }
        }
        l += 1u;
        cell = cell >> vec2(1u);
    }
}

// The cell that holds the plane's point at t, where no crossing decides.
fn middle_cell(axis: u32, t: f32, l: u32) -> i32 {
    let eye = select(frame.eye_cell.x, frame.eye_cell.z, axis == 1u);
    let fract = select(frame.eye_fract.x, frame.eye_fract.z, axis == 1u);
    return (i32(floor(fract + t * plane.dir[axis])) + eye) >> l;
}

// Looks at one column between t0 and t1.
fn column(l: u32, cell: vec2<i32>, t0: f32, t1: f32) {
    let size = levels[l].size;
    // A slice's middle can lie beside a world that the slice still touches.
    if (!in_world(l, cell)) {
        return;
    }
    n_columns += 1u;
    let ix = column_index(l, wrap(cell.x, size.x), wrap(cell.y, size.y));
    let entry = column_entry(l, ix);
    var v = visible(s, t0, t1);
    var run = entry.x;
    if (run == EMPTY || height(run_end(run) << l) <= v.x) {
        return;
    }
    let more = levels[l].runs + entry.y;
    var n_more = 0u;
    if (entry.y != 0u) {
        n_more = runs(more);
    }
    // From the eye outwards: what is nearer in height hides what is farther. First those that do not start above the eye,
    // from the top down; of many, from the first that reaches down into the window.
    let over = starting(l, run, more, n_more, 0.0, true);
    var k = over;
    if (n_more > 8u) {
        k = max(k, starting(l, run, more, n_more, v.y, false));
    }
    while (k <= n_more) {
        n_runs += 1u;
        run = run_at(entry.x, more, k);
        let h1 = height(run_end(run) << l);
        if (h1 <= v.x) {
            break;
        }
        if (draw_run(l, cell, ix, k, run, h1, t0, t1, v)) {
            if (closed()) {
                return;
            }
            v = visible(s, t0, t1);
        }
        k += 1u;
    }
    k = over;
    while (k > 0u) {
        k -= 1u;
        n_runs += 1u;
        run = run_at(entry.x, more, k);
        if (height(run_first(run) << l) >= v.y) {
            return;
        }
        if (draw_run(l, cell, ix, k, run, height(run_end(run) << l), t0, t1, v)) {
            if (closed()) {
                return;
            }
            v = visible(s, t0, t1);
        }
    }
}

// Run k of a column, from the top down.
fn run_at(top: u32, more: u32, k: u32) -> u32 {
    if (k == 0u) {
        return top;
    }
    return runs(more + k);
}

// How many runs of a column, from the top down, start at height h or above; or, with `past`, above it.
fn starting(l: u32, top: u32, more: u32, n_more: u32, h: f32, past: bool) -> u32 {
    var start = 0u;
    var to = n_more + 1u;
    while (start < to) {
        let mid = (start + to) / 2u;
        let h0 = height(run_first(run_at(top, more, mid)) << l);
        if (h0 > h || (h0 == h && !past)) {
            start = mid + 1u;
        } else {
            to = mid;
        }
    }
    return start;
}

// Draws a run that ends above the window's foot, if it may show; says whether it did.
fn draw_run(l: u32, cell: vec2<i32>, ix: u32, k: u32, run: u32, h1: f32, t0: f32, t1: f32, v: vec2<f32>) -> bool {
    let h0 = height(run_first(run) << l);
    if (h0 >= v.y || h1 <= v.x) {
        return false;
    }
    let inside = CENTER && center.y > center.x
        && h1 <= s_center.y * select(t0, t1, h1 < 0.0)
        && h0 >= s_center.x * select(t0, t1, h0 > 0.0);
    if (!inside) {
        draw(l, cell, ix, k, run, h0, h1, t0, t1);
    }
    return !inside;
}

fn draw(l: u32, cell: vec2<i32>, ix: u32, k: u32, run: u32, h0: f32, h1: f32, t0: f32, t1: f32) {
    // At the eye's own height any distance has slope 0, but for 0.
    let j0 = max(sample_at(select(t0, t1, h0 >= 0.0), h0), lo);
    let j1 = min(sample_at(select(t0, t1, h1 <= 0.0), h1), hi);
    if (j0 >= j1) {
        return;
    }
    n_spans += 1u;
    if (BITS && FORWARD) {
        for (var w = j0 >> 5u; w <= (j1 - 1) >> 5u; w++) {
            let mask = low_bits(j1 - 32 * w) & ~low_bits(j0 - 32 * w);
            let word = open_word(u32(w));
            var open = word & mask;
            set_open_word(u32(w), word & ~mask);
            left -= i32(countOneBits(open));
            while (open != 0u) {
                write_sample(32 * w + i32(countTrailingZeros(open)), l, cell, ix, k, run, h0, h1, t0);
                open &= open - 1u;
            }
        }
    } else {
        for (var j = j0; j < j1; j++) {
            if (is_open(j)) {
                set_open_word(u32(j) >> 5u, open_word(u32(j) >> 5u) & ~(1u << (u32(j) & 31u)));
                left -= 1;
                write_sample(j, l, cell, ix, k, run, h0, h1, t0);
            }
        }
    }
    cull(j0, j1);
}

// Takes note that samples j0 .. j1 are filled.
fn cull(j0: i32, j1: i32) {
    if (HORIZON) {
        if (j0 <= lo) {
            lo = first_open(j1);
            s.x = edge_slope(lo);
        }
        if (j1 >= hi && lo < hi) {
            hi = last_open(j0) + 1;
            s.y = edge_slope(hi);
        }
    }
    if (CENTER && j0 > lo && j1 < hi) {
        var merged = vec2(j0, j1);
        if (j0 <= center.y && j1 >= center.x && center.y > center.x) {
            merged = vec2(min(center.x, j0), max(center.y, j1));
        }
        if (merged.y - merged.x > center.y - center.x) {
            center = merged;
            s_center = vec2(edge_slope(center.x), edge_slope(center.y));
        }
    }
}

// The first unfilled sample from j on, hi if there is none.
fn first_open(start: i32) -> i32 {
    var j = start;
    if (BITS) {
        while (j < hi) {
            let open = open_word(u32(j) >> 5u) & ~low_bits(j & 31);
            if (open != 0u) {
                return min((j & -32) + i32(countTrailingZeros(open)), hi);
            }
            j = (j & -32) + 32;
        }
        return hi;
    }
    while (j < hi && !is_open(j)) {
        j++;
    }
    return j;
}

// The last unfilled sample before j, lo - 1 if there is none.
fn last_open(before: i32) -> i32 {
    var j = before - 1;
    if (BITS) {
        while (j >= lo) {
            let open = open_word(u32(j) >> 5u) & low_bits((j & 31) + 1);
            if (open != 0u) {
                return max((j & -32) + 31 - i32(countLeadingZeros(open)), lo - 1);
            }
            j = (j & -32) - 1;
        }
        return lo - 1;
    }
    while (j >= lo && !is_open(j)) {
        j--;
    }
    return j;
}

@compute @workgroup_size(WIDTH)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    if (id.x >= frame.n_planes) {
        return;
    }
    sight_begin(id.x);
//!if STORAGE_BITS
    bits_at = 3u * frame.n_planes + id.x * WORDS;
    bits_stride = 1u;
//!else
    bits_at = lane;
    bits_stride = WIDTH;
//!endif
    begin();
    walk();
    if (COUNT) {
        scratch[3u * id.x] = select(n_columns, CUT_SHORT, is_cut_short());
        scratch[3u * id.x + 1u] = n_runs;
        scratch[3u * id.x + 2u] = n_spans;
    }
}
