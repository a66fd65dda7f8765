// Stage refine: pixels that remap left in doubt walk their own rays at level 0 over the few columns in which the samples
// around them say that the surface lies. Twin: src/cpu/refine.rs. Grid: pixels.
//!include shared/frame.wgsl
//!include shared/scene.wgsl
//!include shared/place.wgsl
//!include shared/ray.wgsl

@group(0) @binding(6) var<storage, read_write> image_color: array<u32>;
// Behind the depths of all pixels their doubts.
@group(0) @binding(7) var<storage, read_write> image_depth: array<u32>;
@group(0) @binding(10) var<storage, read_write> image_voxel: array<vec4<i32>>;

// What `stretch` says where it begins within something solid.
const INSIDE: f32 = -1.0;

// Number and entry of the column of level 0 at a cell; outside the world an empty one.
fn known_of(cell: vec2<i32>) -> vec3<u32> {
    if (!in_world(0u, cell)) {
        return vec3(0u, EMPTY, 0u);
    }
    let ix = column_index(0u, wrap(cell.x, levels[0].size.x), wrap(cell.y, levels[0].size.y));
    return vec3(ix, column_entry(0u, ix));
}

// At most REFINE_COLUMNS columns of the ray, from the one that holds depth `start` to `end`: sets `hit`, or gives the depth up
// to which there is nothing.
fn stretch(start: f32, end: f32) -> f32 {
    let along = vec2(ray.x, ray.z);
    let step = select(vec2(1), vec2(-1), along < vec2(0.0));
    let ahead = select(vec2(0), vec2(1), step > vec2(0));
    let eye = vec2(frame.eye_cell.x, frame.eye_cell.z);
    let fract_ = vec2(frame.eye_fract.x, frame.eye_fract.z);
    let inverse_ = vec2(inverse.x, inverse.z);
    // A sample along the horizon may claim any depth.
    var cell = eye + vec2<i32>(floor(clamp(fract_ + start * along, vec2(-FARTHEST), vec2(FARTHEST))));
    let entry = (vec2<f32>(cell + 1 - ahead - eye) - fract_) * inverse_;
    var q0 = max(max(entry.x, entry.y), 0.0);
    var next = (vec2<f32>(cell + ahead - eye) - fract_) * inverse_;
    // Two columns a turn: their entries come from memory together.
    for (var turn = 0u; turn < REFINE_COLUMNS; turn += 2u) {
        let first = cell;
        var axis = select(0u, 1u, next.y < next.x);
        let q1 = next[axis];
        cell[axis] += step[axis];
        next[axis] = (f32(cell[axis] + ahead[axis] - eye[axis]) - fract_[axis]) * inverse_[axis];
        let known = known_of(first);
        let known_second = known_of(cell);
        if (q1 > q0) {
            column_of(0u, first, known.x, known.yz, q0, q1);
            if (hit) {
                if (turn == 0u && hit_depth == q0 && q0 > 0.0) {
                    hit = false;
                    return INSIDE;
                }
                return q0;
            }
            q0 = q1;
        }
        if (q0 >= end) {
            break;
        }
        axis = select(0u, 1u, next.y < next.x);
        let q2 = next[axis];
        if (q2 > q0) {
            column_of(0u, cell, known_second.x, known_second.yz, q0, q2);
            if (hit) {
                return q0;
            }
            q0 = q2;
        }
        if (q0 >= end) {
            break;
        }
        cell[axis] += step[axis];
        next[axis] = (f32(cell[axis] + ahead[axis] - eye[axis]) - fract_[axis]) * inverse_[axis];
    }
    return q0;
}

// Which lanes' pixels are in doubt. A tenth of them, spread over all subgroups: side by side they keep fewer of these waiting.
var<workgroup> n_doubtful: atomic<u32>;
var<workgroup> doubtful: array<u32, 256>;

@compute @workgroup_size(16, 16)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    if (lane == 0u) {
        atomicStore(&n_doubtful, 0u);
    }
    workgroupBarrier();
    let own = pixel_of(group.xy, lane);
    if (own.x < frame.width && own.y < frame.height) {
        if (image_depth[frame.width * (frame.height + own.y) + own.x] != INFINITY) {
            doubtful[atomicAdd(&n_doubtful, 1u)] = lane;
        }
    }
    workgroupBarrier();
    if (lane < atomicLoad(&n_doubtful)) {
        settle(pixel_of(group.xy, doubtful[lane]));
    }
}

// Walks the ray of a pixel in doubt.
fn settle(id: vec2<u32>) {
    let i = id.y * frame.width + id.x;
    let doubt = image_depth[frame.width * frame.height + i];
    ray = pixel_ray(id.x, id.y);
    inverse = ray_inverse(ray);
    let view_end = frame.view_distance / max(length(ray.xz), TINY);
    let margin = REFINE_MARGIN / max(max(abs(ray.x), abs(ray.y)), abs(ray.z));
    let sky = image_depth[i] == INFINITY;
    let depth = select(bitcast<f32>(image_depth[i]), F32_MAX, sky);
    // What the ray meets there, it cannot see through.
    let end = select(min(depth, view_end), view_end, (doubt >> 31u) == 1u);
    let start = max(bitcast<f32>(doubt & 0x7fffffffu) - margin, 0.0);
    if (start >= view_end) {
        return;
    }
    let to = stretch(start, end);
    // Between two surfaces lies nothing that a sample has shown.
    if (!hit && to != INSIDE && to < depth && depth < view_end && !sky) {
        stretch(max(depth - margin, to), end);
    }
    if (!hit) {
        return;
    }
    image_color[i] = hit_color;
    image_depth[i] = bitcast<u32>(hit_depth);
    if (VOXEL) {
        image_voxel[i] = hit_voxel;
    }
}
