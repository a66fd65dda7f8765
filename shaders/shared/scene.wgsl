// The scene's tables, all levels one after the other (src/resident.rs; a level's positions count from its own start).
// `columns(i)` and the like are written by src/gpu/shaders.rs: a table may be cut into several bindings.

struct Level {
    size: vec2<i32>,
    columns: u32,
    runs: u32,
    blocks: u32,
    blocks_row: u32,
    bottom: i32,
    top: i32,
    paint: u32,
    exposed: u32,
    colors: u32,
    _pad0: u32,
}

@group(0) @binding(2) var<uniform> levels: array<Level, MAX_LEVELS>;

//!table columns vec2<u32>
//!table runs u32
//!table blocks u32
//!table paint u32
//!table exposed vec2<u32>
//!table colors u32

fn run_first(run: u32) -> i32 {
    return i32(run & 0xffffu);
}

fn run_end(run: u32) -> i32 {
    return i32(run >> 16u) + 1;
}

// Number of a column in its level's tables; cells are already within the level.
fn column_index(l: u32, x: i32, z: i32) -> u32 {
    return u32(z * levels[l].size.x + x);
}

// A cell brought into the first period.
fn wrap(v: i32, size: i32) -> i32 {
    if ((size & (size - 1)) == 0) {
        return v & (size - 1);
    }
    let r = v % size;
    return select(r, r + size, r < 0);
}

// Colour of voxel `y` in run number `k` (from the top down) of column number `ix`: `Paint::color`.
fn paint_color(l: u32, ix: u32, k: u32, y: u32) -> u32 {
    if (PAINT == PAINT_RUN) {
        return colors(levels[l].colors + paint(levels[l].paint + ix) + k);
    }
    if (PAINT == PAINT_VOXEL) {
        let start = paint(levels[l].paint + ix);
        let to = paint(levels[l].paint + ix + 1u);
        if (start == to) {
            return UNPAINTED;
        }
        // The last exposed run that starts at or below y, or the first.
        var lo = start;
        var hi = to;
        while (hi - lo > 1u) {
            let mid = (lo + hi) / 2u;
            if ((exposed(levels[l].exposed + mid).x & 0xffffu) <= y) {
                lo = mid;
            } else {
                hi = mid;
            }
        }
        let found = exposed(levels[l].exposed + lo);
        let first = found.x & 0xffffu;
        return colors(levels[l].colors + found.y + clamp(y, first, found.x >> 16u) - first);
    }
    return UNPAINTED;
}
