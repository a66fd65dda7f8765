// Stage remap: each pixel takes the sample of the nearest plane, or (RETEST) the one whose voxel its own ray meets; or it
// writes (INDEX) which sample it takes, for gap_fill, and nothing else, and then (GATHER) takes what gap_fill settled on.
// Twin: src/cpu/remap.rs. Grid: pixels.
//!include shared/frame.wgsl
//!include shared/plane.wgsl
//!include shared/place.wgsl
//!include shared/sample.wgsl
//!include shared/scene.wgsl

//!if !LATE_COLOR
@group(0) @binding(3) var<storage, read> plane_color: array<u32>;
//!endif
@group(0) @binding(4) var<storage, read> plane_depth: array<u32>;
@group(0) @binding(5) var<storage, read> plane_voxel: array<Voxel>;
@group(0) @binding(6) var<storage, read_write> image_color: array<u32>;
// With REFINE, behind the depths of all pixels their doubts (src/cpu/refine.rs).
@group(0) @binding(7) var<storage, read_write> image_depth: array<u32>;
@group(0) @binding(10) var<storage, read_write> image_voxel: array<vec4<i32>>;
//!if INDEX
@group(0) @binding(11) var<storage, read_write> index: array<u32>;
// Pixels without a plane.
@group(0) @binding(12) var<storage, read_write> holes: atomic<u32>;
//!endif
//!if GATHER
@group(0) @binding(11) var<storage, read_write> index: array<u32>;
//!endif

const MISS: f32 = -1.0;

// Depths at which a ray enters a voxel's box, at least 0, and leaves it; the first is greater where it passes by.
fn cut(voxel: vec4<i32>, inverse: vec3<f32>) -> vec2<f32> {
    let l = u32(voxel.w);
    let lower = vec3<f32>((voxel.xyz << vec3(l)) - frame.eye_cell) - frame.eye_fract;
    // From whole numbers: a sum with the other face would lose one at hand.
    let upper = vec3<f32>(((voxel.xyz + vec3(1)) << vec3(l)) - frame.eye_cell) - frame.eye_fract;
    let a = lower * inverse;
    let b = upper * inverse;
    let near3 = min(a, b);
    let far3 = max(a, b);
    return vec2(max(max(near3.x, near3.y), max(near3.z, 0.0)), min(min(far3.x, far3.y), far3.z));
}

// Depth at which a ray enters a voxel, at least 0; MISS where it does not, or there is none, or the eye touches it and the
// ray leaves it.
fn enter(voxel: vec4<i32>, inverse: vec3<f32>) -> f32 {
    if (voxel.w < 0) {
        return MISS;
    }
    let depth = cut(voxel, inverse);
    // Rounding must not let a ray slip between two voxels.
    return select(MISS, depth.x, depth.x <= depth.y * (1.0 + 1e-6) && depth.y > 0.0);
}

//!if RETEST
// Whether a plane of a fan draws a sample: beyond its own samples its part of the buffer is not drawn.
fn is_drawn(fan: u32, k: u32, sample: i32) -> bool {
    let p = frame.fans[fan].first_plane + k;
    return sample >= planes[p].first && sample < planes[p].end;
}

// By how much a ray misses a voxel, as an angle: a share of the distance. The sky is always met.
fn missed_by(voxel: vec4<i32>, inverse: vec3<f32>) -> f32 {
    if (voxel.w < 0) {
        return -STEEP;
    }
    let depth = cut(voxel, inverse);
    if (depth.x <= 0.0) {
        return STEEP;
    }
    return (depth.x - depth.y) / depth.x;
}

//!endif
fn put(i: u32, sample: u32, voxel: vec4<i32>, depth: u32) {
//!if LATE_COLOR
    image_color[i] = color_of(voxel);
//!else
    image_color[i] = plane_color[sample];
//!endif
    image_depth[i] = depth;
    if (VOXEL) {
        let corner = vec4(voxel.xyz << vec3(u32(voxel.w)), voxel.w) + vec4(frame.offset_x, 0, frame.offset_z, 0);
        image_voxel[i] = select(corner, voxel, voxel.w < 0);
    }
}

// The sample's voxel, where it is written.
fn voxel_of(sample: u32) -> vec4<i32> {
//!if !RETEST
    if (!VOXEL) {
        return vec4(-1);
    }
//!endif
    return unpack_voxel(plane_voxel[sample]);
}

