// Stage usage: how many pixels show the tile of each slot, of a world whose tiles come and go.
// Twin: src/cpu/usage.rs. Grid: pixels.
//!include shared/frame.wgsl
//!include shared/scene.wgsl

// By number of the slot among those of all levels.
@group(0) @binding(6) var<storage, read_write> usage: array<atomic<u32>>;
@group(0) @binding(10) var<storage, read> image_voxel: array<vec4<i32>>;

// Columns of a slot in the table of columns, as a power of two.
//!if HEIGHTS
const SLOT_SHIFT: u32 = 2u * TILE_SHIFT - 1u;
//!else
const SLOT_SHIFT: u32 = 2u * TILE_SHIFT;
//!endif

// The slot that the group's first pixel shows, and how many show the same, as most do.
var<workgroup> first_slot: u32;
var<workgroup> together: atomic<u32>;

fn slot_number(voxel: vec4<i32>) -> u32 {
    if (voxel.w < 0) {
        return NONE;
    }
    let l = u32(voxel.w);
    return (levels[l].columns >> SLOT_SHIFT) + slot_of(l, vec2<u32>(voxel.xz) >> vec2(l));
}

@compute @workgroup_size(16, 16)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    var slot = NONE;
    if (id.x < frame.width && id.y < frame.height) {
        slot = slot_number(image_voxel[id.y * frame.width + id.x]);
    }
    if (lane == 0u) {
        first_slot = slot;
        atomicStore(&together, 0u);
    }
    workgroupBarrier();
    if (slot == first_slot) {
        atomicAdd(&together, 1u);
    } else if (slot != NONE) {
        atomicAdd(&usage[slot], 1u);
    }
    workgroupBarrier();
    if (lane == 0u && slot != NONE) {
        atomicAdd(&usage[slot], atomicLoad(&together));
    }
}
