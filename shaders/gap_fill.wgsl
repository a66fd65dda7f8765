// Stage gap_fill: pixels that no plane passes take the sample of the nearest pixel that one does.
// Twin: src/cpu/gap_fill.rs. Grid: pixels.
//!include shared/frame.wgsl
//!include shared/place.wgsl

// As remap left it, and as it shall be.
@group(0) @binding(3) var<storage, read> before: array<u32>;
@group(0) @binding(4) var<storage, read_write> index: array<u32>;

@compute @workgroup_size(16, 16)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= frame.width || id.y >= frame.height) {
        return;
    }
    let i = id.y * frame.width + id.x;
    if (before[i] != HOLE) {
        index[i] = before[i];
        return;
    }
    let place = place_of(id.x, id.y);
    let n_samples = frame.fans[place.fan].n_samples;
    let own = frame.fans[place.fan].first_sample;
    let own_end = own + frame.fans[place.fan].n_planes * n_samples;
    let along = select(vec2(0, 1), vec2(1, 0), place.fan < LEFT);
    let size = vec2(i32(frame.width), i32(frame.height));
    var plane = place.plane;
    // Nearer neighbours first, the right or lower one of two.
    for (var d = 1; d < max(size.x, size.y); d++) {
        var found = HOLE;
        var inside = false;
        for (var side = 0; side < 2; side++) {
            let at = vec2(i32(id.x), i32(id.y)) + along * select(d, -d, side == 1);
            if (all(at >= vec2(0)) && all(at < size)) {
                inside = true;
                let sample = before[u32(at.y) * frame.width + u32(at.x)];
                if (found == HOLE && sample != HOLE && sample >= own && sample < own_end) {
                    found = sample;
                }
            }
        }
        if (found != HOLE) {
            plane = (found - own) / n_samples;
            break;
        }
        if (!inside) {
            break;
        }
    }
    // The neighbour names the plane; the sample along it stays the pixel's own.
    index[i] = own + plane * n_samples + place.sample;
}
