// From a pixel to its plane and sample (src/cpu/remap.rs), in integers that the host prepared in f64: along each row
// (fans up and down) and each column (left and right) the plane's number is a linear function, kept in 32.32 fixed point.

const UP: u32 = 0u;
const DOWN: u32 = 1u;
const LEFT: u32 = 2u;
const RIGHT: u32 = 3u;

struct Line {
    // Value at pixel `anchor`, and step from pixel to pixel; high words signed.
    at_hi: i32,
    at_lo: u32,
    step_hi: i32,
    step_lo: u32,
    anchor: i32,
    // Of a row: columns from .. to lie in fan `fan`, those before in LEFT, those after in RIGHT.
    to: i32,
    fan: u32,
    // Pixels here in a pixel of the far edge.
    narrow: f32,
}

// Lines, two elements each: rows first, then the columns of LEFT, then those of RIGHT. After them the stripes of fans
// whose stripes differ in width, one element each: start and middle, (high, low) words.
@group(0) @binding(8) var<storage, read> lines: array<vec4<u32>>;

fn line_at(i: u32) -> Line {
    let a = lines[2u * i];
    let b = lines[2u * i + 1u];
    return Line(i32(a.x), a.y, i32(a.z), a.w, i32(b.x), i32(b.y), b.z, bitcast<f32>(b.w));
}

struct Place {
    fan: u32,
    // Plane of the fan, and the one next nearest.
    plane: u32,
    second: u32,
    sample: u32,
    // Whether the plane passes within half a pixel.
    covered: bool,
}

// The 64-bit product of two words, (high, low).
fn wide(a: u32, b: u32) -> vec2<u32> {
    let al = a & 0xffffu;
    let ah = a >> 16u;
    let bl = b & 0xffffu;
    let bh = b >> 16u;
    let ll = al * bl;
    let lh = al * bh;
    let hl = ah * bl;
    let middle = (ll >> 16u) + (lh & 0xffffu) + (hl & 0xffffu);
    return vec2(ah * bh + (lh >> 16u) + (hl >> 16u) + (middle >> 16u), (middle << 16u) | (ll & 0xffffu));
}

// Value of a line n pixels from its anchor, (high, low).
fn line_value(line: Line, n: i32) -> vec2<u32> {
    let p = wide(u32(n), line.step_lo);
    var high = p.x + u32(n) * u32(line.step_hi);
    if (n < 0) {
        high -= line.step_lo;
    }
    let low = line.at_lo + p.y;
    return vec2(u32(line.at_hi) + high + select(0u, 1u, low < p.y), low);
}

// Signed less-than of two (high, low) values.
fn below(a: vec2<u32>, b: vec2<u32>) -> bool {
    return i32(a.x) < i32(b.x) || (a.x == b.x && a.y < b.y);
}

fn place_of(x: u32, y: u32) -> Place {
    let row = line_at(y);
    var f = row.fan;
    var line = row;
    var n = i32(x) - row.anchor;
    if (i32(x) < row.anchor) {
        f = LEFT;
    } else if (i32(x) >= row.to) {
        f = RIGHT;
    }
    if (f == LEFT || f == RIGHT) {
        line = line_at(frame.height + select(0u, frame.width, f == RIGHT) + x);
        n = i32(y) - line.anchor;
    }
    let value = line_value(line, n);
    let last = i32(frame.fans[f].n_planes) - 1;
    var plane: i32;
    // Distance from the plane's place, in pixels of the far edge.
    var off: f32;
    let first = frame.fans[f].bounds;
    if (first == NONE) {
        plane = i32(value.x);
        off = (f32(plane - clamp(plane, 0, last)) + (f32(value.y) * (1.0 / 4294967296.0) - 0.5)) * frame.fans[f].spacing;
        plane = clamp(plane, 0, last);
    } else {
        var lo = 0;
        var hi = last + 1;
        while (hi - lo > 1) {
            let mid = (lo + hi) / 2;
            if (below(value, lines[first + u32(mid)].xy)) {
                hi = mid;
            } else {
                lo = mid;
            }
        }
        plane = lo;
        let middle = lines[first + u32(plane)].zw;
        let borrow = select(0u, 1u, value.y < middle.y);
        off = f32(i32(value.x - middle.x - borrow)) + f32(value.y - middle.y) * (1.0 / 4294967296.0);
    }
    let second = clamp(plane + select(1, -1, off < 0.0), 0, last);
    var sample = select(x, y, f < LEFT);
    if (frame.fans[f].n_samples != frame.fans[f].pixels) {
        sample = (2u * sample + 1u) * frame.fans[f].n_samples / (2u * frame.fans[f].pixels);
    }
    if (frame.fans[f].flip == 1u) {
        sample = frame.fans[f].n_samples - 1u - sample;
    }
    // A rounding's width over, so that planes one pixel apart leave no hole.
    return Place(f, u32(plane), u32(second), sample, abs(off * line.narrow) <= 0.5 + 1e-6);
}

// Where a plane's sample stands in the plane buffer.
fn buffer_index(f: u32, plane: u32, sample: u32) -> u32 {
    return frame.fans[f].first_sample + plane * frame.fans[f].n_samples + sample;
}

// Reciprocals of the components of pixel (x, y)'s ray.
fn ray_inverse(ray: vec3<f32>) -> vec3<f32> {
    return select(1.0 / ray, vec3(1e30), abs(ray) < vec3(1e-30));
}

fn pixel_ray(x: u32, y: u32) -> vec3<f32> {
    return frame.ray_origin + f32(x) * frame.ray_right + f32(y) * frame.ray_down;
}
