// One plane, as the host computed it. Rust side: src/gpu/types.rs.

struct Plane {
    dir: vec2<f32>,
    // 1 / dir; the greatest f32 where that is 0.
    inverse: vec2<f32>,
    a: f32,
    b: f32,
    c: f32,
    e: f32,
    delta: f32,
    t_start: f32,
    t_end: f32,
    lod_t: f32,
    first: i32,
    end: i32,
    base: u32,
    lod_first: u32,
    cell: vec2<i32>,
    turn: u32,
    _pad0: u32,
}

@group(0) @binding(1) var<storage, read> planes: array<Plane>;
