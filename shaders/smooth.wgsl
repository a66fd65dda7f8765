// Stage smooth: where a height field is so near that its columns are seen one by one, pixels show a surface, not blocks.
// Twin: src/cpu/smooth.rs. Grid: pixels.
//!include shared/frame.wgsl
//!include shared/scene.wgsl
//!include shared/place.wgsl
//!include shared/ground.wgsl

// Of each level of squares where its tops over the surface begin and how many a row has, then the tops.
@group(0) @binding(9) var<storage, read> surface_tops: array<u32>;
@group(0) @binding(6) var<storage, read_write> image_color: array<u32>;
@group(0) @binding(7) var<storage, read_write> image_depth: array<u32>;
@group(0) @binding(10) var<storage, read_write> image_voxel: array<vec4<i32>>;

const NOTHING: u32 = 0u;
const SURFACE: u32 = 1u;
const INSIDE_GROUND: u32 = 2u;

var<private> met_depth: f32;
var<private> met_color: u32;
var<private> met_voxel: vec4<i32>;

// Past a border, and never back.
fn forward(t: f32, border: f32) -> f32 {
    let next = max(border, t);
    return next + (1e-5 + next * SHADOW_PAST_SHARE);
}

// The least s of 0 to `most` at which c + b·s + a·s², above 0 at 0, is 0; F32_MAX where there is none.
fn first_root(c: f32, b: f32, a: f32, most: f32) -> f32 {
    let square = b * b - 4.0 * a * c;
    if (square < 0.0) {
        return F32_MAX;
    }
    let q = -0.5 * (b + select(sqrt(square), -sqrt(square), b < 0.0));
    var least = F32_MAX;
    if (a != 0.0 && q / a >= 0.0) {
        least = q / a;
    }
    if (q != 0.0 && c / q >= 0.0) {
        least = min(least, c / q);
    }
    return select(F32_MAX, least, least <= most);
}

// Colours of four columns' tops, mixed; those without voxels have no part.
fn ground_color(columns_: vec4<u32>, u: vec2<f32>) -> u32 {
    var corners = columns_;
    var shares = vec4((1.0 - u.x) * (1.0 - u.y), u.x * (1.0 - u.y), (1.0 - u.x) * u.y, u.x * u.y);
    var sum = vec3(0.0);
    var all_ = 0.0;
    for (var i = 0u; i < 4u; i++) {
        let n = voxels(0u, corners[i]);
        if (n > 0u) {
            let color = paint_color(0u, corners[i], 0u, n - 1u);
            sum += shares[i] * vec3<f32>(vec3(color, color >> 8u, color >> 16u) & vec3(255u));
            all_ += shares[i];
        }
    }
    let byte = min(vec3<u32>(sum * (1.0 / max(all_, 1e-6)) + 0.5), vec3(255u));
    return byte.x | (byte.y << 8u) | (byte.z << 16u) | 0xff000000u;
}

