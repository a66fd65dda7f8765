// Stage matter: translucent matter over the shaded picture, front to back by the exact length of each way.
// Twin: src/cpu/matter.rs. Grid: pixels. Only scenes that have matter need it.
//!include shared/frame.wgsl

@group(0) @binding(4) var<storage, read> image_depth: array<u32>;
@group(0) @binding(5) var<storage, read_write> shaded: array<u32>;
// Of each level where its columns' ends begin, then the ends and runs of all levels. See src/gpu/matter.rs.
@group(0) @binding(11) var<storage, read> matter: array<u32>;
// What changes with the frame and the transfer function: a header, levels, optics by code, masks of blocks.
@group(0) @binding(12) var<storage, read> matter_look: array<u32>;

// Whether b comes first in the picture.
override BGRA: bool = false;

const VOLUMETRIC: u32 = 0u;
const SURFACE: u32 = 1u;
const ADDITIVE: u32 = 2u;

var<private> color: vec3<f32>;
var<private> left: f32;
var<private> depth: f32;
var<private> code: u32;
var<private> len: f32;

// A ray from where it meets the matter's box.
var<private> from_cell: vec2<i32>;
var<private> from_fract: vec2<f32>;
var<private> from_y: f32;
var<private> dir: vec3<f32>;
var<private> unit: f32;

fn extinction(of_code: u32) -> f32 {
    return bitcast<f32>(matter_look[matter_look[5] + 6u * of_code + 3u]);
}

fn mode(of_code: u32) -> u32 {
    return matter_look[matter_look[5] + 6u * of_code + 4u];
}

fn material(of_code: u32) -> u32 {
    return matter_look[matter_look[5] + 6u * of_code + 5u];
}

fn color_of(of_code: u32) -> vec3<f32> {
    let at = matter_look[5] + 6u * of_code;
    return vec3(bitcast<f32>(matter_look[at]), bitcast<f32>(matter_look[at + 1u]), bitcast<f32>(matter_look[at + 2u]));
}

fn add(of_code: u32, taken: f32) {
    if (mode(of_code) == ADDITIVE) {
        color += left * taken * color_of(of_code);
        return;
    }
    depth += taken;
    let after = left * exp(-taken);
    color += (left - after) * color_of(of_code);
    left = after;
}

fn flush() {
    let taken = extinction(code) * len;
    len = 0.0;
    if (taken > 0.0 && mode(code) != SURFACE) {
        add(code, taken);
    }
}

// A way through a code, behind what was before. Whether the pixel stays open.
fn pass_through(of_code: u32, way: f32) -> bool {
    if (of_code == code) {
        len += way;
    } else {
        flush();
        if (mode(of_code) == SURFACE && extinction(of_code) > 0.0 && material(of_code) != material(code)) {
            add(of_code, extinction(of_code));
        }
        code = of_code;
        len = way;
    }
    let m = mode(of_code);
    let under_way = select(extinction(of_code) * len, 0.0, m == SURFACE || m == ADDITIVE);
    return depth + under_way < MATTER_CLOSED;
}

// Whether a mask has a layer between two heights.
fn seen(mask: vec2<u32>, low: f32, high: f32, shift: u32) -> bool {
    let a = min(u32(max(low, 0.0)) >> shift, 63u);
    let b = min(u32(max(high, 0.0)) >> shift, 63u);
    var found = 0u;
    if (a < 32u) {
        found |= mask.x & (0xffffffffu << a) & (0xffffffffu >> (31u - min(b, 31u)));
    }
    if (b >= 32u) {
        found |= mask.y & (0xffffffffu << (max(a, 32u) - 32u)) & (0xffffffffu >> (63u - b));
    }
    return found != 0u;
}

// Where the line before cell c of blocks of 1 << shift voxels is crossed, along x (0) or z (1).
fn cross_at(axis: u32, c: i32, shift: u32) -> f32 {
    let d = select(dir.z, dir.x, axis == 0u);
    if (d == 0.0) {
        return F32_MAX;
    }
    let line = (c + select(0, 1, d > 0.0)) << shift;
    let cell = select(from_cell.y, from_cell.x, axis == 0u);
    let fract = select(from_fract.y, from_fract.x, axis == 0u);
    return (f32(line - cell) - fract) / d;
}

fn wrapped(v: i32, n: i32) -> i32 {
    let r = v % n;
    return select(r, r + n, r < 0);
}

fn repeats() -> vec2<bool> {
    return vec2(frame.repeat_x != 0u, frame.repeat_z != 0u);
}

fn whole(cell: vec2<i32>, size: vec2<i32>) -> vec2<i32> {
    return select(cell, vec2(wrapped(cell.x, size.x), wrapped(cell.y, size.y)), repeats());
}

