// The finished picture into a surface of its own size that lets itself be written to. After shared/picture.wgsl.

// FORMAT is written in here.
@group(0) @binding(2) var surface: texture_storage_2d<FORMAT, write>;

@compute @workgroup_size(16, 16)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (any(id.xy >= present.size)) {
        return;
    }
    textureStore(surface, id.xy, vec4(color_at(id.xy), 1.0));
}
