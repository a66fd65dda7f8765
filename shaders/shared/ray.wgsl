// A pixel's ray and what it meets in one column.

var<private> n_columns: u32;
var<private> n_runs: u32;

// The ray: direction with component 1 along the camera's forward axis, so that its parameter is depth.
var<private> ray: vec3<f32>;
var<private> inverse: vec3<f32>;
var<private> hit: bool;
var<private> hit_depth: f32;
var<private> hit_color: u32;
var<private> hit_voxel: vec4<i32>;

fn cross_ray(axis: u32, line: i32) -> f32 {
    let a = axis * 2u;
    return select((f32(line - frame.eye_cell[a]) - frame.eye_fract[a]) * inverse[a], STEEP, ray[a] == 0.0);
}

// The first run of a column that the ray meets between q0 and q1.
fn column(l: u32, cell: vec2<i32>, q0: f32, q1: f32) {
    let ix = column_index(l, wrap(cell.x, levels[l].size.x), wrap(cell.y, levels[l].size.y));
    column_of(l, cell, ix, column_entry(l, ix), q0, q1);
}

// The same of column number `ix`, whose entry is known.
fn column_of(l: u32, cell: vec2<i32>, ix: u32, entry: vec2<u32>, q0: f32, q1: f32) {
    n_columns += 1u;
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