fn cells_at(t: f32, level: u32, size: vec2<i32>) -> vec2<i32> {
    let at = (vec2<i32>(floor(from_fract + t * dir.xz)) + from_cell) >> vec2(level);
    return select(clamp(at, vec2(0), size - 1), at, repeats());
}

fn is_outside(cell: vec2<i32>, size: vec2<i32>) -> bool {
    let out = (cell < vec2(0)) | (cell >= size);
    return any(out & !repeats());
}

// The first run of a column that ends above a height, or, looking down, at it or above.
fn run_at(ends: u32, n: u32, y: f32, down: bool) -> u32 {
    var low = 0u;
    var high = n;
    while (low < high) {
        let middle = (low + high) >> 1u;
        let end = f32((matter[ends + middle] & 0xffffu) + 1u);
        if (end < y || (end == y && !down)) {
            low = middle + 1u;
        } else {
            high = middle;
        }
    }
    return low;
}

// Columns of a level between two places of the ray; whether the pixel stays open.
fn walk(level: u32, begin: f32, stop: f32) -> bool {
    let own = matter_look[4] + 8u * level;
    let size = vec2<i32>(i32(matter_look[own]), i32(matter_look[own + 1u]));
    let offsets = matter_look[own + 2u];
    let runs = matter_look[own + 3u];
    let masks = matter_look[own + 4u];
    let across = matter_look[own + 5u];
    let shift = matter_look[own + 6u];
    let scale = 1.0 / f32(1u << level);
    let y0 = from_y * scale;
    let dy = dir.y * scale;
    let step = select(vec2(1), vec2(-1), dir.xz < vec2(0.0));
    // Where the world repeats, a block may end before eight columns.
    let blocks = all(!repeats() | (size % vec2(BLOCK_SIZE) == vec2(0)));
    var t = begin;
    var cell = cells_at(t, level, size);
    var block = vec2(I32_MAX);
    var mask = vec2(0u);
    while (t < stop) {
        let now = cell >> vec2(BLOCK_SHIFT);
        if (any(now != block)) {
            block = now;
            mask = vec2(0xffffffffu);
            if (blocks) {
                let place = vec2<u32>(whole(cell, size)) >> vec2(BLOCK_SHIFT);
                let at = masks + 2u * (place.y * across + place.x);
                mask = vec2(matter_look[at], matter_look[at + 1u]);
            }
            let out = vec2(cross_at(0u, now.x, level + BLOCK_SHIFT), cross_at(1u, now.y, level + BLOCK_SHIFT));
            let leaves = min(min(out.x, out.y), stop);
            let a = y0 + t * dy;
            let b = y0 + leaves * dy;
            if (!seen(mask, min(a, b), max(a, b), shift)) {
                _ = pass_through(0u, 0.0);
                t = max(t, leaves);
                let before = cell;
                // On the line itself, rounding may leave it on this side, or put it back behind a line of the other axis.
                let there = cells_at(t, level, size);
                cell = select(min(there, before), max(there, before), step > vec2(0));
                let far = select((now << vec2(BLOCK_SHIFT)) - 1, (now + 1) << vec2(BLOCK_SHIFT), step > vec2(0));
                cell = select(cell, far, (cell >> vec2(BLOCK_SHIFT) == now) & (out <= vec2(t)));
                if (is_outside(cell, size)) {
                    return true;
                }
                if (all(cell == before) && t < stop) {
                    // No step is taken twice.
                    mask = vec2(0xffffffffu);
                } else {
                    continue;
                }
            }
        }
        let next = vec2(cross_at(0u, cell.x, level), cross_at(1u, cell.y, level));
        let along_x = next.x <= next.y;
        let leaves = min(min(next.x, next.y), stop);
        if (leaves > t) {
            let place = vec2<u32>(whole(cell, size));
            let column = offsets + place.y * u32(size.x) + place.x;
            let first = matter[column];
            let n = matter[column + 1u] - first;
            let a = y0 + t * dy;
            let b = y0 + leaves * dy;
            if (n == 0u || !seen(mask, min(a, b), max(a, b), shift)) {
                _ = pass_through(0u, leaves - t);
            } else {
                let all_ = (leaves - t) * unit;
                let per = select(unit / abs(dy), 0.0, dy == 0.0);
                let ends = runs + first;
                let down = dy < 0.0;
                var i = run_at(ends, n, a, down);
                var y = a;
                loop {
                    var of_code = 0u;
                    var end = select(F32_MAX, -F32_MAX, down);
                    if (i < n) {
                        let run = matter[ends + i];
                        of_code = run >> 16u;
                        if (!down) {
                            end = f32((run & 0xffffu) + 1u);
                        }
                    }
                    if (down && i > 0u) {
                        end = f32((matter[ends + i - 1u] & 0xffffu) + 1u);
                    }
                    let last = select(end >= b, end <= b, down);
                    var way = min(abs(select(end, b, last) - y) * per, all_);
                    if (last && y == a) {
                        way = all_;
                    }
                    if (!pass_through(of_code, way)) {
                        return false;
                    }
                    if (last) {
                        break;
                    }
                    y = end;
                    i = select(i + 1u, i - 1u, down);
                }
            }
            t = leaves;
        }
        if (t >= stop) {
            break;
        }
        if (along_x) {
            cell.x += step.x;
        } else {
            cell.y += step.y;
        }
        if (is_outside(cell, size)) {
            return true;
        }
    }
    return true;
}

