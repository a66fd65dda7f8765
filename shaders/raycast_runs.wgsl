// Stage traverse, kernel `raycast-runs`: one ray per pixel over the same tables and levels, straight into the image: what the
// tables of planes are worth to rays. Grid: pixels.
//!include shared/frame.wgsl
//!include shared/plane.wgsl
//!include shared/scene.wgsl
//!include shared/place.wgsl
//!include shared/ray.wgsl

override WIDTH: u32 = 8u;
override ROWS: u32 = 8u;

@group(0) @binding(3) var<storage, read_write> image_color: array<u32>;
@group(0) @binding(4) var<storage, read_write> image_depth: array<u32>;
@group(0) @binding(5) var<storage, read_write> image_voxel: array<vec4<i32>>;
@group(0) @binding(6) var<storage, read_write> scratch: array<u32>;

var<workgroup> counts: array<atomic<u32>, 3>;

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
