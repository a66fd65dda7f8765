//! Gradient noise in integers: u32 and i32 that wrap, and shifts, so that a shader can make the same bytes.
//!
//! Places are half voxels of level 0 (the middle of voxel x of level l is (2x + 1)·2ˡ), fractions and values 4,096ths. A
//! lattice cell is a power of two wide. The lattice ends where 2³² half voxels do, and goes on from the other side.

pub use crate::source::procedural::noise::hash;

/// One, as a fraction or a value.
pub const ONE: i32 = 1 << 12;

/// No value of [`noise2`] and [`noise3`] is farther from 0: half of the gradient along each axis, and what rounding adds.
pub const MOST: [i32; 2] = [ONE + ROUNDING, ONE * 3 / 2 + ROUNDING];

/// How far rounding takes a value from that of the function that is meant.
pub const ROUNDING: i32 = 16;

/// The cell that holds a place, and how far into it.
#[inline(always)]
pub fn cell(place: u32, shift: u32) -> (u32, i32) {
    let rest = place & ((1 << shift) - 1);
    (place >> shift, if shift > 12 { rest >> (shift - 12) } else { rest << (12 - shift) } as i32)
}

/// The cell after one.
#[inline(always)]
pub fn after(cell: u32, shift: u32) -> u32 {
    (cell + 1) & (u32::MAX >> shift)
}

/// 6t⁵ − 15t⁴ + 10t³.
#[inline(always)]
pub fn fade(t: i32) -> i32 {
    let cube = (((t * t) >> 12) * t) >> 12;
    (cube * (((t * (6 * t - 15 * ONE)) >> 12) + 10 * ONE)) >> 12
}

#[inline(always)]
pub fn lerp(a: i32, b: i32, t: i32) -> i32 {
    a + (((b - a) * t) >> 12)
}

#[inline(always)]
pub fn scaled(a: i32, t: i32) -> i32 {
    (a * t) >> 12
}

/// Slopes along x, y and z at a corner of the lattice, each above −1 and below 1.
#[inline(always)]
pub fn gradient(hash: u32) -> [i32; 3] {
    [hash, hash >> 8, hash >> 16].map(|h| (((h & 0xFF) << 1) as i32 - 255) << 4)
}

/// Noise along a line through a cell: value and slope of the planes at its two ends, and how far between them.
#[inline(always)]
pub fn along([c0, s0]: [i32; 2], [c1, s1]: [i32; 2], t: i32, fade: i32) -> i32 {
    lerp(c0 + scaled(s0, t), c1 + scaled(s1, t - ONE), fade)
}

/// The plane of one end of a line along x, between two corners in z.
#[inline(always)]
pub fn end2([gx0, _, gz0]: [i32; 3], [gx1, _, gz1]: [i32; 3], fz: i32, w: i32) -> [i32; 2] {
    [lerp(scaled(gz0, fz), scaled(gz1, fz - ONE), w), lerp(gx0, gx1, w)]
}

/// The plane of one end of a line along y, between four corners: (x0, z0), (x1, z0), (x0, z1), (x1, z1).
#[inline(always)]
pub fn end3(g: &[[i32; 3]; 4], [fx, fz]: [i32; 2], [u, w]: [i32; 2]) -> [i32; 2] {
    let at = |i: usize, dx: i32, dz: i32| scaled(g[i][0], fx - dx) + scaled(g[i][2], fz - dz);
    let c = lerp(lerp(at(0, 0, 0), at(1, ONE, 0), u), lerp(at(2, 0, ONE), at(3, ONE, ONE), u), w);
    let s = lerp(lerp(g[0][1], g[1][1], u), lerp(g[2][1], g[3][1], u), w);
    [c, s]
}

/// Noise of two dimensions at a place, in cells of 2^`shift` half voxels.
pub fn noise2(seed: u32, [x, z]: [u32; 2], shift: u32) -> i32 {
    let ((x0, fx), (z0, fz)) = (cell(x, shift), cell(z, shift));
    let (x1, z1) = (after(x0, shift), after(z0, shift));
    let w = fade(fz);
    let g = |x, z| gradient(hash(seed, x, 0, z));
    along(end2(g(x0, z0), g(x0, z1), fz, w), end2(g(x1, z0), g(x1, z1), fz, w), fx, fade(fx))
}

/// Noise of three dimensions.
pub fn noise3(seed: u32, [x, y, z]: [u32; 3], shift: u32) -> i32 {
    let [(x0, fx), (y0, fy), (z0, fz)] = [x, y, z].map(|v| cell(v, shift));
    let [x1, y1, z1] = [x0, y0, z0].map(|v| after(v, shift));
    let end = |y| {
        let g = [(x0, z0), (x1, z0), (x0, z1), (x1, z1)].map(|(x, z)| gradient(hash(seed, x, y, z)));
        end3(&g, [fx, fz], [fade(fx), fade(fz)])
    };
    along(end(y0), end(y1), fy, fade(fy))
}