struct Drawn {
    level: u32,
    // Where the next begins.
    next: f32,
}

// The level to draw at a distance.
fn level_at(far: f32) -> Drawn {
    let coarsest = matter_look[0];
    let finest = bitcast<f32>(matter_look[1]);
    if (coarsest == 0u) {
        return Drawn(0u, F32_MAX);
    }
    var next = min(finest * 2.0, F32_MAX);
    if (far < next) {
        return Drawn(0u, next);
    }
    var level = clamp(u32(min(log2(far / finest), 31.0)), 1u, coarsest);
    next = finest * exp2(f32(level + 1u));
    if (next <= far && level < coarsest) {
        level += 1u;
        next *= 2.0;
    }
    return Drawn(level, select(next, F32_MAX, level == coarsest));
}

// All of the ray's way up to what is solid.
fn look_along(ray: vec3<f32>, solid: f32) {
    let size = vec2<f32>(vec2(matter_look[6], matter_look[7]));
    dir = ray;
    unit = length(ray);
    let horizontal = length(ray.xz);
    var start = 0.0;
    var end = solid;
    if (horizontal > 0.0) {
        end = min(end, frame.view_distance / horizontal);
    }
    let free = vec3(frame.repeat_x != 0u, frame.repeat_z != 0u, false);
    let along = ray.xzy;
    let eye = vec3<f32>(frame.eye_cell.xzy) + frame.eye_fract.xzy;
    for (var k = 0u; k < 3u; k++) {
        if (free[k]) {
            continue;
        }
        var low = 0.0;
        var high = 0.0;
        if (k == 2u) {
            // Whole voxels of the level that is drawn up there.
            let level = level_at(end).level;
            low = f32((matter_look[2] >> level) << level);
            high = f32(((matter_look[3] + (1u << level) - 1u) >> level) << level);
        } else {
            high = size[k];
        }
        low -= eye[k];
        high -= eye[k];
        if (along[k] == 0.0) {
            if (low > 0.0 || high <= 0.0) {
                return;
            }
            continue;
        }
        let a = low / along[k];
        let b = high / along[k];
        start = max(start, min(a, b));
        end = min(end, max(a, b));
    }
    if (!(start < end)) {
        return;
    }
    let place = frame.eye_fract + start * ray;
    let cell = vec3<i32>(floor(place));
    from_cell = (frame.eye_cell + cell).xz;
    from_fract = (place - floor(place)).xz;
    from_y = f32(frame.eye_cell.y) + place.y;
    var t = 0.0;
    let stop = end - start;
    // A level follows another at most once.
    for (var turn = 0u; turn <= MAX_LEVELS; turn++) {
        let drawn = level_at(start + t);
        let here = min(stop, drawn.next - start);
        let open = walk(drawn.level, t, here);
        t = here;
        if (!open || t >= stop) {
            break;
        }
    }
    flush();
    if (depth >= MATTER_CLOSED) {
        // What was not looked at is taken to be as what was.
        color /= 1.0 - left;
        left = 0.0;
    }
}

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= frame.width || id.y >= frame.height) {
        return;
    }
    let i = id.y * frame.width + id.x;
    color = vec3(0.0);
    left = 1.0;
    depth = 0.0;
    code = 0u;
    len = 0.0;
    let bits = image_depth[i];
    let solid = select(bitcast<f32>(bits), F32_MAX, bits == INFINITY);
    look_along(frame.ray_origin + f32(id.x) * frame.ray_right + f32(id.y) * frame.ray_down, solid);
    if (left == 1.0 && all(color == vec3(0.0))) {
        return;
    }
    let rgba = shaded[i];
    var behind = vec3<f32>(vec3(rgba, rgba >> 8u, rgba >> 16u) & vec3(255u));
    let alpha = f32(rgba >> 24u) / 255.0;
    let through = left * alpha;
    let share = 1.0 - left + through;
    let own = select(color, color.bgr, BGRA);
    let mixed = select(vec3(0.0), (own + through * behind) / max(share, 1e-20), share > 0.0);
    let byte = vec4<u32>(clamp(vec4(mixed, share * 255.0) + 0.5, vec4(0.0), vec4(255.0)));
    shaded[i] = byte.x | (byte.y << 8u) | (byte.z << 16u) | (byte.w << 24u);
}
