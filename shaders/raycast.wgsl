// Stage traverse, kernel `raycast`: one ray per pixel over the same tables and levels, straight into the image; the
// baseline that planes are measured against. Grid: pixels.
//!include shared/frame.wgsl
//!include shared/plane.wgsl
//!include shared/scene.wgsl
//!include shared/place.wgsl

override WIDTH: u32 = 8u;
override ROWS: u32 = 8u;

@group(0) @binding(3) var<storage, read_write> image_color: array<u32>;
@group(0) @binding(4) var<storage, read_write> image_depth: array<u32>;
@group(0) @binding(5) var<storage, read_write> image_voxel: array<vec4<i32>>;
@group(0) @binding(6) var<storage, read_write> scratch: array<u32>;

var<workgroup> counts: array<atomic<u32>, 3>;
var<private> n_columns: u32;
var<private> n_runs: u32;

// The ray: direction with component 1 along the camera's forward axis, so that its parameter is depth.
var<private> ray: vec3<f32>;
var<private> inverse: vec3<f32>;
var<private> hit: bool;
var<private> hit_depth: f32;
var<private> hit_color: u32;
var<private> hit_voxel: vec4<i32>;

fn height(y: i32) -> f32 {
    return f32(y - frame.eye_cell.y) - frame.eye_fract.y;
}

fn cross_ray(axis: u32, line: i32) -> f32 {
    let a = axis * 2u;
    return select((f32(line - frame.eye_cell[a]) - frame.eye_fract[a]) * inverse[a], STEEP, ray[a] == 0.0);
}

fn locate_ray(axis: u32, q: f32, l: u32, step: i32, ahead: i32) -> i32 {
    let a = axis * 2u;
    var at = (i32(floor(frame.eye_fract[a] + q * ray[a])) + frame.eye_cell[a]) >> l;
    if (ray[a] == 0.0) {
        return at;
    }
    if (cross_ray(axis, (at + ahead) << l) <= q) {
        at += step;
    } else if (cross_ray(axis, (at + 1 - ahead) << l) > q) {
        at -= step;
    }
    return at;
}

// The first run of a column that the ray meets between q0 and q1.
fn column(l: u32, cell: vec2<i32>, q0: f32, q1: f32) {
    n_columns += 1u;
    let ix = column_index(l, wrap(cell.x, levels[l].size.x), wrap(cell.y, levels[l].size.y));
    let entry = column_entry(l, ix);
    if (entry.x == EMPTY) {
        return;
    }
    let ends = vec2(ray.y * q0, ray.y * q1);
    let low = min(ends.x, ends.y);
    let high = max(ends.x, ends.y);
    var run = entry.x;
    if (height(run_end(run) << l) <= low) {
        return;
    }
    var k = 0u;
    var n_more = 0u;
    let more = levels[l].runs + entry.y;
    if (entry.y != 0u) {
        n_more = runs(more);
    }
    // Going down the first run met is the highest one that reaches below the entry; going up the lowest above it.
    var found = false;
    var found_run = 0u;
    var found_k = 0u;
    loop {
        n_runs += 1u;
        let h0 = height(run_first(run) << l);
        let h1 = height(run_end(run) << l);
        if (h1 <= low) {
            break;
        }
        if (h0 < high || (h0 == high && low == high)) {
            found = true;
            found_run = run;
            found_k = k;
            if (ray.y <= 0.0 || h0 <= ends.x) {
                break;
            }
        } else if (k == 0u && n_more > 8u) {
            var start = 0u;
            var to = n_more;
            while (start < to) {
                let mid = (start + to) / 2u;
                if (height(run_first(runs(more + 1u + mid)) << l) >= high) {
                    start = mid + 1u;
                } else {
                    to = mid;
                }
            }
            k = start;
        }
        if (k >= n_more) {
            break;
        }
        k += 1u;
        run = runs(more + k);
    }
    if (!found) {
        return;
    }
    let first = run_first(found_run);
    let last = run_end(found_run) - 1;
    let h0 = height(first << l);
    let h1 = height((last + 1) << l);
    var q = q0;
    var y: i32;
    if (ends.x >= h1) {
        q = h1 * inverse.y;
        y = last;
    } else if (ends.x < h0) {
        q = h0 * inverse.y;
        y = first;
    } else {
        y = first + (i32(clamp(ends.x - h0, 0.0, f32(((last - first + 1) << l) - 1))) >> l);
    }
    hit = true;
    hit_depth = clamp(q, 0.0, F32_MAX);
    hit_color = paint_color(l, ix, found_k, u32(y));
    hit_voxel = vec4((cell.x << l) + frame.offset_x, y << l, (cell.y << l) + frame.offset_z, i32(l));
}

