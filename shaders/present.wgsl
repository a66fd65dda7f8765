// The finished picture onto a surface, as a triangle that covers it. Not a stage: nothing of a picture is made here.
// After shared/picture.wgsl.

// The surface encodes what it is given as sRGB.
override ENCODES: bool = false;

@vertex
fn corner(@builtin(vertex_index) i: u32) -> @builtin(position) vec4<f32> {
    return vec4(f32(i & 1u) * 4.0 - 1.0, f32(i >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

fn at(x: i32, y: i32) -> vec3<f32> {
    let last = vec2<i32>(present.size) - 1;
    return color_at(vec2<u32>(clamp(vec2(x, y), vec2(0), last)));
}

@fragment
fn pixel(@builtin(position) position: vec4<f32>) -> @location(0) vec4<f32> {
    let here = position.xy - vec2<f32>(present.at);
    var color: vec3<f32>;
    if (all(present.size == present.surface)) {
        color = at(i32(here.x), i32(here.y));
    } else {
        // Enlarged or reduced: linear between the four pixels around.
        let p = here * vec2<f32>(present.size) / vec2<f32>(present.surface) - 0.5;
        let low = floor(p);
        let f = p - low;
        let x = i32(low.x);
        let y = i32(low.y);
        color = mix(mix(at(x, y), at(x + 1, y), f.x), mix(at(x, y + 1), at(x + 1, y + 1), f.x), f.y);
    }
    if (ENCODES) {
        color = select(pow((color + 0.055) / 1.055, vec3(2.4)), color / 12.92, color <= vec3(0.04045));
    }
    return vec4(color, 1.0);
}
