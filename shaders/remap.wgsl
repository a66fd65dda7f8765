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

// Depth at which a ray enters a voxel, at least 0; MISS where it does not.
fn enter(voxel: vec4<i32>, inverse: vec3<f32>) -> f32 {
    let l = u32(voxel.w);
    let lower = vec3<f32>((voxel.xyz << vec3(l)) - frame.eye_cell) - frame.eye_fract;
    // From whole numbers: a sum with the other face would lose one at hand.
    let upper = vec3<f32>(((voxel.xyz + vec3(1)) << vec3(l)) - frame.eye_cell) - frame.eye_fract;
    let a = lower * inverse;
    let b = upper * inverse;
    let near3 = min(a, b);
    let far3 = max(a, b);
    let near = max(max(near3.x, near3.y), max(near3.z, 0.0));
    let far = min(min(far3.x, far3.y), far3.z);
    // Rounding must not let a ray slip between two voxels.
    return select(MISS, near, near <= far * (1.0 + 1e-6));
}

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
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
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
    let own_voxel = voxel_of(own);
    var near_own = MISS;
    if (own_voxel.w >= 0) {
        near_own = enter(own_voxel, inverse);
    }
    let beside = buffer_index(place.fan, place.second, place.sample);
    let beside_plane = frame.fans[place.fan].first_plane + place.second;
    var near_beside = MISS;
    var beside_voxel = vec4(-1);
    // Beyond a plane's own samples its part of the buffer is not drawn.
    if (i32(place.sample) >= planes[beside_plane].first && i32(place.sample) < planes[beside_plane].end) {
        beside_voxel = voxel_of(beside);
        if (beside_voxel.w >= 0) {
            near_beside = enter(beside_voxel, inverse);
        }
    }
    // The nearer of the two is what the ray sees.
    if (near_beside != MISS && (near_own == MISS || near_beside < near_own)) {
        put(i, beside, beside_voxel, bitcast<u32>(near_beside));
        return;
    }
    if (near_own != MISS) {
        put(i, own, own_voxel, bitcast<u32>(near_own));
        return;
    }
    // The nearest sample that the ray meets among those around the place; else one of the two planes' own
    // that shows the sky; else the nearest plane's.
    var best = own;
    var best_depth = MISS;
    var sky = select(NONE, own, own_voxel.w < 0);
    for (var side = 0u; side < 2u; side++) {
        let k = select(place.plane, place.second, side == 1u);
        let p = frame.fans[place.fan].first_plane + k;
        let start = max(i32(place.sample) - 1, planes[p].first);
        let to = min(i32(place.sample) + 2, planes[p].end);
        for (var sample = start; sample < to; sample++) {
            let at = buffer_index(place.fan, k, u32(sample));
            let voxel = voxel_of(at);
            if (voxel.w < 0) {
                // Not a neighbour's along the line: that would be a notch in a silhouette.
                sky = select(sky, at, sky == NONE && u32(sample) == place.sample);
                continue;
            }
            let near = enter(voxel, inverse);
            if (near != MISS && (best_depth == MISS || near < best_depth)) {
                best = at;
                best_depth = near;
            }
        }
    }
    if (best_depth != MISS) {
        put(i, best, voxel_of(best), bitcast<u32>(best_depth));
    } else {
        let chosen = select(sky, own, sky == NONE);
        put(i, chosen, voxel_of(chosen), plane_depth[chosen]);
    }
//!endif
//!endif
//!endif
}
