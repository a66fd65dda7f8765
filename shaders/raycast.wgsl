// Stage traverse, kernel `raycast`: one ray per pixel through a sparse tree of 64-bit masks (src/tree.rs) with the levels of
// planes, straight into the image; the baseline that planes are measured against. Grid: pixels. Twin: src/cpu/raycast.rs.
//!include shared/frame.wgsl
//!include shared/plane.wgsl
//!include shared/scene.wgsl
//!include shared/place.wgsl

override WIDTH: u32 = 8u;
override ROWS: u32 = 8u;

@group(0) @binding(3) var<storage, read_write> image_color: array<u32>;
@group(0) @binding(4) var<storage, read_write> image_depth: array<u32>;
@group(0) @binding(5) var<storage, read_write> image_voxel: array<vec4<i32>>;
@group(0) @binding(6) var<storage, read_write> scratch: array<u32>;
@group(0) @binding(9) var<storage, read> tree: array<u32>;
// Of each level: position of its first root, how many roots stand along x and along z.
@group(0) @binding(10) var<uniform> roots: array<vec4<u32>, MAX_LEVELS>;

var<workgroup> counts: array<atomic<u32>, 3>;

var<private> n_columns: u32;
var<private> n_cells: u32;

// The ray: direction with component 1 along the camera's forward axis, so that its parameter is depth.
var<private> ray: vec3<f32>;
var<private> inverse: vec3<f32>;
var<private> step: vec3<i32>;
var<private> ahead: vec3<i32>;
var<private> hit: bool;
var<private> hit_depth: f32;
var<private> hit_color: u32;
var<private> hit_voxel: vec4<i32>;

// The nodes on the way to the cell looked at last: position, mask, children.
var<private> node_at: vec4<u32>;
var<private> root: vec3<u32>;
var<private> upper: vec3<u32>;
var<private> lower: vec3<u32>;
var<private> leaf: vec2<u32>;

// Of `found`: the cell is solid.
const SOLID_CELL: u32 = 32u;
// Of a node's children: it is solid throughout.
const SOLID_NODE: u32 = 0xffffffffu;

// Depths at which grid lines of level 0 are crossed.
fn crosses(lines: vec3<i32>) -> vec3<f32> {
    let at = vec3<f32>(lines - frame.eye_cell) - frame.eye_fract;
    return select(at * inverse, vec3(STEEP), ray == vec3(0.0));
}

// The cell of level l that holds depth q: estimated, then put right by the crossings.
fn locate_ray(q: f32, l: u32) -> vec3<i32> {
    let at = (vec3<i32>(floor(frame.eye_fract + q * ray)) + frame.eye_cell) >> vec3(l);
    let next = crosses((at + ahead) << vec3(l));
    let before = crosses((at + 1 - ahead) << vec3(l));
    let forth = next <= vec3(q);
    let back = (before > vec3(q)) & (ray != vec3(0.0));
    return at + select(select(vec3(0), -step, back), step, forth);
}

fn child_bit(cell: vec3<u32>, shift: u32) -> u32 {
    let part = (cell >> vec3(shift)) & vec3(3u);
    return part.x | (part.z << 2u) | (part.y << 4u);
}

// The half of a mask that has a bit.
fn half_of(mask: vec2<u32>, bit: u32) -> u32 {
    return select(mask.x, mask.y, bit >= 32u);
}

fn has_child(mask: vec2<u32>, bit: u32) -> bool {
    return ((half_of(mask, bit) >> (bit & 31u)) & 1u) != 0u;
}

// Children before that of a bit.
fn rank(mask: vec2<u32>, bit: u32) -> u32 {
    let before = countOneBits(half_of(mask, bit) & ((1u << (bit & 31u)) - 1u));
    return before + select(0u, countOneBits(mask.x), bit >= 32u);
}

// Log2 of the side of the empty cube at a bit: of two children a side where those are empty together, of four where all are.
fn empty_shift(mask: vec2<u32>, bit: u32, shift: u32) -> u32 {
    let octant = (half_of(mask, bit) >> (bit & 10u)) & 0x00330033u;
    return shift + select(0u, 1u, octant == 0u) + select(0u, 1u, (mask.x | mask.y) == 0u);
}