//!if LATE_COLOR
// As the plane would have it: the columns of runs with colours of their own do not come here.
fn color_of(voxel: vec4<i32>) -> u32 {
    if (voxel.w < 0) {
        return 0u;
    }
    let l = u32(voxel.w);
    let cell = vec2(wrap(voxel.x, levels[l].size.x), wrap(voxel.z, levels[l].size.y));
    return paint_color(l, column_index(l, cell.x, cell.y), 0u, u32(voxel.y));
}

//!endif

@compute @workgroup_size(16, 16)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let id = pixel_of(group.xy, lane);
    if (id.x >= frame.width || id.y >= frame.height) {
        return;
    }
    let i = id.y * frame.width + id.x;
//!if GATHER
    let sample = index[i];
    if (sample == HOLE) {
        image_color[i] = 0u;
        image_depth[i] = INFINITY;
        if (VOXEL) {
            image_voxel[i] = vec4(-1);
        }
        return;
    }
    put(i, sample, voxel_of(sample), plane_depth[sample]);
//!else
    let place = place_of(id.x, id.y);
    let own = buffer_index(place.fan, place.plane, place.sample);
//!if INDEX
    index[i] = select(HOLE, own, place.covered);
    if (!place.covered) {
        atomicAdd(&holes, 1u);
    }
//!else
//!if !RETEST
    put(i, own, voxel_of(own), plane_depth[own]);
//!else
    let inverse = ray_inverse(pixel_ray(id.x, id.y));
    let beside = buffer_index(place.fan, place.second, place.sample);
    let near_own = enter(voxel_of(own), inverse);
    var near_beside = near_own;
    let both = is_drawn(place.fan, place.second, i32(place.sample));
    if (both) {
        near_beside = enter(voxel_of(beside), inverse);
    }
    var best = own;
    var near = near_own;
//!if REFINE
    // No doubt where it meets the same voxel in both, or one of two that share a face. A ray enters one voxel at one depth.
    // Nor of cells of coarser levels.
    let voxel_own = voxel_of(own);
    let voxel_beside = voxel_of(select(own, beside, both));
    let apart = abs(voxel_own - voxel_beside);
    let neighbours = max(max(apart.x, apart.y), apart.z) <= 1 && apart.x + apart.y + apart.z <= 1 && apart.w == 0;
    let coarse = max(voxel_own.w, voxel_beside.w) > 0;
    let settled = coarse || ((near_own != MISS || near_beside != MISS) && (neighbours || near_own == near_beside));
    // Depths are not negative: their bits have their order.
    var nearest = min(plane_depth[own], plane_depth[select(own, beside, both)]);
//!endif
    // Of voxels in both planes the nearer is what the ray sees.
    if (near_beside != MISS && (near == MISS || near_beside < near)) {
        best = beside;
        near = near_beside;
    }
    // Where it does not meet both, the nearest that it meets of the samples next to them too.
    if (near_own == MISS || near_beside == MISS) {
        for (var turn = 0u; turn < 4u; turn++) {
            let k = select(place.plane, place.second, turn >= 2u);
            let sample = i32(place.sample) + select(-1, 1, (turn & 1u) == 1u);
            if (!is_drawn(place.fan, k, sample)) {
                continue;
            }
            let at = buffer_index(place.fan, k, u32(sample));
            let voxel = voxel_of(at);
            let depth = enter(voxel, inverse);
//!if REFINE
            nearest = min(nearest, select(plane_depth[at], INFINITY, voxel.w > 0));
//!endif
            if (depth != MISS && (near == MISS || depth < near)) {
                best = at;
                near = depth;
            }
        }
    }
//!if REFINE
    let doubt = nearest | select(0u, 0x80000000u, near == MISS);
    image_depth[frame.width * frame.height + i] = select(doubt, INFINITY, settled || nearest == INFINITY);
//!endif
    if (near != MISS) {
        put(i, best, voxel_of(best), bitcast<u32>(near));
    } else {
        // The sky if one of the two planes shows it, else the voxel that it misses less.
        if (both && missed_by(voxel_of(beside), inverse) < missed_by(voxel_of(own), inverse)) {
            best = beside;
        }
        put(i, best, voxel_of(best), plane_depth[best]);
    }
//!endif
//!endif
//!endif
}
