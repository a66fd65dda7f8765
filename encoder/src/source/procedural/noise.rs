//! Seeded, periodic gradient noise, the same bits on every machine.
//!
//! Only integer hashing and `+ − * /` of f32, which IEEE 754 rounds one way; nothing from a maths library. Noise is
//! periodic in x and z with a whole number of lattice cells, so every scene made of it tiles.

use rayon::prelude::*;

/// 32 well-mixed bits of a seed and a lattice point.
#[inline]
pub fn hash(seed: u32, x: u32, y: u32, z: u32) -> u32 {
    let mut h = seed ^ x.wrapping_mul(0x9E37_79B1) ^ y.wrapping_mul(0x85EB_CA77) ^ z.wrapping_mul(0xC2B2_AE3D);
    h = (h ^ h >> 16).wrapping_mul(0x7FEB_352D);
    h = (h ^ h >> 15).wrapping_mul(0x846C_A68B);
    h ^ h >> 16
}

/// A hash as a number in [0, 1).
#[inline]
pub fn unit(h: u32) -> f32 {
    (h >> 8) as f32 * (1.0 / (1 << 24) as f32)
}

/// Seed number `i` derived from a scene's seed.
pub fn sub_seed(seed: u64, i: u32) -> u32 {
    hash(seed as u32, (seed >> 32) as u32, i, 0x5EED)
}

fn lerp(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t
}

/// 6t⁵ − 15t⁴ + 10t³: no kinks where lattice cells meet.
fn fade(t: f32) -> f32 {
    t * t * t * (t * (t * 6.0 - 15.0) + 10.0)
}

/// Dot product with one of the twelve directions to the edges of a cube (Perlin 2002).
#[inline]
fn gradient(h: u32, x: f32, y: f32, z: f32) -> f32 {
    let u = if h & 8 == 0 { x } else { y };
    let v = if h & 12 == 0 {
        y
    } else if h & 13 == 12 {
        x
    } else {
        z
    };
    (if h & 1 == 0 { u } else { -u }) + (if h & 2 == 0 { v } else { -v })
}

/// Gradient noise in about [−1, 1] at `(x, y, z) ≥ 0` in lattice cells, periodic in x and z by `period` cells.
pub fn gradient_noise(seed: u32, period: [u32; 2], [x, y, z]: [f32; 3]) -> f32 {
    let (xi, yi, zi) = (x as u32, y as u32, z as u32);
    let (fx, fy, fz) = (x - xi as f32, y - yi as f32, z - zi as f32);
    let (x0, x1) = (xi % period[0], (xi + 1) % period[0]);
    let (z0, z1) = (zi % period[1], (zi + 1) % period[1]);
    let corner = |xi, yi, zi, dx, dy, dz| gradient(hash(seed, xi, yi, zi), fx - dx, fy - dy, fz - dz);
    let (u, v, w) = (fade(fx), fade(fy), fade(fz));
    let edge = |yi, dy, zi, dz| lerp(corner(x0, yi, zi, 0.0, dy, dz), corner(x1, yi, zi, 1.0, dy, dz), u);
    let face = |zi, dz| lerp(edge(yi, 0.0, zi, dz), edge(yi + 1, 1.0, zi, dz), v);
    lerp(face(z0, 0.0), face(z1, 1.0), w)
}

/// Octaves of noise over a world of `size × size` columns.
#[derive(Clone, Copy)]
pub struct Octaves {
    pub seed: u32,
    /// Columns along a side, the period.
    pub size: u32,
    /// Voxels a lattice cell of the first octave; rounded so that a whole number fits the side.
    pub wavelength: f32,
    pub n: u32,
    /// Amplitude of each octave over that of the one before.
    pub gain: f32,
    /// Vertical wavelengths over horizontal.
    pub squash: f32,
}

impl Octaves {
    /// Sum of the octaves at a point in voxels, divided by the sum of amplitudes.
    pub fn at(&self, [x, y, z]: [f32; 3]) -> f32 {
        let (mut sum, mut total, mut amplitude) = (0.0, 0.0, 1.0);
        let cells = ((self.size as f32 / self.wavelength + 0.5) as u32).max(1);
        for octave in 0..self.n {
            let cells = cells << octave;
            let scale = cells as f32 / self.size as f32;
            let p = [x * scale, y * scale / self.squash, z * scale];
            sum += amplitude * gradient_noise(self.seed.wrapping_add(octave), [cells, cells], p);
            total += amplitude;
            amplitude *= self.gain;
        }
        sum / total
    }
}

/// A smooth function sampled on a coarse lattice, periodic in x and z; linear between samples.
pub struct Field {
    /// Columns along a side of the world, lattice cells along it, and samples along y.
    size: u32,
    cells: u32,
    levels: u32,
    /// y of the lowest sample and voxels between two.
    y0: f32,
    step: f32,
    /// `(z·cells + x)·levels + y`.
    samples: Vec<f32>,
}

impl Field {
    /// Samples about every `spacing` voxels, over `y_range`.
    pub fn new(size: u32, y_range: std::ops::Range<f32>, spacing: f32, f: impl Fn([f32; 3]) -> f32 + Sync) -> Field {
        let cells = ((size as f32 / spacing + 0.5) as u32).max(1);
        let levels = ((y_range.end - y_range.start) / spacing) as u32 + 2;
        let scale = size as f32 / cells as f32;
        let mut samples = vec![0.0; cells as usize * cells as usize * levels as usize];
        samples.par_chunks_mut((cells * levels) as usize).enumerate().for_each(|(z, row)| {
            for (i, sample) in row.iter_mut().enumerate() {
                let (x, y) = (i as u32 / levels, i as u32 % levels);
                *sample = f([x as f32 * scale, y_range.start + y as f32 * spacing, z as f32 * scale]);
            }
        });
        Field { size, cells, levels, y0: y_range.start, step: spacing, samples }
    }

    /// The samples along y over the centre of column (x, z).
    pub fn profile<'a>(&self, x: u32, z: u32, out: &'a mut Vec<f32>) -> Profile<'a> {
        let place = |v: u32| {
            let p = (v as f32 + 0.5) * self.cells as f32 / self.size as f32;
            let i = p as u32;
            (i % self.cells, (i + 1) % self.cells, p - i as f32)
        };
        let ((x0, x1, fx), (z0, z1, fz)) = (place(x), place(z));
        let line = |x: u32, z: u32| {
            let at = (z as usize * self.cells as usize + x as usize) * self.levels as usize;
            &self.samples[at..at + self.levels as usize]
        };
        let (a, b, c, d) = (line(x0, z0), line(x1, z0), line(x0, z1), line(x1, z1));
        out.clear();
        out.extend((0..self.levels as usize).map(|j| lerp(lerp(a[j], b[j], fx), lerp(c[j], d[j], fx), fz)));
        Profile { y0: self.y0, per_voxel: 1.0 / self.step, samples: out }
    }
}

/// A [`Field`] over one column.
pub struct Profile<'a> {
    y0: f32,
    per_voxel: f32,
    samples: &'a [f32],
}

impl Profile<'_> {
    /// Value at the centre of voxel `y`, which lies in the field's range.
    #[inline]
    pub fn at(&self, y: u32) -> f32 {
        let p = (y as f32 + 0.5 - self.y0) * self.per_voxel;
        let j = p as usize;
        lerp(self.samples[j], self.samples[j + 1], p - j as f32)
    }
}