fn walk(p: u32) {
    let horizontal = length(ray.xz);
    let step = select(vec2(1), vec2(-1), ray.xz < vec2(0.0));
    let ahead = select(vec2(0), vec2(1), step > vec2(0));
    // The part of the ray that lies in the world, in the view and within the world's heights.
    var q0 = 0.0;
    var q_end = min(frame.view_distance / max(horizontal, TINY), 1e17);
    for (var axis = 0u; axis < 2u; axis++) {
        let repeats = select(frame.repeat_x, frame.repeat_z, axis == 1u);
        if (REPEATS && repeats == 1u) {
            continue;
        }
        let n = levels[0].size[axis];
        if (ray[2u * axis] == 0.0) {
            if (frame.eye_cell[2u * axis] < 0 || frame.eye_cell[2u * axis] >= n) {
                return;
            }
            continue;
        }
        q0 = max(q0, cross_ray(axis, select(n, 0, step[axis] > 0)));
        q_end = min(q_end, cross_ray(axis, select(0, n, step[axis] > 0)));
    }
    if (ray.y > 0.0) {
        q0 = max(q0, frame.bottom * inverse.y);
        q_end = min(q_end, frame.top * inverse.y);
    } else if (ray.y < 0.0) {
        q0 = max(q0, frame.top * inverse.y);
        q_end = min(q_end, frame.bottom * inverse.y);
    }
    if (q0 >= q_end) {
        return;
    }
    // Levels begin where those of the pixel's plane do.
    let lod_q = planes[p].lod_t / max(horizontal, TINY);
    var l = planes[p].lod_first;
    while (l + 1u < level_count() && q0 >= lod_q * f32(1u << (l + 1u))) {
        l += 1u;
    }
    var cell = vec2(locate_ray(0u, q0, l, step.x, ahead.x), locate_ray(1u, q0, l, step.y, ahead.y));
    if (!REPEATS || frame.repeat_x == 0u) {
        cell.x = clamp(cell.x, 0, levels[l].size.x - 1);
    }
    if (!REPEATS || frame.repeat_z == 0u) {
        cell.y = clamp(cell.y, 0, levels[l].size.y - 1);
    }
    loop {
        let size = levels[l].size;
        var next_level = STEEP;
        if (l + 1u < level_count()) {
            next_level = lod_q * f32(1u << (l + 1u));
        }
        let limit = min(q_end, next_level);
        loop {
            if (q0 >= limit) {
                break;
            }
            let wrapped = vec2(wrap(cell.x, size.x), wrap(cell.y, size.y));
            let up = min((wrapped | vec2(BLOCK_SIZE - 1)) + 1, size) - wrapped;
            let down = -(wrapped & vec2(BLOCK_SIZE - 1)) - 1;
            let stop = cell + select(down, up, step > vec2(0));
            let exit = vec2(cross_ray(0u, (stop.x + 1 - ahead.x) << l), cross_ray(1u, (stop.y + 1 - ahead.y) << l));
            let q_exit = min(exit.x, exit.y);
            let q1 = min(q_exit, limit);
            if (COARSE) {
                let block = block_of(l, wrapped);
                let ends = vec2(ray.y * q0, ray.y * q1);
                if (block == EMPTY || height(run_end(block) << l) <= min(ends.x, ends.y)
                    || height(run_first(block) << l) > max(ends.x, ends.y)) {
                    let inner = stop - step;
                    let start = cell;
                    cell = vec2(locate_ray(0u, q1, l, step.x, ahead.x), locate_ray(1u, q1, l, step.y, ahead.y));
                    cell = clamp(cell, min(start, inner), max(start, inner));
                    if (q_exit <= limit) {
                        let axis = select(0u, 1u, exit.y < exit.x);
                        cell[axis] = stop[axis];
                    }
                    q0 = max(q0, q1);
                    continue;
                }
            }
            var next = vec2(cross_ray(0u, (cell.x + ahead.x) << l), cross_ray(1u, (cell.y + ahead.y) << l));
            loop {
                let along_x = next.x <= next.y;
                let nearest = min(next.x, next.y);
                let t1 = min(nearest, limit);
                if (t1 > q0) {
                    column(l, cell, q0, t1);
                    if (hit) {
                        return;
                    }
                    q0 = t1;
                }
                if (nearest >= limit) {
                    break;
                }
                if (along_x) {
                    cell.x += step.x;
                    if (cell.x == stop.x) {
                        break;
                    }
                    next.x = cross_ray(0u, (cell.x + ahead.x) << l);
                } else {
                    cell.y += step.y;
                    if (cell.y == stop.y) {
                        break;
                    }
                    next.y = cross_ray(1u, (cell.y + ahead.y) << l);
                }
            }
        }
        if (q0 >= q_end || l + 1u >= level_count()) {
            return;
        }
        l += 1u;
        cell = cell >> vec2(1u);
    }
}

@compute @workgroup_size(WIDTH, ROWS)
fn main(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    if (lane < 3u) {
        atomicStore(&counts[lane], 0u);
    }
    workgroupBarrier();
    var is_cut = false;
    if (id.x < frame.width && id.y < frame.height) {
        ray = pixel_ray(id.x, id.y);
        inverse = ray_inverse(ray);
        let place = place_of(id.x, id.y);
        hit_voxel = vec4(-1);
        walk(frame.fans[place.fan].first_plane + place.plane);
        let i = id.y * frame.width + id.x;
        image_color[i] = select(0u, hit_color, hit);
        image_depth[i] = select(INFINITY, bitcast<u32>(hit_depth), hit);
        if (VOXEL) {
            image_voxel[i] = hit_voxel;
        }
        if (COUNT) {
            atomicAdd(&counts[0], n_columns);
            atomicAdd(&counts[1], n_runs);
            atomicAdd(&counts[2], select(0u, 1u, hit));
            is_cut = is_cut_short();
        }
    }
    workgroupBarrier();
    if (is_cut) {
        atomicMax(&counts[0], CUT_SHORT);
    }
    if (ENDS_LOOPS) {
        workgroupBarrier();
    }
    if (COUNT && lane < 3u) {
        let n = (frame.width + WIDTH - 1u) / WIDTH;
        scratch[3u * (group.y * n + group.x) + lane] = atomicLoad(&counts[lane]);
    }
}
