// A plane's sight lines and what a run looks like along them; the same functions as in src/cpu/traverse.rs.

// The plane being walked, and slopes of its own window's ends.
var<private> plane: Plane;
var<private> s_first: f32;
var<private> s_end: f32;

fn sight_begin(index: u32) {
    plane = planes[index];
    s_first = edge_slope(plane.first);
    s_end = edge_slope(plane.end);
}

// `b` less what tilted sight lines lose along u.
fn sight_t(b: f32, u: f32) -> f32 {
    if (UPRIGHT) {
        return b;
    }
    return b - u * plane.e;
}

// `c · t + e · h`.
fn sight_scale(t: f32, h: f32) -> f32 {
    if (UPRIGHT) {
        return plane.c * t;
    }
    return plane.c * t + plane.e * h;
}

// Slope of the sight line between samples j - 1 and j.
fn edge_slope(j: i32) -> f32 {
    return slope_at(f32(j));
}

fn slope_at(u: f32) -> f32 {
    let t = sight_t(plane.b, u);
    let h = u * plane.c - plane.a;
    if (t > 0.0) {
        return clamp(h / t, -STEEP, STEEP);
    }
    return select(STEEP, -STEEP, h < 0.0);
}

// The first sample whose centre is at or above point (t, h), within the plane's own window.
fn sample_at(t: f32, h: f32) -> i32 {
    if (h <= s_first * t) {
        return plane.first;
    }
    if (h >= s_end * t) {
        return plane.end;
    }
    let u = (plane.a * t + plane.b * h) / sight_scale(t, h);
    return i32(clamp(ceil(u - 0.5), f32(plane.first), f32(plane.end)));
}

// The heights that may show between t0 and t1 through the window between two slopes.
fn visible(slopes: vec2<f32>, t0: f32, t1: f32) -> vec2<f32> {
    return vec2(slopes.x * select(t1, t0, slopes.x > 0.0), slopes.y * select(t0, t1, slopes.y > 0.0));
}

// Where the plane crosses the grid line at cell number `line` of level 0; never, if it runs along it.
fn cross_x(line: i32) -> f32 {
    if (plane.dir.x == 0.0) {
        return STEEP;
    }
    return (f32(line - frame.eye_cell.x) - frame.eye_fract.x) * plane.inverse.x;
}

fn cross_z(line: i32) -> f32 {
    if (plane.dir.y == 0.0) {
        return STEEP;
    }
    return (f32(line - frame.eye_cell.z) - frame.eye_fract.z) * plane.inverse.y;
}

// The same along axis 0 (x) or 1 (z).
fn cross_axis(axis: u32, line: i32) -> f32 {
    let eye = select(frame.eye_cell.x, frame.eye_cell.z, axis == 1u);
    let fract = select(frame.eye_fract.x, frame.eye_fract.z, axis == 1u);
    let t = (f32(line - eye) - fract) * plane.inverse[axis];
    return select(t, STEEP, plane.dir[axis] == 0.0);
}

// The cell of level l along an axis that holds the plane's point at t: estimated, then put right by the crossings.
fn locate(axis: u32, t: f32, l: u32) -> i32 {
    let d = plane.dir[axis];
    let eye = select(frame.eye_cell.x, frame.eye_cell.z, axis == 1u);
    let fract = select(frame.eye_fract.x, frame.eye_fract.z, axis == 1u);
    var at = (i32(floor(fract + t * d)) + eye) >> l;
    if (d == 0.0) {
        return at;
    }
    let step = select(1, -1, d < 0.0);
    let ahead = select(0, 1, d > 0.0);
    if (cross_axis(axis, (at + ahead) << l) <= t) {
        at += step;
    } else if (cross_axis(axis, (at + 1 - ahead) << l) > t) {
        at -= step;
    }
    return at;
}

// What one sample shows of a run.
struct Shown {
    depth: f32,
    // Voxel within the column, in cells of the level.
    y: i32,
}

// Sample j of a run between heights h0 and h1 whose column begins at t0: bottom, front or top, as `Walk::draw` cuts it.
fn show(j: i32, l: u32, run: u32, h0: f32, h1: f32, t0: f32) -> Shown {
    // The direction through the sample's centre, kept off zero: no depth overflows.
    let ray_t = max(sight_t(sight_t(plane.b, 0.5), f32(j)), TINY);
    let ray_h = (0.5 * plane.c - plane.a) + f32(j) * plane.c;
    let first = run_first(run);
    let last = run_end(run) - 1;
    if (h0 > 0.0 && j < sample_at(t0, h0)) {
        return Shown(h0 * (plane.delta / max(abs(ray_h), TINY)), first);
    }
    if (h1 < 0.0 && j >= sample_at(t0, h1)) {
        return Shown(-h1 * (plane.delta / max(abs(ray_h), TINY)), last);
    }
    let above = clamp((ray_h / ray_t) * t0 - h0, 0.0, f32(((last - first + 1) << l) - 1));
    return Shown(t0 * (plane.delta / ray_t), first + (i32(above) >> l));
}

//!include shared/sample.wgsl

//!if !LATE_COLOR
@group(0) @binding(3) var<storage, read_write> plane_color: array<u32>;
//!endif
@group(0) @binding(4) var<storage, read_write> plane_depth: array<u32>;
@group(0) @binding(5) var<storage, read_write> plane_voxel: array<Voxel>;

fn write_sky(j: i32) {
    let i = plane.base + u32(j);
//!if !LATE_COLOR
    plane_color[i] = 0u;
//!endif
    plane_depth[i] = INFINITY;
    if (VOXEL) {
        plane_voxel[i] = NO_VOXEL;
    }
}

fn write_sample(j: i32, l: u32, cell: vec2<i32>, column: u32, k: u32, run: u32, h0: f32, h1: f32, t0: f32) {
    let shown = show(j, l, run, h0, h1, t0);
    let i = plane.base + u32(j);
//!if !LATE_COLOR
    plane_color[i] = paint_color(l, column, k, u32(shown.y));
//!endif
    plane_depth[i] = bitcast<u32>(shown.depth);
    if (VOXEL) {
        plane_voxel[i] = pack_voxel(cell, shown.y, l);
    }
}
