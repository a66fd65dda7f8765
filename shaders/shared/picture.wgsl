// The finished picture and the surface that shows it.

struct Present {
    // Pixels of the picture, and of the surface those that show it, which begin at `at`.
    size: vec2<u32>,
    surface: vec2<u32>,
    at: vec2<u32>,
    // The picture has b in the low byte, not r.
    bgra: u32,
    _pad0: u32,
}

@group(0) @binding(0) var<uniform> present: Present;
// As stage shade leaves it, in sRGB.
@group(0) @binding(1) var<storage, read> picture: array<u32>;

fn color_at(p: vec2<u32>) -> vec3<f32> {
    let color = unpack4x8unorm(picture[p.y * present.size.x + p.x]);
    return select(color.rgb, color.bgr, present.bgra != 0u);
}