fn meet(ray: vec3<f32>, most_depth: f32) -> u32 {
    let dir = ray.xz;
    let inverse = 1.0 / select(dir, select(vec2(1e-12), vec2(-1e-12), dir < vec2(0.0)), abs(dir) < vec2(1e-12));
    let rise = ray_inverse(ray).y;
    let dims = levels[0].size;
    let eye = frame.eye_cell.xz;
    let fract_ = frame.eye_fract.xz;
    let height_ = f32(frame.eye_cell.y) + frame.eye_fract.y;
    var end = min(most_depth, frame.view_distance / max(length(dir), TINY));
    var t = 0.0;
    let top_ = (frame.surface_top - height_) * rise;
    let bottom = -height_ * rise;
    if (ray.y < 0.0) {
        t = max(t, top_);
        end = min(end, bottom);
    } else if (ray.y > 0.0) {
        end = min(end, top_);
        t = max(t, bottom);
    } else if (height_ >= frame.surface_top) {
        return NOTHING;
    }
    let repeats = vec2(frame.repeat_x == 1u, frame.repeat_z == 1u);
    let outside = !repeats & ((eye < vec2(0)) | (eye >= dims));
    if (any(outside)) {
        let near = select(dims, vec2(0), dir >= vec2(0.0));
        let enter = (vec2<f32>(near - eye) - fract_) * inverse;
        if (any(outside & (enter < vec2(0.0)))) {
            return NOTHING;
        }
        let in_ = select(vec2(0.0), enter + (SHADOW_PAST + enter * SHADOW_PAST_SHARE), outside);
        t = max(t, max(in_.x, in_.y));
    }
    let most = frame.surface_levels - 1u;
    var k = min(SMOOTH_FIRST, most);
    for (var turn = 0u; turn < SMOOTH_STEPS; turn++) {
        if (t >= end) {
            return NOTHING;
        }
        // In quarters of columns.
        let at = fract_ + dir * t;
        let half_ = vec2<i32>(floor(at + at));
        let off = half_ >> vec2(1u);
        let cell = eye + off;
        let ix = ground_index(cell);
        if (ix == NONE) {
            return NOTHING;
        }
        let here = vec2(i32(ix) % dims.x, i32(ix) / dims.x);
        let base = off - here;
        let shift = SMOOTH_SQUARE_SHIFT + k;
        let square = vec2<u32>(here >> vec2(shift));
        let top = f32(surface_tops[surface_tops[2u * k] + square.y * surface_tops[2u * k + 1u] + square.x]);
        let first = (here >> vec2(shift)) << vec2(shift);
        let past = min(first + vec2(1i << shift), dims);
        let border = (vec2<f32>(base + select(first, past, dir >= vec2(0.0))) - fract_) * inverse;
        let leave = forward(t, min(border.x, border.y));
        if (height_ + min(ray.y * t, ray.y * leave) >= top) {
            t = leave;
            k = min(k + 1u, most);
            continue;
        }
        if (k > 0u) {
            k -= 1u;
            continue;
        }
        let lines_ = (0.5 * vec2<f32>(half_ + select(vec2(0), vec2(1), dir >= vec2(0.0))) - fract_) * inverse;
        let next = forward(t, min(lines_.x, lines_.y));
        let n = voxels(0u, ix);
        if (n == 0u) {
            t = next;
            continue;
        }
        // The patch that holds this quarter begins at the middle of the column before its own, or of its own.
        let before = (half_ - 1) >> vec2(1u);
        let corners = ground_columns(eye + before);
        let p = ground_patch(corners);
        let u = at - (vec2<f32>(before) + 0.5);
        let above = height_ + ray.y * t - (p.x + p.y * u.x + p.z * u.y + p.w * u.x * u.y);
        // Above all of the patch.
        if (height_ + min(ray.y * t, ray.y * next) > p.x + max(p.y, 0.0) + max(p.z, 0.0) + max(p.w, 0.0)) {
            t = next;
            continue;
        }
        var s = 0.0;
        if (above > 0.0) {
            let slope = ray.y - (p.y * dir.x + p.z * dir.y + p.w * (u.x * dir.y + u.y * dir.x));
            s = first_root(above, slope, -p.w * dir.x * dir.y, next - t);
        } else if (t == 0.0) {
            return INSIDE_GROUND;
        }
        if (s < F32_MAX) {
            met_depth = t + s;
            met_color = ground_color(corners, clamp(u + dir * s, vec2(0.0), vec2(1.0)));
            let y = clamp(i32(height_ + ray.y * met_depth), 0, i32(n) - 1);
            met_voxel = vec4(cell.x + frame.offset_x, y, cell.y + frame.offset_z, 0);
            return SURFACE;
        }
        t = next;
    }
    return NOTHING;
}

@compute @workgroup_size(16, 16)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let id = pixel_of(group.xy, lane);
    if (id.x >= frame.width || id.y >= frame.height || frame.surface_levels == 0u) {
        return;
    }
    let i = id.y * frame.width + id.x;
    let bits = image_depth[i];
    let near = bits != INFINITY && bitcast<f32>(bits) < frame.smooth_near;
    // What lies behind a block that the surface does not reach, the ray may find far away.
    let met = meet(pixel_ray(id.x, id.y), select(frame.smooth_near, F32_MAX, near));
    if (met == SURFACE) {
        image_color[i] = met_color;
        image_depth[i] = bitcast<u32>(met_depth);
        if (VOXEL) {
            image_voxel[i] = met_voxel;
        }
    } else if (met == NOTHING && near) {
        image_color[i] = 0u;
        image_depth[i] = INFINITY;
        if (VOXEL) {
            image_voxel[i] = vec4(-1);
        }
    }
}
