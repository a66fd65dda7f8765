// Stage shade: colour, screen-space normals, screen-space ambient occlusion, fog and sky.
// Twin: src/cpu/shade.rs. Grid: pixels.
//!include shared/frame.wgsl
//!if SCENE
//!include shared/scene.wgsl
//!endif
//!if SHADOWS
//!include shared/shadow.wgsl
//!endif
//!if SMOOTH_NORMALS
//!include shared/ground.wgsl
//!endif
//!if DERIVED_NORMALS
//!include shared/normal.wgsl
//!endif

@group(0) @binding(3) var<storage, read> image_color: array<u32>;
@group(0) @binding(4) var<storage, read> image_depth: array<u32>;
@group(0) @binding(5) var<storage, read_write> shaded: array<u32>;
// Offsets in pixels of SSAO_SAMPLES neighbours for each of 16 turns.
@group(0) @binding(6) var<storage, read> spiral: array<vec2<i32>>;

override NORMALS: bool = true;
override OCCLUSION: bool = true;
override SSAO_SAMPLES: u32 = 10u;
// b comes first, as in most surfaces that show pictures; r otherwise.
override BGRA: bool = false;

// Stands for the sky; farther than anything drawn.
const FAR: f32 = 3e38;

fn ray_at(x: i32, y: i32) -> vec3<f32> {
    return vec3(frame.start + frame.step * vec2(f32(x), f32(y)), 1.0);
}

// Depth at a pixel; outside the image and in the sky, FAR.
fn depth_at(x: i32, y: i32) -> f32 {
    if (x < 0 || y < 0 || x >= i32(frame.width) || y >= i32(frame.height)) {
        return FAR;
    }
    let z = image_depth[u32(y) * frame.width + u32(x)];
    return select(bitcast<f32>(z), FAR, z == INFINITY);
}

fn pack(c: vec3<f32>) -> u32 {
    let byte = vec3<u32>(clamp(c, vec3(0.0), vec3(1.0)) * 255.0 + 0.5);
    return byte.x | (byte.y << 8u) | (byte.z << 16u) | 0xff000000u;
}

fn put(i: u32, rgba: u32) {
    shaded[i] = select(rgba, (rgba & 0xff00ff00u) | ((rgba & 255u) << 16u) | ((rgba >> 16u) & 255u), BGRA);
}

fn sky(ray: vec3<f32>) -> vec3<f32> {
    let elevation = dot(ray, frame.up) / length(ray);
    let to = select(SKY_NADIR, SKY_ZENITH, elevation >= 0.0);
    var share = min(sqrt(abs(elevation)), 1.0);
    if (frame.fog > 0.0) {
        // The horizon lies in the haze, and below it there is nothing else.
        share *= 1.0 - exp(-HORIZON_CLEARS * max(elevation, 0.0));
    }
    return mix(SKY_HORIZON, to, share);
}

fn tangent(x: i32, y: i32, z: f32, here: vec3<f32>, dx: i32, dy: i32) -> vec3<f32> {
    var sum = vec3(0.0);
    for (var k = 1; k <= 4; k *= 2) {
        let zf = depth_at(x + k * dx, y + k * dy);
        let zb = depth_at(x - k * dx, y - k * dy);
        // The side on the same surface, if one is: a jump of more than what a steep slope makes is an edge.
        let jump_f = abs(zf - z);
        let jump_b = abs(zb - z);
        if (min(jump_f, jump_b) < 0.02 * f32(k) * z + 1.5) {
            if (jump_f <= jump_b) {
                sum += ray_at(x + k * dx, y + k * dy) * zf - here;
            } else {
                sum += here - ray_at(x - k * dx, y - k * dy) * zb;
            }
        }
    }
    return sum;
}

// Unit normal towards the eye, in camera axes.
fn normal(x: i32, y: i32, z: f32) -> vec3<f32> {
    let here = ray_at(x, y) * z;
    let n = cross(tangent(x, y, z, here, 1, 0), tangent(x, y, z, here, 0, 1));
    let length2 = dot(n, n);
    if (!(length2 > 0.0 && length2 < F32_MAX)) {
        if (z > 0.0) {
            return -normalize(ray_at(x, y));
        }
        return vec3(0.0, 0.0, -1.0);
    }
    let unit = n * inverseSqrt(length2);
    return select(unit, -unit, dot(unit, here) > 0.0);
}

