// The surface that a height field stands for. Twin: `Ground` in src/cpu/smooth.rs.

//!if FRACTIONS
// By how much it is higher than level 0's columns, in 256ths of a voxel, 128 more; four columns a word.
@group(0) @binding(13) var<storage, read> fractions: array<u32>;
//!endif

const HOLE_HEIGHT: f32 = -1e9;

// Number of the column at a place, NONE where there is none.
fn ground_index(cell: vec2<i32>) -> u32 {
    let dims = levels[0].size;
    let repeats = vec2(frame.repeat_x == 1u, frame.repeat_z == 1u);
    if (any(!repeats & ((cell < vec2(0)) | (cell >= dims)))) {
        return NONE;
    }
    let at = vec2(select(cell.x, wrap(cell.x, dims.x), repeats.x), select(cell.y, wrap(cell.y, dims.y), repeats.y));
    return u32(at.y * dims.x + at.x);
}

fn ground_height(ix: u32) -> f32 {
    let n = voxels(0u, ix);
//!if FRACTIONS
    let fraction = (f32((fractions[ix >> 2u] >> (8u * (ix & 3u))) & 255u) - 128.0) * (1.0 / 256.0);
//!else
    let fraction = 0.0;
//!endif
    return select(f32(n) + fraction, HOLE_HEIGHT, n == 0u);
}

fn ground_put(axis: u32, v: i32, n: i32, repeat: u32) -> i32 {
    if (repeat == 1u) {
        return wrap(v, n);
    }
    return clamp(v, 0, n - 1);
}

// Columns at the corners of the patch that begins at a column's middle: beyond the world's edge it goes on level.
fn ground_columns(cell: vec2<i32>) -> vec4<u32> {
    let dims = levels[0].size;
    let x0 = ground_put(0u, cell.x, dims.x, frame.repeat_x);
    let x1 = ground_put(0u, cell.x + 1, dims.x, frame.repeat_x);
    let z0 = ground_put(1u, cell.y, dims.y, frame.repeat_z);
    let z1 = ground_put(1u, cell.y + 1, dims.y, frame.repeat_z);
    return vec4<u32>(vec4(z0 * dims.x + x0, z0 * dims.x + x1, z1 * dims.x + x0, z1 * dims.x + x1));
}

// a + b·u + c·v + d·u·v of that patch; a corner without voxels is as high as the mean of the others.
fn ground_patch(columns_: vec4<u32>) -> vec4<f32> {
    var h = vec4(
        ground_height(columns_.x),
        ground_height(columns_.y),
        ground_height(columns_.z),
        ground_height(columns_.w),
    );
    let holes = h == vec4(HOLE_HEIGHT);
    if (any(holes)) {
        let whole = select(vec4(1.0), vec4(0.0), holes);
        let mean = dot(select(h, vec4(0.0), holes), whole) / max(dot(whole, vec4(1.0)), 1.0);
        h = select(h, vec4(mean), holes);
    }
    return vec4(h.x, h.y - h.x, h.z - h.x, h.x - h.y - h.z + h.w);
}

// Height of the surface at a place of level 0: columns, and what is left over.
fn ground_at(cell: vec2<i32>, rest: vec2<f32>) -> f32 {
    let at = rest - 0.5;
    let floor_ = floor(at);
    let p = ground_patch(ground_columns(cell + vec2<i32>(floor_)));
    let u = at - floor_;
    return p.x + p.y * u.x + p.z * u.y + p.w * u.x * u.y;
}

//!if SMOOTH_NORMALS
// The surface's normal at a point given from the eye that is drawn with voxels so large, in the world; 0 where that is a wall.
fn ground_normal(from_eye: vec3<f32>, size: f32) -> vec3<f32> {
    let at = from_eye.xz + frame.eye_fract.xz;
    let floor_ = floor(at);
    let cell = frame.eye_cell.xz + vec2<i32>(floor_);
    let ix = ground_index(cell);
    if (ix == NONE) {
        return vec3(0.0);
    }
    if (voxels(0u, ix) == 0u) {
        return vec3(0.0);
    }
    let rest = at - floor_;
    // Whole columns: the same place in each patch.
    let away = i32(min(size + 0.5, 65536.0));
    let slope = vec2(
        ground_at(cell + vec2(away, 0), rest) - ground_at(cell - vec2(away, 0), rest),
        ground_at(cell + vec2(0, away), rest) - ground_at(cell - vec2(0, away), rest),
    ) * (0.5 / f32(away));
    let steep = length(slope);
    let y = from_eye.y + (f32(frame.eye_cell.y) + frame.eye_fract.y);
    if (y <= ground_at(cell, rest) - (1.5 + steep) * size) {
        return vec3(0.0);
    }
    return vec3(-slope.x, 1.0, -slope.y) * inverseSqrt(1.0 + steep * steep);
}
//!endif