// What holds a cell of level l, which lies within it: SOLID_CELL, or log2 of the side of an empty cube.
fn found(l: u32, cell: vec3<u32>) -> u32 {
    var at = roots[l].x + 3u * (((cell.y >> 8u) * roots[l].z + (cell.z >> 8u)) * roots[l].y + (cell.x >> 8u));
    if (at != node_at.x) {
        node_at.x = at;
        root = vec3(tree[at], tree[at + 1u], tree[at + 2u]);
    }
    var bit = child_bit(cell, 6u);
    if (!has_child(root.xy, bit)) {
        return empty_shift(root.xy, bit, 6u);
    }
    if (root.z == SOLID_NODE) {
        return SOLID_CELL;
    }
    at = root.z + 3u * rank(root.xy, bit);
    if (at != node_at.y) {
        node_at.y = at;
        upper = vec3(tree[at], tree[at + 1u], tree[at + 2u]);
    }
    bit = child_bit(cell, 4u);
    if (!has_child(upper.xy, bit)) {
        return empty_shift(upper.xy, bit, 4u);
    }
    if (upper.z == SOLID_NODE) {
        return SOLID_CELL;
    }
    at = upper.z + 3u * rank(upper.xy, bit);
    if (at != node_at.z) {
        node_at.z = at;
        lower = vec3(tree[at], tree[at + 1u], tree[at + 2u]);
    }
    bit = child_bit(cell, 2u);
    if (!has_child(lower.xy, bit)) {
        return empty_shift(lower.xy, bit, 2u);
    }
    if (lower.z == SOLID_NODE) {
        return SOLID_CELL;
    }
    at = lower.z + 2u * rank(lower.xy, bit);
    if (at != node_at.w) {
        node_at.w = at;
        leaf = vec2(tree[at], tree[at + 1u]);
    }
    bit = child_bit(cell, 0u);
    if (!has_child(leaf, bit)) {
        return empty_shift(leaf, bit, 0u);
    }
    return SOLID_CELL;
}

//!if RUN_COLORS
// Number, from the top down, of the run that holds voxel y of a column.
fn run_number(l: u32, ix: u32, y: i32) -> u32 {
    let entry = column_entry(l, ix);
    if (entry.y == 0u || run_first(entry.x) <= y) {
        return 0u;
    }
    let more = levels[l].runs + entry.y;
    var lo = 0u;
    var hi = runs(more) - 1u;
    while (lo < hi) {
        let mid = (lo + hi) / 2u;
        if (run_first(runs(more + 1u + mid)) <= y) {
            hi = mid;
        } else {
            lo = mid + 1u;
        }
    }
    return lo + 1u;
}
//!endif

// What the ray meets of level l between two depths.
fn walk_level(l: u32, start: f32, limit: f32) {
    let low = vec3(0, levels[l].bottom, 0);
    let high = vec3(levels[l].size.x, levels[l].top, levels[l].size.y);
    var cell = locate_ray(start, l);
    let bounded = clamp(cell, low, high - 1);
    cell.y = bounded.y;
    if (!REPEATS || frame.repeat_x == 0u) {
        cell.x = bounded.x;
    }
    if (!REPEATS || frame.repeat_z == 0u) {
        cell.z = bounded.z;
    }
    var q = start;
    n_columns += 1u;
    while (q < limit) {
        n_cells += 1u;
        let within = vec3(wrap(cell.x, high.x), cell.y, wrap(cell.z, high.z));
        let what = found(l, vec3<u32>(within));
        let shift = select(what, 0u, what == SOLID_CELL);
        // Out of the cube, or of the world, which may repeat from there on.
        let side = vec3((1i << shift) - 1);
        let up = min((within | side) + 1, high) - within;
        let down = max(within & ~side, low) - 1 - within;
        let stop = cell + select(down, up, step > vec3(0));
        let exits = crosses((stop + 1 - ahead) << vec3(l));
        let exit = min(exits.x, min(exits.y, exits.z));
        // A cell of which the ray has no more than a point is not met.
        if (what == SOLID_CELL && exit > q) {
            let ix = column_index(l, within.x, within.z);
            var k = 0u;
//!if RUN_COLORS
            k = run_number(l, ix, within.y);
//!endif
            hit = true;
            hit_depth = clamp(q, 0.0, F32_MAX);
            hit_color = paint_color(l, ix, k, u32(within.y));
            hit_voxel = vec4((cell << vec3(l)) + vec3(frame.offset_x, 0, frame.offset_z), i32(l));
            return;
        }
        if (exit >= limit) {
            return;
        }
        q = max(q, exit);
        let x = exits.x <= exits.y && exits.x <= exits.z;
        let leaves = vec3(x, !x && exits.y <= exits.z, !x && exits.y > exits.z);
        n_columns += select(1u, 0u, leaves.y);
        var next = cell;
        if (shift > 0u) {
            let inner = stop - step;
            next = clamp(locate_ray(q, l), min(cell, inner), max(cell, inner));
        }
        cell = select(next, stop, leaves);
    }
}

