// Whether the sun shines on a point: a walk over columns towards it. Twin: src/cpu/shadow.rs.

// Of each level of squares where its tops begin and how many a row has, then the tops.
@group(0) @binding(9) var<storage, read> tops: array<u32>;

override SMOOTH: bool = false;

// How far before the surface a walk begins, in voxels of level 0.
fn shadow_bias(size: f32, pixels: f32) -> f32 {
    let far = select(clamp((4.0 - pixels) * 0.5, 0.0, 1.0), 1.0, SMOOTH);
    return size * (SHADOW_BIAS_BLOCKS + (SHADOW_BIAS - SHADOW_BIAS_BLOCKS) * far);
}

// Past a border, and never back.
fn forward(t: f32, border: f32) -> f32 {
    let next = max(border, t);
    return next + (SHADOW_PAST + next * SHADOW_PAST_SHARE);
}

// Whether a column of level l at a place of level 0 is solid anywhere between two heights, the lower first.
fn blocks(l: u32, here: vec2<i32>, low: f32, high: f32) -> bool {
    let cell = here >> vec2(l);
    if (any(cell >= levels[l].size)) {
        return false;
    }
    let ix = column_index(l, cell.x, cell.y);
//!if HEIGHTS
    return f32(voxels(l, ix) << l) > low;
//!else
    let entry = column_entry(l, ix);
    if (entry.x == EMPTY || f32(run_end(entry.x) << l) <= low) {
        return false;
    }
    if (f32(run_first(entry.x) << l) < high) {
        return true;
    }
    if (entry.y == 0u) {
        return false;
    }
    let more = levels[l].runs + entry.y;
    // The highest run that begins below where the ray leaves.
    let n = runs(more);
    var lo = 0u;
    var hi = n;
    while (lo < hi) {
        let mid = (lo + hi) / 2u;
        if (f32(run_first(runs(more + 1u + mid)) << l) >= high) {
            lo = mid + 1u;
        } else {
            hi = mid;
        }
    }
    return lo < n && f32(run_end(runs(more + 1u + lo)) << l) > low;
//!endif
}

// Where a walk leaves the square of 2^shift columns that holds a place.
fn leave(here: vec2<i32>, base: vec2<i32>, shift: u32, start: vec2<f32>, dir: vec2<f32>, inverse: vec2<f32>) -> f32 {
    let first = (here >> vec2(shift)) << vec2(shift);
    let past = min(first + vec2(1i << shift), levels[0].size);
    let line = base + select(first, past, dir >= vec2(0.0));
    let at = (vec2<f32>(line) - start) * inverse;
    return min(at.x, at.y);
}

// Whether the sun shines on a point, given from the eye, that is drawn with voxels so large.
fn sun_shines(from_eye: vec3<f32>, size: f32) -> bool {
    let rise = frame.sun_world.y;
    if (rise <= 0.0) {
        return false;
    }
    let most = frame.top_levels - 1u;
    let drawn = min(u32(max(i32(bitcast<u32>(size) >> 23u) - 127, 0)), max(frame.levels, 1u) - 1u);
    let level = min(drawn, most);
    let at = from_eye.xz + frame.eye_fract.xz;
    let floor_ = floor(at);
    let start = at - floor_;
    let cell = frame.eye_cell.xz + vec2<i32>(floor_);
    let height_ = from_eye.y + (f32(frame.eye_cell.y) + frame.eye_fract.y);
    let dir = frame.sun_world.xz;
    let inverse = 1.0 / select(dir, select(vec2(1e-12), vec2(-1e-12), dir < vec2(0.0)), abs(dir) < vec2(1e-12));
    let end = min((frame.world_top - height_) / rise, frame.shadow_end);
    let dims = levels[0].size;
    let repeats = vec2(frame.repeat_x == 1u, frame.repeat_z == 1u);
    let outside = !repeats & ((cell < vec2(0)) | (cell >= dims));
    var t = 0.0;
    if (any(outside)) {
        // From outside to where the world begins.
        let near = select(dims, vec2(0), dir >= vec2(0.0));
        let enter = (vec2<f32>(near - cell) - start) * inverse;
        if (any(outside & (enter < vec2(0.0)))) {
            return true;
        }
        let in_ = select(vec2(0.0), enter + (SHADOW_PAST + enter * SHADOW_PAST_SHARE), outside);
        t = max(in_.x, in_.y);
    }
    var k = level;
    for (var turn = 0u; turn < SHADOW_STEPS; turn++) {
        if (t >= end) {
            return true;
        }
        let off = vec2<i32>(floor(start + dir * t));
        let world = cell + off;
        let within = (world >= vec2(0)) & (world < dims);
        if (any(!repeats & !within)) {
            return true;
        }
        let here = vec2(
            select(world.x, wrap(world.x, dims.x), repeats.x),
            select(world.y, wrap(world.y, dims.y), repeats.y),
        );
        let base = off - here;
        let shift = BLOCK_SHIFT + k;
        let square = vec2<u32>(here >> vec2(shift));
        let top = f32(tops[tops[2u * k] + square.y * tops[2u * k + 1u] + square.x]);
        let now = height_ + rise * t;
        if (now >= top) {
            t = forward(t, leave(here, base, shift, start, dir, inverse));
            k = min(k + 1u, most);
        } else if (k > level) {
            k -= 1u;
        } else {
            let next = forward(t, leave(here, base, level, start, dir, inverse));
            if (blocks(level, here, now, height_ + rise * next)) {
                return false;
            }
            t = next;
        }
    }
    return true;
}
