// The finished picture into a surface of its own size that lets itself be written to: on large GPUs, few of whose processors
// draw triangles, a third of what a copy takes and a fraction of what the pass of present.wgsl does.

struct Present {
    size: vec2<u32>,
    surface: vec2<u32>,
    // The picture has b in the low byte, not r.
    bgra: u32,
    _pad0: u32,
}

@group(0) @binding(0) var<uniform> present: Present;
// As stage shade leaves it, in sRGB.
@group(0) @binding(1) var<storage, read> picture: array<u32>;
// FORMAT is written in here.
@group(0) @binding(2) var surface: texture_storage_2d<FORMAT, write>;

@compute @workgroup_size(16, 16)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (any(id.xy >= present.size)) {
        return;
    }
    let color = unpack4x8unorm(picture[id.y * present.size.x + id.x]);
    textureStore(surface, id.xy, vec4(select(color.rgb, color.bgr, present.bgra != 0u), 1.0));
}