// Share of a pixel's light that its surroundings take, 0 to 1.
fn occlusion(x: i32, y: i32, z: f32, n: vec3<f32>) -> f32 {
    let here = ray_at(x, y) * z;
    let radius = frame.radius_px * frame.pixel * z;
    // One of 16 turns in a 4 × 4 pattern.
    let turn = (((x & 3) * 4 + (y & 3)) * 7) & 15;
    var sum = 0.0;
    for (var k = 0u; k < SSAO_SAMPLES; k++) {
        let at = spiral[u32(turn) * SSAO_SAMPLES + k] + vec2(x, y);
        let zs = depth_at(at.x, at.y);
        if (zs == FAR) {
            continue;
        }
        let v = ray_at(at.x, at.y) * zs - here;
        let d2 = dot(v, v);
        let above = dot(v, n) - 0.02 * radius;
        let fade = max(1.0 - d2 / (radius * radius), 0.0);
        sum += max(above * inverseSqrt(d2 + 0.01 * radius * radius), 0.0) * fade;
    }
    return min(SSAO_STRENGTH * 2.0 * sum / f32(SSAO_SAMPLES), 0.85);
}

@compute @workgroup_size(16, 16)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let id = pixel_of(group.xy, lane);
    if (id.x >= frame.width || id.y >= frame.height) {
        return;
    }
    let i = id.y * frame.width + id.x;
    let x = i32(id.x);
    let y = i32(id.y);
    let ray = ray_at(x, y);
    let bits = image_depth[i];
    if (bits == INFINITY) {
        put(i, select(0u, pack(sky(ray)), frame.sky == 1u));
        return;
    }
    let color = image_color[i] | 0xff000000u;
    if (!NORMALS && !OCCLUSION && frame.fog == 0.0) {
        put(i, color);
        return;
    }
    let z = bitcast<f32>(bits);
    var light = 1.0;
    if (NORMALS || OCCLUSION) {
//!if SMOOTH_NORMALS
        let here = ray * z;
        let from_eye = frame.axis_right * here.x + frame.axis_up * here.y + frame.axis_forward * here.z;
        let of_ground = ground_normal(from_eye, max(frame.size * z, 1.0));
        var n = vec3(dot(frame.axis_right, of_ground), dot(frame.axis_up, of_ground), dot(frame.axis_forward, of_ground));
        if (all(of_ground == vec3(0.0))) {
            n = normal(x, y, z);
        }
//!else
//!if DERIVED_NORMALS
        let along = frame.axis_right * ray.x + frame.axis_up * ray.y + frame.axis_forward;
        let of_voxel = occupancy_normal(along * z, along, max(frame.size * z, 1.0));
        var n = vec3(dot(frame.axis_right, of_voxel), dot(frame.axis_up, of_voxel), dot(frame.axis_forward, of_voxel));
        if (all(of_voxel == vec3(0.0))) {
            n = normal(x, y, z);
        }
//!else
        let n = normal(x, y, z);
//!endif
//!endif
        if (NORMALS) {
//!if SHADOWS
            var sun = max(dot(n, frame.sun), 0.0);
            if (sun > 0.0) {
                let size = max(frame.size * z, 1.0);
                let start = ray * z + n * shadow_bias(size, 1.0 / (frame.pixel * z));
                let origin = frame.axis_right * start.x + frame.axis_up * start.y + frame.axis_forward * start.z;
                sun = select(0.0, sun, sun_shines(origin, size));
            }
//!else
            let sun = max(dot(n, frame.sun), 0.0);
//!endif
            light = frame.ambient + (1.0 - frame.ambient) * (0.25 * dot(n, frame.up) + 0.25 + 0.75 * sun);
        }
        if (OCCLUSION) {
            light *= 1.0 - occlusion(x, y, z, n);
        }
    }
    let rgb = vec3<f32>(vec3(color, color >> 8u, color >> 16u) & vec3(255u)) / 255.0;
    let lit = rgb * light;
    var haze = 0.0;
    if (frame.fog > 0.0) {
        let up = dot(ray, frame.up);
        // Where the view ends, nothing is left to end.
        let far = max(z * sqrt(max(dot(ray, ray) - up * up, 0.0)) / frame.view_distance - FADE_BEGINS, 0.0);
        let fade = min(far * (1.0 / (1.0 - FADE_BEGINS)), 1.0);
        haze = 1.0 - exp(-z * length(ray) * frame.fog) * (1.0 - fade * fade * (3.0 - 2.0 * fade));
    }
    put(i, pack(mix(lit, SKY_HORIZON, haze)));
}
