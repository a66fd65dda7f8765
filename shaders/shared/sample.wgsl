// What a plane's sample shows, as it stands in the plane buffer: cells of the voxel and its level, all -1 for the sky.

//!if PACKED
// x 21, y 11 | z 21, y 5, level 5, sky 1; x and z from the eye's own cell.
alias Voxel = vec2<u32>;
const NO_VOXEL = vec2<u32>(0u, 0x80000000u);

fn eye_cell_at(l: u32) -> vec2<i32> {
    return frame.eye_cell.xz >> vec2(l);
}

fn pack_voxel(cell: vec2<i32>, y: i32, l: u32) -> Voxel {
    let away = vec2<u32>(cell - eye_cell_at(l)) & vec2(0x1fffffu);
    return vec2(away.x | (u32(y) << 21u), away.y | ((u32(y) >> 11u) << 21u) | (l << 26u));
}

fn unpack_voxel(voxel: Voxel) -> vec4<i32> {
    if (voxel.y >> 31u == 1u) {
        return vec4(-1);
    }
    let l = (voxel.y >> 26u) & 31u;
    let cell = (vec2<i32>(voxel << vec2(11u)) >> vec2(11u)) + eye_cell_at(l);
    return vec4(cell.x, i32((voxel.x >> 21u) | (((voxel.y >> 21u) & 31u) << 11u)), cell.y, i32(l));
}
//!else
alias Voxel = vec4<i32>;
const NO_VOXEL = vec4<i32>(-1);

fn pack_voxel(cell: vec2<i32>, y: i32, l: u32) -> Voxel {
    return vec4(cell.x, y, cell.y, i32(l));
}

fn unpack_voxel(voxel: Voxel) -> vec4<i32> {
    return voxel;
}
//!endif
