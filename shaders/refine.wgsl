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

// At most REFINE_COLUMNS columns of the ray, from the one that holds depth `start` to `end`: sets `hit`, or gives the depth up
// to which there is nothing.
fn stretch(start: f32, end: f32) -> f32 {
    let size = levels[0].size;
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
    for (var turn = 0u; turn < REFINE_COLUMNS; turn++) {
        let axis = select(0u, 1u, next.y < next.x);
        let q1 = next[axis];
        if (q1 > q0) {
            if (in_world(0u, cell)) {
                column(0u, cell, q0, q1);
                if (hit) {
                    if (turn == 0u && hit_depth == q0 && q0 > 0.0) {
                        hit = false;
                        return INSIDE;
                    }
                    return q0;
                }
            }
            q0 = q1;
        }
        if (q0 >= end) {
            break;
        }
        cell[axis] += step[axis];
        next[axis] = (f32(cell[axis] + ahead[axis] - eye[axis]) - fract_[axis]) * inverse_[axis];
    }
    return q0;
}

@compute @workgroup_size(16, 16)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let id = pixel_of(group.xy, lane);
    if (id.x >= frame.width || id.y >= frame.height) {
        return;
    }
    let i = id.y * frame.width + id.x;
    let doubt = image_depth[frame.width * frame.height + i];
    if (doubt == INFINITY) {
        return;
    }
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