fn walk(p: u32) {
    let horizontal = max(length(ray.xz), TINY);
    step = select(vec3(1), vec3(-1), ray < vec3(0.0));
    ahead = select(vec3(0), vec3(1), step > vec3(0));
    // The part of the ray that lies in the world and in the view.
    var q = 0.0;
    var q_end = min(frame.view_distance / horizontal, 1e17);
    let size = vec3(levels[0].size.x, 0, levels[0].size.y);
    let near = crosses(select(size, vec3(0), step > vec3(0)));
    let far = crosses(select(vec3(0), size, step > vec3(0)));
    for (var axis = 0u; axis < 3u; axis += 2u) {
        let repeats = select(frame.repeat_x, frame.repeat_z, axis == 2u);
        if (REPEATS && repeats == 1u) {
            continue;
        }
        if (ray[axis] == 0.0) {
            if (frame.eye_cell[axis] < 0 || frame.eye_cell[axis] >= size[axis]) {
                return;
            }
            continue;
        }
        q = max(q, near[axis]);
        q_end = min(q_end, far[axis]);
    }
    // Levels begin where those of the pixel's plane do.
    let lod_q = planes[p].lod_t / horizontal;
    node_at = vec4(NONE);
    for (var l = planes[p].lod_first; l < level_count(); l++) {
        if (q >= q_end) {
            return;
        }
        var limit = q_end;
        if (l + 1u < level_count()) {
            limit = min(limit, lod_q * f32(1u << (l + 1u)));
        }
        if (q >= limit) {
            continue;
        }
        let heights = vec2(height(levels[l].bottom << l), height(levels[l].top << l));
        var ends = vec2(q, limit);
        if (ray.y != 0.0) {
            let turned = select(heights, heights.yx, ray.y < 0.0) * inverse.y;
            ends = vec2(max(q, turned.x), min(limit, turned.y));
        } else if (!(heights.x <= 0.0 && heights.y > 0.0)) {
            ends.y = q;
        }
        if (ends.x < ends.y) {
            walk_level(l, ends.x, ends.y);
            if (hit) {
                return;
            }
        }
        q = limit;
    }
}

@compute @workgroup_size(WIDTH, ROWS)
fn main(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    if (lane < 3u) {
        atomicStore(&counts[lane], 0u);
    }
    workgroupBarrier();
    var is_cut = false;
    if (id.x < frame.width && id.y < frame.height) {
        ray = pixel_ray(id.x, id.y);
        inverse = ray_inverse(ray);
        let place = place_of(id.x, id.y);
        hit_voxel = vec4(-1);
        walk(frame.fans[place.fan].first_plane + place.plane);
        let i = id.y * frame.width + id.x;
        image_color[i] = select(0u, hit_color, hit);
        image_depth[i] = select(INFINITY, bitcast<u32>(hit_depth), hit);
        if (VOXEL) {
            image_voxel[i] = hit_voxel;
        }
        if (COUNT) {
            atomicAdd(&counts[0], n_columns);
            atomicAdd(&counts[1], n_cells);
            atomicAdd(&counts[2], select(0u, 1u, hit));
            is_cut = is_cut_short();
        }
    }
    workgroupBarrier();
    if (is_cut) {
        atomicMax(&counts[0], CUT_SHORT);
    }
    if (ENDS_LOOPS) {
        workgroupBarrier();
    }
    if (COUNT && lane < 3u) {
        let n = (frame.width + WIDTH - 1u) / WIDTH;
        scratch[3u * (group.y * n + group.x) + lane] = atomicLoad(&counts[lane]);
    }
}
