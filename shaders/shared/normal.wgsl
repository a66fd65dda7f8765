// Normals from what is solid around a voxel. Twin: src/cpu/normal.rs.

// Of a column's voxels from `low` up to `high`: how many a run has, and twice the sum of how far they are above y.
fn solid_of(first: i32, end: i32, y: i32, low: i32, high: i32) -> vec2<i32> {
    let a = max(first, low);
    let b = min(end, high);
    if (b <= a) {
        return vec2(0);
    }
    return vec2(b - a, (b - a) * (a + b - 1 - 2 * y));
}

fn solid_around(l: u32, ix: u32, y: i32, reach: i32) -> vec2<i32> {
    let low = y - reach;
    let high = y + reach + 1;
    let entry = column_entry(l, ix);
    if (entry.x == EMPTY) {
        return vec2(0);
    }
    var sum = solid_of(run_first(entry.x), run_end(entry.x), y, low, high);
//!if !HEIGHTS
    if (entry.y != 0u && run_first(entry.x) > low) {
        let more = levels[l].runs + entry.y;
        let n = runs(more);
        var lo = 0u;
        var hi = n;
        while (lo < hi) {
            let mid = (lo + hi) / 2u;
            if (run_first(runs(more + 1u + mid)) >= high) {
                lo = mid + 1u;
            } else {
                hi = mid;
            }
        }
        while (lo < n) {
            let run = runs(more + 1u + lo);
            if (run_end(run) <= low) {
                break;
            }
            sum += solid_of(run_first(run), run_end(run), y, low, high);
            lo += 1u;
        }
    }
//!endif
    return sum;
}

// The normal of the voxel at a point given from the eye, along a ray, drawn so large; 0 where what is around it has no side.
fn occupancy_normal(from_eye: vec3<f32>, ray: vec3<f32>, size: f32) -> vec3<f32> {
    let l = min(u32(max(i32(bitcast<u32>(size) >> 23u) - 127, 0)), max(frame.levels, 1u) - 1u);
    let at = from_eye + ray * (f32(1u << l) * NORMAL_INTO / length(ray)) + frame.eye_fract;
    let cell = (frame.eye_cell + vec3<i32>(floor(at))) >> vec3(l);
    let repeats = vec2(frame.repeat_x == 1u, frame.repeat_z == 1u);
    var sum = vec3(0);
    for (var dz = -3; dz <= 3; dz++) {
        for (var dx = -3; dx <= 3; dx++) {
            let left = NORMAL_REACH_SQUARE - dx * dx - dz * dz;
            if (left < 0) {
                continue;
            }
            let reach = i32(sqrt(f32(left) + 0.5));
            let here = vec2(cell.x + dx, cell.z + dz);
            if (any(!repeats & ((here < vec2(0)) | (here >= levels[l].size)))) {
                continue;
            }
            let ix = column_index(l, wrap(here.x, levels[l].size.x), wrap(here.y, levels[l].size.y));
            let solid = solid_around(l, ix, cell.y, reach);
            sum += vec3(2 * dx * solid.x, solid.y, 2 * dz * solid.x);
        }
    }
    if (all(sum == vec3(0))) {
        return vec3(0.0);
    }
    let n = -normalize(vec3<f32>(sum));
    return select(vec3(0.0), n, dot(n, ray) < 0.0);
}
