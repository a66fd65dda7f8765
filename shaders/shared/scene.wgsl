// The scene's tables, all levels one after the other (src/world/tables.rs; a level's positions count from its own start).
// `columns(i)` and the like are written by src/gpu/shaders.rs: a table may be cut into several bindings.

struct Level {
    size: vec2<i32>,
    columns: u32,
    runs: u32,
    blocks: u32,
    // Blocks a row; where tiles stand in slots, tiles a side of the window, as a power of two.
    blocks_row: u32,
    bottom: i32,
    top: i32,
    // NONE: this level has a colour a column, though others have more.
    paint: u32,
    exposed: u32,
    colors: u32,
    // Slots of the window's tiles, among the runs.
    pages: u32,
}

@group(0) @binding(2) var<uniform> levels: array<Level, MAX_LEVELS>;

//!if HEIGHTS
//!table columns u32
//!else
//!table columns vec2<u32>
//!endif
// Runs, then blocks, of each level.
//!table runs u32
// Starts, exposed runs and colours of each level.
//!table paint u32

// Levels that can be drawn.
fn level_count() -> u32 {
    if (ONE_LEVEL) {
        return 1u;
    }
    return frame.levels;
}

//!if HEIGHTS
// Voxels of column number `ix`, from the ground up.
fn voxels(l: u32, ix: u32) -> u32 {
    return (columns(levels[l].columns + (ix >> 1u)) >> (16u * (ix & 1u))) & 0xffffu;
}

fn run_of_height(n: u32) -> u32 {
    return select((n - 1u) << 16u, EMPTY, n == 0u);
}

//!endif
// The topmost run of column number `ix`, EMPTY where it has none, and where the others stand, 0 for none.
fn column_entry(l: u32, ix: u32) -> vec2<u32> {
//!if HEIGHTS
    return vec2(run_of_height(voxels(l, ix)), 0u);
//!else
    return columns(levels[l].columns + ix);
//!endif
}

//!if PAGED
// Slot of the tile that holds a cell within the level.
fn slot_of(l: u32, cell: vec2<u32>) -> u32 {
    let shift = levels[l].blocks_row;
    let at = (cell >> vec2(TILE_SHIFT)) & vec2((1u << shift) - 1u);
    return runs(levels[l].pages + ((at.y << shift) | at.x));
}

//!endif
// Height bounds of the block that holds a cell within the level.
fn block_of(l: u32, cell: vec2<i32>) -> u32 {
    let at = vec2<u32>(cell) >> vec2(BLOCK_SHIFT);
//!if PAGED
    let within = at & vec2((1u << (TILE_SHIFT - BLOCK_SHIFT)) - 1u);
    let row = (slot_of(l, vec2<u32>(cell)) << (TILE_SHIFT - BLOCK_SHIFT)) | within.y;
    return runs(levels[l].blocks + ((row << (TILE_SHIFT - BLOCK_SHIFT)) | within.x));
//!else
    return runs(levels[l].blocks + at.y * levels[l].blocks_row + at.x);
//!endif
}

fn run_first(run: u32) -> i32 {
    return i32(run & 0xffffu);
}

fn run_end(run: u32) -> i32 {
    return i32(run >> 16u) + 1;
}

// Number of a column in its level's tables; cells are already within the level.
fn column_index(l: u32, x: i32, z: i32) -> u32 {
//!if PAGED
    let cell = vec2(u32(x), u32(z));
    let within = cell & vec2((1u << TILE_SHIFT) - 1u);
    return (((slot_of(l, cell) << TILE_SHIFT) | within.y) << TILE_SHIFT) | within.x;
//!else
    return u32(z * levels[l].size.x + x);
//!endif
}

// A cell brought into the first period.
fn wrap(v: i32, size: i32) -> i32 {
    if (!REPEATS) {
        return v;
    }
    if ((size & (size - 1)) == 0) {
        return v & (size - 1);
    }
    let r = v % size;
    return select(r, r + size, r < 0);
}

fn in_world(l: u32, cell: vec2<i32>) -> bool {
    let within = (cell >= vec2(0)) & (cell < levels[l].size);
    if (!REPEATS) {
        return all(within);
    }
    return (within.x || frame.repeat_x == 1u) && (within.y || frame.repeat_z == 1u);
}

// Where the starts of column number `ix` stand among its level's: a slot has one more than columns.
fn start_at(l: u32, ix: u32) -> u32 {
//!if PAGED
    return levels[l].paint + ix + (ix >> (2u * TILE_SHIFT));
//!else
    return levels[l].paint + ix;
//!endif
}

// Colour of voxel `y` in run number `k` (from the top down) of column number `ix`: `ResidentLevel::color`.
fn paint_color(l: u32, ix: u32, k: u32, y: u32) -> u32 {
    if (PAINT == PAINT_COLUMN) {
        return paint(levels[l].colors + ix);
    }
    if (PAINT == PAINT_HEIGHT) {
        return paint(levels[l].colors + y);
    }
//!if HEIGHTS
    if (PAINT == PAINT_TOP) {
        if (levels[l].paint == NONE) {
            return paint(levels[l].colors + ix);
        }
        let at = start_at(l, ix);
        let start = paint(at);
        let n = paint(at + 1u) - start;
        if (n == 0u) {
            return UNPAINTED;
        }
        let hidden = max(voxels(l, ix), n) - n;
        return paint(levels[l].colors + start + max(y, hidden) - hidden);
    }
//!else
    if (PAINT == PAINT_RUN) {
        return paint(levels[l].colors + paint(levels[l].paint + ix) + k);
    }
    if (PAINT == PAINT_VOXEL) {
        let at = start_at(l, ix);
        let start = paint(at);
        let to = paint(at + 1u);
        if (start == to) {
            return UNPAINTED;
        }
        // The last exposed run that starts at or below y, or the first.
        var lo = start;
        var hi = to;
        while (hi - lo > 1u) {
            let mid = (lo + hi) / 2u;
            if ((paint(levels[l].exposed + 2u * mid) & 0xffffu) <= y) {
                lo = mid;
            } else {
                hi = mid;
            }
        }
        let run_at = levels[l].exposed + 2u * lo;
        let found = vec2(paint(run_at), paint(run_at + 1u));
        let first = found.x & 0xffffu;
        return paint(levels[l].colors + found.y + clamp(y, first, found.x >> 16u) - first);
    }
//!endif
    return UNPAINTED;
}
